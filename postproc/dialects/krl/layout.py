"""Places of the numbers of a program in its files: what the reader passes to the writer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.dialects.krl.execution import Execution
from postproc.dialects.krl.language.motion_statements import MotionStatement, Trigger
from postproc.dialects.krl.language.source import Source
from postproc.frames import Array
from postproc.program import Bools, Carriage, Document, Ints, Places

Offsets = NDArray[np.int32]
ORIENTATIONS = FREE, CONSTANT, JOINT, IGNORE = "#VAR", "#CONSTANT", "#JOINT", "#IGNORE"
"""Values of `$ORI_TYPE` (KUKA, System Variables)."""


class Elements(Struct, frozen=True, eq=False):
    """N points ``P[I]`` of an array, to which a loop moves.

    :param row: (N,) motion to each point.
    :param literal: (N, 2) span of each point in the data list `source`.
    :param source: the `.dat` that declares the array.
    :param name: name of the array, upper case.
    """

    row: Ints
    literal: Ints
    source: Source
    name: str


class Layout(Struct, frozen=True, eq=False):
    """Where the texts of M motions are. Offsets count characters from the beginning of the file of a motion (`source`).

    :param execution: the program in the order in which it runs.
    :param trace_row: (M,) 1-based rows of the trace (`execution.trace`): the lines in execution order.
    :param notes: rows of the trace with the force comments of the program, in order.
    :param numbers: (M, 6) X, Y, Z [mm], A, B, C [deg] that the text commands, missing ones filled in with what the
        controller keeps; for axis and relative targets the Cartesian numbers they amount to.
    :param is_missing: (M, 6) True where the text does not give the component.
    :param target_start: (M,) offset of the target; for `elements`, offset of the point in the data list.
    :param relative_spans: (M, 8, 2) spans of the texts of X, Y, Z, A, B, C, S, T, counted from `target_start`; 0 where
        missing, and all 0 for motions in `statements` (their numbers may be in another line). See `spans`.
    :param keyword: (M,) offset of the instruction.
    :param target: (M, 2) span of the target in the statement: ``{…}``, a name or a chain.
    :param tail: (M, 2) span of the text behind the target that inserted targets repeat: approximation, WITH.
    :param via_spans: (M, 3, 2) spans of X, Y, Z of the auxiliary points of circles; −1 as for `spans`.
    :param via_target: (M, 2) span of the auxiliary point; −1 as for `spans`.
    :param starts_from_joints: (M,) True where the controller's previous position is an axis target or the start.
    :param orientation: (M,) index of `$ORI_TYPE` in `ORIENTATIONS`; 0 for PTP, which does not use `$ORI_TYPE`.
    :param ignores_orientation: (M,) True where `$ORI_TYPE` makes the controller ignore A, B, C of the text, and the
        orientation that it commands differs from them.
    :param turns_with_path: (M,) True for circles with which the tool turns (``$CIRC_TYPE=#PATH``).
    :param is_wrist_led: (M,) True for lines on which the wrist axes turn the tool (``$ORI_TYPE=#JOINT``).
    :param drops_via_orientation: (M,) True for SCIRC whose auxiliary point has A, B, C that must not count once the
        circle is corrected.
    :param is_distance_known: (M,) True where `$APO.CDIS` is known, so that inserted targets can be approximated.
    :param is_in_spline_block: (M,) True in spline blocks, where the robot passes the targets without approximation.
    :param statements: row → statement, for motions that are not plain lines: named points, chains, CA, relative and
        axis targets.
    :param elements: points of motions of loops; these motions are not in `statements`.
    :param types: declared type by variable, upper case.
    :param global_names: variables declared GLOBAL.
    :param followed_names: rows of the trace and offsets of names whose use the reader followed.
    :param copies: pairs of names, upper case: a variable that was copied as a point, and the variable that got the
        copy.
    :param triggers: TRIGGER statements, in order.
    :param carriage: the linear axis E1 that carries the robot; None without it.
    :param resume_place: place, as text, of a RESUME in another file that goes back to the program; empty without it.
    :param documents: joined text, and `.dat`, of a program in several files; empty for a program in one file.
    :param files: name of each `.src` of a program in several files, and the number of its first line in the joined
        text; empty for a program in one file.
    """

    execution: Execution
    trace_row: Ints
    notes: tuple[int, ...]
    numbers: Array
    is_missing: Bools
    target_start: Offsets
    relative_spans: NDArray[np.unsignedinteger[Any]]
    keyword: Offsets
    target: Offsets
    tail: Offsets
    via_spans: Offsets
    via_target: Ints
    starts_from_joints: Bools
    orientation: Ints
    ignores_orientation: Bools
    turns_with_path: Bools
    is_wrist_led: Bools
    drops_via_orientation: Bools
    is_distance_known: Bools
    is_in_spline_block: Bools
    statements: Mapping[int, MotionStatement]
    elements: tuple[Elements, ...]
    types: Mapping[str, str]
    global_names: frozenset[str]
    followed_names: frozenset[tuple[int, int]]
    copies: frozenset[tuple[str, str]]
    triggers: tuple[Trigger, ...]
    carriage: Carriage | None = None
    resume_place: str = ""
    documents: tuple[Document, ...] = ()
    files: tuple[tuple[str, int], ...] = ()

    def spans(self, rows: Ints | slice, columns: slice = slice(None)) -> Offsets:
        """Return the spans of the texts of X, Y, Z, A, B, C, S, T of n motions (n, 8, 2); −1 where missing.

        Spans are offsets in the file of the motion; for array elements (`elements`), in the data list that declares
        them.

        :param rows: (n,) the motions.
        :param columns: the components to return; all eight by default.
        """
        offsets = self.relative_spans[rows, columns].astype(np.int32)
        # 0 in `relative_spans`: missing
        return np.where(offsets > 0, offsets + self.target_start[rows, None, None], -1)

    def places(self, rows: Ints) -> Places | None:
        """Return the files and lines of motions; None if the whole program is in one file and nothing is unrolled.

        :param rows: (n,) the motions.
        """
        trace = self.execution.trace
        if trace.is_file and not self.files:  # lines of the program as it was given
            return None
        names = tuple(source.document.name for source in trace.sources)
        file, line = (column[self.trace_row[rows] - 1].astype(np.int64) for column in (trace.file, trace.line))
        if self.files:  # lines of the joined text are numbered through all files
            first_lines = np.array([number for _, number in self.files])
            in_joined_text = np.array([name == self.documents[0].name for name in names])[file]
            # the last of the joined files that begins at or before the line
            joined_file = np.searchsorted(first_lines, line, side="right") - 1
            file = np.where(in_joined_text, len(names) + joined_file, file)  # their names follow the other names
            line = np.where(in_joined_text, line - first_lines[joined_file] + 1, line)
            names = (*names, *(name for name, _ in self.files))
        return Places(names, file, line)

    def source(self, row: int) -> Source:
        """Return the file that contains a motion.

        :param row: index of the motion, from 0.
        """
        return self.execution.trace.source(self.trace_row.item(row))

    def orientation_types(self, rows: Ints) -> NDArray[np.str_]:
        """Return `$ORI_TYPE` (n,), such as ``#VAR``, of motions (n,)."""
        return np.asarray(np.array(ORIENTATIONS)[self.orientation[rows]])
