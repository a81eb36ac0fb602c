"""How the path is driven: `$VEL`, `$APO`, `$ORI_TYPE`, `$CIRC_TYPE`, `$IPO_MODE`."""

from __future__ import annotations

from postproc.dialects.krl.language.expressions import parse
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.values import Aggregate, Call, Value, Word
from postproc.dialects.krl.layout import ORIENTATIONS
from postproc.dialects.krl.read.explanations import why_unknown
from postproc.dialects.krl.read.known import NOTHING, Known
from postproc.dialects.krl.read.state import FIELDS, Reasons, State
from postproc.dialects.krl.read.variables import Variables
from postproc.frames import M_PER_MM

FASTEST = 100.0
"""A speed above this [m/s] is a slip of the unit."""
_IN_A_FILE = "have the .dat that declares it beside the program, in [krl] search or as config_dat of the cell"
_RUN_TIME = f"Write it as a number, or {_IN_A_FILE}."
_MODES = {
    "$ORI_TYPE": ORIENTATIONS,
    "$CIRC_TYPE": ("#BASE", "#PATH"),
    "$IPO_MODE": ("#BASE", "#TCP"),
}
"""Modes and their values (KUKA, System Variables); the first where a structure that gives them has none."""
_MODE_OF = {
    "SIPO_MODE": "IPO_FRAME",
    "SORI_TYP": "ORI_TYP",
    "SORI_TYPE": "ORI_TYP",
    "SCIRC_TYP": "CIRC_TYP",
    "SCIRC_TYPE": "CIRC_TYP",
}
"""These functions, which inline forms use, and which component of their argument they return."""
_OF_PTP = frozenset({"SAPO_PTP"})
"""Functions that give `$APO` no distance for paths."""


class PathSettings:
    """Follows what is assigned to these variables."""

    def __init__(self, variables: Variables, reasons: Reasons) -> None:
        self.variables, self.reasons = variables, reasons

    def speed(self, state: State, at: Place, field: str | None, value: Value | Known) -> State:
        """Return the state behind ``$VEL.CP = value``, or ``$VEL = {…}`` without a field; other fields do not matter.

        :raises ProgramError: no path can be driven at that speed.
        """
        if isinstance(value, Call) and value.name == "SVEL_CP" and value.arguments:
            value = parse(at.source, *value.arguments[0])[0]
        wanted = self._component(at, field, "CP", value)
        if wanted is None:
            return state
        number = self.variables.number(at.source, wanted)
        if number is None:
            return self._unknown(state, "speed", at, "the speed $VEL.CP is not known before the program runs", wanted)
        if not 0.0 < number <= FASTEST:
            raise at.error(f"the speed $VEL.CP is {number:g} m/s", f"Give a speed above 0, up to {FASTEST:g} m/s.")
        return state.with_known(speed=number, assumed=False)

    def distance(self, state: State, at: Place, field: str | None, value: Value | Known) -> State:
        """Return the state behind ``$APO.CDIS = value``, or ``$APO = {…}`` without a field; likewise."""
        if isinstance(value, Call) and value.name in _OF_PTP:
            return state
        if isinstance(value, Call) and value.name == "SAPO" and field in (None, "CDIS"):
            given = self.variables.argument(at, value, "APO_DIST")
            if given is None:
                return state
            field, value = "CDIS", given
        wanted = self._component(at, field, "CDIS", value)
        if wanted is None:
            return state
        number = self.variables.number(at.source, wanted)
        if number is None or number < 0.0:
            return self._unknown(state, "cdis", at, "the approximation distance $APO.CDIS is not known", wanted)
        return state.with_known(cdis=number * M_PER_MM)

    def mode(self, state: State, at: Place, name: str, value: Value | Known) -> State:
        """Return the state behind ``$ORI_TYPE = value``, and so on.

        :raises ProgramError: the robot moves the workpiece then.
        """
        given: Value | Known | None = value
        if isinstance(value, Call) and value.name in _MODE_OF:
            given = self.variables.argument(at, value, _MODE_OF[value.name])
        known = None if given is None else self.variables.evaluate(at.source, given)
        word = _MODES[name][0] if known is None else known.text if isinstance(known, Word) else ""
        if word not in _MODES[name]:
            why = f"there is no {word}" if word else why_unknown(self.variables, at.source, given or NOTHING)
            advice = f"Write its value, one of {', '.join(_MODES[name])}{'.' if word else f', or {_IN_A_FILE}.'}"
            problem = at.error(f"{name} is not known: {why}", advice)
            if name == "$IPO_MODE":
                raise problem
            return self.reasons.unknown(state, FIELDS[name], problem)
        if name == "$IPO_MODE":
            if word != "#BASE":
                moved = f"$IPO_MODE {word}: the workpiece is moved by the robot"
                raise at.error(moved, "Only $IPO_MODE=#BASE (the robot moves the tool) can be corrected.")
            return state
        return state.with_known(**{FIELDS[name]: word})

    def _component(self, at: Place, field: str | None, own: str, value: Value | Known) -> Value | Known | None:
        """Return what is assigned to one component of a structure; None if that is another one, or left out."""
        if field is not None:
            return value if field == own else None
        known = self.variables.evaluate(at.source, value)
        return known.items.get(own) if isinstance(known, Aggregate) else value

    def _unknown(self, state: State, field: str, at: Place, problem: str, value: Value | Known) -> State:
        why = why_unknown(self.variables, at.source, value)
        return self.reasons.unknown(state, field, at.error(f"{problem}: {why}", _RUN_TIME))
