"""Statements of KRL as `parser` reads them; each says where it is in the text.

Offsets count characters from the beginning of the text. `word` is the first word, upper case (behind GLOBAL), `start`
where the statement begins, GLOBAL included, and `stop` is behind its last character.
"""

from __future__ import annotations

from msgspec import Struct

from postproc.dialects.krl.language.declarations import Declared
from postproc.dialects.krl.language.tokens import Span
from postproc.dialects.krl.language.values import Call, Reference, Value
from postproc.errors import ProgramError


class Statement(Struct, frozen=True, eq=False):
    """What is not understood, or does nothing that matters; the base of all others."""

    word: str
    start: int
    stop: int


class Faulty(Statement, frozen=True, eq=False):
    """A statement that cannot be read: why."""

    error: ProgramError


class Parameter(Struct, frozen=True):
    """A parameter of a routine; without ``:IN`` the routine may write what is given for it."""

    name: str
    by_value: bool


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
    names: tuple[Declared, ...]
    structure: tuple[str, dict[str, str]] | None = None


class Outside(Statement, frozen=True, eq=False):
    """ENUM, EXT, CHANNEL … : it declares, and does nothing."""


class Cyclic(Statement, frozen=True, eq=False):
    """ANIN ON, DIGIN ON, SIGNAL: the name is written again and again, or stands for an input."""

    name: str


class Imported(Statement, frozen=True, eq=False):
    """IMPORT: a variable of a `.dat` under another name; both are written where one of them is. Upper case."""

    name: str
    original: str


class Motion(Statement, frozen=True, eq=False):
    """A motion; `read.motion_reader` reads its points and what follows them."""


class Spline(Statement, frozen=True, eq=False):
    """SPLINE or PTP_SPLINE: begins a spline block."""


class EndSpline(Statement, frozen=True, eq=False):
    """ENDSPLINE; `behind` what follows it."""

    behind: str


class If(Statement, frozen=True, eq=False):
    """IF.

    :param head: its condition; without THEN all that follows IF.
    :param condition: None where it cannot be read.
    :param behind: what follows THEN.
    """

    head: Span
    condition: Condition | None
    then: bool
    behind: str


class While(Statement, frozen=True, eq=False):
    """WHILE or UNTIL; `condition` is None where it cannot be read."""

    head: Span
    condition: Condition | None


class Switch(Statement, frozen=True, eq=False):
    """SWITCH; `value` is None where it cannot be read, then `error` says why."""

    head: Span
    value: Value | None
    error: ProgramError | None = None


class Case(Statement, frozen=True, eq=False):
    """CASE; of its values those are None that are something else."""

    values: tuple[Value | Condition | None, ...]


class For(Statement, frozen=True, eq=False):
    """FOR.

    :param name: of the counter, upper case; empty if there is none.
    :param bounds: first and last number and the step (None: 1); None if it is not understood.
    :param values: from the first number to the end.
    :param error: why a number cannot be read.
    """

    name: str
    counter: Reference | None
    bounds: tuple[Value, Value, Value | None] | None
    values: Span
    error: ProgramError | None = None


class Bare(Statement, frozen=True, eq=False):
    """ELSE, DEFAULT, LOOP, REPEAT, ENDIF … : a word alone on its line; `behind` is what follows nevertheless."""

    behind: str


class Goto(Statement, frozen=True, eq=False):
    """GOTO and its label, upper case."""

    label: str


class Label(Statement, frozen=True, eq=False):
    """Where a GOTO leads; upper case."""

    name: str


class Return(Statement, frozen=True, eq=False):
    """RETURN and the value that it gives, perhaps empty."""

    value: Span


class Event(Statement, frozen=True, eq=False):
    """INTERRUPT or TRIGGER: what it does, and when.

    :param public: GLOBAL.
    :param declares: INTERRUPT DECL.
    :param head: what precedes DO.
    :param action: the statement behind DO; None without one.
    """

    public: bool
    declares: bool
    head: Span
    action: Statement | None


class Trigger(Event, frozen=True, eq=False):
    """TRIGGER.

    :param distance: True for DISTANCE, False for PATH.
    :param value: of DISTANCE or PATH; None if the statement is not understood.
    :param from_start: ONSTART.
    :param delay: of DELAY.
    """

    distance: bool
    value: Span | None
    from_start: bool
    delay: Span | None


class Timed(Statement, frozen=True, eq=False):
    """CONST_VEL, TIME_BLOCK, STOP WHEN PATH: how spline motions are driven.

    :param complete: it is as it must be.
    :param from_start: ONSTART.
    """

    complete: bool
    from_start: bool


class Assignment(Statement, frozen=True, eq=False):
    """A variable and what it is given."""

    target: Reference
    value: Span


class CallStatement(Statement, frozen=True, eq=False):
    """A call that is a statement; BAS too."""

    call: Call


class Condition(Struct, frozen=True, eq=False):
    """Terms joined by comparisons and logic, in the order of the text.

    :param terms: values without these operators, or conditions in brackets.
    :param negated: whether NOT is before each.
    :param operators: between them, upper case.
    """

    terms: tuple[Value | Condition, ...]
    negated: tuple[bool, ...]
    operators: tuple[str, ...]
