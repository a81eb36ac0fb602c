"""Comments of KRL: those about forces and the one in force at each motion; and remarks that may name operations.

A force comment holds until the next one, in execution order. A control structure or a called routine with one is
therefore followed like one with motions; after code that cannot be followed the force is not known until the next
comment.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence, Set
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from postproc.dialects.krl.execution import Branch, Execution, Fork, Join, UnresolvedStructure, UnrolledLoop
from postproc.dialects.krl.language.source import Source, comment_start
from postproc.dialects.krl.language.tokens import FORCE
from postproc.dialects.krl.language.trace import Trace
from postproc.program import FORCE_COMMENT, Bools, Event, ForceNote, Ints, parse_force_note

_Force = ForceNote | str | None
_Event = tuple[int, int, _Force | Fork | Branch | Join]
"""Line of the trace, order on the line, and a force comment, why the force is not known, or a fork, branch or join."""
_FORCE_TOLERANCE = 0.01
"""Forces that differ by less [N, N·m] count as equal: they deflect the tool by a few nanometres."""
_JOIN_ADVICE = "Let the last motion of each branch have the same force, in the axes of $BASE or of the tool."
_FORCE_ADVICE = "Write a force comment before this motion."
_LOOP_ADVICE = "Write a force comment, such as FORCE OFF, before the first motion of the LOOP."


def force_comment_lines(source: Source) -> tuple[int, ...]:
    """Return the lines of a file that have a force comment, ascending."""
    _, lines = _force_comment_offsets(source)
    return tuple(lines.tolist())


def force_notes(
    execution: Execution,
    trace_row: Ints,
    is_rapid: Bools,
    unknown_reasons: Mapping[int, str],
    unchecked_joins: Set[Join] = frozenset(),
) -> list[tuple[int, ForceNote]]:
    """Return the force comments of a trace, each with its row of the trace, in order.

    At branches and joins a comment is added that states the acting force again. In each round of a LOOP without EXIT
    the forces must be those of the first.

    :param trace_row: (M,) rows of the trace with the motions.
    :param is_rapid: (M,) True for motions that carry no force.
    :param unknown_reasons: rows of the trace after which the acting force is not known, and why.
    :param unchecked_joins: joins at which branches may end in different poses.
    :raises ProgramError: the force on a motion is not known, or another one in the second round of a LOOP without EXIT.
    :raises ForceError: a comment cannot be read.
    """
    trace = execution.trace
    lines, comments = _force_comments(execution)
    if execution.may_run is not None:  # leave out comments on rows that do not run
        is_run = execution.may_run[lines - 1]
        lines, comments = lines[is_run], comments[is_run]
    unknown_reasons = dict(unknown_reasons)
    for step in execution.steps:
        if isinstance(step, UnresolvedStructure):
            in_step = (lines >= step.first) & (lines <= step.last)
            if in_step.any():
                place = trace.place(int(lines[in_step][0]))
                unknown_reasons[step.last] = f"a force comment is in code that is left unchanged ({place})"
                lines, comments = lines[~in_step], comments[~in_step]
    notes = list(_parsed_notes(trace, trace_row, lines, comments))
    divisions = [step for step in execution.steps if isinstance(step, Fork | Branch | Join)]
    if not divisions and not unknown_reasons and execution.endless_loop is None:
        return notes
    return _ActiveForce(execution, trace_row, is_rapid, unchecked_joins).restated_notes(
        notes, unknown_reasons, divisions
    )


def _parsed_notes(
    trace: Trace, trace_row: Ints, lines: Ints, comments: NDArray[np.object_]
) -> Iterator[tuple[int, ForceNote]]:
    """Yield the force comments of a trace, each with its row of the trace; each text is parsed once.

    :param trace_row: (M,) rows of the trace with the motions.
    :param lines: (n,) rows of the comments in the trace; `comments` (n,) their texts.
    :raises ForceError: a comment cannot be read.
    """
    note_of_text: dict[str, ForceNote | None] = {}
    # first motion on or after each line, and the line in the file
    rows, lines_in_files = np.searchsorted(trace_row, lines).tolist(), trace.line[lines - 1].tolist()
    for comment, line, file_line, row in zip(comments.tolist(), lines.tolist(), lines_in_files, rows, strict=True):
        if comment not in note_of_text:
            origin = trace.place(line)
            # errors name the first place with the text
            note_of_text[comment] = parse_force_note(comment, origin.line, origin.source.document.name)
        note = note_of_text[comment]
        if note is not None:  # None: the comment is not about forces
            yield line, ForceNote(file_line, note.wrench, note.frame, row)


class _ForcePair(NamedTuple):
    """The acting force, and the force on the last motion; see `_ActiveForce`."""

    active_force: _Force
    motion_force: _Force


class _ActiveForce:
    """The force comment in force, from line to line.

    :ivar active_force: the comment in force; None: no force; a text: the reason why the force is not known.
    :ivar motion_force: the force on the last motion, in the same form; None if that motion carries no force.
    :ivar passed_line: last line of the trace whose motions have been passed.
    :ivar loaded_rows: rows of motions that carry forces, from each of which on another force may act; `forces`: these.
    """

    def __init__(self, execution: Execution, trace_row: Ints, is_rapid: Bools, unchecked_joins: Set[Join]) -> None:
        """Begin before the first line, without a force.

        :param execution: the execution trace.
        :param trace_row: (M,) rows of the trace with the motions.
        :param is_rapid: (M,) True for motions that carry no force.
        :param unchecked_joins: joins at which branches may end in different poses.
        """
        self.execution, self.trace_row, self.is_rapid, self.unchecked_joins = (
            execution,
            trace_row,
            is_rapid,
            unchecked_joins,
        )
        self.notes: list[tuple[int, ForceNote]] = []
        # None: no force; a text: the reason why the force is not known
        self.active_force: _Force = None
        self.motion_force: _Force = None  # on the last motion
        self.passed_line = 0  # no motion has been passed
        self.loaded_rows: list[int] = []
        self.forces: list[_Force] = []

    def restated_notes(
        self,
        notes: Sequence[tuple[int, ForceNote]],
        unknown_reasons: Mapping[int, str],
        divisions: Sequence[Fork | Branch | Join],
    ) -> list[tuple[int, ForceNote]]:
        """Return the force comments, and added comments that state the acting force again at branches and joins.

        :param notes: force comments, each with its row of the trace.
        :param unknown_reasons: rows of the trace after which the acting force is not known, and why.
        :param divisions: forks, branches and joins of the trace.
        """
        events: list[_Event] = [
            *((line, 0, note) for line, note in notes),
            *((line, 1, reason) for line, reason in unknown_reasons.items()),
            *((division.row, 2, division) for division in divisions),
        ]
        events.sort(key=lambda event: event[:2])
        self._pass_events(events)
        notes_of_program, loop = self.notes, self.execution.endless_loop
        if loop is not None:
            self._check_next_round(loop, [event for event in events if event[0] >= loop.first])
        return notes_of_program

    def _check_next_round(self, loop: UnrolledLoop, events: Sequence[_Event]) -> None:
        """Refuse a LOOP without EXIT if a motion has another force in its second round than in the first.

        :param events: the events in the LOOP.
        :raises ProgramError: the force is another one, or not known.
        """
        next_round = _ActiveForce(self.execution, self.trace_row, self.is_rapid, self.unchecked_joins)
        next_round.active_force, next_round.motion_force = self.active_force, self.motion_force
        next_round.passed_line = loop.first - 1
        next_round._pass_events(events)
        for row, force in zip(next_round.loaded_rows, next_round.forces, strict=True):
            first_force = self.forces[bisect_right(self.loaded_rows, row) - 1]
            if _wrench_and_frame(force) != _wrench_and_frame(first_force):
                problem = "its round ends under another force than it began with"
                raise self.execution.endless_loop_error(problem, _LOOP_ADVICE)

    def _pass_events(self, events: Sequence[_Event]) -> None:
        """Pass events in their order, and the motions between and behind them.

        :raises ProgramError: the force on a motion is not known, or branches end under different forces.
        """
        # per open fork: its row, the forces at it, and those at the ends of its branches
        open_forks: list[tuple[int, _ForcePair, list[_ForcePair]]] = []
        for line, _, event in events:
            # a comment acts on the motion of its own line, other events on the motions after it
            self._pass_motions(line - 1 if isinstance(event, ForceNote) else line)
            if isinstance(event, ForceNote):
                self.notes.append((line, event))
                self.active_force = event
            elif isinstance(event, str):
                self.active_force = event
            elif isinstance(event, Fork):
                open_forks.append((line, _ForcePair(self.active_force, self.motion_force), []))
            elif isinstance(event, Branch):
                _, entry, ends = open_forks[-1]
                ends.append(_ForcePair(self.active_force, self.motion_force))
                self.motion_force = entry.motion_force
                self._set_force(line, entry.active_force)
            elif isinstance(event, Join):
                fork_row, entry, ends = open_forks.pop()
                # the first of `ends` was noted where the first branch begins, before any branch ended
                end_forces = [*ends[1:], _ForcePair(self.active_force, self.motion_force)]
                if not event.is_exhaustive:
                    end_forces.append(entry)
                self._pass_join(line, fork_row, end_forces, is_unchecked=event in self.unchecked_joins)
        self._pass_motions(len(self.execution.trace))

    def _pass_join(self, line: int, fork_row: int, ends: Sequence[_ForcePair], *, is_unchecked: bool) -> None:
        """Set the force that acts after a join; if it differs between the branches, it is not known.

        A force common to all branches is not stated again if a motion is on the line of the join.

        :param line: row of the trace with the join; `fork_row`: that of the fork of its branches.
        :param ends: for each branch, the acting force at its end and the force on its last motion.
        :param is_unchecked: True if branches may end in different poses.
        :raises BranchError: the last motions are under different forces: corrected, they would end in different poses.
        """
        forces = [_wrench_and_frame(end.active_force) for end in ends]
        motion_forces = [_wrench_and_frame(end.motion_force) for end in ends]
        if not is_unchecked and any(
            _certainly_differ(force, motion_forces[0]) or _turns_with_path(*force) for force in motion_forces
        ):
            problem = "the branches that end here do so under different forces: corrected, they would not meet"
            raise self.execution.branch_error(problem, line, {fork_row}, _JOIN_ADVICE)
        is_common = all(force == forces[0] for force in forces)
        row = int(np.searchsorted(self.trace_row, line))
        if is_common and row < len(self.trace_row) and self.trace_row[row] == line:
            return  # the line of a motion after which a routine ends
        self._set_force(
            line, ends[0].active_force if is_common else "branches that meet before it leave different ones"
        )

    def _set_force(self, line: int, force: _Force) -> None:
        """Set the acting force from a line of the trace on, and add a comment to `notes` that states it.

        No comment is added for an unknown force, or for no force before the first comment.

        :param force: a comment; None: no force; a text: the reason why the force is not known.
        """
        self.active_force = force
        if isinstance(force, str) or (force is None and not self.notes):
            return
        wrench, frame = _wrench_and_frame(force)
        origin = self.execution.trace.place(line).line
        motion = int(np.searchsorted(self.trace_row, line))
        self.notes.append((line, ForceNote(origin, wrench, frame, motion, is_restated=True)))

    def _pass_motions(self, line: int) -> None:
        """Pass the motions up to and including a line: the acting force becomes the force on the last of them.

        :raises ProgramError: the force on one of these motions is not known.
        """
        # motions after `passed_line`, up to and including `line`
        first, stop = np.searchsorted(self.trace_row, [self.passed_line, line], side="right").tolist()
        self.passed_line = max(self.passed_line, line)
        if first >= stop:
            return
        loaded_rows = first + np.flatnonzero(~self.is_rapid[first:stop])
        if isinstance(self.active_force, str) and len(loaded_rows):
            problem = f"which force acts is not known: {self.active_force}"
            raise self.execution.trace.error(problem, int(self.trace_row[loaded_rows[0]]), _FORCE_ADVICE)
        if len(loaded_rows):
            self.loaded_rows.append(int(loaded_rows[0]))
            self.forces.append(self.active_force)
        self.motion_force = None if self.is_rapid[stop - 1] else self.active_force


def _certainly_differ(force: tuple[Any, ...], other_force: tuple[Any, ...]) -> bool:
    """Return whether two known forces, each a wrench and its axes, certainly differ.

    Forces other than zero in different axes may be equal: False.
    """
    (wrench, frame), (other_wrench, other_frame) = force, other_force
    has_zero = not any(wrench) or not any(other_wrench)
    return (has_zero or frame == other_frame) and any(
        abs(a - b) > _FORCE_TOLERANCE for a, b in zip(wrench, other_wrench, strict=True)
    )


def _turns_with_path(wrench: Sequence[float], frame: str) -> bool:
    """Return whether a force turns with the direction of travel: it acts along or across the feed.

    :param wrench: (6,) force [N] and torque [N·m]; `frame` is the name of its axes.
    """
    return frame == "FEED" and any((*wrench[:2], *wrench[3:5]))  # z is along the spindle, whatever the feed


def _wrench_and_frame(force: _Force) -> tuple[Any, ...]:
    """Return the wrench (6,) [N, N·m] of a comment and the name of its axes.

    No force (None), or a zero one in any axes: zeros in BASE. Unknown force (text): the text in place of the wrench,
    and an empty name.
    """
    if isinstance(force, ForceNote):
        return force.wrench, force.frame if any(force.wrench) else "BASE"
    return ((0.0,) * 6, "BASE") if force is None else (force, "")


def _force_comments(execution: Execution) -> tuple[Ints, NDArray[np.object_]]:
    """Return the rows (n,) of a trace that have a force comment, in order, and the texts (n,) behind the semicolons."""
    rows, texts = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.object_)]
    for source in execution.trace.sources:
        offsets, lines = _force_comment_offsets(source)
        stops = source.stops[lines - 1].tolist()
        comments = [source.text[offset + 1 : stop] for offset, stop in zip(offsets.tolist(), stops, strict=True)]
        rows_of_file, index = execution.rows_of(source, lines)  # a line has as many rows as times that it runs
        rows.append(rows_of_file)
        texts.append(np.array(comments, dtype=np.object_)[index])
    all_rows = np.concatenate(rows)
    order = np.argsort(all_rows, kind="stable")
    return all_rows[order], np.concatenate(texts)[order]


def _force_comment_offsets(source: Source) -> tuple[Ints, Ints]:
    """Return the offsets (n,) at which force comments begin in a file, and their lines (n,), from 1, ascending."""
    text = source.text
    offsets = np.array([match.start() for match in FORCE.finditer(text)], dtype=np.int64)
    lines = np.searchsorted(source.starts, offsets, side="right")  # number of lines that begin at or before each
    starts, stops = source.starts[lines - 1].tolist(), source.stops[lines - 1].tolist()
    begins = [comment_start(text, *span) for span in zip(starts, stops, strict=True)]
    is_comment = np.array(begins, dtype=np.int64) == offsets  # else the semicolon is inside a string or a comment
    return offsets[is_comment], lines[is_comment]


_COMMENT = re.compile(r";[^\r\n;]*")  # begins with a character that is found fast
_EDITOR_COMMENT = re.compile(
    rf";\s*(?!\s)(?:{FORCE_COMMENT.pattern}|ENDFOLD|POSTPROC\b|Params\b|Make your|%|\*|"
    r"FOLD\s*(?:$|%|INI\b|BASISTECH|USER\b|S?PTP\b|S?LIN|S?CIRC|OUT\b|WAIT|SET_|Moduleparameters|DECLARATIONS))",
    re.IGNORECASE,
)
"""Forces, our own line, and what KUKA's editor writes."""
_FOLD = re.compile(r"\A;\s*(?:FOLD\b)?\s*", re.IGNORECASE)
_BLANKS = " \t"
_MAX_COMMENTS = 2000
"""Of more comments than this none names an operation."""


