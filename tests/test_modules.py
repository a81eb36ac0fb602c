"""Programs larger than the memory of the controller as modules: each is a program of its own, and they join to one."""

from __future__ import annotations

import csv
import json
import re
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import cell as cells
from postproc.correction import process
from postproc.dialects.krl import write
from postproc.dialects.krl.write import modules
from postproc.program import SWITCHED_OFF, EventKind
from tests import commands
from tests.attack.krl_interpreter import Controller
from tests.corrections import read_files
from tests.kr270 import FOLDER, ROBOT
from tests.oracle import krl_grammar
from tests.oracle.arm import Arm, abc
from tests.places import CELL_FILE

LIMIT = 8_500
MORE = """
[machine]
home = [0, -90, 90, 0, 30, 0]
clearance_Z = 200.0

[tools.1]
Z = 350.0

[tools.2]
Z = 400.0

[work_offsets.G55]
X = 100.0
Z = -20.0
C = 30.0

[m_codes]
M51 = ["$OUT[7]=TRUE", "$OV_PRO=80"]
"""
run = partial(commands.run, cell="cell.toml")


@pytest.fixture(autouse=True)
def input_files(work_folder):
    cell()
    Path("job.nc").write_text(job_with_tools())


def cell(limit: float = LIMIT, *, divided: bool = True, **lines: str) -> None:
    text = CELL_FILE.read_text().replace("[output]", f"[output]\nprogram_memory_MB = {limit / 1e6}")
    text = text.replace("[output]", "[output]\ndivide_into_modules = true") if divided else text
    for name, value in {"approximation_mm": "0.02", **lines}.items():  # corners of 90° are approximated
        text = re.sub(rf"^{name} = .*$", f"{name} = {value}", text, flags=re.M)
    Path("cell.toml").write_text(text + MORE)


def operation(number: int, moves: int = 30, force: str = "(FORCE FX=100 FY=-150 FZ=80)\n") -> str:
    x = 10 * number
    cuts = "".join(f"G1 X{x + 0.3 * n:.1f} Y{n * n % 7 * 0.3:.1f}\n" for n in range(moves))
    arc = f"G1 X{x} Y0\nG3 X{x + 4} Y4 R4\nG2 X{x} Y0 I-4 J0\n"
    return f"(OPERATION {number})\nG0 X{x} Y0\nZ5\n{force}G1 Z-1 F300\nF900\n{cuts}{arc}G0 Z50\n"


def job_with_tools(count: int = 7, force: str = "(FORCE FX=100 FY=-150 FZ=80)\n") -> str:
    """Tools, work offsets, a home position, and the spindle at two speeds, between operations."""
    between = {
        2: "M9\nM5\nT2 M6\nS9000 M3\nG4 P2.5\nG0 X20 Y0\n",
        4: "G55\nG0 X0 Y0 Z60\nM51\n",
        5: "G28 Z60\nG0 X50 Y0\nZ50\n",
    }
    ops = "".join(between.get(number, "") + operation(number, force=force) for number in range(count))
    return f"G21 G90 G17 G54\nT1 M6\nS12000 M3\nG4 P1.5\nM8\nG0 X0 Y0 Z50\n{ops}M9\nM5\nM30\n"


def sources(where: str = "out") -> list[Path]:
    return sorted(Path(where).glob("*.src"), key=lambda path: (len(path.stem), path.stem))


def executed(path: Path):
    """The motions of a program, executed by the controller of the tests; and its outputs when it ends."""
    text = re.sub(r"^\$(ANOUT|OV_PRO).*$", "", path.read_text(), flags=re.M)
    unit = cells.load(Path("cell.toml"))
    frames = abc(unit.base.X, unit.base.Y, unit.base.Z), abc(unit.tool.X, unit.tool.Y, unit.tool.Z)
    return Controller({path.name.upper(): text}, np.random.default_rng(1), *frames, {}).run(path.stem.upper())


def seen(motions):
    return [
        (m.kind, m.numbers, m.via, m.joints, m.base.tolist(), m.tool.tolist(), m.kind == "PTP" or m.speed, m.cdis)
        for m in motions
    ]


