"""Settings of motions that differ between two programs.

Speed, kind, approximation, external axes, status and turn, orientation, frames, forces, axis targets.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.comparison.paths import SAME_FRAME, PlacedProgram
from postproc.comparison.result import (
    Comparison,
    Difference,
    difference_at,
    file_and_line,
    first_difference,
    pair_warning,
    wrench_in_nominal_base,
)
from postproc.errors import Issue
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, twist_between
from postproc.program import CIRC, FORCE_FRAMES, LIN, PTP, SPL, Ints, Program

SAME_LENGTH = 1e-5
"""Positions of the axis that carries the robot, and approximation distances, that differ by less [m] are the same
(assumed)."""
_SAME_POSTURE = np.radians(20.0)
"""Larger than any turn of a joint by a correction (assumed)."""
_SAME_ANGLE = np.radians(0.001)
"""Axis targets that differ by less are the same (assumed)."""
_NO_SIGN = np.radians(0.01)
"""A joint angle nearer to zero has no sign that T could state (assumed)."""
_SAME_FORCE, _SAME_SHARE = 0.05, (1e-3, 0.05)
"""Forces that differ by less [N, N·m] are the same, or by a smaller share of themselves: texts round them. The second
share is for TOOL and FEED axes, which the correction turns slightly."""
_KINDS = {LIN: "a line (LIN)", CIRC: "an arc (CIRC)", PTP: "point to point (PTP)", SPL: "a spline (SPL)"}
_LED_ORIENTATION = "#VAR"
"""Value of `$ORI_TYPE` that the correction may set, so that a target keeps the A, B, C written."""


def setting_differences(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield the settings of paired motions that differ: speed, kind, approximation, axes, turn, orientation, frames."""
    pairs = np.flatnonzero(comparison.speed_differs)
    if len(pairs):
        yield pair_warning(comparison, "speed", f"the speed is {_speeds_text(comparison.speeds[pairs[0]])}.", pairs)
    yield from _kind_differences(comparison)
    yield from _approximation_differences(comparison)
    yield from _external_axis_differences(comparison)
    yield from _posture_differences(comparison, nominal_path, corrected_path)
    yield from _status_and_turn_differences(comparison, corrected_path)
    yield from _orientation_type_differences(comparison)
    yield from frame_differences(comparison)


def lowered_feed_notes(comparison: Comparison) -> Iterator[Difference]:
    """Yield the feeds that the conversion has lowered, for information."""
    nominal_speed, corrected_speed = comparison.speeds.T
    pairs = np.flatnonzero(comparison.speed_differs & (corrected_speed < nominal_speed))
    if len(pairs):
        lowest = pairs[np.argmin(corrected_speed[pairs] / nominal_speed[pairs])]
        message = f"the conversion has lowered the feed: {_speeds_text(comparison.speeds[lowest])}."
        places = difference_at(comparison, "speed", message, comparison.pair[lowest].tolist(), len(pairs))
        yield replace(places, level="info")


def _speeds_text(speeds: Array) -> str:
    """Return two speeds (2,) [m/s], the nominal one first, as text such as ``"30 mm/s instead of 20 mm/s"``."""
    nominal, corrected = (
        f"{speed:.4g} mm/s" if speed < 9999.5 else f"{speed:.0f} mm/s"  # g writes larger ones with an exponent
        for speed in (speeds * MM_PER_M).tolist()
    )
    return f"{corrected} instead of {nominal}"


