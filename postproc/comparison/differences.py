"""What differs between two programs besides the offsets of their targets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from postproc import toolpath
from postproc.comparison.curves import SAME_FRAME
from postproc.comparison.result import Comparison, Difference
from postproc.comparison.side import Side
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, angle_between, norm, twist_between
from postproc.program import CIRC, FORCE_FRAMES, PTP, Ints, Program

BESIDE = 3.0
"""How far from the path a target may stand to be one inserted on it, in offsets of its neighbours."""
OFF_PATH = 1e-4
"""The same where they have none [m]."""
_BEYOND = 5e-6
"""By how much more than the tolerance it must be off between targets, more than at them, to be told [m]."""
_SAME_LENGTH = 1e-5
"""Places of the axis that carries the robot, and approximation distances, that differ by less [m] are the same."""
_SAME_POSTURE = np.radians(20.0)
"""So far a correction does not turn a joint."""
_SAME_ANGLE = np.radians(0.001)
"""Axis targets that differ by less are the same."""
_SAME_FORCE, _SAME_SHARE = 0.05, (1e-3, 0.05)
"""Forces that differ by less [N, N·m] are the same, or by a smaller share of themselves: texts round them. The second
share is for TOOL and FEED axes, which the correction turns a little."""
_NOTHING = 1e-9
"""A move [m, rad] that is none."""
_BACK = 1e-3
"""So far [m] a program does not go back on its path, but where it is wrong."""
LEVER = 0.1
"""Length of tool [m] along which the tolerance must hold where it is turned."""


def differences(found: Comparison, one: Side, other: Side, *, in_file: bool) -> tuple[Difference, ...]:
    """Return what differs besides offsets.

    :param in_file: forces of the nominal program come from a file.
    """
    return (
        *_unresolved(found),
        *_open(found),
        *_calls(found),
        *_values(found, one, other),
        *_forces(found, other, in_file=in_file),
        *_rapid(found, one),
        *_twice(found, one, other),
        *_back(found, one),
        *_alone(found),
        *_axis_targets(found, one, other),
        *_orientation(found, one, other),
        *_astray(found, one),
    )


def _unresolved(found: Comparison) -> Iterator[Difference]:
    """Tell motions that only the running robot knows: nothing is compared there but their text."""
    both = [program.unresolved for program in (found.nominal, found.corrected)]
    texts = [[_squeezed(each.text) for each in side] for side in both]
    if texts[0] != texts[1]:
        first = next(
            (k for k, pair in enumerate(zip(*texts, strict=False)) if pair[0] != pair[1]), min(map(len, texts))
        )
        places = [(side[first].file, side[first].line) if first < len(side) else None for side in both]
        message = "motions that only the running robot knows differ: nobody can say where they lead."
        yield Difference(
            "error", "unresolved-differs", message, places[0], places[1], abs(len(both[0]) - len(both[1])) or 1
        )
    for k in range(max(map(len, both))):
        sides = [side[k] if k < len(side) else None for side in both]
        each = sides[0] or sides[1]
        assert each is not None
        message = f"not compared, because only the running robot knows it: {each.text!r} ({each.why})."
        places = [None if side is None else (side.file, side.line) for side in sides]
        yield Difference("warning", "not-compared", message, places[0], places[1], 1)


def _open(found: Comparison) -> Iterator[Difference]:
    """Tell the ways that are not compared, because it is not known where they begin."""
    after = found.nominal.after
    if after is None:
        return
    where = np.flatnonzero(after[found.pair[:, 0]] == found.pair[:, 0])
    if len(where):
        message = "the way to this target is not compared, because where it begins is not known."
        yield _at(found, "not-compared", message, where)


def _calls(found: Comparison) -> Iterator[Difference]:
    """Tell calls of programs that are in no file, and that one of the two alone makes: nobody knows what they do."""
    calls = [
        {issue.subject: issue for issue in program.issues if issue.kind == "external-call"}
        for program in (found.nominal, found.corrected)
    ]
    for name in sorted(calls[0].keys() ^ calls[1].keys()):
        side = int(name in calls[1])
        program = (found.nominal, found.corrected)[side]
        place = _of_line(program, calls[side][name].source_line)
        message = f"{name}(), which is in no file, is called by this program alone: what it does is not compared."
        yield _here("not-compared", message, *((None, place) if side else (place, None)))


def _squeezed(text: str) -> str:
    return "".join(text.split()).upper()


def _values(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
    """Tell values that hold for pairs and differ: speed, kind of motion, approximation, axes, frames, forces."""
    where = np.flatnonzero(found.speed_differs)
    if len(where):
        was, now = found.speeds[where[0]] * MM_PER_M
        yield _at(found, "speed", f"the speed is {now:.4g} mm/s instead of {was:.4g} mm/s.", where)
    where = np.flatnonzero(found.kind_differs)
    if len(where):
        message = "one program moves point to point (PTP) where the other follows a line or an arc."
        yield _at(found, "kind", message, where)
    yield from _approximation(found)
    yield from _external_axes(found)
    yield from _posture(found, one, other)
    yield from _frames(found)


def _approximation(found: Comparison) -> Iterator[Difference]:
    """Tell targets that are approximated by another distance; what C_DIS comes of G-code is for the writer to say."""
    if not found.nominal.keeps_text:
        return
    was, now = (p.motions.blend[rows] for p, rows in zip((found.nominal, found.corrected), found.pair.T, strict=True))
    where = np.flatnonzero(np.abs(now - was) > _SAME_LENGTH)
    if len(where):
        told = (f"{value * MM_PER_M:.4g} mm" if value > 0.0 else "none" for value in (now[where[0]], was[where[0]]))
        message = f"the approximation before the target ($APO.CDIS, C_DIS) is {' instead of '.join(told)}."
        yield _at(found, "approximation", message, where)


def _external_axes(found: Comparison) -> Iterator[Difference]:
    """Tell where external axes stand elsewhere; of pairs, where the axis that carries the robot does."""
    one, other = found.nominal.carriage, found.corrected.carriage
    if one is not None and other is not None:
        was, now = (axis.at(rows) for axis, rows in ((one, found.pair[:, 0]), (other, found.pair[:, 1])))
        where = np.flatnonzero(np.abs(now - was) > _SAME_LENGTH)
        if len(where):
            values = " mm instead of ".join(f"{value[where[0]] * MM_PER_M:.4f}" for value in (now, was))
            message = f"E1 is at {values} mm: the robot stands elsewhere, and gives way otherwise, for the same path."
            yield _at(found, "external-axis", message, where)
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
                _of_line(program, each[axis].source_line) if axis in each else None
                for program, each in zip((found.nominal, found.corrected), standing, strict=True)
            )
            yield _here("external-axis", message, one_place, other_place)


def _posture(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
    """Tell where the joints stand elsewhere for the same target: S, T, or an axis target before it are others."""
    apart = np.abs(one.joints[found.pair[:, 0]] - other.joints[found.pair[:, 1]])
    where = np.flatnonzero((apart > _SAME_POSTURE).any(axis=1))
    if len(where):
        joint = int(np.argmax(apart[where[0]]))
        was, now = (side.joints[found.pair[where[0], k], joint] * DEG_PER_RAD for k, side in enumerate((one, other)))
        message = f"the robot takes another posture: A{joint + 1} is at {now:.1f}° instead of {was:.1f}° (S, T)."
        yield _at(found, "posture", message, where)


def _frames(found: Comparison) -> Iterator[Difference]:
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
            yield _at(found, name.strip("$").lower(), message, where)


def _frames_of(program: Program) -> tuple[tuple[Array, Ints], tuple[Array, Ints]]:
    m = program.motions
    return (program.bases, m.base), (program.tools, m.tool)


def _forces(found: Comparison, other: Side, *, in_file: bool) -> Iterator[Difference]:
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
            yield _rows(found, "force", f"{told}.", rows, 1)
        return
    load, two = other.forces(None), found.pair[:, 1]
    theirs, mine = _in_base(found, other.wrench(load, two)), found.cuts.wrench
    share = np.where(load.frame[two] == FORCE_FRAMES.index("BASE"), *_SAME_SHARE)
    where = np.flatnonzero((norm(theirs - mine) > _SAME_FORCE + share * norm(mine)) & ~found.rapid)
    if len(where):
        now, was = (" ".join(f"{value:.4g}" for value in wrench[where[0], :3]) for wrench in (theirs, mine))
        message = f"its comments say the force {now} N instead of {was} N ($BASE): it was corrected for another one."
        yield _at(found, "force", message, where)


def _in_base(found: Comparison, wrench: Array) -> Array:
    """Return wrenches (P, 6) in the root in the nominal `$BASE` of the pairs."""
    rotation = found.nominal.bases[found.nominal.motions.base[found.pair[:, 0]], :3, :3]
    return np.asarray(np.einsum("nji,nkj->nki", rotation, wrench.reshape(-1, 2, 3))).reshape(-1, 6)


def _alone(found: Comparison) -> Iterator[Difference]:
    """Tell targets without partner."""
    rows = found.only_nominal
    if len(rows):
        message = "a target of the nominal program has no partner."
        yield Difference("warning", "only-nominal", message, place_of(found.nominal, rows[0]), count=len(rows))
    rows = found.only_corrected
    if len(rows):
        message = "a target without partner, beside the nominal path."
        yield Difference("warning", "only-corrected", message, None, place_of(found.corrected, rows[0]), len(rows))


def _axis_targets(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
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
        yield _rows(found, "axis-target", message, (row, partner), len(differ))
    if alone:
        message = "an axis target (PTP {A1 …}) stands in one program alone."
        yield _rows(found, "axis-target", message, alone[0], len(alone))


def _orientation(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
    """Tell where the tool is turned by more than the tolerance on a part of its length, also at inserted targets.

    That is from where it should be told to stand under the forces, or from its nominal orientation, which programs have
    that correct positions alone.
    """
    allowed = one.place.tolerance / LEVER
    turned = found.rotation if found.cuts is None else np.minimum(found.rotation, found.cuts.turned)
    if found.cuts is None and any(each.kind == "base" for each in _frames(found)):
        return
    where = np.flatnonzero(turned > allowed)
    inserted, off = _inserted_turned(found, one, other)
    beside = np.flatnonzero(off > allowed)
    if not len(where) and not len(beside):
        return
    rows, angle = ([-1, -1], 0.0)
    if len(beside):
        worst = beside[np.argmax(off[beside])]
        rows, angle = [-1, int(inserted[worst])], float(off[worst])
    if len(where) and turned[where].max() > angle:
        worst = where[np.argmax(turned[where])]
        rows, angle = found.pair[worst].tolist(), float(turned[worst])
    message = f"the tool is turned by {angle * DEG_PER_RAD:.4f}° from its nominal orientation."
    yield _rows(found, "orientation", message, rows, len(where) + len(beside))


def _inserted_turned(found: Comparison, one: Side, other: Side) -> tuple[Ints, Array]:
    """Return inserted targets (n,) and by how much they turn the tool from the nominal path at their place (n,) [rad].

    Without forces the place is that at the same share of the way; less what the pairs beside it are turned by.
    """
    cuts = found.cuts
    if cuts is not None and len(cuts.row):
        ends = np.flatnonzero(cuts.t == 1.0)
        return cuts.row[ends], cuts.between_turned[ends]
    row = found.inserted
    behind = np.searchsorted(found.pair[:, 1], row)
    row, behind = row[behind > 0], behind[behind > 0]
    if found.curves is None or not len(row):
        return row[:0], np.zeros(0)
    chain = found.curves.other
    motion, t = found.curves.one.at(chain.end[row - chain.row[0]])
    mine = toolpath.at(one.program, one.path, motion, t).pose
    flange = toolpath.flange_from_tcp(other.program, row, other.program.motions.target[row], None)
    theirs = toolpath.pose_in_base(one.program, motion, flange @ toolpath.tool_of(one.program, motion), None)
    beside = np.maximum(found.rotation[behind - 1], found.rotation[behind])
    return row, angle_between(mine[:, :3, :3], theirs[:, :3, :3]) - beside


def _rapid(found: Comparison, one: Side) -> Iterator[Difference]:
    """Tell rapid targets that are elsewhere: no force calls for that."""
    off = found.distance if found.cuts is None else np.minimum(found.distance, norm(found.cuts.corrected))
    where = np.flatnonzero((off > one.place.tolerance) & found.rapid)
    if len(where) and not any(each.kind == "base" for each in _frames(found)):
        worst = where[np.argmax(off[where])]
        message = f"a rapid target is {off[worst] * MM_PER_M:.4f} mm off."
        yield _rows(found, "rapid", message, found.pair[worst].tolist(), len(where))


def _twice(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
    """Tell targets of the second program at which the robot stands already: it stops there, approximated or not."""
    still, also = (
        (side.path.way < _NOTHING) & (side.path.turn < _NOTHING) & (side.program.motions.kind != PTP)
        for side in (other, one)
    )
    still[found.pair[also[found.pair[:, 0]], 1]] = False
    where = np.flatnonzero(still)
    if len(where):
        message = "a target stands twice: the robot stops there."
        yield _rows(found, "twice", message, (-1, int(where[0])), len(where))


def _back(found: Comparison, one: Side) -> Iterator[Difference]:
    """Tell inserted targets before which the robot goes back on its path."""
    cuts = found.cuts
    if cuts is None:
        return
    ends = np.flatnonzero(cuts.t == 1.0)
    behind = np.searchsorted(found.pair[:, 1], cuts.row[ends])
    along = cuts.share[ends] * one.path.length[found.pair[behind, 0]]
    back = np.flatnonzero((np.diff(along) < -_BACK) & (np.diff(behind) == 0)) + 1
    if len(back):
        message = f"the robot goes {(along[back[0] - 1] - along[back[0]]) * MM_PER_M:.4f} mm back on its path."
        yield _rows(found, "back", message, (-1, int(cuts.row[ends[back[0]]])), len(back))


def _astray(found: Comparison, one: Side) -> Iterator[Difference]:
    """Tell moves of the second program whose ends stand on the nominal path, and that leave it between them.

    Such an arc has an auxiliary point that sends the robot elsewhere, which no target shows.
    """
    if not len(found.pair):
        return
    allowed = OFF_PATH + BESIDE * np.maximum(found.distance, np.roll(found.distance, 1))
    follows = np.diff(found.pair[:, 0], prepend=-2) == 1
    far = follows & (np.nan_to_num(found.between) > allowed)
    bad = np.flatnonzero(far)
    if len(bad):
        worst = bad[np.argmax(found.between[bad])]
        message = f"it runs {found.between[worst] * MM_PER_M:.4f} mm beside the nominal path before this target."
        rows = np.arange(found.pair[worst - 1, 1] + 1, found.pair[worst, 1] + 1)
        yield _rows(found, "between", message + _look(found, rows), found.pair[worst].tolist(), len(bad))
    cuts = found.cuts
    if cuts is None:
        return
    at_end = np.zeros(len(found.corrected.motions))
    at_end[found.pair[:, 1]] = norm(cuts.corrected)
    at_end[cuts.row[cuts.t == 1.0]] = cuts.between_corrected[cuts.t == 1.0]
    ends = np.maximum(at_end[cuts.row], at_end[cuts.row - 1])
    pair = np.searchsorted(found.pair[:, 1], cuts.row)
    off = cuts.between_corrected
    astray = (off > ends + one.place.tolerance + _BEYOND) & (cuts.t < 1.0) & ~far[pair]
    bad = np.flatnonzero(astray)
    if len(bad):
        worst = bad[np.argmax(off[bad])]
        row = int(cuts.row[worst])
        message = (
            f"under the forces given it leaves {off[worst] * MM_PER_M:.4f} mm to the nominal path before this target."
        )
        count = len(np.unique(cuts.row[bad]))
        message += _look(found, np.array([row]))
        yield _rows(found, "between", message, (int(found.pair[pair[worst], 0]), row), count)


def _look(found: Comparison, rows: Ints) -> str:
    arc = CIRC in found.corrected.motions.kind[rows]
    return " Look at the auxiliary point of its arc." if arc else ""


def place_of(program: Program, row: int) -> tuple[str, int]:
    """Return the file and its line where a motion stands."""
    return program.places(np.array([row])).of(0)


def _of_line(program: Program, line: int | None) -> tuple[str, int] | None:
    """Return the file and its line that a line of a reader's issue is, as far as motions tell."""
    if line is None:
        return None
    rows = np.flatnonzero(program.motions.line == line)
    return place_of(program, rows[0]) if len(rows) else (program.documents[0].name, line)


def _here(
    kind: str, message: str, nominal: tuple[str, int] | None, corrected: tuple[str, int] | None, count: int = 1
) -> Difference:
    return Difference("warning", kind, message, nominal, corrected, count)


def _rows(found: Comparison, kind: str, message: str, rows: Sequence[int], count: int) -> Difference:
    """Return a difference at a motion of each program; −1 where one has none."""
    one, other = (
        None if row < 0 else place_of(program, row)
        for program, row in zip((found.nominal, found.corrected), rows, strict=True)
    )
    return _here(kind, message, one, other, count)


def _at(found: Comparison, kind: str, message: str, pairs: Ints) -> Difference:
    """Return a difference at pairs (n,), the first of which is named."""
    return _rows(found, kind, message, found.pair[pairs[0]].tolist(), len(pairs))
