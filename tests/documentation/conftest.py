"""The README's commands, run once, in order, in a folder with the samples."""

from __future__ import annotations

import re
import runpy
import shlex
import shutil

import pytest
from click.testing import CliRunner

from postproc.cli import main
from tests.documentation import pages


@pytest.fixture(scope="session")
def readme(tmp_path_factory):
    """The folder in which the README was followed, and what each of its commands printed."""
    folder = tmp_path_factory.mktemp("readme")
    shutil.copytree(pages.ROOT / "samples", folder / "samples")
    (folder / "experiment.toml").write_text("\n".join(pages.code("toml")))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for script in re.findall(r"^python (samples/\S+ \S+)$", pages.README, re.M):
            patch.setattr("sys.argv", shlex.split(script))
            runpy.run_path(shlex.split(script)[0], run_name="__main__")
        results = [CliRunner().invoke(main, arguments) for arguments, _ in pages.consoles()]
    return folder, results
