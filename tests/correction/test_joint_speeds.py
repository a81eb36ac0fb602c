"""Joint speeds: rapid moves are slowed, cutting moves state the feed that would do, the written path is checked."""

import re

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Rotary
from postproc.correction import checks, inspection, process, verify
from postproc.frames import pose_from_xyzabc
from postproc.poses import Poses
from postproc.program import PTP
from postproc.under_load import MotionsUnderLoad, PathUnderLoad, RobotInCell
from tests.corrections import read_files
from tests.kr270 import CELL, ROBOT

FAST = replace(CELL, gcode=replace(CELL.gcode, rapid_m_per_s=6.0))
RAPIDS = "G21 G90\nS9000 M3\nG0 X0 Y0 Z50\nZ5\nG1 X50 F{feed}\nG0 Z50\nY-300\nY300\nZ49\nM30\n"


CUT = "G21 G90\nG0 X0 Y-300 Z5\n(FORCE FX=100)\nG1 Y300 F{feed}\n(FORCE OFF)\nG0 Z50\nM30\n"


def converted(text: str, cell=FAST, name: str = "part.nc", **options):
    program = read_files({name: text}, cell)
    return process(program, ROBOT, cell, **options)


def speeds(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"^\$VEL\.CP=([\d.]+)", text, re.M)]


def test_rapid_moves_are_slowed_to_what_the_joints_can_do():
    result = converted(RAPIDS.format(feed=900))
    assert result.documents
    told = next(issue for issue in result.issues if issue.kind == "rapid-slowed")
    assert told.level == "info"
    assert 7 in told.lines
    text = result.documents[0].text
    slow = [speed for speed in speeds(text) if speed > 0.1]
    assert min(slow) < 6.0
    # the slowest of them: A1 passes the middle of Y-300 … Y300 with the most
    predicted = converted(text, name="part.src", mode="predict")
    assert not [issue for issue in predicted.issues if issue.kind.startswith("joint-speed")]
    assert f"{min(slow):.3g} m/s" in told.message
    # just 3 % more would be too fast
    faster = re.sub(rf"^\$VEL\.CP={min(slow):.6f}", f"$VEL.CP={1.03 * min(slow):.6f}", text, flags=re.M)
    again = converted(faster, name="part.src", mode="predict")
    assert [issue for issue in again.issues if issue.kind.startswith("joint-speed")]


def test_nothing_is_slowed_where_the_joints_keep_up():
    result = converted(RAPIDS.format(feed=900), CELL)
    assert "rapid-slowed" not in {issue.kind for issue in result.issues}
    assert set(speeds(result.documents[0].text)) == {0.3, 0.015}


def test_a_cutting_move_states_the_feed_that_would_do():
    text = CUT
    result = converted(text.format(feed=400000), CELL)
    issue = next(issue for issue in result.issues if issue.kind.startswith("joint-speed"))
    assert issue.level == "error"
    feed = float(re.search(r"Lower the feed to ([\d.]+) mm/min", issue.message)[1])
    assert converted(text.format(feed=feed), CELL).documents
    assert not converted(text.format(feed=1.15 * feed), CELL).documents


def test_a_move_at_the_speed_of_rapids_without_a_force_is_slowed_as_they_are():
    """G1 in place of G0: Fusion Personal writes no rapid moves."""
    text = CUT.replace("(FORCE FX=100)\n", "")
    result = converted(text.format(feed=400000), CELL)
    assert result.documents
    assert [issue.lines for issue in result.issues if issue.kind == "rapid-slowed"] == [(3,)]
    assert not converted(CUT.format(feed=400000), CELL).documents


def test_a_cap_lowers_the_feed_of_cuts_and_lists_their_lines():
    capped = replace(CELL, limits=replace(CELL.limits, feed="cap"))
    result = converted(CUT.format(feed=400000), capped)
    issue = next(issue for issue in result.issues if issue.kind == "feed-capped")
    assert (issue.level, issue.lines) == ("warning", (4,))
    feed = float(re.search(r"to ([\d.]+) mm/min", issue.message)[1])
    text = result.documents[0].text
    assert any(abs(speed * 60e3 / feed - 1.0) < 1e-3 for speed in speeds(text))
    assert not converted(CUT.format(feed=1.03 * feed), CELL).documents
    assert converted(CUT.format(feed=0.99 * feed), CELL).documents
    assert "feed-capped" not in {issue.kind for issue in converted(CUT.format(feed=900), capped).issues}


