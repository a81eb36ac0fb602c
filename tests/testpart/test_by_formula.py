"""Covariances, solutions and tests of a part for readings made by hand, against sums over single causes and refits."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.elastostatics import LENGTH_95
from postproc.errors import MeasurementError
from postproc.identification.uncertainty import unmodelled_error
from postproc.robot import Discrepancy
from postproc.testpart import fit as fitting
from postproc.testpart import linear
from postproc.testpart.cut import Surfaces
from postproc.testpart.fit import Fit
from postproc.testpart.linear import LinearPrediction
from postproc.testpart.probing import ProbedSurfaces, TouchOff
from postproc.testpart.readings import Lift, Readings, Top

SIGMA = 5e-6
NAMES = ("F01.left", "F01.right", "F01.floor", "F02.left", "F02.floor", "F03.left", "F03.floor", "W01.gauge")
BASES = np.array([-1, -1, -1, -1, -1, 2, 2, -1])
MASS = np.array([0.0, 0, 0, 0, 0, 0, 0, 120.0])
WALL = np.array([1, 1, 0, 1, 0, 1, 0, 0], dtype=bool)
COUNT = len(NAMES)


def readings(seed=1):
    """Eight readings of three features in two placements; the last one is that of a gauge."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(COUNT, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    point = rng.uniform(0.0, 0.2, (COUNT, 3)) * (1, 1, -0.02)
    number = np.arange(COUNT)
    touch = np.array([[0.01, 0.01, 0], [0.19, 0.02, 0], [0.1, 0.18, 0], [0.02, 0.15, 0]])
    names = tuple(f"T{k:02d}.top" for k in range(1, 9))
    lifted = 1e-5 * rng.normal(size=8)
    touch_off = TouchOff(names, np.concatenate([touch, touch[::-1] + 0.01]), lifted, np.repeat([-1, 2], 4))
    probed = ProbedSurfaces(
        NAMES, number + 10, 0.5 * np.ones(COUNT), point, normal, 1e-4 * rng.normal(size=COUNT), MASS, ("",) * COUNT,
        BASES, number + 2, "probed.csv", touch_off,
    )  # fmt: skip
    none = np.zeros((COUNT, 6))
    where = Surfaces(number, 0.5 * np.ones(COUNT), np.zeros((COUNT, 2, 6)), WALL, none, point)
    return Readings.of(probed, where, SIGMA)


READINGS = readings()


def prediction(seed=2, size=3):
    rng = np.random.default_rng(seed)
    return LinearPrediction(
        1e-4 * rng.normal(size=COUNT), 1e-4 * rng.normal(size=(COUNT, size)), 0.1 * rng.normal(size=COUNT),
        np.array([3e-4, 2e-4, 0.76e-4, 0.74e-4, 1e-5, 1e-4, 3e-4, 0.5e-4]),
    )  # fmt: skip


def causes(by_lift, read=READINGS):
    """Readings (c, n) [m] by each independent cause at its standard deviation: part, radius, path, top."""
    probed = read.probed
    is_cut = probed.mass == 0.0
    rows = []
    for base in (-1, 2):
        here = probed.base == base
        middle = probed.point[here].mean(axis=0)
        for axis in np.eye(3):
            for motion in (
                0.01 * np.tile(axis, (COUNT, 1)),
                0.1 * np.cross(np.tile(axis, (COUNT, 1)), probed.point - middle),
            ):
                seen = np.einsum("ni,ni->n", probed.normal, motion) + by_lift * motion[:, 2]
                rows.append(np.where(here & is_cut, seen, 0.0))
    rows.append(5e-5 * WALL)
    for feature in ("F01", "F02", "F03", "W01"):
        own = np.array([name.startswith(feature) for name in probed.name])
        for axis in np.eye(3):
            rows.append(1e-4 * np.where(own & is_cut, probed.normal @ axis + by_lift * axis[2], 0.0))
        rows.append(2e-5 * np.where(own, by_lift, 0.0))
    for top in read.tops:
        lower = np.linalg.cholesky(top.covariance)
        terms = np.column_stack([np.ones(COUNT), (probed.point - top.origin)[:, :2]])
        rows += [np.where(probed.base == top.base, by_lift * (terms @ column), 0.0) for column in lower.T]
    return np.array(rows)


