"""Other differences between two programs than the offsets of their targets.

Statements between motions, and settings of motions: speed, kind, approximation, axes, status and turn, frames,
orientation, forces.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import islice, takewhile

import numpy as np

from postproc import toolpath
from postproc.comparison.paths import SAME_FRAME, PlacedProgram, nearest, tool_of_nominal
from postproc.comparison.result import (
    OFF_PATH,
    TIMES_OFFSET,
    Comparison,
    Difference,
    at_pairs,
    at_rows,
    of_line,
    place_of,
)
from postproc.comparison.statements import statement_differences
from postproc.correction.targets import corners_of_motions
from postproc.errors import Issue, Level
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, angle_between, norm, twist_between
from postproc.program import CIRC, FORCE_FRAMES, LIN, PTP, SPL, Ints, Program

_BEYOND = 5e-6
"""A deviation between targets is reported if it exceeds those at the targets by the tolerance and this [m]."""
_NOTHING = 1e-9
"""A move [m, rad] that is none."""
_BACK = 1e-3
"""A correction moves a target back along the path by less than this [m]."""
LEVER = 0.1
"""Length of tool [m] over which the tolerance must hold when the tool is turned."""

_ENDS = re.compile(
    r"(?:S?(?:PTP|LIN|CIRC)(?:_REL)?|SPL)(?:\s*\{|\s+[\w$])|END(?:FOR|IF|LOOP|SWITCH|WHILE)?\b|UNTIL\b", re.IGNORECASE
)
"""A motion, or the end of a block: loops that are known are written out."""
_NO_STATEMENT = re.compile(r"\$|&|(?:GLOBAL\s+)?(?:DEF|DEFFCT|DECL|EXT|EXTFCT|INI|BAS)\b", re.IGNORECASE)


def differences(
    found: Comparison,
    one: PlacedProgram,
    other: PlacedProgram,
    *,
    in_file: bool,
    same_origin: bool,
    pairs_are_known: bool,
) -> tuple[Difference, ...]:
    """Return the differences besides offsets.

    :param in_file: forces of the nominal program come from a file.
    :param same_origin: one conversion made the second program of the first, or both: only missing or additional targets
        and what the forces show are differences then.
    :param pairs_are_known: pairs are the targets that the loaded tip comes to, or those that the conversion states.
    """
    uncertain = () if pairs_are_known else tuple(_ambiguous(found, one, other))
    if same_origin:
        return (*_not_compared(found), *_alone(found, one), *_under_forces(found, one), *uncertain)
    between = (*_off_path(found, one, other), *_under_forces(found, one))
    return (
        *_unresolved(found),
        *_not_compared(found),
        *_calls(found),
        *settings(found, one, other),
        *statement_differences(found),
        *forces(found, other, in_file=in_file),
        *_rapid(found, one),
        *_twice(found, one, other),
        *_back(found),
        *_alone(found, one),
        *axis_targets(found, one, other),
        *_orientation(found, one, other),
        *(between or _cut_corners(found, one, other)),
        *uncertain,
    )


def _unresolved(found: Comparison) -> Iterator[Difference]:
    """Yield motions known at run time only that differ in their text, or in the statements before them."""
    both = [program.unresolved for program in (found.nominal, found.corrected)]
    texts = [[_squeezed(each.text) for each in side] for side in both]
    if texts[0] != texts[1]:
        first = next(
            (k for k, pair in enumerate(zip(*texts, strict=False)) if pair[0] != pair[1]), min(map(len, texts))
        )
        places = [(side[first].file, side[first].line) if first < len(side) else None for side in both]
        message = "motions that are known at run time only differ: it is unknown where they lead."
        count = abs(len(both[0]) - len(both[1])) or 1
        yield Difference("error", "unresolved-differs", message, places[0], places[1], count)
    elif len(found.nominal.documents) == len(found.corrected.documents):
        yield from _statements_differ(found)


def _statements_differ(found: Comparison) -> Iterator[Difference]:
    """Yield motions known at run time only if the statements that decide on them differ; not of divided programs.

    Those are the statements back to the motion, or the end of a block, before it.
    """
    both = (found.nominal, found.corrected)
    if not all(program.keeps_text for program in both):
        return
    texts = [{each.name: each.text.splitlines() for each in program.documents} for program in both]
    for one, other in zip(found.nominal.unresolved, found.corrected.unresolved, strict=True):
        if one.file not in texts[0] or other.file not in texts[1]:
            continue
        mine = list(takewhile(bool, _statements(texts[0][one.file], one.line)))
        theirs = list(islice(filter(None, _statements(texts[1][other.file], other.line)), len(mine)))
        if theirs != mine:
            message = "the statements before this motion differ: it is unknown where it leads, or whether it runs."
            yield Difference("error", "unresolved-differs", message, (one.file, one.line), (other.file, other.line), 1)


def _statements(lines: Sequence[str], line: int) -> Iterator[str]:
    """Yield the statements before a line, backwards, except settings and declarations; empty for `_ENDS`."""
    for number in range(line - 2, -1, -1):
        text = lines[number].partition(";")[0].strip()
        if _ENDS.match(text):
            yield ""
        elif text and not _NO_STATEMENT.match(text):
            yield _squeezed(text)


def _squeezed(text: str) -> str:
    return "".join(text.split()).upper()


def _not_compared(found: Comparison) -> Iterator[Difference]:
    """Yield motions that are known at run time only, and those that begin at an unknown place."""
    both = [program.unresolved for program in (found.nominal, found.corrected)]
    for k in range(max(map(len, both))):
        sides = [side[k] if k < len(side) else None for side in both]
        each = sides[0] or sides[1]
        assert each is not None
        message = f"not compared, because it is known at run time only: {each.text!r} ({each.why})."
        places = [None if side is None else (side.file, side.line) for side in sides]
        yield Difference("warning", "not-compared", message, places[0], places[1], 1)
    after = found.nominal.after
    if after is None:
        return
    where = np.flatnonzero(after[found.pair[:, 0]] == found.pair[:, 0])
    if len(where):
        message = "the way to this target is not compared, because it is unknown where it begins."
        yield at_pairs(found, "not-compared", message, where)


def _calls(found: Comparison) -> Iterator[Difference]:
    """Yield calls of programs that are in no file and that only one of the two makes."""
    calls = [
        {issue.subject: issue for issue in program.issues if issue.kind == "external-call"}
        for program in (found.nominal, found.corrected)
    ]
    for name in sorted(calls[0].keys() ^ calls[1].keys()):
        side = int(name in calls[1])
        program = (found.nominal, found.corrected)[side]
        place = of_line(program, calls[side][name].source_line)
        message = f"{name}(), which is in no file, is called by this program only: its effect is not compared."
        if _is_called(name, (found.nominal, found.corrected)[1 - side]):
            message = (
                f"the file of {name}() is in the folder of the other program only: its effect is unknown here. Copy "
                "the file to this folder."
            )
        yield Difference("warning", "not-compared", message, *((None, place) if side else (place, None)))


def _is_called(name: str, program: Program) -> bool:
    """Return whether a program calls a routine, comments left aside."""
    call = re.compile(rf"^[^;\r\n]*\b{re.escape(name)}[ \t]*\(", re.IGNORECASE | re.MULTILINE)
    return any(call.search(document.text) for document in program.documents)


def _alone(found: Comparison, one: PlacedProgram) -> Iterator[Difference]:
    """Yield missing and additional targets; a missing one that the second path leaves out is an error."""
    rows, missed = found.only_nominal, np.nan_to_num(found.missed)
    if len(rows):
        worst = int(np.argmax(missed))
        far = missed[worst] > one.robot_in_cell.tolerance
        message = "a target of the nominal program is missing."
        if far:
            message = (
                "a target of the nominal program is missing: the corrected path leaves the nominal one by "
                f"{missed[worst] * MM_PER_M:.4f} mm there."
            )
        place = place_of(found.nominal, rows[worst])
        level: Level = "error" if far else "warning"
        yield Difference(level, "only-nominal", message, place, _next(found, rows[worst]), len(rows))
    rows = found.only_corrected
    if len(rows):
        message = "an additional target, not on the nominal path."
        yield Difference("warning", "only-corrected", message, None, place_of(found.corrected, rows[0]), len(rows))


def _ambiguous(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield pairs whose nominal target may as well belong to a target inserted next to its partner.

    Without forces of the nominal program the correction is unknown. Since pairs may be wrong ones, so may their largest
    offset: a target is possible within twice that.
    """
    if not len(found.pair) or not len(found.inserted):
        return
    index = np.searchsorted(other.rows, found.pair[:, 1])
    mine = one.track().position[np.searchsorted(one.rows, found.pair[:, 0])]
    theirs = other.track().position
    allowed = OFF_PATH + 2.0 * float(found.distance.max())
    uncertain = np.zeros(len(index))
    for step in (-1, 1):
        near = np.clip(index + step, 0, len(other.rows) - 1)
        possible = np.isin(other.rows[near], found.inserted) & (norm(theirs[near] - mine) <= allowed)
        uncertain = np.where(possible, np.maximum(uncertain, norm(theirs[near] - theirs[index])), uncertain)
    where = np.flatnonzero(uncertain)
    if len(where):
        message = (
            "this target may belong to one that was inserted next to its partner: offsets of such pairs are known to "
            f"{uncertain.max() * MM_PER_M:.2f} mm only. Give the forces with --forces."
        )
        yield at_pairs(found, "pairing", message, where)


