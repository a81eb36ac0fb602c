"""How the path is driven: `$VEL`, `$APO`, and the modes of orientation and interpolation."""

from __future__ import annotations

import math

from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.values import Aggregate, Call, Value, Word
from postproc.dialects.krl.layout import ORIENTATIONS
from postproc.dialects.krl.read.explanations import why_unknown
from postproc.dialects.krl.read.known import NO_VALUE, VariableValue
from postproc.dialects.krl.read.state import FIELD_OF_SETTING, TURN_SPEEDS, Reasons, State
from postproc.dialects.krl.read.variables import Variables
from postproc.errors import ProgramError
from postproc.frames import M_PER_MM, RAD_PER_DEG

FASTEST = 100.0
"""A speed above this [m/s] is a slip of the unit."""
_FILE_ADVICE = "have the .dat that declares it next to the program, in [krl] search or as config_dat of the cell"
_RUN_TIME_ADVICE = f"Write it as a number, or {_FILE_ADVICE}."
MODES = {
    "$ORI_TYPE": ORIENTATIONS,
    "$CIRC_TYPE": ("#BASE", "#PATH"),
    "$SPL_ORI_JOINT_AUTO": ("#OFF", "#ON"),
    "$IPO_MODE": ("#BASE", "#TCP"),
}
"""Modes and their values (KUKA, System Variables).

The first value is taken if a mode is assigned from a structure that lacks it."""
_AUXILIARY_MODES = ("#CONSIDER", "#IGNORE", "#INTERPOLATE")
"""Values of `$CIRC_MODE.AUX_PT.ORI` and `.E1`; the first is taken as for `MODES`."""
_MODE_FUNCTIONS = {
    "SIPO_MODE": "IPO_FRAME",
    "SORI_TYP": "ORI_TYP",
    "SORI_TYPE": "ORI_TYP",
    "SCIRC_TYP": "CIRC_TYP",
    "SCIRC_TYPE": "CIRC_TYP",
}
"""Functions that inline forms use to set modes → the component of their argument that they return."""
_PTP_FUNCTIONS = frozenset({"SAPO_PTP"})
"""Functions that give `$APO` no distance for paths."""


def turn_speed(number: float | None) -> float:
    """Return a turn speed [rad/s] given in [deg/s]; infinite if the number is None (not known) or not above 0."""
    return number * RAD_PER_DEG if number is not None and number > 0.0 else math.inf


