"""Reader of G-code programs: from a document to a `Program`.

Subprograms, loops and expressions are executed first (`execution`), which gives plain lines in execution order. Then
comments, line ends and white space are removed (`words`). Plain motion blocks become columns of numbers in bulk;
pygcode reads the other blocks (`words`), which change modes or make events (`modes`). Modal values are carried forward
over all lines at once and become motions (`moves`, `path`, `arcs`). Unknown codes, and codes whose motion is not
supported, are errors (`codes`).

X, Y, Z are the tool tip in the program frame: `$BASE`, moved by the active work offset. The tool axis points along −Z
of that frame.

Rapid moves before X, Y and Z have all been programmed are held back: the missing axes are unknown, and the current
position of the robot is not an answer (it may be below the part). ``G0 X20 Y20`` and then ``G0 Z5`` become one motion
to X20 Y20 Z5, on the line of the second. The same holds for a G1 that goes up to the highest Z of the program, if that
is above zero and above another Z: else it may be that of a cut.

This reader accepts more than LinuxCNC's rs274: text after an opening ``%``, a closing ``%`` without an opening one, a
missing M2, ``/2`` as block delete, lone CR as line end, a byte order mark, N after a comment, any tool number, more
than four M codes in a block, G94 without a new F, an arc's offset of zero across its plane, A0 (B, C, U, V, W) without
effect, M98 and CALL to files with other names than LinuxCNC's, G15, G40.1, G50, G50.1 and G69, G5.1 Q, G187 and the
like, ``:1001``, coordinates after G80 without G0 at the height of rapid moves (Fanuc: a rapid), G41 and G42 with D0,
brackets in comments, a G28 among G0 and G91, the time of G4 in X, U, F or S, M3 P, MSG "…", G53 alone, L0 of a cycle.
F of a block with G20 or G21 is in the new units (rs274: in those before), and cycles without G98 or G99 retract to the
height before them (rs274: to R). It accepts less: a relative move, an arc, a cycle (unless it gives X and Y itself) or
a change of the work offset before X, Y and Z have been programmed (rs274 begins at zero), a G1 after a G0 before that
(a program that begins with G1 begins at `[start]`), an origin or an increment from a place of the machine (G92, G10
L20, G91 after G28, G30 and G53), parameters that the program has not set, coordinates after a closing ``%``, signs
like ``--1``, decimals in N, an arc in the block of a G4, numbers of 10⁷ and more, a program without motion, and every
code that `codes` refuses. Each of these has a test. In G18 and G19 rs274 confuses the axes of G84.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.dialects.cell_lines import events_with_waits
from postproc.dialects.dialect import CamFormat
from postproc.dialects.gcode import words
from postproc.dialects.gcode.codes import WORK_OFFSETS
from postproc.dialects.gcode.execution import ExecutedProgram, execute
from postproc.dialects.gcode.line_states import line_states_of
from postproc.dialects.gcode.modes import Modes, read_modes
from postproc.dialects.gcode.moves import CellFrames
from postproc.dialects.gcode.path import CHORD_TOLERANCE_SHARE, MotionPath, Speeds, read_path
from postproc.dialects.gcode.rotary import RotaryAxes
from postproc.dialects.gcode.subprograms import called_files
from postproc.dialects.gcode.survey import survey
from postproc.dialects.gcode.words import Fault
from postproc.dialects.text import decode, line_spans
from postproc.errors import ForceError, InputError, Issue, ProgramError, combined_error
from postproc.frames import M_PER_MM, MM_PER_M, MM_PER_MIN, RAD_PER_DEG, Array, inverse
from postproc.program import Document, Event, EventKind, ForceNote, Program, distinct, parse_force_note

__all__ = ["decode", "read"]

_INCH_DECIMALS, _INCH_SIZE, _INCH_FEED = 4, 40.0, 150.0
"""Decimals of coordinates in inches; size of cuts [mm] and feed [mm/min] below which a program without G20 and G21 is
questioned (assumed): a part of 40 mm cut at 150 mm/min needs no robot, a part of 40 inches does.
"""
_DECIMALS = re.compile(r"[XYZ][ \t]*[-+]?[0-9]*\.([0-9]+)", re.IGNORECASE)
_SAMPLE_LENGTH = 100_000
"""Characters in which decimals are looked for."""
SPINDLE_ON = ("spindle_on", "spindle_ccw")


def read(document: Document, cell: Cell, forward_kinematics: Callable[[Array], Array], name: str) -> Program:
    """Read a G-code program.

    The first motion, if rapid, is `PTP` (from wherever the robot is); later rapid ones are `LIN` with
    ``rapid``. Arcs are `CIRC` with centre and end as programmed; their radii at start and end may differ by LinuxCNC's
    tolerance. Moves that go nowhere are left out (issue ``"null-move"``). Rapid moves before X, Y and Z have all been
    programmed are held back until they have (issue ``"start-position"``). The lines of both are in `Program.still`.

    :param document: the program, see `decode`.
    :param cell: `$BASE`, `$TOOL`, work offsets, speed of rapid moves, approximation distance.
    :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
    :param name: name of the program.
    :returns: poses and lengths in metres, feeds in m/s, as `Motions` says.
    :raises InputError: `ProgramError` with file, line, text and advice: a code is not supported or not known, a word
        cannot be read, an arc is impossible, a cutting move has no feed or comes before X, Y and Z have been programmed
        in rapid moves, the program is cut off, it moves nothing, or it is for another control; `ForceError`: a force
        comment cannot be read. All that is wrong is raised together, see `errors.combined_error`.
    """
    return _read(document, cell, forward_kinematics, name, bulk=True)


def _read(
    document: Document, cell: Cell, forward_kinematics: Callable[[Array], Array], name: str, *, bulk: bool
) -> Program:
    """Read a document. If its only faults are arcs whose radii disagree, read it once more with absolute centres.

    Some posts write I, J, K as coordinates, as after G90.1, and do not state it. If the second reading fails too, the
    faults of the first one are raised.

    :param bulk: read plain motion blocks together, else each block by pygcode (for tests).
    :raises InputError: the program has faults, see `read`.
    """
    read_document, issues = _blank_leader(document)
    try:
        program = _executed_program(read_document, cell, forward_kinematics, name, bulk=bulk)
    except InputError as cause:
        if not all(
            getattr(error, "problem", "").startswith(_RADIUS_PROBLEM) for error in (cause, *cause.further_errors)
        ):
            raise
        try:
            program = _executed_program(
                read_document, cell, forward_kinematics, name, bulk=bulk, has_absolute_centres=True
            )
        except InputError:
            raise cause from None
    if issues:
        program = replace(program, documents=(document, *program.documents[1:]), issues=(*program.issues, *issues))
    return program


_RADIUS_PROBLEM = "radii of the arc disagree"
_ABSOLUTE_CENTRES_MESSAGE = (
    "I, J and K are taken as coordinates of the centre, as after G90.1, which the program does not state: only so do "
    "the radii of its arcs agree."
)
_WORD = re.compile(r"(?<![A-Za-z])[A-Z][ \t]*[-+]?\.?[0-9#\[]", re.IGNORECASE)
_COMMENT = re.compile(r"\([^()\r\n]*\)|;[^\r\n]*")


def _blank_leader(document: Document) -> tuple[Document, list[Issue]]:
    """Return a program with blanks in place of the text before its first %, which controls do not read, and a remark.

    A program without such text is returned as it is, without a remark. So is a program with words such as G1 or X5
    before the first %, which then ends it. The % is only looked for in the first `_LEADER_LINES` lines.
    """
    starts, stops = line_spans(document.text)
    spans = zip(starts[:_LEADER_LINES], stops[:_LEADER_LINES], strict=True)
    lines = [document.text[start:stop].strip() for start, stop in spans]
    percent_row = next((row for row, line in enumerate(lines) if line == "%"), 0)
    code = [_COMMENT.sub("", line) for line in lines[:percent_row]]
    if not any(code) or any(_WORD.search(line) for line in code):
        return document, []
    end = int(starts[percent_row])
    blank = re.sub(r"[^\r\n]", " ", document.text[:end])
    message = "The text before the first % is not read."
    row = next(row for row, line in enumerate(code) if line)  # the first line that is not empty
    return replace(document, text=blank + document.text[end:]), [Issue("info", "leader", message, row + 1)]


_LEADER_LINES = 200
"""Lines in which a first % is looked for."""


def _executed_program(
    document: Document,
    cell: Cell,
    forward_kinematics: Callable[[Array], Array],
    name: str,
    *,
    bulk: bool,
    has_absolute_centres: bool = False,
) -> Program:
    """Execute and read a program, see `read`.

    :param bulk: see `_read`.
    :param has_absolute_centres: read centres of arcs as coordinates, though the program does not say so; add a remark.
    :raises InputError: the program has faults.
    """
    run = execute(document)
    source = run.source
    rotary = "" if cell.rotary is None else "".join(cell.rotary.axes)
    # words of the plain motion blocks, and rows of all others, whose words `read_modes` adds
    line_words, other_rows = words.read_plain(source, rotary) if bulk else words.no_plain_words(source)
    modes = read_modes(source, other_rows, line_words, cell, run.faults)
    lines = line_states_of(line_words, modes, cell.rotary)
    if has_absolute_centres and not modes.changes["centre"]:
        lines = replace(lines, has_absolute_centre=np.ones(len(lines.motion), dtype=np.bool_))
    tools = _tools(cell, modes)
    path = read_path(lines, modes, _cell_frames(cell, forward_kinematics, tools), _speeds(cell), cell.rotary)
    comments, force_faults = _comments(run, modes.row_count)
    path = _checked_path(path, modes, run, force_faults)
    notes, events = _events(run, path, modes, comments)
    events, wait_issues = events_with_waits(events, path.motions, document.folder, cell)
    line = run.main_line[path.row]
    line.flags.writeable = False
    return Program(
        name=name,
        dialect="gcode",
        documents=run.documents,
        motions=replace(path.motions, line=line),
        bases=cell.base.pose()[None],
        tools=np.stack(list(tools.values())),
        notes=notes,
        events=events,
        swivel=path.swivel,
        unforced=path.unforced,
        still=distinct(run.main_line[path.still_rows]),
        issues=(
            *_program_issues(run, path, modes, document.text, comments),
            *wait_issues,
            *([Issue("info", "absolute-centres", _ABSOLUTE_CENTRES_MESSAGE)] if has_absolute_centres else []),
        ),
    )


def _program_issues(
    run: ExecutedProgram, path: MotionPath, modes: Modes, text: str, comments: Sequence[tuple[int, str | ForceNote]]
) -> Iterator[Issue]:
    """Yield remarks on how a program was read, with line numbers of the program.

    :param text: text of the program; `comments`: row and content of its comments.
    """
    for issue in (*_reading_issues(path, modes, text), *modes.issues, *_bracket_issues(run, comments)):
        yield replace(issue, source_line=_program_line(run, issue.source_line))
    yield from _late_code_issues(run, modes.row_count)


def _checked_path(
    path: MotionPath | list[Fault], modes: Modes, run: ExecutedProgram, force_faults: Sequence[InputError]
) -> MotionPath:
    """Return the path of a program; raise its faults if it has any.

    :param path: the path, or its faults; `force_faults`: errors of force comments.
    :raises InputError: path, end of the program or force comments have faults, or the program moves nothing.
    """
    faults = path if isinstance(path, list) else []
    if not modes.is_complete:
        advice = "Check that the file was transferred completely."
        faults.append(Fault(modes.row_count - 1, "the program begins with % but ends without %, M2 or M30", advice))
    if faults or force_faults or isinstance(path, list):  # the last for the type: a list has faults
        raise combined_error([*_errors(run, faults), *force_faults])
    if not len(path.motions):
        advice = "Check that the file is the right one and complete."
        if len(path.held_back_rows):
            advice = "There are rapid moves, but X, Y and Z are never all programmed."
        raise ProgramError("the program moves nothing", file=run.documents[0].name, advice=advice)
    return path


def _tools(cell: Cell, modes: Modes) -> dict[float | None, Array]:
    """Return `$TOOL` (4, 4) of the start, under None, and of each tool number in the order of their first use."""
    numbers = dict.fromkeys(number for _, number in modes.tools)
    return {None: cell.tool.pose(), **{number: cell.tools[f"{number:g}"].pose() for number in numbers}}


def _cell_frames(
    cell: Cell, forward_kinematics: Callable[[Array], Array], tools: Mapping[float | None, Array]
) -> CellFrames:
    """Return the frames of the cell that a program refers to.

    :param tools: `$TOOL` (4, 4) by tool number, see `_tools`.
    """
    base, machine = cell.base.pose(), cell.machine
    offsets = {code: cell.work_offsets.get(f"G{code:g}") for code in WORK_OFFSETS}
    home_poses = None
    if machine.home_joints is not None:
        home_poses = inverse(base) @ forward_kinematics(_home_joints(cell)) @ np.stack(list(tools.values()))
    return CellFrames(
        start=inverse(base) @ forward_kinematics(cell.start_joints) @ tools[None],
        orientation=cell.tool_orientation(),
        work_offsets={code: np.eye(4) if frame is None else frame.pose() for code, frame in offsets.items()},
        tools={number: row for row, number in enumerate(tools) if number is not None},
        home_poses=home_poses,
        home_place=None if machine.home_place is None else np.array(machine.home_place),
        clearance=machine.clearance_Z,
        rotary=RotaryAxes.from_cell(cell.rotary),
    )


def _home_joints(cell: Cell) -> Array:
    """Return the joint angles (6,) of [machine] home [rad]; NaN where the cell has none."""
    return np.array(cell.machine.home_joints or np.full(6, np.nan)) * RAD_PER_DEG


def _speeds(cell: Cell) -> Speeds:
    """Return speeds and distances that hold for all moves of a program."""
    return Speeds(
        rapid=cell.gcode.rapid_m_per_s,
        approximation=cell.gcode.approximation_mm * M_PER_MM,
        rounding=cell.gcode.corner_tolerance_mm * M_PER_MM,
        home_joints=_home_joints(cell),
        chord=CHORD_TOLERANCE_SHARE * cell.output.tolerance_mm,
    )


def _program_line(run: ExecutedProgram, line: int | None) -> int | None:
    """Return the line number in the program of an executed line (1-based); None stays None."""
    return None if line is None else int(run.main_line[line - 1])


def _errors(run: ExecutedProgram, faults: Sequence[Fault]) -> list[InputError]:
    """Return faults as errors, the first of each line; a single error if the program is for another control."""
    from postproc.dialects.gcode.foreign import recognise  # late: its patterns are only compiled if there are faults

    spans = [line_spans(document.text) for document in run.documents]
    fault_of_line: dict[tuple[int, int], Fault] = {}  # by index of the document and line number in it
    for fault in faults:
        fault_of_line.setdefault((int(run.document[fault.row]), int(run.line[fault.row])), fault)
    texts = [run.documents[n].text[spans[n][0][line - 1] : spans[n][1][line - 1]] for n, line in fault_of_line]
    names = [document.name for document in run.documents]
    recognised = recognise(texts)
    if recognised is not None:
        index, foreign_format = recognised
        n, line = list(fault_of_line)[index]
        article = "an" if foreign_format.name[0] in "AO" else "a"
        problem = f"this is not plain G-code, but {article} {foreign_format.name} program"
        return [ProgramError(problem, file=names[n], line=line, text=texts[index], advice=foreign_format.advice)]
    return [
        ProgramError(fault.problem, file=names[n], line=line, text=text, advice=fault.advice)
        for ((n, line), fault), text in zip(fault_of_line.items(), texts, strict=True)
    ]


def _late_code_issues(run: ExecutedProgram, row_count: int) -> Iterator[Issue]:
    """Yield a warning if there is code after the end of the program, which is not executed.

    :param row_count: number of lines up to the end of the program.
    """
    source, lines = run.source, list(run.after_end)
    # `words.COMMENT_MARK` stands for a comment
    if source.code[source.ends[row_count] :].strip(b"\n%" + words.COMMENT_MARK.encode()):
        lines = [row + 1 for row in range(row_count, len(source)) if source.line(row).strip(words.COMMENT_MARK + "%")]
    if len(lines):
        end = int(run.main_line[row_count - 1])
        message = f"There is code after the end of the program (line {end}): it is not executed."
        yield Issue("warning", "after-end", message, lines[0], count=len(lines))


def _comments(run: ExecutedProgram, row_count: int) -> tuple[list[tuple[int, str | ForceNote]], list[InputError]]:
    """Return the comments of the first `row_count` executed lines, and the errors of force comments.

    :returns: row and content of each comment, where a force comment is a `ForceNote`; one error for each line with
        unreadable force comments.
    """
    comments: list[tuple[int, str | ForceNote]] = []
    faults: dict[tuple[int, int], InputError] = {}
    for line, text in zip(run.source.comment_lines.tolist(), run.source.comments, strict=True):
        if line > row_count:
            break
        n, file_line = int(run.document[line - 1]), int(run.line[line - 1])
        try:
            note = parse_force_note(text, file_line, run.documents[n].name)
        except ForceError as cause:
            faults.setdefault((n, file_line), cause)
            continue
        comments.append((line - 1, text.strip() if note is None else note))
    return comments, list(faults.values())


def _bracket_issues(run: ExecutedProgram, comments: Sequence[tuple[int, str | ForceNote]]) -> Iterator[Issue]:
    """Yield a remark on each comment with brackets inside, which some controls refuse.

    Comments after a semicolon may have brackets.

    :param comments: row and content of each comment.
    """
    rows = [row for row, text in comments if isinstance(text, str) and "(" in text]
    if rows:
        spans = [line_spans(document.text) for document in run.documents]
        for row in rows:
            n, line = int(run.document[row]), int(run.line[row]) - 1
            prefix = run.documents[n].text[spans[n][0][line] : spans[n][1][line]].partition("(")[0]
            if ";" not in prefix:
                message = "Brackets in a comment: LinuxCNC, Fanuc and Haas controls refuse them. They are read as text."
                yield Issue("info", "brackets", message, row + 1)


def _events(
    run: ExecutedProgram, path: MotionPath, modes: Modes, comments: Sequence[tuple[int, str | ForceNote]]
) -> tuple[tuple[ForceNote, ...], tuple[Event, ...]]:
    """Return force comments, and other comments and events, in order of their lines.

    In one line comments come first, stops last.

    :param comments: row and content of each comment.
    """
    entries = [_Entry(row, _COMMENT_ORDER, "comment", text=text) for row, text in comments if isinstance(text, str)]
    entries += [
        _Entry(event.row, _STOP_ORDER if event.is_after_motion else _EVENT_ORDER, event.kind, event.value)
        for event in modes.row_events
    ]
    entries += [
        _Entry(row, _EVENT_ORDER, event.kind, event.value or _spindle_speed(modes, row, event.kind), motion=motion)
        for motion, row, event in path.events
    ]
    entries.sort(key=attrgetter("row", "order"))
    # an entry precedes the first motion of its line or of a later line, a stop the first motion of a later line
    next_rows = [entry.row + (entry.order == _STOP_ORDER) for entry in entries]
    next_motions = np.searchsorted(path.row, next_rows).tolist()
    events = tuple(
        Event(
            before=motion if entry.motion is None else entry.motion,
            kind=entry.kind,
            line=int(run.main_line[entry.row]),
            value=entry.value,
            text=entry.text,
        )
        for entry, motion in zip(entries, next_motions, strict=True)
    )
    force_notes = [(row, note) for row, note in comments if isinstance(note, ForceNote)]
    next_motions = np.searchsorted(path.row, [row for row, _ in force_notes]).tolist()
    notes = tuple(
        replace(note, before=motion, line=int(run.main_line[row]))
        for motion, (row, note) in zip(next_motions, force_notes, strict=True)
    )
    return notes, events


_COMMENT_ORDER, _EVENT_ORDER, _STOP_ORDER = range(3)
"""Order within a line: comments, events before its motion, events after its motion."""


class _Entry(NamedTuple):
    """A comment or an event of a line.

    :param row: row of the line; `order`: place within the line, such as `_STOP_ORDER`.
    :param kind, value, text: see `Event`.
    :param motion: index of the motion that an event of a cycle precedes; None: it follows from the row.
    """

    row: int
    order: int
    kind: EventKind
    value: float = 0.0
    text: str = ""
    motion: int | None = None


def _spindle_speed(modes: Modes, row: int, kind: str) -> float:
    """Return the speed at which a cycle starts the spindle again [1/min]: that of the last start in the program.

    It is 0 if the cycle stops the spindle, or if the program has not started it.

    :param row: row of the line of the cycle; `kind`: kind of the event of the cycle.
    """
    if kind == "spindle_off":
        return 0.0
    starts = (event for event in reversed(modes.row_events) if event.row <= row and event.kind in SPINDLE_ON)
    return next((event.value for event in starts), 0.0)


def _unit_issue(path: MotionPath, text: str) -> Issue:
    """Return the remark on a program without G20 and G21, which is read in millimetres.

    It is a warning if the numbers look like inches: four decimals at most, as posts write inches, a small size of cuts
    and a low feed.

    :param text: text of the program.
    """
    message = "Neither G20 nor G21 is programmed: millimetres are assumed."
    is_cut = ~path.motions.rapid
    position = path.motions.target[is_cut, :2, 3] * MM_PER_M
    size = np.ptp(position, axis=0) if len(position) else np.zeros(2)
    feed = MM_PER_MIN * float(path.motions.feed[is_cut].max(initial=0.0))
    decimals = max((len(digits) for digits in _DECIMALS.findall(_COMMENT.sub("", text[:_SAMPLE_LENGTH]))), default=0)
    if decimals != _INCH_DECIMALS or not 0.0 < size.max() < _INCH_SIZE or feed > _INCH_FEED:
        return Issue("info", "units", message)
    message += (
        f" The numbers fit inches: four decimals, cuts of {size[0]:.3g} by {size[1]:.3g} in X and Y, F{feed:.3g}. "
        "Write G20 if they are inches, else G21."
    )
    return Issue("warning", "units", message)


def _reading_issues(path: MotionPath, modes: Modes, text: str) -> Iterator[Issue]:
    """Yield remarks on units, approaches, held-back moves and moves of zero length, with lines as executed.

    :param text: text of the program.
    """
    if not modes.changes["units"]:
        yield _unit_issue(path, text)
    for remark in path.remarks:
        yield Issue(remark.level, remark.kind, remark.message, remark.row + 1)
    if len(path.held_back_rows):
        message = "Moves are held back until X, Y and Z are all known."
        lines = tuple((path.held_back_rows + 1).tolist())
        yield Issue("info", "start-position", message, lines[0], count=len(lines), lines=lines)
    null_rows = np.setdiff1d(path.still_rows, path.held_back_rows, assume_unique=True)
    if len(null_rows):
        message = "A move of zero length is left out."
        lines = tuple((null_rows + 1).tolist())
        yield Issue("info", "null-move", message, lines[0], count=len(lines), lines=lines)


GCODE = CamFormat(
    "gcode", (".nc", ".ngc", ".tap", ".cnc", ".gcode", ".mpf", ".ptp"), read, survey=survey, subprograms=called_files
)
"""G-code of milling with three to five axes."""