def _next(found: Comparison, row: int) -> tuple[str, int] | None:
    """Return where the second program has the partner of the next target after a nominal motion."""
    behind = int(np.searchsorted(found.pair[:, 0], row))
    return place_of(found.corrected, found.pair[behind, 1]) if behind < len(found.pair) else None


def _orientation(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield targets, inserted ones too, at which the tool is turned by more than the tolerance over a part of it.

    The angle is that from the orientation which keeps the loaded tool nominal, or from the nominal orientation, which
    programs have that correct positions alone.
    """
    allowed = one.robot_in_cell.tolerance / LEVER
    turned = found.rotation if found.cuts is None else np.minimum(found.rotation, found.cuts.turned)
    if found.cuts is None and any(each.kind == "base" for each in bases_and_tools(found)):
        return
    where = np.flatnonzero(turned > allowed)
    inserted, off = _inserted_turned(found, one, other)
    more = np.flatnonzero(off > allowed)
    if not len(where) and not len(more):
        return
    rows, angle = ([-1, -1], 0.0)
    if len(more):
        worst = more[np.argmax(off[more])]
        rows, angle = [-1, int(inserted[worst])], float(off[worst])
    if len(where) and turned[where].max() > angle:
        worst = where[np.argmax(turned[where])]
        rows, angle = found.pair[worst].tolist(), float(turned[worst])
    message = f"the tool is turned by {angle * DEG_PER_RAD:.4f}° from its nominal orientation."
    yield at_rows(found, "orientation", message, rows, len(where) + len(more))


def _inserted_turned(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> tuple[Ints, Array]:
    """Return inserted targets (n,) and the angles by which they turn the tool from the nominal path there (n,) [rad].

    Without forces, at the same share of the way, and less the rotations of the pairs next to it.
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
    mine = toolpath.at(one.program, one.segments, motion, t).pose
    theirs = tool_of_nominal(one.program, motion, other.program, row, other.program.motions.target[row])
    around = np.maximum(found.rotation[behind - 1], found.rotation[behind])
    return row, angle_between(mine[:, :3, :3], theirs[:, :3, :3]) - around


def _rapid(found: Comparison, one: PlacedProgram) -> Iterator[Difference]:
    """Yield a difference if rapid targets have an offset: no force acts on them that would explain it."""
    off = found.distance if found.cuts is None else np.minimum(found.distance, norm(found.cuts.corrected))
    where = np.flatnonzero((off > one.robot_in_cell.tolerance) & found.rapid)
    if len(where) and not any(each.kind == "base" for each in bases_and_tools(found)):
        worst = where[np.argmax(off[where])]
        message = f"a rapid target is {off[worst] * MM_PER_M:.4f} mm off."
        yield at_rows(found, "rapid", message, found.pair[worst].tolist(), len(where))


def _twice(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield targets of the second program at the present position of the robot: it stops there even if approximated."""
    still, also = (
        (side.segments.travel < _NOTHING) & (side.segments.turn < _NOTHING) & (side.program.motions.kind != PTP)
        for side in (other, one)
    )
    still[found.pair[also[found.pair[:, 0]], 1]] = False
    where = np.flatnonzero(still)
    if len(where):
        message = "the same target twice in succession: the robot stops there."
        yield at_rows(found, "twice", message, (-1, int(where[0])), len(where))


def _back(found: Comparison) -> Iterator[Difference]:
    """Yield inserted targets before which the robot moves back along its path."""
    cuts = found.cuts
    if cuts is None:
        return
    ends = np.flatnonzero(cuts.t == 1.0)
    way = np.searchsorted(found.pair[:, 1], cuts.row[ends])
    along = cuts.length[ends]
    back = np.flatnonzero((np.diff(along) < -_BACK) & (np.diff(way) == 0)) + 1
    if len(back):
        message = f"the robot goes {(along[back[0] - 1] - along[back[0]]) * MM_PER_M:.4f} mm back on its path."
        yield at_rows(found, "back", message, (-1, int(cuts.row[ends[back[0]]])), len(back))


def _off_path(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield ways between pairs on which the second path is farther from the nominal one than its targets are.

    An arc with a wrong auxiliary point is such a way: its targets are right. `_under_forces` reports the ways that are
    checked under forces.
    """
    if found.curves is None:
        return
    allowed = OFF_PATH + TIMES_OFFSET * np.maximum(found.distance, np.roll(found.distance, 1))
    far = np.nan_to_num(found.between) > allowed
    far[_checked(found)] = False
    far[np.searchsorted(found.pair[:, 0], found.only_nominal[found.only_nominal < found.pair[-1, 0]])] = False
    bad = np.flatnonzero(far)
    if not len(bad):
        return
    off = np.array([_distance_of_way(found, one, other, int(k)) for k in bad[:_MOST]])
    bad, off = bad[: len(off)][off > allowed[bad[: len(off)]]], off[off > allowed[bad[: len(off)]]]
    if len(bad):
        worst = int(np.argmax(off))
        message = f"the path is {off[worst] * MM_PER_M:.4f} mm from the nominal one on the way to this target."
        first, last = found.pair[bad[worst] - 1, 1], found.pair[bad[worst], 1]
        message += _advice(found, np.arange(first + 1, last + 1))
        yield at_rows(found, "between", message, found.pair[bad[worst]].tolist(), len(bad))


_MOST = 1000
"""Ways whose distance from the nominal path is computed."""
_PLACES = 65
"""Places of the second path looked at on each of them."""


def _checked(found: Comparison) -> Ints:
    """Return the pairs (n,) on the way to which the second path is checked under forces."""
    cuts = found.cuts
    if cuts is None or not len(cuts.row):
        return np.zeros(0, dtype=np.int64)
    return np.unique(np.searchsorted(found.pair[:, 1], cuts.row[cuts.t < 1.0]))


def _distance_of_way(found: Comparison, one: PlacedProgram, other: PlacedProgram, k: int) -> float:
    """Return the largest distance [m] of the second path from the nominal one, between pair k − 1 and pair k > 0.

    0 unless it clearly exceeds the distance of the inserted targets: corrections move those off the nominal path.
    """
    assert found.curves is not None
    u = k - 1.0 + np.linspace(1e-9, 1.0, _PLACES)
    chain = found.curves.other
    inserted = found.inserted[(found.inserted > found.pair[k - 1, 1]) & (found.inserted < found.pair[k, 1])]
    u = np.append(u, chain.end[inserted - chain.row[0]])
    spots = found.curves.second_in_cell(u)
    limits = (np.full(len(u), one.along[found.pair[n, 0] + 1]) for n in (k - 1, k))
    off = nearest(lambda at: one.points(at.ravel()).reshape(*at.shape, 3), spots, *limits)[1]
    most = float(off[_PLACES:].max(initial=0.0))
    largest = float(off.max())
    return largest if largest > OFF_PATH + TIMES_OFFSET * most else 0.0


def _under_forces(found: Comparison, one: PlacedProgram) -> Iterator[Difference]:
    """Yield places between targets where the loaded tip is farther from the nominal path than at the targets."""
    cuts = found.cuts
    if cuts is None:
        return
    at_end = np.zeros(len(found.corrected.motions))
    at_end[found.pair[:, 1]] = norm(cuts.corrected)
    at_end[cuts.row[cuts.t == 1.0]] = cuts.between_corrected[cuts.t == 1.0]
    ends = np.maximum(at_end[cuts.row], at_end[cuts.row - 1])
    way = np.searchsorted(found.pair[:, 1], cuts.row)
    gap = np.searchsorted(found.pair[:, 0], found.only_nominal)  # missing targets have a difference of their own
    off = cuts.between_corrected
    bad = np.flatnonzero((off > ends + one.robot_in_cell.tolerance + _BEYOND) & (cuts.t < 1.0) & ~np.isin(way, gap))
    if len(bad):
        worst = bad[np.argmax(off[bad])]
        row = int(cuts.row[worst])
        message = (
            f"under the forces given it leaves {off[worst] * MM_PER_M:.4f} mm to the nominal path before this target."
        )
        message += _advice(found, np.array([row]))
        yield at_rows(found, "between", message, (int(found.pair[way[worst], 0]), row), len(np.unique(cuts.row[bad])))


def _cut_corners(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield targets at which approximation (C_DIS) rounds the second path by more than the first program allows.

    A program of G-code allows what G64 or the cell states, and nothing at exact stops; one of KRL its own rounding,
    where its approximation distance is the same: other ones are a difference of their own. Nothing is allowed at
    targets that it does not have.
    """
    m, rows = found.nominal.motions, np.union1d(found.pair[:, 1], found.inserted)
    if not len(rows):
        return
    rounding = corners_of_motions(other.program, other.segments, rows).rounding(found.corrected.motions.blend[rows])
    if found.nominal.keeps_text:
        motion = np.arange(len(m))
        as_programmed = corners_of_motions(one.program, one.segments, motion).rounding(m.blend)
    else:
        as_programmed = np.where(m.blend > 0.0, m.rounding, 0.0)
    allowed, place = np.zeros(len(rows)), np.searchsorted(rows, found.pair[:, 1])
    allowed[place] = as_programmed[found.pair[:, 0]]
    if found.nominal.keeps_text:
        changed = np.abs(found.corrected.motions.blend[found.pair[:, 1]] - m.blend[found.pair[:, 0]]) > _SAME_LENGTH
        allowed[place[changed]] = np.inf
    excess = rounding - allowed
    bad = np.flatnonzero(excess > one.robot_in_cell.tolerance + _BEYOND)
    if len(bad):
        worst = bad[np.argmax(excess[bad])]
        way = min(int(np.searchsorted(found.pair[:, 1], rows[worst])), len(found.pair) - 1)
        remedy = (
            "Set $APO.CDIS and C_DIS back, or convert again."
            if allowed[worst] > 0.0 or not found.nominal.keeps_text
            else "Use a smaller approximation distance there."
        )
        message = (
            f"approximation (C_DIS) cuts the corner by {rounding[worst] * MM_PER_M:.4f} mm; the nominal program allows "
            f"{allowed[worst] * MM_PER_M:.4g} mm. {remedy}"
        )
        yield at_rows(found, "between", message, (int(found.pair[way, 0]), int(rows[worst])), len(bad))


def _advice(found: Comparison, rows: Ints) -> str:
    """Return the advice for motions (n,) of the second program that leave the path: arcs have an auxiliary point."""
    return " Check the auxiliary point of its arc." if CIRC in found.corrected.motions.kind[rows] else ""


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
    # between a pair and the next one the nominal program may have Cartesian targets without partner
    before = np.append(-1, found.pair[:, 0])[np.searchsorted(found.pair[:, 1], rows[where])]
    kinds = np.where(np.isnan(found.nominal.motions.joints[:, 0]), found.nominal.motions.kind, -1)
    same = [now[k] in kinds[b + 1 : motion[k]] for k, b in zip(where, before, strict=True)]
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
