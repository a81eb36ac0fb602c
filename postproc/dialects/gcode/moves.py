"""From lines to moves: start and end of each move in its program frame, from the words and modal state of its line.

Lines between two changes of mode are processed together. Rapid moves are held back until X, Y and Z have all been
programmed, and again after G28 for the axes that it sends home. With the place of `[machine] home` all are known: the
robot goes there first. If the program begins with moves at feed instead
(Fusion: "Using high feed G1 F5000. instead of G0."), all moves begin at `[start]` of the cell, and no force may act
until X, Y and Z have been programmed. A cycle with X and Y may be the first that gives them (pcb2gcode).

After G80 a Fanuc control takes coordinates without a motion code as a rapid, LinuxCNC refuses them. They are read as
a rapid if they retract along the tool, or stay at or above a height to which the program has moved in rapid before.

Indexed rotary axes turn the program frame with the part. Where the machine turns them, its tool stays; relative to the
part it moves on an arc about the axis, and so does the robot, in steps of `INDEX_STEP`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.chunks import chunks, compact
from postproc.dialects.gcode import codes
from postproc.dialects.gcode.arcs import PLANE_AXES
from postproc.dialects.gcode.cycles import DWELLING, Cycle, CycleEvent, CycleMoves
from postproc.dialects.gcode.line_states import LineStates, active_values, carry_forward, take_rows
from postproc.dialects.gcode.modes import Modes, Origin, Return, dwell_time
from postproc.dialects.gcode.rotary import RotaryAxes
from postproc.dialects.gcode.words import BlockError, Fault, Remark
from postproc.frames import M_PER_MM, Array, any_column, inverse, pose_from_xyzabc
from postproc.program import COMPONENTS, Bools, EventKind, Ints, constant

_LENGTH_TOLERANCE_MM = 1e-6
"""Shorter lengths [mm] are rounding: far below the last digit of any program."""
INDEX_STEP = 5.0
"""Largest turn [deg] of indexed axes in one step: a chord is then 0.1 % of the radius inside the arc."""
LEAST_TOOL_Z = 0.2
"""Least Z component in `$BASE` of the tool direction for a retract along the tool."""


class CellFrames(Struct, frozen=True, eq=False):
    """Frames of the cell that a program refers to.

    :param start: (4, 4) pose of the tool frame in `$BASE` when the program starts [m].
    :param orientation: (3, 3) of the tool frame in the program frame.
    :param work_offsets: code of a work offset (54.0 …) → (4, 4) pose of the program frame in `$BASE` [m].
    :param tools: tool number → row of `$TOOL`.
    :param home_poses: (nt, 4, 4) tool frames in `$BASE` at [machine] home, by row of `$TOOL` [m]; None: the cell
        does not give them.
    :param home_place: (3,) position of the machine before the first move and after G28, G30 and G53, in `$BASE` [mm];
        None: the cell gives joint angles of home, or no home.
    :param clearance: Z of `$BASE` to which G28, G30 and G53 retract [mm]; None: the cell does not give it.
    :param rotary: rotary axes of the machine.
    """

    start: Array
    orientation: Array
    work_offsets: Mapping[float, Array]
    tools: Mapping[float, int]
    home_poses: Array | None
    home_place: Array | None
    clearance: float | None
    rotary: RotaryAxes


class Moves(Struct, frozen=True, eq=False):
    """N moves in execution order; positions in the program frame [mm].

    :param row: (N,) row of the line, never decreasing.
    :param code: (N,) 0 to 3.
    :param end: (N, 3) end of each move; a move begins at the end of the move before, except for `first_moves`.
    :param first_moves: (S,) first move of each run of lines, ascending; its start may differ from the end before.
    :param first_starts: (S, 3) starts of the moves `first_moves`.
    :param frame: (N,) row of `frames`; `tool`: (N,) row of `$TOOL`.
    :param rotary_angles: (N, 2, k) angles of the rotary axes at begin and end [deg].
    :param is_in_hole: (N,) moves of cycles that end in the hole or leave it, see `Step`.
    :param is_home_move: (N,) True for moves to [machine] home.
    :param frames: (nf, 4, 4) program frames in `$BASE` [m]; `machine_frames`: with indexed axes at zero.
    :param events: events of cycles: number of moves before the event, row of its line, event.
    :param unknown_ranges: first and last row of each range of lines in which the position of some axis is unknown.
    :param last_start_row: last row of the lines whose moves at feed come from `[start]`; −1 if there are none.
    :param offset: (L,) active work offset of each line.
    :param faults: faults of the lines; `remarks`: remarks on them for the user.
    """

    row: Ints
    code: NDArray[np.int8]
    end: Array
    first_moves: Ints
    first_starts: Array
    frame: Ints
    tool: Ints
    rotary_angles: Array
    is_in_hole: Bools
    is_home_move: Bools
    frames: Array
    machine_frames: Array
    events: Sequence[tuple[int, int, CycleEvent]]
    unknown_ranges: Sequence[tuple[int, int]]
    last_start_row: int
    offset: Array
    faults: Sequence[Fault]
    remarks: Sequence[Remark]

    def begin(self, move: Ints) -> Array:
        """Return the starts (n, 3) of moves (n,): the end of the move before, or the start of one of `first_moves`."""
        starts = self.end[move - 1]
        index = np.searchsorted(self.first_moves, move)
        # −1, which is no move, follows the last of `first_moves`
        has_own_start = np.append(self.first_moves, -1)[index] == move
        starts[has_own_start] = self.first_starts[index[has_own_start]]
        return starts

    def repeat(self, count: Ints) -> Moves:
        """Return the moves, each repeated `count` (N,) times.

        All repeats have the end of their move. The first repeat begins at the start of the move, so the others have no
        length.
        """
        index = np.repeat(np.arange(len(count)), count)
        offsets = np.append(0, np.cumsum(count))  # number of repeats before each move; the last entry is the total
        names = ("row", "code", "end", "frame", "tool", "rotary_angles", "is_in_hole", "is_home_move")
        columns = {name: take_rows(getattr(self, name), index) for name in names}
        events = [(int(offsets[move]), row, event) for move, row, event in self.events]
        return replace(self, **columns, first_moves=offsets[self.first_moves], events=events)


def moves_of(lines: LineStates, modes: Modes, cell_frames: CellFrames) -> Moves:
    """Return the moves of a program; positions of moves on lines of `Moves.unknown_ranges` are meaningless.

    :param modes: modal state and events of the blocks that are not plain.
    """
    return _MoveBuilder(lines, modes, cell_frames).moves()


def below_top(lines: LineStates, first: int, complete_row: int) -> Bools:
    """Return which lines (L,) are below the highest Z of the program while its position is not known yet.

    Programs for hobby controls go up by G1 first, and then to the start position: these moves are at the highest Z. A
    highest Z that is the only Z, or not above zero, may be that of a cut: then all these lines count as below it. So
    they do in a program with G91, and if no line before the last has a Z.

    :param first: first row of these lines; other lines are False.
    :param complete_row: row of the last line, on which X, Y and Z have all been programmed.
    """
    is_below = np.zeros(len(lines.motion), dtype=np.bool_)
    window = slice(first, complete_row + 1)
    z = lines.xyz[window, 2]
    has_z = ~np.isnan(z)
    latest_z_row = np.maximum.accumulate(np.where(has_z, np.arange(len(z)), -1))  # -1: no Z so far
    lowest_z, highest_z = np.nanmin(lines.xyz[:, 2], initial=np.inf), np.nanmax(lines.xyz[:, 2], initial=-np.inf)
    is_safe_height = (lowest_z < highest_z) & (highest_z > 0.0)  # else it may be the height of a cut
    is_top = (latest_z_row >= 0) & (z[latest_z_row] >= highest_z) & is_safe_height
    has_earlier_z = has_z[: complete_row - first].any()  # else nothing has gone up before the last row
    is_below[window] = ~is_top | lines.is_incremental.any() | ~has_earlier_z  # words of G91 are no heights
    return is_below


def _repetition(values: Sequence[int], count: Ints) -> Ints:
    """Return integers, the k-th of `values` repeated `count[k]` times; in constant memory if all are equal.

    :param values: (n,) integers, n ≥ 1; `count`: (n,) number of repeats of each.
    """
    return constant(values[0], int(count.sum())) if len(set(values)) == 1 else np.repeat(values, count)


class _MoveBuilder:
    """Walk over the lines of a program: state of the machine, and the moves so far.

    :ivar position: (3,) position of the tool tip in the program frame [mm].
    :ivar is_known: (3,) whether the position along X, Y, Z is known: programmed, or that of home.
    :ivar is_displaced: (3,) axes along which the machine is at another place than the robot since G28, G30 or G53.
    :ivar is_lifted: whether the robot has retracted by a code that does not move Z of the machine.
    :ivar offset_frames: code of a work offset → (4, 4) frame in `$BASE` [m]; G10 changes it.
    :ivar shift: (3,) shift of coordinates by G52 and G92 [mm]; `kept_shift`: the shift that G92.3 restores.
    :ivar angles: (k,) angles of the rotary axes [deg].
    :ivar move_count: number of moves so far.
    :ivar column_parts: column of `Moves` → its parts, one for each run of lines that were added together.
    :ivar first_moves: index of the first move of each run.
    :ivar starts: start of each run: position, row of `frames`, row of `$TOOL`.
    :ivar losses: (row, axes (3,)): from the row on the position along these axes is unknown.
    :ivar parkings: (row, axes (3,)) of G28, G30 and G53: along these axes the machine has moved and the robot has not.
    """

    def __init__(self, lines: LineStates, modes: Modes, cell_frames: CellFrames) -> None:
        self.lines, self.modes, self.cell_frames = lines, modes, cell_frames
        self.line_count = len(lines.motion)
        self.offset = active_values(modes.changes["offset"], codes.WORK_OFFSETS[0], self.line_count)
        self.offset_frames = dict(cell_frames.work_offsets)
        self.shift, self.kept_shift = np.zeros(3), np.zeros(3)
        self.frames, self.machine_frames = [np.eye(4)], [np.eye(4)]
        self.position = cell_frames.start[:3, 3] / M_PER_MM
        self.is_known = np.zeros(3, dtype=bool)
        if cell_frames.home_place is not None:
            self.position, self.is_known = cell_frames.home_place, np.ones(3, dtype=bool)
        self.is_displaced = np.zeros(3, dtype=bool)
        self.is_lifted = False
        self.angles = cell_frames.rotary.upright
        self.tool = 0
        self.cycle = Cycle()
        spindle_events = [
            event for event in modes.row_events if event.kind in ("spindle_on", "spindle_ccw", "spindle_off")
        ]
        self.spindle_rows = [event.row for event in spindle_events]
        self.spindle_kinds: list[EventKind] = ["spindle_off", *(event.kind for event in spindle_events)]
        self.column_parts: dict[str, list[NDArray[Any]]] = {
            name: [] for name in ("row", "code", "end", "rotary_angles")
        }
        self.first_moves: list[int] = []
        self.starts: list[tuple[Array, int, int]] = []
        self.bottom_moves: list[int] = []
        self.home_moves: list[int] = []
        self.move_count = 0
        self.events: list[tuple[int, int, CycleEvent]] = []
        self.losses: list[tuple[int, Bools]] = [(0, ~self.is_known)]
        self.parkings: list[tuple[int, Bools]] = []
        self.faults: list[Fault] = []
        self.remarks: list[Remark] = []

    def moves(self) -> Moves:
        """Return the moves of the program, which is processed in runs of lines between changes of mode."""
        origins: dict[int, list[Origin]] = {}
        for origin in self.modes.origins:
            origins.setdefault(origin.row, []).append(origin)
        tools = dict(self.modes.tools)
        indexing = set(self._indexing_rows().tolist())
        current = -1.0  # no code of a work offset: the first line sets the frame
        for begin, end in pairwise(self._run_bounds(origins, tools, indexing)):
            if self.offset[begin] != current:
                current = float(self.offset[begin])
                self._change_frame(current)
            if begin == 0 and self.cell_frames.home_place is not None:
                self._add_rapid(0, self.position)
            for origin in origins.get(begin, ()):
                self._set_origin(origin, current)
            if begin in tools:
                self._change_tool(begin, tools[begin])
            if begin in self.modes.returns:
                self._add_return(begin, self.modes.returns[begin])
            elif self.lines.is_drilling[begin]:
                self._add_drilling(begin, end)
            elif begin in indexing:
                self._add_indexed_move(begin)
            else:
                self._add_straight_moves(begin, end)
        self._check_return()
        return self._joined_moves()

    def _indexing_rows(self) -> Ints:
        """Return the rows (n,) with words of indexed axes."""
        if not self.cell_frames.rotary.turns_part:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(any_column(~np.isnan(self.lines.rotary)))

    def _run_bounds(
        self, origins: Mapping[int, object], tools: Mapping[int, object], indexing: Collection[int]
    ) -> list[int]:
        """Return the rows, ascending, at which a run begins, and the number of lines.

        Within a run, work offset, G90 or G91, and cycle or no cycle do not change. Lines of `origins`, `tools`, returns
        and `indexing` begin a run. The line after a return or a turn of indexed axes begins one too.
        """
        lines = self.lines
        is_bound = (self.offset[1:] != self.offset[:-1]) | (lines.is_incremental[1:] != lines.is_incremental[:-1])
        is_bound |= lines.is_drilling[1:] != lines.is_drilling[:-1]
        single_rows = [row for row in (*origins, *tools, *self.modes.returns, *indexing) if row < self.line_count]
        next_rows = [row + 1 for row in (*self.modes.returns, *indexing) if row + 1 < self.line_count]
        return sorted({0, self.line_count, *(np.flatnonzero(is_bound) + 1).tolist(), *single_rows, *next_rows})

    def _add_straight_moves(self, begin: int, end: int) -> None:
        """Add the moves of lines `begin` to `end` (exclusive) of G0 to G3, all in G90 or all in G91.

        If rotary axes turn without tool-centre-point control, the position is lost until it is programmed again.
        """
        lines = self.lines
        if (lines.has_motion_code[begin:end]).any() or (lines.motion[begin:end] == codes.CANCEL_CYCLE).any():
            self.cycle.end()
        last_turn_row = max(
            self._add_lines(begin + chunk.start, min(begin + chunk.stop, end)) for chunk in chunks(end - begin)
        )
        has_turn = last_turn_row >= 0  # without tool-centre-point control
        is_upright = bool((self.angles == self.cell_frames.rotary.upright).all())
        # the tip may be anywhere; with tilted axes `turning_faults` refuses the next move
        if has_turn and is_upright:
            row = last_turn_row + 1
            self.losses.append((row, np.ones(3, dtype=bool)))
            self.is_known = np.asarray(~np.isnan(lines.xyz[row:end]).all(axis=0))

    def _add_lines(self, begin: int, end: int) -> int:
        """Add the moves of lines `begin` to `end` (exclusive), all in G90 or all in G91.

        :returns: the last row on which rotary axes turn without tool-centre-point control; −1: none.
        """
        lines = self.lines
        positions = np.empty((end - begin, 3))
        for axis in range(3):
            words = lines.xyz[begin:end, axis]
            if lines.is_incremental[begin]:
                steps = np.append(self.position[axis], np.where(np.isnan(words), 0.0, words))
                positions[:, axis] = np.cumsum(steps)[1:]
            else:
                positions[:, axis] = carry_forward(words, self.position[axis])
                self.is_known[axis] |= not np.isnan(words).all()
        self._check_height(begin, end)
        angles = self._rotary_angles(begin, end)
        moving = np.flatnonzero(lines.is_moving[begin:end])
        self._add_moves(begin + moving, lines.motion[begin + moving], positions[moving], angles[moving])
        self.position = positions[-1].copy()
        is_turn = ~lines.is_tip_controlled[begin:end] & (angles[:, 0] != angles[:, 1]).any(axis=1)
        turns = np.flatnonzero(is_turn)
        return begin + int(turns[-1]) if len(turns) else -1

    def _add_indexed_move(self, row: int) -> None:
        """Add the moves of a line with words of indexed axes; a fault if it turns them and is not a rapid.

        The move is split into steps of `INDEX_STEP`: seen from the part, the tool moves on an arc about the axes. If no
        axis turns, the line is added as others are. While the position is not known, the part turns without moves.
        """
        start_angles, words = self.angles, self.lines.rotary[row]
        turn = (
            np.nan_to_num(words)
            if self.lines.is_incremental[row]
            else np.where(np.isnan(words), 0.0, words - start_angles)
        )
        if not turn.any():
            self._add_straight_moves(row, row + 1)
            return
        if self.lines.motion[row] != 0.0:
            advice = "Turn indexed axes by G0, or set the CAM system to output tool-centre-point control."
            self.faults.append(Fault(row, "an indexed axis turns in a line that is not a rapid", advice))
            return
        if not self.is_known.all():  # the move from [start] is made when X, Y and Z are known
            self._turn_part(row, start_angles + turn)
            if self.lines.has_xyz_word[row]:
                self._add_straight_moves(row, row + 1)
            return
        self.cycle.end()
        self._check_height(row, row + 1)
        displacement = self.lines.xyz[row]
        if not self.lines.is_incremental[row]:
            displacement = displacement - self.position
        displacement = np.nan_to_num(displacement)  # an axis without a word stays
        start, step_count = self.position, int(np.ceil(np.abs(turn).max() / INDEX_STEP))
        for number in range(1, step_count + 1):
            share = number / step_count
            angles = np.stack([self.angles, start_angles + share * turn])[None]
            self._turn_part(row, angles[0, 1])
            self._add_moves(np.array([row]), np.zeros(1), (start + share * displacement)[None], angles)
            self.position = start + share * displacement

    def _turn_part(self, row: int, angles: Array) -> None:
        """Turn indexed axes to angles (k,) [deg]: the program frame turns, the robot stays."""
        self.angles = angles
        self._change_frame(float(self.offset[row]))

    def _rotary_angles(self, begin: int, end: int) -> Array:
        """Return the angles of the rotary axes (n, 2, k) [deg] before and after each line; set `angles` to the last.

        :param begin: first row of the lines, all in G90 or all in G91; `end`: row after the last.
        """
        words = self.lines.rotary[begin:end]
        end_angles = np.empty((end - begin, len(self.angles)))
        for axis, angle in enumerate(self.angles.tolist()):
            # three "angles" are the components of the direction of the tool (G43.5), which are never incremental
            if self.lines.is_incremental[begin] and len(self.angles) != COMPONENTS:
                end_angles[:, axis] = np.cumsum(np.append(angle, np.nan_to_num(words[:, axis])))[1:]
            else:
                end_angles[:, axis] = carry_forward(words[:, axis], angle)
        start_angles = np.concatenate([self.angles[None], end_angles[:-1]])
        self.angles = end_angles[-1].copy()
        return np.stack([start_angles, end_angles], axis=1)

    def _add_drilling(self, begin: int, end: int) -> None:
        """Add the moves of lines `begin` to `end` (exclusive), all with cycles.

        The first hole of a series may differ from the others, because the tool comes from another height. After a line
        that has repeated the hole before, lines with positions only are therefore added together.
        """
        self._check_drilling(begin, end)
        self._check_height(begin, end)
        spindle = self._spindle_states(begin, end)
        is_position_only = self._is_next_hole(begin, end, spindle)
        other_rows = np.append(np.flatnonzero(~is_position_only), end - begin) + begin
        row, has_steps = begin, False
        while row < end:
            cycle_moves = self._add_hole(row, spindle[row - begin])
            repeats_hole = has_steps and bool(is_position_only[row - begin])
            row, has_steps = row + 1, bool(cycle_moves.steps)
            if repeats_hole and has_steps:
                stop = int(other_rows[np.searchsorted(other_rows, row)])  # the next line that states more, or `end`
                self._add_next_holes(row, stop, cycle_moves)
                row = stop

    def _is_next_hole(self, begin: int, end: int, spindle: Sequence[EventKind]) -> Bools:
        """Return which lines (n,) state only the position of the next hole: words, modes and spindle are as before.

        :param begin: first row of the lines, all with cycles; `end`: row after the last.
        :param spindle: state of the spindle on each line.
        """
        lines = self.lines
        is_position_only = np.append(False, np.array(spindle[1:]) == spindle[:-1])  # the first line states the cycle
        for state in (lines.motion, lines.plane, lines.retracts_to_r):
            is_position_only[1:] &= state[begin + 1 : end] == state[begin : end - 1]
        normal_axis = PLANE_AXES[float(lines.plane[begin])][2]
        for words in (lines.xyz[:, normal_axis], lines.radius, lines.turns, lines.pecks, lines.repeats):
            is_position_only &= np.isnan(words[begin:end])
        return is_position_only

    def _add_hole(self, row: int, spindle: EventKind) -> CycleMoves:
        """Add the moves of one line with a cycle, and return them; add the fault of a faulty line, and return none."""
        lines = self.lines
        axes = list(PLANE_AXES[float(lines.plane[row])])
        is_incremental = bool(lines.is_incremental[row])
        u, v, height = self.position[axes].tolist()  # in the plane (17: X, Y) and across it
        try:
            cycle_moves = self.cycle.hole_moves(
                code=float(lines.motion[row]),
                line_words=self._cycle_words(row, axes),
                position=(u, v, height),
                spindle=spindle,
                relative=is_incremental,
                retracts_to_r=bool(lines.retracts_to_r[row]),
            )
        except BlockError as cause:
            self.faults.append(cause.fault(row))
            return CycleMoves([], [])
        if self.cycle.lifts_to_r and not self.is_known[axes[:2]].all():
            advice = "Program X and Y by G0 before, or Z above R: the tool goes up to R where it is."
            self.faults.append(Fault(row, "a cycle that begins below R before the position is known", advice))
        if not is_incremental:
            self.is_known[axes[:2]] |= ~np.isnan(lines.xyz[row][axes[:2]])
        steps = cycle_moves.steps
        ends = np.empty((len(steps), 3))
        ends[:, axes] = np.reshape([step.end for step in steps], (-1, 3))
        self._add_holes(np.full(len(steps), row), ends, cycle_moves)
        return cycle_moves

    def _cycle_words(self, row: int, axes: list[int]) -> dict[str, float]:
        """Return the words of a line with a cycle as `Cycle.hole_moves` takes them.

        If the unit of the dwell P is unclear, a fault is added, and P is 0.

        :param row: row of the line.
        :param axes: indices of the axes in the plane and across it, whose words become U, V and Z.
        """
        lines = self.lines
        columns = dict(zip("UVZ", lines.xyz[row][axes].tolist(), strict=True))
        # `turns` has P: the turns of an arc, but the dwell of a cycle
        columns |= {"R": lines.radius[row], "P": lines.turns[row], "Q": lines.pecks[row], "L": lines.repeats[row]}
        words = {letter: float(value) for letter, value in columns.items() if not np.isnan(value)}
        if "P" in words and lines.motion[row] in DWELLING:
            name, has_point = f"G{lines.motion[row]} P", row in self.modes.rows_with_point
            try:
                words["P"] = dwell_time(name, words["P"], self.modes.dwell_unit, has_point=has_point)
            except BlockError as cause:  # the time does not matter to the holes that follow
                self.faults.append(cause.fault(row))
                words["P"] = 0.0
        return words

    def _add_next_holes(self, row: int, stop: int, cycle_moves: CycleMoves) -> None:
        """Add the moves of lines `row` to `stop` (exclusive), which state only the positions of holes.

        :param cycle_moves: moves and events of the hole before, which each line repeats at its position.
        """
        steps = cycle_moves.steps
        axes = PLANE_AXES[float(self.lines.plane[row - 1])]
        ends = np.empty((stop - row, len(steps), 3))
        ends[:, :, axes[2]] = [step.end[2] for step in steps]
        for axis in axes[:2]:
            words = self.lines.xyz[row:stop, axis]
            if self.lines.is_incremental[row - 1]:
                coordinates = self.position[axis] + np.cumsum(np.nan_to_num(words))
            else:
                coordinates = carry_forward(words, self.position[axis])
            ends[:, :, axis] = coordinates[:, None]
            if self.cycle.lifts_to_r:
                # the tool goes up to R above the hole before
                ends[:, 0, axis] = np.append(self.position[axis], coordinates[:-1])
        self._add_holes(np.repeat(np.arange(row, stop), len(steps)), ends.reshape(-1, 3), cycle_moves)

    def _add_holes(self, row: Ints, ends: Array, cycle_moves: CycleMoves) -> None:
        """Add the moves of holes that all have the same steps and events.

        :param row: (n,) row of the line of each move; `ends`: (n, 3) its end in the program frame [mm].
        :param cycle_moves: moves and events of one of these holes.
        """
        if not len(row):
            return
        steps, cycle_events = cycle_moves
        # index of the first move of each hole
        first = np.arange(self.move_count, self.move_count + len(row), len(steps))
        if cycle_events:
            holes = zip(first.tolist(), row[:: len(steps)].tolist(), strict=True)
            self.events += [
                (begin + event.step_count, hole_row, event) for begin, hole_row in holes for event in cycle_events
            ]
        steps_in_hole = [n for n, step in enumerate(steps) if step.is_in_hole]
        self.bottom_moves += (first[:, None] + np.array(steps_in_hole, dtype=np.int64)).ravel().tolist()
        self._add_moves(row, np.tile([step.code for step in steps], len(first)), ends)
        self.position = ends[-1].copy()

    def _check_drilling(self, begin: int, end: int) -> None:
        """Add a fault if a rotary axis turns in lines with cycles, or the tool does not point along the hole.

        `angles` is set to those after the last line.

        :param begin: first row of the lines; `end`: row after the last.
        """
        angles = self._rotary_angles(begin, end)
        is_turn = (angles[:, 0] != angles[:, 1]).any(axis=1)
        if is_turn.any():
            row = begin + int(np.argmax(is_turn))
            advice = "Program the rotary axes in a block before the cycle."
            self.faults.append(Fault(row, "rotary axes turn in a cycle", advice))
        alignment = abs(self._tool_direction()[PLANE_AXES[float(self.lines.plane[begin])][2]])
        if self.angles.any() and alignment < 1.0 - 1e-9:  # 1e-9: rounding
            advice = "Set the CAM system to output holes in tilted planes as G0 and G1."
            self.faults.append(Fault(begin, "a cycle with a tilted tool", advice))

    def _tool_direction(self) -> Array:
        """Return the unit direction from the tip to the spindle in the program frame (3,)."""
        return np.asarray(self.cell_frames.rotary.tool_direction(self.angles[None])[0])

    def _spindle_states(self, begin: int, end: int) -> list[EventKind]:
        """Return the state of the spindle on lines `begin` to `end` (exclusive): the last event up to each line."""
        # number of events up to each line, events of the line included; `spindle_kinds[0]` is the state before all
        event_counts = np.searchsorted(self.spindle_rows, np.arange(begin, end), side="right").tolist()
        return [self.spindle_kinds[count] for count in event_counts]

    def _add_return(self, row: int, command: Return) -> None:
        """Add the moves of G28, G30 or G53: through the intermediate point, up to the clearance height, and home.

        If the cell gives a position of home, the named axes go there. If it gives joint angles of home, the robot
        retracts to the clearance height and goes to these joints, except on G53 with Z alone. Without home, the robot
        retracts and stays above its position. A code without letters names all axes.

        :param row: row of the line; `command`: its code and words.
        """
        cell_frames = self.cell_frames
        self.cycle.end()
        axis_mask = np.zeros(3, dtype=bool)
        axis_mask[list(command.axes) or [0, 1, 2]] = True  # the named axes
        if command.code != codes.MACHINE and self.is_known.all():
            self._add_intermediate_move(row, command)
        if cell_frames.home_place is not None:
            self._add_home_move(row, command, axis_mask, cell_frames.home_place)
            return
        is_retract = not axis_mask[:2].any()  # Z alone
        if cell_frames.clearance is not None and self.is_known.all():
            previous_number = self.move_count
            self._add_retract(row, cell_frames.clearance)
            self.is_lifted = not axis_mask[2] and (self.is_lifted or self.move_count > previous_number)
            self.is_displaced[2] |= self.is_lifted
        if cell_frames.home_poses is None or (
            command.code == codes.MACHINE and is_retract and cell_frames.clearance is not None
        ):
            if not self.is_known.all():
                message = "A retract before X, Y and Z are known is left out: the robot is at [start]."
                self.remarks.append(Remark(row, "info", "start-position", message))
            self.is_displaced |= axis_mask
            if cell_frames.home_poses is None and not is_retract:
                message = "The tool retracts to clearance_Z and stays above its place: [machine] home is not given."
                self.remarks.append(Remark(row, "info", "parked", message))
                self.parkings.append((row, axis_mask & [True, True, False]))
            return
        if cell_frames.clearance is None:
            message = "From home the robot goes to the next position by a joint motion, without an approach from above."
            self.remarks.append(Remark(row, "warning", "approach", f"{message} Give [machine] clearance_Z."))
        self.home_moves.append(self.move_count)
        self._turn_part(row, np.where(np.isnan(self.lines.rotary[row]), self.angles, 0.0))
        self._add_rapid(row, self.position)
        self.is_known &= ~axis_mask
        self.losses.append((row + 1, axis_mask))

    def _add_intermediate_move(self, row: int, command: Return) -> None:
        """Add the move to the intermediate point that the words of G28 or G30 give, unless the tool is there already.

        Letters without a number (NaN) leave the coordinate as it is.
        """
        point = self.position.copy()
        for axis, word in command.axes.items():
            if not np.isnan(word):
                point[axis] = word + (point[axis] if self.lines.is_incremental[row] else 0.0)
        if np.abs(point - self.position).max() > _LENGTH_TOLERANCE_MM:
            self._add_rapid(row, point)

    def _add_home_move(self, row: int, command: Return, axis_mask: Bools, home: Array) -> None:
        """Add a rapid that moves the named axes to home, as the machine does.

        Words of G53 other than 0 are machine positions that the cell does not give: the robot goes home, and the axes
        count as displaced.

        :param row: row of the line; `command`: its code and words; `axis_mask`: (3,) the named axes.
        :param home: (3,) position of the machine at home in `$BASE` [mm].
        """
        if self.angles.any() and not self.cell_frames.rotary.turns_part:
            advice = "Turn the rotary axes to zero before, or give A1 to A6 as [machine] home."
            self.faults.append(Fault(row, f"G{command.code:g} with tilted axes, and home is a place", advice))
            return
        frame = self.machine_frames[-1]
        base_position = frame[:3, :3] @ self.position + frame[:3, 3] / M_PER_MM  # in `$BASE` [mm]
        base_position[axis_mask] = home[axis_mask]
        self._add_rapid(row, frame[:3, :3].T @ (base_position - frame[:3, 3] / M_PER_MM))
        is_elsewhere = np.zeros(3, dtype=bool)  # axes that the machine moves to another position than home
        if command.code == codes.MACHINE:
            is_elsewhere[[axis for axis, word in command.axes.items() if word != 0.0]] = True
        self.is_displaced = (self.is_displaced & ~axis_mask) | is_elsewhere
        self.is_lifted = bool(self.is_displaced[2])
        if is_elsewhere[:2].any():
            self.parkings.append((row, is_elsewhere & [True, True, False]))

    def _add_retract(self, row: int, clearance: float) -> None:
        """Add a rapid of the line `row` to the height `clearance` in `$BASE` [mm], along the tool if it is tilted.

        No move is added if the tool is at this height or above; a fault if the tool is nearly horizontal.
        """
        frame, direction = self.machine_frames[-1], self._tool_direction()
        z = float(frame[2, :3] @ self.position + frame[2, 3] / M_PER_MM)
        if z >= clearance - _LENGTH_TOLERANCE_MM:
            return
        if (direction[:2] == 0.0).all():
            direction = frame[2, :3]
        rise = float(frame[2, :3] @ direction)
        if rise < LEAST_TOOL_Z:
            advice = "Retract along the tool with G0 before: a vertical move would drag it through the part."
            self.faults.append(Fault(row, "retract with a nearly horizontal tool", advice))
            return
        self._add_rapid(row, self.position + direction * ((clearance - z) / rise))

    def _check_height(self, begin: int, end: int) -> None:
        """Add a fault for the first line on which machine and robot would move to different heights after a retract.

        In G90 that is a move at feed before the first Z, in G91 a Z or a cycle. A coordinate that G90 states is the
        same for machine and robot again: `is_displaced` (axes along which both are at different places) and `is_lifted`
        (their heights differ after a retract) are updated.

        :param begin: first row of the lines, all in G90 or all in G91; `end`: row after the last.
        """
        lines, rows = self.lines, slice(begin, end)
        has_word, z = ~np.isnan(lines.xyz[rows]), lines.xyz[rows, 2]
        if lines.is_incremental[begin]:
            is_wrong = self.is_displaced[2] & ((has_word[:, 2] & (z != 0.0)) | lines.is_drilling[rows])
        else:
            has_z_before = np.logical_or.accumulate(has_word[:, 2])
            is_at_feed = lines.is_moving[rows] & (lines.motion[rows] > 0.0)
            is_wrong = self.is_lifted & is_at_feed & ~has_z_before
            self.is_displaced &= ~has_word.any(axis=0)
            self.is_lifted &= bool(self.is_displaced[2])
        if is_wrong.any():
            problem = "Z must be programmed again after G28, G30 or G53, before this move"
            advice = "Program Z in G90: the robot is at clearance_Z of the cell, the machine at another height."
            self.faults.append(Fault(begin + int(np.argmax(is_wrong)), problem, advice))
            self.is_displaced[2] = self.is_lifted = False  # one fault is enough

    def _check_return(self) -> None:
        """Add faults of moves before X and Y are programmed again after G28, G30 or G53 moved them on the machine.

        The robot has stayed above its position (`parkings`: row and axes), so machine and robot differ. Only rapids in
        G90 without Z may precede, which program X and Y at the height of the retract.
        """
        has_word = ~np.isnan(self.lines.xyz)
        is_rapid_in_plane = (self.lines.motion == 0.0) & ~self.lines.is_incremental & ~has_word[:, 2]
        for row, axes in self.parkings:
            open_axes = axes.copy()
            for next_row in (row + 1 + np.flatnonzero(self.lines.has_xyz_word[row + 1 :])).tolist():
                if not is_rapid_in_plane[next_row]:
                    names = " and ".join("XYZ"[axis] for axis in np.flatnonzero(open_axes).tolist())
                    problem = f"{names} must be programmed again after G28, G30 or G53, before this move"
                    advice = "Program X and Y by G0 in G90, without Z, or give [machine] home in the cell."
                    self.faults.append(Fault(next_row, problem, advice))
                    break
                open_axes &= ~has_word[next_row]
                if not open_axes.any():
                    break

    def _change_tool(self, row: int, number: float) -> None:
        """Change the tool, and add a rapid that brings its tip to the position of the tip before.

        No move is added if both tools have one `$TOOL`, or if the position is not known.

        :param row: row of the line with M6; `number`: tool number.
        """
        tool_row = self.cell_frames.tools[number]
        if tool_row != self.tool:
            self.tool = tool_row
            if self.is_known.all():
                self._add_rapid(row, self.position)

    def _add_rapid(self, row: int, end: Array) -> None:
        """Add a rapid move of a line to a position (3,) in the program frame [mm]."""
        self._add_moves(np.array([row]), np.zeros(1), end[None])  # code 0: rapid
        self.position = end

    def _add_moves(self, row: Ints, code: Array | NDArray[np.int8], end: Array, angles: Array | None = None) -> None:
        """Add a run of moves (n,), which begins at the current position; the position itself is not changed.

        :param row: (n,) row of the line of each move; `code`: (n,) 0 to 3.
        :param end: (n, 3) ends in the program frame [mm].
        :param angles: (n, 2, k) angles of the rotary axes before and after each move [deg]; None: they keep
            their present angles.
        """
        if angles is None:
            angles = np.broadcast_to(self.angles, (len(row), 2, len(self.angles)))
        # in the order of `column_parts`
        columns: tuple[NDArray[Any], ...] = compact(row, np.int32), code.astype(np.int8), end, angles
        for parts, column in zip(self.column_parts.values(), columns, strict=True):
            parts.append(column)
        self.first_moves.append(self.move_count)
        self.starts.append((self.position, len(self.frames) - 1, self.tool))
        self.move_count += len(row)

    def _change_frame(self, offset: float) -> None:
        """Change to the program frame of a work offset, with shifts and rotary axes, and express the position in it.

        :param offset: code of the work offset (54.0 …).
        """
        machine = self.offset_frames[offset].copy()
        machine[:3, 3] += machine[:3, :3] @ self.shift * M_PER_MM
        frame = self.cell_frames.rotary.part_from_machine(self.angles) @ machine
        last_frame = self.frames[-1]
        if not np.array_equal(frame, last_frame):
            frame_change = inverse(frame) @ last_frame
            self.position = frame_change[:3, :3] @ self.position + frame_change[:3, 3] / M_PER_MM
            self.frames.append(frame)
            self.machine_frames.append(machine)

    def _set_origin(self, origin: Origin, current: float) -> None:
        """Apply G10, G52, G92 or G92.1 to G92.3, and express the position in the new frame.

        - G10 (`STORE`) sets a work offset, and leaves the shift. Faults: see `_set_work_offset`.
        - G52 (`LOCAL`): the words are the shift.
        - G92 (`SHIFT`): the position gets the words as coordinates. If the position is not known, that is a fault.
        - G92.1 (`SHIFT_CLEARED`): no shift.
        - G92.2 (`SHIFT_OFF`): no shift, until G92.3 (`SHIFT_ON`) restores it; G10 in between leaves what it restores.

        :param current: code of the active work offset.
        """
        shift = self.shift.copy()
        if origin.code == codes.STORE:
            self._set_work_offset(origin, current)
        elif origin.code == codes.SHIFT_ON:
            shift = self.kept_shift.copy()
        elif origin.code in (codes.SHIFT_CLEARED, codes.SHIFT_OFF):
            shift[:] = 0.0
        elif origin.code == codes.LOCAL:
            for axis, word in origin.axes.items():
                shift[axis] = word
        else:  # G92
            for axis, word in origin.axes.items():
                self._check_position(origin, "G92", [axis])
                shift[axis] = shift[axis] + self.position[axis] - word
        self.shift = shift
        if origin.code not in (codes.STORE, codes.SHIFT_OFF):
            self.kept_shift = shift.copy()
        self._change_frame(current)

    def _check_position(self, origin: Origin, name: str, axes: Sequence[int]) -> None:
        """Add a fault if a code assigns coordinates to a position that is not known, or not that of the machine.

        :param name: the code, for messages; `axes`: indices of the axes that get coordinates.
        """
        advice = (
            "Remove it if X, Y, Z of the program are those of $BASE, or give the origin in the cell, "
            "[work_offsets.G55]. Else program X, Y and Z by G0 in G90 before."
        )
        if not self.is_known[axes].all():
            self.faults.append(Fault(origin.row, f"{name} before the position is known", advice))
        elif self.is_displaced[axes].any():
            names = " and ".join("XYZ"[axis] for axis in axes if self.is_displaced[axis])
            problem = f"{name} {names} after G28, G30 or G53: the machine is at another place than the robot"
            self.faults.append(Fault(origin.row, problem, advice))

    def _set_work_offset(self, origin: Origin, current: float) -> None:
        """Set a work offset (G10).

        L2: words are the origin in `$BASE`, R its rotation about Z; axes without a word stay. L20: the origin moves,
        and the current position gets the words as coordinates. R with indexed axes is a fault.

        :param current: code of the active work offset, which P0 means.
        """
        system = codes.WORK_OFFSETS[origin.system - 1] if origin.system else current
        new_frame = self.offset_frames[system].copy()  # in `$BASE` [m]
        if origin.rotation_deg is not None and self.cell_frames.rotary.turns_part:
            self.faults.append(
                Fault(origin.row, "G10 R with indexed axes", "X, Y, Z are machine axes there: remove R.")
            )
        elif origin.rotation_deg is not None:
            new_frame[:3, :3] = pose_from_xyzabc([0.0, 0.0, 0.0, origin.rotation_deg, 0.0, 0.0])[:3, :3]
        if origin.is_here:
            self._check_position(origin, "G10 L20", list(origin.axes))
            frame = self.frames[-1]
            base_point = frame[:3, :3] @ self.position * M_PER_MM + frame[:3, 3]  # current position in `$BASE`
            # by how much the origin moves along its axes [mm]: present coordinates less those of the words
            offset = new_frame[:3, :3].T @ (base_point - new_frame[:3, 3]) / M_PER_MM - self.shift
            for axis, word in origin.axes.items():
                offset[axis] -= word
            offset[[axis for axis in range(3) if axis not in origin.axes]] = 0.0
            new_frame[:3, 3] += new_frame[:3, :3] @ offset * M_PER_MM
        else:
            for axis, word in origin.axes.items():
                new_frame[axis, 3] = word * M_PER_MM
        self.offset_frames[system] = new_frame

    def _joined_moves(self) -> Moves:
        """Return the moves of all lines, joined from the runs of lines that were added together.

        It is called once: it empties `column_parts`, and adds a run of no moves if there is no run.
        """
        is_in_hole, is_home_move = np.zeros(self.move_count, dtype=bool), np.zeros(self.move_count, dtype=bool)
        is_in_hole[self.bottom_moves] = True
        is_home_move[self.home_moves] = True
        if not self.first_moves:  # a run of no moves, so that the columns have a shape
            self._add_moves(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 3)))
        columns = {name: np.concatenate(self.column_parts.pop(name)) for name in list(self.column_parts)}
        start_positions, frame_rows, tool_rows = zip(*self.starts, strict=True)  # one for each run
        count = np.diff(self.first_moves, append=self.move_count)  # number of moves of each run
        unknown_ranges, last_start_row = self._ranges_without_start(self._unknown_ranges())
        runs_with_moves = np.flatnonzero(count)  # a run without moves starts none
        moves = Moves(
            **columns,
            first_moves=np.array(self.first_moves)[runs_with_moves],
            first_starts=np.stack(start_positions)[runs_with_moves],
            frame=_repetition(frame_rows, count),
            tool=_repetition(tool_rows, count),
            is_in_hole=is_in_hole,
            is_home_move=is_home_move,
            frames=np.stack(self.frames),
            machine_frames=np.stack(self.machine_frames),
            events=self.events,
            unknown_ranges=unknown_ranges,
            last_start_row=last_start_row,
            offset=self.offset,
            faults=self.faults,
            remarks=self.remarks,
        )
        self._resolve_after_g80(moves)
        return moves

    def _resolve_after_g80(self, moves: Moves) -> None:
        """Change moves without a motion code after G80 into rapids, in place; add a fault for the first unsafe one.

        A retract along the tool is safe, and a move that ends no lower than the lowest rapid before it. A move that
        turns rotary axes is not safe, nor is a move from an unknown position.
        """
        g80_moves = np.flatnonzero(moves.code == codes.CANCEL_CYCLE)
        if not len(g80_moves):
            return
        row, turn = moves.row, moves.rotary_angles
        is_safe = self._is_retract_along_tool(moves, g80_moves) | self._is_above_rapids(moves)[g80_moves]
        is_safe &= (turn[g80_moves, 0] == turn[g80_moves, 1]).all(axis=1)
        for first, last in moves.unknown_ranges:
            is_safe &= (row[g80_moves] < first) | (row[g80_moves] > last)
        moves.code[g80_moves] = 0  # unsafe moves too: later steps would take their code 80 for an arc
        message = "Coordinates without G0 after G80 are read as a rapid, as on Fanuc controls."
        self.remarks += [
            Remark(int(line_row), "info", "motion-after-g80", message) for line_row in row[g80_moves[is_safe]]
        ]
        advice = "Write the motion code. A rapid is assumed only at heights to which the program has moved in rapid."
        for line_row in row[g80_moves[~is_safe]][:1].tolist():
            self.faults.append(Fault(line_row, "coordinates without G0, G1, G2 or G3", advice))

    def _is_retract_along_tool(self, moves: Moves, indices: Ints) -> Bools:
        """Return which moves (n,) go away from the part along the tool axis.

        :param indices: (n,) indices of these moves.
        """
        tool_direction = self.cell_frames.rotary.tool_direction(moves.rotary_angles[indices, 1])
        displacement = moves.end[indices] - moves.begin(indices)
        axial_step = np.einsum("ni,ni->n", displacement, tool_direction)
        lateral_step = np.abs(displacement - axial_step[:, None] * tool_direction).max(axis=1)
        return np.asarray((axial_step > 0.0) & (lateral_step < _LENGTH_TOLERANCE_MM))

    def _is_above_rapids(self, moves: Moves) -> Bools:
        """Return which moves (N,) end no lower than the lowest rapid before them.

        All are False where heights cannot be compared: with a tilted tool, or if program frames differ in orientation.
        """
        rotations = [frame[:3, :3] for frame in self.frames]
        if moves.rotary_angles.any() or not all(np.array_equal(rotations[0], rotation) for rotation in rotations[1:]):
            return np.zeros(len(moves.row), dtype=np.bool_)
        origin_height = np.array([frame[:3, 2] @ frame[:3, 3] for frame in self.frames])  # along their common z [m]
        height = moves.end[:, 2] + origin_height[moves.frame] / M_PER_MM
        is_known_rapid = (moves.code == 0.0) & ~moves.is_in_hole
        for first, last in moves.unknown_ranges:
            is_known_rapid &= (moves.row < first) | (moves.row >= last)  # on row `last` the position is known
        lowest_height = np.minimum.accumulate(np.where(is_known_rapid, height, np.inf))
        return np.asarray(np.isfinite(lowest_height) & (height >= lowest_height - _LENGTH_TOLERANCE_MM))

    def _ranges_without_start(self, unknown_ranges: list[tuple[int, int]]) -> tuple[list[tuple[int, int]], int]:
        """Return the ranges of rows with an unknown position, and the last row whose moves begin at `[start]`.

        A program that begins with moves at feed at a safe height begins at `[start]`, with a remark: in its first range
        no move is held back then. Other programs: the ranges as they are, and −1.

        :param unknown_ranges: ranges (first, last) of rows as `_unknown_ranges` returns them.
        """
        first, last = unknown_ranges[0]
        if not self._begins_at_start(first, last):
            return unknown_ranges, -1
        row_range = slice(first, last + 1)
        is_feed = self.lines.has_xyz_word[row_range] & (self.lines.motion[row_range] == 1.0)
        message = (
            "G1 before X, Y and Z are known: the moves begin at [start] of the cell. Check that the path from there is "
            "free."
        )
        self.remarks.append(Remark(first + int(np.argmax(is_feed)), "warning", "from-start", message))
        return [(first, first), *unknown_ranges[1:]], last

    def _begins_at_start(self, first: int, last: int) -> bool:
        """Return whether a program begins with moves at feed at a safe height, which the robot makes from `[start]`.

        The first of these moves must be at feed, and all of them straight, in G90 and in one work offset. At least one
        is below the highest Z; if none is, the moves are allowed in any case. A cut at or below Z 0 must follow X and
        Y.

        :param first: first row; `last`: row on which X, Y and Z are all known, or the number of lines.
        """
        lines = self.lines
        row_range = slice(first, min(last + 1, self.line_count))
        has_xyz_word = lines.has_xyz_word[row_range]
        is_feed = has_xyz_word & (lines.motion[row_range] == 1.0)
        has_word = ~np.isnan(lines.xyz[row_range])
        is_xy_known = np.logical_or.accumulate(has_word[:, :2], axis=0).all(axis=1)
        is_low = is_feed & (np.where(has_word[:, 2], lines.xyz[row_range, 2], np.inf) <= 0.0)
        if not is_feed.any() or last >= self.line_count:
            return False
        offsets = self.offset[row_range][has_xyz_word]
        is_other_motion = lines.is_drilling[row_range] | (lines.is_moving[row_range] & (lines.motion[row_range] >= 2.0))
        return bool(
            lines.motion[first + int(np.argmax(has_xyz_word))] == 1.0  # the first of the moves
            and not (is_low & ~is_xy_known).any()  # else the place of a plunge is not known
            and not np.isnan(lines.xyz).all(axis=0).any()  # X, Y and Z are programmed somewhere
            and not (has_xyz_word & lines.is_incremental[row_range]).any()
            and not is_other_motion.any()
            and (offsets == offsets[0]).all()
            and (below_top(lines, first, last)[row_range] & is_feed).any()
        )

    def _unknown_ranges(self) -> list[tuple[int, int]]:
        """Return ranges (first, last) of rows with an unknown position, one for each loss of the position (`losses`).

        A range lasts until all its unknown axes are programmed: `last` is the row that makes the position known. Else
        it lasts to the row of the next loss, and the axes stay unknown, or to the number of lines. If no axis is
        unknown, the range is empty: `last` is the row before `first`.
        """
        has_word = ~np.isnan(self.lines.xyz)
        for plane, axes in PLANE_AXES.items():  # the word across the plane is the bottom of the hole
            has_word[:, axes[2]] &= ~(self.lines.is_drilling & (self.lines.plane == plane))
        ranges: list[tuple[int, int]] = []
        unknown_axes = np.zeros(3, dtype=bool)
        ends = [row for row, _ in self.losses[1:]] + [self.line_count]
        for (first, lost_axes), end in zip(self.losses, ends, strict=True):
            unknown_axes = unknown_axes | lost_axes
            if not unknown_axes.any():  # the program begins at a known home
                ranges.append((first, first - 1))
                continue
            range_words = has_word[first:end]
            # row of the next word of each axis; `line_count`: there is none before the next loss
            next_word_row = np.where(
                range_words.any(axis=0),
                first + range_words.argmax(axis=0) if len(range_words) else end,
                self.line_count,
            )
            last = int(next_word_row[unknown_axes].max(initial=first))
            ranges.append((first, min(last, end)))
            unknown_axes = unknown_axes & (next_word_row >= end)
        return ranges
