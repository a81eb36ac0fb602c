"""What a result says of its targets, against loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, files, robot
from postproc.correction.result import HeldFeed, Result, share_beyond, statistics, weighted_quantile
from postproc.elastostatics import Reversals
from postproc.errors import Issue, ModelError
from postproc.robot import urdf
from postproc.robot.model_file import Displacement, Gravity, ModelFile
from tests.kr270 import CELL, FOLDER, ROBOT
from tests.oracle.whole_arm import WholeArm
from tests.programs import program

MADE = program([("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("RAPID", 100, 0, 0), ("LIN", 100, 50, 0)])
EMPTY = Result(MADE, ROBOT, "+Z", "convert", "krl", ())


def test_statistics_weigh_cutting_targets_by_their_length():
    """With whole lengths they are those of rows that are repeated as often."""
    rng = np.random.default_rng(2)
    distance, length = rng.exponential(size=200), rng.integers(0, 6, size=200)
    along = statistics(distance, 0.5 * length)
    repeated = sorted(d for d, n in zip(distance, length, strict=True) for _ in range(n))
    assert along.largest == repeated[-1]
    assert along.mean == pytest.approx(sum(repeated) / len(repeated))
    assert along.rms == pytest.approx((sum(d * d for d in repeated) / len(repeated)) ** 0.5)
    assert along.p95 == repeated[math.ceil(0.95 * len(repeated)) - 1]
    none = statistics(distance, np.zeros(200))
    assert (none.largest, none.rms, none.mean, none.p95) == (0.0, 0.0, 0.0, 0.0)


def test_ninety_five_per_cent_of_twenty_equal_lengths_are_nineteen():
    """0.95 · 20 is not 19 in binary: the sum of nineteen lengths reaches it nevertheless."""
    assert statistics(np.arange(1.0, 21.0), np.full(20, 0.1)).p95 == 19.0


@pytest.mark.parametrize("share", [0.5, 0.95, 1.0])
def test_a_quantile_is_that_of_values_repeated_as_often_as_their_weights(share):
    rng = np.random.default_rng(4)
    values, weights = rng.normal(size=30), rng.integers(0, 5, size=30)
    repeated = np.repeat(values, weights)
    assert weighted_quantile(values, 0.1 * weights, share) == np.quantile(repeated, share, method="inverted_cdf")


def test_the_share_beyond_a_limit_is_that_of_the_length():
    distance, length = np.array([1.0, 2.0, 3.0, 9.0]), np.array([4.0, 2.0, 4.0, 0.0])
    assert share_beyond(distance, 1.5, length) == pytest.approx(0.6)
    assert share_beyond(distance, 3.0, length) == 0.0
    assert share_beyond(distance, 0.0, np.zeros(4)) == 0.0


def test_a_result_without_a_path_has_six_joint_margins_that_are_not_known():
    """As many as the joints: the report lists them in order."""
    np.testing.assert_array_equal(EMPTY.joint_margin, [np.nan] * 6)


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


def test_a_result_without_a_path_has_no_targets():
    """As that of a program that is refused: rows of all columns are counted together."""
    columns = [
        "motion", "t", "output_line", "nominal", "printed", "wrench", "deflection", "deviation_before",
        "deviation_after", "q", "rounding", "programmed_rounding",
    ]  # fmt: skip
    assert (len(EMPTY), EMPTY.failed) == (0, False)
    assert {name: len(getattr(EMPTY, name)) for name in columns} == dict.fromkeys(columns, 0)
    assert [getattr(EMPTY, name).shape[1:] for name in columns[3:10]] == [(4, 4), (6,), (6,), (3,), (3,), (3,), (6,)]


@pytest.mark.parametrize("reference", ["calibrated", "rigid"])
def test_deflection_is_by_the_force_alone_and_deviation_is_from_nominal(reference):
    """A robot whose geometry, and with `rigid` its weight too, takes the tool off its nominal position at rest."""
    file = replace(
        files.read_toml(FOLDER / "model.toml", ModelFile, ModelError),
        gravity=Gravity(reference),
        geometry={"A3": Displacement(source="test", X_mm=0.4, Z_mm=-0.3, RY_deg=0.02)},
    )
    urdf_text = (FOLDER / "robot.urdf").read_text(encoding="utf-8")
    model = robot.assemble("displaced", file, urdf.read(urdf_text, "robot.urdf"))
    arm, tool = WholeArm(urdf_text, file), np.eye(4)
    tool[:3, 3] = [0.0, 0.0, 0.35]
    force = (120.0, 50.0, 90.0, 4.0, -3.0, 2.0)
    made = program(
        [("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", 30, 0, 0)],
        notes=[(3, force)],
        orientation=CELL.tool_orientation(),
    )
    result = correction.process(made, model, CELL, mode="predict")
    base = np.array([1500.0, -200.0, 700.0]) / 1e3
    row = int(np.flatnonzero((result.motion == 2) & (result.t == 1.0))[0])
    loaded, rest = (arm.equilibrium(result.q[row], tool, load)[1][:3, 3] for load in (np.array(force), np.zeros(6)))
    np.testing.assert_allclose(result.deflection[row], loaded - rest, atol=1e-8)
    np.testing.assert_allclose(result.deviation_before[row], loaded - base - [0.03, 0.0, 0.0], atol=1e-8)
    assert np.linalg.norm(result.deviation_before[row] - result.deflection[row]) > 2e-5


def test_feeds_are_lowered_below_the_programmed_one_and_miss_the_tolerance_above_it():
    columns = {name: np.zeros(4) for name in ("length", "without_feed")}
    held = HeldFeed(
        tolerance=1e-4, least=1e-3, unheld="lowest", programmed_feed=np.array([0.05, 0.05, 0.05, np.nan]),
        feed=np.array([0.05, 0.04, 0.03, np.nan]), expected=np.array([1e-4, 1.1e-4, 0.9e-4, 0.0]), **columns,
    )  # fmt: skip
    assert held.is_lowered.tolist() == [False, True, True, False]
    assert held.is_exceeded.tolist() == [False, True, False, False]
