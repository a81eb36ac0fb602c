"""Forces by source line from a CSV file: one row for the whole of each move, or several along it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct

from postproc import files
from postproc.errors import MOST, ForceError, together
from postproc.forces.sources import Knots
from postproc.frames import Array
from postproc.program import FORCE_FRAMES, MOST_FORCE, WRENCH, Bools, Ints, Program
from postproc.toolpath import Segments

_REQUIRED = ("line", *WRENCH[:3])
_SIGMAS = tuple(f"s{name}" for name in WRENCH)
"""Columns of the standard deviations of the wrench."""
_OPTIONAL = (*WRENCH[3:], "frame", "line_end", "t", *_SIGMAS, "sigma_percent")
_MOST_LINES = 1e9
_SHOWN = 5


class ForceTable(Struct, frozen=True, eq=False):
    """The R rows of a force CSV, in order of lines and, along a move, of t.

    :param file: its name.
    :param row: (R,) its line in that file.
    :param first: (R,) first source line to which it applies, and `last` (R,) the last one.
    :param t: (R,) position on the move in [0, 1]; NaN for the whole move.
    :param wrench: (R, 6) [N, N·m].
    :param frame: (R,) index in `FORCE_FRAMES`.
    :param sigma: (R, 6) standard deviations of the wrench.
    """

    file: str
    row: Ints
    first: Ints
    last: Ints
    t: Array
    wrench: Array
    frame: Ints
    sigma: Array

    @property
    def name(self) -> str:
        """The name of the file."""
        return self.file

    def along(self, program: Program, path: Segments) -> Knots:
        """Return the forces of the motions that start on lines of the table, see `ForceSource`.

        :raises ForceError: a row names lines on which no motion starts.
        :raises ProgramError: a row names the line of a call of a routine that cuts and is not followed.
        """
        for each in program.unfollowed:
            if np.any(self.wrench[(self.first <= each.line) & (each.line <= self.last)]):
                raise each.error
        self._find_each(program)
        begins = np.flatnonzero(np.diff(self.first, prepend=-1))
        if len(begins) == 0:
            return Knots.throughout(begins, self.wrench, self.frame)
        line, number = program.motions.line, np.diff(np.append(begins, len(self.row)))
        block = np.searchsorted(self.first[begins], line, side="right") - 1
        motion = np.flatnonzero((block >= 0) & (line <= self.last[begins[block]]))
        count = number[block[motion]]
        inside = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        row = np.repeat(begins[block[motion]], count) + inside
        throughout = np.isnan(self.t[row])
        t = np.where(throughout, 1.0, self.t[row])
        return Knots(np.repeat(motion, count), t, self.wrench[row], self.frame[row], self.sigma[row], throughout)

    def _find_each(self, program: Program) -> None:
        """Check that every row names at least one line on which a motion starts."""
        lines = np.sort(np.concatenate([program.motions.line, program.still]))
        empty = np.searchsorted(lines, self.first, side="left") == np.searchsorted(lines, self.last, side="right")
        if empty.any():
            first, row = (values[empty].tolist() for values in (self.first, self.row))
            others = ", ".join(str(line) for line in first[1 : 1 + _SHOWN])
            more = f", nor on {others}{', …' if len(first) > 1 + _SHOWN else ''}: {len(first)} rows of {len(self.row)}"
            raise ForceError(
                f"no motion starts on line {first[0]} of {program.documents[0].name}{more if others else ''}",
                file=self.file,
                line=row[0],
                advice="Give line numbers of the file, counted from 1, not N words. A force file that was written with "
                "a corrected program applies to that program, not to the original.",
            )


def read_force_csv(path: Path) -> ForceTable:
    """Read `line,Fx,Fy,Fz[,Mx,My,Mz][,frame][,line_end][,t][,sFx,sFy,sFz…|,sigma_percent]`.

    :raises ForceError: missing or unknown column, a value that is not finite or out of range, a line number that
        is not a positive integer, `line_end` before `line`, an unknown frame, two rows for one line without t, places
        t that do not increase along a line, standard deviations below zero or given twice; all of them together
        (`errors.together`).
    """
    numbers, texts, at, wrong = files.parse_csv(
        path, _REQUIRED, _OPTIONAL, ForceError, ("frame",), ("line_end", "t", *_SIGMAS, "sigma_percent")
    )
    columns = _Columns(str(path), at.astype(np.int64), numbers, texts.get("frame", []), wrong)
    first, last, usable = columns.lines()
    wrench, sigma = columns.wrench()
    frame = columns.frame()
    t = columns.places()
    begin, end = (np.where(usable, column, 0.0).astype(np.int64) for column in (first, last))
    order = np.lexsort((columns.row, begin))
    columns.check_order(order, (begin, end, t, frame), usable)
    if wrong:
        raise together(wrong)
    return ForceTable(
        str(path), columns.row[order], begin[order], end[order], t[order], wrench[order], frame[order], sigma[order]
    )


class _Columns(Struct, frozen=True, eq=False):
    """Columns of a force CSV as read. Each method checks some of them and adds errors to `wrong`."""

    file: str
    row: Ints
    numbers: dict[str, Array]
    frames: Sequence[str]
    wrong: list[ForceError]

    def lines(self) -> tuple[Array, Array, Bools]:
        """Return first and last line of each row (n,), and (n,) True where they are valid."""
        first = self.numbers["line"]
        last = self.numbers.get("line_end", first)
        last = np.where(np.isnan(last), first, last)
        usable = np.ones(len(first), dtype=np.bool_)
        for label, column, new in (("line", first, True), ("line_end", last, last != first)):
            bad = (column != np.floor(column)) | ~((column >= 1.0) & (column <= _MOST_LINES))
            wrong = bad & new & np.isfinite(column)
            self.check(wrong, f"{label} is {{:g}}", column, "Give a line number of the program, counted from 1.")
            usable &= ~bad
        self.check(usable & (last < first), "line_end is before line", last)
        return first, last, usable

    def wrench(self) -> tuple[Array, Array]:
        """Return wrenches and their standard deviations, both (n, 6)."""
        wrench, sigma = np.zeros((len(self.row), 6)), np.zeros((len(self.row), 6))
        for index, name in enumerate(WRENCH):
            if name in self.numbers:
                wrench[:, index] = self.numbers[name]
                advice = "This is more than any robot carries: give newtons and newton metres."
                self.check(np.abs(wrench[:, index]) > MOST_FORCE, f"{name} is {{:g}}", wrench[:, index], advice)
        percent = self.numbers.get("sigma_percent", np.full(len(self.row), np.nan))
        self.check(~((percent >= 0.0) | np.isnan(percent)), "sigma_percent is {:g}", percent, _NOT_NEGATIVE)
        sigma += np.abs(wrench) * (np.nan_to_num(percent) / 100.0)[:, None]
        twice = np.zeros(len(self.row), dtype=np.bool_)
        for index, name in enumerate(_SIGMAS):
            given = self.numbers.get(name, np.full(len(self.row), np.nan))
            self.check(
                ~((given >= 0.0) & (given <= MOST_FORCE) | np.isnan(given)), f"{name} is {{:g}}", given, _NOT_NEGATIVE
            )
            twice |= np.isfinite(given) & np.isfinite(percent)
            sigma[:, index] = np.where(np.isnan(given), sigma[:, index], given)
        self.check(twice, "standard deviations in addition to sigma_percent = {:g}", percent, "Give one or the other.")
        return wrench, sigma

    def frame(self) -> Ints:
        """Return the frames (n,)."""
        names = [name.upper() or "BASE" for name in self.frames] or ["BASE"] * len(self.row)
        code: dict[str, int] = {name: place for place, name in enumerate(FORCE_FRAMES)}
        frame = np.array([code.get(name, -1) for name in names], dtype=np.int64)
        self.check(frame < 0, "unknown frame {!r}", names, f"Valid frames: {', '.join(FORCE_FRAMES)}.")
        return frame

    def places(self) -> Array:
        """Return positions along the moves (n,); NaN where a row applies to the whole move."""
        t = self.numbers.get("t", np.full(len(self.row), np.nan))
        advice = "Give a position along the move: 0 at its start, 1 at its end."
        self.check(~((t >= 0.0) & (t <= 1.0) | np.isnan(t)), "t is {:g}", t, advice)
        return t

    def check_order(self, order: Ints, values: tuple[Ints, Ints, Array, Ints], usable: Bools) -> None:
        """Check that rows of one line are in order of t and have one frame, and that no other rows share a line."""
        begin, end, t, frame = (column[order] for column in values)
        usable = usable[order]
        together = np.append(False, (np.diff(begin) == 0) & (np.diff(end) == 0)) & ~np.isnan(t)
        together &= ~np.isnan(np.append(np.nan, t[:-1]))
        before = np.append(0, np.maximum.accumulate(end)[:-1])
        again = usable & (begin <= before) & ~together
        step = np.diff(t, prepend=0.0)
        for wrong, problem, column, advice in (
            (again, "a second row for line {:g}", begin, None),
            (usable & together & (step <= 0.0), "t = {:g} is not larger than in the row before", t, _STEP),
            (usable & together & (np.diff(frame, prepend=0) != 0), "another frame than the row before", t, None),
        ):
            back = np.zeros(len(order), dtype=np.bool_)
            back[order] = wrong
            shown = np.zeros(len(order))
            shown[order] = column
            self.check(back, problem, shown, advice)

    def check(self, wrong: Bools, problem: str, values: Sequence[object] | Array, advice: str | None = None) -> None:
        """Add an error for each wrong row."""
        for place in np.flatnonzero(wrong)[: MOST + 1].tolist():
            text = problem.format(values[place])
            self.wrong.append(ForceError(text, file=self.file, line=int(self.row[place]), advice=advice))


_NOT_NEGATIVE = "Give a standard deviation, 0 or larger, in newtons, newton metres or percent."
_STEP = "Sort the rows of a move by t; give a step as two positions close to each other."
