"""Forces along a program on which every axis turns, against a loop that follows it motion by motion.

The tool turns on every motion, two bases and tools, arcs about tilted axes; forces in all frames, moments as large as
the forces.
"""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import forces, frames, toolpath
from postproc.chunks import Runs
from postproc.forces import Knots, table
from postproc.forces.axes import is_arc_across, is_line_across
from postproc.poses import Poses
from postproc.program import CIRC, LIN, ForceNote, Targets
from tests.programs import program
from tests.toolpath.setting import START, arc, begins, mixed, point, turned, unit

BASE, TOOL, FEED = range(3)
RAMP = 4e-3
AXES = {"+Z": (2, 1.0), "-Z": (2, -1.0), "+X": (0, 1.0), "-X": (0, -1.0)}


class Given:
    """A source of forces given as knots."""

    name = "given"

    def __init__(self, knots):
        self.knots = knots

    def along(self, _program, _path):
        return self.knots


def random_knots(rng, made):
    """Each cutting motion by one ramped wrench, or by two to five along it; standard deviations."""
    rows = []
    for k in np.flatnonzero(~made.motions.rapid).tolist():
        ramped, frame = rng.uniform() < 0.5, int(rng.integers(0, 3))
        places = [1.0] if ramped else np.unique(np.round(rng.uniform(0.0, 1.0, rng.integers(2, 6)), 3))
        if not ramped and rng.uniform() < 0.5:
            places[0] = 0.0
        rows += [(k, t, frame, ramped) for t in places]
    motion, t, frame, ramped = (np.array(column) for column in zip(*rows, strict=True))
    wrench, sigma = rng.normal(0.0, 100.0, (len(t), 6)), rng.uniform(0.0, 9.0, (len(t), 6))
    for n in range(1, len(t)):
        if ramped[n] and rng.uniform() < 0.4:  # as before, in one base: there is nothing to ramp
            frame[[n - 1, n]], wrench[n], sigma[n] = BASE, wrench[n - 1], sigma[n - 1]
            frame[motion == motion[n - 1]] = BASE
    return Knots(motion, t.astype(float), wrench, frame, sigma, rng.uniform(0.0, 0.5, len(t)), ramped)


