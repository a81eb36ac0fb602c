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
from postproc.dialects.krl.read.known import InexactError, inexact_error
from postproc.dialects.krl.read.run import Run


def undecided_error(run: Run, place: Place, bounds: Sequence[Value] = ()) -> InexactError:
    """Return the error for the condition of a statement, or the bounds of a FOR, that are not known before run time.

    :param bounds: those bounds that may be unknown; empty: all values of the statement.
    """
    stmt = statement(place.source, place.line)
    values = bounds or stmt.values
    reason = why_not_decided(run.variables, place.source, values)
    names = without_value(run.variables, place.source, values)
    value_advice = f" Or say in [krl.values] of the cell what {', '.join(names)} will be." if names else ""
    subject = "bounds are" if stmt.word == "FOR" else "condition is"
    problem = f"motion inside {stmt.word}: its {subject} not known before the program runs{reason}"
    return inexact_error(place, problem, LOOP_ADVICE + value_advice)


class Counter:
    """The counter of a FOR loop.

    :ivar name: as it is spelled.
    :ivar key: its stored name, see `Variables.key_of`.
    :ivar last: present last value; `step` the present step.
    """

    def __init__(self, run: Run, source: Source, line: int) -> None:
        """Evaluate the bounds of the FOR on a line of a file, and set the counter to its first value.

        :raises InexactError: its bounds are not known before run time, or it is a REAL.
        :raises ProgramError: the statement cannot be read, or the step is no whole number other than 0.
        """
        self.run, self.place = run, Place(source, line)
        stmt = statement(source, line)
        if isinstance(stmt, tree.For) and stmt.error is not None:
            raise stmt.error
        if not isinstance(stmt, tree.For) or stmt.counter is None or stmt.bounds is None:
            raise undecided_error(run, self.place)
        self.statement = stmt
        self.name = source.text[stmt.counter.start : stmt.counter.stop]
        key = run.variables.key_of(stmt.counter)
        if key is None:
            raise undecided_error(run, self.place, [stmt.counter])
        if run.variables.type_of(stmt.counter) == "REAL":
            problem = f"motion inside FOR: its counter {self.name} is a REAL"
            raise inexact_error(self.place, problem, "Count by an INT, and compute the REAL from it in the loop.")
        self.key, self.bound_values = key, stmt.bounds
        self._are_numbers = all(isinstance(bound, Number) for bound in stmt.bounds[1:] if bound is not None)
        run.place = self.place
        self.last, self.step = self._bounds()
        self._set(self._integer(self.bound_values[0]))
        self.value()

    @property
    def rounds(self) -> int:
        """Number of iterations from now on.

        :raises InexactError: the counter is not known.
        """
        return max(0, (self.last - self.value()) // self.step + 1)

    def has_next_round(self) -> bool:
        """Return whether the loop runs another round: the counter has not passed the last value.

        :raises InexactError: the counter is not known.
        """
        count = self.value()
        return count <= self.last if self.step > 0 else count >= self.last

    def advance(self) -> None:
        """Advance the counter by one step.

        :raises InexactError: the bounds or the step have changed.
        """
        self.run.place = self.place
        if not self._are_numbers and self._bounds() != (self.last, self.step):
            raise inexact_error(self.place, "motion inside FOR: its end changes while it runs", LOOP_ADVICE)
        self._set(self.value() + self.step)

    def skip_rounds(self, rounds: int) -> None:
        """Advance the counter by the steps of some rounds, whose statements leave the bounds unchanged."""
        self._set(self.value() + rounds * self.step)

    def _bounds(self) -> tuple[int, int]:
        """Return the present last value and step of the FOR.

        :raises InexactError: they are not known before run time, or are REALs.
        :raises ProgramError: the step is no whole number other than 0.
        """
        first, last, step_value = self.bound_values
        bounds = [first, last, *([] if step_value is None else [step_value])]
        if not all(map(self.run.variables.functions.is_pure, calls(bounds))):
            raise self._unknown_bounds_error()
        step = 1 if step_value is None else self._step(step_value)
        return self._integer(last), step

    def _step(self, step_value: Value) -> int:
        """Return the value of a step.

        :raises ProgramError: it is 0, or no whole number.
        :raises InexactError: it is not known before run time.
        """
        step = self.run.variables.evaluate(step_value)
        if isinstance(step, Number) and (not step.is_integer or step.value == 0.0):
            problem = f"FOR cannot count by STEP {step.value:g}"
            raise self.place.error(problem, "Give a whole number other than 0, as it is or by an INT.")
        return self._integer(step_value)

    def _integer(self, value: Value) -> int:
        """Return the value of a bound or a step as an integer.

        :raises InexactError: it is a REAL, or not known before run time.
        """
        number = self.run.variables.evaluate(value)
        if not isinstance(number, Number):
            raise self._unknown_bounds_error()
        if not number.is_integer:
            problem = f"motion inside FOR: one of its bounds is a REAL, {number.value:g}"
            raise inexact_error(self.place, problem, "Give whole numbers, as they are or by an INT.")
        return int(number.value)

    def _set(self, number: int) -> None:
        """Give the counter a value."""
        self.run.variables.set(self.key, Number(float(number), 0, 0, True), self.place)

    def value(self) -> int:
        """Return the present value of the counter.

        :raises InexactError: it is not known.
        """
        value = self.run.variables.value(self.key)
        if not isinstance(value, Number) or not value.is_integer:
            raise self._unknown_bounds_error()
        return int(value.value)

    def _unknown_bounds_error(self) -> InexactError:
        """Return the error that the bounds are not known before run time."""
        return undecided_error(self.run, self.place, [bound for bound in self.bound_values if bound is not None])
