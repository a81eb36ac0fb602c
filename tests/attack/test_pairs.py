"""Pairs that `convert` makes of one program belong together; for hours: `python -m tests.attack.pairs`."""

import pytest

from tests.attack.pairs import attack

SEEDS = [0, 2, 4, 6, 9, 13, 19, 37, 113, 123]
"""Arcs divided elsewhere, FEED forces, steps of the force, retracts, a helix, a move in place, loops."""


@pytest.mark.parametrize("seed", SEEDS)
def test_every_pair_of_one_conversion_is_ok(seed):
    assert attack(seed).endswith("pairs")