def axes_at(made, k, t, frame, spindle="+Z"):
    """Axes (3, 3) as columns in `$BASE`, at a place of a motion: by finite differences of the place."""
    begin = begins(made)
    pose = turned(begin[k], made.motions.target[k], t)
    if frame == BASE:
        return np.eye(3)
    if frame == TOOL:
        return pose
    h = 1e-6
    travel = point(made, begin, k, t + h) - point(made, begin, k, t - h)
    column, sign = AXES[spindle]
    z = -sign * pose[:, column]
    x = travel - (travel @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def columns_at(made, knots, length, k, t, values, spindle="+Z"):
    """Columns (2, 3, m) of force and moment at a place, `$BASE`; values (K, 2, 3, m) at the knots."""
    own = np.flatnonzero(knots.motion == k)
    if not len(own):
        places, told, frame, ramped = np.ones(1), np.zeros((1, *values.shape[1:])), BASE, True
    else:
        places, told, frame, ramped = knots.t[own], values[own], knots.frame[own[0]], knots.ramped[own[0]]

    def mixed_at(places, told):
        return np.apply_along_axis(lambda column: np.interp(t, places, column), 0, told)

    if not ramped:
        return np.einsum("ij,hjm->him", axes_at(made, k, t, frame, spindle), mixed_at(places, told))
    share = min(1.0, t * length[k] / RAMP)
    before = np.zeros(values.shape[1:])
    if k > 0:
        before = columns_at(made, knots, length, k - 1, 1.0, values, spindle)
        one, other = (made.bases[made.motions.base[j], :3, :3] for j in (k - 1, k))
        before = np.einsum("ij,hjm->him", other.T @ one, before)
    full = np.einsum("ij,hjm->him", axes_at(made, k, t, frame, spindle), told[0])
    return before + share * (full - before)


@pytest.mark.parametrize("spindle", AXES)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_wrenches_and_deviations_anywhere(seed, spindle):
    rng, made = np.random.default_rng(seed), mixed()
    knots = random_knots(rng, made)
    path = toolpath.segments(made, START)
    load = forces.assign(made, path, Given(knots), spindle, RAMP)
    count = len(made.motions)
    motion = np.repeat(np.arange(1, count), 12)
    t = np.concatenate([np.append(rng.uniform(0.0, 1.0, 11), 1.0) for _ in range(1, count)])
    t[::12] = 0.3 * RAMP / path.length[1:]
    sample = toolpath.at(made, path, motion, t)
    found, spread = load.at(sample), load.spread_at(sample)
    wrench, by_factor = (each.reshape(-1, 2, 3, 1) for each in (knots.wrench, knots.factor[:, None] * knots.wrench))
    values = np.concatenate([wrench, knots.sigma.reshape(-1, 2, 3, 1) * np.eye(3), by_factor], axis=-1)
    in_root = load.spread_in_root(sample)
    for row, (k, place) in enumerate(zip(motion, t, strict=True)):
        columns = columns_at(made, knots, path.length, k, place, values, spindle)
        np.testing.assert_allclose(found[row], columns[..., 0].reshape(6), atol=1e-4)
        expected = columns[..., 1:4]
        np.testing.assert_allclose(spread[row], expected, atol=1e-5)
        root = made.bases[made.motions.base[k], :3, :3]
        np.testing.assert_allclose(in_root[row, :3, :3], root @ expected[0], atol=1e-5)
        np.testing.assert_allclose(in_root[row, 3:, 3:6], root @ expected[1], atol=1e-5)
        np.testing.assert_allclose(in_root[row, :, 12], (columns[..., 4] @ root.T).reshape(6), atol=1e-4)


def test_at_a_knot_and_beyond_the_last_the_wrench_is_its_own():
    made = mixed()
    wrench = np.arange(18.0).reshape(3, 6)
    knots = Knots.along(np.array([3, 3, 3]), np.array([0.25, 0.5, 0.75]), wrench, np.zeros(3, dtype=int))
    path = toolpath.segments(made, START)
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    at = toolpath.at(made, path, np.full(6, 3), np.array([1e-9, 0.25, 0.5, 0.75, 0.8, 1.0]))
    np.testing.assert_array_equal(load.at(at), wrench[[0, 0, 1, 2, 2, 2]])


COMPLIANCE = 2e-6, 7e-6


def moves(wrench):
    """How far the tool gives way to wrenches (..., 6), about [m]."""
    return COMPLIANCE[0] * np.linalg.norm(wrench[..., :3], axis=-1) + COMPLIANCE[1] * np.linalg.norm(
        wrench[..., 3:], axis=-1
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_displacement_by_the_force_is_estimated_from_its_changes(seed):
    rng, made = np.random.default_rng(seed), mixed()
    knots = random_knots(rng, made)
    knots.wrench[np.ix_(knots.motion == 6, [0, 1, 3, 4])] = 0.0  # along the spindle alone
    knots.frame[knots.motion == 6] = FEED
    keep = (knots.motion == 3) & ~knots.ramped  # on this line the force goes straight on through its knots, but for one
    knots.wrench[keep] = 50.0 * knots.t[keep, None] + np.where(knots.t[keep, None] > 0.6, 9.0, 0.0)
    path = toolpath.segments(made, START)
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    found = forces.displacement_estimate(load, COMPLIANCE)
    begin = np.zeros((len(made.motions), 6))
    rows = []
    for k in range(len(made.motions)):
        at = load.first[k], load.first[k + 1]
        own = load.wrench[at[0] : at[1]]
        t = load.t[at[0] : at[1]]
        ramped = load.ramped[k]

        def there(place, k=k):
            return load.at(toolpath.at(made, path, np.array([k]), np.array([place])))[0]

        change = [np.zeros(6)]
        for i in range(1, len(t)):
            straight = load.knot_frame[at[0] + i] == load.knot_frame[at[0] + i - 1]
            change.append(own[i] - own[i - 1] if straight else there(t[i]) - own[i - 1])
        for i in range(len(t)):
            bent = False
            if 0.0 < t[i] < 1.0:
                before = change[i] / (t[i] - t[i - 1]) if i else np.zeros(6)
                after = change[i + 1] / (t[i + 1] - t[i]) if i + 1 < len(t) else np.zeros(6)
                bent = np.abs((after - before) * (t[i] - t[i - 1] if i else 1.0)).max() >= 1e-9
            rows.append((k, t[i], moves(change[i]), bent))
        if not ramped:
            step = moves(there(0.0) - load.wrench_before()[k])
            if step > 1e-8:
                rows.append((k, min(0.5, 1e-5 / max(path.length[k], 1e-5)), step, True))
        own = own[1:] if ramped and t[0] == 0.0 else own  # without the force of the motion before
        assert found.size[k] == pytest.approx(moves(own).max())
        turning = made.motions.kind[k] == 1 and load.frame[k] == FEED
        across = own * [1, 1, 0, 1, 1, 0]
        assert found.turning[k] == pytest.approx(moves(across).max() if turning else 0.0)
        if not turning:
            assert not found.swings[k]
        else:
            runs = is_arc_across(made, path, np.array([k]), "+Z")[0]
            assert found.swings[k] == (across.any() and not runs)
        begin[k] = load.wrench_before()[k]
    rows = sorted((row for row in rows if row[3] or made.motions.kind[row[0]] == CIRC), key=lambda row: row[:2])
    np.testing.assert_array_equal(found.motion, [row[0] for row in rows])
    np.testing.assert_allclose(found.t, [row[1] for row in rows])
    np.testing.assert_allclose(found.change, [row[2] for row in rows], atol=1e-15)
    np.testing.assert_array_equal(found.is_bend, [row[3] for row in rows])


def leaning(begin, end, *moves_):
    """A program whose tool stands at angles about X where its last motion begins and ends [deg]."""
    made = program(moves_)
    target = made.motions.target[:]
    for k, angle in ((-2, begin), (-1, end)):
        target[k, :3, :3] = frames.pose_from_xyzabc([0, 0, 0, 0, 0, 180.0 + angle])[:3, :3]
    return replace(made, motions=replace(made.motions, target=Poses.of(target)))


@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.0), (20.0, 0.0), (0.0, 20.0), (10.0, -10.0)])
@pytest.mark.parametrize("climb", [0.0, 15.0])
def test_arcs_run_across_the_spindle_up_to_45_degrees(begin, end, climb):
    """The axis of the arc leans by an angle about X; so does the tool. What the tool turns halves, the pitch counts."""
    for angle in np.arange(-60.0, 61.0, 1.7):
        s, c = np.sin(np.radians(angle)), np.cos(np.radians(angle))
        first = ("PTP", 40, 0, 0)
        made = leaning(begin, end, first, arc((40, 0, 0), (0.0, -s, c), (0, 0, 0), 150.0, climb))
        path = toolpath.segments(made, np.eye(4))
        pitch = np.degrees(np.arctan2(climb, 40 * np.radians(150.0)))
        apart = max(abs(angle - begin), abs(angle - end)) + 0.5 * abs(end - begin) + pitch
        if abs(apart - 45.0) > 0.01:
            assert is_arc_across(made, path, np.array([1]), "+Z")[0] == (apart < 45.0)


