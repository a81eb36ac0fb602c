"""Programs in several files: divided and joined they make the same motions, whoever executes them."""

import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from msgspec.structs import replace as changed

from postproc.dialects import krl
from postproc.dialects.krl.dialect import KRL
from postproc.dialects.krl.language.parts import joined_program, separated_texts
from postproc.dialects.krl.write import split_files
from postproc.dialects.text import decode
from postproc.errors import PostprocError, ProgramError
from postproc.frames import xyzabc_from_pose
from postproc.program import WrittenProgram
from tests.attack import krl as attack
from tests.attack.krl_generator import Generator
from tests.attack.krl_interpreter import Controller, Invalid
from tests.dialects.krl_programs import CELL, body, forward, numbers, read, targets
from tests.dialects.test_krl_emit import milling
from tests.dialects.test_krl_emit import targets as emitted_targets
from tests.oracle.arm import abc

TWO_POINTS_DAT = "\r\n".join(
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


def divided(source, limit, data=TWO_POINTS_DAT):
    """The files that a program becomes when nothing in it changes."""
    program = read(source, data)
    wanted = targets(program, keep=True)
    return split_files("part", program.documents, krl.rewrite(program, wanted), limit), program


def back(written):
    """The files read as one program."""
    return KRL.read(written.documents, CELL, forward, "part")


def executed(documents, name):
    """The motions that an independent interpreter makes of a program and of all that it calls."""
    return execute({document.name: document.text for document in documents}, name, 0)


def execute(files, name, seed):
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


def test_a_program_with_parameters_is_not_divided():
    with pytest.raises(ProgramError, match="its DEF has parameters, which are not known in other files"):
        divided(long().replace("part( )", "part(DEPTH_NO:IN)"), 20)


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
    whole = joined_program(written.documents)
    assert separated_texts(whole.documents[0].text) == sources
    unended = [replace(document, text=document.text.rstrip("\r\n")) for document in written.documents]
    assert separated_texts(joined_program(unended).documents[0].text) == [text.rstrip("\r\n") for text in sources]


def test_a_program_that_is_short_enough_stays_in_one_file():
    written, program = divided(long(), 1000)
    assert written.documents == program.documents


def test_corrected_targets_and_their_lines():
    program = read(long(), TWO_POINTS_DAT)
    wanted = targets(program, np.full((42, 3), 1e-4), pieces={5: [0.5], 20: [0.25, 0.5]})
    written = split_files("part", program.documents, krl.rewrite(program, wanted), 17)
    again = back(written)
    np.testing.assert_allclose(again.motions.target, wanted.pose, atol=1e-7)
    np.testing.assert_array_equal(again.motions.line, written.output_line)
    done = executed(written.documents, "PARTMAIN")
    np.testing.assert_allclose([m.numbers for m in done], xyzabc_from_pose(wanted.pose), atol=1e-4)


def test_a_program_in_files_is_corrected_in_its_files():
    written, _ = divided(long(), 17)
    program = KRL.read(written.documents, CELL, forward, "partMain")
    assert program.name == "part"
    keep = split_files("part", program.documents, krl.rewrite(program, targets(program, keep=True)), 0)
    assert keep.documents == program.documents
    wanted = targets(program, np.full((42, 3), 1e-4), pieces={7: [0.5]})
    new = split_files("part", program.documents, krl.rewrite(program, wanted), 0)
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


OWN = """DEF PART( )
  DECL INT I, K
  DECL E6POS Q
  INTERRUPT DECL 3 WHEN $IN[1]==TRUE DO STOPPED( )
  BAS(#INITMOV,0)
  I=1
  LIN XP1
  cut(I, 2) ; cut it
  FOR K=1 TO 2
    LIN P[K] C_DIS
  ENDFOR
  LIN {X 4,Y 0,Z 0,A 0,B 0,C 180} C_DIS
  Q=XP2
  Q.Z=Depth(I)
  LIN Q
  TRIGGER WHEN DISTANCE=0 DELAY=0 DO STOPPED( )
  LIN {X 6,Y I,Z 0,A 0,B 0,C 180} C_DIS
  Cut (I, K)
  COUNT=COUNT+1
  LIN {X COUNT,Y 0,Z 0,A 0,B 0,C 180}
  Second( )
  LIN {X COUNT,Y I,Z 5,A 0,B 0,C 180}
END

; cuts
DEF CUT(N:OUT, K:IN)
  DECL INT N, K
  N=N+K
  LIN_REL {Z 1}
END
DEFFCT REAL Depth(N:IN)
  DECL INT N
  $OUT[N]=TRUE
  RETURN (N*1.5)
ENDFCT
DEF STOPPED( )
  $OUT[9]=COUNT>3
END
DEF SECOND( )
  DECL INT I
  I=7
  COUNT=COUNT+I
  LIN P[1]
END
"""
OWN_DATA = """DEFDAT PART
  DECL E6POS XP1={X 0,Y 0,Z 50,A 0,B 0,C 180}
  DECL E6POS XP2={X 10,Y 0,Z 50,A 0,B 0,C 180}
  DECL E6POS P[2]
  P[1]={X 1,Y 2,Z 3,A 0,B 0,C 180}
  P[2]={X 2,Y 2,Z 3,A 0,B 0,C 180}
  INT COUNT=1
ENDDAT
"""


def in_some_files(limit=13, name="part", source=OWN, data=OWN_DATA):
    documents = (decode("part.src", source.encode()), decode("part.dat", data.encode()))
    return split_files(name, (), WrittenProgram(documents, np.zeros(0, dtype=np.int64), "krl"), limit)


@pytest.mark.parametrize("limit", [13, 16, 20])
def test_a_program_with_routines_variables_and_interrupts_of_its_own_moves_as_before_in_files(limit):
    files = {"part.src": OWN, "part.dat": OWN_DATA}
    one = seen(execute(files, "PART", 0))
    written = in_some_files(limit)
    assert len(one) == 11
    for chance in range(5):
        two = execute({document.name: document.text for document in written.documents}, "PARTMAIN", chance)
        assert seen(two) == seen(execute(files, "PART", chance))
    again = back(written)
    np.testing.assert_array_equal(numbers(again), numbers(read(OWN, OWN_DATA)))
    sources = [document.text for document in written.documents if document.name.endswith(".src")]
    assert all(text.count("\n") <= limit for text in sources)
    assert separated_texts(joined_program(written.documents).documents[0].text) == sources


def test_what_several_files_use_is_global_under_names_that_are_the_programs_own():
    written = in_some_files()
    texts = {document.name: document.text for document in written.documents}
    whole = "".join(texts.values())
    assert texts["partMain.dat"].startswith("DEFDAT partMain PUBLIC\n")
    assert re.findall("DECL GLOBAL .*?(?=[\r\n])", texts["partMain.dat"]) == [
        "DECL GLOBAL INT part_COUNT=1",
        "DECL GLOBAL INT part_I, part_K",
        "DECL GLOBAL E6POS part_Q",
    ]
    assert "DECL INT I\n  I=7\n  part_COUNT=part_COUNT+I" in whole  # hidden in that routine
    assert sorted(re.findall(r"GLOBAL DEF\w* ?(?:REAL )?(\w+)", whole)) == [
        "part_Depth",
        "part_STOPPED",
        "part_Second",
        "part_cut",
    ]
    assert "DO part_STOPPED( )" in texts["partMain.src"]
    assert "; cut it" in texts["partMain.src"] + texts["part1.src"]
    assert whole.count("DECL E6POS P[2]") == 2  # each file that uses it has its own
    [told] = [issue for issue in written.issues if issue.kind == "global-routines"]
    assert "CUT is part_cut" in told.message


def test_members_of_a_structure_keep_their_names_where_a_variable_of_the_name_becomes_global():
    structure = "STRUC PLACE INT COUNT,REAL R\n  DECL PLACE HERE\n  HERE={COUNT 2,R 1.5}\n  LIN P[HERE.COUNT]"
    source = OWN.replace("DECL INT I\n  I=7", f"DECL INT I\n  {structure}\n  I=7")
    written = in_some_files(20, source=source)
    assert structure in "".join(document.text for document in written.documents)
    np.testing.assert_array_equal(numbers(back(written)), numbers(read(source, OWN_DATA)))


def test_routines_that_were_global_before_are_named_since_the_controller_may_have_them_twice():
    def warnings(written):
        return [i.message for i in written.issues if (i.kind, i.level) == ("global-routines", "warning")]

    [message] = warnings(in_some_files(source=OWN.replace("DEF SECOND( )", "GLOBAL DEF SECOND( )")))
    assert "(SECOND), which they replace: remove part.src" in message
    assert warnings(in_some_files()) == []


def test_long_names_stay_valid_and_different():
    name = "finishing_cavity_left"
    written = in_some_files(name=name)
    found = re.findall(r"GLOBAL (?:DEF\w*|INT)(?: REAL)? (\w+)", "".join(d.text for d in written.documents))
    assert len(found) == len({one.upper() for one in found}) >= 5
    assert all(len(one) <= 24 and one.startswith(name[:20]) for one in found)
    done = execute({document.name: document.text for document in written.documents}, f"{name[:20]}Main".upper(), 0)
    assert seen(done) == seen(execute({"part.src": OWN, "part.dat": OWN_DATA}, "PART", 0))


def test_names_of_other_programs_are_not_taken():
    documents = (decode("part.src", OWN.encode()), decode("part.dat", OWN_DATA.encode()))
    whole = WrittenProgram(documents, np.zeros(0, dtype=np.int64), "krl")
    text = "".join(d.text for d in split_files("part", (), whole, 13, {"PART_CUT"}).documents)
    assert "GLOBAL DEF part_cut_2(" in text


def test_a_routine_that_other_programs_call_keeps_its_name():
    written = in_some_files(source=OWN.replace("DEF CUT", "GLOBAL DEF CUT"))
    assert any("\nGLOBAL DEF CUT(" in document.text for document in written.documents)


def test_a_program_in_files_with_routines_of_its_own_is_corrected_in_its_files():
    written = in_some_files()
    program = KRL.read(written.documents, CELL, forward, "partMain")
    keep = split_files("part", program.documents, krl.rewrite(program, targets(program, keep=True)), 0)
    assert keep.documents == program.documents
    wanted = targets(program, np.arange(36.0).reshape(12, 3) * 1e-4, pieces={7: [0.5]})
    new = split_files("part", program.documents, krl.rewrite(program, wanted), 0)
    names = [[document.name for document in one.documents if document.name.endswith(".src")] for one in (new, written)]
    assert names[0] == names[1]
    np.testing.assert_allclose(back(new).motions.target, wanted.pose, atol=1e-7)
    assert any("GLOBAL DEF part_cut_2(" in document.text for document in new.documents)  # a copy for another call
    done = execute({document.name: document.text for document in new.documents}, "PARTMAIN", 0)
    np.testing.assert_allclose([m.numbers[:3] for m in done], wanted.pose[:, :3, 3] * 1e3, atol=2e-4)


def test_targets_in_routines_of_its_own_are_numbered_from_file_to_file():
    program = read(OWN, OWN_DATA)
    wanted = targets(program, np.full((12, 3), 1e-4))
    written = split_files("part", program.documents, krl.rewrite(program, wanted), 13)
    again = back(written)
    np.testing.assert_allclose(again.motions.target, wanted.pose, atol=1e-7)
    np.testing.assert_array_equal(again.motions.line, written.output_line)


def test_a_main_routine_that_only_calls_is_divided_too():
    calls = "".join(f"op{n % 3}( )\n" for n in range(30))
    ops = "".join(f"DEF op{n}( )\nLIN {{X {n},Y 0,Z 0,A 0,B 0,C 180}}\nEND\n" for n in range(3))
    source = f"DEF part( )\nDECL INT I\nBAS(#INITMOV,0)\n{calls}END\n{ops}"
    written = in_some_files(source=source, data="DEFDAT part\nENDDAT\n")
    texts = [document.text for document in written.documents if document.name.endswith(".src")]
    assert "part_op" not in texts[0]
    assert len(texts) > 5
    assert seen(execute({d.name: d.text for d in written.documents}, "PARTMAIN", 0)) == seen(
        execute({"part.src": source}, "PART", 0)
    )


def test_a_routine_longer_than_a_file_is_told_and_not_cut():
    source = OWN.replace("  I=7\n", "  I=7\n" * 20)
    told = [issue.message for issue in in_some_files(source=source).issues if issue.kind == "long-file"]
    assert any(re.match(r"A routine of the program, at line \d+, has 2\d lines and is not cut", text) for text in told)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ([*map(line, range(30)), "RETURN"], "RETURN leads to another place"),
        ([*map(line, range(30)), "INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO FOO( )"], "not GLOBAL"),
        ([*map(line, range(30)), "END", "DEF other( )", "RESUME"], "RESUME would break off the whole file"),
        (["S.A=1", *map(line, range(30)), "S.A=2"], "its type KIND is not GLOBAL"),
        ([*map(line, range(30)), "END", "DEF other(T)", "KIND T"], "what OTHER takes or gives"),
        ([";FOLD A", *map(line, range(30)), ";ENDFOLD"], "which are not cut"),
    ],
)
def test_what_would_mean_something_else_in_several_files_is_refused(lines, says):
    data = TWO_POINTS_DAT.replace("ENDDAT", "STRUC KIND INT A\r\nDECL KIND S={A 1}\r\nENDDAT")
    documents = decode("part.src", body("DECL INT I", *lines).encode()), decode("part.dat", data.encode())
    written = WrittenProgram(documents, np.zeros(0, dtype=np.int64), "krl")
    if "not cut" in says:
        assert says in split_files("part", (), written, 12).issues[0].message
        return
    with pytest.raises(ProgramError, match=says) as refused:
        split_files("part", (), written, 12)
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
    program = read(body(*map(line, range(60)), "part3( )"), TWO_POINTS_DAT)
    written = split_files("a" * 24, program.documents, krl.rewrite(program, targets(program, keep=True)), 20)
    assert {len(d.name) for d in written.documents if d.name.endswith(".src")} <= set(range(20, 29))
    written = split_files("part", program.documents, krl.rewrite(program, targets(program, keep=True)), 20)
    assert written.documents[0].name == "part_2Main.src"


