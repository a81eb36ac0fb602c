"""Where the path is computed: against circles through displaced points, brute force and loops."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from postproc import toolpath
from postproc.poses import Poses
from postproc.program import SPL, Carriage
from postproc.toolpath import DisplacementEstimate, Pieces
from tests.programs import program
from tests.toolpath.setting import START, arc, mixed, single, swivel, swivelled, turned

TOLERANCE = 1e-5
CERTAIN = 0.2 * TOLERANCE
"""What a piece of an arc may miss by the estimate without being measured."""


def estimate(made, motion=(), t=(), change=(), bent=(), **of_all):
    """A displacement that changes by `change` at places, or is so large on all motions."""
    count = len(made.motions)
    turning, size = (np.full(count, of_all.get(name, 0.0)) for name in ("turning", "size"))
    none = np.zeros(count, dtype=bool)
    columns = np.array(motion, dtype=np.int64), np.array(t, float), np.array(change, float), np.array(bent, dtype=bool)
    return DisplacementEstimate(*columns, turning, size, swings=none)


def arc_of(degrees, radius=50.0, climb=0.0, growth=0.0):
    return program([("PTP", radius, 0, 0), arc((radius, 0, 0), (0.0, 0.0, 1.0), (0, 0, 0), degrees, climb, growth)])


def pieces(made, found, tolerance=TOLERANCE, **options):
    return toolpath.pieces(toolpath.segments(made, START), tolerance, found, **options)


def largest_certain(uncertain, most=1.0):
    """The largest value at which the pieces are taken as they are."""
    return 10 ** brentq(lambda power: 1.0 if uncertain(10**power) else -1.0, -9.0, np.log10(most), xtol=1e-4)


def missed(points):
    """How far a circle through the first, the middle and the last of (n, 3) points misses them at its shares [m]."""
    middle = len(points) // 2
    centre, radial, across, angle = (each[0] for each in toolpath.circle_through(*points[[0, middle, -1], None]))
    turn = (angle * np.linspace(0.0, 1.0, len(points)))[:, None]
    return np.linalg.norm(points - centre - np.cos(turn) * radial - np.sin(turn) * across, axis=1).max()


def circle(degrees, radius=0.05, count=81):
    phi = np.radians(np.linspace(0.0, degrees, count))
    return phi, radius * np.stack([np.cos(phi), np.sin(phi), 0 * phi], axis=1)


@pytest.mark.parametrize(("degrees", "least"), [(30, 1), (60, 1), (119, 1), (121, 2), (200, 2), (300, 3)])
def test_what_turning_and_growing_displacements_miss_is_about_what_circles_miss(degrees, least):
    """By random compliances and directions: of the worst of them the estimate is from 0.85 to 1.5."""
    made, rng = arc_of(degrees), np.random.default_rng(1)
    phi, spots = circle(degrees / least)
    turns = grows = 0.0
    size = 1e-6
    for _ in range(200):
        compliance = rng.normal(size=(3, 3))
        compliance /= np.linalg.norm(compliance, 2)
        force = Rotation.from_rotvec(np.outer(phi, [0, 0, 1])).apply(Rotation.random(random_state=rng).apply([1, 0, 0]))
        turns = max(turns, missed(spots + size * force @ compliance.T) / size)
        direction = Rotation.random(random_state=rng).apply([1, 0, 0])
        grows = max(grows, missed(spots + size * np.linspace(0, 1, len(phi))[:, None] * direction) / size)
    turning = largest_certain(lambda value: pieces(made, estimate(made, turning=value)).uncertain[0])
    assert 0.85 * turns * turning < CERTAIN < 1.5 * turns * turning
    growing = largest_certain(lambda value: pieces(made, estimate(made, [1], [1.0], [value], [False])).uncertain[0])
    assert 0.85 * grows * growing / least < CERTAIN < 1.5 * grows * growing / least
    assert pieces(made, estimate(made)).number.tolist() == [least]
    # a displacement that is large turns over the length of the arm, and grows as the tool turns with it
    for turned_by in (0.0, 40.0):
        target = made.motions.target[:]
        target[1, :3, :3] = target[0, :3, :3] @ Rotation.from_euler("x", turned_by, degrees=True).as_matrix()
        leaning = replace(made, motions=replace(made.motions, target=Poses.of(target)))
        assert largest_certain(
            lambda value, leaning=leaning: pieces(leaning, estimate(leaning, size=value)).uncertain[0]
        ) == pytest.approx(1.0 / (0.05 / turning + np.radians(turned_by) / growing), rel=1e-3)


def test_the_rise_of_a_helix_and_the_growth_of_its_radius_count_as_growing():
    growing = CERTAIN / (0.13 * np.radians(60))
    for name, sign in (("climb", 1), ("climb", -1)):
        found = largest_certain(
            lambda value, name=name, sign=sign: pieces(
                arc_of(60, **{name: sign * value * 1e3}), estimate(arc_of(60))
            ).uncertain[0]
        )
        assert found == pytest.approx(growing, rel=1e-3)
        phi, spots = circle(60)
        spots[:, 2] = found * phi / phi[-1]
        assert missed(spots) < CERTAIN
    for sign in (1, -1):
        found = largest_certain(
            lambda value, sign=sign: pieces(arc_of(60, growth=sign * value), estimate(arc_of(60))).uncertain[0], 0.5
        )
        assert found * 0.05 == pytest.approx(growing, rel=1e-3)
        phi, spots = circle(60)
        spots *= (1 + sign * found * phi / phi[-1])[:, None]
        assert 0.3 < missed(spots) / CERTAIN < 1.2, missed(spots)


@pytest.mark.parametrize(
    ("degrees", "number"), [(40, 2), (90, 2), (91, 4), (180, 4), (181, 6), (270, 6), (300, 8), (350, 8)]
)  # fmt: skip
def test_what_is_uncertain_is_measured_on_an_even_number_of_pieces_of_45_degrees_at_most(degrees, number):
    found = pieces(arc_of(degrees), estimate(arc_of(degrees), turning=1.0))
    assert (found.number.tolist(), found.uncertain.tolist()) == ([number], [True])
    assert found.min_number.tolist() == [int(np.ceil(degrees / 120))]


@pytest.mark.parametrize("tolerance", [1e-5, 4e-5])
@pytest.mark.parametrize("degrees", [20.0, 100.0, 350.0])
def test_arcs_are_sampled_as_closely_as_lines(tolerance, degrees):
    """Every 20 mm at 0.01 mm, with its root; the tool turns by 3° at most; their middle is a sample."""
    for radius, turned_by in ((400.0, 0.0), (5.0, 170.0)):
        made = arc_of(degrees, radius)
        target = made.motions.target[:]
        target[1, :3, :3] = target[0, :3, :3] @ Rotation.from_euler("x", turned_by, degrees=True).as_matrix()
        made = replace(made, motions=replace(made.motions, target=Poses.of(target)))
        found = pieces(made, estimate(made), tolerance)
        length = np.radians(degrees) * radius / 1e3
        most = max(length / (0.02 * np.sqrt(tolerance / 1e-5)), turned_by / 3.0)
        count = int((found.number * found.samples_per_piece)[0])
        assert found.samples_per_piece[0] % 2 == 0
        assert most <= count + 1e-6
        assert count - 2 * found.number[0] < most or found.samples_per_piece[0] == 2
        motion, t = toolpath.places(made, toolpath.segments(made, START), tolerance, estimate(made), found)
        np.testing.assert_allclose(t[motion == 1], np.arange(1, count + 1) / count)
        assert t[-1] == 1.0


def test_chords_in_place_of_arcs_keep_half_the_tolerance():
    for degrees, radius in ((90.0, 50.0), (300.0, 8.0), (10.0, 500.0)):
        made = arc_of(degrees, radius)
        found = pieces(made, estimate(made, turning=1.0), linearize_arcs=True)
        assert not found.uncertain.any()
        needed = found.samples[0]
        sagitta = radius / 1e3 * (1 - np.cos(np.radians(degrees) / needed / 2))
        assert sagitta <= 0.5 * TOLERANCE
        assert sagitta == pytest.approx(0.5 * TOLERANCE, rel=1e-2) or needed == pytest.approx(
            np.radians(degrees) * radius / 20
        )


def test_a_carried_robot_is_sampled_by_how_far_it_is_carried():
    made = arc_of(60.0)
    made = replace(made, carriage=Carriage(np.zeros(2), np.array([0.0, 0.7]), np.array([1.0, 0, 0])))
    assert pieces(made, estimate(made)).samples.tolist() == [35.0]


def random_estimate(rng, count):
    """Places along motions, of which some bend."""
    motion = np.sort(rng.integers(0, count, 40))
    t = np.concatenate([np.sort(rng.uniform(0.05, 0.95, (motion == k).sum())) for k in range(count)])
    t[np.flatnonzero(np.diff(motion, prepend=-1))[::2]] = 0.0
    bent = rng.uniform(size=40) < 0.5
    bent &= t > 0.0
    return motion, t, 10 ** rng.uniform(-7.5, -4.5) * rng.uniform(0.0, 1.0, 40), bent


@pytest.mark.parametrize("seed", range(6))
def test_arcs_are_divided_where_the_force_bends_if_it_changes_enough(seed):
    rng, few = np.random.default_rng(seed), 0
    arcs = arc((40, 10, 5), (0.0, 0.0, 1.0), (10, -20, 5), 250.0), ("LIN", 80, 60, 0)
    made = program([("PTP", 40, 10, 5), *arcs, arc((80, 60, 0), (0.0, 1.0, 0.0), (30, 60, 0), 100.0)])
    count, path = len(made.motions), toolpath.segments(made, START)
    for _ in range(20):
        motion, t, change, bent = random_estimate(rng, count)
        found = pieces(made, estimate(made, motion, t, change, bent, turning=1e-9))
        expected = []
        for k in np.flatnonzero(made.motions.kind == 1).tolist():
            own = motion == k
            noticed = change[own].sum() > 0.1 * TOLERANCE
            few += not noticed
            bounds = [0.0, *(t[own & bent] if noticed else []), 1.0]
            steps = list(zip(t[own], change[own], strict=True)) if noticed else []
            for a, b in itertools.pairwise(bounds):
                grown = sum(value for place, value in steps if a < place <= b)
                angle = (b - a) * made.motions.sweep[k]
                least = np.ceil(angle / np.radians(120))
                miss = 0.2 * angle**2 * 1e-9 + 0.13 * angle * grown
                expected.append((k, a, b, miss / least**2 > CERTAIN))
        np.testing.assert_array_equal(found.motion, [row[0] for row in expected])
        np.testing.assert_allclose(found.begin, [row[1] for row in expected])
        np.testing.assert_allclose(found.end, [row[2] for row in expected])
        np.testing.assert_array_equal(found.uncertain, [row[3] for row in expected])
        # an arc that is longer than 20 mm at 3° a sample has its share of them
        whole = path.length[found.motion] / 0.02
        np.testing.assert_allclose(found.samples, (found.end - found.begin) * whole)
    assert few > 0


def test_places_of_lines_and_what_is_added_to_them():
    moves = [
        ("PTP", 0, 0, 0), ("LIN", 250, 0, 0), ("LIN", 250, 40, 0), ("RAPID", 0, 40, 0), ("LIN", 0, 300, 0),
        ("LIN", 0, 310, 0),
    ]  # fmt: skip
    made = program(moves)
    target = made.motions.target[:]
    target[5, :3, :3] = target[4, :3, :3] @ Rotation.from_euler("y", 40, degrees=True).as_matrix()
    made = replace(made, motions=replace(made.motions, kind=np.array([2, 0, 0, 0, SPL, 0]), target=Poses.of(target)))
    path = toolpath.segments(made, START)
    none = estimate(made)
    no_arcs = toolpath.pieces(path, TOLERANCE, none)
    for tolerance, counts in ((1e-5, [1, 13, 2, 13, 1, 14]), (4e-5, [1, 7, 1, 7, 1, 14])):
        motion, t = toolpath.places(made, path, tolerance, none, no_arcs)
        np.testing.assert_array_equal(np.bincount(motion), counts)
        np.testing.assert_allclose(t, np.concatenate([np.arange(1, n + 1) / n for n in counts]))
    # where the force bends on lines, and further places; those that are there already are there once
    bends = estimate(made, [1, 1, 2, 3], [0.0401, 0.5, 1.0, 0.33], [1e-6] * 4, [True, False, True, True])
    also = np.array([2, 2, 1]), np.array([0.5, 0.6, 2 / 13 + 1e-10])
    motion, t = toolpath.places(made, path, TOLERANCE, bends, no_arcs, also)
    expected = {1: [0.0401], 2: [0.6], 3: [0.33]}
    for k, n in enumerate([1, 13, 2, 13, 1, 14]):
        np.testing.assert_allclose(
            t[motion == k], np.sort([*(np.arange(1, n + 1) / n), *expected.get(k, [])]), atol=2e-10
        )
    carried = replace(made, carriage=Carriage(np.zeros(6), np.array([0, 0, 0.41, 0, 0, 0]), np.array([1.0, 0, 0])))
    motion, _ = toolpath.places(carried, toolpath.segments(carried, START), TOLERANCE, none, no_arcs)
    np.testing.assert_array_equal(np.bincount(motion), [1, 13, 21, 13, 1, 14])


def test_places_of_arcs_are_those_of_their_pieces():
    made = mixed()
    path = toolpath.segments(made, START)
    arcs = Pieces(
        np.array([1, 1, 2, 6]), np.array([0.0, 0.3, 0.0, 0.0]), np.array([0.3, 1.0, 1.0, 1.0]), np.array([3, 1, 2, 1]),
        np.ones(4, dtype=np.int64), np.array([5.0, 2.0, 14.0, 0.5]), np.zeros(4, dtype=bool),
    )  # fmt: skip
    motion, t = toolpath.places(made, path, TOLERANCE, estimate(made), arcs)
    np.testing.assert_allclose(t[motion == 1], [*(0.3 * np.arange(1, 7) / 6), 0.65, 1.0])
    np.testing.assert_allclose(t[motion == 2], np.arange(1, 17) / 16)
    np.testing.assert_allclose(t[motion == 6], [0.5, 1.0])
    assert (np.lexsort((t, motion)) == np.arange(len(t))).all()
    assert (t[np.diff(motion, append=9) != 0] == 1.0).all()


def random_pieces(rng, count=8):
    motion = np.repeat(np.arange(count), rng.integers(1, 4, count))
    inner = [np.sort(rng.uniform(0.1, 0.9, (motion == k).sum() - 1)) for k in range(count)]
    begin = np.concatenate([np.append(0.0, each) for each in inner])
    end = np.concatenate([np.append(each, 1.0) for each in inner])
    number, least = rng.integers(1, 9, len(motion)), rng.integers(1, 4, len(motion))
    samples, uncertain = rng.uniform(0.1, 40.0, len(motion)), rng.uniform(size=len(motion)) < 0.5
    return Pieces(motion, begin, end, number, least, samples, uncertain)


@pytest.mark.parametrize("seed", range(5))
def test_pieces_cut_joined_settled_and_made_finer(seed):
    rng = np.random.default_rng(seed)
    arcs = random_pieces(rng)
    assert (arcs.samples_per_piece % 2 == 0).all()
    assert (arcs.samples_per_piece * arcs.number >= arcs.samples - 1e-6).all()
    assert ((arcs.samples_per_piece == 2) | ((arcs.samples_per_piece - 2) * arcs.number < arcs.samples)).all()
    wanted = rng.integers(1, 6, len(arcs.motion))
    settled = arcs.with_enough_pieces(wanted)
    np.testing.assert_array_equal(settled.number, np.maximum(wanted, arcs.min_number))
    assert not settled.uncertain.any()
    parts = rng.integers(1, 5, len(arcs.motion))
    cut, row = arcs.divided(parts), 0
    for k, n in enumerate(parts.tolist()):
        bounds = np.linspace(arcs.begin[k], arcs.end[k], n + 1)
        for i in range(n):
            assert cut.motion[row] == arcs.motion[k]
            assert (cut.begin[row], cut.end[row]) == (pytest.approx(bounds[i]), pytest.approx(bounds[i + 1]))
            assert cut.end[row] == (arcs.end[k] if i == n - 1 else cut.begin[row + 1])
            assert cut.number[row] == -(-arcs.number[k] // n)
            assert cut.min_number[row] == -(-arcs.min_number[k] // n)
            assert (cut.samples[row], cut.uncertain[row]) == (arcs.samples[k] / n, arcs.uncertain[k])
            row += 1
    assert row == len(cut.motion)
    mixed_up = rng.permutation(len(cut.motion))
    back = type(cut).join([cut.take(mixed_up[:5]), cut.take(mixed_up[5:9]), cut.take(mixed_up[9:])]).sort()
    for name in Pieces.__struct_fields__:
        np.testing.assert_array_equal(getattr(back, name), getattr(cut, name))


@pytest.mark.parametrize("seed", range(5))
def test_only_the_piece_on_which_the_path_was_missed_is_divided(seed):
    rng = np.random.default_rng(seed)
    arcs = random_pieces(rng)
    at = rng.choice(len(arcs.motion), 3, replace=False)
    share = rng.integers(0, arcs.number[at]) + rng.uniform(0.1, 1.0, 3)
    t = arcs.begin[at] + (arcs.end - arcs.begin)[at] * share / arcs.number[at]
    order = np.argsort(arcs.motion[at] + t)
    parts = rng.integers(2, 5, 3)
    finer = arcs.refined_at(arcs.motion[at][order], t[order], parts[order])
    expected = []
    for k in range(len(arcs.motion)):
        if k not in at:
            expected.append((arcs.begin[k], arcs.end[k], max(arcs.number[k], arcs.min_number[k])))
            continue
        i = int(np.flatnonzero(at == k)[0])
        bounds = np.linspace(arcs.begin[k], arcs.end[k], arcs.number[k] + 1)
        least = -(-arcs.min_number[k] // arcs.number[k])
        for j in range(arcs.number[k]):
            hit = bounds[j] < t[i] <= bounds[j + 1]
            expected.append((bounds[j], bounds[j + 1], max(parts[i] if hit else 1, least)))
    np.testing.assert_allclose(np.stack([finer.begin, finer.end, finer.number], axis=1), expected, atol=1e-12)
    assert not finer.uncertain.any()


def test_lines_on_rotary_axes_are_divided_until_the_tool_leans_less_than_the_tolerance():
    """10 cm up the tool, between one rotation and what the axes do; no piece turns it by more than 60°."""
    made = single(mixed())
    angles = np.array([(0, 10), (10, 20), (40, 15), (20, 50), (30, 10), (5, 40), (170, 40), (200, 10)], dtype=float)
    made = replace(made, motions=replace(made.motions, kind=np.array([2, 0, 0, 0, 0, 0, 1])))
    axes = swivel(made, "CB", angles)
    target = made.motions.target[:]
    for k in range(len(target)):
        target[k, :3, :3] = axes.frames[axes.frame[k]] @ swivelled(made, "CB", angles[k + 1])
    made = replace(made, motions=replace(made.motions, target=Poses.of(target)), swivel=axes)
    path = toolpath.segments(made, START)
    for tolerance in (1e-5, 1e-4, 1.0):
        found = toolpath.swivel_pieces(made, path, tolerance)
        assert found[0] == found[6] == 1
        for k in range(2, 6):  # the first line starts elsewhere than its axes

            def leaned(pieces, k=k):
                at = [
                    axes.frames[axes.frame[k]] @ swivelled(made, "CB", angles[k] + s * (angles[k + 1] - angles[k]))
                    for s in np.linspace(0.0, 1.0, 8 * pieces + 1)
                ]
                worst = 0.0
                for j in range(pieces):
                    ends = [np.eye(4), np.eye(4)]
                    ends[0][:3, :3], ends[1][:3, :3] = at[8 * j], at[8 * j + 8]
                    for i in range(1, 8):
                        apart = turned(*ends, i / 8).T @ at[8 * j + i]
                        worst = max(worst, Rotation.from_matrix(apart).magnitude())
                return worst * 0.1

            by_turn = int(np.ceil(axes.travel[k] / np.radians(60)))
            assert found[k] >= by_turn
            if tolerance == 1.0:
                assert found[k] == by_turn
            elif by_turn == 1:
                assert leaned(found[k]) < 1.1 * tolerance
                assert leaned(found[k] - 1) > 0.9 * tolerance
        motion, _ = toolpath.places(made, path, 1e-5, estimate(made), toolpath.pieces(path, 1e-5, estimate(made)))
        assert (np.bincount(motion)[1:6] >= toolpath.swivel_pieces(made, path, 1e-5)[1:6]).all()
    assert (toolpath.swivel_pieces(made, path, 1e-5) > toolpath.swivel_pieces(made, path, 1e-4)).any()
    assert (toolpath.swivel_pieces(mixed(), toolpath.segments(mixed(), START), 1e-9) == 1).all()
