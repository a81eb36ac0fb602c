"""Values that hold for targets of two programs, and differ: speed, approximation, axes, frames, forces."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc.comparison.curves import SAME_FRAME
from postproc.comparison.entries import at_pairs, at_rows, here, of_line
from postproc.comparison.result import Comparison, Difference
from postproc.comparison.side import Side
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, twist_between
from postproc.program import CIRC, FORCE_FRAMES, LIN, PTP, SPL, Ints, Program

_SAME_LENGTH = 1e-5
"""Places of the axis that carries the robot, and approximation distances, that differ by less [m] are the same."""
_SAME_POSTURE = np.radians(20.0)
"""So far a correction does not turn a joint."""
_SAME_ANGLE = np.radians(0.001)
"""Axis targets that differ by less are the same."""
_SAME_FORCE, _SAME_SHARE = 0.05, (1e-3, 0.05)
"""Forces that differ by less [N, N·m] are the same, or by a smaller share of themselves: texts round them. The second
share is for TOOL and FEED axes, which the correction turns a little."""

_WAYS = {LIN: "a line (LIN)", CIRC: "an arc (CIRC)", PTP: "point to point (PTP)", SPL: "a spline (SPL)"}


def values(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
    """Tell values that hold for pairs and differ: speed, kind of motion, approximation, axes, frames, forces."""
    where = np.flatnonzero(found.speed_differs)
    if len(where):
        was, now = found.speeds[where[0]] * MM_PER_M
        yield at_pairs(found, "speed", f"the speed is {now:.4g} mm/s instead of {was:.4g} mm/s.", where)
    yield from _kind(found)
    yield from _approximation(found)
    yield from _external_axes(found)
    yield from _posture(found, one, other)
    yield from bases_and_tools(found)


def _kind(found: Comparison) -> Iterator[Difference]:
    """Tell targets, inserted ones too, to which the second program moves in another way than the nominal one.

    An arc may have become lines (``--linearize-arcs``): where they leave it, that is told by how far.
    """
    rows = np.union1d(found.pair[:, 1], found.inserted)
    motion = found.pair[np.searchsorted(found.pair[:, 1], rows), 0]
    was, now = found.nominal.motions.kind[motion], found.corrected.motions.kind[rows]
    where = np.flatnonzero((was != now) & ~((was == CIRC) & (now == LIN)))
    if len(where):
        first = where[0]
        message = f"the way to this target is {_WAYS[int(now[first])]} instead of {_WAYS[int(was[first])]}."
        yield at_rows(found, "kind", message, (int(motion[first]), int(rows[first])), len(where))


def _approximation(found: Comparison) -> Iterator[Difference]:
    """Tell targets that are approximated by another distance; what C_DIS comes of G-code is for the writer to say."""
    if not found.nominal.keeps_text:
        return
    was, now = (p.motions.blend[rows] for p, rows in zip((found.nominal, found.corrected), found.pair.T, strict=True))
    where = np.flatnonzero(np.abs(now - was) > _SAME_LENGTH)
    if len(where):
        told = (f"{value * MM_PER_M:.4g} mm" if value > 0.0 else "none" for value in (now[where[0]], was[where[0]]))
        message = f"the approximation before the target ($APO.CDIS, C_DIS) is {' instead of '.join(told)}."
        yield at_pairs(found, "approximation", message, where)


def _external_axes(found: Comparison) -> Iterator[Difference]:
    """Tell where external axes stand elsewhere; of pairs, where the axis that carries the robot does."""
    one, other = found.nominal.carriage, found.corrected.carriage
    if one is not None and other is not None:
        was, now = (axis.at(rows) for axis, rows in ((one, found.pair[:, 0]), (other, found.pair[:, 1])))
        where = np.flatnonzero(np.abs(now - was) > _SAME_LENGTH)
        if len(where):
            values = " mm instead of ".join(f"{value[where[0]] * MM_PER_M:.4f}" for value in (now, was))
            message = f"E1 is at {values} mm: the robot stands elsewhere, and gives way otherwise, for the same path."
            yield at_pairs(found, "external-axis", message, where)
    elif (one is None) != (other is None) and found.nominal.keeps_text:
        name = "nominal" if other is None else "corrected"
        message = f"E1, which carries the robot, has values in the {name} program only."
        yield Difference("warning", "external-axis", message, count=len(found.pair))
    standing = [
        {issue.subject: issue for issue in program.issues if issue.kind == "external-axis"}
        for program in (found.nominal, found.corrected)
    ]
    for axis in sorted({*standing[0], *standing[1]}):
        told = [each[axis].message.partition(":")[0] if axis in each else f"{axis} at 0 or unsaid" for each in standing]
        if told[0] != told[1]:
            message = f"{told[1]} in the corrected program, {told[0]} in the nominal one."
            one_place, other_place = (
                of_line(program, each[axis].source_line) if axis in each else None
                for program, each in zip((found.nominal, found.corrected), standing, strict=True)
            )
            yield here("external-axis", message, one_place, other_place)


def _posture(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
    """Tell where the joints stand elsewhere for the same target: S, T, or an axis target before it are others."""
    apart = np.abs(one.joints[found.pair[:, 0]] - other.joints[found.pair[:, 1]])
    where = np.flatnonzero((apart > _SAME_POSTURE).any(axis=1))
    if len(where):
        joint = int(np.argmax(apart[where[0]]))
        was, now = (side.joints[found.pair[where[0], k], joint] * DEG_PER_RAD for k, side in enumerate((one, other)))
        message = f"the robot takes another posture: A{joint + 1} is at {now:.1f}° instead of {was:.1f}° (S, T)."
        yield at_pairs(found, "posture", message, where)


def bases_and_tools(found: Comparison) -> Iterator[Difference]:
    """Tell `$BASE` and `$TOOL` that differ."""
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
                "are those of the tool as it stands in the robot's root."
            )
            yield at_pairs(found, name.strip("$").lower(), message, where)


def _frames_of(program: Program) -> tuple[tuple[Array, Ints], tuple[Array, Ints]]:
    m = program.motions
    return (program.bases, m.base), (program.tools, m.tool)


def forces(found: Comparison, other: Side, *, in_file: bool) -> Iterator[Difference]:
    """Tell where comments of the second program give another force than is known of the nominal one.

    Where its forces come from a file, comments that it has too are kept as they are.
    """
    kept, notes = (program.notes for program in (found.nominal, found.corrected))
    if found.cuts is None or not notes:
        return
    told = "its comments say another force than those of the nominal program"
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
            yield at_rows(found, "force", f"{told}.", rows, 1)
        return
    load, two = other.forces(None), found.pair[:, 1]
    theirs, mine = _in_base(found, other.wrench(load, two)), found.cuts.wrench
    share = np.where(load.frame[two] == FORCE_FRAMES.index("BASE"), *_SAME_SHARE)
    cutting = ~found.rapid & ~found.corrected.motions.rapid[two]  # rapid motions carry no force
    where = np.flatnonzero((norm(theirs - mine) > _SAME_FORCE + share * norm(mine)) & cutting)
    if len(where):
        now, was = (" ".join(f"{value:.4g}" for value in wrench[where[0], :3]) for wrench in (theirs, mine))
        message = f"its comments say the force {now} N instead of {was} N ($BASE): it was corrected for another one."
        yield at_pairs(found, "force", message, where)


def _in_base(found: Comparison, wrench: Array) -> Array:
    """Return wrenches (P, 6) in the root in the nominal `$BASE` of the pairs."""
    rotation = found.nominal.bases[found.nominal.motions.base[found.pair[:, 0]], :3, :3]
    return np.asarray(np.einsum("nji,nkj->nki", rotation, wrench.reshape(-1, 2, 3))).reshape(-1, 6)


def axis_targets(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
    """Tell joint angles of axis targets that differ, or that one program alone has, in the same gap between pairs.

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
        message = "an axis target (PTP {A1 …}) stands in one program alone."
        yield at_rows(found, "axis-target", message, alone[0], len(alone))
