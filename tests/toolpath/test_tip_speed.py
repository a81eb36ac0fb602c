"""Speed of the tip where the tool turns: the time of a motion is the longer one of its length and its turn."""

from __future__ import annotations

import numpy as np
import pytest

from postproc import toolpath
from postproc.under_load import RobotInCell
from tests.dialects.krl_programs import CELL as KRL_CELL
from tests.dialects.krl_programs import body
from tests.dialects.krl_programs import read as read_krl
from tests.dialects.test_rapid import place
from tests.dialects.test_rapid import read as read_rapid
from tests.dialects.test_rapid_reading import at, module, tail
from tests.kr270 import ROBOT

START = "PTP {X 0,Y 0,Z 0,A 0,B 0,C 180,S 2,T 10}"


def krl_speeds(*lines, setting=KRL_CELL):
    """Speed of the tip [mm/s] on the LIN and CIRC of a program that starts at X 0, $VEL.CP 50 mm/s; NaN on PTP."""
    program = read_krl(body("$VEL.CP=0.05", START, *lines), cell=setting)
    path = toolpath.segments(program, RobotInCell.of(ROBOT, setting).start_flange)
    return 1e3 * toolpath.tip_speeds(program, path)[1:]


def rapid_speeds(*code, data=""):
    """Speed of the tip [mm/s] on the moves of a module behind those to X 0."""
    lines = [f"MoveJ {at(0, 0, 0)}{tail('v200', 'fine')}", *code]
    program = read_rapid(module(lines, data=data))
    path = toolpath.segments(program, place().start_flange)
    return 1e3 * toolpath.tip_speeds(program, path)[2:]


# 90° about the tool axis in 100 mm: X of the tool, the tool direction of KUKA, swivels by 90°
QUARTER = "LIN {X 100,Y 0,Z 0,A 90,B 0,C 180}"


@pytest.mark.parametrize(
    ("lines", "speed"),
    [
        (["$VEL.ORI1=10"], 100 / 9),
        (["$vel.ori1 = 10.0 ; slow"], 100 / 9),
        (["$VEL.ORI1=5", "$VEL.ORI1=10"], 100 / 9),
        (["$VEL={CP 0.05,ORI1 10.0,ORI2 200.0}"], 100 / 9),
        (["$VEL.ORI2=10"], 50.0),  # nothing turns about X of the tool
        (["$VEL.ORI1=200", "$VEL.ORI2=200"], 50.0),
        (["$VEL.ORI1=46", "$VEL.ORI2=46"], 50.0),  # 90° in 2 s are 45 °/s
        (["$VEL.ORI1=44"], 100 * 44 / 90),
        (["$VEL.ORI1=10", "BAS(#INITMOV,0)", "$VEL.CP=0.05"], 50.0),  # resets it to that of the controller
        (["$VEL.ORI1=10", "$VEL.ORI1=$VEL_MA.ORI1"], 50.0),
        (["$VEL.ORI1=10", "IF $IN[1] THEN", "$VEL.ORI1=200", "ENDIF"], 50.0),  # not known
        (["IF $IN[1] THEN", "$VEL.ORI1=10", "ENDIF"], 50.0),
        (["IF TRUE THEN", "$VEL.ORI1=10", "ENDIF"], 100 / 9),
        ([], 50.0),
    ],
)
def test_swivel_speed_of_krl_slows_a_line(lines, speed):
    np.testing.assert_allclose(krl_speeds(*lines, QUARTER), [speed], rtol=1e-9)


def test_with_limits_one_motion_only():
    speeds = krl_speeds(f"S{QUARTER} WITH $VEL={{CP 0.05,ORI1 10.0,ORI2 10.0}}", "LIN {X 200,Y 0,Z 0,A 0,B 0,C 180}")
    np.testing.assert_allclose(speeds, [100 / 9, 50.0], rtol=1e-9)


def test_rotation_speed_of_krl_limits_the_turn_about_the_tool_direction():
    tilted = "LIN {X 100,Y 0,Z 0,A 0,B 0,C 140}"  # 40° about X of the tool
    np.testing.assert_allclose(krl_speeds("$VEL.ORI2=10", tilted), [25.0], rtol=1e-9)
    np.testing.assert_allclose(krl_speeds("$VEL.ORI1=10", tilted), [50.0], rtol=1e-9)


