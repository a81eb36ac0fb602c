"""Options that several commands share, and what the shell completes for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click
from click.shell_completion import CompletionItem

overwrite = click.option(
    "--overwrite", is_flag=True, help="Replace files that postproc did not write, or not as they are."
)
probe_sigma = click.option(
    "--sigma",
    "sigma_mm",
    type=click.FloatRange(1e-4, 1),
    default=0.005,
    show_default=True,
    help="Noise of the probe, mm.",
)


def complete_robots(_ctx: click.Context, _param: click.Parameter | None, incomplete: str) -> list[CompletionItem]:
    """Return the shipped robots whose names begin so, and let the shell look for model folders."""
    from postproc.robot import shipped

    names = [CompletionItem(name) for name in shipped() if name.startswith(incomplete)]
    return [*names, CompletionItem(incomplete, type="dir")]


def complete_files(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Let the shell look for files."""
    return [CompletionItem(incomplete, type="file")]


def several_programs(text: str, *, required: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator for ``--program A B …``: the first is in `programs`, the others are in `more`.

    :param text: help of the option.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        others = click.argument("more", nargs=-1, metavar="[PROGRAM]...", shell_complete=complete_files)
        option = click.option(
            "--program", "programs", multiple=True, required=required, metavar="PROGRAM...",
            shell_complete=complete_files, help=text,
        )  # fmt: skip
        return option(others(command))

    return decorate
