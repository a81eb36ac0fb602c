"""The commands of README and guides, run once, in reading order, in a folder with the samples."""

from __future__ import annotations

import json
import os
import re
import runpy
import shlex
import shutil
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from filelock import FileLock

from postproc.cli import main
from tests.documentation import pages

_TEXT = "\n".join(path.read_text(encoding="utf-8") for path in pages.FOLLOWED)


@pytest.fixture(scope="session")
def readme(tmp_path_factory):
    """The folder in which README and guides were followed, and the result of each of their commands.

    Workers of one run follow them once: the first that needs it.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "readme"
    results = folder.with_suffix(".json")
    with FileLock(folder.with_suffix(".lock")):
        if not results.exists():
            results.write_text(json.dumps(_followed(folder)), encoding="utf-8")
    return folder, [SimpleNamespace(**result) for result in json.loads(results.read_text(encoding="utf-8"))]


def _followed(folder):
    """Follow README and guides in a new folder; return exit code and output of each command."""
    folder.mkdir()
    shutil.copytree(pages.ROOT / "samples", folder / "samples")
    (folder / "experiment.toml").write_text("\n".join(pages.code(pages.PLANNING, "toml")))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for script in re.findall(r"^python (samples/\S+ demo)$", _TEXT, re.M):
            patch.setattr("sys.argv", shlex.split(script))
            runpy.run_path(shlex.split(script)[0], run_name="__main__")
        results = [CliRunner().invoke(main, arguments) for _, arguments, _ in pages.consoles()]
    return [{"exit_code": result.exit_code, "output": result.output} for result in results]
