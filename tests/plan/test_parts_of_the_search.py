"""Pieces of the search one by one: draws, proposals, plans to compare with, what blocks, and the site's units."""

from __future__ import annotations

import re
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import PlanError
from postproc.identification.readings import Box, Measurements, read_experiment
from postproc.plan import constraints, milling, planning, search
from postproc.plan.compensator import CompensatorOptions, plan_compensator, summary, text_lines
from postproc.plan.criterion import Joint2, _compliances_by_parameters, measured_information
from postproc.plan.search import Candidates, Plan, Task
from postproc.plan.sensitivity import Readings, direction
from postproc.plan.site import BoxShape, site_of
from postproc.robot import JOINT_COMPLIANCES
from tests.plan import setting
from tests.plan.setting import BASIC, RIG

VARIANCE = 2 * setting.SIGMA**2 / 3
LOAD, MARKERS = np.array(setting.LOAD_POINT), np.array(list(setting.POINTS.values()))


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return setting.site(tmp_path_factory.mktemp("site"))


def test_draws_are_uniform_in_the_joints_and_over_the_cap_of_directions(site):
    q, tilt = search.draw_poses(site, 40_000, np.random.default_rng(0))
    low, high = np.maximum(site.lower, -np.pi), np.minimum(site.upper, np.pi)
    assert (low < high).all()
    assert np.abs(high[3:]).max() <= np.pi
    # four standard errors of means and of the variance of uniform numbers
    np.testing.assert_allclose((q.mean(axis=0) - 0.5 * (low + high)) / (high - low), 0.0, atol=4 / np.sqrt(12 * 4e4))
    np.testing.assert_allclose(q.std(axis=0) / (high - low), 1 / np.sqrt(12), rtol=0.02)
    assert ((q >= low) & (q <= high)).all()
    down = direction(tilt)
    limit = np.radians(30.0)
    angle = np.arccos(-down[:, 2])
    assert angle.max() <= limit + 1e-9
    # of the cap of 30° the share below an angle is that of its area
    for inner in np.radians([10.0, 20.0, 28.0]):
        assert np.mean(angle < inner) == pytest.approx((1 - np.cos(inner)) / (1 - np.cos(limit)), abs=0.01)
    np.testing.assert_allclose(down[:, :2].mean(axis=0), 0.0, atol=0.01)
    assert np.mean(down[:, 0] * down[:, 1]) == pytest.approx(0.0, abs=0.003)
    level, _ = search.draw_poses(site, 5, np.random.default_rng(0), q2=-1.25)
    assert (level[:, 1] == -1.25).all()


def test_proposals_go_down_the_gradient_and_around_the_pose_within_the_limits(site):
    rng = np.random.default_rng(1)
    q, tilt = np.radians([-30.0, -80.0, 95.0, 40.0, 60.0, 20.0]), np.array([0.1, -0.2])
    slope = np.array([2.0, 50.0, -1.0, 0.5, 0.0, -4.0, 1.0, 3.0])
    new_q, new_tilt = search._proposed_poses(site, q, tilt, slope, rng, 0.01)
    assert slope[1] == 50.0  # of the caller: it stays
    steps = np.array([0.5, 0.25, 0.12, 0.06, 0.03, 0.012, 0.004])
    # the largest component of a step is its length; A2 stays at its level
    unit = -np.array([2.0, 0.0, -1.0, 0.5, 0.0, -4.0, 1.0, 3.0]) / 4.0
    np.testing.assert_allclose(new_q[:7] - q, steps[:, None] * unit[:6], atol=1e-12)
    inside = np.linalg.norm(tilt + steps[:, None] * unit[6:], axis=1) < site.rig.largest_tilt
    assert inside.sum() >= 3
    np.testing.assert_allclose((new_tilt[:7] - tilt)[inside], (steps[:, None] * unit[6:])[inside], atol=1e-12)
    assert (new_q[:, 1] == q[1]).all()
    assert len(new_q) == 7 + 24
    changed = (np.abs(new_q[7:] - q) > 0.0)[:, [0, 2, 3, 4, 5]]
    assert changed[12:].all()
    assert 0.1 < changed[:12].mean() < 0.5  # three joints of ten
    assert np.std((new_q[19:] - q)[:, [0, 2, 3, 4, 5]]) == pytest.approx(0.01, rel=0.3)
    far_q, far_tilt = search._proposed_poses(site, site.upper, np.array([0.4, 0.3]), -slope, rng, 0.5)
    assert ((far_q >= site.lower) & (far_q <= site.upper)).all()
    size = np.linalg.norm(far_tilt, axis=1)
    assert size.max() == pytest.approx(site.rig.largest_tilt)
    hanging = replace(site, rig=replace(site.rig, largest_tilt=0.0))
    steep = np.append(slope[:6], [9.0, -20.0])  # a load that hangs does not turn, however much that would help
    hung_q, hung_tilt = search._proposed_poses(hanging, q, np.zeros(2), steep, rng, 0.01)
    assert not hung_tilt.any()
    np.testing.assert_allclose(hung_q[:7] - q, steps[:, None] * unit[:6], atol=1e-12)


