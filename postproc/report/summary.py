"""`report.json`: the results of a program in numbers, and the verdict on it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, provenance
from postproc.correction import Mode, Result, Statistics, statistics
from postproc.dialects import registry
from postproc.errors import Issue
from postproc.files import FileEntry
from postproc.frames import DEG_PER_RAD, MM_PER_M, norm
from postproc.program import Bools
from postproc.report.feed import FeedSummary, feed_summary
from postproc.report.formatting import ROUNDING_MM, State, above, rounded
from postproc.robot import JOINTS, RobotModel

if TYPE_CHECKING:
    from postproc.report.surface import Surface


class Distances(Struct, frozen=True):
    """Distances of the predicted tool tip from nominal over cutting targets."""

    max_mm: float
    rms_mm: float
    mean_mm: float
    p95_mm: float


class Bound(Struct, frozen=True):
    """Largest and mean of a length over cutting targets."""

    max_mm: float
    rms_mm: float


class Unusable(Struct, frozen=True):
    """The target whose bound exceeds the correction there, and the RMS correction, by most; and the main cause."""

    source_line: int
    u95_mm: float
    corrected_mm: float
    source: str


class Expected(Bound, frozen=True):
    """Bound (95 %) by what the model and the forces state of their uncertainty, over cutting targets.

    `basis` says where the model's uncertainty comes from, `unusable` where the bound is larger than what it corrects.
    """

    basis: str
    unusable: Unusable | None


class Reversal(Struct, frozen=True):
    """A change of the direction of a joint's torque on a cutting move, and the step of the tool by its lost motion."""

    joint: str
    source_line: int
    lost_motion_mm: float


class OnPart(Struct, frozen=True):
    """Expected error on the part (95 %) at its worst target: bound, rounding of corners and path in one; and tolerance.

    `beyond_percent` of the cutting targets exceed the tolerance; None where it, or the bound, is not stated.
    """

    tolerance_mm: float | None
    expected_mm: float | None
    source_line: int | None
    held: bool | None
    beyond_percent: float | None


class OnSurface(Struct, frozen=True):
    """What the programmed path does to the mesh of the part, before any deflection.

    `cut_into_mm` is the largest depth by which it cuts into the mesh, 0 if it does not, `source_line` where.
    `left_mm` is the distance that it keeps from the mesh on half of the surface that the tools touch; None without the
    shapes of the tools. `reached_percent` of the surface are touched or cut into by a tool.
    """

    cut_into_mm: float
    source_line: int | None
    left_mm: float | None
    reached_percent: float


class Judged(Struct, frozen=True):
    """The verdict, see `postproc.report.summary`."""

    state: State
    reasons: list[str]


class Ratios(Struct, frozen=True):
    """Before divided by after; None where what remains is but the rounding of the text."""

    max: float | None
    rms: float | None


class Blending(Struct, frozen=True):
    """Rounding of the corners of cutting moves by approximate positioning: as written, and of the KRL input.

    `by` is what the controller calls it.
    """

    by: str
    max_mm: float
    programmed_max_mm: float
    source_line: int | None


class Origin(Struct, frozen=True):
    """Origin of a KRL program: whether it is as postproc wrote it, mode and version."""

    state: provenance.State
    mode: str | None
    version: str | None


class Limits(Struct, frozen=True):
    """Margins of the path to the limits of the robot; None where unknown."""

    min_joint_margin_deg: float | None
    min_singular_value: float | None
    joint_margins_deg: list[float | None]


class Redundancy(Struct, frozen=True):
    """Turn of the tool about its axis: "constant", "best" or "path", and its range; None where text is kept."""

    mode: str
    min_deg: float
    max_deg: float


class Clearance(Struct, frozen=True):
    """The smallest clearance of arm, tool and obstacles; None where there is nothing to compare."""

    min_clearance_mm: float | None
    bodies: list[str]
    source_line: int
    remarks: list[str]


class ModuleEntry(Struct, frozen=True):
    """A module of a program that is larger than the memory: in the order in which they run; `source_line` begins it."""

    name: str
    size_bytes: int
    source_line: int


class IssueEntry(Struct, frozen=True):
    """An issue, grouped."""

    level: str
    kind: str
    message: str
    source_line: int | None
    count: int


