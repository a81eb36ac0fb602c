from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.chunks import Runs
from postproc.correction import ExpectedErrors
from postproc.errors import Issue
from postproc.report import page, program_text, summary
from postproc.report.answers import COLOURS, EXIT_CODES, Remedy
from postproc.report.summary import Clearance
from postproc.report.verdict import clearance_text
from postproc.robot import Covariance, JointCompliance
from tests import fabricated
from tests.commands import run
from tests.html_page import read_page
from tests.places import CELL_FILE

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


def _errors(chance=0.99, before=1.5e-3, after=8e-4, robot_known=8e-4, forces_known=8e-4):
    length = np.where(fabricated.result().rapid, 0.0, 1.0)
    return ExpectedErrors(before * length, after * length, chance, robot_known, forces_known)


def test_state_colour_and_exit_code_are_one_table():
    assert [(COLOURS[state], EXIT_CODES[state]) for state in ("ok", "warning", "failed")] == [
        ("green", 0),
        ("amber", 0),
        ("red", 3),
    ]


@pytest.mark.parametrize(
    ("chance", "state", "said"),
    [
        (0.99, "ok", "May be run. Uncorrected up to 1.5 mm, corrected up to 0.80 mm (95 %)."),
        (0.84, "ok", "May be run. Uncorrected up to 1.5 mm, corrected up to 0.80 mm (95 %)."),
        (
            0.83,
            "warning",
            "Look before you run it. Uncorrected up to 1.5 mm, corrected up to 0.80 mm (95 %), better with",
        ),
        (
            0.5,
            "warning",
            "Look before you run it. Uncorrected up to 1.5 mm, corrected up to 0.80 mm (95 %), better with",
        ),
        (0.49, "failed", "Do not run it. Uncorrected up to 1.5 mm, corrected up to 0.80 mm (95 %), better with"),
    ],
)
def test_a_wide_bound_alone_is_amber_with_both_numbers_and_harm_on_balance_is_red(chance, state, said):
    verdict = _verdict(errors=_errors(chance))
    assert (verdict.state, verdict.better.state, verdict.drive.state) == (state, state, "ok")
    assert verdict.headline.startswith(said)
    assert (verdict.better.uncorrected_mm, verdict.better.corrected_mm, verdict.better.chance) == (1.5, 0.8, chance)
    rms = np.sqrt(np.mean(_errors().after[~fabricated.result().rapid] ** 2)) * 1e3
    assert verdict.better.corrected_rms_mm == pytest.approx(rms)
    assert verdict.exit_code == (3 if state == "failed" else 0)


def test_a_wide_bound_within_the_tolerance_of_the_part_is_green():
    assert _verdict(part=9e-4, errors=_errors(0.7)).state == "ok"
    assert _verdict(part=9e-4, errors=_errors(0.4)).state == "failed"


def test_a_missed_tolerance_says_both_numbers_and_what_would_help():
    errors = _errors(robot_known=3e-4, forces_known=7e-4)
    result = fabricated.with_changes(_known(fabricated.result()), **_QUIET, errors=errors)
    content = summary(result, 1e-5, 5e-4, remedies=[Remedy("move the part", 0.5), Remedy("lower the feed", 0.79)])
    assert content.verdict.headline == (
        "Do not run it. Uncorrected up to 1.5 mm, corrected up to 0.80 mm (95 %). Your tolerance of 0.5 mm is not "
        "held. What would help: measure the robot (0.30 mm at best), move the part (0.50 mm at best), measure the "
        "forces (0.70 mm at best)."
    )
    tolerance = content.verdict.tolerance
    assert (tolerance.mm, tolerance.held, tolerance.beyond_percent) == (0.5, False, 100.0)
    assert [each.action for each in tolerance.would_help] == [
        "measure the robot",
        "measure the forces",
        "move the part",
    ]


