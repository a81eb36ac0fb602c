"""The line through small maps whose open cells leave one line, or two."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.placement.drive import LeastMargins, Margins, wrap_angles
from postproc.placement.turn_map import BlockedMap, Blocks, TurnMap, line_through, turns_of_circle
from tests.kr270 import ROBOT

COLUMNS = 12
STEP = np.radians(30.0)


def made(seed, blocks=4, wide=2, closed=0.3):
    """A random map with one bin a block; A6 follows the turn, so that a whole circle is one turn of A6."""
    rng = np.random.default_rng(seed)
    shape = (blocks, COLUMNS)
    offset = turns_of_circle(STEP)
    q = np.zeros((*shape, 6))
    q[..., 1], q[..., 2], q[..., 4] = -1.2, 1.9, 0.9
    q[..., 5] = wrap_angles(offset + rng.uniform(-0.2, 0.2, (blocks, 1)))
    margin = np.where(rng.random(shape) < closed, -1.0, 1.0)
    far = np.full(shape, 1.0)
    error = rng.uniform(1e-4, 3e-4, shape)
    zero = np.zeros(shape)
    winding = np.zeros((*shape, 2, 3))
    step = wrap_angles(np.diff(q[:, :1, 5], axis=0, prepend=q[:1, :1, 5]))
    winding[:, :, 1, 0] = step
    winding[:, :, 1, 1], winding[:, :, 1, 2] = np.minimum(step, 0.0), np.maximum(step, 0.0)
    first = np.arange(blocks)
    length = np.full(blocks, np.degrees(STEP) * wide * 1.01e-3)
    begins = first == 0
    own = Blocks(
        first,
        first,
        np.ones(blocks),
        np.where(begins, 0.0, 0.01),
        begins,
        ~begins,
        length,
        np.full(blocks, 100.0),
        first,
    )
    margins = Margins(margin, far, far, far)
    return TurnMap(own, np.zeros(blocks), offset, margins, zero, zero, zero, None, q, winding, error, error)


def test_a_line_never_winds_a6_past_its_limits():
    """Free cells lead the line round and round: after 350° of A6 it must stop."""
    found = made(0, blocks=24, closed=0.0)
    ring = np.full(found.margin.joint.shape, -1.0)
    for k in range(24):
        ring[k, [(k - 1) % COLUMNS, k % COLUMNS]] = 1.0
    found = replace(found, margin=replace(found.margin, joint=ring))
    line = line_through(ROBOT, found, LeastMargins(), np.zeros(6), turn_at_feed=True, is_circle=True)
    assert isinstance(line, BlockedMap)
    wide = replace(ROBOT, upper=ROBOT.upper + np.radians(200.0))
    assert not isinstance(
        line_through(wide, found, LeastMargins(), np.zeros(6), turn_at_feed=True, is_circle=True), BlockedMap
    )


def test_one_turn_for_each_operation_changes_on_rapid_moves_alone():
    found = made(3, blocks=5, closed=0.0)
    blocks = replace(found.blocks, is_at_feed=np.array([False, True, False, True, True]))
    found = replace(found, blocks=blocks)
    line = line_through(ROBOT, found, LeastMargins(), np.zeros(6), turn_at_feed=False, is_circle=True)
    assert line.knots[0] == pytest.approx(line.knots[1])
    assert line.knots[2] == pytest.approx(line.knots[3]) == pytest.approx(line.knots[4])
    assert line.knots[1] != pytest.approx(line.knots[2])


def opened(found, *columns):
    """The map with no other cells than these of its columns, one tuple for each block."""
    margin = np.full(found.margin.joint.shape, -1.0)
    for block, free in enumerate(columns):
        margin[block, list(free)] = 1.0
    return replace(found, margin=replace(found.margin, joint=margin))


@pytest.mark.parametrize(("steady", "chosen"), [(1.9, 3), (1.75, 4)])
def test_of_two_turns_the_one_with_the_smaller_sum_of_squared_errors_is_taken(steady, chosen):
    """1 and 2.4 against 1.9 twice and 1.75 twice: cubes would take the second at both, sums the first at both."""
    found = opened(made(4, blocks=3), (3, 4), (3, 4), (3, 4))
    error = np.full(found.u95.shape, 1e-4)
    error[1:, 3], error[1:, 4] = (1e-4, 2.4e-4), steady * 1e-4
    found = replace(found, u95=error, deflection=error)
    line = line_through(ROBOT, found, LeastMargins(), np.zeros(6), turn_at_feed=False, is_circle=True)
    assert np.rint((line.knots - found.offset[0]) / STEP).tolist() == [chosen] * 3


@pytest.mark.parametrize(("length", "driven"), [(9.9, False), (10.1, True)])
def test_on_rapid_moves_the_turn_changes_by_three_degrees_per_millimetre_at_most(length, driven):
    found = opened(made(5, blocks=4), (5,), (5,), (5, 6), (6,))
    cuts = np.array([False, True, False, True])
    blocks = replace(found.blocks, is_at_feed=cuts, length=np.where(cuts, 0.1, 1e-3 * length))
    line = line_through(
        ROBOT, replace(found, blocks=blocks), LeastMargins(), np.zeros(6), turn_at_feed=False, is_circle=True
    )
    assert isinstance(line, BlockedMap) != driven


@pytest.mark.parametrize("axis", [3, 5])
@pytest.mark.parametrize(("start", "driven"), [(-60.0, True), (300.0, False)])
def test_a4_and_a6_are_counted_from_the_start_each_by_itself(axis, start, driven):
    """The line turns the joint by 90°: from 300° that is past its limit, though the pose at -60° is the same."""
    found = opened(made(6, blocks=4), (4,), (4, 5), (5, 6), (6, 7))
    q = found.q.copy()
    q[..., [3, 5]] = 0.0
    q[..., axis] = found.offset
    found = replace(found, q=q, winding=np.zeros_like(found.winding))
    begin = np.zeros(6)
    begin[axis] = np.radians(start)
    line = line_through(ROBOT, found, LeastMargins(), begin, turn_at_feed=True, is_circle=True)
    assert isinstance(line, BlockedMap) != driven


@pytest.mark.parametrize(("lengths", "columns"), [((35.0, 350.0), [5, 5, 6, 6]), ((350.0, 35.0), [5, 6, 6, 6])])
def test_of_lines_with_one_error_the_one_that_turns_on_the_longer_piece_is_taken(lengths, columns):
    found = opened(made(7, blocks=4), (5,), (5, 6), (5, 6), (6,))
    blocks = replace(found.blocks, length=1e-3 * np.array([10.0, *lengths, 10.0]))
    error = np.full(found.u95.shape, 1e-4)
    found = replace(found, blocks=blocks, u95=error, deflection=error)
    line = line_through(ROBOT, found, LeastMargins(), np.zeros(6), turn_at_feed=True, is_circle=True)
    assert np.rint((line.knots - found.offset[0]) / STEP).tolist() == columns


@pytest.mark.parametrize("axis", [3, 5])
@pytest.mark.parametrize(("last", "driven"), [(-20.0, True), (-5.0, False)])
def test_a4_and_a6_are_counted_on_through_a_joint_interpolation(axis, last, driven):
    """0°, a cut to 170°, a joint interpolation to -160°, which is 200°, a cut to 340° or 355°; the limit is 350°."""
    found = opened(made(8, blocks=4), *[(5,)] * 4)
    angles = np.radians([0.0, 170.0, -160.0, last])
    q, winding = found.q.copy(), np.zeros_like(found.winding)
    q[..., [3, 5]] = 0.0
    q[..., axis] = angles[:, None]
    for block, way in ((1, 170.0), (3, last + 160.0)):
        winding[block, :, [3, 5].index(axis), 0] = winding[block, :, [3, 5].index(axis), 2] = np.radians(way)
    blocks = replace(found.blocks, is_start=np.array([True, False, True, False]))
    found = replace(found, q=q, winding=winding, blocks=blocks)
    line = line_through(ROBOT, found, LeastMargins(), np.zeros(6), turn_at_feed=True, is_circle=True)
    assert isinstance(line, BlockedMap) != driven


def test_a_joint_interpolation_may_lead_to_any_turn():
    """Two cuts at one turn each, far from each other: only a joint interpolation between them may change it."""
    found = opened(made(9, blocks=4, closed=0.0), (2,), (2,), (8,), (8,))
    assert isinstance(
        line_through(ROBOT, found, LeastMargins(), np.zeros(6), turn_at_feed=True, is_circle=True), BlockedMap
    )
    blocks = replace(found.blocks, is_start=np.array([True, False, True, False]))
    line = line_through(
        ROBOT, replace(found, blocks=blocks), LeastMargins(), np.zeros(6), turn_at_feed=True, is_circle=True
    )
    assert np.rint((line.knots - found.offset[0]) / STEP).tolist() == [2, 2, 8, 8]
