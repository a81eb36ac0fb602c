"""Variables with values known before run time: from the `.dat`, the `$config.dat`, the `.src` itself."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from typing import Protocol

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.decimals import without_negative_zero
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import MAX_LENGTH
from postproc.dialects.krl.language.positions import AXES, CARTESIAN, Position, from_aggregate, from_pose
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.values import (
    Aggregate,
    Call,
    Chain,
    Condition,
    Number,
    OpaqueText,
    Operation,
    Reference,
    UnreadableText,
    Value,
    Word,
    parts,
)
from postproc.dialects.krl.read.conditions import as_term, condition_value, matches_case
from postproc.dialects.krl.read.known import NO_VALUE, Scope, UnknownValue, UnparsedValue, VariableValue
from postproc.dialects.krl.read.state import RELEVANT
from postproc.errors import CellError, ProgramError
from postproc.frames import Array, inverse

_COMPONENTS = frozenset({*CARTESIAN, *AXES, "S", "T"})
_REAL = frozenset({*CARTESIAN, *AXES})
FUNCTIONS: dict[str, Callable[..., float]] = {
    "ABS": abs,
    "SQRT": math.sqrt,
    "SIN": lambda angle: math.sin(math.radians(angle)),
    "COS": lambda angle: math.cos(math.radians(angle)),
    "TAN": lambda angle: math.tan(math.radians(angle)),
    "ACOS": lambda number: math.degrees(math.acos(number)),
    "ATAN2": lambda y, x: math.degrees(math.atan2(y, x)),
}
"""Functions of the controller that give a number of numbers; angles in degrees."""
ZERO = Position((0.0,) * 6)
_SCALAR = (Number, Word)
_CONSTANT = (Number, Word, OpaqueText)
_EVALUATED = (Number, Position, Word, UnknownValue)
_WITHOUT_PARTS = (Number, Word, Position, UnknownValue, OpaqueText, UnreadableText)
ANGLES = CARTESIAN[3:]
WHOLE = "INT or REAL"
"""Type of a parameter without ``:IN`` whose argument has the other of these types: no source says which it is."""
LARGEST_INT = 2.0**31
"""INTs are below this: they have 32 bits."""
_OPERATIONS: dict[str, Callable[[float, float], float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
}
_ROUNDED = UnknownValue(why="to which side the quotient of negative INTs is rounded is in no source")
PARTLY_GIVEN = "not all of its components are given, and it had others"
"""Why a position is not known: it may keep the others or lack them, and a motion then keeps those of the robot."""
_MEMBER_ALONE = "its structure had no value as a whole: give all members at once before"
_BEYOND_INT = UnknownValue(why="what becomes of an INT beyond 32 bits is in no source")
_HALF = 1e-5
"""REALs that are closer than this share to the middle between two INTs may be rounded to either: they have fewer
digits on a controller."""
_TURN = 1e-3
"""Angles closer than this [deg] to 90° or 180° may be those of another set: a REAL has seven digits."""
_SET_BY_PROGRAMS = frozenset({"$OUT", "$ANOUT", "$ACC", "$VEL_AXIS", "$ACC_AXIS", "$ACT_BASE", "$ACT_TOOL", "$LOAD"})
_MOVING = ("$POS_", "$AXIS_")
"""What names of variables begin with that say where the robot is."""
FRAME_ARRAYS = frozenset({"BASE_DATA", "TOOL_DATA"})
"""Frames by number, which the cell and files may give."""
_SAME_PLACE = 1e-6
"""Frames closer than this [m] are equal: files and displays give three decimals of a millimetre."""
_SAME_ANGLE = math.radians(1e-3)
"""The same for orientations [rad]."""


def computed(operator: str, a: float, b: float, *, integer: bool) -> float | VariableValue:
    """Return a sum, difference, product or quotient of two numbers, or why it is not known.

    The quotient of two INTs has no decimal places (KUKA, Expert Programming); to which side those of a negative one
    are cut off is in no source, nor what becomes of an INT beyond 32 bits.

    :param integer: both are INTs.
    """
    if operator == "B_NOT":
        return -1.0 - b if integer else NO_VALUE
    if operator == "/" and b == 0.0:
        return NO_VALUE
    if operator == "/" and integer and a % b != 0.0:
        return _ROUNDED if a < 0.0 or b < 0.0 else a // b
    value = _OPERATIONS[operator](a, b)
    if integer and abs(value) >= LARGEST_INT:
        return _BEYOND_INT
    return value if math.isfinite(value) else NO_VALUE


class Functions(Protocol):
    """The functions that a program declares."""

    def pure(self, call: Call) -> bool:
        """Return whether a call gives a value and changes nothing, so that it does not matter when and how often."""

    def value(self, call: Call) -> VariableValue:
        """Return what a call gives that is `pure`."""


class _NoFunctions:
    def pure(self, call: Call) -> bool:
        return False

    def value(self, call: Call) -> VariableValue:
        return NO_VALUE


class Variables:
    """Values by name (upper case; elements as ``P[3]``), at one moment of the program's run.

    :ivar changes: how often a value was replaced by another one.
    :ivar types: declared type by name, upper case.
    :ivar structures: types of the members of each STRUC, upper case.
    :ivar public: names declared GLOBAL.
    :ivar scope: which variables the names of the present routine mean.
    :ivar changing: names that may change at any time, and what changes them.
    :ivar used: names that a motion, a frame or a speed depends on.
    :ivar changed: names that the program gives another value, and where first.
    :ivar given: values that the cell gives, by key.
    :ivar relied: keys of these that were asked for, by any run.
    :ivar initial: names that keep their values from run to run: those of data lists, BASE_DATA and TOOL_DATA.
    :ivar current: present value of one of the `RELEVANT` variables, or of a component of it (name, field); the settings
        in force have these, see `Settings`.
    :ivar functions: those of the program, see `calls`.
    :ivar late: first values, by key, of data lists that are read when the program first calls their file: they held
        from its beginning.
    :ivar reading_late: True while such a list is read.
    """

    def __init__(self, cell: Cell) -> None:
        self._values: dict[str, VariableValue | UnparsedValue] = {}
        self._elements: defaultdict[str, list[str]] = defaultdict(list)
        self.changes = 0
        self.types: dict[str, str] = {}
        self.structures: dict[str, dict[str, str]] = {}
        self.public: set[str] = set()
        self.scope = Scope()
        self.changing: dict[str, UnknownValue] = {}
        self.used: set[str] = set()
        self.changed: dict[str, str] = {}
        self.initial = set(FRAME_ARRAYS)
        self.current: Callable[[str, str | None], VariableValue] = _not_followed
        self.functions: Functions = _NoFunctions()
        self.late: dict[str, VariableValue | UnparsedValue] = {}
        self.reading_late = False
        self._stated = {f"{name}[0]": (ZERO, "the controller, whose number 0 is $NULLFRAME") for name in FRAME_ARRAYS}
        self.given = {key.upper(): _cell_value(value) for key, value in cell.krl.values.items()}
        _check_given(self.given)
        self.relied: set[str] = set()
        for number, base in cell.base_data.items():
            self._put_frame(f"BASE_DATA[{int(number)}]", from_pose(base.pose()), f"[base_data.{number}] of the cell")
        for number, tool in cell.tool_data.items():
            self._put_frame(f"TOOL_DATA[{int(number)}]", from_pose(tool.pose()), f"[tool_data.{number}] of the cell")
        for name in ("$NULLFRAME", "BASE_DATA[0]", "TOOL_DATA[0]"):
            self._values.setdefault(name, ZERO)

    def _put_frame(self, key: str, frame: Position, place: str) -> None:
        self.state_frame(key, frame, place)
        self.put(key, frame)

    def state_frame(self, key: str, value: VariableValue | UnparsedValue, place: str) -> None:
        """Note the frame that the cell or a file gives for ``BASE_DATA[n]`` or ``TOOL_DATA[n]``.

        Components that one of two frames lacks do not count. A value that cannot be read is not noted.

        :param place: for a message: the file and line, or the table of the cell.
        :raises CellError: another place gives another frame.
        """
        try:
            read = value.value if isinstance(value, UnparsedValue) else value
            frame = self.position(read)
        except ProgramError:  # an error where it is used
            return
        if frame is None:
            return
        first, other_place = self._stated.setdefault(key, (frame, place))
        if not _agree(first, frame):
            raise CellError(
                f"{key} has two values: {_frame_text(first)} by {other_place}, and {_frame_text(frame)} by {place}",
                advice="Make them equal, or remove the one that the controller does not have.",
            )

    def copied(self) -> Variables:
        """Return the same values, for another run; it notes in the same set which values of the cell it relies on."""
        duplicate = copy(self)
        duplicate._values, duplicate._elements = dict(self._values), defaultdict(list)
        for name, keys in self._elements.items():
            duplicate._elements[name] = list(keys)
        duplicate.types, duplicate.structures, duplicate.public = (
            dict(self.types),
            dict(self.structures),
            set(self.public),
        )
        duplicate.changing, duplicate.changed = dict(self.changing), dict(self.changed)
        duplicate.used, duplicate.initial = set(self.used), set(self.initial)
        duplicate.late = dict(self.late)
        return duplicate

    def take_given(self, name: str = "") -> None:
        """Set variables to the values of the cell; with a name, only that one and its elements."""
        for key, value in self.given.items():
            root = key.partition("[")[0]
            if not name or name == root:
                self.put(key, convert_to_type(value, self.types.get(root, "")))

    def put(self, key: str, value: VariableValue | UnparsedValue) -> None:
        """Store a value as it is. `set` converts those of assignments to the type of the variable."""
        is_new = key not in self._values
        self.changes += self._values.get(key) != value
        if self.reading_late:
            self.late[key] = value
        if is_new and key.endswith("]"):
            array, _, _ = key.partition("[")
            self._elements[array].append(key)
        self._values[key] = value

    def set(self, key: str, value: VariableValue, place: Place) -> None:
        """Set a variable to a value, converted to its type.

        :param place: where the program does.
        """
        name = key.partition("[")[0]
        if name not in self.changed:
            self.changed[name] = str(place)
        if isinstance(value, Number):
            value = convert_to_type(value, self.types.get(name, ""))
        elif isinstance(value, Aggregate) and self._ambiguous(key, value):
            value = UnknownValue(str(place), PARTLY_GIVEN)
        self.put(key, value)

    def _ambiguous(self, key: str, new: Aggregate) -> bool:
        """Return whether a position lacks components that the variable may have had.

        What becomes of these is not certain: they may stay, or count as missing.
        """
        names: tuple[str, ...] = ()
        if not new.items.keys().isdisjoint(_REAL):
            names = AXES if not new.items.keys().isdisjoint(AXES) else CARTESIAN
        missing_names = [name for name in names if name not in new.items]
        old = self.value(key)
        if not missing_names or old is None or old == NO_VALUE:
            return False
        return not isinstance(old, Aggregate) or any(name in old.items for name in missing_names)

    def set_field(self, key: str, field: str, value: VariableValue, place: Place) -> None:
        """Give one component of a variable a value (``XP1.X=5``)."""
        whole = self.value(key)
        name = key.partition("[")[0]
        if name not in self.changed:
            self.changed[name] = str(place)
        first = field.partition(".")[0].partition("[")[0]
        if isinstance(whole, Position) and field in CARTESIAN and not whole.axis and isinstance(value, Number):
            new_position = with_component(whole, field, value.value)
            self.put(key, UnknownValue(str(place)) if new_position is None else new_position)
        elif isinstance(whole, UnknownValue) and whole.why:
            return
        elif whole in (None, NO_VALUE) and not isinstance(value, UnknownValue):
            self.put(key, UnknownValue(str(place), _MEMBER_ALONE))
        elif not isinstance(whole, Aggregate):
            self.put(key, UnknownValue(str(place), value.why if isinstance(value, UnknownValue) else ""))
        elif "[" not in field and (new := _with_member(self, whole, field.split("."), value)) is not None:
            self.put(key, new)
        elif first not in _COMPONENTS:
            items = {**whole.items, first: OpaqueText(whole.start, whole.stop)}
            self.put(key, replace(whole, items=items, computed=True))
        else:
            self.put(key, UnknownValue(str(place), value.why if isinstance(value, UnknownValue) else ""))

    def forget(self, name: str, place: str) -> None:
        """Note that a variable (all its elements) has a value that is not known; variables of the controller without a
        value have none that is.
        """
        if name[0] == "$" and name not in self._values and name not in self._elements:
            return
        self.changed.setdefault(name, place)
        for key in (name, *self._elements.get(name, ())):
            self._values[key] = UnknownValue(place)

    def as_now(self) -> tuple[dict[str, VariableValue | UnparsedValue], dict[str, UnknownValue]]:
        """Return all values, for `as_then` and `meet`."""
        return dict(self._values), dict(self.changing)

    def as_then(self, snapshot: tuple[dict[str, VariableValue | UnparsedValue], dict[str, UnknownValue]]) -> None:
        """Give all variables the values that they had."""
        self._values, self.changing = self.late | snapshot[0], dict(snapshot[1])

    def meet(
        self, snapshot: tuple[dict[str, VariableValue | UnparsedValue], dict[str, UnknownValue]], place: str
    ) -> None:
        """Merge with the values of another branch: those that differ become unknown."""
        values, volatile_names = self.late | snapshot[0], snapshot[1]
        self.changing = volatile_names | self.changing
        for key in self._values.keys() | values.keys():
            if not self._have_same_value(self._values.get(key), values.get(key)):
                self._values[key] = UnknownValue(place)

    def differing(
        self, snapshot: tuple[dict[str, VariableValue | UnparsedValue], dict[str, UnknownValue]]
    ) -> frozenset[str]:
        """Return the names of variables whose values are not what they were."""
        values, volatile_names = self.late | snapshot[0], snapshot[1]
        keys = (key for key in self._values.keys() | values.keys())
        names = {
            key.partition("[")[0] for key in keys if not self._have_same_value(self._values.get(key), values.get(key))
        }
        return frozenset(names | (self.changing.keys() ^ volatile_names.keys()))

    def _have_same_value(self, first: object, second: object) -> bool:
        """Return whether two stored values are equal; an aggregate equals the unparsed text that it was read from."""
        if first is second or (not isinstance(first, Aggregate) and first == second):
            return True
        if isinstance(second, UnparsedValue):
            first, second = second, first
        if isinstance(first, UnparsedValue):
            if isinstance(second, Aggregate):
                is_same_text = second.source is first.source and second.row == first.row
                return is_same_text and not second.computed and first.start <= second.start < first.stop
            value = first.value
            return isinstance(value, Number) and isinstance(second, Number) and value.value == second.value
        if not isinstance(first, Aggregate) or not isinstance(second, Aggregate):
            return False
        return (first.source, first.row, first.start, first.computed, first.items.keys()) == (
            second.source,
            second.row,
            second.start,
            second.computed,
            second.items.keys(),
        ) and all(self._have_same_value(item, second.items[name]) for name, item in first.items.items())

    def literals(self, name: str, numbers: Sequence[int]) -> tuple[Source, list[tuple[int, int]]] | None:
        """Return the data list that gives elements of an array their values, and the spans of these; None if they have
        other values.
        """
        if name in self.changing or any(key.partition("[")[0] == name for key in self.given):
            return None
        spans, source = [], None
        for number in numbers:
            value = self._values.get(f"{name}[{number}]")
            if not isinstance(value, UnparsedValue | Aggregate) or (isinstance(value, Aggregate) and value.computed):
                return None
            if value.source is not (source := source or value.source) or source.index == 0 or value.row:
                return None
            spans.append((value.start, value.stop))
        return None if source is None else (source, spans)

    def numbers(self, name: str, indices: Iterable[int]) -> Array | None:
        """Return the numbers that elements of an array have; None if one of them is not known."""
        numbers = []
        for index in indices:
            value = self.value(f"{name}[{index}]")
            if not isinstance(value, Number):
                return None
            numbers.append(value.value)
        return np.array(numbers)

    def kept(self) -> dict[str, str]:
        """Return the names that keep their values from run to run and that the program changes, and where it does."""
        change_places = self.changed | {name: value.where for name, value in self.changing.items()}
        return {name: change_places[name] for name in sorted(self.initial & change_places.keys())}

    def next_run(self) -> Variables:
        """Return what the next run of the program begins with: data as this run leaves them, nothing else."""
        next_variables = copy(self)
        next_variables._values = {key: value for key, value in self._values.items() if self._persists(key)}
        next_variables._elements = self._elements.copy()
        (
            next_variables.scope,
            next_variables.changing,
            next_variables.used,
            next_variables.changed,
            next_variables.late,
        ) = Scope(), {}, set(), {}, {}
        for name in self.initial & self.changing.keys():
            next_variables.forget(name, self.changing[name].where)
        for name in {key.partition("[")[0] for key in self.given} - self.initial:
            next_variables.take_given(name)
        next_variables.changed = {}
        return next_variables

    def _persists(self, key: str) -> bool:
        return key[0] == "$" or key.partition("[")[0] in self.initial

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def value(self, key: str) -> VariableValue | None:
        """Return the value of a variable or an element, None where it has none."""
        if key[0] == "$" and (root := key.partition("[")[0]) in RELEVANT:
            return self.current(root, None)
        if self.changing and (name := key.partition("[")[0]) in self.changing:
            return self.changing[name]
        if key in self.given:
            self.relied.add(key)
        value = self._values.get(key)
        if isinstance(value, UnparsedValue):
            value = self.evaluate(value.value)
            if isinstance(value, Number):
                value = convert_to_type(value, self.types.get(key.partition("[")[0], ""))
            self._values[key] = value
        return value

    def evaluate(self, value: Value | VariableValue) -> VariableValue:
        """Return the present value; `UnknownValue` when that is not known before the program runs.

        :raises ProgramError: it cannot be read.
        """
        if isinstance(value, _EVALUATED):
            return value
        if isinstance(value, Reference):
            return self.value_of(value)
        if isinstance(value, Aggregate):
            return self._resolved(value)
        if isinstance(value, Operation):
            return self._computed(value)
        if isinstance(value, Chain):
            return self._product(value)
        if isinstance(value, Call):
            return self._function(value)
        if isinstance(value, Condition):
            return self._decided(value)
        if isinstance(value, UnreadableText):
            raise value.error
        return NO_VALUE

    def _resolved(self, aggregate: Aggregate) -> Aggregate:
        """Return an aggregate whose components have the values that they have now."""
        for item in aggregate.items.values():
            if not isinstance(item, _CONSTANT):
                break
        else:
            return aggregate
        items: dict[str, Value] = {}
        for name, item in aggregate.items.items():
            result = self.evaluate(item)
            items[name] = result if isinstance(result, Number | Word | Aggregate) else OpaqueText(*_span(item))
        if all(result is item for result, item in zip(items.values(), aggregate.items.values(), strict=True)):
            return aggregate
        return replace(aggregate, items=items, computed=True)

    def truth(self, condition: Value | None) -> bool | None:
        """Return whether a condition holds; None where that is not known before the program runs."""
        try:
            if condition is None or not all(map(self.functions.pure, calls([condition]))):
                return None
            value = as_term(self.evaluate(condition))
        except ProgramError:
            return None
        return value if isinstance(value, bool) else None

    def is_chosen_case(self, value: VariableValue, cases: Sequence[Value]) -> bool | None:
        """Return whether one of the values behind CASE is that of its SWITCH; None where that is not known."""
        equal: bool | None = False
        for case in cases:
            is_equal = matches_case(value, self.evaluate(case))
            if is_equal:
                return True
            equal = None if is_equal is None else equal
        return equal

    def _decided(self, condition: Condition) -> VariableValue:
        """Return the value of terms joined by comparisons and logic, or of one alone in brackets."""
        term_values = [self.evaluate(term) for term in condition.terms]
        if not condition.operators and not (condition.negated and condition.negated[0]):
            return term_values[0]
        value = condition_value(term_values, condition)
        if isinstance(value, bool):
            return Word(str(value).upper(), condition.start, condition.stop)
        if isinstance(value, _SCALAR):
            return value
        return next((term_value for term_value in term_values if isinstance(term_value, UnknownValue)), NO_VALUE)

    def _computed(self, operation: Operation) -> VariableValue:
        """Return a sum, difference, product or quotient, see `computed`."""
        left = Number(0.0, 0, 0, True) if operation.left is None else self.evaluate(operation.left)
        right = self.evaluate(operation.right)
        if not isinstance(left, Number) or not isinstance(right, Number):
            return next((side for side in (left, right) if isinstance(side, UnknownValue)), NO_VALUE)
        integer = left.integer and right.integer
        value = computed(operation.operator, left.value, right.value, integer=integer)
        return Number(value, operation.start, operation.stop, integer) if isinstance(value, int | float) else value

    def _function(self, call: Call) -> VariableValue:
        """Return the value of a call (angles in degrees) if its arguments alone determine it, else `NO_VALUE`."""
        function = FUNCTIONS.get(call.name)
        if function is None and call.name != "INV_POS":
            return self.functions.value(call) if self.functions.pure(call) else NO_VALUE
        argument_values = [self.evaluate(argument) for argument in call.arguments]
        numbers = [argument_value.value for argument_value in argument_values if isinstance(argument_value, Number)]
        if call.name == "INV_POS" and len(argument_values) == 1:
            position = self.position(argument_values[0])
            return NO_VALUE if position is None or position.axis else from_pose(inverse(position.pose()))
        if (
            function is None
            or len(numbers) < len(argument_values)
            or len(argument_values) != 1 + (call.name == "ATAN2")
        ):
            return NO_VALUE
        try:
            value = function(*numbers)
        except ValueError:
            return NO_VALUE
        integer = call.name == "ABS" and all(
            argument_value.integer for argument_value in argument_values if isinstance(argument_value, Number)
        )
        return Number(value, call.start, call.stop, integer)

    def _product(self, chain: Chain) -> VariableValue:
        """Return the position that a chain of frames gives: S, T and external axes are those of its last operand."""
        pose, part = np.eye(4), None
        for operand in chain.operands:
            part = self.position(operand)
            if part is None or part.axis or (isinstance(operand, Reference) and not part.complete):
                return NO_VALUE
            pose = pose @ part.pose()
        if part is None:
            return NO_VALUE
        return replace(from_pose(pose), status=part.status, turn=part.turn, external=part.external)

    def key_of(self, reference: Reference) -> str | None:
        """Return the key of a variable, its index resolved; None if the index is not known."""
        name = self.scope.stored(reference.name)
        if reference.indices is None:
            return name
        indices = [self.index(value) for value in reference.indices]
        if not indices or None in indices:
            return None
        return f"{name}[{','.join(map(str, indices))}]"

    def index(self, value: Value) -> int | None:
        """Return one index of an array, None if it is not known."""
        index = self.number(value)
        return None if index is None or index != int(index) else int(index)

    def value_of(self, reference: Reference) -> VariableValue:
        """Return the present value of a variable, or of an element or component; `NO_VALUE` if it has none."""
        if reference.name in RELEVANT:  # a setting of motions, such as $BASE
            return self.current(reference.name, reference.field)
        key = self.key_of(reference)
        value = self.value(key) if key is not None else None
        if value is None and key is not None and reference.indices is not None:
            value = self.value(self.scope.stored(reference.name))  # unknown where any element may have changed
        if isinstance(value, Aggregate) and reference.indices is not None and reference.name in self.scope.arrays:
            value = replace(value, computed=True)  # the text of its numbers belongs to a variable of another name
        if isinstance(value, Position) and reference.field in CARTESIAN and not value.axis:
            return component(value, reference.field)
        if reference.field is not None:
            value = self._member_of(value, reference.field)
            if isinstance(value, Number):
                value = self._member(reference, value)
        return value if value is not None else NO_VALUE

    def _member_of(self, value: VariableValue | None, path: str) -> VariableValue | None:
        """Return a member of a structure, or a member of that: ``F.X``; None if it has no value.

        Of a structure that was computed, the text of a member may be that of another variable.
        """
        computed = False
        for name in path.split("."):
            if isinstance(value, UnknownValue):
                return value
            item = value.items.get(name) if isinstance(value, Aggregate) else None
            if item is None or not isinstance(value, Aggregate):
                return None
            computed |= value.computed
            value = self.evaluate(item)
        return replace(value, computed=True) if computed and isinstance(value, Aggregate) else value

    def _member(self, reference: Reference, number: Number) -> VariableValue:
        """Return a number converted to the type of a member of a structure."""
        kind = self.kind(reference)
        return convert_to_type(number, kind) if kind else number

    def kind(self, reference: Reference) -> str:
        """Return the declared type of a variable, an element or a member, upper case; empty if it is not known."""
        kind = self.types.get(self.scope.stored(reference.name), "")
        for name in () if reference.field is None else reference.field.split("."):
            members = self.structures.get(kind)
            if members is not None:
                kind = members.get(name, "")
            else:
                kind = "REAL" if name in _REAL else ""
        return kind

    def position(self, value: Value | VariableValue) -> Position | None:
        """Return the position that a value gives, or None when it is not known before the program runs.

        :raises ProgramError: it is known but not a valid position.
        """
        result = self.evaluate(value)
        if isinstance(result, Aggregate):
            return from_aggregate(result)
        return result if isinstance(result, Position) else None

    def number(self, value: Value | VariableValue) -> float | None:
        """Return a number, or None when it is not known before the program runs."""
        result = self.evaluate(value)
        return result.value if isinstance(result, Number) else None

    def rely(self, value: Value | VariableValue) -> None:
        """Note which names a motion, a frame or a speed depends on."""
        if isinstance(value, Reference):
            self.used.add(self.scope.stored(value.name))
        if not isinstance(value, _WITHOUT_PARTS):
            for part in parts(value):
                self.rely(part)

    def argument(self, call: Call, field: str) -> Value | VariableValue | None:
        """Return the first argument of a call, of a structure the component in question: None where it says nothing."""
        if not call.arguments:
            return NO_VALUE
        result = self.evaluate(call.arguments[0])
        if isinstance(result, Aggregate):
            return result.items.get(field)
        return call.arguments[0] if isinstance(result, UnknownValue) else result

    def check_name(self, source: Source, reference: Reference) -> None:
        """Refuse a name that is longer than the controller accepts."""
        if len(reference.name) > MAX_LENGTH:
            raise source.error(
                f"the name {reference.name} is longer than {MAX_LENGTH} characters",
                reference.start,
                advice="Give the variable a shorter name.",
            )


def _not_followed(name: str, field: str | None) -> VariableValue:
    return NO_VALUE


def _check_given(keys: Iterable[str]) -> None:
    """Refuse values of the cell for variables that the program sets, or that the reader follows.

    :raises CellError: there is one.
    """
    for key in keys:
        name = key.partition("[")[0].partition(".")[0]
        if name in RELEVANT or name in _SET_BY_PROGRAMS or name.startswith(_MOVING):
            raise CellError(
                f"[krl.values] cannot give {key}: the program changes it while it runs",
                advice="Give inputs such as $IN[5], parameters and variables of the program.",
            )


def component(position: Position, field: str) -> VariableValue:
    """Return a component of a Cartesian position that was computed.

    A, B and C are known only where one set of them describes the orientation: which of two sets the controller has is
    in no source.
    """
    value = position.values[CARTESIAN.index(field)]
    if field in ANGLES and not _one_set(position):
        return UnknownValue(why=f"two sets of A, B, C describe this orientation, and {field} may be that of either")
    return Number(value, 0, 0, False)


def with_component(position: Position, field: str, value: float) -> Position | None:
    """Return a Cartesian position that was computed with another component.

    :returns: None if it is an angle, and the others may be those of another set of A, B, C.
    """
    if field in ANGLES and not _one_set(position, whole_turns=True):
        return None
    values = list(position.values)
    values[CARTESIAN.index(field)] = value
    return replace(position, values=tuple(values), aggregate=None)


def _one_set(position: Position, *, whole_turns: bool = False) -> bool:
    """Return whether one set of A, B, C alone describes an orientation.

    :param whole_turns: sets that differ by whole turns of one angle count as one.
    """
    a, b, c = position.values[3:]
    return abs(b) < 90.0 - _TURN and (whole_turns or (abs(a) < 180.0 - _TURN and abs(c) < 180.0 - _TURN))


def _with_member(variables: Variables, whole: Aggregate, path: Sequence[str], value: VariableValue) -> Aggregate | None:
    """Return a structure with another value of a member, or of a member of that; None if that is not known.

    What becomes of components that a position lacks and had before is not certain.
    """
    name, *inner_path = path
    item = whole.items.get(name)
    old = None if item is None else variables.evaluate(item)
    member: VariableValue | None = value
    if inner_path:
        member = _with_member(variables, old, inner_path, value) if isinstance(old, Aggregate) else None
    elif isinstance(value, Aggregate) and isinstance(old, Aggregate) and not old.items.keys() <= value.items.keys():
        return None
    if not isinstance(member, (Number, Word, Aggregate)):
        return None
    return replace(whole, items={**whole.items, name: member}, computed=True)


def _agree(frame: Position, other_frame: Position) -> bool:
    """Return whether two frames are equal within rounding."""
    if frame.axis or other_frame.axis:
        return False
    pairs = list(zip(frame.values, other_frame.values, strict=True))
    a = Position(tuple(x if x == x else y for x, y in pairs)).pose()
    b = Position(tuple(y if y == y else x for x, y in pairs)).pose()
    difference = np.abs(a - b)
    return bool(difference[:3, 3].max() < _SAME_PLACE and difference[:3, :3].max() < _SAME_ANGLE)


def _frame_text(frame: Position) -> str:
    """Return the given components of a frame as KRL writes them, for messages [mm, deg]."""
    names = AXES if frame.axis else CARTESIAN
    components = [
        f"{name} {without_negative_zero(value):.10g}"
        for name, value in zip(names, np.round(frame.values, 6), strict=True)
    ]
    return f"{{{', '.join(component for component in components if not component.endswith('nan'))}}}"


def _cell_value(value: float) -> Number | Word:
    """Return a value of the cell as KRL has it: a BOOL, an INT or a REAL."""
    if isinstance(value, bool):
        return Word(str(value).upper(), 0, 0)
    return Number(float(value), 0, 0, isinstance(value, int))


def convert_to_type(value: VariableValue, kind: str) -> VariableValue:
    """Return a value converted to the type of a variable: a REAL is rounded to an INT (KUKA, Expert Programming).

    :param kind: its type, upper case; empty if that is not known; `WHOLE` if it is REAL or INT.
    """
    if not isinstance(value, Number) or kind == "REAL":
        return replace(value, integer=False) if isinstance(value, Number) else value
    whole = value.value == int(value.value)
    if kind == WHOLE and not whole:
        return UnknownValue(why=f"whether {value.value:g} is rounded to an INT is in no source")
    if kind in ("INT", WHOLE) and abs(value.value) >= LARGEST_INT:
        return _BEYOND_INT
    if kind == "INT" and not whole:
        nearest = round(value.value)
        if abs(abs(value.value - nearest) - 0.5) < _HALF * max(1.0, abs(value.value)):
            return UnknownValue(why=f"to which side {value.value:g} is rounded is in no source")
        return replace(value, value=float(nearest), integer=True)
    return replace(value, integer=whole)


def _span(value: Value) -> tuple[int, int]:
    """Return offsets of the first character of a value and behind its last."""
    return value.start, value.stop
