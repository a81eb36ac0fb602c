"""Section of the page of a program: the map path × turn about the tool axis, and the line that was chosen on it."""

from __future__ import annotations

import numpy as np

from postproc import placement
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array
from postproc.placement import FREE, NO_CLEARANCE, REASONS, Turn
from postproc.report.deviation.data import Deviation
from postproc.report.formatting import rounded
from postproc.report.kit import Axis, Curve, Map, Note, Notes, Part, Plot, Section

_MOST = 400
"""Largest number of columns of the map along the path."""
_SHOWN = 1e-9
"""Expected errors below this [m] are nothing to colour by: the joint margin is shown."""


def turn(data: Deviation) -> Section | None:
    """Return the map of the turn about the tool axis with the chosen line; None if it was not chosen."""
    found = data.result.turn
    if found is None:
        return None
    reasons = found.map.reasons(found.keep)
    chosen = placement.bin_turns(found)
    blocks = found.map.blocks
    metres = np.cumsum(blocks.length)[blocks.block] - blocks.length[blocks.block] * (1.0 - blocks.share)
    long = np.flatnonzero(np.diff(metres, prepend=0.0) > 0.0)
    shown = long[np.unique(np.linspace(0, len(long) - 1, min(_MOST, len(long))).astype(np.int64))]
    values, title = _values(found)
    low, high = found.range_deg()
    degrees = (found.map.offset + found.constant) * DEG_PER_RAD
    cells = np.where(reasons == FREE, values, np.nan)[shown].T
    grid = Map(
        metres[shown].tolist(),
        [float(angle) for angle in degrees],
        [[None if np.isnan(cell) else float(cell) for cell in row] for row in cells],
        reasons[shown].T.tolist(),
        REASONS,
        title,
    )
    line = _on_map((chosen + found.constant) * DEG_PER_RAD, degrees)
    curve = Curve(metres.tolist(), line.tolist(), "chosen turn", "warning")
    plot = Plot(
        label="Map of the path by the turn of the tool about its axis, with the chosen line.",
        traces=[grid, curve],
        x=Axis(title="along the path, m"),
        y=Axis(title="turn about the tool axis, °", range=(float(degrees[0]) - 2.5, float(degrees[-1]) + 2.5)),
        height=420,
        note="Each column is the worst of its piece of the path. Rapid moves count for reach only, not for errors.",
    )
    how = "one turn for each operation" if found.mode == "best" else "a turn that changes along the path"
    first, last = f"{low:.0f}°", f"{high:.0f}°"
    what = f"{first} everywhere" if first == last else f"{how}, from {first} to {last}"
    parts: list[Part] = [plot]
    notes = [f"Chosen: {what}.", *_gain(found, chosen)]
    if found.map.hit is None:
        notes.append(NO_CLEARANCE)
    parts.append(Notes(tuple(Note(text) for text in notes)))
    return Section("turn", "Turn about the tool axis", tuple(parts))


def _values(found: Turn) -> tuple[Array, str]:
    """Return the values (K, J) that colour the map, and what they are."""
    error = found.map.error * MM_PER_M
    if np.nanmax(error, initial=0.0) > _SHOWN * MM_PER_M:
        cuts = found.map.blocks.cuts[found.map.blocks.block]
        error = np.where(cuts[:, None], error, np.nan)
        return error, "expected error (95 %), mm" if np.isfinite(found.map.u95).any() else "deflection, mm"
    return np.where(
        np.isfinite(found.map.margin.joint), found.map.margin.joint * DEG_PER_RAD, np.nan
    ), "joint margin, °"


def _on_map(angle: Array, degrees: Array) -> Array:
    """Return angles within the range of the map, with NaN where the line goes round."""
    low = degrees[0] - 0.5 * (degrees[1] - degrees[0])
    out = (angle - low) % 360.0 + low
    out[1:][np.abs(np.diff(out)) > 180.0] = np.nan
    return np.asarray(out)


def _gain(found: Turn, chosen: Array) -> list[str]:
    """Return a sentence on the expected error of the line and of the turn that the cell states."""
    weight = found.map.blocks.cuts[found.map.blocks.block]
    error, offset = found.map.error, found.map.offset
    step = offset[1] - offset[0]
    columns = np.rint((chosen - offset[0]) / step).astype(np.int64) % len(offset)
    stated = int(np.argmin(np.abs(offset)))
    line = error[np.arange(len(columns)), columns][weight]
    constant = error[weight, stated]
    if not len(line) or not np.isfinite(line).all() or not line.any():
        return []
    rms = rounded(float(np.sqrt(np.mean(line**2))) * MM_PER_M)
    if not (found.map.reasons(found.keep)[:, stated] == FREE).all():
        before = f"the turn that the cell states ({found.constant * DEG_PER_RAD:g}°) cannot be driven throughout"
    else:
        before = f"{rounded(float(np.sqrt(np.mean(constant**2))) * MM_PER_M)} mm with {found.constant * DEG_PER_RAD:g}°"
    return [f"Expected error along this line {rms} mm RMS; {before}."]
