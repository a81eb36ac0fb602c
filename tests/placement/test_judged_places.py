"""Places of the part as `Programs` judges them, against the programs as they are read there, sample by sample."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, forces, kinematics
from postproc.cell import ExternalAxis, Frame, Start
from postproc.errors import InputError
from postproc.placement import LeastMargins, PathSamples, drive, region, turn_map
from postproc.placement.drive import BARE_MARGINS
from postproc.placement.region import JudgedPlace, Programs
from postproc.under_load import RobotInCell
from tests.collision.setting import frame
from tests.placement.by_sample import SampleBySample
from tests.placement.setting import cell, read_with_robot

GCODE = """G21 G90
(FORCE FX=-110 FY=-190 FZ=130 MY=3 FRAME=BASE)
G0 X0 Y-100 Z60
G1 Z0 F600
G1 X200 F{0}
G1 Y100
G0 Z60
"""
KRL = """DEF part()
$TOOL={{X 350,Y 0,Z 200,A 0,B 0,C 0}}
$VEL.CP=0.05
PTP {{X 0,Y -80,Z 60,A 180,B 0,C 180,E1 {0}}}
;FORCE FX=90 FY=-150 FZ=130 FRAME=BASE
LIN {{X 0,Y 0,Z 0,A 180,B 0,C 180,E1 {0}}}
LIN {{X 60,Y 0,Z 0,A 180,B 0,C 180,E1 {1}}}
$TOOL={{X 350,Y 0,Z 240,A 0,B 0,C 0}}
LIN {{X 60,Y 45,Z 40,A 175,B 0,C 175,E1 {1}}}
END
"""
KEEP = LeastMargins(joint=0.12, wrist=0.3, elbow=0.4, shoulder=0.9, speed=0.5, jump=0.2)
STATED = cell(base=(1500.0, 0.0, 700.0), redundancy_deg=110.0)
CARRIED = replace(STATED, external_axes={"E1": ExternalAxis(direction=(0.0, 2.0, 0.0))})


def gcode(own, feed=2000):
    program, model = read_with_robot(GCODE.format(feed), own)
    return PathSamples.of(program, RobotInCell.of(model, own), None)


def krl(own, e1=0.0, source=None):
    program, model = read_with_robot(KRL.format(e1, e1 + 70.0), own, "krl")
    return PathSamples.of(program, RobotInCell.of(model, own), source)


def moved(own, place):
    return replace(own, base=Frame(X=place[0], Y=place[1], Z=place[2], A=place[3]))


def jacobian(q, tool, step=1e-6):
    """Jacobian (6, 6) of the tool frame by differences of Pinocchio's frames."""
    columns = []
    for change in np.eye(6) * step:
        ahead, behind = (frame(q + sign * change, 6) @ tool for sign in (1.0, -1.0))
        rotation = (ahead[:3, :3] @ behind[:3, :3].T - np.eye(3)) / (2.0 * step)
        turning = 0.5 * np.array(
            [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
        )
        columns.append(np.append((ahead - behind)[:3, 3] / (2.0 * step), turning))
    return np.stack(columns, axis=1)


def one_by_one(samples, turn, keep, rows=None):
    """Judge programs where they are: reason, deflection, expected error, margin, least singular value.

    :param rows: samples of each that count; None: all, and A4 and A6 are counted on from the start.
    """
    margin, driven = np.inf, []
    for n, path in enumerate(samples):
        single = SampleBySample(path, turn_map.branch_of_start(path), np.full(len(path), turn))
        model, reasons = path.robot_in_cell.robot, []
        angle = previous = path.robot_in_cell.cell.start_joints
        for i in range(len(path)):
            angle = angle + np.nan_to_num((single.q[i] - previous + np.pi) % (2 * np.pi) - np.pi)
            previous = single.q[i]
            if rows is not None and i not in rows[n]:
                continue
            joint, wrist, elbow, shoulder = single.margins(i)
            jump = np.abs(single.change(i)).max() if np.isfinite(path.time[i]) else 0.0
            winds = any(not model.lower[k] + keep.joint <= angle[k] <= model.upper[k] - keep.joint for k in (3, 5))
            if np.isnan(joint):
                reasons.append(drive.REACH)
            elif joint < keep.joint or (rows is None and winds):
                reasons.append(drive.LIMIT)
            elif min(wrist - keep.wrist, elbow - keep.elbow, shoulder - keep.shoulder) < 0.0 or jump > keep.jump:
                reasons.append(drive.SINGULAR)
            elif single.speed(i) > keep.speed:
                reasons.append(drive.SPEED)
            margin = margin if np.isnan(joint) else min(margin, joint)
            driven.append((single, i))
        if reasons:
            return min(reasons), None, None, None, None
    errors = []
    for single in dict.fromkeys(single for single, _ in driven):
        errors += single.errors_of([i for one, i in driven if one is single and single.is_cut(i)])
    singular = min(np.linalg.svd(jacobian(single.q[i], single.tool(i)))[1][-1] for single, i in driven)
    return drive.FREE, max(e for _, e in errors), max(e for e, _ in errors), margin, singular


def compare(judged, expected):
    reason, deflection, u95, margin, singular = expected
    assert drive.REASONS[judged.reason] == drive.REASONS[reason]
    if reason == drive.FREE:
        assert judged.deflection == pytest.approx(deflection, rel=1e-6)
        assert judged.u95 == pytest.approx(u95, rel=1e-6)
        assert judged.margin == pytest.approx(margin, abs=1e-8)
        assert judged.singular == pytest.approx(singular, rel=1e-5)


def places(seed, count):
    rng = np.random.default_rng(seed)
    return np.stack(
        [rng.uniform(*span, count) for span in ((900, 2200), (-500, 500), (400, 900), (-40, 40), (-300, 300))], axis=1
    ).round(3)


@pytest.mark.parametrize(
    ("keep", "rows", "refused"),
    [
        (KEEP, slice(3, 9), {drive.FREE, drive.SPEED, drive.LIMIT}),
        (replace(KEEP, jump=0.022, speed=9.0), slice(2, 5), {drive.FREE, drive.SINGULAR}),
    ],
)
def test_a_place_is_judged_by_every_sample_as_the_programs_are_read_there(keep, rows, refused):
    """Two G-code programs, one of them too fast at some places, with other turns of the tool."""
    judged = Programs([gcode(STATED), gcode(STATED, 30000)], keep)
    reasons = set()
    for place, turn in zip(places(1, 12)[rows], np.linspace(-1.2, 0.4, 12)[rows], strict=True):
        place[4] = 0.0
        result = judged._judge(place, turn, judged.branch, judged.full_stations)
        there = moved(STATED, place)
        compare(result, one_by_one([gcode(there), gcode(there, 30000)], turn, keep))
        assert (result.place, result.turn, result.branch) == (tuple(place), turn, judged.branch)
        reasons.add(result.reason)
    assert reasons >= refused


def test_a_place_of_e1_is_that_of_a_program_with_other_numbers_of_e1():
    judged = Programs([krl(CARRIED)], KEEP)
    reasons = set()
    for place in places(3, 5):
        place[4] *= 9.0
        result = judged.judge(place, all_samples=True)
        compare(result, one_by_one([krl(moved(CARRIED, place), place[4])], 0.0, KEEP))
        reasons.add(result.reason)
    assert drive.FREE in reasons
    assert len(reasons) > 1


def test_errors_of_forces_and_of_a_soft_tool_turn_with_the_part(tmp_path):
    """Standard deviations along the axes of $BASE, and springs along those of the tool."""
    (tmp_path / "in.csv").write_text(
        "line,Fx,Fy,Fz,frame,sFx,sFy,sFz\n6,90,-150,130,BASE,90,5,20\n7,90,-50,80,BASE,3,70,20\n"
    )
    source = forces.read(tmp_path / "in.csv")
    soft = replace(CARRIED, tool_compliance=replace(CARRIED.tool_compliance, X_um_per_N=0.4, Y_um_per_N=0.1))
    judged = Programs([krl(soft, source=source)], KEEP)
    bounds = []
    for place in places(3, 3)[[0, 2]]:
        result = judged.judge(place, all_samples=True)
        compare(result, one_by_one([krl(moved(soft, place), place[4], source)], 0.0, KEEP))
        bounds.append(result.u95)
    assert min(bounds) < 0.95 * max(bounds)


def station_rows(samples, count):
    """Samples evenly along the path, and the outermost ones, by counting."""
    position = [samples.sample.pose[i][:3, 3] for i in range(len(samples))]
    usable = [i for i in range(len(samples)) if np.isnan(samples.program.motions.joints[samples.sample.motion[i], 0])]
    count = min(count, len(usable))
    rows = {usable[k * (len(usable) - 1) // (count - 1)] for k in range(count)}
    for axis in range(3):
        rows |= {min(usable, key=lambda i: position[i][axis]), max(usable, key=lambda i: position[i][axis])}
    return sorted(rows)


def test_a_place_is_judged_by_stations_of_programs_in_proportion_to_their_length():
    """120 stations of all programs together, 24 of each at least; speeds and steps are those from the sample before."""
    long = GCODE + "G1 X20 F2000\nG1 X180\n" * 12
    program, model = read_with_robot(long.format(2000), STATED)
    paths = [gcode(STATED), PathSamples.of(program, RobotInCell.of(model, STATED), None)]
    judged = Programs(paths, KEEP)
    rows = [station_rows(path, max(24, 120 * len(path) // sum(map(len, paths)))) for path in paths]
    assert [group.row.tolist() for group in judged.station_choice] == rows
    assert len(rows[1]) < len(paths[1])
    for place in places(4, 1):
        compare(judged.judge(np.append(place[:4], 0.0)), one_by_one(at(place, long), 0.0, KEEP, rows))


def at(place, *texts):
    """Samples of the short program and of others at a place."""
    there = moved(STATED, place)
    found = [gcode(there)]
    for text in texts:
        program, model = read_with_robot(text.format(2000), there)
        found.append(PathSamples.of(program, RobotInCell.of(model, there), None))
    return found


@pytest.mark.parametrize(("start", "reason"), [(200.0, drive.LIMIT), (-160.0, drive.FREE)])
@pytest.mark.parametrize("axis", [3, 5])
def test_a4_and_a6_of_a_whole_program_are_counted_from_the_start(axis, start, reason):
    """170° further the limit of 350° is passed: from 200°, but not from -160°, which is the same pose."""
    judged = Programs([gcode(STATED)], LeastMargins())
    low, high = (np.radians(np.full(2, angle)) for angle in (-350.0, 350.0))
    angles = np.radians(start + np.linspace(10.0, 170.0, 17))
    q = np.zeros((6, 17))
    q[axis] = (angles + np.pi) % (2 * np.pi) - np.pi
    begin = np.zeros(6)
    begin[axis] = np.radians(start)
    judged.robot_in_cell = replace_start(judged.robot_in_cell, begin)
    found = judged._winds_past_limits(q)
    expected = (angles < low[0] + LeastMargins().joint) | (angles > high[0] - LeastMargins().joint)
    np.testing.assert_array_equal(found, expected)
    assert found.any() == (reason == drive.LIMIT)


def replace_start(robot_in_cell, joints):
    return RobotInCell.of(robot_in_cell.robot, replace(robot_in_cell.cell, start=Start(tuple(np.degrees(joints)))))


STATUS = KRL.replace("E1 {0}}}\n;F", "E1 {0},S {2}}}\n;F").replace("$TOOL={{X 350,Y 0,Z 240,A 0,B 0,C 0}}\n", "")


@pytest.mark.parametrize("status", [2, 6])
def test_a_program_that_states_its_status_is_judged_on_that_branch(status):
    program, model = read_with_robot(STATUS.format(0.0, 70.0, status), CARRIED, "krl")
    assert program.motions.status.max() == status
    judged = Programs([PathSamples.of(program, RobotInCell.of(model, CARRIED), None)], BARE_MARGINS)
    result = correction.process(program, model, CARRIED, mode="predict")
    assert not result.failed
    found = judged.judge(np.array([1500.0, 0.0, 700.0, 0.0, 0.0]), all_samples=True)
    form = kinematics.closed_form(model)
    assert {int(k) for k in form.branch_of(result.q)} == {int(judged.full_stations[0].branch[0])}
    assert found.margin == pytest.approx(result.joint_margin.min(), abs=2e-3)


class Touching:
    """Bodies of one program: poses alone touch, or the path between them, or neither."""

    def __init__(self, at_poses=False, between=None):
        self.at_poses, self.between, self.calls = at_poses, between, []

    def is_closer(self, q, rows, shift, base_motion):
        self.calls.append((q, rows, shift, base_motion))
        return self.at_poses

    def is_hit_along_path(self, q, rows, breaks, shift, base_motion):
        self.calls.append((q, rows, shift, base_motion))
        assert not breaks.any()
        hit = np.zeros(len(q), dtype=bool)
        hit[[] if self.between is None or self.between >= len(q) else self.between] = True
        return hit


PLACE = np.array([1450.0, 60.0, 720.0, 10.0, 40.0])


@pytest.mark.parametrize(
    ("at_poses", "between", "all_samples", "reason"),
    [
        (True, None, False, drive.COLLISION), (False, 3, False, drive.FREE), (False, 3, True, drive.COLLISION),
        (False, None, True, drive.FREE), (False, 1, False, drive.FIRST_MOVE), (False, 1, True, drive.FIRST_MOVE),
    ],
)  # fmt: skip
def test_bodies_are_compared_at_poses_and_along_a_whole_program_from_the_start(at_poses, between, all_samples, reason):
    """Their path begins at [start] with E1 as at the first sample; the part is moved by what separates the places."""
    away, back = (f"LIN {{{{X {x},Y 0,Z 0,A 180,B 0,C 180,E1 {{1}}}}}}\n" for x in (300, 0))
    long = KRL.replace("END", (away + back) * 5 + "END")
    program, model = read_with_robot(long.format(0.0, 70.0), CARRIED, "krl")
    samples = PathSamples.of(program, RobotInCell.of(model, CARRIED), None)
    judged = Programs([samples], BARE_MARGINS)
    judged.bodies = [Touching(at_poses, between)]
    result = judged.judge(PLACE, all_samples=all_samples)
    assert result.reason == reason
    there = krl_at(PLACE, long)
    single = SampleBySample(there, judged.branch, np.zeros(len(there)))
    motion, t = there.sample.motion, there.sample.t
    moving = moved(CARRIED, PLACE).base.pose() @ np.linalg.inv(CARRIED.base.pose())
    for (q, rows, shift, base_motion), is_path in zip(judged.bodies[0].calls, (False, True), strict=False):
        expected_rows = judged.full_stations[0].row if all_samples else judged.station_choice[0].row
        e1 = there.program.carriage.at(motion[expected_rows], t[expected_rows])
        expected_q = single.q[expected_rows]
        if is_path:
            count = len(expected_rows) if all_samples else 1  # of stations only the first move is a path
            expected_rows = np.append(expected_rows[0], expected_rows[:count])
            e1 = np.append(e1[0], e1[:count])
            expected_q = np.concatenate([CARRIED_START[None], expected_q[:count]])
        np.testing.assert_array_equal(rows, expected_rows)
        np.testing.assert_allclose(q, expected_q, atol=1e-9)
        np.testing.assert_allclose(shift, e1[:, None] * [0.0, 1.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(base_motion, moving, atol=1e-12)
    assert len(judged.bodies[0].calls) == (1 if at_poses else 2)


CARRIED_START = np.radians(CARRIED.start.joints)


def krl_at(place, text):
    there = moved(CARRIED, place)
    program, model = read_with_robot(text.format(place[4], place[4] + 70.0), there, "krl")
    return PathSamples.of(program, RobotInCell.of(model, there), None)


@pytest.mark.parametrize("seed", range(40))
def test_the_turn_of_the_cell_stays_unless_another_saves_two_percent_and_the_best_of_others_counts(seed, monkeypatch):
    """Of turns that cannot be driven, the first one with the reason that is checked last."""
    rng = np.random.default_rng(seed)
    judged = Programs([gcode(STATED)], KEEP, turns=True)
    np.testing.assert_allclose(np.degrees(judged.turns), np.arange(-180, 180, 30), atol=1e-9)
    judgements = {}
    for turn in judged.turns.tolist():
        reason = drive.FREE if rng.random() < (0.0 if seed % 4 == 0 else 0.7) else int(rng.integers(1, 6))
        margin = np.nan if reason == drive.REACH else rng.uniform(0.1, 1.0)
        error = 1e-4 * (1.0 + (0.03 if seed % 2 else 0.3) * rng.random())
        judgements[turn] = JudgedPlace((0.0,) * 5, reason, error, error, margin, turn=turn)
    monkeypatch.setattr(judged, "_judge", lambda place, turn, branch, stations: judgements[turn])
    found = judged.judge(np.zeros(5))
    free = [each for each in judgements.values() if each.reason == drive.FREE]
    if not free:
        last_reason = max(each.reason for each in judgements.values())
        assert found == next(each for each in judgements.values() if each.reason == last_reason)
        return
    best = free[0]
    for each in free[1:]:
        alike = abs(each.u95 - best.u95) <= 0.01 * min(each.u95, best.u95)
        best = each if (each.margin > best.margin if alike else each.u95 < best.u95) else best
    stays = judgements[0.0].reason == drive.FREE and judgements[0.0].u95 <= 1.02 * best.u95
    assert found == (judgements[0.0] if stays else best)


def test_a_program_without_cuts_has_no_error_and_its_singular_value():
    text = "G21 G90\nG0 X0 Y-100 Z60\nG0 X100\n"
    program, model = read_with_robot(text, STATED)
    samples = PathSamples.of(program, RobotInCell.of(model, STATED), None)
    place = np.array([1500.0, 0.0, 700.0, 0.0, 0.0])
    found = Programs([samples], BARE_MARGINS)._judge(
        place, -0.8, 2, [Programs([samples], BARE_MARGINS).full_stations[0]]
    )
    assert (found.reason, found.deflection, found.u95) == (drive.FREE, 0.0, 0.0)
    single = SampleBySample(samples, 2, np.full(len(samples), -0.8))
    values = [np.linalg.svd(jacobian(single.q[i], single.tool(i)))[1][-1] for i in range(len(samples))]
    assert found.singular == pytest.approx(min(values), rel=1e-5)


@pytest.mark.parametrize("order", [0, 1])
def test_a_place_without_equilibrium_of_one_program_is_refused_as_singular(monkeypatch, order):
    judged = Programs([gcode(STATED), gcode(STATED)], BARE_MARGINS)
    place, calls = np.array([1500.0, 0.0, 700.0, 0.0, 0.0]), []
    free = judged._judge(place, -0.8, judged.branch, judged.full_stations)
    assert free.reason == drive.FREE
    original = drive.errors

    def errors(*parts):
        u95, deflection = original(*parts)
        deflection[-1] = np.nan if len(calls) == order else deflection[-1]
        calls.append(order)
        return u95, deflection

    monkeypatch.setattr(drive, "errors", errors)
    found = judged._judge(place, -0.8, judged.branch, judged.full_stations)
    assert (found.reason, found.margin) == (drive.SINGULAR, free.margin)
    assert np.isnan(found.u95)


def test_a_status_that_todays_place_does_not_reach_leaves_the_branch_of_the_start():
    there = moved(CARRIED, [5000.0, 0.0, 700.0, 0.0])
    program, model = read_with_robot(STATUS.format(0.0, 70.0, 6), there, "krl")
    judged = Programs([PathSamples.of(program, RobotInCell.of(model, there), None)], BARE_MARGINS)
    assert (judged.full_stations[0].branch == -1).all()
    assert (judged.full_stations[0].shift[:, 1] <= 0.07).all()
    found = judged.judge(np.array([1500.0, 0.0, 700.0, 0.0, 0.0]), all_samples=True)
    assert found.branch == judged.branch == int(kinematics.closed_form(model).branch_of(CARRIED_START[None])[0])


def test_stations_know_the_sample_before_them_and_how_far_e1_carries_the_robot():
    samples = krl(CARRIED)
    (group,) = Programs([samples], BARE_MARGINS).full_stations
    motion, t = samples.sample.motion, samples.sample.t
    assert group.row.tolist() == list(range(len(samples)))
    assert group.before.tolist() == [max(i - 1, 0) for i in range(len(samples))]
    carriage = samples.program.carriage
    e1 = [
        carriage.begin[motion[i]] + t[i] * (carriage.end - carriage.begin)[motion[i]]
        for i in [*group.before, *group.row]
    ]
    np.testing.assert_allclose(group.shift, np.outer(e1, [0.0, 1.0, 0.0]), atol=1e-12)
    assert group.is_at_feed.tolist() == [not samples.program.motions.rapid[k] for k in motion]


@pytest.mark.parametrize("change", [0.9e-6, 1.1e-6])
@pytest.mark.parametrize("moves_with_cell", [None, True, False])
def test_programs_in_a_base_of_their_own_would_not_move_with_the_cell(change, moves_with_cell):
    program, model = read_with_robot(GCODE.format(2000), STATED)
    base = STATED.base.pose()
    own = base.copy()
    own[1, 3] += change
    program = replace(
        program, bases=np.stack([base, own]), motions=replace(program.motions, base=np.array([0, 0, 0, 1, 1]))
    )
    shifted = None
    if moves_with_cell is not None:
        bases = program.bases.copy()
        bases[:, 0, 3] += 0.1
        if not moves_with_cell:
            bases[1] = own
        shifted = replace(program, bases=bases)
    robot_in_cell = RobotInCell.of(model, STATED)
    if change < 1e-6 and moves_with_cell is not False:
        region.check_base(program, robot_in_cell, shifted)
        return
    if moves_with_cell is True:
        with pytest.raises(InputError, match="line 6: "):
            region.check_base(program, robot_in_cell, shifted)
        return
    with pytest.raises(InputError, match="line 6: the motions are in a"):
        region.check_base(program, robot_in_cell, shifted)
