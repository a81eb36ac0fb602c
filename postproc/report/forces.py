"""`forces.csv`: the forces of the written program, by its lines."""

from __future__ import annotations

import numpy as np

from postproc.correction import Result
from postproc.decimals import Bytes, Number, rows_of_csv
from postproc.forces import Knots
from postproc.frames import Array
from postproc.program import FORCE_FRAMES, PTP, Ints

COLUMNS = ("line", "line_end", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "frame")
"""Columns of the file, in order, where the force is one for each line; t follows where it is not, then sigmas."""
_SIGMAS = ("sFx", "sFy", "sFz", "sMx", "sMy", "sMz")
_DECIMALS = np.array([3, 3, 3, 4, 4, 4])
_PLACE = 9


def forces_csv(result: Result) -> bytes | None:
    """Return the file: read with the written program, it gives each piece the force that it was corrected for.

    Neighbouring lines with the same force share a row. None where the program needs no such file.
    """
    if result.carried is None:
        return None
    knots = result.carried.take(result.program.motions.kind[result.motion[result.carried.motion]] != PTP)
    halves = [half for wrench in (knots.wrench, knots.sigma) for half in np.split(wrench, 2, axis=1)]
    values = np.hstack([np.round(half, places) for half, places in zip(halves, _DECIMALS[[0, 3, 0, 3]], strict=True)])
    first, last = _shared(knots, values)
    line = result.output_line[knots.motion].astype(float)
    names = np.array([list(name.ljust(4).encode()) for name in FORCE_FRAMES], dtype=np.uint8)
    columns: list[Number | Bytes] = [Number.of(line[rows], 0) for rows in (first, last)]
    columns += [Number.of(values[first, index], int(places)) for index, places in enumerate(_DECIMALS)]
    columns.append(np.where(names == ord(" "), 0, names).astype(np.uint8)[knots.frame[first]])
    header = list(COLUMNS)
    if not knots.ramped.all():
        header.append("t")
        columns.append(Number.of(np.where(knots.ramped[first], np.nan, knots.t[first]), _PLACE))
    for index, name in enumerate(_SIGMAS):
        if values[:, 6 + index].any():
            header.append(name)
            columns.append(Number.of(values[first, 6 + index], int(_DECIMALS[index])))
    return (",".join(header) + "\n").encode() + rows_of_csv(columns)


def _shared(knots: Knots, values: Array) -> tuple[Ints, Ints]:
    """Return the first and the last knot of each row of the file.

    Neighbouring targets share one if each has but one knot, and these are the same.
    """
    same_target = np.diff(knots.motion) == 0
    several = np.append(same_target, False) | np.append(False, same_target)
    differs = (np.diff(values, axis=0) != 0.0).any(axis=1) | (np.diff(knots.frame) != 0)
    differs |= (np.diff(knots.ramped) != 0) | (np.diff(knots.motion) != 1) | several[1:] | several[:-1]
    first = np.flatnonzero(np.append(True, differs)[: len(knots)])
    return first, np.append(first[1:], len(knots))[: len(first)] - 1
