"""Settings of motions that differ: speed, kind, approximation, axes, status and turn, frames, orientation, forces."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc.comparison.paths import SAME_FRAME, PlacedProgram
from postproc.comparison.result import Comparison, Difference, at_pairs, at_rows, of_line
from postproc.errors import Issue
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, twist_between
from postproc.program import CIRC, FORCE_FRAMES, LIN, PTP, SPL, Ints, Program

_SAME_LENGTH = 1e-5
"""Positions of the axis that carries the robot, and approximation distances, that differ by less [m] are the same."""
_SAME_POSTURE = np.radians(20.0)
"""Larger than any turn of a joint by a correction."""
_SAME_ANGLE = np.radians(0.001)
"""Axis targets that differ by less are the same."""
_NO_SIGN = np.radians(0.01)
"""A joint angle nearer to zero has no sign that T could state."""
_SAME_FORCE, _SAME_SHARE = 0.05, (1e-3, 0.05)
"""Forces that differ by less [N, N·m] are the same, or by a smaller share of themselves: texts round them. The second
share is for TOOL and FEED axes, which the correction turns slightly."""
_KINDS = {LIN: "a line (LIN)", CIRC: "an arc (CIRC)", PTP: "point to point (PTP)", SPL: "a spline (SPL)"}
_LED = "#VAR"
"""Value of `$ORI_TYPE` that the correction may set, so that a target keeps the A, B, C written."""


def settings(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield the settings of paired motions that differ: speed, kind, approximation, axes, turn, orientation, frames."""
    where = np.flatnonzero(found.speed_differs)
    if len(where):
        was, now = found.speeds[where[0]] * MM_PER_M
        yield at_pairs(found, "speed", f"the speed is {now:.4g} mm/s instead of {was:.4g} mm/s.", where)
    yield from _kind(found)
    yield from _approximation(found)
    yield from _external_axes(found)
    yield from _posture(found, one, other)
    yield from _status_and_turn(found, other)
    yield from _orientation_type(found)
    yield from bases_and_tools(found)


def _kind(found: Comparison) -> Iterator[Difference]:
    """Yield targets, inserted ones too, that the second program moves to in another way.

    An arc may have become lines (``--linearize-arcs``): where these leave it, another difference gives the distance.
    """
    rows = np.union1d(found.pair[:, 1], found.inserted)
    motion = found.pair[np.searchsorted(found.pair[:, 1], rows), 0]
    was, now = found.nominal.motions.kind[motion], found.corrected.motions.kind[rows]
    where = np.flatnonzero((was != now) & ~((was == CIRC) & (now == LIN)))
    # between a pair and the next one the nominal program may have motions without partner
    before = np.append(-1, found.pair[:, 0])[np.searchsorted(found.pair[:, 1], rows[where])]
    same = [now[k] in found.nominal.motions.kind[b + 1 : motion[k]] for k, b in zip(where, before, strict=True)]
    where = where[~np.array(same, dtype=bool)]
    if len(where):
        first = where[0]
        message = f"the way to this target is {_KINDS[int(now[first])]} instead of {_KINDS[int(was[first])]}."
        yield at_rows(found, "kind", message, (int(motion[first]), int(rows[first])), len(where))


def _approximation(found: Comparison) -> Iterator[Difference]:
    """Yield targets that are approximated by another distance; of G-code the writer chooses it."""
    if not found.nominal.keeps_text:
        return
    was, now = (p.motions.blend[rows] for p, rows in zip((found.nominal, found.corrected), found.pair.T, strict=True))
    where = np.flatnonzero(np.abs(now - was) > _SAME_LENGTH)
    if len(where):
        words = (f"{value * MM_PER_M:.4g} mm" if value > 0.0 else "none" for value in (now[where[0]], was[where[0]]))
        message = f"the approximation before the target ($APO.CDIS, C_DIS) is {' instead of '.join(words)}."
        yield at_pairs(found, "approximation", message, where)


