"""Equations, regressions and the mean of structures, each number against matrices written out in full."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.identification import choice
from postproc.identification.choice import Mean, Member, projection
from postproc.identification.fit import (
    LinearEquations,
    Prior,
    Regression,
    covariance_of,
    gauss_newton,
    learn,
    linearise,
)
from postproc.identification.measurement_model import Structure, measured_displacements, predict
from postproc.robot import JOINT_COMPLIANCES
from samples.paper_study import harness
from tests.identification.test_joint_springs import SPRINGS, forces, placed, readings

CONFIGS, P = 6, 5


def made(seed=0, silent=()):
    """Equations of unequal configurations and weights; rows in `silent` contain no reading."""
    rng = np.random.default_rng(seed)
    config = np.repeat(np.arange(CONFIGS), [9, 6, 12, 9, 15, 6])
    design = rng.normal(size=(len(config), P)) * [1.0, 3.0, 0.5, 2.0, 1.0]
    design[list(silent)] = 0.0
    target = design @ [0.5, 0.0, 1.0, 0.3, 0.7] + rng.normal(size=len(config))
    target[list(silent)] = 0.0
    return LinearEquations(design, target, config, rng.uniform(0.2, 1.0, len(config)))


def regression(columns, signed=True, noise=1.7):
    """All may have either sign but parameter 0, which is positive."""
    rng = np.random.default_rng(1)
    columns = np.array(columns)
    return Regression(
        columns, rng.normal(size=P)[columns] * 0.2, rng.uniform(0.3, 2.0, P)[columns],
        signed & (columns != 0), noise, 0.0, P,
    )  # fmt: skip


def dense(one, equations, rows=slice(None)):
    """Posterior (n, n) and its mean (n,): readings of variance φ/w, parameters of variance s² about m."""
    design = equations.design[rows][:, one.columns]
    weight = np.diag(equations.weight[rows] / one.noise)
    covariance = np.linalg.inv(design.T @ weight @ design + np.diag(1.0 / one.spread**2))
    return covariance, covariance @ (design.T @ weight @ equations.target[rows] + one.mean / one.spread**2)


@pytest.mark.parametrize("columns", [[0, 1, 2, 3, 4], [3, 0, 4]])
def test_a_regression_is_the_posterior_of_normal_readings_and_parameters(columns):
    one, equations = regression(columns), made()
    covariance, mean = dense(one, equations)
    values = one.solve(equations)
    np.testing.assert_allclose(values[columns], mean, rtol=1e-9)
    assert (np.delete(values, columns) == 0.0).all()
    found = one.covariance(equations)
    np.testing.assert_allclose(found[np.ix_(columns, columns)], covariance, rtol=1e-9)
    assert found.sum() == pytest.approx(covariance.sum())
    design = equations.design[:, columns]
    expected = covariance @ design.T @ np.diag(equations.weight / one.noise)
    influence = one.influence(equations, values)
    np.testing.assert_allclose(influence[columns], expected, rtol=1e-9, atol=1e-15)
    assert influence.sum() == pytest.approx(expected.sum())
    hat = design @ expected  # what the readings determine, is the trace of this
    assert one.degrees_of_freedom(equations, values) == pytest.approx(np.trace(hat))
    for without in (np.array([2]), np.array([0, 4, 5])):
        rows = ~np.isin(equations.config, without)
        np.testing.assert_allclose(one.solve(equations, without)[columns], dense(one, equations, rows)[1], rtol=1e-8)


def test_a_parameter_that_is_zero_takes_no_part_in_covariance_of_readings_and_degrees_of_freedom():
    one = replace(regression([0, 1, 2, 3, 4], signed=False), mean=np.array([0.0, -9.0, 0.0, 0.0, 0.0]))
    equations = made()
    values = one.solve(equations)
    on = np.flatnonzero(values)
    assert 1 not in on
    part = replace(one, columns=on, mean=one.mean[on], spread=one.spread[on], signed=on != 0)
    np.testing.assert_allclose(values, part.solve(equations), rtol=1e-9)
    np.testing.assert_allclose(
        one.influence(equations, values), part.influence(equations, values), rtol=1e-9, atol=1e-15
    )
    assert one.degrees_of_freedom(equations, values) == pytest.approx(part.degrees_of_freedom(equations, values))


def test_evidence_of_several_kinds_is_the_density_of_readings_and_factors():
    """Parameters of two kinds and one of a stated size; gross readings weigh less."""
    equations = made(silent=(4, 5, 20))
    kinds = ("joint", "link rotation", "breakpoint")
    prior = Prior(
        np.array([0.4, 0.0, 0.0, 0.2, 0.0]), np.array([0.5, 0.7, 1.5, 0.3, 0.9]), np.array([0, 1, 2, -1, 1]), kinds,
        np.zeros(5, dtype=bool),
    )  # fmt: skip
    columns = np.array([0, 1, 3, 4])
    found = learn(equations, prior, columns)
    size, logs = prior.size[columns], np.log(found.spread / prior.size[columns])
    assert logs[2] == 0.0
    assert logs[1] == pytest.approx(logs[3])
    assert found.mean.tolist() == prior.mean[columns].tolist()
    assert len(size) == 4
    seen = np.linalg.norm(equations.design, axis=1) > 0.0
    design, weight = equations.design[seen][:, columns], equations.weight[seen]

    def density(joint, link, noise):
        factor = np.exp([joint, link, 0.0, link])
        covariance = np.diag(np.exp(noise) / weight) + design @ np.diag((size * factor) ** 2) @ design.T
        left = equations.target[seen] - design @ found.mean
        value = -0.5 * (np.linalg.slogdet(covariance)[1] + left @ np.linalg.solve(covariance, left))
        return value - 0.5 * ((joint / 0.7) ** 2 + (link / 1.0) ** 2 + (noise / 0.5) ** 2)

    here = np.array([logs[0], logs[1], np.log(found.noise)])
    unseen = 0.5 * np.log(equations.weight[~seen]).sum()
    assert found.evidence == pytest.approx(density(*here) + unseen, abs=1e-6)
    free = [0, 1] + ([2] if here[2] > 1e-9 else [])
    for step in 1e-4 * np.eye(3)[free]:
        assert abs(density(*(here + step)) - density(*(here - step))) / 2e-4 < 5e-3


def two_structures(seed=0):
    equations = made(seed)
    one, other = regression([0, 1, 2]), regression([0, 2, 3, 4], noise=1.1)
    fold = np.array([0, 1, 0, 2, 1, 2])
    members = tuple(
        Member(name, False, each, choice._fold_residuals(each, equations, fold))
        for name, each in (("a", one), ("b", other))
    )
    structure = Structure(JOINT_COMPLIANCES[:P], harness.PRIOR)
    return Mean(structure, equations, members, np.array([0.3, 0.7])), fold


def test_residuals_left_out_are_those_of_fits_to_the_other_folds():
    mean, fold = two_structures()
    equations = mean.equations
    for member in mean.members:
        for index in range(3):
            rows = fold[equations.config] == index
            _, values = dense(member.regression, equations, ~rows)
            own = equations.target[rows] - equations.design[rows][:, member.regression.columns] @ values
            np.testing.assert_allclose(member.held_out_residual[rows], own, rtol=1e-8, atol=1e-12)


def test_the_mean_of_structures_is_a_mixture():
    mean, _ = two_structures()
    equations = mean.equations
    value, second, variance = np.zeros(P), np.zeros((P, P)), np.zeros(P)
    for weight, member in zip((0.3, 0.7), mean.members, strict=True):
        one = member.regression
        covariance, own = dense(one, equations)
        whole, square = np.zeros(P), np.zeros((P, P))
        whole[one.columns], square[np.ix_(one.columns, one.columns)] = own, covariance
        value += weight * whole
        second += weight * (square + np.outer(whole, whole))
        variance[one.columns] += weight * one.spread**2
    np.testing.assert_allclose(mean.solve(), value, rtol=1e-9)
    np.testing.assert_allclose(mean.covariance(), second - np.outer(value, value), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(mean.spread(), np.sqrt(variance))
    left = 0.3 * mean.members[0].held_out_residual + 0.7 * mean.members[1].held_out_residual
    for index, found in enumerate(mean.mean_square_errors):
        rows = equations.config == index
        assert found == pytest.approx(np.mean(equations.weight[rows] * left[rows] ** 2))


@pytest.mark.parametrize("seed", range(4))
def test_weights_of_structures_have_the_least_cross_validation_error(seed):
    """Of three among four, against all weights in steps of a per cent."""
    rng, equations = np.random.default_rng(seed), made()
    shared = rng.normal(size=len(equations.target))
    left = [shared + scale * rng.normal(size=len(shared)) for scale in (0.5, 0.6, 0.9, 0.1)]
    left[1] *= 1.0 + 0.3 * seed
    members = [Member("", False, regression([0]), each) for each in left]
    found = choice._stacking_weights(equations, members, np.array([0, 1, 2]))
    assert found[3] == 0.0
    assert found.sum() == pytest.approx(1.0)
    assert found.min() >= 0.0

    def error(weights):
        return float(equations.weight @ (np.tensordot(weights, left[:3], 1)) ** 2)

    grid = [(a / 200, b / 200, 1 - (a + b) / 200) for a in range(0, 201, 2) for b in range(0, 201 - a, 2)]
    best = min(error(weights) for weights in grid)
    assert error(found[:3]) < best * (1.0 + 2e-3 + (found[:3] == 0.0).any() * 2e-2)


def test_structures_with_the_same_errors_share_the_weight_that_one_of_them_would_have():
    rng, equations = np.random.default_rng(7), made()
    shared = rng.normal(size=len(equations.target))
    left = [shared + scale * rng.normal(size=len(shared)) for scale in (0.8, 0.9)]

    def weights(*errors):
        members = [Member("", False, regression([0]), error) for error in errors]
        return choice._stacking_weights(equations, members, np.arange(len(members)))

    once, twice = weights(*left), weights(left[0], *left)
    assert 0.2 < once[0] < 0.8
    assert twice[:2].sum() == pytest.approx(once[0], abs=1e-4)
    np.testing.assert_allclose(weights(left[1], left[1], left[1]).sum(), 1.0)


def test_dropped_parameters_are_replaced_by_the_best_combination_of_those_kept():
    equations, spread, keep = made(), np.array([0.5, 2.0, 1.0, 0.2, 3.0]), np.array([0, 2, 4])
    onto = projection(equations, keep, spread)
    root = np.sqrt(equations.weight)[:, None]
    rows = np.vstack([root * equations.design[:, keep], np.diag(1.0 / spread[keep])])
    for column in (1, 3):
        wanted = np.append(root[:, 0] * equations.design[:, column], np.zeros(3))
        np.testing.assert_allclose(onto[:, column], np.linalg.lstsq(rows, wanted, rcond=None)[0], rtol=1e-8)
    np.testing.assert_array_equal(onto[:, keep], np.eye(3))


def test_covariance_is_the_inverse_of_the_squares_and_infinite_where_nothing_is_known():
    design = np.random.default_rng(2).normal(size=(20, 4)) * [1.0, 1e6, 1e-3, 10.0]
    usual = np.array([1.0, 1e-6, 1e3, 0.1])
    np.testing.assert_allclose(covariance_of(design, usual), np.linalg.inv(design.T @ design), rtol=1e-7)
    dead = usual.copy()
    dead[2] = 1e-5  # of that size it moves no reading by a millionth of σ
    found = covariance_of(design, dead * [1, 1, 1e-2, 1])
    assert np.isinf(found[2, 2])
    assert (np.delete(found[2], 2) == 0.0).all()
    assert (np.delete(found[:, 2], 2) == 0.0).all()
    whole = np.linalg.inv(design.T @ design)  # the others are as uncertain as its value makes them
    np.testing.assert_allclose(
        np.delete(np.delete(found, 2, 0), 2, 1), np.delete(np.delete(whole, 2, 0), 2, 1), rtol=1e-7
    )
    twins = design[:, [0, 1, 1, 3]]
    assert np.isinf(np.diag(covariance_of(twins, usual[[0, 1, 1, 3]]))).tolist() == [False, True, True, False]


def test_degrees_of_freedom_do_not_count_coordinates_of_points_without_a_reading():
    data = readings(forces(5, 800.0), count=5)
    for points_left_out in (0, 1):
        data = replace(data, used=~((data.state == 3) & (data.point < points_left_out)))
        fit = gauss_newton(Structure(JOINT_COMPLIANCES, harness.PRIOR), data, placed(data))
        assert fit.dof == 5 * 12 - 3 * points_left_out - 6


def test_equations_near_values_have_displacements_derivatives_and_weights_of_the_readings():
    """Whitened by the noise of means of two; a point that is far off weighs less."""
    data = readings(forces(5, 800.0), count=5)
    data = replace(data, used=~((data.state == 3) & (data.point == 2)))
    position = data.position + np.random.default_rng(3).normal(0.0, 1e-5, data.position.shape)
    position[(data.state == 7) & (data.point == 0)] += [4e-4, 0.0, 0.0]
    data, placement = replace(data, position=position), placed(data)
    structure = Structure(JOINT_COMPLIANCES, harness.PRIOR)
    values = SPRINGS
    found = linearise(structure, values, data, placement)
    assert found.config.tolist() == np.repeat(np.arange(5), 12).tolist()
    assert found.reading_count == 5 * 12 - 3
    assert found.config_count == 5
    moved, _ = predict(structure, values, data, placement)
    left = measured_displacements(data, placement) - moved
    slopes = np.empty((*left.shape, 6))
    for k in range(6):
        by = np.zeros(6)
        by[k] = 1e-3 * values[k]
        slopes[..., k] = (
            predict(structure, values + by, data, placement)[0] - predict(structure, values - by, data, placement)[0]
        ) / (2 * by[k])
    sizes, rows = {}, {}
    for state in range(5):
        seen = [p for p in range(4) if (state, p) != (1, 2)]
        # displacements of a state share no noise but through the means of two repeats, loaded and not
        for p in seen:
            sigma = data.sigma * np.sqrt(1 / 2 + 1 / 2)
            rows[state, p] = slopes[state, p] / sigma
            sizes[state, p] = np.linalg.norm(left[state, p]) / sigma
    usual = np.median(list(sizes.values())) / 1.538
    for (state, p), size in sizes.items():
        at = 12 * state + 3 * p
        np.testing.assert_allclose(found.weight[at : at + 3], min(1.0, 3.5 * usual / size), rtol=1e-6)
        np.testing.assert_allclose(
            found.design[at : at + 3], rows[state, p], rtol=2e-4, atol=1e-3 * np.abs(rows[state, p]).max()
        )
        white = left[state, p] / (data.sigma * 1.0)
        np.testing.assert_allclose(found.residual(values, slice(at, at + 3)), white, rtol=1e-6, atol=1e-6)
    gone = 12 * 1 + 3 * 2
    assert not found.design[gone : gone + 3].any()
    assert not found.target[gone : gone + 3].any()
    assert found.weight.min() < 0.5
