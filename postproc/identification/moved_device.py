"""A measuring device that was moved between two configurations, seen in the readings without load.

Displacements are differences within a configuration, so a step between two of them spoils the geometry alone.
"""

from __future__ import annotations

import numpy as np

from postproc import elastostatics, kinematics
from postproc.frames import MM_PER_M, Array, norm, rotation_from_vector
from postproc.identification.measurement_model import Placement, unloaded_flange
from postproc.identification.readings import Measurements
from postproc.robot import JOINTS, RobotModel

_SPARE_OF_STEP = 12
"""Fewest degrees of freedom that a step is judged by (assumed)."""
_RARE = 1e-4
"""Chance of a step as clear as this one in readings of one set-up, at any of the configurations (assumed)."""
_RANK_TOLERANCE = 1e-6
"""Least singular value, over the largest, of a direction that the readings determine (assumed)."""
_MAX_CORRELATION = 0.5
"""Correlation of a joint angle with a step beyond which errors of the geometry look like the step."""
_MIN_MOVEMENT = 2e-4
"""Smallest movement [m] that is reported (assumed)."""


def moved_device(robot: RobotModel, data: Measurements, placement: Placement) -> list[str]:
    """Return a warning if the measuring device seems to have moved between two configurations; none if not.

    Readings without load are fitted by a frame, the points, errors of the geometry (six for each joint) and the sag of
    the joints, with and without a step of the frame from a configuration on.
    """
    is_visible = np.abs(placement.residual).max(axis=2, keepdims=True) > 0.0
    columns = [part(robot, data, placement) for part in (_frame_derivatives, _point_derivatives, _sag_derivatives)]
    rows = np.concatenate(columns, axis=3) * is_visible[..., None]
    chance, first, twist = _clearest_step(rows, placement.residual, data.q)
    at = np.append(np.mean(placement.points, axis=0), 1.0)
    middle = np.mean((unloaded_flange(robot, data.q) @ at)[:, :3], axis=0)
    size = float(np.linalg.norm(twist[:3] + np.cross(twist[3:], middle)))
    if chance * len(data.q) > _RARE or size < _MIN_MOVEMENT:
        return []
    return [
        f"from config {data.config[first]:g} on the measuring device seems to have moved by {size * MM_PER_M:.1f} mm: "
        "displacements are differences within a configuration and stay right; the geometry is not. Check the tripod."
    ]


def _clearest_step(rows: Array, residual: Array, q: Array) -> tuple[float, int, Array]:
    """Return the smallest chance of a step in readings of one set-up, its configuration, and its twist (6,), root axes.

    By F-test (Draper and Smith, "Applied Regression Analysis", 1998, ch. 6). Points of a configuration share the error
    of the geometry, so they count as one.

    :param rows: (C, P, 3, n) derivatives of the readings, those by a twist of the root first.
    :param residual: (C, P, 3) of the readings without load [m].
    """
    configs = len(residual)
    design = rows.reshape(-1, rows.shape[3])
    basis, singular, _ = np.linalg.svd(design / np.maximum(norm(design.T), 1e-12), full_matrices=False)
    basis = basis[:, singular > _RANK_TOLERANCE * singular[0]]
    left = residual.ravel() - basis @ (basis.T @ residual.ravel())
    spare = 3 * configs - basis.shape[1] - 6
    best: tuple[float, int, Array] = (np.inf, 0, np.zeros(6))
    for first in range(2, configs - 1) if spare >= _SPARE_OF_STEP else ():
        if _is_separable_by_order(q, first):
            continue
        step = (rows[..., :6] * (np.arange(configs) >= first)[:, None, None, None]).reshape(-1, 6)
        step = step - basis @ (basis.T @ step)
        twist, _, rank, _ = np.linalg.lstsq(step, left, rcond=_RANK_TOLERANCE)
        if rank == 6:
            drop = float(np.sum((step @ twist) ** 2))
            # 1e-300 keeps zero out of the denominator
            unexplained = max(float(np.sum(left**2)) - drop, 1e-300)
            chance = _chance(drop / 6.0 * spare / unexplained, spare)
            if chance < best[0]:
                best = (chance, first, np.asarray(twist))
    return best


