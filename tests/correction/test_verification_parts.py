"""Parts of the verification of a written program, each against a loop: where it is looked at, and what is an error."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.correction import verify
from postproc.correction.verify import _Probes
from postproc.errors import Issue, ProgramError
from postproc.poses import Poses
from postproc.program import CIRC, LIN
from tests.programs import program

TOLERANCE = 2e-5


def targets_of(motion, t):
    """Targets of motions at places; a piece begins at the target before on its motion."""

    def begin(rows):
        return np.array([0.0 if row == 0 or motion[row] != motion[row - 1] else t[row - 1] for row in rows])

    return SimpleNamespace(motion=motion, t=t, begin=begin)


@pytest.mark.parametrize("rest_is_nominal", [False, True])
def test_places_behind_steps_at_jumps_and_without_a_correction_before_them_are_known(rest_is_nominal):
    """Motion 0 begins at the start and motion 2 at an axis target, which are not corrected."""
    made = program([("LIN", 10, 0, 0), ("PTP", 0, 0, 0), ("LIN", 20, 0, 0), ("LIN", 30, 0, 0)])
    joints = np.full((4, 6), np.nan)
    joints[1] = 0.1
    made = replace(made, motions=replace(made.motions, joints=joints))
    motion, t = np.array([0, 0, 2, 2, 3, 3, 3]), np.array([0.5, 1.0, 0.4, 1.0, 0.5, 0.5 + 2e-6, 1.0])
    length = np.array([0.01, 0.2, 0.3, 0.1])
    begins = np.array([True, False, False, True])

    def is_behind_step(row, end):
        return begins[row] & (end < 0.6)

    path = SimpleNamespace(
        program=made,
        motions=SimpleNamespace(
            forces=SimpleNamespace(is_behind_step=is_behind_step), segments=SimpleNamespace(length=length)
        ),
        robot_in_cell=SimpleNamespace(rest_is_nominal=rest_is_nominal),
    )
    target = np.repeat(np.arange(7), 2)
    share = np.tile([0.5, 1.0], 7)
    probes = _Probes(target, share, motion[target], np.zeros(14))
    step, jump, is_judged = verify._conditions_of_probes(path, targets_of(motion, t), probes)
    for n in range(14):
        row, is_inner = target[n], share[n] < 1.0
        end = t[row]
        begin = 0.0 if row == 0 or motion[row] != motion[row - 1] else t[row - 1]
        is_step = is_inner and begins[motion[row]] and end < 0.6
        unsettled = is_inner and motion[row] in (0, 2) and not rest_is_nominal
        assert step[n] == is_step
        assert jump[n] == (is_inner and length[motion[row]] * (end - begin) < 1e-6)
        assert is_judged[n] == (not is_step and not unsettled)
    assert jump.sum() == 1


LEFT = {
    "force-step": ("warning", "the force changes abruptly from the end of the move before"),
    "force-jump": ("error", "the force jumps within this move"),
    "target": ("error", "the simulated program misses a target by"),
    "path": ("error", "the simulated program leaves its path between targets by"),
}


@pytest.mark.parametrize("seed", range(12))
def test_errors_that_are_left_are_named_with_the_largest_of_their_kind(seed):
    rng = np.random.default_rng(seed)
    count = 12
    made = program([("LIN", 10 * k, 0, 0) for k in range(4)])
    distance = rng.choice([9e-7, 1.1e-6, 1.9e-5, 2.1e-5, 5e-5], count, p=[0.3, 0.2, 0.2, 0.15, 0.15])
    share = rng.choice([0.5, 1.0], count)
    probes = _Probes(np.arange(count), share, rng.integers(0, 4, count), np.zeros(count))
    step, jump, smooth = rng.random((3, count)) < 0.4
    path = SimpleNamespace(program=made, robot_in_cell=SimpleNamespace(tolerance=TOLERANCE))
    is_wide = [value > TOLERANCE for value in distance]
    cases = {
        "force-step": [n for n in range(count) if step[n] and is_wide[n]],
        "force-jump": [n for n in range(count) if jump[n] and is_wide[n]],
        "target": [n for n in range(count) if share[n] == 1.0 and distance[n] > 1e-6],
        "path": [n for n in range(count) if smooth[n] and is_wide[n]],
    }
    issues = list(verify._tolerance_issues(path, probes, distance, step=step, jump=jump, smooth=smooth))
    expected = [(name, rows) for name, rows in cases.items() if rows]
    assert len(issues) == len(expected)
    for issue, (name, rows) in zip(issues, expected, strict=True):
        level, words = LEFT[name]
        assert (issue.level, issue.message[: len(words)]) == (level, words)
        assert issue.kind == ("tolerance" if name in ("target", "path") else name)
        assert f"{1e3 * max(distance[n] for n in rows):.4f} mm" in issue.message
        assert set(issue.lines or (issue.source_line,)) == {int(probes.motion[n]) + 1 for n in rows}
        assert name not in ("force-jump", "path") or "(allowed 0.02 mm)" in issue.message


@pytest.mark.parametrize("seed", range(6))
def test_arcs_are_uneven_by_their_displacement_at_the_quarters(monkeypatch, seed):
    """Against the displacement of the end of each piece; the larger one of both quarters."""
    rng = np.random.default_rng(seed)
    nominal, written = rng.normal(size=(2, 3, 3))

    def positions(made, segments, motion, t):
        """Curves of two programs: polynomials of the place."""
        powers = np.stack([t, t**2, t**3], axis=-1)
        return powers @ (nominal if made == "nominal" else written) + motion[:, None]

    monkeypatch.setattr(verify.toolpath, "positions", positions)
    motion, t = np.array([0, 1, 1, 2]), np.array([1.0, 0.4, 1.0, 1.0])
    path = SimpleNamespace(program="nominal", motions=SimpleNamespace(segments=None))
    readback = SimpleNamespace(program="written", segments=None, row=np.array([5, 6, 7, 9]))
    rows, correction = np.array([1, 2, 3]), rng.normal(size=(3, 3))
    found = verify._unevenness(path, SimpleNamespace(targets=targets_of(motion, t)), readback, rows, correction)
    for n, row in enumerate(rows):
        begin = 0.4 if row == 2 else 0.0
        sizes = []
        for share in (0.25, 0.75):
            place = np.array([begin + share * (t[row] - begin)])
            there = positions("written", None, readback.row[[row]], np.array([share]))
            displaced = there - positions("nominal", None, motion[[row]], place) - correction[n]
            sizes.append(float(np.linalg.norm(displaced)))
        assert found[n] == pytest.approx(max(sizes))


@pytest.mark.parametrize("seed", range(12))
def test_a_written_program_is_looked_at_between_targets_where_it_may_leave_its_path(monkeypatch, seed):
    """Long or turning runs every 5 mm or so, arcs and changes of the force at the middle, steep corrections closer."""
    rng = np.random.default_rng(seed)
    motion = np.array([0, 0, 1, 1, 1, 2, 3, 4])
    t = np.array([0.4, 1.0, 0.25, 0.5, 1.0, 1.0, 1.0, 1.0])
    kind = np.array([LIN, CIRC, LIN, LIN, CIRC])
    output_kind = np.where(rng.random(8) < 0.3, CIRC, LIN)
    row_in_output = np.arange(8) + 2
    shift = np.cumsum(rng.choice([0.0, 1.5e-4, 3e-4], 8))
    rows = np.sort(rng.choice(14, 8, replace=False))
    nominal = rng.normal(size=(14, 3))
    pose = np.tile(np.eye(4), (8, 1, 1))
    pose[:, :3, 3] = nominal[rows] + shift[:, None] * [1.0, 0.0, 0.0]
    sample_pose = np.tile(np.eye(4), (14, 1, 1))
    sample_pose[:, :3, 3] = nominal
    unevenness = rng.choice([0.1, 0.3], 8) * TOLERANCE
    lengths, turns = rng.uniform(0.0, 0.03, 10), rng.uniform(0.0, 0.05, 10)
    monkeypatch.setattr(verify, "_unevenness", lambda path, selection, readback, arcs, correction: unevenness[arcs])
    calls = []

    def number_of_places(kinds, length, turn, *, is_curved, is_steep):
        calls.append((kinds.tolist(), length.tolist(), turn.tolist(), is_curved.tolist(), is_steep.tolist()))
        return 1 + is_curved + 2 * is_steep

    monkeypatch.setattr(verify, "number_of_places", number_of_places)
    targets = targets_of(motion, t)
    targets.pose = Poses.of(pose)
    Sized = type("Sized", (SimpleNamespace,), {"__len__": lambda self: len(motion)})
    targets = Sized(**vars(targets))
    output_motions = SimpleNamespace(kind=np.append([LIN, LIN], output_kind))
    path = SimpleNamespace(
        program=SimpleNamespace(motions=SimpleNamespace(kind=kind)),
        sample=SimpleNamespace(pose=Poses.of(sample_pose)),
        robot_in_cell=SimpleNamespace(tolerance=TOLERANCE),
    )
    readback = SimpleNamespace(
        program=SimpleNamespace(motions=output_motions), row=row_in_output,
        segments=SimpleNamespace(travel=lengths, turn=turns),
    )  # fmt: skip
    probes = verify._probes(path, SimpleNamespace(targets=targets, row=rows), readback)
    expected = []
    for n in range(8):
        is_arc = kind[motion[n]] == CIRC or output_kind[n] == CIRC
        is_curved = is_arc or rows[n] - (rows[n - 1] if n else -1) > 1
        steep = (n > 0 and abs(shift[n] - shift[n - 1]) > 2e-4) or (is_arc and unevenness[n] > 0.2 * TOLERANCE)
        expected.append((is_curved, steep))
    ((kinds, length, turn, curved, steep),) = calls
    assert kinds == output_kind.tolist()
    assert (length, turn) == (lengths[2:].tolist(), turns[2:].tolist())
    assert list(zip(curved, steep, strict=True)) == expected
    places = []
    for n, (is_curved, is_steep) in enumerate(expected):
        number = 1 + is_curved + 2 * is_steep
        begin = 0.0 if n == 0 or motion[n] != motion[n - 1] else t[n - 1]
        places += [(n, k / number, begin + k / number * (t[n] - begin)) for k in range(1, number + 1)]
    assert probes.target.tolist() == [n for n, _, _ in places]
    np.testing.assert_allclose(probes.share, [share for _, share, _ in places])
    np.testing.assert_allclose(probes.t, [place for _, _, place in places])
    assert probes.motion.tolist() == motion[probes.target].tolist()
    assert probes.is_inside.tolist() == [share < 1.0 for _, share, _ in places]


def simulated(monkeypatch, seed, *, is_corrected, keeps_text, near_limit=False):
    """The simulation of ten targets from distances at places between and at them."""
    rng = np.random.default_rng(seed)
    target = np.repeat(np.arange(10), 3)
    share = np.tile([0.4, 0.7, 1.0], 10)
    motion = target // 2
    distance = rng.choice([1e-7, 1.5e-5, 1.7e-5, 3e-5], 30, p=[0.4, 0.2, 0.2, 0.2])
    step, jump, is_judged = rng.random((3, 30)) < [[0.2], [0.2], [0.8]]
    probes = _Probes(target, share, motion, 0.1 * target + share)
    made = program([("LIN", 10 * k, 0, 0) for k in range(6)])
    made = replace(made, layout=SimpleNamespace() if keeps_text else None)
    rounding, programmed = rng.uniform(0.0, 6e-5, (2, 10))
    corners = SimpleNamespace(rounding=lambda blend: rounding + 0.0 * blend)
    deviation = rng.normal(size=(10, 3))
    marks = []

    def left(path, places, far, *, step, jump, smooth):
        marks.append((step.tolist(), jump.tolist(), smooth.tolist()))
        yield "left"

    def blending(program, motions, extra, tolerance):
        marks.append((motions.tolist(), extra.tolist(), tolerance))
        yield "blending"

    for name, function in (
        ("corners_of_motions", lambda made, segments, row: corners), ("_probes", lambda *parts: probes),
        ("_deviation", lambda *parts: (deviation, distance, near_limit)), ("_tolerance_issues", left),
        ("_conditions_of_probes", lambda *parts: (step, jump, is_judged)),
        ("_joint_speed_issues", lambda *parts: iter(["fast"])),
    ):  # fmt: skip
        monkeypatch.setattr(verify, name, function)
    monkeypatch.setattr(verify.checks, "blending_issues", blending)
    path = SimpleNamespace(program=made, robot_in_cell=SimpleNamespace(tolerance=TOLERANCE))
    Sized = type("Sized", (SimpleNamespace,), {"__len__": lambda self: 10})
    selection = SimpleNamespace(targets=Sized(motion=np.arange(10) // 2), programmed_rounding=programmed)
    output = SimpleNamespace(motions=SimpleNamespace(blend=np.zeros(12)))
    readback = SimpleNamespace(program=output, segments=None, row=np.arange(2, 12), text="text", numbers="numbers")
    result = verify.simulate(path, selection, None, readback, is_corrected=is_corrected)
    return result, (target, share, motion, distance, step, jump, is_judged, rounding, programmed, marks, probes)


@pytest.mark.parametrize("is_corrected", [True, False])
@pytest.mark.parametrize("keeps_text", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_places_that_use_up_four_fifths_of_the_tolerance_are_missed(monkeypatch, seed, keeps_text, is_corrected):
    """Between targets, where more of them help; not where the force jumps, or where nothing was corrected."""
    result, parts = simulated(monkeypatch, seed, is_corrected=is_corrected, keeps_text=keeps_text)
    target, share, motion, distance, step, jump, is_judged, rounding, programmed, marks, probes = parts
    bad = [n for n in range(30) if is_judged[n] and not jump[n] and share[n] < 1.0 and distance[n] > 0.8 * TOLERANCE]
    assert result.exceedances[0].tolist() == [motion[n] for n in bad]
    np.testing.assert_array_equal(result.exceedances[1], probes.t[bad])
    np.testing.assert_array_equal(result.exceedances[2], distance[bad])
    for k in range(10):
        rows = [n for n in range(30) if target[n] == k and is_judged[n]]
        assert result.path_distance[k] == max((distance[n] for n in rows), default=0.0)
    assert result.largest_path_distance == result.path_distance.max()
    np.testing.assert_array_equal(result.rounding, rounding)
    assert (result.text, result.numbers) == ("text", "numbers")
    if not is_corrected:
        assert result.issues == ()
        return
    assert result.issues == ("left", "blending") if keeps_text else ("left",)
    assert marks[0] == (step.tolist(), (is_judged & jump).tolist(), (is_judged & ~jump).tolist())
    if keeps_text:
        assert marks[1] == ((np.arange(10) // 2).tolist(), (rounding - programmed).tolist(), TOLERANCE)


@pytest.mark.parametrize("near_limit", [True, False])
def test_joint_speeds_of_the_text_are_looked_at_where_one_comes_near_its_limit(monkeypatch, near_limit):
    result, _ = simulated(monkeypatch, 1, is_corrected=True, keeps_text=False, near_limit=near_limit)
    assert result.issues == (("left", "fast") if near_limit else ("left",))


def test_a_joint_that_is_too_fast_at_several_places_is_named_once_with_the_lines_of_both_programs(monkeypatch):
    """At the first of its places, those at samples before those between; the target on its line is that of a motion."""
    nominal, written = (
        program([("LIN", 10 * k, 0, 0) for k in range(3)]),
        program([("LIN", 5 * k, 0, 0) for k in range(6)]),
    )
    written = replace(written, motions=replace(written.motions, line=np.arange(20, 26)))
    nominal = replace(nominal, motions=replace(nominal.motions, line=np.array([7, 8, 11])))
    path = SimpleNamespace(program=nominal, robot_in_cell=SimpleNamespace(robot="robot"))
    selection = SimpleNamespace(targets=SimpleNamespace(motion=np.array([0, 1, 1, 2, 2])))
    readback = SimpleNamespace(program=written, row=np.arange(1, 6))

    def issue(axis, line):
        return Issue("error", f"joint-speed-A{axis}", f"A{axis} on {line}", line, count=2, lines=(line, 99))

    joints = SimpleNamespace(q="q")
    sample = SimpleNamespace(pose=Poses.of(np.zeros((1, 4, 4))))
    segments = SimpleNamespace(turn="turn")
    loaded = SimpleNamespace(sample=sample, joints=joints, motions=SimpleNamespace(segments=segments))
    places = {
        "at samples": [issue(3, 23), issue(5, 25)],
        "first": [issue(3, 22), issue(1, 22)],
        "second": [issue(1, 24)],
    }
    monkeypatch.setattr(
        verify.MotionsUnderLoad, "of", lambda made, place, source: SimpleNamespace(pieces=lambda **_: "")
    )
    monkeypatch.setattr(verify.PathUnderLoad, "of", lambda motions, pieces: loaded)
    monkeypatch.setattr(verify.inspection, "commanded_speed", lambda *_: "at samples")
    monkeypatch.setattr(verify.inspection, "stretches_to_examine", lambda *_: ("arcs", "lines"))
    batches = [("places", "first", "position"), ("places", "second", "position")]
    monkeypatch.setattr(verify.inspection, "dense_places", lambda *parts: batches if parts[3] == "lines" else [])
    monkeypatch.setattr(verify.checks, "joint_speed", lambda made, at, turn, q, position: q if turn == "turn" else None)
    monkeypatch.setattr(verify.checks, "joint_speed_issues", lambda made, robot, at, speed: places[speed])
    found = list(verify._joint_speed_issues(path, selection, readback))
    named = [(entry.kind, entry.message, entry.output_line, entry.source_line, entry.lines) for entry in found]
    assert named == [
        ("joint-speed-A3", "A3 on 23", 23, 8, (8,)), ("joint-speed-A5", "A5 on 25", 25, 11, (11,)),
        ("joint-speed-A1", "A1 on 22", 22, 8, (8,)),
    ]  # fmt: skip


def modules_of(change=None):
    """A program of nine motions in three modules, which begin where the one before ends; one may be changed."""
    rng = np.random.default_rng(5)
    whole = program([("LIN", *rng.uniform(-50.0, 50.0, 3)) for _ in range(9)], bases=np.tile(np.eye(4), (2, 1, 1)))
    motions = replace(
        whole.motions, base=np.array([0] * 5 + [1] * 4), blend=np.where(np.isin(np.arange(9), [0, 2, 5]), 0.0, 5e-4)
    )
    bases = whole.bases.copy()
    bases[1, 0, 3] = 0.3
    whole = replace(whole, motions=motions, bases=bases)
    parts = {}
    for name, rows in (("m1", range(3)), ("m2", range(2, 6)), ("m3", range(5, 9))):
        columns = {field: getattr(motions, field)[np.array(rows)] for field in motions.__struct_fields__}
        part = replace(motions, **columns)
        used = np.unique(part.base)
        made = replace(whole, motions=replace(part, base=np.searchsorted(used, part.base)), bases=bases[used])
        parts[name] = change(made) if change is not None and name == "m2" else made
    documents = [SimpleNamespace(name=name) for name in parts]
    return whole, parts, SimpleNamespace(documents=documents, first=(0, 3, 6))


def other_module(monkeypatch, whole, parts, modules):
    def read(documents, cell, forward, name):
        made = parts[documents[0].name]
        if isinstance(made, Exception):
            raise made
        return made

    monkeypatch.setattr(verify.registry, "dialect_of_name", lambda dialect: SimpleNamespace(read=read))
    monkeypatch.setattr(verify, "led_by_wrist", lambda made, place: made)
    path = SimpleNamespace(robot_in_cell=SimpleNamespace(cell=None, forward=None))
    return verify._first_differing_module(path, whole, np.arange(9), modules, "krl")


def shifted(made, row, distance):
    target = made.motions.target[:]
    target[row, 0, 3] += distance
    return replace(made, motions=replace(made.motions, target=target))


CHANGES = {
    "the same": (lambda made: made, None),
    "a first place that rounding moves": (lambda made: shifted(made, 0, 0.9e-5), None),
    "another first place": (lambda made: shifted(made, 0, 1.1e-5), "m2"),
    "another target": (lambda made: shifted(made, 2, 1e-12), "m2"),
    "another feed": (lambda made: replace(made, motions=replace(made.motions, feed=1.0001 * made.motions.feed)), "m2"),
    "another line": (lambda made: replace(made, motions=replace(made.motions, line=made.motions.line + 7)), None),
    "another base": (lambda made: replace(made, bases=made.bases + 1e-9), "m2"),
    "another tool": (lambda made: replace(made, tools=made.tools + 1e-9), "m2"),
    "a fault": (lambda made: ProgramError("unreadable", file="m2"), "m2"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_modules_move_as_the_program_in_one_piece_from_where_the_one_before_ends(monkeypatch, name):
    change, expected = CHANGES[name]
    assert other_module(monkeypatch, *modules_of(change)) == expected


def test_a_module_ends_at_an_exact_stop(monkeypatch):
    whole, parts, modules = modules_of()
    blend = whole.motions.blend.copy()
    blend[2] = 5e-4
    for made in (whole, *parts.values()):
        rows = made.motions.line - 1
        made.motions.blend[:] = blend[rows]
    assert other_module(monkeypatch, whole, parts, modules) == "m2"
