"""docs/reference/commands.md: the text that `--help` prints for every command.

python -m tests.documentation.reference        # writes the page
"""

from __future__ import annotations

from collections.abc import Iterator

import click

from postproc.cli import main
from tests.documentation.pages import COMMANDS

HEADING = "# Commands and their options\n"
_WIDTH = 110


def every_command(command: click.Command = main, parent: click.Context | None = None) -> Iterator[click.Context]:
    """Yield the context of a command and of all below it, in the order in which `--help` lists them."""
    name = "postproc" if parent is None else command.name
    width = {"terminal_width": _WIDTH, "max_content_width": _WIDTH}
    ctx = command.make_context(name, [], parent=parent, resilient_parsing=True, **width)
    yield ctx
    if isinstance(command, click.Group):
        for each in command.list_commands(ctx):
            found = command.get_command(ctx, each)
            assert found is not None
            yield from every_command(found, ctx)


def reference() -> str:
    """Return the page as text."""
    parts = [HEADING]
    parts += [f"\n## {ctx.command_path}\n\n```text\n{ctx.get_help().rstrip()}\n```\n" for ctx in every_command()]
    return "".join(parts)


if __name__ == "__main__":
    COMMANDS.write_text(reference(), encoding="utf-8")
