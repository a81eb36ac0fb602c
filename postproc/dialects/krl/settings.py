"""What is in force at a motion: `$BASE`, `$TOOL`, speed, approximation, and the statements that change it.

Sources: KUKA's `BAS.SRC` (what #INITMOV, #CP_PARAMS, #FRAMES … set) and the system variables' descriptions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc.cell import Cell
from postproc.dialects.krl.positions import Position, from_pose
from postproc.dialects.krl.source import Source
from postproc.dialects.krl.syntax import Aggregate, Call, Chain, Number, Reference, Value, Word, parse
from postproc.dialects.krl.variables import Unknown, Variables
from postproc.errors import ProgramError
from postproc.frames import M_PER_MM, Array

DEFAULT_SPEED = 2.0
"""DEF_VEL_CP [m/s]: what `BAS(#INITMOV,0)` gives `$VEL.CP`."""
DEFAULT_CDIS = 3.0
"""What `BAS(#INITMOV,0)` gives `$APO.CDIS` [mm]."""

RELEVANT = frozenset(
    {"$BASE", "$TOOL", "$VEL", "$APO", "$ORI_TYPE", "$CIRC_TYPE", "$IPO_MODE", "$ROBROOT", "$WORLD", "$EX_AX_IGNORE"}
)
"""System variables that a motion depends on."""

_HARMLESS_BAS = frozenset({"ACC_CP", "ACC_PTP", "VEL_PTP", "PTP_DAT", "OUT_SYNC", "OUT_ASYNC", "GROUP", "ACC_GLUE"})
_SAME = 1e-13
"""Frames closer than this [m, rad] are one: rounding of their conversion."""
_RUN_TIME = "Write it as a number or a constant name, so that it is known before the program runs."
_FRAME_ADVICE = "Write $BASE and $TOOL as numbers, or add [base_data.n], [tool_data.n] or config_dat to the cell."


class State(NamedTuple):
    """What is in force between two statements.

    :ivar base: row of `Settings.bases`; −1−k when it is not known, for the reason `Settings.reasons[k]`.
    :ivar tool: row of `Settings.tools`; likewise.
    :ivar speed: `$VEL.CP` [m/s].
    :ivar assumed: True while `$VEL.CP` is the controller's default.
    :ivar cdis: `$APO.CDIS` [m].
    :ivar orientation: `$ORI_TYPE`.
    :ivar circle: `$CIRC_TYPE`.
    """

    base: int = 0
    tool: int = 0
    speed: float = DEFAULT_SPEED
    assumed: bool = True
    cdis: float = DEFAULT_CDIS * M_PER_MM
    orientation: str = "#VAR"
    circle: str = "#BASE"


class Settings:
    """The state of a program, followed from statement to statement.

    :ivar state: what is in force now.
    :ivar changes: (line, state in force behind it), in order.
    :ivar bases: `$BASE` in the robot root, row 0 that of the cell.
    :ivar tools: `$TOOL` in the flange frame, row 0 that of the cell.
    :ivar reasons: why a frame is not known.
    """

    def __init__(self, source: Source, variables: Variables, cell: Cell) -> None:
        self.source, self.variables = source, variables
        self.state = State()
        self.changes: list[tuple[int, State]] = [(0, self.state)]
        self.bases: list[Array] = [cell.base.pose()]
        self.tools: list[Array] = [cell.tool.pose()]
        self.reasons: list[ProgramError] = []
        self._rows: dict[tuple[str, tuple[float, ...]], int] = {}

    def change(self, line: int, state: State) -> None:
        """Put a state into force behind a line."""
        if state != self.state:
            self.state = state
            self.changes.append((line, state))

    def assigned(self, state: State, line: int, target: Reference, value: Value) -> State:
        """Return the state behind ``target = value`` for one of the `RELEVANT` variables.

        :raises ProgramError: the value moves the robot in a way that is not modelled, or a speed is not known.
        """
        name = target.name
        if name == "$BASE" or name == "$TOOL":
            return self._frame(state, line, target, value)
        if name == "$VEL":
            return self._speed(state, line, target.field, value)
        if name == "$APO":
            return self._approximation(state, line, target.field, value)
        if name in ("$ORI_TYPE", "$CIRC_TYPE", "$IPO_MODE"):
            return self._mode(state, line, name, value)
        raise self.source.line_error(f"{name} is changed by the program", line, "Leave it as the controller has it.")

    def _mode(self, state: State, line: int, name: str, value: Value) -> State:
        default = {"$ORI_TYPE": "#VAR", "$CIRC_TYPE": "#BASE", "$IPO_MODE": "#BASE"}[name]
        if isinstance(value, Call) and value.name in ("SIPO_MODE", "SORI_TYP"):
            field = "IPO_FRAME" if value.name == "SIPO_MODE" else "ORI_TYP"
            word = self._argument_word(value, field) or default
        else:
            known = self.variables.evaluate(self.source, value)
            if not isinstance(known, Word):
                raise self.source.line_error(f"{name} is not known before the program runs", line, _RUN_TIME)
            word = known.text
        if name == "$IPO_MODE":
            self._check_frame_mode(word, line)
            return state
        return state._replace(orientation=word) if name == "$ORI_TYPE" else state._replace(circle=word)

    def _check_frame_mode(self, word: str, line: int) -> None:
        if word != "#BASE":
            raise self.source.line_error(
                f"$IPO_MODE {word}: the workpiece is moved by the robot",
                line,
                "Only $IPO_MODE=#BASE (the robot moves the tool) can be corrected.",
            )

    def _frame(self, state: State, line: int, target: Reference, value: Value) -> State:
        if isinstance(value, Call) and value.name in ("SBASE", "STOOL", "STOOL2"):
            number = self._argument_number(value, "BASE_NO" if value.name == "SBASE" else "TOOL_NO")
            if number is None:
                text = self.source.text[value.start : value.stop]
                return self._unknown(state, target.name, line, f"{text}: the number is not known")
            return self.numbered(state, line, target.name, number)
        if isinstance(value, Call) and value.name == "EK":
            raise self.source.line_error(
                "external kinematics (EK) move the base", line, "Only a fixed $BASE can be corrected."
            )
        if isinstance(value, Reference) and value.name in ("BASE_DATA", "TOOL_DATA"):
            key = self.variables.key_of(self.source, value)
            return self._named_frame(state, line, target.name, value, key or value.name)
        position = self._current(state, target.name) if _is(value, target.name) else self._position(state, value)
        if target.field is not None:
            position = self._with_field(state, target, value)
        if position is None or position.axis:
            return self._unknown(state, target.name, line, self.variables.why_unknown(self.source, value))
        return self._put(state, target.name, position)

    def _position(self, state: State, value: Value) -> Position | None:
        if isinstance(value, Chain):
            for name in ("$BASE", "$TOOL"):
                self.variables.set(name, self._current(state, name) or Unknown(0))
        return self.variables.position(self.source, value)

    def _current(self, state: State, name: str) -> Position | None:
        row, frames = (state.base, self.bases) if name == "$BASE" else (state.tool, self.tools)
        return from_pose(frames[row]) if row >= 0 else None

    def _with_field(self, state: State, target: Reference, value: Value) -> Position | None:
        current, number = self._current(state, target.name), self.variables.number(self.source, value)
        if current is None or number is None or target.field not in ("X", "Y", "Z", "A", "B", "C"):
            return None
        values = list(current.values)
        values["XYZABC".index(target.field)] = number
        return Position(tuple(values))

    def _put(self, state: State, name: str, position: Position) -> State:
        row = self._rows.get((name, position.values))
        if row is None:
            frames = self.bases if name == "$BASE" else self.tools
            pose = position.pose()
            row = next((row for row, known in enumerate(frames) if np.abs(known - pose).max() < _SAME), len(frames))
            if row == len(frames):
                frames.append(pose)
            self._rows[name, position.values] = row
        return state._replace(base=row) if name == "$BASE" else state._replace(tool=row)

    def _unknown(self, state: State, name: str, line: int, why: str) -> State:
        self.reasons.append(self.source.line_error(f"{name} is not known: {why}", line, _FRAME_ADVICE))
        row = -len(self.reasons)
        return state._replace(base=row) if name == "$BASE" else state._replace(tool=row)

    def numbered(self, state: State, line: int, name: str, number: int) -> State:
        """Return the state behind ``$BASE=BASE_DATA[number]`` or ``$TOOL=TOOL_DATA[number]``."""
        key = f"{name[1:]}_DATA[{number}]"
        return self._named_frame(state, line, name, Reference(f"{name[1:]}_DATA", str(number), None, 0, 0), key)

    def _named_frame(self, state: State, line: int, name: str, reference: Reference, key: str) -> State:
        position = self.variables.position(self.source, reference)
        if position is None:
            return self._unknown(state, name, line, f"{key} is neither in the cell nor in the $config.dat")
        return self._put(state, name, position)

    def _speed(self, state: State, line: int, field: str | None, value: Value) -> State:
        if field is not None and field != "CP":
            return state
        number: float | None
        if isinstance(value, Call) and value.name == "SVEL_CP" and value.arguments:
            value = parse(self.source, *value.arguments[0])[0]
        if field is None and isinstance(value, Aggregate):
            if "CP" not in value.items:
                return state
            value = value.items["CP"]
        number = self.variables.number(self.source, value)
        if number is None:
            raise self.source.line_error("the speed $VEL.CP is not known before the program runs", line, _RUN_TIME)
        if number <= 0.0:
            raise self.source.line_error(f"the speed $VEL.CP is {number:g} m/s", line, "Give a speed above 0 in m/s.")
        return state._replace(speed=number, assumed=False)

    def _approximation(self, state: State, line: int, field: str | None, value: Value) -> State:
        if field is not None and field != "CDIS":
            return state
        if isinstance(value, Call):
            return self._distance(state, value, "APO_DIST") if value.name == "SAPO" else state
        if field is None:
            value = self.variables.evaluate(self.source, value)  # type: ignore[assignment]
            if not isinstance(value, Aggregate) or "CDIS" not in value.items:
                return state
            value = value.items["CDIS"]
        number = self.variables.number(self.source, value)
        if number is None or number < 0.0:
            raise self.source.line_error("the approximation distance $APO.CDIS is not known", line, _RUN_TIME)
        return state._replace(cdis=number * M_PER_MM)

    def _distance(self, state: State, call: Call, field: str) -> State:
        data = self._argument_data(call)
        item = data.items.get(field) if data else None
        return state._replace(cdis=item.value * M_PER_MM) if isinstance(item, Number) else state

    def _argument_data(self, call: Call) -> Aggregate | None:
        if not call.arguments:
            return None
        known = self.variables.evaluate(self.source, parse(self.source, *call.arguments[0])[0])
        return known if isinstance(known, Aggregate) else None

    def _argument_number(self, call: Call, field: str) -> int | None:
        if not call.arguments:
            return None
        known = self.variables.evaluate(self.source, parse(self.source, *call.arguments[0])[0])
        if isinstance(known, Aggregate):
            known = known.items.get(field)  # type: ignore[assignment]
        return int(known.value) if isinstance(known, Number) else None

    def _argument_word(self, call: Call, field: str) -> str | None:
        if not call.arguments:
            return None
        known = self.variables.evaluate(self.source, parse(self.source, *call.arguments[0])[0])
        if isinstance(known, Aggregate):
            known = known.items.get(field)  # type: ignore[assignment]
        return known.text if isinstance(known, Word) else None

    def bas(self, line: int, call: Call) -> State:
        """Return the state behind a call of KUKA's ``BAS(#COMMAND, value)``.

        :raises ProgramError: the command is not known, or what it sets is not known before the program runs.
        """
        state, source = self.state, self.source
        command = source.text[slice(*call.arguments[0])].strip().upper() if call.arguments else ""
        argument = parse(source, *call.arguments[1])[0] if len(call.arguments) > 1 else None
        if command == "#INITMOV":
            return self._initialised(state, line)
        if command == "#VEL_CP" and argument is not None:
            return self._speed(state, line, "CP", argument)
        if command in ("#BASE", "#TOOL"):
            number = self.variables.number(source, argument) if argument is not None else None
            if number is None:
                return self._unknown(state, f"${command[1:]}", line, "its number is not known")
            return self.numbered(state, line, f"${command[1:]}", int(number))
        if command == "#CP_DAT":
            return self._path_data(state, line)
        if command in ("#FRAMES", "#PTP_PARAMS"):
            return self._frames(state, line)
        if command == "#CP_PARAMS" and argument is not None:
            return self._speed(self._frames(self._path_data(state, line), line), line, "CP", argument)
        if command[1:] in _HARMLESS_BAS:
            return state
        known = (
            "#INITMOV, #BASE, #TOOL, #FRAMES, #VEL_CP, #CP_DAT, #CP_PARAMS, #PTP_PARAMS, #VEL_PTP, #ACC_CP, #ACC_PTP"
        )
        raise source.line_error(f"BAS({command}) is not understood", line, f"Understood are {known}.")

    def _initialised(self, state: State, line: int) -> State:
        """#INITMOV also resets the frames; for a program that sets none of its own the cell's are in force."""
        if state.base != 0 or state.tool != 0:
            why = "BAS(#INITMOV,0) resets $BASE and $TOOL after they were set"
            state = self._unknown(self._unknown(state, "$BASE", line, why), "$TOOL", line, why)
        return State(base=state.base, tool=state.tool)

    def _variable(self, name: str, line: int) -> Aggregate | None:
        start, _ = self.source.code_span(line)
        known = self.variables.evaluate(self.source, Reference(name, None, None, start, start))
        return known if isinstance(known, Aggregate) else None

    def _path_data(self, state: State, line: int) -> State:
        data = self._variable("LDAT_ACT", line)
        if data is None:
            return state
        distance, kind, circle = (data.items.get(name) for name in ("APO_DIST", "ORI_TYP", "CIRC_TYP"))
        if isinstance(distance, Number):
            state = state._replace(cdis=distance.value * M_PER_MM)
        if isinstance(kind, Word):
            state = state._replace(orientation=kind.text)
        return state._replace(circle=circle.text) if isinstance(circle, Word) else state

    def _frames(self, state: State, line: int) -> State:
        data = self._variable("FDAT_ACT", line)
        if data is None:
            why = "FDAT_ACT has no value in the program, its .dat or the $config.dat"
            return self._unknown(self._unknown(state, "$BASE", line, why), "$TOOL", line, why)
        mode = data.items.get("IPO_FRAME")
        if isinstance(mode, Word):
            self._check_frame_mode(mode.text, line)
        for name, field in (("$BASE", "BASE_NO"), ("$TOOL", "TOOL_NO")):
            number = data.items.get(field)
            if isinstance(number, Number):
                state = self.numbered(state, line, name, int(number.value))
            else:
                state = self._unknown(state, name, line, f"FDAT_ACT has no {field}")
        return state


def _is(value: Value, name: str) -> bool:
    return isinstance(value, Reference) and value.name == name and value.field is None
