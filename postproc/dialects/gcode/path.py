"""From moves to motions in `$BASE`: arcs, rotary axes, approaches, and all faults of a program.

Rows are lines of the program as executed. Lengths are in mm in the program frame until the last step.

**Approaches.** A machine that comes from home travels in X and Y and then goes down. A robot that goes to the same
position directly moves by its joints, possibly through the part. With `[machine] clearance_Z` it first goes to that
height above the position (with a tilted tool: back along the tool), and then straight to it.

**Rotary axes.** With tool-centre-point control X, Y, Z are the tip in the part, and A, B, C tilt the tool about X, Y
and Z; `[rotary]` gives their order from the part outwards and their signs. Only the direction of the tool
R₁(a)·R₂(b)·z counts: a robot need not rotate the tool about its own axis as the machine does (`program.Swivel`). Before
they are programmed, rotary axes are at zero. Indexed axes turn the part: see `rotary`. F of a move that turns axes
alone is in deg/min, as in LinuxCNC: its time is √(ΔA² + ΔB² + ΔC²) / F.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.cell import Rotary
from postproc.chunks import Runs
from postproc.dialects.circles import ArcColumns
from postproc.dialects.gcode.arcs import POINT_TOLERANCE_MM, ArcFault, Arcs, ArcWords, read_arcs
from postproc.dialects.gcode.cycles import CycleEvent
from postproc.dialects.gcode.line_states import LineStates, active_values, take_rows
from postproc.dialects.gcode.modes import MM_PER_UNIT, Modes, tip_codes
from postproc.dialects.gcode.moves import LEAST_TOOL_Z, CellFrames, Moves, below_top, moves_of
from postproc.dialects.gcode.rotary import RotaryAxes, kind_faults
from postproc.dialects.gcode.words import Fault, Remark
from postproc.errors import MAX_ERRORS
from postproc.frames import M_PER_MM, RAD_PER_DEG, S_PER_MIN, Array, angle_between, any_column, norm
from postproc.poses import Poses
from postproc.program import (
    CIRC,
    COMPONENTS,
    LIN,
    PTP,
    Bools,
    Ints,
    Motions,
    Swivel,
    constant,
    direction,
    distinct,
    largest_rotation,
    read_only,
    tilt_to,
)

_HEIGHT_TOLERANCE_MM = 1e-6
"""Heights [mm] that differ by less are equal: far below the last digit of any program."""


class ApproachedMoves(NamedTuple):
    """N moves of a program, with the approach from a position that is not known: at the start, and after G28.

    :param moves: all moves.
    :param is_held_back: (N,) moves that are left out while X, Y, Z are not all known.
    :param is_arrival: (N,) rapids that go to the known position instead, or above it.
    """

    moves: Moves
    is_held_back: Bools
    is_arrival: Bools


def arrivals(moves: Moves) -> tuple[Bools, Bools]:
    """Return which moves (N,) are held back while X, Y, Z are not all known, and which (N,) arrive there.

    The move on the last row of a range of unknown positions arrives: it starts wherever the robot is. At the start of a
    program that is a rapid; a move at feed begins at `[start]`. After G28, G30 and G53 it may be a move at feed too.
    """
    is_held_back, is_arrival = np.zeros(len(moves.row), dtype=bool), np.zeros(len(moves.row), dtype=bool)
    for number, (first, last) in enumerate(moves.unknown_ranges):
        begin, end = np.searchsorted(moves.row, [first, last]).tolist()  # rows never decrease
        is_held_back[begin:end] = ~moves.is_home_move[begin:end]
        arrival = slice(end, end + 1)  # the move on the last row; empty if the program ends before
        is_program_start = number == 0
        is_arrival[arrival] = moves.code[arrival] <= (0.0 if is_program_start else 1.0)  # 0: rapid, 1: straight at feed
    return is_held_back, is_arrival


def add_approaches(moves: Moves, cell_frames: CellFrames) -> ApproachedMoves:
    """Return the moves; each that comes from home is divided into an approach at the clearance height and the rest.

    The approach is rapid, the rest as programmed. The first move from `[start]` has no separate approach: the user
    chose that position. Without a clearance height no move has one: the whole move is rapid.
    """
    is_held_back, is_arrival = arrivals(moves)
    # the first range is the begin of the program; the others follow G28, G30 or G53
    is_return = is_arrival & (moves.row >= min((first for first, _ in moves.unknown_ranges[1:]), default=np.inf))
    if cell_frames.clearance is None or not is_return.any():
        return ApproachedMoves(_with_rapids(moves, is_arrival), is_held_back, is_arrival)
    returns = np.flatnonzero(is_return)
    tool_direction = cell_frames.rotary.tool_direction(moves.rotary_angles[returns, 1])
    length = _approach_lengths(moves, returns, tool_direction, cell_frames.clearance)
    needs_approach = length > 0.0
    count = np.ones(len(moves.row), dtype=np.int64)
    count[returns[needs_approach]] = 2
    # each of these moves becomes two: the first of them ends at the clearance height, the second where the move ended
    approach_moves = np.cumsum(count)[returns[needs_approach]] - 2
    new_moves = moves.repeat(count)
    end, rotary_angles = new_moves.end.copy(), new_moves.rotary_angles.copy()
    end[approach_moves] += tool_direction[needs_approach] * length[needs_approach][:, None]
    # at begin (0) and end (1) of each move: the approach turns the axes, the second move keeps them
    rotary_angles[approach_moves + 1, 0] = rotary_angles[approach_moves, 1]
    is_arrival = np.repeat(is_arrival, count)
    is_arrival[approach_moves + 1] = False
    new_moves = replace(new_moves, end=end, rotary_angles=rotary_angles)
    return ApproachedMoves(_with_rapids(new_moves, is_arrival), np.repeat(is_held_back, count), is_arrival)


def _with_rapids(moves: Moves, is_rapid: Bools) -> Moves:
    """Return moves of which some (N,) are rapids, whatever their code was."""
    return replace(moves, code=np.where(is_rapid, 0.0, moves.code))


def _approach_lengths(moves: Moves, returns: Ints, tool_direction: Array, clearance: float) -> Array:
    """Return the length (n,) of the approach of moves, along the tool from the clearance height to their ends [mm].

    It is 0 for a move that ends at that height or above, and where the tool is nearly horizontal.

    :param returns: (n,) indices of these moves.
    :param tool_direction: (n, 3) unit vectors from the tip to the spindle at their ends.
    :param clearance: Z in `$BASE` [mm].
    """
    frames = moves.machine_frames[moves.frame[returns]]
    tool_z = np.einsum("ni,ni->n", frames[:, 2, :3], tool_direction)
    z = np.einsum("ni,ni->n", frames[:, 2, :3], moves.end[returns]) + frames[:, 2, 3] / M_PER_MM
    needs_approach = (z < clearance - _HEIGHT_TOLERANCE_MM) & (tool_z > LEAST_TOOL_Z)
    length = np.zeros(len(returns))
    length[needs_approach] = (clearance - z[needs_approach]) / tool_z[needs_approach]
    return length


def chords(moves: Moves, circular: Ints, arcs: Arcs, tolerance: float) -> tuple[Moves, Ints]:
    """Replace arcs along which rotary axes turn by chords.

    The largest angle of a chord is √(8·tolerance / radius), because its sagitta is radius·angle²/8.

    :param circular: (A,) indices of the moves that are `arcs`.
    :param tolerance: largest deviation of chords from arcs [mm].
    :returns: the moves with chords, and the number (N,) of chords for each move; 1 for other moves.
    """
    count = np.ones(len(moves.row), dtype=np.int64)
    turns = (moves.rotary_angles[circular, 0] != moves.rotary_angles[circular, 1]).any(axis=1)
    if not turns.any():
        return moves, count
    begin = moves.begin(circular)
    radial = begin - arcs.centre
    angle = np.sqrt(8.0 * tolerance / np.maximum(norm(radial), tolerance))
    # 1e-9: a sweep that is a whole number of chords but for rounding gets no further chord
    count[circular[turns]] = np.ceil(arcs.sweep[turns] / angle[turns] - 1e-9).astype(np.int64)
    new_moves = moves.repeat(count)
    code, end, turn = new_moves.code.copy(), new_moves.end.copy(), new_moves.rotary_angles.copy()
    first = np.cumsum(count) - count
    for n in np.flatnonzero(turns).tolist():
        move = circular[n]
        rows = slice(first[move], first[move] + count[move])
        share = np.linspace(0.0, 1.0, count[move] + 1)[:, None]
        path = _helix_points(begin[n], moves.end[move], radial[n], arcs.normal[n], arcs.sweep[n] * share)
        path[-1] = moves.end[move]  # without rounding
        angles = moves.rotary_angles[move, 0] + share * (moves.rotary_angles[move, 1] - moves.rotary_angles[move, 0])
        code[rows], end[rows] = 1, path[1:]
        turn[rows] = np.stack([angles[:-1], angles[1:]], axis=1)
    return replace(new_moves, code=code, end=end, rotary_angles=turn), count


def _helix_points(begin: Array, end: Array, radial: Array, normal: Array, angle: Array) -> Array:
    """Return points (n, 3) of a helix whose radius and height change in proportion to the angle.

    :param begin: (3,) start of the helix; `end`: (3,) its end, which sets the climb and the last radius.
    :param radial: (3,) from the axis to the start; `normal`: (3,) unit axis.
    :param angle: (n, 1) angles about the axis from the start [rad], ascending; the last is the whole angle.
    """
    share = angle / angle[-1]
    climb = normal * (normal @ (end - begin))
    growth = norm(end - climb - begin + radial) / norm(radial) - 1.0
    radius_vectors = np.cos(angle) * radial + np.sin(angle) * np.cross(normal, radial)
    return np.asarray(begin - radial + radius_vectors * (1.0 + share * growth) + share * climb)


_LEAST_DIRECTION_Z = -0.9999
"""Tool directions with a smaller Z are refused: there is no unique shortest rotation to −Z."""
_ROTATION_STEPS = 32
"""Steps in which the rotation of the tool is summed."""


def rotation_bound(moves: Moves, axes: Array) -> Array:
    """Return an upper bound of the rotation of the tool in each move (N,) [rad], see `turning`.

    :param axes: (k, 3) unit vectors of the rotary axes.
    """
    angles = np.zeros(len(moves.row))
    turning_moves = np.flatnonzero((moves.rotary_angles[:, 0] != moves.rotary_angles[:, 1]).any(axis=1))
    if len(turning_moves):
        angle_pairs = moves.rotary_angles[turning_moves] * RAD_PER_DEG
        angles[turning_moves] = largest_rotation(axes, angle_pairs[:, 0], angle_pairs[:, 1])
    return angles


def swivel_of(motion_moves: _MotionMoves, lines: LineStates, cell_frames: CellFrames) -> Swivel:
    """Return the rotation of the tool by the rotary axes in the motions of a program.

    It is inactive for motions by joint interpolation, moves to home, and the first motion.
    """
    moves, index = motion_moves.moves, motion_moves.index
    active = ~motion_moves.is_free & ~moves.is_home_move[index]
    active[:1] = False  # the first motion comes from wherever the robot is
    start_angles, end_angles = moves.rotary_angles[index, 0] * RAD_PER_DEG, moves.rotary_angles[index, 1] * RAD_PER_DEG
    return Swivel(
        begin=start_angles,
        end=end_angles,
        axes=cell_frames.rotary.directions,
        frame=moves.frame[index],
        frames=moves.machine_frames[:, :3, :3],
        tool=cell_frames.orientation,
        active=active,
        rate=_rotation_rates(motion_moves, lines, cell_frames.rotary.directions),
    )


def _rotation_rates(motion_moves: _MotionMoves, lines: LineStates, axes: Array) -> Array:
    """Return the angular speed (M,) of motions that only rotate the tool [rad/s]; NaN for all others.

    The time of such a motion is √(ΔA² + ΔB² + ΔC²) / F with angles in degrees and F in deg/min; in G93 it is 1 / F.
    With directions of the tool in place of angles the speed is NaN, except in G93.

    :param axes: (k, 3) unit vectors of the rotary axes.
    """
    rate = np.full(len(motion_moves.index), np.nan)
    rotations = np.flatnonzero(motion_moves.is_rotation)
    if not len(rotations):
        return rate
    index = motion_moves.index[rotations]
    row, angles = motion_moves.moves.row[index], motion_moves.moves.rotary_angles[index]
    begin_angles, end_angles = angles[:, 0], angles[:, 1]
    degrees = norm(end_angles - begin_angles)
    if angles.shape[2] == COMPONENTS:  # directions: no control states the unit of F for their turns
        degrees = np.full(len(rotations), np.nan)
    minutes = np.where(lines.is_inverse_time[row], 1.0, degrees) / lines.written_feed[row]
    swept_angles = _swept_angles(axes, begin_angles * RAD_PER_DEG, end_angles * RAD_PER_DEG)
    rate[rotations] = swept_angles / (minutes * S_PER_MIN)
    return rate


def _swept_angles(axes: Array, begin: Array, end: Array) -> Array:
    """Return the angle through which the tool turns in each motion (n,) [rad], summed over `_ROTATION_STEPS` steps.

    :param axes: (k, 3) unit vectors of the rotary axes; `begin`, `end`: (n, k) their angles at start and end [rad].
    """
    angles = np.zeros(len(begin))
    start_direction = tilt_to(direction(axes, begin))
    for step in range(1, _ROTATION_STEPS + 1):
        end_direction = tilt_to(direction(axes, begin + (end - begin) * (step / _ROTATION_STEPS)))
        angles += angle_between(start_direction, end_direction)
        start_direction = end_direction
    return angles


def turning_faults(
    lines: LineStates, moves: Moves, is_early: Bools, rotary_axes: RotaryAxes, code_names: str
) -> list[Fault]:
    """Return faults of rotary axes, in order of lines.

    :param is_early: (N,) moves that are left out while X, Y, Z are not all known.
    :param code_names: codes that switch tool-centre-point control on, for the advice.
    """
    is_tilted = (moves.rotary_angles != rotary_axes.upright).any(axis=(1, 2))
    axes = rotary_axes.directions
    has_position = ~np.isnan(lines.xyz[moves.row]).all(axis=1) | (moves.code > 0.0)

    # at the start and at the end of each move
    is_upside_down = [
        direction(axes, moves.rotary_angles[:, end] * RAD_PER_DEG)[:, 2] < _LEAST_DIRECTION_Z for end in (0, 1)
    ]
    faults: dict[int, Fault] = {}
    for is_invalid, problem, advice in (
        (
            np.any(is_upside_down, axis=0),
            "the tool points away from the part",
            "Check axes and signs in [rotary].",
        ),
        (
            is_tilted & has_position & ~lines.is_tip_controlled[moves.row] & ~moves.is_home_move & ~is_early,
            "coordinates with tilted axes, but without tool-centre-point control",
            f"They depend on the machine: program {code_names} before, or retract by G53 Z or G28 Z as [machine] says.",
        ),
    ):
        for row in moves.row[is_invalid][: MAX_ERRORS + 1].tolist():
            faults.setdefault(row, Fault(row, problem, advice))
    return [faults[row] for row in sorted(faults)]


def faults_of(
    lines: LineStates, moves: Moves, modes: Modes, arc_rows: Ints, arc_faults: Sequence[ArcFault]
) -> list[Fault]:
    """Return the faults in order of lines, one for each line.

    Faults that may only follow from an unreadable block before are left out.

    :param arc_rows: (A,) rows of the lines of arcs; `arc_faults`: faults of these arcs.
    """
    doubt = _Doubt(lines, modes.faults)
    faults = _LineFaults(modes.faults)
    _check_words(lines, modes, doubt, faults)
    _check_feeds(lines, doubt, faults)
    _check_unknown_positions(lines, moves, doubt, faults)
    for fault in moves.faults:
        if not (doubt.motion[fault.row] or doubt.position[fault.row]):
            faults.add(fault)
    for arc_fault in arc_faults:
        row = int(arc_rows[arc_fault.n])
        if not (doubt.motion[row] or (arc_fault.depends_on_start and doubt.position[row])):
            faults.add(Fault(row, arc_fault.problem, arc_fault.advice))
    return faults.in_order()


class _LineFaults:
    """Faults of a program, at most one for each line: the first that is added."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self._faults = {fault.row: fault for fault in faults}

    def add(self, fault: Fault) -> None:
        """Add a fault, unless its line has one."""
        self._faults.setdefault(fault.row, fault)

    def check(self, is_wrong: Bools, problem: str, advice: str | None = None, *, only_first: bool = False) -> None:
        """Add a fault for each line (L,) that is wrong, at most `MAX_ERRORS` + 1: no more are shown.

        :param only_first: report the first of these lines only, since the others have the same cause.
        """
        for row in np.flatnonzero(is_wrong)[: 1 if only_first else MAX_ERRORS + 1].tolist():
            self.add(Fault(row, problem, advice))

    def in_order(self) -> list[Fault]:
        """Return the faults in order of lines."""
        return [self._faults[row] for row in sorted(self._faults)]


