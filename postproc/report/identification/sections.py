"""Sections of the page of an identification."""

from __future__ import annotations

from collections.abc import Mapping

from postproc.identification.record import Identified, Parameter
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
    Part,
    Plot,
    Points,
    Row,
    Section,
    Span,
    Table,
    Tile,
    Tiles,
)
from postproc.robot import WITH_LINKS
from postproc.robot.parameters import named

_GOOD, _ROUGH = 0.1, 0.5
"""Half width of an interval as a share of the value: up to the first well known, beyond the second not."""
_FLOOR_MM = 1e-5
_SPRINGS = (
    f"A hollow circle is the robot's prior value. {WITH_LINKS}: the intervals are of that sum. Springs "
    "of links that lie alike in the chain are determined together, not one by one: each interval is wide, that of "
    "their sum is not."
)
_JOINTS = "Displacement of each joint from its nominal place on the link before it, axes of its nominal frame."


def summary(told: Identified) -> Section | None:
    """Return what came of it in numbers."""
    residual = told.residual
    if residual is None or told.parameters is None:
        return None
    shares = [entry.share for entry in told.parameters.values()]
    good = sum(share is not None and share <= _GOOD for share in shares)
    rough = sum(share is not None and _GOOD < share <= _ROUGH for share in shares)
    rest = len(shares) - good - rough
    note = (
        f"{rough} more to {_ROUGH * 100:.0f} %; {rest} not by themselves: prior value, or an interval as wide as that"
    )
    gain = residual.before_rms_mm / max(residual.rms_mm, 1e-12)
    tiles = (
        Tile("Displacement under load, RMS", f"{residual.before_rms_mm:.3f}", "mm"),
        Tile("Left by the model on these readings, RMS", f"{residual.rms_mm:.3f}", "mm", f"{gain:.0f} times less"),
        Tile(f"Parameters known to {_GOOD * 100:.0f} %", str(good), f"of {len(shares)}", note),
    )
    return Section("summary", "What came of it", (Tiles(tiles),))


def to_know(told: Identified) -> Section:
    """Return what the readings do not show, and warnings."""
    not_seen = told.not_observable or []
    if not not_seen and not told.warnings:
        text = "Every parameter shows in the readings; no reading was left out."
        return Section("to-know", "What to know", (Notes((Note(text, "good"),)),))
    missing = tuple(
        Note(f"{entry.name} is not observable: {entry.reason}. {entry.advice} The prior value stands in the model.")
        for entry in not_seen
    )
    known = tuple(f"{entry.name} is not observable" for entry in not_seen)
    others = tuple(Note(text, "warning") for text in told.warnings if not text.startswith(known or ("\0",)))
    return Section("to-know", "What to know", (Notes(missing + others, marked=True),))


def configurations(told: Identified) -> Section | None:
    """Return displacement and residual of each configuration."""
    if told.residual is None:
        return None
    rows = told.residual.per_configuration
    at = [row.config for row in rows]
    before = [max(row.before_mm, _FLOOR_MM) for row in rows]
    after = [max(row.after_mm, _FLOOR_MM) for row in rows]
    texts = [f"config {row.config:g}: {row.before_mm:.3f} → {row.after_mm:.4f} mm" for row in rows]
    plot = Plot(
        label="Displacement under load and what the model leaves, for each configuration; the table has the numbers",
        traces=[
            Span(at, after, before),
            Points(at, before, "displacement under load", "before", texts=texts),
            Points(at, after, "what the model leaves", "after", texts=texts),
        ],
        x=Axis(title="configuration"),
        y=Axis(title="mm RMS over the points", logarithmic=True),
        marks=[Mark(told.sigma_mm * 3**0.5, "one reading: σ·√3", "soft", level=True)],
    )
    cells = tuple(Row((f"{row.config:g}", f"{row.before_mm:.3f}", f"{row.after_mm:.4f}")) for row in rows)
    table = Table(("Configuration", "Under load, mm", "Left, mm"), cells, "RMS by configuration", sortable=True)
    return Section("configurations", "Residuals by configuration", (plot, Fold("The numbers", (table,))))


def parameters(told: Identified) -> Section | None:
    """Return the parameters with their intervals."""
    if not told.parameters:
        return None
    return Section("parameters", "Parameters with 95 % intervals", _intervals(told.parameters, _SPRINGS))


def _intervals(entries: Mapping[str, Parameter], note: str) -> tuple[Part, ...]:
    titles = [_title(name) for name in entries]
    shown = [(row, entry) for row, entry in enumerate(entries.values()) if entry.share is not None]
    priors = [
        (row, entry.prior / entry.value - 1.0)
        for row, entry in enumerate(entries.values())
        if entry.prior is not None and entry.value
    ]
    texts = [f"{titles[row]}: {entry.value:.5g} ± {entry.ci95:.2g} {entry.unit}" for row, entry in shown]
    plot = Plot(
        label="Half width of each interval in per cent of the value; the table has the numbers",
        traces=[
            Points(
                [max(-0.6, min(0.6, share)) * 100.0 for _, share in priors],
                [float(row) for row, _ in priors],
                "prior value",
                "soft",
                hollow=True,
            ),
            Points(
                [0.0] * len(shown),
                [float(row) for row, _ in shown],
                "value and interval",
                "after",
                half=[min(entry.share or 0.0, 1.0) * 100.0 for _, entry in shown],
                across=True,
                texts=texts,
            ),
        ],
        x=Axis(title="off the value, %", range=(-60.0, 60.0)),
        y=Axis(categories=titles),
        height=90 + 22 * len(titles),
        note=note,
    )
    rows = tuple(
        Row(
            (
                title,
                "-" if entry.value is None else f"{entry.value:.5g}",
                "prior" if entry.ci95 is None else f"± {entry.ci95:.2g}",
                entry.unit,
                _judged(entry),
            )
        )
        for title, entry in zip(titles, entries.values(), strict=True)
    )
    table = Table(("Parameter", "Value", "95 %", "Unit", ""), rows, "Values and intervals", texts=(3, 4))
    return plot, table


