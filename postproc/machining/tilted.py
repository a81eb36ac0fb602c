"""Tools that cut while their axis is not z of the map: the cells that they sweep, and their edge in material.

The map has one level above each point, so material that such a tool leaves above itself is taken for removed. How much
that is, is counted: `SweptCells.overhang`.

A tool is convex. So the vertical line through a cell is inside of it from one height to another, and the height of its
lower side over a cell is a convex function of its place as it moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import Columns
from postproc.frames import Array, norm
from postproc.machining.cutting import Chips, EngagedEdge, Loads, mean_loads, nearby_cells
from postproc.machining.material import Floats
from postproc.machining.stock import Footprint, Stock, cell_middles, window_cells, windows
from postproc.machining.tool import Cutter, Turn
from postproc.machining.tool_path import StraightSegments
from postproc.program import Bools, Ints
from postproc.toolpath import even_places

_SEARCH_STEPS = 28
"""Steps of the search for the lower side of a rounded corner: it is found to 10⁻⁸ of the size of the tool."""
_RIDGE_HEIGHT = 1e-6
"""Ridges between two poses of a tool are at most this high [m] (assumed)."""
_REST_LENGTH = 1e-9
"""Moves of the tip that are shorter [m] only turn the tool (assumed)."""
_LEAST_SQUARE_SINE = 1e-7
"""Square of the sine of the smallest tilt: a smaller tilt counts as this one, without a division by zero (assumed)."""
_FLUSH_DEPTH = 2e-6
"""An end face less deep below the surface [m] is flush with it (assumed)."""
_MOST_LEVEL_CELLS = 2.0
"""Levels around a point of the edge count up to this many cells above and below it: surfaces that are less steep are
interpolated, and steeper walls are located between two cells."""


def local_axes(travel: Array, axis: Array) -> tuple[Array, Bools]:
    """Return the axes (n, 3, 3) of the edge of a tool as columns, and True (n,) for moves that give no x.

    z is the direction from the tip to the spindle, x the component of the travel square to z, and y = z × x. A move
    along the spindle, or without travel, gives no x: then x is the component of the x of the height map square to z.

    :param travel: (n, 3) unit directions of travel, or zero, in the frame of the map.
    :param axis: (n, 3) unit directions from the tip to the spindle, in the frame of the map.
    """
    component = travel - np.einsum("ni,ni->n", travel, axis)[:, None] * axis
    is_axial = norm(component) < 1e-3
    component[is_axial] = np.array([1.0, 0.0, 0.0]) - axis[is_axial, :1] * axis[is_axial]
    x = component / norm(component)[:, None]
    return np.stack([x, np.cross(axis, x), axis], axis=-1), np.asarray(is_axial)


class TiltedPath(Columns, frozen=True, eq=False):
    """S short straight pieces of the path of a tool that leans or turns, in the frame of the height map [m].

    :param motion: (S,) row of `Motions`, and `t` (S,) place of the middle of the piece on it.
    :param tip: (S, 3) position of the tip in the middle, and `axis` (S, 3) unit direction to the spindle there.
    :param heading: (S, 3) unit direction of travel in the middle, or zero.
    :param begin: (S, 3) position of the tip where the piece begins, and `begin_axis` (S, 3) axis there.
    :param end: (S, 3) position of the tip where the piece ends, and `end_axis` (S, 3) axis there.
    :param pace: (S,) speed of the tip [m/s]; NaN for a tool that only turns, at a speed that is not known.
    :param swing: (S, 3) change of the axis with time [1/s].
    """

    motion: Ints
    t: Array
    tip: Array
    axis: Array
    heading: Array
    begin: Array
    begin_axis: Array
    end: Array
    end_axis: Array
    pace: Array
    swing: Array

    @classmethod
    def of(
        cls,
        segments: StraightSegments,
        begin_axis: Array,
        end_axis: Array,
        cutter: Cutter,
        cell: float,
        *,
        feed: Array,
        swing: Array,
    ) -> TiltedPath:
        """Return the pieces of L segments.

        No piece is longer than a cell, or so long that ridges between its poses are higher than `_RIDGE_HEIGHT`.

        :param begin_axis: (L, 3) axes of the tool where segments begin, and `end_axis` (L, 3) where they end.
        :param cell: width of a cell of the height map [m].
        :param feed: (M,) speed of the tip on motions [m/s].
        :param swing: (M,) angular speed of a tool whose tip rests [rad/s]; NaN: not known.
        """
        length, turn = norm(segments.end - segments.begin), norm(end_axis - begin_axis)
        rounding = cutter.corner if cutter.corner > 0.0 else cutter.radius
        # a ridge between two places of a round of this radius has the height step² / (8 radius)
        step = min(cell, math.sqrt(8.0 * rounding * _RIDGE_HEIGHT))
        count = np.maximum(1, np.ceil((length + cutter.radius * turn) / step - 1e-6)).astype(np.int64)
        piece, share = even_places(np.arange(len(count)), count, "middle")
        half_share = 0.5 / count[piece]

        def interpolated(first: Array, last: Array, place: Array) -> Array:
            """Return values (S, …) at places (S,), 0 … 1, between `first` and `last` (L, …) of the ends of segments."""
            return np.asarray(first[piece] + place[:, None] * (last - first)[piece])

        speed, time = _speeds_and_times(length, turn, feed[segments.motion], swing[segments.motion])
        # begin, middle and end of each piece
        places = share - half_share, share, share + half_share
        axes = [_unit(interpolated(begin_axis, end_axis, place)) for place in places]
        tips = [interpolated(segments.begin, segments.end, place) for place in places]
        rate = (end_axis - begin_axis) / np.maximum(time, 1e-12)[:, None]
        return cls(
            motion=segments.motion[piece],
            t=segments.first[piece] + share * (segments.last - segments.first)[piece],
            tip=tips[1],
            axis=axes[1],
            heading=_unit(interpolated(segments.leave, segments.arrive, share)),
            begin=tips[0],
            begin_axis=axes[0],
            end=tips[2],
            end_axis=axes[2],
            pace=speed[piece],
            swing=rate[piece],
        )

    @property
    def poses(self) -> tuple[Array, Array]:
        """Positions of the tip (S + 1, 3) [m] and axes (S + 1, 3) from the start to the end of the path."""
        return np.concatenate([self.begin, self.end[-1:]]), np.concatenate([self.begin_axis, self.end_axis[-1:]])


def _unit(vectors: Array) -> Array:
    """Return vectors (n, 3) divided by their lengths; zero remains zero."""
    return np.asarray(vectors / np.maximum(norm(vectors), 1e-12)[:, None])


def _speeds_and_times(length: Array, turn: Array, feed: Array, swing: Array) -> tuple[Array, Array]:
    """Return the speeds of the tip on segments (L,) [m/s], and the times of segments (L,) [s].

    Where the tip rests, its speed is 0; NaN if its angular speed is not known.

    :param length: (L,) length of the path of the tip [m], and `turn` (L,) change of the axis [rad].
    :param feed: (L,) [m/s].
    :param swing: (L,) angular speed of a tool whose tip rests [rad/s]; NaN: not known.
    """
    is_at_rest = length < _REST_LENGTH
    speed = np.where(is_at_rest, np.where(np.isnan(swing), np.nan, 0.0), feed)
    time_at_rest = turn / np.where(swing > 0.0, swing, 1.0)  # of an unknown swing any time: the speed is NaN
    return speed, np.where(is_at_rest, time_at_rest, length / np.maximum(speed, 1e-12))


class TiltedLoads(NamedTuple):
    """Mean loads of a tool that leans or turns, at S stations.

    :param loads: mean loads, in the axes of `local_axes`.
    :param cuts: (S, P) length of edge that cuts at each sample point [m].
    :param is_axial: (S,) True where the travel is along the spindle.
    """

    loads: Loads
    cuts: Floats
    is_axial: Bools


def loads(stock: Stock, turn: Turn, path: TiltedPath, tooth_time: Array, hand: Ints) -> TiltedLoads:
    """Return the mean loads of a tool that leans or turns at the S stations of a path.

    :param tooth_time: (S,) time from one tooth to the next [s].
    :param hand: (S,) 1 for M3, −1 for M4.
    """
    axes, is_axial = local_axes(path.heading, path.axis)
    edge_axes = axes.copy()
    edge_axes[:, :, 1] *= hand[:, None]  # M4 mirrors the turn of the edge
    edge_points = _edge_points(turn)
    point = path.tip.astype(np.float32)[:, None] + np.einsum("nik,kp->npi", edge_axes.astype(np.float32), edge_points)
    chip = _tilted_chips(turn, path, edge_axes, edge_points, tooth_time)
    engagement = tilted_cut_edge(stock, turn, point, edge_axes)
    descent_sine = np.maximum(-np.einsum("ni,ni->n", path.heading, path.axis), 0.0).astype(np.float32)
    cosine = np.abs(edge_axes[:, 2].astype(np.float32) @ _edge_normals(turn))
    # a cell of the map is cell² / cos(tilt) on a surface square to the tool: a square as large has this width; where
    # the slope of each piece counts by itself, it contains the tilt
    cell = stock.cell / np.sqrt(path.axis[:, 2]) if turn.least_cosine == 1.0 else stock.cell
    turn_loads = mean_loads(turn, engagement, chip, descent_sine, cell, cosine)
    return TiltedLoads(turn_loads, engagement.length * chip.share, is_axial)


def _edge_points(turn: Turn) -> Floats:
    """Return the middles (3, P) of the pieces of edge over a turn, in the axes of the tool from its tip [m]."""
    rise = np.where(np.isfinite(turn.rise), turn.rise, 0.0)
    x, y = turn.radius * np.sin(turn.phi), turn.radius * np.cos(turn.phi)
    return np.stack([x, y, turn.low + 0.5 * rise]).astype(np.float32)


def _edge_normals(turn: Turn) -> Floats:
    """Return the normals (3, P) of the pieces of edge over a turn, into the material, in the axes of the tool."""
    sine_of_kappa = np.sqrt(np.maximum(1.0 - turn.normal_down**2, 0.0))  # the normal points down by cos κ
    return np.stack([turn.normal_x, sine_of_kappa * np.cos(turn.phi), -turn.normal_down]).astype(np.float32)


def _tilted_chips(turn: Turn, path: TiltedPath, edge_axes: Array, edge_points: Floats, tooth_time: Array) -> Chips:
    """Return the chips of a tool that leans or turns: its edge moves by travel and turn from one tooth to the next.

    The thickness of a chip is the component of this movement along the normal of the edge.

    :param edge_axes: (S, 3, 3) axes of the edge as columns, frame of the height map; mirrored for M4.
    :param edge_points: (3, P) middles of the pieces of edge in these axes, from the tip [m].
    :param tooth_time: (S,) time from one tooth to the next [s].
    """
    travel = np.nan_to_num(path.pace * tooth_time)[:, None] * np.einsum("nik,ni->nk", edge_axes, path.heading)
    axis_step = tooth_time[:, None] * np.einsum("nik,ni->nk", edge_axes, path.swing)
    travel_row, axis_step_row = travel.astype(np.float32), axis_step[:, :2].astype(np.float32)
    # a point r of a tool with axis a, at height h = a·r, moves by e h − a (e·r) where the axis changes by e
    middle, change = (
        travel_row @ direction + axis_step_row @ (direction[:2] * point[2] - direction[2] * point[:2])
        for direction, point in (
            (_edge_normals(turn), edge_points),
            (turn.tangent[turn.round].T, edge_points[:, turn.round]),
        )
    )
    return Chips.of(turn, middle, change)


class SweptCells(Struct, frozen=True, eq=False):
    """Cells that a tool sweeps.

    :param footprint: the cells that it covers, with its lowest level.
    :param front: cells under its front where the motion ends: it moves into their material next.
    :param depth: largest depth of material in cells under the tool [m].
    :param overhang: volume above the tool, away from its front, that a height map cannot keep [m³].
    :param removal: volume that is removed, away from its front and with the overhang [m³].
    """

    footprint: Footprint
    front: Footprint
    depth: float
    overhang: float
    removal: float


def sweep(stock: Stock, cutter: Cutter, tip: Array, axis: Array, top: float) -> SweptCells:
    """Return the cells under a tool that moves from pose to pose, without removing their material.

    Those under its front, the part that moves into material where the path ends, are returned apart.

    :param tip: (n, 3) positions of the tip [m] in n > 1 poses close together, frame of the height map.
    :param axis: (n, 3) unit directions to the spindle.
    :param top: height of the highest material near the path [m].
    """
    parts = list(_cells_by_move(stock, cutter, tip, axis, top))
    if not parts:
        return SweptCells(Footprint.empty(), Footprint.empty(), depth=0.0, overhang=0.0, removal=0.0)
    covered = _CoveredCells(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    # each cell once: lowest level of the lower side, and highest level of the upper side, over all moves
    cell, cell_row = np.unique(covered.cell, return_inverse=True)
    low, high, is_front = np.full(len(cell), np.inf), np.full(len(cell), -np.inf), np.zeros(len(cell), dtype=bool)
    np.minimum.at(low, cell_row, covered.low)
    np.maximum.at(high, cell_row, covered.high)
    is_front[cell_row[covered.is_front]] = True
    material, floor = (values.reshape(-1)[cell] for values in (stock.high, stock.floor))
    height_above = np.maximum(material - np.maximum(high, floor), 0.0)  # of the material above the tool
    depth = np.maximum(material - np.maximum(low, floor), 0.0)
    no_rim = np.zeros(0, dtype=bool)  # the footprint of a tilted tool has no cells that are covered in part
    segment = np.zeros(len(cell), dtype=np.int32)  # not used: no slopes are kept of cells that a tilted tool cuts
    footprint = replace(Footprint.empty(), cell=cell, level=low.astype(np.float32), segment=segment)
    return SweptCells(
        footprint=footprint.selected(~is_front, no_rim),
        front=footprint.selected(is_front, no_rim),
        depth=float(depth.max(initial=0.0)),
        overhang=float(height_above[~is_front].sum()) * stock.cell**2,
        removal=float(depth[~is_front].sum()) * stock.cell**2,
    )


class _CoveredCells(NamedTuple):
    """Cells whose material a tool removes, one row for each cell and move from pose to pose.

    :param cell: (n,) index in the flat map.
    :param low: (n,) lowest level of the tool there [m], and `high` (n,) highest level of its upper side [m].
    :param is_front: (n,) True for cells under its front at the end of the last move.
    """

    cell: Ints
    low: Array
    high: Array
    is_front: Bools


def _cells_by_move(stock: Stock, cutter: Cutter, tip: Array, axis: Array, top: float) -> Iterator[_CoveredCells]:
    """Yield the cells under a tool that moves from pose to pose, in batches of moves; parameters as in `sweep`."""
    axis_end = np.maximum(top - tip[:, 2:], 0.0) / axis[:, 2:] * axis  # where the axis leaves the stock
    ends = np.stack([tip[:-1], tip[1:], (tip + axis_end)[:-1], (tip + axis_end)[1:]])
    for rows, corner, window in windows(stock, cutter.radius + stock.cell, ends.min(axis=0), ends.max(axis=0)):
        index, cell_row, column = window_cells(stock, corner, window)
        x, y = (values.astype(float) for values in cell_middles(stock, tip[rows], cell_row, column))
        low, sinks, high = _lowest_levels(cutter, tip, axis, rows, x, y)
        material = stock.high.reshape(-1)[index]
        is_cut, is_last = low < material, rows == len(tip) - 2
        is_front = sinks & is_last[:, None, None]
        if is_last.any():  # where a tool leans back, and at its rim, the material that it enters next is not below it
            points = x[is_last], y[is_last], material[is_last]
            is_front[is_last] |= _is_outward_side(cutter, tip, axis, rows[is_last], points, stock.cell)
        yield _CoveredCells(index[is_cut], low[is_cut], high[is_cut], is_front[is_cut])


def _is_outward_side(
    cutter: Cutter, tip: Array, axis: Array, rows: Ints, points: tuple[Array, Array, Array | Floats], margin: float
) -> Bools:
    """Return True for points (L, h, w) next to the side of a tool, or outside of it, where the tool moves outwards.

    It does so where its velocity at the point has a component along the outward normal n of its cylinder. A point r
    from the tip, at the height h along the axis, moves by shift + h turn − axis (r·turn) as the axis changes by turn.

    :param tip: (n, 3) positions of the tip [m], and `axis` (n, 3) unit directions to the spindle at the poses.
    :param rows: (L,) first pose of each move.
    :param points: x and y (L, h, w) of the points from the tip at that pose, and their heights (L, h, w) in the map
        [m].
    :param margin: distance of points inside of the tool from its side that counts as near [m].
    """
    shift, turn = (values[rows + 1] - values[rows] for values in (tip, axis))
    # from the tip at the end of the move
    x, y, height = points
    place = [x - shift[:, 0, None, None], y - shift[:, 1, None, None], height - tip[rows + 1, 2, None, None]]
    end_axis, axis_change, tip_change = (
        [vectors[:, k, None, None] for k in range(3)] for vectors in (axis[rows + 1], turn, shift)
    )
    # components of the point along the axis, and along the change of the axis
    along, lean = (sum(p * u for p, u in zip(place, vector, strict=True)) for vector in (end_axis, axis_change))
    to_side = [p - along * u for p, u in zip(place, end_axis, strict=True)]  # square to the axis
    # n · velocity, for a normal of any length
    outwards = sum(
        normal * (tip_step + along * axis_step - u * lean)
        for normal, tip_step, axis_step, u in zip(to_side, tip_change, axis_change, end_axis, strict=True)
    )
    # by how much the rounded corner is inside of the cylinder at the height of the point
    rounding = cutter.corner - np.sqrt(cutter.corner**2 - np.clip(cutter.corner - along, 0.0, cutter.corner) ** 2)
    distance = np.sqrt(sum(n * n for n in to_side))
    return np.asarray((distance > cutter.radius - rounding - margin) & (outwards > 0.0))


class _Levels(NamedTuple):
    """Levels of a tool over cells in L moves from one pose to the next.

    :param low: (L, h, w) lowest level of its lower side [m]; infinite where the tool does not come.
    :param sinks: (L, h, w) True where its lower side still sinks at the end of the move.
    :param high: (L, h, w) highest level of its upper side [m]; minus infinite where the tool does not come.
    """

    low: Array
    sinks: Bools
    high: Array


def _lowest_levels(cutter: Cutter, tip: Array, axis: Array, rows: Ints, x: Array, y: Array) -> _Levels:
    """Return the lowest levels of a tool over cells in L moves from one pose to the next.

    The slope of the lower side with the move is known at both ends, so that its minimum between them is found from two
    planes or from a parabola.

    :param tip: (n, 3) positions of the tip [m], and `axis` (n, 3) unit directions to the spindle at the poses.
    :param rows: (L,) first pose of each move.
    :param x: (L, h, w) x of cells from the tip at that pose [m], and `y` (L, h, w) their y.
    """
    shift = tip[rows + 1] - tip[rows]
    turn = axis[rows + 1] - axis[rows]
    sides = []  # in the first pose of each move, then in the last
    for pose in (rows, rows + 1):
        displacement = (pose != rows)[:, None] * shift
        px, py = x - displacement[:, 0, None, None], y - displacement[:, 1, None, None]
        low, high, slope = _lower_and_upper_sides(cutter, axis[pose], px, py, shift, turn)
        sides.append((low + tip[pose, 2, None, None], high + tip[pose, 2, None, None], slope))
    (low_a, high_a, slope_a), (low_b, high_b, slope_b) = sides  # at both poses of each move
    level = np.minimum(low_a, low_b)
    has_minimum = np.isfinite(low_a) & np.isfinite(low_b) & (slope_a < 0.0) & (slope_b > 0.0)
    a, b, sa, sb = low_a[has_minimum], low_b[has_minimum], slope_a[has_minimum], slope_b[has_minimum]
    if cutter.corner == 0.0:  # two planes that meet at the rim, where a + sa s = b − sb (1 − s)
        share = np.clip((b - sb - a) / (sa - sb), 0.0, 1.0)
        bottom = a + sa * share
    else:  # a smooth curve: its slope sa + (sb − sa) s is linear, and the minimum the mean of two from both ends
        share = sa / (sa - sb)
        bottom = 0.5 * (a + 0.5 * sa * share + b - 0.5 * sb * (1.0 - share))
    level[has_minimum] = np.minimum(bottom, level[has_minimum])
    return _Levels(level, np.isfinite(low_b) & (slope_b < 0.0), np.maximum(high_a, high_b))


class _Sides(NamedTuple):
    """The lower and the upper side of a tool on vertical lines, in one pose.

    :param low: (L, h, w) height of its lower side above the tip [m]; infinite where the line misses the tool.
    :param high: (L, h, w) height of its upper side above the tip [m]; minus infinite where the line misses the tool.
    :param slope: (L, h, w) rate at which the lower side rises, per move [m]; 0 where the line misses the tool.
    """

    low: Array
    high: Array
    slope: Array


def _lower_and_upper_sides(cutter: Cutter, axis: Array, x: Array, y: Array, shift: Array, turn: Array) -> _Sides:
    """Return the lower and the upper side of a tool on vertical lines.

    :param axis: (L, 3) unit directions to the spindle.
    :param x: (L, h, w) x of the lines from the tip [m], and `y` (L, h, w) their y.
    :param shift: (L, 3) displacement of the tip in a move [m], and `turn` (L, 3) change of the axis in it.
    """
    ax, ay, az = (axis[:, k, None, None] for k in range(3))
    axial = x * ax + y * ay  # of the point at the height of the tip, along the axis
    square_sine = np.maximum(1.0 - az * az, _LEAST_SQUARE_SINE)
    # a point (x, y, z) is in the cylinder if x² + y² + z² − (axial + az z)² < radius²: a quadratic equation in z, with
    # the coefficients sin² of the tilt, −2 axial az and x² + y² − axial² − radius²
    root = axial * axial * az * az - square_sine * (x * x + y * y - axial * axial - cutter.radius**2)
    is_met = root > 0.0
    half_root = np.sqrt(np.where(is_met, root, 0.0))
    # of the cylinder, without ends
    low, high = (axial * az - half_root) / square_sine, (axial * az + half_root) / square_sine
    low = np.maximum(low, -axial / az)  # above the plane of the tip
    is_met &= low < high
    flat_radius, corner = cutter.radius - cutter.corner, cutter.corner
    if flat_radius <= 1e-9 * cutter.radius:  # a ball, but for rounding
        low, is_met = _ball_side(cutter.radius, axis, (x, y), axial, _Chords(low, high, is_met))
    elif corner > 0.0:
        low, is_met = _corner_side(cutter, axial, az, x * x + y * y, _Chords(low, high, is_met))
    slope = _slope_of_lower_side(cutter, axis, (x, y, low), axial, shift, turn)
    return _Sides(np.where(is_met, low, np.inf), np.where(is_met, high, -np.inf), np.where(is_met, slope, 0.0))


class _Chords(NamedTuple):
    """Vertical lines in the cylinder of a tool, above the plane through its tip.

    :param low: (L, h, w) height above the tip where a line enters it [m], and `high` (L, h, w) where it leaves it.
    :param is_met: (L, h, w) whether the line meets the cylinder; elsewhere the heights mean nothing.
    """

    low: Array
    high: Array
    is_met: Bools


def _slope_of_lower_side(
    cutter: Cutter, axis: Array, point: tuple[Array, Array, Array], axial: Array, shift: Array, turn: Array
) -> Array:
    """Return the rate (L, h, w) [m] per move at which points of the lower side of a tool rise.

    At a point with the normal n and the velocity v of the tool, the side rises by n·v / n_z on a vertical line. The
    velocity is v = shift + h turn − axis (r·turn), for a point r at the height h along the axis.

    :param axis: (L, 3) unit directions to the spindle.
    :param point: x, y, z (L, h, w) of the points from the tip [m].
    :param axial: (L, h, w) component along the axis of the points at the height of the tip [m].
    :param shift: (L, 3) displacement of the tip in a move [m], and `turn` (L, 3) change of the axis in it.
    """
    x, y, low = point
    ax, ay, az = (axis[:, k, None, None] for k in range(3))
    height = axial + low * az  # above the tip, along the axis
    flat_radius, corner = cutter.radius - cutter.corner, cutter.corner
    px, py, pz = (component - height * a for component, a in ((x, ax), (y, ay), (low, az)))
    distance = np.sqrt(px * px + py * py + pz * pz)
    if corner > 0.0:
        axial_part = np.maximum(corner - height, 0.0)
        radial_part = np.where(axial_part > 0.0, np.maximum(distance - flat_radius, 0.0), 1.0)
    else:
        axial_part = (height < 1e-9).astype(float)  # on the flat end, but for rounding
        radial_part = 1.0 - axial_part
    scale = radial_part / np.maximum(distance, 1e-12)  # no division by zero on the axis
    normal = [p * scale - axial_part * a for p, a in ((px, ax), (py, ay), (pz, az))]  # outward, of any length
    dx, dy, dz = (turn[:, k, None, None] for k in range(3))
    axis_motion = x * dx + y * dy + low * dz
    velocity = [
        shift[:, k, None, None] + height * d - a * axis_motion
        for k, (d, a) in enumerate(((dx, ax), (dy, ay), (dz, az)))
    ]
    normal_speed = sum(n * v for n, v in zip(normal, velocity, strict=True))
    # where the side is vertical the slope is limited: the line just touches the tool
    return np.asarray(normal_speed / np.where(normal[2] < -1e-9, normal[2], -1e-9))


def _ball_side(
    radius: float, axis: Array, point: tuple[Array, Array], axial: Array, chords: _Chords
) -> tuple[Array, Bools]:
    """Return the lower side of a ball-nose tool (L, h, w) [m], and True (L, h, w) for lines that meet the tool.

    It is the lower side of the ball or of the cylinder; 0 on lines that miss the tool.

    :param radius: radius of the tool [m].
    :param axis: (L, 3) unit directions to the spindle.
    :param point: x and y (L, h, w) of vertical lines from the tip [m].
    :param axial: (L, h, w) component of these points along the axis [m].
    """
    ax, ay, az = (axis[:, k, None, None] for k in range(3))
    # the centre of the ball is one radius along the axis from the tip
    square = radius**2 - (point[0] - radius * ax) ** 2 - (point[1] - radius * ay) ** 2
    ball = np.where(square > 0.0, radius * az - np.sqrt(np.maximum(square, 0.0)), np.inf)
    # the cylinder begins at the centre of the ball: above the plane through it, square to the axis
    cylinder = np.maximum(chords.low, (radius - axial) / az)
    cylinder = np.where(chords.is_met & (cylinder < chords.high), cylinder, np.inf)
    lower_side = np.minimum(ball, cylinder)
    is_met = np.isfinite(lower_side)
    return np.where(is_met, lower_side, 0.0), is_met


def _corner_side(cutter: Cutter, axial: Array, az: Array, square: Array, chords: _Chords) -> tuple[Array, Bools]:
    """Return the lower side of a tool with a rounded corner (L, h, w) [m], and True (L, h, w) for lines that meet it.

    The lower side is 0 on lines that miss the cylinder. The tool is inside of a flat tool, whose lower side is
    `chords.low`. The distance from its surface is convex along a line: a golden section finds the innermost place,
    bisection the lower side below it.

    :param axial: (L, h, w) component along the axis of the points of lines at the height of the tip [m]; `az` (L, 1, 1)
        z of the axis; `square` (L, h, w) squares of the horizontal distances from the tip [m²].
    """
    lower_side, is_met = np.where(chords.is_met, chords.low, 0.0), chords.is_met.copy()
    rows = np.flatnonzero(is_met)  # lines that miss the tool need no search
    lines = [np.broadcast_to(part, is_met.shape).ravel()[rows] for part in (axial, az, square)]
    begin = chords.low.ravel()[rows]
    # four radii further along the axis, a line is above the corner
    a, b = begin, np.minimum(chords.high.ravel()[rows], begin + 4.0 * cutter.radius / lines[1])
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    for _ in range(_SEARCH_STEPS):  # the innermost place on the line
        first, second = b - ratio * (b - a), a + ratio * (b - a)
        is_left_closer = _surface_distances(cutter, first, *lines) < _surface_distances(cutter, second, *lines)
        a, b = np.where(is_left_closer, a, first), np.where(is_left_closer, second, b)
    inner = 0.5 * (a + b)
    has_inside = _surface_distances(cutter, inner, *lines) < 0.0
    is_met.ravel()[rows] = has_inside
    lines = [part[has_inside] for part in lines]
    a, b = begin[has_inside], inner[has_inside]
    for _ in range(_SEARCH_STEPS):
        middle = 0.5 * (a + b)
        is_inside = _surface_distances(cutter, middle, *lines) < 0.0
        a, b = np.where(is_inside, a, middle), np.where(is_inside, middle, b)
    lower_side.ravel()[rows[has_inside]] = b
    return lower_side, is_met


def _surface_distances(cutter: Cutter, z: Array, axial: Array, az: Array, square: Array) -> Array:
    """Return the distances (n,) [m] of points from the surface of a tool with a rounded corner, < 0 inside.

    The tool is all that is within the radius of the corner of an inner cylinder without a rounded corner. The radius of
    the inner cylinder is smaller by the radius of the corner, and its end is higher by it.

    :param z: (n,) heights on vertical lines above the tip [m].
    :param axial: (n,) component along the axis of the points of the lines at the height of the tip [m], `az` (n,) z of
        the axis, `square` (n,) squares of the horizontal distances of the lines from the tip [m²].
    """
    height = axial + z * az  # along the axis
    # how far a point is outside of the side of the inner cylinder, and of its end
    radial_excess = np.sqrt(np.maximum(square + z * z - height * height, 0.0)) - (cutter.radius - cutter.corner)
    axial_excess = cutter.corner - height
    outer_distance = np.hypot(np.maximum(radial_excess, 0.0), np.maximum(axial_excess, 0.0))  # 0 inside
    inner_distance = np.minimum(np.maximum(radial_excess, axial_excess), 0.0)  # from the nearer one; 0 outside
    return np.asarray(outer_distance + inner_distance - cutter.corner)


def tilted_cut_edge(stock: Stock, turn: Turn, point: Array, axes: Array) -> EngagedEdge:
    """Return the cutting edge in material of a tool that leans.

    :param turn: without pieces on a cylinder.
    :param point: (n, P, 3) middles of the pieces of edge, frame of the height map [m].
    :param axes: (n, 3, 3) axes of the edge as columns, see `local_axes`; mirrored for M4.
    """
    x, y, z = (point[..., k].astype(np.float32) for k in range(3))
    corners = nearby_cells(stock, x, y)
    steepest = np.float32(_MOST_LEVEL_CELLS * stock.cell)
    high, low, share, floor = (values.reshape(-1) for values in (stock.high, stock.low, stock.share, stock.floor))
    depth = np.zeros_like(x)
    for cell, weight in zip(corners.cell, corners.weight, strict=True):
        upper = high.take(cell)
        # height of the material over the point of the edge, limited; a cell without material is far below it
        level = np.where(upper > floor.take(cell), np.clip(upper - z, -steepest, steepest), -steepest)
        cut_share = share.take(cell)
        if cut_share.any():  # part of the cell is cut down to its lower level
            level += cut_share * (np.clip(np.minimum(low.take(cell), upper) - z, -steepest, steepest) - level)
        depth += weight * level
    depth[:, turn.bottom] -= np.float32(_FLUSH_DEPTH)
    extent = _vertical_extents(turn, axes)
    share_in_material = np.clip(0.5 + depth / extent, 0.0, 1.0)  # half of a piece whose middle is on the surface
    # `ground` is above the lower sides (`floor`) of all cells; below its floor a cell has no material
    if float(z.min()) < stock.ground:
        share_in_material *= z > floor.take(corners.cell[0])
    return EngagedEdge(share_in_material * turn.length, np.zeros((len(x), 0), dtype=np.float32))


def _vertical_extents(turn: Turn, axes: Array) -> Floats:
    """Return the extents of pieces of edge (n, P) along z of the height map [m], at least 0.1 µm.

    :param axes: (n, 3, 3) axes of the edge as columns, see `local_axes`; mirrored for M4.
    """
    up = axes[:, 2].astype(np.float32)  # z of the map in the axes of the tool
    sine, cosine = np.sin(turn.phi).astype(np.float32), np.cos(turn.phi).astype(np.float32)
    sine_of_kappa = np.sqrt(np.maximum(1.0 - turn.normal_down**2, 0.0)).astype(np.float32)
    radial = turn.normal_down * (up[:, :1] * sine + up[:, 1:2] * cosine)  # along the edge, outwards and up
    return np.asarray(np.maximum(turn.length * np.abs(radial + sine_of_kappa * up[:, 2:]), np.float32(1e-7)))
