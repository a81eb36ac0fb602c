"""`--part`: from a mesh on disk to the page and the PLY."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from postproc.correction.process import process
from postproc.errors import InputError
from postproc.files import read_facets, reading
from postproc.jobs import Settings, load_setup, read_program
from postproc.jobs.conversion import surface_of
from tests.commands import run
from tests.html_page import read_page
from tests.places import CELL_FILE

PASSES = "".join(f"G1 X{60 if k % 2 == 0 else 0} Y{4 * k}\nY{4 * k + 4}\n" for k in range(5))
PROGRAM = f"G21 G90\nT1 M6\nS8000 M3\nG0 X0 Y0 Z5\n(FORCE FX=100 FZ=150)\nG1 Z0 F600\n{PASSES}G0 Z20\n"
WITHOUT_FORCES = PROGRAM.replace("(FORCE FX=100 FZ=150)", "(the process gives the forces)")
PROCESS = """[material]
name = "al_7075_t6_carbide"
[tools.1]
diameter_mm = 10.0
flutes = 3
[stock]
box = { X = [0.0, 60.0], Y = [0.0, 20.0], Z = [-5.0, 0.0] }
"""
SIDES = (50, 14, 2)
"""Of the part [mm], below the plane of the passes: low, since facets are divided by the longest side."""


def box(path, sides, middle=(30, 10, -1)):
    """Write a box as mesh [mm]."""
    mesh = trimesh.creation.box(extents=sides)
    mesh.apply_translation(middle)
    mesh.export(path)


FINE = reading._SIDES_PER_PART


@pytest.fixture(autouse=True)
def input_files(work_folder, monkeypatch):
    monkeypatch.setattr(reading, "_SIDES_PER_PART", FINE / 3)  # a ninth of the facets, and of the time
    Path("part.nc").write_text(PROGRAM)
    Path("process.toml").write_text(PROCESS)
    box("part.stl", SIDES)


def _run(command, *arguments, code=0, folder=True):
    if "--process" in arguments:  # it computes all forces
        Path("part.nc").write_text(Path("part.nc").read_text().replace("(FORCE FX=100 FZ=150)", "(computed)"))
    return run(command, *arguments, *(["-o", "out"] if folder else []), cell=CELL_FILE, code=code)


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
    assert "Of the surface reached" in read.text("surface")
    assert "The deflection makes no gouge deeper than 0.01 mm" in read.text("surface")
    mesh = trimesh.load("out/part.surface.ply", process=False)
    assert len(mesh.faces) == len(facets["place"])


def test_with_the_shapes_of_the_tools_what_they_do_not_touch_is_not_told():
    cell, robot = load_setup(Settings(CELL_FILE))
    result = process(read_program("part.nc", robot, cell), robot, cell)
    found = surface_of(result, Path("part.stl"), Path("process.toml"))
    upper = (found.corners[:, :, 2] > -1e-9).all(axis=1)
    assert ((found.row >= 0) == upper).all()


def test_the_shape_of_the_tool_of_a_robot_program_is_that_of_its_number():
    cell, robot = load_setup(Settings(CELL_FILE))
    frame = "{X 0,Y 0,Z 350,A 0,B 0,C 0}"
    lines = "".join(f"LIN {{X {x},Y {y},Z 0,A 180,B 0,C 180}}\n" for y in range(0, 22, 4) for x in (0, 60))
    Path("part.dat").write_text(f"DEFDAT part\nTOOL_DATA[7]={frame}\nENDDAT\n")
    Path("part.src").write_text(
        f"DEF part( )\n$VEL.CP=0.02\n$BASE={{X 1500,Y -200,Z 700,A 0,B 0,C 0}}\n$TOOL=TOOL_DATA[7]\n"
        f"PTP {{X 0,Y 0,Z 5,A 180,B 0,C 180}}\n;FORCE FX=100 FZ=150\n{lines}END\n"
    )
    result = process(read_program("part.src", robot, cell), robot, cell)
    reached = {}
    for key in ("7", "8"):
        Path("process.toml").write_text(
            PROCESS.replace("[tools.1]", f"[tools.{key}]\ndiameter_mm = 1\nflutes = 1\n[tools.1]")
        )
        reached[key] = surface_of(result, Path("part.stl"), Path("process.toml")).is_reached.any()
    assert reached == {"7": True, "8": False}


def test_gouges_of_a_program_as_it_stands_are_listed_with_their_lines():
    Path("part.nc").write_text(PROGRAM.replace("FZ=150", "FZ=-400"))  # pulled into the part
    _run("convert", "part.nc", "--part", "part.stl", "--nominal", "--tolerance", "0.01", code=3)
    read = read_page(Path("out/part.report.html").read_bytes())
    lines = {int(row["data-source-line"]) for row in read.rows if row["in"] == "surface"}
    assert len(lines) > 3
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
    box("part.stl", (50, 30, 2), (30, 20, -1))
    assert "State the frame of the mesh" in _run("convert", "two.src", "--part", "part.stl", code=1).output
    cell = CELL_FILE.read_text() + "\n[part]\nX = 1500.0\nY = -200.0\nZ = 700.0\n"
    Path("cell.toml").write_text(cell)
    run("convert", "two.src", "--part", "part.stl", "-o", "out", cell="cell.toml")
    corners, facets = (read_page(Path("out/two.report.html").read_bytes()).columns(n) for n in ("corners", "facets"))
    y = np.where(corners["z"].reshape(-1, 3).min(axis=1) > -1e-6, corners["y"].reshape(-1, 3).mean(axis=1), np.inf)
    assert facets["place"][np.argmin(np.abs(y - 10.0))] >= 0  # of the upper face
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
        (("part.nc", "--part", "gone.stl"), 1, "gone.stl: no such file: mesh of the part"),
        (("part.nc", "--part", "process.toml"), 1, "process.toml: the mesh of the part cannot be read"),
    ],
)
def test_a_part_that_cannot_be_looked_at_is_an_error_and_nothing_is_written(arguments, code, message):
    Path("other.nc").write_text(PROGRAM)
    assert message in _run("convert", *arguments, code=code).output
    assert not Path("out").exists() or not list(Path("out").iterdir())


def test_the_cut_of_a_process_is_shown_along_the_path():
    twice = "G0 Z5\nX0 Y0\nG1 Z-3 F600\nX60\nG0 Z20"
    Path("part.nc").write_text(WITHOUT_FORCES.replace("G1 Z0", "G1 Z-2").replace("G0 Z20", twice))
    _run("convert", "part.nc", "--process", "process.toml")
    _run("forces", "part.nc", "--process", "process.toml", "-o", "forces.csv", folder=False)
    (tool,) = json.loads(Path("forces.json").read_text())["tools"]
    read = read_page(Path("out/part.report.html").read_bytes())
    text = read.text("cut")
    assert f"Depth of cut, up to {tool['max_depth_mm']:.2f} mm" in text
    assert f"Width of cut, up to {tool['max_width_mm']:.2f} mm" in text
    assert f"Removed, up to {tool['max_removal_mm3_per_s'] * 0.06:.1f} cm³/min" in text
    assert "The file is part.stock.glb." in text
    assert Path("out/part.stock.glb").is_file()
    points, faces, edges = (read.columns(f"stock_{name}") for name in ("points", "faces", "edges"))
    assert 1000 < len(faces["i"]) <= 200_000
    assert points["depth"].max() == pytest.approx(3.0, abs=1e-3)  # 5 mm of stock, 2 mm milled off
    assert len(edges["begin"]) > 100
    (rates,) = (plot["traces"][0]["y"] for plot in read.plots if plot["label"].startswith("Removal rate"))
    assert None in rates
    assert min(rate for rate in rates if rate is not None) > 0.0  # nothing is drawn in air


def test_facets_are_divided_and_cover_the_same_area(monkeypatch):
    monkeypatch.setattr(reading, "_SIDES_PER_PART", FINE)
    corners, _ = read_facets(Path("part.stl"))
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    x, y, z = SIDES
    assert 0.5 * np.linalg.norm(edges, axis=1).sum() == pytest.approx(2 * (x * y + x * z + y * z) * 1e-6)
    assert len(corners) > 3000
    outward = np.einsum("fi,fi->f", edges, corners.mean(axis=1) - np.array([0.03, 0.01, -0.001]))
    assert (outward > 0.0).all()


def test_a_mesh_that_does_not_fit_is_stated_before_anything_else():
    """A mesh 3 mm too high: depth and line in the page, the terminal and the JSON; the verdict is no all-clear."""
    Path("process.toml").write_text(PROCESS.replace("-5.0, 0.0", "-5.0, 1.0"))
    box("high.stl", (50, 14, 7), (30, 10, -0.5))
    for program, options in ((PROGRAM, ()), (WITHOUT_FORCES, ("--process", "process.toml"))):
        Path("part.nc").write_text(program)
        done = _run("convert", "part.nc", "--part", "high.stl", *options)
        content = json.loads(Path("out/part.report.json").read_text())
        assert content["surface"]["cut_into_mm"] == pytest.approx(3.0, abs=0.02)
        assert 6 <= content["surface"]["source_line"] <= 17
        assert content["verdict"]["state"] == "warning"
        line = content["surface"]["source_line"]
        assert f"line {line}: the programmed path itself cuts 3.0 mm into the part" in content["verdict"]["reasons"][0]
        assert "the programmed path itself cuts 3.0 mm into the part" in done.output
        read = read_page(Path("out/part.report.html").read_bytes())
        assert "Programmed path cuts into the part 3.0 mm" in read.text("surface")
        assert "he programmed path itself cuts 3.0 mm into the part" in read.text("verdict")
        facets = read.columns("facets")
        assert np.nanmin(facets["programmed"]) == pytest.approx(-3.0, abs=0.02)


@pytest.mark.parametrize(("tolerance", "is_doubted"), [("3.05", True), ("20", False)])
def test_a_cut_into_the_part_and_the_expected_error_together_are_judged_by_the_tolerance(tolerance, is_doubted):
    box("high.stl", (50, 14, 7), (30, 10, -0.5))
    options = ("--part", "high.stl", "--part-tolerance", tolerance)
    _run("convert", "part.nc", *options)
    content = json.loads(Path("out/part.report.json").read_text())
    assert content["part"]["held"]
    assert content["part"]["expected_mm"] > 0.05
    reasons = [text for text in content["verdict"]["reasons"] if "together more than" in text]
    assert bool(reasons) == is_doubted
    if is_doubted:
        assert content["verdict"]["state"] == "warning"
        assert (
            f"cuts 3.0 mm into the part, and the tool may be off by {content['part']['expected_mm']:.2g} mm"
            in reasons[0]
        )


def test_a_mesh_that_fits_is_said_to_fit_and_how_much_of_it_no_tool_reaches():
    Path("part.nc").write_text(WITHOUT_FORCES)
    Path("process.toml").write_text(PROCESS.replace("-5.0, 0.0", "-5.0, 1.0"))
    _run("convert", "part.nc", "--part", "part.stl", "--process", "process.toml")
    surface = json.loads(Path("out/part.report.json").read_text())["surface"]
    assert surface["cut_into_mm"] == 0.0
    assert surface["source_line"] is None
    x, y, z = SIDES
    upper, whole = x * y, 2 * (x * y + x * z + y * z)
    assert surface["reached_percent"] == pytest.approx(100 * upper / whole, abs=0.01)
    text = read_page(Path("out/part.report.html").read_bytes()).text()
    assert f"tools reach {100 * upper / whole:.0f} % of its surface" in text


def test_a_mesh_elsewhere_is_not_the_part():
    Path("part.nc").write_text(WITHOUT_FORCES)
    Path("process.toml").write_text(PROCESS.replace("-5.0, 0.0", "-5.0, 1.0"))
    box("away.stl", (5, 5, 1), (500, 500, 0))
    _run("convert", "part.nc", "--part", "away.stl", "--process", "process.toml")
    verdict = json.loads(Path("out/part.report.json").read_text())["verdict"]
    assert verdict["state"] == "warning"
    assert "no tool reaches the part" in verdict["reasons"][0]


FACET = "facet normal {}\n outer loop\n  vertex 0 0 0\n  vertex 10 0 0\n  vertex 0 10 0\n endloop\nendfacet\n"


@pytest.mark.parametrize(("name", "normal"), [("Gehäuse", "0 0 1"), ("part", "nan nan 1e"), ("part", "a b c")])
def test_ascii_stl_in_any_encoding_and_with_damaged_normals_is_read(name, normal, capfd):
    Path("part.stl").write_bytes(f"solid {name}\n{FACET.format(normal)}endsolid {name}\n".encode("latin-1"))
    corners, _ = read_facets(Path("part.stl"))
    assert corners.reshape(-1, 3).max(axis=0) == pytest.approx([0.01, 0.01, 0.0])
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0).all()
    assert capfd.readouterr() == ("", "")


def test_an_stl_that_breaks_off_is_an_error_without_a_traceback(capfd):
    Path("part.stl").write_text(
        "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0\nendloop\nendfacet\n"
    )
    with pytest.raises(InputError, match=r"has no surface|cannot be read"):
        read_facets(Path("part.stl"))
    assert capfd.readouterr() == ("", "")
