"""Readings of a robot in a folder, and the models that were identified from them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
from msgspec import Struct

from postproc.identification import record

EXPERIMENT = "experiment"
"""Part of the name of a file that states how readings were taken."""
_COLUMNS = {"config", "load", "point"}
"""Columns of a file of readings."""
_GLOBS = ("*.toml", "*/*.toml", "*/*/*.toml")


class Readings(Struct, frozen=True):
    """An experiment and the files next to it.

    :param experiment: TOML file of the experiment.
    :param files: CSV files of readings, sorted; measurements.csv is the first.
    :param compensators: TOML files of `identify compensator`.
    """

    experiment: Path
    files: tuple[Path, ...]
    compensators: tuple[Path, ...]


class ModelFolder(Struct, frozen=True):
    """A model folder of `identify`.

    :param verdict: a line that says whether the model may be used; empty: only geometry was identified.
    :param refused: whether the verdict is that it must not be used.
    :param warnings: warnings for the user.
    """

    folder: Path
    verdict: str
    refused: bool
    warnings: tuple[str, ...]


class _IdentificationVerdict(Struct, frozen=True):
    """Warnings and verdict, which the record of every kind of identification has."""

    warnings: list[str]
    verdict: record.Verdict | None = None


def readings_of(folder: Path) -> list[Readings]:
    """Return the experiments of a folder and of two levels of folders in it, sorted by path.

    An experiment is a TOML file whose name contains "experiment". Hidden files and folders are left out.
    """
    paths = sorted(path for pattern in _GLOBS for path in folder.glob(pattern) if EXPERIMENT in path.stem.lower())
    return [_readings(path) for path in paths if not _is_hidden(path.relative_to(folder)) and path.is_file()]


def _is_hidden(path: Path) -> bool:
    """Return whether a file or a folder of a relative path is hidden: its name begins with a full stop."""
    return any(part.startswith(".") for part in path.parts)


def _readings(experiment: Path) -> Readings:
    """Return an experiment with the files of readings and the compensator files in its folder."""
    folder = experiment.parent
    files = [path for path in sorted(folder.glob("*.csv")) if set(_header(path)) >= _COLUMNS]
    files.sort(key=lambda path: path.stem.lower() != "measurements")  # measurements.csv first, the others as sorted
    compensators = [path for path in sorted(folder.glob("*.toml")) if "compensator" in path.stem.lower()]
    return Readings(experiment=experiment, files=tuple(files), compensators=tuple(compensators))


def _header(path: Path) -> Iterator[str]:
    """Yield the names of the columns of a CSV file; none if it cannot be read."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            lines = (line for line in file if line.strip() and not line.startswith("#"))
            yield from (word.strip() for word in next(lines, "").split(","))
    except OSError:
        return


def model_of(folder: Path) -> ModelFolder | None:
    """Return the model of a folder; None if `identify` has not written one there, or its record cannot be read."""
    try:
        content = msgspec.json.decode((folder / record.NAME).read_bytes(), type=_IdentificationVerdict)
    except (OSError, ValueError):
        return None
    verdict = content.verdict
    return ModelFolder(
        folder=folder,
        verdict="" if verdict is None else verdict.line,
        refused=verdict is not None and verdict.refused,
        warnings=tuple(content.warnings),
    )
