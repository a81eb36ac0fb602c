from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import PlanError
from postproc.identification.readings import read, read_experiment
from postproc.plan import Options, constraints, plan_measurements, planning, search
from postproc.plan.sensitivity import Readings
from postproc.robot import JOINT_COMPLIANCES, CompensatorStiffness
from samples.paper_study import simulator
from tests.plan import setting
from tests.plan.setting import BASIC, RIG

VARIANCE = 2 * setting.SIGMA**2 / 3


@pytest.mark.parametrize(("seed", "grouped"), [(11, False), (13, True)])
def test_a_plan_beats_the_best_of_200_random_ones_by_an_independent_criterion(tmp_path, seed, grouped, capsys):
    """Random plans: levels, poses and loads at random that can be measured; criterion by tests/plan/setting.py."""
    result = setting.quick(
        tmp_path, tests=setting.job(seed), configurations=15, levels=5, test_poses=3, grouped=grouped, seed=seed
    )
    criterion = setting.grouped if grouped else setting.pooled
    own = criterion(result.plan.q, result.force, result.tests, VARIANCE)
    assert own == pytest.approx(result.plan.value, rel=1e-4)
    of_matrices = setting.grouped_of if grouped else setting.pooled_of
    q2, information = random_poses(setting.site(tmp_path), np.random.default_rng(seed))
    rng, random = np.random.default_rng(seed + 100), []
    for _ in range(200):
        rows = rng.choice(len(q2), 5, replace=False)
        picks = np.array([rng.choice(information.shape[1], 3, replace=False) for _ in rows])
        chosen = information[rows[:, None], picks].reshape(15, 6, 6)
        random.append(of_matrices(chosen, np.repeat(q2[rows], 3), result.tests, VARIANCE))
    random = np.sqrt(random)
    own = np.sqrt(own)
    with capsys.disabled():
        print(f"\n{len(random)} random plans: best {random.min() / own:.2f} ×, median {np.median(random) / own:.2f} × ")
    assert own < random.min()
    assert np.median(random) / own > 1.6


def random_poses(place, rng):
    """Levels (L,) and matrices AᵀA (L, 12, 6, 6) of random poses that can be measured under random loads."""
    q2, found = [], []
    while len(q2) < 16:
        level = rng.uniform(place.lower[1], place.upper[1])
        q, tilt = search.draw_poses(place, 120, rng, q2=level)
        good = np.flatnonzero(constraints.are_feasible(place, q, tilt))[:12]
        if len(good) == 12:
            q2.append(level)
            found.append(setting.normal_matrices(q[good], place.rig.force * search_direction(tilt[good])))
    return np.array(q2), np.array(found)


def search_direction(tilt):
    angle = np.linalg.norm(tilt, axis=1)
    flat = tilt / np.maximum(angle, 1e-12)[:, None] * np.sin(angle)[:, None]
    return np.column_stack([flat, -np.cos(angle)])


def test_the_same_seed_gives_the_same_plan_and_another_seed_another(tmp_path):
    short = {"configurations": 6, "levels": 2, "starts": 1, "rounds": 2}
    one, same, other = (setting.quick(tmp_path, seed=seed, **short) for seed in (3, 3, 4))
    assert (one.plan.q == same.plan.q).all()
    assert (one.force == same.force).all()
    assert not np.array_equal(one.plan.q, other.plan.q)


def test_every_pose_of_a_plan_can_be_measured_and_stands_on_its_level(tmp_path):
    result = setting.quick(tmp_path)
    assert constraints.are_feasible(result.site, result.plan.q, result.plan.tilt).all()
    assert len(np.unique(result.plan.q[:, 1])) == 4
    assert np.diff(np.sort(np.unique(result.plan.q[:, 1]))).min() > np.radians(2)
    assert (np.bincount(result.plan.level) == 2).all()
    assert np.abs(np.linalg.norm(result.force, axis=1) - 275 * 9.81).max() < 0.2


