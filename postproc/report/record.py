"""What a page states as a record: when and with what it was made, and for whom."""

from __future__ import annotations

import os
from datetime import UTC, datetime

from msgspec import Struct

from postproc.version import VERSION

_DIGITS = 16
"""Digits of a SHA-256 that a page shows."""


class Record(Struct, frozen=True):
    """Record of a conversion.

    :param title: of the cell, `[report] title`; empty: none.
    :param customer: of the cell; empty: none.
    :param cell: file of the cell.
    :param sums: SHA-256 in hexadecimal digits by the file that they are of, such as ``"program"``; ``"-"``: none.
    :param date: day on which it was made, as 2026-11-27.
    :param version: of postproc.
    """

    title: str
    customer: str
    cell: str
    sums: dict[str, str]
    date: str
    version: str = VERSION

    def head(self) -> str:
        """Return title, customer, date and version in a line."""
        return " · ".join(filter(None, (self.title, self.customer, self.date, f"postproc {self.version}")))

    def rows(self) -> list[tuple[str, str]]:
        """Return names and values in the order in which a page shows them."""
        titles = [("Title", self.title), ("Customer", self.customer)]
        rows = [(name, value) for name, value in titles if value]
        rows += [("Date", self.date), ("Version", f"postproc {self.version}"), ("Cell", self.cell)]
        return rows + [
            (f"SHA-256 of {name}", f"{value[:_DIGITS]}…") for name, value in self.sums.items() if value != "-"
        ]


def today() -> str:
    """Return the day in UTC as 2026-11-27: today, or that of SOURCE_DATE_EPOCH, which makes output reproducible."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH", "")
    moment = datetime.fromtimestamp(int(seconds), UTC) if seconds.isdecimal() else datetime.now(UTC)
    return moment.date().isoformat()
