"""The page of a plan of measurements: what to expect of it, what it is compared with, the poses drawn."""

from __future__ import annotations

from html import escape

import numpy as np

from postproc.frames import DEG_PER_RAD, MM_PER_M
from postproc.plan import PlanResult
from postproc.report import plan_charts
from postproc.report.style import CSS
from postproc.robot import JOINTS

_SMALL = 0.01


def plan_page(result: PlanResult, name: str) -> bytes:
    """Return the page as HTML in UTF-8: self-contained, no scripts.

    :param name: of the plan.
    """
    unit, factor = _unit(result)
    title = escape(name)
    body = [
        f'<header><p class="kind">Plan of measurements</p><h1>{title}</h1><p>{_subtitle(result)}</p></header>',
        _tiles(result, unit, factor),
        _warnings(result),
        _comparison(result, unit, factor),
        _sizes(result, unit, factor),
        _overview(result),
        f"<section><h2>Each pose</h2>{plan_charts.panels(result)}<p>In the order of least travel. Orange: pull of the "
        "load. Dots: reference points. Grey: shadow on the floor, with a square of 2 m around the foot.</p></section>",
        _poses(result),
        '<div class="columns">',
        _tests(result, unit, factor),
        _parameters(result),
        "</div>",
        _notes(result),
    ]
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}: plan of measurements</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{CSS}{plan_charts.CSS}</style></head>\n<body><main>\n" + "\n".join(body) + "\n</main></body></html>\n"
    ).encode()


def _unit(result: PlanResult) -> tuple[str, float]:
    """Return mm, or µm where everything would be hundredths of a millimetre."""
    return ("mm", MM_PER_M) if result.accuracy.rms * MM_PER_M >= _SMALL else ("µm", 1e6)


def _subtitle(result: PlanResult) -> str:
    levels = len(np.unique(result.plan.level))
    stopped = " · search interrupted: the best plan so far" if result.interrupted else ""
    more = " in addition to those measured" if result.before is not None else ""
    return (
        f"{escape(result.robot)} · {len(result.plan)} poses{more} on {levels} levels of q2 · "
        f"load {result.site.rig.force:.0f} N · test poses from {escape(result.tests.source)}{stopped}"
    )


def _tiles(result: PlanResult, unit: str, factor: float) -> str:
    low, high = (value * factor for value in result.accuracy.interval)
    uncompensated = float(np.sqrt(result.tests.weight @ result.tests.deflection**2))
    tiles = [
        (f"expected after compensation (95 %: {low:.3g}–{high:.3g})", f"{result.accuracy.rms * factor:.3g}", unit),
        ("without compensation, RMS", f"{uncompensated * MM_PER_M:.3g}", "mm"),
    ]
    if len(result.random):
        gain = np.sqrt(np.median(result.random) / result.plan.value)
        tiles.append(("better than the median of random plans", f"{gain:.2f}", "×"))
    tiles.append(("least travel, joints at full speed", f"{result.seconds:.0f}", "s"))
    cells = (f"<div><dt>{label}</dt><dd>{value} <small>{small}</small></dd></div>" for label, value, small in tiles)
    return f'<dl class="tiles">{"".join(cells)}</dl>'


def _warnings(result: PlanResult) -> str:
    if not result.warnings:
        return ""
    rows = "".join(f"<li>{escape(text)}.</li>" for text in result.warnings)
    return f'<section class="issues"><h2 class="warning">Before you measure</h2><ul>{rows}</ul></section>'


def _comparison(result: PlanResult, unit: str, factor: float) -> str:
    if not len(result.random):
        return ""
    random = np.sqrt(result.random) * factor
    own = float(np.sqrt(result.plan.value)) * factor
    serial = None if result.serial is None else float(np.sqrt(result.serial.value)) * factor
    picture = plan_charts.among_others(own, random, serial, unit)
    best = f"The best of {len(random)} random plans has {random.min():.3g} {unit}, this one {own:.3g} {unit}"
    intuitive = "" if serial is None else f", the semi-intuitive plan of the serial approach {serial:.3g} {unit}"
    return (
        f"<section><h2>Among other plans of the same size</h2>{picture}<p>{best}{intuitive}. Random plans: levels, "
        "poses and loads at random among those that can be measured. Semi-intuitive: well-conditioned poses, "
        "far apart, on evenly spaced levels.</p></section>"
    )


