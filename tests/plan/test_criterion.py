from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.plan import search
from postproc.plan.criterion import Criterion, Joint2, expected_accuracy, unidentifiable_joints
from postproc.plan.sensitivity import Readings, direction, direction_slope
from tests.plan import setting

REPEATS = 3
VARIANCE = 2 * setting.SIGMA**2 / REPEATS


@pytest.fixture(scope="module")
def readings(tmp_path_factory):
    site = setting.site(tmp_path_factory.mktemp("site"))
    scale = setting.ROBOT.compliance
    return Readings(site.arm, site.load_point, site.points, site.rig.force, np.sqrt(VARIANCE), scale), site


def plan(site, levels=(-2.2, -1.4, -0.5, -0.2), each=3, seed=1):
    rng = np.random.default_rng(seed)
    level = np.repeat(np.arange(len(levels)), each)
    q, tilt = search.draw_poses(site, len(level), rng)
    q[:, 1] = np.array(levels)[level]
    return q, tilt, level, np.array(levels)


def test_the_pooled_criterion_is_that_of_finite_differences_of_an_independent_arm(readings):
    readings, site = readings
    q, tilt, level, q2 = plan(site)
    tests = replace(setting.job(3).take(np.array([0, 70, 200])), weight=np.array([0.5, 0.2, 0.3]))
    criterion = Criterion.of(tests, readings, Joint2.of(setting.ROBOT, free=False), q2, grouped=False)
    own = criterion.value(readings.information(q, tilt), level)
    independent = setting.pooled(q, site.rig.force * direction(tilt), tests, VARIANCE)
    assert own == pytest.approx(independent, rel=1e-5)


def test_the_grouped_criterion_is_the_printed_formula_by_finite_differences(readings):
    readings, site = readings
    q, tilt, level, q2 = plan(site)
    tests = replace(setting.job(4).take(np.array([10, 150])), weight=np.array([0.6, 0.4]))
    criterion = Criterion.of(tests, readings, Joint2.of(setting.ROBOT, free=False), q2, grouped=True)
    own = criterion.value(readings.information(q, tilt), level)
    independent = setting.grouped(q, site.rig.force * direction(tilt), tests, VARIANCE)
    assert own == pytest.approx(independent, rel=1e-5)


@pytest.mark.parametrize("grouped", [False, True])
@pytest.mark.parametrize("free", [False, True])
def test_the_gradient_of_the_criterion_agrees_with_differences(readings, grouped, free):
    readings, site = readings
    q, tilt, level, q2 = plan(site, seed=5)
    criterion = Criterion.of(setting.job(), readings, Joint2.of(setting.ROBOT, free=free), q2, grouped=grouped)
    total = criterion.normal_matrix(readings.information(q, tilt), level)
    slope = readings.slope(q, tilt, criterion.information_slope(total, level))

    def value(x):
        changed_q, changed_tilt = q.copy(), tilt.copy()
        changed_q[4], changed_tilt[4] = x[:6], x[6:]
        return criterion.value(readings.information(changed_q, changed_tilt), level)

    here = np.concatenate([q[4], tilt[4]])
    expected = setting.differences(value, here, h=1e-5)
    assert np.abs(slope[4] - expected).max() < 1e-5 * np.abs(expected).max()


def test_moments_of_the_load_turn_the_joints_too(readings):
    """Torques are the work of force and moment per angle, by the positions of an independent arm."""
    readings, site = readings
    q, _, _, _ = plan(site, each=1)
    load = np.random.default_rng(6).normal(size=(len(q), 6)) * [900.0, 900, 900, 300, 300, 300]
    rows = readings.regressor(q, load) * readings.noise / readings.unit_compliance
    spots = np.array([[*spot, 1.0] for spot in (setting.LOAD_POINT, *setting.POINTS.values())])
    for angles, wrench, found in zip(q, load, rows, strict=True):
        pose = setting.differences(lambda x: setting.ORACLE.frames(x)[-1], angles)  # (4, 4, 6)
        moved = np.einsum("ijk,pj->pik", pose[:3], spots)
        turned = np.einsum("ijk,lj->ilk", pose[:3, :3], setting.ORACLE.frames(angles)[-1][:3, :3])
        turn = np.array([turned[2, 1], turned[0, 2], turned[1, 0]])
        torque = moved[0].T @ wrench[:3] + turn.T @ wrench[3:]
        np.testing.assert_allclose(found, (moved[1:] * torque).reshape(-1, 6), atol=1e-5 * np.abs(found).max())


