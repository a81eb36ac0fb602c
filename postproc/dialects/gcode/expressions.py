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
_LOCAL = range(1, ARGUMENTS + 1)
_LARGEST = 5601
"""Parameters of RS274/NGC in LinuxCNC are #1 to #5601 (RS274NGC_MAX_PARAMETERS is 5602)."""
_OF_THE_MACHINE = 5000
"""Parameters above this number belong to the control: probed points, offsets, positions."""
_SET_FIRST = "Set it in the program before its first use."
_MACHINE = "Only the machine knows it: write the number instead."


def key_of(name: str) -> str:
    """Return the name of a parameter as its key: case and blanks do not count."""
    return "".join(name.split()).lower()


Key = int | str
"""A parameter: its number, or its name."""


class Parameters:
    """Values of the parameters while a program runs."""

    def __init__(self) -> None:
        self._common: dict[Key, float] = {}
        self._local: dict[Key, float] = {}
        self._callers: list[tuple[dict[Key, float] | None, dict[Key, float]]] = []

    def get(self, key: Key) -> float:
        """Return the value of a parameter.

        :raises BlockError: it has none.
        """
        value = self._scope(key).get(key)
        if value is not None:
            return value
        if isinstance(key, int):
            is_machine_value = _check_number(key) > _OF_THE_MACHINE
            raise BlockError(f"parameter #{key} has no value", _MACHINE if is_machine_value else _SET_FIRST)
        raise BlockError(f"parameter #<{key}> has no value", _MACHINE if key.startswith("_") else _SET_FIRST)

    def exists(self, key: Key) -> bool:
        """Return whether a parameter has a value."""
        return key in self._scope(key)

    def put(self, key: Key, value: float) -> None:
        """Give a parameter a value.

        :raises BlockError: the parameter belongs to the control.
        """
        if isinstance(key, int) and _check_number(key) > _OF_THE_MACHINE:
            raise BlockError(f"parameter #{key} belongs to the control", "Use G10, G52 or G54 … instead.")
        self._scope(key)[key] = value

    def enter(self, arguments: Sequence[float] | None) -> None:
        """Begin a subprogram, whose local names have no value yet.

        :param arguments: values of #1, #2 …; other local numbers are zero. None: it shares those of its caller (M98).
        """
        caller_values: dict[Key, float] | None = None
        if arguments is not None:
            caller_values = {n: self._common[n] for n in _LOCAL if n in self._common}
            self._common.update(dict.fromkeys(_LOCAL, 0.0))
            self._common.update(enumerate(arguments, 1))
        self._callers.append((caller_values, self._local))
        self._local = {}

    def leave(self) -> None:
        """End a subprogram: restore the local parameters of its caller."""
        caller_values, self._local = self._callers.pop()
        if caller_values is not None:
            for n in _LOCAL:
                self._common.pop(n, None)
            self._common.update(caller_values)

    def _scope(self, key: Key) -> dict[Key, float]:
        """Return the scope of a parameter: the values of local names, or of all other parameters."""
        return self._local if isinstance(key, str) and not key.startswith("_") else self._common


def _check_number(number: int) -> int:
    """Return the number of a parameter.

    :raises BlockError: it is out of range.
    """
    if not 0 < number <= _LARGEST:
        raise BlockError(f"there is no parameter #{number}", f"Numbers are 1 to {_LARGEST}.")
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