def test_the_part_adds_the_covariance_of_all_its_causes():
    """Its position in each placement, the radius of the tool, path and top of each feature, and the touch-off."""
    assert [top.base for top in READINGS.tops] == [-1, 2]
    by_lift = prediction().by_lift
    single = causes(by_lift)
    np.testing.assert_allclose(READINGS.part_covariance(by_lift), single.T @ single, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("gamma", [0.0, 0.02])
def test_noise_has_the_probe_an_unmodelled_share_and_what_is_not_known_of_light_passes(gamma):
    """Passes that displace the tool by less than a quarter of the largest displacement; not the gauge."""
    local = prediction()
    light = np.array([0, 0, 0, 1, 1, 0, 0, 0])  # 0.74e-4 and less of 3e-4; the gauge reads 0.5e-4
    own = np.sqrt(SIGMA**2 + (gamma * local.displacement) ** 2 + light * (0.15 * local.displacement) ** 2)
    single = np.concatenate([causes(local.by_lift), np.diag(own)])
    np.testing.assert_allclose(
        linear.noise_covariance(READINGS, local, gamma), single.T @ single, rtol=1e-9, atol=1e-18
    )


def test_errors_of_points_are_those_of_a_prediction_from_all_others():
    """Each left out in turn, by conditioning on the rest."""
    local = prediction()
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3))
    whole, z, scale = root @ root.T, rng.normal(size=2), 1.3
    error, variance = linear.cross_validation_errors(READINGS, local, 0.01, whole, z=z, scale=scale)
    covariance = local.slopes @ whole @ local.slopes.T + linear.noise_covariance(READINGS, local, 0.01)
    offset = READINGS.probed.deviation - local.value + local.slopes @ [*z, 0.3]
    for k in range(COUNT):
        others = np.arange(COUNT) != k
        gain = np.linalg.solve(covariance[np.ix_(others, others)], covariance[others, k])
        assert error[k] == pytest.approx(offset[k] - gain @ offset[others], rel=1e-6)
        assert variance[k] == pytest.approx(covariance[k, k] - gain @ covariance[others, k], rel=1e-6)


def test_a_prediction_has_the_derivatives_of_its_surfaces(monkeypatch):
    """The smaller of the two deviations of a surface counts; a gauge is displaced by what it reads."""
    rng = np.random.default_rng(6)
    weight = rng.normal(size=(COUNT, 2, 6))
    read = replace(READINGS, surfaces=replace(READINGS.surfaces, by_twist=weight))
    twist, by_scale, by_lift = 1e-4 * rng.normal(size=(3, COUNT, 6))
    by_parameter, by_file, lift = rng.normal(size=(COUNT, 6, 4)), rng.normal(size=(4, 2)), 1e-4 * rng.normal(size=COUNT)
    calls = []

    def derivatives(place, robot, order, scale):
        calls.append((place, robot, order, scale))
        return twist, by_parameter, by_scale

    states = SimpleNamespace(
        derivatives=derivatives, lift=lift,
        twist_by_lift=lambda *given: by_lift if given == ("cell", "robot", 1.2, twist) else None,
    )  # fmt: skip
    prior = SimpleNamespace(robot_with_change=lambda z: "robot" if z == "z" else None, order="order", by_file=by_file)
    found = linear.linearise(prior, read, states, "cell", z="z", scale=1.2)
    assert calls == [("cell", "robot", "order", 1.2)]
    for n in range(COUNT):
        values = [float(side @ twist[n]) for side in weight[n]]
        side = weight[n][int(values[1] < values[0])]
        rate = float(side @ by_lift[n])
        assert found.by_lift[n] == pytest.approx(rate)
        assert found.value[n] == pytest.approx(min(values) - rate * lift[n])
        np.testing.assert_allclose(found.slopes[n], [*(side @ by_parameter[n] @ by_file), side @ by_scale[n]])
        moved = abs(min(values)) if MASS[n] else 1.2 * np.linalg.norm(by_scale[n, :3])
        assert found.displacement[n] == pytest.approx(moved)


