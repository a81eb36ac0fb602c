"""What is in force at a motion: `$BASE`, `$TOOL`, speed, approximation, and the statements that change it.

Sources: KUKA's `BAS.SRC` (what #INITMOV, #CP_PARAMS, #FRAMES … set) and the system variables' descriptions.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from postproc.cell import Cell
from postproc.dialects.krl.language.expressions import Aggregate, Call, Number, Reference, Value, Word, parse
from postproc.dialects.krl.language.positions import CARTESIAN, FARTHEST, Position, from_pose
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.read.variables import NOTHING, Known, Unknown, Variables
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

FIELDS = {
    "$BASE": "base",
    "$TOOL": "tool",
    "$VEL": "speed",
    "$APO": "cdis",
    "$ORI_TYPE": "orientation",
    "$CIRC_TYPE": "circle",
}
"""What of the `State` a variable sets; the others of `RELEVANT` must not change at all."""
BAS_SETS = {
    "#INITMOV": tuple(FIELDS),
    "#VEL_CP": ("$VEL",),
    "#BASE": ("$BASE",),
    "#TOOL": ("$TOOL",),
    "#CP_DAT": ("$APO", "$ORI_TYPE", "$CIRC_TYPE"),
    "#FRAMES": ("$BASE", "$TOOL"),
    "#PTP_PARAMS": ("$BASE", "$TOOL"),
    "#CP_PARAMS": tuple(FIELDS),
}
"""Which variables a command of BAS sets."""
_HARMLESS_BAS = frozenset({"ACC_CP", "ACC_PTP", "VEL_PTP", "PTP_DAT", "OUT_SYNC", "OUT_ASYNC", "GROUP", "ACC_GLUE"})
_FASTEST = 100.0
"""A speed above this [m/s] is a slip of the unit."""
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
    :ivar initial: which of `$BASE` and `$TOOL` BAS(#INITMOV,0) has set.
    :ivar uncertain: (field, index of its reason) of those that are not known; `base` and `tool` are never among them.
    """

    base: int = 0
    tool: int = 0
    speed: float = DEFAULT_SPEED
    assumed: bool = True
    cdis: float = DEFAULT_CDIS * M_PER_MM
    orientation: str = "#VAR"
    circle: str = "#BASE"
    initial: frozenset[str] = frozenset()
    uncertain: tuple[tuple[str, int], ...] = ()

    def with_known(self, **fields: object) -> State:
        """Return the state with other values, which are known."""
        initial = self.initial - {f"${name.upper()}" for name in fields}
        uncertain = tuple(one for one in self.uncertain if one[0] not in fields)
        return self._replace(initial=initial, uncertain=uncertain, **fields)  # type: ignore[arg-type]