def _kind_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield a warning if the second program moves to targets, inserted ones too, by another kind of motion."""
    motion, rows = kind_changes(comparison)
    if len(rows):
        nominal_kind = int(comparison.nominal.motions.kind[motion[0]])
        corrected_kind = int(comparison.corrected.motions.kind[rows[0]])
        message = f"the way to this target is {_KINDS[corrected_kind]} instead of {_KINDS[nominal_kind]}."
        yield difference_at(comparison, "kind", message, (int(motion[0]), int(rows[0])), len(rows))


def kind_changes(comparison: Comparison) -> tuple[Ints, Ints]:
    """Return the motions (n,) of the nominal program that are of another kind in the second one, and its motions (n,).

    An arc that has become lines (``--linearize-arcs``) is no change of kind. The nominal motion of an inserted target
    is that to the next pair.
    """
    nominal = comparison.nominal.motions
    rows = np.union1d(comparison.pair[:, 1], comparison.inserted_rows)
    next_pair = np.searchsorted(comparison.pair[:, 1], rows)
    motion = comparison.pair[next_pair, 0]
    nominal_kind, corrected_kind = nominal.kind[motion], comparison.corrected.motions.kind[rows]
    indices = np.flatnonzero((nominal_kind != corrected_kind) & ~((nominal_kind == CIRC) & (corrected_kind == LIN)))
    # a nominal target without partner before the pair may be of the same kind: the motion may belong to it
    previous_motion = np.append(-1, comparison.pair[:, 0])[next_pair]  # that of the pair before; −1: none
    is_axis_target = np.isfinite(nominal.joints[:, 0])
    cartesian_kind = np.where(is_axis_target, -1, nominal.kind)
    has_unpaired_kind = [corrected_kind[k] in cartesian_kind[previous_motion[k] + 1 : motion[k]] for k in indices]
    indices = indices[~np.array(has_unpaired_kind, dtype=bool)]
    return motion[indices], rows[indices]


def _approximation_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield a warning if targets are approximated by another distance; nothing for G-code, whose writer chooses it."""
    if not comparison.nominal.keeps_text:
        return
    nominal_blend, corrected_blend = (  # approximation distances (P,) [m]; 0: an exact stop
        program.motions.blend[rows]
        for program, rows in zip((comparison.nominal, comparison.corrected), comparison.pair.T, strict=True)
    )
    pairs = np.flatnonzero(np.abs(corrected_blend - nominal_blend) > SAME_LENGTH)
    if len(pairs):
        words = (
            f"{value * MM_PER_M:.4g} mm" if value > 0.0 else "none"
            for value in (corrected_blend[pairs[0]], nominal_blend[pairs[0]])
        )
        message = f"the approximation before the target ($APO.CDIS, C_DIS) is {' instead of '.join(words)}."
        yield pair_warning(comparison, "approximation", message, pairs)


def _external_axis_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield a warning each for external axes with other values: the axis that carries the robot, and fixed axes."""
    nominal_axis, corrected_axis = comparison.nominal.carriage, comparison.corrected.carriage
    if nominal_axis is not None and corrected_axis is not None:
        nominal_e1, corrected_e1 = nominal_axis.at(comparison.pair[:, 0]), corrected_axis.at(comparison.pair[:, 1])
        pairs = np.flatnonzero(np.abs(corrected_e1 - nominal_e1) > SAME_LENGTH)
        if len(pairs):
            values = " mm instead of ".join(f"{value[pairs[0]] * MM_PER_M:.4f}" for value in (corrected_e1, nominal_e1))
            message = f"E1 is at {values} mm: the arm is in another pose, and deflects differently, on the same path."
            yield pair_warning(comparison, "external-axis", message, pairs)
    elif (nominal_axis is None) != (corrected_axis is None) and comparison.nominal.keeps_text:
        name = "nominal" if corrected_axis is None else "corrected"
        message = f"E1, which carries the robot, has values in the {name} program only."
        yield Difference("warning", "external-axis", message, count=len(comparison.pair))
    yield from _fixed_axis_differences(comparison)


def _fixed_axis_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield a warning for each external axis that keeps another position in the second program.

    The positions are those in the issues of the reader.
    """
    programs = comparison.nominal, comparison.corrected
    nominal_axes, corrected_axes = (
        {issue.subject: issue for issue in program.issues if issue.kind == "external-axis"} for program in programs
    )
    for axis in sorted({*nominal_axes, *corrected_axes}):
        nominal_text, corrected_text = (_position(axis, axes.get(axis)) for axes in (nominal_axes, corrected_axes))
        if nominal_text != corrected_text:
            message = f"{axis} is {corrected_text} in the corrected program, and {nominal_text} in the nominal one."
            nominal_place, corrected_place = (
                file_and_line(program, axes[axis].source_line) if axis in axes else None
                for program, axes in zip(programs, (nominal_axes, corrected_axes), strict=True)
            )
            yield Difference("warning", "external-axis", message, nominal_place, corrected_place)