@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.0), (20.0, 0.0), (0.0, 20.0), (10.0, -10.0)])
def test_lines_run_across_the_spindle_up_to_45_degrees(begin, end):
    for angle in np.arange(-88.0, 89.0, 1.7):
        s, c = np.sin(np.radians(angle)), np.cos(np.radians(angle))
        made = leaning(begin, end, ("PTP", 0, 0, 0), ("LIN", 0, 40 * c, 40 * s))
        path = toolpath.segments(made, np.eye(4))
        # the spindle leans as the tool does, about X: across it the travel would be at the same angle
        nearest = min(90.0 - abs(angle - begin), 90.0 - abs(angle - end)) - 0.5 * abs(end - begin)
        if abs(nearest - 45.0) > 0.01:
            assert is_line_across(made, path, np.array([1]), "+Z")[0] == (nearest > 45.0)


def displaced_circle(load, piece, compliance, shares):
    """Places (n, 3) of the tip on a piece (motion, begin, end), displaced as it gives way to the force."""
    k, begin, end = piece
    made, path = load.axes.program, load.axes.path
    sample = toolpath.at(made, path, np.full(len(shares), k), begin + shares * (end - begin))
    wrench = load.at(sample)
    return sample.pose[:, :3, 3] - compliance[0] * wrench[:, :3] - compliance[1] * wrench[:, 3:]


