"""Variables whose values are known before the program runs: from the `.dat`, the `$config.dat`, the `.src` itself."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from postproc.cell import Cell
from postproc.dialects.krl.language.declarations import DECLARATION, Declared, declared
from postproc.dialects.krl.language.expressions import (
    Aggregate,
    Call,
    Chain,
    Number,
    Opaque,
    Operation,
    Reference,
    Value,
    Word,
    parse,
)
from postproc.dialects.krl.language.names import MAX_LENGTH
from postproc.dialects.krl.language.positions import AXES, CARTESIAN, Position, from_aggregate, from_pose
from postproc.dialects.krl.language.source import Source

_MORE = re.compile(r"[}\d'\"][ \t]*,[ \t]*[A-Za-z_$][\w$]*[ \t]*(?:\[[^\]]*\])?[ \t]*=", re.ASCII)
_INDEX = re.compile(r"[0-9]{1,9}", re.ASCII)
_FIRST_FIELD = re.compile(r"\w+", re.ASCII)


@dataclass(frozen=True, slots=True)
class Unknown:
    """A variable whose value is not known before the program runs.

    :param where: what changes it, as text for a message; empty where it has no value at all.
    """

    where: str = ""


NOTHING = Unknown()


@dataclass(frozen=True, slots=True)
class _Pending:
    """A value that stands in a declaration and has not been parsed yet."""

    source: Source
    start: int
    stop: int


@dataclass(frozen=True, slots=True)
class Scope:
    """Which variable a name means.

    :param local: names of the routine's own → how they are stored.
    :param own: names of the routine's module, or those of the main program that it does not see.
    :param prefix: what is put before these.
    """

    local: Mapping[str, str] = field(default_factory=dict)
    own: frozenset[str] = frozenset()
    prefix: str = ""

    def stored(self, name: str) -> str:
        """Return under which name a variable (upper case) is stored."""
        local = self.local.get(name)
        return local if local is not None else self.prefix + name if name in self.own else name


Known = Number | Word | Aggregate | Position | Unknown
_COMPONENTS = frozenset({*CARTESIAN, *AXES, "S", "T"})
_REAL = frozenset({*CARTESIAN, *AXES})
_ZERO = Position((0.0,) * 6)


class Variables:
    """Values by name (upper case; elements as ``P[3]``), at one moment of the program's run.

    :ivar types: declared type by name, upper case.
    :ivar public: names declared GLOBAL.
    :ivar scope: which variables the names of the present routine mean.
    :ivar changing: names that may change at any time, and what changes them.
    :ivar used: names that a motion, a frame or a speed depends on.
    :ivar changed: names that the program gives another value, and where first.
    """

    def __init__(self, cell: Cell) -> None:
        self._values: dict[str, Known | _Pending] = {}
        self._elements: defaultdict[str, list[str]] = defaultdict(list)
        self.types: dict[str, str] = {}
        self.public: set[str] = set()
        self.scope = Scope()
        self.changing: dict[str, Unknown] = {}
        self.used: set[str] = set()
        self.changed: dict[str, str] = {}
        self._initial = {"BASE_DATA", "TOOL_DATA"}
        for number, base in cell.base_data.items():
            self.put(f"BASE_DATA[{int(number)}]", from_pose(base.pose()))
        for number, tool in cell.tool_data.items():
            self.put(f"TOOL_DATA[{int(number)}]", from_pose(tool.pose()))
        for name in ("$NULLFRAME", "$WORLD", "$ROBROOT", "BASE_DATA[0]", "TOOL_DATA[0]"):
            self._values.setdefault(name, _ZERO)

    def read_data(self, source: Source, *, fill: bool = False, shared: bool = False) -> None:
        """Take the declarations of a `.dat`; with `fill` only those of names that have no value yet.

        :param shared: all of them are GLOBAL, as those of the `$config.dat`.
        :raises ProgramError: DEFDAT or ENDDAT is missing.
        """
        text = source.text
        opened = closed = False
        for line, (start, stop) in enumerate(zip(source.starts.tolist(), source.stops.tolist(), strict=True), 1):
            while start < stop and text[start] in " \t\r":
                start += 1
            first = text[start : start + 1]
            if first in ("", ";", "&", "\r"):
                continue
            word = text[start : start + 7].upper()
            if word.startswith("DEFDAT"):
                opened = True
            elif word.startswith("ENDDAT"):
                closed = True
                break
            else:
                self._declare_data(source, line, start, stop, fill=fill, shared=shared)
        if not opened or not closed:
            raise source.line_error(
                f"{'ENDDAT' if opened else 'DEFDAT'} is missing",
                len(source.starts),
                "Check that the file is complete and that it is the .dat of this program.",
            )

    def _declare_data(self, source: Source, line: int, start: int, stop: int, *, fill: bool, shared: bool) -> None:
        """Note what one line of a `.dat` declares; a value is parsed when it is needed."""
        match = DECLARATION.match(source.text, start, stop)
        if not match:
            return
        if match[4] and not _MORE.search(source.text, match.end(), stop):
            names = [next(declared(source, start, match.end()))]
        else:
            start, stop = source.code_span(line)
            names = list(declared(source, start, stop))
        for one in names:
            name = self._note(one._replace(public=one.public or shared), fill=fill)
            if one.value >= 0 and not (fill and name in self._values):
                self._initial.add(self.scope.stored(one.name))
                self.put(name, _Pending(source, one.value, stop))

    def declare(self, source: Source, start: int, stop: int) -> list[Declared]:
        """Take one declaration of a `.src`, with initial values; return what it declares."""
        names = list(declared(source, start, stop))
        for one in names:
            name = self._note(one)
            if one.value >= 0:
                self.put(name, _Pending(source, one.value, stop))
        return names

    def _note(self, one: Declared, *, fill: bool = False) -> str:
        """Note type and scope of a declared name; return the key of its value."""
        name = self.scope.stored(one.name)
        if one.kind and not (fill and name in self.types):
            self.types[name] = one.kind
            if one.public:
                self.public.add(name)
        digits = (one.bounds or "").strip("[] \t")
        return f"{name}[{int(digits)}]" if _INDEX.fullmatch(digits) else name

    def put(self, key: str, value: Known | _Pending) -> None:
        """Give a variable its first value."""
        if key not in self._values and key.endswith("]"):
            self._elements[key[: key.index("[")]].append(key)
        self._values[key] = value

    def set(self, key: str, value: Known, where: str) -> None:
        """Give a variable another value: what its type makes of it.

        :param where: where the program does.
        """
        name = key.partition("[")[0]
        self.changed.setdefault(name, where)
        if isinstance(value, Number):
            value = self._typed(name, value)
        elif isinstance(value, Aggregate) and self._ambiguous(key, value):
            value = Unknown(f"{where}: not all of its components are given, and it had others")
        self.put(key, value)

    def _ambiguous(self, key: str, new: Aggregate) -> bool:
        """Return whether a position lacks components that the variable may have had.

        What becomes of these is not certain: they may stay, or count as missing.
        """
        names: tuple[str, ...] = ()
        if not new.items.keys().isdisjoint(_REAL):
            names = AXES if not new.items.keys().isdisjoint(AXES) else CARTESIAN
        missing = [name for name in names if name not in new.items]
        old = self.value(key)
        if not missing or old is None or old == NOTHING:
            return False
        return not isinstance(old, Aggregate) or any(name in old.items for name in missing)

    def _typed(self, name: str, number: Number) -> Known:
        kind = self.types.get(name)
        if kind == "REAL":
            return number._replace(integer=False)
        if kind == "INT" and number.value != int(number.value):
            return Unknown("where it is rounded")
        return number._replace(integer=number.value == int(number.value))

    def set_field(self, key: str, field: str, value: Known, where: str) -> None:
        """Give one component of a variable a value (``XP1.X=5``)."""
        whole = self.value(key)
        self.changed.setdefault(key.partition("[")[0], where)
        match = _FIRST_FIELD.match(field)
        first = match[0] if match else field
        if isinstance(whole, Position) and field in CARTESIAN and not whole.axis and isinstance(value, Number):
            values = list(whole.values)
            values[CARTESIAN.index(field)] = value.value
            self.put(key, replace(whole, values=tuple(values)))
        elif not isinstance(whole, Aggregate):
            self.put(key, Unknown(where))
        elif first == field and isinstance(value, Number | Word):
            self.put(key, replace(whole, items={**whole.items, field: value}, computed=True))
        elif first not in _COMPONENTS:
            items = {**whole.items, first: Opaque(whole.start, whole.stop)}
            self.put(key, replace(whole, items=items, computed=True))
        else:
            self.put(key, Unknown(where))

    def forget(self, name: str, where: str) -> None:
        """Note that a variable (all its elements) has a value that is not known."""
        self.changed.setdefault(name, where)
        for key in (name, *self._elements.get(name, ())):
            self._values[key] = Unknown(where)

    def kept(self) -> dict[str, str]:
        """Return the names that keep their values from run to run and that the program changes, and where it does."""
        changed = self.changed | {name: value.where for name, value in self.changing.items()}
        return {name: changed[name] for name in sorted(self._initial & changed.keys())}

    def next_run(self) -> Variables:
        """Return what the next run of the program begins with: data as this run leaves them, nothing else."""
        later = copy(self)
        later._values = {key: value for key, value in self._values.items() if self._persists(key)}
        later._elements = self._elements.copy()
        later.scope, later.changing, later.used, later.changed = Scope(), {}, set(), {}
        for name in self._initial & self.changing.keys():
            later.forget(name, self.changing[name].where)
        later.changed = {}
        return later

    def _persists(self, key: str) -> bool:
        return key[0] == "$" or key.partition("[")[0] in self._initial

    def value(self, key: str) -> Known | None:
        """Return the value of a variable or an element, None where it has none."""
        if self.changing and (name := key.partition("[")[0]) in self.changing:
            return self.changing[name]
        value = self._values.get(key)
        if isinstance(value, _Pending):
            parsed, _ = parse(value.source, value.start, value.stop)
            value = self.evaluate(value.source, parsed)
            if isinstance(value, Number):
                value = self._typed(key.partition("[")[0], value)
            self._values[key] = value
        return value

    def evaluate(self, source: Source, value: Value | Known) -> Known:
        """Return what a value is now; `Unknown` when that is not known before the program runs."""
        if isinstance(value, Number | Word | Position | Unknown):
            return value
        if isinstance(value, Aggregate):
            return self._resolved(value)
        if isinstance(value, Reference):
            return self._lookup(source, value)
        if isinstance(value, Operation):
            return self._computed(source, value)
        if isinstance(value, Chain):
            return self._product(source, value)
        return NOTHING

    def _resolved(self, aggregate: Aggregate) -> Aggregate:
        """Return an aggregate whose components have the values that they have now."""
        if not any(isinstance(item, Reference | Operation) for item in aggregate.items.values()):
            return aggregate
        items = {}
        for name, item in aggregate.items.items():
            known = self.evaluate(aggregate.source, item)
            items[name] = known if isinstance(known, Number | Word | Aggregate) else Opaque(*_span(item))
        return replace(aggregate, items=items, computed=True)

    def _computed(self, source: Source, operation: Operation) -> Known:
        """Return a sum, difference, product or quotient; two INTs are divided only where nothing remains."""
        left = Number(0.0, 0, 0, True) if operation.left is None else self.evaluate(source, operation.left)
        right = self.evaluate(source, operation.right)
        if not isinstance(left, Number) or not isinstance(right, Number):
            return next((side for side in (left, right) if isinstance(side, Unknown)), NOTHING)
        a, b, integer = left.value, right.value, left.integer and right.integer
        if operation.operator == "/" and (b == 0.0 or (integer and a % b != 0.0)):
            return NOTHING
        value = {"+": a + b, "-": a - b, "*": a * b, "/": a / b if b else 0.0}[operation.operator]
        return Number(value, operation.start, operation.stop, integer) if math.isfinite(value) else NOTHING

    def _product(self, source: Source, chain: Chain) -> Known:
        """Return the position that a chain of frames gives: S, T and external axes are those of its last operand."""
        pose, part = np.eye(4), None
        for operand in chain.operands:
            part = self.position(source, operand)
            if part is None or part.axis:
                return NOTHING
            pose = pose @ part.pose()
        if part is None:
            return NOTHING
        return replace(from_pose(pose), status=part.status, turn=part.turn, external=part.external)

    def key_of(self, source: Source, reference: Reference) -> str | None:
        """Return the key of a variable, its index resolved; None if the index is not known."""
        name = self.scope.stored(reference.name)
        if reference.element is None:
            return name
        if _INDEX.fullmatch(reference.element):
            return f"{name}[{int(reference.element)}]"
        start, stop = reference.inside
        if not source.text[start:stop].strip():
            return None
        value, end = parse(source, start, stop)
        index = self.number(source, value)
        if index is None or index != int(index) or source.text[end:stop].strip():
            return None
        return f"{name}[{int(index)}]"

    def _lookup(self, source: Source, reference: Reference) -> Known:
        key = self.key_of(source, reference)
        value = self.value(key) if key is not None else None
        if value is None and key is not None and reference.element is not None:
            value = self.value(self.scope.stored(reference.name))  # the whole array was changed
        if isinstance(value, Position) and reference.field in CARTESIAN and not value.axis:
            return Number(value.values[CARTESIAN.index(reference.field)], reference.start, reference.stop, False)
        if reference.field is not None and not isinstance(value, Unknown):
            item = value.items.get(reference.field) if isinstance(value, Aggregate) else None
            value = self.evaluate(source, item) if item is not None else None
            if isinstance(value, Number) and reference.field in _REAL:
                value = value._replace(integer=False)
        return value if value is not None else NOTHING

    def position(self, source: Source, value: Value | Known) -> Position | None:
        """Return the position that a value gives, or None when it is not known before the program runs.

        :raises ProgramError: it is known but not a valid position.
        """
        known = self.evaluate(source, value)
        if isinstance(known, Aggregate):
            return from_aggregate(known)
        return known if isinstance(known, Position) else None

    def number(self, source: Source, value: Value | Known) -> float | None:
        """Return a number, or None when it is not known before the program runs."""
        known = self.evaluate(source, value)
        return known.value if isinstance(known, Number) else None

    def rely(self, source: Source, value: Value | Known) -> None:
        """Note which names a motion, a frame or a speed depends on."""
        if isinstance(value, Reference):
            self.used.add(self.scope.stored(value.name))
            if value.element is not None and value.inside[0] < value.inside[1]:
                self.rely(source, parse(source, *value.inside)[0])
        elif isinstance(value, Chain):
            for operand in value.operands:
                self.rely(source, operand)
        elif isinstance(value, Operation):
            for side in (value.left, value.right):
                if side is not None:
                    self.rely(source, side)
        elif isinstance(value, Aggregate):
            for item in value.items.values():
                self.rely(value.source, item)

    def why_unknown(self, source: Source, value: Value | Known) -> str:
        """Return why a value is not known, for a message."""
        if isinstance(value, Position | Unknown):
            return "it is computed while the program runs"
        if isinstance(value, Chain):
            for operand in value.operands:
                if self.position(source, operand) is None:
                    return self.why_unknown(source, operand)
        text = source.text[value.start : value.stop].strip()[:80]
        if isinstance(value, Operation):
            for side in (value.left, value.right):
                if side is not None and isinstance(self.evaluate(source, side), Unknown):
                    return self.why_unknown(source, side)
        if isinstance(value, Opaque | Call | Operation) or (isinstance(value, Reference) and value.name[0] == "$"):
            return f"{text} is computed while the program runs"
        if isinstance(value, Reference):
            if self.key_of(source, value) is None:
                start, stop = value.inside
                why = (
                    f": {self.why_unknown(source, parse(source, start, stop)[0])}"
                    if source.text[start:stop].strip()
                    else ""
                )
                return f"the index of {text} is not known before the program runs{why}"
            known = self._lookup(source, value)
            if isinstance(known, Unknown) and known.where:
                return f"{text} is changed while the program runs ({known.where})"
            if isinstance(known, Unknown):
                return f"{text} has no value in the program, its .dat or the $config.dat"
        return f"{text} is not what is needed here"

    def check_name(self, source: Source, reference: Reference) -> None:
        """Refuse a name that is longer than the controller accepts."""
        if len(reference.name) > MAX_LENGTH:
            raise source.error(f"the name {reference.name} is longer than {MAX_LENGTH} characters", reference.start)


def _span(value: Value) -> tuple[int, int]:
    return value.start, value.stop
