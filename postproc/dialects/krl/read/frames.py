"""`$BASE` and `$TOOL`: from numbers, names, `BASE_DATA[n]`, components, chains."""

from __future__ import annotations

import re

import numpy as np

from postproc.cell import Cell
from postproc.dialects.krl.language.positions import (
    CARTESIAN,
    HALF_TURN,
    LARGEST_B,
    LARGEST_COORDINATE,
    Position,
    position_from_pose,
)
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.values import Call, Number, Reference, Value
from postproc.dialects.krl.read.explanations import why_unknown
from postproc.dialects.krl.read.known import NO_VALUE, UnknownValue, VariableValue
from postproc.dialects.krl.read.state import FIELD_OF_SETTING, Reasons, State
from postproc.dialects.krl.read.variables import ANGLES, Variables, component, with_component
from postproc.errors import ProgramError
from postproc.frames import Array

_FRAME_TOLERANCE = 1e-13
"""Frames closer than this [m, rad] are equal: they differ by the rounding of their conversion."""
_ELEMENT = re.compile(r"\[(\d+)\]$")
_FRAME_ADVICE = "Write $BASE and $TOOL as numbers, or add [base_data.n], [tool_data.n] or config_dat to the cell."


class Frames:
    """The frames that a program uses.

    :ivar bases: the values of `$BASE`, each (4, 4) in the robot root [m]; row 0 is the base of the cell.
    :ivar tools: the values of `$TOOL`, each (4, 4) in the flange frame [m]; row 0 is the tool of the cell.
    :ivar tool_numbers: row of `tools` → numbers n of the `TOOL_DATA[n]` that the program has put into `$TOOL` with this
        frame.
    :ivar is_initmov_open: True if the cell does not say to what BAS(#INITMOV,0) sets `$BASE` and `$TOOL`.
    :ivar names_read_as_assumed: `$BASE`, `$TOOL` or both, if a statement has read their value after such a call.
    """

    def __init__(self, variables: Variables, cell: Cell, reasons: Reasons) -> None:
        """Begin with the frames of the cell."""
        self.variables, self.reasons = variables, reasons
        self.bases: list[Array] = [cell.base.pose()]
        self.tools: list[Array] = [cell.tool.pose()]
        self.tool_numbers: dict[int, set[int]] = {}
        self.is_initmov_open = cell.krl.initmov is None
        self.names_read_as_assumed: set[str] = set()
        self._rows: dict[tuple[str, tuple[float, ...]], int] = {}  # name and numbers of each frame that was set → row
        self._frames_with_uncertain_angles: set[tuple[str, int]] = set()  # name and row: see `_has_angles_in_range`

    def state_after_assignment(
        self, state: State, place: Place, target: Reference, value: Value | VariableValue
    ) -> State:
        """Return the state after ``$BASE = value`` or ``$TOOL = value``, or after an assignment to a component.

        The frame is unknown afterwards if the value is unknown, incomplete or given by joint angles.

        :param place: file and line of the assignment, for messages.
        :param target: `$BASE`, `$TOOL` or a component of them.
        :param value: the assigned expression, or its value.
        :raises ProgramError: the base is moved while the program runs, or a component exceeds `LARGEST_COORDINATE`.
        """
        name = target.name
        if isinstance(value, Call) and value.name in ("SBASE", "STOOL", "STOOL2"):  # functions of inline forms
            number = self.variables.first_argument(value, "BASE_NO" if value.name == "SBASE" else "TOOL_NO")
            if not isinstance(number, Number):
                text = place.source.text[value.start : value.stop]
                reason = why_unknown(self.variables, place.source, number or NO_VALUE)
                return self.state_with_unknown_frame(state, name, place, f"{text}: the number is not known: {reason}")
            return self.state_with_numbered_frame(state, place, name, int(number.value))
        if isinstance(value, Call) and value.name == "EK":
            raise place.error("external kinematics (EK) move the base", "Only a fixed $BASE can be corrected.")
        if target.indices is not None or (target.field is not None and target.field not in CARTESIAN):
            return self.state_with_unknown_frame(state, name, place, "its component is not understood")
        if isinstance(value, Reference) and value.name in ("BASE_DATA", "TOOL_DATA") and value.field is None:
            return self._state_with_stored_frame(state, place, name, value)
        if target.field is not None:
            position = self._frame_with_component(state, target, value)
        else:
            position = self.variables.position(value)
        if position is None or position.is_axis:
            return self.state_with_unknown_frame(state, name, place, why_unknown(self.variables, place.source, value))
        if not position.is_complete:
            return self.state_with_unknown_frame(state, name, place, _missing_components(position))
        if position.largest_coordinate > LARGEST_COORDINATE:
            raise out_of_reach_error(place, position.largest_coordinate)
        return self._state_with_frame(state, name, position)

    def state_with_numbered_frame(self, state: State, place: Place, name: str, number: int) -> State:
        """Return the state after ``$BASE=BASE_DATA[number]`` or ``$TOOL=TOOL_DATA[number]``.

        The frame is unknown afterwards if the array element is not known or incomplete.

        :param place: file and line of the statement, for messages.
        :param name: ``$BASE`` or ``$TOOL``.
        :raises ProgramError: a component exceeds `LARGEST_COORDINATE`.
        """
        return self._state_with_stored_frame(state, place, name, _array_element(f"{name[1:]}_DATA", number))

    def state_with_unknown_frame(self, state: State, name: str, place: Place, reason: str) -> State:
        """Return a state in which `$BASE` or `$TOOL` (`name`) is not known; the reason is stored for messages.

        :param place: file and line of the statement, for messages.
        """
        return self.reasons.state_with_unknown(
            state, FIELD_OF_SETTING[name], place.error(f"{name} is not known: {reason}", _FRAME_ADVICE)
        )

    def frames_of_cell(self, state: State) -> set[str]:
        """Return which of `$BASE` and `$TOOL` are frames of the cell though KUKA's #INITMOV would set other frames.

        BAS(#INITMOV,0) initialises the motion settings at the start of a program: KUKA's sets BASE(0) and TOOL_DATA[1].
        """
        tool = self.variables.position(_array_element("TOOL_DATA", 1))
        kuka_frames = {"$BASE": Position((0.0,) * 6), "$TOOL": tool}
        return {name for name in state.initial_frames if not self._is_cell_frame(name, kuka_frames[name])}

    def _is_cell_frame(self, name: str, position: Position | None) -> bool:
        """Return whether a position equals `$BASE` or `$TOOL` of the cell."""
        frame = self.bases[0] if name == "$BASE" else self.tools[0]
        return position is not None and bool(np.abs(position.pose() - frame).max() < _FRAME_TOLERANCE)

    def current_value(self, state: State, name: str, field: str | None) -> VariableValue:
        """Return the value of `$BASE` or `$TOOL` in a state, or one of its components.

        The name is added to `names_read_as_assumed` if the value may be another one on the controller.

        :param field: X … C; None: the whole frame. `NO_VALUE` is returned for other fields.
        :returns: an `UnknownValue` if the frame is not known, or the component is an angle that may be another one.
        """
        row, frames = (state.base, self.bases) if name == "$BASE" else (state.tool, self.tools)
        if row < 0:  # an unknown frame holds the index of its reason, see `State.base`
            return UnknownValue(reason=self.reasons.errors[-1 - row].problem)
        if self.is_initmov_open and name in self.frames_of_cell(state):
            self.names_read_as_assumed.add(name)
        position = position_from_pose(frames[row])
        if field is None:
            return position
        if field in ANGLES and (name, row) in self._frames_with_uncertain_angles:
            return UnknownValue(reason=f"whether {field} is kept as it was given is in no source")
        return component(position, field) if field in CARTESIAN else NO_VALUE

    def _frame_with_component(self, state: State, target: Reference, value: Value | VariableValue) -> Position | None:
        """Return the frame in force with another value of one component; None if the result is not known.

        :param target: the component of `$BASE` or `$TOOL` that is assigned to.
        :param value: the assigned expression, or its value.
        """
        name, field = target.name, target.field or ""
        row = state.base if name == "$BASE" else state.tool
        frame, number = self.current_value(state, name, None), self.variables.number(value)
        if not isinstance(frame, Position) or number is None:
            return None
        if field in ANGLES and (name, row) in self._frames_with_uncertain_angles:
            # the controller may store another set of A, B, C for the orientation that was given: the two angles that
            # stay are not known
            return None
        return with_component(frame, field, number)

    def _state_with_stored_frame(self, state: State, place: Place, name: str, reference: Reference) -> State:
        """Return the state after `$BASE` or `$TOOL` is set to an element of `BASE_DATA` or `TOOL_DATA`.

        The frame is unknown afterwards if the element is not known or incomplete.

        :param place: file and line of the statement, for messages.
        :param name: `$BASE` or `$TOOL`.
        :param reference: the element.
        :raises ProgramError: a component exceeds `LARGEST_COORDINATE`.
        """
        key = self.variables.key_of(reference) or reference.name  # the latter: the index is not known
        position = self.variables.position(reference)
        if position is not None and position.largest_coordinate > LARGEST_COORDINATE:
            raise out_of_reach_error(place, position.largest_coordinate)
        if position is None:
            value = self.variables.evaluate(reference)
            reason = f"{key} is neither in the cell nor in the $config.dat"
            if isinstance(value, UnknownValue) and value != NO_VALUE:
                reason = value.message_for(key)
            return self.state_with_unknown_frame(state, name, place, reason)
        if not position.is_complete:
            return self.state_with_unknown_frame(state, name, place, f"{_missing_components(position)} in {key}")
        state = self._state_with_frame(state, name, position)
        if name == "$TOOL" and (number := _ELEMENT.search(key)):  # ``TOOL_DATA[n]``
            self.tool_numbers.setdefault(state.tool, set()).add(int(number[1]))
        return state

    def _state_with_frame(self, state: State, name: str, position: Position) -> State:
        """Return the state with `$BASE` or `$TOOL` (`name`) at a complete Cartesian position.

        Equal frames share a row of `bases` or `tools`, so that motions can be grouped by the row.
        """
        if (name, position.values) not in self._rows:
            frames, pose = (self.bases if name == "$BASE" else self.tools), position.pose()
            equal_rows = [row for row, frame in enumerate(frames) if np.abs(frame - pose).max() < _FRAME_TOLERANCE]
            if not equal_rows:  # a new frame
                frames.append(pose)
            self._rows[name, position.values] = equal_rows[0] if equal_rows else len(frames) - 1
        row = self._rows[name, position.values]
        if not _has_angles_in_range(position):
            self._frames_with_uncertain_angles.add((name, row))
        return state.with_values(**{FIELD_OF_SETTING[name]: row})


