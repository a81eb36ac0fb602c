from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from postproc.errors import Issue, ProgramError
from tests import fabricated
from tests.commands import invoke
from tests.kr270 import FOLDER
from tests.places import CELL_FILE, SAMPLES

CELL_270, CELL_16 = str(CELL_FILE), str(SAMPLES / "cell_kr16.toml")


@pytest.fixture
def computed(monkeypatch):
    """Replace the computation by made-up results; the name of the program chooses what happens."""

    def read(documents, *_):
        if documents[0].name.startswith("bad"):
            raise ProgramError("odd word", file=documents[0].name, line=7, text="G999", advice="Remove it.")
        return documents[0].name

    def process(name, _robot, _cell, _rows, mode, **_):
        result = fabricated.result(mode=mode)
        if name.startswith("far"):
            issue = Issue("error", "unreachable", "out of reach", 12, count=3)
            return fabricated.with_changes(result, issues=(issue,), documents=())
        return result

    monkeypatch.setattr("postproc.correction.read", read)
    monkeypatch.setattr("postproc.correction.process", process)


def _touch(*names: str) -> None:
    for name in names:
        Path(name).write_text("G0 X0\n")


def test_one_program_prints_its_summary_and_what_was_written(work_folder, computed):
    _touch("part.nc")
    done = invoke("convert", "part.nc", "--cell", CELL_270)
    assert done.exit_code == 0
    assert "improvement" in done.stdout
    assert done.stdout.splitlines()[-1] == (
        "written to corrected: part.src, part.targets.csv, part.report.html, part.report.json"
    )
    assert done.stderr == ""


def test_many_programs_print_a_table_and_the_worst_exit_code(work_folder, computed):
    _touch("a.nc", "bad.nc", "far.nc")
    done = invoke("convert", "*.nc", "--cell", CELL_270)
    assert done.exit_code == 1
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:5]] == ["a.nc", "bad.nc", "far.nc", "all"]
    assert "Error: bad.nc:7: odd word. Text: 'G999'. Remove it." in done.stderr
    assert "error: far.nc:12: out of reach (3 times)" in done.stderr
    assert "far.nc: nothing is written" in done.stderr


def test_json_prints_json_only(work_folder, computed):
    _touch("a.nc", "far.nc", "bad.nc")
    done = invoke("convert", "*.nc", "--cell", CELL_270, "--json")
    content = json.loads(done.stdout)
    assert content["exit_code"] == done.exit_code == 1
    good, bad, far = content["programs"]
    assert good["before"]["max_mm"] == pytest.approx(1.5, abs=1e-3)
    assert len(good["written"]) == 4
    assert "odd word" in bad["error"]
    assert far["issues"][0]["source_line"] == 12


def test_predict_writes_reports_and_no_program(work_folder, computed):
    _touch("part.nc")
    done = invoke("predict", "part.nc", "--cell", CELL_270, "-o", "out")
    assert done.exit_code == 0
    assert sorted(path.name for path in Path("out").iterdir()) == [
        "part.predict.report.html",
        "part.predict.report.json",
        "part.predict.targets.csv",
    ]


def test_nominal_beyond_a_stated_tolerance_is_written_and_exits_with_3(work_folder, computed):
    _touch("part.nc")
    done = invoke("convert", "part.nc", "--cell", CELL_270, "--nominal", "--tolerance", "0.1")
    assert done.exit_code == 3
    assert Path("corrected/part.src").exists()
    assert "EXCEEDED" in done.stdout
    assert invoke("convert", "part.nc", "--cell", CELL_270, "--nominal").exit_code == 0


@pytest.mark.parametrize(
    "arguments",
    [
        ["convert"],
        ["convert", "part.nc"],
        ["convert", "part.nc", "--cell", "cell.toml", "--tolerance", "-1"],
        ["convert", "part.nc", "--cell", "cell.toml", "--tolerance", "nan"],
        ["convert", "part.nc", "--cell", "cell.toml", "--tolerance", "1e-9"],
        ["convert", "part.nc", "--cell", "cell.toml", "--tolerance", "inf"],
        ["convert", "part.nc", "--cell", "cell.toml", "--jobs", "0"],
        ["convert", "part.nc", "--cell", "cell.toml", "--jobs", "2", "--scheduler", "tcp://x:1"],
        ["convert", "a.nc", "b.nc", "--cell", "cell.toml", "--forces", "forces.csv"],
        ["convert", "part.nc", "--cell", "cell.toml", "--dialect", "heidenhain"],
        ["predict", ".", "--cell", "cell.toml"],
        ["undo"],
    ],
)
def test_wrong_usage_exits_with_2(work_folder, arguments):
    _touch("a.nc", "b.nc", "forces.csv")
    done = invoke(*arguments)
    assert done.exit_code == 2, done.output
    assert "Error:" in done.stderr