def linear_world(monkeypatch, bend=0.0):
    """A model that is linear in its unknowns, or bent by a quadratic term; γ is 0.01."""
    local = prediction()

    def linearised(prior, read, states, place, z, scale):
        x = np.append(z, scale - 1.0)
        value = local.value + local.slopes @ x + bend * (local.slopes @ x) ** 2
        slopes = local.slopes * (1.0 + 2.0 * bend * (local.slopes @ x))[:, None]
        return replace(local, value=value, slopes=slopes)

    monkeypatch.setattr(linear, "linearise", linearised)
    monkeypatch.setattr(linear, "unmodelled_share", lambda *parts: 0.01)
    rng = np.random.default_rng(9)
    root = rng.normal(size=(3, 3))
    return local, SimpleNamespace(covariance=0.02 * root @ root.T), linearised


def test_the_solution_of_a_linear_model_is_the_most_probable_one(monkeypatch):
    """In information form; unknowns that are held stay where they are."""
    local, prior, _ = linear_world(monkeypatch)
    noise = linear.noise_covariance(READINGS, local, 0.01)
    information = np.linalg.inv(prior.covariance) + local.slopes.T @ np.linalg.solve(noise, local.slopes)
    expected = np.linalg.solve(
        information, local.slopes.T @ np.linalg.solve(noise, READINGS.probed.deviation - local.value)
    )
    for free in (np.ones(3), np.array([1.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0])):
        at, z, scale, gamma = linear.solve(prior, READINGS, None, None, z=np.array([0.3, -0.2]), scale=1.4, free=free)
        solution = free * expected
        np.testing.assert_allclose(z, solution[:2], rtol=1e-6)
        assert scale == pytest.approx(1.0 + solution[2])
        np.testing.assert_allclose(at.value, local.value + local.slopes @ solution, atol=1e-12)
        assert gamma == 0.01


def test_the_solution_of_a_bent_model_is_stationary(monkeypatch):
    """The derivative of the sum of squares, with the prior, is zero there."""
    _, prior, linearised = linear_world(monkeypatch, bend=300.0)
    at, z, scale, _ = linear.solve(prior, READINGS, None, None, z=np.zeros(2), scale=1.0, free=np.ones(3))
    noise = linear.noise_covariance(READINGS, at, 0.01)

    def cost(x):
        gap = READINGS.probed.deviation - linearised(None, None, None, None, x[:2], 1.0 + x[2]).value
        return gap @ np.linalg.solve(noise, gap) + x @ np.linalg.solve(prior.covariance, x)

    x = np.append(z, scale - 1.0)
    spread = np.sqrt(np.diag(prior.covariance))
    curved = cost(x + spread) - cost(x)
    for step in np.diag(1e-4 * spread):
        assert abs(cost(x + step) - cost(x - step)) < 1e-5 * abs(curved)


def test_the_height_over_the_block_follows_from_the_position_of_the_part():
    """In information form; slopes are rotations of the part about X and Y, and the touch-off adds its own spread."""
    rng = np.random.default_rng(11)
    by_lift = 0.1 * rng.normal(size=COUNT)
    position = causes(by_lift)[:12].T
    other = np.diag(rng.uniform(1e-10, 3e-10, COUNT))
    target = 1e-5 * rng.normal(size=COUNT)
    lifts = READINGS.lifts(by_lift, np.linalg.inv(position @ position.T + other), target)
    information = np.eye(12) + position.T @ np.linalg.solve(other, position)
    covariance = np.linalg.inv(information)
    value = covariance @ position.T @ np.linalg.solve(other, target)
    assert [lift.base for lift in lifts] == [-1, 2]
    for k, (lift, top) in enumerate(zip(lifts, READINGS.tops, strict=True)):
        # columns are shift and turn about X, about Y, about Z in turn
        terms = np.zeros((3, 12))
        terms[0, 6 * k + 4], terms[1, 6 * k + 3], terms[2, 6 * k + 1] = 0.01, -0.1, 0.1
        middle = READINGS.probed.point[READINGS.probed.base == lift.base].mean(axis=0)
        np.testing.assert_allclose(lift.origin, middle)
        np.testing.assert_allclose(lift.coefficients, terms @ value, rtol=1e-4, atol=1e-9)
        spread = terms @ covariance @ terms.T
        factor = np.array([1.0, *(middle - top.origin)[:2]])
        spread[0, 0] += factor @ top.covariance @ factor
        spread[1:, 1:] += top.covariance[1:, 1:]
        np.testing.assert_allclose(lift.covariance, spread, rtol=1e-4, atol=1e-4 * np.abs(spread).max())


