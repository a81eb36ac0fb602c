"""The forces of the motions of a program: what its sources state, and ramps where the force changes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.chunks import Runs, compact
from postproc.errors import MAX_ERRORS, ForceError, Issue, combined_error
from postproc.forces.axes import Axes, last_travel
from postproc.forces.path_forces import PathForces
from postproc.forces.precedence import combine, comment_knots, small_force_issues, unused_comment_issues
from postproc.forces.releases import released_motions, with_releases
from postproc.forces.sources import BASE, FEED, ForceSource, Knots
from postproc.frames import Array, any_column, norm
from postproc.program import SPL, Bools, Ints, Program, constant, distinct
from postproc.toolpath import Segments, at

_CONTINUOUS_SHARE = 2e-3
"""Relative change between consecutive forces below which no ramp is inserted (assumed)."""


def assign(program: Program, path: Segments, source: ForceSource | None, axis: str, ramp: float) -> PathForces:
    """Return the forces along the motions of a program, from a source and from the comments of the program.

    The source counts on the motions that it covers, comments on the others. Rapid moves have no force.

    :param path: the geometry of the motions.
    :param source: forces in addition to the comments of the program; None: the comments only.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param ramp: length over which a force builds up if it is given for a whole motion [m].
    :raises ForceError: the source cannot be used for this program; a FEED force with a component across the spindle on
        a move along the spindle, without any move across it; a force on a move from [start] of the cell.
    """
    m = program.motions
    stated_forces, issues = _stated_knots(program, path, source)
    law_forces, stock = stated_forces.law_forces, stated_forces.stock
    issues += unused_comment_issues(program)
    if law_forces is None:
        issues += small_force_issues(program, stated_forces)
    is_forceless = np.ones(len(m), dtype=np.bool_)
    is_forceless[stated_forces.motion] = False
    has_travel = ~m.rapid & (path.length > _ZERO_LENGTH)
    issues = _warning(program, np.flatnonzero(is_forceless & has_travel), "no-force", _NO_FORCE_MESSAGE) + issues
    cutting_forces = stated_forces.take(~m.rapid[stated_forces.motion])
    _check_start(program, cutting_forces)
    forceless = np.flatnonzero(is_forceless | m.rapid)
    knots = cutting_forces.with_fallback(
        Knots.throughout(forceless, np.zeros((len(forceless), 6)), np.full(len(forceless), BASE))
    )
    travel, travel_notes = _feed_travel(program, path, knots, axis)
    axes, is_released = Axes(program, path, axis, travel), released_motions(program, path, knots)
    if is_released.any():
        issues.append(m.issue("info", "force-released", _RELEASE_MESSAGE, np.flatnonzero(is_released)))
    path_forces = _forces_with_ramps(knots, axes, ramp, is_released)
    return replace(
        with_releases(path_forces, is_released, ramp),
        issues=(*issues, *travel_notes),
        law_forces=law_forces,
        stock=stock,
    )


def _stated_knots(program: Program, path: Segments, source: ForceSource | None) -> tuple[Knots, list[Issue]]:
    """Return the forces that a source and the comments of the program state, and issues about them.

    Rapid moves keep their forces here. The knots have the law forces and the stock of the source.

    :param path: the geometry of the motions.
    :param source: source of forces; None: the comments of the program only.
    :raises ForceError: the source cannot be used for this program.
    """
    if source is None:
        return comment_knots(program), []
    source_knots = source.along(program, path).check(program, source.name)
    knots, issues = combine(program, source_knots, source.name)
    has_rapid_force = any_column(source_knots.wrench != 0.0) & program.motions.rapid[source_knots.motion]
    issues += source_knots.issues
    issues += _warning(program, source_knots.motion[has_rapid_force], "force-on-rapid", _RAPID_MESSAGE)
    return replace(knots, law_forces=source_knots.law_forces, stock=source_knots.stock), issues


def _check_start(program: Program, knots: Knots) -> None:
    """Refuse forces on moves from `[start]` of the cell: the program does not define the path there.

    :raises ForceError: a knot on one of `Program.unforced` has a force.
    """
    unforced = np.isin(knots.motion, program.unforced)  # few, so that few wrenches are expanded in memory
    motions = knots.motion[unforced][any_column(knots.wrench[unforced] != 0.0)]
    if len(motions):
        advice = "Program X, Y and Z in rapid moves (G0) before cutting, or switch the force on after this move."
        raise _refusal(program, motions, "a force on a move from [start] of the cell", advice)


def _refusal(program: Program, motions: Ints, problem: str, advice: str) -> ForceError:
    """Return one error for all source lines of motions (n,), each with the same problem and advice."""
    name, lines = program.documents[0].name, distinct(program.motions.line[motions])
    lines = lines[: MAX_ERRORS + 1]  # one more than are shown, by which the message says that there are others
    return combined_error(ForceError(problem, file=name, line=line, advice=advice) for line in lines.tolist())


_ZERO_LENGTH = 1e-9
"""A move of at most this length [m] cuts nothing: its ends differ by rounding as those of a LIN to where a PTP ends."""
_NO_FORCE_MESSAGE = "cutting moves without a force: zero force is assumed"
_RELEASE_MESSAGE = (
    "the program waits here with the tool in material: nothing is fed while it waits, so a correction ends over the "
    "last force_ramp_mm before, and the tool comes to the nominal place while it waits"
)
_RAPID_MESSAGE = "rapid moves carry no force: the row is ignored"


def _warning(program: Program, motion: Ints, kind: str, message: str) -> list[Issue]:
    """Return a list with one warning for all motions (n,); an empty list without motions."""
    return [program.motions.issue("warning", kind, message, motion)] if len(motion) else []


def _forces_with_ramps(knots: Knots, axes: Axes, ramp: float, is_released: Bools) -> PathForces:
    """Return the forces from knots that cover every motion, with ramps inserted.

    A ramp needs a second knot at the start of its motion, with the values at the end of the motion before. The only
    knot of a ramped motion (one wrench for the whole motion) moves to the end of the ramp.

    :param knots: wrenches at places along motions, in order, at least one on every motion.
    :param axes: axes of the forces, with program and path.
    :param ramp: length over which a force builds up if it is given for a whole motion [m].
    :param is_released: (M,) True for motions at whose end the force ends: a ramp that follows begins without force.
    """
    motions = np.arange(len(axes.program.motions))
    first = np.searchsorted(knots.motion, np.append(motions, len(motions)))
    last = first[1:] - 1  # last knot of each motion
    start = _start_forces(knots, last, axes, is_released)
    is_ramped = knots.ramped[last]
    has_ramp = is_ramped & _has_changed_force(start, knots, last)  # an equal force needs no second knot
    ramp_knots = first[:-1][has_ramp]  # a ramped motion has one knot
    t = knots.t.copy()
    t[ramp_knots] = ramp / np.maximum(axes.path.length[has_ramp], ramp)  # a motion shorter than the ramp is all ramp
    t = np.insert(t, ramp_knots, 0.0)
    spread = None
    if start.spread is not None:
        spread = np.insert(_covariance_factors(knots.sigma), ramp_knots, start.spread[has_ramp], axis=0)
    first = first + np.concatenate([[0], np.cumsum(has_ramp)])  # after the inserted knots
    return PathForces(
        axes=axes,
        first=compact(first, np.int32),
        place=np.repeat(motions, np.diff(first)) + t,
        t=t,
        wrench=Runs.of(np.insert(knots.wrench, ramp_knots, start.wrench[has_ramp], axis=0)),
        knot_frame=compact(np.insert(knots.frame, ramp_knots, start.frame[has_ramp]), np.int8),
        spread=spread,
        factor=_factors_with_ramps(knots.factor, last, has_ramp, ramp_knots, axes.program),
        frame=compact(knots.frame[last], np.int8),
        ramped=is_ramped,
    )


class _StartForces(NamedTuple):
    """The forces at the start of each motion, before its ramp.

    :param wrench: (M, 6) [N, N·m], in the axes that `frame` names.
    :param frame: (M,) `BASE`; on a motion whose force continues the force before, the frame of the motion.
    :param spread: (M, 2, 3, 3) L of the covariances L·Lᵀ of force and moment, in the same axes; None if all are zero.
    """

    wrench: Array
    frame: Ints
    spread: Array | None


def _start_forces(knots: Knots, last: Ints, axes: Axes, is_released: Bools) -> _StartForces:
    """Return the forces with which ramps begin: those at the end of the motion before.

    Where the force of a motion continues the force before, it begins with the force of the motion: there is no ramp.

    :param last: (M,) the last knot of each motion.
    :param is_released: (M,) True for motions at whose end the force ends.
    """
    wrench, frame = knots.wrench.take(last, axis=0), knots.frame[last]
    end_wrench = np.where(is_released[:, None], 0.0, wrench) if is_released.any() else wrench
    start_wrench, start_frame = axes.wrench_at_start(end_wrench, frame), np.full(len(last), BASE)
    continuing = _continuing_motions(wrench, frame, start_wrench, axes)
    start_wrench[continuing], start_frame[continuing] = wrench[continuing], frame[continuing]
    if not knots.sigma.any():
        return _StartForces(start_wrench, start_frame, None)
    spread = _covariance_factors(knots.sigma[last])
    start_spread = axes.columns_at_start(np.where(is_released[:, None, None, None], 0.0, spread), frame)
    start_spread[continuing] = spread[continuing]
    return _StartForces(start_wrench, start_frame, start_spread)


def _has_changed_force(start: _StartForces, knots: Knots, last: Ints) -> Bools:
    """Return True for motions (M,) whose wrench, frame or standard deviation differs from that at their start.

    :param last: (M,) the last knot of each motion.
    """
    differs = any_column(start.wrench != knots.wrench.take(last, axis=0)) | (start.frame != knots.frame[last])
    if start.spread is not None:
        differs |= (start.spread != _covariance_factors(knots.sigma[last])).any(axis=(1, 2, 3))
    return np.asarray(differs)


def _covariance_factors(sigma: Array) -> Array:
    """Return L (n, 2, 3, 3) of the covariances L·Lᵀ of force and moment, from standard deviations (n, 6)."""
    return np.asarray(sigma.reshape(-1, 2, 3, 1) * np.eye(3))


def _factors_with_ramps(factor: Array, last: Ints, has_ramp: Bools, ramp_knots: Ints, program: Program) -> Array:
    """Return the standard deviations of the unknown factor of the wrench at knots, after knots are inserted for ramps.

    An inserted knot gets the value of the motion before; 0 at the start of the program.

    :param factor: (K,) values at the knots without the inserted ones, and `last` (M,) the last knot of each motion.
    :param has_ramp: (M,) True for motions with an inserted knot.
    :param ramp_knots: the knots before which they are inserted.
    """
    if not factor.any():
        return constant(0.0, len(factor) + len(ramp_knots))
    previous = program.predecessors[has_ramp]
    has_predecessor = previous >= 0
    return np.insert(factor, ramp_knots, np.where(has_predecessor, factor[last[previous]], 0.0))


def _continuing_motions(wrench: Array, frame: Ints, previous: Array, axes: Axes) -> Ints:
    """Return the motions (n,) with a force in FEED axes that continues the force before: it turns with the path.

    :param wrench: (M, 6) wrenches of the motions [N, N·m], in the axes of `frame` (M,).
    :param previous: (M, 6) wrenches at the end of the motion before, in `$BASE` axes.
    """
    rows = np.flatnonzero(frame == FEED)
    start = at(axes.program, axes.path, rows, np.zeros(len(rows)))
    start_wrench = axes.in_base_axes(wrench[rows].reshape(-1, 2, 3, 1), frame[rows], start).reshape(-1, 6)
    difference = norm(start_wrench - previous[rows])
    return rows[any_column(start_wrench != 0.0) & (difference < _CONTINUOUS_SHARE * norm(start_wrench))]


def _feed_travel(program: Program, path: Segments, knots: Knots, axis: str) -> tuple[Array, list[Issue]]:
    """Return `Axes.travel` (M, 3), and notes about it for the user; (0, 3) and no note without forces in FEED axes.

    :raises ForceError: a FEED force on a piece of a spline, or on a move along the spindle without a travel direction.
    """
    m = program.motions
    feed = knots.frame == FEED
    if not feed.any():
        return np.zeros((0, 3)), []
    spline_motions = distinct(knots.motion[feed & (m.kind[knots.motion] == SPL) & any_column(knots.wrench != 0.0)])
    if len(spline_motions):
        problem = "a FEED force on a piece of a spline, whose direction is not known"
        raise _refusal(program, spline_motions, problem, "Give its force in BASE or TOOL axes.")
    travel, needs_direction = last_travel(program, path, axis)
    # components along z, the spindle, are the same for any travel direction: those along x and y need one
    lateral = [0, 1, 3, 4]
    is_lateral = (knots.wrench[:, lateral] != 0.0) | (knots.sigma[:, lateral] != 0.0)
    has_lateral_force = np.zeros(len(m), dtype=np.bool_)
    has_lateral_force[knots.motion[feed & any_column(is_lateral)]] = True
    needs_direction &= has_lateral_force
    is_undefined = needs_direction & np.isnan(travel[:, 0])
    if is_undefined.any():
        advice = (
            "No other move of the program has a feed direction across the spindle that this one could use. "
            "Give its force in BASE or TOOL axes."
        )
        raise _refusal(program, np.flatnonzero(is_undefined), "a FEED force on a move along the spindle", advice)
    issues = []
    if needs_direction.any():
        message = (
            "a FEED force on a move along the spindle, which has no feed direction: x is the travel direction of the "
            "last move across the spindle, or of the first one if none precedes"
        )
        issues.append(m.issue("info", "feed-direction", message, np.flatnonzero(needs_direction)))
    return travel, issues