def test_an_exchange_is_worth_what_the_changed_plan_is(readings):
    readings, site = readings
    q, tilt, level, q2 = plan(site)
    information = readings.information(q, tilt)
    new = readings.information(*search.draw_poses(site, 4, np.random.default_rng(9)))
    for grouped in (False, True):
        criterion = Criterion.of(setting.job(), readings, Joint2.of(setting.ROBOT, True), q2, grouped=grouped)
        values = criterion.exchange_values(
            criterion.normal_matrix(information, level), information[7], new, int(level[7])
        )
        for one, value in zip(new, values, strict=True):
            changed = information.copy()
            changed[7] = one
            assert criterion.value(changed, level) == pytest.approx(value, rel=1e-9)


def test_load_directions_have_unit_length_and_the_angle_asked_for():
    tilt = np.array([[0.0, 0.0], [0.3, 0.4], [-1.0, 0.2]])
    down = direction(tilt)
    assert np.abs(np.linalg.norm(down, axis=1) - 1).max() < 1e-15
    assert np.abs(np.arccos(-down[:, 2]) - np.linalg.norm(tilt, axis=1)).max() < 1e-7
    for row in range(3):
        slope = setting.differences(lambda x: direction(x[None])[0], tilt[row])
        assert np.abs(direction_slope(tilt)[row] - slope).max() < 1e-9


def test_k2_between_the_levels_follows_the_compensator():
    """With K_c free, errors at the levels that come from wrong K_c and s_0 are carried on exactly."""
    from msgspec.structs import replace

    law = Joint2.of(setting.ROBOT, free=True)
    levels, q2 = np.radians([-10, -50, -90, -130]), np.radians([-30.0, -75.0])
    spring = setting.ROBOT.compensator
    changed = replace(law, compensator=replace(spring, stiffness=spring.stiffness * 1.001, free_length=0.4581))
    carried = law.level_derivatives(levels, q2) @ (
        changed.relative_compliance(levels) - law.relative_compliance(levels)
    )
    assert np.abs(carried / (changed.relative_compliance(q2) - law.relative_compliance(q2)) - 1).max() < 1e-3


def spring_of_joint_2(q2, parameters):
    """k2 at angles (n,) of A2 for 1/K⁰_θ2, K_c, s₀K_c: second difference of the energy of a spring between two points.

    P1 is on link 2, at L from the axis; P0 on link 1.
    """
    compliance, stiffness, preload = parameters
    law = setting.ROBOT.compensator

    def energy(angle):
        length = np.abs(law.L * np.exp(1j * angle) + law.ax + 1j * law.ay)
        return 0.5 * stiffness * length**2 - preload * length

    h = 1e-3
    bent = (energy(q2 - h) - 2.0 * energy(q2) + energy(q2 + h)) / h**2
    return 1.0 / (1.0 / compliance + bent)


