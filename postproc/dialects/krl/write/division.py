"""Lines at which a program may be divided into files.

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
    CyclicInput,
    Declaration,
    Event,
    Goto,
    IdleDeclaration,
    Import,
    Label,
    Motion,
    Return,
    Spline,
    Statement,
    Trigger,
)
from postproc.errors import Issue, ProgramError
from postproc.program import Ints

ADVICE = "To have it in one file, set lines_per_file = 0 in [output] of the cell."
_CLOSING = frozenset({*OPENING.values(), "UNTIL", "ENDSPLINE"})
_OPENING = frozenset({*OPENING, "REPEAT", *SPLINES})


def division_error(source: Source, problem: str, line: int, advice: str = ADVICE) -> ProgramError:
    """Return the error that a program cannot be divided into files, at a line."""
    return source.line_error(f"the program cannot be divided into files: {problem}", line, advice)


class CutPoints(Struct, frozen=True, eq=False):
    """Lines at which the main routine of a program may be cut into parts, which become separate files.

    :param begin: line of its DEF.
    :param end: line of its END.
    :param cuts: (n,) lines before which it may be cut, ascending.
    :param first_motion: line of its first motion; without motions, line of its first call behind all INTERRUPTs.
    :param declarations: lines with declarations.
    """

    begin: int
    end: int
    cuts: Ints
    first_motion: int
    declarations: list[int]


def find_cut_points(source: Source, main: Routine) -> CutPoints:
    """Return the lines at which the main routine of a program may be cut into parts, which become separate files.

    A cut is never inside a fold, a control structure or a spline, between a TRIGGER and its motion, or behind CONTINUE.

    :raises ProgramError: a statement would have another meaning in a separate file; there is no motion and no call.
    """
    text = source.text
    first_motion = first_call = 0  # lines; 0: none yet
    depth = 0  # number of open folds and structures
    cuts: list[int] = []
    declarations: list[int] = []
    needs_next = False  # the last statement is a TRIGGER or CONTINUE, which refers to the one behind it
    for line in range(main.first + 1, main.last + 1):
        fold = fold_at(text, int(source.starts[line - 1]), int(source.stops[line - 1]))
        if depth == 0 and not needs_next and fold != "ENDFOLD":
            cuts.append(line)
        if fold:
            depth = max(depth - 1, 0) if fold == "ENDFOLD" else depth + 1
            continue
        stmt = statement(source, line)
        if stmt.start == stmt.stop or line == main.last:  # a line without code, or END
            continue
        _check_divisible(source, line, stmt, first_motion)
        depth = max(0, depth + (stmt.word in _OPENING) - (stmt.word in _CLOSING))
        if isinstance(stmt, Motion | Spline):
            first_motion, needs_next = first_motion or line, False
        elif isinstance(stmt, Trigger) or stmt.word == "CONTINUE":
            needs_next = True
        elif _declares(stmt):
            declarations.append(line)
        elif isinstance(stmt, Event) and not stmt.is_global:
            first_call = 0  # only a call behind all INTERRUPTs counts
        elif not first_call and stmt.word != "BAS" and calls(stmt.values):
            first_call = line
    first_motion = first_motion or first_call  # without motions of its own, all are in routines
    if not first_motion:
        raise division_error(source, "it has no DEF, END or motion", main.first)
    return CutPoints(main.first, main.last, np.array(cuts, dtype=np.int64), first_motion, declarations)


def _declares(stmt: Statement) -> bool:
    """Return whether a statement declares names, so that each file that uses them needs it."""
    is_signal = isinstance(stmt, CyclicInput) and stmt.word == "SIGNAL"
    return is_signal or isinstance(stmt, Declaration | IdleDeclaration | Import)


def _check_divisible(source: Source, line: int, stmt: Statement, first_motion: int) -> None:
    """Check that a statement has the same meaning in a separate file.

    :param line: line of the statement `stmt`.
    :param first_motion: line of the first motion; 0 if no motion precedes the statement.
    :raises ProgramError: it is RETURN, GOTO or a label, or declares an interrupt behind the first motion.
    """
    if isinstance(stmt, Return | Goto | Label):
        raise division_error(source, f"{stmt.word} leads to another place of it", line)
    if first_motion and isinstance(stmt, Event) and stmt.is_declaration and not stmt.is_global:
        problem = "an interrupt that is not GLOBAL is declared behind the first motion"
        raise division_error(source, problem, line, f"Declare it before the first motion. {ADVICE}")


def part_bounds(
    source: Source, base: str, cut_points: CutPoints, limit: int, extra_lines: int
) -> tuple[list[int], list[Issue]]:
    """Return the first line of each part, then the line of END; and warnings about parts that are too long.

    A part is the piece of the main routine that becomes a file of its own. Lines before the first part stay in the main
    program, which calls the parts.

    :param base: beginning of the names of the files.
    :param limit: largest number of lines of a file.
    :param extra_lines: number of lines of each file that are added to the lines of the program.
    :raises ProgramError: `limit` is too small, the first motion cannot be in a part, or a declaration follows it.
    """
    issues: list[Issue] = []
    free_lines = limit - extra_lines
    if free_lines < 1:
        raise division_error(source, f"{limit} lines are not enough for one motion", cut_points.begin)
    first_cuts = cut_points.cuts[cut_points.cuts <= cut_points.first_motion]
    if not len(first_cuts):
        raise division_error(source, "its first motion is in a fold or control structure", cut_points.first_motion)
    cuts = [int(first_cuts[-1])]
    late_declarations = [line for line in cut_points.declarations if line > cuts[0]]
    if late_declarations:
        raise division_error(source, "a declaration follows the first motion", late_declarations[0])
    while cuts[-1] < cut_points.end:
        cut = _next_cut(cut_points, cuts[-1], free_lines)
        if cut - cuts[-1] > free_lines:
            message = (
                f"{base}{len(cuts)}.src has more than {limit} lines: lines {cuts[-1]} to "
                f"{cut - 1} are a fold, a control structure, a spline or a TRIGGER, which are not cut."
            )
            issues.append(Issue("warning", "long-file", message))
        cuts.append(cut)
    return cuts, issues


def _next_cut(cut_points: CutPoints, begin: int, free_lines: int) -> int:
    """Return the line before which the part that begins at line `begin` ends.

    This is the last cut point that leaves the part at most `free_lines` lines. If there is none, it is the next cut
    point; if there is none either, the line of END.
    """
    if cut_points.end - begin <= free_lines:
        return cut_points.end
    next_cuts = cut_points.cuts[cut_points.cuts > begin]
    fitting_cuts = next_cuts[next_cuts <= begin + free_lines]
    candidates = (*fitting_cuts[-1:], *next_cuts[:1], cut_points.end)
    return int(candidates[0])
