"""Feeds that were lowered to hold the tolerance of the part: cutting times, and moves that do not hold it."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.correction import HeldFeed, Result
from postproc.frames import MM_PER_M
from postproc.operations import of_motions, operations
from postproc.report.formatting import rounded

_MM_PER_MIN = 60.0 * MM_PER_M
_MOST_LISTED = 100


class OperationFeed(Struct, frozen=True):
    """One operation: its cutting time at the programmed and at the written feeds, and how many moves were slowed."""

    name: str
    tool: int
    time_before_s: float
    time_after_s: float
    lowered_moves: int
    lowest_feed_mm_per_min: float | None


class MissedMove(Struct, frozen=True):
    """A move that does not hold the tolerance: expected error at its feed, and as the feed tends to zero."""

    source_line: int
    feed_mm_per_min: float
    expected_mm: float
    edge_forces_mm: float | None


class FeedSummary(Struct, frozen=True):
    """`feed` of report.json. Times are lengths by feeds of cutting moves; the controller's accelerations are not in."""

    tolerance_mm: float
    min_feed_mm_per_min: float
    unheld: str
    cutting_moves: int
    lowered_moves: int
    time_before_s: float
    time_after_s: float
    operations: list[OperationFeed]
    missed_moves: int
    missed: list[MissedMove]


def feed_summary(result: Result) -> FeedSummary | None:
    """Return what was done to the feeds; None where they are those of the program."""
    held, m = result.held_feed, result.program.motions
    if held is None:
        return None
    cuts = ~m.rapid & (held.feed > 0.0)
    before, after = (np.where(cuts, held.length / np.where(cuts, f, 1.0), 0.0) for f in (held.programmed, held.feed))
    found = operations(result.program)
    of = of_motions(found, np.arange(len(m)))
    rows: list[OperationFeed] = []
    for place, operation in enumerate(found):
        own = cuts & (of == place)
        if own.any():
            rows.append(
                OperationFeed(
                    name=operation.name,
                    tool=operation.tool,
                    time_before_s=float(before[own].sum()),
                    time_after_s=float(after[own].sum()),
                    lowered_moves=int(np.count_nonzero(held.lowered & own)),
                    lowest_feed_mm_per_min=float(held.feed[own].min()) * _MM_PER_MIN,
                )
            )
    return FeedSummary(
        tolerance_mm=held.tolerance * MM_PER_M,
        min_feed_mm_per_min=held.least * _MM_PER_MIN,
        unheld=held.unheld,
        cutting_moves=int(np.count_nonzero(cuts)),
        lowered_moves=int(np.count_nonzero(held.lowered & cuts)),
        time_before_s=float(before.sum()),
        time_after_s=float(after.sum()),
        operations=rows,
        missed_moves=int(np.count_nonzero(held.missed)),
        missed=_missed(result, held),
    )


def _missed(result: Result, held: HeldFeed) -> list[MissedMove]:
    """Return the moves that do not hold the tolerance, the worst first."""
    rows = np.flatnonzero(held.missed)
    rows = rows[np.argsort(-held.expected[rows], kind="stable")][:_MOST_LISTED]
    edge = held.without_feed[rows]
    return [
        MissedMove(source_line=line, feed_mm_per_min=feed, expected_mm=error, edge_forces_mm=floor)
        for line, feed, error, floor in zip(
            result.program.motions.line[rows].tolist(),
            (held.feed[rows] * _MM_PER_MIN).tolist(),
            (held.expected[rows] * MM_PER_M).tolist(),
            [float(each) * MM_PER_M if np.isfinite(each) else None for each in edge],
            strict=True,
        )
    ]


def sentences(feed: FeedSummary, most: int = 5) -> list[str]:
    """Return what was done to the feeds, and up to `most` moves that are not held, as sentences without full stop."""
    tolerance = f"{feed.tolerance_mm:g} mm"
    if not feed.lowered_moves:
        out = [f"feeds as programmed: lowering none of them helps to hold {tolerance}"]
        if not feed.missed_moves:
            out = [f"feeds as programmed: they hold {tolerance}"]
    else:
        moves = "1 cutting move" if feed.cutting_moves == 1 else f"{feed.cutting_moves} cutting moves"
        out = [
            f"feed lowered on {feed.lowered_moves} of {moves} to hold {tolerance}: "
            f"cutting time {seconds(feed.time_before_s)} → {seconds(feed.time_after_s)}"
        ]
    if feed.missed_moves:
        many = "1 move does not" if feed.missed_moves == 1 else f"{feed.missed_moves} moves do not"
        feeds = "keep the feed of the program" if feed.unheld == "program" else "get the lowest feed"
        out.append(
            f"{many} hold {tolerance} at any feed from min_feed_mm_per_min up: such moves {feeds} ([output] unheld = "
            f'"{feed.unheld}")'
        )
        for move in feed.missed[:most]:
            floor = move.edge_forces_mm
            text = f"line {move.source_line}: {rounded(move.expected_mm)} mm at {move.feed_mm_per_min:.0f} mm/min"
            out.append(
                text + ("" if floor is None else f", {rounded(max(floor, 0.0))} mm of it by edge forces at any feed")
            )
    return out


def seconds(value: float) -> str:
    """Return a time as text.

    >>> seconds(35.24), seconds(754.0), seconds(7260.0)
    ('35.2 s', '12 min 34 s', '2 h 01 min')
    """
    if value < 100.0:
        return f"{value:.1f} s"
    whole = round(value)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
