"""Moves of a plan off its candidates, levels that were measured, and the sides that joints are loaded to."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.plan import constraints, criterion, planning, search
from postproc.plan.criterion import Directions
from tests.plan import setting
from tests.plan.test_make import measured_so_far, search_direction
from tests.plan.test_parts_of_the_search import VARIANCE, Plan

TWO = replace(setting.job().take(np.array([0, 150])), weight=np.array([0.5, 0.5]))


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    site = setting.site(tmp_path_factory.mktemp("site"))
    options = planning.Options(configurations=6, levels=3)
    return planning._planning_problem(site, TWO, setting.ROBOT.compliance, options, None).task


def start_of(task, seed=0):
    """Any plan of candidates, with its criterion by the code of the tests."""
    rng = np.random.default_rng(seed)
    row, level = search.first_levels(task, rng, spread=True), task.pose_levels(rng)
    pick = rng.integers(0, task.candidates.q.shape[1], task.count)
    at = row[level], pick
    plan = Plan(task.candidates.q[at], task.candidates.tilt[at], level, task.candidates.q2[row], 0.0)
    return replace(plan, value=value_of(task, plan))


def value_of(task, plan, before=None):
    q, force = plan.q, task.site.rig.force * search_direction(plan.tilt)
    if before is not None:
        q, force = np.vstack([before[0], q]), np.vstack([before[1], force])
    return setting.pooled(q, force, TWO, VARIANCE)


def lacking(task, plan):
    """How many poses lack to load each joint to both sides, by the torques of an independent arm."""
    count = np.zeros((6, 2), dtype=int)
    for angles, force in zip(plan.q, task.site.rig.force * search_direction(plan.tilt), strict=True):
        moved = setting.differences(
            lambda x: setting.ORACLE.tcp(x, setting.in_flange(setting.LOAD_POINT))[:3, 3], angles
        )
        torque = moved.T @ force
        count += np.stack([-torque, torque], axis=-1) >= task.directions.min_torque
    return np.maximum(task.directions.pose_count - count, 0).sum()


def test_poses_that_move_lower_the_criterion_can_be_measured_and_keep_their_level(task):
    plan = start_of(task)
    moved = search._move_poses(task, plan, np.random.default_rng(1), 0.3)
    assert moved.value == pytest.approx(value_of(task, moved), rel=1e-4)
    assert moved.value < 0.8 * plan.value
    assert constraints.are_feasible(task.site, moved.q, moved.tilt).all()
    np.testing.assert_array_equal(moved.q[:, 1], plan.q[:, 1])
    np.testing.assert_array_equal(moved.q2, plan.q2)
    assert lacking(task, moved) <= lacking(task, plan)
    assert (np.abs(moved.q - plan.q).max(axis=1) > 0.0).sum() >= 4
    assert (np.abs(moved.tilt - plan.tilt).max(axis=1) > 0.0).any()


def test_levels_that_move_take_their_poses_along(task):
    plan, changed = start_of(task), 0
    for _ in range(4):
        moved = search._move_levels(task, plan)
        assert moved.value == pytest.approx(value_of(task, moved), rel=1e-4)
        assert moved.value <= plan.value * (1.0 + 1e-9)
        np.testing.assert_array_equal(moved.q[:, 1], moved.q2[moved.level])
        assert constraints.are_feasible(task.site, moved.q, moved.tilt).all()
        assert (moved.q2 >= task.site.lower[1]).all()
        assert (moved.q2 <= task.site.upper[1]).all()
        gaps = np.abs(moved.q2[:, None] - moved.q2)[np.triu_indices(3, 1)]
        assert gaps.min() >= np.radians(8.0) - 1e-9
        assert lacking(task, moved) <= lacking(task, plan)
        np.testing.assert_array_equal(np.delete(moved.q, [1, 2], axis=1), np.delete(plan.q, [1, 2], axis=1))
        shift, follow = moved.q[:, 1] - plan.q[:, 1], moved.q[:, 2] - plan.q[:, 2]
        # link 2 alone, or so that the forearm keeps its direction
        assert ((np.abs(follow) < 1e-12) | (np.abs(follow + shift) < 1e-12)).all()
        changed += int(np.count_nonzero(np.abs(moved.q2 - plan.q2) > 1e-9))
        plan = moved
    assert changed >= 2


def test_each_pose_in_turn_is_exchanged_for_the_best_candidate_of_its_level(task):
    columns = {name: getattr(task.candidates, name)[:, :20] for name in ("q", "tilt", "information", "torque")}
    undemanding = replace(task.directions, pose_count=np.zeros((6, 2), dtype=int))
    task = replace(task, candidates=replace(task.candidates, **columns), directions=undemanding)
    rng = np.random.default_rng(7)
    row, level = search.first_levels(task, rng, spread=True), task.pose_levels(rng)
    pick = rng.integers(0, task.candidates.q.shape[1], task.count)
    found = search._exchange_poses(
        task, search._Choice(row, level, pick, task.criterion_at(task.candidates.q2[row]), 1.0)
    )
    information = [
        setting.normal_matrices(task.candidates.q[n], task.site.rig.force * search_direction(task.candidates.tilt[n]))
        for n in row
    ]
    best = pick.copy()
    for pose in range(task.count):
        values = []
        for candidate in range(len(information[level[pose]])):
            best[pose] = candidate
            matrices = np.array([information[group][n] for group, n in zip(level, best, strict=True)])
            values.append(setting.pooled_of(matrices, task.candidates.q2[row[level]], TWO, VARIANCE))
        best[pose] = int(np.argmin(values))
    assert (best != pick).sum() >= 5
    np.testing.assert_array_equal(found.pick, best)
    np.testing.assert_array_equal(found.level, level)
    assert found.value == pytest.approx(min(values), rel=1e-3)


def test_refining_never_raises_the_criterion_and_ends_where_little_is_gained(task, monkeypatch):
    monkeypatch.setattr(search, "_MIN_ROUND_GAIN", 0.1)  # it ends sooner
    plan = start_of(task, seed=3)
    values = [refined.value for refined in search.refine(task, plan, np.random.default_rng(2), 80)]
    assert 5 < len(values) < 80
    assert (np.diff([plan.value, *values]) <= 1e-9 * plan.value).all()
    assert values[4] < 0.7 * plan.value
    assert len(list(search.refine(task, plan, np.random.default_rng(2), 1))) == 1


def test_poses_go_to_the_level_where_they_help_most_if_levels_were_measured(tmp_path):
    """Two levels of earlier readings, at which the plan adds poses, and a third one."""
    data, q, force = measured_so_far(tmp_path)
    options = planning.Options(configurations=4, levels=3)
    site = setting.site(tmp_path)
    task = planning._planning_problem(site, TWO, setting.ROBOT.compliance, options, data).task
    assert (task.fixed_count, task.levels, task.count) == (2, 3, 4)
    rng = np.random.default_rng(5)
    row, level = search.first_levels(task, rng, spread=False), task.pose_levels(rng)
    pick = rng.integers(0, task.candidates.q.shape[1], task.count)

    def plan_of(row, level, pick):
        at = row[level], pick
        return Plan(task.candidates.q[at], task.candidates.tilt[at], level, task.candidates.q2[row], 0.0)

    value = value_of(task, plan_of(row, level, pick), (q, force))
    choice = search._Choice(row, level, pick, task.criterion_at(task.candidates.q2[row]), value)
    found = search._exchange_poses(task, choice)
    assert found.value == pytest.approx(
        value_of(task, plan_of(found.row, found.level, found.pick), (q, force)), rel=1e-3
    )
    assert found.value < choice.value
    moved = search._exchange_level(task, found, 2)
    assert moved.row[:2].tolist() == [0, 1]
    assert moved.value <= found.value
    other = value_of(task, plan_of(moved.row, moved.level, moved.pick), (q, force))
    assert moved.value == pytest.approx(other, rel=1e-3)
    assert moved.value < found.value
    np.testing.assert_allclose(np.degrees(task.candidates.q2[:2]), [-100.0, -40.0], atol=1e-6)


def test_the_typical_largest_torque_is_the_weighted_quantile_of_those_that_turn_a_joint():
    rng = np.random.default_rng(4)
    sides, weight = rng.exponential(300.0, (400, 6, 2)), rng.random(400)
    weight /= weight.sum()
    sides[:, 2, 1] = 0.9  # no torque
    rare = np.argsort(weight)[:3]
    sides[:, 4, 0] = 0.0
    sides[rare, 4, 0] = 500.0  # of less than one per cent of the work
    found = criterion._typical_torques(sides, weight)
    for joint in range(6):
        for side in range(2):
            rows = [n for n in range(400) if sides[n, joint, side] > 1.0]
            total = sum(weight[n] for n in rows)
            if total <= 0.01:
                assert found[joint, side] == 0.0
                continue
            done = 0.0
            for n in sorted(rows, key=lambda n: sides[n, joint, side]):
                done += weight[n]
                if done >= 0.95 * total:
                    break
            assert found[joint, side] == sides[n, joint, side]
    assert found[2, 1] == found[4, 0] == 0.0


@pytest.mark.parametrize(("work", "least"), [(20.0, 50.0), (120.0, 120.0), (900.0, 250.0), (0.0, 50.0)])
def test_a_pose_counts_from_the_torque_of_the_work_within_what_poses_reach(work, least):
    """Between a tenth and a half of the typical largest torque of poses that can be measured, 500 N·m here."""
    torque = np.concatenate([np.full((50, 6), 500.0), np.full((50, 6), -500.0)])
    tests = replace(
        setting.job().take(np.array([0, 1])), weight=np.array([0.5, 0.5]), torque=np.array([[work] * 6, [-work] * 6])
    )
    found = criterion.required_directions(torque, tests, 30)
    np.testing.assert_allclose(found.min_torque, least)
    np.testing.assert_allclose(found.rig_torque, 500.0)
    np.testing.assert_allclose(found.work_torque, work)
    assert (found.pose_count == 5).all()  # as many as cover a direction
    assert (criterion.required_directions(torque, tests, 9).pose_count == 3).all()  # one pose of three
    one_sided = criterion.required_directions(np.abs(torque), tests, 30)
    np.testing.assert_array_equal(one_sided.pose_count, [[0, 5]] * 6)
    tiny = criterion.required_directions(torque * 1e-2, tests, 30)
    assert tiny.min_torque.min() >= 1.0  # below 1 N·m a torque has no sign


def test_poses_count_by_joint_and_side():
    demand = Directions(np.array([[2, 1]] * 6), np.full((6, 2), 100.0), np.ones((6, 2)), np.ones((6, 2)))
    torque = np.array([[100.0, 99.0, -100.0, -99.0, 0.0, 500.0]])
    expected = [[False, True], [False, False], [True, False], [False, False], [False, False], [False, True]]
    assert demand.loaded_sides(torque)[0].tolist() == expected
    count = np.array([[2, 1], [1, 1], [0, 5], [3, 0], [2, 2], [0, 0]])
    assert demand.missing_count(count) == 0 + 1 + 2 + 1 + 0 + 3


def test_steps_get_shorter_where_nothing_is_gained_until_they_are_a_degree_or_so(task, monkeypatch):
    """By the factor .4 from .3 rad on; a round with a gain keeps them."""
    scales, gains = [], iter([0.5, 0.0, 0.004, 0.0, 0.002, 0.0, 0.0, 0.0])

    def move(_task, plan, _rng, scale):
        scales.append(scale)
        return replace(plan, value=plan.value * (1.0 - next(gains)))

    monkeypatch.setattr(search, "_move_poses", move)
    monkeypatch.setattr(search, "_move_levels", lambda _, plan: plan)
    plans = list(search.refine(task, replace(start_of(task), value=1.0), None, 99))
    # 0.3 % is the least gain
    np.testing.assert_allclose(scales, [0.3, 0.3, 0.12, 0.12, 0.048, 0.0192])
    assert len(plans) == 6
    assert plans[-1].value == pytest.approx(0.5 * 0.996 * 0.998)


def test_the_search_is_two_thirds_of_the_work_by_starts_and_half_of_the_rounds(monkeypatch):
    """Of three plans that are refined; rounds beyond that do not count."""
    plans = [Plan(np.zeros((1, 6)), np.zeros((1, 2)), np.zeros(1), np.zeros(1), 1.0 / (n + 1)) for n in range(90)]
    monkeypatch.setattr(planning, "improve", lambda *_: iter(plans))
    told = []
    options = planning.Options(starts=8, rounds=40)
    best, interrupted = planning._search(None, options, lambda *each: told.append(each))
    assert (best, interrupted) == (plans[-1], False)
    steps = 8 + 3 * 40 // 2
    np.testing.assert_allclose([share for _, share, _ in told], [0.65 * min(1.0, (n + 1) / steps) for n in range(90)])
    np.testing.assert_allclose([root for *_, root in told], [np.sqrt(1.0 / (n + 1)) for n in range(90)])
