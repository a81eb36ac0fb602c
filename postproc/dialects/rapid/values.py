"""Values of RAPID data: types, predefined data, functions, evaluation.

A value is a float, a bool, a str, or a list of values (record or array). Sources: ABB, Technical reference manual,
RAPID Instructions, Functions and Data types (3HAC16581): speeddata, zonedata, tooldata, wobjdata, Offs, RelTool.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.dialects.rapid.language import quaternions, rotations
from postproc.dialects.rapid.syntax import Argument, Declaration, Expression
from postproc.errors import PostprocError
from postproc.frames import RAD_PER_DEG, Array

Value = Any
"""float, bool, str, or a list of values."""

_POSE = (("TRANS", "POS"), ("ROT", "ORIENT"))
FIELDS: dict[str, tuple[tuple[str, str], ...]] = {
    "POS": (("X", "NUM"), ("Y", "NUM"), ("Z", "NUM")),
    "ORIENT": (("Q1", "NUM"), ("Q2", "NUM"), ("Q3", "NUM"), ("Q4", "NUM")),
    "POSE": _POSE,
    "CONFDATA": (("CF1", "NUM"), ("CF4", "NUM"), ("CF6", "NUM"), ("CFX", "NUM")),
    "EXTJOINT": tuple((f"EAX_{axis}", "NUM") for axis in "ABCDEF"),
    "ROBTARGET": (*_POSE, ("ROBCONF", "CONFDATA"), ("EXTAX", "EXTJOINT")),
    "ROBJOINT": tuple((f"RAX_{axis}", "NUM") for axis in range(1, 7)),
    "JOINTTARGET": (("ROBAX", "ROBJOINT"), ("EXTAX", "EXTJOINT")),
    "LOADDATA": (
        ("MASS", "NUM"),
        ("COG", "POS"),
        ("AOM", "ORIENT"),
        ("IX", "NUM"),
        ("IY", "NUM"),
        ("IZ", "NUM"),
    ),
    "TOOLDATA": (("ROBHOLD", "BOOL"), ("TFRAME", "POSE"), ("TLOAD", "LOADDATA")),
    "WOBJDATA": (
        ("ROBHOLD", "BOOL"),
        ("UFPROG", "BOOL"),
        ("UFMEC", "STRING"),
        ("UFRAME", "POSE"),
        ("OFRAME", "POSE"),
    ),
    "SPEEDDATA": (("V_TCP", "NUM"), ("V_ORI", "NUM"), ("V_LEAX", "NUM"), ("V_REAX", "NUM")),
    "ZONEDATA": (
        ("FINEP", "BOOL"),
        ("PZONE_TCP", "NUM"),
        ("PZONE_ORI", "NUM"),
        ("PZONE_EAX", "NUM"),
        ("ZONE_ORI", "NUM"),
        ("ZONE_LEAX", "NUM"),
        ("ZONE_REAX", "NUM"),
    ),
}
"""Type of a record → names and types of its components, in order."""
_SPEEDS: tuple[int, ...] = (
    5,
    10,
    20,
    30,
    40,
    50,
    60,
    80,
    100,
    150,
    200,
    300,
    400,
    500,
    600,
    800,
    1000,
    1500,
    2000,
    2500,
    3000,
    4000,
)
_SPEEDS = (*_SPEEDS, 5000, 6000, 7000)
MAX_SPEED = 5000.0
"""vmax [mm/s]: the manual says "max. TCP speed for the used robot type, normally 5000 mm/s"."""
_ZONES: dict[int, tuple[float, float, float]] = {
    0: (0.3, 0.3, 0.03),
    1: (1.0, 1.0, 0.1),
    5: (5.0, 8.0, 0.8),
    10: (10.0, 15.0, 1.5),
    15: (15.0, 23.0, 2.3),
    20: (20.0, 30.0, 3.0),
    30: (30.0, 45.0, 4.5),
    40: (40.0, 60.0, 6.0),
    50: (50.0, 75.0, 7.5),
    60: (60.0, 90.0, 9.0),
    80: (80.0, 120.0, 12.0),
    100: (100.0, 150.0, 15.0),
    150: (150.0, 225.0, 23.0),
    200: (200.0, 300.0, 30.0),
}
"""Predefined zonedata: number in the name → radius of the TCP, of orientation and axes [mm], zone of turns [deg]."""
NOT_CONNECTED = 8.9e9
"""An external axis with this number or more is not connected: RAPID writes 9E9."""
SINGLE_PRECISION_TOLERANCE = 1e-5
"""Share by which numbers that the controller calculates in single precision may differ from those calculated here."""
UNIT_QUATERNION = [1.0, 0.0, 0.0, 0.0]
_NO_LOAD = [0.001, [0.0, 0.0, 0.001], UNIT_QUATERNION, 0.0, 0.0, 0.0]
_ORIGIN = [[0.0, 0.0, 0.0], UNIT_QUATERNION]


def predefined_data() -> dict[str, tuple[Value, str]]:
    """Return the data that all controllers have: name, upper case → (value, type).

    Speeds, zones, `tool0`, `wobj0`, `load0` and `pi`, with the values that the manual states.
    """
    # v_tcp, v_ori, v_leax, v_reax
    data: dict[str, tuple[Value, str]] = {
        f"V{speed}": ([float(speed), 500.0, 5000.0, 1000.0], "SPEEDDATA") for speed in _SPEEDS
    }
    data["VMAX"] = ([MAX_SPEED, 500.0, 5000.0, 1000.0], "SPEEDDATA")
    for name, (tcp_zone, other_zone, angle_zone) in _ZONES.items():  # finep, then the zones in the order of `FIELDS`
        zones = [tcp_zone, other_zone, other_zone, angle_zone, other_zone, angle_zone]
        data[f"Z{name}"] = ([False, *zones], "ZONEDATA")
    data["FINE"] = ([True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "ZONEDATA")
    data["TOOL0"] = ([True, _ORIGIN, _NO_LOAD], "TOOLDATA")
    data["WOBJ0"] = ([False, True, "", _ORIGIN, _ORIGIN], "WOBJDATA")
    data["LOAD0"] = (_NO_LOAD, "LOADDATA")
    data["PI"] = (math.pi, "NUM")
    return data


class UnknownValueError(PostprocError):
    """A value is not known before the program runs; `problem` is the reason."""

    def __init__(self, problem: str) -> None:
        super().__init__(problem)
        self.problem = problem


class Variable(Struct, eq=False):
    """Data of a program.

    :ivar type: upper case.
    :ivar value: present value; None if it is not known, or is that of the declaration and was not needed yet.
    :ivar unknown_reason: reason why the value is not known.
    :ivar declaration: its declaration; None for predefined data, parameters and variables of FOR.
    :ivar has_declared_value: True as long as the value is that of the declaration.
    :ivar interrupt: name of a trap or handler that may change it at any time, so that it is never known; else empty.
    :ivar is_changed: True if the run has changed the value, or may have changed it.
    :ivar is_set: True if the value no longer depends on that at the start of the run.
    :ivar is_used: True if the run has used the value at its start, but for computing the next value of the same data.
    :ivar start_value: value at the start of the run, if the run has changed and used it.
    :ivar before_call: the data before calls of other files made them unknown; None if something else has changed them.
    """

    type: str
    value: Value = None
    unknown_reason: str = ""
    declaration: Declaration | None = None
    has_declared_value: bool = False
    interrupt: str = ""
    is_changed: bool = False
    is_set: bool = False
    is_used: bool = False
    start_value: Value = None
    before_call: Variable | None = None

    def change(self, value: Value) -> None:
        """Change the value."""
        if not self.is_changed:
            self.is_changed, self.start_value = True, self.value
        self.value, self.has_declared_value, self.before_call = value, False, None

    def forget(self, reason: str) -> None:
        """Make the value unknown, for a reason."""
        self.change(None)
        self.is_set, self.unknown_reason = True, reason

    def forget_by_foreign_call(self, reason: str) -> None:
        """Make the value unknown in this run; the next run is assumed to begin with the value before the call."""
        before_call = self.at_next_run()
        self.forget(reason)
        self.before_call = before_call

    def at_next_run(self) -> Variable:
        """Return the data as the next run of the program finds them: those that this run leaves, not yet used.

        Routines of other files are assumed to leave data as they are from one run to the next.
        """
        final_data = self.before_call or self
        return replace(final_data, is_set=False, is_used=False)

    def copy_from(self, other: Variable) -> None:
        """Take over all fields of other data: value and history."""
        for name in self.__struct_fields__:
            setattr(self, name, getattr(other, name))

    def start_run(self) -> None:
        """Make the present value the one at the start of a run: nothing has changed or used it yet."""
        self.is_changed = self.is_set = self.is_used = False
        self.start_value = self.before_call = None


class Scope:
    """Data that the statements of a routine see, by name in upper case.

    :ivar outer: data of the modules.
    :ivar inner: parameters and local data of the routine; they hide module data with the same name.
    :ivar presence: parameter of the routine → whether the call gives it; None if that is not known.
    """

    def __init__(self, outer: dict[str, Variable]) -> None:
        self.outer: dict[str, Variable] = outer
        self.inner: dict[str, Variable] = {}
        self.presence: dict[str, bool | None] = {}

    def find(self, name: str) -> Variable | None:
        """Return the data with a name, upper case; None if they are not declared."""
        return self.inner.get(name) or self.outer.get(name)

    def variable(self, name: str) -> Variable:
        """Return the data with a name, upper case.

        :raises UnknownValueError: they are not declared.
        """
        data = self.find(name)
        if data is None:
            raise UnknownValueError(f"{name} is not declared in this file")
        return data


def evaluate(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return the value of an expression, and its type in upper case; empty if the expression does not show the type.

    :raises UnknownValueError: the value is not known before the program runs.
    """
    return _EVALUATORS[expression.kind](expression, scope)