class Summary(Struct, frozen=True, omit_defaults=True, kw_only=True):
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
    feed: FeedSummary | None  # None where feeds are those of the program
    improvement: Ratios
    compensated_percent: float | None
    between_max_mm: float | None
    tolerance_mm: float | None
    tolerance_held: bool | None
    blending: Blending
    size_bytes: int | None  # of the written program; None where nothing is written
    provenance: Origin
    max_correction_mm: float | None
    tool_deflection: Bound | None  # None where holder, spindle and tool are rigid
    max_force_N: float
    limits: Limits
    redundancy: Redundancy | None  # None where the program is KRL or RAPID: its turn is kept
    collision: Clearance | None  # None where the cell has no [collision]
    reversals: list[Reversal]
    issues: list[IssueEntry]
    verdict: Judged
    modules: list[ModuleEntry] | None = None  # in place of one program that is larger than the memory
    surface: OnSurface | None = None  # with a mesh of the part
    copied: list[str] | None = None  # files that it needs and that are as they were; nothing is called there that moves
    files: list[FileEntry] | None = None  # written with this report


def summary(
    result: Result, tolerance: float | None = None, part_tolerance: float | None = None, surface: Surface | None = None
) -> Summary:
    """Return the content of `report.json`.

    :param result: of one program.
    :param tolerance: what the tip may leave the nominal path by [m], to say whether that is held; None = not stated.
        Held means: with what approximate positioning does to corners beyond what a KRL program itself asks for. Where
        only that goes beyond the tolerance, `tolerance_held` is None, and `blending` says by how much.
    :param part_tolerance: what the part may be off [m], 95 %; None = not stated. Without a stated tolerance of the path
        and of the part, the bound may exceed the correction.
    :param surface: of the part; None = there is no mesh.
    """
    before, after = statistics(result.before, result.rapid), statistics(result.after, result.rapid)
    margin = result.joint_margin * DEG_PER_RAD
    force = result.force
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
        u95=None if bound is None else _bound_entry(result, bound, part_tolerance or tolerance),
        part=_on_part(result, part_tolerance),
        feed=feed_summary(result),
        improvement=Ratios(
            max=improvement(before.largest * MM_PER_M, after.largest * MM_PER_M),
            rms=improvement(before.rms * MM_PER_M, after.rms * MM_PER_M),
        ),
        compensated_percent=_compensated(before.rms * MM_PER_M, after.rms * MM_PER_M),
        between_max_mm=_finite(result.between * MM_PER_M),
        tolerance_mm=None if tolerance is None else tolerance * MM_PER_M,
        tolerance_held=_held(result, after, tolerance),
        blending=_blending(result),
        size_bytes=sum(len(piece) for document in result.documents for piece in document.pieces()) or None,
        provenance=_origin(result),
        max_correction_mm=_finite(result.largest_correction * MM_PER_M),
        tool_deflection=_bound(by_tool),
        max_force_N=float(force.max(initial=0.0)),
        limits=Limits(
            min_joint_margin_deg=_finite(float(margin.min())),
            min_singular_value=_finite(result.singular_value),
            joint_margins_deg=[_finite(float(value)) for value in margin],
        ),
        redundancy=_redundancy(result),
        collision=_clearance(result),
        reversals=_reversals(result),
        issues=[issue_entry(issue) for issue in result.issues],
        verdict=Judged(state="ok", reasons=[]),
        modules=_modules(result) or None,
        surface=_surface_entry(result, surface) if surface is not None and len(result) else None,
    )
    judged = verdict(result, content)
    return replace(content, verdict=Judged(state=judged.state, reasons=list(judged.reasons)))


def _modules(result: Result) -> list[ModuleEntry]:
    return [
        ModuleEntry(name=document.name, size_bytes=len(document.to_bytes()), source_line=int(result.source_line[first]))
        for document, first in zip(result.documents if result.modules else (), result.modules, strict=True)
    ]


