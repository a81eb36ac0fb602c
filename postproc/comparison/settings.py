"""Settings of motions that differ between two programs.

Speed, kind, approximation, external axes, status and turn, orientation, frames, forces, axis targets.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

from postproc.comparison.paths import SAME_FRAME, PlacedProgram
from postproc.comparison.result import Comparison, Difference, file_and_line, pair_warning, warning_at
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
        nominal_speed, corrected_speed = comparison.speeds[pairs[0]] * MM_PER_M
        yield pair_warning(
            comparison, "speed", f"the speed is {corrected_speed:.4g} mm/s instead of {nominal_speed:.4g} mm/s.", pairs
        )
    yield from _kind_differences(comparison)
    yield from _approximation_differences(comparison)
    yield from _external_axis_differences(comparison)
    yield from _posture_differences(comparison, nominal_path, corrected_path)
    yield from _status_and_turn_differences(comparison, corrected_path)
    yield from _orientation_type_differences(comparison)
    yield from frame_differences(comparison)


def lowered_feed_notes(comparison: Comparison) -> Iterator[Difference]:
    """Yield the feeds that the conversion has lowered, for information."""
    nominal_speed, corrected_speed = comparison.speeds.T * MM_PER_M
    pairs = np.flatnonzero(comparison.speed_differs & (corrected_speed < nominal_speed))
    if len(pairs):
        lowest = pairs[np.argmin(corrected_speed[pairs] / nominal_speed[pairs])]
        speeds = f"{corrected_speed[lowest]:.4g} mm/s instead of {nominal_speed[lowest]:.4g} mm/s"
        message = f"the conversion has lowered the feed: {speeds}."
        places = warning_at(comparison, "speed", message, comparison.pair[lowest].tolist(), len(pairs))
        yield replace(places, level="info")


def _kind_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield targets, inserted ones too, that the second program moves to in another way.

    An arc may have become lines (``--linearize-arcs``): where these leave it, another difference gives the distance.
    """
    rows = np.union1d(comparison.pair[:, 1], comparison.inserted_rows)
    motion = comparison.pair[np.searchsorted(comparison.pair[:, 1], rows), 0]
    nominal_kind, corrected_kind = comparison.nominal.motions.kind[motion], comparison.corrected.motions.kind[rows]
    indices = np.flatnonzero((nominal_kind != corrected_kind) & ~((nominal_kind == CIRC) & (corrected_kind == LIN)))
    # between a pair and the next one the nominal program may have Cartesian targets without partner
    previous_pair = np.append(-1, comparison.pair[:, 0])[np.searchsorted(comparison.pair[:, 1], rows[indices])]
    kinds = np.where(np.isnan(comparison.nominal.motions.joints[:, 0]), comparison.nominal.motions.kind, -1)
    is_same_kind = [corrected_kind[k] in kinds[b + 1 : motion[k]] for k, b in zip(indices, previous_pair, strict=True)]
    indices = indices[~np.array(is_same_kind, dtype=bool)]
    if len(indices):
        first = indices[0]
        message = (
            f"the way to this target is "
            f"{_KINDS[int(corrected_kind[first])]} instead of {_KINDS[int(nominal_kind[first])]}."
        )
        yield warning_at(comparison, "kind", message, (int(motion[first]), int(rows[first])), len(indices))


