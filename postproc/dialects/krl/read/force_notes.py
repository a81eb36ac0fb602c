"""Force comments of KRL: where they stand, and which of them hold.

A comment holds until the next one, in the order in which lines run. A control structure or a called routine with one is
therefore followed as one that moves; behind what cannot be followed the force is not known until the next comment.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from postproc.dialects.krl.course import Course, Kept
from postproc.dialects.krl.language.source import Source, comment_start
from postproc.program import FORCE_COMMENT, Bools, ForceNote, Ints, parse_force_note

_FORCE = re.compile(f";(?:{FORCE_COMMENT.pattern})", re.IGNORECASE)
_ADVICE = "Write a force comment before this motion."


def noted_lines(source: Source) -> tuple[int, ...]:
    """Return the lines with a force comment, ascending."""
    return tuple(_places(source)[1].tolist())


def notes_of(course: Course, motions: Ints, rapid: Bools, unknown: Mapping[int, str]) -> list[tuple[int, ForceNote]]:
    """Return the force comments of a course that hold, by its lines.

    :param motions: (M,) lines of the course on which its motions stand.
    :param rapid: (M,) True for motions that carry no force.
    :param unknown: lines of the course from which on it is not known which force acts, and why.
    :raises ProgramError: that is so for a motion.
    :raises ForceError: a comment cannot be read.
    """
    source = course.source
    text = source.text
    places, lines = _places(source)
    if course.live is not None:
        places, lines = places[course.live[lines - 1]], lines[course.live[lines - 1]]
    unknown = dict(unknown)
    for step in course.steps:
        if isinstance(step, Kept):
            inside = (lines >= step.first) & (lines <= step.last)
            if inside.any():
                unknown[step.last] = (
                    f"a force comment stands in what stays as it is ({source.origin(int(lines[inside][0]))})"
                )
                places, lines = places[~inside], lines[~inside]
    _check_known(course, motions[~rapid], lines, unknown)
    before = np.searchsorted(motions, lines).tolist()
    parsed: dict[str, ForceNote | None] = {}
    notes = []
    for place, line, row in zip(places.tolist(), lines.tolist(), before, strict=True):
        comment = text[place + 1 : int(source.stops[line - 1])]
        origin = source.origin(line)
        if comment not in parsed:
            parsed[comment] = parse_force_note(comment, origin.line, origin.source.document.name)
        note = parsed[comment]
        if note is not None:
            notes.append((line, ForceNote(origin.line, note.wrench, note.frame, row)))
    return notes


def _places(source: Source) -> tuple[Ints, Ints]:
    """Return where force comments begin, and their lines."""
    text = source.text
    places = np.array([match.start() for match in _FORCE.finditer(text)], dtype=np.int64)
    lines = np.searchsorted(source.starts, places, side="right")
    starts, stops = source.starts[lines - 1].tolist(), source.stops[lines - 1].tolist()
    begins = [comment_start(text, *span) for span in zip(starts, stops, strict=True)]
    real = np.array(begins, dtype=np.int64) == places  # else the semicolon stands in a string or a comment
    return places[real], lines[real]


def _check_known(course: Course, cutting: Ints, noted: Ints, unknown: Mapping[int, str]) -> None:
    """Refuse a motion behind a line from which on the force is not known, unless a comment stands between."""
    for line, why in sorted(unknown.items()):
        motion = int(np.searchsorted(cutting, line, side="right"))
        note = int(np.searchsorted(noted, line, side="right"))
        if motion < len(cutting) and not (note < len(noted) and noted[note] <= cutting[motion]):
            problem = f"which force acts is not known: {why}"
            raise course.source.line_error(problem, int(cutting[motion]), _ADVICE)
