"""Parameters (``#1``, ``#<name>``) and expressions of a running program, by the rules of LinuxCNC.

Parameters 1 to 30 and plain names are local to a subprogram. Numbers from 31 on and names that begin with ``_`` are
global. Only the machine knows a parameter that no block has set (the last probed point, the position of G28, results of
another program), so reading it is an error.

An expression is written in ``[ ]``. ``**`` binds first, then ``*`` ``/`` ``MOD``, then ``+`` ``-``, then comparisons,
then ``AND`` ``OR`` ``XOR``; operators of equal precedence are evaluated from the left. Angles are in degrees. EQ, NE,
GE and LE treat numbers closer than 0.0001 as equal. MOD is never negative (LinuxCNC, `interp_execute.cc`,
`interp_read.cc`).
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence

from postproc.dialects.gcode.words import BlockError

ARGUMENTS = 30
"""Number of numbered parameters that are local to a subprogram."""
_LOCAL_NUMBERS = range(1, ARGUMENTS + 1)
_LARGEST_NUMBER = 5601
"""Parameters of RS274/NGC in LinuxCNC are #1 to #5601 (RS274NGC_MAX_PARAMETERS is 5602)."""
_LARGEST_PROGRAM_NUMBER = 5000
"""Parameters above this number belong to the control: probed points, offsets, positions."""
_SET_ADVICE = "Set it in the program before its first use."
_MACHINE_ADVICE = "Only the machine knows it: write the number instead."


def parameter_key(name: str) -> str:
    """Return the name of a parameter as its key: case and blanks do not count."""
    return "".join(name.split()).lower()


Key = int | str
"""A parameter: its number, or its name."""


class Parameters:
    """Values of the parameters while a program runs.

    `_global_values` also has the numbers 1 to 30, which `enter` saves and replaces. `_callers` has for each open call
    the values of these numbers (None for M98) and the local names of the caller.
    """

    def __init__(self) -> None:
        self._global_values: dict[Key, float] = {}
        self._local_values: dict[Key, float] = {}
        self._callers: list[tuple[dict[Key, float] | None, dict[Key, float]]] = []

    def get(self, key: Key) -> float:
        """Return the value of a parameter.

        :raises BlockError: the parameter has no value, or its number is out of range.
        """
        value = self._scope(key).get(key)
        if value is not None:
            return value
        if isinstance(key, int):
            is_machine_value = _check_number(key) > _LARGEST_PROGRAM_NUMBER
            raise BlockError(f"parameter #{key} has no value", _MACHINE_ADVICE if is_machine_value else _SET_ADVICE)
        raise BlockError(f"parameter #<{key}> has no value", _MACHINE_ADVICE if key.startswith("_") else _SET_ADVICE)

    def exists(self, key: Key) -> bool:
        """Return whether a parameter has a value."""
        return key in self._scope(key)

    def put(self, key: Key, value: float) -> None:
        """Give a parameter a value.

        :raises BlockError: the parameter belongs to the control, or its number is out of range.
        """
        if isinstance(key, int) and _check_number(key) > _LARGEST_PROGRAM_NUMBER:
            raise BlockError(f"parameter #{key} belongs to the control", "Use G10, G52 or G54 … instead.")
        self._scope(key)[key] = value

    def enter(self, arguments: Sequence[float] | None) -> None:
        """Begin a subprogram, whose local names have no value yet.

        :param arguments: values of #1, #2 …; the other numbers up to 30 become zero. None (M98): the subprogram uses
            and sets the numbers of its caller.
        """
        caller_values: dict[Key, float] | None = None
        if arguments is not None:
            caller_values = {n: self._global_values[n] for n in _LOCAL_NUMBERS if n in self._global_values}
            self._global_values.update(dict.fromkeys(_LOCAL_NUMBERS, 0.0))
            self._global_values.update(enumerate(arguments, 1))
        self._callers.append((caller_values, self._local_values))
        self._local_values = {}

    def leave(self) -> None:
        """End a subprogram: restore the local parameters of its caller; after M98 only its local names."""
        caller_values, self._local_values = self._callers.pop()
        if caller_values is not None:
            for n in _LOCAL_NUMBERS:
                self._global_values.pop(n, None)
            self._global_values.update(caller_values)

    def _scope(self, key: Key) -> dict[Key, float]:
        """Return the values among which a parameter is: `_local_values` for a local name, else `_global_values`."""
        return self._local_values if isinstance(key, str) and not key.startswith("_") else self._global_values


def _check_number(number: int) -> int:
    """Return the number of a parameter as it is.

    :raises BlockError: the number is out of range.
    """
    if not 0 < number <= _LARGEST_NUMBER:
        raise BlockError(f"there is no parameter #{number}", f"Numbers are 1 to {_LARGEST_NUMBER}.")
    return number