def _is_arc(lines: LineStates) -> Bools:
    """Return on which lines (L,) G2 or G3 is active."""
    return np.asarray((lines.motion == 2.0) | (lines.motion == 3.0))


def _check_words(lines: LineStates, modes: Modes, doubt: _Doubt, faults: _LineFaults) -> None:
    """Add faults of lines with words that neither their arc nor their cycle uses, or with G4 and an arc.

    :param doubt: lines whose motion code is unknown after an unreadable block, which may use the words.
    """
    is_arc, has_centre = lines.is_moving & _is_arc(lines), any_column(~np.isnan(lines.ijk))
    uses_words = is_arc | lines.is_drilling | doubt.motion
    vector_advice = 'If I, J, K are the direction of the tool (G43.5), write kind = "vector" in [rotary] of the cell.'
    faults.check(has_centre & (lines.motion == 1.0) & ~uses_words, "I, J or K without an arc", vector_advice)
    has_arc_word = has_centre | ~(np.isnan(lines.radius) & np.isnan(lines.turns))
    faults.check(has_arc_word & ~uses_words, "I, J, K, R or P without an arc or a cycle that uses it")
    has_repeats = ~np.isnan(lines.repeats) & (lines.repeats != 0.0)  # L0 repeats nothing
    has_cycle_word = ~np.isnan(lines.pecks) | has_repeats
    faults.check(has_cycle_word & (~uses_words | is_arc), "Q or L without a cycle that uses it")
    for row in np.flatnonzero(lines.is_drilling & has_centre)[: MAX_ERRORS + 1].tolist():
        faults.add(Fault(row, "I, J or K in a cycle", _repeats_advice(lines, row)))
    has_dwell = np.zeros(len(lines.motion), dtype=bool)
    has_dwell[[row for row in modes.dwell_rows if row < len(has_dwell)]] = True
    faults.check(has_dwell & is_arc, "G4 in one block with an arc", "Write one block for each.")


