"""Corners and approximation distances of targets, row by row; which targets stay; numbers and words of results."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.correction import targets
from postproc.correction.process import _causes_at_rest, _memory_warning, _refine
from postproc.correction.result import Result
from postproc.correction.targets import Corners
from postproc.errors import Issue
from postproc.poses import Poses
from postproc.program import CIRC, LIN, PTP, SPL, Targets
from postproc.under_load import SHARE_OF_TOLERANCE
from tests.kr270 import CELL, ROBOT
from tests.programs import program


def random_targets(rng, made, count=14):
    """Targets of the motions of a program, some of which have several."""
    motion = np.sort(np.append(np.arange(len(made.motions)), rng.integers(0, len(made.motions), count)))
    ends = np.append(np.diff(motion) != 0, True)
    t = np.where(ends, 1.0, 0.0)
    for k in range(len(motion)):
        if not ends[k]:
            t[k] = 0.1 * (k - np.flatnonzero(motion == motion[k])[0] + 1) / 20.0
    kind = made.motions.kind[motion].copy()
    pose = np.tile(np.eye(4), (len(motion), 1, 1))
    pose[:, :3, 3] = np.cumsum(rng.normal(0.0, 0.01, (len(motion), 3)), axis=0)
    stays = np.flatnonzero((rng.random(len(motion) - 1) < 0.2) & (kind[1:] != CIRC)) + 1
    pose[stays, :3, 3] = pose[stays - 1, :3, 3]
    via = np.full((len(motion), 3), np.nan)
    arcs = np.flatnonzero(kind == CIRC)
    via[arcs] = pose[arcs, :3, 3] + rng.normal(0.0, 0.01, (len(arcs), 3))
    none = np.full(len(motion), -1)
    return Targets(
        motion, t, kind, Poses.of(pose), via, np.zeros(len(motion), bool), none, none, made.motions.blend[motion]
    )


def random_program(rng, count=8):
    moves = [("LIN", *rng.uniform(-50, 50, 3)) for _ in range(count)]
    made = program(moves)
    kind = rng.choice([LIN, LIN, CIRC, PTP, SPL], count)
    base, tool = np.sort(rng.integers(0, 2, count)), np.sort(rng.integers(0, 2, count))
    motions = replace(
        made.motions, kind=kind, base=base, tool=tool, blend=rng.choice([0.0, 5e-4, 2e-3], count),
        rounding=rng.choice([5e-5, 1e-6], count),
    )  # fmt: skip
    after = np.arange(-1, count - 1)
    after[rng.integers(2, count)] = 0
    return replace(made, motions=motions, after=after if rng.random() < 0.5 else None)


def circle(begin, via, end):
    """Unit directions at begin and end of the arc through three points, and its length."""
    a, b = via - begin, end - begin
    normal = np.cross(a, b)
    centre = (
        begin
        + np.cross(normal, a) * (b @ b) / (2 * normal @ normal)
        + np.cross(b, normal) * (a @ a) / (2 * normal @ normal)
    )
    normal /= np.linalg.norm(normal)
    radius = np.linalg.norm(begin - centre)
    x = (begin - centre) / radius
    y = np.cross(normal, x)
    angle = np.arctan2((end - centre) @ y, (end - centre) @ x) % (2 * np.pi)
    leave, arrive = y, np.cos(angle) * y - np.sin(angle) * x
    return leave, arrive, radius * angle


@pytest.mark.parametrize("seed", range(25))
def test_corners_are_turns_between_pieces_that_follow_each_other_in_the_same_frames(seed):
    rng = np.random.default_rng(seed)
    made = random_program(rng)
    rows = random_targets(rng, made)
    start = rng.normal(0.0, 0.01, (len(made.motions), 3))
    corners, arrive = targets.corners_of_targets(made, rows, start)
    m, count = made.motions, len(rows)
    pieces = []
    for k in range(count):
        end = np.round(rows.pose[k][:3, 3], 7)
        is_first = k == 0 or rows.motion[k] != rows.motion[k - 1]
        begin = np.round(start[rows.motion[k]], 7) if is_first else np.round(rows.pose[k - 1][:3, 3], 7)
        if rows.kind[k] == CIRC:
            pieces.append(circle(begin, np.round(rows.via[k], 7), end))
            continue
        length = np.linalg.norm(end - begin)
        direction = (end - begin) / length if length else np.zeros(3)
        pieces.append((direction, direction, length))
    for k in range(count):
        np.testing.assert_allclose(arrive[k], pieces[k][1], atol=1e-9)
        if k == count - 1:
            assert corners.sharpness[k] == corners.reach[k] == 0.0
            continue
        reach = 0.5 * min(pieces[k][2], pieces[k + 1][2])
        assert corners.reach[k] == pytest.approx(reach, abs=1e-12)
        here, there = rows.motion[k], rows.motion[k + 1]
        follows = there - here <= 1 and m.base[here] == m.base[there] and m.tool[here] == m.tool[there]
        follows = follows and (made.after is None or here == there or made.after[there] == here)
        is_path = {int(rows.kind[k]), int(rows.kind[k + 1])} <= {LIN, CIRC}
        sharp = np.linalg.norm(pieces[k + 1][0] - pieces[k][1]) if follows and is_path and reach > 0.0 else 0.0
        assert corners.sharpness[k] == pytest.approx(sharp, abs=1e-9)


@pytest.mark.parametrize("keeps_text", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_approximation_distances_stay_unless_they_round_a_corner_too_much(seed, keeps_text):
    rng = np.random.default_rng(seed)
    made = random_program(rng)
    rows = random_targets(rng, made)
    if keeps_text:
        made = replace(made, layout=SimpleNamespace())
    cell = replace(CELL, gcode=replace(CELL.gcode, approximation_mm=float(rng.choice([0.2, 1.3]))))
    corners = Corners(rng.choice([0.0, 0.01, 0.3, 1.5], len(rows)), 10.0 ** rng.uniform(-5.0, -2.0, len(rows)))
    found = targets.approximation_distances(made, rows, corners, cell)
    for k in range(len(rows)):
        motion = rows.motion[k]
        at_end, sharp, reach = made.motions.blend[motion], corners.sharpness[k], corners.reach[k]
        allowed = 4.0 * 0.2 * cell.tolerance / max(sharp, 1e-9)  # a fifth of the tolerance is passed at d/4·sharp
        if rows.kind[k] == PTP:
            expected = 0.0
        elif rows.t[k] == 1.0:
            expected = at_end if 0.25 * min(at_end, reach) * sharp <= made.motions.rounding[motion] else 0.0
        elif keeps_text:
            expected = np.inf if at_end > 0.0 or reach <= allowed else 0.0
        else:
            expected = max(at_end, cell.gcode.approximation_mm * 1e-3)
            if allowed < min(expected, reach):
                steps = [digit * 10.0**power for power in range(-6, 3) for digit in (1.0, 2.0, 5.0)]
                expected = 1e-3 * max(step for step in steps if step * 1e-3 <= allowed * (1.0 + 1e-9))
        assert found[k] == pytest.approx(expected, rel=1e-9)
    assert (found > 0.0).any()


@pytest.mark.parametrize("keeps_text", [False, True])
def test_a_program_rounds_its_path_at_the_ends_of_its_own_motions(monkeypatch, keeps_text):
    """In G-code nothing is rounded by the program; inserted targets are passed exactly."""
    made = program([("LIN", 10 * k, 0, 0) for k in range(4)])
    made = replace(made, layout=SimpleNamespace() if keeps_text else None)
    motion = np.array([0, 0, 1, 3, 3, 3])
    asked = []

    def corners(made, path, motions):
        asked.append(motions.tolist())
        return Corners(np.full(3, 0.8), np.array([1e-3, 1e-4, 1e-3]))

    monkeypatch.setattr(targets, "corners_of_motions", corners)
    found = targets.programmed_rounding(made, None, motion)
    expected = 0.25 * 0.8 * np.array([0.0, 5e-4, 1e-4, 0.0, 0.0, 5e-4]) if keeps_text else np.zeros(6)
    np.testing.assert_allclose(found, expected)
    assert asked == ([[0, 1, 3]] if keeps_text else [])


@pytest.mark.parametrize("exponent", range(-2, 4))
@pytest.mark.parametrize("digit", [2, 5])
def test_distances_are_rounded_down_to_one_two_or_five_but_for_the_last_bit(digit, exponent):
    """A distance that is one of these up to the rounding of its computation stays; the next one is far below."""
    smaller = {2: 1.0, 5: 2.0}[digit]
    value, unit = digit * 10.0**exponent * 1e-3, 10.0**exponent * 1e-3
    distance = value * np.array([1.0 - 2e-16, 1.0, 1.0 + 2e-16, 1.3, 0.999])
    expected = np.array([value, value, value, value, smaller * unit])
    np.testing.assert_allclose(targets._round_down(distance), expected, rtol=1e-12)


def draft_of(modules=None, size=3.0e6, divide=False, memory=2.0):
    cell = replace(CELL, output=replace(CELL.output, program_memory_MB=memory, divide_into_modules=divide))
    return SimpleNamespace(size=size, modules=modules), cell


def test_a_program_is_too_large_for_the_memory_of_its_controller_in_one_piece():
    for size, memory, count in ((2.0e6, 2.0, 0), (2.1e6, 2.0, 1), (2.1e6, 2.2, 0)):
        assert len(_memory_warning(*draft_of(size=size, memory=memory))) == count
    (issue,) = _memory_warning(*draft_of())
    assert (issue.level, issue.kind) == ("warning", "program-memory")
    assert issue.message.startswith("the program has 3 MB, 1.5 times program_memory_MB = 2 of [output]")
    assert "or set divide_into_modules = true in [output]" in issue.message
    (divided,) = _memory_warning(*draft_of(divide=True))
    assert "or convert G-code or APT to KRL: divide_into_modules divides no other programs." in divided.message
    assert _memory_warning(*draft_of(modules=("a", "b"))) == ()


@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("mass", [0.0, 5.0])
def test_causes_of_deviation_at_rest_are_those_that_act(rigid, mass):
    robot = SimpleNamespace(geometry_is_nominal=rigid, has_weight=not rigid, subtract_reference=bool(mass))
    cell = replace(CELL, payload=replace(CELL.payload, mass_kg=mass))
    expected = ["the payload"] * bool(mass)
    expected += [] if rigid else ["the calibrated geometry"]
    expected += ["the weight of the arm"] if not rigid and not mass else []
    assert list(_causes_at_rest(robot, cell)) == expected


@pytest.mark.parametrize("linearize_arcs", [False, True])
def test_pieces_of_arcs_are_divided_by_the_root_of_what_they_miss_and_lines_get_a_target(linearize_arcs):
    kind = np.array([LIN, CIRC, LIN])
    calls = []

    def refined_at(motion, t, parts):
        calls.append((motion.tolist(), t.tolist(), parts.tolist()))
        return "refined"

    tolerance = 2e-5
    path = SimpleNamespace(
        program=SimpleNamespace(motions=SimpleNamespace(kind=kind)), arcs=SimpleNamespace(refined_at=refined_at),
        robot_in_cell=SimpleNamespace(tolerance=tolerance),
    )  # fmt: skip
    motion, t = np.array([0, 1, 1, 1, 1, 2]), np.array([0.1, 0.2, 0.4, 0.5, 0.6, 0.9])
    limit = SHARE_OF_TOLERANCE * tolerance
    distance = limit * np.array([3.0, 1.0, 4.1, 8.9, 100.0, 5.0])
    task = SimpleNamespace(linearize_arcs=linearize_arcs)
    pieces, (motions, places) = _refine(task, path, (motion, t, distance), (np.array([2]), np.array([0.3])))
    assert pieces == "refined"
    arcs = [] if linearize_arcs else [1, 2, 3, 4]
    lines = [n for n in range(6) if n not in arcs]
    parts = [min(max(int(np.ceil(np.sqrt(distance[n] / limit) - 1e-12)), 2), 4) for n in arcs]
    assert calls == [([1] * len(arcs), [t[n] for n in arcs], parts)]
    assert motions.tolist() == [2, *motion[lines]]
    assert places.tolist() == [0.3, *t[lines]]


def result_of(mode, bound=True, errors=0):
    made = program([("RAPID", 0, 0, 0), ("LIN", 10, 0, 0), ("LIN", 20, 0, 0)])
    issues = tuple(Issue("error", f"kind-{k}", "wrong") for k in range(errors))
    deviation = np.array([[9.0, 0, 0], [3.0, 4.0, 0], [0, 0, 1.0]]) * 1e-4
    return Result(
        program=made, robot=ROBOT, axis="+Z", mode=mode, written_dialect="krl",
        issues=(*issues, Issue("info", "x", "y")),
        motion=np.arange(3), t=np.ones(3), cut_length=np.array([0.0, 0.01, 0.03]),
        deviation_before=deviation, deviation_after=0.01 * deviation,
        bound=np.array([9e-4, 2e-4, 3e-4]) if bound else None,
    )  # fmt: skip


def test_a_result_is_summed_up_in_words_and_as_a_table():
    rms = np.sqrt((25.0 + 3 * 1.0) / 4) * 0.1
    figures = f"before 0.5 mm (RMS {rms:.2g}), after 0.005 mm (RMS {0.01 * rms:.2g})"
    whole = f"<Result of part on {ROBOT.name}: targets 3, {figures}"
    assert repr(result_of("convert")) == f"{whole}, on the part (95 %) 0.3 mm>"
    assert repr(result_of("convert", bound=False)) == f"{whole}>"
    predicted = repr(result_of("predict", errors=2))
    assert "targets 3, errors 2, before 0.5 mm" in predicted
    assert "after" not in predicted
    table = result_of("convert")._repr_html_()
    assert table.startswith(f"<table><caption>part on {ROBOT.title}</caption><tr><th>targets</th><td>3</td></tr>")
    assert "<tr><th>on the part (95 %)</th><td>0.3 mm</td></tr></table>" in table
    named = replace(result_of("convert"), robot=replace(ROBOT, title=""))
    assert f"<caption>part on {ROBOT.name}</caption>" in named._repr_html_()
