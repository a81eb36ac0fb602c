"""Which segments are swept together, which can touch the stock, and sizes of cuts, against loops."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.machining import sweep
from postproc.machining.sweep import Sweep
from postproc.machining.tool import Cutter, Turn, edge, slice_cylinder
from postproc.machining.tool_path import StraightSegments
from tests.machining.test_map_by_cell import CELL_SIZE, SIZE, made_stock
from tests.machining.test_tilted_by_pose import LAW

RADII = (4e-3, 7e-3)
COUNT = 60


def unit(vector):
    return vector / np.linalg.norm(vector)


def segments(seed):
    """Segments near a map: straight on, bent, up and down, rapid, leaning, with gaps."""
    rng = np.random.default_rng(seed)
    motion = np.sort(rng.integers(0, 40, COUNT))
    turns = rng.choice([0.0, 6.0, 14.0, 90.0], COUNT, p=[0.5, 0.2, 0.2, 0.1])
    heading = np.radians(np.cumsum(turns * rng.choice([-1, 1], COUNT)))
    leave = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(COUNT)])
    steep = rng.random(COUNT)
    leave[steep < 0.15] = [0.0, 0.0, -1.0]
    leave[(steep > 0.15) & (steep < 0.25)] = [0.0, 0.0, 1.0]
    leave[(steep > 0.25) & (steep < 0.35)] = unit(np.array([0.9, 0.0, -0.3]))
    arrive = np.where(rng.random((COUNT, 1)) < 0.8, leave, np.roll(leave, 1, axis=0))
    length = rng.uniform(0.002, 0.04, COUNT)
    begin = rng.uniform([0.0, -0.03, -0.01], [0.06, 0.01, 0.004], (COUNT, 3))
    return StraightSegments(
        motion, np.zeros(COUNT), np.ones(COUNT), begin, begin + length[:, None] * leave, leave, arrive,
        rng.random(COUNT) < 0.8, rng.random(COUNT) < 0.85, np.sort(rng.random(COUNT)) < 0.3,
    )  # fmt: skip


def swept(seed=0):
    rng = np.random.default_rng(seed + 100)
    tool = np.sort(rng.integers(0, 2, 40))
    tools = SimpleNamespace(
        tool=tool, rpm=np.where(np.arange(40) < 30, 6000.0, 8000.0), hand=np.where(np.arange(40) < 36, 1, -1),
        keys=("1", "2"),
    )  # fmt: skip
    axes = np.cumsum(rng.normal(0.0, 0.02, (41, 3)), axis=0) + np.array([0.0, 0.0, 1.0])
    poses = SimpleNamespace(
        tips_and_axes=lambda motion, t: (
            None,
            np.array([unit(axes[k] + share * (axes[k + 1] - axes[k])) for k, share in zip(motion, t, strict=True)]),
        )
    )
    columns = dict.fromkeys(("process", "law", "feed", "swing"))
    made = Sweep(stock=made_stock(), tools=tools, cell_error_sums=np.zeros((40, 3)), poses=poses, **columns)
    made._cutters.update({number: Cutter(radius, 0.0, 2) for number, radius in enumerate(RADII)})
    return made, axes


@pytest.mark.parametrize("seed", range(6))
def test_segments_can_touch_the_stock_beside_and_below_their_tool(seed):
    """A tool that leans may reach its radius below its tip, and a millimetre more, anywhere."""
    made, _ = swept(seed)
    given, top = segments(seed), -0.001
    x0, y0 = made.stock.x, made.stock.y
    x1, y1 = x0 + SIZE[1] * CELL_SIZE, y0 + SIZE[0] * CELL_SIZE
    expected = []
    for n in range(COUNT):
        low, high = np.minimum(given.begin[n], given.end[n]), np.maximum(given.begin[n], given.end[n])
        radius = RADII[made.tools.tool[given.motion[n]]]
        if given.leans[n]:
            expected.append(low[2] - radius - 1e-3 < top)
        else:
            near = low[0] - radius < x1 and high[0] + radius > x0 and low[1] - radius < y1 and high[1] + radius > y0
            expected.append(near and low[2] < top)
    assert made._can_touch(given, top).tolist() == expected


@pytest.mark.parametrize("seed", range(12))
def test_segments_of_one_kind_that_go_on_nearly_straight_are_swept_together(seed):
    """Up to twenty radii; cuts turn by less than 10°, and a tool that leans by less than 3°."""
    made, axes = swept(seed)
    given, tools = segments(seed), made.tools
    may_touch = np.random.default_rng(seed).random(COUNT) < 0.8

    def is_same_kind(n):
        def kind(k):
            return np.hypot(*given.leave[k, :2]) < 1e-3, given.leave[k, 2] < -1e-6

        a, b = given.motion[n - 1], given.motion[n]
        same_state = (tools.tool[a], tools.rpm[a], tools.hand[a]) == (tools.tool[b], tools.rpm[b], tools.hand[b])
        alike = may_touch[n] == may_touch[n - 1]
        joins = given.continues[n] and same_state and alike and given.cutting[n] == given.cutting[n - 1]
        joins |= not given.cutting[n] and given.leans[n] and a == b and alike
        return joins and (not may_touch[n] or not given.cutting[n] or given.leans[n] or kind(n) == kind(n - 1))

    def axis(n):
        motion = given.motion[n]
        return unit(axes[motion + 1])

    joins = [n > 0 and bool(is_same_kind(n)) for n in range(COUNT)]
    assert made._joins_previous(given, may_touch).tolist() == joins
    groups, begin, length = [], 0, 0.0
    for n in range(COUNT):
        ends = n > 0 and (not joins[n] or length > 20.0 * RADII[tools.tool[given.motion[begin]]])
        if n > 0 and not ends and may_touch[n] and given.cutting[n]:
            cosines = [given.leave[begin] @ given.leave[n], given.leave[begin] @ given.arrive[n]]
            ends = min(cosines) < np.cos(np.radians(10.0))
            if given.leans[n]:
                ends |= axis(begin) @ axis(n) < np.cos(np.radians(3.0))
        if ends:
            groups.append((begin, n))
            begin, length = n, 0.0
        length += np.linalg.norm(given.end[n] - given.begin[n])
    assert list(made._groups(given, may_touch)) == [*groups, (begin, COUNT)]
    assert list(made._groups(given.take(slice(0, 0)), may_touch[:0])) == []


def test_stations_in_air_are_in_the_middle_of_their_segments():
    made, _ = swept()
    given = replace(segments(3), first=np.full(COUNT, 0.2), last=np.full(COUNT, 0.6))
    found = made._air_stations(given, 5, 25)
    assert found.motion.tolist() == given.motion[5:25].tolist()
    np.testing.assert_allclose(found.t, 0.4)
    assert not found.wrench.any()
    assert not found.deviation.any()
    assert found.is_axial.tolist() == [bool(np.hypot(*row[:2]) < 1e-3) for row in given.leave[5:25]]
    for name in ("torque", "power", "depth", "width", "rate"):
        assert not getattr(found, name).any()
    assert np.isnan(found.enter).all()
    assert np.isnan(found.leave).all()


def test_stations_in_air_are_axial_along_the_spindle_only():
    made, _ = swept()
    leave = np.tile([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], (COUNT // 4, 1))
    found = made._air_stations(replace(segments(3), leave=leave), 0, 4)
    assert found.is_axial.tolist() == [False, False, True, True]


@pytest.mark.parametrize("seed", range(6))
def test_the_highest_level_near_positions_is_that_of_all_cells_the_tool_may_reach(seed):
    """It is no lower than that of the cells within the radius, and of none farther than three cells more."""
    made, _ = swept()
    stock = made.stock
    rng = np.random.default_rng(seed)
    position = rng.uniform([stock.x - 0.01, stock.y - 0.01, 0], [stock.x + 0.05, stock.y + 0.04, 0], (3, 3))
    radius = 3e-3
    found = made._highest_level(position, radius)
    rows, columns = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]), indexing="ij")
    x, y = stock.x + (columns + 0.5) * CELL_SIZE, stock.y + (rows + 0.5) * CELL_SIZE
    low, high = position[:, :2].min(axis=0), position[:, :2].max(axis=0)

    def level(reach):
        near = (x > low[0] - reach) & (x < high[0] + reach) & (y > low[1] - reach) & (y < high[1] + reach)
        return stock.high[near].max(initial=-np.inf)

    assert level(radius + 0.5 * CELL_SIZE) <= found <= level(radius + 3.5 * CELL_SIZE)
    assert made._highest_level(position + 1.0, radius) == -np.inf


def test_the_box_around_segments_is_wider_by_the_radius_of_the_tool():
    given = segments(4)
    low, high = sweep._extent(given, 10, 14, Cutter(4e-3, 0.0, 2))
    ends = np.concatenate([given.begin[10:14], given.end[10:14]])
    np.testing.assert_allclose(low, ends.min(axis=0) - 4e-3)
    np.testing.assert_allclose(high, ends.max(axis=0) + 4e-3)


def test_straight_runs_begin_where_the_direction_changes():
    """By more than a millionth."""
    chords = np.array([[1, 0, 0], [2, 0, 0], [1, 1e-7, 0], [1, 1e-5, 0], [0, 1, 0], [0, 3, 0], [0, 1, -0.1]]) * 0.01
    ends = np.cumsum(chords, axis=0)
    begin = ends - chords
    given = replace(segments(1).take(slice(0, 7)), begin=begin, end=ends)
    assert sweep._straight_runs(given, 0, 7).tolist() == [0, 3, 4, 6]
    assert sweep._straight_runs(given, 2, 6).tolist() == [2, 3, 4]
    assert sweep._straight_runs(given, 5, 6).tolist() == [5]


@pytest.mark.parametrize("corner", [0.0, 2e-3])
@pytest.mark.parametrize(("enter", "leave"), [(0.0, 90.0), (30.0, 140.0), (90.0, 180.0)])
@pytest.mark.parametrize("depth", [0.003, 0.008])
def test_sizes_of_a_cut_are_those_of_the_part_of_the_cylinder_in_material(corner, enter, leave, depth):
    """Angles, depth and width of a cut between two angles, to the spacing of the points."""
    cutter = Cutter(8e-3, corner, 2)
    turn = Turn.of(slice_cylinder(edge(cutter, 0.5e-3), 0.5e-3, 0.02), cutter, LAW, 0.5e-3, None)
    inside = (turn.phi > np.radians(enter)) & (turn.phi < np.radians(leave)) & (turn.radius > 7e-3)
    top = turn.low + np.where(np.isfinite(turn.rise), turn.rise, 0.0)
    cuts = np.where(inside & (top <= depth + 1e-6) & (turn.rise > 0.0), turn.length, 0.0).astype(np.float32)
    cuts = np.stack([cuts, 0.0 * cuts, 0.04 * cuts])
    found_enter, found_leave, found_depth, width = sweep._engagement_sizes(turn, cuts)
    assert np.degrees(found_enter[0]) == pytest.approx(enter, abs=4.0)
    assert np.degrees(found_leave[0]) == pytest.approx(leave, abs=4.0)
    expected = 8e-3 * abs(np.cos(np.radians(enter)) - np.cos(np.radians(leave)))
    assert width[0] == pytest.approx(expected, abs=0.6e-3)
    assert found_depth[0] == pytest.approx(depth, abs=1.1e-3)
    assert np.isnan(found_enter[1])
    assert np.isnan(found_leave[1])
    assert (found_depth[1], width[1]) == (0.0, 0.0)