def _approximation_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield targets that are approximated by another distance; of G-code the writer chooses it."""
    if not comparison.nominal.keeps_text:
        return
    nominal_blend, corrected_blend = (
        p.motions.blend[rows]
        for p, rows in zip((comparison.nominal, comparison.corrected), comparison.pair.T, strict=True)
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
    """Yield external axes with other values; of the axis that carries the robot, at pairs."""
    nominal_axis, corrected_axis = comparison.nominal.carriage, comparison.corrected.carriage
    if nominal_axis is not None and corrected_axis is not None:
        nominal_e1, corrected_e1 = (
            axis.at(rows)
            for axis, rows in ((nominal_axis, comparison.pair[:, 0]), (corrected_axis, comparison.pair[:, 1]))
        )
        pairs = np.flatnonzero(np.abs(corrected_e1 - nominal_e1) > SAME_LENGTH)
        if len(pairs):
            values = " mm instead of ".join(f"{value[pairs[0]] * MM_PER_M:.4f}" for value in (corrected_e1, nominal_e1))
            message = f"E1 is at {values} mm: the arm is in another pose, and deflects differently, on the same path."
            yield pair_warning(comparison, "external-axis", message, pairs)
    elif (nominal_axis is None) != (corrected_axis is None) and comparison.nominal.keeps_text:
        name = "nominal" if corrected_axis is None else "corrected"
        message = f"E1, which carries the robot, has values in the {name} program only."
        yield Difference("warning", "external-axis", message, count=len(comparison.pair))
    fixed_axes = [
        {issue.subject: issue for issue in program.issues if issue.kind == "external-axis"}
        for program in (comparison.nominal, comparison.corrected)
    ]
    for axis in sorted({*fixed_axes[0], *fixed_axes[1]}):
        words = [_position(axis, axis_issues.get(axis)) for axis_issues in fixed_axes]
        if words[0] != words[1]:
            message = f"{axis} is {words[1]} in the corrected program, and {words[0]} in the nominal one."
            first, second = (
                file_and_line(program, axis_issues[axis].source_line) if axis in axis_issues else None
                for program, axis_issues in zip((comparison.nominal, comparison.corrected), fixed_axes, strict=True)
            )
            yield Difference("warning", "external-axis", message, first, second)


def _position(axis: str, issue: Issue | None) -> str:
    """Return the position of an external axis, as the reader of a program reported it."""
    if issue is None:
        return "at 0 or not given"
    position = issue.message.partition(":")[0].removeprefix(f"{axis} is ")
    return position if position.startswith("at ") else "not given before its first motion"


def _posture_differences(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield targets with other joint angles: S, T, or an axis target before them, are others."""
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
    """Yield PTP targets whose S or T one program alone gives, or whose T is not that of the joint angles there."""
    nominal_motions, corrected_motions = (program.motions for program in (comparison.nominal, comparison.corrected))
    first, second = comparison.pair.T
    ptp = (nominal_motions.kind[first] == PTP) & (corrected_motions.kind[second] == PTP) & comparison.nominal.keeps_text
    q = corrected_path.joints[second]
    differs = (corrected_motions.turn[second, None] >> np.arange(6) & 1 != (q < 0.0)) & (np.abs(q) > _NO_SIGN)
    differs = (
        differs.any(axis=1)
        & (corrected_motions.turn[second] != nominal_motions.turn[first])
        & (corrected_motions.turn[second] >= 0)
    )
    is_missing = ((nominal_motions.turn[first] < 0) != (corrected_motions.turn[second] < 0)) | (
        (nominal_motions.status[first] < 0) != (corrected_motions.status[second] < 0)
    )
    pairs = np.flatnonzero(ptp & (differs | is_missing))
    if len(pairs):
        k = pairs[0]
        nominal_bits, corrected_bits = (
            ", ".join(f"{name} {value}" if value >= 0 else f"no {name}" for name, value in (("S", s), ("T", t)))
            for s, t in (
                (int(nominal_motions.status[first[k]]), int(nominal_motions.turn[first[k]])),
                (int(corrected_motions.status[second[k]]), int(corrected_motions.turn[second[k]])),
            )
        )
        message = (
            f"status and turn of this target are {corrected_bits} instead of {nominal_bits}: "
            "the axes may turn another way."
        )
        yield pair_warning(comparison, "posture", message, pairs)