def _judged(entry: Parameter) -> Cell:
    kinds: tuple[tuple[float, str, Kind], ...] = ((_GOOD, "well known", "good"), (_ROUGH, "roughly known", ""))
    share = entry.share
    if share is None:
        return Cell("not from these readings", "warning")
    for limit, text, kind in kinds:
        if share <= limit:
            return Cell(text, kind)
    return Cell("not by itself: wide", "warning")


def _title(name: str) -> str:
    parameter = named(name)
    return name if parameter is None else parameter.title


def levels(told: Identified) -> Section | None:
    """Return the equivalent compliance of joint 2 by level."""
    if not told.k2_levels:
        return None
    at = [level.q2_deg for level in told.k2_levels]
    values = [level.value for level in told.k2_levels]
    half = [level.ci95 for level in told.k2_levels]
    curve = told.k2_curve or []
    texts = [f"q2 = {q:.1f}°: {v:.4f} ± {h or 0:.4f}" for q, v, h in zip(at, values, half, strict=True)]
    traces = [Curve([q for q, _ in curve], [v for _, v in curve], "the model at small load", "correction")]
    plot = Plot(
        label="Equivalent compliance of joint 2 at each level of q2, and of the model",
        traces=[
            *(traces if curve else []),
            Points(at, values, "level by level", "after", half=half, texts=texts),
        ],
        x=Axis(title="q2, °"),
        y=Axis(title="µrad/(N·m)"),
        note="Points: identified level by level (Eq. (8)), 95 %. Curve: what the model holds at small load, K⁰ and "
        "compensator together (Eq. (4)). Levels are found with joint springs alone: flexible links and stiffening "
        "gears show in them too.",
    )
    return Section("levels", "Equivalent compliance of joint 2 by level of q2", (plot,), "half")


def structures(told: Identified) -> Section | None:
    """Return the structures tried."""
    if told.structure is None:
        return None
    tried = told.structure.tried
    lengths = [max(row.held_out_sigma2, 0.1) for row in tried]
    plot = Plot(
        label="Mean square error of each structure on configurations left out, in units of the noise",
        traces=[
            Bars(
                lengths,
                [f"{row.held_out_sigma2:.2f} σ² · {row.active} parameters" for row in tried],
                [r.chosen for r in tried],
            )
        ],
        x=Axis(title="σ²", logarithmic=True),
        y=Axis(categories=[row.structure for row in tried]),
        marks=[Mark(1.0, "noise alone", "soft")],
        height=80 + 34 * len(tried),
        note=f"{told.structure.reason}.",
    )
    return Section("structures", "Structures tried: error on configurations left out", (plot,))


def correlations(told: Identified) -> Section | None:
    """Return how the parameters found depend on each other."""
    if told.correlation is None or len(told.correlation.names) < 2:
        return None
    names = told.correlation.names
    plot = Plot(
        label="Correlation of each pair of parameters",
        traces=[Matrix(names, told.correlation.matrix)],
        height=180 + min(40, max(900 // len(names), 18)) * len(names),
        note="Blue: together; orange: against. Point at a cell for its number.",
    )
    return Section("correlations", "Correlations of the parameters", (plot,))


def geometry(told: Identified) -> Section | None:
    """Return the variants of the geometry."""
    if told.geometry is None:
        return None
    variants = told.geometry.variants
    plot = Plot(
        label="RMS distance of unloaded readings on configurations left out, for each variant of the geometry",
        traces=[
            Bars(
                [row.held_out_rms_mm for row in variants.values()],
                [f"{row.held_out_rms_mm:.3f} mm (fit {row.rms_mm:.3f})" for row in variants.values()],
                [name == told.geometry.chosen for name in variants],
            )
        ],
        x=Axis(title="mm"),
        y=Axis(categories=list(variants)),
        height=80 + 34 * len(variants),
    )
    return Section("geometry", "Geometry: unloaded readings on configurations left out, RMS distance", (plot,))


def calibrated(told: Identified) -> Section | None:
    """Return the parameters of the geometry."""
    if told.geometry is None or not told.geometry.parameters:
        return None
    return Section("calibrated", "Calibrated geometry", _intervals(told.geometry.parameters, _JOINTS))


def placement(told: Identified) -> Section:
    """Return where robot and points stand."""
    rows = tuple(Row((name, *(f"{point[axis]:.3f}" for axis in "XYZ"))) for name, point in told.points.items())
    table = Table(("Point, flange frame", "X, mm", "Y, mm", "Z, mm"), rows, "Points in the flange frame")
    frame = ", ".join(f"{axis} {told.base[axis]:.3f}" for axis in "XYZABC")
    text = (
        f"Robot root in the frame of the device: {frame} (mm, °). The readings without load are "
        f"{told.unloaded_rms_mm:.3f} mm RMS off the geometry used."
    )
    return Section("placement", "Set-up found from the readings without load", (table, Notes((Note(text, "soft"),))))
