"""The verdict on a program: may it be trusted, what holds, what does not, under which assumptions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import Struct

from postproc.correction import Result
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
_PLACES = 9
_KEPT = ("unresolved", "motions-elsewhere")
"""Kinds of issues about motions and calls that stay as they are."""
_FOREMOST = {
    "convert": ("motions-elsewhere",),
    "nominal": ("motions-elsewhere",),
    "predict": ("motions-elsewhere", "external-call"),
}
"""Kinds of warnings that are told before all others: motions that nobody has looked at, and called files that are
missing: they may set the frames of a program that is told as it stands."""
SOLID = "link masses"
"""An assumed value that only weights, and with them calibrated geometry, depend on: see `assumed`."""


class Verdict(Struct, frozen=True):
    """What to think of a result.

    :param state: ``"failed"`` must not be run as it is, ``"warning"`` needs a look, ``"ok"`` neither.
    :param reasons: what decides the state; for ``"ok"`` what holds.
    :param holds: what was checked and holds.
    :param assumes: what all of it rests on.
    """

    state: State
    reasons: tuple[str, ...]
    holds: tuple[str, ...]
    assumes: tuple[str, ...]


def verdict(result: Result, content: Summary) -> Verdict:
    """Return the verdict.

    :param content: of `report.json` but for the verdict.
    """
    failed, doubtful, holds = _tolerance(content)
    failed = [issue.message for issue in result.issues if issue.level == "error"] + failed
    if content["targets"]:
        more, held = _limits(content)
        doubtful, holds = doubtful + _expected(content) + more, holds + held
    warnings = [issue for issue in result.issues if issue.level == "warning"]
    foremost, others = (
        [_told(i.message, i.source_line, i.count) for i in warnings if (i.kind in _FOREMOST[result.mode]) is first]
        for first in (True, False)
    )
    kept = nothing_corrected(content)
    doubtful = [*([] if kept is None else [kept]), *foremost, *doubtful, *_model(result.robot), *others]
    if content["mode"] != "predict" and result.documents:
        holds.append("the program was read back as it is written, and simulated with its rounded numbers")
    state: State = "failed" if failed else "warning" if doubtful else "ok"
    return Verdict(state, tuple(failed + doubtful or holds), tuple(holds), tuple(_assumptions(result)))


def nothing_corrected(content: Summary) -> str | None:
    """Return a sentence that says so if motions stay as they are and no other one was corrected."""
    kept = sum(issue["count"] for issue in content["issues"] if issue["kind"] in _KEPT)
    if content["mode"] != "convert" or not kept or content["before"]["max_mm"] >= NOTHING_MM:
        return None
    motions = "1 motion or call stays as it is" if kept == 1 else f"{kept} motions and calls stay as they are"
    return f"Nothing was corrected: {motions}."


def _told(message: str, line: int | None, count: int = 1) -> str:
    more = f" and {count - 1} more" if count > 1 else ""
    return message if line is None else f"line {line}{more}: {message}"


def _tolerance(content: Summary) -> tuple[list[str], list[str], list[str]]:
    """Return what fails, what is doubtful and what holds of the tolerance."""
    tolerance, between = content["tolerance_mm"], content["between_max_mm"]
    if not content["targets"]:
        return [], [], []
    if content["mode"] == "predict":
        return [], [], [f"predicted as it stands: up to {content['before']['max_mm']:.4f} mm off at cutting targets"]
    if content["max_force_N"] == 0.0:
        return [], ["no cutting move carries a force: nothing is corrected (postproc forces computes forces)"], []
    if tolerance is None or between is None:
        return [], [], []
    if content["tolerance_held"] is False:
        reached = max(between, content["after"]["max_mm"])
        told = above(reached, tolerance, 4)
        return [f"the predicted path leaves the nominal one by {told} mm: more than {tolerance:g} mm"], [], []
    holds = f"the predicted path stays within {tolerance:g} mm of the nominal one, between targets too"
    if content["tolerance_held"] is None:
        blending = content["blending"]
        reached_mm = above(blending["max_mm"], tolerance)
        told = f"{blending['by']} rounds corners by up to {reached_mm} mm, more than {tolerance:g} mm"
        return [], [_told(told, blending["source_line"])], [f"{holds}, but for corners that {blending['by']} rounds"]
    return [], [], [holds]


def _expected(content: Summary) -> list[str]:
    bound, tolerance = content["u95"], content["tolerance_mm"]
    if bound is None:
        return ["how far the part will be off is unknown: the robot model states no uncertainty of its parameters"]
    if tolerance is not None and bound["max_mm"] > tolerance:
        told = above(bound["max_mm"], tolerance)
        return [
            f"the expected error on the part is up to {told} mm (95 %), more than {tolerance:g} mm: {bound['basis']}"
        ]
    return []


def above(value_mm: float, limit_mm: float, places: int = 3) -> str:
    """Return a number that is more than a limit as text, with as many decimals as it takes to see it.

    >>> above(0.0493, 0.01), above(0.0104, 0.01)
    ('0.049', '0.0104')
    """
    while places < _PLACES and float(f"{value_mm:.{places}f}") <= limit_mm:
        places += 1
    return f"{value_mm:.{places}f}"


def _limits(content: Summary) -> tuple[list[str], list[str]]:
    margins = content["limits"]["joint_margins_deg"]
    near = [
        f"{name} comes within {margin:.1f}° of a limit"
        for name, margin in zip(JOINTS, margins, strict=True)
        if margin is not None and margin < NARROW_DEG
    ]
    least = content["limits"]["min_joint_margin_deg"]
    return near, [] if near or least is None else [f"all joints stay {least:.1f}° or more from their limits"]


def assumed(robot: RobotModel) -> tuple[str, ...]:
    """Return the names of the model's values that are assumed and bear on what the tool does under force."""
    weights = robot.has_weight and (robot.carries_weight or not robot.subtract_reference)
    return tuple(entry.name for entry in robot.sources if entry.assumed and (weights or entry.name != SOLID))


def _model(robot: RobotModel) -> list[str]:
    told = []
    if robot.measured is not None and robot.measured.not_trusted:
        told.append(f"the robot model is not to be trusted: {robot.measured.not_trusted}")
    names = assumed(robot)
    if not names:
        return told
    return [*told, f"values of the robot model are assumed, not measured: {', '.join(names)}"]


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
