"""Variables with values known before run time: from the `.dat`, the `$config.dat`, the `.src` itself."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from typing import NamedTuple, Protocol

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.decimals import without_negative_zero
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import MAX_LENGTH
from postproc.dialects.krl.language.positions import (
    AXES,
    CARTESIAN,
    Position,
    position_from_aggregate,
    position_from_pose,
)
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
_UNKNOWN_ROUNDING = UnknownValue(reason="to which side the quotient of negative INTs is rounded is in no source")
PARTLY_GIVEN = "not all of its components are given, and it had others"
"""Why a position is not known: it may keep the others or lack them, and a motion then keeps those of the robot."""
_LONE_MEMBER = "its structure had no value as a whole: give all members at once before"
_BEYOND_INT = UnknownValue(reason="what becomes of an INT beyond 32 bits is in no source")
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


def operation_result(operator: str, a: float, b: float, *, integer: bool) -> float | VariableValue:
    """Return a sum, difference, product or quotient of two numbers; an `UnknownValue` if it is not known.

    The quotient of two INTs has no decimal places (KUKA, Expert Programming). No source says to which side that of a
    negative INT is rounded, nor what becomes of an INT beyond 32 bits.

    :param operator: ``+ - * /``, or ``B_NOT`` of `b` alone.
    :param integer: both are INTs.
    """
    if operator == "B_NOT":
        return -1.0 - b if integer else NO_VALUE
    if operator == "/" and b == 0.0:
        return NO_VALUE
    if operator == "/" and integer and a % b != 0.0:
        return _UNKNOWN_ROUNDING if a < 0.0 or b < 0.0 else a // b
    value = _OPERATIONS[operator](a, b)
    if integer and abs(value) >= LARGEST_INT:
        return _BEYOND_INT
    return value if math.isfinite(value) else NO_VALUE


class Functions(Protocol):
    """The functions that a program declares."""

    def is_pure(self, call: Call) -> bool:
        """Return whether a call gives a value and changes nothing, so that it does not matter when and how often."""

    def value(self, call: Call) -> VariableValue:
        """Return what a call gives that is `is_pure`."""


class Snapshot(NamedTuple):
    """Values of variables at one moment.

    :ivar values: by stored name; elements as ``P[3]``.
    :ivar volatile_values: names that may change at any time, and what changes them.
    """

    values: dict[str, VariableValue | UnparsedValue]
    volatile_values: dict[str, UnknownValue]


class _NoFunctions:
    """The functions of a program that declares none."""

    def is_pure(self, call: Call) -> bool:
        """Return False: the function is not known."""
        return False

    def value(self, call: Call) -> VariableValue:
        """Return `NO_VALUE`: the function is not known."""
        return NO_VALUE


class Variables:
    """Values by name (upper case; elements as ``P[3]``), at one moment of the program's run.

    :ivar change_count: how often a value was replaced by another one.
    :ivar types: declared type by name, upper case.
    :ivar structures: types of the members of each STRUC, upper case.
    :ivar global_names: names declared GLOBAL.
    :ivar scope: which variables the names of the present routine mean.
    :ivar volatile_values: names that may change at any time, and what changes them.
    :ivar used_names: names that a motion, a frame or a speed depends on.
    :ivar change_places: names that the program gives another value, and where first.
    :ivar cell_values: values that the cell gives, by key.
    :ivar used_cell_values: keys of these that any run has read.
    :ivar persistent_names: names that keep their values from run to run: those of data lists, BASE_DATA and TOOL_DATA.
    :ivar setting_value: function that returns the present value of one of the `RELEVANT` variables, or of one of its
        components, by name and component (None: the whole); see `Settings.current_value`.
    :ivar functions: those of the program, see `calls`.
    :ivar late_values: initial values, by key, of data lists that are read when the program first calls their file; they
        have held since the program began.
    :ivar reads_late_list: True while such a list is read.
    """

    def __init__(self, cell: Cell) -> None:
        """Begin with the values that the cell gives: variables, BASE_DATA and TOOL_DATA.

        :raises CellError: it gives a variable that it may not.
        """
        self._values: dict[str, VariableValue | UnparsedValue] = {}
        self._elements: defaultdict[str, list[str]] = defaultdict(list)
        self.change_count = 0
        self.types: dict[str, str] = {}
        self.structures: dict[str, dict[str, str]] = {}
        self.global_names: set[str] = set()
        self.scope = Scope()
        self.volatile_values: dict[str, UnknownValue] = {}
        self.used_names: set[str] = set()
        self.change_places: dict[str, str] = {}
        self.persistent_names = set(FRAME_ARRAYS)
        self.setting_value: Callable[[str, str | None], VariableValue] = _unknown_setting
        self.functions: Functions = _NoFunctions()
        self.late_values: dict[str, VariableValue | UnparsedValue] = {}
        self.reads_late_list = False
        self._stated = {f"{name}[0]": (ZERO, "the controller, whose number 0 is $NULLFRAME") for name in FRAME_ARRAYS}
        self.cell_values = {key.upper(): _cell_value(value) for key, value in cell.krl.values.items()}
        _check_cell_values(self.cell_values)
        self.used_cell_values: set[str] = set()
        for table, frames in (("base_data", cell.base_data), ("tool_data", cell.tool_data)):
            for number, frame in frames.items():
                key = f"{table.upper()}[{int(number)}]"
                self._put_frame(key, position_from_pose(frame.pose()), f"[{table}.{number}] of the cell")
        for name in ("$NULLFRAME", "BASE_DATA[0]", "TOOL_DATA[0]"):
            self._values.setdefault(name, ZERO)

    def _put_frame(self, key: str, frame: Position, place: str) -> None:
        """Store a frame that the cell gives; `place` is its table in the cell."""
        self.note_frame(key, frame, place)
        self.put(key, frame)

    def note_frame(self, key: str, value: VariableValue | UnparsedValue, place: str) -> None:
        """Note the frame that the cell or a file gives for ``BASE_DATA[n]`` or ``TOOL_DATA[n]``.

        Components that one of two frames lacks do not count. A value that cannot be read is not noted.

        :param key: stored name of the element.
        :param place: for a message: the file and line, or the table of the cell.
        :raises CellError: another place gives another frame.
        """
        try:
            parsed_value = value.value if isinstance(value, UnparsedValue) else value
            frame = self.position(parsed_value)
        except ProgramError:  # an error where it is used
            return
        if frame is None:
            return
        stated_frame, other_place = self._stated.setdefault(key, (frame, place))
        if not _are_equal_frames(stated_frame, frame):
            raise CellError(
                f"{key} has two values: {_frame_text(stated_frame)} by {other_place}, "
                f"and {_frame_text(frame)} by {place}",
                advice="Make them equal, or remove the one that the controller does not have.",
            )

    def copy_for_run(self) -> Variables:
        """Return a copy for another run; both note in one set which values of the cell they rely on."""
        duplicate = copy(self)
        duplicate._values, duplicate._elements = dict(self._values), defaultdict(list)
        for name, keys in self._elements.items():
            duplicate._elements[name] = list(keys)
        duplicate.types, duplicate.structures = dict(self.types), dict(self.structures)
        duplicate.global_names, duplicate.used_names = set(self.global_names), set(self.used_names)
        duplicate.volatile_values, duplicate.change_places = dict(self.volatile_values), dict(self.change_places)
        duplicate.persistent_names, duplicate.late_values = set(self.persistent_names), dict(self.late_values)
        return duplicate

    def take_cell_values(self, name: str = "") -> None:
        """Set variables to the values that the cell gives.

        :param name: stored name of the only variable to set, with its elements; empty: all.
        """
        for key, value in self.cell_values.items():
            root = key.partition("[")[0]
            if not name or name == root:
                self.put(key, convert_to_type(value, self.types.get(root, "")))

    def put(self, key: str, value: VariableValue | UnparsedValue) -> None:
        """Store a value unchanged; `set` converts the values of assignments to the type of the variable.

        :param key: stored name of the variable, or of an element, as ``P[3]``.
        """
        is_new = key not in self._values
        self.change_count += self._values.get(key) != value
        if self.reads_late_list:
            self.late_values[key] = value
        if is_new and key.endswith("]"):
            array, _, _ = key.partition("[")
            self._elements[array].append(key)
        self._values[key] = value

    def set(self, key: str, value: VariableValue, place: Place) -> None:
        """Set a variable to the value of an assignment, converted to its type.

        :param key: stored name of the variable, or of an element, as ``P[3]``.
        :param place: the assignment.
        """
        name = key.partition("[")[0]
        if name not in self.change_places:
            self.change_places[name] = str(place)
        if isinstance(value, Number):
            value = convert_to_type(value, self.types.get(name, ""))
        elif isinstance(value, Aggregate) and self._is_ambiguous(key, value):
            value = UnknownValue(str(place), PARTLY_GIVEN)
        self.put(key, value)

    def _is_ambiguous(self, key: str, new_position: Aggregate) -> bool:
        """Return whether a new position lacks components that the variable may have.

        It is not certain what becomes of these: they may stay, or count as missing.
        """
        names: tuple[str, ...] = ()
        if not new_position.items.keys().isdisjoint(_REAL):
            names = AXES if not new_position.items.keys().isdisjoint(AXES) else CARTESIAN
        missing_names = [name for name in names if name not in new_position.items]
        old_value = self.value(key)
        if not missing_names or old_value is None or old_value == NO_VALUE:
            return False
        return not isinstance(old_value, Aggregate) or any(name in old_value.items for name in missing_names)

    def set_field(self, key: str, field: str, value: VariableValue, place: Place) -> None:
        """Set one component of a variable, as ``XP1.X=5`` does.

        :param key: of the variable.
        :param field: path of the component, such as ``X`` or ``F.X``.
        :param place: the assignment.
        """
        old_value = self.value(key)
        name = key.partition("[")[0]
        if name not in self.change_places:
            self.change_places[name] = str(place)
        if not isinstance(old_value, UnknownValue) or not old_value.reason:
            self.put(key, self._with_field(old_value, field, value, place))

    def _with_field(
        self, old_value: VariableValue | None, field: str, value: VariableValue, place: Place
    ) -> VariableValue:
        """Return the value that a variable has after an assignment to one of its components, see `set_field`.

        :param old_value: of the whole variable; None if it has none.
        :returns: an `UnknownValue` if it is not known.
        """
        unknown = UnknownValue(str(place), value.reason if isinstance(value, UnknownValue) else "")
        if isinstance(old_value, Position) and not old_value.is_axis and field in CARTESIAN:
            new_position = with_component(old_value, field, value.value) if isinstance(value, Number) else None
            return unknown if new_position is None else new_position
        if old_value in (None, NO_VALUE) and not isinstance(value, UnknownValue):
            return UnknownValue(str(place), _LONE_MEMBER)
        if not isinstance(old_value, Aggregate):
            return unknown
        if "[" not in field:
            new_structure = _structure_with_member(self, old_value, field.split("."), value)
            if new_structure is not None:
                return new_structure
        member = field.partition(".")[0].partition("[")[0]
        if member in _COMPONENTS:
            return unknown
        items = {**old_value.items, member: OpaqueText(old_value.start, old_value.stop)}
        return replace(old_value, items=items, is_computed=True)  # the other members keep their values

    def forget(self, name: str, place: str) -> None:
        """Mark a variable and all its elements as unknown.

        Variables of the controller that have no value stay as they are.

        :param place: what changes the variable, for messages.
        """
        if name[0] == "$" and name not in self._values and name not in self._elements:
            return
        self.change_places.setdefault(name, place)
        for key in (name, *self._elements.get(name, ())):
            self._values[key] = UnknownValue(place)

    def snapshot(self) -> Snapshot:
        """Return all values, for `restore` and `merge`."""
        return Snapshot(dict(self._values), dict(self.volatile_values))

    def restore(self, snapshot: Snapshot) -> None:
        """Give all variables the values of a snapshot."""
        self._values, self.volatile_values = self.late_values | snapshot.values, dict(snapshot.volatile_values)

    def merge(self, snapshot: Snapshot, place: str) -> None:
        """Mark as unknown the variables whose values differ from those of a snapshot: that of another branch.

        :param place: the join of the branches, for messages.
        """
        values, volatile_names = self.late_values | snapshot.values, snapshot.volatile_values
        self.volatile_values = volatile_names | self.volatile_values
        for key in self._values.keys() | values.keys():
            if not self._have_same_value(self._values.get(key), values.get(key)):
                self._values[key] = UnknownValue(place)

    def differing_names(self, snapshot: Snapshot) -> frozenset[str]:
        """Return the names of variables whose values differ from those of a snapshot."""
        values, volatile_names = self.late_values | snapshot.values, snapshot.volatile_values
        keys = self._values.keys() | values.keys()
        names = {
            key.partition("[")[0] for key in keys if not self._have_same_value(self._values.get(key), values.get(key))
        }
        return frozenset(names | (self.volatile_values.keys() ^ volatile_names.keys()))

    def _have_same_value(self, first: object, second: object) -> bool:
        """Return whether two stored values are equal; an aggregate equals the unparsed text that it was read from."""
        if first is second or (not isinstance(first, Aggregate) and first == second):
            return True
        if isinstance(second, UnparsedValue):
            first, second = second, first
        if isinstance(first, UnparsedValue):
            if isinstance(second, Aggregate):
                is_same_text = second.source is first.source and second.row == first.row
                return is_same_text and not second.is_computed and first.start <= second.start < first.stop
            value = first.value
            return isinstance(value, Number) and isinstance(second, Number) and value.value == second.value
        if not isinstance(first, Aggregate) or not isinstance(second, Aggregate):
            return False
        is_same_text = first.source is second.source and first.row == second.row and first.start == second.start
        if not is_same_text or first.is_computed != second.is_computed or first.items.keys() != second.items.keys():
            return False
        return all(self._have_same_value(item, second.items[name]) for name, item in first.items.items())

    def data_spans(self, name: str, numbers: Sequence[int]) -> tuple[Source, list[tuple[int, int]]] | None:
        """Return the data list that gives elements of an array their values, and the spans of these values in it.

        :param name: stored name of the array.
        :param numbers: indices of the elements.
        :returns: the file, and first offset and offset behind of each value; None if an element has another value, or
            may have.
        """
        if name in self.volatile_values or any(key.partition("[")[0] == name for key in self.cell_values):
            return None
        spans, source = [], None
        for number in numbers:
            value = self._values.get(f"{name}[{number}]")
            if not isinstance(value, UnparsedValue | Aggregate) or (isinstance(value, Aggregate) and value.is_computed):
                return None
            source = source or value.source
            if value.source is not source or source.index == 0 or value.row > 0:  # the program itself assigns it
                return None
            spans.append((value.start, value.stop))
        return None if source is None else (source, spans)

    def numbers(self, name: str, indices: Iterable[int]) -> Array | None:
        """Return the numbers (n,) in n elements of an array; None if one of them is not known.

        :param name: stored name of the array.
        :param indices: of the elements, as the program counts them.
        """
        numbers = []
        for index in indices:
            value = self.value(f"{name}[{index}]")
            if not isinstance(value, Number):
                return None
            numbers.append(value.value)
        return np.array(numbers)

    def changed_data(self) -> dict[str, str]:
        """Return the variables that keep their values from run to run and that the program changes.

        :returns: stored name → the place that changes it, as text.
        """
        change_places = self.change_places | {name: value.change_place for name, value in self.volatile_values.items()}
        return {name: change_places[name] for name in sorted(self.persistent_names & change_places.keys())}

    def next_run(self) -> Variables:
        """Return the variables as the next run of the program finds them.

        Variables of data lists and of the controller keep the values that this run leaves; others have none.
        """
        next_variables = copy(self)
        next_variables._values = {key: value for key, value in self._values.items() if self._is_kept_between_runs(key)}
        next_variables._elements = self._elements.copy()
        next_variables.scope, next_variables.used_names = Scope(), set()
        next_variables.volatile_values, next_variables.change_places, next_variables.late_values = {}, {}, {}
        for name in self.persistent_names & self.volatile_values.keys():
            next_variables.forget(name, self.volatile_values[name].change_place)
        for name in {key.partition("[")[0] for key in self.cell_values} - self.persistent_names:
            next_variables.take_cell_values(name)
        next_variables.change_places = {}  # without those that `forget` has noted: they are of this run
        return next_variables

    def _is_kept_between_runs(self, key: str) -> bool:
        """Return whether a variable keeps its value from one run of the program to the next."""
        return key[0] == "$" or key.partition("[")[0] in self.persistent_names

    def __contains__(self, key: str) -> bool:
        """Return whether a value is stored under a name."""
        return key in self._values

    def value(self, key: str) -> VariableValue | None:
        """Return the value of a variable or an element by its stored name; None if it has none.

        A value that is not parsed yet is parsed, and stored.

        :raises ProgramError: it cannot be read.
        """
        if key[0] == "$" and (root := key.partition("[")[0]) in RELEVANT:
            return self.setting_value(root, None)
        if self.volatile_values and (name := key.partition("[")[0]) in self.volatile_values:
            return self.volatile_values[name]
        if key in self.cell_values:
            self.used_cell_values.add(key)
        value = self._values.get(key)
        if isinstance(value, UnparsedValue):
            value = self.evaluate(value.value)
            if isinstance(value, Number):
                value = convert_to_type(value, self.types.get(key.partition("[")[0], ""))
            self._values[key] = value
        return value

    def evaluate(self, value: Value | VariableValue) -> VariableValue:
        """Return the value that an expression has now; an `UnknownValue` if it is not known before the program runs.

        :raises ProgramError: the expression cannot be read.
        """
        if isinstance(value, _EVALUATED):
            return value
        if isinstance(value, Reference):
            return self.value_of(value)
        if isinstance(value, Aggregate):
            return self._evaluate_aggregate(value)
        if isinstance(value, Operation):
            return self._evaluate_operation(value)
        if isinstance(value, Chain):
            return self._evaluate_chain(value)
        if isinstance(value, Call):
            return self._evaluate_call(value)
        if isinstance(value, Condition):
            return self._evaluate_condition(value)
        if isinstance(value, UnreadableText):
            raise value.error
        return NO_VALUE

    def _evaluate_aggregate(self, aggregate: Aggregate) -> Aggregate:
        """Return an aggregate with the present values of its components.

        Components without a known value become `OpaqueText`.
        """
        for item in aggregate.items.values():  # a loop: `all` takes longer, and nearly all aggregates are constant
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
        return replace(aggregate, items=items, is_computed=True)

    def truth(self, condition: Value | None) -> bool | None:
        """Return whether a condition holds; None if that is not known before the program runs."""
        try:
            if condition is None or not all(map(self.functions.is_pure, calls([condition]))):
                return None
            value = as_term(self.evaluate(condition))
        except ProgramError:
            return None
        return value if isinstance(value, bool) else None

    def is_chosen_case(self, value: VariableValue, cases: Sequence[Value]) -> bool | None:
        """Return whether a value of a SWITCH is among the values behind one CASE (`cases`); None if it is not known."""
        is_chosen: bool | None = False
        for case in cases:
            is_equal = matches_case(value, self.evaluate(case))
            if is_equal:
                return True
            is_chosen = None if is_equal is None else is_chosen
        return is_chosen

    def _evaluate_condition(self, condition: Condition) -> VariableValue:
        """Return the value of terms joined by comparisons and logic, or of a single term in brackets."""
        term_values = [self.evaluate(term) for term in condition.terms]
        if not condition.operators and not (condition.negated and condition.negated[0]):
            return term_values[0]
        value = condition_value(term_values, condition)
        if isinstance(value, bool):
            return Word(str(value).upper(), condition.start, condition.stop)
        if isinstance(value, _SCALAR):
            return value
        return next((term_value for term_value in term_values if isinstance(term_value, UnknownValue)), NO_VALUE)

    def _evaluate_operation(self, operation: Operation) -> VariableValue:
        """Return a sum, difference, product or quotient, see `operation_result`."""
        left = Number(0.0, 0, 0, True) if operation.left is None else self.evaluate(operation.left)
        right = self.evaluate(operation.right)
        if not isinstance(left, Number) or not isinstance(right, Number):
            return next((side for side in (left, right) if isinstance(side, UnknownValue)), NO_VALUE)
        integer = left.is_integer and right.is_integer
        value = operation_result(operation.operator, left.value, right.value, integer=integer)
        return Number(value, operation.start, operation.stop, integer) if isinstance(value, int | float) else value

    def _evaluate_call(self, call: Call) -> VariableValue:
        """Return the value of a function call, angles in degrees.

        :returns: `NO_VALUE` if its arguments alone do not determine it.
        """
        function = FUNCTIONS.get(call.name)
        if function is None and call.name != "INV_POS":
            return self.functions.value(call) if self.functions.is_pure(call) else NO_VALUE
        argument_values = [self.evaluate(argument) for argument in call.arguments]
        if len(argument_values) != (2 if call.name == "ATAN2" else 1):
            return NO_VALUE
        if function is None:  # INV_POS
            position = self.position(argument_values[0])
            return NO_VALUE if position is None or position.is_axis else position_from_pose(inverse(position.pose()))
        numbers = [value for value in argument_values if isinstance(value, Number)]
        if len(numbers) < len(argument_values):
            return NO_VALUE
        try:
            result = function(*(number.value for number in numbers))
        except ValueError:  # outside of its domain, as the root of −1
            return NO_VALUE
        return Number(result, call.start, call.stop, call.name == "ABS" and numbers[0].is_integer)

    def _evaluate_chain(self, chain: Chain) -> VariableValue:
        """Return the position of frames that are joined by ``:``; `NO_VALUE` if it is not known.

        Status, turn and external axes are those of the last operand.
        """
        pose, position = np.eye(4), None
        for operand in chain.operands:
            position = self.position(operand)
            if position is None or position.is_axis or (isinstance(operand, Reference) and not position.is_complete):
                return NO_VALUE
            pose = pose @ position.pose()
        if position is None:
            return NO_VALUE
        return replace(position_from_pose(pose), status=position.status, turn=position.turn, external=position.external)

    def key_of(self, reference: Reference) -> str | None:
        """Return the key of a variable, its index resolved; None if the index is not known."""
        name = self.scope.stored_name(reference.name)
        if reference.indices is None:
            return name
        indices = [self.index(value) for value in reference.indices]
        if not indices or None in indices:
            return None
        return f"{name}[{','.join(map(str, indices))}]"

    def index(self, value: Value) -> int | None:
        """Return the value of one index of an array; None if it is not known, or is no whole number."""
        index = self.number(value)
        return None if index is None or index != int(index) else int(index)

    def value_of(self, reference: Reference) -> VariableValue:
        """Return the present value of a variable, an element or a component; `NO_VALUE` if it has none."""
        if reference.name in RELEVANT:  # a setting of motions, such as $BASE
            return self.setting_value(reference.name, reference.field)
        key = self.key_of(reference)
        value = self.value(key) if key is not None else None
        if value is None and key is not None and reference.indices is not None:
            value = self.value(self.scope.stored_name(reference.name))  # unknown where any element may have changed
        if isinstance(value, Aggregate) and reference.indices is not None and reference.name in self.scope.array_names:
            value = replace(value, is_computed=True)  # the text of its numbers belongs to a variable of another name
        if isinstance(value, Position) and reference.field in CARTESIAN and not value.is_axis:
            return component(value, reference.field)
        if reference.field is not None:
            value = self._member_of(value, reference.field)
            if isinstance(value, Number):
                value = self._convert_member(reference, value)
        return value if value is not None else NO_VALUE

    def _member_of(self, value: VariableValue | None, path: str) -> VariableValue | None:
        """Return a member of a structure by its path, such as ``F.X``; None if it has no value.

        A member of a computed structure counts as computed too: its text may be that of another variable.
        """
        is_computed = False
        for name in path.split("."):
            if isinstance(value, UnknownValue):
                return value
            item = value.items.get(name) if isinstance(value, Aggregate) else None
            if item is None or not isinstance(value, Aggregate):
                return None
            is_computed |= value.is_computed
            value = self.evaluate(item)
        return replace(value, is_computed=True) if is_computed and isinstance(value, Aggregate) else value

    def _convert_member(self, reference: Reference, number: Number) -> VariableValue:
        """Return a number converted to the type of a member of a structure."""
        kind = self.type_of(reference)
        return convert_to_type(number, kind) if kind else number

    def type_of(self, reference: Reference) -> str:
        """Return the declared type of a variable, an element or a member, upper case; empty if it is not known."""
        kind = self.types.get(self.scope.stored_name(reference.name), "")
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
            return position_from_aggregate(result)
        return result if isinstance(result, Position) else None

    def number(self, value: Value | VariableValue) -> float | None:
        """Return a number, or None when it is not known before the program runs."""
        result = self.evaluate(value)
        return result.value if isinstance(result, Number) else None

    def note_dependence(self, value: Value | VariableValue) -> None:
        """Note the variables in a value on which a motion, a frame or a speed depends."""
        if isinstance(value, Reference):
            self.used_names.add(self.scope.stored_name(value.name))
        if not isinstance(value, _WITHOUT_PARTS):
            for part in parts(value):
                self.note_dependence(part)

    def first_argument(self, call: Call, field: str) -> Value | VariableValue | None:
        """Return the first argument of a call; if it is a structure, one component of it.

        :param field: that component.
        :returns: `NO_VALUE` without an argument; None if the structure lacks the component.
        """
        if not call.arguments:
            return NO_VALUE
        result = self.evaluate(call.arguments[0])
        if isinstance(result, Aggregate):
            return result.items.get(field)
        return call.arguments[0] if isinstance(result, UnknownValue) else result

    def check_name(self, source: Source, reference: Reference) -> None:
        """Refuse a variable whose name is longer than the controller accepts.

        :raises ProgramError: it is.
        """
        if len(reference.name) > MAX_LENGTH:
            raise source.error(
                f"the name {reference.name} is longer than {MAX_LENGTH} characters",
                reference.start,
                advice="Give the variable a shorter name.",
            )


def _unknown_setting(name: str, field: str | None) -> VariableValue:
    """Return `NO_VALUE` for a setting of motions: settings are not followed yet."""
    return NO_VALUE


def _check_cell_values(keys: Iterable[str]) -> None:
    """Refuse cell values for variables that programs set, or that describe the robot position.

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
    """Return a component (`field`: X … C) of a computed Cartesian position [mm, deg].

    A, B and C are known only if one set of them describes the orientation: no source says which of two sets a
    controller has.
    """
    value = position.values[CARTESIAN.index(field)]
    if field in ANGLES and not _has_unique_angles(position):
        return UnknownValue(reason=f"two sets of A, B, C describe this orientation, and {field} may be that of either")
    return Number(value, 0, 0, False)


