"""`postproc convert -`: a program from stdin, and `-o -`: the written program on stdout."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from postproc.cli import streams

if TYPE_CHECKING:
    from postproc.jobs import Outcome, Settings

PIPE = "-"
_DEFAULT_NAME = "STDIN"
"""Name of a program from stdin without `--name`."""


def is_piped(programs: tuple[str, ...], output: Path | None) -> bool:
    """Return whether the program is read from stdin or written to stdout.

    :param output: output folder, or "-" for stdout; None: not given.
    :raises click.UsageError: stdin is given together with other programs.
    """
    if PIPE in programs and len(programs) > 1:
        raise click.UsageError("- is stdin: give it as the only PROGRAM.")
    return PIPE in programs or output == Path(PIPE)


@contextlib.contextmanager
def program_file(program: str, name: str | None, dialect: str | None) -> Iterator[str]:
    """Yield the path of a program; the program from stdin is in a temporary file until the context ends.

    :param program: path of the program, or "-" for stdin.
    :param name: name of the program from stdin; None: STDIN.
    :param dialect: name of its dialect; only stdin needs it.
    :raises click.UsageError: the dialect of stdin is not stated.
    """
    if program != PIPE:
        yield program
        return
    if dialect is None:
        raise click.UsageError("Give --dialect with -: stdin has no extension.")
    from postproc.dialects import registry

    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{name or _DEFAULT_NAME}{registry.dialect_of_name(dialect).extensions[0]}"
        with click.open_file(PIPE, "rb") as stdin:
            path.write_bytes(stdin.read())
        yield str(path)


def convert_piped(program: str, settings: Settings, files: dict[str, Any], name: str | None) -> Outcome:
    """Convert a program from stdin or to stdout; the summary goes to stderr if the program goes to stdout.

    Without an output folder the program goes to stdout. The outcome of a failed program has no summary.

    :param files: options of `find_jobs`.
    :param name: name of the program; None: the name of its file.
    :raises click.ClickException: several files would be written to stdout.
    """
    from postproc import report
    from postproc.cli.outcomes import print_failures
    from postproc.jobs import convert_all, find_jobs

    to_stdout = files["output"] in (None, Path(PIPE))
    with program_file(program, name, files["dialect"]) as path, TemporaryDirectory() as folder:
        output = Path(folder) if to_stdout else files["output"]
        jobs = find_jobs([path], name=name, **{**files, "output": output})
        (outcome,) = convert_all(jobs, settings)
        print_failures([outcome])
        if outcome.summary is None:
            return outcome
        programs = [file for file in outcome.written_files if Path(file).suffix.lower() == jobs[0].writer.extension]
        if to_stdout and len(programs) > 1:
            names = ", ".join(Path(file).name for file in programs)
            raise click.ClickException(f"{len(programs)} files are written ({names}): give a folder by -o.")
        if not click.get_current_context().find_root().params.get("quiet"):  # global option --quiet
            click.echo(report.program_text(outcome.summary), err=to_stdout)
        if to_stdout:
            streams.write_to_stdout(Path(programs[0]).read_bytes())
    return outcome
