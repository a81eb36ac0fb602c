"""`predict --process`: the tool cuts where it gives way to."""

from __future__ import annotations

import json
import math
from functools import partial

import numpy as np
import pytest
from scipy.optimize import fixed_point

from postproc import correction, jobs
from postproc.cli import outcomes
from postproc.jobs import process_forces
from postproc.machining import sweep
from tests.commands import invoke, run
from tests.effort import calls
from tests.machining.setting import AL7075, CELL, ROBOT, gcode, process, read, tool
from tests.machining.test_closed_forms import altintas
from tests.places import SAMPLES

BOX = ((0, 200), (-40, 0), (-20, 0))
TEXT = gcode("G0 X-15 Y3 Z5", "G1 Z-6 F2400", "X215 (here)", "G0 Z5")
WIDTH, DEPTH, RADIUS = 5.0, 6.0, 8.0


def test_force_and_deflection_agree_as_in_closed_form(tmp_path):
    """Stock on the right: the tool is pushed off and up, and cuts less wide and less deep by that."""
    program = read(tmp_path, TEXT)
    (tmp_path / "process.toml").write_text(process(tool(16, 3), BOX, 0.25))
    source = process_forces.read(tmp_path / "process.toml", CELL)
    nominal = correction.process(program, ROBOT, CELL, source, "predict")
    result, _ = process_forces.predict_in_material(program, ROBOT, CELL, source)
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
        run(command, tmp_path / "part.nc", *given, "-o", tmp_path / command, code=(0, 3))
    told = json.loads((tmp_path / "predict" / "part.predict.report.json").read_text())
    (cut,) = [issue for issue in told["issues"] if issue["kind"] == "real-cut"]
    assert cut["level"] == "info"
    assert int(cut["message"].partition("(")[2].split()[0]) <= 3
    assert "The corrected program has the nominal engagement" in cut["message"]
    assert (tmp_path / "predict" / "part.predict.stock.glb").stat().st_size > 1000
    assert {path.name for path in (tmp_path / "convert").iterdir()} == {
        "part.src", "part.forces.csv", "part.targets.csv", "part.report.html", "part.report.json", "part.stock.glb",
    }  # fmt: skip


@pytest.mark.parametrize(("y", "is_named"), [(-20, True), (3, False)])
def test_it_is_said_where_the_tool_moves_aside_of_the_command(tmp_path, y, is_named):
    """At the exit of a slot the force goes within a millimetre; that of a narrow cut goes slowly."""
    program = read(tmp_path, gcode(f"G0 X-15 Y{y} Z5", "G1 Z-4 F1800", "X215 (here)", "G0 Z5"))
    (tmp_path / "process.toml").write_text(process(tool(12, 3), BOX, 0.5))
    source = process_forces.read(tmp_path / "process.toml", CELL)
    result, _ = process_forces.predict_in_material(program, ROBOT, CELL, source)
    asides = [issue for issue in result.issues if issue.kind == "aside-of-command"]
    assert [(issue.level, issue.source_line) for issue in asides] == [("info", 6)] * is_named


def test_process_and_forces_exclude_each_other(tmp_path):
    given = ["--cell", "cell.toml", "--process", "p.toml", "--forces", "f.csv"]
    made = invoke("convert", "part.nc", *given)
    assert made.exit_code == 2
    assert "exclude each other" in made.output


@pytest.mark.parametrize("name", ["p.csv", "p"])
def test_a_process_is_toml(name):
    made = invoke("predict", "part.nc", "--process", name, cell="cell.toml")
    assert made.exit_code == 2


def test_sweeps_of_the_stock_are_shown_on_a_terminal(tmp_path, monkeypatch):
    """Nominal sweep and those of the deflected tool, each from its first segment to its last."""
    from rich.progress import Progress

    shown, update = [], Progress.update

    def seen(self, task, **given):
        if "completed" in given:
            shown.append((given["completed"], given["total"], given["visible"]))
        return update(self, task, **given)

    monkeypatch.setattr(Progress, "update", seen)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    read(tmp_path, TEXT)
    (tmp_path / "process.toml").write_text(process(tool(16, 3), BOX, 1.0))
    settings = jobs.Settings(cell=SAMPLES / "cell_kr270.toml", mode="predict")
    found = jobs.find_jobs([str(tmp_path / "part.nc")], output=tmp_path / "out", forces=tmp_path / "process.toml")
    (outcome,) = outcomes._show_progress(partial(jobs.convert_all, found, settings), 1)
    assert outcome.summary is not None
    ends = [row for row in shown if row[0] == row[1]]
    assert len(ends) >= 2
    assert not any(visible for _, _, visible in ends)
    assert all(visible for done, of, visible in shown if done < of)
    assert len(shown) > len(ends)


def _surface():
    """A ball cutter over a wavy surface in moves of 3 mm: its deflection changes all the time."""
    x = np.linspace(-10, 210, 75)
    z = -6 + 3 * np.sin(x / 20)
    points = [(a, -4.0 * row, b) for row in range(6) for a, b in list(zip(x, z, strict=True))[:: 1 - 2 * (row % 2)]]
    return gcode("G0 X-10 Y0 Z5", *(f"G1 X{a:.3f} Y{y:.3f} Z{b:.3f} F3000" for a, y, b in points), "G0 Z20")


def _holes():
    places = [f"X{10 + 15 * (k % 12)} Y{-10 - 10 * (k // 12)}" for k in range(12)]
    return gcode("G0 X10 Y-10 Z5", f"G98 G83 {places[0]} Z-12 R2 Q3 F400", *places[1:], "G80")


@pytest.mark.parametrize(
    ("text", "cutter"),
    [(_surface(), tool(10, 4, "ball")), (_holes(), tool(8, 2, "drill")), (TEXT, tool(16, 3))],
    ids=["surface", "holes", "slot"],
)
def test_the_cut_of_a_deflected_tool_costs_three_times_a_conversion_at_most(tmp_path, text, cutter, monkeypatch):
    """In calls of functions. A displaced path is as many groups of segments as the programmed one."""
    program, groups = read(tmp_path, text), []
    (tmp_path / "process.toml").write_text(process(cutter, BOX, 0.5))
    grouped = sweep.Sweep._groups

    def counted(self, segments, near):
        found = list(grouped(self, segments, near))
        groups.append(len(found))
        return iter(found)

    monkeypatch.setattr(sweep.Sweep, "_groups", counted)

    def source():
        return process_forces.read(tmp_path / "process.toml", CELL)

    correction.process(program, ROBOT, CELL, source())  # imports
    convert = calls(lambda: correction.process(program, ROBOT, CELL, source()))
    groups.clear()
    predict = calls(lambda: process_forces.predict_in_material(program, ROBOT, CELL, source()))
    assert predict <= 3.0 * convert
    assert max(groups) <= 1.25 * groups[0] + 1
