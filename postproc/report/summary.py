"""`report.json`: the results of a program in numbers, with the verdict on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import provenance
from postproc.correction import Mode, Result, Statistics, share_beyond, statistics, weighted_quantile
from postproc.dialects import registry
from postproc.errors import Issue
from postproc.files import FileEntry
from postproc.frames import DEG_PER_RAD, MM_PER_M, norm
from postproc.program import Bools
from postproc.report.answers import UNJUDGED, Remedy, Verdict
from postproc.report.feed import FeedSummary, feed_summary
from postproc.report.formatting import ROUNDING_MM, stated_mm
from postproc.report.verdict import verdict
from postproc.robot import JOINTS

if TYPE_CHECKING:
    from postproc.report.surface import Surface


class Distances(Struct, frozen=True):
    """Distances of the predicted tool tip from nominal along the cutting path."""

    max_mm: float
    rms_mm: float
    mean_mm: float
    p95_mm: float


class Bound(Struct, frozen=True):
    """Largest and root mean square of a length along the cutting path."""

    max_mm: float
    rms_mm: float


class ExpectedError(Bound, frozen=True):
    """Bound (95 %) of the error on the part along the cutting path, from the uncertainties of model and forces.

    `basis` says where the uncertainty of the model comes from.
    """

    basis: str


class Reversal(Struct, frozen=True):
    """A change of the direction of a joint's torque on a cutting move, and the step of the tool by its lost motion."""

    joint: str
    source_line: int
    lost_motion_mm: float


class OnPart(Struct, frozen=True):
    """Expected error on the part (95 %) at its worst target, and whether it is within the tolerance.

    The error contains the bound, the rounding of corners and the error of the path. The tolerance is exceeded on
    `beyond_percent` of the length of the cutting path; None if the tolerance or the bound is not stated.
    """

    tolerance_mm: float | None
    expected_mm: float | None
    source_line: int | None
    held: bool | None
    beyond_percent: float | None


class OnSurface(Struct, frozen=True):
    """How the programmed path fits the mesh of the part, without deflection.

    `cut_into_mm` is the largest depth by which the path cuts into the mesh, at `source_line`; 0 and None if it does not
    cut in. `left_mm` is the median distance of the path from the surface that the tools touch; None without the shapes
    of the tools. `reached_percent` of the surface are touched or cut into by a tool.
    """

    cut_into_mm: float
    source_line: int | None
    left_mm: float | None
    reached_percent: float


class Ratios(Struct, frozen=True):
    """Deviation before divided by the deviation after; None if only the rounding of the text remains."""

    max: float | None
    rms: float | None


class Blending(Struct, frozen=True):
    """Largest rounding of the corners of cutting moves by approximate positioning: as written, and of the program read.

    `by` is the controller's word for approximate positioning; `source_line` is None if no corner is rounded.
    """

    by: str
    max_mm: float
    programmed_max_mm: float
    source_line: int | None


class Origin(Struct, frozen=True):
    """Origin of a robot program: whether it is as postproc wrote it, in which mode and by which version."""

    state: provenance.State
    mode: str | None
    version: str | None


class Inputs(Struct, frozen=True):
    """Inputs of a result: their SHA-256, as in the line of origin of a program, and the version of postproc.

    `program_files` are the files of the program, in the order in which its sum takes them, relative to the folder of
    the report. `needed_files` are other files from which the program takes values, `needed` is their sum. A sum is
    ``"-"`` if there is no such input.
    """

    program: str
    program_files: list[str]
    needed: str
    needed_files: list[str]
    cell: str
    model: str
    forces: str
    version: str


class Limits(Struct, frozen=True):
    """Margins of the path to the limits of the robot; None where unknown."""

    min_joint_margin_deg: float | None
    min_singular_value: float | None
    joint_margins_deg: list[float | None]


class Redundancy(Struct, frozen=True):
    """Turn of the tool about its axis: mode "constant", "best" or "path", and the range of the turn."""

    mode: str
    min_deg: float
    max_deg: float


class Clearance(Struct, frozen=True):
    """Smallest clearance of arm, tool and obstacles; None if no two bodies could touch."""

    min_clearance_mm: float | None
    bodies: list[str]
    source_line: int
    remarks: list[str]


class ModuleEntry(Struct, frozen=True):
    """A module of a program that is larger than the memory; it begins with the target of `source_line`."""

    name: str
    size_bytes: int
    source_line: int


