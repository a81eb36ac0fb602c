"""Forces and volumes of whole programs as `convert` uses them, with default settings, against exact fronts.

What is compared is the RMS of the error along all cutting moves, as a share of the RMS of the force: entries, corners,
retreats and moves shorter than a cell are part of it. Fronts that are not those of a cylinder in a plane are cut tooth
by tooth.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from postproc import forces as force_sources
from postproc import machining, toolpath
from postproc.frames import norm
from postproc.under_load import RobotInCell
from tests.benchmarks.fronts import divided
from tests.machining.setting import AL7075, CELL, ROBOT, gcode, process, read, tool
from tests.oracle import front
from tests.oracle.teeth import Teeth

BOX = ((0, 80), (-30, 30), (-20, 0))
DEPTH, FEED, RPM, TEETH, RADIUS = 4.0, 2400.0, 12000.0, 3, 5.0
ALLOWED, OF_VOLUME = 0.06, 0.005


def in_box(point):
    return (point[:, 0] > 0) & (point[:, 0] < 80) & (np.abs(point[:, 1]) < 30)


def circle(centre, radius, begin, end, step=0.05):
    angle = np.linspace(begin, end, max(2, math.ceil(abs(end - begin) * radius / step)))
    return np.stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)], axis=-1)


def slot(length):
    return divided([(-8, 1.3), (20, 1.3)], length)


def pocket(length):
    points = [(-8, -6), (24, -6), (24, 7), (9, 7), (9, 0.5), (20, 0.5), (20, 3), (12, 3)]
    return divided(points, length)


def diagonal(length):
    """A contour askew to the cells, with widths of cut of 2.2 mm at its sides and sharp corners."""
    turn = np.array([[math.cos(0.4), -math.sin(0.4)], [math.sin(0.4), math.cos(0.4)]])
    square = [(-9, -9), (9, -9), (9, 9), (-9, 9), (-9, -6.8), (6.8, -6.8), (6.8, 6.8), (-6.8, 6.8)]
    return divided(np.array(square) @ turn.T + (40, 0), length)


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
    return divided(points, length)


CASES = {
    "slot in one": (slot, 1e3), "slot of 0.8 mm": (slot, 0.8), "slot of 0.2 mm": (slot, 0.2), "pocket": (pocket, 1e3),
    "pocket of 0.5 mm": (pocket, 0.5), "contour": (diagonal, 1e3), "contour of 0.3 mm": (diagonal, 0.3),
    "adaptive of 0.8 mm": (adaptive, 0.8), "adaptive of 0.3 mm": (adaptive, 0.3), "retreats": (retreats, 1e3),
}  # fmt: skip


def applied(folder, blocks, cutter, motion, t, **given):
    """Return forces (n, 3) as `convert` uses them at places of the motions behind the approach, `$BASE` axes, and the
    volume removed [mm³]."""
    program = read(folder, gcode(*blocks, spindle=f"S{RPM:g} M3"))
    (folder / "process.toml").write_text(process(cutter, BOX, **given))
    place = RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, place.start_flange)
    source = machining.ProcessSource(machining.load(folder / "process.toml"), place.spindle)
    found = force_sources.assign(program, path, source, place.spindle, place.ramp)
    wrench = found.at(toolpath.at(program, path, np.asarray(motion) + 2, np.asarray(t, float)))
    return wrench[:, :3], source.process_forces.removed_volume * 1e9


def compared(folder, points, spacing=0.4, **given):
    """Return forces (n, 3) at places along the path, and those expected, the length around each place, and the volume
    removed as a share of that expected."""
    blocks = [
        f"G0 X{points[0][0]:.6f} Y{points[0][1]:.6f} Z5", f"G1 Z-{DEPTH} F{FEED}",
        *(f"X{x:.6f} Y{y:.6f}" for x, y in points[1:]),
    ]  # fmt: skip
    exact = front.Path(points, np.arange(len(points) - 1))
    rows = []
    for segment, length in enumerate(exact.length):
        number = max(1, math.ceil(length / spacing))
        rows += [(segment, (k + 0.5) / number) for k in range(number)]
    motion, t = np.array([segment for segment, _ in rows]), np.array([share for _, share in rows])
    wrench, volume = applied(folder, blocks, tool(2 * RADIUS, TEETH), motion, t, **given)
    per_tooth = np.full(len(exact.length), FEED / RPM / TEETH)
    weight = np.array(
        [exact.length[segment] / max(1, math.ceil(exact.length[segment] / spacing)) for segment, _ in rows]
    )
    expected = front.forces(exact, RADIUS, TEETH, DEPTH, per_tooth, AL7075, in_box, rows)
    return wrench, expected, weight, volume / (DEPTH * front.area(exact, RADIUS, BOX[:2]))


def rms_error(found, expected, weight):
    return math.sqrt((weight @ norm(found - expected) ** 2) / (weight @ norm(expected) ** 2))


@pytest.mark.parametrize("name", CASES)
def test_forces_are_where_they_act(tmp_path, name):
    make, length = CASES[name]
    found, expected, weight, volume = compared(tmp_path, make(length))
    error = rms_error(found, expected, weight)
    print(f"{name}: RMS {100 * error:.1f} %, volume {100 * (volume - 1):+.2f} %")
    assert error <= ALLOWED
    assert volume == pytest.approx(1.0, abs=OF_VOLUME)


def test_arcs(tmp_path):
    """Half a turn in solid material and half a turn back, 3 mm farther out, in two motions."""
    arcs = [circle((20, 0), radius, 0.5 * math.pi * sign, -0.5 * math.pi * sign) for radius, sign in ((9, 1), (12, -1))]
    points = np.concatenate(arcs)
    blocks = [
        "G0 X20 Y9 Z5", f"G1 Z-{DEPTH} F{FEED}", "G2 X20 Y-9 J-9", "G1 Y-12", "G3 X20 Y12 J12",
    ]  # fmt: skip
    exact = front.Path(points, np.arange(len(points) - 1))
    counts, step = [len(arc) - 1 for arc in arcs], 7
    first = [(k, 0.5) for k in range(0, counts[0], step)]
    second = [(counts[0] + 1 + k, 0.5) for k in range(0, counts[1], step)]
    motion = np.repeat([0, 2], [len(first), len(second)])
    t = [(k + 0.5) / counts[0] for k, _ in first] + [(k - counts[0] - 0.5) / counts[1] for k, _ in second]
    found, volume = applied(tmp_path, blocks, tool(2 * RADIUS, TEETH), motion, t)
    per_tooth = np.full(len(exact.length), FEED / RPM / TEETH)
    expected = front.forces(exact, RADIUS, TEETH, DEPTH, per_tooth, AL7075, in_box, first + second)
    assert rms_error(found, expected, np.ones(len(t))) <= ALLOWED
    assert volume == pytest.approx(DEPTH * front.area(exact, RADIUS, BOX[:2]), rel=OF_VOLUME)


@pytest.mark.parametrize(
    ("cutter", "corner", "depth", "rise", "length"),
    [
        ("ball", 5.0, 3.0, 0.0, 1e3),
        ("ball", 5.0, 3.0, 0.1, 0.3),
        ("bull", 2.0, 4.0, 0.0, 0.3),
        ("flat", 0.0, 4.0, 0.1, 1e3),
    ],
    ids=["ball", "ball on a slope", "bull", "ramp"],
)
def test_fronts_that_are_cut_tooth_by_tooth(tmp_path, cutter, corner, depth, rise, length):
    """Into the stock from its side and, on slopes, down by a tenth of the way."""
    begin, end = np.array([-9.0, 1.3, -depth]), np.array([26.0, 1.3, -depth - 35.0 * rise])
    number = max(1, round(35.0 / length))
    points = begin + np.linspace(0.0, 1.0, number + 1)[:, None] * (end - begin)
    blocks = [
        "G0 X-9 Y1.3 Z5", f"G1 Z-{depth} F{FEED}", *(f"X{x:.6f} Z{z:.6f}" for x, _, z in points[1:]),
    ]  # fmt: skip
    share = (np.arange(18) + 0.5) / 18
    motion = np.minimum((share * number).astype(int), number - 1)
    t = share * number - motion
    found, volume = applied(tmp_path, blocks, tool(2 * RADIUS, TEETH, cutter, corner), motion, t)
    direction = (end - begin) / np.linalg.norm(end - begin)
    teeth = Teeth(RADIUS, corner, 1, AL7075, discs=60).side(9.0, discs=90)  # each tooth has the same mean
    if corner < RADIUS and rise > 0.0:
        teeth.face(-direction[2], rings=20)

    def material(point):
        return in_box(point[:, :2]) & (point[:, 2] < 0.0)

    per_tooth = FEED / RPM / TEETH
    at = [begin + each * (end - begin) for each in share]
    expected = [teeth.mean(tip, direction, per_tooth, material, steps=90)[0] for tip in at]
    assert rms_error(found, TEETH * np.array(expected), np.ones(18)) <= ALLOWED
    if rise == 0.0:
        path = front.Path([begin[:2], end[:2]], [0])
        heights = (np.arange(20) + 0.5) * depth / 20
        wide = RADIUS - corner + np.sqrt(np.maximum(corner**2 - np.maximum(corner - heights, 0.0) ** 2, 0.0))
        layers = [front.area(path, radius, BOX[:2], 0.2) for radius in wide]
        assert volume == pytest.approx(depth * np.mean(layers), rel=OF_VOLUME)


def test_a_tool_that_is_drawn_back_has_no_force(tmp_path):
    """A tenth of a millimetre behind the cut already, and over all of the retreat less than a tenth of its force."""
    points = retreats(1e3)
    found, expected, *_ = compared(tmp_path, points, spacing=0.04)
    backwards = norm(expected) < 1e-9
    backwards &= np.concatenate([[False], norm(expected)[:-1] > 100.0]) | np.roll(backwards, 1)
    first = np.flatnonzero(np.diff(backwards.astype(int), prepend=0) == 1)
    assert len(first) == 5
    for row in first:
        assert norm(found[row + 3 : row + 9]).max() < 1.0
        assert norm(found[row : row + 10]).mean() < 0.1 * norm(found[row - 1 : row])[0]
