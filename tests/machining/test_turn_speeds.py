"""Forces where the speed of turning slows the tip: those of a slot at the feed per tooth of the slower tip."""

from __future__ import annotations

import json

import numpy as np
import pytest

from postproc import machining, toolpath
from postproc.under_load import RobotInCell
from tests.commands import run
from tests.dialects.krl_programs import CELL, body
from tests.dialects.krl_programs import read as read_krl
from tests.dialects.test_rapid import place
from tests.dialects.test_rapid import read as read_rapid
from tests.dialects.test_rapid_reading import at, module, tail
from tests.kr270 import ROBOT
from tests.machining.setting import AL7075
from tests.machining.test_robot_tools import TWO_TOOLS_CELL

TEETH, DEPTH, RPM = 3, 3.0, 8000.0
PROCESS = f"""[material]
name = "al_7075_t6_carbide"
[tools.default]
diameter_mm = 10
flutes = {TEETH}
rpm = {RPM:g}
[stock]
box = {{ X = [-20, 220], Y = [-20, 80], Z = [-20, 0] }}
resolution_mm = 0.5
"""
TURNED = "[0,0.70710678,0.70710678,0]"
FEED = 50.0
"""$VEL.CP and v_tcp [mm/s]."""


def slot_force(speed):
    """Mean force of a full slot in FEED axes [N] (Altintas: φ from 0 to π), at a speed of the tip [mm/s]."""
    ktc, kte, krc, kre, kac, kae = AL7075
    chip = speed * 60.0 / (RPM * TEETH)
    along = -chip * krc / 4 - kre / np.pi
    across = chip * ktc / 4 + kte / np.pi
    axial = chip * kac / np.pi + kae / 2
    return TEETH * DEPTH * np.array([along, across, axial])


def krl(swivel, end):
    lines = ["$VEL.CP=0.05", *([] if swivel is None else [f"$VEL.ORI1={swivel}", f"$VEL.ORI2={swivel}"])]
    return body(*lines, f"PTP {{X 0,Y 0,Z {-DEPTH},A 0,B 0,C 180,S 2,T 10}}", end)


def krl_forces(folder, swivel, end):
    """Forces on a KRL program of two motions, the last of which cuts: the program, and `ProcessForces`."""
    (folder / "process.toml").write_text(PROCESS)
    program, setting = read_krl(krl(swivel, end)), RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, setting.start_flange)
    return program, machining.estimate(program, path, machining.load(folder / "process.toml"), setting.spindle)


def rapid_forces(folder, turn, command):
    (folder / "process.toml").write_text(PROCESS)
    speed = "v50" if turn is None else f"[{FEED:g},{turn},5000,1000]"
    code = [f"MoveJ {at(0, 0, -DEPTH)}{tail('v200', 'fine')}", "CirPathMode\\ObjectFrame;", command + tail(speed, "z1")]
    program = read_rapid(module(code))
    path = toolpath.segments(program, place().start_flange)
    return program, machining.estimate(program, path, machining.load(folder / "process.toml"), place().spindle)


def middle(found):
    """Wrench in FEED axes in the middle of the last motion (3,) [N]."""
    rows = found.cuts.motion == found.cuts.motion[-1]
    return np.array([np.interp(0.5, found.cuts.t[rows], found.cuts.wrench[rows, k]) for k in range(3)])


LINE, ARC = "LIN {X 100,Y 0,Z -3,A 90,B 0,C 180}", "CIRC {X 50,Y 50,Z -3},{X 100,Y 0,Z -3,A 90,B 0,C 180}"
MOVE_L = f"MoveL {at(100, 0, -3, TURNED)}"
MOVE_C = f"MoveC {at(50, 50, -3)},{at(100, 0, -3, TURNED)}"


