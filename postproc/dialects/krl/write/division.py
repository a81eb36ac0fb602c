"""Where a program may be cut into files.

A cut never falls into a fold, a control structure or a spline, between a TRIGGER and its motion, or behind CONTINUE.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.names import OPENING, SPLINES
from postproc.dialects.krl.language.parser import statement
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import fold_at
from postproc.dialects.krl.language.tree import (
    Cyclic,
    Declaration,
    Event,
    Goto,
    Imported,
    Label,
    Motion,
    Outside,
    Return,
    Spline,
    Statement,
    Trigger,
)
from postproc.errors import Issue, ProgramError
from postproc.program import Ints

ADVICE = "Set lines_per_file = 0 in [output] of the cell to have it in one file."
_CLOSING = frozenset({*OPENING.values(), "UNTIL", "ENDSPLINE"})
_OPENING = frozenset({*OPENING, "REPEAT", *SPLINES})


def undivided(source: Source, problem: str, line: int, advice: str = ADVICE) -> ProgramError:
    """Return the error for a program that cannot be divided."""
    return source.line_error(f"the program cannot be divided into files: {problem}", line, advice)


class CutPoints(Struct, frozen=True, eq=False):
    """Where the main routine of a program may be cut.

    :param begin: line of its DEF.
    :param end: line of its END.
    :param cuts: lines (n,) before which it may be cut, ascending.
    :param first: line of its first motion; where it has none of its own, of its first call behind all INTERRUPTs.
    :param declarations: lines that declare.
    """

    begin: int
    end: int
    cuts: Ints
    first: int
    declarations: list[int]


def places(source: Source, main: Routine) -> CutPoints:
    """Look at all lines of the main routine.

    :raises ProgramError: a statement means something else in a file of its own; there is no motion.
    """
    text = source.text
    first = called = depth = 0
    cuts: list[int] = []
    declarations: list[int] = []
    held = False  # a TRIGGER waits for its motion, or CONTINUE for its statement
    for line in range(main.first + 1, main.last + 1):
        fold = fold_at(text, int(source.starts[line - 1]), int(source.stops[line - 1]))
        if depth == 0 and not held and fold != "ENDFOLD":
            cuts.append(line)
        if fold:
            depth = max(depth - 1, 0) if fold == "ENDFOLD" else depth + 1
            continue
        here = statement(source, line)
        if here.start == here.stop or line == main.last:
            continue
        _check(source, line, here, first)
        depth = max(0, depth + (here.word in _OPENING) - (here.word in _CLOSING))
        if isinstance(here, Motion | Spline):
            first, held = first or line, False
        elif isinstance(here, Trigger) or here.word == "CONTINUE":
            held = True
        elif isinstance(here, Declaration | Outside | Imported) or (isinstance(here, Cyclic) and here.word == "SIGNAL"):
            declarations.append(line)
        elif isinstance(here, Event) and not here.public:
            called = 0
        elif not called and here.word != "BAS" and calls(here.values):
            called = line
    first = first or called
    if not first:
        raise undivided(source, "it has no DEF, END or motion", main.first)
    return CutPoints(main.first, main.last, np.array(cuts, dtype=np.int64), first, declarations)


def _check(source: Source, line: int, here: Statement, first: int) -> None:
    """Refuse statements that mean something else in a file of their own."""
    if isinstance(here, Return | Goto | Label):
        raise undivided(source, f"{here.word} leads to another place of it", line)
    if first and isinstance(here, Event) and here.declares and not here.public:
        problem = "an interrupt that is not GLOBAL is declared behind the first motion"
        raise undivided(source, problem, line, f"Declare it before the first motion, or: {ADVICE}")


def bounds(source: Source, base: str, where: CutPoints, limit: int, overhead: int) -> tuple[list[int], list[Issue]]:
    """Return the first line of each part, and END; and warnings.

    :param base: what the names of the files begin with.
    :param limit: lines of a file at most, of which `overhead` are not those of the program.
    :raises ProgramError: it cannot be cut.
    """
    issues: list[Issue] = []
    room = limit - overhead
    if room < 1:
        raise undivided(source, f"{limit} lines are not enough for one motion", where.begin)
    before = where.cuts[where.cuts <= where.first]
    if not len(before):
        raise undivided(source, "its first motion is in a fold or control structure", where.first)
    found = [int(before[-1])]
    late = [line for line in where.declarations if line > found[0]]
    if late:
        raise undivided(source, "a declaration follows the first motion", late[0])
    while where.end - found[-1] > room:
        later = where.cuts[where.cuts > found[-1]]
        fitting = later[later <= found[-1] + room]
        cut = int(fitting[-1]) if len(fitting) else int(later[0]) if len(later) else where.end
        if not len(fitting):
            message = (
                f"{base}{len(found)}.src has more than {limit} lines: lines {found[-1]} to "
                f"{cut - 1} are a fold, a control structure, a spline or a TRIGGER, which are not cut."
            )
            issues.append(Issue("warning", "long-file", message))
        if cut == where.end:
            break
        found.append(cut)
    return [*found, where.end], issues
