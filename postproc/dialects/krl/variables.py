"""Variables whose values are known before the program runs: from the `.dat`, the `$config.dat`, the `.src` itself."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from dataclasses import dataclass, replace

import numpy as np

from postproc.cell import Cell
from postproc.dialects.krl.names import MAX_LENGTH, NAME
from postproc.dialects.krl.positions import AXES, CARTESIAN, Position, from_aggregate, from_pose
from postproc.dialects.krl.source import Source
from postproc.dialects.krl.syntax import (
    Aggregate,
    Call,
    Chain,
    Number,
    Opaque,
    Reference,
    Value,
    Word,
    parse,
)
from postproc.errors import ProgramError

_DECLARATION = re.compile(
    r"(?:(?:DECL|GLOBAL|CONST|PUBLIC)[ \t]+)*(?:([A-Za-z_]\w*)[ \t]+)?([A-Za-z_$][\w$]*)[ \t]*(\[[^\]]*\])?[ \t]*(=?)",
    re.ASCII | re.IGNORECASE,
)
_NEXT = re.compile(r"[ \t]*,[ \t]*([A-Za-z_$][\w$]*)[ \t]*(\[[^\]]*\])?[ \t]*(=?)", re.ASCII)
_MORE = re.compile(r"[}\d'\"][ \t]*,[ \t]*[A-Za-z_$][\w$]*[ \t]*(?:\[[^\]]*\])?[ \t]*=", re.ASCII)
_GLOBAL = re.compile(r"\bGLOBAL\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Unknown:
    """A variable that the program changes while it runs.

    :param line: 1-based line of the `.src` where it does.
    """

    line: int


@dataclass(frozen=True, slots=True)
class _Pending:
    """A value that stands in a declaration and has not been parsed yet."""

    source: Source
    start: int
    stop: int


Known = Number | Word | Aggregate | Position | Unknown
_COMPONENTS = frozenset({*CARTESIAN, *AXES, "S", "T"})
_ZERO = Position((0.0,) * 6)


class Variables:
    """Values by name (upper case; elements as ``P[3]``), at one moment of the program's run.

    :ivar types: declared type by name, upper case.
    :ivar public: names declared GLOBAL.
    :ivar understood: how often the `.src` names a variable where the reader knows what for.
    """

    def __init__(self, cell: Cell) -> None:
        self._values: dict[str, Known | _Pending] = {}
        self._elements: defaultdict[str, list[str]] = defaultdict(list)
        self.types: dict[str, str] = {}
        self.public: set[str] = set()
        self.understood: Counter[str] = Counter()
        for number, base in cell.base_data.items():
            self.set(f"BASE_DATA[{int(number)}]", from_pose(base.pose()))
        for number, tool in cell.tool_data.items():
            self.set(f"TOOL_DATA[{int(number)}]", from_pose(tool.pose()))
        for name in ("$NULLFRAME", "$WORLD", "$ROBROOT", "BASE_DATA[0]", "TOOL_DATA[0]"):
            self._values.setdefault(name, _ZERO)

    def read_data(self, source: Source, *, fill: bool = False) -> None:
        """Take the declarations of a `.dat`; with `fill` only those of names that have no value yet.

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
                self._declare_data(source, line, start, stop, fill=fill)
        if not opened or not closed:
            raise source.line_error(
                f"{'ENDDAT' if opened else 'DEFDAT'} is missing",
                len(source.starts),
                "Check that the file is complete and that it is the .dat of this program.",
            )

    def _declare_data(self, source: Source, line: int, start: int, stop: int, *, fill: bool) -> None:
        """Note what one line of a `.dat` declares; a value is parsed when it is needed."""
        match = _DECLARATION.match(source.text, start, stop)
        if match and match[4] and not _MORE.search(source.text, match.end(), stop):
            name = self._note(source, match, fill=fill)
            if name and not (fill and name in self._values):
                self.set(name, _Pending(source, match.end(), stop))
        elif match:
            self.declare(source, start, source.code_span(line)[1], fill=fill)

    def declare(self, source: Source, start: int, stop: int, *, fill: bool = False) -> None:
        """Take one declaration or initialisation, also of several names: ``DECL E6POS A={…},B={…}``."""
        match = _DECLARATION.match(source.text, start, stop)
        if not match:
            return
        name: str | None = self._note(source, match, fill=fill)
        equals, end, kind = match[4], match.end(), (match[1] or "").upper()
        while True:
            if equals:
                if name and not (fill and name in self._values):
                    self.set(name, _Pending(source, end, stop))
                end = _value_stop(source, end, stop)
            following = _NEXT.match(source.text, end, stop)
            if not following:
                return
            name = _key(following[1], following[2])
            if kind:
                self.types[following[1].upper()] = kind
            equals, end = following[3], following.end()

    def _note(self, source: Source, match: re.Match[str], *, fill: bool) -> str | None:
        """Note type and scope of a declared name; return the key of its value."""
        name = match[2].upper()
        if match[1] and not (fill and name in self.types):
            self.types[name] = match[1].upper()
            if _GLOBAL.search(source.text, match.start(), match.start(2)):
                self.public.add(name)
        return _key(match[2], match[3])

    def set(self, key: str, value: Known | _Pending) -> None:
        """Give a variable a value."""
        if key not in self._values and key.endswith("]"):
            self._elements[key[: key.index("[")]].append(key)
        self._values[key] = value

    def set_field(self, key: str, field: str, value: Known, line: int) -> None:
        """Give one component of a variable a value (``XP1.X=5``)."""
        whole = self._value(key)
        if isinstance(whole, Aggregate) and isinstance(value, Number | Word):
            self._values[key] = replace(whole, items={**whole.items, field: value}, computed=True)
        elif isinstance(whole, Aggregate) and field not in _COMPONENTS:
            items = {**whole.items, field: Opaque(whole.start, whole.stop)}
            self._values[key] = replace(whole, items=items, computed=True)
        elif isinstance(whole, Aggregate | Position):
            self._values[key] = Unknown(line)

    def forget(self, name: str, line: int) -> None:
        """Note that a variable (all its elements) is changed while the program runs."""
        for key in (name, *self._elements.get(name, ())):
            self._values[key] = Unknown(line)

    def _value(self, key: str) -> Known | None:
        value = self._values.get(key)
        if isinstance(value, _Pending):
            parsed, _ = parse(value.source, value.start, value.stop)
            value = self._values[key] = self.evaluate(value.source, parsed)
        return value

    def evaluate(self, source: Source, value: Value) -> Known:
        """Return what a value is now; `Unknown` when that is not known before the program runs."""
        if isinstance(value, Number | Word | Aggregate):
            return value
        if isinstance(value, Reference):
            return self._lookup(source, value)
        if isinstance(value, Chain):
            return self._product(source, value)
        return Unknown(0)

    def _product(self, source: Source, chain: Chain) -> Known:
        """Return the position that a chain of frames gives: S, T and external axes are those of its last operand."""
        pose, part = np.eye(4), None
        for operand in chain.operands:
            part = self.position(source, operand)
            if part is None or part.axis:
                return Unknown(0)
            pose = pose @ part.pose()
        if part is None:
            return Unknown(0)
        return replace(from_pose(pose), status=part.status, turn=part.turn, external=part.external)

    def key_of(self, source: Source, reference: Reference) -> str | None:
        """Return the key of a variable, its index resolved; None if the index is not known."""
        if reference.element is None:
            return reference.name
        index = reference.element
        if not index.isdigit():
            value = self._value(index) if NAME.fullmatch(index) else None
            if not isinstance(value, Number) or value.value != int(value.value):
                return None
            index = str(int(value.value))
        return f"{reference.name}[{int(index)}]"

    def _lookup(self, source: Source, reference: Reference) -> Known:
        key = self.key_of(source, reference)
        value = self._value(key) if key is not None else None
        if value is None and key is not None and reference.element is not None:
            value = self._value(reference.name)  # the whole array was changed
        if reference.field is not None:
            item = value.items.get(reference.field) if isinstance(value, Aggregate) else None
            value = self.evaluate(source, item) if item is not None else None
        return value if value is not None else Unknown(0)

    def position(self, source: Source, value: Value) -> Position | None:
        """Return the position that a value gives, or None when it is not known before the program runs.

        :raises ProgramError: it is known but not a valid position.
        """
        known = self.evaluate(source, value)
        if isinstance(known, Aggregate):
            return from_aggregate(known)
        return known if isinstance(known, Position) else None

    def number(self, source: Source, value: Value) -> float | None:
        """Return a number, or None when it is not known before the program runs."""
        known = self.evaluate(source, value)
        return known.value if isinstance(known, Number) else None

    def why_unknown(self, source: Source, value: Value) -> str:
        """Return why a value is not known, for a message."""
        if isinstance(value, Chain):
            for operand in value.operands:
                if self.position(source, operand) is None:
                    return self.why_unknown(source, operand)
        text = source.text[value.start : value.stop].strip()
        if isinstance(value, Opaque | Call) or (isinstance(value, Reference) and value.name.startswith("$")):
            return f"{text} is computed while the program runs"
        if isinstance(value, Reference):
            if self.key_of(source, value) is None:
                return f"the index of {text} is not known before the program runs"
            known = self._lookup(source, value)
            if isinstance(known, Unknown) and known.line:
                return f"{text} is changed while the program runs (line {known.line})"
            if isinstance(known, Unknown):
                return f"{text} has no value in the program, its .dat or the $config.dat"
        return f"{text} is not a position"

    def check_name(self, source: Source, reference: Reference) -> None:
        """Refuse a name that is longer than the controller accepts."""
        if len(reference.name) > MAX_LENGTH:
            raise source.error(f"the name {reference.name} is longer than {MAX_LENGTH} characters", reference.start)


def _key(name: str, index: str | None) -> str | None:
    if not index:
        return name.upper()
    digits = index.strip("[] \t")
    return f"{name.upper()}[{int(digits)}]" if digits.isdigit() else name.upper()


def _value_stop(source: Source, start: int, stop: int) -> int:
    """Return where an initial value ends; the end of the line where it cannot be read."""
    try:
        return parse(source, start, stop)[1]
    except ProgramError:
        return stop
