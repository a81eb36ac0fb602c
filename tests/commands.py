"""The command `postproc`, run in this process."""

from __future__ import annotations

from click.testing import CliRunner, Result

from postproc.cli import main


def run(*arguments: object, code: int | tuple[int, ...] = 0, cell: object = None) -> Result:
    """Run a command and return its result.

    :param code: exit code that it must have, or several of which it must have one.
    :param cell: cell file, added as ``--cell``.
    """
    given = [*map(str, arguments), *([] if cell is None else ["--cell", str(cell)])]
    done = CliRunner().invoke(main, given)
    assert done.exit_code in (code if isinstance(code, tuple) else (code,)), done.output
    return done


def printed(*arguments: object, code: int | tuple[int, ...] = 0, cell: object = None) -> str:
    """Run a command and return what it prints; see `run`."""
    return run(*arguments, code=code, cell=cell).output
