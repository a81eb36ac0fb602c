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
    nominal_path, corrected_path = PlacedProgram.of(nominal, place), PlacedProgram.of(corrected, place)
    stated_pairs = _stated_partners(nominal_path, corrected_path, ends)
    if source is None and not nominal.notes:
        load, wrench = None, np.zeros((len(nominal_path.rows), 6))
        partner = partners(nominal_path.track(), corrected_path.track()) if stated_pairs is None else stated_pairs
        certain = np.full(len(nominal_path.rows), same_origin)
    else:
        load = nominal_path.forces(source)
        wrench = nominal_path.wrench(load, nominal_path.rows)
        deviations = deviation(
            nominal_path,
            nominal_path.rows,
            nominal_path.joints[nominal_path.rows],
            wrench,
            nominal_path.carried(nominal_path.rows),
        )
        if stated_pairs is None:
            # the second program is expected to command poses that the deflection takes back to the targets
            partner = partners_under_force(
                nominal_path, corrected_path, partners(nominal_path.track(-deviations), corrected_path.track()), wrench
            )
            certain = norm(deviation_left(nominal_path, corrected_path, partner, wrench)) <= place.tolerance
        else:
            partner, certain = stated_pairs, np.ones(len(stated_pairs), dtype=bool)
    # a target that only divides a line or an arc may have a partner that divides it elsewhere: the path passes it then
    divides = nominal_path.continued[nominal_path.rows] & (partner >= 0) & ~certain & (load is not None)
    comparison = judged(
        paired(nominal_path, corrected_path, np.where(divides, -1, partner), certain),
        nominal_path,
        corrected_path,
        load,
    )
    displaced_partner = moved_alone(comparison, nominal_path, corrected_path)
    is_missing = np.isin(nominal_path.rows, comparison.only_nominal) & divides
    displaced_partner[is_missing] = partner[is_missing]
    if (displaced_partner >= 0).any():
        partner = in_order(np.maximum(partners_of(comparison, nominal_path, corrected_path), displaced_partner))
        comparison = judged(
            paired(nominal_path, corrected_path, partner, np.ones(len(partner), dtype=bool)),
            nominal_path,
            corrected_path,
            load,
        )
    if load is not None:
        index = np.searchsorted(nominal_path.rows, comparison.pair[:, 0])
        left = deviation_left(
            nominal_path, corrected_path, partners_of(comparison, nominal_path, corrected_path), wrench
        )
        cuts = at_pairs(comparison, nominal_path, corrected_path, wrench[index], deviations[index], left[index])
        cuts = between(comparison, cuts, nominal_path, corrected_path, load)
        ends = cuts.row[(cuts.t == 1.0) & (cuts.between_corrected <= place.tolerance)]
        comparison = with_inserted(replace(comparison, cuts=cuts), np.isin(comparison.only_corrected, ends))
    else:
        if same_origin:
            rows, by = (comparison.passed, comparison.only_nominal), (comparison.passed_by, comparison.missed)
            comparison = replace(comparison, passed=np.concatenate(rows), passed_by=np.concatenate(by))
            comparison = replace(comparison, only_nominal=nominal_path.rows[:0], missed=comparison.missed[:0])
            comparison = with_inserted(comparison, np.ones(len(comparison.only_corrected), dtype=bool))
        if corrected.notes:
            first, two = comparison.pair.T
            wrench = corrected_path.wrench(corrected_path.forces(None), two)
            offs = (
                deviation(nominal_path, first, side.joints[rows], wrench, side.carried(rows))
                for side, rows in ((nominal_path, first), (corrected_path, two))
            )
            comparison = replace(comparison, cuts=at_pairs(comparison, nominal_path, corrected_path, wrench, *offs))
    pairs_known = load is not None or stated_pairs is not None
    options = {"in_file": source is not None, "same_origin": same_origin, "pairs_certain": pairs_known}
    return replace(comparison, differences=differences(comparison, nominal_path, corrected_path, **options))


def _stated_partners(nominal_path: PlacedProgram, corrected_path: PlacedProgram, ends: Bools | None) -> Ints | None:
    """Return the index in `corrected_path.rows` of the partner of each of `nominal_path.rows` (n,), as converted.

    :returns: None where nothing is stated, or not for programs of so many targets.
    """
    if ends is None or len(ends) != len(corrected_path.rows) or int(np.count_nonzero(ends)) != len(nominal_path.rows):
        return None
    return np.flatnonzero(ends)
