"""Forces along whole programs as `convert` uses them, with default settings, against exact fronts.

What is compared is the RMS of the error along all cutting moves, as a share of the RMS of the force: entries, corners,
retreats and moves shorter than a cell are part of it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from postproc import forces as force_sources
from postproc import machining, toolpath
from postproc.frames import norm
from postproc.under_load import RobotInCell
from tests.machining.setting import AL7075, CELL, ROBOT, gcode, process, read, tool
from tests.oracle import front

BOX = ((0, 80), (-30, 30), (-20, 0))
DEPTH, FEED, RPM, TEETH = 4.0, 2400.0, 12000.0, 3
ALLOWED = 0.06


def in_box(point):
    return (point[:, 0] > 0) & (point[:, 0] < 80) & (np.abs(point[:, 1]) < 30)


def polyline(points, length):
    """Points with none farther than `length` apart."""
    out = [np.asarray(points[0], float)]
    for point in np.asarray(points, float)[1:]:
        number = max(1, math.ceil(np.linalg.norm(point - out[-1]) / length - 1e-9))
        begin = out[-1]
        out += [begin + (point - begin) * (k + 1) / number for k in range(number)]
    return np.array(out)


def circle(centre, radius, begin, end, step=0.05):
    angle = np.linspace(begin, end, max(2, math.ceil(abs(end - begin) * radius / step)))
    return np.stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)], axis=-1)


def slot(length):
    return polyline([(-8, 1.3), (20, 1.3)], length)


def pocket(length):
    points = [(-8, -6), (24, -6), (24, 7), (9, 7), (9, 0.5), (20, 0.5), (20, 3), (12, 3)]
    return polyline(points, length)


def diagonal(length):
    """A contour askew to the cells, with widths of cut of 2.2 mm at its sides and sharp corners."""
    turn = np.array([[math.cos(0.4), -math.sin(0.4)], [math.sin(0.4), math.cos(0.4)]])
    square = [(-9, -9), (9, -9), (9, 9), (-9, 9), (-9, -6.8), (6.8, -6.8), (6.8, 6.8), (-6.8, 6.8)]
    return polyline(np.array(square) @ turn.T + (40, 0), length)


def adaptive(length, radius=6.0, step=1.2):
    """Loops that cut on their front and come back in air, as adaptive clearing makes them."""
    points = []
    for k in range(5):
        centre = (-6.0 + step * k, 2.0)
        loop = circle(centre, radius, -0.5 * math.pi, 1.5 * math.pi, length)
        points += list(loop if not points else loop[1:])
        points.append((centre[0] + step, 2.0 - radius))
    return np.array(points)


def retreats(length):
    """Cuts of 6 mm, after each of which the tool goes 0.4 mm back: its front meets its own face again."""
    points, x = [(-5.0, 0.0)], -5.0
    for _ in range(5):
        points += [(x + 6.0, 0.0), (x + 5.6, 0.0)]
        x += 5.6
    return polyline(points, length)


CASES = {
    "slot in one": (slot, 1e3), "slot of 0.8 mm": (slot, 0.8), "slot of 0.2 mm": (slot, 0.2), "pocket": (pocket, 1e3),
    "pocket of 0.5 mm": (pocket, 0.5), "contour": (diagonal, 1e3), "contour of 0.3 mm": (diagonal, 0.3),
    "adaptive of 0.8 mm": (adaptive, 0.8), "adaptive of 0.3 mm": (adaptive, 0.3), "retreats": (retreats, 1e3),
}  # fmt: skip


def compared(folder, points, diameter=10.0, spacing=0.4, **given):
    """Return forces (n, 3) at places along the path as `convert` uses them, and those expected, `$BASE` axes."""
    text = gcode(
        f"G0 X{points[0][0]:.6f} Y{points[0][1]:.6f} Z5", f"G1 Z-{DEPTH} F{FEED}",
        *(f"X{x:.6f} Y{y:.6f}" for x, y in points[1:]), spindle=f"S{RPM:g} M3",
    )  # fmt: skip
    program = read(folder, text)
    (folder / "process.toml").write_text(process(tool(diameter, TEETH), BOX, **given))
    place = RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, place.start_flange)
    source = machining.ProcessSource(machining.load(folder / "process.toml"), place.spindle)
    found = force_sources.assign(program, path, source, place.spindle, place.ramp)
    exact = front.Path(points, np.arange(len(points) - 1))
    rows = []
    for segment, length in enumerate(exact.length):
        number = max(1, math.ceil(length / spacing))
        rows += [(segment, (k + 0.5) / number) for k in range(number)]
    motion = np.array([segment for segment, _ in rows]) + 2  # behind the approach and the plunge
    t = np.array([share for _, share in rows])
    wrench = found.at(toolpath.at(program, path, motion, t))[:, :3]
    per_tooth = np.full(len(exact.length), FEED / RPM / TEETH)
    weight = np.array(
        [exact.length[segment] / max(1, math.ceil(exact.length[segment] / spacing)) for segment, _ in rows]
    )
    return wrench, front.forces(exact, diameter / 2, TEETH, DEPTH, per_tooth, AL7075, in_box, rows), weight


def rms_error(found, expected, weight):
    return math.sqrt((weight @ norm(found - expected) ** 2) / (weight @ norm(expected) ** 2))


@pytest.mark.parametrize("name", CASES)
def test_forces_are_where_they_act(tmp_path, name):
    make, length = CASES[name]
    error = rms_error(*compared(tmp_path, make(length)))
    print(f"{name}: RMS {100 * error:.1f} %")
    assert error <= ALLOWED


def test_a_tool_that_is_drawn_back_has_no_force(tmp_path):
    """A tenth of a millimetre behind the cut already, and over all of the retreat less than a tenth of its force."""
    points = retreats(1e3)
    found, expected, _ = compared(tmp_path, points, spacing=0.04)
    backwards = norm(expected) < 1e-9
    backwards &= np.concatenate([[False], norm(expected)[:-1] > 100.0]) | np.roll(backwards, 1)
    first = np.flatnonzero(np.diff(backwards.astype(int), prepend=0) == 1)
    assert len(first) == 5
    for row in first:
        assert norm(found[row + 3 : row + 9]).max() < 1.0
        assert norm(found[row : row + 10]).mean() < 0.1 * norm(found[row - 1 : row])[0]
