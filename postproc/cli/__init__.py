"""Command line: options in, one call, output. Each theme is a file; it is imported only when its command is used."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import sys
import traceback
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import click

from postproc.cli import streams

_COMMANDS = {
    "app": "postproc.cli.app:app",
    "check": "postproc.cli.check:check",
    "compare": "postproc.cli.compare:compare",
    "convert": "postproc.cli.convert:convert",
    "forces": "postproc.cli.forces:forces",
    "identify": "postproc.cli.identify:identify",
    "init": "postproc.cli.first_steps:init",
    "install-post": "postproc.cli.install_post:install_post",
    "place": "postproc.cli.place:place",
    "plan": "postproc.cli.plan:plan",
    "predict": "postproc.cli.convert:predict",
    "robots": "postproc.cli.robots:robots",
    "samples": "postproc.cli.first_steps:samples",
    "schema": "postproc.cli.schema:schema",
    "start": "postproc.cli.start:start",
    "testpart": "postproc.cli.testpart:testpart",
    "watch": "postproc.cli.watch:watch",
}
"""Command → module and attribute that define it."""
_DEBUG = "--debug"
_QUIET = "--quiet"
_GLOBAL_OPTIONS = (_DEBUG, _QUIET)
"""Options that may also follow a command."""


class LazyGroup(click.Group):
    """A group whose commands are imported when they are needed; it turns errors of the library into messages.

    :param command_locations: command → ``"module:attribute"``.
    """

    def __init__(self, *args: object, command_locations: Mapping[str, str], **options: object) -> None:
        super().__init__(*args, **options)  # type: ignore[arg-type]
        self.command_locations = command_locations

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        return sorted({*super().list_commands(ctx), *self.command_locations})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Import and return a command; None if there is no command of this name."""
        if name not in self.command_locations:
            return super().get_command(ctx, name)
        module, attribute = self.command_locations[name].split(":")
        command: click.Command = getattr(import_module(module), attribute)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return name, command and remaining arguments, as click does.

        :raises click.UsageError: there is no such command; the message offers the nearest.
        """
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as cause:
            from postproc.errors import did_you_mean

            suggestion = did_you_mean(args[0], self.list_commands(ctx))
            raise click.UsageError(f"No such command {args[0]!r}. {suggestion}".rstrip(), ctx) from cause

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments; ``--debug`` and ``--quiet`` may be anywhere on the command line."""
        arguments = [arg for arg in args if arg not in _GLOBAL_OPTIONS]
        return super().parse_args(ctx, [*(option for option in _GLOBAL_OPTIONS if option in args), *arguments])

    def main(self, args: Sequence[str] | None = None, *settings: Any, **options: Any) -> Any:
        """Run the command. Warnings of libraries are shown only with ``--debug``.

        :param args: arguments; None: those of the process, which ends with the command.
        """
        streams.replace_absent()
        if args is None:
            from postproc import interrupts

            interrupts.leave_at_once()
            robust_stdout = streams.make_robust()
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # more would wait in a loop, for matrices of 6 × 6
        with warnings.catch_warnings():
            if _DEBUG not in (sys.argv if args is None else args):
                warnings.showwarning = _ignore_warning
            try:
                return super().main(args, *settings, **options)
            finally:
                if args is None:
                    with contextlib.suppress(OSError, ValueError):
                        if message := streams.lost_output(robust_stdout):
                            sys.stderr.write(f"{message}\n")
                    gc.freeze()  # the process ends: a last garbage collection would take 0.1 s

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; an interrupt ends it with exit code 130.

        :raises click.UsageError: an option is unusable or missing (exit code 2).
        :raises click.ClickException: the input is unusable, or the machine fails, or postproc has a fault, whose
            traceback is written to a file (exit code 1).
        """
        from postproc.errors import OptionError, PostprocError

        try:
            return super().invoke(ctx)
        except OptionError as cause:
            raise click.UsageError(str(cause)) from cause
        except PostprocError as cause:
            raise click.ClickException(str(cause)) from cause
        except KeyboardInterrupt as cause:
            click.echo("Interrupted.", err=True)
            ctx.exit(128 + getattr(cause, "number", 2))  # 128 + number of the signal; 2: Ctrl-C
        except click.MissingParameter as cause:
            if cause.param is None or cause.param.name != "cell":
                raise
            text = "Missing option '--cell': the file that says which robot, base and tool. postproc init writes one."
            raise click.UsageError(text, cause.ctx) from cause
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except MemoryError as cause:
            raise click.ClickException("not enough memory") from cause
        except OSError as cause:  # of the machine, not of postproc
            raise click.ClickException(str(cause)) from cause
        except Exception as cause:
            from postproc.cli.faults import fault_message

            text = fault_message(f"unexpected {type(cause).__name__}: {cause}", traceback.format_exc())
            raise click.ClickException(text) from cause


def _ignore_warning(*_: object, **__: object) -> None:
    """Show no warning; takes the arguments of `warnings.showwarning`."""


@click.group(cls=LazyGroup, command_locations=_COMMANDS, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="postproc", message="%(prog)s %(version)s")
@click.option(
    _DEBUG, is_flag=True, help="Show the traceback of a fault, and warnings of libraries; also behind a command."
)
@click.option(
    _QUIET, is_flag=True, help="Print no summaries, only errors and what --json prints; also behind a command."
)
def main(debug: bool, quiet: bool) -> None:  # read in cli/faults.py and cli/outcomes.py
    """Correct robot milling programs for the elastic deflection of the arm under cutting forces.

    \b
    Example:
      postproc convert part.nc --cell cell.toml --forces part.forces.csv

    Exit codes: 0 good; 1 input unusable or a move cannot be done, nothing written for that program; 2 wrong usage;
    3 the verdict is red: a tolerance that you gave is missed, or correction does
    more harm than good; 130 interrupted.
    """  # noqa: D301 - click: keep these lines as they are
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            with contextlib.suppress(ValueError, OSError):
                stream.reconfigure(errors="replace")  # a console that cannot show a character is no reason to stop
