"""Two programs that call one subprogram of another file: none moves by what was corrected for the other."""

from __future__ import annotations

import json
import re
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import cell
from postproc.dialects.krl.dialect import callers
from postproc.jobs import Job, conversion, find_jobs, output_plan
from tests import commands
from tests.attack.krl_interpreter import Controller
from tests.oracle.arm import abc
from tests.places import CELL_FILE

START = "BAS(#INITMOV,0)\n$VEL.CP=0.05\nPTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}\n"


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("cell.toml").write_text(CELL_FILE.read_text())
    for name, force in (("one", 200), ("two", -300), ("three", 200)):
        write_caller(name, force)
    Path("sub.src").write_text("DEF sub()\nLIN {X 20,Y 20,Z 0,A 0,B 0,C 180}\nEND\n")


def write_caller(name: str, force: int) -> None:
    Path(f"{name}.src").write_text(
        f"DEF {name}( )\n{START};FORCE FX={force} FY=100 FZ=-100\nLIN {{X 0,Y 0,Z 10,A 0,B 0,C 180}}\nsub()\n"
        "LIN {X 50,Y 0,Z 10,A 0,B 0,C 180}\nEND\n"
    )


run = partial(commands.run, cell="cell.toml")


def alone(name: str) -> None:
    """The written program moves as one that was converted into a folder of its own."""
    assert "unchanged since" in run("predict", f"out/{name}.src", "-o", "told").output
    run("convert", f"{name}.src", "-o", f"alone_{name}")
    one, other = (Path(folder, f"{name}.targets.csv").read_text() for folder in ("out", f"alone_{name}"))
    assert one == other
    run("compare", f"{name}.src", f"out/{name}.src", "-o", "told")


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_a_subprogram_that_was_corrected_for_another_program_is_written_under_a_name_of_its_own(more):
    run("convert", "one.src", "-o", "out")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    told = " ".join(run("convert", "two.src", "-o", "out", *more).stdout.split())
    assert "sub.src is written as sub_two.src: it differs from the one written for one." in told
    assert "would move by the correction made here" not in told
    assert {name: Path("out", name).read_bytes() for name in before} == before
    assert "\nsub_two()\n" in Path("out/two.src").read_text()
    assert Path("out/sub_two.src").read_text().startswith("DEF sub_two()\n;POSTPROC 1 ")
    alone("one")
    alone("two")
    run("convert", "one.src", "-o", "out")  # its own
    two = {path.name: path.read_bytes() for path in Path("out").glob("*two*")}
    run("convert", "two.src", "-o", "out")
    assert two == {path.name: path.read_bytes() for path in Path("out").glob("*two*")}


def test_a_program_of_the_same_run_is_not_said_to_move_by_the_correction_of_another():
    told = " ".join(run("convert", "one.src", "two.src", "-o", "out").stdout.split())
    assert Path("out/sub_two.src").exists()
    assert "would move by the correction made here" not in told
    assert "two.src of its folders calls it too" in " ".join(run("convert", "one.src", "-o", "alone").stdout.split())


GLOBAL = "DEFDAT sub PUBLIC\nDECL GLOBAL INT NS=1\nENDDAT\n"


@pytest.mark.parametrize(
    ("data", "two", "reason"),
    [
        (GLOBAL, "", "DECL GLOBAL INT NS=1 in sub.dat would exist twice"),
        ("", 'CWRITE($CMD,STAT,MODE,"RUN sub")\n', "two.src uses its name in another way than to call it"),
    ],
)
@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_a_subprogram_that_cannot_have_another_name_is_not_replaced(more, data, two, reason):
    if data:
        Path("sub.dat").write_text(data)
    Path("two.src").write_text(Path("two.src").read_text().replace("sub()\n", f"sub()\n{two}"))
    run("convert", "one.src", "-o", "out")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    told = run("convert", "two.src", "-o", "out", *more, code=1).stderr
    problem = "out/sub.src: this file was written for one, which needs it too, and is corrected differently for two"
    assert f"{problem}. A copy of it for two is not possible: {reason}" in " ".join(told.split())
    assert "another folder with -o" in told
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


