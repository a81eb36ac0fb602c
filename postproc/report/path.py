"""Paths of results: points to draw them by, and their operations."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc import toolpath
from postproc.correction import Result, Statistics, statistics
from postproc.frames import Array, norm
from postproc.operations import operations as program_operations
from postproc.program import CIRC, Ints, Program

_STEP = tuple(np.radians([10.0, 20.0]))
"""Smallest and largest angle of a chord that an arc is drawn by (assumed)."""
_FINEST = 1e-4
"""Smallest angle of a chord where its distance from the arc is given [rad] (assumed)."""
_UNSEEN = 1.0 / 2000.0
"""Largest distance of a chord from its arc, as a share of the extent of the path: half a pixel (assumed)."""


def drawn_path(result: Result, chord: float | None = None) -> tuple[Array, Ints]:
    """Return points along the nominal path, and the target to which each leads.

    :param chord: largest distance of the chords of an arc from it [m]; None = `_UNSEEN` of the extent of the path.

    :returns: positions (P, 3) [m] in `$BASE`, or in the robot root if the program has more than one base; and the row
        (P,) of the target at the end of the piece that the point lies on. Each target is the last of its points.
    """
    motions = result.program.motions
    position, row = result.nominal.position, np.arange(len(result))
    arc_rows = np.flatnonzero(motions.kind[result.motion] == CIRC)
    if len(arc_rows):
        arcs = _ArcPieces.of(result, arc_rows)
        distance = _UNSEEN * float(np.ptp(position, axis=0).max()) if chord is None else chord
        count = np.ones(len(result), dtype=np.int64)
        count[arc_rows] = arcs.chord_counts(distance, _STEP[0] if chord is None else _FINEST)
        row, share = toolpath.even_places(row, count)
        remaining_share = 1.0 - share
        inner = np.flatnonzero(remaining_share > 0.0)  # the others are targets
        position = position[row]
        position[inner] = arcs.points(np.searchsorted(arc_rows, row[inner]), remaining_share[inner])
    bases = result.program.bases
    if len(bases) > 1:
        base = bases[motions.base[result.motion[row]]]
        position = np.einsum("nij,nj->ni", base[:, :3, :3], position) + base[:, :3, 3]
    return np.asarray(position), row


class _ArcPieces(NamedTuple):
    """The A pieces of arcs and helices that lead to targets, in their `$BASE`.

    :param axis: (A, 3) point of the axis at the height of the end [m].
    :param radial: (A, 3) from there to the end [m].
    :param tangent: (A, 3) direction of travel at the end, as long as the radius [m].
    :param angle: (A,) of the piece [rad].
    :param rise: (A, 3) by which a helix rises along the axis on the piece [m].
    """

    axis: Array
    radial: Array
    tangent: Array
    angle: Array
    rise: Array

    @classmethod
    def of(cls, result: Result, rows: Ints) -> _ArcPieces:
        """Return the pieces to targets on arcs, `rows` (A,) of the result."""
        motions, motion, end = result.program.motions, result.motion[rows], result.nominal.position[rows]
        previous = np.maximum(rows - 1, 0)
        is_same_motion = (rows > 0) & (result.motion[previous] == motion)
        angle = motions.sweep[motion] * (result.t[rows] - np.where(is_same_motion, result.t[previous], 0.0))
        normal, radius_vector = motions.normal[motion], end - motions.centre[motion]
        height = np.einsum("ni,ni->n", radius_vector, normal)[:, None] * normal
        chord = end - result.nominal.position[previous]  # zero before the first target
        return cls(
            axis=motions.centre[motion] + height,
            radial=radius_vector - height,
            tangent=np.cross(normal, radius_vector),
            angle=angle,
            rise=np.einsum("ni,ni->n", chord, normal)[:, None] * normal,
        )

    def chord_counts(self, distance: float, least_angle: float) -> Ints:
        """Return the number of chords (A,) by which each piece is drawn.

        :param distance: largest distance of a chord from the arc [m].
        :param least_angle: smallest angle of a chord [rad].
        """
        step = 2.0 * np.arccos(np.clip(1.0 - distance / np.maximum(norm(self.radial), distance), -1.0, 1.0))
        step = np.clip(step, least_angle, _STEP[1])
        return np.asarray(np.maximum(np.ceil(self.angle / step), 1.0).astype(np.int64))

    def points(self, piece: Ints, remaining_share: Array) -> Array:
        """Return the points (n, 3) on pieces (n,) of which a share (n,) remains until their end [m]."""
        angle = self.angle[piece] * remaining_share
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        on_circle = self.axis[piece] + cos * self.radial[piece] - sin * self.tangent[piece]
        return np.asarray(on_circle - remaining_share[:, None] * self.rise[piece])


class Operation(Struct, frozen=True):
    """A run of targets.

    :param name: comment before it, or empty.
    :param tool: number of the tool that was changed to, or of the `$TOOL` of the program (from 1); 0 = not known.
    :param first: row of its first target, `last` of its last one.
    :param line: source line of its first target.
    :param cutting: number of cutting targets.
    :param before: deviation of the tool tip without correction [m], `after` with the program as written [m], along
        the cutting path.
    :param bound: 95 % bound of what remains on the part, or None.
    :param force: largest force [N].
    """

    name: str
    tool: int
    first: int
    last: int
    line: int
    cutting: int
    before: Statistics
    after: Statistics
    bound: Statistics | None
    force: float


def operations(result: Result) -> list[Operation]:
    """Return the operations that cut, in order; a program without any mark is one."""
    starts = operation_starts(result.program, result.motion)
    cutting_operations = []
    for first, end in pairwise([*sorted(starts), len(result)]):
        rows = slice(first, end)
        rapid = result.rapid[rows]
        cutting = int(np.count_nonzero(~rapid))
        if not cutting:
            continue
        name, tool = starts[first]
        begin = first + int(np.argmin(rapid))
        cutting_operations.append(
            Operation(
                name=name,
                tool=tool,
                first=first,
                last=end - 1,
                line=int(result.source_line[begin]),
                cutting=cutting,
                before=statistics(norm(result.deviation_before[rows]), result.cut_length[rows]),
                after=statistics(norm(result.deviation_after[rows]), result.cut_length[rows]),
                bound=None if result.bound is None else statistics(result.bound[rows], result.cut_length[rows]),
                force=float(result.force[rows].max(initial=0.0)),
            )
        )
    return cutting_operations


def operation_starts(program: Program, motion: Ints) -> dict[int, tuple[str, int]]:
    """Return the rows at which operations start: row → (name, tool).

    :param motion: (K,) row of `program.motions`, never decreasing.
    """
    operations_in_order = program_operations(program)
    rows = np.searchsorted(motion, [operation.first for operation in operations_in_order]).tolist()
    return {
        row: (operation.name, operation.tool)
        for row, operation in zip(rows, operations_in_order, strict=True)
        if row < len(motion)
    }
