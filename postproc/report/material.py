"""Identified cutting coefficients as a page and as text: measured against fitted forces."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.machining.identification import NAMES, CutReadings, IdentifiedMaterial
from postproc.report.kit import Axis, Curve, Note, Notes, Page, Plot, Points, Row, Section, Table, Tile, Tiles
from postproc.report.kit.parts import Traced

_COMPONENTS = ("Fx", "Fy", "Fz", "power")


def as_text(found: IdentifiedMaterial) -> str:
    """Return the result as lines to print."""
    lines = [
        f"{name} {value:.4g} ± {half:.2g} {'N/mm²' if k < 3 else 'N/mm'}{'' if own else ' (not measured)'}"
        for k, (name, value, half, own) in enumerate(zip(NAMES, found.value, found.half, found.identified, strict=True))
    ]
    if np.isfinite(found.residual):
        lines.append(f"residual {_residual(found)} N RMS")
    if np.isfinite(found.left_out):
        lines.append(f"error by leaving one feed out: {_left_out(found)} %")
    lines.append(f"forces computed with them: sigma {found.sigma_percent:.2g} %")
    return "\n".join(lines)


def _residual(found: IdentifiedMaterial) -> str:
    """Return the RMS residual [N] as text, without rounding errors of exact readings."""
    return f"{round(found.residual, 6):.3g}"


def _left_out(found: IdentifiedMaterial) -> str:
    """Return the error of a feed left out [%] as text, without rounding errors of exact readings."""
    return f"{round(100 * found.left_out, 6):.2g}"


def material_page(found: IdentifiedMaterial, readings: CutReadings, name: str) -> bytes:
    """Return the page as HTML in UTF-8: one file that loads nothing.

    :param name: of the file of readings.
    """
    tiles = [Tile("Residual, RMS", _residual(found), "N")] if np.isfinite(found.residual) else []
    if np.isfinite(found.left_out):
        tiles.append(Tile("Error by leaving one feed out", _left_out(found), "%"))
    tiles.append(Tile("Sigma of computed forces", f"{found.sigma_percent:.2g}", "%"))
    sections = [Section("numbers", "How well it fits", (Tiles(tuple(tiles)),))]
    if found.warnings:
        notes = tuple(Note(f"{text}.", "warning") for text in found.warnings)
        sections.append(Section("issues", "What to know", (Notes(notes, marked=True),)))
    fitted = found.predictor @ found.value
    unlike = len(set(readings.mode)) > 1
    for component in sorted(set(found.component.tolist())):
        sections.append(_fit_of(found, readings, fitted, component, unlike=unlike))
    rows = tuple(
        Row((each, f"{value:.4g}", f"{half:.2g}", "N/mm²" if k < 3 else "N/mm", "readings" if own else "process"))
        for k, (each, value, half, own) in enumerate(zip(NAMES, found.value, found.half, found.identified, strict=True))
    )
    head = ("coefficient", "value", "± 95 %", "unit", "from")
    table = Table(head, rows, "Cutting coefficients with 95 % intervals", texts=(3, 4))
    sections.append(Section("parameters", "Coefficients", (table,)))
    return b"".join(Page("Cutting coefficients", name, f"{len(readings.line)} cuts", tuple(sections)).render())


def _fit_of(
    found: IdentifiedMaterial, readings: CutReadings, fitted: Array, component: int, *, unlike: bool
) -> Section:
    """Return measured and fitted values of one component: over the feed, or one over the other for unlike cuts."""
    rows = np.flatnonzero(found.component == component)
    reading = found.reading[rows]
    name, unit = _COMPONENTS[component], "W" if component == 3 else "N"
    texts = [f"line {int(readings.line[k])}: {readings.mode[k]}, {readings.feed[k]:g} mm/min" for k in reading.tolist()]
    half = [1.96 * value for value in found.sigma[rows].tolist()]
    measured, expected = found.measured[rows], fitted[rows]
    if unlike:
        span = [float(min(measured.min(), expected.min())), float(max(measured.max(), expected.max()))]
        traces: list[Traced] = [
            Curve(span, span, "measured = fitted", "soft", dashed=True),
            Points(expected.tolist(), measured.tolist(), "measured", "force", half, texts=texts),
        ]
        x = Axis(title=f"fitted {name}, {unit}")
    else:
        order = np.argsort(readings.feed[reading])
        feed = readings.feed[reading]
        traces = [
            Curve(feed[order].tolist(), expected[order].tolist(), "fitted", "after"),
            Points(feed.tolist(), measured.tolist(), "measured", "force", half, texts=texts),
        ]
        x = Axis(title="feed, mm/min")
    plot = Plot(label=f"Measured and fitted {name}", traces=traces, x=x, y=Axis(title=f"{name}, {unit}"))
    return Section(f"fit-{name}", f"{name}: measured and fitted", (plot,), "half")
