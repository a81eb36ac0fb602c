"""A measuring device that was moved between two configurations, seen in the readings without load.

Displacements are differences within a configuration, so a step between two of them spoils the geometry alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc import elastostatics, kinematics
from postproc.frames import MM_PER_M, Array, norm
from postproc.identification.measurement_model import MIN_COMPLIANCE, Placement, unloaded_design, unloaded_flange
from postproc.identification.readings import Measurements
from postproc.robot import JOINTS, RobotModel

_FREEDOM_OF_STEP = 12
"""Fewest degrees of freedom that a step is judged by (assumed)."""
_USUAL_FRAMES = np.concatenate([np.full(6, np.inf), np.full(36, 1e-3)])
"""Standard deviations of twists of the root, which is free, and of the six joint frames [m, rad] (assumed)."""
_UNMODELLED = 2e-4
"""Standard deviation of the error that a calibrated geometry leaves of a coordinate [m] (assumed)."""
_RARE_CHANCE = 1e-4
"""Largest probability of a step at least as clear in readings of one set-up, at any configuration (assumed)."""
_RANK_TOLERANCE = 1e-6
"""Least singular value, over the largest, of a direction that the readings determine (assumed)."""
_MAX_CORRELATION = 0.5
"""Correlation of a joint angle with a step beyond which errors of the geometry look like the step."""
_MIN_MOVEMENT = 2e-4
"""Smallest movement [m] that is reported (assumed)."""


def moved_device(robot: RobotModel, data: Measurements, placement: Placement) -> list[str]:
    """Return a warning if the measuring device seems to have moved between two configurations; else none.

    Readings without load are fitted by a frame, the points, errors of the geometry (six for each joint) and the sag of
    the joints, with and without a step of the frame from a configuration on, see `_clearest_step`.
    """
    is_visible = np.abs(placement.residual).max(axis=2, keepdims=True) > 0.0  # exactly zero without a reading
    by_frames, by_sag = _frame_derivatives(robot, data, placement), _sag_derivatives(robot, data, placement)
    by_points = unloaded_design(robot, data, placement)[..., 6:]  # the first six are by the root, see by_frames
    design = np.concatenate([by_frames, by_points, by_sag], axis=3) * is_visible[..., None]
    usual_points = np.full(by_points.shape[3], np.inf)  # the points are free
    compliance = np.maximum(robot.compliance[list(robot.actuated)], MIN_COMPLIANCE)
    usual_sizes = np.concatenate([_USUAL_FRAMES, usual_points, compliance])
    step = _clearest_step(design, usual_sizes, placement.residual, data.q)
    # size of the movement in the middle of all readings
    mean_point = np.append(np.mean(placement.points, axis=0), 1.0)
    mean_position = np.mean((unloaded_flange(robot, data.q) @ mean_point)[:, :3], axis=0)
    size = float(np.linalg.norm(step.twist[:3] + np.cross(step.twist[3:], mean_position)))
    # a step was sought at every configuration: probabilities of single tests add up (Bonferroni)
    if step.chance * len(data.q) > _RARE_CHANCE or size < _MIN_MOVEMENT:
        return []
    return [
        f"from config {data.config[step.first]:g} on the measuring device seems to have moved by "
        f"{size * MM_PER_M:.1f} mm: "
        "displacements are differences within a configuration and stay right; the geometry is not. Check the tripod."
    ]


class _Step(NamedTuple):
    """A step of the measuring device.

    :param chance: probability of a step at least as clear in readings without any.
    :param first: row of the first configuration after it.
    :param twist: (6,) of the device: translation at the root [m], rotation [rad], root axes.
    """

    chance: float
    first: int
    twist: Array


def _clearest_step(design: Array, usual_sizes: Array, residual: Array, q: Array) -> _Step:
    """Return the step of the measuring device that explains most of the residuals, with its chance by the F-test.

    Source: Draper and Smith, "Applied Regression Analysis", 1998, ch. 6. Points of a configuration share the error of
    the geometry, so they count as one point. All unknowns are free if that leaves enough degrees of freedom, else
    they have their usual sizes. The chance is infinite if no step can be tested.

    :param design: (C, P, 3, n) derivatives of the readings by n unknowns; the first six are a twist of the root.
    :param usual_sizes: (n,) standard deviations of the unknowns; infinite for unknowns that are always free.
    :param residual: (C, P, 3) of the readings without load [m].
    :param q: (C, 6) joint angles [rad].
    """
    configs, points = residual.shape[:2]
    columns, errors = design.reshape(-1, design.shape[3]), residual.ravel()
    basis = _basis(columns)
    freedom = 3 * configs - basis.shape[1] - 6  # degrees of freedom after the six of the step
    if freedom < _FREEDOM_OF_STEP:
        # a pseudo-reading of zero for each error of a usual size; points count as one, so it weighs as many readings
        weight = np.diag(_UNMODELLED * np.sqrt(points) / usual_sizes)[np.isfinite(usual_sizes)]
        columns, errors = np.concatenate([columns, weight]), np.append(errors, np.zeros(len(weight)))
        basis = _basis(columns)
        freedom = 3 * configs + len(weight) - basis.shape[1] - 6
    unexplained_errors = errors - basis @ (basis.T @ errors)
    clearest = _Step(np.inf, 0, np.zeros(6))
    if freedom < _FREEDOM_OF_STEP:
        return clearest
    for first in range(2, configs - 1):  # two configurations or more on each side
        if _is_correlated_with_step(q, first):
            continue
        is_after_step = np.arange(configs) >= first
        step = np.zeros((len(errors), 6))
        step[: residual.size] = (design[..., :6] * is_after_step[:, None, None, None]).reshape(-1, 6)
        step = step - basis @ (basis.T @ step)
        twist, _, rank, _ = np.linalg.lstsq(step, unexplained_errors, rcond=_RANK_TOLERANCE)
        if rank == 6:
            explained_square = float(np.sum((step @ twist) ** 2))
            # 1e-300 keeps zero out of the denominator
            unexplained_square = max(float(np.sum(unexplained_errors**2)) - explained_square, 1e-300)
            chance = _exceedance_probability(explained_square / 6.0 * freedom / unexplained_square, freedom)
            if chance < clearest.chance:
                clearest = _Step(chance, first, np.asarray(twist))
    return clearest


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis (rows, r) of columns (rows, n), without directions that are rounding alone."""
    # 1e-12: columns of zeros stay zero
    basis, singular_values, _ = np.linalg.svd(columns / np.maximum(norm(columns.T), 1e-12), full_matrices=False)
    return np.asarray(basis[:, singular_values > _RANK_TOLERANCE * singular_values[0]])


