"""Records the execution trace, line by line, while a program is followed.

The execution trace: the lines of the program in the order in which they are executed, as rows from 1. Loops are
unrolled in it, and called routines inlined.
"""

from __future__ import annotations

from collections.abc import Set
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import ragged_range
from postproc.dialects.krl.execution import (
    Body,
    Branch,
    Execution,
    Fork,
    InlinedRoutine,
    Join,
    Lines,
    PlainRounds,
    RoutineEntry,
    RoutineExit,
    Step,
    UnresolvedStructure,
    UnrolledLoop,
)
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.structures import Block
from postproc.dialects.krl.language.trace import Trace
from postproc.errors import ProgramError
from postproc.program import Document


class _OpenRoutine(Struct, eq=False):
    """A routine of the trace that has not ended yet.

    :ivar next_line: first line of the routine that is not recorded yet.
    :ivar reported_line: line of the `.src` to report for all lines of the routine; 0: each line itself.
    :ivar bodies: body of the routine, and bodies of its loops that have not ended, the innermost last.
    """

    source: Source
    next_line: int
    reported_line: int
    bodies: list[Body] = []


class _LineRange(NamedTuple):
    """Consecutive rows of the trace that are consecutive lines of one file.

    :ivar file_number: index of the file in the files of the trace.
    :ivar first: line of the first row; `last` is the line of the last row.
    :ivar reported_line: line of the `.src` to report for all rows; 0: the line of each row itself.
    :ivar is_executed: True if the rows run.
    :ivar for_line: line of the FOR whose counter the only row sets; 0 for rows that are lines of the file.
    """

    file_number: int
    first: int
    last: int
    reported_line: int
    is_executed: bool
    for_line: int = 0


class RecorderState(NamedTuple):
    """The state of a recorder, for `Recorder.return_to`.

    :ivar row_count: number of rows. The next five are the lengths of the lists and dictionaries of the recorder.
    :ivar last_step: the last step, which later rows may extend; None without steps.
    :ivar open_routines: for each open routine its next line, number of bodies, and number of structures in each body.
    """

    row_count: int
    range_count: int
    step_count: int
    assignment_count: int
    inlined_count: int
    file_count: int
    last_step: Step | None
    open_routines: list[tuple[int, int, list[int]]]


