"""Bound over deflection where work is done, and the chance that correction makes a place better there."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.identification import uncertainty
from postproc.identification.uncertainty import Workspace, WorkspaceLevel, bound_over_workspace
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
    found = bound_over_workspace(model([2.0] * 6), data)
    assert found.refusal == found.reservation == ""
    # one compliance alone: two standard deviations of 2 %; in all directions together less than thrice that
    assert 0.03 < found.worst_level.bound_ratio < 0.12
    assert [round(level.load) for level in found.levels][-1] <= 2700
    assert all(one.load < other.load for one, other in zip(found.levels, found.levels[1:], strict=False))
    assert "bound over deflection in the workspace: below" in found.line


def test_a_spring_that_no_reading_shows_is_named_with_joint_and_pose(data):
    found = bound_over_workspace(model([2.0, 2.0, 300.0, 2.0, 2.0, 2.0]), data)
    assert found.refusal == ""
    assert "the bound is up to" in found.reservation
    assert "most of it comes from A3, whose readings do not determine k3" in found.reservation
    assert "A1 … A6 = " in found.reservation


def test_an_unmodelled_error_as_large_as_the_deflection_is_a_reservation_with_its_chance(data):
    found = bound_over_workspace(model([2.0] * 6, off=2e-3), data)
    assert "the unmodelled error is 2.0" in found.reservation
    least = min(level.chance for level in found.measured_levels)
    assert f"a chance of {100 * least:.0f} % only" in found.reservation
    assert found.refusal == ""


@pytest.mark.parametrize(("worst", "is_reserved"), [(0.85, False), (0.98, True)])
def test_a_bound_about_as_large_as_the_deflection_is_a_reservation(worst, is_reserved):
    small, measured = (WorkspaceLevel(load, 1e-3, 1e-4, share, 0.9) for load, share in ((50.0, 2.0), (500.0, worst)))
    workspace = Workspace((small, measured), 400.0, "k3 is not determined", (0.0,) * 6)
    assert (workspace.reservation != "") == is_reserved
    if is_reserved:
        assert workspace.reservation.startswith("under 500 N the bound is up to 0.98 times the deflection (A1 … A6 = 0")
        assert workspace.reservation.endswith("k3 is not determined")


def test_the_chance_is_that_of_draws_of_the_error(data):
    """Errors of the compliances are drawn; correction by the stated ones must be better as often as is said."""
    rng, percent = np.random.default_rng(5), 60.0
    stated = model([percent] * 6, off=0.1e-3)
    said = bound_over_workspace(stated, data).levels[-1]
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    q, direction = uncertainty._random_poses(stated, tool)
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
    found = bound_over_workspace(model([2.0] * 6, off=0.15e-3), data)
    assert found.refusal == found.reservation == ""
    assert found.levels[0].bound_ratio > 1.0
    assert "N and below the bound can exceed the deflection" in found.line


def test_each_level_has_the_median_and_the_quantile_of_its_poses(data):
    """Deflections by the linear springs of another arm; bounds of two deviations of one compliance, which is larger."""
    from tests.identification.test_joint_springs import ARM

    percent = [0.01, 0.01, 20.0, 0.01, 0.01, 0.01]
    bare = replace(model(percent, off=1e-9), compensator=None)
    found = bound_over_workspace(bare, data)
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    q, direction = uncertainty._random_poses(bare, tool)
    slopes = np.array(
        [np.array([ARM.gradient(lambda x, a=a: ARM.tcp(x, tool)[a, 3], row) for a in range(3)]) for row in q]
    )  # (n, 3, 6)
    measured = []
    for state in np.flatnonzero(data.load > 0.0):
        row = data.q[data.state_config[state]]
        lever = np.array([ARM.gradient(lambda x, a=a: ARM.tcp(x, tool)[a, 3], row) for a in range(3)])
        measured.append(np.abs(lever.T @ data.wrench[state, :3]))
    measured = np.max(measured, axis=0)
    largest = np.linalg.norm(data.wrench[:, :3], axis=1).max()
    torque = np.einsum("nij,ni->nj", slopes, direction)
    loaded = measured > 0.02 * measured.max()
    size = largest * np.minimum(1.0, (measured[loaded] / np.abs(torque[:, loaded] * largest)).min(axis=1))
    moved = np.einsum("nij,nj->ni", slopes, torque * harness.PRIOR.compliance)
    third = slopes[:, :, 2] * (torque[:, 2] * harness.PRIOR.compliance[2])[:, None]
    smallest = found.levels[0]
    assert smallest.load == pytest.approx(np.median(0.05 * size), rel=1e-6)
    assert smallest.deflection == pytest.approx(np.median(0.05 * size * np.linalg.norm(moved, axis=1)), rel=2e-3)
    bound = 1.96 * 0.2 * 0.05 * size * np.linalg.norm(third, axis=1)
    assert smallest.bound == pytest.approx(np.median(bound), rel=0.02)
    ratio = bound / (0.05 * size * np.linalg.norm(moved, axis=1))
    assert smallest.bound_ratio == pytest.approx(np.quantile(ratio, 0.95), rel=0.03)
    loads = np.array([level.load for level in found.levels])
    np.testing.assert_allclose(loads / loads[-1], [0.05, 0.1, 0.2, 0.5, 1.0])
    assert found.least_load == pytest.approx(np.linalg.norm(data.wrench[data.load > 0.0, :3], axis=1).min())
    assert "A3" in found.cause
    angles = np.array(found.pose)
    at = int(np.argmin(np.abs(q - angles).sum(axis=1)))
    np.testing.assert_array_equal(q[at], angles)
    assert ratio[at] == pytest.approx(np.quantile(ratio, 0.95), rel=0.05)
