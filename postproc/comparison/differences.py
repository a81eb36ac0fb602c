"""Other differences between two programs than the offsets of their targets."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import islice, takewhile

import numpy as np

from postproc import toolpath
from postproc.comparison.paths import PlacedProgram, nearest, tool_of_nominal
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
from postproc.comparison.settings import axis_targets, bases_and_tools, forces, settings
from postproc.errors import Level
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, angle_between, norm
from postproc.program import CIRC, PTP, Ints, Program

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
    found: Comparison, one: PlacedProgram, other: PlacedProgram, *, in_file: bool, same_origin: bool
) -> tuple[Difference, ...]:
    """Return the differences besides offsets.

    :param in_file: forces of the nominal program come from a file.
    :param same_origin: one conversion made the second program of the first, or both: only missing or additional targets
        and what the forces show are differences then.
    """
    if same_origin:
        return (*_not_compared(found), *_alone(found, one), *_under_forces(found, one))
    return (
        *_unresolved(found),
        *_not_compared(found),
        *_calls(found),
        *settings(found, one, other),
        *forces(found, other, in_file=in_file),
        *_rapid(found, one),
        *_twice(found, one, other),
        *_back(found),
        *_alone(found, one),
        *axis_targets(found, one, other),
        *_orientation(found, one, other),
        *_off_path(found, one, other),
        *_under_forces(found, one),
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
        far = missed[worst] > one.place.tolerance
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


def _next(found: Comparison, row: int) -> tuple[str, int] | None:
    """Return where the second program has the partner of the next target after a nominal motion."""
    behind = int(np.searchsorted(found.pair[:, 0], row))
    return place_of(found.corrected, found.pair[behind, 1]) if behind < len(found.pair) else None


def _orientation(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield targets, inserted ones too, at which the tool is turned by more than the tolerance over a part of it.

    The angle is that from the orientation which keeps the loaded tool nominal, or from the nominal orientation, which
    programs have that correct positions alone.
    """
    allowed = one.place.tolerance / LEVER
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
    mine = toolpath.at(one.program, one.path, motion, t).pose
    theirs = tool_of_nominal(one.program, motion, other.program, row, other.program.motions.target[row])
    around = np.maximum(found.rotation[behind - 1], found.rotation[behind])
    return row, angle_between(mine[:, :3, :3], theirs[:, :3, :3]) - around


def _rapid(found: Comparison, one: PlacedProgram) -> Iterator[Difference]:
    """Yield a difference if rapid targets have an offset: no force acts on them that would explain it."""
    off = found.distance if found.cuts is None else np.minimum(found.distance, norm(found.cuts.corrected))
    where = np.flatnonzero((off > one.place.tolerance) & found.rapid)
    if len(where) and not any(each.kind == "base" for each in bases_and_tools(found)):
        worst = where[np.argmax(off[where])]
        message = f"a rapid target is {off[worst] * MM_PER_M:.4f} mm off."
        yield at_rows(found, "rapid", message, found.pair[worst].tolist(), len(where))


def _twice(found: Comparison, one: PlacedProgram, other: PlacedProgram) -> Iterator[Difference]:
    """Yield targets of the second program at the present position of the robot: it stops there even if approximated."""
    still, also = (
        (side.path.travel < _NOTHING) & (side.path.turn < _NOTHING) & (side.program.motions.kind != PTP)
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
    """Return the largest distance of the second path from the nominal one on the way to a pair k > 0 [m].

    Less what its inserted targets are off: these are on the path.
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
    bad = np.flatnonzero((off > ends + one.place.tolerance + _BEYOND) & (cuts.t < 1.0) & ~np.isin(way, gap))
    if len(bad):
        worst = bad[np.argmax(off[bad])]
        row = int(cuts.row[worst])
        message = (
            f"under the forces given it leaves {off[worst] * MM_PER_M:.4f} mm to the nominal path before this target."
        )
        message += _advice(found, np.array([row]))
        yield at_rows(found, "between", message, (int(found.pair[way[worst], 0]), row), len(np.unique(cuts.row[bad])))


def _advice(found: Comparison, rows: Ints) -> str:
    """Return the advice for motions (n,) of the second program that leave the path: arcs have an auxiliary point."""
    return " Check the auxiliary point of its arc." if CIRC in found.corrected.motions.kind[rows] else ""
