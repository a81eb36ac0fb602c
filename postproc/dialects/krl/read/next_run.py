"""Later runs of a program: whether they move like the first run, see `postproc.dialects.changed_data`.

Values of a `.dat`, BASE_DATA and TOOL_DATA stay as a run leaves them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import zip_longest

import numpy as np
from msgspec.structs import replace

from postproc.dialects.changed_data import FollowedRun, changed_data_issue, later_difference
from postproc.dialects.krl.execution import Execution, Lines, RoutineExit, Step, UnresolvedStructure
from postproc.dialects.krl.language.positions import Position
from postproc.dialects.krl.read.known import UnknownValue, shown_name
from postproc.dialects.krl.read.main_routine import Start, TraceFollower, execution_of
from postproc.dialects.krl.read.motions import OrderedMotions, ordered_motions
from postproc.dialects.krl.read.plain_lines import PlainLines
from postproc.dialects.krl.read.rounds import Uses
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.variables import variable_of
from postproc.errors import Issue, ProgramError
from postproc.frames import Array


def changed_data_issues(
    follower: TraceFollower,
    change_places: Mapping[str, str],
    first: OrderedMotions,
    plain_lines: PlainLines,
    start_joints: tuple[float, ...],
) -> Iterator[Issue]:
    """Yield a warning if a later run of the program moves differently, or cannot be followed.

    Each run begins with the data that the one before leaves.

    :param follower: has followed the first run.
    :param change_places: variables whose values the first run leaves to the next, see `kept_values`; nothing is yielded
        if there are none.
    :param first: motions of the first run.
    :param plain_lines: plain lines of the trace.
    :param start_joints: (6,) joint angles at the start [deg].
    """
    later_runs = _LaterRuns(follower, change_places, first, plain_lines, start_joints)
    difference = later_difference(change_places.keys(), later_runs.follow_next)
    if difference is not None:
        names = sorted(set(map(variable_of, difference.names)))
        places = {shown_name(name): later_runs.change_places[name] for name in names}
        yield changed_data_issue(places, difference.place, is_certain=difference.is_certain)


def kept_values(follower: TraceFollower) -> dict[str, str]:
    """Return variable → place that changes it, for variables whose values the next run of the program may use.

    Left out are variables that the program sets before it uses them, and variables that it uses only to compute their
    own next value; but not those that an interrupt, for example, may change at any time.
    """
    run, change_places = follower.run, follower.run.settings.variables.changed_data()
    uses = Uses(run, run.routine.source, run.nodes(run.routine)) if change_places else None
    volatile_names = run.settings.variables.volatile_values
    return {
        name: place
        for name, place in change_places.items()
        if uses is None or name in volatile_names or (uses.may_use(name) and not uses.only_counts(name))
    }


class _LaterRuns:
    """The runs of a program after the first, one after the other; for the parameters see `changed_data_issues`.

    :ivar change_places: variable whose value a run leaves to the next → first place that changes it, of all runs.
    """

    def __init__(
        self,
        follower: TraceFollower,
        change_places: Mapping[str, str],
        first: OrderedMotions,
        plain_lines: PlainLines,
        start_joints: tuple[float, ...],
    ) -> None:
        """Begin behind the first run."""
        self.change_places = dict(change_places)
        self._follower, self._first, self._plain_lines, self._start_joints = follower, first, plain_lines, start_joints
        self._last_variables = follower.run.settings.variables

    def follow_next(self, unknown_keys: frozenset[str]) -> FollowedRun:
        """Follow the program with the data that the run before has left, and compare it with the first run.

        :param unknown_keys: variables and elements of arrays that are unknown when the run begins.
        :returns: the run; its difference is a line of the file. Changed data are given by their keys.
        """
        follower, first_run = self._follower, self._follower.run
        variables = self._last_variables.next_run()
        for key in unknown_keys:
            variables.put(key, UnknownValue(self.change_places[variable_of(key)]))
        start = Start(
            first_run.library,
            first_run.routine,
            first_run.obstacles,
            variables=variables,
            cell=first_run.settings.cell,
            joints=self._start_joints,
        )
        # a copy of the list, which `ordered_motions` empties
        plain_lines = replace(self._plain_lines, motions=[*self._plain_lines.motions])
        try:
            execution, collected_motions = execution_of(start)
            row = _first_differing_row(follower.execution, execution)
            if row is None:
                next_follower = TraceFollower(
                    collected_motions or start.new_collection(follower.execution.trace), follower.execution, plain_lines
                )
                if collected_motions is None:
                    next_follower.follow([])
                motions = ordered_motions(next_follower, plain_lines.motions)
                row = _first_difference(first_run.settings, self._first, next_follower.run.settings, motions)
            if row is not None:
                return FollowedRun(follower.execution.trace.reported_line(row))
        except ProgramError as cause:  # the run cannot be followed
            return FollowedRun(cause.line or first_run.routine.first)
        self._last_variables = next_follower.run.settings.variables
        places = kept_values(next_follower)
        self.change_places = places | self.change_places
        keys = self._last_variables.differing_keys(variables.snapshot())
        # None: it moves as the first run does
        return FollowedRun(None, frozenset(key for key in keys if variable_of(key) in places))


def _first_differing_row(first: Execution, second: Execution) -> int | None:
    """Return the first row, from 1, at which the traces of two runs differ; None if they are equal."""
    row_count = min(len(first.trace), len(second.trace))  # rows of both traces
    columns = [(*_file_and_line_columns(execution), execution.counter_values()) for execution in (first, second)]
    differs = np.zeros(row_count, dtype=np.bool_)
    for first_column, second_column in zip(*columns, strict=True):
        a, b = first_column[:row_count], second_column[:row_count]
        differs |= (a != b) & ~(np.isnan(a) & np.isnan(b))  # NaN, no counter, equals NaN
    row = int(np.argmax(differs)) + 1 if differs.any() else None
    step_row = _first_differing_step(first, second)
    if row is None and step_row is None and len(first.trace) != len(second.trace):
        return row_count
    return min((known_row for known_row in (row, step_row) if known_row is not None), default=None)


def _first_differing_step(first: Execution, second: Execution) -> int | None:
    """Return the row of the trace at which the first step differs between two runs; None if all steps are equal."""
    row = 1  # of the last step with a row
    for step, other_step in zip_longest(first.steps, second.steps):
        if _identity(step) == _identity(other_step):
            row = _step_row(step) or row
        elif isinstance(step, Lines) and isinstance(other_step, Lines) and step.first == other_step.first:
            return min(step.last, other_step.last) + 1
        else:
            step_rows = map(_step_row, (step, other_step))
            return min((known_row for known_row in step_rows if known_row is not None), default=row)
    return None


def _identity(step: Step | None) -> object:
    """Return what is equal in equal steps of two runs: the step, without the reason why a structure is not followed."""
    return (step.first, step.last) if isinstance(step, UnresolvedStructure) else step


def _step_row(step: Step | None) -> int | None:
    """Return the first row of the trace of a step; None if it has none."""
    if isinstance(step, Lines | UnresolvedStructure):
        return step.first
    return None if step is None or isinstance(step, RoutineExit) else step.row


def _file_and_line_columns(execution: Execution) -> tuple[Array, Array]:
    """Return the file (L,), as a number, and the line (L,) of each of the L rows of a trace."""
    trace = execution.trace
    files = np.array([float(id(source)) for source in trace.sources])  # the two runs share their sources
    return files[trace.file], trace.line.astype(np.float64)


def _first_difference(
    first_settings: Settings, first: OrderedMotions, second_settings: Settings, second: OrderedMotions
) -> int | None:
    """Return the row of the trace with the first motion that differs between two runs; None if all are equal.

    :param first_settings: settings of the first run, with its frames; `second_settings` those of the second.
    :param first: motions of the first run; `second` those of the second. If one run has more motions than the other,
        the row of the first motion is returned.
    """
    if len(first.columns) != len(second.columns):
        return int((first.columns if len(first.columns) else second.columns).trace_row[0])
    is_same = np.ones(len(first.columns), dtype=np.bool_)
    for first_values, second_values in (
        (first.columns.numbers, second.columns.numbers),
        (first.columns.posture, second.columns.posture),
        (first.columns.external, second.columns.external),
        (first.columns.via, second.columns.via),
        (
            _settings_by_state(first_settings, first)[first.motion_states.index],
            _settings_by_state(second_settings, second)[second.motion_states.index],
        ),
        (first.numbers[:, :2], second.numbers[:, :2]),  # speed and distance, without turn speeds
    ):
        # NaN equals NaN
        is_same &= ((first_values == second_values) | (np.isnan(first_values) & np.isnan(second_values))).all(axis=1)
    for motion, move in first.moves.items():
        is_same[motion] &= motion in second.moves and _are_equal(move.end.position, second.moves[motion].end.position)
    differing_motions = np.flatnonzero(~is_same)
    return int(first.columns.trace_row[differing_motions[0]]) if len(differing_motions) else None


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