_CORNER = (
    "G21 G90 G17 G54\nT1 M6\nS6000 M3\nG0 X0 Y0 Z50\n(FORCE FX=100 FY=-200 FZ=50)\n"
    "G1 Z-2 F300\nX100 F1000\nY50\nG0 Z50\nM30\n"
)


@pytest.mark.parametrize("command", ["convert", "predict"])
def test_what_would_help_is_what_lowers_the_error_of_this_program(tmp_path, command):
    """Corners that are rounded too much are to be rounded less; a program that is not corrected is to be corrected."""
    cell = CELL_FILE.read_text().replace("approximation_mm = 0.2", "approximation_mm = 5\ncorner_tolerance_mm = 5")
    (tmp_path / "cell.toml").write_text(cell)
    (tmp_path / "corner.nc").write_text(_CORNER)
    output = run(command, tmp_path / "corner.nc", "--part-tolerance", 0.1, "-o", tmp_path, code=(0, 3),
                 cell=tmp_path / "cell.toml").output  # fmt: skip
    first = {"convert": "round corners less (0.25 mm at best), ", "predict": "measure the robot and correct it ("}
    assert f"Your tolerance of 0.1 mm is not held. What would help: {first[command]}" in output
    assert (", correct it (" in output) == (command == "predict")


def test_a_tolerance_that_cannot_be_judged_is_not_said_to_be_missed():
    verdict = summary(fabricated.with_changes(fabricated.result(), errors=None, bound=None), 1e-5, 1e-4).verdict
    assert (verdict.tolerance.held, verdict.tolerance.state) == (None, "warning")
    assert "It is not known whether your tolerance of 0.1 mm is held." in verdict.headline
    assert "is not held" not in verdict.headline


def test_a_tolerance_has_the_digits_that_the_user_gave():
    content = summary(fabricated.result(), 0.249 * 1e-3, 0.249 * 1e-3)
    assert (content.tolerance_mm, content.part.tolerance_mm) == (0.249, 0.249)


def test_a_prediction_says_what_correction_would_give_and_judges_the_program_as_it_is():
    result = fabricated.with_changes(_known(fabricated.result(mode="predict")), **_QUIET, errors=_errors(0.3))
    assert summary(result).verdict.state == "ok"
    content = summary(result, part_tolerance=9e-4)
    assert content.verdict.headline.startswith(
        "Do not run it as it is. Uncorrected up to 1.5 mm; corrected it would be up to 0.80 mm (95 %). Your tolerance "
        "of 0.9 mm is not held. What would help: correct it (0.80 mm at best)."
    )


def test_what_was_not_checked_is_said_by_name_and_does_not_make_it_amber():
    verdict = _verdict()
    assert (verdict.state, verdict.drive.unchecked) == ("ok", ["collisions", "moves through material"])
    assert _verdict(is_stock_known=True).drive.unchecked == ["collisions"]
    assert "not checked: collisions (the cell has no [collision]), moves through material" in program_text(_content())


def test_a_warning_on_forces_is_no_reason_not_to_drive():
    verdict = _verdict(issues=(Issue("warning", "beyond-measured-A3", "more than measured", 7),))
    assert (verdict.drive.state, verdict.better.state, verdict.state) == ("ok", "warning", "warning")
    verdict = _verdict(issues=(Issue("warning", "joint-speed-A3", "fast", 7),))
    assert (verdict.drive.state, verdict.better.state) == ("warning", "ok")


def test_a_program_of_which_all_is_known_and_held_is_good():
    verdict = _verdict(bound=np.full(100, 2e-4), rounding=np.full(100, 5e-5))
    assert verdict.state == "ok"
    assert verdict.reasons[:4] == [
        "expected error on the part (95 %): up to 0.25 mm, measured on this robot",
        "line 3: approximation (C_DIS) rounds corners by up to 0.050 mm",
        "the predicted path stays within 0.0040 mm of the nominal one, between targets too, but for rounded corners "
        "(tolerance 0.01 mm)",
        "the correction is at most 1.5 mm",
    ]


