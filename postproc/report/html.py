"""`report.html`: one self-contained page, no scripts, nothing loaded from elsewhere."""

from __future__ import annotations

from html import escape
from itertools import pairwise
from typing import Literal

import numpy as np

from postproc.correction import Result
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm
from postproc.program import Ints
from postproc.report import charts
from postproc.report.charts import Curve
from postproc.report.drawn import drawn_path
from postproc.report.style import CSS
from postproc.report.summary import Summary, nothing_to_correct, summary
from postproc.report.text import millimetres, number, percent, targets, times

_JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
_NARROW = 5.0
_MODES = {
    "convert": "corrected program",
    "nominal": "written without correction",
    "predict": "predicted as it stands, nothing written",
}
_MEASURES: tuple[tuple[str, Literal["max_mm", "rms_mm", "mean_mm", "p95_mm"]], ...] = (
    ("Maximum", "max_mm"),
    ("RMS", "rms_mm"),
    ("Mean", "mean_mm"),
    ("95th percentile", "p95_mm"),
)


def page(result: Result, tolerance: float | None = None) -> bytes:
    """Return the report of one program as HTML in UTF-8, below 1 MB however long the program.

    :param result: of one program.
    :param tolerance: what the tip may leave the nominal path by [m]; None = not stated.
    """
    content = summary(result, tolerance)
    name = escape(content["program"])
    body = [
        f'<header><p class="kind">Deviation report</p><h1>{name}</h1><p>{_subtitle(content)}</p></header>',
        _tiles(content),
        '<div class="columns">',
        _distances(content),
        _facts(content),
        "</div>",
        _issues(content),
    ]
    if len(result) and nothing_to_correct(content) is None:
        position, row = drawn_path(result)
        body += [_along(result, position, row), _seen_from_above(result, position, row)]
    body += [_joints(result), _notes(content)]
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{name}: deviation report</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{CSS}</style></head>\n<body><main>\n" + "\n".join(body) + "\n</main></body></html>\n"
    ).encode()


def _subtitle(content: Summary) -> str:
    return f"{escape(content['robot'])} · {_MODES[content['mode']]} · {targets(content)}"


def _tiles(content: Summary) -> str:
    before, after = content["before"], content["after"]
    tiles = [("largest deviation before", f"{before['max_mm']:.3f}", "mm")]
    if content["mode"] == "convert":
        tiles.append(("largest deviation after", millimetres(after["max_mm"]), "mm"))
        tiles.append(("compensated (RMS)", percent(content["compensated_percent"]).removesuffix(" %"), "%"))
    tiles.append(("largest force", f"{content['max_force_N']:.0f}", "N"))
    cells = (f"<div><dt>{label}</dt><dd>{value} <small>{unit}</small></dd></div>" for label, value, unit in tiles)
    return f'<dl class="tiles">{"".join(cells)}</dl>'


def _distances(content: Summary) -> str:
    nothing = nothing_to_correct(content)
    if nothing is not None:
        return f'<section><h2>Deviation of the tool tip</h2><p class="good">{nothing}</p></section>'
    predict = content["mode"] == "predict"
    head = ("Deviation", "predicted, mm") if predict else ("Deviation", "before, mm", "after, mm", "improvement")
    rows = []
    for label, key in _MEASURES:
        before, after = content["before"][key], content["after"][key]
        cells = [label, millimetres(before)]
        if not predict:
            cells += [millimetres(after), times(before, after)]
        rows.append(cells)
    return f"<section><h2>Deviation of the tool tip at cutting targets</h2>{_table(head, rows)}</section>"


def _facts(content: Summary) -> str:
    held = {
        None: " (held but for approximation)",
        True: " (held)",
        False: ' <strong class="error">exceeded</strong>',
    }[content["tolerance_held"]]
    between = content["between_max_mm"]
    rows = [["Between targets too, at most", f"{'-' if between is None else millimetres(between)} mm"]]
    if content["tolerance_mm"] is not None:
        rows.append(["Tolerance", f"{content['tolerance_mm']:g} mm{held}"])
    blending = content["blending"]
    if blending["source_line"] is not None:
        rows.append(["Approximation (C_DIS) rounds corners by up to", f"{number(blending['max_mm'], 3)} mm"])
    if content["mode"] == "convert":
        rows.append(["Largest correction", f"{number(content['max_correction_mm'], 3)} mm"])
    limits = content["limits"]
    rows.append(["Smallest joint margin", f"{number(limits['min_joint_margin_deg'], 1)}°"])
    rows.append(["Smallest singular value", number(limits["min_singular_value"], 3)])
    return f"<section><h2>Limits</h2>{_table(('', ''), rows)}</section>"


