"""Joints that stand elsewhere than their angle says, once and twice a turn: against Pinocchio, files, programs."""

import json

import msgspec
import numpy as np
import pytest

from postproc import elastostatics, frames, kinematics, robot
from postproc.elastostatics import compensate
from postproc.errors import ModelError
from postproc.robot import LinkSprings
from postproc.robot.model_file import TransmissionEntry
from tests.commands import invoke
from tests.kr270 import CONTENT, FOLDER, OFFSET_TOOL
from tests.oracle.pinocchio_arm import Arm

URDF = (FOLDER / "robot.urdf").read_text(encoding="utf-8")
NOMINAL = robot.load(FOLDER).nominal
KEYS = ("sin_urad", "cos_urad", "sin2_urad", "cos2_urad")


def waves(rng, size):
    return dict(zip(robot.JOINTS, rng.uniform(-size, size, (6, 4)), strict=True))


def with_waves(amplitude, **changes):
    entries = {
        joint: TransmissionEntry(source="test", **dict(zip(KEYS, values.tolist(), strict=True)))
        for joint, values in amplitude.items()
    }
    return robot.assemble("waves", msgspec.structs.replace(CONTENT, transmission=entries, **changes), NOMINAL)


def stands(amplitude, q):
    """Where the joints stand, by the formula of docs/reference."""
    out = q.copy()
    for joint, (sin, cos, sin2, cos2) in enumerate(amplitude.values()):
        for row, angle in enumerate(q[:, joint]):
            more = sin * np.sin(angle) + cos * np.cos(angle) + sin2 * np.sin(2 * angle) + cos2 * np.cos(2 * angle)
            out[row, joint] += 1e-6 * more
    return out


@pytest.mark.parametrize("size", [0.0, 300.0, 1e4])
def test_the_arm_stands_where_pinocchio_puts_it_and_the_command_is_found_back(size):
    rng = np.random.default_rng(1)
    amplitude = waves(rng, size)
    model, arm = with_waves(amplitude), Arm(URDF)
    q = rng.uniform(model.lower, model.upper, (30, 6))
    x = elastostatics.coordinates(model, q)
    np.testing.assert_allclose(x, stands(amplitude, q), atol=1e-14)
    np.testing.assert_allclose(elastostatics.balance.joint_angles(model, x.T).T, q, atol=1e-13)
    pose = elastostatics.deflect(model, q, OFFSET_TOOL, np.zeros((30, 6))).pose
    np.testing.assert_allclose(pose, arm.tcp(stands(amplitude, q), OFFSET_TOOL)[0], atol=1e-12)
    assert model.geometry_is_nominal == (size == 0.0)
    # the controller knows nothing of it
    np.testing.assert_array_equal(
        kinematics.tcp(model.nominal, q, OFFSET_TOOL)[0], kinematics.tcp(NOMINAL, q, OFFSET_TOOL)[0]
    )


@pytest.mark.parametrize("links", [{}, {"A2": LinkSprings(source="test", Y_um_per_N=0.05, RX_urad_per_Nm=0.2)}])
@pytest.mark.parametrize("reference", ["calibrated", "rigid"])
def test_a_loaded_tool_stands_at_its_target_as_pinocchio_puts_it(links, reference):
    rng = np.random.default_rng(2)
    amplitude = waves(rng, 400.0)
    model = with_waves(amplitude, links=links, gravity=msgspec.structs.replace(CONTENT.gravity, reference=reference))
    arm = Arm(URDF, springs=[(spring.link, spring.axis) for spring in model.link_springs])
    q = np.radians([5.0, -70.0, 105.0, 20.0, 50.0, 30.0]) + rng.uniform(-0.2, 0.2, (20, 6))
    target, wrench = (
        kinematics.tcp(model.nominal, q, OFFSET_TOOL)[0],
        rng.normal(size=(20, 6)) * [400, 400, 400, 30, 30, 30],
    )
    found = compensate(model, target, q, OFFSET_TOOL, wrench)
    x = found.theta.copy()
    x[:, arm.actuated] += stands(amplitude, found.q)
    np.testing.assert_allclose(arm.tcp(x, OFFSET_TOOL)[0], target, atol=1e-9)
    np.testing.assert_allclose(found.pose, kinematics.tcp(NOMINAL, found.q, OFFSET_TOOL)[0], atol=1e-12)
    loaded = elastostatics.deflect(model, found.q, OFFSET_TOOL, wrench)
    np.testing.assert_allclose(loaded.pose, target, atol=2e-8)
    np.testing.assert_allclose(loaded.theta, found.theta, atol=2e-8)


