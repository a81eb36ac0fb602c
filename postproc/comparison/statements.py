"""Statements between motions that switch, wait, or set accelerations and loads, compared between two KRL programs.

They do not change the path that is simulated, and still decide what is made: a spindle that is not on, a wait that is
gone, a `$LOAD` by which the controller no longer knows what it carries.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence

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


class _Texts:
    """The lines of a program's files without comments, by name of the file."""

    def __init__(self, program: Program) -> None:
        """Split the files of a program into lines."""
        self.program = program
        self.lines = {document.name: document.text.splitlines() for document in program.documents}

    def statements_between(self, start: tuple[str, int], end: tuple[str, int]) -> list[Statement] | None:
        """Return the compared statements from a motion to the next one; None where they are in different files.

        From the end of a loop to its begin where the next motion is not behind.
        """
        if start[0] != end[0] or start[0] not in self.lines:
            return None
        if start[1] < end[1]:
            return self._compared_statements(start[0], range(start[1] + 1, end[1]))
        tail = self._loop_bound(start[0], range(start[1] + 1, len(self.lines[start[0]]) + 1), _LOOP_BEGIN, _LOOP_END)
        head = self._loop_bound(end[0], range(end[1] - 1, 0, -1), _LOOP_END, _LOOP_BEGIN)
        if tail is None or head is None:
            return None
        return [
            *self._compared_statements(start[0], range(start[1] + 1, tail)),
            *self._compared_statements(end[0], range(head + 1, end[1])),
        ]

    def routine(self, place: tuple[str, int]) -> tuple[tuple[str, int], tuple[str, int]]:
        """Return the places of the first and the last line of the routine around a motion, DEF and END.

        :param place: file and 1-based line of the motion; the begin and the end of the file count without a DEF or END.
        """
        file, line = place
        lines = self.lines.get(file, [])
        first = next((n for n in range(line - 1, 0, -1) if _ROUTINE.match(self.statement(file, n))), 0)
        last = next((n for n in range(line + 1, len(lines) + 1) if _END.match(self.statement(file, n))), len(lines) + 1)
        return (file, first), (file, last)

    def _loop_bound(self, file: str, numbers: range, opens: re.Pattern[str], closes: re.Pattern[str]) -> int | None:
        """Return the line of the begin or end of the loop that is around the first of these lines."""
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
    """Yield the statements that are between the same motions of one of two KRL programs only."""
    programs = comparison.nominal, comparison.corrected
    if any(program.dialect != "krl" or not program.keeps_text for program in programs) or not len(comparison.pair):
        return
    texts = [_Texts(program) for program in programs]
    motions = [_places_of_motions(program, rows) for program, rows in zip(programs, comparison.pair.T, strict=True)]
    occurrences: dict[tuple[str, bool], list[tuple[int, int]]] = {}
    for places, text in zip(motions, texts, strict=True):
        places.insert(0, text.routine(places[0])[0])
        places.append(text.routine(places[-1])[1])
    for k in range(len(comparison.pair) + 1):
        spans = [text.statements_between(*places[k : k + 2]) for text, places in zip(texts, motions, strict=True)]
        if spans[0] is None or spans[1] is None or [s for s, _ in spans[0]] == [s for s, _ in spans[1]]:
            continue
        for statement, line, in_second in _unmatched_statements(spans[0], spans[1]):
            occurrences.setdefault((statement, in_second), []).append((min(k, len(comparison.pair) - 1), line))
    yield from _list_differences(comparison, occurrences, texts)


def _places_of_motions(program: Program, rows: Ints) -> list[tuple[str, int]]:
    """Return file and line of motions `rows` (n,)."""
    places = program.places(rows)
    return [(places.files[int(file)], int(line)) for file, line in zip(places.file, places.line, strict=True)]


def _unmatched_statements(first: Sequence[Statement], second: Sequence[Statement]) -> Iterator[tuple[str, int, bool]]:
    """Yield statements of one side only, with their line and whether it is the second; of another order, all."""
    counts = [Counter(statement for statement, _ in side) for side in (first, second)]
    if counts[0] == counts[1]:
        yield from ((statement, line, True) for statement, line in second)
        return
    for in_second, side in enumerate((first, second)):
        surplus = counts[in_second] - counts[1 - in_second]
        for statement, line in side:
            if surplus[statement] > 0:
                surplus[statement] -= 1
                yield statement, line, bool(in_second)


def _list_differences(
    comparison: Comparison, occurrences: dict[tuple[str, bool], list[tuple[int, int]]], texts: Sequence[_Texts]
) -> Iterator[Difference]:
    """Yield the statements that only one program has, the first of each text; further ones as one count."""
    order = sorted(occurrences.items(), key=lambda entry: entry[1][0])
    for (_, in_second), places in order[:_MAX_STATEMENTS]:
        k, line = places[0]
        nominal_place, corrected_place = (
            place_of(program, row)
            for program, row in zip((comparison.nominal, comparison.corrected), comparison.pair[k], strict=True)
        )
        file = (corrected_place if in_second else nominal_place)[0]
        nominal_place, corrected_place = (nominal_place, (file, line)) if in_second else ((file, line), corrected_place)
        program_name = "second" if in_second else "nominal"
        text = texts[in_second].statement(file, line)
        message = f"{text} is at this place in the {program_name} program only: it switches, waits or drives otherwise."
        yield Difference("warning", "statement", message, nominal_place, corrected_place, len(places))
    unlisted_entries = order[_MAX_STATEMENTS:]
    if unlisted_entries:
        count = int(np.sum([len(places) for _, places in unlisted_entries]))
        message = f"{len(unlisted_entries)} other statements that switch, wait or set accelerations differ."
        yield Difference("warning", "statement", message, count=count)
