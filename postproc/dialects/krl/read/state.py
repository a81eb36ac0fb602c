"""Settings in force at a motion: `$BASE`, `$TOOL`, speed, approximation; and why some of it may not be known.

Sources: KUKA's `BAS.SRC` (what #INITMOV, #CP_PARAMS, #FRAMES … set) and the system variables' descriptions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import compact
from postproc.errors import ProgramError
from postproc.frames import M_PER_MM
from postproc.program import CIRC, PTP, Bools, Ints

DEFAULT_SPEED = 2.0
"""DEF_VEL_CP [m/s]: what `BAS(#INITMOV,0)` gives `$VEL.CP`."""
DEFAULT_CDIS = 3.0
"""What `BAS(#INITMOV,0)` gives `$APO.CDIS` [mm]."""

FIELD_OF_SETTING = {
    "$BASE": "base",
    "$TOOL": "tool",
    "$VEL": "speed",
    "$APO": "cdis",
    "$ORI_TYPE": "orientation",
    "$CIRC_TYPE": "circle",
    "$CIRC_MODE": "auxiliary",
    "$SPL_ORI_JOINT_AUTO": "wrist_mode",
}
"""System variable → field of the `State` that it sets. The other `MOTION_SETTINGS` must not change at all."""
TURN_SPEEDS = ("swivel_speed", "rotation_speed")
"""Fields for the turn speeds `$VEL.ORI1` and `$VEL.ORI2`, the largest speeds at which the tool turns. One that is not
known is infinite: the time that motions take depends on it, and with it the force, but not the path, so that no motion
is refused for it."""
MOTION_SETTINGS = frozenset({*FIELD_OF_SETTING, "$IPO_MODE", "$ROBROOT", "$WORLD", "$EX_AX_IGNORE"})
"""System variables that the path of a motion depends on."""
STORED_VARIABLES = frozenset({"$H_POS", "$FLAG"})
"""Other system variables that keep what a program writes until a program writes them again."""


class State(Struct, frozen=True):
    """Settings in force between two statements.

    :ivar base: row of `Frames.bases`; −1−k when it is not known, for the reason `Reasons.errors[k]`.
    :ivar tool: row of `Frames.tools`; −1−k when it is not known, for the reason `Reasons.errors[k]`.
    :ivar speed: `$VEL.CP` [m/s].
    :ivar swivel_speed: `$VEL.ORI1`, largest speed of the tool direction [rad/s]; infinite where it is not stated.
    :ivar rotation_speed: `$VEL.ORI2`, largest speed about the tool direction [rad/s]; infinite where it is not stated.
    :ivar is_speed_assumed: True while `$VEL.CP` is the controller's default.
    :ivar cdis: `$APO.CDIS` [m].
    :ivar orientation: `$ORI_TYPE`.
    :ivar circle: `$CIRC_TYPE`.
    :ivar auxiliary: `$CIRC_MODE.AUX_PT.ORI`.
    :ivar wrist_mode: `$SPL_ORI_JOINT_AUTO`.
    :ivar initial_frames: which of `$BASE` and `$TOOL` BAS(#INITMOV,0) has set.
    :ivar spline_block: the spline block, ``SPLINE`` or ``PTP_SPLINE``; empty outside of one.
    :ivar uncertain_fields: fields that are not known, each with the index of its reason in `Reasons.errors`; `base` and
        `tool` are never among them.
    """

    base: int = 0
    tool: int = 0
    speed: float = DEFAULT_SPEED
    swivel_speed: float = math.inf
    rotation_speed: float = math.inf
    is_speed_assumed: bool = True
    cdis: float = DEFAULT_CDIS * M_PER_MM
    orientation: str = "#VAR"
    circle: str = "#BASE"
    auxiliary: str = "#CONSIDER"
    wrist_mode: str = "#OFF"
    initial_frames: frozenset[str] = frozenset()
    spline_block: str = ""
    uncertain_fields: tuple[tuple[str, int], ...] = ()

    def with_values(self, **fields: object) -> State:
        """Return the state with new values of some fields; these fields are then known.

        :param fields: field name → value. A frame given here no longer counts as set by BAS(#INITMOV,0).
        """
        initial_frames = self.initial_frames - {f"${name.upper()}" for name in fields}  # base → $BASE
        uncertain_fields = tuple((field, index) for field, index in self.uncertain_fields if field not in fields)
        return replace(self, initial_frames=initial_frames, uncertain_fields=uncertain_fields, **fields)

    def differing_fields(self, other_state: State) -> set[str]:
        """Return the names of the fields that a variable sets and that have different values in two states.

        `is_speed_assumed`, `initial_frames`, `spline_block` and `uncertain_fields` are not compared.
        """
        fields = (*FIELD_OF_SETTING.values(), *TURN_SPEEDS)
        return {field for field in fields if getattr(self, field) != getattr(other_state, field)}

    def without_turn_speeds(self) -> State:
        """Return the state with infinite `TURN_SPEEDS`, so that a comparison of two states disregards them."""
        return replace(self, swivel_speed=math.inf, rotation_speed=math.inf)


class MotionStates(Struct, frozen=True, eq=False):
    """Settings in force at M motions.

    :param states: all states that are in force anywhere.
    :param index: (M,) index in `states` of the state of each motion.
    """

    states: list[State]
    index: Ints

    def at(self, row: int) -> State:
        """Return the state of the motion in a row, from 0."""
        return self.states[int(self.index[row])]

    def take(self, rows: Ints | Bools) -> MotionStates:
        """Return the settings of some motions, given by their rows or by a mask (M,)."""
        return MotionStates(self.states, self.index[rows])

    def column(self, property_of: Callable[[State], object]) -> np.ndarray[Any, Any]:
        """Return one property of the states of all motions (M,). The result may be read-only.

        :param property_of: returns the property of a state.
        """
        values = np.array([property_of(state) for state in self.states])
        if len(values) and (values == values[0]).all():
            return np.broadcast_to(values[0], (len(self.index),))  # takes no memory
        # 4 bytes or less for each integer of a long program
        return (compact(values, np.int32) if values.dtype == np.int64 else values)[self.index]


class Reasons:
    """Why something in force is not known.

    :ivar errors: the errors for motions that depend on unknown settings; states hold their indices.
    """

    def __init__(self) -> None:
        """Begin without reasons."""
        self.errors: list[ProgramError] = []

    def state_with_unknown(self, state: State, field: str, reason: ProgramError) -> State:
        """Return a state in which a field is not known, and add the reason to `errors`.

        Frames: the row becomes negative, see `State.base`. Turn speeds: they become infinite, and the reason is not
        stored. Other fields: the field keeps its value and is added to `State.uncertain_fields`.
        """
        if field in TURN_SPEEDS:
            return state.with_values(**{field: math.inf})
        self.errors.append(reason)
        if field in ("base", "tool"):
            return state.with_values(**{field: -len(self.errors)})  # −1−k for the reason `errors[k]`
        # drops an earlier reason for the field from `uncertain_fields`
        new_state = state.with_values(**{field: getattr(state, field)})
        return replace(new_state, uncertain_fields=(*new_state.uncertain_fields, (field, len(self.errors) - 1)))

    def refuse_unknown(self, state: State, fields: Iterable[str]) -> None:
        """Refuse a motion that depends on fields of its state whose values are not known.

        :raises ProgramError: the stored reason for the first such field.
        """
        for field in fields:
            frame_row = getattr(state, field) if field in ("base", "tool") else 0
            if frame_row < 0:  # an unknown frame holds the index of its reason, see `State.base`
                raise self.errors[-1 - frame_row]
            for uncertain_field, index in state.uncertain_fields:
                if uncertain_field == field:
                    raise self.errors[index]


def fields_of(variable: str) -> list[str]:
    """Return the fields of the `State` that a variable sets."""
    return [FIELD_OF_SETTING[variable], *(TURN_SPEEDS if variable == "$VEL" else ())]


def fields_used(kind: int, *, has_axis_target: bool, is_approximated: bool) -> list[str]:
    """Return the fields of its `State` on which a motion depends.

    :param kind: PTP, LIN, CIRC or SPL.
    :param has_axis_target: True if the target is given by joint angles: it needs no frames.
    :param is_approximated: True if `$APO.CDIS` applies.
    """
    fields = [] if has_axis_target else ["base", "tool"]
    if kind != PTP:
        fields += ["speed", "orientation", *(["circle"] if kind == CIRC else [])]
    return [*fields, "cdis"] if is_approximated else fields
