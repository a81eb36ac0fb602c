"""Numbers, parameters and expressions where a word has its value, by the rules of LinuxCNC's rs274.

An expression stands in ``[ ]``. What binds first is ``**``, then ``*`` ``/`` ``MOD``, then ``+`` ``-``, then
comparisons, then ``AND`` ``OR`` ``XOR``; equals are worked out from the left. Angles are degrees; EQ and NE, GE and LE
take numbers closer than 0.0001 for equal; MOD is never negative (LinuxCNC, `interp_execute.cc`, `interp_read.cc`).
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping

from postproc.dialects.gcode.blocks import BlockError
from postproc.dialects.gcode.parameters import Key, Parameters, key_of

Value = Callable[[Parameters], float]
"""What a value is while a program runs: its parameters in, a number out."""

_SAME = 1e-4
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
_NAME = re.compile(r"<([^<>#]+)>")
_FUNCTION = re.compile(r"(ABS|ACOS|ASIN|ATAN|COS|EXISTS|EXP|FIX|FUP|LN|ROUND|SIN|SQRT|TAN)(?=\[)")
_OPERATOR = re.compile(r"\*\*|[-+*/]|MOD|AND|XOR|OR|EQ|NE|GT|GE|LT|LE")


def _modulo(left: float, right: float) -> float:
    rest = math.fmod(left, right)
    return rest + abs(right) if rest < 0.0 else rest


_BINARY: Mapping[str, tuple[int, Callable[[float, float], float]]] = {
    "**": (5, math.pow),
    "*": (4, operator.mul),
    "/": (4, operator.truediv),
    "MOD": (4, _modulo),
    "+": (3, operator.add),
    "-": (3, operator.sub),
    "EQ": (2, lambda a, b: float(abs(a - b) < _SAME)),
    "NE": (2, lambda a, b: float(abs(a - b) >= _SAME)),
    "GT": (2, lambda a, b: float(a > b)),
    "LT": (2, lambda a, b: float(a < b)),
    "GE": (2, lambda a, b: float(a >= b or abs(a - b) < _SAME)),
    "LE": (2, lambda a, b: float(a <= b or abs(a - b) < _SAME)),
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


def whole(value: float) -> int:
    """Return a number that must be whole, as rs274 reads one: within 0.0001."""
    if abs(value - round(value)) > _SAME:
        raise BlockError(f"{value:g} is not a whole number", None)
    return round(value)


class Reader:
    """Reads values from a packed line, from `at` on."""

    def __init__(self, code: str, at: int = 0) -> None:
        self.code, self.at = code, at

    def value(self) -> Value:
        """Read a value: a number, a parameter, a function or an expression, with signs before it."""
        number = self._match(_NUMBER)
        if number is not None:
            constant = float(number[0])
            return lambda _: constant
        following = self.code[self.at : self.at + 1]
        if following == "[":
            return self.expression()
        if following == "#":
            return _looked_up(self.parameter())
        if following in ("+", "-") and following:
            self.at += 1
            inner = self.value()
            return inner if following == "+" else lambda known: -inner(known)
        return self._function()

    def expression(self) -> Value:
        """Read ``[ … ]``."""
        self._expect("[")
        out = self._operation(1)
        self._expect("]")
        return out

    def parameter(self) -> Callable[[Parameters], Key]:
        """Read ``#…``: which parameter it is."""
        self._expect("#")
        name = self._match(_NAME)
        if name is not None:
            key = key_of(name[1])
            return lambda _: key
        index = self.value()
        return lambda known: whole(index(known))

    def _operation(self, weakest: int) -> Value:
        left = self.value()
        while True:
            found = _OPERATOR.match(self.code, self.at)
            if found is None or _BINARY[found[0]][0] < weakest:
                return left
            self.at = found.end()
            precedence, function = _BINARY[found[0]]
            left = _joined(found[0], function, left, self._operation(precedence + 1))

    def _function(self) -> Value:
        name = self._match(_FUNCTION)
        if name is None:
            rest = self.code[self.at : self.at + 12]
            raise BlockError(f"a value was expected before {rest!r}" if rest else "a value is missing", None)
        if name[1] == "EXISTS":
            self._expect("[")
            key = self.parameter()
            self._expect("]")
            return lambda known: float(known.exists(key(known)))
        inner = self.expression()
        if name[1] == "ATAN":
            self._expect("/")
            other = self.expression()
            return lambda known: math.degrees(math.atan2(inner(known), other(known)))
        return _applied(name[1], inner)

    def _match(self, pattern: re.Pattern[str]) -> re.Match[str] | None:
        found = pattern.match(self.code, self.at)
        if found is not None:
            self.at = found.end()
        return found

    def _expect(self, character: str) -> None:
        if not self.code.startswith(character, self.at):
            rest = self.code[self.at : self.at + 12]
            raise BlockError(
                f"{character!r} was expected before {rest!r}" if rest else f"{character!r} is missing", None
            )
        self.at += 1


def _looked_up(key: Callable[[Parameters], Key]) -> Value:
    return lambda known: known.get(key(known))


def _applied(name: str, inner: Value) -> Value:
    function = _UNARY[name]

    def apply(known: Parameters) -> float:
        value = inner(known)
        try:
            return function(value)
        except (ValueError, OverflowError):
            raise BlockError(f"{name}[{value:g}] has no value", None) from None

    return apply


def _joined(name: str, function: Callable[[float, float], float], left: Value, right: Value) -> Value:
    def apply(known: Parameters) -> float:
        one, other = left(known), right(known)
        try:
            return function(one, other)
        except (ValueError, OverflowError, ZeroDivisionError):
            raise BlockError(f"[{one:g} {name} {other:g}] has no value", None) from None

    return apply
