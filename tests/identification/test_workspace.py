"""Bound over deflection where work is done, and the chance that correction makes a place better there."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.identification import uncertainty
from postproc.identification.uncertainty import over_workspace
from samples.paper_study import harness, simulator


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(1)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 15)
    _, raw = simulator.measure(true, q, f, rng, levels=(0.2, 1.0))
    return harness.load(simulator.write(folder, q, f, raw, levels=(0.2, 1.0)))


def model(percent, off=5e-6):
    """The KR 270 with compliances known to so many per cent, and an unmodelled error."""
    sigma = np.asarray(percent) / 100.0 * 1e6 * harness.PRIOR.compliance
    covariance = robot.Covariance(robot.JOINT_COMPLIANCES, np.diag(sigma**2))
    unmodelled = robot.Discrepancy(np.array([540.0, 2700.0]), np.array([off, off]))
    return replace(harness.PRIOR, covariance=covariance, discrepancy=unmodelled)


def test_a_model_whose_springs_are_known_is_usable(data):
    found = over_workspace(model([2.0] * 6), data)
    assert found.refusal == found.reservation == ""
    # one compliance alone: two standard deviations of 2 %; in all directions together less than thrice that
    assert 0.03 < found.worst.worst < 0.12
    assert [round(level.load) for level in found.levels][-1] <= 2700
    assert all(one.load < other.load for one, other in zip(found.levels, found.levels[1:], strict=False))
    assert "bound over deflection in the workspace: below" in found.line


def test_a_spring_that_no_reading_shows_is_named_with_joint_and_pose(data):
    found = over_workspace(model([2.0, 2.0, 300.0, 2.0, 2.0, 2.0]), data)
    assert found.refusal == ""
    assert "the bound is up to" in found.reservation
    assert "most of it comes from A3, whose readings do not determine k3" in found.reservation
    assert "A1 … A6 = " in found.reservation


def test_an_unmodelled_error_as_large_as_the_deflection_is_a_reservation_with_its_chance(data):
    found = over_workspace(model([2.0] * 6, off=2e-3), data)
    assert "the unmodelled error is 2.0" in found.reservation
    least = min(level.chance for level in found.measured)
    assert f"a chance of {100 * least:.0f} % only" in found.reservation
    assert found.refusal == ""


def test_the_chance_is_that_of_draws_of_the_error(data):
    """Errors of the compliances are drawn; correction by the stated ones must be better as often as is said."""
    rng, percent = np.random.default_rng(5), 60.0
    stated = model([percent] * 6, off=0.1e-3)
    said = over_workspace(stated, data).levels[-1]
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    q, direction = uncertainty._poses(stated, tool)
    wrench = np.concatenate([said.load * direction, 0.0 * direction], axis=1)
    deflection = elastostatics.deflect(stated, q, tool, wrench).twist[:, :3]
    slopes = elastostatics.sensitivity(stated, q, tool, wrench)
    sigma = np.sqrt(np.diag(stated.covariance.matrix))
    better = []
    for _ in range(400):
        error = slopes @ (sigma * rng.normal(size=6)) + 0.1e-3 / 2.7955 * rng.normal(size=(len(q), 3))
        better.append(np.linalg.norm(error, axis=1) < np.linalg.norm(deflection + error, axis=1))
    assert said.chance == pytest.approx(np.quantile(np.mean(better, axis=0), 0.05), abs=0.04)


def test_forces_too_small_to_correct_are_stated_but_refuse_nothing(data):
    found = over_workspace(model([2.0] * 6, off=0.15e-3), data)
    assert found.refusal == found.reservation == ""
    assert found.levels[0].worst > 1.0
    assert "N and below the bound can exceed the deflection" in found.line