def with_component(position: Position, field: str, value: float) -> Position | None:
    """Return a computed Cartesian position with another value of one component.

    :param field: X … C; `value` is its new number [mm or deg].
    :returns: None if the component is an angle, and the others may be those of another set of A, B, C.
    """
    if field in ANGLES and not _has_unique_angles(position, whole_turns=True):
        return None
    values = list(position.values)
    values[CARTESIAN.index(field)] = value
    return replace(position, values=tuple(values), aggregate=None)


def _has_unique_angles(position: Position, *, whole_turns: bool = False) -> bool:
    """Return whether only one set of A, B, C describes the orientation of a position.

    :param whole_turns: True if sets that differ by whole turns of an angle count as one.
    """
    a, b, c = position.values[3:]
    return abs(b) < 90.0 - _TURN and (whole_turns or (abs(a) < 180.0 - _TURN and abs(c) < 180.0 - _TURN))


def _structure_with_member(
    variables: Variables, structure: Aggregate, path: Sequence[str], value: VariableValue
) -> Aggregate | None:
    """Return a structure with another value of a member, or of a member of that member.

    :param path: names of the members, the outermost first.
    :returns: None if the result is not known, as where a position loses components that it had.
    """
    name, *inner_path = path
    item = structure.items.get(name)
    old_member = None if item is None else variables.evaluate(item)
    old_structure = old_member if isinstance(old_member, Aggregate) else None
    member: VariableValue | None = value
    if inner_path:
        member = None if old_structure is None else _structure_with_member(variables, old_structure, inner_path, value)
    elif isinstance(value, Aggregate) and old_structure is not None and old_structure.items.keys() - value.items.keys():
        return None
    if not isinstance(member, (Number, Word, Aggregate)):
        return None
    return replace(structure, items={**structure.items, name: member}, is_computed=True)