DRILL = """DEF drill(PX:IN,PY:IN)
REAL PX,PY
DECL FRAME P
P={{X 0,Y 0,Z 20,A 0,B 0,C 180}}
P.X=PX
P.Y=PY
LIN P
P.Z=-8
;FORCE FX=0 FY=0 FZ=300
LIN P
{calls};FORCE OFF
P.Z=20
LIN P
END
"""
BORE = """DEF bore(PZ:IN)
REAL PZ
LIN {X 10,Y 10,Z 0,A 0,B 0,C 180}
END
"""


def write_drilled(*, calls_others: bool) -> None:
    """Write programs that call one drilling routine for two holes each; it may call a GLOBAL and a local routine."""
    for number in (1, 2, 3):
        calls = f"drill({10 * number},20)\ndrill({10 * number},90)\n"
        Path(f"hole{number}.src").write_text(f"DEF hole{number}( )\n{START}{calls}END\n")
    drill = DRILL.format(calls="deep(1)\nbore(1)\n" if calls_others else "")
    Path("drill.src").write_text(drill + ("GLOBAL " + BORE.replace("bore", "deep") + BORE if calls_others else ""))


def executed(folder: str, program: str) -> list:
    """Run a written program on the controller of the tests with all files of its folder."""
    unit = cell.load("cell.toml")
    frames = abc(unit.base.X, unit.base.Y, unit.base.Z), abc(unit.tool.X, unit.tool.Y, unit.tool.Z)
    files = {path.name.upper(): path.read_text() for path in Path(folder).glob("*.src")}
    motions = Controller(files, np.random.default_rng(1), *frames, {}).run(program.upper())
    return [(motion.kind, motion.numbers, motion.joints, motion.force) for motion in motions]


@pytest.mark.parametrize("calls_others", [False, True])
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_programs_that_each_need_several_copies_of_one_subprogram_are_all_written(jobs, calls_others):
    write_drilled(calls_others=calls_others)
    programs = [f"hole{number}" for number in (1, 2, 3)]
    sources = [f"{program}.src" for program in programs]
    done = run("convert", *sources, "-o", "out", "--jobs", jobs)
    texts = {path.name: path.read_text() for path in Path("out").glob("*.src")}
    assert set(texts) == {*sources, "drill.src", "drill_hole2.src", "drill_hole3.src"}
    visible = [name.upper() for text in texts.values() for name in re.findall(r"GLOBAL DEF (\w+)", text)]
    visible += [Path(name).stem.upper() for name in texts]
    assert len(visible) == len(set(visible))
    assert {"DRILL_2", "DRILL_HOLE2_2", "DRILL_HOLE3_2"} <= set(visible)
    assert not any("BORE" in name for name in visible)  # only its own file calls it
    assert "this one calls its copy drill_hole2_2()." in Path("out/hole2.report.json").read_text()
    for program in programs:
        run("convert", f"{program}.src", "-o", f"alone_{program}")
        assert executed("out", program) == executed(f"alone_{program}", program)
    assert executed("out", "hole1") != executed("out", "hole2")
    run("convert", *sources, "-o", "out", "--jobs", "1")
    assert texts == {path.name: path.read_text() for path in Path("out").glob("*.src")}
    assert done.exit_code == 0


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_copies_of_subprograms_whose_names_differ_at_their_ends_only_have_different_names(jobs):
    names = [f"drill_left_of_the_slots{side}" for side in "AB"]  # 24 characters, the limit
    for program, name in zip(("hole1", "hole2"), names, strict=True):
        Path(f"{name}.src").write_text(DRILL.format(calls="").replace("DEF drill", f"DEF {name}"))
        Path(f"{program}.src").write_text(f"DEF {program}( )\n{START}{name}(10,20)\n{name}(10,90)\nEND\n")
    run("convert", "hole1.src", "hole2.src", "-o", "out", "--jobs", jobs)
    visible = [name for path in Path("out").glob("*.src") for name in re.findall(r"GLOBAL DEF (\w+)", path.read_text())]
    assert len(visible) == len(set(visible)) == 2
    assert all(name.startswith("drill_left_of_the") and name.endswith("_2") and len(name) == 24 for name in visible)
    for program in ("hole1", "hole2"):
        run("convert", f"{program}.src", "-o", f"alone_{program}")
        assert executed("out", program) == executed(f"alone_{program}", program)


