"""The verdict on a program: may it be run, what holds, what does not, under which assumptions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import Struct

from postproc import elastostatics
from postproc.correction import Result
from postproc.report.digits import above, rounded
from postproc.robot import JOINTS, RobotModel

if TYPE_CHECKING:
    from postproc.report.summary import Summary

State = Literal["ok", "warning", "failed"]
NOTHING_MM = 1e-6
"""A deviation below this everywhere is none: what is left of it is noise of the arithmetic."""
NARROW_DEG = 5.0
"""A joint that comes nearer to its limit is something to look at."""
WORDS: dict[tuple[bool, State], str] = {
    (True, "ok"): "May be run.",
    (True, "warning"): "Look before you run it.",
    (True, "failed"): "Do not run it.",
    (False, "ok"): "As it stands.",
    (False, "warning"): "As it stands, with reservations.",
    (False, "failed"): "It cannot be predicted.",
}
"""The verdict in a word: (is there a program to run, state)."""
_KEPT = ("unresolved", "motions-elsewhere")
"""Kinds of issues about motions and calls that stay as they are."""
_FOREMOST = {
    "convert": ("motions-elsewhere",),
    "nominal": ("motions-elsewhere",),
    "predict": ("motions-elsewhere", "external-call"),
}
"""Kinds of warnings that come before all others: motions that were not examined, and called files that are missing,
which may set the frames of a program that is predicted as it stands."""
SOLID = "link masses"
"""An assumed value that only weights, and with them calibrated geometry, depend on: see `assumed`."""
_FIRST = math.inf
"""Cost [mm] of what comes first whatever it costs."""
_WORDS_ONLY = 0.0
"""Cost [mm] of what is stated in words."""


class Finding(Struct, frozen=True):
    """One statement of a verdict, and how many millimetres on the part it can cost."""

    cost_mm: float
    text: str


class Verdict(Struct, frozen=True):
    """What to think of a result.

    :param state: ``"failed"`` must not be run as it is, ``"warning"`` needs a look, ``"ok"`` neither.
    :param reasons: what decides the state, the most expensive in millimetres first; for ``"ok"`` what to expect.
    :param holds: what to expect and what was checked and holds.
    :param assumes: assumptions of all of it.
    """

    state: State
    reasons: tuple[str, ...]
    holds: tuple[str, ...]
    assumes: tuple[str, ...]


def verdict(result: Result, content: Summary) -> Verdict:
    """Return the verdict.

    :param content: of `report.json` but for the verdict.
    """
    failed = [Finding(_FIRST, issue.message) for issue in result.issues if issue.level == "error"]
    doubtful = [
        Finding(
            _FIRST if issue.kind in _FOREMOST[result.mode] else _WORDS_ONLY,
            _at(issue.message, issue.source_line, issue.count),
        )
        for issue in result.issues
        if issue.level == "warning"
    ]
    holds: list[Finding] = []
    if content["targets"]:
        more_failed, more_doubtful = _judged(result, content)
        failed += more_failed
        near = _near_limits(content)
        doubtful = [*more_doubtful, *near, *doubtful]
        holds = _expected(content) + ([] if near else _margin(content))
    if (kept := nothing_corrected(content)) is not None:
        doubtful.insert(0, Finding(_FIRST, kept))
    if result.robot.measured is not None and result.robot.measured.not_trusted:
        doubtful.append(Finding(_FIRST, f"the robot model is not to be trusted: {result.robot.measured.not_trusted}"))
    if content["mode"] != "predict" and result.documents:
        holds.append(
            Finding(_WORDS_ONLY, "the program was read back as it is written, and simulated with its rounded numbers")
        )
    names = assumed(result.robot)
    if names:
        holds.append(Finding(_WORDS_ONLY, f"assumed values of the robot model: {', '.join(names)}"))
    state: State = "failed" if failed else "warning" if doubtful else "ok"
    reasons = [*_texts(failed), *_texts(doubtful)] or _texts(holds)
    return Verdict(state, tuple(reasons), tuple(_texts(holds)), tuple(_assumptions(result)))


def nothing_corrected(content: Summary) -> str | None:
    """Return a sentence that says so if motions stay as they are and no other one was corrected."""
    kept = sum(issue["count"] for issue in content["issues"] if issue["kind"] in _KEPT)
    if content["mode"] != "convert" or not kept or content["before"]["max_mm"] >= NOTHING_MM:
        return None
    motions = "1 motion or call stays as it is" if kept == 1 else f"{kept} motions and calls stay as they are"
    return f"Nothing was corrected: {motions}."


def _texts(findings: list[Finding]) -> list[str]:
    return [finding.text for finding in sorted(findings, key=lambda finding: -finding.cost_mm)]


def _at(message: str, line: int | None, count: int = 1) -> str:
    more = f" and {count - 1} more" if count > 1 else ""
    return message if line is None else f"line {line}{more}: {message}"


def _judged(result: Result, content: Summary) -> tuple[list[Finding], list[Finding]]:
    """Return what fails and what is doubtful of path, expected error and forces."""
    failed, doubtful = [], []
    predicted = content["mode"] == "predict"
    if content["tolerance_held"] is False and not predicted:
        reached, tolerance = max(content["between_max_mm"] or 0.0, content["after"]["max_mm"]), content["tolerance_mm"]
        assert tolerance is not None
        text = (
            f"the predicted path leaves the nominal one by {above(reached, tolerance)} mm: more than {tolerance:g} mm"
        )
        failed.append(Finding(reached, text))
    if content["max_force_N"] == 0.0 and not predicted:
        doubtful.append(Finding(_FIRST, _without_forces(result, content)))
    bound, part = content["u95"], content["part"]
    if bound is None:
        text = "how far the part will be off is unknown: the robot model states no uncertainty of its parameters"
        doubtful.append(Finding(content["before"]["max_mm"], text))
    elif (unusable := bound["unusable"]) is not None:
        advice = (
            "Give the forces with smaller standard deviations"
            if unusable["source"] == elastostatics.FORCES
            else "Identify the robot with readings that show this, or use another model"
        )
        text = (
            f"the expected error of {above(unusable['u95_mm'], unusable['corrected_mm'])} mm (95 %) is larger than the "
            f"{rounded(unusable['corrected_mm'])} mm that are corrected, mostly due to {unusable['source']}. {advice}."
        )
        failed.append(Finding(unusable["u95_mm"], _at(text, unusable["source_line"])))
    if part["held"] is False and part["expected_mm"] is not None and part["tolerance_mm"] is not None:
        error = above(part["expected_mm"], part["tolerance_mm"])
        text = (
            f"the expected error on the part is up to {error} mm (95 %), more than the {part['tolerance_mm']:g} mm of "
            f"[part] tolerance_mm, at {part['beyond_percent']:.2g} % of the cutting targets"
        )
        (doubtful if predicted else failed).append(Finding(part["expected_mm"], _at(text, part["source_line"])))
    return failed, doubtful


def _without_forces(result: Result, content: Summary) -> str:
    if content["before"]["max_mm"] < NOTHING_MM:
        return "no cutting move carries a force: nothing is corrected (postproc forces computes forces)"
    corrected = content["mode"] == "convert"
    causes = " and ".join(result.causes) or "the model"
    what = "corrected is" if corrected else "what remains is"
    cause = "cause" if len(result.causes) > 1 else "causes"
    return (
        f"no cutting move carries a force: {what} only what {causes} {cause}, up to "
        f"{rounded(content['before']['max_mm'])} mm (postproc forces computes forces)"
    )


def _expected(content: Summary) -> list[Finding]:
    """Return what to expect on the part, in millimetres."""
    found = []
    bound, part, blending = content["u95"], content["part"], content["blending"]
    if bound is not None:
        text = f"expected error on the part (95 %): up to {rounded(bound['max_mm'])} mm, {bound['basis']}"
        found.append(Finding(bound["max_mm"], text))
    if part["held"] and part["expected_mm"] is not None:
        text = (
            f"[part] tolerance_mm = {part['tolerance_mm']:g} is held: up to {rounded(part['expected_mm'])} mm (95 %), "
            "corners and path included"
        )
        found.append(Finding(part["expected_mm"], text))
    if content["mode"] == "predict":
        text = f"predicted as it stands: up to {rounded(content['before']['max_mm'])} mm off at cutting targets"
        return [Finding(_FIRST, text), *found]
    if blending["source_line"] is not None:
        own = blending["programmed_max_mm"]
        itself = f", the program itself by {rounded(own)} mm" if own else ""
        text = f"{blending['by']} rounds corners by up to {rounded(blending['max_mm'])} mm{itself}"
        found.append(Finding(blending["max_mm"], _at(text, blending["source_line"])))
    if content["tolerance_held"] is not False and content["between_max_mm"] is not None and content["tolerance_mm"]:
        but = ", but for rounded corners" if content["tolerance_held"] is None else ""
        within = f"{rounded(content['between_max_mm'])} mm of the nominal one, between targets too{but}"
        text = f"the predicted path stays within {within} (tolerance {content['tolerance_mm']:g} mm)"
        found.append(Finding(content["between_max_mm"], text))
    if content["mode"] == "convert" and (content["max_correction_mm"] or 0.0) >= NOTHING_MM:
        found.append(
            Finding(_WORDS_ONLY, f"the correction is at most {rounded(content['max_correction_mm'] or 0.0)} mm")
        )
    return found


def _near_limits(content: Summary) -> list[Finding]:
    margins = content["limits"]["joint_margins_deg"]
    return [
        Finding(_WORDS_ONLY, f"{name} comes within {margin:.1f}° of a limit")
        for name, margin in zip(JOINTS, margins, strict=True)
        if margin is not None and margin < NARROW_DEG
    ]


def _margin(content: Summary) -> list[Finding]:
    least = content["limits"]["min_joint_margin_deg"]
    return [] if least is None else [Finding(_WORDS_ONLY, f"all joints stay {least:.1f}° or more from their limits")]


def assumed(robot: RobotModel) -> tuple[str, ...]:
    """Return the names of the model's values that are assumed and bear on what the tool does under force."""
    weights = robot.has_weight and (robot.carries_weight or not robot.subtract_reference)
    return tuple(entry.name for entry in robot.sources if entry.assumed and (weights or entry.name != SOLID))


def _assumptions(result: Result) -> list[str]:
    force = np.abs(result.wrench).max(initial=0.0)
    out = [f"the elastic model of {result.robot.title or result.robot.name}, as its sources below state it"]
    if force > 0.0:
        out.append("the cutting forces as given, constant in time: no chatter, no dynamics of drives")
    if result.robot.covariance is None:
        out.append("exact parameters: the model has no covariance")
    rigid = "holder, spindle and workpiece" if result.deflection_by_tool is None else "workpiece"
    out.append(f"{rigid} rigid; frames ($BASE, $TOOL) as the cell states them")
    return out
