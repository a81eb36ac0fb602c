"""Inputs that cannot be used and fits that go astray: what is said, and what is done instead."""

import json

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.compensator import Compensator
from postproc.errors import InputError, MeasurementError, NotConvergedError, PostprocError
from postproc.identification import (
    compensator_geometry,
    dataset,
    fit,
    joint_springs,
    measurement_model,
    model_folder,
    plausibility,
    record,
    uncertainty,
)
from postproc.identification.compensator_geometry import MarkerReadings
from postproc.identification.measurement_model import LevelCompliance, Structure
from postproc.identification.procedure import CheckedReadings
from postproc.identification.validation import JobShare, ValidatedLevel, Validation, coverage
from postproc.robot import JOINT_COMPLIANCES
from samples.paper_study import harness, simulator
from tests.identification.test_joint_springs import POINTS, SPRINGS, forces, placed, readings
from tests.identification.test_judgement import fit_of


def markers(q2, p1, p0):
    count = len(q2)
    return MarkerReadings(
        q2=q2, markers=tuple(f"P0{n + 1}" for n in range(len(p0))), p1=p1, p0=p0, count_p1=np.ones(count),
        count_p0=np.ones((len(p0), count)), scatter=0.0, scatter_dof=0,
    )  # fmt: skip


def mechanism(value, q2, radius=0.12):
    """P1 and two markers of a compensator with L, a_x, a_y, in the plane of the device."""
    p1 = value[0] * np.exp(1j * q2)
    pivot = -(value[1] + 1j * value[2])
    spring = (p1 - pivot) / np.abs(p1 - pivot)
    planes = [p1, *(pivot + radius * spring * np.exp(1j * beta) for beta in (0.0, 1.5))]
    p1, *p0 = (np.column_stack([plane.real, plane.imag, 0.0 * plane.real]) for plane in planes)
    return p1, np.array(p0)


def test_a_compensator_whose_pivot_is_inside_the_circle_of_its_end_is_refused():
    q2 = np.radians([0.0, -30.0, -60.0, -90.0, -120.0])
    outside, inside = np.array([0.18, 0.6, 0.1]), np.array([0.18, 0.15, 0.05])
    found = compensator_geometry.identify(markers(q2, *mechanism(outside, q2)))
    np.testing.assert_allclose(found.lengths, outside, atol=1e-9)
    with pytest.raises(MeasurementError, match=r"P0 comes out 158.1 mm from P2, inside the circle of P1 \(180.0 mm\)"):
        compensator_geometry.identify(markers(q2, *mechanism(inside, q2)))


def test_markers_on_a_straight_line_have_no_centre():
    line = np.linspace(0.0, 1.0, 5)[:, None] * [1.0, 2.0, -1.0]
    with pytest.raises(MeasurementError, match="moved along a straight line"):
        compensator_geometry.swivel_axis(np.array([line, line + np.array([0.0, 0.0, 1.0])]))


def test_a_folder_is_no_file_to_write_to(tmp_path):
    with pytest.raises(InputError, match="is a folder"):
        compensator_geometry.save(tmp_path, None, "")


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        dataset.check(tmp_path / "absent")


def test_doubts_of_readings_are_listed_as_faults_of_a_folder(monkeypatch):
    data = readings(forces(3), count=3)
    checked = CheckedReadings(data, None, ["line 7"], ["all points move", "gap"], "forces turned")
    monkeypatch.setattr(dataset, "check_readings", lambda *_: checked)
    monkeypatch.setattr(dataset, "gaps", lambda _: ["gap"])
    found = dataset._agreement_findings(harness.PRIOR, data)
    assert [(finding.text, finding.is_present) for finding in found] == [
        ("outlier: line 7", False),
        ("forces turned", False),
        ("all points move", False),
    ]


def stub_of(residual_of, slope_of):
    """A model with one parameter x that moves all points along X by `residual_of`(x)."""

    def predict(structure, values, data, placement):
        x = float(values[0])
        value, slope = residual_of(x), slope_of(x)
        if not np.isfinite(value):
            raise NotConvergedError("no equilibrium", np.array([0]))
        moved = np.zeros((len(data.loaded_states), len(data.points), 3))
        moved[..., 0] = value
        slopes = np.zeros((*moved.shape, 1))
        slopes[..., 0, 0] = slope
        return moved, slopes

    return predict


