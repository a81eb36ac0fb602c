"""`report.json`: what came of a program in numbers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np

from postproc import provenance
from postproc.correction import Mode, Result, Statistics, statistics
from postproc.dialects import registry
from postproc.errors import Issue
from postproc.files import FileEntry
from postproc.frames import DEG_PER_RAD, MM_PER_M, norm
from postproc.program import Bools
from postproc.report.digits import ROUNDING_MM
from postproc.report.verdict import NOTHING_MM, State, nothing_corrected, verdict
from postproc.robot import JOINTS


class Distances(TypedDict):
    """Distances of the predicted tool tip from nominal over cutting targets."""

    max_mm: float
    rms_mm: float
    mean_mm: float
    p95_mm: float


class Bound(TypedDict):
    """Largest and mean of a length over cutting targets."""

    max_mm: float
    rms_mm: float


class Unusable(TypedDict):
    """The target whose bound exceeds by most what is corrected there and, as RMS, over the program; and its cause."""

    source_line: int
    u95_mm: float
    corrected_mm: float
    source: str


class Expected(Bound):
    """Bound (95 %) by what the model and the forces state of their uncertainty, over cutting targets.

    `basis` says where the model's uncertainty comes from, `unusable` where the bound is larger than what it corrects.
    """

    basis: str
    unusable: Unusable | None


class Reversal(TypedDict):
    """A change of the direction of a joint's torque on a cutting move, and the step of the tool by its lost motion."""

    joint: str
    source_line: int
    lost_motion_mm: float


class OnPart(TypedDict):
    """Expected error on the part (95 %) at its worst target: bound, rounding of corners and path in one; and tolerance.

    `beyond_percent` of the cutting targets exceed the tolerance; None where it, or the bound, is not stated.
    """

    tolerance_mm: float | None
    expected_mm: float | None
    source_line: int | None
    held: bool | None
    beyond_percent: float | None


class Judged(TypedDict):
    """The verdict, see `postproc.report.verdict`."""

    state: State
    reasons: list[str]


class Ratios(TypedDict):
    """Before divided by after; None where what remains is but the rounding of the text."""

    max: float | None
    rms: float | None


class Blending(TypedDict):
    """How far approximate positioning passes the corners of cutting moves: as written, and as KRL input itself does.

    `by` is what the controller calls it.
    """

    by: str
    max_mm: float
    programmed_max_mm: float
    source_line: int | None


class Origin(TypedDict):
    """What a KRL program says of where it comes from: is it still what postproc wrote, and which mode and version."""

    state: provenance.State
    mode: str | None
    version: str | None


class Limits(TypedDict):
    """How near the path comes to what the robot cannot do; None where unknown."""

    min_joint_margin_deg: float | None
    min_singular_value: float | None
    joint_margins_deg: list[float | None]


class IssueEntry(TypedDict):
    """An issue, grouped."""

    level: str
    kind: str
    message: str
    source_line: int | None
    count: int


class Summary(TypedDict):
    """Content of `report.json`. Numbers that are unknown are None; none is NaN or infinite."""

    program: str
    robot: str
    mode: Mode
    targets: int
    inserted_targets: int
    before: Distances
    after: Distances
    u95: Expected | None  # None where the model states no uncertainty
    part: OnPart
    improvement: Ratios
    compensated_percent: float | None
    between_max_mm: float | None
    tolerance_mm: float | None
    tolerance_held: bool | None
    blending: Blending
    provenance: Origin
    max_correction_mm: float | None
    tool_deflection: Bound | None  # None where holder, spindle and tool are rigid
    max_force_N: float
    limits: Limits
    reversals: list[Reversal]
    issues: list[IssueEntry]
    verdict: Judged
    copied: NotRequired[list[str]]  # files that it needs and that are as they were; nothing is called there that moves
    files: NotRequired[list[FileEntry]]  # written with this report


