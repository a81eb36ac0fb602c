"""Two programs compared: targets paired, offsets, and where each would cut under the same force, also between targets.

Both are seen by the robot: a target is the pose that the flange is sent to, so that programs with different `$BASE` or
`$TOOL` may command the same. Offsets are those of the nominal program's tool, in its `$BASE`.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.comparison.differences import differences
from postproc.comparison.loaded_path import at_pairs, between, deviation
from postproc.comparison.pairing import partners
from postproc.comparison.partners import (
    deviation_left,
    in_order,
    judged,
    moved_alone,
    paired,
    partners_of,
    partners_under_force,
    with_inserted,
)
from postproc.comparison.paths import PlacedProgram
from postproc.comparison.result import Comparison
from postproc.forces import ForceSource
from postproc.frames import norm
from postproc.program import Bools, Ints, Program
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell


def compare(
    nominal: Program,
    corrected: Program,
    robot: RobotModel,
    cell: Cell,
    source: ForceSource | None = None,
    *,
    same_origin: bool = False,
    ends: Bools | None = None,
) -> Comparison:
    """Compare two programs for one part.

    :param nominal: the program as it should be cut.
    :param corrected: the program to compare with it.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces of the nominal program, in addition to its comments. Without either, the comments of the other
        program count.
    :param same_origin: both are as one conversion read or wrote them: they differ by the correction alone.
    :param ends: (n,) whether Cartesian targets of the second program end a motion of the first, or were inserted, as
        the conversion states it; None: pairs follow from their places.
    :raises ProgramError: a target is out of reach.
    :raises ForceError: forces that cannot be assigned to the motions, or without an equilibrium of the arm.
    """
    place = RobotInCell.of(robot, cell)
    one, other = PlacedProgram.of(nominal, place), PlacedProgram.of(corrected, place)
    stated = _stated_partners(one, other, ends)
    if source is None and not nominal.notes:
        load, wrench = None, np.zeros((len(one.rows), 6))
        partner = partners(one.track(), other.track()) if stated is None else stated
        certain = np.full(len(one.rows), same_origin)
    else:
        load = one.forces(source)
        wrench = one.wrench(load, one.rows)
        off = deviation(one, one.rows, one.joints[one.rows], wrench, one.carried(one.rows))
        if stated is None:
            # the second program is expected to command poses that the deflection takes back to the targets
            partner = partners_under_force(one, other, partners(one.track(-off), other.track()), wrench)
            certain = norm(deviation_left(one, other, partner, wrench)) <= place.tolerance
        else:
            partner, certain = stated, np.ones(len(stated), dtype=bool)
    # a target that only divides a line or an arc may have a partner that divides it elsewhere: the path passes it then
    divides = one.continued[one.rows] & (partner >= 0) & ~certain & (load is not None)
    found = judged(paired(one, other, np.where(divides, -1, partner), certain), one, other, load)
    moved = moved_alone(found, one, other)
    missing = np.isin(one.rows, found.only_nominal) & divides
    moved[missing] = partner[missing]
    if (moved >= 0).any():
        partner = in_order(np.maximum(partners_of(found, one, other), moved))
        found = judged(paired(one, other, partner, np.ones(len(partner), dtype=bool)), one, other, load)
    if load is not None:
        kept = np.searchsorted(one.rows, found.pair[:, 0])
        left = deviation_left(one, other, partners_of(found, one, other), wrench)
        cuts = at_pairs(found, one, other, wrench[kept], off[kept], left[kept])
        cuts = between(found, cuts, one, other, load)
        ends = cuts.row[(cuts.t == 1.0) & (cuts.between_corrected <= place.tolerance)]
        found = with_inserted(replace(found, cuts=cuts), np.isin(found.only_corrected, ends))
    else:
        if same_origin:
            rows, by = (found.passed, found.only_nominal), (found.passed_by, found.missed)
            found = replace(found, passed=np.concatenate(rows), passed_by=np.concatenate(by))
            found = replace(found, only_nominal=one.rows[:0], missed=found.missed[:0])
            found = with_inserted(found, np.ones(len(found.only_corrected), dtype=bool))
        if corrected.notes:
            first, two = found.pair.T
            wrench = other.wrench(other.forces(None), two)
            offs = (
                deviation(one, first, side.joints[rows], wrench, side.carried(rows))
                for side, rows in ((one, first), (other, two))
            )
            found = replace(found, cuts=at_pairs(found, one, other, wrench, *offs))
    known = load is not None or stated is not None
    options = {"in_file": source is not None, "same_origin": same_origin, "pairs_are_known": known}
    return replace(found, differences=differences(found, one, other, **options))


def _stated_partners(one: PlacedProgram, other: PlacedProgram, ends: Bools | None) -> Ints | None:
    """Return the index in `other.rows` of the partner of each of `one.rows` (n,), as the conversion states it.

    :returns: None where nothing is stated, or not for programs of so many targets.
    """
    if ends is None or len(ends) != len(other.rows) or int(np.count_nonzero(ends)) != len(one.rows):
        return None
    return np.flatnonzero(ends)
