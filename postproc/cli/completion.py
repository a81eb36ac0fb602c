"""What the shell offers behind an option or a command: robots, and files where a word may be a pattern too."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem


def complete_robots(_ctx: click.Context, _param: click.Parameter | None, incomplete: str) -> list[CompletionItem]:
    """Return the shipped robots whose names begin so, and let the shell look for model folders."""
    from postproc.robot import shipped

    names = [CompletionItem(name) for name in shipped() if name.startswith(incomplete)]
    return [*names, CompletionItem(incomplete, type="dir")]


def complete_files(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Let the shell look for files."""
    return [CompletionItem(incomplete, type="file")]
