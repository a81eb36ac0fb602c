"""From the `$BASE` of motions into the robot root, and back."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array, inverse, product
from postproc.program import Ints, Program

Place = Array | float | None
"""Where on their motions, in (0, 1], (n,) or all of them: where a carriage has brought the robot; None: it is at 0."""


def tool_of(program: Program, motion: Ints) -> Array:
    """Return `$TOOL` in the flange frame for motions (n,) [m]: (4, 4) if the program has but one, else (n, 4, 4)."""
    return _each(program.tools, program.motions.tool[motion])


def base_of(program: Program, motion: Ints) -> Array:
    """Return `$BASE` in the root for motions (n,) [m]: (4, 4) if the program has but one, else (n, 4, 4)."""
    return _each(program.bases, program.motions.base[motion])


def _each(frames: Array, row: Ints) -> Array:
    """Return rows of frames (k, 4, 4): (4, 4) if there is but one, else (n, 4, 4)."""
    return np.asarray(frames[0] if len(frames) == 1 else frames.take(row, axis=0))


def pose_in_root(program: Program, motion: Ints, pose_in_base: Array, t: Place = 1.0) -> Array:
    """Return poses (n, 4, 4) in the root of poses in `$BASE` of their motions, at places t on them."""
    return _moved(program, motion, t, product(base_of(program, motion), pose_in_base), -1.0)


def pose_in_base(program: Program, motion: Ints, pose_in_root: Array, t: Place = 1.0) -> Array:
    """Return poses (n, 4, 4) in `$BASE` of their motions of poses in the root, at places t on them."""
    return product(inverse(base_of(program, motion)), _moved(program, motion, t, pose_in_root, 1.0))


def points_in_base(program: Program, motion: Ints, point_in_root: Array, t: Place = 1.0) -> Array:
    """Return points (n, 3) in `$BASE` of their motions of points in the root [m], at places t on them."""
    base = base_of(program, motion)
    if program.carriage is not None and t is not None:
        point_in_root = point_in_root + program.carriage.offset(motion, t)
    apart, rotation = point_in_root - base[..., :3, 3], base[..., :3, :3]
    return apart @ rotation if rotation.ndim == 2 else np.asarray(np.einsum("ni,nij->nj", apart, rotation))


def _moved(program: Program, motion: Ints, t: Place, pose: Array, sign: float) -> Array:
    """Return poses (n, 4, 4) as seen from the robot where its carriage has brought it (`sign` −1), or back (1)."""
    if program.carriage is not None and t is not None:
        pose = pose.copy()
        pose[..., :3, 3] += sign * program.carriage.offset(motion, t)
    return np.asarray(pose)


def wrench_in_root(program: Program, motion: Ints, wrench_in_base: Array) -> Array:
    """Return wrenches (n, 6) turned from `$BASE` axes to root axes."""
    rotation = base_of(program, motion)[..., :3, :3]
    pairs = wrench_in_base.reshape((-1, 3) if rotation.ndim == 2 else (-1, 2, 3))
    return np.asarray(pairs @ np.swapaxes(rotation, -1, -2)).reshape(-1, 6)


def columns_in_root(program: Program, motion: Ints, columns_in_base: Array) -> Array:
    """Return columns (n, 2, 3, m) of force and moment in root axes of columns in `$BASE` axes."""
    return np.asarray(np.einsum("...ij,...hjm->...him", base_of(program, motion)[..., :3, :3], columns_in_base))


def flange_from_tcp(program: Program, motion: Ints, pose_tcp_in_base: Array, t: Place = 1.0) -> Array:
    """Return flange poses in the root (N, 4, 4) for tool frames in `$BASE` of motions (N,), at places t on them."""
    from_tool = _each(inverse(program.tools), program.motions.tool[motion])
    pose = product(base_of(program, motion), pose_tcp_in_base, from_tool)
    return _moved(program, motion, t, pose, -1.0)


def flange_points(program: Program, motion: Ints, pose_tcp_in_base: Array, point: Array, t: Place = 1.0) -> Array:
    """Return the position (N, 3) in the root of a point (3,) of the flange frame [m]; else as `flange_from_tcp`."""
    m = program.motions
    in_tool = inverse(program.tools) @ np.append(point, 1.0)
    if len(program.bases) == len(program.tools) == 1:
        in_base = np.einsum("nij,j->ni", pose_tcp_in_base, in_tool[0])
        out = np.einsum("ij,nj->ni", program.bases[0, :3], in_base)
    else:
        placed = pose_tcp_in_base @ in_tool[m.tool[motion]][..., None]
        out = (program.bases[m.base[motion], :3] @ placed)[..., 0]
    if program.carriage is not None and t is not None:
        out = out - program.carriage.offset(motion, t)
    return np.asarray(out)
