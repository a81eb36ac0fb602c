"""Motions left uncorrected: their target, or whether they run, is not known before run time, or other robots may
move in time with them.

Rows are those of the execution trace: the lines of the program in the order in which they are executed. A motion is
given by its index among the motions of the program.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.execution import RoutineEntry
from postproc.dialects.krl.language.names import SYNCHRONISING
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tree import CallStatement, Event, Motion
from postproc.dialects.krl.language.values import Call, Reference, Word, walk
from postproc.dialects.krl.layout import CONSTANT
from postproc.dialects.krl.read.main_routine import TraceFollower
from postproc.dialects.krl.read.motion_reader import ROBOT_POSITIONS, depends_on_position
from postproc.dialects.krl.read.motions import OrderedMotions, uncertain_motions
from postproc.dialects.krl.read.variables import PARTLY_GIVEN
from postproc.errors import Issue, ProgramError
from postproc.program import CIRC, PTP, SPL, Bools, Ints, UnresolvedMotion, distinct

_WAIT_WORD = "#PROGSYNC"
"""First argument of a SYNCCMD at which the programs of the robots only wait for each other."""
_OTHER_SYNC = "?"
"""Stands for the word of a line that synchronises robots by other means than SYNCCMD with a word."""
_SEARCH_LENGTH = 1_000_000
"""Characters of a text that are searched at once."""
_SYNC_ADVICE = (
    "Motions before the first SYNCCMD of a program and behind the last are corrected; --keep-unresolved leaves those "
    "between as they are."
)
_UNKNOWN_START = "where it begins is not known, and its path depends on that"
_SHIFT_TEXT = ". It starts from the current robot position: the correction of the motion before it moves it too"
_OPEN_START_MESSAGE = (
    "Where this motion begins is not known, because the one before stays as it is: no targets are inserted into it, "
    "and its path is not checked."
)


class SeparatedMotions(Struct, frozen=True, eq=False):
    """The motions of a program, separated by whether they can be corrected.

    :param sequence: the M motions that can be corrected.
    :param predecessors: (M,) the motion at whose end each of them begins, see `Program.after`; the motion itself if its
        start is not known. None: the motion before it.
    :param unresolved: the motions that stay uncorrected.
    :param issues: warnings for the user.
    """

    sequence: OrderedMotions
    predecessors: Ints | None = None
    unresolved: tuple[UnresolvedMotion, ...] = ()
    issues: tuple[Issue, ...] = ()


def without_unresolved(follower: TraceFollower, sequence: OrderedMotions) -> SeparatedMotions:
    """Separate the motions that stay uncorrected under `--keep-unresolved` from those that can be corrected.

    A motion behind an uncorrected one, or behind a call that is not followed, begins in a pose that is not known. If
    its path depends on that pose, it stays uncorrected too.

    :param sequence: the motions of the program whose targets are known.
    :raises ProgramError: no motion can be corrected; or, without that option, a motion is synchronised with another
        robot.
    """
    run, columns = follower.run, sequence.columns
    sync_motions = list(_synchronised_motions(follower, columns.trace_row))
    if sync_motions and not run.keeps_unresolved:
        _, error = sync_motions[0]
        raise error
    unknown_motions = list(uncertain_motions(run.settings, sequence)) if run.keeps_unresolved else []
    reasons = dict(run.unresolved_motions)
    is_dropped = np.zeros(len(columns), dtype=np.bool_)
    for motion, reason in (*unknown_motions, *sync_motions):
        reasons[int(columns.trace_row[motion])] = reason
        is_dropped[motion] = True
    # calls that RESUME may break off; without the option, motions that depend on them are refused later
    interruptible_rows = [row for row, _ in run.interruptible_calls] if run.keeps_unresolved else []
    if not reasons and not run.untraced_calls and not interruptible_rows:
        return SeparatedMotions(sequence)
    unknown_pose_rows = sorted({*reasons, *(call.row for call in run.untraced_calls), *interruptible_rows})
    open_motions = _drop_dependent_motions(follower, sequence, unknown_pose_rows, is_dropped, reasons)
    if is_dropped.all():
        raise reasons[min(reasons)]  # the reason of the first row
    # the use of a point by an uncorrected motion is not followed: the point must keep its value
    for motion in sequence.moves.keys() & np.flatnonzero(is_dropped).tolist():
        move = sequence.moves[motion]
        run.followed_names -= {(move.trace_row, point.start) for point in (move.end, move.via) if point is not None}
    corrected_motions = _without_rows(sequence, is_dropped)
    new_index = np.cumsum(~is_dropped) - 1  # index of each corrected motion among the corrected ones
    begins = [int(new_index[motion]) for motion in sorted(open_motions) if motion < len(columns)]
    predecessors = np.arange(len(corrected_motions.columns)) - 1
    predecessors[begins] = begins  # the motion itself: its start is not known
    unresolved, issues = _report_unresolved(follower, reasons)
    return SeparatedMotions(
        corrected_motions,
        predecessors,
        unresolved,
        (*issues, *_open_start_warnings(follower, corrected_motions, begins)),
    )


def _drop_dependent_motions(
    follower: TraceFollower,
    sequence: OrderedMotions,
    unknown_pose_rows: Sequence[int],
    is_dropped: Bools,
    reasons: dict[int, ProgramError],
) -> set[int]:
    """Drop the motions whose path depends on an unknown start pose, one after the other.

    :param unknown_pose_rows: rows of the trace after which the robot pose is not known.
    :param is_dropped: (M,) True for motions that stay uncorrected; set to True for dropped motions.
    :param reasons: row of the trace → why its motion stays uncorrected; dropped motions are added.
    :returns: the first motion behind each such row that is corrected all the same, because its path does not depend on
        its start pose; M if there is none.
    """
    columns, open_motions = sequence.columns, set[int]()
    for pose_row in unknown_pose_rows:
        motion = int(np.searchsorted(columns.trace_row, pose_row, side="right"))  # the next motion
        while motion < len(columns) and (is_dropped[motion] or depends_on_start(sequence, motion)):
            if not is_dropped[motion]:
                row = int(columns.trace_row[motion])
                reasons[row] = follower.run.trace.error(_UNKNOWN_START, row)
            is_dropped[motion] = True
            motion += 1
        open_motions.add(motion)
    return open_motions


def _without_rows(sequence: OrderedMotions, is_dropped: Bools) -> OrderedMotions:
    """Return the motions that are not dropped.

    :param is_dropped: (M,) True for motions that are dropped.
    """
    is_kept = ~is_dropped
    new_index = np.cumsum(is_kept) - 1  # index of each kept motion among the kept ones
    return OrderedMotions(
        columns=sequence.columns.take(is_kept),
        motion_states=sequence.motion_states.take(is_kept),
        numbers=sequence.numbers.of_rows(is_kept),
        moves={int(new_index[motion]): move for motion, move in sequence.moves.items() if is_kept[motion]},
    )


def _synchronised_motions(follower: TraceFollower, trace_row: Ints) -> Iterator[tuple[int, ProgramError]]:
    """Yield the motions during which another robot may move in time with this robot: the index of each, and its error.

    These are the motions between two SYNCCMD. `SYNCCMD(#PROGSYNC, …)` only lets the programs of the robots wait for
    each other: behind the last of these each robot goes on alone. Any other SYNCCMD, also in a called routine, is taken
    to hold to the end of the program (KUKA.RoboTeam; its manual is not public).

    :param trace_row: (M,) rows of the motions in the trace.
    """
    trace, sync_lines = follower.run.trace, _sync_lines(follower)
    if not sync_lines:
        return
    # between two lines, and behind the last one unless the programs only wait there
    sections = [
        (begin.row, end.row, f"between SYNCCMD ({trace.place(begin.row)}) and SYNCCMD ({trace.place(end.row)})")
        for begin, end in pairwise(sync_lines)
    ]
    last = sync_lines[-1]
    if not last.only_waits:
        sections.append((last.row, len(trace) + 1, f"behind SYNCCMD ({trace.place(last.row)})"))
    for begin, end, section_text in sections:
        # row `end` counts: the row before a LOOP, see `_sync_lines`, may be a motion
        for motion in np.flatnonzero((trace_row > begin) & (trace_row <= end)).tolist():
            problem = f"the motion is {section_text}: another robot may move in time with it"
            yield motion, trace.error(problem, int(trace_row[motion]), _SYNC_ADVICE)


class _SyncLine(NamedTuple):
    """A line of the trace that synchronises robots.

    :ivar row: row of the trace.
    :ivar only_waits: True if the programs of the robots only wait for each other there.
    """

    row: int
    only_waits: bool


def _sync_lines(follower: TraceFollower) -> list[_SyncLine]:
    """Return the lines of the trace that synchronise robots, in order.

    If a LOOP without EXIT contains such lines, the lines before and behind its round are returned too.

    :returns: empty if no file that has been read synchronises robots.
    """
    execution, trace = follower.execution, follower.execution.trace
    if (words := _sync_words(follower)) is None:
        return []
    entry_rows = {step.row for step in execution.steps if isinstance(step, RoutineEntry)}
    sync_lines = []
    for row in range(execution.body.first, execution.body.stop):
        # rows that set the counter of a FOR are no lines of the file
        if not trace.is_counter_row[row - 1] and (execution.may_run is None or execution.may_run[row - 1]):
            word = _sync_word(*trace.place(row), words.names, is_entered=row in entry_rows)
            if word:  # else the line does not synchronise robots
                only_waits = not words.may_run_later and (words.only_wait or word == _WAIT_WORD)
                sync_lines.append(_SyncLine(row, only_waits))
    loop = execution.endless_loop
    # a section may begin in one round and end in the next
    if loop is not None and any(loop.first <= line.row < loop.stop for line in sync_lines):
        sync_lines += [_SyncLine(loop.first - 1, only_waits=True), _SyncLine(loop.stop, only_waits=True)]
    return sorted(sync_lines)


class _SyncWords(NamedTuple):
    """How the files of a program synchronise robots.

    :ivar names: names, upper case, of the routines that synchronise robots, by their own lines or by calls.
    :ivar only_wait: True if the programs of the robots only wait for each other at all SYNCCMD.
    :ivar may_run_later: True if a SYNCCMD is in the action of an INTERRUPT or a TRIGGER: it may run at any time behind
        its declaration.
    """

    names: frozenset[str]
    only_wait: bool
    may_run_later: bool


def _sync_words(follower: TraceFollower) -> _SyncWords | None:
    """Return how the files of a program synchronise robots; None if no file that has been read does."""
    run = follower.run
    modules = [run.library.program, *run.library.read_modules()]
    if not any(_synchronises(module.source.text) for module in modules):
        return None
    routines = [(module, routine) for module in modules for routine in module.routines.values()]
    words_of_routine = {
        routine: {_sync_word(routine.source, line) for line in routine.statement_lines} - {""}
        for _, routine in routines
    }
    sync_routines = {routine for routine, words in words_of_routine.items() if words}
    names = frozenset(
        routine.name.upper()
        for module, routine in routines
        if not sync_routines.isdisjoint(run.analysis.reachable_routines(module, routine))
    )
    return _SyncWords(
        names,
        only_wait=set().union(*words_of_routine.values()) <= {_WAIT_WORD},
        may_run_later=any(
            isinstance(statement(routine.source, line), Event) and _sync_word(routine.source, line, names)
            for _, routine in routines
            for line in routine.statement_lines
        ),
    )


def _synchronises(text: str, size: int = _SEARCH_LENGTH) -> bool:
    """Return whether a text has one of the words that synchronise robots, also in comments and strings.

    :param size: number of characters that are searched at once.
    """
    # sections overlap by the length of a word
    sections = (
        text[offset : offset + size + max(map(len, SYNCHRONISING))].upper() for offset in range(0, len(text), size)
    )
    return any(name in section for section in sections for name in SYNCHRONISING)


def _sync_word(source: Source, line: int, names: Collection[str] = (), *, is_entered: bool = False) -> str:
    """Return how a line synchronises robots: the first argument of its SYNCCMD, if that is a word.

    :param names: names of the routines that synchronise robots: a line that names one of them synchronises too.
    :param is_entered: True if the statements of the called routine are in the trace themselves; then the call does not
        count, but its arguments do.
    :returns: empty if the line does not synchronise robots. `_OTHER_SYNC` if it does so otherwise than by SYNCCMD with
        a word, or cannot be read.
    """
    start, stop = source.code_span(line)
    if not (names or _synchronises(source.text[start:stop])):
        return ""
    stmt = statement(source, line)
    try:
        values = stmt.call.arguments if is_entered and isinstance(stmt, CallStatement) else stmt.values
        references = [part for part in walk(values) if isinstance(part, Call | Reference)]
    except ProgramError:
        return _OTHER_SYNC
    if all(part.name not in SYNCHRONISING and part.name not in names for part in references):
        return ""
    call = stmt.call if isinstance(stmt, CallStatement) and stmt.call.name in SYNCHRONISING else None
    argument = call.arguments[0] if call is not None and call.arguments else None
    return argument.text if isinstance(argument, Word) else _OTHER_SYNC


def depends_on_start(sequence: OrderedMotions, motion: int, *, arcs: bool = True) -> bool:
    """Return whether the target of a motion, or the shape of its arc, depends on where the motion begins.

    True under #CONSTANT, which keeps the orientation of the start, for circles, SPL and relative motions, and if the
    target lacks components, which keep their previous value.

    :param arcs: False to disregard the shape of arcs: circles with complete points and without CA do not count then.
    """
    kind = sequence.columns.kind[motion]
    keeps_orientation = kind != PTP and sequence.motion_states.at(motion).orientation == CONSTANT
    if keeps_orientation or kind == SPL or (arcs and kind == CIRC):
        return True
    move = sequence.moves.get(motion)
    if move is None:  # a plain motion: only its target may lack components
        return bool(np.isnan(sequence.columns.numbers[motion]).any())
    has_circular_angle = move.angle is not None  # CA: the arc begins at the start and turns by this angle
    is_relative = bool(move.relative_axes)
    return has_circular_angle or is_relative or move.is_via_incomplete or not move.end.position.is_complete


def _report_unresolved(
    follower: TraceFollower, reasons: dict[int, ProgramError]
) -> tuple[tuple[UnresolvedMotion, ...], list[Issue]]:
    """Return each uncorrected line of a file once, and a warning on each.

    :param reasons: row of the trace → why its motion stays uncorrected.
    """
    motion_of_line: dict[str, UnresolvedMotion] = {}  # by file and line
    issues = []
    for row, reason in sorted(reasons.items()):
        origin = follower.run.trace.place(row)
        if str(origin) in motion_of_line:  # a line that runs more than once
            continue
        reported_line: int | None = follower.run.trace.reported_line(row)
        text = origin.source.text[slice(*origin.source.code_span(origin.line))]
        motion_of_line[str(origin)] = UnresolvedMotion(origin.source.document.name, origin.line, text, reason.problem)
        suffix = _SHIFT_TEXT if _depends_on_position(follower, row, reason) else ""
        is_in_other_file = origin.source is not follower.run.routine.source
        prefix, reported_line = (f"{origin}: ", None) if is_in_other_file else ("", reported_line)
        message = f"{prefix}stays as it is, uncorrected: {text!r} ({reason.problem}){suffix}"
        issues.append(Issue("warning", "unresolved", message, reported_line, subject=str(origin)))
    return tuple(motion_of_line.values()), issues


def _depends_on_position(follower: TraceFollower, row: int, reason: ProgramError) -> bool:
    """Return whether an uncorrected motion, or the first target of a called routine, depends on the robot position.

    :param row: row of the trace with the motion or the call.
    :param reason: why it stays uncorrected; its text may name a variable with the robot position.
    """
    stmt = statement(*follower.run.trace.place(row))
    if row in follower.run.position_dependent_calls or (isinstance(stmt, Motion) and depends_on_position(stmt)):
        return True
    may_use_position = PARTLY_GIVEN in reason.problem or any(name in reason.problem.upper() for name in ROBOT_POSITIONS)
    return isinstance(stmt, Motion) and may_use_position


def _open_start_warnings(follower: TraceFollower, sequence: OrderedMotions, motions: list[int]) -> Iterator[Issue]:
    """Yield warnings on motions with an unknown start: one for each line of other files, one for the program itself.

    :param motions: indices of these motions in `sequence`.
    """
    trace = follower.run.trace
    place_of_row = {row: trace.place(row) for row in sequence.columns.trace_row[motions].tolist()}
    program_rows = [row for row, place in place_of_row.items() if place.source is follower.run.routine.source]
    for name in {str(place): None for row, place in place_of_row.items() if row not in program_rows}:
        yield Issue("warning", "start-unknown", f"{name}: {_OPEN_START_MESSAGE}", subject=name)
    if program_rows:
        lines = distinct(trace.reported_lines[np.array(program_rows) - 1]).tolist()
        yield Issue(
            "warning", "start-unknown", _OPEN_START_MESSAGE, lines[0], count=len(program_rows), lines=tuple(lines)
        )
