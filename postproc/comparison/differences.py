"""Other differences between two programs than the offsets of their targets.

Those of paths and of statements between motions are here, those of settings in `comparison.settings`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import islice, takewhile, zip_longest

import numpy as np

from postproc import toolpath
from postproc.comparison.paths import (
    SMALLEST_SHARE,
    PlacedProgram,
    commanded_positions,
    distances_from_path,
    nearest_lengths,
    tool_of_nominal,
)
from postproc.comparison.result import (
    OFF_PATH,
    TIMES_OFFSET,
    Comparison,
    Difference,
    difference_at,
    file_and_line,
    first_difference,
    pair_warning,
    place_of,
)
from postproc.comparison.settings import (
    axis_target_differences,
    force_differences,
    frame_differences,
    kind_changes,
    lowered_feed_notes,
    setting_differences,
)
from postproc.comparison.statements import statement_differences
from postproc.correction.targets import Corners, corners_of_motions
from postproc.errors import Level
from postproc.frames import DEG_PER_RAD, M_PER_MM, MM_PER_M, Array, angle_between, norm
from postproc.program import CIRC, LIN, PTP, Ints, Program, distinct

_EXCESS_MARGIN = 5e-6
"""A deviation between targets is reported if it exceeds those at the targets by the tolerance and this [m]; assumed."""
_NO_TRAVEL = 1e-9
"""A move by less [m, rad] counts as no move (assumed)."""
_BACKWARD_STEP = 1e-3
"""A correction moves a target back along the path by less than this [m] (assumed)."""
LEVER = 0.1
"""Length of tool [m] over which the tolerance must hold when the tool is turned."""

_ENDS = re.compile(
    r"(?:S?(?:PTP|LIN|CIRC)(?:_REL)?|SPL)(?:\s*\{|\s+[\w$])|END(?:FOR|IF|LOOP|SWITCH|WHILE)?\b|UNTIL\b", re.IGNORECASE
)
"""A motion, or the end of a block: loops that are known are written out."""
_NO_STATEMENT = re.compile(r"\$|&|(?:GLOBAL\s+)?(?:DEF|DEFFCT|DECL|EXT|EXTFCT|INI|BAS)\b", re.IGNORECASE)


def differences(
    comparison: Comparison,
    nominal_path: PlacedProgram,
    corrected_path: PlacedProgram,
    *,
    has_force_file: bool,
    same_origin: bool,
    are_pairs_certain: bool,
) -> tuple[Difference, ...]:
    """Return the differences besides offsets.

    :param has_force_file: forces of the nominal program come from a file.
    :param same_origin: one conversion made the second program of the first, or both. Settings and statements are then
        not compared.
    :param are_pairs_certain: pairs were found under forces, or the conversion states them.
    """
    ambiguous_pairs = () if are_pairs_certain else tuple(_ambiguous_pairs(comparison, nominal_path, corrected_path))
    if same_origin:
        return (
            *lowered_feed_notes(comparison),
            *_uncompared_motions(comparison),
            *_unpaired_targets(comparison, nominal_path, corrected_path),
            *_deviations_under_force(comparison, nominal_path),
            *ambiguous_pairs,
        )
    path_differences = (
        *_stretches_off_path(comparison, nominal_path, corrected_path),
        *_deviations_under_force(comparison, nominal_path),
    )
    cut_corners = _cut_corners(comparison, nominal_path, corrected_path)
    return (
        *_unresolved_differences(comparison),
        *_uncompared_motions(comparison),
        *_call_differences(comparison),
        *setting_differences(comparison, nominal_path, corrected_path),
        *statement_differences(comparison),
        *force_differences(comparison, corrected_path, has_force_file=has_force_file),
        *_rapid_differences(comparison, nominal_path),
        *_repeated_positions(comparison, nominal_path, corrected_path),
        *_backward_moves(comparison),
        *_unpaired_targets(comparison, nominal_path, corrected_path),
        *axis_target_differences(comparison, nominal_path, corrected_path),
        *_orientation_differences(comparison, nominal_path, corrected_path),
        *_joint_motions_off_path(comparison, nominal_path, corrected_path),
        *path_differences,
        # a path that is off has corners of its own
        *(corner for corner in cut_corners if corner.level == "error" or not path_differences),
        *ambiguous_pairs,
    )


def _unresolved_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield an error if motions that are known at run time only differ in their text.

    If their texts are equal, the statements before them are compared.
    """
    motions = comparison.nominal.unresolved, comparison.corrected.unresolved
    nominal_texts, corrected_texts = ([_normal_text(motion.text) for motion in side] for side in motions)
    first = first_difference(nominal_texts, corrected_texts)
    if first is not None:
        nominal_place, corrected_place = (
            (side[first].file, side[first].line) if first < len(side) else None for side in motions
        )
        message = "motions that are known at run time only differ: it is unknown where they lead."
        count = abs(len(motions[0]) - len(motions[1])) or 1  # equal numbers of motions: one of them differs at least
        yield Difference("error", "unresolved-differs", message, nominal_place, corrected_place, count)
    elif len(comparison.nominal.documents) == len(comparison.corrected.documents):
        yield from _unresolved_statement_differences(comparison)


