"""Forces in other axes than those of the root: turned, exchanged, of flange or device; and rigs that cannot tell."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import MeasurementError
from postproc.identification import stated_loads as module
from postproc.identification.measurement_model import locate, unloaded_flange
from postproc.identification.procedure import identify
from postproc.identification.stated_loads import doubt_of_loads
from samples.paper_study import harness, simulator


def readings(folder, seed=3, count=20, hard=False):
    """Readings of the paper's arm, or of one whose links deflect too."""
    rng = np.random.default_rng(seed)
    true = simulator.hard(rng) if hard else simulator.paper_like(rng)
    q, f = simulator.plan(rng, count, tilt=50.0)
    _, raw = simulator.measure(true, q, f, rng, 0.03e-3)
    return harness.load(simulator.write(folder, q, f, raw))


def stated(data, matrix):
    """The readings whose forces are stated multiplied by (3, 3) or (S, 3, 3) matrices."""
    wrench = data.wrench.copy()
    wrench[:, :3] = np.einsum("...ij,...j->...i", matrix, wrench[:, :3])
    return replace(data, wrench=wrench)


def turn(degrees, axis):
    """Rotation about a coordinate axis, by the formula of the plane."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def judged(data):
    return doubt_of_loads(harness.PRIOR, data, locate(harness.PRIOR, data))


@pytest.mark.parametrize("hard", [False, True])
def test_forces_in_root_axes_are_not_questioned(tmp_path, hard):
    assert judged(readings(tmp_path, hard=hard)) == ""


@pytest.mark.parametrize(("degrees", "axis"), [(15.0, 2), (-20.0, 2), (25.0, 0), (-30.0, 1)])
def test_a_turn_is_named_with_axis_and_angle_that_turn_the_forces_back(tmp_path, degrees, axis):
    data = stated(readings(tmp_path), turn(-degrees, axis))
    with pytest.raises(MeasurementError) as caught:
        judged(data)
    match = re.search(r"fit ([\d.]+) times better turned by (-?[\d.]+)° about (\w) of the root", str(caught.value))
    assert match, str(caught.value)
    assert float(match[2]) == pytest.approx(degrees, abs=1.0)
    assert match[3] == "XYZ"[axis]
    assert float(match[1]) > 3.0


@pytest.mark.parametrize(
    ("matrix", "parts"),
    [
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], "Fy, Fx, Fz"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, -1]], "Fx, Fy, -Fz"),
        ([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], "-Fy, Fx, Fz"),  # what is stated as Fx is the true Fy
        ([[0, 1, 0], [0, 0, 1], [1, 0, 0]], "Fz, Fx, Fy"),
    ],
)
def test_exchanged_columns_and_signs_are_named(tmp_path, matrix, parts):
    with pytest.raises(MeasurementError, match=f"times better if Fx, Fy, Fz of the root are the columns {parts}[.]"):
        judged(stated(readings(tmp_path), np.array(matrix, dtype=float)))


def test_axes_of_flange_and_measuring_device_are_named(tmp_path):
    data = readings(tmp_path, hard=True)
    of_flange = np.swapaxes(unloaded_flange(harness.PRIOR, data.q)[data.state_config, :3, :3], 1, 2)
    with pytest.raises(MeasurementError, match="times better if they are in flange axes"):
        judged(stated(data, of_flange))
    of_device = locate(harness.PRIOR, data).root_in_device[:3, :3]
    with pytest.raises(MeasurementError, match="times better if they are in the axes of the measuring device"):
        judged(stated(data, of_device))


def test_a_turn_that_links_could_imitate_is_a_reservation_of_the_model(tmp_path, monkeypatch):
    data = stated(readings(tmp_path), turn(-15.0, 2))
    monkeypatch.setattr(module, "CERTAIN_RATIO", 0.0)
    result = identify(harness.PRIOR, data, depth="joints")
    assert "times better turned by 1" in result.judgement.reservation
    assert "$ROBROOT" in result.judgement.reservation
    monkeypatch.setattr(module, "DOUBTFUL_RATIO", 0.0)
    assert judged(data) == ""


def test_forces_of_the_other_sign_are_left_to_the_check_of_the_loads(tmp_path):
    data = stated(readings(tmp_path), -np.eye(3))
    assert judged(data) == ""
    with pytest.raises(MeasurementError, match="the points move against the forces"):
        identify(harness.PRIOR, data)


def test_hanging_weights_and_two_loads_tell_nothing_of_axes(tmp_path):
    data = readings(tmp_path)
    wrench = data.wrench.copy()
    wrench[:, :2] = 0.0
    assert judged(replace(data, wrench=wrench)) == ""
    few = stated(data.take_configurations(np.arange(2)), turn(40.0, 2))
    assert doubt_of_loads(harness.PRIOR, few, locate(harness.PRIOR, data)) == ""


def test_moments_are_turned_as_those_of_turned_forces():
    """r × F of turned vectors, also in a mirror."""
    rng = np.random.default_rng(8)
    mirror = np.eye(3)[[1, 0, 2]] @ turn(25.0, 0)
    lever, force = rng.normal(size=(2, 4, 3))
    data = readings_with(np.c_[force, np.cross(lever, force)])
    turned = module._turned_loads(data, mirror).wrench
    assert turned[:, :3] == pytest.approx(force @ mirror.T)
    assert turned[:, 3:] == pytest.approx(np.cross(lever @ mirror.T, force @ mirror.T))


def readings_with(wrench):
    class Wrenches(module.Struct, frozen=True):
        wrench: object

    return Wrenches(wrench)


@pytest.mark.parametrize(
    "point",
    [(0.210 / 25.4, -0.060 / 25.4, 0.180 / 25.4), (0.210, -0.060, -0.180), (-0.060, 0.210, 0.180)],
    ids=["inch", "sign of Z", "X and Y exchanged"],
)
def test_a_load_point_that_is_stated_wrong_is_named_with_the_true_one(tmp_path, point):
    data = replace(readings(tmp_path), load_point=np.array(point))
    with pytest.raises(MeasurementError, match=r"times better if they pull at .* Check \[load_point\]") as caught:
        judged(data)
    place = re.search(r"at (-?\d+), (-?\d+), (-?\d+) mm in the flange frame, not at", str(caught.value))
    distance = np.array([float(value) for value in place.groups()]) - simulator.LOAD_POINT * 1e3
    assert np.abs(distance).max() < 40.0  # two rounds: enough to see which number is wrong


def test_a_load_point_that_was_measured_by_a_ruler_is_not_questioned(tmp_path):
    data = readings(tmp_path)
    assert judged(replace(data, load_point=data.load_point + np.array([0.0, 0.02, -0.03]))) == ""


def test_readings_that_joint_springs_explain_raise_no_other_hypothesis(tmp_path, monkeypatch):
    def unexpected(*_):
        raise AssertionError

    monkeypatch.setattr(module, "_axes_hypothesis", unexpected)
    data = replace(readings(tmp_path), sigma=0.06e-3)  # twice the noise of the readings: χ² is a quarter of its freedom
    assert judged(data) == ""
    with pytest.raises(AssertionError):
        judged(replace(data, sigma=0.01e-3))