class IssueEntry(Struct, frozen=True):
    """An issue: `count` equal ones, the first at `source_line`."""

    level: str
    kind: str
    message: str
    source_line: int | None
    count: int


class Summary(Struct, frozen=True, omit_defaults=True, kw_only=True):
    """Content of `report.json`. Unknown numbers are None; no number is NaN or infinite."""

    program: str
    robot: str
    mode: Mode
    targets: int
    inserted_targets: int
    before: Distances
    after: Distances
    u95: ExpectedError | None  # None where the model states no uncertainty
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
    verdict: Verdict
    modules: list[ModuleEntry] | None = None  # in place of one program that is larger than the memory
    surface: OnSurface | None = None  # with a mesh of the part
    copied: list[str] | None = None  # unchanged files that the program needs; no motion is called in them
    inputs: Inputs | None = None  # None of a result in memory
    files: list[FileEntry] | None = None  # written with this report


def summary(
    result: Result,
    tolerance: float | None = None,
    part_tolerance: float | None = None,
    surface: Surface | None = None,
    remedies: Sequence[Remedy] = (),
) -> Summary:
    """Return the content of `report.json`.

    :param result: result of one program.
    :param tolerance: largest permitted distance of the tip from the nominal path [m]; None: not stated. Rounding of
        corners by approximate positioning counts as far as it exceeds that of the program read. `tolerance_held` is
        None if only this rounding exceeds the tolerance; `blending` states it.
    :param part_tolerance: largest permitted error of the part [m], 95 %; None = not stated.
    :param surface: deviations of the surface of the part; None: there is no mesh.
    :param remedies: measures that would lower the expected error, in addition to those that follow from the result.
    """
    content = _unjudged_summary(result, tolerance, part_tolerance, surface)
    return replace(content, verdict=verdict(result, content, remedies))


def _unjudged_summary(
    result: Result, tolerance: float | None, part_tolerance: float | None, surface: Surface | None
) -> Summary:
    """Return the content of `report.json` with a placeholder as verdict; parameters as of `summary`."""
    uncorrected, prediction = (statistics(distance, result.cut_length) for distance in (result.before, result.after))
    return Summary(
        program=result.program.documents[0].name,
        robot=result.robot.name,
        mode=result.mode,
        targets=len(result),
        inserted_targets=result.inserted,
        before=_distances_entry(uncorrected),
        after=_distances_entry(prediction),
        u95=_expected_error(result),
        part=_part_entry(result, part_tolerance),
        feed=feed_summary(result),
        improvement=Ratios(
            max=improvement(uncorrected.largest * MM_PER_M, prediction.largest * MM_PER_M),
            rms=improvement(uncorrected.rms * MM_PER_M, prediction.rms * MM_PER_M),
        ),
        compensated_percent=_compensated_percent(uncorrected.rms * MM_PER_M, prediction.rms * MM_PER_M),
        between_max_mm=_finite_or_none(result.path_deviation * MM_PER_M),
        tolerance_mm=None if tolerance is None else stated_mm(tolerance),
        tolerance_held=_is_tolerance_held(result, prediction, tolerance),
        blending=_blending_entry(result),
        # 0: nothing is written
        size_bytes=sum(len(piece) for document in result.documents for piece in document.pieces()) or None,
        provenance=_origin_entry(result),
        max_correction_mm=_finite_or_none(result.largest_correction * MM_PER_M),
        tool_deflection=_tool_deflection(result),
        max_force_N=float(result.force.max(initial=0.0)),
        limits=_limits(result),
        redundancy=_redundancy_entry(result),
        collision=_clearance_entry(result),
        reversals=_reversal_entries(result),
        issues=[issue_entry(issue) for issue in result.issues],
        verdict=UNJUDGED,
        modules=_module_entries(result) or None,
        surface=_surface_entry(result, surface) if surface is not None and len(result) else None,
    )


def _limits(result: Result) -> Limits:
    """Return the margins of the joints to their limits [deg] and the smallest singular value [m/rad]."""
    margins_deg = result.joint_margin * DEG_PER_RAD  # (6,)
    return Limits(
        min_joint_margin_deg=_finite_or_none(float(margins_deg.min())),
        min_singular_value=_finite_or_none(result.singular_value),
        joint_margins_deg=[_finite_or_none(float(margin)) for margin in margins_deg],
    )


def _module_entries(result: Result) -> list[ModuleEntry]:
    """Return an entry for each written module, in the order in which the modules run; empty for a single program."""
    module_documents = result.documents if result.modules else ()
    return [
        ModuleEntry(
            name=document.name,
            size_bytes=len(document.to_bytes()),
            source_line=int(result.source_line[first_target]),
        )
        for document, first_target in zip(module_documents, result.modules, strict=True)
    ]


