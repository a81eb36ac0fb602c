"""Forces along motions as piecewise linear profiles, from the stations of a sweep.

Stations that such a profile does not need are omitted (`thin_out`). At the start of a motion the force changes within
half the feed per tooth (`smooth_steps`): the mean force is the mean over the tooth pitch, and after a change of
engagement the next tooth cuts the new chip. The force drops to zero at once when the tool is retracted. A force CSV has
one profile for all moves of a line (`knots_by_line`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from postproc.errors import ForceError
from postproc.forces import Knots
from postproc.forces.sources import BASE, FEED
from postproc.frames import Array, norm
from postproc.machining.tilted import local_axes
from postproc.machining.tool_path import AXIS_TOLERANCE, ToolPoses, home_base
from postproc.program import CIRC, LIN, Bools, Ints, Program, constant
from postproc.toolpath import Segments, tangent

_TOLERANCE_SHARE = 0.01
"""Tolerance between stations as a share of the largest force and of the largest moment of a motion,"""
_LEAST_TOLERANCE = 1.0, 0.1
"""but at least this [N, N·m]: one newton at 100 mm of tool. Changes at the start of a motion that are smaller than
this tolerance extend over the whole motion."""


def thin_out(motion: Ints, wrench: Array) -> NDArray[np.int64]:
    """Return the rows (K,) of stations that are needed: between them the wrench is linear to within a tolerance.

    A station is a place on a motion with its wrench.

    The first and the last station of each motion are kept. A motion with a constant wrench keeps one station. The
    tolerance is `_TOLERANCE_SHARE` of the largest force and moment of a motion, at least `_LEAST_TOLERANCE`.

    :param motion: (N,) row of `Motions`, never decreasing.
    :param wrench: (N, 6) [N, N·m].
    """
    if len(motion) == 0:
        return np.zeros(0, dtype=np.int64)
    bounds = np.flatnonzero(np.diff(motion, prepend=-1, append=-1))  # first row of each motion, and the end
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
        rows.append(begin + np.array(sorted(_needed_rows(halves[begin:end])), dtype=np.int64))
    return np.sort(np.concatenate(rows))


def _needed_rows(halves: Array) -> Iterator[int]:
    """Yield the rows that a piecewise linear profile of forces and moments needs, in no order.

    By the algorithm of Ramer (1972) and of Douglas and Peucker (1973): between two rows the one that deviates most from
    a straight line is added, until no deviation is above 1. Rows are taken as equally spaced.

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
        farthest_row = int(np.argmax(deviation))
        if deviation[farthest_row] > 1.0:
            yield begin + 1 + farthest_row
            open_ranges += [(begin, begin + 1 + farthest_row), (begin + 1 + farthest_row, end)]


class Stations(NamedTuple):
    """N places on cutting motions in order, and the wrenches at them.

    Wrenches are in FEED axes; on moves along the spindle in the axes of `tilted.local_axes`.

    :param motion: (N,) row of `Motions`, and `t` (N,) place on it in [0, 1].
    :param wrench: (N, 6) [N, N·m].
    :param deviation: (N, 6) standard deviations of the wrench that are independent from station to station.
    """

    motion: Ints
    t: Array
    wrench: Array
    deviation: Array


def smooth_steps(
    poses: ToolPoses,
    stations: Stations,
    rise: Array,
    *,
    sigma: float,
    axial_sigma: float,
    base_axes: bool,
) -> Knots:
    """Return the knots of wrenches that are continuous from motion to motion.

    At the start of a motion the force changes linearly from the force at the end of the motion before, or from zero
    after a rapid motion. At the end of the motion the force acts in full.

    :param poses: the tool on the path, in the frame of the height map of the stock.
    :param rise: (M,) length over which the force changes at the start of a motion [m].
    :param sigma: standard deviation of one unknown factor of all wrenches, as a share of them.
    :param axial_sigma: standard deviation of the axial force as a share of the force across the axis; 0 if axial
        coefficients are known.
    :param base_axes: True: return wrenches in `$BASE` axes, except where FEED axes turn along a motion. False: in FEED
        axes, except on moves along the spindle, whose wrenches are in `$BASE` axes.
    """
    first = np.flatnonzero(np.diff(stations.motion, prepend=-1))  # first station of each motion
    has_one_station = np.diff(first, append=len(stations.motion)) == 1
    motions, places, values, independent_deviation = _continuous_stations(poses, stations, first, rise)
    axial_deviation = axial_sigma * norm(values[:, :2])
    axes, is_axial = _feed_axes(poses, motions, places)
    is_in_base = _are_in_base_axes(poses, motions, is_axial, has_one_station, base_axes=base_axes)
    to_base = _map_axes_in_base(poses.program, motions[is_in_base], poses.frame) @ axes[is_in_base]
    values[is_in_base] = _rotated_wrenches(to_base, values[is_in_base])
    independent_deviation[is_in_base] = _rotated_deviations(to_base, independent_deviation[is_in_base])
    deviation = np.hypot(np.abs(values) * sigma, independent_deviation)
    # on moves along the spindle in $BASE axes: z of $BASE is taken for the axis of the tool
    deviation[:, 2] = np.hypot(deviation[:, 2], axial_deviation)
    factor = constant(sigma, len(motions))
    return Knots.along(motions, places, values, np.where(is_in_base, BASE, FEED), deviation, factor)