def _external_axes(found: Comparison) -> Iterator[Difference]:
    """Yield external axes with other values; of the axis that carries the robot, at pairs."""
    one, other = found.nominal.carriage, found.corrected.carriage
    if one is not None and other is not None:
        was, now = (axis.at(rows) for axis, rows in ((one, found.pair[:, 0]), (other, found.pair[:, 1])))
        where = np.flatnonzero(np.abs(now - was) > _SAME_LENGTH)
        if len(where):
            values = " mm instead of ".join(f"{value[where[0]] * MM_PER_M:.4f}" for value in (now, was))
            message = f"E1 is at {values} mm: the arm is in another pose, and deflects differently, on the same path."
            yield at_pairs(found, "external-axis", message, where)
    elif (one is None) != (other is None) and found.nominal.keeps_text:
        name = "nominal" if other is None else "corrected"
        message = f"E1, which carries the robot, has values in the {name} program only."
        yield Difference("warning", "external-axis", message, count=len(found.pair))
    fixed = [
        {issue.subject: issue for issue in program.issues if issue.kind == "external-axis"}
        for program in (found.nominal, found.corrected)
    ]
    for axis in sorted({*fixed[0], *fixed[1]}):
        words = [_position(axis, each.get(axis)) for each in fixed]
        if words[0] != words[1]:
            message = f"{axis} is {words[1]} in the corrected program, and {words[0]} in the nominal one."
            first, second = (
                of_line(program, each[axis].source_line) if axis in each else None
                for program, each in zip((found.nominal, found.corrected), fixed, strict=True)
            )
            yield Difference("warning", "external-axis", message, first, second)


def _position(axis: str, issue: Issue | None) -> str:
    """Return the position of an external axis, as the reader of a program reported it."""
    if issue is None:
        return "at 0 or not given"
    stated = issue.message.partition(":")[0].removeprefix(f"{axis} is ")
    return stated if stated.startswith("at ") else "not given before its first motion"


