"""The commands of README and guides, run once, in reading order, in a folder with the samples."""

from __future__ import annotations

import os
import re
import shutil
from types import SimpleNamespace

import pytest

from tests.documentation import following, pages
from tests.places import ROOT

_TEXT = "\n".join(path.read_text(encoding="utf-8") for path in pages.FOLLOWED)


@pytest.fixture(scope="session")
def readme(tmp_path_factory):
    """The folder in which README and guides were followed, and the result of each of their commands.

    Workers of one run follow them once: the first that needs it.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "readme"
    return folder, [SimpleNamespace(**result) for result in following.once(folder, _followed)]


def _followed(folder):
    """Follow README and guides in a folder; return exit code and output of each command."""
    shutil.copytree(ROOT / "samples", folder / "samples")
    (folder / "experiment.toml").write_text("\n".join(pages.code(pages.PLANNING, "toml")))
    scripts = re.findall(r"^python (samples/\S+ demo)$", _TEXT, re.M)
    return following.followed(folder, scripts, [arguments for _, arguments, _ in pages.consoles()])
