"""A new program larger than the memory of the controller: modules that are loaded and run one after another.

A controller holds all modules in its memory at once, so that a program that calls others needs as much. KUKA.DirLoader,
or the operator, loads one module, runs it, and replaces it by the next one. The robot interpreter is stopped meanwhile.

Decisions, where KUKA leaves a choice:

- Each module is a program of its own: header, initialisation, and the system variables as they are at its start.
- It begins with a PTP to the joint angles at which the module before ends, and ends with an exact stop. So the robot
  does not move between two modules. If it was moved, this PTP returns to a position above everything that is cut.
- The spindle and the coolant are switched off at the end of a module, and on again at the start of the next one. An
  operator may load it next to the tool, and no program watches over a spindle that turns between two programs.
- Outputs that other lines of the cell switch keep their state, such as those of a clamp.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.decimals import number_text
from postproc.dialects.krl.language.names import MAX_LENGTH
from postproc.dialects.krl.write.emit import ANGLE_DECIMALS, Emitter, axis_motion, calls_program, emit
from postproc.dialects.new_program import LINE_END, no_lines_comment
from postproc.errors import Issue, ProgramError
from postproc.frames import DEG_PER_RAD, Array, norm
from postproc.program import (
    CIRC,
    SWITCHED_OFF,
    Document,
    Event,
    EventKind,
    Ints,
    Modules,
    Program,
    TargetForces,
    TargetJoints,
    Targets,
    WrittenProgram,
)

_MB = 1e6
_RESERVE = 2000
"""Bytes of a module besides motions and header: system variables, comments, and the line that states its origin."""
_HEIGHT_TOLERANCE = 1e-4
"""Heights of retracts that differ by less than this [m] are equal."""
_STATE = re.compile(r"\s*(\$[\w.]+)\s*=")
"""A line that sets a system variable. Outputs, flags and timers have an index, and keep their values."""
_WHILE_RUNNING = re.compile(r"\s*(INTERRUPT|ANIN|ANOUT)\b", re.IGNORECASE)
"""A statement whose effect ends with the program."""
_SWITCHING: dict[EventKind, EventKind] = SWITCHED_OFF | {kind: kind for kind in SWITCHED_OFF.values()}
"""Kind of an event → kind of the event that switches the same device off: equal for all events of one device."""
_SPINDLE_DIRECTIONS = {"+Z": (2, -1.0), "-Z": (2, 1.0), "+X": (0, -1.0), "-X": (0, 1.0)}
"""Axis of the tool → column of the tool frame, and its sign, so that the product points from the tip to the spindle."""
_AXIS_DECIMALS = 6
"""Unit vectors along the tool are equal if they agree in this number of decimals: at 3 m they differ by 3 µm."""
_END_RULE = "between two rapid moves, with the tool above everything that the program cuts"


def divide_into_modules(
    program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comment_forces: TargetForces | None = None
) -> WrittenProgram:
    """Return a program read from G-code as KRL text; `emit` says what that contains.

    It is divided into modules if it is larger than the memory of the controller, and the cell allows modules.

    :param joints: joint angles at the targets.
    :param comment_forces: forces to be written as comments; None: no force comments.
    :raises ProgramError: the program cannot be written (`emit`), or not be divided so that each module fits.
    """
    output = emit(program, targets, cell, comment_forces)
    if not cell.output.divide_into_modules or output.size <= cell.output.program_memory_MB * _MB:
        return output
    # `emit` keeps no emitter. Twice more: where modules begin depends on the sizes of the lines, and the program then
    # needs exact stops and force comments there
    undivided = Emitter(program, targets, cell, comment_forces)
    module_starts = _module_starts(program, targets, cell, undivided, undivided.write())
    emitter = Emitter(program, targets, cell, comment_forces, module_starts)
    return _Divider(emitter, emitter.write(), module_starts, joints).write()


def _line_ends(output: WrittenProgram) -> Ints:
    """Return the byte offsets (n,) behind the lines of the n targets of a written program."""
    content = np.frombuffer(output.documents[0].to_bytes(), dtype=np.uint8)
    return np.asarray(np.flatnonzero(content == ord("\n"))[output.output_line - 1] + 1)


def _module_starts(
    program: Program, targets: Targets, cell: Cell, emitter: Emitter, output: WrittenProgram
) -> list[int]:
    """Return the targets before which new modules begin, ascending; the number of modules is the smallest possible.

    :param emitter: emitter of the undivided program.
    :param output: the undivided program.
    :raises ProgramError: the text between two possible ends of modules is too large for one module.
    """
    end_motions = _possible_ends(program, cell)
    # motions of targets ascend: the first target behind each end
    next_targets = np.searchsorted(targets.motion, end_motions.astype(targets.motion.dtype), side="right")
    # a module ends after the last target of a motion, and must have targets before and behind its end
    has_targets = (next_targets > 0) & (next_targets < len(targets))
    end_motions, next_targets = end_motions[has_targets], next_targets[has_targets]
    end_offset = np.append(_line_ends(output)[next_targets - 1], output.size)  # of each possible end, then of the text
    switch_lines = [line for kind in _SWITCHING for line in getattr(cell.gcode, kind) or ()]
    header_size = sum(len(line) + len(LINE_END) for line in emitter.header_lines(program.name))
    memory = cell.output.program_memory_MB * _MB
    # a module may have all switching lines twice: at its start and at its end
    capacity = memory - header_size - _RESERVE - 2 * sum(map(len, switch_lines))
    starts: list[int] = []
    begin, end = header_size, -1  # offset at which a module begins; index of the possible end before it, −1: none
    while end_offset[-1] - begin > capacity:
        # offsets ascend: index of the last end at most `capacity` bytes behind `begin`; −1: none
        last_fitting_end = int(np.searchsorted(end_offset, begin + capacity, side="right")) - 1
        if last_fitting_end <= end:
            first_motion = 0 if end < 0 else int(end_motions[end]) + 1
            last_motion = int(end_motions[end + 1]) if end + 1 < len(end_motions) else -1
            size = end_offset[end + 1] - begin + memory - capacity
            raise _size_error(program, cell, first_motion, last_motion, size / _MB)
        end, begin = last_fitting_end, int(end_offset[last_fitting_end])
        starts.append(int(next_targets[end]))
    return starts


def _size_error(program: Program, cell: Cell, first: int, last: int, size: float) -> ProgramError:
    """Return the error that motions first … last need a module that is too large.

    :param last: last motion; −1 is the last motion of the program.
    :param size: size of this module [MB].
    """
    line = program.motions.line
    return ProgramError(
        f"the moves from here to line {line[last]} alone need a module of {size:.2g} MB, more than "
        f"program_memory_MB = {cell.output.program_memory_MB:g} of [output]: a module may not end in them",
        file=program.documents[0].name,
        line=int(line[first]),
        advice=f"A module ends {_END_RULE}. Program a retract there, raise tolerance_mm, or divide the job in "
        "the CAM system.",
    )


def _possible_ends(program: Program, cell: Cell) -> Ints:
    """Return the motions (n,) after which a module may end, ascending: the highest of each run of rapid moves.

    A module is a piece of the program that is loaded and run by itself.

    It must end above everything that the program cuts. The last rapid move before a cut, which approaches the part, and
    motions to joint angles do not count.
    """
    motions = program.motions
    is_cartesian = np.isnan(motions.joints[:, 0])
    candidates = np.flatnonzero(motions.rapid[:-1] & motions.rapid[1:] & is_cartesian[:-1])
    if not len(candidates):
        return candidates
    height = _heights_above_cuts(program, cell, candidates)
    # candidates without a cut between them form a run; within each, sort by height, equal heights by their order
    run = np.cumsum(~motions.rapid)[candidates]
    # the last key sorts first: runs, then heights from above, then order
    by_height = np.lexsort((candidates, -np.floor(height / _HEIGHT_TOLERANCE), run))
    highest = by_height[np.diff(run[by_height], prepend=-1) != 0]  # the first of each run
    return np.asarray(np.sort(candidates[highest[height[highest] > _HEIGHT_TOLERANCE]]))


def _heights_above_cuts(program: Program, cell: Cell, candidates: Ints) -> Array:
    """Return the heights (n,) [m] of the ends of motions above everything that the program cuts.

    The height of a motion is measured along its own tool axis. It is negative below the highest cut, and infinite
    without cuts. Arcs count as whole circles.

    :param candidates: (n,) the motions.
    """
    motions = program.motions
    base = program.bases[motions.base]
    column, sign = _SPINDLE_DIRECTIONS[cell.tool.axis]
    position = np.einsum("nij,nj->ni", base[:, :3, :3], motions.target.position) + base[:, :3, 3]
    tool_axis = sign * np.einsum(
        "nij,nj->ni", base[candidates, :3, :3], motions.target[candidates, :3, :3][:, :, column]
    )
    cut_ends, circles = position[~motions.rapid], _circles_in_root(program)
    height = np.empty(len(candidates))
    axes, axis_index = np.unique(tool_axis.round(_AXIS_DECIMALS), axis=0, return_inverse=True)
    for index, axis in enumerate(axes):
        indices = np.flatnonzero(axis_index.ravel() == index)  # of the candidates with this tool axis
        circle_tops = circles.centre @ axis + circles.radius * norm(np.cross(circles.normal, axis))
        highest_cut = max((cut_ends @ axis).max(initial=-np.inf), circle_tops.max(initial=-np.inf))
        height[indices] = position[candidates[indices]] @ axis - highest_cut
    return height


class _Circles(NamedTuple):
    """The circles of the n arcs of a program, in the robot root.

    :ivar centre: (n, 3) [m].
    :ivar normal: (n, 3) unit vectors.
    :ivar radius: (n,) [m].
    """

    centre: Array
    normal: Array
    radius: Array


def _circles_in_root(program: Program) -> _Circles:
    """Return the circles of the arcs of a program, in the robot root."""
    motions = program.motions
    arcs = np.flatnonzero(motions.kind == CIRC)
    base = program.bases[motions.base[arcs]]
    return _Circles(
        centre=np.einsum("nij,nj->ni", base[:, :3, :3], motions.centre[arcs]) + base[:, :3, 3],
        normal=np.einsum("nij,nj->ni", base[:, :3, :3], motions.normal[arcs]),
        radius=norm(np.cross(motions.normal[arcs], motions.target.position[arcs] - motions.centre[arcs])),
    )


def _text(lines: Sequence[str]) -> str:
    """Return lines as text, each with its line end."""
    return "".join(line + LINE_END for line in lines)


class _SwitchLines(Struct, frozen=True):
    """A spindle or coolant that is on where a module ends.

    :param event: the event that switched it on.
    :param on_lines: lines of the cell that switch it on.
    :param off_lines: lines of the cell that switch it off.
    """

    event: Event
    on_lines: list[str]
    off_lines: list[str]


class _Divider:
    """Divides the text of a program into modules."""

    def __init__(
        self, emitter: Emitter, undivided: WrittenProgram, starts: Sequence[int], joints: TargetJoints
    ) -> None:
        """Name the modules, and find the target before which each event takes place.

        :param emitter: emitter that has written the program with exact stops before `starts`.
        :param undivided: the program that it has written.
        :param starts: targets before which modules begin, without the first module.
        :param joints: joint angles at the targets.
        :raises ProgramError: lines of the cell have an effect that ends with each module.
        """
        self.new_program, self.emitter, self.undivided, self.joints = emitter.new_program, emitter, undivided, joints
        self.first_targets = (0, *starts)
        module_count = len(self.first_targets)
        prefix = emitter.program.name[: MAX_LENGTH - len(f"_{module_count}")]
        self.names = [f"{prefix}_{number}" for number in range(1, module_count + 1)]
        self.event_targets = [self.new_program.first_target(event) for event in emitter.program.events]
        for event in emitter.program.events:
            if event.kind in ("m_code", "tool_change") and any(
                map(_WHILE_RUNNING.match, self.new_program.lines_of(event))
            ):
                raise ProgramError(
                    "the lines of the cell for this block have an effect that ends with each module",
                    file=emitter.program.documents[0].name,
                    line=event.line,
                    advice="INTERRUPT, ANIN and ANOUT hold while a program runs. Remove them from the cell, or write "
                    "divide_into_modules = false.",
                )

    def write(self) -> WrittenProgram:
        """Return the written program: the undivided text, and its modules.

        :raises ProgramError: the cell has no lines to switch off what is on at the end of a module.
        """
        (document,), output_line = self.undivided.documents, self.undivided.output_line
        header = self.emitter.header_lines(self.emitter.program.name)  # of the undivided text
        starts = np.array(self.first_targets[1:], dtype=np.int64)
        # the text of each module begins behind the line of the target before it; offsets in bytes are offsets in the
        # text, since the encoding has one byte for each character
        offsets = [len(_text(header)), *_line_ends(self.undivided)[starts - 1].tolist(), len(document.text)]
        preceding_count = [len(header), *output_line[starts - 1].tolist()]  # lines before the text of each module
        documents, lines, line_count = [], [], 0
        for index, (first, stop) in enumerate(pairwise((*self.first_targets, len(output_line)))):
            top_lines = self.emitter.header_lines(self.names[index], self._module_comment(index))
            top_lines += self._start_lines(first) if first > 0 else []
            bottom_lines = [*self._switch_off_lines(stop), "END"] if stop < len(output_line) else []
            module_text = document.text[offsets[index] : offsets[index + 1]]
            text = _text(top_lines) + module_text + _text(bottom_lines)
            documents.append(Document(f"{self.names[index]}.src", text, document.encoding))
            # lines are numbered through all modules
            lines.append(output_line[first:stop] - preceding_count[index] + len(top_lines) + line_count)
            line_count += text.count("\n")
        modules = Modules(tuple(documents), self.first_targets, np.concatenate(lines))
        return replace(self.undivided, modules=modules, issues=(*self.undivided.issues, self._modules_issue(documents)))

    def _module_comment(self, index: int) -> str:
        """Return the comment that states number and neighbours of a module: ``module 2 of 3, run after …``."""
        predecessor = f", run after {self.names[index - 1]}" if index else ""
        successor = f", next is {self.names[index + 1]}" if index + 1 < len(self.names) else ""
        return f"module {index + 1} of {len(self.names)}{predecessor}{successor}"

    def _modules_issue(self, documents: Sequence[Document]) -> Issue:
        """Return the information that the program is written as several modules, with their sizes."""
        sizes = ", ".join(f"{document.name} ({len(document.text) / _MB:.2g} MB)" for document in documents)
        message = (
            f"the program is larger than program_memory_MB = {self.emitter.cell.output.program_memory_MB:g} of "
            f"[output], and is written as {len(documents)} modules. Load and run them one after another in this order, "
            f"each in place of the one before: {sizes}. Between two modules the robot stays where it is, and the lines "
            "of [gcode] switch spindle and coolant off."
        )
        return Issue("info", "modules", message)

    def _start_lines(self, next_target: int) -> list[str]:
        """Return the lines between the initialisation and the motions of a module that begins with `next_target`.

        They set system variables, move to the end of the module before, and switch on the spindle and the coolant if
        they were on there.
        """
        state, words = self._system_variables(next_target), self.new_program.words
        lines = [*state, axis_motion(self.joints.q[next_target - 1] * DEG_PER_RAD, ANGLE_DECIMALS)]
        cell_lines: list[str] = []
        for switch in self._active_switches(next_target):
            if self._is_switched_at(switch.event, next_target):
                continue  # the program itself switches it here
            cell_lines += switch.on_lines
            lines += [words.wait, *switch.on_lines] if switch.on_lines else [f"; {no_lines_comment(switch.event)}"]
            lines += [words.dwell.format(number_text(dwell.value)) for dwell in self._dwells(switch.event)]
        if calls_program(cell_lines):  # the called program may have changed them
            lines += state
        return lines

    def _system_variables(self, next_target: int) -> list[str]:
        """Return the lines that set the system variables to their values before `next_target`, one line for each."""
        line_of_name: dict[str, str] = {}
        previous_lines = (
            line
            for row in sorted(self.new_program.lines_before)
            if row < next_target
            for line in self.new_program.lines_before[row]
        )
        for line in (*self.emitter.start_lines(), *previous_lines):
            if match := _STATE.match(line):
                line_of_name[match[1].upper()] = line
        return list(line_of_name.values())

    def _switch_off_lines(self, next_target: int) -> list[str]:
        """Return the lines at the end of a module, before `next_target`, that switch spindle and coolant off."""
        lines = [line for switch in self._active_switches(next_target) for line in switch.off_lines]
        return [self.new_program.words.wait, *lines] if lines else []

    def _active_switches(self, next_target: int) -> Iterator[_SwitchLines]:
        """Yield the spindle and the coolant if they are on before `next_target`.

        A device without lines in the cell has no lines to switch it on or off.

        :raises ProgramError: the cell has lines to switch a device on, and none to switch it off.
        """
        for off_kind in dict.fromkeys(SWITCHED_OFF.values()):
            switch_events = [
                event
                for event, target in zip(self.emitter.program.events, self.event_targets, strict=True)
                if target < next_target and _SWITCHING.get(event.kind) == off_kind
            ]
            if not switch_events or switch_events[-1].kind == off_kind:
                continue
            on_lines, off_lines = (
                self.new_program.lines_of(switch_events[-1]),
                self.new_program.lines_of(Event(before=0, kind=off_kind, line=0)),
            )
            if on_lines and not off_lines:
                raise ProgramError(
                    f"a module would end with the {off_kind.removesuffix('_off')} that this line switches on: the "
                    "cell has no lines to switch it off",
                    file=self.emitter.program.documents[0].name,
                    line=switch_events[-1].line,
                    advice=f"Give {off_kind} in [gcode] of the cell.",
                )
            yield _SwitchLines(switch_events[-1], on_lines, off_lines if on_lines else [])

    def _is_switched_at(self, event: Event, next_target: int) -> bool:
        """Return whether the program switches the device of an event between `next_target` and the target before it."""
        off_kind, events = _SWITCHING[event.kind], zip(self.emitter.program.events, self.event_targets, strict=True)
        return any(
            target == next_target and _SWITCHING.get(program_event.kind) == off_kind for program_event, target in events
        )

    def _dwells(self, event: Event) -> Iterator[Event]:
        """Yield the dwells that follow an event before the same target: they wait until the spindle has its speed."""
        events = self.emitter.program.events
        # by identity: equal events may occur several times
        index = max(position for position, program_event in enumerate(events) if program_event is event)
        later_events = zip(events[index + 1 :], self.event_targets[index + 1 :], strict=True)
        return (
            later_event
            for later_event, target in later_events
            if target == self.event_targets[index] and later_event.kind == "dwell"
        )
