"""`targets.csv`: one row for each Cartesian target written."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc import decimals
from postproc.decimals import Bytes
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, xyzabc_from_pose
from postproc.pipeline import Result

_XYZABC = ("X", "Y", "Z", "A", "B", "C")
COLUMNS = (
    "output_line", "source_line", "t", "rapid",
    *_XYZABC, *(f"{name}_cmd" for name in _XYZABC),
    "Fx", "Fy", "Fz", "Mx", "My", "Mz",
    "dX", "dY", "dZ", "before_mm", "after_mm", "u95_mm",
    "A1", "A2", "A3", "A4", "A5", "A6",
)  # fmt: skip
"""Columns of the file, in order."""

_NOMINAL = (6, 6, 6, 6, 6, 6)
_COMMAND = {"gcode": (4, 4, 4, 5, 5, 5), "krl": (6, 6, 6, 6, 6, 6)}
"""Decimals of commanded poses by dialect: those of the KRL written from G-code; the most that KRL input has."""
_WRENCH = (3, 3, 3, 4, 4, 4)
_LENGTH, _ANGLE, _PLACE = 6, 5, 9
_CHUNK = 8192


def targets_csv(result: Result) -> Iterator[bytes]:
    """Yield the file in pieces of some thousand rows.

    Units: mm, degrees, N, N·m; `t` in (0, 1]; `u95_mm` is empty where the model has no covariance.
    """
    yield (",".join(COLUMNS) + "\n").encode()
    for begin in range(0, len(result), _CHUNK):
        yield _rows(result, slice(begin, begin + _CHUNK))


def _rows(result: Result, part: slice) -> bytes:
    motion = result.motion[part]
    moved = result.program.motions
    bound = np.full(len(motion), np.nan) if result.bound is None else result.bound[part]
    columns: list[Bytes] = [
        decimals.fixed(result.output_line[part].astype(float), 0),
        decimals.fixed(moved.line[motion].astype(float), 0),
        decimals.fixed(result.t[part], _PLACE),
        decimals.fixed(moved.rapid[motion].astype(float), 0),
        *_block(xyzabc_from_pose(result.nominal[part]), _NOMINAL),
        *_block(result.printed[part], _COMMAND[result.program.dialect]),
        *_block(result.wrench[part], _WRENCH),
        *_block(result.deflection[part] * MM_PER_M, (_LENGTH,) * 3),
        *(decimals.fixed(values * MM_PER_M, _LENGTH) for values in (result.before[part], result.after[part], bound)),
        *_block(result.q[part] * DEG_PER_RAD, (_ANGLE,) * 6),
    ]
    parts: list[Bytes | bytes] = [piece for column in columns for piece in (column, b",")]
    parts[-1] = b"\n"
    return decimals.lines(parts)


def _block(values: Array, places: tuple[int, ...]) -> list[Bytes]:
    return [decimals.fixed(values[:, index], count) for index, count in enumerate(places)]
