"""Motions that move instructions of RAPID state: targets, speed, zone, tool and work object, with their values.

Source: ABB, Technical reference manual, RAPID Instructions, Functions and Data types (3HAC16581).
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
"""Function of name and type of a tool or work object that no module declares; returns that of the cell, or None."""

_OPTIONS = {"WOBJ", "V", "T", "Z", "CONC", "INPOS", "TLOAD", "NOEOFFS", "T1", "T2", "T3", "T4", "T5", "T6", "T7", "T8"}
_REFUSED_OPTIONS = {
    "ID": "moves together with other robots",
    "CORR": "is corrected by a sensor",
    "TRACK": "is led by a sensor",
    "ADVANCED": "is led by a sensor",
}


_PLAUSIBLE_LIMIT = 1e6
"""Larger speeds [mm/s], durations [s] and zones [mm] are mistakes (assumed)."""


class Setting(Struct, frozen=True):
    """Settings that apply to moves until an instruction changes them.

    :ivar follows_configuration: ConfJ: True if MoveJ goes to the configuration of its target.
    :ivar singularity_mode: SingArea: OFF, WRIST or LOCKAXIS4.
    :ivar circle_mode: CirPathMode: PATHFRAME, OBJECTFRAME or another.
    :ivar speed_share: VelSet: factor of programmed speeds.
    :ivar speed_limit: VelSet: largest speed of the TCP [mm/s].
    """

    follows_configuration: bool = True
    singularity_mode: str = "OFF"
    circle_mode: str = "PATHFRAME"
    speed_share: float = 1.0
    speed_limit: float = 5000.0


class Target(Struct, frozen=True, eq=False):
    """The end of a motion or the point on a circle.

    :ivar numbers: the 17 numbers of a robtarget, or the 12 of a jointtarget.
    :ivar expression: the argument of the move.
    :ivar literal: aggregate that contains the numbers in the text; None if they are calculated.
    :ivar data: declaration whose initial value is `literal`; None if the literal is the argument, or there is none.
    """

    numbers: list[float]
    expression: Expression
    literal: Expression | None = None
    data: Declaration | None = None


class Move(Struct, frozen=True, eq=False):
    """An executed motion.

    :ivar statement: the instruction.
    :ivar kind: `LIN`, `CIRC` or `PTP`.
    :ivar target: the end of the motion.
    :ivar via: the point on a circle; None for other motions.
    :ivar has_joint_target: True if the target is a jointtarget, not a robtarget.
    :ivar speed: speed of the TCP [mm/s]; 0 if a duration is stated.
    :ivar duration: duration of the motion [s]; 0 if a speed is stated.
    :ivar turn_speed: largest rotational speed of the tool (v_ori) [deg/s]; infinite if it is not known.
    :ivar zone: approximation distance [mm]; 0 for a stop.
    :ivar tool: value of the tooldata.
    :ivar tool_name: name of the tooldata as it is spelled in its declaration; empty for a component of other data.
    :ivar wobj: value of the wobjdata.
    :ivar setting: settings that apply to the motion.
    """

    statement: Instruction
    kind: int
    target: Target
    via: Target | None
    has_joint_target: bool
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

    Arguments without a name are, in this order: targets, speed, triggers, zone, tool, further ones such as a signal.

    :param form: numbers of targets, triggers and further arguments of this instruction.
    :param scope: data at this time.
    :param setting: settings that apply to the motion.
    :param frames: function of name and type, which returns the value of a tool or work object of the cell, or None.
    :raises UnknownValueError: a value is not known before the program runs, or an option is not supported.
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
    min_count = form.target_count + 3 + form.count_before_zone  # 3: speed, zone and tool
    if not min_count <= len(expressions) <= min_count + form.most_behind_tool:
        raise UnknownValueError(f"{statement.name} has {len(expressions)} arguments instead of {min_count}")
    *via_points, end_point = (
        _target(expressions[k], scope, takes_joints=form.takes_joints) for k in range(form.target_count)
    )
    speed_index, zone_index = form.target_count, form.target_count + 1 + form.count_before_zone
    speed, duration = _speed_and_duration(expressions[speed_index], options, scope, setting)
    wobj = options["WOBJ"].value if "WOBJ" in options else None
    return Move(
        statement=statement,
        kind=form.kind,
        target=end_point,
        via=via_points[0] if via_points else None,
        has_joint_target=form.takes_joints,
        speed=speed,
        duration=duration,
        turn_speed=_turn_speed(expressions[speed_index], options, scope, setting),
        zone=_zone_radius(expressions[zone_index], options, scope),
        tool=_frame(expressions[zone_index + 1], "TOOLDATA", scope, frames),
        tool_name=_data_name(expressions[zone_index + 1], scope),
        # predefined data are pairs of value and type
        wobj=predefined_data()["WOBJ0"][0] if wobj is None else _frame(wobj, "WOBJDATA", scope, frames),
        setting=setting,
    )


def _target(expression: Expression, scope: Scope, *, takes_joints: bool) -> Target:
    """Return the numbers of a target, and the literal and declaration that contain them.

    :param takes_joints: True if the move needs a jointtarget, False if it needs a robtarget.
    :raises UnknownValueError: the numbers are unknown, or the value has another type.
    """
    if expression.kind == "numbers":
        if takes_joints:
            raise UnknownValueError("MoveAbsJ goes to joint angles, not to a robtarget")
        return Target([float(text) for text in expression.value], expression, expression)
    value, type_ = evaluate(expression, scope)
    if type_ not in ("", "JOINTTARGET" if takes_joints else "ROBTARGET"):
        raise UnknownValueError(f"a {type_.lower()} is no target of {'MoveAbsJ' if takes_joints else 'this move'}")
    numbers = _numbers(value, takes_joints=takes_joints)
    variable = scope.find(base_name(expression))
    if expression.kind == "list":
        return Target(numbers, expression, expression)
    if (
        variable is not None and variable.has_declared_value and variable.declaration is not None
    ):  # still its initial value
        element = _element(expression, variable.declaration.value, scope)
        # only literals of module data can be corrected: local data are declared again in each call
        if element is not None and scope.outer.get(base_name(expression)) is variable:
            return Target(numbers, expression, element, variable.declaration)
    return Target(numbers, expression)


def _speed_and_duration(
    expression: Expression, options: dict[str, Argument], scope: Scope, setting: Setting
) -> tuple[float, float]:
    r"""Return the speed of the TCP [mm/s] and the duration of the move [s].

    With ``\T`` the speed is 0; otherwise the duration is 0, and the speed is that of ``\V`` or of the speeddata. VelSet
    scales and limits it.

    :param expression: the speeddata.
    :raises UnknownValueError: the stated speed or duration is not known, or out of range.
    """
    share, limit = setting.speed_share, setting.speed_limit
    for name in ("T", "V"):
        argument = options.get(name)
        if argument is not None and argument.value is not None:
            stated_number = number(argument.value, scope)
            if not 0.0 < stated_number < _PLAUSIBLE_LIMIT:
                raise UnknownValueError(f"\\{name} must be more than 0")
            return (0.0, stated_number / share) if name == "T" else (min(stated_number * share, limit), 0.0)
    value, _ = evaluate(expression, scope)
    if not isinstance(value, list) or len(value) != len(FIELDS["SPEEDDATA"]):
        raise UnknownValueError("the speed is no speeddata")
    tcp_speed = value[0]
    if isinstance(tcp_speed, bool) or not isinstance(tcp_speed, float) or not 0.0 < tcp_speed < _PLAUSIBLE_LIMIT:
        raise UnknownValueError("the speed of the TCP must be more than 0")
    return min(tcp_speed * share, limit), 0.0


def _turn_speed(expression: Expression, options: dict[str, Argument], scope: Scope, setting: Setting) -> float:
    r"""Return the rotational speed of the tool in a move [deg/s]: v_ori of the speeddata, scaled by VelSet.

    ``\V`` replaces only the speed of the TCP. ``\T`` states the duration of the whole move: the result is infinite. It
    is infinite too if v_ori is not known, or not above zero.

    :param expression: the speeddata.
    """
    if "T" in options:
        return math.inf
    try:
        value, _ = evaluate(expression, scope)
    except UnknownValueError:
        return math.inf
    is_speeddata = isinstance(value, list) and len(value) == len(FIELDS["SPEEDDATA"])
    turn_speed = value[1] if is_speeddata else None  # v_tcp, v_ori, …
    if not isinstance(turn_speed, float) or isinstance(turn_speed, bool) or turn_speed <= 0.0:
        return math.inf
    return turn_speed * setting.speed_share


def _zone_radius(expression: Expression, options: dict[str, Argument], scope: Scope) -> float:
    r"""Return the radius [mm] of the zone of a move; 0 for a stop point.

    ``\Z`` states the radius. ``\Inpos`` makes the end a stop point.

    :param expression: the zonedata.
    :raises UnknownValueError: the zone is unknown, or out of range.
    """
    argument = options.get("Z")
    if argument is not None and argument.value is not None:
        return max(number(argument.value, scope), 0.0)
    if "INPOS" in options:
        return 0.0
    value, _ = evaluate(expression, scope)
    if not isinstance(value, list) or len(value) != len(FIELDS["ZONEDATA"]) or not isinstance(value[0], bool):
        raise UnknownValueError("the zone is no zonedata")
    distance = value[1]  # finep, pzone_tcp, …
    if isinstance(distance, bool) or not isinstance(distance, float) or not 0.0 <= distance < _PLAUSIBLE_LIMIT:
        raise UnknownValueError("the zone is no distance")
    return 0.0 if value[0] else distance


def _frame(expression: Expression, type_: str, scope: Scope, frames: Frames) -> Value:
    """Return the value of a tool or work object; if no module declares it, that of the cell.

    :param type_: TOOLDATA or WOBJDATA.
    :param frames: function of name and type, which returns the value of the cell, or None if the cell has none.
    :raises UnknownValueError: the value is unknown, or has another type.
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
    """Return the name of the data that an expression names, as it is spelled in their declaration.

    A parameter has the name of the data that are its argument. The name is in upper case if no module declares the
    data. Empty for elements, components and other expressions, and for a parameter without such data.
    """
    if expression.kind != "name":
        return ""
    variable = scope.find(expression.value)
    if variable is not None and variable.declaration is not None:
        return variable.declaration.spelling
    is_parameter_or_local = expression.value in scope.inner
    return "" if is_parameter_or_local else str(expression.value)


