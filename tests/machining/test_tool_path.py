"""The tool's path through the stock as straight pieces, against a loop; two tilted bases, helices, a tilted map."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import frames, toolpath
from postproc.machining import tool_path
from postproc.machining.estimate import _no_contact_error, _scale_issues
from postproc.machining.tool_path import Directions, Shift, straight_segments, tool_states
from tests.toolpath.setting import BASES, START, begins, mixed, point

FRAME = frames.pose_from_xyzabc([12.0, -7.0, 30.0, 25.0, -15.0, 40.0])
CELL_SIZE = 4e-4
TOOL_STATES = np.array([0, 0, 0, 1, 1, -1, 0])


def in_map(made, k, place):
    """A place [m] in the base of motion k, in the frame of the map, which is in that of the first cutting motion."""
    to_map = np.linalg.inv(FRAME) @ np.linalg.inv(BASES[0]) @ BASES[made.motions.base[k]]
    return (to_map @ [*place, 1.0])[:3]


def heading(made, begin, k, t):
    h = 1e-6
    one, other = (in_map(made, k, point(made, begin, k, t + by)) for by in (-h, h))
    return (other - one) / np.linalg.norm(other - one)


def pieces_of_arc(made, begin, k):
    """Chords that leave the arc by a tenth of a cell and turn by 8° at most."""
    m = made.motions
    radius = np.linalg.norm(np.cross(begin[k, :3, 3] - m.centre[k], m.normal[k]))
    by_sag = np.sqrt(8.0 * 0.1 * CELL_SIZE / radius)
    return int(np.ceil(m.sweep[k] / min(by_sag, np.radians(8.0))))


def test_pieces_of_lines_and_arcs_are_in_the_frame_of_the_map():
    made = mixed()
    begin = begins(made)
    found = straight_segments(made, toolpath.segments(made, START), SimpleNamespace(tool=TOOL_STATES), FRAME, CELL_SIZE)
    expected = []
    for k in (1, 2, 3, 4, 6):  # no PTP, and no motion without a tool
        count = pieces_of_arc(made, begin, k) if made.motions.kind[k] == 1 else 1
        expected += [(k, n / count, (n + 1) / count) for n in range(count)]
    np.testing.assert_array_equal(found.motion, [row[0] for row in expected])
    np.testing.assert_allclose(found.first, [row[1] for row in expected], atol=1e-15)
    np.testing.assert_allclose(found.last, [row[2] for row in expected], atol=1e-15)
    for row, (k, first, last) in enumerate(expected):
        ends = [in_map(made, k, point(made, begin, k, t)) for t in (first, last)]
        np.testing.assert_allclose([found.begin[row], found.end[row]], ends, rtol=0, atol=1e-12)
        directions = [heading(made, begin, k, t) for t in (first, last)]
        np.testing.assert_allclose([found.leave[row], found.arrive[row]], directions, rtol=0, atol=1e-7)
        assert found.cutting[row] == (not made.motions.rapid[k])
        # motion 4 begins with the tool of motion 3 in another base: the tip is elsewhere
        at_start = row == 0 or (found.motion[row] != found.motion[row - 1] and k in (3, 6))
        if k != 4:
            assert found.continues[row] == (not at_start)


def test_pieces_are_cut_and_displaced_where_the_tip_is_displaced():
    made = mixed()
    begin, path = begins(made), toolpath.segments(made, START)
    offset = 1e-3 * np.array([[1, 0, 0], [1, 0, 0], [0, 2, 1], [3, 0, 1], [0, 0, -3], [4, 1, 0]])
    shift = Shift.of(made, np.array([2, 3, 3, 3, 4, 6]), np.array([1.0, 0.25, 0.75, 1.0, 1.0, 0.5]), offset)
    found = straight_segments(made, path, SimpleNamespace(tool=TOOL_STATES), FRAME, CELL_SIZE, shift=shift)
    for k, cuts in ((3, [0.0, 0.25, 0.75, 1.0]), (4, [0.0, 1.0])):
        own = found.motion == k
        np.testing.assert_allclose(found.first[own], cuts[:-1], atol=1e-12)
        np.testing.assert_allclose(found.last[own], cuts[1:], atol=1e-12)
    own = np.flatnonzero(found.motion == 6)
    assert np.abs(found.last[own] - 0.5).min() < 1e-12
    np.testing.assert_allclose(found.first[own[1:]], found.last[own[:-1]], atol=1e-12)
    for row in np.flatnonzero(found.motion == 3):
        for t, place in ((found.first[row], found.begin[row]), (found.last[row], found.end[row])):
            base = [BASES[made.motions.base[k], :3, :3] for k in (2, 3)]
            here = np.vstack([base[1].T @ base[0] @ offset[0], offset[1:4]])  # motion 2 ends where motion 3 begins
            by = [np.interp(t, [-0.001, 0.25, 0.75, 1.0], here[:, axis]) for axis in range(3)]
            np.testing.assert_allclose(place, in_map(made, 3, point(made, begin, 3, t) + by), rtol=0, atol=1e-12)


def test_a_displacement_keeps_its_direction_where_the_base_changes():
    made = mixed()
    base = made.motions.base
    along = [0.3e-3, -0.2e-3, 0.5e-3]
    motion = np.arange(len(base))
    offset = np.array([BASES[k, :3, :3].T @ along for k in base])
    assert len(set(base.tolist())) > 1
    shift = Shift.of(made, motion, np.ones(len(motion)), offset)
    for t in (0.0, 0.4, 1.0):
        found = shift.displacements(motion, np.full(len(motion), t))
        for k, own in enumerate(found):
            np.testing.assert_allclose(BASES[base[k], :3, :3] @ own, along, atol=1e-15)


def test_pieces_of_some_motions_are_joined_only_to_those_that_are_left():
    made = mixed()
    every = straight_segments(
        made, toolpath.segments(made, START), SimpleNamespace(tool=0 * TOOL_STATES), FRAME, CELL_SIZE
    )
    some = every.of(np.array([False, True, False, True, False, False, True]))
    assert set(some.motion) == {1, 3, 6}
    starts = np.flatnonzero(np.diff(some.motion, prepend=-1))
    assert not some.continues[starts].any()
    np.testing.assert_array_equal(some.continues[1:][np.diff(some.motion) == 0], True)
    np.testing.assert_array_equal(some.begin, every.begin[np.isin(every.motion, [1, 3, 6])])


@pytest.mark.parametrize(("axis", "column", "sign"), [("+Z", 2, -1), ("-Z", 2, 1), ("+X", 0, -1), ("-X", 0, 1)])
def test_the_spindle_is_given_in_the_base_of_the_first_cutting_motion(axis, column, sign):
    made = mixed()
    m = replace(made.motions, base=np.array([0, 1, 1, 1, 0, 0, 1]))
    made = replace(made, motions=m)
    found = Directions.of(made, toolpath.segments(made, START), axis).end
    for k in range(len(m)):
        in_root = BASES[m.base[k], :3, :3] @ (sign * m.target[k, :3, column])
        np.testing.assert_allclose(found[k], BASES[1, :3, :3].T @ in_root, rtol=0, atol=1e-14)


def cutting(*ends):
    """Pieces between places (n, 3) [m], all of which cut but the last."""
    ends = np.array(ends)
    cuts = np.arange(len(ends) - 1) < len(ends) - 2
    return SimpleNamespace(begin=ends[:-1], end=ends[1:], cutting=cuts)


BOUNDS = (0.1, 0.2, -0.3, -0.25, 0.04)
"""Of the stock: 100 mm by 50 mm, top at 40 mm."""


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (2.54, "The stock is smaller by about 25.4: is one of them in inches?"), (0.1 / 25.4, "The stock is larger"),
        (0.1, None), (0.49, None), (0.51, None), (0.78, "smaller"), (7.5, "smaller"), (7.7, None),
        (0.0119, None), (0.0117, "larger"), (0.0012, "larger"), (0.00115, None), (0.3, None),
        (100.0, "The stock is smaller by about 1000: is one of them in metres?"), (0.1 / 1000, "larger by about 1000"),
        (0.0005, None),
    ],
)  # fmt: skip
@pytest.mark.parametrize("axis", [0, 1])
def test_a_path_that_misses_the_stock_says_where_both_are_and_whether_units_may_differ(size, text, axis):
    begin, far = np.array([0.5, 0.6, -0.02]), np.array([9.0, 9.0, 9.0])
    end = begin + size * np.eye(3)[axis] + [0, 0, 0.01]
    process = SimpleNamespace(path="process.toml")
    error = _no_contact_error(cutting(end, begin, far), BOUNDS, process, None)
    low, high = 1e3 * np.minimum(begin, end), 1e3 * np.maximum(begin, end)
    where = ", ".join(f"{name} {a:.4g} … {b:.4g}" for name, a, b in zip("XYZ", low, high, strict=True))
    assert f"cutting moves lie within {where} mm" in str(error)
    assert "the stock within X 100 … 200, Y -300 … -250, top Z 40 mm" in str(error)
    assert ("is one of them in" in str(error)) == (text is not None)
    assert text is None or text in str(error)


def test_a_path_five_times_as_large_as_the_stock_is_a_warning():
    for size, expected in ((4.9, []), (5.1, ["stock-scale"])):
        begin = np.array([-0.3, -0.4, 0.0])
        for wide in ((0.1 * size, 0.05 * size), (0.1 * size, 1.0), (1.0, 0.05 * size)):
            end = begin + np.array([*wide, 0.0])
            found = _scale_issues(cutting(end, begin, begin + 9.0), BOUNDS)
            assert [issue.kind for issue in found] == expected
            assert not found or "the path is 5 times as large as the stock" in found[0].message


class Tools:
    """A process of two tools, and one for all other numbers: (rpm, spindle) of each."""

    path = "part.process.toml"

    def __init__(self, **of_key):
        self.tools = {key: SimpleNamespace(rpm=rpm, spindle=spindle) for key, (rpm, spindle) in of_key.items()}

    def tool(self, number):
        key = str(number) if str(number) in self.tools else "default"
        return (key, self.tools[key]) if key in self.tools else None


TOOLS_OF = Tools(**{"1": (5000.0, "M4"), "2": (None, "M3"), "default": (700.0, "M3")})


@pytest.mark.parametrize("speeds", [False, True], ids=["of the process", "of the program"])
@pytest.mark.parametrize("seed", range(6))
def test_tool_speed_and_hand_of_each_motion_are_those_of_the_last_statements_before_it(seed, speeds):
    """By a loop over motions; speeds of the process count only if the program gives none."""
    random, made = np.random.default_rng(seed), mixed()
    kinds = ["tool_change"] + (["spindle_on", "spindle_ccw", "spindle_off"] if speeds else ["spindle_off"])
    places = np.sort(random.integers(0, 7, 6))
    events = []
    for n, (kind, place) in enumerate(zip(random.choice(kinds, 6), places, strict=True)):
        value = float(random.integers(1, 4)) if kind == "tool_change" else 900.0 + n
        events.append(SimpleNamespace(kind=kind, before=int(place), value=value))
    given = any(event.kind in ("spindle_on", "spindle_ccw") for event in events)
    found = tool_states(replace(made, events=tuple(events)), TOOLS_OF)
    for k in range(7):
        number, rpm, hand = -1, 0.0, 1
        for event in events:
            if event.before <= k and event.kind == "tool_change":
                number = int(event.value)
            elif event.before <= k and event.kind == "spindle_off":
                rpm = 0.0
            elif event.before <= k:
                rpm, hand = event.value, -1 if event.kind == "spindle_ccw" else 1
        key, tool = TOOLS_OF.tool(number)
        if not given and tool.rpm is not None:
            rpm, hand = tool.rpm, -1 if tool.spindle == "M4" else 1
        assert (found.keys[found.tool[k]], found.rpm[k], found.hand[k], found.number[k]) == (key, rpm, hand, number)


@pytest.mark.parametrize("seed", range(6))
def test_segments_are_divided_at_the_places_of_a_displacement(seed):
    """Segment by segment, also where motions have none, and up to the end of the last."""
    rng = np.random.default_rng(seed)
    rows, places = [], []
    for motion in range(1, 9):
        if rng.random() < 0.25:
            continue  # a motion without segments
        bounds = [0.0, *np.sort(rng.uniform(0.05, 0.95, rng.integers(0, 3))), 1.0]
        rows += [(motion, first, last) for first, last in itertools.pairwise(bounds)]
    for motion in range(1, 9):
        places += [(motion, t) for t in np.sort(rng.uniform(0.0, 1.0, rng.integers(0, 4)))]
        if rng.random() < 0.3:
            places.append((motion, 1.0))
    motion, first, last = (np.array(column) for column in zip(*rows, strict=True))
    at_motion, at_t = (np.array(column) for column in zip(*places, strict=True))
    shift = SimpleNamespace(motion=at_motion.astype(int), t=at_t)
    expected = []
    for k, (begin, end) in zip(motion, zip(first, last, strict=True), strict=True):
        cuts = [t for row, t in places if row == k and begin + 1e-9 < t < end - 1e-9]
        expected += [(k, a, b) for a, b in itertools.pairwise([begin, *cuts, end])]
    found = tool_path._divided_at_shift(motion.astype(int), first, last, shift)
    np.testing.assert_allclose(np.column_stack(found), expected, atol=1e-12)
