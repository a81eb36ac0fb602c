"""Some of the random programs that copy points."""

import pytest

from tests.attack.copied_points import attempt


@pytest.mark.parametrize("first", range(0, 30, 10))
def test_copied_points_are_corrected_where_that_changes_nothing_else(first, tmp_path):
    states = []
    for seed in range(first, first + 10):
        folder = tmp_path / str(seed)
        folder.mkdir()
        states.append(attempt(seed, folder))
    assert states.count("with copies") >= 3
