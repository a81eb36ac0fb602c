"""Sections of the page of a plan."""

from __future__ import annotations

import numpy as np

from postproc.frames import DEG_PER_RAD, MM_PER_M
from postproc.plan import PlanResult
from postproc.report.kit import (
    Axis,
    Cell,
    Counts,
    Curve,
    Mark,
    Note,
    Notes,
    Plot,
    Points,
    Row,
    Section,
    Table,
    Tile,
    Tiles,
)
from postproc.report.plan_data import extremes, poses_by_side
from postproc.robot import JOINTS, WITH_LINKS

_GOOD = 0.1
_BINS = 60


def expected(result: PlanResult) -> Section:
    """Return what to expect of the plan."""
    low, high = (value * MM_PER_M for value in result.accuracy.interval)
    uncompensated = float(np.sqrt(result.tests.weight @ result.tests.deflection**2))
    tiles = [
        Tile(
            "After compensation, RMS",
            f"{result.accuracy.rms * MM_PER_M:.3g}",
            "mm",
            f"95 %: {low:.3g} … {high:.3g} mm",
        ),
        Tile("Without compensation, RMS", f"{uncompensated * MM_PER_M:.3g}", "mm"),
    ]
    if len(result.random):
        gain = np.sqrt(np.median(result.random) / result.plan.value)
        tiles.append(Tile("Better than the median of random plans", f"{gain:.2f}", "×"))
    tiles.append(Tile("Least travel, joints at full speed", f"{result.seconds:.0f}", "s"))
    return Section("expected", "What to expect", (Tiles(tuple(tiles)),))


def warnings(result: PlanResult) -> Section | None:
    """Return what to know before measuring."""
    if not result.warnings:
        return None
    notes = tuple(Note(f"{text}.", "warning") for text in result.warnings)
    return Section("warnings", "Before you measure", (Notes(notes, marked=True),))


def comparison(result: PlanResult) -> Section | None:
    """Return the plan among random ones."""
    if not len(result.random):
        return None
    random = np.sqrt(result.random) * MM_PER_M
    own = float(np.sqrt(result.plan.value)) * MM_PER_M
    serial = None if result.serial is None else float(np.sqrt(result.serial.value)) * MM_PER_M
    # some random plans are hopeless: the picture ends where 97 % of them are in
    top = max(float(np.quantile(random, 0.97)), serial or 0.0, own) * 1.05
    counts, edges = np.histogram(np.clip(random, 0.0, top), bins=_BINS, range=(0.0, top))
    median = float(np.median(random))
    marks = [Mark(own, f"this plan {own:.3g}", "after"), Mark(median, f"median of random plans {median:.3g}", "before")]
    marks += [] if serial is None else [Mark(serial, f"semi-intuitive plan {serial:.3g}", "before")]
    best = f"The best of {len(random)} random plans has {random.min():.3g} mm, this one {own:.3g} mm"
    intuitive = "" if serial is None else f", the semi-intuitive plan of the serial approach {serial:.3g} mm"
    plot = Plot(
        label="Histogram of the criterion of random plans; this plan is marked",
        traces=[Counts(edges.tolist(), counts.tolist(), "random plans")],
        x=Axis(title="criterion (root: RMS distance that remains), mm", range=(0.0, top)),
        y=Axis(title="plans"),
        marks=marks,
        note=f"{best}{intuitive}. Random plans: levels, poses and loads at random among those that can be measured. "
        "Semi-intuitive: well-conditioned poses, far apart, on evenly spaced levels.",
    )
    return Section("comparison", "Among other plans of the same size", (plot,))


