"""Reversals: a joint's torque changes its direction, the gear takes up its lost motion, and the tool steps.

A gear with lost motion or backlash ±b is on one flank or the other. The model has it at b·tanh(v), v = torque/T
(`robot.Backlash`). Near the change of sign its flank depends on friction and on the torque before: with the probability
(1 + tanh v)/2 of the upper flank, the mean is b·tanh(v) and the variance b²·(1 − tanh² v).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.chunks import in_chunks
from postproc.elastostatics.balance import Balance, undeflected_balance
from postproc.frames import Array, norm
from postproc.program import Bools, Ints
from postproc.robot import Backlash, RobotModel

_NO_DIRECTION = 0.01
"""A torque below this share of the joint's largest one along the path counts as zero: the gear is between flanks."""
_NO_TORQUE = 1e-3
"""So does a torque below this [N·m] (assumed)."""


class Reversals(Struct, frozen=True, eq=False):
    """M changes of the direction of a joint's torque, in the order of the path.

    :param row: (M,) first place with the new direction.
    :param before: (M,) last place with the old one.
    :param joint: (M,) 0…5.
    :param step: (M,) step of the tool as the gear moves from one flank to the other [m]; 0 where the model states no
        lost motion.
    """

    row: Ints
    before: Ints
    joint: Ints
    step: Array


def reversals(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Reversals:
    """Return the changes of direction of the joints' torques along a path of N places.

    The torque is the sum of load, payload, weights of the links and compensator. Where the model states backlash or
    lost motion, it is the torque that moves it in the model: for lost motion, that of the load alone.

    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """
    terms = _flanks(robot)

    modelled_joints = [robot.actuated.index(robot.row(parameter)) for parameter, _ in terms]
    other_joints = [joint for joint in range(6) if joint not in modelled_joints]

    def torques(q: Array, tool: Array, wrench: Array) -> tuple[Array]:
        """Return the torques (n, k) [N·m] whose signs count: of joints without a term for it, then of the terms.

        :param q: (n, 6) joint angles [rad].
        :param tool: (n, 4, 4) tool in the flange frame.
        :param wrench: (n, 6) at the tool tip, robot root [N, N·m].
        """
        state = undeflected_balance(robot, q, tool, wrench)
        total = np.broadcast_to(state.torque - state.rest_torque, state.torque.shape)[
            [robot.actuated[j] for j in other_joints]
        ]
        return (np.stack([*total, *(_moving_torque(state, parameter) for parameter, _ in terms)], axis=1),)

    tools = np.broadcast_to(tool, (len(q), 4, 4))
    torque = in_chunks(torques, q, tools, wrench)[0]
    rows, earlier_rows, joints, steps = [], [], [], []
    signals = [(joint, 0.0, _NO_TORQUE) for joint in other_joints]
    signals += [
        (joint, value, parameter.torque) for joint, (parameter, value) in zip(modelled_joints, terms, strict=True)
    ]
    for joint_torque, (joint, value, threshold) in zip(torque.T, signals, strict=True):
        first, second = _changes(
            joint_torque, max(threshold, _NO_DIRECTION * float(np.abs(joint_torque).max(initial=0.0)))
        )
        rows.append(second)
        earlier_rows.append(first)
        joints.append(np.full(len(second), joint))
        steps.append(np.zeros(len(second)))
        if value > 0.0:
            state = undeflected_balance(robot, q[second], tools[second], wrench[second])
            steps[-1] = 2.0 * value * norm(np.moveaxis(state.jacobian[:3, robot.actuated[joint]], 0, -1))
    row = np.concatenate(rows)
    order = np.argsort(row, kind="stable")
    return Reversals(row[order], *(np.concatenate(column)[order] for column in (earlier_rows, joints, steps)))


def flank_covariance(robot: RobotModel, q: Array, tool: Array, wrench: Array, turning: Bools) -> Array:
    """Return the covariance (n, 3, 3) [m²] of the tool's position due to the unknown flanks of the gears.

    :param turning: (n, 6) the gear changes its flank next to this place: it may be on either.
    """
    covariance = np.zeros((len(q), 3, 3))
    terms = _flanks(robot)
    if not terms:
        return covariance
    state = undeflected_balance(robot, q, tool, wrench)
    for parameter, value in terms:
        row = robot.row(parameter)
        share = 1.0 - np.tanh(_moving_torque(state, parameter) / parameter.torque) ** 2
        share[turning[:, robot.actuated.index(row)]] = 1.0
        lever = state.jacobian[:3, row]
        covariance += np.einsum("n,in,jn->nij", value**2 * share, lever, lever)
    return covariance


def _flanks(robot: RobotModel) -> list[tuple[Backlash, float]]:
    """Return the backlash and lost-motion terms of a model with their values b > 0 [rad]: the gear is within ±b."""
    return [(parameter, value) for parameter, value in robot.terms if isinstance(parameter, Backlash) and value > 0.0]


def _moving_torque(state: Balance, parameter: Backlash) -> Array:
    """Return the torque (n,) that moves a gear from one flank to the other [N·m]."""
    row = state.robot.row(parameter)
    if not parameter.with_rest_torque:
        return np.asarray(state.load_part[row])
    return np.asarray(state.torque[row] + np.broadcast_to(state.preload, state.torque.shape)[row])


def _changes(torque: Array, threshold: float) -> tuple[Ints, Ints]:
    """Return the rows (m,) before and after each change of sign of a torque (N,).

    Rows with a torque of at most `threshold` [N·m] have no sign and are skipped.
    """
    places = np.flatnonzero(np.abs(torque) > threshold)
    sign_changes = np.flatnonzero(np.diff(np.sign(torque[places])) != 0.0)
    return places[sign_changes], places[sign_changes + 1]