def _check_feeds(lines: LineStates, doubt: _Doubt, faults: _LineFaults) -> None:
    """Add faults of lines that cut without a feed, and of cycles in G93.

    The feed of G94 is modal, so its fault is that of the first such line. F of G93 holds for its own line.

    :param doubt: lines whose motion code or feed is unknown after an unreadable block.
    """
    is_feed_motion = (lines.motion == 1.0) | _is_arc(lines)
    cuts = ((lines.has_motion_code | lines.is_moving) & is_feed_motion) | lines.is_drilling
    has_no_feed = cuts & ~(lines.feed > 0.0) & ~doubt.motion & ~doubt.feed  # also NaN
    has_no_g93_feed = has_no_feed & lines.is_inverse_time & lines.is_moving
    faults.check(has_no_feed & ~lines.is_inverse_time, "cutting move without a feed", "Give F.", only_first=True)
    faults.check(has_no_g93_feed, "cutting move in G93 without a feed", "Give F in each block.")
    advice = "Write G94, and F in mm/min or inch/min."
    faults.check(lines.is_drilling & lines.is_inverse_time, "a cycle in G93", advice, only_first=True)


def _repeats_advice(lines: LineStates, row: int) -> str | None:
    """Return advice for a line of a cycle whose K may be the number of holes, as on Fanuc.

    None: the line has I, J or L, or its K is not a positive whole number.

    :param row: row of the line.
    """
    i, j, k = (lines.ijk[row] / MM_PER_UNIT[float(lines.units[row])]).tolist()  # back in the units of the program
    count = 0.0 if isnan(k) else round(k, 9)  # without the rounding of the conversion to mm
    if not (isnan(i) and isnan(j) and isnan(lines.repeats[row])) or count < 1.0 or count != round(count):
        return None
    return f"If K is the number of holes, write L{count:g}."


