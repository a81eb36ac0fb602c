"""The places of a path that a page shows: all targets, or of very many those that matter, the worst among them."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.correction import Result
from postproc.forces.feed import across
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, largest, norm, xyzabc_from_pose
from postproc.program import CIRC, PTP, WRENCH, Bools, Ints, distinct
from postproc.report.deviation.drawn import drawn_path
from postproc.report.kit import Columns
from postproc.robot import JOINTS

MOST = 40_000
"""So many places a page holds at most; of more, each run of targets keeps its first and its worst."""
_MOST_POINTS = 80_000
_SINGULAR_AT = 1_000
"""At so many places at most the Jacobian is decomposed; between them its smallest singular value is interpolated."""


class Places(Struct, frozen=True, eq=False):
    """The places of a page. Row i of `columns` is place i.

    :param row: (P,) row of the result that each place is.
    :param travelled: (K,) length of the path up to each target of the result [m].
    :param seconds: (K,) time up to there, without accelerations [s].
    :param columns: what is known of each place; millimetres, degrees, newtons.
    :param drawn: points of the nominal path for the view in space: X, Y, Z [mm] and the place that each leads to.
    """

    row: Ints
    travelled: Array
    seconds: Array
    columns: Columns
    drawn: Columns

    def of(self, row: int) -> int:
        """Return the place that is this row of the result, or the first one after it."""
        return min(int(np.searchsorted(self.row, row)), len(self.row) - 1)


def correction(result: Result) -> Array:
    """Return commanded minus nominal positions (K, 3) [m], `$BASE`, as printed."""
    return np.asarray(result.printed[:, :3] / MM_PER_M - result.nominal[:, :3, 3])


def kept(result: Result) -> Ints:
    """Return the rows (P,) that a page shows, in order: of each run of targets the first, and the largest deviation
    before and after, correction, force, bound; and the reversals that are listed. Thinning hides no worst place.
    """
    count = len(result)
    if count <= MOST:
        return np.arange(count)
    measures = [result.before, result.after, norm(correction(result)), norm(result.wrench[:, :3])]
    if result.bound is not None:
        measures.append(result.bound)
    turned = [] if result.reversals is None else [result.reversals.row[result.largest_reversals]]
    runs = MOST // (len(measures) + 1)
    begin = distinct(np.linspace(0, count, runs, endpoint=False).astype(np.int64))
    run = np.repeat(np.arange(len(begin)), np.diff(begin, append=count))
    rows = [begin, np.array([count - 1]), *turned]
    for measure in measures:
        value = np.nan_to_num(measure, nan=np.inf)
        largest = np.maximum.reduceat(value, begin)
        at = np.flatnonzero(value == largest[run])
        rows.append(at[np.concatenate([[True], np.diff(run[at]) != 0])])
    return distinct(np.concatenate(rows))


def places(result: Result) -> Places:
    """Return the places of a result that has some."""
    m, motion = result.program.motions, result.motion
    position, leads_to = drawn_path(result)
    step = np.zeros(len(leads_to))
    step[1:] = norm(np.diff(position, axis=0))
    last = np.flatnonzero(np.diff(leads_to, append=len(result)))
    travelled = np.cumsum(step)[last]
    seconds = np.cumsum(_durations(result, np.diff(travelled, prepend=0.0)))
    row = kept(result)
    moved, at = correction(result)[row] * MM_PER_M, xyzabc_from_pose(result.nominal[row])
    axes = _feed_axes(result, row)
    columns: dict[str, Array | Ints | Bools] = {
        "source_line": result.source_line[row],
        "output_line": result.output_line[row],
        "base": m.base[motion[row]],
        "tool": m.tool[motion[row]],
        "t": result.t[row],
        "length": travelled[row] * MM_PER_M,
        "time": seconds[row],
        "speed": m.feed[motion[row]] * MM_PER_M,
        "before": norm(result.deviation_before[row]) * MM_PER_M,
        "after": norm(result.deviation_after[row]) * MM_PER_M,
        "u95": (np.full(len(row), np.nan) if result.bound is None else result.bound[row]) * MM_PER_M,
        "correction": norm(moved),
        "force": norm(result.wrench[row, :3]),
        "singular": _singular_values(result, row),
        "rapid": result.rapid[row],
    }
    for name, values in (("X", at), ("cX", moved), ("F", result.wrench[row]), ("q", result.q[row] * DEG_PER_RAD)):
        for index in range(values.shape[1]):
            columns[_NAMES[name][index]] = values[:, index]
    for name, vector in (("b", result.deviation_before[row]), ("a", result.deviation_after[row])):
        along = np.einsum("nij,ni->nj", axes, vector)
        for index, axis in enumerate("XYZ"):
            columns[f"{name}{axis}"] = vector[:, index] * MM_PER_M
        for index, axis in enumerate(("along", "across", "normal")):
            columns[f"{name}_{axis}"] = along[:, index] * MM_PER_M
    return Places(row, travelled, seconds, Columns.of(columns), _drawn(result, position, leads_to, row))


_NAMES = {
    "X": ("X", "Y", "Z", "A", "B", "C"),
    "cX": ("cX", "cY", "cZ"),
    "F": WRENCH,
    "q": JOINTS,
}


def _drawn(result: Result, position: Array, leads_to: Ints, row: Ints) -> Columns:
    """Return the points of the nominal path, each with the place that it leads to."""
    show = np.isin(leads_to, row)
    if np.count_nonzero(show) > _MOST_POINTS:
        show = np.zeros(len(leads_to), dtype=bool)
        show[np.flatnonzero(np.diff(leads_to, append=len(result)))[row]] = True
    point = position[show] * MM_PER_M
    return Columns.of(
        {"x": point[:, 0], "y": point[:, 1], "z": point[:, 2], "place": np.searchsorted(row, leads_to[show])}
    )


def _durations(result: Result, length: Array) -> Array:
    """Return seconds (K,) that each target takes: at the feed, or with the slowest joint at its full speed."""
    feed = result.program.motions.feed[result.motion]
    turned = np.zeros((len(result), 6))
    turned[1:] = np.abs(np.diff(result.q, axis=0))
    joints = largest(turned / result.robot.speed)
    fed = (result.program.motions.kind[result.motion] != PTP) & (feed > 0.0)
    return np.where(fed, length / np.where(fed, feed, 1.0), joints)


def _feed_axes(result: Result, row: Ints) -> Array:
    """Return the axes (P, 3, 3) along, across and normal to the feed as columns in `$BASE`; NaN along the spindle."""
    m, end = result.program.motions, result.nominal[:, :3, 3]
    motion, before = result.motion[row], np.maximum(row - 1, 0)
    travel = end[row] - end[before]
    arcs = np.flatnonzero(m.kind[motion] == CIRC)
    spoke = end[row[arcs]] - m.centre[motion[arcs]]
    turning = np.cross(m.normal[motion[arcs]], spoke)
    rise = np.einsum("ni,ni->n", travel[arcs], m.normal[motion[arcs]])[:, None] * m.normal[motion[arcs]]
    same = (result.motion[before[arcs]] == motion[arcs]) & (row[arcs] > 0)
    turned = m.sweep[motion[arcs]] * (result.t[row[arcs]] - np.where(same, result.t[before[arcs]], 0.0))
    travel[arcs] = turning + rise / np.where(turned > 0.0, turned, 1.0)[:, None]
    axes, meant = across(result.nominal[row, :3, :3], travel, result.axis)
    meant &= m.base[motion] == m.base[result.motion[before]]
    axes[~meant] = np.nan
    return axes


def _singular_values(result: Result, row: Ints) -> Array:
    """Return the smallest singular value (P,) of the tool's Jacobian, metres and radians per radian."""
    some = distinct(np.linspace(0, len(row) - 1, min(len(row), _SINGULAR_AT)).astype(np.int64))
    tool = result.program.tools[result.program.motions.tool[result.motion[row[some]]]]
    values = kinematics.singular_values(result.robot, result.q[row[some]], tool)
    return np.interp(np.arange(len(row)), some, values)
