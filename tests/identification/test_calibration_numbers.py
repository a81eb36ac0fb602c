"""Numbers of the calibration by matrices and loops: derivatives, fit, cross-validation, error elsewhere, files."""

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc import robot
from postproc.identification import calibration
from postproc.identification.calibration import GeometryParameter
from postproc.identification.model_folder import read_prior
from postproc.robot import JOINTS
from postproc.robot.model_file import GeometryErrorEntry, Gravity, Stiffening
from samples.paper_study import harness, simulator
from tests.oracle.arm import Arm

NOMINAL = harness.PRIOR.nominal
ARM = Arm.load(robot.find("kuka_kr270"))
POINTS = np.array(list(simulator.POINTS.values()))
CONTENT = read_prior(robot.find("kuka_kr270"), None, "")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Readings of 12 poses of a robot whose joints are off; one point was not read once."""
    rng = np.random.default_rng(4)
    true = simulator.TrueRobot(
        simulator.Gear("linear", np.full(6, 1e12), np.ones(6)), offsets=np.r_[0, rng.normal(0, 5e-4, 4), 0]
    )
    q, f = simulator.plan(rng, 12)
    _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
    measured = harness.load(simulator.write(tmp_path_factory.mktemp("readings"), q, f, raw, 0.05e-3))
    return measured.drop([int(np.flatnonzero((measured.state == 4) & (measured.point == 2))[0])])


@pytest.fixture(scope="module")
def solution(data):
    free = calibration.nonredundant_displacements(NOMINAL, 3)
    bare = msgspec.structs.replace(CONTENT, geometry={}, transmission={}, gravity=Gravity("calibrated"))
    return calibration._fit_geometry(bare, NOMINAL, "x", data, free)


def places(q, root, points, shift=None, joint=None):
    """Points (P, 3) of the flange in the device, by another arm; `shift` (6,) moves a joint in its frame."""
    frames = ARM.frames(q)
    flange = frames[-1]
    if shift is not None:
        # all behind the joint moves by a twist in the axes of its frame, which does not turn with the joint itself
        frame = ARM.frames(np.where(np.arange(6) == joint, 0.0, q))[joint]
        rotation = Rotation.from_rotvec(shift[3:]).as_matrix()
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = rotation, shift[:3]
        flange = frame @ motion @ np.linalg.inv(frame) @ flange
    return (root @ np.column_stack([points @ flange[:3, :3].T + flange[:3, 3], np.ones(len(points))]).T).T[:, :3]


ROOT = np.eye(4)
ROOT[:3, :3] = Rotation.from_euler("xyz", [20, -35, 140], degrees=True).as_matrix()
ROOT[:3, 3] = [1.2, -3.4, 0.8]


def test_derivatives_by_base_points_and_joints_are_differences_of_another_arm():
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 6))
    flange, columns = calibration._joint_derivatives(NOMINAL, q, POINTS)
    base, tool = np.split(calibration._placement_columns(flange, POINTS, ROOT), [6], axis=1)
    h = 1e-6
    for column in range(6):
        twist = np.zeros(6)
        twist[column] = h
        moved = []
        for sign in (1.0, -1.0):
            root = ROOT.copy()
            root[:3, :3] = Rotation.from_rotvec(sign * twist[3:]).as_matrix() @ ROOT[:3, :3]
            root[:3, 3] += sign * twist[:3]
            moved.append(np.array([places(row, root, POINTS) for row in q]))
        np.testing.assert_allclose(base[:, column], (moved[0] - moved[1]).ravel() / (2 * h), atol=1e-7)
    for column in range(9):
        change = np.zeros((3, 3))
        change.flat[column] = h
        moved = [np.array([places(row, ROOT, POINTS + sign * change) for row in q]) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(tool[:, column], (moved[0] - moved[1]).ravel() / (2 * h), atol=1e-7)
    for joint in range(6):
        for axis in range(6):
            shift = np.zeros(6)
            shift[axis] = h
            moved = [
                np.array([places(row, np.eye(4), POINTS, sign * shift, joint) for row in q]) for sign in (1.0, -1.0)
            ]
            slope = (moved[0] - moved[1]).ravel() / (2 * h)
            np.testing.assert_allclose(columns[:, joint, axis], slope, atol=1e-7, err_msg=f"A{joint + 1} {axis}")


def test_displacements_that_are_kept_are_independent_of_the_frames_and_of_each_other():
    """By the rank of differences; all others are in the span of those that are kept."""
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (40, 6))
    flange, columns = calibration._joint_derivatives(NOMINAL, q, POINTS)
    frames = calibration._placement_columns(flange, POINTS, np.eye(4))
    kept = calibration.nonredundant_displacements(NOMINAL, 3)
    names = ("X", "Y", "Z", "RX", "RY", "RZ")
    own = np.stack([columns[:, JOINTS.index(p.joint), names.index(p.axis)] for p in kept], axis=1)
    basis = np.hstack([frames, own])
    whole = np.hstack([frames, columns.reshape(len(columns), -1)])
    assert np.linalg.matrix_rank(basis, tol=1e-6) == basis.shape[1] == 15 + 18
    assert np.linalg.matrix_rank(whole, tol=1e-6) == 15 + 18
    # zero offsets come before all others where both would do
    axis = [names[3 + int(np.argmax(np.abs(NOMINAL.axis[joint])))] for joint in range(6)]
    assert {f"A{joint + 1}.{axis[joint]}" for joint in range(1, 5)} <= {p.name for p in kept}
    one = calibration.nonredundant_displacements(NOMINAL, 1)
    assert len(one) <= 18


def test_the_calibration_is_that_of_least_squares_with_a_prior(data, solution):
    """Base and points are free, joints have 1 mm and 2 mrad; readings weigh by their number over σ²."""
    _, count = data.means()
    assert (count[data.unloaded_states].min(), count[data.unloaded_states].max()) == (2, 3)
    frames = 6 + 9
    size = len(solution.parameters)
    usual = np.array([2e-3 if p.axis.startswith("R") else 1e-3 for p in solution.parameters])
    normal = solution.design[: 12 * 9].T @ solution.design[: 12 * 9]
    normal[frames:, frames:] += np.diag(1.0 / usual**2)
    residual = solution.residual
    white = residual * np.sqrt(count[data.unloaded_states])[..., None] / data.sigma
    inflate = max(1.0, np.sum(white**2) / (12 * 9 - 15 - size))
    scale = np.sqrt(np.diag(normal))
    covariance = inflate * np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(solution.covariance_of_unknowns)), deviation, rtol=1e-3)
    np.testing.assert_allclose(
        solution.covariance_of_unknowns / np.outer(deviation, deviation),
        covariance / np.outer(deviation, deviation),
        atol=1e-3,
    )
    np.testing.assert_array_equal(solution.covariance, solution.covariance_of_unknowns[15:, 15:])
    # the gradient of the squares is zero: readings pull as much as the prior
    pull = solution.design[: 12 * 9].T @ white.ravel()
    pull[frames:] -= solution.values / usual**2
    np.testing.assert_allclose(pull / scale, 0.0, atol=1e-3)
    assert np.sqrt(np.mean(white**2)) == pytest.approx(0.8, abs=0.3)
    placement = solution.placement
    np.testing.assert_allclose(
        placement.covariance * data.sigma**2 * inflate, solution.covariance_of_unknowns[:15, :15], rtol=1e-9
    )


def test_errors_of_configurations_left_out_are_those_of_fits_to_the_other_folds(data, solution):
    found = calibration._cross_validation_error(solution, data)
    fold = np.random.default_rng(0).permutation(12) % 10
    rows = np.repeat(np.arange(12), 9)
    usual = np.array([2e-3 if p.axis.startswith("R") else 1e-3 for p in solution.parameters])
    prior = np.hstack([np.zeros((len(usual), 15)), np.diag(1.0 / usual)])
    for index in range(10):
        train = fold[rows] != index
        design = np.vstack([solution.design[: 12 * 9][train], prior])
        target = np.append(solution.target[: 12 * 9][train], np.zeros(len(usual)))
        size = np.linalg.norm(design, axis=0)
        state = np.linalg.lstsq(design / size, target, rcond=None)[0] / size
        for config in np.flatnonzero(fold == index):
            own = rows == config
            left = solution.target[: 12 * 9][own] - solution.design[: 12 * 9][own] @ state
            _, count = data.means()
            weight = np.repeat(np.sqrt(count[data.unloaded_states][config]), 3) / data.sigma
            assert found[config] == pytest.approx(np.sum((left / weight) ** 2) / 3, rel=1e-5)


def test_the_error_elsewhere_is_that_of_draws_of_base_point_and_joints(solution):
    """Errors are drawn with the covariance of the fit and put on another arm, all over the range of the joints.

    Of 200 draws the RMS is known to 4 % or so.
    """
    rng = np.random.default_rng(8)
    found = calibration._extrapolation_error(solution, NOMINAL)
    keep = [*range(9), *range(15, 15 + len(solution.values))]
    drawn = rng.multivariate_normal(np.zeros(len(keep)), solution.covariance_of_unknowns[np.ix_(keep, keep)], 200)
    low, high = np.maximum(NOMINAL.lower, -np.pi), np.minimum(NOMINAL.upper, np.pi)
    names = ("X", "Y", "Z", "RX", "RY", "RZ")
    root, point = solution.placement.root_in_device, solution.placement.points[:1]
    lengths = []
    for error in drawn:
        q = rng.uniform(low, high)
        moved = places(q, root, point)[0]
        turned = moved + error[:3] + np.cross(error[3:6], moved - root[:3, 3])
        at = places(q, root, point + error[6:9])[0] - moved + turned
        for value, parameter in zip(error[9:], solution.parameters, strict=True):
            shift = np.zeros(6)
            shift[names.index(parameter.axis)] = value
            at = at + places(q, root, point, shift, JOINTS.index(parameter.joint))[0] - moved
        lengths.append(np.linalg.norm(at - moved))
    assert found == pytest.approx(1.614 * np.sqrt(np.mean(np.square(lengths))), rel=0.13)


def test_geometries_are_tried_from_simple_to_rich():
    free = (GeometryParameter("A2", "X"),)
    old = msgspec.structs.replace(CONTENT, gravity=Gravity("rigid", in_gears=True))
    for with_gears in (False, True):
        variants = calibration._variants(old, free, with_gears=with_gears)
        names = ["nominal geometry", "nominal geometry with sag", "calibrated geometry", "calibrated geometry with sag"]
        names += ["calibrated geometry, gears", "calibrated geometry with sag, gears"] if with_gears else []
        assert [label for label, *_ in variants] == names
        for label, model, parameters in variants:
            assert model.gravity == Gravity("rigid" if "sag" in label else "calibrated", in_gears=True)
            assert parameters[: len(free)] == (free if "calibrated" in label else ())
            assert len(parameters) == ("calibrated" in label) + 24 * ("gears" in label)


def test_values_are_written_in_the_units_of_their_keys_with_their_intervals():
    parameters = (GeometryParameter("A2", "X"), GeometryParameter("A2", "RY"), GeometryParameter("A3", "sin2"))
    values, half = np.array([1.5e-3, 2e-3, 1e-4]), np.array([2e-4, 3e-4, 5e-5])
    model = calibration._add_geometry(CONTENT, parameters, values, "identified from x.csv", half)
    assert list(model.geometry) == ["A2"]
    assert list(model.transmission) == ["A3"]
    assert model.geometry["A2"].X_mm == pytest.approx(1.5)
    assert model.geometry["A2"].RY_deg == pytest.approx(np.degrees(2e-3))
    assert model.transmission["A3"].sin2_urad == pytest.approx(100.0)
    text = f"identified from x.csv (95 %: X ± 0.2 mm, RY ± {np.degrees(3e-4):.2g} deg)"
    assert model.geometry["A2"].source == text
    assert model.transmission["A3"].source == "identified from x.csv (95 %: sin2 ± 50 urad)"
    plain = calibration._add_geometry(CONTENT, parameters, values, "s", None)
    assert plain.geometry["A2"].source == "s"


def result_of(**parts):
    angles = dict.fromkeys(JOINTS, (-100.0, 100.0))
    error = GeometryErrorEntry(source="", u95_mm=0.1, angles_deg=angles, unmeasured_mm=1.0)
    content = msgspec.structs.replace(CONTENT, geometry_error=error, gravity=Gravity("rigid"))
    return SimpleNamespace(**({"is_weightless": True, "content": content} | parts))


def test_joints_that_turned_by_less_than_thirty_degrees_are_named():
    assert calibration._small_motion_warnings(result_of()) == []
    for span, named in ((30.5, False), (29.5, True)):
        angles = {joint: (-10.0, 10.0 + (span - 20.0)) if joint == "A4" else (-90.0, 90.0) for joint in JOINTS}
        base = result_of().content
        error = msgspec.structs.replace(base.geometry_error, angles_deg=angles)
        found = calibration._small_motion_warnings(
            result_of(content=msgspec.structs.replace(base, geometry_error=error))
        )
        assert bool(found) == named
        if named:
            assert found[0].startswith(f"A4 turned by {span:.0f}° in the readings")


def test_gears_identified_without_the_weights_contradict_a_weightless_geometry():
    base = result_of().content
    joints = dict(base.joints)
    joints["A3"] = msgspec.structs.replace(joints["A3"], stiffening=[Stiffening(700.0, 0.1)])
    stiffening = msgspec.structs.replace(base, joints=joints)
    (text,) = calibration._contradiction_warnings(result_of(content=stiffening))
    assert "the gears of A3 were identified with the load alone" in text
    assert calibration._contradiction_warnings(result_of()) == []
    assert calibration._contradiction_warnings(result_of(is_weightless=False, content=stiffening)) == []
    in_gears = msgspec.structs.replace(stiffening, gravity=Gravity("rigid", in_gears=True))
    assert calibration._contradiction_warnings(result_of(content=in_gears)) == []


def test_the_record_of_a_geometry_has_millimetres_and_what_was_not_narrowed(data):
    found = calibration.identify_geometry(CONTENT, NOMINAL, "x", data)
    written = calibration.report_data(found)
    assert found.chosen.startswith("calibrated geometry")
    for row, (name, entry) in enumerate(written.parameters.items()):
        parameter = found.parameters[row]
        factor = np.degrees(1.0) if parameter.axis.startswith("R") else 1e3
        assert name == f"{parameter.joint}.{parameter.axis}"
        assert (entry.value, entry.ci95) == pytest.approx(
            (factor * found.values[row], 1.96 * factor * np.sqrt(found.covariance[row, row])), rel=1e-4
        )
        usual = 2e-3 if parameter.axis.startswith("R") else 1e-3
        narrowed = np.sqrt(found.covariance[row, row]) <= 0.8 * usual
        assert entry.observable == narrowed
        assert entry.determined == (entry.ci95 <= abs(entry.value))
    assert (written.u95_mm, written.sag, written.chosen) == (
        pytest.approx(1e3 * found.u95),
        found.is_weightless,
        found.chosen,
    )
    for label, (fit, held_out) in found.rms.items():
        variant = written.variants[label]
        assert (variant.rms_mm, variant.held_out_rms_mm) == pytest.approx((1e3 * fit, 1e3 * held_out))
    fit = found.rms[found.chosen][0]
    assert fit == pytest.approx(np.sqrt(np.mean(np.sum(found.placement.residual**2, axis=2))), rel=1e-6)
    error = found.content.geometry_error
    assert error.u95_mm == pytest.approx(1e3 * found.u95)
    for joint, (low, high) in error.angles_deg.items():
        own = np.degrees(data.q[:, JOINTS.index(joint)])
        assert (low, high) == pytest.approx((own.min(), own.max()))


def test_errors_of_gears_are_expected_smaller_than_those_of_zero_offsets():
    wave, turn, shift = (GeometryParameter("A3", axis) for axis in ("sin2", "RY", "X"))
    assert 0.0 < wave.usual_size < 0.5 * turn.usual_size
    assert shift.usual_size == 1e-3  # a tolerance of a casting
    assert (wave.unit_and_factor[0], turn.unit_and_factor[0], shift.unit_and_factor[0]) == ("urad", "deg", "mm")
    assert (wave.unit_and_factor[1], turn.unit_and_factor[1], shift.unit_and_factor[1]) == pytest.approx(
        (1e6, np.degrees(1.0), 1e3)
    )
    assert (wave.name, turn.name) == ("A3.sin2", "A3.RY")


def test_parameters_that_five_poses_leave_at_four_fifths_of_their_prior_are_not_observable(data, monkeypatch):
    monkeypatch.setattr(calibration, "simplest_variant", lambda _: "calibrated geometry")
    found = calibration.identify_geometry(CONTENT, NOMINAL, "x", data.take_configurations(np.arange(5)))
    usual = np.array([2e-3 if p.axis.startswith("R") else 1e-3 for p in found.parameters])
    wide = np.sqrt(np.diag(found.covariance)) > 0.8 * usual
    assert 0 < wide.sum() < len(usual)
    assert list(found.not_observable) == [p.name for p, is_wide in zip(found.parameters, wide, strict=True) if is_wide]