def _are_in_base_axes(
    poses: ToolPoses, motions: Ints, is_axial: Bools, has_one_station: Bools, *, base_axes: bool
) -> Bools:
    """Return True for knots (K,) whose wrenches `smooth_steps` returns in `$BASE` axes, False for FEED axes.

    A wrench that is linear in FEED axes is not linear in `$BASE` axes where these turn along a motion.

    :param motions: (K,) motion of each knot.
    :param is_axial: (K,) True where the travel at the knot is along the spindle.
    :param has_one_station: (k,) True for cutting motions with a constant wrench.
    :param base_axes: see `smooth_steps`.
    """
    # each motion has a run of `count` knots: what holds for the motion or for its last knot is repeated for all
    count = np.diff(np.flatnonzero(np.diff(motions, prepend=-1)), append=len(motions))
    is_constant = np.repeat(has_one_station, count)
    ends_axially = is_axial[np.repeat(np.cumsum(count) - 1, count)]
    turns_axes = (poses.program.motions.kind[motions] == CIRC) | (poses.path.turn[motions] > AXIS_TOLERANCE)
    return np.asarray((ends_axially & ~(is_constant & turns_axes)) | (~turns_axes & base_axes))


def _continuous_stations(poses: ToolPoses, stations: Stations, first: Ints, rise: Array) -> Stations:
    """Return stations between which linear wrenches are continuous from motion to motion, see `smooth_steps`.

    :param first: (k,) first station of each cutting motion.
    :param rise: (M,) length over which the force changes at the start of a motion [m].
    """
    motion, t, wrench, deviation = stations
    cut_motions = motion[first]
    length = poses.path.length[cut_motions]
    start_wrench, start_deviation = _start_wrenches(poses, first, stations)
    reach = np.minimum(1.0, rise[cut_motions] / np.maximum(length, 1e-9))  # no division by zero
    wrench_at_rise = _wrenches_at(motion, t, wrench, cut_motions, reach)
    reach[_begins_with_last_force(start_wrench, wrench_at_rise, wrench, first)] = 1.0  # no rise is needed
    row, places = _knot_places(length > rise[cut_motions], reach, first, t)
    place_motions = cut_motions[row]
    wrench_at_places = _wrenches_at(motion, t, wrench, place_motions, places)
    deviation_at_places = _wrenches_at(motion, t, deviation, place_motions, places)
    begins = np.flatnonzero(np.diff(row, prepend=-1))  # first knot of each motion
    wrench_at_places[begins], deviation_at_places[begins] = start_wrench, start_deviation
    return Stations(place_motions, places, wrench_at_places, deviation_at_places)


def _start_wrenches(poses: ToolPoses, first: Ints, stations: Stations) -> tuple[Array, Array]:
    """Return the wrenches at the starts of cutting motions, and their standard deviations, (k, 6) each, in FEED axes.

    They are the wrenches at the end of the motion before, in the axes at the start; zero after a rapid motion.

    :param first: (k,) first station of each cutting motion.
    """
    motion, _, wrench, deviation = stations
    last, cut_motions = np.append(first[1:], len(motion)) - 1, motion[first]  # last station of each motion
    end_axes = _feed_axes(poses, cut_motions, np.ones(len(cut_motions)))[0]
    end_wrench = _rotated_wrenches(end_axes, wrench[last])  # in the axes of the map
    end_deviation = _rotated_deviations(end_axes, deviation[last])
    follows = np.flatnonzero(np.diff(cut_motions, prepend=-2) == 1)  # motions directly after another cutting motion
    start_wrench, start_deviation = np.zeros((len(cut_motions), 6)), np.zeros((len(cut_motions), 6))
    start_axes = np.swapaxes(_feed_axes(poses, cut_motions[follows], np.zeros(len(follows)))[0], 1, 2)
    start_wrench[follows] = _rotated_wrenches(start_axes, end_wrench[follows - 1])
    start_deviation[follows] = _rotated_deviations(start_axes, end_deviation[follows - 1])
    return start_wrench, start_deviation


