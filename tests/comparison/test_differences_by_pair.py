"""Differences of random programs pair by pair: which are reported, at which place, with which number and how often."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import frames
from postproc.comparison import differences, settings
from postproc.comparison.result import Cuts
from postproc.correction.targets import Corners
from postproc.errors import Issue
from postproc.program import CIRC, LIN, PTP, SPL, Carriage, ForceNote
from tests.comparison.test_parts import compared
from tests.programs import program

SEEDS = range(14)
TOLERANCE = 1e-4
MAX_CORRECTION_MM = 0.3
CELL = SimpleNamespace(output=SimpleNamespace(max_correction_mm=MAX_CORRECTION_MM))
SIDE = SimpleNamespace(robot_in_cell=SimpleNamespace(tolerance=TOLERANCE, cell=CELL))
COUNT = 12
LAYOUT = SimpleNamespace(places=lambda rows: None)
"""Of a program that keeps its text; its lines are those of its motions."""


def random_pairs(rng, **fields):
    """Two programs of twelve motions; eight of each are pairs."""
    nominal = program([("LIN" if rng.random() < 0.7 else "RAPID", 10 * k, 0, 0) for k in range(COUNT)])
    corrected = program([("LIN", 10 * k, 0, 0) for k in range(COUNT)])
    pair = np.stack([np.sort(rng.choice(COUNT, 8, replace=False)) for _ in range(2)], axis=1)
    rest = np.setdiff1d(np.arange(COUNT), pair[:, 1])
    is_inserted = (rng.random(len(rest)) < 0.6) & (rest < pair[-1, 1])
    fields = {"inserted_rows": rest[is_inserted], "additional_rows": rest[~is_inserted]} | fields
    fields.setdefault("pose", nominal.motions.target[pair[:, 0]])
    return compared(nominal, corrected, pair, **fields)


def cuts_of(rng, comparison, **fields):
    """Random places between pairs, among them the ends of inserted targets."""
    count, n = len(comparison.pair), 20
    row = np.sort(rng.integers(0, COUNT, n))
    t = rng.choice([0.3, 0.7, 1.0], n)
    values = {
        "wrench": rng.normal(0.0, 100.0, (count, 6)), "nominal": np.zeros((count, 3)),
        "corrected_deviation": rng.normal(0.0, 1e-4, (count, 3)), "rotation": rng.uniform(0.0, 2e-3, count),
        "row": row, "t": t, "nominal_distance": np.zeros(n), "corrected_distance": rng.uniform(0.0, 5e-4, n),
        "path_rotation": rng.uniform(0.0, 2e-3, n), "length": np.cumsum(rng.normal(1e-3, 3e-3, n)),
    }  # fmt: skip
    return Cuts(**(values | fields))


def line(row):
    """File and line of a motion in a program of one line each."""
    return None if row < 0 else ("part.nc", int(row) + 1)


def the_only(found, expected, level="warning"):
    """Compare a difference with level, kind, rows and count; none with None."""
    listed = list(found)
    if expected is None:
        assert listed == []
        return None
    kind, rows, count = expected
    (difference,) = listed
    assert (difference.level, difference.kind, difference.count) == (level, kind, count)
    assert (difference.nominal, difference.corrected) == (line(rows[0]), line(rows[1]))
    return difference.message


@pytest.mark.parametrize("has_cuts", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_rapid_targets_have_no_offset_that_a_force_would_explain(seed, has_cuts):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    pose = found.pose.copy()
    pose[:, :3, 3] += rng.normal(0.0, 1e-4, (8, 3))
    found = replace(found, pose=pose)
    found = replace(found, cuts=cuts_of(rng, found) if has_cuts else None)
    offsets = []
    for k in range(8):
        offset = np.linalg.norm(pose[k, :3, 3] - found.nominal.motions.target[found.pair[k, 0]][:3, 3])
        left = np.linalg.norm(found.cuts.corrected_deviation[k]) if has_cuts else np.inf
        offsets.append(min(offset, left))
    bad = [k for k in range(8) if found.nominal.motions.rapid[found.pair[k, 0]] and offsets[k] > TOLERANCE]
    worst = max(bad, key=lambda k: offsets[k], default=None)
    expected = None if worst is None else ("rapid", found.pair[worst], len(bad))
    message = the_only(differences._rapid_differences(found, SIDE), expected)
    assert worst is None or f"is {1e3 * offsets[worst]:.4f} mm off." in message
    other_base = replace(found.corrected, bases=frames.pose_from_xyzabc([[1501.0, -200, 700, 0, 0, 0]]))
    assert not list(differences._rapid_differences(replace(found, corrected=other_base), SIDE))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_target_at_the_present_position_is_a_stop_unless_the_nominal_program_stops_there(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    sides, stops = [], []
    for made in (found.nominal, found.corrected):
        travel = rng.choice([0.0, 0.9e-9, 1.1e-9, 0.1], COUNT, p=[0.4, 0.2, 0.1, 0.3])
        turn = rng.choice([0.0, 0.9e-9, 1.1e-9, 0.1], COUNT, p=[0.6, 0.2, 0.1, 0.1])
        made.motions.kind[rng.random(COUNT) < 0.2] = PTP
        sides.append(SimpleNamespace(program=made, segments=SimpleNamespace(travel=travel, turn=turn)))
        stops.append([travel[k] < 1e-9 and turn[k] < 1e-9 and made.motions.kind[k] != PTP for k in range(COUNT)])
    partner = {int(second): int(first) for first, second in found.pair}
    bad = [k for k in range(COUNT) if stops[1][k] and not (k in partner and stops[0][partner[k]])]
    the_only(differences._repeated_positions(found, *sides), ("twice", (-1, bad[0]), len(bad)) if bad else None)


@pytest.mark.parametrize("seed", SEEDS)
def test_inserted_targets_of_one_way_go_on_along_the_path(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    cuts = cuts_of(rng, found)
    found = replace(found, cuts=cuts)
    ends = [n for n in range(20) if cuts.t[n] == 1.0]
    bad = []
    for before, after in itertools.pairwise(ends):
        ways = [sum(found.pair[:, 1] < cuts.row[n]) for n in (before, after)]
        if ways[0] == ways[1] and cuts.length[after] < cuts.length[before] - 1e-3:
            bad.append((before, after))
    expected = ("back", (-1, cuts.row[bad[0][1]]), len(bad)) if bad else None
    message = the_only(differences._backward_moves(found), expected)
    assert not bad or f"{1e3 * (cuts.length[bad[0][0]] - cuts.length[bad[0][1]]):.4f} mm back" in message
    assert not list(differences._backward_moves(replace(found, cuts=None)))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_loaded_tip_leaves_the_path_between_targets_by_more_than_at_them(seed):
    """By the tolerance and 5 µm, unless a missing target is there, which has a difference of its own."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    found.corrected.motions.kind[rng.random(COUNT) < 0.3] = CIRC
    cuts = cuts_of(rng, found)
    missing = np.setdiff1d(np.arange(COUNT), found.pair[:, 0])[: int(rng.integers(0, 3))]
    found = replace(found, cuts=cuts, only_nominal=missing)
    at_end = dict.fromkeys(range(-1, COUNT), 0.0)
    for k, (_, row) in enumerate(found.pair):
        at_end[row] = np.linalg.norm(cuts.corrected_deviation[k])
    for n in range(20):
        if cuts.t[n] == 1.0:
            at_end[cuts.row[n]] = cuts.corrected_distance[n]
    at_end[-1] = at_end[COUNT - 1]
    ways = [sum(found.pair[:, 1] < row) for row in cuts.row]
    gaps = {sum(found.pair[:, 0] < row) for row in missing}
    bad = []
    for n in range(20):
        limit = max(at_end[cuts.row[n]], at_end[cuts.row[n] - 1]) + TOLERANCE + 5e-6
        if cuts.t[n] < 1.0 and ways[n] not in gaps and ways[n] < 8 and cuts.corrected_distance[n] > limit:
            bad.append(n)
    if any(ways[n] == 8 for n in range(20) if cuts.t[n] < 1.0):
        return  # no place behind the last pair is ever checked
    worst = max(bad, key=lambda n: cuts.corrected_distance[n], default=None)
    expected = None
    if bad:
        expected = ("between", (found.pair[ways[worst], 0], cuts.row[worst]), len({cuts.row[n] for n in bad}))
    message = the_only(differences._deviations_under_force(found, SIDE), expected)
    if bad:
        assert f"leaves {1e3 * cuts.corrected_distance[worst]:.4f} mm" in message
        is_arc = found.corrected.motions.kind[cuts.row[worst]] == CIRC
        assert ("Check the auxiliary point of its arc." in message) == is_arc


