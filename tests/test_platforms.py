"""Windows: what is installed there, and files as they are written there.

There is no Windows here: what can be told from the packages and from the files is tested.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.commands import invoke, run
from tests.kr270 import CELL_TEXT, ROBOT
from tests.places import CELL_FILE, ROOT
from tests.robot_urdfs import ROS, ros_urdf

WINDOWS = {"sys_platform": "win32", "platform_system": "Windows", "os_name": "nt", "extra": ""}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
COMPILED = (".so", ".pyd", ".dylib", ".dll")


def on_windows(requirements: list[str]) -> list[Requirement]:
    parsed = [Requirement(text) for text in requirements]
    return [each for each in parsed if each.marker is None or each.marker.evaluate(WINDOWS)]


def installed_on_windows() -> dict[str, Requirement]:
    """All that pip brings to Windows with postproc: name → as it is asked for."""
    found: dict[str, Requirement] = {}
    waiting = on_windows(PROJECT["dependencies"])
    while waiting:
        each = waiting.pop()
        if canonicalize_name(each.name) in found:
            continue
        found[canonicalize_name(each.name)] = each
        try:
            waiting += on_windows(distribution(each.name).requires or [])
        except PackageNotFoundError:  # colorama, which click asks for on Windows alone
            continue
    return found


def is_pure_python(name: str) -> bool:
    """Whether a package that is installed here holds nothing compiled."""
    try:
        files = distribution(name).files or []
    except PackageNotFoundError:
        return False
    return bool(files) and not any(file.name.endswith(COMPILED) for file in files)


def pip_for_windows(*requirements: str) -> subprocess.CompletedProcess[str]:
    platform = ["--platform", "win_amd64", "--implementation", "cp", "--python-version", "3.11"]
    tags = ["--abi", "cp311", "--abi", "abi3", "--abi", "none"]
    command = ["install", "--dry-run", "--ignore-installed", "--no-deps", "--only-binary=:all:", "--target", "unused"]
    return subprocess.run(
        [sys.executable, "-m", "pip", *command, *platform, *tags, *requirements],
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@cache
def index_is_there() -> bool:
    return pip_for_windows("packaging").returncode == 0


def test_pinocchio_is_not_asked_for_on_windows_and_nothing_else_is_left_out():
    everywhere = {canonicalize_name(Requirement(text).name) for text in PROJECT["dependencies"]}
    direct = {canonicalize_name(each.name) for each in on_windows(PROJECT["dependencies"])}
    assert everywhere - direct == {"pin"}
    assert {"numpy", "pygcode", "euclid3"} <= set(installed_on_windows())


def test_what_is_installed_on_windows_has_a_wheel_there_or_nothing_compiled():
    compiled = {name: needed for name, needed in installed_on_windows().items() if not is_pure_python(name)}
    assert {"numpy", "scipy"} <= set(compiled)
    if not index_is_there():
        pytest.skip("no package index can be reached")
    done = pip_for_windows(*(str(needed).partition(";")[0] for needed in compiled.values()))
    assert done.returncode == 0, done.stderr


def test_a_package_without_a_wheel_for_windows_would_be_noticed():
    assert not is_pure_python("numpy")
    assert is_pure_python("click")
    if not index_is_there():
        pytest.skip("no package index can be reached")
    assert pip_for_windows("pin>=4.0").returncode != 0


def test_all_but_identify_and_plan_runs_without_pinocchio(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "pinocchio", None)  # an import is an ImportError
    assert invoke("samples", "s").exit_code == 0
    cell = ["--cell", "s/cell_kr270.toml"]
    process = ["--process", "s/plate.process.toml", "-o", "plate.forces.csv"]
    for command in (
        ["convert", "s/pocket.nc", *cell, "-o", "corrected"],
        ["convert", "s/pocket.nc", *cell, "-o", "nominal", "--nominal"],
        ["convert", "s/plate.nc", *cell, "--process", "s/plate.process.toml", "-o", "corrected"],  # forces with sigma
        ["predict", "s/pocket.nc", *cell, "-o", "corrected"],
        ["compare", "nominal/pocket.src", "corrected/pocket.src", *cell, "-o", "compared"],
        ["forces", "s/plate.nc", *cell, *process],
        ["robots", "kuka_kr270"],
        ["init", "--robot", "kuka_kr270", "--base", "1500,0,700", "--tool", "0,0,350"],
    ):
        done = invoke(*command)
        assert done.exit_code in (0, 3), f"{command[0]}: {done.output}"  # 3: a tolerance is exceeded


@pytest.mark.parametrize(
    "arguments",
    [
        ["identify", "elastostatics", "no.csv", "--experiment", "experiment.toml", "-o", "model"],
        ["identify", "geometry", "no.csv", "--experiment", "experiment.toml", "-o", "model"],
        ["identify", "validate", "robot", "no.csv", "--experiment", "experiment.toml"],
        ["plan", "--experiment", "experiment.toml", "--cell", "cell.toml", "--program", "no.nc", "-o", "plan.csv"],
    ],
    ids=lambda arguments: " ".join(arguments[:2]),
)
def test_identify_and_plan_say_at_once_that_pinocchio_is_missing_and_how_to_get_it(arguments, tmp_path, monkeypatch):
    """Before the readings are looked for: there are none."""
    monkeypatch.chdir(tmp_path)
    Path("experiment.toml").write_text(
        'robot = "kuka_kr270"\nsigma_mm = 0.03\n[load_point]\nX = 0\nY = 0\nZ = 200\n[points.P1]\nX = 1\nY = 0\nZ = 0\n'
    )
    Path("cell.toml").write_bytes(CELL_FILE.read_bytes())
    arguments = [str(ROOT / "robot_models" / "kuka_kr270") if each == "robot" else each for each in arguments]
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    done = invoke(*arguments)
    assert done.exit_code == 1
    assert "KR 270" in done.stderr
    assert "conda install -c conda-forge pinocchio" in done.stderr
    assert "(WSL)" in done.stderr


def windows_text(path: Path) -> bytes:
    """Return a text file as Windows editors write it: CRLF, and a byte order mark."""
    return b"\xef\xbb\xbf" + path.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", b"\r\n")


def without_origin(path: Path) -> bytes:
    """Return a written program without the line that holds digests of its sources."""
    return b"".join(line for line in path.read_bytes().splitlines(True) if not line.startswith(b";POSTPROC"))


@pytest.mark.parametrize("program", ["pocket.nc", "freeform.nc"])
def test_files_with_the_line_ends_and_marks_of_windows_give_the_same_program(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    forces = ["freeform.forces.csv"] if program == "freeform.nc" else []
    for folder, text in (("unix", Path.read_bytes), ("windows", windows_text)):
        Path(folder).mkdir()
        for name in (program, "cell_kr270.toml", *forces):
            (Path(folder) / name).write_bytes(text(ROOT / "samples" / name))
        cell = ["--cell", f"{folder}/cell_kr270.toml", "-o", f"{folder}/out"]
        run("convert", f"{folder}/{program}", *cell, *(f"--forces={folder}/{name}" for name in forces))
    stem = Path(program).stem
    assert without_origin(Path(f"windows/out/{stem}.src")) == without_origin(Path(f"unix/out/{stem}.src")) != b""
    tables = [Path(f"{folder}/out/{stem}.targets.csv").read_bytes() for folder in ("unix", "windows")]
    assert tables[0] == tables[1]


def test_paths_in_a_cell_may_be_written_with_backslashes(tmp_path, monkeypatch):

    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_bytes(ros_urdf(ROBOT, (1,) * 6, names=ROS).encode())
    assert invoke("robots", "add", "arm.urdf", "-o", "models/mine", "--name", "mine").exit_code == 0
    Path("R1/System").mkdir(parents=True)
    Path("R1/System/$config.dat").write_text("DEFDAT $CONFIG\nBASE_DATA[3]={X 1500,Y -200,Z 700,A 0,B 0,C 0}\nENDDAT\n")
    Path("lib").mkdir()
    Path("lib/raise.src").write_text("DEF raise()\n$VEL.CP=0.1\nEND\n")
    text = CELL_TEXT.partition("[base_data.3]")[0]
    text = text.replace('robot = "kuka_kr270"', "robot = 'models\\mine'\nconfig_dat = 'R1\\System\\$config.dat'")
    Path("cell.toml").write_text(f"{text}\n[krl]\nsearch = ['.\\lib']\n")
    lines = ["DEF part()", "$BASE=BASE_DATA[3]", "raise()", "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}"]
    lines += ["LIN {X 10,Y 10,Z 20,A 180,B 0,C 180}", "LIN {X 60,Y 10,Z 20,A 180,B 0,C 180}", "END"]
    Path("part.src").write_text("\n".join([*lines, ""]))
    run("convert", "part.src", "--cell", "cell.toml")
    assert Path("corrected/part.src").is_file()