def _position(axis: str, issue: Issue | None) -> str:
    """Return the position of an external axis in words, from the issue of the reader, for example "at 100 mm".

    :param issue: what the reader reported of this axis; None: nothing, since the axis is at 0 or not in the program.
    """
    if issue is None:
        return "at 0 or not given"
    position = issue.message.partition(":")[0].removeprefix(f"{axis} is ")
    return position if position.startswith("at ") else "not given before its first motion"


def _posture_differences(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield a warning if targets have other joint angles, since S, T or an axis target before them differs."""
    differences = np.abs(nominal_path.joints[comparison.pair[:, 0]] - corrected_path.joints[comparison.pair[:, 1]])
    pairs = np.flatnonzero((differences > _SAME_POSTURE).any(axis=1))
    if len(pairs):
        joint = int(np.argmax(differences[pairs[0]]))
        nominal_angle, corrected_angle = (
            side.joints[comparison.pair[pairs[0], k], joint] * DEG_PER_RAD
            for k, side in enumerate((nominal_path, corrected_path))
        )
        message = (
            f"the robot takes another posture: "
            f"A{joint + 1} is at {corrected_angle:.1f}° instead of {nominal_angle:.1f}° (S, T)."
        )
        yield pair_warning(comparison, "posture", message, pairs)


def _status_and_turn_differences(comparison: Comparison, corrected_path: PlacedProgram) -> Iterator[Difference]:
    """Yield a warning for PTP targets with S or T in one program only, or with a T unlike the signs of the joints."""
    nominal_motions, corrected_motions = (program.motions for program in (comparison.nominal, comparison.corrected))
    nominal_row, corrected_row = comparison.pair.T
    is_ptp = (nominal_motions.kind[nominal_row] == PTP) & (corrected_motions.kind[corrected_row] == PTP)
    # −1 where a target does not state it
    nominal_status, corrected_status = nominal_motions.status[nominal_row], corrected_motions.status[corrected_row]
    nominal_turn, corrected_turn = nominal_motions.turn[nominal_row], corrected_motions.turn[corrected_row]
    q = corrected_path.joints[corrected_row]
    turn_bits = corrected_turn[:, None] >> np.arange(6) & 1  # bit k of T is set where joint k + 1 is negative
    is_wrong_turn = ((turn_bits != (q < 0.0)) & (np.abs(q) > _NO_SIGN)).any(axis=1)
    is_wrong_turn &= (corrected_turn != nominal_turn) & (corrected_turn >= 0)
    is_missing = ((nominal_turn < 0) != (corrected_turn < 0)) | ((nominal_status < 0) != (corrected_status < 0))
    pairs = np.flatnonzero(is_ptp & comparison.nominal.keeps_text & (is_wrong_turn | is_missing))
    if len(pairs):
        first = pairs[0]
        nominal_bits = _status_and_turn_text(int(nominal_status[first]), int(nominal_turn[first]))
        corrected_bits = _status_and_turn_text(int(corrected_status[first]), int(corrected_turn[first]))
        message = (
            f"status and turn of this target are {corrected_bits} instead of {nominal_bits}: "
            "the axes may turn another way."
        )
        yield pair_warning(comparison, "posture", message, pairs)


def _status_and_turn_text(status: int, turn: int) -> str:
    """Return status and turn of a target in words, for example "S 2, no T"; negative: the target does not state it."""
    return ", ".join(f"{name} {value}" if value >= 0 else f"no {name}" for name, value in (("S", status), ("T", turn)))


def _orientation_type_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield a warning for pairs whose `$ORI_TYPE` differs, except where the correction set it to keep A, B, C.

    Nothing is yielded for programs that are not KRL.
    """
    nominal_layout, corrected_layout = comparison.nominal.layout, comparison.corrected.layout
    if nominal_layout is None or corrected_layout is None:
        return
    nominal_types, corrected_types = (
        nominal_layout.orientation_types(comparison.pair[:, 0]),
        corrected_layout.orientation_types(comparison.pair[:, 1]),
    )
    if nominal_types is None or corrected_types is None:
        return
    is_on_path = (comparison.nominal.motions.kind[comparison.pair[:, 0]] != PTP) & (
        comparison.corrected.motions.kind[comparison.pair[:, 1]] != PTP
    )
    pairs = np.flatnonzero((nominal_types != corrected_types) & (corrected_types != _LED_ORIENTATION) & is_on_path)
    if len(pairs):
        message = (
            f"$ORI_TYPE is {corrected_types[pairs[0]]} instead of {nominal_types[pairs[0]]}: "
            "the tool may turn otherwise on the way there."
        )
        yield pair_warning(comparison, "orientation-type", message, pairs)


def frame_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield a warning each for pairs whose `$BASE` differs, and for those whose `$TOOL` differs."""
    nominal, corrected = comparison.nominal, comparison.corrected
    nominal_row, corrected_row = comparison.pair.T
    bases = _FramesOfPairs(
        nominal.bases, corrected.bases, nominal.motions.base[nominal_row], corrected.motions.base[corrected_row]
    )
    tools = _FramesOfPairs(
        nominal.tools, corrected.tools, nominal.motions.tool[nominal_row], corrected.motions.tool[corrected_row]
    )
    for name, frames in (("$BASE", bases), ("$TOOL", tools)):
        twists = twist_between(frames.nominal[:, None], frames.corrected[None])  # from each to each: they are few
        is_other = np.abs(twists).max(axis=2) > SAME_FRAME
        pairs = np.flatnonzero(is_other[frames.nominal_index, frames.corrected_index])
        if len(pairs):
            twist = twists[frames.nominal_index[pairs[0]], frames.corrected_index[pairs[0]]]
            message = (
                f"{name} differs, by {norm(twist[:3]) * MM_PER_M:.4f} mm and {np.degrees(norm(twist[3:])):.4f}°: "
                "offsets are those of the tool in the root of the robot."
            )
            yield pair_warning(comparison, name.strip("$").lower(), message, pairs)


class _FramesOfPairs(NamedTuple):
    """Frames of both programs, and which of them each pair has.

    :param nominal: (f, 4, 4) of the nominal program [m]; `corrected` (g, 4, 4) of the second one.
    :param nominal_index: (P,) frame of each pair in `nominal`; `corrected_index` (P,) in `corrected`.
    """

    nominal: Array
    corrected: Array
    nominal_index: Ints
    corrected_index: Ints


def force_differences(
    comparison: Comparison, corrected_path: PlacedProgram, *, has_force_file: bool
) -> Iterator[Difference]:
    """Yield a warning if force comments of the second program give other forces than the nominal program has.

    :param has_force_file: the nominal program has its forces from a file: comments in both programs must then be the
        same.
    """
    if comparison.cuts is None or not comparison.corrected.notes:
        return
    if has_force_file and comparison.nominal.notes:
        yield from _force_comment_differences(comparison)
        return
    load, corrected_rows = corrected_path.forces(None), comparison.pair[:, 1]
    corrected_wrench = wrench_in_nominal_base(comparison, corrected_path.wrench(load, corrected_rows))
    nominal_wrench = comparison.cuts.wrench
    share = np.where(load.frame[corrected_rows] == FORCE_FRAMES.index("BASE"), *_SAME_SHARE)
    cutting = ~comparison.rapid & ~comparison.corrected.motions.rapid[corrected_rows]  # rapid motions carry no force
    pairs = np.flatnonzero(
        (norm(corrected_wrench - nominal_wrench) > _SAME_FORCE + share * norm(nominal_wrench)) & cutting
    )
    if len(pairs):
        corrected_force, nominal_force = (
            " ".join(f"{value:.4g}" for value in wrench[pairs[0], :3]) for wrench in (corrected_wrench, nominal_wrench)
        )
        message = (
            f"its comments give the force {corrected_force} N instead of {nominal_force} N ($BASE): "
            "it was corrected for another one."
        )
        yield pair_warning(comparison, "force", message, pairs)


def _force_comment_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield a warning at the first force comment that is not the same in both programs."""
    programs = comparison.nominal, comparison.corrected
    nominal_forces, corrected_forces = ([(note.wrench, note.frame) for note in program.notes] for program in programs)
    first = first_difference(nominal_forces, corrected_forces)
    if first is None:
        return
    # a comment after the last motion is reported at that motion; −1: this program has fewer comments
    rows = [
        min(program.notes[first].before, len(program.motions) - 1) if first < len(program.notes) else -1
        for program in programs
    ]
    message = "its comments give another force than those of the nominal program."
    yield difference_at(comparison, "force", message, rows, 1)


def axis_target_differences(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield axis targets with other joint angles, and those that one program alone has between the same pairs.

    A new program for G-code begins with one at `[start]`, which G-code does not know.
    """
    from_first_pair = not comparison.nominal.keeps_text
    nominal_targets = _axis_targets(nominal_path.program, comparison.pair[:, 0], from_first_pair=from_first_pair)
    corrected_targets = _axis_targets(corrected_path.program, comparison.pair[:, 1], from_first_pair=from_first_pair)
    unpaired_rows = [(row, -1) for place, row in nominal_targets.items() if place not in corrected_targets]
    unpaired_rows += [(-1, row) for place, row in corrected_targets.items() if place not in nominal_targets]
    paired_rows = [
        (row, corrected_targets[place]) for place, row in nominal_targets.items() if place in corrected_targets
    ]
    differences = [np.abs(nominal_path.joints[row] - corrected_path.joints[partner]) for row, partner in paired_rows]
    other_targets = [k for k, difference in enumerate(differences) if difference.max() > _SAME_ANGLE]
    if other_targets:
        first = other_targets[0]
        row, partner = paired_rows[first]
        joint = int(np.argmax(differences[first]))
        nominal_angle = nominal_path.joints[row, joint] * DEG_PER_RAD
        corrected_angle = corrected_path.joints[partner, joint] * DEG_PER_RAD
        message = f"an axis target is another one: A{joint + 1} {corrected_angle:.4f}° instead of {nominal_angle:.4f}°."
        yield difference_at(comparison, "axis-target", message, (row, partner), len(other_targets))
    if unpaired_rows:
        message = "an axis target (PTP {A1 …}) is in one of the programs only."
        yield difference_at(comparison, "axis-target", message, unpaired_rows[0], len(unpaired_rows))


def _axis_targets(program: Program, paired_rows: Ints, *, from_first_pair: bool) -> dict[tuple[int, int], int]:
    """Return the motions of a program to axis targets, by their place among the pairs.

    A place is the number of pairs before the motion, and its number among the axis targets since the last pair. Axis
    targets of two programs at the same place are partners.

    :param paired_rows: (P,) motions of the program that end at the pairs.
    :param from_first_pair: leave out those before the first pair.
    """
    rows = np.flatnonzero(np.isfinite(program.motions.joints[:, 0]))
    next_pair = np.searchsorted(paired_rows, rows)
    number_since_pair = np.arange(len(rows)) - np.searchsorted(next_pair, next_pair)
    places = zip(next_pair.tolist(), number_since_pair.tolist(), strict=True)
    first = 1 if from_first_pair else 0
    return {place: row for place, row in zip(places, rows.tolist(), strict=True) if place[0] >= first}
