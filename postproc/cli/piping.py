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
_NAME = "STDIN"


def is_piped(programs: tuple[str, ...], output: Path | None) -> bool:
    """Return whether stdin or stdout is meant.

    :raises click.UsageError: stdin is one of several programs.
    """
    if PIPE in programs and len(programs) > 1:
        raise click.UsageError("- is stdin: give it as the only PROGRAM.")
    return PIPE in programs or output == Path(PIPE)


@contextlib.contextmanager
def program_file(program: str, name: str | None, dialect: str | None) -> Iterator[str]:
    """Yield the path of a program; stdin is a temporary file meanwhile.

    :raises click.UsageError: the format of stdin is not stated.
    """
    if program != PIPE:
        yield program
        return
    if dialect is None:
        raise click.UsageError("Give --dialect with -: stdin has no extension.")
    from postproc.dialects import registry

    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{name or _NAME}{registry.dialect_of_name(dialect).extensions[0]}"
        with click.open_file(PIPE, "rb") as stdin:
            path.write_bytes(stdin.read())
        yield str(path)


def convert_piped(program: str, settings: Settings, files: dict[str, Any], name: str | None) -> Outcome:
    """Convert a program from or to a pipe; what is printed goes to stderr if stdout has the program.

    :param files: options of `find_jobs`.
    :param name: of the program; None: that of the file.
    :raises click.ClickException: several files are written, which one pipe cannot take.
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
        if not click.get_current_context().find_root().params.get("quiet"):
            click.echo(report.program_text(outcome.summary), err=to_stdout)
        if to_stdout:
            streams.write_to_stdout(Path(programs[0]).read_bytes())
    return outcome