def test_the_flattest_cut_is_that_of_floors_below_the_touch_off_points():
    """Of walls if no floor is probed; a gauge is no cut."""
    tops = tuple(Top(base, (), np.array([0, 0, z]), np.zeros(3), np.eye(3), 0.0) for base, z in ((-1, 1e-3), (2, 5e-3)))
    point = READINGS.probed.point.copy()
    point[:, 2] = -1e-3 * np.array([0.2, 9, 3, 0.1, 4, 9, 1.5, -7])
    read = replace(READINGS, probed=replace(READINGS.probed, point=point), tops=tops)
    assert read.least_depth == pytest.approx(4e-3)  # F01.floor: 3 mm below 1 mm
    walls = replace(read, surfaces=replace(read.surfaces, is_wall=np.ones(COUNT, dtype=bool)))
    assert walls.least_depth == pytest.approx(1.1e-3)
    without = replace(read, tops=tops[1:])
    assert without.least_depth == pytest.approx(6.5e-3)


def test_a_lift_is_a_plane_over_the_middle_of_the_points_and_its_forces_are_limited():
    lift = Lift(-1, np.array([0.1, 0.2, 0.0]), np.array([1e-3, 0.02, -0.03]), np.eye(3))
    points = np.array([[0.1, 0.2, 5.0], [0.2, 0.2, 0.0], [0.1, 0.3, 0.0], [0.0, 0.5, 0.0]])
    np.testing.assert_allclose(lift.heights(points), [1e-3, 3e-3, -2e-3, -1e-2])
    (limited,) = fitting._heights([lift], 2.5e-3)
    np.testing.assert_allclose(limited(points), [1e-3, 2.5e-3, -2e-3, -2.5e-3])


def estimate(local, deviation, outliers=()):
    read = replace(READINGS, probed=replace(READINGS.probed, deviation=deviation))
    states = SimpleNamespace(take=lambda rows: rows)
    return fitting._Estimate(
        read, np.arange(20, 20 + COUNT), outliers, np.ones(3, dtype=bool), states, np.zeros(2), 1.0, 0.01, local
    )


def test_the_point_that_contradicts_all_others_is_left_out_but_not_beyond_the_limit():
    """Beyond five times its usual size; where all points are worse than they should be, beyond five times that."""
    local, whole = prediction(), 0.02 * np.eye(3)
    covariance = local.slopes @ whole @ local.slopes.T + linear.noise_covariance(READINGS, local, 0.005)
    precision = np.linalg.inv(covariance)

    def sizes(deviation):
        return np.abs(precision @ (deviation - local.value)) / np.sqrt(np.diag(precision))

    one_sigma = covariance[:, 4] * np.sqrt(precision[4, 4])  # the others agree with all but this point
    np.testing.assert_allclose(sizes(local.value + one_sigma), np.arange(COUNT) == 4, atol=1e-9)
    for size, is_left_out in ((4.9, False), (5.1, True)):
        deviation = local.value + size * one_sigma
        found = fitting._without_outlier(estimate(local, deviation), whole, 1)
        assert (found is not None) == is_left_out
        assert fitting._without_outlier(estimate(local, deviation, ("F09.left",)), whole, 1) is None
    kept = [k for k in range(COUNT) if k != 4]
    assert found.outliers == ("F02.floor",)
    assert found.rows.tolist() == [20 + k for k in kept]
    assert found.states.tolist() == kept
    assert found.readings.probed.name == tuple(NAMES[k] for k in kept)
    # errors of all points ten times as large as they should be: the same gross error is among them
    rng = np.random.default_rng(0)
    large = local.value + 10.0 * np.linalg.cholesky(covariance) @ rng.normal(size=COUNT)
    share = sizes(large).max() / (np.median(sizes(large)) / 0.6745)
    assert 1.0 < share < 5.0 < sizes(large).max()
    assert fitting._without_outlier(estimate(local, large), whole, 1) is None