def _are_equal_frames(frame: Position, other_frame: Position) -> bool:
    """Return whether two frames are equal within rounding; a component that one lacks counts as that of the other.

    Frames given by joint angles count as different.
    """
    if frame.is_axis or other_frame.is_axis:
        return False
    pairs = list(zip(frame.values, other_frame.values, strict=True))
    pose = Position(tuple(x if x == x else y for x, y in pairs)).pose()
    other_pose = Position(tuple(y if y == y else x for x, y in pairs)).pose()
    difference = np.abs(pose - other_pose)
    return bool(difference[:3, 3].max() < _SAME_PLACE and difference[:3, :3].max() < _SAME_ANGLE)


def _frame_text(frame: Position) -> str:
    """Return the given components of a frame as KRL writes them, for messages [mm, deg]."""
    names = AXES if frame.is_axis else CARTESIAN
    components = [
        f"{name} {without_negative_zero(value):.10g}"
        for name, value in zip(names, np.round(frame.values, 6), strict=True)
    ]
    return f"{{{', '.join(component for component in components if not component.endswith('nan'))}}}"


def _cell_value(value: float) -> Number | Word:
    """Return a value of the cell as a value of KRL: a BOOL, an INT or a REAL."""
    if isinstance(value, bool):
        return Word(str(value).upper(), 0, 0)
    return Number(float(value), 0, 0, isinstance(value, int))


