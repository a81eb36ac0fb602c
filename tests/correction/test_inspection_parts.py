"""Places between samples and motions that are slowed, against loops; what a program states of its origin and frames."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import cell as cells
from postproc.correction import checks, inspection
from postproc.correction.inspection import Slowing, Stretches
from postproc.poses import Poses
from postproc.program import CIRC, LIN, Event
from tests.collision.setting import frame
from tests.correction.test_closely import CELL_WITH_START, arcs_and_lines
from tests.kr270 import ROBOT

PATH = arcs_and_lines()


def shifted_path():
    """Joint angles and positions (N, …) of a correction that changes from sample to sample."""
    rng = np.random.default_rng(7)
    q = PATH.joints.q + np.radians(0.05) * rng.normal(size=PATH.joints.q.shape)
    return q, PATH.sample.pose[:, :3, 3] + 1e-4 * rng.normal(size=(len(PATH), 3))


def interpolated(values, motion, t):
    """Value at a place of a motion, linear between the samples next to it; before the first one that of its end."""
    places = PATH.sample.motion + PATH.sample.t
    place = motion + t
    after = min(int(np.searchsorted(places, place)), len(places) - 1)
    before = max(after - 1, 0)
    if place >= places[-1] or place <= places[0]:
        return values[after if place >= places[-1] else 0]
    share = (place - places[before]) / (places[after] - places[before])
    return values[before] + share * (values[after] - values[before])


@pytest.mark.parametrize("chunk", [8192, 7, 1])
def test_places_between_samples_have_the_pose_of_the_path_and_the_correction_between_samples(monkeypatch, chunk):
    """The arm by Pinocchio; whole turns are those of the samples."""
    monkeypatch.setattr(inspection, "SAMPLES_AT_ONCE", chunk)
    stretches = Stretches(
        np.array([1, 2, 4, 6, 8]),
        np.array([0.0, 0.3, 0.0, 0.0, 0.5]),
        np.array([1.0, 0.6, 1.0, 0.5, 1.0]),
        np.array([5, 3, 4, 3, 2]),
    )
    q, position = shifted_path()
    shift = np.array([0, 0, 0, 2 * np.pi, 0, -2 * np.pi])
    turned = replace(PATH, joints=replace(PATH.joints, q=PATH.joints.q + shift))
    expected = [
        (motion, begin + (end - begin) * k / parts)
        for motion, begin, end, parts in zip(
            stretches.motion, stretches.begin, stretches.end, stretches.parts, strict=True
        )
        for k in range(parts + 1)
    ]
    places, joints, positions, poses = [], [], [], []
    for close, exact, commanded in inspection.dense_places(turned, q + shift, position, stretches):
        places += list(zip(close.motion.tolist(), close.t.tolist(), strict=True))
        joints += list(exact)
        positions += list(commanded)
        poses += [close.pose[n] for n in range(len(close))]
    np.testing.assert_allclose(np.array(places), np.array(expected), atol=1e-12)
    program = PATH.program
    nominal = PATH.sample.pose[:, :3, 3]
    for (motion, t), angles, commanded, pose in zip(expected, joints, positions, poses, strict=True):
        by_correction = interpolated(q - PATH.joints.q, motion, t)
        base, tool = program.bases[program.motions.base[motion]], program.tools[program.motions.tool[motion]]
        np.testing.assert_allclose(frame(angles - by_correction, 6) @ tool, base @ pose, atol=1e-9)
        np.testing.assert_allclose(commanded, pose[:3, 3] + interpolated(position - nominal, motion, t), atol=1e-12)
        near = interpolated(PATH.joints.q, motion, t) + shift
        assert np.abs(angles - by_correction - near).max() < np.pi


def slowed_by_loop(path, q, position, before, fast_lines, *, cap):
    """Feeds and joints of slowed motions: the largest share of a joint speed at samples, and between."""
    m, robot = path.program.motions, path.robot_in_cell.robot
    limit = 0.98 * 0.95 ** (before.count if before else 0)
    speed = inspection.commanded_speed(path, q, position)
    entries = [(int(motion), row) for motion, row in zip(path.sample.motion, speed, strict=True)]
    _, lines = inspection.stretches_to_examine(path, q, speed)
    for close, exact, exact_position in inspection.dense_places(path, q, position, lines):
        speeds = checks.joint_speed(path.program, close, path.motions.segments.turn, exact, exact_position)
        entries += [(int(motion), row) for motion, row in zip(close.motion, speeds, strict=True)]
    feed, joint = m.feed.copy(), np.full(len(m), -1) if before is None else before.joint.copy()
    forced = {int(k) for n, k in enumerate(path.sample.motion) if path.wrench[n].any()}
    is_fast = [k not in forced and m.feed[k] >= CELL_WITH_START.gcode.rapid_m_per_s for k in range(len(m))]
    is_free = [m.rapid[k] or k in path.program.unforced or is_fast[k] for k in range(len(m))]
    positioning = [m.kind[k] == LIN and is_free[k] for k in range(len(m))]
    is_capped = [cap and m.kind[k] in (LIN, CIRC) and not m.rapid[k] and not positioning[k] for k in range(len(m))]
    slowable = [is_capped[k] or positioning[k] for k in range(len(m))]
    shares = {}
    for k in range(len(m)):
        rows = [row / robot.speed for motion, row in entries if motion == k] if slowable[k] else []
        worst = max(rows, key=lambda row: row.max(), default=np.zeros(6))
        if worst.max() > limit:
            shares[k] = worst
    on_line = any(slowable[k] and m.line[k] in fast_lines for k in range(len(m)))
    for k, worst in shares.items():
        again = before is not None and on_line and (before.joint[k] >= 0 or m.line[k] in fast_lines)
        if worst.max() > 1.0 or again:
            feed[k] *= limit / worst.max()
            joint[k] = int(worst.argmax())
    return feed, joint, is_capped


def rapid_path(scale, *, cap):
    """The path with some moves as rapid ones, at feeds that drive joints to about their largest speed."""
    m = PATH.program.motions
    rapid = m.rapid.copy()
    rapid[[2, 5, 8]] = True
    feed = m.feed * np.where(rapid, 60.0, 25.0) * scale
    unforced = np.array([3])
    program = replace(PATH.program, motions=replace(m, rapid=rapid, feed=feed), notes=(), unforced=unforced)
    limits = replace(CELL_WITH_START.limits, feed="cap" if cap else "refuse")
    place = replace(PATH.robot_in_cell, cell=replace(CELL_WITH_START, limits=limits))
    return replace(PATH, motions=replace(PATH.motions, program=program, robot_in_cell=place))


@pytest.mark.parametrize("cap", [False, True])
@pytest.mark.parametrize("times", [0, 1, 3])
@pytest.mark.parametrize("scale", [0.3, 1.0, 2.0])
def test_motions_are_slowed_to_a_share_of_the_joint_speeds_that_falls_each_time(cap, times, scale):
    path = rapid_path(scale, cap=cap)
    q, position = path.joints.q, path.sample.pose[:, :3, 3]
    m = path.program.motions
    before = None
    if times:
        joint = np.full(len(m), -1)
        joint[2] = 3
        joint[0] = 4  # is not slowed again, and stays named
        before = Slowing(joint, np.zeros(len(m), dtype=bool), times)
    for fast_lines in ((), (int(m.line[5]),), (int(m.line[7]), int(m.line[8]))):
        feed, joint, is_capped = slowed_by_loop(path, q, position, before, fast_lines, cap=cap)
        found = inspection.slow_fast_motions(path, q, position, before, fast_lines)
        if np.array_equal(feed, m.feed, equal_nan=True):
            assert found is None
            continue
        motions, slowing = found
        np.testing.assert_allclose(motions.program.motions.feed, feed, rtol=1e-9)
        assert slowing.joint.tolist() == joint.tolist()
        assert slowing.is_capped.tolist() == is_capped
        assert slowing.count == times + 1
        is_lowered = feed < m.feed
        as_read = motions.program.feed_as_read
        assert (as_read is not None) == any(is_capped[k] for k in np.flatnonzero(is_lowered))
        assert as_read is None or np.array_equal(as_read, m.feed, equal_nan=True)


def test_a_remark_on_slowed_motions_names_joints_and_the_slowest_feed():
    m = PATH.program.motions
    feed = np.full(len(m), 0.5)
    feed[[2, 5, 6]] = 0.1234, 0.0321, 0.2
    motions = replace(m, feed=feed)
    joint = np.full(len(m), -1)
    joint[[2, 5]] = 3, 0
    issue = Slowing(joint, np.zeros(len(m), dtype=bool), 1).issue(motions)
    assert (issue.level, issue.kind) == ("info", "rapid-slowed")
    assert (
        issue.message
        == "Positioning moves in which A1 and A4 would turn too fast are slowed, to 0.0321 m/s at the slowest."
    )
    assert set(issue.lines) == {int(m.line[2]), int(m.line[5])}
    capped = np.zeros(len(m), dtype=bool)
    capped[[2, 6]] = True
    issue = Slowing(joint, capped, 1).issue(motions)
    assert (issue.level, issue.kind) == ("warning", "feed-capped")
    assert (
        issue.message
        == "Moves at feed in which A1 and A4 would turn too fast are slowed, to 7404 mm/min at the lowest."
    )


ORIGIN = SimpleNamespace(part_of="", mode="", state="none", version="0.1.0", line=3)


CORRECTED, NOMINAL = {"mode": "corrected", "state": "intact"}, {"mode": "nominal", "state": "intact"}
PART = {"part_of": "whole.src"}
IS_PART = ("error", "part-of-program", "this file is a part of whole.src", 3)
IS_COMMANDS = ("error", "corrected-before", "this program was corrected by postproc 0.1.0 before", 3)
IS_CHANGED = ("warning", "changed-since", "this program was changed since postproc 0.1.0 wrote it.", 3)
CALLS_COMMANDS = ("error", "corrected-before", "sub.src, which this program calls, was corrected by postproc 9", None)


@pytest.mark.parametrize(
    ("mode", "main", "called", "expected"),
    [
        ("convert", {}, None, None), ("convert", PART, None, IS_PART), ("predict", PART, None, IS_PART),
        ("convert", CORRECTED, None, IS_COMMANDS), ("nominal", CORRECTED | {"state": "changed"}, None, IS_COMMANDS),
        ("predict", CORRECTED, None, None), ("predict", CORRECTED | {"state": "changed"}, None, IS_CHANGED),
        ("convert", NOMINAL, None, None), ("convert", NOMINAL | {"state": "changed"}, None, IS_CHANGED),
        ("convert", {}, CORRECTED | {"version": "9"}, CALLS_COMMANDS), ("convert", {}, NOMINAL, None),
        ("predict", {}, CORRECTED, None), ("convert", CORRECTED, CORRECTED, IS_COMMANDS),
    ],
)  # fmt: skip
def test_a_program_that_was_corrected_is_not_corrected_again(monkeypatch, mode, main, called, expected):
    documents = [SimpleNamespace(name="main.src")] + [SimpleNamespace(name="sub.src")] * (called is not None)
    origins = {"main.src": main, "sub.src": called}

    def origin(files):
        return SimpleNamespace(**(vars(ORIGIN) | origins[files[0].name]))

    writer = SimpleNamespace(writer=SimpleNamespace(origin=origin))
    monkeypatch.setattr(inspection.registry, "dialect_of_name", lambda dialect: writer)
    issues = inspection.origin_issues(SimpleNamespace(dialect="krl", documents=documents), mode)
    assert len(issues) == (expected is not None)
    for issue in issues:
        level, kind, words, line = expected
        assert (issue.level, issue.kind, issue.source_line) == (level, kind, line)
        assert words in issue.message


def test_a_program_of_a_dialect_that_is_not_written_has_no_origin(monkeypatch):
    monkeypatch.setattr(inspection.registry, "dialect_of_name", lambda dialect: SimpleNamespace(writer=None))
    assert inspection.origin_issues(SimpleNamespace(dialect="gcode", documents=()), "convert") == []


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize(("change", "is_another"), [(0.9e-6, False), (1.1e-6, True)])
def test_frames_that_are_not_those_of_the_cell_are_noted_with_their_numbers(axis, change, is_another):
    """By a micrometre, or a microradian."""
    program = replace(
        PATH.program,
        dialect="krl",
        bases=CELL_WITH_START.base.pose()[None].copy(),
        tools=CELL_WITH_START.tool.pose()[None].copy(),
    )
    motions = replace(program.motions, base=0 * program.motions.base, tool=0 * program.motions.tool)
    assert inspection.frame_issues(replace(program, motions=motions, bases=np.eye(4)[None]), CELL_WITH_START) == []
    program = replace(program, motions=motions, layout=SimpleNamespace())
    assert inspection.frame_issues(program, CELL_WITH_START) == []
    for name, section, frames in (("$BASE", "base", "bases"), ("$TOOL", "tool", "tools")):
        other = getattr(program, frames).copy()
        if axis < 3:
            other[0, axis, 3] += change
        else:
            small = np.zeros(3)
            small[axis - 3] = change
            other[0, :3, :3] = other[0, :3, :3] @ (np.eye(3) + np.cross(np.eye(3), small))
        issues = inspection.frame_issues(replace(program, **{frames: other}), CELL_WITH_START)
        assert len(issues) == is_another
        for issue in issues:
            assert (issue.level, issue.kind) == ("info", f"own-{section}")
            assert issue.message.startswith(f"{name} is {{X ")
            assert f"[{section}] of the cell" in issue.message
            assert set(issue.lines) == set(program.motions.line.tolist())


@pytest.mark.parametrize(
    ("frames", "shift", "text"),
    [
        (["base"], 0.1, "1 obstacle of [collision] stands in [base] of the cell"),
        (["base", "root", "base"], 0.1, "2 obstacles of [collision] stand in [base] of the cell"),
        (["base"], 0.9e-6, ""), (["root"], 0.1, ""), ([], 0.1, ""), (None, 0.1, ""),
    ],
)  # fmt: skip
def test_obstacles_in_the_base_of_the_cell_are_asked_about_where_the_program_has_another(frames, shift, text):
    box = cells.Box(X=(0.0, 10.0), Y=(0.0, 10.0), Z=(0.0, 10.0))
    collision = None
    if frames is not None:
        collision = cells.Collision(obstacles=[cells.ObstacleTable(box=box, frame=frame) for frame in frames])
    cell = replace(CELL_WITH_START, collision=collision)
    bases = CELL_WITH_START.base.pose()[None].copy()
    bases[0, 1, 3] += shift
    program = replace(PATH.program, dialect="krl", bases=bases)
    program = replace(program, motions=replace(program.motions, base=0 * program.motions.base))
    assert inspection.obstacle_issues(program, cell) == []  # converted G-code is placed in [base]
    issues = inspection.obstacle_issues(replace(program, layout=SimpleNamespace()), cell)
    assert [(issue.level, issue.kind, issue.message[: len(text)]) for issue in issues] == (
        [("warning", "obstacles-elsewhere", text)] if text else []
    )


@pytest.mark.parametrize("seed", range(40))
def test_pieces_of_lines_are_examined_where_a_state_may_reach_its_limit_between_two_samples(monkeypatch, seed):
    """Each of nine states alone comes near to its bound: by its step, the way and the turn of the piece."""
    rng = np.random.default_rng(seed)
    rows = [
        n for n in range(len(PATH)) if PATH.program.motions.kind[PATH.sample.motion[n]] == LIN
    ]  # fmt: skip
    segments = PATH.motions.segments
    begin = [
        0.0 if n == 0 or PATH.sample.motion[n - 1] != PATH.sample.motion[n] else PATH.sample.t[n - 1]
        for n in range(len(PATH))
    ]
    part = [PATH.sample.t[n] - begin[n] for n in range(len(PATH))]
    way = [segments.travel[PATH.sample.motion[n]] * part[n] for n in range(len(PATH))]
    turn = [segments.turn[PATH.sample.motion[n]] * part[n] for n in range(len(PATH))]
    rows = [n for n in rows if way[n] > 0.002 or turn[n] > np.radians(0.5)]
    step = rng.uniform(0.0, 0.02, (9, len(rows)))
    limits = np.array([
        [*(2.0 * step[k, i] + way[n] / 0.15 + 6.0 * turn[n] for k in range(7)),
         2.0 * step[7, i] + way[n] + 0.5 * turn[n] + checks.SHOULDER_RADIUS, 5.0 * way[n] + 3.0 * turn[n]]
        for i, n in enumerate(rows)
    ]).T  # fmt: skip
    rooms = limits * 1.001
    near = rng.random(len(rows)) < 0.5
    for i in np.flatnonzero(near):
        rooms[rng.integers(9), i] *= 0.999 / 1.001
    before, after = (np.where(rng.random(rooms.shape) < 0.5, rooms, rooms + 1.0) for _ in range(2))
    before = np.where((before > rooms) & (after > rooms), rooms, before)
    fast = rng.random(len(PATH)) < 0.1
    calls = []

    def states(path, q, chunk):
        calls.append(chunk.tolist())
        return before, after, step

    monkeypatch.setattr(inspection, "_margins_and_steps", states)
    found = inspection._line_stretches(PATH, None, fast)
    assert calls == [rows]
    expected = [n for i, n in enumerate(rows) if near[i] or fast[n]]
    assert found.motion.tolist() == [PATH.sample.motion[n] for n in expected]
    np.testing.assert_allclose(found.begin, [begin[n] for n in expected])
    np.testing.assert_allclose(found.end, [PATH.sample.t[n] for n in expected])
    parts = [int(np.ceil(max(way[n] / 0.002, turn[n] / np.radians(0.5)) - 1e-9)) for n in expected]
    assert found.parts.tolist() == parts


def test_arcs_of_whole_steps_of_five_degrees_have_as_many_parts():
    """Their sweeps in radians are rounded up or down."""
    degrees = np.array([*np.arange(5.0, 361.0, 5.0), 0.1, 4.9, 5.1, 7.5, 359.9])
    parts = [*range(1, 73), 1, 1, 2, 2, 72]
    motions = SimpleNamespace(kind=np.full(len(degrees), CIRC), sweep=np.radians(degrees))
    count = np.arange(len(degrees))
    path = SimpleNamespace(
        program=SimpleNamespace(motions=motions),
        sample=SimpleNamespace(motion=count),
        robot_in_cell=SimpleNamespace(robot=ROBOT, cell=SimpleNamespace(start_joints=np.zeros(6))),
    )
    found = inspection._arc_stretches(path, np.zeros((len(degrees), 6)), np.ones(len(degrees), dtype=bool))
    assert (found.motion.tolist(), found.parts.tolist()) == (count.tolist(), parts)


@pytest.mark.parametrize("seed", range(40))
def test_arcs_are_examined_where_a_state_may_reach_its_limit_by_twice_their_largest_step(monkeypatch, seed):
    rng = np.random.default_rng(seed)
    motion = PATH.sample.motion
    rows = [n for n in range(len(PATH)) if PATH.program.motions.kind[motion[n]] == CIRC]
    arcs = sorted({int(motion[n]) for n in rows})
    step = rng.uniform(0.0, 0.1, (9, len(rows)))
    step[:6, rng.random(len(rows)) < 0.02] = np.radians(10.1)
    room = np.full((9, len(rows)), 9.0)
    near = {arc: rng.random() < 0.5 for arc in arcs}
    for arc in arcs:
        own = [i for i, n in enumerate(rows) if motion[n] == arc]
        largest = 2.0 * step[:, own].max(axis=1)
        limit = [*largest[:6], max(largest[6], np.radians(1.0)), largest[7] + checks.SHOULDER_RADIUS, np.radians(20.0)]
        for k in range(9):
            room[k, own[rng.integers(len(own))]] = limit[k] * 1.001
        if near[arc]:
            k = int(rng.integers(9))
            room[k, own[rng.integers(len(own))]] = limit[k] * 0.999
    fast = rng.random(len(PATH)) < 0.02
    monkeypatch.setattr(inspection, "_margins_and_steps", lambda path, q, chunk: (room + 1.0, room, step))
    found = inspection._arc_stretches(PATH, None, fast)
    turns = {int(motion[n]) for i, n in enumerate(rows) if fast[n] or step[:6, i].max() > np.radians(10.0)}
    expected = [arc for arc in arcs if near[arc] or arc in turns]
    assert found.motion.tolist() == expected
    assert found.parts.tolist() == [{1: 36, 4: 18, 6: 108}[arc] for arc in expected]
    assert (found.begin == 0.0).all()
    assert (found.end == 1.0).all()


def test_states_are_distances_of_joints_to_their_limits_and_of_the_arm_to_singular_poses():
    """The first sample follows the start; the wrist ahead of A1 and the angle of A3 by Pinocchio's frames."""
    rng = np.random.default_rng(5)
    robot, start = PATH.robot_in_cell.robot, CELL_WITH_START.start_joints
    q = rng.uniform(0.6 * robot.lower, 0.6 * robot.upper, (len(PATH), 6))
    rows = np.array([0, 3, 7])
    before, after, step = inspection._margins_and_steps(PATH, q, rows)

    def states(angles):
        shoulder, elbow, wrist = (frame(angles, carrier)[:3, 3] for carrier in (1, 2, 4))
        upper, fore = elbow - shoulder, wrist - elbow
        stretched = np.arccos(upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore))
        room = np.minimum(angles - robot.lower, robot.upper - angles)
        return [*room, abs(angles[4]), np.hypot(*wrist[:2]), stretched]

    for n, row in enumerate(rows):
        previous = start if row == 0 else q[row - 1]
        np.testing.assert_allclose(before[:, n], states(previous), atol=1e-6)
        np.testing.assert_allclose(after[:, n], states(q[row]), atol=1e-6)
        np.testing.assert_allclose(step[:7, n], np.abs([*(q[row] - previous), q[row, 4] - previous[4]]), atol=1e-12)


