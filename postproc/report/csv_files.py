"""`targets.csv` and `forces.csv`: the targets of a written program, and the forces along its lines."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from postproc.chunks import chunks
from postproc.correction import Result
from postproc.decimals import Bytes, Number, rows_of_csv
from postproc.dialects import registry
from postproc.forces import Knots
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, xyzabc_from_pose
from postproc.program import FORCE_FRAMES, PTP, WRENCH, Ints
from postproc.robot import JOINTS

_XYZABC = ("X", "Y", "Z", "A", "B", "C")
TARGET_COLUMNS = (
    "output_line", "source_line", "t", "rapid",
    *_XYZABC, *(f"{name}_cmd" for name in _XYZABC),
    *WRENCH,
    "dX", "dY", "dZ", "before_mm", "after_mm", "u95_mm",
    *JOINTS,
)  # fmt: skip
"""Columns of targets.csv, in order."""
CARRIAGE = "E1"
"""A further column if the robot is on a linear axis: the position of that axis [mm]."""

_POSE_DECIMALS = (6, 6, 6, 6, 6, 6)
"""Decimals of X, Y, Z [mm] and A, B, C [deg] of nominal poses."""
_WRENCH_DECIMALS = (3, 3, 3, 4, 4, 4)
"""Decimals of forces [N] and moments [N·m], as in force comments."""
_LENGTH_DECIMALS, _ANGLE_DECIMALS, _T_DECIMALS = 6, 5, 9
"""Decimals of lengths [mm], of joint angles [deg], and of t, the place along a motion."""


def targets_csv(result: Result) -> Iterator[bytes]:
    """Yield targets.csv, one row for each written target, in pieces of some thousand rows.

    Units: mm, degrees, N, N·m; `t` in (0, 1]; `u95_mm` is empty where the model has no covariance.
    """
    carriage = result.program.carriage
    yield (",".join(TARGET_COLUMNS if carriage is None else (*TARGET_COLUMNS, CARRIAGE)) + "\n").encode()
    for rows in chunks(len(result)):
        yield _target_rows(result, rows)


def _target_rows(result: Result, rows: slice) -> bytes:
    """Return the rows of targets.csv for the targets `rows`, in the order of `TARGET_COLUMNS`."""
    m, motion, t = result.program.motions, result.motion[rows], result.t[rows]
    command_decimals = registry.dialect_of_name(result.program.dialect).command_decimals
    empty_cells = np.empty((len(t), 0), dtype=np.uint8)  # texts without a byte
    columns: list[Number | Bytes] = [
        Number.of(result.output_line[rows].astype(float), 0),  # whole numbers: no decimals
        Number.of(m.line[motion].astype(float), 0),
        Number.of(t, _T_DECIMALS),
        Number.of(m.rapid[motion].astype(float), 0),
        *_number_columns(xyzabc_from_pose(result.nominal[rows]), _POSE_DECIMALS),
        *_number_columns(result.printed[rows], command_decimals),
        *_number_columns(result.wrench[rows], _WRENCH_DECIMALS),
        *_number_columns(result.deflection[rows] * MM_PER_M, (_LENGTH_DECIMALS,) * 3),
        Number.of(norm(result.deviation_before[rows]) * MM_PER_M, _LENGTH_DECIMALS),
        Number.of(norm(result.deviation_after[rows]) * MM_PER_M, _LENGTH_DECIMALS),
        empty_cells if result.bound is None else Number.of(result.bound[rows] * MM_PER_M, _LENGTH_DECIMALS),
        *_number_columns(result.q[rows] * DEG_PER_RAD, (_ANGLE_DECIMALS,) * 6),
    ]
    if result.program.carriage is not None:
        columns.append(Number.of(result.program.carriage.at(motion, t) * MM_PER_M, _LENGTH_DECIMALS))
    return rows_of_csv(columns)


def _number_columns(values: Array, decimals: tuple[int, ...]) -> list[Number]:
    """Return the columns of values (n, k) as numbers to write, column j with `decimals[j]` decimals."""
    return [Number.of(values[:, index], count) for index, count in enumerate(decimals)]


FORCE_COLUMNS = ("line", "line_end", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "frame")
"""Columns of every forces.csv, in order.

