"""`part.compare.pairs.csv`: one row for each Cartesian target of either program."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from postproc.chunks import chunks
from postproc.comparison import Comparison
from postproc.decimals import Number, rows_of_csv
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm, xyzabc_from_pose
from postproc.program import Ints, Program

_XYZABC = ("X", "Y", "Z", "A", "B", "C")
_NUMBERS = (
    *(f"{name}_nominal" for name in _XYZABC),
    *(f"{name}_corrected" for name in _XYZABC),
    "offset_mm", "rotation_deg", "speed_nominal_mm_per_s", "speed_corrected_mm_per_s",
    "cut_nominal_mm", "cut_corrected_mm", "between_mm",
)  # fmt: skip
_PLACES = (6,) * 13 + (6, 3, 3, 6, 6, 6)
PAIR_COLUMNS = ("state", "nominal_file", "nominal_line", "corrected_file", "corrected_line", "rapid", *_NUMBERS)
"""Columns of the file, in order."""
_STATES = ("pair", "inserted", "only_nominal", "only_corrected", "passed")


def pairs_csv(found: Comparison) -> Iterator[bytes]:
    """Yield the file in pieces: in the order of the second program, targets of the first alone behind their neighbour.

    Numbers that a target does not have are empty. Poses are in the nominal `$BASE` for pairs, else in their own.
    """
    yield (",".join(PAIR_COLUMNS) + "\n").encode()
    one, other = found.nominal.motions, found.corrected.motions
    pair, alone = found.pair, np.append(found.only_nominal, found.passed)
    nominal = np.concatenate(
        [pair[:, 0], np.full(len(found.inserted), -1), alone, np.full(len(found.only_corrected), -1)]
    )
    corrected = np.concatenate([pair[:, 1], found.inserted, np.full(len(alone), -1), found.only_corrected])
    counts = len(pair), len(found.inserted), len(found.only_nominal), len(found.passed), len(found.only_corrected)
    state = np.repeat([0, 1, 2, 4, 3], counts)
    before = np.append(-1, pair[:, 1])[np.searchsorted(pair[:, 0], alone)]
    order = np.lexsort((np.isin(state, (2, 4)), np.concatenate([corrected[state < 2], before, found.only_corrected])))
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
    names = _words(_STATES, state[order])
    (file, line), (file_two, line_two) = (
        _places(program, rows[order]) for program, rows in ((found.nominal, nominal), (found.corrected, corrected))
    )
    for part in chunks(len(order)):
        columns: list[Number | NDArray[np.uint8]] = [
            names[part], file[part], Number.of(line[part], 0), file_two[part], Number.of(line_two[part], 0),
            Number.of(rapid[part], 0),
            *(Number.of(numbers[part, index], places) for index, places in enumerate(_PLACES)),
        ]  # fmt: skip
        yield rows_of_csv(columns)


def _places(program: Program, rows: Ints) -> tuple[NDArray[np.uint8], Array]:
    """Return file and line of motions (n,) as columns; empty where there is none (−1)."""
    there = rows >= 0
    places = program.places(rows[there])
    line, file = np.full(len(rows), np.nan), np.full(len(rows), len(places.files))
    line[there], file[there] = places.line, places.file
    return _words([*places.files, ""], file), line


def _words(words: Sequence[str], which: Ints) -> NDArray[np.uint8]:
    """Return words as a column of texts (n, width), padded with zeros; quoted where CSV needs it."""
    quoted = ['"' + word.replace('"', '""') + '"' if set(word) & set(',"\r\n') else word for word in words]
    return np.char.encode(quoted, "utf-8").view(np.uint8).reshape(len(quoted), -1)[which]
