"""Motions left uncorrected: their target, or whether they run, is not known before run time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.positions import CARTESIAN
from postproc.dialects.krl.language.tree import Motion, Statement
from postproc.dialects.krl.language.values import Aggregate, Reference, walk
from postproc.dialects.krl.read.main_routine import MainRoutine
from postproc.dialects.krl.read.motion_reader import HERE
from postproc.dialects.krl.read.motions import OrderedMotions
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.state import fields_used
from postproc.errors import Issue, ProgramError
from postproc.program import CIRC, PTP, SPL, Ints, Unresolved

_BEGIN = "where it begins is not known, and its path depends on that"
_SHIFTED = ". It starts from the current robot position: the correction of the motion before it moves it too"
_OPEN = (
    "Where this motion begins is not known, because the one before stays as it is: its end is corrected, no targets "
    "are inserted into it, and its path is not checked."
)


class Separated(Struct, frozen=True, eq=False):
    """The motions of a program, separated by whether they can be corrected.

    :param ordered: those that can.
    :param after: the motion at whose end each of them begins, see `Program.after`.
    :param unresolved: the others.
    :param issues: warnings for the user.
    """

    ordered: OrderedMotions
    after: Ints | None = None
    unresolved: tuple[Unresolved, ...] = ()
    issues: tuple[Issue, ...] = ()


def without_unresolved(main: MainRoutine, ordered: OrderedMotions) -> Separated:
    """Take out the motions that stay as they are, where that is wanted.

    :param ordered: motions whose targets are known.
    :raises ProgramError: there are none that can be corrected.
    """
    run, rows = main.run, ordered.rows
    if not run.keep:
        return Separated(ordered)
    lost = dict(run.unresolved)
    dropped = np.zeros(len(rows), dtype=np.bool_)
    for row, reason in _uncertain(run.settings, ordered):
        lost[int(rows.line[row])] = reason
        dropped[row] = True
    if not lost and not run.moved:
        return Separated(ordered)
    open_: set[int] = set()
    for line in sorted({*lost, *(call.line for call in run.moved)}):
        row = int(np.searchsorted(rows.line, line, side="right"))
        while row < len(rows) and (dropped[row] or needs_start(ordered, row)):
            if not dropped[row]:
                lost[int(rows.line[row])] = main.run.source.line_error(_BEGIN, int(rows.line[row]))
            dropped[row] = True
            row += 1
        open_.add(row)
    if dropped.all():
        raise min(lost.items())[1]
    for row in np.flatnonzero(dropped).tolist():
        if row in ordered.moves:
            move = ordered.moves[row]
            run.understood -= {move.end.start, *([move.via.start] if move.via else [])}
    new = np.cumsum(~dropped) - 1
    after = np.arange(int((~dropped).sum())) - 1
    begins = [int(new[row]) for row in sorted(open_) if row < len(rows)]
    after[begins] = begins
    moves = {int(new[row]): move for row, move in ordered.moves.items() if not dropped[row]}
    left = OrderedMotions(
        rows.take(~dropped), ordered.states, ordered.state[~dropped], ordered.numbers[~dropped], moves
    )
    unresolved, issues = _reported(main, lost)
    return Separated(left, after, unresolved, (*issues, *_opened(main, left, begins)))


def _uncertain(settings: Settings, ordered: OrderedMotions) -> Iterator[tuple[int, ProgramError]]:
    """Yield the motions that depend on frames, speeds or modes that are not known."""
    for index, used in enumerate(ordered.states):
        if not used.uncertain and used.base >= 0 and used.tool >= 0:
            continue
        for row in np.flatnonzero(ordered.state == index).tolist():
            axis = row in ordered.moves and ordered.moves[row].end.position.axis
            approximated = bool(ordered.rows.approximated[row])
            try:
                fields = fields_used(int(ordered.rows.kind[row]), axis=axis, approximated=approximated)
                settings.refuse_uncertain(used, fields)
            except ProgramError as cause:
                yield row, cause


def needs_start(ordered: OrderedMotions, row: int, *, arcs: bool = True) -> bool:
    """Return whether the target of a motion, or the shape of an arc, depends on where it begins."""
    move = ordered.moves.get(row)
    if ordered.rows.kind[row] != PTP and ordered.states[ordered.state[row]].orientation == "#CONSTANT":
        return True
    if move is not None and (move.via_incomplete or move.angle is not None):
        return True
    kind = ordered.rows.kind[row]
    if (arcs and kind == CIRC) or kind == SPL or (move is not None and bool(move.relative)):
        return True
    if move is not None:
        return not move.end.position.complete
    return bool(np.isnan(ordered.rows.numbers[row, :6]).any())


def _reported(main: MainRoutine, lost: dict[int, ProgramError]) -> tuple[tuple[Unresolved, ...], list[Issue]]:
    """Return each uncorrected line, and a warning for it."""
    found: dict[str, Unresolved] = {}
    issues = []
    for line, reason in sorted(lost.items()):
        origin = main.run.source.origin(line)
        if str(origin) in found:
            continue
        shown: int | None = int(main.run.source.shown(np.array([line]))[0])
        text = origin.source.text[slice(*origin.source.code_span(origin.line))]
        found[str(origin)] = Unresolved(origin.source.document.name, origin.line, text, reason.problem)
        shifted = _SHIFTED if _depends(statement(*origin)) else ""
        elsewhere = origin.source is not main.run.routine.source
        where, shown = (f"{origin}: ", None) if elsewhere else ("", shown)
        message = f"{where}stays as it is, uncorrected: {text!r} ({reason.problem}){shifted}"
        issues.append(Issue("warning", "unresolved", message, shown, subject=str(origin)))
    return tuple(found.values()), issues


def _depends(here: Statement) -> bool:
    """Return whether the target of an uncorrected motion depends on the current robot position."""
    if not isinstance(here, Motion):
        return False
    given = here.end.items.keys() & CARTESIAN if isinstance(here.end, Aggregate) else ()
    from_here = any(isinstance(value, Reference) and value.name in HERE for value in walk(here.values))
    return from_here or here.word.endswith("_REL") or 0 < len(given) < len(CARTESIAN)


def _opened(main: MainRoutine, ordered: OrderedMotions, begins: list[int]) -> Iterator[Issue]:
    source = main.run.source
    origins = {line: source.origin(line) for line in ordered.rows.line[begins].tolist()}
    own = [line for line, origin in origins.items() if origin.source is main.run.routine.source]
    for name in {str(origin): None for line, origin in origins.items() if line not in own}:
        yield Issue("warning", "start-unknown", f"{name}: {_OPEN}", subject=name)
    if own:
        lines = np.unique(source.shown(np.array(own))).tolist()
        begins = own
        yield Issue("warning", "start-unknown", _OPEN, lines[0], count=len(begins), lines=tuple(lines))
