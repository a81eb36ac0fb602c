"""Probed points of a test part: `probing.csv`, and the same filled in."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc import files
from postproc.chunks import Columns
from postproc.decimals import without_negative_zero
from postproc.errors import MeasurementError
from postproc.frames import M_PER_MM, MM_PER_M, Array, norm
from postproc.program import Bools, Ints
from postproc.testpart.features import Placement, Program

PROGRAM, BASE = "program", "base"
COLUMNS = ("source_line", "t", "X", "Y", "Z", "nx", "ny", "nz", "deviation_mm")
MASS = "mass_kg"
_MOST_MASS = 500.0
"""Largest mass of a weight [kg]: a larger number is another quantity or unit."""
_NORMAL_TOLERANCE = 1e-3
"""Tolerance of the length 1 of a normal in a file, which has three or four decimals (assumed)."""
_FEWEST_POINTS = 6
"""Fewest probed points that can be compared: the position of the part alone takes six numbers."""


TOP = "top"
"""Surface of a touch-off point: ``T01.top``."""


class TouchOff(Struct, frozen=True, eq=False):
    """k probed points of the uncut top of the block.

    :param name: (k,) names, ``T01.top``.
    :param point: (k, 3) points on the top as programmed, `$BASE` [m].
    :param deviation: (k,) deviation of the top along Z, positive where it is higher [m].
    :param base: (k,) number of the placement, as in `ProbedSurfaces`.
    """

    name: tuple[str, ...] = ()
    point: Array = np.zeros((0, 3))
    deviation: Array = np.zeros(0)
    base: Ints = np.zeros(0, dtype=np.int64)

    def of_placement(self, base: int) -> Self:
        """Return the points of one placement of the block, by its number."""
        rows = np.flatnonzero(self.base == base)
        names = tuple(self.name[k] for k in rows)
        return replace(self, name=names, point=self.point[rows], deviation=self.deviation[rows], base=self.base[rows])


class ProbedSurfaces(Columns, frozen=True, eq=False):
    """Probed points of n surfaces.

    :param name: (n,) ``F01.left``: feature and surface.
    :param line: (n,) line of the program whose motion makes the point, and `t` (n,) the place on that motion.
    :param point: (n, 3) in `$BASE` [m].
    :param normal: (n, 3) unit vectors out of the material.
    :param deviation: (n,) deviation along the normal, positive where material is left [m].
    :param mass: (n,) mass of the weight on the tool where a gauge read its displacement along the normal [kg]; 0 where
        surfaces were probed.
    :param program: (n,) name of the program that makes each point; empty if all placements have one program.
    :param base: (n,) number of the placement: n of `[base_data.n]` of the cell, −1 for its `[base]`.
    :param row: (n,) line of the file.
    :param file: path of the file.
    :param touch_off: points of the uncut top, which are not among the n.
    """

    name: tuple[str, ...]
    line: Ints
    t: Array
    point: Array
    normal: Array
    deviation: Array
    mass: Array
    program: tuple[str, ...]
    base: Ints
    row: Ints
    file: str
    touch_off: TouchOff = TouchOff()

    def __len__(self) -> int:
        return len(self.name)

    @property
    def is_gauge(self) -> Bools:
        """(n,) True where a gauge was read under a weight; False where a cut surface was probed."""
        return np.asarray(self.mass > 0.0)

    @property
    def group(self) -> Ints:
        """(n,) number of the feature of each point: the name up to the first dot."""
        features = [name.partition(".")[0] for name in self.name]
        return np.unique(features, return_inverse=True)[1].astype(np.int64)

    def take(self, rows: NDArray[Any] | slice) -> Self:
        """Return the points of some rows; the touch-off points remain."""
        indices = np.arange(len(self))[rows].tolist()
        name, program = (tuple(texts[k] for k in indices) for texts in (self.name, self.program))
        return replace(super().take(rows), name=name, program=program)


def read(path: Path) -> ProbedSurfaces:
    """Read probed points; rows without a deviation are left out.

    :raises MeasurementError: the file is no such table, a normal is no unit vector, or too few points are probed.
    """
    numbers, texts, lines = files.read_csv(
        path,
        required_columns=("feature", *COLUMNS),
        optional=(PROGRAM, BASE, MASS),
        error=MeasurementError,
        text_columns=("feature", PROGRAM),
        may_be_empty=("deviation_mm", BASE, MASS),
    )
    mass = _masses(numbers, lines, path)
    base = np.nan_to_num(numbers.get(BASE, np.full(len(lines), -1.0)), nan=-1.0)  # −1: `[base]` of the cell
    has_fraction = bool((base % 1.0).any())
    if (PROGRAM in texts) != (BASE in numbers) or has_fraction:  # the two columns go together
        advice = "Keep the columns program and base."
        raise MeasurementError("the rows do not name program and placement", file=str(path), line=1, advice=advice)
    is_top = np.array([name.rpartition(".")[2] == TOP for name in texts["feature"]], dtype=bool)
    is_filled = np.isfinite(numbers["deviation_mm"])
    filled_rows = np.flatnonzero(is_filled & ~is_top)
    if len(filled_rows) < _FEWEST_POINTS:
        raise MeasurementError(
            f"{len(filled_rows)} of {int((~is_top).sum())} points have a deviation",
            file=str(path),
            advice="Fill in deviation_mm: along the normal, positive where material is left.",
        )
    row_numbers = lines.astype(np.int64)
    all_rows = ProbedSurfaces(
        name=tuple(texts["feature"]),
        line=numbers["source_line"].astype(np.int64),
        t=numbers["t"],
        point=np.column_stack([numbers[name] for name in "XYZ"]) * M_PER_MM,
        normal=_normals(numbers, np.flatnonzero(is_filled), row_numbers, str(path)),
        deviation=numbers["deviation_mm"] * M_PER_MM,
        mass=mass,
        program=tuple(texts[PROGRAM]) if PROGRAM in texts else ("",) * len(lines),
        base=base.astype(np.int64),
        row=row_numbers,
        file=str(path),
    )
    touch_off = _touch_off_points(all_rows.take(np.flatnonzero(is_filled & is_top)))
    return replace(all_rows.take(filled_rows), touch_off=touch_off)


def _masses(numbers: dict[str, Array], lines: Array, path: Path) -> Array:
    """Return the mass (n,) [kg] of the weight of each row of a table, 0 without one.

    :param numbers: name of a column → its numbers (n,); `lines` (n,) line of each row in the file.
    :raises MeasurementError: a mass is negative or too large.
    """
    mass = np.nan_to_num(numbers.get(MASS, np.zeros(len(lines))))
    is_invalid = ~((mass >= 0.0) & (mass <= _MOST_MASS))
    if is_invalid.any():
        line = int(lines[np.argmax(is_invalid)])
        raise MeasurementError(f"{MASS} is not between 0 and {_MOST_MASS:g}", file=str(path), line=line)
    return mass


def _normals(numbers: dict[str, Array], rows: Ints, lines: Ints, file: str) -> Array:
    """Return the normals of all rows of a table (n, 3), with those of some rows checked and scaled to length 1.

    :param numbers: name of a column → its numbers (n,).
    :param rows: rows to be checked; the other normals stay as they are.
    :param lines: (n,) line of each row in the file.
    :raises MeasurementError: a checked normal does not have length 1.
    """
    normal = np.column_stack([numbers[name] for name in ("nx", "ny", "nz")])
    is_not_unit = np.abs(norm(normal[rows]) - 1.0) > _NORMAL_TOLERANCE
    if is_not_unit.any():
        row = int(lines[rows][np.argmax(is_not_unit)])
        raise MeasurementError("nx, ny, nz is no unit vector", file=file, line=row, advice="Keep the columns.")
    normal[rows] /= norm(normal[rows])[:, None]
    return normal


def _touch_off_points(rows: ProbedSurfaces) -> TouchOff:
    """Return rows of a table as touch-off points of the top of the block.

    :raises MeasurementError: the normal of a row is not Z, or it states the mass of a weight.
    """
    is_invalid = (rows.normal[:, 2] < 1.0 - _NORMAL_TOLERANCE) | rows.is_gauge
    if is_invalid.any():
        first = int(np.argmax(is_invalid))
        raise MeasurementError(
            f"{rows.name[first]} is no point of the top",
            file=rows.file,
            line=int(rows.row[first]),
            advice="Touch-off points have nx, ny, nz = 0, 0, 1, and no mass_kg.",
        )
    return TouchOff(rows.name, rows.point, rows.deviation, rows.base)


def is_probing_table(path: Path) -> bool:
    """Return whether the first line of a file has the column deviation_mm of probed points; False if it is no text."""
    try:
        with path.open(encoding="utf-8-sig") as text:
            return "deviation_mm" in text.readline()
    except (OSError, UnicodeDecodeError):
        return False


def table(parts: dict[Placement, Program]) -> bytes:
    """Return the content of `probing.csv`: the points to be probed, with an empty deviation.

    If weights are hung on the tool, there is a column of masses. If the block has a placement other than `[base]`, each
    row names its program and placement.

    :param parts: the program of each placement of the block, with its points.
    """
    has_weight = any(part.mass.any() for part in parts.values())
    has_placements = any(placement.number for placement in parts)
    head = ["feature", *((PROGRAM, BASE) if has_placements else ()), *COLUMNS, *((MASS,) if has_weight else ())]
    rows = [",".join(head)]
    for placement, part in parts.items():
        made_by = f",{placement.name},{placement.number}" if has_placements else ""
        for name, line, t, point, normal, mass in zip(
            part.feature, part.line.tolist(), part.t.tolist(), part.point * MM_PER_M, part.normal, part.mass.tolist(),
            strict=True,
        ):  # fmt: skip
            place = ",".join(f"{value:.4f}" for value in without_negative_zero(point))
            end = f",{mass:g}" if has_weight else ""
            direction = ",".join(f"{value:.9f}" for value in normal)
            rows.append(f"{name}{made_by},{line},{t:.6f},{place},{direction},{end}")
    return ("\n".join(rows) + "\n").encode()