def missed_by_circle(spots, shares):
    """What the circle through first, middle and last of (n, 3) spots misses at their shares [m]."""
    middle = int(np.flatnonzero(shares == 0.5)[0])
    a, b, c = spots[0], spots[middle], spots[-1]
    normal = np.cross(b - a, c - a)
    rows = np.array([b - a, c - a, normal / np.linalg.norm(normal) * np.linalg.norm(c - a)])
    centre = np.linalg.solve(rows, [(b - a) @ (a + b) / 2, (c - a) @ (a + c) / 2, rows[2] @ a])
    axis = normal / np.linalg.norm(normal)
    sweep = np.arctan2(np.cross(a - centre, c - centre) @ axis, (a - centre) @ (c - centre)) % (2 * np.pi)
    out, side = a - centre, np.cross(axis, a - centre)
    on = centre + np.cos(sweep * shares)[:, None] * out + np.sin(sweep * shares)[:, None] * side
    return np.linalg.norm(spots - on, axis=1).max()


@pytest.mark.parametrize("compliance", [(4e-6, 0.0), (0.0, 5e-6), (2e-6, -2e-6)])
def test_pieces_where_the_force_swings_round_are_halved_until_circles_follow_it(compliance):
    """An arc that comes near the direction of the spindle, and one that does not."""
    moves_ = [("PTP", 50, 0, 0), arc((50, 0, 0), unit(0, -1.0, 0.15), (0, 0, 0), 170.0)]
    made = program([*moves_, ("LIN", -60, 0, 0), arc((-60, 0, 0), (0.0, 0.0, 1.0), (0, 0, 0), 90.0)])
    path = toolpath.segments(made, START)
    knots = Knots.throughout(np.array([1, 3]), np.array([[100.0, 40, 20, 60, -50, 10]] * 2), np.full(2, FEED))
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    found, limit = forces.displacement_estimate(load, (1e-9, 1e-9)), 2e-6
    assert found.swings.tolist() == [False, True, False, False]
    arcs = toolpath.pieces(path, 1e-5, found)
    halved = forces.refined_arcs(load, arcs, found, compliance, limit)
    other = halved.motion == 3
    np.testing.assert_array_equal(halved.number[other], arcs.number[arcs.motion == 3])
    own = halved.take(~other)
    assert len(own.motion) > 8
    assert (own.number == 1).all()
    np.testing.assert_array_equal(own.begin[1:], own.end[:-1])
    assert (own.begin[0], own.end[-1]) == (0.0, 1.0)
    quarters, fine = np.array([0.0, 0.25, 0.5, 0.75, 1.0]), np.linspace(0.0, 1.0, 33)
    for begin, end in zip(own.begin, own.end, strict=True):
        long = (end - begin) * path.length[1] > 1e-7
        if long:
            assert (
                missed_by_circle(displaced_circle(load, (1, begin, end), compliance, quarters), quarters)
                <= limit * 1.001
            )
        # the piece of which it is a half was too long
        width = end - begin
        parent = begin - width if round(begin / width) % 2 else begin
        spots = displaced_circle(load, (1, parent, parent + 2 * width), compliance, quarters)
        if len(own.motion) > 2 and 2 * width <= 0.5:
            assert missed_by_circle(spots, quarters) > limit * 0.999
        if width > 1e-3:
            spots = displaced_circle(load, (1, begin, end), compliance, fine)
            assert missed_by_circle(spots, fine) < 3.0 * limit


