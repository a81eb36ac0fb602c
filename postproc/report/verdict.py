"""The verdict on a result: the three answers of `postproc.report.answers`, made here for every command that has one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from postproc.correction import Mode, Result, share_beyond, statistics
from postproc.elastostatics import HARMFUL_CHANCE, UNCERTAIN_CHANCE
from postproc.errors import Issue
from postproc.frames import MM_PER_M
from postproc.program import SPL
from postproc.report.answers import (
    RUN_TIME,
    SPLINES,
    TOOL_CHANGES,
    Drive,
    Improvement,
    Remedy,
    Tolerance,
    Verdict,
    chance_in_words,
    remedies_text,
    verdict_of,
)
from postproc.report.formatting import State, above_limit_text, two_digit_text
from postproc.robot import JOINTS, RobotModel

if TYPE_CHECKING:
    from postproc.report.summary import Blending, OnPart, Summary

NOTHING_MM = 1e-6
"""Deviations below this everywhere are noise of the arithmetic (assumed)."""
_UNCORRECTED_KINDS = ("unresolved", "motions-elsewhere")
"""Kinds of issues about motions and calls that stay as they are."""
NARROW_DEG = 5.0
"""Distance from its limit [deg] below which a joint is a reason for a warning (assumed)."""
_FOREMOST_KINDS: dict[Mode, tuple[str, ...]] = {
    "convert": ("motions-elsewhere", "frames-at-rest"),
    "nominal": ("motions-elsewhere",),
    "predict": ("motions-elsewhere", "frames-at-rest", "external-call"),
}
"""Kinds of warnings that come before all others: motions that were not examined, frames that may not hold for the
real arm, and called files that are missing, which may set the frames of a predicted program."""
_FORCE_KINDS = frozenset(
    {
        "assumed-stock", "beyond-measured", "cuts-unseen", "deep-cut", "drilled-by-mill", "force-on-rapid",
        "force-step", "forces-by-pass", "frames-at-rest", "hollow-stock", "material", "no-force", "other-cutter",
        "real-cut", "stock-scale",
    }
)  # fmt: skip
"""Kinds of warnings about forces and model, which decide whether the part is better, and not whether to drive it."""
CUT_MM = 0.01
"""Depth [mm] up to which a cut of the programmed path into the mesh does not count, without a tolerance (assumed)."""
LEFT_MM = 0.1
"""Height [mm] of material that a finishing path may leave between passes, and by the facets of the mesh (assumed)."""
SOLID = "link masses"
"""Name of an assumed value of the model that changes only the weights of the links: see `assumed_values`."""
_SORTED_FIRST = np.inf
"""In place of the error [mm] of a finding: it is sorted before all others."""
_SORTED_LAST = 0.0
"""In place of the error [mm] of a finding that is not about a length: it is sorted last."""
_AFTER_TOOL_CHANGE = "after-tool-change"
"""Kind of the issue of a path that begins where a called program leaves the robot."""
_FRAMES_AT_REST = "frames-at-rest"
"""Kind of the issue of frames that may have been measured while the tip was displaced without a force."""
ASSUMED_STOCK = "assumed-stock"
"""Kind of the issue of a stock that is assumed, as the process states no stock."""
STOCK_REMARK = "The stock is assumed: check it first."
"""Remark in the headline, so that it is shown wherever the answers are."""


class Finding(Struct, frozen=True):
    """A statement of a verdict, with the error on the part [mm] that it can mean.

    Findings are shown by this error, the largest first; `_SORTED_FIRST` and `_SORTED_LAST` stand in for it.
    """

    error_mm: float
    text: str


def verdict(result: Result, content: Summary, other_remedies: Sequence[Remedy] = ()) -> Verdict:
    """Return the verdict on a result: the three answers, what holds, and the assumptions.

    :param content: content of `report.json` with a placeholder as verdict.
    :param other_remedies: remedies in addition to those that follow from the result.
    """
    warnings = [issue for issue in result.issues if issue.level == "warning"]
    # kinds of issues of one joint end in its name, such as "-A2"
    force_warnings = [issue for issue in warnings if issue.kind.partition("-A")[0] in _FORCE_KINDS]
    motion_warnings = [issue for issue in warnings if issue not in force_warnings]
    drive = _drive_answer(result, content, motion_warnings)
    tolerance = _tolerance_answer(result, content, other_remedies)
    better = _improvement_answer(result, content, _issue_findings(force_warnings, result.mode), tolerance)
    passed_checks = _sorted_texts(_passed_findings(result, content))
    remark = STOCK_REMARK if any(issue.kind == ASSUMED_STOCK for issue in result.issues) else ""
    return verdict_of(
        result.mode, drive, better, tolerance, holds=passed_checks, assumes=_assumptions(result), remark=remark
    )


def _drive_answer(result: Result, content: Summary, warnings: Sequence[Issue]) -> Drive:
    """Return the answer whether the program may be driven: its state, reasons, and what was not checked.

    :param warnings: warnings about motions, without those about forces.
    """
    errors = [issue.message for issue in result.issues if issue.level == "error"]
    doubts = _issue_findings(warnings, result.mode)
    if content.targets:  # else no motion was examined
        surface_doubts, _ = _surface_findings(content)  # findings in favour of the program are in `holds`
        doubts = [*surface_doubts, *_narrow_margin_findings(content), *doubts]
    # name of each check → whether it was made
    checks = {
        "collisions": content.collision is not None,
        "moves through material": result.is_stock_known,
        SPLINES: not bool((result.program.motions.kind == SPL).any()),
        RUN_TIME: not result.program.unresolved,
        TOOL_CHANGES: all(issue.kind != _AFTER_TOOL_CHANGE for issue in result.issues),
    }
    unchecked = [name for name, is_checked in checks.items() if not is_checked]
    return Drive(_state(errors, doubts), [*errors, *_sorted_texts(doubts)], unchecked)


def _state(failures: Sequence[object], doubts: Sequence[object]) -> State:
    """Return the state of an answer: failed if there are failures, else a warning if there are doubts, else ok."""
    if failures:
        return "failed"
    return "warning" if doubts else "ok"


def _improvement_answer(
    result: Result, content: Summary, doubts: list[Finding], tolerance: Tolerance | None
) -> Improvement:
    """Return the answer whether the corrected program is better than the uncorrected one.

    The errors in the answer are None if the model states no uncertainty, or if the program that is read is corrected.
    The answer is "failed" if the chance of a gain is below `HARMFUL_CHANCE`, a "warning" below `UNCERTAIN_CHANCE`.

    :param doubts: findings about forces and model.
    :param tolerance: answer on the tolerance: if the tolerance is held, a wide bound is no doubt. None: no answer.
    """
    # a correction is made for the forces of the nominal engagement, so it is judged under them: a prediction may be
    # computed with those of the deflected tool, and `engagement_result` then is the prediction with the nominal ones
    judged_result = result if result.engagement_result is None else result.engagement_result
    errors = judged_result.errors  # None: the model states no uncertainty
    failures = list[Finding]()
    doubts = [*doubts, *_doubts_of_input(result, content, is_error_known=errors is not None)]
    if errors is None or _is_corrected_input(content):
        return Improvement(
            state=_state([], doubts),
            uncorrected_mm=None,
            corrected_mm=None,
            uncorrected_rms_mm=None,
            corrected_rms_mm=None,
            chance=None,
            reasons=_sorted_texts(doubts),
        )
    uncorrected, corrected = (statistics(error, judged_result.cut_length) for error in (errors.before, errors.after))
    corrected_mm = corrected.largest * MM_PER_M
    # where all deviations are within the tolerance of the path, and CUT_MM, it does not matter whether they shrink
    largest_deviation_mm = max(content.before.max_mm, content.after.max_mm)
    negligible_mm = min(content.tolerance_mm or CUT_MM, CUT_MM)
    is_chance_judged = content.mode == "convert" and largest_deviation_mm > negligible_mm
    chance = errors.chance if is_chance_judged else None
    if chance is not None and chance < HARMFUL_CHANCE:
        failures.append(Finding(_SORTED_FIRST, _CHANCE.format("does more harm than good", chance_in_words(chance))))
    elif chance is not None and chance < UNCERTAIN_CHANCE and not (tolerance is not None and tolerance.held):
        doubts.append(Finding(corrected_mm, _uncertain_gain_text(result, content, chance)))
    if content.mode == "convert" and (corrected.largest - uncorrected.largest) * MM_PER_M > CUT_MM:
        doubts.append(Finding(corrected_mm, _WORSE_PLACE))
    return Improvement(
        state=_state(failures, doubts),
        uncorrected_mm=uncorrected.largest * MM_PER_M,
        corrected_mm=corrected_mm,
        uncorrected_rms_mm=uncorrected.rms * MM_PER_M,
        corrected_rms_mm=corrected.rms * MM_PER_M,
        chance=errors.chance,
        reasons=[*_sorted_texts(failures), *_sorted_texts(doubts)],
    )


def _uncertain_gain_text(result: Result, content: Summary, chance: float) -> str:
    """Return the doubt that the gain is not much larger than its uncertainty, with remedies if there are any."""
    text = _CHANCE.format("is not much larger than its uncertainty", chance_in_words(chance))
    actions = _remedies(result, content)
    return f"{text}. What would help: {remedies_text(actions)}" if actions else text


def _doubts_of_input(result: Result, content: Summary, *, is_error_known: bool) -> list[Finding]:
    """Return doubts about what the correction is made from: motions, forces and model.

    :param is_error_known: the model states the uncertainty of its parameters, so that the expected error is known.
    """
    doubts = list[Finding]()
    if (sentence := uncorrected_sentence(content)) is not None:
        doubts.append(Finding(_SORTED_FIRST, sentence))
    if content.targets and content.max_force_N == 0.0 and content.mode != "predict":
        doubts.append(Finding(_SORTED_FIRST, _no_force_sentence(result, content)))
    if content.targets and not is_error_known:
        text = "how far the part will be off is unknown: the robot model states no uncertainty of its parameters"
        doubts.append(Finding(content.before.max_mm, text))
    if result.robot.measured is not None and result.robot.measured.not_trusted:
        doubts.append(
            Finding(_SORTED_FIRST, f"the robot model is not to be trusted: {result.robot.measured.not_trusted}")
        )
    return doubts


_WORSE_PLACE = (
    "at the worst place the corrected program is further off than the uncorrected one: the path between targets is "
    "held to tolerance_mm of [output] only. Set it lower"
)
_CHANCE = "the correction {}: it makes the part better with a chance of {}"


def _tolerance_answer(result: Result, content: Summary, other_remedies: Sequence[Remedy]) -> Tolerance | None:
    """Return the answer on the tolerance of the part; without one, that the tolerance of the path is not held.

    None if there is no tolerance of the part and the path holds its tolerance. A program that is predicted and was
    corrected has no answer on the part: its targets are not those of the part.

    :param other_remedies: remedies in addition to those that follow from the result.
    """
    part, reasons = content.part, _path_reasons(content)
    if part.tolerance_mm is None or _is_corrected_input(content):
        return _missed_path_tolerance(result, content, reasons)
    is_error_unknown = part.held is None or part.expected_mm is None  # the model states no uncertainty
    # frames that may be off can only make the error larger: a tolerance that is not held stays so
    is_frame_unknown = any(issue.kind == _FRAMES_AT_REST for issue in result.issues)
    if is_error_unknown or (part.held and is_frame_unknown):
        unknown_reason = _UNKNOWN_UNCERTAINTY if part.held is None else _UNKNOWN_FRAMES
        return Tolerance(
            state=_state(reasons, [unknown_reason]),
            of="part",
            mm=part.tolerance_mm,
            held=None,
            beyond_percent=None,
            would_help=[],
            reasons=[*reasons, unknown_reason],
        )
    if part.held:
        return Tolerance(
            state=_state(reasons, []),
            of="part",
            mm=part.tolerance_mm,
            held=True,
            beyond_percent=0.0,
            would_help=[],
            reasons=reasons,
        )
    return _missed_part_tolerance(part, [*_remedies(result, content), *other_remedies], reasons)


def _missed_path_tolerance(result: Result, content: Summary, reasons: list[str]) -> Tolerance | None:
    """Return the answer that the path does not hold its tolerance; None if it holds it or has none.

    :param reasons: see `_path_reasons`.
    """
    if not reasons or content.tolerance_mm is None:
        return None
    percent = 100.0 * share_beyond(result.after * MM_PER_M, content.tolerance_mm, result.cut_length)
    return Tolerance(
        state="failed",
        of="path",
        mm=content.tolerance_mm,
        held=False,
        beyond_percent=percent,
        would_help=[],
        reasons=reasons,
    )


def _missed_part_tolerance(part: OnPart, remedies: Sequence[Remedy], reasons: list[str]) -> Tolerance:
    """Return the answer that the tolerance of the part is not held.

    :param part: states the tolerance and the expected error, which is larger.
    :param remedies: those that lower the expected error noticeably are stated.
    :param reasons: why the path does not hold its tolerance, see `_path_reasons`.
    """
    assert part.tolerance_mm is not None  # both are known where the tolerance is missed
    assert part.expected_mm is not None
    text = (
        f"the expected error on the part is up to {above_limit_text(part.expected_mm, part.tolerance_mm)} mm (95 %, "
        f"corners and path included), more than the {part.tolerance_mm:g} mm of [part] tolerance_mm, on "
        f"{_percent_digits(part.beyond_percent)} % of the cutting path"
    )
    return Tolerance(
        state="failed",
        of="part",
        mm=part.tolerance_mm,
        held=False,
        beyond_percent=part.beyond_percent,
        would_help=[remedy for remedy in remedies if remedy.expected_mm < _REMEDY_SHARE * part.expected_mm],
        reasons=[_with_line(text, part.source_line), *reasons],
    )


def _path_reasons(content: Summary) -> list[str]:
    """Return the reason why the written path does not hold its tolerance; empty if it holds it or is not judged."""
    is_path_missed = content.tolerance_held is False  # None: only the rounding of corners exceeds it, which is allowed
    if not content.targets or not is_path_missed or content.mode == "predict":
        return []
    assert content.tolerance_mm is not None
    between_targets_mm = content.between_max_mm or 0.0  # None: the path between targets is unknown
    largest_mm = max(between_targets_mm, content.after.max_mm)
    deviation_text = above_limit_text(largest_mm, content.tolerance_mm)
    return [f"the predicted path leaves the nominal one by {deviation_text} mm: more than {content.tolerance_mm:g} mm"]


_UNKNOWN_UNCERTAINTY = (
    "whether [part] tolerance_mm is held is unknown: the robot model states no uncertainty of its parameters"
)
_UNKNOWN_FRAMES = "whether [part] tolerance_mm is held is unknown: the frames may not hold for this arm"
_REMEDY_SHARE = 0.95
"""A remedy is named if the expected error with it is below this share of the present one (assumed)."""


def _remedies(result: Result, content: Summary) -> list[Remedy]:
    """Return remedies that would lower the expected error on the part (95 %) noticeably, each with that error.

    Empty if the model states no uncertainty.
    """
    errors = result.errors
    if errors is None:
        return []
    expected_error = float(errors.after.max(initial=0.0))  # with correction [m]
    is_corrected = content.mode == "convert"
    suffix = "" if is_corrected else " and correct it"
    # measure → largest expected error that would remain with it [m]
    error_of_action = {"measure the robot": errors.with_known_robot, "measure the forces": errors.with_known_forces}
    actions = [
        Remedy(action + suffix, error * MM_PER_M)
        for action, error in error_of_action.items()
        if error < _REMEDY_SHARE * expected_error
    ]
    if not is_corrected:
        return [Remedy("correct it", expected_error * MM_PER_M), *actions]
    # the bound u95 at targets is the expected error without the rounding of corners
    expected_mm = expected_error * MM_PER_M
    is_rounding_large = content.blending.max_mm > (1.0 - _REMEDY_SHARE) * expected_mm
    if is_rounding_large and content.u95 is not None and content.u95.max_mm < _REMEDY_SHARE * expected_mm:
        actions.append(Remedy("round corners less", content.u95.max_mm))
    return actions


def _is_corrected_input(content: Summary) -> bool:
    """Return whether a predicted program is one that postproc corrected: its targets are commanded poses."""
    return content.mode == "predict" and content.provenance.state == "intact" and content.provenance.mode == "corrected"


def _passed_findings(result: Result, content: Summary) -> list[Finding]:
    """Return findings on the expected error, the margins, the checks that passed, and assumed values of the model.

    Without targets there is no finding on errors, margins and surfaces.
    """
    findings = list[Finding]()
    if content.targets:
        _, surface_findings = _surface_findings(content)
        findings = [
            *surface_findings,
            *_expected_findings(result, content),
            *_margin_findings(content),
            *_clearance_findings(content),
        ]
    if content.mode != "predict" and result.documents:
        text = "the program was read back as it is written, and simulated with its rounded numbers"
        findings.append(Finding(_SORTED_LAST, text))
    if names := assumed_values(result.robot):
        findings.append(Finding(_SORTED_LAST, f"assumed values of the robot model: {', '.join(names)}"))
    return findings


def _issue_findings(issues: Sequence[Issue], mode: Mode) -> list[Finding]:
    """Return issues as findings, in their order; kinds that matter most in this mode are marked to be sorted first."""
    return [
        Finding(
            _SORTED_FIRST if issue.kind in _FOREMOST_KINDS[mode] else _SORTED_LAST,
            _with_line(issue.message, issue.source_line, issue.count),
        )
        for issue in issues
    ]


def uncorrected_sentence(content: Summary) -> str | None:
    """Return a sentence if motions stay as they are and no other motion was corrected; else None."""
    count = sum(issue.count for issue in content.issues if issue.kind in _UNCORRECTED_KINDS)
    if content.mode != "convert" or not count or content.before.max_mm >= NOTHING_MM:
        return None
    motions = "1 motion or call stays as it is" if count == 1 else f"{count} motions and calls stay as they are"
    return f"Nothing was corrected: {motions}."


def nothing_to_correct(content: Summary) -> str | None:
    """Return a sentence that says why there is nothing to correct; None if the tool deviates anywhere."""
    if (sentence := uncorrected_sentence(content)) is not None:
        return sentence
    if not (content.targets and content.before.max_mm < NOTHING_MM):
        return None
    reason = "no cutting move carries a force" if content.max_force_N == 0.0 else "the forces do not move the tool"
    return f"Nothing to correct: {reason}, the tool follows the programmed path."


def _sorted_texts(findings: list[Finding]) -> list[str]:
    """Return the texts of findings, those that can mean the largest error on the part first."""
    return [finding.text for finding in sorted(findings, key=lambda finding: -finding.error_mm)]


def _with_line(message: str, line: int | None, count: int = 1) -> str:
    """Return a message that begins with its source line and the number of further lines; unchanged without a line.

    :param count: number of lines with this message, including the one named.
    """
    other_lines = f" and {count - 1} more" if count > 1 else ""
    return message if line is None else f"line {line}{other_lines}: {message}"


def _percent_digits(percent: float | None) -> str:
    """Return a percentage with two significant digits, from 10 on without decimals.

    Less than 100 is at most "99", so that "100" is said only of all of the path.

    :param percent: must be known, not None.
    """
    assert percent is not None
    if percent < 9.95:  # from 9.95 on, two digits would round to 10
        return f"{percent:.2g}"
    shown_percent = percent if percent == 100.0 else min(percent, 99.0)
    return f"{shown_percent:.0f}"


def _no_force_sentence(result: Result, content: Summary) -> str:
    """Return a sentence for a program without forces: nothing is corrected, or the deviation by other causes [mm]."""
    if content.before.max_mm < NOTHING_MM:
        return "no cutting move carries a force: nothing is corrected (postproc forces computes forces)"
    is_corrected = content.mode == "convert"
    causes = " and ".join(result.causes) or "the model"
    subject = "corrected is" if is_corrected else "what remains is"
    cause = "cause" if len(result.causes) > 1 else "causes"
    return (
        f"no cutting move carries a force: {subject} only what {causes} {cause}, up to "
        f"{two_digit_text(content.before.max_mm)} mm (postproc forces computes forces)"
    )


def _expected_findings(result: Result, content: Summary) -> list[Finding]:
    """Return findings on the expected error on the part, the rounding of corners, the path and the correction [mm].

    Mode "predict": findings on the deviation as programmed, its uncertainty and the tolerance alone.
    """
    findings = [*_held_tolerance_findings(content.part), *_uncertainty_findings(result, content)]
    if content.mode == "predict":
        uncorrected_mm = content.before.max_mm
        text = f"predicted as programmed: up to {two_digit_text(uncorrected_mm)} mm off at cutting targets"
        return [Finding(_SORTED_FIRST, text), *findings]
    findings += [*_rounding_findings(content.blending), *_path_findings(content)]
    correction_mm = content.max_correction_mm or 0.0  # None: unknown
    if content.mode == "convert" and correction_mm >= NOTHING_MM:
        findings.append(Finding(_SORTED_LAST, f"the correction is at most {two_digit_text(correction_mm)} mm"))
    return findings


def _held_tolerance_findings(part: OnPart) -> list[Finding]:
    """Return the finding that the tolerance of the part is held; empty if it is not, or if that is unknown."""
    if not part.held or part.expected_mm is None:
        return []
    text = (
        f"[part] tolerance_mm = {part.tolerance_mm:g} is held: up to {two_digit_text(part.expected_mm)} mm (95 %), "
        "corners and path included"
    )
    return [Finding(part.expected_mm, text)]


def _uncertainty_findings(result: Result, content: Summary) -> list[Finding]:
    """Return the bound (95 %) of the prediction, or of the error on the part if a program is written.

    Empty if the model states no uncertainty.
    """
    if content.u95 is None:
        return []
    quantity, largest_mm = "uncertainty of the prediction", content.u95.max_mm
    if content.mode != "predict":
        quantity, largest_mm = "expected error on the part", max(largest_mm, _largest_expected_error(result))
    source_of_uncertainty = content.u95.basis
    text = f"{quantity} (95 %): up to {two_digit_text(largest_mm)} mm, {source_of_uncertainty}"
    return [Finding(largest_mm, text)]


def _rounding_findings(blending: Blending) -> list[Finding]:
    """Return the largest rounding of corners by approximate positioning (C_DIS, zones); empty without rounded corners.

    :param blending: `by` is the controller's word for approximate positioning.
    """
    if blending.source_line is None:
        return []
    programmed_mm = blending.programmed_max_mm
    program_share = f", the program itself by {two_digit_text(programmed_mm)} mm" if programmed_mm else ""
    text = f"{blending.by} rounds corners by up to {two_digit_text(blending.max_mm)} mm{program_share}"
    return [Finding(blending.max_mm, _with_line(text, blending.source_line))]


def _path_findings(content: Summary) -> list[Finding]:
    """Return the finding that the predicted path holds its tolerance; empty if it does not, or if that is unknown."""
    between_targets_mm = content.between_max_mm
    is_path_missed = content.tolerance_held is False
    if is_path_missed or between_targets_mm is None or not content.tolerance_mm:
        return []
    is_only_rounding_beyond = content.tolerance_held is None
    exception = ", but for rounded corners" if is_only_rounding_beyond else ""
    bound_text = f"{two_digit_text(between_targets_mm)} mm of the nominal one, between targets too{exception}"
    text = f"the predicted path stays within {bound_text} (tolerance {content.tolerance_mm:g} mm)"
    return [Finding(between_targets_mm, text)]


def _largest_expected_error(result: Result) -> float:
    """Return the largest expected error on the part (95 %) after correction [mm], corners and path included.

    0 if the model states no uncertainty.
    """
    errors = result.errors
    return 0.0 if errors is None else statistics(errors.after, result.cut_length).largest * MM_PER_M


def _surface_findings(content: Summary) -> tuple[list[Finding], list[Finding]]:
    """Return doubts about the programmed path and the mesh of the part, and findings in favour of the program.

    Both are empty without a mesh. Else there is one finding in all, by the first of these that applies: no tool reaches
    the mesh; the path cuts in beyond the tolerance, alone or with the expected error; it leaves material beyond the
    tolerance (three doubts); the path fits the mesh.
    """
    surface, part = content.surface, content.part
    if surface is None:
        return [], []
    limit_mm = part.tolerance_mm or content.tolerance_mm or CUT_MM
    reach_text = f"tools reach {surface.reached_percent:.0f} % of its surface"
    if surface.reached_percent == 0.0:
        text = "no tool reaches the part: check that its mesh is in mm and in its frame, and the shapes of the tools"
        return [Finding(_SORTED_FIRST, text)], []
    if (cut_doubt := _cut_doubt(surface.cut_into_mm, part, limit_mm)) is not None:
        return [Finding(_SORTED_FIRST, _with_line(f"{cut_doubt}; {reach_text}", surface.source_line))], []
    left_mm = surface.left_mm  # median height of the material that the path leaves; None: unknown
    if left_mm is not None and left_mm > max(limit_mm, LEFT_MM):
        text = (
            f"the programmed path itself leaves {two_digit_text(left_mm)} mm on the part: check that the mesh is in "
            f"place and is what this program makes; {reach_text}"
        )
        return [Finding(_SORTED_FIRST, text)], []
    text = f"the programmed path cuts into the part by no more than {limit_mm:g} mm; {reach_text}"
    return [], [Finding(_SORTED_LAST, text)]


def _cut_doubt(cut_mm: float, part: OnPart, limit_mm: float) -> str | None:
    """Return a doubt about how deep the programmed path cuts into the part; None if that is within the limit.

    :param cut_mm: largest depth of the programmed path in the part, without deflection.
    :param limit_mm: tolerance of the part; without one, that of the path or `CUT_MM`.
    """
    cut_text = f"the programmed path itself cuts {two_digit_text(cut_mm)} mm into the part"
    if cut_mm > limit_mm:
        return f"{cut_text}: check that the mesh is in place and is the finished part"
    if part.held and part.expected_mm is not None and cut_mm + part.expected_mm > limit_mm:
        return (
            f"{cut_text}, and the tool may be off by {two_digit_text(part.expected_mm)} mm (95 %): together more than "
            f"[part] tolerance_mm = {limit_mm:g}"
        )
    return None


def clearance_text(content: Summary) -> str:
    """Return the smallest clearance [mm] in words, or why it is unknown."""
    clearance = content.collision
    if clearance is None:
        return "collisions are not checked: the cell has no [collision]"
    if clearance.min_clearance_mm is None:
        return "[collision] names no bodies that could touch"
    bodies = " and ".join(clearance.bodies)
    place = f"of {bodies} at line {clearance.source_line}; stock not counted"
    return f"smallest clearance {clearance.min_clearance_mm:.3g} mm, {place}"


def _clearance_findings(content: Summary) -> list[Finding]:
    """Return the smallest clearance as a finding; empty if collisions were not checked."""
    return [] if content.collision is None else [Finding(_SORTED_LAST, clearance_text(content))]


def _narrow_margin_findings(content: Summary) -> list[Finding]:
    """Return a finding for each joint that comes nearer to a limit than `NARROW_DEG`."""
    margins = content.limits.joint_margins_deg
    return [
        Finding(_SORTED_LAST, f"{name} comes within {margin:.1f}° of a limit")
        for name, margin in zip(JOINTS, margins, strict=True)
        if margin is not None and margin < NARROW_DEG
    ]


def _margin_findings(content: Summary) -> list[Finding]:
    """Return the finding that all joints stay at least `NARROW_DEG` from their limits; empty if a joint does not."""
    margin_deg = content.limits.min_joint_margin_deg
    return (
        []
        if margin_deg is None or margin_deg < NARROW_DEG
        else [Finding(_SORTED_LAST, f"all joints stay {margin_deg:.1f}° or more from their limits")]
    )


def assumed_values(robot: RobotModel) -> tuple[str, ...]:
    """Return the names of the assumed values of the model that affect the deflection under force."""
    # the sag by the weights of the links is the same with and without a force: where deflections count from the
    # unloaded arm (`subtract_reference`), weights change nothing, unless compliances depend on the torque by them
    do_weights_count = robot.has_weight and (robot.carries_weight or not robot.subtract_reference)
    return tuple(entry.name for entry in robot.sources if entry.assumed and (do_weights_count or entry.name != SOLID))


def _assumptions(result: Result) -> list[str]:
    """Return the assumptions behind the numbers of the report."""
    # `values` has a row for each run of targets with one wrench (it may have rows of no target), `run` the row of each
    largest_force = np.abs(result.wrench.values).max(axis=1)[result.wrench.run].max(initial=0.0)
    clearance_remarks = [] if result.clearance is None else list(result.clearance.remarks)
    assumptions = [
        *clearance_remarks,
        f"the elastic model of {result.robot.title or result.robot.name}, as its sources below state it",
    ]
    if largest_force > 0.0:
        assumptions.append("the cutting forces as given, constant in time: no chatter, no dynamics of drives")
        if result.exact_forces and result.robot.covariance is not None:
            assumptions.append(
                "exact forces: the bound counts no error of theirs (columns sFx, sFy, sFz or sigma_percent)"
            )
    if result.is_stock_known:
        assumptions.append(
            "the stock of the process before the first cut: what other programs cut before is not removed from it. "
            "State what they leave as [stock] file"
        )
    if result.robot.covariance is None:
        assumptions.append("exact parameters: the model has no covariance")
    rigid = "holder, spindle and workpiece" if result.deflection_by_tool is None else "workpiece"
    assumptions.append(f"{rigid} rigid; frames ($BASE, $TOOL) as the cell states them")
    return assumptions
