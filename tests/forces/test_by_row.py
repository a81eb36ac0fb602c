"""Sources of forces row by row: random tables and comments against plain readers, passes of lines, knots of pieces."""

from __future__ import annotations

from itertools import pairwise, zip_longest
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import forces, toolpath
from postproc.errors import ForceError
from postproc.forces import Knots, precedence, table
from postproc.program import FORCE_FRAMES, ForceNote
from tests.programs import program

NAMES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
COUNT = 12


def random_program(rng):
    """Motions on lines 1 to 9, some lines with several; force comments with and without a force."""
    line = np.sort(rng.integers(1, 10, COUNT))
    made = program([("LIN" if rng.random() < 0.75 else "RAPID", 10 * k, 0, 0) for k in range(COUNT)])
    made = replace(made, motions=replace(made.motions, line=line))
    notes, before = [], 0
    for _ in range(int(rng.integers(0, 5))):
        before = int(rng.integers(before, COUNT))
        wrench = tuple(rng.choice([0.0, 1.5, 80.0], 6).tolist()) if rng.random() < 0.7 else (0.0,) * 6
        notes.append(ForceNote(int(line[before]), wrench, str(rng.choice(FORCE_FRAMES)), before))
    return replace(made, notes=tuple(notes))


def rows_of(rng):
    """Rows of a table in any order: ranges of lines, or places along the moves of one line."""
    rows, line = [], 1
    while line < 10:
        last = line + int(rng.integers(0, 3))
        if rng.random() < 0.7:
            places = np.sort(rng.choice([0.0, 0.25, 0.5, 1.0], int(rng.integers(1, 4)), replace=False))
            frame = str(rng.choice(["", "base", "TOOL", "Feed"]))
            for t in [None] if rng.random() < 0.5 else places.tolist():
                sigmas = [float(rng.choice([0.5, 3.0])) if rng.random() < 0.4 else None for _ in NAMES]
                percent = (
                    float(rng.choice([5.0, 20.0])) if all(s is None for s in sigmas) and rng.random() < 0.5 else None
                )
                factor = 10.0 if percent is None and rng.random() < 0.3 else None
                rows.append((line, last, t, rng.normal(0.0, 100.0, 6).round(3), frame, sigmas, percent, factor))
        line = last + 1
    first = [rows[k][0] for k in rng.permutation(len(rows))]
    of_line = {line: iter([row for row in rows if row[0] == line]) for line in set(first)}
    return [next(of_line[line]) for line in first]  # the rows of one move follow each other in order of t


def text_of(rows):
    head = ",".join(
        ["line", *NAMES, "frame", "line_end", "t", *(f"s{n}" for n in NAMES), "sigma_percent", "factor_percent"]
    )
    lines = []
    for first, last, t, wrench, frame, sigmas, percent, factor in rows:
        cells = [first, *wrench, frame, last if last > first else "", "" if t is None else t]
        lines.append(",".join(str(c) for c in [*cells, *("" if v is None else v for v in (*sigmas, percent, factor))]))
    return "\n".join([head, *lines, ""])


def sigma_of(row):
    """Standard deviations of a row: stated ones, else by a share of each component; and that share."""
    _, _, _, wrench, _, sigmas, percent, factor = row
    share = (percent if percent is not None else factor or 0.0) / 100.0
    return [abs(w) * share if s is None else s for w, s in zip(wrench, sigmas, strict=True)], share


