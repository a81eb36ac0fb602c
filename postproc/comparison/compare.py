"""Two programs compared: targets paired, offsets, and what each would cut under the same force.

Both are seen by the robot: a target is where the flange is sent, so that programs with different `$BASE` or `$TOOL` may
command the same. Offsets are those of the nominal program's tool, in its `$BASE`.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import toolpath
from postproc.cell import Cell
from postproc.comparison import cuts
from postproc.comparison.curves import Curves
from postproc.comparison.differences import BESIDE, OFF_PATH, differences
from postproc.comparison.pairing import partners
from postproc.comparison.result import Comparison
from postproc.comparison.side import Side
from postproc.forces import ForceSource
from postproc.frames import Array, norm, twist_between
from postproc.program import PTP, Bools, Ints, Program
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell

_MOST_MOVED = 200
"""Targets beside the path that are asked whether they were moved: where there are more, another program is meant."""


def compare(
    nominal: Program, corrected: Program, robot: RobotModel, cell: Cell, source: ForceSource | None = None
) -> Comparison:
    """Compare two programs for one part.

    :param nominal: the program as it should be cut.
    :param corrected: the one to be compared with it.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces of the nominal program beside its comments. Without either, the comments of the other program
        hold.
    :raises ProgramError: a target is out of reach.
    :raises ForceError: forces that cannot be given to the motions, or that the arm does not hold.
    """
    place = RobotInCell.of(robot, cell)
    one, other = Side.of(nominal, place), Side.of(corrected, place)
    if source is None and not nominal.notes:
        found = _paired(one, other, partners(one.track(), other.track()))
        if corrected.notes:
            first, two = found.pair.T
            wrench = other.wrench(other.forces(None), two)
            off = cuts.deviation(one, first, one.joints[first], wrench, one.stands(first))
            found = replace(found, cuts=cuts.at_pairs(found, one, other, wrench, off))
    else:
        load = one.forces(source)
        wrench = one.wrench(load, one.rows)
        off = cuts.deviation(one, one.rows, one.joints[one.rows], wrench, one.stands(one.rows))
        # the second program is expected to aim as far past its targets as the tool gives way
        found = _paired(one, other, partners(one.track(-off), other.track()))
        kept = np.searchsorted(one.rows, found.pair[:, 0])
        told = cuts.at_pairs(found, one, other, wrench[kept], off[kept])
        found = replace(found, cuts=cuts.between(found, told, one, other, load))
    return replace(found, differences=differences(found, one, other, in_file=source is not None))


def _paired(one: Side, other: Side, partner: Ints) -> Comparison:
    nominal, corrected, has = one.program, other.program, partner >= 0
    pair = np.stack([one.rows[has], other.rows[partner[has]]], axis=1)
    pose, off = _offsets(one, other, pair)
    rest = np.setdiff1d(other.rows, pair[:, 1])
    on_path = _on_path(one, other, pair, norm(off[:, :3]), rest)
    if (~on_path).any():
        pair = _moved(one, other, pair, off[:, :3], rest[~on_path])
        pose, off = _offsets(one, other, pair)
        rest = np.setdiff1d(other.rows, pair[:, 1])
        on_path = _on_path(one, other, pair, norm(off[:, :3]), rest)
    curves = Curves.of((nominal, one.path), (corrected, other.path), pair)
    return Comparison(
        nominal=nominal,
        corrected=corrected,
        robot=one.place.robot.name,
        pair=pair,
        inserted=rest[on_path],
        only_nominal=one.rows[~has],
        only_corrected=rest[~on_path],
        pose=pose,
        rotation=norm(off[:, 3:]),
        curves=curves,
        between=np.full(len(pair), np.nan) if curves is None else curves.apart(),
        cuts=None,
        differences=(),
    )


def _offsets(one: Side, other: Side, pair: Ints) -> tuple[Array, Array]:
    """Return where the second program sends the nominal tool (P, 4, 4), nominal `$BASE`, and the twists (P, 6)."""
    flange = toolpath.flange_from_tcp(other.program, pair[:, 1], other.program.motions.target[pair[:, 1]], None)
    pose = toolpath.pose_in_base(one.program, pair[:, 0], flange @ toolpath.tool_of(one.program, pair[:, 0]), None)
    return pose, twist_between(one.program.motions.target[pair[:, 0]], pose)


def _moved(one: Side, other: Side, pair: Ints, offset: Array, rows: Ints) -> Ints:
    """Return pairs (P, 2) with targets that were moved in the place of their neighbours.

    A target beside the path (`rows`) next to one that has a partner was moved, and not added, if that other one stands
    on the path as inserted ones do, and its offset is like that of neither neighbouring pair.
    """
    pair, distance = pair.copy(), norm(offset)
    change = np.pad(norm(np.diff(offset, axis=0)), 1, constant_values=np.inf)
    odd = np.minimum(change[:-1], change[1:]) > OFF_PATH
    index = {int(row): place for place, row in enumerate(other.rows.tolist())}
    for row in rows[:_MOST_MOVED].tolist():
        behind = int(np.searchsorted(pair[:, 1], row))
        for k in (behind, behind - 1):
            if not 0 <= k < len(pair) or not odd[k] or abs(index[int(pair[k, 1])] - index[row]) != 1:
                continue
            released, tried, known = pair[k, 1:], pair.copy(), distance.copy()
            tried[k, 1], known[k] = row, 0.0
            if _on_path(one, other, tried, known, released.copy())[0]:
                pair = tried
                break
    return pair


def _on_path(one: Side, other: Side, pair: Ints, distance: Array, rows: Ints) -> Bools:
    """Return which of the second program's targets without partner, `rows` (r,), stand on the nominal path.

    That is: before the first pair, or between two that follow one another in the nominal program too, hardly farther
    from the nominal path than the offsets (P,) there.
    """
    out, most = np.full(len(rows), np.inf), np.zeros(len(rows))
    nominal, kind = one.program, other.program.motions.kind
    behind = np.searchsorted(pair[:, 1], rows)
    between = np.flatnonzero((behind < len(pair)) & (kind[rows] != PTP))
    behind = behind[between]
    before = np.append(-1, pair[:, 0])[behind]
    along = np.append(0.0, np.cumsum(other.path.length))
    here, last = along[rows[between] + 1], along[pair[behind, 1] + 1]
    first = along[np.append(-1, pair[:, 1])[behind] + 1]
    motion = pair[behind, 0]
    length = np.maximum(one.path.length[motion], 1e-12)
    target = toolpath.at(other.program, other.path, rows[between], np.ones(len(between))).pose
    flange = toolpath.flange_from_tcp(other.program, rows[between], target, None)
    spot = toolpath.pose_in_base(nominal, motion, flange @ toolpath.tool_of(nominal, motion), None)[:, :3, 3]
    aside = np.full(len(spot), np.inf)
    in_proportion = (here - first) / np.maximum(last - first, 1e-12)
    # a detour, where the other program has one, is on one side of it only
    for share in (in_proportion, (here - first) / length, 1.0 - (last - here) / length):
        nearest = toolpath.positions(nominal, one.path, motion, np.clip(share, 1e-9, 1.0))
        aside = np.minimum(aside, norm(spot - nearest))
    allowed = OFF_PATH + BESIDE * np.maximum(np.append(0.0, distance)[behind], distance[behind])
    follows = one.follows(before, motion) & (nominal.motions.kind[motion] != PTP)
    out[between], most[between] = np.where(follows, aside, np.inf), allowed
    return np.asarray(out <= most)