def test_parts_of_a_divided_program_call_copies_and_are_not_copied():
    write_drilled(calls_others=False)
    path = Path("hole2.src")
    moves = "".join(f"LIN {{X {10 * k},Y 5,Z 20,A 0,B 0,C 180}}\n" for k in range(12))
    path.write_text(path.read_text().replace("drill(20,90)", f"{moves}drill(20,90)"))
    run("convert", "hole1.src", "hole2.src", "-o", "out", "--lines-per-file", "9")
    written = {path.name for path in Path("out").glob("*.src")}
    assert {"hole2Main.src", "hole21.src", "hole22.src", "drill_hole2.src"} <= written
    assert not any(name.startswith("hole") and "_" in name for name in written)
    run("convert", "hole2.src", "-o", "alone", "--lines-per-file", "9")
    assert executed("out", "hole2Main") == executed("alone", "hole2Main")


def test_a_copy_has_no_name_that_a_subprogram_of_another_program_defines():
    write_drilled(calls_others=False)
    run("convert", "hole1.src", "hole2.src", "-o", "out")
    Path("sub.src").write_text(f"{Path('sub.src').read_text()}GLOBAL DEF drill_hole3_2()\nEND\n")
    run("convert", "one.src", "-o", "out")
    run("convert", "hole3.src", "-o", "out")
    assert "GLOBAL DEF drill_hole3_2_2(" in Path("out/drill_hole3.src").read_text()
    assert "\ndrill_hole3_2_2(30,90)\n" in Path("out/hole3.src").read_text()


@pytest.mark.parametrize(("jobs", "before"), [("1", True), ("2", False)])
def test_in_one_run_the_first_has_the_file_and_the_second_a_copy(jobs, before):
    if before:  # alike then, so that both use it
        for name in ("one", "two"):
            write_caller(name, 150)
        run("convert", "one.src", "two.src", "-o", "out")
        for name, force in (("one", 200), ("two", -300)):
            write_caller(name, force)
    run("convert", "one.src", "two.src", "-o", "out", "--jobs", jobs, "--overwrite")
    assert {path.name for path in Path("out").glob("*.src*")} == {"one.src", "two.src", "sub.src", "sub_two.src"}
    assert not [path for path in Path("out").iterdir() if ".old" in path.name or path.name.startswith(".")]
    alone("one")
    alone("two")


def test_what_calls_a_copy_is_a_copy_too():
    for name in ("one", "two"):
        path = Path(f"{name}.src")
        path.write_text(path.read_text().replace("sub()", "mid( ) ; sub()"))
    Path("mid.src").write_text(
        "&ACCESS RVP\nDEF mid( )\nEXT sub ( )\nsub ( )\nLIN {X 30,Y 20,Z 0,A 0,B 0,C 180}\nEND\n"
    )
    Path("sub.dat").write_text("DEFDAT sub\nDECL INT sub_count=0\nENDDAT\n")
    run("convert", "one.src", "two.src", "-o", "out")
    names = {path.name for path in Path("out").iterdir() if path.suffix in (".src", ".dat")}
    files = {"mid.src", "sub.src", "sub.dat", "mid_two.src", "sub_two.src", "sub_two.dat"}
    assert names == {"one.src", "two.src", *files}
    assert "mid_two( ) ; sub()" in Path("out/two.src").read_text()
    text = Path("out/mid_two.src").read_text()
    assert "DEF mid_two( )" in text
    assert "EXT sub_two ( )\nsub_two ( )" in text
    assert Path("out/sub_two.dat").read_text() == "DEFDAT sub_two\nDECL INT sub_count=0\nENDDAT\n"
    for name in ("one", "two"):
        alone(name)


def test_programs_that_are_corrected_alike_share_it():
    run("convert", "one.src", "three.src", "-o", "out")
    assert {path.name for path in Path("out").glob("*.src")} == {"one.src", "three.src", "sub.src"}
    for name in ("one", "three"):
        assert "unchanged since" in run("predict", f"out/{name}.src", "-o", "told").output