@pytest.mark.parametrize("compliance", [(4e-6, 0.0), (0.0, 5e-6), (3e-6, 1e-6)])
def test_lines_that_turn_the_tool_through_the_travel_get_places_where_the_force_swings_round(compliance):
    made = leaning(-70.0, 80.0, ("PTP", 0, 0, 0), ("LIN", 3, 0, 60), ("LIN", 6, 0, 90))
    turning = made.motions.target[:]
    turning[1, :3, :3] = turning[0, :3, :3]
    made = replace(made, motions=replace(made.motions, target=Poses.of(turning)))
    path = toolpath.segments(made, START)
    knots = Knots.throughout(np.array([1, 2]), np.array([[100.0, 40, 20, 60, -50, 10]] * 2), np.full(2, FEED))
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    limit = 3e-6
    motion, t = forces.swing_places(load, compliance, limit)
    assert (np.bincount(motion, minlength=3) > 0).tolist() == [False, False, True]
    places = np.array([0.0, *np.sort(t), 1.0])
    assert (np.diff(places) > 0).all()

    def displaced(shares):
        wrench = load.at(toolpath.at(made, path, np.full(len(shares), 2), shares))
        return np.hstack([compliance[0] * wrench[:, :3], compliance[1] * wrench[:, 3:]])

    for a, b in pairwise(places):
        shares = np.linspace(a, b, 5)
        spots = displaced(shares)
        straight = spots[0] + np.linspace(0, 1, 5)[:, None] * (spots[-1] - spots[0])
        if (b - a) * path.length[2] > 1e-7:
            assert np.linalg.norm(spots - straight, axis=1).max() <= limit * 1.001
        parent = a - (b - a) if round(a / (b - a)) % 2 else a
        shares = np.linspace(parent, parent + 2 * (b - a), 5)
        spots = displaced(shares)
        straight = spots[0] + np.linspace(0, 1, 5)[:, None] * (spots[-1] - spots[0])
        assert np.linalg.norm(spots - straight, axis=1).max() > limit * 0.999


@pytest.mark.parametrize("turn", [0.1, 20.0, 40.0])
def test_lines_across_the_spindle_need_no_places_however_the_force_turns_with_the_tool(turn):
    """The tool turns about the direction of travel: the force turns as fast, and the tool's turn is sampled anyway."""
    made = leaning(-turn, turn, ("PTP", 0, 0, 0), ("LIN", 40, 0, 0))
    path = toolpath.segments(made, START)
    knots = Knots.throughout(np.array([1]), np.array([[100.0, 400, 20, 60, -50, 10]]), np.array([FEED]))
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    motion, t = forces.swing_places(load, (1e-3, 1e-3), 1e-9)
    assert (len(motion), len(t)) == (0, 0)


@pytest.mark.parametrize("size", [50.0, 5000.0])
def test_where_the_force_jumps_pieces_of_an_arc_are_halved_down_to_a_tenth_of_a_micrometre(size):
    """The arc passes the direction of the spindle itself: there the FEED axes turn by half a turn at once."""
    made = program([("PTP", size, 0, 0), arc((size, 0, 0), (0.0, -1.0, 0.0), (0, 0, 0), 250.0)])
    path = toolpath.segments(made, START)
    knots = Knots.throughout(np.array([1]), np.array([[100.0, 0, 0, 0, 0, 0]]), np.array([FEED]))
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    found = forces.displacement_estimate(load, (1e-6, 0.0))
    halved = forces.refined_arcs(load, toolpath.pieces(path, 1e-5, found), found, (1e-6, 0.0), 1e-6)
    width = (halved.end - halved.begin).min()
    smallest = width * min(1.0, path.length[1])
    assert 0.5e-7 < smallest <= 1e-7
    assert (halved.begin[0], halved.end[-1]) == (0.0, 1.0)
    np.testing.assert_array_equal(halved.begin[1:], halved.end[:-1])


