"""The surface of the part, and where the tool gouges it."""

import numpy as np

from postproc.frames import MM_PER_M
from postproc.report.deviation.content import Deviation
from postproc.report.digits import millimetres, rounded
from postproc.report.kit import Note, Notes, Part, Row, Section, Table, Tile, Tiles, View

_MOST = 40


def section(told: Deviation) -> Section | None:
    """Return the surface with the largest deviations along its normal, and the gouges beyond the tolerance."""
    surface = told.surface
    if surface is None or not len(told.result):
        return None
    touched = surface.row >= 0
    if not touched.any():
        text = "The tool touches the part nowhere: is its mesh in mm, in $BASE, and are the shapes of the tools right?"
        return Section("surface", "Surface of the part", (Notes((Note(text, "warning"),)),))
    after = surface.after if told.compared else surface.before
    words = "with the program as written" if told.compared else "as it stands"
    tiles = [
        _depth("Gouged before, at most", -surface.before[touched].min()),
        _depth("Left before, at most", surface.before[touched].max()),
    ]
    if told.compared:
        tiles.append(_depth("Gouged after, at most", -after[touched].min(), "as the model predicts it"))
        tiles.append(_depth("Left after, at most", after[touched].max()))
    if surface.bound is not None:
        tiles.append(Tile("Expected error (95 %), up to", rounded(surface.bound[touched].max() * MM_PER_M), "mm"))
    share = 100.0 * _area(surface.corners[touched]) / _area(surface.corners)
    tiles.append(Tile("Of the surface touched", f"{share:.0f}", "%"))
    label = "The part, coloured by the deviation along its outward normal; the table below lists the gouges"
    view = View("surface", label, "Below 0 the tool gouges, above it leaves material. Grey: no tool touches.")
    parts: list[Part] = [Tiles(tuple(tiles)), view, *_gouges(told, after, words)]
    return Section("surface", "Surface of the part", tuple(parts))


def _depth(label: str, value: float, note: str = "") -> Tile:
    """Return the largest depth [m] below the surface, or height above it; negative: there is none."""
    if value <= 0.0:
        return Tile(label, "nothing", "", note)
    return Tile(label, millimetres(float(value) * MM_PER_M), "mm", note)


def _area(corners: np.ndarray) -> float:
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.sqrt(np.einsum("fi,fi->f", edges, edges)).sum())


def _gouges(told: Deviation, after: np.ndarray, words: str) -> list[Part]:
    """Return the lines that gouge by more than the tolerance, the deepest place of each."""
    surface, tolerance = told.surface, told.tolerance
    if surface is None or tolerance is None:
        return []
    deep = np.flatnonzero(after < -tolerance)
    if not len(deep):
        text = f"No gouge deeper than {tolerance * MM_PER_M:g} mm {words}."
        return [Notes((Note(text, "good"),))]
    order = deep[np.argsort(after[deep], kind="stable")]
    line = told.result.source_line[surface.row[order]]
    _, first = np.unique(line, return_index=True)
    centre = surface.corners.mean(axis=1) * MM_PER_M
    rows = []
    for facet in order[np.sort(first)[:_MOST]].tolist():
        row = int(surface.row[facet])
        cells = [str(told.result.source_line[row]), f"{-after[facet] * MM_PER_M:.4f}"]
        cells += [f"{value:.2f}" for value in centre[facet]]
        rows.append(Row(tuple(cells), told.places.of(row), int(told.result.source_line[row])))
    head = ("Source line", "Depth, mm", "X, mm", "Y, mm", "Z, mm")
    note = f"Deeper than {tolerance * MM_PER_M:g} mm {words}; the deepest place of each line."
    return [Table(head, tuple(rows), "Gouges beyond the tolerance", sortable=True, note=note)]