def test_a_step_too_far_is_halved_until_the_squares_fall_again(monkeypatch):
    """Newton for the cube root of x goes from x to −2x and grows; half of that step ends at −x/2."""
    data = readings(forces(3), count=3)
    monkeypatch.setattr(measurement_model, "measured_displacements", lambda data, _: np.zeros((3, 4, 3)))
    structure = Structure(JOINT_COMPLIANCES[:1], harness.PRIOR)

    def slope(x):
        return np.abs(x) ** (-2.0 / 3.0) / 3.0

    for begin in (1.0, -3.0):
        monkeypatch.setattr(fit, "predict", stub_of(np.cbrt, slope))
        found = fit.gauss_newton(structure, data, placed(data), start=np.array([begin]))
        assert abs(found.values[0]) < 1e-2 * abs(begin)
    # where there is no equilibrium a step is halved too; at the start that is an error
    monkeypatch.setattr(fit, "predict", stub_of(lambda x: np.cbrt(x) if abs(x) < 4.0 else np.nan, slope))
    found = fit.gauss_newton(structure, data, placed(data), start=np.array([3.0]))
    assert abs(found.values[0]) < 3e-2
    with pytest.raises(NotConvergedError):
        fit.gauss_newton(structure, data, placed(data), start=np.array([10.0]))


def test_a_start_far_off_is_given_up_for_the_prior(monkeypatch):
    tried = []

    def gauss_newton(structure, data, placement, start=None, iterations=25):
        tried.append((start, iterations))
        if start is not None:
            raise NotConvergedError("no equilibrium", np.array([0]))
        return "fit"

    monkeypatch.setattr(joint_springs, "gauss_newton", gauss_newton)
    assert joint_springs._attempt(None, None, None, "values") == "fit"
    assert tried == [("values", 25), (None, 2)]
    data = readings(forces(6), count=6)
    assert joint_springs.extended_set(harness.PRIOR, data, placed(data)) is None


def test_derivatives_without_a_number_name_the_load(monkeypatch):
    data = readings(forces(4), count=4)

    def predict(*_):
        moved, slopes = np.zeros((4, 4, 3)), np.zeros((4, 4, 3, 6))
        slopes[2, 1, 0, 3] = np.nan
        return moved, slopes

    monkeypatch.setattr(fit, "predict", predict)
    with pytest.raises(PostprocError, match="config 3, load 1: these springs have no equilibrium under this load"):
        fit.linearise(Structure(JOINT_COMPLIANCES, harness.PRIOR), SPRINGS, data, placed(data))


def test_values_without_a_finite_variance_are_not_written():
    data = readings(forces(4), count=4)
    covariance = np.diag((0.02 * SPRINGS) ** 2)
    covariance[3, 3] = np.inf
    with pytest.raises(MeasurementError, match="no finite value or variance for k4"):
        fit.to_file_units(fit_of(data, covariance=covariance))


def test_levels_of_one_angle_do_not_show_a_compensator():
    law = Compensator(stiffness=8e4, free_length=0.45, L=0.184, ax=0.685, ay=0.12)
    same = joint_springs.Levels(np.full(4, -1.0), np.full(4, 2e-7), np.eye(4) * 1e-18)
    assert joint_springs.compensator_from_levels(same, law) is None
    assert LevelCompliance("A2", 3).name == "k2#3"


def test_the_uncertainty_of_a_missing_joint_is_half_its_value_if_none_is_stated():
    bare = replace(harness.PRIOR, covariance=None)
    assert joint_springs.prior_spread(bare, JOINT_COMPLIANCES[2]) == pytest.approx(0.5 * bare.compliance[2])
    stated = robot.Covariance(JOINT_COMPLIANCES[:2], np.diag([4.0, 9.0]) * 1e-4)
    known = replace(harness.PRIOR, covariance=stated)
    assert joint_springs.prior_spread(known, JOINT_COMPLIANCES[1]) == pytest.approx(0.03e-6)
    assert joint_springs.prior_spread(known, JOINT_COMPLIANCES[2]) == pytest.approx(0.5 * bare.compliance[2])


