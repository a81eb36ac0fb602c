"""The post in a real FreeCAD: a part, a job, posted by FreeCAD's own machinery."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

from postproc.hosts import install_post
from tests.commands import run
from tests.places import CELL_FILE

HERE = Path(__file__).parent
FREECAD = shutil.which("freecadcmd") or shutil.which("FreeCADCmd")

pytestmark = pytest.mark.skipif(FREECAD is None, reason="FreeCAD is not installed (Debian: apt install freecad)")


@pytest.fixture(scope="module")
def posted(tmp_path_factory):
    """What came of several posts of one job: one start of FreeCAD."""
    folder = tmp_path_factory.mktemp("freecad")
    posts = folder / ".local" / "share" / "FreeCAD" / "Macro"
    posts.mkdir(parents=True)
    install_post("freecad", posts)
    for name in ("out", "cut", "round", "by", "a", "b", "c", "d"):  # FreeCAD asks for a folder that is not there
        (folder / name).mkdir()
    (folder / "taken").write_text("a file where a folder should be")
    by_material = f"--cell {CELL_FILE} --material al_6082_t6_carbide"
    ours = {"processor": "kuka_compensated", "arguments": f"--cell {CELL_FILE}"}
    runs = {
        "linuxcnc": {"processor": "linuxcnc", "arguments": "--no-show-editor", "file": str(folder / "theirs.ngc")},
        "corrected": {**ours, "file": str(folder / "out" / "bracket.src")},
        "nominal": {
            **ours,
            "arguments": f"--cell {CELL_FILE} --nominal --name flat --out-dir {folder / 'flat'}",
            "file": str(folder / "x.src"),
        },
        "no cell": {**ours, "arguments": f"--cell {folder / 'none.toml'}", "file": str(folder / "a" / "bad.src")},
        "no argument": {**ours, "arguments": "", "file": str(folder / "b" / "bad.src")},
        "no folder": {
            **ours,
            "arguments": f"--cell {CELL_FILE} --out-dir {folder / 'taken'}",
            "file": str(folder / "a" / "bad.src"),
        },
        "far": {**ours, "arguments": f"--cell {folder / 'far.toml'}", "file": str(folder / "c" / "bad.src")},
        "no flutes": {**ours, "arguments": f"{by_material}", "file": str(folder / "a" / "bad.src"), "flutes": 0},
        "v-bit": {**ours, "arguments": f"{by_material}", "file": str(folder / "b" / "bad.src"), "tool": "v-bit"},
        "no material": {
            **ours,
            "arguments": f"--cell {CELL_FILE} --material cheese",
            "file": str(folder / "c" / "bad.src"),
        },
        "two sources": {
            **ours,
            "arguments": f"{by_material} --process {folder / 'x.toml'}",
            "file": str(folder / "d" / "bad.src"),
        },
        "material": {**ours, "arguments": by_material, "file": str(folder / "cut" / "bracket.src")},
        "round": {**ours, "arguments": by_material, "file": str(folder / "round" / "bracket.src"), "stock": "cylinder"},
        "process": {
            **ours,
            "arguments": f"--cell {CELL_FILE} --process {folder / 'cut' / 'bracket.process.toml'}",
            "file": str(folder / "by" / "bracket.src"),
        },
        "still": {**ours, "file": str(folder / "d" / "bad.src"), "inactive": ["Profile", "Pocket", "Drilling"]},
    }
    (folder / "far.toml").write_text(CELL_FILE.read_text().replace("X = 1500.0", "X = 3500.0"))
    (folder / "settings.json").write_text(json.dumps({"runs": list(runs.values())}))
    environment = {**os.environ, "LC_ALL": "C.UTF-8", "HOME": str(folder)}
    done = subprocess.run(
        [FREECAD, str(HERE / "freecad_job.py")],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (folder / "result.json").is_file(), done.stdout[-3000:] + done.stderr[-3000:]
    return folder, dict(zip(runs, json.loads((folder / "result.json").read_text()), strict=True))


def _rows(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_post_gives_what_convert_makes_of_freecads_linuxcnc_post(posted):
    folder, _ = posted
    run("convert", folder / "theirs.ngc", "-o", folder / "theirs", cell=CELL_FILE)
    theirs, ours = (
        _rows(path) for path in (folder / "theirs" / "theirs.targets.csv", folder / "out" / "bracket.targets.csv")
    )
    assert len(theirs) == len(ours) > 80
    assert any((row["X"], row["Y"], row["Z"]) == ("85.000000", "30.000000", "0.000000") for row in ours)  # drilled
    columns = ("X", "Y", "Z", "A", "B", "C", "X_cmd", "Y_cmd", "Z_cmd", "t", "rapid")
    values = [np.array([[float(row[name]) for name in columns] for row in rows]) for rows in (theirs, ours)]
    np.testing.assert_allclose(values[0][:, :9], values[1][:, :9], rtol=0, atol=1e-3)
    np.testing.assert_array_equal(values[0][:, 10], values[1][:, 10])


def test_freecad_is_given_the_text_that_is_written(posted):
    folder, results = posted
    text = (folder / "out" / "bracket.src").read_bytes().decode()
    assert results["corrected"]["texts"] == [text]
    assert "DEF bracket" in text
    assert {path.suffix for path in (folder / "out").iterdir()} >= {".src", ".csv", ".json", ".html", ".txt"}


def test_options_reach_postproc(posted):
    folder, results = posted
    assert "DEF flat" in results["nominal"]["texts"][0]
    assert "mode nominal" in results["nominal"]["texts"][0] or "nominal" in (folder / "flat" / "flat.src").read_text()


@pytest.mark.parametrize(
    ("run", "says"),
    [
        ("no cell", "none.toml"),
        ("no argument", "--cell"),
        ("no folder", "Choose another folder"),
        ("far", "operation "),
        ("still", "moves nothing"),
        ("no flutes", "states no number of flutes"),
        ("v-bit", "forces of the shape 'v-bit' are not known"),
        ("no material", "no material 'cheese'"),
        ("two sources", "exclude each other"),
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_written(posted, run, says):
    folder, results = posted
    assert says in results[run]["error"], results[run]
    assert not list(folder.glob("?/*"))


def test_forces_come_from_stock_tools_and_speeds_of_the_job(posted):
    """The job: a cutter of 6 mm with 2 flutes, 12,000 turns and 1200 mm a minute; a box, 1 mm larger all round."""
    folder, results = posted
    assert "error" not in results["material"], results["material"]
    told = (folder / "cut" / "bracket.process.toml").read_text()
    for line in ('shape = "flat"', "diameter_mm = 6\n", "flutes = 2\n", 'name = "al_6082_t6_carbide"'):
        assert line in told
    assert "X = [-1.000000, 101.000000], Y = [-1.000000, 61.000000], Z = [-1.000000, 21.000000]" in told
    (folder / "own.toml").write_text(told)
    command = ["forces", str(folder / "cut" / "bracket.moves.nc"), "--cell", str(CELL_FILE), "--process"]
    shutil.copy(folder / "cut" / "bracket.moves.txt", folder / "cut" / "bracket.moves.nc")
    done = run(*command, folder / "own.toml", "-o", folder / "own.csv", "--json")
    largest = max(float(row["Fx"]) ** 2 + float(row["Fy"]) ** 2 + float(row["Fz"]) ** 2 for row in _rows(
        folder / "cut" / "bracket.targets.csv"
    )) ** 0.5  # fmt: skip
    assert largest == pytest.approx(json.loads(done.stdout)["tools"][0]["max_force_N"], rel=0.02)
    assert [row["X_cmd"] for row in _rows(folder / "by" / "bracket.targets.csv")] == [
        row["X_cmd"] for row in _rows(folder / "cut" / "bracket.targets.csv")
    ]


def test_stock_that_is_no_box_is_handed_over_as_a_mesh(posted):
    folder, results = posted
    assert "error" not in results["round"], results["round"]
    mesh = trimesh.load(folder / "round" / "bracket.stock.stl")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(np.pi * 65**2 * 22, rel=1e-3)


def test_a_fault_names_operation_and_command(posted):
    _, results = posted
    assert "out of reach" in results["far"]["error"]
    assert "command " in results["far"]["error"]
