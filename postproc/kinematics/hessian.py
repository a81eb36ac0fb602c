"""How the torques of a dead load and of the weights change with the configuration: what Eq. (1) and (5) need."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np

from postproc.errors import PostprocError
from postproc.frames import Array, hat
from postproc.kinematics.forward import GRAVITY
from postproc.robot import Chain


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
    if not wrench[:, 3:].any():
        return np.asarray(symmetric)
    # row j, column i < j: (ω_i × ω_j)·M = ω_i·(ω_j × M)
    by_moment = np.tril(np.swapaxes(axes @ (hat(-wrench[:, 3:]) @ angular), 1, 2), -1)
    return np.asarray(symmetric + by_moment)


def gravity_stiffness(chain: Chain, q: Array) -> Array:
    """Return ∂²U_g/∂q² (N, nv, nv) at configurations q (N, nv), by Pinocchio: how the torques of the weights change.

    :raises PostprocError: Pinocchio is not installed.
    """
    model = pinocchio_model(chain)
    data = model.createData()
    stiffness = np.empty((len(q), model.nv, model.nv))
    for row, coordinates in enumerate(np.ascontiguousarray(q, dtype=float)):
        stiffness[row] = _pinocchio().computeGeneralizedGravityDerivatives(model, data, coordinates)
    return stiffness


def require_pinocchio(robot: str) -> None:
    """Check that Pinocchio is installed, before work begins that needs it.

    :param robot: title of the robot, for the message.
    :raises PostprocError: it is not.
    """
    _pinocchio(f"{robot} has masses: how their torques change is computed by")


def _pinocchio(subject: str = "this needs") -> Any:
    """Return the module `pinocchio`.

    :param subject: what needs it, as the beginning of a sentence.
    :raises PostprocError: it is not installed.
    """
    try:
        return import_module("pinocchio")
    except ImportError as cause:
        raise PostprocError(
            f"{subject} Pinocchio, which is not installed. On Linux and macOS: pip install pin. Windows has no wheel "
            "of it: conda install -c conda-forge pinocchio, or use the Windows Subsystem for Linux (WSL). All other "
            "commands work without it."
        ) from cause


@lru_cache(maxsize=16)
def pinocchio_model(chain: Chain) -> Any:
    """Return a `pinocchio.Model` with the geometry and the masses of a chain.

    :raises PostprocError: Pinocchio is not installed.
    """
    pin = _pinocchio()
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0.0, 0.0, -GRAVITY]), np.zeros(3))
    for row in range(chain.nv):
        kind = pin.JointModelRevoluteUnaligned if chain.is_revolute[row] else pin.JointModelPrismaticUnaligned
        joint = model.addJoint(row, kind(chain.axis[row]), pin.SE3(chain.placement[row]), f"joint {row}")
        inertia = pin.Inertia(float(chain.mass[row]), chain.centre[row], np.zeros((3, 3)))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return model
