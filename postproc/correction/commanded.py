"""What the controller is told at each sample of a path, and what the tool does without correction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.compensation import Compensation
from postproc.errors import NotConvergedError
from postproc.frames import Array
from postproc.program import Ints
from postproc.under_load import ImpossiblePathError, PathUnderLoad

_NO_BALANCE = "no command holds the tool here under this force: singular pose, or a force beyond the springs."


def as_it_stands(path: PathUnderLoad) -> Compensation:
    """Return the commands of the program as it is; poses in `$BASE`."""
    return Compensation(path.joints.q, path.sample.pose, np.zeros((len(path), path.setting.robot.actual.nv)))


def corrected(path: PathUnderLoad) -> Compensation:
    """Return the corrected commands of all samples but axis targets, which are left as they stand; poses in `$BASE`.

    :raises ImpossiblePathError: some sample cannot be held.
    """
    movable = np.flatnonzero(np.isnan(path.program.motions.joints[path.sample.motion, 0]))

    def in_chunk(row: Ints) -> tuple[Array, Array, Array]:
        pose, q, tool = path.pose_in_root(row), path.joints.q.take(row, axis=0), path.tool(row)
        found = path.setting.compensate(pose, q, tool, path.wrench_in_root(row))
        motion, t = path.sample.motion[row], path.sample.t[row]
        return found.q, toolpath.pose_in_base(path.program, motion, found.pose, t), found.theta

    found = _balanced(path, in_chunk, movable)
    if len(movable) < len(path):
        stands = as_it_stands(path)
        whole = stands.q.copy(), stands.pose.copy(), stands.theta
        for array, part in zip(whole, found, strict=True):
            array[movable] = part
        found = whole
    return Compensation(*found)


def uncorrected(path: PathUnderLoad, rows: Ints, theta: Array) -> tuple[Array, ...]:
    """Return what the tool would do at samples (n,) if nothing were corrected, `$BASE` [m].

    :param theta: (N, nv) deflections of the springs, about.
    :returns: (n, 3) deviation of the tip from nominal; (n, 3) its displacement by the wrench alone; (n, 3) of that, how
        far holder, spindle and tool give way.
    :raises ImpossiblePathError: there is no equilibrium somewhere.
    """

    def in_chunk(row: Ints) -> tuple[Array, Array, Array]:
        q, wrench = path.joints.q.take(row, axis=0), path.wrench_in_root(row)
        tip, by_tool = path.tip_in_base(row, q, wrench, theta.take(row, axis=0))
        deviation = tip - path.sample.pose[row, :3, 3]
        if path.setting.rest_is_nominal:
            return deviation, deviation, by_tool
        rest, _ = path.tip_in_base(row, q, np.zeros_like(wrench), theta[row])
        return deviation, tip - rest, by_tool

    return _balanced(path, in_chunk, rows)


def _balanced(path: PathUnderLoad, function: Callable[[Ints], tuple[Array, ...]], rows: Ints) -> tuple[Array, ...]:
    """Return what a function makes of samples (n,), in chunks; all motions where it finds no equilibrium are told."""
    try:
        return in_chunks(function, rows)
    except NotConvergedError as cause:
        motion = path.sample.motion[rows[list(cause.rows)]]
        raise ImpossiblePathError(path.program.motions.issue("error", "not-converged", _NO_BALANCE, motion)) from None
