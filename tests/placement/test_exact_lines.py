"""The line through random maps with all of its terms, against a plain count of every state that a line can have."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.placement.drive import LeastMargins, Margins
from postproc.placement.turn_map import BlockedMap, Blocks, TurnMap, line_through
from tests.kr270 import ROBOT

TURN = 2.0 * np.pi
KEEP = LeastMargins()
WRIST = [3, 5]


def wrapped(angle):
    return (angle + np.pi) % TURN - np.pi


def random_map(seed, columns, step):
    """Seven blocks of one to three bins: two joint interpolations, cuts, and a rapid move."""
    rng = np.random.default_rng(seed)
    counts = np.array([1, 2, 3, 1, 1, 2, 2])
    begins = np.array([True, False, False, False, True, False, False])
    cuts = np.array([False, True, True, False, False, True, True])
    bins, blocks = counts.sum(), len(counts)
    share = np.concatenate([[*np.sort(rng.uniform(0.1, 0.9, count - 1)), 1.0] for count in counts])
    samples = rng.integers(1, 5, bins)
    first = np.cumsum(samples) - samples
    length = np.degrees(step) * 1e-3 * rng.uniform(1.2, 2.8, blocks) / np.where(cuts, 1.0, 3.0)
    time = np.where(cuts, np.degrees(step) / 30.0 * rng.uniform(1.2, 2.8, blocks), 0.0)
    block = np.repeat(np.arange(blocks), counts)
    cut_length = np.random.default_rng(100 + seed).uniform(1e-3, 4e-3, bins) * cuts[block]
    division = Blocks(first, block, share, cut_length, begins, cuts, length, time, np.arange(blocks))
    shape = (bins, columns)
    offset = (np.arange(columns) - columns // 2) * step
    winding = np.zeros((*shape, 2, 3))
    q = rng.uniform(-0.5, 0.5, (*shape, 6))
    way = rng.uniform(-0.4, 0.4, (*shape, 2)) + rng.choice([-1.6, 1.6], (bins, 1, 2))
    q[..., WRIST] = wrapped(rng.uniform(-3.0, 3.0, 2) + np.cumsum(way, axis=0) + offset[:, None] * [0.3, 1.0])
    winding[..., 0] = way
    winding[..., 1] = np.minimum(way, 0.0) - rng.uniform(0.0, 0.3, (*shape, 2))
    winding[..., 2] = np.maximum(way, 0.0) + rng.uniform(0.0, 0.3, (*shape, 2))
    joint, wrist = rng.uniform(KEEP.joint, 0.5, (2, *shape))
    joint[rng.random(shape) < 0.12] = -1.0
    u95 = rng.uniform(1e-4, 4e-4, shape)
    u95[rng.random(shape) < 0.1] = np.nan
    base = np.repeat(rng.uniform(-0.4, 0.4, bins) * step, samples)
    speed, rate = rng.uniform(0.0, 0.6, shape), rng.uniform(0.0, 1.5, shape)
    margin = Margins(joint, wrist, np.ones(shape), np.ones(shape))
    zero, deflection = np.zeros(shape), rng.uniform(1e-4, 4e-4, shape)
    return TurnMap(division, base, offset, margin, speed, zero, rate, None, q, winding, u95, deflection)


class Count:
    """Every line through a map, block by block: of lines with one turn and equal A4 and A6 the cheapest stays."""

    def __init__(self, turns, start, *, at_feed, is_circle):
        self.turns, self.start, self.at_feed, self.is_circle = turns, start[WRIST], at_feed, is_circle
        self.count = len(turns.offset)
        self.step = turns.offset[1] - turns.offset[0]
        self.lower, self.upper = ROBOT.lower[WRIST] + KEEP.joint, ROBOT.upper[WRIST] - KEEP.joint
        self.open = turns.margin.joint >= KEEP.joint
        self.ends = np.append(turns.blocks.first[1:], len(turns.base)) - 1
        self.samples = np.diff(np.append(turns.blocks.first, len(turns.base)))
        self.error = np.where(np.isnan(turns.u95), turns.deflection, turns.u95)
        self.cut_length = turns.blocks.cut_length
        least = [
            min([e for e, free in zip(*row, strict=True) if free], default=0.0)
            for row in zip(self.error, self.open, strict=True)
        ]
        self.total = float(sum(n * e**2 for n, e in zip(self.cut_length, least, strict=True)))

    def cell(self, k, column, added=0.0):
        """Cost of a bin: its squared error, and up to 1 % of the whole for missing margin."""
        ease = min(self.turns.margin.joint[k, column], self.turns.margin.wrist[k, column])
        squares = self.cut_length[k] * (self.error[k, column] + added) ** 2 / self.total
        return squares + 0.01 * np.exp(-ease / np.radians(15.0)) * self.samples[k] / self.samples.sum()

    def begun(self, states, bins):
        """After a joint interpolation; it is reached from the cheapest state of each turn."""
        cheapest: dict[int, tuple] = {}
        for state in states:
            if state[1] not in cheapest or state[0] < cheapest[state[1]][0]:
                cheapest[state[1]] = state
        for cost, _, angle, path in cheapest.values() if states else [(0.0, 0, self.start, ())]:
            for column in range(self.count):
                hand = self.turns.q[bins[-1], column][WRIST]
                reached = angle + wrapped(hand - angle)
                if all(self.open[k, column] for k in bins) and self.fits(reached):
                    turning = 0.003 * 0.1 * np.abs(reached - angle).max()
                    cells = sum(self.cell(k, column) for k in bins)
                    yield cost + turning + cells, column, reached, (*path, self.turns.offset[column])

    def fits(self, angle):
        return bool((angle >= self.lower).all() and (angle <= self.upper).all())

    def changes(self, b, bins):
        """Changes of the column on a block: 3°/mm on rapids, 1°/mm and 30°/s on cuts, 60° a bin, 170°."""
        blocks = self.turns.blocks
        millimetres = 1e3 * blocks.length[b]
        if blocks.is_at_feed[b] and not self.at_feed:
            return [0]
        degrees = min(millimetres, 30.0 * blocks.time[b]) if blocks.is_at_feed[b] else 3.0 * millimetres
        limit = np.radians(min(degrees, 60.0 * len(bins), 170.0))
        moved = self.base_change(bins)
        steps = range(1 - self.count, self.count)
        return [k for k in steps if abs(k * self.step + moved) <= limit]

    def base_change(self, bins):
        return self.turns.base[self.ends[bins[-1]]] - self.turns.base[self.ends[bins[0] - 1]]

    def advanced(self, states, b, bins):
        """After a block on which the turn changes with the path."""
        turns, blocks = self.turns, self.turns.blocks
        millimetres = max(1e3 * blocks.length[b], 1.0)
        changes = self.changes(b, bins)
        for cost, source, start, path in states:
            for change in changes:
                turned = abs(change * self.step + self.base_change(bins))
                share_of_fastest = np.degrees(turned) / millimetres
                angle, value = start, cost + 0.003 * turned * (1.0 + share_of_fastest)
                shares = [0.0, *blocks.share[bins]]
                is_free = self.is_circle or 0 <= source + change < self.count
                for k, begin, end in zip(bins, shares[:-1], shares[1:], strict=True):
                    low, high = sorted((source + change * begin, source + change * end))
                    crossed = range(int(np.floor(low + 1e-9)), int(np.ceil(high - 1e-9)) + 1)
                    is_free = is_free and all(self.open[k, column % self.count] for column in crossed)
                    here, there = (round(source + change * share) % self.count for share in (begin, end))
                    middle = round(source + change * 0.5 * (begin + end)) % self.count
                    value += self.cell(k, middle, 5e-5 * share_of_fastest)
                    if blocks.is_at_feed[b] and len(changes) > 1:
                        fastest = abs(change) * self.step / blocks.time[b]
                        is_free = is_free and turns.speed[k, there] + turns.rate[k, there] * fastest <= 1.0
                    winding = turns.winding[k, here]
                    is_free = is_free and self.fits(angle + winding[:, 1]) and self.fits(angle + winding[:, 2])
                    angle = angle + winding[:, 0]
                    angle = angle + wrapped(turns.q[k, there][WRIST] - turns.q[k, here][WRIST])
                    is_free = is_free and self.fits(angle)
                if is_free:
                    moved = path[-1] + change * self.step
                    yield value, (source + change) % self.count, angle, (*path, moved)

    def best(self):
        """Return the cheapest line as cost and turns (B,), or the block that cannot be passed."""
        states: list[tuple] = []
        blocks = self.turns.blocks
        for b in range(len(blocks.length)):
            bins = np.flatnonzero(blocks.block == b)
            following = self.begun(states, bins) if blocks.is_start[b] else self.advanced(states, b, bins)
            cheapest: dict[tuple, tuple] = {}
            for state in following:
                key = (state[1], *np.round(state[2], 6))
                if key not in cheapest or state[0] < cheapest[key][0]:
                    cheapest[key] = state
            states = list(cheapest.values())
            if not states:
                return b
        cost, _, _, turn = min(states, key=lambda state: state[0])
        last = self.ends[[np.flatnonzero(blocks.block == b)[-1] for b in range(len(blocks.length))]]
        return cost, np.array(turn) + self.turns.base[last]


def agree(turns, start, **options):
    """Compare both lines; return whether there is one."""
    line = line_through(ROBOT, turns, KEEP, start, turn_at_feed=options["at_feed"], is_circle=options["is_circle"])
    expected = Count(turns, start, **options).best()
    if isinstance(line, BlockedMap):
        assert line.block == expected
        return False
    cost, knots = expected
    assert line.cost == pytest.approx(cost, rel=1e-9)
    np.testing.assert_allclose(line.knots, knots, atol=1e-9)
    return True


def start_of(seed):
    start = np.zeros(6)
    start[WRIST] = np.random.default_rng(seed).uniform(-4.0, 4.0, 2)
    return start


@pytest.mark.parametrize("at_feed", [True, False])
def test_the_line_on_a_circle_of_turns_is_the_cheapest_of_all(at_feed):
    lines = [
        agree(random_map(seed, 8, np.radians(45.0)), start_of(seed), at_feed=at_feed, is_circle=True)
        for seed in range(12)
    ]
    assert 3 <= sum(lines) < 12


@pytest.mark.parametrize("at_feed", [True, False])
def test_the_line_in_a_band_of_turns_is_the_cheapest_of_all(at_feed):
    lines = [
        agree(random_map(seed, 7, np.radians(2.0)), start_of(seed), at_feed=at_feed, is_circle=False)
        for seed in range(20, 32)
    ]
    assert 3 <= sum(lines) < 12


def test_a_change_of_one_cost_would_be_noticed():
    turns, start = random_map(0, 8, np.radians(45.0)), start_of(0)
    line = line_through(ROBOT, turns, KEEP, start, turn_at_feed=True, is_circle=True)
    dearer = replace(turns, u95=1.001 * turns.u95, deflection=turns.deflection)
    cost, _ = Count(dearer, start, at_feed=True, is_circle=True).best()
    assert line.cost != pytest.approx(cost, rel=1e-9)
