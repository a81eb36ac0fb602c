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
from postproc.dialects.krl.read.state import MOTION_SETTINGS
from postproc.errors import CellError, ProgramError
from postproc.frames import Array, inverse

_REAL_COMPONENTS = frozenset({*CARTESIAN, *AXES})
"""Components of positions whose type is REAL: X … C and A1 … A6."""
_COMPONENTS = _REAL_COMPONENTS | {"S", "T"}
"""Components of positions; status S and turn T are INTs."""
FUNCTIONS: dict[str, Callable[..., float]] = {
    "ABS": abs,
    "SQRT": math.sqrt,
    "SIN": lambda angle: math.sin(math.radians(angle)),
    "COS": lambda angle: math.cos(math.radians(angle)),
    "TAN": lambda angle: math.tan(math.radians(angle)),
    "ACOS": lambda number: math.degrees(math.acos(number)),
    "ATAN2": lambda y, x: math.degrees(math.atan2(y, x)),
}
"""Functions of the controller that compute a number from numbers; angles in degrees."""
ZERO = Position((0.0,) * 6)
_SCALAR_TYPES = (Number, Word)
_CONSTANT_TYPES = (Number, Word, OpaqueText)
_EVALUATED_TYPES = (Number, Position, Word, UnknownValue)
_TYPES_WITHOUT_PARTS = (Number, Word, Position, UnknownValue, OpaqueText, UnreadableText)
ANGLES = CARTESIAN[3:]
INT_OR_REAL = "INT or REAL"
"""Type of a parameter without ``:IN`` that is INT with a REAL argument, or the reverse: no source says which holds."""
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
"""Why a position is not known: the variable may keep the missing components, or lack them, so that a motion keeps the
components of the robot position."""
_LONE_MEMBER_REASON = "its structure had no value as a whole: give all members at once before"
_ACTIVE_DATA = frozenset({"FDAT_ACT", "LDAT_ACT", "PDAT_ACT"})
"""Structures that the `$config.dat` always declares, with all members: an assigned member is known also where that file
is not read."""
_BEYOND_INT = UnknownValue(reason="what becomes of an INT beyond 32 bits is in no source")
_ROUNDING_TOLERANCE = 1e-5
"""A REAL closer to the middle between two INTs than this share of its size may be rounded to either: a controller has
fewer digits."""
_ANGLE_TOLERANCE = 1e-3
"""If B is closer than this [deg] to ±90°, or A or C to ±180°, the controller may have another set of A, B, C of the
orientation: a REAL has seven digits."""
_SET_BY_PROGRAMS = frozenset({"$OUT", "$ANOUT", "$ACC", "$VEL_AXIS", "$ACC_AXIS", "$ACT_BASE", "$ACT_TOOL", "$LOAD"})
_POSITION_PREFIXES = ("$POS_", "$AXIS_")
"""Beginnings of the names of variables that hold the robot position."""
FRAME_ARRAYS = frozenset({"BASE_DATA", "TOOL_DATA"})
"""Frames by number, which the cell and files may give."""
_POSITION_TOLERANCE = 1e-6
"""Positions closer than this [m] are equal: files and displays give three decimals of a millimetre."""
_ORIENTATION_TOLERANCE = math.radians(1e-3)
"""Orientations closer than this [rad] are equal: files and displays give three decimals of a degree."""


def operation_result(operator: str, a: float, b: float, *, are_integers: bool) -> float | VariableValue:
    """Return a sum, difference, product or quotient of two numbers.

    The quotient of two INTs has no decimal places (KUKA, Expert Programming). No source says to which side the quotient
    of a negative INT is rounded, nor what becomes of an INT beyond 32 bits.

    :param operator: ``+ - * /``, or ``B_NOT`` of `b` alone.
    :param are_integers: True if both numbers are INTs.
    :returns: an `UnknownValue` if the result is not known; `NO_VALUE` for a division by 0, an infinite result, and
        ``B_NOT`` of a REAL.
    """
    if operator == "B_NOT":
        return -1.0 - b if are_integers else NO_VALUE  # all bits of a two's complement flipped
    if operator == "/" and b == 0.0:
        return NO_VALUE
    if operator == "/" and are_integers and a % b != 0.0:
        return _UNKNOWN_ROUNDING if a < 0.0 or b < 0.0 else a // b
    value = _OPERATIONS[operator](a, b)
    if are_integers and abs(value) >= LARGEST_INT:
        return _BEYOND_INT
    return value if math.isfinite(value) else NO_VALUE


