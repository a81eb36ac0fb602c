"""Canned cycles G73, G81 to G86, G89: the moves of a hole, by the rules of LinuxCNC (`interp_cycles.cc`).

R, Z, P and Q are modal until the cycle ends. After a change between G90 and G91, R and Z must be given again: LinuxCNC
keeps the numbers, and the hole is at another height. In G91, R is relative to the initial level and Z to R. The initial
level is the height before the first cycle of a series; G98 retracts to it, G99 to R. A tool below R first goes up to R.
After each peck, G73 and G83 return to 0.254 mm (0.010 inch) above the last depth. G84 reverses the spindle at the
bottom, G86 stops it there.

Without G98 or G99 holes return to the initial level, the higher of the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from msgspec import Struct

from postproc.dialects.gcode.words import BlockError
from postproc.program import EventKind

_CLEARANCE_MM = 0.254
"""Distance above the last depth of a peck drill, 0.010 inch, as LinuxCNC drives G83."""
_MOST_PECKS = 10_000
"""A hole with more is a mistake in a number: at 0.1 mm a peck it would be 1 m deep."""
_MODES = ("G90", "G91")
_NEEDED_WORDS: Mapping[float, str] = {73.0: "Q", 82.0: "P", 83.0: "Q", 86.0: "P", 89.0: "P"}
DWELLING = (82.0, 84.0, 86.0, 89.0)
"""Cycles that wait at the bottom, for the time P."""

Point = tuple[float, float, float]


class Step(Struct, frozen=True):
    """A move of a cycle.

    :param code: 0 for a rapid, 1 for a move at feed.
    :param end: its end in the plane and across it [mm].
    :param is_in_hole: whether it begins or ends in the hole, where the tool reverses: its end must not be rounded.
    """

    code: float
    end: Point
    is_in_hole: bool = False


class CycleEvent(Struct, frozen=True):
    """An event of a cycle: a dwell, or a change of the spindle.

    :param step_count: number of moves of the cycle that precede it.
    :param value: time of a dwell [s].
    """

    step_count: int
    kind: EventKind
    value: float = 0.0


class CycleMoves(NamedTuple):
    """Moves of the holes of a line, and the events between them."""

    steps: list[Step]
    events: list[CycleEvent]


class Cycle:
    """The modal words of a cycle, and the initial level.

    :ivar code: number of the G code; 0: no cycle is active.
    :ivar level: height before the first cycle of the series [mm]; None: no cycle is active.
    :ivar words: letter → number: Z and R in mm as programmed, P in s, Q in mm.
    :ivar is_relative: letter → whether it was given in G91.
    :ivar lifts_to_r: whether the tool first goes up to R.
    """

    def __init__(self) -> None:
        self.code = 0.0
        self.words: dict[str, float] = {}
        self.is_relative: dict[str, bool] = {}
        self.level: float | None = None
        self.lifts_to_r = False

    def end(self) -> None:
        """End a series of cycles."""
        self.code, self.level = 0.0, None
        self.words.clear()

    def hole_moves(
        self,
        code: float,
        line_words: Mapping[str, float],
        position: Point,
        spindle: EventKind,
        *,
        relative: bool,
        retracts_to_r: bool,
    ) -> CycleMoves:
        """Return the moves of the holes of a line, and the events between them.

        :param code: number of the G code of the cycle.
        :param line_words: words of the line: U and V in the plane, Z across it, R, Q [mm], P, L. L0 states the hole for
            the lines that follow and drills none (Fanuc and Haas; LinuxCNC refuses it).
        :param position: position of the tool before, in the plane and across it [mm].
        :param spindle: state of the spindle before the cycle.
        :param relative: whether G91 is active.
        :param retracts_to_r: whether G99 is active: the tool retracts to the R plane, not to the initial level.
        :returns: no moves for L0.
        :raises BlockError: a word is missing, or impossible.
        """
        self._keep_words(code, line_words, relative)
        u, v, height = position
        self.level = height if self.level is None else self.level
        repeats = _repeats(line_words)
        if repeats == 0:
            _check_undrilled_position(line_words, (0.0, 0.0) if relative else (u, v))
            return CycleMoves([], [])
        r, z = self._heights(self.level if relative else None)
        steps: list[Step] = []
        events: list[CycleEvent] = []
        self.lifts_to_r = self.level < r
        if self.lifts_to_r:
            steps.append(Step(0.0, (u, v, r)))
            height = r
        clear_height = r if retracts_to_r else max(self.level, r)
        for hole_number in range(repeats):
            u, v = (
                coordinate + line_words.get(name, 0.0) if relative else line_words.get(name, coordinate)
                for name, coordinate in zip("UV", (u, v), strict=True)
            )
            # the tool goes to the first hole at its present height, to the others at that of the retract
            start = height if hole_number == 0 and height > r else clear_height
            steps.append(Step(0.0, (u, v, start)))
            if start > r:
                steps.append(Step(0.0, (u, v, r)))
            self._add_descent((u, v, z), r, steps)
            self._add_retract((u, v, clear_height), r, steps, events, spindle)
        return CycleMoves(steps, events)

    def _keep_words(self, code: float, line_words: Mapping[str, float], relative: bool) -> None:
        """Add the words Z, R, P and Q of a line to the modal words; a change of the cycle clears them first.

        :param code: number of the G code of the cycle; `line_words`: words of the line by letter.
        :param relative: whether G91 is active.
        :raises BlockError: a word that the cycle needs is missing, or R or Z was given in G90 and G91 is active, or the
            reverse.
        """
        if code != self.code:
            self.words.clear()
            self.code = code
        self.words.update({letter: line_words[letter] for letter in "ZRPQ" if letter in line_words})
        self.is_relative.update(dict.fromkeys(line_words, relative))
        missing_letters = [
            letter for letter in ("Z", "R", *_NEEDED_WORDS.get(self.code, "")) if letter not in self.words
        ]
        if missing_letters:
            raise BlockError(f"G{self.code:g} without {' and '.join(missing_letters)}", None)
        conflicts = [letter for letter in "RZ" if self.is_relative[letter] != relative]
        if conflicts:
            # a mode as an index of `_MODES`: False is G90, True is G91
            problem = (
                f"{' and '.join(conflicts)} of the cycle: given in {_MODES[not relative]}, used in {_MODES[relative]}"
            )
            raise BlockError(problem, "Give R and Z again after G90 or G91: controls differ in what they keep.")

    def _heights(self, level: float | None) -> tuple[float, float]:
        """Return the heights of the R plane and of the bottom of the hole [mm].

        :param level: height that R counts from after G91, and Z from R; None: both are coordinates.
        :raises BlockError: the R plane is below the bottom.
        """
        r, z = self.words["R"], self.words["Z"]
        if level is not None:
            r, z = r + level, r + level + z
        if r < z:
            raise BlockError(
                f"R of the cycle ({r:.4f} mm) is below the bottom of the hole ({z:.4f} mm)", "Check R and Z."
            )
        return r, z

    def _add_descent(self, bottom: Point, r: float, steps: list[Step]) -> None:
        """Append to `steps` the moves from the R plane to the bottom.

        G73 and G83 drill in pecks of depth Q: G83 goes up to the R plane after each, G73 only by `_CLEARANCE_MM`.

        :param bottom: end of the descent, in the plane and across it [mm]; `r`: height of the R plane [mm].
        :raises BlockError: the depth of a peck is not above zero, or needs too many pecks.
        """
        u, v, z = bottom
        if self.code in (73.0, 83.0):
            peck = self.words["Q"]
            if peck <= 0.0 or (r - z) / peck > _MOST_PECKS:
                raise BlockError(f"Q{peck:g} mm is not a valid depth of a peck", None)
            depth = r - peck
            while depth > z:
                retract_height = depth + _CLEARANCE_MM
                steps.append(Step(1.0, (u, v, depth), is_in_hole=True))
                if self.code == 83.0:
                    steps.append(Step(0.0, (u, v, r), is_in_hole=True))
                steps.append(Step(0.0, (u, v, retract_height), is_in_hole=True))
                depth -= peck
        steps.append(Step(1.0, bottom, is_in_hole=True))

    def _add_retract(
        self, clear_point: Point, r: float, steps: list[Step], cycle_events: list[CycleEvent], spindle: EventKind
    ) -> None:
        """Append to `steps` the retract from the bottom, and to `cycle_events` the dwell and the spindle changes.

        G84: the spindle reverses at the bottom, the tool retracts at feed, and the spindle turns clockwise again.
        G86: the spindle stops at the bottom, the tool retracts in rapid, and the spindle turns as before.
        G85: the tool retracts at feed to the R plane, then in rapid. G89: it retracts at feed. Others: in rapid.

        :param clear_point: end of the retract, in the plane and across it [mm]; `r`: height of the R plane [mm].
        :param spindle: state of the spindle before the cycle.
        :raises BlockError: the spindle does not turn as the cycle needs it.
        """
        step_count, dwell = len(steps), self.words.get("P", 0.0)
        wait = [CycleEvent(step_count, "dwell", dwell)] if self.code in DWELLING and dwell > 0.0 else []
        if self.code == 84.0:
            if spindle != "spindle_on":
                raise BlockError("G84 with a spindle that does not turn clockwise", "Start it with M3 before.")
            cycle_events += [CycleEvent(step_count, "spindle_off"), CycleEvent(step_count, "spindle_ccw"), *wait]
            steps.append(Step(1.0, clear_point, is_in_hole=True))
            cycle_events += [CycleEvent(step_count + 1, "spindle_off"), CycleEvent(step_count + 1, "spindle_on")]
        elif self.code == 86.0:
            if spindle == "spindle_off":
                raise BlockError("G86 with a spindle that does not turn", "Start it with M3 before.")
            cycle_events += [*wait, CycleEvent(step_count, "spindle_off")]
            steps.append(Step(0.0, clear_point))
            cycle_events.append(CycleEvent(step_count + 1, spindle))
        elif self.code == 85.0:
            steps += [Step(1.0, (clear_point[0], clear_point[1], r)), Step(0.0, clear_point)]
        else:
            cycle_events += wait
            steps.append(Step(1.0 if self.code == 89.0 else 0.0, clear_point))


def _repeats(line_words: Mapping[str, float]) -> int:
    """Return the number of holes of a line with a cycle: its L, or 1.

    :param line_words: words of the line by letter.
    :raises BlockError: L is negative or not a whole number.
    """
    repeats = line_words.get("L", 1.0)
    if repeats < 0.0 or repeats != round(repeats):
        raise BlockError(f"L{repeats:g} of a cycle is not a number of holes", None)
    return round(repeats)


def _check_undrilled_position(line_words: Mapping[str, float], resting_words: tuple[float, float]) -> None:
    """Check that a line without a hole (L0) has no word U or V that would move the tool.

    :param line_words: words of the line by letter.
    :param resting_words: the words U and V that leave the tool where it is [mm].
    :raises BlockError: U or V of the line has another value.
    """
    if any(line_words.get(letter, word) != word for letter, word in zip("UV", resting_words, strict=True)):
        advice = "Controls differ in whether the tool goes there: program the place in a block before, by G0."
        raise BlockError("L0 of a cycle at another place than the tool is", advice)