def _knot_places(is_long: Bools, reach: Array, first: Ints, t: Array) -> tuple[Ints, Array]:
    """Return m knots in order: the number (m,) of their cutting motion, 0 … k − 1, and the place (m,) on it, 0 … 1.

    Each motion has a knot at its start, one where its rise ends, its stations after that, and one at its end. A motion
    whose rise takes all of it has the first and the last only, unless it is long and begins with the force before it.

    :param is_long: (k,) True for motions longer than their rise.
    :param reach: (k,) place where the rise ends on a motion, 0 … 1; also 1 if there is no rise, because the motion
        begins with the force at the end of the motion before.
    :param first: (k,) row of the first station of each motion; `t` (n,) places of all stations.
    """
    rows = np.arange(len(first))
    count = np.diff(first, append=len(t))
    row = np.repeat(rows, count)  # number of the motion of each station
    has_rise_end = reach < 1.0
    # stations between the end of the rise and the end of the motion; 1e-9: not at the end of the rise itself
    is_inner = (t > np.where(has_rise_end, reach, 0.0)[row] + 1e-9) & (t < 1.0)
    is_inner &= ((count > 1) & (has_rise_end | is_long))[row]
    rise_rows = np.flatnonzero(has_rise_end)
    row_of_place = np.concatenate([rows, rise_rows, row[is_inner], rows])
    places = np.concatenate([np.zeros(len(rows)), reach[rise_rows], t[is_inner], np.ones(len(rows))])
    order = np.lexsort((places, row_of_place))
    return row_of_place[order], places[order]


def _begins_with_last_force(start_wrench: Array, wrench_at_rise: Array, wrench: Array, first: Ints) -> Bools:
    """Return True for cutting motions (k,) that begin with the force at the end of the motion before, within tolerance.

    :param start_wrench: (k, 6) at the end of the motion before, `wrench_at_rise` (k, 6) after the rise.
    :param wrench: (n, 6) of all stations; `first` (k,) row of the first station of each motion.
    """
    is_equal = np.ones(len(wrench_at_rise), dtype=bool)
    for half, least_tolerance in zip((slice(0, 3), slice(3, 6)), _LEAST_TOLERANCE, strict=True):  # force, moment
        tolerance = np.maximum(_TOLERANCE_SHARE * np.maximum.reduceat(norm(wrench[:, half]), first), least_tolerance)
        is_equal &= norm(wrench_at_rise[:, half] - start_wrench[:, half]) <= tolerance
    return is_equal


def _wrenches_at(motion: Ints, t: Array, wrench: Array, place_motion: Ints, places: Array) -> Array:
    """Return wrenches (k, 6) at places on motions: linear between the stations of each, constant outside of them.

    :param motion: (n,) motion of each station, `t` (n,) place on it, `wrench` (n, 6).
    :param place_motion: (k,) motion of each place, and `places` (k,) on it in [0, 1].
    """
    # motion + t / 2 is a sorted key of the stations in which the end of a motion is before the start of the next one
    next_station = np.searchsorted(motion + 0.5 * t, place_motion + 0.5 * places)
    first_rows = np.searchsorted(motion, place_motion, side="left")
    last_rows = np.searchsorted(motion, place_motion, side="right") - 1
    next_row = np.clip(next_station, first_rows, last_rows)
    previous_row = np.clip(next_station - 1, first_rows, last_rows)
    interval = t[next_row] - t[previous_row]
    share = np.clip((places - t[previous_row]) / np.where(interval > 0.0, interval, 1.0), 0.0, 1.0)
    return np.asarray(wrench[previous_row] + share[:, None] * (wrench[next_row] - wrench[previous_row]))