def _unresolved_statement_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield an error for each motion known at run time only before which the statements differ.

    Compared are the statements back to the motion, or the end of a block, before it.
    """
    nominal, corrected = comparison.nominal, comparison.corrected
    if not nominal.keeps_text or not corrected.keeps_text:
        return
    nominal_lines, corrected_lines = (
        {document.name: document.text.splitlines() for document in program.documents}
        for program in (nominal, corrected)
    )
    for nominal_motion, corrected_motion in zip(nominal.unresolved, corrected.unresolved, strict=True):
        if nominal_motion.file not in nominal_lines or corrected_motion.file not in corrected_lines:
            continue
        preceding_statements = _statements_before(nominal_lines[nominal_motion.file], nominal_motion.line)
        nominal_statements = list(takewhile(bool, preceding_statements))  # "": a motion, or the end of a block
        # the second program may have inserted motions between them: its statements are compared past these
        corrected_statements = filter(
            None, _statements_before(corrected_lines[corrected_motion.file], corrected_motion.line)
        )
        if list(islice(corrected_statements, len(nominal_statements))) != nominal_statements:
            message = "the statements before this motion differ: it is unknown where it leads, or whether it runs."
            yield Difference(
                "error",
                "unresolved-differs",
                message,
                (nominal_motion.file, nominal_motion.line),
                (corrected_motion.file, corrected_motion.line),
                1,
            )


def _statements_before(lines: Sequence[str], line: int) -> Iterator[str]:
    """Yield the statements before a line, backwards, except settings and declarations; "" for a motion or block end.

    :param line: the line, from 1 on.
    """
    for text_line in reversed(lines[: line - 1]):
        text = text_line.partition(";")[0].strip()
        if _ENDS.match(text):
            yield ""
        elif text and not _NO_STATEMENT.match(text):
            yield _normal_text(text)


def _normal_text(text: str) -> str:
    """Return a statement without blanks and in capitals, as statements are compared."""
    return "".join(text.split()).upper()


def _uncompared_motions(comparison: Comparison) -> Iterator[Difference]:
    """Yield motions that are known at run time only, and those that begin at an unknown place."""
    # the lists are of different lengths if only one program has a motion
    for nominal_motion, corrected_motion in zip_longest(comparison.nominal.unresolved, comparison.corrected.unresolved):
        motion = nominal_motion or corrected_motion
        message = f"not compared, because it is known at run time only: {motion.text!r} ({motion.why})."
        nominal_place, corrected_place = (
            None if side is None else (side.file, side.line) for side in (nominal_motion, corrected_motion)
        )
        yield Difference("warning", "not-compared", message, nominal_place, corrected_place, 1)
    nominal_rows = comparison.pair[:, 0]
    # a motion that is its own predecessor begins at an unknown place
    pairs = np.flatnonzero(comparison.nominal.predecessors[nominal_rows] == nominal_rows)
    if len(pairs):
        message = "the way to this target is not compared, because it is unknown where it begins."
        yield pair_warning(comparison, "not-compared", message, pairs)


def _call_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield calls of programs that are in no file and that only one of the two makes."""
    programs = comparison.nominal, comparison.corrected
    nominal_calls, corrected_calls = (
        {issue.subject: issue for issue in program.issues if issue.kind == "external-call"} for program in programs
    )
    for name in sorted(nominal_calls.keys() ^ corrected_calls.keys()):
        is_in_second = name in corrected_calls
        program, other_program = programs[::-1] if is_in_second else programs
        call = (corrected_calls if is_in_second else nominal_calls)[name]
        place = file_and_line(program, call.source_line)
        message = f"{name}(), which is in no file, is called by this program only: its effect is not compared."
        if _is_called(name, other_program):
            message = (
                f"the file of {name}() is in the folder of the other program only: its effect is unknown here. Copy "
                "the file to this folder."
            )
        nominal_place, corrected_place = (None, place) if is_in_second else (place, None)
        yield Difference("warning", "not-compared", message, nominal_place, corrected_place)


