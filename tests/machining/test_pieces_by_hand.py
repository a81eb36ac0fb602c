"""Small pieces of the forces of a process, each worked out by hand: comments, passes, branches, profiles, depths."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from postproc.errors import ForceError
from postproc.machining import branches, cutting, profiles, resolution, tilted
from postproc.machining import stock as stocks
from postproc.machining.leaning import depth_inside
from postproc.machining.tool import Cutter
from postproc.machining.tool_comments import Comment, commented_tools, cutter_of, named_text, stock_size

DIAMETERS = {
    "CUTTER/ 12.0": 12.0, "D=8": 8.0, "D : 8.5": 8.5, "D=.25in": 6.35, 'D=1/4"': 6.35, "D=0.5 inches": 12.7,
    "diameter 10": 10.0, "tool dia. = 10 mm": 10.0, "DIA 3/8": 9.525, "{6 mm}": 6.0, "⌀ 20": 20.0, "Ø4": 4.0,
    "10 dia": 10.0, "6 mm flat end mill": 6.0, "8 ball nose endmill": 8.0, "1-1/2 drill": 38.1, "1 1/2 drill": 38.1,
    "end mill 12": 12.0, "drill, long: 5.5": 5.5, "Schaftfräser 16": 16.0, "dia off 3": None, "mill": None,
    "D=1/0": None, "D=0": None,
}  # fmt: skip


@pytest.mark.parametrize("text", DIAMETERS)
def test_a_diameter_is_read_in_each_of_its_forms(text):
    """Fractions are of an inch; other lengths are mm unless they say otherwise, or the program is in inches."""
    assert cutter_of(text, inches=False).diameter_mm == pytest.approx(DIAMETERS[text])
    if DIAMETERS[text] and not any(unit in text for unit in ("mm", "in", '"', "/")):
        assert cutter_of(text, inches=True).diameter_mm == pytest.approx(25.4 * DIAMETERS[text])
    if "CUTTER" in text:
        assert cutter_of(text, inches=True).diameter_mm == pytest.approx(304.8)


def test_lengths_in_inches_are_millimetres_to_a_nanometre():
    cutter = cutter_of("D=1/3in CR=1/7in bull", inches=False)
    assert (cutter.diameter_mm, cutter.corner_radius_mm) == (8.466667, 3.628571)
    assert stock_size([Comment(1, "stock size X=1/3in Y=1/7in Z=2/3in")], inches=False) == (
        8.466667,
        3.628571,
        16.933333,
    )


@pytest.mark.parametrize(
    ("text", "shape", "corner", "flutes"),
    [
        ("D=10 flat", "flat", 0, None), ("D=10 square end mill 3 flutes", "flat", 0, 3),
        ("D=10 ball 2FL", "ball", 0, 2),
        ("D=10 Kugelfräser Z=4", "ball", 0, 4), ("D=10 Torus R=2", "bull", 2, None), ("D=10 Bohrer", "drill", 0, None),
        ("D=50 face mill teeth = 6", "flat", 0, 6), ("D=10 R=1.5", "bull", 1.5, None), ("D=10 CR=5", "ball", 0, None),
        ("D=10 CR=4.99", "bull", 4.99, None), ("D=10 corner radius 1 mm 12 teeth", "bull", 1, 12),
        ("D=10", None, 0, None),
        ("D=10 CR=0.1in", "bull", 2.54, None), ("D=10 chamfer", None, 0, None),
        ("D=10 drill TAPER=118deg", "drill", 0, None),
        ("D=10 flat TAPER=0deg", "flat", 0, None), ("D=10 flat TAPER=3deg", None, 0, None),
        ("D=10 Z=-3", None, 0, None),
        ("D=10 Z=4.5", None, 0, None), ("CUTTER/ 12, 1.5", "bull", 1.5, None), ("CUTTER/ 12, 6", "ball", 0, None),
        ("D=10 tap", None, 0, None), ("D=10 drill CR=2", "drill", 0, None), ("ball", "ball", 0, None),
    ],
)  # fmt: skip
def test_shape_corner_and_flutes_are_read(text, shape, corner, flutes):
    cutter = cutter_of(text, inches=False)
    assert (cutter.shape, cutter.corner_radius_mm, cutter.flutes) == (shape, pytest.approx(corner), flutes)


@pytest.mark.parametrize(("line", "is_its"), [(3, False), (4, True), (12, True), (13, False)])
def test_a_comment_is_of_the_tool_change_in_its_line_or_up_to_eight_after_it(line, is_its):
    found = commented_tools([Comment(4, "end mill 6 mm")], [(line, 7), (40, 8)], inches=False)
    assert set(found) == ({7} if is_its else set())


def test_a_comment_with_a_shape_waits_for_one_with_a_diameter():
    comments = [Comment(1, "T2 ball"), Comment(2, "T2 D=6 flat"), Comment(3, "T2 D=9 drill"), Comment(4, "T3 spare")]
    found = commented_tools(comments, [], inches=False)
    assert set(found) == {2}
    assert (found[2].shape, found[2].diameter_mm, found[2].text) == ("flat", 6.0, "T2 D=6 flat")


@pytest.mark.parametrize(
    ("number", "text", "expected"),
    [
        (1, "T1 D=16.", "T1 D=16."),
        (2, "T1 D=16.", "T2 T1 D=16."),
        (3, "mill", "T3 mill"),
        (4, "Tool #4: x", "Tool #4: x"),
    ],
)
def test_a_comment_is_named_with_its_tool_once(number, text, expected):
    assert named_text(number, text) == expected


@pytest.mark.parametrize(
    ("comments", "size", "inch_size"),
    [
        (["stock 100 x 80 x 20"], (100, 80, 20), (2540, 2032, 508)),
        (["blank: 4 x 3 x 1/2 in"], (101.6, 76.2, 12.7), (101.6, 76.2, 12.7)),
        (["Stock size", "X=10 Y=20", "X=30 Y=40 Z=50 mm"], (30, 40, 50), (762, 1016, 50)),
        (["Material Size", "", "", "X=30 Y=40 Z=50"], None, None),
        (["block size X: 1 Y: 2 Z: 3"], (1, 2, 3), (25.4, 50.8, 76.2)), (["X=30 Y=40 Z=50"], None, None),
    ],
)  # fmt: skip
def test_the_stock_is_read_in_each_of_its_forms(comments, size, inch_size):
    numbered = [Comment(line, text) for line, text in enumerate(comments, start=1)]
    for inches, expected in ((False, size), (True, inch_size)):
        assert stock_size(numbered, inches=inches) == (expected if expected is None else pytest.approx(expected))


def segments(begin, end, motion):
    return SimpleNamespace(begin=np.array(begin, float), end=np.array(end, float), motion=np.array(motion))


def test_motions_near_the_stock_are_those_within_a_radius_and_below_its_top():
    """The block is 10 by 6 m in these numbers, its top at 1; the margin is 2."""
    places = [
        (-1.9, 3, 0), (-2.1, 3, 0), (11.9, 3, 0), (12.1, 3, 0), (5, -1.9, 0), (5, -2.1, 0), (5, 7.9, 0), (5, 8.1, 0),
        (5, 3, 0.9), (5, 3, 1.1),
    ]  # fmt: skip
    near = branches.near_stock(segments(places, places, range(10)), (0, 10, 0, 6, 1), 2.0, 11)
    assert near.tolist() == [True, False] * 5 + [False]
    through = segments([(-5, 3, 9), (5, 20, 9)], [(15, 3, 0), (5, -20, 9)], [1, 3])  # across; above
    assert branches.near_stock(through, (0, 10, 0, 6, 1), 2.0, 4).tolist() == [False, True, False, False]


def test_a_branch_that_cuts_is_refused_if_a_later_motion_comes_near():
    """At its first cut, with the place of the first motion near the stock behind it."""

    def program(*spans):
        names = {"part.src": range(8), "sub.src": range(8, 12)}

        def places(rows):
            files = [next(name for name, inside in names.items() if row in inside) for row in rows]
            return SimpleNamespace(of=lambda k: (files[k], 100 + int(rows[k])))

        return SimpleNamespace(motions=range(12), branches=spans, places=places)

    near = np.zeros(12, dtype=bool)
    near[[1, 6, 9]] = True
    for spans, cut, line, later in (
        ([(2, 5)], [3, 4], 103, "line 106"), ([(2, 5)], [1, 6], None, ""), ([(0, 2), (5, 7)], [6], 106, "sub.src:109"),
        ([(8, 10)], [8], None, ""), ([(2, 6)], [2], 102, "line 106"), ([(2, 5)], [5], None, ""),
    ):  # fmt: skip
        if line is None:
            branches.check_branches(program(*spans), np.array(cut), near)
            continue
        with pytest.raises(ForceError) as refused:
            branches.check_branches(program(*spans), np.array(cut), near)
        assert (refused.value.file, refused.value.line) == ("part.src", line)
        assert f"so that the stock on {later} is not known" in str(refused.value)


def thin(monkeypatch, rapid, tool, shares, begins=(0,)):
    """Thin passes of a program: per motion its tool and the deviation by the cells, as a share of 100 N."""
    monkeypatch.setattr(
        resolution, "operations", lambda program, at_retracts: [SimpleNamespace(first=first) for first in begins]
    )
    program = SimpleNamespace(motions=SimpleNamespace(rapid=np.array(rapid, dtype=bool)))
    squares = (100.0 * np.array(shares)) ** 2
    force = 1e4 * (1.0 - np.array(rapid))
    sums = resolution.CellErrors(squares, squares, 0.05**2 * force, force)
    return [
        (p.first, p.tool, pytest.approx(p.force_share))
        for p in resolution.thin_passes(program, SimpleNamespace(tool=np.array(tool)), sums)
    ]


def test_finer_cells_are_needed_from_the_first_pass_on_of_which_the_rest_needs_them(monkeypatch):
    """Passes are at the motions 1-2, 4 and 6-7; a pass counts with the root mean square of its motions."""
    rapid = [1, 0, 0, 1, 0, 1, 0, 0]
    none = [0.0, 0.01, 0.01, 0.0, 0.01, 0.0, 0.01, 0.01]
    assert thin(monkeypatch, rapid, [0] * 8, none) == []
    last = [0.0, 0.01, 0.01, 0.0, 0.06, 0.0, 0.1, 0.1]
    assert thin(monkeypatch, rapid, [0] * 8, last) == [(4, 0, np.sqrt((0.06**2 + 2 * 0.1**2) / 3))]
    assert thin(monkeypatch, rapid, [0] * 8, [0.0, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0]) == [(1, 0, np.sqrt(0.08 / 5))]
    alone = [0.0, 0.08, 0.08, 0.0, 0.0, 0.0, 0.0, 0.0]  # thin, but not the rest of the operation with it
    assert thin(monkeypatch, rapid, [0] * 8, alone) == []
    assert thin(monkeypatch, rapid, [0] * 8, alone, (0, 4)) == [(1, 0, 0.08)]
    assert thin(monkeypatch, rapid, [2, 2, 2, 2, 5, 5, 5, 5], last) == [(4, 5, np.sqrt((0.06**2 + 2 * 0.1**2) / 3))]
    assert thin(monkeypatch, [0, 1], [0, 0], [0.0551, 0.0]) == [(0, 0, 0.0551)]
    assert thin(monkeypatch, [0, 1], [0, 0], [0.0549, 0.0]) == []
    assert thin(monkeypatch, [1, 1], [0, 0], [0.5, 0.5]) == []


def test_cells_are_divided_until_a_tenth_more_than_enough():
    """By the excess, rounded up beyond a tenth; no more than twelve million cells; a factor of one is none."""
    passes = [resolution.ThinPasses(row, 0, 0.3, excess) for row, excess in ((3, 2.09), (5, 2.11), (7, 1.09), (9, 20))]
    assert resolution.cell_divisors(passes, 120_000, [0]) == {3: 2, 5: 3, 9: 10}
    assert resolution.cell_divisors(passes, 1_000_000, [0]) == {3: 2, 5: 3, 9: 3}


def profile(t, values, frame=0):
    values = np.array(values, dtype=float)
    return profiles._Profile(
        np.array(t, dtype=float), np.column_stack([values, np.zeros((len(values), 11))]), np.full(len(t), frame)
    )


@pytest.mark.parametrize(
    ("first", "second", "are_equal"),
    [
        (profile([0, 1], [0, 10]), profile([0, 0.5, 1], [0, 5, 10]), True),
        (profile([0, 1], [0, 10]), profile([0, 0.5, 1], [0, 5.0019, 10]), True),
        (profile([0, 1], [0, 10]), profile([0, 0.5, 1], [0, 5.0021, 10]), False),
        (profile([0, 1], [0, 10]), profile([0, 1], [0, 10], 1), False),
        (profile([np.nan], [4]), profile([np.nan], [4.0019]), True),
        (profile([np.nan], [4]), profile([np.nan], [4.0021]), False),
        (profile([np.nan], [4]), profile([0, 1], [4, 4]), False),
        (profile([np.nan], [0.0019]), profile([0, 1], [0, 0.001], 1), True),
        (profile([np.nan], [0.0021]), profile([0, 1], [0, 0.001], 1), False),
    ],
)  # fmt: skip
def test_profiles_are_equal_within_two_millinewtons_all_along(first, second, are_equal):
    assert profiles._are_equal(first, second) == are_equal
    assert profiles._are_equal(second, first) == are_equal


def test_wrenches_between_stations_are_linear_and_constant_beyond_them():
    motion, t = np.array([2, 2, 2, 5]), np.array([0.2, 0.4, 0.8, 0.5])
    wrench = np.outer([1.0, 3.0, 11.0, 7.0], [1, 2, 3, -1, -2, -3])
    found = profiles._wrenches_at(
        motion, t, wrench, np.array([2, 2, 2, 2, 2, 2, 5, 5]), np.array([0, 0.2, 0.3, 0.5, 0.8, 1, 0, 1])
    )
    np.testing.assert_allclose(found[:, 0], [1, 1, 2, 5, 11, 11, 7, 7])
    np.testing.assert_allclose(found[:, 4], -2 * found[:, 0])


def test_knots_are_at_the_start_the_end_of_the_rise_the_stations_behind_it_and_the_end():
    """Motions: a rise to 0.3; no rise, long; no rise, short; one station."""
    first, t = np.array([0, 3, 5, 7]), np.array([0.2, 0.3, 0.7, 0.0, 0.4, 0.1, 0.5, 0.5])
    row, place = profiles._knot_places(np.array([True, True, False, True]), np.array([0.3, 1.0, 1.0, 0.25]), first, t)
    assert list(zip(row.tolist(), place.tolist(), strict=True)) == [
        (0, 0.0), (0, 0.3), (0, 0.7), (0, 1.0), (1, 0.0), (1, 0.4), (1, 1.0), (2, 0.0), (2, 1.0),
        (3, 0.0), (3, 0.25), (3, 1.0),
    ]  # fmt: skip


def test_a_motion_begins_with_the_force_before_it_within_a_hundredth_or_a_newton_and_a_tenth_of_a_newtonmetre():
    first, wrench = np.array([0, 2]), np.zeros((4, 6))
    wrench[0, 0], wrench[0, 5] = 300.0, 30.0  # a hundredth: 3 N and 0.3 N·m
    for force, moment, expected in (
        (0.9, 0.09, [1, 1]),
        (1.1, 0.0, [1, 0]),
        (0.0, 0.11, [1, 0]),
        (3.1, 0.0, [0, 0]),
        (0.0, 0.31, [0, 0]),
    ):
        after = np.tile([0.0, force, 0.0, 0.0, moment, 0.0], (2, 1))
        assert profiles._begins_with_last_force(np.zeros((2, 6)), after, wrench, first).tolist() == [
            bool(x) for x in expected
        ]


def test_deviations_in_other_axes_are_those_of_independent_components():
    angle = np.radians(30.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    found = profiles._rotated_deviations(turn[None], np.array([[4.0, 2.0, 1.0, 0.4, 0.2, 0.1]]))
    np.testing.assert_allclose(
        found[0, :3], [np.hypot(4 * turn[0, 0], 2 * turn[0, 1]), np.hypot(4 * turn[1, 0], 2 * turn[1, 1]), 1]
    )
    np.testing.assert_allclose(found[0, 3:], 0.1 * found[0, :3])


BLOCK = (np.array([0.0, 0.0, -0.02]), np.array([0.06, 0.04, 0.0]))
UP = np.array([[0.0, 0.0, 1.0]])


@pytest.mark.parametrize("shape", ["flat", "ball", "bull"])
def test_the_depth_of_an_upright_tool_is_that_of_its_end_but_for_a_cell(shape):
    """Nothing beside the block, above it, or under its floor; a flat end is exact but for 20 µm."""
    cell = 0.5e-3
    stock = stocks.from_box(*BLOCK, cell)
    cutter = Cutter(5e-3, {"flat": 0.0, "ball": 5e-3, "bull": 2e-3}[shape], 2)
    missing = 2e-5 if shape == "flat" else cell
    for x, y, depth in ((0.03, 0.02, 3e-3), (0.002, 0.001, 4e-3), (0.062, 0.02, 5e-3)):
        found = depth_inside(stock, cutter, np.array([[x, y, -depth]]), UP)
        beside = max(x - 0.06, 0.0)
        rise = cutter.lower_side(np.array([beside]))[0] if beside else 0.0
        assert found == pytest.approx(depth - missing - rise, abs=(1e-6 if not beside else 6e-4))
    for tip in ([0.03, 0.02, 1e-3], [0.066, 0.02, -5e-3], [0.03, -0.006, -5e-3]):
        assert depth_inside(stock, cutter, np.array([tip]), UP) == 0.0


def test_of_many_poses_the_deepest_counts():
    stock = stocks.from_box(*BLOCK, 0.5e-3)
    tips = np.tile([0.03, 0.02, -1e-3], (300, 1))
    for row in (0, 127, 128, 299):
        deeper = tips.copy()
        deeper[row, 2] = -2e-3
        assert depth_inside(stock, Cutter(5e-3, 0.0, 2), deeper, np.tile(UP, (300, 1))) == pytest.approx(
            1.98e-3, abs=1e-6
        )


def test_a_move_without_knots_has_one_wrench_of_zero():
    """Equal to one whose force is next to nothing, and to no other."""
    knots = SimpleNamespace(
        ramped=np.array([True, False, False]), t=np.array([0.3, 0.0, 1.0]), frame=np.array([1, 0, 0]),
        wrench=np.full((3, 6), 5.0), sigma=np.full((3, 6), 0.5),
    )  # fmt: skip
    nothing = profiles._profile(knots, 1, 1)
    assert (nothing.t.tolist(), nothing.values.tolist(), nothing.frame.tolist()) == ([0.0], [[0.0] * 12], [0])
    constant, line = profiles._profile(knots, 0, 1), profiles._profile(knots, 1, 3)
    assert np.isnan(constant.t).tolist() == [True]
    assert (line.t.tolist(), line.frame.tolist()) == ([0.0, 1.0], [0, 0])
    np.testing.assert_allclose(line.values, [[5.0] * 6 + [0.5] * 6] * 2)
    assert not profiles._are_equal(nothing, line)
    assert not profiles._are_equal(nothing, constant)
    assert profiles._are_equal(nothing, profile([0, 1], [0.001, 0.0]))
    other = constant._replace(values=constant.values + np.eye(12)[3] * 0.01)  # one moment alone
    assert not profiles._are_equal(constant, other)


@pytest.mark.parametrize(("height", "limit"), [(0.0, 2.9), (1.0, 4.632), (2.0, 4.9), (9.0, 4.9)])
@pytest.mark.parametrize("axis", [(1.0, 0.0), (0.0, 1.0), (-0.6, 0.8)])
def test_points_ahead_of_an_upright_tool_are_near_its_side_or_outside_of_it(height, limit, axis):
    """A tool of radius 5 with a corner of 2 moves along x, y or between by 1; the margin is 0.1 [mm].

    Behind it nothing is ahead.
    """
    along = np.array(axis) / np.hypot(*axis)
    tip = np.array([[0.0, 0.0, 3e-3], [*(1e-3 * along), 3e-3]])
    distance = 1e-3 * np.array([[[limit - 0.01, limit + 0.01, -limit - 0.01, 8.0, -8.0]]]) + 1e-3
    level = np.full((1, 1, 5), 3e-3 + 1e-3 * height)
    points = distance * along[0], distance * along[1], level
    found = tilted._is_outward_side(Cutter(5e-3, 2e-3, 2), tip, np.tile(UP, (2, 1)), np.array([0]), points, 1e-4)
    assert found.ravel().tolist() == [False, True, False, True, False]


def test_points_ahead_of_a_turning_tool_are_on_the_side_to_which_its_axis_turns():
    """About the tip: at 8 mm above it the tool moves towards +x, at the height of the tip not at all."""
    tip, lean = np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0], [np.sin(0.1), 0.0, np.cos(0.1)]])
    x, level = 1e-3 * np.array([[[7.0, -7.0, 7.0]]]), 1e-3 * np.array([[[8.0, 8.0, -8.0]]])
    found = tilted._is_outward_side(Cutter(5e-3, 0.0, 2), tip, lean, np.array([0]), (x, 0.0 * x, level), 1e-4)
    assert found.ravel().tolist() == [True, False, False]


@pytest.mark.parametrize("most", [30, 400, 10**6])
def test_windows_contain_all_cells_near_their_segments_and_batches_are_limited(monkeypatch, most):
    """Each segment whose window is on the map is once in a batch, small windows first."""
    monkeypatch.setattr(stocks, "MOST_CELLS_AT_ONCE", most)
    stock = stocks.from_box(*BLOCK, 2e-3)
    rng = np.random.default_rng(6)
    begin = rng.uniform([-0.02, -0.02, -0.01], [0.08, 0.06, 0.0], (40, 3))
    end = begin + rng.uniform(-0.01, 0.01, (40, 3)) * rng.choice([0.1, 1.0, 3.0], (40, 1))
    rows_y, columns = stock.high.shape
    x = stock.x + stock.cell * (np.arange(columns) + 0.5)
    y = stock.y + stock.cell * (np.arange(rows_y) + 0.5)
    taken, sizes = [], []
    for rows, corner, window in stocks.windows(stock, 5e-3, begin, end):
        assert len(rows) == 1 or len(rows) * window.prod() <= 4 * most
        assert (corner >= 0).all()
        assert (corner + window <= [columns, rows_y]).all()
        sizes.append(window.prod())
        for row, (column, line) in zip(rows.tolist(), corner.tolist(), strict=True):
            taken.append(row)
            low, high = np.minimum(begin[row], end[row]) - 5e-3, np.maximum(begin[row], end[row]) + 5e-3
            near_x = np.flatnonzero((x + 1e-3 > low[0]) & (x - 1e-3 < high[0]))
            near_y = np.flatnonzero((y + 1e-3 > low[1]) & (y - 1e-3 < high[1]))
            assert near_x.min() >= column
            assert near_x.max() < column + window[0]
            assert near_y.min() >= line
            assert near_y.max() < line + window[1]
    low, high = np.minimum(begin, end)[:, :2] - 5e-3, np.maximum(begin, end)[:, :2] + 5e-3
    map_low, map_high = (
        np.array([stock.x, stock.y]) + stock.cell * np.array(size) for size in ((0, 0), (columns, rows_y))
    )
    on_map = ((high > map_low) & (low < map_high)).all(axis=1)
    assert sorted(taken) == np.flatnonzero(on_map).tolist()
    assert most < 10**6 or len(sizes) == 1
    assert most > 30 or len(sizes) > 10


@pytest.mark.parametrize("shape", ["flat", "ball", "bull"])
@pytest.mark.parametrize("slope", [0.0, -0.5, 0.5, -1.0])
def test_the_front_of_a_tool_is_where_its_surface_moves_outwards(shape, slope):
    """Its outward normal along the travel: on the rounds away from the middle of the round, on a flat end down."""
    stock = stocks.from_box(*BLOCK, 1e-3)
    radius, corner = 5e-3, {"flat": 0.0, "ball": 5e-3, "bull": 2e-3}[shape]
    point, along = np.array([0.03, 0.02, -1e-3]), np.sqrt(1.0 - slope**2)
    direction = np.array([0.6 * along, 0.8 * along, slope])
    rows, columns = stock.high.shape
    cell = np.arange(rows * columns)
    found = stocks._is_under_front(stock, Cutter(radius, corner, 2), cell, point, direction, rim=False)
    at_rim = stocks._is_under_front(stock, Cutter(radius, corner, 2), cell, point, direction, rim=True)
    for k in cell.tolist():
        x = stock.x + 1e-3 * (k % columns + 0.5) - point[0]
        y = stock.y + 1e-3 * (k // columns + 0.5) - point[1]
        distance = np.hypot(x, y)
        if distance > radius + 0.9e-3:
            assert distance < radius + 1.1e-3 or not found[k] or (shape == "flat" and slope == 0.0)
            continue
        assert at_rim[k] == (x * direction[0] + y * direction[1] > 0.0)
        outside = max(distance - (radius - corner), 0.0)
        if distance > radius:
            continue
        normal = np.array([0.0, 0.0, -1.0])
        if corner and outside > 0.0:
            normal = (
                np.array([x / distance * outside, y / distance * outside, -np.sqrt(corner**2 - outside**2)]) / corner
            )
        if shape == "flat" and slope == 0.0:
            assert found[k] == (x * direction[0] + y * direction[1] > 0.0)
        elif abs(normal @ direction) > 1e-9:
            assert found[k] == (normal @ direction > 0.0)


def test_the_depth_of_a_cut_is_that_of_cells_that_the_tool_covers_fully():
    """On both ways along; nothing above the block, and no more than down to its floor."""
    stock = stocks.from_box(*BLOCK, 0.5e-3)
    begin, end = (
        np.array([[-0.01, 0.02, -2e-3], [0.03, 0.02, 1e-3]]),
        np.array([[0.02, 0.02, -3e-3], [0.05, 0.02, 1e-3]]),
    )
    for first, last in ((begin, end), (end, begin)):
        assert stocks.depth_of_cut(stock, Cutter(5e-3, 0.0, 2), first, last) == pytest.approx(3e-3, abs=1e-6)
        assert stocks.depth_of_cut(stock, Cutter(5e-3, 0.0, 2), first[1:], last[1:]) == 0.0
    deep = np.array([[0.03, 0.02, -0.05]])
    assert stocks.depth_of_cut(stock, Cutter(5e-3, 0.0, 2), deep, deep + np.array([0.01, 0, 0])) == pytest.approx(
        0.02, abs=1e-6
    )


@pytest.mark.parametrize("rows_at_once", [1, 4, 1000])
def test_the_map_of_a_wedge_is_its_plane_however_many_rows_are_taken_at_once(monkeypatch, rows_at_once):
    """The top rises from 2 to 12 mm along y, the floor is at −3 mm; ten rows are no multiple of four."""
    corners = [
        (x, y, z) for x in (0.0, 0.02) for y, heights in ((0.0, (-3e-3, 2e-3)), (0.02, (-3e-3, 12e-3))) for z in heights
    ]
    quads = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5)]
    faces = np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])
    whole = stocks.from_mesh(np.array(corners), faces, 2e-3)
    rows, columns = whole.high.shape
    monkeypatch.setattr(stocks, "MOST_PAIRS", rows_at_once * columns * stocks._SUBDIVISION**2)
    stock = stocks.from_mesh(np.array(corners), faces, 2e-3)
    y = stock.y + 2e-3 * (np.arange(rows) + 0.5)
    inside = (y > 1e-3) & (y < 0.019)
    middle = columns // 2
    np.testing.assert_allclose(stock.high[inside, middle], 2e-3 + 0.5 * y[inside], atol=1e-7)
    np.testing.assert_allclose(stock.floor[inside, middle], -3e-3, atol=1e-7)
    for name in ("high", "low", "share", "floor"):
        np.testing.assert_array_equal(getattr(stock, name), getattr(whole, name))
    assert stock.volume() == pytest.approx(0.02 * 0.02 * 10e-3, rel=0.01)
    for box in (stock, stocks.from_box(*BLOCK, 2e-3)):  # points below this height are compared with the floor
        assert 0.0 < box.ground - float(box.floor.max()) < 1e-5


@pytest.mark.parametrize("reach", [0, 1, 3, 20])
def test_marks_near_a_point_are_those_up_to_some_points_to_either_side(reach):
    marks = np.random.default_rng(8).random((6, 14)) < 0.15
    marks[0] = False
    found = cutting._has_no_mark_near(marks, reach)
    for row in range(6):
        for k in range(14):
            assert found[row, k] == (not any(marks[row, max(k - reach, 0) : k + reach + 1]))


@pytest.mark.parametrize("kind", ["exchanged", "mirrored in x", "mirrored in y"])
def test_a_finer_map_is_the_same_whichever_way_its_grooves_run(kind):
    """Two grooves of a ball along x, and the same along y, or seen in a mirror."""
    cutter = Cutter(3e-3, 3e-3, 2)
    size = np.array([0.02, 0.012])
    begin = np.array([[-0.005, 0.0043, -1e-3], [0.004, 0.0071, -1.5e-3]])
    end = begin + np.array([[0.03, 0.0, 0.0], [0.007, 0.0, 0.0]])

    def moved(points):
        if kind == "exchanged":
            return points[:, [1, 0, 2]]
        axis = 0 if kind.endswith("x") else 1
        mirrored = points.copy()
        mirrored[:, axis] = size[axis] - points[:, axis]
        return mirrored

    def fine(box, first, last):
        stock = stocks.from_box(np.array([0.0, 0.0, -0.01]), np.append(box, 0.0), 0.5e-3)
        for k in range(2):
            stocks.remove(stock, cutter, first[k : k + 1], last[k : k + 1])
        return stocks.refine(stock, 3)

    plain = fine(size, begin, end)
    other = fine(size[::-1] if kind == "exchanged" else size, moved(begin), moved(end))
    back = {"exchanged": other.high.T, "mirrored in x": other.high[:, ::-1], "mirrored in y": other.high[::-1]}[kind]
    # in a mirror cells that a groove ends in the middle of are rounded to the other side
    assert np.mean(np.abs(back - plain.high) > 2e-7) <= (0.0 if kind == "exchanged" else 0.006)
    assert np.ptp(plain.high) > 1e-3
