"""KUKA's `BAS`: what ``BAS(#COMMAND,value)`` sets. Source: `BAS.SRC` of the controller."""

from __future__ import annotations

from collections.abc import Collection

from msgspec.structs import replace

from postproc.cell import Cell
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.tree import CallStatement
from postproc.dialects.krl.language.values import Aggregate, Call, Number, Reference, Value, Word
from postproc.dialects.krl.read.explanations import why_unknown
from postproc.dialects.krl.read.frames import Frames
from postproc.dialects.krl.read.known import VariableValue
from postproc.dialects.krl.read.path_settings import MODES, PathSettings
from postproc.dialects.krl.read.state import DEFAULT_CDIS, DEFAULT_SPEED, FIELD_OF_SETTING, State
from postproc.dialects.krl.read.variables import Variables
from postproc.frames import M_PER_MM

_SPLINE_VARIABLES = {"$CIRC_MODE": "auxiliary", "$SPL_ORI_JOINT_AUTO": "wrist_mode"}
"""Variables of spline motions, which BAS does not set, and the fields of the `State` that they set."""
_MOTION_VARIABLES = tuple(name for name in FIELD_OF_SETTING if name not in _SPLINE_VARIABLES)
BAS_SETS = {
    "#INITMOV": _MOTION_VARIABLES,
    "#VEL_CP": ("$VEL",),
    "#BASE": ("$BASE",),
    "#TOOL": ("$TOOL",),
    "#CP_DAT": ("$VEL", "$APO", "$ORI_TYPE", "$CIRC_TYPE"),
    "#FRAMES": ("$BASE", "$TOOL"),
    "#PTP_DAT": ("$APO",),
    "#PTP_PARAMS": ("$APO", "$BASE", "$TOOL"),
    "#CP_PARAMS": _MOTION_VARIABLES,
}
"""Which variables a command of BAS sets."""
_FRAME_DATA = ("FDAT_ACT", "BASE_DATA", "TOOL_DATA")
_BAS_READS = {
    "#INITMOV": ("TOOL_DATA",),
    "#BASE": ("BASE_DATA",),
    "#TOOL": ("TOOL_DATA",),
    "#CP_DAT": ("LDAT_ACT",),
    "#FRAMES": _FRAME_DATA,
    "#PTP_DAT": ("PDAT_ACT",),
    "#PTP_PARAMS": ("PDAT_ACT", *_FRAME_DATA),
    "#CP_PARAMS": ("LDAT_ACT", *_FRAME_DATA),
}
"""Which data of the controller a command of BAS reads."""
_FUNCTION_READS = {"SBASE": "BASE_DATA", "STOOL": "TOOL_DATA", "STOOL2": "TOOL_DATA"}
"""Which data of the controller a function of inline forms reads."""
_HARMLESS_COMMANDS = frozenset({"ACC_CP", "ACC_PTP", "VEL_PTP", "OUT_SYNC", "OUT_ASYNC", "GROUP", "ACC_GLUE"})
"""Commands that change no field of the `State`."""
_COMMAND_LIST = (
    "#INITMOV, #BASE, #TOOL, #FRAMES, #VEL_CP, #CP_DAT, #CP_PARAMS, #PTP_DAT, #PTP_PARAMS, #VEL_PTP, #ACC_CP, #ACC_PTP"
)


def command_of(source: Source, call: Call) -> str:
    """Return the command of a call of BAS with its ``#``, upper case; empty without arguments."""
    return source.text[call.arguments[0].start : call.arguments[0].stop].strip().upper() if call.arguments else ""


def data_read(source: Source, line: int, words: Collection[str]) -> list[str]:
    """Return the data of the controller that BAS and the functions of inline forms read on a line without naming them.

    :param words: words in the code of the line, upper case.
    """
    names = [_FUNCTION_READS[word] for word in words if word in _FUNCTION_READS]
    stmt = statement(source, line) if "BAS" in words else None
    if isinstance(stmt, CallStatement) and stmt.word == "BAS":
        names += _BAS_READS.get(command_of(source, stmt.call), ())
    return names


