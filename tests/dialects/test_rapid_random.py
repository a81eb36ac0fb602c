"""Random programs as RAPID: a grammar of its own finds every target, frame, speed, zone, stop and line in its place."""

from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from msgspec.structs import replace as changed
from scipy.spatial.transform import Rotation

from postproc.cell import GCode
from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.rapid.language import abb_from_joints
from postproc.errors import ProgramError
from postproc.frames import pose_from_xyzabc
from postproc.program import CIRC, LIN, PTP, Document, Event, TargetJoints, Targets
from tests import programs
from tests.dialects.krl_programs import CELL, forward
from tests.dialects.rapid_grammar import frame, parse

LINES = {
    "spindle_on": ["SetAO aoSpindle,{S};", "SetDO doSpindle,1;"],
    "spindle_off": ["SetDO doSpindle,0;"],
    "coolant_on": ["SetDO doCoolant,1;"],
    "coolant_off": ["SetDO doCoolant,0;"],
    "tool_change": ["! tool {T}", "Stop;"],
}
MILLING = changed(CELL, gcode=GCode(rapid_m_per_s=0.25, **LINES))
KINDS = {LIN: "MoveL", CIRC: "MoveC", PTP: "MoveJ"}
_place = st.integers(-9_000_000, 9_000_000).map(lambda n: n / 10_000)
_frames = st.lists(
    st.tuples(*[_place] * 3, *[st.integers(-1799, 1800).map(lambda n: n / 10)] * 3), min_size=1, max_size=3
)


@st.composite
def programs_and_targets(draw):
    """A program with events and frames, targets with any orientation, and joint angles."""
    n = draw(st.integers(1, 12))
    kind = np.array(draw(st.lists(st.sampled_from([LIN, LIN, LIN, CIRC, PTP]), min_size=n, max_size=n)))
    pose = np.tile(np.eye(4), (n, 1, 1))
    pose[:, :3, :3] = Rotation.random(n, random_state=draw(st.integers(0, 2**31))).as_matrix()
    pose[:, :3, 3] = np.array(draw(st.lists(st.tuples(*[_place] * 3), min_size=n, max_size=n))) / 1e3
    bases, tools = (pose_from_xyzabc(np.array(draw(_frames), dtype=float)) for _ in range(2))
    base, tool = (
        np.array(draw(st.lists(st.integers(0, len(of) - 1), min_size=n, max_size=n))) for of in (bases, tools)
    )
    made = programs.program([("LIN", 0, 0, 0)] * n, bases=bases, tools=tools, base=base)
    feed = np.array(draw(st.lists(st.sampled_from([0.005, 0.02, 0.0333333, 0.5]), min_size=n, max_size=n)))
    events = draw(
        st.lists(st.tuples(st.integers(0, n), st.sampled_from([*LINES, "dwell", "stop", "comment"])), max_size=6)
    )
    events = tuple(Event(at, what, 1, 1.5, "words") for at, what in sorted(events, key=lambda event: event[0]))
    motions = replace(made.motions, tool=tool, feed=np.where(kind == PTP, np.nan, feed), kind=kind)
    blend = np.array(draw(st.lists(st.sampled_from([0.0, 0.0002, 0.005]), min_size=n, max_size=n)))
    via = np.where((kind == CIRC)[:, None], pose[:, :3, 3] + [0.01, 0.02, 0.03], np.nan)
    none = np.full(n, -1)
    targets = Targets(np.arange(n), np.ones(n), kind, pose, via, np.zeros(n, bool), none, none, blend)
    q = np.radians(np.array(draw(st.lists(st.tuples(*[st.integers(-179, 179)] * 6), min_size=n, max_size=n))) + 0.5)
    status = np.array(draw(st.lists(st.integers(0, 7), min_size=n, max_size=n)))
    program = replace(made, motions=motions, events=events, documents=(Document("part.nc", ""),))
    return program, targets, TargetJoints(q, status)


@settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
@given(programs_and_targets())
def test_a_random_program_is_written_target_by_target(made):
    program, targets, joints = made
    written = RAPID.writer.write(program, targets, joints, MILLING, None)
    text = written.documents[0].text
    data, code = parse(text)
    moves = [one for one in code if one[1] in KINDS.values()]
    assert [line for line, *_ in moves] == written.output_line.tolist()
    m = program.motions
    angles = abb_from_joints(joints.q)
    for k, (_, name, arguments, work_object) in enumerate(moves):
        *points, speed, zone, tool = arguments
        assert name == KINDS[int(targets.kind[k])]
        assert len(points) == (2 if name == "MoveC" else 1)
        position, orientation, conf, _ = points[-1]
        np.testing.assert_allclose(position, targets.pose[k, :3, 3] * 1e3, atol=5.01e-5)
        np.testing.assert_allclose(frame([position, orientation])[:3, :3], targets.pose[k, :3, :3], atol=3e-8)
        assert conf[:3] == [np.floor(angles[k, axis] / 90) for axis in (0, 3, 5)]
        np.testing.assert_allclose(frame(data[tool][1][1]), _mm(program.tools[m.tool[k]]), atol=1e-5)
        np.testing.assert_allclose(frame(data[work_object][1][3]), _mm(program.bases[m.base[k]]), atol=1e-5)
        if name == "MoveC":
            np.testing.assert_allclose(points[0][0], targets.via[k] * 1e3, atol=5.01e-5)
        wanted = 250.0 if name == "MoveJ" else m.feed[k] * 1e3
        assert abs(data[speed][1][0] - wanted) < 6e-4
        if zone != "fine":
            assert abs(data[zone][1][1] - targets.blend[k] * 1e3) < 1e-6
        assert (zone == "fine") == _stops(program, targets, k)
    _check_order(program, code, text)


def _mm(pose):
    out = pose.copy()
    out[:3, 3] *= 1e3
    return out


def _stops(program, targets, k):
    """Whether the robot must stand still at a target: no zone, the end, other frames, a PTP or something behind it."""
    m, last = program.motions, k + 1 == len(targets)
    events = [event for event in program.events if event.before == k + 1 and event.kind != "comment"]
    if targets.blend[k] == 0.0 or last or events:
        return True
    return bool(m.base[k] != m.base[k + 1] or m.tool[k] != m.tool[k + 1] or targets.kind[k + 1] == PTP)


def _check_order(program, code, text):
    """Lines of the cell, dwells and stops stand between the moves that they stood between."""
    begin = next(at for at, one in enumerate(code) if one[1] == "MoveAbsJ") + 1
    moves, found = 0, []
    for _, name, arguments, _ in code[begin:-2]:
        if name in KINDS.values():
            moves += 1
        else:
            found.append((moves, name, arguments[-1] if arguments else None))
    expected = []
    for event in program.events:
        for line in LINES.get(event.kind, {"dwell": ["WaitTime 1.5;"], "stop": ["Stop;"]}.get(event.kind, [])):
            line = line.replace("{S}", "1.5")
            if not line.startswith("!"):
                name, _, arguments = line.rstrip(";").partition(" ")
                expected.append((event.before, name, float(arguments.split(",")[-1]) if arguments else None))
    assert found == expected
    assert text.count("! words") == sum(event.kind == "comment" for event in program.events)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(programs_and_targets())
def test_a_random_program_is_read_back_as_it_was_meant(made):
    """The controller's single precision is the largest error: 6e-5 mm at 1 m, 6e-8 of a quaternion."""
    program, targets, joints = made
    document = RAPID.writer.write(program, targets, joints, MILLING, None).documents[0]
    try:
        back = RAPID.read([document], MILLING, forward, "part")
    except ProgramError as refused:
        assume("three points of the circle" not in str(refused))  # which these circles may have on a line
        raise
    m = back.motions
    rows = np.flatnonzero(np.isnan(m.joints[:, 0]))
    assert m.kind[rows].tolist() == targets.kind.tolist()
    np.testing.assert_allclose(m.target[rows, :3, 3], targets.pose[:, :3, 3], atol=1.2e-7)
    np.testing.assert_allclose(m.target[rows, :3, :3], targets.pose[:, :3, :3], atol=4e-7)
    given = program.motions
    np.testing.assert_allclose(back.bases[m.base[rows]], program.bases[given.base], atol=4e-7)
    np.testing.assert_allclose(back.tools[m.tool[rows]], program.tools[given.tool], atol=4e-7)
    np.testing.assert_allclose(m.feed[rows], given.feed, rtol=1e-4)
    free = targets.kind == PTP
    assert (m.status[rows][free] == joints.status[free]).all()
    assert m.joints[0].tolist() != [np.nan] * 6
    np.testing.assert_allclose(m.joints[0], np.radians(MILLING.start.joints), atol=1e-6)
