"""What a fit of a part is said to be, case by case: verdicts, faults, remarks, tables and the files of the model."""

from __future__ import annotations

import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import machining
from postproc.robot import Discrepancy
from postproc.robot.model_file import MeasuredEntry
from postproc.testpart import fit as fitting
from postproc.testpart import model
from postproc.testpart.fit import Fit, PriorComparison
from postproc.testpart.prior import Prior
from postproc.testpart.readings import Lift, Top
from tests.kr270 import ROBOT
from tests.testpart import trial
from tests.testpart.test_by_formula import COUNT, NAMES, READINGS

Z95 = 1.959964
PRIOR = Prior.of(trial.RobotInCell.of(trial.ROBOT, trial.CELL).robot, 0.1)
SIZE = len(PRIOR.parameters)
DEPTH = READINGS.least_depth
TILT_SIGMA = 1e-3
HIGH = np.array([0.0, 0.0, 0.2])
"""Of the touch-off points over the cuts [m], where no lift is large next to the depth."""


def lift(base=-1, height=0.0, slopes=(0.0, 0.0), sigma=1e-5, tilt_sigma=TILT_SIGMA):
    """How high a program ran over the block [m, rad]; the tilt has one uncertain axis."""
    middle = READINGS.probed.point[READINGS.probed.base == base].mean(axis=0)
    return Lift(base, middle, np.array([height, *slopes]), np.diag([sigma**2, tilt_sigma**2, 0.0]))


def fitted(**fields):
    """A fit in which nothing is wrong; its correlations are zero."""
    free = np.ones(SIZE + 1, dtype=bool)
    values = {
        "prior": PRIOR, "readings": READINGS, "z": np.zeros(SIZE), "scale": 1.0,
        "covariance": np.diag((0.5 * PRIOR.sigma) ** 2), "free": free, "prior_prediction": np.full(COUNT, 2e-5),
        "prediction": READINGS.probed.deviation + 1e-6, "load": np.linspace(100.0, 200.0, COUNT),
        "displacement": np.full(COUNT, 3e-4), "error": np.full(COUNT, 4e-6), "spread": np.full(COUNT, 6e-6),
        "gamma": 0.01, "prior_error": np.zeros(COUNT), "slopes": np.zeros((COUNT, SIZE + 1)),
        "torque": np.arange(6.0) * 100.0, "lifts": (lift(-1), lift(2)), "by_lift": np.zeros(COUNT),
    }  # fmt: skip
    return Fit(**(values | fields))


def verdict(outliers=(), **fields):
    found = model.summary(fitted(**fields), outliers)
    return found.verdict.refused, found.verdict.line


def test_a_fit_in_which_nothing_is_wrong_may_be_used():
    assert verdict() == (False, "the model may be used, within its bound")


def one(k, value, size=SIZE):
    z = np.zeros(size)
    z[k] = value
    return z