def test_a_cap_lowers_the_feed_of_a_robot_program_too():
    nominal = converted(CUT.format(feed=900), CELL, mode="nominal").documents[0].text
    fast = nominal.replace("$VEL.CP=0.015000", "$VEL.CP=6.5")
    assert fast != nominal
    assert not converted(fast, CELL, name="part.src").documents
    capped = replace(CELL, limits=replace(CELL.limits, feed="cap"))
    result = converted(fast, capped, name="part.src")
    assert result.documents
    assert "feed-capped" in {issue.kind for issue in result.issues}


def test_rapid_moves_are_not_slowed_further_where_a_cut_that_cannot_be_is_too_fast():
    """The cut is refused; the remark on its rapid moves is that of a program whose cut is slow enough."""

    def remark(feed):
        return next(i.message for i in converted(text.format(feed=feed)).issues if i.kind == "rapid-slowed")

    text = RAPIDS.replace("G1 X50 F{feed}", "(FORCE FX=100)\nG1 X50 F{feed}\n(FORCE OFF)")
    assert not converted(text.format(feed=400000)).documents
    assert remark(400000) == remark(900)


def test_a_cap_lowers_the_feed_until_the_written_program_keeps_the_speeds():
    """A tilt of 70° past the wrist singularity: the written program turns A4 faster than its draft."""
    rotary = Rotary(axes=["C", "B"], kind="tcp")
    gcode = replace(CELL.gcode, redundancy_deg=180.0)
    capped = replace(CELL, limits=replace(CELL.limits, feed="cap"), rotary=rotary, gcode=gcode)
    text = (
        "G21 G90\nG43.4 H1\nG0 X0 Y0 Z100 B0 C0\n(FORCE FX=150 FY=-220 FZ=310)\nG1 X0 Y0 Z10 B-70 C0 F6000\n"
        "(FORCE OFF)\nG0 Z120\nM30\n"
    )
    result = converted(text, capped)
    assert result.documents
    issue = next(issue for issue in result.issues if issue.kind == "feed-capped")
    assert issue.lines == (5,)
    feed = float(re.search(r"to ([\d.]+) mm/min", issue.message)[1])
    refused = replace(capped, limits=replace(CELL.limits, feed="refuse"))
    assert not converted(text.replace("F6000", f"F{1.08 * feed:.0f}"), refused).documents
    assert converted(text.replace("F6000", f"F{feed:.0f}"), refused).documents


@pytest.mark.parametrize(("value", "text"), [(1234.9, "1200"), (0.0567, "0.056"), (100.0, "100"), (99.0, "99")])
def test_the_feed_is_rounded_down(value, text):
    assert checks._round_down(value) == text


def test_a_first_move_at_feed_that_comes_from_start_is_slowed_as_rapid_moves_are():
    """A G1 as first move: from [start] to the part in one go, at 900 m/min. No force may act on it."""
    text = "G21 G90\nG1 X0 Y0 Z50 F{feed}\nX20 F900\nM30\n"
    result = converted(text.format(feed=900000), CELL)
    assert not [issue for issue in result.issues if issue.kind.startswith("joint-speed")]
    assert [issue.source_line for issue in result.issues if issue.kind == "rapid-slowed"] == [2]
    first, second = speeds(result.documents[0].text)[:2]
    assert 0.1 < first < 15.0
    assert second == 0.015
    faster = result.documents[0].text.replace(f"$VEL.CP={first:.6f}", f"$VEL.CP={1.03 * first:.6f}", 1)
    assert faster != result.documents[0].text
    again = converted(faster, name="part.src", mode="predict")
    assert [issue for issue in again.issues if issue.kind.startswith("joint-speed")]
    assert "rapid-slowed" not in {issue.kind for issue in converted(text.format(feed=900), CELL).issues}


def test_speed_is_rotation_over_the_time_of_the_way():
    """Of the first sample from [start]; of the others from the sample before, at their feed along the commanded way."""
    program = read_files({"part.nc": "G21 G90\nG1 X0 Y0 Z50 F600\nX20 F900\nM30\n"})
    motions = MotionsUnderLoad.of(program, RobotInCell.of(ROBOT, CELL), None)
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    q, position = path.joints.q, path.sample.pose[:, :3, 3]
    speed = inspection.commanded_speed(path, q, position)
    start = (
        motions.robot_in_cell.start_flange[:3, 3] + motions.robot_in_cell.start_flange[:3, :3] @ program.tools[0, :3, 3]
    )
    before = np.vstack([start - program.bases[0, :3, 3], position[:-1]])
    assert not program.bases[0, :3, :3].round(12)[~np.eye(3, dtype=bool)].any()
    seconds = np.linalg.norm(position - before, axis=1) / np.where(path.sample.motion == 0, 0.010, 0.015)
    turned = np.abs(np.diff(q, axis=0, prepend=[CELL.start_joints]))
    np.testing.assert_allclose(speed, turned / seconds[:, None], rtol=1e-6)


