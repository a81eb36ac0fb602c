"""Readings of three configurations, each at a level of q2 of its own, made by a simulator of another author.

Joint springs and compensator are exact there. Without k2, which three levels do not show next to K_c and s_0, the best
compensator would have a free length of -4.8 m.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from tests.commands import run

HERE = Path(__file__).parent


def test_a_spring_that_cannot_be_built_is_not_identified_and_the_model_has_the_values_that_are_told(tmp_path):
    files = (HERE / "three_levels.csv", "--experiment", HERE / "three_levels.toml", "-o", tmp_path / "arm")
    run("identify", "elastostatics", *files, code=(0, 3))
    told = json.loads((tmp_path / "arm" / "identification.json").read_text(encoding="utf-8"))["parameters"]
    model = tomllib.loads((tmp_path / "arm" / "model.toml").read_text(encoding="utf-8"))
    assert not told["K_c"]["observable"]
    assert model["compensator"]["stiffness_N_per_m"] == pytest.approx(told["K_c"]["value"])
    assert model["compensator"]["free_length_mm"] == pytest.approx(told["s_0"]["value"])
    assert told["k2"]["observable"], "it is determined where K_c and s_0 are those of the prior"
    assert told["k2"]["value"] == pytest.approx(0.372, abs=0.06), "with K_c 0.372 at q2 = -10°"
