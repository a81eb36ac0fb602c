"""Programs that are written in several files: what stands in the folder, and what every command makes of them."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from tests import commands
from tests.dialects.gcode_reading import AT_Z10
from tests.places import CELL_FILE

PLUNGE = AT_Z10 + "G1 Z-1 F600\n"


@pytest.fixture(autouse=True)
def input_files(work_folder):
    cell(20)
    write_zigzag(60)


def cell(limit: int) -> None:
    Path("cell.toml").write_text(CELL_FILE.read_text().replace("[output]", f"[output]\nlines_per_file = {limit}"))


def write_zigzag(count: int, name: str = "part.nc", forces: bool = True) -> None:
    force = "(FORCE FX=100 FY=-150 FZ=80)\n" if forces else ""
    lines = "".join(f"G1 X{0.1 * n:.1f} Y{n % 7 * 0.1:.1f}\n" for n in range(count))
    Path(name).write_text(PLUNGE + force + lines + "G0 Z10\nM2\n")


run = partial(commands.run, cell="cell.toml")


def sources(where: str = "out") -> set[str]:
    return {path.name for path in Path(where).iterdir() if path.suffix == ".src"}


def test_divided_it_is_what_it_is_in_one_file():
    run("convert", "part.nc", "-o", "out")
    cell(0)
    run("convert", "part.nc", "-o", "whole")
    whole = Path("whole/part.src").read_text().splitlines()
    moves = [line for line in whole if line.startswith(("LIN", "PTP", "$VEL"))]
    files = [Path("out/partMain.src"), *sorted(Path("out").glob("part[0-9]*.src"), key=lambda p: int(p.stem[4:]))]
    lines = [line for path in files for line in path.read_text().splitlines()]
    assert [line for line in lines if line.startswith(("LIN", "PTP", "$VEL"))] == moves
    assert all(len(path.read_text().splitlines()) <= 20 for path in files[1:])
    assert [line for line in files[0].read_text().splitlines() if line.endswith("( )")][-1] == f"{files[-1].stem}( )"
    rows = Path("out/part.targets.csv").read_text().splitlines()[1:]
    for row in rows:  # lines count on from file to file
        number = int(row.split(",")[0])
        assert lines[number - 1].startswith(("LIN", "PTP"))


def test_all_commands_take_the_main_program():
    run("convert", "part.nc", "-o", "out")
    one = run("predict", "out/partMain.src", "-o", "told", "--json")
    assert json.loads(one.stdout)["programs"][0]["provenance"]["state"] == "intact"
    assert "corrected" in run("convert", "out", "-o", "again", code=1).stderr
    told = json.loads(run("compare", "part.nc", "out/partMain.src", "-o", "told", "--json").stdout)
    assert told["verdict"]["state"] != "failed"
    assert told["only_nominal"] == told["only_corrected"] == 0
    assert told["provenance"]["state"] == "intact"


def test_a_changed_part_is_told():
    run("convert", "part.nc", "-o", "out")
    part = Path("out/part2.src")
    part.write_bytes(part.read_bytes().replace(b"C_DIS", b"C_DIS ", 1))
    told = json.loads(run("compare", "part.nc", "out/partMain.src", "-o", "told", "--json", code=3).stdout)
    assert told["provenance"]["state"] == "changed"


@pytest.mark.parametrize("command", ["convert", "predict"])
def test_a_part_alone_is_refused(command):
    run("convert", "part.nc", "-o", "out")
    assert "part of partMain" in run(command, "out/part2.src", "-o", "again", code=1).stderr


@pytest.mark.parametrize("marked", [True, False])
def test_a_part_that_cannot_be_read_alone_is_told_as_a_part(marked):
    run("convert", "part.nc", "-o", "out")
    for path in Path("out").glob("part*.src"):  # a point that is known in the whole program alone
        text = path.read_text() if marked else path.read_text().replace(";POSTPROC 1 part", "; part")
        path.write_text(text.replace("LIN {", "LIN START\nLIN {", 1))
    told = run("predict", "out/part2.src", "-o", "again", code=1).stderr
    assert "this file is a part of partMain, which calls it: without it, the target is not known" in told
    assert "Name partMain.src instead." in told
    assert "--keep-unresolved" not in told


def subprograms(declared: str = "", inside: str = "", force: str = "") -> None:
    head = "BAS(#INITMOV,0)\n$VEL.CP=0.05\nPTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}\n;FORCE FX=100 FY=-150 FZ=80\n"
    lines = "".join(f"LIN {{X {n},Y 0,Z 0,A 0,B 0,C 180}}\n" for n in range(30))
    Path("job.src").write_text(f"DEF job( )\n{declared}{head}{lines}{force}cut( )\nEND\n")
    Path("cut.src").write_text(f"DEF cut( )\n{inside}{lines}END\n")
    Path("stopped.src").write_text("DEF stopped( )\nBRAKE\nback( )\nEND\nDEF back( )\nRESUME\nEND\n")


@pytest.mark.parametrize(
    ("declared", "inside", "resumes"),
    [
        ("INTERRUPT DECL 5 WHEN $IN[9] DO stopped( )\n", "", True),
        ("global interrupt decl 5 when $in[9] do stopped( )\n", "", True),
        ("", "INTERRUPT DECL 5 WHEN $IN[9] DO stopped( )\nINTERRUPT ON 5\n", False),
        ("INTERRUPT DECL 5 WHEN $IN[9] DO $OUT[1]=TRUE\n", "", False),
    ],
)
def test_resume_in_another_file_is_seen_where_it_goes_back_to_the_program(declared, inside, resumes):
    subprograms(declared, inside, ";FORCE OFF\n")
    told = run("convert", "job.src", "-o", "out", code=int(resumes)).stderr
    if resumes:
        assert "cannot be divided into files: RESUME would break off" in told
        assert "stopped.src, line 6" in told
    else:
        assert "jobMain.src" in sources()
        assert "stopped.src" not in told
    cell(200)
    run("convert", "job.src", "-o", "whole")
    subprograms(declared, inside)
    broken_off = "stopped" in declared + inside
    told = run("convert", "job.src", "-o", "forced", code=int(broken_off)).stderr
    assert ("RESUME of an interrupt may break it off; cut(), called in job.src" in told) is broken_off


@pytest.mark.parametrize("places", [(20,), (10, 20)])
def test_an_error_of_the_division_names_the_line_of_the_program_that_was_read(places):
    subprograms(force=";FORCE OFF\n")
    lines = Path("job.src").read_text().splitlines()
    for place in places:  # each is line `place` of the program
        lines.insert(place - 1, "INTERRUPT DECL 5 WHEN $IN[9] DO $OUT[1]=TRUE")
    Path("jobs").mkdir()
    Path("jobs/job.src").write_text("\n".join(lines) + "\n")
    Path("cut.src").rename("jobs/cut.src")
    message = run("convert", "jobs/job.src", "-o", "out", code=1).stderr
    assert f"jobs/job.src:{places[0]}: the program cannot be divided" in message
    assert "Declare it before the first motion. To have it in one file, set lines_per_file = 0" in message


def test_the_file_of_a_subprogram_that_is_longer_than_files_may_be_is_told():
    subprograms()
    done = run("convert", "job.src", "-o", "out", "--json")
    (told,) = [i for i in json.loads(done.stdout)["programs"][0]["issues"] if i["kind"] == "long-file"]
    assert "cut.src has 32 lines, more than 20: files of subprograms are not divided" in told["message"]
    assert {"jobMain.src", "cut.src"} < sources()


def test_a_nominal_program_in_files_is_corrected_in_its_files():
    run("convert", "part.nc", "--nominal", "-o", "out")
    run("convert", "out/partMain.src", "-o", "again")
    assert sources("again") == sources("out")
    run("convert", "out", "-o", "folder")
    assert sources("folder") == sources("out")


def test_without_forces_the_files_come_back_byte_for_byte():
    write_zigzag(60, forces=False)
    run("convert", "part.nc", "--nominal", "-o", "out")
    run("convert", "out/partMain.src", "-o", "again")
    for name in sources():
        assert Path("again", name).read_bytes() == Path("out", name).read_bytes()


def test_parts_of_an_earlier_run_go():
    run("convert", "part.nc", "-o", "out")
    before = sources()
    write_zigzag(20)
    run("convert", "part.nc", "-o", "out")
    assert {"partMain.src", "part1.src"} <= sources() < before
    cell(0)
    run("convert", "part.nc", "-o", "out")
    assert sources() == {"part.src"}
    cell(20)
    run("convert", "part.nc", "-o", "out")
    assert "part.src" not in sources()


def test_a_part_that_was_changed_is_not_removed():
    run("convert", "part.nc", "-o", "out")
    last = max(Path("out").glob("part[0-9].src"))
    last.write_text("mine")
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    write_zigzag(5)
    assert last.name in run("convert", "part.nc", "-o", "out", code=1).stderr
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before
    run("convert", "part.nc", "-o", "out", "--overwrite")
    assert not last.exists()


def test_a_file_of_somebody_else_in_the_way_is_kept():
    Path("out").mkdir()
    Path("out/part2.src").write_text("mine")
    assert "part2.src" in run("convert", "part.nc", "-o", "out", code=1).stderr
    assert sources() == {"part2.src"}


def test_what_an_earlier_run_wrote_is_set_aside_whole():
    run("convert", "part.nc", "-o", "out")
    Path("part.nc").write_text(PLUNGE + "G1 X1e9\n")
    run("convert", "part.nc", "-o", "out", code=1)
    assert not sources()
    assert Path("out/partMain.src.old").exists()


def test_another_program_of_the_run_is_not_replaced():
    cell(45)
    write_zigzag(5, "part2.nc")
    done = run("convert", "part.nc", "part2.nc", "-o", "out", code=1)
    assert "part.nc also writes part2.src" in done.stderr
    assert "also written in this run" in done.stderr
    text = Path("out/part2.src").read_text()
    assert "part=2" not in text
    write_zigzag(5)
    run("convert", "part.nc", "part2.nc", "-o", "short")
    assert sources("short") == {"part.src", "part2.src"}


def test_a_renamed_program():
    run("convert", "part.nc", "-o", "out", "--name", "job")
    assert {"jobMain.src", "job1.src", "job2.src"} <= sources()
    Path("long.src").write_bytes(
        b"DEF long( )\r\n$VEL.CP=0.05\r\n"
        + b"".join(b"LIN {X %d,Y 0,Z 0,A 20,B 0,C 180}\r\n" % n for n in range(40))
        + b"END\r\n"
    )
    run("convert", "long.src", "-o", "out", "--name", "other")
    assert {"otherMain.src", "other1.src"} <= sources()
    assert "long" not in Path("out/otherMain.src").read_text()


def test_rapid_is_not_divided():
    abb = CELL_FILE.with_name("cell_irb6700.toml").read_text()
    Path("cell.toml").write_text(abb.replace("[output]", "[output]\nlines_per_file = 20"))
    done = run("convert", "part.nc", "-o", "out", "--to", "rapid")
    assert "lines_per_file divides only KRL" in done.output
    assert {path.suffix for path in Path("out").iterdir()} == {".mod", ".csv", ".html", ".json"}


def test_a_subprogram_of_another_file_is_written_beside_the_parts_and_read_back():
    pose = "Y 0,Z 0,A 0,B 0,C 180}"
    lines = "".join(f"LIN {{X {n},{pose} C_DIS\nsub()\n" for n in range(12))
    joints = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}"
    Path("cut.src").write_text(
        f"DEF cut()\nBAS(#INITMOV,0)\n$VEL.CP=0.05\n{joints}\n;FORCE FX=200 FY=0 FZ=-100\n{lines}END\n"
    )
    Path("sub.src").write_text(f"DEF sub()\nLIN {{X 5.5,{pose}\nEND\n")
    run("convert", "cut.src", "-o", "out")
    assert sources() == {"cutMain.src", "cut1.src", "cut2.src", "sub.src"}
    assert "LIN {X 5.5,Y 0," not in Path("out/sub.src").read_text()
    run("predict", "out/cutMain.src", "-o", "held")