def test_a_compensator_of_markers_replaces_the_geometry_alone(tmp_path):
    q2 = np.radians([0.0, -30.0, -60.0, -90.0, -120.0])
    value = np.array([0.18, 0.6, 0.1])
    compensator_geometry.save(
        tmp_path / "c.toml", compensator_geometry.identify(markers(q2, *mechanism(value, q2))), "x"
    )
    found = model_folder.with_compensator_geometry(harness.PRIOR, tmp_path / "c.toml").compensator
    old = harness.PRIOR.compensator
    assert (found.L, found.ax, found.ay) == pytest.approx(tuple(value))
    assert (found.stiffness, found.free_length) == (old.stiffness, old.free_length)
    bare = model_folder.with_compensator_geometry(replace(harness.PRIOR, compensator=None), tmp_path / "c.toml")
    assert (bare.compensator.stiffness, bare.compensator.free_length, bare.compensator.L) == pytest.approx((0, 0, 0.18))


@pytest.mark.parametrize(("ay", "is_doubted"), [(0.123, False), (-0.123, True)])
def test_a_pivot_on_the_other_side_of_the_arm_is_a_reservation(tmp_path, ay, is_doubted):
    """As with q2 of the other sign: the readings of the arm alone would not show it."""
    rng = np.random.default_rng(2)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 10)
    simulator.write(tmp_path, q, f, simulator.measure(true, q, f, rng)[1])
    q2 = np.radians([0.0, -30.0, -60.0, -90.0, -120.0])
    geometry = compensator_geometry.identify(markers(q2, *mechanism(np.array([0.185, 0.686, ay]), q2)))
    compensator_geometry.save(tmp_path / "c.toml", geometry, "x")
    choices = model_folder.Choices(compensator=tmp_path / "c.toml", structure="joints")
    paths = (tmp_path / name for name in ("measurements.csv", "experiment.toml", "model"))
    line = model_folder.identify_folder(*paths, choices).data.verdict.line
    assert ("check the sign of q2" in line) == is_doubted


def test_the_model_is_not_written_over_the_one_that_it_came_from(tmp_path):
    content = model_folder.read_prior(robot.find("kuka_kr270"), None, "")
    data = record.IdentificationRecord(
        method="none", robot="x", sigma_mm=0.03, base={}, points={}, unloaded_rms_mm=0.0, outliers=[], warnings=[]
    )
    with pytest.raises(InputError, match="would overwrite the prior model"):
        model_folder.write(tmp_path, content, data, tmp_path / "." / "x" / "..")


def test_displacements_do_not_show_the_geometry(tmp_path):
    data = readings(forces(3), count=3)
    model_folder._require_positions(data, tmp_path / "m.csv")
    with pytest.raises(MeasurementError, match="displacements do not show the geometry"):
        model_folder._require_positions(replace(data, are_displacements=True), tmp_path / "m.csv")


@pytest.mark.parametrize(("has_load", "worst"), [(True, 3), (False, 1)])
def test_of_repeats_that_differ_the_one_that_is_off_in_the_direction_of_the_residual_is_wrong(has_load, worst):
    """A reading under load that is too far makes the displacement too large, one without load too small."""
    data = readings(forces(2), count=2)
    position = data.position.copy()
    rows = np.array([0, 4, 1, 5])
    position[rows] = [0.5, 0.5, 0.5]
    position[rows[3]] += [3e-4, 0.0, 0.0]
    position[rows[1]] -= [4e-4, 0.0, 0.0]
    moved = replace(data, position=position)
    residual = np.array([1e-4, 0.0, 0.0])
    assert plausibility._worst_repeat(moved, rows, residual, placed(data), has_load) == [rows[worst]]
    assert plausibility._worst_repeat(moved, rows[:1], residual, placed(data), has_load) == [rows[0]]
    alike = replace(data, position=np.where(np.isin(np.arange(len(position)), rows)[:, None], 0.5, position))
    assert plausibility._worst_repeat(alike, rows, residual, placed(data), has_load) == rows.tolist()


def test_a_damaged_record_is_an_error_of_its_file_and_none_is_no_record(tmp_path):
    assert record.measured_states(tmp_path).as_array().shape == (0, 12)
    state = {"joints_deg": [0.0, -90.0, 90.0, 0.0, 45.0, 180.0], "load": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}
    (tmp_path / record.NAME).write_text(json.dumps({"states": [state]}))
    expected = [[0.0, -np.pi / 2, np.pi / 2, 0.0, np.pi / 4, np.pi, 1, 2, 3, 4, 5, 6]]
    np.testing.assert_allclose(record.measured_states(tmp_path).as_array(), expected)
    (tmp_path / record.NAME).write_text('{"states": 3}')
    with pytest.raises(MeasurementError, match=record.NAME):
        record.measured_states(tmp_path)