def _has_angles_in_range(position: Position) -> bool:
    """Return whether A, B, C of a frame are in the ranges in which controllers show angles: ±180°, ±90°, ±180°.

    Other angles may be kept as given, or replaced by the set in these ranges.
    """
    a, b, c = position.values[3:]
    return abs(a) <= HALF_TURN and abs(b) <= LARGEST_B and abs(c) <= HALF_TURN


def _array_element(name: str, number: int) -> Reference:
    """Return a reference to the element of an array with a number; it is in no text."""
    index = Number(float(number), start=0, stop=0, is_integer=True)
    return Reference(name, (index,), field=None, start=0, stop=0)


def _missing_components(position: Position) -> str:
    """Return which components of an incomplete frame are missing, as text for a message: ``A is not given``."""
    names = [name for name, value in zip(CARTESIAN, position.values, strict=True) if np.isnan(value)]
    return f"{', '.join(names)} {'is' if len(names) == 1 else 'are'} not given"


def out_of_reach_error(place: Place, number: float) -> ProgramError:
    """Return the error that a statement contains a coordinate beyond `LARGEST_COORDINATE`, as by a typing error.

    :param place: file and line of the statement.
    :param number: the coordinate [mm or deg].
    """
    return place.error(f"{number:g} is out of any robot's reach", "Coordinates are in mm and degrees.")
