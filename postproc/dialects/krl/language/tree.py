"""Statements of KRL as `parser` reads them, with their spans in the text.

Offsets count characters from the beginning of the text. `word` is the first word of a statement, upper case, without
GLOBAL. `start` is the offset of the statement, GLOBAL included; `stop` is the offset behind its last character.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from msgspec import Struct

from postproc.dialects.krl.language.declarations import DeclaredName, Structure
from postproc.dialects.krl.language.tokens import Span
from postproc.dialects.krl.language.values import Call, Reference, Value
from postproc.errors import ProgramError


def _values_of(part: object) -> tuple[Value, ...]:
    """Return the values in a part of a statement, in the order of the text.

    :param part: a value, a statement, a tail, a tuple of such parts, or None.
    """
    if isinstance(part, (Statement, Tail)):
        return part.values
    if isinstance(part, tuple):
        return tuple(value for item in part for value in _values_of(item))
    return () if part is None else (part,)  # type: ignore[return-value]


class _Node(Struct, frozen=True, eq=False, kw_only=True):
    """Fields of all statements that are given by keyword; see `Statement`."""

    code: Value | None = None


class Statement(_Node, frozen=True, eq=False):
    """A statement that is not understood, or does nothing that matters; the base of all others.

    :param code: text that is not parsed further, with the calls in it; None if there are none.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("code",)
    """Names of the fields that contain values, in the order of the text."""

    word: str
    start: int
    stop: int

    @property
    def values(self) -> tuple[Value, ...]:
        """All values of the statement, in the order of the text."""
        values: list[Value] = []
        for name in self.PARTS:
            part = getattr(self, name)
            if part is not None:
                values += _values_of(part)
        return tuple(values)


class FaultyStatement(Statement, frozen=True, eq=False):
    """A statement that cannot be read, for the reason in `error`."""

    error: ProgramError


class Parameter(Struct, frozen=True):
    """A parameter of a routine; without ``:IN`` the routine may write its argument.

    :param by_value: True for ``:IN``.
    :param is_array: True for a whole array: ``Q[]``.
    """

    name: str
    by_value: bool
    is_array: bool = False


class Definition(Statement, frozen=True, eq=False):
    """DEF or DEFFCT.

    :param is_global: GLOBAL is its first word.
    :param name: as it is spelled.
    :param name_start: offset of the name.
    :param result_type: type of the value that a DEFFCT returns, upper case; empty for DEF.
    :param parameters: in the order of the text.
    """

    is_global: bool
    name: str
    name_start: int
    result_type: str
    parameters: tuple[Parameter, ...]


class Declaration(Statement, frozen=True, eq=False):
    """Names that are declared, with their initial values.

    :param is_global: GLOBAL is its first word.
    :param is_constant: CONST: no statement may write the names.
    :param structure: the type that STRUC declares; None for other declarations.
    """

    is_global: bool
    is_constant: bool
    names: tuple[DeclaredName, ...]
    structure: Structure | None = None


class IdleDeclaration(Statement, frozen=True, eq=False):
    """ENUM, EXT, CHANNEL … : a declaration that does nothing when it runs."""


class CyclicInput(Statement, frozen=True, eq=False):
    """ANIN ON, DIGIN ON, SIGNAL: the controller writes the variable in each cycle, or it is the name of an input."""

    name: str


class Import(Statement, frozen=True, eq=False):
    """IMPORT: a variable of a `.dat` under another name; a statement that writes one of the names writes both.

    :param name: the new name, upper case.
    :param original: name in the `.dat`, upper case.
    :param file: name of this `.dat`, upper case, without extension.
    """

    name: str
    original: str
    file: str


class Tail(Struct, frozen=True, eq=False):
    """WITH and approximation, which follow the points of a motion. Inserted targets repeat this text.

    :param with_stop: offset behind WITH, before the approximation; `start` without WITH.
    :param assignments: assignments of WITH; a plain `Statement` for anything else.
    :param approximation: C_DIS, C_VEL …, upper case, in order.
    :param unknown_text: span of a text that is not understood; None if there is none.
    :param error: reason why WITH cannot be read; None if it can.
    """

    start: int
    stop: int
    with_stop: int
    assignments: tuple[Statement, ...] = ()
    approximation: tuple[str, ...] = ()
    unknown_text: Span | None = None
    error: ProgramError | None = None

    @property
    def values(self) -> tuple[Value, ...]:
        """Values of WITH, in the order of the text."""
        return _values_of(self.assignments) if self.assignments else ()