def converted(*options: str) -> list[Path]:
    """Return the modules, and write the program in one piece into `whole`."""
    run("convert", "job.nc", "-o", "out", *options)
    cell(divided=False)
    run("convert", "job.nc", "-o", "whole", *options)
    cell()
    return sources()


def test_executed_one_after_another_they_make_the_motions_of_the_program_in_one_piece():
    found = converted()
    assert len(found) >= 3
    whole, joined = seen(executed(Path("whole/job.src"))), []
    arm = Arm.load(FOLDER)
    last = None
    for path in found:
        assert path.stat().st_size <= LIMIT
        krl_grammar.check(path.name, path.read_text())
        motions = executed(path)
        if last is not None:  # it begins where the one before ends
            begin = np.linalg.inv(last.base) @ arm.nominal_tcp(np.radians(motions[0].joints), last.tool)
            assert np.abs(begin - abc(*last.numbers)).max() < 5e-6
            assert last.cdis is None
        joined += seen(motions)[last is not None :]
        last = motions[-1]
    assert len(joined) == len(whole) > 250
    different = [(one, other) for one, other in zip(joined, whole, strict=True) if one != other]
    assert all(one[:-1] == other[:-1] and one[-1] is None for one, other in different)  # exact stops
    assert len(different) <= len(found) - 1


def test_each_is_a_program_of_its_own():
    found = [path.read_text().splitlines() for path in converted()]
    for number, lines in enumerate(found, 1):
        assert f"DEF job_{number}( )" in lines
        assert lines[-1] == "END"
        place = lines.index(next(line for line in lines if line.startswith("PTP {A1 ")))
        names = {line.split("=")[0] for line in lines[:place] if line.startswith("$")}
        assert {"$BASE", "$TOOL", "$APO.CDIS"} | ({"$VEL.CP"} if number > 1 else set()) <= names
        assert "    BAS (#INITMOV,0 )" in lines[:place]
    count = len(found)
    assert f"; module 1 of {count}, next is job_2" in found[0]
    assert f"; module 2 of {count}, run after job_1, next is job_3" in found[1]
    assert f"; module {count} of {count}, run after job_{count - 1}" in found[-1]
    behind = next(n for n, lines in enumerate(found) if "$OV_PRO=80" in lines)
    assert [lines.count("$OV_PRO=80") for lines in found[behind:]] == [1] * (count - behind)  # a system variable
    assert count - behind > 1
    assert sum(lines.count("$OUT[7]=TRUE") for lines in found) == 1  # an output keeps its state


def test_spindle_and_coolant_are_off_between_modules():
    found = [path.read_text() for path in converted()]
    for text in found:
        for output in ("$OUT[1]", "$OUT[2]"):
            states = re.findall(rf"^{re.escape(output)}=(TRUE|FALSE)", text, re.M)
            assert not states or states[-1] == "FALSE"
    both = r"\nPTP \{.*\}\nWAIT SEC 0\n\$ANOUT\[1\]=12000/24000.0\n\$OUT\[1\]=TRUE\nWAIT SEC 3.0\n"
    assert re.search(both + r"WAIT SEC 1.5\nWAIT SEC 0\n\$OUT\[2\]=TRUE\n; OPERATION", found[1])  # with its wait
    assert re.search(both.replace("12000", "9000") + r"WAIT SEC 2.5\n; OPERATION", found[3])  # the second spindle speed
    assert all(text.endswith("}\nWAIT SEC 0\n$OUT[1]=FALSE\nEND\n") for text in found[2:-1])
    assert found[0].endswith("}\nWAIT SEC 0\n$OUT[1]=FALSE\n$OUT[2]=FALSE\nEND\n")


def test_each_kind_of_event_is_switched_off_or_leaves_nothing_on():
    """A new kind that is in neither would be left on between modules."""
    switching = SWITCHED_OFF.keys() | set(SWITCHED_OFF.values())
    assert set(get_args(EventKind)) - switching == {"tool_change", "dwell", "stop", "m_code", "comment"}