def test_springs_without_equilibrium_are_named_with_pose_and_force(monkeypatch):
    data = readings(forces(6, 500.0), count=6, points=POINTS[:1])
    sigma = 0.02 * harness.PRIOR.compliance * 1e6
    model = replace(harness.PRIOR, covariance=robot.Covariance(JOINT_COMPLIANCES, np.diag(sigma**2)))
    whole = uncertainty.bound_over_workspace(model, data)
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    q, _ = uncertainty._random_poses(model, tool)
    asked = []

    def deflect(_model, q, _tool, wrench):
        asked.append(np.linalg.norm(wrench[:, :3], axis=1))
        raise NotConvergedError("no equilibrium", np.array([7, 9]))

    monkeypatch.setattr(uncertainty.elastostatics, "deflect", deflect)
    found = uncertainty.bound_over_workspace(model, data)
    assert found.levels == ()
    np.testing.assert_array_equal(found.pose, q[7])
    assert found.cause == f"the springs have no equilibrium under {asked[0][7]:.0f} N"
    assert found.least_load == whole.least_load
    assert found.refusal.startswith("at A1 … A6 = ")


def test_the_verdict_of_jobs_names_shares_and_what_to_measure():
    level = ValidatedLevel(600.0, 1e-3, 7e-5, 7e-5, 1e-10, 0.97, (0.8, 1.0), 0.9, 3e-5, 15)
    covered = coverage(np.zeros((0, 6)), np.zeros(0, dtype=np.int64))

    def verdict(*shares):
        jobs = tuple(JobShare(f"job{n}", share, ()) for n, share in enumerate(shares))
        return Validation((level,), covered, (), (), jobs)

    both = verdict(1.0, 0.9499)
    assert not both.holds
    assert (
        "the model holds for 100% of the cutting path of job0, 94% of the cutting path of job1: at 600 N" in both.line
    )
    assert both.line.endswith(" Measure under the torques that job1 needs, listed below.")
    assert verdict(0.95).holds
    assert "Measure" not in verdict(0.95).line
    none = verdict(0.0)
    assert none.line.startswith("IT IS NOT KNOWN whether the model holds for job0: the readings cover none of it.")
    assert not none.holds
    assert both.keeps_bound


def test_a_parameter_that_moves_no_reading_stays_at_nothing(monkeypatch):
    """Of its usual size it moves them by less than a millionth of the noise: noise does not set it."""
    data = readings(forces(3), count=3)
    rng = np.random.default_rng(3)
    measured = rng.normal(0.0, 1e-5, (3, 4, 3)) + 2e-4
    structure = Structure(JOINT_COMPLIANCES[:2], harness.PRIOR)
    usual = structure.usual_sizes()

    for size, is_dead in ((1e-7, True), (1e-4, False)):
        # all readings by the second parameter, in units of the noise, if it has its usual size
        direction = rng.normal(size=(3, 4, 3))
        direction *= size * data.sigma / np.linalg.norm(direction) / usual[1]

        def predict(_structure, values, _data, _placement, direction=direction):
            slopes = np.stack([np.full((3, 4, 3), 1e2), direction], axis=-1)
            return slopes @ values, slopes

        monkeypatch.setattr(measurement_model, "measured_displacements", lambda *_: measured)
        monkeypatch.setattr(fit, "predict", predict)
        found = fit.gauss_newton(structure, data, placed(data), start=np.zeros(2))
        assert found.values[0] == pytest.approx(measured.mean() / 1e2, rel=1e-6) or not is_dead
        assert (found.values[1] == 0.0) == is_dead
        assert np.isinf(found.covariance[1, 1]) == is_dead


@pytest.mark.parametrize(("wrong", "kept"), [(1, 3), (2, 4)])
def test_of_four_repeats_of_a_marker_one_is_left_out_and_two_are_not(wrong, kept):
    """Two to either side of the others: none is the usual one."""
    position = np.random.default_rng(2).normal(0.0, 1e-5, (8, 3))
    position[1] += [1e-3, 0.0, 0.0]
    if wrong == 2:
        position[2] -= [1e-3, 0.0, 0.0]
    groups = {("P1", 0.0): np.arange(4), ("P01", 0.0): np.arange(4, 8)}
    found, warnings = compensator_geometry._remove_outliers(groups, position, 2 + np.arange(8))
    assert len(found["P1", 0.0]) == kept
    assert len(found["P01", 0.0]) == 4
    assert len(warnings) == (wrong == 1)
    assert not warnings or warnings[0].startswith("line 3: marker P1 at q2 = 0° is ")