def summary(result: Result, tolerance: float | None = None, part_tolerance: float | None = None) -> Summary:
    """Return the content of `report.json`.

    :param result: of one program.
    :param tolerance: what the tip may leave the nominal path by [m], to say whether that is held; None = not stated.
        Held means: with what approximate positioning does to corners beyond what a KRL program itself asks for. Where
        only that goes beyond the tolerance, `tolerance_held` is None, and `blending` says by how much.
    :param part_tolerance: what the part may be off [m], 95 %; None = not stated. Without a stated tolerance of the path
        and of the part, the bound may exceed what is corrected.
    """
    before, after = statistics(result.before, result.rapid), statistics(result.after, result.rapid)
    margin = result.joint_margin * DEG_PER_RAD
    force = norm(result.wrench[:, :3])
    bound = None if result.bound is None else statistics(result.bound, result.rapid)
    by_tool = None
    if result.deflection_by_tool is not None:
        by_tool = statistics(norm(result.deflection_by_tool), result.rapid)
    content = Summary(
        program=result.program.documents[0].name,
        robot=result.robot.name,
        mode=result.mode,
        targets=len(result),
        inserted_targets=result.inserted,
        before=_distances(before),
        after=_distances(after),
        u95=None if bound is None else _expected(result, bound, part_tolerance or tolerance),
        part=_on_part(result, part_tolerance),
        improvement={
            "max": improvement(before.largest * MM_PER_M, after.largest * MM_PER_M),
            "rms": improvement(before.rms * MM_PER_M, after.rms * MM_PER_M),
        },
        compensated_percent=_compensated(before.rms * MM_PER_M, after.rms * MM_PER_M),
        between_max_mm=_finite(result.between * MM_PER_M),
        tolerance_mm=None if tolerance is None else tolerance * MM_PER_M,
        tolerance_held=_held(result, after, tolerance),
        blending=_blending(result),
        provenance=_origin(result),
        max_correction_mm=_finite(result.largest_correction * MM_PER_M),
        tool_deflection=_bound(by_tool),
        max_force_N=float(force.max(initial=0.0)),
        limits={
            "min_joint_margin_deg": _finite(float(margin.min())),
            "min_singular_value": _finite(result.singular_value),
            "joint_margins_deg": [_finite(float(value)) for value in margin],
        },
        reversals=_reversals(result),
        issues=[issue_entry(issue) for issue in result.issues],
        verdict={"state": "ok", "reasons": []},
    )
    judged = verdict(result, content)
    content["verdict"] = {"state": judged.state, "reasons": list(judged.reasons)}
    return content


def _held(result: Result, after: Statistics, tolerance: float | None) -> bool | None:
    if tolerance is None:
        return None
    reached = max(after.largest, result.between) if math.isfinite(result.between) else math.inf
    if not reached <= tolerance:
        return False
    more = result.rounding - result.programmed
    return True if reached + more[_cuts(result)].max(initial=0.0) <= tolerance else None


def _blending(result: Result) -> Blending:
    cuts = np.flatnonzero(_cuts(result))
    worst = cuts[np.argmax(result.rounding[cuts])] if len(cuts) else None
    written = result.documents[0].name if result.documents else None
    dialect = result.program.dialect if written is None else registry.of_file(Path(written)).name
    by = registry.written_in(dialect, None)[1].approximation
    if worst is None or not result.rounding[worst] > 0.0:
        return {"by": by, "max_mm": 0.0, "programmed_max_mm": 0.0, "source_line": None}
    return {
        "by": by,
        "max_mm": float(result.rounding[worst]) * MM_PER_M,
        "programmed_max_mm": float(result.programmed[cuts].max()) * MM_PER_M,
        "source_line": int(result.source_line[worst]),
    }


def _origin(result: Result) -> Origin:
    writer = registry.by_name(result.program.dialect).writer
    said = None if writer is None else writer.origin(result.program.documents)
    if said is None or said.state == "none":
        return {"state": "none", "mode": None, "version": None}
    return {"state": said.state, "mode": said.mode or None, "version": said.version or None}


def _cuts(result: Result) -> Bools:
    """(K,) True for targets before or behind which the tool cuts."""
    return np.asarray(~(result.rapid & np.append(result.rapid[1:], True)[: len(result)]))


