"""Reader of cutter-location files (APT, CLDATA, CLSF): from a document to a `Program`.

X, Y, Z are the tool tip in `$BASE`; i, j, k the direction from the tip to the spindle. The tool is tilted from z to
that direction by the shortest rotation, as with rotary axes in G-code (`program.tilt_to`); between two points it turns
by one rotation. Where it comes straight from below, it is tilted from −z instead. Anything not understood that may move
the tool is an error.

Sources: ISO 4343:2000 as quoted in public specifications; PTC, Creo NC, "Supported CL Data Commands" and the pages on
circles and holes; Siemens, NX CLSF Manager (``CIRCLE``); Vericut, "Supported APT-CLS NC Program Records"; Autodesk's
post "Common ISO 4343 APT"; files of CATIA V5, Siemens NX and SolidWorks CAM.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.chunks import Runs
from postproc.dialects.apt import statements, systems
from postproc.dialects.apt.execution import execute
from postproc.dialects.apt.execution_result import ARC, RAPID, ExecutionResult, Fault, MoveRun
from postproc.dialects.apt.statements import Statements
from postproc.dialects.apt.survey import survey
from postproc.dialects.cell_lines import events_with_waits
from postproc.dialects.circles import ArcColumns
from postproc.dialects.dialect import CamFormat
from postproc.errors import ForceError, InputError, Issue, ProgramError, combined_error
from postproc.frames import M_PER_MM, RAD_PER_DEG, S_PER_MIN, Array, inverse, norm
from postproc.poses import Poses
from postproc.program import (
    CIRC,
    LIN,
    PTP,
    Bools,
    Document,
    Event,
    ForceNote,
    Ints,
    Motions,
    Program,
    constant,
    distinct,
    parse_force_note,
    read_only,
    tilt_to,
)

_MOVE_TOLERANCE_MM = 1e-6
"""Shorter moves are rounding: far below the last digit of a program."""
_TURN_TOLERANCE = 1e-9
"""Smaller changes of the unit vector of the tool are the rounding of doubles."""
_OPPOSITE_COSINE = -0.9999
"""A direction whose component along a reference is smaller has no shortest rotation from the reference (assumed)."""
_BELOW_AXES = np.diag([1.0, -1.0, -1.0])
"""Reference orientation of programs whose tool comes from below: half a turn about X."""


def read(document: Document, cell: Cell, forward_kinematics: Callable[[Array], Array], name: str) -> Program:
    """Read a cutter-location file.

    The first motion is `PTP` if it is rapid; later rapid motions are `LIN` with ``rapid``. Moves of zero length are
    left out.

    :param cell: `$BASE`, `$TOOL`, tools, `[machine]`, `[m_codes]`, speed of rapid moves, approximation distance.
    :param forward_kinematics: (6,) joints [rad] → (4, 4) flange in the robot root [m].
    :param name: name of the program.
    :raises InputError: all errors of the file together, each with file, line, text and advice.
    """
    source = statements.split(document)
    result = execute(source, cell)
    notes, comments, errors = _comments(source, result)
    errors += [_changed_system(source, line) for line in systems.changed_axis_systems(source.comments)]
    moves = _Moves(result.move_runs)
    faults = [*result.faults, *_opposite_directions(moves, source)]
    if faults or errors:
        raise combined_error([*(_error(source, fault.row, fault.problem, fault.advice) for fault in faults), *errors])
    if not result.move_runs:
        advice = "Check that the file is the right one and complete."
        raise ProgramError("the program moves nothing", file=document.name, advice=advice)
    numbers = {number: row for row, number in enumerate(result.tools, 1)} if cell.tools else {}  # 0 is `$TOOL`
    base = cell.base.pose()
    tools = np.stack([cell.tool.pose(), *(cell.tools[f"{number:g}"].pose() for number in numbers)])
    home = None
    if cell.machine.home_joints is not None:
        joints = np.array(cell.machine.home_joints) * RAD_PER_DEG
        home = _Home(joints, inverse(base) @ forward_kinematics(joints) @ tools)
    motion_moves = _motion_moves(moves, numbers)
    motions = _motions(moves, motion_moves, source, cell, numbers, home)
    events, wait_issues = events_with_waits(
        _events(result, comments, source, motion_moves, motions), motions, document.folder, cell
    )
    return Program(
        name=name,
        dialect="apt",
        documents=(document,),
        motions=motions,
        bases=base[None],
        tools=tools,
        notes=_notes_before_motions(notes, motions),
        events=events,
        unforced=np.zeros(int(result.begins_at_start), dtype=np.int64),
        still=distinct(source.line[np.delete(moves.row, motion_moves)]),
        issues=(*_issues(result, source, moves, motion_moves), *wait_issues),
    )


def _error(source: Statements, row: int, problem: str, advice: str | None) -> ProgramError:
    """Return the error of the statement `row`, with its line and text."""
    line = int(source.line[row])
    return ProgramError(problem, file=source.document.name, line=line, text=source.text(row), advice=advice)


def _changed_system(source: Statements, line: int) -> ProgramError:
    """Return the error for a second machining axis system, which begins on a line."""
    problem = "the machining axis system changes: coordinates from here on are in another system"
    advice = "Write one file for each machining axis system, and give its place as [base] of a cell."
    return ProgramError(problem, file=source.document.name, line=line, advice=advice)


class _Comments(NamedTuple):
    """Comments of a file.

    :ivar notes: force comments.
    :ivar plain_comments: 1-based line and text of all other comments.
    :ivar faults: errors of force comments.
    """

    notes: list[ForceNote]
    plain_comments: list[tuple[int, str]]
    faults: list[InputError]


def _comments(source: Statements, result: ExecutionResult) -> _Comments:
    """Return the comments up to the end of the program: comments after ``$$``, and force comments in PPRINT.

    Other texts of PPRINT are left out: they are events of `result`.
    """
    notes: list[ForceNote] = []
    plain_comments: list[tuple[int, str]] = []
    faults: list[InputError] = []
    # line, text, and whether PPRINT or a similar statement prints it
    texts = [(line, text, False) for line, text in source.comments]
    texts += [(int(source.line[e.row]), e.text, True) for e in result.events if e.kind == "comment"]
    line_after_end = int(source.line[min(result.after_end)]) if result.after_end else len(source.spans[0]) + 1
    for line, text, is_printed in sorted(texts):
        if line >= line_after_end:
            break
        try:
            note = parse_force_note(text, line, source.document.name)
        except ForceError as cause:
            faults.append(cause)
            continue
        if note is not None:
            notes.append(note)
        elif text and not is_printed:
            plain_comments.append((line, text))
    return _Comments(notes, plain_comments, faults)


class _Moves:
    """All moves as arrays (N, …).

    :ivar move_runs: the runs that they come from: consecutive moves of one kind, feed and tool, see `MoveRun`.
    :ivar row: (N,) rows of their statements.
    :ivar begin: (N, 3) beginnings of the moves [mm]; the first move has none and gets its end.
    :ivar end: (N, 3) ends of the moves [mm].
    :ivar axis: (N, 3) direction of the tool at the ends.
    :ivar run_index: (N,) index of the run of each move.
    :ivar turns: (N,) True if the direction of the tool changes; before the first move it is z.
    """

    def __init__(self, move_runs: Sequence[MoveRun]) -> None:
        """Join the moves of all runs; there may be none."""
        no_rows, no_points = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        self.move_runs = move_runs
        self.row: Ints = np.concatenate([no_rows, *(run.row for run in move_runs)])
        self.end: Array = np.concatenate([no_points, *(run.end for run in move_runs)])
        self.axis: Array = np.concatenate([no_points, *(run.axis for run in move_runs)])
        self.run_index = np.repeat(np.arange(len(move_runs)), [len(run.row) for run in move_runs])
        self.begin = np.concatenate([self.end[:1], self.end[:-1]])
        previous_axis = np.concatenate([[[0.0, 0.0, 1.0]], self.axis[:-1]])[: len(self.row)]
        self.turns = norm(self.axis - previous_axis) > _TURN_TOLERANCE

    def values_by_move(self, name: str) -> Array:
        """Return the field `name` of the run of each move (N,)."""
        return np.array([getattr(run, name) for run in self.move_runs])[self.run_index]


class _Home(NamedTuple):
    """The home position of the cell: joint angles (6,) [rad], and poses (tools, 4, 4) of the tool in `$BASE` [m]."""

    joints: Array
    poses: Array


def _tools(moves: _Moves, numbers: dict[float, int]) -> Ints:
    """Return the index of the tool of each move (N,); 0, which is `$TOOL`, before the first tool.

    :param numbers: number of each tool of the program → its index.
    """
    run_tools = [0 if run.tool is None else numbers.get(run.tool, 0) for run in moves.move_runs]
    return np.array(run_tools)[moves.run_index]


def _motion_moves(moves: _Moves, numbers: dict[float, int]) -> Ints:
    """Return the moves (M,) that become motions of the robot: the first move, and all that are not of zero length.

    An arc, a joint motion, a turn and a change of the tool are motions even if the tip does not move.

    :param numbers: number of each tool of the program → its index.
    """
    tool = _tools(moves, numbers)
    # the first move changes no tool
    is_tool_change = np.diff(tool, prepend=tool[:1]) != 0
    is_long = norm(moves.end - moves.begin) > _MOVE_TOLERANCE_MM
    is_first = np.arange(len(tool)) == 0
    is_arc, is_joint_motion = moves.values_by_move("code") == ARC, moves.values_by_move("is_joint_motion")
    return np.flatnonzero(is_long | moves.turns | is_arc | is_joint_motion | is_tool_change | is_first)


def _motions(
    moves: _Moves, motion_moves: Ints, source: Statements, cell: Cell, numbers: dict[float, int], home: _Home | None
) -> Motions:
    """Return the moves that are motions, in `$BASE`.

    :param motion_moves: (M,) moves that are motions.
    :param numbers: number of each tool of the program → its index.
    :param home: home position of the cell; None without one.
    """
    code, is_joint_motion, is_to_home = (
        moves.values_by_move(name)[motion_moves] for name in ("code", "is_joint_motion", "is_to_home")
    )
    tool = _tools(moves, numbers)[motion_moves]
    count = len(motion_moves)
    target = _targets(moves, motion_moves, cell.tool_orientation())
    joints = np.broadcast_to(np.nan, (count, 6))  # takes no memory
    if is_to_home.any() and home is not None:
        joints = joints.copy()
        joints[is_to_home] = home.joints
        target[is_to_home] = home.poses[tool[is_to_home]]
    arcs = _arcs(moves.move_runs, moves.run_index[motion_moves], code == ARC)
    rapid = code == RAPID
    feed = np.where(
        rapid, cell.gcode.rapid_m_per_s, moves.values_by_move("feed")[motion_moves] * (M_PER_MM / S_PER_MIN)
    )
    feed[is_joint_motion] = np.nan
    blend = np.where(moves.values_by_move("is_exact_stop")[motion_moves], 0.0, cell.gcode.approximation_mm * M_PER_MM)
    unset = constant(-1, count)
    motions = Motions(
        kind=np.where(is_joint_motion, PTP, np.where(code == ARC, CIRC, LIN)).astype(np.int64),
        rapid=rapid,
        line=source.line[moves.row[motion_moves]],
        target=Poses.of(target),
        joints=Runs.of(joints),
        centre=arcs.centre,
        normal=arcs.normal,
        sweep=arcs.sweep,
        feed=feed,
        base=constant(0, count),
        tool=tool,
        blend=blend,
        rounding=constant(cell.gcode.corner_tolerance_mm * M_PER_MM, count),
        status=unset,
        turn=unset,
    )
    return read_only(motions)


def _targets(moves: _Moves, motion_moves: Ints, orientation: Array) -> Array:
    """Return the poses (M, 4, 4) [m] of the tool frame in `$BASE` at the ends of motions.

    :param motion_moves: (M,) moves that are motions.
    :param orientation: (3, 3) orientation of the tool frame in the program frame if the tool points along z.
    """
    target = np.zeros((len(motion_moves), 4, 4))
    target[:, 3, 3] = 1.0
    reference = _reference(moves.axis)
    axis = moves.axis[motion_moves] @ reference
    if (axis == axis[:1]).all():  # one direction: one matrix is faster
        target[:, :3, :3] = reference @ tilt_to(axis[:1])[0] @ orientation
    else:
        target[:, :3, :3] = reference @ tilt_to(axis) @ orientation
    target[:, :3, 3] = moves.end[motion_moves] * M_PER_MM
    return target


def _arcs(move_runs: Sequence[MoveRun], run_index: Ints, is_arc: Bools) -> ArcColumns:
    """Return centre [m], axis and sweep [rad] of M motions; NaN for motions that are no arcs.

    :param move_runs: runs of moves; an arc is a run of its own, which has its circle.
    :param run_index: (M,) run of each motion.
    :param is_arc: (M,) True for motions that are arcs.
    """
    empty = np.broadcast_to(np.nan, (len(run_index), 3))  # takes no memory
    if not is_arc.any():
        return ArcColumns(empty, empty, empty[:, 0])
    columns = ArcColumns.unset(len(run_index))
    for n in np.flatnonzero(is_arc).tolist():
        run = move_runs[run_index[n]]
        if run.circle is not None:
            columns.centre[n], columns.normal[n] = run.circle.centre * M_PER_MM, run.circle.axis
            columns.sweep[n] = run.sweep
    return columns


def _reference(axis: Array) -> Array:
    """Return the orientation (3, 3) from whose z axis the tool is tilted to its directions, by the shortest rotation.

    It is that of `$BASE`, or half a turn about X if the tool comes straight from below anywhere: from z to −z there is
    no shortest rotation.

    :param axis: (n, 3) directions of the tool.
    """
    return _BELOW_AXES if (axis[:, 2] < _OPPOSITE_COSINE).any() else np.eye(3)


def _opposite_directions(moves: _Moves, source: Statements) -> list[Fault]:
    """Return the fault that the tool comes straight from above and, elsewhere, straight from below; else no fault.

    There is no shortest rotation from one to the other. The fault is at the later of the two first moves.
    """
    sides = (("above", moves.axis[:, 2] > -_OPPOSITE_COSINE), ("below", moves.axis[:, 2] < _OPPOSITE_COSINE))
    first_moves = sorted((int(np.argmax(is_side)), side) for side, is_side in sides if is_side.any())
    if len(first_moves) < len(sides):
        return []
    (earlier_move, earlier_side), (later_move, later_side) = first_moves
    line = int(source.line[moves.row[earlier_move]])
    problem = f"the tool comes from {later_side}, and from {earlier_side} in line {line}"
    return [Fault(int(moves.row[later_move]), problem, "Write one file for each clamping of the part.")]


def _notes_before_motions(notes: Sequence[ForceNote], motions: Motions) -> tuple[ForceNote, ...]:
    """Return the force notes, each with the index of the first motion behind it."""
    # lines of motions ascend: index of the first motion on or behind the line of each note
    indices = np.searchsorted(motions.line, [note.line for note in notes]).tolist()
    return tuple(replace(note, before=index) for note, index in zip(notes, indices, strict=True))


def _events(
    result: ExecutionResult,
    comments: Sequence[tuple[int, str]],
    source: Statements,
    motion_moves: Ints,
    motions: Motions,
) -> Iterator[Event]:
    """Yield comments and other events in execution order; force comments are left out.

    :param comments: line and text of each comment.
    :param motion_moves: (M,) moves that are motions.
    :param motions: these motions.
    """
    statement_events = [
        Event(
            before=int(np.searchsorted(motion_moves, event.before)),  # number of motions before it
            kind=event.kind,
            line=int(source.line[event.row]),
            value=event.value,
            text=event.text,
        )
        for event in result.events
        if event.kind != "comment" or parse_force_note(event.text, 1, "") is None
    ]
    # index of the first motion on or behind the line of each comment
    motion_index = np.searchsorted(motions.line, [line for line, _ in comments]).tolist()
    comment_events = [
        Event(before, "comment", line, text=text) for (line, text), before in zip(comments, motion_index, strict=True)
    ]
    yield from sorted([*statement_events, *comment_events], key=lambda event: (event.before, event.line))


def _issues(result: ExecutionResult, source: Statements, moves: _Moves, motion_moves: Ints) -> Iterator[Issue]:
    """Yield information and warnings on how the file was read.

    :param motion_moves: (M,) moves that are motions.
    """
    if not result.has_units:
        yield Issue("info", "units", "No UNITS are programmed: millimetres are assumed.")
    csys_lines = [line for line, text in source.comments if systems.is_moved(text)]
    if csys_lines:
        message = (
            "The coordinate system of an NC sequence is not that of the machine: coordinates are read as those of the "
            "machine, as Creo writes them. Check that COORDINATE_OUTPUT is MACHINE_CSYS."
        )
        yield Issue(
            "warning", "coordinate-system", message, csys_lines[0], count=len(csys_lines), lines=tuple(csys_lines)
        )
    for remark in result.remarks:
        yield Issue(remark.level, remark.kind, remark.message, int(source.line[remark.row]))
    null_lines = distinct(source.line[np.delete(moves.row, motion_moves)])
    if len(null_lines):
        lines = tuple(null_lines.tolist())
        yield Issue("info", "null-move", "A move of zero length is left out.", lines[0], count=len(lines), lines=lines)
    if result.after_end:
        lines = tuple(sorted(int(source.line[row]) for row in result.after_end))
        message = "There are statements after the end of the program: they are not executed."
        yield Issue("warning", "after-end", message, lines[0], count=len(lines), lines=lines)


APT = CamFormat("apt", (".apt", ".aptsource", ".cls", ".clsf", ".cl", ".clf", ".ncl", ".cldata"), read, survey=survey)
"""Cutter-location files: APT, CLDATA, CLSF."""
