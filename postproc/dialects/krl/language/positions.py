"""Positions: the numbers of E6POS, POS, FRAME, E6AXIS and AXIS values."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.values import Aggregate, Number
from postproc.errors import ProgramError
from postproc.frames import Array, pose_from_xyzabc, xyzabc_from_pose

CARTESIAN = ("X", "Y", "Z", "A", "B", "C")
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
COLUMNS = (*CARTESIAN, "S", "T")
"""Components whose spans in the text are kept."""
_AXES = frozenset(AXES)
_EXTERNAL = frozenset(EXTERNAL)
_CARTESIAN_COMPONENTS = frozenset({*CARTESIAN, "S", "T", *EXTERNAL})
_AXIS_COMPONENTS = frozenset({*AXES, *EXTERNAL})
_CARTESIAN_TAGS = ("", "E6POS", "E3POS", "POS", "FRAME")
_AXIS_TAGS = ("", "E6AXIS", "E3AXIS", "AXIS")
MAX_STATUS, MAX_TURN = 31, 63
"""S has five bits and T six, one for each joint (KSS, Status and Turn)."""
LARGEST_COORDINATE = 1e6
"""Largest coordinate [mm, deg] that is read: larger numbers are typing errors."""
LARGEST_B = 90.0
"""Controllers show B from −90° to 90°; beyond, a second set of angles describes the same orientation."""
HALF_TURN = 180.0
"""Largest A and C [deg] of a position."""
_NAN = float("nan")


class Position(Struct, frozen=True, eq=False):
    """A target or frame whose numbers are known.

    :param values: X, Y, Z [mm], A, B, C [deg] of a Cartesian position; A1…A6 [deg] of an axis position. NaN where a
        component is missing.
    :param is_axis: True for A1…A6.
    :param status: S; −1 if it is not given.
    :param turn: T; −1 if it is not given.
    :param external: E1…E6, NaN where missing; empty if all are missing.
    :param aggregate: the aggregate that contains these numbers as text; None if they are the result of an operation.
    """

    values: tuple[float, ...]
    is_axis: bool = False
    status: int = -1
    turn: int = -1
    external: tuple[float, ...] = ()
    aggregate: Aggregate | None = None

    @property
    def is_complete(self) -> bool:
        """Whether no component is missing."""
        return not any(math.isnan(value) for value in self.values)

    @property
    def largest_coordinate(self) -> float:
        """Largest absolute value of a coordinate [mm, deg]; 0 if all are missing."""
        return max([abs(value) for value in self.values if value == value], default=0.0)  # without NaN

    def pose(self) -> Array:
        """Return the frame as a (4, 4) pose [m]; a missing component is 0."""
        return pose_from_xyzabc(np.nan_to_num(np.array(self.values)))


class NotANumberError(ProgramError):
    """A component of a position is not known as a number before the program runs.

    :ivar component: name of the component.
    """

    component = ""


def position_from_pose(pose: Array) -> Position:
    """Return the Cartesian position of a (4, 4) pose [m]."""
    return Position(tuple(float(value) for value in xyzabc_from_pose(pose)))


def position_from_aggregate(aggregate: Aggregate) -> Position:
    """Return the position that an aggregate gives, such as ``{X 1,Y 2,Z 3,A 0,B 90,C 0,S 2}`` or ``{A1 0,A2 -90}``.

    :raises NotANumberError: a component is not a number.
    :raises ProgramError: a component is unknown, axes and Cartesian components are mixed, S or T is out of range.
    """
    items = aggregate.items
    # the first of the tags is empty: an aggregate without a type
    is_axis = aggregate.tag in _AXIS_TAGS[1:] or not _AXES.isdisjoint(items)
    components, tags = (_AXIS_COMPONENTS, _AXIS_TAGS) if is_axis else (_CARTESIAN_COMPONENTS, _CARTESIAN_TAGS)
    if aggregate.tag not in tags:
        kind = "an axis position" if is_axis else "a Cartesian position"
        raise aggregate.source.error(
            f"{aggregate.tag} is not the type of {kind}", aggregate.start, advice=f"Valid types: {', '.join(tags[1:])}."
        )
    values = [value.value for value in items.values() if isinstance(value, Number)]
    # the numbers of a computed aggregate are not in its text
    text_aggregate = None if aggregate.is_computed else aggregate
    if len(values) == len(CARTESIAN) and tuple(items) == CARTESIAN and aggregate.tag in _CARTESIAN_TAGS:
        return Position(tuple(values), aggregate=text_aggregate)  # nearly all aggregates
    numbers = {}
    for name, value in items.items():
        if name not in components or not isinstance(value, Number):
            raise _component_error(aggregate, name, components)
        numbers[name] = value.value
    has_external = not _EXTERNAL.isdisjoint(numbers)
    return Position(
        values=tuple([numbers.get(name, _NAN) for name in (AXES if is_axis else CARTESIAN)]),
        is_axis=is_axis,
        status=_status_or_turn(aggregate, "S", numbers.get("S"), MAX_STATUS),
        turn=_status_or_turn(aggregate, "T", numbers.get("T"), MAX_TURN),
        external=tuple([numbers.get(name, _NAN) for name in EXTERNAL]) if has_external else (),
        aggregate=text_aggregate,
    )


def _component_error(aggregate: Aggregate, name: str, components: frozenset[str]) -> ProgramError:
    """Return the error for a component that a position cannot have, or else the `NotANumberError` for the component.

    :param components: components that the position may have.
    """
    if name not in components:
        valid = ", ".join(
            component for component in (*AXES, *CARTESIAN, "S", "T", *EXTERNAL) if component in components
        )
        problem, advice = f"{name} is not a component of a position", f"Valid components: {valid}."
    else:
        problem = f"component {name} is not a number"
        advice = (
            "Targets that are computed while the program runs cannot be corrected; write them as numbers, or leave "
            "such motions as they are by --keep-unresolved."
        )
    error = aggregate.source.error(problem, aggregate.start, advice)
    if name not in components:
        return error
    not_a_number = NotANumberError(
        error.problem, file=error.file, line=error.line, text=error.text, advice=error.advice
    )
    not_a_number.component = name
    return not_a_number


def _status_or_turn(aggregate: Aggregate, name: str, value: float | None, highest: int) -> int:
    """Return S or T of a position; −1 if it is not given.

    :param name: ``S`` or ``T``.
    :param value: its number; None if it is not given.
    :param highest: largest valid number.
    :raises ProgramError: `value` is not an integer from 0 to `highest`.
    """
    if value is None:
        return -1
    if value != int(value) or not 0 <= value <= highest:
        advice = f"{name} is a whole number from 0 to {highest}."
        raise aggregate.source.error(f"{name} {value:g} is out of range", aggregate.start, advice)
    return int(value)
