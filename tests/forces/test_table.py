"""Rows of a force CSV along a move, and standard deviations."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import forces, toolpath
from postproc.errors import ForceError
from postproc.frames import pose_from_xyzabc
from postproc.poses import Poses
from tests.programs import program

START = np.eye(4)
RAMP = 1e-3
MOVES = [("PTP", 0, 0, 0), ("LIN", 100, 0, 0), ("LIN", 100, 50, 0), ("LIN", 0, 50, 0), ("RAPID", 0, 50, 20)]


def write(tmp_path, text):
    path = tmp_path / "forces.csv"
    path.write_text(text, encoding="utf-8")
    return path


def put_on(made, tmp_path, text):
    path = toolpath.segments(made, START)
    return path, forces.assign(made, path, forces.read_force_csv(write(tmp_path, text)), "+Z", RAMP)


def along(made, tmp_path, text, motion, t):
    path, load = put_on(made, tmp_path, text)
    places = np.asarray(t, dtype=float)
    return load.at(toolpath.at(made, path, np.full(len(places), motion), places))


def test_between_rows_of_a_line_the_force_is_linear_and_outside_constant_without_a_ramp(tmp_path):
    text = "line,t,Fx,Fy,Fz,Mz\n2,0.25,100,0,0,4\n2,0.75,-100,50,0,0\n"
    found = along(program(MOVES), tmp_path, text, 1, [1e-9, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0])
    np.testing.assert_allclose(found[:, 0], [100, 100, 100, 0, -100, -100, -100], atol=1e-9)
    np.testing.assert_allclose(found[:, 1], [0, 0, 0, 25, 50, 50, 50], atol=1e-9)
    np.testing.assert_allclose(found[:, 5], [4, 4, 4, 2, 0, 0, 0], atol=1e-9)


def test_the_next_move_ramps_up_from_the_last_row(tmp_path):
    text = "line,t,Fx,Fy,Fz\n2,0,0,0,0\n2,0.5,200,0,0\n3,,0,80,0\n"
    found = along(program(MOVES), tmp_path, text, 2, [0.01, 0.02, 1.0])  # 0.5 and 1 mm of 50
    np.testing.assert_allclose(found[:, :2], [[100, 40], [0, 80], [0, 80]], atol=1e-9)


def test_rows_of_a_range_of_lines_hold_for_each_move_of_it(tmp_path):
    text = "line,line_end,t,Fx,Fy,Fz\n2,4,0,0,0,0\n2,4,1,90,0,0\n"
    for motion in (1, 2, 3):
        np.testing.assert_allclose(along(program(MOVES), tmp_path, text, motion, [1 / 3])[0, 0], 30, atol=1e-9)


def test_feed_forces_along_an_arc_are_linear_in_axes_that_turn_with_it(tmp_path):
    made = program([("PTP", 50, 0, 0), ("CIRC", -50, 0, 0, 0, 0, 0, 180.0, (0, 0, 1))])
    text = "line,t,Fx,Fy,Fz,frame\n2,0,0,0,0,FEED\n2,1,60,0,30,FEED\n"
    found = along(made, tmp_path, text, 1, [0.5, 1.0])  # travel along −X, then −Y
    np.testing.assert_allclose(found[:, :3], [[-30, 0, 15], [0, -60, 30]], atol=1e-9)


def test_knots_beyond_the_rows_of_one_line_do_not_reach_the_next(tmp_path):
    text = "line,t,Fx,Fy,Fz\n2,1,10,0,0\n3,0,20,0,0\n3,0.001,30,0,0\n4,0.999,40,0,0\n4,1,50,0,0\n"
    made = program(MOVES)
    assert [along(made, tmp_path, text, motion, [0.5])[0, 0] for motion in (1, 2, 3)] == [10, 30, 40]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("line,t,Fx,Fy,Fz\n2,1.5,0,0,0\n", r"forces\.csv:2: t is 1\.5"),
        ("line,t,Fx,Fy,Fz\n2,-0.1,0,0,0\n", r"forces\.csv:2: t is -0\.1"),
        ("line,t,Fx,Fy,Fz\n2,x,0,0,0\n", "column t is not a finite number"),
        ("line,t,Fx,Fy,Fz\n2,0.5,0,0,0\n2,0.2,0,0,0\n", r"csv:3: t = 0\.2 is not larger than in the row before"),
        ("line,t,Fx,Fy,Fz\n2,0.5,0,0,0\n2,0.5,1,0,0\n", r"csv:3: t = 0\.5 is not larger"),
        ("line,t,Fx,Fy,Fz\n2,0.5,0,0,0\n2,,1,0,0\n", r"csv:3: a second row for line 2"),
        ("line,t,Fx,Fy,Fz\n2,,0,0,0\n2,0.5,1,0,0\n", r"csv:3: a second row for line 2"),
        ("line,line_end,t,Fx,Fy,Fz\n2,3,0.5,0,0,0\n2,2,0.6,1,0,0\n", r"csv:3: a second row for line 2"),
        ("line,line_end,t,Fx,Fy,Fz\n2,3,0.5,0,0,0\n2,3,0.6,1,0,0\n3,,,1,0,0\n", r"csv:4: a second row for line 3"),
        ("line,t,frame,Fx,Fy,Fz\n2,0.5,FEED,0,0,0\n2,0.6,BASE,1,0,0\n", "csv:3: another frame than the row before"),
        ("line,Fx,Fy,Fz\n1.5e9,0,0,0\n", r"csv:2: line is 1\.5e\+09"),
        ("line,Fx,Fy,Fz\n2.5,0,0,0\n", r"csv:2: line is 2\.5"),
        ("line,Fx,Fy,Fz\n0,0,0,0\n", r"csv:2: line is 0"),
        ("line,Fx,Fy,Fz,sFx\n2,0,0,0,-1\n", r"csv:2: sFx is -1"),
        ("line,Fx,Fy,Fz,sigma_percent\n2,0,0,0,-5\n", r"csv:2: sigma_percent is -5"),
        (
            "line,Fx,Fy,Fz,sFx,sigma_percent\n2,0,0,0,1,5\n",
            "csv:2: standard deviations in addition to sigma_percent = 5",
        ),
    ],
)
def test_rows_that_cannot_be_meant_are_refused_with_their_place(tmp_path, text, message):
    with pytest.raises(ForceError, match=message):
        forces.read_force_csv(write(tmp_path, text))


def test_rows_of_a_line_need_not_follow_each_other_in_the_file(tmp_path):
    text = "line,t,Fx,Fy,Fz\n3,0,0,8,0\n2,0,0,0,0\n2,1,100,0,0\n3,1,0,0,0\n"
    assert along(program(MOVES), tmp_path, text, 1, [0.5])[0, 0] == pytest.approx(50)
    assert along(program(MOVES), tmp_path, text, 2, [0.5])[0, 1] == pytest.approx(4)


def covariance(made, tmp_path, text, motion, t):
    path, load = put_on(made, tmp_path, text)
    spread = load.spread_at(toolpath.at(made, path, np.array([motion]), np.array([t])))
    return None if spread is None else spread[0] @ np.swapaxes(spread[0], 1, 2)


def test_standard_deviations_turn_with_their_frame_and_are_linear_between_rows(tmp_path):
    made = program(MOVES)
    text = "line,t,frame,Fx,Fy,Fz,sFx,sFy,sFz\n3,0,FEED,1,1,1,2,4,6\n3,1,FEED,1,1,1,4,4,0\n"
    force, moment = covariance(made, tmp_path, text, 2, 0.5)  # travel along +Y: x is Y, y is −X
    np.testing.assert_allclose(force, np.diag([16.0, 9.0, 9.0]), atol=1e-9)
    assert not moment.any()


def test_sigma_percent_is_of_each_component(tmp_path):
    text = "line,Fx,Fy,Fz,Mx,sigma_percent\n2,100,-50,0,8,10\n3,1,1,1,1,\n"
    force, moment = covariance(program(MOVES), tmp_path, text, 1, 1.0)
    np.testing.assert_allclose(np.diag(force), [100, 25, 0])
    np.testing.assert_allclose(np.diag(moment), [0.64, 0, 0])
    assert not covariance(program(MOVES), tmp_path, text, 2, 1.0)[0].any()


def test_a_sigma_of_zero_percent_is_none(tmp_path):
    table = forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz,sigma_percent\n2,100,-50,0,0\n"))
    assert not table.sigma.any()


def test_on_the_ramp_the_deviation_is_mixed_as_the_force_is(tmp_path):
    text = "line,frame,Fx,Fy,Fz,sFx\n2,FEED,9,0,0,6\n3,FEED,9,0,0,2\n"
    force, _ = covariance(program(MOVES), tmp_path, text, 2, 0.01)  # half of the ramp: 3·X̂ of the one, 1·Ŷ of the other
    expected = np.array([[3.0], [1.0], [0.0]])
    np.testing.assert_allclose(force, expected @ expected.T, atol=1e-9)


def test_without_deviations_there_is_no_covariance(tmp_path):
    made = program(MOVES)
    assert covariance(made, tmp_path, "line,Fx,Fy,Fz\n2,1,1,1\n", 1, 1.0) is None
    path, load = put_on(made, tmp_path, "line,Fx,Fy,Fz\n2,1,1,1\n")
    assert load.spread_in_root(toolpath.at(made, path, np.array([1]), np.array([1.0]))) is None


def test_stated_deviations_without_a_factor_are_the_whole_covariance(tmp_path):
    made = program(MOVES)
    path, load = put_on(made, tmp_path, "line,Fx,Fy,Fz,Mx,sFx,sFy,sMx\n2,100,-50,9,8,3,5,2\n3,1,1,1,1,,,\n")
    (factors,) = load.spread_in_root(toolpath.at(made, path, np.array([1]), np.array([1.0])))
    np.testing.assert_allclose(factors @ factors.T, np.diag([9.0, 25, 0, 4, 0, 0]), atol=1e-9)
    assert factors.shape == (6, 6), "one covariance: further columns would be that of a factor"


def test_behind_a_branch_the_ramp_begins_with_the_factor_of_the_move_that_leads_there(tmp_path):
    """The fourth move begins where the second ends; the third, in another branch, has a factor of its own."""
    made = replace(program(MOVES), after=np.array([-1, 0, 1, 1, 3]))
    text = "line,Fx,Fy,Fz,factor_percent\n2,100,0,0,10\n3,100,0,0,50\n4,0,100,0,20\n"
    path, load = put_on(made, tmp_path, text)
    half = toolpath.at(made, path, np.array([3]), 0.5 * RAMP / path.length[[3]])
    (factors,) = load.spread_in_root(half)
    np.testing.assert_allclose(factors[:, 12], [5, 10, 0, 0, 0, 0], atol=1e-9)
    assert not factors[:, 6:12].any(), "the force is uncertain by its factor alone"


@pytest.mark.parametrize("frame", ["BASE", "TOOL", "FEED"])
def test_a_move_that_only_turns_the_tool_has_no_force_unless_one_is_stated(tmp_path, frame):
    """Without a row it has zero force and no warning; those of the moves next to it are their own."""
    made = program([*MOVES[:2], MOVES[1], *MOVES[2:4]])
    target = made.motions.target[:].copy()
    target[2:, :3, :3] = target[2:, :3, :3] @ pose_from_xyzabc([0, 0, 0, 0, 20, 0])[:3, :3]
    made = replace(made, motions=replace(made.motions, target=Poses.of(target)))
    path, load = put_on(made, tmp_path, f"line,frame,Fx,Fy,Fz\n2,{frame},80,0,0\n4,{frame},0,40,0\n")
    assert (np.diff(load.first) > 0).all()
    assert [(issue.kind, issue.lines) for issue in load.issues] == [("no-force", (5,))]
    ends = load.at(toolpath.at(made, path, np.arange(5), np.ones(5)))
    np.testing.assert_allclose(np.linalg.norm(ends[:, :3], axis=1), [0, 80, 0, 40, 0], atol=1e-9)
    half = toolpath.at(made, path, np.array([3]), 0.5 * RAMP / path.length[[3]])
    np.testing.assert_allclose(np.linalg.norm(load.at(half)[0, :3]), 20, atol=1e-2)


def test_a_table_without_rows_is_refused(tmp_path):
    with pytest.raises(ForceError, match="a header without rows"):
        forces.read_force_csv(write(tmp_path, "line,Fx,Fy,Fz\n\n"))