def _edited(text: str, old: str, new: str) -> None:
    assert old in text
    Path("cell.toml").write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("X = 1500.0", "X = nan", "base.X is nan"),
        ("Z = 350.0", "Z = inf", "tool.Z is inf"),
        ("-90", "-inf", r"start.joints[1] is -inf"),
        ("tolerance_mm = 0.01", "tolerance_m = 0.00001", "Valid keys: tolerance_mm, max_correction_mm"),
        ("force_ramp_mm = 1.0", "mass_g = 1.0", "Valid keys: tolerance_mm"),
        ("tolerance_mm = 0.01", "tolerance_mm = -1.0", "tolerance_mm"),
        ("tolerance_mm = 0.01", "tolerance_mm = '0.01'", "tolerance_mm"),
        ('axis = "+Z"', 'axis = "+Y"', "axis"),
        ("joints = [0, -90, 100, 0, 80, 0]", "joints = [0, -70, 110, 0, 50]", "joints"),
        ('robot = "kuka_kr270"', 'robot = "kuka_kr999"', "kuka_kr270"),
        ("[tool]", "[tool", "not valid TOML"),
    ],
)
def test_unusable_cell_exits_with_1_and_names_the_place(work_folder, old, new, message):
    _touch("part.nc")
    _edited(Path(CELL_270).read_text(), old, new)
    done = invoke("convert", "part.nc", "--cell", "cell.toml")
    assert done.exit_code == 1
    assert message in done.stderr
    assert "Traceback" not in done.output
    assert not Path("corrected").exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("line,Fx,Fy,Fz\n9,1,nan,2\n", "forces.csv:2: column Fy is not a finite number"),
        ("line,Fx,Fy,Fz\n9,1,inf,2\n", "forces.csv:2: column Fy is not a finite number"),
        ("line,Fx,Fy\n9,1,2\n", "missing column Fz"),
        ("line,Fx,Fy,Fz,Fq\n9,1,2,3,4\n", "unknown column 'Fq'"),
        ("line,Fx_kN,Fy,Fz\n9,1,2,3\n", "unknown column 'Fx_kN'"),
        ("line,Fx,Fy,Fz\n9,1,2\n", "forces.csv:2: 3 values where the header has 4"),
        ("line,Fx,Fy,Fz\n2,1,2,3\n", "no motion starts on line 2"),
        ("line,Fx,Fy,Fz\n9,1,2,3\n9,1,2,3\n", "a second row for line 9"),
        ("", "empty file"),
        (b"\x00\xff\xfe", "not UTF-8"),
    ],
)
def test_unusable_forces_exit_with_1_and_name_the_place(work_folder, content, message):
    Path("forces.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    program = str(SAMPLES / "long_lin.src")
    done = invoke("convert", program, "--cell", CELL_16, "--forces", "forces.csv", "-o", "out")
    assert done.exit_code == 1
    assert message in done.stderr
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("compliance_urad_per_Nm = 0.623", "compliance_urad_per_Nm = nan"),
        ("compliance_urad_per_Nm = 0.623", "compliance_mrad_per_Nm = 0.000623"),
        ("compliance_urad_per_Nm = 0.623", "compliance_urad_per_Nm = 0.0"),
        ("[joints.A1]", "[joints.A7]"),
    ],
)
def test_unusable_robot_model_exits_with_1_and_names_the_file(work_folder, old, new):

    Path("my_robot").mkdir()
    for file in FOLDER.iterdir():
        Path("my_robot", file.name).write_text(file.read_text().replace(old, new))
    _edited(Path(CELL_270).read_text(), "kuka_kr270", "my_robot")
    _touch("part.nc")
    done = invoke("convert", "part.nc", "--cell", "cell.toml")
    assert done.exit_code == 1
    assert "model.toml" in done.stderr


