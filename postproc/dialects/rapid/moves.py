"""The motion that a move instruction of RAPID states: targets, speed, zone, tool and work object, with their values.

What arguments mean: ABB, Technical reference manual, RAPID Instructions, Functions and Data types (3HAC16581).
"""

from __future__ import annotations

import math
from collections.abc import Callable

from msgspec import Struct

from postproc.dialects.rapid.instructions import Form
from postproc.dialects.rapid.syntax import Argument, Declaration, Expression, Instruction
from postproc.dialects.rapid.values import (
    FIELDS,
    Scope,
    UnknownValueError,
    Value,
    base_name,
    evaluate,
    number,
    predefined_data,
    record_numbers,
)

Frames = Callable[[str, str], Value | None]
"""Returns the tool or work object of the cell by name and type, for those that no module declares, or None."""

_OPTIONS = {"WOBJ", "V", "T", "Z", "CONC", "INPOS", "TLOAD", "NOEOFFS", "T1", "T2", "T3", "T4", "T5", "T6", "T7", "T8"}
_REFUSED_OPTIONS = {
    "ID": "moves together with other robots",
    "CORR": "is corrected by a sensor",
    "TRACK": "is led by a sensor",
    "ADVANCED": "is led by a sensor",
}


_LARGEST = 1e6
"""Speeds [mm/s], durations [s] and zones [mm] beyond are mistakes (assumed)."""


class Setting(Struct, frozen=True):
    """What instructions have set for the moves that follow.

    :ivar follows: True while MoveJ goes to the configuration of its target (ConfJ).
    :ivar area: SingArea: OFF, WRIST or LOCKAXIS4.
    :ivar circles: CirPathMode: PATHFRAME, OBJECTFRAME or another.
    :ivar speed: VelSet: share of the speed, and its limit [mm/s].
    """

    follows: bool = True
    area: str = "OFF"
    circles: str = "PATHFRAME"
    speed: tuple[float, float] = (1.0, 5000.0)


class Target(Struct, frozen=True, eq=False):
    """The end of a motion or the point on a circle.

    :ivar numbers: the 17 numbers of a robtarget, or the 12 of a jointtarget.
    :ivar expression: of the argument; `literal` that of its numbers in the text, if they stand there.
    :ivar data: declaration that has the numbers; None: the argument itself has them, or they are calculated.
    """

    numbers: list[float]
    expression: Expression
    literal: Expression | None = None
    data: Declaration | None = None


class Move(Struct, frozen=True, eq=False):
    """An executed motion.

    :ivar speed: of the TCP [mm/s], `duration` [s] if that is given instead, else 0.
    :ivar turn_speed: largest speed at which the tool turns (v_ori) [deg/s]; infinite if it is not stated.
    :ivar zone: approximation distance [mm]; 0 for a stop.
    :ivar tool_name: of the data that are the tool, as they are declared; empty for a component of other data.
    """

    statement: Instruction
    kind: int
    target: Target
    via: Target | None
    joints: bool
    speed: float
    duration: float
    turn_speed: float
    zone: float
    tool: Value
    tool_name: str
    wobj: Value
    setting: Setting


def stated_move(statement: Instruction, form: Form, scope: Scope, setting: Setting, frames: Frames) -> Move:
    """Return the motion that an instruction states.

    :param form: of its arguments; `setting`: what earlier instructions have set.
    :param frames: see `Frames`.
    :raises UnknownValueError: a value is not known before the program runs, or an option is not followed.
    """
    expressions = [
        argument.value for argument in statement.arguments if not argument.name and argument.value is not None
    ]
    options = {argument.name: argument for argument in statement.arguments if argument.name}
    for name in options:
        if name in _REFUSED_OPTIONS:
            raise UnknownValueError(f"the move {_REFUSED_OPTIONS[name]} (\\{name})")
        if name not in _OPTIONS:
            raise UnknownValueError(f"\\{name} is not followed")
    min_count = form.points + 3 + form.before_zone  # points, speed, perhaps a trigger, zone and tool
    if not min_count <= len(expressions) <= min_count + form.behind:
        raise UnknownValueError(f"{statement.name} has {len(expressions)} arguments instead of {min_count}")
    *via_points, end_point = (_target(expressions[k], scope, joints=form.joints) for k in range(form.points))
    speed_index, zone_index = form.points, form.points + 1 + form.before_zone
    speed, duration = _speed_and_duration(expressions[speed_index], options, scope, setting)
    wobj = options["WOBJ"].value if "WOBJ" in options else None
    return Move(
        statement=statement,
        kind=form.kind,
        target=end_point,
        via=via_points[0] if via_points else None,
        joints=form.joints,
        speed=speed,
        duration=duration,
        turn_speed=_turn_speed(expressions[speed_index], options, scope, setting),
        zone=_zone(expressions[zone_index], options, scope),
        tool=_frame(expressions[zone_index + 1], "TOOLDATA", scope, frames),
        tool_name=_data_name(expressions[zone_index + 1], scope),
        wobj=predefined_data()["WOBJ0"][0] if wobj is None else _frame(wobj, "WOBJDATA", scope, frames),
        setting=setting,
    )


