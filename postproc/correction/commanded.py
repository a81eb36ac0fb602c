"""What the controller is told at each sample of a path, and what the tool does without correction."""

from __future__ import annotations

import numpy as np

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.compensation import Compensation
from postproc.errors import Issue, NotConvergedError
from postproc.frames import Array
from postproc.program import Bools, Ints
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
            found = path.setting.compensate(path.pose_in_root[row], q[places], path.tool(row), path.wrench_in_root[row])
        except NotConvergedError as cause:
            raise NotConvergedError(str(cause), places[list(cause.rows)]) from None
        q[places], theta[places] = found.q, found.theta
        pose[places] = toolpath.pose_in_base(path.program, path.sample.motion[row], found.pose)
        return q, pose, theta

    try:
        return Compensation(*in_chunks(in_chunk, np.arange(len(path)), movable))
    except NotConvergedError as cause:
        raise _no_balance(path, cause) from None


def uncorrected(path: PathUnderLoad, rows: Ints, theta: Array) -> tuple[Array, Array]:
    """Return what the tool would do at samples (n,) if nothing were corrected.

    :param theta: (N, nv) deflections of the springs, about.
    :returns: the tip seen from nominal (n, 3), and its displacement by the wrench alone (n, 3), `$BASE` [m].
    :raises ImpossiblePathError: there is no equilibrium somewhere.
    """

    def in_chunk(row: Ints) -> tuple[Array, Array]:
        q, wrench = path.joints.q[row], path.wrench_in_root[row]
        tip = path.tip_in_base(row, q, wrench, theta[row])
        deviation = tip - path.sample.pose[row, :3, 3]
        if path.setting.rest_is_nominal:
            return deviation, deviation
        return deviation, tip - path.tip_in_base(row, q, np.zeros_like(wrench), theta[row])

    try:
        deviation, deflection = in_chunks(in_chunk, rows)
    except NotConvergedError as cause:
        raise _no_balance(path, NotConvergedError(str(cause), rows[list(cause.rows)])) from None
    return deviation, deflection


def _no_balance(path: PathUnderLoad, cause: NotConvergedError) -> ImpossiblePathError:
    """Return an error that names the first of the motions concerned and counts them."""
    motion = path.sample.motion[list(cause.rows)]
    line = int(path.program.motions.line[motion.min()])
    return ImpossiblePathError(
        Issue("error", "not-converged", _NO_BALANCE, source_line=line, count=len(np.unique(motion)))
    )
