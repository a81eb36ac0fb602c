"""The paths of the two programs that are compared, and the stretch from one pair of targets to the next.

A place on a program's path is its arc length from the start of the program [m], or (motion, t) as in `toolpath`. Points
that both programs share are in the robot root where that is at E1 = 0, here called the cell.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import numpy as np
from msgspec import Struct

from postproc import forces, toolpath
from postproc.chunks import in_chunks
from postproc.comparison.pairing import Track
from postproc.errors import ProgramError
from postproc.forces import ForceSource, PathForces
from postproc.frames import Array, norm, twist_between
from postproc.kinematics import JointPath, UnreachableError
from postproc.program import CIRC, PTP, Bools, Ints, Program
from postproc.simulation import DrivenProgram
from postproc.toolpath import Segments
from postproc.under_load import RobotInCell

SAME_FRAME = 1e-6
"""Frames that differ by less [m, rad] are the same (assumed)."""
_PLACES, _REFINEMENTS, _FINE_SAMPLES = 33, 6, 9
"""Search for the nearest place of a path: number of samples of the first round, number of further rounds between the
neighbours of the nearest sample, and number of their samples (assumed)."""
_SAMPLES, _ROUNDS = 9, 4
"""Search for the largest distance of two arcs: places of a round, and rounds between the neighbours of the best place
(assumed)."""
NO_DISTANCE = 1e-12
"""Lengths [m] and shares below this are rounding: quotients by it stay finite."""
SMALLEST_SHARE = 1e-9
"""Share of a motion at which it begins: at 0 is the end of the motion before, under whose force and tool."""
_NO_LENGTH, _PER_RADIAN, _MIN_SIZE = 1e-9, 1e-3, 1e-4
"""A motion shorter than the first [m] does not move the tip. Its arc length is the second [m/rad] times the rotation of
the tool, and at least the last [m], because the force may change along it (assumed)."""


class PlacedProgram(DrivenProgram, frozen=True, eq=False, dict=True):
    """A program of M motions as its controller drives it, with the joint angles at the ends of its motions.

    :param size: (M,) length of the motions [m]; of one that does not move the tip, see `_PER_RADIAN`.
    :param arc_length: (M + 1,) arc length at which each motion begins, and that of the end: the sum of these sizes [m].
    :param target_rows: (n,) motions with a Cartesian target.
    :param joints: (M, 6) joint angles at the ends of the motions [rad].
    :param branch: (M,) branch of the inverse kinematics of each.
    """

    size: Array
    arc_length: Array
    target_rows: Ints
    joints: Array
    branch: Ints

    @classmethod
    def of(cls, program: Program, robot_in_cell: RobotInCell) -> PlacedProgram:
        """Return a program in its cell.

        :raises ProgramError: a target is out of reach.
        """
        m = program.motions
        segments = toolpath.segments(program, robot_in_cell.start_flange)
        is_rotation = (m.kind != PTP) & (segments.length < _NO_LENGTH)  # the tip stays where it is
        size = np.where(is_rotation, np.maximum(_PER_RADIAN * segments.turn, _MIN_SIZE), segments.length)
        ends = _end_joints(program, robot_in_cell)
        return cls(
            program,
            robot_in_cell,
            segments,
            size=size,
            arc_length=np.append(0.0, np.cumsum(size)),
            target_rows=np.flatnonzero(np.isnan(m.joints[:, 0])),
            joints=ends.q[:],
            branch=ends.branch,
        )

    def track(self, offset: Array | float = 0.0) -> Track:
        """Return the n Cartesian targets, with their positions in the robot root and the steps to them.

        :param offset: (n, 3) by which they are displaced, in their `$BASE` [m]; 0: they are not.
        """
        m, rows = self.program.motions, self.target_rows
        pose = m.target[rows]
        is_ptp = m.kind[rows] == PTP
        # the path of a PTP is not known: its chord counts
        step = np.where(is_ptp, norm(pose[:, :3, 3] - self.segments.begin(rows)), self.segments.length[rows])
        pose[:, :3, 3] += offset
        position = toolpath.pose_in_root(self.program, rows, pose, None)[:, :3, 3]
        return Track(position, step, is_ptp, self.is_continued[rows])

    @cached_property
    def is_continued(self) -> Bools:
        """(M,) True for motions whose end is no corner: the next motion continues the same line or arc."""
        return np.append(toolpath.continues(self.program, self.segments)[1:], False)

    def at(self, length: Array) -> tuple[Ints, Array]:
        """Return the motions (n,) at arc lengths `length` (n,) [m], and the places t (n,) on them, in (0, 1]."""
        motion = np.clip(np.searchsorted(self.arc_length, length) - 1, 0, len(self.arc_length) - 2)
        size = np.maximum(self.size[motion], NO_DISTANCE)
        return motion, np.clip((length - self.arc_length[motion]) / size, SMALLEST_SHARE, 1.0)

    def points(self, length: Array) -> Array:
        """Return the programmed positions (n, 3) at arc lengths `length` (n,), in the cell [m]."""
        motion, t = self.at(length)
        return in_cell(self.program, motion, toolpath.positions(self.program, self.segments, motion, t))

    def forces(self, source: ForceSource | None) -> PathForces:
        """Return the forces along the program: from a source, else, with None, from its comments."""
        return forces.assign(self.program, self.segments, source, self.robot_in_cell.spindle, self.robot_in_cell.ramp)

    def wrench(self, load: PathForces, motion: Ints, t: Array | float = 1.0) -> Array:
        """Return the wrenches (n, 6) at places (motion, t), root axes [N, N·m]; t = 1: at the ends of the motions."""
        share = np.broadcast_to(np.asarray(t, dtype=float), motion.shape)
        wrench = load.at(toolpath.at(self.program, self.segments, motion, share))
        return toolpath.wrench_in_root(self.program, motion, wrench)

    def joints_at(self, motion: Ints, t: Array) -> Array:
        """Return the joint angles (n, 6) at places (motion, t) [rad]; NaN out of reach."""
        return self.commanded_poses(motion, t, self.branch[motion])[1]


def in_cell(program: Program, motion: Ints, point: Array) -> Array:
    """Return points (n, 3) in the cell [m]: the frame of the robot root where that is at E1 = 0.

    :param motion: (n,) rows of `Motions`.
    :param point: (n, 3) in the `$BASE` of these motions [m].
    """
    base = toolpath.base_of(program, motion)
    return np.asarray(np.einsum("...ij,...j->...i", base[..., :3, :3], point) + base[..., :3, 3])


def file_and_line(program: Program, row: int) -> tuple[str, int]:
    """Return the path of the file of motion `row`, and its line."""
    file, line = program.places(np.array([row])).of(0)
    return str(Path(program.documents[0].folder) / file), line


def _end_joints(program: Program, robot_in_cell: RobotInCell) -> JointPath:
    """Return the joint angles (M, 6) at the ends of all motions, and the branches (M,) of the inverse kinematics.

    :raises ProgramError: a target is out of reach; the error names its line.
    """
    count = len(program.motions)
    try:
        return robot_in_cell.follow(program, np.arange(count), np.ones(count), program.motions.target)
    except UnreachableError as cause:
        file, line = file_and_line(program, cause.rows[0])
        problem = "out of reach (on the branch of [start] joints)"
        raise ProgramError(problem, file=file, line=line) from None


def stretch_limits(path: PlacedProgram, paired_rows: Ints, pair: Ints) -> tuple[Array, Array]:
    """Return the arc lengths (n,) at which the stretches to pairs begin, and (n,) at which they end [m].

    A stretch begins at the pair before, the first one at the start of the program.

    :param paired_rows: (P,) motions of the program that end at the pairs.
    :param pair: (n,) indices of the pairs.
    """
    previous_rows = np.append(-1, paired_rows)[pair]
    return path.arc_length[previous_rows + 1], path.arc_length[paired_rows[pair] + 1]


def nearest(
    path_points: Callable[[Ints, Array], Array], positions: Array, begin: Array, end: Array
) -> tuple[Array, Array]:
    """Return the arc length (n,) at which a path is nearest to each of n points, and the distances (n,) [m].

    Samples the path evenly, then again between the neighbours of the nearest sample.

    :param path_points: returns the positions (m, s, 3) of the path at s arc lengths for each of m points: takes the
        rows (m,) of these points, and the arc lengths (m, s). The path may be another one for each point.
    :param positions: (n, 3) the points.
    :param begin: (n,) arc length from which places count, `end` (n,) to which [m].
    """

    def nearest_to(point: Ints) -> tuple[Array, Array]:
        """Return the arc lengths (m,) and distances (m,) of some of the points, rows (m,)."""
        row = np.arange(len(point))
        low, high, count = begin[point], end[point], _PLACES  # of the samples
        for _ in range(1 + _REFINEMENTS):
            lengths = low[:, None] + (high - low)[:, None] * np.linspace(SMALLEST_SHARE, 1.0, count)
            offsets = path_points(point, lengths) - positions[point, None]
            distances = norm(offsets.reshape(-1, 3)).reshape(lengths.shape)
            sample = np.argmin(distances, axis=1)
            low, high = lengths[row, np.maximum(sample - 1, 0)], lengths[row, np.minimum(sample + 1, count - 1)]
            nearest_length, distance = lengths[row, sample], distances[row, sample]
            count = _FINE_SAMPLES
        return nearest_length, distance

    # in chunks: each point has a row of samples
    return in_chunks(nearest_to, np.arange(len(positions)))


def nearest_lengths(path: PlacedProgram, positions: Array, begin: Array, end: Array) -> tuple[Array, Array]:
    """Return the arc lengths (n,) [m] at which a path is nearest to points, and their distances (n,) from there [m].

    :param positions: (n, 3) the points, in the cell [m].
    :param begin: (n,) arc length from which the path counts, `end` (n,) to which [m].
    """

    def path_points(_: Ints, lengths: Array) -> Array:
        """Return the positions (m, s, 3) of the path at arc lengths (m, s) [m]."""
        return path.points(lengths.ravel()).reshape(*lengths.shape, 3)

    return nearest(path_points, positions, begin, end)


def distances_from_path(path: PlacedProgram, positions: Array, begin: Array, end: Array) -> Array:
    """Return the distances (n,) of points from a path between two arc lengths [m]; parameters of `nearest_lengths`."""
    return nearest_lengths(path, positions, begin, end)[1]


class Chain(Struct, frozen=True, eq=False):
    """The motions of a program from its first to its last pair. Pair k is at u = k; between, u is by arc length.

    :param program: the program; `segments` its geometry.
    :param row: (m,) its motions, in order; `pair` (m,) the pair to which each leads.
    :param begin: (m,) u at which each begins, `end` (m,) at which it ends; equal for a PTP, which has no length.
    """

    program: Program
    segments: Segments
    row: Ints
    pair: Ints
    begin: Array
    end: Array

    @classmethod
    def of(cls, side: PlacedProgram, paired_rows: Ints) -> Chain:
        """Return the chain of the motions between the first and the last pair.

        A pair is a motion of the nominal program and its partner in the corrected one, which ends at the same target.

        :param paired_rows: (P,) motions of the program that end at the pairs.
        """
        row = np.arange(paired_rows[0] + 1, paired_rows[-1] + 1)
        pair = np.searchsorted(paired_rows, row)  # the pair to which each motion leads
        previous_row, next_row = paired_rows[pair - 1], paired_rows[pair]
        begin_length, end_length = stretch_limits(side, paired_rows, pair)
        stretch_length = end_length - begin_length
        share_of_length = (side.arc_length[row + 1] - begin_length) / np.maximum(stretch_length, NO_DISTANCE)
        share_of_count = (row - previous_row) / (next_row - previous_row)  # for stretches without length
        share = np.where(stretch_length > NO_DISTANCE, share_of_length, share_of_count)
        end = np.where(row == next_row, pair, np.minimum(pair - 1 + share, pair))
        begin = np.concatenate([[0.0], end[:-1]])
        return cls(side.program, side.segments, row=row, pair=pair, begin=begin, end=end)

    def at(self, u: Array) -> tuple[Ints, Array]:
        """Return the motions (n,) and the places t (n,) on them, in (0, 1], at u (n,), 0 < u <= P − 1.

        Pair k is at u = k; between pairs u grows with the length of the path.
        """
        index = np.minimum(np.searchsorted(self.end, u), len(self.end) - 1)
        width = np.maximum(self.end[index] - self.begin[index], NO_DISTANCE)
        return self.row[index], np.clip((u - self.begin[index]) / width, SMALLEST_SHARE, 1.0)

    def any_between(self, selection: Bools) -> Bools:
        """Return for each pair (P,) whether a selected motion leads to it from the pair before.

        :param selection: (M,) True for the selected motions.
        """
        has_motion = np.zeros(int(self.end[-1]) + 1, dtype=bool)
        has_motion[self.pair[selection[self.row]]] = True
        return has_motion


class Curves(Struct, frozen=True, eq=False):
    """Both paths between pairs, at the same u. Pieces of splines are replaced by their chords; PTP is unknown.

    :param nominal_chain: of the nominal program, `corrected_chain` of the second one.
    """

    nominal_chain: Chain
    corrected_chain: Chain

    @classmethod
    def of(cls, nominal_path: PlacedProgram, corrected_path: PlacedProgram, pair: Ints) -> Curves | None:
        """Return the curves between pairs; None for fewer than two.

        :param pair: (P, 2) motions of both programs that end at the pairs.
        """
        return cls(Chain.of(nominal_path, pair[:, 0]), Chain.of(corrected_path, pair[:, 1])) if len(pair) > 1 else None

    def at(self, u: Array) -> tuple[Array, Array]:
        """Return the positions (n, 3) [m] of the nominal tool that each program commands at u (n,), nominal `$BASE`."""
        motion, t = self.nominal_chain.at(u)
        nominal_point = toolpath.positions(self.nominal_chain.program, self.nominal_chain.segments, motion, t)
        return nominal_point, self._second_points(*self.corrected_chain.at(u), motion)

    def second_points_in_cell(self, u: Array) -> Array:
        """Return where the second program commands the nominal tool (n, 3) at u (n,), in the cell [m]."""
        motion = self.nominal_chain.at(u)[0]
        return in_cell(self.nominal_chain.program, motion, self._second_points(*self.corrected_chain.at(u), motion))

    def _second_points(self, row: Ints, share: Array, motion: Ints) -> Array:
        """Return where the second program commands the nominal tool (n, 3), in `$BASE` of nominal motions [m].

        :param row: (n,) motions of the second program, and `share` (n,) places on them.
        :param motion: (n,) motions of the nominal program.
        """
        nominal, second = self.nominal_chain.program, self.corrected_chain.program
        if self._has_same_tool:
            point = toolpath.positions(second, self.corrected_chain.segments, row, share)
            return toolpath.points_in_base(nominal, motion, in_cell(second, row, point), None)
        pose = toolpath.at(second, self.corrected_chain.segments, row, share).pose[:]
        return tool_of_nominal(nominal, motion, second, row, pose)[:, :3, 3]

    def largest_gaps(self) -> Array:
        """Return the largest distance (P,) [m] of both paths at the same u, between each pair and the pair before.

        The parameter u of both paths is k at pair k, and between pairs it grows with the length of each path.

        NaN for the first pair, and where a PTP is between.
        """
        gaps = np.full(int(self.nominal_chain.end[-1]) + 1, np.nan)  # for each pair
        # between knots, the ends of motions of either program, both paths are smooth
        knots = np.unique(np.concatenate([[0.0], self.nominal_chain.end, self.corrected_chain.end]))
        knots = knots[np.diff(knots, prepend=-1.0) > NO_DISTANCE]
        begin, end = knots[:-1], knots[1:]  # of each piece
        pair = _pair_at_end(end)
        is_nominal_ptp, is_corrected_ptp = self.nominal_chain.program.motions.kind == PTP, self._kind == PTP
        has_ptp = self.nominal_chain.any_between(is_nominal_ptp) | self.corrected_chain.any_between(is_corrected_ptp)
        largest = np.maximum(self._distance(begin + SMALLEST_SHARE * (end - begin)), self._distance(end))
        curve_indices = np.flatnonzero(~has_ptp[pair] & self._is_curved(end))
        if len(curve_indices):
            # at arcs the gap may be largest between the knots; in chunks, since each piece has a row of samples
            inside = in_chunks(self._largest, begin[curve_indices], end[curve_indices])
            largest[curve_indices] = np.maximum(largest[curve_indices], inside)
        np.fmax.at(gaps, pair, largest)  # the largest of the pieces that lead to each pair; NaN does not count
        gaps[has_ptp] = np.nan
        return gaps

    def parts(self, angle: float) -> Ints:
        """Return the number of chords (P,) that draw the path to each pair; at least 1.

        :param angle: largest angle of an arc that one chord draws [rad].
        """
        counts = np.ones(int(self.nominal_chain.end[-1]) + 1, dtype=np.int64)
        for chain in (self.nominal_chain, self.corrected_chain):
            arc = np.flatnonzero(chain.program.motions.kind[chain.row] == CIRC)
            angles = np.zeros(len(counts))
            np.add.at(angles, _pair_at_end(chain.end[arc]), chain.program.motions.sweep[chain.row[arc]])
            counts = np.maximum(counts, np.ceil(angles / angle).astype(np.int64))
        return counts

    @property
    def _kind(self) -> Ints:
        """(M,) kinds of the motions of the second program."""
        return self.corrected_chain.program.motions.kind

    @property
    def _has_same_tool(self) -> bool:
        """Whether both programs have one tool, and the same: positions are then found without orientations."""
        tools = (self.nominal_chain.program.tools, self.corrected_chain.program.tools)
        return len(tools[0]) == len(tools[1]) == 1 and bool(np.abs(twist_between(*tools)).max() <= SAME_FRAME)

    def _is_curved(self, u: Array) -> Bools:
        """Return where (n,) the distance of the paths may be largest inside a piece: at arcs, not between two lines.

        A piece is a part of both paths between ends of motions of either program; it contains one u (n,).
        """
        if not self._has_same_tool:
            return np.ones(len(u), dtype=bool)
        motion, row = self.nominal_chain.at(u)[0], self.corrected_chain.at(u)[0]
        return np.asarray((self.nominal_chain.program.motions.kind[motion] == CIRC) | (self._kind[row] == CIRC))

    def _distance(self, u: Array) -> Array:
        """Return the distances (n,) of the two paths at u (n,) [m]."""
        nominal_points, corrected_points = self.at(u)
        return norm(corrected_points - nominal_points)

    def _largest(self, begin: Array, end: Array) -> Array:
        """Return the largest distances (n,) [m] between u = begin (n,) and end (n,), where both paths are smooth."""
        largest = np.zeros(len(begin))
        for _ in range(_ROUNDS):
            u = begin[:, None] + np.linspace(SMALLEST_SHARE, 1.0, _SAMPLES) * (end - begin)[:, None]
            distance = self._distance(u.ravel()).reshape(u.shape)
            sample = distance.argmax(axis=1)
            row = np.arange(len(u))
            largest = np.maximum(largest, distance[row, sample])
            # the next samples are between the neighbours of the largest one
            begin, end = u[row, np.maximum(sample - 1, 0)], u[row, np.minimum(sample + 1, _SAMPLES - 1)]
        return largest


def _pair_at_end(u: Array) -> Ints:
    """Return the pairs (n,) to which the path leads at places u (n,); pair k is at u = k."""
    return np.asarray(np.ceil(u - NO_DISTANCE).astype(np.int64))


def tool_of_nominal(nominal: Program, motion: Ints, second: Program, row: Ints, pose: Array) -> Array:
    """Return the poses (n, 4, 4) of the nominal tool, nominal `$BASE`, where a second program sends its own.

    :param motion: (n,) motions of the nominal program, `row` (n,) those of the second.
    :param pose: (n, 4, 4) of the second program's tool, in its `$BASE`.
    """
    flange = toolpath.flange_from_tcp(second, row, pose, None)
    return toolpath.pose_in_base(nominal, motion, flange @ toolpath.tool_of(nominal, motion), None)


def commanded_positions(nominal: Program, motion: Ints, second: Program, row: Ints) -> Array:
    """Return where targets of a second program send the tip of the nominal tool, (n, 3) in the cell [m].

    :param motion: (n,) motions of the nominal program that give the tool; `row` (n,) motions of the second program.
    """
    flange = toolpath.flange_from_tcp(second, row, second.motions.target[row], None)
    return np.asarray((flange @ toolpath.tool_of(nominal, motion))[:, :3, 3])
