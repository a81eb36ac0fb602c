"""How summaries look: as plain text here, the same when piped; a terminal may show them in its own way."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol

from postproc.report.verdict import State


class Display(Protocol):
    """Where a summary is shown."""

    def verdict(self, text: str, state: State) -> str:
        """Return a verdict as it looks for its state."""
        ...

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = (), indent: str = ""
    ) -> str:
        """Return a table.

        :param head: of each column.
        :param rows: cells of each row, as many as heads.
        :param right: columns whose cells end in line: numbers.
        :param indent: in front of each line.
        """
        ...


class Plain:
    """Plain text, each column as wide as it needs to be."""

    def verdict(self, text: str, state: State) -> str:
        """Return the text as it is."""
        del state
        return text

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = (), indent: str = ""
    ) -> str:
        """Return a table as text.

        >>> print(Plain().table(("axis", "mm"), [("X", "1.5"), ("Y", "-12.0")], right=(1,)))
        axis     mm
        X       1.5
        Y     -12.0
        """
        cells = [tuple(head), *map(tuple, rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        return "\n".join(
            indent
            + "  ".join(
                cell.rjust(width) if column in right else cell.ljust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in cells
        )


PLAIN = Plain()
