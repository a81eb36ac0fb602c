"""Options that several commands share, and what the shell completes for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from postproc import actions
from postproc.actions import Option
from postproc.cli.ranges import FiniteRange

_PATH = click.Path(path_type=Path)
_Command = TypeVar("_Command", bound=Callable[..., Any])

probe_sigma = click.option(
    "--sigma",
    "sigma_mm",
    type=FiniteRange(1e-4, 1),
    default=0.005,
    show_default=True,
    help="Noise of the probe, mm.",
)


class Choice(click.Choice[str]):
    """Type of an option or argument with fixed values; the error message for another value offers the nearest one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the value, which must be one of the choices.

        :raises click.BadParameter: the value is not one of the choices; the message offers the nearest one.
        """
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as cause:
            from postproc.errors import did_you_mean

            suggestion = did_you_mean(str(value), [str(choice) for choice in self.choices])
            raise click.BadParameter(f"{cause.message} {suggestion}".rstrip(), ctx, param) from cause


def complete_robots(_ctx: click.Context, _param: click.Parameter | None, incomplete: str) -> list[CompletionItem]:
    """Return the shipped robots whose names begin with `incomplete`, and let the shell complete model folders."""
    from postproc.robot import shipped_models

    names = [CompletionItem(name) for name in shipped_models() if name.startswith(incomplete)]
    return [*names, CompletionItem(incomplete, type="dir")]


def complete_files(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Let the shell complete names of files."""
    return [CompletionItem(incomplete, type="file")]


def several_programs(text: str, *, is_required: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that adds ``--program A B …`` to a command.

    An option of click takes one value: `programs` of the command has A, the argument `other_programs` has B ….

    :param text: help text of the option.
    :param is_required: the option must be given.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        """Return a command with the option, and with the argument for the programs after the first."""
        further_programs = click.argument(
            "other_programs", nargs=-1, metavar="[PROGRAM]...", shell_complete=complete_files
        )
        option = click.option(
            "--program", "programs", multiple=True, required=is_required, metavar="PROGRAM...",
            shell_complete=complete_files, help=text,
        )  # fmt: skip
        return option(further_programs(command))

    return decorate


def _dialect(_ctx: click.Context, _param: click.Parameter, value: str | None) -> str | None:
    """Return the name of a dialect, after checking it; a click callback. None stays None.

    :raises click.BadParameter: no dialect has this name, or it cannot be used.
    """
    from postproc.dialects import registry
    from postproc.errors import InputError

    try:
        return None if value is None else registry.dialect_of_name(value).name
    except InputError as cause:
        raise click.BadParameter(str(cause)) from None


def _click_option(option: Option) -> Callable[[_Command], _Command]:
    """Return the decorator of click for an option of `postproc.actions`, by its kind."""
    attributes: dict[str, Any] = {"metavar": option.metavar} if option.metavar else {}
    if option.kind == "flag":
        attributes["is_flag"] = True
    elif option.kind == "path":
        attributes["type"] = _PATH
    elif option.kind == "count":
        attributes["type"] = click.IntRange(min=None if option.minimum is None else int(option.minimum))
    elif option.kind == "length":
        # without a minimum a length must be positive
        attributes["type"] = FiniteRange(min=option.minimum or 0, min_open=option.minimum is None)
    else:
        attributes["callback"] = _dialect
    return click.option(*option.flags, option.name, required=option.required, help=option.help, **attributes)


overwrite = _click_option(actions.OVERWRITE)
dialect = _click_option(actions.DIALECT)
dialect_of_either_program = _click_option(
    actions.DIALECT._replace(
        help="Format of a program whose extension is not known; if both are known, of NOMINAL; default: by the "
        "extension."
    )
)


def shared_options(command: _Command) -> _Command:
    """Add the options that convert and predict share."""
    return _with_options(command, actions.SHARED_OPTIONS)


def conversion_options(command: _Command) -> _Command:
    """Add the options that convert and watch share."""
    return _with_options(command, actions.CONVERSION)


def _with_options(command: _Command, options: tuple[Option, ...]) -> _Command:
    """Return a command with options; its help shows them in this order."""
    # the decorator that is applied last comes first in the help
    for option in reversed(options):
        command = _click_option(option)(command)
    return command


def pop_file_options(options: dict[str, Any]) -> dict[str, Any]:
    """Remove the options of `find_jobs` from the options of a command, and return them: dialect, to, forces and output.

    A process file is returned as `forces`. The options that stay are the fields of `Settings`.

    :raises click.UsageError: forces and process are both given, or the process is no .toml file.
    """
    process = options.pop("process")
    if process is not None:
        if options["forces"] is not None:
            raise click.UsageError("--forces and --process exclude each other.")
        if process.suffix.lower() != ".toml":
            raise click.BadParameter(f"{process} is no .toml file.", param_hint="--process")
        options["forces"] = process
    return {name: options.pop(name) for name in ("dialect", "to", "forces", "output") if name in options}