class Motion(Statement, frozen=True, eq=False):
    """A motion.

    :param via: auxiliary point of a circle, None for others.
    :param end: target; None where a circle lacks it.
    :param angle: CA, None without it.
    :param frame: ``#BASE`` or ``#TOOL`` of a relative motion; empty if it is not given.
    :param frame_span: span of `frame` if it follows the approximation; None if it follows the target or is not given.
    """

    PARTS = ("via", "end", "angle", "tail")

    via: Value | None
    end: Value | None
    angle: Value | None
    frame: str
    frame_span: Span | None
    tail: Tail


class Spline(Statement, frozen=True, eq=False):
    """SPLINE or PTP_SPLINE: begins a spline block."""

    PARTS = ("tail",)

    tail: Tail


class EndSpline(Statement, frozen=True, eq=False):
    """ENDSPLINE.

    :param extra_text: text behind it: C_SPL, or empty.
    """

    extra_text: str


class If(Statement, frozen=True, eq=False):
    """IF.

    :param condition: code between IF and THEN, or behind IF if THEN is missing; None if there is no code.
    :param extra_text: text behind THEN; empty in a correct program.
    """

    PARTS = ("condition",)

    condition: Value | None
    has_then: bool
    extra_text: str


class While(Statement, frozen=True, eq=False):
    """WHILE or UNTIL."""

    PARTS = ("condition",)

    condition: Value


class Switch(Statement, frozen=True, eq=False):
    """SWITCH."""

    PARTS = ("value",)

    value: Value


class Case(Statement, frozen=True, eq=False):
    """CASE and its values."""

    PARTS = ("cases",)

    cases: tuple[Value, ...]


class Bounds(NamedTuple):
    """The bounds of a FOR.

    :ivar first: first value of the counter.
    :ivar last: last value.
    :ivar step: increment; None if STEP is left out, which means 1.
    """

    first: Value
    last: Value
    step: Value | None


class For(Statement, frozen=True, eq=False):
    """FOR.

    :param name: name of the counter, upper case; empty if there is none.
    :param counter: variable that is the counter; None if the statement is not understood.
    :param bounds: None if the statement is not understood.
    :param error: reason why it cannot be read; None if it can be read, or no reason is known.
    """

    PARTS = ("counter", "bounds", "code")

    name: str
    counter: Reference | None
    bounds: Bounds | None
    error: ProgramError | None = None


class BareWord(Statement, frozen=True, eq=False):
    """ELSE, DEFAULT, LOOP, REPEAT, ENDIF … : a word that is alone on its line.

    :param extra_text: text behind the word; empty in a correct program.
    """

    extra_text: str


class Goto(Statement, frozen=True, eq=False):
    """GOTO and its label, upper case."""

    label: str


class Label(Statement, frozen=True, eq=False):
    """A label, to which a GOTO jumps; upper case."""

    name: str


class Return(Statement, frozen=True, eq=False):
    """RETURN and the value that it returns; None without a value."""

    PARTS = ("value",)

    value: Value | None


class Event(Statement, frozen=True, eq=False):
    """INTERRUPT or TRIGGER.

    :param is_global: True for GLOBAL.
    :param is_declaration: True for INTERRUPT DECL.
    :param code: code before DO, with the calls in it; None if there are none.
    :param action: the statement behind DO; None without one.
    """

    PARTS = ("code", "action")

    is_global: bool
    is_declaration: bool
    action: Statement | None


class Trigger(Event, frozen=True, eq=False):
    """TRIGGER.

    :param is_distance: True for DISTANCE, False for PATH.
    :param value: value of DISTANCE or PATH; None if the statement is not understood.
    :param is_from_start: True for ONSTART.
    :param delay: value of DELAY; None if the statement is not understood.
    """

    is_distance: bool
    value: Value | None
    is_from_start: bool
    delay: Value | None


class SplineTiming(Statement, frozen=True, eq=False):
    """CONST_VEL, TIME_BLOCK or STOP WHEN PATH: speed and stops of spline motions.

    :param is_complete: True if the statement has all that its form requires.
    :param is_from_start: True for ONSTART.
    """

    is_complete: bool
    is_from_start: bool


class Assignment(Statement, frozen=True, eq=False):
    """An assignment of a value to a variable."""

    PARTS = ("target", "value")

    target: Reference
    value: Value


class CallStatement(Statement, frozen=True, eq=False):
    """A call as a statement, also a call of BAS."""

    PARTS = ("call",)

    call: Call
