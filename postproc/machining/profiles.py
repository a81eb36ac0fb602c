"""Forces along motions as piecewise linear profiles, from the stations of a sweep.

Stations that such a profile does not need are omitted (`thin_out`). At the start of a motion the force changes within
half the feed per tooth (`smooth_steps`): the mean force is the mean over the tooth pitch, and after a change of
engagement the next tooth cuts the new chip. The force drops to zero at once when the tool is retracted. A force CSV has
one profile for all moves of a line (`one_move_a_line`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from postproc.errors import ForceError
from postproc.forces import Knots
from postproc.forces.sources import BASE, FEED
from postproc.frames import Array, norm
from postproc.machining.tilted import local_axes
from postproc.machining.tool_path import TURNS, ToolPoses, home_base
from postproc.program import CIRC, LIN, Bools, Ints, Program, constant
from postproc.toolpath import Segments, tangent

_TOLERANCE_SHARE = 0.01
"""Tolerance between stations as a share of the largest force and of the largest moment of a motion,"""
_LEAST_TOLERANCE = 1.0, 0.1
"""but at least this [N, N·m]: one newton at 100 mm of tool. Changes at the start of a motion that are smaller than
this tolerance extend over the whole motion."""


def thin_out(motion: Ints, wrench: Array) -> NDArray[np.int64]:
    """Return the rows (K,) of stations that are needed: between them the wrench is linear to within a tolerance.

    The first and the last station of each motion are kept. A motion with a constant wrench keeps one station.

    :param motion: (N,) row of `Motions`, never decreasing.
    :param wrench: (N, 6) [N, N·m].
    """
    if len(motion) == 0:
        return np.zeros(0, dtype=np.int64)
    bounds = np.flatnonzero(np.diff(motion, prepend=-1, append=-1))
    count = np.diff(bounds)
    # forces and moments are divided by their own tolerances, so that 1 is the limit for both
    halves = np.array(wrench, dtype=float).reshape(-1, 2, 3)
    tolerance = np.maximum(_TOLERANCE_SHARE * np.maximum.reduceat(norm(halves), bounds[:-1]), _LEAST_TOLERANCE)
    halves /= np.repeat(tolerance, count, axis=0)[:, :, None]
    low, high = np.minimum.reduceat(halves, bounds[:-1]), np.maximum.reduceat(halves, bounds[:-1])
    # constant: the diagonal of the box of all values is within the tolerance
    is_constant = norm(high - low).max(axis=1) <= 1.0
    middle_rows = bounds[:-1] + count // 2
    rows = [middle_rows[is_constant]]
    for motion_number in np.flatnonzero(~is_constant).tolist():
        begin, end = int(bounds[motion_number]), int(bounds[motion_number + 1])
        rows.append(begin + np.array(sorted(_kept_rows(halves[begin:end])), dtype=np.int64))
    return np.sort(np.concatenate(rows))


def _kept_rows(halves: Array) -> Iterator[int]:
    """Yield the rows that a piecewise linear profile of forces and moments needs, in no order.

    The algorithm of Ramer 1972 and of Douglas and Peucker 1973, over the row number.

    :param halves: (n, 2, 3) forces and moments, each in units of its tolerance.
    """
    last = len(halves) - 1
    yield from {0, last}
    open_ranges = [(0, last)]
    while open_ranges:
        begin, end = open_ranges.pop()
        if end - begin < 2:
            continue
        share = ((np.arange(begin + 1, end) - begin) / (end - begin))[:, None, None]
        deviation = norm(halves[begin + 1 : end] - (halves[begin] + share * (halves[end] - halves[begin]))).max(axis=1)
        farthest = int(np.argmax(deviation))
        if deviation[farthest] > 1.0:
            yield begin + 1 + farthest
            open_ranges += [(begin, begin + 1 + farthest), (begin + 1 + farthest, end)]


def smooth_steps(
    poses: ToolPoses,
    stations: tuple[Ints, Array, Array, Array],
    rise: Array,
    sigma: tuple[float, float],
    *,
    base_axes: bool,
) -> Knots:
    """Return the knots of wrenches that are continuous from motion to motion.

    At the start of a motion the force changes from that at the end of the motion before, zero after a rapid one, to
    its own; at the end of the motion it acts in full.

    :param poses: the tool on the path, in the frame of the map of the stock.
    :param stations: rows of `Motions` (n,), places on them, and wrenches (n, 6) with standard deviations of their own
        (n, 6) in FEED axes; on moves along the spindle in `tilted.local_axes`.
    :param rise: (M,) length over which the force changes at the start of a motion [m].
    :param sigma: standard deviation as a share of the wrench, which may be one factor of it; and that of the axial
        force as a share of the force across the axis (0 where axial coefficients are known), in addition.
    :param base_axes: give them in `$BASE`, but for arcs; else in FEED, but for moves along the spindle.
    """
    program, path = poses.program, poses.path
    motion, t, wrench, own_deviation = stations
    first = np.flatnonzero(np.diff(motion, prepend=-1))
    has_one_station = first == np.append(first[1:], len(motion)) - 1
    cut_motions = motion[first]
    start_wrench, start_deviation = _start_wrenches(poses, first, stations)
    reach = np.minimum(1.0, rise[cut_motions] / np.maximum(path.length[cut_motions], 1e-9))
    wrench_at_rise = _wrenches_at(motion, t, wrench, cut_motions, reach)
    reach[_begins_with_last_force(start_wrench, wrench_at_rise, wrench, first)] = 1.0
    row, places = _knot_places(path.length[cut_motions] > rise[cut_motions], reach, first, t)
    values, free_deviation = (
        _wrenches_at(motion, t, station_values, cut_motions[row], places) for station_values in (wrench, own_deviation)
    )
    begins = np.flatnonzero(np.diff(row, prepend=-1))
    values[begins], free_deviation[begins] = start_wrench, start_deviation
    axial_sigma = sigma[1] * norm(values[:, :2])
    count = np.diff(begins, append=len(row))
    motions = cut_motions[row]
    axes, is_axial = _feed_axes(poses, motions, places)
    is_steady = np.repeat(has_one_station, count)
    turns_axes = (program.motions.kind[motions] == CIRC) | (path.turn[motions] > TURNS)
    # stations are thinned where the wrench is linear in FEED axes: where these turn, it is not linear in $BASE
    in_base = (is_axial[np.repeat(np.cumsum(count) - 1, count)] & ~(is_steady & turns_axes)) | (~turns_axes & base_axes)
    to_base = _to_base(program, motions[in_base], poses.frame) @ axes[in_base]
    values[in_base] = _in_other_axes(to_base, values[in_base])
    free_deviation[in_base] = _deviation_in_other_axes(to_base, free_deviation[in_base])
    deviation = np.hypot(np.abs(values) * sigma[0], free_deviation)
    # on moves along the spindle in $BASE axes: z of $BASE is taken for the axis of the tool
    deviation[:, 2] = np.hypot(deviation[:, 2], axial_sigma)
    factor = constant(sigma[0], len(motions))
    return Knots.along(motions, places, values, np.where(in_base, BASE, FEED), deviation, factor)


def _start_wrenches(poses: ToolPoses, first: Ints, stations: tuple[Ints, Array, Array, Array]) -> tuple[Array, Array]:
    """Return the wrenches at the starts of cutting motions, and their standard deviations, (k, 6) each, in FEED axes.

    They are those at the end of the motion before, in the axes there; zero after a rapid motion.

    :param first: (k,) first station of each cutting motion; `stations` see `smooth_steps`.
    """
    motion, _, wrench, deviation = stations
    last, cut_motions = np.append(first[1:], len(motion)) - 1, motion[first]
    end_axes = _feed_axes(poses, cut_motions, np.ones(len(cut_motions)))[0]
    ends, end_deviation = _in_other_axes(end_axes, wrench[last]), _deviation_in_other_axes(end_axes, deviation[last])
    follows = np.flatnonzero(np.diff(cut_motions, prepend=-2) == 1)
    start_wrench, start_deviation = np.zeros((len(cut_motions), 6)), np.zeros((len(cut_motions), 6))
    start_axes = np.swapaxes(_feed_axes(poses, cut_motions[follows], np.zeros(len(follows)))[0], 1, 2)
    start_wrench[follows] = _in_other_axes(start_axes, ends[follows - 1])
    start_deviation[follows] = _deviation_in_other_axes(start_axes, end_deviation[follows - 1])
    return start_wrench, start_deviation


def _knot_places(is_long: Bools, reach: Array, first: Ints, t: Array) -> tuple[Ints, Array]:
    """Return cutting motion (m,), as a place in `first`, and place on it (m,) of knots, in order.

    At 0 there is the force of the motion before; where the rise ends that of the motion itself; then its stations, and
    its own force at the end. A motion that is all rise has no knots between, unless it is long and goes on as before.

    :param is_long: (k,) motions longer than their rise.
    :param reach: (k,) where the rise ends on a motion, 0 … 1; 1 too for one that begins with the force before it.
    :param first: (k,) first station of each motion; `t` (n,) places of all stations.
    """
    rows = np.arange(len(first))
    count = np.diff(first, append=len(t))
    row = np.repeat(rows, count)
    is_inner = (t > np.where(reach < 1.0, reach, 0.0)[row] + 1e-9) & (t < 1.0) & ~(count == 1)[row]
    is_inner &= ((reach < 1.0) | is_long)[row]
    early_rows = np.flatnonzero(reach < 1.0)
    row_of_place = np.concatenate([rows, early_rows, row[is_inner], rows])
    places = np.concatenate([np.zeros(len(rows)), reach[early_rows], t[is_inner], np.ones(len(rows))])
    order = np.lexsort((places, row_of_place))
    return row_of_place[order], places[order]


def _begins_with_last_force(start_wrench: Array, wrench_at_rise: Array, wrench: Array, first: Ints) -> Bools:
    """Return which cutting motions (k,) begin with about the force at the end of the motion before.

    :param start_wrench: (k, 6) at the end of the motion before, `wrench_at_rise` (k, 6) after the rise.
    :param wrench: (n, 6) of all stations; `first` (k,) row of the first station of each motion.
    """
    is_alike = np.ones(len(wrench_at_rise), dtype=bool)
    for half, least_tolerance in zip((slice(0, 3), slice(3, 6)), _LEAST_TOLERANCE, strict=True):
        largest = np.maximum.reduceat(norm(wrench[:, half]), first)
        is_alike &= norm(wrench_at_rise[:, half] - start_wrench[:, half]) <= np.maximum(
            _TOLERANCE_SHARE * largest, least_tolerance
        )
    return is_alike


def _wrenches_at(motion: Ints, t: Array, wrench: Array, place_motion: Ints, places: Array) -> Array:
    """Return wrenches (k, 6) at places on motions: linear between the stations of each, constant outside of them.

    :param motion: (n,) motion of each station, `t` (n,) place on it, `wrench` (n, 6).
    :param place_motion: (k,) motion of each place, and `places` (k,) on it in [0, 1].
    """
    # half of t keeps the end of a motion apart from the start of the next in one sorted key
    next_station = np.searchsorted(motion + 0.5 * t, place_motion + 0.5 * places)
    first_rows, last_rows = (
        np.searchsorted(motion, place_motion, side="left"),
        np.searchsorted(motion, place_motion, side="right") - 1,
    )
    next_row = np.clip(next_station, first_rows, last_rows)
    last_row = np.clip(next_station - 1, first_rows, last_rows)
    interval = t[next_row] - t[last_row]
    share = np.clip((places - t[last_row]) / np.where(interval > 0.0, interval, 1.0), 0.0, 1.0)
    return np.asarray(wrench[last_row] + share[:, None] * (wrench[next_row] - wrench[last_row]))


def _feed_axes(poses: ToolPoses, motion: Ints, t: Array) -> tuple[Array, Bools]:
    """Return FEED axes (n, 3, 3) as columns in those of the map, and which places (n,) are on moves along the spindle.

    :param motion: (n,) rows of `Motions`, and `t` (n,) places on them.
    """
    direction = tangent(poses.program, poses.path, motion, t)
    to_map = np.swapaxes(_to_base(poses.program, motion, poses.frame), 1, 2)
    direction = np.einsum("nij,nj->ni", to_map, direction)
    return local_axes(direction, poses.spindle_directions(motion, t))


def _to_base(program: Program, motion: Ints, map_in_base: Array) -> Array:
    """Return the axes of the map (n, 3, 3) as columns in the `$BASE` of motions.

    :param motion: (n,) rows of `Motions`.
    :param map_in_base: (4, 4) frame of the map in the `$BASE` of the stock, see `home_base`.
    """
    base = program.motions.base[motion]
    home = program.bases[home_base(program), :3, :3]
    return np.asarray(np.swapaxes(program.bases[base, :3, :3], 1, 2) @ home @ map_in_base[:3, :3])


def _in_other_axes(rotation: Array, wrench: Array) -> Array:
    """Return wrenches (n, 6) in other axes: `rotation` (n, 3, 3) times force and times moment of `wrench` (n, 6)."""
    halves = [np.einsum("nij,nj->ni", rotation, wrench[:, half]) for half in (slice(0, 3), slice(3, 6))]
    return np.concatenate(halves, axis=1)


def _deviation_in_other_axes(rotation: Array, deviation: Array) -> Array:
    """Return standard deviations (n, 6) in other axes, see `_in_other_axes`: components are taken for independent.

    :param deviation: (n, 6) standard deviations of the components in the present axes [N, N·m].
    """
    return np.asarray(np.sqrt(_in_other_axes(rotation * rotation, deviation * deviation)))


_SAME_FORCE = 2e-3
"""Forces that differ by less [N, N·m] count as equal: the file has three decimals."""
_PARALLEL_COSINE = 1.0 - 1e-6
"""Cosine of the angle between a move and the spindle above which the move is along it."""
_COMMENT = re.compile(r"\([^)]*\)|;.*")
_CALL = re.compile(r"M[ \t]*0*98(?![\d.])|CALL", re.IGNORECASE)
_ADVICE = "Omit the CSV: `convert --process process.toml` and `predict --process` give each move its own force."

_Profile = tuple[Array, Array, Ints]
"""Places on a move (k,), wrenches with standard deviations (k, 12) and their frames (k,)."""


def one_move_a_line(program: Program, path: Segments, axis: str, knots: Knots) -> Knots:
    """Return the knots of one representative move for each line, as a force CSV needs them.

    All cutting moves of a line must have the same force along them. A line makes several moves if it is executed
    several times, or if it calls a routine of another file. For a drilling cycle, the hole or peck with the largest
    force represents all of them.

    :param path: geometry of the motions.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :raises ForceError: moves of a line have different forces; the error is for the first such line.
    """
    m = program.motions
    keep = np.ones(len(knots), dtype=np.bool_)
    cutting = np.flatnonzero(~m.rapid)
    cutting = cutting[np.argsort(m.line[cutting], kind="stable")]
    _, begin, count = np.unique(m.line[cutting], return_index=True, return_counts=True)
    texts = program.documents[0].text.splitlines()
    force_square = np.einsum("ni,ni->n", knots.wrench[:, :3], knots.wrench[:, :3])
    for row in np.flatnonzero(count > 1).tolist():
        moves = cutting[begin[row] : begin[row] + count[row]]
        # rows of knots of each move; those of a move without force are none
        low, high = np.searchsorted(knots.motion, moves), np.searchsorted(knots.motion, moves, side="right")
        has_force = high > low
        if not has_force.any():
            continue
        first = _profile(knots, low[0], high[0])
        different_passes = [k for k in range(1, len(moves)) if not _are_equal(first, _profile(knots, low[k], high[k]))]
        largest = int(np.argmax(has_force))
        if different_passes:
            text = texts[int(m.line[moves[0]]) - 1]
            if not _is_cycle(program, path, "XYZ".index(axis[1]), moves, text):
                raise _profile_conflict(program, moves[[0, different_passes[0]]], len(moves), text)
            largest = int(np.argmax([force_square[a:b].max(initial=-1.0) for a, b in zip(low, high, strict=True)]))
        for k in np.flatnonzero(has_force).tolist():
            keep[low[k] : high[k]] = k == largest
    return knots.take(keep)


def _profile(knots: Knots, low: int, high: int) -> _Profile:
    """Return places on a move (k,), wrenches with standard deviations (k, 12) and their frames (k,).

    One wrench of zero if the rows from `low` to `high` of the knots, those of the move, are none.

    The place is NaN if one wrench holds for the whole move.
    """
    if low == high:
        return np.zeros(1), np.zeros((1, 12)), np.zeros(1, dtype=np.int64)
    rows = slice(low, high)
    t = np.where(knots.ramped[rows], np.nan, knots.t[rows])
    return t, np.hstack([knots.wrench[rows], knots.sigma[rows]]), knots.frame[rows]


def _are_equal(first: _Profile, second: _Profile) -> bool:
    """Return whether the forces along two moves, linear between their places, are equal within `_SAME_FORCE`."""
    (t, values, frame), (t_, values_, frame_) = first, second
    if np.abs(values).max() <= _SAME_FORCE and np.abs(values_).max() <= _SAME_FORCE:
        return True
    if frame[0] != frame_[0] or np.isnan(t[0]) != np.isnan(t_[0]):
        return False
    if np.isnan(t[0]):
        return bool(np.abs(values[0] - values_[0]).max() <= _SAME_FORCE)
    places = np.union1d(t, t_)
    differences = [np.interp(places, t, a) - np.interp(places, t_, b) for a, b in zip(values.T, values_.T, strict=True)]
    return bool(np.abs(differences).max() <= _SAME_FORCE)


def _is_cycle(program: Program, path: Segments, column: int, moves: Ints, text: str) -> bool:
    """Return whether a line is a drilling cycle: consecutive rapid moves and cuts along the spindle, without a call.

    :param column: of the tool frame that is along the spindle.
    :param moves: (k,) cutting motions of the line; `text` of the line.
    """
    m = program.motions
    if program.keeps_text or _CALL.search(_COMMENT.sub("", text)):
        return False
    rows = np.flatnonzero(m.line == m.line[moves[0]])
    if len(rows) != rows[-1] - rows[0] + 1 or not m.rapid[rows].any():
        return False
    cosine = np.einsum("ni,ni->n", tangent(program, path, moves, np.ones(len(moves))), m.target[moves, :3, column])
    return bool(((m.kind[moves] == LIN) & (np.abs(cosine) > _PARALLEL_COSINE)).all())


def _profile_conflict(program: Program, rows: Ints, count: int, text: str) -> ForceError:
    """Return the error for the `count` cutting motions of one line whose forces differ; `rows` (2,): two of them."""
    line, file = int(program.motions.line[rows[0]]), program.documents[0].name
    places = program.places(rows)
    place_texts = [f"{name}:{number}" for name, number in map(places.of, range(2)) if (name, number) != (file, line)]
    place_text = f" ({', '.join(place_texts)} …)" if place_texts else ""
    problem = (
        f"the {count} cutting moves of this line{place_text} have different forces: a force CSV has one for all of them"
    )
    return ForceError(problem, file=file, line=line, text=text, advice=_ADVICE)
