"""What a result says of its targets, against loops."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import robot
from postproc.correction.result import Result, statistics
from postproc.elastostatics import Reversals
from postproc.errors import Issue
from tests.programs import program

MADE = program([("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("RAPID", 100, 0, 0), ("LIN", 100, 50, 0)])
EMPTY = Result(MADE, robot.load(robot.find("kuka_kr270")), "+Z", "convert", ())


def test_statistics_are_those_of_cutting_targets():
    rng = np.random.default_rng(2)
    distance, rapid = rng.exponential(size=200), rng.random(200) < 0.3
    found, cutting = statistics(distance, rapid), sorted(d for d, r in zip(distance, rapid, strict=True) if not r)
    n = len(cutting)
    assert found.largest == cutting[-1]
    assert found.mean == pytest.approx(sum(cutting) / n)
    assert found.rms == pytest.approx((sum(d * d for d in cutting) / n) ** 0.5)
    at = 0.95 * (n - 1)
    low = int(at)
    assert found.p95 == pytest.approx(cutting[low] + (at - low) * (cutting[low + 1] - cutting[low]))
    none = statistics(distance, np.ones(200, dtype=bool))
    assert (none.largest, none.rms, none.mean, none.p95) == (0.0, 0.0, 0.0, 0.0)


def test_rows_of_a_result_are_those_of_its_motions():
    before, after = np.array([[3e-4, 0, 4e-4]] * 4), np.array([[0, 1e-6, 0]] * 4)
    result = replace(EMPTY, motion=np.array([1, 1, 2, 3]), t=np.array([0.4, 1, 1, 1]), deviation_before=before)
    result = replace(result, deviation_after=after)
    assert (len(result), result.inserted) == (4, 1)
    assert result.source_line.tolist() == [2, 2, 3, 4]
    assert result.rapid.tolist() == [False, False, True, False]
    np.testing.assert_allclose(result.before, 5e-4)
    np.testing.assert_allclose(result.after, 1e-6)
    assert not result.failed
    assert not replace(result, issues=(Issue("warning", "a", ""),)).failed
    assert replace(result, issues=(Issue("warning", "a", ""), Issue("error", "b", ""))).failed


def test_of_the_reversals_of_one_joint_and_line_the_largest_is_shown_and_twenty_of_all():
    rng = np.random.default_rng(3)
    motion = np.arange(30) % 4
    row, joint, step = rng.integers(0, 30, 200), rng.integers(0, 6, 200), rng.permutation(200) * 1e-6
    fields = {name: np.zeros(200) for name in Reversals.__struct_fields__} | {"row": row, "joint": joint, "step": step}
    result = replace(EMPTY, motion=motion, t=np.ones(30), reversals=Reversals(**fields))
    largest = {}
    for n in np.argsort(-step):
        largest.setdefault((int(MADE.motions.line[motion[row[n]]]), int(joint[n])), int(n))
    assert result.largest_reversals.tolist() == list(largest.values())[:20]
    assert len(largest) > 20
    assert len(EMPTY.largest_reversals) == 0
