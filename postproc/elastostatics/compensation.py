"""Corrected poses: the commands under which the deflected tool is at its targets.

The controller turns a commanded pose into joint angles q by its nominal geometry; the tool is then at
g_actual(q + θ(q, F)). Off-line compensation (paper, Fig. 1) finds the pose P for which this is the target, in position
and orientation, to convergence.

Because the actual coordinates x = q + θ at the target are known from inverse kinematics of the ACTUAL geometry, the
load on each spring is known too, and with it θ (`springs_at_target`). If the geometry is nominal and only joints
deflect, one evaluation solves the problem. Otherwise Newton's steps move the joints to the target, and the coordinates
of link springs to their deflections.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.elastostatics.balance import elastic_coordinates, joint_angles, static_torque
from postproc.elastostatics.equilibrium import springs_at_target
from postproc.errors import NotConvergedError
from postproc.frames import Array
from postproc.program import Bools
from postproc.robot import RobotModel

_POSITION_TOLERANCE = 1e-10
"""Largest distance between actual and target position [m]; 1e-7 is needed, and Newton's last step gives this."""
_ROTATION_TOLERANCE = 1e-11
"""Largest angle between actual and target orientation [rad]; 1e-8 is needed."""
_MAX_ITERATIONS = 30
_LARGEST_STEP = 0.2
"""Of a joint in one iteration [rad]."""


class Compensation(Struct, frozen=True, eq=False):
    """Corrected commands of N targets, converged.

    :param q: (N, 6) joint angles that the controller will hold [rad].
    :param pose: (N, 4, 4) commanded tool frame by the nominal geometry [m]; from `compensate` in the robot root.
    :param theta: (N, nv) deflections of the springs at the target [rad, m].
    """

    q: Array
    pose: Array
    theta: Array


def compensate(robot: RobotModel, target: Array, q_nominal: Array, tool: Array, wrench: Array) -> Compensation:
    """Find the commands under which the loaded tool is at its targets.

    :param robot: the robot (with its payload).
    :param target: (N, 4, 4) tool frame in the robot root [m].
    :param q_nominal: (N, 6) joint angles of the uncorrected targets by the nominal geometry [rad]: they fix the branch.
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises NotConvergedError: a target has no converged command; `rows` says which.
    """
    tools, goal, wrench = kinematics.components(tool), kinematics.components(target), np.ascontiguousarray(wrench.T)
    joints, passive = np.array(robot.actuated), np.array(robot.passive, dtype=np.int64)
    x = elastic_coordinates(robot, q_nominal.T)
    theta = np.zeros_like(x)
    for _ in range(_MAX_ITERATIONS):
        state = kinematics.posture(robot.loaded, x, tools, weigh=robot.has_weight)
        jacobian, missed = state.jacobian(), kinematics.twist_between(state.pose, goal)
        left = np.abs(missed)
        # without link springs the deflection matters at the target only
        if len(passive) or not _beyond(left).any():
            load = np.einsum("ikn,in->kn", jacobian, wrench)
            theta = springs_at_target(robot, x, load, static_torque(robot, x, state))
            between = np.einsum("ikn,kn->in", jacobian[:, passive], (theta - x)[passive])
            left, missed = left + np.abs(between), missed - between
        rows = np.flatnonzero(_beyond(left))
        if len(rows) == 0:
            q = joint_angles(robot, x - theta)
            pose = kinematics.posture(robot.nominal, q, tools).pose
            return Compensation(q.T, kinematics.matrices(pose), theta.T)
        step = _newton(jacobian[:, joints][..., rows], missed[:, rows])
        x[np.ix_(joints, rows)] += np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        x[np.ix_(passive, rows)] = theta[np.ix_(passive, rows)]
    raise NotConvergedError("no loaded equilibrium at the target: pose singular or load too large", rows.tolist())


def _beyond(left: Array) -> Bools:
    """Return where twists (6, n) exceed the tolerances."""
    return np.asarray(~((left[:3].max(axis=0) <= _POSITION_TOLERANCE) & (left[3:].max(axis=0) <= _ROTATION_TOLERANCE)))


def _newton(jacobian: Array, twist: Array) -> Array:
    """Return the step (6, n) of the joints that moves the tool by a twist (6, n); not finite where it is singular."""
    square = np.moveaxis(jacobian, -1, 0)
    good = np.linalg.det(square) != 0.0
    out = np.full(twist.shape, np.nan)
    out[:, good] = np.linalg.solve(square[good], twist.T[good, :, None])[..., 0].T
    return out
