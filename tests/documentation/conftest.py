"""The commands of README and guides, run once, in reading order, in a folder with the samples."""

from __future__ import annotations

import re
import runpy
import shlex
import shutil

import pytest
from click.testing import CliRunner

from postproc.cli import main
from tests.documentation import pages

_TEXT = "\n".join(path.read_text(encoding="utf-8") for path in pages.FOLLOWED)


@pytest.fixture(scope="session")
def readme(tmp_path_factory):
    """The folder in which README and guides were followed, and the result of each of their commands."""
    folder = tmp_path_factory.mktemp("readme")
    shutil.copytree(pages.ROOT / "samples", folder / "samples")
    (folder / "experiment.toml").write_text("\n".join(pages.code(pages.PLANNING, "toml")))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for script in re.findall(r"^python (samples/\S+ demo)$", _TEXT, re.M):
            patch.setattr("sys.argv", shlex.split(script))
            runpy.run_path(shlex.split(script)[0], run_name="__main__")
        results = [CliRunner().invoke(main, arguments) for _, arguments, _ in pages.consoles()]
    return folder, results