def _numbers(value: Value, *, takes_joints: bool) -> list[float]:
    """Return the 17 numbers of a robtarget, or the 12 of a jointtarget.

    :param takes_joints: True for a jointtarget.
    :raises UnknownValueError: the value has another form.
    """
    return record_numbers(value, 6, 6) if takes_joints else record_numbers(value, 3, 4, 4, 6)  # sizes of the components


def _element(expression: Expression, initial: Expression | None, scope: Scope) -> Expression | None:
    """Return the aggregate in a declared value that contains the numbers of an expression.

    None without a declared value, for other expressions than data and array elements, and if the numbers are not in an
    aggregate.

    :param expression: data, or an element of an array.
    :param initial: the declared value; None without one.
    :raises UnknownValueError: an index is not known.
    """
    if initial is None or expression.kind not in ("name", "index"):
        return None
    element: Expression = initial
    for item in expression.items[1:]:  # the indices, from 1
        if element.kind != "list":
            return None
        element = element.items[int(number(item, scope)) - 1]
    return element if element.kind in ("numbers", "list") else None


def are_equal(first: Move, second: Move) -> bool:
    """Return whether two motions of one statement have the same points, speed, zone, frames and settings."""
    has_same_target = first.statement is second.statement and first.target.numbers == second.target.numbers
    has_same_via = (first.via.numbers if first.via else None) == (second.via.numbers if second.via else None)
    has_same_data = (first.speed, first.zone, first.tool, first.wobj, first.setting) == (
        second.speed, second.zone, second.tool, second.wobj, second.setting,
    )  # fmt: skip
    return has_same_target and has_same_via and has_same_data
