"""SE(3), KUKA frames {X, Y, Z, A, B, C}, and the only conversion of units in the package.

Inside the package: metres, radians, newtons. A pose is a homogeneous 4×4 matrix; its name states the
direction: ``pose_tcp_in_base`` maps coordinates in the TCP frame to coordinates in the base frame.
A KUKA frame is R = Rz(A)·Ry(B)·Rx(C) with mm and degrees (KUKA System Software manual, "A, B, C").
All functions take any number of leading axes.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

M_PER_MM = 1e-3
RAD_PER_DEG = np.pi / 180.0
MM_PER_M = 1e3
DEG_PER_RAD = 180.0 / np.pi
MM_PER_INCH = 25.4
S_PER_MIN = 60.0
MM_PER_MIN = S_PER_MIN * MM_PER_M
"""mm/min of one m/s."""
FULL_TURN = 2.0 * np.pi
_POLE = 1e-9
"""Cosine of B below which A is taken as 0: only the sum or difference of A and C means something there."""
_HALF_TURN_COSINE = -0.99
"""Cosine of an angle below which its sine loses digits: the axis is taken from the symmetric part of the rotation."""
_SMALL_SINE = 5e-3
"""Below this the series of asin and of Rodrigues' factors to the fifth power are exact to 1e-16."""
_IDENTITY = np.eye(4)
_TO_SI = np.array([M_PER_MM] * 3 + [RAD_PER_DEG] * 3)


def pose_from_xyzabc(xyzabc: ArrayLike) -> Array:
    """Return the poses of KUKA frames.

    :param xyzabc: (..., 6) X, Y, Z [mm], A, B, C [deg].
    :returns: (..., 4, 4), translation in metres.

    >>> pose_from_xyzabc([0, 0, 1000, 0, 90, 0]).round(6).tolist()[0]
    [0.0, 0.0, 1.0, 0.0]
    """
    values: Array = np.asarray(xyzabc, dtype=float) * _TO_SI
    pose = np.zeros((*values.shape[:-1], 4, 4))
    pose[..., :3, :3] = rotation_from_angles(values[..., 3:])
    pose[..., :3, 3] = values[..., :3]
    pose[..., 3, 3] = 1.0
    return pose


def rotation_from_angles(angles: Array) -> Array:
    """Return Rz(a)·Ry(b)·Rx(c) (..., 3, 3) of angles a, b, c (..., 3) [rad]."""
    sin, cos = sine_and_cosine(angles)
    (sa, sb, sc), (ca, cb, cc) = np.moveaxis(sin, -1, 0), np.moveaxis(cos, -1, 0)
    matrix = np.empty((*angles.shape, 3))
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2] = ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc
    matrix[..., 1, 0], matrix[..., 1, 1], matrix[..., 1, 2] = sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc
    matrix[..., 2, 0], matrix[..., 2, 1], matrix[..., 2, 2] = -sb, cb * sc, cb * cc
    return matrix


def xyzabc_from_pose(pose: Array) -> Array:
    """Return KUKA frames (..., 6) [mm, deg] of poses (..., 4, 4) [m]; A, B, C in (−180, 180].

    At B = ±90°, where A and C are not unique, A is 0 and the three still compose to the given rotation: C is taken
    from what remains after A and B, not from entries that vanish there.

    >>> xyzabc_from_pose(pose_from_xyzabc([10, 20, 30, 40, 90, 15])).round(6).tolist()
    [10.0, 20.0, 30.0, 0.0, 90.0, -25.0]
    """
    angles = angles_from_rotation(pose[..., :3, :3])
    return np.asarray(np.concatenate([pose[..., :3, 3], angles], axis=-1) / _TO_SI)


def angles_from_rotation(rotation: Array) -> Array:
    """Return a, b, c (..., 3) in (−π, π] [rad] of rotations Rz(a)·Ry(b)·Rx(c) (..., 3, 3).

    The inverse of `rotation_from_angles`. At b = ±90°, a is 0, see `xyzabc_from_pose`.
    """
    r = rotation
    at_pole = r[..., 1, 0] ** 2 + r[..., 0, 0] ** 2 < _POLE**2
    a = np.where(at_pole, 0.0, np.arctan2(r[..., 1, 0], r[..., 0, 0]))
    sa, ca = sine_and_cosine(a)
    b = np.arctan2(-r[..., 2, 0], ca * r[..., 0, 0] + sa * r[..., 1, 0])
    c = np.arctan2(
        sa * r[..., 0, 2] - ca * r[..., 1, 2],
        ca * r[..., 1, 1] - sa * r[..., 0, 1],
    )
    return np.stack([a, b, c], axis=-1)