def issue_entry(issue: Issue) -> IssueEntry:
    """Return an issue as it stands in `report.json`."""
    return {
        "level": issue.level,
        "kind": issue.kind,
        "message": issue.message,
        "source_line": issue.source_line,
        "count": issue.count,
    }


def to_json(content: object) -> bytes:
    """Return JSON text in UTF-8, indented, with a line end.

    :raises ValueError: a number is NaN or infinite.
    """
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode(errors="backslashreplace")


def _bound(values: Statistics | None) -> Bound | None:
    return None if values is None else {"max_mm": values.largest * MM_PER_M, "rms_mm": values.rms * MM_PER_M}


def _expected(result: Result, bound: Statistics, allowed: float | None) -> Expected:
    """Return the bound over cutting targets.

    :param allowed: tolerance of the part, else of the path [m]: a bound below it is never unusable.
    """
    doubt = result.doubt
    return {
        "max_mm": bound.largest * MM_PER_M,
        "rms_mm": bound.rms * MM_PER_M,
        "basis": result.robot.basis,
        "unusable": None
        if doubt is None or allowed is None or doubt.bound <= allowed
        else {
            "source_line": int(result.source_line[doubt.row]),
            "u95_mm": doubt.bound * MM_PER_M,
            "corrected_mm": doubt.corrected * MM_PER_M,
            "source": doubt.source,
        },
    }


def _reversals(result: Result) -> list[Reversal]:
    turned = result.reversals
    if turned is None:
        return []
    return [
        {
            "joint": JOINTS[turned.joint[index]],
            "source_line": int(result.source_line[turned.row[index]]),
            "lost_motion_mm": float(turned.step[index]) * MM_PER_M,
        }
        for index in result.largest_reversals.tolist()
    ]


def _on_part(result: Result, tolerance: float | None) -> OnPart:
    """Return the expected error on the part, judged by a tolerance [m].

    At each cutting target: the bound, what approximate positioning rounds there beyond a KRL program's own, and what is
    left of the path: of a corrected program the largest anywhere, else the deviation there.
    """
    stated = None if tolerance is None else tolerance * MM_PER_M
    if result.bound is None or result.rapid.all():
        return {"tolerance_mm": stated, "expected_mm": None, "source_line": None, "held": None, "beyond_percent": None}
    left = np.full(len(result), result.between) if result.mode == "convert" else result.after
    error = np.where(result.rapid, 0.0, result.bound + np.maximum(result.rounding - result.programmed, 0.0) + left)
    worst = int(np.argmax(error))
    beyond = None if tolerance is None else 100.0 * float(np.mean(error[~result.rapid] > tolerance))
    return {
        "tolerance_mm": stated,
        "expected_mm": _finite(float(error[worst]) * MM_PER_M),
        "source_line": int(result.source_line[worst]),
        "held": None if tolerance is None else bool(error[worst] <= tolerance),
        "beyond_percent": beyond,
    }


def _distances(values: Statistics) -> Distances:
    return {
        "max_mm": values.largest * MM_PER_M,
        "rms_mm": values.rms * MM_PER_M,
        "mean_mm": values.mean * MM_PER_M,
        "p95_mm": values.p95 * MM_PER_M,
    }


def improvement(before_mm: float, after_mm: float) -> float | None:
    """Return before divided by after; None where what remains is but the rounding of the text, or unknown."""
    return _finite(before_mm / after_mm) if after_mm >= ROUNDING_MM else None


def nothing_to_correct(content: Summary) -> str | None:
    """Return a sentence that says so if the tool deviates nowhere, with or without correction."""
    if (kept := nothing_corrected(content)) is not None:
        return kept
    if not (content["targets"] and content["before"]["max_mm"] < NOTHING_MM):
        return None
    why = "no cutting move carries a force" if content["max_force_N"] == 0.0 else "the forces do not move the tool"
    return f"Nothing to correct: {why}, the arm stands as programmed."


def _compensated(before_mm: float, after_mm: float) -> float | None:
    return _finite(100.0 * (1.0 - after_mm / before_mm)) if before_mm >= ROUNDING_MM else None


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
