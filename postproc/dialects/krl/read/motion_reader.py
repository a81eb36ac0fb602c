"""Motion statements one by one: what is not read as a plain line."""

from __future__ import annotations

import re

from msgspec.structs import replace

from postproc.dialects.krl.language.brackets import split
from postproc.dialects.krl.language.expressions import operand, parse
from postproc.dialects.krl.language.motion_statements import MotionStatement, Point
from postproc.dialects.krl.language.positions import FARTHEST, NotANumberError, Position
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.values import Reference
from postproc.dialects.krl.read.explanations import why_unknown
from postproc.dialects.krl.read.frames import out_of_reach
from postproc.dialects.krl.read.inexact import unresolved
from postproc.dialects.krl.read.known import NOTHING
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.state import RELEVANT, State, fields_used
from postproc.errors import ProgramError
from postproc.program import CIRC, LIN, PTP, SPL

KINDS = {"LIN": LIN, "SLIN": LIN, "PTP": PTP, "SPTP": PTP, "CIRC": CIRC, "SCIRC": CIRC, "SPL": SPL}
_APPROXIMATION = re.compile(r"(?:[ \t]*\bC_(?:DIS|VEL|ORI|PTP|SPL)\b)*[ \t]*$", re.IGNORECASE)
_ANGLE = re.compile(r"[ \t]*,[ \t]*CA\b[ \t]*=?", re.IGNORECASE)
_COMMA = re.compile(r"[ \t]*,")
_REFERENCE_FRAME = re.compile(r"[ \t]*(#BASE|#TOOL)\b", re.IGNORECASE)
_REFERENCE_FRAME_BEHIND = re.compile(r"\bC_\w+[ \t]*((#BASE|#TOOL)[ \t]*)$", re.IGNORECASE)
_WITH = re.compile(r"[ \t]*WITH\b", re.IGNORECASE)
_NO_EFFECT = re.compile(
    r"\$(?:LOAD|ACC|VEL_AXIS|VEL_EXTAX|JERK|GEAR_JERK|ECO_LEVEL|COLLMON|TORQMON|SPL_VEL_)", re.IGNORECASE
)
_HERE = frozenset({"$POS_ACT", "$POS_ACT_MES", "$AXIS_ACT", "$AXIS_ACT_MEAS"})
_HOME = frozenset({"XHOME", "HOME", "$H_POS"})
RUN_TIME_ADVICE = (
    "Targets must be known before the program runs: write them as numbers or as points of the .dat, or leave such "
    "motions as they are by --keep-unresolved."
)


