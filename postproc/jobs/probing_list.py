"""List of the points to probe on a test part, and check of a file with probed points."""

from __future__ import annotations

import csv
from pathlib import Path

from msgspec import Struct

from postproc.errors import InputError
from postproc.testpart.probing import is_probing_table

LARGEST_BYTES = 4 * 2**20
"""Probing lists have some 100 lines: larger files are something else."""


class ProbingList(Struct, frozen=True):
    """Points to probe, in this order, as `probing.csv` has them.

    :param columns: names of the columns.
    :param rows: texts of each row.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def probing_list(path: Path) -> ProbingList:
    """Return the content of a probing file, without comments; an empty list if the file does not exist.

    :raises InputError: the file cannot be read.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [tuple(row) for row in csv.reader(file) if row and not row[0].startswith("#")]
    except FileNotFoundError:
        rows = []
    except (OSError, UnicodeDecodeError, csv.Error) as cause:
        raise InputError(f"it cannot be read ({cause})", file=str(path)) from cause
    return ProbingList(rows[0], tuple(rows[1:])) if rows else ProbingList((), ())


def check_probed(path: Path) -> None:
    """Check that a file is a table of probed points: it has the column deviation_mm.

    :raises InputError: the file is no such table.
    """
    if not is_probing_table(path):
        raise InputError("this is no probing file", advice="Fill in the column deviation_mm of probing.csv, as CSV.")
