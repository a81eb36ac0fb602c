"""What a page states as a record: when and with what it was made, and for whom."""

from __future__ import annotations

import os
from datetime import UTC, datetime

from msgspec import Struct

from postproc.version import VERSION

_SHA_DIGITS = 16
"""Digits of a SHA-256 that a page shows."""


class Record(Struct, frozen=True):
    """Record of a conversion.

    :param title: of the cell, `[report] title`; empty: none.
    :param customer: of the cell; empty: none.
    :param cell: file of the cell.
    :param sums: SHA-256 in hexadecimal digits by the name of the file, such as ``"program"``; ``"-"``: no such file.
    :param date: day of the conversion, as 2026-11-27.
    :param version: version of postproc.
    """

    title: str
    customer: str
    cell: str
    sums: dict[str, str]
    date: str
    version: str = VERSION

    def head_line(self) -> str:
        """Return title, customer, date and version in a line; an empty title or customer is left out."""
        return " · ".join(filter(None, (self.title, self.customer, self.date, f"postproc {self.version}")))

    def rows(self) -> list[tuple[str, str]]:
        """Return names and values in the order in which a page shows them; empty values are left out."""
        stated_texts = [("Title", self.title), ("Customer", self.customer)]
        rows = [(name, text) for name, text in stated_texts if text]
        rows += [("Date", self.date), ("Version", f"postproc {self.version}"), ("Cell", self.cell)]
        return rows + [
            (f"SHA-256 of {name}", f"{digits[:_SHA_DIGITS]}…") for name, digits in self.sums.items() if digits != "-"
        ]


def today() -> str:
    """Return today in UTC, as 2026-11-27.

    The environment variable SOURCE_DATE_EPOCH [s since 1970] replaces today, so that output is reproducible.
    """
    seconds = os.environ.get("SOURCE_DATE_EPOCH", "")
    moment = datetime.fromtimestamp(int(seconds), UTC) if seconds.isdecimal() else datetime.now(UTC)
    return moment.date().isoformat()
