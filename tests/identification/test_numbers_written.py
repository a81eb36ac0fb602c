"""Numbers of identification.json and model.toml: those of the identification, in the units that their keys name."""

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import astuple, replace

from postproc import robot
from postproc.errors import MeasurementError
from postproc.files import check_sizes
from postproc.identification import model_folder, procedure, readings
from postproc.identification.fit import FACTORS
from postproc.identification.joint_springs import SpringOfJoint2
from postproc.identification.procedure import identify
from postproc.robot import JOINT_COMPLIANCES
from samples.paper_study import harness, simulator
from tests.identification.test_joint_springs import ARM


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Joint springs and compensator from 15 configurations."""
    rng = np.random.default_rng(3)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 15)
    true.gear.k = 1.0 / simulator.PAPER_K
    _, raw = simulator.measure(true, q, f, rng)
    folder = simulator.write(tmp_path_factory.mktemp("readings"), q, f, raw)
    return identify(harness.PRIOR, harness.load(folder), depth="joints")


def test_residuals_are_in_millimetres_by_configuration_and_together(result):
    written = model_folder.report_data(result).residual
    left = np.linalg.norm(result.fit.residual, axis=2) * 1e3  # one load: a row for each configuration
    data, placement = result.data, result.placement
    mean = np.zeros((len(data.load), len(data.points), 3))
    for state, point in np.ndindex(mean.shape[:2]):
        mean[state, point] = data.position[(data.state == state) & (data.point == point) & data.used].mean(axis=0)
    unloaded = [np.flatnonzero((data.state_config == c) & (data.load == 0.0))[0] for c in range(15)]
    loaded = [np.flatnonzero((data.state_config == c) & (data.load > 0.0))[0] for c in range(15)]
    moved = np.linalg.norm(mean[loaded] - mean[unloaded], axis=2) * 1e3
    assert placement.residual.shape[1] == 3
    assert written.rms_mm == pytest.approx(np.sqrt(np.mean(left**2)))
    assert written.max_mm == pytest.approx(left.max())
    assert written.before_rms_mm == pytest.approx(np.sqrt(np.mean(moved**2)))
    assert (written.chi2, written.degrees_of_freedom) == (result.fit.chi2, 15 * 9 - 8)
    for row, number in zip(written.per_configuration, range(15), strict=True):
        assert row.config == data.config[number]
        assert row.before_mm == pytest.approx(np.sqrt(np.mean(moved[number] ** 2)))
        assert row.after_mm == pytest.approx(np.sqrt(np.mean(left[number] ** 2)))
    assert 0.3 < written.before_rms_mm < 10.0


def test_states_torques_and_unmodelled_errors_are_those_of_the_readings(result):
    written, data = model_folder.report_data(result), result.data
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    torque = []
    for state in np.flatnonzero(data.load > 0.0):
        q, wrench = data.q[data.state_config[state]], data.wrench[state]
        torque.append(np.abs(ARM.gradient(lambda x, w=wrench: w[:3] @ ARM.tcp(x, tool)[:3, 3], q)))
        row = written.states[len(torque) - 1]
        np.testing.assert_allclose(row.joints_deg, np.degrees(q), atol=1e-6)
        assert row.load == pytest.approx(wrench.tolist())
    np.testing.assert_allclose(written.torque_Nm, np.max(torque, axis=0), rtol=1e-5, atol=1e-6)
    (level,) = written.discrepancy
    (load,) = result.discrepancy.load
    assert load == pytest.approx(np.median(np.linalg.norm(data.wrench[data.load > 0.0], axis=1)))
    lengths = [1e3 * getattr(result.discrepancy, name)[0] for name in ("held_out", "noise", "parameter_error", "u95")]
    assert list(astuple(level)) == pytest.approx([load, *lengths])
    assert written.sigma_mm == pytest.approx(1e3 * data.sigma)
    assert written.unloaded_rms_mm == pytest.approx(
        1e3 * np.sqrt(np.mean(np.sum(result.placement.residual**2, axis=2)))
    )
    for row, space in zip(written.workspace, result.workspace.levels, strict=True):
        lengths = 1e3 * space.deflection, 1e3 * space.bound
        assert astuple(row) == pytest.approx((space.load, *lengths, space.bound_ratio, space.chance))


def test_what_readings_do_not_show_of_gears_is_named_as_assumed(result):
    shown = replace(result, discrepancy=replace(result.discrepancy, return_bound=2e-5))
    written = model_folder.report_data(shown)
    assert (written.return_u95_mm, written.assumptions) == (pytest.approx(0.02), [])
    written = model_folder.report_data(replace(result, discrepancy=replace(result.discrepancy, return_bound=None)))
    assert written.return_u95_mm is None
    assert written.assumptions[0].startswith("the gears have no hysteresis: only readings without load before, between")


def test_parameters_have_values_two_sided_intervals_and_those_of_the_prior(result):
    written = model_folder.report_data(result)
    sigma = np.sqrt(np.diag(result.fit.covariance))
    names = [parameter.name for parameter in result.fit.structure.parameters]
    for joint in JOINT_COMPLIANCES:
        entry, row = written.parameters[joint.name], names.index(joint.name)
        assert entry.unit == "urad/(N·m)"
        assert entry.value == pytest.approx(1e6 * result.fit.values[row])
        assert entry.prior == pytest.approx(1e6 * harness.PRIOR.compliance[row])
        assert (entry.observable, entry.determined) == (True, True)
        assert entry.ci95 == pytest.approx(1.96 * 1e6 * sigma[row], rel=1e-4)
    k2, stiffness = written.parameters["k2"], written.parameters["K_theta2_0"]
    # a stiffness is one over a compliance, and relatively as uncertain
    assert stiffness.value == pytest.approx(1e6 / k2.value)
    assert stiffness.ci95 / stiffness.value == pytest.approx(k2.ci95 / k2.value)
    assert stiffness.prior == pytest.approx(1e6 / k2.prior)
    assert list(written.parameters)[:8] == ["k1", "k2", "k3", "k4", "k5", "k6", "K_theta2_0", "K_c"]
    correlation = np.array(written.correlation.matrix)
    assert written.correlation.names == names
    np.testing.assert_allclose(np.diag(correlation), 1.0)
    a, b = names.index("k1"), names.index("k3")
    assert correlation[a, b] == pytest.approx(result.fit.covariance[a, b] / sigma[a] / sigma[b], abs=1e-4)


def test_the_curve_of_joint_2_is_that_of_gear_and_compensator_by_differences_of_its_energy(result):
    written, model = model_folder.report_data(result), result.robot()
    law, gear = model.compensator, 1.0 / model.compliance[1]
    q2 = np.radians([angle for angle, _ in written.k2_curve])
    assert (q2[0], q2[-1]) == pytest.approx((result.levels.q2.min(), result.levels.q2.max()))

    def energy(angle):
        a, side = np.hypot(law.ax, law.ay), np.arctan2(law.ay, law.ax) - angle
        length = np.sqrt(a**2 + law.L**2 + 2.0 * a * law.L * np.cos(side))
        return 0.5 * law.stiffness * (length - law.free_length) ** 2

    h = 1e-4
    for angle, (_, compliance) in zip(q2, written.k2_curve, strict=True):
        spring = (energy(angle + h) - 2.0 * energy(angle) + energy(angle - h)) / h**2
        assert compliance == pytest.approx(1e6 / (gear + spring), rel=1e-5)
    without = SimpleNamespace(levels=result.levels, robot=lambda: replace(model, compensator=None))
    np.testing.assert_allclose([c for _, c in model_folder._k2_curve(without)], 1e6 / gear)
    assert model_folder._k2_curve(SimpleNamespace(levels=None)) == []


def test_the_spring_of_joint_2_from_levels_has_two_sided_intervals():
    spring = SpringOfJoint2(np.array([4e6, 8e4, 3e4]), np.diag([1e10, 4e6, 9e4]))
    written = model_folder._spring_records(spring)
    assert list(written) == ["K_theta2_0", "K_c", "K_c*s_0"]
    for entry, value, sigma in zip(written.values(), (4e6, 8e4, 3e4), (1e5, 2e3, 300.0), strict=True):
        assert list(astuple(entry)) == pytest.approx([value, 1.96 * sigma], rel=1e-4)
    assert model_folder._spring_records(None) is None


def test_what_is_not_identified_keeps_the_prior_in_both_files(result):
    content = model_folder.read_prior(robot.find("kuka_kr270"), None, "")
    missing = (SimpleNamespace(parameter=JOINT_COMPLIANCES[3], name="k4", reason="why", advice="what"),)
    part = replace(result, missing=missing)
    written = model_folder.report_data(part)
    entry = written.parameters["k4"]
    assert (entry.ci95, entry.observable, entry.source) == (None, False, "prior")
    assert entry.value == entry.prior == pytest.approx(1e6 * harness.PRIOR.compliance[3])
    assert [(row.name, row.reason, row.advice) for row in written.not_observable] == [("k4", "why", "what")]
    file = model_folder.model_file(part, content, "r.csv", None)
    for joint in JOINT_COMPLIANCES:
        spring = file.joints[joint.joint]
        if joint is JOINT_COMPLIANCES[3]:
            assert spring.compliance_urad_per_Nm == content.joints["A4"].compliance_urad_per_Nm
            assert spring.sigma_percent == content.joints["A4"].sigma_percent
            assert spring.assumed
            assert spring.source == f"prior, not observable in r.csv: {content.joints['A4'].source}"
        else:
            value = 1e6 * result.fit.values[JOINT_COMPLIANCES.index(joint)]
            assert spring.compliance_urad_per_Nm == pytest.approx(value)
            assert not spring.assumed
    assert "k4" not in file.covariance.parameters
    assert file.discrepancy.u95_mm == pytest.approx((1e3 * result.discrepancy.u95).tolist())
    assert file.discrepancy.load_N == result.discrepancy.load.tolist()
    assert file.measured.configurations == 15
    np.testing.assert_allclose(file.measured.torque_Nm, written.torque_Nm)
    whole = model_folder.model_file(result, content, "r.csv", None)
    rows = [whole.covariance.parameters.index(name) for name in ("k3", "k4")]
    sigma = [np.sqrt(result.fit.covariance[i, i]) * 1e6 for i in (2, 3)]
    np.testing.assert_allclose([whole.covariance.matrix[row][row] ** 0.5 for row in rows], sigma, rtol=1e-4)


def test_parts_that_hardly_move_are_expected_to_be_the_stiffer_ones():
    """Foundations are stiffer than links, and ends of links and breakpoints add to what links and gears do already."""
    size = {kind: middle for kind, (middle, _) in FACTORS.items()}
    assert size["base rotation"] < size["end rotation"] < size["link rotation"]
    assert size["base translation"] < size["link translation"]
    assert size["breakpoint"] < size["fading"]
    assert size["backlash"] == size["lost motion"] < 0.0
    assert size["joint"] == 0.0  # about what the robot states
    assert all(width >= np.log(2.0) for _, width in FACTORS.values()), "known to a factor of two at best"


@pytest.mark.parametrize(
    ("worth_a_look", "hidden", "unexplained", "better", "tried", "taken"),
    [
        (False, False, False, True, False, False),
        (True, False, False, False, True, False),
        (True, False, False, True, True, True),
        (False, True, False, False, True, True),
        (True, False, True, False, True, True),
    ],
)
def test_richer_structures_are_taken_for_their_evidence_or_where_noise_or_a_misfit_calls_for_them(
    result, worth_a_look, hidden, unexplained, better, tried, taken, monkeypatch
):
    class TakenError(Exception):
        """The richer structure was taken."""

    calls = []

    def choose(_prior, data, _placement):
        calls.append(data)
        return data, SimpleNamespace(fit=result.fit), ["reading 7"]

    def refuse(*_):
        raise TakenError

    monkeypatch.setattr(procedure, "_fit_joints_and_placement", lambda _, data, placement: (
        SimpleNamespace(fit=result.fit, missing=[], levels=None, spring=None), data, placement, []))  # fmt: skip
    monkeypatch.setattr(procedure, "_choose_springs", choose)
    monkeypatch.setattr(procedure, "_has_possible_error", lambda _: worth_a_look)
    monkeypatch.setattr(procedure, "_would_hide_link_springs", lambda _: hidden)
    monkeypatch.setattr(procedure, "_has_unexplained_error", lambda _: unexplained)
    monkeypatch.setattr(procedure, "_has_clear_evidence", lambda *_: better)
    monkeypatch.setattr(procedure, "_undetermined_springs", refuse)
    if taken:
        with pytest.raises(TakenError):
            identify(harness.PRIOR, result.data)
    else:
        found = identify(harness.PRIOR, result.data)
        assert found.choice is None
        assert found.left_out == ()  # nor are the readings left out that do not fit it
        np.testing.assert_array_equal(found.fit.values, result.fit.values)
    assert len(calls) == tried


@pytest.mark.parametrize(("factor", "refused"), [(0.9, False), (1.1, True)])
@pytest.mark.parametrize("column", ["X", "Fz", "Mx", "A3", "load"])
def test_cells_beyond_a_kilometre_a_meganewton_or_ten_turns_are_refused(result, tmp_path, column, factor, refused):
    limit = {"X": 1e6, "Fz": 1e6, "Mx": 1e6, "A3": 3600.0, "load": 1e9}[column]
    numbers = {name: np.full(2, -factor * limit if name == column else 0.0) for name in ("X", "Fz", "Mx", "A3", "load")}
    whole = {name: numbers.get(name, np.zeros(2)) for name, *_ in readings._LARGEST}
    if refused:
        with pytest.raises(MeasurementError, match=column):
            check_sizes(tmp_path / "m.csv", whole, np.array([2, 3]), readings._LARGEST, MeasurementError)
    else:
        check_sizes(tmp_path / "m.csv", whole, np.array([2, 3]), readings._LARGEST, MeasurementError)
