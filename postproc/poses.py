"""Many poses in little memory: the targets of a program often have one orientation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from postproc.chunks import Columns, in_chunks
from postproc.frames import (
    M_PER_MM,
    RAD_PER_DEG,
    Array,
    angle_between,
    angles_from_rotation,
    largest,
    rotation_from_angles,
)

_FIRST_THREE = slice(None, 3)


class Poses(Columns, frozen=True, eq=False):
    """N poses, indexed like an array (N, 4, 4), in less memory: a constant orientation is kept once, others by angles.

    :param position: (N, 3) [m].
    :param orientation: (N, 3) angles A, B, C [deg], from which matrices are computed where they are needed; or the
        matrices (N, 3, 3), of one orientation for all a view without memory of its own, see `fixed`.

    >>> poses = Poses.fixed(np.arange(6.0).reshape(2, 3), np.eye(3))
    >>> poses[[1], :3, 3].tolist(), poses[[1]].shape, poses.position.nbytes + poses.rotation.base.nbytes
    ([[3.0, 4.0, 5.0]], (1, 4, 4), 120)
    """

    position: Array
    orientation: Array

    @classmethod
    def of(cls, pose: Array) -> Poses:
        """Return the poses of an array (N, 4, 4) [m]; if all have one orientation, it is kept once."""
        rotation = pose[:, :3, :3]
        # the last orientation is compared first, which is enough for most paths that turn the tool
        is_constant = (
            bool(len(pose)) and bool((rotation[-1] == rotation[0]).all()) and bool((rotation == rotation[0]).all())
        )
        if is_constant:
            return cls.fixed(pose[:, :3, 3].copy(), rotation[0].copy())
        return cls(pose[:, :3, 3].copy(), rotation.copy())

    @classmethod
    def fixed(cls, position: Array, rotation: Array) -> Poses:
        """Return poses at positions (N, 3) [m] with one orientation (3, 3)."""
        return cls(position, np.broadcast_to(rotation, (len(position), 3, 3)))

    @property
    def is_fixed(self) -> bool:
        """True if one orientation is kept for all."""
        return self.orientation.ndim == 3 and self.orientation.strides[0] == 0

    @property
    def rotation(self) -> Array:
        """(N, 3, 3) orientations, to be read only."""
        return self._rotation(slice(None))

    def xyzabc(self, rows: NDArray[Any] | slice) -> Array:
        """Return X, Y, Z [mm], A, B, C [deg] (n, 6) of some of the poses."""
        orientation = self.orientation[rows]
        angles_deg = orientation if orientation.ndim == 2 else angles_from_rotation(orientation) / RAD_PER_DEG
        return np.hstack([self.position[rows] / M_PER_MM, angles_deg])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the array that these poses are indexed like."""
        return len(self), 4, 4

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, key: Any) -> Array:
        """Return matrices (n, 4, 4) of some rows, or entries of them: `[rows]`, `[rows, :3, 3]`, `[rows, :3, :3]`."""
        rows, *entries = key if isinstance(key, tuple) else (key,)
        if entries == [_FIRST_THREE, 3]:
            return np.asarray(self.position[rows])
        if entries and entries[0] == _FIRST_THREE and entries[1] in (_FIRST_THREE, 0, 1, 2):
            return np.asarray(self._rotation(rows)[..., entries[1]])
        position = self.position[rows]
        matrices = np.zeros((*position.shape[:-1], 4, 4))
        matrices[..., :3, :3], matrices[..., :3, 3], matrices[..., 3, 3] = self._rotation(rows), position, 1.0
        return np.asarray(matrices[(*[slice(None)] * (matrices.ndim - 2), *entries)])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)

    def take(self, rows: NDArray[Any] | slice) -> Poses:
        """Return some of the poses."""
        position = self.position[rows]
        if self.is_fixed:
            return Poses(position, np.broadcast_to(self.orientation[:1], (len(position), 3, 3)))
        return Poses(position, self.orientation[rows])

    def _rotation(self, rows: Any) -> Array:
        """Return the rotations (n, 3, 3) of some of the poses."""
        orientation = self.orientation[rows]
        return orientation if self.orientation.ndim == 3 else rotation_from_angles(orientation * RAD_PER_DEG)


def largest_differences(first: Poses, second: Poses) -> Array:
    """Return by how much N poses differ from N others (N,): the larger of offset, by component [m], and angle [rad]."""
    return np.maximum(largest(first.position - second.position), angles_between(first, second))


def angles_between(first: Poses, second: Poses) -> Array:
    """Return the angles (N,) [rad] between the orientations of N poses and of N others."""

    def angles(rows: NDArray[Any]) -> Array:
        """Return the angles of some of the poses."""
        return angle_between(first._rotation(rows), second._rotation(rows))

    # in chunks: each pair of orientations is two matrices, three times the memory of its position
    return in_chunks(angles, np.arange(len(first)))


def as_poses(pose: Poses | Array) -> Poses:
    """Return poses as they are, or those of an array (N, 4, 4)."""
    return Poses.of(pose) if isinstance(pose, np.ndarray) else pose


def poses_from_xyzabc(xyzabc: Array) -> Poses:
    """Return the poses of KUKA frames (N, 6) [mm, deg], see `pose_from_xyzabc`."""
    angles = xyzabc[:, 3:]
    # the last row is compared first, which is enough for most paths that turn the tool
    if len(angles) and (angles[-1] == angles[0]).all() and (angles == angles[0]).all():
        return Poses.fixed(xyzabc[:, :3] * M_PER_MM, rotation_from_angles(angles[0] * RAD_PER_DEG))
    return Poses(xyzabc[:, :3] * M_PER_MM, angles)