@pytest.mark.parametrize(
    ("forces", "motion", "length"),
    [
        (krl_forces, LINE, 100.0),
        (krl_forces, ARC, 50 * np.pi),
        (rapid_forces, MOVE_L, 100.0),
        (rapid_forces, MOVE_C, 50 * np.pi),
    ],
)
def test_slow_turn_has_the_force_of_its_feed_per_tooth(tmp_path, forces, motion, length):
    program, found = forces(tmp_path, 10, motion)
    speed = length / 9.0  # 90° at 10 °/s
    np.testing.assert_allclose(middle(found), slot_force(speed), rtol=0.02, atol=2.0)
    (issue,) = (issue for issue in found.issues if issue.kind == "slow-turn")
    assert f"here from 3000 to {60 * speed:.0f} mm/min" in issue.message
    assert issue.source_line == program.motions.line[-1]
    # the program keeps its feed
    assert program.motions.feed[-1] == pytest.approx(FEED / 1e3, rel=1e-6)
    # at the programmed feed the force is another one, by more than the tolerance
    assert np.abs(slot_force(FEED) - slot_force(speed)).max() > 10.0


@pytest.mark.parametrize(("forces", "motion"), [(krl_forces, LINE), (krl_forces, ARC), (rapid_forces, MOVE_L)])
def test_turn_speed_that_does_not_bind_changes_nothing(tmp_path, forces, motion):
    _, stated = forces(tmp_path, 60, motion)  # 90° in 2 s are 45 °/s
    _, unstated = forces(tmp_path, None, motion)
    np.testing.assert_array_equal(stated.cuts.wrench, unstated.cuts.wrench)
    np.testing.assert_array_equal(stated.knots.wrench, unstated.knots.wrench)
    assert stated.issues == unstated.issues
    np.testing.assert_allclose(middle(stated), slot_force(FEED), rtol=0.02, atol=2.0)


def test_correction_is_that_of_the_same_program_with_the_slower_feed(tmp_path):
    """Text and feed of the written program stay; its correction is that of 11.111 mm/s."""
    (tmp_path / "cell.toml").write_text(TWO_TOOLS_CELL.format(length=320.0))
    (tmp_path / "process.toml").write_text(PROCESS)
    options = ("--cell", tmp_path / "cell.toml", "--process", tmp_path / "process.toml", "-o", tmp_path / "out")
    written = {}
    for name, turn, feed in (("turned", 10, "0.05"), ("slow", 200, f"{1 / 90:.9f}")):
        lines = [
            "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}", "$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}", f"$VEL.ORI1={turn}",
            f"$VEL.ORI2={turn}", "$VEL.CP=0.05", "PTP {X 0,Y 0,Z 50,A 180,B 0,C 180}", "LIN {X 0,Y 0,Z -3}",
            f"$VEL.CP={feed}", "LIN {X 100,Y 0,Z -3,A 90,B 0,C 180}", "$VEL.CP=0.05", "LIN {X 100,Y 0,Z 50}",
        ]  # fmt: skip
        (tmp_path / f"{name}.src").write_text("\n".join([f"DEF {name}()", *lines, "END", ""]))
        run("convert", tmp_path / f"{name}.src", *options)
        written[name] = (tmp_path / "out" / f"{name}.src").read_text().splitlines()
    different = {pair for pair in zip(*written.values(), strict=True) if pair[0] != pair[1]}
    names = {line.split("=")[0] for line, _ in different if not line.startswith((";", "DEF"))}
    assert names == {"$VEL.ORI1", "$VEL.ORI2", "$VEL.CP"}
    assert written["turned"].count("$VEL.CP=0.05") == 3
    reports = {name: json.loads((tmp_path / "out" / f"{name}.report.json").read_text()) for name in written}
    assert any(issue["kind"] == "slow-turn" for issue in reports["turned"]["issues"])
    assert not any(issue["kind"] == "slow-turn" for issue in reports["slow"]["issues"])
    assert reports["turned"]["before"] == reports["slow"]["before"]
