"""Operations of a program: the runs of motions that CAM made as one step, with their names and tools.

An operation begins at a tool change, at another `$TOOL` or `$BASE`, or at a comment on a line of its own. Its name is
the comment: with a tool change the last one before it (Fusion, Mastercam, SolidCAM), else the first one after it
(CamBam, FreeCAD). A program that says ``begin operation: NAME`` (FreeCAD) names all of its operations that way.
Comments about files, dates, tools, machines and single moves are not names. In a program with very many comments only
those at retracts count, or none.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import groupby, islice, zip_longest
from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct

from postproc.program import FORCE_COMMENT, Event, Ints, Program

_BEGIN_OPERATION = re.compile(r"\s*(?:begin|start)\s+operation\s*[:=]\s*(.*)", re.IGNORECASE)
_END_OPERATION = re.compile(r"\s*(?:finish|end)\s+operation\s*[:=]\s*(.*)", re.IGNORECASE)
_OPERATION_PREFIX = re.compile(r"\s*(?:operation|toolpath|op)\s*(?:\d+\s*)?[:=]", re.IGNORECASE)
_NAME_PREFIX = re.compile(r"\A\s*(?:(?:operation|toolpath|op)\s*(?:\d+\s*)?[:=]\s*-?|[-=*]+)\s*", re.IGNORECASE)
_NO_NAME = re.compile(
    r"(?:T\s*\d+\b|tools?\b|dia|end ?mill\b.*:|exported|post|output|generated|created|made\s|using\b|programm?\b|this\b"
    r"|date|time|machin(?:e|ing time)|material|vendor|model\b|descri|units?\b|files?\b|cam\b|version|author|stock"
    r"|total|estimated|cutting|target\b|set\b|origin|home|safe|spindle|coolant|feed|rapid|lead|ramp|retract|plunge"
    r"|helix\b|layer|level|pass\b|compensat|begin\b|end\b|toolpaths\b|min\b|max\b|mm\b|inch|metric|millimet"
    r"|[XYZ]\s*[-=:]|notes?\b|warning|uncomment|change\b|load\b|wcs\b|G5\d|N\d+\b|absolute|incremental|header"
    r"|footer|disable|select|cancel|sign\b|for mach|move to|job\b|all\b|rpm\b|pycam|software|project\b|#)"
    r"|[\d.\s\-/:]*$|.*\b\d{1,2}:\d\d\b|.*\b\d{4}-\d\d-\d\d|.*\b\d{1,2}[./]\d{1,2}[./]\d{4}|.*=|.*www\.",
    re.IGNORECASE,
)
"""Comments that are no names: tools, headers of files, dates, assignments, and remarks on single moves."""
_END_MILLING = re.compile(r"end ?mill(?:ing)? +\D+$", re.IGNORECASE)
"""Milling with an end mill: a name after a retract, though comments that begin with "end" are none."""
_LINE_OF_COMMENT = re.compile(r"\s*/?\s*(?:N\s*\d+)?\s*[(;]", re.IGNORECASE)
_MOST_OPERATIONS = 60
"""More operations than this are remarks on single moves (assumed)."""
_PIECE = 2**20
"""Characters that are divided into lines at once: a text of 100 MB then needs no second copy of itself."""


Names = Literal["all", "retracts", "none"]


class Operation(Struct, frozen=True):
    """A run of motions of a program.

    :param name: its comment; without one the tool (``"T3"``, see `tool_text`), or a number (``"operation 2"``).
    :param tool: number of the last tool change before it; row of `Program.tools` from 1 of robot programs; 0 = none.
    :param first: row of its first motion, `last` of its last one.
    :param line: 1-based line of the main file with its comment or tool change; 1 at the start of the program.
    """

    name: str
    tool: int
    first: int
    last: int
    line: int


def operations(program: Program, *, at_retracts: bool = False) -> tuple[Operation, ...]:
    """Return the operations of a program in the order of execution; together they contain every motion.

    Runs without a cutting motion (approaches, tool changes) belong to the operation that follows.

    :param at_retracts: leave out comments between two cutting motions, unless a blank line precedes them.
    """
    candidates: tuple[Operation, ...] = ()
    # fewer and fewer comments count, until operations are few enough not to be remarks on single moves
    choices: tuple[Names, ...] = ("retracts",) if at_retracts else ("all", "retracts", "none")
    for names in choices:
        candidates = tuple(_join_operations(program, _operation_starts(program, names)))
        if len(candidates) <= _MOST_OPERATIONS:
            break
    return candidates


def operation_indices(operations_in_order: tuple[Operation, ...], motion: Ints) -> Ints:
    """Return the place in `operations_in_order` of the operation of each motion (n,)."""
    return np.asarray(np.searchsorted([operation.first for operation in operations_in_order], motion, side="right") - 1)


def tool_text(program: Program, tool: int) -> str:
    """Return the tool of an operation as its program writes it, see `Program.tool_text`; empty: it is unknown.

    :param tool: see `Operation.tool`.
    """
    if not tool:
        return ""
    keys = program.tool_keys[tool - 1] if program.tool_keys else ()
    return " or ".join(map(program.tool_text, keys)) or f"T{tool}"


def title(comment: str) -> str:
    """Return the name of an operation in a comment, without the words around it, blanks made one.

    >>> title("begin operation:  Contour  2"), title("Toolpath:- Profile 1"), title("2D Pocket1")
    ('Contour 2', 'Profile 1', '2D Pocket1')
    """
    explicit = _BEGIN_OPERATION.match(comment)
    text = explicit[1] if explicit else _NAME_PREFIX.sub("", comment, count=1)
    name = " ".join(text.split()).strip("-=* ")
    return name if re.search(r"[^\W\d]", name) else " ".join(comment.split())


def finished_operation(comment: str) -> str | None:
    """Return the name in ``finish operation: NAME``, None for every other comment."""
    match = _END_OPERATION.match(comment)
    return None if match is None else " ".join(match[1].split())


def ignored_comments(program: Program) -> tuple[Event, ...]:
    """Return comments that begin no operation of ``operations(at_retracts=True)``, but could be names.

    Those are alone on their line and, after a retract, read like remarks ("pass 2"); or they read like names, and are
    between two cutting motions. Programs that mark operations with ``begin operation`` have none.
    """
    rows = len(program.motions)
    comments = [event for event in program.events if event.kind == "comment" and 0 < event.before < rows]
    lines = _numbered_lines(program, comments)
    comments_without_operation: list[Event] = []
    if any(_BEGIN_OPERATION.match(event.text) for event in comments):
        return ()
    for event in _separate_events(comments, lines):
        name = title(event.text)
        is_name = _naming_comment([event], is_first=False, is_explicit=False) is not None
        is_remark = (
            name and not is_name and not FORCE_COMMENT.match(event.text) and not _END_OPERATION.match(event.text)
        )
        is_at_retract = _is_at_retract(program, event.before, [event], lines, has_change=False)
        is_ignored_name, is_ignored_remark = is_name and not is_at_retract, is_remark and is_at_retract
        if is_ignored_name or is_ignored_remark:
            comments_without_operation.append(event)
    return tuple(comments_without_operation)


def _is_name(comment: str) -> bool:
    """Return whether a comment reads like the name of an operation."""
    remark = _NO_NAME.match(title(comment)) or FORCE_COMMENT.match(comment) or _END_OPERATION.match(comment)
    return bool(comment.strip()) and not remark


class _Start(NamedTuple):
    """Where an operation begins, or may begin.

    :param row: its first motion.
    :param name: of the operation; empty: it has none of its own.
    :param tool: see `Operation.tool`.
    :param line: 1-based line of its comment or tool change, else of its first motion; 1 at the start of the program.
    """

    row: int
    name: str
    tool: int
    line: int


def _operation_starts(program: Program, names: Names) -> Iterator[_Start]:
    """Yield where operations may begin, in order: at the first motion, at other frames, at comments and tool changes.

    :param names: which comments name operations.
    """
    motions = program.motions
    boundary_events = [
        event for event in program.events if event.kind in ("comment", "tool_change") and event.before < len(motions)
    ]
    # first motions with another `$BASE` or `$TOOL` than the motion before
    frame_changes = np.flatnonzero((np.diff(motions.base) != 0) | (np.diff(motions.tool) != 0)) + 1
    no_name = ""
    starts = {0: (no_name, 1)} | {row: (no_name, int(motions.line[row])) for row in frame_changes.tolist()}
    starts |= _starts_at_events(program, boundary_events, names)
    rows = sorted(starts)
    for row, tool in zip(rows, _tools_at(program, boundary_events, rows), strict=True):
        name, line = starts[row]
        yield _Start(row, name, tool, line)


def _starts_at_events(program: Program, boundary_events: list[Event], names: Names) -> dict[int, tuple[str, int]]:
    """Return name (empty: none) and line of operations that comments or tool changes begin, by their first motion.

    :param boundary_events: comments and tool changes.
    :param names: which comments name operations.
    """
    is_explicit = any(event.kind == "comment" and _BEGIN_OPERATION.match(event.text) for event in boundary_events)
    lines = _numbered_lines(program, boundary_events)
    starts: dict[int, tuple[str, int]] = {}
    for row, group in groupby(sorted(boundary_events, key=lambda event: event.before), key=lambda event: event.before):
        events = list(group)
        changes = [event for event in events if event.kind == "tool_change"]
        candidates = events if is_explicit else _separate_events(events, lines)
        is_left_out = names == "none" or (
            names == "retracts"
            and not is_explicit
            and not _is_at_retract(program, row, candidates, lines, has_change=bool(changes))
        )
        comment = None if is_left_out else _naming_comment(candidates, is_first=row == 0, is_explicit=is_explicit)
        if comment is not None:
            starts[row] = (title(comment.text), comment.line)
        elif changes:
            starts[row] = ("", changes[-1].line)
    return starts


def _tools_at(program: Program, boundary_events: list[Event], rows: list[int]) -> list[int]:
    """Return the tool of the operations that begin at motions, see `Operation.tool`.

    :param boundary_events: comments and tool changes.
    :param rows: the motions.
    """
    changes = sorted(
        (event for event in boundary_events if event.kind == "tool_change"), key=lambda event: event.before
    )
    if changes:
        numbers = np.array([0, *(int(event.value) for event in changes)])  # 0 before the first change
        counts = np.searchsorted([event.before for event in changes], rows, side="right")
        return [int(number) for number in numbers[counts]]
    # a robot program has no tool changes: its tools are rows of `Program.tools`, counted from 1
    return [int(row) + 1 for row in program.motions.tool[rows]] if program.keeps_text else [0] * len(rows)


def _numbered_lines(program: Program, events: list[Event]) -> dict[int, str]:
    """Return the lines of some events, and those before them: number → text."""
    line_numbers = {line for event in events for line in (event.line - 1, event.line)}
    numbered_lines = enumerate(text_lines(program.documents[0].text) if program.documents else (), start=1)
    return {
        number: line for number, line in islice(numbered_lines, max(line_numbers, default=0)) if number in line_numbers
    }


def text_lines(text: str, piece: int = _PIECE) -> Iterator[str]:
    """Yield the lines of a text; of a long one there are never all at once.

    :param piece: characters that are divided at once, and those up to the end of the line.
    """
    start = 0
    while start < len(text):
        stop = text.find("\n", start + piece) + 1 or len(text)
        yield from text[start:stop].splitlines()
        start = stop


def _separate_events(events: list[Event], lines: dict[int, str]) -> list[Event]:
    """Return the tool changes, and the comments that are alone on their line."""
    return [
        event
        for event in events
        if event.kind == "tool_change"
        or event.line not in lines
        or event.text not in lines[event.line]
        or _LINE_OF_COMMENT.match(lines[event.line])
    ]


def _is_at_retract(program: Program, row: int, events: list[Event], lines: dict[int, str], *, has_change: bool) -> bool:
    """Return whether comments before motion `row` may name an operation: not if they are between two cutting motions.

    Even there they may after a blank line, at a tool change and at the beginning of the program.

    :param events: the events before the motion.
    :param lines: of the events, and those before them: number → text.
    :param has_change: True if there is a tool change before the motion, after the one before it.
    """
    rapid = program.motions.rapid
    if row == 0 or has_change or rapid[row] or rapid[row - 1]:
        return True
    return any(event.line in lines and not lines.get(event.line - 1, "none").strip() for event in events)


def _naming_comment(events: list[Event], *, is_first: bool, is_explicit: bool) -> Event | None:
    """Return the comment that names an operation, or None.

    :param events: comments and tool changes before a motion.
    :param is_first: True if the motion is the first of the program.
    :param is_explicit: True if the program marks operations with ``begin operation``: other comments then name none.
    """
    if is_explicit:
        return next(
            (event for event in reversed(events) if event.kind == "comment" and _BEGIN_OPERATION.match(event.text)),
            None,
        )
    last_change = max((k for k, event in enumerate(events) if event.kind == "tool_change"), default=None)
    names_before_change: list[Event] = []
    names_after_change: list[Event] = []
    for index, event in enumerate(events):
        if event.kind == "tool_change":
            continue
        if _OPERATION_PREFIX.match(event.text):
            return event
        # "end milling" is a name, though comments that begin with "end" are not
        is_milling = last_change is None and not is_first and bool(_END_MILLING.match(title(event.text)))
        if is_milling or _is_name(event.text):
            is_before = last_change is None or index < last_change
            (names_before_change if is_before else names_after_change).append(event)
    if not names_before_change:
        return next(iter(names_after_change), None)
    # without a tool change, a header precedes the first operation, and remarks follow the name of the others
    return names_before_change[-1 if last_change is not None or is_first else 0]


def _join_operations(program: Program, starts: Iterable[_Start]) -> Iterator[Operation]:
    """Yield operations from the places where they may begin.

    A start without a cutting motion belongs to the operation that follows; neighbours with one name and tool are one.
    """
    runs: list[_Start] = []
    for start in _cutting_starts(program, list(starts)):
        if not runs or (start.name, start.tool) != (runs[-1].name, runs[-1].tool):
            runs.append(start)
    for number, (run, next_run) in enumerate(zip_longest(runs, runs[1:]), start=1):
        name = run.name or tool_text(program, run.tool) or f"operation {number}"
        last_row = (len(program.motions) if next_run is None else next_run.row) - 1
        yield Operation(name, run.tool, run.row, last_row, run.line)


def _cutting_starts(program: Program, starts: list[_Start]) -> Iterator[_Start]:
    """Yield the starts whose motions cut, each from the first motion on that belongs to no operation before.

    A start without a name, such as a change of frames, goes on with the operation before it.

    :param starts: all starts, in order.
    """
    count = len(program.motions)
    cuts_before = np.concatenate([[0], np.cumsum(~program.motions.rapid)])  # number of cutting motions before each
    stops = [*(start.row for start in starts[1:]), count]
    # `begin`: first motion of the operation that is not complete yet; −1: no tool yet
    begin, name, last_tool, has_new_name = 0, "", -1, False
    for start, stop in zip(starts, stops, strict=True):
        if start.tool != last_tool:
            # between a comment and its tool change there may be a move to home: its name is that of this operation
            name, last_tool = name if has_new_name else "", start.tool
        name = start.name or name
        has_new_name = has_new_name or bool(start.name)
        has_cut = cuts_before[stop] > cuts_before[start.row]
        if not has_cut and stop < count:
            continue
        yield _Start(begin, name, start.tool, start.line)
        begin, has_new_name = stop, False
