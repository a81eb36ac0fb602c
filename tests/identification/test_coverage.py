"""Torques that readings cover, against loops over loads, joints and signs."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.identification.validation import (
    Coverage,
    coverage,
    is_inside_coverage,
    job_share,
    torque_lines,
    torque_record,
)
from postproc.robot import JOINTS

SIGNS = (-1.0, 1.0)


def readings(seed):
    """Torques (L, 6) of loads in configurations; few on some joints, and one joint that is loaded to one side only."""
    rng = np.random.default_rng(seed)
    torque = rng.normal(0.0, [800.0, 700.0, 300.0, 2.0, 20.0, 0.5], (24, 6))
    torque[:, 2] = np.abs(torque[:, 2])
    return torque, np.sort(rng.integers(0, 9, 24)) * 7


def by_loops(torque, config):
    """Largest torques and configurations by joint and sign; and the level of the smallest loads."""
    largest, count = np.zeros((6, 2)), np.zeros((6, 2), dtype=int)
    for joint in range(6):
        for side, sign in enumerate(SIGNS):
            own = [(sign * row[joint], c) for row, c in zip(torque, config, strict=True) if sign * row[joint] > 1.0]
            largest[joint, side] = max((size for size, _ in own), default=0.0)
            count[joint, side] = len({c for _, c in own})
    levels = {c: min(level(row, largest) for row, k in zip(torque, config, strict=True) if k == c) for c in config}
    return largest, count, sorted(levels.values())[min(5, len(levels)) - 1]


def level(row, largest):
    """The torque on the most loaded joint, over the largest one covered in that direction."""
    parts = [max(0.0, sign * row[j]) / largest[j, s] for j in range(6) for s, sign in enumerate(SIGNS) if largest[j, s]]
    return max(parts, default=0.0)


@pytest.mark.parametrize("seed", range(6))
def test_what_loads_cover(seed):
    torque, config = readings(seed)
    found = coverage(torque, config)
    largest, count, least = by_loops(torque, config)
    np.testing.assert_allclose(found.largest, largest)
    np.testing.assert_array_equal(found.configurations, count)
    assert found.least == pytest.approx(least)
    np.testing.assert_array_equal(found.is_covered, count >= 5)
    assert not found.refuted.any()
    refuted = np.random.default_rng(seed).random((6, 2)) < 0.3
    np.testing.assert_array_equal(coverage(torque, config, refuted).is_covered, (count >= 5) & ~refuted)
    for entry, name, sizes, number in zip(torque_record(found), JOINTS, largest, count, strict=True):
        assert (entry.joint, entry.negative_Nm, entry.positive_Nm) == (name, pytest.approx(-sizes[0]), sizes[1])
        assert (entry.negative_configurations, entry.positive_configurations) == tuple(number)


def test_few_configurations_cover_down_to_the_largest_of_their_smallest_loads():
    torque, config = readings(0)
    few = config <= config[3]
    found = coverage(torque[few], config[few])
    assert found.least == pytest.approx(by_loops(torque[few], config[few])[2])
    nothing = coverage(torque[:0], config[:0])
    assert (nothing.least, nothing.largest.any(), nothing.configurations.any()) == (np.inf, False, False)


@pytest.mark.parametrize("seed", range(6))
def test_a_job_is_inside_where_no_joint_is_in_a_direction_or_of_a_size_that_is_not_covered(seed):
    rng = np.random.default_rng(100 + seed)
    torque, config = readings(seed)
    refuted = rng.random((6, 2)) < 0.1
    found = coverage(torque, config, refuted)
    job = rng.normal(0.0, [500.0, 400.0, 100.0, 1.2, 10.0, 0.5], (400, 6)) * rng.uniform(0.0, 1.2, (400, 1))
    job[:, 2] = np.abs(job[:, 2])
    weight = rng.random(400)
    weight /= weight.sum()
    wanted, reasons = [], {}
    for row, part in zip(job, weight, strict=True):
        wrong = []
        for j, name in enumerate(JOINTS):
            for s, sign in enumerate(SIGNS):
                where = f"{('negative', 'positive')[s]} torque on {name}"
                if sign * row[j] <= 1.0:
                    continue
                count = found.configurations[j, s]
                if refuted[j, s]:
                    wrong.append(f"{where}: there the readings contradict the model")
                elif count == 0:
                    wrong.append(f"{where}: no reading has it")
                elif count < 5:
                    wrong.append(f"{where}: {count} of 5 configurations needed have it")
                elif sign * row[j] > found.largest[j, s]:
                    wrong.append(f"{where} beyond {found.largest[j, s]:.0f} N·m")
        if level(row, found.largest) < found.least:
            wrong.append("all torques below those of the smallest loads")
        wanted.append(not wrong)
        for one in wrong:
            reasons[one] = reasons.get(one, 0.0) + part
    assert is_inside_coverage(job, found).tolist() == wanted
    result = job_share("part", job, weight, found)
    assert (result.program, result.share) == ("part", pytest.approx(weight[wanted].sum()))
    assert {one.reason: one.share for one in result.outside} == pytest.approx(reasons)
    assert [one.share for one in result.outside] == sorted((one.share for one in result.outside), reverse=True)


def test_the_table_says_what_is_covered_by_joint_and_sign():
    count = np.array([[5, 6], [4, 0], [7, 8], [5, 5], [5, 5], [5, 9]])
    largest = np.array([[10.0, 20], [30, 0], [50, 60], [70, 80], [90, 100], [110, 120]])
    refuted = np.zeros((6, 2), dtype=bool)
    refuted[2, 1] = True
    found = Coverage(largest, count, refuted, 0.1)
    lines = torque_lines(found, ())
    assert lines[1].split() == ["negative", "positive"]
    assert [line.split() for line in lines[2:5]] == [
        ["A1", "-10", "(5)", "20", "(6)"],
        ["A2", "-30", "(4)", "none"],
        ["A3", "-50", "(7)", "60", "(8)", "off"],
    ]
    assert lines[-2:] == [
        "the model does not record which torques it was identified with",
        "not covered: torques on A2 negative and positive, A3 positive",
    ]
    own = torque_lines(
        replace(found, configurations=np.full((6, 2), 5), refuted=np.zeros((6, 2), dtype=bool)), torque_record(found)
    )
    assert own[1].split() == ["negative", "positive", "identified", "with"]
    assert own[2].split() == ["A1", "-10", "(5)", "20", "(5)", "-10", "…", "20"]
    assert len(own) == 8
