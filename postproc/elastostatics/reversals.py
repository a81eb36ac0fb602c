"""Reversals: a joint's torque changes its direction, the gear takes up its lost motion, and the tool steps.

A gear with lost motion or backlash ±b is on one flank or the other. The model has it at b·tanh(v), v = torque/T
(`robot.Backlash`). Near the change of sign its flank depends on friction and on the torque before: with the probability
(1 + tanh v)/2 of the upper flank, the mean is b·tanh(v) and the variance b²·(1 − tanh² v).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from msgspec import Struct

from postproc.chunks import Columns
from postproc.elastostatics.balance import Balance, in_chunks_of_states, undeflected_balance
from postproc.frames import Array, norm
from postproc.program import Bools, Ints
from postproc.robot import Backlash, RobotModel

_NO_DIRECTION = 0.01
"""A torque below this share of the joint's largest one along the path counts as zero: the gear is between its flanks,
the two sides of its teeth."""
_NO_TORQUE = 1e-3
"""So does a torque below this [N·m] (assumed)."""


class Reversals(Columns, frozen=True, eq=False):
    """M changes of the direction of a joint's torque, in the order of the path.

    :param row: (M,) first place with the new direction.
    :param previous_row: (M,) last place with the old direction; places between have hardly any torque.
    :param joint: (M,) 0…5.
    :param step: (M,) step of the tool as the gear moves from one flank to the other [m]; 0 where the model states no
        lost motion.
    """

    row: Ints
    previous_row: Ints
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
    tools = np.broadcast_to(tool, (len(q), 4, 4))
    signals = _signals(robot)
    torque = in_chunks_of_states(partial(_torques, robot, signals), q, tools, wrench)
    parts = []
    for signal, signal_torque in zip(signals, torque.T, strict=True):
        largest = float(np.abs(signal_torque).max(initial=0.0))
        previous_row, row = _sign_changes(signal_torque, max(signal.threshold, _NO_DIRECTION * largest))
        step = np.zeros(len(row))
        if signal.half_play > 0.0:
            state = undeflected_balance(robot, q[row], tools[row], wrench[row])
            lever = np.moveaxis(state.jacobian[:3, robot.actuated[signal.joint]], 0, -1)
            step = 2.0 * signal.half_play * norm(lever)
        parts.append(Reversals(row, previous_row, np.full(len(row), signal.joint), step))
    order = np.argsort(np.concatenate([part.row for part in parts]), kind="stable")
    return Reversals.join(parts, order)


class _Signal(Struct, frozen=True):
    """A torque whose change of sign is a reversal.

    :param joint: 0…5 on which it is.
    :param term: backlash or lost motion that it moves; None if the model states none of the joint.
    :param half_play: b of the term [rad]; 0 without one.
    :param threshold: torques of at most this size have no direction [N·m].
    """

    joint: int
    term: Backlash | None = None
    half_play: float = 0.0
    threshold: float = _NO_TORQUE


def _signals(robot: RobotModel) -> list[_Signal]:
    """Return the torques to watch: of joints without backlash or lost motion, then one for each such term."""
    terms = _backlash_terms(robot)
    modelled_joints = [robot.actuated.index(robot.row(term)) for term, _ in terms]
    signals = [_Signal(joint) for joint in range(6) if joint not in modelled_joints]
    return signals + [
        _Signal(joint, term, half_play, term.torque)
        for joint, (term, half_play) in zip(modelled_joints, terms, strict=True)
    ]


def _torques(robot: RobotModel, signals: Sequence[_Signal], q: Array, tool: Array, wrench: Array) -> Array:
    """Return the torques (n, k) [N·m] of k signals at n places; parameters as of `reversals`."""
    state = undeflected_balance(robot, q, tool, wrench)
    # the torque without the static torque that is balanced at rest
    joint_torque = np.broadcast_to(state.torque - state.rest_torque, state.torque.shape)
    return np.stack(
        [
            joint_torque[robot.actuated[signal.joint]] if signal.term is None else _moving_torque(state, signal.term)
            for signal in signals
        ],
        axis=1,
    )


def flank_covariance(robot: RobotModel, q: Array, tool: Array, wrench: Array, changes_flank: Bools) -> Array:
    """Return the covariance (n, 3, 3) [m²] of the tool's position due to the unknown flanks of the gears, root axes.

    :param q: (n, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (n, 4, 4) tool in the flange frame [m].
    :param wrench: (n, 6) at the TCP, root axes [N, N·m].
    :param changes_flank: (n, 6) True for gears that change their flank next to a place: they may be on either there.
    """
    covariance = np.zeros((len(q), 3, 3))
    terms = _backlash_terms(robot)
    if not terms:
        return covariance
    state = undeflected_balance(robot, q, tool, wrench)
    for parameter, value in terms:
        row = robot.row(parameter)
        variance_share = 1.0 - np.tanh(_moving_torque(state, parameter) / parameter.torque) ** 2
        variance_share[changes_flank[:, robot.actuated.index(row)]] = 1.0
        lever = state.jacobian[:3, row]
        covariance += np.einsum("n,in,jn->nij", value**2 * variance_share, lever, lever)
    return covariance


def _backlash_terms(robot: RobotModel) -> list[tuple[Backlash, float]]:
    """Return the backlash and lost-motion terms of a model with their values b > 0 [rad]: the gear is at +b or −b."""
    return [(parameter, value) for parameter, value in robot.terms if isinstance(parameter, Backlash) and value > 0.0]


def _moving_torque(state: Balance, parameter: Backlash) -> Array:
    """Return the torque (n,) that moves a gear from one flank to the other [N·m]; of lost motion, that of the load."""
    row = state.robot.row(parameter)
    if not parameter.with_rest_torque:
        return np.asarray(state.load_part[row])
    return np.asarray(state.torque[row] + np.broadcast_to(state.preload, state.torque.shape)[row])


def _sign_changes(torque: Array, threshold: float) -> tuple[Ints, Ints]:
    """Return the rows (m,) before and after each change of sign of a torque (N,).

    Rows with a torque of at most `threshold` [N·m] have no sign and are skipped.
    """
    signed_rows = np.flatnonzero(np.abs(torque) > threshold)
    changes = np.flatnonzero(np.diff(np.sign(torque[signed_rows])) != 0.0)
    return signed_rows[changes], signed_rows[changes + 1]
