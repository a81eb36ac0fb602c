"""Spline blocks: ``SPLINE … ENDSPLINE`` and ``PTP_SPLINE … ENDSPLINE``.

The robot passes the points of a block without a stop and without approximation; ``ENDSPLINE C_SPL`` approximates the
last point. SLIN and SCIRC have the same path as outside of a block; the path of SPL is known at its points alone (KUKA,
KSS 8.x, 'spline motion').
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.names import SPLINES
from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.tokens import word_at
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.language.tree import EndSpline, Spline, Statement
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.dialects.krl.read.motion_reader import MotionReader
from postproc.dialects.krl.read.run import SETTING_ADVICE
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.state import State
from postproc.errors import Issue
from postproc.program import SPL, Bools, Ints, Motions, distinct


class OpenBlock(Struct, frozen=True):
    """A spline block that is not closed yet.

    :ivar row: row of the trace with the first line of the block; `place` is that line in its file.
    :ivar outer_state: state in force before the block.
    :ivar block_state: state in force behind the first line of the block.
    """

    row: int
    place: Place
    outer_state: State
    block_state: State


class SplineBlocks:
    """Follows the spline blocks of a program.

    :ivar open_block: the block that is not closed yet; None if there is none.
    :ivar approximated_ends: rows of the trace with ENDSPLINE C_SPL.
    :ivar end_rows: rows of the trace with ENDSPLINE.
    """

    def __init__(self, settings: Settings, reader: MotionReader) -> None:
        """Begin outside of a spline block."""
        self.settings, self.reader = settings, reader
        self.open_block: OpenBlock | None = None
        self.approximated_ends: list[int] = []
        self.end_rows: list[int] = []

    def follow_line(self, place: Place, stmt: Statement, row: int) -> None:
        """Open or close a spline block.

        :param stmt: SPLINE, PTP_SPLINE or ENDSPLINE.
        :param row: row of the execution trace with the statement.
        :raises ProgramError: the line is not understood, a block is opened inside another, or no block is open.
        """
        if isinstance(stmt, Spline):
            if self.open_block is not None:
                raise place.error(
                    f"{stmt.word} inside of a spline block ({self.open_block.place})",
                    advice="End that block with ENDSPLINE first.",
                )
            state = self.reader.block_state(place, stmt)
            self.open_block = OpenBlock(row, place, self.settings.state, state)
            self.settings.change_state(row, state)
            return
        if self.open_block is None:
            raise place.error(
                "ENDSPLINE without SPLINE",
                advice="Write SPLINE before the first motion of the block, or remove ENDSPLINE.",
            )
        tail = stmt.extra_text if isinstance(stmt, EndSpline) else ""
        if tail.upper() not in ("", "C_SPL"):
            raise place.error(f"{tail!r} is not understood", advice="Check its spelling.")
        if tail:
            self.approximated_ends.append(row)
        self._close_block(place, self.open_block, row)

    def _close_block(self, place: Place, block: OpenBlock, row: int) -> None:
        """Close a spline block: the settings before it are in force again.

        Settings that functions in the motions of the block have changed become unknown.

        :param place: place of ENDSPLINE, in row `row` of the trace.
        """
        end_state = self.settings.state
        changed_fields = block.block_state.differing_fields(end_state) | {
            field for field, _ in set(end_state.uncertain_fields) - set(block.block_state.uncertain_fields)
        }
        self.settings.change_state(row, block.outer_state)
        if changed_fields:
            problem = "a function that a motion of the spline block calls changes what motions depend on"
            self.settings.make_uncertain(row, sorted(changed_fields), place.error(problem, SETTING_ADVICE))
        self.end_rows.append(row)
        self.open_block = None


def check_words(trace: Trace, columns: MotionColumns, block: np.ndarray) -> None:
    """Refuse motions that are not allowed inside or outside of a spline block.

    :param columns: the R motions.
    :param block: (R,) word of the block that contains each motion, such as SPLINE; empty outside of blocks.
    :raises ProgramError: SPL is outside of a block, or a block contains a motion of a kind that it may not contain.
    """
    for row in np.flatnonzero((block != "") | (columns.kind == SPL)).tolist():
        line, start = columns.trace_row.item(row), columns.keyword.item(row)
        text = trace.source(line).text
        word = word_at(text, start, len(text)).removesuffix("_REL")
        if block[row] == "":
            advice = "Write SPLINE before the first of these lines and ENDSPLINE behind the last."
            raise trace.error("SPL outside of a spline block", line, advice)
        if word not in SPLINES[block[row]]:
            advice = f"It may hold {', '.join(SPLINES[block[row]])}."
            raise trace.error(f"{word} in a {block[row]} block", line, advice)


def is_spline(trace: Trace, columns: MotionColumns, indices: Ints) -> Bools:
    """Return which motions (n,) are spline motions: SLIN, SCIRC, SPTP, SPL.

    :param columns: all motions of the program.
    :param indices: (n,) rows of the motions in question.
    """
    file, is_spline_row = trace.file[columns.trace_row[indices] - 1], np.zeros(len(indices), dtype=np.bool_)
    for number, source in enumerate(trace.sources):
        keywords = columns.keyword[indices[file == number]].tolist()
        # the words of other motions do not begin with S
        is_spline_row[file == number] = [source.text[offset] in "sS" for offset in keywords]
    return is_spline_row


def approximated_motions(columns: MotionColumns, is_in_block: Bools, end_lines: list[int]) -> Bools:
    """Return which motions (R,) are approximated: at their ends the robot rounds the corner.

    :param columns: the R motions, with their own approximation.
    :param is_in_block: (R,) True for motions in a spline block, of which only the last can be approximated.
    :param end_lines: rows of the trace with ENDSPLINE C_SPL.
    """
    is_approximated = columns.approximated & ~is_in_block
    last_rows = np.searchsorted(columns.trace_row, end_lines) - 1  # the motion before each; −1: none
    is_approximated[last_rows[last_rows >= 0]] = True
    return np.asarray(is_approximated)


def unknown_path_warning(motions: Motions) -> list[Issue]:
    """Return the warning that the path of SPL motions is not known between their points; empty without SPL."""
    spline_rows = np.flatnonzero(motions.kind == SPL)
    if not len(spline_rows):
        return []
    message = (
        "The path of SPL is not known between its points: these are corrected for the force at each of them, nothing "
        "is inserted between, and statements on the path between targets leave SPL out."
    )
    line = motions.line[spline_rows]
    lines = tuple(distinct(line).tolist())
    return [Issue("warning", "spline", message, int(line[0]), count=len(spline_rows), lines=lines)]
