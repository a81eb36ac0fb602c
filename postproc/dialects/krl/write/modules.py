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

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.dialects.krl.language.names import MAX_LENGTH
from postproc.dialects.krl.write.emit import Emitter, axis_motion, calls_program, emit
from postproc.dialects.new_program import LINE_END, no_lines, number
from postproc.errors import Issue, ProgramError
from postproc.frames import DEG_PER_RAD, norm
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
"""Bytes for what a module has in addition: system variables, comments, and the line that says where it comes from."""
_SAME_HEIGHT = 1e-4
"""Places of a retract whose heights differ by less [m] are equally high."""
_STATE = re.compile(r"\s*(\$[\w.]+)\s*=")
"""A line that sets a system variable. Outputs, flags and timers have an index, and keep their values."""
_WHILE_RUNNING = re.compile(r"\s*(INTERRUPT|ANIN|ANOUT)\b", re.IGNORECASE)
"""A statement whose effect ends with the program."""
_SWITCHING: dict[EventKind, EventKind] = SWITCHED_OFF | {kind: kind for kind in SWITCHED_OFF.values()}
"""Kind of an event → the kind that switches off what it switches: equal for all events of one device."""
_AXES = {"+Z": (2, -1.0), "-Z": (2, 1.0), "+X": (0, -1.0), "-X": (0, 1.0)}
"""Column of a tool frame, and sign, that point from the tip to the spindle."""
_END_RULE = "between two rapid moves, with the tool above everything that the program cuts"


def divide_into_modules(
    program: Program, targets: Targets, joints: TargetJoints, cell: Cell, comment_forces: TargetForces | None = None
) -> WrittenProgram:
    """Return a program read from G-code as KRL, see `emit`; in modules if it is too large and the cell wants them.

    :param joints: joint angles at the targets.
    :raises ProgramError: it cannot be divided so that each module fits.
    """
    output = emit(program, targets, cell, comment_forces)
    if not cell.output.divide_into_modules or output.size <= cell.output.program_memory_MB * _MB:
        return output
    undivided = Emitter(program, targets, cell, comment_forces)
    starts = _module_starts(program, targets, cell, undivided, undivided.write())
    emitter = Emitter(program, targets, cell, comment_forces, starts)
    return _Divider(emitter, emitter.write(), starts, joints).write()


def _line_ends(output: WrittenProgram) -> Ints:
    """Return the offsets (n,) behind the lines of n targets in a written program."""
    content = np.frombuffer(output.documents[0].to_bytes(), dtype=np.uint8)
    return np.asarray(np.flatnonzero(content == ord("\n"))[output.output_line - 1] + 1)


def _module_starts(
    program: Program, targets: Targets, cell: Cell, emitter: Emitter, output: WrittenProgram
) -> list[int]:
    """Return the targets before which new modules begin: as few as possible.

    :raises ProgramError: the text between two places where a module may end is too large for one module.
    """
    end_motions = _places(program, cell)
    next_targets = np.searchsorted(targets.motion, end_motions.astype(targets.motion.dtype), side="right")
    end_motions, next_targets = (
        end_motions[(next_targets > 0) & (next_targets < len(targets))],
        next_targets[(next_targets > 0) & (next_targets < len(targets))],
    )
    ends = _line_ends(output)
    end_offset = np.append(ends[next_targets - 1], output.size)
    lines = [line for kind in _SWITCHING for line in getattr(cell.gcode, kind) or ()]
    header_size = sum(len(line) + 2 for line in emitter.header_lines(program.name))
    capacity = cell.output.program_memory_MB * _MB - header_size - _RESERVE - 2 * sum(map(len, lines))
    starts: list[int] = []
    begin, index = header_size, -1
    while end_offset[-1] - begin > capacity:
        last = int(np.searchsorted(end_offset, begin + capacity, side="right")) - 1
        if last <= index:
            source_lines = program.motions.line
            first = source_lines[0] if index < 0 else source_lines[end_motions[index] + 1]
            last_line = source_lines[end_motions[index + 1]] if index + 1 < len(end_motions) else source_lines[-1]
            size = (end_offset[index + 1] - begin + cell.output.program_memory_MB * _MB - capacity) / _MB
            raise ProgramError(
                f"the moves from here to line {last_line} alone need a module of {size:.2g} MB, more than "
                f"program_memory_MB = {cell.output.program_memory_MB:g} of [output]: a module may not end in them",
                file=program.documents[0].name,
                line=int(first),
                advice=f"A module ends {_END_RULE}. Program a retract there, raise tolerance_mm, or divide the job in "
                "the CAM system.",
            )
        index, begin = last, int(end_offset[last])
        starts.append(int(next_targets[last]))
    return starts


