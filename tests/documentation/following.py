"""Follow pages in a folder: run their scripts and commands, once for all workers of a test run."""

from __future__ import annotations

import json
import runpy
import shlex
import traceback

import pytest
from filelock import FileLock

from tests.commands import invoke


def once(folder, follow):
    """Return what `follow(folder)` returns, as JSON keeps it. The first worker that needs it calls it.

    If it raises, the test fails with its traceback in every worker.
    """
    results = folder.with_suffix(".json")
    with FileLock(folder.with_suffix(".lock")):
        if not results.exists():
            folder.mkdir()
            try:
                found = {"results": follow(folder)}
            except Exception:
                found = {"failed": traceback.format_exc()}
            results.write_text(json.dumps(found), encoding="utf-8")
    found = json.loads(results.read_text(encoding="utf-8"))
    if "failed" in found:
        pytest.fail(found["failed"], pytrace=False)
    return found["results"]


def followed(folder, scripts, commands):
    """Run scripts and then `postproc` commands in a folder; return exit code and output of each command.

    :raises RuntimeError: a script raises or exits; the message names it.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for script in scripts:
            patch.setattr("sys.argv", shlex.split(script))
            try:
                runpy.run_path(shlex.split(script)[0], run_name="__main__")
            except (Exception, SystemExit) as error:
                raise RuntimeError(f"python {script}: {type(error).__name__}: {error}") from error
        return [_result(invoke(*arguments)) for arguments in commands]


def _result(result):
    raised = result.exc_info if result.exception and not isinstance(result.exception, SystemExit) else None
    output = result.output + ("".join(traceback.format_exception(*raised)) if raised else "")
    return {"exit_code": result.exit_code, "output": output}
