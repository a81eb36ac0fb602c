"""Which force belongs to which motion: rows of a CSV file and comments in the program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from postproc import files
from postproc.errors import MOST, ForceError, Issue, together
from postproc.forces.feed import last_travel
from postproc.frames import Array
from postproc.program import FORCE_FRAMES, MOST_FORCE, Bools, Ints, Program
from postproc.toolpath import Segments

_COLUMNS = ("Fx", "Fy", "Fz")
_MOMENTS = ("Mx", "My", "Mz")
_MOST_LINES = 1e9
BASE, TOOL, FEED = range(3)
"""Values of `MotionForces.frame`."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceRows:
    """Rows of a force CSV: `first`…`last` source lines (inclusive), wrench (n, 6) [N, N·m], frame code (n,)."""

    file: str
    row: Ints
    first: Ints
    last: Ints
    wrench: Array
    frame: Ints


@dataclass(frozen=True, slots=True, eq=False)
class MotionForces:
    """The full force of each motion.

    :param wrench: (M, 6) Fx…Mz [N, N·m] in the axes that `frame` names; zero for rapid moves.
    :param frame: (M,) `BASE`, `TOOL` or `FEED`.
    :param travel: (M, 3) x of `FEED` for motions along the spindle, see `feed.last_travel`; (0, 3) without FEED.
    :param issues: what the user should know, e.g. cutting moves without a force.
    """

    wrench: Array
    frame: Ints
    travel: Array
    issues: tuple[Issue, ...]


def read_force_csv(path: Path) -> ForceRows:
    """Read `line,Fx,Fy,Fz[,Mx,My,Mz][,frame][,line_end]`.

    :raises ForceError: missing or unknown column, a value that is no finite number or out of range, a line number that
        is no positive whole number, `line_end` before `line`, an unknown frame, two rows for one line; all of them
        together (`errors.together`).
    """
    numbers, texts, at, found = files.parse_csv(
        path, ("line", *_COLUMNS), (*_MOMENTS, "frame", "line_end"), ForceError, ("frame",), ("line_end",)
    )
    row = at.astype(np.int64)
    first = numbers["line"]
    last = numbers.get("line_end", first)
    last = np.where(np.isnan(last), first, last)
    wrench = np.zeros((len(first), 6))
    names = [name.upper() or "BASE" for name in texts.get("frame", [])] or ["BASE"] * len(first)
    code: dict[str, int] = {name: place for place, name in enumerate(FORCE_FRAMES)}
    frame = np.array([code.get(name, -1) for name in names], dtype=np.int64)

    def check(wrong: Bools, problem: str, values: Sequence[object] | Array, advice: str | None = None) -> None:
        for place in np.flatnonzero(wrong)[: MOST + 1].tolist():
            text = problem.format(values[place])
            found.append(ForceError(text, file=str(path), line=int(row[place]), advice=advice))

    for index, name in enumerate((*_COLUMNS, *_MOMENTS)):
        if name in numbers:
            wrench[:, index] = numbers[name]
            advice = "No arm carries that: give newtons and newton metres."
            check(np.abs(numbers[name]) > MOST_FORCE, f"{name} is {{:g}}", numbers[name], advice)
    usable = np.ones(len(first), dtype=np.bool_)
    for label, column, new in (("line", first, True), ("line_end", last, last != first)):
        bad = (column != np.floor(column)) | ~((column >= 1.0) & (column <= _MOST_LINES))
        check(bad & new & np.isfinite(column), f"{label} is {{:g}}", column, "Lines of the program are counted from 1.")
        usable &= ~bad
    check(usable & (last < first), "line_end is before line", last)
    check(frame < 0, "unknown frame {!r}", names, f"Valid frames: {', '.join(FORCE_FRAMES)}.")
    begin, end = (np.where(usable, column, 0.0).astype(np.int64) for column in (first, last))
    order = np.argsort(begin, kind="stable")
    again = np.zeros(len(first), dtype=np.bool_)
    again[order[1:]] = begin[order[1:]] <= np.maximum.accumulate(end[order])[:-1]
    check(again & usable, "a second row for line {:g}", first)
    if found:
        raise together(found)
    return ForceRows(str(path), row[order], begin[order], end[order], wrench[order], frame[order])