def remarks(execution: Execution, motions: Ints) -> tuple[Event, ...]:
    """Return the comments that may name an operation, in execution order, each as an event at the next motion.

    Comments behind code, about forces, and those that KUKA's editor or postproc writes are left out.

    :param motions: (M,) lines of the motions in the trace.
    :returns: empty if there are more than `_MAX_COMMENTS` comments.
    """
    comment_starts = []
    for source in execution.trace.sources:
        starts, lines = _lines_of_comments(source)
        rows, index = execution.rows_of(source, lines)
        comment_starts += [
            (row, source, start) for row, start in zip(rows.tolist(), starts[index].tolist(), strict=True)
        ]
        if len(comment_starts) > _MAX_COMMENTS:
            return ()
    events = []
    for row, source, start in sorted(comment_starts, key=itemgetter(0)):
        comment = _COMMENT.match(source.text, start)
        name = _FOLD.sub("", comment[0]).strip(" \t-=*") if comment else ""
        if comment and name and not _EDITOR_COMMENT.match(comment[0].rstrip()):
            reported_line = execution.trace.reported_line(row)
            next_motion = int(np.searchsorted(motions, row))
            events.append(Event(before=next_motion, kind="comment", line=reported_line, text=name))
    return tuple(events)


def _lines_of_comments(source: Source) -> tuple[Ints, Ints]:
    """Return the offsets (n,) of comments without code before them on the line, and their lines (n,)."""
    text = source.text
    starts = np.array([match.start() for match in _COMMENT.finditer(text)], dtype=np.int64)
    lines = source.line_at_each(starts)
    begins = source.starts[lines - 1]
    is_alone = begins == starts  # most comments begin their line
    candidates = np.flatnonzero(~is_alone)  # indented, or behind code
    for index, begin, start in zip(
        candidates.tolist(), begins[candidates].tolist(), starts[candidates].tolist(), strict=True
    ):
        # the first character decides most lines
        is_alone[index] = text[begin] in _BLANKS and not text[begin:start].strip(_BLANKS)
    return starts[is_alone], lines[is_alone]
