"""Where gears turn over: a joint changes the direction of its torque and takes up its lost motion, the tool steps.

A gear with lost motion or backlash ±b lies on one flank or on the other. The model puts it at b·tanh(v), v = torque/T
(`robot.Backlash`). Which flank it is on near the change of sign depends on friction and on what was before: with the
probability (1 + tanh v)/2 for the upper flank the mean is b·tanh(v), and the variance b²·(1 − tanh² v).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.chunks import in_chunks
from postproc.elastostatics.balance import Balance, held
from postproc.elastostatics.springs import spread
from postproc.frames import Array, norm
from postproc.program import Bools, Ints
from postproc.robot import Backlash, RobotModel

_NO_DIRECTION = 0.01
"""A torque below this share of the joint's largest one along the path has no direction: the joint is between flanks."""
_NO_TORQUE = 1e-3
"""Nor has a torque below this [N·m]."""


class Reversals(Struct, frozen=True, eq=False):
    """M changes of the direction of a joint's torque, in the order of the path.

    :param row: (M,) the first place at which the torque has its new direction.
    :param before: (M,) the last place at which it had the old one.
    :param joint: (M,) 0…5.
    :param step: (M,) distance by which the tool steps as the gear goes from one flank to the other [m]; 0 where the
        model states no lost motion.
    """

    row: Ints
    before: Ints
    joint: Ints
    step: Array


def reversals(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Reversals:
    """Return where the joints change the direction of their torque along a path of N places.

    The torque is all that acts on the gear: load, payload, weights of the links and compensator. Where the model states
    backlash or lost motion, it is the torque that turns that over in the model: for lost motion, of the load alone.

    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    """
    terms = _flanks(robot)

    def in_chunk(q: Array, tool: Array, wrench: Array) -> tuple[Array, Array, Array]:
        state = _state(robot, q, tool, wrench)
        joints = list(robot.actuated)
        total = np.broadcast_to(state.torque - state.held, state.torque.shape)[joints].T
        stated = np.stack([_turning(state, parameter) for parameter, _ in terms], axis=1) if terms else total[:, :0]
        lever = norm(np.moveaxis(state.jacobian[:3, joints], 0, -1))  # (6, n)
        return total, stated, lever.T

    total, stated, lever = in_chunks(in_chunk, q, np.broadcast_to(tool, (len(q), 4, 4)), wrench)
    rows, before, joints, steps = [], [], [], []
    known = [robot.actuated.index(parameter.row(robot)) for parameter, _ in terms]
    signals = [(joint, total[:, joint], 0.0, _NO_TORQUE) for joint in range(6) if joint not in known]
    for joint, torque, (parameter, value) in zip(known, stated.T, terms, strict=True):
        signals.append((joint, torque, value, parameter.torque))
    for joint, torque, value, least in signals:
        first, second = _changes(torque, max(least, _NO_DIRECTION * float(np.abs(torque).max(initial=0.0))))
        rows.append(second)
        before.append(first)
        joints.append(np.full(len(second), joint))
        steps.append(2.0 * value * lever[second, joint])
    row = np.concatenate(rows)
    order = np.argsort(row, kind="stable")
    return Reversals(row[order], *(np.concatenate(column)[order] for column in (before, joints, steps)))


def flank_covariance(robot: RobotModel, q: Array, tool: Array, wrench: Array, turning: Bools) -> Array:
    """Return the covariance (n, 3, 3) [m²] of the tool's position by not knowing on which flank the gears lie.

    :param turning: (n, 6) the gear turns over next to this place: it may lie on either flank.
    """
    out = np.zeros((len(q), 3, 3))
    terms = _flanks(robot)
    if not terms:
        return out
    state = _state(robot, q, tool, wrench)
    for parameter, value in terms:
        row = parameter.row(robot)
        share = 1.0 - np.tanh(_turning(state, parameter) / parameter.torque) ** 2
        share[turning[:, robot.actuated.index(row)]] = 1.0
        reach = state.jacobian[:3, row]
        out += np.einsum("n,in,jn->nij", value**2 * share, reach, reach)
    return out


def _flanks(robot: RobotModel) -> list[tuple[Backlash, float]]:
    return [(parameter, value) for parameter, value in robot.terms if isinstance(parameter, Backlash) and value > 0.0]


def _state(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Balance:
    x = spread(robot, q.T)
    return Balance.at(robot, x, held(robot, x), kinematics.components(tool), wrench.T)


def _turning(state: Balance, parameter: Backlash) -> Array:
    """Return the torque (n,) that turns a gear over [N·m]."""
    row = parameter.row(state.robot)
    if not parameter.feels_rest:
        return np.asarray(state.by_load[row])
    return np.asarray(state.torque[row] + np.broadcast_to(state.at_rest, state.torque.shape)[row])


def _changes(torque: Array, least: float) -> tuple[Ints, Ints]:
    """Return the places before and after each change of sign of a torque (N,), those below `least` passed over."""
    places = np.flatnonzero(np.abs(torque) > least)
    changed = np.flatnonzero(np.diff(np.sign(torque[places])) != 0.0)
    return places[changed], places[changed + 1]