def _is_called(name: str, program: Program) -> bool:
    """Return whether the text of a program calls a routine by this name; comments do not count."""
    call = re.compile(rf"^[^;\r\n]*\b{re.escape(name)}[ \t]*\(", re.IGNORECASE | re.MULTILINE)
    return any(call.search(document.text) for document in program.documents)


def _unpaired_targets(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield missing and additional targets.

    A missing one that the second path leaves out is an error. So is an additional one between pairs that a cut leads
    to, if it is farther from the nominal path than the largest permitted correction. Before the first pair and after
    the last one it may be an approach or a retract.
    """
    rows, distances = comparison.only_nominal, np.nan_to_num(comparison.missing_distance)  # NaN for PTP
    if len(rows):
        worst = int(np.argmax(distances))
        is_off_path = distances[worst] > nominal_path.robot_in_cell.tolerance
        message = "a target of the nominal program is missing."
        if is_off_path:
            message = (
                "a target of the nominal program is missing: the corrected path leaves the nominal one by "
                f"{distances[worst] * MM_PER_M:.4f} mm there."
            )
        place = place_of(comparison.nominal, rows[worst])
        level: Level = "error" if is_off_path else "warning"
        yield Difference(level, "only-nominal", message, place, _next_partner(comparison, rows[worst]), len(rows))
    rows = comparison.additional_rows
    if len(rows):
        distances = _distances_of_targets(comparison, nominal_path, corrected_path, rows)
        motions, next_pair = comparison.corrected.motions, np.searchsorted(comparison.pair[:, 1], rows)
        is_between_pairs = (next_pair > 0) & (next_pair < len(comparison.pair))
        is_cut = is_between_pairs & (motions.kind[rows] != PTP) & ~motions.rapid[rows]
        is_far_cut = is_cut & (distances > _max_correction(nominal_path))
        level = "error" if is_far_cut.any() else "warning"
        worst = int(np.argmax(np.where(is_far_cut, distances, 0.0) if is_far_cut.any() else distances))
        message = "an additional target."
        if distances[worst] > nominal_path.robot_in_cell.tolerance:
            message = f"an additional target, {distances[worst] * MM_PER_M:.4f} mm from the nominal path."
        yield Difference(level, "only-corrected", message, None, place_of(comparison.corrected, rows[worst]), len(rows))


def _max_correction(path: PlacedProgram) -> float:
    """Return the largest permitted correction, `max_correction_mm` of the cell, in metres."""
    return path.robot_in_cell.cell.output.max_correction_mm * M_PER_MM


def _distances_of_targets(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram, rows: Ints
) -> Array:
    """Return the distances (n,) of targets of the second program from the nominal path next to them [m].

    Counted is the path from the pair before a target to the pair behind it, or to the end of the program.

    :param rows: (n,) motions of the second program.
    """
    pair = np.searchsorted(comparison.pair[:, 1], rows)
    nominal_rows = np.concatenate([[-1], comparison.pair[:, 0], [len(comparison.nominal.motions) - 1]])
    begin, end = nominal_path.arc_length[nominal_rows[pair] + 1], nominal_path.arc_length[nominal_rows[pair + 1] + 1]
    motion = nominal_rows[pair + 1]
    position = commanded_positions(nominal_path.program, motion, corrected_path.program, rows)
    return distances_from_path(nominal_path, position, begin, end)


def _ambiguous_pairs(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield a warning for pairs whose nominal target may as well belong to a target inserted next to its partner.

    An inserted target may be the right partner if it is within twice the largest offset: without forces the offsets of
    right pairs are unknown.
    """
    if not len(comparison.pair) or not len(comparison.inserted_rows):
        return
    nominal_position = nominal_path.track().position[np.searchsorted(nominal_path.target_rows, comparison.pair[:, 0])]
    corrected_position = corrected_path.track().position
    partner = np.searchsorted(
        corrected_path.target_rows, comparison.pair[:, 1]
    )  # index of the target in the second track
    limit = OFF_PATH + 2.0 * float(comparison.distance.max())
    uncertainty = np.zeros(len(partner))  # of the offset of each pair [m]
    for step in (-1, 1):  # the target before the partner, and the one after it
        neighbour = np.clip(partner + step, 0, len(corrected_path.target_rows) - 1)
        is_inserted = np.isin(corrected_path.target_rows[neighbour], comparison.inserted_rows)
        is_possible = is_inserted & (norm(corrected_position[neighbour] - nominal_position) <= limit)
        gap = norm(corrected_position[neighbour] - corrected_position[partner])
        uncertainty = np.where(is_possible, np.maximum(uncertainty, gap), uncertainty)
    pairs = np.flatnonzero(uncertainty)
    if len(pairs):
        message = (
            "this target may belong to one that was inserted next to its partner: offsets of such pairs are known to "
            f"{uncertainty.max() * MM_PER_M:.2f} mm only. Give the forces with --forces."
        )
        yield pair_warning(comparison, "pairing", message, pairs)


def _next_partner(comparison: Comparison, row: int) -> tuple[str, int] | None:
    """Return file and line of the partner of the next paired target after nominal motion `row`; None after the last."""
    pair_index = int(np.searchsorted(comparison.pair[:, 0], row))
    return place_of(comparison.corrected, comparison.pair[pair_index, 1]) if pair_index < len(comparison.pair) else None


def _orientation_differences(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield targets, inserted ones too, at which a tool of length `LEVER` is turned by more than the tolerance.

    The angle is the smaller of two: from the orientation that keeps the loaded tool nominal, and from the nominal
    orientation, which programs have that correct positions alone. Without forces only the second is known, and nothing
    is yielded if `$BASE` differs.
    """
    limit = nominal_path.robot_in_cell.tolerance / LEVER
    pair_angles = (
        comparison.rotation if comparison.cuts is None else np.minimum(comparison.rotation, comparison.cuts.rotation)
    )
    if comparison.cuts is None and _has_other_base(comparison):
        return
    pairs = np.flatnonzero(pair_angles > limit)
    inserted_rows, inserted_angles = _inserted_rotations(comparison, nominal_path, corrected_path)
    inserted_indices = np.flatnonzero(inserted_angles > limit)
    if not len(pairs) and not len(inserted_indices):
        return
    worst_rows, angle = [-1, -1], 0.0  # of the largest angle: nominal and second motion, −1 for none
    if len(inserted_indices):
        worst = inserted_indices[np.argmax(inserted_angles[inserted_indices])]
        worst_rows, angle = [-1, int(inserted_rows[worst])], float(inserted_angles[worst])
    if len(pairs) and pair_angles[pairs].max() > angle:
        worst = pairs[np.argmax(pair_angles[pairs])]
        worst_rows, angle = comparison.pair[worst].tolist(), float(pair_angles[worst])
    message = f"the tool is turned by {angle * DEG_PER_RAD:.4f}° from its nominal orientation."
    yield difference_at(comparison, "orientation", message, worst_rows, len(pairs) + len(inserted_indices))


def _has_other_base(comparison: Comparison) -> bool:
    """Return whether `$BASE` differs at a pair: this is reported by itself, and may explain offsets and rotations."""
    return any(difference.kind == "base" for difference in frame_differences(comparison))


def _inserted_rotations(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> tuple[Ints, Array]:
    """Return inserted targets (n,) and the angles by which they turn the tool from the nominal path there (n,) [rad].

    Without forces, the angle counts from the nominal orientation at the same share of the stretch between two pairs.
    The larger rotation of these pairs is subtracted.
    """
    cuts = comparison.cuts  # deviations under force; None: no forces are known
    if cuts is not None and len(cuts.row):
        ends = np.flatnonzero(cuts.t == 1.0)  # places at inserted targets; others are between targets
        return cuts.row[ends], cuts.path_rotation[ends]
    row = comparison.inserted_rows
    next_pair = np.searchsorted(comparison.pair[:, 1], row)
    row, next_pair = row[next_pair > 0], next_pair[next_pair > 0]
    if comparison.curves is None or not len(row):
        return row[:0], np.zeros(0)
    # the rows of a chain are consecutive, so that a difference of rows is an index
    chain = comparison.curves.corrected_chain
    motion, t = comparison.curves.nominal_chain.at(chain.end[row - chain.row[0]])
    nominal_pose = toolpath.at(nominal_path.program, nominal_path.segments, motion, t).pose
    corrected_pose = tool_of_nominal(
        nominal_path.program, motion, corrected_path.program, row, corrected_path.program.motions.target[row]
    )
    pair_rotation = np.maximum(comparison.rotation[next_pair - 1], comparison.rotation[next_pair])
    return row, angle_between(nominal_pose[:, :3, :3], corrected_pose[:, :3, :3]) - pair_rotation


def _rapid_differences(comparison: Comparison, nominal_path: PlacedProgram) -> Iterator[Difference]:
    """Yield a difference if rapid targets have an offset: no force acts on them that would explain it.

    Nothing is yielded if `$BASE` differs.
    """
    offsets = (
        comparison.distance
        if comparison.cuts is None
        else np.minimum(comparison.distance, norm(comparison.cuts.corrected_deviation))
    )
    pairs = np.flatnonzero((offsets > nominal_path.robot_in_cell.tolerance) & comparison.rapid)
    if len(pairs) and not _has_other_base(comparison):
        worst = pairs[np.argmax(offsets[pairs])]
        message = f"a rapid target is {offsets[worst] * MM_PER_M:.4f} mm off."
        yield difference_at(comparison, "rapid", message, comparison.pair[worst].tolist(), len(pairs))


def _repeated_positions(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield targets of the second program at which the robot already is: it stops there even if approximated."""
    is_stop, is_nominal_stop = (
        (side.segments.travel < _NO_TRAVEL) & (side.segments.turn < _NO_TRAVEL) & (side.program.motions.kind != PTP)
        for side in (corrected_path, nominal_path)
    )
    # a target that the nominal program repeats too is no difference
    nominal_row, corrected_row = comparison.pair.T
    is_stop[corrected_row[is_nominal_stop[nominal_row]]] = False
    rows = np.flatnonzero(is_stop)
    if len(rows):
        message = "the same target twice in succession: the robot stops there."
        yield difference_at(comparison, "twice", message, (-1, int(rows[0])), len(rows))


def _backward_moves(comparison: Comparison) -> Iterator[Difference]:
    """Yield inserted targets before which the robot moves back along its path."""
    cuts = comparison.cuts
    if cuts is None:
        return
    is_target = cuts.t == 1.0
    rows, lengths = cuts.row[is_target], cuts.length[is_target]
    next_pair = np.searchsorted(comparison.pair[:, 1], rows)  # the pair to which an inserted target leads
    steps = np.diff(lengths)  # along the nominal path, to a target from the one before
    reversals = np.flatnonzero((steps < -_BACKWARD_STEP) & (np.diff(next_pair) == 0))
    if len(reversals):
        first = reversals[0]
        message = f"the robot goes {-steps[first] * MM_PER_M:.4f} mm back on its path."
        yield difference_at(comparison, "back", message, (-1, int(rows[first + 1])), len(reversals))


def _stretches_off_path(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield stretches between pairs on which the second path is farther from the nominal one than its targets are.

    The stretch to a pair is the path from the pair before it.
    An arc with a wrong auxiliary point is such a stretch: its targets are right. It is an error where the distance is
    larger than the largest permitted correction. `_deviations_under_force` reports stretches that are checked under
    forces.
    """
    if comparison.curves is None:
        return
    nominal_row, corrected_row = comparison.pair.T
    limits = OFF_PATH + TIMES_OFFSET * np.maximum(comparison.distance, np.roll(comparison.distance, 1))
    is_off_path = np.nan_to_num(comparison.path_distance) > limits
    is_off_path[_pairs_under_force(comparison)] = False
    # missing targets have a difference of their own
    missing_rows = comparison.only_nominal[comparison.only_nominal < nominal_row[-1]]
    is_off_path[np.searchsorted(nominal_row, missing_rows)] = False
    pairs = np.flatnonzero(is_off_path)
    largest_first = np.argsort(-comparison.path_distance[pairs], kind="stable")
    pairs = np.sort(pairs[largest_first[:_MAX_STRETCHES]])
    distances = np.array([_distance_on_stretch(comparison, nominal_path, corrected_path, k) for k in pairs.tolist()])
    exceeds = distances > limits[pairs]
    pairs, distances = pairs[exceeds], distances[exceeds]
    if len(pairs):
        worst = int(np.argmax(distances))
        pair = pairs[worst]
        message = f"the path is {distances[worst] * MM_PER_M:.4f} mm from the nominal one on the way to this target."
        message += _arc_advice(comparison, np.arange(corrected_row[pair - 1] + 1, corrected_row[pair] + 1))
        level: Level = "error" if distances[worst] > _max_correction(nominal_path) else "warning"
        yield difference_at(comparison, "between", message, comparison.pair[pair].tolist(), len(pairs), level=level)


_MAX_STRETCHES = 1000
"""Largest number of stretches whose distance from the nominal path is computed, by the largest gaps (assumed)."""
_SAMPLES = 65
"""Samples of the second path on each of these stretches (assumed)."""


def _joint_motions_off_path(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield point-to-point motions in place of cuts that leave the nominal path by more than the tolerance."""
    nominal, second = comparison.nominal.motions, comparison.corrected
    motion, rows = kind_changes(comparison)
    is_cut = np.isin(nominal.kind[motion], (LIN, CIRC)) & ~nominal.rapid[motion]
    begin_row = second.predecessors[rows]
    # a motion that is its own predecessor begins at an unknown place
    is_known = (begin_row >= 0) & (begin_row != rows) & (np.searchsorted(comparison.pair[:, 1], rows) > 0)
    changes = np.flatnonzero(is_cut & (second.motions.kind[rows] == PTP) & is_known)
    distances = np.array(
        [
            _distance_of_joint_motion(comparison, nominal_path, corrected_path, int(begin_row[k]), int(rows[k]))
            for k in changes
        ]
    )
    is_off_path = distances > nominal_path.robot_in_cell.tolerance + _EXCESS_MARGIN
    changes, distances = changes[is_off_path], distances[is_off_path]
    if len(changes):
        worst = changes[np.argmax(distances)]
        message = (
            f"PTP instead of a cut: on the way to this target the tool leaves the nominal path by "
            f"{distances.max() * MM_PER_M:.4f} mm. Write LIN or CIRC."
        )
        worst_rows = (int(motion[worst]), int(rows[worst]))
        yield difference_at(comparison, "between", message, worst_rows, len(changes), level="error")


def _distance_of_joint_motion(
    comparison: Comparison,
    nominal_path: PlacedProgram,
    corrected_path: PlacedProgram,
    begin_row: int,
    row: int,
) -> float:
    """Return the largest distance of a PTP from the nominal path [m], less the offsets of its ends.

    The offsets are the correction, which changes in proportion to the way. All joints, and the axis that carries the
    robot, begin and end together.

    :param begin_row: motion of the second program at whose end the PTP begins.
    :param row: the PTP, a motion of the second program after the first pair.
    """
    share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    begin_offset, end_offset = corrected_path.carriage_displacement(np.array([begin_row, row]))
    tips = corrected_path.loaded_tip(
        np.full(_SAMPLES, row),
        q=(1.0 - share) * corrected_path.joints[begin_row] + share * corrected_path.joints[row],
        wrench=np.zeros((_SAMPLES, 6)),
        displacement=(1.0 - share) * begin_offset + share * end_offset,
    )
    pair = int(np.searchsorted(comparison.pair[:, 1], row))
    begin, end = nominal_path.arc_length[comparison.pair[pair - 1 : pair + 1, 0] + 1]
    ends = tips[[0, -1]]
    lengths, _ = nearest_lengths(nominal_path, ends, np.full(2, begin), np.full(2, end))
    begin_correction, end_correction = ends - nominal_path.points(lengths)
    tips = tips - (1.0 - share) * begin_correction - share * end_correction
    return float(distances_from_path(nominal_path, tips, np.full(_SAMPLES, begin), np.full(_SAMPLES, end)).max())


def _pairs_under_force(comparison: Comparison) -> Ints:
    """Return the pairs (n,) whose stretch, from the pair before, is checked under forces; none without forces."""
    cuts = comparison.cuts
    if cuts is None or not len(cuts.row):
        return np.zeros(0, dtype=np.int64)
    return distinct(np.searchsorted(comparison.pair[:, 1], cuts.row[cuts.t < 1.0]))  # t < 1: between targets


def _distance_on_stretch(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram, k: int
) -> float:
    """Return the largest distance [m] of the second path from the nominal one, between pair k − 1 and pair k > 0.

    0 unless it clearly exceeds the distance of inserted targets, since corrections move these off the nominal path.
    """
    assert comparison.curves is not None
    chain = comparison.curves.corrected_chain
    first_row, last_row = comparison.pair[k - 1 : k + 1, 1]
    inserted_rows = comparison.inserted_rows
    inserted_rows = inserted_rows[(inserted_rows > first_row) & (inserted_rows < last_row)]
    inserted_u = chain.end[inserted_rows - chain.row[0]]  # rows of a chain are consecutive
    u = np.append(k - 1.0 + np.linspace(SMALLEST_SHARE, 1.0, _SAMPLES), inserted_u)
    second_points = comparison.curves.second_points_in_cell(u)
    begin, end = nominal_path.arc_length[comparison.pair[k - 1 : k + 1, 0] + 1]
    distances = distances_from_path(nominal_path, second_points, np.full(len(u), begin), np.full(len(u), end))
    inserted_distance = float(distances[_SAMPLES:].max(initial=0.0))
    largest = float(distances.max())
    return largest if largest > OFF_PATH + TIMES_OFFSET * inserted_distance else 0.0


def _deviations_under_force(comparison: Comparison, nominal_path: PlacedProgram) -> Iterator[Difference]:
    """Yield places between targets where the loaded tip is farther from the nominal path than at the targets."""
    cuts = comparison.cuts  # row and t: motion of the second program, and place on it, that were checked
    if cuts is None:
        return
    # the deviation at the end of each motion of the second program: at pairs, and at inserted targets
    end_distance = np.zeros(len(comparison.corrected.motions))
    end_distance[comparison.pair[:, 1]] = norm(cuts.corrected_deviation)
    end_distance[cuts.row[cuts.t == 1.0]] = cuts.corrected_distance[cuts.t == 1.0]
    largest_at_ends = np.maximum(end_distance[cuts.row], end_distance[cuts.row - 1])
    limits = largest_at_ends + nominal_path.robot_in_cell.tolerance + _EXCESS_MARGIN
    stretch = np.searchsorted(comparison.pair[:, 1], cuts.row)
    # missing targets have a difference of their own
    has_missing_target = np.isin(stretch, np.searchsorted(comparison.pair[:, 0], comparison.only_nominal))
    places = np.flatnonzero((cuts.corrected_distance > limits) & (cuts.t < 1.0) & ~has_missing_target)
    if len(places):
        worst = places[np.argmax(cuts.corrected_distance[places])]
        row = int(cuts.row[worst])
        message = (
            f"under the forces given it leaves {cuts.corrected_distance[worst] * MM_PER_M:.4f} mm to the "
            "nominal path before this target."
        )
        message += _arc_advice(comparison, np.array([row]))
        rows = (int(comparison.pair[stretch[worst], 0]), row)
        yield difference_at(comparison, "between", message, rows, len(distinct(cuts.row[places])))


def _cut_corners(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield targets at which approximation (C_DIS) rounds the second path by more than the first program allows.

    It is an error if that is more than the largest deviation without correction, or without forces more than the
    largest permitted correction.
    """
    rows = np.union1d(comparison.pair[:, 1], comparison.inserted_rows)
    if not len(rows):
        return
    corners = corners_of_motions(corrected_path.program, corrected_path.segments, rows)
    rounding = corners.rounding(comparison.corrected.motions.blend[rows])
    allowed_rounding = _allowed_rounding(comparison, nominal_path, rows, corners)
    excess = rounding - allowed_rounding
    cut_corners = np.flatnonzero(excess > nominal_path.robot_in_cell.tolerance + _EXCESS_MARGIN)
    if len(cut_corners):
        worst = cut_corners[np.argmax(excess[cut_corners])]
        next_pair = min(int(np.searchsorted(comparison.pair[:, 1], rows[worst])), len(comparison.pair) - 1)
        remedy = (
            "Set $APO.CDIS and C_DIS back, or convert again."
            if allowed_rounding[worst] > 0.0 or not comparison.nominal.keeps_text
            else "Use a smaller approximation distance there."
        )
        message = (
            f"approximation (C_DIS) cuts the corner by {rounding[worst] * MM_PER_M:.4f} mm; the nominal program allows "
            f"{allowed_rounding[worst] * MM_PER_M:.4g} mm. {remedy}"
        )
        worst_rows = (int(comparison.pair[next_pair, 0]), int(rows[worst]))
        cuts = comparison.cuts
        limit = _max_correction(nominal_path) if cuts is None else float(norm(cuts.nominal).max(initial=0.0))
        level: Level = "error" if excess[worst] > limit else "warning"
        yield difference_at(comparison, "between", message, worst_rows, len(cut_corners), level=level)


def _allowed_rounding(comparison: Comparison, nominal_path: PlacedProgram, rows: Ints, corners: Corners) -> Array:
    """Return how much rounding (n,) [m] of the second program's targets the nominal program allows.

    G-code and APT: the tolerance that G64 or the cell states; 0 at exact stops. KRL and RAPID: the rounding by the
    approximation distance of the nominal program. A target that the nominal program does not have may be rounded in
    KRL and RAPID by the distance of the pair behind it, which convert gives it; in G-code and APT not at all.

    :param rows: (n,) motions of the second program, ascending; the motions of all pairs are among them.
    :param corners: of the second program, at `rows`.
    """
    m, (nominal_rows, corrected_rows) = comparison.nominal.motions, comparison.pair.T
    allowed_rounding = np.zeros(len(rows))
    index_of_pair = np.searchsorted(rows, corrected_rows)
    if not comparison.nominal.keeps_text:  # G-code or APT
        programmed_rounding = np.where(m.blend > 0.0, m.rounding, 0.0)
        allowed_rounding[index_of_pair] = programmed_rounding[nominal_rows]
        return allowed_rounding
    next_pair = np.minimum(np.searchsorted(corrected_rows, rows), len(corrected_rows) - 1)
    allowed_rounding = corners.rounding(m.blend[nominal_rows[next_pair]])
    nominal_corners = corners_of_motions(nominal_path.program, nominal_path.segments, np.arange(len(m)))
    allowed_rounding[index_of_pair] = nominal_corners.rounding(m.blend)[nominal_rows]
    return allowed_rounding


def _arc_advice(comparison: Comparison, rows: Ints) -> str:
    """Return advice for motions `rows` (n,) of the second program that leave the path; empty if none is an arc."""
    return " Check the auxiliary point of its arc." if CIRC in comparison.corrected.motions.kind[rows] else ""
