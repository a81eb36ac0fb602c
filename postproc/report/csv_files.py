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
"""Columns of the file, in order."""
CARRIAGE = "E1"
"""A further column if the robot is on a linear axis: the position of that axis [mm]."""

_NOMINAL = (6, 6, 6, 6, 6, 6)
_WRENCH_DECIMALS = (3, 3, 3, 4, 4, 4)
"""Decimals of poses [mm, deg], and of forces [N] and moments [N·m]."""
_LENGTH, _ANGLE, _PLACE = 6, 5, 9
"""Decimals of lengths [mm], a nanometre; of angles [deg]; and of t, which is a place along a motion."""


def targets_csv(result: Result) -> Iterator[bytes]:
    """Yield targets.csv, one row for each written target, in pieces of some thousand rows.

    Units: mm, degrees, N, N·m; `t` in (0, 1]; `u95_mm` is empty where the model has no covariance.
    """
    carriage = result.program.carriage
    yield (",".join(TARGET_COLUMNS if carriage is None else (*TARGET_COLUMNS, CARRIAGE)) + "\n").encode()
    for rows in chunks(len(result)):
        yield _target_rows(result, rows)


def _target_rows(result: Result, rows: slice) -> bytes:
    """Return the rows of targets.csv for some of the targets."""
    m, motion, t = result.program.motions, result.motion[rows], result.t[rows]
    command_decimals = registry.dialect_of_name(result.program.dialect).command_decimals
    no_bound = np.empty((len(t), 0), dtype=np.uint8)  # no bytes: an empty cell in each row
    columns: list[Number | Bytes] = [
        Number.of(result.output_line[rows].astype(float), 0),
        Number.of(m.line[motion].astype(float), 0),
        Number.of(t, _PLACE),
        Number.of(m.rapid[motion].astype(float), 0),
        *_number_columns(xyzabc_from_pose(result.nominal[rows]), _NOMINAL),
        *_number_columns(result.printed[rows], command_decimals),
        *_number_columns(result.wrench[rows], _WRENCH_DECIMALS),
        *_number_columns(result.deflection[rows] * MM_PER_M, (_LENGTH,) * 3),
        Number.of(norm(result.deviation_before[rows]) * MM_PER_M, _LENGTH),
        Number.of(norm(result.deviation_after[rows]) * MM_PER_M, _LENGTH),
        no_bound if result.bound is None else Number.of(result.bound[rows] * MM_PER_M, _LENGTH),
        *_number_columns(result.q[rows] * DEG_PER_RAD, (_ANGLE,) * 6),
    ]
    if result.program.carriage is not None:
        columns.append(Number.of(result.program.carriage.at(motion, t) * MM_PER_M, _LENGTH))
    return rows_of_csv(columns)


def _number_columns(values: Array, decimals: tuple[int, ...]) -> list[Number]:
    """Return the columns of values (n, k) as numbers to write, each with its number of decimals."""
    return [Number.of(values[:, index], count) for index, count in enumerate(decimals)]


FORCE_COLUMNS = ("line", "line_end", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "frame")
"""Columns of the file, in order, where the force is one for each line; t follows where it is not, then sigmas."""
_SIGMAS = ("sFx", "sFy", "sFz", "sMx", "sMy", "sMz")
_DECIMALS = np.array([3, 3, 3, 4, 4, 4])
"""Decimals of forces [N] and moments [N·m], as in force comments."""
_PLACE = 9


def forces_csv(result: Result) -> bytes | None:
    """Return forces.csv of a written program: the force that each of its pieces was corrected for.

    Neighbouring lines with the same force share a row. None where the program needs no such file.
    """
    knots = _file_forces(result)
    return None if knots is None else _force_rows(knots, result.output_line)


def forces_by_module(result: Result) -> dict[str, bytes]:
    """Return forces.csv of each module of a written program, by its own lines: file name → content."""
    contents, first_line, knots = dict[str, bytes](), 0, _file_forces(result)
    if knots is None:
        return contents
    for document, (first, last) in zip(result.documents, pairwise((*result.modules, len(result))), strict=True):
        module_knots = knots.take((knots.motion >= first) & (knots.motion < last))
        contents[f"{Path(document.name).stem}.forces.csv"] = _force_rows(module_knots, result.output_line - first_line)
        first_line += document.text.count("\n")
    return contents


def _file_forces(result: Result) -> Knots | None:
    """Return the forces that a file must give to the written program, without PTP; None where it needs no file."""
    if result.file_forces is None:
        return None
    return result.file_forces.take(result.program.motions.kind[result.motion[result.file_forces.motion]] != PTP)


def _force_rows(knots: Knots, output_line: Ints) -> bytes:
    """Return forces.csv, header and rows.

    :param knots: forces; `motion` is the row of a target, as of `forces.piece_knots`.
    :param output_line: (K,) line of each target in the file.
    """
    # rounded as printed before rows are compared; columns: wrench 0…5, standard deviations 6…11, factor 12 [%]
    halves = [half for wrench in (knots.wrench, knots.sigma) for half in np.split(wrench, 2, axis=1)]
    values = np.hstack([np.round(half, places) for half, places in zip(halves, _DECIMALS[[0, 3, 0, 3]], strict=True)])
    values = np.column_stack([values, np.round(100.0 * knots.factor, 3)])
    first, last = _knots_of_rows(knots, values)
    line = output_line[knots.motion].astype(float)
    names = np.array([list(name.ljust(4).encode()) for name in FORCE_FRAMES], dtype=np.uint8)
    columns: list[Number | Bytes] = [Number.of(line[rows], 0) for rows in (first, last)]
    columns += [Number.of(values[first, index], int(places)) for index, places in enumerate(_DECIMALS)]
    columns.append(np.where(names == ord(" "), 0, names).astype(np.uint8)[knots.frame[first]])
    header = list(FORCE_COLUMNS)
    if not knots.ramped.all():
        header.append("t")
        columns.append(Number.of(np.where(knots.ramped[first], np.nan, knots.t[first]), _PLACE))
    for index, name in enumerate(_SIGMAS):
        if values[:, 6 + index].any():
            header.append(name)
            columns.append(Number.of(values[first, 6 + index], int(_DECIMALS[index])))
    if values[:, 12].any():
        header.append("factor_percent")
        columns.append(Number.of(values[first, 12], 3))
    return (",".join(header) + "\n").encode() + rows_of_csv(columns)


def _knots_of_rows(knots: Knots, values: Array) -> tuple[Ints, Ints]:
    """Return the indices (R,) of the first and of the last knot of each row of forces.csv.

    Neighbouring targets share a row if each has one knot, and these are the same.

    :param values: (n, 13) numbers of each knot as printed.
    """
    same_target = np.diff(knots.motion) == 0
    has_many_knots = np.append(same_target, False) | np.append(False, same_target)
    # a row ends where anything that it states changes, or where a target has knots of its own
    differs = (np.diff(values, axis=0) != 0.0).any(axis=1) | (np.diff(knots.frame) != 0)
    differs |= (np.diff(knots.ramped) != 0) | (np.diff(knots.motion) != 1) | has_many_knots[1:] | has_many_knots[:-1]
    first = np.flatnonzero(np.append(True, differs)[: len(knots)])
    return first, np.append(first[1:], len(knots))[: len(first)] - 1
