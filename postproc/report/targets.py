"""`targets.csv`: one row for each Cartesian target written."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc.chunks import chunks
from postproc.correction import Result
from postproc.decimals import Bytes, Number, rows_of_csv
from postproc.dialects import registry
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, xyzabc_from_pose
from postproc.program import WRENCH, Bools, Ints
from postproc.robot import JOINTS

_XYZABC = ("X", "Y", "Z", "A", "B", "C")
COLUMNS = (
    "output_line", "source_line", "t", "rapid",
    *_XYZABC, *(f"{name}_cmd" for name in _XYZABC),
    *WRENCH,
    "dX", "dY", "dZ", "before_mm", "after_mm", "u95_mm",
    *JOINTS,
)  # fmt: skip
"""Columns of the file, in order."""
CARRIAGE = "E1"
"""One more where the robot is carried by a linear axis: where that stands [mm]."""

_NOMINAL = (6, 6, 6, 6, 6, 6)
_WRENCH_DECIMALS = (3, 3, 3, 4, 4, 4)
_LENGTH, _ANGLE, _PLACE = 6, 5, 9


def targets_csv(result: Result) -> Iterator[bytes]:
    """Yield the file in pieces of some thousand rows.

    Units: mm, degrees, N, N·m; `t` in (0, 1]; `u95_mm` is empty where the model has no covariance.
    """
    m = result.program.motions
    places = registry.by_name(result.program.dialect).command_decimals
    carriage = result.program.carriage
    yield (",".join(COLUMNS if carriage is None else (*COLUMNS, CARRIAGE)) + "\n").encode()
    for part in chunks(len(result)):
        motion = result.motion[part]
        yield _rows(
            (result.output_line[part], m.line[motion], result.t[part], m.rapid[motion]),
            (result.nominal[part], result.printed[part], places, result.wrench[part]),
            (result.deflection[part], norm(result.deviation_before[part]), norm(result.deviation_after[part])),
            None if result.bound is None else result.bound[part],
            result.q[part],
            None if carriage is None else carriage.at(motion, result.t[part]),
        )


def _rows(
    origin: tuple[Ints, Ints, Array, Bools],
    command: tuple[Array, Array, tuple[int, ...], Array],
    deviation: tuple[Array, Array, Array],
    bound: Array | None,
    q: Array,
    carriage: Array | None,
) -> bytes:
    (output_line, source_line, t, rapid), (nominal, printed, places, wrench) = origin, command
    deflection, *distances = deviation
    columns: list[Number | Bytes] = [
        Number.of(output_line.astype(float), 0),
        Number.of(source_line.astype(float), 0),
        Number.of(t, _PLACE),
        Number.of(rapid.astype(float), 0),
        *_block(xyzabc_from_pose(nominal), _NOMINAL),
        *_block(printed, places),
        *_block(wrench, _WRENCH_DECIMALS),
        *_block(deflection * MM_PER_M, (_LENGTH,) * 3),
        *(Number.of(values * MM_PER_M, _LENGTH) for values in distances),
        np.empty((len(t), 0), dtype=np.uint8) if bound is None else Number.of(bound * MM_PER_M, _LENGTH),
        *_block(q * DEG_PER_RAD, (_ANGLE,) * 6),
        *([] if carriage is None else [Number.of(carriage * MM_PER_M, _LENGTH)]),
    ]
    return rows_of_csv(columns)


def _block(values: Array, places: tuple[int, ...]) -> list[Number]:
    return [Number.of(values[:, index], count) for index, count in enumerate(places)]
