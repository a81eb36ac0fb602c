from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

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
    return fabricated.with_changes(result, robot=replace(result.robot, sources=entries, covariance=covariance))


def _verdict(tolerance=1e-5, **changes):
    return summary(fabricated.with_changes(_known(fabricated.result()), **{**_QUIET, **changes}), tolerance)["verdict"]


def test_a_program_of_which_all_is_known_and_held_is_good():
    verdict = _verdict()
    assert verdict["state"] == "ok"
    assert verdict["reasons"][0] == "the predicted path stays within 0.01 mm of the nominal one, between targets too"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"bound": None}, "unknown: the robot model states no uncertainty"),
        ({"bound": np.full(100, 2e-5)}, "the expected error on the part is up to 0.020 mm (95 %), more than 0.01 mm"),
        ({"rounding": np.full(100, 5e-5)}, "line 3: approximation (C_DIS) rounds corners by up to 0.050 mm"),
        ({"joint_margin": np.radians([9.0, 4.0, 9, 9, 9, 9])}, "A2 comes within 4.0° of a limit"),
        ({"wrench": np.zeros((100, 6))}, "no cutting move carries a force"),
        ({"issues": (Issue("warning", "blending", "look at it", 7),)}, "line 7: look at it"),
        ({"robot": fabricated.result().robot}, "assumed, not measured: compliance A2, compensator spring"),
    ],
)
def test_what_needs_a_look_is_a_warning(changes, reason):
    verdict = _verdict(**changes)
    assert verdict["state"] == "warning"
    assert any(reason in text for text in verdict["reasons"]), verdict


def test_a_tolerance_that_approximation_leaves_is_not_said_to_hold():
    result = fabricated.with_changes(_known(fabricated.result()), **_QUIET, rounding=np.full(100, 5e-5))
    assert "targets too, but for corners that approximation (C_DIS) rounds" in read_page(
        b"".join(page(result, 1e-5))
    ).text("verdict")


def test_what_must_not_be_run_has_failed():
    assert _verdict(tolerance=1e-6)["state"] == "failed"
    assert "more than 0.001 mm" in _verdict(tolerance=1e-6)["reasons"][0]
    failed = _verdict(issues=(Issue("error", "joint-limit", "A3 beyond its limit", 9),))
    assert (failed["state"], failed["reasons"][0]) == ("failed", "A3 beyond its limit")


def test_the_bound_is_over_cutting_targets():
    base = fabricated.result()
    bound = np.where(base.rapid, 1.0, np.linspace(0.0, 1e-4, 100))
    content = summary(fabricated.with_changes(base, bound=bound))
    assert content["u95"]["max_mm"] == pytest.approx(0.1)
    assert content["u95"]["rms_mm"] == pytest.approx(1e3 * np.sqrt(np.mean(bound[~base.rapid] ** 2)))
    assert summary(base)["u95"] is None


@pytest.mark.parametrize(("written", "word"), [("part.src", "(C_DIS)"), ("part.mod", "(zones)")])
def test_rounding_of_corners_is_told_in_the_word_of_the_controller(written, word):
    changes = {"rounding": np.full(100, 5e-5), "documents": (Document(written, ""),)}
    result = fabricated.with_changes(fabricated.result(), **changes)
    content = summary(result, 1e-5)
    limits = read_page(b"".join(page(result, 1e-5))).text("limits")
    for text, times in ((content["verdict"]["reasons"][0], 1), (of_one(content), 2), (limits, 1)):
        assert text.count("rounds corners") == text.count(f"pproximation {word} rounds corners") == times