def _check_unknown_positions(lines: LineStates, moves: Moves, doubt: _Doubt, faults: _LineFaults) -> None:
    """Add faults of moves that need a position that is not known yet: before X, Y, Z are programmed, and after G28.

    :param doubt: lines whose motion or position is in doubt because of other faults, which are reported instead.
    """
    row = np.arange(len(lines.motion))
    has_axis_word = lines.has_xyz_word
    advice = (
        "Program X, Y and Z in rapid moves (G0, in G90) first: the tool may be anywhere before. Or state in the cell "
        "where the machine is when the program starts: [machine] home = [X, Y, Z]."
    )
    unset_axes = [axis for axis, words in zip("XYZ", lines.xyz.T, strict=True) if np.isnan(words).all()]
    if unset_axes:
        advice += f" {' and '.join(unset_axes)} {'is' if len(unset_axes) == 1 else 'are'} never programmed."
    for first, complete_row in moves.unknown_ranges:
        if first >= len(row):
            continue
        is_within = (row >= first) & (row <= complete_row)
        is_early = has_axis_word & is_within & ~doubt.position
        problem = "incremental move before the position is known"
        faults.check(is_early & lines.is_incremental, problem, advice, only_first=True)
        begin = first + int(np.argmax(has_axis_word[first:])) if has_axis_word[first:].any() else first
        # a single line that gives X, Y and Z at once is no low move
        is_low = (begin != complete_row) & below_top(lines, first, complete_row)
        is_line = lines.motion == 1.0  # G1
        is_low_cut = (is_line & is_low) | (lines.is_drilling & (row < complete_row))
        is_cut = is_early & is_low_cut & ~doubt.motion
        faults.check(is_cut, "cutting move before the position is known", advice, only_first=True)
        is_unknown_arc = lines.is_moving & _is_arc(lines) & is_within & ~doubt.motion & ~doubt.position
        faults.check(is_unknown_arc, "arc before the position is known", advice, only_first=True)
        has_other_offset = is_early & (moves.offset != moves.offset[begin])
        faults.check(
            has_other_offset, "change of the work offset before the position is known", advice, only_first=True
        )


