"""Plans load every joint to both sides, as far as the rig can: torques by the simulator's own chain."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.identification.validation import MIN_CONFIGURATIONS
from postproc.plan import criterion, milling
from postproc.plan.criterion import unreachable_direction_warnings
from samples.paper_study import simulator
from tests.plan import setting
from tests.plan.setting import BASIC

HANGING = BASIC + "\n[rig]\nmass_kg = 275\n"


def simulated(q, force):
    """Torques (n, 6) of forces at the load point [N·m]."""
    bare = simulator.TrueRobot(simulator.Gear("linear", 1 / simulator.PAPER_K, np.ones(6)))
    frames = bare.frames(bare.commanded(q))
    flange = bare.flange(frames)
    return bare.pulled(frames, 5, flange[:, :3, 3] + flange[:, :3, :3] @ np.array(setting.LOAD_POINT), force)


def sides(torque, least):
    return np.stack([-torque >= least[:, 0], torque >= least[:, 1]], axis=-1).sum(axis=0)


def work(joints, forces):
    """Test poses under forces at the tip, root axes."""
    wrench = np.zeros((len(joints), 6))
    wrench[:, :3] = forces
    return milling.poses_under_load(
        setting.ROBOT, np.radians(joints), setting.CELL.tool.pose(), wrench, weight=np.ones(len(joints)), source="work"
    )


ONE_POSE = work([[0, -70, 110, 0, 50, 0], [5, -65, 105, 5, 45, 0]], [[0, 0, 500.0], [0, 0, 450.0]])
"""Work under one force: what the criterion alone wants measured is one-sided."""


@pytest.mark.parametrize("configurations", [8, 15])
def test_every_joint_is_loaded_to_both_sides_by_the_torque_of_the_work(tmp_path, configurations):
    result = setting.quick(tmp_path, tests=ONE_POSE, configurations=configurations, levels=4)
    torque = simulated(result.plan.q, result.force)
    np.testing.assert_allclose(result.torque, torque, atol=1e-6 * np.abs(torque).max())
    found = result.directions
    assert np.all(found.pose_count == min(MIN_CONFIGURATIONS, configurations // 3))
    assert np.all(sides(torque, found.min_torque) >= found.pose_count)
    # near the work: a pose counts by its torque, where poses that can be measured reach that
    np.testing.assert_allclose(found.work_torque, work_of(ONE_POSE), rtol=1e-9)
    reachable = found.work_torque <= 0.5 * found.rig_torque
    assert np.all(found.min_torque[reachable] >= found.work_torque[reachable])
    assert np.all(found.min_torque >= 0.1 * found.rig_torque - 1e-9)


def work_of(tests):
    """Largest torques of two samples to each side: by the oracle's positions, differences, and the wrench."""
    torque = np.array(
        [
            setting.differences(lambda x: (setting.ORACLE.frames(x)[-1] @ setting.CELL.tool.pose())[:3, 3], q).T @ w[:3]
            for q, w in zip(tests.q, tests.wrench, strict=True)
        ]
    )
    found = np.stack([np.maximum(-torque, 0).max(axis=0), np.maximum(torque, 0).max(axis=0)], axis=-1)
    return np.where(found > 1.0, found, 0.0)


def test_without_the_condition_the_same_search_leaves_joints_one_sided(tmp_path, monkeypatch):
    needed = setting.quick(tmp_path, tests=ONE_POSE, configurations=15, levels=4)

    def no_need(*arguments):
        return replace(criterion.required_directions(*arguments), pose_count=np.zeros((6, 2), dtype=np.int64))

    monkeypatch.setattr("postproc.plan.planning.required_directions", no_need)
    free = setting.quick(tmp_path, tests=ONE_POSE, configurations=15, levels=4)
    assert np.any(
        sides(simulated(free.plan.q, free.force), needed.directions.min_torque) < needed.directions.pose_count
    )
    # the condition costs little of the criterion
    assert free.plan.value <= needed.plan.value * 1.05
    assert np.sqrt(needed.plan.value / free.plan.value) < 1.3


def test_a_weight_that_hangs_cannot_turn_a1_and_the_warning_says_so(tmp_path):
    result = setting.quick(tmp_path, tests=ONE_POSE, text=HANGING)
    (told,) = [warning for warning in result.warnings if "cannot turn the torque" in warning]
    assert "A1 (negative and positive)" in told
    assert "A4" not in told
    assert "max_angle_deg if a pulley can turn the pull" in told
    assert np.all(result.directions.pose_count[0] == 0)
    counted = sides(simulated(result.plan.q, result.force), result.directions.min_torque)
    assert np.all(counted[1:] >= result.directions.pose_count[1:])


def test_a_direction_that_only_the_work_has_is_named_with_its_torque():
    torque = np.abs(np.random.default_rng(0).normal(300.0, 50.0, (500, 6)))
    found = criterion.required_directions(torque, ONE_POSE, 15)
    (told,) = unreachable_direction_warnings(found, vertical=False)
    negative = found.work_torque[:, 0]
    joint = int(np.argmax(negative))
    assert negative[joint] > 0.0
    assert f"A{joint + 1} (negative; the work has up to {negative[joint]:.0f} N·m negative)" in told
    assert "a larger [rig] max_angle_deg" in told
    assert (
        unreachable_direction_warnings(
            criterion.required_directions(np.concatenate([torque, -torque]), ONE_POSE, 15), vertical=False
        )
        == ()
    )


def test_what_was_measured_counts(tmp_path):
    both = np.concatenate([np.full((10, 6), 500.0), np.full((10, 6), -500.0)])
    assert np.all(criterion.required_directions(both, ONE_POSE, 9).pose_count == 3)
    measured = np.concatenate([np.full((2, 6), 500.0), np.full((4, 6), -500.0)])
    found = criterion.required_directions(both, ONE_POSE, 9, measured)  # 15 poses in all: five to each side
    assert found.pose_count.tolist() == [[1, 3]] * 6