def variable_of(key: str) -> str:
    """Return the stored name of a variable from its key, or from that of one of its elements: ``P`` of ``P[3]``."""
    return key.partition("[")[0]


class Functions(Protocol):
    """The functions that a program declares."""

    def is_pure(self, call: Call) -> bool:
        """Return whether a call gives a value and changes nothing, so that it may run at any time, and repeatedly."""

    def value(self, call: Call) -> VariableValue:
        """Return the value of a call that `is_pure`."""


class Snapshot(NamedTuple):
    """Values of variables at one moment.

    :ivar values: stored name → value; elements have names such as ``P[3]``.
    :ivar volatile_values: stored names of variables that may change at any time → what changes them.
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
    """Values of variables at one moment of the run of a program.

    A variable is given by its stored name: its name, upper case, with a prefix or suffix if variables of several
    routines or files have that name, see `Scope`. An array element is given by the stored name of the array and its
    index: ``P[3]``. Both are called keys. An expression with a variable that was never set gives `NO_VALUE`, which is
    an `UnknownValue` that says neither where nor why.

    :ivar change_count: number of times that a value was replaced by another value.
    :ivar types: stored name → declared type, upper case.
    :ivar structures: name of a STRUC → types of its members by name, upper case.
    :ivar global_names: names declared GLOBAL.
    :ivar scope: resolves the names in the present routine.
    :ivar volatile_values: stored names of variables that may change at any time → what changes them.
    :ivar used_names: stored names of variables that a motion, a frame or a speed depends on.
    :ivar change_places: stored names of variables that the program changes → the place of the first change.
    :ivar cell_values: key → value that the cell gives.
    :ivar used_cell_values: keys of `cell_values` that any run has read.
    :ivar persistent_names: stored names of variables that keep their values from run to run: those of data lists,
        BASE_DATA and TOOL_DATA.
    :ivar setting_value: function that returns the present value of one of the `MOTION_SETTINGS`, or of one of its
        components, by name and component (None: the whole); see `Settings.current_value`.
    :ivar functions: the functions of the program, see `calls`.
    :ivar late_values: key → initial value, from data lists that are read when the program first calls their file; these
        values have held since the program began.
    :ivar reads_late_list: True while such a data list is read.
    """

    def __init__(self, cell: Cell) -> None:
        """Begin with the values that the cell gives: variables, BASE_DATA and TOOL_DATA.

        :raises CellError: the cell gives a variable that it may not give, or two frames for one number.
        """
        self._values: dict[str, VariableValue | UnparsedValue] = {}
        self._elements: defaultdict[str, list[str]] = defaultdict(list)  # array → keys of its elements
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
        # key of BASE_DATA or TOOL_DATA → its frame, and the first place that gives it
        self._stated_frames = {
            f"{name}[0]": (ZERO, "the controller, whose number 0 is $NULLFRAME") for name in FRAME_ARRAYS
        }
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
        """Store a frame that the cell gives.

        :param key: stored name of the element of BASE_DATA or TOOL_DATA.
        :param place: the table of the frame in the cell, for messages.
        """
        self.note_frame(key, frame, place)
        self.put(key, frame)

    def note_frame(self, key: str, value: VariableValue | UnparsedValue, place: str) -> None:
        """Check the frame that the cell or a file gives for ``BASE_DATA[n]`` or ``TOOL_DATA[n]`` against other places.

        The first frame of each element is kept for this. Components that one of two frames lacks do not count. A value
        that cannot be read, or is not known, is passed over.

        :param key: stored name of the element.
        :param place: file and line, or the table of the cell, for messages.
        :raises CellError: another place gives another frame.
        """
        try:
            parsed_value = value.value if isinstance(value, UnparsedValue) else value
            frame = self.position(parsed_value)
        except ProgramError:  # raised again where the value is used
            return
        if frame is None:
            return
        stated_frame, other_place = self._stated_frames.setdefault(key, (frame, place))
        if not _are_equal_frames(stated_frame, frame):
            raise CellError(
                f"{key} has two values: {_frame_text(stated_frame)} by {other_place}, "
                f"and {_frame_text(frame)} by {place}",
                advice="Make them equal, or remove the one that the controller does not have.",
            )

    def copy_for_run(self) -> Variables:
        """Return a copy for another run of the program; `used_cell_values` is shared by all runs."""
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
        """Set variables to the values that the cell gives, converted to their types.

        :param name: stored name of a variable, to set it and its elements alone; empty: set all.
        """
        for key, value in self.cell_values.items():
            variable = variable_of(key)
            if not name or name == variable:
                self.put(key, convert_to_type(value, self.types.get(variable, "")))

    def put(self, key: str, value: VariableValue | UnparsedValue) -> None:
        """Store a value unchanged. Assignments of the program use `set`, which converts the value to the type.

        :param key: stored name of the variable, or of an element, as ``P[3]``.
        """
        is_new = key not in self._values
        self.change_count += self._values.get(key) != value
        if self.reads_late_list:
            self.late_values[key] = value
        if is_new and key.endswith("]"):
            self._elements[variable_of(key)].append(key)
        self._values[key] = value

    def set(self, key: str, value: VariableValue, place: Place) -> None:
        """Set a variable to the value of an assignment, converted to its type, and note the change.

        The variable becomes unknown if it is set to a position without some components that its present value has, or
        may have: no source says whether it then keeps them.

        :param key: stored name of the variable, or of an element, as ``P[3]``.
        :param place: the assignment.
        """
        name = variable_of(key)
        if name not in self.change_places:
            self.change_places[name] = str(place)
        if isinstance(value, Number):
            value = convert_to_type(value, self.types.get(name, ""))
        elif isinstance(value, Aggregate) and self._leaves_components_uncertain(key, value):
            value = UnknownValue(str(place), PARTLY_GIVEN)
        self.put(key, value)

    def _leaves_components_uncertain(self, key: str, new_position: Aggregate) -> bool:
        """Return whether an aggregate is a position that lacks components which the variable has, or may have.

        It is not certain what becomes of these components: they may stay, or be missing.

        :param key: stored name of the variable that gets `new_position`.
        """
        names: tuple[str, ...] = ()  # of all components; none for other structures
        if not new_position.items.keys().isdisjoint(_REAL_COMPONENTS):
            names = AXES if not new_position.items.keys().isdisjoint(AXES) else CARTESIAN
        missing_names = [name for name in names if name not in new_position.items]
        old_value = self.value(key)
        was_never_set = old_value is None or old_value == NO_VALUE  # it has no components
        if not missing_names or was_never_set:
            return False
        if isinstance(old_value, Aggregate):
            return any(name in old_value.items for name in missing_names)
        return True  # unknown, or computed, with all components

    def set_field(self, key: str, field: str, value: VariableValue, place: Place) -> None:
        """Set one component of a variable, as ``XP1.X=5`` does, and note the change.

        A variable that is unknown for a stated reason stays so: the reason is of more use in messages.

        :param key: stored name of the variable, or of an element.
        :param field: path of the component, such as ``X`` or ``F.X``.
        :param place: the assignment.
        """
        old_value = self.value(key)
        name = variable_of(key)
        if name not in self.change_places:
            self.change_places[name] = str(place)
        has_value = old_value not in (None, NO_VALUE)
        if name in _ACTIVE_DATA and not has_value:
            old_value = Aggregate(place.source, 0, 0, "", {}, is_computed=True)  # a structure without known members
        is_unknown_for_reason = isinstance(old_value, UnknownValue) and bool(old_value.reason)
        if not is_unknown_for_reason:
            self.put(key, self._value_with_component(old_value, field, value, place))

    def _value_with_component(
        self, old_value: VariableValue | None, field: str, value: VariableValue, place: Place
    ) -> VariableValue:
        """Return the value of a variable after an assignment to one of its components, see `set_field`.

        If the new value of a position component is not known, the whole position becomes unknown. If the new value of
        another member is not known, that member alone becomes unknown.

        :param old_value: value of the whole variable before; None if it has none.
        :param field: path of the component; `value` is its new value.
        :returns: an `UnknownValue` if the value of the whole variable is not known, before or after the assignment.
        """
        unknown = UnknownValue(str(place), value.reason if isinstance(value, UnknownValue) else "")
        if isinstance(old_value, Position) and not old_value.is_axis and field in CARTESIAN:
            new_position = with_component(old_value, field, value.value) if isinstance(value, Number) else None
            return unknown if new_position is None else new_position
        if old_value in (None, NO_VALUE) and not isinstance(value, UnknownValue):
            return UnknownValue(str(place), _LONE_MEMBER_REASON)
        if not isinstance(old_value, Aggregate):
            return unknown
        if "[" not in field:  # elements of arrays in structures are not followed
            new_structure = _structure_with_member(self, old_value, field.split("."), value)
            if new_structure is not None:
                return new_structure
        member = field.partition(".")[0].partition("[")[0]  # the outermost member, without an index
        if member in _COMPONENTS:
            return unknown
        items = {**old_value.items, member: OpaqueText(old_value.start, old_value.stop)}
        return replace(old_value, items=items, is_computed=True)

    def forget(self, name: str, place: str) -> None:
        """Mark a variable and all its elements as unknown.

        Variables of the controller that have no value stay as they are: nothing of their value was known.

        :param name: stored name of the variable.
        :param place: place of the statement that changes the variable, for messages.
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
        """Mark as unknown the variables whose values differ from those of a snapshot.

        :param snapshot: the values at the end of another branch.
        :param place: the join of the branches, for messages.
        """
        # data lists that were read after the snapshot: their values have held since the program began
        values = self.late_values | snapshot.values
        self.volatile_values = snapshot.volatile_values | self.volatile_values
        for key in self._values.keys() | values.keys():
            if not self._have_same_value(self._values.get(key), values.get(key)):
                self._values[key] = UnknownValue(place)

    def differing_names(self, snapshot: Snapshot) -> frozenset[str]:
        """Return the stored names of variables with other values than in a snapshot.

        A variable also differs if it is volatile, which means that it may change at any time, in one of the two only.
        """
        volatile_in_one = self.volatile_values.keys() ^ snapshot.volatile_values.keys()
        return frozenset({variable_of(key) for key in self.differing_keys(snapshot)} | volatile_in_one)

    def differing_keys(self, snapshot: Snapshot) -> frozenset[str]:
        """Return the keys of variables and elements with other values than in a snapshot."""
        # data lists that were read after the snapshot: their values have held since the program began
        snapshot_values = self.late_values | snapshot.values
        keys = self._values.keys() | snapshot_values.keys()
        return frozenset(
            key for key in keys if not self._have_same_value(self._values.get(key), snapshot_values.get(key))
        )

    def _have_same_value(self, first: object, second: object) -> bool:
        """Return whether two stored values are equal.

        Aggregates are equal if their numbers come from one text at one row of the trace, where they are corrected.
        An aggregate equals the unparsed text that it was read from. A number equals an unparsed text that gives the
        number.

        :param first: a value, an `UnparsedValue`, or None for a variable without a value; so is `second`.
        """
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
        :returns: the data list, and for each element the offset of the first character of its value and the offset
            behind its last. None if an element has no value, or its value is not, or may not be, that of this list.
        """
        if name in self.volatile_values or any(variable_of(key) == name for key in self.cell_values):
            return None
        spans, source = [], None
        for number in numbers:
            value = self._values.get(f"{name}[{number}]")
            if not isinstance(value, UnparsedValue | Aggregate) or (isinstance(value, Aggregate) and value.is_computed):
                return None
            source = source or value.source
            # the values are in several files, or the `.src` (index 0, or a row of the trace) gives one
            if value.source is not source or source.index == 0 or value.row > 0:
                return None
            spans.append((value.start, value.stop))
        return None if source is None else (source, spans)

    def numbers(self, name: str, indices: Iterable[int]) -> Array | None:
        """Return the numbers (n,) in n elements of an array; None if the value of an element is no known number.

        :param name: stored name of the array.
        :param indices: indices of the elements, as the program counts them.
        """
        numbers = []
        for index in indices:
            value = self.value(f"{name}[{index}]")
            if not isinstance(value, Number):
                return None
            numbers.append(value.value)
        return np.array(numbers)

    def changed_data(self) -> dict[str, str]:
        """Return the variables that keep their values from run to run and that the program changes, sorted by name.

        :returns: stored name → the place that changes the variable, as text.
        """
        change_places = self.change_places | {name: value.change_place for name, value in self.volatile_values.items()}
        return {name: change_places[name] for name in sorted(self.persistent_names & change_places.keys())}

    def next_run(self) -> Variables:
        """Return the variables as the next run of the program finds them.

        Variables of data lists and of the controller keep the values that this run leaves. Others have no value, or the
        value of the cell. Variables of data lists that may change at any time are unknown.
        """
        next_variables = copy(self)
        next_variables._values = {key: value for key, value in self._values.items() if self._is_kept_between_runs(key)}
        next_variables._elements = self._elements.copy()
        next_variables.scope, next_variables.used_names = Scope(), set()
        next_variables.volatile_values, next_variables.change_places, next_variables.late_values = {}, {}, {}
        for name in self.persistent_names & self.volatile_values.keys():
            next_variables.forget(name, self.volatile_values[name].change_place)
        for name in {variable_of(key) for key in self.cell_values} - self.persistent_names:
            next_variables.take_cell_values(name)
        next_variables.change_places = {}  # without those that `forget` has noted: they are of this run
        return next_variables

    def _is_kept_between_runs(self, key: str) -> bool:
        """Return whether a variable, given by its key, keeps its value from one run of the program to the next."""
        return key[0] == "$" or variable_of(key) in self.persistent_names

    def __contains__(self, key: str) -> bool:
        """Return whether a value is stored under a key."""
        return key in self._values

    def value(self, key: str) -> VariableValue | None:
        """Return the value of a variable or an element by its stored name; None if it has no value.

        A value that is not parsed yet is parsed, and stored. If the cell gives the value, its key is added to
        `used_cell_values`.

        :raises ProgramError: the value cannot be read.
        """
        # `variable_of` is written out: values are read very often
        if key[0] == "$" and (name := key.partition("[")[0]) in MOTION_SETTINGS:
            return self.setting_value(name, None)
        if self.volatile_values and (name := key.partition("[")[0]) in self.volatile_values:
            return self.volatile_values[name]
        if key in self.cell_values:
            self.used_cell_values.add(key)
        value = self._values.get(key)
        if isinstance(value, UnparsedValue):
            value = self.evaluate(value.value)
            if isinstance(value, Number):
                value = convert_to_type(value, self.types.get(variable_of(key), ""))
            self._values[key] = value
        return value

    def evaluate(self, value: Value | VariableValue) -> VariableValue:
        """Return the present value of an expression; numbers, words, positions and unknown values stay as they are.

        :returns: an `UnknownValue` if the value is not known before the program runs; `NO_VALUE` without a reason.
        :raises ProgramError: the expression cannot be read.
        """
        if isinstance(value, _EVALUATED_TYPES):
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

        Components without a known value become `OpaqueText`. The aggregate itself is returned if no component differs;
        else the result counts as computed.
        """
        for item in aggregate.items.values():  # a loop: `all` takes longer, and nearly all aggregates are constant
            if not isinstance(item, _CONSTANT_TYPES):
                break
        else:
            return aggregate  # all components are constant
        items: dict[str, Value] = {}
        for name, item in aggregate.items.items():
            result = self.evaluate(item)
            items[name] = result if isinstance(result, Number | Word | Aggregate) else OpaqueText(*_span(item))
        if all(result is item for result, item in zip(items.values(), aggregate.items.values(), strict=True)):
            return aggregate
        return replace(aggregate, items=items, is_computed=True)

    def truth(self, condition: Value | None) -> bool | None:
        """Return whether a condition holds; None if that is not known before the program runs.

        A condition that calls a function with side effects, cannot be read, or is no BOOL, counts as not known.

        :param condition: the condition; None if a statement lacks it.
        """
        try:
            if condition is None or not all(map(self.functions.is_pure, calls([condition]))):
                return None
            value = as_term(self.evaluate(condition))
        except ProgramError:
            return None
        return value if isinstance(value, bool) else None

    def is_chosen_case(self, value: VariableValue, cases: Sequence[Value]) -> bool | None:
        """Return whether the value of a SWITCH is among the values behind one CASE.

        :param cases: the values behind CASE.
        :returns: None if none of them certainly equals the value, but one may.
        """
        is_chosen: bool | None = False
        for case in cases:
            is_equal = matches_case(value, self.evaluate(case))
            if is_equal:
                return True
            is_chosen = None if is_equal is None else is_chosen
        return is_chosen

    def _evaluate_condition(self, condition: Condition) -> VariableValue:
        """Return the value of terms joined by comparisons and logic, or of a single term in brackets.

        :returns: a BOOL, or the number or word that a single term gives. If the value is not known: the first
            `UnknownValue` of a term; `NO_VALUE` if no term has one.
        """
        term_values = [self.evaluate(term) for term in condition.terms]
        if not condition.operators and not (condition.negated and condition.negated[0]):  # a term in brackets
            return term_values[0]
        value = condition_value(term_values, condition)
        if isinstance(value, bool):
            return Word(str(value).upper(), condition.start, condition.stop)
        if isinstance(value, _SCALAR_TYPES):
            return value
        return next((term_value for term_value in term_values if isinstance(term_value, UnknownValue)), NO_VALUE)

    def _evaluate_operation(self, operation: Operation) -> VariableValue:
        """Return a sum, difference, product or quotient, see `operation_result`.

        :returns: if a side is no known number: the `UnknownValue` of that side, or `NO_VALUE` for a side of another
            type, such as a word.
        """
        # −x is 0 − x
        left = (
            Number(0.0, start=0, stop=0, is_integer=True) if operation.left is None else self.evaluate(operation.left)
        )
        right = self.evaluate(operation.right)
        if not isinstance(left, Number) or not isinstance(right, Number):
            return next((side for side in (left, right) if isinstance(side, UnknownValue)), NO_VALUE)
        are_integers = left.is_integer and right.is_integer
        value = operation_result(operation.operator, left.value, right.value, are_integers=are_integers)
        if isinstance(value, int | float):
            return Number(value, operation.start, operation.stop, are_integers)
        return value

    def _evaluate_call(self, call: Call) -> VariableValue:
        """Return the value of a function call, angles in degrees.

        :returns: `NO_VALUE` if the function has side effects or is not known, or if the number, the type or the value
            of an argument is wrong.
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
        is_integer = call.name == "ABS" and numbers[0].is_integer  # all other functions give REALs
        return Number(result, call.start, call.stop, is_integer)

    def _evaluate_chain(self, chain: Chain) -> VariableValue:
        """Return the position of frames that are joined by ``:``, the product of their poses.

        Status, turn and external axes are those of the last frame.

        :returns: `NO_VALUE` if a frame is not known, given by joint angles, or a variable that lacks components.
        """
        pose, position = np.eye(4), None
        for operand in chain.operands:
            position = self.position(operand)
            # in an aggregate of the chain itself, missing components are 0
            if position is None or position.is_axis or (isinstance(operand, Reference) and not position.is_complete):
                return NO_VALUE
            pose = pose @ position.pose()
        if position is None:
            return NO_VALUE
        return replace(position_from_pose(pose), status=position.status, turn=position.turn, external=position.external)

    def key_of(self, reference: Reference) -> str | None:
        """Return the key of a variable or an array element, with the value of its index.

        :returns: None if an index is not known, and for a whole array ``P[]``.
        """
        name = self.scope.stored_name(reference.name)
        if reference.indices is None:
            return name
        indices = [self.index(value) for value in reference.indices]
        if not indices or None in indices:
            return None
        return f"{name}[{','.join(map(str, indices))}]"

    def index(self, value: Value) -> int | None:
        """Return the number of one index of an array; None if it is not known, or no whole number."""
        index = self.number(value)
        return None if index is None or index != int(index) else int(index)

    def value_of(self, reference: Reference) -> VariableValue:
        """Return the present value of a variable, an element or a component; `NO_VALUE` if it has none."""
        if reference.name in MOTION_SETTINGS:  # a setting of motions, such as $BASE
            return self.setting_value(reference.name, reference.field)
        key = self.key_of(reference)
        value = self.value(key) if key is not None else None
        if value is None and key is not None and reference.indices is not None:
            # `forget` marks the array itself as unknown if any element may have changed
            value = self.value(self.scope.stored_name(reference.name))
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

        A member of a computed structure counts as computed too: its text may belong to another variable.

        :param value: the structure; an `UnknownValue` is returned itself.
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
        """Return a number converted to the declared type of a member of a structure, if that is known.

        :param reference: the member.
        """
        member_type = self.type_of(reference)
        return convert_to_type(number, member_type) if member_type else number

    def type_of(self, reference: Reference) -> str:
        """Return the declared type of a variable, an element or a member, upper case; empty if it is not known."""
        type_name = self.types.get(self.scope.stored_name(reference.name), "")
        for name in () if reference.field is None else reference.field.split("."):
            members = self.structures.get(type_name)
            if members is not None:
                type_name = members.get(name, "")
            else:  # a position of the controller's own types
                type_name = "REAL" if name in _REAL_COMPONENTS else ""
        return type_name

    def position(self, value: Value | VariableValue) -> Position | None:
        """Return the position that an expression gives; None if it gives none, or is not known before the program runs.

        :raises ProgramError: the value is a known aggregate but not a valid position.
        """
        result = self.evaluate(value)
        if isinstance(result, Aggregate):
            return position_from_aggregate(result)
        return result if isinstance(result, Position) else None

    def number(self, value: Value | VariableValue) -> float | None:
        """Return the number that an expression gives; None if it is not known before the program runs, or no number."""
        result = self.evaluate(value)
        return result.value if isinstance(result, Number) else None

    def note_dependence(self, value: Value | VariableValue) -> None:
        """Add the variables in an expression to `used_names`: a motion, a frame or a speed depends on it."""
        if isinstance(value, Reference):
            self.used_names.add(self.scope.stored_name(value.name))
        if not isinstance(value, _TYPES_WITHOUT_PARTS):
            for part in parts(value):
                self.note_dependence(part)

    def first_argument(self, call: Call, field: str) -> Value | VariableValue | None:
        """Return the value of the first argument of a call; if it is a structure, the value of one component.

        :param field: name of the component.
        :returns: `NO_VALUE` if the call has no argument; None if the structure lacks the component; the expression of
            the argument, in place of its value, if that is not known.
        """
        if not call.arguments:
            return NO_VALUE
        result = self.evaluate(call.arguments[0])
        if isinstance(result, Aggregate):
            return result.items.get(field)
        return call.arguments[0] if isinstance(result, UnknownValue) else result

    def check_name(self, source: Source, reference: Reference) -> None:
        """Refuse a variable whose name is longer than the controller accepts.

        :param source: the file that contains the reference.
        :raises ProgramError: the name is too long.
        """
        if len(reference.name) > MAX_LENGTH:
            raise source.error(
                f"the name {reference.name} is longer than {MAX_LENGTH} characters",
                reference.start,
                advice="Give the variable a shorter name.",
            )


def _unknown_setting(name: str, field: str | None) -> VariableValue:
    """Return `NO_VALUE` for a setting of motions, in place of `Settings.current_value` before settings are followed."""
    return NO_VALUE


def _check_cell_values(keys: Iterable[str]) -> None:
    """Refuse cell values for variables that programs set, or that describe the robot position.

    :param keys: keys of the cell values.
    :raises CellError: the cell gives such a variable.
    """
    for key in keys:
        name = key.partition("[")[0].partition(".")[0]
        if name in MOTION_SETTINGS or name in _SET_BY_PROGRAMS or name.startswith(_POSITION_PREFIXES):
            raise CellError(
                f"[krl.values] cannot give {key}: the program changes it while it runs",
                advice="Give inputs such as $IN[5], parameters and variables of the program.",
            )


def component(position: Position, field: str) -> VariableValue:
    """Return a component of a computed Cartesian position [mm, deg].

    A, B and C are unknown if two sets of them describe the orientation: no source says which set a controller has.

    :param field: name of the component, X … C.
    """
    value = position.values[CARTESIAN.index(field)]
    if field in ANGLES and not _has_unique_angles(position):
        return UnknownValue(reason=f"two sets of A, B, C describe this orientation, and {field} may be that of either")
    return Number(value, start=0, stop=0)  # a REAL that is in no text


def with_component(position: Position, field: str, value: float) -> Position | None:
    """Return a computed Cartesian position with another value of one component.

    :param field: name of the component, X … C; `value` is its new number [mm or deg].
    :returns: None if the component is an angle and the controller may have other A, B, C for the same orientation.
    """
    if field in ANGLES and not _has_unique_angles(position, ignores_whole_turns=True):
        return None
    values = list(position.values)
    values[CARTESIAN.index(field)] = value
    return replace(position, values=tuple(values), aggregate=None)


def _has_unique_angles(position: Position, *, ignores_whole_turns: bool = False) -> bool:
    """Return whether the controller certainly has the same A, B, C for the orientation of a position.

    At B = ±90° infinitely many sets of angles describe the orientation. A or C of ±180° may have either sign.

    :param ignores_whole_turns: True if sets count as equal whose A or C differ by a whole turn.
    """
    a, b, c = position.values[3:]
    has_unique_b = abs(b) < 90.0 - _ANGLE_TOLERANCE
    has_unique_signs = max(abs(a), abs(c)) < 180.0 - _ANGLE_TOLERANCE
    return has_unique_b and (ignores_whole_turns or has_unique_signs)


def _structure_with_member(
    variables: Variables, structure: Aggregate, path: Sequence[str], value: VariableValue
) -> Aggregate | None:
    """Return a structure with another value of a member, or of a member inside a member.

    :param path: names of the members, the outermost first.
    :param value: new value of the innermost member.
    :returns: None if the result is not known: the value or an outer member is not known, or the new value lacks
        components that the old value has.
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
    """Return whether two frames are equal within rounding; a component that one frame lacks is taken from the other.

    Frames given by joint angles count as different.
    """
    if frame.is_axis or other_frame.is_axis:
        return False
    pairs = list(zip(frame.values, other_frame.values, strict=True))
    pose = Position(tuple(y if math.isnan(x) else x for x, y in pairs)).pose()
    other_pose = Position(tuple(x if math.isnan(y) else y for x, y in pairs)).pose()
    # an element of a rotation matrix changes by the angle between the orientations [rad] at most
    difference = np.abs(pose - other_pose)
    return bool(difference[:3, 3].max() < _POSITION_TOLERANCE and difference[:3, :3].max() < _ORIENTATION_TOLERANCE)