@pytest.mark.parametrize(("first", "feed"), [("turn", 0.010), ("nothing", 0.010), ("ptp", np.nan), ("line", 0.0)])
def test_a_first_move_without_travel_or_feed_has_no_known_speed(first, feed):
    """It turns the tool by 20° at [start], moves nothing, goes by joints, or has no feed."""
    program = read_files({"part.nc": "G21 G90\nG1 X0 Y0 Z50 F600\nX20 F900\nM30\n"})
    place, m = RobotInCell.of(ROBOT, CELL), program.motions
    kind, feeds, target = m.kind.copy(), m.feed.copy(), m.target[:].copy()
    feeds[0] = feed
    if first == "ptp":
        kind[0] = PTP
    if first in ("turn", "nothing"):
        turn = pose_from_xyzabc([0, 0, 0, 20.0 * (first == "turn"), 0, 0])
        target[0] = np.linalg.inv(program.bases[0]) @ place.start_flange @ program.tools[0] @ turn
    changed = replace(program, motions=replace(m, kind=kind, feed=feeds, target=Poses.of(target)))
    motions = MotionsUnderLoad.of(changed, place, None)
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    speed = inspection.commanded_speed(path, path.joints.q, path.sample.pose[:, :3, 3])
    moved = path.sample.motion == 1
    assert not speed[~moved].any()
    assert speed[moved].any()


@pytest.mark.parametrize(("share", "near"), [(0.65, False), (0.72, False), (0.78, True), (0.95, True)])
def test_the_written_path_is_near_a_joint_speed_from_three_quarters_of_it_on(monkeypatch, share, near):
    """Share of the largest speed of a joint on a cut along one line, by the angles of the path that is commanded."""
    cell = replace(CELL, gcode=replace(CELL.gcode, rapid_m_per_s=0.001))
    program = read_files({"part.nc": CUT.format(feed=3000)}, cell)
    motions = MotionsUnderLoad.of(program, RobotInCell.of(ROBOT, cell), None)
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    cuts = ~program.motions.rapid[path.sample.motion]
    speed = inspection.commanded_speed(path, path.joints.q, path.sample.pose[:, :3, 3])[cuts]
    robot = replace(ROBOT, speed=ROBOT.speed * (speed / ROBOT.speed).max() / share)
    found, deviation = [], verify._deviation

    def seen(*arguments):
        found.append(deviation(*arguments)[2])
        return deviation(*arguments)

    monkeypatch.setattr(verify, "_deviation", seen)
    process(read_files({"part.nc": CUT.format(feed=3000)}, cell, robot), robot, cell)
    assert found[-1] is near


@pytest.mark.parametrize("slower", [1.0, 0.01])
def test_the_written_path_of_any_robot_is_checked(monkeypatch, slower):
    robot = replace(ROBOT, speed=ROBOT.speed * slower)
    monkeypatch.setattr(checks, "joint_speed_issues", spared(checks.joint_speed_issues, "part.nc"))
    text = CUT.format(feed=400000 * slower)
    program = read_files({"part.nc": text}, robot=robot)
    result = process(program, robot, CELL)
    kinds = [issue.kind for issue in result.issues if issue.level == "error"]
    assert "joint-speed" in " ".join(kinds)
    assert len(kinds) == len(set(kinds))  # each joint once, however many places it is too fast at


def test_the_written_path_is_checked(monkeypatch):
    """Were the commanded path not checked, the text would be refused, with the lines of both."""
    monkeypatch.setattr(checks, "joint_speed_issues", spared(checks.joint_speed_issues, "part.nc"))
    monkeypatch.setattr(inspection, "slow_fast_motions", lambda *_: None)
    result = converted(RAPIDS.format(feed=900))
    assert not result.documents
    issue = next(issue for issue in result.issues if issue.level == "error")
    assert issue.kind.startswith("joint-speed")
    assert issue.source_line in (7, 8)
    assert issue.output_line is not None


def spared(check, name: str):
    def checked(program, *arguments):
        of_source = bool(program.documents) and program.documents[0].name == name
        return iter(()) if of_source else check(program, *arguments)

    return checked
