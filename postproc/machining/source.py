"""A process as a source of forces: from material, tools and stock, and from its table of operations."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.errors import ForceError, Issue, combined_error, line_names
from postproc.forces import Knots, LawForces
from postproc.machining.estimate import ProcessForces, estimate
from postproc.machining.process import OperationTable, Process
from postproc.machining.remaining import Guard
from postproc.machining.tool_path import Shift, refuse_unread_cuts
from postproc.operations import Operation, finished_operation, ignored_comments, operations, title
from postproc.program import FORCE_FRAMES, Event, Ints, Program, distinct
from postproc.toolpath import Segments

_TOOL = re.compile(r"T0*(\d+)", re.IGNORECASE)
_BLOCK = re.compile(r"N0*(\d+)", re.IGNORECASE)
_N_WORD = re.compile(r"\s*/?\s*N\s*0*(\d+)", re.IGNORECASE)
_MAX_NAMES = 20
"""Operations that a message lists."""
_MAX_COMMENTS = 3
"""Comments that a message quotes."""


def operation_knots(program: Program, process: Process) -> Knots:
    """Return the force of each cutting motion that an entry of [operations] names.

    An entry has one of three names. Comment: the text with which the operation begins, before or after its tool change.
    Tool: T3. Block: the N word of the block in which the operation begins, N120. Comments and blocks take precedence
    over tools.

    The force ends at the next operation that begins at a tool change or retract, see `postproc.operations`, or at a
    comment ``finish operation: NAME`` with the name of the entry. Other comments between cutting motions do not end
    it; a note lists those that could be names of operations.

    :raises ForceError: an entry matches nothing in the program; the message lists the operations found.
    :raises ProgramError: a routine that cuts is not followed.
    """
    refuse_unread_cuts(program)
    entry_of_motion, entry_by_comment = _entries_of_motions(program, process)
    motion = np.flatnonzero((entry_of_motion != _NO_ENTRY) & ~program.motions.rapid)
    entries = list(process.operations.values())
    # wrench, frame and relative standard deviation of each entry; `rows` is the entry of each cutting motion
    wrench = np.array([_wrench_of_entry(entry) for entry in entries]).reshape(-1, 6)
    frame = np.array([FORCE_FRAMES.index(entry.frame) for entry in entries], dtype=np.int64)
    share = np.array([entry.sigma_percent / 100.0 for entry in entries])
    rows = entry_of_motion[motion]
    sigma = np.abs(wrench[rows]) * share[rows, None]
    knots = Knots.throughout(motion, wrench[rows], frame[rows], sigma, factor=share[rows])
    issues = _ignored_comment_issues(program, entry_by_comment, list(process.operations))
    return replace(knots, issues=tuple(issues))


def _entries_of_motions(program: Program, process: Process) -> tuple[Ints, Ints]:
    """Return the entry of [operations] of each motion (M,), and the entry (M,) that a comment or block names for it.

    Entries are numbered in the order of the file; `_NO_ENTRY`: none. The first result is the second, else the entry of
    the tool.

    :raises ForceError: an entry matches nothing in the program.
    """
    names, program_operations = list(process.operations), operations(program, at_retracts=True)
    # T number, digits of an N word, or text of a comment → number of its entry in [operations]
    tools = {int(match[1]): k for k, name in enumerate(names) if (match := _TOOL.fullmatch(name.strip()))}
    blocks = {match[1]: k for k, name in enumerate(names) if (match := _BLOCK.fullmatch(name.strip()))}
    titles = {_normal_text(name): k for k, name in enumerate(names) if k not in {*tools.values(), *blocks.values()}}
    tool_changes = [event for event in program.events if event.kind == "tool_change"]
    tool_entry_changes = [
        _EntryChange(event.before, _CHANGE_RANK, tools.get(int(event.value), _NO_ENTRY)) for event in tool_changes
    ]
    named_entry_changes = _named_changes(program, program_operations, titles, blocks)
    named_entry = _last_entry(named_entry_changes, len(program.motions))
    entry_of_motion = np.where(
        named_entry != _NO_ENTRY, named_entry, _last_entry(tool_entry_changes, len(program.motions))
    )
    used_entries = {change.entry for change in [*tool_entry_changes, *named_entry_changes]}
    unused = [name for k, name in enumerate(names) if k not in used_entries]
    if unused:
        raise combined_error(_unmatched_error(program, process, name, program_operations) for name in unused)
    return entry_of_motion, named_entry


_NO_ENTRY = -1
"""No entry of [operations] gives the force."""
_CHANGE_RANK, _OPERATION_RANK, _COMMENT_RANK, _N_WORD_RANK = range(4)
"""Ranks of changes at one motion, lowest first: tool change or end, operation, comment that names an entry, N word."""


class _EntryChange(NamedTuple):
    """The motion at which the force of an entry of [operations] begins, or at which forces end.

    :param row: row of the first motion with this force, or without a force.
    :param rank: among changes at one row, the one with the highest rank counts.
    :param entry: number of the entry whose force begins; `_NO_ENTRY`: forces end.
    """

    row: int
    rank: int
    entry: int


def _named_changes(
    program: Program, program_operations: tuple[Operation, ...], titles: dict[str, int], blocks: dict[str, int]
) -> list[_EntryChange]:
    """Return where forces of entries that a comment or an N word names begin, and where forces end.

    :param titles: normal text of a comment → number of its entry.
    :param blocks: digits of an N word → number of its entry.
    """
    operation_changes = [
        # if no entry has the name of the operation, forces end where it begins
        _EntryChange(operation.first, _OPERATION_RANK, titles.get(_normal_text(operation.name), _NO_ENTRY))
        for operation in program_operations
    ]
    return [*operation_changes, *_comment_changes(program, titles), *_block_changes(program, blocks)]


def _comment_changes(program: Program, titles: dict[str, int]) -> Iterator[_EntryChange]:
    """Yield where an entry that a comment names begins, and where tool changes and finishing comments end it.

    The first tool change after the comment belongs to the operation that the comment names. A later change to another
    tool ends the entry, and so does any change after a cut.

    :param titles: normal text of a comment → number of its entry.
    """
    cut_count = _cut_counts(program)
    entry_row, running_entry = 0, _NO_ENTRY  # row and entry of the last comment that names one
    new_tool: float | None = None  # number of the tool that was changed to since then
    for event in _events_with_tool_changes(program):
        if event.kind == "tool_change":
            if cut_count[event.before] > cut_count[entry_row] or new_tool not in (None, event.value):
                # a change at the motion of the comment that named the entry ends what this comment began
                ends_comment = running_entry != _NO_ENTRY and entry_row == event.before
                yield _EntryChange(event.before, _COMMENT_RANK if ends_comment else _CHANGE_RANK, _NO_ENTRY)
                running_entry = _NO_ENTRY
            new_tool = event.value
        elif event.kind == "comment":
            entry = titles.get(_normal_text(title(event.text)), titles.get(_normal_text(event.text), _NO_ENTRY))
            end_title = finished_operation(event.text)
            is_running = running_entry != _NO_ENTRY
            if entry != _NO_ENTRY:
                yield _EntryChange(event.before, _COMMENT_RANK, entry)
                entry_row, running_entry, new_tool = event.before, entry, None
            elif end_title is not None and is_running and titles.get(_normal_text(end_title)) == running_entry:
                yield _EntryChange(event.before, _CHANGE_RANK, _NO_ENTRY)


def _block_changes(program: Program, blocks: dict[str, int]) -> Iterator[_EntryChange]:
    """Yield where an entry that an N word names begins: at each motion by which the program reaches its line.

    :param blocks: digits of an N word → number of its entry.
    """
    line = program.motions.line
    for number, text in enumerate(program.documents[0].text.splitlines() if blocks else (), start=1):
        match = _N_WORD.match(text)
        if match is not None and match[1] in blocks:
            # motions of this line or a later one that follow a motion of an earlier line
            begins = (line >= number) & (np.concatenate([[0], line[:-1]]) < number)
            for row in np.flatnonzero(begins).tolist():
                yield _EntryChange(row, _N_WORD_RANK, blocks[match[1]])


def _events_with_tool_changes(program: Program) -> list[Event]:
    """Return the events of a program, with a tool change at each change of `$TOOL` if the program has no tool changes.

    Programs without tool changes are those in KRL, and G-code with G43 but without M6.
    """
    m, events = program.motions, list(program.events)
    if any(event.kind == "tool_change" for event in events):
        return events
    rows = (np.flatnonzero(np.diff(m.tool)) + 1).tolist()
    events += [Event(row, "tool_change", int(m.line[row]), value=float(m.tool[row])) for row in rows]
    return sorted(events, key=lambda event: event.before)


def _cut_counts(program: Program) -> Ints:
    """Return the numbers of cutting motions (M + 1,) before each motion, and of all motions."""
    return np.concatenate([[0], np.cumsum(~program.motions.rapid)])


def _ignored_comment_issues(program: Program, named_entry: Ints, names: list[str]) -> Iterator[Issue]:
    """Yield a note for each entry whose force continues after comments that could be names of operations.

    Such a comment is alone on its line after a retract, but `postproc.operations` takes it for a remark, like "pass 2".
    Or it is between two cutting motions.

    :param named_entry: (M,) entry that a comment or a block names for each motion; `_NO_ENTRY`: none.
    :param names: names of the entries, in their order.
    """
    cutting = np.flatnonzero(~program.motions.rapid)
    cut_count, comments_by_entry = _cut_counts(program), dict[int, list[Event]]()
    for comment in ignored_comments(program):
        next_cut = int(cut_count[comment.before])  # index in `cutting` of the first cut after the comment
        if 0 < next_cut < len(cutting):
            last_entry, next_entry = named_entry[cutting[next_cut - 1]], named_entry[cutting[next_cut]]
            if last_entry == next_entry != _NO_ENTRY:
                comments_by_entry.setdefault(int(last_entry), []).append(comment)
    for entry, comments in comments_by_entry.items():
        comment_text = ", ".join(
            f"{title(comment.text)!r} (line {comment.line})" for comment in comments[:_MAX_COMMENTS]
        )
        suffix = f" and {len(comments) - _MAX_COMMENTS} more" if len(comments) > _MAX_COMMENTS else ""
        message = (
            f"the force of [operations.{names[entry]!r}] goes on after the comment {comment_text}{suffix}. If an "
            "operation begins there, give it an entry with its forces"
        )
        yield Issue("info", "operation-goes-on", message, comments[0].line, count=len(comments), subject=names[entry])


def _last_entry(changes: list[_EntryChange], count: int) -> Ints:
    """Return the entry (count,) of the last change at or before each motion; `_NO_ENTRY` before the first change.

    :param changes: in any order. Of changes at one motion the highest rank counts; of equal ranks, the last one.
    :param count: number of motions.
    """
    before_all = _EntryChange(-1, _CHANGE_RANK, _NO_ENTRY)
    ordered_changes = [before_all, *sorted(changes, key=lambda change: (change.row, change.rank))]
    last_change = np.searchsorted([change.row for change in ordered_changes], np.arange(count), side="right") - 1
    return np.array([change.entry for change in ordered_changes], dtype=np.int64)[last_change]


def _unmatched_error(
    program: Program, process: Process, name: str, program_operations: tuple[Operation, ...]
) -> ForceError:
    """Return the error for the entry `name` that matches nothing in the program.

    It suggests the most similar operation or comment of the program, and lists its operations.
    """
    file = program.documents[0].name
    operation_names = list(dict.fromkeys(operation.name for operation in program_operations))
    comments = [title(event.text) for event in program.events if event.kind == "comment" and event.text.strip()]
    candidates = [*operation_names, *comments]
    matches = difflib.get_close_matches(_normal_text(name), [_normal_text(candidate) for candidate in candidates], 1)
    similar_name = next((item for item in candidates if matches and _normal_text(item) == matches[0]), None)
    name_list = ", ".join(f"{operation_name!r}" for operation_name in operation_names[:_MAX_NAMES])
    name_list += " …" if len(operation_names) > _MAX_NAMES else ""
    advice = f"Did you mean {similar_name!r}? " if similar_name else ""
    advice += (
        f"Operations found: {name_list or 'none'}. Name an operation as its comment, a tool as T3, a block as N120."
    )
    return ForceError(
        f"[operations.{name!r}]: no comment, tool or block of {file} has this name", file=process.path, advice=advice
    )


def _normal_text(text: str) -> str:
    """Return a text with single blanks and in lower case: names are compared in this form."""
    return " ".join(text.split()).casefold()


def _wrench_of_entry(entry: OperationTable) -> tuple[float, ...]:
    """Return force [N] and moment [N·m] of an entry."""
    return entry.Fx, entry.Fy, entry.Fz, entry.Mx, entry.My, entry.Mz


def refuse_comments(program: Program, process: str) -> None:
    """Refuse a program that states forces in comments: a process computes those of all its moves.

    :param process: path of the process file, for the message.
    :raises ForceError: a comment states a force; the message lists lines.
    """
    lines = list(dict.fromkeys(note.line for note in program.notes if any(note.wrench)))
    if lines:
        raise ForceError(
            f"a force comment, and forces from {process}: it is not clear which of them counts",
            file=program.documents[0].name,
            line=lines[0],
            advice=f"Give no --process, or remove the force comments ({line_names(lines, 5)}).",
        )


_NO_KNOTS = np.zeros(0, dtype=np.int64), np.zeros((0, 6)), np.zeros(0, dtype=np.int64)


class ProcessSource:
    """The forces of a process: from material, tools and stock; entries of its table of operations take precedence.

    Implements `forces.ForceSource`. The stock is swept once for a program.

    :ivar process: the process.
    :ivar process_forces: the last computed forces; None before the first call of `along`, and without [material].
    """

    def __init__(
        self,
        process: Process,
        axis: str,
        *,
        stock: Path | None = None,
        shift: Shift | None = None,
        guard: Callable[[], Guard] | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Store a process; its forces are computed when `along` is called first.

        :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
        :param stock: mesh of the stock, instead of that of the process.
        :param shift: displacement of the tip, see `Shift`.
        :param guard: returns the parts of the tool that must stay clear of the stock; None: nothing is compared.
        :param progress: called with the number of straight segments swept, and their total number.
        """
        self.process, self._axis, self._stock, self._shift = process, axis, stock, shift
        self._progress, self._guard = progress, guard
        self._program: Program | None = None  # of which `_knots` are the forces
        self._knots: Knots | None = None
        self.process_forces: ProcessForces | None = None

    def shift_tip(self, shift: Shift) -> ProcessSource:
        """Return the same process with a displaced tip; no parts of the tool are compared with the stock."""
        return ProcessSource(self.process, self._axis, stock=self._stock, shift=shift, progress=self._progress)

    @property
    def name(self) -> str:
        """The file of the process."""
        return self.process.path

    def along(self, program: Program, path: Segments) -> Knots:
        """Return the forces along the motions of a program, see `estimate` and `operation_knots`.

        :raises ForceError: the process cannot be used for this program, or it states forces in comments too.
        """
        refuse_comments(program, self.name)
        if self._knots is None or self._program is not program:
            self._knots, self._program = self._forces(program, path), program
        return self._knots

    def _forces(self, program: Program, path: Segments) -> Knots:
        """Return the forces by the cutting law and by the entries of [operations], which take precedence."""
        process = self.process
        if process.material is None:
            return operation_knots(program, process) if process.operations else Knots.throughout(*_NO_KNOTS)
        self.process_forces = process_forces = estimate(
            program,
            path,
            process,
            self._axis,
            stock=self._stock,
            shift=self._shift,
            guard=None if self._guard is None else self._guard(),
            progress=self._progress,
        )
        knots, issues = process_forces.knots, process_forces.issues
        law_motions = self._common_factor_motions(process_forces)
        if process.operations:
            entry_knots = operation_knots(program, process)
            knots = entry_knots.with_fallback(knots)
            issues = (*issues, *entry_knots.issues)
            law_motions = np.setdiff1d(law_motions, entry_knots.motion)
        law_forces = LawForces(process.law().numbers, law_motions)
        return replace(knots, issues=issues, law_forces=law_forces, stock=process_forces.over_time)

    def _common_factor_motions(self, process_forces: ProcessForces) -> Ints:
        """Return the motions (k,) whose forces have one unknown factor in common: the error of the cutting law.

        There are none if the law has no error, or a covariance of its coefficients instead.
        """
        law = self.process.law()
        has_common_factor = law.covariance is None and law.sigma > 0.0
        return distinct(process_forces.knots.motion) if has_common_factor else np.zeros(0, dtype=np.int64)
