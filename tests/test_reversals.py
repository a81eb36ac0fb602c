"""Reversals of joint torques, and the step of lost motion that belongs to them."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import elastostatics, robot
from postproc.frames import rotation_from_vector
from postproc.robot import Backlash, LostMotion
from tests.kr270 import ROBOT, STRAIGHT_TOOL

POSE = np.radians([[10.0, -70.0, 100.0, 20.0, 50.0, 0.0]])
ANGLE = 50e-6


def _sweep(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """One pose, a force across the arm from one side to the other."""
    force = np.linspace(-600.0, 600.0, count)
    wrench = np.zeros((count, 6))
    wrench[:, 1] = force
    return np.repeat(POSE, count, axis=0), wrench


def _total(model: robot.RobotModel, q: np.ndarray, wrench: np.ndarray) -> np.ndarray:
    """Torque on the gears by the potential: a difference of the work of force and weights, no Jacobian."""
    step = 1e-6

    def work(angles: np.ndarray) -> np.ndarray:
        frames, flange = model.loaded.joint_frames(angles)
        tip = flange @ STRAIGHT_TOOL
        weight = np.zeros(len(angles))
        for joint in range(6):
            turn = rotation_from_vector(angles[:, joint, None] * model.loaded.axis[joint])
            arm = np.einsum("nab,nbc,c->na", frames[:, joint, :3, :3], turn, model.loaded.centre[joint])
            weight += 9.81 * model.loaded.mass[joint] * (frames[:, joint, 2, 3] + arm[:, 2])
        law = model.compensator
        length = np.sqrt(law.ax**2 + law.ay**2 + law.L**2 + 2 * np.hypot(law.ax, law.ay) * law.L
                         * np.cos(np.arctan2(law.ay, law.ax) - angles[:, 1]))  # fmt: skip
        spring = 0.5 * law.stiffness * (length - law.free_length) ** 2
        return np.einsum("na,na->n", tip[:, :3, 3], wrench[:, :3]) - weight - spring

    return np.stack([(work(q + d) - work(q - d)) / (2 * step) for d in step * np.eye(6)], axis=1)


def test_reversals_are_where_the_total_torque_changes_its_sign():
    q, wrench = _sweep()
    torque = _total(ROBOT, q, wrench)
    found = elastostatics.reversals(ROBOT, q, STRAIGHT_TOOL, wrench)
    expected = {
        (row + 1, joint)
        for joint in range(6)
        for row in range(len(q) - 1)
        if torque[row, joint] * torque[row + 1, joint] < 0.0 and np.abs(torque[:, joint]).max() > 1e-3
    }
    rows = {(int(row), int(joint)) for row, joint in zip(found.row, found.joint, strict=True)}
    assert rows == expected
    assert {joint for _, joint in rows} == {0, 3, 4}
    assert (found.step == 0.0).all()


@pytest.mark.parametrize("kind", [Backlash, LostMotion])
def test_the_step_is_what_the_tool_moves_as_the_gear_turns_over(kind):
    """Against the equilibrium on both sides of the reversal, at a torque that hardly bends the springs."""
    model = replace(ROBOT, terms=((kind("A1", 1.0), ANGLE),))
    q, wrench = _sweep()
    found = elastostatics.reversals(model, q, STRAIGHT_TOOL, wrench)
    (at,) = np.flatnonzero(found.joint == 0)
    small = np.zeros((2, 6))
    small[:, 1] = (-20.0, 20.0)
    both = np.repeat(POSE, 2, axis=0)
    loose, tight = (elastostatics.deflect(each, both, STRAIGHT_TOOL, small).twist[:, :3] for each in (model, ROBOT))
    step = np.linalg.norm(np.diff(loose - tight, axis=0))
    assert found.step[at] == pytest.approx(step, rel=1e-3)
    assert found.step[at] > 1e-4
    assert found.previous_row[at] < found.row[at]


def test_backlash_under_the_weights_turns_over_with_the_total_torque():
    """In gears that carry the weights, the load and the torque at rest press on a flank together."""
    backlash = {Backlash(joint, 1e-6): ANGLE for joint in ("A3", "A4", "A5")}
    model = replace(ROBOT.with_values(backlash), carries_weight=True)
    q, wrench = _sweep()
    wrench[:, 2] = 6.0 * wrench[:, 1]
    torque = _total(ROBOT, q, wrench)
    found = elastostatics.reversals(model, q, STRAIGHT_TOOL, wrench)
    for joint in (2, 3, 4):
        expected = np.flatnonzero(torque[1:, joint] * torque[:-1, joint] < 0.0) + 1
        assert len(expected) == 1
        (row,) = found.row[found.joint == joint]
        assert expected[0] <= row <= expected[0] + 1  # a place between the flanks has no direction
        assert joint != 2 or abs(expected[0] - len(q) // 2) > 3  # the weights shift it


def test_a_torque_that_only_comes_near_zero_does_not_reverse():
    q, wrench = _sweep()
    wrench[:, 1] = np.abs(wrench[:, 1]) + 30.0
    found = elastostatics.reversals(ROBOT, q, STRAIGHT_TOOL, wrench)
    assert 0 not in found.joint


def test_the_bound_counts_the_flank_only_where_it_is_not_known():
    """Against draws of the flank, the upper one with the probability that gives the model's own mean."""
    lost = LostMotion("A1", 300.0)
    model = replace(ROBOT, terms=((lost, ANGLE),), covariance=replace(ROBOT.covariance, matrix=np.zeros((7, 7))))
    q, wrench = _sweep(9)
    bound = elastostatics.position_bound(model, q, STRAIGHT_TOOL, wrench)
    assert bound[4] == pytest.approx(1.96 * ANGLE * _lever(), rel=0.03)
    assert bound[[0, 8]].max() < 0.1 * bound[4]
    assert (np.diff(bound[:5]) > 0.0).all()
    rng = np.random.default_rng(7)
    torque = _total(ROBOT, q, wrench)[:, 0]
    mean = np.tanh(torque[3] / 300.0)
    drawn = np.where(rng.random(100_000) < 0.5 * (1.0 + mean), 1.0, -1.0) - mean
    assert bound[3] == pytest.approx(1.96 * np.sqrt(np.mean(drawn**2)) * ANGLE * _lever(), rel=0.03)
    turning = np.zeros((9, 6), dtype=bool)
    turning[0, 0] = True
    assert elastostatics.position_bound(model, q, STRAIGHT_TOOL, wrench, changes_flank=turning)[0] == pytest.approx(
        bound[4], rel=1e-6
    )


def test_the_bound_counts_what_the_payload_does():
    payload = ROBOT.with_payload(150.0, np.array([0.0, 0.0, 0.2]))
    only = replace(payload, covariance=robot.Covariance.of(["k3"], [[(0.25 * 0.416) ** 2]]))
    bound = elastostatics.position_bound(only, POSE, STRAIGHT_TOOL, np.zeros((1, 6)))[0]
    softer = replace(only, stiffness=np.diag(np.diag(only.stiffness) / np.array([1.0, 1.0, 1.001, 1.0, 1.0, 1.0])))
    moved = [elastostatics.deflect(each, POSE, STRAIGHT_TOOL, np.zeros((1, 6))).twist[0, :3] for each in (only, softer)]
    assert bound == pytest.approx(1.96 * 250.0 * np.linalg.norm(moved[1] - moved[0]), rel=0.03)


def _lever() -> float:
    """Distance of the tip from the axis of A1."""
    tip = (ROBOT.nominal.joint_frames(POSE)[1][0] @ STRAIGHT_TOOL)[:3, 3]
    return float(np.hypot(tip[0], tip[1]))