def inverse(pose: Array) -> Array:
    """Return the inverse of rigid poses (..., 4, 4).

    >>> (xyzabc_from_pose(inverse(pose_from_xyzabc([0, 0, 1000, 0, 90, 0]))).round(6) + 0.0).tolist()
    [1000.0, 0.0, 0.0, 0.0, -90.0, 0.0]
    """
    inverse_pose = np.zeros_like(pose)
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    inverse_pose[..., :3, :3] = rotation
    inverse_pose[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation, pose[..., :3, 3])
    inverse_pose[..., 3, 3] = 1.0
    return inverse_pose


def product(left: Array, pose: Array, right: Array = _IDENTITY) -> Array:
    """Return left·pose·right of poses (n, 4, 4); the outer ones are (4, 4), the same for all, or (n, 4, 4).

    Where both are the same for all it is one product of two matrices: vec(L·P·R) = vec(P)·(Lᵀ ⊗ R), row by row.
    """
    if left.ndim == right.ndim == 2:
        return np.asarray(pose.reshape(-1, 16) @ np.kron(left.T, right)).reshape(-1, 4, 4)
    return np.asarray(left @ pose @ right)


def rotation_vector(rotation: Array) -> Array:
    """Return the rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3); angle ≤ π.

    >>> rotation_vector(rotation_from_vector(np.array([0.0, 0.5, 0.0]))).round(9).tolist()
    [0.0, 0.5, 0.0]
    """
    sine_axis = 0.5 * np.stack(
        [
            rotation[..., 2, 1] - rotation[..., 1, 2],
            rotation[..., 0, 2] - rotation[..., 2, 0],
            rotation[..., 1, 0] - rotation[..., 0, 1],
        ],
        axis=-1,
    )  # sin(angle)·axis
    square = np.einsum("...i,...i->...", sine_axis, sine_axis)
    # near half a turn about a unit axis a the diagonal is 2a² − 1: two entries above ½ are those of a small turn
    if (
        square.max(initial=0.0) < _SMALL_SINE**2
        and (rotation[..., 0, 0] > 0.5).all()
        and (rotation[..., 1, 1] > 0.5).all()
    ):
        return np.asarray(sine_axis * (1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0)))[..., None])  # asin(s)/s
    sine = np.sqrt(square)
    cosine = 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    divisor = np.where(sine > 0.0, sine, 1.0)
    vector = sine_axis * np.where(sine > 0.0, angle / divisor, 1.0)[..., None]
    is_near_half_turn = np.atleast_1d(cosine < _HALF_TURN_COSINE)
    if is_near_half_turn.any():
        rows, rotations = np.atleast_2d(vector), rotation.reshape(*is_near_half_turn.shape, 3, 3)
        rows[is_near_half_turn] = _near_half_turn(
            rotations[is_near_half_turn], np.atleast_2d(sine_axis)[is_near_half_turn]
        )
        vector = rows.reshape(vector.shape)
    return vector


def _near_half_turn(rotation: Array, sine_axis: Array) -> Array:
    """Return rotation vectors (n, 3) of rotations (n, 3, 3) near a half turn, where the sine has no digits left.

    The symmetric part is cos·I + (1 − cos)·a·aᵀ: its column of the largest diagonal entry gives the axis a, and
    `sine_axis` (n, 3), sin·a, its sign. At the half turn itself, where both signs mean the same, the largest entry is
    positive.
    """
    row = np.arange(len(rotation))
    cosine = 0.5 * (np.trace(rotation, axis1=1, axis2=2) - 1.0)
    largest_entry = np.argmax(np.einsum("nii->ni", rotation), axis=1)
    axis = 0.5 * (rotation[row, :, largest_entry] + rotation[row, largest_entry])
    axis[row, largest_entry] -= cosine
    axis /= norm(axis)[:, None]
    axis *= np.where(np.einsum("ni,ni->n", axis, sine_axis) < 0.0, -1.0, 1.0)[:, None]
    return np.asarray(axis * np.arctan2(norm(sine_axis), cosine)[:, None])


def sine_and_cosine(angle: Array) -> tuple[Array, Array]:
    """Return sine and cosine of angles [rad], to 4e-16.

    Computed from the tangent of half the angle, which takes less time than both functions.
    """
    half = np.tan(0.5 * angle)
    scale = 2.0 / (1.0 + half * half)
    return half * scale, scale - 1.0


def wrap_angles(angle: Array) -> Array:
    """Return angles [rad] less the whole turns that bring them into −π … π."""
    return np.asarray(angle - FULL_TURN * np.rint(angle / FULL_TURN))


def angle_between(rotation_a: Array, rotation_b: Array) -> Array:
    """Return the angles (n,) [rad] between rotations (n, 3, 3): ‖R₁ − R₂‖² = 8·sin²(θ/2)."""
    difference = (rotation_a - rotation_b).reshape(-1, 9)
    return np.asarray(2.0 * np.arcsin(np.minimum(norm(difference) / np.sqrt(8.0), 1.0)))