def number(expression: Expression, scope: Scope) -> float:
    """Return the value of an expression that must be a number.

    :raises UnknownValueError: the value is not known, or no number.
    """
    value, _ = evaluate(expression, scope)
    if isinstance(value, bool) or not isinstance(value, float):
        raise UnknownValueError("a number is expected")
    return value


def truth(expression: Expression, scope: Scope) -> bool:
    """Return the value of an expression that must be TRUE or FALSE.

    :raises UnknownValueError: the value is not known, or neither.
    """
    value, _ = evaluate(expression, scope)
    if not isinstance(value, bool):
        raise UnknownValueError("a condition is expected")
    return value


def nested_numbers(value: Value) -> Iterator[float]:
    """Yield the numbers of a value, also those in nested records, in order.

    :raises UnknownValueError: it contains another value than numbers.
    """
    if isinstance(value, list):
        for item in value:
            yield from nested_numbers(item)
    elif isinstance(value, float) and not isinstance(value, bool):
        yield value
    else:
        raise UnknownValueError("a number is expected")


def record_numbers(value: Value, *sizes: int) -> list[float]:
    """Return the numbers of a record whose components are records.

    :param sizes: number of numbers of each component.
    :raises UnknownValueError: the value has another form, or a number is infinite.
    """
    if not isinstance(value, list) or [len(part) if isinstance(part, list) else 1 for part in value] != list(sizes):
        raise UnknownValueError("the value has another form than its type")
    numbers = list(nested_numbers(value))
    if not np.isfinite(numbers).all():
        raise UnknownValueError("a number is too large")
    return numbers


