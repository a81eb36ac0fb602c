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
    chords = _Chords.of(result, frames, is_chosen)
    if len(chords.row) == 0:
        return None
    length = norm(chords.step)
    spacing = max(_SPACING, (ball_radius or 0.0) * _BALL_SPACING, float(length.sum()) / _MOST_SAMPLES)
    count = np.maximum(np.ceil(length / spacing), 1.0).astype(np.int64)
    chord, chord_share = toolpath.even_places(np.arange(len(count)), count, "middle")
    end = chords.row[chord]
    share = (chords.number[chord] + chord_share) / chords.count[chord]
    share_step = 1.0 / (count[chord] * chords.count[chord])
    point = chords.begin[chord] + chord_share[:, None] * chords.step[chord]
    deviations = [frames.to_mesh(values) for values in (result.deviation_before, result.deviation_after)]
    start = np.stack([values[piece_start(result, end)] for values in deviations])
    change = np.stack([values[end] for values in deviations]) - start
    return CutPath(
        point=point,
        step=chords.step[chord] / count[chord, None],
        row=end,
        share=share,
        share_step=share_step,
        axis=_axes_between(frames.to_mesh(_spindle(result)), end, share),
        deviation=start + share[:, None] * change,
        deviation_step=share_step[:, None] * change,
        tree=cKDTree(point),
    )


class _Chords(Struct, frozen=True, eq=False):
    """C chords of cutting pieces, in order: what `drawn_path` draws of arcs, in the frame of the mesh.

    :param begin: (C, 3) start of each, and step: (C, 3) the vector to its end [m].
    :param row: (C,) row of the result at the end of the piece.
    :param number: (C,) chords before it on its piece, and count: (C,) all chords of that piece.
    """

    begin: Array
    step: Array
    row: Ints
    number: Ints
    count: Ints

    @classmethod
    def of(cls, result: Result, frames: Frames, is_chosen: Bools) -> _Chords:
        """Return the chords of the cutting pieces to chosen targets (K,)."""
        position, row = drawn_path(result, CHORD)
        position = position @ frames.drawn[:3, :3].T + frames.drawn[:3, 3]
        number = np.arange(len(row)) - np.searchsorted(row, row)  # points of one target are consecutive
        cuts = (~result.rapid & is_chosen)[row[1:]]
        step, count = np.diff(position, axis=0), np.bincount(row, minlength=len(result))
        row = row[1:][cuts]
        return cls(position[:-1][cuts], step[cuts], row, number[1:][cuts], count[row])


def _axes_between(spindle: Array, end: Ints, share: Array) -> Array:
    """Return the directions (S, 3) from the tip to the spindle on pieces.

    :param spindle: (K, 3) at the targets; `end` (S,) the rows of those at which pieces end.
    :param share: (S,) of the pieces that is behind.
    """
    axis = (1.0 - share)[:, None] * spindle[np.maximum(end - 1, 0)] + share[:, None] * spindle[end]
    axis /= np.maximum(norm(axis), 1e-300)[:, None]  # 1e-300: opposite directions have no mean, and divide by no zero
    return axis


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