def convert_to_type(value: VariableValue, kind: str) -> VariableValue:
    """Return a value converted to the type of a variable: a REAL is rounded to an INT (KUKA, Expert Programming).

    :param kind: that type, upper case; empty if it is not known; `WHOLE` if it is REAL or INT.
    :returns: an `UnknownValue` if the rounding is not certain.
    """
    if not isinstance(value, Number) or kind == "REAL":
        return replace(value, is_integer=False) if isinstance(value, Number) else value
    is_whole = value.value == int(value.value)
    if kind == WHOLE and not is_whole:
        return UnknownValue(reason=f"whether {value.value:g} is rounded to an INT is in no source")
    if kind in ("INT", WHOLE) and abs(value.value) >= LARGEST_INT:
        return _BEYOND_INT
    if kind == "INT" and not is_whole:
        nearest = round(value.value)
        if abs(abs(value.value - nearest) - 0.5) < _HALF * max(1.0, abs(value.value)):
            return UnknownValue(reason=f"to which side {value.value:g} is rounded is in no source")
        return replace(value, value=float(nearest), is_integer=True)
    return replace(value, is_integer=is_whole)


def _span(value: Value) -> tuple[int, int]:
    """Return the offsets of the first character of a value and behind its last."""
    return value.start, value.stop
