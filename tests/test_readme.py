"""The README is executed: its command, its Python, its files."""

from __future__ import annotations

import contextlib
import io
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from postproc.cli import main

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.])")


@pytest.fixture(autouse=True)
def a_copy_of_the_samples(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "samples", tmp_path / "samples")
    monkeypatch.chdir(tmp_path)


def same(shown, actual):
    """Equal texts but for the last digits of numbers, which may differ from machine to machine."""
    assert _NUMBER.sub("#", shown).split() == _NUMBER.sub("#", actual).split()
    for a, b in zip(_NUMBER.findall(shown), _NUMBER.findall(actual), strict=True):
        assert float(a) == pytest.approx(float(b), rel=0.05, abs=1e-9)


def test_the_command_prints_what_the_readme_shows():
    command, shown = re.search(r"```console\n\$ postproc ([^\n]*)\n(.*?)```", TEXT, re.DOTALL).groups()
    result = CliRunner().invoke(main, command.split())
    assert result.exit_code == 0, result.output
    same(shown, result.output)


def test_the_python_example_prints_what_the_readme_shows():
    code, shown = re.search(r"```python\n(.*?)```\n\n```\n(.*?)```", TEXT, re.DOTALL).groups()
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(code, {})
    same(shown, out.getvalue())


def test_every_file_and_script_the_readme_names_exists():
    for name in re.findall(r"(?:samples|tests|postproc)/[\w./]+\.\w+", TEXT):
        assert (ROOT / name).is_file(), name
