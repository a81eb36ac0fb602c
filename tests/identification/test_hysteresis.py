"""Loads up and down: backlash and friction are told by joint, and not taken for stiffening."""

import pytest

from tests.benchmarks import hysteresis


@pytest.mark.parametrize(
    ("kind", "named", "most"),
    [("friction in A4", ["A4"], 0.02), ("backlash in every joint", None, 0.1)],
)
def test_backlash_and_friction_of_gears_that_do_not_stiffen_are_told_as_what_they_are(kind, named, most):
    """Gears as they are: the other five joints of the first kind, and `tests.benchmarks.hysteresis`."""
    told, factor, inside, fades = hysteresis.tried(0, *hysteresis.KINDS[kind])
    assert told == named if named is not None else len(told) >= 4
    assert factor > 20
    assert inside >= 0.9
    assert fades < most