def test_robot_with_a_nan_in_its_urdf_is_refused(work_folder):

    Path("my_robot").mkdir()
    for file in FOLDER.iterdir():
        Path("my_robot", file.name).write_text(file.read_text().replace("1.25", "nan", 1))
    assert "nan" in Path("my_robot/robot.urdf").read_text()
    _edited(Path(CELL_270).read_text(), "kuka_kr270", "my_robot")
    _touch("part.nc")
    assert invoke("convert", "part.nc", "--cell", "cell.toml").exit_code == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"\r\n\r\n", "empty"),
        (b"PK\x03\x04\x00\x00", "binary"),
        (b"DEF part()\nPTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}\nLIN {X 100,Y 1", "part.src:3"),
        (b"DEF part()\nEND\n", "part.src"),
        (b"DEF part()\nLIN {X NaN,Y 0,Z 0,A 0,B 0,C 0}\nEND\n", "part.src:2"),
    ],
)
def test_unusable_program_exits_with_1_and_names_the_line(work_folder, content, message):
    Path("part.src").write_bytes(content)
    done = invoke("convert", "part.src", "--cell", CELL_270)
    assert done.exit_code == 1
    assert message in done.stderr
    assert "report it" not in done.stderr
    assert not Path("corrected").exists()


def _aggregate(joints: list[float]) -> str:
    """Where the tool of the KR 270 cell stands at A1…A6 [deg], as KRL."""
    from postproc import jobs, kinematics
    from postproc.frames import inverse, xyzabc_from_pose

    cell, model = jobs.load_setup(jobs.Settings(Path(CELL_270)))
    pose = kinematics.tcp(model.nominal, np.radians([joints]), cell.tool.pose())[0][0]
    values = xyzabc_from_pose(inverse(cell.base.pose()) @ pose)
    return "{" + ",".join(f"{name} {value:.5f}" for name, value in zip("XYZABC", values, strict=True)) + "}"


@pytest.mark.parametrize(
    ("moves", "line", "message"),
    [
        (["LIN {X 5000,Y 0,Z 0,A 180,B 0,C 180}"], 3, "out of reach"),
        ([[0, -70, 110, 0, 30, 0], "PTP {A1 0,A2 10,A3 110,A4 0,A5 50,A6 0}"], 4, "A2 = 10.000° is outside its limits"),
        ([[0, -70, 110, 0, 20, 0], [0, -70, 110, 0, -20, 0]], 4, "singularity"),
    ],
)
def test_moves_that_cannot_be_done_exit_with_1_and_name_the_line(work_folder, moves, line, message):
    texts = [f"LIN {_aggregate(move)}" if isinstance(move, list) else move for move in moves]
    head = ["DEF part()", "PTP {A1 0,A2 -70,A3 110,A4 0,A5 20,A6 0}"]
    Path("part.src").write_text("\n".join([*head, *texts, "END", ""]))
    done = invoke("convert", "part.src", "--cell", CELL_270)
    assert done.exit_code == 1
    assert f"part.src:{line}" in done.stderr
    assert re.search(message, done.stderr)
    assert not Path("corrected").exists()


def test_a_force_file_that_lies_beside_and_is_not_given_is_named(work_folder):
    Path("part.nc").write_text("G21 G90\nG0 X0 Y0 Z20\nG1 Z-2 F600\nX40\nM30\n")
    assert "is next to it" not in invoke("predict", "part.nc", "--cell", CELL_270, "-o", "out").stdout
    Path("part.forces.csv").write_text("line,Fx,Fy,Fz\n4,-100,50,20\n")
    said = invoke("predict", "part.nc", "--cell", CELL_270, "-o", "out").stdout
    assert "give --forces part.forces.csv to use part.forces.csv, which is next to it" in said
    said = invoke("predict", "part.nc", "--cell", CELL_270, "--forces", "part.forces.csv", "-o", "out").stdout
    assert "is next to it" not in said