@pytest.mark.parametrize("seed", range(30))
def test_a_table_gives_each_motion_the_rows_of_its_line(tmp_path, seed):
    rng = np.random.default_rng(seed)
    made, rows = random_program(rng), rows_of(rng)
    m = made.motions
    lines = set(m.line.tolist())
    rows = [row for row in rows if lines & set(range(row[0], row[1] + 1))]
    if not rows:
        return
    (tmp_path / "f.csv").write_text(text_of(rows))
    knots = forces.read_force_csv(tmp_path / "f.csv").along(made, toolpath.segments(made, np.eye(4)))
    expected = []
    for k in range(COUNT):
        line = m.line[k]
        cuts_too = any(m.line[n] == line and not m.rapid[n] for n in range(COUNT))
        if m.rapid[k] and cuts_too:
            continue
        own = [row for row in rows if row[0] <= line <= row[1]]
        for row in sorted(own, key=lambda row: row[2] or 0.0):
            frame = ["BASE", "TOOL", "FEED"].index(row[4].upper() or "BASE")
            expected.append((k, 1.0 if row[2] is None else row[2], row[3], frame, *sigma_of(row), row[2] is None))
    assert len(knots) == len(expected)
    for n, (motion, t, wrench, frame, sigma, factor, ramped) in enumerate(expected):
        assert (knots.motion[n], knots.t[n], knots.frame[n], knots.ramped[n]) == (motion, t, frame, ramped)
        np.testing.assert_allclose(knots.wrench[n], wrench)
        np.testing.assert_allclose(knots.sigma[n], sigma)
        assert knots.factor[n] == pytest.approx(factor)
    assert not knots.issues


def comment_of(made, motion):
    """The last comment executed before a motion."""
    return next((note for note in reversed(made.notes) if note.before <= motion), None)


@pytest.mark.parametrize("seed", range(40))
def test_a_source_replaces_comments_on_its_motions_and_says_where_they_differ(seed):
    rng = np.random.default_rng(seed)
    made = random_program(rng)
    motion = np.sort(rng.choice(COUNT, int(rng.integers(1, 8)), replace=False))
    wrench, frame = rng.choice([0.0, 1.5, 80.0, 80.0019, 80.0021], (len(motion), 6)), rng.integers(0, 3, len(motion))
    for n, k in enumerate(motion):
        note = comment_of(made, k)
        if note is not None and rng.random() < 0.6:
            wrench[n], frame[n] = np.add(note.wrench, rng.choice([0.0, 1.9e-3, 2.1e-3])), FORCE_FRAMES.index(note.frame)
    source = Knots.throughout(motion, wrench, frame)
    knots, issues = forces.precedence.combine(made, source, "f.csv")
    by_motion = {int(k): (wrench[n], int(frame[n])) for n, k in enumerate(motion)}
    stated, conflicts = [], []
    for k in range(COUNT):
        note = comment_of(made, k)
        if note is None:
            continue
        stated += [k] if any(note.wrench) and not made.motions.rapid[k] else []
        if k not in by_motion:
            by_motion[k] = np.array(note.wrench), FORCE_FRAMES.index(note.frame)
        elif k in stated:
            differs = np.abs(np.subtract(note.wrench, by_motion[k][0])).max() > 2e-3
            conflicts += [k] if differs or by_motion[k][1] != FORCE_FRAMES.index(note.frame) else []
    assert knots.motion.tolist() == sorted(by_motion)
    for n, k in enumerate(knots.motion):
        np.testing.assert_array_equal(knots.wrench[n], by_motion[k][0])
        assert knots.frame[n] == by_motion[k][1]
    kinds = {issue.kind: issue for issue in issues}
    assert ("force-sources" in kinds, "force-replaced" in kinds) == (bool(stated), bool(conflicts))
    if stated:
        cutting = [k for k in motion if not made.motions.rapid[k]]
        own = [k for k in stated if k not in motion]
        words = f"f.csv on {len(cutting)} cutting moves, comments of the program on {len(own)};"
        assert words in kinds["force-sources"].message
    if conflicts:
        assert set(kinds["force-replaced"].lines) == {int(made.motions.line[k]) for k in conflicts}


