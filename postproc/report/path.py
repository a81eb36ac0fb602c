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

_LEAST_CHORD_ANGLE, _MOST_CHORD_ANGLE = np.radians([10.0, 20.0]).tolist()
"""Smallest and largest angle of the chords by which an arc is drawn [rad] (assumed)."""
_LEAST_STATED_CHORD_ANGLE = 1e-4
"""Smallest angle of a chord if its distance from the arc is stated [rad] (assumed)."""
_CHORD_DISTANCE_SHARE = 1.0 / 2000.0
"""Largest distance of a chord from its arc, as a share of the extent of the path: half a pixel (assumed)."""


def drawn_path(result: Result, chord: float | None = None) -> tuple[Array, Ints]:
    """Return points along the nominal path, and the target to which each point leads.

    A piece is the path from one target to the next. Straight pieces have one point, their target; pieces of arcs have
    points before it.

    :param chord: largest distance of an arc from its chords [m]; None: `_CHORD_DISTANCE_SHARE` of the extent of the
        path.

    :returns: positions (P, 3) [m] in `$BASE`, or in the robot root if the program has more than one base; and for each
        point the row (P,) of the target at the end of its piece. Each target is the last point of its piece.
    """
    motions = result.program.motions
    position, row = result.nominal.position, np.arange(len(result))
    arc_rows = np.flatnonzero(motions.kind[result.motion] == CIRC)
    if len(arc_rows):
        arcs = _ArcPieces.of(result, arc_rows)
        distance = _CHORD_DISTANCE_SHARE * float(np.ptp(position, axis=0).max()) if chord is None else chord
        count = np.ones(len(result), dtype=np.int64)
        count[arc_rows] = arcs.chord_counts(
            distance, _LEAST_CHORD_ANGLE if chord is None else _LEAST_STATED_CHORD_ANGLE
        )
        row, share = toolpath.even_places(row, count)
        remaining_share = 1.0 - share
        inner = np.flatnonzero(remaining_share > 0.0)  # points before a target
        position = position[row]
        # searchsorted: index of the row of a target in arc_rows, which contains it
        position[inner] = arcs.points(np.searchsorted(arc_rows, row[inner]), remaining_share[inner])
    bases = result.program.bases
    if len(bases) > 1:
        base = bases[motions.base[result.motion[row]]]
        position = np.einsum("nij,nj->ni", base[:, :3, :3], position) + base[:, :3, 3]
    return np.asarray(position), row


class _ArcPieces(NamedTuple):
    """The A pieces of arcs and helices that lead to targets, in their `$BASE`.

    :param axis: (A, 3) point of the axis at the height of the end of the piece [m].
    :param radial: (A, 3) vector from `axis` to the end of the piece [m].
    :param tangent: (A, 3) direction of travel at the end of the piece, as long as the radius [m].
    :param angle: (A,) angle of the piece [rad].
    :param rise: (A, 3) vector by which a helix rises along its axis on the piece [m]; 0 of an arc.
    """

    axis: Array
    radial: Array
    tangent: Array
    angle: Array
    rise: Array

    @classmethod
    def of(cls, result: Result, rows: Ints) -> _ArcPieces:
        """Return the pieces that lead to targets on arcs and helices.

        :param rows: (A,) rows of these targets in the result.
        """
        motions, motion, end = result.program.motions, result.motion[rows], result.nominal.position[rows]
        previous = np.maximum(rows - 1, 0)
        # t of the piece begins at the previous target if that is on the same motion, else at 0
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

        A chord of angle a is r (1 − cos(a/2)) from its arc.

        :param distance: largest distance of the arc from a chord [m]; the limits of the angle go before it.
        :param least_angle: smallest angle of a chord [rad]; the largest is `_MOST_CHORD_ANGLE`.
        """
        radius = np.maximum(norm(self.radial), distance)
        chord_angle = 2.0 * np.arccos(np.clip(1.0 - distance / radius, -1.0, 1.0))
        chord_angle = np.clip(chord_angle, least_angle, _MOST_CHORD_ANGLE)
        return np.asarray(np.maximum(np.ceil(self.angle / chord_angle), 1.0).astype(np.int64))

    def points(self, piece: Ints, remaining_share: Array) -> Array:
        """Return points (n, 3) on pieces, in their `$BASE` [m].

        :param piece: (n,) index of the piece of each point.
        :param remaining_share: (n,) share of the piece from the point to the end of the piece.
        """
        angle = self.angle[piece] * remaining_share
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        on_circle = self.axis[piece] + cos * self.radial[piece] - sin * self.tangent[piece]
        return np.asarray(on_circle - remaining_share[:, None] * self.rise[piece])


class Operation(Struct, frozen=True):
    """An operation: consecutive targets with one tool.

    :param name: comment before the operation, or empty.
    :param tool: number of the tool that was changed to, or of the `$TOOL` of the program (from 1); 0 = not known.
    :param first: row of its first target, `last` row of its last target.
    :param line: source line of its first cutting target.
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
    """Return the operations that cut, in order; a program that does not tell operations apart has one."""
    starts = operation_starts(result.program, result.motion)  # first target → name and tool
    cutting_operations = []
    for first, end in pairwise([*sorted(starts), len(result)]):
        rows = slice(first, end)
        rapid = result.rapid[rows]
        cutting_count = int(np.count_nonzero(~rapid))
        if not cutting_count:
            continue
        name, tool = starts[first]
        first_cut = first + int(np.argmin(rapid))  # the first target that is not rapid
        cutting_operations.append(
            Operation(
                name=name,
                tool=tool,
                first=first,
                last=end - 1,
                line=int(result.source_line[first_cut]),
                cutting=cutting_count,
                before=statistics(norm(result.deviation_before[rows]), result.cut_length[rows]),
                after=statistics(norm(result.deviation_after[rows]), result.cut_length[rows]),
                bound=None if result.bound is None else statistics(result.bound[rows], result.cut_length[rows]),
                force=float(result.force[rows].max(initial=0.0)),
            )
        )
    return cutting_operations


def operation_starts(program: Program, motion: Ints) -> dict[int, tuple[str, int]]:
    """Return the operations by the target at which they start: row of the target → (name, tool).

    Of operations without a target only the last before a target counts; operations after the last target are left out.

    :param motion: (K,) row of `program.motions` of each target, never decreasing.
    """
    operations_in_order = program_operations(program)
    rows = np.searchsorted(motion, [operation.first for operation in operations_in_order]).tolist()
    return {
        row: (operation.name, operation.tool)
        for row, operation in zip(rows, operations_in_order, strict=True)
        if row < len(motion)
    }
