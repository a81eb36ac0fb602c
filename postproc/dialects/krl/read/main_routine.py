"""The motions of a program in the order in which they run, and what is in force when they do."""

from __future__ import annotations

from collections.abc import Sequence

from postproc.dialects.krl.language.names import NAME, fault_of
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.statements import MOTION_WORDS, calls
from postproc.dialects.krl.read.interpreter import LOOP_ADVICE, Interpreter
from postproc.dialects.krl.read.library import Library
from postproc.dialects.krl.read.motion_columns import MotionCollector
from postproc.dialects.krl.read.motion_reader import MotionReader
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.state import FIELDS
from postproc.errors import MOST, ProgramError, together


class MainRoutine:
    """Follows a program through the lines that are not plain motions.

    :ivar run: the program as far as it has run.
    :ivar motions: those of the main routine, in order.
    :ivar still: lines of motions to where the robot is already.
    """

    def __init__(self, library: Library, main: Routine, settings: Settings, reader: MotionReader) -> None:
        self.run = Run(library, main, settings)
        self._interpreter = Interpreter(self.run, self._motion)
        self.reader = reader
        self.motions = MotionCollector()
        self.still: list[int] = []
        self._refused: set[int] = set()

    def follow(self, faults: Sequence[ProgramError]) -> None:
        """Follow the main routine.

        :param faults: what is wrong with the bounds of routines.
        :raises ProgramError: something that changes motion is not understood; all such lines together.
        """
        fault = fault_of(self.run.routine.name)
        if fault:
            raise self.run.source.line_error(
                f"{self.run.routine.name} is not a valid name: {fault}", self.run.routine.first
            )
        for module in self.run.library.submit():
            for routine in module.routines.values():
                effects = self.run.analysis.of(module, routine)
                self.run.may_change(effects.writes | effects.anytime, f"the submit program {module.name}")
        errors = list(faults)
        broken: set[str] = set()
        for line in self.run.routine.lines:
            self.run.line = line
            try:
                self._interpreter.statement(Place(self.run.source, line))
            except ProgramError as cause:
                names = [name.upper() for name in NAME.findall(self.run.source.text, *self.run.source.code_span(line))]
                if broken.isdisjoint(names):
                    errors.append(cause)
                broken.update(name for name in names[:1] if name not in FIELDS and name not in MOTION_WORDS)
                if len(errors) > MOST:
                    break
        if self.run.level.open and not errors:
            word, opened = self.run.level.open[-1]
            errors.append(
                self.run.source.line_error(f"{word} is not closed", opened, "Check that the file is complete.")
            )
        if errors:
            raise together({(error.line, error.problem): error for error in reversed(errors)}.values())
        if self.run.level.returned:
            self.run.blocked.append((self.run.level.returned, self.run.routine.last, "RETURN"))

    def misplaced(self, line: int, opener: str, opened: int) -> ProgramError:
        """Return the error for a motion inside a control structure or behind RETURN."""
        if opener == "RETURN":
            return self.run.source.line_error(f"the motion is never reached: RETURN in line {opened}", line)
        return self.run.source.line_error(f"motion inside {opener} (line {opened})", line, LOOP_ADVICE)

    def only_comments(self, first: int, last: int) -> bool:
        """Return whether the lines first … last hold nothing but comments and other TRIGGERs."""
        for line in range(first, last + 1):
            start, stop = self.run.source.code_span(line)
            if start < stop and line not in self.run.triggers:
                return False
        return True

    def _motion(self, at: Place, word: str, start: int, stop: int) -> None:
        """Take a motion of the main routine.

        :raises ProgramError: it is not understood, not certain, or its target is not known before the program runs.
        """
        level = self.run.level
        opener, opened = level.open[-1] if level.open else ("RETURN", level.returned)
        if opened and not self.reader.stays(at, word, start, stop):
            if opened not in self._refused:
                self._refused.add(opened)
                raise self.misplaced(at.line, opener, opened)
            return
        for call in calls(at.source, start, stop):
            self._interpreter.calls.call(at, call, certain=False)
        move, state, names = self.reader.read(at, word, start, stop)
        self.run.understood.update(names)
        if move is None:
            self.still.append(at.line)
        else:
            self.motions.add(move, state)
