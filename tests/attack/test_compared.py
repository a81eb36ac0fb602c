"""Differences planted in random corrected programs; for hours: `python -m tests.attack.compared`."""

from collections import Counter
from importlib import import_module

import numpy as np
import pytest

from postproc.comparison import Difference
from tests.attack import compared
from tests.attack.compared import attack
from tests.attack.driver import Wrong

module = import_module("postproc.comparison.compare")


def test_every_difference_planted_is_told_and_nothing_else():
    outcomes = Counter(attack(seed) for seed in range(12))
    planted = {name: number for name, number in outcomes.items() if name not in ("refused", "nothing to plant")}
    assert sum(planted.values()) > 6
    assert len(planted) >= 6


FAULTS = {
    "tells no differences": lambda *_, **__: (),
    "tells what is not there": lambda *_, **__: (Difference("warning", "twice", "a target twice."),),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_attack_finds_a_comparison_that(fault, monkeypatch):
    monkeypatch.setattr(module, "differences", FAULTS[fault])
    with pytest.raises(Wrong):
        Counter(attack(seed) for seed in range(40))


def test_a_digit_is_changed_by_as_much_as_asked():
    planter = compared.Planter.__new__(compared.Planter)
    planter.rng, planter.lines = np.random.default_rng(1), ["LIN {X 12.3456,Y -0.5,Z 3}\n"]
    for _ in range(50):
        text = planter.changed(0, "X", 0.03)
        value = float(text.split("X ")[1].split(",")[0])
        assert 0.03 <= abs(value - 12.3456) <= 400.0
        assert sum(a != b for a, b in zip(text, planter.lines[0], strict=True)) == 1