def _feed_axes(poses: ToolPoses, motion: Ints, t: Array) -> tuple[Array, Bools]:
    """Return the FEED axes (n, 3, 3) at places on motions, as columns in the frame of the height map of the stock.

    x is along the travel, square to z; z is the direction from the tip to the spindle, see `local_axes`.

    :param motion: (n,) rows of `Motions`, and `t` (n,) places on them, 0 … 1.
    :returns: the axes, and True (n,) for moves along the spindle, whose travel gives no x.
    """
    travel_in_base = tangent(poses.program, poses.path, motion, t)
    base_to_map = np.swapaxes(_map_axes_in_base(poses.program, motion, poses.frame), 1, 2)
    travel_in_map = np.einsum("nij,nj->ni", base_to_map, travel_in_base)
    return local_axes(travel_in_map, poses.spindle_directions(motion, t))


def _map_axes_in_base(program: Program, motion: Ints, map_in_base: Array) -> Array:
    """Return the axes of the height map (n, 3, 3) as columns in the `$BASE` of motions.

    :param motion: (n,) rows of `Motions`.
    :param map_in_base: (4, 4) frame of the map in the `$BASE` of the stock, see `home_base`.
    """
    base = program.motions.base[motion]
    home = program.bases[home_base(program), :3, :3]
    return np.asarray(np.swapaxes(program.bases[base, :3, :3], 1, 2) @ home @ map_in_base[:3, :3])


def _rotated_wrenches(rotation: Array, wrench: Array) -> Array:
    """Return wrenches (n, 6) in other axes, about the same point.

    :param rotation: (n, 3, 3) matrices by which force and moment of `wrench` (n, 6) are multiplied.
    """
    halves = [np.einsum("nij,nj->ni", rotation, wrench[:, half]) for half in (slice(0, 3), slice(3, 6))]
    return np.concatenate(halves, axis=1)


def _rotated_deviations(rotation: Array, deviation: Array) -> Array:
    """Return standard deviations (n, 6) of wrenches in other axes; their components are taken for independent.

    :param rotation: (n, 3, 3) matrices by which vectors in the present axes are multiplied.
    :param deviation: (n, 6) standard deviations of the components in the present axes [N, N·m].
    """
    return np.asarray(np.sqrt(_rotated_wrenches(rotation * rotation, deviation * deviation)))


_SAME_FORCE = 2e-3
"""Forces that differ by less [N, N·m] count as equal: the file has three decimals."""
_PARALLEL_COSINE = 1.0 - 1e-6
"""Cosine of the angle between a move and the spindle above which the move is along it."""
_COMMENT = re.compile(r"\([^)]*\)|;.*")
_CALL = re.compile(r"M[ \t]*0*98(?![\d.])|CALL", re.IGNORECASE)
_ADVICE = "Omit the CSV: `convert --process process.toml` and `predict --process` give each move its own force."


class _Profile(NamedTuple):
    """The forces along one move, linear between k places.

    :param t: (k,) places on the move in [0, 1]; NaN if one wrench holds for the whole move.
    :param values: (k, 12) wrenches and their standard deviations [N, N·m].
    :param frame: (k,) index of the axes of each wrench.
    """

    t: Array
    values: Array
    frame: Ints


