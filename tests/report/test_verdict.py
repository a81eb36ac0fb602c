from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.correction.result import Doubt, doubtful
from postproc.errors import Issue
from postproc.program import Document
from postproc.report import of_one, page, summary
from postproc.robot import Covariance, JointCompliance
from tests import fabricated
from tests.html_page import read_page

_QUIET = {"issues": (), "bound": np.full(100, 5e-6)}


def _known(result):
    """The same with a model of which nothing is assumed, and whose uncertainty is known."""
    entries = tuple(replace(entry, assumed=False) for entry in result.robot.sources)
    covariance = Covariance((JointCompliance("A1"),), np.eye(1))
    robot = replace(result.robot, sources=entries, covariance=covariance, stated_spread=())
    return fabricated.with_changes(result, robot=robot)


def _content(tolerance=1e-5, part=None, **changes):
    result = fabricated.with_changes(_known(fabricated.result()), **{**_QUIET, **changes})
    return summary(result, tolerance, part)


def _verdict(tolerance=1e-5, part=None, **changes):
    return _content(tolerance, part, **changes).verdict


def test_a_program_of_which_all_is_known_and_held_is_good():
    verdict = _verdict(bound=np.full(100, 2e-4), rounding=np.full(100, 5e-5))
    assert verdict.state == "ok"
    assert verdict.reasons[:4] == [
        "expected error on the part (95 %): up to 0.20 mm, measured on this robot",
        "line 3: approximation (C_DIS) rounds corners by up to 0.050 mm",
        "the predicted path stays within 0.0040 mm of the nominal one, between targets too, but for rounded corners "
        "(tolerance 0.01 mm)",
        "the correction is at most 1.5 mm",
    ]


def test_a_robot_that_was_not_measured_is_good_too_and_says_what_it_rests_on():
    verdict = _verdict(robot=fabricated.result().robot, bound=np.full(100, 2e-4))
    assert verdict.state == "ok"
    assert verdict.reasons[0].endswith("up to 0.20 mm, from published values, not measured on this robot")
    assumed = "assumed values of the robot model: compliance A2, compensator spring, joint speeds"
    assert verdict.reasons[-1] == assumed


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"bound": None}, "unknown: the robot model states no uncertainty"),
        ({"joint_margin": np.radians([9.0, 4.0, 9, 9, 9, 9])}, "A2 comes within 4.0° of a limit"),
        ({"wrench": np.zeros((100, 6)), "before": np.zeros(100)}, "carries a force: nothing is corrected"),
        (
            {"wrench": np.zeros((100, 6)), "causes": ("the payload",)},
            "carries a force: corrected is only what the payload causes, up to 1.5 mm",
        ),
        ({"issues": (Issue("warning", "blending", "look at it", 7),)}, "line 7: look at it"),
    ],
)
def test_what_needs_a_look_is_a_warning(changes, reason):
    verdict = _verdict(**changes)
    assert verdict.state == "warning"
    assert any(reason in text for text in verdict.reasons), verdict


@pytest.mark.parametrize(("tolerance", "held"), [(2.6e-4, True), (2.5e-4, False)])
def test_the_part_is_judged_by_bound_corners_and_path_together(tolerance, held):
    bound = np.where(np.arange(100) == 60, 2e-4, 1e-4)
    content = _content(part=tolerance, bound=bound, rounding=np.full(100, 6e-5), programmed=np.full(100, 1e-5))
    assert content.part.expected_mm == pytest.approx(0.254)
    assert content.part.source_line == 63
    assert content.part.held is held
    assert content.part.beyond_percent == pytest.approx(0.0 if held else 100.0 / 96)
    assert content.verdict.state == ("ok" if held else "failed")
    reason = content.verdict.reasons[0]
    assert ("tolerance_mm = 0.26 is held" in reason) if held else reason.startswith("line 63: the expected error")
    assert "corners and path included" in reason


@pytest.mark.parametrize(("targets", "percent"), [(1, "1"), (12, "12"), (95, "99"), (96, "100")])
def test_the_share_beyond_the_tolerance_of_the_part_is_a_plain_number(targets, percent):
    rank = np.cumsum(~fabricated.result().rapid)
    reason = _verdict(part=2e-4, bound=np.where(rank <= targets, 3e-4, 1e-4)).reasons[0]
    assert f"at {percent} % of the cutting targets" in reason


def test_a_bound_that_exceeds_what_it_corrects_fails_with_its_cause():
    doubt = Doubt(60, 2.4e-3, 1.1e-3, "the model of A3")
    verdict = _verdict(doubt=doubt)
    assert verdict.state == "failed"
    assert verdict.reasons[0].startswith(
        "line 63: the expected error of 2.4 mm (95 %) is larger than the 1.1 mm that are corrected, mostly due to the "
        "model of A3. Identify"
    )
    assert _verdict(doubt=doubt, part=2.5e-3).state == "ok"  # a bound below the tolerance of the part does no harm
    assert _verdict(doubt=Doubt(60, 0.9e-5, 0.5e-5, "the model of A3")).state == "ok"


def test_what_must_not_be_run_has_failed():
    assert _verdict(tolerance=1e-6).state == "failed"
    assert "more than 0.001 mm" in _verdict(tolerance=1e-6).reasons[0]
    failed = _verdict(issues=(Issue("error", "joint-limit", "A3 beyond its limit", 9),))
    assert (failed.state, failed.reasons[0]) == ("failed", "A3 beyond its limit")


def test_the_bound_is_over_cutting_targets():
    base = fabricated.result()
    bound = np.where(base.rapid, 1.0, np.linspace(0.0, 1e-4, 100))
    content = summary(fabricated.with_changes(base, bound=bound))
    assert content.u95.max_mm == pytest.approx(0.1)
    assert content.u95.rms_mm == pytest.approx(1e3 * np.sqrt(np.mean(bound[~base.rapid] ** 2)))
    assert summary(base).u95 is None


@pytest.mark.parametrize(("written", "word"), [("part.src", "(C_DIS)"), ("part.mod", "(zones)")])
def test_rounding_of_corners_is_told_in_the_word_of_the_controller(written, word):
    changes = {"rounding": np.full(100, 5e-5), "documents": (Document(written, ""),)}
    result = fabricated.with_changes(fabricated.result(), **changes)
    content = summary(result, 1e-5)
    limits = read_page(b"".join(page(result, 1e-5))).text("limits")
    for text, times in ((of_one(content), 1), (limits, 1)):
        assert text.count("rounds corners") == text.count(f"pproximation {word} rounds corners") == times


def test_a_bound_is_compared_with_what_the_program_corrects_in_all():
    corrected = np.array([0.1, 1.0, 1.0, 1.0, 0.0])
    rapid = np.array([False, False, False, False, True])
    rms = np.sqrt(3.01 / 4)
    assert doubtful(np.array([0.8, 0.7, 0.7, 0.7, 9.0]), corrected, rapid) is None  # where deflections cancel
    assert doubtful(np.array([0.9, 0.7, 0.7, 0.7, 9.0]), corrected, rapid) == (0, pytest.approx(rms))
    assert doubtful(np.array([0.9, 0.7, 1.4, 1.2, 9.0]), corrected, rapid) == (2, 1.0)
    assert doubtful(np.ones(5), corrected, np.ones(5, dtype=bool)) is None
