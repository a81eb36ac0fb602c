"""Holder, spindle and tool as a spring in series, against the minimum of an energy that has them in it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from postproc import cell as cells
from postproc import elastostatics
from postproc.elastostatics import ToolSpring
from postproc.under_load import RobotInCell
from tests.kr270 import CELL, FOLDER, ROBOT, TOOL
from tests.oracle.arm import Arm

ARM = Arm.load(FOLDER)
SOFT = cells.ToolCompliance(0.3, 0.2, 0.05, 20.0, 10.0, 5.0)
SETTING = RobotInCell.of(ROBOT, msgspec.structs.replace(CELL, tool_compliance=SOFT))
Q = np.radians([[10.0, -70, 105, 20, 50, -30], [-35.0, -50, 90, -100, -70, 80]])
FORCE = np.array([[800.0, -600, 300, 0, 0, 0], [-300.0, 900, -1200, 0, 0, 0]])


def by_energy(q, wrench):
    """Tip (3,) and displacement of the tool (3,) where the energy of arm and tool has its minimum."""
    stiffness, reference = 1.0 / SOFT.diagonal()[:3], ARM.reference(q)
    scale = np.concatenate([ARM.stiffness, stiffness])

    def potential(state):
        theta, delta = state[:6], state[6:]
        pose = ARM.tcp(q + theta, TOOL)
        arm = ARM.potential(theta, q, TOOL, wrench[:3], reference)
        return arm + 0.5 * np.sum(stiffness * delta**2) - np.dot(wrench[:3], pose[:3, :3] @ delta)

    found = root(lambda s: ARM.gradient(potential, s / scale), np.zeros(9), options={"xtol": 1e-13})
    assert np.abs(found.fun).max() < 1e-6
    state = found.x / scale
    pose = ARM.tcp(q + state[:6], TOOL)
    moved = pose[:3, :3] @ state[6:]
    return pose[:3, 3] + moved, moved


def test_the_loaded_tip_stands_at_the_minimum_of_the_energy():
    tip, by_tool = SETTING.tip_and_tool_deflection(Q, TOOL, FORCE)
    for row in range(len(Q)):
        expected, moved = by_energy(Q[row], FORCE[row])
        np.testing.assert_allclose(tip[row], expected, rtol=0, atol=2e-9)
        np.testing.assert_allclose(by_tool[row], moved, rtol=0, atol=2e-9)
        assert np.linalg.norm(moved) > 1e-4


def test_the_command_puts_that_minimum_at_the_target():
    target = np.array([ARM.nominal_tcp(q, TOOL) for q in Q])
    found = SETTING.compensate(target, Q, TOOL, FORCE)
    for row in range(len(Q)):
        assert np.linalg.norm(by_energy(found.q[row], FORCE[row])[0] - target[row, :3, 3]) < 5e-9


def test_a_moment_turns_the_tool_and_the_command_turns_it_back():
    """The tool twists by C·M in its own axes: turned back, it stands as the target asks."""
    moment = np.array([[0.0, 0, 0, 40.0, -60, 30]])
    target = ARM.nominal_tcp(Q[0], TOOL)[None]
    found = SETTING.compensate(target, Q[:1], TOOL, moment)
    held = ARM.loaded_tcp(found.q[0], TOOL, moment[0])
    twist = held[:3, :3].T @ target[0, :3, :3]
    vector = 0.5 * np.array([twist[2, 1] - twist[1, 2], twist[0, 2] - twist[2, 0], twist[1, 0] - twist[0, 1]])
    expected = SOFT.diagonal()[3:] * (held[:3, :3].T @ moment[0, 3:])
    np.testing.assert_allclose(vector, expected, rtol=1e-5)
    np.testing.assert_allclose(held[:3, 3], target[0, :3, 3], atol=1e-8)


WRENCH = np.array([[800.0, -600, 300, 250, -400, 300], [-300.0, 900, -1200, -350, 150, 420]])


def series(q, wrench):
    """Position and orientation of the tip of arm and tool in series under a wrench, and the deflection of the tool.

    The tool shifts and turns by C·Rᵀ·(force, moment) from where the arm holds it, R its orientation there; the arm
    feels the force where the tip has gone.
    """
    moved, compliance = np.zeros(3), SOFT.diagonal()
    for _ in range(30):
        at_arm = np.concatenate([wrench[:3], wrench[3:] + np.cross(moved, wrench[:3])])
        held = ARM.loaded_tcp(q, TOOL, at_arm)
        turned = held[:3, :3]
        before, moved = moved, turned @ (compliance[:3] * (turned.T @ wrench[:3]))
        if np.abs(moved - before).max() < 1e-13:
            break
    turn = turned @ (compliance[3:] * (turned.T @ wrench[3:]))
    return held[:3, 3] + moved, Rotation.from_rotvec(turn).as_matrix() @ turned, moved


def test_force_and_moment_together_shift_and_turn_the_tip_as_arm_and_tool_in_series():
    tip, by_tool = SETTING.tip_and_tool_deflection(Q, TOOL, WRENCH)
    np.testing.assert_array_equal(SETTING.tip(Q, TOOL, WRENCH), tip)
    for row in range(len(Q)):
        expected, _, moved = series(Q[row], WRENCH[row])
        np.testing.assert_allclose(tip[row], expected, rtol=0, atol=3e-9)
        np.testing.assert_allclose(by_tool[row], moved, rtol=0, atol=3e-9)
    guess = elastostatics.deflect(SETTING.robot, Q, TOOL, WRENCH).theta
    np.testing.assert_allclose(SETTING.tip_and_tool_deflection(Q, TOOL, WRENCH, guess)[0], tip, rtol=0, atol=3e-9)


def test_the_command_puts_the_tip_at_its_target_and_turns_it_back():
    target = np.array([ARM.nominal_tcp(q, TOOL) for q in Q])
    found = SETTING.compensate(target, Q, TOOL, WRENCH)
    for row in range(len(Q)):
        tip, turned, _ = series(found.q[row], WRENCH[row])
        np.testing.assert_allclose(tip, target[row, :3, 3], rtol=0, atol=2e-8)
        np.testing.assert_allclose(turned, target[row, :3, :3], rtol=0, atol=2e-8)


def test_each_of_the_six_compliances_shifts_or_turns_along_its_own_axis_of_the_tool():
    turned = Rotation.from_euler("ZYX", [[30.0, -50, 110], [-70.0, 20, 10]], degrees=True).as_matrix()
    spring = ToolSpring(SOFT.diagonal())
    found = spring.deflection(turned, WRENCH)
    matrices = spring.matrices(turned)
    for row in range(2):
        axes = np.block([[turned[row], np.zeros((3, 3))], [np.zeros((3, 3)), turned[row]]])
        expected = axes @ np.diag(SOFT.diagonal()) @ axes.T
        np.testing.assert_allclose(matrices[row], expected, rtol=0, atol=1e-18)
        np.testing.assert_allclose(found[row], expected @ WRENCH[row], rtol=1e-12)


def test_the_tool_of_the_cell_adds_to_the_softness_of_the_robot():
    rigid = RobotInCell.of(ROBOT, CELL).tip_compliance(TOOL)
    soft = SETTING.tip_compliance(TOOL)
    assert np.subtract(soft, rigid) == pytest.approx([0.3e-6, 20e-6], rel=1e-9)
    by_force = [ARM.loaded_tcp(CELL.start_joints, TOOL, unit)[:3, 3] for unit in np.eye(6)]
    away = np.linalg.norm(by_force - ARM.tcp(CELL.start_joints, TOOL)[:3, 3], axis=1)
    assert rigid == pytest.approx([away[:3].max(), away[3:].max()], rel=1e-3)


def test_a_rigid_tool_changes_nothing():
    assert RobotInCell.of(ROBOT, CELL).tool_spring is None
    tip, by_tool = RobotInCell.of(ROBOT, CELL).tip_and_tool_deflection(Q, TOOL, FORCE)
    assert not by_tool.any()
    assert tip[0] == pytest.approx(ARM.loaded_tcp(Q[0], TOOL, FORCE[0])[:3, 3], abs=2e-9)


def test_a_negative_compliance_is_refused(tmp_path):
    text = (Path(CELL.folder) / "cell_kr270.toml").read_text() + "\n[tool_compliance]\nX_um_per_N = -0.1\n"
    (tmp_path / "cell.toml").write_text(text)
    with pytest.raises(cells.CellError, match=r"tool_compliance\.X_um_per_N"):
        cells.load(tmp_path / "cell.toml")