@pytest.mark.parametrize("size", [6.0, 3000.0])
def test_where_the_force_jumps_on_a_line_places_are_a_tenth_of_a_micrometre_apart(size):
    made = leaning(-70.0, 80.0, ("PTP", 0, 0, 0), ("LIN", 0, 0, size))  # the tool turns through the travel
    path = toolpath.segments(made, START)
    knots = Knots.along(
        np.array([1, 1]), np.array([0.0, 1.0]), np.array([[100.0, 0, 0, 0, 0, 0]] * 2), np.full(2, FEED)
    )
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    motion, t = forces.swing_places(load, (1e-6, 0.0), 1e-6)
    assert (motion == 1).all()
    smallest = np.diff(np.sort(t)).min() * min(1.0, path.length[1])
    assert 0.25e-7 < smallest <= 1e-7


def test_each_line_on_which_the_force_swings_has_the_places_that_it_has_alone():
    knots = Knots.throughout(np.array([1, 2]), np.array([[100.0, 40, 20, 60, -50, 10]] * 2), np.full(2, FEED))

    def places(first, second):
        made = leaning(-70.0, 80.0, ("PTP", 0, 0, 0), ("LIN", 3, 0, 60), ("LIN", 6, 0, 120))
        target = made.motions.target[:]
        target[0, :3, :3], target[2, :3, :3] = target[second, :3, :3].copy(), target[first, :3, :3].copy()
        made = replace(made, motions=replace(made.motions, target=Poses.of(target)))
        load = forces.assign(made, toolpath.segments(made, START), Given(knots), "+Z", RAMP)
        motion, t = forces.swing_places(load, (4e-6, 1e-6), 3e-6)
        assert len(motion) == len(t)
        return [np.sort(t[motion == k]) for k in (1, 2)]

    both, one, other = places(0, 0), places(0, 1), places(1, 0)
    assert [len(each) > 4 for each in (*both, *one, *other)] == [True, True, False, True, True, False]
    np.testing.assert_array_equal(both[0], other[0])
    np.testing.assert_array_equal(both[1], one[1])


def divided(made, cuts):
    """The program with motions divided at places, each piece a motion of its own, and the targets at their ends."""
    path, m = toolpath.segments(made, START), made.motions
    motion = np.concatenate([np.full(len(each), k) for k, each in enumerate(cuts)])
    t = np.concatenate(cuts)
    pose = toolpath.at(made, path, motion, t).pose
    none = np.full(len(t), -1)
    targets = Targets(
        motion,
        t,
        m.kind[motion],
        pose,
        np.full((len(t), 3), np.nan),
        np.zeros(len(t), bool),
        none,
        none,
        m.blend[motion],
    )
    columns = {name: getattr(m, name)[motion] for name in m.__struct_fields__}
    columns["target"] = Poses.of(pose)
    columns["sweep"] = m.sweep[motion] * (t - targets.begin(np.arange(len(targets))))
    return path, targets, replace(made, motions=replace(m, **columns))


def plain():
    """As `mixed`, but its arcs keep their radius: a piece of such an arc is one too."""
    first = arc((40, 10, 5), unit(1, 2, 3), (10, -20, 45), 250.0, climb=12.0)
    second = arc(first[1:4], unit(-2, 1, 1), (5, 30, -10), 100.0, climb=-7.0)
    moves_ = [("PTP", 40, 10, 5), first, second, ("LIN", 100, -50, 20), ("LIN", 40, 60, -30)]
    made, whole = program(moves_), mixed()
    target = made.motions.target[:]
    target[:, :3, :3] = whole.motions.target[:5, :3, :3]
    motions = replace(made.motions, target=Poses.of(target), base=np.array([0, 0, 0, 1, 1]))
    return replace(made, motions=motions, bases=whole.bases)