@pytest.mark.parametrize("free", [False, True])
def test_the_expected_accuracy_is_that_of_a_thousand_errors_of_an_independent_fit(readings, free):
    """Gauss–Markov by the oracle's positions and differences; errors of the parameters drawn with its covariance."""
    readings, site = readings
    q, tilt, *_ = plan(site, levels=(-2.3, -1.6, -0.9, -0.2), each=3, seed=2)
    tests = replace(setting.job(3).take(np.array([0, 70, 200])), weight=np.array([0.5, 0.2, 0.3]))
    law, k = setting.ROBOT.compensator, setting.ROBOT.compliance
    prior = np.array([k[1], law.stiffness, law.stiffness * law.free_length])[: 3 if free else 1]
    scale = np.concatenate([np.delete(k, 1), prior])

    def columns(rows, q2):
        """Columns of k1, k3 … k6 and of the parameters of joint 2, of columns (n, r, 6) of k1 … k6."""
        of_two = setting.differences(
            lambda x: spring_of_joint_2(q2, np.concatenate([x, np.ones(3)])[:3] * whole), np.ones(len(prior)), h=1e-4
        )
        return np.concatenate(
            [rows[:, :, [0, 2, 3, 4, 5]] * np.delete(k, 1), rows[:, :, 1:2] * of_two[:, None]], axis=2
        )

    whole = np.array([k[1], law.stiffness, law.stiffness * law.free_length])
    force = site.rig.force * direction(tilt)
    design = np.array(
        [setting.regressor(*one, setting.LOAD_POINT, setting.POINTS.values()) for one in zip(q, force, strict=True)]
    )
    design = columns(design, q[:, 1]).reshape(-1, len(scale))
    covariance = VARIANCE * np.linalg.inv(design.T @ design)
    work = columns(setting.milling_regressors(tests), tests.q[:, 1])
    found = expected_accuracy(tests, readings, Joint2.of(setting.ROBOT, free), q, readings.information_of(q, force))
    np.testing.assert_allclose(found.poses, np.sqrt(np.einsum("tka,ab,tkb->t", work, covariance, work)), rtol=1e-3)
    half = 1.96 * np.sqrt(np.diag(covariance))
    names = [parameter.name for parameter in found.parameters]
    for name, relative in zip(("k1", "k3", "k4", "k5", "k6", "k2", "K_c", "s_0"), half, strict=False):
        assert found.relative_half_widths[names.index(name)] == pytest.approx(relative, rel=2e-3), name
    assert len(names) == len(half)
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(len(half)), covariance, 4000)
    rms = np.sqrt(np.einsum("t,ntk->n", tests.weight, np.einsum("tka,na->ntk", work, drawn) ** 2))
    assert found.rms == pytest.approx(np.sqrt(np.mean(rms**2)), rel=0.02)
    # one χ² in place of a sum of many: its lower end is the less exact one
    low, high = np.quantile(rms, [0.025, 0.975])
    assert found.interval == (pytest.approx(low, rel=0.35), pytest.approx(high, rel=0.06))


def test_earlier_readings_count_as_poses_of_the_plan(readings):
    from postproc.plan.criterion import MeasuredLoads

    readings, site = readings
    q, tilt, level, q2 = plan(site)
    information, tests = readings.information(q, tilt), setting.job(3)
    known, new = MeasuredLoads(q[:5], q2[:2], information[:5], level[:5]), slice(5, None)
    joint2 = Joint2.of(setting.ROBOT, free=False)
    whole = expected_accuracy(tests, readings, joint2, q, information)
    parts = expected_accuracy(tests, readings, joint2, q[new], information[new], known)
    np.testing.assert_allclose(parts.poses, whole.poses, rtol=1e-9)
    for grouped in (False, True):
        alone, more = (Criterion.of(tests, readings, joint2, q2, grouped, each) for each in (None, known))
        assert more.value(information[new], level[new]) == pytest.approx(alone.value(information, level), rel=1e-9)


@pytest.mark.parametrize(("share", "missing"), [(1.1, ()), (0.9, (3,))])
def test_a_compliance_is_hidden_if_all_poses_together_leave_it_wider_than_half_its_value(readings, share, missing):
    """Readings of one pose know it to 1/√information; half the value is the limit of the identification."""
    readings, _ = readings
    each = np.full((7, 6, 6), 100.0 * np.eye(6))
    enough = (1.96 / 0.5) ** 2 / 8  # of eight poses, all as good as the best one
    each[:, 3, 3] = 0.1 * share * enough
    each[4, 3, 3] = share * enough
    assert unidentifiable_joints(each, 8) == missing
