"""Gross errors and wrong sets of readings, planted one by one into readings without noise worth mentioning."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import MeasurementError
from postproc.identification import plausibility, procedure
from postproc.identification.measurement_model import locate
from postproc.identification.readings import Measurements
from samples.paper_study import harness, simulator

SIGMA = 0.01e-3
BODY = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.1, 0.4]])


def rigid(states=6, repeats=3, points=4, seed=0):
    """Readings of one rigid body that is anywhere: nothing but repeats and distances can be judged."""
    rng = np.random.default_rng(seed)
    order = [(s, r, p) for s in range(states) for r in range(repeats) for p in range(points)]
    state, repeat, point = np.array(order).T
    turn = np.linalg.qr(rng.normal(size=(states, 3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))[:, None, None]
    place = np.einsum("sij,pj->spi", turn, BODY[:points]) + rng.uniform(-1, 1, (states, 1, 3))
    count = len(order)
    return Measurements(
        file="m.csv", config=1.0 + np.arange(states // 2), q=np.zeros((states // 2, 6)),
        state_config=np.arange(states) // 2, load=(np.arange(states) % 2).astype(float), wrench=np.zeros((states, 6)),
        points=("P1", "P2", "P3", "P4")[:points], guess=BODY[:points], load_point=np.zeros(3), sigma=SIGMA, state=state,
        point=point, repeat=1.0 + repeat, position=place[state, point] + rng.normal(0.0, SIGMA, (count, 3)),
        line=2 + np.arange(count), used=np.ones(count, dtype=bool),
    )  # fmt: skip


def moved(data, reading, by):
    position = data.position.copy()
    position[reading] += by
    return replace(data, position=position)


def test_a_reading_far_from_its_repeats_and_one_at_a_wrong_distance_are_left_out_and_named():
    three, off = rigid(), np.array([0.5e-3, 0.0, 0.0])
    wrong = moved(three, 25, off)
    cleaned, told = plausibility.remove_gross_errors(wrong)
    assert np.flatnonzero(~cleaned.used).tolist() == [25]
    assert told == [f"{three.name(25)} is 0.50 mm from its repeats: left out"]
    once = rigid(repeats=1)  # no repeats: the distances to the other points show it
    cleaned, told = plausibility.remove_gross_errors(moved(once, 10, off))
    assert np.flatnonzero(~cleaned.used).tolist() == [10]
    assert len(told) == 1
    assert told[0].startswith(f"{once.name(10)} is 0.")
    assert told[0].endswith(" mm off in its distance to the other points: left out")
    # both at once: all repeats of one point are off alike, so that distances alone show them
    both = wrong
    for reading in (13, 17, 21):
        both = moved(both, reading, off)
    cleaned, told = plausibility.remove_gross_errors(both)
    assert np.flatnonzero(~cleaned.used).tolist() == [13, 17, 21, 25]
    assert ["repeats" in line for line in told] == [True, False, False, False]


@pytest.mark.parametrize(("sets", "seen"), [(3, True), (2, False)])
def test_distances_are_compared_from_three_sets_on(sets, seen):
    once = rigid(states=4, repeats=1)
    incomplete = [int(np.flatnonzero(once.state == state)[0]) for state in range(sets, 4)]
    wrong = moved(once, 5, np.array([0.5e-3, 0.0, 0.0])).drop(incomplete)
    bad, names = plausibility._readings_off_body(wrong, SIGMA)
    assert bad == ([5] if seen else [])
    assert len(names) == seen


def test_half_of_the_repeats_are_not_left_out_since_none_of_them_is_the_usual_one():
    """Two of four to either side of the others, and one of three, which is left out."""
    four, off = rigid(repeats=4, points=2), np.array([0.5e-3, 0.0, 0.0])
    rows = np.flatnonzero((four.state == 2) & (four.point == 1))
    _, told = plausibility.remove_gross_errors(moved(moved(four, rows[0], off), rows[3], -off))
    assert told == []
    cleaned, _ = plausibility.remove_gross_errors(moved(four, rows[0], off))
    assert np.flatnonzero(~cleaned.used).tolist() == [rows[0]]


@pytest.mark.parametrize(("factor", "count"), [(0.8, 0), (1.3, 1)])
def test_a_reading_is_gross_from_nine_standard_deviations_on(factor, count):
    off = factor * 9.0 * SIGMA * np.array([0.0, 0.6, 0.8])
    data = rigid(seed=3)
    data = replace(data, position=data.position - 0.9 * (data.position - data.means()[0][data.state, data.point]))
    _, told = plausibility.remove_gross_errors(moved(data, 31, off))
    assert len([line for line in told if "repeats" in line]) == count


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    """A robot, and readings of it with three repeats; the noise is small."""
    rng = np.random.default_rng(5)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 10)
    _, raw = simulator.measure(true, q, f, rng, SIGMA)
    return true, q, f, raw, tmp_path_factory.mktemp("readings")


def loaded(experiment, change, folder):
    """Return the readings [config, loaded, repeat, point] after a change."""
    _, q, f, raw, place = experiment
    new = raw.copy()
    change(new)
    return harness.load(simulator.write(place / folder, q, f, new, SIGMA))


OFF = np.array([0.9e-3, -0.6e-3, 0.5e-3])


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((6, 1, 1, 1), ["config 7, load 1, repeat 2, point P2"]),  # one repeat under load
        ((6, 1, slice(None), 1), [f"config 7, load 1, repeat {k}, point P2" for k in (1, 2, 3)]),  # all of them
        ((3, 0, 2, 0), ["config 4, load 0, repeat 3, point P1"]),  # one without load
    ],
)
def test_the_reading_that_a_fit_contradicts_is_named_loaded_or_not(experiment, place, expected):
    def change(raw):
        raw[place] += 3.0 * OFF

    data = loaded(experiment, change, "off")
    placement = locate(harness.PRIOR, data)
    fit = procedure._fit_of_joints(harness.PRIOR, data, placement).fit
    cleaned, told = plausibility.remove_worst_residual(data, placement, fit)
    assert [line.split(" is ")[0].partition(": ")[2] for line in told] == expected
    assert [data.name(int(row)).partition(": ")[2] for row in np.flatnonzero(~cleaned.used)] == expected


def test_as_many_largest_residuals_as_are_wrong_explain_a_misfit(experiment):
    """The second wrong point follows the first in the order of the readings, the third is far from both."""

    def change(raw):
        for config, point in ((2, 1), (2, 2), (7, 0)):
            raw[config, 1, :, point] += 0.2 * OFF * (4.0 - point)

    data = loaded(experiment, change, "three")
    fit = procedure._fit_of_joints(harness.PRIOR, data, locate(harness.PRIOR, data)).fit
    assert [procedure._can_outliers_explain(fit, most) for most in (1, 2, 3, 4)] == [False, False, True, True]


@pytest.mark.parametrize("method", ["enhanced", "serial"])
def test_what_was_left_out_and_what_is_not_observable_is_among_the_warnings(experiment, method):
    """One reading is off by 9 mm; and the stated noise is so large that k6 is not known."""

    def change(raw):
        raw[6, 1, 1, 1] += 10.0 * OFF

    data = loaded(experiment, change, "warned")
    result = procedure.identify(harness.PRIOR, data, method)
    (left_out,) = result.left_out
    assert f"outlier: {left_out}" in result.warnings
    noisy = procedure.identify(harness.PRIOR, replace(data, sigma=0.5e-3), method)
    assert noisy.missing or method == "serial"
    assert {str(entry) for entry in noisy.missing} <= set(noisy.warnings)


@pytest.mark.parametrize(
    ("share", "off"),
    [(1.0, (0.03, 0.0, 0.0)), (0.0, (0.0, 0.0, 0.0)), (1e-3, (0.0, 0.0, 0.0)), (1.0, (0.0, 1.0, 0.0))],
    ids=["30 mm", "zeros", "metres", "another target"],
)
@pytest.mark.parametrize("load", [0, 1])
def test_a_reading_that_is_off_by_far_is_left_out_before_means_are_judged(experiment, share, off, load):
    def change(raw):
        raw[6, load, 1, 1] = share * raw[6, load, 1, 1] + np.array(off)

    result = procedure.identify(harness.PRIOR, loaded(experiment, change, "gross"), "serial")
    (left_out,) = result.left_out
    assert f"config 7, load {load}, repeat 2, point P2" in left_out


def test_some_configurations_are_what_a_file_of_them_alone_gives(experiment):
    _, q, f, raw, place = experiment
    whole, rows = loaded(experiment, lambda _: None, "whole"), np.array([1, 4, 7])
    few = harness.load(simulator.write(place / "few", q[rows], f[rows], raw[rows], SIGMA))
    found = whole.take_configurations(rows)
    for name in Measurements.__struct_fields__:
        if name not in ("file", "config", "line"):
            np.testing.assert_array_equal(getattr(found, name), getattr(few, name), err_msg=name)
    assert found.config.tolist() == [2.0, 5.0, 8.0]
    np.testing.assert_array_equal(found.position, whole.position[np.isin(whole.state_config[whole.state], rows)])


@pytest.mark.parametrize("loop", [0.03e-3, 0.1e-3])
def test_a_loop_has_the_half_width_by_which_the_gear_lags(experiment, loop):
    """A4 is behind while the load comes up, and ahead by as much when it goes down again."""
    true, q, f, _, place = experiment
    rng, shares = np.random.default_rng(7), (0.2, 1.0, 0.2)
    from tests.identification.test_truth import Returning, joint_torques_of

    flank = np.sign(joint_torques_of(true, q, f)[:, 3])
    _, raw = simulator.measure(Returning(true, flank, loop, f), q, f, rng, SIGMA, levels=shares)
    data = harness.load(simulator.write(place / "loop", q, f, raw, SIGMA, levels=shares))
    (told,) = plausibility.hysteresis_warnings(harness.PRIOR, data, locate(harness.PRIOR, data))
    assert told.endswith("backlash or friction in A4")
    assert float(told.split("looks like ")[1].split(" ")[0]) == pytest.approx(loop * 1e3, rel=0.1, abs=0.0006)


@pytest.mark.parametrize(("factor", "unit"), [(1 / 9.81, "kg"), (1 / 30.0, "another unit than N")])
def test_forces_in_another_unit_than_newton_are_refused(experiment, factor, unit):
    """Forces that are too small by 9.81 are masses; by 30 they are neither."""
    data = loaded(experiment, lambda raw: None, "newton")
    placement = locate(harness.PRIOR, data)
    plausibility.check_loads(harness.PRIOR, data, placement)
    with pytest.raises(MeasurementError, match=f"the forces look like {unit}"):
        plausibility.check_loads(harness.PRIOR, replace(data, wrench=data.wrench * factor), placement)


def test_a_fit_without_a_gross_residual_leaves_out_nothing(experiment):
    data = loaded(experiment, lambda raw: None, "clean")
    placement = locate(harness.PRIOR, data)
    fit = procedure._fit_of_joints(harness.PRIOR, data, placement).fit
    cleaned, lines = plausibility.remove_worst_residual(data, placement, fit)
    assert cleaned is data
    assert lines == []


def test_what_joint_springs_leave_unexplained_is_a_warning_with_its_size(tmp_path):
    """Links deflect too, and the fit is to be one of joint springs: the covariance grows by the misfit."""
    rng = np.random.default_rng(3)
    true, (q, f) = simulator.hard(rng), simulator.plan(rng, 12)
    _, raw = simulator.measure(true, q, f, rng, SIGMA)
    data = harness.load(simulator.write(tmp_path, q, f, raw, SIGMA))
    found = procedure.identify(harness.PRIOR, data, depth="joints")
    (warning,) = [text for text in found.warnings if text.startswith("joint springs and compensator leave")]
    ratio = found.fit.chi2 / found.fit.dof
    assert f"leave {1e3 * found.fit.rms:.3f} mm RMS, {ratio:.1f} times the noise variance" in warning
    assert ratio > 2.0
