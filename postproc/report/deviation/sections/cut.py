"""The cut: what the teeth are engaged with along the path, and what is left of the stock."""

import numpy as np

from postproc.frames import DEG_PER_RAD, MM_PER_M, Array
from postproc.program import Ints
from postproc.report.deviation.content import Deviation
from postproc.report.kit import Axis, Curve, Note, Notes, Part, Plot, Section, Tile, Tiles, View
from postproc.report.kit.plots import Colour

_SHOWN = 600
_CM3_PER_MIN = 1e6 * 60.0
_CM3 = 1e6


def section(told: Deviation) -> Section | None:
    """Return plots of the engagement over the length of the path, and room for the stock."""
    found = told.process
    if found is None or not len(told.result) or not len(found.cuts.t):
        return None
    cuts = found.cuts
    order = np.lexsort((cuts.t, cuts.motion))
    motion, t = cuts.motion[order], cuts.t[order]
    row = _rows(told, motion, t)
    x = np.interp(motion + t, told.result.motion + told.result.t, told.places.travelled) * MM_PER_M
    plots: list[Part] = []
    drawn: tuple[tuple[str, str, tuple[tuple[str, Array, float], ...]], ...] = (
        ("Depth and width of cut", "mm", (("depth", cuts.depth, MM_PER_M), ("width", cuts.width, MM_PER_M))),
        ("Angles of the teeth", "°", (("enter", cuts.enter, DEG_PER_RAD), ("leave", cuts.leave, DEG_PER_RAD))),
        ("Removed", "cm³/min", (("removed", cuts.rate, _CM3_PER_MIN),)),
        ("Power", "W", (("power", cuts.power, 1.0),)),
    )
    for label, unit, curves in drawn:
        traces = []
        colours: tuple[Colour, ...] = ("before", "after")
        for (name, values, factor), colour in zip(curves, colours, strict=False):
            kept = _kept(values[order])
            y = _with_gaps(values[order] * factor, motion)[kept]
            place = np.minimum(np.searchsorted(told.places.row, row[kept]), len(told.places.row) - 1)
            traces.append(Curve(x[kept].tolist(), y.tolist(), name, colour, places=place.tolist()))
        plots.append(
            Plot(
                label=f"{label}, {unit}, along the path. Left and right arrow keys step.",
                traces=[*traces],
                x=Axis(title="length of the path, mm"),
                y=Axis(title=unit if len(curves) > 1 else f"{label.lower()}, {unit}"),
                height=220,
            )
        )
    tiles = Tiles(
        (
            Tile("Depth of cut, up to", f"{np.nanmax(cuts.depth) * MM_PER_M:.2f}", "mm"),
            Tile("Width of cut, up to", f"{np.nanmax(cuts.width) * MM_PER_M:.2f}", "mm"),
            Tile("Removed, up to", f"{np.nanmax(cuts.rate) * _CM3_PER_MIN:.1f}", "cm³/min"),
            Tile("Removed in all", f"{found.removed * _CM3:.1f}", "cm³", f"left {found.stock.volume() * _CM3:.1f} cm³"),
        )
    )
    label = "What is left of the stock, turned by mouse, touch and arrow keys"
    stock = (
        View("stock", label, "What is left of the stock, in $BASE; as a file it ends in stock.glb.")
        if told.stock is not None
        else Notes((Note("What is left of the stock is too large for a page: look at the file stock.glb.", "soft"),))
    )
    return Section("cut", "The cut", (tiles, *plots, stock))


def _rows(told: Deviation, motion: Ints, t: Array) -> Ints:
    """Return the row of the result at or behind each place on a motion."""
    row = np.searchsorted(told.result.motion + told.result.t, motion + t - 1e-9)
    return np.asarray(np.minimum(row, len(told.result) - 1))


def _kept(values: Array) -> Ints:
    """Return which of many values are drawn: of every so many the smallest and the largest."""
    each = -(-2 * len(values) // _SHOWN)
    if each <= 2:
        return np.arange(len(values))
    known = np.nan_to_num(values)
    padded = np.append(known, np.full(-len(known) % each, known[-1])).reshape(-1, each)
    first = np.arange(len(padded)) * each
    rows = np.concatenate([first + padded.argmin(axis=1), first + padded.argmax(axis=1)])
    return np.unique(np.minimum(rows, len(values) - 1))


def _with_gaps(values: Array, motion: Ints) -> Array:
    """Return values with a gap where motions between do not cut."""
    out = values.astype(float)
    out[np.flatnonzero(np.diff(motion) > 1)] = np.nan
    return out