class _Doubt:
    """Lines (L,) whose state is unknown because of an unreadable block before or on them.

    :ivar motion: the active motion code is unknown, up to the line before the next motion code.
    :ivar position: the position at the start is unknown, until X, Y and Z have been programmed again.
    :ivar feed: the feed is unknown, up to the end of the program.
    """

    def __init__(self, lines: LineStates, faults: Sequence[Fault]) -> None:
        """Find the lines that may depend on the text of a fault, which was not read (`Fault.lost_text`).

        Any G in it may be a motion code, or a code that changes the position.
        """
        count = len(lines.motion)
        if not faults:
            self.motion = self.position = self.feed = np.zeros(count, dtype=bool)
            return
        row = np.arange(count)

        def last_rows(is_marked: Array | Bools) -> Ints:
            """Return for each row (L,) the last marked row up to it; −1: none."""
            return np.asarray(np.maximum.accumulate(np.where(is_marked, row, -1)), dtype=np.int64)

        def last_lost_rows(letters: str) -> Ints:
            """Return for each row (L,) the last row up to it with one of the letters in unreadable text; −1: none."""
            is_lost = np.zeros(count, dtype=bool)
            is_lost[[fault.row for fault in faults if set(letters) & set(fault.lost_text)]] = True
            return last_rows(is_lost)

        coordinate_rows = [last_rows(~np.isnan(lines.xyz[:, axis]) & ~lines.is_incremental) for axis in range(3)]
        position_row = np.minimum.reduce(coordinate_rows)
        position_row = np.concatenate([[-1], position_row[:-1]])  # a line starts at the position of the line before
        # a value is in doubt until the next row that states it
        self.motion = (last_lost_rows("G") >= 0) & (last_rows(lines.has_motion_code) <= last_lost_rows("G"))
        self.position = (last_lost_rows("GXYZIJK") >= 0) & (position_row <= last_lost_rows("GXYZIJK"))
        self.feed = last_lost_rows("F") >= 0


CHORD_TOLERANCE_SHARE = 0.1
"""Share of the tolerance that chords of arcs may use (assumed)."""
_LEAST_ROTATION = 1e-9
"""Rotations of the tool below this [rad] are ignored (assumed)."""


