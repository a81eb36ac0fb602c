"""What the controller is told at each sample of a path, and what the tool does without correction."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.compensation import Compensation
from postproc.errors import Issue, NotConvergedError
from postproc.frames import Array
from postproc.program import Bools, Ints, distinct
from postproc.under_load import ImpossiblePathError, PathUnderLoad

_NO_BALANCE = "no command holds the tool here under this force: singular pose, or a force beyond the springs."


def as_it_stands(path: PathUnderLoad) -> Compensation:
    """Return the commands of the program as it is; poses in `$BASE`."""
    return Compensation(path.joints.q, path.sample.pose, np.zeros((len(path), path.setting.robot.actual.nv)))


def corrected(path: PathUnderLoad) -> Compensation:
    """Return the corrected commands of all samples but axis targets, which are left as they stand; poses in `$BASE`.

    :raises ImpossiblePathError: some sample cannot be held.
    """
    movable = np.isnan(path.program.motions.joints[path.sample.motion, 0])

    def in_chunk(row: Ints, movable: Bools) -> tuple[Array, Array, Array]:
        q, pose = path.joints.q[row], path.sample.pose[row]
        theta = np.zeros((len(row), path.setting.robot.actual.nv))
        places = np.flatnonzero(movable)
        row = row[places]
        try:
            found = path.setting.compensate(path.pose_in_root(row), q[places], path.tool(row), path.wrench_in_root(row))
        except NotConvergedError as cause:
            raise NotConvergedError(str(cause), places[list(cause.rows)]) from None
        q[places], theta[places] = found.q, found.theta
        pose[places] = toolpath.pose_in_base(path.program, path.sample.motion[row], found.pose, path.sample.t[row])
        return q, pose, theta

    try:
        return Compensation(*in_chunks(in_chunk, np.arange(len(path)), movable))
    except NotConvergedError as cause:
        raise _no_balance(path, cause) from None


class Uncorrected(Struct, frozen=True, eq=False):
    """What the tool would do at n samples if nothing were corrected, `$BASE` [m].

    :param deviation: (n, 3) the tip seen from nominal.
    :param deflection: (n, 3) its displacement by the wrench alone.
    :param by_tool: (n, 3) of that, how far holder, spindle and tool give way.
    """

    deviation: Array
    deflection: Array
    by_tool: Array

    def take(self, rows: Ints) -> Uncorrected:
        """Return some of the samples."""
        return Uncorrected(self.deviation[rows], self.deflection[rows], self.by_tool[rows])


def uncorrected(path: PathUnderLoad, rows: Ints, theta: Array) -> Uncorrected:
    """Return what the tool would do at samples (n,) if nothing were corrected.

    :param theta: (N, nv) deflections of the springs, about.
    :raises ImpossiblePathError: there is no equilibrium somewhere.
    """

    def in_chunk(row: Ints) -> tuple[Array, Array, Array]:
        q, wrench = path.joints.q[row], path.wrench_in_root(row)
        tip, by_tool = path.tip_in_base(row, q, wrench, theta[row])
        deviation = tip - path.sample.pose[row, :3, 3]
        if path.setting.rest_is_nominal:
            return deviation, deviation, by_tool
        rest, _ = path.tip_in_base(row, q, np.zeros_like(wrench), theta[row])
        return deviation, tip - rest, by_tool

    try:
        return Uncorrected(*in_chunks(in_chunk, rows))
    except NotConvergedError as cause:
        raise _no_balance(path, NotConvergedError(str(cause), rows[list(cause.rows)])) from None


def _no_balance(path: PathUnderLoad, cause: NotConvergedError) -> ImpossiblePathError:
    """Return an error that names the first of the motions concerned and counts them."""
    motion = path.sample.motion[list(cause.rows)]
    line = path.program.motions.line[distinct(motion)]
    lines = tuple(distinct(line).tolist())
    return ImpossiblePathError(
        Issue("error", "not-converged", _NO_BALANCE, source_line=int(line[0]), count=len(line), lines=lines)
    )
