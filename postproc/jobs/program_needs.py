"""What a program needs from the cell and the process before it can be converted.

`postproc init PROGRAM` and `postproc start PROGRAM` ask for these things only. The text of the program shows tools,
work offsets, M codes and rotary axes (`dialects.dialect.Survey`). For the other settings the program is read with an
answer and without it: a setting without which the reader refuses the program is needed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import correction, toolpath
from postproc.cell import Box, Cell, Frame, GCode, Machine, Start, Tool
from postproc.decimals import without_negative_zero
from postproc.dialects import registry
from postproc.dialects.dialect import CamFormat, Survey, WithNumberedFrames
from postproc.errors import InputError
from postproc.frames import MM_PER_M, Array
from postproc.jobs import answers as parse
from postproc.jobs.programs import load_robot, read_documents, states_forces
from postproc.machining.process import DEFAULT
from postproc.machining.tool_comments import Comment, CommentedTool, commented_tools, stock_size
from postproc.program import CIRC, Document, Ints, Program, distinct
from postproc.robot import RobotModel

_ROBOT, _RAPID_ROBOT = "kuka_kr270", "abb_irb6700_200_260"
"""Robot of the trial readings: what a CAM program means does not depend on it."""
_START = (0.0, -90.0, 100.0, 0.0, 80.0, 0.0)
"""Start joints [deg], clear of singular poses; the needs of a program do not depend on them."""
_CLEARANCE_MM = 200.0
"""Height of retracts in trial readings [mm]; the needs of a program do not depend on it."""
_SIDE_MM = 5.0
"""A stock without a stated size is larger than what the tools sweep by this on each side [mm] (assumed)."""


_ARC_ANGLE_STEP = np.radians(3.0)
"""Largest angle between points on arcs [rad]: the extremes of an arc are missed by 0.034 % of its radius."""
_LEAST_UPRIGHT_COSINE = float(np.cos(np.radians(30.0)))
"""Cosine of the largest tilt at which a tool that goes up does not cut (assumed)."""
_LEAST_DEPTH_M = 1e-4
"""A rapid move that ends below the highest cut by more than this is beside the stock [m] (assumed)."""


class ProgramNeeds(Struct, frozen=True):
    """Needs of a program, and values that it states itself.

    :param file: path of the program.
    :param dialect: name of its format.
    :param tools: T numbers of its tool changes, in order of first use.
    :param robot_tools: tools that cut in a robot program, if there are several: n of `TOOL_DATA[n]` (KRL), or name of
        the tooldata (RAPID).
    :param cutters: T number → cutter as comments describe it; number 0 in a program without tool numbers.
    :param work_offsets: codes of work offsets other than G54.
    :param frames: tables of the cell for frames of the controller that it names by number, such as ``"base_data.3"``.
    :param m_codes: M codes of the machine.
    :param rotary: letters of its rotary axes.
    :param tip_controlled: whether it switches tool-centre-point control on.
    :param switches: what it switches on: ``"spindle"``, ``"coolant"``.
    :param settings: settings that the reader needs: ``"home"``, ``"radius_offsets"``, ``"dwell_unit"``.
    :param has_forces: whether it states its cutting forces in comments.
    :param has_speeds: whether it states spindle speeds.
    :param span: smallest and largest X, Y, Z of its cutting moves in `$BASE` with all work offsets at zero [mm]; None:
        it could not be read, does not cut, or turns axes without tool-centre-point control.
    :param low_rapids: X, Y of rapid moves that end below the top of its cuts [mm]: no stock is there at first.
    :param stock_mm: lengths of the stock along X, Y, Z that comments state [mm].
    :param refusal: why it cannot be converted with any answer; empty: it can be read.
    """

    file: Path
    dialect: str
    tools: tuple[int, ...] = ()
    robot_tools: tuple[str, ...] = ()
    cutters: Mapping[int, CommentedTool] = {}
    work_offsets: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    m_codes: tuple[str, ...] = ()
    rotary: tuple[str, ...] = ()
    tip_controlled: bool = False
    switches: frozenset[str] = frozenset()
    settings: tuple[str, ...] = ()
    has_forces: bool = False
    has_speeds: bool = False
    span: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    low_rapids: tuple[tuple[float, float], ...] = ()
    stock_mm: tuple[float, float, float] | None = None
    refusal: str = ""

    @property
    def is_robot_program(self) -> bool:
        """Whether it is in a robot language (KRL, RAPID), so that it states itself how it moves and retracts."""
        return registry.dialect_of_name(self.dialect).writer is not None

    @property
    def changes_tools(self) -> bool:
        """Whether it mounts a second tool."""
        return len(self.tools) > 1

    @property
    def cutter_keys(self) -> tuple[str, ...]:
        """Keys in [tools] of a process for the cutters of the program; `DEFAULT` if it names no tools."""
        return tuple(str(number) if number else DEFAULT for number in self.tools) or self.robot_tools or (DEFAULT,)

    @property
    def only_tool(self) -> int | None:
        """T number of its only tool; None if it names none, or several."""
        return self.tools[0] if len(self.tools) == 1 else None

    def cutter(self, key: str) -> CommentedTool:
        """Return the cutter with a key in [tools] of a process as comments describe it; empty if they do not."""
        if key == DEFAULT:  # the tool of a program without tool numbers
            return self.cutters.get(0, CommentedTool())
        # comments describe no tool by name
        return self.cutters.get(int(key), CommentedTool()) if key.isdecimal() else CommentedTool()

    def stock_box(self, diameters: Mapping[str, float]) -> Box | None:
        """Return the stock in `$BASE` [mm], rounded outwards to whole millimetres; None: the program does not cut.

        A size that comments state is centred on the cutting moves in X and Y, and goes down from the top. Else the box
        is what the tools sweep, and `_SIDE_MM` more; a side where the tool comes down in rapid is moved inwards. The
        top is the highest cut, or Z = 0 if that is higher: there may be material above the cuts.

        :param diameters: diameters of the cutters by key in [tools] of a process [mm].
        """
        if self.span is None:
            return None
        low, high = (np.array(corner) for corner in self.span)
        margin = 0.5 * max(diameters.values(), default=0.0) + _SIDE_MM
        low[:2], high[:2] = low[:2] - margin, high[:2] + margin
        if self.stock_mm is not None:
            middle, half_size = 0.5 * (low + high)[:2], 0.5 * np.array(self.stock_mm[:2])
            low[:2], high[:2] = middle - half_size, middle + half_size
            low[2] = min(low[2], max(high[2], 0.0) - self.stock_mm[2])
        else:
            low[2] -= _SIDE_MM
            _exclude_points(low, high, self.low_rapids, margin)
        high[2] = max(high[2], 0.0)
        low, high = without_negative_zero(np.floor(low)), without_negative_zero(np.ceil(high))
        if low[2] >= high[2]:  # a box needs a height
            high[2] = low[2] + 1.0
        return Box(*((float(begin), float(end)) for begin, end in zip(low, high, strict=True)))


def needs_of(path: Path, dialect: str | None = None) -> ProgramNeeds:
    """Return the needs of a program.

    :param dialect: name of its format; None: by the extension.
    :raises ProgramError: the file cannot be read.
    :raises InputError: its extension is not known.
    """
    reader = registry.dialect_of_file(path, dialect)
    name = reader.name
    documents = read_documents(path, name)
    survey = Survey()
    if isinstance(reader, CamFormat) and reader.survey is not None:
        survey = reader.survey(documents[0])
    trial = _Trial(documents, name, registry.program_name(path), survey)
    program, refusal, settings = trial.outcome()
    frames = () if program is None else trial.needed_frames()
    changes = survey.tool_changes
    comments = [Comment(line, text) for line, text in survey.comments]
    needs = ProgramNeeds(
        path,
        name,
        tools=tuple(dict.fromkeys(number for _, number in changes)),
        cutters=commented_tools(comments, changes, inches=survey.inches),
        work_offsets=survey.work_offsets,
        frames=frames,
        m_codes=survey.m_codes,
        rotary=survey.rotary,
        tip_controlled=survey.tip_controlled,
        switches=survey.switches,
        settings=settings,
        stock_mm=stock_size(comments, inches=survey.inches),
        refusal=refusal,
    )
    if program is None:
        return replace(needs, has_forces=needs.is_robot_program and states_forces(path))
    return _add_content(needs, program)


def _add_content(needs: ProgramNeeds, program: Program) -> ProgramNeeds:
    """Return the needs with tools, forces, speeds and extents of the program as it was read."""
    motions = program.motions
    tools = needs.tools or tuple(
        dict.fromkeys(int(event.value) for event in program.events if event.kind == "tool_change")
    )
    cutting_tools = distinct(motions.tool[~np.asarray(motions.rapid)]).tolist() if program.tool_keys else []
    cutter_keys = dict.fromkeys(key for row in cutting_tools for key in program.tool_keys[row])
    robot_tools = sorted(cutter_keys, key=lambda key: int(key) if key.isdecimal() else 0)  # names keep their order
    return replace(
        needs,
        tools=tools,
        robot_tools=tuple(robot_tools) if len(robot_tools) > 1 else (),
        has_forces=bool(program.notes),
        has_speeds=any(event.kind in ("spindle_on", "spindle_ccw") and event.value > 0.0 for event in program.events),
        # without tool-centre-point control X, Y, Z may be machine axes, not the tip in the part
        span=None if needs.rotary and not needs.tip_controlled else _span(program),
        low_rapids=_low_rapids(program),
    )


def _low_rapids(program: Program) -> tuple[tuple[float, float], ...]:
    """Return X, Y [mm] of rapid moves that end below the highest cutting target: no stock is there at first.

    They are rounded to 1 mm, each once, in the order of the moves. Moves to a place where a cut ended before are left
    out, such as moves into a hole between two pecks.
    """
    motions = program.motions
    ends = motions.target.position
    rapid = np.asarray(motions.rapid)
    if rapid.all():
        return ()
    end_points = [tuple(place) for place in np.round(ends[:, :2] * MM_PER_M).tolist()]
    cutting = _cutting_motions(program)
    top = ends[cutting, 2].max() if len(cutting) else 0.0
    is_low = rapid & (ends[:, 2] < max(0.0, top) - _LEAST_DEPTH_M)  # the stock reaches up to Z 0 at least
    cut_places: set[tuple[float, ...]] = set()
    points: dict[tuple[float, float], None] = {}
    for place, is_rapid, ends_low in zip(end_points, rapid.tolist(), is_low.tolist(), strict=True):
        if not is_rapid:
            cut_places.add(place)
        elif ends_low and place not in cut_places:
            points[place[0], place[1]] = None
    return tuple(points)


def _exclude_points(low: Array, high: Array, points: Sequence[tuple[float, float]], margin: float) -> None:
    """Move sides of a box inwards, in place, so that a tool at some points does not touch it.

    Each point moves the side that is nearest to it. Points more than a margin outside move no side. Nor do points more
    than two margins inside, which are taken to be in material that was cut before.

    :param low: (3,) smallest corner of the box [mm], changed; `high`: (3,) its largest corner, changed.
    :param points: X, Y of the tool axis [mm].
    :param margin: distance of the tool axis to keep from the box [mm].
    """
    for x, y in points:
        # distance of the tool axis from each side, positive inside
        gaps = {(0, "low"): x - low[0], (0, "high"): high[0] - x, (1, "low"): y - low[1], (1, "high"): high[1] - y}
        (axis, side), gap = min(gaps.items(), key=lambda item: item[1])
        if -margin < gap <= 2.0 * margin:
            if side == "low":
                low[axis] = (x, y)[axis] + margin
            else:
                high[axis] = (x, y)[axis] - margin


def _cutting_motions(program: Program) -> Ints:
    """Return the indices of the motions that cut, sorted.

    A motion cuts if it is not rapid and no retract of an upright tool at feed. If comments state forces, it must also
    be under a force.
    """
    is_cutting = ~np.asarray(program.motions.rapid)
    target: Array = program.motions.target[:]
    columns = [0, 2] if program.keeps_text else [2]  # the axis of the tool: a robot program does not say which it is
    is_upright = (np.abs(target[:, 2, columns]) > _LEAST_UPRIGHT_COSINE).any(axis=1)
    is_cutting &= ~(toolpath.retract_motions(target[:, :3, 3], np.array([0.0, 0.0, 1.0])) & is_upright)
    if program.notes:  # forces that comments state, each from one motion on
        begins = np.array([note.before for note in program.notes])
        is_loaded = np.array([False, *(any(note.wrench) for note in program.notes)])
        # number of notes up to each motion: its last note holds, and before the first there is no force
        is_cutting &= is_loaded[np.searchsorted(begins, np.arange(len(is_cutting)), side="right")]
    return np.flatnonzero(is_cutting)


def _span(program: Program) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
    """Return the corners (smallest X, Y, Z; largest X, Y, Z) of the box of cutting moves in `$BASE` [mm].

    The start of a move counts with its X and Y only: a plunge starts above the material. None: the program does not
    cut.
    """
    cutting = _cutting_motions(program)
    if not len(cutting):
        return None
    targets: Array = program.motions.target.position
    starts = targets[np.maximum(cutting - 1, 0)]
    starts[:, 2] = targets[cutting, 2]
    points = np.concatenate([targets[cutting], _arc_points(program, cutting), starts]) * MM_PER_M
    x_min, y_min, z_min = without_negative_zero(np.round(points.min(axis=0), 3)).tolist()
    x_max, y_max, z_max = without_negative_zero(np.round(points.max(axis=0), 3)).tolist()
    return (x_min, y_min, z_min), (x_max, y_max, z_max)


def _arc_points(program: Program, cutting: Ints) -> Array:
    """Return points (n, 3) [m] on the arcs of cutting motions, at most 3° apart, each in the `$BASE` of its motion.

    They are needed because the end of an arc does not show its extent: a full circle ends where it begins.

    :param cutting: indices of the cutting motions.
    """
    arcs = cutting[program.motions.kind[cutting] == CIRC]
    part_count = np.ceil(program.motions.sweep[arcs] / _ARC_ANGLE_STEP).astype(np.int64)  # of each arc
    motion, t = toolpath.even_places(arcs, part_count, at="end")
    # the start pose of the robot is not used: a move precedes the first arc
    path = toolpath.segments(program, np.eye(4))
    return np.asarray(toolpath.at(program, path, motion, t).pose.position)


_DWELL_UNITS = ("ms", "s")
"""Units of dwells that are tried, in this order: a number fits one unit or both."""
_ROTARY_KINDS = ("tcp", "indexed")
"""Kinds of rotary axes that are tried, in this order: with indexed axes the reader accepts cycles too."""
_WITHOUT_HOME: Mapping[str, Any] = {"radius_offsets": "wear"}
_ASSUMED_ANSWERS: Mapping[str, Any] = {"home": [0.0, 0.0, _CLEARANCE_MM], **_WITHOUT_HOME}
"""Settings that only some programs need → answer in trial readings. A retract with a tilted tool is refused if the cell
has a home position, so `_WITHOUT_HOME` is tried too."""


class _TrialOutcome(NamedTuple):
    """Outcome of trial readings.

    :ivar program: the program as it is read; None: it cannot be read.
    :ivar refusal: why it cannot be read; empty: it can be read, or frames of the controller are missing.
    :ivar settings: settings without which it cannot be read.
    """

    program: Program | None
    refusal: str = ""
    settings: tuple[str, ...] = ()


class _Trial:
    """Trial readings of a program with cells that lack some settings, to find the settings that it needs.

    :param documents: files of the program; `dialect`: name of its format.
    :param name: name of the program; `survey`: what its text shows.
    """

    def __init__(self, documents: Sequence[Document], dialect: str, name: str, survey: Survey) -> None:
        self.documents, self.dialect, self.name, self.survey = documents, dialect, name, survey
        self.robot_name = _RAPID_ROBOT if dialect == "rapid" else _ROBOT
        self.robot: RobotModel = load_robot(self.robot_name)
        reader = registry.dialect_of_name(dialect)
        self.frames = reader.numbered_frames(documents) if isinstance(reader, WithNumberedFrames) else ()

    def outcome(self) -> _TrialOutcome:
        """Return the program as it is read with the first answers that it accepts, and the settings that it needs.

        Of a program that accepts none, the shortest refusal is returned.
        """
        if registry.dialect_of_name(self.dialect).writer is not None:
            return self._read_robot_program()
        answers, refusals = dict(_ASSUMED_ANSWERS), []
        kinds = _ROTARY_KINDS if self.survey.rotary else _ROTARY_KINDS[:1]
        dwells = ({}, *({"dwell_unit": unit} for unit in _DWELL_UNITS))
        for usual_answers, kind, dwell in product((_ASSUMED_ANSWERS, _WITHOUT_HOME), kinds, dwells):
            answers = {**usual_answers, **dwell}
            program, refusal = self._read(answers, kind)
            if program is not None:
                break
            refusals.append(refusal)
        else:
            return _TrialOutcome(None, min(refusals, key=len))  # the shorter text: another unit adds faults of its own
        settings = [
            setting
            for setting in answers  # needed if the program is refused without it
            if self._is_refused({key: value for key, value in answers.items() if key != setting}, kind)
        ]
        return _TrialOutcome(program, settings=tuple(settings))

    def needed_frames(self) -> tuple[str, ...]:
        """Return the frames by number that the program needs: without one of them it is refused.

        The program must be readable with all frames.
        """
        return tuple(frame for frame in self.frames if self._is_refused({}, frames={*self.frames} - {frame}))

    def _read_robot_program(self) -> _TrialOutcome:
        """Return a robot program as `outcome` does, without settings and without a refusal.

        It may be unreadable here only because frames of the controller are missing, which is no refusal.
        """
        program, _ = self._read({})
        return _TrialOutcome(program)

    def _is_refused(
        self, answers: Mapping[str, Any], kind: str = _ROTARY_KINDS[0], frames: Collection[str] | None = None
    ) -> bool:
        """Return whether the program cannot be read with some answers; parameters as of `_read`."""
        program, _ = self._read(answers, kind, frames)
        return program is None

    def _read(
        self, answers: Mapping[str, Any], kind: str = _ROTARY_KINDS[0], frames: Collection[str] | None = None
    ) -> tuple[Program | None, str]:
        """Return the program as it is read with some answers, and an empty text; if it is refused, None and the reason.

        :param answers: settings by name, as in `_ASSUMED_ANSWERS`.
        :param kind: meaning of X, Y, Z with rotary axes, one of `_ROTARY_KINDS`.
        :param frames: frames by number that the cell states; None: all that the program names.
        """
        cell = self._cell(answers, kind, self.frames if frames is None else frames)
        try:
            return correction.read(self.documents, self.robot, cell, self.name, self.dialect), ""
        except InputError as cause:
            return None, str(cause)

    def _cell(self, answers: Mapping[str, Any], kind: str, frames: Collection[str]) -> Cell:
        """Return a cell for a trial reading. Its frames are arbitrary: the needs of a program do not depend on them.

        :param answers: settings by name, as in `_ASSUMED_ANSWERS`; `kind`, `frames`: see `_read`.
        """
        letters = [letter for letter in "CBA" if letter in self.survey.rotary][:2]
        points = dict.fromkeys(letters, (0.0, 0.0, 0.0))
        gcode = GCode(
            tool_change=[],
            radius_offsets=answers.get("radius_offsets", "radius"),
            dwell_unit=answers.get("dwell_unit"),
        )
        return Cell(
            robot=self.robot_name,
            base=Frame(X=1500.0, Z=700.0),
            tool=Tool(Z=350.0),
            start=Start(_START),
            gcode=gcode,
            machine=Machine(home=answers.get("home"), clearance_Z=_CLEARANCE_MM),
            m_codes={code: [] for code in self.survey.m_codes},
            work_offsets={code: Frame() for code in self.survey.work_offsets},
            base_data={number: Frame(X=1500.0, Z=700.0) for number in _numbers(frames, "base_data")},
            tool_data={number: Tool(Z=350.0) for number in _numbers(frames, "tool_data")},
            rotary=parse.rotary(letters, kind, points if kind == "indexed" else {}) if letters else None,
        )


def _numbers(frames: Collection[str], table: str) -> Iterator[str]:
    """Return an iterator over the numbers of frames in a table of the cell: ``3`` of ``"base_data.3"``."""
    return (number for name, _, number in (frame.partition(".") for frame in frames) if name == table)
