"""From commanded samples to the targets that are to be written."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics, toolpath
from postproc.correction import blending, select
from postproc.correction.select import CommandedPath
from postproc.elastostatics import Compensation
from postproc.frames import Array, largest, twist_between
from postproc.program import CIRC, LIN, PTP, Bools, Ints, Program, Targets
from postproc.robot import RobotModel
from postproc.under_load import PathUnderLoad

_UNCHANGED = 1e-7
"""A correction below this [m, rad] is none: the text of a target is left to the byte where the program keeps it."""


class Chosen(Struct, frozen=True, eq=False):
    """The K targets chosen of the N samples of a path.

    :param targets: targets to be written.
    :param row: (K,) sample of each target.
    :param arrive: (K, 3) direction of travel at the end of the piece to each, `$BASE`.
    :param programmed: (K,) how far the program as read rounds its path there [m], see `Result`.
    """

    targets: Targets
    row: Ints
    arrive: Array
    programmed: Array


def chosen(
    path: PathUnderLoad, command: Compensation, least_arc: tuple[float, float], *, linearize_arcs: bool
) -> Chosen:
    """Choose what to write: as few of the samples as hold the tolerance.

    :param command: commands of the samples, in `$BASE`.
    :param least_arc: see `dialects.dialect.Writer`.
    :param linearize_arcs: arcs are written as lines.
    """
    program, sample, m = path.program, path.sample, path.program.motions
    whole, kept = _unchanged(path, command)
    commanded = CommandedPath.of(path, command)
    kind = np.where(m.kind == CIRC, LIN, m.kind) if linearize_arcs else m.kind
    every = toolpath.swivel_pieces(program, path.motions.segments, path.setting.tolerance) > 1
    selected = select.choose(commanded, kind, whole, every, least_arc)
    movable = np.isnan(m.joints[sample.motion[selected[0]], 0])
    row, target_kind, via_row = (each[movable] for each in selected)
    motion = sample.motion[row]
    via, arcs = np.broadcast_to(np.nan, (len(row), 3)), via_row >= 0
    if arcs.any():
        via = via.copy()
        via[arcs] = commanded.position[via_row[arcs]]
    status, turn = _status_and_turn(program, path.setting.robot, motion, command.q.take(row, axis=0))
    keep = kept[motion] & (sample.t[row] == 1.0)
    targets = Targets(
        motion, sample.t[row], target_kind, command.pose.take(row, axis=0), via, keep, status, turn, m.blend[motion]
    )
    corners, arrive = blending.of_targets(program, targets, commanded.start)
    blend = blending.distances(program, targets, corners, path.setting.cell)
    programmed = blending.programmed(program, path.motions.segments, motion)
    return Chosen(replace(targets, blend=blend), row, arrive, programmed)


def _unchanged(path: PathUnderLoad, command: Compensation) -> tuple[Bools, Bools]:
    """Return which motions are one target whatever lies between (M,), and which end as their text says (M,).

    In a program that keeps its text that is those that need no correction. Where a motion starts matters to straight
    lines, which may then have to be divided, and to circles, which are other circles then; a PTP ends where it ends.
    """
    m, sample = path.program.motions, path.sample
    if not path.program.keeps_text:
        return np.zeros(len(m), dtype=bool), np.zeros(len(m), dtype=bool)
    moved = largest(twist_between(sample.pose, command.pose)) > _UNCHANGED
    first = np.flatnonzero(np.diff(sample.motion, prepend=-1))
    end_moved = moved[sample.ends]
    any_moved = np.maximum.reduceat(moved, first) | np.concatenate([[False], end_moved[:-1]])
    arcs = m.kind == CIRC
    # a circle is what it was if it starts where it did to the last digit, and so does each circle before it
    rows, changed = np.arange(len(m)), np.where(arcs, any_moved, end_moved)
    last_changed = np.maximum.accumulate(np.where(changed, rows, -2))
    last_other = np.maximum.accumulate(np.where(arcs, -1, rows))
    kept = np.where(arcs, last_changed < last_other, ~end_moved)
    return np.where(m.kind == LIN, ~any_moved, kept), kept


def _status_and_turn(program: Program, robot: RobotModel, motion: Ints, q: Array) -> tuple[Ints, Ints]:
    """Return S and T of targets (K,): of PTP, where the program gives them if it keeps its text; else −1."""
    m = program.motions
    status, turn = np.full(len(motion), -1), np.full(len(motion), -1)
    ptp = np.flatnonzero(m.kind[motion] == PTP)
    status[ptp], turn[ptp] = kinematics.status_of(robot, q[ptp]), kinematics.turn_of(q[ptp])
    if program.keeps_text:
        for new, given, bits in ((status, m.status[motion], 7), (turn, m.turn[motion], 63)):
            new[:] = np.where(given >= 0, given & ~bits | new, -1)
    return status, turn
