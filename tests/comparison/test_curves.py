"""Both paths between pairs, against lines, arcs and rotations written out here with scipy alone.

The programs have frames of their own, turned and displaced, and turn the tool along lines.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation, Slerp

from postproc import frames
from postproc.comparison.differences import _distance_on_stretch, _inserted_rotations
from postproc.comparison.loaded_path import Stretches
from postproc.comparison.partners import pair_targets
from postproc.comparison.paths import Chain, Curves, PlacedProgram, nearest
from postproc.poses import Poses
from postproc.program import CIRC, PTP
from postproc.under_load import RobotInCell
from tests.comparison.test_named import CELL, ROBOT
from tests.kr270 import FOLDER
from tests.oracle.arm import Arm
from tests.programs import program

PLACE = RobotInCell.of(ROBOT, CELL)
DOWN = Rotation.from_euler("x", 180, degrees=True)


class Path:
    """A program made of its moves (mm), and its poses by formulas.

    :param turned: rotation vector [deg] of each target, before the tool points down.
    """

    def __init__(self, moves, turned=None, base=(1500, -200, 700, 0, 0, 0), tool=(0, 0, 350, 0, 0, 0)):
        self.moves = moves
        self.turned = Rotation.from_rotvec(np.radians(np.zeros((len(moves), 3)) if turned is None else turned)) * DOWN
        self.base, self.tool = frames.pose_from_xyzabc(list(base)), frames.pose_from_xyzabc(list(tool))
        made = program(moves, bases=self.base[None], tools=self.tool[None])
        pose = made.motions.target[:]
        pose[:, :3, :3] = self.turned.as_matrix()
        made = replace(made, motions=replace(made.motions, target=Poses.of(pose)))
        self.placed = PlacedProgram.of(made, PLACE)

    def length(self, k):
        """Length of move k > 0 [m]."""
        move = self.moves[k]
        a, b = (np.array(self.moves[n][1:4]) / 1e3 for n in (k - 1, k))
        return math.radians(move[7]) * math.dist(b, np.array(move[4:7]) / 1e3) if move[0] == "CIRC" else math.dist(a, b)

    def pose(self, k, t):
        """Pose of the tool in the base, on move k > 0."""
        move, out = self.moves[k], np.eye(4)
        a, b = (np.array(self.moves[n][1:4]) / 1e3 for n in (k - 1, k))
        out[:3, 3] = a + t * (b - a)
        if move[0] == "CIRC":
            centre, axis = np.array(move[4:7]) / 1e3, np.array(move[8], dtype=float)
            turn = Rotation.from_rotvec(t * math.radians(move[7]) * axis / np.linalg.norm(axis))
            out[:3, 3] = centre + turn.apply(a - centre)
        out[:3, :3] = Slerp([0, 1], self.turned[[k - 1, k]])(t).as_matrix()
        return out

    def flange(self, k, t):
        return self.base @ self.pose(k, t) @ np.linalg.inv(self.tool)


def place_at(path, paired, u):
    """Move and share of the way to a pair, at u: by length from pair to pair."""
    pair = max(1, math.ceil(u - 1e-12))
    first, last = paired[pair - 1] + 1, paired[pair]
    length = [path.length(k) for k in range(first, last + 1)]
    left = (u - (pair - 1)) * sum(length)
    for k, each in zip(range(first, last + 1), length, strict=True):
        if left <= each + 1e-12:
            return k, min(left / each, 1.0)
        left -= each
    return last, 1.0


ONE = [
    ("LIN", 0, 0, 0), ("LIN", 40, 0, 2), ("LIN", 20, 30, 4), ("CIRC", 40, 50, 4, 40, 30, 4, 90.0, (0, 0, -1)),
    ("LIN", 10, 60, 0), ("LIN", 30, 80, 5), ("LIN", 80, 80, 5),
]  # fmt: skip
TWO = [
    ("LIN", 0.3, -0.2, 0.1), ("LIN", 15, 2, 0.5), ("LIN", 40, 1, 2.5), ("LIN", 20.4, 30, 4),
    ("CIRC", 40.4, 50, 4, 40.4, 30, 4, 90.0, (0, 0, -1)), ("LIN", 33, 52, 3), ("LIN", 29, 80.5, 5.5),
    ("LIN", 81, 79, 5),
]  # fmt: skip
PAIRS = np.array([[0, 0], [1, 2], [2, 3], [3, 4], [5, 6], [6, 7]])
TURNED = [[0, 0, 0], [3, 1, 0], [3, 1, -8], [3, 1, -8], [0, 0, 5], [2, 2, 2], [-3, 0, 0]]
ALSO = [[0, 0, 0], [2, 0, 0], [3, 1, 0], [3, 1, -8], [3, 1, -8], [0, 0, 4], [2, 2, 3], [-3, 0, 0]]
BASE, TOOL = (1480, -190, 720, 5, -3, 2), (10, -20, 380, 15, 4, -6)


def corners(path, paired):
    """The u at which a move ends between pairs."""
    for pair in range(1, len(paired)):
        length = [path.length(k) for k in range(paired[pair - 1] + 1, paired[pair] + 1)]
        yield from pair - 1 + np.cumsum(length) / sum(length)


def seen(one, other, pairs, u):
    """Where both send the nominal tool, in the nominal base: (2, 3)."""
    (k, t), (row, share) = (place_at(path, pairs[:, n], u) for n, path in enumerate((one, other)))
    there = np.linalg.inv(one.base) @ other.flange(row, share) @ one.tool
    return np.stack([one.pose(k, t)[:3, 3], there[:3, 3]])


@pytest.mark.parametrize(
    "frames_of_second", [{}, {"base": BASE}, {"tool": TOOL}, {"base": BASE, "tool": TOOL}], ids=str
)
def test_both_programs_send_the_nominal_tool_where_frames_and_lengths_say(frames_of_second):
    one, other = Path(ONE, TURNED), Path(TWO, ALSO, **frames_of_second)
    curves = Curves.of(one.placed, other.placed, PAIRS)
    u = np.concatenate([np.linspace(0.013, 5.0, 40), [1.0, 2.0, 3.0, 4.0, 5.0]])
    expected = np.array([seen(one, other, PAIRS, each) for each in u])
    np.testing.assert_allclose(np.stack(curves.at(u), axis=1), expected, atol=1e-9)
    inside = (one.base[:3, :3] @ expected[:, 1].T).T + one.base[:3, 3]
    np.testing.assert_allclose(curves.second_points_in_cell(u), inside, atol=1e-9)
    largest = np.zeros(6)
    for each in [
        *np.arange(5) + 1e-9,
        *np.linspace(0.05, 5.0, 100),
        *corners(one, PAIRS[:, 0]),
        *corners(other, PAIRS[:, 1]),
    ]:
        pair = math.ceil(each - 1e-12)
        largest[pair] = max(largest[pair], np.linalg.norm(np.diff(seen(one, other, PAIRS, each), axis=0)))
    found = curves.largest_gaps()
    assert np.isnan(found[0])
    np.testing.assert_allclose(found[1:], largest[1:], rtol=1e-3)


def test_ways_by_ptp_are_unknown_in_either_program():
    pairs = np.stack([np.arange(7)] * 2, axis=1)
    for row in (1, 4, 6):
        joint = [("PTP", *move[1:4]) if k == row else move for k, move in enumerate(ONE)]
        for sides in ((ONE, joint), (joint, ONE)):
            curves = Curves.of(*(Path(moves).placed for moves in sides), pairs)
            assert np.flatnonzero(np.isnan(curves.largest_gaps())).tolist() == [0, row]
    few = pairs[[0, 2, 6]]  # an inner motion on the way is enough
    one, other = Path(ONE).placed, Path([("PTP", *m[1:4]) if k == 5 else m for k, m in enumerate(ONE)]).placed
    assert np.flatnonzero(np.isnan(Curves.of(one, other, few).largest_gaps())).tolist() == [0, 2]
    assert Curves.of(one, other, pairs[:1]) is None


def test_arcs_are_drawn_by_a_chord_for_each_angle():
    """Quarter and half circle on one way: 270°; the other program has a quarter there. A line is one chord."""
    half = ("CIRC", 60, 30, 4, 40, 30, 4, 180.0, (0, 0, 1))
    moves = [("LIN", 20, 30, 4), ONE[3], ("LIN", 20, 30, 4), half, ("LIN", 0, 0, 0)]
    one, other = Path(moves).placed, Path([*moves[:3], ("LIN", 60, 30, 4), moves[4]]).placed
    pairs = np.array([[0, 0], [3, 3], [4, 4]])
    for sides in ((one, other), (other, one)):
        curves = Curves.of(*sides, pairs)
        assert curves.parts(math.radians(10)).tolist() == [1, 27, 1]
        assert curves.parts(math.radians(7)).tolist() == [1, 39, 1]
        assert curves.nominal_chain.any_between(np.arange(5) == 1).tolist() == [False, True, False]
        assert curves.corrected_chain.any_between(np.arange(5) == 4).tolist() == [False, False, True]
    three = np.array([[0, 0], [1, 1], [3, 3], [4, 4]])
    assert Curves.of(one, other, three).parts(math.radians(10)).tolist() == [1, 9, 18, 1]


def test_the_largest_distance_inside_a_piece_is_found_wherever_it_is():
    """Distances that fall off from their largest one evenly, at other shares of pieces of different lengths."""
    share = np.append(np.linspace(0.001, 0.999, 41), [0.93, 0.97])
    begin = 2.0 * np.arange(len(share))
    end = begin + np.linspace(0.1, 1.0, len(share))
    top = begin + share * (end - begin)

    def distance(u):
        return 0.5 - np.abs(u - top[np.floor(u / 2.0).astype(int)])

    largest = Curves._largest(SimpleNamespace(_distance=distance), begin, end)
    assert (largest <= 0.5).all()
    np.testing.assert_allclose(largest, 0.5, atol=1.0 / 8 / 4**3)  # eighths of the piece, then thrice a quarter of that


def test_a_chain_begins_behind_the_first_pair_and_ends_with_the_last():
    chain = Chain.of(Path(ONE).placed, np.array([1, 3, 5]))
    path = Path(ONE)
    length = np.array([path.length(k) for k in range(2, 6)])
    ends = [length[0] / length[:2].sum(), 1.0, 1.0 + length[2] / length[2:].sum(), 2.0]
    assert chain.row.tolist() == [2, 3, 4, 5]
    np.testing.assert_allclose(chain.end, ends, rtol=1e-12)
    np.testing.assert_allclose(chain.begin, [0.0, *ends[:-1]], rtol=1e-12)
    motion, t = chain.at(np.array([ends[0] / 4, ends[0], (ends[0] + 1.0) / 2, 1.0, 2.0]))
    assert motion.tolist() == [2, 2, 3, 3, 5]
    np.testing.assert_allclose(t, [0.25, 1.0, 0.5, 1.0, 1.0], rtol=1e-12)


def test_places_of_a_program_are_its_lengths_and_targets():
    """A motion that only turns the tool has a length of its own: 1 mm per radian, 0.1 mm at least."""
    moves = [*ONE[:3], ("LIN", 20, 30, 4), ("LIN", 20, 30, 4), *ONE[3:]]
    turned = np.zeros((9, 3))
    turned[3:, 2] = 30.0
    turned[4:, 2] = 31.0
    path = Path(moves, turned, base=BASE)
    side = path.placed
    assert len(side.arc_length) == 10
    size = np.diff(side.arc_length)
    expected = [path.length(k) for k in range(1, 9)]
    expected[2], expected[3] = math.radians(30.0) * 1e-3, 1e-4
    np.testing.assert_allclose(size[1:], expected, rtol=1e-9)
    np.testing.assert_allclose(side.size, size, rtol=1e-9)
    where = np.array(
        [
            side.arc_length[2] + 0.3 * size[2],
            side.arc_length[4],
            side.arc_length[5] + 0.5 * size[5],
            side.arc_length[-1],
        ]
    )
    motion, t = side.at(where)
    assert motion.tolist() == [2, 3, 5, 8]
    np.testing.assert_allclose(t, [0.3, 1.0, 0.5, 1.0], rtol=1e-9)
    in_root = [path.base @ path.pose(k, each) for k, each in zip(motion.tolist(), t.tolist(), strict=True)]
    np.testing.assert_allclose(side.points(where), [pose[:3, 3] for pose in in_root], atol=1e-12)
    track = side.track()
    targets = [(path.base @ np.append(np.array(move[1:4]) / 1e3, 1.0))[:3] for move in moves]
    np.testing.assert_allclose(track.position, targets, atol=1e-12)
    np.testing.assert_allclose(track.step[1:], [path.length(k) for k in range(1, 9)], atol=1e-12)
    offset = np.random.default_rng(1).normal(size=(9, 3)) * 1e-3
    moved = side.track(offset).position - track.position
    np.testing.assert_allclose(moved, offset @ path.base[:3, :3].T, atol=1e-12)


def test_a_track_has_the_distance_as_step_of_a_ptp():
    moves = [("PTP", *ONE[0][1:]), *ONE[1:3], ("PTP", *ONE[3][1:4]), *ONE[4:]]
    track = Path(moves).placed.track()
    assert track.joint.tolist() == [True, False, False, True, False, False, False]
    assert track.step[3] == pytest.approx(math.hypot(20, 20) * 1e-3)
    assert [move[0] == "PTP" for move in moves] == (Path(moves).placed.program.motions.kind == PTP).tolist()
    assert (Path(ONE).placed.program.motions.kind == CIRC).tolist() == [move[0] == "CIRC" for move in ONE]


def test_joints_at_a_place_bring_the_flange_there():
    path = Path(ONE, TURNED, base=BASE, tool=TOOL)
    motion, t = np.array([1, 3, 4, 6]), np.array([0.3, 0.5, 1.0, 0.01])
    found = path.placed.joints_at(motion, t)
    arm = Arm.load(FOLDER)
    for q, k, share in zip(found, motion.tolist(), t.tolist(), strict=True):
        np.testing.assert_allclose(arm.tcp(q, np.eye(4)), path.flange(k, share), atol=1e-9)


def test_the_nearest_place_of_a_curve_is_that_of_many():
    """A helix, points inside and outside of it, each with limits of its own."""
    random = np.random.default_rng(4)

    def helix(length):
        return np.stack([np.cos(length), np.sin(length), 0.3 * length], axis=-1)

    begin, end = random.uniform(0, 2, 30), random.uniform(2.5, 5, 30)
    wanted = helix(random.uniform(0, 6, 30)) * random.uniform(0.3, 1.7, (30, 1)) + random.normal(size=(30, 3)) * 0.1
    place, distance = nearest(lambda _, length: helix(length), wanted, begin, end)
    tried = begin[:, None] + (end - begin)[:, None] * np.linspace(0, 1, 4001)
    apart = np.linalg.norm(helix(tried) - wanted[:, None], axis=2)
    np.testing.assert_allclose(distance, apart.min(axis=1), atol=1e-6)
    np.testing.assert_allclose(place, tried[np.arange(30), apart.argmin(axis=1)], atol=2e-3)
    assert ((place >= begin) & (place <= end)).all()
    np.testing.assert_allclose(np.linalg.norm(helix(place) - wanted, axis=1), distance, atol=1e-12)


def test_ways_begin_at_the_start_or_behind_the_pair_before_and_end_with_their_own():
    """In both programs; the first way has targets of the second program before its pair."""
    one, other = Path(ONE).placed, Path(TWO).placed
    pair = np.array([[1, 2], [2, 3], [5, 6]])
    found = SimpleNamespace(pair=pair)
    ways = Stretches.from_pairs(found, one, other)
    np.testing.assert_array_equal(ways.begin, [0.0, one.arc_length[2], one.arc_length[3]])
    np.testing.assert_array_equal(ways.end, one.arc_length[[2, 3, 6]])
    np.testing.assert_array_equal(
        ways.corrected_span, [[0.0, other.arc_length[3]], other.arc_length[[3, 4]], other.arc_length[[4, 7]]]
    )
    assert ways.stretch.tolist() == [0, 0, 0, 1, 2, 2, 2, 3]
    share = other.arc_length[2] / other.arc_length[3]
    np.testing.assert_allclose(ways.guessed_lengths(np.array([1])), share * one.arc_length[2])
    assert ways.begin_lengths(np.array([0, 3]), np.arange(8) * 1.0).tolist() == [0.0, 2.0]


@pytest.mark.parametrize(("inside", "found"), [(0.6, 0.0), (0.65, 0.0), (0.2, 0.0)])
def test_what_inserted_targets_are_off_is_no_distance_of_the_way(inside, found):
    """Pairs are 0.2 mm off, so that inserted targets may be 0.7 mm off: the path through them is not off it."""
    one = Path([("LIN", 0, 0, 0), ("LIN", 80, 0, 0), ("LIN", 80, 40, 0)]).placed
    other = Path([("LIN", 0, 0.2, 0), ("LIN", 40, inside, 0), ("LIN", 80, 0.2, 0), ("LIN", 80, 40.2, 0)]).placed
    made = pair_targets(one, other, np.array([0, 2, 3]), np.ones(3, dtype=bool))
    assert made.inserted_rows.tolist() == [1]
    assert _distance_on_stretch(made, one, other, 1) == found
    bulge = [
        ("LIN", 0, 0.2, 0),
        ("LIN", 20, 0.2, 0),
        ("CIRC", 60, 0.2, 0, 40, 0.2, 0, 180.0, (0, 0, -1)),
        ("LIN", 80, 0.2, 0),
    ]
    other = Path([*bulge, ("LIN", 80, 40.2, 0)]).placed
    made = pair_targets(one, other, np.array([0, 3, 4]), np.ones(3, dtype=bool))
    assert made.inserted_rows.tolist() == [1, 2]
    assert _distance_on_stretch(made, one, other, 1) == pytest.approx(20.2e-3, abs=2e-5)


@pytest.mark.parametrize("targets_before", [0, 1, 5])
@pytest.mark.parametrize(("bulge", "distance"), [(1.2, 0.0), (1.6, 2.2e-3)])
def test_a_way_is_judged_by_its_own_inserted_targets_wherever_it_is_in_the_program(targets_before, bulge, distance):
    """They are 0.6 mm off, so that the arc between them may be 0.1 + 3 · 0.6 mm off; those before it are 0.2 mm off."""
    begin = [("LIN", x, 0.2, 0) for x in np.linspace(-60, -10, 7 + targets_before)]
    radius = (20.0**2 + bulge**2) / (2.0 * bulge)
    sweep = 2.0 * math.degrees(math.asin(20.0 / radius))
    middle = ("CIRC", 60, 0.6, 0, 40, 0.6 + bulge - radius, 0, sweep, (0, 0, -1))
    nominal = [("LIN", x, y, 0) for x, y in ((begin[targets_before][1], 0), (-10, 0), (0, 0), (80, 0), (80, 40))]
    one = Path(nominal).placed
    end = [("LIN", 80, 0.2, 0), ("LIN", 80, 40.2, 0)]
    other = Path([*begin, ("LIN", 0, 0.2, 0), ("LIN", 20, 0.6, 0), middle, *end]).placed
    last = len(begin)
    partner = np.array([targets_before, last - 1, last, last + 3, last + 4])
    made = pair_targets(one, other, partner, np.ones(5, dtype=bool))
    assert made.inserted_rows.tolist()[-2:] == [last + 1, last + 2]
    assert _distance_on_stretch(made, one, other, 3) == pytest.approx(distance, abs=2e-5)


@pytest.mark.parametrize("frames_of_second", [{}, {"base": BASE, "tool": TOOL}], ids=str)
def test_inserted_targets_turn_the_tool_by_more_than_the_pairs_next_to_them(frames_of_second):
    """From the orientation at the same share of the nominal way; a target before the first pair has none."""
    pairs = np.array([[1, 2], [2, 3], [3, 4], [5, 6], [6, 7]])
    one, other = Path(ONE, TURNED), Path(TWO, ALSO, **frames_of_second)
    rotation = np.radians([0.1, 0.5, 0.2, 0.05, 0.3])
    comparison = SimpleNamespace(
        cuts=None, pair=pairs, rotation=rotation, inserted_rows=np.array([1, 5]),
        curves=Curves.of(one.placed, other.placed, pairs),
    )  # fmt: skip
    rows, angles = _inserted_rotations(comparison, one.placed, other.placed)
    share = other.length(5) / (other.length(5) + other.length(6))
    k, t = place_at(one, pairs[:, 0], 2.0 + share)
    commanded = np.linalg.inv(one.base) @ other.flange(5, 1.0) @ one.tool
    turned = Rotation.from_matrix(one.pose(k, t)[:3, :3].T @ commanded[:3, :3]).magnitude()
    assert rows.tolist() == [5]
    np.testing.assert_allclose(angles, [turned - np.radians(0.2)], atol=1e-9)
    for field, value in (("curves", None), ("inserted_rows", np.array([1]))):
        rows, angles = _inserted_rotations(
            SimpleNamespace(**vars(comparison) | {field: value}), one.placed, other.placed
        )
        assert (len(rows), len(angles)) == (0, 0)
