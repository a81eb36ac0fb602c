"""Commanded joint angles and poses at each sample of a path, and the deviation of the tool without correction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from postproc import toolpath
from postproc.chunks import in_chunks
from postproc.elastostatics import Compensation
from postproc.errors import NotConvergedError
from postproc.frames import Array
from postproc.program import Ints
from postproc.under_load import ImpossiblePathError, PathUnderLoad

_NO_BALANCE = "no loaded equilibrium: the pose is singular or the load too large. Move the part or check the forces."


def as_programmed(path: PathUnderLoad) -> Compensation:
    """Return the uncorrected commands of the program; poses in `$BASE`."""
    return Compensation(path.joints.q, path.sample.pose, np.zeros((len(path), path.setting.robot.actual.nv)))


def corrected(path: PathUnderLoad) -> Compensation:
    """Return the corrected commands of all samples; poses in `$BASE`. Axis targets are not corrected.

    :raises ImpossiblePathError: a sample has no loaded equilibrium.
    """
    movable = np.flatnonzero(np.isnan(path.program.motions.joints[path.sample.motion, 0]))

    def in_chunk(row: Ints) -> tuple[Array, Array, Array]:
        pose, q, tool = path.pose_in_root(row), path.joints.q.take(row, axis=0), path.tool(row)
        found = path.setting.compensate(pose, q, tool, path.wrench_in_root(row))
        motion, t = path.sample.motion[row], path.sample.t[row]
        return found.q, toolpath.pose_in_base(path.program, motion, found.pose, t), found.theta

    found = _balanced(path, in_chunk, movable)
    if len(movable) < len(path):
        unchanged = as_programmed(path)
        whole = unchanged.q.copy(), unchanged.pose.copy(), unchanged.theta
        for array, part in zip(whole, found, strict=True):
            array[movable] = part
        found = whole
    return Compensation(*found)


def uncorrected(path: PathUnderLoad, rows: Ints, theta: Array) -> tuple[Array, ...]:
    """Return the deviation and displacement of the tool at samples (n,) without correction, `$BASE` [m].

    :param theta: (N, nv) approximate deflections of the springs: start values.
    :returns: (n, 3) deviation of the tip from nominal; (n, 3) its displacement by the wrench alone; (n, 3) of that,
        the deflection of holder, spindle and tool.
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
    """Return the results of a function of samples (n,), in chunks; the error lists all motions without equilibrium."""
    try:
        return in_chunks(function, rows)
    except NotConvergedError as cause:
        motion = path.sample.motion[rows[list(cause.rows)]]
        raise ImpossiblePathError(path.program.motions.issue("error", "not-converged", _NO_BALANCE, motion)) from None