def _data_value(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return value and type of data; an initial value is evaluated and stored when it is first needed.

    :raises UnknownValueError: the data are not declared, or have no known value.
    """
    variable = scope.variable(expression.value)
    if not variable.is_set:  # the value depends on that at the start of the run, which is used here
        variable.is_used = True
    if variable.value is None and variable.declaration is not None and variable.has_declared_value:
        initial = variable.declaration.value
        if initial is not None:
            # without local data, which may have the names of data of the module
            variable.value, _ = evaluate(initial, Scope(scope.outer))
    if variable.value is None:
        prefix = f"{expression.value} is not known: "
        raise UnknownValueError(prefix + (variable.unknown_reason.removeprefix(prefix) or "it has no value yet"))
    return variable.value, variable.type


def _robtarget_value(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return the value and type of a robtarget of 17 numbers: position, orientation, configuration, external axes."""
    del scope
    values = [float(text) for text in expression.value]
    return [values[:3], values[3:7], values[7:11], values[11:]], "ROBTARGET"


def _element_value(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return value and type of an element of an array.

    :raises UnknownValueError: the array or an index is not known, or there is no such element.
    """
    value, type_ = evaluate(expression.items[0], scope)
    for item in expression.items[1:]:
        index = _list_index(item, scope)
        if not isinstance(value, list) or not 0 <= index < len(value):
            raise UnknownValueError(f"the index {index + 1} is outside of the array")
        value = value[index]
    if value is None:
        raise UnknownValueError(f"an element of {base_name(expression)} has no value yet")
    return value, type_


def _list_index(index: Expression, scope: Scope) -> int:
    """Return the index in a list, from 0, for an index of an array, from 1.

    :raises UnknownValueError: the index is not known, or no whole number.
    """
    value = number(index, scope)
    if not value.is_integer():
        raise UnknownValueError(f"the index {value:g} is outside of the array")
    return int(value) - 1


def _component_value(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return value and type of a component of a record.

    :raises UnknownValueError: the record is not known, or there is no such component.
    """
    value, type_ = evaluate(expression.items[0], scope)
    for index, (name, component_type) in enumerate(FIELDS.get(type_, ())):
        if name == expression.value and isinstance(value, list) and index < len(value):
            return value[index], component_type
    raise UnknownValueError(f"the component {expression.value} is not known")


def _aggregate_value(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return the values of an aggregate, such as ``[1, [2, 3]]``, and an empty type: an aggregate does not show it.

    :raises UnknownValueError: a value is not known.
    """
    return [item.value if item.kind == "number" else evaluate(item, scope)[0] for item in expression.items], ""


def _literal_value(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return value and type of a number, a string, TRUE or FALSE."""
    del scope
    return expression.value, {"number": "NUM", "bool": "BOOL", "string": "STRING"}[expression.kind]


_ARITHMETIC: dict[str, Callable[[float, float], float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "DIV": lambda a, b: float(math.trunc(a / b)),
    "MOD": lambda a, b: math.fmod(a, b),
}
_LOGIC: dict[str, Callable[[bool, bool], bool]] = {
    "AND": lambda a, b: a and b,
    "OR": lambda a, b: a or b,
    "XOR": lambda a, b: a != b,
}
_COMPARISONS: dict[str, Callable[[Value, Value], bool]] = {
    "=": lambda a, b: a == b,
    "<>": lambda a, b: a != b,
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
    "<=": lambda a, b: a <= b,
    ">=": lambda a, b: a >= b,
}


def _operation_value(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return value and type of an operation.

    :raises UnknownValueError: an operand is unknown or has an unsuitable type, or the result depends on rounding.
    """
    word, items = expression.value, expression.items
    if len(items) == 1:
        return _unary_value(word, items[0], scope)
    if word in _LOGIC:
        return _LOGIC[word](truth(items[0], scope), truth(items[1], scope)), "BOOL"
    left, type_ = evaluate(items[0], scope)
    right, right_type = evaluate(items[1], scope)
    if word in _COMPARISONS:
        if type(left) is not type(right) or (isinstance(left, list) and word not in ("=", "<>")):
            raise UnknownValueError("values of different types are compared")
        if isinstance(left, float) and not _is_decided(left, right):
            raise UnknownValueError("whether the numbers are equal depends on the rounding of the controller")
        return _COMPARISONS[word](left, right), "BOOL"
    if isinstance(left, str) and isinstance(right, str) and word == "+":
        return left + right, "STRING"
    try:
        return _arithmetic_value(word, left, right), type_ or right_type
    except (ZeroDivisionError, OverflowError, ValueError):
        raise UnknownValueError("the expression cannot be calculated") from None


def _unary_value(word: str, operand: Expression, scope: Scope) -> tuple[Value, str]:
    """Return value and type of an operation on one operand: NOT, or a sign of a number or vector.

    :raises UnknownValueError: the operand is unknown, or of another type.
    """
    if word == "NOT":
        return not truth(operand, scope), "BOOL"
    value, type_ = evaluate(operand, scope)
    sign = -1.0 if word == "-" else 1.0
    if isinstance(value, list):
        return [sign * component for component in nested_numbers(value)], type_
    return sign * number(operand, scope), type_


def _is_decided(left: float, right: float) -> bool:
    """Return whether the comparison of two numbers is the same on the controller, which calculates in single precision.

    So it is if they clearly differ, or if they are equal and have no rounding in single precision.
    """
    if abs(left - right) > SINGLE_PRECISION_TOLERANCE * max(abs(left), abs(right)):
        return True
    return left == right == float(np.float32(left))


def _arithmetic_value(word: str, left: Value, right: Value) -> Value:
    """Return the value of an arithmetic operation on numbers, or on vectors of the type `pos`.

    :param word: operator, one of `_ARITHMETIC`.
    :raises UnknownValueError: the operation is not defined for these operands.
    :raises ArithmeticError: the result is not defined or too large.
    :raises ValueError: the result is not defined.
    """
    are_lists = isinstance(left, list), isinstance(right, list)
    if are_lists == (False, False):
        if isinstance(left, bool) or isinstance(right, bool) or isinstance(left, str) or isinstance(right, str):
            raise UnknownValueError("a number is expected")
        return _ARITHMETIC[word](left, right)
    left_numbers, right_numbers = list(nested_numbers(left)), list(nested_numbers(right))
    if are_lists == (True, True) and word in "+-" and len(left_numbers) == len(right_numbers) == 3:
        return [_ARITHMETIC[word](x, y) for x, y in zip(left_numbers, right_numbers, strict=True)]
    if word == "*" and are_lists == (True, False) and len(left_numbers) == 3:
        return [x * right_numbers[0] for x in left_numbers]
    if word == "*" and are_lists == (False, True) and len(right_numbers) == 3:
        return [left_numbers[0] * y for y in right_numbers]
    raise UnknownValueError("an operation on records is not followed")


def _function_value(expression: Expression, scope: Scope) -> tuple[Value, str]:
    """Return value and type of a function call.

    ``Present(parameter)``, whether a call gives an optional parameter, is known from the call of the routine, and
    ``Dim(array, number)``, a size of an array, from the declaration. Functions in
    `_FUNCTIONS` are computed from the values of their arguments.

    :raises UnknownValueError: the value is known at run time only, or the arguments are not those of the function.
    """
    if expression.value == "PRESENT" and expression.items and expression.items[0].value is not None:
        is_given = scope.presence.get(base_name(expression.items[0].value))
        if is_given is not None:
            return is_given, "BOOL"
    arguments = [argument.value for argument in expression.items if argument.value is not None]
    if expression.value == "DIM" and len(arguments) == 2:
        return _dimension_size(arguments[0], arguments[1], scope), "NUM"
    function = _FUNCTIONS.get(expression.value)
    if function is None:
        raise UnknownValueError(f"the function {expression.value} gives its value at run time")
    stated_arguments = [argument for argument in expression.items if argument.value is not None]
    values = [evaluate(argument.value, scope)[0] for argument in stated_arguments if not argument.name]
    options = {argument.name: number(argument.value, scope) for argument in stated_arguments if argument.name}
    try:
        return function(values, options)
    except (ValueError, TypeError, IndexError, ZeroDivisionError, OverflowError):
        raise UnknownValueError(f"the call of {expression.value} is not understood") from None


def _dimension_size(array: Expression, dimension: Expression, scope: Scope) -> float:
    """Return ``Dim(array, dimension)``: the number of elements in a dimension, as it is declared.

    :param dimension: number of the dimension, from 1.
    :raises UnknownValueError: the declaration of the array is not known, or the array has no such dimension.
    """
    dimension_number = number(dimension, scope)
    variable = scope.variable(array.value) if array.kind == "name" else None
    sizes = () if variable is None or variable.declaration is None else variable.declaration.dimensions
    if dimension_number not in range(1, len(sizes) + 1):
        raise UnknownValueError("the function DIM gives its value at run time, but for arrays that the module declares")
    # sizes of module data are evaluated without local data, which may have the same names
    return number(sizes[int(dimension_number) - 1], scope if array.value in scope.inner else Scope(scope.outer))


def _rotation(quaternion: list[float]) -> Array:
    """Return the rotation (3, 3) of a quaternion q1…q4."""
    return np.asarray(rotations(np.array([quaternion]))[0])


def _quaternion(rotation: Array) -> list[float]:
    """Return the quaternion q1…q4 of a rotation (3, 3)."""
    return [float(value) for value in quaternions(rotation[None])[0]]


def axis_rotation(axis: int, degrees: float) -> Array:
    """Return the rotation (3, 3) about an axis, 0 for x to 2 for z, by an angle [deg]."""
    rotation, angle = np.eye(3), degrees * RAD_PER_DEG
    i, j = (axis + 1) % 3, (axis + 2) % 3  # the other axes, in cyclic order: i turns to j
    rotation[i, i] = rotation[j, j] = np.cos(angle)
    rotation[j, i] = np.sin(angle)
    rotation[i, j] = -rotation[j, i]
    return rotation


def _offs(values: list[Value], options: dict[str, float]) -> tuple[Value, str]:
    """Return the value and type of ``Offs(p, x, y, z)``: the target p displaced in the work object [mm].

    :param values: p, x, y, z.
    :param options: optional arguments; must be empty.
    :raises ValueError: the arguments are not those of Offs.
    :raises UnknownValueError: p is no robtarget.
    """
    point, *offset = values
    if options or len(offset) != 3:
        raise ValueError
    record_numbers(point, 3, 4, 4, 6)
    return [[a + b for a, b in zip(point[0], offset, strict=True)], *point[1:]], "ROBTARGET"


def _reltool(values: list[Value], options: dict[str, float]) -> tuple[Value, str]:
    r"""Return value and type of ``RelTool(p, dx, dy, dz \Rx \Ry \Rz)``: target p displaced in its tool frame [mm].

    The tool is turned about x, then about the new y, then about the new z [deg].

    :param values: p, dx, dy, dz.
    :param options: name of each rotation, such as ``RX`` → angle.
    :raises ValueError: the arguments are not those of RelTool.
    :raises UnknownValueError: p is no robtarget.
    """
    point, *offset = values
    if set(options) - {"RX", "RY", "RZ"} or len(offset) != 3:
        raise ValueError
    record_numbers(point, 3, 4, 4, 6)
    rotation = _rotation(point[1])
    position = np.array(point[0]) + rotation @ np.array(offset, dtype=np.float64)
    orientation = point[1]
    if options:
        for axis, name in enumerate(("RX", "RY", "RZ")):
            rotation = rotation @ axis_rotation(axis, options.get(name, 0.0))
        orientation = _quaternion(rotation)
    return [position.tolist(), orientation, *point[2:]], "ROBTARGET"


def _orient_zyx(values: list[Value], options: dict[str, float]) -> tuple[Value, str]:
    """Return the value and type of ``OrientZYX(z, y, x)``: the quaternion of rotations about z, new y, new x [deg].

    R = Rz(z) · Ry(y) · Rx(x).

    :param values: z, y, x.
    :param options: optional arguments; must be empty.
    :raises ValueError: the arguments are not those of OrientZYX.
    """
    z, y, x = values
    if options:
        raise ValueError
    return _quaternion(axis_rotation(2, z) @ axis_rotation(1, y) @ axis_rotation(0, x)), "ORIENT"


def _number_function(function: Callable[..., float]) -> Callable[[list[Value], dict[str, float]], tuple[Value, str]]:
    """Return a function of numbers in the form of `_FUNCTIONS`: a function of a list of values and a dict of options.

    When it is called with options, or with values that are no numbers, it raises ValueError.

    :param function: function of one or more numbers; angles are in degrees as in RAPID.
    """

    def call(values: list[Value], options: dict[str, float]) -> tuple[Value, str]:
        """Return the value of the function, and the type NUM.

        :raises ValueError: there are options, or values that are no numbers.
        """
        if options or any(isinstance(value, bool) or not isinstance(value, float) for value in values):
            raise ValueError
        return float(function(*values)), "NUM"

    return call


_FUNCTIONS: dict[str, Callable[[list[Value], dict[str, float]], tuple[Value, str]]] = {
    "OFFS": _offs,
    "RELTOOL": _reltool,
    "ORIENTZYX": _orient_zyx,
    "ABS": _number_function(abs),
    "SQRT": _number_function(math.sqrt),
    "POW": _number_function(math.pow),
    "SIN": _number_function(lambda a: math.sin(math.radians(a))),
    "COS": _number_function(lambda a: math.cos(math.radians(a))),
    "TAN": _number_function(lambda a: math.tan(math.radians(a))),
    "ASIN": _number_function(lambda a: math.degrees(math.asin(a))),
    "ACOS": _number_function(lambda a: math.degrees(math.acos(a))),
    "ATAN": _number_function(lambda a: math.degrees(math.atan(a))),
    "ATAN2": _number_function(lambda a, b: math.degrees(math.atan2(a, b))),
}
FOLLOWED_FUNCTIONS = frozenset({*_FUNCTIONS, "PRESENT", "DIM"})
"""Functions of RAPID whose values can be known before run time."""
_EVALUATORS: dict[str, Callable[[Expression, Scope], tuple[Value, str]]] = {
    "number": _literal_value,
    "bool": _literal_value,
    "string": _literal_value,
    "name": _data_value,
    "numbers": _robtarget_value,
    "index": _element_value,
    "field": _component_value,
    "list": _aggregate_value,
    "operation": _operation_value,
    "call": _function_value,
}


def changed_arguments(arguments: tuple[Argument, ...]) -> Iterator[Expression]:
    """Yield the values of arguments that a call may change: data, their elements and components."""
    for argument in arguments:
        if argument.value is not None and argument.value.kind in ("name", "index", "field"):
            yield argument.value


def base_name(expression: Expression) -> str:
    """Return the name of the data that an expression is, or is a part of; empty for other expressions."""
    while expression.kind in ("index", "field"):
        expression = expression.items[0]
    return expression.value if expression.kind == "name" else ""


def assign(target: Expression, value: Value, scope: Scope) -> None:
    """Assign a value to data, to an element or to a component.

    Data that a trap or handler may change at any time become unknown instead.

    :param target: name, element or component.
    :raises UnknownValueError: the data are not declared, or an index or the value of the whole array is not known.
    :raises ValueError: the record has no such component.
    """
    variable = scope.variable(base_name(target))
    if variable.interrupt:
        variable.forget(f"{variable.interrupt} may change it")
        return
    if target.kind == "name":
        variable.change(value)
        return
    path: list[int] = []  # to the element or component: indices from 0, from outside to inside
    inner = target
    while inner.kind in ("index", "field"):
        if inner.kind == "index":
            path[:0] = [_list_index(item, scope) for item in inner.items[1:]]
        else:
            _, type_ = evaluate(inner.items[0], scope)
            path.insert(0, [name for name, _ in FIELDS.get(type_, ())].index(inner.value))
        inner = inner.items[0]
    record_or_array, _ = evaluate(inner, scope)  # `inner` is the name of the data now
    variable.change(_replace_component(record_or_array, path, value))


def _replace_component(record_or_array: Value, path: list[int], value: Value) -> Value:
    """Return a record or array with another value of one component.

    :param path: indices of the component, from 0, from outside to inside; empty: the whole value is replaced.
    :raises UnknownValueError: there is no such component.
    """
    if not path:
        return value
    if not isinstance(record_or_array, list) or not 0 <= path[0] < len(record_or_array):
        raise UnknownValueError("the index is outside of the array")
    return [
        _replace_component(item, path[1:], value) if index == path[0] else item
        for index, item in enumerate(record_or_array)
    ]