class FakeCriterion:
    """The sum of the information, and what it was asked."""

    def __init__(self, q2):
        self.q2, self.asked = q2, []

    def value(self, information, level):
        self.asked.append((information, level))
        return float(information.sum())


def task_of(site, q2, per_level=6, count=7, levels=3, fixed=0, seed=0):
    """Poses at random, whose information is the number of their level and of themselves; criteria that are noted."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, (len(q2), per_level, 6))
    q[:, :, 1] = np.asarray(q2)[:, None]
    number = 100.0 * np.arange(len(q2))[:, None] + np.arange(per_level)
    information = np.zeros((len(q2), per_level, 6, 6))
    information[:, :, 0, 0] = number
    criteria = []

    def criterion_at(levels_q2):
        criteria.append(FakeCriterion(levels_q2))
        return criteria[-1]

    candidates = Candidates(np.asarray(q2, dtype=float), q, rng.normal(size=(len(q2), per_level, 2)), information,
                            np.zeros((len(q2), per_level, 6)))  # fmt: skip
    return Task(site, None, criterion_at, candidates, count, levels, None, fixed), criteria


GRID = np.radians(np.arange(-120.0, -20.0, 5.0))


def test_random_plans_have_different_levels_apart_and_any_pose_of_each(site):
    task, criteria = task_of(site, GRID)
    values = search.random_values(task, 5, 40)
    assert len(values) == len(criteria) == 40
    picked = []
    for value, criterion in zip(values, criteria, strict=True):
        ((information, level),) = criterion.asked
        assert value == information.sum()
        assert level.tolist() == [0, 0, 0, 1, 1, 2, 2]
        gaps = np.abs(criterion.q2[:, None] - criterion.q2[None])[np.triu_indices(3, 1)]
        assert gaps.min() >= np.radians(8.0) - 1e-9
        rows = np.array([int(np.argmin(np.abs(GRID - q2))) for q2 in criterion.q2])
        numbers = information[:, 0, 0]
        assert (numbers // 100 == rows[level]).all()
        picked += (numbers % 100).tolist()
    assert set(picked) == set(range(6))
    assert len({tuple(criterion.q2) for criterion in criteria}) > 30
    np.testing.assert_array_equal(values, search.random_values(task, 5, 40))


def test_levels_nearer_than_eight_degrees_are_taken_only_if_there_are_too_few_others(site):
    near = np.radians([-100.0, -93.0, -60.0])
    task, _ = task_of(site, near, levels=2)
    for seed in range(10):
        rows = search.first_levels(task, np.random.default_rng(seed), spread=False)
        assert abs(near[rows[0]] - near[rows[1]]) >= np.radians(8.0)
    task, _ = task_of(site, near, levels=3)
    assert sorted(search.first_levels(task, np.random.default_rng(0), spread=False)) == [0, 1, 2]
    task, _ = task_of(site, GRID, levels=4)
    rows = search.first_levels(task, np.random.default_rng(0), spread=True)
    assert rows.tolist() == [0, 6, 13, 19]
    fixed, _ = task_of(site, GRID, levels=4, fixed=2)
    for spread in (False, True):
        rows = search.first_levels(fixed, np.random.default_rng(1), spread=spread)
        assert rows[:2].tolist() == [0, 1]  # those that were measured come first
        assert len(set(rows.tolist())) == 4


def test_groups_are_as_equal_as_can_be_and_at_random_where_levels_were_measured(site):
    task, _ = task_of(site, GRID, count=8)
    assert task.pose_levels(np.random.default_rng(0)).tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    fixed, _ = task_of(site, GRID, count=600, fixed=2)
    share = np.bincount(fixed.pose_levels(np.random.default_rng(0)), minlength=3) / 600
    np.testing.assert_allclose(share, 1 / 3, atol=0.08)


def test_the_plan_of_the_serial_approach_has_the_most_dexterous_poses_that_are_farthest_apart(site):
    """Jacobian by differences of another arm, its lengths over the root of their mean square in all poses."""
    task, _ = task_of(site, GRID[::9], per_level=20, count=6, levels=3)
    plan = search.serial_plan(task)
    assert plan.q2.tolist() == GRID[::9].tolist()
    assert plan.level.tolist() == [0, 0, 1, 1, 2, 2]

    def jacobian(q):
        moved = setting.differences(lambda x: setting.ORACLE.tcp(x, setting.in_flange(LOAD))[:3, 3], q)
        pose = setting.differences(lambda x: setting.ORACLE.frames(x)[-1][:3, :3], q)
        turned = np.einsum("ijk,lj->ilk", pose, setting.ORACLE.frames(q)[-1][:3, :3])
        turn = np.array([turned[2, 1], turned[0, 2], turned[1, 0]])
        return moved, turn

    for group in range(3):
        poses = task.candidates.q[group]
        pairs = [jacobian(q) for q in poses]
        length = np.sqrt(np.mean([np.sum(moved**2, axis=0) for moved, _ in pairs]))
        singular = [np.linalg.svd(np.vstack([moved / length, turn]), compute_uv=False) for moved, turn in pairs]
        worth = np.array([values[-1] / values[0] for values in singular])
        np.testing.assert_allclose(search._dexterity(task, poses), worth, rtol=1e-5)
        best = np.argsort(-worth)[:4]  # a fifth of twenty
        first = poses[best[0]]
        second = max((poses[row] for row in best[1:]), key=lambda q: np.linalg.norm(q - first))
        chosen = plan.q[plan.level == group]
        np.testing.assert_allclose(chosen, [first, second])
        own = [int(np.argmin(np.abs(poses - q).sum(axis=1))) for q in chosen]
        np.testing.assert_array_equal(plan.tilt[plan.level == group], task.candidates.tilt[group][own])
    picks = [
        int(np.argmin(np.abs(task.candidates.q[g] - q).sum(axis=1))) for g, q in zip(plan.level, plan.q, strict=True)
    ]
    assert plan.value == task.candidates.information[plan.level, picks].sum()


def test_each_further_row_is_the_farthest_from_all_before():
    q = np.array([[0.0], [1.0], [10.0], [4.0], [6.1], [-3.0], [99.0]])
    assert search._distant_rows(q, np.array([0, 1, 2, 3, 4, 5]), 4) == [0, 2, 3, 5]
    assert search._distant_rows(q, np.array([1, 0, 2]), 3) == [1, 2, 0]


@pytest.mark.parametrize(
    ("rows", "culprit"),
    [
        # of 4000 poses: forbidden by the floor, by the sight, by a box; what alone forbids most of the others
        ({"floor": (0, 3990), "sight": (0, 3900), "box": (3985, 4000)}, "floor"),
        ({"floor": (0, 3000), "sight": (2500, 4000)}, "floor"),
        ({"floor": (0, 2400), "sight": (1500, 4000)}, "sight"),
        ({"floor": (0, 4000), "sight": (0, 4000), "box": (0, 10)}, "floor"),
    ],
)
def test_what_blocks_is_the_constraint_without_which_most_poses_were_possible(site, monkeypatch, rows, culprit):
    forbidden = {name: (np.arange(4000) >= low) & (np.arange(4000) < high) for name, (low, high) in rows.items()}
    monkeypatch.setattr(constraints, "failures", lambda *_: {**forbidden, "none": np.zeros(4000, dtype=bool)})
    text = search.blocking_text(site, np.random.default_rng(0))
    assert text.startswith(f"no pose can be measured: what blocks is: {culprit}. Of 4000 poses at random: ")
    assert "none" not in text
    stated = re.findall(r"(floor|sight|box) forbids ([\d.]+) %(?:, without it (\d+) poses were possible)?", text)
    share = {name: (high - low) / 40.0 for name, (low, high) in rows.items()}
    assert [name for name, *_ in stated] == sorted(rows, key=lambda name: -share[name])
    for name, percent, free in stated:
        assert float(percent) == pytest.approx(share[name], abs=0.05)
        alone = forbidden[name].copy()
        for other in rows:
            if other != name:
                alone &= ~forbidden[other]
        assert int(free or 0) == alone.sum()


def measured(repeats=(3, 2), configs=4, load=None):
    """Loads on two levels of A2, read so often under load and without it."""
    rng = np.random.default_rng(3)
    q = np.radians([0.0, -80, 90, 0, 60, 0]) + rng.uniform(-0.4, 0.4, (configs, 6))
    q[:, 1] = np.radians([-80.0, -79.0, -110.0, -80.5])[:configs]
    wrench = np.zeros((2 * configs, 6))
    wrench[1::2, :3] = rng.normal(size=(configs, 3)) * 900.0
    rows = [(s, r, p) for s in range(2 * configs) for r in range(repeats[1 - s % 2]) for p in range(3)]
    state, repeat, point = np.array(rows).T
    return Measurements(
        file="m.csv", config=1.0 + np.arange(configs), q=q, state_config=np.arange(2 * configs) // 2,
        load=(np.arange(2 * configs) % 2).astype(float), wrench=wrench, points=("P1", "P2", "P3"), guess=MARKERS,
        load_point=LOAD, sigma=setting.SIGMA, state=state, point=point, repeat=1.0 + repeat,
        position=np.zeros((len(rows), 3)), line=2 + np.arange(len(rows)), used=np.ones(len(rows), dtype=bool),
    )  # fmt: skip


def test_earlier_readings_weigh_as_often_as_they_were_read(site):
    data, scale = measured(), setting.ROBOT.compliance
    readings = Readings(site.arm, LOAD, MARKERS, 1.0, 7e-5, scale)
    found = measured_information(data, readings, setting.SIGMA)
    assert found.level.tolist() == [1, 1, 0, 1]
    np.testing.assert_allclose(np.degrees(found.q2), [-110.0, np.mean([-80.0, -79.0, -80.5])])
    np.testing.assert_array_equal(found.q, data.q)
    for row in range(4):
        design = setting.regressor(data.q[row], data.wrench[2 * row + 1, :3], LOAD, MARKERS) * scale
        variance = setting.SIGMA**2 * (1 / 3 + 1 / 2)  # loaded three times, unloaded twice
        expected = design.T @ design / variance
        np.testing.assert_allclose(found.information[row], expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max())


def test_torques_of_earlier_readings_are_those_of_the_largest_load_of_each_configuration(site):
    data = measured()
    second = replace(
        data, state_config=np.append(data.state_config, [1, 2]), load=np.append(data.load, [2.0, 2.0]),
        wrench=np.vstack([data.wrench, 0.5 * data.wrench[3], 2.0 * data.wrench[5]]),
    )  # fmt: skip
    readings = Readings(site.arm, LOAD, MARKERS, 1.0, 1.0, np.ones(6))
    found = planning._largest_torques(second, readings)
    for row, factor in enumerate((1.0, 1.0, 2.0, 1.0)):
        moved = setting.differences(lambda x: setting.ORACLE.tcp(x, setting.in_flange(LOAD))[:3, 3], data.q[row])
        np.testing.assert_allclose(
            found[row], factor * moved.T @ data.wrench[2 * row + 1, :3], atol=1e-5 * np.abs(found).max()
        )


def test_a_site_has_metres_radians_and_newtons(tmp_path):
    text = BASIC.replace("Z = 262\n", "Z = 262\nnormal = [0, 3, 4]\n").replace("sigma_mm = 0.03", "sigma_mm = 0.05") + (
        "\n[rig]\nmass_kg = 100\nmax_angle_deg = 20\nrope_mm = 700\nweight_radius_mm = 150\n"
        "max_torque_Nm = [1, 2, 3, 4, 5, 6]\n"
        "[tracker]\nX = 4000\nY = -2500\nZ = 1300\nacceptance_deg = 25\n"
        "[floor]\nZ = -120\n[body]\nradius_mm = [100, 200, 300, 400, 500]\ntool_radius_mm = 60\nclearance_mm = 45\n"
        "[[boxes]]\nX = 1000\nsize = [400, 200, 600]\n"
    )
    site = setting.site(tmp_path, text, margin=3.0)
    assert site.rig.force == pytest.approx(100 * 9.80665, rel=1e-3)
    assert (site.rig.largest_tilt, site.rig.rope, site.rig.weight_radius) == pytest.approx((np.radians(20), 0.7, 0.15))
    np.testing.assert_allclose(site.tracker, [4.0, -2.5, 1.3])
    assert (site.floor, site.tool_radius, site.clearance) == pytest.approx((-0.12, 0.06, 0.045))
    assert (site.sigma, site.acceptance) == pytest.approx((5e-5, np.radians(25)))
    np.testing.assert_allclose(site.radius, [0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(site.torque_limit, [1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(site.lower, setting.ROBOT.lower + np.radians(3.0))
    np.testing.assert_allclose(site.upper, setting.ROBOT.upper - np.radians(3.0))
    np.testing.assert_allclose(site.normals[0], [0.0, 0.6, 0.8])
    assert np.isnan(site.normals[1:]).all()
    np.testing.assert_allclose(site.points, MARKERS)
    np.testing.assert_allclose(site.load_point, LOAD)
    assert site.names == ("P1", "P2", "P3")
    (obstacle,) = site.obstacles
    assert obstacle.name == "box 1"
    np.testing.assert_allclose(obstacle.half, [0.2, 0.1, 0.3])
    assert obstacle.distance(np.array([1.5, 0.0, 0.0])) == pytest.approx(0.3)
    plain = setting.site(tmp_path, BASIC + RIG)
    assert plain.tracker is None
    # shares of the reach of the wrist: from A2 to A3, and from there to A5
    frames = setting.ORACLE.frames(np.zeros(6))
    at = [frame[:3, 3] for frame in frames]
    reach = np.linalg.norm(at[2] - at[1]) + np.linalg.norm(at[4] - at[2])
    np.testing.assert_allclose(plain.radius / reach, [0.149, 0.085, 0.12, 0.072, 0.055])
    with pytest.raises(PlanError, match=r"\[points.P2\] normal is zero"):
        setting.site(tmp_path, text.replace("Z = 255\n", "Z = 255\nnormal = [0, 0, 0]\n"))
    joint = int(np.argmin(setting.ROBOT.upper - setting.ROBOT.lower))
    half = 0.5 * float((setting.ROBOT.upper - setting.ROBOT.lower)[joint])
    with pytest.raises(PlanError, match=f"leaves nothing of the range of A{joint + 1}"):
        site_of(setting.ROBOT, read_experiment(tmp_path / "experiment.toml"), tmp_path, setting.CELL.start_joints, half)


def test_torques_are_limited_by_the_urdf_only_if_it_states_all_of_them(tmp_path):
    from postproc.plan.site import _torque_limit

    effort = np.array([1e3, 2e3, 3e3, 4e3, 5e3, 6e3])
    model = SimpleNamespace(nominal=SimpleNamespace(effort=effort))
    np.testing.assert_array_equal(_torque_limit(model, None), effort)
    np.testing.assert_array_equal(_torque_limit(model, (6.0,) * 6), np.full(6, 6.0))
    for missing in (0.0, np.inf, np.nan):
        partial = np.where(np.arange(6) == 3, missing, effort)
        assert _torque_limit(SimpleNamespace(nominal=SimpleNamespace(effort=partial)), None) is None


def test_the_folded_arm_reaches_less_far_than_all_others_that_are_possible(site):
    q = planning.folded_pose(site)
    assert q[0] == 0.0
    ends = np.vstack([LOAD, MARKERS])

    def reach(angles):
        frames = setting.ORACLE.frames(angles)
        places = [frame[:3, 3] for frame in frames] + [(frames[-1] @ [*end, 1.0])[:3] for end in ends]
        return max(np.hypot(*place[:2]) for place in places)

    room = replace(site, obstacles=())
    assert constraints.are_passable(room, q[None]).all()
    others, _ = search.draw_poses(site, 300, np.random.default_rng(7))
    others = others[constraints.are_passable(room, others)]
    assert len(others) > 30
    assert reach(q) < np.quantile([reach(angles) for angles in others], 0.02)
    # a joint that cannot turn to zero is turned as near to it as it can
    aside = replace(site, lower=np.where(np.arange(6) == 0, 0.5, site.lower))
    assert planning.folded_pose(aside)[0] == 0.5


def test_the_order_of_travel_counts_blocked_moves_and_the_seconds_of_the_others(site, monkeypatch):
    q = np.radians([[18.0, -80, 90, 0, 60, 0], [10.0, -80, 90, 0, 60, 0], [30.0, -80, 90, 0, 60, 0]])
    start = np.radians([0.0, -80, 90, 0, 60, 0])
    here = replace(site, start=start)
    monkeypatch.setattr(planning, "free_moves", lambda _, stops: np.ones((len(stops), len(stops)), dtype=bool))
    order, seconds, blocked = planning.least_travel(here, q)
    assert order.tolist() == [1, 0, 2]
    assert seconds == pytest.approx(30.0 / 86.0)  # A1 does 86°/s
    assert blocked.tolist() == []
    free = np.ones((4, 4), dtype=bool)
    free[2, 0] = free[0, 2] = False  # from the start to the second
    monkeypatch.setattr(planning, "free_moves", lambda *_: free)
    order, seconds, blocked = planning.least_travel(here, q)
    assert order.tolist() == [0, 1, 2]
    assert seconds == pytest.approx((18.0 + 8.0 + 20.0) / 86.0)
    assert blocked.tolist() == []
    free[0] = free[:, 0] = False
    order, _, blocked = planning.least_travel(here, q)
    assert blocked.tolist() == [0]
    stops = [start, *q[order]]
    assert sum(np.abs(b - a).max() for a, b in pairwise(stops)) == pytest.approx(np.radians(30.0))


def test_ways_round_go_by_the_start_by_folding_or_both(site, monkeypatch):
    """Only the moves named are free; poses of A1 in whole tens of degrees."""
    start, fold = np.radians([0.0, -90, 90, 0, 0, 0]), np.radians([0.0, -120, 140, 0, 0, 0])
    q = np.radians([[40.0, -60, 60, 0, 0, 0], [-70.0, -60, 60, 0, 0, 0]])
    monkeypatch.setattr(planning, "folded_pose", lambda _: fold)
    here = replace(site, start=start)

    def at(shape, angle):
        turned = shape.copy()
        turned[0] = np.radians(angle)
        return turned

    options = [
        [start], [at(start, -70.0)], [at(start, 40.0)], [at(start, 40.0), at(start, -70.0)],
        [at(fold, -70.0)], [at(fold, 40.0)], [at(fold, 40.0), at(fold, -70.0)],
    ]  # fmt: skip
    for number, via in enumerate(options):
        allowed = {tuple(np.round(stop, 9)) for stop in via}

        def passable(_, stops, allowed=allowed):
            return np.array([tuple(np.round(stop, 9)) in allowed for stop in stops])

        monkeypatch.setattr(planning.constraints, "are_passable", passable)
        monkeypatch.setattr(planning, "free_moves", lambda _, stops: np.ones((len(stops), len(stops)), dtype=bool))
        ways, stuck = planning.via_poses(here, q, np.array([1]))
        assert stuck.tolist() == []
        assert len(ways[0]) == 0
        if number in (3, 6):  # a single one of its two poses would do
            assert len(ways[1]) == 1
        else:
            np.testing.assert_allclose(ways[1], via)
    calls = []

    def one_move_blocked(_, stops):
        calls.append(stops)
        free = np.ones((len(stops), len(stops)), dtype=bool)
        if len(stops) == 3:
            free[1, 2] = free[2, 1] = False
        return free

    monkeypatch.setattr(planning.constraints, "are_passable", lambda _, stops: np.ones(len(stops), dtype=bool))
    monkeypatch.setattr(planning, "free_moves", one_move_blocked)
    ways, stuck = planning.via_poses(here, q, np.array([1]))
    np.testing.assert_allclose(ways[1], options[3])
    np.testing.assert_allclose(calls[0], [q[0], start, q[1]])
    ways, _ = planning.via_poses(here, q, np.array([0]))  # the first begins at the start
    np.testing.assert_allclose(ways[0], [at(start, 0.0), at(start, 40.0)])
    monkeypatch.setattr(planning, "free_moves", lambda _, stops: np.eye(len(stops), dtype=bool))
    assert planning.via_poses(here, q, np.array([0, 1]))[1].tolist() == [0, 1]


def test_what_stays_uncertain_is_named_with_what_to_do():
    spring = SimpleNamespace(compensator=object(), has_free_compensator=False)
    parameters = (JOINT_COMPLIANCES[0], JOINT_COMPLIANCES[4])
    accuracy = SimpleNamespace(uncertain=parameters)
    first, second, third = planning.uncertainty_warnings(accuracy, spring, np.array([0, 4]))
    assert first.startswith("k1, k5: the 95 % interval will be wider than half the value")
    assert second.startswith("the spring of the gravity compensator (K_c, s_0) cannot be determined")
    assert "on its way to configuration 1, 5: jog it there by hand" in third
    for joint2 in (
        SimpleNamespace(compensator=None, has_free_compensator=False),
        SimpleNamespace(compensator=object(), has_free_compensator=True),
    ):
        assert planning.uncertainty_warnings(SimpleNamespace(uncertain=()), joint2, np.zeros(0, dtype=int)) == []


def test_a_parameter_is_uncertain_from_half_its_value_on():
    from postproc.plan.criterion import Accuracy

    relative = np.array([0.49, 0.51, np.nan, np.inf, 0.5])
    accuracy = Accuracy(1.0, (0.5, 1.5), np.ones(1), JOINT_COMPLIANCES[:5], relative)
    assert accuracy.uncertain == JOINT_COMPLIANCES[1:4]


def test_programs_count_alike_and_shares_of_the_work_add_up_to_one():
    long, short = setting.job(1, count=30), setting.job(2, count=10)
    both = milling.join([long, short])
    assert both.weight.sum() == pytest.approx(1.0)
    assert both.weight[:30].sum() == pytest.approx(0.5)
    assert len(both) == 40
    np.testing.assert_array_equal(both.q, np.vstack([long.q, short.q]))
    np.testing.assert_array_equal(both.torque[30:], short.torque)
    np.testing.assert_array_equal(both.deflection[:30], long.deflection)
    assert both.source == "job 1, job 2"


def test_the_deflection_of_a_test_pose_is_that_of_the_force_by_an_independent_arm():
    """J diag(k) Jᵀ F by differences, with k2 of gear and compensator together."""
    tests = setting.job(3).take(np.arange(0, 300, 60))
    slopes = setting.milling_regressors(tests)
    for row, angles in enumerate(tests.q):
        k = np.array(setting.ROBOT.compliance)
        k[1] = setting.oracle_k2(angles[1], k[1], True)
        assert tests.deflection[row] == pytest.approx(np.linalg.norm(slopes[row] @ k), rel=2e-3)
        moved = setting.differences(lambda x: (setting.ORACLE.frames(x)[-1] @ setting.CELL.tool.pose())[:3, 3], angles)
        np.testing.assert_allclose(tests.torque[row], moved.T @ tests.wrench[row, :3], rtol=1e-5, atol=1e-3)


def test_a_plan_of_the_compensator_is_written_in_millimetres_and_degrees():
    plan = plan_compensator(setting.ROBOT, 0.04e-3, CompensatorOptions(angles=3, repeats=2))
    written = summary(plan)
    law = setting.ROBOT.compensator
    assert [written[key]["prior"] for key in ("L_mm", "a_x_mm", "a_y_mm")] == pytest.approx(
        [1e3 * law.L, 1e3 * law.ax, 1e3 * law.ay]
    )
    assert [written[key]["ci95"] for key in ("L_mm", "a_x_mm", "a_y_mm")] == pytest.approx((1e3 * plan.ci95).tolist())
    even = [written[key]["ci95_even_angles"] for key in ("L_mm", "a_x_mm", "a_y_mm")]
    assert even == pytest.approx((1e3 * plan.ci95_even).tolist())
    assert np.sum(np.square(even)) > np.sum(plan.ci95**2) * 1e6
    assert written["q2_deg"] == pytest.approx(np.degrees(plan.q2).tolist())
    assert written["sigma_mm"] == 0.04
    assert [marker["beta_deg"] for marker in written["markers"]] == [0.0, 90.0, 180.0, 270.0]
    # the spring's direction from P0 = −(a_x, a_y) to P1 on its circle
    angle = [np.arctan2(law.L * np.sin(q) + law.ay, law.L * np.cos(q) + law.ax) for q in plan.q2]
    assert written["turn_deg"] == pytest.approx(np.degrees(max(angle) - min(angle)))
    lines = text_lines(plan)
    assert lines[0].endswith(f"the compensator turns by {written['turn_deg']:.1f}°")
    assert "P01 0°, P02 90°, P03 180°, P04 270°; any radius; opposite markers at equal radius" in lines[1]
    assert lines[2].startswith(f"2 readings each with 0.04 mm noise: L ± {1e3 * plan.ci95[0]:.3f} mm, a_x ±")
    assert f"L ± {even[0]:.3f} mm, a_x ± {even[1]:.3f} mm, a_y ± {even[2]:.3f} mm" in lines[3]
    odd = plan_compensator(setting.ROBOT, 0.04e-3, CompensatorOptions(angles=3, markers=3))
    assert "opposite" not in text_lines(odd)[1]


def test_the_search_improves_the_best_few_of_its_starts(monkeypatch):
    """Values of starts, and what refining makes of each; the best so far is yielded at each step."""
    starts = {0: 9.0, 1: 5.0, 2: 7.0, 3: 6.0}
    refined = {5.0: [4.9, 4.8], 6.0: [3.0, 3.5], 7.0: [0.1]}

    def plan(value):
        return Plan(np.zeros((1, 6)), np.zeros((1, 2)), np.zeros(1, dtype=int), np.zeros(1), value)

    seeds = iter(range(4))
    spreads = []

    def exchange(_task, _rng, spread):
        spreads.append(spread)
        return plan(starts[next(seeds)])

    monkeypatch.setattr(search, "exchange", exchange)
    monkeypatch.setattr(search, "refine", lambda _task, start, _rng, rounds: map(plan, refined[start.value][:rounds]))
    values = [found.value for found in search.improve(None, 0, 4, 2, 2)]
    assert values == [9.0, 5.0, 5.0, 5.0, 4.9, 4.8, 3.0, 3.0]
    assert spreads == [True, False, False, False]


def test_relative_compliance_of_joint_2_follows_gear_and_spring_in_series():
    law = Joint2.of(setting.ROBOT, free=True)
    assert law.has_free_compensator
    bare = Joint2.of(replace(setting.ROBOT, compensator=None), free=True)
    assert not bare.has_free_compensator
    q2 = np.radians([-20.0, -70.0, -120.0])
    k = setting.ROBOT.compliance[1]
    np.testing.assert_allclose(law.relative_compliance(q2), [setting.oracle_k2(a, k, True) / k for a in q2], rtol=1e-5)
    np.testing.assert_array_equal(bare.relative_compliance(q2), 1.0)
    np.testing.assert_array_equal(bare.stiffness_columns(q2), [[1.0, 0.0, 0.0]] * 3)
    np.testing.assert_array_equal(bare.level_derivatives(q2[:2], q2), np.full((3, 2), 0.5))


def test_parts_of_the_arm_stretched_out_are_not_too_close_to_each_other(site):
    """Their coarse shapes, here of a thick arm, overlap there without a collision."""
    site = replace(site, radius=3.0 * site.radius)
    state = constraints.State.of(site, np.zeros((1, 6)), None)
    pairs = constraints._capsule_pairs(site, state)
    gaps = constraints._axis_distances(pairs)[:, 0]
    overlapping = [
        one.radius + other.radius + site.clearance > gap for (one, other), gap in zip(pairs, gaps, strict=True)
    ]
    assert any(overlapping)
    assert all(allowed.all() for _, allowed in constraints._self_clearance(site, state))


def test_more_levels_than_can_be_measured_are_refused(site, monkeypatch):
    task, _ = task_of(site, GRID[::9])
    monkeypatch.setattr(planning, "draw_candidates", lambda *_: task.candidates)
    options = planning.Options(configurations=8, levels=4)
    with pytest.raises(PlanError, match="poses can be measured at 3 of the levels of q2 tried only, 4 are asked for"):
        planning._planning_problem(site, setting.job(), setting.ROBOT.compliance, options, None)


@pytest.mark.parametrize("keep", [(0, 1, 2, 3, 4, 5), (1, 3)])
def test_compliances_depend_on_gear_and_spring_of_joint_2_by_its_pose(keep):
    """Of a stiff spring: differences of the second derivative of its energy."""
    spring = setting.ROBOT.compensator
    stiff = replace(setting.ROBOT, compensator=replace(spring, stiffness=6e6))
    q = np.zeros((3, 6))
    q[:, 1] = np.radians([-20.0, -70.0, -120.0])
    gear, values = stiff.compliance[1], np.array([6e6, 6e6 * spring.free_length])

    def k2(angle, parameters):
        """For 1/K⁰_θ2 over the gear's, and K_c and s₀·K_c."""
        arm, h = np.hypot(spring.ax, spring.ay), 1e-4
        lengths = [
            np.sqrt(arm**2 + spring.L**2 + 2 * arm * spring.L * np.cos(np.arctan2(spring.ay, spring.ax) - angle + by))
            for by in (-h, 0.0, h)
        ]
        energy = [0.5 * parameters[1] * length**2 - parameters[2] * length for length in lengths]
        return 1.0 / (1.0 / parameters[0] + gear * (energy[0] - 2.0 * energy[1] + energy[2]) / h**2)

    for free in (False, True):
        found = _compliances_by_parameters(Joint2.of(stiff, free), list(keep), q)
        size, two = len(keep), keep.index(1)
        assert found.shape == (3, size, size + (2 if free else 0))
        for row, angle in enumerate(q[:, 1]):
            whole = np.array([1.0, *values])
            slopes = []
            for n in range(3):
                step = np.zeros(3)
                step[n] = 1e-4 * whole[n]
                slopes.append((k2(angle, whole + step) - k2(angle, whole - step)) / (2.0 * step[n]))
            assert found[row, two, two] == pytest.approx(slopes[0], rel=1e-4)
            assert abs(slopes[0] - 1.0) > 0.02
            if free:  # in units of K⁰_θ2 for the springs
                np.testing.assert_allclose(found[row, two, size:], np.array(slopes[1:]) / gear, rtol=1e-3)
            others = np.delete(np.delete(found[row, :, :size], two, 0), two, 1)
            np.testing.assert_array_equal(others, np.eye(size - 1))


