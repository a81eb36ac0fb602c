"""Questions about cells and programs, row by row: which values are asked about, on which lines, with which numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import frames
from postproc.chunks import Runs
from postproc.correction import plausibility
from postproc.errors import Issue
from postproc.program import Event
from tests.kr270 import CELL, ROBOT
from tests.programs import program

COUNT = 10
SEEDS = range(16)


def random_program(rng, tools, bases):
    moves = [("LIN" if rng.random() < 0.6 else "RAPID", *rng.uniform(-100, 100, 3)) for _ in range(COUNT)]
    made = program(moves, tools=tools, bases=bases)
    motions = replace(
        made.motions, tool=rng.integers(0, len(tools), COUNT), base=rng.integers(0, len(bases), COUNT),
        feed=rng.choice([9.0, 11.0, 1200.0, 29e3, 31e3], COUNT) / 60e3,
    )  # fmt: skip
    return replace(made, motions=motions)


def lines(issue):
    return sorted(issue.lines or (issue.source_line,))


@pytest.mark.parametrize("keeps_text", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_tools_shorter_than_5_mm_and_bases_inside_the_foot_are_asked_about(seed, keeps_text):
    rng = np.random.default_rng(seed)
    sizes = rng.choice([0.0, 0.35, 4.9, 5.1, 350.0], 3), rng.choice([0.0, 1.5, 9.9, 10.1, 1500.0], 3)
    directions = rng.normal(size=(2, 3, 3))
    directions /= np.linalg.norm(directions, axis=2)[..., None]
    tools, bases = (
        frames.pose_from_xyzabc(np.hstack([size[:, None] * d, np.zeros((3, 3))]))
        for size, d in zip(sizes, directions, strict=True)
    )
    made = replace(random_program(rng, tools, bases), layout=SimpleNamespace() if keeps_text else None)
    m, expected = made.motions, []
    is_short, is_near = sizes[0] < 5.0, (sizes[1] > 0.0) & (sizes[1] < 10.0)
    for kind, rows, values, is_odd in (
        ("short-tool", m.tool, sizes[0], is_short),
        ("near-base", m.base, sizes[1], is_near),
    ):
        for row in range(3):
            cuts = [k + 1 for k in range(COUNT) if rows[k] == row and not m.rapid[k]]
            if cuts and is_odd[row]:
                expected.append((kind, cuts, f"{values[row]:.3g} mm from the"))
    issues = list(plausibility.setup_questions(made, CELL, ROBOT))
    assert [(issue.kind, lines(issue)) for issue in issues] == [(kind, cuts) for kind, cuts, _ in expected]
    for issue, (kind, _, words) in zip(issues, expected, strict=True):
        assert issue.level == "warning"
        assert words in issue.message
        table = {"short-tool": "[tool] or [tools.n]", "near-base": "[base]"}[kind]
        name = {"short-tool": "$TOOL", "near-base": "$BASE"}[kind]
        assert (f"{table} of the cell is in mm" in issue.message) == (not keeps_text)
        assert (f"{name} of the program is in mm" in issue.message) == keeps_text


def forces_of(rng, made, rating):
    """Knots of some motions: forces about once and twice the rating, moments about half a metre of lever."""
    counts = rng.integers(0, 4, COUNT)
    wrench = np.zeros((counts.sum(), 6))
    for k in range(len(wrench)):
        direction = rng.normal(size=3)
        size = rng.choice(
            [0.0, 50.0, 0.99 * rating, 1.01 * rating, 1.99 * rating, 2.01 * rating], p=[0.2, 0.5, 0.1, 0.1, 0.05, 0.05]
        )
        wrench[k, :3] = size * direction / np.linalg.norm(direction)
        direction = rng.normal(size=3)
        wrench[k, 3:] = size * rng.choice([0.1, 0.49, 0.51]) * direction / np.linalg.norm(direction)
        wrench[k, 3] += 5.0 * (size == 0.0 and rng.random() < 0.5)
    return (
        SimpleNamespace(law_forces=None, first=np.append(0, np.cumsum(counts)), wrench=Runs.of(wrench)),
        wrench,
        np.repeat(np.arange(COUNT), counts),
    )


@pytest.mark.parametrize("seed", range(40))
def test_forces_beyond_the_rating_and_levers_beyond_half_a_metre_are_asked_about(seed):
    """Of cuts alone; above twice the rating with a warning. Moments without a force have no lever."""
    rng = np.random.default_rng(seed)
    made = replace(random_program(rng, np.eye(4)[None], np.eye(4)[None]), layout=SimpleNamespace())
    rating = 270.0 * 9.81
    path_forces, wrench, motion = forces_of(rng, made, rating)
    is_cut = ~made.motions.rapid[motion]
    size, moment = (np.linalg.norm(wrench[:, part], axis=1) * is_cut for part in (slice(3), slice(3, 6)))
    expected = []
    strong = sorted({int(k) + 1 for k in motion[size > 270.0 * plausibility.GRAVITY]})
    if strong:
        level = "warning" if size.max() > 2.0 * 270.0 * plausibility.GRAVITY else "info"
        expected.append((level, "force-rating", strong, f"a force of {size.max():.0f} N: {ROBOT.title} carries 270 kg"))
    levers = [n for n in range(len(wrench)) if size[n] > 0.0 and moment[n] > 0.5 * size[n]]
    if levers:
        worst = max(levers, key=lambda n: moment[n])
        words = f"a moment of {moment[worst]:.4g} N·m with a force of {size[worst]:.4g} N: a lever of "
        words += f"{moment[worst] / size[worst]:.2g} m."
        expected.append(("warning", "moment-unit", sorted({int(motion[n]) + 1 for n in levers}), words))
    issues = list(plausibility.force_questions(made, path_forces, CELL, ROBOT))
    assert [(issue.level, issue.kind, lines(issue)) for issue in issues] == [entry[:3] for entry in expected]
    assert all(words in issue.message for issue, (_, _, _, words) in zip(issues, expected, strict=True))


@pytest.mark.parametrize(
    ("is_computed", "kinds", "advice"),
    [
        (False, ["default-speed"], "Are the forces in N?"),
        (True, ["default-speed"], "a speed that is assumed, since $VEL.CP is not set"),
        (True, [], "Check feed, tool and stock"),
    ],
)
def test_a_computed_force_is_doubted_by_what_it_is_computed_from(is_computed, kinds, advice):
    program = SimpleNamespace(issues=[Issue("info", kind, "") for kind in kinds])
    forces = SimpleNamespace(law_forces=object() if is_computed else None)
    assert advice in plausibility._force_advice(program, forces)


@pytest.mark.parametrize("has_lines", [True, False])
@pytest.mark.parametrize("seed", range(24))
def test_cuts_with_a_stopped_spindle_or_the_feed_of_another_unit_are_asked_about(seed, has_lines):
    """Cuts are motions at feed with a force; the spindle of a cell without lines for it is switched otherwise."""
    rng = np.random.default_rng(seed)
    made = random_program(rng, np.eye(4)[None], np.eye(4)[None])
    path_forces, wrench, motion = forces_of(rng, made, 1e4)
    gcode = replace(CELL.gcode, spindle_on=["M3"] if has_lines else [], spindle_ccw=[])
    before = np.sort(rng.integers(0, COUNT, int(rng.integers(0, 4))))
    kinds = rng.choice(["spindle_on", "spindle_ccw", "spindle_off", "coolant_on"], len(before), p=[0.2, 0.2, 0.4, 0.2])
    events = tuple(
        Event(before=int(b), kind=str(kind), value=1000.0, line=40 + n)
        for n, (b, kind) in enumerate(zip(before, kinds, strict=True))
    )
    made = replace(made, events=events)
    cuts = [k for k in range(COUNT) if not made.motions.rapid[k] and wrench[motion == k, :3].any()]
    feeds = 60e3 * made.motions.feed
    odd = [k for k in cuts if not 10.0 <= feeds[k] <= 30e3]
    off, causes = [], {}
    for k in cuts:
        switch = [event for event in events if event.before <= k and event.kind.startswith("spindle")]
        if has_lines and (not switch or switch[-1].kind == "spindle_off"):
            off.append(k)
            causes[k] = f"line {switch[-1].line} switches it off" if switch else "nothing switches it on before"
    expected = [("feed-unit", [k + 1 for k in odd])] * bool(odd) + [("spindle-off", [k + 1 for k in off])] * bool(off)
    cell = replace(CELL, gcode=gcode)
    issues = [
        issue
        for issue in plausibility.force_questions(made, path_forces, cell, ROBOT)
        if issue.kind in ("feed-unit", "spindle-off")
    ]
    assert [(issue.kind, lines(issue)) for issue in issues] == expected
    for issue in issues:
        words = (
            f"a feed of {feeds[odd[0]]:.3g} mm/min" if issue.kind == "feed-unit" else f"spindle off: {causes[off[0]]}."
        )
        assert words in issue.message
    kept = replace(made, layout=SimpleNamespace())
    assert not [
        i
        for i in plausibility.force_questions(kept, path_forces, cell, ROBOT)
        if i.kind in ("feed-unit", "spindle-off")
    ]


@pytest.mark.parametrize("seed", range(40))
def test_a_longer_tool_is_asked_about_where_it_reaches_below_cuts(seed):
    """Below the deepest of all along the tool, or below the highest within 50 mm around the cuts, in one $BASE."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    lengths = rng.choice([100.0, 100.0009, 130.0, 160.0], 3)
    tools = frames.pose_from_xyzabc([[0.0, 0, length, 0, 0, 0] for length in lengths])
    moves = [
        ("LIN" if rng.random() < 0.4 else "RAPID", *(rng.uniform(-60, 60, 2)), rng.uniform(0, 60)) for _ in range(COUNT)
    ]
    made = program(moves, tools=tools, bases=np.tile(np.eye(4), (2, 1, 1)))
    down = np.diag([1.0, -1.0, -1.0])
    target = made.motions.target[:]
    target[:, :3, :3] = turn @ down
    target[:, :3, 3] = target[:, :3, 3] @ turn.T
    motions = replace(
        made.motions, target=target, tool=np.sort(rng.integers(0, 3, COUNT)), base=np.sort(rng.integers(0, 2, COUNT))
    )
    made = replace(made, motions=motions)
    up = -(turn @ down @ [0.0, 0.0, 1.0])
    is_retract = [False] * COUNT
    for k in range(1, COUNT):
        step = target[k, :3, 3] - target[k - 1, :3, 3]
        is_straight = np.linalg.norm(step - (step @ up) * up) < 1e-6
        is_retract[k] = step @ up > 0 and (is_straight or is_retract[k - 1])
    expected = []
    for k in range(1, COUNT):
        before, after = motions.tool[k - 1], motions.tool[k]
        if before == after or motions.base[k - 1] != motions.base[k] or lengths[after] - lengths[before] <= 1e-3:
            continue
        axis = turn @ down @ [0.0, 0.0, 1.0]
        tip = target[k - 1, :3, 3] + 1e-3 * (lengths[after] - lengths[before]) * axis
        cuts = [
            target[n, :3, 3]
            for n in range(COUNT)
            if not (motions.rapid[n] or is_retract[n]) and motions.base[n] == motions.base[k]
        ]
        if not cuts:
            continue
        depths = [(point - tip) @ axis for point in cuts]
        across = np.array([point - tip - depth * axis for point, depth in zip(cuts, depths, strict=True)])
        is_over = bool((across.min(axis=0) <= 0.05).all() and (across.max(axis=0) >= -0.05).all())
        if max(depths) < 0.0 or (is_over and min(depths) < 0.0):
            where = "among" if max(depths) >= 0.0 else "below all"
            numbers = ", ".join(
                f"{name} {round(1e3 * value, 4) + 0.0:.6g}" for name, value in zip("XYZ", tip, strict=True)
            )
            longer = f"{lengths[after] - lengths[before]:.4g} mm longer: where it is mounted its tip is at {numbers}"
            expected.append((k + 1, f"is {longer} of $BASE, which is {where} the cuts."))
    issues = list(plausibility.tool_change_warnings(made, "+Z"))
    assert [issue.source_line for issue in issues] == [row for row, _ in expected]
    for issue, (_, words) in zip(issues, expected, strict=True):
        assert (issue.level, issue.kind) == ("warning", "tool-change-depth")
        assert words in issue.message
