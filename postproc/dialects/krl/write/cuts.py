"""Where a program may be cut into files.

A cut never falls into a fold, a control structure or a spline, between a TRIGGER and its motion, or behind CONTINUE.
"""

from __future__ import annotations

import re

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.names import DECLARING, OPENING
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.statements import MOTION_WORDS, SPLINES, calls, declares, word_at
from postproc.errors import Issue, ProgramError
from postproc.program import Ints

ADVICE = "Set lines_per_file = 0 in [output] of the cell to have it in one file."
_FOLD = re.compile(r"[ \t]*;[ \t]*(END)?FOLD\b", re.IGNORECASE)
_LABEL = re.compile(r"[A-Za-z_]\w*[ \t]*:$", re.ASCII)
_LOCAL_INTERRUPT = re.compile(r"INTERRUPT[ \t]+DECL\b", re.IGNORECASE)
_CLOSING = frozenset({*OPENING.values(), "UNTIL", "ENDSPLINE"})
_OPENING = frozenset({*OPENING, "REPEAT", *SPLINES})


def undivided(source: Source, problem: str, line: int, advice: str = ADVICE) -> ProgramError:
    """Return the error for a program that cannot be divided."""
    return source.line_error(f"the program cannot be divided into files: {problem}", line, advice)


class Places(Struct, frozen=True, eq=False):
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


def places(source: Source, main: Routine) -> Places:
    """Look at all lines of the main routine.

    :raises ProgramError: a statement means something else in a file of its own; there is no motion.
    """
    text = source.text
    first = called = depth = 0
    cuts: list[int] = []
    declarations: list[int] = []
    held = False  # a TRIGGER waits for its motion, or CONTINUE for its statement
    for line in range(main.first + 1, main.last + 1):
        start, stop = int(source.starts[line - 1]), int(source.stops[line - 1])
        fold = _FOLD.match(text, start, stop)
        if depth == 0 and not held and not (fold and fold[1]):
            cuts.append(line)
        if fold:
            depth = max(depth - 1, 0) if fold[1] else depth + 1
            continue
        start, stop = source.code_span(line)
        if start == stop or line == main.last:
            continue
        word = word_at(text, start, stop)
        _check(source, line, word, text[start:stop], first)
        depth = max(0, depth + (word in _OPENING) - (word in _CLOSING))
        if word in MOTION_WORDS or word in SPLINES:
            first, held = first or line, False
        elif word in ("TRIGGER", "CONTINUE"):
            held = True
        elif declares(text, start, stop) or word in DECLARING:
            declarations.append(line)
        elif word == "INTERRUPT":
            called = 0
        elif not called and word != "BAS" and calls(source, start, stop):
            called = line
    first = first or called
    if not first:
        raise undivided(source, "it has no DEF, END or motion", main.first)
    return Places(main.first, main.last, np.array(cuts, dtype=np.int64), first, declarations)


def _check(source: Source, line: int, word: str, code: str, first: int) -> None:
    """Refuse statements that mean something else in a file of their own."""
    if word in ("RETURN", "GOTO") or _LABEL.match(code):
        raise undivided(source, f"{word or code} leads to another place of it", line)
    if first and _LOCAL_INTERRUPT.match(code):
        problem = "an interrupt that is not GLOBAL is declared behind the first motion"
        raise undivided(source, problem, line, f"Declare it before the first motion, or: {ADVICE}")


def bounds(source: Source, base: str, where: Places, limit: int, overhead: int) -> tuple[list[int], list[Issue]]:
    """Return the first line of each part, and END; and what is to be told.

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
        raise undivided(source, "its first motion stands in a fold or control structure", where.first)
    found = [int(before[-1])]
    late = [line for line in where.declarations if line > found[0]]
    if late:
        raise undivided(source, "a declaration stands behind the first motion", late[0])
    while where.end - found[-1] > room:
        later = where.cuts[where.cuts > found[-1]]
        fitting = later[later <= found[-1] + room]
        cut = int(fitting[-1]) if len(fitting) else int(later[0]) if len(later) else where.end
        if not len(fitting):
            message = (
                f"{base}{len(found)}.src has more than {limit} lines: from line {found[-1]} to line "
                f"{cut - 1} stand a fold, a control structure, a spline or a TRIGGER, which are not cut."
            )
            issues.append(Issue("warning", "long-file", message))
        if cut == where.end:
            break
        found.append(cut)
    return [*found, where.end], issues
