"""Where the loaded tip goes by each of two programs, at the pairs of their targets and between them.

Both are simulated by `simulation.DrivenProgram`, under the force that acts where the tool is on the nominal path. A
place on a path is its arc length from the start of the program, or a motion (row of `Motions`) and t on it, 0 at its
start and 1 at its end. A stretch is the path from one pair to the next.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import toolpath
from postproc.chunks import Columns, chunks
from postproc.comparison.paths import NO_DISTANCE, PlacedProgram, file_and_line, stretch_limits
from postproc.comparison.result import Comparison, Cuts, wrench_in_nominal_base
from postproc.errors import ForceError, NotConvergedError
from postproc.forces import BEHIND_STEP, PathForces
from postproc.frames import Array, angle_between, norm
from postproc.program import CIRC, LIN, PTP, SPL, Bools, Ints, Program
from postproc.simulation import number_of_places

_GAUSS_NEWTON_STEPS = 4
"""Gauss-Newton steps to the nearest place of the path."""
_DIFFERENCE_STEP = 1e-6
"""Step of their finite differences [m]."""
_LEAST_RATE = 0.05
"""Rate of change of the distance per length below which the place does not matter."""
_SUFFICIENT_DISTANCE = 1e-8
"""A distance at targets that is not improved further [m] (assumed)."""
_CLOSE_SHARE = 0.2
"""A distance at targets, as a share of the tolerance, beyond which a nearer place is sought elsewhere (assumed)."""
_START_VALUES, _RAMPS, _RAMP_SAMPLES, _REFINEMENTS = 65, 3.0, 9, 3
"""Places tried on the whole stretch, and on this many times the ramp of a force; then refined so often (assumed)."""
_FIRST_SHARES = np.geomspace(1e-5, 1e-2, 13)
"""And these shares of the stretch: where a move begins with a step, the force may change over some micrometres."""
_PROBE_WRENCH = np.array([100.0, 100.0, 100.0, 10.0, 10.0, 10.0])
"""Forces [N] and moments [N·m] from which the compliance at the tip is taken."""
_MIN_PARTS = 2
"""Places at which pieces of the second program are checked at least: it may leave its path between targets."""
_STEEP_CHANGE = 2e-4
"""A piece is steep if the displacements of its two ends differ by more than this [m] (assumed)."""
_MIN_PIECE_LENGTH = 2.0 * BEHIND_STEP
"""A piece whose stretch of the nominal path is shorter [m] is not checked between its ends."""


def deviation(path: PlacedProgram, motion: Ints, q: Array, wrench: Array, displacement: Array) -> Array:
    """Return the loaded tip minus the targets of motions, (n, 3) in their `$BASE` [m].

    :param path: the program of the motions in its cell, which gives the robot, the tools and the targets.
    :param motion: (n,) rows of motions of this program.
    :param q: (n, 6) commanded joint angles [rad].
    :param wrench: (n, 6) at the tip, root axes [N, N·m].
    :param displacement: (n, 3) of the robot by E1 [m].
    :raises ForceError: the arm has no equilibrium under the force.
    """
    try:
        tip = path.loaded_tip(motion, q, wrench, displacement)
    except NotConvergedError as cause:
        raise no_equilibrium(path.program, motion, cause) from None
    return path.to_base(motion, tip) - path.program.motions.target.position[motion]


def no_equilibrium(program: Program, motion: Ints, cause: NotConvergedError) -> ForceError:
    """Return the error for a force under which the arm has no equilibrium.

    :param motion: (n,) motions; the error names the line of the first that is in `cause.rows`.
    """
    file, line = file_and_line(program, int(motion[cause.rows[0]]))
    return ForceError(f"the arm does not hold this force here: {cause}", file=file, line=line)


def pair_cuts(
    comparison: Comparison,
    nominal_path: PlacedProgram,
    wrench: Array,
    *,
    nominal_deviation: Array,
    corrected_deviation: Array,
) -> Cuts:
    """Return the deviations at the pairs; the arrays for places between pairs are empty.

    :param wrench: (P, 6) at the tip, root axes [N, N·m].
    :param nominal_deviation: (P, 3) by the nominal program, its `$BASE` [m].
    :param corrected_deviation: (P, 3) by the second program, in its `$BASE` [m].
    :raises ForceError: the arm has no equilibrium under a force.
    """
    no_values = np.zeros(0)
    return Cuts(
        wrench=wrench_in_nominal_base(comparison, wrench),
        nominal=nominal_deviation,
        corrected_deviation=corrected_deviation,
        rotation=_orientation_errors(comparison, nominal_path, wrench),
        row=np.zeros(0, dtype=np.int64),
        t=no_values,
        nominal_distance=no_values,
        corrected_distance=no_values,
        path_rotation=no_values,
        length=no_values,
    )


def _orientation_errors(comparison: Comparison, nominal_path: PlacedProgram, wrench: Array) -> Array:
    """Return the angle between the commanded orientation and the one that keeps the loaded tool nominal (P,) [rad].

    :param wrench: (P, 6) at the tip at the pairs, root axes [N, N·m].
    :raises ForceError: the arm has no equilibrium under a force.
    """
    program, motion = comparison.nominal, comparison.pair[:, 0]
    target = toolpath.pose_in_root(program, motion, program.motions.target[motion])
    tool, q = toolpath.tool_of(program, motion), nominal_path.joints[motion]
    try:
        compensated_pose = nominal_path.robot_in_cell.compensate(target, q, tool, wrench).pose
    except NotConvergedError as cause:
        raise no_equilibrium(program, motion, cause) from None
    compensated_pose = toolpath.pose_in_base(program, motion, compensated_pose)
    return angle_between(compensated_pose[:, :3, :3], comparison.pose[:, :3, :3])


def cuts_between_pairs(
    comparison: Comparison, cuts: Cuts, nominal_path: PlacedProgram, corrected_path: PlacedProgram, load: PathForces
) -> Cuts:
    """Return `cuts` with the deviations at the unpaired targets of the second program, and between its targets.

    Each place of the second program is compared with the place of the nominal path that its loaded tip is nearest to,
    on the stretch between the same pairs.

    :param cuts: the deviations at the pairs.
    :param load: the forces along the nominal program.
    :raises ForceError: the arm has no equilibrium under a force.
    """
    stretches = Stretches.from_pairs(comparison, nominal_path, corrected_path)
    search = Search(nominal_path, corrected_path, load, stretches)
    targets = stretches.targets(comparison)
    at_ends = _NearestPlaces.of(
        search, targets, np.ones(len(targets)), stretches.guessed_lengths(targets), _SUFFICIENT_DISTANCE
    )
    # where on the nominal path each motion of the second program ends
    end_length = np.full(len(corrected_path.program.motions), np.nan)
    end_length[comparison.pair[:, 1]] = nominal_path.arc_length[comparison.pair[:, 0] + 1]
    end_length[at_ends.row] = at_ends.length
    places = _NearestPlaces.join([at_ends, _places_inside_pieces(search, end_length)])
    angles = np.zeros(len(places.row))  # targets come first; inside of pieces orientations are not checked
    angles[: len(at_ends.row)] = _orientation_errors_at(nominal_path, corrected_path, load, at_ends.length, at_ends.row)
    order = np.lexsort((places.t, places.row))
    places = places.take(order)
    return replace(
        cuts,
        row=places.row,
        t=places.t,
        nominal_distance=places.nominal_distance,
        corrected_distance=places.corrected_distance,
        path_rotation=angles[order],
        length=places.length,
    )


class _NearestPlaces(Columns, frozen=True, eq=False):
    """Places of the second program, and the places of the nominal path that their loaded tips are nearest to.

    :param row: (n,) motions of the second program; `t` (n,) places on them.
    :param length: (n,) arc lengths of the nearest places on the nominal path [m].
    :param nominal_distance: (n,) distance of the loaded tip from the nearest place by the nominal program [m].
    :param corrected_distance: (n,) the same by the second program [m].
    """

    row: Ints
    t: Array
    length: Array
    nominal_distance: Array
    corrected_distance: Array

    @classmethod
    def of(cls, search: Search, row: Ints, t: Array, guess: Array, sufficient_distance: float) -> _NearestPlaces:
        """Return the places on the nominal path nearest to n places of the second program, without those out of reach.

        :param row: (n,) motions of the second program; `t` (n,) places on them.
        :param guess: (n,) approximate arc lengths on the nominal path [m].
        :param sufficient_distance: a deviation that is small enough: no nearer place is sought [m].
        """
        # in chunks: the search for a place far from its guess tries more than a hundred arc lengths
        return cls.join(
            [cls._of_chunk(search, row[part], t[part], guess[part], sufficient_distance) for part in chunks(len(row))]
        )

    @classmethod
    def _of_chunk(cls, search: Search, row: Ints, t: Array, guess: Array, sufficient_distance: float) -> _NearestPlaces:
        """Return the nearest places as `of`, computed for all places at once."""
        joints = search.corrected_path.joints_at(row, t)
        is_reachable = np.isfinite(joints).all(axis=1)
        row, t, guess = row[is_reachable], t[is_reachable], guess[is_reachable]
        deviations = search.deviations(row, t, joints[is_reachable], guess, sufficient_distance=sufficient_distance)
        return cls(row, t, deviations.length, deviations.nominal_distance, deviations.corrected_distance)


def _places_inside_pieces(search: Search, end_length: Array) -> _NearestPlaces:
    """Return places inside the lines and arcs of the second program, with the nearest places of the nominal path.

    A piece is such a line or arc, from one target to the next. Pieces of unknown length, very short ones, and those
    that cover a step of the force are left out.

    :param end_length: (M,) arc lengths on the nominal path at which the second program's motions end [m]; NaN where
        unknown.
    """
    nominal_path, corrected_path, stretches = search.nominal_path, search.corrected_path, search.stretches
    pieces = stretches.pieces()
    begin, end = stretches.begin_lengths(pieces, end_length), end_length[pieces]
    is_checked = (end - begin > _MIN_PIECE_LENGTH) & ~_covers_step(nominal_path, search.load, end)
    pieces, begin = pieces[is_checked], begin[is_checked]
    row, t = places_on_pieces(corrected_path, pieces, _is_steep(nominal_path, corrected_path, pieces, end_length))
    begin_length = begin[np.searchsorted(pieces, row)]  # of the piece of each place: pieces are ascending motions
    guess = begin_length + t * (end_length[row] - begin_length)
    return _NearestPlaces.of(search, row, t, guess, nominal_path.robot_in_cell.tolerance)


class Stretches(Struct, frozen=True, eq=False):
    """The stretches of both paths between pairs: stretch k leads from pair k − 1 to pair k, the first from the start.

    :param corrected_path: the second program, of M motions.
    :param stretch: (M,) the stretch of each motion; P for those after the last pair.
    :param begin: (P,) arc lengths on the nominal path at which the stretches begin, `end` (P,) at which they end [m].
    :param corrected_span: (P, 2) arc lengths on the second path at which the stretches begin and end [m].
    :param is_comparable: (P,) True where the whole nominal stretch is cutting lines and arcs that can be corrected.
    """

    corrected_path: PlacedProgram
    stretch: Ints
    begin: Array
    end: Array
    corrected_span: Array
    is_comparable: Bools

    @classmethod
    def from_pairs(
        cls, comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
    ) -> Stretches:
        """Return the stretches between the pairs of a comparison.

        A stretch is comparable if no motion in it is unknown: a rapid move, PTP or SPL to a Cartesian target, or a
        motion whose start is not corrected.
        """
        m, (nominal_rows, corrected_rows) = nominal_path.program.motions, comparison.pair.T
        is_axis_target = np.isfinite(m.joints[:, 0])
        is_unknown = (np.isin(m.kind, (PTP, SPL)) | m.rapid) & ~is_axis_target
        # number of unknown motions before each motion; the last element is that of all motions
        unknown_count = np.append(0, np.cumsum(is_unknown | _has_uncorrected_start(nominal_path)))
        # stretch k is behind the motion of pair k − 1, up to that of pair k; the first one begins with motion 0
        count_at_limits = unknown_count[np.append(0, nominal_rows + 1)]
        pairs = np.arange(len(comparison.pair))
        begin, end = stretch_limits(nominal_path, nominal_rows, pairs)
        return cls(
            corrected_path,
            stretch=np.searchsorted(corrected_rows, np.arange(len(corrected_path.program.motions))),
            begin=begin,
            end=end,
            corrected_span=np.stack(stretch_limits(corrected_path, corrected_rows, pairs), axis=1),
            is_comparable=np.diff(count_at_limits) == 0,
        )

    def _is_on_comparable_stretch(self, row: Ints) -> Bools:
        """Return which motions `row` (n,) of the second program are on a stretch that is comparable."""
        return np.append(self.is_comparable, False)[self.stretch[row]]  # after the last pair is no stretch

    def targets(self, comparison: Comparison) -> Ints:
        """Return the targets (n,) without a partner that are compared with the nominal path, ascending.

        Those are all inserted targets, and additional ones that end lines or arcs on comparable stretches.
        """
        additional_rows = comparison.additional_rows
        kind = self.corrected_path.program.motions.kind
        is_cut = np.isin(kind[additional_rows], (LIN, CIRC))
        additional_rows = additional_rows[self._is_on_comparable_stretch(additional_rows) & is_cut]
        return np.sort(np.append(comparison.inserted_rows, additional_rows))

    def pieces(self) -> Ints:
        """Return the lines and arcs (n,) of the second program that are compared with the nominal path inside."""
        rows = self.corrected_path.target_rows
        rows = rows[np.isin(self.corrected_path.program.motions.kind[rows], (LIN, CIRC))]
        return rows[self._is_on_comparable_stretch(rows) & ~_has_uncorrected_start(self.corrected_path)[rows]]

    def guessed_lengths(self, row: Ints) -> Array:
        """Return arc lengths (n,) on the nominal path [m] at the same share of the stretch as the ends of motions.

        :param row: (n,) motions of the second program.
        """
        stretch = self.stretch[row]
        begin, end = self.corrected_span[stretch].T
        share = (self.corrected_path.arc_length[row + 1] - begin) / np.maximum(end - begin, NO_DISTANCE)
        return np.asarray(self.begin[stretch] + share * (self.end[stretch] - self.begin[stretch]))

    def begin_lengths(self, row: Ints, end_length: Array) -> Array:
        """Return the arc lengths (n,) on the nominal path at which motions begin [m].

        A motion begins at the target before it, the first one where its stretch begins.

        :param row: (n,) motions of the second program.
        :param end_length: (M,) arc lengths on the nominal path at which the second program's motions end [m].
        """
        previous_target = np.searchsorted(self.corrected_path.target_rows, row) - 1  # −1: none
        previous_row = self.corrected_path.target_rows[previous_target]
        return np.where(previous_target >= 0, end_length[previous_row], self.begin[self.stretch[row]])


def _covers_step(nominal_path: PlacedProgram, load: PathForces, end_length: Array) -> Bools:
    """Return True (n,) for pieces that end so soon after a step of the force that they cover it.

    The force steps where cuts start.

    :param end_length: (n,) arc lengths on the nominal path at which the pieces end [m]; NaN where unknown.
    """
    # pieces whose end is unknown (NaN) are not checked anyway: any place may stand for it
    return load.is_behind_step(*nominal_path.at(np.nan_to_num(end_length)))


def _has_uncorrected_start(side: PlacedProgram) -> Bools:
    """Return which motions (M,) begin at an unknown place, or at a pose that is not corrected.

    The start of the program and axis targets are not corrected, unless the arm at rest is nominal.
    """
    m, predecessors = side.program.motions, side.program.predecessors
    # a motion that is its own predecessor begins at an unknown place
    has_unknown_start = predecessors == np.arange(len(m))
    # row −1, the last one, is the start of the program: it is given by joints too
    begins_at_joints = np.append(np.isfinite(m.joints[:, 0]), True)[predecessors]
    return np.asarray(has_unknown_start | (begins_at_joints & (not side.robot_in_cell.rest_is_nominal)))


def _is_steep(nominal_path: PlacedProgram, corrected_path: PlacedProgram, pieces: Ints, end_length: Array) -> Bools:
    """Return which lines and arcs (n,) of the second program are displaced differently at their ends.

    The displacement is from the nominal path. True as well where that of an end is unknown.

    :param pieces: (n,) motions of the second program.
    :param end_length: (M,) arc lengths on the nominal path of the ends of the second program's motions [m]; NaN where
        unknown.
    """
    rows = np.flatnonzero(np.isfinite(end_length))
    displacements = np.full((len(end_length), 3), np.nan)
    displacements[rows] = corrected_path.points(corrected_path.arc_length[rows + 1]) - nominal_path.points(
        end_length[rows]
    )
    previous_target = np.maximum(np.searchsorted(corrected_path.target_rows, pieces) - 1, 0)
    changes = norm(displacements[pieces] - displacements[corrected_path.target_rows[previous_target]])
    return ~np.asarray(changes <= _STEEP_CHANGE)  # True for NaN


def places_on_pieces(corrected_path: PlacedProgram, pieces: Ints, is_steep: Bools) -> tuple[Ints, Array]:
    """Return places (row, t), (k,) each, inside of lines and arcs of the second program.

    :param pieces: (n,) motions of the second program.
    :param is_steep: (n,) True where the displacement differs between both ends: more places are checked there.
    """
    kind, segments = corrected_path.program.motions.kind[pieces], corrected_path.segments
    is_arc = kind == CIRC
    length, turn = segments.length[pieces], segments.turn[pieces]
    part_counts = number_of_places(kind, length, turn, is_curved=is_arc, is_steep=is_arc | is_steep)
    row, t = toolpath.even_places(pieces, np.maximum(part_counts, _MIN_PARTS))
    is_inside = t < 1.0
    return row[is_inside], t[is_inside]


def _orientation_errors_at(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, load: PathForces, length: Array, row: Ints
) -> Array:
    """Return the angles (n,) by which targets of the second program turn the loaded tool from the nominal path [rad].

    The smaller of two: from the orientation that keeps the loaded tool nominal, and from the nominal orientation, which
    programs have that correct positions alone.

    :param length: (n,) arc lengths on the nominal path [m]; `row` (n,) motions of the second program.
    :raises ForceError: the arm has no equilibrium under a force.
    """
    program, (motion, t) = nominal_path.program, nominal_path.at(length)
    wrench = nominal_path.wrench(load, motion, t)
    pose = toolpath.pose_in_root(program, motion, toolpath.at(program, nominal_path.segments, motion, t).pose[:], t)
    tool = toolpath.tool_of(program, motion)
    try:
        compensated_pose = nominal_path.robot_in_cell.compensate(
            pose, nominal_path.joints_at(motion, t), tool, wrench
        ).pose
    except NotConvergedError as cause:
        raise no_equilibrium(program, motion, cause) from None
    flange = toolpath.flange_from_tcp(corrected_path.program, row, corrected_path.program.motions.target[row], None)
    commanded_pose = flange @ tool
    angles = angle_between(compensated_pose[:, :3, :3], commanded_pose[:, :3, :3])
    return np.asarray(np.minimum(angles, angle_between(pose[:, :3, :3], commanded_pose[:, :3, :3])))


class _Deviations(NamedTuple):
    """Places of the nominal path that the loaded tip of the second program is nearest to, and the tips' distances.

    :param length: (n,) arc lengths of these places on the nominal path [m].
    :param nominal_distance: (n,) distances of the loaded tip of the nominal program from these places [m].
    :param corrected_distance: (n,) distances of the loaded tip of the second program from these places [m].
    """

    length: Array
    nominal_distance: Array
    corrected_distance: Array


class Search(Struct, frozen=True, eq=False):
    """Finds the place of the nominal path that the loaded tip of the second program is nearest to.

    The force acts where the tool is on the nominal path, so it depends on the place that is sought.
    """

    nominal_path: PlacedProgram
    corrected_path: PlacedProgram
    load: PathForces
    stretches: Stretches

    def deviations(self, row: Ints, t: Array, q: Array, guess: Array, *, sufficient_distance: float) -> _Deviations:
        """Return the place of the nominal path nearest to the loaded tip, for each of n places of the second program.

        With it come the distances of the loaded tip from there: by the nominal program, and by the second one.

        :param row: (n,) motions of the second program; `t` (n,) places on them; `q` (n, 6) joint angles there [rad].
        :param guess: (n,) approximate arc lengths on the nominal path [m].
        :param sufficient_distance: a distance that is small enough: no nearer place is sought [m].
        :raises ForceError: the arm has no equilibrium under a force.
        """
        length, distance = self._nearest_places(row, t, q, guess, sufficient_distance)
        motion, nominal_t = self.nominal_path.at(length)
        nominal_q = self.nominal_path.joints_at(motion, nominal_t)
        displacement = self.nominal_path.carriage_displacement(motion, nominal_t)
        return _Deviations(length, norm(self._tip_offset(nominal_q, displacement, length)), distance)

    def _nearest_places(
        self, row: Ints, t: Array, q: Array, guess: Array, sufficient_distance: float
    ) -> tuple[Array, Array]:
        """Return arc lengths (n,) on the nominal path nearest to the tip, and the distances there (n,) [m].

        Newton steps begin at the guess. Where they end far from the tip, many places of the stretch are tried.
        Parameters as of `deviations`.
        """
        stretch, displacement = self.stretches.stretch[row], self.corrected_path.carriage_displacement(row, t)
        low, high = self.stretches.begin[stretch], self.stretches.end[stretch]
        # a little (1e-4: assumed) behind the end of the motion before, whose force and tool may be others
        low = np.minimum(low + _MIN_PIECE_LENGTH * 1e-4, high)
        start = np.clip(guess, low, high)
        length, distance = self._newton_steps(q, displacement, start, (low, high), accuracy=sufficient_distance)
        close_distance = max(sufficient_distance, _CLOSE_SHARE * self.nominal_path.robot_in_cell.tolerance)
        distant_rows = np.flatnonzero(distance > close_distance)
        if len(distant_rows):
            q, displacement = q[distant_rows], displacement[distant_rows]
            limits = low[distant_rows], high[distant_rows]
            start = self._nearest_lengths(q, displacement, limits)
            new_length, new_distance = self._newton_steps(q, displacement, start, limits, accuracy=_SUFFICIENT_DISTANCE)
            is_nearer = new_distance < distance[distant_rows]
            nearer_rows = distant_rows[is_nearer]
            length[nearer_rows], distance[nearer_rows] = new_length[is_nearer], new_distance[is_nearer]
        return length, distance

    def _tip_offset(self, q: Array, displacement: Array, length: Array) -> Array:
        """Return the tips (n, 3) under the forces at places of the nominal path, minus these places, in the cell [m].

        :param q: (n, 6) commanded joint angles [rad], `displacement` (n, 3) of the robot by E1 [m].
        :param length: (n,) arc lengths on the nominal path [m].
        """
        motion, t = self.nominal_path.at(length)
        tip = self._tip(q, displacement, motion, self.nominal_path.wrench(self.load, motion, t))
        return tip - self.nominal_path.points(length)

    def _tip(self, q: Array, displacement: Array, motion: Ints, wrench: Array) -> Array:
        """Return the loaded tips (n, 3) in the cell (robot root at E1 = 0) [m] at joint angles q (n, 6) [rad].

        :param displacement: (n, 3) of the robot by E1 [m].
        :param motion: (n,) nominal motions, whose tool is used; `wrench` (n, 6) at the tip, root axes [N, N·m].
        :raises ForceError: there is no equilibrium on a motion.
        """
        try:
            return self.nominal_path.loaded_tip(motion, q, wrench, displacement)
        except NotConvergedError as cause:
            raise no_equilibrium(self.nominal_path.program, motion, cause) from None

    def _newton_steps(
        self, q: Array, displacement: Array, length: Array, limits: tuple[Array, Array], accuracy: float
    ) -> tuple[Array, Array]:
        """Return arc lengths (n,) of the nominal path nearest to the tip, and the distances there (n,) [m].

        Gauss-Newton steps of the square of the distance, whose derivative is a finite difference.

        :param q: (n, 6) commanded joint angles [rad], `displacement` (n, 3) of the robot by E1 [m].
        :param length: (n,) start values [m]; changed in place.
        :param limits: smallest and largest arc lengths, (n,) each [m].
        :param accuracy: a distance that is not improved further [m].
        """
        deviations = self._tip_offset(q, displacement, length)
        best, distance = length.copy(), norm(deviations)
        rows = np.flatnonzero(distance > accuracy)
        for _ in range(_GAUSS_NEWTON_STEPS):
            if not len(rows):
                break
            low, high = limits[0][rows], limits[1][rows]
            step = np.where(length[rows] + _DIFFERENCE_STEP < high, _DIFFERENCE_STEP, -_DIFFERENCE_STEP)
            stepped_offset = self._tip_offset(q[rows], displacement[rows], length[rows] + step)
            derivative = (stepped_offset - deviations[rows]) / step[:, None]
            square = np.einsum("ni,ni->n", derivative, derivative)
            slope = np.einsum("ni,ni->n", deviations[rows], derivative)
            does_tip_move = square > _LEAST_RATE**2  # else the path only turns the tool here
            newton_step = np.where(does_tip_move, -slope / np.where(does_tip_move, square, 1.0), 0.0)
            length[rows] = np.clip(length[rows] + newton_step, low, high)
            deviations[rows] = self._tip_offset(q[rows], displacement[rows], length[rows])
            new_distance = norm(deviations[rows])
            is_nearer = new_distance < distance[rows]
            nearer_rows = rows[is_nearer]
            best[nearer_rows], distance[nearer_rows] = length[nearer_rows], new_distance[is_nearer]
            rows = rows[distance[rows] > accuracy]
        return best, distance

    def _nearest_lengths(self, q: Array, displacement: Array, limits: tuple[Array, Array]) -> Array:
        """Return the arc lengths (n,) nearest to the tip among many between limits [m].

        The force moves the tip: on a steep ramp the tip may move back while the path goes on. The deflection is taken
        from the compliance at the end of the stretch, which costs seven equilibria instead of one for each place tried.

        :param q: (n, 6) commanded joint angles [rad], `displacement` (n, 3) how far E1 has carried the robot [m].
        :param limits: smallest and largest arc lengths, (n,) each [m].
        """
        low, high = limits
        motion_at_end = self.nominal_path.at(high)[0]
        unloaded_tip = self._tip(q, displacement, motion_at_end, np.zeros((len(q), 6)))
        compliance = self._tip_compliance(q, displacement, motion_at_end, unloaded_tip)
        lengths = self._start_lengths(low, high)
        rows = np.arange(len(q))
        for _ in range(_REFINEMENTS):
            row_of_sample = np.repeat(rows, lengths.shape[1])
            motion, t = self.nominal_path.at(lengths.ravel())
            wrench = self.nominal_path.wrench(self.load, motion, t)
            tips = unloaded_tip[row_of_sample] + np.einsum("nij,nj->ni", compliance[row_of_sample], wrench)
            distances = norm(tips - self.nominal_path.points(lengths.ravel())).reshape(lengths.shape)
            best = np.argmin(distances, axis=1)
            length = lengths[rows, best]
            # the next samples are between the neighbours of the best one
            begin = lengths[rows, np.maximum(best - 1, 0)]
            end = lengths[rows, np.minimum(best + 1, lengths.shape[1] - 1)]
            lengths = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, _RAMP_SAMPLES)
        return np.asarray(length)

    def _tip_compliance(self, q: Array, displacement: Array, motion: Ints, unloaded_tip: Array) -> Array:
        """Return the deflection of the tip per unit of each component of the wrench (n, 3, 6) [m/N, m/(N·m)].

        It is that under each component of `_PROBE_WRENCH` alone, divided by the component.

        :param unloaded_tip: (n, 3) the tip without load, in the cell [m]; other parameters as of `_tip`.
        """
        deflections = [
            self._tip(q, displacement, motion, np.tile(wrench, (len(q), 1))) - unloaded_tip
            for wrench in np.diag(_PROBE_WRENCH)
        ]
        return np.asarray(np.stack(deflections, axis=2) / _PROBE_WRENCH)

    def _start_lengths(self, low: Array, high: Array) -> Array:
        """Return the arc lengths (n, s) at which the search begins, ascending [m].

        They are evenly spaced on the whole stretch, closer on the ramp at its begin, where the force changes, and
        closest just behind the begin, where it may have a step.

        :param low: (n,) smallest arc lengths, `high` (n,) largest ones [m].
        """
        fractions = np.linspace(0.0, 1.0, _START_VALUES)
        stretch_length = (high - low)[:, None]
        ramp_length = np.minimum(_RAMPS * self.nominal_path.robot_in_cell.ramp, stretch_length)
        distances = np.hstack([stretch_length * fractions, ramp_length * fractions, stretch_length * _FIRST_SHARES])
        return np.asarray(low[:, None] + np.sort(distances, axis=1))