def _places(program: Program, cell: Cell) -> Ints:
    """Return the motions (n,) after which a module may end: of consecutive rapid moves, the one that ends highest.

    Its end must be above everything that the program cuts; height is measured along the tool axis there. The last rapid
    move before a cut does not count.
    """
    motions = program.motions
    cartesian = np.isnan(motions.joints[:, 0])
    candidates = np.flatnonzero(motions.rapid[:-1] & motions.rapid[1:] & cartesian[:-1])
    if not len(candidates):
        return candidates
    base = program.bases[motions.base]
    column, sign = _AXES[cell.tool.axis]
    position = np.einsum("nij,nj->ni", base[:, :3, :3], motions.target.position) + base[:, :3, 3]
    tool_axis = sign * np.einsum(
        "nij,nj->ni", base[candidates, :3, :3], motions.target[candidates, :3, :3][:, :, column]
    )
    cuts = np.flatnonzero(~motions.rapid)
    arcs = np.flatnonzero(motions.kind == CIRC)
    centre = np.einsum("nij,nj->ni", base[arcs, :3, :3], motions.centre[arcs]) + base[arcs, :3, 3]
    normal = np.einsum("nij,nj->ni", base[arcs, :3, :3], motions.normal[arcs])
    radius = norm(np.cross(motions.normal[arcs], motions.target.position[arcs] - motions.centre[arcs]))
    height = np.empty(len(candidates))
    axes, axis_row = np.unique(tool_axis.round(6), axis=0, return_inverse=True)
    for row, axis in enumerate(axes):
        axis_candidates = np.flatnonzero(axis_row.ravel() == row)
        arc_heights = centre @ axis + radius * norm(np.cross(normal, axis))
        highest = max((position[cuts] @ axis).max(initial=-np.inf), arc_heights.max(initial=-np.inf))
        height[axis_candidates] = position[candidates[axis_candidates]] @ axis - highest
    # candidates without a cut between them are one run; in each, the highest, and of equal heights the first
    run = np.cumsum(~motions.rapid)[candidates]
    chosen_candidates = np.lexsort((candidates, -np.floor(height / _SAME_HEIGHT), run))
    chosen_candidates = chosen_candidates[np.diff(run[chosen_candidates], prepend=-1) != 0]
    return np.asarray(np.sort(candidates[chosen_candidates[height[chosen_candidates] > _SAME_HEIGHT]]))


class _SwitchLines(Struct, frozen=True):
    """Spindle or coolant that is on where a module ends: lines of the cell to switch it on and off."""

    event: Event
    on_lines: list[str]
    off_lines: list[str]


