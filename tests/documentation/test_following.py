"""What fails while pages are followed is named, in each worker that needs the results."""

from __future__ import annotations

import click
import pytest

from tests.documentation import following


def test_a_script_that_raises_is_named_in_each_worker(tmp_path):
    calls = []

    def follow(folder):
        calls.append(folder)
        (folder / "demo.py").write_text("raise ValueError('no tool')")
        return following.followed(folder, ["demo.py demo"], [])

    for _ in range(2):
        with pytest.raises(pytest.fail.Exception, match=r"python demo\.py demo: ValueError: no tool"):
            following.once(tmp_path / "pages", follow)
    assert len(calls) == 1


def test_a_command_that_raises_ends_with_code_1_and_its_traceback(tmp_path, monkeypatch):
    @click.command()
    @click.argument("what")
    def main(what):
        click.echo("begun")
        if what == "raise":
            raise ZeroDivisionError("no stiffness")

    monkeypatch.setattr("tests.commands.main", main)
    first, raised, last = following.once(
        tmp_path / "pages", lambda folder: following.followed(folder, [], [["run"], ["raise"], ["run"]])
    )
    assert first == last == {"exit_code": 0, "output": "begun\n"}
    assert raised["exit_code"] == 1
    assert raised["output"].endswith("ZeroDivisionError: no stiffness\n")
