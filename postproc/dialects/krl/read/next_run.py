"""The next run of a program: whether it moves like the first run.

Values of a `.dat`, BASE_DATA and TOOL_DATA stay as a run leaves them. A program that changes some of them is followed
once more with the changed values. If it then moves differently, the output holds only for runs that begin with the
values in the files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from postproc.dialects.changed_data import changed_data_issue
from postproc.dialects.krl.course import Course
from postproc.dialects.krl.language.positions import Position
from postproc.dialects.krl.read.main_routine import MainRoutine, Start, course_of
from postproc.dialects.krl.read.motions import OrderedMotions, ordered_motions
from postproc.dialects.krl.read.plain_lines import PlainLines
from postproc.dialects.krl.read.rounds import Uses
from postproc.dialects.krl.read.settings import Settings
from postproc.errors import Issue, ProgramError
from postproc.frames import Array


def changed_data_issues(
    main: MainRoutine,
    change_places: Mapping[str, str],
    first: OrderedMotions,
    plain_lines: PlainLines,
    start_joints: tuple[float, ...],
) -> Iterator[Issue]:
    """Yield a warning if the next run of the program moves differently, or cannot be followed.

    The next run begins with the data that the first run leaves.

    :param main: has followed the first run.
    :param change_places: variables whose values the first run leaves to the next, see `kept_values`; nothing is yielded
        if there are none.
    :param first: motions of the first run.
    :param plain_lines: plain lines of the trace; its `motions` are emptied.
    :param start_joints: (6,) joint angles at the start [deg].
    """
    if not change_places:
        return
    cell, library, routine = main.run.settings.cell, main.run.library, main.run.routine
    variables = main.run.settings.variables.next_run()
    start = Start(library, routine, main.run.obstacles, variables=variables, cell=cell, joints=start_joints)
    try:
        course, collected_motions = course_of(start)
        line = _first_differing_row(main.course, course)
        if line is None:
            second_run = MainRoutine(
                collected_motions or start.new_collection(main.course.trace), main.course, plain_lines
            )
            if collected_motions is None:
                second_run.follow([])
            second = ordered_motions(second_run, plain_lines.motions)
            line = _first_difference(main.run.settings, first, second_run.run.settings, second)
        line = None if line is None else main.course.trace.shown_line(line)
    except ProgramError as cause:  # the next run cannot be followed
        line = cause.line or main.run.routine.first
    if line is not None:
        yield changed_data_issue(change_places, line)


def kept_values(main: MainRoutine) -> dict[str, str]:
    """Return variable → place that changes it, for variables whose values the next run of the program may use.

    Left out are variables that the program sets before it uses them, and variables that it uses only to compute their
    own next value; but not those that an interrupt, for example, may change at any time.
    """
    run, change_places = main.run, main.run.settings.variables.changed_data()
    uses = Uses(run, run.routine.source, run.nodes(run.routine)) if change_places else None
    volatile_names = run.settings.variables.volatile_values
    return {
        name: place
        for name, place in change_places.items()
        if uses is None or name in volatile_names or (uses.may_use(name) and not uses.only_counts(name))
    }


def _first_differing_row(first: Course, second: Course) -> int | None:
    """Return the first row, from 1, at which the traces of two runs differ; None if they are equal.

    It is 1 if they differ in their steps or their length alone.
    """
    row_count = min(len(first.trace), len(second.trace))  # rows of both traces
    columns = [(*_file_and_line_columns(course), course.counter_values()) for course in (first, second)]
    differs = np.zeros(row_count, dtype=np.bool_)
    for first_column, second_column in zip(*columns, strict=True):
        a, b = first_column[:row_count], second_column[:row_count]
        differs |= (a != b) & ~(np.isnan(a) & np.isnan(b))  # NaN equals NaN
    if differs.any():
        return int(np.argmax(differs)) + 1
    return None if first.steps == second.steps and len(first.trace) == len(second.trace) else 1


def _file_and_line_columns(course: Course) -> tuple[Array, Array]:
    """Return the file (L,), as a number, and the line (L,) of each of the L rows of a trace."""
    trace = course.trace
    files = np.array([float(id(source)) for source in trace.sources])  # the two runs share their sources
    return files[trace.file], trace.line.astype(np.float64)


def _first_difference(
    first_settings: Settings, first: OrderedMotions, second_settings: Settings, second: OrderedMotions
) -> int | None:
    """Return the line of the trace with the first motion that differs between two runs; None if all are equal.

    :param first_settings: settings of the first run, with its frames; `second_settings` those of the second.
    :param first: motions of the first run; `second` those of the second. If one run has more motions than the other,
        the line of the first motion is returned.
    """
    if len(first.rows) != len(second.rows):
        return int((first.rows if len(first.rows) else second.rows).line[0])
    is_same = np.ones(len(first.rows), dtype=np.bool_)
    for first_values, second_values in (
        (first.rows.numbers, second.rows.numbers),
        (first.rows.posture, second.rows.posture),
        (first.rows.external, second.rows.external),
        (first.rows.via, second.rows.via),
        (
            _settings_by_state(first_settings, first)[first.motion_states.index],
            _settings_by_state(second_settings, second)[second.motion_states.index],
        ),
        (first.numbers[:, :2], second.numbers[:, :2]),  # speed and distance, without turn speeds
    ):
        # NaN equals NaN
        is_same &= ((first_values == second_values) | (np.isnan(first_values) & np.isnan(second_values))).all(axis=1)
    for row, move in first.moves.items():
        is_same[row] &= row in second.moves and _are_equal(move.end.position, second.moves[row].end.position)
    rows = np.flatnonzero(~is_same)
    return int(first.rows.line[rows[0]]) if len(rows) else None


def _are_equal(position: Position, other_position: Position) -> bool:
    """Return whether two positions have the same components, type, S, T and external axes; NaN equals NaN."""
    numbers, other_numbers = (
        np.array([*p.values, p.is_axis, p.status, p.turn, *p.external], dtype=np.float64)
        for p in (position, other_position)
    )
    return np.array_equal(numbers, other_numbers, equal_nan=True)


def _settings_by_state(settings: Settings, sequence: OrderedMotions) -> Array:
    """Return the frames and modes of each of S states (S, 36): base (16), tool (16), four modes by their hashes.

    Unknown frames are NaN.
    """
    return np.array(
        [
            np.concatenate(
                [
                    _frame(settings.frames.bases, state.base),
                    _frame(settings.frames.tools, state.tool),
                    [hash(mode) for mode in (state.orientation, state.circle, state.auxiliary, state.wrist_mode)],
                ]
            )
            for state in sequence.motion_states.states
        ]
    )


def _frame(frames: list[Array], row: int) -> Array:
    """Return a frame (16,), row by row; NaN for a negative row, which stands for an unknown frame."""
    return frames[row].ravel() if row >= 0 else np.full(16, np.nan)
