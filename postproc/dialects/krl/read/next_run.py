"""The next run of a program: whether it does the same as the first.

Values of a `.dat`, BASE_DATA and TOOL_DATA stay as a run leaves them. Where a program changes some of them, it is
followed once more from there. If it then moves differently, the output holds only for runs that begin with the files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from postproc.dialects.krl.course import Course
from postproc.dialects.krl.language.positions import Position
from postproc.dialects.krl.read.main_routine import MainRoutine, Start, course_of
from postproc.dialects.krl.read.motions import OrderedMotions, ordered_motions
from postproc.dialects.krl.read.plain_lines import PlainLines
from postproc.dialects.krl.read.rounds import Uses
from postproc.dialects.krl.read.settings import Settings
from postproc.errors import Issue, ProgramError, first_of
from postproc.frames import Array

_MOST_NAMES = 10
"""Most names in one message."""


def changed_data_issues(
    main: MainRoutine,
    change_places: Mapping[str, str],
    first: OrderedMotions,
    plain_lines: PlainLines,
    start_joints: tuple[float, ...],
) -> Iterator[Issue]:
    """Yield a warning if the next run of the program moves differently, or is not known.

    The next run begins with the data that this run leaves.

    :param main: has followed the program.
    :param change_places: values that it leaves to the next run, see `kept_values`.
    :param first: its motions.
    :param plain_lines: its plain lines.
    :param start_joints: joint angles at the start [deg].
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
            second_run = MainRoutine(collected_motions or start.collected(main.course.trace), main.course, plain_lines)
            if collected_motions is None:
                second_run.follow([])
            second = ordered_motions(second_run, plain_lines.motions)
            line = _first_difference(main.run.settings, first, second_run.run.settings, second)
        line = None if line is None else main.course.trace.shown_line(line)
    except ProgramError as cause:
        line = cause.line or main.run.routine.first
    if line is None:
        return
    names = first_of([f"{name} ({place})" for name, place in change_places.items()], _MOST_NAMES)
    message = (
        f"The program changes data that stay changed: {names}. The next run begins with the changed "
        "values and moves differently from this line on: the output holds for a run that begins with the values in "
        "the files. Set them at the beginning of the program."
    )
    yield Issue("warning", "changed-data", message, line, subject=", ".join(list(change_places)[:_MOST_NAMES]))


def kept_values(main: MainRoutine) -> dict[str, str]:
    """Return the variables whose values a run leaves to the next one, which may use them, and where they are changed.

    Variables that the program sets before it uses them are left out, and counters that nothing else uses.
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
    """Return the first row, from 1, at which the traces of two runs differ; None if they are equal."""
    rows = min(len(first.trace), len(second.trace))
    columns = [(*_file_and_line_columns(course), course.counter_values()) for course in (first, second)]
    differs = np.zeros(rows, dtype=np.bool_)
    for first_column, second_column in zip(*columns, strict=True):
        differs |= (first_column[:rows] != second_column[:rows]) & ~(
            np.isnan(first_column[:rows]) & np.isnan(second_column[:rows])
        )
    if differs.any():
        return int(np.argmax(differs)) + 1
    return None if first.steps == second.steps and len(first.trace) == len(second.trace) else 1


def _file_and_line_columns(course: Course) -> tuple[Array, Array]:
    """Return the file (L,), as a number, and the line (L,) that each row of a trace is."""
    trace = course.trace
    files = np.array([float(id(source)) for source in trace.sources])  # the two runs share their sources
    return files[trace.file], trace.line.astype(np.float64)


def _first_difference(
    first_settings: Settings, first: OrderedMotions, second_settings: Settings, second: OrderedMotions
) -> int | None:
    """Return the line of the first motion that differs between two runs; None if there is none."""
    if len(first.rows) != len(second.rows):
        return int((first.rows if len(first.rows) else second.rows).line[0])
    is_same = np.ones(len(first.rows), dtype=np.bool_)
    for first_values, second_values in (
        (first.rows.numbers, second.rows.numbers),
        (first.rows.posture, second.rows.posture),
        (first.rows.external, second.rows.external),
        (first.rows.via, second.rows.via),
        (
            _settings_by_state(first_settings, first)[first.in_force.index],
            _settings_by_state(second_settings, second)[second.in_force.index],
        ),
        (first.numbers[:, :2], second.numbers[:, :2]),
    ):
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
    """Return the frames and modes of each of S states (S, 36); NaN for unknown frames."""
    return np.array(
        [
            np.concatenate(
                [
                    _frame(settings.frames.bases, state.base),
                    _frame(settings.frames.tools, state.tool),
                    [hash(mode) for mode in (state.orientation, state.circle, state.auxiliary, state.by_wrist)],
                ]
            )
            for state in sequence.in_force.states
        ]
    )


def _frame(frames: list[Array], row: int) -> Array:
    """Return a frame (16,), row by row; NaN for a negative row, which stands for an unknown frame."""
    return frames[row].ravel() if row >= 0 else np.full(16, np.nan)
