"""The turn about the tool axis in whole programs: what can be driven, what it costs, and what the robot then does."""

from __future__ import annotations

import itertools
import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, placement, robot
from postproc.cell import Box, Collision, HolderTable, ObstacleTable, Rotary
from postproc.frames import rotation_from_vector
from postproc.placement import REASONS, drive, turn_map, turning
from postproc.placement.samples import PathSamples
from postproc.poses import Poses
from postproc.report import summary
from postproc.under_load import RobotInCell
from tests.corrections import read_back
from tests.oracle import cell_sim
from tests.oracle.arm import Arm
from tests.placement.setting import TWO_POCKETS, around, cell, process_text, read_with_robot

POCKETS = TWO_POCKETS.format(1300, 1500)
POCKET_BASE = (0.0, 0.0, 500.0)


@pytest.fixture(scope="module")
def turned_pockets():
    """Both pockets, each at its best turn, without bodies."""
    return process_text(POCKETS, cell(base=POCKET_BASE, redundancy="best"))


@pytest.mark.parametrize("axes", [None, ["C", "B"]])
def test_a_turn_of_all_motions_is_the_turn_that_the_cell_could_state(axes):
    """Five axes too: a turn about the tool axis, whatever direction that has."""
    text = "G21 G90\nG0 X1500 Y0 Z60\nG1 Z0 F1500\nG1 X1600 F2000\n"
    if axes is not None:
        text = text.replace("X1600", "X1600 C30 B20").replace("G0 X1500", "G0 C0 B0 X1500")
    plain = cell() if axes is None else replace(cell(), rotary=Rotary(axes=axes, kind="tcp"))
    stated = replace(plain, gcode=replace(plain.gcode, redundancy_deg=40.0))
    one, other = read_with_robot(text, plain)[0], read_with_robot(text, stated)[0]
    turned = placement.turn_program(one, "+X", np.full(len(one.motions), np.radians(40.0)))
    assert np.allclose(turned.motions.target, other.motions.target, atol=1e-12)
    if axes is not None:
        t, rows = np.full(len(one.motions), 0.4), np.arange(len(one.motions))
        assert np.allclose(turned.swivel.at(rows, t), other.swivel.at(rows, t), atol=1e-12)


@pytest.mark.parametrize("name", ["kuka_kr270", "abb_irb6700_200_260"])
def test_a_program_that_no_constant_turn_can_drive_is_driven_along_the_path(name):
    text, own = around(1900, 150), cell(name)
    for turn in range(-180, 180, 60 if name == "kuka_kr270" else 120):
        assert process_text(text, replace(own, gcode=replace(own.gcode, redundancy_deg=float(turn)))).failed
    best = process_text(text, replace(own, gcode=replace(own.gcode, redundancy="best")))
    assert [issue.kind for issue in best.issues if issue.level == "error"] == ["redundancy"]
    assert 'redundancy = "path"' in next(issue.message for issue in best.issues if issue.level == "error")
    path = process_text(text, replace(own, gcode=replace(own.gcode, redundancy="path")))
    assert not path.failed, path.issues
    content = summary(path).redundancy
    assert content.mode == "path"
    assert content.max_deg - content.min_deg > 20.0


SLOW, BINDING = 3000, 112_000
"""Feeds [mm/min]: A4 would be too fast at the second one if the line turned a little faster."""


@cache
def driven(feed):
    """The written program by the simulator of a controller.

    :returns: the cell, joint angles (n, 6) [rad] in the order of execution, the path since the one before (n,) [m], and
        whether the move is a cut (n,).
    """
    own = cell(redundancy="path")
    result = process_text(around(1900, 150, 31, feed), own)
    assert not result.failed, result.issues
    moves = cell_sim.read(result.documents[0].to_bytes().decode())[1:]  # the first one goes to the start
    frame = lambda table: tuple(getattr(table, axis) for axis in "XYZABC")  # noqa: E731
    start = np.degrees(result.q[0])  # from far away the least squares of the arm may end in another solution
    sim = cell_sim.Cell(Arm.load(robot.find(own.robot)), start, frame(own.base), frame(own.tool))
    q, place, cut = [], [], []
    for index, _, pose, joints in sim.run(moves, shares=(0.5, 1.0)):
        q.append(joints)
        place.append(pose[:3, 3])
        cut.append(moves[index]["kind"] == "LIN" and abs(moves[index]["frame"][2]) < 1.0)
    travel = np.linalg.norm(np.diff(place, axis=0, prepend=place[:1]), axis=1)
    return own, np.array(q), travel, np.array(cut)


