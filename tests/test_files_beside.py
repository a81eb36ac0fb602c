"""Files that a program needs and that are not changed stand beside what is written: it runs, and is read, there."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path

import pytest

from tests import commands
from tests.places import CELL_FILE

START = "BAS(#INITMOV,0)\n$VEL.CP=0.05\nPTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}\n"
FRAMES = (
    b"\xef\xbb\xbf&ACCESS RVP\r\nDEF frames( )\r\n;f\xc3\xbcr alle\r\nmore( )\nEND\r\n"
    b"DEF never( )\r\nlate( )\r\nEND\r\n"
)
MORE = b"DEF more( )\n;gr\xfc\xdfe (other( ))\n$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}\nEND\n"
POINTS = "DEFDAT points PUBLIC\nDECL GLOBAL FRAME AWAY={X 50,Y 0,Z 30,A 0,B 0,C 180}\nENDDAT\n"


@pytest.fixture(autouse=True)
def input_files(work_folder):
    Path("cell.toml").write_text(CELL_FILE.read_text())
    Path("in").mkdir()


def write_cut(name: str, *lines: str, force: int = 200, to: float = 50) -> None:
    cut = f";FORCE FX={force} FY=100 FZ=-100", "LIN {X 0,Y 0,Z 10,A 0,B 0,C 180}", f"LIN {{X {to}}}", "END", ""
    Path(f"in/{name}.src").write_text(f"DEF {name}( )\n{START}" + "\n".join([*lines, *cut]))


run = partial(commands.run, cell="cell.toml")


def names(folder: str = "out") -> set[str]:
    return {path.name for path in Path(folder).iterdir() if path.suffix.lower() in (".src", ".dat", ".sub", ".old")}


def needs(name: str = "one") -> dict[str, bytes]:
    """A program, and the files beside it that it needs; others stand there too."""
    write_cut(name, "frames( )", "LIN AWAY", '$MSG_T.MSG[]="other( )" ;other( )')
    files = {
        "frames.src": FRAMES,
        "more.SRC": MORE,
        "more.dat": b"DEFDAT more\nENDDAT\n",
        "points.dat": POINTS.encode(),
    }
    files["late.src"] = b"DEF late( )\nEND\n"
    for file, content in files.items():
        Path("in", file).write_bytes(content)
    for file in ("other.src", "bystander.dat", "$config.dat", "background.sub", "bas.src"):
        Path("in", file).write_text(f"DEF {Path(file).stem}( )\nEND\n")
    return files


@pytest.mark.parametrize("mode", [[], ["--nominal"], ["--name", "two"], ["--lines-per-file", "9"]])
def test_what_a_program_needs_stands_beside_it_to_the_byte(mode):
    files = needs()
    run("convert", "in/one.src", "-o", "out", *mode)
    for name, content in files.items():
        assert Path("out", name).read_bytes() == content
    assert names() - files.keys() <= {"one.src", "two.src", "oneMain.src", "one1.src", "one2.src", "one3.src"}
    stem = mode[1] if mode[:1] == ["--name"] else "one"
    report = json.loads(Path(f"out/{stem}.report.json").read_bytes())
    assert files.keys() < {entry["name"] for entry in report["files"]}
    assert set(report["copied"]) == files.keys()
    written = f"out/{stem}{'Main' if 'out/oneMain.src' in map(str, Path('out').iterdir()) else ''}.src"
    run("predict", written, "-o", "told")
    told = json.loads(next(Path("told").glob("*.predict.report.json")).read_bytes())
    assert "external-call" not in {issue["kind"] for issue in told["issues"]}
    compared = run("compare", "in/one.src", written, "-o", "told", code=3 if mode == ["--nominal"] else 0)
    assert "Copy it there" not in compared.stdout


def test_without_a_force_they_are_written_too_and_predict_writes_none():
    files = needs()
    text = Path("in/one.src").read_text()
    Path("in/one.src").write_text("".join(line for line in text.splitlines(True) if "FORCE" not in line))
    run("convert", "in/one.src", "-o", "out")
    assert names() == {"one.src", *files}
    run("predict", "in/one.src", "-o", "told")
    assert names("told") == set()


def test_into_the_folder_that_they_stand_in_they_need_not_be_written():
    files = needs()
    before = {path.name: path.read_bytes() for path in Path("in").iterdir()}
    run("convert", "in/one.src", "-o", "in", "--name", "two")
    assert {name: Path("in", name).read_bytes() for name in before} == before
    entries = json.loads(Path("in/two.report.json").read_bytes())["files"]
    assert files.keys().isdisjoint(entry["name"] for entry in entries)


def test_a_second_conversion_replaces_and_removes_what_the_first_wrote():
    needs()
    run("convert", "in/one.src", "-o", "out")
    Path("in/more.SRC").write_bytes(MORE.replace(b"1500", b"1501"))
    run("convert", "in/one.src", "-o", "out")
    assert b"1501" in Path("out/more.SRC").read_bytes()
    write_cut("one", "LIN AWAY")
    run("convert", "in/one.src", "-o", "out")
    assert names() == {"one.src", "points.dat"}


def test_a_file_of_somebody_else_is_not_replaced_but_the_same_one_is_taken():
    files = needs()
    Path("out").mkdir()
    for name, content in files.items():
        Path("out", name).write_bytes(content)
    run("convert", "in/one.src", "-o", "out")
    shutil.rmtree("out")
    Path("out").mkdir()
    Path("out/more.SRC").write_bytes(b"mine")
    told = run("convert", "in/one.src", "-o", "out", code=1).stderr
    assert "not written by postproc, or changed since: out/more.SRC" in told
    run("convert", "in/one.src", "-o", "out", "--overwrite")
    assert Path("out/more.SRC").read_bytes() == MORE


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_programs_of_one_folder_share_them(jobs):
    files = needs()
    needs("two")
    run("convert", "in/one.src", "in/two.src", "-o", "out", "--jobs", jobs)
    assert names() == {"one.src", "two.src", *files}
    write_cut("two")
    run("convert", "in/two.src", "-o", "out")
    assert names() == {"one.src", "two.src", *files}  # the other one needs them still
    needs("two")
    Path("in/more.SRC").write_bytes(MORE.replace(b"1500", b"1501"))
    told = run("convert", "in/two.src", "-o", "out", code=1).stderr
    assert "out/more.SRC: this file was written for one, which needs it too, and stays as it is for two" in told
    run("convert", "in/one.src", "in/two.src", "-o", "out", "--jobs", jobs)
    assert names() - {f"two.{kind}.old" for kind in ("src", "report.json", "report.html", "targets.csv")} == {
        *("one.src", "two.src"),  # which failed in between
        *files,
    }
    assert b"1501" in Path("out/more.SRC").read_bytes()


LIBRARY = """DEF lib( )
END
GLOBAL DEF Ready( )
$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}
END
GLOBAL DEF Across( )
LIN PX
END
"""


@pytest.mark.parametrize(
    ("order", "jobs"),
    [
        (("sets", "cuts"), None),
        (("cuts", "sets", "cuts", "sets"), None),
        *((order, jobs) for order in (("cuts", "sets"), ("sets", "cuts")) for jobs in ("1", "2")),
    ],
)
def test_one_program_needs_as_it_is_what_is_corrected_for_another(order, jobs):
    """The routines that move nothing are the same in both."""
    write_cut("cuts", "Ready( )", ";FORCE FX=300 FY=0 FZ=0", "Across( )")
    write_cut("sets", "Ready( )")
    Path("in/lib.src").write_text(LIBRARY)
    Path("in/lib.dat").write_text("DEFDAT lib\nDECL POS PX={X 20,Y 20,Z 0,A 0,B 0,C 180}\nENDDAT\n")
    if jobs is None:
        for name in order:
            run("convert", f"in/{name}.src", "-o", "out")
    else:
        run("convert", *(f"in/{name}.src" for name in order), "-o", "out", "--jobs", jobs)
    assert names() == {"cuts.src", "sets.src", "lib.src", "lib.dat"}
    assert Path("out/lib.src").read_text() != LIBRARY
    for name in ("cuts", "sets"):
        assert "unchanged since" in run("predict", f"out/{name}.src", "-o", "told").output
    Path("in/lib.src").write_text(LIBRARY.replace("1500", "1510"))
    told = run("convert", "in/sets.src", "-o", "out", code=1).stderr
    assert "this file was written for cuts" in told


def test_what_is_not_followed_is_not_left_to_what_was_corrected_for_another():
    Path("in/sub.src").write_text("DEF sub()\nLIN {X 20,Y 20,Z 0,A 0,B 0,C 180}\nPTP $POS_ACT\nEND\n")
    write_cut("cuts", ";FORCE FX=300 FY=0 FZ=0", "sub( )")
    run("convert", "in/cuts.src", "-o", "out")
    corrected = Path("out/sub.src").read_bytes()
    assert corrected != Path("in/sub.src").read_bytes()
    text = "GLOBAL INTERRUPT DECL 3 WHEN $IN[1]==TRUE DO halt3( )\n"
    Path("in/halt3.src").write_text("DEF halt3( )\nRESUME\nEND\n")
    Path("in/keeps.src").write_text(
        f"DEF keeps( )\n{text}{START}sub( )\nPTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}}\n"
        ";FORCE FX=200 FY=0 FZ=0\nLIN {X 0,Y 0,Z 10,A 0,B 0,C 180}\nEND\n"
    )
    told = run("convert", "in/keeps.src", "-o", "out", code=1).stderr
    assert "out/sub.src: this file was written for cuts" in told
    assert Path("out/sub.src").read_bytes() == corrected
    run("convert", "in/keeps.src", "-o", "more")
    assert names("more") == {"keeps.src", "sub.src", "halt3.src"}
    run("convert", "in/cuts.src", "-o", "more")
    assert names("more") == {"keeps.src", "sub.src", "halt3.src", "cuts.src", "sub_cuts.src"}


@pytest.mark.parametrize("order", [("other", "one"), ("one", "other")])
@pytest.mark.parametrize("together", [True, False])
def test_the_data_of_another_program_are_left_to_it(order, together):
    write_cut("other", "LIN P1")
    data = POINTS.replace("points", "other").replace("ENDDAT", "DECL POS P1={X 1,Y 2,Z 3,A 0,B 0,C 180}\nENDDAT")
    Path("in/other.dat").write_text(data)
    text = Path("in/other.src").read_text().replace("LIN P1", "LIN {X 0,Y 0,Z 20,A 0,B 0,C 180}\n;FORCE FX=200\nLIN P1")
    Path("in/other.src").write_text(text)
    write_cut("one", "LIN AWAY")
    for names_ in [order] if together else [(name,) for name in order]:
        run("convert", *(f"in/{name}.src" for name in names_), "-o", "out")
    assert names() == {"one.src", "other.src", "other.dat"}
    assert Path("out/other.dat").read_text() != data
    for name in ("one", "other"):
        assert "unchanged since" in run("predict", f"out/{name}.src", "-o", "told").output


def test_what_a_corrected_subprogram_and_a_data_list_need_is_written_too():
    files = needs("unused")
    write_cut("one", "Across( )")
    Path("in/lib.src").write_text(LIBRARY.replace("LIN PX", "frames( )\nLIN {X 20,Y 20,Z 0,A 0,B 0,C 180} ;points( )"))
    Path("in/one.dat").write_text("DEFDAT one\nIMPORT REAL FAR IS /R1/bystander..FAR\nENDDAT\n")
    run("convert", "in/one.src", "-o", "out")
    wanted = {"one.src", "one.dat", "lib.src", "bystander.dat", *files} - {"points.dat"}
    assert names() == wanted


def test_what_the_cell_names_stays_where_it_is():
    files = needs()
    Path("library").mkdir()
    for name in files:
        shutil.move(f"in/{name}", "library")
    Path("cell.toml").write_text(f'{CELL_FILE.read_text()}\n[krl]\nsearch = ["library"]\n')
    run("convert", "in/one.src", "-o", "out")
    assert names() == {"one.src"}


@pytest.mark.parametrize("through", ["sub( )", "first( )"])
def test_a_global_point_that_only_a_subprogram_names_is_known(through):
    Path("in/points.dat").write_text(POINTS)
    Path("in/first.src").write_text("DEF first( )\nsub( )\nEND\n")
    Path("in/sub.src").write_text("DEF sub( )\nLIN AWAY\nEND\n")
    write_cut("one", through)
    run("convert", "in/one.src", "-o", "out")
    assert Path("out/points.dat").read_text() == POINTS
    rows = Path("out/one.targets.csv").read_text().splitlines()
    assert ["50.000000", "0.000000", "30.000000"] in [row.split(",")[4:7] for row in rows]


HELD = "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}\n$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}\n$VEL.CP=0.02\n"
JOINTS = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}\n"
CUT = ";FORCE FX=-100 FY=50 FZ=80\nLIN XP1\n"
THERE = "{X 60,Y 40,Z 0,A 180,B 0,C 180}"


def another() -> None:
    """A program of its own, whose GLOBAL point others may use."""
    Path("in/a.src").write_text(f"DEF a( )\n{HELD}{JOINTS}{CUT}LIN PA\nEND\n")
    Path("in/a.dat").write_text(
        "DEFDAT a PUBLIC\nDECL GLOBAL E6POS XP1={X 160,Y 40,Z 0,A 180,B 0,C 180}\nDECL GLOBAL REAL X=1.0\n"
        "DECL GLOBAL INT MODE=1\nDECL POS PA={X 150,Y 40,Z 0,A 180,B 0,C 180}\nENDDAT\n"
    )


@pytest.mark.parametrize(
    ("text", "data"),
    [
        (f"DEF b( )\n{HELD}{JOINTS}{CUT}END\n", f"DEFDAT b\nDECL E6POS XP1={THERE}\nENDDAT\n"),
        (f"DEF b( )\nDECL E6POS XP1\n{HELD}{JOINTS}XP1={THERE}\n{CUT}END\n", ""),
        (f"DEF b( )\n{HELD}{JOINTS}{CUT.replace('XP1', THERE)}END\n", ""),  # X of a position is not that variable
        (f"DEF b( )\n{HELD}$ORI_TYPE=#VAR\n{JOINTS}{CUT.replace('XP1', THERE)}$ADVANCE=3 ;XP1 a( )\nEND\n", ""),
        (f"DEF b( )\n{HELD}{JOINTS}{CUT.replace('XP1', THERE)}a( )\nEND\nDEF a( )\nEND\n", ""),
    ],
)
def test_names_of_its_own_need_nothing_of_the_program_that_has_global_ones(text, data):
    another()
    Path("in/b.src").write_text(text)
    if data:
        Path("in/b.dat").write_text(data)
    done = run("convert", "in/b.src", "-o", "out")
    assert names() == {"b.src", *(["b.dat"] if data else [])}
    assert "a.src" not in done.output
    assert "a.dat" not in done.output
    run("convert", "in/a.src", "-o", "out")
    corrected = {name: Path("out", name).read_bytes() for name in ("a.src", "a.dat")}
    run("convert", "in/b.src", "-o", "out")
    assert {name: Path("out", name).read_bytes() for name in corrected} == corrected


def test_a_local_point_does_not_begin_with_the_value_of_a_global_one():
    another()
    Path("in/b.src").write_text(f"DEF b( )\nDECL E6POS XP1\n{HELD}{JOINTS}XP1.X=70\n{CUT}END\n")
    told = run("convert", "in/b.src", "-o", "out", code=1).stderr
    assert "b.src:9: the target is not known: XP1" in told


def test_the_routine_of_a_called_file_hides_a_program_of_its_name():
    another()
    Path("in/sub.src").write_text(f"DEF sub( )\na( )\nLIN {THERE}\nEND\nDEF a( )\n$VEL.CP=0.02\nEND\n")
    Path("in/b.src").write_text(f"DEF b( )\n{HELD}{JOINTS};FORCE FX=-100 FY=50 FZ=80\nsub( )\nEND\n")
    run("convert", "in/b.src", "-o", "out")
    assert names() == {"b.src", "sub.src"}


def test_the_points_of_another_program_are_not_written_next_to_one_that_uses_a_global_one_of_them():
    another()
    Path("in/b.src").write_text(f"DEF b( )\n{HELD}{JOINTS}{CUT}PTP XP1\nEND\n")
    done = run("convert", "in/b.src", "-o", "out")
    assert names() == {"b.src"}
    warning = "a.dat, from which b takes XP1, is not written: it belongs to a.src, which moves the robot"
    assert warning in done.output
    assert warning in Path("out/b.report.html").read_text()
    run("convert", "in/a.src", "-o", "out")
    corrected = {name: Path("out", name).read_bytes() for name in ("a.src", "a.dat")}
    assert b"XP1={X 160,Y 40,Z 0" in corrected["a.dat"]  # GLOBAL points are not corrected in place
    assert corrected["a.dat"] != Path("in/a.dat").read_bytes()
    done = run("convert", "in/b.src", "-o", "out")
    assert "is not written" not in done.output
    assert {name: Path("out", name).read_bytes() for name in corrected} == corrected
    assert "unchanged since" in run("predict", "out/b.src", "-o", "told").output


def test_a_file_with_motions_that_only_the_controller_needs_is_named_as_uncorrected():
    another()
    Path("in/b.src").write_text(f"DEF b( )\n{HELD}{JOINTS}{CUT.replace('XP1', THERE)}END\nDEF never( )\na( )\nEND\n")
    done = run("convert", "in/b.src", "-o", "out")
    assert names() == {"b.src", "a.src", "a.dat"}
    warning = "a.src is written uncorrected, as it was read, and has motions"
    assert warning in done.output
    assert warning in Path("out/b.report.html").read_text()