def test_what_the_program_switches_where_a_module_begins_is_not_switched_on_before():
    Path("job.nc").write_text(job_with_tools(3))
    third = converted()[2].read_text()
    begin = third.index("PTP {A1")
    assert third.index("$OUT[1]=FALSE", begin) < third.index("HALT", begin) < third.index("$OUT[1]=TRUE", begin)


def test_without_lines_for_the_spindle_nothing_is_switched():
    cell(spindle_on="[]", spindle_off="[]")
    run("convert", "job.nc", "-o", "out")
    begin, text = sources()[1].read_text().split("; OPERATION", 1)
    assert begin.endswith(
        "}\n; spindle_on 12000: no lines for it in the cell\nWAIT SEC 1.5\nWAIT SEC 0\n$OUT[2]=TRUE\n"
    )
    assert "$OUT[1]" not in begin + text


def test_frames_and_speed_are_set_again_after_lines_that_call_a_program():
    cell(spindle_on='["SPINDLE({S})"]')
    run("convert", "job.nc", "-o", "out")
    begin, _ = sources()[1].read_text().split("; OPERATION", 1)
    before, _, behind = re.split(r"(PTP \{A1.*\n)", begin)
    assert "WAIT SEC 0\nSPINDLE(12000)\n" in behind
    again = [line for line in behind.splitlines() if line.startswith(("$BASE", "$TOOL", "$APO", "$VEL"))]
    assert again == [line for line in before.splitlines() if line.startswith("$")]
    assert len(again) == 4


@pytest.mark.parametrize(("key", "what", "line"), [("spindle_off", "spindle", 3), ("coolant_off", "coolant", 5)])
def test_a_spindle_that_nothing_switches_off_is_an_error(key, what, line):
    cell(**{key: "[]"})
    told = run("convert", "job.nc", "-o", "out", code=1).stderr
    assert f"job.nc:{line}: a module would end with the {what} that this line switches on" in told
    assert f"Give {key} in [gcode] of the cell." in told
    assert not Path("out").exists()


@pytest.mark.parametrize("statement", ["INTERRUPT ON 5", "anout on anout1=0.5*$vel_act+0"])
def test_a_statement_that_ends_with_the_program_is_an_error(statement):
    Path("cell.toml").write_text(Path("cell.toml").read_text().replace("$OV_PRO=80", statement))
    told = run("convert", "job.nc", "-o", "out", code=1).stderr
    line = Path("job.nc").read_text().splitlines().index("M51") + 1
    assert f"job.nc:{line}: the lines of the cell for this block have an effect that ends with each module" in told


def test_a_program_that_fits_is_written_as_before():
    cell(divided=False, limit=4e6)
    run("convert", "job.nc", "-o", "whole")
    size = Path("whole/job.src").stat().st_size
    cell(size)
    run("convert", "job.nc", "-o", "out")
    assert sources() == [Path("out/job.src")]
    lines = [Path(name, "job.src").read_text().splitlines() for name in ("whole", "out")]
    different = [(one, other) for one, other in zip(*lines, strict=True) if one != other]
    assert [one.split()[0] for one, _ in different] == [";POSTPROC"]  # the sum of the cell
    report = json.loads(Path("out/job.report.json").read_text())
    assert "modules" not in report


def test_an_operation_that_is_too_large_is_refused_with_line_and_size():
    text = job_with_tools(2).replace("M9\nM5\nM30\n", "") + operation(2, 200) + "M30\n"
    Path("job.nc").write_text(text)
    told = run("convert", "job.nc", "-o", "out", code=1).stderr
    begin, end = (text[: text.rindex(block)].count("\n") + 1 for block in ("G0 X20 Y0", "G0 Z50"))
    found = re.search(r"job.nc:(\d+): the moves from here to line (\d+) alone need a module of (\S+) MB", told)
    assert (int(found[1]), int(found[2])) == (begin, end)
    assert "more than program_memory_MB = 0.0085 of [output]" in told
    assert "above everything that the program cuts" in told
    assert not Path("out").exists()
    cell(1e6 * float(found[3]) + 1000)
    run("convert", "job.nc", "-o", "out")
    assert float(found[3]) * 1e6 - 4000 < sources()[-1].stat().st_size < float(found[3]) * 1e6


