"""A model that misses much of what was measured is said to, with both numbers."""

from types import SimpleNamespace

import numpy as np
import pytest

from postproc.identification import uncertainty

SIZE = 0.7e-3
"""RMS displacement of the points under load [m]."""


def readings(rng):
    """Two configurations, one without load each, 40 points; the last point has no reading under the first load."""
    mean = rng.normal(size=(4, 40, 3))
    displacement = rng.normal(size=(2, 40, 3))
    displacement[0, -1] = 0.0
    displacement *= SIZE / np.sqrt(np.sum(displacement**2) / 79)
    mean[[1, 3]] = mean[[0, 2]] + displacement
    count = np.ones((4, 40), dtype=int)
    count[1, -1], mean[1, -1] = 0, np.nan
    return SimpleNamespace(
        means=lambda: (mean, count),
        loaded_states=np.array([1, 3]),
        unloaded_states=np.array([0, 2]),
        state_config=np.array([0, 0, 1, 1]),
    )


@pytest.mark.parametrize("share", [0.1, 0.29, 0.31, 0.6])
@pytest.mark.parametrize("square_error", [3.9, 4.1])
@pytest.mark.parametrize("is_chosen", [True, False])
def test_errors_beyond_noise_and_a_third_of_the_displacements_put_the_set_up_in_question(
    share, square_error, is_chosen
):
    rng = np.random.default_rng(1)
    data = readings(rng)
    left = rng.normal(size=(2, 40, 3))
    left[0, -1] = 0.0
    left *= share * SIZE / np.sqrt(np.sum(left**2) / 79)
    choice = SimpleNamespace(left_out=left, held_out=np.array([square_error, square_error])) if is_chosen else None
    fit = SimpleNamespace(residual=left, chi2=square_error * 100.0, dof=100)
    misfit = uncertainty._misfit(data, fit, choice)
    for limit in (0.3, 0.5):
        text = misfit.text_beyond(limit)
        assert bool(text) == (share > limit and square_error > 4.0)
        if text:
            assert f"off by {1e3 * share * SIZE:.2g} mm RMS of displacements of 0.7 mm: check axes" in text