class Speeds(Struct, frozen=True):
    """Speeds and corner tolerances of the cell.

    :param rapid: speed of G0 [m/s].
    :param approximation: approximation distance [m].
    :param rounding: tolerance of rounded corners [m], unless the program gives it (G64 P).
    :param home_joints: (6,) joint angles of [machine] home [rad], or NaN.
    :param chord: tolerance of chords of an arc along which rotary axes turn [mm].
    """

    rapid: float
    approximation: float
    rounding: float
    home_joints: Array
    chord: float


class MotionPath(Struct, frozen=True, eq=False):
    """The motions of a program, and remarks.

    :param motions: see `Motions`; their lines are rows + 1.
    :param swivel: see `Program`.
    :param row: (M,) row of each motion, never decreasing.
    :param still_rows: (n,) rows of moves without a motion, ascending: moves of zero length, and those held back.
    :param unforced: (n,) motions at feed that come from `[start]` of the cell.
    :param held_back_rows: (n,) the rows of `still_rows` with rapid moves before the position is known.
    :param events: events of cycles: index of the motion after the event, row of its line, event.
    """

    motions: Motions
    swivel: Swivel | None
    row: Ints
    unforced: Ints
    still_rows: Ints
    held_back_rows: Ints
    events: Sequence[tuple[int, int, CycleEvent]]
    remarks: Sequence[Remark]


class _MotionMoves(Struct, frozen=True, eq=False):
    """The M motions of a program among its N moves: a line programs a move, the robot executes a motion.

    :param moves: all moves; arcs along which rotary axes turn are chords.
    :param index: (M,) indices of the moves that are motions, ascending.
    :param length: (M,) their lengths [mm].
    :param is_free: (M,) motions by joint interpolation.
    :param is_rotation: (M,) motions at feed that rotate the tool without moving its tip.
    :param circular: (A,) indices of the moves that are arcs; `arcs`: their geometry.
    :param is_held_back: (N,) moves left out while X, Y, Z are not all known; `is_null_move`: (N,) moves of no effect.
    """

    moves: Moves
    index: Ints
    length: Array
    is_free: Bools
    is_rotation: Bools
    circular: Ints
    arcs: Arcs
    is_held_back: Bools
    is_null_move: Bools


def read_path(
    lines: LineStates, modes: Modes, cell_frames: CellFrames, speeds: Speeds, rotary: Rotary | None
) -> MotionPath | list[Fault]:
    """Return the motions of a program, or its faults in order of lines.

    :param lines: words and modal state of all lines.
    :param modes: modal state and events of the blocks that are not plain.
    :param rotary: rotary axes of the cell; None: it has none.
    :returns: the motions; a list of faults if there are any.
    """
    approached_moves = add_approaches(moves_of(lines, modes, cell_frames), cell_frames)
    moves = approached_moves.moves
    circular = np.flatnonzero(moves.code >= 2.0)  # G2, G3
    arcs = _arcs(lines, moves, circular)
    faults = faults_of(lines, moves, modes, moves.row[circular], arcs.faults)
    if not faults and rotary is not None:
        switched_on = np.array([row for row, on in modes.tip_control_changes if on], dtype=np.int64)
        faults = kind_faults(rotary, lines.rotary, switched_on) or turning_faults(
            lines,
            moves,
            approached_moves.is_held_back,
            cell_frames.rotary,
            " or ".join(rotary.tcp_on or tip_codes(rotary)),
        )
    if faults:
        return faults
    motion_moves = _motion_moves(approached_moves, circular, arcs, cell_frames.rotary, speeds.chord)
    moves, row = motion_moves.moves, motion_moves.moves.row[motion_moves.index]
    swivel = None if rotary is None else swivel_of(motion_moves, lines, cell_frames)
    held_rows = moves.row[motion_moves.is_held_back]
    return MotionPath(
        motions=_motions(motion_moves, lines, modes, swivel, cell_frames, speeds),
        swivel=swivel,
        row=row,
        unforced=np.flatnonzero((row <= moves.last_start_row) & (moves.code[motion_moves.index] == 1.0)),
        still_rows=distinct(np.concatenate([held_rows, moves.row[motion_moves.is_null_move]])),
        held_back_rows=distinct(held_rows),
        events=[(int(np.searchsorted(motion_moves.index, move)), row, event) for move, row, event in moves.events],
        remarks=moves.remarks,
    )


