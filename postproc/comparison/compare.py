"""Two programs compared: targets paired, offsets, and where each would cut under the same force, also between targets.

A pair is a target of the nominal program and its partner, the target of the second program that is to be the same place
on the part. Indices of partners count the Cartesian targets of the second program.

Both are seen by the robot: a target is the pose that the flange is sent to, so that programs with different `$BASE` or
`$TOOL` may command the same. Offsets are those of the nominal program's tool, in its `$BASE`.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import placement
from postproc.cell import Cell
from postproc.comparison.differences import differences
from postproc.comparison.loaded_path import cuts_between_pairs, deviation, pair_cuts
from postproc.comparison.pairing import partners
from postproc.comparison.partners import (
    count_as_inserted,
    deviations_by_partners,
    judge_unpaired,
    moved_partners,
    ordered_partners,
    pair_targets,
    partners_of,
    partners_under_force,
)
from postproc.comparison.paths import PlacedProgram
from postproc.comparison.result import Comparison
from postproc.forces import ForceSource
from postproc.forces.path_forces import PathForces
from postproc.frames import Array, norm
from postproc.program import Bools, Ints, Program
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell

_SAME_FEED = 1e-3
"""Feeds that differ by a smaller share are equal: they are written with few digits."""


def compare(
    nominal: Program,
    corrected_program: Program,
    robot: RobotModel,
    cell: Cell,
    source: ForceSource | None = None,
    *,
    same_origin: bool = False,
    ends: Bools | None = None,
) -> Comparison:
    """Compare two programs for one part.

    The tool of a nominal G-code program is turned about its axis as `convert` turns it in this cell.

    :param nominal: the program as it should be cut.
    :param corrected_program: the program to compare with it.
    :param robot: the robot model.
    :param cell: the cell.
    :param source: forces of the nominal program, in addition to its comments; None: its comments alone. If the nominal
        program has no forces at all, the comments of `corrected_program` count.
    :param same_origin: one conversion read the nominal program and wrote the second: only the correction differs.
    :param ends: (c,) True for Cartesian targets of the second program that end a motion of the first, False for
        inserted ones, as the conversion states it; None: pairs follow from positions and forces.
    :raises ProgramError: a target is out of reach.
    :raises ForceError: forces that cannot be assigned to the motions, or without an equilibrium of the arm.
    """
    robot_in_cell = RobotInCell.of(robot, cell)
    nominal = placement.in_chosen_turn(nominal, robot_in_cell, source).program
    nominal_path = PlacedProgram.of(nominal, robot_in_cell)
    robot_in_cell = robot_in_cell.in_touched_frames(nominal, nominal_path.segments)
    nominal_path = replace(nominal_path, robot_in_cell=robot_in_cell)
    corrected_path = PlacedProgram.of(corrected_program, robot_in_cell)
    stated_pairs = _stated_partners(nominal_path, corrected_path, ends)
    has_forces = source is not None or bool(nominal.notes)
    if has_forces:
        pairing = _pair_under_forces(nominal_path, corrected_path, source, stated_pairs)
    else:
        pairing = _pair_by_position(nominal_path, corrected_path, stated_pairs, is_certain=same_origin)
    nominal_path, loads = pairing.nominal_path, pairing.loads
    comparison = _all_pairs(nominal_path, corrected_path, pairing.partner, pairing.is_certain, loads)
    if loads is not None:
        comparison = _complete_cuts(comparison, nominal_path, corrected_path, loads)
    else:
        if same_origin:
            comparison = _explain_as_inserted(comparison, nominal_path)
        if corrected_program.notes:
            comparison = _add_cuts(comparison, nominal_path, corrected_path)
    other_differences = differences(
        comparison,
        nominal_path,
        corrected_path,
        has_force_file=source is not None,
        same_origin=same_origin,
        are_pairs_certain=loads is not None or stated_pairs is not None,
    )
    return replace(comparison, differences=other_differences)


def _with_partner_feeds(nominal_path: PlacedProgram, corrected_path: PlacedProgram, partner: Ints) -> Program | None:
    """Return the nominal program at the feeds of the second one; None if both programs have the same feeds.

    The forces of a process depend on the feed, and the second program is corrected for its own feeds.

    :param partner: (n,) index in `corrected_path.target_rows` of the partner of each nominal target; −1 for none.
    """
    motions, feed = nominal_path.program.motions, nominal_path.program.motions.feed.copy()
    rows, partner_rows = nominal_path.target_rows[partner >= 0], corrected_path.target_rows[partner[partner >= 0]]
    partner_feed = corrected_path.program.motions.feed[partner_rows]
    differs = ~motions.rapid[rows] & (np.abs(partner_feed - feed[rows]) > _SAME_FEED * feed[rows])
    if not differs.any():
        return None
    feed[rows[differs]] = partner_feed[differs]
    return replace(nominal_path.program, motions=replace(motions, feed=feed), feed_as_read=motions.feed)


class _Loads(Struct, frozen=True, eq=False):
    """Forces of the nominal program, and deflections at its n targets.

    :param path: forces along the program.
    :param wrench: (n, 6) at the targets, root axes [N, N·m].
    :param deflection: (n, 3) of the tool tip at the targets, in their `$BASE` [m].
    """

    path: PathForces
    wrench: Array
    deflection: Array

    @classmethod
    def of(cls, nominal_path: PlacedProgram, source: ForceSource | None) -> _Loads:
        """Return the loads of a program, from its comments and a source; None: from its comments alone.

        :raises ForceError: the arm has no equilibrium under a force.
        """
        path, rows = nominal_path.forces(source), nominal_path.target_rows
        wrench = nominal_path.wrench(path, rows)
        displacement = nominal_path.carriage_displacement(rows)
        return cls(path, wrench, deviation(nominal_path, rows, nominal_path.joints[rows], wrench, displacement))


class _Pairing(Struct, frozen=True, eq=False):
    """The partners of the n targets of the nominal program, and the loads by which they were found.

    :param nominal_path: the nominal program, at the feeds for which the loads are computed.
    :param partner: (n,) index of the partner in the targets of the second program; −1 for none.
    :param is_certain: (n,) True where the partner is right for certain.
    :param loads: forces of the nominal program; None if they are not known.
    """

    nominal_path: PlacedProgram
    partner: Ints
    is_certain: Bools
    loads: _Loads | None


def _pair_by_position(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, stated_pairs: Ints | None, *, is_certain: bool
) -> _Pairing:
    """Return the partners without forces.

    :param stated_pairs: (n,) partners that the conversion states; None: they follow from positions.
    :param is_certain: True if all partners are right for certain.
    """
    partner = partners(nominal_path.track(), corrected_path.track()) if stated_pairs is None else stated_pairs
    return _Pairing(nominal_path, partner, np.full(len(partner), is_certain), None)


def _pair_under_forces(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, source: ForceSource | None, stated_pairs: Ints | None
) -> _Pairing:
    """Return the partners under the forces of the nominal program.

    Forces of a process are computed at the feeds of the second program.

    :param source: forces in addition to the comments of the nominal program; None: its comments alone.
    :param stated_pairs: (n,) partners that the conversion states; None: they follow from positions and forces.
    :raises ForceError: the arm has no equilibrium under a force.
    """
    robot_in_cell = nominal_path.robot_in_cell
    loads = _Loads.of(nominal_path, source)
    partner, is_certain = _partners_under_load(nominal_path, corrected_path, loads, stated_pairs)
    depends_on_feed = loads.path.law_forces is not None  # forces are computed by a cutting law
    program_at_feeds = _with_partner_feeds(nominal_path, corrected_path, partner) if depends_on_feed else None
    if program_at_feeds is not None:
        nominal_path = PlacedProgram.of(program_at_feeds, robot_in_cell)
        loads = _Loads.of(nominal_path, source)
        partner, is_certain = _partners_under_load(nominal_path, corrected_path, loads, stated_pairs)
    return _Pairing(nominal_path, partner, is_certain, loads)


def _partners_under_load(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, loads: _Loads, stated_pairs: Ints | None
) -> tuple[Ints, Bools]:
    """Return the partner (n,) of each nominal target, −1 for none, and whether it is certain (n,).

    A partner is certain if the loaded tip by the second program is within the tolerance of the nominal target.

    :param stated_pairs: (n,) partners that the conversion states, all of them certain; None: they are searched.
    """
    if stated_pairs is not None:
        return stated_pairs, np.ones(len(stated_pairs), dtype=bool)
    # the second program is expected to command poses that the deflection takes back to the targets
    expected_track = nominal_path.track(-loads.deflection)
    predicted_partner = partners(expected_track, corrected_path.track())
    partner = partners_under_force(nominal_path, corrected_path, predicted_partner, loads.wrench)
    remaining_deviation = norm(deviations_by_partners(nominal_path, corrected_path, partner, loads.wrench))
    return partner, remaining_deviation <= nominal_path.robot_in_cell.tolerance


def _all_pairs(
    nominal_path: PlacedProgram, corrected_path: PlacedProgram, partner: Ints, is_certain: Bools, loads: _Loads | None
) -> Comparison:
    """Return the comparison of nominal targets with their partners.

    A second round pairs missing targets with additional ones to which the second program has moved them.

    :param partner: (n,) index of the partner in `corrected_path.target_rows`; −1 for none.
    :param is_certain: (n,) True where the partner is right for certain.
    :param loads: forces of the nominal program; None if they are not known.
    """
    path_forces = None if loads is None else loads.path
    has_doubtful_partner = (partner >= 0) & ~is_certain & (loads is not None)
    # a target that only divides a line or an arc may have a partner that divides it elsewhere: the path passes it then,
    # so it first has no partner, and gets it back if it then counts as missing
    is_division_point = nominal_path.is_continued[nominal_path.target_rows] & has_doubtful_partner
    pairs = pair_targets(nominal_path, corrected_path, np.where(is_division_point, -1, partner), is_certain)
    comparison = judge_unpaired(pairs, nominal_path, corrected_path, path_forces)
    displaced_partner = moved_partners(comparison, nominal_path, corrected_path)
    is_missing = np.isin(nominal_path.target_rows, comparison.only_nominal) & is_division_point
    displaced_partner[is_missing] = partner[is_missing]
    if not (displaced_partner >= 0).any():
        return comparison
    partner = ordered_partners(np.maximum(partners_of(comparison, nominal_path, corrected_path), displaced_partner))
    pairs = pair_targets(nominal_path, corrected_path, partner, np.ones(len(partner), dtype=bool))
    return judge_unpaired(pairs, nominal_path, corrected_path, path_forces)


def _complete_cuts(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram, loads: _Loads
) -> Comparison:
    """Return a comparison with the deviations of both programs under the nominal forces, also between targets.

    An additional target whose loaded tip is within the tolerance of the nominal path becomes an inserted one.
    """
    partner = partners_of(comparison, nominal_path, corrected_path)
    corrected_deviation = deviations_by_partners(nominal_path, corrected_path, partner, loads.wrench)
    target_of_pair = np.searchsorted(
        nominal_path.target_rows, comparison.pair[:, 0]
    )  # rows of `loads`: one for each target
    cuts = pair_cuts(
        comparison,
        nominal_path,
        loads.wrench[target_of_pair],
        nominal_deviation=loads.deflection[target_of_pair],
        corrected_deviation=corrected_deviation[target_of_pair],
    )
    cuts = cuts_between_pairs(comparison, cuts, nominal_path, corrected_path, loads.path)
    tolerance = nominal_path.robot_in_cell.tolerance
    rows_on_path = cuts.row[(cuts.t == 1.0) & (cuts.corrected_distance <= tolerance)]  # t = 1: targets
    return count_as_inserted(replace(comparison, cuts=cuts), np.isin(comparison.additional_rows, rows_on_path))


def _explain_as_inserted(comparison: Comparison, nominal_path: PlacedProgram) -> Comparison:
    """Return a comparison of two programs of one conversion, in which no target is missing or additional.

    Nominal targets without a partner count as passed, those of the second program as inserted.
    """
    comparison = replace(
        comparison,
        passed_rows=np.concatenate([comparison.passed_rows, comparison.only_nominal]),
        passing_distance=np.concatenate([comparison.passing_distance, comparison.missing_distance]),
        only_nominal=nominal_path.target_rows[:0],
        missing_distance=comparison.missing_distance[:0],
    )
    return count_as_inserted(comparison, np.ones(len(comparison.additional_rows), dtype=bool))


def _add_cuts(comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram) -> Comparison:
    """Return a comparison with the deviations at the pairs, under the forces in comments of the second program."""
    nominal_rows, corrected_rows = comparison.pair.T
    comment_forces = corrected_path.forces(None)
    wrench = corrected_path.wrench(comment_forces, corrected_rows)
    # both are deviations from the nominal targets, of the joint angles that each program commands
    nominal_deviation, corrected_deviation = (
        deviation(nominal_path, nominal_rows, path.joints[rows], wrench, path.carriage_displacement(rows))
        for path, rows in ((nominal_path, nominal_rows), (corrected_path, corrected_rows))
    )
    cuts = pair_cuts(
        comparison,
        nominal_path,
        wrench,
        nominal_deviation=nominal_deviation,
        corrected_deviation=corrected_deviation,
    )
    return replace(comparison, cuts=cuts)


def _stated_partners(nominal_path: PlacedProgram, corrected_path: PlacedProgram, ends: Bools | None) -> Ints | None:
    """Return the partners (n,) of nominal targets that the conversion states: indices in `corrected_path.target_rows`.

    :param ends: (c,) True for each of `corrected_path.target_rows` that ends a nominal motion, False for inserted ones.
    :returns: None if `ends` is None, or if the numbers of targets do not fit those of the programs.
    """
    if (
        ends is None
        or len(ends) != len(corrected_path.target_rows)
        or int(np.count_nonzero(ends)) != len(nominal_path.target_rows)
    ):
        return None
    return np.flatnonzero(ends)