def test_a_level_that_was_measured_stays_though_nothing_can_be_measured_there_now(site, monkeypatch):
    """It has no information to give, and no torques; levels of the grid need a tenth of the poses."""
    rng = np.random.default_rng(6)
    counts = {}

    def draw_feasible_poses(_site, q2, count, _rng):
        number = 0 if q2 == -1.0 else [count, 10, 9][len(counts) % 3]
        counts[q2] = number
        q, tilt = search.draw_poses(site, number, rng, q2)
        return q, tilt

    monkeypatch.setattr(search, "draw_feasible_poses", draw_feasible_poses)
    readings = Readings(site.arm, site.load_point, site.points, 900.0, 7e-5, setting.ROBOT.compliance)
    found = search.draw_candidates(site, readings, rng, np.array([-1.0]))
    assert found.q2.tolist() == [q2 for q2, number in counts.items() if number >= 10 or q2 == -1.0]
    assert not found.information[0].any()
    assert not found.torque[0].any()
    assert found.information[1:].any(axis=(2, 3)).all()
    assert found.torque[1:].any(axis=2).all()
    pulls = 900.0 * direction(found.tilt[1])
    np.testing.assert_allclose(found.torque[1], readings.torque(found.q[1], pulls), rtol=1e-9, atol=1e-9)
    few = int(np.argmax([counts[q2] == 10 for q2 in found.q2]))
    np.testing.assert_array_equal(found.q[few, :10], found.q[few, 10:20])  # repeated
    assert found.take_parameters((1, 3)).information.shape[2:] == (2, 2)
    np.testing.assert_array_equal(found.take_parameters((1, 3)).information[..., 0, 1], found.information[..., 1, 3])
    assert len(found) == len(found.q2)
    counts.clear()
    counts.update(dict.fromkeys((7.0, 8.0), 0))  # so that the first level of the grid has too few
    free = search.draw_candidates(site, readings, rng)
    assert free.q2.tolist() == [q2 for q2, number in counts.items() if number >= 10]
    assert free.q2[0] > site.lower[1]


def test_a_long_part_is_compared_with_an_obstacle_all_along(site):
    """A thin one whose ends are far from a small box that its middle runs through."""
    shape = BoxShape.of(Box(size=(100.0, 100.0, 100.0), X=0.0), 1)
    end = np.array([[0.6, 0.0, 0.0], [0.6, 0.3, 0.0], [0.0, 0.6, 0.1]])
    parts = (constraints.Capsule("tool", -end, end, 0.02), constraints.Capsule("rope", end + 1.0, end + 2.0, 0.01))
    assert constraints._keeps_clearance(site, parts, shape, 3).tolist() == [False, False, False]
    away = np.array([0.0, 0.0, 0.5])
    parts = (constraints.Capsule("tool", away - end, away + end, 0.02),)
    assert constraints._keeps_clearance(site, parts, shape, 3).tolist() == [True, True, True]
