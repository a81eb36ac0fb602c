"""Parts of the choice of turn and start, each against its formula: margins, prices, closed cells, errors."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import kinematics
from postproc.errors import NotConvergedError
from postproc.placement import drive, turn_map, turning
from postproc.placement.drive import BARE_MARGINS, LeastMargins
from postproc.placement.samples import PathSamples
from postproc.placement.turn_map import BlockedMap, Blocks, Line
from postproc.placement.turning import chosen_start
from postproc.poses import Poses
from postproc.under_load import RobotInCell
from tests.placement.by_sample import SampleBySample
from tests.placement.setting import cell, read_with_robot

TEXT = """G21 G90
(FORCE FX=-110 FY=-190 FZ=130 FRAME=BASE)
G0 X0 Y0 Z60
G1 Z0 F600
G1 X25 F2000
G1 Y90
G0 Z60
G1 X140
"""
AWAY = "G21 G90\nG0 X0 Y-100 Z60\nG1 Z0 F600\nX200 Y250 Z250\n"


def samples_of(text=TEXT, base=(1500.0, 0.0, 700.0), **gcode):
    own = cell(base=base, **gcode)
    program, model = read_with_robot(text, own)
    return PathSamples.of(program, RobotInCell.of(model, own), None)


@pytest.fixture(scope="module")
def path():
    samples = samples_of(redundancy_deg=60.0)
    return samples, Blocks.of(samples), turn_map.branch_of_start(samples)


def test_the_price_of_a_line_has_the_rms_error_of_its_cuts_and_its_least_margin(path):
    samples, blocks, branch = path
    knots = np.random.default_rng(1).uniform(-0.4, 0.4, len(blocks.length))
    error, margin = turning._error_and_margin(samples, blocks, branch, Line(knots, 0.0))
    single = SampleBySample(samples, branch, turning._sample_turns(samples, blocks, knots))
    squares, length = 0.0, 0.0
    travel = samples.segments.length[samples.sample.motion] * np.diff(samples.sample.t, prepend=0.0)
    travel = np.where(travel < 0.0, samples.segments.length[samples.sample.motion] * samples.sample.t, travel)
    for first, end in zip(blocks.first, [*blocks.first[1:], len(samples)], strict=True):
        if single.is_cut(first):
            squares += travel[first:end].sum() * single.errors((first + end - 1) // 2)[0] ** 2
            length += travel[first:end].sum()
    assert error == pytest.approx(np.sqrt(squares / length), rel=1e-6)
    assert margin == pytest.approx(min(single.margins(i)[:3].min() for i in range(len(samples))), abs=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_margins_are_kept_at_which_error_and_price_of_the_margin_are_least(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    degrees = [None, 30.0, 20.0, 12.0, 7.0, 4.0]
    errors, margins = rng.uniform(1e-4, 1.4e-4, 6), np.radians(rng.uniform(1.0, 40.0, 6))
    blocked = rng.random(6) < 0.3
    keeps = [LeastMargins() if level is None else LeastMargins(*[np.radians(level)] * 3) for level in degrees]
    row_of = {(keep.joint, keep.wrist): k for k, keep in enumerate(keeps)}

    def find(samples, whole, keep, mode, *, is_circle):
        assert (mode, is_circle) == ("path", True)
        row = row_of[keep.joint, keep.wrist]
        return BlockedMap(0) if blocked[row] else Line(np.full(1, float(row)), 0.0)

    monkeypatch.setattr(turning, "_cheapest_line", find)
    monkeypatch.setattr(
        turning,
        "_error_and_margin",
        lambda samples, blocks, branch, line: (errors[int(line.knots[0])], margins[int(line.knots[0])]),
    )
    totals = np.where(blocked, np.inf, errors + 5e-5 * np.exp(-np.degrees(margins) / 10.0))
    expected = keeps[int(totals.argmin())] if not blocked.all() else LeastMargins()
    assert turning._margins_of_least_cost(None, SimpleNamespace(blocks=None), 0) == expected


def test_cells_next_to_a_line_with_collisions_are_closed_on_both_sides(path):
    samples, blocks, _ = path
    offset = turn_map.turns_of_circle(np.radians(30.0))
    columns = turn_map._empty_map(blocks, np.zeros(len(samples)), offset, has_bodies=True)
    columns.hit[2, 7] = True
    knots = np.radians(np.linspace(-200.0, 230.0, len(blocks.length)))
    turn = np.degrees(turning._sample_turns(samples, blocks, knots))
    is_hit = np.arange(len(samples)) % 3 == 1
    expected = columns.hit.copy()
    for i in np.flatnonzero(is_hit):
        row = max(k for k in range(len(blocks.first)) if blocks.first[k] <= i)
        for column in range(12):
            gap = (turn[i] - (30.0 * column - 180.0) + 180.0) % 360.0 - 180.0
            expected[row, column] |= abs(gap) < 30.0 - 1e-6
    closed = turning._close_cells(samples, columns, Line(knots, 0.0), is_hit)
    np.testing.assert_array_equal(closed.hit, expected)
    assert columns.hit.sum() == 1


class Away:
    """Bodies that touch at given samples of a path from the start."""

    def __init__(self, *rows):
        self.rows, self.calls = list(rows), []

    def is_hit_along_path(self, q, rows, breaks):
        self.calls.append((q, rows))
        assert not breaks.any()
        return np.isin(np.arange(len(q)), self.rows)


def test_bodies_are_compared_along_every_sample_of_a_line_from_the_start(path):
    samples, blocks, branch = path
    knots = np.linspace(-0.2, 0.3, len(blocks.length))
    bodies = Away(0, 4)
    is_hit = turning._is_hit(samples, blocks, branch, Line(knots, 0.0), bodies)
    assert np.flatnonzero(is_hit).tolist() == [3]
    single = SampleBySample(samples, branch, turning._sample_turns(samples, blocks, knots))
    ((q, rows),) = bodies.calls
    np.testing.assert_allclose(q, [samples.robot_in_cell.cell.start_joints, *single.q], atol=1e-9)
    assert rows.tolist() == [0, *range(len(samples))]


def test_errors_without_equilibrium_are_not_known_and_take_none_from_the_others():
    q = np.arange(36.0).reshape(6, 6)
    tools = np.tile(np.eye(4), (6, 1, 1))
    tools[:, 0, 3] = np.arange(6)
    wrench, pose = np.arange(36.0).reshape(6, 6) * 0.01, np.tile(np.eye(4), (6, 1, 1))
    pose[:, :3, 3] = np.random.default_rng(1).normal(size=(6, 3))
    refused = [{1, 4}, {3}]

    def tip(joints, tool, load):
        rows = (joints[:, 0] / 6).astype(int)
        np.testing.assert_array_equal(load, wrench[rows])
        np.testing.assert_array_equal(tool, tools[rows])
        bad = [n for n, row in enumerate(rows) if refused and row in refused[0]]
        if bad:
            refused.pop(0)
            raise NotConvergedError("too large", rows=bad)
        return joints[:, :3] * 0.1

    found = drive._deflections(SimpleNamespace(tip=tip), q, tools, wrench, pose)
    expected = np.linalg.norm(q[:, :3] * 0.1 - pose[:, :3, 3], axis=1)
    expected[[1, 3, 4]] = np.nan
    np.testing.assert_allclose(found, expected)


def margins_of_branches(samples, turns):
    """Margins (8, J, N) at turns [deg]; −inf where limits or reach end them."""
    result = np.full((8, len(turns), len(samples)), -np.inf)
    for branch in range(8):
        for n, turn in enumerate(turns):
            single = SampleBySample(samples, branch, np.full(len(samples), np.radians(turn)))
            for i in range(len(samples)):
                joint, wrist, elbow, _ = single.margins(i)
                if joint >= 0.0:
                    result[branch, n, i] = min(joint, wrist, elbow)
    return result


@pytest.mark.parametrize(
    ("text", "redundancy", "base"),
    [
        (TEXT, "constant", (1500.0, 0.0, 700.0)),
        (TEXT, "path", (1500.0, 0.0, 700.0)),
        (AWAY, "constant", (1300.0, 200.0, 600.0)),
    ],
)
def test_the_start_is_on_the_branch_whose_worst_sample_has_the_most_margin(text, redundancy, base):
    """The last sample counts as well: the robot reaches farthest there. A free turn is the best one at each sample."""
    samples = samples_of(text, base, redundancy=redundancy, redundancy_deg=60.0)
    found = chosen_start(samples.program, samples.robot_in_cell)
    turns = np.zeros(1) if redundancy == "constant" else np.arange(-180.0, 180.0, 30.0)
    margins = margins_of_branches(samples, turns)
    worst = margins.max(axis=1).min(axis=1)
    starts = np.isfinite(margins[:, :, 0].max(axis=1))
    worst = np.where(starts, worst, -np.inf)
    stated, next_best = np.degrees(np.sort(worst)[::-1][:2])
    branch = int(kinematics.closed_form(samples.robot_in_cell.robot).branch_of(np.radians([found.joints]))[0])
    assert worst[branch] == pytest.approx(worst.max(), abs=1e-6)
    assert f"with the most margin to joint limits and singular poses, {stated:.1f}°" in found.message
    assert (f"(the next best has {next_best:.1f}°)" in found.message) == np.isfinite(next_best)
    turn = turns[int(margins[branch, :, 0].argmax())]
    single = SampleBySample(samples, branch, np.full(len(samples), np.radians(turn)))
    change = np.degrees(single.q[0]) - found.joints
    np.testing.assert_allclose((change + 180.0) % 360.0 - 180.0, np.zeros(6), atol=1e-4)
    angles = ", ".join(f"{angle:.1f}" for angle in found.joints)
    assert f"the program starts at A1…A6 = {angles}, its first target, on the branch" in found.message


REASONS = ("free", "out of reach", "joint limit", "singular pose", "joint speed", "collision")


def map_of_reasons(samples, blocks, reasons):
    """A map (K, 12) whose cells are refused for these reasons."""
    made = turn_map._empty_map(
        blocks, np.zeros(len(samples)), turn_map.turns_of_circle(np.radians(30.0)), has_bodies=True
    )
    margin = drive.Margins(*(np.where(reasons == drive.REACH, np.nan, 1.0) for _ in range(4)))
    margin.joint[reasons == drive.LIMIT] = -1.0
    margin.wrist[reasons == drive.SINGULAR] = 0.0
    return replace(
        made,
        margin=margin,
        speed=np.where(reasons == drive.SPEED, 2.0, 0.0),
        jump=np.zeros(reasons.shape),
        hit=np.asarray(reasons == drive.COLLISION),
    )


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("mode", ["best", "path"])
def test_the_error_without_a_line_names_the_first_bin_that_is_closed_with_its_reasons(path, mode, seed):
    """Of the block that cannot be passed; its last bin if none is closed."""
    samples, blocks, branch = path
    rng = np.random.default_rng(seed)
    reasons = rng.choice(5, (len(blocks.first), 12), p=[0.6, 0.1, 0.1, 0.1, 0.1])
    block = int(rng.integers(len(blocks.length)))
    rows = np.flatnonzero(blocks.block == block)
    if seed % 2:
        reasons[rng.choice(rows, 2)] = rng.integers(1, 5, 12)
    issue = turning._blocked_error(
        samples, map_of_reasons(samples, blocks, reasons), BlockedMap(block), mode, branch, None
    )
    closed = [row for row in rows if reasons[row].all()]
    row = closed[0] if closed else rows[-1]
    counts = [(REASONS[k], 100.0 * np.count_nonzero(reasons[row] == k) / 12) for k in range(1, 6)]
    words = ", ".join(f"{name} at {share:.0f} % of all turns" for name, share in counts if share)
    line = samples.program.motions.line[samples.sample.motion[blocks.first[row]]]
    assert (issue.level, issue.kind, issue.source_line) == ("error", "redundancy", line)
    if closed:
        expected = f"no turn of the tool about its axis can be driven here ({words}). Move the part or [start]."
    elif mode == "best":
        expected = (
            f"no single turn of the tool about its axis can be driven through this operation ({words} here). "
            'Set [gcode] redundancy = "path", or move the part.'
        )
    else:
        expected = (
            "the tool cannot be turned about its axis quickly enough to stay where the robot can drive "
            f"({words} here). Lower the feed, move the part or choose other [start] joints."
        )
    assert issue.message == expected


@pytest.mark.parametrize("mode", ["best", "path"])
def test_an_error_without_a_refused_turn_has_no_reasons(path, mode):
    samples, blocks, branch = path
    free = map_of_reasons(samples, blocks, np.zeros((len(blocks.first), 12)))
    assert "(" not in turning._blocked_error(samples, free, BlockedMap(1), mode, branch, None).message


@pytest.mark.parametrize("limited", [[2, 3], [5, 6, 7, 8, 9, 10, 11], [0, 1, 2, 3, 4, 5]])
def test_the_error_of_collisions_names_the_bodies_at_the_turn_where_they_are_farthest(path, monkeypatch, limited):
    """Of each turn the sample with the smallest distance counts, of these the largest."""
    samples, _, branch = path
    monkeypatch.setattr(turn_map, "BINS_OF_BLOCK", 1)
    blocks = Blocks.of(samples)
    row = int(np.argmax(np.diff([*blocks.first, len(samples)])))
    reasons = np.zeros((len(blocks.first), 12), dtype=int)
    reasons[row] = drive.COLLISION
    reasons[row, limited] = drive.LIMIT
    base = np.random.default_rng(4).uniform(-0.1, 0.1, len(samples))
    whole = replace(map_of_reasons(samples, blocks, reasons), base=base)
    part = range(blocks.first[row], [*blocks.first, len(samples)][row + 1])
    columns = [column for column in range(12) if column not in limited]
    singles = {n: SampleBySample(samples, branch, base + whole.offset[n]) for n in columns}

    def distances(q):
        return 0.05 + 0.02 * np.sin(9.0 * np.nan_to_num(q).sum(axis=-1))

    def clearance(q, rows):
        distance = distances(q)
        names = np.rint(distance * 1e7).astype(int)
        return SimpleNamespace(distance=distance, first=names, second=names + 1)

    bodies = SimpleNamespace(clearance=clearance, name=lambda row: f"body {row}", min_distance=0.08)
    issue = turning._blocked_error(samples, whole, BlockedMap(int(blocks.block[row])), "best", branch, bodies)
    least = {n: min(distances(single.q[i]) for i in part) for n, single in singles.items()}
    farthest = max(least.values())
    name = round(farthest * 1e7)
    shares = [f"{len(part_of_turns) / 0.12:.0f} % of all turns" for part_of_turns in (limited, columns)]
    assert re.search(
        rf"\(joint limit at {shares[0]}, collision at {shares[1]}: "
        rf"body {name} {1e3 * farthest:.2g} mm from body {name + 1} at best, and 80 mm are needed\)",
        issue.message,
    ), issue.message
    assert len(part) > 1


@pytest.mark.parametrize("has_bodies", [False, True])
@pytest.mark.parametrize(("gain", "is_good"), [(1.019, True), (1.021, False)])
@pytest.mark.parametrize(("is_blocked", "is_hit"), [(False, False), (True, False), (False, True)])
def test_the_turn_of_the_cell_is_as_good_within_two_percent_where_it_can_be_driven(
    path, monkeypatch, has_bodies, gain, is_good, is_blocked, is_hit
):
    """By the RMS along the cuts; only columns at the turn of the cell are open to its line."""
    samples, blocks, branch = path
    rng = np.random.default_rng(5)
    knots = rng.uniform(-1.0, 1.0, len(blocks.length))
    at_line = turning._sample_turns(samples, blocks, knots)
    best = rng.uniform(1e-4, 2e-4, len(blocks.first))
    is_cut = blocks.is_at_feed[blocks.block]
    # the same sum of squares, times the gain, elsewhere along the path
    lengths = blocks.cut_length
    level = np.sqrt(sum(n * e**2 for n, e in zip(lengths, best, strict=True)) / lengths.sum())
    today = np.where(is_cut, gain * level, 9.0)

    def evaluate(paths, divided, number, base, offset, bodies):
        assert (number, offset.tolist(), bodies) == (branch, [0.0], None)
        error = today if not base.any() else best
        assert not base.any() or np.array_equal(base, at_line)
        return SimpleNamespace(error=error[:, None])

    offset = turn_map.turns_of_circle(np.radians(30.0)) + 2.0 * np.pi
    whole = replace(turn_map._empty_map(blocks, np.zeros(len(samples)), offset, has_bodies=has_bodies))
    if has_bodies:
        whole.hit[1, 6] = True
    opened, struck = [], []

    def find(paths, columns, keep, mode, *, is_circle):
        opened.append((~columns.hit, keep, mode, is_circle))
        return BlockedMap(0) if is_blocked else Line(np.zeros(len(knots)), 0.0)

    def strike(paths, divided, number, line, bodies):
        struck.append((line.knots.any(), bodies))
        return np.array([False, is_hit])

    for name, function in (("_cheapest_line", find), ("_is_hit", strike)):
        monkeypatch.setattr(turning, name, function)
    monkeypatch.setattr(turn_map, "evaluate", evaluate)
    bodies = "bodies" if has_bodies else None
    found = turning._today_is_as_good(samples, whole, branch, LeastMargins(), Line(knots, 0.0), bodies)
    assert found == (is_good and not is_blocked and not (has_bodies and is_hit))
    if is_good:
        ((columns, keep, mode, is_circle),) = opened
        expected = np.zeros(columns.shape, dtype=bool)
        expected[:, 6] = True
        expected[1, 6] = not has_bodies
        np.testing.assert_array_equal(columns, expected)
        assert (keep, mode, is_circle) == (LeastMargins(), "best", True)
        assert struck == ([(False, "bodies")] if has_bodies and not is_blocked else [])


@pytest.mark.parametrize("has_fine", [True, False])
@pytest.mark.parametrize("free_after", [0, 1, 2, 3, 7, 99])
def test_lines_with_collisions_are_replaced_eight_times_at_most(monkeypatch, has_fine, free_after):
    """The refined line comes first; cells of each line that collides are closed."""
    closed, looked = [], []

    def find(samples, whole, keep, mode, *, is_circle):
        assert is_circle
        return Line(np.array([float(len(closed))]), 0.0)

    def refined(samples, blocks, branch, line, *, keep, mode, bodies):
        return Line(line.knots + 0.5, 0.0) if has_fine else None

    def strike(samples, blocks, branch, line, bodies):
        looked.append(float(line.knots[0]))
        return np.array([len(looked) <= free_after])

    def close(samples, whole, line, is_hit):
        closed.append(float(line.knots[0]))
        return whole

    for name, function in (
        ("_cheapest_line", find),
        ("_refine_line", refined),
        ("_is_hit", strike),
        ("_close_cells", close),
    ):
        monkeypatch.setattr(turning, name, function)
    whole = SimpleNamespace(blocks=None)
    line, after = turning._free_line(None, whole, 0, LeastMargins(), "best", "bodies")
    assert after is whole
    expected, tries = [], 0
    for _ in range(8):
        base = float(tries)
        for knot in (base + 0.5, base) if has_fine else (base,):
            expected.append(knot)
            tries += 1
            if tries > free_after:
                break
        if tries > free_after:
            break
    assert looked == expected
    assert closed == expected[: len(expected) - (free_after < len(expected))]
    assert line.knots[0] == (expected[-1] if free_after < len(expected) else np.floor(expected[-1]))
    looked.clear()
    closed.clear()
    alone, _ = turning._free_line(None, whole, 0, LeastMargins(), "best", None)
    assert alone.knots[0] == (0.5 if has_fine else 0.0)
    assert not looked


def test_a_blocked_map_has_no_line(monkeypatch):
    monkeypatch.setattr(turning, "_cheapest_line", lambda *arguments, is_circle: BlockedMap(3))
    whole = SimpleNamespace(blocks=None)
    assert turning._free_line(None, whole, 0, LeastMargins(), "best", "bodies") == (BlockedMap(3), whole)


def test_cuts_that_tilt_the_tool_are_those_whose_axis_differs_at_both_ends():
    """By more than a micrometre a metre; rapid moves and joint interpolations may tilt it."""
    samples = samples_of()
    rng = np.random.default_rng(2)
    motions = samples.program.motions
    target = motions.target[:]
    for k in range(len(motions)):
        angle = [0.0, 1e-7, 1e-5, 0.3][int(rng.integers(4))]
        target[k, :3, :3] = target[k, :3, :3] @ Rotation.from_rotvec([0.2 * k, angle, 0.0]).as_matrix()
    tilted = replace(samples.program, motions=replace(motions, target=Poses.of(target)))
    tilted_samples = PathSamples.of(tilted, samples.robot_in_cell, None)
    axes = target[:, :3, 0]
    expected = [
        k > 0 and not motions.rapid[k] and np.linalg.norm(axes[k] - axes[k - 1]) > 1e-6 for k in range(len(motions))
    ]
    assert turning._tilting_motions(tilted_samples).tolist() == expected
    assert 0 < sum(expected) < len(expected) - 2


def line_of(number):
    return Line(np.full(3, float(number)), 0.0)


@pytest.mark.parametrize("mode", ["best", "path"])
@pytest.mark.parametrize("has_bodies", [True, False])
@pytest.mark.parametrize("today_is_as_good", [True, False])
@pytest.mark.parametrize(
    ("wide", "bare"),
    [
        (line_of(1), line_of(2)),
        (BlockedMap(4), line_of(2)),
        (BlockedMap(4), BlockedMap(2)),
        (BlockedMap(2), BlockedMap(4)),
    ],
)
def test_the_turn_keeps_wide_margins_if_a_line_does_else_the_least_ones(
    monkeypatch, mode, has_bodies, today_is_as_good, wide, bare
):
    """The turn of the cell stays where it is as good; the error is about the block farthest along the program."""
    asked, priced = [], LeastMargins(joint=0.3)
    Sized = type("Sized", (), {"__len__": lambda self: 5})
    samples = Sized()
    blocks = SimpleNamespace(turn_of_motions=lambda paths, knots: 10.0 + knots)
    own = cell(redundancy_deg=20.0)
    if has_bodies:
        own = replace(own, collision=SimpleNamespace(clearance_mm=7.0))

    def free_line(paths, whole, branch, keep, asked_mode, bodies):
        asked.append((whole, branch, keep, asked_mode, bodies))
        return (wide if len(asked) == 1 else bare), f"map {len(asked)}"

    def evaluate(paths, divided, branch, base, offset, bodies):
        assert (paths, divided, branch, base.tolist(), bodies) == (samples, blocks, 3, [0.0] * 5, asked_bodies)
        np.testing.assert_allclose(np.degrees(offset), np.arange(-180.0, 180.0, 5.0), atol=1e-9)
        return "map 0"

    asked_bodies = ("bodies", samples, 7.0) if has_bodies else None
    for name, function in (
        ("PathSamples", SimpleNamespace(of=lambda program, place, source: samples)), ("_free_line", free_line),
        ("Blocks", SimpleNamespace(of=lambda paths: blocks)),
        ("_tilting_motions", lambda paths: np.zeros(3, dtype=bool)),
        ("Bodies", lambda paths, need: ("bodies", paths, need)),
        ("_margins_of_least_cost", lambda paths, whole, branch: priced),
        ("_today_is_as_good", lambda *parts: today_is_as_good), ("_turn_issue", lambda turn: "said"),
        ("_blocked_error",
         lambda paths, whole, block, asked_mode, branch, bodies: (whole, block, asked_mode, branch, bodies)),
    ):  # fmt: skip
        monkeypatch.setattr(turning, name, function)
    monkeypatch.setattr(turn_map, "evaluate", evaluate)
    monkeypatch.setattr(turn_map, "branch_of_start", lambda paths: 3)
    turn, issues = turning.choose_turn(SimpleNamespace(swivel=None), SimpleNamespace(cell=own), "source", mode)
    first_keep = LeastMargins() if mode == "best" else priced
    expected = [("map 0", 3, first_keep, mode, asked_bodies)]
    if isinstance(wide, BlockedMap):
        expected.append(("map 1", 3, turning.BARE_MARGINS, mode, asked_bodies))
    assert asked == expected
    if isinstance(wide, BlockedMap) and isinstance(bare, BlockedMap):
        assert turn is None
        assert issues == (("map 2", BlockedMap(4), mode, 3, asked_bodies),)
        return
    is_bare = isinstance(wide, BlockedMap)
    knots = bare.knots if is_bare else 0.0 * wide.knots if today_is_as_good else wide.knots
    assert (turn.mode, turn.map, turn.keep) == (
        mode,
        f"map {len(asked)}",
        turning.BARE_MARGINS if is_bare else LeastMargins(),
    )
    np.testing.assert_array_equal(turn.knots, knots)
    np.testing.assert_array_equal(turn.of_motion, 10.0 + knots)
    assert turn.constant == pytest.approx(np.radians(20.0))
    assert issues == ("said",)


@pytest.mark.parametrize(("mode", "is_refused"), [("best", False), ("path", True)])
def test_tilting_cuts_are_refused_along_the_path_alone(monkeypatch, path, mode, is_refused):
    samples, _, _ = path
    tilts = np.arange(6) == 4
    monkeypatch.setattr(turning, "_tilting_motions", lambda paths: tilts)
    monkeypatch.setattr(turning, "_free_line", lambda *parts: (BlockedMap(0), None))
    monkeypatch.setattr(turning, "_blocked_error", lambda *parts: "why")
    monkeypatch.setattr(turning, "_margins_of_least_cost", lambda *parts: LeastMargins())
    monkeypatch.setattr(turn_map, "evaluate", lambda *parts: None)
    turn, (issue,) = turning.choose_turn(samples.program, samples.robot_in_cell, None, mode)
    assert turn is None
    assert (issue == "why") != is_refused
    assert not is_refused or (issue.kind, issue.source_line) == ("redundancy", samples.program.motions.line[4])


@pytest.mark.parametrize(
    ("axis", "direction"), [("+X", (1, 0, 0)), ("-X", (-1, 0, 0)), ("+Z", (0, 0, 1)), ("-Z", (0, 0, -1))]
)
def test_a_program_is_turned_about_the_axis_of_its_tool_but_for_axis_targets(axis, direction):
    """About the direction from the tip to the spindle; five axes spin between the ends."""
    samples = samples_of()
    motions = samples.program.motions
    joints = np.full((6, 6), np.nan)
    joints[2] = 0.1
    made = replace(samples.program, motions=replace(motions, joints=joints))
    turn = np.linspace(-1.0, 2.0, 6)
    turned = turning.turn_program(made, axis, turn)
    for k in range(6):
        rotation = Rotation.from_rotvec(-turn[k] * np.array(direction, dtype=float)).as_matrix()
        expected = motions.target[k].copy()
        expected[:3, :3] = expected[:3, :3] @ (np.eye(3) if k == 2 else rotation)
        np.testing.assert_allclose(turned.motions.target[k], expected, atol=1e-12)


@pytest.mark.parametrize("mode", ["best", "path"])
def test_the_fine_map_lies_around_the_line_and_is_no_circle(monkeypatch, path, mode):
    samples, blocks, branch = path
    knots = np.linspace(-0.3, 0.4, len(blocks.length))
    calls = []

    def evaluate(paths, divided, number, base, offset, bodies):
        calls.append((number, bodies))
        np.testing.assert_allclose(base, turning._sample_turns(samples, blocks, knots))
        np.testing.assert_allclose(np.degrees(offset), np.arange(-6.0, 7.0), atol=1e-12)
        return "fine"

    def line_through(robot, whole, keep, start, *, turn_at_feed, is_circle):
        calls.append((robot, whole, keep, turn_at_feed, is_circle))
        np.testing.assert_array_equal(start, samples.robot_in_cell.cell.start_joints)
        return answers.pop(0)

    answers = [line_of(5), BlockedMap(1)]
    monkeypatch.setattr(turn_map, "evaluate", evaluate)
    monkeypatch.setattr(turn_map, "line_through", line_through)
    line = Line(knots, 0.0)
    found = turning._refine_line(samples, blocks, branch, line, keep=BARE_MARGINS, mode=mode, bodies="bodies")
    assert found.knots[0] == 5.0
    assert calls == [(branch, "bodies"), (samples.robot_in_cell.robot, "fine", BARE_MARGINS, mode == "path", False)]
    assert turning._refine_line(samples, blocks, branch, line, keep=BARE_MARGINS, mode=mode, bodies="bodies") is None


@pytest.mark.parametrize("seed", range(12))
def test_branches_on_which_some_turn_is_free_at_each_sample_have_no_collision(monkeypatch, seed):
    """Of those that reach the whole program; all count where none is free, or where one alone can be taken."""
    rng = np.random.default_rng(seed)
    turns, count = 3, 7
    worst = np.where(rng.random(8) < 0.5, rng.uniform(0.1, 1.0, 8), -np.inf)
    hits = rng.random((8, turns, count)) < rng.choice([0.15, 0.4, 0.8])
    q = [[np.full((6, count), 10.0 * branch + turn) for turn in range(turns)] for branch in range(8)]

    class Bodies:
        def __init__(self, samples, need):
            assert need == 7.0

        def is_hit_along_path(self, path, rows, breaks, *, between_samples):
            assert not between_samples
            assert breaks.all()
            assert rows.tolist() == list(range(20, 20 + count))
            branch, turn = divmod(int(path[0, 0]), 10)
            return hits[branch, turn]

    monkeypatch.setattr(turning, "Bodies", Bodies)
    table = SimpleNamespace(clearance_mm=7.0)
    samples = SimpleNamespace(robot_in_cell=SimpleNamespace(cell=SimpleNamespace(collision=table)))
    found = turning._collision_free_branches(samples, np.arange(20, 20 + count), q, worst)
    able = [k for k in range(8) if np.isfinite(worst[k])]
    free = [k in able and all(any(not hits[k, t, n] for t in range(turns)) for n in range(count)) for k in range(8)]
    assert found == (free if len(able) > 1 and any(free) else [True] * 8)
    samples.robot_in_cell.cell.collision = None
    assert turning._collision_free_branches(samples, np.arange(20, 20 + count), q, worst) == [True] * 8


def test_a_start_is_stated_with_four_decimals_and_no_negative_zero():
    start = turning._chosen_start(np.radians([-0.00004, 12.34567, -90.0, 180.0, 0.05, -0.04]), "because")
    assert start.joints == (0.0, 12.3457, -90.0, 180.0, 0.05, -0.04)
    assert str(start.joints[0]) == "0.0"
    words = "A1…A6 = 0.0, 12.3, -90.0, 180.0, 0.1, -0.0, its first target, because."
    assert start.message == f"The cell has no [start]: the program starts at {words}"


STATED = "DEF part()\n$VEL.CP=0.05\nPTP {{{0}}}\nLIN {{X 20,Y 0,Z 0,A 180,B 0,C 180}}\n{1}END\n"
POSE = "X 0,Y 0,Z 60,A 180,B 0,C 180"


def krl_samples(first, rest=""):
    own = cell(base=(1500.0, 0.0, 700.0))
    program, model = read_with_robot(STATED.format(first, rest), own, "krl")
    return program, RobotInCell.of(model, own)


def test_a_program_that_states_its_joints_starts_there():
    joints = "A1 3,A2 -91.5,A3 110,A4 0.25,A5 60,A6 -10"
    found = chosen_start(*krl_samples(joints))
    assert found.joints == (3.0, -91.5, 110.0, 0.25, 60.0, -10.0)
    assert found.message.endswith("its first target, whose joint angles it states.")


@pytest.mark.parametrize(
    "later", ["PTP {A1 0,A2 -90,A3 110,A4 0,A5 60,A6 0}\n", f"PTP {{{POSE.replace('X 0', 'X 10')},S 2,T 35}}\n"]
)
def test_only_motions_before_one_that_states_joints_or_a_status_decide_on_the_branch(later):
    """What follows is far out of reach: it does not count."""
    away = "LIN {X 5000,Y 0,Z 0,A 180,B 0,C 180}\n"
    alone, followed = (chosen_start(*krl_samples(POSE, rest)) for rest in ("", later + away))
    assert followed == alone
    unreached = chosen_start(*krl_samples(POSE, away))
    assert "on the branch that reaches most of the program" in unreached.message
    assert "on the branch with the most margin" in alone.message