def sizes(result: PlanResult) -> Section | None:
    """Return the criterion against the number of poses."""
    if len(result.sizes) < 2:
        return None
    number = [float(size.configurations) for size in result.sizes]
    own = (np.sqrt([size.value for size in result.sizes]) * MM_PER_M).tolist()
    random = (np.sqrt([size.random for size in result.sizes]) * MM_PER_M).tolist()
    chosen = [(n, value) for n, value in zip(number, own, strict=True) if n == len(result.plan)]
    high = min(max(random), 4.0 * max(own)) * 1.05
    plot = Plot(
        label="Criterion against the number of poses, for the best plans found and for random ones",
        traces=[
            Curve(number, random, "random plans, median", "before", dots=True, dashed=True),
            Curve(number, own, "best plan found", "after", dots=True),
            Points([n for n, _ in chosen], [v for _, v in chosen], "this plan", "ink", hollow=True),
        ],
        x=Axis(title="number of poses"),
        y=Axis(title="mm", range=(0.0, high)),
        note="Other sizes by a shorter search, good to some per cent. Once the curve falls with the root of the number "
        "only, further poses merely average out noise.",
    )
    return Section("sizes", "How many poses pay", (plot,))


def angles(result: PlanResult) -> Section:
    """Return angles and loads of the poses."""
    head = ("Pose", *(f"{joint}, °" for joint in JOINTS), "Fx, N", "Fy, N", "Fz, N")
    rows = tuple(
        Row((str(row), *(f"{angle + 0.0:.3f}" for angle in q), *(f"{value + 0.0:.1f}" for value in force)))
        for row, (q, force) in enumerate(zip(result.plan.q * DEG_PER_RAD, result.force, strict=True), 1)
    )
    note = "In the order of least travel. Loads act on the load point, root axes."
    return Section("angles", "Angles and loads", (Table(head, rows, "Angles and loads of each pose", note=note),))


def tests(result: PlanResult) -> Section:
    """Return the test poses."""
    order = np.argsort(-result.tests.weight, kind="stable")
    rows = tuple(
        Row(
            (
                str(place),
                f"{100 * result.tests.weight[row]:.1f}",
                f"{np.linalg.norm(result.tests.wrench[row, :3]):.0f}",
                f"{result.tests.deflection[row] * MM_PER_M:.3f}",
                f"{result.accuracy.poses[row] * MM_PER_M:.3g}",
            )
        )
        for place, row in enumerate(order, 1)
    )
    head = ("Test pose", "Share, %", "Force, N", "Deflection, mm", "Expected to remain, mm")
    note = f"They stand for all cutting moves (Σ w A₀ᵀA₀ agrees to {100 * result.represented:.2g} %)."
    table = Table(head, rows, "Test poses", sortable=True, note=note)
    return Section("tests", "Test poses: where it will be milled", (table,), "half")


def parameters(result: PlanResult) -> Section:
    """Return how well each parameter will be known."""
    rows = tuple(
        Row((parameter.symbol, Cell(f"± {_percent(float(half))}", "good" if half <= _GOOD else "warning")))
        for parameter, half in zip(result.accuracy.parameters, result.accuracy.relative, strict=True)
    )
    note = (
        "Of the robot's present value. A plan made for the work at hand may leave wide what the work does not need. "
        f"{WITH_LINKS}: the intervals are of that sum."
    )
    table = Table(("Parameter", "95 % interval"), rows, "Expected intervals of the parameters", note=note)
    return Section("parameters", "Parameters", (table,), "half")


def torques(result: PlanResult) -> Section:
    """Return the torques of the loads on the joints, by sign, and those of the work."""
    low, high = extremes(result)
    work, count = result.directions.work, poses_by_side(result)
    rows = tuple(
        Row(
            (
                joint,
                Cell(f"{low[row]:.0f} ({count[row, 0]})", "good" if count[row, 0] else "warning"),
                Cell(f"{high[row]:.0f} ({count[row, 1]})", "good" if count[row, 1] else "warning"),
                f"{-work[row, 0] + 0.0:.0f} … {work[row, 1]:.0f}",
            )
        )
        for row, joint in enumerate(JOINTS)
    )
    note = (
        "Of the load alone, N·m; in brackets the poses that load the joint to that side by about the torque of the "
        "work or more. Lost motion and preload of a gear show only where it is loaded to both sides."
    )
    head = ("Joint", "negative (poses)", "positive (poses)", "work")
    return Section(
        "torques", "Torques on the joints", (Table(head, rows, "Torques by joint and sign", note=note),), "half"
    )


def _percent(half: float) -> str:
    return f"{100 * half:.2g} %" if half < 10.0 else "unbounded"