class Settings:
    """The state of a program, followed from statement to statement.

    :ivar state: what is in force now.
    :ivar changes: (line of the program, state in force behind it), in order.
    :ivar bases: `$BASE` in the robot root, row 0 that of the cell.
    :ivar tools: `$TOOL` in the flange frame, row 0 that of the cell.
    :ivar reasons: why something is not known.
    """

    def __init__(self, variables: Variables, cell: Cell) -> None:
        self.variables, self.cell = variables, cell
        self.state = State()
        self.changes: list[tuple[int, State]] = [(0, self.state)]
        self.bases: list[Array] = [cell.base.pose()]
        self.tools: list[Array] = [cell.tool.pose()]
        self.reasons: list[ProgramError] = []
        self._rows: dict[tuple[str, tuple[float, ...]], int] = {}

    def change(self, line: int, state: State) -> None:
        """Put a state into force behind a line of the program."""
        if state != self.state:
            self.state = state
            self.changes.append((line, state))

    def may_become(self, line: int, state: State, reason: ProgramError) -> None:
        """Put what is in force into doubt as far as another state differs, which may or may not come into force."""
        names = {name for name in FIELDS.values() if getattr(self.state, name) != getattr(state, name)}
        self.make_uncertain(line, sorted(names | {name for name, _ in state.uncertain}), reason)

    def make_uncertain(self, line: int, names: Iterable[str], reason: ProgramError) -> None:
        """Note that fields of the state are not known from a line of the program on."""
        state = self.state
        for name in names:
            state = self._uncertain(state, name, reason)
        self.change(line, state)

    def _uncertain(self, state: State, name: str, reason: ProgramError) -> State:
        self.reasons.append(reason)
        if name in ("base", "tool"):
            return state.with_known(**{name: -len(self.reasons)})
        return state.with_known(**{name: getattr(state, name)})._replace(
            uncertain=(*(one for one in state.uncertain if one[0] != name), (name, len(self.reasons) - 1))
        )

    def refuse_uncertain(self, state: State, names: Iterable[str]) -> None:
        """Refuse a motion that depends on fields of its state that are not known.

        :raises ProgramError: the reason why one is not.
        """
        for name in names:
            row = getattr(state, name) if name in ("base", "tool") else 0
            if row < 0:
                raise self.reasons[-1 - row]
            for affected, reason in state.uncertain:
                if affected == name:
                    raise self.reasons[reason]

    def assigned(self, state: State, at: Place, target: Reference, value: Value | Known) -> State:
        """Return the state behind ``target = value`` for one of the `RELEVANT` variables.

        :raises ProgramError: the value moves the robot in a way that is not modelled.
        """
        name = target.name
        self.variables.rely(at.source, value)
        if name == "$BASE" or name == "$TOOL":
            return self._frame(state, at, target, value)
        if name == "$VEL":
            return self._speed(state, at, target.field, value)
        if name == "$APO":
            return self._approximation(state, at, target.field, value)
        if name in ("$ORI_TYPE", "$CIRC_TYPE", "$IPO_MODE"):
            return self._mode(state, at, name, value)
        raise at.error(f"{name} is changed by the program", "Leave it as the controller has it.")

    def _mode(self, state: State, at: Place, name: str, value: Value | Known) -> State:
        default = {"$ORI_TYPE": "#VAR", "$CIRC_TYPE": "#BASE", "$IPO_MODE": "#BASE"}[name]
        if isinstance(value, Call) and value.name in ("SIPO_MODE", "SORI_TYP"):
            data = self._argument(at, value, "IPO_FRAME" if value.name == "SIPO_MODE" else "ORI_TYP")
            word = data.text if isinstance(data, Word) else default
        else:
            known = self.variables.evaluate(at.source, value)
            if not isinstance(known, Word):
                problem = at.error(f"{name} is not known before the program runs", _RUN_TIME)
                if name == "$IPO_MODE":
                    raise problem
                return self._uncertain(state, FIELDS[name], problem)
            word = known.text
        if name == "$IPO_MODE":
            _check_frame_mode(word, at)
            return state
        return state.with_known(**{FIELDS[name]: word})

    def _frame(self, state: State, at: Place, target: Reference, value: Value | Known) -> State:
        name = target.name
        if isinstance(value, Call) and value.name in ("SBASE", "STOOL", "STOOL2"):
            known = self._argument(at, value, "BASE_NO" if value.name == "SBASE" else "TOOL_NO")
            if not isinstance(known, Number):
                text = at.source.text[value.start : value.stop]
                return self._unknown(state, name, at, f"{text}: the number is not known")
            return self.numbered(state, at, name, int(known.value))
        if isinstance(value, Call) and value.name == "EK":
            raise at.error("external kinematics (EK) move the base", "Only a fixed $BASE can be corrected.")
        if target.element is not None or (target.field is not None and target.field not in CARTESIAN):
            return self._unknown(state, name, at, "its component is not understood")
        if isinstance(value, Reference) and value.name in ("BASE_DATA", "TOOL_DATA") and value.field is None:
            key = self.variables.key_of(at.source, value)
            return self._named_frame(state, at, name, value, key or value.name)
        self._show(state)
        if target.field is not None:
            position = self._with_field(state, at, target, value)
        else:
            position = self.variables.position(at.source, value)
        if position is None or position.axis:
            return self._unknown(state, name, at, self.variables.why_unknown(at.source, value))
        if position.farthest > FARTHEST:
            raise out_of_reach(at, position.farthest)
        return self._put(state, name, position)

    def _show(self, state: State) -> None:
        """Let expressions see `$BASE` and `$TOOL`."""
        for name in ("$BASE", "$TOOL"):
            self.variables.put(name, self._current(state, name) or NOTHING)

    def _current(self, state: State, name: str) -> Position | None:
        row, frames = (state.base, self.bases) if name == "$BASE" else (state.tool, self.tools)
        return from_pose(frames[row]) if row >= 0 else None

    def _with_field(self, state: State, at: Place, target: Reference, value: Value | Known) -> Position | None:
        current, number = self._current(state, target.name), self.variables.number(at.source, value)
        if current is None or number is None:
            return None
        values = list(current.values)
        values[CARTESIAN.index(target.field or "")] = number
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
        return state.with_known(**{FIELDS[name]: row})

    def _unknown(self, state: State, name: str, at: Place, why: str) -> State:
        return self._uncertain(state, FIELDS[name], at.error(f"{name} is not known: {why}", _FRAME_ADVICE))

    def numbered(self, state: State, at: Place, name: str, number: int) -> State:
        """Return the state behind ``$BASE=BASE_DATA[number]`` or ``$TOOL=TOOL_DATA[number]``."""
        key = f"{name[1:]}_DATA[{number}]"
        return self._named_frame(state, at, name, Reference(f"{name[1:]}_DATA", str(number), None, 0, 0), key)

    def _named_frame(self, state: State, at: Place, name: str, reference: Reference, key: str) -> State:
        position = self.variables.position(at.source, reference)
        if position is not None and position.farthest > FARTHEST:
            raise out_of_reach(at, position.farthest)
        if position is None:
            known = self.variables.evaluate(at.source, reference)
            why = "is neither in the cell nor in the $config.dat"
            if isinstance(known, Unknown) and known.where:
                why = f"is changed while the program runs ({known.where})"
            return self._unknown(state, name, at, f"{key} {why}")
        return self._put(state, name, position)

    def _speed(self, state: State, at: Place, field: str | None, value: Value | Known) -> State:
        if field is not None and field != "CP":
            return state
        if isinstance(value, Call) and value.name == "SVEL_CP" and value.arguments:
            value = parse(at.source, *value.arguments[0])[0]
        if field is None:
            known = self.variables.evaluate(at.source, value)
            if isinstance(known, Aggregate):
                if "CP" not in known.items:
                    return state
                value = known.items["CP"]
        number = self.variables.number(at.source, value)
        if number is None:
            why = self.variables.why_unknown(at.source, value)
            problem = at.error(f"the speed $VEL.CP is not known before the program runs: {why}", _RUN_TIME)
            return self._uncertain(state, "speed", problem)
        if not 0.0 < number <= _FASTEST:
            raise at.error(f"the speed $VEL.CP is {number:g} m/s", f"Give a speed above 0, up to {_FASTEST:g} m/s.")
        return state.with_known(speed=number, assumed=False)

    def _approximation(self, state: State, at: Place, field: str | None, value: Value | Known) -> State:
        if field is not None and field != "CDIS":
            return state
        if isinstance(value, Call):
            if value.name != "SAPO":
                return state
            field, value = "CDIS", self._argument(at, value, "APO_DIST")
            if value == NOTHING:
                return state
        if field is None:
            known = self.variables.evaluate(at.source, value)
            if isinstance(known, Aggregate):
                if "CDIS" not in known.items:
                    return state
                value = known.items["CDIS"]
        number = self.variables.number(at.source, value)
        if number is None or number < 0.0:
            why = self.variables.why_unknown(at.source, value)
            problem = at.error(f"the approximation distance $APO.CDIS is not known: {why}", _RUN_TIME)
            return self._uncertain(state, "cdis", problem)
        return state.with_known(cdis=number * M_PER_MM)

    def _argument(self, at: Place, call: Call, field: str) -> Value | Known:
        """Return the first argument of a call, of a structure the component in question."""
        if not call.arguments:
            return NOTHING
        known = self.variables.evaluate(at.source, parse(at.source, *call.arguments[0])[0])
        return known.items.get(field, NOTHING) if isinstance(known, Aggregate) else known

    def bas(self, at: Place, call: Call) -> State:
        """Return the state behind a call of KUKA's ``BAS(#COMMAND, value)``.

        :raises ProgramError: the command is not known.
        """
        state, source = self.state, at.source
        command = source.text[slice(*call.arguments[0])].strip().upper() if call.arguments else ""
        argument = parse(source, *call.arguments[1])[0] if len(call.arguments) > 1 else None
        if argument is not None:
            self.variables.rely(source, argument)
        if command == "#INITMOV":
            return self._initialised(state, at)
        if command == "#VEL_CP" and argument is not None:
            return self._speed(state, at, "CP", argument)
        if command in ("#BASE", "#TOOL"):
            number = self.variables.number(source, argument) if argument is not None else None
            if number is None:
                return self._unknown(state, f"${command[1:]}", at, "its number is not known")
            return self.numbered(state, at, f"${command[1:]}", int(number))
        if command == "#CP_DAT":
            return self._path_data(state, at)
        if command in ("#FRAMES", "#PTP_PARAMS"):
            return self._frames(state, at)
        if command == "#CP_PARAMS" and argument is not None:
            return self._speed(self._frames(self._path_data(state, at), at), at, "CP", argument)
        if command[1:] in _HARMLESS_BAS:
            return state
        known = (
            "#INITMOV, #BASE, #TOOL, #FRAMES, #VEL_CP, #CP_DAT, #CP_PARAMS, #PTP_PARAMS, #VEL_PTP, #ACC_CP, #ACC_PTP"
        )
        raise at.error(f"BAS({command}) is not understood", f"Understood are {known}.")

    def _initialised(self, state: State, at: Place) -> State:
        """#INITMOV also sets BASE(0) and TOOL_DATA[1]; the cell says whether these are meant, or its own frames."""
        fresh, meant = State(), self.cell.krl.initmov
        if meant == "bas":
            return self.numbered(self.numbered(fresh, at, "$BASE", 0), at, "$TOOL", 1)
        if meant is None and (state.base != 0 or state.tool != 0):
            why = "BAS(#INITMOV,0) resets $BASE and $TOOL after they were set"
            return self._unknown(self._unknown(fresh, "$BASE", at, why), "$TOOL", at, why)
        return fresh._replace(initial=frozenset(("$BASE", "$TOOL")))

    def assumed_frames(self, state: State, source: Source) -> set[str]:
        """Return which of `$BASE` and `$TOOL` are the cell's because nobody says what #INITMOV gives."""
        if self.cell.krl.initmov is not None:
            return set()
        tool = self.variables.position(source, Reference("TOOL_DATA", "1", None, 0, 0))
        real = {"$BASE": Position((0.0,) * 6), "$TOOL": tool}
        return {name for name in state.initial if not self._is_cell(name, real[name])}

    def _is_cell(self, name: str, position: Position | None) -> bool:
        frame = self.bases[0] if name == "$BASE" else self.tools[0]
        return position is not None and bool(np.abs(position.pose() - frame).max() < _SAME)

    def _variable(self, name: str, at: Place) -> Aggregate | None:
        start, _ = at.source.code_span(at.line)
        known = self.variables.evaluate(at.source, Reference(name, None, None, start, start))
        return known if isinstance(known, Aggregate) else None

    def _path_data(self, state: State, at: Place) -> State:
        data = self._variable("LDAT_ACT", at)
        if data is None:
            return state
        distance, kind, circle = (data.items.get(name) for name in ("APO_DIST", "ORI_TYP", "CIRC_TYP"))
        if isinstance(distance, Number):
            state = state.with_known(cdis=distance.value * M_PER_MM)
        if isinstance(kind, Word):
            state = state.with_known(orientation=kind.text)
        return state.with_known(circle=circle.text) if isinstance(circle, Word) else state

    def _frames(self, state: State, at: Place) -> State:
        data = self._variable("FDAT_ACT", at)
        if data is None:
            why = "FDAT_ACT has no value in the program, its .dat or the $config.dat"
            return self._unknown(self._unknown(state, "$BASE", at, why), "$TOOL", at, why)
        mode = data.items.get("IPO_FRAME")
        if isinstance(mode, Word):
            _check_frame_mode(mode.text, at)
        for name, field in (("$BASE", "BASE_NO"), ("$TOOL", "TOOL_NO")):
            number = data.items.get(field)
            if isinstance(number, Number):
                state = self.numbered(state, at, name, int(number.value))
            else:
                state = self._unknown(state, name, at, f"FDAT_ACT has no {field}")
        return state


def _check_frame_mode(word: str, at: Place) -> None:
    if word != "#BASE":
        raise at.error(
            f"$IPO_MODE {word}: the workpiece is moved by the robot",
            "Only $IPO_MODE=#BASE (the robot moves the tool) can be corrected.",
        )


def out_of_reach(at: Place, number: float) -> ProgramError:
    """Return the error for a coordinate beyond `FARTHEST`."""
    return at.error(f"{number:g} is out of any robot's reach", "Coordinates are in mm and degrees.")
