"""What differs between two programs besides the offsets of their targets."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import islice, takewhile

import numpy as np

from postproc import toolpath
from postproc.comparison.entries import at_pairs, at_rows, here, of_line, place_of
from postproc.comparison.result import Comparison, Difference
from postproc.comparison.side import Side
from postproc.comparison.values import axis_targets, bases_and_tools, forces, values
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, angle_between, norm
from postproc.program import CIRC, PTP, Ints, Program

BESIDE = 3.0
"""How far from the path a target may stand to be one inserted on it, in offsets of its neighbours."""
OFF_PATH = 1e-4
"""The same where they have none [m]."""
_BEYOND = 5e-6
"""By how much more than the tolerance it must be off between targets, more than at them, to be told [m]."""
_NOTHING = 1e-9
"""A move [m, rad] that is none."""
_BACK = 1e-3
"""So far [m] a program does not go back on its path, but where it is wrong."""
LEVER = 0.1
"""Length of tool [m] along which the tolerance must hold where it is turned."""

_ENDS = re.compile(
    r"(?:S?(?:PTP|LIN|CIRC)(?:_REL)?|SPL)(?:\s*\{|\s+[\w$])|END(?:FOR|IF|LOOP|SWITCH|WHILE)?\b|UNTIL\b", re.IGNORECASE
)
"""A motion, or the end of a block: loops that are known are written out."""
_NO_STATEMENT = re.compile(r"\$|&|(?:GLOBAL\s+)?(?:DEF|DEFFCT|DECL|EXT|EXTFCT|INI|BAS)\b", re.IGNORECASE)


def differences(found: Comparison, one: Side, other: Side, *, in_file: bool) -> tuple[Difference, ...]:
    """Return what differs besides offsets.

    :param in_file: forces of the nominal program come from a file.
    """
    return (
        *_unresolved(found),
        *_open(found),
        *_calls(found),
        *values(found, one, other),
        *forces(found, other, in_file=in_file),
        *_rapid(found, one),
        *_twice(found, one, other),
        *_back(found, one),
        *_alone(found),
        *axis_targets(found, one, other),
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
    elif len(found.nominal.documents) == len(found.corrected.documents):
        yield from _fed(found)
    for k in range(max(map(len, both))):
        sides = [side[k] if k < len(side) else None for side in both]
        each = sides[0] or sides[1]
        assert each is not None
        message = f"not compared, because only the running robot knows it: {each.text!r} ({each.why})."
        places = [None if side is None else (side.file, side.line) for side in sides]
        yield Difference("warning", "not-compared", message, places[0], places[1], 1)


def _fed(found: Comparison) -> Iterator[Difference]:
    """Tell statements before motions that only the running robot knows that differ: what they go to, or whether.

    Those behind the motion, or the end of a block, before it are looked at; of divided programs none.
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
            message = "the statements before this motion differ: nobody can say where it leads, or whether it runs."
            yield Difference("error", "unresolved-differs", message, (one.file, one.line), (other.file, other.line), 1)


def _statements(lines: Sequence[str], line: int) -> Iterator[str]:
    """Yield the statements before a line, backwards, but for settings and declarations; empty for what ends them."""
    for number in range(line - 2, -1, -1):
        text = lines[number].partition(";")[0].strip()
        if _ENDS.match(text):
            yield ""
        elif text and not _NO_STATEMENT.match(text):
            yield _squeezed(text)


def _open(found: Comparison) -> Iterator[Difference]:
    """Tell the ways that are not compared, because it is not known where they begin."""
    after = found.nominal.after
    if after is None:
        return
    where = np.flatnonzero(after[found.pair[:, 0]] == found.pair[:, 0])
    if len(where):
        message = "the way to this target is not compared, because where it begins is not known."
        yield at_pairs(found, "not-compared", message, where)


def _calls(found: Comparison) -> Iterator[Difference]:
    """Tell calls of programs that are in no file, and that one of the two alone makes: nobody knows what they do."""
    calls = [
        {issue.subject: issue for issue in program.issues if issue.kind == "external-call"}
        for program in (found.nominal, found.corrected)
    ]
    for name in sorted(calls[0].keys() ^ calls[1].keys()):
        side = int(name in calls[1])
        program = (found.nominal, found.corrected)[side]
        place = of_line(program, calls[side][name].source_line)
        message = f"{name}(), which is in no file, is called by this program alone: what it does is not compared."
        if _is_called(name, (found.nominal, found.corrected)[1 - side]):
            message = (
                f"the file of {name}() is beside the other program, and not beside this one: what it sets is not known "
                "here. Copy it there."
            )
        yield here("not-compared", message, *((None, place) if side else (place, None)))


def _is_called(name: str, program: Program) -> bool:
    """Return whether a program calls a routine, comments left aside."""
    call = re.compile(rf"^[^;\r\n]*\b{re.escape(name)}[ \t]*\(", re.IGNORECASE | re.MULTILINE)
    return any(call.search(document.text) for document in program.documents)


def _squeezed(text: str) -> str:
    return "".join(text.split()).upper()


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


def _orientation(found: Comparison, one: Side, other: Side) -> Iterator[Difference]:
    """Tell where the tool is turned by more than the tolerance on a part of its length, also at inserted targets.

    That is from where it should be told to stand under the forces, or from its nominal orientation, which programs have
    that correct positions alone.
    """
    allowed = one.place.tolerance / LEVER
    turned = found.rotation if found.cuts is None else np.minimum(found.rotation, found.cuts.turned)
    if found.cuts is None and any(each.kind == "base" for each in bases_and_tools(found)):
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
    yield at_rows(found, "orientation", message, rows, len(where) + len(beside))


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
    if len(where) and not any(each.kind == "base" for each in bases_and_tools(found)):
        worst = where[np.argmax(off[where])]
        message = f"a rapid target is {off[worst] * MM_PER_M:.4f} mm off."
        yield at_rows(found, "rapid", message, found.pair[worst].tolist(), len(where))


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
        yield at_rows(found, "twice", message, (-1, int(where[0])), len(where))


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
        yield at_rows(found, "back", message, (-1, int(cuts.row[ends[back[0]]])), len(back))


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
        yield at_rows(found, "between", message + _look(found, rows), found.pair[worst].tolist(), len(bad))
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
        yield at_rows(found, "between", message, (int(found.pair[pair[worst], 0]), row), count)


def _look(found: Comparison, rows: Ints) -> str:
    arc = CIRC in found.corrected.motions.kind[rows]
    return " Look at the auxiliary point of its arc." if arc else ""
