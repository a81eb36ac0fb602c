"""Tools that turn while they cut: forces and volumes against exact fronts, and what a map of the stock cannot tell."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import machining, toolpath
from postproc.errors import ForceError
from postproc.under_load import RobotInCell
from tests.benchmarks.fronts import rms
from tests.benchmarks.turning_fronts import CASES, FIVE, axes_of, compared
from tests.machining.setting import ROBOT, forces, gcode, line_of, on_line, process, tool
from tests.oracle import fronts

BOX = ((0, 40), (0, 20), (-20, 0))


DRAWN = (
    "ball R3 rough 1, 20° ± 8°",
    "flat R5 rough 1.5, 8° ± 4°",
    "bull R5 c1 side 6, 4° ± 2°",
    "ball R4 indexed 1, 30°",
)


@pytest.mark.parametrize("name", DRAWN)
def test_forces_of_a_tool_that_turns_are_those_of_exact_fronts(tmp_path, name):
    found, expected = compared(tmp_path, CASES[name], np.random.default_rng(3), count=3, fineness=0.03)
    print(f"{name}: RMS {100 * rms(found - expected) / rms(expected):.1f} %")
    assert rms(found - expected) <= 0.06 * rms(expected)


@pytest.mark.parametrize(("shape", "corner"), [("flat", 0.0), ("bull", 1.5), ("ball", 4.0)])
def test_the_volume_that_a_turning_tool_removes(tmp_path, shape, corner):
    """Against points that are inside of the tool at any of dense poses: a cut at 5° to 25° along the stock."""
    text = gcode("G0 X-20 Y2 B5 C0", "Z-3", "G1 X60 Y8 B25 F2400", "G0 Z40")
    _, found = forces(tmp_path, text, process(tool(8, 2, shape, corner), BOX), FIVE)
    place = np.linspace(0.0, 1.0, 401)[:, None]
    tip = np.array([-20, 2, -3.0]) + place * (80, 6, 0)
    axes = axes_of(5.0 + 20.0 * place[:, 0], 0.0 * place[:, 0])
    cutter = fronts.Cutter(4.0, corner, 2, 0.5)
    point = np.stack(np.meshgrid(np.arange(0.5, 40, 1.0), np.arange(0.15, 14, 0.3), np.arange(-5.925, 0, 0.15)), -1)
    point, count = point.reshape(-1, 3), 0
    for first in range(0, 401, 20):
        few = slice(first, first + 20)
        near = np.flatnonzero(np.abs(point[:, 0] - tip[few, 0].mean()) < 9.0)
        inside = cutter.inside(point[near], tip[few], axes[few]).any(axis=1)
        count += np.count_nonzero(inside)
        point = np.delete(point, near[inside], axis=0)
    assert found.removed_volume == pytest.approx(count * 1.0 * 0.3 * 0.15 * 1e-9, rel=0.008)


def test_a_cut_that_would_hang_over_in_one_map_gets_a_map_of_its_own(tmp_path):
    """A slot at 30° to 34° after an upright cut: along z its wall hangs over, along the tool it does not."""
    blocks = ("G0 X20 Y-20 B30 C0", "Z-8", "G1 Y40 B34 F2400 (here)", "G0 Z40")
    upright = ("G0 X36 Y-20 B0 C0", "Z-1", "G1 Y40 F2400", "G0 Z40")
    text, alone = gcode(*upright, *blocks), gcode(*blocks)
    program, found = forces(tmp_path, text, process(tool(8, 2), BOX), FIVE)
    other, expected = forces(tmp_path, alone, process(tool(8, 2), BOX), FIVE)
    force = on_line(program, found, line_of(text, blocks[2]), 0.5)
    np.testing.assert_allclose(
        force, on_line(other, expected, line_of(alone, blocks[2]), 0.5), atol=0.03 * np.linalg.norm(force[:3])
    )


@pytest.mark.parametrize("turn", [3, 10])
def test_a_slot_along_an_arc_has_one_force_although_a_later_cut_turns_the_tool(tmp_path, turn):
    """Where the tool leans back from its travel in the map, the material of its front is above it.

    It was taken for removed at the end of each chord, and the force fell to a fifth behind it.
    """
    arc = "G3 X10 Y30 I0 J10"
    text = gcode("G0 X-20 Y10 B0 C0", "Z-3", "G1 X10 F1200", arc, f"G1 X-20 B{turn}", "G0 Z40")
    box = ((0, 40), (0, 40), (-20, 0))
    program, found = forces(tmp_path, text, process(tool(10, 3), box, 0.25), FIVE)
    places = np.linspace(0.02, 0.98, 641)
    strength = [np.linalg.norm(on_line(program, found, line_of(text, arc), place)[:3]) for place in places]
    np.testing.assert_allclose(strength, np.median(strength), rtol=0.08)


@pytest.mark.parametrize(("slot", "is_hidden"), [(("X20 Y-20", "Y40"), True), (("X-20 Y10", "X60"), False)])
def test_earlier_cuts_that_overhang_seen_from_a_new_direction_are_told(tmp_path, slot, is_hidden):
    """A small slot of a large stock: the warning counted 2 % of the stock, and the slot was solid again without it."""
    text = gcode(
        f"G0 {slot[0]} B0 C0", "Z-3", f"G1 {slot[1]} F1200", "G0 Z60", "G0 X-40 Y-30 Z-16 B90", "G1 Y60", "G0 X-60"
    )
    _, found = forces(tmp_path, text, process(tool(8, 2), ((0, 40), (-20, 40), (-60, 0)), 1.0), FIVE)
    assert any("overhangs, seen along the tool now" in issue.message for issue in found.issues) == is_hidden


def test_material_that_a_leaning_tool_leaves_above_itself_is_refused(tmp_path):
    """A groove from 5° to 60° and back in one cut has walls that hang over, whatever the direction."""
    text = gcode("G0 X20 Y-20 B-40 C0", "Z-8", "G1 Y5 F2400", "Y15 B40", "Y40", "G0 Z40")
    with pytest.raises(ForceError, match=r"the tool leaves material above itself"):
        forces(tmp_path, text, process(tool(8, 2), BOX), FIVE)


def test_a_tool_that_turns_where_it_rests_needs_a_speed(tmp_path):
    text = gcode("G0 X20 Y-20 B0 C0", "Z-2", "G1 Y10 F2400", "B4", "Y40", "G0 Z40")
    program, found = forces(tmp_path, text, process(tool(8, 2, "ball"), BOX), FIVE)
    turns = found.knots.wrench[program.motions.line[found.knots.motion] == 7]
    assert np.isfinite(turns).all()
    assert np.abs(turns).max() > 1.0
    unpaced_motions = replace(program, swivel=replace(program.swivel, rate=np.full(len(program.motions), np.nan)))
    path = toolpath.segments(unpaced_motions, RobotInCell.of(ROBOT, FIVE).start_flange)
    with pytest.raises(ForceError, match=r"part.nc:7: the tool turns in material while its tip rests"):
        machining.estimate(unpaced_motions, path, machining.load(tmp_path / "process.toml"), "+Z")


def test_a_move_that_turns_the_tool_by_more_than_a_map_can_show_is_refused(tmp_path):
    text = gcode("G0 X20 Y-20 B-70 C0", "Z-2", "G1 Y40 B70 F2400", "G0 Z40")
    with pytest.raises(ForceError, match=r"part.nc:6: the tool turns by more than 120° in one cutting move"):
        forces(tmp_path, text, process(tool(8, 2, "ball"), BOX), FIVE)
