"""All checks of a commanded path, and of the origin that a program states."""

from __future__ import annotations

from postproc.cell import Cell
from postproc.correction import checks, closely, joint_speeds
from postproc.correction.result import Mode
from postproc.dialects import registry
from postproc.elastostatics import Compensation
from postproc.errors import Issue
from postproc.frames import M_PER_MM, norm
from postproc.program import Program
from postproc.under_load import PathUnderLoad


def of_origin(program: Program, mode: Mode) -> list[Issue]:
    """Return the issues of a program that postproc wrote: it must not be corrected a second time."""
    writer = registry.by_name(program.dialect).writer
    if writer is None:
        return []
    origin = writer.origin(program.documents)
    if origin.part_of:
        message = (
            f"this file is a part of {origin.part_of}, which calls it and sets its start position, frames "
            f"and speed. Name {origin.part_of} instead."
        )
        return [Issue("error", "part-of-program", message, origin.line)]
    if mode != "predict":
        for document in program.documents[1:]:
            called = writer.origin([document])
            if called.mode == "corrected" and origin.mode != "corrected":
                message = (
                    f"{document.name}, which this program calls, was corrected by postproc {called.version} before: "
                    "its targets are commands already, and would be corrected twice. Put the original there."
                )
                return [Issue("error", "corrected-before", message)]
    if origin.state == "none":
        return []
    if mode != "predict" and origin.mode != "nominal":
        message = (
            f"this program was corrected by postproc {origin.version} before: its targets are commands already, and "
            "would be corrected twice. Convert the program that it was made from."
        )
        return [Issue("error", "corrected-before", message, origin.line)]
    if origin.state == "changed":
        message = f"this program was changed since postproc {origin.version} wrote it."
        return [Issue("warning", "changed-since", message, origin.line)]
    return []


def of_tools(program: Program, cell: Cell) -> list[Issue]:
    """Return an error if a program changes to another tool, and the cell does not say how."""
    changes = [event for event in program.events if event.kind == "tool_change"]
    second = next((event for event in changes if event.value != changes[0].value), None)
    if program.keeps_text or second is None or cell.gcode.tool_change is not None:
        return []
    message = (
        f"the program changes from tool {changes[0].value:g} to tool {second.value:g}, but the cell has no tool_change "
        'lines. Give [gcode] tool_change = ["…"], or tool_change = [] if the tool is changed by hand, without a line.'
    )
    return [Issue("error", "tool-change", message, second.line)]


def of_path(path: PathUnderLoad, command: Compensation) -> list[Issue]:
    """Return the issues of the path as commanded.

    :param command: commands of the samples, in `$BASE`.
    """
    program, robot, sample, cell = path.program, path.setting.robot, path.sample, path.setting.cell
    q, position, start = command.q, command.pose[:, :3, 3], cell.start_joints
    speed = joint_speeds.commanded_speed(path, q, position)
    arcs, lines = closely.stretches(path, q, speed)
    allowed = cell.output.max_correction_mm * M_PER_MM
    found = [
        *checks.start_joints(program, robot, start),
        *checks.first_move(program, path.joints, start),
        *checks.half_turns(program, sample, path.motions.segments.turn, command.pose),
        *checks.posture(program, robot, sample, path.joints, start),
        *checks.status_and_turn(program, robot, sample, path.joints.q),
        *checks.joint_limits(program, robot, sample, q),
        *checks.singularities(program, robot, sample, q, arcs.motion),
        *checks.joint_speeds(program, robot, sample, speed),
        *checks.meetings(program, sample, command.pose, path.wrench),
        *checks.correction_size(program, sample.motion, norm(position - sample.pose[:, :3, 3]), allowed),
    ]
    known = {issue.kind for issue in found}
    for stretches, apart in ((arcs, arcs.motion[:0]), (lines, lines.motion)):
        found += (issue for issue in closely.look(path, q, position, stretches, apart) if issue.kind not in known)
        known |= {issue.kind for issue in found}
    return found