t follows if a force changes along a line, then standard deviations that are not 0, then factor_percent.
"""
_SIGMA_COLUMNS = ("sFx", "sFy", "sFz", "sMx", "sMy", "sMz")


def forces_csv(result: Result) -> bytes | None:
    """Return forces.csv of a written program: the force that each of its pieces was corrected for.

    Consecutive lines with the same force share a row. None if the program needs no such file.
    """
    knots = _file_forces(result)
    return None if knots is None else _force_rows(knots, result.output_line)


def forces_by_module(result: Result) -> dict[str, bytes]:
    """Return forces.csv of each module of a written program: file name → content; empty if no file is needed.

    Lines are counted in the text of the module.
    """
    # result.output_line counts through the modules as if they were one text; result.modules: first target of each
    contents, preceding_lines, knots = dict[str, bytes](), 0, _file_forces(result)
    if knots is None:
        return contents
    for document, (first, end) in zip(result.documents, pairwise((*result.modules, len(result))), strict=True):
        module_knots = knots.take((knots.motion >= first) & (knots.motion < end))
        contents[f"{Path(document.name).stem}.forces.csv"] = _force_rows(
            module_knots, result.output_line - preceding_lines
        )
        preceding_lines += document.text.count("\n")
    return contents


def _file_forces(result: Result) -> Knots | None:
    """Return the forces of the targets that forces.csv must state, without those of PTP; None if no file is needed.

    No file is needed if comments of the written program state its forces, or if nothing is written.
    """
    knots = result.file_forces  # `knots.motion`: target of each force
    if knots is None:
        return None
    kind = result.program.motions.kind[result.motion[knots.motion]]
    return knots.take(kind != PTP)


def _force_rows(knots: Knots, output_line: Ints) -> bytes:
    """Return forces.csv with header and rows; columns as `FORCE_COLUMNS` says.

    A knot is a force at a place t of the piece to a target, 0 at its begin and 1 at the target. A ramped knot is the
    only one of its piece, and has no t: the force changes to it from that of the piece before.

    :param knots: forces; `knots.motion` is a row of the targets, as of `forces.piece_knots`.
    :param output_line: (K,) line of each target in the written file.
    """
    # rounded as printed before rows are compared; columns: wrench 0…5, standard deviations 6…11, factor 12 [%]
    columns_of_decimals = zip((*knots.wrench.T, *knots.sigma.T), _WRENCH_DECIMALS * 2, strict=True)
    rounded = [np.round(column, decimals) for column, decimals in columns_of_decimals]
    values = np.column_stack([*rounded, np.round(100.0 * knots.factor, 3)])
    first, last = _knots_of_rows(knots, values)
    line = output_line[knots.motion].astype(float)
    # bytes of the names of the frames, one row each; rows_of_csv leaves out zeros
    names = np.array([list(name.ljust(4, "\0").encode()) for name in FORCE_FRAMES], dtype=np.uint8)
    columns: list[Number | Bytes] = [Number.of(line[rows], 0) for rows in (first, last)]
    columns += [Number.of(values[first, index], decimals) for index, decimals in enumerate(_WRENCH_DECIMALS)]
    columns.append(names[knots.frame[first]])
    header = list(FORCE_COLUMNS)
    changes_along_line = not knots.ramped.all()
    if changes_along_line:
        header.append("t")
        columns.append(Number.of(np.where(knots.ramped[first], np.nan, knots.t[first]), _T_DECIMALS))
    for index, name in enumerate(_SIGMA_COLUMNS):
        if values[:, 6 + index].any():
            header.append(name)
            columns.append(Number.of(values[first, 6 + index], _WRENCH_DECIMALS[index]))
    if values[:, 12].any():
        header.append("factor_percent")
        columns.append(Number.of(values[first, 12], 3))
    return (",".join(header) + "\n").encode() + rows_of_csv(columns)


def _knots_of_rows(knots: Knots, values: Array) -> tuple[Ints, Ints]:
    """Return the indices (R,) of the first and of the last knot of each row of forces.csv.

    Consecutive targets share a row if each has a single knot, and these knots have the same force.

    :param values: (n, 13) numbers of each knot as printed.
    """
    same_target = np.diff(knots.motion) == 0
    has_many_knots = np.append(same_target, False) | np.append(False, same_target)
    # differs[i]: knot i + 1 begins a row, as a number differs, or one of both knots is of a target with several knots
    differs = (np.diff(values, axis=0) != 0.0).any(axis=1) | (np.diff(knots.frame) != 0)
    differs |= (np.diff(knots.ramped) != 0) | (np.diff(knots.motion) != 1) | has_many_knots[1:] | has_many_knots[:-1]
    first = np.flatnonzero(np.append(True, differs)[: len(knots)])  # [: len(knots)]: no knots have no rows
    return first, np.append(first[1:], len(knots))[: len(first)] - 1
