"""Feeds that were lowered to hold the tolerance of the part: cutting times, and moves that do not hold it."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.correction import HeldFeed, Result
from postproc.frames import MM_PER_M, MM_PER_MIN, Array
from postproc.operations import operation_indices, operations
from postproc.program import Bools
from postproc.report.formatting import stated_mm, two_digit_text

_MOST_MOVES = 100
"""Moves out of tolerance that a report lists (assumed)."""


class OperationFeed(Struct, frozen=True):
    """An operation: its cutting time at the programmed and at the written feeds, and the number of slowed moves."""

    name: str
    tool: int
    time_before_s: float
    time_after_s: float
    lowered_moves: int
    lowest_feed_mm_per_min: float | None


class MissedMove(Struct, frozen=True):
    """A move that does not hold the tolerance: expected error at its feed, and as the feed tends to zero.

    `edge_forces_mm` is the error as the feed tends to zero: edge forces do not depend on the feed. None: unknown.
    """

    source_line: int
    feed_mm_per_min: float
    expected_mm: float
    edge_forces_mm: float | None


class FeedSummary(Struct, frozen=True):
    """`feed` of report.json. A time is the sum of length over feed of cutting moves, without accelerations."""

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
    """Return the summary of lowered feeds; None if feeds are not chosen by a tolerance."""
    feeds, m = result.held_feed, result.program.motions
    if feeds is None:
        return None
    is_cut = ~m.rapid & (feeds.feed > 0.0)
    programmed_time, written_time = (
        # 1.0: no division by the feed of moves that do not cut
        np.where(is_cut, feeds.length / np.where(is_cut, feed, 1.0), 0.0)
        for feed in (feeds.programmed_feed, feeds.feed)
    )
    return FeedSummary(
        tolerance_mm=stated_mm(feeds.tolerance),
        min_feed_mm_per_min=feeds.least * MM_PER_MIN,
        unheld=feeds.unheld,
        cutting_moves=int(np.count_nonzero(is_cut)),
        lowered_moves=int(np.count_nonzero(feeds.is_lowered & is_cut)),
        time_before_s=float(programmed_time.sum()),
        time_after_s=float(written_time.sum()),
        operations=_operation_feeds(result, feeds, is_cut, programmed_time, written_time),
        missed_moves=int(np.count_nonzero(feeds.is_exceeded)),
        missed=_missed_moves(result, feeds),
    )


def _operation_feeds(
    result: Result, feeds: HeldFeed, is_cut: Bools, programmed_time: Array, written_time: Array
) -> list[OperationFeed]:
    """Return an entry for each operation with cutting moves.

    :param is_cut: (M,) True for cutting moves.
    :param programmed_time: (M,) duration of each move at the programmed feed [s], `written_time` (M,) at the written
        feed.
    """
    entries: list[OperationFeed] = []
    program_operations = operations(result.program)
    index_of_move = operation_indices(program_operations, np.arange(len(is_cut)))
    for index, operation in enumerate(program_operations):
        is_cut_of_operation = is_cut & (index_of_move == index)
        if is_cut_of_operation.any():
            entries.append(
                OperationFeed(
                    name=operation.name,
                    tool=operation.tool,
                    time_before_s=float(programmed_time[is_cut_of_operation].sum()),
                    time_after_s=float(written_time[is_cut_of_operation].sum()),
                    lowered_moves=int(np.count_nonzero(feeds.is_lowered & is_cut_of_operation)),
                    lowest_feed_mm_per_min=float(feeds.feed[is_cut_of_operation].min()) * MM_PER_MIN,
                )
            )
    return entries


def _missed_moves(result: Result, feeds: HeldFeed) -> list[MissedMove]:
    """Return up to `_MOST_MOVES` moves that do not hold the tolerance, the largest expected error first."""
    rows = np.flatnonzero(feeds.is_exceeded)
    rows = rows[np.argsort(-feeds.expected[rows], kind="stable")][:_MOST_MOVES]
    edge_errors = feeds.without_feed[rows]  # expected error as the feed tends to zero [m]
    return [
        MissedMove(source_line=line, feed_mm_per_min=feed, expected_mm=error, edge_forces_mm=edge_error)
        for line, feed, error, edge_error in zip(
            result.program.motions.line[rows].tolist(),
            (feeds.feed[rows] * MM_PER_MIN).tolist(),
            (feeds.expected[rows] * MM_PER_M).tolist(),
            [float(error) * MM_PER_M if np.isfinite(error) else None for error in edge_errors],
            strict=True,
        )
    ]


def feed_sentences(feed: FeedSummary, max_moves: int = 5) -> list[str]:
    """Return sentences, without full stops, on lowered feeds and on moves out of tolerance.

    :param max_moves: largest number of moves out of tolerance that have a sentence each.
    """
    tolerance = f"{feed.tolerance_mm:g} mm"
    if not feed.lowered_moves:
        texts = [f"feeds as programmed: lowering none of them helps to hold {tolerance}"]
        if not feed.missed_moves:
            texts = [f"feeds as programmed: they hold {tolerance}"]
    else:
        moves = "1 cutting move" if feed.cutting_moves == 1 else f"{feed.cutting_moves} cutting moves"
        texts = [
            f"feed lowered on {feed.lowered_moves} of {moves} to hold {tolerance}: "
            f"cutting time {duration_text(feed.time_before_s)} → {duration_text(feed.time_after_s)}"
        ]
    if feed.missed_moves:
        count_text = "1 move does not" if feed.missed_moves == 1 else f"{feed.missed_moves} moves do not"
        feeds = "keep the feed of the program" if feed.unheld == "program" else "get the lowest feed"
        texts.append(
            f"{count_text} hold {tolerance} at any feed from min_feed_mm_per_min up: such moves {feeds} "
            f'([output] unheld = "{feed.unheld}")'
        )
        for move in feed.missed[:max_moves]:
            edge_mm = move.edge_forces_mm
            text = (
                f"line {move.source_line}: {two_digit_text(move.expected_mm)} mm at {move.feed_mm_per_min:.0f} mm/min"
            )
            texts.append(
                text
                + (
                    ""
                    if edge_mm is None
                    else f", {two_digit_text(max(edge_mm, 0.0))} mm of it by edge forces at any feed"
                )
            )
    return texts


def duration_text(seconds: float) -> str:
    """Return a duration [s] as text.

    >>> duration_text(35.24), duration_text(754.0), duration_text(7260.0)
    ('35.2 s', '12 min 34 s', '2 h 01 min')
    """
    if seconds < 100.0:
        return f"{seconds:.1f} s"
    whole_seconds = round(seconds)
    if whole_seconds < 3600:
        return f"{whole_seconds // 60} min {whole_seconds % 60:02d} s"
    return f"{whole_seconds // 3600} h {whole_seconds % 3600 // 60:02d} min"
