"""Forces and engagement against a cutter that is turned tooth by tooth in a stock given by formulas.

Bounds: 4 % of the force and 3 N, which is what a cell of 0.25 mm may cost; most cases are within 1 %. The same of the
moment about the tip, and 3 N at the rim.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.machining.setting import AL7075, forces, gcode, line_of, on_line, process, tool
from tests.oracle.teeth import Teeth

RELATIVE, ABSOLUTE, LEVER = 0.04, 3.0, 0.005


def close(found, expected, relative=RELATIVE, absolute=ABSOLUTE):
    found, expected = np.asarray(found), np.asarray(expected)
    for half, least in ((slice(0, 3), absolute), (slice(3, 6), absolute * LEVER)):
        off, allowed = found[half] - expected[half], relative * np.linalg.norm(expected[half]) + least
        assert np.abs(off).max(initial=0.0) <= allowed, f"{found} {expected}"


def tooth_by_tooth(teeth, *given, **options):
    """Mean wrench (6,) [N, N·m]."""
    return teeth.wrench(*given, **options) * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])


BOX = ((0, 100), (-40, 40), (-20, 0))


def in_box(point, box=BOX):
    return np.all([(point[:, k] > box[k][0]) & (point[:, k] < box[k][1]) for k in range(3)], axis=0)


def outside_slot(point, radius, y, x_from, x_to):
    """Not in a slot along x that a cutter of a radius made."""
    x = np.clip(point[:, 0], x_from, x_to)
    return np.hypot(point[:, 0] - x, point[:, 1] - y) > radius


@pytest.mark.parametrize("spindle", ["S6000 M3", "S6000 M4"])
@pytest.mark.parametrize(
    ("y", "slot"),
    [(0.0, None), (-38.3, None), (39.61, None), (-8.0, 0.0), (7.37, 0.0), (41.0, None)],
    ids=["slot", "stock on the left", "stock on the right", "beside a slot", "other side", "little"],
)
def test_side_milling_and_slots(tmp_path, y, slot, spindle):
    before = () if slot is None else ("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X110", "G0 Z5")
    block = "X110 F2400 (here)"
    text = gcode(*before, f"G0 X-10 Y{y} Z5", "G1 Z-3 F2400", block, spindle=spindle)
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX))
    teeth = Teeth(5.0, 0.0, 4, AL7075).side(3.0)

    def material(point):
        there = in_box(point)
        return there if slot is None else there & outside_slot(point, 5.0, slot, -10, 110)

    hand = 1 if spindle.endswith("3") else -1
    expected = tooth_by_tooth(teeth, (50, y, -3), (1, 0, 0), 0.1, material, hand=hand, steps=360)
    close(on_line(program, found, line_of(text, block), 60 / 120), expected)


def test_a_second_pass_is_in_air(tmp_path):
    text = gcode("G0 X-10 Y0 Z5", "G1 Z-3 F2400", "X110", "X-10 (again)")
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX))
    line = line_of(text, "X-10 (again)")
    for t in np.linspace(0.0, 1.0, 40):
        assert np.abs(on_line(program, found, line, t)[:3]).max() < 1e-3


@pytest.mark.parametrize("x", [0.5, 2.0, 4.0, 98.0, 103.0, 106.0])
def test_entry_and_exit_lie_within_the_resolution(tmp_path, x):
    text = gcode("G0 X-10 Y1.3 Z5", "G1 Z-3 F2400", "X110 (here)")
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX))
    teeth = Teeth(5.0, 0.0, 4, AL7075).side(3.0)
    expected = [teeth.mean((x + d, 1.3, -3), (1, 0, 0), 0.1, in_box, steps=360)[0] for d in (-0.25, 0.0, 0.25)]
    force = on_line(program, found, line_of(text, "X110 (here)"), (x + 10) / 120)[:3]
    slack = RELATIVE * np.linalg.norm(expected[1]) + ABSOLUTE
    assert (force >= np.min(expected, axis=0) - slack).all()
    assert (force <= np.max(expected, axis=0) + slack).all()


def test_stock_that_covers_part_of_the_depth(tmp_path):
    """The tip is below the stock, and the stock begins beside the axis."""
    box = ((0, 100), (-40, -2.2), (-2, 0))
    text = gcode("G0 X-10 Y0 Z5", "G1 Z-6 F2400", "X110 (here)")
    program, found = forces(tmp_path, text, process(tool(16, 3), box))
    teeth = Teeth(8.0, 0.0, 3, AL7075).side(8.0, discs=800)
    expected = tooth_by_tooth(teeth, (50, 0, -6), (1, 0, 0), 2400 / 6000 / 3, lambda p: in_box(p, box), steps=240)
    close(on_line(program, found, line_of(text, "X110 (here)"), 0.5), expected)


@pytest.mark.parametrize(("shape", "corner"), [("ball", 5.0), ("bull", 2.0)])
@pytest.mark.parametrize("y", [0.0, -4.0, 3.0], ids=["slot", "beside on the right", "beside on the left"])
@pytest.mark.parametrize("depth", [1.5, 7.0])
def test_ball_and_bull_in_and_beside_a_slot(tmp_path, shape, corner, y, depth):
    before = () if y == 0.0 else ("G0 X-10 Y0 Z5", f"G1 Z{-depth} F2400", "X110", "G0 Z5")
    text = gcode(*before, f"G0 X-10 Y{y} Z5", f"G1 Z{-depth} F2400", "X110 (here)")
    program, found = forces(tmp_path, text, process(tool(10, 4, shape, corner), BOX))
    teeth = Teeth(5.0, corner, 4, AL7075)
    if depth > corner:
        teeth.side(depth)

    def material(point):
        there = in_box(point)
        if y == 0.0:
            return there
        over = point[:, 2] + depth
        half = np.where(over < corner, 5.0 - corner + np.sqrt(np.maximum(corner**2 - (corner - over) ** 2, 0.0)), 5.0)
        return there & ~((over > 0) & (np.abs(point[:, 1]) < half))

    expected = tooth_by_tooth(teeth, (50, y, -depth), (1, 0, 0), 0.1, material, steps=240)
    close(on_line(program, found, line_of(text, "X110 (here)"), 0.5), expected)


@pytest.mark.parametrize(("shape", "corner"), [("ball", 6.0), ("bull", 2.0)])
@pytest.mark.parametrize("sense", ["G2", "G3"])
@pytest.mark.parametrize("path_radius", [0.3, 0.75])
def test_ball_and_bull_on_a_circle_that_hardly_opens_the_hole_of_a_plunge(tmp_path, path_radius, sense, shape, corner):
    """On the first half of the circle; the solid is what is beyond the plunge, from the angle where both meet."""
    circle = f"{sense} I{-path_radius}"
    text = gcode("G0 X0 Y0 Z5", "G1 Z-1 F2400", f"X{path_radius}", circle)
    program, found = forces(tmp_path, text, process(tool(12, 4, shape, corner), ((-40, 40), (-40, 40), (-20, 0))))
    line = line_of(text, circle)
    force = np.mean([on_line(program, found, line, t)[:3] for t in np.linspace(0.15, 0.45, 31)], axis=0)

    def material(point):
        """Not where the ball or the bull of the plunge is, about (0, outwards) on the circle; behind it no chip is."""
        over = point[:, 2] + 1.0
        half = 6.0 - corner + np.sqrt(np.maximum(corner**2 - (corner - over) ** 2, 0.0))
        return (point[:, 2] < 0.0) & (np.hypot(point[:, 0], point[:, 1]) > half)

    outwards = 1.0 if sense == "G2" else -1.0  # to the left of the feed
    tip = (0.0, outwards * path_radius, -1.0)
    expected = Teeth(6.0, corner, 4, AL7075).mean(tip, (1, 0, 0), 0.1, material, steps=720)[0]
    assert np.linalg.norm(force - expected) < RELATIVE * np.linalg.norm(expected)


@pytest.mark.parametrize("slope", [-20.0, 20.0], ids=["down", "up"])
def test_ball_on_a_slope(tmp_path, slope):
    """Level stock, and a way that goes down or up through it."""
    rise = 40 * math.tan(math.radians(slope))
    begin = -1.0 if slope < 0 else -1.0 - rise
    text = gcode(f"G0 X20 Y0 Z{begin + 5:.4f}", f"G1 Z{begin:.6f} F2400", f"X60 Z{begin + rise:.6f} (here)")
    program, found = forces(tmp_path, text, process(tool(10, 2, "ball"), BOX))
    share = 0.35 if slope < 0 else 0.8
    x, z = 20 + 40 * share, begin + rise * share
    direction = np.array([math.cos(math.radians(slope)), 0, math.sin(math.radians(slope))])
    teeth = Teeth(5.0, 5.0, 2, AL7075, discs=300).side(max(-z, 5.1))
    expected = tooth_by_tooth(teeth, (x, 0, z), direction, 2400 / 6000 / 2, in_box, steps=360)
    line = line_of(text, f"X60 Z{begin + rise:.6f} (here)")
    close(on_line(program, found, line, share), expected)


def test_ramp_of_a_flat_tool(tmp_path):
    """Across the axis the end face adds nothing; what it cuts is in the thrust, which the sides do not have."""
    text = gcode("G0 X10 Y0 Z5", "G1 Z0 F2400", "X90 Z-4 (here)")
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX))
    wrench = on_line(program, found, line_of(text, "X90 Z-4 (here)"), 0.5)
    direction = np.array([80, 0, -4]) / math.hypot(80, 4)
    expected = tooth_by_tooth(Teeth(5.0, 0.0, 4, AL7075).side(2.0), (50, 0, -2), direction, 0.1, in_box, steps=360)
    close(wrench[:2], expected[:2])
    face = 4 * 5.0 * (0.1 * -direction[2] * AL7075[2] + -direction[2] * AL7075[3])
    assert wrench[2] == pytest.approx(expected[2] + face, rel=0.04)


def test_full_circle_inside_and_outside(tmp_path):
    """Around a boss of 20 mm, and inside a bore of that size, in whole turns."""
    text = gcode("G0 X65 Y0 Z5", "G1 Z-3 F2400", "G2 X65 Y0 I-15 J0 (here)")
    program, found = forces(tmp_path, text, process(tool(10, 4), BOX))
    teeth = Teeth(5.0, 0.0, 4, AL7075).side(3.0)
    line = line_of(text, "G2 X65 Y0 I-15 J0 (here)")
    for share in (0.3, 0.55, 0.8):
        angle = -2 * math.pi * share
        tip = (50 + 15 * math.cos(angle), 15 * math.sin(angle), -3)
        expected = tooth_by_tooth(teeth, tip, (math.sin(angle), -math.cos(angle), 0), 0.1, in_box, steps=360)
        close(on_line(program, found, line, share), expected)


def test_kienzle(tmp_path):
    text = gcode("G0 X-10 Y37.5 Z5", "G1 Z-3 F2400", "X110 (here)")
    material = "kc11_N_per_mm2 = 641.0\nmc = 0.27"
    program, found = forces(tmp_path, text, process(tool(10, 2), BOX, material=material))
    teeth = Teeth(5.0, 0.0, 2, kienzle=(641.0, 0.27, 0.3)).side(3.0)
    expected = tooth_by_tooth(teeth, (50, 37.5, -3), (1, 0, 0), 0.2, in_box, steps=720)
    close(on_line(program, found, line_of(text, "X110 (here)"), 0.5), expected)


def test_another_plane(tmp_path):
    """A quarter circle in G18 climbs out of the stock: ball, tip on the circle."""
    text = gcode("G0 X20 Y0 Z5", "G1 Z-4 F2400", "G18", "G2 X40 Z-4 I10 K17.3205080757 (here)")
    program, found = forces(tmp_path, text, process(tool(10, 2, "ball"), BOX))
    line = line_of(text, "G2 X40 Z-4 I10 K17.3205080757 (here)")
    (motion,) = np.flatnonzero(program.motions.line == line)
    sweep = program.motions.sweep[motion]
    radius, cx, cz = 20.0, 30.0, -4 + 17.3205080757
    turn = np.sign(program.motions.normal[motion, 1])
    share = 0.6 if sweep < math.pi else 0.02
    start = math.atan2(-17.3205080757, -10)
    angle = start - turn * sweep * share
    tip = np.array([cx + radius * math.cos(angle), 0, cz + radius * math.sin(angle)])
    direction = -turn * np.array([-math.sin(angle), 0, math.cos(angle)])
    teeth = Teeth(5.0, 5.0, 2, AL7075, discs=300).side(12.0)
    expected = tooth_by_tooth(teeth, tip, direction, 0.2, in_box, steps=360)
    close(on_line(program, found, line, share), expected)


def test_a_spindle_that_turns_the_other_way_through_the_mirrored_part_gives_mirrored_forces(tmp_path):
    """A curve whose direction changes all the time, half in material, downhill in part."""
    blocks = ["G0 X-20 Y{}12 Z5", "G1 Z-2 F600", "G{} X20 Y{}12 I20 J{}30 F900", "G1 X26 Y{}16 Z-3", "G0 Z20"]
    found = []
    for sign, arc, spindle in (("-", 3, "S6000 M3"), ("", 2, "S6000 M4")):
        other = "" if sign else "-"
        text = [
            blocks[0].format(sign),
            blocks[1],
            blocks[2].format(arc, sign, other),
            blocks[3].format(sign),
            blocks[4],
        ]
        box = ((-30.0, 30.0), (-40.0, 40.0), (-10.0, 0.0))
        folder = tmp_path / spindle[-2:]
        folder.mkdir()
        program_text = gcode(*text, spindle=spindle)
        found.append(forces(folder, program_text, process(tool(8.0, 3, "ball"), box))[1].cuts)
    one, two = found
    np.testing.assert_array_equal(one.motion, two.motion)
    size = np.abs(one.wrench).max(axis=0)
    np.testing.assert_allclose(two.wrench * [1, -1, 1, -1, 1, -1] / size, one.wrench / size, rtol=0, atol=1e-4)
