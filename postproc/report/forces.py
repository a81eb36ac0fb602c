"""`forces.csv`: the forces of the written program, by its lines."""

from __future__ import annotations

import numpy as np

from postproc import decimals
from postproc.correction import Result
from postproc.program import FORCE_FRAMES, PTP

COLUMNS = ("line", "line_end", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "frame")
"""Columns of the file, in order."""
_DECIMALS = (3, 3, 3, 4, 4, 4)


def forces_csv(result: Result) -> bytes | None:
    """Return the file: read with the written program, it gives each target the force that it was corrected for.

    Neighbouring lines with the same force share a row. None where the program needs no such file.
    """
    if result.carried is None:
        return None
    kind = result.program.motions.kind[result.motion]
    rows = np.flatnonzero(kind != PTP)
    line, frame = result.output_line[rows], result.carried.frame[rows]
    wrench = np.round(result.carried.wrench[rows], _DECIMALS[0])
    wrench[:, 3:] = np.round(result.carried.wrench[rows, 3:], _DECIMALS[3])
    differs = (np.diff(wrench, axis=0) != 0.0).any(axis=1) | (np.diff(frame) != 0) | (np.diff(rows) != 1)
    first = np.flatnonzero(np.concatenate([[True], differs])[: len(rows)])
    last = np.append(first[1:], len(rows))[: len(first)] - 1
    names = np.array([list(name.ljust(4).encode()) for name in FORCE_FRAMES], dtype=np.uint8)
    columns = [decimals.fixed(line[rows].astype(float), 0) for rows in (first, last)]
    columns += [decimals.fixed(wrench[first, index], places) for index, places in enumerate(_DECIMALS)]
    columns.append(np.where(names == ord(" "), 0, names).astype(np.uint8)[frame[first]])
    parts: list[decimals.Bytes | bytes] = [piece for column in columns for piece in (column, b",")]
    return (",".join(COLUMNS) + "\n").encode() + decimals.lines([*parts[:-1], b"\n"])