@pytest.mark.parametrize(("feed", "least"), [(SLOW, 0.02), (BINDING, 0.9)])
def test_the_written_program_stays_within_joint_limits_and_speeds_by_the_simulator(feed, least):
    own, q, travel, cut = driven(feed)
    model = robot.load(robot.find(own.robot))
    assert (q > model.lower).all()
    assert (q < model.upper).all()
    rows = np.flatnonzero(cut[1:] & cut[:-1] & (travel[1:] > 1e-4)) + 1
    assert len(rows) > 50
    share = np.abs(q[rows] - q[rows - 1]) * feed / 60_000 / travel[rows, None] / model.speed
    assert least < share.max() <= 1.0


def test_a_feed_at_which_no_line_keeps_the_joint_speeds_is_refused():
    found = process_text(around(1900, 150, 31, 125_000), cell(redundancy="path"))
    assert any("joint speed" in issue.message for issue in found.issues if issue.level == "error")


@pytest.mark.parametrize("feed", [SLOW, BINDING])
def test_a6_never_jumps_by_the_simulator(feed):
    _, q, _, cut = driven(feed)
    steps = np.degrees(np.abs(np.diff(q, axis=0)))[cut[1:] & cut[:-1]]
    assert 0.5 < steps[:, 5].max() < 6.0
    assert np.ptp(np.degrees(q[:, 5])) < 360.0


def expected_rms(result, lines):
    """RMS of the expected error along the cuts of source lines [m]."""
    chosen = ~result.rapid & np.isin(result.source_line, lines)
    return float(np.sqrt(np.average(result.bound[chosen] ** 2, weights=result.cut_length[chosen])))


def test_the_best_turn_of_each_operation_is_within_two_percent_of_all_constant_turns(turned_pockets):
    own = cell(base=POCKET_BASE)
    first, second = range(4, 8), range(10, 13)
    found = {
        turn: result
        for turn in range(-180, 180, 20)
        if not (
            result := process_text(POCKETS, replace(own, gcode=replace(own.gcode, redundancy_deg=float(turn))))
        ).failed
    }
    best = turned_pockets
    assert not best.failed, best.issues
    assert len(found) >= 3
    for lines in (first, second):
        assert expected_rms(best, lines) <= 1.02 * min(expected_rms(result, lines) for result in found.values())
        assert np.ptp(_turns(best, lines)) < 1e-6


def test_the_best_line_is_within_two_percent_of_every_pair_of_turns():
    """Brute force: a start and an end for the turn along one cut, in steps of 30°."""
    text = "G21 G90\n(FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED)\nG0 X1300 Y-300 Z60\nG1 Z0 F600\nG1 Y300 F2000\n"
    own = cell(base=(0.0, 0.0, 500.0))
    program, model = read_with_robot(text, own)
    errors = []
    for begin, end in itertools.product(range(-60, 61, 30), repeat=2):
        turned = placement.turn_program(program, "+X", np.radians([begin, begin, end]))
        result = correction.process(turned, model, own)
        if not result.failed and abs(end - begin) <= 170:
            errors.append(expected_rms(result, [4, 5]))
    path = process_text(text, replace(own, gcode=replace(own.gcode, redundancy="path")))
    assert not path.failed
    assert expected_rms(path, [4, 5]) <= 1.02 * min(errors)


