"""From the `$BASE` of motions into the robot root, and back."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array, inverse
from postproc.program import Ints, Program


def tool_of(program: Program, motion: Ints) -> Array:
    """Return `$TOOL` in the flange frame for motions (n,) [m]: (4, 4) if the program has but one, else (n, 4, 4)."""
    if len(program.tools) == 1:
        return np.asarray(program.tools[0])
    return np.asarray(program.tools[program.motions.tool[motion]])


def base_of(program: Program, motion: Ints) -> Array:
    """Return `$BASE` in the root for motions (n,) [m]: (4, 4) if the program has but one, else (n, 4, 4)."""
    if len(program.bases) == 1:
        return np.asarray(program.bases[0])
    return np.asarray(program.bases[program.motions.base[motion]])


def pose_in_root(program: Program, motion: Ints, pose_in_base: Array) -> Array:
    """Return poses (n, 4, 4) in the root of poses in `$BASE` of their motions."""
    return np.asarray(base_of(program, motion) @ pose_in_base)


def pose_in_base(program: Program, motion: Ints, pose_in_root: Array) -> Array:
    """Return poses (n, 4, 4) in `$BASE` of their motions of poses in the root."""
    return np.asarray(inverse(base_of(program, motion)) @ pose_in_root)


def points_in_base(program: Program, motion: Ints, point_in_root: Array) -> Array:
    """Return points (n, 3) in `$BASE` of their motions of points in the root [m]."""
    base = base_of(program, motion)
    return np.asarray(np.einsum("...i,...ij->...j", point_in_root - base[..., :3, 3], base[..., :3, :3]))


def wrench_in_root(program: Program, motion: Ints, wrench_in_base: Array) -> Array:
    """Return wrenches (n, 6) in root axes of wrenches in `$BASE` axes."""
    rotation = base_of(program, motion)[..., :3, :3]
    pairs = wrench_in_base.reshape(-1, 2, 3)
    return np.asarray(np.einsum("...ij,...kj->...ki", rotation, pairs)).reshape(-1, 6)


def columns_in_root(program: Program, motion: Ints, columns_in_base: Array) -> Array:
    """Return columns (n, 2, 3, m) of force and moment in root axes of columns in `$BASE` axes."""
    return np.asarray(np.einsum("...ij,...hjm->...him", base_of(program, motion)[..., :3, :3], columns_in_base))


def flange_from_tcp(program: Program, motion: Ints, pose_tcp_in_base: Array) -> Array:
    """Return flange poses in the robot root (N, 4, 4) for tool frames in `$BASE` of the given motions."""
    moved = program.motions
    if len(program.bases) == len(program.tools) == 1:
        return np.asarray(program.bases[0] @ pose_tcp_in_base @ inverse(program.tools[0]))
    return np.asarray(program.bases[moved.base[motion]] @ pose_tcp_in_base @ inverse(program.tools)[moved.tool[motion]])


def flange_points(program: Program, motion: Ints, pose_tcp_in_base: Array, point: Array) -> Array:
    """Return where a point (3,) of the flange frame stands in the robot root (N, 3) [m]; poses as `flange_from_tcp`."""
    m = program.motions
    in_tool = inverse(program.tools) @ np.append(point, 1.0)
    if len(program.bases) == len(program.tools) == 1:
        in_base = np.einsum("nij,j->ni", pose_tcp_in_base, in_tool[0])
        return np.asarray(np.einsum("ij,nj->ni", program.bases[0, :3], in_base))
    placed = pose_tcp_in_base @ in_tool[m.tool[motion]][..., None]
    return np.asarray((program.bases[m.base[motion], :3] @ placed)[..., 0])
