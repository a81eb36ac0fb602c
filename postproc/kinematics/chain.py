"""Forward kinematics and its derivatives for N configurations at once, by Pinocchio.

Jacobians are those of (TCP position, rotation) in root axes: Pinocchio's LOCAL_WORLD_ALIGNED. They are made from the
WORLD Jacobian, which Pinocchio returns in one call, by moving its reference point to the TCP.

Most of the time of a call is the way from Python into Pinocchio and back. Many configurations are therefore evaluated
on a model that holds several arms side by side: one call for as many configurations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from postproc.frames import Array, hat
from postproc.robot import FLANGE

_COORDINATES = 24
"""Coordinates of all arms side by side; of more, Pinocchio's data, which grow with the cube, are slow to set up."""
_MANY = 64
"""Configurations from which on it pays to build them."""


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
    arms = _Arms.of(model, len(q))
    rows = arms.rows(q)
    out = np.zeros(rows.shape)
    if arms.weight > 0.0:
        centre, data, height = pin.jacobianCenterOfMass, arms.data, arms.data.Jcom[2]
        for coordinates, its_height in zip(rows, out, strict=True):
            centre(arms.model, data, coordinates, False)
            its_height[...] = height
    return out.reshape(-1, model.nv)[: len(q)] * arms.weight


def _evaluate(model: pin.Model, q: Array, tool: Array, *, weigh: bool) -> tuple[Array, Array, Array]:
    arms = _Arms.of(model, len(q))
    rows = arms.rows(q)
    transposed, heights = np.empty((*rows.shape, 6)), np.zeros(rows.shape)
    last = np.empty((len(rows), arms.count, 4, 3))
    # views of Pinocchio's own memory: copying from them costs half of what its return values cost
    columns, ends, height = arms.data.J.T, arms.ends(model), arms.data.Jcom[2]
    weigh = weigh and arms.weight > 0.0
    compute, centre = pin.computeJointJacobians, pin.jacobianCenterOfMass
    for coordinates, its_columns, its_last, its_height in zip(rows, transposed, last, heights, strict=True):
        if weigh:  # the Jacobian of the centre of mass leaves the joint Jacobian behind; its z row times weight is ∇U_g
            centre(arms.model, arms.data, coordinates, False)
            its_height[...] = height
        else:
            compute(arms.model, arms.data, coordinates)
        its_columns[...] = columns
        its_last[...] = ends
    end = np.zeros((len(q), 4, 4))
    end[:, :3] = np.swapaxes(last.reshape(-1, 4, 3)[: len(q)], 1, 2)
    end[:, 3, 3] = 1.0
    flange = model.frames[model.getFrameId(FLANGE)].placement.homogeneous
    pose = end @ (flange @ tool)
    transposed = transposed.reshape(-1, model.nv, 6)[: len(q)]
    transposed[..., :3] += transposed[..., 3:] @ hat(pose[:, :3, 3])  # v − p × ω
    return pose, np.swapaxes(transposed, 1, 2), heights.reshape(-1, model.nv)[: len(q)] * arms.weight


@dataclass(frozen=True, slots=True, eq=False)
class _Arms:
    """`count` arms alike, side by side in one model."""

    count: int
    model: pin.Model
    data: pin.Data
    weight: float
    """Of all links of all arms [N]."""

    @classmethod
    def of(cls, model: pin.Model, rows: int) -> _Arms:
        """Return the arms on which to evaluate a number of configurations of one arm."""
        count = max(1, _COORDINATES // model.nv) if rows >= _MANY else 1
        many = model if count == 1 else _side_by_side(model, count)
        weight = -many.gravity.linear[2] * sum(inertia.mass for inertia in list(many.inertias)[1:])
        return cls(count, many, many.createData(), float(weight))

    def rows(self, q: Array) -> Array:
        """Return configurations (N, nv) as those of all arms (⌈N/count⌉, count·nv); the last row is filled up."""
        calls = -(-len(q) // self.count)
        return np.resize(np.asarray(q, dtype=float), (calls, self.model.nv))

    def ends(self, model: pin.Model) -> Array:
        """Return a view (count, 4, 3) of the last link of each arm in `data`: columns of rotation, then position."""
        last = model.frames[model.getFrameId(FLANGE)].parentJoint
        places = [self.data.oMi[last + arm * (model.njoints - 1)] for arm in range(self.count)]
        rotation = places[0].rotation
        begins = [place.rotation.__array_interface__["data"][0] for place in places]
        position = places[0].translation.__array_interface__["data"][0]
        size = begins[-1] - begins[-2] if self.count > 1 else 0
        # a C++ vector of rotations, by columns, each followed by its position
        if np.diff(begins).tolist() != [size] * (self.count - 1) or position - begins[0] != rotation.nbytes:
            raise RuntimeError("this version of Pinocchio stores poses in another way: install the version asked for")
        return as_strided(rotation.T, (self.count, 4, 3), (size, *rotation.T.strides), writeable=False)


def _side_by_side(model: pin.Model, count: int) -> pin.Model:
    """Return a model of `count` arms, each with the coordinates, masses and gravity of the given one."""
    many = pin.Model()
    many.gravity = model.gravity
    for arm in range(count):
        shift = arm * (model.njoints - 1)
        for joint in range(1, model.njoints):
            parent = model.parents[joint]
            name = f"{model.names[joint]} {arm}"
            placement = model.jointPlacements[joint]
            many.addJoint(parent + shift if parent else 0, model.joints[joint], placement, name)
            many.appendBodyToJoint(joint + shift, model.inertias[joint], pin.SE3.Identity())
    return many


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
