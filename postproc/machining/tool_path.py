"""The path of the tool through the stock: its tool and spindle speed, and straight segments in the frame of the map."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc import toolpath
from postproc.chunks import Columns
from postproc.errors import MAX_ERRORS, ForceError, Issue, Level, combined_error, did_you_mean
from postproc.frames import MM_PER_M, Array, inverse, norm
from postproc.machining.process import DEFAULT, Process, is_name
from postproc.program import CIRC, PTP, Bools, Ints, Program, distinct
from postproc.toolpath import Segments, even_places, positions, tangent


class ToolStates(Struct, frozen=True, eq=False):
    """Tool and spindle speed on each of M motions.

    :param tool: (M,) index in `keys`.
    :param keys: keys of [tools].
    :param rpm: (M,) spindle speed [1/min]; 0 while it is off.
    :param hand: (M,) 1 for M3 (clockwise seen from the spindle), −1 for M4.
    :param number: (M,) T number of the program; −1 before the first tool change, and in robot programs.
    """

    tool: Ints
    keys: tuple[str, ...]
    rpm: Array
    hand: NDArray[np.int64]
    number: Ints


def tool_states(program: Program, process: Process) -> ToolStates:
    """Return tool and spindle speed on each motion.

    The key of a cutter in [tools] is the number of T … M6 in G-code, n of `TOOL_DATA[n]` in KRL, and the name of the
    tooldata in RAPID. A program without spindle speeds has those of [tools].

    :raises ForceError: a tool that cuts is not in [tools], or it takes [tools.default] while another key is a name that
        the program does not have.
    """
    count = len(program.motions)
    rpm, hand, has_speed = np.zeros(count), np.ones(count, dtype=np.int64), False
    for event in program.events:
        following_rows = slice(event.before, None)
        if event.kind in ("spindle_on", "spindle_ccw"):
            rpm[following_rows], has_speed = event.value, True
            hand[following_rows] = 1 if event.kind == "spindle_on" else -1
        elif event.kind == "spindle_off":
            rpm[following_rows] = 0.0
    number, entry, keys = _tool_numbers(program), cutter_entries(program, process), tuple(process.tools)
    for row, tool in enumerate(process.tools.values()):
        if not has_speed and tool.rpm is not None:
            rpm[entry == row] = tool.rpm
            hand[entry == row] = 1 if tool.spindle == "M3" else -1
    cuts = ~np.asarray(program.motions.rapid)
    if (lacks_tool := (entry < 0) & cuts).any():
        _refuse_missing_tools(program, process, number, lacks_tool)
    if DEFAULT in keys and (entry[cuts] == keys.index(DEFAULT)).any():
        _refuse_unknown_names(program, process, number)
    return ToolStates(entry, keys, rpm, hand, number)


def cutter_entries(program: Program, process: Process) -> Ints:
    """Return the row in [tools] of the process of the cutter of each motion (M,); −1: it has no entry.

    :raises ForceError: several tools have one frame, and which of them cuts is not known, see `_stated_key`.
    """
    tool, names = _program_tools(program, process)
    keys = tuple(process.tools)
    rows = np.full(len(names), -1)
    for index, name in enumerate(names):
        entry = process.tool(name)
        if entry is None:
            continue
        key, _ = entry
        # a tool without a name may have the only entry of the process, unless its key is the name of another tool
        if name is not None or not is_name(key):
            rows[index] = keys.index(key)
    return rows[tool]


def _tool_numbers(program: Program) -> Ints:
    """Return the T number on each motion (M,), −1 before the first tool change."""
    number = np.full(len(program.motions), -1)
    for event in program.events:
        if event.kind == "tool_change":
            number[event.before :] = int(event.value)
    return number


def tapping_motions(program: Program, tools: ToolStates) -> Ints:
    """Return the motions (n,) that cut a thread: at feed, and the next motion is at feed with a reversed spindle."""
    is_cut = ~np.asarray(program.motions.rapid)
    return np.flatnonzero((tools.hand[1:] != tools.hand[:-1]) & is_cut[1:] & is_cut[:-1])


def _program_tools(program: Program, process: Process) -> tuple[Ints, list[str | None]]:
    """Return the index of the tool of each motion (M,), and the number or name of each tool.

    The name is None for a tool without a number, and for a tool of a robot program without an entry in [tools].

    :raises ForceError: several tools have one frame, and which of them cuts is not known, see `_stated_key`.
    """
    if program.tool_keys:
        return program.motions.tool, [_stated_key(program, process, row) for row in range(len(program.tools))]
    number = _tool_numbers(program)
    numbers = distinct(number)
    # T0 and −1 (before the first tool change) name no tool, unless [tools] has an entry 0
    names = [str(value) if value > 0 or str(value) in process.tools else None for value in numbers.tolist()]
    return np.searchsorted(numbers, number), names


def _stated_key(program: Program, process: Process, row: int) -> str | None:
    """Return the number or name of a tool of a robot program that has an entry in [tools]; None if none has.

    Several `TOOL_DATA[n]` or tooldata may have the same frame: then the program does not state which of them cuts.

    :param row: row of `Program.tools`, the frames.
    :raises ForceError: several tools with this frame have an entry; or a tooldata has one, and others have its frame.
    """
    names = [name for name in program.tool_keys[row] if process.key_of(name) is not None]
    is_by_name = bool(names) and is_name(names[0])  # by the name of tooldata, not by n of TOOL_DATA[n]
    if len(names) > 1 or (is_by_name and len(program.tool_keys[row]) > 1):
        frame_names = program.tool_keys[row] if is_by_name else names
        tools = " and ".join(program.tool_text(name) for name in frame_names)
        entries = "have an entry each" if len(names) > 1 else f"only {names[0]} has an entry"
        problem = f"{tools} are one frame, and {entries} in {process.path}: which cutter cuts is not known"
        advice = f"Measure their lengths, or give {'[tools.default] only' if is_by_name else 'one entry'}."
        raise ForceError(problem, file=program.documents[0].name, advice=advice)
    return names[0] if names else None


def _refuse_missing_tools(program: Program, process: Process, number: Ints, lacks_tool: Bools) -> None:
    """Raise the error for cutting motions whose tools the process file lacks.

    :param number: (M,) T number of each motion.
    :param lacks_tool: (M,) True for cuts whose tool has no entry.
    :raises ForceError: always, one error for each tool.
    """
    tool = program.motions.tool if program.tool_keys else number
    missing_tools = distinct(tool[lacks_tool])[: MAX_ERRORS + 1]
    first_cuts = [int(np.flatnonzero(lacks_tool & (tool == row))[0]) for row in missing_tools]
    raise combined_error(_missing_tool_error(program, process, row, int(number[row])) for row in first_cuts)


def _missing_tool_error(program: Program, process: Process, motion: int, number: int) -> ForceError:
    """Return the error for a tool that the process file lacks.

    :param motion: row of the first cut of the tool.
    :param number: T number of the tool; 0 or −1: the program states none.
    """
    is_robot_program = program.keeps_text
    names = program.tool_keys[program.motions.tool[motion]] if program.tool_keys else ()
    tool_list = ", ".join(f"[tools.{key}]" for key in process.tools) or "none"
    advice = f"Give [tools.default] in {process.path}; found: {tool_list}."
    if names:
        problem = f"no cutter for {' or '.join(program.tool_text(name) for name in names)} in {process.path}"
        advice = f"Give [tools.{names[0]}]; found: {tool_list}."
    elif is_robot_program and program.dialect == "rapid":
        problem = "no cutter for the tool of this move, which is no tooldata by its name"
    elif is_robot_program:
        problem = "no cutter for the $TOOL of this move, which has no number"
    elif number <= 0:  # T0, and M6 without T, name no tool
        problem = "no tool number (T… M6) before this move"
    else:
        problem, advice = f"tool T{number} is not in {process.path}", f"Give [tools.{number}]; found: {tool_list}."
    line = int(program.motions.line[motion])
    return ForceError(problem, file=program.documents[0].name, line=line, advice=advice)


def _refuse_unknown_names(program: Program, process: Process, number: Ints) -> None:
    """Refuse names in [tools] that a program does not have: they may mean a tool that takes [tools.default].

    :param number: (M,) T number of each motion.
    :raises ForceError: [tools] has such names, one error for each.
    """
    names = list(dict.fromkeys(name for row in program.tool_keys for name in row))
    names = names or [str(value) for value in distinct(number).tolist() if value > 0]
    unknown_keys = [key for key in process.tools if is_name(key) and key.upper() not in map(str.upper, names)]
    tools = ", ".join(program.tool_text(name) for name in names) or "none"
    errors = [
        ForceError(
            f"[tools.{key}] is of no tool of {program.documents[0].name}, in which a tool cuts as [tools.default]",
            file=process.path,
            advice=f"{did_you_mean(key, names)} Its tools: {tools}. Correct the name, or give each its table.".lstrip(),
        )
        for key in unknown_keys[: MAX_ERRORS + 1]
    ]
    if errors:
        raise combined_error(errors)


_SAME_TIP = 1e-4
"""Tools whose tips in the flange frame differ by less [m] are taken for one cutter (assumed): of 100 mm and more, two
cutters that are alike to a tenth of a millimetre are rare, and one that was measured twice is not."""


def shared_cutter_issues(program: Program, tools: ToolStates, engaged_motions: Ints) -> Iterator[Issue]:
    """Yield a warning for each entry of [tools] that cuts with several tools of a robot program.

    :param engaged_motions: (n,) motions that touch material, in order; other motions at feed may only position.
    """
    m, is_robot_program = program.motions, program.keeps_text
    tool, frame = tools.tool[engaged_motions], m.tool[engaged_motions]
    if not is_robot_program:
        return
    for entry in distinct(tool).tolist():
        rows = distinct(frame[tool == entry])
        tips = program.tools[rows, :3, 3]
        tip_distance = norm(tips - tips[0])
        if len(rows) < 2 or tip_distance.max() <= _SAME_TIP:
            continue
        # the first tool, and the one whose tip is farthest from its tip
        tool_rows = [int(rows[0]), int(rows[int(np.argmax(tip_distance))])]
        first_motions = [int(engaged_motions[np.argmax((frame == row) & (tool == entry))]) for row in tool_rows]
        names = [
            f"{_tool_name(program, row)} (line {m.line[row_motion]})"
            for row, row_motion in zip(tool_rows, first_motions, strict=True)
        ]
        keys = [key for row in tool_rows for key in (program.tool_keys[row] if program.tool_keys else ())]
        new_keys = [key for key in dict.fromkeys(keys) if key.upper() != tools.keys[entry].upper()]
        advice = f"Give {' and '.join(f'[tools.{key}]' for key in new_keys)}"
        if not new_keys:
            data = "tooldata of its own" if program.dialect == "rapid" else "TOOL_DATA[n] of its own"
            advice = f"Give each {data} in the program, and its table in [tools]"
        message = (
            f"{' and '.join(names)}, whose tips are {tip_distance.max() * MM_PER_M:.4g} mm apart, both cut as "
            f"[tools.{tools.keys[entry]}]: are they one cutter? {advice} if they are not."
        )
        yield Issue("warning", "one-cutter", message, int(m.line[first_motions[1]]), subject=tools.keys[entry])


def _tool_name(program: Program, row: int) -> str:
    """Return the name of a tool of a robot program as the program states it; "the tool" if it is not known.

    :param row: row of `Program.tools`.
    """
    keys = program.tool_keys[row] if program.tool_keys else ()
    if len(keys) != 1:
        return "the tool"
    text = program.tool_text(keys[0])
    return f"$TOOL = {text}" if keys[0].isdecimal() else text


_RAPID = re.compile(r"\s*S?PTP", re.IGNORECASE)


def refuse_unread_cuts(program: Program) -> None:
    """Refuse a program that calls routines whose cuts were not read: these would remain uncorrected under force.

    :raises ProgramError: a called routine was not read; the error names the cause.
    """
    if program.unfollowed:
        raise combined_error(call.error for call in program.unfollowed)


def unread_cut_issues(program: Program) -> list[Issue]:
    """Return a warning if cutting motions were not read: the stock keeps the material that they remove."""
    lines = [
        f"{statement.file}, line {statement.line}"
        for statement in program.unresolved
        if not _RAPID.match(statement.text)
    ]
    lines += [f"{issue.subject}()" for issue in program.issues if issue.kind == "motions-elsewhere"]
    if not lines:
        return []
    suffix = f" and {len(lines) - 1} more" if len(lines) > 1 else ""
    message = (
        f"motions that are kept unread remove nothing from the stock: {lines[0]}{suffix}. If a later motion passes the "
        "same place, its force is computed for material that was already removed."
    )
    return [Issue("warning", "cuts-unseen", message, count=len(lines))]


_CHORD_ERROR = 0.1
"""An arc is divided into chords that deviate from it by this share of a cell at most (assumed),"""
_CHORD_ANGLE = np.radians(8.0)
"""and that turn by this angle at most (assumed)."""
_RAPID_ROTATION = np.radians(2.0)
"""Rapid moves that turn the tool are divided into pieces on which no axis turns by more than this: their chords leave
the path by half a millimetre at most (an arc of 2° with a radius of 3 m)."""
AXIS_TOLERANCE = np.radians(0.5)
"""A tool whose axis differs by less from that of the map is taken for one along it."""
_CUT_ROTATION = np.radians(1.0)
"""Cuts that turn the tool are divided into pieces on which it turns by this angle at most (assumed)."""
_PLACES_ON_MOTION = 1e-9, 0.25, 0.5, 0.75
"""Places of motions at which the direction of the tool is compared (assumed); the first is the start."""
_NO_LENGTH = 1e-9
"""Segments shorter than this [m] do not move the tool; also the first place on a motion, since 0 is none."""
_END_OF_MOTION = 1.0 - 1e-7
"""The end of a motion is before the start of the next one, where the displacement may differ."""


class StraightSegments(Columns, frozen=True, eq=False):
    """L straight segments in order; [m], frame of the height map (z from the tip to the spindle).

    :param motion: (L,) row of `Motions`.
    :param first: (L,) place on the motion where the segment begins, 0 … 1, and `last` (L,) place where it ends.
    :param begin: (L, 3) position of the tip where the segment begins, and `end` (L, 3) where it ends.
    :param leave: (L, 3) unit direction of travel where the segment begins, and `arrive` (L, 3) where it ends.
    :param cutting: (L,) False for rapid moves.
    :param continues: (L,) True if the segment begins at the end of the segment before, with the same tool.
    :param leans: (L,) True where the tool is not along z of the map, or turns: segments are chords of its path.
    """

    motion: Ints
    first: Array
    last: Array
    begin: Array
    end: Array
    leave: Array
    arrive: Array
    cutting: Bools
    continues: Bools
    leans: Bools

    def of(self, motions: Bools) -> StraightSegments:
        """Return the segments of selected motions (M,); at gaps in the selection `continues` is False."""
        rows = np.flatnonzero(motions[self.motion])
        segments = self.take(rows)
        # rows are consecutive where nothing was left out; −2: the first segment continues none
        return replace(segments, continues=segments.continues & (np.diff(rows, prepend=-2) == 1))


class Shift(Struct, frozen=True, eq=False):
    """Displacement of the deflected tip along the path.

    :param motion: (n,) rows of `Motions`, and `t` (n,) places on them, in order.
    :param offset: (n, 3) displacement [m] in the axes of the robot root, as `$BASE` may change between motions.
    :param root: (nb, 3, 3) axes of each `$BASE` in the root.
    :param base: (M,) row in `root` of the `$BASE` of each motion.
    """

    motion: Ints
    t: Array
    offset: Array
    root: Array
    base: Ints

    @classmethod
    def of(cls, program: Program, motion: Ints, t: Array, offset: Array) -> Shift:
        """Return the displacement from values in the `$BASE` of motions.

        :param motion: (n,) rows of `Motions`, and `t` (n,) places on them, in order.
        :param offset: (n, 3) displacements at these places in the `$BASE` of the motions [m].
        """
        root, base = program.bases[:, :3, :3], program.motions.base
        return cls(motion, t, np.einsum("nij,nj->ni", root[base[motion]], offset), root, base)

    def displacements(self, motion: Ints, t: Array) -> Array:
        """Return the displacements (k, 3) at places on motions, in the `$BASE` of the motions [m].

        They are linear between the places with known displacement, also across ends of motions.

        :param motion: (k,) rows of `Motions`, and `t` (k,) places on them.
        """
        # motion + t is one key in the order of the path; the end of a motion stays before the start of the next
        key, given_key = motion + _END_OF_MOTION * t, self.motion + _END_OF_MOTION * self.t
        displacement = np.stack([np.interp(key, given_key, self.offset[:, axis]) for axis in range(3)], axis=-1)
        return np.asarray(np.einsum("nji,nj->ni", self.root[self.base[motion]], displacement))


def straight_segments(
    program: Program,
    path: Segments,
    tools: ToolStates,
    frame: Array,
    cell: float,
    *,
    shift: Shift | None = None,
    directions: Directions | None = None,
) -> StraightSegments:
    """Return the straight segments of the motions of a program.

    Motions without a cutter have none, and neither have motions without length, unless the tool leans or turns.

    :param frame: (4, 4) frame of the height map in the `$BASE` of the stock, see `home_base`.
    :param cell: width of a cell [m].
    :param shift: displacement of the tip; segments are also divided at its places. None: no displacement.
    :param directions: directions of the tool; None: it is along z of the map.
    """
    m = program.motions
    is_leaning = _is_leaning(program, path, frame, directions)
    count = _segment_counts(program, path, is_leaning, cell)
    motions = np.arange(len(m))
    motion, first = even_places(motions, count, "start")
    _, last = even_places(motions, count, "end")
    if shift is not None:
        motion, first, last = _divided_at_shift(motion, first, last, shift)
    begin = path.begin(motion)
    is_inner = first > 0.0  # segments that begin within their motion
    begin[is_inner] = positions(program, path, motion[is_inner], first[is_inner])
    end = positions(program, path, motion, last)
    leave, arrive = _travel_directions(program, path, _DividedSegments(motion, first, last), end - begin)
    if shift is not None:
        begin, end = begin + shift.displacements(motion, first), end + shift.displacements(motion, last)
    begin, end, leave, arrive = _to_map(program, motion, frame, (begin, end), (leave, arrive))
    continues = np.zeros(len(motion), dtype=bool)
    continues[1:] = (norm(begin[1:] - end[:-1]) < 1e-6) & (tools.tool[motion[1:]] == tools.tool[motion[:-1]])
    segment_leans = is_leaning[motion]
    continues[1:] &= (segment_leans[1:] == segment_leans[:-1]) & ~(segment_leans & m.rapid[motion])[1:]
    is_kept = ((norm(end - begin) > _NO_LENGTH) | segment_leans) & (tools.tool[motion] >= 0)
    columns = (motion, first, last, begin, end, leave, arrive, ~m.rapid[motion], continues, segment_leans)
    return StraightSegments(*(np.asarray(column[is_kept]) for column in columns))


def _travel_directions(
    program: Program, path: Segments, segments: _DividedSegments, chord: Array
) -> tuple[Array, Array]:
    """Return the unit directions of travel (L, 3) where segments begin, and (L, 3) where they end.

    They are along the chord, on arcs along the tangent; zero for a straight segment without length.

    :param segments: motions and places of the segments.
    :param chord: (L, 3) from the begin to the end of each segment [m].
    """
    motion, first, last = segments
    is_arc = program.motions.kind[motion] == CIRC
    length = norm(chord)
    leave = chord / np.where(length > 0.0, length, 1.0)[:, None]
    arrive = leave.copy()
    if is_arc.any():
        leave[is_arc] = tangent(program, path, motion[is_arc], first[is_arc])
        arrive[is_arc] = tangent(program, path, motion[is_arc], last[is_arc])
    return leave, arrive


def _segment_counts(program: Program, path: Segments, is_leaning: Bools, cell: float) -> Ints:
    """Return the number of straight segments of each motion (M,); 0 for a PTP on which the tool is along z of the map.

    :param is_leaning: (M,) motions on which the tool turns or leans from z of the height map.
    :param cell: width of a cell [m].
    """
    m = program.motions
    count = np.ones(len(m), dtype=np.int64)
    arcs = path.arcs
    radius = norm(arcs.radial)
    # a chord over this angle deviates by radius · angle² / 8 from its arc
    angle = np.minimum(_CHORD_ANGLE, np.sqrt(8.0 * _CHORD_ERROR * cell / np.maximum(radius, cell)))
    count[arcs.motion] = np.maximum(1, np.ceil(arcs.sweep / angle)).astype(np.int64)
    rotation = path.turn.astype(float)
    ptp = np.flatnonzero(is_leaning & (m.kind == PTP))
    if path.joint_moves is not None:
        rotation[ptp] = path.joint_moves.turn(ptp)
    max_rotation = np.where(m.rapid, _RAPID_ROTATION, _CUT_ROTATION)
    count[is_leaning] = np.maximum(
        count[is_leaning], np.ceil(rotation[is_leaning] / max_rotation[is_leaning]).astype(np.int64)
    )
    count[(m.kind == PTP) & ~is_leaning] = 0
    return count


class Directions(Struct, frozen=True, eq=False):
    """Directions from tip to spindle along the motions of a program, in the `$BASE` of the stock, see `home_base`.

    :param end: (M, 3) direction at the end of each motion.
    :param cuts: (M,) False for rapid motions.
    :param turning: (k,) motions on which the tool frame turns by more than `AXIS_TOLERANCE`.
    :param inner: (4, k, 3) directions on these motions, at the places `_PLACES_ON_MOTION`.
    """

    end: Array
    cuts: Bools
    turning: Ints
    inner: Array

    @classmethod
    def of(cls, program: Program, path: Segments, axis: str) -> Directions:
        """Return the directions of a program.

        :param path: geometry of its motions.
        :param axis: axis of the tool frame that points from the spindle to the tip, a key of `_SPINDLE`.
        """
        m, column = program.motions, _SPINDLE[axis][0]
        turning = np.flatnonzero((path.turn > AXIS_TOLERANCE) & (m.kind != PTP))
        inner = np.zeros((len(_PLACES_ON_MOTION), len(turning), 3))
        for k, t in enumerate(_PLACES_ON_MOTION):
            pose = toolpath.at(program, path, turning, np.full(len(turning), t)).pose[:]
            inner[k] = _towards_spindle(program, axis, turning, pose[:, :3, column])
        end = _towards_spindle(program, axis, np.arange(len(m)), m.target[:, :3, column])
        return cls(end, ~m.rapid, turning, inner)

    def of_range(self, begin: int, end: int) -> Array:
        """Return all unit directions (n, 3) of the tool on the cutting motions from row `begin` to `end` (exclusive).

        The directions at the ends of motions come first, then those inside motions on which the tool turns.
        """
        first, last = np.searchsorted(self.turning, [begin, end]).tolist()
        inner = self.inner[:, first:last][:, self.cuts[self.turning[first:last]]]
        return np.concatenate([self.end[begin:end][self.cuts[begin:end]], inner.reshape(-1, 3)])

    def is_within(self, direction: Array, angle: float) -> Bools:
        """Return True for motions (M,) on which the tool is within an angle [rad] of a direction (3,) everywhere."""
        is_within = self.end @ direction > np.cos(angle)
        is_within[self.turning] &= (self.inner @ direction > np.cos(angle)).all(axis=0)
        return np.asarray(is_within)


def _is_leaning(program: Program, path: Segments, frame: Array, directions: Directions | None) -> Bools:
    """Return True for motions (M,) on which the tool turns or leans from z of the height map.

    A PTP counts as one of them if its path is known, as it may turn the tool anywhere.

    :param frame: (4, 4) frame of the map in the `$BASE` of the stock, see `home_base`.
    :param directions: directions of the tool; None: along z of the map, except on rapid motions that turn it.
    """
    m = program.motions
    leans = m.rapid & (path.turn > AXIS_TOLERANCE)
    if directions is not None:
        leans |= ~directions.is_within(frame[:3, 2], AXIS_TOLERANCE)
    return np.asarray(np.where(m.kind == PTP, path.joint_moves is not None, leans))


class ToolPoses(Struct, frozen=True, eq=False):
    """The poses of the tool on the motions of a program, in the frame of the height map.

    :param program: the program, and `path` the geometry of its motions.
    :param frame: (4, 4) frame of the map in the `$BASE` of the stock, see `home_base`.
    :param axis: axis of the tool frame that points from the spindle to the tip, a key of `_SPINDLE`.
    :param leans: (M,) True for motions on which the tool is not along z of the map.
    """

    program: Program
    path: Segments
    frame: Array
    axis: str
    leans: Bools

    def spindle_directions(self, motion: Ints, t: Array) -> Array:
        """Return the unit directions (n, 3) from tip to spindle at places on motions; z of the height map if upright.

        :param motion: (n,) rows of `Motions`, and `t` (n,) places on them.
        """
        direction = np.tile([0.0, 0.0, 1.0], (len(motion), 1))
        leaning_rows = np.flatnonzero(self.leans[motion])
        if len(leaning_rows):
            _, direction[leaning_rows] = self.tips_and_axes(motion[leaning_rows], t[leaning_rows])
        return direction

    def tips_and_axes(self, motion: Ints, t: Array) -> tuple[Array, Array]:
        """Return the tips (n, 3) [m] and the unit directions (n, 3) from tip to spindle at places on motions.

        :param motion: (n,) rows of `Motions`, and `t` (n,) places on them.
        """
        inner = np.maximum(t, _NO_LENGTH)  # the start of a motion: `toolpath.at` has places in (0, 1]
        pose = toolpath.at(self.program, self.path, motion, inner).pose[:]
        column, sign = _SPINDLE[self.axis]
        tip, direction = pose[:, :3, 3], sign * pose[:, :3, column]
        # `_to_map` takes two points and two directions of segments: here both are the same
        tip, _, direction, _ = _to_map(self.program, motion, self.frame, (tip, tip), (direction, direction))
        return tip, direction


class _DividedSegments(NamedTuple):
    """Segments of motions, or parts of them between places of a displacement, in order.

    :param motion: (k,) row of `Motions` of each part.
    :param first: (k,) place on the motion where it begins, in [0, 1].
    :param last: (k,) place where it ends.
    """

    motion: Ints
    first: Array
    last: Array


def _divided_at_shift(motion: Ints, first: Array, last: Array, shift: Shift) -> _DividedSegments:
    """Return segments divided at the places of a displacement.

    :param motion: (L,) motions of the segments, in order.
    :param first: (L,) places where they begin, and `last` (L,) where they end.
    :param shift: displacement of the tip, given at places on the path.
    """
    # motion + t is one sorted key of all places
    keys = np.unique(np.concatenate([motion + first, shift.motion + shift.t, motion + last]))
    segment = np.searchsorted(motion + first, keys[:-1], side="right") - 1
    part_motion = motion[segment]
    begin = np.maximum(first[segment], keys[:-1] - part_motion)
    end = np.minimum(last[segment], keys[1:] - part_motion)
    has_length = end - begin > 1e-9  # others are places that differ by rounding
    return _DividedSegments(part_motion[has_length], begin[has_length], end[has_length])


class _SegmentVectors(NamedTuple):
    """Two points and two directions of each of L segments, in the frame of the height map.

    :param first_point: (L, 3) [m].
    :param second_point: (L, 3) [m].
    :param first_direction: (L, 3) unit vectors.
    :param second_direction: (L, 3) unit vectors.
    """

    first_point: Array
    second_point: Array
    first_direction: Array
    second_direction: Array


def _to_map(
    program: Program, motion: Ints, frame: Array, points: tuple[Array, Array], directions: tuple[Array, Array]
) -> _SegmentVectors:
    """Return two points and two directions of L segments in the frame of the height map.

    :param motion: (L,) rows of `Motions`.
    :param frame: (4, 4) frame of the map in the `$BASE` of the stock, see `home_base`.
    :param points: two points (L, 3) of each segment, in the `$BASE` of its motion [m].
    :param directions: two directions (L, 3) of each segment, in the `$BASE` of its motion.
    """
    base = program.motions.base[motion]
    vectors = [vector.copy() for vector in (*points, *directions)]
    home = home_base(program)
    to_map = inverse(frame)
    for row in distinct(base).tolist():
        of_base = base == row
        pose = to_map if row == home else to_map @ inverse(program.bases[home]) @ program.bases[row]
        for k, vector in enumerate(vectors):
            vector[of_base] = vector[of_base] @ pose[:3, :3].T + (pose[:3, 3] if k < len(points) else 0.0)
    return _SegmentVectors(*vectors)


_SPINDLE = {"+Z": (2, -1.0), "-Z": (2, 1.0), "+X": (0, -1.0), "-X": (0, 1.0)}
"""Axis of the tool frame that points to the tip → its column, and the sign with which it points to the spindle."""


_POSITIONING_SHARE = 0.1
"""Moves at feed in a frame only position if their length is below this share of all moves at feed (assumed)."""


def home_base(program: Program) -> int:
    """Return the row of `Program.bases` in which the stock is given.

    G-code: the `$BASE` of the first cutting motion. Robot programs: the one with the greatest length of moves at feed,
    as the first LIN may only position; of equal lengths that of the first cutting motion.
    """
    m, is_robot_program = program.motions, program.keeps_text
    first_base = int(m.base[np.argmax(~m.rapid)])
    if not is_robot_program or (m.base[~m.rapid] == first_base).all():
        return first_base
    length = _length_by_base(program)
    return first_base if length[first_base] == length.max(initial=0.0) else int(np.argmax(length))


def _length_by_base(program: Program) -> Array:
    """Return the length of moves at feed in each `$BASE` (nb,) [m]; arcs as chords, without moves between frames."""
    m = program.motions
    chord = norm(np.diff(m.target.position, axis=0, prepend=0.0))
    # −1 before the first motion: it has no known begin, and does not count
    is_within = ~m.rapid & (np.diff(m.base, prepend=-1) == 0)
    return np.asarray(np.bincount(m.base[is_within], chord[is_within], minlength=len(program.bases)))


def stock_base_issues(program: Program) -> Iterator[Issue]:
    """Yield an issue that names the `$BASE` of the stock, if a robot program moves at feed in several frames.

    It is a note if the moves in all other frames only position, or if the frame is [base] of the cell; else a warning.
    """
    m, is_robot_program = program.motions, program.keeps_text
    bases = distinct(m.base[~m.rapid])
    if is_robot_program and len(bases) > 1:
        home, length = home_base(program), _length_by_base(program)
        rows = np.flatnonzero(~m.rapid & (m.base == home))
        message = (
            f"the program moves at feed in {len(bases)} frames $BASE: the stock stands in that of this line, in which "
            "most of the way is. If the stock is given in another one, the forces are wrong"
        )
        is_of_cell = home == 0 and program.dialect == "krl"  # row 0 of the bases of a KRL program is [base]
        is_certain = is_of_cell or length.sum() - length[home] < _POSITIONING_SHARE * length.sum()
        level: Level = "info" if is_certain else "warning"
        yield Issue(level, "stock-base", message, int(m.line[rows[0]]), count=len(rows))


def _towards_spindle(program: Program, axis: str, motion: Ints, column: Array) -> Array:
    """Return directions from tip to spindle (n, 3) in the `$BASE` of the stock, see `home_base`.

    :param motion: (n,) rows of `Motions`.
    :param column: (n, 3) axis of the tool frame along the spindle, in the `$BASE` of these motions.
    """
    direction, base = _SPINDLE[axis][1] * column, program.motions.base[motion]
    home = program.bases[home_base(program)]
    for row in distinct(base).tolist():
        of_base = base == row
        direction[of_base] = direction[of_base] @ (home[:3, :3].T @ program.bases[row, :3, :3]).T
    return np.asarray(direction)
