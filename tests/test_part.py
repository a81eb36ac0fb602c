"""`--part`: from a mesh on disk to the page and the PLY."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

from postproc.cli import main
from postproc.correction.process import process
from postproc.jobs import Settings, load_setup, read_program
from postproc.jobs.part_file import read_facets, surface_of
from tests.html_page import read_page

CELL = str(Path(__file__).parents[1] / "samples" / "cell_kr270.toml")
PASSES = "".join(f"G1 X{60 if k % 2 == 0 else 0} Y{4 * k}\nY{4 * k + 4}\n" for k in range(10))
PROGRAM = f"G21 G90\nT1 M6\nS8000 M3\nG0 X0 Y0 Z5\n(FORCE FX=100 FZ=150)\nG1 Z0 F600\n{PASSES}G0 Z20\n"
PROCESS = """[material]
name = "al_7075_t6_carbide"
[tools.1]
diameter_mm = 10.0
flutes = 3
[stock]
box = { X = [0.0, 60.0], Y = [0.0, 40.0], Z = [-5.0, 0.0] }
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("part.nc").write_text(PROGRAM)
    Path("process.toml").write_text(PROCESS)
    box = trimesh.creation.box(extents=(50, 30, 10))
    box.apply_translation((30, 20, -5))
    box.export("part.stl")


def _run(command, *arguments, code=0, folder=True):
    done = CliRunner().invoke(main, [command, *arguments, "--cell", CELL, *(["-o", "out"] if folder else [])])
    assert done.exit_code == code, done.output
    return done


def test_the_face_that_is_milled_is_off_by_the_upright_part_of_the_deviation():
    _run("convert", "part.nc", "--part", "part.stl")
    read = read_page(Path("out/part.report.html").read_bytes())
    facets, corners, at = read.columns("facets"), read.columns("corners"), read.columns()
    touched = facets["place"] >= 0
    height = corners["z"].reshape(-1, 3)
    assert touched[(height > -1e-6).all(axis=1)].all()  # the upper face; without shapes of tools what is near it too
    assert np.isfinite(facets["before"]).tolist() == touched.tolist()
    cutting = at["rapid"] == 0
    low, high = at["bZ"][cutting].min(), at["bZ"][cutting].max()
    upper = (height > -1e-6).all(axis=1)
    assert facets["before"][upper].min() >= low - 1e-4
    assert facets["before"][upper].max() <= high + 1e-4
    assert np.abs(facets["after"][touched]).max() < 1e-3
    assert "Of the surface touched" in read.text("surface")
    assert "No gouge deeper than 0.01 mm" in read.text("surface")
    mesh = trimesh.load("out/part.surface.ply", process=False)
    assert len(mesh.faces) == len(facets["place"])


def test_with_the_shapes_of_the_tools_what_they_do_not_touch_is_not_told():
    cell, robot = load_setup(Settings(Path(CELL)))
    result = process(read_program("part.nc", robot, cell), robot, cell)
    found = surface_of(result, Path("part.stl"), Path("process.toml"))
    upper = (found.corners[:, :, 2] > -1e-9).all(axis=1)
    assert ((found.row >= 0) == upper).all()


def test_gouges_of_a_program_as_it_stands_are_listed_with_their_lines():
    Path("part.nc").write_text(PROGRAM.replace("FZ=150", "FZ=-400"))  # pulled into the part
    _run("convert", "part.nc", "--part", "part.stl", "--nominal", "--tolerance", "0.01", code=3)
    read = read_page(Path("out/part.report.html").read_bytes())
    lines = {int(row["data-source-line"]) for row in read.rows if row["in"] == "surface"}
    assert len(lines) > 5
    assert min(lines) >= 5