Value = Callable[[Parameters], float]
"""An expression: evaluates to a number, given the parameters."""

_EQUALITY_TOLERANCE = 1e-4
"""Numbers that differ by less are equal in EQ, NE, LE and GE, as in LinuxCNC."""
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
_NAME = re.compile(r"<([^<>#]+)>")
_FUNCTION = re.compile(r"(ABS|ACOS|ASIN|ATAN|COS|EXISTS|EXP|FIX|FUP|LN|ROUND|SIN|SQRT|TAN)(?=\[)")
_OPERATOR = re.compile(r"\*\*|[-+*/]|MOD|AND|XOR|OR|EQ|NE|GT|GE|LT|LE")


def _modulo(left: float, right: float) -> float:
    """Return the remainder of a division, never negative (LinuxCNC)."""
    remainder = math.fmod(left, right)
    return remainder + abs(right) if remainder < 0.0 else remainder


_BINARY_OPERATORS: Mapping[str, tuple[int, Callable[[float, float], float]]] = {
    "**": (5, math.pow),
    "*": (4, operator.mul),
    "/": (4, operator.truediv),
    "MOD": (4, _modulo),
    "+": (3, operator.add),
    "-": (3, operator.sub),
    "EQ": (2, lambda a, b: float(abs(a - b) < _EQUALITY_TOLERANCE)),
    "NE": (2, lambda a, b: float(abs(a - b) >= _EQUALITY_TOLERANCE)),
    "GT": (2, lambda a, b: float(a > b)),
    "LT": (2, lambda a, b: float(a < b)),
    "GE": (2, lambda a, b: float(a >= b or abs(a - b) < _EQUALITY_TOLERANCE)),
    "LE": (2, lambda a, b: float(a <= b or abs(a - b) < _EQUALITY_TOLERANCE)),
    "AND": (1, lambda a, b: float(a != 0.0 and b != 0.0)),
    "OR": (1, lambda a, b: float(a != 0.0 or b != 0.0)),
    "XOR": (1, lambda a, b: float((a != 0.0) != (b != 0.0))),
}
_UNARY_FUNCTIONS: Mapping[str, Callable[[float], float]] = {
    "ABS": abs,
    "ACOS": lambda x: math.degrees(math.acos(x)),
    "ASIN": lambda x: math.degrees(math.asin(x)),
    "COS": lambda x: math.cos(math.radians(x)),
    "EXP": math.exp,
    "FIX": lambda x: float(math.floor(x)),
    "FUP": lambda x: float(math.ceil(x)),
    "LN": math.log,
    "ROUND": lambda x: float(int(x + math.copysign(0.5, x))),
    "SIN": lambda x: math.sin(math.radians(x)),
    "SQRT": math.sqrt,
    "TAN": lambda x: math.tan(math.radians(x)),
}


def nearest_integer(value: float) -> int:
    """Return the integer nearest to a value, from which it may differ by 0.0001, as in rs274.

    :raises BlockError: the value differs by more, or is not finite.
    """
    if not math.isfinite(value) or abs(value - round(value)) > _EQUALITY_TOLERANCE:
        raise BlockError(f"{value:g} is not a whole number", None)
    return round(value)


_MOST_NESTED = 50
"""Limit of brackets and signs nested in each other: a program has a few, a damaged file may have thousands."""


