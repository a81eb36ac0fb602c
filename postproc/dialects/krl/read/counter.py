"""The counter of a FOR whose rounds are followed."""

from __future__ import annotations

from collections.abc import Sequence

from postproc.dialects.krl.language import tree
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.values import Number, Value
from postproc.dialects.krl.read.explanations import names_without_value, why_not_decided
from postproc.dialects.krl.read.interpreter import LOOP_ADVICE
from postproc.dialects.krl.read.known import UnknownOrderError, unknown_order_error
from postproc.dialects.krl.read.run import Run


def undecided_error(run: Run, place: Place, bounds: Sequence[Value] = ()) -> UnknownOrderError:
    """Return the error for the condition of a statement, or the bounds of a FOR, that are not known before run time.

    :param place: file and line of the statement.
    :param bounds: the bounds of a FOR that may be unknown; empty: all expressions of the statement.
    """
    stmt = statement(place.source, place.line)
    values = bounds or stmt.values
    reason = why_not_decided(run.variables, place.source, values)
    names = names_without_value(run.variables, place.source, values)
    value_advice = f" Or say in [krl.values] of the cell what {', '.join(names)} will be." if names else ""
    subject = "bounds are" if stmt.word == "FOR" else "condition is"
    problem = f"motion inside {stmt.word}: its {subject} not known before the program runs{reason}"
    return unknown_order_error(place, problem, LOOP_ADVICE + value_advice)


class Counter:
    """The counter of a FOR loop.

    :ivar name: name of the counter as it is spelled.
    :ivar key: stored name of the counter, see `Variables.key_of`.
    :ivar last: last value of the counter that runs a round; `step` the step. Both as evaluated last.
    """

    def __init__(self, run: Run, source: Source, line: int) -> None:
        """Evaluate the bounds of the FOR on a line (from 1) of a file, and set the counter to its first value.

        :raises UnknownOrderError: the bounds are not known before run time, the counter is a REAL, or may change at any
            time.
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
            raise unknown_order_error(self.place, problem, "Count by an INT, and compute the REAL from it in the loop.")
        self.key, self.bound_values = key, stmt.bounds
        self._has_constant_bounds = all(isinstance(bound, Number) for bound in stmt.bounds[1:] if bound is not None)
        run.statement_place = self.place  # functions in the bounds are called from here
        self.last, self.step = self._bounds()
        self._set_value(self._whole_number(self.bound_values[0]))
        self.value()  # raises the error if the counter may change at any time

    @property
    def round_count(self) -> int:
        """Number of rounds from now on, the present one included.

        :raises UnknownOrderError: the counter is not known.
        """
        return max(0, (self.last - self.value()) // self.step + 1)

    def has_next_round(self) -> bool:
        """Return whether the counter has not passed its last value, so that the loop runs a round with it.

        :raises UnknownOrderError: the counter is not known.
        """
        count = self.value()
        return count <= self.last if self.step > 0 else count >= self.last

    def advance(self) -> None:
        """Advance the counter by one step.

        :raises UnknownOrderError: the last value or the step has changed, or the counter is not known.
        """
        self.run.statement_place = self.place  # functions in the bounds are called from here
        if not self._has_constant_bounds and self._bounds() != (self.last, self.step):
            raise unknown_order_error(self.place, "motion inside FOR: its end changes while it runs", LOOP_ADVICE)
        self._set_value(self.value() + self.step)

    def skip(self, round_count: int) -> None:
        """Advance the counter by the steps of a number of rounds, whose statements leave the bounds unchanged."""
        self._set_value(self.value() + round_count * self.step)

    def _bounds(self) -> tuple[int, int]:
        """Return the present last value and step of the FOR.

        :raises UnknownOrderError: they are not known before run time, or are REALs.
        :raises ProgramError: the step is no whole number other than 0.
        """
        first, last, step_value = self.bound_values
        bounds = [bound for bound in (first, last, step_value) if bound is not None]
        if not all(map(self.run.variables.functions.is_pure, calls(bounds))):
            raise self._unknown_bounds_error()
        step = 1 if step_value is None else self._step_number(step_value)
        return self._whole_number(last), step

    def _step_number(self, step_value: Value) -> int:
        """Return the number of an expression for STEP.

        :raises ProgramError: the step is 0 or a REAL.
        :raises UnknownOrderError: the step is not known before run time.
        """
        step = self._known_number(step_value)
        if not step.is_integer or step.value == 0.0:
            problem = f"FOR cannot count by STEP {step.value:g}"
            raise self.place.error(problem, "Give a whole number other than 0, as it is or by an INT.")
        return int(step.value)

    def _whole_number(self, bound: Value) -> int:
        """Return the number of an expression for the first or the last value of the counter.

        :raises UnknownOrderError: the number is a REAL, or not known before run time.
        """
        number = self._known_number(bound)
        if not number.is_integer:
            problem = f"motion inside FOR: one of its bounds is a REAL, {number.value:g}"
            raise unknown_order_error(self.place, problem, "Give whole numbers, as they are or by an INT.")
        return int(number.value)

    def _known_number(self, bound: Value) -> Number:
        """Return the number of an expression for a bound or the step.

        :raises UnknownOrderError: it is not known before run time.
        """
        number = self.run.variables.evaluate(bound)
        if not isinstance(number, Number):
            raise self._unknown_bounds_error()
        return number

    def _set_value(self, number: int) -> None:
        """Give the counter a value."""
        self.run.variables.set(self.key, Number(float(number), start=0, stop=0, is_integer=True), self.place)

    def value(self) -> int:
        """Return the present value of the counter.

        :raises UnknownOrderError: the value is not known, as when the counter may change at any time, or is a REAL.
        """
        value = self.run.variables.value(self.key)
        if not isinstance(value, Number) or not value.is_integer:
            raise self._unknown_bounds_error()
        return int(value.value)

    def _unknown_bounds_error(self) -> UnknownOrderError:
        """Return the error that the bounds are not known before run time."""
        return undecided_error(self.run, self.place, [bound for bound in self.bound_values if bound is not None])