class PathSettings:
    """Follows assignments to `$VEL`, `$APO`, `$CIRC_MODE` and the `MODES`."""

    def __init__(self, variables: Variables, reasons: Reasons, *, has_carriage: bool) -> None:
        """Keep the variables, and whether E1 carries the robot."""
        self.variables, self.reasons, self.has_carriage = variables, reasons, has_carriage

    def state_with_speed(self, state: State, place: Place, field: str | None, value: Value | VariableValue) -> State:
        """Return the state after ``$VEL.CP = value``; inline forms write ``$VEL = SVEL_CP(value, …)``.

        A speed that is not known makes the field unknown. A turn speed that is not known is infinite.

        :param field: the component that is assigned; None for ``$VEL = {…}``. Other components than CP, ORI1 and ORI2
            leave the state unchanged.
        :raises ProgramError: the speed of the path is not above 0, or beyond `FASTEST`.
        """
        for component_name, name in zip(("ORI1", "ORI2"), TURN_SPEEDS, strict=True):
            component = self._assigned_component(field, component_name, value)
            if component is not None:
                state = state.with_values(**{name: turn_speed(self.variables.number(component))})
        if isinstance(value, Call) and value.name == "SVEL_CP" and value.arguments:
            value = value.arguments[0]  # the speed
        component = self._assigned_component(field, "CP", value)
        if component is None:
            return state
        number = self.variables.number(component)
        if number is None:
            return self._unknown_state(
                state, "speed", place, "the speed $VEL.CP is not known before the program runs", component
            )
        if not 0.0 < number <= FASTEST:
            raise place.error(f"the speed $VEL.CP is {number:g} m/s", f"Give a speed above 0, up to {FASTEST:g} m/s.")
        return state.with_values(speed=number, is_speed_assumed=False)

    def state_with_distance(self, state: State, place: Place, field: str | None, value: Value | VariableValue) -> State:
        """Return the state after ``$APO.CDIS = value``; a distance that is not known makes the field unknown.

        :param field: the component that is assigned; None for ``$APO = {…}``. Other components than CDIS leave the
            state unchanged.
        """
        if isinstance(value, Call) and value.name in _PTP_FUNCTIONS:  # inline forms of PTP set no distance
            return state
        if isinstance(value, Call) and value.name == "SAPO" and field in (None, "CDIS"):  # inline forms of LIN, CIRC
            argument = self.variables.first_argument(value, "APO_DIST")
            if argument is None:
                return state
            field, value = "CDIS", argument
        component = self._assigned_component(field, "CDIS", value)
        if component is None:
            return state
        number = self.variables.number(component)
        if number is None or number < 0.0:
            return self._unknown_state(
                state, "cdis", place, "the approximation distance $APO.CDIS is not known", component
            )
        return state.with_values(cdis=number * M_PER_MM)

    def state_with_mode(self, state: State, place: Place, name: str, value: Value | VariableValue) -> State:
        """Return the state after an assignment to one of the `MODES`, such as ``$ORI_TYPE = value``.

        A value that is not known makes the mode unknown, except for `$IPO_MODE`.

        :param place: source and line of the assignment, for messages.
        :param name: name of the variable.
        :raises ProgramError: `$IPO_MODE` is not known, or is that of a robot that moves the workpiece.
        """
        argument: Value | VariableValue | None = value
        if isinstance(value, Call) and value.name in _MODE_FUNCTIONS:  # functions of inline forms return their argument
            argument = self.variables.first_argument(value, _MODE_FUNCTIONS[value.name])
        word = self._mode_word(place, name, argument, MODES[name])
        if isinstance(word, ProgramError):
            if name == "$IPO_MODE":
                raise word
            return self.reasons.state_with_unknown(state, FIELD_OF_SETTING[name], word)
        if name == "$IPO_MODE":
            if word != "#BASE":
                problem = f"$IPO_MODE {word}: the workpiece is moved by the robot"
                raise place.error(problem, "Only $IPO_MODE=#BASE (the robot moves the tool) can be corrected.")
            return state
        return state.with_values(**{FIELD_OF_SETTING[name]: word})

    def state_with_auxiliary(
        self, state: State, place: Place, field: str | None, value: Value | VariableValue
    ) -> State:
        """Return the state after ``$CIRC_MODE = value``: how SCIRC uses the orientation of auxiliary points.

        A value that is not known makes the mode unknown. How SCIRC uses the orientation of end points (TARGET_PT)
        matters for circles with CA only, see `motions`.

        :param field: path of the component that is assigned, such as ``AUX_PT.ORI``; None: the whole structure.
        :raises ProgramError: E1, which carries the robot, is led through the auxiliary point.
        """
        argument: Value | VariableValue | None = value
        if isinstance(value, Call) and value.name == "SCIRC_M":  # inline forms
            argument = self.variables.first_argument(value, "CB")
        word = self._mode_word(
            place, "$CIRC_MODE.AUX_PT.E1", self._auxiliary_component(field, argument, "E1"), _AUXILIARY_MODES
        )
        if self.has_carriage and word == "#INTERPOLATE":
            problem = (
                "$CIRC_MODE.AUX_PT.E1 #INTERPOLATE: E1, which carries the robot, is led through the auxiliary point"
            )
            raise place.error(problem, "Only circles on which E1 goes from start to end are understood: use #CONSIDER.")
        if field not in (None, "AUX_PT", "AUX_PT.ORI"):  # the orientation of auxiliary points is not assigned
            return state
        word = self._mode_word(
            place, "$CIRC_MODE.AUX_PT.ORI", self._auxiliary_component(field, argument, "ORI"), _AUXILIARY_MODES
        )
        if isinstance(word, ProgramError):
            return self.reasons.state_with_unknown(state, "auxiliary", word)
        return state.with_values(auxiliary=word)

    def _auxiliary_component(
        self, field: str | None, value: Value | VariableValue | None, component: str
    ) -> Value | VariableValue | None:
        """Return the value that an assignment to `$CIRC_MODE`, or to a component of it, gives a component of AUX_PT.

        :param field: path of the component that is assigned; None: the whole structure.
        :param value: the assigned value.
        :param component: ORI or E1.
        :returns: None if another component is assigned, or the value lacks this one. A value that is not known to be a
            structure is returned itself.
        """
        path = [] if field is None else field.split(".")
        names = ["AUX_PT", component]
        if path != names[: len(path)]:
            return None
        for name in names[len(path) :]:  # from the assigned component down to the one that is returned
            result = NO_VALUE if value is None else self.variables.evaluate(value)
            if value is None or not isinstance(result, Aggregate):
                return value
            value = result.items.get(name)
        return value

    def _mode_word(
        self, place: Place, name: str, value: Value | VariableValue | None, words: tuple[str, ...]
    ) -> str | ProgramError:
        """Return the word of a mode, or the error that the mode is not known.

        :param name: name of the mode, for the message.
        :param value: the assigned value; None if the structure that gives it lacks it.
        :param words: allowed words; the first is returned for None.
        """
        result = None if value is None else self.variables.evaluate(value)
        word = words[0] if result is None else result.text if isinstance(result, Word) else ""  # empty: not known
        if word in words:
            return word
        reason = f"there is no {word}" if word else why_unknown(self.variables, place.source, value or NO_VALUE)
        advice = f"Write its value, one of {', '.join(words)}{'.' if word else f', or {_FILE_ADVICE}.'}"
        return place.error(f"{name} is not known: {reason}", advice)

    def _assigned_component(
        self, field: str | None, component: str, value: Value | VariableValue
    ) -> Value | VariableValue | None:
        """Return the value that an assignment to a structure, or to one of its components, gives a component.

        :param field: the component that is assigned; None: the whole structure.
        :param component: the component whose value is returned.
        :returns: None if another component is assigned, or the structure lacks this one. A value that is not known
            to be a structure is returned itself.
        """
        if field is not None:
            return value if field == component else None
        result = self.variables.evaluate(value)
        return result.items.get(component) if isinstance(result, Aggregate) else value

    def _unknown_state(
        self, state: State, field: str, place: Place, problem: str, value: Value | VariableValue
    ) -> State:
        """Return a state in which a field is not known, because the value assigned to it is not.

        :param problem: what is not known, for the message.
        """
        reason = why_unknown(self.variables, place.source, value)
        return self.reasons.state_with_unknown(state, field, place.error(f"{problem}: {reason}", _RUN_TIME_ADVICE))
