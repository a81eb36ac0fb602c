"""Statements of KRL as `parser` reads them; each says where it is in the text.

Offsets count characters from the beginning of the text. `word` is the first word, upper case (behind GLOBAL), `start`
where the statement begins, GLOBAL included, and `stop` is behind its last character.
"""

from __future__ import annotations

from typing import ClassVar

from msgspec import Struct

from postproc.dialects.krl.language.declarations import DeclaredName
from postproc.dialects.krl.language.tokens import Span
from postproc.dialects.krl.language.values import Call, Reference, Value
from postproc.errors import ProgramError


def _values_of(part: object) -> tuple[Value, ...]:
    """Return the values in a part of a statement: a value, another statement, several of these, or None."""
    if isinstance(part, (Statement, Tail)):
        return part.values
    if isinstance(part, tuple):
        return tuple(value for item in part for value in _values_of(item))
    return () if part is None else (part,)  # type: ignore[return-value]


class _Node(Struct, frozen=True, eq=False, kw_only=True):
    code: Value | None = None


class Statement(_Node, frozen=True, eq=False):
    """A statement that is not understood, or does nothing that matters; the base of all others.

    :param code: text that is not parsed further, with the calls in it; None if there are none.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("code",)
    """Fields with values, in the order of the text."""

    word: str
    start: int
    stop: int

    @property
    def values(self) -> tuple[Value, ...]:
        """The values in it, in the order of the text."""
        values: list[Value] = []
        for name in self.PARTS:
            part = getattr(self, name)
            if part is not None:
                values += _values_of(part)
        return tuple(values)


class FaultyStatement(Statement, frozen=True, eq=False):
    """A statement that cannot be read: why."""

    error: ProgramError


class Parameter(Struct, frozen=True):
    """A parameter of a routine; without ``:IN`` the routine may write its argument.

    :param is_array: it is a whole array: ``Q[]``.
    """

    name: str
    by_value: bool
    is_array: bool = False


class Definition(Statement, frozen=True, eq=False):
    """DEF or DEFFCT.

    :param name: as it is spelled, at `at`.
    :param result: type of what a DEFFCT gives, upper case; empty for DEF.
    :param parameters: in order.
    """

    public: bool
    name: str
    at: int
    result: str
    parameters: tuple[Parameter, ...]


class Declaration(Statement, frozen=True, eq=False):
    """Names that are declared, with their initial values.

    :param public: GLOBAL is its first word.
    :param constant: CONST: no statement may write the names.
    :param structure: of STRUC, its name and its members with their types.
    """

    public: bool
    constant: bool
    names: tuple[DeclaredName, ...]
    structure: tuple[str, dict[str, str]] | None = None


class IdleDeclaration(Statement, frozen=True, eq=False):
    """ENUM, EXT, CHANNEL … : it declares, and does nothing."""


class CyclicInput(Statement, frozen=True, eq=False):
    """ANIN ON, DIGIN ON, SIGNAL: the name is written again and again, or is that of an input."""

    name: str


class Import(Statement, frozen=True, eq=False):
    """IMPORT: a variable of a `.dat` under another name; both are written where one of them is. Upper case.

    :param file: name of that `.dat` without its ending.
    """

    name: str
    original: str
    file: str


class Tail(Struct, frozen=True, eq=False):
    """What follows the points of a motion: WITH and approximation. It holds for inserted targets too.

    :param given: assignments of WITH; a plain `Statement` for anything else.
    :param approximation: C_DIS, C_VEL …, upper case, in order; `behind` where the text before them ends.
    :param rest: text that is not understood.
    :param error: why WITH cannot be read.
    """

    start: int
    stop: int
    behind: int
    given: tuple[Statement, ...] = ()
    approximation: tuple[str, ...] = ()
    rest: Span | None = None
    error: ProgramError | None = None

    @property
    def values(self) -> tuple[Value, ...]:
        """The values in it, in the order of the text."""
        return _values_of(self.given) if self.given else ()


class Motion(Statement, frozen=True, eq=False):
    """A motion.

    :param via: auxiliary point of a circle, None for others.
    :param end: target; None where a circle lacks it.
    :param angle: CA, None without it.
    :param frame: ``#BASE`` or ``#TOOL`` of a relative motion; empty if it is not given.
    :param frame_behind: where that is behind the approximation; None: it is behind the target, or not given.
    """

    PARTS = ("via", "end", "angle", "tail")

    via: Value | None
    end: Value | None
    angle: Value | None
    frame: str
    frame_behind: Span | None
    tail: Tail


class Spline(Statement, frozen=True, eq=False):
    """SPLINE or PTP_SPLINE: begins a spline block."""

    PARTS = ("tail",)

    tail: Tail


class EndSpline(Statement, frozen=True, eq=False):
    """ENDSPLINE; `behind` what follows it."""

    behind: str


class If(Statement, frozen=True, eq=False):
    """IF.

    :param condition: without THEN all that follows IF; None if there is none.
    :param behind: what follows THEN.
    """

    PARTS = ("condition",)

    condition: Value | None
    has_then: bool
    behind: str


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


class For(Statement, frozen=True, eq=False):
    """FOR.

    :param name: of the counter, upper case; empty if there is none.
    :param bounds: first and last number and the step (None: 1); None if it is not understood.
    :param error: why a number cannot be read.
    """

    PARTS = ("counter", "bounds", "code")

    name: str
    counter: Reference | None
    bounds: tuple[Value, Value, Value | None] | None
    error: ProgramError | None = None


class BareWord(Statement, frozen=True, eq=False):
    """ELSE, DEFAULT, LOOP, REPEAT, ENDIF … : a word alone on its line; `behind` is what follows nevertheless."""

    behind: str


class Goto(Statement, frozen=True, eq=False):
    """GOTO and its label, upper case."""

    label: str


class Label(Statement, frozen=True, eq=False):
    """Where a GOTO leads; upper case."""

    name: str


class Return(Statement, frozen=True, eq=False):
    """RETURN and the value that it gives; None without one."""

    PARTS = ("value",)

    value: Value | None


class Event(Statement, frozen=True, eq=False):
    """INTERRUPT or TRIGGER: what it does, and when.

    :param public: GLOBAL.
    :param declares: INTERRUPT DECL.
    :param code: what precedes DO, likewise.
    :param action: the statement behind DO; None without one.
    """

    PARTS = ("code", "action")

    public: bool
    declares: bool
    action: Statement | None


class Trigger(Event, frozen=True, eq=False):
    """TRIGGER.

    :param distance: True for DISTANCE, False for PATH.
    :param value: of DISTANCE or PATH; None if the statement is not understood.
    :param from_start: ONSTART.
    :param delay: of DELAY.
    """

    distance: bool
    value: Value | None
    from_start: bool
    delay: Value | None


class SplineTiming(Statement, frozen=True, eq=False):
    """CONST_VEL, TIME_BLOCK, STOP WHEN PATH: how spline motions are driven.

    :param complete: it is as it must be.
    :param from_start: ONSTART.
    """

    complete: bool
    from_start: bool


class Assignment(Statement, frozen=True, eq=False):
    """A variable and what it is given."""

    PARTS = ("target", "value")

    target: Reference
    value: Value


class CallStatement(Statement, frozen=True, eq=False):
    """A call that is a statement; BAS too."""

    PARTS = ("call",)

    call: Call
