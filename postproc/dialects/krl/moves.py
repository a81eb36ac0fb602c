"""Motion statements one by one: what the bulk path does not read."""

from __future__ import annotations

import re
from dataclasses import dataclass

from postproc.dialects.krl.positions import Position
from postproc.dialects.krl.settings import RELEVANT, Settings, State
from postproc.dialects.krl.syntax import Reference, operand, parse, split
from postproc.dialects.krl.variables import Unknown
from postproc.program import CIRC, LIN, PTP

KINDS = {"LIN": LIN, "SLIN": LIN, "PTP": PTP, "SPTP": PTP, "CIRC": CIRC, "SCIRC": CIRC}
_APPROXIMATION = re.compile(r"(?:[ \t]*\bC_(?:DIS|VEL|ORI|PTP|SPL)\b)*[ \t]*$", re.IGNORECASE)
_ANGLE = re.compile(r"[ \t]*,[ \t]*CA\b[ \t]*=?", re.IGNORECASE)
_COMMA = re.compile(r"[ \t]*,")
_REFERENCE_FRAME = re.compile(r"[ \t]*(#BASE|#TOOL)\b", re.IGNORECASE)
_WITH = re.compile(r"[ \t]*WITH\b", re.IGNORECASE)
_NO_EFFECT = re.compile(
    r"\$(?:LOAD|ACC|VEL_AXIS|VEL_EXTAX|JERK|GEAR_JERK|COLLMON|TORQMON|CIRC_MODE|SPL_)", re.IGNORECASE
)
_HERE = frozenset({"$POS_ACT", "$POS_ACT_MES", "$AXIS_ACT", "$AXIS_ACT_MEAS"})
_HOME = frozenset({"XHOME", "HOME", "$H_POS"})
RUN_TIME_ADVICE = "Targets must be known before the program runs: write them as numbers or as points of the .dat."


@dataclass(frozen=True, slots=True, eq=False)
class Operand:
    """One point of a motion statement.

    :param position: its numbers, as far as they are given.
    :param start: offset in the `.src` where its text begins.
    :param stop: offset behind its text.
    :param name: variable (upper case) when it is named by itself, else empty: a literal or a chain.
    """

    position: Position
    start: int
    stop: int
    name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """One motion statement.

    :param line: 1-based line.
    :param kind: `LIN`, `CIRC` or `PTP`.
    :param keyword: span of the instruction, with ``_REL``.
    :param end: target.
    :param relative: ``""``, ``"#BASE"`` or ``"#TOOL"``: axes of a ``_REL`` target.
    :param via: auxiliary point of a CIRC.
    :param angle: CA [deg], or None.
    :param tail: offset from which the text applies to inserted targets too: approximation and WITH.
    :param stop: offset behind the code of the line.
    :param approximated: True where `$APO.CDIS` applies.
    :param state: what is in force.
    """

    line: int
    kind: int
    keyword: tuple[int, int]
    end: Operand
    relative: str
    via: Operand | None
    angle: float | None
    tail: int
    stop: int
    approximated: bool
    state: State

    @property
    def plain(self) -> bool:
        """Whether it is a Cartesian LIN or PTP with its numbers in the line: what the bulk path reads too."""
        position = self.end.position
        inline = position.aggregate is not None and position.aggregate.start == self.end.start and not self.end.name
        return self.kind != CIRC and inline and not position.axis and not self.relative