CASES = {
    "unmodelled": [({"gamma": 0.25}, None), ({"gamma": 0.26}, "26 % of the deflection are not described")],
    "implausible": [
        ({"z": one(1, -3.99 * PRIOR.sigma[1])}, None),
        ({"z": one(1, -4.2 * PRIOR.sigma[1])}, f"{PRIOR.parameters[1].name} would be 4.2 standard deviations"),
    ],
    "forces": [({"scale": 1.39}, None), ({"scale": 0.59}, "forces would be 0.59 times those computed: check material")],
    "nothing": [
        ({"free": one(SIZE, 1, SIZE + 1) > 0, "covariance": np.diag((0.89 * PRIOR.sigma) ** 2)}, None),
        (
            {"free": one(SIZE, 1, SIZE + 1) > 0, "covariance": np.diag((0.91 * PRIOR.sigma) ** 2)},
            "the part determines neither a parameter of the robot nor the forces",
        ),
        ({"free": one(0, 1, SIZE + 1) > 0, "covariance": np.diag((0.91 * PRIOR.sigma) ** 2)}, None),
    ],
    "exchanged": [({"exchanged_pair": ("F01", "F03")}, "F01 and F03 look exchanged: exchange their rows")],
    "too high": [
        ({"lifts": (lift(-1, 0.49 * DEPTH), lift(2))}, None),
        ({"lifts": (lift(-1, 0.51 * DEPTH), lift(2))}, "too high over the block at [base], more than half of the"),
        ({"lifts": (lift(-1), lift(2, -0.51 * DEPTH))}, "too low over the block at [base_data.2], more than half"),
    ],
    "vague": [
        ({"lifts": (lift(-1, sigma=0.124 * DEPTH), lift(2))}, None),
        (
            {"lifts": (lift(-1, sigma=0.129 * DEPTH), lift(2))},
            f"the depth of the cuts at [base] is known to ± {1e3 * Z95 * 0.129 * DEPTH:.2g} mm only",
        ),
    ],
    "tilted": [
        ({"lifts": (lift(-1, slopes=(0.004, 0.0029)), lift(2))}, None),  # 3 mm/m, and twice their 1 mm/m
        (
            {"lifts": (lift(-1, slopes=(0.004, 0.0031)), lift(2))},
            "the program is tilted by 5.1 mm/m against the uncut top at [base]",
        ),
    ],
    "vague tilt": [
        ({"lifts": (lift(-1, tilt_sigma=4.99e-3), lift(2))}, None),
        (
            {"lifts": (lift(-1, tilt_sigma=5.1e-3), lift(2))},
            "2 features so close together are too few at [base]: how the program is tilted against the uncut top is "
            "known to ± 10 mm/m only",
        ),
        ({"lifts": (lift(-1), lift(2, tilt_sigma=5.1e-3))}, "one feature is too few at [base_data.2]: how the program"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(("fields", "reason"), [case for cases in CASES.values() for case in cases])
def test_a_fit_is_refused_beyond_each_limit_with_its_reason(fields, reason):
    """Depths are those of cuts that are thick next to these tilts: 6 mm/m over 0.2 m are less than half of one."""
    flat = replace(READINGS, tops=tuple(replace(top, origin=top.origin + HIGH) for top in READINGS.tops))
    fields = dict(fields)
    if any(np.any(each.coefficients[1:]) for each in fields.get("lifts", ())):
        fields["readings"] = flat
    refused, line = verdict(**fields)
    assert refused == (reason is not None)
    if reason:
        assert line.startswith("NOT TO BE TRUSTED: ")
        assert reason in line


@pytest.mark.parametrize(
    ("outliers", "words"),
    [
        (("F01.left",), "F01.left contradicts the other points"),
        (("F01.left", "F02.left"), "F01.left, F02.left contradict the"),
    ],
)  # fmt: skip
def test_points_left_out_are_the_reason_before_all_others_of_the_model(outliers, words):
    refused, line = verdict(outliers, gamma=0.5)
    assert refused
    assert words in line
    assert f"outlier: {outliers[0]}" in model.summary(fitted(), outliers).warnings


@pytest.mark.parametrize(("misfit", "is_contradictory"), [(3.9, False), (4.1, True)])
def test_touch_off_points_on_no_plane_come_first(misfit, is_contradictory):
    tops = (replace(READINGS.tops[0], misfit=misfit), READINGS.tops[1])
    refused, line = verdict(("F01.left",), readings=replace(READINGS, tops=tops))
    assert refused
    names = ", ".join(f"T{k:02d}.top" for k in range(1, 5))
    assert (f"the touch-off points {names} are on no plane" in line) == is_contradictory


@pytest.mark.parametrize(
    ("height", "sigma", "is_named"),
    [
        (1.01e-4, 1e-6, True), (0.99e-4, 1e-6, False), (-1.01e-4, 1e-6, True), (3.8e-4, 2e-4, False),
        (4.1e-4, 2e-4, True),
    ],
)  # fmt: skip
def test_a_lift_is_worth_a_remark_beyond_a_tenth_of_a_millimetre_and_its_own_interval(height, sigma, is_named):
    readings = replace(READINGS, tops=tuple(replace(top, origin=top.origin + HIGH) for top in READINGS.tops))
    found = model.summary(fitted(readings=readings, lifts=(lift(-1), lift(2, height, sigma=sigma))), ())
    way = "high" if height > 0.0 else "low"
    words = f"the program ran {1e3 * abs(height):.2f} mm too {way} over the block at [base_data.2] (± "
    assert [words in text for text in found.warnings] == [True] * is_named
    (first, second) = found.touch_off
    assert (first.frame, second.frame) == ("[base]", "[base_data.2]")
    assert second.lift_mm == pytest.approx(1e3 * height, abs=1e-4)
    assert second.ci95 == pytest.approx(1e3 * Z95 * sigma, abs=1e-4)
    assert second.points == [f"T{k:02d}.top" for k in range(5, 9)]


def test_the_tilt_is_that_of_both_slopes_and_three_points_cannot_be_checked():
    top = Top(-1, ("T01.top", "T02.top", "T03.top"), np.zeros(3), np.zeros(3), np.eye(3), 0.0)
    readings = replace(READINGS, tops=(top, READINGS.tops[1]))
    found = model.summary(fitted(readings=readings, lifts=(lift(-1, slopes=(0.0003, -0.0004)), lift(2))), ())
    assert [error.tilt_mm_per_m for error in found.touch_off] == [0.5, 0.0]
    assert [text for text in found.warnings if "cannot be checked" in text] == [
        "three touch-off points at [base] cannot be checked against each other: probe a fourth"
    ]


def test_the_table_of_points_has_what_was_measured_and_predicted_with_the_place_of_the_part():
    fit = fitted(gamma=0.010049)
    found = model.summary(fit, ())
    datum = READINGS.datum
    assert np.abs(datum[:7]).min() > 0.0
    for n, point in enumerate(found.points):
        assert point.feature == NAMES[n]
        values = (
            READINGS.probed.deviation[n] + datum[n],
            2e-5 + datum[n],
            READINGS.probed.deviation[n] + 1e-6 + datum[n],
        )
        np.testing.assert_allclose(
            (point.measured_mm, point.before_mm, point.after_mm, point.error_mm, point.sigma_mm),
            1e3 * np.array([*values, 4e-6, 6e-6]), atol=1e-5,
        )  # fmt: skip
    assert found.left_mm == pytest.approx(1e-3)
    deviation = READINGS.probed.deviation
    assert found.deviation_mm == pytest.approx(1e3 * np.sqrt(np.mean(deviation**2)), abs=1e-5)
    assert found.without_mm == pytest.approx(1e3 * np.sqrt(np.mean((2e-5 - deviation) ** 2)), abs=1e-5)
    assert (found.sigma_mm, found.unmodelled_percent) == (5e-3, 1.0)  # of 1.0049 %
    for level, bound, entry in zip(*fit.u95(), found.discrepancy, strict=True):
        assert entry.load_N == level
        assert entry.u95_mm == pytest.approx(1e3 * bound)
        assert (entry.held_out_mm, entry.noise_mm, entry.own_mm) == pytest.approx((4e-3, 5e-3, 6e-3))


def test_parameters_that_are_held_have_the_value_of_the_prior():
    """Compliances in files are as large as the prior's plus the change; the scale has its own interval."""
    z = 0.3 * PRIOR.sigma[:-1]
    free = np.ones(SIZE + 1, dtype=bool)
    free[2] = False
    z[2] = 0.0
    found = model.summary(fitted(z=z, free=free, scale=1.05), ())
    assert found.held_by_prior == [PRIOR.parameters[2].name]
    assert found.warnings[0] == f"the part does not determine {PRIOR.parameters[2].name}: they keep their prior"
    for k, parameter in enumerate(PRIOR.parameters):
        entry = found.parameters[parameter.name]
        assert entry.value == pytest.approx(PRIOR.values[k] + z[k])
        assert entry.ci95 == pytest.approx(Z95 * 0.5 * PRIOR.sigma[k])
        assert (entry.unit, entry.observable, entry.source) == (parameter.unit, k != 2, "prior" if k == 2 else None)
        assert entry.prior == pytest.approx(PRIOR.values[k])
    scale = found.force_scale
    assert (scale.value, scale.unit, scale.prior, scale.observable) == (1.05, "1", 1.0, True)
    assert scale.ci95 == pytest.approx(Z95 * 0.05)
    vague = model.summary(fitted(covariance=np.diag((0.91 * PRIOR.sigma) ** 2)), ())
    assert not vague.force_scale.observable


CHI2_LIMIT = COUNT + 3.29 * np.sqrt(2.0 * COUNT) + 7.0


def agreed(monkeypatch, outliers=(), prior=PRIOR, **fields):
    values = {
        "chi2": 5.0,
        "no_change_probability": 0.5,
        "change": np.zeros(SIZE + 1),
        "spread": np.ones(SIZE + 1),
    } | fields
    monkeypatch.setattr(fitting.Fit, "compare_with_prior", lambda self, given: PriorComparison(**values))
    return model.agreement(fitted(), prior, outliers)


@pytest.mark.parametrize(
    ("chi2", "chance", "outliers", "holds"),
    [(CHI2_LIMIT - 0.1, 0.006, (), True), (CHI2_LIMIT + 0.1, 0.5, (), False), (5.0, 0.004, (), False),
     (5.0, 0.5, ("F01.left",), False)],
)  # fmt: skip
def test_a_model_holds_if_neither_the_readings_nor_one_change_speak_against_it(
    monkeypatch, chi2, chance, outliers, holds
):
    found = agreed(monkeypatch, outliers, chi2=chi2, no_change_probability=chance)
    assert found.holds == holds
    assert (found.chi2, found.points, found.chance) == (round(chi2, 2), COUNT, chance)
    assert found.line.startswith(f"χ² {chi2:.0f} of {COUNT} points (at most {CHI2_LIMIT:.0f})")
    assert ("deflects otherwise" in found.line) == (chance < 0.005)
    assert bool(found.fault) == bool(outliers)


def test_changes_are_named_by_their_factor_beyond_three_standard_deviations(monkeypatch):
    """Factors are never below a fiftieth; the scale of the forces is no parameter that changes."""
    values = PRIOR.values
    change = np.append(np.array([0.31, 0.29, -0.99, *np.zeros(SIZE - 3)]) * values, 9.0)
    spread = np.append(0.1 * values, 1e-3)
    found = agreed(monkeypatch, no_change_probability=1e-3, change=change, spread=spread)
    names = [PRIOR.parameters[k].name for k in (0, 2)]
    assert [(entry.name, entry.factor, entry.sigmas) for entry in found.drifted] == [
        (names[0], 1.31, 3.1), (names[1], 0.02, -9.9),
    ]  # fmt: skip
    assert found.line.endswith(f"; the arm deflects otherwise under these forces: {names[0]} × 1.31, {names[1]} × 0.02")
    assert agreed(monkeypatch, no_change_probability=0.5, change=change, spread=spread).drifted == []
    none = agreed(monkeypatch, no_change_probability=1e-3)
    assert none.line.endswith(": no single joint")


def test_a_comparison_warns_where_forces_and_compliances_were_not_identified_together(monkeypatch):
    (warning,) = agreed(monkeypatch).warnings
    assert warning.startswith("the model was not identified with these forces")
    covariance = PRIOR.covariance.copy()
    covariance[-1, 0] = covariance[0, -1] = -1e-3
    assert agreed(monkeypatch, prior=replace(PRIOR, covariance=covariance)).warnings == []
    certain = PRIOR.covariance.copy()
    certain[-1, -1] = 0.0
    assert agreed(monkeypatch, prior=replace(PRIOR, covariance=certain)).warnings == []


@pytest.mark.parametrize("law", ["linear", "kienzle"])
def test_material_has_the_law_of_the_process_with_its_forces_scaled(tmp_path, law):
    """Coefficients times the scale; their spread is that of the scale relative to its value."""
    text = trial.process_text(((0, 110), (0, 90), (-30, 0)), 0.5)
    if law == "kienzle":
        numbers = "kc11_N_per_mm2 = 900\nmc = 0.27\nradial_ratio = 0.4\naxial_ratio = 0.2"
        text = text.replace('name = "al_7075_t6_carbide"', numbers)
    (tmp_path / "process.toml").write_text(text)
    process = machining.load(tmp_path / "process.toml")
    covariance = np.diag(np.append(np.ones(SIZE), 0.06**2))
    fit = fitted(scale=1.2, covariance=covariance)
    table = tomllib.loads(model.material(fit, process, "part").decode())["material"]
    assert table["sigma_percent"] == 5.0
    assert table["source"].endswith("forces scaled by 1.200: part")
    entry = model._forces_entry(fit, process, "part")
    if law == "kienzle":
        assert table["kc11_N_per_mm2"] == pytest.approx(1080.0)
        assert (table["mc"], table["radial_ratio"], table["axial_ratio"]) == pytest.approx((0.27, 0.4, 0.2))
        expected = 1.2 * 900.0 * np.array([1.0, 0.4, 0.2]), np.zeros(3)
    else:
        keys = ("Ktc_N_per_mm2", "Krc_N_per_mm2", "Kac_N_per_mm2", "Kte_N_per_mm", "Kre_N_per_mm", "Kae_N_per_mm")
        cutting = process.law()
        expected = 1.2e-6 * np.array(cutting.cutting), 1.2e-3 * np.array(cutting.edge)
        np.testing.assert_allclose([table[key] for key in keys], np.concatenate(expected))
    np.testing.assert_allclose(entry.cutting_N_per_mm2, expected[0])
    np.testing.assert_allclose(entry.edge_N_per_mm, expected[1], atol=1e-12)
    assert (entry.mc, entry.sigma_percent) == ((0.27 if law == "kienzle" else 0.0), 5.0)
    certain = fitted(covariance=np.diag(np.append(np.ones(SIZE), 0.0)))
    assert model._forces_entry(certain, process, "part") is None


def test_the_unmodelled_error_is_the_larger_one_of_the_part_and_the_model_before():
    load, bound = fitted().u95()
    before = Discrepancy(np.array([10.0, 150.0, 1000.0]), np.array([1e-6, 2e-6, 5e-3]))
    robot = SimpleNamespace(discrepancy=before)
    both = fitted(prior=SimpleNamespace(robot=robot, covariance=PRIOR.covariance))
    loads, u95 = model._discrepancy(both)
    assert loads.tolist() == sorted({*load.tolist(), 10.0, 150.0, 1000.0})
    for level, value in zip(loads, u95, strict=True):
        of_part = np.interp(level, load, bound) * max(level / load[-1], 1.0)
        assert value == pytest.approx(max(of_part, np.interp(level, before.load, before.u95)))


@pytest.fixture(scope="module")
def process(tmp_path_factory):
    path = tmp_path_factory.mktemp("process") / "process.toml"
    path.write_text(trial.process_text(((0, 110), (0, 90), (-30, 0)), 0.5))
    return machining.load(path)


def test_the_model_file_has_what_the_part_determines_and_the_rest_of_the_prior(process):
    """Held parameters with a spread of the file stay as they are, unless they are known together with others."""
    free = np.ones(SIZE + 1, dtype=bool)
    free[[4, 5]] = False
    covariance = np.diag((0.5 * PRIOR.sigma) ** 2)
    sigma = np.sqrt(np.diag(covariance))
    covariance[4, 0] = covariance[0, 4] = 0.02 * sigma[0] * sigma[4]
    covariance[5, 0] = covariance[0, 5] = 0.005 * sigma[0] * sigma[5]
    z = 0.2 * PRIOR.sigma[:-1] * free[:-1]
    fit = fitted(z=z, free=free, covariance=covariance, scale=1.0)
    content = trial.content()
    found = model.model_file(fit, content, process, "a part")
    for k, joint in enumerate(trial.JOINTS):
        entry, before = found.joints[joint], content.joints[joint]
        if k in (4, 5):
            assert entry.compliance_urad_per_Nm == before.compliance_urad_per_Nm
            assert entry.source == before.source
            continue
        assert entry.compliance_urad_per_Nm == pytest.approx(PRIOR.values[k] + z[k])
        assert (entry.source, entry.sigma_percent, entry.assumed) == ("a part", None, False)
        assert entry.ci95 == pytest.approx(Z95 * 0.5 * PRIOR.sigma[k])
    stiffness = found.compensator.stiffness_N_per_m
    assert stiffness == pytest.approx(PRIOR.values[6] + z[6])
    assert found.compensator.free_length_mm == content.compensator.free_length_mm
    names = [parameter.name for k, parameter in enumerate(PRIOR.parameters) if k != 5]
    assert found.covariance.parameters == [*names, "forces"]
    rows = [k for k in range(SIZE + 1) if k != 5]
    np.testing.assert_allclose(found.covariance.square, covariance[np.ix_(rows, rows)])
    assert found.measured.configurations == 4  # features and the gauge
    assert found.measured.torque_Nm == (0.0, 100.0, 200.0, 300.0, 400.0, 500.0)
    assert found.discrepancy.u95_mm == pytest.approx((1e3 * fit.u95()[1]).tolist())
    assert found.discrepancy.load_N == fit.u95()[0].tolist()


def test_the_model_file_adds_to_what_was_measured_before(process):
    torque = np.array([250.0, 10, 10, 10, 10, 900])
    measured = SimpleNamespace(torque=torque)
    robot = replace(ROBOT, measured=measured)
    prior = replace(PRIOR, robot=robot)
    earlier = MeasuredEntry(source="tracker", configurations=15, torque_Nm=tuple(torque.tolist()), not_trusted="")
    found = model.model_file(fitted(prior=prior), replace(trial.content(), measured=earlier), process, "a part")
    assert found.measured.configurations == 19
    assert found.measured.torque_Nm == (250.0, 100.0, 200.0, 300.0, 400.0, 900.0)
