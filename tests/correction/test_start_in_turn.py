"""A cell without [start]: the program starts at its first target, with its tool turned as it is written."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.commands import run
from tests.places import CELL_FILE, ROOT


def cell_of(folder, mode):
    text = re.sub(r"(?ms)^\[start\].*?(?=^\[)", "[machine]\nclearance_Z = 120.0\n\n", CELL_FILE.read_text())
    text = re.sub(r"(?m)^redundancy_deg.*$", f'redundancy = "{mode}"', text)
    assert f'redundancy = "{mode}"' in text
    assert "[start]" not in text
    (folder / "cell.toml").write_text(text)
    return folder / "cell.toml"


@pytest.mark.parametrize("mode", ["best", "constant"])
def test_the_first_target_is_where_the_program_is_told_to_start(tmp_path, mode):
    told = run("convert", ROOT / "samples" / "pocket.nc", "-o", tmp_path, code=0, cell=cell_of(tmp_path, mode)).output
    assert told.splitlines()[1].startswith("May be run.")
    start = re.search(r"the program starts at A1…A6 = ([-\d., ]+), its first target", told)[1]
    text = Path(tmp_path / "pocket.src").read_text()
    joints = re.search(r"PTP \{A1 ([-\d.]+),A2 ([-\d.]+),A3 ([-\d.]+),A4 ([-\d.]+),A5 ([-\d.]+),A6 ([-\d.]+)\}", text)
    stated = [float(word) for word in start.split(",")]
    assert [float(word) for word in joints.groups()] == pytest.approx(stated, abs=0.06)
    first = re.search(r"PTP \{X .*?\}", text)[0]
    assert first.count(",T ") == 1, "the same turns as at the start"
