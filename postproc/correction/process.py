"""The life of a program, stage by stage: path under load, commands, targets, text, read back, simulated, result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.compensation import Compensation
from postproc.correction import commanded, inspection, select, targets
from postproc.correction.drafts import Draft, Task, result_of
from postproc.correction.result import Mode, Result
from postproc.dialects import registry
from postproc.errors import InputError, ProgramError, group_issues
from postproc.forces import ForceSource
from postproc.frames import Array
from postproc.program import CIRC, Document, Ints, Program, read_only
from postproc.robot import RobotModel
from postproc.toolpath import Pieces
from postproc.under_load import SHARE_OF_TOLERANCE, ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, RobotInCell

_ROUNDS = 8
"""How often targets are inserted where the simulation of the written program leaves the tolerance."""
_MOST_PARTS = 4
"""Into so many parts at most a piece of an arc is divided at once there."""


def read(documents: Sequence[Document], robot: RobotModel, cell: Cell, name: str, dialect: str) -> Program:
    """Read a program.

    :param documents: the main file first.
    :param dialect: name of its format, see `dialects.registry`.
    :raises InputError: it is in a language that the robot's controller does not read.
    :raises ProgramError: it is not understood; the message names file, line, text and what to do.
    """
    if registry.by_name(dialect).writer is not None:
        _check_language(documents[0].name, robot, dialect)
    program = registry.by_name(dialect).read(documents, cell, RobotInCell.of(robot, cell).forward, name)
    if len(program.motions) == 0:
        raise ProgramError("no motion in this program", file=documents[0].name, advice="Nothing can be corrected.")
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
    """Correct a program, or predict what it does as it stands.

    :param program: as read.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces beside the comments of the program; they win.
    :param mode: ``"convert"`` corrects, ``"nominal"`` writes the same moves without correction, ``"predict"`` writes
        nothing: it tells what the program does as it stands, at the places where ``"convert"`` would have its targets.
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
        told=tuple(inspection.of_origin(program, mode)),
    )
    wrong = [issue for issue in task.told if issue.level == "error"]
    if not wrong:
        try:
            draft = _settled(task, MotionsUnderLoad.of(program, RobotInCell.of(robot, cell), source))
            return result_of(task, _as_read(task, draft) if mode == "predict" else draft)
        except ImpossiblePathError as cause:
            wrong = [cause.issue]
    return Result(program, robot, cell.tool.axis, mode, group_issues([*program.issues, *wrong]))


def _check_language(file: str, robot: RobotModel, language: str) -> None:
    if robot.language not in ("", language):
        raise InputError(
            f"a program in {language} for {robot.title}, whose controller reads {robot.language}",
            file=file,
            advice=f"Name another robot in the cell, or convert G-code with --to {robot.language}. What a robot reads "
            "stands in its model.toml, language.",
        )


def _settled(task: Task, motions: MotionsUnderLoad) -> Draft:
    """Draft the program, with more targets each time where its simulation leaves the tolerance."""
    pieces, also = _first_pieces(task, motions), motions.swung
    for _ in range(_ROUNDS):
        draft = _drafted(task, PathUnderLoad.of(motions, pieces, also))
        if draft.simulated is None or task.mode == "nominal" or len(draft.simulated.missed[0]) == 0:
            break
        pieces, also = _closer(task, draft.path, draft.simulated.missed, also)
    return draft


def _first_pieces(task: Task, motions: MotionsUnderLoad) -> Pieces:
    """Return into how many pieces to divide the arcs; where that is uncertain, by what larger ones miss."""
    pieces = motions.pieces(linearize_arcs=task.linearize_arcs)
    if pieces.uncertain.any():
        path = PathUnderLoad.of(motions, pieces)
        pieces = select.pieces_needed(select.CommandedPath.of(path, _commands(task, path)))
    return pieces


def _closer(
    task: Task, path: PathUnderLoad, missed: tuple[Ints, Array, Array], also: tuple[Ints, Array]
) -> tuple[Pieces, tuple[Ints, Array]]:
    """Return pieces of arcs, and places of straight motions, that look closer where the path was missed."""
    motion, t, distance = missed
    on_arc = (path.program.motions.kind[motion] == CIRC) & (not task.linearize_arcs)
    parts = np.sqrt(distance[on_arc] / (SHARE_OF_TOLERANCE * path.setting.tolerance))
    parts = np.clip(np.ceil(parts), 2, _MOST_PARTS).astype(np.int64)
    pieces = path.arcs.finer(motion[on_arc], t[on_arc], parts)
    return pieces, (np.append(also[0], motion[~on_arc]), np.append(also[1], t[~on_arc]))


def _commands(task: Task, path: PathUnderLoad) -> Compensation:
    """Return what the controller is told at each sample, in `$BASE`."""
    if task.mode == "nominal":
        return commanded.as_it_stands(path)
    try:
        return commanded.corrected(path)
    except ImpossiblePathError:
        if task.mode == "convert":
            raise
        return commanded.as_it_stands(path)  # what cannot be corrected can still be predicted


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
    """Return the draft as the program read: it was corrected only to find the places."""
    path, chosen = draft.path, draft.chosen
    chosen = replace(chosen, targets=replace(chosen.targets, pose=path.sample.pose[chosen.row]))
    return Draft.of(task, path, commanded.as_it_stands(path), chosen)
