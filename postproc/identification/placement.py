"""Where the measuring device and the reference points are: first step of the identification (paper, section 4).

From readings without load, by the robot's geometry: positions of points only, no orientations (partial pose).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import elastostatics, kinematics
from postproc.errors import MeasurementError
from postproc.frames import MM_PER_M, Array, displaced, hat, inverse, xyzabc_from_pose
from postproc.identification.measurements import Measurements
from postproc.robot import RobotModel

_STEPS = 20


class Placement(Struct, frozen=True, eq=False):
    """Base transform and reference points.

    :param root_in_device: (4, 4) maps robot root coordinates to the frame of the device [m].
    :param points: (P, 3) in the flange frame [m].
    :param covariance: (6 + 3P, 6 + 3P) of (twist of the root in device axes, points), for unit noise [1/1].
    :param residual: (C, P, 3) reading minus model without load, device axes [m].
    """

    root_in_device: Array
    points: Array
    covariance: Array
    residual: Array

    @property
    def rms(self) -> float:
        """RMS distance of the unloaded readings from the model [m]."""
        squares = np.sum(self.residual**2, axis=-1)
        return float(np.sqrt(squares.sum() / max(1, np.count_nonzero(squares))))


def kabsch(source: Array, target: Array) -> Array:
    """Return the rigid transform (4, 4) that carries points (n, 3) best to others (Kabsch 1976)."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((source - a).T @ (target - b))
    sign = np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)])
    pose = np.eye(4)
    pose[:3, :3] = vt.T @ sign @ u.T
    pose[:3, 3] = b - pose[:3, :3] @ a
    return pose


def locate(robot: RobotModel, data: Measurements, flange: Array | None = None) -> Placement:
    """Find the root in the device frame and the points in the flange frame from the readings without load.

    :param flange: (C, 4, 4) poses of the flange without load in the root frame, if not those of the geometry.
    :raises MeasurementError: fewer readings than unknowns, or points and configurations that leave the frames open.
    """
    if flange is None:
        flange = unloaded_flange(robot, data.q)
    mean, count = data.means()
    seen, weight = mean[data.unloaded], count[data.unloaded]
    configs, points = seen.shape[:2]
    if configs * points * 3 < 6 + 3 * points:
        raise MeasurementError(
            f"{configs} configurations of {points} points are {configs * points * 3} coordinates for "
            f"{6 + 3 * points} unknowns of base and points",
            file=data.file,
            advice="Measure more configurations.",
        )
    position = data.guess.copy()
    model = _place(flange, position)
    known = weight.ravel() > 0.0
    pose = kabsch(model.reshape(-1, 3)[known], seen.reshape(-1, 3)[known])
    normal = np.eye(6 + 3 * points)
    for _ in range(_STEPS):
        model = _place(pose @ flange, position)
        left = seen - model
        jacobian = np.zeros((configs, points, 3, 6 + 3 * points))
        jacobian[..., 0:3] = np.eye(3)
        jacobian[..., 3:6] = -hat(model - pose[:3, 3])
        turned = pose[:3, :3] @ flange[:, :3, :3]
        for index in range(points):
            jacobian[:, index, :, 6 + 3 * index : 9 + 3 * index] = turned
        rows = (jacobian * np.sqrt(weight)[..., None, None]).reshape(-1, 6 + 3 * points)
        normal = rows.T @ rows
        scale = 1.0 / np.sqrt(np.diag(normal))
        if np.linalg.cond(normal * np.outer(scale, scale)) > 1e10:
            raise MeasurementError(
                "base transform and reference points cannot be separated with these configurations",
                file=data.file,
                advice="Turn A1…A6, the wrist above all, more from configuration to configuration.",
            )
        step = np.linalg.solve(normal, rows.T @ (left * np.sqrt(weight)[..., None]).ravel())
        pose = displaced(pose, step[:6])
        position = position + step[6:].reshape(points, 3)
        if np.abs(step).max() < 1e-11:
            break
    left = (seen - _place(pose @ flange, position)) * (weight > 0.0)[..., None]
    return Placement(pose, position, np.asarray(np.linalg.inv(normal)), left)


def unloaded_flange(robot: RobotModel, q: Array) -> Array:
    """Return the pose (C, 4, 4) of the flange without load [m]: sagged, if the geometry is a weightless robot's."""
    if robot.subtract_reference:
        return kinematics.tcp(robot.actual, elastostatics.coordinates(robot, q), np.eye(4))[0]
    return elastostatics.deflect(robot, q, np.eye(4), np.zeros((len(q), 6))).pose


def in_root_axes(placement: Placement, vectors: Array) -> Array:
    """Turn vectors (..., 3) from device axes to root axes."""
    return np.asarray(vectors @ placement.root_in_device[:3, :3])


def describe(placement: Placement) -> dict[str, float]:
    """Return the base transform as a KUKA frame [mm, deg]: the root in the device frame."""
    values = xyzabc_from_pose(placement.root_in_device)
    return {name: float(value) for name, value in zip("XYZABC", values, strict=True)}


def describe_points(placement: Placement, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Return the reference points in the flange frame [mm]."""
    return {
        name: {axis: float(v * MM_PER_M) for axis, v in zip("XYZ", p, strict=True)}
        for name, p in zip(names, placement.points, strict=True)
    }


def device_to_root(placement: Placement, positions: Array) -> Array:
    """Return positions (..., 3) of the device frame in the root frame [m]."""
    back = inverse(placement.root_in_device)
    return np.asarray(positions @ back[:3, :3].T + back[:3, 3])


def _place(frames: Array, points: Array) -> Array:
    placed: Array = np.einsum("cij,pj->cpi", frames[:, :3, :3], points) + frames[:, None, :3, 3]
    return placed
