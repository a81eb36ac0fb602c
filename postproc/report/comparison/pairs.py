"""`part.compare.pairs.csv`: one row for each Cartesian target of either program."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc.chunks import chunks
from postproc.comparison import Comparison
from postproc.decimals import Number, rows_of_csv
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, xyzabc_from_pose

_XYZABC = ("X", "Y", "Z", "A", "B", "C")
_NUMBERS = (
    *(f"{name}_nominal" for name in _XYZABC),
    *(f"{name}_corrected" for name in _XYZABC),
    "offset_mm", "rotation_deg", "speed_nominal_mm_per_s", "speed_corrected_mm_per_s",
    "cut_nominal_mm", "cut_corrected_mm", "between_mm",
)  # fmt: skip
_PLACES = (6,) * 13 + (6, 3, 3, 6, 6, 6)
PAIR_COLUMNS = ("state", "nominal_line", "corrected_line", "rapid", *_NUMBERS)
"""Columns of the file, in order."""
_STATES = ("pair", "inserted", "only_nominal", "only_corrected")


def pairs_csv(found: Comparison) -> Iterator[bytes]:
    """Yield the file in pieces: in the order of the second program, targets of the first alone behind their neighbour.

    Numbers that a target does not have are empty. Poses are in the nominal `$BASE` for pairs, else in their own.
    """
    yield (",".join(PAIR_COLUMNS) + "\n").encode()
    one, other = found.nominal.motions, found.corrected.motions
    pair, alone = found.pair, found.only_nominal
    nominal = np.concatenate(
        [pair[:, 0], np.full(len(found.inserted), -1), alone, np.full(len(found.only_corrected), -1)]
    )
    corrected = np.concatenate([pair[:, 1], found.inserted, np.full(len(alone), -1), found.only_corrected])
    state = np.repeat(np.arange(4), [len(pair), len(found.inserted), len(alone), len(found.only_corrected)])
    before = np.append(-1, pair[:, 1])[np.searchsorted(pair[:, 0], alone)]
    order = np.lexsort((state == 2, np.concatenate([corrected[state < 2], before, found.only_corrected])))
    unknown = np.full(len(order), np.nan)
    poses = [np.full((len(order), 6), np.nan) for _ in range(2)]
    poses[0][nominal >= 0] = xyzabc_from_pose(one.target[nominal[nominal >= 0]])
    poses[1][: len(pair)] = xyzabc_from_pose(found.pose)
    rest = np.flatnonzero((corrected >= 0) & (state != 0))
    poses[1][rest] = xyzabc_from_pose(other.target[corrected[rest]])

    def of_pairs(values: Array | None) -> Array:
        out = unknown.copy()
        if values is not None:
            out[: len(pair)] = values
        return out

    speeds = (np.where(rows >= 0, m.feed[rows], np.nan) * MM_PER_M for m, rows in ((one, nominal), (other, corrected)))
    cuts = (None, None) if found.cuts is None else (found.cuts.nominal, found.cuts.corrected)
    numbers = np.column_stack(
        [
            *poses,
            of_pairs(found.distance * MM_PER_M),
            of_pairs(found.rotation * DEG_PER_RAD),
            *speeds,
            *(of_pairs(None if off is None else norm(off) * MM_PER_M) for off in cuts),
            of_pairs(found.between * MM_PER_M),
        ]
    )[order]
    rapid = np.where(nominal >= 0, one.rapid[nominal], other.rapid[corrected]).astype(float)[order]
    lines = [np.where(rows >= 0, m.line[rows], np.nan)[order] for m, rows in ((one, nominal), (other, corrected))]
    names = np.array([name.ljust(len(_STATES[3]), "\0").encode() for name in _STATES])
    names = np.frombuffer(names[state[order]].tobytes().ljust(1), dtype=np.uint8)[: len(order) * len(_STATES[3])]
    names = names.reshape(len(order), len(_STATES[3]))
    for part in chunks(len(order)):
        columns = [
            *(Number.of(values[part], 0) for values in (*lines, rapid)),
            *(Number.of(numbers[part, index], places) for index, places in enumerate(_PLACES)),
        ]
        yield rows_of_csv([names[part], *columns])
