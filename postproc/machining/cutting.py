"""Engagement of the edge in the stock, and the mean cutting forces over a turn that follow from it.

Axes: x along the feed, z along the spindle from the tip to the spindle, y = z × x; φ from +y, growing clockwise seen
from the spindle, so that with M3 a tooth enters a slot at φ = 0 on the left. Forces act on the tool. With M4 everything
is mirrored in y.

A piece of edge with its normal n = (sin κ sin φ, sin κ cos φ, −cos κ), length b and chip thickness h = c·n, c being the
feed per tooth, has (Altintas and Lee, "Mechanics and dynamics of ball end milling", J. Manuf. Sci. Eng. 120, 1998;
Engin and Altintas, Int. J. Mach. Tools Manuf. 41, 2001)

    tangential  (Ktc h + Kte) b   along (−cos φ, sin φ, 0)
    radial      (Krc h + Kre) b   along −n
    axial       (Kac h + Kae) b   along (cos κ sin φ, cos κ cos φ, sin κ)

The mean over a turn is N/2π ∫ dφ of this over the edge in material; on a cylinder (κ = 90°) that is the average force
of end milling in Altintas, "Manufacturing Automation", 2nd ed., 2012, Eq. (2.31). The end face (κ = 0) cuts where the
feed goes down: on a plunge this is the force of drilling and plunge milling, torque N R² (Ktc c + Kte)/2 and thrust
N R (Krc c + Kre) (Altintas and Ko, CIRP Annals 55, 2006).

The radial coefficients of milling do not give the thrust of a drill, whose chisel edge in the middle presses rather
than cuts. It makes 50 to 60 % of the thrust (Modern Machining Technology, Woodhead 2011, ch. 2) or 50 to 70 %
(Mitsubishi Materials, general drilling knowledge), less where the point is thinned. The feed force is taken in
proportion to that of tool makers, 0.5 kc fn D/2 (Sandvik Coromant, drilling formulas). With the kc of the torque,
kc = 8 M/(fn D²), published thrusts are this many times that formula:

    0.83          Mitsubishi Materials, "Drilling forces": 10 mm, 0.3 mm/rev, 15 N·m, 2500 N
    0.86 to 0.94  Sandvik Coromant: sin κ of the point angle
    1.1           Machinery's Handbook, 31st ed., pp. 1152 and 1153, T and M of a split point (c/d = 0.03)
    1.4 to 1.5    the same, standard point with its chisel edge (c/d = 0.18), 3 to 16 mm
    1.8           Tungaloy general catalogue 2020-2021, p. L068, T = 570 K D f^0.85, M = K D² (0.63 + 16.84 f)/100

The force is 1.3 times the formula, so for drills Krc = 0.65 Ktc and Kre = 0.65 Kte; the deviation takes anything
from 0.8 to 1.8 times it for as likely.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.frames import Array, norm
from postproc.machining.material import Floats
from postproc.machining.stock import SLOPE, Stock, surface_rises
from postproc.machining.tool import Turn
from postproc.program import Bools

_NO_CONTACT = 1e-6
"""Engaged edge lengths below this [m] are rounding errors,"""
_NO_CHIP = 1e-12
"""and changes of the chip along a piece of edge below this [m] (assumed)."""
_ROUNDING = np.float32(0.01)
"""Shares of a cell that differ by less are equal: coordinates have seven digits."""
_WALL_CELLS = 2.0
"""Number of cells to both sides over which an edge must follow a wall (assumed). A wall that crosses the edge at 20° is
three quarters of a cell away there."""


class EngagedEdge(Struct, frozen=True, eq=False):
    """Engaged cutting edge at n stations (places of the tip), at the P points of a turn of the tool.

    :param length: (n, P) length of edge in material [m].
    :param moment: (n, C) ∫ z dz over the edge in material at the C points on the cylinder, z above the tip [m²].
    """

    length: Floats
    moment: Floats


class _CellLevels(NamedTuple):
    """Levels of the cells that contain points, (n, K) each.

    :param high: upper levels [m].
    :param low: lower levels [m].
    :param share: share of the area of each cell that is at its lower level, 0 … 1.
    :param floor: lower side of the material [m].
    """

    high: Floats
    low: Floats
    share: Floats
    floor: Floats


class Corners(Struct, frozen=True, eq=False):
    """The four cells around each point: their indices in the flat map, and their weights of interpolation."""

    cell: tuple[NDArray[np.int32], ...]
    weight: tuple[Floats, ...]


def cut_edge(stock: Stock, turn: Turn, x: Floats, y: Floats, position: Floats, layer: Floats) -> EngagedEdge:
    """Return the cutting edge in material of a tool along z of the height map, at n stations.

    :param turn: P sample points of the edge within a turn: first on the end face, then on the round, then on the
        cylinder.
    :param x: (n, P) and `y` (n, P): coordinates of these points in the map [m].
    :param position: (n, 3) positions of the tip [m].
    :param layer: (n,) thickness of the layer above the tip that the end face cuts [m], the descent from one tooth to
        the next. Material that is thinner counts for its share: teeth pass at any height within the layer.
    """
    length = np.zeros(x.shape, dtype=np.float32)
    tip = position[:, 2]
    z = tip[:, None]
    end_count = turn.side.start  # points on the end face and the round come before those on the cylinder
    if end_count > 0:
        corners = nearby_cells(stock, x[:, :end_count], y[:, :end_count])
        has_partly_cut = _has_partly_cut_cells(stock, corners)
        if turn.round.start < end_count:
            length[:, turn.round] = _round_lengths(stock, turn, corners, z, has_partly_cut)
        if turn.bottom.start < turn.bottom.stop:
            depth = np.maximum(layer, np.float32(1e-7))[:, None]  # no division by zero on level paths
            bottom_height = _interpolated_difference(
                stock, corners, turn.bottom, lambda level: np.minimum(np.maximum(level - z, 0.0), depth), has_partly_cut
            )
            length[:, turn.bottom] = bottom_height / depth * turn.length[turn.bottom]
    moment = np.zeros((len(x), 0), dtype=np.float32)
    if turn.side.start < turn.side.stop:
        nearest_cells = _containing_cells(stock, x[:, turn.side], y[:, turn.side])
        length[:, turn.side], moment = _cylinder_contact(stock, nearest_cells, position, turn)
    length[length < _NO_CONTACT] = 0.0
    return EngagedEdge(length, moment)


def _round_lengths(stock: Stock, turn: Turn, corners: Corners, z: Floats, has_partly_cut: bool) -> Floats:
    """Return the lengths of edge in material (n, R) [m] at the R sample points on the round of a tool.

    The part of the height of each piece that is below the surface of the stock is converted to a length along the edge.
    It is computed for the surface of each of four cells, and then interpolated: where a wall is between the cells,
    those beyond it count for their share of the distance, so that the wall is on average where it is. Levels that are
    interpolated first would move it towards the lower cells.

    :param turn: its `low` are the heights of the lower ends of pieces above the tip, its `rise` the heights of pieces.
    :param corners: cells around the points on the end face, and around the R points on the round.
    :param z: (n, 1) height of the tip [m].
    :param has_partly_cut: whether any of the cells is at two levels.
    """
    pieces = turn.round
    low, rise = turn.low[pieces], turn.rise[pieces]
    base = z + low

    def height_below(level: Floats, surface_rise: Floats | None) -> Floats:
        """Return the height of each piece (n, R) [m] below a level; `surface_rise` is added to it, None: 0."""
        surface = level if surface_rise is None else level + surface_rise
        return np.minimum(np.maximum(surface - base, 0.0), rise)

    high, lower, share, floor = (values.reshape(-1) for values in (stock.high, stock.low, stock.share, stock.floor))
    cells = [cell[:, pieces] for cell in corners.cell]
    weights = [weight[:, pieces] for weight in corners.weight]
    levels = [high.take(cell) for cell in cells]
    plane_rises = _plane_rises(stock, corners, pieces)
    rises: list[Floats] | list[None] = surface_rises(levels, weights, plane_rises) if plane_rises else [None] * 4
    is_near_floor = float(z.min()) < stock.ground  # the highest lower side of the material, of all cells
    height = np.zeros(base.shape, dtype=np.float32)
    for cell, weight, level, surface_rise in zip(cells, weights, levels, rises, strict=True):
        cell_height = height_below(level, surface_rise)
        if has_partly_cut:
            cut_share = share.take(cell)
            if cut_share.any():
                lower_height = height_below(np.minimum(lower.take(cell), level), None)
                cell_height += cut_share * (lower_height - cell_height)
        if is_near_floor:
            # the part of a piece below the lower side of the material is in air
            cell_height = np.maximum(cell_height - height_below(floor.take(cell), None), 0.0)
        cell_height *= weight
        height += cell_height
    return np.asarray(height * (turn.length[pieces] / rise))


def nearby_cells(stock: Stock, x: Floats, y: Floats) -> Corners:
    """Return the four cells around points, and their weights of bilinear interpolation.

    Cells are in the order lower left, lower right, upper left, upper right (x to the right, y up). Points off the map
    get the cells at its edge.

    :param x: (n, P) and `y` (n, P): coordinates in the frame of the height map [m].
    """
    rows, columns = stock.high.shape
    scale = np.float32(1.0 / stock.cell)
    # distances from the middle of the first cell, in cells; below, the part beyond the middle of the lower left cell
    x_share = (x - np.float32(stock.x)) * scale - np.float32(0.5)
    y_share = (y - np.float32(stock.y)) * scale - np.float32(0.5)
    # a little less than the last cell, so that the cell after it exists
    np.clip(x_share, 0.0, np.float32(columns - 1.001), out=x_share)
    np.clip(y_share, 0.0, np.float32(rows - 1.001), out=y_share)
    column, row = x_share.astype(np.int32), y_share.astype(np.int32)
    x_share -= column
    y_share -= row
    lower_left = row * np.int32(columns) + column
    product = x_share * y_share
    return Corners(
        (lower_left, lower_left + 1, lower_left + columns, lower_left + (columns + 1)),
        (1 - x_share - y_share + product, x_share - product, y_share - product, product),
    )


def _containing_cells(stock: Stock, x: Floats, y: Floats) -> NDArray[np.int32]:
    """Return the index (n, P) in the flat map of the cell that contains each point; `x` and `y` (n, P) [m].

    Points off the height map get the cell at its edge.
    """
    rows, columns = stock.high.shape
    scale = np.float32(1.0 / stock.cell)
    column = ((x - np.float32(stock.x)) * scale).astype(np.int32)
    row = ((y - np.float32(stock.y)) * scale).astype(np.int32)
    np.clip(column, 0, columns - 1, out=column)
    np.clip(row, 0, rows - 1, out=row)
    row *= np.int32(columns)
    row += column
    return row


def _has_partly_cut_cells(stock: Stock, corners: Corners) -> bool:
    """Return whether any row of the height map that contains one of these cells has a partly cut cell."""
    lower_left = corners.cell[0]
    columns = stock.high.shape[1]
    # a flat index divided by the number of columns is a row; the upper cells are one row further
    rows = slice(int(lower_left.min()) // columns, int(lower_left.max()) // columns + 2)
    return bool(stock.share[rows].any())


def _interpolated_difference(
    stock: Stock, corners: Corners, pieces: slice, function: Callable[[Floats], Floats], has_partly_cut: bool
) -> Floats:
    """Return function(surface) − function(lower side) of the stock, interpolated between four cells (n, k), at least 0.

    :param corners: cells around the points; `pieces` selects k of the points.
    :param function: a function of heights (n, k) [m] that is constant or rises with the height.
    :param has_partly_cut: whether any of the cells has two levels: each then counts by its share of the area.
    """
    high, low, share, floor = (values.reshape(-1) for values in (stock.high, stock.low, stock.share, stock.floor))
    result = None
    for cell, weight in zip(corners.cell, corners.weight, strict=True):
        cell_index = cell[:, pieces]
        upper = high.take(cell_index)
        difference = function(upper)
        if has_partly_cut:
            cut_share = share.take(cell_index)
            if cut_share.any():
                difference += cut_share * (function(np.minimum(low.take(cell_index), upper)) - difference)
        difference = difference - function(floor.take(cell_index))
        np.maximum(difference, 0.0, out=difference)
        difference *= weight[:, pieces]
        result = difference if result is None else result + difference
    return np.asarray(result)


def _cylinder_contact(stock: Stock, nearest: NDArray[np.int32], position: Floats, turn: Turn) -> tuple[Floats, Floats]:
    """Return the engaged height of the cylinder (n, K) [m], and its first moment ∫ z dz above the tip (n, K) [m²].

    The cylinder has no upper end. Both levels of the cell that contains the point count by their shares of its area: a
    second pass along the same wall is then in air. An edge inside an earlier cut, as at the end of each layer of a
    slot, meets the lower level only: the material behind the wall does not count. For an edge outside of an earlier
    cut, the upper level counts in full.

    :param nearest: (n, K) index in the flat map of the cell that contains each point on the cylinder.
    :param position: (n, 3) of the tip [m].
    """
    levels = _CellLevels(
        *(values.reshape(-1).take(nearest) for values in (stock.high, stock.low, stock.share, stock.floor))
    )
    share, tip = levels.share, position[:, 2:]
    # all points on the cylinder have the same lower end
    bottom = np.maximum(levels.floor - tip, turn.low[turn.side.start])
    top = np.maximum(levels.high - tip, bottom)
    # twice the moment: the integral of z dz is half the difference of squares
    height, moment = top - bottom, top * top - bottom * bottom
    if share.any():
        is_inside, is_outside = _sides_of_earlier_cut(stock, nearest, position, turn, levels)
        share = np.where((share > 0.0) & is_inside, np.float32(1.0), share * ~is_outside)
        lower_top = np.maximum(np.minimum(levels.low - tip, top), bottom)
        height += share * (lower_top - top)
        moment += share * (lower_top * lower_top - top * top)
    return height, np.float32(0.5) * moment


def _sides_of_earlier_cut(
    stock: Stock, nearest: NDArray[np.int32], position: Floats, turn: Turn, levels: _CellLevels
) -> tuple[Bools, Bools]:
    """Return at which points (n, K) the cylinder is inside of an earlier cut, and at which (n, K) it is outside.

    It is inside where it covers no more of a cell than was cut of it, else outside: cut areas of one cell are assumed
    nested. A point is inside only if no point within `_WALL_CELLS` cells along the rim is outside, and the other way
    round. Near a crossing of wall and edge both are False: there the share of the cell that is cut is right on average.

    :param nearest: (n, K) index in the flat map of the cell that contains each point on the cylinder.
    :param position: (n, 3) of the tip [m].
    :param levels: levels of these cells.
    """
    high, low, share, _ = levels
    radius, cell = turn.radius[turn.side.start], np.float32(stock.cell)
    row, column = np.divmod(nearest, np.int32(stock.high.shape[1]))
    x = (column + np.float32(0.5)) * cell + (np.float32(stock.x) - position[:, :1])
    y = (row + np.float32(0.5)) * cell + (np.float32(stock.y) - position[:, 1:2])
    # share of a cell that a straight rim at this distance from its middle covers
    coverage = (radius - np.hypot(x, y)) / cell + np.float32(0.5)
    # a cell without a share is cut as a whole if it is below the mean of the two levels of partly cut cells
    is_partly_cut = share > 0.0
    mid_level = np.float32(0.5) * (high + np.minimum(low, high)) * is_partly_cut
    mean_mid_level = mid_level.sum(axis=1, keepdims=True) / np.maximum(is_partly_cut.sum(axis=1, keepdims=True), 1)
    is_cut = ~is_partly_cut & (high <= mean_mid_level)
    is_outside = (coverage > share + _ROUNDING) & (coverage < 1.0) & ~is_cut
    is_inside = is_partly_cut & (coverage <= share + _ROUNDING) & (coverage > 0.0) | is_cut
    # number of sample points in `_WALL_CELLS` cells along the rim
    reach = int(np.ceil(_WALL_CELLS * stock.cell / (float(turn.width[turn.side.start]) * float(radius))))
    # a point is inside without an outside mark nearby, and outside without an inside mark nearby
    return _has_no_mark_near(is_outside, reach), _has_no_mark_near(is_inside, reach)


def _has_no_mark_near(marks: Bools, reach: int) -> Bools:
    """Return True for points (n, K) without a mark at themselves or up to `reach` points to either side.

    :param marks: (n, K), with the K points in order along the rim.
    """
    # a difference of running counts is the number of marks from `first` to `end` (exclusive)
    count = np.zeros((len(marks), marks.shape[1] + 1), dtype=np.int32)
    np.cumsum(marks, axis=1, out=count[:, 1:])
    points = np.arange(marks.shape[1])
    end, first = np.minimum(points + reach + 1, len(points)), np.maximum(points - reach, 0)
    return np.asarray(count[:, end] == count[:, first])


def _plane_rises(stock: Stock, corners: Corners, pieces: slice) -> list[Floats]:
    """Return the rise of the tangent plane from the middle of each of four cells to a point between them [m].

    :param corners: cells around the points; `pieces` selects k of the points.
    :returns: four arrays (n, k); an empty list if all cells are level.
    """
    # one int32 holds both slopes of a cell (int16), so that one look-up gets both
    slope_pairs = stock.slope.reshape(-1, 2).view(np.int32)[:, 0]
    # the weights of the two right cells add up to the place of the point between left and right, those of the two upper
    # cells to its place between lower and upper
    x_share, y_share = (
        (corners.weight[1] + corners.weight[3])[:, pieces],
        (corners.weight[2] + corners.weight[3])[:, pieces],
    )
    corner_pairs = [slope_pairs.take(cell[:, pieces]) for cell in corners.cell]
    if not any(pair.any() for pair in corner_pairs):
        return []
    rise_unit = np.float32(SLOPE * stock.cell)
    rises = []
    # cell k is the right one of two in x if bit 0 of k is set, the upper one in y if bit 1 is
    for k, pair in enumerate(corner_pairs):
        slope = pair[..., None].view(np.int16)
        rises.append(rise_unit * (slope[..., 0] * (x_share - (k & 1)) + slope[..., 1] * (y_share - (k >> 1))))
    return rises


_LEVEL_SINE = 1e-3
"""Sine of the angle to the level below which a cut is level."""
_THRUST_SHARE = 0.5 / 1.3
"""Feed forces of drills differ from the computed one by this share at most, either way: by chisel edge and thinning."""
CELL_ERROR_SHARE = 0.2
"""Standard deviation of a force by the cells of the map, as a share of it, times √n: n is the area of the front of the
tool in material in cells. The RMS error of balls against exact fronts is 0.06 to 0.12 of 1/√n, for n from 4 to 590,
cells of 0.15 to 0.4 mm, depths of 0.1 to 1 mm; some surfaces have more (`python -m tests.benchmarks.fronts`)."""
WALL_ERROR = 0.05
"""Standard deviation of the place of a wall in the map, in cells: that of finishing passes of flat tools 0.05 to 0.2 mm
wide and 1.5 to 24 mm deep against closed forms, with cells of 0.25 mm, is 0.026 to 0.054."""
_STEEPNESS_POWER = -1.5
"""The variance of a force by the cells of the map grows with this power of the cosine of the slope: on a steep wall few
cells are under the contact, and each of them covers a large part of it. With cells of 0.25 mm, balls R3 that finish
walls 0.3 mm deep are off by 0.3 to 0.9 of the deviation that follows (45 to 84° from the top down, 45 to 80° from the
bottom up), and by 2 to 2.5 of it on steeper walls. With cells of 0.1 mm it is 0.3 to 1.5 of it, from 80 to 87°."""
_GENTLE_COSINE = 0.5
"""Cosine of the slope above which a surface is not steep (assumed)."""
_ONE_THREAD = 200_000
"""Number of products below which OpenBLAS uses one thread (its limit is 2^18)."""


class Loads(Struct, frozen=True, eq=False):
    """Sums over the edge in material in a turn, at n stations.

    :param wrench: (n, 6) mean force [N] and moment about the tip [N·m] on the tool, in the axes above.
    :param deviation: (n, 6) its standard deviation by the covariance of the material, by the unknown rubbing of the end
        face and thrust of the chisel edge of a drill, and by the cells of the height map.
    :param cell_error_share: (n,) standard deviation of the force by the cells of the map, as a share of the force; 0
        for drills, whose hole has no open side.
    :param gentle_error_share: (n,) the part of that by surfaces that are neither steep nor walls: finer cells can
        interpolate them.
    :param removal: (n,) volume removed in one turn by one tooth [m³].
    """

    wrench: Array
    deviation: Array
    cell_error_share: Array
    gentle_error_share: Array
    removal: Array


class Chips(Struct, frozen=True, eq=False):
    """Chips of the pieces of edge at n stations.

    :param thickness: (n, P) mean over the part of the piece that moves into the material [m].
    :param share: (n, P) of the piece that this part is, 0 … 1.
    """

    thickness: Floats
    share: Floats

    @classmethod
    def of(cls, turn: Turn, middle: Floats, change: Floats) -> Chips:
        """Return the chips of pieces of edge along which the thickness changes linearly.

        A piece whose thickness changes its sign cuts with a share of its length only. Without such shares, forces
        would jump with the slope of the path: the lowest ring of a ball cuts along half of its circle on a level path,
        and along all of it on a path that descends as steeply as the ring.

        :param middle: (n, P) thickness in the middle of pieces [m], < 0 where they move away from the material.
        :param change: (n, Q) thickness at an end of each of the Q pieces on the round, less that in its middle [m].
        """
        share = np.asarray(middle > 0.0, np.float32)
        thickness = np.maximum(middle, 0.0)
        change = np.maximum(np.abs(change), np.float32(_NO_CHIP))
        round_middle = middle[:, turn.round]
        # linear from middle − change to middle + change: the share with a positive thickness, and its mean there
        share[:, turn.round] = np.clip(0.5 + 0.5 * round_middle / change, 0.0, 1.0)
        thickness[:, turn.round] = np.maximum(thickness[:, turn.round], 0.5 * (round_middle + change))
        thickness *= share > 0.0
        return cls(thickness, share)


def chips(turn: Turn, feed: Floats, descent: Floats) -> Chips:
    """Return the chips of a tool at n stations (places of the tip).

    The thickness is the component of the travel along the normal of the edge.

    :param feed: (n,) travel along x from one tooth to the next [m], and `descent` (n,) travel down [m].
    """
    middle = feed[:, None] * turn.normal_x
    middle += descent[:, None] * turn.normal_down
    tangent = turn.tangent[turn.round]  # half the change of the normal along each piece; its z is up, the travel down
    return Chips.of(turn, middle, feed[:, None] * tangent[:, 0] - descent[:, None] * tangent[:, 2])


def mean_loads(
    turn: Turn, engagement: EngagedEdge, chip: Chips, descent_sine: Floats, cell: float | Array, cosine: Floats
) -> Loads:
    """Return the loads averaged over a turn, with their standard deviations.

    The rubbing of the end face counts by the sine of the descent: published coefficients of level cuts contain it, and
    on a plunge it acts in full. Between these, the share that rubs is unknown: uniform from that sine to 1.

    :param engagement: lengths of edge in material.
    :param chip: chips of the pieces of edge, from `chips`.
    :param descent_sine: (n,) sine of the angle by which the feed goes down, 0 … 1.
    :param cell: width of a cell of the height map [m]; or (n,) the width that a cell has on the surface of the tool.
    :param cosine: (P,) or (n, P) cosine of the slope of the surface in the map that the piece of edge cuts.
    """
    rubbed_length = engagement.length * chip.share
    rubbing = rubbed_length.copy()  # of the end face, less than its length
    cutting = rubbing * turn.law.chip_factor(chip.thickness)
    arc_length = (turn.radius * turn.width.astype(np.float32))[:, None]  # of each sample point of the turn [m]
    area = product_in_blocks(rubbing, arc_length)[:, 0].astype(float)
    removal = product_in_blocks(rubbing * chip.thickness, arc_length)[:, 0]
    uncertain_edge = np.where(descent_sine > _LEVEL_SINE, 1.0 - descent_sine, 0.0)[:, None] * rubbing[:, turn.bottom]
    rubbing[:, turn.bottom] *= descent_sine[:, None]
    wrench = (product_in_blocks(cutting, turn.cut_wrench) + product_in_blocks(rubbing, turn.rub_wrench)).astype(float)
    side_chip = chip.thickness[:, turn.side]
    force_moment = product_in_blocks(
        engagement.moment * turn.law.chip_factor(side_chip), turn.cut_wrench[turn.side, :2]
    )
    force_moment += product_in_blocks(engagement.moment * (side_chip > 0.0), turn.rub_wrench[turn.side, :2])
    _add_moment_of_height(wrench, force_moment)
    # uniform from none of it to all: the variance is a third of the square of half the range
    variance = np.square(product_in_blocks(uncertain_edge, turn.rub_wrench[turn.bottom]).astype(float)) / 3.0
    if turn.drill:
        variance[:, 2] += np.square(_THRUST_SHARE * wrench[:, 2]) / 3.0
    if turn.law.covariance is not None:
        unit_wrench = _unit_wrenches(turn, engagement, (cutting, rubbing), side_chip)
        variance += np.einsum("kni,kl,lni->ni", unit_wrench, np.array(turn.law.covariance), unit_wrench)
    # a drill has no open side: the cells of the map add no error to its forces
    steepness = np.maximum(cosine, np.float32(turn.least_cosine)) ** np.float32(_STEEPNESS_POWER)
    steep_area = product_in_blocks(rubbed_length * steepness, arc_length)[:, 0].astype(float)
    area = np.maximum(area, 1e-12)  # [m²]: no division by zero in air
    gentle_length = rubbed_length * np.asarray(cosine > _GENTLE_COSINE, dtype=np.float32)
    gentle_area = product_in_blocks(gentle_length, arc_length)[:, 0].astype(float)
    error_length = 0.0 if turn.drill else CELL_ERROR_SHARE * turn.sampling * cell  # its square is variance times area
    surface_error_share = error_length * np.sqrt(steep_area) / area
    cell_error_share = np.minimum(np.hypot(surface_error_share, _wall_error_share(turn, rubbed_length, cell)), 1.0)
    # the error may have any direction: each of three components has a third of the variance
    for components in (slice(0, 3), slice(3, 6)):
        variance[:, components] += (np.square(cell_error_share * norm(wrench[:, components])) / 3.0)[:, None]
    return Loads(
        wrench=wrench,
        deviation=np.sqrt(np.maximum(variance, 0.0)),
        cell_error_share=cell_error_share,
        gentle_error_share=np.minimum(error_length * np.sqrt(gentle_area) / area, 1.0),
        removal=np.asarray(removal, dtype=float),
    )


def _wall_error_share(turn: Turn, length: Floats, cell: float | Array) -> Array:
    """Return the standard deviation of forces (n,) by the place of the wall that the cylinder cuts, as a share of them.

    A wall is one row of columns of the map whatever its height, so that the error does not fall with the depth of cut:
    a thin layer is `WALL_ERROR` cells thicker or thinner. It is compared with the width of the whole cut.

    :param length: (n, P) length of edge that cuts [m]; on the cylinder that is the depth.
    :param cell: width of a cell of the height map [m]; or (n,) the width that a cell has on the surface of the tool.
    """
    if turn.drill:
        return np.zeros(len(length))
    arc_length = turn.radius * turn.width.astype(np.float32)
    # area of the cut seen along the feed: a layer of this width times depth is removed
    front_area = product_in_blocks(length, (arc_length * turn.normal_x)[:, None])[:, 0].astype(float)
    wall_height = length[:, turn.side].max(axis=1, initial=0.0).astype(float)
    return np.asarray(WALL_ERROR * cell * wall_height / np.maximum(front_area, 1e-12))


def _add_moment_of_height(wrench: Array, force_moment: Floats) -> None:
    """Add to wrenches (n, 6), in place, the moment of forces that act above the tip: (0, 0, z) × F = (−z Fy, z Fx, 0).

    :param force_moment: (n, 2) ∫ z dF along x and y [N·m].
    """
    wrench[:, 3] -= force_moment[:, 1]
    wrench[:, 4] += force_moment[:, 0]


def _unit_wrenches(turn: Turn, engagement: EngagedEdge, edges: tuple[Floats, Floats], side_chip: Floats) -> Array:
    """Return the mean wrench (6, n, 6) for 1 of each coefficient: Ktc, Krc, Kac [N/m²], Kte, Kre, Kae [N/m].

    :param edges: (n, P) engaged lengths times chip [m²], and (n, P) lengths that rub [m].
    :param side_chip: (n, C) thickness of the chips on the cylinder [m].
    """
    wrench = np.zeros((6, len(side_chip), 6))
    sides = turn.law.chip_factor(side_chip), np.asarray(side_chip > 0.0, np.float32)
    for kind, (edge, side) in enumerate(zip(edges, sides, strict=True)):  # 0: cutting, 1: edge coefficients
        for axis, unit in enumerate(turn.unit_wrench):  # tangential, radial, axial
            coefficient_wrench = wrench[3 * kind + axis]
            coefficient_wrench[:] = product_in_blocks(edge, unit)
            moment = product_in_blocks(engagement.moment * side, unit[turn.side, :2])
            _add_moment_of_height(coefficient_wrench, moment)
    return wrench


def product_in_blocks(matrix: Floats, factor: Floats) -> Floats:
    """Return the product (n, k) of `matrix` (n, P) and `factor` (P, k), in blocks so small that BLAS uses one thread.

    At these sizes threads cost more time than they save, above all if other processes need the processors.
    """
    rows = max(1, _ONE_THREAD // max(1, factor.size))
    return np.concatenate([matrix[k : k + rows] @ factor for k in range(0, max(1, len(matrix)), rows)])