def per_motion(program: Program, path: Segments, rows: ForceRows | None, axis: str) -> MotionForces:
    """Give each motion its force: a CSV row wins for its lines, else the last force comment; rapid moves none.

    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :raises ForceError: a CSV row names lines on which no motion starts; a FEED force with a part across the spindle on
        a move along the spindle, before any move across it.
    """
    m = program.motions
    wrench = np.zeros((len(m), 6))
    frame = np.zeros(len(m), dtype=np.int64)
    given = np.zeros(len(m), dtype=bool)
    from_csv = np.zeros(len(m), dtype=bool)
    if program.notes:
        lines = np.array([note.line for note in program.notes])
        index = np.searchsorted(lines, m.line, side="right") - 1
        given = index >= 0
        values = np.array([note.wrench for note in program.notes])
        frames = np.array([FORCE_FRAMES.index(note.frame) for note in program.notes])
        wrench[given], frame[given] = values[index[given]], frames[index[given]]
    if rows is not None and len(rows.first):
        _check_rows(program, rows)
        index = np.searchsorted(rows.first, m.line, side="right") - 1
        from_csv = (index >= 0) & (m.line <= rows.last[index])
        wrench[from_csv], frame[from_csv] = rows.wrench[index[from_csv]], rows.frame[index[from_csv]]
        given |= from_csv
    issues = []
    for kind, concerned, message in (
        ("no-force", ~given & ~m.rapid, "cutting moves without a force: none is assumed"),
        ("force-on-rapid", from_csv & m.rapid & wrench.any(axis=1), "rapid moves carry no force: the row is ignored"),
    ):
        found = np.flatnonzero(concerned)
        if len(found):
            issues.append(Issue("warning", kind, message, source_line=int(m.line[found[0]]), count=len(found)))
    wrench[m.rapid] = 0.0
    travel, lead = _travel(program, path, wrench, frame, axis)
    return MotionForces(wrench, frame, travel, (*issues, *lead))


def _travel(program: Program, path: Segments, wrench: Array, frame: Ints, axis: str) -> tuple[Array, list[Issue]]:
    """Return `MotionForces.travel`, and what to tell about it."""
    m = program.motions
    if not (frame == FEED).any():
        return np.zeros((0, 3)), []
    travel, needs = last_travel(program, path, axis)
    needs &= (frame == FEED) & wrench[:, [0, 1, 3, 4]].any(axis=1)
    unknown = needs & np.isnan(travel[:, 0])
    if unknown.any():
        advice = (
            "Such a move has no feed direction across the spindle, and no move from which it could be taken has one: "
            "give its force in BASE or TOOL axes."
        )
        name, problem = program.documents[0].name, "a FEED force on a move along the spindle"
        lines = np.unique(m.line[unknown])[: MOST + 1].tolist()
        raise together(ForceError(problem, file=name, line=line, advice=advice) for line in lines)
    issues = []
    if needs.any():
        message = (
            "a FEED force on a move along the spindle, which has no feed direction: x is the travel direction of the "
            "last move that had one, before any such move that of the first"
        )
        line = int(m.line[int(np.argmax(needs))])
        issues.append(Issue("info", "feed-direction", message, source_line=line, count=int(needs.sum())))
    return travel, issues


def _check_rows(program: Program, rows: ForceRows) -> None:
    """Every row must name at least one line on which a motion starts."""
    lines = np.sort(np.concatenate([program.motions.line, program.still]))
    empty = np.searchsorted(lines, rows.first, side="left") == np.searchsorted(lines, rows.last, side="right")
    if empty.any():
        advice = f"{int(empty.sum())} such rows. Line numbers are those of the file, counted from 1, not N words."
        name = program.documents[0].name
        raise together(
            ForceError(f"no motion starts on line {first} of {name}", file=rows.file, line=row, advice=advice)
            for first, row in zip(rows.first[empty].tolist(), rows.row[empty].tolist(), strict=True)
        )