def test_a_program_is_corrected_and_simulated_with_it(tmp_path):
    """Without forces: `predict` sees what the gears do, as Pinocchio computes it, and `convert` takes it out."""
    amplitude = waves(np.random.default_rng(3), 300.0)
    folder = tmp_path / "wavy"
    folder.mkdir()
    (folder / "robot.urdf").write_text(URDF, encoding="utf-8")
    (folder / "model.toml").write_bytes(
        (FOLDER / "model.toml").read_bytes()
        + "".join(
            f'\n[transmission.{joint}]\nsource = "test"\n'
            + "".join(f"{key} = {value:.6f}\n" for key, value in zip(KEYS, values, strict=True))
            for joint, values in amplitude.items()
        ).encode()
    )
    (tmp_path / "cell.toml").write_text(
        'robot = "wavy"\n[base]\nX = 1500.0\nZ = 700.0\n[tool]\nZ = 350.0\n[start]\njoints = [0, -70, 110, 0, 50, 0]\n'
    )
    (tmp_path / "part.nc").write_text("G21 G90\nG0 X0 Y0 Z20\nG1 Z-2 F600\nX200\nY150\nX-80 Y-60\nM30\n")
    arm, tool = Arm(URDF), frames.pose_from_xyzabc([0.0, 0.0, 350.0, 0.0, 0.0, 0.0])
    rows = {}
    for command in ("predict", "convert"):
        run = invoke(command, tmp_path / "part.nc", "-o", tmp_path / "out", cell=tmp_path / "cell.toml")
        assert run.exit_code in (0, 3), run.output
        name = "part.predict" if command == "predict" else "part"
        table = (tmp_path / "out" / f"{name}.targets.csv").read_text().splitlines()
        head = table[0].split(",")
        rows[command] = [dict(zip(head, line.split(","), strict=True)) for line in table[1:]]
    assert max(float(row["before_mm"]) for row in rows["predict"]) > 0.2
    for command in ("predict", "convert"):
        for row in rows[command]:
            q = np.radians([[float(row[joint]) for joint in robot.JOINTS]])
            tip = arm.tcp(stands(amplitude, q), tool)[0][0, :3, 3] * 1e3 - [1500.0, 0.0, 700.0]
            off = np.linalg.norm(tip - [float(row[axis]) for axis in "XYZ"])
            limit = float(row["before_mm"]) if command == "predict" else 0.0
            assert off == pytest.approx(limit, abs=2e-3)
    report = json.loads((tmp_path / "out" / "part.report.json").read_text())
    assert report["after"]["max_mm"] < 1e-3 < 0.2 < report["before"]["max_mm"]


def test_a_model_file_that_names_no_joint_or_an_impossible_amplitude_is_refused(tmp_path):
    (tmp_path / "robot.urdf").write_text(URDF, encoding="utf-8")
    text = (FOLDER / "model.toml").read_text(encoding="utf-8")
    for table, message in (
        ('[transmission.A7]\nsource = "x"\n', "unknown joint 'A7'"),
        ('[transmission.A3]\nsin_urad = 2e4\nsource = "x"\n', "sin_urad"),
        ('[transmission.A3]\nsin3_urad = 2\nsource = "x"\n', "sin3_urad"),
    ):
        (tmp_path / "model.toml").write_text(text + table, encoding="utf-8")
        with pytest.raises(ModelError, match=message):
            robot.load(tmp_path)