def _issues(content: Summary) -> str:
    if not content["issues"]:
        return '<section><h2>Issues</h2><p class="good">None.</p></section>'
    rows = [
        [
            f'<span class="{issue["level"]}">{issue["level"]}</span>',
            "-" if issue["source_line"] is None else str(issue["source_line"]),
            str(issue["count"]),
            escape(issue["message"]),
        ]
        for issue in content["issues"]
    ]
    head = ("Level", "First line", "Places", "What")
    return f'<section class="issues"><h2>Issues</h2>{_table(head, rows)}</section>'


def _table(head: tuple[str, ...], rows: list[list[str]]) -> str:
    titles = "".join(f'<th scope="col">{title}</th>' for title in head) if any(head) else ""
    body = "".join(
        f'<tr><th scope="row">{row[0]}</th>{"".join(f"<td>{cell}</td>" for cell in row[1:])}</tr>' for row in rows
    )
    return f"<table>{f'<thead><tr>{titles}</tr></thead>' if titles else ''}<tbody>{body}</tbody></table>"


def _along(result: Result, position: Array, row: Ints) -> str:
    travelled = np.zeros(len(row))
    np.cumsum(norm(np.diff(position, axis=0)), out=travelled[1:])
    travelled = travelled[np.flatnonzero(np.diff(row, append=len(result)))]
    unit, factor = ("mm", MM_PER_M) if travelled[-1] < 2.0 else ("m", 1.0)
    curves = [_deviation(result, result.before, "before: as programmed", "before")]
    if result.mode != "predict":
        title = "after: as written (own scale)" if result.mode == "convert" else "as written"
        curves.append(_deviation(result, result.after, title, "after"))
    if result.mode == "convert":
        moved = norm(result.printed[:, :3] - result.nominal[:, :3, 3] * MM_PER_M)
        curves.append(Curve("correction, mm", moved, "moved", 70))
    curves.append(Curve("force, N", norm(result.wrench[:, :3]), "force", 70))
    picture = charts.strips(
        travelled * factor,
        f"path travelled, {unit}",
        ~result.rapid,
        curves,
        "Deviation of the tool tip along the path, with correction and force",
    )
    return f"<section><h2>Along the path</h2>{picture}<p>Gaps are rapid moves.</p></section>"


def _deviation(result: Result, distance: Array, title: str, style: str) -> Curve:
    """Return a curve in mm, or in µm where it stays below 0.01 mm, with its largest value marked."""
    cutting = ~result.rapid
    largest = float(distance[cutting].max(initial=0.0))
    unit, factor = ("µm", MM_PER_M * 1e3) if largest * MM_PER_M < 0.01 else ("mm", MM_PER_M)
    mark = ""
    if cutting.any():
        line = int(result.source_line[int(np.argmax(np.where(cutting, distance, -1.0)))])
        mark = f"{largest * factor:.3g} {unit}, line {line}"
    return Curve(f"{title}, {unit}", distance * factor, style, mark=mark)


def _seen_from_above(result: Result, position: Array, row: Ints) -> str:
    frame = "$BASE" if len(result.program.bases) == 1 else "the robot root"
    picture, limits = charts.path_map(
        position[:, :2] * MM_PER_M,
        (result.before * MM_PER_M)[row],
        ~result.rapid[row],
        "The path seen from above, coloured by the deviation as programmed",
    )
    texts = [f"{limit:.3g}" for limit in limits]
    ranges = [f"below {texts[0]}", *(f"{a}–{b}" for a, b in pairwise(texts)), f"above {texts[-1]}"]
    legend = "".join(
        f'<li><i class="{name}"></i>{text}</li>' for name, text in zip(charts.CLASSES, ranges, strict=True)
    )
    return (
        f"<section><h2>Seen from above: deviation as programmed</h2>{picture}"
        f'<ul class="legend">{legend}<li>mm</li></ul><p>X and Y of {frame}. Grey: rapid moves.</p></section>'
    )


def _joints(result: Result) -> str:
    rows = []
    for index, name in enumerate(_JOINTS):
        margin = float(result.joint_margin[index]) * DEG_PER_RAD
        style = ' class="warning"' if margin < _NARROW else ""
        angles = result.q[:, index] * DEG_PER_RAD
        cells = [f"{angles.min():z.1f}", f"{angles.max():z.1f}"] if len(angles) else ["-", "-"]
        value = number(margin if np.isfinite(margin) else None, 1)
        rows.append([name, *cells, f"<span{style}>{value}</span>"])
    head = ("Joint", "from, °", "to, °", "margin to the nearest limit, °")
    return f'<section class="joints"><h2>Joints</h2>{_table(head, rows)}</section>'


def _notes(content: Summary) -> str:
    how = {
        "convert": "“After” is a simulation of the program as written, with its rounded numbers.",
        "nominal": "“After” is a simulation of the program as written: without correction.",
        "predict": "Nothing was corrected or written.",
    }[content["mode"]]
    return (
        "<footer><p>All deviations are predictions of the elastostatic model of the robot under the forces given, not "
        f"measurements. Statistics are over cutting targets. {how}</p></footer>"
    )
