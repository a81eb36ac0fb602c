"""The counter of a FOR whose rounds are followed."""

from __future__ import annotations

from collections.abc import Sequence

from postproc.dialects.krl.language import tree
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.values import Number, Value
from postproc.dialects.krl.read.explanations import why_not_decided, without_value
from postproc.dialects.krl.read.interpreter import LOOP_ADVICE
from postproc.dialects.krl.read.known import InexactError, inexact
from postproc.dialects.krl.read.run import Run


def undecided_error(run: Run, at: Place, bounds: Sequence[Value] = ()) -> InexactError:
    """Return the error for a condition, or for the bounds of a FOR, that are not known before run time.

    :param bounds: those of the FOR; empty: all values of the statement count.
    """
    stmt = statement(at.source, at.line)
    values = bounds or stmt.values
    reason = why_not_decided(run.variables, at.source, values)
    names = without_value(run.variables, at.source, values)
    value_advice = f" Or say in [krl.values] of the cell what {', '.join(names)} will be." if names else ""
    subject = "bounds are" if stmt.word == "FOR" else "condition is"
    problem = f"motion inside {stmt.word}: its {subject} not known before the program runs{reason}"
    return inexact(at, problem, LOOP_ADVICE + value_advice)


class Counter:
    """The counter of a FOR loop.

    :raises InexactError: its bounds are not known before run time.
    """

    def __init__(self, run: Run, source: Source, line: int) -> None:
        self.run, self.at = run, Place(source, line)
        stmt = statement(source, line)
        if isinstance(stmt, tree.For) and stmt.error is not None:
            raise stmt.error
        if not isinstance(stmt, tree.For) or stmt.counter is None or stmt.bounds is None:
            raise undecided_error(run, self.at)
        self.here = stmt
        self.name = source.text[stmt.counter.start : stmt.counter.stop]
        key = run.variables.key_of(stmt.counter)
        if key is None:
            raise undecided_error(run, self.at, [stmt.counter])
        if run.variables.kind(stmt.counter) == "REAL":
            problem = f"motion inside FOR: its counter {self.name} is a REAL"
            raise inexact(self.at, problem, "Count by an INT, and compute the REAL from it in the loop.")
        self.key, self.given = key, stmt.bounds
        self._are_numbers = all(isinstance(bound, Number) for bound in stmt.bounds[1:] if bound is not None)
        run.place = self.at
        self.last, self.step = self._bounds()
        self._set(self._whole(self.given[0]))
        self.now()

    @property
    def rounds(self) -> int:
        """Number of iterations from now on."""
        return max(0, (self.last - self.now()) // self.step + 1)

    def within(self) -> bool:
        """Return whether the loop runs another round: its variable has not passed the end value."""
        count = self.now()
        return count <= self.last if self.step > 0 else count >= self.last

    def advance(self) -> None:
        """Advance by one step."""
        self.run.place = self.at
        if not self._are_numbers and self._bounds() != (self.last, self.step):
            raise inexact(self.at, "motion inside FOR: its end changes while it runs", LOOP_ADVICE)
        self._set(self.now() + self.step)

    def pass_over(self, rounds: int) -> None:
        """Advance by the steps of some rounds that leave its bounds as they are."""
        self._set(self.now() + rounds * self.step)

    def _bounds(self) -> tuple[int, int]:
        """Return its present last value and step."""
        first, last, width = self.given
        bounds = [first, last, *([] if width is None else [width])]
        if not all(map(self.run.variables.functions.pure, calls(bounds))):
            raise self._unknown()
        step = 1 if width is None else self._step(width)
        return self._whole(last), step

    def _step(self, width: Value) -> int:
        """Return a step.

        :raises ProgramError: it is zero or not an integer.
        """
        step = self.run.variables.evaluate(width)
        if isinstance(step, Number) and (not step.integer or step.value == 0.0):
            problem = f"FOR cannot count by STEP {step.value:g}"
            raise self.at.error(problem, "Give a whole number other than 0, as it is or by an INT.")
        return self._whole(width)

    def _whole(self, value: Value) -> int:
        """Return the integer that a bound or a step is.

        :raises ProgramError: it is a REAL, or not known before run time.
        """
        number = self.run.variables.evaluate(value)
        if not isinstance(number, Number):
            raise self._unknown()
        if not number.integer:
            problem = f"motion inside FOR: one of its bounds is a REAL, {number.value:g}"
            raise inexact(self.at, problem, "Give whole numbers, as they are or by an INT.")
        return int(number.value)

    def _set(self, number: int) -> None:
        """Give the counter a value."""
        self.run.variables.set(self.key, Number(float(number), 0, 0, True), self.at)

    def now(self) -> int:
        """Return its present value."""
        value = self.run.variables.value(self.key)
        if not isinstance(value, Number) or not value.integer:
            raise self._unknown()
        return int(value.value)

    def _unknown(self) -> InexactError:
        """Return the error that the bounds are not known before run time."""
        return undecided_error(self.run, self.at, [bound for bound in self.given if bound is not None])
