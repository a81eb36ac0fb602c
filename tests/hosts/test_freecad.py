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
from click.testing import CliRunner

from postproc.cli import main
from postproc.hosts import install_post

HERE = Path(__file__).parent
CELL = (HERE.parent.parent / "samples" / "cell_kr270.toml").resolve()
FREECAD = shutil.which("freecadcmd") or shutil.which("FreeCADCmd")

pytestmark = pytest.mark.skipif(FREECAD is None, reason="FreeCAD is not installed (Debian: apt install freecad)")


@pytest.fixture(scope="module")
def posted(tmp_path_factory):
    """What came of several posts of one job: one start of FreeCAD."""
    folder = tmp_path_factory.mktemp("freecad")
    posts = folder / ".local" / "share" / "FreeCAD" / "Macro"
    posts.mkdir(parents=True)
    install_post("freecad", posts)
    for name in ("out", "a", "b", "c", "d"):  # FreeCAD asks for a folder that is not there
        (folder / name).mkdir()
    (folder / "taken").write_text("a file where a folder should be")
    ours = {"processor": "kuka_compensated", "arguments": f"--cell {CELL}"}
    runs = {
        "linuxcnc": {"processor": "linuxcnc", "arguments": "--no-show-editor", "file": str(folder / "theirs.ngc")},
        "corrected": {**ours, "file": str(folder / "out" / "bracket.src")},
        "nominal": {
            **ours,
            "arguments": f"--cell {CELL} --nominal --name flat --out-dir {folder / 'flat'}",
            "file": str(folder / "x.src"),
        },
        "no cell": {**ours, "arguments": f"--cell {folder / 'none.toml'}", "file": str(folder / "a" / "bad.src")},
        "no argument": {**ours, "arguments": "", "file": str(folder / "b" / "bad.src")},
        "no folder": {
            **ours,
            "arguments": f"--cell {CELL} --out-dir {folder / 'taken'}",
            "file": str(folder / "a" / "bad.src"),
        },
        "far": {**ours, "arguments": f"--cell {folder / 'far.toml'}", "file": str(folder / "c" / "bad.src")},
        "still": {**ours, "file": str(folder / "d" / "bad.src"), "inactive": ["Profile", "Pocket", "Drilling"]},
    }
    (folder / "far.toml").write_text(CELL.read_text().replace("X = 1500.0", "X = 3500.0"))
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
    done = CliRunner().invoke(
        main, ["convert", str(folder / "theirs.ngc"), "--cell", str(CELL), "-o", str(folder / "theirs")]
    )
    assert done.exit_code == 0, done.output
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
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_written(posted, run, says):
    folder, results = posted
    assert says in results[run]["error"], results[run]
    assert not list(folder.glob("?/*"))


def test_a_fault_names_operation_and_command(posted):
    _, results = posted
    assert "out of reach" in results["far"]["error"]
    assert "command " in results["far"]["error"]