class Recorder:
    """The execution trace of a program so far.

    :param main: the main routine.
    :ivar row_count: number of rows.
    :ivar may_call_originals: True if routines of the trace may also be called by code that is left uncorrected.
    :ivar is_final: False once rows were dropped, left uncorrected, taken at once or divided into branches: the rows are
        then not those of the statements that have been followed.
    :ivar body: body of the main routine.
    """

    def __init__(self, main: Routine) -> None:
        """Begin with the lines of the file up to and including the DEF of the main routine."""
        self.main = main
        self.row_count = 0
        self.may_call_originals = False
        self.is_final = True
        self._sources: dict[Source, int] = {main.source: 0}
        self._line_ranges: list[_LineRange] = []
        self._steps: list[Step] = []
        self._counter_values: list[tuple[int, int]] = []  # row that sets the counter of a FOR, and the number
        self._inlined: dict[Routine, None] = {}  # inlined routines and their files, as ordered sets
        self._files: dict[Document, None] = {}
        self._record_lines(main.source, 1, main.first, 0, is_executed=False)
        self.body = Body(self.row_count + 1)
        self._open_routines = [_OpenRoutine(main.source, main.first + 1, 0, [self.body])]

    def shift_and_reported_line(self, line: int) -> tuple[int, int]:
        """Return for a line of the present routine its row of the trace minus the line, and the line to report.

        :param line: a line that will be recorded next, or after lines up to it.
        :returns: the line to report is the line itself; in routines of other files it is that of their call in the
            main `.src`.
        """
        open_routine = self._open_routines[-1]
        next_row = self.row_count + 1  # that of line `next_line`
        return next_row - open_routine.next_line, open_routine.reported_line or line

    def record_run_lines(self, line: int) -> None:
        """Record the lines of the present routine up to `line` that are not recorded yet, as lines that run."""
        first_row = self.row_count + 1
        if self._record_up_to(line, is_executed=True):
            self._add_lines_step(first_row)

    def record_passed_lines(self, line: int, *, is_executed: bool = True) -> None:
        """Record the lines of the present routine up to `line` that are not recorded yet, as rows outside of all steps.

        Their statements are not followed again along the trace: they control execution, or do not run.

        :param is_executed: True for lines that control execution; False for lines that do not run.
        """
        self._record_up_to(line, is_executed=is_executed)

    def record_unresolved(self, line: int, cause: ProgramError) -> None:
        """Record the lines of a control structure, up to its last line `line`, that is left uncorrected.

        :param cause: why the branch taken is not known before run time.
        """
        first_row = self.row_count + 1
        self._record_up_to(line, is_executed=True)
        self._steps.append(UnresolvedStructure(first_row, self.row_count, cause))
        self.may_call_originals = True
        self.is_final = False

    def record_division(self, step: Fork | Branch | Join) -> None:
        """Record a fork, the begin of a branch or a join after the last recorded row; `step.row` is filled in."""
        self._steps.append(replace(step, row=self.row_count))
        self.is_final = False

    def state(self) -> RecorderState:
        """Return the present state of the recorder, for `return_to`."""
        return RecorderState(
            row_count=self.row_count,
            range_count=len(self._line_ranges),
            step_count=len(self._steps),
            assignment_count=len(self._counter_values),
            inlined_count=len(self._inlined),
            file_count=len(self._files),
            last_step=self._steps[-1] if self._steps else None,
            open_routines=[
                (routine.next_line, len(routine.bodies), [len(body.loops_and_calls) for body in routine.bodies])
                for routine in self._open_routines
            ],
        )

    def return_to(self, state: RecorderState) -> None:
        """Drop everything recorded since an earlier `state`; `is_final` stays False from then on."""
        self.is_final = False
        self.row_count = state.row_count
        for routine in list(self._inlined)[state.inlined_count :]:
            del self._inlined[routine]
        for document in list(self._files)[state.file_count :]:
            del self._files[document]
        del (
            self._line_ranges[state.range_count :],
            self._steps[state.step_count :],
            self._counter_values[state.assignment_count :],
        )
        if state.last_step is not None:  # later rows may have extended it
            self._steps[-1] = state.last_step
        del self._open_routines[len(state.open_routines) :]
        for open_routine, (next_line, body_count, structure_counts) in zip(
            self._open_routines, state.open_routines, strict=True
        ):
            open_routine.next_line = next_line
            del open_routine.bodies[body_count:]
            for body, structure_count in zip(open_routine.bodies, structure_counts, strict=True):
                del body.loops_and_calls[structure_count:]

    def enter_routine(self, place: Place, name_span: tuple[int, int], module: Module, routine: Routine) -> None:
        """Begin a routine that the present routine calls.

        :param place: the line with the call, which is recorded as the last of the caller.
        :param name_span: span of the name of the called routine in the file of that line.
        """
        caller = self._open_routines[-1]
        self.record_passed_lines(place.line)
        self._steps.append(RoutineEntry(self.row_count, module, routine))
        body = Body(self.row_count + 1)
        caller.bodies[-1].loops_and_calls.append(InlinedRoutine(self.row_count, name_span, routine, body))
        is_in_main_file = routine.source is self.main.source
        reported_line = 0 if is_in_main_file else caller.reported_line or place.line
        self._open_routines.append(_OpenRoutine(routine.source, routine.first + 1, reported_line, [body]))
        self._inlined[routine] = None
        if not is_in_main_file:
            self._files |= {file.document: None for file in (module.source, module.data) if file is not None}

    def leave_routine(self) -> None:
        """End the routine that was entered last."""
        body = self._open_routines.pop().bodies[0]  # the bodies of its loops have ended
        body.stop = self.row_count + 1
        self._steps.append(RoutineExit())

    def begin_loop(self, block: Block, counter: str, step: int, *, has_exit: bool, closing: int = 0) -> UnrolledLoop:
        """Begin to unroll a loop, and return its record.

        :param counter: counter of FOR, as it is spelled; empty for other loops.
        :param step: step of FOR; 0 for other loops.
        :param has_exit: True if the loop contains EXIT.
        :param closing: first of the lines that close the loop; 0: its last line alone closes it.
        """
        self.record_run_lines(block.first - 1)
        source = self._open_routines[-1].source
        loop = UnrolledLoop(
            opener=source.lines_text(block.first, block.first),
            closer=source.lines_text(closing or block.last, block.last),
            counter=counter,
            step=step,
            has_exit=has_exit,
            first=self.row_count + 1,
        )
        self._open_routines[-1].bodies[-1].loops_and_calls.append(loop)
        return loop

    def begin_round(self, loop: UnrolledLoop, block: Block, number: int | None) -> None:
        """Begin an iteration of a loop: a new innermost body, recorded from the line behind the head of the loop on.

        FOR: a row that sets the counter precedes these lines.

        :param loop: the record of the loop, which gets the new body.
        :param block: the loop in its file.
        :param number: value of the counter of FOR in this iteration; None for other loops.
        """
        body = Body(self.row_count + 1)
        loop.bodies.append(body)
        self._open_routines[-1].bodies.append(body)
        self._record_assignment(block, number)
        self._open_routines[-1].next_line = block.first + 1

    def record_plain_rounds(self, loop: UnrolledLoop, block: Block, rounds: PlainRounds) -> None:
        """Record at once all rounds of a FOR that differ only in the value of its counter.

        :param loop: the record of the loop, which gets the bodies of the rounds.
        :param block: the FOR in its file.
        :param rounds: number and rows of the rounds; they begin with the next row.
        """
        routine = self._open_routines[-1]
        body_lines = _LineRange(
            self._file_number(routine.source), block.first + 1, block.last - 1, routine.reported_line, is_executed=True
        )
        self._line_ranges += [self._assignment_range(block), body_lines] * rounds.count
        starts = range(rounds.first, rounds.stop_row, rounds.length)
        loop.bodies += [Body(start, start + rounds.length) for start in starts]
        loop.plain_rounds = rounds
        self.row_count = rounds.stop_row - 1
        self.is_final = False
        self._add_lines_step(rounds.first)

    def end_round(self, block: Block, *, is_whole: bool) -> None:
        """End the innermost iteration of a loop.

        :param block: the loop in its file.
        :param is_whole: False if EXIT, RETURN or GOTO has ended it before its last line.
        """
        if is_whole:
            self.record_run_lines(block.last - 1)
        self.record_passed_lines(block.last - 1, is_executed=False)
        self._open_routines[-1].bodies.pop().stop = self.row_count + 1

    def end_loop(self, loop: UnrolledLoop, block: Block, number: int | None) -> None:
        """End a loop; recording continues behind its last line.

        :param loop: the record of the loop.
        :param block: the loop in its file.
        :param number: value of the counter of FOR after the loop; None if the loop was left early, and for other loops.
        """
        if not loop.bodies:  # no round has run
            self.record_passed_lines(block.last, is_executed=False)
        self._record_assignment(block, number)
        self._open_routines[-1].next_line = block.last + 1
        loop.stop = self.row_count + 1

    def execution(self, unfollowed_routines: Set[Routine]) -> Execution:
        """Return the complete trace.

        The other lines of the main file are added as rows that do not run, but for inlined routines behind the main
        routine, whose lines are in the trace already.

        :param unfollowed_routines: routines reached by calls that are not followed: if they are inlined too, their text
            must stay unchanged. If code is left uncorrected (`may_call_originals`), all inlined routines must.
        """
        main = self.main
        self.body.stop = self.row_count + 1
        next_line = main.last
        for routine in sorted(self._inlined, key=lambda routine: routine.first):
            # those before the main routine are among the rows that precede it
            if routine.source is main.source and routine.first > main.last:
                self._record_lines(main.source, next_line, routine.first - 1, 0, is_executed=False)
                next_line = routine.last + 1
        self._record_lines(main.source, next_line, len(main.source.starts), 0, is_executed=False)
        columns = np.array(self._line_ranges, dtype=np.int64).T  # one for each field of `_LineRange`
        _, first_lines, last_lines, *_ = columns
        lengths = last_lines - first_lines + 1
        file, first, _, reported_line, is_executed, for_line = (np.repeat(values, lengths) for values in columns)
        # rows of a range are consecutive lines; 0 in `for_line` or `reported_line`: the line of the row itself
        line = np.where(for_line > 0, for_line, first + ragged_range(lengths))
        reported_lines = np.where(reported_line > 0, reported_line, line)
        return Execution(
            main=main,
            trace=Trace(tuple(self._sources), file, line, reported_lines, for_line > 0),
            steps=tuple(self._steps),
            body=self.body,
            may_run=is_executed.astype(np.bool_),
            inlined_routines=frozenset(self._inlined),
            unchanged_routines=frozenset(
                self._inlined if self.may_call_originals else self._inlined.keys() & unfollowed_routines
            ),
            files=tuple(self._files),
            counter_of_row=dict(self._counter_values),
        )

    def _record_up_to(self, line: int, *, is_executed: bool) -> bool:
        """Record the lines of the present routine up to `line` that are not recorded yet, without a step.

        :param is_executed: True if the lines run.
        :returns: False if there are no such lines.
        """
        open_routine = self._open_routines[-1]
        if line < open_routine.next_line:
            return False
        self._record_lines(
            open_routine.source, open_routine.next_line, line, open_routine.reported_line, is_executed=is_executed
        )
        open_routine.next_line = line + 1
        return True

    def _record_lines(self, source: Source, first: int, last: int, reported_line: int, *, is_executed: bool) -> None:
        """Add the lines first … last of a file to the trace, one row for each; nothing if last < first.

        :param source: the file.
        :param reported_line: line of the `.src` to report for all these lines; 0: each line itself.
        :param is_executed: True if the lines run.
        """
        if last < first:
            return
        self._line_ranges.append(_LineRange(self._file_number(source), first, last, reported_line, is_executed))
        self.row_count += last - first + 1

    def _file_number(self, source: Source) -> int:
        """Return the index of a file in the files of the trace; a new file is added."""
        return self._sources.setdefault(source, len(self._sources))

    def _record_assignment(self, block: Block, number: int | None) -> None:
        """Record a row that sets the counter of a FOR to a number, as a row that runs.

        :param block: the loop in its file.
        :param number: value of the counter; None, for other loops: nothing is recorded.
        """
        if number is None:
            return
        self._line_ranges.append(self._assignment_range(block))
        self.row_count += 1
        self._counter_values.append((self.row_count, number))
        self._add_lines_step(self.row_count)

    def _assignment_range(self, block: Block) -> _LineRange:
        """Return the row that sets the counter of a FOR of the present routine: its line is that of the FOR."""
        routine = self._open_routines[-1]
        number = self._file_number(routine.source)
        return _LineRange(number, 1, 1, routine.reported_line, is_executed=True, for_line=block.first)  # 1 … 1: one row

    def _add_lines_step(self, first_row: int) -> None:
        """Add the rows from `first_row` on as a step: to `Lines` that end directly before, or as new `Lines`."""
        last_step = self._steps[-1] if self._steps else None
        if isinstance(last_step, Lines) and last_step.last == first_row - 1:
            self._steps[-1] = Lines(last_step.first, self.row_count)
        else:
            self._steps.append(Lines(first_row, self.row_count))
