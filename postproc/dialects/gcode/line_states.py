"""Words and modal state of each line of a G-code program, as arrays over all its lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.cell import Rotary
from postproc.chunks import chunks
from postproc.dialects.gcode import codes
from postproc.dialects.gcode.modes import MM_PER_UNIT, Modes
from postproc.dialects.gcode.words import Words
from postproc.frames import Array, any_column, norm
from postproc.program import Bools, Ints, constant


class LineStates(Struct, frozen=True, eq=False):
    """Words and modal state of each line, lengths in mm: XYZ, IJK (L, 3); all else (L,).

    :param xyz: words X, Y, Z; NaN where absent.
    :param has_xyz_word: whether the line has X, Y or Z.
    :param ijk: words I, J, K; NaN where absent.
    :param radius: R: the radius of an arc, or the height of the R plane of a cycle; NaN where absent.
    :param turns: P: the turns of an arc, or the dwell of a cycle; NaN where absent.
    :param motion: active motion code, such as 1 for G1; 80: none.
    :param has_motion_code: whether the line itself has a motion code.
    :param feed: [mm/min]; in G93 [1/min].
    :param written_feed: the last F as written, which is in deg/min for moves of rotary axes alone.
    :param plane: 17, 18 or 19; `units`: 20 or 21.
    :param is_incremental: whether G91 is active.
    :param has_absolute_centre: whether G90.1 is active.
    :param is_moving: whether the line moves by G0…G3.
    :param is_drilling: whether the line moves by a cycle.
    :param rotary: (L, k) words of the rotary axes [deg], or (L, 3) directions of the tool; NaN where absent.
    :param is_tip_controlled: whether tool-centre-point control is on.
    :param is_inverse_time: whether G93 is active.
    :param retracts_to_r: whether G99 is active: cycles retract to the R plane.
    :param pecks: Q, the depth of a peck; NaN where absent.
    :param repeats: L, the number of holes; NaN where absent.
    """

    xyz: Array
    has_xyz_word: Bools
    ijk: Array
    radius: Array
    turns: Array
    motion: NDArray[np.int8]
    has_motion_code: Bools
    feed: Array
    written_feed: Array
    plane: Array
    units: Array
    is_incremental: Bools
    has_absolute_centre: Bools
    is_moving: Bools
    is_drilling: Bools
    rotary: Array
    is_tip_controlled: Bools
    is_inverse_time: Bools
    retracts_to_r: Bools
    pecks: Array
    repeats: Array


def carry_forward(values: Array, initial: float) -> Array:
    """Return values (L,) with NaN replaced by the last value before, or by `initial`."""
    filled_values = np.empty(len(values))
    for chunk in chunks(len(values)):
        chunk_values = np.append(initial, values[chunk])  # index 0: the value before the chunk
        # index of the last value that is not NaN, up to each value
        last_index = np.maximum.accumulate(np.where(np.isnan(chunk_values), 0, np.arange(len(chunk_values))))
        filled_values[chunk] = chunk_values[last_index[1:]]
        initial = chunk_values[last_index[-1]]
    return filled_values


def active_values(changes: Sequence[tuple[int, float]], initial: float, rows: int) -> Array:
    """Return the active value of each line (rows,), from its changes.

    :param changes: (row, value), in order of rows; a value is active from its row on.
    :param initial: value before the first change; `rows`: number of lines.
    """
    bounds = [0, *(row for row, _ in changes if row < rows), rows]
    values = [initial, *(value for row, value in changes if row < rows)]
    if len(set(values)) == 1:
        return constant(initial, rows)
    return np.repeat(np.array(values, dtype=float), np.diff(bounds))


def take_rows(column: NDArray[Any], rows: Ints) -> NDArray[Any]:
    """Return rows (n,) of a column; a broadcast column of a single value stays broadcast, and takes no memory."""
    if len(column) and column.strides[0] == 0:  # broadcast from its first row
        return np.broadcast_to(column[0], (len(rows), *column.shape[1:]))
    return np.asarray(column[rows])


def line_states_of(words: Words, modes: Modes, rotary: Rotary | None) -> LineStates:
    """Return words and modal state of all lines of a program, lengths in mm.

    :param modes: modal state and events of the blocks that are not plain.
    :param rotary: the rotary axes of the cell, whose words are angles or directions; None: it has none.
    """
    count = modes.row_count
    # the first code of each group is active when the program starts
    state = {group: active_values(modes.changes[group], valid[0], count) for group, valid in codes.GROUPS.items()}
    inches = state["units"] == 20.0
    factor = np.where(inches, MM_PER_UNIT[20.0], MM_PER_UNIT[21.0])[:, None] if inches.any() else None
    xyz, ijk, radius, pecks = (_in_mm(words[group][:count], factor) for group in ("XYZ", "IJK", "R", "Q"))
    code = words.column("G")[:count]
    motion = carry_forward(code, codes.CANCEL_CYCLE).astype(np.int8)
    is_arc = (motion == 2.0) | (motion == 3.0)
    rotary_words = _rotary_words(words, is_arc, rotary)
    if rotary is not None and rotary.kind == "vector":
        ijk = np.where(is_arc[:, None], ijk, np.nan)
    has_position = any_column(~np.isnan(xyz))
    kinds = _line_kinds(code, motion, has_position | ~np.isnan(rotary_words).all(axis=1), any_column(~np.isnan(ijk)))
    is_inverse_time = state["feed"] == 93.0
    feed_words = words.column("F")[:count]
    written_feed = carry_forward(feed_words, 0.0)
    return LineStates(
        xyz=xyz,
        has_xyz_word=has_position,
        ijk=ijk,
        radius=radius[:, 0],
        turns=words.column("P")[:count],
        motion=motion,
        has_motion_code=kinds.has_motion_code,
        feed=_feeds(feed_words, written_feed, factor, is_inverse_time),
        written_feed=written_feed,
        plane=state["plane"],
        units=state["units"],
        is_incremental=state["distance"] == 91.0,
        has_absolute_centre=state["centre"] == 90.1,
        is_moving=kinds.is_moving,
        is_drilling=kinds.is_drilling,
        rotary=rotary_words,
        is_tip_controlled=_tip_control(modes, rotary, count),
        is_inverse_time=is_inverse_time,
        retracts_to_r=state["retract"] == 99.0,
        pecks=pecks[:, 0],
        repeats=words.column("L")[:count],
    )


class _LineKinds(NamedTuple):
    """Which lines (L,) have a motion code themselves, move by G0…G3, and move by a cycle."""

    has_motion_code: Bools
    is_moving: Bools
    is_drilling: Bools


def _line_kinds(code: Array, motion: NDArray[np.int8], has_axis_word: Bools, has_centre: Bools) -> _LineKinds:
    """Return which lines move: lines with a word of an axis, and arcs with a motion code or a centre (full circles).

    :param code: (L,) motion code of each line; NaN: it has none. `motion`: (L,) the active one.
    :param has_axis_word: (L,) lines with X, Y, Z or a rotary axis; `has_centre`: (L,) with I, J or K.
    """
    has_motion_code = ~np.isnan(code) & (code != codes.CANCEL_CYCLE)
    is_arc = (motion == 2.0) | (motion == 3.0)
    is_drilling = np.isin(motion, codes.CYCLES) & has_axis_word
    is_moving = ~is_drilling & (has_axis_word | (is_arc & (has_motion_code | has_centre)))
    return _LineKinds(has_motion_code, is_moving, is_drilling)


def _in_mm(group_words: Array, factor: Array | None) -> Array:
    """Return words (L, n) in millimetres; a group without words stays broadcast, and takes no memory.

    :param factor: (L, 1) millimetres per unit of each line; None: all lines are in millimetres.
    """
    is_broadcast = not group_words.strides[0]  # one NaN for all lines
    return group_words if factor is None or is_broadcast else group_words * factor


def _tip_control(modes: Modes, rotary: Rotary | None, count: int) -> Bools:
    """Return whether tool-centre-point control is on, for each of `count` lines.

    Without rotary axes it is on in all lines. With rotary axes it is on in all lines if the cell names no code that
    switches it on, and the program has none; else from such a code on.
    """
    if rotary is None or not (rotary.tcp_on or any(on for _, on in modes.tip_control_changes)):
        return np.ones(count, dtype=bool)
    return active_values(modes.tip_control_changes, 0.0, count) > 0.0


def _rotary_words(words: Words, is_arc: Bools, rotary: Rotary | None) -> Array:
    """Return the words of the rotary axes (n, k) of the first n lines [deg], or the direction of the tool (n, 3).

    In a cell without rotary axes (None) k is 0. Directions are scaled to unit length; (0, 0, 0) stays.

    :param is_arc: (n,) lines of arcs, where I, J and K are the centre, not the direction of the tool.
    """
    count = len(is_arc)
    if rotary is not None and rotary.kind == "vector":
        direction = np.where(is_arc[:, None], np.nan, words["IJK"][:count])
        length = norm(direction)[:, None]  # NaN of an incomplete direction, which is an error like I0 J0 K0
        return np.divide(direction, length, out=direction, where=length > 0.0)
    if rotary is None or not rotary.axes:
        return np.zeros((count, 0))
    return np.stack([words.column(letter)[:count] for letter in rotary.axes], axis=1)


def _feeds(feed_words: Array, written_feed: Array, factor: Array | None, is_inverse_time: Bools) -> Array:
    """Return the modal feed (L,) of each line [mm/min]; in G93 the feed of the line itself [1/min], or 0.

    After G93 a feed must be programmed again: until then it is 0.

    :param feed_words: (L,) F as written; NaN where absent.
    :param written_feed: (L,) the last F as written.
    :param factor: (L, 1) millimetres per unit of each line; None: all lines are in millimetres.
    :param is_inverse_time: (L,) lines in G93.
    """
    if factor is None and not is_inverse_time.any():
        return written_feed  # F is in mm/min everywhere: no further column is needed
    feeds_mm = _in_mm(feed_words[:, None], factor)[:, 0]
    if not is_inverse_time.any():
        return carry_forward(feeds_mm, 0.0)
    # the feed before G93 is not valid after it
    is_after_g93 = np.append(False, is_inverse_time[:-1] & ~is_inverse_time[1:])
    g94_words = np.where(is_inverse_time, np.nan, np.where(is_after_g93 & np.isnan(feeds_mm), 0.0, feeds_mm))
    return np.where(is_inverse_time, np.nan_to_num(feed_words), carry_forward(g94_words, 0.0))
