"""KUKA frames and SE(3), against scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from postproc import frames

angle = st.floats(-180.0, 180.0)
near_pole = st.sampled_from([90.0, -90.0, 89.9999999, -89.99999, 90.00000001, 0.0, 180.0, -180.0])


@given(angle, st.one_of(angle, near_pole), angle)
def test_kuka_frame_is_rz_ry_rx(a, b, c):
    pose = frames.pose_from_xyzabc([10.0, -20.0, 30.0, a, b, c])
    expected = Rotation.from_euler("ZYX", [a, b, c], degrees=True).as_matrix()
    np.testing.assert_allclose(pose[:3, :3], expected, atol=1e-14)
    np.testing.assert_allclose(pose[:3, 3], [0.01, -0.02, 0.03])


@given(angle, st.one_of(angle, near_pole), angle)
def test_abc_of_a_pose_compose_to_the_same_pose_even_at_b_90(a, b, c):
    pose = frames.pose_from_xyzabc([1.0, 2.0, 3.0, a, b, c])
    again = frames.pose_from_xyzabc(frames.xyzabc_from_pose(pose))
    np.testing.assert_allclose(again, pose, atol=1e-9, rtol=0)


def test_at_b_90_a_is_zero_so_that_equal_orientations_print_equal():
    for a, c in ((10.0, 10.0), (-170.0, -170.0), (33.3, 33.3)):
        printed = frames.xyzabc_from_pose(frames.pose_from_xyzabc([0, 0, 0, a, 90.0, c]))[3:]
        np.testing.assert_allclose(printed, [0, 90, 0], atol=1e-9)


@given(angle, st.one_of(angle, near_pole), angle)
def test_abc_rounded_as_printed_moves_the_orientation_by_no_more_than_the_rounding(a, b, c):
    pose = frames.pose_from_xyzabc([1.0, 2.0, 3.0, a, b, c])
    printed = np.round(frames.xyzabc_from_pose(pose), 5)
    moved = frames.twist_between(pose, frames.pose_from_xyzabc(printed))
    assert np.linalg.norm(np.degrees(moved[3:])) <= 1.5e-5


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-6, 4e-3, 0.1, 1.0, 3.0, np.pi - 1e-3, np.pi - 1e-9])
def test_rotation_vector_returns_what_made_the_rotation(size):
    rng = np.random.default_rng(1)
    axis = rng.normal(size=(50, 3))
    vector = size * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    rotation = frames.rotation_from_vector(vector)
    np.testing.assert_allclose(rotation, Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(frames.rotation_vector(rotation), vector, atol=1e-12 + 2e-8 * (size > 3.1))


def test_displaced_and_twist_between_are_inverse():
    rng = np.random.default_rng(2)
    pose = frames.pose_from_xyzabc(rng.uniform(-180, 180, (20, 6)))
    twist = rng.normal(size=(20, 6))
    twist[:, 3:] *= 0.5
    np.testing.assert_allclose(frames.twist_between(pose, frames.displaced(pose, twist)), twist, atol=1e-12)


def test_inverse_undoes_a_pose():
    pose = frames.pose_from_xyzabc([[100.0, 200, 300, 10, 20, 30]])
    np.testing.assert_allclose(frames.inverse(pose) @ pose, np.eye(4)[None], atol=1e-15)


def test_interpolation_turns_about_one_axis_and_moves_on_a_line():
    a, b = frames.pose_from_xyzabc([[0.0, 0, 0, 0, 0, 0], [100.0, 0, 0, 90, 0, 0]])
    middle = frames.interpolated(a[None], b[None], np.array([0.5]))
    np.testing.assert_allclose(frames.xyzabc_from_pose(middle)[0], [50, 0, 0, 45, 0, 0], atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-7, 1e-3, 1.0, 3.0])
def test_angle_between_rotations_is_that_of_the_rotation_from_one_to_the_other(size):
    axis = np.array([[0.6, -0.64, 0.48]])
    one = frames.rotation_from_vector(np.array([[0.3, -1.0, 0.8]]))
    other = frames.rotation_from_vector(size * axis) @ one
    assert frames.angle_between(one, other) == pytest.approx(size, rel=1e-3 if size < 1e-9 else 1e-8, abs=1e-15)
