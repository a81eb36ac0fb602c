"""Plain lines and statements put together: `Motions`, and the `Layout` of their text."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.chunks import Runs, compact
from postproc.dialects.krl.language.motion_statements import MotionStatement, Trigger, triggers
from postproc.dialects.krl.language.tokens import words_in
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.layout import CONSTANT, FREE, IGNORE, JOINT, ORIENTATIONS, Elements, Layout, Offsets
from postproc.dialects.krl.read.auxiliary_points import (
    AuxiliaryOrientations,
    Circles,
    auxiliary_orientations,
    first_other_rotation,
    other_rotation_error,
)
from postproc.dialects.krl.read.end_poses import (
    EndPoses,
    OrientationControl,
    TextTargets,
    circle_geometry,
    end_poses,
    same_orientation,
)
from postproc.dialects.krl.read.external_axes import external_axes
from postproc.dialects.krl.read.main_routine import TraceFollower
from postproc.dialects.krl.read.motion_columns import MotionColumns, merged_motions
from postproc.dialects.krl.read.plain_rounds import ElementMotions
from postproc.dialects.krl.read.plain_settings import NUMBERS
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.spline_blocks import approximated_motions, check_words, is_spline, unknown_path_warning
from postproc.dialects.krl.read.state import DEFAULT_SPEED, MotionStates, State, fields_used
from postproc.errors import Issue, ProgramError, combined_error
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array, angle_between, any_column, norm
from postproc.program import CIRC, LIN, PTP, Bools, Carriage, FrameColumns, Ints, Motions, Starts, constant, distinct

_ONE_ROTATION_MODES = (FREE, CONSTANT)
"""Values of `$ORI_TYPE` under which the orientation changes by one rotation, or not at all."""
_TURN_TOLERANCE = 0.5 * RAD_PER_DEG
"""Turns below this [rad] are the same by the wrist axes and by one rotation, within 0.001° away from singular poses:
their difference is about the square of half the turn."""
_ARC_TOLERANCE = 1e-6
"""The arc of a circle with CA ends at its end point if its angle differs by less than this [rad]."""
_TRAVEL_TOLERANCE = 1e-7
"""An external axis that moves by less than this [m] does not move: the tenth of a micrometre of the text."""
_UNKNOWN_TURN_MESSAGES = {
    JOINT: "the orientation changes under $ORI_TYPE=#JOINT on another path than a line, or while E1 moves: how the "
    "wrist axes lead it is not known",
    IGNORE: "the orientation changes at a target under $ORI_TYPE=#IGNORE: the controller chooses it there",
}
"""Changes of orientation that are refused, by `$ORI_TYPE`."""
_SPEED_WORDS = frozenset({"C_VEL", "C_ORI"})


class OrderedMotions(NamedTuple):
    """All R motions in execution order: the contents of their lines, and the settings in force.

    A motion is given by its index, from 0, also called its row.

    :ivar columns: the motions as they are in the text.
    :ivar motion_states: settings in force at each motion; for the fields `plain_settings.NUMBERS` see `numbers`.
    :ivar numbers: (R, 4) speed, distance of approximation, two turn speeds (`plain_settings.NUMBERS`), as runs. Plain
        settings change these, and create no states.
    :ivar moves: row → statement, for motions that are not plain.
    """

    columns: MotionColumns
    motion_states: MotionStates
    numbers: Runs
    moves: dict[int, MotionStatement]


class _MergedSettings(NamedTuple):
    """The order of all R motions, and the settings in force.

    Plain motions are read in bulk; all others are statements.

    :ivar places: (R,) indices in execution order, from 0, of the plain motions, then of the statements.
    :ivar motion_states: settings in force at each motion, in execution order.
    :ivar numbers: (R, 4) see `OrderedMotions.numbers`.
    """

    places: Ints
    motion_states: MotionStates
    numbers: Runs


def ordered_motions(follower: TraceFollower, plain_parts: list[MotionColumns]) -> OrderedMotions:
    """Return all motions of a program in order: plain lines and statements together.

    :param follower: has followed all lines that are not plain.
    :param plain_parts: plain motions, in parts; the list is emptied, so that their memory is released.
    """
    plain_parts += [rounds.columns for rounds in follower.rounds]
    statement_rows = follower.motions.columns()
    places, motion_states, numbers = _merged_settings(
        follower, [columns.trace_row for columns in plain_parts], statement_rows.trace_row
    )
    first = sum(map(len, plain_parts))  # index in `places` of the first statement
    moves = {places.item(first + index): move for index, move in follower.motions.special_moves}
    plain_parts.append(statement_rows)
    return OrderedMotions(merged_motions(plain_parts, places), motion_states, numbers, moves)


def _merged_settings(follower: TraceFollower, plain_rows: list[Ints], statement_rows: Ints) -> _MergedSettings:
    """Return the order of plain motions and statements, and the settings in force at each motion.

    :param follower: has followed all lines that are not plain.
    :param plain_rows: rows of the trace with the plain motions, in parts.
    :param statement_rows: (S,) rows of the trace with the motions that were read as statements.
    """
    plain_row = np.concatenate(plain_rows)
    plain_states = _states_of_lines(follower.run.settings, plain_row)  # statements have their states with them
    states, statement_index = _with_statement_states(plain_states.motion_states.states, follower.motions.states)
    plain_places, statement_places = _merged_places(plain_row, statement_rows)
    places = compact(np.concatenate([plain_places, statement_places]), np.int32)
    index: NDArray[Any] = np.empty(len(places), dtype=np.int32)
    index[places] = np.concatenate([plain_states.motion_states.index, statement_index])
    numbers = np.array([[getattr(state, field) for field in NUMBERS] for state in states])[index]
    # plain settings are not part of the states: they replace the numbers of the plain motions
    for column in range(len(NUMBERS)):
        state_values = numbers[plain_places, column]
        numbers[plain_places, column] = follower.run.settings.plain_assignments.values_at(
            column, plain_row, plain_states.change_lines, state_values
        )
    return _MergedSettings(places, MotionStates(states, index), Runs.of(numbers))


def _merged_places(plain_rows: Ints, statement_rows: Ints) -> tuple[Ints, Ints]:
    """Return the places in execution order, from 0, of P plain motions (P,) and of S statements (S,) among them.

    :param plain_rows: (P,) rows of the trace with the plain motions, in any order.
    :param statement_rows: (S,) rows of the trace with the statements, ascending.
    """
    order = compact(np.argsort(plain_rows, kind="stable"), np.int32)
    # before a statement are the plain motions with smaller rows, and the statements before it
    plain_count = np.searchsorted(plain_rows, statement_rows, sorter=order)
    statement_places = plain_count + np.arange(len(statement_rows))
    plain_places = np.empty_like(plain_rows)
    plain_places[order] = np.delete(np.arange(len(plain_rows) + len(statement_rows)), statement_places)
    return plain_places, statement_places


class MotionsAndLayout(NamedTuple):
    """The motions of a program, the places of their numbers in the text, and issues about assumptions."""

    motions: Motions
    layout: Layout
    issues: list[Issue]


def stated_turn_speeds(numbers: Runs) -> Runs | None:
    """Return `Program.turn_speeds`; None if no motion has a turn speed.

    :param numbers: see `OrderedMotions.numbers`.
    """
    speeds = numbers.values[:, 2:]  # behind speed and distance
    if not np.isfinite(speeds).any():
        return None
    return Runs(np.column_stack([np.full(len(speeds), np.inf), speeds]), numbers.run)


def motions_and_layout(
    follower: TraceFollower,
    sequence: OrderedMotions,
    start_joints: Array,
    kinematics: Callable[[Array], Array],
    predecessors: Ints | None = None,
) -> MotionsAndLayout:
    """Return the motions of a program in order, and the layout of their text.

    :param follower: has followed all lines that are not plain.
    :param sequence: all motions; the missing numbers of their targets are filled in in place.
    :param start_joints: (6,) joint angles at the start [rad].
    :param kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
    :param predecessors: (M,) the motion at whose end each begins, see `Program.after`; None: the motion before it.
    :raises ProgramError: a frame, a component or an axis is not known; external axes move; an orientation or a circle
        is not what the controller could follow.
    """
    trace, settings = follower.execution.trace, follower.run.settings
    sequence = _with_approximation(follower, sequence)
    columns, motion_states, _, moves = sequence
    _check_settings(settings, sequence)
    targets, axis_issues = _text_targets(follower, sequence, predecessors)
    text_ends = columns.numbers[columns.kind == CIRC, :3]  # a copy: `end_poses` completes the numbers in place
    ends = end_poses(targets, start_joints, kinematics, predecessors)
    is_wrist_led = _wrist_led_rows(trace, columns, motion_states, ends, targets.carriage)
    _check_automatic_wrist_mode(trace, columns, motion_states, ends, settings)
    path = _Path(targets, ends, _circle_columns(sequence, targets, ends, text_ends, settings))
    motions = _motions(trace, sequence, path)
    layout = _layout(follower, sequence, motions, path, is_wrist_led)
    has_assumed_speed = motion_states.column(lambda state: state.is_speed_assumed) & (columns.kind != PTP)
    issues = [
        *axis_issues,
        *_assumption_issues(motions.line, targets.is_missing, has_assumed_speed, moves),
        *_speed_blending_issues(trace, columns),
        *unknown_path_warning(motions),
        *_wrist_led_issues(motions, is_wrist_led),
    ]
    return MotionsAndLayout(motions, layout, issues)


def _with_approximation(follower: TraceFollower, sequence: OrderedMotions) -> OrderedMotions:
    """Return the motions with `approximated` as it holds in spline blocks.

    Inside a block only the last motion can be approximated, by ENDSPLINE C_SPL.

    :raises ProgramError: a motion is not allowed inside, or outside, of a spline block.
    """
    columns, block = sequence.columns, sequence.motion_states.column(lambda state: state.spline_block)
    check_words(follower.execution.trace, columns, block)
    is_approximated = approximated_motions(columns, block != "", follower.splines.approximated_ends)
    return sequence._replace(columns=replace(columns, approximated=is_approximated))


def _text_targets(
    follower: TraceFollower, sequence: OrderedMotions, predecessors: Ints | None
) -> tuple[TextTargets, list[Issue]]:
    """Return the targets as the text gives them, and issues about external axes.

    :param predecessors: (M,) the motion at whose end each begins, see `Program.after`; None: the motion before it.
    :raises ProgramError: an external axis moves, or a circle turns the tool in a way that is not known.
    """
    trace, settings = follower.execution.trace, follower.run.settings
    columns, motion_states, _, moves = sequence
    relative_rows = np.array([row for row, move in moves.items() if move.relative_axes], dtype=np.int64)
    uses_root = np.ones(len(columns), dtype=np.bool_)  # the path depends on the robot root, except to axis targets
    uses_root[[row for row, move in moves.items() if move.end.position.is_axis]] = False
    issues, carriage = external_axes(
        trace, columns, relative_rows, uses_root, direction=settings.cell.carriage, predecessors=predecessors
    )
    control = _orientation_control(trace, columns, motion_states)
    is_missing = np.isnan(columns.numbers)
    # axis and relative targets have no numbers yet: `end_poses` computes them
    is_missing[~uses_root] = False
    is_missing[relative_rows] = False
    targets = TextTargets(
        trace=trace,
        trace_row=columns.trace_row,
        numbers=columns.numbers,
        frames=_frame_columns(settings, motion_states),
        statements=moves,
        control=control,
        carriage=carriage,
        is_missing=is_missing,
    )
    return targets, issues


def _frame_columns(settings: Settings, motion_states: MotionStates) -> FrameColumns:
    """Return `$BASE` and `$TOOL` of the motions.

    Only motions to axis targets may have an unknown frame (−1); they get frame 0, which they do not use.
    """
    base, tool = (
        np.where(column < 0, 0, column) if (column < 0).any() else column
        for column in (motion_states.column(lambda state: state.base), motion_states.column(lambda state: state.tool))
    )
    return FrameColumns(base, tool, np.stack(settings.frames.bases), np.stack(settings.frames.tools))


class _Path(NamedTuple):
    """The path of M motions.

    :ivar targets: the targets as the text gives them.
    :ivar ends: the complete targets.
    :ivar circles: the circles among the motions.
    """

    targets: TextTargets
    ends: EndPoses
    circles: _CircleColumns


def _motions(trace: Trace, sequence: OrderedMotions, path: _Path) -> Motions:
    """Return the `Motions` of a program from its ordered motions and their path."""
    (columns, _, numbers, _), frames, ends, circles = sequence, path.targets.frames, path.ends, path.circles
    return Motions(
        kind=columns.kind,
        rapid=columns.kind == PTP,
        line=trace.reported_lines[columns.trace_row - 1],
        target=ends.pose,
        joints=ends.joints,
        centre=circles.centre,
        normal=circles.normal,
        sweep=circles.sweep,
        feed=np.where(columns.kind == PTP, np.nan, numbers[:, 0]),  # column 0: speed, 1: distance of approximation
        base=frames.base,
        tool=frames.tool,
        blend=np.where(columns.approximated, numbers[:, 1], 0.0),
        rounding=constant(np.inf, len(columns)),  # no limit but `blend`
        status=columns.posture[:, 0],
        turn=columns.posture[:, 1],
    )


def _layout(
    follower: TraceFollower, sequence: OrderedMotions, motions: Motions, path: _Path, is_wrist_led: Bools
) -> Layout:
    """Return the places of the numbers of the motions in the text; `notes` are added by the reader.

    :param sequence: all motions; `motions` and `path` are what has been computed from them.
    :param is_wrist_led: (M,) True for motions on which the wrist axes turn the tool.
    """
    columns, motion_states, _, moves = sequence
    targets, ends, circles = path
    run = follower.run
    elements = tuple(_elements_of_program(columns, rounds) for rounds in follower.rounds)
    return Layout(
        execution=follower.execution,
        trace_row=columns.trace_row,
        notes=(),
        numbers=ends.numbers,
        is_missing=targets.is_missing,
        target_start=_target_starts(columns.target[:, 0], elements),
        relative_spans=columns.relative_spans,
        keyword=columns.keyword,
        target=columns.target,
        tail=columns.tail,
        via_spans=columns.via_spans,
        via_target=columns.via_target,
        starts_from_joints=ends.starts_from_joints,
        # PTP has no orientation control: index 0
        orientation=np.where(columns.kind == PTP, np.int8(0), motion_states.column(_orientation_index)),
        ignores_orientation=ends.ignores_orientation,
        turns_with_path=targets.control.turns_with_path,
        is_wrist_led=is_wrist_led,
        drops_via_orientation=circles.drops_via_orientation,
        is_distance_known=motion_states.column(lambda s: all(field != "cdis" for field, _ in s.uncertain_fields)),
        is_in_spline_block=motion_states.column(lambda state: state.spline_block) != "",
        statements=moves,
        elements=elements,
        types=dict(run.settings.variables.types),
        global_names=frozenset(run.settings.variables.global_names),
        followed_names=frozenset(run.followed_names),
        copies=frozenset(run.copies),
        triggers=_triggers_of_motions(follower, columns.trace_row, motions, ends.start),
        carriage=targets.carriage,
        resume_place="" if run.resume_place is None else str(run.resume_place),
    )


def _elements_of_program(columns: MotionColumns, rounds: ElementMotions) -> Elements:
    """Return the array elements to which a loop moves, with the rows of these motions in the program.

    :param columns: the motions of the program.
    :param rounds: the motions of the loop; uncorrected ones, which are not in `columns`, are left out.
    """
    motion = np.searchsorted(columns.trace_row, rounds.columns.trace_row)
    # False for an uncorrected motion: another one has its index
    is_present = columns.trace_row[np.minimum(motion, len(columns) - 1)] == rounds.columns.trace_row
    return Elements(motion[is_present], rounds.literal[is_present], rounds.source, rounds.name)


def _target_starts(target: Offsets, elements: tuple[Elements, ...]) -> Offsets:
    """Return the offsets (R,) at which the points of motions begin, in the `.src` or in a data list.

    :param target: (R,) offsets of the targets in the statements of the motions.
    :param elements: the motions whose points are array elements of data lists.
    """
    starts = target.copy() if elements else target
    for loop_elements in elements:
        starts[loop_elements.row] = loop_elements.literal[:, 0]  # start of the span
    return starts


class _LineStates(NamedTuple):
    """Settings in force at n lines.

    :ivar motion_states: states at the lines.
    :ivar change_lines: (n,) line of the trace from which on the state holds.
    """

    motion_states: MotionStates
    change_lines: Ints


def _states_of_lines(settings: Settings, line: Ints) -> _LineStates:
    """Return the states in force before lines of the trace.

    :param line: (n,) the lines.
    """
    change_lines = np.array([line for line, _ in settings.changes])  # ascending, from 0
    index = compact(np.searchsorted(change_lines, line) - 1, np.int32)  # the last change on a line before
    states = [state for _, state in settings.changes]
    return _LineStates(MotionStates(states, index), compact(change_lines, np.int32)[index])


def _with_statement_states(states: list[State], statement_states: list[State]) -> tuple[list[State], Ints]:
    """Return some states and, behind them, the states of k statements; and the index of each statement's state (k,).

    Equal states of statements are added once.

    :param statement_states: state in force at each of the k statements.
    """
    all_states = list(states)
    index_of_state: dict[State, int] = {}
    indices = []
    for state in statement_states:
        if state not in index_of_state:
            index_of_state[state] = len(all_states)
            all_states.append(state)
        indices.append(index_of_state[state])
    return all_states, compact(np.array(indices, dtype=np.int64), np.int32)


class LineSettings(NamedTuple):
    """Settings in force before a line, to be compared.

    :ivar state: the state without turn speeds; known frames have row 0, an unknown frame holds the index of its reason,
        see `State.base`.
    :ivar base: `$BASE` (4, 4) in the robot root [m]; zeros if it is not known.
    :ivar tool: `$TOOL` (4, 4) in the flange frame [m]; zeros if it is not known.
    """

    state: State
    base: Array
    tool: Array


def settings_at(settings: Settings, line: Ints) -> list[LineSettings]:
    """Return the settings in force before n rows of the trace.

    :param line: (n,) the rows.
    """
    motion_states, change_lines = _states_of_lines(settings, line)
    numbers = [
        settings.plain_assignments.values_at(row, line, change_lines, motion_states.column(attrgetter(field)))
        for row, field in enumerate(NUMBERS)
    ]
    entries = []
    for index, *values in zip(motion_states.index.tolist(), *(column.tolist() for column in numbers), strict=True):
        state = motion_states.states[index]
        base = _frame_or_zeros(settings.frames.bases, state.base)
        tool = _frame_or_zeros(settings.frames.tools, state.tool)
        # frames are compared by their numbers: only unknown ones keep their row
        state = replace(
            state,
            base=min(state.base, 0),
            tool=min(state.tool, 0),
            is_speed_assumed=False,
            **dict(zip(NUMBERS, values, strict=True)),
        )
        entries.append(LineSettings(state.without_turn_speeds(), base, tool))
    return entries


def _frame_or_zeros(frames: list[Array], row: int) -> Array:
    """Return a frame (4, 4); zeros for a negative row, which stands for an unknown frame."""
    return frames[row] if row >= 0 else np.zeros((4, 4))


def _orientation_index(state: State) -> object:
    """Return the index of `$ORI_TYPE` of a state in `ORIENTATIONS`."""
    return np.int8(ORIENTATIONS.index(state.orientation))


def _check_settings(settings: Settings, sequence: OrderedMotions) -> None:
    """Refuse motions that depend on unknown frames, speeds or modes.

    :raises ProgramError: there are such motions; all reasons together.
    """
    faults = list(_setting_errors(settings, sequence))
    if faults:
        raise combined_error(faults)


def setting_errors(follower: TraceFollower, plain_parts: list[MotionColumns]) -> Iterator[ProgramError]:
    """Yield the errors of the motions of a program that depend on unknown settings, once for each reason.

    :param follower: has followed all lines that are not plain.
    :param plain_parts: plain motions, in parts; the list is emptied.
    """
    yield from _setting_errors(follower.run.settings, ordered_motions(follower, plain_parts))


def _setting_errors(settings: Settings, sequence: OrderedMotions) -> Iterator[ProgramError]:
    """Yield the errors of motions that depend on unknown settings, once for each reason."""
    reason_keys: set[tuple[str | None, int | None, str]] = set()
    for _, cause in uncertain_motions(settings, sequence):
        if (key := (cause.file, cause.line, cause.problem)) not in reason_keys:
            reason_keys.add(key)
            yield cause


def uncertain_motions(settings: Settings, sequence: OrderedMotions) -> Iterator[tuple[int, ProgramError]]:
    """Yield the motions that depend on unknown frames, speeds or modes: the row of each, and its error.

    They are grouped by their states, not in the order of the program.
    """
    columns, motion_states, _, moves = sequence
    for index, state in enumerate(motion_states.states):
        if not state.uncertain_fields and state.base >= 0 and state.tool >= 0:
            continue
        for row in np.flatnonzero(motion_states.index == index).tolist():
            has_axis_target = row in moves and moves[row].end.position.is_axis  # plain motions have none
            fields = fields_used(
                int(columns.kind[row]), has_axis_target=has_axis_target, is_approximated=bool(columns.approximated[row])
            )
            try:
                settings.refuse_uncertain(state, fields)
            except ProgramError as cause:
                yield row, cause


def _orientation_control(trace: Trace, columns: MotionColumns, motion_states: MotionStates) -> OrientationControl:
    """Return how the orientation of each motion is controlled: KUKA, KSS 8.x, `$ORI_TYPE` and `$CIRC_TYPE`.

    `$ORI_TYPE` #CONSTANT: the orientation of the start stays, and A, B, C of the target are disregarded. `$CIRC_TYPE`
    #PATH: a circle turns the tool with the path; the orientation relative to the path stays, or changes by one
    rotation. `$CIRC_TYPE` has no effect under `$ORI_TYPE` #JOINT.

    :raises ProgramError: a circle is under #PATH and an `$ORI_TYPE` other than `_ONE_ROTATION_MODES`.
    """
    is_circle = columns.kind == CIRC
    is_unsupported = is_circle & motion_states.column(
        lambda state: state.circle == "#PATH" and state.orientation not in _ONE_ROTATION_MODES
    )
    if is_unsupported.any():
        first = int(np.argmax(is_unsupported))
        problem = f"a circle under $ORI_TYPE={motion_states.at(first).orientation} and $CIRC_TYPE=#PATH"
        raise trace.error(problem, int(columns.trace_row[first]), "Use $CIRC_TYPE=#BASE, or $ORI_TYPE=#VAR.")
    is_constant = motion_states.column(lambda state: state.orientation == CONSTANT) & (columns.kind != PTP)
    is_path_mode = motion_states.column(
        lambda state: state.circle == "#PATH" and state.orientation in _ONE_ROTATION_MODES
    )
    return OrientationControl(keeps_orientation=is_constant, turns_with_path=is_circle & is_path_mode, via=columns.via)


def _wrist_led_rows(
    trace: Trace, columns: MotionColumns, motion_states: MotionStates, ends: EndPoses, carriage: Carriage | None
) -> Bools:
    """Return which motions (R,) turn the tool by the wrist axes A4 to A6: LINs under `$ORI_TYPE=#JOINT` that turn it.

    :raises ProgramError: the orientation changes under #JOINT or #IGNORE on another motion, in a way that is not known.
    """
    is_wrist_led = np.zeros(len(columns), dtype=np.bool_)
    candidates = np.flatnonzero(
        motion_states.column(lambda state: state.orientation not in _ONE_ROTATION_MODES) & (columns.kind != PTP)
    )
    if not len(candidates):
        return is_wrist_led
    modes = motion_states.take(candidates).column(lambda state: state.orientation)
    next_rows = np.minimum(candidates + 1, len(columns) - 1)  # the last motion itself, which has no next one
    is_turned, is_next_turned = (
        ~same_orientation(ends.start.at(subset)[:, :3, :3], ends.pose[subset, :3, :3])
        for subset in (candidates, next_rows)
    )
    # under #IGNORE the next motion begins with the orientation that the controller has chosen
    is_turned |= is_next_turned & (modes == IGNORE)
    is_led_by_wrist = (modes == JOINT) & (columns.kind[candidates] == LIN)
    if carriage is not None:
        is_led_by_wrist &= carriage.travel[candidates] <= _TRAVEL_TOLERANCE
    is_wrist_led[candidates[is_turned & is_led_by_wrist]] = True
    is_unknown = is_turned & ~is_led_by_wrist
    if is_unknown.any():
        first = int(np.argmax(is_unknown))
        advice = "Use $ORI_TYPE=#VAR: the orientation then changes by one rotation, from target to target."
        raise trace.error(_UNKNOWN_TURN_MESSAGES[str(modes[first])], int(columns.trace_row[candidates[first]]), advice)
    return is_wrist_led


def _check_automatic_wrist_mode(
    trace: Trace, columns: MotionColumns, motion_states: MotionStates, ends: EndPoses, settings: Settings
) -> None:
    """Refuse spline motions whose orientation the controller may lead by the wrist axes, since that path is not known.

    Under `$SPL_ORI_JOINT_AUTO` #ON the controller decides that itself for each spline motion under `$ORI_TYPE=#VAR`
    (KUKA, KSS 8.x). A setting that is not known counts as #ON.

    :raises ProgramError: the orientation changes on such a motion.
    """
    may_use_wrist = motion_states.column(
        lambda state: state.wrist_mode == "#ON" or any(field == "wrist_mode" for field, _ in state.uncertain_fields)
    )
    if not may_use_wrist.any():
        return
    is_free = motion_states.column(lambda state: state.orientation == FREE) & may_use_wrist & (columns.kind != PTP)
    free_rows = np.flatnonzero(is_free)
    spline_rows = free_rows[is_spline(trace, columns, free_rows)]
    turn = angle_between(ends.start.at(spline_rows)[:, :3, :3], ends.pose[spline_rows, :3, :3])
    for row in spline_rows[turn > _TURN_TOLERANCE].tolist():
        settings.refuse_uncertain(motion_states.at(row), ["wrist_mode"])  # raises if the mode is not known
        problem = "the orientation changes under $SPL_ORI_JOINT_AUTO=#ON: the wrist axes may lead it, not one rotation"
        raise trace.error(problem, int(columns.trace_row[row]), "Use $SPL_ORI_JOINT_AUTO=#OFF.")


class _CircleColumns(NamedTuple):
    """The circles among M motions; NaN, or False, for other motions.

    :ivar centre: (M, 3) [m].
    :ivar normal: (M, 3) unit vectors; the arc turns about it by the right hand, see `Motions`.
    :ivar sweep: (M,) angle of the arc [rad], above 0.
    :ivar drops_via_orientation: (M,) see `Layout`.
    """

    centre: Array
    normal: Array
    sweep: Array
    drops_via_orientation: Bools


def _circle_columns(
    sequence: OrderedMotions, targets: TextTargets, ends: EndPoses, text_ends: Array, settings: Settings
) -> _CircleColumns:
    """Return the circles of a program, with the arcs that the robot drives.

    With CA the arc has this angle; a negative CA reverses its direction. Without CA it ends at the end point.

    :param sequence: all motions.
    :param targets: the targets as the text gives them; `ends` the completed targets.
    :param settings: has the reasons of unknown modes.
    :param text_ends: (n, 3) X, Y, Z of the ends of the n circles as the text gives them [mm].
    :raises ProgramError: a circle is not defined by its points, or it is not known how the tool turns on it.
    """
    trace, (columns, motion_states, _, moves) = targets.trace, sequence
    drops_via_orientation = np.zeros(len(columns), dtype=np.bool_)
    nan_rows = np.broadcast_to(np.nan, (len(columns), 3))  # takes no memory
    circle_rows = np.flatnonzero(columns.kind == CIRC)
    if not len(circle_rows):
        return _CircleColumns(nan_rows, nan_rows, nan_rows[:, 0], drops_via_orientation)
    circles = _circles(trace, columns, circle_rows, ends, text_ends)
    angle = _programmed_angles(moves, circle_rows, len(columns))
    has_angle = ~np.isnan(angle)  # circles with CA
    # the arc does not end at the end point
    has_other_end = has_angle & (np.abs(angle - circles.arcs.angle) >= _ARC_TOLERANCE)
    _check_circular_angles(targets, circle_rows[has_other_end], ends)
    orientations = auxiliary_orientations(trace, columns, moves, circle_rows, motion_states.take(circle_rows))
    _check_turns(circles, orientations, targets, motion_states, settings)
    drops_via_orientation[circle_rows] = orientations.has_effect
    centre, normal, sweep = nan_rows.copy(), nan_rows.copy(), nan_rows[:, 0].copy()
    centre[circle_rows] = circles.arcs.centre
    normal[circle_rows] = np.where(has_angle, np.sign(angle), 1.0)[:, None] * circles.arcs.axis
    sweep[circle_rows] = np.where(has_angle, np.abs(angle), circles.arcs.angle)
    return _CircleColumns(centre, normal, sweep, drops_via_orientation)


def _check_turns(
    circles: Circles,
    orientations: AuxiliaryOrientations,
    targets: TextTargets,
    motion_states: MotionStates,
    settings: Settings,
) -> None:
    """Refuse circles on which the tool does not, or may not, turn by the shorter rotation; the first one is named.

    :param orientations: orientations of the auxiliary points of the circles.
    :param motion_states: settings in force at all motions.
    :raises ProgramError: there is such a circle. If its `$CIRC_MODE.AUX_PT.ORI` is not known, the error says why.
    """
    index = first_other_rotation(circles, orientations, targets.control.turns_with_path[circles.rows])
    if index is not None:
        row = circles.rows.item(index)
        settings.refuse_uncertain(motion_states.at(row), ["auxiliary"])  # raises if the mode is not known
        is_led_through = bool(orientations.is_led_through[index])
        raise other_rotation_error(targets.trace, targets.trace_row.item(row), is_led_through=is_led_through)


def _circles(trace: Trace, columns: MotionColumns, circle_rows: Ints, ends: EndPoses, text_ends: Array) -> Circles:
    """Return the circles through the points of the text; components that a point lacks are those of the start.

    :param circle_rows: (n,) rows of the circles.
    :param text_ends: (n, 3) X, Y, Z of the ends of the circles as the text gives them [mm].
    :raises ProgramError: the points of a circle do not define a circle.
    """
    start = ends.start.at(circle_rows)
    via, end = columns.via[circle_rows] * M_PER_MM, text_ends * M_PER_MM
    for row, points in ends.circles.items():  # relative circles
        index = np.searchsorted(circle_rows, row)
        via[index], end[index] = points * M_PER_MM
    via, end = (np.where(np.isnan(points), start[:, :3, 3], points) for points in (via, end))
    arcs = circle_geometry(trace, columns.trace_row[circle_rows], start[:, :3, 3], via, end)
    return Circles(circle_rows, start, ends.pose[circle_rows], via, arcs)


def _programmed_angles(moves: Mapping[int, MotionStatement], circle_rows: Ints, count: int) -> Array:
    """Return the angle CA (n,) [rad] of n circles; NaN for circles without CA.

    :param circle_rows: (n,) rows of the circles.
    :param count: number of motions of the program.
    """
    angles = np.full(count, np.nan)
    for row, move in moves.items():  # circles that are read in bulk have no CA
        if move.angle is not None:
            angles[row] = move.angle * RAD_PER_DEG
    return angles[circle_rows]


def _check_circular_angles(targets: TextTargets, circle_rows: Ints, ends: EndPoses) -> None:
    """Refuse a change of orientation or of E1 on circles whose CA leads to another point than the end point.

    :param circle_rows: (n,) rows of these circles.
    :raises ProgramError: the orientation or E1 changes on such a circle.
    """
    trace, trace_row, control, carriage = targets.trace, targets.trace_row, targets.control, targets.carriage
    start, end = ends.start.at(circle_rows)[:, :3, :3], ends.pose[circle_rows, :3, :3]
    is_turning = control.turns_with_path[circle_rows] | ~same_orientation(start, end)
    is_turning &= ~control.keeps_orientation[circle_rows]
    if is_turning.any():
        raise trace.error(
            "the orientation changes on a circle with CA: where it is reached is not certain",
            int(trace_row[circle_rows[is_turning]][0]),
            "Give the end of the arc as its end point, without CA, or use $ORI_TYPE=#CONSTANT.",
        )
    if carriage is None:
        return
    is_travelling = np.abs(carriage.end[circle_rows] - carriage.begin[circle_rows]) > _TRAVEL_TOLERANCE
    if is_travelling.any():
        raise trace.error(
            "E1 moves along a circle with CA: where it reaches its end is not certain",
            int(trace_row[circle_rows[is_travelling]][0]),
            "Give the end of the arc as its end point, without CA, or move E1 in a motion of its own.",
        )


def _triggers_of_motions(follower: TraceFollower, line: Ints, motions: Motions, start: Starts) -> tuple[Trigger, ...]:
    """Return the TRIGGERs that refer to a motion, in order.

    A TRIGGER refers to the next motion, unless a spline block ends between the two.

    :param line: (M,) lines of the motions in the trace.
    :param start: poses at which the motions start.
    """
    lines = np.array(follower.run.triggers, dtype=np.int64)
    rows = np.searchsorted(line, lines)  # the next motion after each TRIGGER; M if there is none
    lines, rows = lines[rows < len(motions)], rows[rows < len(motions)]
    is_in_block = [
        follower.are_in_one_block(trigger_line, motion_line)
        for trigger_line, motion_line in zip(lines.tolist(), line[rows].tolist(), strict=True)
    ]
    lines, rows = lines[is_in_block], rows[is_in_block]
    if not len(rows):
        return ()
    is_attached = [
        follower.has_only_comments(trigger_line + 1, motion_line - 1)
        for trigger_line, motion_line in zip(lines.tolist(), line[rows].tolist(), strict=True)
    ]
    begin, end = start.at(rows)[:, :3, 3], motions.target.position[rows]  # positions [m]
    is_arc = motions.kind[rows] == CIRC
    # lengths of the motions [m]
    length = np.where(is_arc, norm(begin - motions.centre[rows]) * motions.sweep[rows], norm(end - begin))
    return tuple(
        triggers(follower.execution.trace, list(zip(lines.tolist(), rows.tolist(), is_attached, strict=True)), length)
    )


def _speed_blending_issues(trace: Trace, columns: MotionColumns) -> list[Issue]:
    """Return the issue that paths are approximated by speed or orientation (C_VEL, C_ORI); empty if none is."""
    # path motions with text behind the target that `$APO.CDIS` does not apply to
    exact_rows = np.flatnonzero(
        (columns.kind != PTP) & ~columns.approximated & (columns.tail[:, 1] > columns.tail[:, 0])
    )
    tails = zip(
        exact_rows.tolist(), columns.trace_row[exact_rows].tolist(), columns.tail[exact_rows].tolist(), strict=True
    )
    speed_rows = [
        row
        for row, line, tail in tails
        if any(word in _SPEED_WORDS for word, _ in words_in(trace.source(line).text, *tail))
    ]
    if not speed_rows:
        return []
    message = (
        "C_VEL and C_ORI blend by speed and orientation: how far that rounds corners is not known, and "
        "does not count in the check of the tolerance."
    )
    line = trace.reported_lines[columns.trace_row[speed_rows] - 1]
    lines = tuple(distinct(line).tolist())
    return [Issue("info", "blending-by-speed", message, int(line[0]), count=len(speed_rows), lines=lines)]


def _wrist_led_issues(motions: Motions, is_wrist_led: Bools) -> list[Issue]:
    """Return the warning on lines on which the wrist axes turn the tool; empty if there are no such lines.

    :param is_wrist_led: (M,) True for these lines.
    """
    wrist_rows = np.flatnonzero(is_wrist_led)
    if not len(wrist_rows):
        return []
    message = (
        "$ORI_TYPE=#JOINT: it is assumed that A4 to A6 turn in proportion to the path length while the tip stays on "
        "its line. Corrected motions are divided and get $ORI_TYPE=#VAR."
    )
    return [motions.issue("warning", "wrist-led", message, wrist_rows)]


def _assumption_issues(
    line: Ints, is_missing: Bools, has_assumed_speed: Bools, moves: Mapping[int, MotionStatement]
) -> list[Issue]:
    """Return an issue on missing components and one on missing speeds, with the lines of the motions, if there are any.

    :param line: (M,) lines of the motions, to be reported.
    :param is_missing: (M, 6) True for components that the text lacks, which keep their value.
    :param has_assumed_speed: (M,) True for motions before which no speed is set.
    :param moves: row → statement, for motions that are not plain.
    """
    issues = []
    incomplete = any_column(is_missing)
    for row, move in moves.items():
        incomplete[row] = not move.end.position.is_complete or move.is_via_incomplete
    for is_affected, kind, message in (
        (
            incomplete,
            "missing-components",
            "components are missing: they keep their previous value (in relative motions: 0).",
        ),
        (
            has_assumed_speed,
            "default-speed",
            f"$VEL.CP is not set before: the controller's {DEFAULT_SPEED:g} m/s is assumed.",
        ),
    ):
        affected_rows = np.flatnonzero(is_affected)
        if len(affected_rows):
            lines = tuple(distinct(line[affected_rows]).tolist())
            issues.append(
                Issue("info", kind, message, int(line[affected_rows[0]]), count=len(affected_rows), lines=lines)
            )
    return issues