def _target(expression: Expression, scope: Scope, *, joints: bool) -> Target:
    """Return the numbers of a target and where they are written.

    :raises UnknownValueError: they are unknown, or of another type.
    """
    if expression.kind == "numbers":
        if joints:
            raise UnknownValueError("MoveAbsJ goes to joint angles, not to a robtarget")
        return Target([float(text) for text in expression.value], expression, expression)
    value, type_ = evaluate(expression, scope)
    if type_ not in ("", "JOINTTARGET" if joints else "ROBTARGET"):
        raise UnknownValueError(f"a {type_.lower()} is no target of {'MoveAbsJ' if joints else 'this move'}")
    numbers = _numbers(value, joints=joints)
    variable = scope.find(base_name(expression))
    if expression.kind == "list":
        return Target(numbers, expression, expression)
    if variable is not None and variable.literal and variable.declaration is not None:
        element = _element(expression, variable.declaration.value, scope)
        if element is not None and scope.outer.get(base_name(expression)) is variable:
            return Target(numbers, expression, element, variable.declaration)
    return Target(numbers, expression)


def _speed_and_duration(
    expression: Expression, options: dict[str, Argument], scope: Scope, setting: Setting
) -> tuple[float, float]:
    """Return the speed of the TCP [mm/s] and the duration of the move [s]; the one that is not stated is 0.

    :raises UnknownValueError: neither is known.
    """
    share, limit = setting.speed
    for name in ("T", "V"):
        argument = options.get(name)
        if argument is not None and argument.value is not None:
            value = number(argument.value, scope)
            if not 0.0 < value < _LARGEST:
                raise UnknownValueError(f"\\{name} must be more than 0")
            return (0.0, value / share) if name == "T" else (min(value * share, limit), 0.0)
    value, _ = evaluate(expression, scope)
    if not isinstance(value, list) or len(value) != len(FIELDS["SPEEDDATA"]):
        raise UnknownValueError("the speed is no speeddata")
    tcp = value[0]
    if isinstance(tcp, bool) or not isinstance(tcp, float) or not 0.0 < tcp < _LARGEST:
        raise UnknownValueError("the speed of the TCP must be more than 0")
    return min(tcp * share, limit), 0.0


def _turn_speed(expression: Expression, options: dict[str, Argument], scope: Scope, setting: Setting) -> float:
    """Return v_ori of the speeddata of a move [deg/s]; infinite if it is not known, or the move has a duration.

    VelSet changes it in proportion; the option V gives another speed of the TCP only, T another one of all.
    """
    if "T" in options:
        return math.inf
    try:
        value, _ = evaluate(expression, scope)
    except UnknownValueError:
        return math.inf
    speed = value[1] if isinstance(value, list) and len(value) == len(FIELDS["SPEEDDATA"]) else None
    if not isinstance(speed, float) or isinstance(speed, bool) or speed <= 0.0:
        return math.inf
    return speed * setting.speed[0]


def _zone(expression: Expression, options: dict[str, Argument], scope: Scope) -> float:
    """Return the radius [mm] of a zone, 0 for a stop point.

    :raises UnknownValueError: it is unknown.
    """
    argument = options.get("Z")
    if argument is not None and argument.value is not None:
        return max(number(argument.value, scope), 0.0)
    if "INPOS" in options:
        return 0.0
    value, _ = evaluate(expression, scope)
    if not isinstance(value, list) or len(value) != len(FIELDS["ZONEDATA"]) or not isinstance(value[0], bool):
        raise UnknownValueError("the zone is no zonedata")
    distance = value[1]
    if isinstance(distance, bool) or not isinstance(distance, float) or not 0.0 <= distance < _LARGEST:
        raise UnknownValueError("the zone is no distance")
    return 0.0 if value[0] else distance


def _frame(expression: Expression, type_: str, scope: Scope, frames: Frames) -> Value:
    """Return a tool or work object; one that no module declares is that of the cell.

    :param type_: TOOLDATA or WOBJDATA.
    :raises UnknownValueError: it is unknown, or of another type.
    """
    if expression.kind == "name" and scope.find(expression.value) is None:
        value = frames(expression.value, type_)
        if value is not None:
            return value
    value, value_type = evaluate(expression, scope)
    if value_type not in ("", type_):
        raise UnknownValueError(f"a {value_type.lower()} is no {type_.lower()}")
    return value


def _data_name(expression: Expression, scope: Scope) -> str:
    """Return the name of the data that an expression is, as they are declared; empty for a component of other data.

    A parameter has the name of the data that the call gives it. Data that no module declares have it in upper case.
    """
    if expression.kind != "name":
        return ""
    variable = scope.find(expression.value)
    if variable is not None and variable.declaration is not None:
        return variable.declaration.spelling
    return "" if expression.value in scope.inner else str(expression.value)


def _numbers(value: Value, *, joints: bool) -> list[float]:
    """Return the 17 numbers of a robtarget, or the 12 of a jointtarget.

    :raises UnknownValueError: the value has another form.
    """
    return record_numbers(value, 6, 6) if joints else record_numbers(value, 3, 4, 4, 6)


def _element(expression: Expression, initial: Expression | None, scope: Scope) -> Expression | None:
    """Return the part of a declaration that has the numbers of an expression; None if there is none.

    :param expression: data, or an element of an array; `initial`: the declared value, or None.
    :raises UnknownValueError: an index is not known.
    """
    if initial is None or expression.kind not in ("name", "index"):
        return None
    element: Expression = initial
    for item in expression.items[1:]:
        if element.kind != "list":
            return None
        element = element.items[int(number(item, scope)) - 1]
    return element if element.kind in ("numbers", "list") else None


def equal(first: Move, second: Move) -> bool:
    """Return whether two motions are the same."""
    same_target = first.statement is second.statement and first.target.numbers == second.target.numbers
    same_via = (first.via.numbers if first.via else None) == (second.via.numbers if second.via else None)
    has_same_data = (first.speed, first.zone, first.tool, first.wobj, first.setting) == (
        second.speed, second.zone, second.tool, second.wobj, second.setting,
    )  # fmt: skip
    return same_target and same_via and has_same_data
