"""Predicted displacements of the reference points and their derivatives by the parameters.

The prediction is the equilibrium of `elastostatics.deflect`, so that nothing is linearised in the load (Eq. (8) alone
is off by 0.2–0.3 % at 2.7 kN). The derivatives are those of the equilibrium θ = c(τ(θ); p), c being the compliance law:

    ∂t/∂p = J (I − C_t H)⁻¹ ∂c/∂p        with C_t = ∂c/∂τ, H = ∂τ/∂θ (load, weights, compensator)
"""

from __future__ import annotations

import numpy as np

from postproc import elastostatics, kinematics
from postproc.errors import NotConvergedError
from postproc.frames import Array
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement
from postproc.identification.structure import Structure
from postproc.program import Ints
from postproc.robot import RobotModel


def predict(structure: Structure, values: Array, data: Measurements, placement: Placement) -> tuple[Array, Array]:
    """Return displacements of the points (L, P, 3) [m] in root axes and their derivatives (L, P, 3, p).

    :raises NotConvergedError: the springs have no equilibrium under a load; the message names it.
    """
    config = data.state_config[data.loaded]
    moved = np.empty((len(config), len(data.points), 3))
    slopes = np.zeros((*moved.shape, len(structure.parameters)))
    level = np.full(len(config), -1) if structure.levels is None else structure.levels[config]
    for value in np.unique(level):
        rows = np.flatnonzero(level == value)
        at = None if structure.levels is None else int(value)
        active = structure.active(at)
        try:
            moved[rows], of_active = _predict(
                structure, structure.robot(values, at), active, data.loaded[rows], data, placement
            )
        except NotConvergedError as error:
            state = int(data.loaded[rows[error.rows[0]]])
            raise NotConvergedError(
                f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}: {error}", error.rows
            ) from None
        for column, index in enumerate(active):
            slopes[rows, ..., index] = of_active[..., column]
    return moved, slopes


def _predict(
    structure: Structure, robot: RobotModel, active: list[int], states: Ints, data: Measurements, placement: Placement
) -> tuple[Array, Array]:
    """Return displacements and derivatives by the active parameters of some loaded states."""
    q = data.q[data.state_config[states]]
    x0 = elastostatics.coordinates(robot, q)
    wrench = data.wrench[states]
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    lever = placement.points - data.load_point
    pose, twist = _equilibrium(structure, robot, active, q, tool, wrench)
    loaded, slopes = _of_points(pose, twist, lever)
    if robot.subtract_reference:
        rest, _ = kinematics.tcp(robot.loaded, x0, tool)
        unloaded, _ = _of_points(rest, twist, lever)
    else:  # without load the robot sags by the same springs
        rest, sag = _equilibrium(structure, robot, active, q, tool, np.zeros_like(wrench))
        unloaded, of_sag = _of_points(rest, sag, lever)
        slopes = slopes - of_sag
    return loaded - unloaded + (pose[:, :3, 3] - rest[:, :3, 3])[:, None], slopes


def _of_points(pose: Array, twist: Array, lever: Array) -> tuple[Array, Array]:
    """Return points (L, P, 3) from the load point, root axes, and how they move (L, P, 3, p) with twists (L, 6, p)."""
    points = np.einsum("lij,pj->lpi", pose[:, :3, :3], lever)
    turned = np.cross(np.swapaxes(twist[:, 3:], 1, 2)[:, None], points[:, :, None], axisa=3, axisb=3, axisc=3)
    return points, twist[:, None, :3] + turned.swapaxes(2, 3)


def _equilibrium(
    structure: Structure, robot: RobotModel, active: list[int], q: Array, tool: Array, wrench: Array
) -> tuple[Array, Array]:
    """Return the pose (L, 4, 4) of the load point under load and its derivative (L, 6, p), a twist per parameter."""
    parameters = [structure.parameters[index] for index in active]
    found, twist = elastostatics.deflection_by_parameter(robot, q, tool, wrench, parameters)
    return found.pose, twist
