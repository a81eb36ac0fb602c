from __future__ import annotations

import numpy as np
import pytest

from postproc.plan import search
from postproc.plan.criterion import Criterion, Joint2
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
    q, tilt = search.draw(site, len(level), rng)
    q[:, 1] = np.array(levels)[level]
    return q, tilt, level, np.array(levels)


def test_the_pooled_criterion_is_that_of_finite_differences_of_an_independent_arm(readings):
    readings, site = readings
    q, tilt, level, q2 = plan(site)
    tests = setting.job(3).take(np.array([0, 70, 200]), np.array([0.5, 0.2, 0.3]))
    criterion = Criterion.of(tests, readings, Joint2.of(setting.ROBOT, free=False), q2, grouped=False)
    own = criterion.value(readings.information(q, tilt), level)
    independent = setting.pooled(q, site.rig.force * direction(tilt), tests, VARIANCE)
    assert own == pytest.approx(independent, rel=1e-5)


def test_the_grouped_criterion_is_the_printed_formula_by_finite_differences(readings):
    readings, site = readings
    q, tilt, level, q2 = plan(site)
    tests = setting.job(4).take(np.array([10, 150]), np.array([0.6, 0.4]))
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
    total = criterion.total(readings.information(q, tilt), level)
    slope = readings.slope(q, tilt, criterion.push(total, level))

    def value(x):
        changed_q, changed_tilt = q.copy(), tilt.copy()
        changed_q[4], changed_tilt[4] = x[:6], x[6:]
        return criterion.value(readings.information(changed_q, changed_tilt), level)

    here = np.concatenate([q[4], tilt[4]])
    expected = setting.differences(value, here, h=1e-5)
    assert np.abs(slope[4] - expected).max() < 1e-5 * np.abs(expected).max()


def test_an_exchange_is_worth_what_the_changed_plan_is(readings):
    readings, site = readings
    q, tilt, level, q2 = plan(site)
    information = readings.information(q, tilt)
    new = readings.information(*search.draw(site, 4, np.random.default_rng(9)))
    for grouped in (False, True):
        criterion = Criterion.of(setting.job(), readings, Joint2.of(setting.ROBOT, True), q2, grouped=grouped)
        values = criterion.exchanged(criterion.total(information, level), information[7], new, int(level[7]))
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
    carried = law.from_levels(levels, q2) @ (changed.relative(levels) - law.relative(levels))
    assert np.abs(carried / (changed.relative(q2) - law.relative(q2)) - 1).max() < 1e-3
