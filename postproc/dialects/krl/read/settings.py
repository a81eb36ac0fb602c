"""Settings in force, followed from statement to statement."""

from __future__ import annotations

import math
from collections.abc import Iterable

from postproc.cell import Cell
from postproc.dialects.krl.language.positions import CARTESIAN
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.values import Call, Number, Reference, Value, Word
from postproc.dialects.krl.read.bas import Bas
from postproc.dialects.krl.read.frames import Frames
from postproc.dialects.krl.read.known import NO_VALUE, UnknownValue, VariableValue
from postproc.dialects.krl.read.path_settings import MODES, PathSettings
from postproc.dialects.krl.read.plain_settings import PlainAssignments, no_settings
from postproc.dialects.krl.read.state import FIELD_OF_SETTING, TURN_SPEEDS, Reasons, State
from postproc.dialects.krl.read.variables import ZERO, Variables, component
from postproc.errors import ProgramError
from postproc.frames import M_PER_MM


class Settings:
    """The settings of motions while a program is followed; `variables` reads their present values here.

    :ivar state: the present state.
    :ivar changes: each row of the trace (or line of the program, if they are the same) after which the state changes,
        and the state then in force, in order.
    :ivar plain_assignments: assignments of numbers to speeds and distances, read in bulk; they come into force before
        the next statement is followed.
    :ivar follows_numbers: True if plain assignments are followed; if False, speeds and distances have no values.
    :ivar lacked_numbers: True if the value of a speed or a distance was read although they are not followed.
    :ivar frames: the frames that the program uses.
    """

    def __init__(self, variables: Variables, cell: Cell) -> None:
        """Begin with the settings of the cell, and let the variables read settings here."""
        self.variables, self.cell = variables, cell
        variables.setting_value = self.current_value
        self.state = State()
        self.changes: list[tuple[int, State]] = [(0, self.state)]
        self.plain_assignments = PlainAssignments(no_settings())
        self.follows_numbers, self.lacked_numbers = True, False
        self._reasons = Reasons()  # one list for all parts, since states hold indices of reasons
        self.frames = Frames(variables, cell, self._reasons)
        self._path = PathSettings(variables, self._reasons, has_carriage=cell.carriage is not None)
        self._bas = Bas(variables, cell, self.frames, self._path)

    def current_value(self, name: str, field: str | None) -> VariableValue:
        """Return the present value of a setting of motions, such as `$BASE`, or of a component of it.

        :param field: the component, such as CP of `$VEL`; None: the whole.
        :returns: an `UnknownValue` if it is not known; `NO_VALUE` for settings and components that are not followed.
        """
        state = self.state
        if state.spline_block:
            return UnknownValue(reason="which value it has inside of a spline block is in no source")
        if name in ("$BASE", "$TOOL"):
            return self.frames.current_value(state, name, field)
        for uncertain_field, index in state.uncertain_fields:
            if uncertain_field == FIELD_OF_SETTING.get(name):
                return UnknownValue(reason=self._reasons.errors[index].problem)
        if name in ("$WORLD", "$ROBROOT"):
            if field is None:
                return ZERO
            return component(ZERO, field) if field in CARTESIAN else NO_VALUE
        if (name, field) == ("$VEL", "CP") and not state.is_speed_assumed:
            return self._followed_number(state.speed)
        if (name, field) == ("$APO", "CDIS"):
            return self._followed_number(state.cdis / M_PER_MM)
        if field is None and name in MODES:
            return Word("#BASE" if name == "$IPO_MODE" else str(getattr(state, FIELD_OF_SETTING[name])), 0, 0)
        return NO_VALUE

    def _followed_number(self, value: float) -> VariableValue:
        """Return the value of a speed or a distance as a number of KRL.

        :returns: `NO_VALUE` if plain assignments are not followed, since one of them may have set another value; this
            is noted in `lacked_numbers`.
        """
        self.lacked_numbers |= not self.follows_numbers
        return Number(value, 0, 0) if self.follows_numbers else NO_VALUE

    def change_state(self, line: int, state: State) -> None:
        """Put a state into force after a line of the program, or row of the trace."""
        if state != self.state:
            self.state = state
            self.changes.append((line, state))

    def apply_assignments_before(self, line: int) -> None:
        """Put into force the plain assignments before a line of the program, or row of the trace."""
        for setting_line, field, value in self.plain_assignments.values_before(line):
            fields = {field: value, "is_speed_assumed": False} if field == "speed" else {field: value}
            self.change_state(setting_line, self.state.with_values(**fields))

    def may_become(self, line: int, state: State, reason: ProgramError) -> None:
        """Mark as unknown the fields that differ between the present state and a state that may come into force.

        :param line: line of the program, or row of the trace, after which it may come into force.
        :param state: that state; the fields that are unknown in it become unknown too.
        :param reason: the error for motions that depend on these fields.
        """
        fields = self.state.differing_fields(state) | {field for field, _ in state.uncertain_fields}
        self.make_uncertain(line, sorted(fields), reason)

    def make_uncertain(self, line: int, fields: Iterable[str], reason: ProgramError) -> None:
        """Mark fields of the state as unknown from a line of the program, or row of the trace, on.

        :param reason: the error for motions that depend on these fields.
        """
        state = self.state
        for field in fields:
            state = self._reasons.state_with_unknown(state, field, reason)
        self.change_state(line, state)

    def forget_turn_speeds(self, line: int) -> None:
        """Treat the turn speeds `$VEL.ORI1` and `$VEL.ORI2` as not stated (infinite) from a row of the trace on."""
        self.change_state(line, self.state.with_values(**dict.fromkeys(TURN_SPEEDS, math.inf)))

    def refuse_uncertain(self, state: State, fields: Iterable[str]) -> None:
        """Refuse a motion that depends on fields of its state whose values are not known.

        :raises ProgramError: the stored reason for the first such field.
        """
        self._reasons.refuse_unknown(state, fields)

    def state_after_assignment(
        self, state: State, place: Place, target: Reference, value: Value | VariableValue
    ) -> State:
        """Return the state after ``target = value``, for a setting of motions such as `$BASE`.

        The variables in the value are noted as used.

        :param state: the state before.
        :raises ProgramError: the effect of the value is not modelled, or the setting is one that programs must not
            change.
        """
        name = target.name
        self.variables.note_dependence(value)
        if name in ("$BASE", "$TOOL"):
            return self.frames.state_after_assignment(state, place, target, value)
        if name == "$VEL":
            return self._path.state_with_speed(state, place, target.field, value)
        if name == "$APO":
            return self._path.state_with_distance(state, place, target.field, value)
        if name == "$CIRC_MODE":
            return self._path.state_with_auxiliary(state, place, target.field, value)
        if name in MODES:
            return self._path.state_with_mode(state, place, name, value)
        raise place.error(f"{name} is changed by the program", "Leave it as the controller has it.")

    def state_after_bas(self, place: Place, call: Call) -> State:
        """Return the state after ``BAS(#COMMAND, value)``; `place` is the statement with the call.

        :raises ProgramError: the command is not understood.
        """
        return self._bas.state_after_call(self.state, place, call)

    def assumed_frames(self, state: State) -> set[str]:
        """Return which of `$BASE` and `$TOOL` are taken from the cell because `[krl] initmov` is not given."""
        return set() if self.cell.krl.initmov is not None else self.frames.frames_of_cell(state)