def test_a_turn_along_the_path_does_not_trade_margin_and_steadiness_for_little_error():
    """Without a price the line had 2.6° of margin, 166° of turning and steps of 21° for 2 % of the expected error."""
    force = "(FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED)"
    text = f"G21 G90\n{force}\nG0 X1900 Y-200 Z60\nG1 Z0 F600\nG1 Y-50 F2000\nG1 X1960\nG1 Y-200\nG0 Z60\n"
    lines = range(4, 8)
    stated = cell(base=(0.0, 0.0, 500.0))

    def priced(result):
        """Expected error, and 0.05 mm without margin, less by e for each 10°."""
        margin = min(np.degrees(result.joint_margin).min(), np.degrees(np.abs(result.q[:, 4])).min())
        return expected_rms(result, lines) + 5e-5 * np.exp(-margin / 10.0), margin

    path = process_text(text, replace(stated, gcode=replace(stated.gcode, redundancy="path")))
    assert not path.failed, path.issues
    total, margin = priced(path)
    assert margin > 20.0
    cuts = ~path.rapid[1:] & ~path.rapid[:-1]
    assert np.degrees(np.abs(np.diff(path.q, axis=0)))[cuts].max() < 10.0
    constants = (
        process_text(text, replace(stated, gcode=replace(stated.gcode, redundancy_deg=float(turn))))
        for turn in range(-160, 200, 40)
    )
    totals = [priced(result)[0] for result in constants if not result.failed]
    assert len(totals) >= 3
    assert total <= 1.02 * min(totals)


def _turns(result, lines):
    """Turn of the tool [deg] of targets of lines, from their nominal orientation: that of tool Z about the vertical."""
    chosen = np.isin(result.source_line, lines) & ~result.rapid
    z = result.nominal[chosen][:, :3, 2]
    return np.degrees(np.unwrap(np.arctan2(z[:, 1], z[:, 0])))


def with_bodies(own, *obstacles):
    """A cell with a spindle, and boxes."""
    held = [HolderTable(diameter_mm=20, length_mm=60), HolderTable(diameter_mm=120, length_mm=200)]
    boxes = [ObstacleTable(name="wall", box=Box(*spans)) for spans in obstacles]
    return replace(own, collision=Collision(holder=held, obstacles=boxes))


def test_without_bodies_the_choice_says_that_no_collisions_are_checked():
    own = cell(base=(0.0, 0.0, 500.0))
    program, model = read_with_robot(POCKETS, own)
    free, said = placement.choose_turn(program, RobotInCell.of(model, own), None, "best")
    assert free.map.hit is None
    assert "Collisions do not count in this choice: the cell has no [collision]" in said[0].message


@pytest.mark.parametrize("mode", ["best", "path"])
def test_a_turn_that_comes_too_close_to_a_wall_is_not_chosen(mode, turned_pockets):
    """The turn that is best without the wall is an error with it; the chosen one passes the check of the path."""
    own = cell(base=POCKET_BASE, redundancy=mode)
    wall = with_bodies(own, ((1600, 1650), (-200, 0), (150, 400)))
    if mode == "best":
        same = float(np.degrees(turned_pockets.turn.of_motion[3]))
        stated = process_text(
            POCKETS, replace(wall, gcode=replace(own.gcode, redundancy="constant", redundancy_deg=same))
        )
        assert {issue.kind for issue in stated.issues if issue.level == "error"} == {"collision"}
    found = process_text(POCKETS, wall)
    assert not found.failed, found.issues
    assert found.clearance.distance >= 0.005
    closed = found.turn.map.reasons(found.turn.keep) == REASONS.index("collision")
    assert 0.02 < closed.mean() < 0.9


def test_a_collision_between_samples_of_the_map_is_found_where_the_line_goes(monkeypatch):
    """A post beside a long cut: with every 1000th sample in the map alone, the line is checked at all of them."""
    text = "G21 G90\n(FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED)\nG0 X1300 Y-400 Z60\nG1 Z0 F600\nG1 Y400 F2000\nG0 Z60\n"
    own = with_bodies(cell(base=(0.0, 0.0, 500.0), redundancy="best"), ((1450, 1470), (-5, 5), (100, 600)))
    for name, few in (("MOST_POSES", 1), ("BINS_OF_BLOCK", 1), ("MOST_BLOCKS", 1)):
        monkeypatch.setattr(turn_map, name, few)
    result = process_text(text, own)
    assert not result.failed, result.issues
    assert result.clearance.distance >= 0.005


