"""Blocks and bins of a path, and the turns in them, by sums over the program as it is written."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.placement import turn_map, turning
from postproc.placement.samples import SPINDLE_AXES, PathSamples
from postproc.placement.turn_map import Blocks
from postproc.under_load import RobotInCell
from tests.placement.setting import cell, read_with_robot

TEXT = "G21 G90\nG0 X1300 Y0 Z60\nG1 Z0 F600\n" + "".join(
    f"G1 X{1300 + 4 * k} F{1200 + 300 * (k % 2)}\n" for k in range(1, 8)
)
TEXT += "G1 X1528 F3000\nG0 Z60\nG0 X1400\nG1 Z0 F1500\nG1 Y90\n"
LENGTHS = np.array([60.0, *[4.0] * 7, 200.0, 60.0, 128.0, 60.0, 90.0]) * 1e-3
"""Of all motions but the first, which goes to the start by joint interpolation [m]."""
FEEDS = np.array([600, *[1200 + 300 * (k % 2) for k in range(1, 8)], 3000, np.inf, np.inf, 1500, 1500]) / 6e4


@pytest.fixture(scope="module")
def path():
    own = cell()
    program, model = read_with_robot(TEXT, own)
    samples = PathSamples.of(program, RobotInCell.of(model, own), None)
    return samples, Blocks.of(samples)


def test_samples_are_at_most_twenty_millimetres_apart_and_have_the_time_of_their_feed(path):
    samples, _ = path
    motion, t = samples.sample.motion, samples.sample.t
    counts = np.ceil(LENGTHS / 0.020 - 1e-9).astype(int)
    assert np.bincount(motion).tolist() == [1, *counts]
    np.testing.assert_allclose(t, np.concatenate([[1.0], *(np.arange(1, n + 1) / n for n in counts)]), atol=1e-12)
    times = np.repeat(LENGTHS / counts / FEEDS, counts)
    np.testing.assert_allclose(samples.time, [np.inf, *np.where(times > 0.0, times, np.inf)], rtol=1e-9)
    assert samples.travel[1:].sum() == pytest.approx(LENGTHS.sum())
    np.testing.assert_array_equal(samples.is_at_feed, [False, *np.repeat(np.isfinite(FEEDS), counts)])


def test_blocks_are_motions_or_runs_of_ten_millimetres(path):
    """A rapid begins another block, and so does each motion behind another 10 mm of a run."""
    samples, blocks = path
    number = blocks.block[np.searchsorted(blocks.first, np.arange(len(samples)), side="right") - 1]
    of_motion = [int(number[samples.sample.motion == k][-1]) for k in range(len(LENGTHS) + 1)]
    ends = np.flatnonzero(np.diff([*of_motion, -1]))
    assert blocks.motion.tolist() == ends.tolist()
    expected, begin, length, rapid = [0], 0, 0.0, None
    for motion_length, feed in zip(LENGTHS, FEEDS, strict=True):
        if rapid is not np.isinf(feed):
            rapid, length, begin = np.isinf(feed), 0.0, expected[-1] + 1
            steps = [0]
        steps.append(int(length / 0.010 + 1e-9))
        begin += int(steps[-1] != steps[-2])
        expected.append(begin)
        length += motion_length
    assert of_motion == expected
    of_block = np.array(of_motion[1:])
    np.testing.assert_allclose(blocks.length, np.bincount(of_block, LENGTHS), atol=1e-12)
    times = np.where(np.isfinite(FEEDS), LENGTHS / FEEDS, 0.0)
    np.testing.assert_allclose(blocks.time, np.bincount(of_block, times), rtol=1e-9)
    assert blocks.is_start.tolist() == [True, *[False] * (len(blocks.length) - 1)]
    is_cut = np.bincount(of_block, np.isfinite(FEEDS)) > 0
    np.testing.assert_array_equal(blocks.is_at_feed, is_cut)


def test_bins_have_the_length_of_their_cuts(path):
    samples, blocks = path
    ends = [*blocks.first[1:], len(samples)]
    travel = np.where(samples.is_at_feed, samples.segments.length[samples.sample.motion], 0.0)
    step = np.where(
        np.diff(samples.sample.motion, prepend=-1) != 0, samples.sample.t, np.diff(samples.sample.t, prepend=0)
    )
    lengths = [sum(travel[first:end] * step[first:end]) for first, end in zip(blocks.first, ends, strict=True)]
    np.testing.assert_allclose(blocks.cut_length, lengths, atol=1e-7)
    assert blocks.cut_length.sum() == pytest.approx(LENGTHS[np.isfinite(FEEDS)].sum(), rel=1e-5)


@pytest.mark.parametrize("seed", range(8))
def test_a_run_is_divided_where_another_step_of_its_length_begins(seed):
    rng = np.random.default_rng(seed)
    length = rng.uniform(0.0, 0.009, 40) * (rng.random(40) < 0.9)
    starts_run = (rng.random(40) < 0.15) | (np.arange(40) == 0)
    expected, block, step, travelled = [], -1, 0, 0.0
    for k in range(40):
        if starts_run[k]:
            travelled, step, block = 0.0, 0, block + 1
        elif int(travelled / 0.010) != step:
            step, block = int(travelled / 0.010), block + 1
        expected.append(block)
        travelled += length[k]
    assert turn_map._block_of_motion(length, starts_run, 0.010).tolist() == expected


def test_bins_divide_the_samples_of_a_block_evenly_and_state_their_share_of_its_path(path):
    samples, blocks = path
    travelled = np.cumsum(np.where(samples.sample.motion == 0, 0.0, samples.travel))
    for block in range(1, len(blocks.length)):
        bins = np.flatnonzero(blocks.block == block)
        ends = np.append(blocks.first, len(samples))[bins + 1] - 1
        before = travelled[blocks.first[bins[0]] - 1]
        np.testing.assert_allclose(blocks.share[bins], (travelled[ends] - before) / blocks.length[block], atol=1e-9)
        counts = np.diff(np.append(blocks.first, len(samples)))[bins]
        assert len(bins) == min(6, counts.sum())
        assert np.ptp(counts) <= 1
    np.testing.assert_array_equal(blocks.last, blocks.first[1:] - 1)


def test_the_turn_changes_in_proportion_to_the_path_of_each_block(path):
    samples, blocks = path
    knots = np.random.default_rng(2).uniform(-1.0, 1.0, len(blocks.length))
    at_motion = np.append(0.0, np.cumsum(LENGTHS))
    begins = np.where(blocks.is_start, knots, np.append(knots[0], knots[:-1]))
    of_motion, at_samples = blocks.turn_of_motions(samples, knots), turning._sample_turns(samples, blocks, knots)
    for k in range(1, len(LENGTHS) + 1):
        block = int(np.searchsorted(blocks.motion, k))
        total = blocks.length[1 : block + 1].sum()
        share = 1.0 - (total - at_motion[k]) / blocks.length[block]
        expected = begins[block] + share * (knots[block] - begins[block])
        assert of_motion[k] == pytest.approx(expected, abs=1e-9)
        previous = expected if k == 1 and blocks.is_start[block] else of_motion[k - 1]
        rows = samples.sample.motion == k
        t = samples.sample.t[rows]
        np.testing.assert_allclose(at_samples[rows], previous + t * (expected - previous), atol=1e-9)


def test_axes_point_where_their_names_say():
    assert SPINDLE_AXES.keys() == {"+X", "-X", "+Z", "-Z"}
    for name, direction in SPINDLE_AXES.items():
        assert direction == tuple(float(f"{name[0]}1") * (letter == name[1]) for letter in "XYZ")


@pytest.mark.parametrize(("blocks_at_most", "bins_at_most"), [(1000, 2500), (7, 2500), (1000, 30), (5, 12), (1000, 1)])
def test_long_paths_have_longer_blocks_and_fewer_bins(path, monkeypatch, blocks_at_most, bins_at_most):
    """A block is a share of the whole path at least; the bins of all blocks together are limited, one each at least."""
    samples, _ = path
    monkeypatch.setattr(turn_map, "MOST_BLOCKS", blocks_at_most)
    monkeypatch.setattr(turn_map, "MOST_BINS", bins_at_most)
    blocks = Blocks.of(samples)
    step = max(0.010, LENGTHS.sum() / blocks_at_most)
    rapid = [True, *np.isinf(FEEDS)]
    block, begin, number, expected = 0, 0.0, 0, [0]
    for k, length in enumerate(LENGTHS, 1):
        if k == 1 or rapid[k] != rapid[k - 1]:
            block, begin, number = block + 1, 0.0, 0
        elif int(begin / step + 1e-9) != number:
            block, number = block + 1, int(begin / step + 1e-9)
        expected.append(block)
        begin += length
    assert np.repeat(np.arange(len(blocks.motion)), np.diff([-1, *blocks.motion])).tolist() == expected
    counts = np.bincount(np.array(expected)[samples.sample.motion])
    most = min(6, max(1, bins_at_most // len(counts)))
    assert np.bincount(blocks.block).tolist() == [min(most, count) for count in counts]


def test_joint_interpolations_are_blocks_of_their_own_without_length(path):
    """Between them the path is divided anew; a block after one continues from it."""
    text = "DEF part()\n$VEL.CP=0.05\n" + "".join(
        f"{word} {{X {x},Y 0,Z 0,A 180,B 0,C 180}}\n"
        for word, x in [("PTP", 0), ("LIN", 4), ("LIN", 8), ("PTP", 30), ("PTP", 50), ("LIN", 54), ("LIN", 80)]
    )
    own = cell(base=(1500.0, 0.0, 700.0))
    program, model = read_with_robot(text + "END\n", own, "krl")
    samples = PathSamples.of(program, RobotInCell.of(model, own), None)
    blocks = Blocks.of(samples)
    assert blocks.motion.tolist() == [0, 2, 3, 4, 6]
    assert blocks.is_start.tolist() == [True, False, True, True, False]
    np.testing.assert_allclose(blocks.length, [0.0, 0.008, 0.0, 0.0, 0.030], atol=1e-9)
    np.testing.assert_allclose(blocks.time, [0.0, 0.16, 0.0, 0.0, 0.6], atol=1e-9)
    assert blocks.is_at_feed.tolist() == [False, True, False, False, True]
    assert np.isinf(samples.time[samples.program.motions.kind[samples.sample.motion] == 2]).all()
    knots = np.array([0.1, 0.3, -0.5, 0.7, 0.2])
    turn = blocks.turn_of_motions(samples, knots)
    np.testing.assert_allclose(turn, [0.1, 0.2, 0.3, -0.5, 0.7, 0.7 - 0.5 * 4 / 30, 0.2], atol=1e-9)
