"""Plain assignments to system variables: ``$VEL.CP=0.05`` before each of a hundred thousand motions.

As for motions (`plain_lines`), one expression is the fence; what it leaves out is read statement by statement
(`interpreter`, `path_settings`), and so could plain assignments be. It accepts valid numbers, TRUE and FALSE.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read.path_settings import FASTEST, turn_speed
from postproc.dialects.krl.read.state import TURN_SPEEDS
from postproc.frames import M_PER_MM, Array
from postproc.program import Ints

_NUMBER = r"[0-9]{1,6}+(?:\.[0-9]{0,9}+)?"
# variables on whose value motions depend, and others without effect on motion; possessive quantifiers, for one pass
_SETTING = re.compile(
    rf"""\$(?:
    (?P<name>VEL\.(?:CP|ORI[12]) | APO\.CDIS)[ \t]*+=[ \t]*+(?P<number>{_NUMBER})
    | (?:APO\.(?:CVEL|CPTP|CORI) | ACC\.(?:CP|ORI[12]))[ \t]*+=[ \t]*+{_NUMBER}
    | (?:OUT|ANOUT|VEL_AXIS|ACC_AXIS)\[[0-9]{{1,4}}+\][ \t]*+=[ \t]*+(?:TRUE | FALSE | {_NUMBER})
    )[ \t]*+(?:;[^\r\n]*+)?[\r\n]""",
    re.ASCII | re.IGNORECASE | re.VERBOSE,
)
NUMBERS = ("speed", "cdis", *TURN_SPEEDS)
"""Fields of the `State` that plain assignments set, in the order of their rows in `PlainSettings.values`."""
_ROW_OF_VARIABLE = {"VEL.CP": 0, "APO.CDIS": 1, "VEL.ORI1": 2, "VEL.ORI2": 3}
"""Variable → index in `NUMBERS` of the field that it sets."""


class PlainSettings(Struct, frozen=True, eq=False):
    """S plain assignments.

    :param line: (S,) lines of the assignments, from 1, ascending.
    :param values: (4, S) value that each assignment gives each of the `NUMBERS`, in the unit of the `State`; NaN: none.
    """

    line: Ints
    values: Array

    def assigned_values(self, row: int) -> tuple[Ints, Array]:
        """Return the lines (G,) with assignments to one of the `NUMBERS`, and the assigned values (G,).

        :param row: index of the field in `NUMBERS`.
        """
        is_assigned = ~np.isnan(self.values[row])
        return self.line[is_assigned], self.values[row, is_assigned]


def no_settings() -> PlainSettings:
    """Return `PlainSettings` without an assignment."""
    return PlainSettings(np.zeros(0, dtype=np.int64), np.zeros((len(NUMBERS), 0)))


def scan(source: Source) -> PlainSettings:
    """Return all plain assignments of a file, in order."""
    text = source.text
    starts, names, numbers = [], [], []
    for match in _SETTING.finditer(text):
        starts.append(match.start())
        names.append(match["name"])
        numbers.append(match["number"])
    if not starts:
        return no_settings()
    offsets = np.array(starts)
    line = np.searchsorted(source.starts, offsets, side="right")  # lines that begin at or before each offset
    begin = source.starts[line - 1]
    values = np.full((len(NUMBERS), len(starts)), np.nan)
    is_plain_line = np.ones(len(starts), dtype=bool)
    for index, (name, number) in enumerate(zip(names, numbers, strict=True)):
        if name is not None:
            row, value = _ROW_OF_VARIABLE[name.upper()], float(number)
            values[row, index] = _value_in_state_unit(row, value)
            is_plain_line[index] = row != 0 or 0.0 < value <= FASTEST  # other speeds are refused as statements
    for index in np.flatnonzero(begin != offsets).tolist():  # only blanks may precede the assignment
        is_plain_line[index] &= not text[begin[index] : starts[index]].strip(" \t")
    return PlainSettings(line[is_plain_line], values[:, is_plain_line])


def _value_in_state_unit(row: int, number: float) -> float:
    """Return a number of the text [m/s, mm, deg/s] in the unit of the `State` [m/s, m, rad/s].

    :param row: index in `NUMBERS` of the field that it sets.
    """
    if row == 0:
        return number
    return number * M_PER_MM if row == 1 else turn_speed(number)


def is_plain(source: Source, line: int) -> bool:
    """Return whether a line is a plain assignment, such as ``$OUT[1]=TRUE`` or ``$VEL.CP=0.1``."""
    start, _ = source.code_span(line)
    match = _SETTING.match(source.text, start)
    if match is None:
        return False
    is_speed = match["name"] is not None and match["name"].upper() == "VEL.CP"
    return not is_speed or 0.0 < float(match["number"]) <= FASTEST


class PlainAssignments:
    """Plain assignments that come into force while a program is followed.

    :param settings: the assignments that run, by rows of the trace.
    """

    def __init__(self, settings: PlainSettings) -> None:
        """Begin before the first assignment."""
        # for each of the `NUMBERS`: lines and values, the lines as a list, and the number of passed assignments
        self._assigned = [settings.assigned_values(row) for row in range(len(NUMBERS))]
        self._lines = [lines.tolist() for lines, _ in self._assigned]
        self._passed_counts = [0] * len(NUMBERS)
        self._is_finished = not any(self._lines)

    def values_before(self, line: int) -> list[tuple[int, str, float]]:
        """Return the assignments since the previous call that come into force before a line, and pass them.

        Only the first and the last assignment to each field are returned: motions between them get their values from
        `values_at`. At the lines of both, the latest values of the other fields are returned too.

        :returns: (line, field, value), by ascending lines.
        """
        if self._is_finished:
            return []
        # first index and the index after the last of the assignments to each field that are passed now
        spans = [
            (first, bisect_left(lines, line, first))
            for first, lines in zip(self._passed_counts, self._lines, strict=True)
        ]
        assignments = self._latest_assignments(spans)
        self._passed_counts = [stop for _, stop in spans]
        self._is_finished = all(
            stop == len(lines) for stop, lines in zip(self._passed_counts, self._lines, strict=True)
        )
        return assignments

    def _latest_assignments(self, spans: Sequence[tuple[int, int]]) -> list[tuple[int, str, float]]:
        """Return the latest assignments at the lines of the first and the last assignment of each span.

        :param spans: for each of `NUMBERS`, first index and the index after the last of its assignments.
        :returns: (line, field, value), by ascending lines.
        """
        lines_of_ends = {
            lines[index]
            for (first, stop), lines in zip(spans, self._lines, strict=True)
            if stop > first
            for index in (first, stop - 1)
        }
        assignments = []
        for line in sorted(lines_of_ends):
            for field_index, (first, stop) in enumerate(spans):
                latest = bisect_right(self._lines[field_index], line, first, stop) - 1
                if latest >= first:
                    _, values = self._assigned[field_index]
                    assignments.append((line, NUMBERS[field_index], float(values[latest])))
        return assignments

    def insert(self, settings: PlainSettings) -> None:
        """Add assignments, whose lines must be behind all assignments that have been passed."""
        for row in range(len(NUMBERS)):
            new_lines, new_values = settings.assigned_values(row)
            if len(new_lines):
                lines, values = self._assigned[row]
                indices = np.searchsorted(lines, new_lines)  # keeps the order of lines
                all_lines = np.insert(lines, indices, new_lines)
                self._assigned[row] = all_lines, np.insert(values, indices, new_values)
                self._lines[row] = all_lines.tolist()
                self._is_finished = False

    def values_at(self, field_index: int, line: Ints, change_lines: Ints, state_values: Array) -> Array:
        """Return the values of one of the `NUMBERS` before n lines (n,).

        A plain assignment replaces the value of a state that came into force on an earlier line.

        :param field_index: index of the field in `NUMBERS`.
        :param line: (n,) the lines.
        :param change_lines: (n,) line after which the state in force at each of them holds.
        :param state_values: (n,) values of the field in these states.
        """
        lines, values = self._assigned[field_index]
        if not len(lines):
            return state_values
        previous = np.searchsorted(lines, line) - 1  # the last assignment before each line; −1: none
        return np.where((previous >= 0) & (lines[previous] > change_lines), values[previous], state_values)