def test_what_another_program_calls_stays_where_one_does_not_call_it_any_more():
    run("convert", "one.src", "three.src", "-o", "out")
    text = Path("one.src").read_text()
    Path("one.src").write_text(text.replace("sub()\n", ""))
    run("convert", "one.src", "-o", "out")
    Path("one.src").write_text(text.replace("X 50", "X 1e9"))
    run("convert", "one.src", "-o", "out", code=1)
    assert not Path("out/one.src").exists()
    assert "unchanged since" in run("predict", "out/three.src", "-o", "told").output


def test_a_corrected_subprogram_is_not_corrected_again():
    run("convert", "one.src", "-o", "out")
    assert "mode=corrected" in Path("out/sub.src").read_text()
    shutil.copy("two.src", "out/two.src")
    told = run("convert", "out/two.src", "-o", "again", code=1).output
    assert "sub.src, which this program calls, was corrected" in told
    run("predict", "out/two.src", "-o", "again")


def test_in_a_folder_it_is_corrected_with_those_that_call_it():
    Path("jobs").mkdir()
    for name in ("one", "three", "sub"):
        shutil.move(f"{name}.src", "jobs")
    Path("jobs/one.src").write_text(Path("jobs/one.src").read_text().replace("sub()", "Ready()\nsub()"))
    Path("jobs/tools.src").write_text("DEF tools()\n;nothing\nEND\nGLOBAL DEF READY ( )\n$OUT[1]=TRUE\nEND\n")
    Path("jobs/CELL.src").write_text("DEF CELL()\nLOOP\nIF $IN[1] THEN\none()\nENDIF\nENDLOOP\nEND\n")
    Path("jobs/last.src").write_text(Path("jobs/one.src").read_text().replace("one", "last").replace("sub()", ";sub()"))
    run("convert", "jobs/one.src", "-o", "alone")
    done = run("convert", "jobs", "-o", "out", code=1)
    assert "jobs/sub.src: called by one.src, three.src: corrected with it" in done.stderr
    assert done.stderr.count("Error: ") == done.stderr.count("Error: jobs/CELL.src:5: the branches") == 1
    assert "jobs/tools.src: called by last.src, one.src: written with it, unchanged" in done.stderr
    written = {"one.src", "three.src", "last.src", "sub.src", "tools.src"}
    assert {path.name for path in Path("out").glob("*.src")} == written
    for name in ("one.src", "sub.src", "tools.src"):
        assert Path("out", name).read_bytes() == Path("alone", name).read_bytes()
    index = Path("out/index.html").read_text()
    assert index.count("called by others") == 3  # in its tile, and in two rows
    rows = [line for line in done.stdout.splitlines() if line.startswith(("jobs/sub", "jobs/tools"))]
    assert all("skipped: a subprogram" in line for line in rows)
    assert len(rows) == 2
    named = run("convert", "jobs", "jobs/sub.src", "-o", "more", code=1).stderr
    assert "one.src calls sub.src, which is also converted as a program of its own" in named


def test_one_name_and_one_file_of_forces_are_those_of_the_program_that_calls_the_others():
    Path("jobs").mkdir()
    for name in ("one", "sub"):
        shutil.move(f"{name}.src", "jobs")
    run("convert", "jobs", "-o", "out", "--name", "first")
    assert {path.name for path in Path("out").glob("*.src")} == {"first.src", "sub.src"}
    run("predict", "jobs", "-o", "told")