def _exceedance_probability(ratio: float, freedom: int) -> float:
    """Return the probability that an F-distributed ratio with 6 and `freedom` degrees of freedom exceeds `ratio`."""
    from scipy.special import fdtrc  # takes long to import

    return float(fdtrc(6, freedom, ratio))


def _is_correlated_with_step(q: Array, first: int) -> bool:
    """Return whether a joint angle is correlated with a step between configurations `first` − 1 and `first`.

    Errors of the geometry that depend on this angle would look like the step.

    :param q: (C, 6) joint angles [rad].
    """
    # 1e-12: a joint that never turns is not correlated with anything
    angles = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-12)
    step = (np.arange(len(q)) >= first).astype(float)
    step = (step - step.mean()) / step.std()
    return bool(np.abs(step @ angles / len(q)).max() > _MAX_CORRELATION)


def _frame_derivatives(robot: RobotModel, data: Measurements, placement: Placement) -> Array:
    """Return the derivatives (C, P, 3, 42) of the points, device axes, by twists of the root, then of six joint frames.

    Each twist is about the origin of its frame, in the axes of the frame: translation, then rotation.
    """
    x = elastostatics.coordinates(robot, data.q)
    root_axes = placement.root_in_device[:3, :3]
    joint_frames, _ = robot.nominal.joint_frames(data.q)
    frames = [np.tile(np.eye(4), (len(x), 1, 1)), *np.swapaxes(joint_frames, 0, 1)]
    slopes = np.zeros((len(data.q), len(placement.points), 3, len(frames), 6))
    for index, point in enumerate(placement.points):
        tool = np.eye(4)
        tool[:3, 3] = point
        pose, _ = kinematics.tcp(robot.actual, x, tool)
        for number, frame in enumerate(frames):
            axes = root_axes @ frame[:, :3, :3]
            lever = (pose[:, :3, 3] - frame[:, :3, 3]) @ root_axes.T
            slopes[:, index, :, number, :3] = axes
            slopes[:, index, :, number, 3:] = np.cross(np.swapaxes(axes, 1, 2), lever[:, None]).swapaxes(1, 2)
    return slopes.reshape(*slopes.shape[:3], -1)


def _sag_derivatives(robot: RobotModel, data: Measurements, placement: Placement) -> Array:
    """Return the derivatives (C, P, 3, 6) of the points, device axes, by the compliance of each joint under gravity."""
    x = elastostatics.coordinates(robot, data.q)
    torque = elastostatics.balance.static_torque(robot, x.T).T[:, list(robot.actuated)]
    slopes = np.zeros((len(x), len(placement.points), 3, len(JOINTS)))
    for index, point in enumerate(placement.points):
        tool = np.eye(4)
        tool[:3, 3] = point
        jacobian = kinematics.tcp(robot.actual, x, tool)[1][:, :3, list(robot.actuated)]
        slopes[:, index] = placement.root_in_device[:3, :3] @ (jacobian * torque[:, None])
    return slopes