@pytest.mark.parametrize("deviation", [None, 2e-4])
@pytest.mark.parametrize("keeps_text", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_corners_are_rounded_by_no_more_than_the_nominal_program_allows(monkeypatch, seed, keeps_text, deviation):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    if deviation is not None:  # of the nominal program under its forces, somewhere
        found = replace(found, cuts=cuts_of(rng, found, nominal=np.eye(8, 3) * deviation))
    layout = LAYOUT if keeps_text else None
    own_blend, own_rounding = rng.choice([0.0, 2e-3], COUNT), rng.choice([5e-5, 2e-4], COUNT)
    motions = replace(found.nominal.motions, blend=own_blend, rounding=own_rounding)
    nominal = replace(found.nominal, layout=layout, motions=motions)
    blend = rng.choice([0.0, 1e-3, 2e-3], COUNT)
    corrected = replace(found.corrected, motions=replace(found.corrected.motions, blend=blend))
    found = replace(found, nominal=nominal, corrected=corrected)
    sharp, reach = rng.uniform(0.0, 1.4, (2, COUNT)), rng.uniform(1e-4, 2e-3, (2, COUNT))
    sides = [
        SimpleNamespace(program=made, segments=n, robot_in_cell=SIDE.robot_in_cell)
        for n, made in enumerate((nominal, corrected))
    ]
    monkeypatch.setattr(
        differences, "corners_of_motions", lambda made, path, rows: Corners(sharp[path][rows], reach[path][rows])
    )

    def rounding(side, row, distance):
        return 0.25 * min(distance, reach[side][row]) * sharp[side][row]

    partner = {int(second): int(first) for first, second in found.pair}
    excess, allowances = {}, {}
    for row in sorted({*partner, *found.inserted_rows.tolist()}):
        next_partner = partner[min((second for second in partner if second >= row), default=max(partner))]
        allowed = rounding(1, row, nominal.motions.blend[next_partner]) if keeps_text else 0.0
        if row in partner:
            first = partner[row]
            allowed = nominal.motions.rounding[first] if nominal.motions.blend[first] > 0.0 else 0.0
            if keeps_text:
                allowed = rounding(0, first, nominal.motions.blend[first])
        excess[row], allowances[row] = rounding(1, row, blend[row]) - allowed, allowed
    bad = [row for row, value in excess.items() if value > TOLERANCE + 5e-6]
    worst = max(bad, key=lambda row: excess[row], default=None)
    expected = None
    if bad:
        way = min(sum(found.pair[:, 1] < worst), 7)
        expected = ("between", (found.pair[way, 0], worst), len(bad))
    limit = 1e-3 * MAX_CORRECTION_MM if deviation is None else deviation
    level = "error" if max(excess.values()) > limit else "warning"
    message = the_only(differences._cut_corners(found, *sides), expected, level)
    if bad:
        assert f"by {1e3 * rounding(1, worst, blend[worst]):.4f} mm; the nominal" in message
        assert f"allows {1e3 * allowances[worst]:.4g} mm. " in message
        is_own = allowances[worst] > 0.0 or not keeps_text
        assert message.endswith("Set $APO.CDIS and C_DIS back, or convert again." if is_own else "distance there.")


@pytest.mark.parametrize("seed", SEEDS)
def test_a_target_next_to_an_inserted_one_may_belong_to_it_within_twice_the_largest_offset(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    pose = found.pose.copy()
    pose[:, :3, 3] += rng.normal(0.0, 1e-4, (8, 3)) * (seed % 3)
    found = replace(found, pose=pose)
    tracks = [np.cumsum(rng.normal(0.0, 2e-4, (COUNT, 3)), axis=0) for _ in range(2)]
    tracks[1] = tracks[0][[min(int(k), COUNT - 1) for k in range(COUNT)]] + rng.normal(0.0, 1e-4, (COUNT, 3))
    sides = [
        SimpleNamespace(
            target_rows=np.arange(COUNT), track=lambda position=position: SimpleNamespace(position=position)
        )
        for position in tracks
    ]
    largest = max(
        np.linalg.norm(pose[k, :3, 3] - found.nominal.motions.target[found.pair[k, 0]][:3, 3]) for k in range(8)
    )
    uncertain = {}
    for k, (first, second) in enumerate(found.pair):
        for row in (second - 1, second + 1):
            is_near = 0 <= row < COUNT and np.linalg.norm(tracks[1][row] - tracks[0][first]) <= 1e-4 + 2.0 * largest
            if is_near and row in found.inserted_rows:
                gap = np.linalg.norm(tracks[1][row] - tracks[1][second])
                uncertain[k] = max(gap, uncertain.get(k, 0.0))
    expected = ("pairing", found.pair[min(uncertain)], len(uncertain)) if uncertain else None
    message = the_only(differences._ambiguous_pairs(found, *sides), expected)
    assert not uncertain or f"are known to {1e3 * max(uncertain.values()):.2f} mm only." in message


@pytest.mark.parametrize("has_cuts", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_the_tool_is_turned_by_no_more_than_the_tolerance_over_a_tenth_of_a_metre(seed, has_cuts):
    """Of pairs from the nearer one of two orientations; of inserted targets from the path."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng, rotation=rng.uniform(0.0, 1.6e-3, 8))
    cuts = cuts_of(rng, found)
    found = replace(found, cuts=cuts if has_cuts else None)
    limit = TOLERANCE / 0.1
    angles = [min(found.rotation[k], cuts.rotation[k]) if has_cuts else found.rotation[k] for k in range(8)]
    ends = [n for n in range(20) if has_cuts and cuts.t[n] == 1.0]
    places = {tuple(found.pair[k]): angles[k] for k in range(8) if angles[k] > limit}
    entries = [(cuts.path_rotation[n], (-1, cuts.row[n])) for n in ends if cuts.path_rotation[n] > limit]
    entries += [(angle, rows) for rows, angle in places.items()]
    worst = max(entries, default=None, key=lambda entry: entry[0])
    expected = None if worst is None else ("orientation", worst[1], len(entries))
    message = the_only(differences._orientation_differences(found, SIDE, SIDE), expected)
    assert worst is None or f"turned by {np.degrees(worst[0]):.4f}° from" in message
    other_base = replace(found.corrected, bases=frames.pose_from_xyzabc([[1501.0, -200, 700, 0, 0, 0]]))
    elsewhere = list(differences._orientation_differences(replace(found, corrected=other_base), SIDE, SIDE))
    assert bool(elsewhere) == (has_cuts and worst is not None)


@pytest.mark.parametrize("keeps_text", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_approximation_distances_of_robot_programs_are_the_same_to_ten_micrometres(seed, keeps_text):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    blends = rng.choice([0.0, 5e-4], COUNT), rng.choice([0.0, 5.09e-4, 5.11e-4, 4.91e-4], COUNT)
    nominal, corrected = (
        replace(made, motions=replace(made.motions, blend=blend), layout=LAYOUT if keeps_text else None)
        for made, blend in zip((found.nominal, found.corrected), blends, strict=True)
    )
    found = replace(found, nominal=nominal, corrected=corrected)
    bad = [k for k, (a, b) in enumerate(found.pair) if keeps_text and abs(blends[1][b] - blends[0][a]) > 1e-5]
    message = the_only(
        settings._approximation_differences(found), ("approximation", found.pair[bad[0]], len(bad)) if bad else None
    )
    if bad:
        a, b = found.pair[bad[0]]
        words = [f"{1e3 * value:.4g} mm" if value else "none" for value in (blends[1][b], blends[0][a])]
        assert f"is {words[0]} instead of {words[1]}." in message


@pytest.mark.parametrize("seed", SEEDS)
def test_joints_of_another_posture_differ_by_more_than_twenty_degrees(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    joints = np.radians(rng.uniform(-90.0, 90.0, (2, COUNT, 6)))
    for first, second in found.pair:
        change = rng.choice([-20.1, -19.9, 0.0, 19.9, 20.1], 6, p=[0.02, 0.2, 0.56, 0.2, 0.02])
        joints[1, second] = joints[0, first] + np.radians(change)
    sides = [SimpleNamespace(joints=q) for q in joints]
    steps = [np.degrees(np.abs(joints[0, a] - joints[1, b])) for a, b in found.pair]
    bad = [k for k in range(8) if steps[k].max() > 20.0]
    message = the_only(
        settings._posture_differences(found, *sides), ("posture", found.pair[bad[0]], len(bad)) if bad else None
    )
    if bad:
        (a, b), joint = found.pair[bad[0]], int(steps[bad[0]].argmax())
        angles = np.degrees([joints[1, b, joint], joints[0, a, joint]])
        assert f"A{joint + 1} is at {angles[0]:.1f}° instead of {angles[1]:.1f}° (S, T)." in message


@pytest.mark.parametrize("keeps_text", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_status_and_turn_are_given_in_both_programs_and_the_turn_is_that_of_the_joints(seed, keeps_text):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    q = np.radians(rng.choice([-60.0, -0.005, 0.005, 60.0], (COUNT, 6)))
    right = [sum(int(q[k, axis] < 0.0) << axis for axis in range(6)) for k in range(COUNT)]
    motions = []
    for made, is_second in ((found.nominal, False), (found.corrected, True)):
        turn = np.where(rng.random(COUNT) < 0.25, -1, rng.integers(0, 64, COUNT))
        if is_second:
            for first, second in found.pair:
                turn[second] = [right[second], motions[0].turn[first], -1, 21][int(rng.integers(4))]
        status = np.where(rng.random(COUNT) < 0.3, -1, rng.choice([0, 2], COUNT))
        kind = np.where(rng.random(COUNT) < 0.8, PTP, LIN)
        motions.append(replace(made.motions, turn=turn, status=status, kind=kind))
    nominal = replace(found.nominal, motions=motions[0], layout=LAYOUT if keeps_text else None)
    found = replace(found, nominal=nominal, corrected=replace(found.corrected, motions=motions[1]))
    bad = []
    for k, (a, b) in enumerate(found.pair):
        mine, theirs = motions
        signs = [axis for axis in range(6) if abs(np.degrees(q[b, axis])) > 0.01]
        differs = any((int(theirs.turn[b]) >> axis & 1) != (q[b, axis] < 0.0) for axis in signs)
        is_wrong = theirs.turn[b] >= 0 and theirs.turn[b] != mine.turn[a] and differs
        one_alone = (mine.turn[a] < 0) != (theirs.turn[b] < 0) or (mine.status[a] < 0) != (theirs.status[b] < 0)
        if keeps_text and mine.kind[a] == theirs.kind[b] == PTP and (is_wrong or one_alone):
            bad.append(k)
    sides = SimpleNamespace(joints=q)
    message = the_only(
        settings._status_and_turn_differences(found, sides), ("posture", found.pair[bad[0]], len(bad)) if bad else None
    )
    if bad:
        a, b = found.pair[bad[0]]
        words = []
        for m, row in ((motions[1], b), (motions[0], a)):
            words.append(
                ", ".join(f"{n} {v}" if v >= 0 else f"no {n}" for n, v in (("S", m.status[row]), ("T", m.turn[row])))
            )
        assert f"are {words[0]} instead of {words[1]}:" in message


@pytest.mark.parametrize("seed", SEEDS)
def test_e1_of_pairs_is_the_same_to_ten_micrometres(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    ends = [np.zeros(COUNT), rng.choice([0.0, 0.9e-5, 1.1e-5, -0.02], COUNT, p=[0.5, 0.3, 0.1, 0.1])]
    direction = np.array([1.0, 0.0, 0.0])
    nominal, corrected = (
        replace(made, carriage=Carriage(np.zeros(COUNT), end, direction), layout=LAYOUT)
        for made, end in zip((found.nominal, found.corrected), ends, strict=True)
    )
    both = replace(found, nominal=nominal, corrected=corrected)
    bad = [k for k, (a, b) in enumerate(found.pair) if abs(ends[1][b] - ends[0][a]) > 1e-5]
    expected = ("external-axis", found.pair[bad[0]], len(bad)) if bad else None
    message = the_only(settings._external_axis_differences(both), expected)
    assert not bad or f"E1 is at {1e3 * ends[1][found.pair[bad[0], 1]]:.4f} mm instead of 0.0000 mm:" in message
    for one, name in (
        (replace(both, corrected=found.corrected), "nominal"),
        (replace(both, nominal=replace(found.nominal, layout=LAYOUT)), "corrected"),
    ):
        (alone,) = settings._external_axis_differences(one)
        assert (alone.kind, alone.count, alone.nominal) == ("external-axis", 8, None)
        assert f"in the {name} program only." in alone.message
    assert not list(
        settings._external_axis_differences(replace(both, nominal=found.nominal))
    )  # a program of G-code has none


def test_external_axes_that_stand_still_are_compared_by_what_their_readers_say():
    found = compared()
    at = [
        Issue("info", "external-axis", f"{axis} is at {value} mm: kept", line, subject=axis)
        for axis, value, line in (("E2", 5, 2), ("E3", 7, 3))
    ]
    unknown = Issue("info", "external-axis", "E3 is moved: unknown", 4, subject="E3")
    nominal, corrected = replace(found.nominal, issues=(*at,)), replace(found.corrected, issues=(at[0], unknown))
    (difference,) = settings._external_axis_differences(replace(found, nominal=nominal, corrected=corrected))
    assert (
        difference.message
        == "E3 is not given before its first motion in the corrected program, and at 7 mm in the nominal one."
    )
    assert (difference.nominal, difference.corrected) == (("part.nc", 3), ("part.nc", 4))
    (missing,) = settings._external_axis_differences(replace(found, nominal=replace(nominal, issues=at[:1])))
    assert missing.message == "E2 is at 0 or not given in the corrected program, and at 5 mm in the nominal one."
    assert (missing.nominal, missing.corrected, missing.count) == (("part.nc", 2), None, 1)


@pytest.mark.parametrize("seed", SEEDS)
def test_another_orientation_type_of_path_motions_is_reported_but_for_the_led_one(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    types = rng.choice(["#VAR", "#CONSTANT", "#JOINT"], (2, COUNT), p=[0.3, 0.6, 0.1])
    kinds = rng.choice([LIN, PTP], (2, COUNT), p=[0.7, 0.3])
    sides = [
        replace(
            made,
            layout=SimpleNamespace(places=LAYOUT.places, orientation_types=lambda rows, own=own: own[rows]),
            motions=replace(made.motions, kind=kind),
        )
        for made, own, kind in zip((found.nominal, found.corrected), types, kinds, strict=True)
    ]
    found = replace(found, nominal=sides[0], corrected=sides[1])
    bad = [
        k for k, (a, b) in enumerate(found.pair)
        if types[0][a] != types[1][b] != "#VAR" and kinds[0][a] != PTP and kinds[1][b] != PTP
    ]  # fmt: skip
    expected = ("orientation-type", found.pair[bad[0]], len(bad)) if bad else None
    message = the_only(settings._orientation_type_differences(found), expected)
    if bad:
        a, b = found.pair[bad[0]]
        assert f"$ORI_TYPE is {types[1][b]} instead of {types[0][a]}:" in message
    assert not list(settings._orientation_type_differences(replace(found, corrected=replace(sides[1], layout=None))))
    # RAPID has no such type: there is nothing to compare with, on either side
    without = SimpleNamespace(places=LAYOUT.places, orientation_types=lambda rows: None)
    for changed in ({"nominal": 0}, {"corrected": 1}, {"nominal": 0, "corrected": 1}):
        untyped = {name: replace(sides[n], layout=without) for name, n in changed.items()}
        assert not list(settings._orientation_type_differences(replace(found, **untyped)))


@pytest.mark.parametrize("seed", SEEDS)
def test_frames_of_pairs_are_the_same_to_a_micrometre_and_a_microradian(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    frames_of = {}
    for name in ("bases", "tools"):
        first = frames.pose_from_xyzabc(rng.uniform(-300.0, 300.0, (2, 6)))
        second = first.copy()
        for pose in second:
            if rng.random() < 0.5:
                pose[:3, 3] += rng.choice([0.9e-6, 1.1e-6, 3e-4]) * np.eye(3)[rng.integers(3)]
            elif rng.random() < 0.5:
                angle = rng.choice([0.9e-6, 1.1e-6, 2e-3])
                pose[:3, :3] = Rotation.from_rotvec(angle * np.eye(3)[rng.integers(3)]).as_matrix() @ pose[:3, :3]
        frames_of[name] = first, second
    index = rng.integers(0, 2, (2, 2, COUNT))
    sides = [
        replace(
            made,
            bases=frames_of["bases"][n],
            tools=frames_of["tools"][n],
            motions=replace(made.motions, base=index[0, n], tool=index[1, n]),
        )
        for n, made in enumerate((found.nominal, found.corrected))
    ]
    found = replace(found, nominal=sides[0], corrected=sides[1])
    expected = []
    for row, (name, key) in enumerate((("bases", "base"), ("tools", "tool"))):
        bad = []
        for k, (a, b) in enumerate(found.pair):
            one, other = frames_of[name][0][index[row, 0, a]], frames_of[name][1][index[row, 1, b]]
            turn = Rotation.from_matrix(other[:3, :3] @ one[:3, :3].T).as_rotvec()
            shift = other[:3, 3] - one[:3, 3]
            if max(np.abs(shift).max(), np.abs(turn).max()) > 1e-6:
                bad.append((k, np.linalg.norm(shift), np.linalg.norm(turn)))
        if bad:
            words = f"${key.upper()} differs, by {1e3 * bad[0][1]:.4f} mm and {np.degrees(bad[0][2]):.4f}°:"
            expected.append((key, tuple(found.pair[bad[0][0]]), len(bad), words))
    listed = list(settings.frame_differences(found))
    assert len(listed) == len(expected)
    for difference, (key, rows, count, words) in zip(listed, expected, strict=True):
        assert (difference.kind, difference.count) == (key, count)
        assert (difference.nominal, difference.corrected) == (line(rows[0]), line(rows[1]))
        assert difference.message.startswith(words)


@pytest.mark.parametrize("frame", [0, 1, 2])
@pytest.mark.parametrize("seed", SEEDS)
def test_comments_give_the_forces_of_the_nominal_program_to_the_digits_written(seed, frame):
    """0.05 N and a thousandth in BASE axes, 5 % in axes that the correction turns."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    found.corrected.motions.rapid[rng.random(COUNT) < 0.2] = True
    turn = Rotation.from_euler("z", 30.0, degrees=True).as_matrix()
    base = np.eye(4)
    base[:3, :3] = turn
    nominal = replace(found.nominal, bases=base[None])
    corrected = replace(found.corrected, notes=(ForceNote(1, (1.0,) * 6, "BASE", 0),))
    cuts = cuts_of(rng, found)
    found = replace(found, nominal=nominal, corrected=corrected, cuts=cuts)
    share = 1e-3 if frame == 0 else 0.05
    in_base, in_root = np.zeros((COUNT, 6)), np.zeros((COUNT, 6))
    for k, (_, second) in enumerate(found.pair):
        size = (0.05 + share * np.linalg.norm(cuts.wrench[k])) * rng.choice([0.9, 1.1])
        direction = rng.normal(size=6)
        in_base[second] = cuts.wrench[k] + size * direction / np.linalg.norm(direction)
        in_root[second] = np.concatenate([turn @ in_base[second, :3], turn @ in_base[second, 3:]])
    load = SimpleNamespace(frame=np.full(COUNT, frame))
    side = SimpleNamespace(forces=lambda source: load, wrench=lambda path, rows: in_root[rows])
    bad = []
    for k, (first, second) in enumerate(found.pair):
        off = np.linalg.norm(in_base[second] - cuts.wrench[k])
        is_cut = not nominal.motions.rapid[first] and not corrected.motions.rapid[second]
        if is_cut and off > 0.05 + share * np.linalg.norm(cuts.wrench[k]):
            bad.append(k)
    expected = ("force", found.pair[bad[0]], len(bad)) if bad else None
    message = the_only(settings.force_differences(found, side, has_force_file=False), expected)
    if bad:
        words = [" ".join(f"{v:.4g}" for v in w[:3]) for w in (in_base[found.pair[bad[0], 1]], cuts.wrench[bad[0]])]
        assert f"the force {words[0]} N instead of {words[1]} N ($BASE):" in message
    assert not list(settings.force_differences(replace(found, cuts=None), side, has_force_file=False))
    assert not list(
        settings.force_differences(replace(found, corrected=replace(corrected, notes=())), side, has_force_file=False)
    )


@pytest.mark.parametrize(
    ("mine", "theirs", "rows"),
    [
        ([(1, 10.0)], [(1, 10.0)], None), ([(1, 10.0)], [(2, 10.0)], None), ([(1, 10.0)], [(1, 11.0)], (0, 0)),
        ([(1, 10.0), (4, 5.0)], [(1, 10.0)], (3, -1)), ([(1, 10.0)], [(1, 10.0), (5, 5.0)], (-1, 4)),
    ],
)  # fmt: skip
def test_with_a_file_of_forces_the_comments_of_both_programs_are_the_same(mine, theirs, rows):
    found = compared()
    sides = [
        replace(
            made, notes=tuple(ForceNote(number, (size,) + (0.0,) * 5, "BASE", number - 1) for number, size in notes)
        )
        for made, notes in ((found.nominal, mine), (found.corrected, theirs))
    ]
    cuts = cuts_of(np.random.default_rng(1), found)
    found = replace(found, nominal=sides[0], corrected=sides[1], cuts=cuts)
    message = the_only(
        settings.force_differences(found, None, has_force_file=True), None if rows is None else ("force", rows, 1)
    )
    assert rows is None or message.endswith("than those of the nominal program.")


@pytest.mark.parametrize("keeps_text", [False, True])
@pytest.mark.parametrize("seed", range(30))
def test_axis_targets_are_paired_in_order_between_the_same_pairs(seed, keeps_text):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    sides, joints = [], []
    for n, made in enumerate((found.nominal, found.corrected)):
        free = np.setdiff1d(np.arange(COUNT), found.pair[:, n])
        q = np.full((COUNT, 6), np.nan)
        q[free[rng.random(len(free)) < 0.7]] = 0.3
        q = q + np.radians(rng.choice([0.0, 0.0009, 0.0011], (COUNT, 6), p=[0.9, 0.06, 0.04])) * n
        joints.append(q)
        layout = LAYOUT if keeps_text else None
        sides.append(
            SimpleNamespace(program=replace(made, motions=replace(made.motions, joints=q), layout=layout), joints=q)
        )
    found = replace(found, nominal=sides[0].program, corrected=sides[1].program)
    queues: list[dict] = [{}, {}]
    for n in (0, 1):
        for row in range(COUNT):
            gap = int(sum(found.pair[:, n] < row))
            if np.isfinite(joints[n][row, 0]) and (keeps_text or gap > 0):
                queues[n].setdefault(gap, []).append(row)
    differ, alone = [], ([], [])
    for gap in range(9):
        one, other = queues[0].get(gap, []), queues[1].get(gap, [])
        shared = min(len(one), len(other))
        differ += [
            (a, b) for a, b in zip(one, other, strict=False)
            if np.degrees(np.abs(joints[0][a] - joints[1][b]).max()) > 0.001
        ]  # fmt: skip
        alone[0].extend((row, -1) for row in one[shared:])
        alone[1].extend((-1, row) for row in other[shared:])
    unpaired = alone[0] + alone[1]
    listed = list(settings.axis_target_differences(found, *sides))
    assert [difference.count for difference in listed] == [len(rows) for rows in (differ, unpaired) if rows]
    if differ:
        a, b = differ[0]
        joint = int(np.abs(joints[0][a] - joints[1][b]).argmax())
        angles = np.degrees([joints[1][b, joint], joints[0][a, joint]])
        assert f"another one: A{joint + 1} {angles[0]:.4f}° instead of {angles[1]:.4f}°." in listed[0].message
        assert (listed[0].nominal, listed[0].corrected) == (line(a), line(b))
    if unpaired:
        assert (listed[-1].nominal, listed[-1].corrected) == (line(unpaired[0][0]), line(unpaired[0][1]))


@pytest.mark.parametrize("seed", range(30))
def test_kinds_of_pairs_and_inserted_targets_are_those_of_the_way_they_are_on(seed):
    """An arc may become lines; between two pairs each kind of the nominal targets there may be used."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    kinds = rng.choice([LIN, CIRC, PTP, SPL], (2, COUNT), p=[0.5, 0.3, 0.1, 0.1])
    joints = np.full((COUNT, 6), np.nan)
    joints[np.setdiff1d(np.arange(COUNT), found.pair[:, 0])[::2]] = 0.1
    nominal = replace(found.nominal, motions=replace(found.nominal.motions, kind=kinds[0], joints=joints))
    corrected = replace(found.corrected, motions=replace(found.corrected.motions, kind=kinds[1]))
    found = replace(found, nominal=nominal, corrected=corrected)
    bad = []
    for row in sorted({*found.pair[:, 1].tolist(), *found.inserted_rows.tolist()}):
        way = int(sum(found.pair[:, 1] < row))
        first = found.pair[way, 0]
        before = found.pair[way - 1, 0] if way else -1
        between = {kinds[0][k] for k in range(before + 1, first) if np.isnan(joints[k, 0])}
        is_line_of_arc = kinds[0][first] == CIRC and kinds[1][row] == LIN
        if kinds[0][first] != kinds[1][row] and not is_line_of_arc and kinds[1][row] not in between:
            bad.append((first, row))
    message = the_only(settings._kind_differences(found), ("kind", bad[0], len(bad)) if bad else None)
    if bad:
        names = {LIN: "a line (LIN)", CIRC: "an arc (CIRC)", PTP: "point to point (PTP)", SPL: "a spline (SPL)"}
        assert f"is {names[kinds[1][bad[0][1]]]} instead of {names[kinds[0][bad[0][0]]]}." in message


@pytest.mark.parametrize("seed", SEEDS)
def test_the_first_pair_with_another_speed_is_named_in_millimetres_a_second(seed):
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    found.corrected.motions.feed[:] = rng.choice([0.05, 0.5, 0.06], COUNT)
    path = SimpleNamespace(joints=np.zeros((COUNT, 6)))
    feeds = found.nominal.motions.feed, found.corrected.motions.feed
    bad = [k for k, (a, b) in enumerate(found.pair) if abs(feeds[1][b] - feeds[0][a]) > 1e-4]
    listed = [
        difference for difference in settings.setting_differences(found, path, path) if difference.kind == "speed"
    ]
    message = the_only(listed, ("speed", found.pair[bad[0]], len(bad)) if bad else None)
    if bad:
        a, b = found.pair[bad[0]]
        assert f"is {1e3 * feeds[1][b]:.4g} mm/s instead of {1e3 * feeds[0][a]:.4g} mm/s." in message


@pytest.mark.parametrize("has_cuts", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_ways_that_leave_the_nominal_path_by_more_than_their_targets_are_named(monkeypatch, seed, has_cuts):
    """By 0.1 mm and three offsets at their ends; not where forces are checked, or a missing target is."""
    rng = np.random.default_rng(seed)
    found = random_pairs(rng)
    found.corrected.motions.kind[rng.random(COUNT) < 0.3] = CIRC
    pose = found.pose.copy()
    pose[:, :3, 3] += rng.normal(0.0, 3e-5, (8, 3))
    between = np.where(rng.random(8) < 0.1, np.nan, rng.choice([5e-5, 3e-4, 1e-3], 8))
    between[0] = np.nan
    missing = np.setdiff1d(np.arange(COUNT), found.pair[:, 0])[: int(rng.integers(0, 3))]
    found = replace(found, pose=pose, path_distance=between, only_nominal=missing, curves=SimpleNamespace())
    cuts = cuts_of(rng, found, row=np.sort(rng.choice(found.pair[:2, 1], 20)))
    found = replace(found, cuts=cuts if has_cuts else None)
    exact = rng.choice([1e-5, 2.5e-4, 8e-4, 9e-4] if seed % 2 else [1e-5, 2e-4, 2.5e-4], 8)
    monkeypatch.setattr(differences, "_distance_on_stretch", lambda comparison, one, other, k: exact[k])
    offsets = [np.linalg.norm(pose[k, :3, 3] - found.nominal.motions.target[found.pair[k, 0]][:3, 3]) for k in range(8)]
    checked = {
        int(sum(found.pair[:, 1] < row)) for row, t in zip(cuts.row, cuts.t, strict=True) if t < 1.0 and has_cuts
    }
    gaps = {int(sum(found.pair[:, 0] < row)) for row in missing}
    limits = [1e-4 + 3.0 * max(offsets[k], offsets[k - 1]) for k in range(8)]
    bad = [
        k for k in range(8)
        if between[k] > limits[k] and k not in checked and k not in gaps and exact[k] > limits[k]
    ]  # fmt: skip
    worst = max(bad, key=lambda k: exact[k], default=None)
    expected = None if worst is None else ("between", found.pair[worst], len(bad))
    level = "error" if bad and exact[worst] > 1e-3 * MAX_CORRECTION_MM else "warning"
    message = the_only(differences._stretches_off_path(found, SIDE, SIDE), expected, level)
    if bad:
        assert f"the path is {1e3 * exact[worst]:.4f} mm from the nominal one" in message
        way = range(found.pair[worst - 1, 1] + 1, found.pair[worst, 1] + 1)
        assert ("Check the auxiliary point" in message) == any(found.corrected.motions.kind[row] == CIRC for row in way)
    assert not list(differences._stretches_off_path(replace(found, curves=None), SIDE, SIDE))
    assert differences._pairs_under_force(found).tolist() == sorted(checked)


def test_calls_of_one_program_alone_are_named_by_whether_the_other_has_the_file():
    found = compared()
    issue = [
        Issue("info", "external-call", "x", line, subject=name) for name, line in (("P1", 2), ("P2", 3), ("P3", 4))
    ]
    text = "DEF part()\nP1 ()\n; P3()\nEND\n"
    document = found.corrected.documents[0]
    other = replace(found.corrected, issues=(issue[1],), documents=(type(document)("part.nc", text),))
    both = replace(found, nominal=replace(found.nominal, issues=tuple(issue)), corrected=other)
    first, second = differences._call_differences(both)
    assert (first.level, first.kind) == ("warning", "not-compared")
    assert first.message.startswith("the file of P1() is in the folder of the other program only")
    assert second.message == "P3(), which is in no file, is called by this program only: its effect is not compared."
    assert [(d.nominal, d.corrected) for d in (first, second)] == [(("part.nc", 2), None), (("part.nc", 4), None)]
    swapped = replace(both, nominal=both.corrected, corrected=both.nominal)
    assert [(d.nominal, d.corrected) for d in differences._call_differences(swapped)] == [
        (None, ("part.nc", 2)),
        (None, ("part.nc", 4)),
    ]


def test_ways_that_begin_at_an_unknown_place_are_counted():
    found = compared()
    after = np.array([-1, 1, 1, 3, 3])
    known = replace(found, nominal=replace(found.nominal, after=after))
    (difference,) = differences._uncompared_motions(known)
    assert (difference.kind, difference.count) == ("not-compared", 2)
    assert (difference.nominal, difference.corrected) == (line(1), line(1))
    assert not list(differences._uncompared_motions(found))


@pytest.mark.parametrize("pairs_certain", [True, False])
@pytest.mark.parametrize("same_origin", [True, False])
@pytest.mark.parametrize("is_off", [True, False])
@pytest.mark.parametrize("corner_level", ["warning", "error"])
def test_programs_of_one_conversion_are_compared_by_their_targets_and_forces_alone(
    monkeypatch, pairs_certain, same_origin, is_off, corner_level
):
    """Corners that are cut a little count only where no path difference explains them."""
    corner = SimpleNamespace(level=corner_level)
    names = {
        "_unresolved_differences": "unresolved", "_uncompared_motions": "not compared",
        "_call_differences": "calls", "setting_differences": "settings", "lowered_feed_notes": "lowered",
        "statement_differences": "statements", "force_differences": "forces", "_rapid_differences": "rapid",
        "_repeated_positions": "twice",
        "_backward_moves": "back", "_unpaired_targets": "alone", "axis_target_differences": "axis",
        "_orientation_differences": "orientation", "_stretches_off_path": "off", "_deviations_under_force": "under",
        "_joint_motions_off_path": "joint", "_cut_corners": corner, "_ambiguous_pairs": "ambiguous",
    }  # fmt: skip
    for name, word in names.items():
        is_empty = name in ("_stretches_off_path", "_deviations_under_force") and not is_off
        monkeypatch.setattr(
            differences, name, lambda *parts, word=word, empty=is_empty, **options: [] if empty else [word]
        )
    found = differences.differences(
        None, None, None, has_force_file=True, same_origin=same_origin, are_pairs_certain=pairs_certain
    )
    uncertain = [] if pairs_certain else ["ambiguous"]
    if same_origin:
        assert list(found) == ["lowered", "not compared", "alone", *(["under"] if is_off else []), *uncertain]
        return
    whole = [
        "unresolved",
        "not compared",
        "calls",
        "settings",
        "statements",
        "forces",
        "rapid",
        "twice",
        "back",
        "alone",
    ]
    paths = ["off", "under"] if is_off else []
    if corner_level == "error" or not is_off:
        paths.append(corner)
    assert list(found) == [*whole, "axis", "orientation", "joint", *paths, *uncertain]