class MoveReader:
    """Reads motion statements.

    :ivar home_used: line of the first motion to a home position that only the cell knows; 0 if there is none.
    """

    def __init__(self, settings: Settings, home: tuple[float, ...]) -> None:
        self.settings, self.source, self.variables = settings, settings.source, settings.variables
        self.home = home
        self.home_used = 0

    def read(self, line: int, word: str, start: int, stop: int) -> Move | None:
        """Return the motion of a statement, or None where it only asks for the present position.

        :param word: instruction, upper case.
        :param start: offset of the instruction.
        :param stop: offset behind the code of the line.
        :raises ProgramError: it is not understood, or its target is not known before the program runs.
        """
        source, name = self.source, word.removesuffix("_REL")
        kind, relative = KINDS[name], "#BASE" if word != name else ""
        if relative and kind == CIRC:
            raise source.line_error(f"{word} is not supported", line, "Write the circle with absolute points.")
        via = angle = None
        position = start + len(word)
        if kind == CIRC:
            via, position = self._operand(line, position, stop)
            comma = _COMMA.match(source.text, position, stop)
            if not via or not comma:
                raise source.line_error(f"{word} needs an auxiliary point and an end point", line)
            position = comma.end()
        end, position = self._operand(line, position, stop)
        if end is None:
            return None
        if kind == CIRC and (match := _ANGLE.match(source.text, position, stop)):
            angle, position = self._angle(line, match.end(), stop)
        if relative and (match := _REFERENCE_FRAME.match(source.text, position, stop)):
            relative, position = match[1].upper(), match.end()
        state, approximated = self._tail(line, kind, position, stop)
        self._check(line, word, kind, end, via)
        if not end.position.axis:
            for row in (state.base, state.tool):
                if row < 0:
                    raise self.settings.reasons[-1 - row]
        keyword = (start, start + len(word))
        return Move(line, kind, keyword, end, relative, via, angle, position, stop, approximated, state)

    def _operand(self, line: int, start: int, stop: int) -> tuple[Operand | None, int]:
        """Return a point and the offset behind it; None for the present position."""
        value, end = parse(self.source, start, stop)
        name = ""
        if isinstance(value, Reference):
            self.variables.check_name(self.source, value)
            if value.name in _HERE:
                return None, end
            name = value.name
            self.variables.understood[name] += 1
        position = self.variables.position(self.source, value)
        if position is None and name in _HOME and self.variables.evaluate(self.source, value) == Unknown(0):
            self.home_used = self.home_used or line
            position = Position(self.home, axis=True)
        if position is None:
            why = self.variables.why_unknown(self.source, value)
            raise self.source.line_error(f"the target is not known: {why}", line, RUN_TIME_ADVICE)
        return Operand(position, value.start, value.stop, name), end

    def _angle(self, line: int, start: int, stop: int) -> tuple[float, int]:
        value, end = parse(self.source, start, stop)
        angle = self.variables.number(self.source, value)
        if angle is None or angle == 0.0:
            raise self.source.line_error("the circular angle CA is not a number other than 0", line)
        return angle, end

    def _check(self, line: int, word: str, kind: int, end: Operand, via: Operand | None) -> None:
        if kind != PTP and (end.position.axis or (via and via.position.axis)):
            raise self.source.line_error(f"{word} to axis angles", line, "Write a Cartesian target, or use PTP.")
        if kind == CIRC and any(value != value for p in (end, via) if p for value in p.position.values[:3]):
            raise self.source.line_error(f"{word} needs X, Y and Z of both points", line)

    def _tail(self, line: int, kind: int, start: int, stop: int) -> tuple[State, bool]:
        """Return the state, and whether `$APO.CDIS` applies, after reading what follows the points."""
        text, state = self.source.text, self.settings.state
        approximation = _APPROXIMATION.search(text, start, stop)
        end = approximation.start() if approximation else stop
        words = text[end:stop].upper()
        if match := _WITH.match(text, start, end):
            state = self._with(line, state, match.end(), end)
        elif text[start:end].strip():
            raise self.source.line_error(f"{text[start:end].strip()!r} is not understood", line)
        return state, "C_DIS" in words or ("C_SPL" in words and kind != PTP)

    def _with(self, line: int, state: State, start: int, stop: int) -> State:
        """Return the state for this motion alone: ``WITH $VEL=…, $TOOL=…``."""
        for begin, end in split(self.source, start, stop):
            target, position = operand(self.source, begin, end)
            if not isinstance(target, Reference) or self.source.text[position:end].lstrip()[:1] != "=":
                raise self.source.line_error(f"{self.source.text[begin:end].strip()!r} is not understood", line)
            if target.name in RELEVANT:
                equals = self.source.text.index("=", position)
                state = self.settings.assigned(state, line, target, parse(self.source, equals + 1, end)[0])
            elif not _NO_EFFECT.match(target.name):
                raise self.source.line_error(f"{target.name} in WITH is not understood", line)
        return state