class Reader:
    """Parser for values in a packed line, from `position`."""

    def __init__(self, code: str, position: int = 0) -> None:
        self.code, self.position, self._depth = code, position, 0

    def read_value(self) -> Value:
        """Read a value: a number, a parameter, a function or an expression, with signs before it.

        :raises BlockError: there is none, or brackets and signs are nested too deeply.
        """
        if self._depth == _MOST_NESTED:
            raise BlockError(f"more than {_MOST_NESTED} brackets or signs one in another", None)
        self._depth += 1
        result = self._read_unnested_value()
        self._depth -= 1
        return result

    def _read_unnested_value(self) -> Value:
        """Read a value like `read_value`, which counts how deeply values are nested.

        :raises BlockError: there is none, or it is beyond the range of floats.
        """
        number = self._match(_NUMBER)
        if number is not None:
            constant = float(number[0])
            if not math.isfinite(constant):
                raise BlockError(f"a number of {len(number[0])} digits", "Check the number.")
            return lambda _: constant
        next_character = self.code[self.position : self.position + 1]
        if next_character == "[":
            return self.read_expression()
        if next_character == "#":
            return _parameter_value(self.read_parameter())
        if next_character in ("+", "-"):
            self.position += 1
            inner = self.read_value()
            return inner if next_character == "+" else lambda parameters: -inner(parameters)
        return self._read_function()

    def read_expression(self) -> Value:
        """Read an expression ``[ … ]``; return a function for its value.

        :raises BlockError: a bracket or a value is missing or invalid.
        """
        self._expect("[")
        value = self._read_operations(1)
        self._expect("]")
        return value

    def read_parameter(self) -> Callable[[Parameters], Key]:
        """Read ``#…``; return a function for the key of the parameter.

        The returned function raises `BlockError` if a computed number is not whole.

        :raises BlockError: no name or number follows.
        """
        self._expect("#")
        name = self._match(_NAME)
        if name is not None:
            key = parameter_key(name[1])
            return lambda _: key
        index = self.read_value()
        return lambda parameters: nearest_integer(index(parameters))

    def _read_operations(self, weakest: int) -> Value:
        """Read values and the operators between them, up to the first operator that binds less tightly than `weakest`.

        This is precedence climbing: the right side of an operator is read with a precedence that is higher by one.

        :param weakest: least precedence, see `_BINARY_OPERATORS`.
        :returns: a function for the result.
        :raises BlockError: a value is missing or invalid.
        """
        left = self.read_value()
        while True:
            match = _OPERATOR.match(self.code, self.position)
            if match is None or _BINARY_OPERATORS[match[0]][0] < weakest:
                return left
            self.position = match.end()
            precedence, function = _BINARY_OPERATORS[match[0]]
            left = _binary_value(match[0], function, left, self._read_operations(precedence + 1))

    def _read_function(self) -> Value:
        """Read a function, such as SIN[…] or ATAN[…]/[…]; return a function for its value.

        :raises BlockError: no function follows, or its argument is invalid.
        """
        name = self._match(_FUNCTION)
        if name is None:
            remaining_text = self.code[self.position : self.position + 12]
            raise BlockError(
                f"a value was expected before {remaining_text!r}" if remaining_text else "a value is missing", None
            )
        if name[1] == "EXISTS":
            self._expect("[")
            key = self.read_parameter()
            self._expect("]")
            return lambda parameters: float(parameters.exists(key(parameters)))
        inner = self.read_expression()
        if name[1] == "ATAN":
            self._expect("/")
            divisor = self.read_expression()
            return lambda parameters: math.degrees(math.atan2(inner(parameters), divisor(parameters)))
        return _unary_value(name[1], inner)

    def _match(self, pattern: re.Pattern[str]) -> re.Match[str] | None:
        """Return the match of a pattern at `position`, and skip it; None: the pattern does not match."""
        match = pattern.match(self.code, self.position)
        if match is not None:
            self.position = match.end()
        return match

    def _expect(self, character: str) -> None:
        """Skip a character.

        :raises BlockError: another character is at `position`.
        """
        if not self.code.startswith(character, self.position):
            remaining_text = self.code[self.position : self.position + 12]
            raise BlockError(
                f"{character!r} was expected before {remaining_text!r}"
                if remaining_text
                else f"{character!r} is missing",
                None,
            )
        self.position += 1


def _parameter_value(key: Callable[[Parameters], Key]) -> Value:
    """Return a function for the value of a parameter, whose key may be computed.

    The returned function raises `BlockError` if the parameter has no value.
    """
    return lambda parameters: parameters.get(key(parameters))


def _unary_value(name: str, inner: Value) -> Value:
    """Return a function that applies the function `name` of G-code to a value.

    The returned function raises `BlockError` if the result is not defined, such as for SQRT[-1].
    """
    function = _UNARY_FUNCTIONS[name]

    def apply(parameters: Parameters) -> float:
        """Return the result for the present parameters.

        :raises BlockError: it is not defined.
        """
        value = inner(parameters)
        try:
            return function(value)
        except (ValueError, OverflowError):
            raise BlockError(f"{name}[{value:g}] has no value", None) from None

    return apply


def _binary_value(name: str, function: Callable[[float, float], float], left: Value, right: Value) -> Value:
    """Return a function that combines two values by an operator.

    The returned function raises `BlockError` if the result is not defined or beyond the range of floats.

    :param name: the operator, for messages; `function`: its function of two numbers.
    """

    def apply(parameters: Parameters) -> float:
        """Return the result for the present parameters.

        :raises BlockError: it is not defined or not finite.
        """
        a, b = left(parameters), right(parameters)
        try:
            result = function(a, b)
        except (ValueError, OverflowError, ZeroDivisionError):
            result = math.nan
        if not math.isfinite(result):  # a product that is too large is infinite, without an exception
            raise BlockError(f"[{a:g} {name} {b:g}] has no value", None)
        return result

    return apply