def _redundancy(result: Result) -> Redundancy | None:
    if result.turn is None:
        constant = result.redundancy_deg
        return None if constant is None else Redundancy(mode="constant", min_deg=constant, max_deg=constant)
    low, high = result.turn.range_deg()
    return Redundancy(mode=result.turn.mode, min_deg=round(low, 3), max_deg=round(high, 3))


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
        return Blending(by=by, max_mm=0.0, programmed_max_mm=0.0, source_line=None)
    return Blending(
        by=by,
        max_mm=float(result.rounding[worst]) * MM_PER_M,
        programmed_max_mm=float(result.programmed[cuts].max()) * MM_PER_M,
        source_line=int(result.source_line[worst]),
    )


def _origin(result: Result) -> Origin:
    writer = registry.by_name(result.program.dialect).writer
    said = None if writer is None else writer.origin(result.program.documents)
    if said is None or said.state == "none":
        return Origin(state="none", mode=None, version=None)
    return Origin(state=said.state, mode=said.mode or None, version=said.version or None)


def _cuts(result: Result) -> Bools:
    """(K,) True for targets before or behind which the tool cuts."""
    return np.asarray(~(result.rapid & np.append(result.rapid[1:], True)[: len(result)]))


def issue_entry(issue: Issue) -> IssueEntry:
    """Return an issue as an entry of `report.json`."""
    return IssueEntry(
        level=issue.level, kind=issue.kind, message=issue.message, source_line=issue.source_line, count=issue.count
    )


def _bound(values: Statistics | None) -> Bound | None:
    return None if values is None else Bound(max_mm=values.largest * MM_PER_M, rms_mm=values.rms * MM_PER_M)


def _bound_entry(result: Result, bound: Statistics, allowed: float | None) -> Expected:
    """Return the bound over cutting targets.

    :param allowed: tolerance of the part, else of the path [m]: a bound below it is never unusable.
    """
    doubt = result.doubt
    return Expected(
        max_mm=bound.largest * MM_PER_M,
        rms_mm=bound.rms * MM_PER_M,
        basis=result.robot.basis,
        unusable=None
        if doubt is None or allowed is None or doubt.bound <= allowed
        else Unusable(
            source_line=int(result.source_line[doubt.row]),
            u95_mm=doubt.bound * MM_PER_M,
            corrected_mm=doubt.corrected * MM_PER_M,
            source=doubt.source,
        ),
    )


def _reversals(result: Result) -> list[Reversal]:
    turned = result.reversals
    if turned is None:
        return []
    return [
        Reversal(
            joint=JOINTS[turned.joint[index]],
            source_line=int(result.source_line[turned.row[index]]),
            lost_motion_mm=float(turned.step[index]) * MM_PER_M,
        )
        for index in result.largest_reversals.tolist()
    ]


def _on_part(result: Result, tolerance: float | None) -> OnPart:
    """Return the largest expected error on the part (`Result.expected`), judged by a tolerance [m]."""
    stated, error = None if tolerance is None else tolerance * MM_PER_M, result.expected
    if error is None or result.rapid.all():
        return OnPart(tolerance_mm=stated, expected_mm=None, source_line=None, held=None, beyond_percent=None)
    worst = int(np.argmax(error))
    beyond = None if tolerance is None else 100.0 * float(np.mean(error[~result.rapid] > tolerance))
    return OnPart(
        tolerance_mm=stated,
        expected_mm=_finite(float(error[worst]) * MM_PER_M),
        source_line=int(result.source_line[worst]),
        held=None if tolerance is None else bool(error[worst] <= tolerance),
        beyond_percent=beyond,
    )


def _surface_entry(result: Result, surface: Surface) -> OnSurface:
    cut = np.flatnonzero(surface.programmed_row >= 0)
    deepest = cut[np.argmin(surface.programmed[cut])] if len(cut) else None
    area, left = surface.area, surface.programmed[surface.touched & (surface.programmed_row < 0)]
    known = left[np.isfinite(left)]
    return OnSurface(
        cut_into_mm=0.0 if deepest is None else -float(surface.programmed[deepest]) * MM_PER_M,
        source_line=None if deepest is None else int(result.source_line[surface.programmed_row[deepest]]),
        left_mm=float(np.median(known)) * MM_PER_M if len(known) else None,
        reached_percent=100.0 * float(area[surface.reached].sum() / max(float(area.sum()), 1e-300)),
    )


def _distances(values: Statistics) -> Distances:
    return Distances(
        max_mm=values.largest * MM_PER_M,
        rms_mm=values.rms * MM_PER_M,
        mean_mm=values.mean * MM_PER_M,
        p95_mm=values.p95 * MM_PER_M,
    )