def _motion_moves(
    approached_moves: ApproachedMoves, circular: Ints, arcs: Arcs, rotary_axes: RotaryAxes, chord_tolerance: float
) -> _MotionMoves:
    """Return which moves are motions: moves that are not held back and have an effect.

    A move of zero length has an effect if it rotates the tool, is an arc, goes to home, arrives from an unknown
    position, or changes the tool.

    :param circular: (A,) indices of the moves that are arcs; `arcs`: their geometry.
    :param chord_tolerance: deviation of chords from arcs along which rotary axes turn [mm].
    """
    moves, count = chords(approached_moves.moves, circular, arcs, chord_tolerance)
    is_held_back = np.repeat(approached_moves.is_held_back, count)
    is_arrival = np.repeat(approached_moves.is_arrival, count)
    length = np.repeat(_lengths(approached_moves.moves, circular, arcs), count)
    is_tool_change = np.diff(moves.tool, prepend=moves.tool[:1]) != 0
    rotates = rotation_bound(moves, rotary_axes.directions) > _LEAST_ROTATION
    is_short = length <= POINT_TOLERANCE_MM
    is_kept = rotates | (moves.code >= 2.0) | moves.is_home_move | is_tool_change | is_arrival | is_held_back
    is_null_move = is_short & ~is_kept
    index = np.flatnonzero(~is_null_move & ~is_held_back)
    is_free = is_arrival[index] | moves.is_home_move[index]
    return _MotionMoves(
        moves=moves,
        index=index,
        length=length[index],
        is_free=is_free,
        is_rotation=(rotates & is_short & (moves.code == 1.0))[index] & ~is_free,
        circular=np.flatnonzero(moves.code >= 2.0),
        arcs=arcs.masked_arcs(count[circular] == 1),  # the others are chords
        is_held_back=is_held_back,
        is_null_move=is_null_move,
    )


def _arcs(lines: LineStates, moves: Moves, circular: Ints) -> Arcs:
    """Return the arcs of moves, with their faults.

    :param circular: (A,) indices of the moves that are arcs.
    """
    row = moves.row[circular]
    return read_arcs(
        ArcWords(
            start=moves.begin(circular),
            end=moves.end[circular],
            is_programmed=~np.isnan(lines.xyz[row]),
            offset=lines.ijk[row],
            radius=lines.radius[row],
            turns=lines.turns[row],
            is_clockwise=moves.code[circular] == 2.0,
            plane=lines.plane[row],
            units=lines.units[row],
            has_absolute_centre=lines.has_absolute_centre[row],
        )
    )


def _motions(
    motion_moves: _MotionMoves,
    lines: LineStates,
    modes: Modes,
    swivel: Swivel | None,
    cell_frames: CellFrames,
    speeds: Speeds,
) -> Motions:
    """Return the motions (M,) of a program in `$BASE`; their lines are rows + 1.

    :param swivel: rotation of the tool; None: there are no rotary axes.
    """
    moves, index = motion_moves.moves, motion_moves.index
    row, code, is_home = moves.row[index], moves.code[index], moves.is_home_move[index]
    kind = np.where(motion_moves.is_free, PTP, np.where(code < 2.0, LIN, CIRC))
    frame = take_rows(moves.frame, index)
    joints = np.broadcast_to(np.nan, (len(index), 6))  # takes no memory
    if is_home.any() and cell_frames.home_poses is not None:
        joints = joints.copy()
        joints[is_home] = speeds.home_joints
    arcs = _arcs_in_base(motion_moves, kind, frame)
    feed = _speeds_of(
        lines,
        row,
        is_rapid=code == 0.0,
        is_rotation=motion_moves.is_rotation,
        length=motion_moves.length,
        speeds=speeds,
    )
    feed[kind == PTP] = np.nan
    blend, rounding = _corner_distances(modes, row, moves.is_in_hole[index], speeds)
    unset = constant(-1, len(index))  # the program states neither status nor turn of the joints
    motions = Motions(
        kind=kind,
        rapid=code == 0.0,
        line=row + 1,
        target=_targets(moves, index, frame, swivel, cell_frames),
        joints=Runs.of(joints),
        centre=arcs.centre,
        normal=arcs.normal,
        sweep=arcs.sweep,
        feed=feed,
        base=constant(0, len(index)),
        tool=take_rows(moves.tool, index),
        blend=blend,
        rounding=rounding,
        status=unset,
        turn=unset,
    )
    return read_only(motions)


def _targets(moves: Moves, motion_moves: Ints, frame: Ints, swivel: Swivel | None, cell_frames: CellFrames) -> Poses:
    """Return the poses (M,) [m] of the tool frame in `$BASE` at the ends of motions.

    :param motion_moves: (M,) indices of the moves that are motions; `frame`: (M,) their rows of `moves.frames`.
    :param swivel: rotation of the tool; None: there are no rotary axes.
    """
    position = _points_in_base(moves.frames, frame, moves.end[motion_moves])
    rotation = _rotations(moves.frames, frame, swivel, cell_frames.orientation)
    is_home = moves.is_home_move[motion_moves]
    if is_home.any() and cell_frames.home_poses is not None:
        poses = cell_frames.home_poses[moves.tool[motion_moves[is_home]]]
        rotation = rotation.copy()
        rotation[is_home], position[is_home] = poses[:, :3, :3], poses[:, :3, 3]
    return Poses(position, rotation)