@pytest.mark.parametrize("seed", range(30))
def test_comments_that_hold_on_no_cutting_move_are_listed(seed):
    made = random_program(np.random.default_rng(seed))
    acting = [comment_of(made, k) for k in range(COUNT) if not made.motions.rapid[k] and comment_of(made, k)]
    used = {(note.wrench, note.frame) for note in acting}  # the reader of KRL states a force again behind branches
    # one that another force follows before the next motion is kept text of a corrected program
    followed = [a.before == b.before and any(b.wrench) for a, b in pairwise(made.notes)]
    notes = [note for note, skipped in zip_longest(made.notes, followed) if not skipped]
    lines = sorted({note.line for note in notes if any(note.wrench) and (note.wrench, note.frame) not in used})
    issues = list(precedence.unused_comment_issues(made))
    assert [issue.lines for issue in issues] == ([tuple(lines)] if lines else [])
    knots = precedence.comment_knots(made)
    assert knots.motion.tolist() == [k for k in range(COUNT) if comment_of(made, k)]
    unset = replace(made, notes=(ForceNote(1, (1.0,) * 6, "BASE", -1),))
    with pytest.raises(ValueError, match=r"leaves ForceNote\.before unset"):
        precedence.comment_knots(unset)


@pytest.mark.parametrize("seed", range(20))
def test_the_largest_force_of_the_cuts_is_questioned_below_three_newtons(seed):
    """Unless a moment acts: it would be in kilonewton metres too."""
    rng = np.random.default_rng(seed)
    made = random_program(rng)
    motion = np.arange(COUNT)
    wrench = np.zeros((COUNT, 6))
    wrench[:, :3] = rng.choice([0.0, 0.5, 1.7], (COUNT, 3)) * (rng.random(COUNT) < 0.7)[:, None]
    wrench[:, :3] *= rng.choice([1.0, 0.1])  # all of them below 1 N too
    wrench[rng.integers(COUNT), 3] = rng.choice([0.0, 1.0], p=[0.8, 0.2])
    sizes = np.linalg.norm(wrench[:, :3], axis=1) * ~made.motions.rapid
    issues = list(precedence.small_force_issues(made, Knots.throughout(motion, wrench, 0 * motion)))
    assert bool(issues) == (0.0 < sizes.max() < 3.0 and not wrench[:, 3:].any())
    if issues:
        row = int(sizes.argmax())
        assert issues[0].source_line == made.motions.line[row]
        assert issues[0].message.startswith(f"the largest force is {sizes[row]:.2g} N: are these kN?")
        assert (issues[0].level, issues[0].kind, issues[0].count) == ("warning", "force-unit", 1)


@pytest.mark.parametrize("seed", range(30))
def test_a_line_that_is_passed_several_times_has_the_forces_of_its_first_pass(seed):
    """Others differ by more than the decimals of a file, in frame, or in number."""
    rng = np.random.default_rng(seed)
    targets = 9
    line = rng.integers(1, 5, targets)
    base = {n: (np.sort(rng.uniform(0.0, 0.9, int(rng.integers(0, 3)))), rng.normal(0.0, 50.0, 6)) for n in range(1, 5)}
    columns, differ, first = {name: [] for name in ("motion", "t", "wrench", "frame", "sigma", "factor")}, [], {}
    for k in range(targets):
        inner, wrench = base[int(line[k])]
        off, odd = (
            rng.choice([0.0, 1.9e-3, 2.1e-3], p=[0.6, 0.2, 0.2]),
            str(rng.choice(["", "t", "frame", "sigma", "factor", "count"], p=[0.6, 0.05, 0.05, 0.05, 0.05, 0.2])),
        )
        off *= int(line[k]) in first
        odd = odd if int(line[k]) in first else ""
        places = [*inner.tolist(), 1.0]
        if odd == "count":
            places = [0.95, *places] if len(inner) == 0 else places[1:]
        for n, t in enumerate(places):
            columns["motion"].append(k)
            columns["t"].append(t - 2e-9 * (odd == "t" and n == 0))
            columns["wrench"].append(wrench + off * np.eye(6)[n % 6])
            columns["frame"].append(int(odd == "frame"))
            columns["sigma"].append(np.full(6, 1.0 + 2.1e-3 * (odd == "sigma")))
            columns["factor"].append(0.1 + 2e-9 * (odd == "factor"))
        if int(line[k]) not in first:
            first[int(line[k])] = k
        elif odd or off > 2e-3:
            differ.append(k)
    knots = Knots(
        **{name: np.array(values) for name, values in columns.items()}, ramped=np.zeros(len(columns["t"]), dtype=bool)
    )
    found, rows = table.first_pass_knots(knots, line)
    assert rows.tolist() == differ
    expected = [n for name in sorted(first) for n, k in enumerate(columns["motion"]) if k == first[name]]
    np.testing.assert_array_equal(found.wrench, np.array(columns["wrench"])[expected])
    assert found.motion.tolist() == [columns["motion"][n] for n in expected]


