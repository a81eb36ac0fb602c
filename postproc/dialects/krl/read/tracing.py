"""Records the execution trace, line by line, while a program is followed."""

from __future__ import annotations

from collections.abc import Set
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import ragged_range
from postproc.dialects.krl.course import (
    Body,
    Branch,
    Course,
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

    :ivar cursor: its first line that is not recorded yet.
    :ivar shown_line: line of the `.src` to report for its lines; 0 if that is their own.
    """

    source: Source
    cursor: int
    shown_line: int
    bodies: list[Body] = []


class Recorder:
    """The execution trace of a program so far.

    :param main: the main routine.
    :ivar pinned: True if routines may also be called unchanged.
    :ivar is_final: False after something was dropped, is kept, or forks: rows and what ran differ then.
    """

    def __init__(self, main: Routine) -> None:
        self.main = main
        self.count = 0
        self.pinned = False
        self.is_final = True
        self._sources: dict[Source, int] = {main.source: 0}
        self._from: list[tuple[int, int, int, int, int, bool]] = []
        self._steps: list[Step] = []
        self._counts: list[tuple[int, int]] = []
        self._inlined: dict[Routine, None] = {}
        self._files: dict[Document, None] = {}
        self._put(main.source, 1, main.first, 0, live=False)
        self.body = Body(self.count + 1)
        self._open = [_OpenRoutine(main.source, main.first + 1, 0, [self.body])]

    def present(self, line: int) -> tuple[int, int]:
        """Return what the row of a line of the present routine has in addition to the line, and the line of the `.src`
        to report for it.
        """
        open_routine = self._open[-1]
        return self.count + 1 - open_routine.cursor, open_routine.shown_line or line

    def run_to(self, line: int) -> None:
        """Record lines that run, up to a line of the routine."""
        first = self.count + 1
        if self._next(line, live=True):
            self._run_on(first)

    def pass_to(self, line: int, *, live: bool = True) -> None:
        """Record lines of control statements, up to a line of the routine; if not `live`, lines that do not run."""
        self._next(line, live=live)

    def keep(self, line: int, cause: ProgramError) -> None:
        """Record lines up to a line whose branch taken is not known before run time."""
        first = self.count + 1
        self._next(line, live=True)
        self._steps.append(UnresolvedStructure(first, self.count, cause))
        self.pinned = True
        self.is_final = False

    def divide(self, step: Fork | Branch | Join) -> None:
        """Record a fork, the begin of a branch or a join after the recorded lines."""
        self._steps.append(replace(step, row=self.count))
        self.is_final = False

    def mark(self) -> tuple[Any, ...]:
        """Return the present length of the trace, for `back_to`."""
        open_ = [(s.cursor, len(s.bodies), [len(body.parts) for body in s.bodies]) for s in self._open]
        last = self._steps[-1] if self._steps else None
        lengths = len(self._from), len(self._steps), len(self._counts), len(self._inlined), len(self._files)
        return self.count, lengths, last, open_

    def back_to(self, mark: tuple[Any, ...]) -> None:
        """Drop everything recorded since."""
        self.is_final = False
        self.count, (pieces, steps, counts, inlined, files), last, open_ = mark
        for routine in list(self._inlined)[inlined:]:
            del self._inlined[routine]
        for document in list(self._files)[files:]:
            del self._files[document]
        del self._from[pieces:], self._steps[steps:], self._open[len(open_) :]
        del self._counts[counts:]
        if steps:
            self._steps[-1] = last
        for open_routine, (cursor, bodies, parts) in zip(self._open, open_, strict=True):
            open_routine.cursor = cursor
            del open_routine.bodies[bodies:]
            for body, count in zip(open_routine.bodies, parts, strict=True):
                del body.parts[count:]

    def enter(self, at: Place, name: tuple[int, int], module: Module, routine: Routine) -> None:
        """Begin a routine that the present line calls.

        :param name: span of its name in the file of that line.
        """
        caller = self._open[-1]
        self.pass_to(at.line)
        self._steps.append(RoutineEntry(self.count, module, routine))
        body = Body(self.count + 1)
        caller.bodies[-1].parts.append(InlinedRoutine(self.count, name, routine, body))
        is_own = routine.source is self.main.source
        shown_line = 0 if is_own else caller.shown_line or at.line
        self._open.append(_OpenRoutine(routine.source, routine.first + 1, shown_line, [body]))
        self._inlined[routine] = None
        if not is_own:
            self._files |= {file.document: None for file in (module.source, module.data) if file is not None}

    def leave(self) -> None:
        """End the routine that was entered last."""
        body = self._open.pop().bodies[0]
        body.last = self.count + 1
        self._steps.append(RoutineExit())

    def begin(self, block: Block, counter: str, step: int, *, left: bool, closing: int = 0) -> UnrolledLoop:
        """Begin to unroll a loop; `counter`, as it is spelled, and `step` of FOR, else empty and 0.

        :param closing: first of the lines that close it; 0: its last line does alone.
        """
        self.run_to(block.first - 1)
        source = self._open[-1].source
        opening_text = _lines(source, block.first, block.first)
        closing_text = _lines(source, closing or block.last, block.last)
        loop = UnrolledLoop(opening_text, closing_text, counter, step, left, self.count + 1)
        self._open[-1].bodies[-1].parts.append(loop)
        return loop

    def repeat(self, loop: UnrolledLoop, block: Block, number: int | None) -> None:
        """Begin an iteration of a loop.

        :param number: of the counter of FOR; None for other loops.
        """
        body = Body(self.count + 1)
        loop.bodies.append(body)
        self._open[-1].bodies.append(body)
        self._assign(block, number)
        self._open[-1].cursor = block.first + 1

    def plain_rounds(self, loop: UnrolledLoop, block: Block, rounds: PlainRounds) -> None:
        """Record rounds that differ in the number of the counter only."""
        open_routine = self._open[-1]
        first, last = block.first + 1, block.last - 1
        source = self._sources.setdefault(open_routine.source, len(self._sources))
        round_origin = (
            (source, 1, 1, open_routine.shown_line, block.first, True),
            (source, first, last, open_routine.shown_line, 0, True),
        )
        self._from += round_origin * rounds.count
        starts = range(rounds.first, rounds.beyond, rounds.length)
        loop.bodies += [Body(start, start + rounds.length) for start in starts]
        loop.plain = rounds
        self.count = rounds.beyond - 1
        self.is_final = False
        self._run_on(rounds.first)

    def repeated(self, block: Block, *, whole: bool) -> None:
        """End an iteration of a loop; if not `whole`, the loop was left."""
        if whole:
            self.run_to(block.last - 1)
        self.pass_to(block.last - 1, live=False)
        self._open[-1].bodies.pop().last = self.count + 1

    def end(self, loop: UnrolledLoop, block: Block, number: int | None) -> None:
        """End a loop.

        :param number: that the counter of FOR has then; None if the loop is left, and for other loops.
        """
        if not loop.bodies:
            self.pass_to(block.last, live=False)
        self._assign(block, number)
        self._open[-1].cursor = block.last + 1
        loop.last = self.count + 1

    def course(self, callees: Set[Routine]) -> Course:
        """Return the complete trace.

        :param callees: routines reached by calls that are not followed.
        """
        main = self.main
        self.body.last = self.count + 1
        line = main.last
        for routine in sorted(self._inlined, key=lambda routine: routine.first):
            if routine.source is main.source and routine.first > main.last:
                self._put(main.source, line, routine.first - 1, 0, live=False)
                line = routine.last + 1
        self._put(main.source, line, len(main.source.starts), 0, live=False)
        lengths = np.array([last - first + 1 for _, first, last, *_ in self._from])
        column = np.array(self._from, dtype=np.int64)
        run = ragged_range(lengths)
        source, first, _, shown_line, fixed_line, live = (np.repeat(values, lengths) for values in column.T)
        origin = np.where(fixed_line > 0, fixed_line, first + run)
        shown = np.where(shown_line > 0, shown_line, origin)
        return Course(
            main,
            Trace(tuple(self._sources), source, origin, shown, fixed_line > 0),
            tuple(self._steps),
            self.body,
            live.astype(np.bool_),
            frozenset(self._inlined),
            frozenset(self._inlined if self.pinned else self._inlined.keys() & callees),
            tuple(self._files),
            counts=dict(self._counts),
        )

    def _next(self, line: int, *, live: bool) -> bool:
        """Record the lines up to one; return whether there are any."""
        open_routine = self._open[-1]
        if line < open_routine.cursor:
            return False
        self._put(open_routine.source, open_routine.cursor, line, open_routine.shown_line, live=live)
        open_routine.cursor = line + 1
        return True

    def _put(self, source: Source, first: int, last: int, shown_line: int, *, live: bool) -> None:
        """Record lines first … last of a file; `live` says whether they run."""
        if last < first:
            return
        self._from.append((self._sources.setdefault(source, len(self._sources)), first, last, shown_line, 0, live))
        self.count += last - first + 1

    def _assign(self, block: Block, number: int | None) -> None:
        """Record the assignment of a number to the counter of a FOR; None: another loop, which has no counter."""
        if number is None:
            return
        open_routine = self._open[-1]
        source = self._sources.setdefault(open_routine.source, len(self._sources))
        self._from.append((source, 1, 1, open_routine.shown_line, block.first, True))
        self.count += 1
        self._counts.append((self.count, number))
        self._run_on(self.count)

    def _run_on(self, first: int) -> None:
        """Record that lines from `first` on run, in one step with those directly before them."""
        last_step = self._steps[-1] if self._steps else None
        if isinstance(last_step, Lines) and last_step.last == first - 1:
            self._steps[-1] = Lines(last_step.first, self.count)
        else:
            self._steps.append(Lines(first, self.count))


def _lines(source: Source, first: int, last: int) -> str:
    start = int(source.starts[first - 1])
    return source.text[start : int(source.starts[last]) if last < len(source.starts) else len(source.text)]
