"""`report.html` of an identification: one self-contained page, no scripts, nothing loaded from elsewhere.

A pure function of `identification.json`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import log10
from typing import Any

from postproc.report.charts import ticks
from postproc.report.style import CSS
from postproc.robot.parameters import named

_WIDTH = 1000
_LEFT, _RIGHT = 64, 16
_PLOT = _WIDTH - _LEFT - _RIGHT
_SPRINGS = (
    "A hollow circle is the robot's prior value. Springs of links that lie alike in the chain are determined together, "
    "not one by one: their intervals are wide, their sum is not."
)
_MORE = """
.dot.before{fill:var(--before)}.dot.after{fill:var(--after)}.dot.prior{fill:none;stroke:var(--soft);stroke-width:1.5}
.span{stroke:var(--rule);stroke-width:3}.bar{fill:var(--rule)}.bar.chosen{fill:var(--after)}
.whisker{stroke:var(--after);stroke-width:2}.curve{fill:none;stroke:var(--moved);stroke-width:2}
.noise{stroke:var(--soft);stroke-dasharray:5 4}.left{text-anchor:start}.right{text-anchor:end}.mid{text-anchor:middle}
.wide td:nth-child(2){width:42%}.wide td,.wide th{white-space:nowrap}.plain td{text-align:left}
dl.missing dt{font-weight:600;margin-top:8px}dl.missing dd{margin:0;color:var(--soft)}
"""


def page(data: Mapping[str, Any]) -> bytes:
    """Return the report as HTML in UTF-8.

    :param data: content of `identification.json`.
    """
    name = escape(str(data["robot"]))
    parts = [f'<header><p class="kind">Identification report</p><h1>{name}</h1><p>{_subtitle(data)}</p></header>']
    if "residual" in data:
        parts += [_tiles(data), _notes(data), _configurations(data), _parameters(data["parameters"], _SPRINGS)]
        parts += [_levels(data), _structures(data), _correlations(data)]
    parts += [_geometry(data), _setup(data)]
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{name}: identification report</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{CSS}{_MORE}</style></head>\n<body><main>\n" + "\n".join(parts) + "\n</main></body></html>\n"
    ).encode()


def _subtitle(data: Mapping[str, Any]) -> str:
    count = f"{len(data['residual']['per_configuration'])} configurations · " if "residual" in data else ""
    return f"method {escape(data['method'])} · {count}noise σ {data['sigma_mm']:.3g} mm a coordinate"


def _tiles(data: Mapping[str, Any]) -> str:
    residual = data["residual"]
    gain = residual["before_rms_mm"] / max(residual["rms_mm"], 1e-12)
    seen = sum(1 for entry in data["parameters"].values() if entry["observable"])
    tiles = [
        ("displacement under load (RMS)", f"{residual['before_rms_mm']:.3f}", "mm"),
        ("left by the model (RMS)", f"{residual['rms_mm']:.3f}", "mm"),
        ("gain on these readings", f"{gain:.0f}", "times"),
        ("parameters determined", f"{seen}", f"of {len(data['parameters'])}"),
    ]
    cells = (f"<div><dt>{label}</dt><dd>{value} <small>{unit}</small></dd></div>" for label, value, unit in tiles)
    return f'<dl class="tiles">{"".join(cells)}</dl>'


def _notes(data: Mapping[str, Any]) -> str:
    if not data["not_observable"] and not data["warnings"]:
        return "<section><h2>What to know</h2><p>All parameters are determined; no reading was left out.</p></section>"
    entries = "".join(
        f"<dt>{escape(entry['name'])} is not observable</dt>"
        f"<dd>{escape(entry['reason'])}. {escape(entry['advice'])} The prior value stands in the model.</dd>"
        for entry in data["not_observable"]
    )
    known = {entry["name"] for entry in data["not_observable"]}
    others = [w for w in data["warnings"] if not any(w.startswith(f"{name} is not observable") for name in known)]
    notes = "".join(f'<p class="warning">{escape(warning)}</p>' for warning in others)
    return f'<section><h2>What to know</h2><dl class="missing">{entries}</dl>{notes}</section>'


def _configurations(data: Mapping[str, Any]) -> str:
    rows = data["residual"]["per_configuration"]
    values = [max(v, 1e-5) for row in rows for v in (row["before_mm"], row["after_mm"])]
    low, high = log10(min(values)) - 0.1, log10(max(values)) + 0.1
    height, top = 300, 16

    def place(value: float) -> float:
        return top + height * (high - log10(max(value, 1e-5))) / (high - low)

    parts = []
    for exponent in range(int(low) - 1, int(high) + 2):
        for factor in (1, 2, 5):
            value = factor * 10.0**exponent
            if low <= log10(value) <= high:
                parts.append(_rule(place(value), f"{value:g}"))
    step = _PLOT / max(len(rows), 1)
    noise = data["sigma_mm"] * 3**0.5
    if low <= log10(noise) <= high:
        y = place(noise)
        parts.append(f'<path class="noise" d="M{_LEFT} {y:.1f}H{_WIDTH - _RIGHT}"/>')
        parts.append(f'<text class="note right" x="{_WIDTH - _RIGHT}" y="{y - 5:.1f}">one reading: σ·√3</text>')
    for index, row in enumerate(rows):
        x = _LEFT + (index + 0.5) * step
        before, after = place(row["before_mm"]), place(row["after_mm"])
        tip = f"config {row['config']:g}: {row['before_mm']:.3f} → {row['after_mm']:.4f} mm"
        parts.append(
            f'<g><title>{tip}</title><path class="span" d="M{x:.1f} {before:.1f}V{after:.1f}"/>'
            f'<circle class="dot before" cx="{x:.1f}" cy="{before:.1f}" r="5"/>'
            f'<circle class="dot after" cx="{x:.1f}" cy="{after:.1f}" r="5"/></g>'
        )
        if len(rows) <= 40 or index % 5 == 0:
            parts.append(f'<text class="mid" x="{x:.1f}" y="{top + height + 18}">{row["config"]:g}</text>')
    parts.append(f'<text class="right" x="{_WIDTH - _RIGHT}" y="{top + height + 36}">configuration</text>')
    legend = (
        '<ul class="legend"><li><i style="background:var(--before)"></i>displacement under load</li>'
        '<li><i style="background:var(--after)"></i>what the model leaves</li></ul>'
    )
    return (
        "<section><h2>Residuals by configuration, mm RMS over the points (logarithmic)</h2>"
        f"{_svg(top + height + 42, 'residuals before and after', parts)}{legend}</section>"
    )


def _rule(y: float, label: str) -> str:
    return (
        f'<path class="grid" d="M{_LEFT} {y:.1f}H{_WIDTH - _RIGHT}"/>'
        f'<text class="right" x="{_LEFT - 6}" y="{y + 4:.1f}">{label}</text>'
    )


def _svg(height: float, label: str, parts: Sequence[str]) -> str:
    return f'<svg viewBox="0 0 {_WIDTH} {height:.0f}" role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'


def _parameters(entries: Mapping[str, Any], note: str) -> str:
    rows = []
    for name, entry in entries.items():
        half = entry["ci95"]
        value = f"{entry['value']:.5g}"
        interval = "prior" if half is None else f"± {half:.2g}"
        rows.append(
            f"<tr><th>{_title(name)}</th><td>{_forest(entry)}</td><td>{value}</td><td>{interval}</td>"
            f"<td>{escape(entry['unit'])}</td></tr>"
        )
    return (
        "<section><h2>Parameters with 95 % intervals</h2>"
        '<table class="wide"><thead><tr><th>Parameter</th><th>interval, % of the value (−50 … +50)</th><th>Value</th>'
        f"<th>95 %</th><th>Unit</th></tr></thead><tbody>{''.join(rows)}</tbody></table>"
        f"<p>{note}</p></section>"
    )


def _title(name: str) -> str:
    parameter = named(name)
    return escape(name if parameter is None else parameter.title)


def _forest(entry: Mapping[str, Any]) -> str:
    width, middle = 400.0, 200.0
    parts = [f'<path class="grid" d="M0 9H{width:.0f}M{middle:.0f} 2V16"/>']
    value, half = entry["value"], entry["ci95"]
    if half is not None and value:
        reach = min(abs(half / value), 0.5) / 0.5 * middle
        parts.append(f'<path class="whisker" d="M{middle - reach:.1f} 9H{middle + reach:.1f}"/>')
        parts.append(f'<circle class="dot after" cx="{middle:.0f}" cy="9" r="4"/>')
        if abs(half / value) > 0.5:
            parts.append(
                f'<path class="whisker" d="M6 4L0 9L6 14M{width - 6:.0f} 4L{width:.0f} 9L{width - 6:.0f} 14"/>'
            )
    prior = entry.get("prior")
    if prior is not None and value:
        x = middle + max(-1.0, min(1.0, (prior / value - 1.0) / 0.5)) * (middle - 6)
        parts.append(f'<circle class="dot prior" cx="{x:.1f}" cy="9" r="4"/>')
    return f'<svg viewBox="0 0 400 18" role="img" aria-label="interval">{"".join(parts)}</svg>'


def _levels(data: Mapping[str, Any]) -> str:
    levels, curve = data["k2_levels"], data.get("k2_curve", [])
    if not levels:
        return ""
    values = [e["value"] + s * (e["ci95"] or 0.0) for e in levels for s in (-1, 1)] + [p[1] for p in curve]
    grid = ticks(0.0, max(values) - min(values) or 1.0, 5)
    step = grid[1] - grid[0]
    low = step * (min(values) // step)
    high = step * (max(values) // step + 1)
    angles = [e["q2_deg"] for e in levels] + [p[0] for p in curve]
    left, right = min(angles) - 5.0, max(angles) + 5.0
    height, top = 220, 16

    def across(angle: float) -> float:
        return float(_LEFT + _PLOT * (angle - left) / (right - left))

    def up(value: float) -> float:
        return float(top + height * (high - value) / (high - low))

    parts = [_rule(up(low + i * step), f"{low + i * step:.4g}") for i in range(round((high - low) / step) + 1)]
    if curve:
        path = "L".join(f"{across(a):.1f} {up(v):.1f}" for a, v in curve)
        parts.append(f'<path class="curve" d="M{path}"/>')
    for entry in levels:
        x, y = across(entry["q2_deg"]), up(entry["value"])
        reach = 0.0 if entry["ci95"] is None else up(entry["value"] - entry["ci95"]) - y
        parts.append(
            f"<g><title>q2 = {entry['q2_deg']:.1f}°: {entry['value']:.4f} ± {entry['ci95'] or 0:.4f}</title>"
            f'<path class="whisker" d="M{x:.1f} {y - reach:.1f}V{y + reach:.1f}M{x - 6:.1f} {y - reach:.1f}h12'
            f'M{x - 6:.1f} {y + reach:.1f}h12"/><circle class="dot after" cx="{x:.1f}" cy="{y:.1f}" r="5"/></g>'
            f'<text class="mid" x="{x:.1f}" y="{top + height + 18}">{entry["q2_deg"]:.0f}°</text>'
        )
    parts.append(f'<text class="right" x="{_WIDTH - _RIGHT}" y="{top + height + 36}">q2</text>')
    return (
        "<section><h2>Equivalent compliance of joint 2 by level of q2, µrad/(N·m)</h2>"
        f"{_svg(top + height + 42, 'k2 by level', parts)}<p>Points: identified level by level (Eq. (8)), 95 %. Curve: "
        "what the model holds at small load, K⁰ and compensator together (Eq. (4)). Levels are found with joint "
        "springs alone: flexible links and stiffening gears show in them too.</p></section>"
    )


def _structures(data: Mapping[str, Any]) -> str:
    if "structure" not in data:
        return ""
    tried = data["structure"]["tried"]
    values = [max(row["held_out_sigma2"], 0.1) for row in tried]
    low, high = log10(min(*values, 1.0)) - 0.1, log10(max(values)) + 0.1
    text, bar = 520, 26
    parts = []
    room = _WIDTH - text - 165
    noise = text + room * (0.0 - low) / (high - low)
    for index, (row, value) in enumerate(zip(tried, values, strict=True)):
        y = 8 + index * bar
        length = room * (log10(value) - low) / (high - low)
        style = "bar chosen" if row["chosen"] else "bar"
        label = f"{row['held_out_sigma2']:.2f} σ²"
        parts.append(
            f'<text class="right{" note" if row["chosen"] else ""}" x="{text - 10}" y="{y + 14}">'
            f"{escape(row['structure'])}</text>"
            f'<rect class="{style}" x="{text}" y="{y + 2}" width="{max(length, 1):.1f}" height="16" rx="2"/>'
            f'<text class="left" x="{text + length + 8:.1f}" y="{y + 14}">{label} · {row["active"]} parameters</text>'
        )
    bottom = 8 + len(tried) * bar
    parts.append(f'<path class="noise" d="M{noise:.1f} 4V{bottom}"/>')
    parts.append(f'<text class="mid" x="{noise:.1f}" y="{bottom + 14}">noise alone</text>')
    return (
        "<section><h2>Structures tried: error on configurations left out (mean square, logarithmic)</h2>"
        f"{_svg(bottom + 20, 'cross-validation', parts)}<p>{escape(data['structure']['reason'])}.</p></section>"
    )


def _correlations(data: Mapping[str, Any]) -> str:
    names, matrix = data["correlation"]["names"], data["correlation"]["matrix"]
    count = len(names)
    if count < 2:
        return ""
    size = min(44.0, 560.0 / count)
    margin = 90
    parts = []
    for row in range(count):
        for column in range(count):
            value = matrix[row][column]
            colour = "var(--after)" if value >= 0 else "var(--before)"
            x, y = margin + column * size, 4 + row * size
            parts.append(
                f"<g><title>{escape(names[row])} – {escape(names[column])}: {value:.2f}</title>"
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{size - 1:.1f}" height="{size - 1:.1f}" fill="{colour}" '
                f'fill-opacity="{min(abs(value), 1.0):.2f}" stroke="var(--rule)" stroke-width=".5"/></g>'
            )
            if size > 30 and row != column:
                parts.append(f'<text class="mid" x="{x + size / 2:.1f}" y="{y + size / 2 + 4:.1f}">{value:.2f}</text>')
        if size > 11:
            parts.append(
                f'<text class="right" x="{margin - 6}" y="{4 + (row + 0.5) * size + 4:.1f}">{escape(names[row])}</text>'
            )
            x = margin + (row + 0.5) * size
            y = 4 + count * size + 8
            parts.append(
                f'<text class="right" x="{x:.1f}" y="{y:.1f}" transform="rotate(-60 {x:.1f} {y:.1f})">'
                f"{escape(names[row])}</text>"
            )
    height = 4 + count * size + 70
    chart = f'<svg viewBox="0 0 {_WIDTH} {height:.0f}" role="img" aria-label="correlations">{"".join(parts)}</svg>'
    return f"<section><h2>Correlations of the parameters</h2>{chart}<p>Blue: together; orange: against.</p></section>"


def _geometry(data: Mapping[str, Any]) -> str:
    if "geometry" not in data:
        return ""
    geometry = data["geometry"]
    highest = max(row["held_out_rms_mm"] for row in geometry["variants"].values())
    parts, text, bar = [], 320, 26
    for index, (label, row) in enumerate(geometry["variants"].items()):
        y = 8 + index * bar
        length = (_WIDTH - text - 200) * row["held_out_rms_mm"] / highest
        chosen = label == geometry["chosen"]
        parts.append(
            f'<text class="right{" note" if chosen else ""}" x="{text - 10}" y="{y + 14}">{escape(label)}</text>'
            f'<rect class="bar{" chosen" if chosen else ""}" x="{text}" y="{y + 2}" width="{length:.1f}" height="16"/>'
            f'<text class="left" x="{text + length + 8:.1f}" y="{y + 14}">{row["held_out_rms_mm"]:.3f} mm '
            f"(fit {row['rms_mm']:.3f})</text>"
        )
    chart = _svg(12 + len(geometry["variants"]) * bar, "geometry variants", parts)
    table = ""
    if geometry["parameters"]:
        note = "Displacement of each joint from its nominal place on the link before it, axes of its nominal frame."
        table = _parameters(geometry["parameters"], note)
    return (
        "<section><h2>Geometry: RMS distance of unloaded readings, on configurations left out</h2>"
        f"{chart}</section>{table}"
    )


def _setup(data: Mapping[str, Any]) -> str:
    base = data["base"]
    rows = "".join(
        f"<tr><th>{escape(name)}</th>" + "".join(f"<td>{point[axis]:.3f}</td>" for axis in "XYZ") + "</tr>"
        for name, point in data["points"].items()
    )
    frame = ", ".join(f"{axis} {base[axis]:.3f}" for axis in "XYZABC")
    return (
        "<section><h2>Set-up found from the readings without load</h2>"
        "<table><thead><tr><th>Point, flange frame</th><th>X, mm</th><th>Y, mm</th><th>Z, mm</th></tr></thead>"
        f"<tbody>{rows}</tbody></table><p>Robot root in the frame of the device: {frame} (mm, deg). The readings "
        f"without load are {data['unloaded_rms_mm']:.3f} mm RMS off the geometry used.</p></section>"
    )