def _redundancy_entry(result: Result) -> Redundancy | None:
    """Return the turn of the tool about its axis, chosen or constant; None if the program determines it."""
    if result.turn is None:  # it was not chosen: it is that of the cell, or of the program
        constant_deg = result.redundancy_deg
        return None if constant_deg is None else Redundancy("constant", min_deg=constant_deg, max_deg=constant_deg)
    low, high = result.turn.range_deg()
    return Redundancy(mode=result.turn.mode, min_deg=round(low, 3), max_deg=round(high, 3))


def _is_tolerance_held(result: Result, prediction: Statistics, tolerance: float | None) -> bool | None:
    """Return whether the path holds a tolerance [m].

    None if no tolerance is stated, or if only the rounding of corners by approximation exceeds it: how far a controller
    really rounds is not known. The rounding counts as far as it exceeds that of the program read.

    :param prediction: distances of the tip from nominal at the targets, with the program as written [m].
    """
    if tolerance is None:
        return None
    is_path_known = math.isfinite(result.path_deviation)  # between the targets
    path_deviation = max(prediction.largest, result.path_deviation) if is_path_known else math.inf
    if not path_deviation <= tolerance:  # not ≤: an unknown deviation (NaN) does not hold it
        return False
    extra_rounding = (result.rounding - result.programmed_rounding)[_is_next_to_cut(result)].max(initial=0.0)
    return True if path_deviation + extra_rounding <= tolerance else None


def _blending_entry(result: Result) -> Blending:
    """Return the largest rounding of corners of cuts by approximation [mm], and its line.

    0 without a line if no corner of a cut is rounded. The word for approximation is that of the written language; if
    nothing is written, that of the language in which the program would be written.
    """
    corners = np.flatnonzero(_is_next_to_cut(result))
    worst_corner = corners[np.argmax(result.rounding[corners])] if len(corners) else None
    _, writer = registry.written_in(result.written_dialect)
    if worst_corner is None or not result.rounding[worst_corner] > 0.0:  # not >: unknown (NaN) too
        return Blending(by=writer.approximation, max_mm=0.0, programmed_max_mm=0.0, source_line=None)
    return Blending(
        by=writer.approximation,
        max_mm=float(result.rounding[worst_corner]) * MM_PER_M,
        programmed_max_mm=float(result.programmed_rounding[corners].max()) * MM_PER_M,
        source_line=int(result.source_line[worst_corner]),
    )


def _origin_entry(result: Result) -> Origin:
    """Return the origin that the text of the program read states; state "none" if it states none."""
    writer = registry.dialect_of_name(result.program.dialect).writer
    origin = None if writer is None else writer.origin(result.program.documents)
    if origin is None or origin.state == "none":
        return Origin(state="none", mode=None, version=None)
    return Origin(state=origin.state, mode=origin.mode or None, version=origin.version or None)


def _is_next_to_cut(result: Result) -> Bools:
    """Return which targets (K,) end or begin a cutting motion: approximation there rounds a corner of a cut."""
    # the motion after a target is that of the next row; after the last row no motion follows, as if it were rapid
    return np.asarray(~(result.rapid & np.append(result.rapid[1:], True)[: len(result)]))


def issue_entry(issue: Issue) -> IssueEntry:
    """Return an issue as an entry of `report.json`."""
    return IssueEntry(
        level=issue.level, kind=issue.kind, message=issue.message, source_line=issue.source_line, count=issue.count
    )


def _expected_error(result: Result) -> ExpectedError | None:
    """Return the bound (95 %) of the error on the part along the cutting path [mm]; None without a covariance."""
    if result.bound is None:
        return None
    bound = statistics(result.bound, result.cut_length)  # [m]
    return ExpectedError(max_mm=bound.largest * MM_PER_M, rms_mm=bound.rms * MM_PER_M, basis=result.robot.basis)


def _tool_deflection(result: Result) -> Bound | None:
    """Return the deflection of holder, spindle and tool along the cutting path [mm]; None if they are rigid."""
    if result.deflection_by_tool is None:
        return None
    deflection = statistics(norm(result.deflection_by_tool), result.cut_length)
    return Bound(max_mm=deflection.largest * MM_PER_M, rms_mm=deflection.rms * MM_PER_M)


