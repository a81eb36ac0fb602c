"""The command `postproc`, run in this process."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from postproc.cli import main
from tests.places import CELL_FILE

CELL_OPTION = ("--cell", CELL_FILE)
CELL_IN_NUMBERS = ("--robot", "kuka_kr270", "--base", "1500,-200,700", "--tool", "0,0,350")
"""Options that state a cell without a file."""


def invoke(*arguments: object, cell: object = None, **options: object) -> Result:
    """Run a command and return its result, whatever its exit code is.

    :param cell: cell file, added as ``--cell``.
    :param options: of `CliRunner.invoke`: input, env, catch_exceptions.
    """
    words = [*map(str, arguments), *([] if cell is None else ["--cell", str(cell)])]
    return CliRunner().invoke(main, words, **options)


def run(*arguments: object, code: int | tuple[int, ...] = 0, cell: object = None, **options: object) -> Result:
    """Run a command and return its result; see `invoke`.

    :param code: exit code that it must have, or several of which it must have one.
    """
    result = invoke(*arguments, cell=cell, **options)
    assert result.exit_code in (code if isinstance(code, tuple) else (code,)), result.output
    return result


def printed(*arguments: object, code: int | tuple[int, ...] = 0, cell: object = None) -> str:
    """Run a command and return what it prints; see `run`."""
    return run(*arguments, code=code, cell=cell).output


def convert(*arguments: object, code: int | tuple[int, ...] = 0, cell: object = CELL_FILE) -> Result:
    """Run `convert` into the folder `out`; see `run`.

    :param arguments: programs and options; without any, the program part.nc.
    """
    return run("convert", *(arguments or ("part.nc",)), "-o", "out", code=code, cell=cell)


def convert_text(
    folder: Path,
    name: str,
    text: str,
    *options: object,
    process: str | None = None,
    code: int | tuple[int, ...] = 0,
    cell: object = CELL_FILE,
) -> Result:
    """Write a program into a folder and run `convert` on it, into the folder `out` in there; see `run`.

    :param process: text of a process file that is given to the command.
    """
    (folder / name).write_bytes(text.encode())
    if process is not None:
        (folder / "process.toml").write_text(process)
        options = ("--process", folder / "process.toml", *options)
    return run("convert", folder / name, "-o", folder / "out", *options, code=code, cell=cell)


def comparison(
    nominal: object, corrected: object, *arguments: object, code: int | tuple[int, ...] = 0, cell: object = None
) -> dict[str, Any]:
    """Run `compare` into the folder `found` and return the summary that it prints as JSON; see `run`."""
    words = ("compare", nominal, corrected, "-o", "found", "--json", "--overwrite", *arguments)
    return json.loads(printed(*words, code=code, cell=cell))
