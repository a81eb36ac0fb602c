"""Identified cutting coefficients as a page and as text: measured against fitted forces."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.machining.identification import NAMES, CutReadings, IdentifiedMaterial
from postproc.report.kit import Axis, Curve, Note, Notes, Page, Plot, Points, Row, Section, Table, Tile, Tiles
from postproc.report.kit.parts import PlotItem

_COMPONENT_NAMES = ("Fx", "Fy", "Fz", "power")
"""Names of `IdentifiedMaterial.component`."""
_UNITS = ("N/mm²",) * 3 + ("N/mm",) * 3
"""Units of the coefficients `NAMES`: three of shear, then three of the edge."""


def as_text(material: IdentifiedMaterial) -> str:
    """Return identified coefficients as text to print: values with 95 % intervals, residual, errors."""
    lines = [
        f"{name} {value:.4g} ± {half:.2g} {unit}{'' if is_identified else ' (not measured)'}"
        for name, value, half, unit, is_identified in zip(
            NAMES, material.value, material.half_width, _UNITS, material.identified, strict=True
        )
    ]
    if np.isfinite(material.residual):
        lines.append(f"residual {_residual_text(material)} N RMS")
    if np.isfinite(material.cross_validation_error):
        lines.append(f"error by leaving one feed out: {_left_out_text(material)} %")
    lines.append(f"forces computed with them: sigma {material.sigma_percent:.2g} %")
    return "\n".join(lines)


def _residual_text(material: IdentifiedMaterial) -> str:
    """Return the RMS residual [N] as text; rounded, so that exact readings have 0."""
    return f"{round(material.residual, 6):.3g}"


def _left_out_text(material: IdentifiedMaterial) -> str:
    """Return the error of a feed that is left out [%] as text; rounded, so that exact readings have 0."""
    return f"{round(100 * material.cross_validation_error, 6):.2g}"


def material_page(material: IdentifiedMaterial, readings: CutReadings, name: str) -> bytes:
    """Return the page as HTML in UTF-8: one file that loads nothing.

    :param name: name of the file of readings.
    """
    tiles = [Tile("Residual, RMS", _residual_text(material), "N")] if np.isfinite(material.residual) else []
    if np.isfinite(material.cross_validation_error):
        tiles.append(Tile("Error by leaving one feed out", _left_out_text(material), "%"))
    tiles.append(Tile("Sigma of computed forces", f"{material.sigma_percent:.2g}", "%"))
    sections = [Section("numbers", "How well it fits", (Tiles(tuple(tiles)),))]
    if material.warnings:
        notes = tuple(Note(f"{text}.", "warning") for text in material.warnings)
        sections.append(Section("issues", "What to know", (Notes(notes, bulleted=True),)))
    fit = material.predictor @ material.value
    has_several_modes = len(set(readings.mode)) > 1
    for component in sorted(set(material.component.tolist())):
        sections.append(_fit_section(material, readings, fit, component, has_several_modes=has_several_modes))
    sections.append(Section("parameters", "Coefficients", (_coefficient_table(material),)))
    return b"".join(Page("Cutting coefficients", name, f"{len(readings.line)} cuts", tuple(sections)).render())


def _coefficient_table(material: IdentifiedMaterial) -> Table:
    """Return the table of the cutting coefficients [N/mm², N/mm] with their 95 % intervals."""
    rows = tuple(
        Row((coefficient, f"{value:.4g}", f"{half:.2g}", unit, "readings" if is_identified else "process"))
        for coefficient, value, half, unit, is_identified in zip(
            NAMES, material.value, material.half_width, _UNITS, material.identified, strict=True
        )
    )
    head = ("coefficient", "value", "± 95 %", "unit", "from")
    return Table(head, rows, "Cutting coefficients with 95 % intervals", texts=(3, 4))


def _fit_section(
    material: IdentifiedMaterial, readings: CutReadings, fit: Array, component: int, *, has_several_modes: bool
) -> Section:
    """Return the section with a plot of measured and fitted values of one component.

    Cuts of one mode: both values over the feed. Cuts of several modes, which differ in more than the feed: measured
    over fitted values.

    :param fit: (n,) fitted value of each row of `material.measured` [N; power: W].
    :param component: index in `_COMPONENT_NAMES`.
    :param has_several_modes: the cuts are of several modes (slot, up, down).
    """
    rows = np.flatnonzero(material.component == component)
    reading = material.reading[rows]
    name, unit = _COMPONENT_NAMES[component], "W" if component == 3 else "N"  # 3: power
    texts = [f"line {int(readings.line[k])}: {readings.mode[k]}, {readings.feed[k]:g} mm/min" for k in reading.tolist()]
    half_widths = [1.96 * sigma for sigma in material.sigma[rows].tolist()]  # 95 % of a normal distribution
    measured_values, fitted_values = material.measured[rows], fit[rows]
    if has_several_modes:
        span = [
            float(min(measured_values.min(), fitted_values.min())),
            float(max(measured_values.max(), fitted_values.max())),
        ]
        traces: list[PlotItem] = [
            Curve(span, span, "measured = fitted", "soft", dashed=True),
            Points(fitted_values.tolist(), measured_values.tolist(), "measured", "force", half_widths, texts=texts),
        ]
        x = Axis(title=f"fitted {name}, {unit}")
    else:
        order = np.argsort(readings.feed[reading])
        feed = readings.feed[reading]
        traces = [
            Curve(feed[order].tolist(), fitted_values[order].tolist(), "fitted", "after"),
            Points(feed.tolist(), measured_values.tolist(), "measured", "force", half_widths, texts=texts),
        ]
        x = Axis(title="feed, mm/min")
    plot = Plot(label=f"Measured and fitted {name}", traces=traces, x=x, y=Axis(title=f"{name}, {unit}"))
    return Section(f"fit-{name}", f"{name}: measured and fitted", (plot,), "half")