def test_a_program_that_no_turn_can_drive_names_the_line_and_the_reason():
    text = "G21 G90\nG0 X1500 Y0 Z60\nG1 Z0 F1500\nG1 X2400 F2000\nG1 X3300\nG1 X1500\n"
    result = process_text(text, cell(redundancy="path"))
    issue = next(issue for issue in result.issues if issue.level == "error")
    assert issue.source_line in (4, 5)
    assert "joint limit" in issue.message or "out of reach" in issue.message


@pytest.mark.parametrize("mode", ["best", "path"])
def test_a_program_that_collides_with_every_turn_names_bodies_and_millimetres(mode):
    """The tip is at Z 0 and 60 mm of cutter below the spindle: a plate over the part is 20 mm below the spindle."""
    own = with_bodies(cell(base=(0.0, 0.0, 500.0), redundancy=mode), ((1000, 2000), (-600, 600), (39, 40)))
    held = [own.collision.holder[0], HolderTable(name="spindle", diameter_mm=120, length_mm=200)]
    own = replace(own, collision=replace(own.collision, holder=held, clearance_mm=30.0))
    text = "G21 G90\n(FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED)\nG0 X1300 Y0 Z200\nG1 Z62 F600\nG1 Y100 F2000\nG0 Z200\n"
    issue = next(issue for issue in process_text(text, own).issues if issue.level == "error")
    assert issue.kind == "redundancy"
    found = re.search(r"collision at \d+ % of all turns: (\w+) ([\d.]+) mm from wall at best", issue.message)
    assert found, issue.message
    assert found[1] == "cutter"
    assert float(found[2]) == pytest.approx(22.0, abs=8.0)


def test_the_turn_of_the_cell_stays_where_no_other_saves_two_percent():
    """From the best turn of the map, 4° off cost 1.4 %, 8° cost 3 %."""
    own = cell(base=(0.0, 0.0, 500.0), redundancy="best")
    text = "G21 G90\n(FORCE FX=-110 FY=-190 FZ=130 FRAME=FEED)\nG0 X1300 Y-50 Z60\nG1 Z0 F600\nG1 Y50 F2000\nG0 Z60\n"
    found = process_text(text, own)
    (best,) = set(found.turn.range_deg())
    for off, stays in ((-4.0, True), (-8.0, False)):
        stated = replace(own, gcode=replace(own.gcode, redundancy_deg=best + off))
        constant = process_text(text, replace(stated, gcode=replace(stated.gcode, redundancy="constant")))
        assert (expected_rms(constant, [4, 5]) <= 1.02 * expected_rms(found, [4, 5])) == stays
        assert process_text(text, stated).turn.range_deg() == pytest.approx((best + off * stays,) * 2, abs=1e-6)


def test_the_turn_of_the_cell_does_not_stay_where_it_comes_too_close_to_a_wall(turned_pockets):
    wall = with_bodies(cell(base=POCKET_BASE, redundancy="best"), ((1600, 1650), (-200, 0), (150, 400)))
    free = float(np.degrees(turned_pockets.turn.of_motion[3]))
    found = process_text(POCKETS, replace(wall, gcode=replace(wall.gcode, redundancy_deg=free)))
    assert not found.failed, found.issues
    assert found.turn.of_motion[3] != 0.0
    assert found.clearance.distance >= 0.005


def test_the_text_of_a_robot_program_keeps_its_turn():
    own = cell(redundancy="path")
    text = "G21 G90\nG0 X1500 Y0 Z60\nG1 Z0 F1500\nG1 X1600 F2000\n"
    written = process_text(text, replace(own, gcode=replace(own.gcode, redundancy="constant")))
    model = robot.load(robot.find(own.robot))
    program = read_back(written, own, model)
    result = correction.process(program, model, own, mode="predict")
    assert result.turn is None
    assert summary(result).redundancy is None