def _orientation_type_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield pairs whose `$ORI_TYPE` differs, except where it differs to keep the A, B, C of a corrected target."""
    nominal_layout, corrected_layout = comparison.nominal.layout, comparison.corrected.layout
    if nominal_layout is None or corrected_layout is None:
        return
    nominal_types, corrected_types = (
        nominal_layout.orientation_types(comparison.pair[:, 0]),
        corrected_layout.orientation_types(comparison.pair[:, 1]),
    )
    if nominal_types is None or corrected_types is None:
        return
    kinds = np.stack(
        [
            comparison.nominal.motions.kind[comparison.pair[:, 0]],
            comparison.corrected.motions.kind[comparison.pair[:, 1]],
        ]
    )
    pairs = np.flatnonzero(
        (nominal_types != corrected_types) & (corrected_types != _LED_ORIENTATION) & (kinds != PTP).all(axis=0)
    )
    if len(pairs):
        message = (
            f"$ORI_TYPE is {corrected_types[pairs[0]]} instead of {nominal_types[pairs[0]]}: "
            "the tool may turn otherwise on the way there."
        )
        yield pair_warning(comparison, "orientation-type", message, pairs)


def frame_differences(comparison: Comparison) -> Iterator[Difference]:
    """Yield `$BASE` and `$TOOL` that differ."""
    for name, (frames, frame_index), (corrected_frames, corrected_index) in zip(
        ("$BASE", "$TOOL"), _frames_of(comparison.nominal), _frames_of(comparison.corrected), strict=True
    ):
        frames_differ = np.abs(twist_between(frames[:, None], corrected_frames[None])).max(axis=2) > SAME_FRAME
        pairs = np.flatnonzero(
            frames_differ[frame_index[comparison.pair[:, 0]], corrected_index[comparison.pair[:, 1]]]
        )
        if len(pairs):
            first = pairs[0]
            twist = twist_between(
                frames[frame_index[comparison.pair[first, 0]]],
                corrected_frames[corrected_index[comparison.pair[first, 1]]],
            )
            message = (
                f"{name} differs, by {norm(twist[:3]) * MM_PER_M:.4f} mm and {np.degrees(norm(twist[3:])):.4f}°: "
                "offsets are those of the tool in the root of the robot."
            )
            yield pair_warning(comparison, name.strip("$").lower(), message, pairs)


def _frames_of(program: Program) -> tuple[tuple[Array, Ints], tuple[Array, Ints]]:
    """Return the frames (f, 4, 4) `$BASE`, and the row (M,) of that of each motion; and the same of `$TOOL`."""
    m = program.motions
    return (program.bases, m.base), (program.tools, m.tool)


def force_differences(comparison: Comparison, corrected_path: PlacedProgram, *, in_file: bool) -> Iterator[Difference]:
    """Yield places where comments of the second program give another force than the nominal program has.

    :param in_file: the nominal program has its forces from a file: comments in both programs must then be the same.
    """
    nominal_notes, notes = (program.notes for program in (comparison.nominal, comparison.corrected))
    if comparison.cuts is None or not notes:
        return
    text = "its comments give another force than those of the nominal program"
    if in_file and nominal_notes:
        texts = [[(note.wrench, note.frame) for note in side] for side in (nominal_notes, notes)]
        if texts[0] != texts[1]:
            first = next(
                (k for k, pair in enumerate(zip(*texts, strict=False)) if pair[0] != pair[1]), min(map(len, texts))
            )
            rows = [
                min(side[first].before, len(program.motions) - 1) if first < len(side) else -1
                for side, program in ((nominal_notes, comparison.nominal), (notes, comparison.corrected))
            ]
            yield warning_at(comparison, "force", f"{text}.", rows, 1)
        return
    load, corrected_rows = corrected_path.forces(None), comparison.pair[:, 1]
    corrected_wrench, nominal_wrench = (
        _base_wrenches(comparison, corrected_path.wrench(load, corrected_rows)),
        comparison.cuts.wrench,
    )
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


def _base_wrenches(comparison: Comparison, wrench: Array) -> Array:
    """Return wrenches (P, 6) in the axes of the nominal `$BASE` of the pairs; `wrench` (P, 6) is in root axes."""
    rotation = comparison.nominal.bases[comparison.nominal.motions.base[comparison.pair[:, 0]], :3, :3]
    return np.asarray(np.einsum("nji,nkj->nki", rotation, wrench.reshape(-1, 2, 3))).reshape(-1, 6)


def axis_target_differences(
    comparison: Comparison, nominal_path: PlacedProgram, corrected_path: PlacedProgram
) -> Iterator[Difference]:
    """Yield axis targets with other joint angles, and those that one program alone has between the same pairs.

    A new program for G-code begins with one at `[start]`, which G-code does not know.
    """
    axis = [np.flatnonzero(np.isfinite(side.program.motions.joints[:, 0])) for side in (nominal_path, corrected_path)]
    gap = [np.searchsorted(comparison.pair[:, k], rows) for k, rows in enumerate(axis)]
    if not comparison.nominal.keeps_text:
        axis = [rows[gaps > 0] for rows, gaps in zip(axis, gap, strict=True)]
        gap = [gaps[gaps > 0] for gaps in gap]
    # axis targets belong together that have the same number between the same pairs
    number = [np.arange(len(gaps)) - np.searchsorted(gaps, gaps) for gaps in gap]
    corrected_rows = {(int(g), int(k)): int(row) for g, k, row in zip(gap[1], number[1], axis[1], strict=True)}
    differ: list[tuple[int, int]] = []
    unpaired_rows: list[tuple[int, int]] = []
    for g, k, row in zip(gap[0].tolist(), number[0].tolist(), axis[0].tolist(), strict=True):
        partner = corrected_rows.pop((g, k), -1)
        if partner < 0:
            unpaired_rows.append((row, -1))
        elif np.abs(nominal_path.joints[row] - corrected_path.joints[partner]).max() > _SAME_ANGLE:
            differ.append((row, partner))
    unpaired_rows += [(-1, row) for row in corrected_rows.values()]
    if differ:
        row, partner = differ[0]
        joint = int(np.argmax(np.abs(nominal_path.joints[row] - corrected_path.joints[partner])))
        nominal_angle, corrected_angle = (
            side.joints[r, joint] * DEG_PER_RAD for side, r in ((nominal_path, row), (corrected_path, partner))
        )
        message = f"an axis target is another one: A{joint + 1} {corrected_angle:.4f}° instead of {nominal_angle:.4f}°."
        yield warning_at(comparison, "axis-target", message, (row, partner), len(differ))
    if unpaired_rows:
        message = "an axis target (PTP {A1 …}) is in one of the programs only."
        yield warning_at(comparison, "axis-target", message, unpaired_rows[0], len(unpaired_rows))
