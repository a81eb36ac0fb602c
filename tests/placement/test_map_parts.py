"""Parts of the map of turns, each against a loop: ways through bins, winding, costs, turns of bins."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.placement import drive, turn_map, turning
from postproc.placement.drive import LeastMargins, Margins
from postproc.placement.turn_map import Blocks, TurnMap


def test_a_way_through_a_bin_is_bad_if_a_column_that_it_touches_is():
    """From place to place on a circle of 8 columns, by the columns between and on both ends."""
    rng = np.random.default_rng(1)
    bad = rng.random(8) < 0.3
    begin, end = rng.integers(-8, 16, (2, 200, 1)) * 0.5, rng.integers(-8, 16, (2, 200, 1)) * 0.5
    for start, stop in zip(begin, end, strict=True):
        rounding = rng.uniform(-1e-12, 1e-12, (2, *start.shape))
        found = turn_map._crosses_forbidden(bad, np.stack([start, stop]) + rounding)
        for n in range(200):
            low, high = sorted((start[n, 0], stop[n, 0]))
            columns = range(int(np.floor(low)), int(np.ceil(high)) + 1)
            assert found[n, 0] == any(bad[column % 8] for column in columns), (low, high)


def test_winding_of_bins_is_the_way_of_the_joints_from_the_end_of_the_bin_before():
    rng = np.random.default_rng(2)
    step, starts = rng.normal(size=(2, 20)), np.array([0, 3, 4, 11])
    found = turn_map._windings(step, starts)
    assert found.shape == (4, 2, 3)
    for k, (first, last) in enumerate(zip(starts, [3, 4, 11, 20], strict=True)):
        for joint in range(2):
            way = np.cumsum(step[joint, first:last])
            expected = [way[-1], min(0.0, way.min()), max(0.0, way.max())]
            np.testing.assert_allclose(found[k, joint], expected, atol=1e-12)


@pytest.mark.parametrize(("step", "count"), [(5.0, 72), (30.0, 12), (7.0, 51)])
def test_turns_of_a_whole_circle_are_even_and_begin_at_half_a_turn(step, count):
    turns = np.degrees(turn_map.turns_of_circle(np.radians(step)))
    assert len(turns) == count
    np.testing.assert_allclose(np.diff(turns), 360.0 / count)
    assert -180.0 - 1e-9 <= turns[0] < -180.0 + 360.0 / count
    assert 0.0 in turns.round(9)


BLOCKS = Blocks(
    first=np.array([0, 1, 3, 6, 8]), block=np.array([0, 1, 1, 2, 2]), share=np.array([1.0, 0.4, 1.0, 0.5, 1.0]),
    cut_length=np.array([0.0, 0.01, 0.04, 0.0, 0.0]),
    is_start=np.array([True, False, False]), is_at_feed=np.array([False, True, False]),
    length=np.array([0.0, 0.05, 0.08]),
    time=np.array([0.0, 2.0, 0.0]), motion=np.array([0, 1, 2]),
)  # fmt: skip


def small_map(**changes) -> TurnMap:
    """Five bins of ten samples, three turns."""
    shape = (5, 3)
    margin = Margins(np.full(shape, 0.5), np.full(shape, 0.7), np.ones(shape), np.ones(shape))
    zero = np.zeros(shape)
    made = TurnMap(
        BLOCKS, np.zeros(10), np.array([-0.1, 0.0, 0.1]), margin, zero, zero, zero, None, np.zeros((5, 3, 6)),
        np.zeros((5, 3, 2, 3)), np.full(shape, 2e-4), np.full(shape, 3e-4),
    )  # fmt: skip
    return replace(made, **changes)


def test_costs_are_shares_of_the_least_squares_over_the_cuts_and_a_little_for_margin():
    """Bins 1 and 2 are cuts of 10 and 40 mm; a turn without margin costs 1 % more over the whole path."""
    error = np.full((5, 3), 2e-4)
    error[1], error[2] = [3e-4, 1e-4, 2e-4], [4e-4, 5e-4, 2e-4]
    bad = np.zeros((5, 3), dtype=bool)
    bad[1, 1] = True
    ease = np.full((5, 3), np.inf)
    ease[2, 0], ease[3, 1] = 0.0, np.radians(15.0)
    margin = Margins(ease, np.full((5, 3), np.inf), np.ones((5, 3)), np.ones((5, 3)))
    costs = turn_map._costs(small_map(u95=error, margin=margin), bad)
    total = 0.01 * (2e-4) ** 2 + 0.04 * (2e-4) ** 2
    share = np.array([0.0, 0.01, 0.04, 0.0, 0.0]) / total
    np.testing.assert_allclose(costs.square_error_cost, share)
    expected = share[:, None] * np.where(bad, 0.0, error) ** 2
    expected[2, 0] += 0.01 * 3 / 10
    expected[3, 1] += 0.01 * np.exp(-1.0) * 2 / 10
    np.testing.assert_allclose(costs.cell, expected, rtol=1e-9, atol=1e-15)
    columns, price = np.array([[2, 0]]), np.array([1e-5, 2e-5])
    grown = [share[2] * ((error[2, c] + p) ** 2 - error[2, c] ** 2) for c, p in zip([2, 0], price, strict=True)]
    np.testing.assert_allclose(costs.cost_of_increase(2, columns, price), [grown], rtol=1e-9)
    none = turn_map._costs(small_map(u95=np.zeros((5, 3))), bad)
    assert not none.square_error_cost.any()


def test_the_error_of_a_map_is_the_deflection_where_the_model_has_none():
    error = np.full((5, 3), 2e-4)
    error[1, 2] = np.nan
    found = small_map(u95=error).error
    assert found[1, 2] == 3e-4
    assert (np.delete(found.ravel(), 5) == 2e-4).all()


def test_reasons_of_a_map_are_those_of_its_margins_speeds_and_bodies():
    hit = np.zeros((5, 3), dtype=bool)
    hit[1, 1] = True
    speed = np.zeros((5, 3))
    speed[2, 2] = 0.96
    jump = np.zeros((5, 3))
    jump[3, 0] = 1.0
    reasons = small_map(hit=hit, speed=speed, jump=jump).reasons(LeastMargins())
    assert reasons[1, 1] == drive.COLLISION
    assert reasons[2, 2] == drive.SPEED
    assert reasons[3, 0] == drive.SINGULAR
    assert np.count_nonzero(reasons) == 3


def test_turns_at_the_ends_of_bins_are_between_those_of_their_block():
    turn = turning.Turn(
        "path", small_map(), LeastMargins(), 0.2, np.array([0.3, 0.7, -0.1]), np.array([0.3, 0.7, -0.1])
    )
    np.testing.assert_allclose(turning.bin_turns(turn), [0.3, 0.3 + 0.4 * 0.4, 0.7, 0.7 - 0.5 * 0.8, -0.1])
    assert turn.range_deg() == pytest.approx((np.degrees(0.1), np.degrees(0.9)))


def test_limits_of_the_hand_keep_the_margin_of_the_joints():
    robot = SimpleNamespace(lower=np.arange(6.0) - 10.0, upper=np.arange(6.0) + 10.0)
    low, high = turn_map._limits(robot, LeastMargins(joint=0.5))
    np.testing.assert_allclose(low, [-7.0 + 0.5, -5.0 + 0.5])
    np.testing.assert_allclose(high, [13.0 - 0.5, 15.0 - 0.5])


@pytest.mark.parametrize(("mode", "words"), [("best", "by one angle for each operation"), ("path", "along the path")])
def test_the_choice_is_told_with_its_range(mode, words):
    turn = turning.Turn(mode, small_map(), LeastMargins(), 0.0, np.zeros(3), np.radians([-10.0, 20.4, 0.0]))
    said = turning._turn_issue(turn)
    assert (said.level, said.kind) == ("info", "redundancy")
    assert said.message.startswith(f"The tool is turned about its axis {words}, from -10° to 20°. ")
    assert said.message.endswith("the cell has no [collision].")
    checked = replace(turn, map=small_map(hit=np.zeros((5, 3), dtype=bool)), of_motion=np.full(3, 0.5))
    assert turning._turn_issue(checked).message == "The tool is turned about its axis by 29° everywhere."


def test_the_price_of_a_way_is_that_of_the_columns_in_the_middle_of_its_bins():
    """Block 1 has bins that end at 0.4 and 1 of its path: their middles are at 0.2 and 0.7 of the change."""
    shape, steps = (5, 12), np.array([-4, -1, 0, 3, 5])
    zero, wide = np.zeros(shape), np.ones(shape)
    found = TurnMap(
        BLOCKS, np.zeros(10), np.arange(12) * 0.1, Margins(wide, wide, wide, wide), zero, zero, zero, None,
        np.zeros((*shape, 6)), np.zeros((*shape, 2, 3)), zero, zero,
    )  # fmt: skip
    cell = np.random.default_rng(5).uniform(1.0, 2.0, shape)
    prices = [
        turn_map._LineSearch(
            found, zero > 0.0, turn_map._Costs(values, zero, np.zeros(5)), np.zeros(2),
            np.full(2, -9.0), np.full(2, 9.0), turn_at_feed=True, is_circle=True,
        ).crossing(1, slice(1, 3), turn_map._Changes(steps, np.abs(steps) * 0.1)).price
        for values in (cell, zero)
    ]  # fmt: skip
    for target in range(12):
        for column, step in enumerate(steps):
            middles = [int(np.rint(target - step + share * step)) % 12 for share in (0.2, 0.7)]
            expected = cell[1, middles[0]] + cell[2, middles[1]]
            assert prices[0][target, column] - prices[1][target, column] == pytest.approx(expected, abs=1e-12)