def norm(vector: Array) -> Array:
    """Return the lengths (...) of vectors (..., k)."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vector, vector)))


def largest(values: Array) -> Array:
    """Return the largest magnitude in each row (n,) of (n, k) values, k ≥ 1; much faster than `max` over short rows."""
    return reduce(np.maximum, np.abs(values).T)


def any_column(truths: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which rows (n,) of (n, k) truths hold one, k ≥ 1; much faster than `any` over short rows."""
    return reduce(np.logical_or, truths.T)


def hat(vector: Array) -> Array:
    """Return the skew matrices (..., 3, 3) of vectors (..., 3): the product with b is the cross product with b.

    >>> (hat(np.array([1.0, 0.0, 0.0])) @ [0.0, 1.0, 0.0]).tolist()
    [0.0, 0.0, 1.0]
    """
    skew = np.zeros((*vector.shape, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -z, y, -x
    skew[..., 1, 0], skew[..., 2, 0], skew[..., 2, 1] = z, -y, x
    return skew


def rotation_from_vector(vector: Array) -> Array:
    """Return rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad] (Rodrigues)."""
    square = np.einsum("...i,...i->...", vector, vector)[..., None, None]
    skew = hat(vector)
    if square.max(initial=0.0) < _SMALL_SINE**2:
        a = 1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0))
        b = 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0))
    else:
        angle = np.sqrt(square)
        a, b = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    rotation: Array = np.eye(3) + a * skew + b * (skew @ skew)
    return rotation


def twist_between(start_pose: Array, end_pose: Array) -> Array:
    """Return (..., 6) the displacement that carries one pose to another: translation [m] of the origin and
    rotation vector [rad], both in the axes of the frame in which the poses are given.
    """
    twist = np.empty((*np.broadcast_shapes(start_pose.shape, end_pose.shape)[:-2], 6))
    twist[..., :3] = end_pose[..., :3, 3] - start_pose[..., :3, 3]
    relative = end_pose[..., :3, :3] @ np.swapaxes(start_pose[..., :3, :3], -1, -2)
    twist[..., 3:] = rotation_vector(relative)
    return twist


def displace(pose: Array, twist: Array) -> Array:
    """Return the poses moved by twists (inverse of `twist_between`): (..., 4, 4) and (..., 6)."""
    moved_pose = np.zeros((*np.broadcast_shapes(pose.shape[:-2], twist.shape[:-1]), 4, 4))
    moved_pose[..., :3, 3] = pose[..., :3, 3] + twist[..., :3]
    moved_pose[..., :3, :3] = rotation_from_vector(twist[..., 3:]) @ pose[..., :3, :3]
    moved_pose[..., 3, 3] = 1.0
    return moved_pose


def rigid_displacement(points: Array, shift: Array, weight: Array) -> Array:
    """Return the displacement (4, 4) of a rigid body that fits small shifts of its points best, by least squares.

    A rotation that the points do not determine (one point, or points of a line) is none.

    :param points: (n, 3), and `shift` (n, 3), both in one unit; shifts turn the body by a small angle.
    :param weight: (n,) of the points.

    >>> corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    >>> turned = np.array([[0.0, 0.0, 0.5], [0.0, 0.001, 0.5], [-0.001, 0.0, 0.5]])
    >>> rigid_displacement(corners, turned, np.ones(3))[:3, 3].round(6).tolist()
    [0.0, 0.0, 0.5]
    """
    share = weight / weight.sum()
    centre, mean_shift = share @ points, share @ shift
    root_share = np.sqrt(share)[:, None, None]
    # a small rotation ω shifts a point p by ω × (p − centre) = −hat(p − centre) ω
    design = (-root_share * hat(points - centre)).reshape(-1, 3)
    angle = np.linalg.lstsq(design, (root_share[..., 0] * (shift - mean_shift)).ravel(), rcond=_UNDETERMINED)[0]
    displacement = np.eye(4)
    displacement[:3, :3] = rotation_from_vector(angle)
    displacement[:3, 3] = centre + mean_shift - displacement[:3, :3] @ centre
    return displacement


_UNDETERMINED = 1e-3
"""Spread of points about an axis, over the largest, up to which they do not determine a turn about it."""


def interpolate(start_pose: Array, end_pose: Array, t: Array) -> Array:
    """Return poses on the straight run from one pose to another, t in [0, 1]: position linear, orientation
    by one rotation about a fixed axis (how KUKA interpolates LIN with ``$ORI_TYPE=#VAR``).

    >>> ends = pose_from_xyzabc([[0, 0, 0, 0, 0, 0], [100, 0, 0, 90, 0, 0]])
    >>> (xyzabc_from_pose(interpolate(*ends, np.array(0.5))).round(6) + 0.0).tolist()
    [50.0, 0.0, 0.0, 45.0, 0.0, 0.0]
    """
    return displace(start_pose, twist_between(start_pose, end_pose) * np.asarray(t)[..., None])