class Bas:
    """Follows calls of BAS."""

    def __init__(self, variables: Variables, cell: Cell, frames: Frames, path: PathSettings) -> None:
        """Keep the parts of the settings that calls of BAS change."""
        self.variables, self.cell, self.frames, self.path = variables, cell, frames, path

    def state_after_call(self, state: State, place: Place, call: Call) -> State:
        """Return the state after ``BAS(#COMMAND, value)``.

        A value that is not known makes the frame or the speed that it sets unknown.

        :raises ProgramError: the command is not understood, or its value is missing.
        """
        source = place.source
        command = command_of(source, call)
        argument = call.arguments[1] if len(call.arguments) > 1 else None
        if argument is not None:
            self.variables.note_dependence(argument)
        if command == "#INITMOV":
            return self._state_after_initmov(state, place)
        if command == "#VEL_CP" and argument is not None:
            return self._state_with_speed(state, place, argument)
        if command in ("#BASE", "#TOOL"):
            number = self.variables.number(argument) if argument is not None else None
            if number is None:
                return self.frames.state_with_unknown_frame(state, f"${command[1:]}", place, "its number is not known")
            return self.frames.state_with_numbered_frame(state, place, f"${command[1:]}", int(number))
        if command == "#CP_DAT":
            return self._state_after_cp_dat(self._state_with_speed_of_data(state, place), place)
        if command == "#PTP_DAT":
            return self._state_after_ptp_dat(state, place)
        if command == "#FRAMES":
            return self._state_after_frames(state, place)
        if command == "#PTP_PARAMS":
            return self._state_after_frames(self._state_after_ptp_dat(state, place), place)
        if command == "#CP_PARAMS" and argument is not None:
            state = self._state_after_frames(self._state_after_cp_dat(state, place), place)
            return self._state_with_speed(state, place, argument)
        if command[1:] in _HARMLESS_COMMANDS:
            return state
        raise place.error(f"BAS({command}) is not understood", f"Understood are {_COMMAND_LIST}.")

    def _state_after_initmov(self, state: State, place: Place) -> State:
        """Return the state after BAS(#INITMOV,0): default settings, but for those of splines, which stay.

        The frames depend on `[krl] initmov` of the cell. "bas": BASE(0) and TOOL_DATA[1], as KUKA's BAS sets them.
        "cell": the frames of the cell. Not stated: the frames of the cell as well; if the program has set other frames
        before, they are not known.

        :param place: file and line of the call, for messages.
        """
        spline_fields = {field: getattr(state, field) for field in _SPLINE_VARIABLES.values()}
        initial_state = State(
            **spline_fields,
            speed=self._default("DEF_VEL_CP", DEFAULT_SPEED, place),
            cdis=self._default("DEF_APO_CDIS", DEFAULT_CDIS, place) * M_PER_MM,
            uncertain_fields=tuple((field, index) for field, index in state.uncertain_fields if field in spline_fields),
        )
        initmov = self.cell.krl.initmov
        if initmov == "bas":
            base_state = self.frames.state_with_numbered_frame(initial_state, place, "$BASE", 0)
            return self.frames.state_with_numbered_frame(base_state, place, "$TOOL", 1)
        # base and tool 0 are the frames of the cell, see `Frames.bases`; so they are in `initial_state`
        if initmov is None and (state.base != 0 or state.tool != 0):
            return self._without_frames(
                initial_state, place, "BAS(#INITMOV,0) resets $BASE and $TOOL after they were set"
            )
        return replace(initial_state, initial_frames=frozenset(("$BASE", "$TOOL")))

    def _without_frames(self, state: State, place: Place, reason: str) -> State:
        """Return a state in which `$BASE` and `$TOOL` are not known; the reason is stored for messages.

        :param place: file and line of the call, for messages.
        """
        state = self.frames.state_with_unknown_frame(state, "$BASE", place, reason)
        return self.frames.state_with_unknown_frame(state, "$TOOL", place, reason)

    def _structure_value(self, name: str, place: Place) -> VariableValue:
        """Return the value of a structure that a command of BAS reads: LDAT_ACT or FDAT_ACT."""
        return self.variables.evaluate(self._reference(name, None, place))

    def _default(self, name: str, usual_value: float, place: Place) -> float:
        """Return a default value that the `$config.dat` states; the usual one if it is not known."""
        number = self.variables.number(self._reference(name, None, place))
        return usual_value if number is None else number

    def _reference(self, name: str, field: str | None, place: Place) -> Reference:
        """Return a reference to a structure or to one of its fields, as if the call of BAS contained it.

        :param field: name of the field; None: the whole structure.
        :param place: the call of BAS.
        """
        start, _ = place.source.code_span(place.line)
        return Reference(name, None, field, start, start)  # no text, but the line of the call for messages

    def _state_with_speed(self, state: State, place: Place, speed: Value) -> State:
        """Return the state after VEL_CP of BAS: `$VEL.CP`, at most DEF_VEL_CP."""
        state = self.path.state_with_speed(state, place, "CP", speed)
        return replace(state, speed=min(state.speed, self._default("DEF_VEL_CP", DEFAULT_SPEED, place)))

    def _state_with_speed_of_data(self, state: State, place: Place) -> State:
        """Return the state with the speed of LDAT_ACT; it is not known if LDAT_ACT lacks it."""
        return self._state_with_speed(state, place, self._reference("LDAT_ACT", "VEL", place))

    def _state_after_cp_dat(self, state: State, place: Place) -> State:
        """Return the state after CP_DAT of BAS: LDAT_ACT gives `$APO.CDIS`, `$ORI_TYPE` and `$CIRC_TYPE`.

        The distance stays if LDAT_ACT lacks it; a mode gets its first value. If LDAT_ACT itself is not known, none of
        the three is known.
        """
        data = self._structure_value("LDAT_ACT", place)  # a reference to a field of an unknown structure is unknown too
        lacking = {"APO_DIST", "ORI_TYP", "CIRC_TYP"} - set(data.items) if isinstance(data, Aggregate) else set()
        if "APO_DIST" not in lacking:
            state = self.path.state_with_distance(state, place, "CDIS", self._reference("LDAT_ACT", "APO_DIST", place))
        for name, field in (("$ORI_TYPE", "ORI_TYP"), ("$CIRC_TYPE", "CIRC_TYP")):
            if field in lacking:
                state = state.with_values(**{FIELD_OF_SETTING[name]: MODES[name][0]})
            else:
                state = self.path.state_with_mode(state, place, name, self._reference("LDAT_ACT", field, place))
        return state

    def _state_after_ptp_dat(self, state: State, place: Place) -> State:
        """Return the state after PTP_DAT of BAS: PDAT_ACT gives `$APO.CDIS` if its APO_MODE is #CDIS.

        Otherwise it gives `$APO.CPTP`, which is not followed; so it is assumed if PDAT_ACT is not known.
        """
        mode = self.variables.evaluate(self._reference("PDAT_ACT", "APO_MODE", place))
        if isinstance(mode, Word) and mode.text == "#CDIS":
            return self.path.state_with_distance(state, place, "CDIS", self._reference("PDAT_ACT", "APO_DIST", place))
        return state

    def _state_after_frames(self, state: State, place: Place) -> State:
        """Return the state after BAS(#FRAMES): FDAT_ACT gives `$IPO_MODE` and the numbers of `$BASE` and `$TOOL`.

        A frame whose number is missing or not known is unknown afterwards. If FDAT_ACT itself is not known, both frames
        are. `$IPO_MODE` stays if its field is missing.
        """
        data = self._structure_value("FDAT_ACT", place)
        if not isinstance(data, Aggregate):
            return self._without_frames(
                state, place, why_unknown(self.variables, place.source, self._reference("FDAT_ACT", None, place))
            )
        if "IPO_FRAME" in data.items:
            state = self.path.state_with_mode(
                state, place, "$IPO_MODE", self._reference("FDAT_ACT", "IPO_FRAME", place)
            )
        for name, field in (("$BASE", "BASE_NO"), ("$TOOL", "TOOL_NO")):
            number = data.items.get(field)
            if isinstance(number, Number):
                state = self.frames.state_with_numbered_frame(state, place, name, int(number.value))
            else:
                state = self.frames.state_with_unknown_frame(state, name, place, f"FDAT_ACT has no {field}")
        return state