def test_a_cut_that_tilts_the_tool_without_rotary_axes_is_not_turned_on_the_way():
    """One rotation that tilts and turns would make the tool lean from its programmed direction between the ends."""
    own = cell(base=(0.0, 0.0, 500.0))
    program, model = read_with_robot("G21 G90\nG0 X1300 Y-300 Z60\nG1 Z0 F600\nG1 Y300 F2000\n", own)
    target = program.motions.target[:]
    target[2, :3, :3] = rotation_from_vector(np.array([[0.0, 0.2, 0.0]]))[0] @ target[2, :3, :3]
    tilted = replace(program, motions=replace(program.motions, target=Poses.of(target)))
    setting = RobotInCell.of(model, own)
    turn, said = placement.choose_turn(tilted, setting, None, "path")
    assert turn is None
    assert said[0].level == "error"
    assert said[0].source_line == 4
    assert placement.choose_turn(tilted, setting, None, "best")[0] is not None


def test_the_turns_that_are_tried_divide_the_circle():
    np.testing.assert_allclose(np.degrees(drive.TRIED_TURNS), range(-180, 180, 30), atol=1e-9)


@pytest.mark.parametrize(
    ("millimetres", "seconds", "change", "limit"),
    [
        (20.0, 10.0, 0.0, 20.0),  # 1° a millimetre
        (100.0, 0.5, 0.0, 15.0),  # 30° a second
        (100.0, 0.5, 7.0, 15.0),  # with what the columns of the map turn already
        (100.0, 0.5, -7.0, 15.0),
        (1000.0, 100.0, 0.0, 170.0),  # less than half a turn
    ],
)
def test_a_cut_turns_by_what_its_length_and_its_time_allow_and_no_more(millimetres, seconds, change, limit):
    blocks = SimpleNamespace(length=[millimetres * 1e-3], time=[seconds], is_at_feed=[True])
    base_at_ends = np.append(np.zeros(9), np.radians(change))
    columns = SimpleNamespace(blocks=blocks, offset=np.arange(120), step=np.radians(3.0), base_at_ends=base_at_ends)
    search = turn_map._LineSearch(
        columns, None, None, None, None, None, turn_at_feed=True, is_circle=True
    )  # fmt: skip
    steps = search._changes(0, slice(1, 10)).step
    assert steps.tolist() == [k for k in range(-119, 120) if abs(3.0 * k + change) <= limit + 1e-6]


def test_a_rapid_block_takes_no_time_and_a_cut_its_length_over_its_feed():
    own = cell()
    program, model = read_with_robot("G21 G90\nG0 X1300 Y0 Z60\nG1 Z0 F600\nG1 Y90 F1200\nG0 Z60\n", own)
    blocks = turn_map.Blocks.of(PathSamples.of(program, RobotInCell.of(model, own), None))
    assert not blocks.time[~blocks.is_at_feed].any()
    assert blocks.time.sum() == pytest.approx(60.0 / 10.0 + 90.0 / 20.0)


@pytest.mark.parametrize("column", [0, 4, 9])
def test_the_column_in_which_a_line_collides_is_closed_and_no_other(column):
    own = cell()
    program, model = read_with_robot("G21 G90\nG0 X1300 Y0 Z60\nG1 Z0 F600\nG1 Y90 F1200\nG0 Z60\n", own)
    samples = PathSamples.of(program, RobotInCell.of(model, own), None)
    blocks = turn_map.Blocks.of(samples)
    branch = turn_map.branch_of_start(samples)
    offset = np.arange(10) * 0.25 - 1.0  # exact: a line along a column is not between two
    columns = turn_map.evaluate(samples, blocks, branch, np.zeros(len(samples)), offset, None)
    columns = replace(columns, hit=np.zeros(columns.u95.shape, dtype=bool))
    line = turn_map.Line(np.full(len(blocks.time), offset[column]), 0.0)
    is_hit = np.arange(len(samples)) == 5
    closed = turning._close_cells(samples, columns, line, is_hit).hit
    assert np.argwhere(closed).tolist() == [[np.searchsorted(blocks.first, 5, side="right") - 1, column]]
