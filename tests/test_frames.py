"""KUKA frames and SE(3), against scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from postproc import frames

angle = st.floats(-180.0, 180.0)
near_pole = st.sampled_from([90.0, -90.0, 89.9999999, -89.99999, 90.00000001, 0.0, 180.0, -180.0])


def test_units():
    assert frames.M_PER_MM * 1e3 == 1.0
    assert frames.MM_PER_M == 1e3
    assert (np.pi * frames.DEG_PER_RAD, 180.0 * frames.RAD_PER_DEG) == pytest.approx((180.0, np.pi), rel=1e-15)


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
    np.testing.assert_allclose(frames.twist_between(pose, frames.displace(pose, twist)), twist, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 4.9e-3, 5.1e-3, 0.02, 0.09, 0.5, 3.0])
def test_rotations_of_vectors_are_those_of_scipy_whatever_their_size(size):
    """Ten of one size at once: small ones are computed by a series."""
    vector = np.random.default_rng(8).normal(size=(10, 3))
    vector *= size / np.linalg.norm(vector, axis=1, keepdims=True)
    expected = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(frames.rotation_from_vector(vector), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(frames.rotation_vector(expected), vector, rtol=0, atol=1e-14)


def test_inverse_undoes_a_pose():
    pose = frames.pose_from_xyzabc([[100.0, 200, 300, 10, 20, 30]])
    np.testing.assert_allclose(frames.inverse(pose) @ pose, np.eye(4)[None], atol=1e-15)


def test_interpolation_turns_about_one_axis_and_moves_on_a_line():
    a, b = frames.pose_from_xyzabc([[0.0, 0, 0, 0, 0, 0], [100.0, 0, 0, 90, 0, 0]])
    middle = frames.interpolate(a[None], b[None], np.array([0.5]))
    np.testing.assert_allclose(frames.xyzabc_from_pose(middle)[0], [50, 0, 0, 45, 0, 0], atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-7, 1e-3, 1.0, 3.0])
def test_angle_between_rotations_is_that_of_the_rotation_from_one_to_the_other(size):
    axis = np.array([[0.6, -0.64, 0.48]])
    one = frames.rotation_from_vector(np.array([[0.3, -1.0, 0.8]]))
    other = frames.rotation_from_vector(size * axis) @ one
    assert frames.angle_between(one, other) == pytest.approx(size, rel=1e-3 if size < 1e-9 else 1e-8, abs=1e-15)


def random_poses(count, seed=3):
    rng = np.random.default_rng(seed)
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    pose[:, :3, 3] = rng.normal(size=(count, 3))
    return pose


@pytest.mark.parametrize("size", [1e-4, 1e-3, 4.9e-3, 5.1e-3, 9e-3, 1.0])
def test_rotations_about_an_axis_of_the_frame_are_sine_and_cosine_to_the_last_digit(size):
    for axis in range(3):
        vector = size * np.eye(3)[axis]
        j, k = (axis + 1) % 3, (axis + 2) % 3
        rotation = frames.rotation_from_vector(vector)
        assert rotation[k, j] == pytest.approx(np.sin(size), rel=4e-16)
        assert rotation[j, k] == pytest.approx(-np.sin(size), rel=4e-16)
        np.testing.assert_allclose(rotation[[axis, j, k], [axis, j, k]], [1, np.cos(size), np.cos(size)], atol=2e-16)
        np.testing.assert_allclose(frames.rotation_vector(rotation), vector, rtol=1e-15, atol=1e-16)


@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 0.2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rotation_vectors_near_half_a_turn_are_exact_whatever_the_axis(off, sign):
    axes = np.concatenate([np.eye(3), np.random.default_rng(4).normal(size=(30, 3)), [[1, 1, 0], [-1, 0, 2]]])
    axes = sign * axes / np.linalg.norm(axes, axis=1)[:, None]
    vector = (np.pi - off) * axes
    rotation = Rotation.from_rotvec(vector).as_matrix()
    found = frames.rotation_vector(rotation)
    assert np.abs(frames.norm(found) - (np.pi - off)).max() < 1e-14
    np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), rotation, rtol=0, atol=2e-15)
    if off >= 1e-12:
        np.testing.assert_allclose(found, vector, rtol=0, atol=1e-14)
    else:  # both signs mean the same: the largest entry is positive
        assert (found[np.arange(len(found)), np.abs(found).argmax(axis=1)] > 0.0).all() or off == 0.0
    one = np.array([frames.rotation_vector(each) for each in rotation])
    np.testing.assert_array_equal(one, found)
    pairs = rotation[:34].reshape(2, 17, 3, 3)
    np.testing.assert_array_equal(frames.rotation_vector(pairs), found[:34].reshape(2, 17, 3))


def test_rotation_vectors_of_turns_of_any_size_at_once_are_those_of_scipy():
    vector = np.random.default_rng(5).normal(size=(200, 3))
    vector *= (np.linspace(0.0, 3.14, 200) / np.linalg.norm(vector, axis=1))[:, None]
    rotation = Rotation.from_rotvec(vector).as_matrix()
    np.testing.assert_allclose(frames.rotation_vector(rotation), vector, rtol=0, atol=3e-14)
    np.testing.assert_allclose(frames.rotation_from_vector(vector), rotation, rtol=0, atol=1e-15)
    quarter = np.diag([-1.0, -1.0, 1.0])  # no sine, and no small turn
    np.testing.assert_allclose(frames.rotation_vector(quarter), [0, 0, np.pi], atol=1e-15)
    np.testing.assert_allclose(frames.rotation_vector(np.diag([1.0, -1.0, -1.0])), [np.pi, 0, 0], atol=1e-15)


def test_half_a_turn_about_the_bisector_of_two_axes_is_not_taken_for_none():
    for pair in ([0, 1], [0, 2], [1, 2]):
        axis = np.zeros(3)
        axis[pair] = np.sqrt(0.5)
        for off in (0.0, 1e-15, 1e-5, 1e-3):
            turn = Rotation.from_rotvec((np.pi - off) * axis).as_matrix()
            np.testing.assert_allclose(frames.norm(frames.rotation_vector(turn)), np.pi - off, rtol=1e-14)


def test_products_inverses_and_twists_are_those_of_matrices():
    one, other, third = random_poses(20), random_poses(20, 4), random_poses(20, 5)
    for left in (one[0], one):
        for right in (third[0], third):
            expected = np.array(
                [
                    a @ b @ c
                    for a, b, c in zip(
                        np.broadcast_to(left, one.shape), other, np.broadcast_to(right, one.shape), strict=True
                    )
                ]
            )
            np.testing.assert_allclose(frames.product(left, other, right), expected, rtol=0, atol=2e-14)
    np.testing.assert_allclose(frames.product(one[0], other), one[0] @ other, rtol=0, atol=1e-14)
    np.testing.assert_allclose(frames.inverse(one), np.linalg.inv(one), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(frames.inverse(one)[:, 3], np.tile([0.0, 0, 0, 1], (20, 1)))
    twist = frames.twist_between(one, other)
    turn = Rotation.from_matrix(other[:, :3, :3] @ np.swapaxes(one[:, :3, :3], 1, 2)).as_rotvec()
    np.testing.assert_allclose(twist, np.concatenate([(other - one)[:, :3, 3], turn], axis=1), rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        frames.twist_between(one[0], other), [frames.twist_between(one[0], b) for b in other], atol=1e-15
    )
    moved = frames.displace(one[0], twist)
    np.testing.assert_allclose(moved[:, :3, 3], one[0, :3, 3] + twist[:, :3], rtol=0, atol=1e-15)
    np.testing.assert_allclose(moved[:, :3, :3], Rotation.from_rotvec(turn).as_matrix() @ one[0, :3, :3], atol=1e-14)
    np.testing.assert_array_equal(moved[:, 3], np.tile([0.0, 0, 0, 1], (20, 1)))


def test_interpolated_poses_are_those_of_scipys_slerp_each_at_its_own_place():
    one, other = random_poses(8), random_poses(8, 4)
    t = np.linspace(0.0, 1.0, 8)
    found = frames.interpolate(one, other, t)
    for row in range(8):
        between = Slerp([0.0, 1.0], Rotation.from_matrix([one[row, :3, :3], other[row, :3, :3]]))(t[row])
        np.testing.assert_allclose(found[row, :3, :3], between.as_matrix(), rtol=0, atol=1e-12)
        expected = (1.0 - t[row]) * one[row, :3, 3] + t[row] * other[row, :3, 3]
        np.testing.assert_allclose(found[row, :3, 3], expected, rtol=0, atol=1e-14)


def test_rows_are_looked_at_whole():
    values = np.array([[1.0, -5.0, 2.0], [-1.0, 0.5, 0.25], [0.0, 0.0, 7.0]])
    assert frames.largest(values).tolist() == [5.0, 1.0, 7.0]
    truths = values > 1.5
    assert frames.any_column(truths).tolist() == [True, False, True]
    np.testing.assert_allclose(frames.norm(values), np.linalg.norm(values, axis=1), rtol=1e-15)
    a, b = np.random.default_rng(6).normal(size=(2, 5, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", frames.hat(a), b), np.cross(a, b), rtol=0, atol=1e-15)
    angle = np.linspace(-400.0, 400.0, 4001)
    np.testing.assert_allclose(frames.sine_and_cosine(angle), [np.sin(angle), np.cos(angle)], rtol=0, atol=1e-13)
    near = np.linspace(-3.2, 3.2, 1001)
    np.testing.assert_allclose(frames.sine_and_cosine(near), [np.sin(near), np.cos(near)], rtol=0, atol=6e-16)


@given(st.floats(-180.0, 180.0), st.sampled_from([90.0, -90.0]), st.floats(-180.0, 180.0))
def test_at_the_pole_a_is_zero_and_close_to_it_a_is_found(a, b, c):
    at = frames.xyzabc_from_pose(frames.pose_from_xyzabc([1.0, -2.0, 3.0, a, b, c]))
    np.testing.assert_allclose(at[[0, 1, 2, 3, 4]], [1.0, -2.0, 3.0, 0.0, b], rtol=0, atol=1e-6)
    near = frames.xyzabc_from_pose(frames.pose_from_xyzabc([0.0, 0, 0, a, b * (1.0 - 1e-6), c]))
    assert (near[3] - a + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-4)


def test_any_number_of_leading_axes_is_worked_on_pose_by_pose():
    one, other = random_poses(6).reshape(2, 3, 4, 4), random_poses(6, 4).reshape(2, 3, 4, 4)
    twist = np.random.default_rng(7).normal(size=(2, 3, 6))
    for index in np.ndindex(2, 3):
        a, b, t = one[index], other[index], twist[index]
        for together, alone in (
            (frames.displace(one, twist), frames.displace(a, t)),
            (frames.displace(one[0, 0], twist), frames.displace(one[0, 0], t)),
            (frames.displace(one, twist[0, 0]), frames.displace(a, twist[0, 0])),
            (frames.twist_between(one, other), frames.twist_between(a, b)),
            (frames.inverse(one), frames.inverse(a)),
            (frames.xyzabc_from_pose(one), frames.xyzabc_from_pose(a)),
            (frames.pose_from_xyzabc(twist), frames.pose_from_xyzabc(t)),
            (frames.hat(twist[..., :3]), frames.hat(t[:3])),
            (frames.interpolate(one, other, np.full((2, 3), 0.3)), frames.interpolate(a, b, np.array(0.3))),
        ):
            np.testing.assert_allclose(together[index], alone, rtol=0, atol=1e-12)


def test_a_rigid_displacement_is_that_of_its_points_and_no_turn_that_they_do_not_show():
    rng = np.random.default_rng(12)
    turn = np.array([3e-4, -5e-4, 2e-4])
    points, weight = rng.uniform([1.2, -0.1, 0.4], [1.8, 0.5, 1.0], (20, 3)), rng.uniform(0.1, 2.0, 20)
    shift = np.array([1e-3, -2e-3, 5e-4]) + np.cross(turn, points)
    found = frames.rigid_displacement(points, shift, weight)
    assert points @ found[:3, :3].T + found[:3, 3] == pytest.approx(points + shift, abs=1e-6)  # of second order
    line = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    found = frames.rigid_displacement(line, np.cross(turn, line), np.ones(3))
    assert frames.rotation_vector(found[:3, :3]) == pytest.approx(turn * [0.0, 1.0, 1.0], abs=1e-9)
    found = frames.rigid_displacement(line[:1], np.array([[1e-3, 2e-3, 3e-3]]), np.ones(1))
    assert (found[:3, :3] == np.eye(3)).all()
    assert found[:3, 3] == pytest.approx([1e-3, 2e-3, 3e-3])
    heavy = frames.rigid_displacement(line[:2], np.array([[0.0, 0.0, 1e-3], [0.0, 0.0, 3e-3]]), np.array([3.0, 1.0]))
    assert (heavy @ [1.25, 0.0, 0.0, 1.0])[2] == pytest.approx(1.5e-3, abs=1e-8)  # of the centre by weight
