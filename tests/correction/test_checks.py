"""Checks along the path: what stops a program, and where the message points."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction
from postproc.poses import Poses
from tests.corrections import read_files
from tests.kr270 import CELL, FOLDER, ROBOT
from tests.oracle.arm import Arm
from tests.programs import program

FAST_RAPIDS = replace(CELL, gcode=replace(CELL.gcode, rapid_m_per_s=10.0))
"""In it, no feed is that of rapid moves, which are slowed where no force acts."""
DOWN = CELL.tool_orientation()


def issues_of(moves, notes=(), mode="predict", **changes):
    made = program(moves, notes=notes, orientation=DOWN, **changes)
    return {issue.kind: issue for issue in correction.process(made, ROBOT, CELL, mode=mode).issues}


FINE = [("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", 100, 0, 0)]


def test_a_good_program_has_no_errors():
    assert not [issue for issue in issues_of(FINE).values() if issue.level == "error"]


def test_out_of_reach_names_the_line_of_the_move():
    found = issues_of([*FINE, ("LIN", 3500, 0, 0), ("LIN", 0, 0, 0)])["unreachable"]
    assert (found.level, found.source_line) == ("error", 4)


def test_a_joint_limit_passed_on_the_way_is_found_though_both_ends_are_within():
    # straight over the robot's side: A1 turns beyond its limit only around the middle of the move
    tight = ROBOT.upper.copy()
    tight[0] = np.radians(8.0)
    from msgspec.structs import replace

    model = replace(ROBOT, upper=tight)
    made = program([("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", -900, 0, 0)], orientation=DOWN)
    kinds = {issue.kind: issue for issue in correction.process(made, model, CELL, mode="predict").issues}
    assert kinds["joint-limit-A1"].source_line == 3


def test_a_move_behind_the_robot_passes_the_shoulder_singularity():
    found = issues_of([("PTP", 0, 200, 900), ("LIN", -1100, 200, 900), ("LIN", -2400, 200, 900)])
    assert any("singularity" in kind or kind in ("unreachable", "joint-jump") for kind in found)
    assert any(issue.level == "error" and issue.source_line in (2, 3) for issue in found.values())


def test_a_rapid_move_too_fast_for_a_joint_is_slowed():
    made = program(FINE, orientation=DOWN)
    made.motions.feed[2] = 5.0
    made.motions.rapid[2] = True
    issues = correction.process(made, ROBOT, CELL, mode="predict").issues
    assert not [issue for issue in issues if issue.kind.startswith("joint-speed-A")]
    assert [issue.source_line for issue in issues if issue.kind == "rapid-slowed"] == [int(made.motions.line[2])]


def test_feed_too_fast_for_a_joint_is_an_error_with_the_joint_and_its_speed():
    made = program(FINE, orientation=DOWN)
    made.motions.feed[2] = 5.0
    kinds = {issue.kind: issue for issue in correction.process(made, ROBOT, FAST_RAPIDS, mode="predict").issues}
    fast = [issue for kind, issue in kinds.items() if kind.startswith("joint-speed-A")]
    assert fast
    assert fast[0].source_line == 3
    assert "°/s" in fast[0].message


def test_a_correction_beyond_the_limit_of_the_cell_is_an_error():
    found = issues_of(FINE, notes=[(2, (0.0, 0, 40000.0, 0, 0, 0))], mode="convert")
    assert found["correction-size"].level == "error"
    assert found["correction-size"].source_line == 2


def test_a_result_with_an_error_holds_no_documents():
    made = program([*FINE, ("LIN", 3500, 0, 0)], orientation=DOWN)
    result = correction.process(made, ROBOT, CELL)
    assert result.failed
    assert result.documents == ()


@pytest.mark.parametrize("factor", [0.5, 1.5])
def test_what_the_text_says_is_what_counts(monkeypatch, factor):
    """If the writer wrote other numbers than computed, the program is not released."""
    from postproc.dialects.krl.write import modules

    honest = modules.emit

    def wrong(made, targets, *others):
        pose = targets.pose[:]
        pose[2:, 0, 3] += 1e-5 * factor
        return honest(made, replace(targets, pose=Poses.of(pose)), *others)

    monkeypatch.setattr(modules, "emit", wrong)
    result = correction.process(
        program(FINE, notes=[(2, (0.0, 50.0, 90.0, 0, 0, 0))], orientation=DOWN), ROBOT, CELL, mode="convert"
    )
    assert result.failed
    assert {issue.kind for issue in result.issues if issue.level == "error"} == {"read-back"}
    assert result.documents == ()


def test_a_speed_that_the_text_does_not_say_is_told(monkeypatch):
    from postproc.dialects.krl.write import modules

    honest = modules.emit

    def wrong(made, targets, *others):
        feed = made.motions.feed.copy()
        feed[-2] += 1e-4
        return honest(replace(made, motions=replace(made.motions, feed=feed)), targets, *others)

    monkeypatch.setattr(modules, "emit", wrong)
    result = correction.process(
        program(FINE, notes=[(2, (0.0, 50.0, 90.0, 0, 0, 0))], orientation=DOWN), ROBOT, CELL, mode="convert"
    )
    assert [issue.kind for issue in result.issues if issue.level == "error"] == ["read-back"]
    assert result.documents == ()


def test_start_joints_beyond_their_limits_stop_every_program():
    import msgspec

    start = msgspec.structs.replace(CELL.start, joints=(0.0, 50.0, 110.0, 0.0, 50.0, 0.0))
    cell = msgspec.structs.replace(CELL, start=start)
    result = correction.process(program(FINE, orientation=DOWN), ROBOT, cell, mode="predict")
    found = {issue.kind: issue for issue in result.issues}
    assert found["start-joints"].level == "error"
    assert "A2" in found["start-joints"].message


def test_a_turn_that_no_legal_axis_value_has_is_an_error():
    made = program([*FINE, ("PTP", 0, 0, 50)], orientation=DOWN)
    made.motions.status[3], made.motions.turn[3] = 2, 0  # A2 is negative within its limits: bit 1 must be set
    kinds = {issue.kind: issue for issue in correction.process(made, ROBOT, CELL, mode="predict").issues}
    assert (kinds["status-turn"].level, kinds["status-turn"].source_line) == ("error", 4)


def test_turning_the_tool_on_the_spot_under_force_is_not_timed_by_the_feed():
    from scipy.spatial.transform import Rotation

    made = program([*FINE, ("LIN", 100, 0, 0)], notes=[(2, (100.0, 50.0, 200.0, 0, 0, 0))], orientation=DOWN)
    target = made.motions.target[:]
    target[3, :3, :3] = Rotation.from_euler("y", 3, degrees=True).as_matrix() @ DOWN
    made = replace(made, motions=replace(made.motions, target=Poses.of(target)))
    result = correction.process(made, ROBOT, CELL)
    assert not [issue for issue in result.issues if issue.kind.startswith("joint-speed")]
    assert not result.failed


@pytest.mark.parametrize(("share", "level"), [(0.95, None), (1.05, "error")])
def test_the_fastest_feed_is_where_a_joint_of_an_independent_arm_reaches_its_speed(share, level):
    arm, base, tool = Arm.load(FOLDER), np.eye(4), np.eye(4)
    base[:3, 3], tool[:3, 3] = [1.5, -0.2, 0.7], [0, 0, 0.35]
    place = np.eye(4)
    place[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ np.diag([-1.0, -1.0, 1.0])  # spindle down, turned as the cell says
    angles, way = [], np.linspace(0.0, 0.1, 21)
    for x in way:
        place[0, 3] = x
        angles.append(arm.inverse(base @ place, tool, angles[-1] if angles else CELL.start_joints))
    slope = np.abs(np.diff(angles, axis=0)).max(axis=0) / (way[1] - way[0])
    fastest = float((ROBOT.speed / slope).min())
    made = program(FINE, orientation=DOWN)
    made.motions.feed[2] = share * fastest
    found = [
        issue
        for issue in correction.process(made, ROBOT, FAST_RAPIDS, mode="predict").issues
        if "joint-speed" in issue.kind
    ]
    assert [issue.level for issue in found] == ([] if level is None else [level])
    if found:
        joint = int((ROBOT.speed / slope).argmin())
        assert found[0].kind == f"joint-speed-A{joint + 1}"
        assert f"(limit {np.degrees(ROBOT.speed[joint]):.0f}°/s)" in found[0].message


def test_a_start_with_a5_at_zero_is_warned_about_and_one_exactly_at_a_limit_is_not():
    import msgspec

    def kinds(*joints):
        start = msgspec.structs.replace(CELL.start, joints=joints)
        result = correction.process(program(FINE, orientation=DOWN), ROBOT, msgspec.structs.replace(CELL, start=start))
        return {issue.kind: issue.level for issue in result.issues}

    assert kinds(0.0, -70.0, 110.0, 0.0, 0.0, 0.0)["start-singular"] == "warning"
    at_limit = kinds(0.0, -70.0, 110.0, 0.0, 50.0, float(np.degrees(ROBOT.upper[5])))
    assert not {"start-singular", "start-joints"} & set(at_limit)


def test_a_first_move_that_turns_the_hand_by_half_a_turn_is_told():
    from msgspec.structs import replace as changed

    cell = changed(CELL, gcode=changed(CELL.gcode, redundancy_deg=0.0))
    made = program(FINE, orientation=cell.tool_orientation())
    told = {issue.kind: issue for issue in correction.process(made, ROBOT, cell, mode="predict").issues}
    issue = told["first-move-A6"]
    assert (issue.level, issue.source_line) == ("warning", 1)
    assert "redundancy_deg" in issue.message
    assert not [kind for kind in issues_of(FINE) if kind.startswith("first-move")]


def test_a_posture_that_changes_is_told():
    made = program([*FINE, ("PTP", 100, 0, 50), ("LIN", 100, 0, 0)], orientation=DOWN)
    made.motions.status[3] = 6  # wrist turned over
    told = {issue.kind: issue for issue in correction.process(made, ROBOT, CELL, mode="predict").issues}
    assert (told["posture"].level, told["posture"].source_line, told["posture"].count) == ("info", 4, 1)
    assert "S from 2 to 6" in told["posture"].message
    assert "posture" not in issues_of(FINE)


def test_advice_for_g_code_is_not_given_for_krl():
    from msgspec.structs import replace

    made = program(FINE, orientation=DOWN)
    for dialect, layout, given in (("gcode", None, True), ("krl", object(), False)):
        tight = replace(ROBOT, upper=np.radians([180.0, -120.0, 150.0, 350.0, 125.0, 350.0]))
        issues = correction.process(replace(made, dialect=dialect, layout=layout), tight, CELL, mode="nominal").issues
        assert any("redundancy_deg" in issue.message for issue in issues) is given


def test_half_a_turn_from_home_is_a_warning():
    text = "DEF home()\n$VEL.CP=0.02\nPTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}\n;FORCE FX=100 FY=0 FZ=300\n"
    text += "LIN {X 0,Y 40,Z 10,A 0,B 0,C 180}\nLIN {X 60,Y 40,Z 10,A 0,B 0,C 180}\nEND\n"
    made = read_files({"home.src": text})
    found = [issue for issue in correction.process(made, ROBOT, CELL).issues if issue.kind == "half-turn"]
    assert [(issue.level, issue.source_line) for issue in found] == [("warning", 5)]


@pytest.mark.parametrize("angle", [180.0, 179.9, -180.0, 179.5, -120.0])
@pytest.mark.parametrize(("force", "level"), [(";FORCE FX=100 FY=0 FZ=300", "error"), ("; nothing acts", "warning")])
def test_a_move_that_turns_the_tool_by_half_a_circle_is_refused_where_it_is_corrected(angle, force, level):
    moves = [("PTP", 0.0, 0.0), ("LIN", 20.0, 0.0), ("LIN", 60.0, angle), ("LIN", 100.0, angle)]
    lines = [f"{kind} {{X {x},Y 40,Z 10,A {a},B 0,C 180}}" for kind, x, a in moves]
    home = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}"
    text = "\n".join(["DEF half()", "$VEL.CP=0.02", home, force, *lines, "END", ""])
    made = read_files({"half.src": text})
    found = [issue for issue in correction.process(made, ROBOT, CELL).issues if issue.kind == "half-turn"]
    assert [(issue.level, issue.source_line) for issue in found] == ([(level, 7)] if abs(angle) > 179.8 else [])
