"""Programs in several files: divided and joined they make the same motions, whoever executes them."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as changed

from postproc.dialects import krl
from postproc.dialects.krl.dialect import KRL
from postproc.dialects.krl.language.parts import joined, taken_apart
from postproc.dialects.krl.write import in_files
from postproc.dialects.text import decode
from postproc.errors import PostprocError, ProgramError
from postproc.frames import xyzabc_from_pose
from postproc.program import Written
from tests.attack import krl as attack
from tests.attack.krl_generator import Generator
from tests.attack.krl_interpreter import Controller, Invalid
from tests.dialects.krl_programs import CELL, body, forward, numbers, read, targets
from tests.dialects.test_krl_emit import milling
from tests.dialects.test_krl_emit import targets as emitted_targets
from tests.oracle.arm import abc

DATA = "\r\n".join(
    [
        "&ACCESS RVP",
        "DEFDAT part",
        "DECL E6POS XP1={X 0,Y 0,Z 50,A 0,B 0,C 180}",
        "DECL E6POS XP2={X 10,Y 0,Z 50,A 0,B 0,C 180}",
        "DECL GLOBAL REAL HEIGHT=5.0",
        "DECL REAL DEPTH=-1.0",
        "ENDDAT",
        "",
    ]
)


def line(x, tail=""):
    return f"LIN {{X {x},Y 0,Z 0,A 0,B 0,C 180}}{tail}"


def long(count=40, tail=" C_DIS"):
    return body("PTP XP1", *(line(x, tail) for x in range(count)), "LIN XP2")


def divided(source, limit, data=DATA):
    """The files that a program becomes when nothing in it changes."""
    program = read(source, data)
    wanted = targets(program, keep=True)
    return in_files("part", program.documents, krl.rewrite(program, wanted), limit), program


def back(written):
    """The files read as one program."""
    return KRL.read(written.documents, CELL, forward, "part")


def executed(documents, name):
    """The motions that an independent interpreter makes of a program and of all that it calls."""
    return run({document.name: document.text for document in documents}, name, 0)


def run(files, name, seed):
    frames = {"BASE_DATA": {**attack.FRAMES, 0: (0,) * 6}, "TOOL_DATA": {**attack.TOOLS, 0: (0,) * 6}}
    data = {k: {n: dict(zip("XYZABC", map(float, v), strict=True)) for n, v in d.items()} for k, d in frames.items()}
    base, tool = CELL.base, CELL.tool
    named = {Path(file).name: text for file, text in files.items()}
    cell = abc(base.X, base.Y, base.Z), abc(tool.X, tool.Y, tool.Z)
    return Controller(named, np.random.default_rng(seed), *cell, data).run(name)


def seen(motions):
    return [
        (m.kind, m.numbers and np.round(m.numbers, 6).tolist(), m.joints, m.base.tolist(), m.speed, m.cdis)
        for m in motions
    ]


@pytest.mark.parametrize("limit", [12, 20, 33])
def test_divided_and_joined_it_makes_the_same_motions(limit):
    written, program = divided(long(), limit)
    names = [document.name for document in written.documents]
    assert names[0] == "partMain.src"
    assert {"part1.src", "part1.dat", "part2.src"} <= set(names)
    sources = [document for document in written.documents if document.name.endswith(".src")]
    assert all(len(document.text.splitlines()) <= limit for document in sources)
    again = back(written)
    np.testing.assert_array_equal(numbers(again), numbers(program))
    np.testing.assert_array_equal(again.motions.kind, program.motions.kind)
    np.testing.assert_array_equal(again.motions.blend, program.motions.blend)
    np.testing.assert_array_equal(again.motions.line, written.output_line)
    one, other = executed(program.documents, "PART"), executed(written.documents, "PARTMAIN")
    assert len(one) == 42
    assert seen(one) == seen(other)


def test_each_line_of_the_body_stands_in_one_of_the_files_as_it_was():
    source = long()
    written, _ = divided(source, 20)
    inside = []
    for document in written.documents:
        if document.name.endswith(".src"):
            lines = document.text.split("\r\n")
            inside += [one for one in lines if not re.match(r"&|DEF |END|;POSTPROC|part\d|$", one)]
    assert inside == [one for one in source.split("\r\n") if not re.match("&|DEF |END|$", one)]


def test_files_are_joined_and_taken_apart_to_the_byte():
    written, _ = divided(long(), 20)
    sources = [document.text for document in written.documents if document.name.endswith(".src")]
    whole = joined(written.documents)
    assert taken_apart(whole.documents[0].text) == sources
    unended = [replace(document, text=document.text.rstrip("\r\n")) for document in written.documents]
    assert taken_apart(joined(unended).documents[0].text) == [text.rstrip("\r\n") for text in sources]


def test_a_program_that_is_short_enough_stays_in_one_file():
    written, program = divided(long(), 1000)
    assert written.documents == program.documents


def test_corrected_targets_and_their_lines():
    program = read(long(), DATA)
    wanted = targets(program, np.full((42, 3), 1e-4), pieces={5: [0.5], 20: [0.25, 0.5]})
    written = in_files("part", program.documents, krl.rewrite(program, wanted), 17)
    again = back(written)
    np.testing.assert_allclose(again.motions.target, wanted.pose, atol=1e-7)
    np.testing.assert_array_equal(again.motions.line, written.output_line)
    done = executed(written.documents, "PARTMAIN")
    np.testing.assert_allclose([m.numbers for m in done], xyzabc_from_pose(wanted.pose), atol=1e-4)


def test_a_program_in_files_is_corrected_in_its_files():
    written, _ = divided(long(), 17)
    program = KRL.read(written.documents, CELL, forward, "partMain")
    assert program.name == "part"
    keep = in_files("part", program.documents, krl.rewrite(program, targets(program, keep=True)), 0)
    assert keep.documents == program.documents
    wanted = targets(program, np.full((42, 3), 1e-4), pieces={7: [0.5]})
    new = in_files("part", program.documents, krl.rewrite(program, wanted), 0)
    assert [document.name for document in new.documents] == [document.name for document in program.documents]
    np.testing.assert_allclose(back(new).motions.target, wanted.pose, atol=1e-7)


def test_cuts_leave_folds_triggers_and_control_structures_whole():
    lines = []
    for x in range(0, 60, 3):
        lines += [
            ";FOLD LIN",
            f"; P{x}",
            line(x),
            ";ENDFOLD",
            "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE",
            "; here",
            line(x + 1),
            "IF $IN[1] THEN",
            "$OUT[2]=TRUE",
            "ENDIF",
            "CONTINUE",
            "$OUT[3]=TRUE",
        ]
    written, program = divided(body(*lines), 23)
    assert len(written.documents) > 8
    for document in written.documents:
        text = document.text
        assert text.count(";FOLD") == text.count(";ENDFOLD")
        assert text.count("IF $IN") == text.count("ENDIF")
        assert not re.search(r"(TRIGGER[^\r\n]*|; here|CONTINUE)\r\nEND\r\n", text)
    np.testing.assert_array_equal(numbers(back(written)), numbers(program))


def test_a_fold_longer_than_a_file_is_told_and_not_cut():
    written, program = divided(body(line(0), ";FOLD X", *(line(x) for x in range(1, 40)), ";ENDFOLD", line(50)), 20)
    assert any("which are not cut" in issue.message for issue in written.issues)
    np.testing.assert_array_equal(numbers(back(written)), numbers(program))


def test_declarations_go_where_they_are_used():
    lines = [line(x) for x in range(20)]
    written, _ = divided(body("DECL INT I", "EXT FOO( )", *lines, "I=3", "$OUT[I]=TRUE", *lines, "LIN XP1"), 16)
    texts = {document.name: document.text for document in written.documents}
    assert all("DECL INT I" in text and "EXT FOO" in text for name, text in texts.items() if name.endswith(".src"))
    assert [name for name, text in texts.items() if "XP1=" in text] == [
        max(n for n in texts if re.search(r"\d\.dat", n))
    ]
    assert "HEIGHT" in texts["partMain.dat"]
    assert "DEPTH" in texts["partMain.dat"]


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (["I=1", *map(line, range(30)), "$OUT[I]=TRUE"], "I is a variable of it and used in several"),
        (["DEPTH=3", *map(line, range(30)), "HEIGHT=DEPTH"], "DEPTH is a variable of it"),
        (
            ["INTERRUPT DECL 3 WHEN $IN[1] DO DEPTH=DEPTH+1", *map(line, range(30)), "HEIGHT=DEPTH"],
            "DEPTH is a variable of it",
        ),
        (
            ["TRIGGER WHEN DISTANCE=0 DELAY=0 DO DEPTH=3", *map(line, range(30)), "HEIGHT=DEPTH"],
            "DEPTH is a variable of it",
        ),
        ([*map(line, range(30)), "RETURN"], "RETURN leads to another place"),
        ([*map(line, range(30)), "INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO FOO( )"], "not GLOBAL"),
        ([*map(line, range(30)), "END", "DEF other( )"], "routines of its own"),
        ([";FOLD A", *map(line, range(30)), ";ENDFOLD"], "which are not cut"),
    ],
)
def test_what_would_mean_something_else_in_several_files_is_refused(lines, says):
    written = Written(read(body(line(1)), DATA).documents[:1], np.zeros(0, dtype=np.int64), "krl")
    written = replace(
        written,
        documents=(replace(written.documents[0], text=body("DECL INT I", *lines)), decode("part.dat", DATA.encode())),
    )
    if "not cut" in says:
        assert says in in_files("part", (), written, 12).issues[0].message
        return
    with pytest.raises(ProgramError, match=says) as refused:
        in_files("part", (), written, 12)
    assert "lines_per_file = 0" in str(refused.value)


def test_a_missing_part_and_a_fault_in_a_part_name_the_file():
    written, _ = divided(long(), 17)
    with pytest.raises(ProgramError, match=r"partMain\.src:\d+: part2\.src is not there"):
        back(replace(written, documents=tuple(d for d in written.documents if d.name != "part2.src")))
    wrong = [replace(d, text=d.text.replace("LIN {X 9,", "LIN {X nine,")) for d in written.documents]
    place = next((d.name, d.text[: d.text.index("nine")].count("\n") + 1) for d in wrong if "nine" in d.text)
    with pytest.raises(ProgramError) as fault:
        back(replace(written, documents=tuple(wrong)))
    assert (fault.value.file, fault.value.line) == place


def test_names_are_valid_and_used_for_nothing_else():
    program = read(body(*map(line, range(60)), "part3( )"), DATA)
    written = in_files("a" * 24, program.documents, krl.rewrite(program, targets(program, keep=True)), 20)
    assert {len(d.name) for d in written.documents if d.name.endswith(".src")} <= set(range(20, 29))
    written = in_files("part", program.documents, krl.rewrite(program, targets(program, keep=True)), 20)
    assert written.documents[0].name == "part_2Main.src"


def test_renamed_files_call_each_other():
    written, program = divided(long(), 17)
    new = krl.renamed(written.documents, "job")
    assert {d.name for d in new} >= {"jobMain.src", "job1.src", "job1.dat"}
    assert not re.search(r"part\d|partMain", "".join(d.text for d in new))
    assert seen(executed(new, "JOBMAIN")) == seen(executed(program.documents, "PART"))


def test_a_new_program_is_divided():
    program = milling()
    cell = changed(CELL, output=changed(CELL.output, lines_per_file=10))
    wanted = emitted_targets(program, pieces=(1, 2))
    written = KRL.writer.write(program, wanted, None, cell, None)
    one = krl.emit(program, wanted, cell)
    assert len(written.documents) > 2
    again = KRL.read(written.documents, CELL, forward, "part")
    whole = KRL.read(one.documents, CELL, forward, "part")
    np.testing.assert_array_equal(numbers(again), numbers(whole))
    np.testing.assert_array_equal(again.motions.feed, whole.motions.feed)
    np.testing.assert_array_equal(again.motions.blend, whole.motions.blend)


@pytest.mark.parametrize("seed", range(60))
def test_random_programs_make_the_same_motions_in_files(seed, tmp_path):
    """What the independent interpreter makes of them, whatever they hold; or they are refused."""
    files = Generator(np.random.default_rng(seed)).programs()
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(text.encode())
    documents = tuple(replace(decode(n, files[n].encode()), folder=str(tmp_path)) for n in ("part.src", "part.dat"))
    whole = Written(documents, np.zeros(0, dtype=np.int64), "krl")
    count = len(files["part.src"].splitlines())
    try:
        krl.read_program(documents, attack.cell(tmp_path), forward, "part")
        written = in_files("part", (), whole, max(count // 2, 14))
    except PostprocError:
        return
    others = {name: text for name, text in files.items() if name not in ("part.src", "part.dat")}
    for chance in range(3):
        try:
            one = run(files, "PART", chance)
        except Invalid:
            continue
        new = others | {document.name: document.text for document in written.documents}
        assert seen(run(new, written.documents[0].name.split(".")[0].upper(), chance)) == seen(one)
