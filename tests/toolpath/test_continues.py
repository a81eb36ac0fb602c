"""Which motions continue the line or the arc before them, and where a corner is: cases made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import toolpath
from postproc.poses import Poses
from tests.programs import program
from tests.toolpath.setting import arc

TO = ("LIN", 0, 0, 0)
QUARTER = ("CIRC", 20, 20, 0, 0, 20, 0, 90.0, (0, 0, 1))


def path_of(moves, **fields):
    """A program whose first motion leads to (0, 0, 0), and which of the others continue."""
    made = program([TO, *moves])
    if fields:
        made = replace(made, motions=replace(made.motions, **fields))
    return made, toolpath.segments(made, np.eye(4))


def continued(moves, **fields):
    return toolpath.continues(*path_of(moves, **fields)).tolist()


def around(axis, degrees, begin=(20, 20, 0), centre=(0, 20, 0)):
    """An arc of some degrees about an axis through (0, 20, 0), after a quarter about Z; its normal is the axis."""
    return arc(begin, np.array(axis) / np.linalg.norm(axis), centre, degrees)


LINES = {
    "straight on": ([("LIN", 20, 0, 0), ("LIN", 50, 0, 0)], True),
    "within its digits": ([("LIN", 20, 0.0049, 0), ("LIN", 40, 0, 0)], True),
    "beside the line": ([("LIN", 20, 0.0051, 0), ("LIN", 40, 0, 0)], False),
    "above the line": ([("LIN", 20, 0, 0.0051), ("LIN", 40, 0, 0)], False),
    "a corner": ([("LIN", 20, 0, 0), ("LIN", 20, 30, 0)], False),
    "back": ([("LIN", 20, 0, 0), ("LIN", 5, 0, 0)], False),
    "back beyond the start": ([("LIN", 20, 0, 0), ("LIN", -5, 0, 0)], False),
    "one that is no line": ([("LIN", 0.0049, 0, 0), ("LIN", 30, 0, 0)], False),
    "one that hardly is": ([("LIN", 0.0051, 0, 0), ("LIN", 30, 0, 0)], True),
    "before one that is no line": ([("LIN", 30, 0, 0), ("LIN", 30.0049, 0, 0)], False),
    "rapid after cutting": ([("LIN", 20, 0, 0), ("RAPID", 50, 0, 0)], False),
    "a PTP": ([("PTP", 20, 0, 0), ("PTP", 50, 0, 0)], False),
    "an arc after its tangent": ([("LIN", 20, 0, 0), ("CIRC", 40, 20, 0, 20, 20, 0, 90.0, (0, 0, 1))], False),
}


@pytest.mark.parametrize("case", LINES)
def test_a_line_continues_one_that_leads_on(case):
    moves, expected = LINES[case]
    assert continued(moves) == [False, False, expected]


def leaving(degrees):
    """An arc in the same plane that leaves the quarter at a corner."""
    corner = np.radians(degrees)
    return around((0, 0, 1), 50.0, centre=(20 - 20 * np.cos(corner), 20 - 20 * np.sin(corner), 0))


def tilted(degrees):
    """An arc whose plane is turned about the tangent at the division, (0, 1, 0): there is no corner."""
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    return around((sine, 0, cosine), 50.0, centre=(20 - 20 * cosine, 20, 20 * sine))


ARCS = {
    "the same circle": (around((0, 0, 1), 50.0), True),
    "the other way round": (around((0, 0, -1), 50.0), False),
    "a smaller one": (around((0, 0, 1), 50.0, centre=(2.2, 20, 0)), False),
    "a little smaller one": (around((0, 0, 1), 50.0, centre=(1.8, 20, 0)), True),
    "a larger one": (around((0, 0, 1), 50.0, centre=(-2.2, 20, 0)), False),
    "with a corner of 4 degrees": (leaving(4.0), True),
    "with a corner of 6 degrees": (leaving(6.0), False),
    "a helix on": (arc((20, 20, 0), np.array([0.0, 0, 1]), (0, 20, 0), 50.0, climb=1.0), True),
    "a steep helix": (arc((20, 20, 0), np.array([0.0, 0, 1]), (0, 20, 0), 50.0, climb=3.0), False),
    "a plane turned by 38 degrees": (tilted(38.0), True),
    "a plane turned by 42 degrees": (tilted(42.0), False),
}


@pytest.mark.parametrize("case", ARCS)
def test_an_arc_continues_one_of_about_the_same_circle(case):
    second, expected = ARCS[case]
    assert continued([QUARTER, second]) == [False, False, expected]


@pytest.mark.parametrize("kind", ["lines", "arcs"])
@pytest.mark.parametrize("what", ["base", "tool"])
def test_motions_in_other_frames_do_not_continue(kind, what):
    moves = [("LIN", 20, 0, 0), ("LIN", 50, 0, 0)] if kind == "lines" else [QUARTER, around((0, 0, 1), 50.0)]
    made, path = path_of(moves)
    assert toolpath.continues(made, path).tolist() == [False, False, True]
    other = replace(made, motions=replace(made.motions, **{what: np.array([0, 0, 1])}))
    assert toolpath.continues(other, path).tolist() == [False, False, False]


def test_the_first_motion_of_another_branch_continues_none():
    made, path = path_of([("LIN", 20, 0, 0), ("LIN", 50, 0, 0), ("LIN", 90, 0, 0)])
    assert toolpath.continues(made, path).tolist() == [False, False, True, True]
    for after, expected in (
        ([-1, 0, 1, 2], [True, True]),
        ([-1, 0, 0, 2], [False, True]),
        ([-1, 0, 1, 1], [True, False]),
    ):
        branches = replace(made, after=np.array(after))
        assert toolpath.continues(branches, path).tolist() == [False, False, *expected]


@pytest.mark.parametrize(("second", "expected"), [(15.0, True), (15.0015, True), (15.002, False), (0.0, False)])
def test_the_tool_turns_by_as_much_per_length(second, expected):
    """10° over 20 mm, then so many over 30 mm: to within a thousandth of a radian per metre, 0.0017° over 30 mm."""
    made = program([TO, ("LIN", 20, 0, 0), ("LIN", 50, 0, 0)])
    target = made.motions.target[:]
    for row, angle in ((1, 10.0), (2, 10.0 + second)):
        target[row, :3, :3] = Rotation.from_euler("y", angle, degrees=True).as_matrix() @ target[row, :3, :3]
    made = replace(made, motions=replace(made.motions, target=Poses.of(target)))
    assert toolpath.continues(made, toolpath.segments(made, np.eye(4))).tolist() == [False, False, expected]


def test_lines_far_from_the_origin_continue_too():
    """The same three lines, displaced: the second continues the first, the third does not."""
    for x, y in ((0, 0), (70, -300)):
        made = program([("LIN", x, y, 5), ("LIN", x + 10, y + 5, 5), ("LIN", x + 30, y + 15, 5), ("LIN", x + 30, y, 5)])
        found = toolpath.continues(made, toolpath.segments(made, np.eye(4)))
        assert found.tolist()[2:] == [True, False]
