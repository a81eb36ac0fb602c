"""Forward kinematics and its derivatives for N configurations at once, by Pinocchio.

Jacobians are those of (TCP position, rotation) in root axes: Pinocchio's LOCAL_WORLD_ALIGNED. They are made from the
WORLD Jacobian, which Pinocchio returns in one call, by moving its reference point to the TCP.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from postproc.frames import Array, hat
from postproc.robot import FLANGE


def tcp(model: pin.Model, q: Array, tool: Array) -> tuple[Array, Array]:
    """Return pose and Jacobian of the tool frame.

    :param model: of `RobotModel`: `nominal`, `actual` or `loaded`.
    :param q: (N, nv) coordinates [rad, m].
    :param tool: (4, 4) or (N, 4, 4) tool frame in the flange frame [m].
    :returns: pose in the root frame (N, 4, 4) [m]; Jacobian (N, 6, nv), rows: position [m], rotation [rad], root axes.
    """
    pose, jacobian, _ = _evaluate(model, q, tool, weigh=False)
    return pose, jacobian


def tcp_and_weight(model: pin.Model, q: Array, tool: Array) -> tuple[Array, Array, Array]:
    """Return pose and Jacobian of the tool frame as `tcp`, and ∇U_g (N, nv) as `gravity_torque`, in one pass."""
    return _evaluate(model, q, tool, weigh=True)


def gravity_torque(model: pin.Model, q: Array) -> Array:
    """Return ∇U_g (N, nv): torques that hold the weights of the links at configurations q (N, nv)."""
    weight, data, out = _weight(model), model.createData(), np.zeros((len(q), model.nv))
    if weight > 0.0:
        for row, coordinates in enumerate(np.ascontiguousarray(q, dtype=float)):
            out[row] = pin.jacobianCenterOfMass(model, data, coordinates, False)[2]
    return out * weight


def _evaluate(model: pin.Model, q: Array, tool: Array, *, weigh: bool) -> tuple[Array, Array, Array]:
    weight, data = _weight(model), model.createData()
    flange = model.frames[model.getFrameId(FLANGE)]
    jacobian, heights = np.empty((len(q), 6, model.nv)), np.zeros((len(q), model.nv))
    end = np.empty((len(q), 4, 4))
    for row, coordinates in enumerate(np.ascontiguousarray(q, dtype=float)):
        if weigh and weight > 0.0:  # leaves the joint Jacobian behind; the z row times weight is ∇U_g
            heights[row] = pin.jacobianCenterOfMass(model, data, coordinates, False)[2]
        else:
            pin.computeJointJacobians(model, data, coordinates)
        jacobian[row] = data.J
        end[row] = data.oMi[flange.parentJoint].homogeneous
    pose = end @ (flange.placement.homogeneous @ tool)
    jacobian[:, :3] -= hat(pose[:, :3, 3]) @ jacobian[:, 3:]  # v − p × ω
    return pose, jacobian, heights * weight


def _weight(model: pin.Model) -> float:
    """Return the weight of all links [N]."""
    return float(-model.gravity.linear[2] * sum(inertia.mass for inertia in list(model.inertias)[1:]))


def load_stiffness(jacobian: Array, wrench: Array) -> Array:
    """Return H = ∂(JᵀF)/∂q with F fixed: how a dead load stiffens or softens the chain.

    For a chain of revolute joints in LOCAL_WORLD_ALIGNED axes, column i of J being (v_i, ω_i):
    ∂v_j/∂q_i = ω_min(i,j) × v_max(i,j), and ∂ω_j/∂q_i = ω_i × ω_j for i < j, else 0 (Hourtash, "The kinematic Hessian
    and higher derivatives", 2005). The moment part is not symmetric.

    :param jacobian: (N, 6, nv) of the TCP.
    :param wrench: (N, 6) force [N] and moment [N·m] at the TCP, root axes.
    :returns: (N, nv, nv); row j, column i: ∂(JᵀF)_j/∂q_i.
    """
    linear, angular = jacobian[:, :3], jacobian[:, 3:]
    axes = np.swapaxes(angular, 1, 2)
    # (ω_i × v_j)·F = ω_i·(v_j × F), i ≤ j
    upper = np.triu(axes @ (hat(-wrench[:, :3]) @ linear))
    symmetric = upper + np.swapaxes(np.triu(upper, 1), 1, 2)
    # row j, column i < j: (ω_i × ω_j)·M = ω_i·(ω_j × M)
    if not wrench[:, 3:].any():
        return np.asarray(symmetric)
    return np.asarray(symmetric + np.tril(np.swapaxes(axes @ (hat(-wrench[:, 3:]) @ angular), 1, 2), -1))


def gravity_stiffness(model: pin.Model, q: Array) -> Array:
    """Return ∂²U_g/∂q² (N, nv, nv) at configurations q (N, nv): how the torques of the weights change."""
    data = model.createData()
    compute = pin.computeGeneralizedGravityDerivatives
    out = np.empty((len(q), model.nv, model.nv))
    for row, coordinates in enumerate(np.ascontiguousarray(q, dtype=float)):
        out[row] = compute(model, data, coordinates)
    return out