def test_a_program_with_two_bases_needs_the_frame_of_the_mesh():
    krl = """DEF two( )
$TOOL = {X 0,Y 0,Z 350,A 0,B 0,C 0}
$BASE = {X 1500,Y -200,Z 700,A 0,B 0,C 0}
$VEL.CP = 0.02
PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}
LIN {X 0,Y 10,Z 5,A 180,B 0,C 180}
;FORCE FZ=150
LIN {X 0,Y 10,Z 0,A 180,B 0,C 180}
LIN {X 60,Y 10,Z 0,A 180,B 0,C 180}
$BASE = {X 1500,Y -180,Z 700,A 0,B 0,C 0}
LIN {X 60,Y 10,Z 0,A 180,B 0,C 180}
LIN {X 0,Y 10,Z 0,A 180,B 0,C 180}
END
"""
    Path("two.src").write_text(krl)
    assert "State the frame of the mesh" in _run("convert", "two.src", "--part", "part.stl", code=1).output
    cell = Path(CELL).read_text() + "\n[part]\nX = 1500.0\nY = -200.0\nZ = 700.0\n"
    Path("cell.toml").write_text(cell)
    done = CliRunner().invoke(main, ["convert", "two.src", "--part", "part.stl", "--cell", "cell.toml", "-o", "out"])
    assert done.exit_code == 0, done.output
    corners, facets = (read_page(Path("out/two.report.html").read_bytes()).columns(n) for n in ("corners", "facets"))
    y = corners["y"].reshape(-1, 3).mean(axis=1)
    assert facets["place"][np.argmin(np.abs(y - 10.0))] >= 0
    assert facets["place"][np.argmin(np.abs(y - 30.0))] >= 0


def test_the_surface_of_an_earlier_run_does_not_stay():
    _run("convert", "part.nc", "--part", "part.stl")
    _run("predict", "part.nc", "--part", "part.stl")
    assert {"part.surface.ply", "part.surface.glb", "part.predict.surface.glb"} <= {
        p.name for p in Path("out").iterdir()
    }
    _run("convert", "part.nc")
    assert not Path("out/part.surface.ply").exists()
    assert Path("out/part.predict.surface.ply").exists()
    _run("predict", "part.nc")
    assert not list(Path("out").glob("*surface*"))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("part.nc", "other.nc", "--part", "part.stl"), 2, "--part goes with one program"),
        (("part.nc", "--part", "gone.stl"), 1, "gone.stl: no mesh that can be read"),
        (("part.nc", "--part", "process.toml"), 1, "process.toml: no mesh that can be read"),
    ],
)
def test_a_part_that_cannot_be_looked_at_is_an_error_and_nothing_is_written(arguments, code, message):
    Path("other.nc").write_text(PROGRAM)
    assert message in _run("convert", *arguments, code=code).output
    assert not Path("out").exists() or not list(Path("out").iterdir())


def test_the_cut_of_a_process_is_shown_along_the_path():
    Path("part.nc").write_text(PROGRAM.replace("G1 Z0", "G1 Z-2"))
    _run("convert", "part.nc", "--process", "process.toml")
    _run("forces", "part.nc", "--process", "process.toml", "-o", "forces.csv", folder=False)
    (tool,) = json.loads(Path("forces.json").read_text())["tools"]
    read = read_page(Path("out/part.report.html").read_bytes())
    text = read.text("cut")
    assert f"Depth of cut, up to {tool['max_depth_mm']:.2f} mm" in text
    assert f"Width of cut, up to {tool['max_width_mm']:.2f} mm" in text
    assert f"Removed, up to {tool['max_removal_mm3_per_s'] * 0.06:.1f} cm³/min" in text
    stock = trimesh.load("out/part.stock.glb", force="mesh")
    assert len(read.columns("stock_faces")["i"]) == len(stock.faces)
    assert read.columns("stock_points")["z"].min() == pytest.approx(-5.0, abs=1e-3)


def test_facets_are_divided_and_cover_the_same_area():
    corners = read_facets(Path("part.stl"))
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert 0.5 * np.linalg.norm(edges, axis=1).sum() == pytest.approx(2 * (50 * 30 + 50 * 10 + 30 * 10) * 1e-6)
    assert len(corners) > 5000
    outward = np.einsum("fi,fi->f", edges, corners.mean(axis=1) - np.array([0.03, 0.02, -0.005]))
    assert (outward > 0.0).all()
