"""Forces by source line: read from a CSV file, and made for the lines of the written program.

The file has one row for the whole of each move, or several along it.

The written program divides a motion into pieces: each ends at a target and is a motion of its own. If the force of a
motion is ramped (it builds up over the first `force_ramp_mm`), so is that of each piece, and it acts in full at its
end: so each target gets the wrench that acts there. A force that is given along a motion is also given along each of
its pieces. The axes are those of `$BASE`, in which the force on a straight piece is constant. A FEED force on an arc,
and FEED and TOOL forces on a motion that turns the tool, keep their axes, which turn along the piece.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc import files
from postproc.chunks import Runs, ragged_range
from postproc.errors import MAX_ERRORS, ForceError, Issue, choices, combined_error
from postproc.forces.axes import LEAST_TURN, Axes, axes_of_travel
from postproc.forces.path_forces import PathForces
from postproc.forces.sources import BASE, FEED, TOOL, Knots
from postproc.frames import Array, any_column, largest, norm
from postproc.program import CIRC, FORCE_FRAMES, MOST_FORCE, WRENCH, Bools, Ints, Program, TargetForces, Targets
from postproc.toolpath import Segments, at

_REQUIRED_COLUMNS = ("line", *WRENCH[:3])
_SIGMA_COLUMNS = tuple(f"s{name}" for name in WRENCH)
"""Columns of the standard deviations of the wrench."""
_PERCENT_COLUMNS = ("sigma_percent", "factor_percent")
_OPTIONAL_COLUMNS = (*WRENCH[3:], "frame", "line_end", "t", *_SIGMA_COLUMNS, *_PERCENT_COLUMNS)
_MOST_LINES = 1e9
"""Line numbers beyond it are another quantity in the wrong column (assumed); they fit int32."""
_LISTED_LINES = 5
"""Lines that a message names; three dots stand for the others."""


class ForceTable(Struct, frozen=True, eq=False):
    """The R rows of a force CSV, in order of lines and, along a move, of t.

    :param file: name of the file.
    :param row: (R,) line of each row in the file.
    :param first: (R,) first source line to which it applies, and `last` (R,) the last one.
    :param t: (R,) position on the move in [0, 1]; NaN for the whole move.
    :param wrench: (R, 6) [N, N·m].
    :param frame: (R,) index in `FORCE_FRAMES`.
    :param sigma: (R, 6) standard deviations of the wrench.
    :param factor: (R,) standard deviation of one factor of the whole wrench, see `Knots`.
    """

    file: str
    row: Ints
    first: Ints
    last: Ints
    t: Array
    wrench: Array
    frame: Ints
    sigma: Array
    factor: Array

    @property
    def name(self) -> str:
        """The name of the file."""
        return self.file

    def along(self, program: Program, path: Segments) -> Knots:
        """Return the forces of the motions that start on lines of the table, see `ForceSource`.

        On a line with rapid motions and cuts, as that of a drilling cycle, the rows apply to the cuts only.

        :raises ForceError: a row names lines on which no motion starts.
        :raises ProgramError: a row names the line of a call of a routine that cuts and is not followed.
        """
        for call in program.unfollowed:
            if np.any(self.wrench[(self.first <= call.line) & (call.line <= self.last)]):
                raise call.error
        self._check_rows(program)
        motion, row = self._rows_of_motions(program)
        is_constant = np.isnan(self.t[row])
        return Knots(
            motion=motion,
            t=np.where(is_constant, 1.0, self.t[row]),
            wrench=self.wrench[row],
            frame=self.frame[row],
            sigma=self.sigma[row],
            factor=self.factor[row],
            ramped=is_constant,
            issues=tuple(self._zero_length_issues(program)),
        )

    def _rows_of_motions(self, program: Program) -> tuple[Ints, Ints]:
        """Return the motion (k,) and the row of the table (k,) of each knot, in order along the program.

        Rows with the same first line are a block: they are the knots of each motion that starts on the lines of the
        block. Rapid motions on a line that also cuts have no knots.
        """
        block_begins = np.flatnonzero(np.diff(self.first, prepend=-1))
        block_sizes = np.diff(np.append(block_begins, len(self.row)))
        line, rapid = program.motions.line, program.motions.rapid
        block = np.searchsorted(self.first[block_begins], line, side="right") - 1  # of each motion; −1: before all
        has_knots = ~rapid | ~np.isin(line, line[~rapid])
        motion = np.flatnonzero((block >= 0) & (line <= self.last[block_begins[block]]) & has_knots)
        count = block_sizes[block[motion]]
        return np.repeat(motion, count), np.repeat(block_begins[block[motion]], count) + ragged_range(count)

    def _zero_length_issues(self, program: Program) -> Iterator[Issue]:
        """Yield a warning if rows with a force cover only moves of zero length."""
        starts = np.sort(program.motions.line)
        has_no_motion = np.searchsorted(starts, self.first, side="left") == np.searchsorted(
            starts, self.last, side="right"
        )
        rows = np.flatnonzero(has_no_motion & any_column(self.wrench != 0.0))
        if len(rows):
            lines = tuple(dict.fromkeys(self.first[rows].tolist()))
            message = f"a move of zero length carries no force: its row of {self.name} is not used"
            yield Issue("warning", "force-on-still", message, lines[0], count=len(lines), lines=lines)

    def _check_rows(self, program: Program) -> None:
        """Check that every row names at least one line on which a motion starts.

        :raises ForceError: no motion starts on the lines of a row.
        """
        lines = np.sort(np.concatenate([program.motions.line, program.still]))
        is_empty = np.searchsorted(lines, self.first, side="left") == np.searchsorted(lines, self.last, side="right")
        if is_empty.any():
            first, row = (values[is_empty].tolist() for values in (self.first, self.row))
            line_list = ", ".join(str(line) for line in first[1 : 1 + _LISTED_LINES])
            line_list += ", …" if len(first) > 1 + _LISTED_LINES else ""
            suffix = f", nor on {line_list}: {len(first)} rows of {len(self.row)}"
            raise ForceError(
                f"no motion starts on line {first[0]} of {program.documents[0].name}{suffix if line_list else ''}",
                file=self.file,
                line=row[0],
                advice="Give line numbers of the file, counted from 1, not N words. A force file that was written with "
                "a corrected program applies to that program, not to the original.",
            )


def read_force_csv(path: Path) -> ForceTable:
    """Read `line,Fx,Fy,Fz[,Mx,My,Mz][,frame][,line_end][,t][,sFx,sFy,sFz…[,factor_percent]|,sigma_percent]`.

    :raises ForceError: no rows, missing or unknown column, a value that is not finite or out of range, a line number
        that is not a positive integer, `line_end` before `line`, an unknown frame, two rows for one line without t,
        places t that do not increase along a line, standard deviations below zero or given twice; all of them together
        (`errors.combined_error`).
    """
    numbers, texts, row, faults = files.parse_csv(
        path,
        _REQUIRED_COLUMNS,
        _OPTIONAL_COLUMNS,
        ForceError,
        ("frame",),
        ("line_end", "t", *_SIGMA_COLUMNS, *_PERCENT_COLUMNS),
    )
    columns = _Columns(str(path), row.astype(np.int64), numbers, texts.get("frame", []), faults)
    lines, wrenches = columns.lines(), columns.wrench()
    frame = columns.frame()
    t = columns.positions()
    order = np.lexsort((columns.row, lines.first))
    columns.add_order_errors(order, lines, t, frame)
    if faults:
        raise combined_error(faults)
    if not len(columns.row):
        advice = "Add the rows, or convert without this file if the program cuts nothing."
        raise ForceError("a header without rows: the file states no force", file=str(path), advice=advice)
    return ForceTable(
        file=str(path),
        row=columns.row[order],
        first=lines.first[order],
        last=lines.last[order],
        t=t[order],
        wrench=wrenches.wrench[order],
        frame=frame[order],
        sigma=wrenches.sigma[order],
        factor=wrenches.factor[order],
    )


class _SourceLines(NamedTuple):
    """Source lines to which the R rows of a force CSV apply.

    :param first: (R,) the first line, and `last` (R,) the last one; 0 if one of them is invalid.
    :param valid: (R,) True if both are valid line numbers.
    """

    first: Ints
    last: Ints
    valid: Bools


class _Wrenches(NamedTuple):
    """The wrenches of the R rows of a force CSV.

    :param wrench: (R, 6) [N, N·m], in the axes of the row.
    :param sigma: (R, 6) standard deviations of its components [N, N·m].
    :param factor: (R,) standard deviation of one factor of the whole wrench, see `Knots`.
    """

    wrench: Array
    sigma: Array
    factor: Array


class _Columns(Struct, frozen=True, eq=False):
    """The R rows of a force CSV by column, as read. Each method checks some columns and adds errors to `errors`.

    :param row: (R,) line of each row in the file.
    :param numbers: columns (R,) of numbers by header; NaN for an empty cell.
    :param frames: the column `frame`; empty without it.
    """

    file: str
    row: Ints
    numbers: dict[str, Array]
    frames: Sequence[str]
    errors: list[ForceError]

    def lines(self) -> _SourceLines:
        """Return the source lines of each row, and add errors for invalid ones."""
        first = self.numbers["line"]
        last = self.numbers.get("line_end", first)
        last = np.where(np.isnan(last), first, last)
        valid = np.ones(len(first), dtype=np.bool_)
        # a fault of `line` is not reported again as one of the `line_end` that is copied from it
        for label, column, is_separate in (("line", first, True), ("line_end", last, last != first)):
            is_invalid = (column != np.floor(column)) | ~((column >= 1.0) & (column <= _MOST_LINES))
            is_new_fault = is_invalid & is_separate & np.isfinite(column)
            self.add_errors(
                is_new_fault, f"{label} is {{:g}}", column, "Give a line number of the program, counted from 1."
            )
            valid &= ~is_invalid
        self.add_errors(valid & (last < first), "line_end is before line", last)
        first_line, last_line = (np.where(valid, column, 0.0).astype(np.int64) for column in (first, last))
        return _SourceLines(first_line, last_line, valid)

    def wrench(self) -> _Wrenches:
        """Return the wrench of each row and its standard deviations, and add errors for invalid values."""
        wrench = np.zeros((len(self.row), 6))
        for index, name in enumerate(WRENCH):
            if name in self.numbers:
                wrench[:, index] = self.numbers[name]
                advice = "This is more than any robot carries: give newtons and newton metres."
                self.add_errors(np.abs(wrench[:, index]) > MOST_FORCE, f"{name} is {{:g}}", wrench[:, index], advice)
        return _Wrenches(wrench, *self._sigma_and_factor(wrench))

    def _sigma_and_factor(self, wrench: Array) -> tuple[Array, Array]:
        """Return `sigma` and `factor` of `_Wrenches` for wrenches (R, 6), and add errors for invalid values.

        Percentages give the deviation of all six components; a column of one component replaces it.
        """
        percent, factor_percent = (self._deviations(name, np.inf) for name in _PERCENT_COLUMNS)
        factor = np.nan_to_num(np.where(np.isnan(percent), factor_percent, percent)) / 100.0
        sigma = np.abs(wrench) * factor[:, None]
        has_both = np.isfinite(percent) & np.isfinite(factor_percent)
        for index, name in enumerate(_SIGMA_COLUMNS):
            deviations = self._deviations(name, MOST_FORCE)
            has_both |= np.isfinite(deviations) & np.isfinite(percent)
            sigma[:, index] = np.where(np.isnan(deviations), sigma[:, index], deviations)
        self.add_errors(
            has_both, "standard deviations in addition to sigma_percent = {:g}", percent, "Give one or the other."
        )
        return sigma, factor

    def _deviations(self, name: str, limit: float) -> Array:
        """Return a column of standard deviations (R,), NaN for empty cells; add errors for values out of range.

        :param name: header of the column; a missing column is empty.
        :param limit: largest permitted value; the smallest is 0.
        """
        values = self.numbers.get(name, np.full(len(self.row), np.nan))
        is_wrong = ~((values >= 0.0) & (values <= limit) | np.isnan(values))
        self.add_errors(
            is_wrong,
            f"{name} is {{:g}}",
            values,
            "Give a standard deviation, 0 or larger, in newtons, newton metres or percent.",
        )
        return values

    def frame(self) -> Ints:
        """Return the frames (R,) as indices in `FORCE_FRAMES`, and add errors for unknown ones, whose index is −1.

        An empty cell is BASE.
        """
        names = [name.upper() or "BASE" for name in self.frames] or ["BASE"] * len(self.row)
        code_of: dict[str, int] = {name: code for code, name in enumerate(FORCE_FRAMES)}
        frame = np.array([code_of.get(name, -1) for name in names], dtype=np.int64)
        self.add_errors(frame < 0, "unknown frame {!r}", names, valid=FORCE_FRAMES)
        return frame

    def positions(self) -> Array:
        """Return positions along moves (R,), NaN for rows of a whole move; add errors for positions out of [0, 1]."""
        t = self.numbers.get("t", np.full(len(self.row), np.nan))
        advice = "Give a position along the move: 0 at its start, 1 at its end."
        self.add_errors(~((t >= 0.0) & (t <= 1.0) | np.isnan(t)), "t is {:g}", t, advice)
        return t

    def add_order_errors(self, order: Ints, lines: _SourceLines, t: Array, frame: Ints) -> None:
        """Add errors for rows of one line that are not in order of t or have several frames, and for repeated lines.

        Each row is compared with the row before it. Rows without valid lines are not reported again.

        :param order: (R,) rows, sorted by their first lines.
        :param t: (R,) position on the move of each row, and `frame` (R,) its frame; see `ForceTable`.
        """
        begin, end, is_valid = lines.first[order], lines.last[order], lines.valid[order]
        t, frame = t[order], frame[order]
        rank = np.argsort(order)  # of each row of the file
        has_same_lines = np.append(False, (np.diff(begin) == 0) & (np.diff(end) == 0))
        previous_t = np.append(np.nan, t[:-1])
        # two positions along the same move
        shares_line = has_same_lines & ~np.isnan(t) & ~np.isnan(previous_t)
        previous_end = np.append(0, np.maximum.accumulate(end)[:-1])  # largest last line of all rows before
        repeats_line = is_valid & (begin <= previous_end) & ~shares_line
        step = np.diff(t, prepend=0.0)
        for is_invalid, problem, column, advice in (
            (repeats_line, "a second row for line {:g}", begin, None),
            (is_valid & shares_line & (step <= 0.0), "t = {:g} is not larger than in the row before", t, _ORDER_ADVICE),
            (is_valid & shares_line & (np.diff(frame, prepend=0) != 0), "another frame than the row before", t, None),
        ):
            self.add_errors(is_invalid[rank], problem, column[rank].astype(float), advice)

    def add_errors(
        self,
        is_wrong: Bools,
        problem: str,
        values: Sequence[object] | Array,
        advice: str | None = None,
        valid: Sequence[str] = (),
    ) -> None:
        """Add an error for each wrong row, up to one more than are shown.

        :param is_wrong: (R,) True for wrong rows.
        :param problem: format of the message, with one field for the value of the row.
        :param values: (R,) values of the rows.
        :param advice: advice for all wrong rows; None: no advice.
        :param valid: valid names of the value: the advice is the nearest of them. Empty: `advice` is used.
        """
        for index in np.flatnonzero(is_wrong)[: MAX_ERRORS + 1].tolist():
            text = problem.format(values[index])
            row_advice = choices(str(values[index]), valid, "Valid frames") if valid else advice
            self.errors.append(ForceError(text, file=self.file, line=int(self.row[index]), advice=row_advice))


_ORDER_ADVICE = "Sort the rows of a move by t; give a step as two positions close to each other."


_PLACE_TOLERANCE = 1e-9
"""Positions on a motion that differ by less count as one (assumed)."""
_LEAST_CHANGE = 1e-6
"""Changes of the force below this [N, N·m] count as none: the file has three decimals."""

_FACTOR_TOLERANCE = 1e-9
"""Standard deviations of a factor that differ by less count as equal (assumed)."""
_FORCE_TOLERANCE = 2e-3
"""Forces of two passes of a line that differ by less [N, N·m] count as equal: the file has three decimals."""


def target_forces(forces: PathForces, targets: Targets, arrive: Array, wrench: Runs) -> TargetForces:
    """Return the wrench at each target for the comments of the written program.

    A target ends a piece of a motion. FEED: a wrench on a piece that ends along the spindle, where these axes are not
    defined, is given in BASE axes.

    :param forces: forces of the program as read.
    :param targets: the K targets to write.
    :param arrive: (K, 3) direction of travel at the end of each piece, `$BASE`; (0, 3) without forces in FEED axes.
    :param wrench: (K, 6) wrench at each target [N, N·m], `$BASE` axes.
    """
    # a wrench of zero is the same in all axes. `values` are the different wrenches, `run` the row of each target's
    has_force = any_column(wrench.values != 0.0)[wrench.run]
    frame = np.where(has_force, _piece_frames(forces, targets), BASE)
    if (frame == BASE).all():
        return TargetForces(wrench, frame)
    values = wrench[:]
    for code in (TOOL, FEED):
        rows = np.flatnonzero(frame == code)
        axes = targets.pose[rows, :3, :3]
        if code == FEED:
            axes, is_defined = axes_of_travel(axes, arrive[rows], forces.axes.spindle)
            frame[rows[~is_defined]] = BASE
            rows, axes = rows[is_defined], axes[is_defined]
        for components in (slice(0, 3), slice(3, 6)):
            values[rows, components] = np.einsum("nji,nj->ni", axes, values[rows, components])
    return TargetForces(Runs.of(values), frame)


def piece_knots(forces: PathForces, targets: Targets, at_end: TargetForces, output_axes: Axes, row: Ints) -> Knots:
    """Return the wrench along each piece for the CSV file of the written program.

    A piece is the part of a motion of the program as read that is written as one motion, up to a target.

    :param forces: forces of the program as read, and `targets` the K written targets.
    :param at_end: the wrench at the targets, see `target_forces`.
    :param output_axes: axes of forces along the program as written.
    :param row: (K,) motion of the written program that ends at each target.
    :returns: knots; their `motion` is the row of the target at the end of the piece, and t the place on the piece.
    """
    # a ramped force is given for the whole piece, as it acts at its end
    target, share = _knot_places(forces, targets)
    is_ramped = forces.ramped[targets.motion[target]]
    frame = np.where(is_ramped, at_end.frame[target], _piece_frames(forces, targets)[target])
    begin, end = targets.begin(target), targets.t[target]  # of the piece, on the motion as read
    program, path = forces.axes.program, forces.axes.path
    nominal = at(program, path, targets.motion[target], np.where(share == 1.0, end, begin + share * (end - begin)))
    output_place = at(output_axes.program, output_axes.path, row[target], share)
    wrench = output_axes.in_frame_axes(forces.at(nominal).reshape(-1, 2, 3, 1), frame, output_place).reshape(-1, 6)
    wrench[is_ramped] = at_end.wrench[target[is_ramped]]
    spread = forces.spread_at(nominal)
    sigma = np.zeros_like(wrench)
    if spread is not None:
        sigma = norm(output_axes.in_frame_axes(spread, frame, output_place)).reshape(-1, 6)
    return _without_repeated_forces(Knots(target, share, wrench, frame, sigma, forces.factor_at(nominal), is_ramped))


def first_pass_knots(knots: Knots, line: Ints) -> tuple[Knots, Ints]:
    """Return the knots of the first pass of each line, in order of lines, and targets of passes with another force.

    In loops a line is executed several times (passes); a force file has one force for all passes of a line.

    :param knots: knots of all passes, see `piece_knots`: their `motion` is a row of targets.
    :param line: (K,) line of each target in the written program.
    :returns: the knots, and the targets (n,) of later passes whose force differs from that of the first, ascending.
    """
    target, begin, count = np.unique(knots.motion, return_index=True, return_counts=True)
    # row of `target` with the first pass of each line; and for each target the index of its line
    _, first, line_of_target = np.unique(line[target], return_index=True, return_inverse=True)
    first_pass = first[line_of_target]  # of the line of each target, as a row of `target`
    later_passes = np.flatnonzero(first_pass != np.arange(len(target)))
    knots_of_pass = [slice(start, start + size) for start, size in zip(begin.tolist(), count.tolist(), strict=True)]
    differs = [not _is_same_force(knots, knots_of_pass[k], knots_of_pass[first_pass[k]]) for k in later_passes.tolist()]
    rows = np.flatnonzero(np.isin(knots.motion, target[first]))
    rows = rows[np.argsort(line[knots.motion[rows]], kind="stable")]
    return knots.take(rows), target[later_passes[np.array(differs, dtype=np.bool_)]]


def _is_same_force(knots: Knots, first: slice, second: slice) -> bool:
    """Return whether two passes of a line have the same force; `first` and `second` are the knots of the passes."""
    if first.stop - first.start != second.stop - second.start or (knots.frame[first] != knots.frame[second]).any():
        return False
    return all(
        np.abs(values[first] - values[second]).max() <= tolerance
        for values, tolerance in (
            (knots.t, _PLACE_TOLERANCE),
            (knots.wrench, _FORCE_TOLERANCE),
            (knots.sigma, _FORCE_TOLERANCE),
            (knots.factor, _FACTOR_TOLERANCE),
        )
    )


def _knot_places(forces: PathForces, targets: Targets) -> tuple[Ints, Array]:
    """Return the p places on pieces where the force is given: row of the target (p,) and share (p,) of its piece.

    A piece is the part of a motion up to a target; its share is 0 at its start, 1 at its end. Ramped forces build up at
    the start of each written motion by themselves, so the end of the piece is enough. Other forces are given at the
    start of the piece, at the knots inside it (the places where the source of forces states a wrench), and at its end.
    """
    begin, end = targets.begin(np.arange(len(targets))), targets.t  # of the piece, as t on its motion: 0 … 1
    # `forces.place` is motion + t of each knot, ascending: knots from `low` to `high` (exclusive) are inside the piece
    low = np.searchsorted(forces.place, targets.motion + begin + _PLACE_TOLERANCE)
    high = np.maximum(np.searchsorted(forces.place, targets.motion + end - _PLACE_TOLERANCE), low)
    count = np.where(forces.ramped[targets.motion], 1, high - low + 2)  # places on each piece
    target = np.repeat(np.arange(len(targets)), count)
    index = ragged_range(count)
    is_start, is_end = index == 0, index == count[target] - 1  # a single place is the end
    # start and end of a piece need no knot: knot 0 is a placeholder, whose share is not used
    knot = np.where(is_end | is_start, 0, low[target] + index - 1)
    share = (forces.t[knot] - begin[target]) / (end - begin)[target]
    return target, np.where(is_end, 1.0, np.where(is_start, 0.0, share))


def _without_repeated_forces(knots: Knots) -> Knots:
    """Return all knots of pieces with changing force, and the last knot of pieces with constant force.

    :param knots: their `motion` is the row of the target at the end of the piece.
    """
    last = np.flatnonzero(np.diff(knots.motion, append=-1) != 0)
    last_knot = last[np.searchsorted(last, np.arange(len(knots)))]  # of the piece of each knot
    columns = np.hstack([knots.wrench, knots.sigma, knots.factor[:, None]])
    differs = largest(columns - columns[last_knot]) > _LEAST_CHANGE
    has_change = np.zeros(len(knots), dtype=np.bool_)
    has_change[last_knot[differs]] = True
    is_kept = has_change[last_knot]
    is_kept[last] = True
    return knots.take(is_kept)


def _piece_frames(forces: PathForces, targets: Targets) -> Ints:
    """Return the frame (K,) in which the force on the piece to each of K targets is constant or changes linearly."""
    frame, turn = forces.frame[targets.motion], forces.axes.path.turn[targets.motion]
    turns_tool = turn > LEAST_TURN
    keeps_frame = (frame == FEED) & ((targets.kind == CIRC) | turns_tool) | (frame == TOOL) & turns_tool
    return np.where(keeps_frame, frame, BASE)
