"""What does not cut against the stock that remains: closed forms of cylinders and walls, and planted contacts."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import machining, toolpath
from postproc.cell import Frame
from postproc.machining import stock as stocks
from postproc.machining.remaining import Ceiling, Guard, ToolPart, touches
from postproc.machining.tool import Cutter
from postproc.under_load import RobotInCell
from tests.machining.setting import CELL, ROBOT, gcode, process, read, tool

CELL_MM = 0.5
BOX = ([0, 60], [0, 60], [-40, 0])


def swept(folder, text, parts, need=0.0, box=BOX, cutter=None, resolution=CELL_MM):
    """Program, `ProcessForces` and guard; parts are (name, diameter, height above the tip) in mm."""
    program = read(folder, text)
    (folder / "process.toml").write_text(process(cutter or tool(20, 4), box, resolution))
    guard = Guard([ToolPart(name, 0.5e-3 * wide, 1e-3 * high) for name, wide, high in parts], 1e-3 * need)
    place = RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, place.start_flange)
    found = machining.estimate(program, path, machining.load(folder / "process.toml"), place.spindle, guard=guard)
    return program, found, guard


def collisions(found):
    return [issue for issue in found.issues if issue.kind == "collision"]


def test_a_cylinder_over_beside_and_off_the_edge_of_a_block():
    """Distance of a cylinder from a block, by the drawing: held where it is more than is asked for, and not else."""
    block = stocks.from_box(np.array([0, 0, -0.04]), np.array([0.1, 0.06, 0.0]), 0.5e-3)
    radius, cell = 0.02, 0.5e-3
    rng = np.random.default_rng(3)
    seen = []
    for _ in range(300):
        x, y, z = rng.uniform([-0.04, -0.04, -0.01], [0.14, 0.1, 0.02])
        beside = np.hypot(max(-x, x - 0.1, 0.0), max(-y, y - 0.06, 0.0))
        distance = np.hypot(max(beside - radius, 0.0), max(z, 0.0))
        need = rng.uniform(0.0, 0.01)
        body = Cutter(radius + need, need, 1)
        place = np.array([[x, y, z - need]])
        hit = bool(touches(block, body, place, place)[0])
        seen.append(hit)
        if distance < need - 1e-5 or (distance == 0.0 and z < -1e-5):
            assert hit, (x, y, z, need)
        if hit:
            assert distance < need + 1.5 * cell, (x, y, z, need)
    assert 50 < sum(seen) < 250


def test_a_motion_past_a_block_against_dense_poses():
    """What a body touches anywhere on a straight motion is what it touches at poses every 0.1 mm."""
    block = stocks.from_box(np.array([0, 0, -0.04]), np.array([0.1, 0.06, 0.0]), 1e-3)
    rng, seen = np.random.default_rng(4), []
    for _ in range(30):
        begin, end = rng.uniform([-0.04, -0.04, -0.008], [0.14, 0.1, 0.03], (2, 3))
        body = Cutter(0.015, float(rng.choice([0.0, 0.004])), 1)
        places = begin + np.linspace(0, 1, 600)[:, None] * (end - begin)
        dense = touches(block, body, places, places).any()
        hit = touches(block, body, begin[None], end[None])[0]
        deeper = touches(block, body, places - [0, 0, 4e-4], places - [0, 0, 4e-4]).any()
        assert dense <= hit <= deeper
        seen.append(hit)
    assert 5 < sum(seen) < 28


@pytest.mark.parametrize("wide", [4, 12, 17, 24])
def test_a_shank_beside_a_wall_is_as_far_as_drawn(tmp_path, wide):
    """The last pass of a shoulder has its axis 10 mm from the wall, so the shank is 10 − wide / 2 from it."""
    text = gcode("G0 X-30 Y-10 Z5", "G1 Z-10 F2400", "X90", "Y0", "X-30")
    _, found, guard = swept(tmp_path, text, [("shank", wide, 6.0)], need=9.0)
    expected = min(max(10.0 - 0.5 * wide, 0.0), 6.0)  # the floor is 6 mm below it
    least = 1e3 * min(guard.close_distances.values())
    assert expected - 2.5 * CELL_MM <= least <= expected + 0.05
    (issue,) = collisions(found)
    assert f"within {least:.2g} mm" in issue.message or least == 0.0


def test_a_holder_above_the_top_is_as_far_as_drawn(tmp_path):
    """6 mm above the tip, 4 below the top: 2 mm are left. They are held if 1.9 are asked for."""
    text = gcode("G0 X-30 Y30 Z5", "G1 Z-4 F2400", "X90")
    _, found, guard = swept(tmp_path, text, [("holder", 60, 6.0)], need=3.0)
    assert 1e3 * min(guard.close_distances.values()) == pytest.approx(2.0, abs=0.05)
    assert (
        "holder comes within 2 mm of the stock that is left here; [collision] asks for 3 mm"
        in collisions(found)[0].message
    )
    _, found, _ = swept(tmp_path, text, [("holder", 60, 6.0)], need=1.9)
    assert collisions(found) == []


def test_a_shank_in_its_own_hole_is_free_and_a_wider_one_is_not(tmp_path):
    """A plunge of 30 mm with a cutter of 20: what is wider than the cutter, 15 above the tip, meets the top."""
    text = gcode("G0 X30 Y30 Z5", "G1 Z-30 F600", "G0 Z5")
    for wide, expected in ((18, False), (30, True)):
        _, found, guard = swept(tmp_path, text, [("shank", wide, 15.0)])
        assert bool(guard.close_distances) == expected
        assert len(collisions(found)) == expected
    (issue,) = collisions(found)
    assert issue.level == "error"
    assert issue.source_line == 5
    assert "shank touches the stock" in issue.message


def test_the_holder_is_compared_with_what_is_left_at_that_time(tmp_path):
    """A deep pass is free where shallow passes made room before it, and not where it comes first."""
    room = ["G0 Y10 Z5", "G1 Z-8 F2400", "X90", "G0 Z5", "X-30", "Y30", "G1 Z-8", "X90", "G0 Z5", "X-30",
            "Y50", "G1 Z-8", "X90", "G0 Z5", "X-30"]  # fmt: skip
    deep = ["G0 Y30 Z5", "G1 Z-16 F2400", "X90", "G0 Z5"]
    holder = [("holder", 36, 10.0)]  # 6 below the top at Z-16
    start = "G0 X-30 Y30 Z5"
    _, found, _ = swept(tmp_path, gcode(start, *room, *deep), holder, need=1.0)
    assert collisions(found) == []
    program, found, guard = swept(tmp_path, gcode(start, *deep), holder, need=1.0)
    (issue,) = collisions(found)
    assert issue.subject == "holder, stock"
    assert program.motions.line[min(motion for _, motion in guard.close_distances)] == 7


def test_a_rapid_through_stock_is_refused_until_it_was_cut(tmp_path):
    """The way across the block at Z-5, as a rapid move: before the slot is cut, and after it."""
    slot = ["G1 Z-5 F2400", "X90", "G0 Z5", "X-30"]
    way = ["G0 Z-5", "X90", "Z5"]
    start = "G0 X-30 Y30 Z5"
    _, found, _ = swept(tmp_path, gcode(start, *slot, *way), [])
    assert collisions(found) == []
    deeper = ["G1 Z-8 F2400", *slot[1:]]
    program, found, _ = swept(tmp_path, gcode(start, *way, "X-30", *deeper), [])
    (issue,) = collisions(found)
    assert issue.level == "error"
    assert "cutter goes 5 mm deep into the stock in a rapid move" in issue.message
    assert program.documents[0].text.splitlines()[issue.source_line - 1] == "X90"


def test_the_coarse_stock_is_never_below_the_map_and_follows_it(tmp_path):
    """Before each motion the coarse cells hold the map that a sweep of the motions before it leaves."""
    blocks = ["G0 X-30 Y20 Z5", "G1 Z-4 F2400", "X90", "G0 Z5", "G0 X-30", "Y35", "G1 Z-9", "X40", "G0 Z5"]
    program, found, _ = swept(tmp_path, gcode(*blocks), [])
    over = found.over_time
    for count in range(4, len(blocks) + 1):
        text = gcode(*blocks[:count])
        part, left, _ = swept(tmp_path, text, []) if count > 2 else (None, None, None)
        own = Ceiling(left.stock)
        level = over.ceiling[0].levels_before(len(part.motions))
        before = np.where(np.isfinite(own.levels_before(0)), own.levels_before(0), -np.inf)
        assert (level >= before).all()
        assert (level == before).mean() > 0.9  # the front of a cut is removed with the next motion
    assert over.is_compared.all() or (~over.is_compared).sum() <= 1
    points, faces = over.mesh(0)
    base = program.bases[0]
    local = (points - base[:3, 3]) @ base[:3, :3] * 1e3
    np.testing.assert_allclose(local.min(axis=0), [0, 0, -40], atol=2 * over.accuracy * 1e3)
    np.testing.assert_allclose(local.max(axis=0), [60, 60, 0], atol=2 * over.accuracy * 1e3)
    assert local[:, 2].max() == pytest.approx(0.0, abs=1e-6)
    assert faces.max() == len(points) - 1


@pytest.mark.parametrize(
    ("wide", "said"), [(None, []), (20.0, []), (12.0, ["cutter of 12 mm, but tools.1 of the process has 20 mm"])]
)
def test_a_cutter_of_the_cell_unlike_that_of_the_process_is_an_error(tmp_path, wide, said):
    program = read(tmp_path, gcode("G0 X-30 Y0 Z5", "G1 Z-10 F2400", "X90"))
    (tmp_path / "process.toml").write_text(process(tool(20, 4), BOX, CELL_MM))
    guard = Guard([], 0.0, None if wide is None else 1e-3 * wide)
    place = RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, place.start_flange)
    found = machining.estimate(program, path, machining.load(tmp_path / "process.toml"), place.spindle, guard=guard)
    issues = [issue for issue in found.issues if issue.kind == "other-cutter"]
    assert [issue.level for issue in issues] == ["error"] * len(said)
    assert all(text in issue.message for issue, text in zip(issues, said, strict=True))


@pytest.mark.parametrize(("length", "longer"), [(370.0, True), (330.0, False)])
def test_a_rapid_move_that_a_longer_tool_begins_in_the_stock_says_so(tmp_path, length, longer):
    """After the change the flange is where it was: the tip of a tool 20 mm longer is 15 mm below the top."""
    cell = replace(CELL, tools={"1": Frame(Z=350.0), "3": Frame(Z=length)})
    text = gcode(
        "G0 X-30 Y30 Z5", "G1 X30 F2400", "Z-1", "G0 Z5", "T3 M6", "S6000 M3", "G0 Z40", "G1 X31 Z-1", "G0 Z40"
    )
    program = read(tmp_path, text, cell=cell)
    (tmp_path / "process.toml").write_text(process(tool(20, 4), BOX, CELL_MM).replace("[tools.1]", "[tools.default]"))
    place = RobotInCell.of(ROBOT, cell)
    path = toolpath.segments(program, place.start_flange)
    given = machining.load(tmp_path / "process.toml")
    for guard, kind in ((None, "rapid-in-material"), (Guard([], 0.0), "collision")):
        found = machining.estimate(program, path, given, place.spindle, guard=guard)
        said = [issue.message for issue in found.issues if issue.kind == kind]
        assert ["The new tool is 20 mm longer" in message for message in said] == [True] * longer
    text = gcode("G0 X-30 Y30 Z5", "G1 X30 F2400", "Z-1", "G0 X35", "Z5")
    assert "longer" not in collisions(swept(tmp_path, text, [])[1])[0].message


@pytest.mark.parametrize("seed", range(4))
def test_a_body_touches_cells_that_it_covers_in_part_and_reaches_into(seed):
    """Cell by cell, by the corner of each that is nearest to the path: half a diagonal is added to the radius."""
    rng = np.random.default_rng(seed)
    stock = stocks.from_box(np.array([0.0, 0.0, -0.01]), np.array([0.02, 0.015, 0.0]), 1e-3)
    stock.high[:] = np.where(
        rng.random(stock.high.shape) < 0.06, rng.uniform(-4e-3, 0.0, stock.high.shape), stock.floor
    )
    stock.floor[:] = np.where(rng.random(stock.high.shape) < 0.5, stock.floor, stock.high)
    body = Cutter(2e-3, 0.0, 1)
    begin = rng.uniform([-0.004, -0.004, -5e-3], [0.024, 0.019, -1e-3], (60, 3))
    end = begin + rng.uniform(-5e-3, 5e-3, (60, 3)) * [1, 1, 0]
    found, rows = touches(stock, body, begin, end), stock.high.shape
    t = np.linspace(0.0, 1.0, 201)[:, None]
    compared = 0
    for n in range(60):
        places = begin[n] + t * (end[n] - begin[n])
        gaps = []
        for row, column in np.ndindex(rows):
            if stock.high[row, column] <= max(begin[n, 2] + 1e-6, float(stock.floor[row, column])):
                continue
            x, y = stock.x + (column + 0.5) * 1e-3, stock.y + (row + 0.5) * 1e-3
            gaps.append(float(np.hypot(places[:, 0] - x, places[:, 1] - y).min()) - 2e-3 - 0.7072e-3)
        nearest = min(gaps, default=1.0)
        if abs(nearest) > 5e-5:
            compared += 1
            assert found[n] == (nearest < 0.0)
    assert compared > 50
    assert 5 < found.sum() < 55


@pytest.mark.parametrize(("depth", "is_hit"), [(0.9e-6, False), (1.1e-6, True)])
def test_a_body_that_is_flush_with_the_stock_does_not_touch_it(depth, is_hit):
    stock = stocks.from_box(np.array([0.0, 0.0, -0.01]), np.array([0.02, 0.015, 0.0]), 1e-3)
    place = np.array([[0.01, 0.008, -depth]])
    assert touches(stock, Cutter(2e-3, 0.0, 1), place, place).tolist() == [is_hit]


@pytest.mark.parametrize(("radius", "need", "height", "corner", "expected"), [
    (2.9, 0.0, 1.0, 0.0, True), (3.1, 0.0, 1.0, 0.0, False), (1.9, 1.0, 1.0, 0.0, True), (2.1, 1.0, 1.0, 0.0, False),
    (2.0, 0.5, 0.4, 0.0, False), (2.0, 0.5, 0.6, 0.0, True), (3.0, 0.0, 0.9, 5.0, False), (3.0, 0.0, 1.1, 5.0, True),
    (2.0, 1.0, 1.9, 5.0, False), (2.0, 1.0, 2.1, 5.0, True),
])  # fmt: skip
def test_a_part_inside_of_what_the_cutter_sweeps_needs_no_comparison(radius, need, height, corner, expected):
    """A cutter of radius 5 less two cells of 1; a ball is 1 above its tip at a distance of 3 [mm]."""
    guard = Guard([], 1e-3 * need)
    part = ToolPart("shank", 1e-3 * radius, 1e-3 * height)
    assert guard._is_in_sweep(part, Cutter(5e-3, 1e-3 * corner, 2), 1e-3) is expected


@pytest.mark.parametrize(("gap", "closest"), [(-0.5, 0.0), (0.0, 0.0), (0.7, 0.7), (1.4, 1.4), (1.6, None)])
def test_the_distance_of_a_part_above_the_stock_is_recorded_if_it_is_below_the_needed_one(gap, closest):
    """1.5 mm are needed; of several segments of a motion the smallest distance remains."""
    stock = stocks.from_box(np.array([0.0, 0.0, -0.01]), np.array([0.02, 0.015, 0.0]), 1e-3)
    guard, part = Guard([], 1.5e-3), ToolPart("holder", 3e-3, 4e-3)

    def record(distance):
        place = np.array([[0.01, 0.008, 1e-3 * distance - 4e-3]])
        guard._record_distance(part, stock, 7, (place, place + np.array([1e-3, 0.0, 0.0])))

    record(gap)
    if closest is None:
        assert guard.close_distances == {}
        return
    assert guard.close_distances[("holder", 7)] == pytest.approx(1e-3 * closest, abs=6e-5)
    record(gap + 0.2)
    assert guard.close_distances[("holder", 7)] == pytest.approx(1e-3 * closest, abs=6e-5)
    record(gap - 0.2)
    assert guard.close_distances[("holder", 7)] == pytest.approx(1e-3 * max(closest - 0.2, 0.0), abs=6e-5)
    assert list(guard.close_distances) == [("holder", 7)]
