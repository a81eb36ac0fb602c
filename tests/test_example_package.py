"""The example of a package that adds to postproc, really installed."""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.places import CELL_FILE, ROOT

PLUGIN = ROOT / "samples" / "plugin"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder that pip installed the example into."""
    folder = tmp_path_factory.mktemp("installed")
    source = folder / "source"
    shutil.copytree(PLUGIN, source)
    options = ["--no-index", "--no-deps", "--no-build-isolation", "--quiet", "--target", str(folder / "site")]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, str(source)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder / "site"


def convert_with_package(site: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(site), str(ROOT)])
    return subprocess.run(
        [sys.executable, "-m", "postproc", "convert", *arguments, "--cell", str(CELL_FILE), "-o", "out"],
        capture_output=True, text=True, check=False, cwd=folder, env=os.environ | {"PYTHONPATH": path},
    )  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    for name in ("part.points", "part.dyn"):
        shutil.copy(PLUGIN / name, tmp_path)
    return tmp_path


def targets(path: Path) -> np.ndarray:
    names = ("t", "X", "Y", "Z", "X_cmd", "Y_cmd", "Z_cmd", "Fx", "Fy", "Fz")
    with path.open(newline="") as file:
        return np.array([[float(row[name]) for name in names] for row in csv.DictReader(file)])


def test_its_format_and_its_forces_give_what_gcode_and_a_table_of_the_same_forces_give(installed, folder):
    done = convert_with_package(installed, folder, "part.points", "--forces", "part.dyn")
    assert done.returncode == 0, done.stderr
    # the same path and forces by hand: 20 mm down, 80, 40, 80 mm, 20 mm up
    lines = ["G21 G90 G94", "G0 X0 Y0 Z20", "G1 Z0 F600", "G1 X80 F1500", "G1 Y40", "G1 X0", "G1 Z20 F600", "M30"]
    (folder / "same.nc").write_text("\n".join(lines))
    after_100 = tuple(a + (b - a) * 75 / 85 for a, b in zip((-120, 80, 40), (-150, 60, 45), strict=True))
    forces = {
        3: [(0, 0, 0, 0), (1, -96, 64, 32)],
        4: [(0, -96, 64, 32), (5 / 80, -120, 80, 40), (1, *after_100)],
        5: [(0, *after_100), (10 / 40, -150, 60, 45), (1, -150, 60, 45)],
        6: [(0, -150, 60, 45), (60 / 80, -150, 60, 45), (1, 0, 0, 0)],
        7: [(0, 0, 0, 0), (1, 0, 0, 0)],
    }
    rows = [f"{line},{t},{x},{y},{z}" for line, knots in forces.items() for t, x, y, z in knots]
    (folder / "same.csv").write_text("\n".join(["line,t,Fx,Fy,Fz", *rows]))
    same = convert_with_package(installed, folder, "same.nc", "--forces", "same.csv")
    assert same.returncode == 0, same.stderr
    mine, other = (targets(folder / "out" / f"{name}.targets.csv") for name in ("part", "same"))
    assert len(mine) > 6  # places inserted where the force bends
    np.testing.assert_allclose(mine, other, atol=2e-4)
    assert np.abs(mine[:, 7]).max() == pytest.approx(150.0)


def test_what_is_wrong_in_its_files_is_told_with_the_line(installed, folder):
    (folder / "part.points").write_text("0 0 20\n1 2\n0 0 0 600\n0 0 0 -600\n")
    done = convert_with_package(installed, folder, "part.points")
    assert done.returncode == 1
    assert "part.points:2: no point" in done.stderr
    assert "part.points:4: no point" in done.stderr
    assert not (folder / "out").exists()


@pytest.mark.parametrize("module", ["points", "dynamometer"])
def test_a_broken_package_explains_itself_and_stops_nothing(installed, folder, module):
    site = folder / "site"
    shutil.copytree(installed, site)
    (site / "postproc_example" / f"{module}.py").write_text("import no_such_module\n")
    done = convert_with_package(site, folder, "part.points", "--forces", "part.dyn")
    assert done.returncode == 1
    assert "postproc-example" in done.stderr
    assert "no_such_module" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (folder / "out").exists()
    shutil.copy(ROOT / "samples" / "pocket.nc", folder)
    assert convert_with_package(site, folder, "pocket.nc").returncode == 0


def test_without_it_the_format_is_not_known(folder):
    done = convert_with_package(folder, folder, "part.points")
    assert done.returncode == 1
    assert "unknown kind of program '.points'" in done.stderr