def test_a_robot_that_was_not_measured_is_good_too_and_says_what_it_rests_on():
    verdict = _verdict(robot=fabricated.result().robot, bound=np.full(100, 2e-4))
    assert verdict.state == "ok"
    assert verdict.reasons[0].endswith("up to 0.20 mm, from published values, A2 assumed, not measured on this robot")
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
    content = _content(part=tolerance, bound=bound, rounding=np.full(100, 6e-5), programmed_rounding=np.full(100, 1e-5))
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
    assert f"on {percent} % of the cutting path" in reason


@pytest.mark.parametrize("tolerance", ["part", "path"])
def test_the_share_beyond_a_tolerance_is_that_of_the_length(tolerance):
    """One target of 96 is off, and stands for half of the path."""
    base = fabricated.result()
    off = np.arange(100) == 60
    cut_length = np.where(off, 0.95, base.cut_length)
    if tolerance == "part":
        verdict = _verdict(part=2e-4, bound=np.where(off, 3e-4, 1e-4), cut_length=cut_length)
    else:
        verdict = _verdict(after=np.where(off, 3e-5, 1e-6), cut_length=cut_length)
    assert verdict.tolerance.beyond_percent == pytest.approx(50.0)


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


@pytest.mark.parametrize(("written", "word"), [("krl", "(C_DIS)"), ("rapid", "(zones)")])
def test_rounding_of_corners_is_told_in_the_word_of_the_controller(written, word):
    changes = {"rounding": np.full(100, 5e-5), "written_dialect": written}
    result = fabricated.with_changes(fabricated.result(), **changes)
    content = summary(result, 1e-5)
    limits = read_page(b"".join(page(result, 1e-5))).text("limits")
    for text, times in ((program_text(content), 1), (limits, 1)):
        assert text.count("rounds corners") == text.count(f"pproximation {word} rounds corners") == times


def test_a_stock_that_nobody_stated_is_something_to_look_at_first():
    issues = (Issue("warning", "assumed-stock", "the stock is assumed"),)
    verdict = _verdict(errors=_errors(), issues=issues)
    assert (verdict.state, verdict.drive.state, verdict.better.state) == ("warning", "ok", "warning")
    assert verdict.headline.startswith("Look before you run it.")
    assert verdict.headline.endswith("The stock is assumed: check it first.")
    assert verdict.reasons[0] == "the stock is assumed"


def test_the_smallest_clearance_is_said_or_why_it_is_unknown():
    content = _content()
    assert clearance_text(content) == "collisions are not checked: the cell has no [collision]"
    none = replace(content, collision=Clearance(None, [], 0, []))
    assert clearance_text(none) == "[collision] names no bodies that could touch"
    near = replace(content, collision=Clearance(12.3456, ["hand", "table"], 42, []))
    assert clearance_text(near) == "smallest clearance 12.3 mm, of hand and table at line 42; stock not counted"


def test_the_numbers_rest_on_what_is_assumed():
    rigid = "rigid; frames ($BASE, $TOOL) as the cell states them"
    assert _verdict().assumes[1:] == [
        "the cutting forces as given, constant in time: no chatter, no dynamics of drives",
        f"holder, spindle and workpiece {rigid}",
    ]
    exact = "exact forces: the bound counts no error of theirs (columns sFx, sFy, sFz or sigma_percent)"
    assert _verdict(exact_forces=True).assumes[2] == exact
    assert "the stock of the process before the first cut" in _verdict(is_stock_known=True).assumes[2]
    soft = _verdict(deflection_by_tool=np.zeros((100, 3)), wrench=Runs.of(np.zeros((100, 6))))
    assert soft.assumes[1:] == [f"workpiece {rigid}"]
    result = _known(fabricated.result())
    unknown = replace(result, robot=replace(result.robot, covariance=None))
    assert "exact parameters: the model has no covariance" in summary(unknown, 1e-5).verdict.assumes
