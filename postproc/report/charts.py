"""Charts as inline SVG, of bounded size however many targets there are.

Curves of more than some thousand points are drawn as bands between the minimum and the maximum in each column of
pixels, so that no peak is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from postproc.frames import Array
from postproc.program import Bools, Ints

WIDTH = 1000
_LEFT, _RIGHT = 64, 16
_PLOT = WIDTH - _LEFT - _RIGHT
_EXACT = 1500
_MAP_HEIGHT = 560
_MAP_POINTS = 20_000
CLASSES = ("c0", "c1", "c2", "c3", "c4", "c5", "c6", "c7")
"""CSS classes of the colours of the map, from small to large."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One strip of a chart.

    :param title: what is shown, with unit.
    :param values: (K,) in that unit.
    :param style: CSS class.
    :param height: pixels.
    :param mark: text at the largest value, or empty.
    """

    title: str
    values: Array
    style: str
    height: int = 150
    mark: str = ""


def strips(x: Array, x_title: str, shown: Bools, curves: Sequence[Curve], label: str) -> str:
    """Return an SVG of curves one above the other over the same x.

    :param x: (K,) never decreasing.
    :param shown: (K,) False where the curves are interrupted.
    :param label: what a screen reader says.
    """
    span = float(x[-1] - x[0]) or 1.0
    horizontal = _LEFT + (x - x[0]) / span * _PLOT
    parts, top = [], 0
    for curve in curves:
        parts.append(_strip(horizontal, shown, curve, top))
        top += curve.height + 34
    for value in ticks(float(x[0]), float(x[0]) + span, 8):
        place = _LEFT + (value - x[0]) / span * _PLOT
        parts.append(f'<text class="tick" x="{place:.1f}" y="{top + 7}" text-anchor="middle">{value:g}</text>')
    parts.append(f'<text class="tick" x="{WIDTH - _RIGHT}" y="{top + 25}" text-anchor="end">{escape(x_title)}</text>')
    return _svg(top + 30, label, parts)


def _strip(horizontal: Array, shown: Bools, curve: Curve, top: int) -> str:
    base = top + 24 + curve.height
    values = curve.values[shown]
    grid = ticks(0.0, float(values.max(initial=0.0)) or 1.0, 4)
    highest = max(grid[-1], float(values.max(initial=0.0)) * 1.08)
    vertical = base - np.where(shown, curve.values, 0.0) / highest * curve.height
    parts = [f'<text class="title" x="{_LEFT}" y="{top + 15}">{escape(curve.title)}</text>']
    for value in grid:
        place = base - value / highest * curve.height
        parts.append(f'<path class="grid" d="M{_LEFT} {place:.1f}H{WIDTH - _RIGHT}"/>')
        parts.append(f'<text class="tick" x="{_LEFT - 6}" y="{place + 4:.1f}" text-anchor="end">{value:g}</text>')
    draw = _line if np.count_nonzero(shown) <= _EXACT else _band
    parts.append(draw(horizontal, vertical, shown, curve.style))
    if curve.mark and len(values):
        row = int(np.argmax(np.where(shown, curve.values, -1.0)))
        side = "end" if horizontal[row] > _LEFT + 0.7 * _PLOT else "start"
        shift = -7 if side == "end" else 7
        parts.append(f'<circle class="mark" cx="{horizontal[row]:.1f}" cy="{vertical[row]:.1f}" r="3.5"/>')
        parts.append(
            f'<text class="note" x="{horizontal[row] + shift:.1f}" y="{max(vertical[row] - 5, top + 30):.1f}" '
            f'text-anchor="{side}">{escape(curve.mark)}</text>'
        )
    return "".join(parts)


def _line(horizontal: Array, vertical: Array, shown: Bools, style: str) -> str:
    """Return the curve point by point, broken where not shown."""
    rows = np.flatnonzero(shown)
    path = []
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if len(run) == 1:
            path.append(f"M{horizontal[run[0]]:.1f} {vertical[run[0]]:.1f}h.5")
        elif len(run):
            path.append("M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(horizontal[run], vertical[run], strict=True)))
    return f'<path class="line {style}" d="{"".join(path)}"/>'


def _band(horizontal: Array, vertical: Array, shown: Bools, style: str) -> str:
    """Return minimum and maximum in each column of pixels, as one area."""
    column = np.clip(horizontal[shown] - _LEFT, 0, _PLOT - 1).astype(np.int64)
    low, high = np.full(_PLOT, -np.inf), np.full(_PLOT, np.inf)
    height = vertical[shown]
    follows = np.flatnonzero(np.diff(np.flatnonzero(shown)) == 1)
    for where, value in ((column, height), (column[follows + 1], height[follows])):  # the latter joins the columns
        np.maximum.at(low, where, value)
        np.minimum.at(high, where, value)
    filled = np.flatnonzero(np.isfinite(low))
    area = []
    for run in np.split(filled, np.flatnonzero(np.diff(filled) > 1) + 1):
        there = "".join(f"V{high[k]:.1f}h1" for k in run)
        back = "".join(f"V{max(low[k], high[k] + 1.5):.1f}h-1" for k in run[::-1])
        area.append(f"M{_LEFT + run[0]} {high[run[0]]:.1f}{there}{back}Z")
    return f'<path class="band {style}" d="{"".join(area)}"/>'


def ticks(low: float, high: float, about: int) -> list[float]:
    """Return round values from `low` to `high`, about that many.

    >>> ticks(0.0, 7.3, 4)
    [0.0, 2.0, 4.0, 6.0]
    """
    raw = (high - low) / about
    power = 10.0 ** np.floor(np.log10(raw))
    step = float(next(factor * power for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * power >= raw * 0.999))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(f"{index * step:.12g}") for index in range(first, last + 1)]


def path_map(position: Array, value: Array, shown: Bools, label: str) -> tuple[str, Array]:
    """Return an SVG of the path seen from above, coloured by a value, and the limits between the colours.

    :param position: (P, 2) X, Y [mm].
    :param value: (P,) of the piece that ends at each point.
    :param shown: (P,) False for moves drawn thin and grey.
    :returns: the SVG, and as many limits as there are colours, less one; the hundredth part at either end is clipped.
    """
    low, high = position.min(axis=0), position.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    scale = min(_PLOT / size[0], (_MAP_HEIGHT - 60) / size[1])
    height = max(int(size[1] * scale) + 60, 120)
    left = _LEFT + (_PLOT - size[0] * scale) / 2.0
    pixel = np.stack(
        [left + (position[:, 0] - low[0]) * scale, height - 40 - (position[:, 1] - low[1]) * scale], axis=1
    )
    first, last = np.percentile(value[shown], [1, 99]) if shown.any() else (0.0, 0.0)
    limits = np.linspace(first, last, len(CLASSES) + 1)[1:-1]
    colour = np.searchsorted(limits, value)
    colour[~shown] = -1
    rows = _thinned(pixel, colour)
    pixel, colour = np.round(pixel[rows], 1), colour[rows]
    parts = [f'<path class="rapid" d="{_pieces(pixel, colour, -1)}"/>']
    parts += [
        f'<path class="way {name}" d="{_pieces(pixel, colour, index)}"/>'
        for index, name in enumerate(CLASSES)
        if (colour == index).any()
    ]
    parts.append(_scale_bar(float(size.max()), scale, height))
    parts.append(f'<text class="tick" x="{WIDTH - _RIGHT}" y="{height - 8}" text-anchor="end">X →, Y ↑</text>')
    return _svg(height, label, parts), limits


def _scale_bar(extent: float, scale: float, height: int) -> str:
    length = ticks(0.0, extent, 4)[1]
    return (
        f'<path class="axis" d="M{_LEFT} {height - 12}h{length * scale:.1f}"/>'
        f'<text class="tick" x="{_LEFT + length * scale + 8:.1f}" y="{height - 8}">{length:g} mm</text>'
    )


def _thinned(pixel: Array, colour: Ints) -> Ints:
    """Return rows that show the same picture, at most some thousands: where direction or colour change.

    Of several changes on a short piece of path only the first and the last are kept.
    """
    if len(pixel) <= _MAP_POINTS:
        return np.arange(len(pixel))
    step = np.diff(pixel, axis=0)
    turn = np.zeros(len(pixel))
    angle = np.arctan2(step[:, 1], step[:, 0])
    turn[1:-1] = np.abs((np.diff(angle) + np.pi) % (2.0 * np.pi) - np.pi)
    bend = np.cumsum(turn)
    travel = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    change = np.concatenate([np.diff(colour) != 0, [True]])
    change[0] = True
    fine = 0.5
    while True:
        turned = np.concatenate([[True], np.diff(np.floor(bend / (0.05 * max(fine, 1.0)))) != 0])
        rows = np.flatnonzero(turned | change)
        piece = np.floor(travel[rows] / fine)
        new = np.diff(piece) != 0
        rows = rows[np.concatenate([[True], new]) | np.concatenate([new, [True]])]
        if len(rows) <= _MAP_POINTS:
            return np.asarray(rows)
        fine *= np.clip(len(rows) / _MAP_POINTS, 1.5, 3.0)


def _pieces(pixel: Array, colour: Ints, index: int) -> str:
    """Return the runs of one colour as SVG path data; each begins where the point before it lies."""
    rows = np.flatnonzero(colour == index)
    out = []
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if len(run) == 0:
            continue
        first = max(int(run[0]) - 1, 0)
        points = pixel[first : int(run[-1]) + 1]
        out.append("M" + "L".join(f"{a:g} {b:g}" for a, b in points.tolist()))
    return "".join(out)


def _svg(height: int, label: str, parts: Sequence[str]) -> str:
    return (
        f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(label)}">'
        f"<title>{escape(label)}</title>{''.join(parts)}</svg>"
    )
