"""Points that come out far from where the experiment states them: another zero of A6, or careless guesses."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.errors import MeasurementError
from postproc.identification.measurement_model import locate
from postproc.identification.model_folder import geometry_folder
from postproc.identification.procedure import identify
from postproc.identification.stated_points import displaced_points
from postproc.identification.uncertainty import Judgement
from samples.paper_study import harness, simulator
from tests.identification.test_joint_springs import POINTS, forces, readings


def stated(guess, points=POINTS, turn_of_a6=0.0, count=10):
    """Return the text on points of the oracle's arm that an experiment states at a guess (P, 3) [m]."""
    data = readings(forces(count), count=count, points=points)
    data = replace(data, guess=guess, q=data.q + np.radians([0, 0, 0, 0, 0, turn_of_a6]))
    return displaced_points(data, locate(harness.PRIOR, data))


@pytest.mark.parametrize("points", [POINTS[1:], POINTS[1:2]])
@pytest.mark.parametrize(("turn", "angle"), [(90.0, 90), (-45.0, -45)])
def test_another_zero_of_a6_turns_all_points_and_the_text_says_by_which_angle(points, turn, angle):
    text = stated(points, points, turn_of_a6=turn)
    subject = "all points are" if len(points) > 1 else "it is"
    assert f"{subject} turned by {angle}° about Z of the flange frame: check A6" in text


def test_the_point_farthest_off_has_both_places_and_the_others_their_distance():
    guess = POINTS + np.array([[0.04, 0, 0], [0, 0.02, 0], [0, 0, -0.25], [0, 0, 0]])
    text = stated(guess)
    assert text.startswith("point P3 comes out at -100, 250, 20 mm in the flange frame, 250 mm from the stated ")
    assert "stated -100, 250, -230 (P1 by 40 mm): check A6, the flange frame" in text
    assert "turned" not in text


@pytest.mark.parametrize(("off", "is_far"), [(0.0, False), (0.028, False), (0.032, True)])
def test_guesses_within_thirty_millimetres_are_no_set_up_error(off, is_far):
    assert bool(stated(POINTS + off * np.array([0.6, 0.0, 0.8]))) == is_far


def test_points_that_the_readings_leave_open_are_not_called_far():
    """The residuals are those of another robot, so the points are uncertain by more than they are off."""
    data = replace(readings(forces(10)), guess=POINTS + np.array([0.05, 0.0, 0.0]))
    placement = locate(harness.PRIOR, data)
    assert displaced_points(data, placement)
    residual = np.full_like(placement.residual, 0.01)
    assert displaced_points(data, replace(placement, residual=residual, covariance=100.0 * placement.covariance)) == ""


def test_a_reservation_precedes_the_others_and_refuses_nothing():
    judgement = Judgement("", "4 configurations", [])
    assert judgement.with_reservation("").line == judgement.line
    line = judgement.with_reservation("point P1 is far").line
    assert line == "the model may be used, within its bound, with a reservation: point P1 is far; 4 configurations"


@pytest.mark.parametrize("method", ["enhanced", "serial"])
def test_readings_with_another_zero_of_a6_are_refused_since_the_load_point_turns_too(tmp_path, method):
    rng = np.random.default_rng(2)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 10)
    _, raw = simulator.measure(true, q, f, rng)
    data = harness.load(simulator.write(tmp_path, q, f, raw))
    assert identify(harness.PRIOR, data, method, "joints").judgement.line == "the model may be used, within its bound"
    turned = replace(data, q=data.q + np.radians([0, 0, 0, 0, 0, 90.0]))
    with pytest.raises(
        MeasurementError, match=r"times better if they pull at .*turned by 90° about Z of the flange frame"
    ):
        identify(harness.PRIOR, turned, method, "joints")


def test_points_that_are_stated_careless_are_a_reservation(tmp_path):
    rng = np.random.default_rng(2)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 10)
    _, raw = simulator.measure(true, q, f, rng)
    data = harness.load(simulator.write(tmp_path, q, f, raw))
    judgement = identify(harness.PRIOR, replace(data, guess=data.guess + 0.05), "enhanced", "joints").judgement
    assert judgement.distrust == ""
    assert "comes out at" in judgement.reservation


def test_the_calibration_of_the_geometry_alone_warns_of_it_too(tmp_path):
    rng = np.random.default_rng(2)
    true, (q, f) = simulator.paper_like(rng), simulator.plan(rng, 20)
    _, raw = simulator.measure(true, q, f, rng)
    for turn in (0.0, 90.0):
        simulator.write(tmp_path, q + np.radians([0, 0, 0, 0, 0, turn]), f, raw)
        written = geometry_folder(*(tmp_path / name for name in ("measurements.csv", "experiment.toml", "model")))
        assert any("turned by 90°" in text for text in written.data.warnings) == (turn > 0.0)
