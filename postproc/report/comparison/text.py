"""Summary of a comparison for the terminal."""

from __future__ import annotations

from msgspec.structs import astuple

from postproc.report.comparison.summary import ComparisonSummary
from postproc.report.formatting import PLAIN, ROUNDING_MM, Display, State, millimetres

WORDS: dict[State, str] = {
    "ok": "They belong together.",
    "warning": "Look at the differences.",
    "failed": "Do not run the corrected one.",
}
"""Sentence for each verdict."""
_ROWS = ("max", "RMS", "mean", "95 %")
_SHOWN = 5


def of_comparison(content: ComparisonSummary, display: Display = PLAIN) -> str:
    """Return the summary of a comparison, at most one screen.

    :param display: style of the text.
    """
    verdict, cut = content.verdict, content.cut
    lines = [
        f"{content.corrected} against {content.nominal}  on {content.robot}: {counted(content)}",
        display.verdict(WORDS[verdict.state], verdict.state),
        *(f"  - {reason}" for reason in verdict.reasons),
        "",
    ]
    head = ["at cutting targets [mm]", "offset"] + (["nominal cuts", "corrected cuts"] if cut is not None else [])
    sources = [content.offset] + ([cut.nominal, cut.corrected] if cut is not None else [])
    rows = [(label, *map(millimetres, values)) for label, *values in zip(_ROWS, *map(astuple, sources), strict=True)]
    if between := content.between:
        rows.append(("max between", "-", millimetres(between.nominal_max_mm), millimetres(between.corrected_max_mm)))
    lines += [display.table(head, rows, range(1, len(head)), "  "), ""]
    lines.append(f"  orientation: {content.rotation.max_deg:.4f}° at most")
    apart = content.between_targets
    if apart.nominal_line is not None:
        lines.append(
            f"  on the way between targets: {millimetres(apart.max_mm)} mm at most, before "
            f"{apart.nominal_file}:{apart.nominal_line} and {apart.corrected_file}:{apart.corrected_line}"
        )
    if content.passed:
        lines.append(f"  {of_passed(content)}")
    if content.splines:
        lines.append(f"  {of_splines(content)}")
    for pair in content.largest[:_SHOWN]:
        if pair.mm > 0.0:
            where = f"{pair.nominal_file}:{pair.nominal_line} and {pair.corrected_file}:{pair.corrected_line}"
            lines.append(f"  {millimetres(pair.mm)} mm between {where}")
    origin = content.provenance
    if origin.state == "none":
        lines.append(f"  {content.corrected} does not say that postproc wrote it")
    elif origin.version is not None:
        since = "unchanged since" if origin.state == "intact" else "changed since"
        lines.append(f"  {content.corrected} was written by postproc {origin.version} ({origin.mode}), {since}")
    return "\n".join(lines)


def of_splines(content: ComparisonSummary) -> str:
    """Return a sentence on splines, of which only the targets are compared."""
    count = content.splines
    return f"of splines ({count} SPL) the targets are compared, the way between them is not"


def of_passed(content: ComparisonSummary) -> str:
    """Return a sentence on nominal targets that the second program leaves out and whose path passes them."""
    count, within = content.passed, content.passed_within_mm
    what, it = ("1 target", "it") if count == 1 else (f"{count} targets", "them")
    verb = "is" if count == 1 else "are"
    passes = f"its path passes {it}" + ("" if within is None else f" within {max(within, ROUNDING_MM):.4f} mm")
    return f"{what} of the nominal program {verb} not in the corrected one; {passes}"


def counted(content: ComparisonSummary) -> str:
    """Return the numbers of paired and unpaired targets in words."""
    text = f"{content.pairs} pairs, {content.inserted} inserted"
    text += f", {content.only_nominal} missing" if content.only_nominal else ""
    return text + (f", {content.only_corrected} added" if content.only_corrected else "")