@pytest.mark.parametrize(
    ("files", "called"),
    [
        ({"a": "b()", "b": "c( )", "c": "LIN P"}, {"b": "a", "c": "b"}),
        ({"a": "b()", "b": "a()"}, {}),
        ({"a": "b()", "b": "c()", "c": "b()"}, {"b": "ac", "c": "b"}),
        ({"a": ";b()", "b": "LIN P"}, {}),
        ({"a": "x=1 ; b()", "b": "LIN P"}, {}),
        ({"a": "a()", "b": "LIN P[1]"}, {}),
        ({"a": "B (1)", "b": "LIN P"}, {"b": "a"}),
        ({"a": "b()\nEND\nDEF b()\nLIN P", "b": "LIN P"}, {}),
        ({"a": "IF F(1)>2 THEN\nENDIF", "b": "END\nGLOBAL DEFFCT REAL f(n:IN)\nRETURN 1"}, {"b": "a"}),
        ({"a": "IF F(1)>2 THEN\nENDIF", "b": "LIN P\nEND\nGLOBAL DEFFCT REAL f(n:IN)\nRETURN 1"}, {}),
        ({"a": "IF F(1)>2 THEN\nENDIF", "b": "END\nDEFFCT REAL f(n:IN)\nRETURN 1"}, {}),
        ({"Cell": "b()", "b": "LIN P"}, {}),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_which_files_of_a_folder_others_call(files, called, end, tmp_path):
    paths = {name: tmp_path / f"{name}.src" for name in files}
    for name, lines in files.items():
        paths[name].write_bytes(f"&ACCESS\nDEF {name}( )\n{lines}\nEND\n".replace("\n", end).encode())
    found = callers(list(paths.values()))
    assert {path.stem: "".join(other.stem for other in others) for path, others in found.items()} == called


def test_a_subprogram_that_is_also_a_program_of_the_run_is_named():
    told = run("convert", "one.src", "sub.src", "-o", "out", code=1).stderr
    assert "one.src calls sub.src, which is also converted as a program of its own" in told


def test_those_that_may_correct_one_file_in_common_are_one_line():
    Path("more").mkdir()
    Path("two.src").write_text("DEF two()\ninner()\nEND\n")
    Path("inner.src").write_text("DEF inner()\nSub ( )\nEND\n")
    Path("four.src").write_text("DEF four()\ntools()\n; sub()\nLIN {X 1}\nEND\n")
    Path("five.src").write_text("DEF five()\ntools()\nLast()\nEND\n")
    Path("tools.src").write_text("DEF tools()\n$OUT[1]=TRUE\nEND\n")
    Path("more/last.src").write_text("DEF last()\nPTP HOME\nEND\n")
    Path("six.src").write_text("DEF six()\nlast()\nEND\n")
    Path("cell.toml").write_text(CELL_FILE.read_text() + '\n[krl]\nsearch = ["more"]\n')

    def lines(*names, **keywords):
        found: dict[Path, list[Job]] = {}
        for job in find_jobs([f"{name}.src" for name in names], **keywords):
            found.setdefault(job.output, []).append(job)
        groups = [
            line for jobs in found.values() for line in output_plan.groups_in_sequence(jobs, cell.load("cell.toml"))
        ]
        return sorted(" ".join(sorted(job.program.stem for job in line)) for line in groups)

    assert lines("five", "four", "one", "six", "two") == ["five six", "four", "one two"]
    shutil.copy("four.src", "more/seven.src")
    assert lines("four", "one", "more/seven", output=Path("out")) == ["four one seven"]
    assert lines("four", "one", "more/seven") == ["four", "one", "seven"]


def test_the_first_has_the_file_however_long_it_takes():
    text = Path("one.src").read_text()
    Path("one.src").write_text(text.replace("sub()\n", "sub()\n" + "LIN {X 20,Y 30}\nLIN {X 30,Y 30}\n" * 300))
    for _ in range(2):
        run("convert", "one.src", "two.src", "three.src", "-o", "out", "--jobs", "2")
        files = {"one.src", "two.src", "three.src", "sub.src", "sub_two.src"}
        assert {path.name for path in Path("out").glob("*.src*")} == files
        run("predict", "out/one.src", "-o", "told")


def test_a_shared_file_that_was_changed_leaves_what_is_there():
    run("convert", "one.src", "three.src", "-o", "out")
    with Path("out/sub.src").open("a") as file:
        file.write("; by hand\n")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    told = run("convert", "one.src", "three.src", "-o", "out", code=1).stderr
    assert told.count("not written by postproc, or changed since: out/sub.src. Nothing was written.") == 2
    after = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    assert {**after, "index.html": b""} == {**before, "index.html": b""}


@pytest.mark.parametrize("force", [";FORCE FX=200 FY=0 FZ=0\n", ""])
def test_a_routine_of_another_file_that_cannot_be_followed_is_refused_under_force(force):
    write_caller("one", 0)
    if not force:
        write_caller("one", 200)
    Path("sub.src").write_text(f"DEF sub()\n{force}LIN {{X 20,Y 20,Z 0,A 0,B 0,C 180}}\nLIN $POS_ACT:{{X 9}}\nEND\n")
    told = run("convert", "one.src", "-o", "out", code=1).stderr
    assert f"sub.src:{3 + bool(force)}: " in told
    assert "sub(), called in one.src, line 7, would stay uncorrected under force" in told
    assert "--keep-unresolved" in told
    kept = run("convert", "one.src", "-o", "out", "--keep-unresolved").stdout
    assert f"sub.src, line {3 + bool(force)}: stays as it is" in " ".join(kept.split())


@pytest.mark.parametrize("is_own", [False, True])
def test_the_name_of_a_called_routine_has_the_limit_of_program_names(is_own):
    name = "sub_with_a_name_that_is_too_long"
    text = Path("one.src").read_text().replace("sub()", f"{name}()")
    routine = f"DEF {name}()\nLIN {{X 20,Y 20,Z 0,A 0,B 0,C 180}}\nEND\n"
    Path("one.src").write_text(text + routine if is_own else text)
    if not is_own:
        Path(f"{name}.src").write_text(routine)
    error = run("convert", "one.src", "-o", "out", code=1).stderr
    assert f"{'one.src:10' if is_own else f'{name}.src:1'}: {name.upper()} is not a valid name: it has 32 char" in error
    assert "Rename it, and its file" in error


@pytest.mark.parametrize("motion", ["LIN $POS_ACT:{X 9}", "sub()"])
def test_without_force_it_stays_with_a_warning_that_comes_first_and_names_the_cause(motion):
    Path("jobs").mkdir()
    text = Path("one.src").read_text().replace("sub()", ";FORCE OFF\nsub()\nPTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}")
    Path("jobs/one.src").write_text(text)
    Path("jobs/sub.src").write_text(f"DEF sub()\nLIN {{X 20,Y 20,Z 0,A 0,B 0,C 180}}\n{motion}\nEND\n")
    done = run("convert", "jobs", "-o", "out")
    assert "jobs/sub.src: called by one.src: written with it, unchanged" in done.stderr
    assert Path("out/sub.src").read_bytes() == Path("jobs/sub.src").read_bytes()
    reasons = json.loads(Path("out/one.report.json").read_text())["verdict"]["reasons"]
    assert "its motions are not corrected here, because of sub.src, line 3: " in reasons[0]
    assert ("calls itself" in reasons[0]) is (motion == "sub()")


PROCESS = """
[material]
name = "al_6082_t6_carbide"
[tools.default]
shape = "flat"
diameter_mm = 12
flutes = 3
rpm = 8000
[stock]
box = { X = [0.0, 100.0], Y = [-40.0, 40.0], Z = [-20.0, 3.0] }
resolution_mm = 1.0
"""
AXES = "PTP {A1 0,A2 -90,A3 100,A4 0,A5 80,A6 20}"


@pytest.mark.parametrize("command", ["convert", "predict", "forces"])
@pytest.mark.parametrize("operations", [False, True])
@pytest.mark.parametrize(("cut", "refused"), [("LIN {X 20,Y 20,Z 0,A 0,B 0,C 180}", True), (AXES, False)])
def test_a_routine_that_cannot_be_followed_is_refused_where_a_process_makes_its_forces(
    command, operations, cut, refused
):
    lines = f"LIN {{X -15,Y 0,Z 0,A 0,B 0,C 180}}\nLIN {{X 50}}\nLIN {{Z 20}}\nsub()\n{AXES}\n"
    Path("one.src").write_text(f"DEF one()\n{START};ROUGH\n{lines}LIN {{X 60,Y 0,Z 20,A 0,B 0,C 180}}\nEND\n")
    Path("sub.src").write_text(f"DEF sub()\n{cut}\nPTP $POS_ACT:{{X 9}}\nEND\n")
    table = '[operations."ROUGH"]\nFx = 100.0\nFy = 0.0\nFz = 0.0\nframe = "BASE"\n'
    Path("cut.toml").write_text(table if operations else PROCESS)
    output = ["-o", "told.csv" if command == "forces" else "out"]
    done = run(command, "one.src", "--process", "cut.toml", *output, code=int(refused))
    if refused:
        assert "sub.src:3: " in done.stderr
        assert "sub(), called in one.src, line 9, would stay uncorrected under force." in done.stderr
        assert "--keep-unresolved" in done.stderr
        assert not Path("out").exists()
        assert not Path("told.csv").exists()
    if refused and command != "forces":
        text = Path("sub.src").read_text()
        for kept in (text, text.replace("END", "LIN $POS_ACT:{X 9}\nEND")):
            Path("sub.src").write_text(kept)
            done = run(command, "one.src", "--process", "cut.toml", *output, "--keep-unresolved")
            assert ("remove nothing from the stock: sub.src, line 4" in done.stderr + done.stdout) is (
                not operations and "LIN $POS_ACT" in kept
            )


@pytest.mark.parametrize("command", ["convert", "predict"])
@pytest.mark.parametrize(
    ("rows", "refused"), [("6,8,300", True), ("7,7,300", True), ("6,8,0", False), ("6,6,300\n9,9,300", False)]
)
def test_lines_of_a_table_that_take_in_what_cannot_be_followed_are_refused(command, rows, refused):
    lines = f"LIN {{X 0,Y 0,Z 0,A 0,B 0,C 180}}\nsub()\n{AXES}\nLIN {{X 60,Y 0,Z 0,A 0,B 0,C 180}}\n"
    Path("one.src").write_text(f"DEF one()\n{START}\n{lines}END\n")
    Path("sub.src").write_text("DEF sub()\nLIN {X 20,Y 0,Z 0,A 0,B 0,C 180}\nPTP $POS_ACT:{X 9}\nEND\n")
    Path("f.csv").write_text("line,line_end,Fx,Fy,Fz\n" + "".join(f"{row},0,0\n" for row in rows.split("\n")))
    done = run(command, "one.src", "--forces", "f.csv", "-o", "out", code=int(refused))
    assert ("sub.src:3: " in done.stderr) is refused
    assert ("sub(), called in one.src, line 7, would stay uncorrected under force." in done.stderr) is refused
    assert refused or "sub() moves the robot" in done.stdout


def test_motions_that_carry_no_force_are_not_refused_under_one():
    text = Path("one.src").read_text().replace("LIN {X 50", "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}\nLIN {X 50")
    Path("one.src").write_text(text)
    Path("sub.src").write_text("DEF sub()\nPTP {A1 9,A2 -70,A3 110,A4 0,A5 50,A6 20}\nPTP XUNKNOWN\nEND\n")
    run("convert", "one.src", "-o", "out")


def test_what_fails_leaves_the_file_of_its_name_that_another_program_calls():
    run("convert", "one.src", "-o", "out")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    assert (
        "out/sub.src: this file was written for one, which needs it"
        in run("convert", "sub.src", "-o", "out", code=1).stderr
    )
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


G_CODE = "G90 G21 G17\nG0 X0 Y0 Z20\n(FORCE FX=200 FY=0 FZ=0)\nG1 X50 F1000\nM30\n"


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
@pytest.mark.parametrize("force", [200, 0])
def test_g_code_does_not_replace_the_subprogram_of_its_name_that_another_program_calls(more, force):
    if not force:  # the subprogram is copied, not corrected
        write_caller("one", 0)
        Path("one.src").write_text(Path("one.src").read_text().replace(";FORCE FX=0 FY=100 FZ=-100", ""))
    run("convert", "one.src", "-o", "out")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    Path("sub.nc").write_text(G_CODE)
    told = run("convert", "sub.nc", "-o", "out", *more, code=1).stderr
    assert "out/sub.src: this file was written for one, which needs it" in told
    assert "--name" in told
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
    run("convert", "sub.nc", "-o", "out", "--name", "pocket", *more)
    assert {name: Path("out", name).read_bytes() for name in before} == before
    for path in Path("out").glob("one.*"):
        path.unlink()
    run("convert", "sub.nc", "-o", "out", "--overwrite")  # nobody calls it any more


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_subprogram_that_was_changed_is_replaced_with_all_programs_of_the_run_that_call_it(jobs):
    run("convert", "one.src", "three.src", "-o", "out")
    Path("sub.src").write_text(Path("sub.src").read_text().replace("X 20", "X 23"))
    before = Path("out/sub.src").read_bytes()
    run("convert", "one.src", "-o", "out")
    assert Path("out/sub.src").read_bytes() == before  # for three, which is not in this run
    assert Path("out/sub_one.src").exists()
    run("convert", "one.src", "three.src", "-o", "out", "--jobs", jobs)
    assert Path("out/sub.src").read_bytes() != before
    assert {path.name for path in Path("out").glob("*.src")} == {"one.src", "three.src", "sub.src"}
    for name in ("one", "three"):
        assert "unchanged since" in run("predict", f"out/{name}.src", "-o", "told").output


def test_a_file_that_another_program_calls_stays_when_that_of_its_name_is_divided():
    Path("one.src").write_text(f"DEF one( )\n{START}sub()\nEND\n")
    lines = "".join(f"LIN {{X {20 + k},Y 20,Z 0,A 50,B 0,C 180}}\n" for k in range(8))
    Path("sub.src").write_text(f"DEF sub( )\n{lines}END\n")
    run("convert", "one.src", "-o", "out")
    run("convert", "sub.src", "-o", "out", "--overwrite")
    before = Path("out/sub.src").read_bytes()
    run("convert", "sub.src", "-o", "out", "--lines-per-file", "5")
    assert Path("out/subMain.src").exists()
    assert Path("out/sub.src").read_bytes() == before


def test_what_stood_with_a_file_that_was_replaced_is_gone_where_it_fails_now():
    run("convert", "one.src", "three.src", "-o", "out")
    Path("sub.src").write_text(Path("sub.src").read_text().replace("X 20", "X 23"))
    Path("three.src").write_text(Path("three.src").read_text().replace("X 50", "X 1e9"))
    run("convert", "one.src", "three.src", "-o", "out", code=1)
    assert {path.name for path in Path("out").glob("*.src")} == {"one.src", "sub.src"}
    assert Path("out/three.src.old").exists()
    assert "unchanged since" in run("predict", "out/one.src", "-o", "told").output


def test_a_called_file_that_is_missing_beside_one_of_two_programs_is_told():
    Path("jobs").mkdir()
    Path("frames.src").write_text("DEF frames()\n$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}\nEND\n")
    text = Path("one.src").read_text().replace("sub()\n", "").replace(";FORCE", "frames()\n;FORCE")
    for path in (Path("one.src"), Path("jobs/one.src")):
        path.write_text(text)
    told = " ".join(run("compare", "one.src", "jobs/one.src", "-o", "told", code=3).stdout.split())
    assert "the file of FRAMES() is in the folder of the other program only" in told
    assert "called by this program only" not in told
    run("predict", "jobs/one.src", "-o", "told")
    reasons = json.loads(Path("told/one.predict.report.json").read_text())["verdict"]["reasons"]
    assert "frames()" in reasons[0]
    Path("one.src").write_text(text.replace("frames()", ";frames()"))
    told = " ".join(run("compare", "one.src", "jobs/one.src", "-o", "told", code=3).stdout.split())
    assert "called by this program only" in told


@pytest.mark.parametrize(("old", "new"), [("sub_two()", "sub()"), ("LIN {X 5", "LIN {X 6")])
def test_a_copy_by_which_the_program_would_move_differently_is_refused(monkeypatch, old, new):
    run("convert", "one.src", "-o", "out")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    rename = output_plan.copy_subprograms

    def wrong(*arguments):
        renamed = rename(*arguments)
        main, *others = renamed.documents
        assert old in main.text
        return renamed._replace(documents=(replace(main, text=main.text.replace(old, new)), *others))

    monkeypatch.setattr(conversion, "copy_subprograms", wrong)
    done = run("convert", "two.src", "-o", "out", code=1)
    assert "would move differently" in done.output
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
