"""The targets of a program: samples that hold the tolerance, pieces of arcs, zones of approximate positioning.

Targets: as few samples as hold the tolerance. Every motion keeps its end. On straight runs a sample is inserted where
the line between corrected targets would miss it by most, as long as the distance exceeds the limit. Arcs are written as
circles through the corrected start, middle and end of their pieces (`toolpath.Pieces`).

Approximate positioning (C_DIS) rounds corners. A controller leaves its path at the distance `$APO.CDIS` before the
target, but at most half the distance to a neighbouring target, and follows a parabola whose tangents are the two pieces
of path. With directions a and b there, and the distance d, the parabola passes the corner at d/4 · |b − a| =
d/2 · sin(turn/2) (the middle of the quadratic Bézier curve through corner − d·a, corner, corner + d·b).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics, toolpath
from postproc.cell import Cell
from postproc.chunks import chunks, ragged_range
from postproc.forces.sources import FEED
from postproc.frames import M_PER_MM, Array, norm, sine_and_cosine
from postproc.poses import Poses, largest_differences
from postproc.program import CIRC, LIN, PTP, SPL, Bools, Ints, Program, Targets, constant
from postproc.robot import RobotModel
from postproc.toolpath import Pieces, Segments, Toolpath, circle_through
from postproc.under_load import SHARE_OF_TOLERANCE, PathUnderLoad

_FLAT = 1e-6
"""Sagitta [m] below which a piece of an arc is written as a line (assumed)."""


class Commands(Struct, frozen=True, eq=False):
    """Commands of the N samples of a path.

    :param q: (N, 6) joint angles that the controller will hold [rad].
    :param pose: N commanded tool frames by the nominal geometry, `$BASE` [m].
    :param theta: (N, nv) deflections of the springs there [rad, m].
    """

    q: Array
    pose: Poses
    theta: Array


class CommandedPath(Struct, frozen=True, eq=False):
    """A path as it is commanded.

    :param sample: N places on the path.
    :param arcs: the pieces of its arcs.
    :param position: (N, 3) commanded positions at the places, `$BASE` [m].
    :param start: (M, 3) commanded position at the start of each motion, `$BASE` [m].
    :param limit: largest path error allowed between targets [m].
    """

    sample: Toolpath
    arcs: Pieces
    position: Array
    start: Array
    limit: float

    @classmethod
    def of(cls, path: PathUnderLoad, command: Commands) -> CommandedPath:
        """Return the path of commands, in `$BASE`."""
        ends = np.flatnonzero(path.sample.is_end)
        starts = toolpath.starts(
            path.program, lambda motion: command.pose[ends[motion]], path.robot_in_cell.start_flange
        )
        position = command.pose.position
        start = position[np.roll(ends, 1)]  # the end of the motion before
        # those that do not begin there, or in another frame; the first motion is among them
        start[starts.changed] = starts.pose[:, :3, 3]
        return cls(path.sample, path.arcs, position, start, SHARE_OF_TOLERANCE * path.robot_in_cell.tolerance)


class ChosenSamples(NamedTuple):
    """The K samples that become targets, in order.

    :param row: (K,) rows of the samples.
    :param kind: (K,) `LIN`, `CIRC`, `PTP` or `SPL`.
    :param via: (K,) row of the sample that is the auxiliary point of a CIRC, −1 elsewhere.
    """

    row: Ints
    kind: Ints
    via: Ints


def choose_samples(
    path: CommandedPath, kind: Ints, is_whole: Bools, is_dense: Bools, least_arc: tuple[float, float]
) -> ChosenSamples:
    """Choose which samples become targets: the ends of all motions, and those that `CommandedPath.limit` requires.

    :param kind: (M,) kind of each motion to be written; arcs to be written as lines are given as `LIN`.
    :param is_whole: (M,) True for motions that are written as one target because their text is kept.
    :param is_dense: (M,) True for motions of which every sample becomes a target.
    :param least_arc: smallest arc that the controller accepts: distance of its points [m], angle at its start between
        the other two [rad]; smaller ones become lines.
    """
    sample, arcs = path.sample, path.arcs  # sample.motion (N,) is the motion of each sample, arcs.motion of each arc
    is_target = sample.is_end | is_dense[sample.motion]
    kinds, via = kind[sample.motion], np.full(len(sample), -1)  # of the target at each sample; −1: no auxiliary point
    count = np.bincount(sample.motion, minlength=len(kind))
    divisible_lines = np.flatnonzero((count > 1) & (kind == LIN) & ~is_whole)
    if len(divisible_lines):
        is_target[_divide_lines(path, divisible_lines)] = True
    circle_stretches = np.flatnonzero(((kind == CIRC) & ~is_whole)[arcs.motion])
    if len(circle_stretches):
        # an arc is written as circles through start, middle and end of its pieces
        start, middle, end = _piece_samples(path, circle_stretches)
        least_distance, least_angle = least_arc
        is_arc = ~_becomes_line(start, path.position[middle], path.position[end], least_distance, least_angle)
        is_target[end], kinds[end], via[end] = True, np.where(is_arc, CIRC, LIN), np.where(is_arc, middle, -1)
    row = np.flatnonzero(is_target)
    return ChosenSamples(row, kinds[row], via[row])


def arc_pieces(path: CommandedPath) -> Pieces:
    """Return the arcs in the pieces that the tolerance needs, by the error of circles through pieces twice as large.

    A piece is the part of an arc that is written as one circle.
    """
    arcs, command = path.arcs, path.position
    stretch = np.flatnonzero(arcs.uncertain)
    begin, middle_row, end_row = _piece_samples(path, stretch)
    # pieces 2i and 2i + 1 together are the larger one: the samples at its quarters are their middles
    start, quarter, middle = begin[::2], middle_row[::2], end_row[::2]
    three_quarters, end = middle_row[1::2], end_row[1::2]
    centre, radial, tangential, angle = circle_through(start, command[middle], command[end])
    path_error = np.zeros(len(end))
    for share, row in ((0.25, quarter), (0.75, three_quarters)):
        part_angle = (angle * share)[:, None]
        arc_point = centre + np.cos(part_angle) * radial + np.sin(part_angle) * tangential
        path_error = np.maximum(path_error, norm(command[row] - arc_point))
    # the error falls with the square of the length: √(error / limit) times as many pieces
    pairs = arcs.number[stretch] // 2
    number = arcs.number.copy()
    largest_error = np.maximum.reduceat(path_error, np.cumsum(pairs) - pairs)
    number[stretch] = np.ceil(pairs * np.sqrt(largest_error / path.limit)).astype(np.int64)
    return arcs.with_enough_pieces(number)


class _PieceSamples(NamedTuple):
    """Pieces of arcs, each of which is written as a circle through its start, middle and end.

    :param start: (n, 3) point where each begins, `$BASE` [m].
    :param middle: (n,) sample in its middle.
    :param end: (n,) sample at its end.
    """

    start: Array
    middle: Ints
    end: Ints


def _piece_samples(path: CommandedPath, stretch: Ints) -> _PieceSamples:
    """Return the pieces of stretches of arcs: parts of arcs that are divided evenly.

    A piece has an even number of consecutive samples; it starts at the last sample of the piece before.

    :param stretch: (s,) rows of `path.arcs`.
    """
    arcs, sample = path.arcs, path.sample
    # the samples on arcs are those of the stretches in order: the running sum of sizes is where each stretch begins
    size = arcs.number * arcs.samples_per_piece
    first = np.flatnonzero(np.isin(sample.motion, arcs.motion))[np.cumsum(size) - size]
    number, samples_of_piece = arcs.number[stretch], np.repeat(arcs.samples_per_piece[stretch], arcs.number[stretch])
    piece = ragged_range(number)
    row = np.repeat(first[stretch], number) + piece * samples_of_piece
    begin = path.position[row - 1]
    is_first = (piece == 0) & (np.repeat(arcs.begin[stretch], number) == 0.0)
    begin[is_first] = path.start[sample.motion[row[is_first]]]
    # `row` is the first sample after the start: of an even number of samples, that of the middle is half as far
    return _PieceSamples(begin, row + samples_of_piece // 2 - 1, row + samples_of_piece - 1)


def _divide_lines(path: CommandedPath, motions: Ints) -> Ints:
    """Divide lines (n,) at their largest error until every piece fits; return the samples at which pieces end.

    All pieces of all lines are divided at once: `left` and `right` are rows of the points that bound each.

    :returns: samples, in no order.
    """
    count = np.bincount(path.sample.motion, minlength=len(path.start))
    first_sample = (np.cumsum(count) - count)[motions]
    # the points of a line: its start, in place of the sample before its first, and its samples
    size = count[motions] + 1
    first = np.cumsum(size) - size
    row = ragged_range(size, first_sample - 1)
    t, position = path.sample.t[row], path.position[row]
    t[first], position[first] = 0.0, path.start[motions]
    left, right = first, first + size - 1
    piece_ends: list[Ints] = []
    while len(left):
        largest_distance, farthest_point = _farthest_points(t, position, left, right)
        is_divided = largest_distance > path.limit
        piece_ends.append(right[~is_divided])
        division = farthest_point[is_divided]
        left, right = np.concatenate([left[is_divided], division]), np.concatenate([division, right[is_divided]])
    return np.asarray(row[np.concatenate(piece_ends)])


def _farthest_points(t: Array, position: Array, left: Ints, right: Ints) -> tuple[Array, Ints]:
    """Return the largest distance of the inner points of each piece from the straight line, and the row of that point.

    Distances (n,) are from the place of the line at the same t; rows (n,). A piece without inner points has the
    distance 0 and the row −1.

    :param t: (P,) place of each point on its motion, and `position` (P, 3) its position [m].
    :param left: (n,) row of the first point of each piece, and `right` (n,) of its last one.
    """
    count = right - left - 1
    piece = np.repeat(np.arange(len(left)), count)
    inner = ragged_range(count, left + 1)
    share = (t[inner] - t[left][piece]) / (t[right] - t[left])[piece]
    start, end = position[left], position[right]
    distance = norm(position[inner] - start[piece] - share[:, None] * (end - start)[piece])
    # sorted by piece, then by distance: the last point of each piece is the farthest
    by_distance = np.lexsort((distance, piece))
    last_of_piece = by_distance[np.cumsum(count[count > 0]) - 1]
    largest_distance, farthest_point = np.zeros(len(left)), np.full(len(left), -1)
    largest_distance[piece[last_of_piece]] = distance[last_of_piece]
    farthest_point[piece[last_of_piece]] = inner[last_of_piece]
    return largest_distance, farthest_point


def _becomes_line(a: Array, b: Array, c: Array, least_distance: float, least_angle: float) -> Bools:
    """Return which arcs (n,) from a through b to c, (n, 3) each [m], are written as lines.

    These are flat, or smaller than a controller takes.

    :param least_distance: smallest distance of b and c from a [m] that the controller takes, and `least_angle` smallest
        angle at a between b and c [rad].
    """
    chord, first = c - a, b - a
    length, height = norm(chord), norm(np.cross(chord, first))
    # |chord × first| is the length of the chord times the sagitta
    is_flat = height < _FLAT * length
    is_short = np.minimum(length, norm(first)) < least_distance
    # the tangent of the angle at a is |chord × first| / (chord · first)
    is_narrow = height < np.tan(least_angle) * (chord * first).sum(axis=1)
    is_full_circle = length == 0.0  # it has no chord, and stays an arc
    return np.asarray(~is_full_circle & (is_flat | is_short | is_narrow))


_ROUNDING_SHARE = 0.2
"""Share of the tolerance that rounding may use at inserted targets (assumed)."""
_DECIMALS = 7
"""Decimals of positions [m] in the written text, which has 1e-4 mm: on short arcs, rounding changes the direction."""
_STEPS = np.array([1.0, 2.0, 5.0])
"""Digits of approximation distances: each is at least two fifths of the largest that is allowed."""


class Corners(Struct, frozen=True):
    """The K targets of a path as corners.

    :ivar sharpness: (K,) |b − a| = 2 sin(turn/2); 0 where nothing can be rounded: at PTP, at pieces of splines,
        at the end, where frames change.
    :ivar reach: (K,) half the length of the shorter one of the neighbouring pieces [m]: blending begins no earlier.
    """

    sharpness: Array
    reach: Array

    def rounding(self, distance: Array) -> Array:
        """Return the distance (K,) [m] of each corner from the rounded path, by approximation distances (K,) [m]."""
        return np.asarray(0.25 * np.minimum(distance, self.reach) * self.sharpness)


def _corners(bend: Array, length: Array, is_continuous: Bools) -> Corners:
    """Return the corners at the ends of pieces, which lead from one target to the next.

    :param bend: (K − 1,) distance between the unit directions at the end of each piece and at the start of the next,
        which are zero where a piece has none.
    :param length: (K,) of the pieces [m].
    :param is_continuous: (K,) whether the next piece follows at once, in the same frames.
    """
    sharpness, reach = np.zeros(len(length)), np.zeros(len(length))
    reach[:-1] = 0.5 * np.minimum(length[:-1], length[1:])
    sharpness[:-1] = np.where(is_continuous[:-1] & (reach[:-1] > 0.0), bend, 0.0)
    return Corners(sharpness, reach)


def _is_continuous(program: Program, motion: Ints, kind: Ints) -> Bools:
    """Return which targets (n,) can be rounded: they and the next are LIN or CIRC, which follows in the same frames.

    :param motion: (n,) motion of each target, and `kind` (n,) as written.
    """
    m = program.motions
    next_motion = np.append(motion[1:], -1)  # −1: no target follows the last one
    is_same_frame = (m.base[next_motion] == m.base[motion]) & (m.tool[next_motion] == m.tool[motion])
    follows_at_once = (next_motion >= 0) & (next_motion - motion <= 1)
    # not at the start of branches, or where the position of the robot is unknown
    follows_at_once &= (next_motion == motion) | (program.predecessors[next_motion] == motion)
    is_path_motion = (kind != PTP) & (kind != SPL)
    return np.asarray(follows_at_once & is_same_frame & is_path_motion & np.append(is_path_motion[1:], False))


def corners_of_targets(program: Program, targets: Targets, start: Array) -> tuple[Corners, Array]:
    """Return the K corners of a path to be written, and the unit direction (K, 3) in which it arrives at each, `$BASE`.

    :param start: (M, 3) commanded position at the start of each motion, `$BASE` [m].
    """
    bend, length, arrive = np.empty(len(targets)), np.empty(len(targets)), np.empty((len(targets), 3))
    for part in chunks(len(targets)):
        row = np.arange(max(part.start - 1, 0), min(part.stop, len(targets)))  # from the last one of the part before
        # a piece is the path from one target to the next; the bend is that from its arrival to the next departure
        leave, arrive[row], length[row] = _piece_geometry(targets, start, row)
        bend[row[1:]] = norm(leave[1:] - arrive[row[:-1]])
    return _corners(bend[1:], length, _is_continuous(program, targets.motion, targets.kind)), arrive


class _PieceGeometry(NamedTuple):
    """Geometry of the pieces to n targets.

    :param leave: (n, 3) unit direction at the start of each, `$BASE`; zero for a piece without length.
    :param arrive: (n, 3) the same at the end.
    :param length: (n,) [m].
    """

    leave: Array
    arrive: Array
    length: Array


def _piece_geometry(targets: Targets, start: Array, row: Ints) -> _PieceGeometry:
    """Return the directions at both ends of the pieces to targets, and their lengths, with rounded coordinates.

    :param start: (M, 3) commanded position at the start of each motion, `$BASE` [m].
    :param row: (n,) rows of the targets.
    """
    motion, previous = targets.motion[row], np.maximum(row - 1, 0)
    end, previous_end = (np.round(targets.pose.position[rows], _DECIMALS) for rows in (row, previous))
    is_first_of_motion = (row == 0) | (targets.motion[previous] != motion)
    begin = np.where(is_first_of_motion[:, None], np.round(start[motion], _DECIMALS), previous_end)
    step = end - begin
    length = norm(step)
    leave = step / np.where(length > 0.0, length, 1.0)[:, None]
    arrive = leave.copy()
    arcs = np.flatnonzero(targets.kind[row] == CIRC)
    if len(arcs):
        # radial: from the centre to the start of the arc; tangent: direction there, as long as the radius [m]
        _, radial, tangent, angle = circle_through(begin[arcs], np.round(targets.via[row[arcs]], _DECIMALS), end[arcs])
        radius, (sine, cosine) = norm(radial), sine_and_cosine(angle[:, None])
        leave[arcs] = tangent / radius[:, None]
        arrive[arcs] = (cosine * tangent - sine * radial) / radius[:, None]
        length[arcs] = radius * angle
    return _PieceGeometry(leave, arrive, length)


def corners_of_motions(program: Program, path: Segments, motion: Ints) -> Corners:
    """Return the corners of a program at the ends of motions (n,), which are in execution order.

    :param path: geometry of all motions of the program.
    """
    kind = program.motions.kind[motion]
    arriving, leaving = motion[:-1], motion[1:]  # the motions before and after each corner but the last
    arrive = toolpath.tangent(program, path, arriving, np.ones(len(arriving)))
    leave = toolpath.tangent(program, path, leaving, np.zeros(len(leaving)))
    return _corners(norm(leave - arrive), path.length[motion], _is_continuous(program, motion, kind))


def programmed_rounding(program: Program, path: Segments, motion: Ints) -> Array:
    """Return how far the program as read rounds its path at targets (K,) [m], by its own approximation distances.

    0 at inserted targets and in G-code.

    :param motion: (K,) motion of each target, never decreasing.
    """
    if not program.keeps_text:
        return constant(0.0, len(motion))
    rounding = np.zeros(len(motion))
    is_last_target = np.append(np.diff(motion) != 0, True)[: len(motion)]  # [: len(motion)]: there may be no target
    ended_motion = motion[is_last_target]
    corners = corners_of_motions(program, path, ended_motion)
    rounding[is_last_target] = corners.rounding(program.motions.blend[ended_motion])
    return rounding


def approximation_distances(program: Program, targets: Targets, corners: Corners, cell: Cell) -> Array:
    """Return the approximation distance (K,) [m] of each target; 0: an exact stop.

    The end of a motion has the distance that the program gives it, unless blending would round it by more than
    `Motions.rounding` allows: then it is an exact stop. The robot does not stop at inserted targets. Where one of them
    is a corner, because the force changes, its distance is made smaller in a program from G-code; in KRL, where
    `$APO.CDIS` is the program's own, the robot stops there if it also stops at the end of that motion.

    :param cell: states the approximation distance of inserted targets, and the tolerance.
    """
    m, motion = program.motions, targets.motion
    programmed_distance = m.blend[motion]
    rounds_too_much = corners.rounding(programmed_distance) > m.rounding[motion]
    end_distance = np.where(rounds_too_much, 0.0, programmed_distance)
    inner_distance = _inner_distances(program, programmed_distance, corners, cell)
    distance = np.where(targets.t == 1.0, end_distance, inner_distance)
    return np.where(targets.kind == PTP, 0.0, distance)


def _inner_distances(program: Program, programmed_distance: Array, corners: Corners, cell: Cell) -> Array:
    """Return the approximation distances (K,) [m] of targets if they are inserted; see `approximation_distances`.

    Infinite in a program that keeps its text: `$APO.CDIS` of the program holds.

    :param programmed_distance: (K,) distance that the program gives to the end of the motion of each target [m].
    """
    # `Corners.rounding` is distance · sharpness / 4: the distance at which it is its share of the tolerance; a straight
    # corner (sharpness 0) has a very large one
    largest_distance = 4.0 * _ROUNDING_SHARE * cell.tolerance / np.maximum(corners.sharpness, 1e-9)
    if program.keeps_text:
        is_blended = (programmed_distance > 0.0) | (corners.reach <= largest_distance)
        return np.where(is_blended, np.inf, 0.0)
    distance = np.maximum(programmed_distance, cell.gcode.approximation_mm * M_PER_MM)
    is_limited = largest_distance < np.minimum(distance, corners.reach)  # blending begins no earlier than `reach`
    distance[is_limited] = _round_down(largest_distance[is_limited])
    return distance


def _round_down(distance: Array) -> Array:
    """Return distances (n,) [m] rounded down to 1, 2 or 5 times a power of ten millimetres, so that few differ."""
    step = _STEPS * 10.0 ** np.floor(np.log10(distance / M_PER_MM))[:, None]
    # the factor keeps a distance that is such a number from being rounded to the one below it
    smaller = np.where(step * M_PER_MM <= distance[:, None] * (1.0 + 1e-9), step, 0.0)
    return np.asarray(smaller.max(axis=1) * M_PER_MM)


_STATUS_BITS, _TURN_BITS = 0b111, 0b111111
"""Bits of S that state the posture (overhead, elbow, wrist), and of T that state the signs of A1 to A6."""
_UNCHANGED = 1e-7
"""A correction below this [m, rad] is none: the text of a target is left to the byte where the program keeps it."""


class TargetSelection(Struct, frozen=True, eq=False):
    """The K targets chosen of the N samples of a path.

    :param targets: targets to be written.
    :param row: (K,) sample of each target.
    :param arrive: (K, 3) direction of travel at the end of the piece to each, `$BASE`; (0, 3) without forces in FEED
        axes.
    :param programmed_rounding: (K,) distance of the rounded path of the program as read from each target [m].
    """

    targets: Targets
    row: Ints
    arrive: Array
    programmed_rounding: Array


def choose_targets(
    path: PathUnderLoad, command: Commands, least_arc: tuple[float, float], *, linearize_arcs: bool
) -> TargetSelection:
    """Choose the targets to write: the fewest samples that hold the tolerance.

    :param command: commands of the samples, in `$BASE`.
    :param least_arc: smallest arc that the controller accepts, see `dialects.dialect.Writer`.
    :param linearize_arcs: arcs are written as lines.
    """
    program, sample, m = path.program, path.sample, path.program.motions
    is_whole, keeps_end = _unchanged_motions(path, command)
    commanded_path = CommandedPath.of(path, command)
    kind = np.where(m.kind == CIRC, LIN, m.kind) if linearize_arcs else m.kind
    is_dense = ~is_whole & (toolpath.swivel_pieces(program, path.motions.segments, path.robot_in_cell.tolerance) > 1)
    samples = choose_samples(commanded_path, kind, is_whole, is_dense, least_arc)
    # axis targets are written from their own joint angles
    is_cartesian = np.isnan(m.joints[sample.motion[samples.row], 0])
    row, target_kind, via_row = (values[is_cartesian] for values in samples)
    motion = sample.motion[row]
    via, arcs = np.broadcast_to(np.nan, (len(row), 3)), via_row >= 0
    if arcs.any():
        via = via.copy()
        via[arcs] = commanded_path.position[via_row[arcs]]
    status, turn = _status_and_turn(program, path.robot_in_cell.robot, motion, command.q[row])
    targets = Targets(
        motion=motion,
        t=sample.t[row],
        kind=target_kind,
        pose=command.pose.take(row),
        via=via,
        keep=keeps_end[motion] & (sample.t[row] == 1.0),
        status=status,
        turn=turn,
        blend=m.blend[motion],
    )
    corners, arrive = corners_of_targets(program, targets, commanded_path.start)
    blend = approximation_distances(program, targets, corners, path.robot_in_cell.cell)
    if not (path.motions.forces.frame == FEED).any():
        arrive = np.zeros((0, 3))  # only forces in axes of the feed need directions of travel
    rounding = programmed_rounding(program, path.motions.segments, motion)
    return TargetSelection(replace(targets, blend=blend), row, arrive, rounding)


def _unchanged_motions(path: PathUnderLoad, command: Commands) -> tuple[Bools, Bools]:
    """Return which motions (M,) become a single target, and which (M,) keep the end that their text states.

    Both are motions of programs that keep their text, and need no correction. A line or circle needs none if its start
    needs none too: from another start it is another line or circle. For a PTP the end is enough.
    """
    m, sample = path.program.motions, path.sample
    if not path.program.keeps_text:
        return np.zeros(len(m), dtype=bool), np.zeros(len(m), dtype=bool)
    is_corrected = largest_differences(sample.pose, command.pose) > _UNCHANGED
    first_samples = np.flatnonzero(np.diff(sample.motion, prepend=-1))
    end_differs = is_corrected[sample.is_end]
    path_differs = np.maximum.reduceat(is_corrected, first_samples) | np.concatenate([[False], end_differs[:-1]])
    is_arc = m.kind == CIRC
    # the text of a circle is kept if its start is that of the text: no change since the last motion that is no circle,
    # whose end is printed as it was
    rows, differs = np.arange(len(m)), np.where(is_arc, path_differs, end_differs)
    # −2 before any change and −1 before any line: arcs from the start of the program on are kept too
    last_change = np.maximum.accumulate(np.where(differs, rows, -2))
    last_line = np.maximum.accumulate(np.where(is_arc, -1, rows))
    keeps_end = np.where(is_arc, last_change < last_line, ~end_differs)
    return np.where(m.kind == LIN, ~path_differs, keeps_end), keeps_end


def _status_and_turn(program: Program, robot: RobotModel, motion: Ints, q: Array) -> tuple[Ints, Ints]:
    """Return status S and turn T of targets (K,); −1 for none.

    Only PTP targets have them; in a program that keeps its text, only those to which it gives them. Of these, bits that
    do not follow from the joint angles remain as the program has them.

    :param motion: (K,) motion of each target.
    :param q: (K, 6) commanded joint angles [rad].
    """
    m = program.motions
    ptp = np.flatnonzero(m.kind[motion] == PTP)
    if not len(ptp):
        return constant(-1, len(motion)), constant(-1, len(motion))
    status, turn = np.full(len(motion), -1), np.full(len(motion), -1)
    status[ptp], turn[ptp] = kinematics.status_of(robot, q[ptp]), kinematics.turn_of(q[ptp])
    if program.keeps_text:
        for target_bits, programmed_bits, computed_bits in (
            (status, m.status[motion], _STATUS_BITS),
            (turn, m.turn[motion], _TURN_BITS),
        ):
            target_bits[:] = np.where(programmed_bits >= 0, programmed_bits & ~computed_bits | target_bits, -1)
    return status, turn
