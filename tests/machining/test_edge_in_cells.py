"""Edge in material and its loads in single cells of the map, against numbers by hand and sums point by point."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from postproc.machining import cutting
from postproc.machining import stock as stocks
from postproc.machining.stock import Stock, surface_rises

CELL_SIZE = 1e-3
X, Y = 0.1, 0.2


def stock_of(high, low=0.0, share=0.0, floor=0.0, slope=(0.0, 0.0)):
    """Return a map whose values are numbers or lists (ny, nx), levels in mm."""
    shape = np.shape(high)
    levels = [np.broadcast_to(np.array(v, np.float32) / 1e3, shape).astype(np.float32) for v in (high, low, floor)]
    shares = np.broadcast_to(np.array(share, np.float32), shape).astype(np.float32)
    slopes = np.zeros((*shape, 2), np.int16)
    slopes[:] = np.round(np.array(slope) / 1e-4)
    return Stock(X, Y, CELL_SIZE, levels[0], levels[1], shares, slopes, levels[2], float(levels[2].max()) + 1e-6)


def points(*cells):
    """Return x and y (1, n) of points [m], in cells from the corner of the map."""
    x, y = np.array(cells, dtype=float).T
    return (X + CELL_SIZE * x[None]).astype(np.float32), (Y + CELL_SIZE * y[None]).astype(np.float32)


@pytest.mark.parametrize(
    ("point", "cells", "weights"),
    [
        ((1.75, 2.0), (6, 7, 11, 12), (0.375, 0.125, 0.375, 0.125)),
        ((0.6, 0.7), (0, 1, 5, 6), (0.72, 0.08, 0.18, 0.02)),
        ((3.25, 1.6), (7, 8, 12, 13), (0.25 * 0.9, 0.75 * 0.9, 0.25 * 0.1, 0.75 * 0.1)),
        ((-9.0, 1.6), (5, 6, 10, 11), (0.9, 0.0, 0.1, 0.0)),
        ((99.0, 1.6), (8, 9, 13, 14), (0.0009, 0.8991, 0.0001, 0.0999)),
        ((1.6, 99.0), (11, 12, 16, 17), (0.0009, 0.0001, 0.8991, 0.0999)),
    ],
)
def test_a_point_is_between_four_cells_of_the_map(point, cells, weights):
    """Four rows of five cells."""
    corners = cutting.nearby_cells(stock_of(np.ones((4, 5))), *points(point))
    assert tuple(int(cell[0, 0]) for cell in corners.cell) == cells
    np.testing.assert_allclose([float(weight[0, 0]) for weight in corners.weight], weights, atol=2e-5)


@pytest.mark.parametrize(
    ("point", "cell"),
    [((0.1, 0.1), 0), ((4.9, 0.1), 4), ((1.6, 2.9), 11), ((9.0, 2.5), 14), ((-3.0, 2.5), 10), ((2.5, 9.0), 17)],
)
def test_a_point_is_in_one_cell_of_the_map(point, cell):
    assert cutting._containing_cells(stock_of(np.ones((4, 5))), *points(point)).tolist() == [[cell]]


@pytest.mark.parametrize(("row", "expected"), [(0, False), (1, True), (2, True), (3, False)])
def test_partly_cut_cells_count_in_the_rows_around_a_point(row, expected):
    share = np.zeros((4, 5))
    share[row, 4] = 0.5
    stock = stock_of(np.ones((4, 5)), share=share)
    assert cutting._has_partly_cut_cells(stock, cutting.nearby_cells(stock, *points((1.75, 2.0)))) is expected


FOUR = [[4.0, 4.0], [4.0, 4.0]]
SLOPES = {"left": [[[0.2, 0.1], [0, 0]], [[0, 0], [0, 0]]], "right": [[[0, 0], [0.2, 0.1]], [[0, 0], [0, 0]]],
          "upper": [[[0, 0], [0, 0]], [[0, 0], [0.2, 0.1]]],
          "ridge": [[[0.2, 0], [-0.2, 0]], [[0.2, 0], [-0.2, 0]]]}  # fmt: skip


@pytest.mark.parametrize(
    ("values", "z", "height"),
    [
        ({"high": FOUR}, 3.0, 1.0),
        ({"high": [[4, 8], [4, 8]]}, 2.0, 0.75 * 2 + 0.25 * 6),
        ({"high": [[4, 4], [8, 8]]}, 2.0, 0.5 * 2 + 0.5 * 6),
        ({"high": [[4, 1], [4, 1]]}, 3.0, 0.75),  # a wall: lower cells have no material at this height
        ({"high": [[2, 6], [2, 6]], "slope": (1.0, 0.0)}, 4.0, 0.25 * 1.25),  # planes at 2.25 and 5.25
        ({"high": FOUR, "low": 3.5, "share": [[0.4, 0], [0, 0]]}, 3.0, 0.375 * 0.8 + 0.625),
        ({"high": FOUR, "low": 1.0, "share": [[0.4, 0], [0, 0]]}, 3.0, 0.375 * 0.6 + 0.625),
        ({"high": FOUR, "low": 9.0, "share": [[0.4, 0], [0, 0]]}, 3.0, 1.0),
        ({"high": FOUR, "floor": [[0, 0], [0, 3.4]]}, 3.0, 0.875 + 0.125 * 0.6),
        ({"high": FOUR, "slope": SLOPES["left"]}, 3.0, 1 + 0.5 * 0.375 * (0.05 + 0.05)),
        ({"high": FOUR, "slope": SLOPES["right"]}, 3.0, 1 + 0.5 * 0.125 * (-0.15 + 0.05)),
        ({"high": FOUR, "slope": SLOPES["upper"]}, 3.0, 1 + 0.5 * 0.125 * (-0.15 - 0.05)),
        ({"high": FOUR, "slope": SLOPES["ridge"]}, 3.0, 1.05),
        ({"high": FOUR, "low": 3.5, "share": [[1, 0], [0, 0]], "slope": SLOPES["left"]}, 3.0,
         0.375 * 0.5 + 0.625 * (1 - 0.5 * 0.375 * 0.1)),  # the slope is of the upper level
    ],
)  # fmt: skip
def test_the_height_of_a_piece_below_the_surface_between_four_cells(values, z, height):
    """The point is a quarter of a cell to the right of the left cells, and half way up: weights 3, 1, 3, 1 of 8."""
    turn = SimpleNamespace(
        low=np.zeros(1, np.float32), rise=np.ones(1, np.float32), length=np.ones(1, np.float32), round=slice(0, 1)
    )
    stock = stock_of(**values)
    corners = cutting.nearby_cells(stock, *points((0.75, 1.0)))
    lengths = cutting._round_lengths(stock, turn, corners, np.full((1, 1), z * 1e-3, np.float32), True)
    assert float(lengths[0, 0]) == pytest.approx(height * 1e-3, abs=2e-8)


def test_a_paraboloid_between_cells_is_exact():
    def surface(x, y):
        return 0.3 * x**2 - 0.2 * y**2 + 0.1 * x * 2 + 0.5 * y + 1.0

    x, y = 0.3, 0.8
    cells = [(0, 0), (1, 0), (0, 1), (1, 1)]
    levels = [np.array([surface(a, b)], np.float32) for a, b in cells]
    planes = [np.array([(0.6 * a + 0.2) * (x - a) + (-0.4 * b + 0.5) * (y - b)], np.float32) for a, b in cells]
    weights = [np.array([(x if a else 1 - x) * (y if b else 1 - y)], np.float32) for a, b in cells]
    rises = surface_rises(levels, weights, planes)
    level = sum(w * (h + rise) for w, h, rise in zip(weights, levels, rises, strict=True))
    assert float(level[0]) == pytest.approx(surface(x, y), abs=1e-6)


@pytest.mark.parametrize(
    ("z", "floor", "length"),
    [(3.0, 0.0, 0.6), (3.6, 0.0, 0.24), (3.9, 0.0, 0.0), (3.6, 3.9, 0.12), (3.6, 3.7, 0.24), (3.0, 3.4, 0.36)],
)
def test_the_edge_of_a_round_is_in_material_between_surface_and_floor(z, floor, length):
    """The piece is 0.2 to 0.7 mm above the tip and 0.6 mm long; the surface is at 4 mm."""
    turn = SimpleNamespace(
        low=np.array([2e-4], np.float32), rise=np.array([5e-4], np.float32), length=np.array([6e-4], np.float32),
        round=slice(0, 1),
    )  # fmt: skip
    stock = stock_of(FOUR, floor=floor)
    corners = cutting.nearby_cells(stock, *points((0.75, 1.0)))
    lengths = cutting._round_lengths(stock, turn, corners, np.full((1, 1), z * 1e-3, np.float32), False)
    assert float(lengths[0, 0]) == pytest.approx(length * 1e-3, abs=2e-9 + 1e-3 * 2e-6)


@pytest.mark.parametrize(
    ("z", "descent", "length"), [(3.8, 0.5, 0.4), (3.2, 0.5, 1.0), (4.1, 0.5, 0.0), (3.9, 0.0, 1.0), (3.8, 0.4, 0.5)]
)
@pytest.mark.parametrize("share", [0.0, 0.25])
def test_the_end_face_cuts_the_descent_of_a_turn(z, descent, length, share):
    """A share of one cell (3 of 8) that is cut to the floor has no edge."""
    turn = SimpleNamespace(bottom=slice(0, 1), round=slice(1, 1), side=slice(1, 1), length=np.array([1e-3], np.float32))
    stock = stock_of(FOUR, share=[[share, 0], [0, 0]])
    position = np.array([[0, 0, z * 1e-3]], np.float32)
    edge = cutting.cut_edge(stock, turn, *points((0.75, 1.0)), position, np.array([descent * 1e-3], np.float32))
    assert float(edge.length[0, 0]) == pytest.approx(length * 1e-3 * (1 - 0.375 * share), rel=2e-3, abs=1e-9)
    assert edge.moment.shape == (1, 0)


def contact(stock, distances, low=0.0, width=2.5):
    """Return height and moment of points on a cylinder of 5 mm in row 1, whose cells have distances in cells."""
    turn = SimpleNamespace(
        low=np.array([low * 1e-3], np.float32), radius=np.array([5e-3], np.float32),
        width=np.array([width * CELL_SIZE / 5e-3]), side=slice(0, len(distances)),
    )  # fmt: skip
    columns = stock.high.shape[1]
    nearest = np.array([[columns + k for k in range(len(distances))]], np.int32)
    position = np.array([[X + CELL_SIZE * (0.5 - distances[0]), Y + CELL_SIZE * 1.5, 1e-3]], np.float32)
    height, moment = cutting._cylinder_contact(stock, nearest, position, turn)
    return height[0] * 1e3, moment[0] * 1e6


@pytest.mark.parametrize(
    ("high", "floor", "low", "bottom", "top"),
    [(4, 0, 0.0, 0, 3), (4, 2, 0.0, 1, 3), (4, 0, 0.5, 0.5, 3), (4, 2, 0.5, 1, 3), (0.5, 0, 0.0, 0, 0),
     (2, 3, 0.0, 2, 2)],
)  # fmt: skip
def test_a_cylinder_is_in_material_from_the_floor_or_its_lower_end_to_the_surface(high, floor, low, bottom, top):
    """The tip is at 1 mm."""
    height, moment = contact(stock_of(np.full((3, 1), float(high)), floor=float(floor)), [5.2], low)
    np.testing.assert_allclose([height[0], moment[0]], [top - bottom, 0.5 * (top**2 - bottom**2)], atol=2e-6)


@pytest.mark.parametrize(
    ("distance", "share", "low", "top"),
    [
        (5.2, 0.4, 2, 1.0),  # the rim covers 0.3 of the cell, 0.4 of it are cut: air but below the lower level
        (5.2, 0.295, 2, 1.0),  # equal but for rounding
        (5.2, 0.2, 2, 3.0),  # it covers more than is cut
        (5.2, 0.4, 0.5, 0.0), (5.2, 0.4, 9, 3.0),
    ],
)  # fmt: skip
def test_a_cylinder_in_a_partly_cut_cell_meets_the_level_of_its_side(distance, share, low, top):
    height, moment = contact(stock_of(np.full((3, 1), 4.0), low=low, share=share), [distance])
    np.testing.assert_allclose([height[0], moment[0]], [top, 0.5 * top**2], atol=2e-5)


@pytest.mark.parametrize("seed", range(6))
def test_chips_are_the_mean_of_the_part_of_a_piece_that_moves_into_the_material(seed):
    """On rounds the thickness is linear along the piece, elsewhere constant."""
    rng = np.random.default_rng(seed)
    turn = SimpleNamespace(round=slice(1, 3))
    middle, change = rng.uniform(-1, 1, (4, 4)).astype(np.float32), rng.uniform(-1, 1, (4, 2)).astype(np.float32)
    chip = cutting.Chips.of(turn, middle.copy(), change)
    along = (np.arange(20_000) + 0.5) / 10_000 - 1.0
    for n, p in np.ndindex(4, 4):
        thickness = middle[n, p] + (change[n, p - 1] if p in (1, 2) else 0.0) * along
        cuts = thickness > 0.0
        assert float(chip.share[n, p]) == pytest.approx(cuts.mean(), abs=2e-4)
        assert float(chip.thickness[n, p]) == pytest.approx(thickness[cuts].mean() if cuts.any() else 0.0, abs=2e-4)


def test_the_chip_is_the_travel_along_the_normal():
    turn = SimpleNamespace(
        round=slice(1, 2), normal_x=np.array([0.6, 0.8], np.float32), normal_down=np.array([0.8, 0.6], np.float32),
        tangent=np.array([[0, 0, 0], [0.1, 7.0, 0.2]], np.float32),
    )  # fmt: skip
    chip = cutting.chips(turn, np.array([2.0], np.float32), np.array([1.0], np.float32))
    np.testing.assert_allclose(chip.thickness, [[2.0, 2.2]], rtol=1e-6)
    steep = cutting.chips(turn, np.array([2.0], np.float32), np.array([-2.5], np.float32))
    # 1.6 - 1.5 = 0.1 in the middle and 0.1·2 + 0.2·2.5 = 0.7 more at an end: 4/7 of the piece, 0.4 on average
    np.testing.assert_allclose([steep.share[0, 1], steep.thickness[0, 1]], [4 / 7, 0.4], rtol=1e-5)
    assert steep.share[0, 0] == steep.thickness[0, 0] == 0.0


@pytest.mark.parametrize("drill", [False, True])
@pytest.mark.parametrize("covariance", [None, np.diag([4.0, 0.0, 1.0, 9.0, 0.0, 0.25]) + 0.1])
@pytest.mark.parametrize("cell", [1e-4, 10.0])
def test_loads_are_sums_over_the_points_of_a_turn(drill, covariance, cell):
    """The four points are on the end face, the round and the cylinder; chips count by their square root."""
    rng = np.random.default_rng(4)
    law = SimpleNamespace(chip_factor=np.sqrt, covariance=covariance)
    turn = SimpleNamespace(
        law=law, drill=drill, sampling=1.5, least_cosine=0.2,
        radius=np.array([1, 2, 3, 3], np.float32), width=np.array([0.1, 0.2, 0.3, 0.4]),
        normal_x=np.array([0.1, 0.4, 0.9, 0.5], np.float32), bottom=slice(0, 1), round=slice(1, 2), side=slice(2, 4),
        cut_wrench=rng.normal(size=(4, 6)).astype(np.float32), rub_wrench=rng.normal(size=(4, 6)).astype(np.float32),
        unit_wrench=rng.normal(size=(3, 4, 6)).astype(np.float32),
    )  # fmt: skip
    length, moment = rng.uniform(0.1, 1, (3, 4)).astype(np.float32), rng.uniform(0.1, 1, (3, 2)).astype(np.float32)
    thickness = rng.uniform(0.1, 1, (3, 4)).astype(np.float32)
    thickness[1, 3] = 0.0
    share = np.where(thickness > 0, 0.7, 0.0).astype(np.float32)
    sine = np.array([0.0, 0.4, 1.0])
    cosine = np.array([0.9, 0.55, 0.1, 0.3], np.float32)
    loads = cutting.mean_loads(
        turn, cutting.EngagedEdge(length.copy(), moment), cutting.Chips(thickness, share), sine, cell, cosine
    )

    def total(n, cut, rub):
        """Return the wrench of a station by coefficients per point, (4, 6) each."""
        wrench = np.zeros(6)
        for p in range(4):
            edge = length[n, p] * share[n, p]
            wrench += edge * np.sqrt(thickness[n, p]) * cut[p] + edge * (sine[n] if p == 0 else 1.0) * rub[p]
            if p >= 2:
                f = moment[n, p - 2] * (np.sqrt(thickness[n, p]) * cut[p] + (thickness[n, p] > 0) * rub[p])
                wrench[3:5] += (-f[1], f[0])
        return wrench

    for n in range(3):
        arc = turn.radius * turn.width
        wrench, edge = total(n, turn.cut_wrench, turn.rub_wrench), length[n] * share[n]
        np.testing.assert_allclose(loads.wrench[n], wrench, rtol=2e-5, atol=1e-6)
        assert loads.removal[n] == pytest.approx(float(edge @ (thickness[n] * arc)), rel=1e-5)
        level = 0.0 if drill else 0.2 * 1.5 * cell / np.sqrt(float(edge @ arc))
        steepness = float(edge @ (arc * np.array([0.9, 0.55, 0.2, 0.3]) ** -1.5)) / float(edge @ arc)
        by_cells = min(1.0, level * np.sqrt(steepness))
        gentle = float(edge[:2] @ arc[:2]) / float(edge @ arc)
        assert loads.gentle_error_share[n] == pytest.approx(min(1.0, level * np.sqrt(gentle)), rel=1e-5)
        front = float(edge @ (arc * turn.normal_x))
        by_wall = 0.0 if drill else 0.05 * cell * edge[2:].max() / front
        assert loads.cell_error_share[n] == pytest.approx(min(1.0, np.hypot(by_cells, by_wall)), rel=1e-5)
        unknown = (1 - sine[n] if sine[n] > 0 else 0.0) * edge[0] * turn.rub_wrench[0]
        square = unknown**2 / 3
        if drill:
            square[2] += (0.5 / 1.3 * wrench[2]) ** 2 / 3
        if covariance is not None:
            none = np.zeros((4, 6))
            units = [total(n, unit, none) for unit in turn.unit_wrench]
            units += [total(n, none, unit) for unit in turn.unit_wrench]
            square += np.einsum("ki,kl,li->i", np.array(units), covariance, np.array(units))
        by_map = min(1.0, np.hypot(by_cells, by_wall))
        square[:3] += by_map**2 * (wrench[:3] @ wrench[:3]) / 3
        square[3:] += by_map**2 * (wrench[3:] @ wrench[3:]) / 3
        np.testing.assert_allclose(loads.deviation[n], np.sqrt(square), rtol=5e-5)


def test_a_mesh_gives_the_slopes_of_planes_and_none_in_cells_with_a_step():
    """A prism whose top rises by 0.5 per x and has a step of 2 mm in the middle of a cell."""
    profile = [(0.0, 0.0), (10.0, 5.0), (10.0, 7.0), (20.0, 12.0), (20.0, -5.0), (0.0, -5.0)]
    stock = stocks.from_mesh(*prism(profile, 10.0), 4e-3)
    slopes = stock.slope[2:-2, 2:-2, 0] * stocks.SLOPE  # without the border; cells begin at 0, 4, 8, 12, 16 mm
    np.testing.assert_allclose(slopes[0], [0.5, 0.5, 0.0, 0.5, 0.5], atol=1e-4)
    assert not stock.slope[..., 1].any()


def prism(profile, width):
    """Return vertices [m] and faces of a prism along y, from a closed profile of points x, z [mm]."""
    points = np.array(profile)
    count = len(points)
    ends = [np.column_stack([points[:, 0], np.full(count, y), points[:, 1]]) for y in (0.0, width)]
    sides = [(k, (k + 1) % count) for k in range(count)]
    faces = [face for a, b in sides for face in ((a, b, b + count), (a, b + count, a + count))]
    return np.concatenate(ends) * 1e-3, np.array(faces)
