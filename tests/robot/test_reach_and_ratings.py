"""Reach of an arm, payloads that names state, frames by name, and covariances that are none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.errors import ModelError
from postproc.robot import from_urdf
from postproc.robot.rating import exceeded_rating, rated_payload
from tests.kr270 import ROBOT
from tests.robot.test_adopted import placed
from tests.robot.test_folder import MODEL, written


@pytest.mark.parametrize("wrist", [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.15, 0.0, 0.1)])
def test_the_reach_is_the_largest_distance_of_the_wrist_from_the_axis_of_a1(wrist):
    """By a search over A2 and A3, whose axes are horizontal: from the axis of A2, and that from the axis of A1."""
    placement = placed(4, ROBOT.nominal.placement[4, :3, 3] + wrist)
    chain = replace(ROBOT.nominal, placement=placement)
    a3 = np.linspace(-np.pi, np.pi, 2001)
    q = np.zeros((len(a3), 6))
    q[:, 2] = a3
    frames = chain.joint_frames(q)[0]
    shoulder, centre = frames[:, 1, :3, 3], frames[:, 4, :3, 3]
    lengths = np.linalg.norm((centre - shoulder)[:, [0, 2]], axis=1)
    expected = lengths.max() + np.hypot(*shoulder[0, :2])
    assert from_urdf._reach(chain) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("name", "payload"),
    [
        ("KUKA KR 270-2", 270), ("kr120_r2700_2", 120), ("KR 210-2 L150", 150), ("kr6", 6), ("IRB 6700-200/2.60", 200),
        ("irb1200_5_90", 5), ("irb 2600", None), ("arm", None), ("ur10", None), ("skr 5", 5),
    ],
)  # fmt: skip
def test_payloads_are_those_of_the_class_in_a_name(name, payload):
    assert rated_payload(name) == payload
    assert rated_payload("arm", name) == payload
    assert rated_payload("KR 90", name) == 90


@pytest.mark.parametrize(("mass", "is_exceeded"), [(323.0, False), (324.0, False), (325.0, True)])
def test_a_weight_is_questionable_from_a_fifth_over_the_rating(mass, is_exceeded):
    assert exceeded_rating(mass, "KR 270") == (270.0 if is_exceeded else None)
    assert exceeded_rating(1e6, "arm") is None


def frames_of(*frames):
    poses = {name: (joint, np.full((4, 4), float(k))) for k, (name, joint) in enumerate(frames)}
    return SimpleNamespace(frames=poses)


def test_a_frame_is_found_by_its_name_or_behind_a_prefix_on_its_joint():
    def place(arm, carrier=5):
        found = from_urdf._frame(arm, "tool0", carrier, "arm.urdf")
        return None if found is None else int(found[0, 0])

    assert place(frames_of(("a", 5), ("tool0", 5))) == 1
    assert place(frames_of(("tool0", 4), ("link_6", 5))) is None
    assert place(frames_of(("kr_tool0", 5), ("tool0", 4))) == 0
    assert place(frames_of(("left/tool0", 5), ("x_tool0", 3))) == 0
    assert place(frames_of(("kr_tool0", 5), ("tool0", 5))) == 1
    assert place(frames_of(("mytool0", 5))) is None
    with pytest.raises(ModelError, match="several links could be tool0: a_tool0, b_tool0"):
        place(frames_of(("a_tool0", 5), ("b_tool0", 5)))


def covariance(*rows):
    return f'\n[covariance]\nparameters = ["k1", "k2"]\nmatrix = [{", ".join(map(str, rows))}]\n'


@pytest.mark.parametrize("scale", [1.0, 1e-12, 1e9])
@pytest.mark.parametrize(("correlation", "is_refused"), [(0.5, False), (1.0, False), (1.001, True)])
def test_a_covariance_has_no_negative_variance_in_any_direction_whatever_its_units(
    tmp_path, scale, correlation, is_refused
):
    text = covariance([scale, correlation * scale], [correlation * scale, scale])
    if is_refused:
        with pytest.raises(ModelError, match="is not symmetric positive semidefinite"):
            robot.load(written(tmp_path, MODEL + text))
        return
    found = robot.load(written(tmp_path, MODEL + text)).covariance
    names = [parameter.name for parameter in found.parameters]
    rows = [names.index("k1"), names.index("k2")]
    expected = scale * np.array([[1.0, correlation], [correlation, 1.0]])
    np.testing.assert_allclose(found.matrix[np.ix_(rows, rows)], expected)


def test_a_model_without_any_spread_has_no_covariance(tmp_path):
    text = "".join(line for line in MODEL.splitlines(keepends=True) if "sigma_percent" not in line)
    assert robot.load(written(tmp_path, text)).covariance is None