@pytest.mark.parametrize("seed", range(12))
def test_pieces_with_one_force_keep_the_last_knot_alone(seed):
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 4, 8)
    motion = np.repeat(np.arange(8), counts)
    wrench, sigma, factor = np.zeros((len(motion), 6)), np.ones((len(motion), 6)), np.full(len(motion), 0.2)
    t = np.concatenate([np.linspace(0.0, 1.0, n) if n > 1 else [1.0] for n in counts])
    for values, rows in ((wrench, 6), (sigma, 6)):
        changed = rng.random(len(motion)) < 0.2
        values[changed, rng.integers(rows)] += rng.choice([0.9e-6, 1.1e-6])
    factor[rng.random(len(motion)) < 0.1] += 1e-3
    knots = Knots(motion, t, wrench, np.zeros(len(motion), dtype=int), sigma, factor, np.zeros(len(motion), dtype=bool))
    expected = []
    for k in range(8):
        rows = np.flatnonzero(motion == k)
        columns = np.hstack([wrench[rows], sigma[rows], factor[rows, None]])
        expected += rows.tolist() if np.abs(columns - columns[-1]).max() > 1e-6 else [rows[-1]]
    np.testing.assert_array_equal(table._without_repeated_forces(knots).t, t[expected])
    assert table._without_repeated_forces(knots).motion.tolist() == motion[expected].tolist()


@pytest.mark.parametrize("count", [1, 2, 6, 7])
def test_rows_of_lines_without_a_motion_are_counted_and_five_are_listed(tmp_path, count):
    made = program([("LIN", 10 * k, 0, 0) for k in range(3)])
    rows = "".join(f"{20 + k},1,0,0\n" for k in range(count))
    (tmp_path / "f.csv").write_text(f"line,Fx,Fy,Fz\n2,1,0,0\n{rows}")
    with pytest.raises(ForceError) as refused:
        forces.read_force_csv(tmp_path / "f.csv").along(made, None)
    others = ", ".join(str(20 + k) for k in range(1, min(count, 6))) + (", …" if count > 6 else "")
    suffix = f", nor on {others}: {count} rows of {count + 1}" if count > 1 else ""
    assert refused.value.problem == f"no motion starts on line 20 of part.nc{suffix}"
    assert refused.value.line == 3


def test_a_call_that_is_not_followed_refuses_forces_on_its_line(tmp_path):
    (tmp_path / "f.csv").write_text("line,Fx,Fy,Fz,line_end\n1,5,0,0,1\n2,0,0,0,3\n")
    source = forces.read_force_csv(tmp_path / "f.csv")
    made = program([("LIN", 10 * k, 0, 0) for k in range(3)])
    for line, is_refused in ((1, True), (2, False), (3, False)):
        call = SimpleNamespace(line=line, error=ForceError("not followed"))
        with_call = replace(made, unfollowed=(call,))
        if is_refused:
            with pytest.raises(ForceError, match="not followed"):
                source.along(with_call, None)
        else:
            assert len(source.along(with_call, None)) == 3


def test_an_unknown_frame_is_refused_with_those_that_are_known(tmp_path):
    (tmp_path / "f.csv").write_text("line,Fx,Fy,Fz,frame\n1,1,0,0,FED\n2,1,0,0,tool\n")
    with pytest.raises(ForceError) as refused:
        forces.read_force_csv(tmp_path / "f.csv")
    assert (refused.value.problem, refused.value.line) == ("unknown frame 'FED'", 2)
    assert all(name in refused.value.advice for name in FORCE_FRAMES)
    assert "Valid frames" in refused.value.advice
