"""Pairs that `convert` makes of one program belong together; for hours: `python -m tests.attack.pairs`."""

import pytest

from tests.attack.pairs import attack

SEEDS = [0, 2, 4, 6, 9, 13, 19, 37, 113, 123]
"""Arcs divided elsewhere, FEED forces, steps of the force, retracts, a helix, a move in place, loops."""


@pytest.mark.parametrize("seed", SEEDS)
def test_every_pair_of_one_conversion_is_ok(seed, tmp_path):
    _, found = attack(seed, tmp_path)
    assert found
    for pair, (code, state, why, counts) in found.items():
        reasons = [why] if isinstance(why, str) else list(why)
        asks_for_forces = bool(reasons) and all("Give" in reason and "--forces" in reason for reason in reasons)
        assert (code, state) == (0, "ok") or (pair in ("nominal", "source without forces") and asks_for_forces), (
            pair,
            why,
        )
        assert not any(counts.values()), (pair, counts)