@pytest.mark.parametrize("share", [0.89, 0.91])
def test_parameters_that_stay_as_uncertain_as_before_are_held_but_not_the_forces(monkeypatch, share):
    """From nine tenths of the standard deviation before; what is held keeps the value of the prior."""
    whole = np.diag([4.0, 9.0, 0.01])
    after = np.diag([share**2 * 4.0, 0.2, 0.01])
    monkeypatch.setattr(
        fitting, "posterior_covariance", lambda read, local, gamma, prior, free: after if free.all() else None
    )
    start = replace(estimate(prediction(), READINGS.probed.deviation), z=np.array([0.7, -0.4]))
    found = fitting._with_held_parameters(start, whole)
    if share < 0.9:
        assert found is None
        return
    assert (found.free.tolist(), found.z.tolist()) == ([False, True, True], [0.0, -0.4])
    assert fitting._with_held_parameters(replace(found, linear_model=start.linear_model), whole) is None


def test_the_likeness_of_deviations_is_a_cosine_in_units_of_their_noise():
    noise = np.diag([4.0, 1.0])
    assert fitting._cosine_between(np.array([2.0, 0.0]), np.array([2.0, 1.0]), noise) == pytest.approx(np.sqrt(0.5))
    assert fitting._cosine_between(np.array([-4.0, -2.0]), np.array([2.0, 1.0]), noise) == pytest.approx(-1.0)
    assert fitting._cosine_between(np.zeros(2), np.array([2.0, 1.0]), noise) == 0.0


def test_the_other_sides_of_features_are_found_by_their_names():
    names = ["F01.left", "F01.floor", "F02.left", "F01.right", "F03.right"]
    assert fitting._opposite_rows(names).tolist() == [3, 1, 2, 0, 4]


@pytest.mark.parametrize(
    ("factor", "problem"),
    [(0.21, None), (4.9, None), (1.0, None), (5.1, "millimetres"), (0.19, "hardly any"), (-0.1, "hardly any"),
     (-0.21, "is the sign the other way")],
)  # fmt: skip
def test_deviations_are_a_fifth_to_five_times_the_predicted_ones(factor, problem):
    local = prediction()
    read = replace(READINGS, probed=replace(READINGS.probed, deviation=factor * local.value))
    if problem is None:
        fitting._check_size(read, local)
        return
    with pytest.raises(MeasurementError, match=f"are {factor:.2g} times what the model predicts") as refused:
        fitting._check_size(read, local)
    assert problem in str(refused.value)


def fit_of(seed=5, **fields):
    """A fit with made-up numbers."""
    rng = np.random.default_rng(seed)
    local = prediction()
    covariance = np.diag([4.0, 9.0, 0.01])
    robot = SimpleNamespace(discrepancy=None)
    prior = SimpleNamespace(covariance=covariance, robot=robot, drift=np.array([1.5, 0.8, 0.0]))
    values = {
        "prior": prior, "readings": READINGS, "z": np.zeros(2), "scale": 1.1, "covariance": 0.25 * covariance,
        "free": np.ones(3, dtype=bool), "prior_prediction": np.zeros(COUNT), "prediction": np.zeros(COUNT),
        "load": np.array([100.0, 105, 24, 200, 210, 90, 26, 400]), "displacement": local.displacement,
        "error": 1e-5 * rng.normal(size=COUNT), "spread": rng.uniform(0.8e-5, 2e-5, COUNT), "gamma": 0.01,
        "prior_error": 1e-4 * rng.normal(size=COUNT), "slopes": local.slopes, "torque": np.ones(6), "lifts": (),
        "by_lift": local.by_lift,
    }  # fmt: skip
    return Fit(**(values | fields))


