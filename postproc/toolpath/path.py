"""The geometry of motions: poses, positions and directions of travel anywhere on them, in `$BASE` and in the root."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from msgspec import Struct

from postproc.chunks import Columns
from postproc.frames import (
    Array,
    angle_between,
    interpolate,
    inverse,
    norm,
    product,
    rotation_from_vector,
    sine_and_cosine,
)
from postproc.poses import Poses, angles_between
from postproc.program import CIRC, LIN, PTP, SPL, Bools, FrameColumns, Ints, Program, Starts, constant

_LEAST_TURN = 1e-6
"""Angle [rad] below which matrices of rotation may be interpolated entry by entry: its square is rounding."""

_SAME_LINE, _SAME_RATE = 5e-6, 1e-3
"""A motion continues the line before it if the corner between them is nearer to one line than this [m]; and any motion
only if it turns the tool by the same angle per length, to within this [rad/m] (assumed)."""
_SAME_TANGENT, _SAME_AXIS, _SAME_RADIUS = np.radians(5.0), np.radians(40.0), 0.1
"""It continues an arc if tangent and axis differ by less [rad], and the radius by less than this share (assumed)."""


class JointMoves(Protocol):
    """The tool on motions along which the axes, not the tool, are interpolated (PTP): see `under_load.PtpMoves`."""

    def at(self, motion: Ints, t: Array) -> Array:
        """Return the tool frames (n, 4, 4) in `$BASE` [m] at t (n,) in [0, 1] along PTP motions (n,)."""

    def turn(self, motion: Ints) -> Array:
        """Return the sum of the turns of all axes (n,) [rad] on PTP motions: no part of the arm turns by more."""


class Segments(Struct, frozen=True, eq=False):
    """The geometry of M motions: where each starts, how long it is. `$BASE` of the motion, metres.

    :param start: tool frames where the motions start.
    :param end: (M, 3) positions where they end [m]: those of the program, shared with it.
    :param length: (M,) path length of the TCP; 0 for PTP, of a piece of a spline the chord.
    :param travel: (M,) `length`, or the travel of the linear axis on this motion if that is longer [m].
    :param turn: (M,) angle between the orientations at start and end [rad], or how far the tool turns at
        most where it turns with the path or by rotary axes.
    :param arcs: the geometry of the arcs among them.
    :param joint_moves: the PTPs among them; None: the robot is not known, and only their ends are.
    """

    start: Starts
    end: Array
    length: Array
    travel: Array
    turn: Array
    arcs: Arcs
    joint_moves: JointMoves | None = None

    def begin(self, motion: Ints) -> Array:
        """Return the positions (n, 3) where motions (n,) start [m]."""
        # a motion starts where the one before it ends, unless its start pose is stored (`Starts.changed`): motion 0 is
        position = self.end.take(motion - 1, axis=0)
        index, is_changed = self.start.find_changed(motion)
        position[is_changed] = self.start.pose[index[is_changed], :3, 3]
        return position


class Arcs(Struct, frozen=True, eq=False):
    """The geometry of A arcs: at angle φ = sweep·t the TCP is at

        centre + (1 + growth·t)·(cos φ·radial + sin φ·across) + climb·t.

    :param motion: (A,) row of `Motions`, ascending.
    :param centre: (A, 3) on the axis, at the height of the start [m].
    :param radial: (A, 3) from there to the start [m].
    :param across: (A, 3) the same turned by 90° about the axis [m].
    :param climb: (A, 3) rise of a helix, along the axis [m].
    :param growth: (A,) of the radius: those programmed at start and end may differ by the tolerance of the control.
    :param sweep: (A,) angle [rad], > 0.
    """

    motion: Ints
    centre: Array
    radial: Array
    across: Array
    climb: Array
    growth: Array
    sweep: Array

    def position(self, motion: Ints, t: Array) -> Array:
        """Return the positions (n, 3) [m] at t (n,) in [0, 1] along motions (n,), which are arcs."""
        arc = np.searchsorted(self.motion, motion)
        sine, cosine = sine_and_cosine(self.sweep[arc] * t)
        scale = 1.0 + self.growth[arc] * t
        point = self.centre.take(arc, axis=0)  # `take` of rows is several times faster than an index
        for share, vector in ((scale * cosine, self.radial), (scale * sine, self.across), (t, self.climb)):
            point += share[:, None] * vector.take(arc, axis=0)
        return point

    def velocity(self, motion: Ints, t: Array) -> Array:
        """Return the derivatives (n, 3) of the positions by t [m], at t (n,) in [0, 1] along motions (n,)."""
        arc = np.searchsorted(self.motion, motion)
        sweep, growth = self.sweep[arc], self.growth[arc]
        sine, cosine = sine_and_cosine(sweep * t)
        scaled_sweep = sweep * (1.0 + growth * t)
        radial_rate = growth * cosine - scaled_sweep * sine
        tangential_rate = growth * sine + scaled_sweep * cosine
        radial, tangential, climb = (vector.take(arc, axis=0) for vector in (self.radial, self.across, self.climb))
        return np.asarray(radial_rate[:, None] * radial + tangential_rate[:, None] * tangential + climb)


class Toolpath(Columns, frozen=True, eq=False):
    """N samples of the nominal path.

    :param motion: (N,) row of `Motions`.
    :param t: (N,) place on the motion: near 0 at its start, 1 at its end.
    :param pose: N tool frames in the motion's `$BASE` [m].
    :param distance: (N,) travelled from the start of the motion [m].
    """

    motion: Ints
    t: Array
    pose: Poses
    distance: Array

    def __len__(self) -> int:
        return len(self.motion)

    @property
    def is_end(self) -> Bools:
        """(N,) True at the ends of motions."""
        return np.asarray(self.t == 1.0)


def starts(program: Program, end: Callable[[Ints], Array], start_flange_in_root: Array) -> Starts:
    """Return the start poses of all motions, each in the `$BASE` and with the `$TOOL` of its motion.

    :param end: returns the poses (n, 4, 4) at the ends of motions (n,) [m].
    :param start_flange_in_root: (4, 4) pose of the flange before the first motion [m].
    """
    m = program.motions
    if program.carriage is not None:
        start_flange_in_root = start_flange_in_root.copy()
        start_flange_in_root[:3, 3] += program.carriage.begin[0] * program.carriage.direction
    return Starts.of(
        FrameColumns(m.base, m.tool, program.bases, program.tools), end, start_flange_in_root, program.after
    )


def segments(program: Program, start_flange_in_root: Array) -> Segments:
    """Return the start poses and lengths of all motions.

    :param start_flange_in_root: (4, 4) pose of the flange before the first motion [m].
    """
    m = program.motions
    start = starts(program, m.target.__getitem__, start_flange_in_root)
    # as if each motion began where the one before ends; those that begin elsewhere are replaced
    previous_end, changed = m.target.take(np.arange(len(m)) - 1), start.changed
    length, shortest_turn = norm(m.target.position - previous_end.position), angles_between(previous_end, m.target)
    length[changed] = norm(m.target.position[changed] - start.pose[:, :3, 3])
    shortest_turn[changed] = angle_between(start.pose[:, :3, :3], m.target[changed, :3, :3])
    arcs = _arcs(program, start)
    length[arcs.motion] = np.hypot(norm(arcs.radial) * arcs.sweep, norm(arcs.climb))
    length[m.kind == PTP] = 0.0
    return Segments(
        start=start,
        end=m.target.position,
        length=length,
        travel=length if program.carriage is None else np.maximum(length, program.carriage.travel),
        turn=_turns(program, start, shortest_turn),
        arcs=arcs,
    )


def _turns(program: Program, start: Starts, shortest_turn: Array) -> Array:
    """Return how far the tool turns on each motion (M,) [rad], an upper bound.

    It is the angle between start and end, or more where the tool turns by rotary axes or with an arc.

    :param start: tool frames where the motions start.
    :param shortest_turn: (M,) angle between the orientations at start and end [rad].
    """
    m = program.motions
    turn = shortest_turn if shortest_turn.any() else constant(0.0, len(m))
    if program.turning is not None:
        turn = np.maximum(turn, program.turning.travel)
    if program.turns_with_path is not None:
        turn = turn.copy()
        rows = np.flatnonzero(program.turns_with_path)
        # the end turned back along the arc: without a turn relative to the path, it is the orientation at the start
        end_turned_back = _turn_about_arc_axis(program, rows, -m.sweep[rows], m.target[rows, :3, :3])
        # the turn of the path and that relative to it: their sum is an upper bound
        turn[rows] = m.sweep[rows] + angle_between(start.at(rows)[:, :3, :3], end_turned_back)
    return turn


def _arcs(program: Program, start: Starts) -> Arcs:
    """Return the A arcs of a program as helices about their axes, each in `$BASE` of its motion [m].

    :param start: tool frames where the motions start.
    """
    m = program.motions
    motion = np.flatnonzero(m.kind == CIRC)
    begin, end, normal = start.at(motion)[:, :3, 3], m.target.position[motion], m.normal[motion]
    # the programmed centre may be anywhere on the axis; `Arcs` needs the one at the height of the start
    height = np.einsum("ni,ni->n", begin - m.centre[motion], normal)[:, None] * normal
    climb = np.einsum("ni,ni->n", end - begin, normal)[:, None] * normal
    centre = m.centre[motion] + height
    radial = begin - centre
    growth = norm(end - centre - climb) / norm(radial) - 1.0
    return Arcs(motion, centre, radial, np.cross(normal, radial), climb, growth, m.sweep[motion])


def at(program: Program, path: Segments, motion: Ints, t: Array) -> Toolpath:
    """Return the nominal path at n places: motion (n,), and t (n,) along it, 0 at its start, 1 at its end.

    LIN: position linear, orientation by one rotation, or as rotary axes or the wrist turn (`Program.turning`). CIRC:
    rotation about the arc's axis with a linear rise; the orientation is interpolated as for LIN, in axes that turn with
    the arc where `Program.turns_with_path` is set. PTP: from joint interpolation (`Segments.joint_moves`); without a
    robot, its end everywhere. A piece of a spline is represented by its chord.
    """
    pose = program.motions.target.take(motion)
    _move_to_places(program, path, motion, t, pose.position)
    return Toolpath(
        motion, t, Poses(pose.position, _rotations(program, path, motion, t, pose)), path.length[motion] * t
    )


def _rotations(program: Program, path: Segments, motion: Ints, t: Array, end: Poses) -> Array:
    """Return the orientations (n, 3, 3) of the tool in `$BASE`, at t (n,) in [0, 1] along motions (n,).

    They are interpolated by one rotation, or turn with rotary axes, with the wrist or with the arc, see `at`.

    :param end: n tool frames at the ends of the motions. Their rotations are changed in place, unless these are fixed.
    """
    m = program.motions
    inner_rows = np.flatnonzero((t < 1.0) & (m.kind[motion] != PTP))
    joint_move_rows = _axis_interpolated_rows(program, path, motion, t)
    turn = path.turn[motion[inner_rows]]
    small_turn_rows = inner_rows[(turn > 0.0) & (turn < _LEAST_TURN)]
    turning_rows = inner_rows[turn >= _LEAST_TURN]
    rotation = end.rotation
    if end.is_fixed and len(small_turn_rows) + len(turning_rows) + len(joint_move_rows):
        rotation = rotation.copy()
    if len(small_turn_rows):
        start_rotation, end_rotation = path.start.at(motion[small_turn_rows])[:, :3, :3], rotation[small_turn_rows]
        remaining_share = (1.0 - t[small_turn_rows])[:, None, None]
        rotation[small_turn_rows] = end_rotation + remaining_share * (start_rotation - end_rotation)
    if program.turning is not None and len(turning_rows):
        is_swivel = program.turning.active[motion[turning_rows]]
        swivel_rows, turning_rows = turning_rows[is_swivel], turning_rows[~is_swivel]
        rotation[swivel_rows] = program.turning.at(motion[swivel_rows], t[swivel_rows])
    if program.turns_with_path is not None and len(turning_rows):
        follows_path = program.turns_with_path[motion[turning_rows]]
        arc_rows, turning_rows = turning_rows[follows_path], turning_rows[~follows_path]
        rotation[arc_rows] = _arc_orientations(program, path, motion[arc_rows], t[arc_rows])
    if len(turning_rows):
        motion_rows = motion[turning_rows]
        start_pose, end_pose = path.start.at(motion_rows), m.target[motion_rows]
        rotation[turning_rows] = interpolate(start_pose, end_pose, t[turning_rows])[:, :3, :3]
    if path.joint_moves is not None and len(joint_move_rows):
        rotation[joint_move_rows] = path.joint_moves.at(motion[joint_move_rows], t[joint_move_rows])[:, :3, :3]
    return rotation


def _axis_interpolated_rows(program: Program, path: Segments, motion: Ints, t: Array) -> Ints:
    """Return the indices (m,) of those of n places that are on PTPs before their ends.

    Empty if the robot, and with it the path of PTPs, is not known.

    :param motion: (n,) motion of each place; `t`: (n,) place along it, 0 at its start, 1 at its end.
    """
    if path.joint_moves is None:
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero((t < 1.0) & (program.motions.kind[motion] == PTP))


def _arc_orientations(program: Program, path: Segments, rows: Ints, t: Array) -> Array:
    """Return the tool orientations (n, 3, 3) in `$BASE` along arcs whose orientation follows the path.

    The orientation at the end is turned back by the sweep about the axis of the arc; between it and that at the start,
    orientations relative to the path are interpolated; they are then turned forward with the path.

    :param rows: (n,) the arcs, rows of `Motions`; `t`: (n,) place on each arc, 0 at its start, 1 at its end.
    """
    m = program.motions
    end = m.target[rows]
    end[:, :3, :3] = _turn_about_arc_axis(program, rows, -m.sweep[rows], end[:, :3, :3])
    relative_orientation = interpolate(path.start.at(rows), end, t)[:, :3, :3]
    return _turn_about_arc_axis(program, rows, t * m.sweep[rows], relative_orientation)


def _turn_about_arc_axis(program: Program, rows: Ints, angle: Array, orientation: Array) -> Array:
    """Return orientations (n, 3, 3) turned by angles (n,) [rad] about the axes of arcs, rows (n,) of `Motions`."""
    return np.asarray(rotation_from_vector(angle[:, None] * program.motions.normal[rows]) @ orientation)


def positions(program: Program, path: Segments, motion: Ints, t: Array) -> Array:
    """Return the nominal positions (n, 3) of the TCP in `$BASE` [m] at t (n,) in [0, 1] along motions (n,), as `at`."""
    position = program.motions.target.position[motion]
    _move_to_places(program, path, motion, t, position)
    return position


def _move_to_places(program: Program, path: Segments, motion: Ints, t: Array, position: Array) -> None:
    """Move positions (n, 3) [m] from the ends of motions (n,) to t (n,) in [0, 1] along them, in place.

    Before the end of a PTP without a known path, positions stay at its end.
    """
    inner_rows = np.flatnonzero(t < 1.0)
    kind = program.motions.kind[motion[inner_rows]]
    lines, arcs = inner_rows[(kind == LIN) | (kind == SPL)], inner_rows[kind == CIRC]
    if len(lines):
        begin = path.begin(motion[lines])
        position[lines] = begin + t[lines, None] * (position[lines] - begin)
    if len(arcs):
        position[arcs] = path.arcs.position(motion[arcs], t[arcs])
    joint_move_rows = _axis_interpolated_rows(program, path, motion, t)
    if path.joint_moves is not None and len(joint_move_rows):
        position[joint_move_rows] = path.joint_moves.at(motion[joint_move_rows], t[joint_move_rows])[:, :3, 3]


def tangent(program: Program, path: Segments, motion: Ints, t: Array) -> Array:
    """Return the unit direction of travel (n, 3) in `$BASE`, at t (n,) in [0, 1] along motions (n,).

    It is zero without travel, and for PTP.
    """
    m = program.motions
    direction = np.zeros((len(motion), 3))
    kind = m.kind[motion]
    lines = np.flatnonzero(((kind == LIN) | (kind == SPL)) & (path.length[motion] > 0.0))
    rows = motion[lines]
    direction[lines] = (m.target.position[rows] - path.begin(rows)) / path.length[rows, None]
    arcs = np.flatnonzero(kind == CIRC)
    if len(arcs):
        velocity = path.arcs.velocity(motion[arcs], t[arcs])
        direction[arcs] = velocity / norm(velocity)[:, None]
    return direction


def continues(program: Program, path: Segments) -> Bools:
    """Return which motions (M,) continue the line or the arc before: where they begin is no corner.

    Both motions have the same `$BASE` and `$TOOL`, turn the tool by as much per length, and are both rapid or not.
    """
    m = program.motions
    # row k is the pair of motions k and k + 1
    is_alike = np.logical_and.reduce([column[1:] == column[:-1] for column in (m.kind, m.base, m.tool, m.rapid)])
    is_alike &= np.minimum(path.length[:-1], path.length[1:]) > _SAME_LINE
    is_alike &= np.abs(np.diff(path.turn / np.maximum(path.length, _SAME_LINE))) < _SAME_RATE
    if program.after is not None:
        is_alike &= program.after[1:] == np.arange(len(m) - 1)
    lines, arcs = (np.flatnonzero(is_alike & (m.kind[1:] == kind)) for kind in (LIN, CIRC))
    continues_motion = np.zeros(len(m), dtype=bool)
    continues_motion[lines + 1] = _is_line_continued(program, path, lines)
    continues_motion[arcs + 1] = _is_arc_continued(program, path, arcs)
    return continues_motion


def _is_line_continued(program: Program, path: Segments, lines: Ints) -> Bools:
    """Return which lines (n,), rows of `Motions`, go straight on in the line that follows each."""
    m = program.motions
    begin, corner, end = path.begin(lines), m.target.position[lines], m.target.position[lines + 1]
    chord = end - begin
    corner_distance = norm(np.cross(corner - begin, chord)) / np.maximum(norm(chord), _SAME_LINE)
    return np.asarray((corner_distance < _SAME_LINE) & (np.einsum("ni,ni->n", corner - begin, end - corner) > 0.0))


def _is_arc_continued(program: Program, path: Segments, arcs: Ints) -> Bools:
    """Return which arcs (n,), rows of `Motions`, go on in the arc that follows each: tangent, axis and radius agree.

    They agree roughly only: a helix may be divided into arcs, each in a plane of its own.
    """
    m = program.motions
    end_tangent = tangent(program, path, arcs, np.ones(len(arcs)))
    start_tangent = tangent(program, path, arcs + 1, np.zeros(len(arcs)))
    radius, next_radius = (norm(path.arcs.radial[np.searchsorted(path.arcs.motion, rows)]) for rows in (arcs, arcs + 1))
    is_same_arc = (np.einsum("ni,ni->n", end_tangent, start_tangent) > np.cos(_SAME_TANGENT)) & (
        np.abs(next_radius - radius) < _SAME_RADIUS * radius
    )
    return np.asarray(is_same_arc & (np.einsum("ni,ni->n", m.normal[arcs], m.normal[arcs + 1]) > np.cos(_SAME_AXIS)))


class ArcsThroughPoints(NamedTuple):
    """Circular arcs through n triples of points, in the frame and unit of length of the points.

    :param centre: (n, 3).
    :param radial: (n, 3) vectors from the centres to the first points.
    :param tangential: (n, 3) the same turned by 90° in the direction of travel.
    :param angle: (n,) from the first points to the last ones, in (0, 2π) [rad].
    """

    centre: Array
    radial: Array
    tangential: Array
    angle: Array


def circle_through(a: Array, b: Array, c: Array) -> ArcsThroughPoints:
    """Return the arcs from points a through b to c, each (n, 3) in one frame and unit of length.

    Points on one line give centre a and vectors of zero.
    """
    ab, ac = b - a, c - a
    normal = np.cross(ab, ac)
    square = np.einsum("ni,ni->n", normal, normal)[:, None]
    # the height of b over ac is ‖normal‖/‖ac‖: below 1e-12 of ‖ac‖ the points are on one line in double precision
    is_straight = square[:, 0] <= 1e-24 * np.einsum("ni,ni->n", ac, ac) ** 2
    square = np.where(is_straight[:, None], 1.0, square)
    ab2, ac2 = np.einsum("ni,ni->n", ab, ab)[:, None], np.einsum("ni,ni->n", ac, ac)[:, None]
    centre = a + np.cross(ab2 * ac - ac2 * ab, normal) / (2.0 * square)
    unit = normal / np.sqrt(square)
    radial = a - centre
    tangential = np.cross(unit, radial)
    to_c = c - centre
    angle = np.arctan2(np.einsum("ni,ni->n", to_c, tangential), np.einsum("ni,ni->n", to_c, radial)) % (2.0 * np.pi)
    return ArcsThroughPoints(centre, radial, tangential, angle)


Place = Array | float | None
"""Places t on motions, 0 at the start, 1 at the end: (n,), or one for all motions. The linear axis is where it is then;
None: it is at 0, whatever the motion."""


def tool_of(program: Program, motion: Ints) -> Array:
    """Return `$TOOL` in the flange frame for motions (n,) [m]: (4, 4) if the program has but one, else (n, 4, 4)."""
    return _frames_of_rows(program.tools, program.motions.tool[motion])


def base_of(program: Program, motion: Ints) -> Array:
    """Return `$BASE` in the root for motions (n,) [m]: (4, 4) if the program has but one, else (n, 4, 4)."""
    return _frames_of_rows(program.bases, program.motions.base[motion])


def _frames_of_rows(frames: Array, row: Ints) -> Array:
    """Return the frames of rows (n,) of frames (k, 4, 4): (n, 4, 4), or the only one (4, 4), which broadcasts."""
    return np.asarray(frames[0] if len(frames) == 1 else frames.take(row, axis=0))


def pose_in_root(program: Program, motion: Ints, pose_in_base: Array, t: Place = 1.0) -> Array:
    """Return poses (n, 4, 4) [m] in the robot root, from poses in `$BASE` of motions (n,).

    :param t: place on the motions at which the linear axis has the robot, 0 at their starts, 1 at their ends; None: the
        axis is at 0.
    """
    pose = product(base_of(program, motion), pose_in_base)
    offset = _track_offset(program, motion, t)
    return pose if offset is None else _translated(pose, -offset)  # `$BASE` stays, the root moves away from it


def pose_in_base(program: Program, motion: Ints, pose_in_root: Array, t: Place = 1.0) -> Array:
    """Return poses (n, 4, 4) [m] in `$BASE` of motions (n,), from poses in the robot root.

    :param t: place on the motions at which the linear axis has the robot, see `pose_in_root`.
    """
    offset = _track_offset(program, motion, t)
    pose_at_zero = np.asarray(pose_in_root) if offset is None else _translated(pose_in_root, offset)
    return product(inverse(base_of(program, motion)), pose_at_zero)


def points_in_base(program: Program, motion: Ints, point_in_root: Array, t: Place = 1.0) -> Array:
    """Return points (n, 3) [m] in `$BASE` of motions (n,), from points in the robot root.

    :param t: place on the motions at which the linear axis has the robot, see `pose_in_root`.
    """
    base = base_of(program, motion)
    track_offset = _track_offset(program, motion, t)
    if track_offset is not None:
        point_in_root = point_in_root + track_offset
    vector, rotation = point_in_root - base[..., :3, 3], base[..., :3, :3]  # from the origin of `$BASE`
    return vector @ rotation if rotation.ndim == 2 else np.asarray(np.einsum("ni,nij->nj", vector, rotation))


def _track_offset(program: Program, motion: Ints, t: Place) -> Array | None:
    """Return how far (n, 3) [m] the linear axis has moved the robot root from where it is at axis position 0.

    :param t: place on the motions (n,), see `pose_in_root`.
    :returns: in axes of the root; None: the robot has no linear axis, or it is at 0.
    """
    return None if program.carriage is None or t is None else program.carriage.offset(motion, t)


def _translated(pose: Array, offset: Array) -> Array:
    """Return copies of poses (n, 4, 4) [m] translated by offsets (n, 3) [m]."""
    pose = pose.copy()
    pose[..., :3, 3] += offset
    return np.asarray(pose)


def wrench_in_root(program: Program, motion: Ints, wrench_in_base: Array) -> Array:
    """Return wrenches (n, 6) [N, N·m] of motions (n,) rotated from `$BASE` axes to root axes, about the same point."""
    rotation = base_of(program, motion)[..., :3, :3]
    # rows of forces and moments; with a matrix for each motion, a force and a moment for each matrix
    vectors = wrench_in_base.reshape((-1, 3) if rotation.ndim == 2 else (-1, 2, 3))
    return np.asarray(vectors @ np.swapaxes(rotation, -1, -2)).reshape(-1, 6)


def directions_in_root(program: Program, motion: Ints, direction_in_base: Array) -> Array:
    """Return vectors (n, 3) of motions (n,) rotated from `$BASE` axes to root axes."""
    return np.asarray(np.einsum("...ij,...j->...i", base_of(program, motion)[..., :3, :3], direction_in_base))


def columns_in_root(program: Program, motion: Ints, columns_in_base: Array) -> Array:
    """Return columns (n, 2, 3, m) of force and moment in root axes of columns in `$BASE` axes."""
    return np.asarray(np.einsum("...ij,...hjm->...him", base_of(program, motion)[..., :3, :3], columns_in_base))


def flange_from_tcp(program: Program, motion: Ints, pose_tcp_in_base: Array, t: Place = 1.0) -> Array:
    """Return flange poses (N, 4, 4) [m] in the robot root, from tool frames (N, 4, 4) in `$BASE` of motions (N,).

    :param t: place on the motions at which the linear axis has the robot, see `pose_in_root`.
    """
    flange_in_tool = _frames_of_rows(inverse(program.tools), program.motions.tool[motion])
    pose = product(base_of(program, motion), pose_tcp_in_base, flange_in_tool)
    offset = _track_offset(program, motion, t)
    return pose if offset is None else _translated(pose, -offset)


def flange_points(program: Program, motion: Ints, pose_tcp_in_base: Array, point: Array, t: Place = 1.0) -> Array:
    """Return positions in the root (N, 3) of a point (3,) of the flange frame [m].

    :param motion: (N,) rows of `Motions`, `pose_tcp_in_base` (N, 4, 4) the tool frames in their `$BASE` [m].
    :param t: place on the motions at which the linear axis has the robot, see `pose_in_root`.
    """
    m = program.motions
    point_in_tool = inverse(program.tools) @ np.append(point, 1.0)  # a row for each tool; homogeneous
    if len(program.bases) == len(program.tools) == 1:  # the usual case, without a copy of the frames for each row
        point_in_base = np.einsum("nij,j->ni", pose_tcp_in_base, point_in_tool[0])
        position = np.einsum("ij,nj->ni", program.bases[0, :3], point_in_base)
    else:
        column_in_base = pose_tcp_in_base @ point_in_tool[m.tool[motion]][..., None]
        position = (program.bases[m.base[motion], :3] @ column_in_base)[..., 0]
    offset = _track_offset(program, motion, t)
    return np.asarray(position if offset is None else position - offset)