CHECKS = (
    "start_joint_issues", "first_move_issues", "start_height_issues", "half_turn_issues", "posture_issues",
    "status_and_turn_issues", "joint_limit_issues", "singularity_issues", "joint_speed_issues",
    "joint_issues_at_joins", "correction_issues_at_joins", "correction_size_issues",
)  # fmt: skip


@pytest.mark.parametrize("clearance", [None, 45.0])
def test_a_path_has_the_issues_of_all_checks_and_between_samples_those_of_other_kinds(monkeypatch, clearance):
    """Stretches of arcs come first: what they find is not looked for again on lines."""
    calls, between = {}, []
    for name in CHECKS:

        def check(*parts, name=name):
            calls[name] = parts
            yield SimpleNamespace(kind=name)

        monkeypatch.setattr(inspection.checks, name, check)
    arcs, lines = SimpleNamespace(motion=np.array([1, 4])), SimpleNamespace(motion=np.array([2, 5]))
    monkeypatch.setattr(inspection, "stretches_to_examine", lambda path, q, speed: (arcs, lines))

    def between_samples(path, q, position, stretches, sparse):
        between.append((stretches, sparse.tolist()))
        of_arcs = ["joint_limit_issues", "new", "new", "other"]
        yield from (
            SimpleNamespace(kind=kind)
            for kind in (of_arcs if stretches is arcs else ["other", "last", "posture_issues"])
        )

    monkeypatch.setattr(inspection, "issues_between_samples", between_samples)
    q, position = shifted_path()
    pose = PATH.sample.pose[:]
    pose[:, :3, 3] = position
    output = replace(CELL_WITH_START.output, max_correction_mm=7.5)
    cell = replace(CELL_WITH_START, output=output, machine=replace(CELL_WITH_START.machine, clearance_Z=clearance))
    path = replace(PATH, motions=replace(PATH.motions, robot_in_cell=replace(PATH.robot_in_cell, cell=cell)))
    command = SimpleNamespace(q=q, pose=Poses.of(pose))
    issues = inspection.path_issues(path, command)
    assert [issue.kind for issue in issues] == [*CHECKS, "new", "new", "other", "last"]
    assert between == [(arcs, []), (lines, [2, 5])]
    assert calls["start_height_issues"][2] == (None if clearance is None else pytest.approx(0.045))
    np.testing.assert_array_equal(calls["singularity_issues"][4], arcs.motion)
    np.testing.assert_allclose(
        calls["correction_size_issues"][2], np.linalg.norm(position - PATH.sample.pose[:, :3, 3], axis=1), atol=1e-12
    )
    assert calls["correction_size_issues"][3] == pytest.approx(0.0075)
    assert calls["joint_limit_issues"][3] is q
    tips = calls["start_height_issues"][1]
    assert len(tips) == 201
    base = path.program.bases[path.program.motions.base[0]]
    end = PATH.program.motions.target[0][:3, 3]
    start = (
        np.linalg.inv(base) @ frame(CELL_WITH_START.start_joints, 6) @ path.program.tools[path.program.motions.tool[0]]
    )
    np.testing.assert_allclose(tips[-1], end, atol=1e-9)
    np.testing.assert_allclose(tips[0], start[:3, 3], atol=1e-6)


