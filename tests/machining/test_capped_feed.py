"""`[limits] feed = "cap"`: forces of a process are those of the feed that is written."""

from __future__ import annotations

import csv
import re

import numpy as np

from tests.commands import run
from tests.machining.setting import process, tool
from tests.places import CELL_FILE

PROGRAM = "G21 G90 G17 G94\nT1 M6\nS100000 M3\nG0 X-10 Y30 Z20\nZ-0.5\nG1 X110 F{feed}\nG0 Z20\nM5\nM30\n"


def converted(folder, feed):
    """Standard error, speed of the cut in the written program [m/s], and force in the middle of the slot [N]."""
    folder.mkdir()
    (folder / "part.nc").write_text(PROGRAM.format(feed=feed))
    (folder / "process.toml").write_text(process(tool(12, 3), ((0, 100), (0, 60), (-20, 0)), 1.0))
    (folder / "cell.toml").write_text(
        '[limits]\nfeed = "cap"\n'.join(re.split(r"(?m)^(?=\[output\])", CELL_FILE.read_text()))
    )
    words = (folder / "part.nc", "--process", folder / "process.toml", "-o", folder)
    told = run("convert", *words, code=(0, 3), cell=folder / "cell.toml").output
    text = (folder / "part.src").read_text()
    speed = float(re.findall(r"\$VEL\.CP=([\d.]+)", text.partition("Z -0.5")[2])[0])
    with (folder / "part.targets.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    at_half = min(rows, key=lambda row: abs(float(row["X"]) - 50.0) + abs(float(row["Z"]) + 0.5))
    return told, speed, np.array([float(at_half[name]) for name in ("Fx", "Fy", "Fz")])


def test_a_cut_that_is_slowed_has_the_forces_of_its_written_feed(tmp_path):
    told, speed, force = converted(tmp_path / "fast", 160000)
    assert "would turn too fast are slowed" in told
    assert speed < 0.9 * 160000 / 60e3
    plain, same_speed, expected = converted(tmp_path / "slow", f"{60e3 * speed:.3f}")
    assert "are slowed" not in plain
    assert same_speed == speed
    np.testing.assert_allclose(force, expected, rtol=0.01)
    _, _, of_programmed_feed = converted(tmp_path / "half", f"{30e3 * speed:.3f}")
    assert abs(of_programmed_feed - expected).max() > 10.0, "the feed matters"
