"""From commanded samples to the targets that are to be written."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics, toolpath
from postproc.compensation import Compensation
from postproc.correction import blending, select
from postproc.frames import Array, largest, twist_between
from postproc.program import CIRC, LIN, PTP, Bools, Ints, Program, Targets
from postproc.robot import RobotModel
from postproc.toolpath import Pieces
from postproc.under_load import SHARE_OF_TOLERANCE, PathUnderLoad

_UNCHANGED = 1e-7
"""A correction below this [m, rad] is none: the text of a target is left to the byte where the program keeps it."""


class Chosen(Struct, frozen=True, eq=False):
    """The K targets chosen of the N samples of a path.

    :param targets: what is to be written.
    :param row: (K,) which sample each is.
    :param arrive: (K, 3) direction of travel at the end of the piece to each, `$BASE`.
    """

    targets: Targets
    row: Ints
    arrive: Array


def pieces_needed(path: PathUnderLoad, command: Compensation) -> Pieces:
    """Return how many pieces of arcs are needed, by what larger ones miss."""
    limit = SHARE_OF_TOLERANCE * path.setting.tolerance
    return select.pieces_needed(_commanded(path, command), limit)


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
    commanded = _commanded(path, command)
    kind = np.where(m.kind == CIRC, LIN, m.kind) if linearize_arcs else m.kind
    limit = SHARE_OF_TOLERANCE * path.setting.tolerance
    every = toolpath.swivel_pieces(program, path.motions.segments, path.setting.tolerance) > 1
    selected = select.choose(commanded, kind, whole, every, limit, least_arc)
    movable = np.isnan(m.joints[sample.motion[selected.row], 0])
    row, target_kind, via_row = selected.row[movable], selected.kind[movable], selected.via[movable]
    motion = sample.motion[row]
    via, arcs = np.broadcast_to(np.nan, (len(row), 3)), via_row >= 0
    if arcs.any():
        via = via.copy()
        via[arcs] = commanded.position[via_row[arcs]]
    status, turn = _status_and_turn(program, path.setting.robot, motion, command.q[row])
    keep = kept[motion] & (sample.t[row] == 1.0)
    targets = Targets(motion, sample.t[row], target_kind, command.pose[row], via, keep, status, turn, m.blend[motion])
    corners, arrive = blending.of_targets(program, targets, commanded.start)
    blend = blending.distances(program, targets, corners, path.setting.cell)
    return Chosen(replace(targets, blend=blend), row, arrive)


def _unchanged(path: PathUnderLoad, command: Compensation) -> tuple[Bools, Bools]:
    """Return which motions are one target whatever lies between (M,), and which end as their text says (M,).

    In a program that keeps its text that is those that need no correction. Where a motion starts matters to straight
    lines, which may then have to be divided, and to circles, which are other circles then; a PTP ends where it ends.
    """
    m, sample = path.program.motions, path.sample
    if not path.program.keeps_text:
        return np.zeros(len(m), dtype=bool), np.zeros(len(m), dtype=bool)
    moved = largest(twist_between(sample.pose, command.pose)) > _UNCHANGED
    first = np.flatnonzero(np.concatenate([[True], np.diff(sample.motion) != 0]))
    end_moved = moved[sample.ends]
    any_moved = np.maximum.reduceat(moved, first) | np.concatenate([[False], end_moved[:-1]])
    arcs = m.kind == CIRC
    # a circle is what it was if it starts where it did to the last digit, and so does each circle before it
    rows, changed = np.arange(len(m)), np.where(arcs, any_moved, end_moved)
    last_changed = np.maximum.accumulate(np.where(changed, rows, -2))
    last_other = np.maximum.accumulate(np.where(arcs, -1, rows))
    kept = np.where(arcs, last_changed < last_other, ~end_moved)
    return np.where(m.kind == LIN, ~any_moved, kept), kept


def _commanded(path: PathUnderLoad, command: Compensation) -> select.CommandedPath:
    return select.CommandedPath(path.sample, path.arcs, command.pose[:, :3, 3], _starts(path, command))


def _starts(path: PathUnderLoad, command: Compensation) -> Array:
    """Return the commanded positions (M, 3) where the motions start, in their `$BASE` [m]."""
    ends = np.flatnonzero(path.sample.ends)
    starts = toolpath.starts(path.program, lambda motion: command.pose[ends[motion]], path.setting.start_flange)
    start = np.roll(command.pose[ends, :3, 3], 1, axis=0)
    start[starts.changed] = starts.pose[:, :3, 3]
    return start


def _status_and_turn(program: Program, robot: RobotModel, motion: Ints, q: Array) -> tuple[Ints, Ints]:
    """Return S and T of PTP targets (K,): of a program that keeps its text where it gives them, else always.

    :param motion: (K,) of the targets, and `q` (K, 6) their joint angles [rad].
    """
    m = program.motions
    status, turn = np.full(len(motion), -1), np.full(len(motion), -1)
    ptp = np.flatnonzero(m.kind[motion] == PTP)
    if len(ptp):
        new_status, new_turn = kinematics.status_of(robot, q[ptp]), kinematics.turn_of(q[ptp])
        if not program.keeps_text:
            status[ptp], turn[ptp] = new_status, new_turn
        else:
            given, given_turn = m.status[motion[ptp]], m.turn[motion[ptp]]
            status[ptp] = np.where(given >= 0, given & ~7 | new_status, -1)
            turn[ptp] = np.where(given_turn >= 0, given_turn & ~63 | new_turn, -1)
    return status, turn
