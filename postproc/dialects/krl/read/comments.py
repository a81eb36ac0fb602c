"""Comments of KRL: those about forces and the one in force at each motion; and remarks that may name operations.

A force comment holds until the next one, in execution order. A control structure or a called routine with one is
therefore followed like one with motions; after code that cannot be followed the force is not known until the next
comment.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence, Set
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from postproc.dialects.krl.course import Branch, Course, Fork, Join, UnresolvedStructure
from postproc.dialects.krl.language.source import Source, comment_start
from postproc.dialects.krl.language.tokens import FORCE
from postproc.dialects.krl.language.trace import Trace
from postproc.program import FORCE_COMMENT, Bools, Event, ForceNote, Ints, parse_force_note

_Force = ForceNote | str | None
_FORCE_TOLERANCE = 0.01
"""Forces that differ by less [N, N·m] count as equal: they deflect the tool by a few nanometres."""
_JOIN_ADVICE = "Let the last motion of each branch have the same force, in the axes of $BASE or of the tool."
_ADVICE = "Write a force comment before this motion."


def force_comment_lines(source: Source) -> tuple[int, ...]:
    """Return the lines of a file that have a force comment, ascending."""
    return tuple(_force_comment_places(source)[1].tolist())


def notes_of(
    course: Course,
    motions: Ints,
    rapid: Bools,
    unknown_reasons: Mapping[int, str],
    unchecked_joins: Set[Join] = frozenset(),
) -> list[tuple[int, ForceNote]]:
    """Return the force comments of a trace, by its lines; the acting force is stated again at branches and joins.

    :param motions: (M,) lines of the motions in the trace.
    :param rapid: (M,) True for motions that carry no force.
    :param unknown_reasons: lines of the trace after which the acting force is not known, and why.
    :param unchecked_joins: joins at which branches may end in different poses.
    :raises ProgramError: the force on a motion is not known.
    :raises ForceError: a comment cannot be read.
    """
    trace = course.trace
    lines, comments = _force_comments(course)
    if course.may_run is not None:
        is_run = course.may_run[lines - 1]
        lines, comments = lines[is_run], comments[is_run]
    unknown_reasons = dict(unknown_reasons)
    for step in course.steps:
        if isinstance(step, UnresolvedStructure):
            in_step = (lines >= step.first) & (lines <= step.last)
            if in_step.any():
                place = trace.place(int(lines[in_step][0]))
                unknown_reasons[step.last] = f"a force comment is in code that is left unchanged ({place})"
                lines, comments = lines[~in_step], comments[~in_step]
    notes = list(_parsed_notes(trace, motions, lines, comments))
    marks = [step for step in course.steps if isinstance(step, Fork | Branch | Join)]
    if not marks and not unknown_reasons:
        return notes
    return _ActiveForce(course, motions, rapid, unchecked_joins).with_restated_notes(notes, unknown_reasons, marks)


def _parsed_notes(
    trace: Trace, motions: Ints, lines: Ints, comments: NDArray[np.object_]
) -> Iterator[tuple[int, ForceNote]]:
    """Yield the force comments of a trace, by its lines.

    :param motions: (M,) lines of the motions in the trace.
    :param lines: (n,) lines of the comments in the trace; `comments` (n,) their texts. Each text is parsed once.
    :raises ForceError: a comment cannot be read.
    """
    note_of_text: dict[str, ForceNote | None] = {}
    rows, lines_in_files = np.searchsorted(motions, lines).tolist(), trace.line[lines - 1].tolist()
    for comment, line, file_line, row in zip(comments.tolist(), lines.tolist(), lines_in_files, rows, strict=True):
        if comment not in note_of_text:
            origin = trace.place(line)
            note_of_text[comment] = parse_force_note(comment, origin.line, origin.source.document.name)
        note = note_of_text[comment]
        if note is not None:
            yield line, ForceNote(file_line, note.wrench, note.frame, row)


class _ForcePair(NamedTuple):
    """The acting force, and that of the last motion."""

    now: _Force
    last: _Force


class _ActiveForce:
    """The force comment in force, from line to line.

    :ivar now: the comment in force; a text if it is not known: the reason.
    :ivar last: the same for the last motion.
    """

    def __init__(self, course: Course, motions: Ints, rapid: Bools, unchecked_joins: Set[Join]) -> None:
        """Begin before the first line, without a force; `since` is the last line whose motions have been passed.

        :param motions: (M,) lines of the motions in the trace; `rapid` (M,) True for those that carry no force.
        :param unchecked_joins: joins at which branches may end in different poses.
        """
        self.course, self.motions, self.rapid, self.unchecked_joins = course, motions, rapid, unchecked_joins
        self.notes: list[tuple[int, ForceNote]] = []
        self.now: _Force = None
        self.last: _Force = None
        self.since = 0

    def with_restated_notes(
        self,
        notes: Sequence[tuple[int, ForceNote]],
        unknown_reasons: Mapping[int, str],
        marks: Sequence[Fork | Branch | Join],
    ) -> list[tuple[int, ForceNote]]:
        """Return the force comments, with those that state the acting force again at branches and joins.

        :param notes: force comments by lines of the trace.
        :param unknown_reasons: lines after which the acting force is not known, and why.
        :param marks: forks, branches and joins of the trace.
        """
        events: list[tuple[int, int, _Force | Fork | Branch | Join]] = [
            *((line, 0, note) for line, note in notes),
            *((line, 1, reason) for line, reason in unknown_reasons.items()),
            *((mark.row, 2, mark) for mark in marks),
        ]
        # per open fork: the forces at it, and those at the ends of its branches
        open_forks: list[tuple[_ForcePair, list[_ForcePair]]] = []
        for line, _, event in sorted(events, key=lambda event: event[:2]):
            self._pass_motions(line - isinstance(event, ForceNote))
            if isinstance(event, ForceNote):
                self.notes.append((line, event))
                self.now = event
            elif isinstance(event, str):
                self.now = event
            elif isinstance(event, Fork):
                open_forks.append((_ForcePair(self.now, self.last), []))
            elif isinstance(event, Branch):
                entry, ends = open_forks[-1]
                ends.append(_ForcePair(self.now, self.last))
                self.last = entry.last
                self._set_force(line, entry.now)
            elif isinstance(event, Join):
                entry, ends = open_forks.pop()
                end_forces = [*ends[1:], _ForcePair(self.now, self.last), *([] if event.is_exhaustive else [entry])]
                self._pass_join(line, end_forces, is_unchecked=event in self.unchecked_joins)
        self._pass_motions(len(self.course.trace))
        return self.notes

    def _pass_join(self, line: int, ends: Sequence[_ForcePair], *, is_unchecked: bool) -> None:
        """Set the force that acts after a join.

        :param ends: for each branch, the force at its end and that of its last motion.
        :param is_unchecked: True if branches may end in different poses.
        :raises ProgramError: the branches end under different forces: corrected, they would end in different poses.
        """
        forces, last_forces = ([_wrench_and_frame(end[index]) for end in ends] for index in (0, 1))
        if not is_unchecked and any(
            _certainly_differ(force, last_forces[0]) or _turns_with_path(*force) for force in last_forces
        ):
            problem = "the branches that end here do so under different forces: corrected, they would not meet"
            raise self.course.trace.error(problem, line, _JOIN_ADVICE)
        is_common = all(force == forces[0] for force in forces)
        row = int(np.searchsorted(self.motions, line))
        if is_common and row < len(self.motions) and self.motions[row] == line:
            return  # not stated again on the line of a motion after which a routine ends
        self._set_force(line, ends[0].now if is_common else "branches that meet before it leave different ones")

    def _set_force(self, line: int, force: _Force) -> None:
        """Make a force the acting one from a line of the trace on, and add a comment to `notes` that states it.

        :param force: a comment; None: no force; a text: why it is not known, which no comment can state.
        """
        self.now = force
        if isinstance(force, str) or (force is None and not self.notes):
            return
        wrench, frame = _wrench_and_frame(force)
        origin = self.course.trace.place(line).line
        self.notes.append((line, ForceNote(origin, wrench, frame, int(np.searchsorted(self.motions, line)))))

    def _pass_motions(self, line: int) -> None:
        """Pass the motions up to a line, with the acting force.

        :raises ProgramError: the force on one of them is not known.
        """
        first, stop = np.searchsorted(self.motions, [self.since, line], side="right").tolist()
        self.since = max(self.since, line)
        if first >= stop:
            return
        cutting = np.flatnonzero(~self.rapid[first:stop])
        if isinstance(self.now, str) and len(cutting):
            problem = f"which force acts is not known: {self.now}"
            raise self.course.trace.error(problem, int(self.motions[first + cutting[0]]), _ADVICE)
        self.last = None if self.rapid[stop - 1] else self.now


def _certainly_differ(force: tuple[Any, ...], other_force: tuple[Any, ...]) -> bool:
    """Return whether two forces, each a wrench and its axes, certainly differ; in different axes they may be equal."""
    (wrench, frame), (other_wrench, other_frame) = force, other_force
    has_zero = not any(wrench) or not any(other_wrench)
    return (has_zero or frame == other_frame) and any(
        abs(a - b) > _FORCE_TOLERANCE for a, b in zip(wrench, other_wrench, strict=True)
    )


def _turns_with_path(wrench: Sequence[float], frame: str) -> bool:
    """Return whether a force turns with the direction of travel: it acts along or across the feed.

    :param wrench: (6,) force [N] and torque [N·m]; `frame` is the name of its axes.
    """
    return frame == "FEED" and any((*wrench[:2], *wrench[3:5]))


def _wrench_and_frame(force: _Force) -> tuple[Any, ...]:
    """Return the wrench (6,) of a comment and the name of its axes; zeros in BASE without a comment.

    For an unknown force it is the reason and an empty name.
    """
    if isinstance(force, ForceNote):
        return force.wrench, force.frame
    return ((0.0,) * 6, "BASE") if force is None else (force, "")


def _force_comments(course: Course) -> tuple[Ints, NDArray[np.object_]]:
    """Return the rows of a trace with a force comment (n,), in order, and its text behind the semicolon (n,)."""
    rows, texts = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.object_)]
    for source in course.trace.sources:
        places, lines = _force_comment_places(source)
        stops = source.stops[lines - 1].tolist()
        comments = [source.text[place + 1 : stop] for place, stop in zip(places.tolist(), stops, strict=True)]
        row, index = course.rows_of(source, lines)
        rows.append(row)
        texts.append(np.array(comments, dtype=np.object_)[index])
    row = np.concatenate(rows)
    order = np.argsort(row, kind="stable")
    return row[order], np.concatenate(texts)[order]


def _force_comment_places(source: Source) -> tuple[Ints, Ints]:
    """Return the offsets (n,) at which force comments begin in a file, and their lines (n,)."""
    text = source.text
    places = np.array([match.start() for match in FORCE.finditer(text)], dtype=np.int64)
    lines = np.searchsorted(source.starts, places, side="right")
    starts, stops = source.starts[lines - 1].tolist(), source.stops[lines - 1].tolist()
    begins = [comment_start(text, *span) for span in zip(starts, stops, strict=True)]
    is_comment = np.array(begins, dtype=np.int64) == places  # else the semicolon is inside a string or a comment
    return places[is_comment], lines[is_comment]


_COMMENT = re.compile(r";[^\r\n;]*")  # begins with a character that is found fast
_OF_THE_EDITOR = re.compile(
    rf";\s*(?!\s)(?:{FORCE_COMMENT.pattern}|ENDFOLD|POSTPROC\b|Params\b|Make your|%|\*|"
    r"FOLD\s*(?:$|%|INI\b|BASISTECH|USER\b|S?PTP\b|S?LIN|S?CIRC|OUT\b|WAIT|SET_|Moduleparameters|DECLARATIONS))",
    re.IGNORECASE,
)
"""Forces, our own line, and what KUKA's editor writes."""
_FOLD = re.compile(r"\A;\s*(?:FOLD\b)?\s*", re.IGNORECASE)
_BLANKS = " \t"
_MAX_COMMENTS = 2000
"""Of more comments than this none names an operation."""