def _corner_distances(modes: Modes, row: Ints, is_in_hole: Bools, speeds: Speeds) -> tuple[Array, Array]:
    """Return approximation distance (M,) [m] and permitted rounding of corners (M,) [m] at the ends of motions.

    :param row: (M,) row of the line of each motion.
    :param is_in_hole: (M,) motions of cycles that begin or end in a hole: exact stops, since the tool reverses there.
    """
    approximation = take_rows(active_values(modes.blends, speeds.approximation, modes.row_count), row)
    if is_in_hole.any():
        approximation = np.where(is_in_hole, 0.0, approximation)
    if not modes.roundings:
        return approximation, constant(speeds.rounding, len(row))
    limit = active_values(modes.roundings, np.nan, modes.row_count)[row]  # NaN: the value of the cell holds
    return approximation, np.where(np.isnan(limit), speeds.rounding, limit)


def _rotations(frames: Array, frame: Ints, swivel: Swivel | None, orientation: Array) -> Array:
    """Return the orientation (M, 3, 3) of the tool frame in `$BASE` at the ends of motions.

    :param frame: (M,) row of `frames` (nf, 4, 4).
    :param swivel: rotation of the tool by rotary axes; None: it keeps its orientation in the program frame.
    :param orientation: (3, 3) of the tool frame in the program frame, without rotary axes.
    """
    if swivel is not None:
        return swivel.orientation(swivel.end, swivel.frame)
    if len(frames) > 1:
        return np.asarray((frames[:, :3, :3] @ orientation)[frame])
    return np.broadcast_to(frames[0, :3, :3] @ orientation, (len(frame), 3, 3))


def _arcs_in_base(motion_moves: _MotionMoves, kind: Ints, frame: Ints) -> ArcColumns:
    """Return centre, axis and sweep (M,) of motions in `$BASE`; NaN for motions that are no arcs.

    :param kind: (M,) kind of each motion; `frame`: (M,) its row of the program frames.
    """
    empty = np.broadcast_to(np.nan, (len(kind), 3))  # takes no memory
    arc_motions = np.flatnonzero(kind == CIRC)
    if not len(arc_motions):
        return ArcColumns(empty, empty, empty[:, 0])
    arcs, frames = motion_moves.arcs, motion_moves.moves.frames
    arc_rows = np.searchsorted(motion_moves.circular, motion_moves.index[arc_motions])  # `circular` is ascending
    columns = ArcColumns(empty.copy(), empty.copy(), empty[:, 0].copy())
    columns.centre[arc_motions] = _points_in_base(frames, frame[arc_motions], arcs.centre[arc_rows])
    columns.normal[arc_motions] = np.einsum("nij,nj->ni", frames[frame[arc_motions], :3, :3], arcs.normal[arc_rows])
    columns.sweep[arc_motions] = arcs.sweep[arc_rows]
    return columns


def _speeds_of(
    lines: LineStates, row: Ints, *, is_rapid: Bools, is_rotation: Bools, length: Array, speeds: Speeds
) -> Array:
    """Return the speeds of the tool tip in motions (M,) [m/s]: the rapid speed of the cell, or the feed of the program.

    In G93, F is the reciprocal of the time of the motion in minutes. Motions that only rotate the tool have no path:
    their duration follows from the angular speed (`_rotation_rates`), not from the speed returned here.

    :param row: (M,) row of the line of each motion; `length`: (M,) its length [mm].
    :param is_rapid: (M,) motions of G0; `is_rotation`: (M,) motions that only rotate the tool.
    """
    mm_per_min = lines.feed[row]  # in G93 [1/min]
    is_inverse_time = lines.is_inverse_time[row] & ~is_rapid
    mm_per_min[is_inverse_time] *= length[is_inverse_time]  # now [mm/min] everywhere
    # without a length the product is 0: any speed will do that does not limit the motion
    mm_per_min[is_inverse_time & is_rotation] = speeds.rapid * S_PER_MIN / M_PER_MM
    return np.where(is_rapid, speeds.rapid, mm_per_min * (M_PER_MM / S_PER_MIN))


def _lengths(moves: Moves, circular: Ints, arcs: Arcs) -> Array:
    """Return the lengths of moves (N,) [mm]; an arc counts as a helix with the radius of its start.

    :param circular: (A,) indices of the moves that are arcs; `arcs`: their geometry.
    """
    lengths = norm(moves.end - moves.begin(np.arange(len(moves.row))))
    if len(circular):
        begin = moves.begin(circular)
        axial_length = np.einsum("ni,ni->n", moves.end[circular] - begin, arcs.normal)
        lengths[circular] = np.hypot(norm(begin - arcs.centre) * arcs.sweep, axial_length)
    return lengths


def _points_in_base(frames: Array, frame: Ints, points_mm: Array) -> Array:
    """Return points of program frames in `$BASE` (n, 3) [m].

    :param frames: (nf, 4, 4) program frames in `$BASE` [m]; `frame`: (n,) row of the frame of each point.
    :param points_mm: (n, 3) points in these frames [mm].
    """
    rotation, origin = frames[:, :3, :3] * M_PER_MM, frames[:, :3, 3]
    if len(frames) == 1:  # saves a matrix for each point
        return np.asarray(np.einsum("nj,ij->ni", points_mm, rotation[0]) + origin[0])
    return np.asarray(np.einsum("nij,nj->ni", rotation[frame], points_mm) + origin[frame])
