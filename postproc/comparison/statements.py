"""Statements between motions that switch, wait, or set accelerations and loads, compared between two KRL programs.

They do not change the path that is simulated, and still decide what is made: a spindle that is not on, a wait that is
gone, a `$LOAD` by which the controller no longer knows what it carries.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from postproc.comparison.result import Comparison, Difference, place_of
from postproc.program import Ints, Program

_STATEMENT_WORDS = re.compile(
    r"\$(?:OUT|ANOUT|CYCFLAG|FLAG|ACC|ACC_AXIS|ACC_CAR|LOAD|LOAD_A\d|VEL\.ORI\d|VEL_AXIS|VEL_CAR|APO\.(?:CVEL|CORI|CPTP)"
    r"|JERK|GEAR_JERK|IPO_MODE|ADVANCE|OV_PRO|TIMER_STOP)\b|(?:WAIT|HALT|PULSE|ANOUT|TRIGGER|INTERRUPT|BRAKE|CONTINUE"
    r"|SYN|EXIT|RETURN|RESUME)\b",
    re.IGNORECASE,
)
"""Statements that are compared; what frames, speeds and targets say is compared by value."""
_DISTANCE = re.compile(r"WHEN(?:DISTANCE|PATH)=.*?DO", re.IGNORECASE)
"""Where a TRIGGER acts: the correction keeps it in place on a path that it divides."""
_LOOP_BEGIN = re.compile(r"(?:FOR|WHILE|LOOP|REPEAT)\b", re.IGNORECASE)
_LOOP_END = re.compile(r"(?:ENDFOR|ENDWHILE|ENDLOOP|UNTIL)\b", re.IGNORECASE)
_ROUTINE = re.compile(r"(?:GLOBAL\s+)?DEF(?:FCT)?\b", re.IGNORECASE)
_END = re.compile(r"END(?:FCT)?\b", re.IGNORECASE)
_MAX_STATEMENTS = 20
"""Largest number of statements that are listed (assumed); others are counted together."""

Statement = tuple[str, int]
"""A statement without blanks, in capitals, and its 1-based line."""
_Occurrences = dict[tuple[str, bool], list[tuple[int, int]]]
"""Places of statements that one program has, by text and whether it is the second: next pair, and 1-based line."""


class _Texts:
    """The lines of a program's files without comments, by name of the file."""

    def __init__(self, program: Program) -> None:
        """Split the files of a program into lines."""
        self.program = program
        self.lines = {document.name: document.text.splitlines() for document in program.documents}

    def statements_between(self, start: tuple[str, int], end: tuple[str, int]) -> list[Statement] | None:
        """Return the compared statements from a motion to the next one.

        If the next motion is above in the text, a loop leads back to it. The statements are then those down to the end
        of the loop, and those from its begin to the next motion.

        :param start: file and 1-based line of the motion, `end` of the next one.
        :returns: None where the motions are in different files, or no loop is around them.
        """
        (file, start_line), (end_file, end_line) = start, end
        if file != end_file or file not in self.lines:
            return None
        if start_line < end_line:
            return self._compared_statements(file, range(start_line + 1, end_line))
        lines_after_start, lines_before_end = (
            range(start_line + 1, len(self.lines[file]) + 1),
            range(end_line - 1, 0, -1),
        )
        loop_end = self._loop_bound(file, lines_after_start, opens=_LOOP_BEGIN, closes=_LOOP_END)
        loop_begin = self._loop_bound(file, lines_before_end, opens=_LOOP_END, closes=_LOOP_BEGIN)
        if loop_end is None or loop_begin is None:
            return None
        return [
            *self._compared_statements(file, range(start_line + 1, loop_end)),
            *self._compared_statements(file, range(loop_begin + 1, end_line)),
        ]

    def routine_limits(self, place: tuple[str, int]) -> tuple[tuple[str, int], tuple[str, int]]:
        """Return the places of the first and the last line of the routine around a motion, DEF and END.

        :param place: file and 1-based line of the motion; the begin and the end of the file count without a DEF or END.
        """
        file, line = place
        lines = self.lines.get(file, [])
        preceding_lines, following_lines = range(line - 1, 0, -1), range(line + 1, len(lines) + 1)
        first = next((n for n in preceding_lines if _ROUTINE.match(self.statement(file, n))), 0)
        last = next((n for n in following_lines if _END.match(self.statement(file, n))), len(lines) + 1)
        return (file, first), (file, last)

    def _loop_bound(self, file: str, numbers: range, *, opens: re.Pattern[str], closes: re.Pattern[str]) -> int | None:
        """Return the line where the loop around the first of these lines begins or ends; None without such a loop.

        :param numbers: line numbers, in the direction of the search.
        :param opens: statement at which a nested loop starts in this direction; `closes`: at which a loop is over.
        """
        depth = 0
        for number in numbers:
            text = self.statement(file, number)
            if closes.match(text):
                if depth == 0:
                    return number
                depth -= 1
            elif opens.match(text):
                depth += 1
        return None

    def statement(self, file: str, number: int) -> str:
        """Return the text of a line, `number` from 1 on, without its comment."""
        return self.lines[file][number - 1].partition(";")[0].strip()

    def _compared_statements(self, file: str, numbers: range) -> list[Statement]:
        """Return the statements that are compared on these lines of a file."""
        texts = ((self.statement(file, number), number) for number in numbers)
        return [(_normal_text(text), number) for text, number in texts if _STATEMENT_WORDS.match(text)]


