"""The page of an identification, a pure function of `identification.json`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from postproc.identification.record import RESERVATION, IdentificationRecord, Parameter
from postproc.report.formatting import two_digit_decimals
from postproc.report.kit import (
    Axis,
    Bars,
    Cell,
    Curve,
    Fold,
    Kind,
    Mark,
    Matrix,
    Note,
    Notes,
    Page,
    Part,
    Plot,
    Points,
    Row,
    Section,
    Span,
    Table,
    Tile,
    Tiles,
    Verdict,
)
from postproc.robot import WITH_LINKS
from postproc.robot.parameters import parameter_of_name

_WELL_KNOWN_SHARE, _ROUGHLY_KNOWN_SHARE, _BARELY_KNOWN_SHARE = 0.1, 0.5, 1.0
"""Largest half width of the 95 % interval, as a share of the value, of well, roughly and barely known parameters."""
_LEAST_SHARE_SHOWN, _LEAST_VALUE_IN_MILLIONS = 1e-3, 1e5
"""The scale of shares begins at 0.1 % or below; larger values than the second number are stated in millions."""
_LEAST_MM_SHOWN = 1e-5
"""Displacements are drawn on a logarithmic scale that begins at 0.01 µm."""
_SPRING_NOTE = (
    "The farther left, the better known; a hollow circle is how far off the robot's prior value was. "
    f"{WITH_LINKS}: the intervals are of that sum. Springs of links that lie alike in the chain are determined "
    "together, not one by one: each interval is wide, that of their sum is not."
)
_JOINT_NOTE = "Displacement of each joint from its nominal place on the link before it, axes of its nominal frame."


def verdict_section(data: IdentificationRecord) -> Section | None:
    """Return the section of the verdict: whether the model may be used, and within which bound.

    None without a verdict.
    """
    if data.verdict is None:
        return None
    if data.verdict.refused:
        reason = data.verdict.line.partition(": ")[2]
        part = Verdict("failed", "Not to be trusted.", f"{reason[:1].upper()}{reason[1:].rstrip('.')}.")
    elif reservation := data.verdict.line.partition(RESERVATION)[2]:
        part = Verdict("warning", "May be used,", f"within its bound{RESERVATION}{reservation.rstrip('.')}.")
    else:
        part = Verdict("ok", "May be used,", "within its bound.")
    notes = [Note(f"{line[:1].upper()}{line[1:]}.") for line in data.error_lines]
    if data.torque_Nm is not None:
        torques = ", ".join(f"{torque:.0f}" for torque in data.torque_Nm)
        notes.append(Note(f"The loads put up to {torques} N·m on A1 … A6: work that puts more is extrapolated."))
    return Section("verdict", "Verdict", (part, *((Notes(tuple(notes), bulleted=True),) if notes else ())))


def summary_section(data: IdentificationRecord) -> Section | None:
    """Return the section with the results in numbers; None if the record has no residual or no parameters."""
    residual = data.residual
    if residual is None or data.parameters is None:
        return None
    # half width of the 95 % interval over the value; None: the readings do not show the parameter
    shares = [entry.share for entry in data.parameters.values() if entry.share is not None]
    well_known_count, roughly_known_count, known_count = (
        sum(share <= limit for share in shares)
        for limit in (_WELL_KNOWN_SHARE, _ROUGHLY_KNOWN_SHARE, _BARELY_KNOWN_SHARE)
    )
    words = [
        f"{well_known_count} to {_WELL_KNOWN_SHARE * 100:.0f} %",
        f"{roughly_known_count - well_known_count} more to {_ROUGHLY_KNOWN_SHARE * 100:.0f} %",
        *([f"{known_count - roughly_known_count} barely"] if known_count > roughly_known_count else []),
        *([f"{len(shares) - known_count} only together with others"] if len(shares) > known_count else []),
        *(
            [f"{len(data.parameters) - len(shares)} not seen: prior value"]
            if len(shares) < len(data.parameters)
            else []
        ),
    ]
    gain = residual.before_rms_mm / max(residual.rms_mm, 1e-12)  # 1e-12: no division by zero
    tiles = (
        Tile("Displacement under load, RMS", f"{residual.before_rms_mm:.3f}", "mm"),
        Tile("Residual on these readings, RMS", f"{residual.rms_mm:.3f}", "mm", f"{gain:.0f} times less"),
        Tile("Parameters determined", str(known_count), f"of {len(data.parameters)}", "; ".join(words)),
    )
    return Section("summary", "Results", (Tiles(tiles),))


def findings_section(data: IdentificationRecord) -> Section:
    """Return the section with unidentifiable parameters, warnings and assumptions; a note without any."""
    unobservable = data.not_observable or []
    assumptions = tuple(Note(f"Assumed: {text}.") for text in data.assumptions or ())
    if not unobservable and not data.warnings and not assumptions:
        text = "Every parameter is identifiable; no reading was left out."
        return Section("to-know", "What to know", (Notes((Note(text, "good"),)),))
    unobservable_notes = tuple(
        Note(f"{entry.name} is not observable: {entry.reason}. {entry.advice} The model keeps the prior value.")
        for entry in unobservable
    )
    # warnings about these parameters would repeat the notes; startswith(()) is False: without any, all warnings stay
    stated_beginnings = tuple(f"{entry.name} is not observable" for entry in unobservable)
    warnings = tuple(Note(text, "warning") for text in data.warnings if not text.startswith(stated_beginnings))
    return Section("to-know", "What to know", (Notes(unobservable_notes + warnings + assumptions, bulleted=True),))


def configurations_section(data: IdentificationRecord) -> Section | None:
    """Return the section with displacement under load and residual [mm] of each configuration.

    None without residual.
    """
    if data.residual is None:
        return None
    rows = data.residual.per_configuration
    numbers = [row.config for row in rows]
    displacement = [max(row.before_mm, _LEAST_MM_SHOWN) for row in rows]
    residual = [max(row.after_mm, _LEAST_MM_SHOWN) for row in rows]
    texts = [f"config {row.config:g}: {row.before_mm:.3f} → {row.after_mm:.4f} mm" for row in rows]
    plot = Plot(
        label="Displacement under load and residual of the model, for each configuration; the table has the numbers",
        traces=[
            Span(numbers, residual, displacement),
            Points(numbers, displacement, "displacement under load", "before", texts=texts),
            Points(numbers, residual, "residual of the model", "after", texts=texts),
        ],
        x=Axis(title="configuration"),
        y=Axis(title="distance, RMS over the points, mm", logarithmic=True),
        # the distance of one reading, of three coordinates with the noise σ each
        marks=[Mark(data.sigma_mm * 3**0.5, "one reading: σ·√3", "soft", level=True)],
    )
    cells = tuple(Row((f"{row.config:g}", f"{row.before_mm:.3f}", f"{row.after_mm:.4f}")) for row in rows)
    table = Table(("Configuration", "Under load, mm", "Residual, mm"), cells, "RMS by configuration", sortable=True)
    return Section("configurations", "Residuals by configuration", (plot, Fold("The numbers", (table,))))


def parameters_section(data: IdentificationRecord) -> Section | None:
    """Return the section of the parameters with their 95 % intervals; None without parameters."""
    if not data.parameters:
        return None
    return Section("parameters", "Parameters with 95 % intervals", _interval_parts(data.parameters, _SPRING_NOTE))


def _interval_parts(entries: Mapping[str, Parameter], note: str) -> tuple[Part, ...]:
    """Return a plot and a table of the 95 % intervals of parameters, in the order of `entries`.

    :param entries: name of each parameter → value and interval.
    :param note: a sentence below the plot.
    """
    titles = [_parameter_title(name) for name in entries]
    rows = tuple(
        Row((title, *value_texts(entry), _accuracy_cell(entry)))
        for title, entry in zip(titles, entries.values(), strict=True)
    )
    table = Table(("Parameter", "Value", "95 %", "Unit", ""), rows, "Values and intervals", texts=(3, 4))
    return _interval_plot(entries, titles, note), table


def _interval_plot(entries: Mapping[str, Parameter], titles: list[str], note: str) -> Plot:
    """Return the plot of half widths of 95 % intervals, and of errors of prior values, in percent of the values.

    A parameter is a category of the y axis: its dots are at the height of its number in `entries`.

    :param titles: titles of the parameters, in the order of `entries`.
    :param note: a sentence below the plot.
    """
    shares = {row: entry.share for row, entry in enumerate(entries.values()) if entry.share is not None}
    smallest, largest = min([_LEAST_SHARE_SHOWN, *shares.values()]), max([1.0, *shares.values()])
    prior_errors = {
        row: abs(entry.prior / entry.value - 1.0)
        for row, entry in enumerate(entries.values())
        if entry.prior is not None and entry.value and entry.share is not None
    }
    prior_dots = Points(
        [100.0 * min(max(error, smallest), largest) for error in prior_errors.values()],
        [float(row) for row in prior_errors],
        "prior value off by",
        "soft",
        hollow=True,
        texts=[f"{titles[row]}: prior value off by {_percent_text(error)}" for row, error in prior_errors.items()],
    )
    interval_dots = Points(
        [100.0 * share for share in shares.values()],
        [float(row) for row in shares],
        "half width of the interval",
        "after",
        texts=[f"{titles[row]}: known to {_percent_text(share)}" for row, share in shares.items()],
    )
    return Plot(
        label="Half width of each 95 % interval in per cent of the value; the table has the numbers",
        traces=[prior_dots, interval_dots],
        x=Axis(
            title="half width of the interval, % of the value",
            logarithmic=True,
            range=(80.0 * smallest, 130.0 * largest),  # in percent, with a margin
        ),
        y=Axis(categories=titles),
        marks=[
            Mark(100.0 * limit, f"{100.0 * limit:.0f} %", "soft") for limit in (_WELL_KNOWN_SHARE, _BARELY_KNOWN_SHARE)
        ],
        height=90 + 22 * len(titles),  # [px]: axis and marks, and a line for each title
        note=note,
    )


def _percent_text(share: float) -> str:
    """Return a share in percent, with two significant digits below 100 %."""
    return f"{100.0 * share:.2g} %" if share < 1.0 else f"{100.0 * share:.0f} %"


class ValueTexts(NamedTuple):
    """Value, interval and unit of a parameter as texts.

    :param value: the value; "-" if it is unknown.
    :param interval: "±" and half width of the 95 % interval; "prior" without an interval.
    :param unit: unit of value and interval.
    """

    value: str
    interval: str
    unit: str


def value_texts(entry: Parameter) -> ValueTexts:
    """Return a parameter as texts.

    The value has as many decimals as two digits of its interval; without an interval, three digits. Large values are in
    millions.
    """
    is_large = entry.value is not None and abs(entry.value) >= _LEAST_VALUE_IN_MILLIONS
    scale, unit = (1e6, f"10⁶ {entry.unit}") if is_large else (1.0, entry.unit)
    if entry.value is None:
        value = "-"
    elif entry.ci95 is None:
        value = f"{entry.value / scale:.3g}"
    else:
        value = f"{entry.value / scale:.{two_digit_decimals(entry.ci95 / scale)}f}"
    return ValueTexts(
        value,
        "prior" if entry.ci95 is None else f"± {entry.ci95 / scale:.2g}",
        unit.replace("urad", "µrad").replace("um/", "µm/"),
    )


def _accuracy_cell(entry: Parameter) -> Cell:
    """Return words on the accuracy of a parameter, by its share: half width of the 95 % interval over the value."""
    accuracy_steps: tuple[tuple[float, str, Kind], ...] = (
        (_WELL_KNOWN_SHARE, "well known", "good"),
        (_ROUGHLY_KNOWN_SHARE, "roughly known", ""),
        (_BARELY_KNOWN_SHARE, "barely known", "warning"),
    )
    share = entry.share
    if share is None:
        return Cell("not from these readings", "warning")
    for limit, text, kind in accuracy_steps:
        if share <= limit:
            return Cell(text, kind)
    return Cell("only together with others", "warning")


def _parameter_title(name: str) -> str:
    """Return the title of a parameter for readers; its name if the robot model has no such parameter."""
    parameter = parameter_of_name(name)
    return name if parameter is None else parameter.title


def levels_section(data: IdentificationRecord) -> Section | None:
    """Return the section with the equivalent compliance of joint 2 [µrad/(N·m)] by level of q2; None without levels."""
    if not data.k2_levels:
        return None
    angles = [level.q2_deg for level in data.k2_levels]
    compliances = [level.value for level in data.k2_levels]
    half_widths = [level.ci95 for level in data.k2_levels]
    model_curve = data.k2_curve or []  # pairs of q2 [deg] and compliance of the model
    texts = [
        f"q2 = {q:.1f}°: {k2:.4f} ± {half or 0:.4f}"  # no interval: ± 0
        for q, k2, half in zip(angles, compliances, half_widths, strict=True)
    ]
    model_traces = [
        Curve([q for q, _ in model_curve], [k2 for _, k2 in model_curve], "the model at small load", "correction")
    ]
    plot = Plot(
        label="Equivalent compliance of joint 2 at each level of q2, and of the model",
        traces=[
            *(model_traces if model_curve else []),
            Points(angles, compliances, "level by level", "after", half=half_widths, texts=texts),
        ],
        x=Axis(title="q2, °"),
        y=Axis(title="compliance of joint 2, µrad/(N·m)"),
        note="Points: identified level by level (Eq. (8)), 95 %. Curve: what the model holds at small load, K⁰ and "
        "compensator together (Eq. (4)). Levels are found with joint springs alone: flexible links and stiffening "
        "gears show in them too.",
    )
    return Section("levels", "Equivalent compliance of joint 2 by level of q2", (plot,))


def structures_section(data: IdentificationRecord) -> Section | None:
    """Return the section that lists the structures tried, with their cross-validation errors.

    None if the record has no structures.
    """
    if data.structure is None:
        return None
    rows = data.structure.tried
    lengths = [max(row.held_out_sigma2, 0.1) for row in rows]  # the scale is logarithmic
    plot = Plot(
        label="Mean square error of each structure on configurations left out, in units of the noise",
        traces=[
            Bars(
                lengths,
                [f"{row.held_out_sigma2:.2f} σ² · {row.active} parameters" for row in rows],
                [row.chosen for row in rows],
            )
        ],
        x=Axis(title="mean square error, σ²", logarithmic=True),
        y=Axis(categories=[row.structure for row in rows]),
        marks=[Mark(1.0, "noise alone", "soft")],
        height=_bars_height(len(rows)),
        note=f"{data.structure.reason}.",
    )
    return Section("structures", "Structures tried: error on configurations left out", (plot,))


def _bars_height(count: int) -> int:
    """Return the height of a plot of horizontal bars [px]: of its axis, and of `count` bars."""
    return 80 + 34 * count


def correlations_section(data: IdentificationRecord) -> Section | None:
    """Return the section on the correlations of the identified parameters; None with fewer than two parameters."""
    if data.correlation is None or len(data.correlation.names) < 2:
        return None
    names = data.correlation.names
    # some 900 px in all; names stay legible from 18 px on
    row_height = min(40, max(900 // len(names), 18))
    plot = Plot(
        label="Correlation of each pair of parameters",
        traces=[Matrix(names, data.correlation.matrix)],
        height=180 + row_height * len(names),  # [px]: 180 for the names below
        note="Blue: together; orange: against. Point at a cell for its number.",
    )
    return Section("correlations", "Correlations of the parameters", (plot,))


def geometry_section(data: IdentificationRecord) -> Section | None:
    """Return the section that compares the variants of the geometry; None if the geometry was not identified."""
    if data.geometry is None:
        return None
    variants = data.geometry.variants
    plot = Plot(
        label="RMS distance of unloaded readings on configurations left out, for each variant of the geometry",
        traces=[
            Bars(
                [row.held_out_rms_mm for row in variants.values()],
                [f"{row.held_out_rms_mm:.3f} mm (fit {row.rms_mm:.3f})" for row in variants.values()],
                [name == data.geometry.chosen for name in variants],
            )
        ],
        x=Axis(title="RMS distance, mm"),
        y=Axis(categories=list(variants)),
        height=_bars_height(len(variants)),
    )
    return Section("geometry", "Geometry: unloaded readings on configurations left out, RMS distance", (plot,))


def calibration_section(data: IdentificationRecord) -> Section | None:
    """Return the section with the calibrated geometry and its 95 % intervals; None if no geometry was identified."""
    if data.geometry is None or not data.geometry.parameters:
        return None
    return Section("calibrated", "Calibrated geometry", _interval_parts(data.geometry.parameters, _JOINT_NOTE))


def placement_section(data: IdentificationRecord) -> Section:
    """Return the section with the placement of the robot root in the device frame and of the points on the flange."""
    rows = tuple(Row((name, *(f"{point[axis]:.3f}" for axis in "XYZ"))) for name, point in data.points.items())
    table = Table(("Point, flange frame", "X, mm", "Y, mm", "Z, mm"), rows, "Points in the flange frame")
    frame = ", ".join(f"{axis} {data.base[axis]:.3f}" for axis in "XYZABC")
    text = (
        f"Robot root in the frame of the device: {frame} (mm, °). The readings without load are "
        f"{data.unloaded_rms_mm:.3f} mm RMS off the geometry used."
    )
    return Section("placement", "Set-up found from the readings without load", (table, Notes((Note(text, "soft"),))))


SECTIONS: tuple[Callable[[IdentificationRecord], Section | None], ...] = (
    verdict_section,
    summary_section,
    findings_section,
    configurations_section,
    parameters_section,
    levels_section,
    structures_section,
    correlations_section,
    geometry_section,
    calibration_section,
    placement_section,
)
"""Functions of the sections of the page, in order; a section without content is None."""


def page(data: IdentificationRecord, name: str) -> bytes:
    """Return the page as HTML in UTF-8: one file that loads nothing.

    :param data: content of `identification.json`.
    :param name: name of the written model.
    """
    count = "" if data.residual is None else f"{len(data.residual.per_configuration)} configurations · "
    sections = tuple(section for section_of in SECTIONS if (section := section_of(data)) is not None)
    footer = (
        Note(
            "Intervals are 95 %, from the noise of the readings; what the structure of the model does not describe "
            "comes on top, see the errors on configurations left out."
        ),
    )
    subtitle = f"found from {data.robot}, method {data.method} · {count}noise σ {data.sigma_mm:.3g} mm a coordinate"
    return b"".join(Page("Identification report", name, subtitle, sections, footer).render())