def _posture(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield targets with other joint angles: S, T, or an axis target before them, are others."""
    apart = np.abs(one.joints[found.pair[:, 0]] - other.joints[found.pair[:, 1]])
    where = np.flatnonzero((apart > _SAME_POSTURE).any(axis=1))
    if len(where):
        joint = int(np.argmax(apart[where[0]]))
        was, now = (side.joints[found.pair[where[0], k], joint] * DEG_PER_RAD for k, side in enumerate((one, other)))
        message = f"the robot takes another posture: A{joint + 1} is at {now:.1f}° instead of {was:.1f}° (S, T)."
        yield at_pairs(found, "posture", message, where)


def _status_and_turn(found: Comparison, other: PlacedProgram) -> Iterator[Difference]:
    """Yield PTP targets whose S or T one program alone gives, or whose T is not that of the joint angles there."""
    one, two = (program.motions for program in (found.nominal, found.corrected))
    first, second = found.pair.T
    ptp = (one.kind[first] == PTP) & (two.kind[second] == PTP) & found.nominal.keeps_text
    q = other.joints[second]
    wrong = (two.turn[second, None] >> np.arange(6) & 1 != (q < 0.0)) & (np.abs(q) > _NO_SIGN)
    wrong = wrong.any(axis=1) & (two.turn[second] != one.turn[first]) & (two.turn[second] >= 0)
    alone = ((one.turn[first] < 0) != (two.turn[second] < 0)) | ((one.status[first] < 0) != (two.status[second] < 0))
    where = np.flatnonzero(ptp & (wrong | alone))
    if len(where):
        k = where[0]
        was, now = (
            ", ".join(f"{name} {value}" if value >= 0 else f"no {name}" for name, value in (("S", s), ("T", t)))
            for s, t in (
                (int(one.status[first[k]]), int(one.turn[first[k]])),
                (int(two.status[second[k]]), int(two.turn[second[k]])),
            )
        )
        message = f"status and turn of this target are {now} instead of {was}: the axes may turn another way."
        yield at_pairs(found, "posture", message, where)


def _orientation_type(found: Comparison) -> Iterator[Difference]:
    """Yield pairs with another `$ORI_TYPE`, but for that which keeps the A, B, C of a corrected target."""
    one, other = found.nominal.layout, found.corrected.layout
    if one is None or other is None:
        return
    was, now = one.orientation_types(found.pair[:, 0]), other.orientation_types(found.pair[:, 1])
    if was is None or now is None:
        return
    kinds = np.stack([found.nominal.motions.kind[found.pair[:, 0]], found.corrected.motions.kind[found.pair[:, 1]]])
    where = np.flatnonzero((was != now) & (now != _LED) & (kinds != PTP).all(axis=0))
    if len(where):
        message = (
            f"$ORI_TYPE is {now[where[0]]} instead of {was[where[0]]}: the tool may turn otherwise on the way there."
        )
        yield at_pairs(found, "orientation-type", message, where)


def bases_and_tools(found: Comparison) -> Iterator[Difference]:
    """Yield `$BASE` and `$TOOL` that differ."""
    for name, (frames, used), (others, others_used) in zip(
        ("$BASE", "$TOOL"), _frames_of(found.nominal), _frames_of(found.corrected), strict=True
    ):
        apart = np.abs(twist_between(frames[:, None], others[None])).max(axis=2) > SAME_FRAME
        where = np.flatnonzero(apart[used[found.pair[:, 0]], others_used[found.pair[:, 1]]])
        if len(where):
            first = where[0]
            off = twist_between(frames[used[found.pair[first, 0]]], others[others_used[found.pair[first, 1]]])
            message = (
                f"{name} differs, by {norm(off[:3]) * MM_PER_M:.4f} mm and {np.degrees(norm(off[3:])):.4f}°: offsets "
                "are those of the tool in the root of the robot."
            )
            yield at_pairs(found, name.strip("$").lower(), message, where)


def _frames_of(program: Program) -> tuple[tuple[Array, Ints], tuple[Array, Ints]]:
    m = program.motions
    return (program.bases, m.base), (program.tools, m.tool)


def forces(found: Comparison, other: PlacedProgram, *, in_file: bool) -> Iterator[Difference]:
    """Yield places where comments of the second program give another force than the nominal program has.

    :param in_file: the nominal program has its forces from a file: comments in both programs must then be the same.
    """
    kept, notes = (program.notes for program in (found.nominal, found.corrected))
    if found.cuts is None or not notes:
        return
    what = "its comments give another force than those of the nominal program"
    if in_file and kept:
        texts = [[(note.wrench, note.frame) for note in side] for side in (kept, notes)]
        if texts[0] != texts[1]:
            first = next(
                (k for k, pair in enumerate(zip(*texts, strict=False)) if pair[0] != pair[1]), min(map(len, texts))
            )
            rows = [
                min(side[first].before, len(program.motions) - 1) if first < len(side) else -1
                for side, program in ((kept, found.nominal), (notes, found.corrected))
            ]
            yield at_rows(found, "force", f"{what}.", rows, 1)
        return
    load, two = other.forces(None), found.pair[:, 1]
    theirs, mine = _in_base(found, other.wrench(load, two)), found.cuts.wrench
    share = np.where(load.frame[two] == FORCE_FRAMES.index("BASE"), *_SAME_SHARE)
    cutting = ~found.rapid & ~found.corrected.motions.rapid[two]  # rapid motions carry no force
    where = np.flatnonzero((norm(theirs - mine) > _SAME_FORCE + share * norm(mine)) & cutting)
    if len(where):
        now, was = (" ".join(f"{value:.4g}" for value in wrench[where[0], :3]) for wrench in (theirs, mine))
        message = f"its comments give the force {now} N instead of {was} N ($BASE): it was corrected for another one."
        yield at_pairs(found, "force", message, where)


def _in_base(found: Comparison, wrench: Array) -> Array:
    """Return wrenches (P, 6) in the nominal `$BASE` of the pairs, of wrenches in the root."""
    rotation = found.nominal.bases[found.nominal.motions.base[found.pair[:, 0]], :3, :3]
    return np.asarray(np.einsum("nji,nkj->nki", rotation, wrench.reshape(-1, 2, 3))).reshape(-1, 6)


def axis_targets(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield axis targets with other joint angles, and those that one program alone has between the same pairs.

    A new program for G-code begins with one at `[start]`, which G-code does not know.
    """
    axis = [np.flatnonzero(np.isfinite(side.program.motions.joints[:, 0])) for side in (one, other)]
    gap = [np.searchsorted(found.pair[:, k], rows) for k, rows in enumerate(axis)]
    if not found.nominal.keeps_text:
        axis = [rows[gaps > 0] for rows, gaps in zip(axis, gap, strict=True)]
        gap = [gaps[gaps > 0] for gaps in gap]
    first = [np.arange(len(gaps)) - np.searchsorted(gaps, gaps) for gaps in gap]
    known = {(int(g), int(k)): int(row) for g, k, row in zip(gap[1], first[1], axis[1], strict=True)}
    differ: list[tuple[int, int]] = []
    alone: list[tuple[int, int]] = []
    for g, k, row in zip(gap[0].tolist(), first[0].tolist(), axis[0].tolist(), strict=True):
        partner = known.pop((g, k), -1)
        if partner < 0:
            alone.append((row, -1))
        elif np.abs(one.joints[row] - other.joints[partner]).max() > _SAME_ANGLE:
            differ.append((row, partner))
    alone += [(-1, row) for row in known.values()]
    if differ:
        row, partner = differ[0]
        joint = int(np.argmax(np.abs(one.joints[row] - other.joints[partner])))
        was, now = (side.joints[r, joint] * DEG_PER_RAD for side, r in ((one, row), (other, partner)))
        message = f"an axis target is another one: A{joint + 1} {now:.4f}° instead of {was:.4f}°."
        yield at_rows(found, "axis-target", message, (row, partner), len(differ))
    if alone:
        message = "an axis target (PTP {A1 …}) is in one of the programs only."
        yield at_rows(found, "axis-target", message, alone[0], len(alone))