def test_report_page_and_terminal_list_the_modules_in_order():
    done = run("convert", "job.nc", "-o", "out")
    report = json.loads(Path("out/job.report.json").read_text())
    names = [path.name for path in sources()]
    assert [each["name"] for each in report["modules"]] == names
    assert [each["size_bytes"] for each in report["modules"]] == [path.stat().st_size for path in sources()]
    assert report["size_bytes"] == sum(path.stat().st_size for path in sources())
    begins = [each["source_line"] for each in report["modules"]]
    text = Path("job.nc").read_text().splitlines()
    blocks = ["G0 X0 Y0 Z50", "G0 X10 Y0", "T2 M6", "G0 X30 Y0", "G0 X0 Y0 Z60", "Z50", "G0 X60 Y0"]
    assert [text[line - 1] for line in begins] == blocks
    assert {each["name"] for each in report["files"]} >= set(names)
    sizes = r", ".join(rf"{name} \(0\.0\d+ MB\)" for name in names)
    listed = rf"is written as {len(names)} modules\. Load and run them one after another in this order, .*: {sizes}"
    assert re.search(listed, done.output.replace("\n", " "))
    assert re.search(listed, Path("out/job.report.html").read_text())
    assert "program-memory" not in {issue["kind"] for issue in report["issues"]}


def rows(name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(Path(name).read_text().splitlines()))


def test_lines_of_the_targets_count_on_from_module_to_module():
    converted()
    lines = [line for path in sources() for line in path.read_text().splitlines()]
    found = rows("out/job.targets.csv")
    assert len(found) > 250
    for row in found:
        line = lines[int(row["output_line"]) - 1]
        assert line.startswith(("LIN", "CIRC", "PTP {X"))
        assert f"{{X {float(row['X_cmd']):.10g}," in line
    whole = rows("whole/job.targets.csv")
    assert [{**row, "output_line": ""} for row in found] == [{**row, "output_line": ""} for row in whole]


@pytest.mark.parametrize("in_file", [False, True])
def test_predict_finds_the_forces_of_each_module(in_file):
    options = []
    if in_file:
        text = job_with_tools(force="")
        cuts = [n for n, line in enumerate(text.splitlines(), 1) if line.startswith(("G1 ", "G2 ", "G3 "))]
        Path("job.nc").write_text(text)
        table = "".join(f"{line},{100 + 40 * (n % 3)},-150,80,BASE\n" for n, line in enumerate(cuts))
        Path("job.csv").write_text(f"line,Fx,Fy,Fz,frame\n{table}")
        options = ["--forces", "job.csv"]
    run("convert", "job.nc", "-o", "out", *options)
    wanted = [(row["Fx"], row["Fy"], row["Fz"]) for row in rows("out/job.targets.csv")]
    found = []
    for path in sources():
        given = ["--forces", path.with_suffix(".forces.csv")] if in_file else []
        done = run("predict", path, "-o", "held", *given, "--json")
        (content,) = json.loads(done.stdout)["programs"]
        assert content["provenance"]["state"] == "intact"
        own = {row["source_line"]: row for row in rows(f"held/{path.stem}.predict.targets.csv")}
        found += [(row["Fx"], row["Fy"], row["Fz"]) for row in own.values()]
    assert found == wanted
    assert len(set(wanted)) == (4 if in_file else 2)


def test_a_module_is_neither_corrected_again_nor_compared():
    run("convert", "job.nc", "-o", "out")
    assert "was corrected by postproc" in run("convert", "out/job_2.src", "-o", "again", code=1).stderr
    for pair in (("job.nc", "out/job_2.src"), ("out/job_1.src", "whole.src")):
        Path("whole.src").write_text("DEF whole()\nPTP {A1 9,A2 -70,A3 110,A4 0,A5 50,A6 20}\nEND\n")
        told = run("compare", *pair, "-o", "again", code=1).stderr
        assert re.search(r"job_\d.src:5: this is module \d of \d, not a whole program", told)
        assert "divide_into_modules = false" in told