@pytest.mark.parametrize("discrepancy", [None, 4e-5])
@pytest.mark.parametrize("tied", [None, 0, 1])
def test_a_model_is_compared_by_the_change_that_explains_the_readings_best(discrepancy, tied):
    """As a regression on the change alone; a model from a part is right at the part, whatever it misses elsewhere."""
    fit = fit_of()
    prior = fit.prior
    covariance = prior.covariance.copy()
    if tied is not None:
        covariance[-1, tied] = covariance[tied, -1] = -0.05
    stated = None if discrepancy is None else Discrepancy(np.array([1.0, 1e4]), np.full(2, discrepancy))
    prior = SimpleNamespace(
        covariance=covariance, drift=prior.drift, has_forces_of_model=bool(covariance[-1, :-1].any()),
        robot=SimpleNamespace(discrepancy=stated),
    )  # fmt: skip
    found = fit.compare_with_prior(prior)
    unmodelled = 0.01 * fit.displacement
    if stated is not None and tied is None:
        unmodelled = np.maximum(unmodelled, discrepancy / LENGTH_95)
    light = np.array([0, 0, 0, 1, 1, 0, 0, 0]) * 0.15 * fit.displacement
    single = causes(fit.by_lift)
    noise = single.T @ single + np.diag(SIGMA**2 + unmodelled**2 + light**2) + fit.slopes @ covariance @ fit.slopes.T
    assert found.chi2 == pytest.approx(fit.prior_error @ np.linalg.solve(noise, fit.prior_error), rel=1e-6)
    changes = fit.slopes * prior.drift
    gain = prior.drift[:, None] * np.linalg.solve(changes @ changes.T + noise, changes).T
    np.testing.assert_allclose(found.change, gain @ fit.prior_error, rtol=1e-6)
    spread = np.diag(prior.drift**2) - gain @ (changes * prior.drift)
    np.testing.assert_allclose(found.spread, np.sqrt(np.maximum(np.diag(spread), 0.0)), atol=1e-6)
    assert 0.0 < found.no_change_probability <= 1.0


def test_a_fit_is_known_relative_to_its_prior():
    np.testing.assert_allclose(fit_of().sigma, [0.5, 0.5, 0.5])
    free = fit_of(prior=SimpleNamespace(covariance=np.diag([4.0, 0.0, 0.01])), covariance=np.diag([1.0, 0.0, 0.01]))
    np.testing.assert_allclose(free.sigma, [0.5, 0.0, 1.0])


def test_the_unmodelled_error_grows_with_the_level_of_the_load():
    """Points below a quarter of the largest load do not count; a tenth of the deflection is added, and none falls."""
    fit = fit_of(error=np.array([1e-5, -2e-5, 9e-3, 1e-6, 1e-6, 9e-3, 9e-3, 3e-6]))
    fit = replace(fit, load=np.array([101.0, 105, 24, 200, 210, 99, 26, 400]))
    load, bound = fit.u95()
    rows = np.flatnonzero(fit.load > 100.0)
    level = fitting.levels(fit.load[rows])
    expected = []
    for k in range(level.max() + 1):
        own = rows[level == k]
        rms = np.sqrt(np.mean(fit.displacement[own] ** 2))
        variance = np.maximum(fit.spread[own] ** 2 - (0.01 * fit.displacement[own]) ** 2, 0.1 * fit.spread[own] ** 2)
        features = [NAMES[n].partition(".")[0] for n in own]
        share = np.array([1.0 / features.count(name) for name in features])
        size = unmodelled_error(fit.error[own][:, None], variance[:, None, None], 0.0005 * rms, share)
        expected.append(float(np.hypot(size, 0.1 * rms)))
        assert load[k] == np.median(fit.load[own])
    assert len(load) == level.max() + 1
    np.testing.assert_allclose(bound, np.maximum.accumulate(expected))


