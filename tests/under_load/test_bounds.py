"""A path that no arm could drive is refused before any work, with its line."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, frames, jobs, kinematics, robot, toolpath, under_load
from postproc.poses import Poses
from postproc.program import Carriage
from postproc.under_load import ImpossiblePathError
from tests.kr270 import CELL, ROBOT
from tests.programs import program

DOWN = CELL.tool_orientation()
UP = (0.0, 0.0, 1.0)
APPROACH = [("PTP", 0, 0, 50), ("LIN", 0, 0, 0)]


@pytest.mark.parametrize(
    ("move", "kind"),
    [
        (("LIN", 9e6, 0, 0), "unreachable"),
        (("LIN", 0, 0, -5000), "unreachable"),
        (("RAPID", 0, -1e5, 0), "unreachable"),
        (("CIRC", 0, 0, 0, 9e5, 0, 0, 360.0, UP), "unreachable"),
        (("CIRC", 1000, 0, 0, 500, 4000, 0, 345.0, UP), "unreachable"),
        (("CIRC", 0, 0, 0, 5, 0, 0, 36e6, UP), "turns"),
        (("CIRC", 0, 0, 100, 5, 0, 0, 361000.0, UP), "turns"),
    ],
)
@pytest.mark.parametrize("mode", ["convert", "predict"])
def test_absurd_moves_are_refused_without_sampling(monkeypatch, move, kind, mode) -> None:
    monkeypatch.setattr(toolpath, "places", lambda *_, **__: pytest.fail("the path is sampled"))
    (issue,) = correction.process(program([*APPROACH, move], orientation=DOWN), ROBOT, CELL, mode=mode).issues
    assert (issue.level, issue.kind, issue.source_line) == ("error", kind, 3)


def test_a_path_of_absurd_length_is_refused() -> None:
    there_and_back = [("LIN", 1500.0 * (n % 2), 0, 0) for n in range(30_000)]
    (issue,) = correction.process(program([*APPROACH, *there_and_back], orientation=DOWN), ROBOT, CELL).issues
    assert (issue.level, issue.kind) == ("error", "path-length")


def test_flat_arcs_of_large_radius_and_threads_are_fine() -> None:
    flat = program([*APPROACH, ("CIRC", 100, 0, 0, 50, -2e6, 0, np.degrees(100 / 2e6), (0, 0, -1))], orientation=DOWN)
    thread = program([*APPROACH, ("CIRC", 0, 0, 50, 5, 0, 0, 360.0 * 40, UP)], orientation=DOWN)
    for made in (flat, thread):
        path = toolpath.segments(made, np.eye(4))
        under_load.check_ends(made, ROBOT)
        under_load.check_arcs(made, ROBOT, path)


@pytest.mark.parametrize("zero_of_A5", [0.0, np.pi], ids=["outstretched", "folded back"])
@pytest.mark.parametrize("name", sorted(robot.shipped_models()))
def test_no_pose_within_the_joint_limits_is_beyond_the_reach(name: str, zero_of_A5: float) -> None:
    model = jobs.load_robot(name)
    placement = model.nominal.placement.copy()
    placement[4, :3, :3] @= frames.rotation_from_vector(zero_of_A5 * model.nominal.axis[4])
    model = replace(model, nominal=replace(model.nominal, placement=placement))
    rng = np.random.default_rng(3)
    q = rng.uniform(-np.pi, np.pi, (50_000, 6))
    away = np.linalg.norm(kinematics.tcp(model.nominal, q, np.eye(4))[0][:, :3, 3], axis=1)
    assert 0.8 < away.max() / under_load._reach(model) < 1.0


REACH = under_load._reach(ROBOT)
BASE = np.array([1500.0, -200.0, 700.0])
TO_FLANGE = np.array([0.0, 0.0, 350.0])


def refused(made):
    """Return the issue with which a program is refused, or None."""
    try:
        under_load.check_ends(made, ROBOT)
        under_load.check_arcs(made, ROBOT, toolpath.segments(made, np.eye(4)))
    except ImpossiblePathError as error:
        return error.issue
    return None


def at_flange(x, y, z):
    """Target of a move [mm, $BASE] for the flange to stand at (x, y, z) [mm] in the root."""
    return tuple(np.array([x, y, z]) - TO_FLANGE - BASE)


@pytest.mark.parametrize("direction", [(0.6, 0.8, 0.0), (-0.48, 0.64, 0.6), (0.0, 0.6, -0.8)])
def test_ends_are_refused_exactly_beyond_the_reach_and_the_message_says_by_how_much(direction) -> None:
    for size, bad in ((0.999, False), (1.001, True)):
        spot = at_flange(*(np.array(direction) * size * REACH * 1e3))
        made = program([("PTP", 0, 0, 50), ("PTP", *spot)], orientation=DOWN)
        issue = refused(made)
        assert (issue is not None) == bad
    assert (issue.kind, issue.source_line) == ("unreachable", 2)
    assert f"up to {REACH * 1001:.0f} mm from the robot's root, and its reach is {REACH * 1000:.0f} mm" in issue.message


def arc(angles, centre, radius, height=1000.0):
    """Moves to an arc about a vertical axis and along it; centre and radius of the flange [mm], angles [deg]."""
    first, last = np.radians(angles)
    ends = [at_flange(centre[0] + radius * np.cos(a), centre[1] + radius * np.sin(a), height) for a in (first, last)]
    middle = at_flange(centre[0], centre[1], height)
    return [*APPROACH, ("LIN", *ends[0]), ("CIRC", *ends[1], *middle, angles[1] - angles[0], UP)]


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_an_arc_whose_ends_are_within_reach_is_refused_where_it_swings_out_of_it(share) -> None:
    level = np.sqrt(REACH**2 - 1.0) * 1e3
    radius, sweep = 1000.0, 200.0
    for away, bad in ((level - radius - 20.0, False), (level - 0.8 * radius, True)):
        turned = np.radians(35.0)  # the arc bulges outwards in this direction, at this share of it
        centre = away * np.array([np.cos(turned), np.sin(turned)])
        first = 35.0 - share * sweep
        issue = refused(program(arc((first, first + sweep), centre, radius), orientation=DOWN))
        assert (issue is not None) == bad
    assert (issue.kind, issue.source_line) == ("unreachable", 4)
    assert f"leaves the reach of the flange, {REACH * 1e3:.0f} mm" in issue.message


def test_full_circles_are_refused_by_their_radius_alone() -> None:
    for radius, bad in ((0.99 * REACH * 1e3, False), (1.01 * REACH * 1e3, True)):
        start = at_flange(1500.0, 0.0, 1000.0)
        centre = at_flange(1500.0 - radius, 0.0, 1000.0)
        made = program([*APPROACH, ("LIN", *start), ("CIRC", *start, *centre, 360.0, UP)], orientation=DOWN)
        issue = refused(made)
        assert (issue is not None) == bad
    assert issue.kind == "unreachable"


def test_full_circles_may_be_anywhere_within_reach() -> None:
    """Behind the robot, far from the origin of $BASE."""
    start, centre = at_flange(-1100.0, 0.0, 1000.0), at_flange(-1000.0, 0.0, 1000.0)
    made = program([*APPROACH, ("LIN", *start), ("CIRC", *start, *centre, 360.0, UP)], orientation=DOWN)
    assert np.linalg.norm(np.add(start, centre)) > 1.2e3 * REACH
    assert refused(made) is None


def test_ends_are_seen_from_where_the_linear_axis_has_carried_the_robot() -> None:
    for size, bad in ((0.999, False), (1.001, True)):
        spot = at_flange(1e3 * (1.0 + size * REACH), 0.0, 0.0)
        made = program([("PTP", 0, 0, 50), ("PTP", *spot)], orientation=DOWN)
        assert refused(made) is not None
        carriage = Carriage(np.array([0.0, 0.0]), np.array([0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
        assert (refused(replace(made, carriage=carriage)) is not None) == bad


def test_arcs_of_up_to_a_thousand_turns_are_taken() -> None:
    for turns, bad in ((999.0, False), (1002.5, True)):
        made = program([*APPROACH, ("CIRC", 0, 0, 50, 5, 0, 0, 360.0 * turns, UP)], orientation=DOWN)
        issue = refused(made)
        assert (issue is not None) == bad
    assert (issue.kind, issue.source_line) == ("turns", 3)
    assert issue.message.startswith("an arc of 1002.5 turns, more than the permitted 1000")


def test_the_longest_path_is_ten_thousand_times_the_reach() -> None:
    for metres, bad in ((9990.0 * REACH, False), (10010.0 * REACH, True)):
        count = 16
        degrees = 360.0 * round(metres / count / (2.0 * np.pi * 0.5))  # of whole turns with a radius of 0.5 m
        made = program([*APPROACH, *[("CIRC", 0, 0, 50, 500, 0, 50, degrees, UP)] * count], orientation=DOWN)
        path = toolpath.segments(made, np.eye(4))
        assert (path.length.sum() > 10_000 * REACH) == bad
        issue = refused(made)
        assert (issue is not None) == bad
    assert (issue.kind, issue.source_line) == ("path-length", 1)
    assert issue.message.startswith("the path is 39 km long, more than 10000 times the reach of the robot")


def test_axis_targets_are_not_asked_where_they_are() -> None:
    made = program([("PTP", 0, 0, 50), ("PTP", 9e6, 0, 0)], orientation=DOWN)
    joints = made.motions.joints[:]
    joints[1] = 0.1
    assert refused(made) is not None
    target = made.motions.target[:]
    target[1, :3, 3] = np.nan
    assert refused(replace(made, motions=replace(made.motions, joints=joints, target=Poses.of(target)))) is None
