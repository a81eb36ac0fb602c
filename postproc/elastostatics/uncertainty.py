"""How far the predicted deflection may be off, from the covariance of the identified parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from postproc import kinematics
from postproc.chunks import in_chunks
from postproc.elastostatics.balance import asked, beside
from postproc.elastostatics.springs import A2, coordinates, fading, spring_deflection
from postproc.errors import ModelError
from postproc.frames import M_PER_MM, Array
from postproc.robot import RobotModel

_JOINT_PARAMETERS = ("k1", "k2", "k3", "k4", "k5", "k6")


def position_bound(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array | None:
    """Return the 95 % bound (N,) [m] on the error of the predicted deflection of the TCP, or None.

    From `RobotModel.covariance` and the sensitivity of the TCP to each identified parameter, at first order. The length
    of a normal vector with covariance Σ is bounded by its first two moments: |e|² ~ g·χ²_h with g = tr Σ²/tr Σ,
    h = tr² Σ/tr Σ² (Satterthwaite 1946), and the quantile of χ² by Wilson and Hilferty (1931), good to 1.5 %.

    :param q: (N, 6) joint angles [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises ModelError: the covariance names a parameter that the model does not have.
    """
    if robot.covariance is None:
        return None
    covariance = np.array(robot.covariance.matrix, dtype=float)

    def bound(q: Array, tool: Array, wrench: Array) -> tuple[Array]:
        s = sensitivity(robot, q, tool, wrench)
        spread = s @ covariance @ np.swapaxes(s, 1, 2)
        trace = np.trace(spread, axis1=1, axis2=2)
        square = np.sum(spread**2, axis=(1, 2))
        h = np.divide(trace**2, square, out=np.ones_like(trace), where=square > 0.0)
        g = np.divide(square, trace, out=np.zeros_like(trace), where=trace > 0.0)
        return (np.sqrt(g * h * (1.0 - 2.0 / (9.0 * h) + 1.6448536 * np.sqrt(2.0 / (9.0 * h))) ** 3),)

    return in_chunks(bound, q, np.broadcast_to(tool, (len(q), 4, 4)), wrench)[0]


def sensitivity(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return (N, 3, P) ∂(position of the TCP)/∂(parameter), in m per unit of the file, at first order in the load.

    Parameters by name, in the order of `robot.covariance`: ``k1``…``k6`` [µrad/(N·m)], ``k1@800`` the part of k1 that
    fades beyond 800 N·m, ``K_c`` [N/m], ``s_0`` [mm], ``A2.RX`` the springs of links [µm/N, µrad/(N·m)].
    """
    names = robot.covariance.parameters if robot.covariance is not None else []
    x = coordinates(robot, q)
    _, jacobian = kinematics.tcp(robot.loaded, x, tool)
    torque = np.einsum("nij,ni->nj", jacobian, wrench)
    second = robot.actuated[A2]
    law_of_gears = robot.stiffening
    at_rest = np.zeros_like(torque)
    if law_of_gears is not None and (law_of_gears.carries_weight or not robot.subtract_reference):
        at_rest = -asked(robot, x.T, kinematics.posture(robot.actual, x.T, weigh=robot.has_weight)).T
    _, slope = spring_deflection(robot, torque, at_rest)
    share = beside(robot, x.T, slope.T)
    torque[:, second] /= share  # what is left for the gear
    theta, slope = spring_deflection(robot, torque, at_rest)
    reach = jacobian[:, :3].copy()
    reach[:, :, second] /= share[:, None]
    link_rows = dict(zip((f"{s.link}.{s.axis}" for s in robot.link_springs), robot.passive, strict=True))
    columns = []
    for name in names:
        joint, _, limit = name.partition("@")
        if name in ("K_c", "s_0") and robot.compensator is not None:
            law = robot.compensator
            unit = replace(law, stiffness=1.0)
            factor = unit.stiffness_about_joint(x[:, second])
            if name == "s_0":
                longer = replace(law, free_length=law.free_length + M_PER_MM)
                factor = longer.stiffness_about_joint(x[:, second]) - law.stiffness_about_joint(x[:, second])
            columns.append(reach[:, :, second] * (-slope[:, second] * theta[:, second] * factor)[:, None])
        elif name in link_rows:
            columns.append(1e-6 * reach[:, :, link_rows[name]] * torque[:, link_rows[name], None])
        elif joint in _JOINT_PARAMETERS:
            row = robot.actuated[_JOINT_PARAMETERS.index(joint)]
            amount = torque[:, row]
            if limit:
                u0 = at_rest[:, row] / float(limit)
                amount = float(limit) * (fading(amount / float(limit) + u0) - fading(u0)) - amount
            columns.append(1e-6 * reach[:, :, row] * amount[:, None])
        else:
            raise ModelError(f"[covariance] names {name!r}, which the model does not have")
    return np.stack(columns, axis=2) if columns else np.zeros((len(q), 3, 0))
