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

CHORD_DISTANCE = 1e-6
"""Largest distance of an arc from the chords on which its samples are [m] (assumed)."""
_SAMPLE_SPACING = 2e-4
"""Smallest distance of samples along the path [m]: places between them are interpolated."""
_BALL_SPACING = 0.1
"""Distance of samples along the path of a ball cutter, in radii (assumed)."""
_MOST_SAMPLES = 1_500_000
"""Largest number of samples: on longer paths their distance is larger."""


class Frames(Struct, frozen=True, eq=False):
    """Transformations from the frames of a program into the frame of the mesh.

    :param drawn: (4, 4) from the frame of `drawn_path` [m].
    :param rotation: (K, 3, 3) from the `$BASE` of each target.
    """

    drawn: Array
    rotation: Array

    @classmethod
    def of(cls, result: Result, mesh_frame: Array | None) -> Frames:
        """Return the frames of a result.

        :param mesh_frame: (4, 4) frame of the mesh in the robot root [m]; None: the mesh is in the only `$BASE`.
        """
        bases = result.program.bases
        root_to_mesh = np.linalg.inv(bases[0] if mesh_frame is None else mesh_frame)
        base_to_mesh = root_to_mesh @ bases
        base_of_target = result.program.motions.base[result.motion]
        # drawn_path is in the only $BASE, or in the root if there are several
        return cls(base_to_mesh[0] if len(bases) == 1 else root_to_mesh, base_to_mesh[base_of_target, :3, :3])

    def to_mesh(self, vectors: Array) -> Array:
        """Return vectors (K, 3) of targets in the axes of the mesh; the given ones are in `$BASE` axes."""
        return np.asarray(np.einsum("kij,kj->ki", self.rotation, vectors))


class CutPath(Struct, frozen=True, eq=False):
    """Cutting pieces of the path of one tool: S samples close to each other, in the frame of the mesh.

    :param point: (S, 3) positions of the tip [m].
    :param step: (S, 3) vector along the path [m]; each sample is in the middle of its step.
    :param row: (S,) row of the result at the end of the piece of path.
    :param share: (S,) share of the piece from its start to the sample.
    :param share_step: (S,) share of the piece that the step covers.
    :param axis: (S, 3) unit vector from the tip to the spindle.
    :param deviation: (2, S, 3) deviation of the tip [m]: without correction, and with the program as written.
    :param deviation_step: (2, S, 3) change of the deviation over the step [m].
    :param tree: tree of the points, for searches of the nearest.
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
        """Return, on the steps of samples, the points that are nearest to places of contact.

        :param contact_point: (n, 3) places of contact [m].
        :param index: (n, k) k samples for each place.
        :returns: points (n, k, 3) [m], and (n, k) the share of its step at which each is (−0.5 … 0.5; 0: the sample).
        """
        step = self.step[index]
        share = self.step_share(contact_point[:, None] - self.point[index], step)
        return self.point[index] + share[..., None] * step, share

    @staticmethod
    def step_share(from_point: Array, step: Array) -> Array:
        """Return the shares (...,) of steps, −0.5 … 0.5, that are nearest to points.

        :param from_point: (..., 3) points relative to the samples [m].
        :param step: (..., 3) steps of the samples [m]; of a step of length 0 the share is 0.
        """
        square = np.einsum("...i,...i->...", step, step)
        share = np.einsum("...i,...i->...", from_point, step) / np.where(square > 0.0, square, 1.0)
        return np.asarray(np.clip(share, -0.5, 0.5))


def tool_path(result: Result, frames: Frames, is_chosen: Bools, ball_radius: float | None) -> CutPath | None:
    """Return the cutting path of one tool; None if it cuts nothing.

    :param is_chosen: (K,) True for the targets of this tool.
    :param ball_radius: radius of a ball cutter [m], for which samples may be farther apart, as the nearest place on the
        step of each sample counts. None: the cutter has another shape, or is unknown.
    """
    chords = _Chords.of(result, frames, is_chosen)
    if len(chords.row) == 0:
        return None
    length = norm(chords.step)
    spacing = max(_SAMPLE_SPACING, (ball_radius or 0.0) * _BALL_SPACING, float(length.sum()) / _MOST_SAMPLES)
    count = np.maximum(np.ceil(length / spacing), 1.0).astype(np.int64)
    chord, chord_share = toolpath.even_places(np.arange(len(count)), count, "middle")
    end = chords.row[chord]
    # the chords of a piece are of equal length
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
    """The C chords by which `drawn_path` follows the cutting pieces, in order, in the frame of the mesh.

    :param begin: (C, 3) start of each chord [m].
    :param step: (C, 3) vector from its start to its end [m].
    :param row: (C,) row of the result at the end of its piece.
    :param number: (C,) number of chords before it on its piece.
    :param count: (C,) number of all chords of its piece.
    """

    begin: Array
    step: Array
    row: Ints
    number: Ints
    count: Ints

    @classmethod
    def of(cls, result: Result, frames: Frames, is_chosen: Bools) -> _Chords:
        """Return the chords of the cutting pieces that lead to chosen targets.

        :param is_chosen: (K,) True for chosen targets.
        """
        position, row = drawn_path(result, CHORD_DISTANCE)
        position = position @ frames.drawn[:3, :3].T + frames.drawn[:3, 3]
        # the points of a piece are consecutive: searchsorted returns the first one
        number = np.arange(len(row)) - np.searchsorted(row, row)
        # a chord leads from each point to the next one; the first point of the path is the end of no chord
        cuts = (~result.rapid & is_chosen)[row[1:]]
        step, count = np.diff(position, axis=0), np.bincount(row, minlength=len(result))
        row = row[1:][cuts]
        return cls(position[:-1][cuts], step[cuts], row, number[1:][cuts], count[row])


def _axes_between(spindle: Array, end: Ints, share: Array) -> Array:
    """Return the unit vectors (S, 3) from the tip to the spindle at samples on pieces of path.

    :param spindle: (K, 3) unit vectors from the tip to the spindle at the targets.
    :param end: (S,) row of the target at the end of the piece of each sample.
    :param share: (S,) share of the piece from its start to the sample.
    """
    axis = (1.0 - share)[:, None] * spindle[np.maximum(end - 1, 0)] + share[:, None] * spindle[end]
    axis /= np.maximum(norm(axis), 1e-300)[:, None]  # 1e-300: no division by zero
    return axis


def piece_start(result: Result, end: Ints) -> Ints:
    """Return the rows (n,) of the targets whose values hold at the start of pieces of path.

    That is the previous target; after a rapid move the values at the end hold for the whole piece.

    :param end: (n,) row of the target at the end of each piece.
    """
    previous_row = np.maximum(end - 1, 0)
    return np.where(result.rapid[previous_row], end, previous_row)


def _spindle(result: Result) -> Array:
    """Return the unit vector from the tip to the spindle (K, 3) at each target, in `$BASE` axes."""
    any_travel = np.zeros((len(result), 3))  # z of FEED axes does not depend on the travel
    any_travel[:, 0] = 1.0
    axes, _ = axes_of_travel(result.nominal[:, :3, :3], any_travel, result.axis)
    return np.asarray(axes[:, :, 2])