def test_an_interrupt_gives_the_best_plan_so_far(tmp_path):
    class Stop:
        def __init__(self):
            self.values = []

        def __call__(self, stage, share, best):
            if stage == "searching":
                self.values.append(best)
                if len(self.values) == 4:
                    raise KeyboardInterrupt

    stop = Stop()
    options = Options(configurations=8, levels=4, starts=3, test_poses=8, rounds=6)
    result = plan_measurements(setting.site(tmp_path), setting.job(), options, progress=stop)
    assert result.interrupted
    assert np.sqrt(result.plan.value) == pytest.approx(min(stop.values), rel=1e-3)
    assert len(result.random) == 0


def test_the_search_never_gets_worse_and_ends_better_than_it_began(tmp_path):
    values = []

    def note(stage, share, best):
        if stage == "searching":
            values.append(best)

    options = Options(configurations=10, levels=5, starts=3, test_poses=4, rounds=4, comparisons=False)
    plan_measurements(setting.site(tmp_path), setting.job(), options, progress=note)
    assert (np.diff(values) <= 0).all()
    assert values[-1] < 0.97 * values[2]


def test_the_share_done_rises_from_nothing_to_the_whole(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(planning, "random_values", lambda *_: np.ones(1))
    monkeypatch.setattr(planning, "criterion_by_number", lambda *_: ((count, 1.0, 1.0) for count in range(6)))
    options = Options(configurations=6, levels=2, starts=2, test_poses=4, rounds=2)
    plan_measurements(setting.site(tmp_path), setting.job(), options, progress=lambda *each: told.append(each))
    shares = np.array([share for _, share, _ in told])
    assert (np.diff(shares) >= 0.0).all()
    assert (shares[0], shares[-1]) == (0.0, pytest.approx(1.0))
    assert list(dict.fromkeys(stage for stage, _, _ in told)) == [
        "drawing poses that can be measured", "searching", "comparing with other plans",
        "comparing with other numbers of poses",
    ]  # fmt: skip


def test_a_hanging_weight_cannot_show_k1_and_the_plan_says_so_before_anyone_measures(tmp_path):
    result = setting.quick(tmp_path, text=BASIC + "\n[rig]\nmass_kg = 275\n")
    assert JOINT_COMPLIANCES[0] not in result.accuracy.parameters
    assert any("k1 is not observable" in text and "max_angle_deg" in text for text in result.warnings)
    assert (result.force[:, :2] == 0).all()


@pytest.mark.parametrize("mass", [2000, 275, 150, 20])
def test_the_second_load_is_as_near_to_the_work_as_makes_sense(tmp_path, mass):
    site = setting.site(tmp_path, BASIC + f"\n[rig]\nmass_kg = {mass}\n")
    tests = setting.job()
    work = np.sqrt(tests.weight @ np.sum(tests.wrench[:, :3] ** 2, axis=1))
    second = planning.second_load(site, tests) * mass * 9.81
    # between a tenth of the weight, which noise does not hide, and two fifths of it
    assert second == pytest.approx(min(max(work, 0.1 * mass * 9.81), 0.4 * mass * 9.81), rel=1e-3)


def test_a_load_on_the_axis_of_a6_cannot_show_k6(tmp_path):
    text = BASIC.replace("X = 210\nY = -60", "X = 0\nY = 0") + RIG
    result = setting.quick(tmp_path, text=text)
    assert any("k6 is not observable" in text and "bracket" in text for text in result.warnings)


def test_a_load_too_small_to_be_seen_is_refused(tmp_path):
    with pytest.raises(PlanError, match="load is too small"):
        setting.quick(tmp_path, text=BASIC + "\n[rig]\nmass_kg = 0.01\nmax_angle_deg = 30\n")


def test_the_compensator_is_planned_for_only_where_it_can_be_identified(tmp_path, monkeypatch):
    from msgspec.structs import replace

    short = {"starts": 1, "rounds": 1}
    assert not setting.quick(tmp_path, **short).compensator_free
    spring = setting.ROBOT.compensator
    stiff = replace(setting.ROBOT, compensator=replace(spring, stiffness=6e6))
    monkeypatch.setattr(setting, "ROBOT", stiff)
    result = setting.quick(tmp_path, configurations=15, levels=5, **short)
    assert result.compensator_free
    assert CompensatorStiffness() in result.accuracy.parameters
    assert np.ptp(result.plan.q[:, 1]) > np.radians(80)


def test_more_than_can_be_determined_is_refused(tmp_path):
    with pytest.raises(PlanError, match="5 levels of q2 for 4 configurations"):
        setting.quick(tmp_path, configurations=4, levels=5)
    one_point = BASIC[: BASIC.index("[points.P2]")]
    with pytest.raises(PlanError, match=r"2 poses of 1 points on a level are 6 .* for 6|are 3 coordinates for 6"):
        setting.quick(tmp_path, text=one_point + RIG, configurations=4, levels=4, grouped=True)


@pytest.mark.parametrize(
    ("points", "fewest"),
    [(3, 3), (2, 3), (1, 4)],  # two numbers for each of six springs: 12; a configuration has 6, 5 or 3
)
def test_fewer_configurations_than_identify_needs_are_refused(tmp_path, points, fewest):
    text = (BASIC if points == 3 else BASIC[: BASIC.index(f"[points.P{points + 1}]")]) + RIG
    short = {"text": text, "starts": 1, "rounds": 1, "test_poses": 3}
    message = (
        f"{fewest - 1} configurations of {points} points are too few: `identify` would not trust a model from fewer "
        f"than {fewest}. Ask for {fewest} or more with --configurations"
    )
    with pytest.raises(PlanError, match=re.escape(message)):
        setting.quick(tmp_path, configurations=fewest - 1, levels=1, **short)
    assert len(setting.quick(tmp_path, configurations=fewest, levels=1, **short).plan.q) == fewest


def test_configurations_that_were_measured_count_towards_those_that_identify_needs(tmp_path):
    data, _, _ = measured_so_far(tmp_path)
    short = {"starts": 1, "rounds": 1, "test_poses": 3, "configurations": 1, "levels": 1}
    assert len(setting.quick(tmp_path, data=data.take_configurations(np.arange(2)), **short).plan.q) == 1
    message = "2 configurations of 3 points with the 1 that were measured are too few"
    with pytest.raises(PlanError, match=f"{message}.*Ask for 2 or more with --configurations"):
        setting.quick(tmp_path, data=data.take_configurations(np.arange(1)), **short)


@pytest.mark.parametrize(("configurations", "is_refused"), [(5, True), (6, False)])
def test_a_compensator_that_is_identified_needs_configurations_too(configurations, is_refused):
    """Two numbers for each of eight parameters: 16; a configuration of one point has three."""
    arguments = 8, Options(configurations=configurations), 1, None
    if is_refused:
        with pytest.raises(PlanError, match="from fewer than 6"):
            planning._check_identifiable(*arguments)
        return
    planning._check_identifiable(*arguments)


@pytest.mark.parametrize(
    ("options", "points", "keep", "enough"),
    [
        # pooled: k1, k3 … k6 and a k2 for each level
        ({"configurations": 3, "levels": 3}, 1, 6, True),  # 9 coordinates for 5 + 3
        ({"configurations": 3, "levels": 3}, 1, 5, True),
        ({"configurations": 2, "levels": 2}, 1, 6, False),  # 6 for 7
        ({"configurations": 2, "levels": 2}, 1, 5, True),  # 6 for 6
        ({"configurations": 2, "levels": 1}, 1, 6, True),  # 6 for 6
        ({"configurations": 1, "levels": 1}, 2, 6, True),
        ({"configurations": 1, "levels": 1}, 1, 6, False),
        # grouped: six for each level, by the poses that every level has
        ({"configurations": 7, "levels": 4, "grouped": True}, 1, 6, False),  # 1 pose on some level
        ({"configurations": 8, "levels": 4, "grouped": True}, 1, 6, True),
        ({"configurations": 7, "levels": 4, "grouped": True}, 2, 6, True),
        ({"configurations": 4, "levels": 4, "grouped": True}, 1, 3, True),
        ({"configurations": 4, "levels": 4, "grouped": True}, 1, 4, False),
    ],
)
def test_coordinates_that_are_read_are_counted_against_compliances(tmp_path, options, points, keep, enough):
    place = setting.site(tmp_path)
    scale = np.ones(6)
    readings = Readings(place.arm, place.load_point, place.points, 1.0, 1.0, scale, tuple(range(6))[:keep])
    arguments = Options(**options), readings, points, options["levels"]
    if enough:
        planning._check_reading_count(*arguments, None)
        return
    with pytest.raises(PlanError, match=rf"of {points} points .* coordinates for \d+ compliances"):
        planning._check_reading_count(*arguments, None)


@pytest.mark.parametrize(("joint", "advice"), [(0, "by a cable over a pulley"), (2, "heavier"), (5, "on a bracket")])
def test_the_share_of_the_deflection_that_a_hidden_compliance_makes_is_stated(tmp_path, joint, advice):
    """By the positions of an independent arm, differences, and the robot's own compliance."""
    tests = replace(setting.job(4).take(np.array([0, 70, 200])), weight=np.array([0.5, 0.2, 0.3]))
    site = setting.site(tmp_path, BASIC + "\n[rig]\nmass_kg = 275\n")
    (text,) = planning.hidden_compliance_warnings(site, tests, setting.ROBOT.compliance, (joint,))
    own = setting.milling_regressors(tests)[:, :, joint] * setting.ROBOT.compliance[joint]
    share = np.sqrt(np.sum(tests.weight[:, None] * own**2)) * 1e3
    assert text.startswith(f"k{joint + 1} is not observable with this rig: ")
    assert advice in text
    assert float(re.search(r"; (\S+) mm \(RMS\)", text)[1]) == pytest.approx(share, rel=0.006, abs=1e-9)


def measured_so_far(folder, count=6):
    q, f = simulator.plan(np.random.default_rng(5), count=count, levels=(-40, -100))
    robot = simulator.paper_like(np.random.default_rng(6), stiff_compensator=False)
    _, raw = simulator.measure(robot, q, f, np.random.default_rng(7))
    simulator.write(folder, q, f, raw)
    setup = read_experiment(setting.experiment(folder))
    return read(folder / "measurements.csv", setup), q, f


def test_with_measurements_the_plan_says_what_to_measure_next(tmp_path):
    data, q, force = measured_so_far(tmp_path)
    result = setting.quick(tmp_path, data=data, configurations=3, levels=3, test_poses=3)
    assert result.accuracy.rms < result.initial_accuracy.rms
    levels = np.degrees(np.unique(result.plan.q2))
    assert {-100.0, -40.0} <= set(levels.round(3))
    assert len(levels) == 3
    together = setting.pooled(np.vstack([q, result.plan.q]), np.vstack([force, result.force]), result.tests, VARIANCE)
    assert together == pytest.approx(result.plan.value, rel=1e-3)


def test_next_poses_help_more_than_the_same_number_planned_without_the_measurements(tmp_path):
    data, q, force = measured_so_far(tmp_path)
    options = {"configurations": 3, "levels": 2, "test_poses": 3}
    next_ones = setting.quick(tmp_path, data=data, **options)
    rng = np.random.default_rng(1)
    place = setting.site(tmp_path)
    random = []
    for _ in range(30):
        drawn = search.draw_poses(place, 3, rng)
        drawn[0][:, 1] = np.radians(rng.choice([-40.0, -100.0], 3))
        both = np.vstack([force, place.rig.force * search_direction(drawn[1])])
        random.append(setting.pooled(np.vstack([q, drawn[0]]), both, next_ones.tests, VARIANCE))
    assert next_ones.plan.value < min(random)


def test_every_exchange_has_the_value_of_its_plan_and_improves_it(tmp_path):
    """Of the poses, then of each level: the value that is kept up to date is the criterion of the whole plan."""
    site, tests = setting.site(tmp_path), replace(setting.job().take(np.array([0, 150])), weight=np.array([0.5, 0.5]))
    options = Options(configurations=7, levels=3)
    task = planning._planning_problem(site, tests, setting.ROBOT.compliance, options, None).task
    rng = np.random.default_rng(2)
    row, level = search.first_levels(task, rng, spread=False), task.pose_levels(rng)
    pick = rng.integers(0, task.candidates.q.shape[1], task.count)

    def value(row, level, pick):
        q, tilt = (each[row[level], pick] for each in (task.candidates.q, task.candidates.tilt))
        return setting.pooled(q, site.rig.force * search_direction(tilt), tests, VARIANCE)

    criterion = task.criterion_at(task.candidates.q2[row])
    choice = search._Choice(row, level, pick, criterion, value(row, level, pick))
    improved = []
    steps = [lambda one, group=group: search._exchange_level(task, one, group) for group in range(3)]
    for step in (*steps, lambda one: search._exchange_poses(task, one)):
        found = step(choice)
        assert found.value == pytest.approx(value(found.row, found.level, found.pick), rel=1e-3)
        assert found.value <= choice.value
        improved.append(found.value < 0.99 * choice.value)
        choice = found
    assert choice.value < 0.5 * value(row, level, pick)
    assert sum(improved[:3]) >= 2  # a level that moves brings its poses along


def test_exchange_keeps_levels_apart(tmp_path):
    result = setting.quick(tmp_path, configurations=12, levels=6, starts=1, rounds=3)
    assert np.diff(np.sort(result.plan.q2)).min() >= search._LEAST_DISTANCE - 1e-4


@pytest.mark.parametrize(
    ("mass_kg", "limits", "is_asked"),
    [(323, "", False), (325, "", True), (900, "max_torque_Nm = [9e3, 9e3, 9e3, 9e3, 9e3, 9e3]\n", False)],
)
def test_a_load_beyond_the_rating_is_asked_about_unless_torques_are_checked(mass_kg, limits, is_asked, tmp_path):
    rig = RIG.replace("mass_kg = 275", f"mass_kg = {mass_kg}")
    warnings = planning.unchecked_warnings(setting.site(tmp_path, BASIC + rig + limits))
    assert any("more than the 270 kg (2649 N) that the robot is rated for" in text for text in warnings) == is_asked


def test_the_payload_counts_towards_the_rating(tmp_path):
    rig = RIG.replace("mass_kg = 275", "mass_kg = 250")
    assert not any("rated" in text for text in planning.unchecked_warnings(setting.site(tmp_path, BASIC + rig)))
    (warning,) = (
        text
        for text in planning.unchecked_warnings(setting.site(tmp_path, BASIC + rig + "[payload]\nmass_kg = 80\n"))
        if "rated" in text
    )
    assert warning.startswith("load and [payload] of 3237 N together are more than the 270 kg")


def test_earlier_readings_inform_the_compliances_that_the_rig_can_show(tmp_path):
    """A weight that hangs shows nothing of A1: neither does the plan count it in the readings that are there."""
    data, *_ = measured_so_far(tmp_path)
    hanging = setting.site(tmp_path, BASIC + "\n[rig]\nmass_kg = 275\n")
    vertical = replace(data, wrench=data.wrench * [0.0, 0, 1, 0, 0, 0])
    options = Options(configurations=4, levels=3)
    problem = planning._planning_problem(hanging, setting.job(), setting.ROBOT.compliance, options, vertical)
    assert problem.readings.identified_joints == (1, 2, 3, 4, 5)
    assert problem.earlier_data.information.shape[1:] == (5, 5)
    assert (np.diagonal(problem.earlier_data.information, axis1=1, axis2=2).sum(axis=0) > 0.0).all()
    assert problem.task.candidates.information.shape[2:] == (5, 5)
    assert problem.task.fixed_count == 2
    whole = planning._planning_problem(setting.site(tmp_path), setting.job(), setting.ROBOT.compliance, options, data)
    assert whole.earlier_data.information.shape[1:] == (6, 6)
