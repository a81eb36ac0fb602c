"""Tables of text, for a terminal."""

from __future__ import annotations

import io
from collections.abc import Collection, Sequence

_WIDEST = 10_000


def table(head: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = (), indent: str = "") -> str:
    """Return a table as text, as wide as it needs to be.

    :param head: of each column.
    :param rows: cells of each row, as many as heads.
    :param right: columns whose cells end in line: numbers.
    :param indent: in front of each line.

    >>> print(table(("axis", "mm"), [("X", "1.5"), ("Y", "-12.0")], right=(1,)))
    axis     mm
    X       1.5
    Y     -12.0
    """
    from rich.console import Console  # not needed by who writes files alone
    from rich.table import Table
    from rich.text import Text

    made = Table(box=None, pad_edge=False, padding=(0, 1))
    for column, title in enumerate(head):
        made.add_column(Text(title), justify="right" if column in right else "left", no_wrap=True)
    for row in rows:
        made.add_row(*map(Text, row))
    out = io.StringIO()
    Console(file=out, width=_WIDEST, color_system=None, legacy_windows=False).print(made)
    return "\n".join(indent + line.rstrip() for line in out.getvalue().splitlines())
