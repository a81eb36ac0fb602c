"""Plain lines and statements put together: `Motions`, and the `Layout` of their text."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.chunks import Runs, compact
from postproc.dialects.krl.language.motion_statements import MotionStatement, Trigger, triggers
from postproc.dialects.krl.language.tokens import words_in
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.layout import CONSTANT, FREE, IGNORE, JOINT, ORIENTATIONS, Elements, Layout, Offsets
from postproc.dialects.krl.read.auxiliary_points import ignores_auxiliary_orientation
from postproc.dialects.krl.read.end_poses import (
    EndPoses,
    OrientationControl,
    circle_geometry,
    end_poses,
    same_orientation,
)
from postproc.dialects.krl.read.external_axes import external_axes
from postproc.dialects.krl.read.main_routine import MainRoutine
from postproc.dialects.krl.read.motion_columns import MotionColumns, merged_motions
from postproc.dialects.krl.read.plain_rounds import ElementMotions
from postproc.dialects.krl.read.plain_settings import NUMBERS
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.spline_blocks import approximated_motions, check_words, is_spline, unknown_path_warning
from postproc.dialects.krl.read.state import DEFAULT_SPEED, State, fields_used
from postproc.errors import Issue, ProgramError, combined_error
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array, angle_between, any_column, norm
from postproc.program import CIRC, LIN, PTP, Bools, Carriage, Ints, Motions, Starts, constant, distinct

_ONE_ROTATION = (FREE, CONSTANT)
"""Values of `$ORI_TYPE` under which the orientation changes by one rotation, or not at all."""
_SMALL_TURN = 0.5 * RAD_PER_DEG
"""By less than this [rad] the wrist turns the tool as one rotation does, to 0.001° away from singular poses: the square
of half of it."""
_END_TOLERANCE = 1e-6
"""A circle with CA that ends this close [rad] to its end point ends there."""
_REST_TOLERANCE = 1e-7
"""An external axis that moves by less [m] stays where it is: the tenth of a micrometre of the text."""
_SPEED_WORDS = frozenset({"C_VEL", "C_ORI"})


class OrderedMotions(NamedTuple):
    """All motions in order: the contents of their lines, and the settings in force.

    :param rows: (R,) motions.
    :param states: all states that are in force anywhere.
    :param state_index: (R,) which of them.
    :param numbers: (R, 2) of these, speed and distance of approximation, see `plain_settings.NUMBERS`, as runs of equal
        ones: plain settings have no states of their own.
    :param moves: row → statement, of those that are not plain.
    """

    rows: MotionColumns
    states: list[State]
    state_index: Ints
    numbers: Runs
    moves: dict[int, MotionStatement]


def ordered_motions(main: MainRoutine, plain_parts: list[MotionColumns]) -> OrderedMotions:
    """Return all motions of a program in order: plain lines and statements together.

    :param main: has followed all lines that are not plain.
    :param plain_parts: plain motions, in parts; the list is emptied, see `merged_motions`.
    """
    plain_parts += [rounds.rows for rounds in main.rounds]
    statement_rows = main.motions.rows()
    places, states, state, numbers = _merge_order(main, [rows.line for rows in plain_parts], statement_rows.line)
    first = sum(map(len, plain_parts))
    moves = {places.item(first + index): move for index, move in main.motions.special}
    plain_parts.append(statement_rows)
    return OrderedMotions(merged_motions(plain_parts, places), states, state, numbers, moves)


def _merge_order(main: MainRoutine, lines: list[Ints], statement_lines: Ints) -> tuple[Ints, list[State], Ints, Runs]:
    """Return the places of all R motions in execution order, and the settings in force.

    :param lines: lines of the plain motions, in parts.
    :param statement_lines: (S,) lines of the motions that were read as statements.
    :returns: places (R,), of the plain motions and then of the statements; all states; in execution order, the index of
        the state of each motion (R,) and its `NUMBERS` (R, 2).
    """
    line = np.concatenate(lines)
    states, state_plain, state_moves, change_lines = _states_of_lines(main.run.settings, line, main.motions.states)
    order = compact(np.argsort(line, kind="stable"), np.int32)
    place = np.searchsorted(line, statement_lines, sorter=order) + np.arange(len(statement_lines))
    place_plain = np.empty_like(line)
    place_plain[order] = np.delete(np.arange(len(line) + len(statement_lines)), place)
    places = compact(np.concatenate([place_plain, place]), np.int32)
    state: NDArray[Any] = np.empty(len(places), dtype=np.int32)
    state[places] = np.concatenate([state_plain, state_moves])
    numbers = np.array([[getattr(s, field) for field in NUMBERS] for s in states])[state]
    for row in range(len(NUMBERS)):
        row_values = numbers[place_plain, row]
        numbers[place_plain, row] = main.run.settings.plain_assignments.values_at(row, line, change_lines, row_values)
    return places, states, state, Runs.of(numbers)


def motions_and_layout(
    main: MainRoutine,
    sequence: OrderedMotions,
    start_joints: Array,
    kinematics: Callable[[Array], Array],
    predecessors: Ints | None = None,
) -> tuple[Motions, Layout, list[Issue]]:
    """Return the motions of a program in order, the layout of their text, and issues about assumptions.

    :param main: has followed all lines that are not plain.
    :param sequence: all motions.
    :param start_joints: (6,) joint angles at the start [rad].
    :param kinematics: (6,) joints → (4, 4) flange in the robot root.
    :param predecessors: (M,) the motion at whose end each begins, see `Program.after`.
    :raises ProgramError: a frame, a component or an axis is not known; external axes move; an orientation or a circle
        is not what the controller could follow.
    """
    trace, settings = main.course.trace, main.run.settings
    rows, states, state, _, moves = sequence
    block = _column(states, state, lambda s: s.spline_block)
    check_words(trace, rows, block)
    rows = replace(rows, approximated=approximated_motions(rows, block != "", main.splines.approximated_ends))
    base = _column(states, state, lambda s: s.base)
    tool = _column(states, state, lambda s: s.tool)
    _check_settings(settings, rows, states, state, moves)
    base, tool = (
        np.where(column < 0, 0, column) if (column < 0).any() else column for column in (base, tool)
    )  # of axis targets
    relative = np.array([row for row, move in moves.items() if move.relative_axes], dtype=np.int64)
    uses_root = np.ones(len(rows), dtype=np.bool_)
    uses_root[[row for row, move in moves.items() if move.end.position.is_axis]] = False
    axis_issues, carriage = external_axes(trace, rows, relative, uses_root, settings.cell.carriage, predecessors)
    frames = base, tool, np.stack(settings.frames.bases), np.stack(settings.frames.tools)
    control = _orientation_control(trace, rows, states, state)
    is_missing, arc_ends = np.isnan(rows.numbers), rows.numbers[rows.kind == CIRC, :3]
    ends = end_poses(
        trace, rows.line, rows.numbers, frames, moves, start_joints, kinematics, control, carriage, predecessors
    )
    by_wrist = _wrist_led_rows(trace, rows, states, state, ends, carriage)
    _check_by_wrist(trace, rows, states, state, ends, settings)
    centre, normal, sweep, unheeded = _circle_columns(
        trace, rows, ends, arc_ends, moves, control, settings, (states, state), carriage
    )

    is_missing[[row for row, move in moves.items() if move.end.position.is_axis or move.relative_axes]] = False
    sequence = sequence._replace(rows=rows)
    motions = _motions(trace, sequence, (base, tool), ends, (centre, normal, sweep))
    columns = is_missing, control.turns_with_path, by_wrist, unheeded
    layout = _layout(trace, main, sequence, motions, ends, columns, carriage)
    has_assumed_speed = _column(states, state, lambda s: s.is_speed_assumed) & (rows.kind != PTP)
    assumptions = _assumption_issues(motions.line, is_missing, has_assumed_speed, moves)
    return (
        motions,
        layout,
        [
            *axis_issues,
            *assumptions,
            *_speed_blending_issues(trace, rows),
            *unknown_path_warning(motions),
            *_wrist_led_issues(motions, by_wrist),
        ],
    )


def _motions(
    trace: Trace,
    sequence: OrderedMotions,
    frames: tuple[Ints, Ints],
    ends: EndPoses,
    arcs: tuple[Array, Array, Array],
) -> Motions:
    """Return the motions of a program, from what its text gives and the completed targets.

    :param frames: rows of `$BASE` and `$TOOL` (R,) each.
    :param ends: the completed targets.
    :param arcs: centres (R, 3), normals (R, 3) and swept angles (R,) of circles.
    """
    rows, numbers = sequence.rows, sequence.numbers
    base, tool = frames
    centre, normal, sweep = arcs
    return Motions(
        kind=rows.kind,
        rapid=rows.kind == PTP,
        line=trace.shown[rows.line - 1],
        target=ends.pose,
        joints=ends.joints,
        centre=centre,
        normal=normal,
        sweep=sweep,
        feed=np.where(rows.kind == PTP, np.nan, numbers[:, 0]),
        base=base,
        tool=tool,
        blend=np.where(rows.approximated, numbers[:, 1], 0.0),
        rounding=constant(np.inf, len(rows)),
        status=rows.posture[:, 0],
        turn=rows.posture[:, 1],
    )


def _layout(
    trace: Trace,
    main: MainRoutine,
    sequence: OrderedMotions,
    motions: Motions,
    ends: EndPoses,
    columns: tuple[Bools, Bools, Bools, Bools],
    carriage: Carriage | None,
) -> Layout:
    """Return the places of the numbers of the motions in the text.

    :param columns: (R,) each: `Layout.is_missing`, `with_path`, `by_wrist` and `unheeded`.
    """
    rows, states, state, _, moves = sequence
    variables = main.run.settings.variables
    is_missing, with_path, by_wrist, unheeded = columns
    elements = tuple(_elements_of_program(rows, rounds) for rounds in main.rounds)
    return Layout(
        course=main.course,
        line=rows.line,
        notes=(),
        numbers=ends.numbers,
        is_missing=is_missing,
        target_start=_target_begins(rows.target[:, 0], elements),
        relative_spans=rows.relative_spans,
        keyword=rows.keyword,
        target=rows.target,
        tail=rows.tail,
        via_spans=rows.via_spans,
        via_target=rows.via_target,
        starts_from_joints=ends.starts_from_joints,
        orientation=np.where(rows.kind == PTP, np.int8(0), _column(states, state, _orientation_index)),
        ignores_orientation=ends.ignores_orientation,
        turns_with_path=with_path,
        is_wrist_led=by_wrist,
        drops_via_orientation=unheeded,
        is_distance_known=_column(states, state, lambda s: all(field != "cdis" for field, _ in s.uncertain_fields)),
        is_in_spline_block=_column(states, state, lambda s: s.spline_block) != "",
        statements=moves,
        elements=elements,
        types=dict(variables.types),
        global_names=frozenset(variables.global_names),
        followed_names=frozenset(main.run.followed_names),
        copies=frozenset(main.run.copies),
        triggers=_triggers_of_motions(trace, main, rows.line, motions, ends.start),
        carriage=carriage,
        resume_place="" if main.run.resume_place is None else str(main.run.resume_place),
    )


def _elements_of_program(rows: MotionColumns, rounds: ElementMotions) -> Elements:
    """Return the points of an array to which a loop moves, by the rows of their motions in the program.

    :param rows: the motions of the program; those of the loop that are not among them are left out.
    :param rounds: the motions of the loop.
    """
    row = np.searchsorted(rows.line, rounds.rows.line)
    is_present = rows.line[np.minimum(row, len(rows) - 1)] == rounds.rows.line
    return Elements(row[is_present], rounds.literal[is_present], rounds.source, rounds.name)


def _target_begins(target: Offsets, elements: tuple[Elements, ...]) -> Offsets:
    """Return the offsets (R,) at which the points of motions begin: their targets, or elements of data lists."""
    begins = target.copy() if elements else target
    for part in elements:
        begins[part.row] = part.literal[:, 0]
    return begins


def _states_of_lines(
    settings: Settings, line: Ints, statement_states: list[State]
) -> tuple[list[State], Ints, Ints, Ints]:
    """Return all states, and which of them is in force at each line.

    :param line: (n,) lines of plain motions.
    :param statement_states: states of the k statements that were read one by one.
    :returns: the states; the index of that of each plain line (n,) and each statement (k,); the lines (n,) after which
        the states of plain lines hold.
    """
    states = [state for _, state in settings.changes]
    changes = np.array([line for line, _ in settings.changes])
    index_of_state: dict[State, int] = {}
    statement_indices = []
    for state in statement_states:
        if state not in index_of_state:
            index_of_state[state] = len(states)
            states.append(state)
        statement_indices.append(index_of_state[state])
    state_of_line = compact(np.searchsorted(changes, line) - 1, np.int32)
    return (
        states,
        state_of_line,
        compact(np.array(statement_indices, dtype=np.int64), np.int32),
        compact(changes, np.int32)[state_of_line],
    )


def settings_at(settings: Settings, line: Ints) -> list[tuple[State, Array, Array]]:
    """Return the settings in force before n lines: for each the state, and `$BASE` and `$TOOL` as matrices (4, 4).

    The rows of the frames in the state are 0. If a frame is not known, the state has the reason and the matrix is 0.

    :param line: (n,) lines of the trace.
    """
    states, state, _, change_lines = _states_of_lines(settings, line, [])
    numbers = [
        settings.plain_assignments.values_at(row, line, change_lines, _column(states, state, _number_of_state(row)))
        for row in (0, 1)
    ]
    entries = []
    for index, *values in zip(state.tolist(), *(column.tolist() for column in numbers), strict=True):
        line_state = states[index]
        frames = (
            _frame_or_zeros(settings.frames.bases, line_state.base),
            _frame_or_zeros(settings.frames.tools, line_state.tool),
        )
        field_values = dict(zip(NUMBERS, values, strict=True))
        entries.append(
            (
                replace(
                    line_state,
                    base=min(line_state.base, 0),
                    tool=min(line_state.tool, 0),
                    is_speed_assumed=False,
                    **field_values,
                ),
                *frames,
            )
        )
    return entries


def _frame_or_zeros(frames: list[Array], row: int) -> Array:
    """Return a frame (4, 4); zeros for a negative row, which stands for an unknown frame."""
    return frames[row] if row >= 0 else np.zeros((4, 4))


def _number_of_state(row: int) -> Callable[[State], object]:
    """Return a function that reads one of the `NUMBERS` from a state."""
    return lambda state: getattr(state, NUMBERS[row])


def _orientation_index(state: State) -> object:
    """Return the index of `$ORI_TYPE` of a state in `ORIENTATIONS`."""
    return np.int8(ORIENTATIONS.index(state.orientation))


def _column(states: list[State], state: Ints, value: Callable[[State], object]) -> np.ndarray:
    """Return one property of the states in force at n motions (n,), to be read only.

    :param state: (n,) index of the state of each motion.
    :param value: reads the property from a state; integers get at most 4 bytes each.
    """
    values = np.array([value(s) for s in states])
    if len(values) and (values == values[0]).all():
        return np.broadcast_to(values[0], (len(state),))
    return (compact(values, np.int32) if values.dtype == np.int64 else values)[state]


def _check_settings(
    settings: Settings, rows: MotionColumns, states: list[State], state: Ints, moves: Mapping[int, MotionStatement]
) -> None:
    """Refuse motions that depend on unknown frames, speeds or modes.

    :raises ProgramError: there are some; all reasons together.
    """
    faults = list(_setting_errors(settings, rows, states, state, moves))
    if faults:
        raise combined_error(faults)


def setting_errors(main: MainRoutine, plain_parts: list[MotionColumns]) -> Iterator[ProgramError]:
    """Yield the errors of the motions of a program that depend on unknown settings, once for each reason."""
    sequence = ordered_motions(main, plain_parts)
    yield from _setting_errors(main.run.settings, sequence.rows, sequence.states, sequence.state_index, sequence.moves)


def _setting_errors(
    settings: Settings, rows: MotionColumns, states: list[State], state: Ints, moves: Mapping[int, MotionStatement]
) -> Iterator[ProgramError]:
    """Yield the errors of motions that depend on unknown settings, once for each reason.

    :param state: (M,) index in `states` of each motion; `moves` the motions that were not read in bulk, by row.
    """
    reason_keys: set[tuple[str | None, int | None, str]] = set()
    for index, motion_state in enumerate(states):
        if not motion_state.uncertain_fields and motion_state.base >= 0 and motion_state.tool >= 0:
            continue
        for row in np.flatnonzero(state == index).tolist():
            axis = row in moves and moves[row].end.position.is_axis
            fields = fields_used(int(rows.kind[row]), axis=axis, is_approximated=bool(rows.approximated[row]))
            try:
                settings.refuse_uncertain(motion_state, fields)
            except ProgramError as cause:
                if (key := (cause.file, cause.line, cause.problem)) not in reason_keys:
                    reason_keys.add(key)
                    yield cause


def _orientation_control(trace: Trace, rows: MotionColumns, states: list[State], state: Ints) -> OrientationControl:
    """Return how the orientation of each motion is controlled: KUKA, KSS 8.x, `$ORI_TYPE` and `$CIRC_TYPE`.

    Under #CONSTANT the orientation of the start stays and the programmed one is disregarded. Under #PATH a circle turns
    the tool with the path: the orientation that stays, or changes by one rotation, is the one relative to the path.
    `$CIRC_TYPE` has no effect under #JOINT.

    :raises ProgramError: a circle under #PATH whose orientation changes otherwise.
    """
    is_circle = rows.kind == CIRC
    is_unsupported = is_circle & _column(
        states, state, lambda s: s.circle == "#PATH" and s.orientation not in _ONE_ROTATION
    )
    if is_unsupported.any():
        first = int(np.argmax(is_unsupported))
        problem = f"a circle under $ORI_TYPE={states[state[first]].orientation} and $CIRC_TYPE=#PATH"
        raise trace.error(problem, int(rows.line[first]), "Use $CIRC_TYPE=#BASE, or $ORI_TYPE=#VAR.")
    is_constant = _column(states, state, lambda s: s.orientation == CONSTANT) & (rows.kind != PTP)
    with_path = _column(states, state, lambda s: s.circle == "#PATH" and s.orientation in _ONE_ROTATION)
    return OrientationControl(is_constant, is_circle & with_path, rows.via)


def _wrist_led_rows(
    trace: Trace,
    rows: MotionColumns,
    states: list[State],
    state: Ints,
    ends: EndPoses,
    carriage: Carriage | None,
) -> Bools:
    """Return the motions (R,) on which the wrist axes turn the tool: lines under `$ORI_TYPE=#JOINT`.

    :raises ProgramError: the controller would lead the orientation in a way that is not known.
    """
    is_wrist_led = np.zeros(len(rows), dtype=np.bool_)
    candidates = np.flatnonzero(
        _column(states, state, lambda s: s.orientation not in _ONE_ROTATION) & (rows.kind != PTP)
    )
    if not len(candidates):
        return is_wrist_led
    kinds = [states[index].orientation for index in state[candidates]]
    next_rows = np.minimum(candidates + 1, len(rows) - 1)
    is_turned, is_next_turned = (
        ~same_orientation(ends.start.at(subset)[:, :3, :3], ends.pose[subset, :3, :3])
        for subset in (candidates, next_rows)
    )
    is_turned |= is_next_turned & np.array([kind == IGNORE for kind in kinds])
    is_led_by_wrist = np.array([kind == JOINT for kind in kinds]) & (rows.kind[candidates] == LIN)
    if carriage is not None:
        is_led_by_wrist &= carriage.travel[candidates] <= _REST_TOLERANCE
    is_wrist_led[candidates[is_turned & is_led_by_wrist]] = True
    is_turned &= ~is_led_by_wrist
    if not is_turned.any():
        return is_wrist_led
    first = int(np.argmax(is_turned))
    problem = {
        JOINT: "the orientation changes under $ORI_TYPE=#JOINT on another path than a line, or while E1 moves: how the "
        "wrist axes lead it is not known",
        IGNORE: "the orientation changes at a target under $ORI_TYPE=#IGNORE: the controller chooses it there",
    }[kinds[first]]
    advice = "Use $ORI_TYPE=#VAR: the orientation then changes by one rotation, from target to target."
    raise trace.error(problem, int(rows.line[candidates[first]]), advice)


def _check_by_wrist(
    trace: Trace, rows: MotionColumns, states: list[State], state: Ints, ends: EndPoses, settings: Settings
) -> None:
    """Refuse spline motions whose orientation the controller may lead by the wrist axes.

    Under `$SPL_ORI_JOINT_AUTO` #ON it decides that itself for each motion under `$ORI_TYPE=#VAR` (KUKA, KSS 8.x).

    :raises ProgramError: the orientation changes on such a motion.
    """
    may_use_wrist = [s.by_wrist == "#ON" or any(field == "by_wrist" for field, _ in s.uncertain_fields) for s in states]
    if not any(may_use_wrist):
        return
    is_free = (
        _column(states, state, lambda s: s.orientation == FREE) & np.array(may_use_wrist)[state] & (rows.kind != PTP)
    )
    free_rows = np.flatnonzero(is_free)
    spline_rows = free_rows[is_spline(trace, rows, free_rows)]
    turn = angle_between(ends.start.at(spline_rows)[:, :3, :3], ends.pose[spline_rows, :3, :3])
    for row in spline_rows[turn > _SMALL_TURN].tolist():
        settings.refuse_uncertain(states[state[row]], ["by_wrist"])
        problem = "the orientation changes under $SPL_ORI_JOINT_AUTO=#ON: the wrist axes may lead it, not one rotation"
        raise trace.error(problem, int(rows.line[row]), "Use $SPL_ORI_JOINT_AUTO=#OFF.")


def _circle_columns(
    trace: Trace,
    rows: MotionColumns,
    ends: EndPoses,
    given_ends: Array,
    moves: Mapping[int, MotionStatement],
    control: OrientationControl,
    settings: Settings,
    in_force: tuple[list[State], Ints],
    carriage: Carriage | None,
) -> tuple[Array, Array, Array, Bools]:
    """Return centre (M, 3), normal (M, 3) and sweep (M,) of the circles, NaN elsewhere, and
    `Layout.drops_via_orientation` (M,).

    :param given_ends: (n, 3) X, Y, Z of the ends of the n circles as the text gives them [mm].
    :param control: how the orientation is led.
    :param in_force: states, and the index of the state at each motion (M,).
    :raises ProgramError: a circle is not defined by its points, or it is not known how the tool turns on it.
    """
    unheeded = np.zeros(len(rows), dtype=np.bool_)
    nan_rows = np.broadcast_to(np.nan, (len(rows), 3))  # takes no memory
    circular = np.flatnonzero(rows.kind == CIRC)
    if not len(circular):
        return nan_rows, nan_rows, nan_rows[:, 0], unheeded
    centre, normal, sweep = nan_rows.copy(), nan_rows.copy(), nan_rows[:, 0].copy()
    line, start = rows.line[circular], ends.start.at(circular)
    text_points = rows.via[circular] * M_PER_MM, given_ends * M_PER_MM
    for row, points in ends.circles.items():
        circle_index = np.searchsorted(circular, row)
        text_points[0][circle_index], text_points[1][circle_index] = points * M_PER_MM
    via, end = (np.where(np.isnan(points), start[:, :3, 3], points) for points in text_points)
    centre[circular], axis, angle = circle_geometry(trace, line, start[:, :3, 3], via, end)
    programmed_angles = np.full(len(rows), np.nan)
    for row, move in moves.items():
        programmed_angles[row] = np.nan if move.angle is None else move.angle * RAD_PER_DEG
    programmed_angles = programmed_angles[circular]
    has_angle = ~np.isnan(programmed_angles)
    at_other_end = circular[has_angle & ~(np.abs(programmed_angles - angle) < _END_TOLERANCE)]
    _check_circular_angles(trace, rows.line, at_other_end, ends, control, carriage)
    tools = start, ends.pose[circular]
    arcs = centre[circular], axis, via, angle
    states, state = in_force
    unheeded[circular] = ignores_auxiliary_orientation(
        trace, rows, circular, moves, tools, arcs, control, settings, (states, state[circular])
    )
    normal[circular] = np.where(has_angle, np.sign(programmed_angles), 1.0)[:, None] * axis
    sweep[circular] = np.where(has_angle, np.abs(programmed_angles), angle)
    return centre, normal, sweep, unheeded


def _check_circular_angles(
    trace: Trace,
    line: Ints,
    circles: Ints,
    ends: EndPoses,
    control: OrientationControl,
    carriage: Carriage | None,
) -> None:
    """Refuse a change of orientation or of E1 on circles whose CA leads to another point than the end point.

    :param line: (M,) lines of all motions.
    :param circles: (n,) rows of these circles.
    :raises ProgramError: one changes.
    """
    start, end = ends.start.at(circles)[:, :3, :3], ends.pose[circles, :3, :3]
    is_turning = (control.turns_with_path[circles] | ~same_orientation(start, end)) & ~control.keeps_orientation[
        circles
    ]
    if is_turning.any():
        raise trace.error(
            "the orientation changes on a circle with CA: where it is reached is not certain",
            int(line[circles[is_turning]][0]),
            "Give the end of the arc as its end point, without CA, or use $ORI_TYPE=#CONSTANT.",
        )
    if carriage is None:
        return
    is_travelling = np.abs(carriage.end[circles] - carriage.begin[circles]) > _REST_TOLERANCE
    if is_travelling.any():
        raise trace.error(
            "E1 moves along a circle with CA: where it reaches its end is not certain",
            int(line[circles[is_travelling]][0]),
            "Give the end of the arc as its end point, without CA, or move E1 in a motion of its own.",
        )


def _triggers_of_motions(
    trace: Trace, main: MainRoutine, line: Ints, motions: Motions, start: Starts
) -> tuple[Trigger, ...]:
    """Return the TRIGGERs that refer to a motion, in order.

    :param line: (M,) lines of the motions in the trace.
    """
    lines = np.array(main.run.triggers, dtype=np.int64)
    rows = np.searchsorted(line, lines)
    lines, rows = lines[rows < len(motions)], rows[rows < len(motions)]
    in_block = [
        main.are_in_one_block(trigger_line, int(line[row]))
        for trigger_line, row in zip(lines.tolist(), rows.tolist(), strict=True)
    ]
    lines, rows = lines[in_block], rows[in_block]
    if not len(rows):
        return ()
    following = line[rows].tolist()
    is_attached = [
        main.contain_only_comments(trigger_line + 1, line - 1)
        for trigger_line, line in zip(lines.tolist(), following, strict=True)
    ]
    begin, end = start.at(rows)[:, :3, 3], motions.target.position[rows]
    is_arc = motions.kind[rows] == CIRC
    length = np.where(is_arc, norm(begin - motions.centre[rows]) * motions.sweep[rows], norm(end - begin))
    return tuple(triggers(trace, list(zip(lines.tolist(), rows.tolist(), is_attached, strict=True)), length))


def _speed_blending_issues(trace: Trace, rows: MotionColumns) -> list[Issue]:
    """Return the information that paths are approximated by speed or orientation (C_VEL, C_ORI); none if none is."""
    exact_rows = np.flatnonzero((rows.kind != PTP) & ~rows.approximated & (rows.tail[:, 1] > rows.tail[:, 0]))
    tails = zip(exact_rows.tolist(), rows.line[exact_rows].tolist(), rows.tail[exact_rows].tolist(), strict=True)
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
    line = trace.shown[rows.line[speed_rows] - 1]
    lines = tuple(distinct(line).tolist())
    return [Issue("info", "blending-by-speed", message, int(line[0]), count=len(speed_rows), lines=lines)]


def _wrist_led_issues(motions: Motions, by_wrist: Bools) -> list[Issue]:
    """Return the warning on lines on which the wrist axes turn the tool; none if there are none."""
    wrist_rows = np.flatnonzero(by_wrist)
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
    """Return the information on missing components and on missing speeds, with the lines of the motions.

    :param line: (M,) lines of the motions.
    :param is_missing: (M, 6) components that the text lacks, which keep their value.
    :param has_assumed_speed: (M,) motions before which no speed is set.
    :param moves: row → statement, of those that are not plain.
    """
    issues = []
    incomplete = any_column(is_missing)
    for row, move in moves.items():
        incomplete[row] = not move.end.position.is_complete or move.is_via_incomplete
    for rows, kind, message in (
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
        affected_rows = np.flatnonzero(rows)
        if len(affected_rows):
            lines = tuple(distinct(line[affected_rows]).tolist())
            issues.append(
                Issue("info", kind, message, int(line[affected_rows[0]]), count=len(affected_rows), lines=lines)
            )
    return issues
