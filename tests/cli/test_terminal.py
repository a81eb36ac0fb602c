"""Tables as a terminal shows them, and as plain text where stdout goes elsewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

from tests.kr270 import ROBOT

RUN = "import sys; from postproc.cli import main\ntry: main({!r})\nfinally: print('rich' in sys.modules)"


def words(text: str) -> set[str]:
    return set(re.sub(r"\x1b\[[0-9;]*m", "", text).split())


@pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal of Unix")
@pytest.mark.parametrize("columns", [60, 200])
def test_a_terminal_shows_a_table_no_wider_than_itself_and_nothing_is_cut_off(columns):
    import pty

    ours, theirs = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "postproc", "robots", "kuka_kr270"],
        stdout=theirs,
        env={**os.environ, "COLUMNS": str(columns), "TERM": "xterm"},
    )
    os.close(theirs)
    shown = b""
    try:
        while piece := os.read(ours, 4096):
            shown += piece
    except OSError:  # Linux tells the end so
        pass
    os.close(ours)
    assert child.wait() == 0
    text = re.sub(r"\x1b\[[0-9;]*m", "", shown.decode())
    assert "\x1b[1m" in shown.decode()
    assert max(map(len, text.splitlines())) <= columns
    for entry in ROBOT.sources:
        assert words(entry.name) | words(entry.value) | words(entry.source) <= words(text)


def test_piped_the_table_is_plain_and_rich_is_not_imported():
    done = subprocess.run(
        [sys.executable, "-c", RUN.format(["robots", "kuka_kr270"])], capture_output=True, text=True, check=True
    )
    assert "\x1b" not in done.stdout
    assert done.stdout.splitlines()[-1] == "False"
    for entry in ROBOT.sources:
        assert any(entry.name in line and entry.source in line for line in done.stdout.splitlines())
