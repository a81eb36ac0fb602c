"""The gravity compensator's law against derivatives of its energy and a triangle."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.compensator import Compensator
from postproc.errors import ModelError

LAW = Compensator(stiffness=1.2e5, free_length=0.458, L=0.18472, ax=0.68593, ay=0.1233)
Q2 = np.radians(np.linspace(-146.0, 20.0, 30))


def test_length_is_that_of_the_triangle_p0_p2_p1():
    p1 = LAW.L * np.stack([np.cos(Q2), np.sin(Q2)], axis=1)
    np.testing.assert_allclose(LAW.length(Q2), np.linalg.norm(p1 + np.array([LAW.ax, LAW.ay]), axis=1), atol=1e-15)


def test_gradient_and_stiffness_are_derivatives_of_the_energy():
    h = 1e-5
    slope = (LAW.energy(Q2 + h) - LAW.energy(Q2 - h)) / (2 * h)
    np.testing.assert_allclose(LAW.gradient(Q2), slope, rtol=1e-7, atol=1e-3)
    curve = (LAW.gradient(Q2 + h) - LAW.gradient(Q2 - h)) / (2 * h)
    np.testing.assert_allclose(LAW.stiffness_about_joint(Q2), curve, rtol=1e-7, atol=1e-3)


@pytest.mark.parametrize("shape", [(30,), (5, 6), ()])
def test_columns_are_the_shares_of_stiffness_and_preload_for_angles_of_any_shape(shape):
    """Of gradient and stiffness, which are linear in both: springs of one of them alone."""
    q2 = np.resize(Q2, shape)
    for column, spring in enumerate((LAW.with_spring(1.0, 0.0), LAW.with_spring(1e-3, 1.0))):
        rest = 0.0 if column == 0 else 1e-3  # of the stiffness that it needs to have a length
        for columns, of in (
            (LAW.gradient_columns, spring.gradient),
            (LAW.stiffness_columns, spring.stiffness_about_joint),
        ):
            found = columns(q2)
            assert found.shape == (*shape, 2)
            np.testing.assert_allclose(found[..., column] + rest * found[..., 0], of(q2), rtol=1e-9, atol=1e-12)


def test_the_assumed_spring_of_the_kr_270_2_balances_about_5_kNm():
    assert 4e3 < np.abs(LAW.gradient(Q2)).max() < 9e3


@pytest.mark.parametrize(
    "wrong",
    [
        {"L": 0.9},
        {"L": 0.5, "ax": 0.3, "ay": 0.4},  # at one angle its length would be zero
        {"L": 0.0},
        {"L": -0.1},
        {"stiffness": -1.0},
        {"free_length": -0.1},
        {"stiffness": np.nan},
    ],
)
def test_impossible_geometry_is_refused(wrong):
    given = {"stiffness": 1e5, "free_length": 0.4, "L": 0.2, "ax": 0.6, "ay": 0.1}
    Compensator(**given)
    with pytest.raises(ModelError, match="impossible"):
        Compensator(**given | wrong)