@pytest.mark.parametrize("seed", range(6))
def test_forces_that_go_with_a_divided_program_are_those_of_the_program(seed):
    """On each piece: along it where they are given along the motion, at its end where they come up over the ramp."""
    rng, made = np.random.default_rng(seed), plain()
    cuts = [
        np.array([1.0]),
        np.array([0.2, 0.55, 1.0]),
        np.array([0.4, 1.0]),
        np.array([0.1, 0.35, 0.9, 1.0]),
        np.array([1.0]),
    ]
    path, targets, written = divided(made, cuts)
    knots = random_knots(rng, made)
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    arrive = toolpath.tangent(made, path, targets.motion, targets.t)
    wrench = load.at(toolpath.at(made, path, targets.motion, targets.t))
    at_end = forces.target_forces(load, targets, arrive, Runs.of(wrench))
    acts = wrench.any(axis=1)  # every motion turns the tool: forces keep their axes
    np.testing.assert_array_equal(at_end.frame, np.where(acts, load.frame[targets.motion], BASE))
    other = toolpath.segments(written, START)
    row = np.arange(len(targets))
    travel, _ = forces.last_travel(written, other, "+Z")
    found = forces.piece_knots(load, targets, at_end, forces.Axes(written, other, "+Z", travel), row)
    carried = forces.assign(written, other, Given(replace(found, motion=row[found.motion])), "+Z", RAMP)
    for share in (0.03, 0.3, 0.5, 0.81, 1.0):
        sample = toolpath.at(written, other, row, np.full(len(row), share))
        begin = targets.begin(np.arange(len(targets)))
        t = begin + share * (targets.t - begin)
        nominal = toolpath.at(made, path, targets.motion, t)
        np.testing.assert_allclose(sample.pose[:, :3, 3], nominal.pose[:, :3, 3], atol=1e-12)
        expected, have = load.at(nominal), carried.at(sample)
        along = ~load.ramped[targets.motion]
        in_base = load.frame[targets.motion] == BASE
        exact = (along & in_base) | (share == 1.0)
        np.testing.assert_allclose(have[exact], expected[exact], atol=1e-6)
        turns = along & ~in_base  # linear in the axes of the force, as the program has it
        np.testing.assert_allclose(have[turns], expected[turns], atol=1e-5)
        spread, carries = load.spread_at(nominal), carried.spread_at(sample)
        if share == 1.0:  # the deviations of each component, in the axes in which the force is written
            own = load.frame[targets.motion] == carried.frame
            covariance, written_ = (each @ np.swapaxes(each, 2, 3) for each in (spread[own], carries[own]))
            np.testing.assert_allclose(
                np.trace(written_, axis1=2, axis2=3), np.trace(covariance, axis1=2, axis2=3), atol=1e-6
            )


@pytest.mark.parametrize(
    ("frame", "kind", "turn", "written"),
    [
        (BASE, LIN, 0.0, BASE), (BASE, CIRC, 0.0, BASE), (BASE, LIN, 0.1, BASE), (BASE, CIRC, 0.1, BASE),
        (TOOL, LIN, 0.0, BASE), (TOOL, CIRC, 0.0, BASE), (TOOL, LIN, 0.1, TOOL), (TOOL, CIRC, 0.1, TOOL),
        (FEED, LIN, 0.0, BASE), (FEED, CIRC, 0.0, FEED), (FEED, LIN, 0.1, FEED), (FEED, CIRC, 0.1, FEED),
    ],
)  # fmt: skip
def test_forces_keep_their_axes_on_pieces_on_which_these_turn(frame, kind, turn, written):
    """TOOL axes turn with the tool, FEED axes along arcs too; others are constant in `$BASE`."""
    load = SimpleNamespace(
        frame=np.array([0, 1, 2, frame]), axes=SimpleNamespace(path=SimpleNamespace(turn=np.zeros(4)))
    )
    load.axes.path.turn[3] = turn
    targets = SimpleNamespace(motion=np.array([3, 3]), kind=np.array([kind, kind]))
    assert table._piece_frames(load, targets).tolist() == [written] * 2