def _frame_text(frame: Position) -> str:
    """Return the given components of a frame as KRL writes them, for messages [mm, deg]."""
    names = AXES if frame.is_axis else CARTESIAN
    components = [
        f"{name} {without_negative_zero(value):.10g}"
        for name, value in zip(names, np.round(frame.values, 6), strict=True)
    ]
    given_components = (component for component in components if not component.endswith("nan"))  # NaN: not given
    return f"{{{', '.join(given_components)}}}"


def _cell_value(value: float) -> Number | Word:
    """Return a bool, int or float of the cell as a value of KRL: a BOOL, an INT or a REAL; it is in no text."""
    if isinstance(value, bool):
        return Word(str(value).upper(), start=0, stop=0)
    return Number(float(value), start=0, stop=0, is_integer=isinstance(value, int))


def convert_to_type(value: VariableValue, type_name: str) -> VariableValue:
    """Return a value converted to the type of a variable: a REAL is rounded to an INT (KUKA, Expert Programming).

    Values other than numbers are returned unchanged. For a type that is not known, a whole number may be an INT.

    :param type_name: the type, upper case; empty if it is not known; `INT_OR_REAL` if it is REAL or INT.
    :returns: an `UnknownValue` if the rounding is not certain, or the number is beyond 32 bits.
    """
    if not isinstance(value, Number) or type_name == "REAL":
        return replace(value, is_integer=False) if isinstance(value, Number) else value
    is_whole = value.value == int(value.value)
    if type_name == INT_OR_REAL and not is_whole:
        return UnknownValue(reason=f"whether {value.value:g} is rounded to an INT is in no source")
    if type_name in ("INT", INT_OR_REAL) and abs(value.value) >= LARGEST_INT:
        return _BEYOND_INT
    if type_name == "INT" and not is_whole:
        nearest = round(value.value)
        if abs(abs(value.value - nearest) - 0.5) < _ROUNDING_TOLERANCE * max(1.0, abs(value.value)):
            return UnknownValue(reason=f"to which side {value.value:g} is rounded is in no source")
        return replace(value, value=float(nearest), is_integer=True)
    return replace(value, is_integer=is_whole)


def _span(value: Value) -> tuple[int, int]:
    """Return the offsets of the first character of a value and behind its last."""
    return value.start, value.stop
