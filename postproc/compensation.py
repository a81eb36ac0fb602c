"""Corrected poses: where the controller must aim so that the deflected tool stands at its target.

The controller turns a commanded pose into joint angles q by its nominal geometry; the tool then stands at
g_actual(q + θ(q, F)). Off-line compensation (paper, Fig. 1) looks for the pose P that makes this the target, in
position and orientation, to convergence.

Because the actual coordinates x = q + θ at the target are known from inverse kinematics of the ACTUAL geometry, the
load on each spring is known too, and with it θ (`elastostatics.springs_at`): with joint springs alone one evaluation
solves the problem. Springs between the joints move x a little; the loop then repeats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc import elastostatics, kinematics
from postproc.errors import NotConvergedError
from postproc.frames import Array, largest, twist_between
from postproc.program import Ints
from postproc.robot import RobotModel

POSITION_TOLERANCE = 1e-8
"""What may be left between actual and target position [m]; 1e-7 is asked for."""
ROTATION_TOLERANCE = 1e-9
"""What may be left between actual and target orientation [rad]; 1e-8 is asked for."""
_MAX_ITERATIONS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Compensation:
    """Corrected commands of N targets, converged.

    :param q: (N, 6) joint angles that the controller will hold [rad].
    :param pose: (N, 4, 4) commanded tool frame by the nominal geometry [m]; from `compensate` in the robot root.
    :param theta: (N, nv) deflections of the springs at the target [rad, m].
    """

    q: Array
    pose: Array
    theta: Array

    def at(self, rows: Ints) -> Compensation:
        """Return the given rows (n,)."""
        return Compensation(self.q[rows], self.pose[rows], self.theta[rows])


def uncorrected(robot: RobotModel, q: Array, tool: Array) -> Compensation:
    """Return joint angles (N, 6) as commands without any correction."""
    return Compensation(q, kinematics.tcp(robot.nominal, q, tool)[0], np.zeros((len(q), robot.actual.nv)))


def compensate(robot: RobotModel, target: Array, q_nominal: Array, tool: Array, wrench: Array) -> Compensation:
    """Find the commands under which the loaded tool stands at its targets.

    :param robot: the robot (with its payload).
    :param target: (N, 4, 4) tool frame in the robot root [m].
    :param q_nominal: (N, 6) joint angles of the uncorrected targets by the nominal geometry [rad]: they fix the branch.
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises NotConvergedError: some target cannot be held; `rows` says which.
    """
    q, theta = _solve(robot, target, q_nominal, tool, wrench)
    return Compensation(q, kinematics.tcp(robot.nominal, q, tool)[0], theta)


def _solve(robot: RobotModel, target: Array, q_nominal: Array, tool: Array, wrench: Array) -> tuple[Array, Array]:
    actuated = list(robot.actuated)
    passive = [column for column in range(robot.actual.nv) if column not in actuated]
    x = elastostatics.coordinates(robot, q_nominal)
    for _ in range(_MAX_ITERATIONS):
        pose, jacobian, weight = kinematics.tcp_and_weight(robot.loaded, x, tool)
        missed = np.abs(twist_between(pose, target))
        if missed.max(initial=0.0) > ROTATION_TOLERANCE:
            x, pose, _ = kinematics.refine(robot.loaded, x, actuated, tool, target, (pose, jacobian))
            missed = np.abs(twist_between(pose, target))
            _, jacobian, weight = kinematics.tcp_and_weight(robot.loaded, x, tool)
        theta = elastostatics.springs_at(robot, x, jacobian, wrench, weight)
        # what the coordinates between the joints still have to move displaces the tool by as much
        move = jacobian[:, :, passive] @ (theta - x)[:, passive, None]
        left = missed + np.abs(move[..., 0])
        bad = (largest(left[:, :3]) > POSITION_TOLERANCE) | (largest(left[:, 3:]) > ROTATION_TOLERANCE)
        if not bad.any():
            return (x - theta)[:, actuated], theta
        x[:, passive] = theta[:, passive]
    raise NotConvergedError("no command found that holds the target", np.flatnonzero(bad).tolist())
