"""One configuration of many with a wrongly noted angle, or whose points are not where the others put them."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.errors import MeasurementError
from postproc.identification import calibration
from postproc.identification.measurement_model import as_positions, locate, unloaded_design, unloaded_flange
from postproc.identification.model_folder import read_prior
from postproc.identification.outlying_configuration import deletion
from postproc.identification.plausibility import checked_frames
from samples.paper_study import harness, simulator

NAMES = ("A1", "A2", "A3", "A4", "A5", "A6")


def readings(folder, seed=5, poses=20):
    """Readings of an arm whose joints stand tenths of a millimetre off, and which sags."""
    rng = np.random.default_rng(seed)
    true = simulator.hard(rng)
    q, f = simulator.plan(rng, poses, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng, 0.05e-3)
    return harness.load(simulator.write(folder, q, f, raw, 0.05e-3))


def with_angle(data, row, joint, degrees):
    """The readings with one angle noted larger than it was."""
    q = data.q.copy()
    q[row, joint] += np.radians(degrees)
    return replace(data, q=q)


def calibrated(data):
    content = read_prior(robot.find("kuka_kr270"), None, "")
    return calibration.identify_geometry(content, harness.PRIOR.nominal, "x", data)


@pytest.mark.parametrize("prior_rows", [0, 5])
def test_errors_by_deletion_are_those_of_a_fit_to_the_other_configurations(prior_rows):
    rng = np.random.default_rng(3)
    design, target = rng.normal(size=(9, 4, 5)), rng.normal(size=(9, 4))
    target[2] += 40.0
    ridge = np.diag(rng.uniform(0.5, 3.0, 5))[:prior_rows]

    def fit(rows):
        whole = np.concatenate([design[rows].reshape(-1, 5), ridge])
        values = np.linalg.lstsq(whole, np.r_[target[rows].ravel(), np.zeros(prior_rows)], rcond=None)[0]
        return values, np.linalg.inv(whole.T @ whole)

    values, inverse = fit(np.arange(9))
    judged = deletion(design, target - design @ values, ridge)
    unknowns = np.trace(inverse @ design.reshape(-1, 5).T @ design.reshape(-1, 5))  # those that the prior leaves
    for row in range(9):
        others = np.delete(np.arange(9), row)
        values, inverse = fit(others)
        error = target[row] - design[row] @ values
        assert judged.error[row] == pytest.approx(error, rel=1e-9)
        size = np.sqrt(np.mean((target[others] - design[others] @ values) ** 2, axis=1))
        scatter = np.median(size) * np.sqrt(36 / (36 - unknowns))
        covariance = scatter**2 * (np.eye(4) + design[row] @ inverse @ design[row].T)
        assert judged.ratio[row] == pytest.approx(np.sqrt(error @ np.linalg.solve(covariance, error) / 4), rel=1e-9)
    assert judged.ratio.argmax() == 2


def test_the_design_of_the_placement_is_that_by_differences(tmp_path):
    data = readings(tmp_path, poses=5)
    placement = locate(harness.PRIOR, data)
    design = unloaded_design(harness.PRIOR, data, placement)

    def positions(turn, points):
        """Points after the root moved by a twist about itself, device axes (Rodrigues' formula)."""
        angle = np.linalg.norm(turn[3:])
        x, y, z = turn[3:] / max(angle, 1e-30)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        flange = unloaded_flange(harness.PRIOR, data.q)
        root = placement.root_in_device
        in_root = np.einsum("cij,pj->cpi", flange[:, :3, :3], points) + flange[:, None, :3, 3]
        return in_root @ (rotation @ root[:3, :3]).T + root[:3, 3] + turn[:3]

    step = 1e-6
    for column in range(15):
        shift = np.zeros(15)
        shift[column] = step
        plus, minus = (
            positions(sign * shift[:6], placement.points + sign * shift[6:].reshape(3, 3)) for sign in (1.0, -1.0)
        )
        assert design[..., column] == pytest.approx((plus - minus) / (2 * step), abs=1e-8)


@pytest.mark.parametrize(("joint", "degrees"), [(0, 1.5), (1, -2.0), (2, 3.0), (4, 6.0)])
def test_a_wrong_angle_is_named_with_its_joint_and_direction(tmp_path, joint, degrees):
    data = readings(tmp_path)
    checked_frames(harness.PRIOR, data)
    with pytest.raises(MeasurementError) as caught:
        checked_frames(harness.PRIOR, with_angle(data, 7, joint, degrees))
    pattern = r"config 8: .* An (A\d) that is ([\d.]+)° (larger|smaller) \(KUKA signs\) would explain it"
    match = re.search(pattern, str(caught.value))
    assert match, str(caught.value)
    assert match[1] == NAMES[joint]
    assert float(match[2]) == pytest.approx(abs(degrees), abs=0.4)  # the geometry is millimetres off
    assert match[3] == ("smaller" if degrees > 0.0 else "larger")  # of what was noted
    assert caught.value.line == int(data.line[data.state_config[data.state] == 7].min())


def test_a_calibration_sees_a_tenth_of_the_error(tmp_path):
    """The calibrated geometry of the others is tenths of a millimetre off, the nominal one millimetres."""
    data = readings(tmp_path, poses=30)
    calibrated(data)
    wrong = with_angle(data, 11, 0, 0.3)
    checked_frames(harness.PRIOR, wrong)
    with pytest.raises(MeasurementError, match=r"config 12: .* An A1 that is 0\.\d+° smaller"):
        calibrated(wrong)


def test_points_of_another_configuration_name_no_joint(tmp_path):
    data = readings(tmp_path)
    position = data.position.copy()
    rows = data.state == data.unloaded_states[3]
    position[rows] += np.array([0.02, -0.03, 0.025])
    with pytest.raises(MeasurementError) as caught:
        checked_frames(harness.PRIOR, replace(data, position=position))
    assert "config 4: without load the points are 4" in str(caught.value)  # 44 mm
    assert "would explain" not in str(caught.value)


def test_few_configurations_and_small_errors_are_not_judged(tmp_path):
    data = readings(tmp_path, poses=12)
    few = data.take_configurations(np.arange(9))
    checked_frames(harness.PRIOR, with_angle(few, 4, 0, 0.5))
    # readings of an arm that has no error of geometry at all: 20 times its noise is still below a millimetre
    flange = unloaded_flange(harness.PRIOR, data.q)
    noise = np.random.default_rng(1).normal(size=data.position.shape) * 0.02e-3
    points = np.einsum("cij,pj->cpi", flange[:, :3, :3], data.guess) + flange[:, None, :3, 3]
    exact = replace(data, position=points[data.state_config[data.state], data.point] + noise)
    checked_frames(harness.PRIOR, with_angle(exact, 4, 0, 0.015))
    with pytest.raises(MeasurementError, match="config 5: without load the points are"):
        checked_frames(harness.PRIOR, with_angle(exact, 4, 0, 0.1))


def test_displacements_have_no_configuration_to_judge(tmp_path):
    data = readings(tmp_path)
    start = data.means()[0][data.unloaded_states][data.state_config[data.state], data.point]
    moved = replace(data, position=data.position - start, are_displacements=True)
    assert checked_frames(harness.PRIOR, as_positions(harness.PRIOR, moved)).rms < 1e-4


def test_few_configurations_of_which_one_is_far_off_are_named_by_leaving_each_out(tmp_path):
    data = readings(tmp_path).take_configurations(np.arange(6))
    with pytest.raises(MeasurementError, match="config 5: the readings without load are far from the points"):
        checked_frames(harness.PRIOR, with_angle(data, 4, 0, 20.0))


@pytest.mark.parametrize(
    ("position", "cause"),
    [
        (lambda place: place / 25.4, "as far apart as if X, Y, Z were in inch: give them in mm"),
        (lambda place: place * [1.0, -1.0, 1.0], "the axes of the measuring device are left-handed"),
        (lambda place: place[:, [1, 0, 2]], "the axes of the measuring device are left-handed"),
        (lambda place: place * 1.5, "Check the robot named in the experiment"),
    ],
)
def test_positions_of_another_unit_or_of_left_handed_axes_are_named(tmp_path, position, cause):
    data = readings(tmp_path)
    with pytest.raises(MeasurementError, match=r"mm \(RMS\) off the geometry of kuka_kr270\. ") as caught:
        checked_frames(harness.PRIOR, replace(data, position=position(data.position)))
    assert cause in str(caught.value)