def test_renamed_files_call_each_other():
    written, program = divided(long(), 17)
    new = krl.rename(written.documents, "job")
    assert {d.name for d in new} >= {"jobMain.src", "job1.src", "job1.dat"}
    assert not re.search(r"part\d|partMain", "".join(d.text for d in new))
    assert seen(executed(new, "JOBMAIN")) == seen(executed(program.documents, "PART"))


def test_renamed_files_with_routines_of_their_own_have_global_names_of_the_new_name():
    written = in_some_files()
    new = krl.rename(written.documents, "a_much_longer_name_than_that")
    assert not re.search(r"(?i)\bpart(\d|_|Main)", "".join(document.text for document in new))
    name = new[0].name.removesuffix(".src")
    assert name == "a_much_longer_name_tMain"
    assert seen(execute({d.name: d.text for d in new}, name.upper(), 0)) == seen(
        execute({"part.src": OWN, "part.dat": OWN_DATA}, "PART", 0)
    )


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
    whole = WrittenProgram(documents, np.zeros(0, dtype=np.int64), "krl")
    count = len(files["part.src"].splitlines())
    try:
        krl.read_program(documents, attack.cell(tmp_path), forward, "part")
        written = split_files("part", (), whole, max(count // 3, 12))
    except PostprocError:
        return
    others = {name: text for name, text in files.items() if name not in ("part.src", "part.dat")}
    for chance in range(3):
        try:
            one = execute(files, "PART", chance)
        except Invalid:
            continue
        new = others | {document.name: document.text for document in written.documents}
        assert seen(execute(new, written.documents[0].name.split(".")[0].upper(), chance)) == seen(one)


def test_data_of_the_controller_in_a_data_list_of_the_program_keep_their_name(tmp_path):
    """Parts share BASE_DATA, whoever states it: it is neither renamed nor repeated."""
    point = "LIN {{X {0},Y {0},Z 30,A 10,B 20,C 170}} C_DIS"
    lines = ["BAS(#BASE,7)", *(point.format(n) for n in range(9)), "BASE_DATA[2].X=0.8", "$BASE=BASE_DATA[2]", "SUB()"]
    lines += [point.format(n) for n in range(9)]
    text = "\n".join(
        ["DEF part()", "BAS(#INITMOV,0)", *lines, "END", "DEF SUB()", "$BASE=BASE_DATA[2]", point.format(3)]
    )
    files = {
        "part.src": f"{text}\nEND\n",
        "part.dat": "DEFDAT part\nBASE_DATA[7]={X 11,Y 2,Z 3,A 40,B 5,C 6}\nENDDAT\n",
    }
    program = attack.read_job(files, tmp_path)
    cell = attack.cell(tmp_path)
    written = attack.divided(program, attack.moved(program, np.random.default_rng(0)), 12, cell)
    assert len(written.documents) > 3
    texts = {document.name: document.text for document in written.documents}
    assert not any("part_BASE_DATA" in text for text in texts.values())
    assert [name for name, text in texts.items() if "BASE_DATA[7]" in text] == ["partMain.dat"]
    again = KRL.read(written.documents, cell, forward, "partMain")
    assert len(again.motions) >= len(program.motions)
    np.testing.assert_array_equal(np.unique(again.bases, axis=0), np.unique(program.bases, axis=0))


def test_the_line_of_an_error_of_a_new_program_is_said_to_be_that_of_the_written_one():
    with pytest.raises(ProgramError) as caught:
        in_some_files(source="\n".join(["DEF part( )", *["PTP XP1"] * 20, "GOTO AWAY", "AWAY:", "END", ""]))
    assert caught.value.line is None
    assert caught.value.text == "GOTO AWAY"
    assert caught.value.problem.endswith("leads to another place of it (line 22 of the written program)")
