"""Which force belongs to which motion: rows of a CSV file and comments in the program."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from postproc import files
from postproc.errors import ForceError, Issue
from postproc.frames import Array
from postproc.program import FORCE_FRAMES, Ints, Program

_COLUMNS = ("Fx", "Fy", "Fz")
_MOMENTS = ("Mx", "My", "Mz")
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
    :param issues: what the user should know, e.g. cutting moves without a force.
    """

    wrench: Array
    frame: Ints
    issues: tuple[Issue, ...]


def read_force_csv(path: Path) -> ForceRows:
    """Read `line,Fx,Fy,Fz[,Mx,My,Mz][,frame][,line_end]`.

    :raises ForceError: missing or unknown column, a value that is no finite number, a line number that is no positive
        whole number, `line_end` before `line`, an unknown frame, two rows for one line.
    """
    numbers, texts, at = files.read_csv(
        path, ("line", *_COLUMNS), (*_MOMENTS, "frame", "line_end"), ForceError, ("frame",), ("line_end",)
    )
    row = at.astype(np.int64)
    first = numbers["line"]
    last = numbers.get("line_end", first)
    last = np.where(np.isnan(last), first, last)
    for label, column in (("line", first), ("line_end", last)):
        bad = np.flatnonzero((column != np.floor(column)) | (column < 1))
        if len(bad):
            raise ForceError(f"{label} is {column[bad[0]]:g}", file=str(path), line=int(row[bad[0]]))
    reversed_rows = np.flatnonzero(last < first)
    if len(reversed_rows):
        raise ForceError("line_end is before line", file=str(path), line=int(row[reversed_rows[0]]))
    names = [name.upper() or "BASE" for name in texts.get("frame", [])] or ["BASE"] * len(first)
    for place, name in enumerate(names):
        if name not in FORCE_FRAMES:
            raise ForceError(
                f"unknown frame {name!r}",
                file=str(path),
                line=int(row[place]),
                advice=f"Valid frames: {', '.join(FORCE_FRAMES)}.",
            )
    wrench = np.zeros((len(first), 6))
    for index, name in enumerate((*_COLUMNS, *_MOMENTS)):
        if name in numbers:
            wrench[:, index] = numbers[name]
    code: dict[str, int] = {name: place for place, name in enumerate(FORCE_FRAMES)}
    frame = np.array([code[name] for name in names], dtype=np.int64)
    order = np.argsort(first, kind="stable")
    begin, end = first[order].astype(np.int64), last[order].astype(np.int64)
    overlap = np.flatnonzero(begin[1:] <= end[:-1])
    if len(overlap):
        raise ForceError(
            f"a second row for line {begin[overlap[0] + 1]}", file=str(path), line=int(row[order][overlap[0] + 1])
        )
    return ForceRows(str(path), row[order], begin, end, wrench[order], frame[order])


def per_motion(program: Program, rows: ForceRows | None) -> MotionForces:
    """Give each motion its force: a CSV row wins for its lines, else the last force comment; rapid moves none.

    :raises ForceError: a CSV row names lines on which no motion starts.
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
    return MotionForces(wrench, frame, tuple(issues))


def _check_rows(program: Program, rows: ForceRows) -> None:
    """Every row must name at least one line on which a motion starts."""
    lines = np.sort(np.concatenate([program.motions.line, program.still]))
    empty = np.searchsorted(lines, rows.first, side="left") == np.searchsorted(lines, rows.last, side="right")
    bad = np.flatnonzero(empty)
    if len(bad):
        raise ForceError(
            f"no motion starts on line {rows.first[bad[0]]} of {program.documents[0].name}",
            file=rows.file,
            line=int(rows.row[bad[0]]),
            advice=f"{len(bad)} such rows. Line numbers are those of the file, counted from 1, not N words.",
        )