@pytest.mark.parametrize("command", [[], ["convert"], ["predict"], ["robots"]])
def test_every_command_has_help_with_an_example(command):
    done = invoke(*command, "--help")
    assert done.exit_code == 0
    assert "Example" in done.stdout
    assert "postproc" in done.stdout.split("Example")[1]
    assert "\\b" not in done.stdout


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from postproc.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "print(sorted({'numpy', 'scipy', 'pinocchio', 'trimesh', 'rich', 'msgspec', 'pygcode'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_console_that_cannot_show_a_character_is_no_reason_to_stop():
    environment = {**os.environ, "PYTHONIOENCODING": "iso8859-2"}
    done = subprocess.run(
        [sys.executable, "-c", "from postproc.cli import main; main()", "robots", "kuka_kr270"],
        capture_output=True,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert b"?rad/(N?m)" in done.stdout


def test_real_program_is_converted_in_a_process_of_its_own(work_folder):
    done = subprocess.run(
        [sys.executable, "-c", "from postproc.cli import main; main()", "convert", str(SAMPLES / "inline.src"),
         "--cell", CELL_270, "-o", "out", "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (entry,) = json.loads(done.stdout)["programs"]
    report = json.loads(Path("out/inline.report.json").read_text())
    assert report["after"]["max_mm"] < 0.0011
    assert {**report, "program": entry["program"]}.items() <= entry.items()
    rows = Path("out/inline.targets.csv").read_text().splitlines()
    assert len(rows) == report["targets"] + 1
    written = Path("out/inline.src").read_text().splitlines()
    lines = [int(row.split(",")[0]) for row in rows[1:]]
    assert all(written[line - 1].split()[0] in ("LIN", "PTP", "CIRC") for line in lines)


def test_a_krl_program_is_written_under_another_name(work_folder):
    sample = str(SAMPLES / "inline.src")
    assert invoke("convert", sample, "--cell", CELL_270, "-o", "out").exit_code == 0
    assert invoke("convert", sample, "--cell", CELL_270, "-o", "named", "--name", "Other_1").exit_code == 0
    assert {path.name for path in Path("named").iterdir()} == {
        path.name.replace("inline", "Other_1") for path in Path("out").iterdir()
    }
    for ending, head in ((".src", "DEF"), (".dat", "DEFDAT")):
        text = Path("out", f"inline{ending}").read_text()
        lines = zip(text.splitlines(), Path("named", f"Other_1{ending}").read_text().splitlines(), strict=True)
        changed = [(a, b) for a, b in lines if a != b and ";POSTPROC" not in a]
        assert len(changed) == 1
        assert changed[0][1].split("(")[0].split()[:2] == [head, "Other_1"]
    assert invoke("predict", "named/Other_1.src", "--cell", CELL_270, "-o", "predicted").exit_code == 0
    again = invoke("convert", "named/Other_1.src", "--cell", CELL_270, "-o", "again")
    assert again.exit_code == 1
    assert "corrected by postproc" in again.stderr


def test_processes_give_the_same_files_as_one_after_the_other(work_folder):
    source = (SAMPLES / "inline.src").read_bytes()
    for index in range(3):
        Path(f"p{index}.src").write_bytes(source.replace(b"DEF inline", f"DEF p{index}".encode()))
        Path(f"p{index}.dat").write_bytes((SAMPLES / "inline.dat").read_bytes().replace(b"  inline", b"  p%d" % index))
    assert invoke("convert", ".", "--cell", CELL_270, "-o", "one").exit_code == 0
    done = subprocess.run(
        [sys.executable, "-c", "from postproc.cli import main; main()", "convert", ".", "--cell", CELL_270, "-o", "two",
         "--jobs", "2"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    table = done.stdout.splitlines()[1:5]
    assert [line.split()[0] for line in table] == ["p0.src", "p1.src", "p2.src", "all"]
    one = {path.name: path.read_bytes() for path in Path("one").iterdir()}
    two = {path.name: path.read_bytes() for path in Path("two").iterdir()}
    assert one.pop("index.html") != two.pop("index.html")  # each says which folder it is of
    assert len(one) == 15
    assert one == two


def test_a_program_in_which_nothing_was_corrected_says_so_in_its_first_line(work_folder):
    stand = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 20}"
    cut = [f"LIN {{X {x},Y 0,Z 10,A 0,B 0,C 180}}" for x in (0, 50)]
    lines = ["DEF part()", "BAS(#INITMOV,0)", "$VEL.CP=0.05", stand, ";FORCE FX=200 FY=100 FZ=-100"]
    loop = ["WHILE $IN[1]", *cut, "ENDWHILE", stand, "END", ""]
    Path("part.src").write_text("\n".join([*lines, *loop]))
    told = invoke("convert", "part.src", "--keep-unresolved", cell=CELL_270).output
    first = told.splitlines()[0]
    assert first == "part.src  on kuka_kr270: Nothing was corrected: 2 motions and calls stay as they are."
    assert "\n  - Nothing was corrected: 2 motions and calls stay as they are.\n" in told
    assert "Nothing to correct" not in told
    Path("part.src").write_text("\n".join([*lines, *cut, *loop]))
    told = invoke("convert", "part.src", "--keep-unresolved", "--overwrite", cell=CELL_270).output
    assert "Nothing was corrected" not in told
    assert "compensated" in told