def improvement(before_mm: float, after_mm: float) -> float | None:
    """Return before divided by after; None where what remains is but the rounding of the text, or unknown."""
    return _finite(before_mm / after_mm) if after_mm >= ROUNDING_MM else None


def nothing_to_correct(content: Summary) -> str | None:
    """Return a sentence that says so if the tool deviates nowhere, with or without correction."""
    if (kept := nothing_corrected(content)) is not None:
        return kept
    if not (content.targets and content.before.max_mm < NOTHING_MM):
        return None
    why = "no cutting move carries a force" if content.max_force_N == 0.0 else "the forces do not move the tool"
    return f"Nothing to correct: {why}, the tool follows the programmed path."


def _compensated(before_mm: float, after_mm: float) -> float | None:
    return _finite(100.0 * (1.0 - after_mm / before_mm)) if before_mm >= ROUNDING_MM else None


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


NOTHING_MM = 1e-6
"""Deviations below this everywhere are noise of the arithmetic."""
NARROW_DEG = 5.0
"""A joint that comes nearer to its limit is something to look at."""
WORDS: dict[tuple[bool, State], str] = {
    (True, "ok"): "May be run.",
    (True, "warning"): "Look before you run it.",
    (True, "failed"): "Do not run it.",
    (False, "ok"): "As programmed.",
    (False, "warning"): "As programmed, with reservations.",
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
which may set the frames of a predicted program."""
CUT_MM = 0.01
"""Without a stated tolerance, a cut of the programmed path into the mesh below this is none."""
LEFT_MM = 0.1
"""Material that a finishing path may leave on most of a part, between passes and by the facets of the mesh."""
SOLID = "link masses"
"""An assumed value that only weights, and with them calibrated geometry, depend on: see `assumed`."""
_FIRST = math.inf
"""Cost [mm] of a finding that comes first."""
_WORDS_ONLY = 0.0
"""Cost [mm] of a finding without a length."""


class Finding(Struct, frozen=True):
    """One statement of a verdict, and how many millimetres on the part it can cost."""

    cost_mm: float
    text: str


class Verdict(Struct, frozen=True):
    """The verdict on a result.

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
    if content.targets:
        more_failed, more_doubtful = _judged(result, content)
        failed += more_failed
        near = _near_limits(content)
        surface_doubtful, surface_holds = _on_surface(content)
        doubtful = [*surface_doubtful, *more_doubtful, *near, *doubtful]
        holds = [*surface_holds, *_expected(content), *([] if near else _margin(content)), *_free(content)]
    if (kept := nothing_corrected(content)) is not None:
        doubtful.insert(0, Finding(_FIRST, kept))
    if result.robot.measured is not None and result.robot.measured.not_trusted:
        doubtful.append(Finding(_FIRST, f"the robot model is not to be trusted: {result.robot.measured.not_trusted}"))
    if content.mode != "predict" and result.documents:
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
    kept = sum(issue.count for issue in content.issues if issue.kind in _KEPT)
    if content.mode != "convert" or not kept or content.before.max_mm >= NOTHING_MM:
        return None
    motions = "1 motion or call stays as it is" if kept == 1 else f"{kept} motions and calls stay as they are"
    return f"Nothing was corrected: {motions}."


def _texts(findings: list[Finding]) -> list[str]:
    return [finding.text for finding in sorted(findings, key=lambda finding: -finding.cost_mm)]


def _at(message: str, line: int | None, count: int = 1) -> str:
    more = f" and {count - 1} more" if count > 1 else ""
    return message if line is None else f"line {line}{more}: {message}"


def _judged(result: Result, content: Summary) -> tuple[list[Finding], list[Finding]]:
    """Return failures and doubts about path, expected error and forces."""
    failed, doubtful = [], []
    predicted = content.mode == "predict"
    if content.tolerance_held is False and not predicted:
        reached, tolerance = max(content.between_max_mm or 0.0, content.after.max_mm), content.tolerance_mm
        assert tolerance is not None
        text = (
            f"the predicted path leaves the nominal one by {above(reached, tolerance)} mm: more than {tolerance:g} mm"
        )
        failed.append(Finding(reached, text))
    if content.max_force_N == 0.0 and not predicted:
        doubtful.append(Finding(_FIRST, _without_forces(result, content)))
    bound, part = content.u95, content.part
    if bound is None:
        text = "how far the part will be off is unknown: the robot model states no uncertainty of its parameters"
        doubtful.append(Finding(content.before.max_mm, text))
    elif (unusable := bound.unusable) is not None:
        advice = (
            "Measure the forces, or the cutting coefficients (postproc identify forces)"
            if unusable.source == elastostatics.FORCES
            else "Identify the robot with readings that show this, or use another model"
        )
        text = (
            f"the expected error of {above(unusable.u95_mm, unusable.corrected_mm)} mm (95 %) is larger than the "
            f"{rounded(unusable.corrected_mm)} mm that are corrected, mostly due to {unusable.source}. {advice}."
        )
        failed.append(Finding(unusable.u95_mm, _at(text, unusable.source_line)))
    origin = content.provenance
    compensated = predicted and origin.state == "intact" and origin.mode == "corrected"
    if part.held is False and part.expected_mm is not None and part.tolerance_mm is not None and not compensated:
        error = above(part.expected_mm, part.tolerance_mm)
        of = "predicted deviation included" if predicted else "corners and path included"
        text = (
            f"the expected error on the part is up to {error} mm (95 %, {of}), more than the "
            f"{part.tolerance_mm:g} mm of [part] tolerance_mm, at "
            f"{_two_digits(part.beyond_percent)} % of the cutting targets"
        )
        (doubtful if predicted else failed).append(Finding(part.expected_mm, _at(text, part.source_line)))
    return failed, doubtful


def _two_digits(percent: float | None) -> str:
    """Return a percentage with two significant digits, from 10 on without decimals; only 100 is 100."""
    assert percent is not None
    return f"{percent:.2g}" if percent < 9.95 else f"{percent if percent == 100.0 else min(percent, 99.0):.0f}"


def _without_forces(result: Result, content: Summary) -> str:
    if content.before.max_mm < NOTHING_MM:
        return "no cutting move carries a force: nothing is corrected (postproc forces computes forces)"
    corrected = content.mode == "convert"
    causes = " and ".join(result.causes) or "the model"
    what = "corrected is" if corrected else "what remains is"
    cause = "cause" if len(result.causes) > 1 else "causes"
    return (
        f"no cutting move carries a force: {what} only what {causes} {cause}, up to "
        f"{rounded(content.before.max_mm)} mm (postproc forces computes forces)"
    )


def _expected(content: Summary) -> list[Finding]:
    """Return what to expect on the part, in millimetres."""
    found = []
    bound, part, blending = content.u95, content.part, content.blending
    if bound is not None:
        what = "uncertainty of the prediction" if content.mode == "predict" else "expected error on the part"
        text = f"{what} (95 %): up to {rounded(bound.max_mm)} mm, {bound.basis}"
        found.append(Finding(bound.max_mm, text))
    if part.held and part.expected_mm is not None:
        text = (
            f"[part] tolerance_mm = {part.tolerance_mm:g} is held: up to {rounded(part.expected_mm)} mm (95 %), "
            "corners and path included"
        )
        found.append(Finding(part.expected_mm, text))
    if content.mode == "predict":
        text = f"predicted as programmed: up to {rounded(content.before.max_mm)} mm off at cutting targets"
        return [Finding(_FIRST, text), *found]
    if blending.source_line is not None:
        own = blending.programmed_max_mm
        itself = f", the program itself by {rounded(own)} mm" if own else ""
        text = f"{blending.by} rounds corners by up to {rounded(blending.max_mm)} mm{itself}"
        found.append(Finding(blending.max_mm, _at(text, blending.source_line)))
    if content.tolerance_held is not False and content.between_max_mm is not None and content.tolerance_mm:
        but = ", but for rounded corners" if content.tolerance_held is None else ""
        within = f"{rounded(content.between_max_mm)} mm of the nominal one, between targets too{but}"
        text = f"the predicted path stays within {within} (tolerance {content.tolerance_mm:g} mm)"
        found.append(Finding(content.between_max_mm, text))
    if content.mode == "convert" and (content.max_correction_mm or 0.0) >= NOTHING_MM:
        found.append(Finding(_WORDS_ONLY, f"the correction is at most {rounded(content.max_correction_mm or 0.0)} mm"))
    return found


def _on_surface(content: Summary) -> tuple[list[Finding], list[Finding]]:
    """Return doubts and findings about the programmed path and the mesh of the part."""
    surface = content.surface
    if surface is None:
        return [], []
    limit = content.part.tolerance_mm or content.tolerance_mm or CUT_MM
    reached = f"tools reach {surface.reached_percent:.0f} % of its surface"
    if surface.reached_percent == 0.0:
        text = "no tool reaches the part: check that its mesh is in mm and in $BASE, and the shapes of the tools"
        return [Finding(_FIRST, text)], []
    cut, left = surface.cut_into_mm, surface.left_mm
    if cut > limit:
        text = (
            f"the programmed path itself cuts {rounded(cut)} mm into the part: check that the mesh is in place and is "
            f"the finished part; {reached}"
        )
        return [Finding(_FIRST, _at(text, surface.source_line))], []
    if left is not None and left > max(limit, LEFT_MM):
        text = (
            f"the programmed path itself leaves {rounded(left)} mm on the part: check that the mesh is in place and is "
            f"what this program makes; {reached}"
        )
        return [Finding(_FIRST, text)], []
    text = f"the programmed path cuts into the part by no more than {limit:g} mm; {reached}"
    return [], [Finding(_WORDS_ONLY, text)]


def _clearance(result: Result) -> Clearance | None:
    found = result.clearance
    if found is None:
        return None
    least = _finite(found.distance * MM_PER_M)
    names = [name for name in found.bodies if name]
    return Clearance(min_clearance_mm=least, bodies=names, source_line=found.line, remarks=list(found.remarks))


def _free(content: Summary) -> list[Finding]:
    """Return the smallest clearance as a finding; none if collisions were not checked."""
    return [] if content.collision is None else [Finding(_WORDS_ONLY, clearance(content))]


def clearance(content: Summary) -> str:
    """Return the smallest clearance in words."""
    found = content.collision
    if found is None:
        return "collisions are not checked: the cell has no [collision]"
    if found.min_clearance_mm is None:
        return "[collision] names no bodies that could touch"
    between = " and ".join(found.bodies)
    where = f"of {between} at line {found.source_line}; stock not counted"
    return f"smallest clearance {found.min_clearance_mm:.3g} mm, {where}"


def _near_limits(content: Summary) -> list[Finding]:
    margins = content.limits.joint_margins_deg
    return [
        Finding(_WORDS_ONLY, f"{name} comes within {margin:.1f}° of a limit")
        for name, margin in zip(JOINTS, margins, strict=True)
        if margin is not None and margin < NARROW_DEG
    ]


def _margin(content: Summary) -> list[Finding]:
    least = content.limits.min_joint_margin_deg
    return [] if least is None else [Finding(_WORDS_ONLY, f"all joints stay {least:.1f}° or more from their limits")]


def assumed(robot: RobotModel) -> tuple[str, ...]:
    """Return the names of the model's values that are assumed and bear on what the tool does under force."""
    weights = robot.has_weight and (robot.carries_weight or not robot.subtract_reference)
    return tuple(entry.name for entry in robot.sources if entry.assumed and (weights or entry.name != SOLID))


def _assumptions(result: Result) -> list[str]:
    force = np.abs(result.wrench.values).max(axis=1)[result.wrench.run].max(initial=0.0)
    bodies = ["no collision: the cell has no [collision], so none is checked"]
    if result.clearance is not None:
        bodies = list(result.clearance.remarks)
    out = [*bodies, f"the elastic model of {result.robot.title or result.robot.name}, as its sources below state it"]
    if force > 0.0:
        out.append("the cutting forces as given, constant in time: no chatter, no dynamics of drives")
        if result.exact_forces and result.robot.covariance is not None:
            out.append("exact forces: the bound counts no error of theirs (columns sFx, sFy, sFz or sigma_percent)")
    if result.robot.covariance is None:
        out.append("exact parameters: the model has no covariance")
    rigid = "holder, spindle and workpiece" if result.deflection_by_tool is None else "workpiece"
    out.append(f"{rigid} rigid; frames ($BASE, $TOOL) as the cell states them")
    return out
