"""`part.compare.report.html`."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc.comparison import Comparison
from postproc.frames import MM_PER_M, Array, norm
from postproc.program import Ints
from postproc.report.comparison.summary import ComparisonSummary
from postproc.report.comparison.text import WORDS, counted
from postproc.report.kit import (
    Axis,
    Cell,
    Counts,
    Curve,
    Kind,
    Lines,
    Mark,
    Note,
    Notes,
    Page,
    Part,
    Plot,
    Row,
    Section,
    Table,
    Tile,
    Tiles,
    Verdict,
)
from postproc.report.text import millimetres

_DRAWN = 4_000
_BINS = 40
_KINDS: dict[str, Kind] = {"error": "error", "warning": "warning", "info": "soft"}
_ROWS = (("Maximum", "max_mm"), ("RMS", "rms_mm"), ("Mean", "mean_mm"), ("95th percentile", "p95_mm"))


def comparison_page(found: Comparison, content: ComparisonSummary) -> Iterator[bytes]:
    """Yield the page of a comparison as HTML in UTF-8, one file that loads nothing."""
    sections = [_verdict(content), _numbers(content)]
    if len(found.pair):
        sections += [_path(found), _along(found, content), _histogram(found), _operations(content), _worst(found)]
    yield from Page(
        kind="Comparison",
        title=f"{content['corrected']} against {content['nominal']}",
        subtitle=f"{content['robot']} · {counted(content)}",
        sections=(*sections, _issues(content)),
        footer=(
            Note(
                "Offsets are from the nominal target to where the second program sends the same tool, in the nominal "
                "$BASE, in millimetres. What a program cuts is a prediction of the elastostatic model under the forces "
                "given. Statistics are over cutting targets that stand in both."
            ),
        ),
    ).render()


def _verdict(content: ComparisonSummary) -> Section:
    judged = content["verdict"]
    first, *others = (text[:1].upper() + text[1:] + "." for text in judged["reasons"])
    parts: list[Part] = [Verdict(judged["state"], WORDS[judged["state"]], first)]
    if others:
        kind: Kind = "error" if judged["state"] == "failed" else ""
        parts.append(Notes(tuple(Note(text, kind) for text in others), "And", marked=True))
    return Section("verdict", "Verdict", tuple(parts))


def _numbers(content: ComparisonSummary) -> Section:
    cut = content["cut"]
    tiles = [
        Tile("Largest offset", millimetres(content["offset"]["max_mm"]), "mm"),
        Tile("Largest change of orientation", f"{content['rotation']['max_deg']:.4f}", "°"),
    ]
    head, sources = ["Criterion", "Offset, mm"], [content["offset"]]
    if cut is not None:
        tiles.append(Tile("The nominal program cuts, largest", millimetres(cut["nominal"]["max_mm"]), "mm"))
        tiles.append(Tile("The corrected one, largest", millimetres(cut["corrected"]["max_mm"]), "mm"))
        head += ["Nominal cuts, mm", "Corrected cuts, mm"]
        sources += [cut["nominal"], cut["corrected"]]
    rows = tuple(Row((label, *(millimetres(source[key]) for source in sources))) for label, key in _ROWS)  # type: ignore[literal-required]
    return Section("numbers", "Offsets and deviations, mm", (Tiles(tuple(tiles)), Table(tuple(head), rows, "Numbers")))


def _shown(found: Comparison) -> Ints:
    """Return which pairs are drawn: of every so many the one of the largest offset, so that the worst is among them."""
    each = -(-len(found.pair) // _DRAWN)
    size = np.where(found.rapid, -1.0, found.distance)
    padded = np.append(size, np.full(-len(size) % each, -2.0)).reshape(-1, each)
    return np.asarray(np.arange(len(padded)) * each + padded.argmax(axis=1))


def _path(found: Comparison) -> Section:
    rows = _shown(found)
    nominal, offset = found.target[rows, :3, 3], found.offset[rows]
    extent = float(np.ptp(nominal, axis=0).max())
    largest = float(norm(offset).max())
    factor = 10.0 ** np.floor(np.log10(0.1 * extent / largest)) if largest > 0.0 and extent > 0.0 else 1.0
    factor = max(1.0, float(factor))
    traces = [
        _line(nominal, "nominal", "before"),
        _line(nominal + factor * offset, f"corrected, offsets {factor:g} times", "after"),
    ]
    plot = Plot(
        label="Both paths in space; offsets of the corrected one are exaggerated.",
        traces=[*traces],
        height=480,
        note=f"Pairs joined by straight lines, {len(rows)} of {len(found.pair)}; the largest offsets are among them.",
    )
    return Section("view3d", f"Both paths, offsets {factor:g} times larger", (plot,))


def _line(points: Array, name: str, colour: str) -> Lines:
    x, y, z = points.T.tolist()
    return Lines(x, y, z, name, "before" if colour == "before" else "after")


def _along(found: Comparison, content: ComparisonSummary) -> Section:
    rows = _shown(found)
    line = found.nominal_line[rows].astype(float).tolist()
    offset = (found.offset[rows] * MM_PER_M).T.tolist()
    names = (("X", "correction"), ("Y", "force"), ("Z", "ink"))
    curves = [Curve(line, values, name, colour) for values, (name, colour) in zip(offset, names, strict=True)]  # type: ignore[arg-type]
    x = Axis(title="line of the nominal program")
    parts: list[Part] = [
        Plot(label="Offset in X, Y, Z along the program", traces=[*curves], x=x, y=Axis(title="offset, mm"))
    ]
    if found.cuts is not None:
        cuts = [
            Curve(line, (norm(off[rows]) * MM_PER_M).tolist(), name, colour)  # type: ignore[arg-type]
            for off, name, colour in (
                (found.cuts.nominal, "nominal", "before"),
                (found.cuts.corrected, "corrected", "after"),
            )
        ]
        mark = Mark(content["tolerance_mm"], "tolerance", "warning", level=True)
        parts.append(
            Plot(
                label="What each program cuts along the path",
                traces=[*cuts],
                x=x,
                y=Axis(title="deviation, mm"),
                marks=[mark],
            )
        )
    return Section("along", "Along the program", tuple(parts))


def _histogram(found: Comparison) -> Section:
    counts, edges = np.histogram(found.distance[~found.rapid] * MM_PER_M, bins=_BINS)
    bars = Counts(edges.tolist(), counts.tolist(), "offset")
    plot = Plot(
        label="Histogram of the offset at cutting targets",
        traces=[bars],
        x=Axis(title="offset, mm"),
        y=Axis(title="targets"),
    )
    return Section("histogram", "Distribution of the offset", (plot,), "half")


def _operations(content: ComparisonSummary) -> Section:
    head = ["Operation", "Tool", "First line", "Cutting targets", "Offset, mm"]
    head += ["Nominal cuts, mm", "Corrected cuts, mm"] if content["cut"] is not None else []
    rows = []
    for number, operation in enumerate(content["operations"], 1):
        cut = operation["cut"]
        cells = [
            operation["name"] or f"operation {number}",
            f"T{operation['tool']}" if operation["tool"] else "-",
            str(operation["nominal_line"]),
            str(operation["pairs"]),
            millimetres(operation["offset"]["max_mm"]),
            *([millimetres(cut[key]["max_mm"]) for key in ("nominal", "corrected")] if cut is not None else []),
        ]
        rows.append(Row(tuple(cells), source_line=operation["nominal_line"]))
    table = Table(tuple(head), tuple(rows), "Operations, largest values", sortable=True, note="Largest values.")
    return Section("operations", "Operations and tools", (table,), "half")


def _worst(found: Comparison) -> Section:
    size = np.where(found.rapid, -1.0, found.distance)
    order = np.argsort(-size, kind="stable")[:20]
    head = ["Nominal line", "Corrected line", "Offset, mm", "X, mm", "Y, mm", "Z, mm", "Turned, °"]
    head += ["Nominal cuts, mm", "Corrected cuts, mm"] if found.cuts is not None else []
    cuts = () if found.cuts is None else (found.cuts.nominal, found.cuts.corrected)
    rows = []
    for row in order[size[order] >= 0.0].tolist():
        cells = [str(found.nominal_line[row]), str(found.corrected_line[row])]
        cells.append(millimetres(float(found.distance[row]) * MM_PER_M))
        cells += [f"{value:.4f}" for value in found.offset[row] * MM_PER_M + 0.0]
        cells.append(f"{np.degrees(found.rotation[row]):.4f}")
        cells += [millimetres(float(norm(off[row])) * MM_PER_M) for off in cuts]
        rows.append(Row(tuple(cells), source_line=int(found.nominal_line[row])))
    return Section("worst", "Largest offsets", (Table(tuple(head), tuple(rows), "Largest offsets", sortable=True),))


def _issues(content: ComparisonSummary) -> Section:
    if not content["issues"]:
        return Section("issues", "Differences besides positions", (Notes((Note("None.", "good"),)),))
    rows = tuple(
        Row(
            (
                Cell(issue["level"], _KINDS[issue["level"]]),
                issue["message"],
                "-" if issue["source_line"] is None else str(issue["source_line"]),
                str(issue["count"]),
            ),
            source_line=issue["source_line"],
        )
        for issue in content["issues"]
    )
    head = ("Level", "What", "Line", "Places")
    return Section("issues", "Differences besides positions", (Table(head, rows, "Differences", texts=(1,)),))