def knots_by_line(program: Program, path: Segments, axis: str, knots: Knots) -> Knots:
    """Return the knots of one representative cutting move of each line: a force CSV has one force profile for a line.

    A line makes several moves if it is executed several times, or if it calls a routine of another file: these must
    have the same force along them. For a drilling cycle, the hole or peck with the largest force represents all.

    :param path: geometry of the motions.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :raises ForceError: moves of a line have different forces; the error is for the first such line.
    """
    m = program.motions
    is_kept = np.ones(len(knots), dtype=np.bool_)
    cutting = np.flatnonzero(~m.rapid)
    cutting = cutting[np.argsort(m.line[cutting], kind="stable")]
    # cutting motions are sorted by line: `begin` is the first motion of each line, `count` the number of its motions
    _, begin, count = np.unique(m.line[cutting], return_index=True, return_counts=True)
    texts = program.documents[0].text.splitlines()
    force_square = np.einsum("ni,ni->n", knots.wrench[:, :3], knots.wrench[:, :3])
    for row in np.flatnonzero(count > 1).tolist():
        moves = cutting[begin[row] : begin[row] + count[row]]
        # rows of the knots of each move, from begin to end (exclusive); a move without force has none
        begins, ends = np.searchsorted(knots.motion, moves), np.searchsorted(knots.motion, moves, side="right")
        has_force = ends > begins
        if not has_force.any():
            continue
        profiles = [_profile(knots, first, end) for first, end in zip(begins, ends, strict=True)]
        different_moves = [k for k in range(1, len(moves)) if not _are_equal(profiles[0], profiles[k])]
        kept_move = int(np.argmax(has_force))  # the first with a force
        if different_moves:
            text = texts[int(m.line[moves[0]]) - 1]
            if not _is_drilling_cycle(program, path, "XYZ".index(axis[1]), moves, text):
                raise _profile_conflict_error(program, moves[[0, different_moves[0]]], len(moves), text)
            largest_squares = [force_square[a:b].max(initial=-1.0) for a, b in zip(begins, ends, strict=True)]
            kept_move = int(np.argmax(largest_squares))
        for k in np.flatnonzero(has_force).tolist():  # knots of the other moves are left out
            is_kept[begins[k] : ends[k]] = k == kept_move
    return knots.take(is_kept)


def _profile(knots: Knots, first: int, end: int) -> _Profile:
    """Return the forces along the move whose knots are the rows from `first` to `end` (exclusive).

    A move without knots has one wrench of zero.
    """
    if first == end:
        return _Profile(np.zeros(1), np.zeros((1, 12)), np.zeros(1, dtype=np.int64))
    rows = slice(first, end)
    t = np.where(knots.ramped[rows], np.nan, knots.t[rows])
    return _Profile(t, np.hstack([knots.wrench[rows], knots.sigma[rows]]), knots.frame[rows])


def _are_equal(first: _Profile, second: _Profile) -> bool:
    """Return whether the forces along two moves, linear between their places, are equal within `_SAME_FORCE`.

    Two moves without force are equal in any axes.
    """
    if np.abs(first.values).max() <= _SAME_FORCE and np.abs(second.values).max() <= _SAME_FORCE:
        return True
    is_constant = np.isnan(first.t[0])
    if first.frame[0] != second.frame[0] or is_constant != np.isnan(second.t[0]):
        return False
    if is_constant:
        return bool(np.abs(first.values[0] - second.values[0]).max() <= _SAME_FORCE)
    places = np.union1d(first.t, second.t)
    differences = [
        np.interp(places, first.t, first_component) - np.interp(places, second.t, second_component)
        for first_component, second_component in zip(first.values.T, second.values.T, strict=True)
    ]
    return bool(np.abs(differences).max() <= _SAME_FORCE)


def _is_drilling_cycle(program: Program, path: Segments, column: int, moves: Ints, text: str) -> bool:
    """Return whether a line is a drilling cycle: consecutive rapid moves and cuts along the spindle, without a call.

    :param column: column of the tool frame that is along the spindle: 0, 1, 2 for x, y, z.
    :param moves: (k,) cutting motions of the line; `text` of the line.
    """
    m, is_robot_program = program.motions, program.keeps_text
    if is_robot_program or _CALL.search(_COMMENT.sub("", text)):
        return False
    rows = np.flatnonzero(m.line == m.line[moves[0]])
    if len(rows) != rows[-1] - rows[0] + 1 or not m.rapid[rows].any():
        return False
    cosine = np.einsum("ni,ni->n", tangent(program, path, moves, np.ones(len(moves))), m.target[moves, :3, column])
    return bool(((m.kind[moves] == LIN) & (np.abs(cosine) > _PARALLEL_COSINE)).all())


def _profile_conflict_error(program: Program, rows: Ints, count: int, text: str) -> ForceError:
    """Return the error for the `count` cutting motions of one line whose forces differ.

    :param rows: (2,) two motions with different forces; `text` of the line.
    """
    line, file = int(program.motions.line[rows[0]]), program.documents[0].name
    places = program.places(rows)
    place_texts = [f"{name}:{number}" for name, number in map(places.of, range(2)) if (name, number) != (file, line)]
    place_text = f" ({', '.join(place_texts)} …)" if place_texts else ""
    problem = (
        f"the {count} cutting moves of this line{place_text} have different forces: a force CSV has one for all of them"
    )
    return ForceError(problem, file=file, line=line, text=text, advice=_ADVICE)
