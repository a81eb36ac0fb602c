"""How summaries look on a terminal: coloured, in tables as wide as it; plain where stdout goes elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import click

from postproc.report.formatting import PLAIN, Display

if TYPE_CHECKING:
    from postproc.report.formatting import State

_COLOURS: dict[State, str] = {"ok": "green", "warning": "yellow", "failed": "red"}


class _Terminal:
    """Summaries with colours, and tables as wide as the terminal, by rich."""

    def verdict(self, text: str, state: State) -> str:
        """Return a text in bold and in the colour of a state."""
        return click.style(text, fg=_COLOURS[state], bold=True)

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[int] = (), indent: str = ""
    ) -> str:
        """Return a table as text.

        :param right: indices of columns that are aligned right and not wrapped.
        :param indent: text as wide as the indentation of the table.
        """
        from rich import box
        from rich.console import Console
        from rich.padding import Padding
        from rich.table import Table
        from rich.text import Text

        rich_table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
        for column, title in enumerate(head):
            is_right = column in right
            rich_table.add_column(
                Text(title), justify="right" if is_right else "left", no_wrap=is_right, min_width=4, overflow="fold"
            )
        for row in rows:
            rich_table.add_row(*map(Text, row))
        console = Console(legacy_windows=False)
        with console.capture() as capture:
            console.print(Padding(rich_table, (0, 0, 0, len(indent)), expand=False))
        return capture.get().rstrip("\n")


def display() -> Display:
    """Return the output for summaries on stdout: with colours on a terminal, else plain text."""
    return _Terminal() if sys.stdout.isatty() else PLAIN