def test_a_force_that_stays_as_it_is_is_given_once_to_each_piece():
    made = plain()
    path, targets, written = divided(made, [np.array([1.0]), *[np.array([0.5, 1.0])] * 4])
    rng = np.random.default_rng(1)
    wrench, sigma = rng.normal(0.0, 9.0, (4, 6)), rng.uniform(1.0, 2.0, (4, 6))
    motion = np.repeat(np.arange(1, 5), 2)
    columns = [np.repeat(values, 2, axis=0) for values in (wrench, sigma)]
    columns[1][5, 3] += 1.0  # a deviation that changes on the third of them
    knots = Knots.along(motion, np.tile([0.2, 0.8], 4), columns[0], np.repeat([FEED, TOOL, FEED, TOOL], 2), columns[1])
    load = forces.assign(made, path, Given(knots), "+Z", RAMP)
    there = load.at(toolpath.at(made, path, targets.motion, targets.t))
    at_end = forces.target_forces(
        load, targets, toolpath.tangent(made, path, targets.motion, targets.t), Runs.of(there)
    )
    other = toolpath.segments(written, START)
    axes = forces.Axes(written, other, "+Z", forces.last_travel(written, other, "+Z")[0])
    found = forces.piece_knots(load, targets, at_end, axes, np.arange(len(targets)))
    assert np.bincount(found.motion).tolist() == [1, 1, 1, 1, 1, 3, 3, 1, 1]


def test_a_piece_with_one_force_has_that_of_its_target_in_a_file():
    """That of the comment at the same target, to the last digit: both are one record."""
    made = replace(plain(), notes=(ForceNote(1, (50.0, -20.0, 30.0, 1.0, 2.0, 3.0), "TOOL", before=0),))
    path, targets, written = divided(made, [np.array([1.0]), *[np.array([0.5, 1.0])] * 4])
    load = forces.assign(made, path, None, "+Z", RAMP)
    there = load.at(toolpath.at(made, path, targets.motion, targets.t))
    at_end = forces.target_forces(
        load, targets, toolpath.tangent(made, path, targets.motion, targets.t), Runs.of(there)
    )
    at_end = replace(at_end, wrench=at_end.wrench[:] + 1.0)
    other = toolpath.segments(written, START)
    axes = forces.Axes(written, other, "+Z", forces.last_travel(written, other, "+Z")[0])
    found = forces.piece_knots(load, targets, at_end, axes, np.arange(len(targets)))
    assert load.ramped[targets.motion].all()
    np.testing.assert_array_equal(found.wrench, at_end.wrench[found.motion])


def test_on_a_plunge_the_travel_of_another_base_keeps_its_direction_in_the_root():
    """Bases that are turned in all three angles."""
    bases = frames.pose_from_xyzabc([[1500.0, 0, 700, 20, -35, 50], [1400.0, 100, 650, -70, 15, -100]])
    made = program([("PTP", 0, 0, 0), ("LIN", 30, 20, 10), ("LIN", 0, 0, 0)], bases=bases, base=[0, 0, 1])
    target, r = made.motions.target[:], bases[:, :3, :3]
    spindle = unit(0.2, -0.3, -1.0)
    down = np.linalg.qr(np.stack([spindle, (1, 0, 0), (0, 1, 0)], axis=1))[0][:, [1, 2, 0]]
    down *= np.sign(down[:, 2] @ spindle)
    for k in (0, 1):
        target[k, :3, :3] = down
    in_other = np.linalg.inv(bases[1]) @ bases[0] @ target[1]
    target[2] = in_other
    target[2, :3, 3] += 0.02 * in_other[:3, 2]
    made = replace(made, motions=replace(made.motions, target=Poses.of(target)))
    path = toolpath.segments(made, np.eye(4))
    last, needs = forces.last_travel(made, path, "+Z")
    assert needs.tolist() == [True, False, True]
    travel = target[1, :3, 3] - target[0, :3, 3]
    z = -down[:, 2]
    x = travel - (travel @ z) * z
    np.testing.assert_allclose(last[2], r[1].T @ r[0] @ x / np.linalg.norm(x), atol=1e-12)
    np.testing.assert_allclose(last[0], x / np.linalg.norm(x), atol=1e-12)
