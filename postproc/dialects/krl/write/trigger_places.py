"""Places of TRIGGER statements when inserted targets divide the motion that they refer to into pieces.

A TRIGGER must be before the piece on which it switches; ``PATH`` then counts from the start or the end of this piece.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from postproc.decimals import decimal_text
from postproc.dialects.krl.language.motion_statements import Trigger
from postproc.frames import MM_PER_M, Array

_DISTANCE_TOLERANCE = 1e-6
"""Distances along a path that differ by less than this [m] are equal."""


def piece_and_distance(trigger: Trigger, ends: Array, speed: float) -> tuple[int, float] | None:
    """Return the piece of a divided motion before which a TRIGGER must be, and its distance on this piece.

    Inserted targets divide the motion into n pieces. A TRIGGER refers to the motion that follows it.

    :param ends: (n,) ends of the pieces, as shares of the motion in (0, 1].
    :param speed: speed of the TCP [m/s].
    :returns: number of the piece, from 0, and distance along the path from its start (`is_from_start`) or its end [m].
        None if no single piece contains the path from the distance of the TRIGGER to the place at which it switches.
    """
    end = ends * trigger.length
    begin = np.concatenate([[0.0], end[:-1]])
    position = trigger.offset + (0.0 if trigger.is_from_start else trigger.length)
    # stretch of the path on which the output switches; DELAY may be negative
    earliest, latest = min(position, position + trigger.delay * speed), max(position, position + trigger.delay * speed)
    is_after_begin, is_before_end = earliest > begin - _DISTANCE_TOLERANCE, latest < end + _DISTANCE_TOLERANCE
    is_after_begin[0] = is_before_end[-1] = True  # distances beyond the motion count from its first or last piece
    fits = is_after_begin & is_before_end
    if trigger.path_span is None:  # DISTANCE counts from an end of the motion: only the first or the last piece has it
        other_pieces = slice(1, None) if trigger.is_from_start else slice(-1)
        fits[other_pieces] = False
    if not trigger.is_attached:  # other statements follow it, so that it cannot be moved behind an inserted target
        fits[1:] = False
    pieces = np.flatnonzero(fits & np.isfinite(position + trigger.delay))  # NaN: distance or delay is no number
    if not len(pieces):
        return None
    piece = int(pieces[0 if trigger.is_from_start else -1])
    return piece, float(position - (begin if trigger.is_from_start else end)[piece])


class PlacedTriggers(Struct, frozen=True, eq=False):
    """Places of the TRIGGERs and of the inserted targets of one divided motion.

    :param target_rows: for each inserted target, the 1-based row of the trace (line in execution order) before which it
        is inserted.
    :param moved_triggers: for each piece, the TRIGGERs that are moved to the line before it, in order.
    :param path_texts: TRIGGER whose PATH changes → its new number as text.
    :param lost_triggers: TRIGGERs that cannot switch at the same place on any piece.
    """

    target_rows: list[int]
    moved_triggers: list[list[Trigger]]
    path_texts: dict[Trigger, str]
    lost_triggers: list[Trigger]


def place_triggers(triggers: Sequence[Trigger], motion_row: int, ends: Array, speed: float) -> PlacedTriggers:
    """Return the places of the TRIGGERs of one divided motion and of the targets inserted into it.

    The inserted targets divide the motion into pieces; a TRIGGER must be before the piece on which it switches. It
    stays on its line if the inserted targets can be written before and behind it.

    :param triggers: TRIGGERs of the motion, in order.
    :param motion_row: 1-based row of the trace (line in execution order) with the motion.
    :param ends: (n,) ends of the pieces, as shares of the motion in (0, 1].
    :param speed: speed of the TCP [m/s].
    """
    # at first, all inserted targets are right before the motion
    placement = PlacedTriggers(
        target_rows=[motion_row] * (len(ends) - 1),
        moved_triggers=[[] for _ in ends],
        path_texts={},
        lost_triggers=[],
    )
    # from the last to the first: smallest piece of the later TRIGGERs that stay on their lines
    earliest_piece = len(ends)
    for trigger in reversed(triggers):
        piece_and_offset = piece_and_distance(trigger, ends, speed)
        if piece_and_offset is None:  # it cannot switch at the same place
            placement.lost_triggers.append(trigger)
            continue
        piece, offset = piece_and_offset
        if trigger.path_span is not None and abs(offset - trigger.offset) > _DISTANCE_TOLERANCE:
            placement.path_texts[trigger] = decimal_text(offset * MM_PER_M, 3).rstrip("0").rstrip(".")
        if piece > earliest_piece:  # a later TRIGGER stays before an earlier piece: this one must follow it
            placement.moved_triggers[piece].insert(0, trigger)
            continue
        earliest_piece = piece
        if trigger.is_attached:  # the ends of earlier pieces precede the TRIGGER
            placement.target_rows[:piece] = [trigger.trace_row] * piece
    placement.lost_triggers.reverse()
    return placement
