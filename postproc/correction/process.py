"""Processing stages of a program: path under load, commands, targets, text, read back, simulated, result."""

from __future__ import annotations

import gc
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from postproc import placement
from postproc.cell import Cell
from postproc.correction import checks, commanded, inspection, joint_speeds, select, targets
from postproc.correction.drafts import Draft, Task, result_of
from postproc.correction.read_back import LARGE_TEXT
from postproc.correction.result import Mode, Result
from postproc.dialects import registry
from postproc.elastostatics import Compensation
from postproc.errors import InputError, Issue, ProgramError, group_issues
from postproc.forces import ForceSource
from postproc.frames import Array
from postproc.program import CIRC, Document, Ints, Program, read_only
from postproc.robot import RobotModel
from postproc.toolpath import Pieces
from postproc.under_load import SHARE_OF_TOLERANCE, ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, RobotInCell

_ROUNDS = 8
"""Largest number of rounds that insert targets where the simulated program exceeds the tolerance."""
_MOST_PARTS = 4
"""Largest number of parts into which a piece of an arc is divided in one round."""


def read(documents: Sequence[Document], robot: RobotModel, cell: Cell, name: str, dialect: str) -> Program:
    """Read a program.

    :param documents: the main file first.
    :param dialect: name of its format, see `dialects.registry`.
    :raises InputError: the robot's controller does not read this language.
    :raises ProgramError: it cannot be interpreted; the message gives file, line, text and advice.
    """
    if registry.by_name(dialect).writer is not None:
        _check_language(documents[0].name, robot, dialect)
    program = registry.by_name(dialect).read(documents, cell, RobotInCell.of(robot, cell).forward, name)
    if len(program.motions) == 0:
        raise ProgramError("no motion in this program", file=documents[0].name, advice="Nothing can be corrected.")
    if sum(len(document.text) for document in documents) > LARGE_TEXT:
        gc.collect()  # readers leave reference cycles, which hold columns of the text
    return read_only(program)


def process(
    program: Program,
    robot: RobotModel,
    cell: Cell,
    source: ForceSource | None = None,
    mode: Mode = "convert",
    *,
    linearize_arcs: bool = False,
    to: str | None = None,
) -> Result:
    """Correct a program, or predict its uncorrected path.

    :param program: as read.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces in addition to the force comments of the program; they take precedence.
    :param mode: ``"convert"`` corrects, ``"nominal"`` writes the same moves without correction, ``"predict"`` writes
        nothing: it predicts the path of the uncorrected program at the targets that ``"convert"`` would write.
    :param linearize_arcs: write arcs as lines.
    :param to: dialect to write in; None = that of the program if it is written, else KRL.
    :returns: a result; with an issue of level error it holds no documents.
    :raises InputError: the program would be in a language that the robot's controller does not read.
    :raises ForceError: forces that cannot be given to the motions.
    """
    language, writer = registry.written_in(program.dialect, to)
    if mode != "predict":
        _check_language(program.documents[0].name, robot, language)
    task = Task(
        robot=robot,
        mode=mode,
        linearize_arcs=linearize_arcs,
        writer=writer,
        in_file=source is not None,
        initial_issues=(*inspection.of_origin(program, mode), *inspection.of_tools(program, cell)),
    )
    wrong = [issue for issue in task.initial_issues if issue.level == "error"]
    setting = RobotInCell.of(robot, cell)
    if not wrong and cell.gcode.redundancy != "constant" and not program.keeps_text:
        turn, told = placement.chosen(program, setting, source, cell.gcode.redundancy)
        task, wrong = (
            replace(task, turn=turn, initial_issues=(*task.initial_issues, *told)),
            [each for each in told if turn is None],
        )
        if turn is not None:
            program = placement.turned(program, cell.tool.axis, turn.of_motion)
    if not wrong:
        try:
            task, draft = _settled(task, MotionsUnderLoad.of(program, setting, source))
            return result_of(task, _as_read(task, draft) if mode == "predict" else draft)
        except ImpossiblePathError as cause:
            wrong = [cause.issue]
    return Result(program, robot, cell.tool.axis, mode, group_issues([*program.issues, *wrong]))