class States(SimpleNamespace):
    """States of a world that is linear in its unknowns; the forces of some round add an offset."""

    def take(self, rows):
        return States(offset=self.offset, rows=rows)


def world(monkeypatch, offsets, deviation):
    """A fit by rounds: offsets [m] of the predicted deviations in each call that cuts the programs anew."""
    local, prior, _ = linear_world(monkeypatch)
    local = replace(local, displacement=np.full(COUNT, 3e-4), by_lift=np.zeros(COUNT))

    def linearised(given, read, states, place, z, scale):
        rows = [NAMES.index(name) for name in read.probed.name]
        value = local.value + local.slopes @ np.append(z, scale - 1.0) + states.offset
        return replace(local, value=value).take(np.array(rows))

    monkeypatch.setattr(linear, "linearise", linearised)
    monkeypatch.setattr(fitting, "linearise", linearised)
    for name in ("_without_outlier", "_with_held_parameters"):
        monkeypatch.setattr(fitting, name, lambda *parts: None)
    ends = []
    monkeypatch.setattr(
        fitting, "_fit_at_end",
        lambda given, estimate, at_prior, pair: ends.append((estimate, at_prior, pair)) or "fit",
    )  # fmt: skip
    prior.robot, prior.parameters = "as read", (1, 2)
    prior.robot_with_change = lambda z: ("changed", *z)
    calls = []

    def cut_at(robot, scale, heights):
        calls.append((robot, scale, [height(READINGS.probed.point) for height in heights]))
        return States(offset=offsets[min(len(calls) - 1, len(offsets) - 1)], rows=np.arange(COUNT))

    read = replace(READINGS, probed=replace(READINGS.probed, deviation=deviation))
    return read, prior, cut_at, calls, ends, local


def test_rounds_of_a_fit_end_when_new_forces_move_the_prediction_by_little(monkeypatch):
    """The forces of each round are those of the solution before, at heights of at most half of the flattest cut."""
    local = prediction()
    x = np.array([0.02, -0.03, 0.05])
    deviation = local.value + local.slopes @ x
    deviation[BASES == -1] += 5e-3 * READINGS.probed.normal[BASES == -1, 2] * (MASS[BASES == -1] == 0.0)
    offsets = [0.0, 0.0, 6e-6, 8e-6, 9e-6, 9e-6]
    read, prior, cut_at, calls, ends, _ = world(monkeypatch, offsets, deviation)
    assert fitting.fit(prior, read, None, cut_at) == ("fit", ())
    ((end, at_prior, pair),) = ends
    assert calls[0] == ("as read", 1.0, [])
    assert len(calls) == 2
    assert calls[1][0][0] == "changed"
    limit = 0.5 * read.least_depth
    largest = np.abs(np.concatenate(calls[1][2])).max()
    assert largest == pytest.approx(limit)
    assert pair is None
    np.testing.assert_allclose(at_prior.value, local.value)
    assert end.outliers == ()


@pytest.mark.parametrize(
    ("offsets", "rounds", "settles"),
    [([0.0, 1.4e-6], 1, True), ([0.0, 1.6e-6, 2e-6], 2, True), ([0.0, *(4e-6 * k for k in range(1, 20))], 12, True),
     ([0.0, *(6e-6 * k for k in range(1, 20))], 12, False)],
)  # fmt: skip
def test_a_fit_settles_if_the_last_change_is_small(monkeypatch, offsets, rounds, settles):
    """By 1.5 µm RMS at once; after twelve rounds 5 µm will do, and more is refused."""
    read, prior, cut_at, calls, ends, local = world(monkeypatch, offsets, prediction().value)
    if settles:
        fitting.fit(prior, read, None, cut_at)
    else:
        with pytest.raises(MeasurementError, match="does not settle"):
            fitting.fit(prior, read, None, cut_at)
    assert len(calls) == rounds + 1
    if settles:
        np.testing.assert_allclose(ends[0][1].value, local.value + offsets[1])  # the prior under the first new forces