@pytest.mark.parametrize(
    ("numbers", "keeps_text", "change", "expected"),
    [
        ([1, 1, 2], False, None, (1, 2)), ([1, 1, 1], False, None, None), ([1, 1], False, [], None),
        ([1, 2], True, None, None), ([], False, None, None), ([3, 5, 4], False, None, (3, 5)),
    ],
)  # fmt: skip
def test_another_tool_needs_lines_for_its_change(numbers, keeps_text, change, expected):
    events = tuple(Event(before=k, kind="tool_change", value=float(n), line=7 + k) for k, n in enumerate(numbers))
    other = Event(before=0, kind="coolant_on", value=9.0, line=1)
    made = replace(PATH.program, events=(other, *events), layout=SimpleNamespace() if keeps_text else None)
    cell = replace(CELL_WITH_START, gcode=replace(CELL_WITH_START.gcode, tool_change=change))
    issues = inspection.tool_change_issues(made, cell)
    assert len(issues) == (expected is not None)
    if expected:
        row = next(k for k, n in enumerate(numbers) if n != numbers[0])
        assert (issues[0].level, issues[0].kind, issues[0].source_line) == ("error", "tool-change", 7 + row)
        assert f"changes from tool {expected[0]} to tool {expected[1]}, but" in issues[0].message


@pytest.mark.parametrize(
    ("tools", "expected"), [({}, [("warning", 8)]), ({"1": cells.Frame(Z=1), "2": cells.Frame(Z=2)}, [])]
)
def test_several_tools_need_lengths_of_their_own(tools, expected):
    events = tuple(Event(before=k, kind="tool_change", value=1.0 + k, line=7 + k) for k in range(2))
    gcode = replace(CELL_WITH_START.gcode, tool_change=[])
    issues = inspection.tool_change_issues(
        replace(PATH.program, events=events, layout=None), replace(CELL_WITH_START, gcode=gcode, tools=tools)
    )
    assert [(issue.level, issue.source_line) for issue in issues] == expected
