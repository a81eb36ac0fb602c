"""Parts of identification reading by reading: gross errors, swapped names, loops, steps of the device, levels."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy import stats
from scipy.spatial.transform import Rotation

from postproc.errors import MeasurementError
from postproc.frames import pose_from_xyzabc
from postproc.identification import moved_device, plausibility, validation
from postproc.identification.measurement_model import Placement
from postproc.identification.readings import Measurements, _check_sets
from postproc.identification.validation import ValidatedLevel, _Displacements
from tests.collision.setting import frame
from tests.kr270 import ROBOT

POINTS = np.array([[0.1, 0.0, 0.2], [-0.12, 0.05, 0.25], [0.02, -0.15, 0.3]])
SIGMA = 1e-5


def readings(rng, configs=6, loads=2, repeats=4, points=3):
    """Readings of points of a rigid body in random poses, with noise; the lines of a file in their order."""
    states = [(c, load) for c in range(configs) for load in range(loads + 1)]
    poses = Rotation.random(len(states), random_state=int(rng.integers(1000))).as_matrix()
    rows = [(s, r, p) for s in range(len(states)) for r in range(repeats) for p in range(points)]
    state, repeat, point = np.array(rows).T
    position = np.einsum("nij,nj->ni", poses[state], POINTS[point]) + rng.normal(0.0, SIGMA, (len(rows), 3))
    number = np.array([load for _, load in states])
    wrench = np.zeros((len(states), 6))
    wrench[:, 2] = -500.0 * number
    return Measurements(
        file="measurements.csv", config=10.0 + np.arange(configs), q=rng.uniform(-1.0, 1.0, (configs, 6)),
        state_config=np.array([c for c, _ in states]), load=number, wrench=wrench, points=("P1", "P2", "P3")[:points],
        guess=POINTS[:points], load_point=np.zeros(3), sigma=SIGMA, state=state, point=point, repeat=repeat + 1.0,
        position=position, line=np.arange(2, len(rows) + 2), used=np.ones(len(rows), dtype=bool),
    )  # fmt: skip


def moved(data, row, vector):
    position = data.position.copy()
    position[row] += vector
    return replace(data, position=position)


@pytest.mark.parametrize("seed", range(10))
def test_readings_far_from_the_median_of_their_repeats_are_left_out(seed):
    """By nine standard deviations; fewer than half of the repeats, of three at least."""
    rng = np.random.default_rng(seed)
    data = readings(rng, points=2, repeats=int(rng.integers(2, 6)))
    for row in rng.choice(len(data.state), 5, replace=False):
        data = moved(
            data, row, 1e-4 * rng.choice([0.4, 1.5, 3.0]) * Rotation.random(random_state=int(row)).as_matrix()[0]
        )
    sigma = max(data.sigma, robust_sigma(data))
    expected, far = set(), {}
    for state in range(len(data.load)):
        for point in range(2):
            rows = np.flatnonzero((data.state == state) & (data.point == point))
            distance = {
                int(row): np.linalg.norm(data.position[row] - np.median(data.position[rows], axis=0)) for row in rows
            }
            wrong = [row for row in distance if distance[row] > 9.0 * sigma]
            if len(rows) >= 3 and 0 < len(wrong) < 0.5 * len(rows):
                expected |= set(wrong)
                far |= {row: distance[row] for row in wrong}
    found, lines = plausibility.remove_gross_errors(data)
    assert set(np.flatnonzero(~found.used).tolist()) == expected
    assert len(lines) == len(expected)
    for row in expected:
        assert f"{data.name(row)} is {1e3 * far[row]:.2f} mm from its repeats: left out" in lines


def robust_sigma(data):
    """Noise of a coordinate from the median of the distances to the means of the repeats."""
    left, counts = [], []
    for state in range(len(data.load)):
        for point in range(len(data.points)):
            rows = np.flatnonzero((data.state == state) & (data.point == point) & data.used)
            if len(rows) >= 2:
                left.append(data.position[rows] - data.position[rows].mean(axis=0))
                counts.append(len(rows))
    if not left:
        return 0.0
    return float(
        np.median(np.abs(np.concatenate(left))) / stats.norm.ppf(0.75) / np.sqrt(1.0 - 1.0 / np.median(counts))
    )


@pytest.mark.parametrize("repeats", [1, 2, 5])
def test_the_noise_of_repeats_is_that_of_their_median_deviation(repeats):
    data = readings(np.random.default_rng(3), repeats=repeats)
    assert plausibility._robust_sigma(data) == pytest.approx(robust_sigma(data), rel=1e-4)
    assert repeats == 1 or robust_sigma(data) == pytest.approx(SIGMA, rel=0.15)


@pytest.mark.parametrize("seed", range(10))
def test_a_reading_at_wrong_distances_to_the_other_points_is_left_out_if_these_agree(seed):
    rng = np.random.default_rng(seed)
    data = readings(rng, repeats=2)
    for row in rng.choice(len(data.state), 4, replace=False):
        data = moved(
            data, row, rng.choice([3e-5, 8e-5, 2e-4, 1e-3]) * Rotation.random(random_state=int(row)).as_matrix()[0]
        )
    data = replace(data, used=rng.random(len(data.state)) < 0.97)
    sets = {}
    for n in range(len(data.state)):
        if data.used[n]:
            sets.setdefault((int(data.state[n]), data.repeat[n]), {})[int(data.point[n])] = n
    whole = [rows for rows in sets.values() if len(rows) == 3]
    pairs = [(0, 1), (0, 2), (1, 2)]
    distances = [[np.linalg.norm(data.position[rows[a]] - data.position[rows[b]]) for a, b in pairs] for rows in whole]
    errors = np.abs(np.array(distances) - np.median(distances, axis=0))
    sigma, limit = data.sigma, 6.0 * np.sqrt(2.0) * data.sigma
    expected = {}
    for rows, (first, second, third) in zip(whole, errors, strict=True):
        of_point = {0: (first, second, third), 1: (first, third, second), 2: (second, third, first)}
        worst = max(of_point, key=lambda point: sum(of_point[point][:2]))
        own, other = of_point[worst][:2], of_point[worst][2]
        if max(own) > limit and other <= limit:
            expected[rows[worst]] = max(own)
    bad, lines = plausibility._readings_off_body(data, sigma)
    assert set(bad) == set(expected)
    assert all(
        f"{data.name(row)} is {1e3 * off:.2f} mm off in its distance" in " ".join(lines)
        for row, off in expected.items()
    )


@pytest.mark.parametrize("order", [(1, 0, 2), (2, 1, 0), (1, 2, 0)])
def test_points_whose_names_are_swapped_in_a_set_are_named_with_its_line(order):
    data = readings(np.random.default_rng(1), repeats=2)
    plausibility.check_points(data)
    rows = np.flatnonzero((data.state == 4) & (data.repeat == 2.0))
    position = data.position.copy()
    position[rows] = data.position[rows][list(order)]
    with pytest.raises(MeasurementError) as refused:
        plausibility.check_points(replace(data, position=position))
    names = [f"P{k + 1}" for k in range(3) if order[k] != k]
    assert f"fit only if the names {' and '.join(names)} are swapped" in str(refused.value)
    assert refused.value.line == data.line[rows[0]]
    plausibility.check_points(moved(data, rows[0], np.array([0.03, 0.0, 0.0])))  # a wrong reading is no swapped name


@pytest.mark.parametrize("seed", range(20))
def test_the_same_load_before_and_after_a_larger_one_is_a_pair(seed):
    rng = np.random.default_rng(seed)
    count = 14
    config = np.sort(rng.integers(0, 3, count))
    wrench = np.zeros((count, 6))
    wrench[:, 2] = -rng.choice([100.0, 101.0, 103.0, 119.0, 122.0, 250.0], count)
    number = np.concatenate([np.arange(np.count_nonzero(config == c)) for c in range(3)])
    data = SimpleNamespace(wrench=wrench, loaded_states=np.flatnonzero(number > 0), state_config=config, load=number)
    rows = data.loaded_states
    expected = set()
    for a, first in enumerate(rows):
        for b, second in enumerate(rows):
            size = abs(wrench[first, 2])
            between = [
                k for k in rows if config[k] == config[first] and number[first] < number[k] < number[second]
                and abs(wrench[k, 2]) > 1.2 * size
            ]  # fmt: skip
            is_same = config[first] == config[second] and abs(wrench[first, 2] - wrench[second, 2]) < 0.02 * size
            if is_same and number[first] < number[second] and between:
                expected.add((a, b))
    up, down = plausibility.load_loops(data)
    assert set(zip(up.tolist(), down.tolist(), strict=True)) == expected


def placed(rng, configs=5):
    """Configurations, points and the place of the root in the device."""
    q = rng.uniform(0.4 * ROBOT.lower, 0.4 * ROBOT.upper, (configs, 6))
    root = pose_from_xyzabc([1200.0, -300.0, 500.0, 35.0, -20.0, 70.0])
    placement = Placement(
        root_in_device=root, points=POINTS[:2], covariance=np.eye(12), residual=np.zeros((configs, 2, 3))
    )
    return SimpleNamespace(q=q), placement


def read_points(q, placement, change=None, offset=None):
    """Readings (C, P, 3) of the points by Pinocchio, with a small motion of one frame or of the points."""
    result = np.zeros((len(q), 2, 3))
    for n, angles in enumerate(q):
        for index, point in enumerate(placement.points):
            place = np.append(point + (0.0 if offset is None else offset[index]), 1.0)
            before = np.eye(4) if change is None else change[0](angles)
            motion = np.eye(4) if change is None else before @ change[1] @ np.linalg.inv(before)
            result[n, index] = (placement.root_in_device @ motion @ frame(angles, 6) @ place)[:3]
    return result


def twist(vector):
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec(vector[3:]).as_matrix(), vector[:3]
    return motion


def test_derivatives_by_twists_of_root_and_joint_frames_are_differences_of_another_arm():
    """A joint frame is that of the link before it, turned as at joint angle 0: it does not turn with the joint."""
    rng = np.random.default_rng(2)
    data, placement = placed(rng)
    slopes = moved_device._frame_derivatives(ROBOT, data, placement)
    assert slopes.shape == (5, 2, 3, 42)
    for number in range(7):

        def at(angles, number=number):
            if number == 0:
                return np.eye(4)
            turned = frame(angles, number - 1)
            back = np.eye(4)
            back[:3, :3] = Rotation.from_rotvec(-angles[number - 1] * ROBOT.nominal.axis[number - 1]).as_matrix()
            return turned @ back

        for axis in range(6):
            step = np.zeros(6)
            step[axis] = 1e-6
            ahead, behind = (read_points(data.q, placement, (at, twist(sign * step))) for sign in (1.0, -1.0))
            np.testing.assert_allclose(slopes[..., 6 * number + axis], (ahead - behind) / 2e-6, atol=1e-6)


def test_derivatives_by_points_are_differences_of_another_arm():
    data, placement = placed(np.random.default_rng(3))
    slopes = moved_device.unloaded_design(ROBOT, data, placement)[..., 6:]
    for column in range(6):
        offset = np.zeros((2, 3))
        offset.flat[column] = 1e-3
        change = (read_points(data.q, placement, offset=offset) - read_points(data.q, placement)) / 1e-3
        np.testing.assert_allclose(slopes[..., column], change, atol=1e-9)


def test_derivatives_by_the_sag_of_joints_are_their_angles_times_the_weight_on_them():
    """The weight's torque by differences of the potential energy is that of the model; a joint turns all behind it."""
    data, placement = placed(np.random.default_rng(4))
    slopes = moved_device._sag_derivatives(ROBOT, data, placement)
    torque = moved_device.elastostatics.balance.static_torque(ROBOT, data.q.T).T
    for joint in range(6):
        step = np.zeros(6)
        step[joint] = 1e-6
        change = (read_points(data.q + step, placement) - read_points(data.q - step, placement)) / 2e-6
        np.testing.assert_allclose(slopes[..., joint], change * torque[:, joint, None, None], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_the_clearest_step_is_that_of_the_f_test_over_all_configurations(seed):
    """By least squares with and without it, a configuration counted as one point."""
    rng = np.random.default_rng(seed)
    configs, points = 16, 2
    rows = rng.normal(size=(configs, points, 3, 14))
    rows[..., 13] = rows[..., 12]  # a direction that the readings do not determine
    first = int(rng.integers(3, 13))
    residual = rng.normal(0.0, 1e-5, (configs, points, 3))
    jump = rng.normal(0.0, 2e-5 * (seed % 3), 6)
    residual[first:] += rows[first:, ..., :6] @ jump
    q = rng.normal(size=(configs, 6))
    design, target = rows.reshape(-1, 14), residual.ravel()

    def squares(columns):
        return float(np.sum((target - columns @ np.linalg.lstsq(columns, target, rcond=1e-9)[0]) ** 2))

    without, rank, free = squares(design), 13, np.full(rows.shape[3], np.inf)
    spare = 3 * configs - rank - 6
    best = (np.inf, 0)
    for row in range(2, configs - 1):
        order = [np.corrcoef(np.arange(configs) >= row, angles)[0, 1] for angles in q.T]
        assert moved_device._is_correlated_with_step(q, row) == (max(map(abs, order)) > 0.5)
        if max(map(abs, order)) > 0.5:
            continue
        step = (rows[..., :6] * (np.arange(configs) >= row)[:, None, None, None]).reshape(-1, 6)
        with_step = squares(np.hstack([design, step]))
        chance = stats.f.sf((without - with_step) / 6.0 * spare / with_step, 6, spare)
        best = min(best, (chance, row))
    chance, row, found = moved_device._clearest_step(rows, free, residual, q)
    assert (chance, row) == (pytest.approx(best[0], rel=1e-6), best[1])
    step = (rows[..., :6] * (np.arange(configs) >= row)[:, None, None, None]).reshape(-1, 6)
    values = np.linalg.lstsq(np.hstack([design[:, :13], step]), target, rcond=None)[0]
    np.testing.assert_allclose(found, values[13:], atol=1e-9)
    few = 7 if seed % 2 else 8
    assert moved_device._clearest_step(rows[:few], free, residual[:few], q[:few])[0] == np.inf


def compared(rng, states=20, points=3):
    load = np.where(np.arange(states) % 2 == 0, 500.0, 2000.0) * rng.uniform(0.98, 1.02, states)
    left, bound = np.abs(rng.normal(0.0, 1e-4, (states, points))), rng.uniform(5e-5, 3e-4, (states, points))
    noise = rng.uniform(1e-11, 1e-10, (states, points))
    return _Displacements(
        is_compared=rng.random((states, points)) < 0.8, config=np.sort(rng.integers(0, 8, states)), load=load,
        displacement=np.abs(rng.normal(0.0, 1e-3, (states, points))), prediction_error=left, bound=bound, noise=noise,
        error_ratio=left / np.sqrt(bound**2 + 2.7954835**2 * noise), has_bound=True,
    )  # fmt: skip


def clopper_pearson(inside, total, doubt):
    """Limits of a share from counts by configuration, with as many displacements as their scatter implies."""
    configs, count = len(total), sum(total)
    share = sum(inside) / count
    if configs < 2:
        return 0.0, 1.0
    scatter = configs / (configs - 1) * sum((i - share * n) ** 2 for i, n in zip(inside, total, strict=True)) / count**2
    number = float(configs)
    if scatter > 0.0:
        ratio = stats.t.ppf(doubt, count - 1) / stats.t.ppf(doubt, configs - 1)
        number = min(count, ratio**2 * share * (1 - share) / scatter)
    good = share * number
    low = stats.beta.ppf(doubt, good, number - good + 1) if good > 0.0 else 0.0
    high = stats.beta.ppf(1 - doubt, good + 1, number - good) if good < number else 1.0
    return low, high


@pytest.mark.parametrize("has_bound", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_levels_of_loads_have_the_means_shares_and_limits_of_their_displacements(seed, has_bound):
    rng = np.random.default_rng(seed)
    comparison = replace(compared(rng), has_bound=has_bound)
    found = validation._validated_levels(comparison)
    assert len(found) == 2
    for level, size in zip(found, (500.0, 2000.0), strict=True):
        states = [
            n for n in range(20) if abs(comparison.load[n] / size - 1.0) < 0.1 and comparison.is_compared[n].any()
        ]
        cells = [(n, p) for n in states for p in range(3) if comparison.is_compared[n, p]]

        def rms(values, cells=cells):
            return np.sqrt(np.mean([values[cell] ** 2 for cell in cells]))

        assert level.load == np.median([comparison.load[n] for n in states])
        assert (level.measured, level.prediction_error) == pytest.approx(
            (rms(comparison.displacement), rms(comparison.prediction_error))
        )
        assert (level.noise, level.bound) == pytest.approx((rms(np.sqrt(comparison.noise)), rms(comparison.bound)))
        means = [
            np.mean([comparison.prediction_error[n, p] ** 2 for p in range(3) if comparison.is_compared[n, p]])
            for n in states
        ]
        assert level.standard_error == pytest.approx(stats.sem(means))
        assert level.configurations == len({comparison.config[n] for n in states})
        if not has_bound:
            assert (level.limits, np.isnan(level.inside), np.isnan(level.error_ratio)) == ((0.0, 1.0), True, True)
            continue
        ratios = [comparison.error_ratio[cell] for cell in cells]
        assert level.inside == np.mean([ratio <= 1.0 for ratio in ratios])
        assert level.error_ratio == pytest.approx(np.quantile(ratios, 0.95))
        configs = sorted({comparison.config[n] for n, _ in cells})
        counts = [
            [
                sum(comparison.config[n] == c and (not only or comparison.error_ratio[n, p] <= 1.0) for n, p in cells)
                for c in configs
            ]
            for only in (True, False)
        ]
        low, high = clopper_pearson(*counts, 0.05)[0], clopper_pearson(*counts, 0.025)[1]
        assert level.limits == pytest.approx((low, high), abs=1e-9)


@pytest.mark.parametrize(
    ("inside", "limits", "refuted", "held"),
    [
        (0.97, (0.6, 1.0), False, True), (0.9, (0.5, 0.95), False, True), (0.89, (0.6, 1.0), False, False),
        (0.97, (0.49, 1.0), False, False), (0.97, (0.6, 0.949), True, False), (0.97, (0.6, 0.951), False, True),
    ],
)  # fmt: skip
def test_a_level_holds_with_enough_displacements_inside_and_is_refuted_by_its_upper_limit(
    inside, limits, refuted, held
):
    level = ValidatedLevel(500.0, 1e-3, 3e-4, 1e-4, 1e-8, inside, limits, 1.0, 1e-4, 6)
    assert (level.is_refuted, level.keeps_bound) == (refuted, held)


@pytest.mark.parametrize(("left", "above"), [(3e-4, True), (1.5e-4, False), (0.9e-4, False)])
def test_the_factor_of_a_level_is_without_noise_or_a_lower_limit(left, above):
    """Where the residual exceeds the noise by two standard errors; else with these in its place."""
    level = ValidatedLevel(500.0, 1e-3, left, 1e-4, 1e-8, 1.0, (0.6, 1.0), 1.0, 1e-4, 6)
    assert level.exceeds_noise == above
    rest = left**2 - 1e-8 if above else max(left**2 - 1e-8, 0.0) + 2e-8
    assert level.factor == pytest.approx(1e-3 / np.sqrt(rest))
    assert replace(level, prediction_error=1e-4, standard_error=0.0).factor == np.inf


@pytest.mark.parametrize("seed", range(8))
def test_states_of_configuration_and_load_that_a_model_knows_are_those_within_their_digits(seed):
    """A pose to 1e-4 rad, a load to a hundredth of it."""
    rng = np.random.default_rng(seed)
    count = 10
    q, wrench = rng.uniform(-1.0, 1.0, (count, 6)), rng.normal(0.0, 500.0, (count, 6))
    data = SimpleNamespace(q=q, state_config=np.arange(count), loaded_states=np.arange(count), wrench=wrench)
    states, expected = [], np.zeros(count, dtype=bool)
    for n in range(count):
        turn, share = rng.choice([0.9e-4, 1.1e-4]), rng.choice([0.009, 0.011])
        if rng.random() < 0.7:
            direction = rng.normal(size=6)
            change = share * np.linalg.norm(wrench[n]) * direction / np.linalg.norm(direction)
            states.append([*(q[n] + turn * np.eye(6)[rng.integers(6)]), *(wrench[n] + change)])
            expected[n] = turn < 1e-4 and share < 0.01
    assert validation._is_known_state(data, np.array(states).reshape(-1, 12)).tolist() == expected.tolist()


def test_a_gross_reading_names_its_line_configuration_load_and_point():
    data = readings(np.random.default_rng(1))
    row = 50
    words = data.name(row)
    config, load = data.config[data.state_config[data.state[row]]], data.load[data.state[row]]
    numbers = [float(value) for value in re.findall(r"[\d.]+", words)]
    assert {float(data.line[row]), float(config), float(load)} <= set(numbers)
    assert data.points[data.point[row]] in words


def test_a_load_without_a_point_that_was_read_without_it_is_refused_with_its_line():
    """One common point is enough; a configuration that has no reading without load is another error's."""
    data = readings(np.random.default_rng(1))
    _check_sets(data, data.file)
    first = np.flatnonzero((data.state_config == 2) & (data.load == 0))[0]
    loaded = np.flatnonzero((data.state_config == 2) & (data.load == 1))[0]
    for kept, is_refused in (((0,), False), ((1,), True), ((), True)):
        removed = (data.state == first) & ~np.isin(data.point, kept)
        removed |= (data.state == loaded) & (data.point != 0)
        other = replace(data, used=~removed)
        if not is_refused:
            _check_sets(other, data.file)
            continue
        with pytest.raises(MeasurementError, match=r"config 12, load [12]: no point has readings with and") as refused:
            _check_sets(other, data.file)
        assert data.state_config[data.state[refused.value.line - 2]] == 2
    without_rest = replace(data, load=np.where(data.state_config == 2, 1, data.load))
    _check_sets(without_rest, data.file)
    with pytest.raises(MeasurementError, match="no reading of point P4"):
        _check_sets(replace(data, points=(*data.points, "P4")), data.file)