def _chance(ratio: float, spare: int) -> float:
    """Return the chance of an F-distributed ratio (6, spare) beyond a value."""
    from scipy.stats import f

    return float(f.sf(ratio, 6, spare))


def _is_separable_by_order(q: Array, first: int) -> bool:
    """Return whether a joint angle separates the configurations (C, 6) from `first` on from those before."""
    angles = (q - q.mean(axis=0)) / np.maximum(q.std(axis=0), 1e-12)
    step = (np.arange(len(q)) >= first).astype(float)
    step = (step - step.mean()) / step.std()
    return bool(np.abs(step @ angles / len(q)).max() > _MAX_CORRELATION)


def _frame_derivatives(robot: RobotModel, data: Measurements, placement: Placement) -> Array:
    """Return the derivatives (C, P, 3, 42) of the points, device axes, by twists of root and joint frames.

    A twist has the axes of its frame.
    """
    x = elastostatics.coordinates(robot, data.q)
    turn = placement.root_in_device[:3, :3]
    slopes = np.zeros((len(data.q), len(placement.points), 3, 42))
    for index, point in enumerate(placement.points):
        tool = np.eye(4)
        tool[:3, 3] = point
        pose, _ = kinematics.tcp(robot.actual, x, tool)
        frames = [np.tile(np.eye(4), (len(x), 1, 1)), *_joint_frames(robot, data.q)]
        for number, frame in enumerate(frames):
            axes = turn @ frame[:, :3, :3]
            lever = (pose[:, :3, 3] - frame[:, :3, 3]) @ turn.T
            columns = slice(6 * number, 6 * number + 3), slice(6 * number + 3, 6 * number + 6)
            slopes[:, index, :, columns[0]] = axes
            slopes[:, index, :, columns[1]] = np.cross(np.swapaxes(axes, 1, 2), lever[:, None]).swapaxes(1, 2)
    return slopes


def _sag_derivatives(robot: RobotModel, data: Measurements, placement: Placement) -> Array:
    """Return the derivatives (C, P, 3, 6) of the points by the compliance of each joint under the own weight."""
    x = elastostatics.coordinates(robot, data.q)
    torque = elastostatics.balance.static_torque(robot, x.T).T[:, list(robot.actuated)]
    slopes = np.zeros((len(x), len(placement.points), 3, len(JOINTS)))
    for index, point in enumerate(placement.points):
        tool = np.eye(4)
        tool[:3, 3] = point
        jacobian = kinematics.tcp(robot.actual, x, tool)[1][:, :3, list(robot.actuated)]
        slopes[:, index] = placement.root_in_device[:3, :3] @ (jacobian * torque[:, None])
    return slopes


def _joint_frames(robot: RobotModel, q: Array) -> list[Array]:
    """Return the frames (C, 4, 4) of the six joints before they turn, root axes."""
    pose, frames = np.tile(np.eye(4), (len(q), 1, 1)), []
    for joint in range(len(JOINTS)):
        pose = pose @ robot.nominal.placement[joint]
        frames.append(pose)
        rotation = np.tile(np.eye(4), (len(q), 1, 1))
        for row, angle in enumerate(q[:, joint]):
            rotation[row, :3, :3] = rotation_from_vector(angle * robot.nominal.axis[joint])
        pose = pose @ rotation
    return frames


def _point_derivatives(robot: RobotModel, data: Measurements, placement: Placement) -> Array:
    """Return the derivatives (C, P, 3, 3P) of the points by their places on the flange, device axes."""
    rotation = placement.root_in_device[:3, :3] @ unloaded_flange(robot, data.q)[:, :3, :3]
    count = len(placement.points)
    slopes = np.zeros((len(rotation), count, 3, 3 * count))
    for index in range(count):
        slopes[:, index, :, 3 * index : 3 * index + 3] = rotation
    return slopes
