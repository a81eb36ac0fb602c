"""The cutting path of each tool in the frame of a part: samples of tip, axis and deviation."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from scipy.spatial import cKDTree

from postproc import toolpath
from postproc.correction import Result
from postproc.forces.axes import axes_of_travel
from postproc.frames import Array, norm
from postproc.program import Bools, Ints
from postproc.report.path import drawn_path

CHORD = 1e-6
"""Distance [m] of the samples on an arc from it (assumed)."""
_SPACING = 2e-4
"""Distance of samples along the path [m]: places between them are interpolated."""
_BALL_SPACING = 0.1
"""Largest distance of samples of the path of a ball, in radii (assumed)."""
_MOST_SAMPLES = 1_500_000
"""Samples of long programs: their distance grows so that memory does not."""


class Frames(Struct, frozen=True, eq=False):
    """Transformations from the frames of a program into that of the mesh.

    :param drawn: (4, 4) of the frame that `drawn_path` is in [m].
    :param rotation: (K, 3, 3) of the `$BASE` of each target.
    """

    drawn: Array
    rotation: Array

    @classmethod
    def of(cls, result: Result, mesh_frame: Array | None) -> Frames:
        """Return the frames of a result, for a mesh frame (4, 4) in the robot root or for a mesh in `$BASE`."""
        bases = result.program.bases
        root = np.linalg.inv(bases[0] if mesh_frame is None else mesh_frame)
        in_mesh = root @ bases
        of_target = result.program.motions.base[result.motion]
        return cls(in_mesh[0] if len(bases) == 1 else root, in_mesh[of_target, :3, :3])

    def to_mesh(self, vectors: Array) -> Array:
        """Return vectors (K, 3) of `$BASE` in the axes of the mesh."""
        return np.asarray(np.einsum("kij,kj->ki", self.rotation, vectors))


class CutPath(Struct, frozen=True, eq=False):
    """Cutting pieces of the path of one tool: S samples close to each other, in the frame of the mesh.

    :param point: (S, 3) positions of the tip [m].
    :param step: (S, 3) vector of the path over each sample, which is in its middle [m].
    :param row: (S,) row of the result at the end of the piece.
    :param share: (S,) of the piece that is behind the sample, and share_step: (S,) the share that its step covers.
    :param axis: (S, 3) direction from the tip to the spindle.
    :param deviation: (2, S, 3) of the tip [m]: without correction, and with the program as written.
    :param deviation_step: (2, S, 3) its change over the step [m].
    :param tree: of the points.
    """

    point: Array
    step: Array
    row: Ints
    share: Array
    share_step: Array
    axis: Array
    deviation: Array
    deviation_step: Array
    tree: cKDTree

    def nearest_points(self, contact_point: Array, index: Ints) -> tuple[Array, Array]:
        """Return the points of the path around samples that are nearest to places of contact.

        :param contact_point: (n, 3) places of contact [m].
        :param index: (n, k) samples next to each.
        :returns: points (n, k, 3) [m], and (n, k) how far along its step each is (−0.5 … 0.5).
        """
        step = self.step[index]
        offset = self.step_share(contact_point[:, None] - self.point[index], step)
        return self.point[index] + offset[..., None] * step, offset

    @staticmethod
    def step_share(from_point: Array, step: Array) -> Array:
        """Return the place (...,) along steps (..., 3) that is nearest to points (..., 3) relative to samples."""
        square = np.einsum("...i,...i->...", step, step)
        share = np.einsum("...i,...i->...", from_point, step) / np.where(square > 0.0, square, 1.0)
        return np.asarray(np.clip(share, -0.5, 0.5))


def tool_path(result: Result, frames: Frames, is_chosen: Bools, ball_radius: float | None) -> CutPath | None:
    """Return the cutting pieces to chosen targets (K,); None if there are none.

    :param ball_radius: of a ball [m]: larger samples suffice, as the nearest place on each counts. None: of another
        shape, or unknown.
    """
    position, row = drawn_path(result, CHORD)
    position = position @ frames.drawn[:3, :3].T + frames.drawn[:3, 3]
    # points of one target are consecutive: the number of a chord on its piece, from 1, and the chords of each piece
    number = np.arange(len(row)) - np.searchsorted(row, row) + 1
    pieces_of_row = np.bincount(row, minlength=len(result))
    begin, step = position[:-1], np.diff(position, axis=0)
    cuts = (~result.rapid & is_chosen)[row[1:]]
    begin, step, row, number = begin[cuts], step[cuts], row[1:][cuts], number[1:][cuts]
    if len(row) == 0:
        return None
    length = norm(step)
    spacing = max(_SPACING, (ball_radius or 0.0) * _BALL_SPACING, float(length.sum()) / _MOST_SAMPLES)
    count = np.maximum(np.ceil(length / spacing), 1.0).astype(np.int64)
    piece, piece_share = toolpath.even_places(np.arange(len(count)), count, "middle")
    end = row[piece]
    share = (number[piece] - 1 + piece_share) / pieces_of_row[end]
    share_step = 1.0 / (count[piece] * pieces_of_row[end])
    point = begin[piece] + piece_share[:, None] * step[piece]
    spindle = frames.to_mesh(_spindle(result))
    axis = (1.0 - share)[:, None] * spindle[np.maximum(end - 1, 0)] + share[:, None] * spindle[end]
    axis /= np.maximum(norm(axis), 1e-300)[:, None]  # 1e-300: opposite directions have no mean, and divide by no zero
    deviations = [frames.to_mesh(values) for values in (result.deviation_before, result.deviation_after)]
    start = np.stack([values[piece_start(result, end)] for values in deviations])
    change = np.stack([values[end] for values in deviations]) - start
    return CutPath(
        point,
        step[piece] / count[piece, None],
        end,
        share,
        share_step,
        axis,
        start + share[:, None] * change,
        share_step[:, None] * change,
        cKDTree(point),
    )


def piece_start(result: Result, end: Ints) -> Ints:
    """Return the rows (n,) with the values at the start of the pieces to rows `end` (n,): the rows before, if they cut.

    After a rapid move the values at the end hold for the whole piece.
    """
    previous_row = np.maximum(end - 1, 0)
    return np.where(result.rapid[previous_row], end, previous_row)


def _spindle(result: Result) -> Array:
    """Return the direction from the tip to the spindle (K, 3) at each target, `$BASE`."""
    any_travel = np.zeros((len(result), 3))  # z of FEED axes does not depend on the travel
    any_travel[:, 0] = 1.0
    axes, _ = axes_of_travel(result.nominal[:, :3, :3], any_travel, result.axis)
    return np.asarray(axes[:, :, 2])
