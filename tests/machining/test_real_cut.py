"""`predict --process`: the tool cuts where it gives way to."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import fixed_point

from postproc import correction
from postproc.cli import main
from postproc.jobs import process_forces
from tests.machining.setting import AL7075, CELL, ROBOT, SAMPLES, gcode, process, read, tool
from tests.machining.test_closed_forms import altintas

BOX = ((0, 200), (-40, 0), (-20, 0))
TEXT = gcode("G0 X-15 Y3 Z5", "G1 Z-6 F2400", "X215 (here)", "G0 Z5")
WIDTH, DEPTH, RADIUS = 5.0, 6.0, 8.0


def test_force_and_deflection_agree_as_in_closed_form(tmp_path):
    """Stock on the right: the tool is pushed off and up, and cuts less wide and less deep by that."""
    program = read(tmp_path, TEXT)
    (tmp_path / "process.toml").write_text(process(tool(16, 3), BOX, 0.25))
    source = process_forces.read(tmp_path / "process.toml", CELL)
    nominal = correction.process(program, ROBOT, CELL, source, "predict")
    result, _ = process_forces.predicted(program, ROBOT, CELL, source)
    row = int(np.argmin(np.abs(result.t - 0.5) + (program.motions.line[result.motion] != 6)))
    other = int(np.argmin(np.abs(nominal.t - result.t[row]) + (nominal.motion != result.motion[row])))
    # how the tip gives way in y and z: by the response to three forces that differ a little
    moments = np.linalg.norm(nominal.wrench[other, 3:])
    assert moments < 10.0
    steps = []
    for k in range(3):
        text = [
            "[operations.T1]",
            *(f"{n} = {100.0 * (j == k)}" for j, n in enumerate(("Fx", "Fy", "Fz"))),
            'frame = "BASE"',
        ]
        (tmp_path / "unit.toml").write_text("\n".join(text))
        unit = correction.process(program, ROBOT, CELL, process_forces.read(tmp_path / "unit.toml", CELL), "predict")
        at = int(np.argmin(np.abs(unit.t - result.t[row]) + (unit.motion != result.motion[row])))
        steps.append(unit.deviation_before[at] / 100.0)
    compliance = np.array(steps).T

    def again(force):
        shift = compliance @ force * 1e3
        width = WIDTH - shift[1]
        depth = DEPTH - shift[2]
        return altintas(3, depth, 2400 / 6000 / 3, AL7075, math.pi - math.acos(1 - width / RADIUS), math.pi)

    expected = fixed_point(again, nominal.wrench[other, :3])
    assert np.linalg.norm(expected - nominal.wrench[other, :3]) > 10.0
    np.testing.assert_allclose(result.wrench[row, :3], expected, atol=0.02 * np.linalg.norm(expected))


def test_it_is_told_and_the_corrected_program_is_that_of_the_nominal_cut(tmp_path):
    read(tmp_path, TEXT)
    (tmp_path / "process.toml").write_text(process(tool(16, 3), BOX, 0.5))
    given = ["--cell", str(SAMPLES / "cell_kr270.toml"), "--process", str(tmp_path / "process.toml")]
    for command in ("predict", "convert"):
        made = CliRunner().invoke(main, [command, str(tmp_path / "part.nc"), *given, "-o", str(tmp_path / command)])
        assert made.exit_code in (0, 3), made.output
    told = json.loads((tmp_path / "predict" / "part.predict.report.json").read_text())
    (cut,) = [issue for issue in told["issues"] if issue["kind"] == "real-cut"]
    assert cut["level"] == "info"
    assert int(cut["message"].partition("(")[2].split()[0]) <= 3
    assert "The corrected program has the nominal engagement" in cut["message"]
    assert (tmp_path / "predict" / "part.predict.stock.glb").stat().st_size > 1000
    assert {path.name for path in (tmp_path / "convert").iterdir()} == {
        "part.src", "part.forces.csv", "part.targets.csv", "part.report.html", "part.report.json", "part.stock.glb",
    }  # fmt: skip


def test_process_and_forces_exclude_each_other(tmp_path):
    given = ["--cell", "cell.toml", "--process", "p.toml", "--forces", "f.csv"]
    made = CliRunner().invoke(main, ["convert", "part.nc", *given])
    assert made.exit_code == 2
    assert "exclude each other" in made.output


@pytest.mark.parametrize("name", ["p.csv", "p"])
def test_a_process_is_toml(name):
    made = CliRunner().invoke(main, ["predict", "part.nc", "--cell", "cell.toml", "--process", name])
    assert made.exit_code == 2