def remarks(course: Course, motions: Ints) -> tuple[Event, ...]:
    """Return the comments that may name an operation, as events at the first motions after them.

    :param motions: (M,) lines of the motions in the trace.
    :returns: none if there are more than `_MAX_COMMENTS`.
    """
    comment_starts = []
    for source in course.trace.sources:
        starts, lines = _lines_of_comments(source)
        rows, index = course.rows_of(source, lines)
        comment_starts += [
            (row, source, start) for row, start in zip(rows.tolist(), starts[index].tolist(), strict=True)
        ]
        if len(comment_starts) > _MAX_COMMENTS:
            return ()
    events = []
    for row, source, start in sorted(comment_starts, key=itemgetter(0)):
        comment = _COMMENT.match(source.text, start)
        name = _FOLD.sub("", comment[0]).strip(" \t-=*") if comment else ""
        if comment and name and not _OF_THE_EDITOR.match(comment[0].rstrip()):
            shown_line = course.trace.shown_line(row)
            events.append(Event(int(np.searchsorted(motions, row)), "comment", shown_line, 0.0, name))
    return tuple(events)


def _lines_of_comments(source: Source) -> tuple[Ints, Ints]:
    """Return the offsets (n,) of comments that have a line to themselves, and their lines (n,)."""
    text = source.text
    starts = np.array([match.start() for match in _COMMENT.finditer(text)], dtype=np.int64)
    lines = source.line_at_each(starts)
    begins = source.starts[lines - 1]
    is_alone = begins == starts
    candidates = np.flatnonzero(~is_alone)
    for index, begin, start in zip(
        candidates.tolist(), begins[candidates].tolist(), starts[candidates].tolist(), strict=True
    ):
        is_alone[index] = text[begin] in _BLANKS and not text[begin:start].strip(_BLANKS)
    return starts[is_alone], lines[is_alone]