def test_modules_of_an_earlier_run_go():
    run("convert", "job.nc", "-o", "out")
    before = sources()
    Path("job.nc").write_text(job_with_tools(3))
    run("convert", "job.nc", "-o", "out")
    assert sources() == before[: len(sources())] != before
    cell(divided=False)
    run("convert", "job.nc", "-o", "out")
    assert sources() == [Path("out/job.src")]
    cell()
    run("convert", "job.nc", "-o", "out")
    assert Path("out/job.src") not in sources()


def test_modules_are_set_aside_together_where_the_program_fails():
    run("convert", "job.nc", "-o", "out")
    names = [path.name for path in sources()]
    Path("job.nc").write_text("G21 G90 G17\nG1 X1e9 F100\n")
    run("convert", "job.nc", "-o", "out", code=1)
    assert not sources()
    assert {path.name for path in Path("out").glob("*.src.old")} == {f"{name}.old" for name in names}


def test_modules_that_stay_where_the_cell_cannot_be_used_are_named():
    run("convert", "job.nc", "-o", "out")
    Path("cell.toml").write_text("robot = 3")
    told = run("convert", "job.nc", "-o", "out", code=1).output
    assert "There before, not of this run: out/job_1.src, out/job_2.src" in told.replace("\n", " ")


def test_a_module_that_was_changed_is_not_replaced():
    run("convert", "job.nc", "-o", "out")
    sources()[-1].write_text("mine")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    Path("job.nc").write_text(job_with_tools(3))
    assert sources()[-1].name in run("convert", "job.nc", "-o", "out", code=1).stderr
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
    run("convert", "job.nc", "-o", "out", "--overwrite")
    assert len(sources()) < len([name for name in before if name.endswith(".src")])


def test_names_that_clash():
    Path("job_2.nc").write_text(job_with_tools(1))
    done = run("convert", "job.nc", "job_2.nc", "-o", "out", code=1)
    assert "job.nc also writes job_2.src" in done.stderr
    assert sources() == [Path("out/job_2.src")]
    assert "module" not in Path("out/job_2.src").read_text().splitlines()[4]
    for name in ("abcdefghijklmnopqrstuvw1", "abcdefghijklmnopqrstuvw2"):
        Path(f"{name}.nc").write_text(job_with_tools())
    both = ["abcdefghijklmnopqrstuvw1.nc", "abcdefghijklmnopqrstuvw2.nc"]
    told = run("convert", *both, "-o", "long", "--overwrite", code=1).stderr
    assert "long/abcdefghijklmnopqrstuv_1.src: this file was written for abcdefghijklmnopqrstuvw1" in told
    assert {path.stem[:-1] for path in sources("long")} == {"abcdefghijklmnopqrstuv_"}


def test_the_warning_names_the_option_and_programs_that_it_does_not_divide():
    cell(divided=False)
    assert "or set divide_into_modules = true in [output]" in run("convert", "job.nc", "-o", "out").output.replace(
        "\n", " "
    )
    cell()
    run("convert", "job.nc", "-o", "krl", "--nominal", "--name", "all")
    one = Path("krl/all_1.src")
    cell(2_000)
    told = run("convert", one, "-o", "again").output.replace("\n", " ")
    assert "divide_into_modules divides no other programs" in told
    assert sources("again") == [Path("again/all_1.src")]


def result(mode: str = "convert"):
    unit = cells.load(Path("cell.toml"))
    program = read_files({"job.nc": Path("job.nc").read_bytes()}, unit)
    return process(program, ROBOT, unit, mode=mode)


