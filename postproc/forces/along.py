"""The wrench anywhere on the path of a program: what its sources give, put on its motions."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.errors import MOST, ForceError, Issue, together
from postproc.forces.axes import Axes
from postproc.forces.comments import of_comments
from postproc.forces.feed import last_travel
from postproc.forces.knots import BASE, FEED, ForceSource, Knots
from postproc.frames import Array, any_column
from postproc.program import SPL, Bools, Ints, Program, distinct
from postproc.toolpath import Segments, Toolpath

BEHIND_STEP = 1e-5
"""So far behind a step of the force [m] the path is computed: the correction follows over that length."""


class PathForces(Struct, frozen=True, eq=False):
    """The forces along the M motions of a program: K knots, each motion with one at least, linear between them.

    The knots are those of the sources. Where the force of a motion comes up over the ramp of the cell, a knot at its
    start holds the wrench at the end of the motion before, in `$BASE` axes, and its own stands at the end of the ramp.

    :param axes: what turns forces into `$BASE` axes.
    :param first: (M + 1,) the knots of motion i are those from first[i] to first[i + 1].
    :param place: (K,) row of `Motions` plus t: increasing but for the end of a motion, where the next one starts.
    :param t: (K,) place on the motion in [0, 1].
    :param wrench: (K, 6) Fx…Mz [N, N·m] on the tool at its tip, in the axes that `knot_frame` names.
    :param knot_frame: (K,) `BASE`, `TOOL` or `FEED`.
    :param spread: (K, 2, 3, 3) L of the covariances L·Lᵀ of force and moment, in the same axes; None if all are zero.
    :param frame: (M,) frame in which the force of each motion is given.
    :param ramped: (M,) True where it comes up over the ramp.
    :param before: (M, 6) wrench at the end of the motion before, in `$BASE` axes of the motion; zero before the first.
    :param issues: what the user should know, e.g. cutting moves without a force.
    """

    axes: Axes
    first: Ints
    place: Array
    t: Array
    wrench: Array
    knot_frame: Ints
    spread: Array | None
    frame: Ints
    ramped: Bools
    before: Array
    issues: tuple[Issue, ...]

    def at(self, sample: Toolpath) -> Array:
        """Return the wrench (N, 6) at samples of the path [N, N·m], `$BASE` axes of their motions."""
        return self._between(self.wrench.reshape(-1, 2, 3, 1), sample).reshape(-1, 6)

    def spread_at(self, sample: Toolpath) -> Array | None:
        """Return L (N, 2, 3, 3) of the covariances L·Lᵀ of force and moment at samples; None if all are zero."""
        return None if self.spread is None else self._between(self.spread, sample)

    def behind_step(self, motion: Ints, t: Array) -> Bools:
        """Return which places (n,) lie just behind the start of motions whose force may begin with a step."""
        return np.asarray(~self.ramped[motion] & (self.axes.path.length[motion] * t < 1.5 * BEHIND_STEP))

    def _between(self, columns: Array, sample: Toolpath) -> Array:
        """Return columns (N, 2, 3, m) of force and moment in `$BASE` axes at samples; (K, 2, 3, m) at the knots."""
        motion, t = sample.motion, sample.t
        first, last = self.first[motion], self.first[motion + 1] - 1
        right = np.clip(np.searchsorted(self.place, motion + t), first, last)
        left = np.where(self.t[right] > t, np.maximum(right - 1, first), right)
        out, frame = columns.take(right, axis=0), self.knot_frame[right]
        inner = np.flatnonzero(left != right)
        left, right = left[inner], right[inner]
        share = ((t[inner] - self.t[left]) / (self.t[right] - self.t[left]))[:, None, None, None]
        begin = columns.take(left, axis=0)
        alike = self.knot_frame[left] == frame[inner]
        same, ramp = inner[alike], inner[~alike]
        out[same] = begin[alike] + share[alike] * (out[same] - begin[alike])
        out = self.axes.into_base(out, frame, sample)
        out[ramp] = begin[~alike] + share[~alike] * (out[ramp] - begin[~alike])
        return out


def along(program: Program, path: Segments, source: ForceSource | None, axis: str, ramp: float) -> PathForces:
    """Put forces on the motions: a source wins for those that it knows, else the comments hold; rapid moves have none.

    :param path: the geometry of the motions.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param ramp: over which length a force comes up that is given for the whole of a motion [m].
    :raises ForceError: the source cannot be used for this program; a FEED force with a part across the spindle on a
        move along the spindle, before any move across it.
    """
    m = program.motions
    given, told = of_comments(program), []
    if source is not None:
        own = source.along(program, path).checked(program, source.name)
        told += list(own.issues)
        told += _told(
            program, own.motion[any_column(own.wrench != 0.0) & m.rapid[own.motion]], "force-on-rapid", _ON_RAPID
        )
        given = own.over(given)
    without = np.ones(len(m), dtype=np.bool_)
    without[given.motion] = False
    told = _told(program, np.flatnonzero(without & ~m.rapid), "no-force", _NONE) + told
    given = given.take(~m.rapid[given.motion])
    without |= m.rapid
    none = np.flatnonzero(without)
    given = given.over(Knots.throughout(none, np.zeros((len(none), 6)), np.full(len(none), BASE)))
    travel, lead = _travel(program, path, given, axis)
    return _resolved(given, Axes(program, path, axis, travel), ramp, (*told, *lead))


_NONE = "cutting moves without a force: none is assumed"
_ON_RAPID = "rapid moves carry no force: the row is ignored"


def _told(program: Program, motion: Ints, kind: str, message: str) -> list[Issue]:
    """Return a warning for motions (n,) if there are any."""
    return [program.motions.issue("warning", kind, message, motion)] if len(motion) else []


def _resolved(given: Knots, axes: Axes, ramp: float, issues: tuple[Issue, ...]) -> PathForces:
    """Return the forces of knots that every motion has, with the ramps put in."""
    motions = np.arange(len(axes.program.motions))
    first = np.searchsorted(given.motion, np.append(motions, len(motions)))
    last = first[1:] - 1
    ramped, frame = given.ramped[last], given.frame[last]
    begins = first[:-1][ramped]  # the only knot of each
    before = axes.at_start(given.wrench.take(last, axis=0).reshape(-1, 2, 3, 1), frame).reshape(-1, 6)
    spread = None
    if given.sigma.any():
        spread = given.sigma.reshape(-1, 2, 3, 1) * np.eye(3)
        spread = np.insert(spread, begins, axes.at_start(spread[last], frame)[ramped], axis=0)
    length = axes.path.length[ramped]
    t = given.t.copy()
    t[begins] = np.where(length > ramp, ramp / np.where(length > ramp, length, 1.0), 1.0)
    t = np.insert(t, begins, 0.0)
    first = first + np.concatenate([[0], np.cumsum(ramped)])
    return PathForces(
        axes,
        first,
        np.repeat(motions, np.diff(first)) + t,
        t,
        np.insert(given.wrench, begins, before[ramped], axis=0),
        np.insert(given.frame, begins, BASE),
        spread,
        frame,
        ramped,
        before,
        issues,
    )


def _travel(program: Program, path: Segments, given: Knots, axis: str) -> tuple[Array, list[Issue]]:
    """Return `Axes.travel`, and what to tell about it."""
    m = program.motions
    feed = given.frame == FEED
    if not feed.any():
        return np.zeros((0, 3)), []
    curved = np.unique(given.motion[feed & (m.kind[given.motion] == SPL) & any_column(given.wrench != 0.0)])
    if len(curved):
        name, problem = program.documents[0].name, "a FEED force on a piece of a spline, whose direction is not known"
        advice = "Give its force in BASE or TOOL axes."
        lines = np.unique(m.line[curved])[: MOST + 1].tolist()
        raise together(ForceError(problem, file=name, line=line, advice=advice) for line in lines)
    travel, needs = last_travel(program, path, axis)
    acts = np.zeros(len(m), dtype=np.bool_)
    across = (given.wrench[:, [0, 1, 3, 4]] != 0.0) | (given.sigma[:, [0, 1, 3, 4]] != 0.0)
    acts[given.motion[feed & any_column(across)]] = True
    needs &= acts
    unknown = needs & np.isnan(travel[:, 0])
    if unknown.any():
        advice = (
            "Such a move has no feed direction across the spindle, and no move from which it could be taken has one: "
            "give its force in BASE or TOOL axes."
        )
        name, problem = program.documents[0].name, "a FEED force on a move along the spindle"
        lines = distinct(m.line[unknown])[: MOST + 1].tolist()
        raise together(ForceError(problem, file=name, line=line, advice=advice) for line in lines)
    issues = []
    if needs.any():
        message = (
            "a FEED force on a move along the spindle, which has no feed direction: x is the travel direction of the "
            "last move that had one, before any such move that of the first"
        )
        issues.append(m.issue("info", "feed-direction", message, np.flatnonzero(needs)))
    return travel, issues
