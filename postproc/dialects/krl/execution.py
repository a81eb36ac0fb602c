"""Execution of a program: its lines in execution order, with loops unrolled, called routines inlined, and branches.

These lines are the rows of the trace (`Trace`), from 1. Reading and correction treat them as a straight program;
`write.folding` maps them back to the files.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field

from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.trace import Trace
from postproc.errors import ProgramError
from postproc.frames import Array
from postproc.program import Bools, Document, Ints


class Lines(Struct, frozen=True):
    """Rows first … last of the trace, which run one after the other."""

    first: int
    last: int


class UnresolvedStructure(Struct, frozen=True):
    """A control structure on rows first … last of the trace whose branch taken is not known before run time.

    :ivar reason: why it is not known, as the error that is raised if a motion depends on it.
    """

    first: int
    last: int
    reason: ProgramError


class ForkVisit(NamedTuple):
    """One visit of the execution trace to a fork, which it may reach several times, in loops and by calls.

    :ivar place: file and line of the IF or SWITCH.
    :ivar enclosing: places of enclosing loops and calls, outermost first, each with the number of its iteration, from
        1; 0 for a call.
    """

    place: Place
    enclosing: tuple[tuple[Place, int], ...]


class Fork(Struct, frozen=True):
    """A row behind which the program divides into branches; the branch taken is not known before run time."""

    row: int
    visit: ForkVisit


class Branch(Struct, frozen=True):
    """One of the branches of the last `Fork` begins after this row."""

    row: int


class Join(Struct, frozen=True):
    """Control-flow join: branches end at this row.

    :ivar is_exhaustive: True if one of the branches always runs, as with ELSE or DEFAULT.
    """

    row: int
    is_exhaustive: bool


class RoutineEntry(Struct, frozen=True):
    """The call on a row of the trace: the steps up to its `RoutineExit` run in the routine."""

    row: int
    module: Module
    routine: Routine


class RoutineExit(Struct, frozen=True):
    """The end of the routine that was entered last."""


Step = Lines | UnresolvedStructure | Fork | Branch | Join | RoutineEntry | RoutineExit


class Body(Struct, eq=False):
    """The rows of one round of a loop, or of one run of a routine: rows first … stop − 1 of the trace.

    Apart from `loops_and_calls`, they are contiguous lines of a file.

    :ivar loops_and_calls: unrolled loops and inlined routines in these rows, in order.
    """

    first: int
    stop: int = 0
    loops_and_calls: list[UnrolledLoop | InlinedRoutine] = []


class PlainBody(Struct, frozen=True, eq=False):
    """Statements, by their lines in the file, of a FOR that does nothing but move, set values and switch outputs.

    :ivar motions: motions to points of arrays.
    :ivar settings: ``$VEL.CP=V[I]``, ``$APO.CDIS=D[I+1]``.
    :ivar triggers: TRIGGER that switches an output.
    :ivar assignments: to variables that the round sets before it uses them.
    :ivar is_computed: the points are computed from the counter, see `computed_rounds`.
    """

    motions: tuple[int, ...]
    settings: tuple[int, ...]
    triggers: tuple[int, ...]
    assignments: tuple[int, ...] = ()
    is_computed: bool = False


class PlainRounds(Struct, frozen=True, eq=False):
    """The rounds of a FOR with a plain body: they differ in the number of the counter only.

    :ivar begin: value of the counter in the first round.
    :ivar step: increment of the counter in each round.
    :ivar first: row of the trace on which the first round begins, with the assignment to the counter.
    :ivar count: number of rounds.
    :ivar length: number of rows of each round.
    :ivar source: file of the loop.
    :ivar head: line of FOR in this file.
    :ivar body: the lines of its statements.
    """

    begin: int
    step: int
    first: int
    count: int
    length: int
    source: Source
    head: int
    body: PlainBody

    @property
    def stop_row(self) -> int:
        """Row of the trace behind the last round."""
        return self.first + self.count * self.length

    def counter_value(self, row: int) -> int | None:
        """Return the value that a row of the trace assigns to the counter; None for rows without an assignment."""
        round_number, row_in_round = divmod(row - self.first, self.length)
        # the first row of each round is the assignment, in place of the line of FOR
        return self.begin + round_number * self.step if row_in_round == 0 else None

    def rows_of_statement(self, statement: int) -> Ints:
        """Return the rows of the trace (count,) at which the rounds run a statement of the body.

        :param statement: line of that statement in its file.
        """
        # each round is the row that sets the counter, in place of the line of FOR, and the lines of the body
        return np.asarray(self.first + statement - self.head + self.length * np.arange(self.count))

    def indices(self, offset: int) -> range:
        """Return the indices of the array elements that the rounds use: counter plus an offset, 1 for ``P[I+1]``."""
        begin = self.begin + offset
        return range(begin, begin + self.count * self.step, self.step)


class UnrolledLoop(Struct, eq=False):
    """An unrolled loop.

    :ivar opener: text of the first line of the loop, with its line end.
    :ivar closer: text of its last line, or of all lines that jump back to its beginning.
    :ivar counter: name of the counter of a FOR, as it is spelled; empty for other loops.
    :ivar step: increment of the counter of a FOR; each body begins with an assignment to it. 0 for other loops.
    :ivar has_exit: True if it contains EXIT.
    :ivar first: first row of the trace that is in the loop.
    :ivar stop: row of the trace behind the loop.
    :ivar bodies: one per iteration; empty if the loop does not run.
    :ivar plain_rounds: the rounds of a FOR with a plain body; None for other loops.
    :ivar is_endless: True for LOOP without EXIT: its only body is one iteration, which ends in the state in which it
        began.
    """

    opener: str
    closer: str
    counter: str
    step: int
    has_exit: bool
    first: int
    stop: int = 0
    bodies: list[Body] = []
    plain_rounds: PlainRounds | None = None
    is_endless: bool = False

    @property
    def is_for(self) -> bool:
        """Whether the loop is a FOR; WHILE, REPEAT and LOOP have no counter."""
        return self.step != 0


class InlinedRoutine(Struct, eq=False):
    """An inlined routine.

    :ivar row: row of the trace with the call.
    :ivar name: span of the routine's name in the call, in the file of the call.
    """

    row: int
    name: tuple[int, int]
    routine: Routine
    body: Body


class BranchError(ProgramError):
    """Branches cannot be corrected.

    :ivar fork_visits: the forks whose branches cannot be corrected; in a loop, each iteration visits a fork anew.
    """

    fork_visits: frozenset[ForkVisit]


class Execution(Struct, frozen=True, eq=False):
    """The order in which the lines of a program run, with loops unrolled and called routines inlined.

    :param main: the main routine.
    :param trace: the L lines in this order; the lines of the `.src` itself if nothing is unrolled or inlined.
    :param steps: runs of consecutive rows, branches, and entries and exits of routines, in execution order.
    :param body: the rows of the main routine.
    :param may_run: (L,) False for lines that do not run: branches that are not taken; None: all may run.
    :param inlined_routines: routines whose calls are followed.
    :param unchanged_routines: inlined routines that are also reached by a call that is not followed: their text must
        not change.
    :param files: other source and data files of the inlined routines.
    :param used_names: names, upper case, of programs and GLOBAL routines of all folders, if new names are needed.
    :param counter_of_row: row with an assignment to the counter of a FOR → its value; without the rows of plain rounds.
    :param other_callers: file of an inlined routine → other programs of the folders that name the routine.
    """

    main: Routine
    trace: Trace
    steps: tuple[Step, ...]
    body: Body
    may_run: Bools | None = None
    inlined_routines: frozenset[Routine] = frozenset()
    unchanged_routines: frozenset[Routine] = frozenset()
    files: tuple[Document, ...] = ()
    used_names: frozenset[str] = frozenset()
    other_callers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    counter_of_row: Mapping[int, int] = field(default_factory=dict)

    @property
    def endless_loop(self) -> UnrolledLoop | None:
        """The LOOP without EXIT at the end of the program; None if there is none."""
        # nothing runs behind it: it can only be the last
        last_structure = self.body.loops_and_calls[-1] if self.body.loops_and_calls else None
        return last_structure if isinstance(last_structure, UnrolledLoop) and last_structure.is_endless else None

    @property
    def endless_loop_line(self) -> int:
        """Line in the `.src` of the LOOP without EXIT: the line before its body; 0 if there is none."""
        return 0 if self.endless_loop is None else self.trace.place(self.endless_loop.first).line - 1

    def endless_loop_error(self, problem: str, advice: str) -> ProgramError:
        """Return the error that the LOOP without EXIT cannot be corrected, at its line."""
        return self.main.source.line_error(f"LOOP never ends, and {problem}", self.endless_loop_line, advice)

    def branch_error(self, problem: str, row: int, fork_rows: Collection[int], advice: str) -> BranchError:
        """Return the error that the branches of some forks cannot be corrected.

        A fork is a row behind which the program divides into branches.

        :param row: row of the trace (line in execution order) that the error names; `fork_rows`: rows of these forks.
        """
        base = self.trace.error(problem, row, advice)
        error = BranchError(base.problem, file=base.file, line=base.line, text=base.text, advice=base.advice)
        error.fork_visits = frozenset(
            step.visit for step in self.steps if isinstance(step, Fork) and step.row in fork_rows
        )
        return error

    def counter_value(self, loop: UnrolledLoop, row: int) -> int:
        """Return the value that a row of the trace (a line in execution order) assigns to the counter of a FOR.

        :raises KeyError: the row does not assign it.
        """
        rounds = loop.plain_rounds
        # plain rounds compute it; the assignment behind the last round, and other loops, are in `counter_of_row`
        value = rounds.counter_value(row) if rounds is not None and row < rounds.stop_row else None
        return self.counter_of_row[row] if value is None else value

    def counter_values(self) -> Array:
        """Return the values (L,) that the L rows of the trace assign to the counter of a FOR; NaN for other rows.

        The trace: the lines of the program in execution order, with loops unrolled and called routines inlined.
        """
        counter = np.full(len(self.trace), np.nan)
        rows = np.array([*self.counter_of_row], dtype=np.int64)
        counter[rows - 1] = [*self.counter_of_row.values()]  # rows count from 1
        for rounds in self.plain_rounds():
            first_rows = slice(rounds.first - 1, rounds.stop_row - 1, rounds.length)  # of each round; rows count from 1
            counter[first_rows] = rounds.begin + np.arange(rounds.count) * rounds.step
        return counter

    def rows_of(self, source: Source, lines: Ints) -> tuple[Ints, Ints]:
        """Return the rows of the trace on which some lines of a file run.

        The trace: the lines of the program in execution order, with loops unrolled and called routines inlined.

        :param lines: (n,) lines of the file, from 1.
        :returns: rows (m,), from 1, ascending, and the index in `lines` (m,) of the line that each runs. A line that
            runs twice has two rows.
        """
        trace = self.trace
        if trace.is_file:  # rows are lines
            return lines, np.arange(len(lines))
        index_of_line = np.full(len(source.starts) + 1, -1, dtype=np.int64)
        index_of_line[lines] = np.arange(len(lines))  # −1: not among the lines
        rows = np.flatnonzero((trace.file == trace.sources.index(source)) & ~trace.is_counter_row)
        rows = rows[index_of_line[trace.line[rows]] >= 0]
        return rows + 1, index_of_line[trace.line[rows]]

    def plain_rounds(self) -> list[PlainRounds]:
        """Return the rounds of all loops with a plain body, in execution order."""
        return list(_plain_rounds(self.body))

    @property
    def is_straight(self) -> bool:
        """Whether the trace is the `.src` itself: nothing is unrolled or inlined."""
        return self.trace.is_file


def _plain_rounds(body: Body) -> Iterator[PlainRounds]:
    """Yield the plain rounds in a body, also in inlined routines and in nested loops, in execution order."""
    for structure in body.loops_and_calls:
        if isinstance(structure, InlinedRoutine):
            yield from _plain_rounds(structure.body)
        elif structure.plain_rounds is not None:
            yield structure.plain_rounds  # there is no loop and no call in plain rounds
        else:
            for round_body in structure.bodies:
                yield from _plain_rounds(round_body)
