"""Result of processing one program: the data of all reports and files."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr

from postproc.chunks import Runs
from postproc.correction.collisions import SmallestClearance
from postproc.elastostatics import Reversals
from postproc.errors import Issue
from postproc.forces import Knots
from postproc.frames import MM_PER_M, Array, norm
from postproc.placement import Turn
from postproc.poses import Poses
from postproc.program import Bools, Document, Ints, Program
from postproc.robot import RobotModel

Mode = Literal["convert", "nominal", "predict"]
_MOST_REVERSALS = 20
"""Largest number of reversals listed."""


class ExpectedErrors(Struct, frozen=True, eq=False):
    """Expected errors on the part (95 %) without and with correction, see `elastostatics.expected_error`.

    Both count the rounding of corners by approximate positioning beyond that of the KRL input. With correction, what
    the path between the targets leaves beyond the targets counts too.

    :param before: (K,) if nothing is corrected [m]; 0 on rapid moves.
    :param after: (K,) with correction [m]: of the program as written; of a prediction, as it would be written; of a
        nominal program, with an exact correction. 0 on rapid moves.
    :param chance: that correction lowers the RMS error over the cutting path; None if it changes nothing.
    :param with_known_robot: largest of `after` if the errors of the forces were the only ones [m].
    :param with_known_forces: largest of `after` if the forces were certain [m].
    """

    before: Array
    after: Array
    chance: float | None
    with_known_robot: float
    with_known_forces: float


class HeldFeed(Struct, frozen=True, eq=False):
    """Feeds of M motions, lowered so that the expected error on the part stays within its tolerance.

    :param tolerance: of the part, 95 % [m].
    :param least: smallest feed that was allowed [m/s].
    :param unheld: feed of motions that hold the tolerance at none: that of the "program", or the "lowest".
    :param programmed_feed: (M,) feed as programmed, and feed: (M,) as written [m/s]; NaN for joint motions.
    :param length: (M,) length of the path [m].
    :param expected: (M,) largest expected error at the written feed [m]; 0 on rapid moves.
    :param without_feed: (M,) the same as the feed tends to zero: by edge forces, and by what does not depend on the
        force [m]; NaN on motions that hold the tolerance or could not be slowed.
    """

    tolerance: float
    least: float
    unheld: Literal["program", "lowest"]
    programmed_feed: Array
    feed: Array
    length: Array
    expected: Array
    without_feed: Array

    @property
    def is_lowered(self) -> Bools:
        """(M,) True where the written feed is below the programmed one."""
        return np.asarray(self.feed < self.programmed_feed)

    @property
    def is_exceeded(self) -> Bools:
        """(M,) True where the tolerance is exceeded at the written feed."""
        return np.asarray(self.expected > self.tolerance)


class Result(Struct, frozen=True, eq=False):
    """Result of one program. Row i of every array is the same Cartesian target; SI units, `$BASE` axes.

    The defaults are those of a program that could not be computed at all, which has no targets.

    :param program: the program as read.
    :param robot: the robot model.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param mode: corrected ("convert"), written without correction ("nominal"), or predicted only ("predict").
    :param written_dialect: name of the dialect of the written program; of a prediction, that in which `process` would
        write it.
    :param issues: errors, warnings and information for the user, grouped.
    :param documents: files to write, the main one first; empty if there is an error, or nothing to write.
    :param motion: (K,) row of `program.motions`.
    :param t: (K,) place on that motion, in (0, 1].
    :param cut_length: (K,) length of the cutting path for which the target stands [m], see `toolpath.cut_lengths`; 0 on
        rapid moves.
    :param output_line: (K,) line of the written program (of the input for "predict").
    :param nominal: K nominal poses of the tool frame.
    :param printed: (K, 6) X, Y, Z, A, B, C of the command as printed in the written text: mm and degrees.
    :param wrench: (K, 6) force and moment used; an array becomes `Runs`.
    :param deflection: (K, 3) displacement of the tool tip that the wrench causes at the uncorrected target [m].
    :param deflection_by_tool: (K, 3) share of holder, spindle and tool in `deflection` [m]; None if they are rigid.
    :param deviation_before: (K, 3) predicted tip minus nominal position if nothing is corrected [m].
    :param deviation_after: (K, 3) the same with the program as written [m].
    :param bound: (K,) 95 % bound of the predicted position from the model's covariance [m], or None.
    :param errors: expected errors on the part without and with correction, or None.
    :param q: (K, 6) commanded joint angles [rad].
    :param joint_margin: (6,) smallest distance of each joint to a limit along the path [rad].
    :param singular_value: smallest singular value of the Jacobian along the path.
    :param path_deviation: largest predicted distance from the nominal path, between targets too [m].
    :param rounding: (K,) how far approximate positioning (C_DIS) passes each target, as written [m].
    :param programmed_rounding: (K,) the same of the program as read; zero where it is G-code.
    :param file_forces: forces that a CSV file must give to the written program, along the piece to the target that
        `motion` names; None where its comments do, or nothing is written.
    :param largest_correction: largest distance between commanded and nominal position [m].
    :param reversals: where joints change the direction of their torque on cutting moves; None if nothing was computed.
    :param causes: causes of deviation from nominal without correction, in words.
    :param clearance: smallest clearance of arm, tool and obstacles; None if the cell has no [collision].
    :param is_stock_known: True if the stock that the tool cuts is known, and rapid moves through it are found.
    :param exact_forces: True if no force states a standard deviation.
    :param held_feed: feeds that were lowered for the tolerance of the part; None: feeds are those of the program.
    :param turn: the turn of the tool about its axis, if it was chosen.
    :param redundancy_deg: turn that the cell states for all of a program; None if the program states orientations.
    :param modules: row of the first target of each of `documents`, if they are modules; empty if not.
    :param engagement_result: of a prediction with the forces of the deflected tool: that with the forces of the nominal
        engagement, by which a correction is made.
    """

    program: Program
    robot: RobotModel
    axis: str
    mode: Mode
    written_dialect: str
    issues: tuple[Issue, ...]
    documents: tuple[Document, ...] = ()
    motion: Ints = np.zeros(0, dtype=np.int64)
    t: Array = np.zeros(0)
    cut_length: Array = np.zeros(0)
    output_line: Ints = np.zeros(0, dtype=np.int64)
    nominal: Poses = Poses(np.zeros((0, 3)), np.zeros((0, 3, 3)))
    printed: Array = np.zeros((0, 6))
    wrench: Runs = Runs.of(np.zeros((0, 6)))
    deflection: Array = np.zeros((0, 3))
    deflection_by_tool: Array | None = None
    deviation_before: Array = np.zeros((0, 3))
    deviation_after: Array = np.zeros((0, 3))
    bound: Array | None = None
    errors: ExpectedErrors | None = None
    q: Array = np.zeros((0, 6))
    joint_margin: Array = np.full(6, np.nan)
    singular_value: float = np.nan
    path_deviation: float = np.nan
    rounding: Array = np.zeros(0)
    programmed_rounding: Array = np.zeros(0)
    file_forces: Knots | None = None
    largest_correction: float = np.nan
    reversals: Reversals | None = None
    causes: tuple[str, ...] = ()
    clearance: SmallestClearance | None = None
    is_stock_known: bool = False
    exact_forces: bool = False
    held_feed: HeldFeed | None = None
    turn: Turn | None = None
    redundancy_deg: float | None = None
    modules: tuple[int, ...] = ()
    engagement_result: Result | None = None

    def __post_init__(self) -> None:
        force_setattr(self, "wrench", Runs.of(self.wrench))

    def __len__(self) -> int:
        return len(self.motion)

    def __repr__(self) -> str:
        """Return program, robot and largest deviations: arrays are too long to show."""
        words = ", ".join(f"{name} {value}" for name, value in self._figures())
        return f"<Result of {self.program.name} on {self.robot.name}: {words}>"

    def _repr_html_(self) -> str:
        """Return the key figures of the correction as an HTML table, for notebooks; `postproc.page` is the report."""
        title = escape(f"{self.program.name} on {self.robot.title or self.robot.name}")
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in self._figures())
        return f"<table><caption>{title}</caption>{rows}</table>"

    def _figures(self) -> Iterator[tuple[str, str]]:
        """Yield name and value of what sums a result up; mm."""
        yield "targets", f"{len(self)}"
        if self.failed:
            yield "errors", f"{sum(issue.level == 'error' for issue in self.issues)}"
        if len(self) and not self.rapid.all():
            uncorrected = statistics(self.before, self.cut_length)
            yield "before", f"{uncorrected.largest * MM_PER_M:.2g} mm (RMS {uncorrected.rms * MM_PER_M:.2g})"
            if self.mode != "predict":
                prediction = statistics(self.after, self.cut_length)
                yield "after", f"{prediction.largest * MM_PER_M:.2g} mm (RMS {prediction.rms * MM_PER_M:.2g})"
            if self.bound is not None:
                yield "on the part (95 %)", f"{float(self.bound[~self.rapid].max()) * MM_PER_M:.2g} mm"

    @property
    def failed(self) -> bool:
        """True if the program has an issue of level error."""
        return any(issue.level == "error" for issue in self.issues)

    @property
    def source_line(self) -> Ints:
        """(K,) line of the input program."""
        return np.asarray(self.program.motions.line[self.motion])

    @property
    def rapid(self) -> Bools:
        """(K,) True for moves without cutting force."""
        return np.asarray(self.program.motions.rapid[self.motion])

    @property
    def force(self) -> Array:
        """(K,) size of the force used [N]."""
        return np.asarray(norm(self.wrench.values[:, :3])[self.wrench.run])

    @property
    def before(self) -> Array:
        """(K,) distance of the predicted tip from nominal if nothing is corrected [m]."""
        return norm(self.deviation_before)

    @property
    def after(self) -> Array:
        """(K,) distance of the predicted tip from nominal with the program as written [m]."""
        return norm(self.deviation_after)

    @property
    def expected(self) -> Array | None:
        """(K,) expected error on the part (95 %) by the program as it is [m]; None without covariance."""
        if self.errors is None:
            return None
        return self.errors.after if self.mode == "convert" else self.errors.before

    @property
    def largest_reversals(self) -> Ints:
        """Rows of `reversals` (n,), largest steps first: the largest of each joint and source line; twenty at most."""
        if self.reversals is None:
            return np.zeros(0, dtype=np.int64)
        rows_by_size = np.argsort(-self.reversals.step, kind="stable")
        line_and_joint = np.stack([self.source_line[self.reversals.row], self.reversals.joint], axis=1)
        # the first of equal rows is the largest step of its joint and line
        _, first_ranks = np.unique(line_and_joint[rows_by_size], axis=0, return_index=True)
        return rows_by_size[np.sort(first_ranks)[:_MOST_REVERSALS]]

    @property
    def inserted(self) -> int:
        """Number of targets that the program as read did not have."""
        return int(np.count_nonzero(self.t < 1.0))


class Statistics(Struct, frozen=True):
    """Distances of the predicted tip from nominal along the cutting path [m]; `p95` is not exceeded on 95 % of it."""

    largest: float
    rms: float
    mean: float
    p95: float


_LEAST_SHARE = 1e-12
"""Share of a sum of lengths or areas by which rounding may change it."""


def statistics(distance: Array, cut_length: Array) -> Statistics:
    """Return statistics along the cutting path; all zero for a program that cuts nothing.

    :param distance: (K,) at targets [m].
    :param cut_length: (K,) length of the cutting path for which each of them stands [m]; those with 0 do not count.
    """
    is_cut = cut_length > 0.0
    if not is_cut.any():
        return Statistics(0.0, 0.0, 0.0, 0.0)
    cut_distance, length = distance[is_cut], cut_length[is_cut]
    total = float(length.sum())
    return Statistics(
        largest=float(cut_distance.max()),
        rms=float(np.sqrt(length @ cut_distance**2 / total)),
        mean=float(length @ cut_distance / total),
        p95=weighted_quantile(cut_distance, length, 0.95),
    )


def weighted_quantile(values: Array, weights: Array, share: float) -> float:
    """Return the smallest value that is not exceeded on a share of the weights.

    :param values: (n,), at least one.
    :param weights: (n,) such as lengths or areas, not all zero.
    :param share: in (0, 1].
    """
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(sums, share * sums[-1] * (1.0 - _LEAST_SHARE))]])


def share_beyond(distance: Array, limit: float, cut_length: Array) -> float:
    """Return the share of the length of the cutting path on which a distance exceeds a limit, in [0, 1].

    :param distance: (K,) at targets, in the unit of the limit.
    :param cut_length: (K,) length of the cutting path for which each of them stands [m]; 0 if there is none.
    """
    is_beyond = distance > limit
    # two sums: where all is beyond, the share is 1 without rounding
    beyond, within = float(cut_length[is_beyond].sum()), float(cut_length[~is_beyond].sum())
    return beyond / (beyond + within) if beyond > 0.0 else 0.0
