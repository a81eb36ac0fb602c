"""Tools that lean, pose by pose: sides, edges and chips against the solid of the tool and rigid-body motion."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from postproc.machining import stock as stocks
from postproc.machining import tilted
from postproc.machining.material import CuttingLaw
from postproc.machining.tilted import TiltedPath
from postproc.machining.tool import Cutter, Turn, edge
from postproc.machining.tool_path import StraightSegments
from tests.machining.test_map_by_cell import CUTTERS

LAW = CuttingLaw((8e8, 2e8, 1e8), (2e4, 2e4, 1e3), 0.0, 0.1, "made up")


def direction(lean, turn):
    """Unit vector (3,) that leans from z by an angle, turned about z [deg]."""
    lean, turn = np.radians([lean, turn])
    return np.array([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)])


def is_inside(cutter, tip, axis, points):
    """Whether points (n, 3) are inside of the solid of a tool, which goes on upwards without an end."""
    offset = points - tip
    height = offset @ axis
    distance = np.linalg.norm(offset - height[:, None] * axis, axis=1)
    lower = cutter.lower_side(np.minimum(distance, cutter.radius))
    return (distance < cutter.radius) & (height > lower)


def side_heights(cutter, tip, axis, x, y):
    """Heights (2,) at which a vertical line enters and leaves a tool, by a search and bisection; None if it misses."""
    z = np.linspace(-0.04, 0.12, 3201) + tip[2]
    inside = is_inside(cutter, tip, axis, np.column_stack([np.full(len(z), x), np.full(len(z), y), z]))
    if not inside.any():
        return None
    rows = np.flatnonzero(inside)
    ends = []
    for outer, inner in ((rows[0] - 1, rows[0]), (rows[-1] + 1, rows[-1])):
        if outer == len(z):
            ends.append(np.inf)
            continue
        a, b = z[outer], z[inner]
        for _ in range(40):
            middle = 0.5 * (a + b)
            if is_inside(cutter, tip, axis, np.array([[x, y, middle]]))[0]:
                b = middle
            else:
                a = middle
        ends.append(b)
    return np.array(ends)


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize("lean", [8.0, 25.0, 50.0])
def test_sides_of_a_leaning_tool_are_those_of_its_solid(shape, lean):
    """Lower and upper side over points, and the rise of the lower one with a move by finite differences."""
    cutter = CUTTERS[shape]
    rng = np.random.default_rng(int(lean))
    axis, tip = direction(lean, 40.0), np.zeros(3)
    shift, turn = np.array([2e-4, -1e-4, 1.5e-4]), np.cross(rng.normal(size=3), axis) * 0.01
    x, y = rng.uniform(-0.008, 0.012, (2, 60))
    low, high, slope = (
        values[0, 0] for values in tilted._lower_and_upper_sides(
            cutter, axis[None], x[None, None], y[None, None], shift[None], turn[None]
        )
    )  # fmt: skip
    step, met = 1e-4, 0
    for n in range(60):
        sides = side_heights(cutter, tip, axis, x[n], y[n])
        if sides is None or sides[1] - sides[0] < 1e-4:
            continue
        met += 1
        assert low[n] == pytest.approx(sides[0], abs=2e-6)
        leaves = np.array([x[n], y[n], sides[1]]) @ axis
        if np.isfinite(sides[1]) and leaves > cutter.corner + 1e-5:  # through the cylinder
            assert high[n] == pytest.approx(sides[1], abs=2e-6)
        moved = []
        for sign in (-1.0, 1.0):
            new_axis = axis + sign * step * turn
            found = side_heights(cutter, tip + sign * step * shift, new_axis / np.linalg.norm(new_axis), x[n], y[n])
            moved.append(None if found is None else found[0])
        if None not in moved and abs(moved[0] + moved[1] - 2 * sides[0]) < 1e-10:
            rise = (moved[1] - moved[0]) / (2.0 * step)
            assert slope[n] == pytest.approx(rise, abs=2e-2 * abs(rise) + 2e-6)
    assert met > 15
    beside = tilted._lower_and_upper_sides(
        cutter, axis[None], np.full((1, 1, 1), -0.05), np.zeros((1, 1, 1)), shift[None], turn[None]
    )
    assert [float(value[0, 0, 0]) for value in beside] == [np.inf, -np.inf, 0.0]


@pytest.mark.parametrize("shape", CUTTERS)
def test_cells_under_a_turning_tool_are_cut_to_its_lowest_level(shape):
    """Against poses five times as dense; volume and depth are sums over the cells."""
    cutter, cell = CUTTERS[shape], 1e-3
    stock = stocks.from_box(np.array([-0.02, -0.02, -0.02]), np.array([0.02, 0.02, 0.0]), cell)
    share = np.linspace(0.0, 1.0, 33)[:, None]
    tip = np.array([-0.004, 0.001, -0.004]) + share * np.array([0.005, 0.002, -0.001])
    axis = direction(20.0, 180.0) + share * (direction(28.0, 150.0) - direction(20.0, 180.0))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    swept = tilted.sweep(stock, cutter, tip, axis, 0.0)
    dense = np.linspace(0.0, 32.0, 161)
    rows, columns = stock.high.shape
    x, y = np.meshgrid(stock.x + (np.arange(columns) + 0.5) * cell, stock.y + (np.arange(rows) + 0.5) * cell)
    lowest, highest = np.full(stock.high.shape, np.inf), np.full(stock.high.shape, -np.inf)
    for place in dense:
        k = min(int(place), 31)
        pose, lean = (values[k] + (place - k) * (values[k + 1] - values[k]) for values in (tip, axis))
        lean = lean / np.linalg.norm(lean)
        low, high, _ = tilted._lower_and_upper_sides(
            cutter, lean[None], (x - pose[0])[None], (y - pose[1])[None], np.zeros((1, 3)), np.zeros((1, 3))
        )
        lowest, highest = np.minimum(lowest, low[0] + pose[2]), np.maximum(highest, high[0] + pose[2])
    found = np.concatenate([swept.footprint.cell, swept.front.cell])
    level = np.concatenate([swept.footprint.level, swept.front.level])
    material = stock.high.ravel()
    flat = lowest.ravel()
    expected = np.flatnonzero(flat < material - 1e-5)
    assert set(expected.tolist()) <= set(found.tolist())
    assert len(found) == len(set(found.tolist()))
    error = (level - flat[found])[np.isin(found, expected)]
    assert np.abs(error).max() < 1e-4  # at the rim, which passes some cells between two poses
    assert np.abs(error).mean() < 6e-6
    depth = np.maximum(material - np.maximum(flat, stock.floor.ravel()), 0.0)
    assert swept.depth == pytest.approx(depth.max(), abs=3e-5)
    kept = np.isin(np.arange(len(flat)), swept.footprint.cell)
    assert swept.removal == pytest.approx(depth[kept].sum() * cell**2, rel=0.02)
    above = np.maximum(material - np.maximum(highest.ravel(), stock.floor.ravel()), 0.0)[kept].sum() * cell**2
    assert swept.overhang == pytest.approx(above, rel=0.05, abs=1e-12)
    assert len(swept.front.cell) > 0


def turn_of(shape):
    cutter = CUTTERS[shape]
    edges = edge(Cutter(cutter.radius, cutter.corner, 2, drill=True), 1e-3)  # without the cylinder
    return Turn.of(edges, cutter, LAW, 1e-3, None)


@pytest.mark.parametrize("shape", CUTTERS)
def test_the_extent_of_a_piece_of_edge_is_that_along_z_of_the_map(shape):
    """By the ends of the piece: it goes outwards and up at kappa, the angle of its normal."""
    turn = turn_of(shape)
    rng = np.random.default_rng(2)
    axes = np.linalg.qr(rng.normal(size=(4, 3, 3)))[0]
    extent = tilted._vertical_extents(turn, axes)
    sine_of_kappa = np.sqrt(1.0 - turn.normal_down.astype(float) ** 2)
    for n in range(4):
        along = np.stack([turn.normal_down * np.sin(turn.phi), turn.normal_down * np.cos(turn.phi), sine_of_kappa])
        rise = np.abs(axes[n, 2] @ along) * turn.length
        np.testing.assert_allclose(extent[n], np.maximum(rise, 1e-7), rtol=2e-3, atol=1e-8)


@pytest.mark.parametrize("shape", ["ball", "bull"])
@pytest.mark.parametrize("hand", [1, -1])
def test_the_chip_of_a_turning_tool_is_the_motion_of_the_edge_along_its_normal(monkeypatch, shape, hand):
    """In the time of a tooth, as a rigid body: the tip moves, and the axis turns without spin."""
    turn, tooth = turn_of(shape), 0.005
    axis = direction(20.0, 70.0)
    heading = np.array([0.8, 0.5, -0.2])
    heading /= np.linalg.norm(heading)
    swing = np.cross(axis, np.array([6.0, -4.0, 18.0]))
    columns = {name: np.zeros((1, 3)) for name in TiltedPath.__struct_fields__}
    path = TiltedPath(**(columns | {
        "motion": np.array([0]), "t": np.array([0.5]), "tip": np.array([[1e-3, 2e-3, -1e-3]]), "axis": axis[None],
        "heading": heading[None], "pace": np.array([0.03]), "swing": swing[None],
    }))  # fmt: skip
    seen = []

    def of(given, middle, change):
        seen.append((middle, change))
        return SimpleNamespace(share=np.ones_like(middle))

    def engaged(stock, given, point, axes):
        seen.append((point, axes))
        return SimpleNamespace(length=np.ones(point.shape[:2]))

    monkeypatch.setattr(tilted.Chips, "of", of)
    monkeypatch.setattr(tilted, "tilted_cut_edge", engaged)
    monkeypatch.setattr(tilted, "mean_loads", lambda *parts: seen.append(parts[3:]) or "loads")
    result = tilted.loads(SimpleNamespace(cell=1e-3), turn, path, np.array([tooth]), np.array([hand]))
    (middle, change), (point, axes), (descent, width, cosine) = seen
    x = heading - (heading @ axis) * axis
    x /= np.linalg.norm(x)
    frame = np.column_stack([x, hand * np.cross(axis, x), axis])
    np.testing.assert_allclose(axes[0], frame, atol=1e-12)
    kappa = np.arccos(np.clip(turn.normal_down.astype(float), -1.0, 1.0))
    rise = np.where(np.isfinite(turn.rise), turn.rise, 0.0)
    local = np.column_stack([
        turn.radius * np.sin(turn.phi), turn.radius * np.cos(turn.phi), turn.low + 0.5 * rise
    ])  # fmt: skip
    places = local @ frame.T
    np.testing.assert_allclose(point[0], path.tip[0] + places, atol=1e-8)
    spin = np.cross(axis, swing)
    motion = tooth * (0.03 * heading + np.cross(spin, places))
    normal = np.column_stack([np.sin(kappa) * np.sin(turn.phi), np.sin(kappa) * np.cos(turn.phi), -np.cos(kappa)])
    np.testing.assert_allclose(middle[0], np.einsum("pi,pi->p", motion, normal @ frame.T), atol=2e-7)
    bent = turn.tangent[turn.round].astype(float)
    np.testing.assert_allclose(
        change[0], np.einsum("pi,pi->p", motion[turn.round], bent @ frame.T), atol=2e-7
    )  # fmt: skip
    assert descent[0] == pytest.approx(max(-heading @ axis, 0.0))
    # on a ball each piece counts with the slope of its own surface
    assert width == pytest.approx(1e-3 if shape == "ball" else 1e-3 / np.sqrt(axis[2]))
    np.testing.assert_allclose(cosine[0], np.abs((normal @ frame.T)[:, 2]), atol=1e-6)
    assert result[0] == "loads"
    assert result[2].tolist() == [False]


def test_axes_of_an_edge_follow_the_travel_or_the_map():
    """Along the spindle, and at rest, x is that of the map, square to the tool."""
    axis = np.array([direction(20.0, 10.0), direction(20.0, 10.0), direction(35.0, 200.0), [0, 0, 1.0]])
    travel = np.array([[0.6, 0.0, 0.8], direction(20.0, 10.0), [0, 0, 0], [0, 1.0, 0]])
    axes, is_axial = tilted.local_axes(travel, axis)
    assert is_axial.tolist() == [False, True, True, False]
    for n in range(4):
        np.testing.assert_allclose(axes[n].T @ axes[n], np.eye(3), atol=1e-12)
        assert np.linalg.det(axes[n]) == pytest.approx(1.0)
        np.testing.assert_allclose(axes[n][:, 2], axis[n], atol=1e-12)
        wanted = [1.0, 0.0, 0.0] if is_axial[n] else travel[n]
        across = np.cross(axis[n], wanted)
        assert abs(axes[n][:, 0] @ across) < 1e-12
        assert axes[n][:, 0] @ wanted > 0.0


def segments_of(begin, end):
    count = len(begin)
    leave = (end - begin) / np.maximum(np.linalg.norm(end - begin, axis=1), 1e-12)[:, None]
    no = np.zeros(count, dtype=bool)
    return StraightSegments(
        np.arange(count) + 1, np.full(count, 0.25), np.full(count, 0.75), begin, end, leave, leave, ~no, no, ~no
    )


def test_pieces_of_the_path_are_so_short_that_no_cell_and_no_ridge_is_passed_over():
    """By travel and by the turn of the tool at its radius; speeds are those of the tip, or of a turn at rest."""
    cutter, cell = CUTTERS["bull"], 0.4e-3
    begin = np.array([[0, 0, 0], [0.003, 0, 0], [0.003, 0.001, 0], [0.003, 0.001, 0.0]])
    end = np.array([[0.003, 0, 0], [0.003, 0.001, 0], [0.003, 0.001, 0], [0.003, 0.001, 0.0]])
    first = np.array([direction(lean, 0.0) for lean in (10.0, 10.0, 20.0, 20.0)])
    last = np.array([direction(lean, 0.0) for lean in (10.0, 20.0, 30.0, 20.5)])
    feed, swing = np.array([9.0, 0.02, 0.03, 9.0, 9.0]), np.array([9.0, 9.0, 9.0, 0.5, np.nan])
    path = TiltedPath.of(segments_of(begin, end), first, last, cutter, cell, feed=feed, swing=swing)
    step = min(cell, np.sqrt(8.0 * 2e-3 * 1e-6))
    at = 0
    for k in range(4):
        length, turned = np.linalg.norm(end[k] - begin[k]), np.linalg.norm(last[k] - first[k])
        count = max(1, int(np.ceil((length + 5e-3 * turned) / step - 1e-6)))
        rows = np.arange(at, at + count)
        assert path.motion[rows].tolist() == [k + 1] * count
        for n, row in enumerate(rows):
            for share, tip, axis in (
                (n / count, path.begin[row], path.begin_axis[row]),
                ((n + 0.5) / count, path.tip[row], path.axis[row]),
                ((n + 1) / count, path.end[row], path.end_axis[row]),
            ):
                np.testing.assert_allclose(tip, begin[k] + share * (end[k] - begin[k]), atol=1e-12)
                lean = first[k] + share * (last[k] - first[k])
                np.testing.assert_allclose(axis, lean / np.linalg.norm(lean), atol=1e-12)
            assert path.t[row] == pytest.approx(0.25 + 0.5 * (n + 0.5) / count)
        time = length / feed[k + 1] if length > 0.0 else turned / 0.5 if k == 2 else None
        if time is not None:
            np.testing.assert_allclose(path.swing[rows], [(last[k] - first[k]) / time] * count, rtol=1e-9, atol=1e-9)
        pace = feed[k + 1] if length > 0.0 else 0.0 if k == 2 else np.nan
        np.testing.assert_array_equal(path.pace[rows], np.full(count, pace))
        at += count
    assert len(path.t) == at
    tips, axes = path.poses
    assert tips.shape == axes.shape == (at + 1, 3)
    np.testing.assert_array_equal(tips[-1], path.end[-1])
    np.testing.assert_array_equal(axes[:-1], path.begin_axis)
    np.testing.assert_allclose(np.linalg.norm(path.heading, axis=1)[:3], 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_the_distance_from_a_rounded_tool_is_that_from_the_points_of_its_side(seed):
    """Below zero inside; by a dense profile of end face, corner and cylinder."""
    cutter = CUTTERS["bull"]
    rng = np.random.default_rng(seed)
    axis = direction(30.0, 100.0)
    x, y, z = rng.uniform(-0.008, 0.008, (3, 200))
    axial, square = x * axis[0] + y * axis[1], x * x + y * y
    found = tilted._surface_distances(cutter, z, axial, np.full(200, axis[2]), square)
    angle = np.linspace(0.0, 0.5 * np.pi, 4001)
    profile = np.concatenate([
        np.column_stack([np.linspace(0.0, 3e-3, 4001), np.zeros(4001)]),
        np.column_stack([3e-3 + 2e-3 * np.sin(angle), 2e-3 - 2e-3 * np.cos(angle)]),
        np.column_stack([np.full(8001, 5e-3), np.linspace(2e-3, 0.03, 8001)]),
    ])  # fmt: skip
    points = np.column_stack([x, y, z])
    inside = is_inside(cutter, np.zeros(3), axis, points)
    for n in range(200):
        height = points[n] @ axis
        radius = np.linalg.norm(points[n] - height * axis)
        gap = np.hypot(profile[:, 0] - radius, profile[:, 1] - height).min()
        assert found[n] == pytest.approx(-gap if inside[n] else gap, abs=5e-6)