def _check_language(file: str, robot: RobotModel, language: str) -> None:
    if robot.language not in ("", language):
        raise InputError(
            f"a program in {language} for {robot.title}, whose controller reads {robot.language}",
            file=file,
            advice=f"Name another robot in the cell, or convert G-code with --to {robot.language}. The "
            "language of a robot is in its model.toml.",
        )


def _settled(task: Task, motions: MotionsUnderLoad) -> tuple[Task, Draft]:
    """Draft the program; insert targets each round where its simulation exceeds the tolerance.

    :returns: the task, with an issue if rapid moves were slowed, and the draft.
    """
    pieces, also = _first_pieces(task, motions), motions.swung
    slow: Issue | None = None
    for _ in range(_ROUNDS):
        draft = _drafted(task, PathUnderLoad.of(motions, pieces, also))
        if slow is None and any(issue.kind.startswith(checks.JOINT_SPEED) for issue in draft.issues):
            slowed = joint_speeds.slowed(draft.path, draft.q, draft.path.sample.pose[:, :3, 3])
            if slowed is not None:
                motions, slow = slowed
                task = replace(task, initial_issues=(*task.initial_issues, slow))
                draft = _drafted(task, PathUnderLoad.of(motions, pieces, also))
        if draft.simulated is None or task.mode == "nominal" or len(draft.simulated.missed[0]) == 0:
            break
        pieces, also = _closer(task, draft.path, draft.simulated.missed, also)
    return task, draft


def _first_pieces(task: Task, motions: MotionsUnderLoad) -> Pieces:
    """Return the division of the arcs; where it is uncertain, from the path error of larger pieces."""
    pieces = motions.pieces(linearize_arcs=task.linearize_arcs)
    if pieces.uncertain.any():
        path = PathUnderLoad.of(motions, pieces)
        pieces = select.pieces_needed(select.CommandedPath.of(path, _commands(task, path)))
    return pieces


def _closer(
    task: Task, path: PathUnderLoad, missed: tuple[Ints, Array, Array], also: tuple[Ints, Array]
) -> tuple[Pieces, tuple[Ints, Array]]:
    """Return finer pieces of arcs and more places on straight motions where the path left the tolerance."""
    motion, t, distance = missed
    on_arc = (path.program.motions.kind[motion] == CIRC) & (not task.linearize_arcs)
    parts = np.sqrt(distance[on_arc] / (SHARE_OF_TOLERANCE * path.setting.tolerance))
    parts = np.clip(np.ceil(parts), 2, _MOST_PARTS).astype(np.int64)
    pieces = path.arcs.finer(motion[on_arc], t[on_arc], parts)
    return pieces, (np.append(also[0], motion[~on_arc]), np.append(also[1], t[~on_arc]))


def _commands(task: Task, path: PathUnderLoad) -> Compensation:
    """Return the commands of all samples, in `$BASE`."""
    if task.mode == "nominal":
        return commanded.as_programmed(path)
    try:
        return commanded.corrected(path)
    except ImpossiblePathError:
        if task.mode == "convert":
            raise
        return commanded.as_programmed(path)  # what cannot be corrected can still be predicted


def _drafted(task: Task, path: PathUnderLoad) -> Draft:
    """Draft the program with targets at some of the samples; write it and read it back unless there is an error."""
    draft = _chosen(task, path)
    try:
        return draft if draft.failed else draft.written(task)
    except ProgramError:
        if task.mode == "predict":
            return draft
        raise


def _chosen(task: Task, path: PathUnderLoad) -> Draft:
    """Draft the program with targets at some of the samples."""
    command = _commands(task, path)
    chosen = targets.chosen(path, command, task.writer.least_arc, linearize_arcs=task.linearize_arcs)
    return Draft.of(task, path, command, chosen)


def _as_read(task: Task, draft: Draft) -> Draft:
    """Return the draft with the uncorrected commands: the correction only served to place the targets."""
    path, chosen = draft.path, draft.chosen
    chosen = replace(chosen, targets=replace(chosen.targets, pose=path.sample.pose[chosen.row]))
    return Draft.of(task, path, commanded.as_programmed(path), chosen)
