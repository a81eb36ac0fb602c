"""Which force acts where: CSV rows, comments, frames, and the ramp."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import forces, frames, toolpath
from postproc.errors import ForceError
from postproc.forces import Knots, path_forces
from postproc.poses import Poses
from postproc.program import parse_force_note
from tests.programs import program

START = np.eye(4)
RAMP = 1e-3


def put_on(made, source, axis="+Z"):
    return forces.assign(made, toolpath.segments(made, START), source, axis, RAMP)


def along(made, motion, distance_mm, source=None, axis="+Z"):
    """Wrench at a distance along one motion [mm]."""
    path = toolpath.segments(made, START)
    t = np.array([distance_mm / 1000 / path.length[motion]])
    return put_on(made, source, axis).at(toolpath.at(made, path, np.array([motion]), t))[0]


def at_ends(made, source=None):
    """Wrench at the end of each motion."""
    path, count = toolpath.segments(made, START), len(made.motions)
    return put_on(made, source).at(toolpath.at(made, path, np.arange(count), np.ones(count)))


def write(tmp_path, text):
    path = tmp_path / "forces.csv"
    path.write_text(text, encoding="utf-8")
    return path


SQUARE = [("PTP", 0, 0, 0), ("LIN", 100, 0, 0), ("LIN", 100, 50, 0), ("RAPID", 100, 50, 20)]


def test_comment_force_is_modal_ramps_up_over_1_mm_and_down_in_the_rapid():
    made = program(SQUARE, notes=[(2, (100.0, 0, 0, 0, 0, 5.0)), (3, (0.0, 200.0, 0, 0, 0, 0))])
    np.testing.assert_allclose(along(made, 1, 0.25), [25, 0, 0, 0, 0, 1.25])
    np.testing.assert_allclose(along(made, 1, 1.0), [100, 0, 0, 0, 0, 5])
    np.testing.assert_allclose(along(made, 1, 100.0), [100, 0, 0, 0, 0, 5])
    np.testing.assert_allclose(along(made, 2, 0.5), [50, 100, 0, 0, 0, 2.5])
    np.testing.assert_allclose(along(made, 2, 50.0), [0, 200, 0, 0, 0, 0])
    np.testing.assert_allclose(along(made, 3, 0.75), [0, 50, 0, 0, 0, 0])
    np.testing.assert_allclose(along(made, 3, 5.0), np.zeros(6))


def test_the_ramp_begins_with_what_acts_where_the_motion_begins():
    """The third motion begins where the first ends: another branch than the second, under another base."""
    lines = [("LIN", 100, 0, 0), ("LIN", 100, 50, 0), ("LIN", 100, 0, 40), ("LIN", 0, 0, 40)]
    notes = [(1, (80.0, 0, 0, 0, 0, 0)), (2, (0.0, 0, 300.0, 0, 0, 0)), (3, (0.0, 40.0, 0, 0, 0, 0))]
    made = program(lines, notes=notes)
    turned = made.bases[0] @ frames.pose_from_xyzabc([0, 0, 0, 90, 0, 0])
    motions = replace(made.motions, base=np.array([0, 0, 1, 1]))
    made = replace(made, motions=motions, bases=np.stack([made.bases[0], turned]), after=np.array([-1, 0, 0, 2]))
    # half of what acted there, −Y of the base turned by 90°, and half of its own
    np.testing.assert_allclose(along(made, 2, 0.5), [0, -40 + 20, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(along(made, 2, 2.0), [0, 40, 0, 0, 0, 0], atol=1e-12)


def test_on_a_segment_shorter_than_the_ramp_the_force_is_reached_at_its_end():
    made = program([("PTP", 0, 0, 0), ("LIN", 0.4, 0, 0), ("LIN", 100, 0, 0)], notes=[(2, (80.0, 0, 0, 0, 0, 0))])
    np.testing.assert_allclose(along(made, 1, 0.1), [20, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(along(made, 1, 0.4), [80, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(along(made, 2, 0.1), [80, 0, 0, 0, 0, 0])


def test_feed_frame_has_x_along_travel_and_z_from_tip_to_spindle():
    made = program(SQUARE, notes=[(2, (10.0, 20.0, 30.0, 1, 2, 3), "FEED")])
    # tool axis +Z points down: z_feed is up; x_feed = +X, y_feed = z × x = +Y on the first line
    np.testing.assert_allclose(along(made, 1, 50), [10, 20, 30, 1, 2, 3], atol=1e-12)
    # on the second line the travel is +Y: x_feed = +Y, y_feed = z × y = −X
    np.testing.assert_allclose(along(made, 2, 40), [-20, 10, 30, -2, 1, 3], atol=1e-12)


def test_feed_frame_turns_with_an_arc():
    made = program(
        [("PTP", 50, 0, 0), ("CIRC", -50, 0, 0, 0, 0, 0, 180.0, (0, 0, 1))], notes=[(2, (10.0, 0, 0, 0, 0, 0), "FEED")]
    )
    quarter = np.pi / 2 * 50
    np.testing.assert_allclose(along(made, 1, quarter), [-10, 0, 0, 0, 0, 0], atol=1e-12)


def test_a_feed_force_that_goes_on_turns_with_the_path_from_its_start():
    """A line runs into an arc of 5 mm radius without a corner: no ramp mixes in the direction at its start."""
    moves = [("PTP", -50, -5, 0), ("LIN", 0, -5, 0), ("CIRC", 5, 0, 0, 0, 0, 0, 90.0, (0, 0, 1))]
    made = program(moves, notes=[(2, (10.0, 0, 0, 0, 0, 0), "FEED")])
    for distance in (0.1, 0.5, 0.9):
        angle = distance / 5
        expected = [10 * np.cos(angle), 10 * np.sin(angle), 0, 0, 0, 0]
        np.testing.assert_allclose(along(made, 2, distance), expected, atol=1e-9)


def test_where_the_travel_is_reversed_a_feed_force_changes_over_the_ramp():
    made = program(
        [("PTP", 0, 0, 0), ("LIN", 50, 0, 0), ("LIN", 0, 0, 0)], notes=[(2, (10.0, 0, 0, 0, 0, 4.0), "FEED")]
    )
    for distance, x in ((0.25, 5.0), (0.75, -5.0), (1.5, -10.0)):
        np.testing.assert_allclose(along(made, 2, distance), [x, 0, 0, 0, 0, 4], atol=1e-9)


def test_feed_frame_on_a_sloped_move_keeps_z_along_the_spindle():
    made = program([("PTP", 0, 0, 0), ("LIN", 30, 0, -30)], notes=[(2, (10.0, 0, 7.0, 0, 0, 0), "FEED")])
    np.testing.assert_allclose(along(made, 1, 20), [10, 0, 7, 0, 0, 0], atol=1e-12)


def test_tool_frame_is_turned_with_the_tool():
    made = program(SQUARE, notes=[(2, (1.0, 2.0, 3.0, 4, 5, 6), "TOOL")])
    np.testing.assert_allclose(along(made, 1, 50), [1, -2, -3, 4, -5, -6], atol=1e-12)


def test_on_a_plunge_feed_x_is_the_last_travel_across_the_spindle():
    moves = [("PTP", 0, 0, 10), ("RAPID", 30, 40, 10), ("LIN", 30, 40, 5), ("LIN", 30, 40, 0), ("LIN", 0, 40, 0)]
    made = program(moves, notes=[(1, (10.0, 5.0, 30.0, 0, 0, 0), "FEED")])
    for motion in (2, 3):
        np.testing.assert_allclose(along(made, motion, 4), [6 - 4, 8 + 3, 30, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(along(made, 4, 4), [-10, -5, 30, 0, 0, 0], atol=1e-12)
    (issue,) = put_on(made, None).issues
    assert (issue.kind, issue.level, issue.source_line, issue.count) == ("feed-direction", "info", 3, 2)


def test_a_plunge_at_the_begin_of_a_branch_takes_the_last_travel_before_the_branches():
    """The fifth move begins where the second ends; the third and fourth are another branch, which did not run."""
    moves = [("PTP", 0, 0, 10), ("LIN", 30, 40, 10), ("LIN", 30, 40, 0), ("LIN", 0, 40, 0), ("LIN", 30, 40, 5)]
    moves += [("LIN", 30, 40, 0), ("LIN", 30, 0, 0), ("LIN", 30, 0, 20)]
    made = program(moves, notes=[(2, (10.0, 5.0, 30.0, 0, 0, 0), "FEED")])
    made = replace(made, after=np.array([-1, 0, 1, 2, 1, 4, 5, 6]))
    for motion in (2, 4, 5):
        np.testing.assert_allclose(along(made, motion, 4), [6 - 4, 8 + 3, 30, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(along(made, 7, 4), [5, -10, 30, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_the_last_travel_is_that_of_the_moves_executed_before(seed):
    """Random moves and predecessors, one of them at an unknown start; each is followed back one by one."""
    rng = np.random.default_rng(seed)
    steps = np.array([[10.0, 0, 0], [0, 10, 0], [0, 0, 5]])[rng.integers(0, 3, 30)]
    made = program([("LIN", *point) for point in np.cumsum(steps, axis=0)])
    after = np.array([-1, *(int(rng.integers(max(-1, k - 4), k)) for k in range(1, 30))])
    after[7] = 7
    made = replace(made, after=after)
    path = toolpath.segments(made, START)
    travel, needs = forces.last_travel(made, path, "+Z")
    across = toolpath.tangent(made, path, np.arange(30), np.ones(30))[:, :2]
    for k in range(30):
        row = after[k]
        while row >= 0 and needs[row]:
            row = after[row] if after[row] != row else -1
        row = row if row >= 0 and row != k else int(np.argmin(needs))
        np.testing.assert_allclose(travel[k, :2], across[row] / np.linalg.norm(across[row]), atol=1e-9)


def test_after_an_arc_a_retract_takes_the_direction_at_its_end():
    moves = [("PTP", 50, 0, 0), ("CIRC", 0, 50, 0, 0, 0, 0, 90.0, (0, 0, 1)), ("LIN", 0, 50, 20)]
    made = program(moves, notes=[(2, (10.0, 0, 0, 0, 0, 0), "FEED")])
    np.testing.assert_allclose(along(made, 2, 10), [-10, 0, 0, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("rise", [1, -1])
@pytest.mark.parametrize("side", [1, -1])
def test_after_an_arc_that_ends_along_the_spindle_a_plunge_takes_the_direction_just_before_its_end(side, rise):
    arc = ("CIRC", 20 * side, 0, 20 * rise, 0, 0, 20 * rise, 90.0, (0, -side * rise, 0))  # a quarter, up or down
    moves = [("PTP", 0, 0, 0), arc, ("LIN", 20 * side, 0, 50 * rise)]
    made = program(moves, notes=[(3, (10.0, 4, 0, 0, 0, 0), "FEED")])
    np.testing.assert_allclose(along(made, 2, 20), [10 * side, 4 * side, 0, 0, 0, 0], atol=1e-6)
    last, needs = forces.last_travel(made, toolpath.segments(made, START), "+Z")
    np.testing.assert_allclose(last[2], [side, 0.0, 0.0], atol=1e-9)
    assert needs.tolist()[1:] == [False, True]


def test_a_plunge_after_the_first_motion_takes_the_direction_from_the_start():
    """The first motion comes from where the tool is at [start]; what needs no other direction keeps its own."""
    made = program([("LIN", 30, 40, 0), ("LIN", 30, 40, -20), ("LIN", 30, 0, -20), ("LIN", 30, 0, 0)])
    path = toolpath.segments(made, np.eye(4))
    last, needs = forces.last_travel(made, path, "+Z")
    begin = np.array([0.0, 0.0, 0.35]) - made.bases[0, :3, 3]  # of the tool, at a flange in the root
    way = (np.array([0.03, 0.04, 0.0]) - begin)[:2]
    assert needs.tolist() == [False, True, False, True]
    np.testing.assert_allclose(last[1], [*way / np.linalg.norm(way), 0.0], atol=1e-9)
    np.testing.assert_allclose(last[3], [0.0, -1.0, 0.0], atol=1e-9)


def test_the_last_travel_keeps_its_direction_in_space_when_the_base_changes():
    bases = frames.pose_from_xyzabc([[1500.0, 0, 700, 0, 0, 0], [1500.0, 0, 700, 90, 0, 0]])
    moves = [("PTP", 0, 0, 10), ("LIN", 30, 0, 10), ("LIN", 0, -30, 0)]
    made = program(moves, notes=[(3, (10.0, 0, 0, 0, 0, 0), "FEED")], bases=bases, base=[0, 0, 1])
    np.testing.assert_allclose(along(made, 2, 5), [0, -10, 0, 0, 0, 0], atol=1e-12)


def test_an_arc_that_runs_along_the_spindle_at_one_place_keeps_its_direction_there():
    made = program(
        [("PTP", 50, 0, 0), ("CIRC", -50, 0, 0, 0, 0, 0, 180.0, (0, -1, 0))], notes=[(2, (10.0, 0, 0, 0, 0, 0), "FEED")]
    )
    for share in (1e-9, 0.5, 1.0):  # up at its start, along −X on top, down at its end
        np.testing.assert_allclose(along(made, 1, share * np.pi * 50)[0], -10 if share > 1e-6 else 0, atol=1e-5)


@pytest.mark.parametrize("place", [0.0, 0.6, 1.0])
def test_where_an_arc_runs_along_the_spindle_its_direction_just_before_is_taken_and_at_its_start_just_after(place):
    """Arcs in the plane of X and Z that run up or down there, and towards +X before it (at the start, after it).

    The move before the arc is towards −Y, another direction than that of the arc.
    """
    if place == 0.6:
        begin = (50 * np.cos(1.2 * np.pi), 0.0, -50 * np.sin(1.2 * np.pi))
        arc = ("CIRC", *begin, 0, 0, 0, 360.0, (0, -1, 0))
    else:
        begin = (-50.0, 0.0, 0.0)
        arc = ("CIRC", 50, 0, 0, 0, 0, 0, 180.0, (0, 1, 0))
    before = ("PTP", begin[0], 40.0, begin[2])
    made = program([before, ("LIN", *begin), arc], notes=[(3, (10.0, 0, 0, 0, 0, 0), "FEED")])
    path = toolpath.segments(made, START)
    load = forces.assign(made, path, None, "+Z", 1e-9)
    spot = toolpath.at(made, path, np.array([2]), np.array([place or 1e-6]))
    direction = toolpath.tangent(made, path, np.array([2]), np.array([place]))[0]
    assert abs(direction[2]) > 1.0 - 1e-9
    found = load.at(spot)[0]
    np.testing.assert_allclose(found[:3], [10, 0, 0], atol=1e-6)


def test_a_plunge_before_any_travel_takes_the_direction_of_the_first():
    moves = [("PTP", 0, 0, 10), ("LIN", 0, 0, 5), ("LIN", 0, 0, 0), ("LIN", 0, 10, 0), ("LIN", 10, 10, 0)]
    made = program(moves, notes=[(2, (10.0, 5.0, 30.0, 0, 0, 0), "FEED")])
    for motion in (1, 2, 3):
        np.testing.assert_allclose(along(made, motion, 4), [-5, 10, 30, 0, 0, 0], atol=1e-12)
    (issue,) = put_on(made, None).issues
    assert (issue.kind, issue.source_line, issue.count) == ("feed-direction", 2, 2)


@pytest.mark.parametrize("drift", [0.0, 1e-3])
@pytest.mark.parametrize("first", ["PTP", "LIN"])
def test_feed_forces_where_no_move_has_a_direction_name_the_lines(first, drift):
    """Also where rounding moves a plunge sideways by a micrometre: that is no direction of travel.

    The first move begins right above its end, at the place of the tool at [start].
    """
    x, y, z = 1e3 * (START[:3, 3] + [0, 0, 0.35] - [1.5, -0.2, 0.7])
    moves = [(first, x + drift, y, z - 450), ("LIN", x, y, z - 455), ("LIN", x, y, z - 460)]
    with pytest.raises(ForceError, match=r"part\.nc:2: .*along the spindle") as caught:
        along(program(moves, notes=[(2, (10.0, 0, 0, 0, 0, 0), "FEED")]), 1, 5)
    assert [error.line for error in caught.value.further_errors] == [3]


def test_a_feed_force_along_the_spindle_alone_needs_no_travel():
    made = program([("PTP", 0, 0, 10), ("LIN", 0, 0, 0)], notes=[(2, (0.0, 0, 30.0, 0, 0, 2.0), "FEED")])
    np.testing.assert_allclose(along(made, 1, 5), [0, 0, 30, 0, 0, 2], atol=1e-12)
    assert put_on(made, None).issues == ()


def test_a_dead_force_keeps_its_direction_in_space_when_the_base_changes():
    bases = frames.pose_from_xyzabc([[1500.0, 0, 700, 0, 0, 0], [1500.0, 0, 700, 90, 0, 0]])
    made = program([*SQUARE[:2], ("LIN", 50, -50, 0)], notes=[(2, (100.0, 0, 0, 0, 0, 0))], bases=bases, base=[0, 0, 1])
    np.testing.assert_allclose(along(made, 2, 1e-9), [0, -100, 0, 0, 0, 0], atol=1e-3)


def test_csv_row_wins_over_the_comment_for_its_lines(tmp_path):
    made = program(SQUARE, notes=[(1, (100.0, 0, 0, 0, 0, 0))])
    rows = forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz,frame,line_end\n2,1,2,3,,2\n"))
    np.testing.assert_allclose(along(made, 1, 50, rows), [1, 2, 3, 0, 0, 0])
    np.testing.assert_allclose(along(made, 2, 50, rows), [100, 0, 0, 0, 0, 0])


def test_a_row_for_a_move_that_goes_nowhere_is_no_error(tmp_path):
    from msgspec.structs import replace

    made = replace(program(SQUARE), still=np.array([77]))
    rows = forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz\n2,1,0,0\n77,1,0,0\n"))
    assert at_ends(made, rows)[:, 0].tolist() == [0, 1, 0, 0]


def test_an_empty_line_end_means_the_line_alone(tmp_path):
    rows = forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz,line_end\n2,1,2,3,\n3,4,5,6,3\n"))
    assert at_ends(program(SQUARE), rows)[1:3, 0].tolist() == [1.0, 4.0]


def test_cutting_moves_without_a_force_are_counted():
    load = put_on(program(SQUARE), None)
    (issue,) = load.issues
    assert (issue.kind, issue.count, issue.source_line, issue.level) == ("no-force", 2, 2, "warning")


def test_no_force_on_a_rapid_is_nothing_to_tell(tmp_path):
    rows = forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz,line_end\n1,0,0,0,1\n2,5,5,5,3\n4,0,0,0,4\n"))
    assert put_on(program(SQUARE), rows).issues == ()


def test_a_force_on_a_move_from_start_is_refused_with_its_line():
    notes = [(2, (10.0, 0, 0, 0, 0, 0))]
    assert put_on(replace(program(SQUARE, notes=notes), unforced=np.array([0])), None)
    with pytest.raises(ForceError, match=r"a force on a move from \[start\] of the cell") as caught:
        put_on(replace(program(SQUARE, notes=notes), unforced=np.array([1])), None)
    assert caught.value.line == 2


@pytest.mark.parametrize("axis", ["+Z", "-Z", "+X", "-X"])
def test_a_force_along_the_spindle_of_plunges_alone_needs_no_travel_across_it(axis):
    """FEED axes have z along the spindle; any x will do."""
    made = program(
        [("PTP", 0, 0, 20), ("LIN", 0, 0, 5), ("LIN", 0, 0, 0)], notes=[(2, (0, 0, 90.0, 0, 0, 4.0), "FEED")]
    )
    down = {"+Z": np.diag([1.0, -1, -1]), "-Z": np.eye(3)}
    side = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    turned = down.get(axis, side if axis == "+X" else -side @ np.diag([1.0, -1, 1]))
    target = made.motions.target[:]
    target[:, :3, :3] = turned
    made = replace(made, motions=replace(made.motions, target=Poses.of(target)))
    end = toolpath.at(made, toolpath.segments(made, START), np.array([2]), np.ones(1))
    np.testing.assert_allclose(put_on(made, None, axis).at(end)[0], [0, 0, 90, 0, 0, 4], atol=1e-9)


def test_a_force_on_a_rapid_is_ignored_and_told(tmp_path):
    rows = forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz,line_end\n1,5,5,5,4\n"))
    load = put_on(program(SQUARE), rows)
    assert not at_ends(program(SQUARE), rows)[[0, 3]].any()
    assert [issue.kind for issue in load.issues] == ["force-on-rapid"]


def test_rapids_of_a_line_that_also_cuts_get_no_warning(tmp_path):
    """A drilling cycle: approach, cut and retract are one line. The row is that of the cut."""
    cycle = [("RAPID", 0, 0, 2), ("LIN", 0, 0, -5), ("RAPID", 0, 0, 20), ("RAPID", 50, 0, 20)]
    made = program(cycle)
    made = replace(made, motions=replace(made.motions, line=np.array([1, 1, 1, 2])))
    table = forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz\n1,0,0,300\n"))
    assert not put_on(made, table).issues
    np.testing.assert_allclose(at_ends(made, table)[:, 2], [0, 300, 0, 0])
    table = forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz\n1,0,0,300\n2,0,0,300\n"))
    (issue,) = put_on(made, table).issues
    assert (issue.kind, issue.source_line) == ("force-on-rapid", 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("line,Fx,Fy\n1,2,3\n", "missing column Fz"),
        ("line,Fx,Fy,Fz,Fw\n1,2,3,4,5\n", "unknown column 'Fw'"),
        ("line,Fx,Fy,Fz\n2,nan,0,0\n", r"forces\.csv:2: column Fx is not a finite number"),
        ("line,Fx,Fy,Fz\n2,inf,0,0\n", "not a finite number"),
        ("line,Fx,Fy,Fz\n2,1e999,0,0\n", "not a finite number"),
        ("line,Fx,Fy,Fz\n2,12 N,0,0\n", "not a finite number"),
        ("line,Fx,Fy,Fz\n2,,0,0\n", "not a finite number"),
        ("line,Fx,Fy,Fz\n2,1,0\n", r"forces\.csv:2: 3 values where the header has 4"),
        ("line,Fx,Fy,Fz\n99,1,0,0\n", "no motion starts on line 99"),
        ("line,Fx,Fy,Fz\n2.5,1,0,0\n", "line is 2.5"),
        ("line,Fx,Fy,Fz,frame\n2,1,0,0,WORLD\n", "unknown frame 'WORLD'"),
        ("line,Fx,Fy,Fz,line_end\n3,1,0,0,2\n", "line_end is before line"),
        ("line,Fx,Fy,Fz\n2,1,0,0\n2,1,0,0\n", "a second row for line 2"),
        ("line,Fx,Fy,Fz\n1e300,1,0,0\n", r"forces\.csv:2: line is 1e\+300"),
        ("line,Fx,Fy,Fz\nx,1,0,0\n", r"forces\.csv:2: column line is not a finite number: 'x'[^\n]*$"),
        ("line,Fx,Fy,Fz\n-1,1,0,0\n", r"forces\.csv:2: line is -1"),
        ("line,Fx,Fy,Fz\n2,1e300,0,0\n", r"forces\.csv:2: Fx is 1e\+300"),
        ("line,Fx,Fy,Fz,line_end\n1,1,0,0,4\n2,1,0,0,\n3,1,0,0,\n", r"forces\.csv:3: .*\n.*csv:4: a second row"),
        ("line;Fx;Fy;Fz\n2;1,5;0;0\n", "columns separated by semicolons.*Separate the columns by commas"),
        ("line\tFx\tFy\tFz\n2\t1\t0\t0\n", "columns separated by tabs"),
        ("line,Fx,Fy,Fz\n2;1;0;0\n", r"forces\.csv:2: values separated by semicolons"),
        ("line,Fx,Fy,Fz\n2," + "1" * 200_000 + ",0,0\n", "not a valid CSV file"),
        ("", "empty file"),
    ],
)
def test_a_bad_force_file_is_refused_with_its_place(tmp_path, text, message):
    with pytest.raises(ForceError, match=message):
        put_on(program(SQUARE), forces.read_force_csv(write(tmp_path, text)))


def test_all_errors_of_a_force_file_are_told_in_order_of_lines(tmp_path):
    text = "line,Fx,Fy,Fz,frame\n2,1,0,0,WORLD\n3,1,0\n2.5,x,0,0,\n4,0,0,0,\n4,0,0,1e9,\n"
    with pytest.raises(ForceError) as caught:
        forces.read_force_csv(write(tmp_path, text))
    error = caught.value
    assert [(e.line, e.problem) for e in (error, *error.further_errors)] == [
        (2, "unknown frame 'WORLD'"),
        (3, "3 values where the header has 5"),
        (4, "column Fx is not a finite number: 'x'"),
        (4, "line is 2.5"),
        (6, "Fz is 1e+09"),
        (6, "a second row for line 4"),
    ]


@pytest.mark.parametrize("line", ["0", "x", "2.5", "1e300", "-3", ""])
def test_a_row_without_a_line_is_no_second_row_for_another_one(tmp_path, line):
    for rows in (f"{line},1,0,0\n1,1,0,0\n2,1,0,0\n", f"1,1,0,0\n{line},1,0,0\n2,1,0,0\n"):
        with pytest.raises(ForceError) as caught:
            forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz\n" + rows))
        assert caught.value.line == 2 + rows.split("\n").index(f"{line},1,0,0")
        assert not caught.value.further_errors


def test_force_comments_are_read_in_any_case_and_others_are_left_alone():
    note = parse_force_note(" force fx=120 FY=-40.5 Fz=3e2 mx=1 FRAME=tool", 7, "a.nc")
    assert (note.wrench, note.frame, note.line) == ((120.0, -40.5, 300.0, 1.0, 0.0, 0.0), "TOOL", 7)
    assert parse_force_note("FORCE OFF", 1, "a.nc").wrench == (0.0,) * 6
    assert parse_force_note("FORCED COOLING", 1, "a.nc") is None
    assert parse_force_note("roughing", 1, "a.nc") is None


@pytest.mark.parametrize(
    "text",
    [
        "FORCE FX 100",
        "FORCE FX=nan",
        "FORCE FX=1e7",
        "FORCE FX=1 FX=2",
        "FORCE FX=1 FRAME=WORLD",
        "FORCE 100",
        "FORCE",
        "FORCE ON",
        "FORCE: FX=100",
        "FORCES FX=100 FY=5",
        "FORCES OFF",
        "FORCEOFF",
        "FORC FX=100",
        "Froce fx = -100.5",
        "CUTTING FORCE FX=100",
        "FX=100 FY=20 FZ=0",
        "FORCE NONE HERE",
        "FORCE switched off",
        "FORCE IS ZERO",
        "FORCE NOT GIVEN YET",
        "FORCE in the frame",
        "FORCE about 100 N",
        "FORCE unknown FX",
        "FORCE exact path FX=100",
        "FORCE feed",
        "FORCE fx fy",
    ],
)
def test_a_force_comment_that_cannot_be_read_is_an_error_with_its_line(text):
    with pytest.raises(ForceError, match=r"a\.nc:7"):
        parse_force_note(text, 7, "a.nc")


@pytest.mark.parametrize(
    "text",
    [
        "FOLD PTP P1 FX=100",
        "reinforce",
        "FX 6000 spindle",
        "AFX=1",
        "FORCED COOLING OFF",
        "Force exact path (without look-ahead)",
        " Force-torque sensor ready",
        "(Force gripper öffnen)",
    ],
)
def test_comments_about_other_things_are_no_force_comments(text):
    assert parse_force_note(text, 7, "a.nc") is None


@pytest.mark.parametrize("axis", ["+Z", "-Z", "+X", "-X"])
def test_feed_axes_do_not_depend_on_which_axis_of_the_tool_frame_is_the_spindle(axis):
    """Travel along +X of the base, spindle upright: x ahead, z up to the spindle, y = z × x to the left."""
    towards_tip = np.array([0.0, 0.0, -1.0]) * (1.0 if axis[0] == "+" else -1.0)
    other = np.array([0.6, 0.8, 0.0])
    columns = [other, np.cross(towards_tip, other), towards_tip]
    if axis[1] == "X":
        columns = [towards_tip, other, np.cross(towards_tip, other)]
    force = (10.0, 20.0, 30.0, 1.0, 2.0, 3.0)
    made = program(SQUARE, notes=[(2, force, "FEED")], orientation=np.stack(columns, axis=1))
    np.testing.assert_allclose(along(made, 1, 50, axis=axis), force, atol=1e-12)


def test_rows_for_another_program_are_one_error_that_says_which_program_they_may_be_for(tmp_path):
    """As with the file that lies beside a written program, given for the nominal one."""
    path = write(tmp_path, "line,Fx,Fy,Fz\n" + "".join(f"{line},1,0,0\n" for line in (2, *range(900, 960))))
    with pytest.raises(ForceError) as raised:
        at_ends(program(SQUARE), forces.read(path))
    told = str(raised.value)
    assert told.count("no motion starts") == 1
    assert "60 rows of 61" in told
    assert "not to the original" in told


class OfKnots:
    """Forces in $BASE at given places of motions: {motion: [(t, wrench), …]}."""

    name = "knots"

    def __init__(self, knots):
        self.knots = knots

    def along(self, program, path):
        motion = np.repeat(list(self.knots), [len(rows) for rows in self.knots.values()])
        t, wrench = (np.array([row[k] for rows in self.knots.values() for row in rows]) for k in (0, 1))
        return Knots.along(motion, t, wrench, np.zeros(len(motion), dtype=np.int64))


def test_places_at_which_the_rate_of_the_force_changes_are_those_off_the_line_between_their_neighbours():
    """Uneven places: on one motion the force grows evenly, on the others each component bends at one place."""
    made = program([("LIN", 0, 0, 0), *(("LIN", 100 * n, 50, 0) for n in range(1, 6))])
    places, slope = np.array([0.0, 0.1, 0.35, 0.6, 0.9, 1.0]), np.array([300.0, -200, 100, 9, -7, 5])
    expected, knots = [], {}
    for motion in range(1, 6):
        values = 40.0 + places[:, None] * slope
        if motion > 1:
            values[motion:, motion] += 80.0 * (places[motion:] - places[motion - 1])  # bends at the knot before
            expected.append((motion, places[motion - 1]))
        knots[motion] = list(zip(places, values, strict=True))
    load = put_on(made, OfKnots(knots))
    motion = np.repeat(np.arange(6), np.diff(load.first))
    change, bent = path_forces._changes_and_bends(load, motion)
    assert [(int(m), float(t)) for m, t in zip(motion[bent], load.t[bent], strict=True)] == expected
    for row in range(1, len(motion)):
        same = motion[row] == motion[row - 1]
        wanted = load.wrench[:][row] - load.wrench[:][row - 1] if same else np.zeros(6)
        np.testing.assert_allclose(change[row], wanted, atol=1e-12)
