"""Poses by components, the sample index LAST: (3, 4, n), the columns X, Y, Z of the rotation and the position.

Each component is then one array, and an operation on all samples runs through contiguous memory. Values that are the
same for all samples have n = 1; their zeros cost nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc import frames
from postproc.frames import Array

_SMALL_STEP = 5e-3
"""Below this difference of the columns of two rotations [rad], series to the fifth power are exact to 1e-16."""


def components(pose: Array) -> Array:
    """Return poses (4, 4) or (n, 4, 4) as (3, 4, 1) or (3, 4, n); n poses that are one broadcast pose as (3, 4, 1)."""
    if pose.ndim == 2:
        pose = pose[None]
    elif pose.strides[0] == 0:
        pose = pose[:1]
    return np.ascontiguousarray(pose[:, :3].transpose(1, 2, 0))


def matrices(pose: Array) -> Array:
    """Return poses (3, 4, n) as (n, 4, 4)."""
    matrix = np.zeros((pose.shape[-1], 4, 4))
    matrix[:, :3] = pose.transpose(2, 0, 1)
    matrix[:, 3, 3] = 1.0
    return matrix


def combination(columns: Sequence[Array], factors: Sequence[float | Array] | Array) -> Array:
    """Return Σ columns[k]·factors[k] (m, n) of k columns (m, n) or (m, 1).

    :param factors: k numbers, or arrays (n,) or (1,). A single factor of 0 or 1 costs nothing.
    """
    total: Array | None = None
    for column, factor in zip(columns, factors, strict=True):
        constant = factor if isinstance(factor, float) else float(factor[0]) if len(factor) == 1 else None
        if constant == 0.0:
            continue
        term = column if constant == 1.0 else column * factor
        total = term if total is None else total + term
    return np.zeros((len(columns[0]), 1)) if total is None else total


def product(columns: Sequence[Array], pose: Array) -> Array:
    """Return the poses frame·pose (3, 4, n).

    :param columns: X, Y, Z and origin of the frame, (3, n) or (3, 1) each.
    :param pose: (3, 4, n) or (3, 4, 1) in that frame.
    """
    result = np.empty(np.broadcast_shapes(pose.shape, *(column.shape[-1:] for column in columns)))
    for column in range(4):
        result[:, column] = combination(columns[:3], pose[:, column])
    result[:, 3] += columns[3]
    return result


def cross(a: Array, b: Array, out: Array | None = None) -> Array:
    """Return the cross products (3, n) of vectors `a` and `b`, (3, n) or (3, 1) each, in `out` if it is given."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape)) if out is None else out
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(a[j], b[k], out=out[i])
        out[i] -= a[k] * b[j]
    return out


def twist_between(start: Array, end: Array) -> Array:
    """Return the twists (6, n) from poses to other poses, (3, 4, n) each: translation [m], then rotation vector [rad].

    Root axes, as of `frames.twist_between`.
    """
    difference = end[:, :3] - start[:, :3]
    if not np.abs(difference).max(initial=0.0) < _SMALL_STEP:
        return np.ascontiguousarray(frames.twist_between(matrices(start), matrices(end)).T)
    # axis times sine of the rotation R₂·R₁ᵀ: half of Σ x₁ × x₂ over the columns, and x₁ × x₂ = x₁ × (x₂ − x₁)
    sine = (
        cross(start[:, 0], difference[:, 0])
        + cross(start[:, 1], difference[:, 1])
        + cross(start[:, 2], difference[:, 2])
    )
    sine *= 0.5
    square = (sine * sine).sum(axis=0)
    angle_over_sine = 1.0 + square * (1.0 / 6.0 + square * (3.0 / 40.0))  # series of asin(s)/s
    return np.concatenate([end[:, 3] - start[:, 3], sine * angle_over_sine])
