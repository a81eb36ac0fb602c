"""A misspelt key, column, name or value is an error that offers the right one: every kind of file, and options."""

from __future__ import annotations

from pathlib import Path

import pytest

from postproc import cell, files, machining
from postproc import robot as robots
from postproc.dialects import registry
from postproc.errors import MeasurementError, PostprocError
from postproc.forces import read as read_forces
from postproc.identification import compensator_geometry
from postproc.identification.readings import COLUMNS, read, read_experiment
from postproc.machining import identification
from postproc.plan import milling
from postproc.program import parse_force_note
from postproc.testpart import probing
from tests.commands import invoke
from tests.kr270 import CELL, FOLDER, ROBOT
from tests.places import SAMPLES

EXPERIMENT = """\
robot = "kuka_kr270"
sigma_mm = 0.01

load_point = {X = 0.0, Y = 0.0, Z = 100.0}

[points]
P1 = {X = 0.0, Y = 0.0, Z = 100.0}
P2 = {X = 0.0, Y = 100.0, Z = 100.0}
P3 = {X = 80.0, Y = 100.0, Z = 100.0}
"""


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def changed(sample: str, before: str, after: str) -> str:
    text = (SAMPLES / sample).read_text(encoding="utf-8")
    assert before in text
    return text.replace(before, after, 1)


def cell_file(folder):
    cell.load(written(folder, "c.toml", changed("cell_kr270.toml", "tolerance_mm", "tolernace_mm")))


def value_of_the_cell(folder):
    text = changed("cell_kr270.toml", "[gcode]", '[gcode]\nredundancy = "pth"')
    cell.load(written(folder, "c.toml", text))


def process_file(folder):
    text = changed("plate.process.toml", "diameter_mm", "diamter_mm")
    machining.load(written(folder, "p.toml", text))


def material(folder):
    text = '[material]\nname = "stainless_austenitc"\n[tools.default]\ndiameter_mm = 10\nflutes = 2\n'
    machining.load(written(folder, "p.toml", text)).law()


def model_file(folder):
    for path in FOLDER.iterdir():
        if path.is_file():
            (folder / path.name).write_bytes(path.read_bytes())
    text = (folder / "model.toml").read_text(encoding="utf-8")
    written(folder, "model.toml", text.replace("[joints.A4]", "[joints.A44]", 1))
    robots.load(folder)


def robot(_):
    robots.find("kuka_kr720")


def experiment(folder):
    read_experiment(written(folder, "e.toml", EXPERIMENT.replace("sigma_mm", "sigm_mm")))


def readings(folder):
    given = read_experiment(written(folder, "e.toml", EXPERIMENT))
    read(written(folder, "m.csv", ",".join(COLUMNS).replace("point", "pont") + "\n"), given)


def point(folder):
    given = read_experiment(written(folder, "e.toml", EXPERIMENT.replace("P1", "front")))
    row = ",".join("frnt" if name == "point" else "0" for name in COLUMNS)
    read(written(folder, "m.csv", ",".join(COLUMNS) + "\n" + row + "\n"), given)


def compensator(folder):
    compensator_geometry.read(written(folder, "k.csv", "q2,makrer,repeat,X,Y,Z\n"))


def forces(folder):
    read_forces(written(folder, "f.csv", "line,Fx,Fy,Fz,frme\n1,0,0,0,BASE\n"))


def frame(folder):
    read_forces(written(folder, "f.csv", "line,Fx,Fy,Fz,frame\n1,0,0,0,FEDE\n"))


def comment(_):
    parse_force_note("FORCE FX=1 FRAME=FEDE", 1, "part.nc")


def cuts(folder):
    identification.read(written(folder, "c.csv", "mode,ap_m,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz,sigma_N\n"))


def mode(folder):
    head = "mode,ap_mm,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz,sigma_N\n"
    identification.read(written(folder, "c.csv", head + "slott,1,,3900,500,1,1,1,1\n"))


def milled_poses(folder):
    path = written(folder, "t.csv", "A1,A2,A3,A4,A5,A6,Fx,Fy,Fz,wight\n")
    milling.from_file(path, ROBOT, CELL)


def probed(folder):
    probing.read(written(folder, "p.csv", "feature,x_mm,y_mm,z_mm,nx,ny,nz,devation_mm\n"))


def dialect(_):
    registry.dialect_of_name("rapidd")


def column_of_two(folder):
    files.read_csv(written(folder, "a.csv", "lenght,width\n1,2\n"), ("length", "width"), (), MeasurementError)


MISSPELT = {
    cell_file: "tolerance_mm", value_of_the_cell: "path", process_file: "diameter_mm", material: "stainless_austenitic",
    model_file: "A4", robot: "kuka_kr270", experiment: "sigma_mm", readings: "point", point: "front",
    compensator: "marker", forces: "frame", frame: "FEED", comment: "FEED", cuts: "ap_mm", mode: "slot",
    milled_poses: "weight", probed: "deviation_mm", dialect: "rapid", column_of_two: "length",
}  # fmt: skip


@pytest.mark.parametrize("reader", MISSPELT, ids=lambda reader: reader.__name__)
def test_the_right_word_is_offered(reader, tmp_path):
    with pytest.raises(PostprocError) as error:
        reader(tmp_path)
    assert f"Did you mean `{MISSPELT[reader]}`?" in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["identify", "elastostatics", "m.csv", "--method", "serail"], "serial"),
        (["install-post", "freeca"], "freecad"),
        (["convert", "part.nc", "--to", "rapidd"], "rapid"),
        (["convert", "part.nc", "--cel", "cell.toml"], "--cell"),
        (["plan", "compensatr"], "compensator"),
        (["identify", "elastostatic"], "elastostatics"),
        (["confert"], "convert"),
        (["robots", "kuka_kr720"], "kuka_kr270"),
    ],
)
def test_the_command_line_offers_the_right_word(arguments, word, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("m.csv", "part.nc"):
        (tmp_path / name).write_text("")
    done = invoke(*arguments)
    assert done.exit_code == 2 or "no robot" in done.stderr
    assert word in done.stderr.replace("postproc " + arguments[0], "").partition("id you mean")[2]
