"""All checks of a path as it is commanded, and what a program says of where it comes from."""

from __future__ import annotations

from postproc.compensation import Compensation
from postproc.correction import checks, closely
from postproc.correction.result import Mode
from postproc.dialects import registry
from postproc.errors import Issue
from postproc.frames import M_PER_MM, norm
from postproc.program import Program
from postproc.under_load import PathUnderLoad


def of_origin(program: Program, mode: Mode) -> list[Issue]:
    """Return what there is to say about a program that postproc wrote: it is not corrected a second time."""
    writer = registry.by_name(program.dialect).writer
    if writer is None:
        return []
    origin = writer.origin(program.documents)
    if origin.part_of:
        message = (
            f"this file is a part of {origin.part_of}, which calls it: where the robot stands before it, with which "
            f"frames and speed, is said there. Name {origin.part_of} instead."
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


def of_path(path: PathUnderLoad, command: Compensation) -> list[Issue]:
    """Return the issues of the path as commanded.

    :param command: commands of the samples, in `$BASE`.
    """
    program, robot, sample, cell = path.program, path.setting.robot, path.sample, path.setting.cell
    q, position, start = command.q, command.pose[:, :3, 3], cell.start_joints
    speed = checks.joint_speed(program, sample, path.motions.segments.turn, q, position)
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
    told = {issue.kind for issue in found}
    for stretches, apart in ((arcs, arcs.motion[:0]), (lines, lines.motion)):
        found += (issue for issue in closely.look(path, q, position, stretches, apart) if issue.kind not in told)
        told |= {issue.kind for issue in found}
    return found