def _reversal_entries(result: Result) -> list[Reversal]:
    """Return the largest reversals of joints on cuts, with their lost motion [mm]; empty without reversals."""
    reversals = result.reversals
    if reversals is None:
        return []
    return [
        Reversal(
            joint=JOINTS[reversals.joint[index]],
            source_line=int(result.source_line[reversals.row[index]]),
            lost_motion_mm=float(reversals.step[index]) * MM_PER_M,
        )
        for index in result.largest_reversals.tolist()
    ]


def _part_entry(result: Result, tolerance: float | None) -> OnPart:
    """Return the largest expected error on the part (`Result.expected`), judged by a tolerance [m].

    The error is None if the model states no uncertainty, or if nothing is cut.

    :param tolerance: None: not stated.
    """
    tolerance_mm, error = None if tolerance is None else stated_mm(tolerance), result.expected
    if error is None or result.rapid.all():
        return OnPart(tolerance_mm=tolerance_mm, expected_mm=None, source_line=None, held=None, beyond_percent=None)
    worst = int(np.argmax(error))
    percent = None if tolerance is None else 100.0 * share_beyond(error, tolerance, result.cut_length)
    return OnPart(
        tolerance_mm=tolerance_mm,
        expected_mm=_finite_or_none(float(error[worst]) * MM_PER_M),
        source_line=int(result.source_line[worst]),
        held=None if tolerance is None else bool(error[worst] <= tolerance),
        beyond_percent=percent,
    )


def _surface_entry(result: Result, surface: Surface) -> OnSurface:
    """Return the largest depth of the programmed path in the part, the median height of the material that it leaves
    [mm], and the share of the surface that tools reach [%].
    """
    # height [m] of the programmed path over each facet of the mesh, without deflection: below 0 it cuts into the part
    height, area = surface.programmed, surface.area
    is_cut_into = surface.programmed_row >= 0  # row of the target that cuts in; −1: none does
    cut_facets = np.flatnonzero(is_cut_into)
    deepest_facet = cut_facets[np.argmin(height[cut_facets])] if len(cut_facets) else None
    # touched: the tool passes the facet within a limit; reached: it touches it or cuts into it
    has_material_left = surface.is_touched & ~is_cut_into & np.isfinite(height)
    left_height, left_area = height[has_material_left], area[has_material_left]
    median_height = weighted_quantile(left_height, left_area, 0.5) if left_area.any() else None
    return OnSurface(
        cut_into_mm=0.0 if deepest_facet is None else -float(height[deepest_facet]) * MM_PER_M,
        source_line=None if deepest_facet is None else int(result.source_line[surface.programmed_row[deepest_facet]]),
        left_mm=None if median_height is None else median_height * MM_PER_M,
        # 1e-300 keeps a mesh without area from dividing by zero
        reached_percent=100.0 * float(area[surface.is_reached].sum() / max(float(area.sum()), 1e-300)),
    )


def _distances_entry(values: Statistics) -> Distances:
    """Return statistics [m] as distances in mm."""
    return Distances(
        max_mm=values.largest * MM_PER_M,
        rms_mm=values.rms * MM_PER_M,
        mean_mm=values.mean * MM_PER_M,
        p95_mm=values.p95 * MM_PER_M,
    )


def improvement(before_mm: float, after_mm: float) -> float | None:
    """Return the deviation before divided by the deviation after.

    None if the deviation after is below the rounding of written numbers, or if a deviation is unknown (NaN).
    """
    return _finite_or_none(before_mm / after_mm) if after_mm >= ROUNDING_MM else None


def _compensated_percent(before_mm: float, after_mm: float) -> float | None:
    """Return the share of the deviation that is compensated [%].

    None if the deviation before is below the rounding of written numbers, or if a deviation is unknown (NaN).
    """
    return _finite_or_none(100.0 * (1.0 - after_mm / before_mm)) if before_mm >= ROUNDING_MM else None


def _finite_or_none(value: float) -> float | None:
    """Return a number, or None for NaN and infinity, which JSON does not have."""
    return float(value) if math.isfinite(value) else None


def _clearance_entry(result: Result) -> Clearance | None:
    """Return the smallest distance of bodies [mm], its bodies and its line; None if collisions were not checked."""
    clearance = result.clearance
    if clearance is None:
        return None
    distance_mm = _finite_or_none(clearance.distance * MM_PER_M)
    names = [name for name in clearance.bodies if name]  # empty: no two bodies could touch
    return Clearance(
        min_clearance_mm=distance_mm, bodies=names, source_line=clearance.line, remarks=list(clearance.remarks)
    )
