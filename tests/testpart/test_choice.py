"""The choice of the features of a part from candidates with made-up information."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import MeasurementError, PlanError
from postproc.testpart import design
from postproc.testpart.cut import States, states_at_nominal_height
from postproc.testpart.design import Candidates, Criterion, Tests
from postproc.testpart.features import Cutting, Feature, Kind
from postproc.testpart.prior import Prior
from tests.testpart import trial

PRIOR = Prior.of(trial.RobotInCell.of(trial.ROBOT, trial.CELL).robot, 0.1)
SIZE = len(PRIOR.parameters) + 1
UNKNOWNS = SIZE + 8
CUTTING = Cutting(0.01, 6000.0, 0.018, 1, 0.0, 0.0005)


class StatesOfTests(SimpleNamespace):
    """Deflections of tests that are linear in unknowns in units of files."""

    def derivatives(self, place, robot, order, scale):
        return None, self.by_parameter, self.by_scale

    def twist(self, place, robot, scale):
        return np.concatenate([self.rest + scale * self.deflection, np.full_like(self.rest, 7.0)], axis=1)


def made_tests(seed=1, count=5):
    rng = np.random.default_rng(seed)
    states = StatesOfTests(
        by_parameter=1e-4 * rng.normal(size=(count, 6, SIZE - 1)) @ np.linalg.pinv(PRIOR.by_file * PRIOR.sigma[:-1]),
        by_scale=1e-3 * rng.normal(size=(count, 6)), deflection=1e-3 * rng.normal(size=(count, 3)),
        rest=rng.normal(size=(count, 3)),
    )  # fmt: skip
    weight = rng.random(count)
    return Tests(states, weight / weight.sum(), np.arange(count) % 2 == 0, "made up")


def candidates(seed=2, count=14):
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(count, 4, UNKNOWNS)) * rng.uniform(0.3, 3.0, (count, 1, 1))
    apart = rng.random((count, count)) < 0.8
    apart = apart & apart.T & ~np.eye(count, dtype=bool)
    feature = tuple(Feature(Kind(3e-3, 0), *rng.uniform(0.0, 0.2, 2), 0.0) for _ in range(count))
    return Candidates(
        feature, rng.integers(0, 2, count), np.swapaxes(slopes, 1, 2) @ slopes, rng.uniform(10.0, 40.0, count), apart,
        np.ones(count), None,
    )  # fmt: skip


def expected_square(given, information):
    """Expected square error [m²] by the covariance of the unknowns and the displacement of each test."""
    covariance = np.linalg.inv(information)[:SIZE, :SIZE]
    total, states = 0.0, given.states
    for k, weight in enumerate(given.weight):
        rows = [states.by_parameter[k, :3] @ PRIOR.by_file * PRIOR.sigma[:-1]]
        rows.append(0.1 * given.is_scaled[k] * states.by_scale[k, :3, None])
        slopes = np.concatenate(rows, axis=1)
        total += weight * np.trace(slopes @ covariance @ slopes.T)
    return total


def test_the_criterion_is_the_expected_square_of_the_error_at_the_tests():
    given, found = made_tests(), candidates()
    criterion = Criterion.of(PRIOR, None, given, UNKNOWNS)
    information = np.eye(UNKNOWNS) + found.information[:3]
    np.testing.assert_allclose(criterion(information), [expected_square(given, each) for each in information])


def test_information_before_a_part_is_that_of_the_prior_in_units_of_its_spread():
    """Correlated with the forces; what is certain stays certain, and the units of the part are one."""
    covariance = np.diag([4.0, 0.0, 0.04])
    covariance[0, 2] = covariance[2, 0] = -0.5 * 2.0 * 0.2
    prior = SimpleNamespace(covariance=covariance, sigma=np.sqrt(np.diag(covariance)))
    found = design._prior_information(prior, 5)
    scaled = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, 0.0], [-0.5, 0.0, 1.0]])
    np.testing.assert_allclose(found[:3, :3], np.linalg.inv(scaled), atol=1e-12)
    np.testing.assert_allclose(found[3:, 3:], np.eye(2))
    assert (found[:3, 3:] == 0.0).all()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("weighed", [False, True])
def test_no_exchange_of_one_feature_in_its_time_makes_the_chosen_part_better(seed, weighed):
    """Its features do not touch, and are cut one placement after the other."""
    given, found = made_tests(seed), candidates(seed + 10)
    weight = np.diag(np.append(np.full(SIZE, 2.0), np.zeros(8))) if weighed else 0.0
    chosen = design.choose(found, PRIOR, None, given, 4, weight)
    rows = chosen.chosen.tolist()
    assert len(set(rows)) == 4
    start = np.eye(UNKNOWNS) + weight

    def value(part):
        return expected_square(given, start + found.information[list(part)].sum(axis=0))

    own = value(rows)
    for k, row in enumerate(rows):
        others = rows[:k] + rows[k + 1 :]
        assert found.is_apart[row, others].all()
        for other in range(len(found.feature)):
            if found.is_apart[other, others].all() and found.seconds[other] <= found.seconds[row]:
                assert value([*others, other]) > (1.0 - 1.1e-4) * own
    keys = [(found.placement[row], found.feature[row].y, found.feature[row].x) for row in rows]
    assert keys == sorted(keys)
    assert [chosen.placement[k] for k in range(4)] == [found.placement[row] for row in rows]
    assert chosen.features == tuple(found.feature[row] for row in rows)


def test_the_first_feature_is_the_one_that_gains_most_for_its_time():
    given, found = made_tests(3), replace(candidates(5), is_apart=np.zeros((14, 14), dtype=bool))
    start = np.eye(UNKNOWNS)
    before = expected_square(given, start)
    gains = [
        (before - expected_square(given, start + information)) / seconds
        for information, seconds in zip(found.information, found.seconds, strict=True)
    ]
    best = int(np.argmax(gains))
    same_time = replace(found, seconds=np.where(np.arange(14) == best, found.seconds, 1e3))
    chosen = design.choose(same_time, PRIOR, None, given, 3)
    assert chosen.chosen.tolist() == [best]  # all touch each other, and the others take longer


def test_a_part_has_the_errors_and_the_time_that_it_is_expected_to_have():
    given, found = made_tests(6), candidates(7)
    weight = np.diag(np.append(np.full(SIZE, 2.0), np.zeros(8)))
    rows = np.array([5, 2, 9])
    part = design.evaluate(found, PRIOR, None, given, rows, weight)
    start = np.eye(UNKNOWNS)
    whole = start + found.information[rows].sum(axis=0)
    assert part.before == pytest.approx(np.sqrt(expected_square(given, start)))
    assert part.after == pytest.approx(np.sqrt(expected_square(given, whole + weight)))
    np.testing.assert_allclose(part.sigma, np.sqrt(np.diag(np.linalg.inv(whole + weight)))[:SIZE])
    np.testing.assert_allclose(part.sigma_without_weight, np.sqrt(np.diag(np.linalg.inv(whole)))[:SIZE])
    sizes = np.linalg.norm(given.states.deflection, axis=1)
    assert part.deflection == pytest.approx(np.sqrt(given.weight @ sizes**2))
    assert part.seconds == pytest.approx(found.seconds[[5, 2, 9]].sum())
    assert part.tests == "made up"
    assert sorted(part.chosen.tolist()) == [2, 5, 9]
    without = design.evaluate(found, PRIOR, None, given, rows)
    assert without.sigma_without_weight is None
    with pytest.raises(MeasurementError, match="no feature was chosen"):
        design.evaluate(found, PRIOR, None, given, rows[:0])


@pytest.mark.parametrize("most", [60, 12])
def test_features_are_tried_all_over_the_block_and_are_whole_inside_it(most):
    """Places are evenly spread, and in all there are no more than asked for of each kind and direction."""
    kinds = [Kind(3e-3, 0), Kind(1.5e-3, 1)]
    low, high = np.array([0.1, -0.2, -0.03]), np.array([0.3, -0.08, 0.0])
    found = design._inside_block(kinds, CUTTING, (low, high), most)
    angles = {round(float(np.degrees(feature.angle)), 6) for feature in found}
    assert angles == {30.0 * k for k in range(12)}
    x = sorted({feature.x for feature in found if feature.kind == kinds[0]})
    y = sorted({feature.y for feature in found if feature.kind == kinds[0]})
    for values, begin, end in ((x, 0.1, 0.3), (y, -0.2, -0.08)):
        steps = np.diff(values)
        assert steps == pytest.approx(np.full(len(steps), steps[0]))
        assert sum((values[0] - begin, values[-1] - end)) == pytest.approx(0.0, abs=1e-9)
        assert steps[0] >= max(0.008, np.sqrt(0.2 * 0.12 / most)) - 1e-12
    assert len(x) * len(y) <= most
    for feature in found:
        c, s = np.cos(feature.angle), np.sin(feature.angle)
        middle = {0: 0.0, 1: 0.002}[feature.kind.side]
        half = {0: 0.0081, 1: 0.0101}[feature.kind.side]  # three quarters of the tool, the trim, half of a step
        for u in (-0.016, 0.016):
            end = np.array([feature.x + c * u - s * middle, feature.y + s * u + c * middle])
            assert (end - half >= low[:2] - 1e-9).all()
            assert (end + half <= high[:2] + 1e-9).all()
    with pytest.raises(PlanError, match="no feature fits into the block: each takes 32 mm"):
        design._inside_block(kinds, CUTTING, (low, low + 0.02), most)


def test_the_position_of_the_part_in_each_placement_is_an_unknown_of_its_own():
    """Parameters, forces and the radius of the tool are common; seven unknowns belong to a placement."""
    rng = np.random.default_rng(8)
    common, kinds = SIZE + 1, [Kind(3e-3, 0), Kind(3e-3, 1)]
    state = states_at_nominal_height(np.zeros((1, 6)), np.eye(4)[None], np.eye(4)[None], np.zeros((1, 6)))

    def entry(k):
        small = rng.normal(size=(common + 7, common + 7))
        feature = Feature(kinds[k % 2], 0.05 * k, 0.02 * k, 0.0)
        return design._ReachableFeature(feature, small, 1e-4 * k, replace(state, q=np.full((1, 6), float(k))))

    by_placement = [[entry(k) for k in range(3)], [entry(k) for k in (3, 4)]]
    found = design._join_candidates(by_placement, CUTTING)
    assert found.placement.tolist() == [0, 0, 0, 1, 1]
    entries = [each for placement in by_placement for each in placement]
    assert found.feature == tuple(each[0] for each in entries)
    for k, (feature, small, deflection, _) in enumerate(entries):
        first = common + 7 * found.placement[k]
        index = [*range(common), *range(first, first + 7)]
        np.testing.assert_array_equal(found.information[k][np.ix_(index, index)], small)
        assert np.count_nonzero(found.information[k]) == small.size
        assert found.deflection[k] == deflection
        assert found.seconds[k] == design.features.seconds(feature.kind, CUTTING)
        assert found.states.q[k, 0] == k
    assert isinstance(found.states, States)
    assert found.is_apart.shape == (5, 5)
    everywhere = design.tests_in_block(found)
    assert everywhere.states.q[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    np.testing.assert_allclose(everywhere.weight, 0.2)
    assert everywhere.is_scaled.all()
    assert everywhere.source == "this process all over the block in all its placements"
    one = design._join_candidates(by_placement[:1], CUTTING)
    assert design.tests_in_block(one).source == "this process all over the block"


def test_tests_are_taken_evenly_from_many_features():
    states = states_at_nominal_height(
        np.tile(np.arange(200.0)[:, None], 6), np.tile(np.eye(4), (200, 1, 1)), np.tile(np.eye(4), (200, 1, 1)),
        np.zeros((200, 6)),
    )  # fmt: skip
    found = SimpleNamespace(feature=tuple(range(200)), placement=np.zeros(200, dtype=int), states=states)
    taken = design.tests_in_block(found).states.q[:, 0]
    assert len(taken) == 48
    assert (taken[0], taken[-1]) == (0.0, 199.0)
    assert set(np.diff(taken)) <= {4.0, 5.0}