def test_turn_about_an_inclined_axis_is_divided_between_both_speeds():
    """B = 45° of the tool: its x is at 45° to Z, about which the tool turns by 90°: both parts are 90°/√2."""
    start, end = "LIN {X 0,Y 0,Z 10,A 0,B 45,C 180}", "LIN {X 100,Y 0,Z 10,A 90,B 45,C 180}"
    for name in ("ORI1", "ORI2"):
        speeds = krl_speeds(start, f"$VEL.{name}=10", end)
        np.testing.assert_allclose(speeds[1:], [100 / (9 / np.sqrt(2))], rtol=1e-9)


def test_arc_of_krl_is_slowed_by_its_length():
    arc = "CIRC {X 50,Y 50,Z 0},{X 100,Y 0,Z 0,A 90,B 0,C 180}"
    np.testing.assert_allclose(krl_speeds("$VEL.ORI1=10", arc), [50 * np.pi / 9], rtol=1e-9)
    np.testing.assert_allclose(krl_speeds("$VEL.ORI1=90", arc), [50.0], rtol=1e-9)


def test_arc_with_which_the_tool_turns_is_slowed_by_its_turn_in_space():
    """Half a circle with the tool fixed to the path: 180° at 10 °/s."""
    arc = "CIRC {X 50,Y 50,Z 0},{X 100,Y 0,Z 0,A 180,B 0,C 180}"
    speeds = krl_speeds("$CIRC_TYPE=#PATH", "$VEL.ORI1=10", arc)
    np.testing.assert_allclose(speeds, [50 * np.pi / 18], rtol=1e-9)


def test_routine_that_may_have_run_leaves_the_speed_unknown():
    lines = ["$VEL.ORI1=10", "IF $IN[1] THEN", "SLOW()", "ENDIF", QUARTER, "END", "DEF SLOW()", "$VEL.ORI1=200"]
    np.testing.assert_allclose(krl_speeds(*lines), [50.0], rtol=1e-9)
    certain = ["$VEL.ORI1=200", "SLOW()", QUARTER, "END", "DEF SLOW()", "$VEL.ORI1=10"]
    np.testing.assert_allclose(krl_speeds(*certain), [100 / 9], rtol=1e-9)


def test_motion_that_only_turns_the_tool_keeps_its_feed():
    speeds = krl_speeds("$VEL.ORI1=10", "LIN {X 0,Y 0,Z 0,A 90,B 0,C 180}", "LIN {X 100,Y 0,Z 0,A 90,B 0,C 180}")
    np.testing.assert_allclose(speeds, [50.0, 50.0], rtol=1e-12)


TURNED = "[0,0.70710678,0.70710678,0]"


def moved(speed, zone="z1", command="MoveL"):
    return f"{command} {at(100, 0, 0, TURNED)}{tail(speed, zone)}"


@pytest.mark.parametrize(
    ("code", "speed"),
    [
        ([moved("[50,10,5000,1000]")], 100 / 9),
        ([moved("vSlow")], 100 / 9),
        ([moved("[50,500,5000,1000]")], 50.0),
        ([moved("v50")], 50.0),  # 500 °/s
        ([moved("v1000")], 100 * 500 / 90),
        (["VelSet 50,5000;", moved("[200,20,5000,1000]")], 100 / 9),
        ([moved("[200,10,5000,1000]\\V:=50")], 100 / 9),
        ([moved("[200,10,5000,1000]\\T:=2")], 50.0),
    ],
)
def test_reorientation_speed_of_rapid_slows_a_line(code, speed):
    data = "  CONST speeddata vSlow:=[50,10,5000,1000];"
    np.testing.assert_allclose(rapid_speeds(*code, data=data), [speed], rtol=1e-6)


def test_reorientation_speed_of_rapid_limits_turns_about_any_axis():
    tilted = "[0,0.93969262,0,0.34202014]"  # 40° about Y of the tool
    speeds = rapid_speeds(f"MoveL {at(100, 0, 0, tilted)}{tail('[50,10,5000,1000]')}")
    np.testing.assert_allclose(speeds, [25.0], rtol=1e-6)


def test_arc_of_rapid_is_slowed_by_its_length():
    arc = f"MoveC {at(50, 50, 0)},{at(100, 0, 0, TURNED)}{tail('[50,10,5000,1000]')}"
    np.testing.assert_allclose(rapid_speeds("CirPathMode\\ObjectFrame;", arc), [50 * np.pi / 9], rtol=1e-6)


def test_arc_on_which_the_tool_keeps_its_orientation_is_not_slowed():
    arc = f"MoveC {at(50, 50, 0)},{at(100, 0, 0)}{tail('[50,10,5000,1000]')}"
    np.testing.assert_allclose(rapid_speeds(arc), [50.0], rtol=1e-6)
