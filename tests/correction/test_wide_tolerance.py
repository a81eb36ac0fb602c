"""A tolerance wider than the deflection: what the path leaves between targets decides, not what is left at them."""

from __future__ import annotations

import json

import pytest

from tests.commands import printed
from tests.places import CELL_FILE, SAMPLES


@pytest.mark.parametrize(("tolerance", "state"), [("0.05", "ok"), ("3", "warning")])
def test_a_program_that_is_worse_at_its_worst_place_is_not_green(tmp_path, tolerance, state):
    printed(
        "convert",
        SAMPLES / "pocket.nc",
        "--cell",
        CELL_FILE,
        "--tolerance",
        tolerance,
        "-o",
        tmp_path,
    )
    better = json.loads((tmp_path / "pocket.report.json").read_text(encoding="utf-8"))["verdict"]["better"]
    assert (better["corrected_mm"] > better["uncorrected_mm"] + 0.01) is (state == "warning")
    assert better["state"] == state
    assert any("worst place" in reason for reason in better["reasons"]) is (state == "warning")