class MotionReader:
    """Reads motion statements.

    :ivar home_used: line of the first motion to a home position that only the cell knows; 0 if there is none.
    """

    def __init__(self, settings: Settings, home: tuple[float, ...]) -> None:
        self.settings, self.variables = settings, settings.variables
        self.home = home
        self.home_used = 0

    def read(self, at: Place, word: str, start: int, stop: int) -> tuple[MotionStatement | None, State, list[int]]:
        """Return the motion of a statement, or None where it only asks for the present position, and what it names.

        :param word: instruction, upper case.
        :param start: offset of the instruction.
        :param stop: offset behind the code of the line.
        :returns: the motion; what is in force for it; offsets of the names whose values it uses.
        :raises ProgramError: it is not understood, or its target is not known before the program runs.
        """
        text, name = at.source.text, word.removesuffix("_REL")
        kind, relative = KINDS[name], "#BASE" if word != name else ""
        names: list[int] = []
        via = angle = behind = None
        position = start + len(word)
        if kind == CIRC:
            via, position = self._operand(at, position, stop, names)
            comma = _COMMA.match(text, position, stop)
            if not via or not comma:
                raise at.error(f"{word} needs an auxiliary point and an end point")
            position = comma.end()
        if self.stays(at, word, start, stop):
            return None, self.settings.state, names
        end, position = self._operand(at, position, stop, names)
        if end is None:
            problem = f"{word}: the target is not known: it is where the robot stands"
            raise unresolved(at.error(problem, RUN_TIME_ADVICE))
        if kind == CIRC and (match := _ANGLE.match(text, position, stop)):
            angle, position = self._angle(at, match.end(), stop)
        code = stop
        if relative:
            if match := _REFERENCE_FRAME.match(text, position, stop):
                relative, position = match[1].upper(), match.end()
            elif match := _REFERENCE_FRAME_BEHIND.search(text, position, stop):
                relative, behind, code = match[2].upper(), match.span(1), match.start(1)
        state, approximated = self._tail(at, kind, position, code)
        self._check(at, word, kind, end, via)
        try:
            self.settings.refuse_uncertain(state, fields_used(kind, axis=end.position.axis, approximated=approximated))
        except ProgramError as cause:
            raise unresolved(cause) from None
        keyword = (start, start + len(word))
        return (
            MotionStatement(at.line, kind, keyword, end, relative, via, angle, position, code, approximated, behind),
            state,
            names,
        )

    def block(self, at: Place, word: str, start: int, stop: int) -> State:
        """Return what is in force within a spline block: what it is given by WITH, for itself alone.

        :param word: ``SPLINE`` or ``PTP_SPLINE``.
        :param start: offset behind it.
        :param stop: offset behind the code of the line.
        :raises ProgramError: it is not understood.
        """
        state, _ = self._tail(at, LIN, start, stop)
        return replace(state, block=word)

    def stays(self, at: Place, word: str, start: int, stop: int) -> bool:
        """Return whether a motion leads to where the robot is: ``PTP $POS_ACT``, ``LIN $POS_ACT``.

        :param word: instruction, upper case.
        :param start: offset of the instruction.
        :param stop: offset behind the code of the line.
        """
        if KINDS.get(word, CIRC) == CIRC:
            return False
        value, _ = parse(at.source, start + len(word), stop)
        return isinstance(value, Reference) and value.name in _HERE and value.field is None

    def _operand(self, at: Place, start: int, stop: int, names: list[int]) -> tuple[Point | None, int]:
        """Return a point and the offset behind it; None for the present position."""
        source = at.source
        value, end = parse(source, start, stop)
        name = ""
        if isinstance(value, Reference):
            self.variables.check_name(source, value)
            if value.name in _HERE:
                return None, end
            name = value.name
            names.append(value.start)
        self.variables.rely(source, value)
        try:
            position = self.variables.position(source, value)
        except NotANumberError as cause:
            raise unresolved(cause) from None
        if position is None and name in _HOME and self.variables.evaluate(source, value) == NOTHING:
            self.home_used = self.home_used or at.line
            position = Position(self.home, axis=True)
        if position is None:
            why = why_unknown(self.variables, source, value)
            raise unresolved(at.error(f"the target is not known: {why}", RUN_TIME_ADVICE))
        if position.farthest > FARTHEST:
            raise out_of_reach(at, position.farthest)
        return Point(position, value.start, value.stop, name), end

    def _angle(self, at: Place, start: int, stop: int) -> tuple[float, int]:
        value, end = parse(at.source, start, stop)
        angle = self.variables.number(at.source, value)
        if angle is None or not 0.0 < abs(angle) <= FARTHEST:
            raise at.error("the circular angle CA is not a number of degrees other than 0")
        return angle, end

    def _check(self, at: Place, word: str, kind: int, end: Point, via: Point | None) -> None:
        if kind != PTP and (end.position.axis or (via and via.position.axis)):
            raise at.error(f"{word} to axis angles", "Write a Cartesian target, or use PTP.")

    def _tail(self, at: Place, kind: int, start: int, stop: int) -> tuple[State, bool]:
        """Return the state, and whether `$APO.CDIS` applies, after reading what follows the points."""
        text, state = at.source.text, self.settings.state
        approximation = _APPROXIMATION.search(text, start, stop)
        end = approximation.start() if approximation else stop
        words = text[end:stop].upper()
        if match := _WITH.match(text, start, end):
            state = self._with(at, state, match.end(), end)
        elif text[start:end].strip():
            raise at.error(f"{text[start:end].strip()!r} is not understood")
        return state, "C_DIS" in words or ("C_SPL" in words and kind != PTP)

    def _with(self, at: Place, state: State, start: int, stop: int) -> State:
        """Return the state for this motion alone: ``WITH $VEL=…, $TOOL=…``."""
        for begin, end in split(at.source, start, stop):
            target, position = operand(at.source, begin, end)
            if not isinstance(target, Reference) or at.source.text[position:end].lstrip()[:1] != "=":
                raise at.error(f"{at.source.text[begin:end].strip()!r} is not understood")
            if target.name in RELEVANT:
                equals = at.source.text.index("=", position)
                state = self.settings.assigned(state, at, target, parse(at.source, equals + 1, end)[0])
            elif not _NO_EFFECT.match(target.name):
                raise at.error(f"{target.name} in WITH is not understood")
        return state
