"""Forces of a process as files and text: forces.csv, its summary, and a table to print."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isnan

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import chunks
from postproc.decimals import without_negative_zero
from postproc.errors import Issue
from postproc.files import FileEntry, json_bytes
from postproc.forces import Knots
from postproc.frames import MM_PER_M
from postproc.machining import Entry, ProcessForces, kienzle_coefficients, linear_coefficients
from postproc.program import FORCE_FRAMES, Program, distinct
from postproc.report.summary import IssueEntry, issue_entry
from postproc.version import VERSION

COLUMNS = (
    "line", "t", "Fx", "Fy", "Fz", "Mx", "My", "Mz", "frame", "sFx", "sFy", "sFz", "sMx", "sMy", "sMz",
    "factor_percent",
)  # fmt: skip
"""Columns of forces.csv, in order."""
_CM3_PER_MIN_OF_MM3_PER_S = 0.06
_MM3_PER_M3 = 1e9


class ToolSummary(Struct, frozen=True, omit_defaults=True, kw_only=True):
    """Largest values of one tool; `max_force_line` is the line of the program with the largest force.

    `max_depth_mm` of a drill is the depth of its deepest hole; `max_feed_force_N` is given for drills only.
    """

    tool: str
    max_force_N: float
    max_force_line: int
    max_torque_Nm: float
    max_power_W: float
    max_depth_mm: float
    max_width_mm: float
    max_removal_mm3_per_s: float
    max_feed_force_N: float | None = None


class ForcesSummary(Struct, frozen=True, omit_defaults=True, kw_only=True):
    """Content of forces.json. Without material and stock, the keys up to `tools` are left out.

    `by_operation` counts the moves whose force is from the table of operations. `forces_json` adds the keys after it.
    """

    program: str | None = None
    places: int | None = None
    removed_mm3: float | None = None
    left_mm3: float | None = None
    tools: list[ToolSummary] | None = None
    by_operation: int
    version: str | None = None
    issues: list[IssueEntry] | None = None
    files: list[FileEntry] | None = None


def forces_csv(program: Program, knots: Knots) -> Iterator[bytes]:
    """Yield forces.csv in pieces of some thousand rows.

    `t` is empty for a ramped knot, the only knot of its motion.

    :param knots: of one motion for each line of the program, see `machining.knots_by_line`.
    """
    yield (",".join(COLUMNS) + "\n").encode()
    lines, t = program.motions.line[knots.motion], np.where(knots.ramped, np.nan, knots.t)
    for part in chunks(len(knots)):
        # numbers below the last decimal are printed as −0.000: the sign is removed from the text
        yield "".join(
            f"{line},{'' if isnan(place) else format(place, '.6f')},"
            f"{w[0]:.3f},{w[1]:.3f},{w[2]:.3f},{w[3]:.4f},{w[4]:.4f},{w[5]:.4f},{FORCE_FRAMES[frame]},"
            f"{s[0]:.3f},{s[1]:.3f},{s[2]:.3f},{s[3]:.4f},{s[4]:.4f},{s[5]:.4f},{100.0 * factor:.3f}\n"
            for line, place, w, frame, s, factor in zip(
                lines[part].tolist(), t[part].tolist(), without_negative_zero(knots.wrench[part]).tolist(),
                knots.frame[part].tolist(), knots.sigma[part].tolist(), knots.factor[part].tolist(), strict=True,
            )
        ).replace("-0.000,", "0.000,").replace("-0.0000,", "0.0000,").encode()  # fmt: skip


def summary(program: Program, process: ProcessForces | None, by_operation: int) -> ForcesSummary:
    """Return the content of forces.json.

    :param process: forces computed from material and stock; None: no forces were computed.
    :param by_operation: moves whose force is from the table of operations.
    """
    if process is None:
        return ForcesSummary(by_operation=by_operation)
    m, cuts = program.motions, process.cuts
    tools: list[ToolSummary] = []
    for index in distinct(process.tools.tool[cuts.motion]).tolist():
        rows = process.tools.tool[cuts.motion] == index  # stations of the cut at which this tool cuts
        force = np.linalg.norm(cuts.wrench[rows, :3], axis=1)
        worst_motion = int(cuts.motion[rows][int(np.argmax(force))])
        # component 2 of a wrench is along the axis of the tool: the feed force of a drill
        feed_force = round(float(np.abs(cuts.wrench[rows, 2]).max()), 1)
        tools.append(
            ToolSummary(
                tool=process.tools.keys[index],
                max_force_N=round(float(force.max()), 1),
                max_force_line=int(m.line[worst_motion]),
                max_torque_Nm=round(float(np.abs(cuts.torque[rows]).max()), 3),
                max_power_W=round(float(cuts.power[rows].max()), 1),
                max_depth_mm=round(float(cuts.depth[rows].max()) * MM_PER_M, 3),
                max_width_mm=round(float(cuts.width[rows].max()) * MM_PER_M, 3),
                max_removal_mm3_per_s=round(float(cuts.rate[rows].max()) * _MM3_PER_M3, 1),
                max_feed_force_N=feed_force if process.drills[index] else None,
            )
        )
    return ForcesSummary(
        program=program.documents[0].name,
        places=len(cuts.t),
        removed_mm3=round(process.removed_volume * _MM3_PER_M3, 1),
        left_mm3=round(process.stock.volume() * _MM3_PER_M3, 1),
        tools=tools,
        by_operation=by_operation,
    )


def forces_json(content: ForcesSummary, issues: Sequence[Issue], entries: list[FileEntry]) -> bytes:
    """Return forces.json as bytes: the content with the version, the issues and the written files.

    :param content: content as of `summary`.
    :param entries: entries of the files that were written.
    """
    return json_bytes(replace(content, version=VERSION, issues=[issue_entry(i) for i in issues], files=entries))


def as_text(content: ForcesSummary) -> str:
    """Return the summary as lines to print: forces and cut of each tool, removed volume, forces by operation."""
    lines = []
    for tool in content.tools or []:
        removal = tool.max_removal_mm3_per_s * _CM3_PER_MIN_OF_MM3_PER_S
        lines.append(
            f"tool {tool.tool}: mean force up to {tool.max_force_N:g} N (line {tool.max_force_line}); "
            f"torque {tool.max_torque_Nm:g} N·m; power {tool.max_power_W:g} W"
        )
        is_drill = tool.max_feed_force_N is not None
        if is_drill:
            lines.append(
                f"  drilled up to {tool.max_depth_mm:g} mm deep, feed force up to {tool.max_feed_force_N:g} N, "
                f"torque up to {tool.max_torque_Nm:g} N·m, {removal:.3g} cm³/min"
            )
            continue
        lines.append(
            f"  depth of cut up to {tool.max_depth_mm:g} mm, width {tool.max_width_mm:g} mm, {removal:.3g} cm³/min"
        )
    if content.removed_mm3 is not None and content.left_mm3 is not None:
        lines.append(f"removed {content.removed_mm3 / 1e3:.4g} cm³, left {content.left_mm3 / 1e3:.4g} cm³")
    if content.by_operation:
        lines.append(f"forces by operation for {content.by_operation} move{'s' * (content.by_operation != 1)}")
    return "\n".join(lines)


def materials(entries: dict[str, Entry]) -> str:
    """Return the table of materials as text: coefficients, source and warning of each.

    :param entries: name of each material → its coefficients, of one of two cutting laws.
    """
    lines = []
    for name, entry in entries.items():
        lines.append(f"{name}: {entry.title}{' (assumed)' if entry.assumed else ''}, sigma {entry.sigma_percent:g} %")
        if entry.Ktc_N_per_mm2 is not None:
            ktc, krc, kac, kte, kre, kae = linear_coefficients(entry)
            lines.append(f"  Ktc {ktc:g}, Krc {krc:g}, Kac {kac:g} N/mm²; Kte {kte:g}, Kre {kre:g}, Kae {kae:g} N/mm")
        else:
            kc11, mc, radial, axial = kienzle_coefficients(entry)
            shares = f"radial {radial:g}, axial {axial:g} of the tangential force"
            lines.append(f"  kc1.1 {kc11:g} N/mm², mc {mc:g}; {shares}")
        lines.append(f"  source: {entry.source}")
        if entry.warning:
            lines.append(f"  warning: {entry.warning}")
    return "\n".join(lines)