def _normal_text(text: str) -> str:
    """Return a statement without blanks and in capitals, and a TRIGGER without the place where it acts."""
    return _DISTANCE.sub("DO", "".join(text.split()).upper())


def statement_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield a warning for each statement that is between the same motions in one of two KRL programs only.

    Nothing is yielded for other dialects.
    """
    programs = comparison.nominal, comparison.corrected
    if any(program.dialect != "krl" or not program.keeps_text for program in programs) or not len(comparison.pair):
        return
    nominal_texts, corrected_texts = (_Texts(program) for program in programs)
    nominal_places = _places_of_motions(nominal_texts, comparison.pair[:, 0])
    corrected_places = _places_of_motions(corrected_texts, comparison.pair[:, 1])
    occurrences: _Occurrences = {}
    for k in range(len(comparison.pair) + 1):
        first = nominal_texts.statements_between(*nominal_places[k : k + 2])
        second = corrected_texts.statements_between(*corrected_places[k : k + 2])
        if first is None or second is None or [text for text, _ in first] == [text for text, _ in second]:
            continue
        next_pair = min(k, len(comparison.pair) - 1)  # statements after the last motion are reported at it
        for statement in _unmatched_statements(first, second):
            places = occurrences.setdefault((statement.text, statement.is_in_second), [])
            places.append((next_pair, statement.line))
    yield from _list_differences(comparison, occurrences, nominal_texts, corrected_texts)


def _places_of_motions(texts: _Texts, rows: Ints) -> list[tuple[str, int]]:
    """Return file and line of motions (n,) of a program, n > 0.

    The list begins with the DEF of the first motion's routine, and ends with the END of the last one's.
    """
    places = texts.program.places(rows)
    motions = [(places.files[int(file)], int(line)) for file, line in zip(places.file, places.line, strict=True)]
    routine_begin, _ = texts.routine_limits(motions[0])
    _, routine_end = texts.routine_limits(motions[-1])
    return [routine_begin, *motions, routine_end]


class _UnmatchedStatement(NamedTuple):
    """A statement that only one of two programs has at a place.

    :param text: without blanks, in capitals.
    :param line: its line, from 1 on.
    :param is_in_second: True if the second program has it.
    """

    text: str
    line: int
    is_in_second: bool


def _unmatched_statements(first: Sequence[Statement], second: Sequence[Statement]) -> Iterator[_UnmatchedStatement]:
    """Yield the statements that only one of two sequences has; if only their order differs, all of the second."""
    first_counts, second_counts = (Counter(text for text, _ in statements) for statements in (first, second))
    if first_counts == second_counts:
        yield from (_UnmatchedStatement(text, line, is_in_second=True) for text, line in second)
        return
    sides = ((False, first, first_counts - second_counts), (True, second, second_counts - first_counts))
    for is_in_second, statements, surplus_counts in sides:
        for text, line in statements:
            if surplus_counts[text] > 0:
                surplus_counts[text] -= 1
                yield _UnmatchedStatement(text, line, is_in_second)


def _list_differences(
    comparison: Comparison, occurrences: _Occurrences, nominal_texts: _Texts, corrected_texts: _Texts
) -> Iterator[Difference]:
    """Yield a warning for each text of a statement that only one program has, at its first place.

    Beyond `_MAX_STATEMENTS` texts, one warning gives the number of the others.
    """
    order = sorted(occurrences.items(), key=lambda entry: entry[1][0])
    for (_, is_in_second), places in order[:_MAX_STATEMENTS]:
        pair, line = places[0]
        nominal_row, corrected_row = comparison.pair[pair]
        nominal_place = place_of(comparison.nominal, nominal_row)
        corrected_place = place_of(comparison.corrected, corrected_row)
        # in the program that has it, the place is the line of the statement; in the other one, that of the motion
        if is_in_second:
            corrected_place = corrected_place[0], line
            text = corrected_texts.statement(*corrected_place)
        else:
            nominal_place = nominal_place[0], line
            text = nominal_texts.statement(*nominal_place)
        program_name = "second" if is_in_second else "nominal"
        message = f"{text} is at this place in the {program_name} program only: it switches, waits or drives otherwise."
        yield Difference("warning", "statement", message, nominal_place, corrected_place, len(places))
    unlisted_entries = order[_MAX_STATEMENTS:]
    if unlisted_entries:
        count = int(np.sum([len(places) for _, places in unlisted_entries]))
        message = f"{len(unlisted_entries)} other statements that switch, wait or set accelerations differ."
        yield Difference("warning", "statement", message, count=count)
