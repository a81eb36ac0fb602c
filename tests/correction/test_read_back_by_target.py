"""What is read back must be what was computed: each quantity of each target alone may differ by its rounding only."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.correction import verify
from postproc.frames import pose_from_xyzabc
from postproc.poses import Poses
from postproc.program import CIRC, LIN, PTP, Carriage
from tests.programs import ends, program

MOTIONS = 4
BASES = pose_from_xyzabc([[1500.0, -200, 700, 0, 0, 0], [900.0, 300, 500, 30, 0, 0]])
TOOLS = pose_from_xyzabc([[0.0, 0, 350, 0, 0, 0], [10.0, 0, 250, 0, 20, 0], [0.0, 0, 150, 0, 0, 0]])
ABOVE, BELOW = 1.2e-6, 0.8e-6
"""Differences [m, rad, m/s] above and below the rounding of printed numbers, 1 µm and 1 µrad."""


def nominal():
    """Four motions in two bases with two of three tools; lines 1 to 4."""
    made = program(
        [("PTP", 0, 0, 0), ("LIN", 10, 0, 0), ("LIN", 20, 5, 0), ("LIN", 20, 5, 30)], bases=BASES, tools=TOOLS
    )
    return replace(made, motions=replace(made.motions, base=np.array([0, 0, 1, 1]), tool=np.array([0, 0, 2, 2])))


def targets():
    """Six targets on these motions, of which two are inserted; they are turned and displaced at random."""
    rng = np.random.default_rng(3)
    motion, t = np.array([0, 1, 1, 2, 2, 3]), np.array([1.0, 0.5, 1.0, 0.3, 1.0, 1.0])
    pose = pose_from_xyzabc(np.column_stack([rng.uniform(-50.0, 50.0, (6, 3)), rng.uniform(-80.0, 80.0, (6, 3))]))
    kind = np.array([PTP, LIN, LIN, CIRC, LIN, LIN])
    made = ends(replace_rows(nominal().motions, motion), pose)
    return replace(made, motion=motion, t=t, kind=kind)


def replace_rows(motions, rows):
    return replace(motions, **{name: getattr(motions, name)[rows] for name in motions.__struct_fields__})


def output():
    """The program that has these targets: two axis targets before them, frames in another order."""
    wanted = targets()
    made = program([("PTP", 0, 0, 0)] * 8, bases=BASES[::-1].copy(), tools=TOOLS[::-1].copy())
    m = nominal().motions
    joints = np.full((8, 6), np.nan)
    joints[[0, 3]] = 0.1
    row = np.array([1, 2, 4, 5, 6, 7])
    pose = np.tile(np.eye(4), (8, 1, 1))
    pose[row] = wanted.pose[:]
    kind, base, tool, feed = np.zeros((4, 8))
    kind[row], base[row], tool[row] = wanted.kind, 1 - m.base[wanted.motion], 2 - m.tool[wanted.motion]
    feed[row] = m.feed[wanted.motion]
    motions = replace(
        made.motions, joints=joints, target=Poses.of(pose), kind=kind.astype(int), base=base.astype(int),
        tool=tool.astype(int), feed=feed,
    )  # fmt: skip
    return replace(made, motions=motions), row


def mismatch(change=None, selected=slice(None)):
    """The issue of a program in which some targets are changed."""
    made, row = output()
    made = made if change is None else change(made, row[selected])
    return verify._mismatch(nominal(), targets(), made, row)


def test_a_program_with_the_frames_in_another_order_and_axis_targets_between_is_the_same():
    assert mismatch() is None


def moved(axis, size):
    """Displace (0 to 2) or turn (3 to 5) a target."""

    def change(made, row):
        pose = made.motions.target[:]
        step = np.zeros(3)
        step[axis % 3] = size
        if axis < 3:
            pose[row, :3, 3] += step
        else:
            pose[row, :3, :3] = pose[row, :3, :3] @ (np.eye(3) + np.cross(np.eye(3), step))
        return replace(made, motions=replace(made.motions, target=Poses.of(pose)))

    return change


def other_feed(size):
    def change(made, row):
        feed = made.motions.feed.copy()
        feed[row] += size
        return replace(made, motions=replace(made.motions, feed=feed))

    return change


def other_frame(name, axis, size):
    """Displace or turn one of the frames of the program: all targets in it differ."""

    def change(made, row):
        frames = getattr(made, name).copy()
        step = np.zeros(3)
        step[axis % 3] = size
        index = getattr(made.motions, name[:-1])[row[0]]
        if axis < 3:
            frames[index, :3, 3] += step
        else:
            frames[index, :3, :3] = frames[index, :3, :3] @ (np.eye(3) + np.cross(np.eye(3), step))
        return replace(made, **{name: frames})

    return change


def other_index(name, value):
    """Give a target another of the frames."""

    def change(made, row):
        column = getattr(made.motions, name).copy()
        column[row] = value
        return replace(made, motions=replace(made.motions, **{name: column}))

    return change


@pytest.mark.parametrize("target", range(6))
@pytest.mark.parametrize("axis", range(6))
def test_a_target_that_is_moved_or_turned_by_more_than_its_rounding_is_an_error_of_its_source_line(target, axis):
    """The message counts the targets that differ and names the line of the first of them."""
    for size in (ABOVE, -ABOVE):
        issue = mismatch(moved(axis, size), target)
        assert (issue.level, issue.kind) == ("error", "read-back")
        assert (issue.source_line, issue.count) == (targets().motion[target] + 1, 1)
        issue = mismatch(moved(axis, size), slice(target, None))
        assert (issue.source_line, issue.count) == (targets().motion[target] + 1, 6 - target)
    for size in (BELOW, -BELOW):
        assert mismatch(moved(axis, size), slice(target, None)) is None


@pytest.mark.parametrize("target", range(1, 6))
def test_another_speed_is_an_error_by_more_than_its_rounding(target):
    for size in (ABOVE, -ABOVE):
        issue = mismatch(other_feed(size), target)
        assert (issue.source_line, issue.count) == (targets().motion[target] + 1, 1)
    for size in (BELOW, -BELOW):
        assert mismatch(other_feed(size), target) is None


def test_a_ptp_has_no_speed_to_compare():
    assert mismatch(other_feed(0.1), 0) is None


@pytest.mark.parametrize(
    ("name", "first", "count", "line"), [("bases", 0, 3, 1), ("bases", 3, 3, 3), ("tools", 0, 3, 1), ("tools", 4, 3, 3)]
)
@pytest.mark.parametrize("axis", range(6))
def test_another_frame_is_an_error_of_all_targets_in_it(name, first, count, line, axis):
    for size in (ABOVE, -ABOVE):
        issue = mismatch(other_frame(name, axis, size), slice(first, None))
        assert (issue.source_line, issue.count) == (line, count)
    assert mismatch(other_frame(name, axis, BELOW), slice(first, None)) is None


@pytest.mark.parametrize(("name", "value"), [("base", 0), ("tool", 1), ("tool", 0), ("kind", CIRC)])
def test_a_target_in_another_frame_or_on_another_kind_of_motion_is_an_error(name, value):
    issue = mismatch(other_index(name, value), 1)
    assert (issue.source_line, issue.count) == (2, 1)


def test_a_program_with_another_number_of_targets_is_an_error_that_names_both_numbers():
    made, row = output()
    issue = verify._mismatch(nominal(), targets(), made, row[:-1])
    assert (issue.level, issue.kind) == ("error", "read-back")
    assert issue.message == "the written program has 5 targets instead of 6"


def carriages():
    """E1 along the nominal motions and along the motions read back [m]: the same at all targets."""
    begin, end = np.array([0.0, 0.5, 0.5, -0.2]), np.array([0.5, 0.5, -0.2, 1.3])
    direction = np.array([1.0, 0.0, 0.0])
    wanted, row = targets(), output()[1]
    read_end = np.full(8, 9.0)
    read_end[row] = [0.5, 0.5, 0.5, 0.5 - 0.3 * 0.7, -0.2, 1.3]
    return Carriage(begin, end, direction), Carriage(np.append(0.0, read_end[:-1]), read_end, direction), wanted, row


@pytest.mark.parametrize("target", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_another_position_of_the_linear_axis_is_an_error_of_the_targets_that_have_it(target, sign):
    nominal_axis, read_axis, wanted, row = carriages()
    made, _ = output()
    for size, count in ((ABOVE, 1), (BELOW, 0)):
        end = read_axis.end.copy()
        end[row[target]] += sign * size
        read = replace(made, carriage=replace(read_axis, end=end))
        issue = verify._mismatch(replace(nominal(), carriage=nominal_axis), wanted, read, row)
        assert (0 if issue is None else issue.count) == count
        assert issue is None or issue.source_line == wanted.motion[target] + 1


def test_a_linear_axis_in_only_one_of_both_programs_is_an_error_of_all_targets():
    nominal_axis, read_axis, wanted, row = carriages()
    made, _ = output()
    for expected, read in (
        (replace(nominal(), carriage=nominal_axis), made),
        (nominal(), replace(made, carriage=read_axis)),
    ):
        issue = verify._mismatch(expected, wanted, read, row)
        assert (issue.source_line, issue.count) == (1, 6)