FAULTS = {
    "another number": lambda text: re.sub(r"LIN \{X (\d)", r"LIN {X 9\1", text, count=1),
    "another speed": lambda text: text.replace("$VEL.CP=0.015", "$VEL.CP=0.016", 1),
    "a corner": lambda text: text.replace(" C_DIS", "", 1),
    "a motion less": lambda text: re.sub(r"\nLIN.*", "", text, count=1),
    "another base": lambda text: text.replace("$BASE={X 1500", "$BASE={X 1500.001", 1),
    "another tool": lambda text: text.replace(",Z 350,", ",Z 350.001,", 1).replace(",Z 400,", ",Z 400.001,", 1),
    "another start": lambda text: re.sub(r"PTP \{A1 (\d+\.\d\d)\d", lambda m: f"PTP {{A1 {m[1]}{9}", text, count=1),
    "no END": lambda text: text.replace("END", "ENDE"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_module_that_moves_otherwise_would_be_noticed(fault, monkeypatch):
    right = write.divide_into_modules

    def wrong(*given):
        written = right(*given)
        first, second, *others = written.modules.documents
        broken = replace(second, text=FAULTS[fault](second.text))
        assert broken.text != second.text
        return replace(written, modules=replace(written.modules, documents=(first, broken, *others)))

    assert result().documents
    monkeypatch.setattr(write, "divide_into_modules", wrong)
    done = result()
    assert not done.documents
    told = "job_2.src moves differently from the program in one piece"
    assert [told in issue.message for issue in done.issues if issue.level == "error"] == [True]


def test_an_approximated_end_of_a_module_would_be_noticed(monkeypatch):
    class Running(modules.Emitter):
        starts = property(lambda _: (), lambda *_: None)

    monkeypatch.setattr(modules, "Emitter", Running)
    assert not result().documents


def places(text: str, more: str = "") -> list[str]:
    """Return the blocks of G-code after which a module may end."""
    lines = ["G21 G90 G17 G54", *text.split("; ")]
    Path("job.nc").write_text("\n".join(lines))
    Path("cell.toml").write_text(CELL_FILE.read_text() + MORE + more)
    unit = cells.load(Path("cell.toml"))
    program = read_files({"job.nc": Path("job.nc").read_bytes()}, unit)
    return [lines[line - 1] for line in program.motions.line[modules._possible_ends(program, unit)]]


CUT = "G1 Z-1 F500; X20"
LOW = f"G0 X1 Y0 Z50; {CUT}; G0 Z5; X30; {CUT}"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"G0 X1 Y0 Z50; {CUT}; G0 Z5; Z40; X30; Z2; {CUT}; G0 Z9", ["Z40"]),  # the first of the highest
        (f"G0 X1 Y0 Z30; X5 Z50; {CUT}; G0 Z9", ["G0 X1 Y0 Z30"]),
        (LOW, ["G0 Z5"]),
        (f"G0 X1 Y0 Z50; {CUT}; G0 Z5; {CUT}", []),  # a cut follows
        (f"{LOW}; G1 Z6; X40; G0 Z60", []),  # a cut is higher
        (f"{LOW}; G1 Z4.5; X40; G0 Z60", ["G0 Z5"]),
        (f"{LOW}; G18 G3 X30 Z-1 R5; G0 Z60", ["G0 Z5"]),
        (f"{LOW}; G18 G2 X30 Z-1 R5; G0 Z60", ["G0 Z5"]),  # an arc passes 1 mm lower
        (f"{LOW}; G18 G2 X34 Z-1 R7; G0 Z60", []),  # an arc passes higher
        (f"{LOW}; G17 G2 X34 R7; G0 Z60", ["G0 Z5"]),  # an arc about the tool axis
        (f"{LOW}; G55; X30 Y0 Z0; G0 Z60", ["G0 Z5"]),
        (f"{LOW}; G55; X30 Y0 Z30; G0 Z60", []),  # a cut is higher in the root, with another work offset
        ("G0 X1 Y0 Z50; X5", ["G0 X1 Y0 Z50"]),
        ("G0 X1 Y0 Z-1; G1 X20 F500", []),  # the first cut is as high
    ],
)
def test_where_a_module_may_end(text, found):
    assert places(text) == found


ROTARY = """
[rotary]
axes = ["B"]
kind = "tcp"
"""


@pytest.mark.parametrize(
    ("x", "found"),
    [
        (100, ["G0 X100 Z100"]),  # along the tool it is 141 mm high, and all cuts are lower
        (-100, []),  # along the tool it is 0 mm high: beside the part
    ],
)
def test_height_counts_along_the_tilted_tool(x, found):
    cut = "G1 X0 Y0 Z10 B45 F500; X20"
    assert places(f"G0 X{x} Y0 Z100 B45; {cut}; G0 X{x} Z100; Y50; {cut}; G0 Z90", ROTARY)[-1:] == found