_BINARY: Mapping[str, tuple[int, Callable[[float, float], float]]] = {
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
_UNARY: Mapping[str, Callable[[float], float]] = {
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
    """Return a value that is whole within 0.0001, as rs274 requires.

    :raises BlockError: it is not.
    """
    if not math.isfinite(value) or abs(value - round(value)) > _EQUALITY_TOLERANCE:
        raise BlockError(f"{value:g} is not a whole number", None)
    return round(value)


_DEEPEST = 50
"""Values one in another: a program has a few, a damaged file may have thousands."""


class Reader:
    """Parser for values in a packed line, from position `at`."""

    def __init__(self, code: str, at: int = 0) -> None:
        self.code, self.at, self._inside = code, at, 0

    def value(self) -> Value:
        """Read a value: a number, a parameter, a function or an expression, with signs before it.

        :raises BlockError: there is none, or brackets and signs are nested too deeply.
        """
        if self._inside == _DEEPEST:
            raise BlockError(f"more than {_DEEPEST} brackets or signs one in another", None)
        self._inside += 1
        result = self._value()
        self._inside -= 1
        return result

    def _value(self) -> Value:
        """Return the next value: a number, [expression], parameter or function, with its sign.

        :raises BlockError: there is none, or it is beyond the range of floats.
        """
        number = self._match(_NUMBER)
        if number is not None:
            constant = float(number[0])
            if not math.isfinite(constant):
                raise BlockError(f"a number of {len(number[0])} digits", "Check the number.")
            return lambda _: constant
        following = self.code[self.at : self.at + 1]
        if following == "[":
            return self.expression()
        if following == "#":
            return _parameter_value(self.parameter())
        if following in ("+", "-"):
            self.at += 1
            inner = self.value()
            return inner if following == "+" else lambda parameters: -inner(parameters)
        return self._function()

    def expression(self) -> Value:
        """Read ``[ … ]``; return a function for its value.

        :raises BlockError: it is not valid.
        """
        self._expect("[")
        value = self._operation(1)
        self._expect("]")
        return value

    def parameter(self) -> Callable[[Parameters], Key]:
        """Read ``#…``; return a function for the key of the parameter.

        :raises BlockError: no name or number follows. That function raises it where the number is not whole.
        """
        self._expect("#")
        name = self._match(_NAME)
        if name is not None:
            key = key_of(name[1])
            return lambda _: key
        index = self.value()
        return lambda parameters: nearest_integer(index(parameters))

    def _operation(self, weakest: int) -> Value:
        """Return the operations from here on that bind at least as tightly as `weakest` (precedence climbing).

        :raises BlockError: a value is missing or invalid.
        """
        left = self.value()
        while True:
            match = _OPERATOR.match(self.code, self.at)
            if match is None or _BINARY[match[0]][0] < weakest:
                return left
            self.at = match.end()
            precedence, function = _BINARY[match[0]]
            left = _binary_value(match[0], function, left, self._operation(precedence + 1))

    def _function(self) -> Value:
        """Return the value of the next function, such as SIN[…] or ATAN[…]/[…].

        :raises BlockError: there is none.
        """
        name = self._match(_FUNCTION)
        if name is None:
            remaining_text = self.code[self.at : self.at + 12]
            raise BlockError(
                f"a value was expected before {remaining_text!r}" if remaining_text else "a value is missing", None
            )
        if name[1] == "EXISTS":
            self._expect("[")
            key = self.parameter()
            self._expect("]")
            return lambda parameters: float(parameters.exists(key(parameters)))
        inner = self.expression()
        if name[1] == "ATAN":
            self._expect("/")
            divisor = self.expression()
            return lambda parameters: math.degrees(math.atan2(inner(parameters), divisor(parameters)))
        return _unary_value(name[1], inner)

    def _match(self, pattern: re.Pattern[str]) -> re.Match[str] | None:
        """Return the match of a pattern here, and skip it; None: it does not match."""
        match = pattern.match(self.code, self.at)
        if match is not None:
            self.at = match.end()
        return match

    def _expect(self, character: str) -> None:
        """Skip a character.

        :raises BlockError: another one is here.
        """
        if not self.code.startswith(character, self.at):
            remaining_text = self.code[self.at : self.at + 12]
            raise BlockError(
                f"{character!r} was expected before {remaining_text!r}"
                if remaining_text
                else f"{character!r} is missing",
                None,
            )
        self.at += 1


def _parameter_value(key: Callable[[Parameters], Key]) -> Value:
    """Return a value that reads a parameter, whose key may be computed.

    :raises BlockError: when it is evaluated: the parameter has no value.
    """
    return lambda parameters: parameters.get(key(parameters))


def _unary_value(name: str, inner: Value) -> Value:
    """Return a value that applies the function `name` to another one.

    :raises BlockError: when it is evaluated: the function has no value there.
    """
    function = _UNARY[name]

    def apply(parameters: Parameters) -> float:
        """Return the value of the function.

        :raises BlockError: it has none.
        """
        value = inner(parameters)
        try:
            return function(value)
        except (ValueError, OverflowError):
            raise BlockError(f"{name}[{value:g}] has no value", None) from None

    return apply


def _binary_value(name: str, function: Callable[[float, float], float], left: Value, right: Value) -> Value:
    """Return a value that combines two others by an operator.

    :param name: of the operator, for messages; `function`: what it computes.
    :raises BlockError: when it is evaluated: the operation has no value there.
    """

    def apply(parameters: Parameters) -> float:
        """Return the value of the operation.

        :raises BlockError: it has none.
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
