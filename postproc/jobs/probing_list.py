"""What to probe of a test part, as a list, and whether a file is one of its probing."""

from __future__ import annotations

import csv
from pathlib import Path

from msgspec import Struct

from postproc.errors import InputError
from postproc.testpart.probing import is_probed

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
    """Return the content of a probing file; empty: it is not there.

    :raises InputError: it cannot be read.
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
    """Check that a file is a table of probed points.

    :raises InputError: it is not.
    """
    if not is_probed(path):
        raise InputError("this is no probing file", advice="Fill in the column deviation_mm of probing.csv, as CSV.")
