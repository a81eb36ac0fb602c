"""Axes of forces: FEED axes (along the travel, along the spindle, square to both), and rotations into `$BASE`."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.forces.sources import FEED, TOOL
from postproc.frames import RAD_PER_DEG, Array, norm
from postproc.program import CIRC, Bools, Ints, Program
from postproc.toolpath import Segments, Toolpath, at, tangent

_SPINDLE = {"+Z": (2, 1.0), "-Z": (2, -1.0), "+X": (0, 1.0), "-X": (0, -1.0)}
"""Axis of the tool frame that points from the spindle to the tip → its column, and the sign of the axis."""
_PARALLEL_SINE = 1e-3
"""Sine of the angle between travel and spindle below which the travel is along the spindle (assumed)."""
LEAST_TURN = 1e-6
"""Rotations of the tool below this [rad] count as none (assumed)."""
_LEAST_ANGLE = 45.0 * RAD_PER_DEG
"""Smallest angle between travel and spindle at which the path runs across the spindle (assumed)."""
_TANGENT_OFFSET = 0.01
"""Where an arc is tangent to the spindle, its direction is that at this distance from the point (share of the arc)
(assumed)."""


def feed_axes(program: Program, path: Segments, sample: Toolpath, axis: str, inherited_travels: Array) -> Array:
    """Return the FEED axes (n, 3, 3) as columns in `$BASE`: those of forces that are stated relative to the travel.

    z is along the spindle, from the tip to the spindle; x is along the component of the travel perpendicular to z;
    y = z × x.

    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param inherited_travels: (M, 3) x for motions along the spindle: that of the last motion across it, see
        `last_travel`; where it is NaN, any x perpendicular to z.
    """
    z = _towards_spindle(sample, axis)
    x, sine = _perpendicular_directions(z, tangent(program, path, sample.motion, sample.t))
    parallel_rows = np.flatnonzero(sine < _PARALLEL_SINE)
    if len(parallel_rows):
        x[parallel_rows] = _directions_along_spindle(program, path, sample.take(parallel_rows), axis, inherited_travels)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _directions_along_spindle(
    program: Program, path: Segments, sample: Toolpath, axis: str, inherited_travels: Array
) -> Array:
    """Return x (n, 3) of FEED axes in `$BASE` at samples whose travel is along the spindle.

    Where an arc is tangent to the spindle, x is that at a point of the arc nearby. On a motion along the spindle, x is
    that of the last motion across the spindle; without such a motion, any direction perpendicular to the spindle.

    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param inherited_travels: (M, 3) x for motions along the spindle, see `last_travel`; NaN without a motion across it.
    """
    z, t = _towards_spindle(sample, axis), sample.t
    offset_t = np.where(t > _TANGENT_OFFSET, t - _TANGENT_OFFSET, t + _TANGENT_OFFSET)
    x, sine = _perpendicular_directions(z, tangent(program, path, sample.motion, offset_t))
    # motions that are parallel to the spindle all along
    rows = np.flatnonzero(sine < _PARALLEL_SINE)
    inherited_travel = inherited_travels[sample.motion[rows]]
    # column − 2 is the next column of the tool frame, perpendicular to the spindle: 2 → 0, 0 → −2, which is 1
    tool_axis = sample.pose[rows, :3, _SPINDLE[axis][0] - 2]
    fallback = np.where(np.isnan(inherited_travel), tool_axis, inherited_travel)
    x[rows] = _perpendicular_directions(z[rows], fallback)[0]
    return x


def is_arc_across(program: Program, path: Segments, arcs: Ints, axis: str) -> Bools:
    """Return True for arcs (n,), rows of `Motions`, whose travel keeps at least 45° from the direction of the spindle.

    On these arcs FEED axes turn about as fast as the travel. Near the direction of the spindle they swing by up to half
    a turn, the faster the nearer, and at that direction they jump.

    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    """
    m = program.motions
    # the angle of the spindle to the axis of the arc at the worse end, half the turn of the tool, and the pitch of a
    # helix add up to the largest deviation of the travel from the plane across the spindle
    z = _towards_spindle(at(program, path, arcs, np.ones(len(arcs))), axis)
    start = path.start.at(arcs)[:, :3, _SPINDLE[axis][0]]
    angles_to_axis = [
        np.arccos(np.minimum(np.abs(np.einsum("ni,ni->n", m.normal[arcs], vector)), 1.0)) for vector in (z, start)
    ]
    row = np.searchsorted(path.arcs.motion, arcs)  # of each arc in `path.arcs`, which are in the order of motions
    pitch = np.arctan2(norm(path.arcs.climb[row]), norm(path.arcs.radial[row]) * path.arcs.sweep[row])
    return np.asarray(np.maximum(*angles_to_axis) + 0.5 * path.turn[arcs] + pitch < _LEAST_ANGLE)


def is_line_across(program: Program, path: Segments, lines: Ints, axis: str) -> Bools:
    """Return True for straight motions (n,), rows of `Motions`, whose travel keeps at least 45° from the spindle.

    Nearer to it, FEED axes may swing by up to half a turn while the tool turns a little.

    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    """
    # the smallest angle between travel and spindle is at least that at the ends, minus half the turn of the tool
    ends = at(program, path, lines, np.ones(len(lines)))
    travel = tangent(program, path, lines, ends.t)
    start = path.start.at(lines)[:, :3, _SPINDLE[axis][0]]
    cosines = [np.abs(np.einsum("ni,ni->n", z, travel)) for z in (_towards_spindle(ends, axis), start)]
    smallest_angle = np.arccos(np.minimum(np.maximum(*cosines), 1.0))
    return np.asarray(smallest_angle - 0.5 * path.turn[lines] > _LEAST_ANGLE)


def axes_of_travel(orientation: Array, travel: Array, axis: str) -> tuple[Array, Bools]:
    """Return the FEED axes (n, 3, 3) of tool orientations (n, 3, 3) and travel directions (n, 3), all in `$BASE`.

    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :returns: the axes as columns, and (n,) False where the travel is along the spindle and the axes are undefined.
    """
    column, sign = _SPINDLE[axis]
    z = -sign * orientation[:, :, column]
    x, sine = _perpendicular_directions(z, travel)
    return np.stack([x, np.cross(z, x), z], axis=-1), np.asarray(sine >= _PARALLEL_SINE)


def last_travel(program: Program, path: Segments, axis: str) -> tuple[Array, Bools]:
    """Return for each motion the travel direction of the last motion across the spindle before it.

    Programs often begin with a plunge: motions before the first motion across the spindle get the direction of this.

    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :returns: (M, 3) unit vectors in `$BASE` of each motion, NaN if no motion runs across the spindle, or if the tool
        has turned into that direction; and (M,) True for motions that need it, along the spindle or without travel.
    """
    m = program.motions
    rows, end = np.arange(len(m)), np.ones(len(m))
    z = _towards_spindle(at(program, path, rows, end), axis)
    x, is_undefined = _end_directions(program, path, z)
    source = _last_motion_across(program.predecessors, is_undefined)  # the motion whose direction each motion gets
    # before the first motion across the spindle, this motion is the source; −1 if no motion runs across it
    source[source < 0] = -1 if is_undefined.all() else int(np.argmin(is_undefined))
    rotation = program.bases[:, :3, :3]
    travel_in_root = np.einsum("nij,nj->ni", rotation[m.base[source]], x[source])
    inherited_travel = np.einsum("nji,nj->ni", rotation[m.base], travel_in_root)
    inherited_travel[source < 0] = np.nan
    has_turned = _perpendicular_directions(z, inherited_travel)[1] < _PARALLEL_SINE  # the tool, into that direction
    inherited_travel[has_turned] = np.nan
    return inherited_travel, is_undefined


def _end_directions(program: Program, path: Segments, z: Array) -> tuple[Array, Bools]:
    """Return the travel directions across the spindle (M, 3) at the ends of motions, and True (M,) if there is none.

    An arc that ends along the spindle has the direction of a point shortly before its end.

    :param z: (M, 3) unit directions from the tip to the spindle at the ends of motions, `$BASE`.
    """
    m = program.motions
    rows, end = np.arange(len(m)), np.ones(len(m))
    x, sine = _perpendicular_directions(z, tangent(program, path, rows, end))
    tangent_arcs = np.flatnonzero((m.kind == CIRC) & (sine < _PARALLEL_SINE))
    x[tangent_arcs], sine[tangent_arcs] = _perpendicular_directions(
        z[tangent_arcs], tangent(program, path, tangent_arcs, end[tangent_arcs] - _TANGENT_OFFSET)
    )
    return x, sine < _PARALLEL_SINE


def _last_motion_across(previous: Ints, is_undefined: Bools) -> Ints:
    """Return for each motion the last motion executed before it that defines a travel direction (M,); −1: none.

    :param previous: (M,) the motion at whose end each motion begins, see `Program.after`.
    :param is_undefined: (M,) True for motions without a travel direction.
    """
    rows = np.arange(len(is_undefined))
    previous = np.append(np.where(previous == rows, -1, previous), -1)  # the last row, −1, is the start of the program
    # a motion with a direction is its own source, any other first points to the motion before it
    source = np.where(np.append(is_undefined, False), previous, np.append(rows, -1))
    for _ in range(len(is_undefined).bit_length()):  # each repetition follows twice as many motions
        source = source[source]
    return np.asarray(source[previous[:-1]])


def _towards_spindle(sample: Toolpath, axis: str) -> Array:
    """Return the unit directions from the tip to the spindle (n, 3) at samples, `$BASE`.

    :param axis: axis of the tool frame that points from the spindle to the tip, a key of `_SPINDLE`.
    """
    column, sign = _SPINDLE[axis]
    return np.asarray(-sign * sample.pose[:, :3, column])


def _perpendicular_directions(z: Array, travel: Array) -> tuple[Array, Array]:
    """Return unit vectors (n, 3) along the component of the travel perpendicular to z, and its length (n,).

    Where the component has no length, the vector is zero.

    :param z: (n, 3) unit vectors, and `travel` (n, 3) vectors in the same axes.
    """
    component = travel - np.einsum("ni,ni->n", travel, z)[:, None] * z
    length = norm(component)
    return component / np.where(length > 0.0, length, 1.0)[:, None], length


class Axes(Struct, frozen=True, eq=False):
    """The axes of forces along a program.

    Forces are columns (n, 2, 3, m): force and moment, m vectors of each.

    :param program: the program, `path` the geometry of its motions.
    :param spindle: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param travel: (M, 3) x of `FEED` for motions along the spindle, see `last_travel`; (0, 3) without FEED.
    """

    program: Program
    path: Segments
    spindle: str
    travel: Array

    def in_base_axes(self, columns: Array, frame: Ints, sample: Toolpath) -> Array:
        """Return columns (n, 2, 3, m) in `$BASE` axes.

        :param columns: (n, 2, 3, m) in the axes of `frame` (n,), `BASE`, `TOOL` or `FEED`, at samples.
        """
        return self._rotate_columns(columns, frame, sample, "nij,nhjm->nhim")

    def in_frame_axes(self, columns: Array, frame: Ints, sample: Toolpath) -> Array:
        """Return columns (n, 2, 3, m) in the axes of `frame` (n,), `BASE`, `TOOL` or `FEED`, at samples.

        :param columns: (n, 2, 3, m) in `$BASE` axes.
        """
        return self._rotate_columns(columns, frame, sample, "nji,nhjm->nhim")

    def _rotate_columns(self, columns: Array, frame: Ints, sample: Toolpath, product: str) -> Array:
        """Return columns (n, 2, 3, m) of force and moment rotated between their frames and `$BASE`.

        :param frame: (n,) `BASE`, `TOOL` or `FEED`, whose axes are those at the samples.
        :param product: subscripts of einsum that apply the rotation from a frame to `$BASE`, or its transpose.
        """
        rotated_columns = columns.copy()
        for code in (TOOL, FEED):
            rows = np.flatnonzero(frame == code)
            rows = rows[columns[rows].any(axis=(1, 2, 3))]  # zero needs no rotation
            if len(rows):
                samples = sample.take(rows)
                rotation = samples.pose[:, :3, :3]
                if code == FEED:
                    rotation = feed_axes(self.program, self.path, samples, self.spindle, self.travel)
                rotated_columns[rows] = np.einsum(product, rotation, columns[rows])
        return rotated_columns

    def columns_at_start(self, columns: Array, frame: Ints) -> Array:
        """Return the forces at the start of motions, which are those at the end of the motion before.

        :param columns: (M, 2, 3, m) at the end of each of M motions, in the axes of `frame` (M,): force and moment, X
            to Z, m vectors.
        :returns: (M, 2, 3, m) in `$BASE` axes of each motion; zero at the start of the program.
        """
        bases, base_index = self.program.bases, self.program.motions.base
        previous = self.program.predecessors  # −1: the motion begins the program
        at_ends = columns.copy()
        rows = np.flatnonzero((frame == TOOL) | (frame == FEED))
        end_samples = at(self.program, self.path, rows, np.ones(len(rows)))
        at_ends[rows] = self.in_base_axes(columns[rows], frame[rows], end_samples)
        at_starts = np.where((previous >= 0)[:, None, None, None], at_ends[previous], 0.0)
        # where `$BASE` changes: from that of the motion before, through the root, to that of the motion
        changed_rows = np.flatnonzero(base_index != base_index[previous])
        root_from_previous = bases[base_index[previous[changed_rows]], :3, :3]
        base_from_root = np.swapaxes(bases[base_index[changed_rows], :3, :3], 1, 2)
        rotation = base_from_root @ root_from_previous
        at_starts[changed_rows] = np.einsum("nij,nhjm->nhim", rotation, at_starts[changed_rows])
        return at_starts

    def wrench_at_start(self, wrench: Array, frame: Ints) -> Array:
        """Return the wrench (M, 6) [N, N·m] at the start of motions, that at the end of the motion before.

        :param wrench: (M, 6) wrench at the end of each motion [N, N·m], in the axes of `frame` (M,).
        :returns: in `$BASE` axes of each motion; zero at the start of the program.
        """
        return self.columns_at_start(wrench.reshape(-1, 2, 3, 1), frame).reshape(-1, 6)