class _Divider:
    """Divides the text of a program at its targets `starts`."""

    def __init__(
        self, emitter: Emitter, undivided: WrittenProgram, starts: Sequence[int], joints: TargetJoints
    ) -> None:
        """Name the modules, and find the target before which each event is.

        :raises ProgramError: lines of the cell have an effect that ends with each module.
        """
        self.new_program, self.emitter, self.undivided, self.joints = emitter.new_program, emitter, undivided, joints
        self.first_targets = (0, *starts)
        name, tail = emitter.program.name, len(str(len(self.first_targets))) + 1
        self.names = [f"{name[: MAX_LENGTH - tail]}_{index}" for index in range(1, len(self.first_targets) + 1)]
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
        """Return the written program as one text, with its modules."""
        text, ends = self.undivided.documents[0].text, _line_ends(self.undivided)
        head = sum(len(line) + len(LINE_END) for line in self.emitter.header_lines(self.emitter.program.name))
        documents, lines, line_count = [], [], 0
        output_line = self.undivided.output_line
        for index, (first, stop) in enumerate(pairwise((*self.first_targets, len(output_line)))):
            top_lines = self.emitter.header_lines(self.names[index], self._order(index))
            head_lines = (
                len(self.emitter.header_lines(self.emitter.program.name)) if first == 0 else int(output_line[first - 1])
            )
            top_lines += [] if first == 0 else self._start_lines(first)
            body = text[
                head if first == 0 else ends[first - 1] : ends[stop - 1] if stop < len(output_line) else len(text)
            ]
            bottom_lines = [*self._switch_off_lines(stop), "END"] if stop < len(output_line) else []
            module_text = (
                "".join(line + LINE_END for line in top_lines)
                + body
                + "".join(line + LINE_END for line in bottom_lines)
            )
            documents.append(Document(f"{self.names[index]}.src", module_text, self.undivided.documents[0].encoding))
            lines.append(output_line[first:stop] - head_lines + len(top_lines) + line_count)
            line_count += module_text.count("\n")
        modules = Modules(tuple(documents), self.first_targets, np.concatenate(lines))
        return replace(self.undivided, modules=modules, issues=(*self.undivided.issues, self._issue(documents)))

    def _order(self, index: int) -> str:
        """Return the comment that states the place of a module among the others."""
        predecessor = f", run after {self.names[index - 1]}" if index else ""
        successor = f", next is {self.names[index + 1]}" if index + 1 < len(self.names) else ""
        return f"module {index + 1} of {len(self.names)}{predecessor}{successor}"

    def _issue(self, documents: Sequence[Document]) -> Issue:
        """Return the information that the program is written as several modules, with their sizes."""
        sizes = ", ".join(f"{document.name} ({len(document.text) / _MB:.2g} MB)" for document in documents)
        message = (
            f"the program is larger than program_memory_MB = {self.emitter.cell.output.program_memory_MB:g} of "
            f"[output], and is written as {len(documents)} modules. Load and run them one after another in this order, "
            f"each in place of the one before: {sizes}. Between two modules the robot stays where it is, and the lines "
            "of [gcode] switch spindle and coolant off."
        )
        return Issue("info", "modules", message)

    def _start_lines(self, k: int) -> list[str]:
        """Return the first lines of a module that begins with target `k`.

        They set system variables, move to the end of the module before, and switch on what was on there.
        """
        state: dict[str, str] = {}
        previous_lines = (
            line for row in sorted(self.new_program.before) if row < k for line in self.new_program.before[row]
        )
        for line in (*self.emitter.start_lines(), *previous_lines):
            match = _STATE.match(line)
            if match:
                state[match[1].upper()] = line
        lines, cell_lines = [*state.values(), axis_motion(self.joints.q[k - 1] * DEG_PER_RAD, 5)], list[str]()
        for switch in self._active_switches(k):
            if self._is_switched_at(switch.event, k):
                continue  # the program itself switches it here
            event = switch.event
            cell_lines += switch.on_lines
            lines += [self.new_program.words.wait, *switch.on_lines] if switch.on_lines else [f"; {no_lines(event)}"]
            lines += [self.new_program.words.dwell.format(number(dwell.value)) for dwell in self._dwells(event)]
        return [
            *lines,
            *(state.values() if calls_program(cell_lines) else ()),
        ]  # a program that is called may have set others

    def _switch_off_lines(self, k: int) -> list[str]:
        """Return the lines at the end of a module, before target `k`, that switch off what is on."""
        lines = [line for switch in self._active_switches(k) for line in switch.off_lines]
        return [self.new_program.words.wait, *lines] if lines else []

    def _active_switches(self, k: int) -> Iterator[_SwitchLines]:
        """Yield the spindle and the coolant if they are on before target `k`.

        :raises ProgramError: the cell has lines to switch it on, and none to switch it off.
        """
        for off_kind in dict.fromkeys(SWITCHED_OFF.values()):
            switch_events = [
                event
                for event, target in zip(self.emitter.program.events, self.event_targets, strict=True)
                if target < k and _SWITCHING.get(event.kind) == off_kind
            ]
            if not switch_events or switch_events[-1].kind == off_kind:
                continue
            on_lines, off_lines = (
                self.new_program.lines_of(switch_events[-1]),
                self.new_program.lines_of(Event(0, off_kind, 0)),
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

    def _is_switched_at(self, event: Event, k: int) -> bool:
        """Return whether the program itself switches, at target `k`, the device of an event."""
        off_kind, events = _SWITCHING[event.kind], zip(self.emitter.program.events, self.event_targets, strict=True)
        return any(target == k and _SWITCHING.get(program_event.kind) == off_kind for program_event, target in events)

    def _dwells(self, event: Event) -> Iterator[Event]:
        """Yield the dwells that follow an event before the same target: they wait until the spindle has its speed."""
        events, at = self.emitter.program.events, self.event_targets
        index = max(position for position, program_event in enumerate(events) if program_event is event)
        return (
            event_after
            for position, event_after in enumerate(events)
            if position > index and at[position] == at[index] and event_after.kind == "dwell"
        )
