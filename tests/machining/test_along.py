"""Forces along motions: continuous, in any axes the same, the same by file as in memory."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from postproc import forces as force_sources
from postproc import machining, toolpath
from postproc.cli import main
from postproc.errors import ForceError
from postproc.under_load import RobotInCell
from tests.machining.setting import CELL, ROBOT, SAMPLES, forces, gcode, process, read, tool

BOX = ((0, 100), (-40, 40), (-20, 0))
WAYS = (
    "G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X30", "Y20", "G3 X50 Y0 I0 J-20", "G2 X70 Y-20 I0 J-20", "G1 X90 Y-10 Z-1", "Z-4",
    "Y15", "X110", "G0 Z5",
)  # fmt: skip


def path_forces(program, source):
    place = RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, place.start_flange)
    return path, force_sources.along(program, path, source, place.spindle, place.ramp)


def at(program, path, found, share):
    motion = np.arange(len(program.motions))
    return found.at(toolpath.at(program, path, motion, np.full(len(motion), share)))


@pytest.fixture
def computed(tmp_path):
    program = read(tmp_path, gcode(*WAYS))
    (tmp_path / "process.toml").write_text(process(tool(10, 4), BOX, 0.5))
    return program, machining.load(tmp_path / "process.toml"), tmp_path


def test_forces_have_no_steps(computed):
    program, given, _ = computed
    place = RobotInCell.of(ROBOT, CELL)
    path, found = path_forces(program, machining.ProcessSource(given, place.spindle, place.ramp))
    cutting = np.flatnonzero(~program.motions.rapid[1:] & ~program.motions.rapid[:-1]) + 1
    begin, end = at(program, path, found, 1e-9), at(program, path, found, 1.0)
    assert np.abs(end).max() > 300.0
    np.testing.assert_allclose(begin[cutting], end[cutting - 1], atol=0.1)


def test_what_is_written_is_what_is_in_memory_and_base_axes_are_the_same(computed):
    program, given, folder = computed
    place = RobotInCell.of(ROBOT, CELL)
    path, found = path_forces(program, machining.ProcessSource(given, place.spindle, place.ramp))
    for option in ([], ["--base"]):
        result = CliRunner().invoke(
            main,
            [
                *("forces", str(folder / "part.nc"), "--cell", str(SAMPLES / "cell_kr270.toml"), *option),
                *("--process", str(folder / "process.toml"), "-o", str(folder / "f.csv")),
            ],
        )
        assert result.exit_code == 0, result.output
        _, other = path_forces(program, force_sources.read(folder / "f.csv"))
        bound = 1e-2 if not option else 6.0  # in $BASE axes a force that turns on an arc is linear between places
        for share in (0.2, 0.5, 0.77, 1.0):
            np.testing.assert_allclose(at(program, path, found, share), at(program, path, other, share), atol=bound)


def test_standard_deviations_are_those_of_the_material(tmp_path):
    _, found = forces(tmp_path, gcode(*WAYS), process(tool(10, 4), BOX, 0.5))
    np.testing.assert_allclose(found.along.sigma, 0.15 * np.abs(found.along.wrench))
    text = process(tool(10, 4), BOX, 0.5).replace("[tools.1]", "sigma_percent = 40\n[tools.1]")
    _, found = forces(tmp_path, gcode(*WAYS), text)
    np.testing.assert_allclose(found.along.sigma, 0.40 * np.abs(found.along.wrench))


def test_forces_by_operation(tmp_path):
    text = gcode(
        "(begin operation: Contour 2)", "G0 X0 Y0 Z5", "G1 Z-3 F2400", "X20", "(finish operation: Contour 2)", "X30",
        "N120 X40", "T3 M6", "X50",
    )  # fmt: skip
    program = read(tmp_path, text)
    (tmp_path / "process.toml").write_text(
        '[operations."contour 2"]\nFx = -110\nsigma_percent = 10\n[operations.N120]\nFy = 5\nframe = "BASE"\n'
        "[operations.T3]\nFz = 30\n"
    )
    own = machining.by_operation(program, machining.load(tmp_path / "process.toml"))
    lines = program.motions.line[own.motion].tolist()
    assert lines == [6, 7, 10, 12]
    np.testing.assert_allclose(own.wrench[:, :3], [[-110, 0, 0], [-110, 0, 0], [0, 5, 0], [0, 0, 30]])
    assert own.frame.tolist() == [2, 2, 0, 2]
    assert own.sigma[0, 0] == pytest.approx(11.0)


def test_operations_and_subprograms(tmp_path):
    one = ("G0 X0 Y0 Z5", "(rough)", "G1 Z-3 F2400", "M98 P1", "X30", "M98 P1")
    below = "O1\nY9\nY0\nM99\n"
    (tmp_path / "process.toml").write_text("[operations.rough]\nFx = -110\n")
    process = machining.load(tmp_path / "process.toml")
    whole = read(tmp_path, gcode(*one) + below)
    assert machining.by_operation(whole, process).wrench[:, 0].tolist() == [-110.0] * 6
    (tmp_path / "process.toml").write_text("[operations.rough]\nFx = -110\n[operations.finish]\nFx = -20\n")
    two = read(tmp_path, gcode(*one[:4], "(finish)", *one[4:]) + below)
    with pytest.raises(ForceError, match="not certain") as caught:
        machining.by_operation(two, machining.load(tmp_path / "process.toml"))
    assert caught.value.line == 14


def test_an_operation_that_is_not_there(tmp_path):
    program = read(tmp_path, gcode(*WAYS))
    (tmp_path / "process.toml").write_text("[operations.Pocket]\nFx = -110\n")
    with pytest.raises(ForceError, match="no comment, tool or block"):
        machining.by_operation(program, machining.load(tmp_path / "process.toml"))