def _sizes(result: PlanResult, unit: str, factor: float) -> str:
    if len(result.sizes) < 2:
        return ""
    number = np.array([size.configurations for size in result.sizes])
    own = np.sqrt([size.value for size in result.sizes]) * factor
    random = np.sqrt([size.random for size in result.sizes]) * factor
    picture = plan_charts.against_number(number, own, random, len(result.plan), unit)
    return (
        f"<section><h2>How many poses pay</h2>{picture}<p>Other sizes by a shorter search, good to some per cent. Once "
        "the curve falls with the root of the number only, further poses merely average out noise.</p></section>"
    )


def _overview(result: PlanResult) -> str:
    return f"<section><h2>All poses</h2>{plan_charts.overview(result)}<p>Orange: pull of the load.</p></section>"


def _poses(result: PlanResult) -> str:
    head = ("Pose", *(f"{joint}, °" for joint in JOINTS), "Fx, N", "Fy, N", "Fz, N")
    rows = [
        [str(row + 1), *(f"{angle + 0.0:.3f}" for angle in q * DEG_PER_RAD), *(f"{f + 0.0:.1f}" for f in force)]
        for row, (q, force) in enumerate(zip(result.plan.q, result.force, strict=True))
    ]
    note = "Loads act on the load point, root axes."
    return f"<section><h2>Angles and loads</h2>{_table(head, rows)}<p>{note}</p></section>"


def _tests(result: PlanResult, unit: str, factor: float) -> str:
    order = np.argsort(-result.tests.weight, kind="stable")
    rows = [
        [
            str(place),
            f"{100 * result.tests.weight[row]:.1f}",
            f"{np.linalg.norm(result.tests.wrench[row, :3]):.0f}",
            f"{result.tests.deflection[row] * MM_PER_M:.3f}",
            f"{result.accuracy.poses[row] * factor:.3g}",
        ]
        for place, row in enumerate(order, 1)
    ]
    head = ("Test pose", "share, %", "force, N", "deflection, mm", f"expected to remain, {unit}")
    return (
        f"<section><h2>Test poses: where it will be milled</h2>{_table(head, rows)}<p>They stand for all cutting moves "
        f"(Σ w A₀ᵀA₀ agrees to {100 * result.represented:.2g} %).</p></section>"
    )


def _parameters(result: PlanResult) -> str:
    rows = [
        [name, f'<span class="{"good" if half <= 0.1 else "warning"}">± {_percent(float(half))}</span>']
        for name, half in zip((p.symbol for p in result.accuracy.parameters), result.accuracy.relative, strict=True)
    ]
    return (
        f"<section><h2>Parameters</h2>{_table(('Parameter', '95 % interval'), rows)}<p>Of the robot's present value. A "
        "plan made for the work at hand may leave wide what the work does not need.</p></section>"
    )


def _percent(half: float) -> str:
    return f"{100 * half:.2g} %" if half < 10.0 else "unbounded"


def _table(head: tuple[str, ...], rows: list[list[str]]) -> str:
    titles = "".join(f'<th scope="col">{title}</th>' for title in head)
    body = "".join(
        f'<tr><th scope="row">{row[0]}</th>{"".join(f"<td>{cell}</td>" for cell in row[1:])}</tr>' for row in rows
    )
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>"


def _notes(result: PlanResult) -> str:
    how = (
        "Criterion as printed in the paper: each level of q2 identified alone."
        if result.options.grouped
        else "Criterion: covariance of Eq. (8), shared by the levels; k2 at a test pose from them by Eq. (9), (10)."
    )
    return (
        f"<footer><p>{how} The expected accuracy is that of an identification which weights all readings by their "
        "noise. It counts the noise of the readings only: what the model does not describe comes on top. "
        f"Seed {result.options.seed}; the same seed and files give the same plan.</p></footer>"
    )
