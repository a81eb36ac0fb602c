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

    :param is_placed: whether X, Y or Z is programmed.
    :param ijk: words I, J, K; `radius`: R, of cycles the height to which they retract; NaN where absent.
    :param turns: P, turns of an arc or dwell of a cycle.
    :param motion: active motion code, such as 1 for G1; 80: none.
    :param has_motion_code: whether the line itself has a motion code.
    :param feed: [mm/min]; in G93 [1/min]. `rate`: F as written, in deg/min for rotary axes alone.
    :param plane: 17, 18 or 19; `units`: 20 or 21.
    :param incremental: G91; `absolute_centre`: G90.1.
    :param moving: lines that move by G0…G3; `drilling`: by a cycle.
    :param rotary: (L, k) words of the rotary axes [deg].
    :param tip: whether tool-centre-point control is on.
    :param inverse_time: G93; `to_r`: G99.
    :param pecks: Q; `repeats`: L.
    """

    xyz: Array
    is_placed: Bools
    ijk: Array
    radius: Array
    turns: Array
    motion: NDArray[np.int8]
    has_motion_code: Bools
    feed: Array
    rate: Array
    plane: Array
    units: Array
    incremental: Bools
    absolute_centre: Bools
    moving: Bools
    drilling: Bools
    rotary: Array
    tip: Bools
    inverse_time: Bools
    to_r: Bools
    pecks: Array
    repeats: Array


def carry_forward(values: Array, initial: float) -> Array:
    """Return values (L,) with NaN replaced by the last value before, or by `initial`."""
    filled_values = np.empty(len(values))
    for part in chunks(len(values)):
        part_values = np.append(initial, values[part])
        last = np.maximum.accumulate(np.where(np.isnan(part_values), 0, np.arange(len(part_values))))
        filled_values[part] = part_values[last[1:]]
        initial = part_values[last[-1]]
    return filled_values


def active_values(changes: Sequence[tuple[int, float]], initial: float, rows: int) -> Array:
    """Return the active value of each line (rows,), from changes (row, value) in order of rows."""
    bounds = [0, *(row for row, _ in changes if row < rows), rows]
    values = [initial, *(value for row, value in changes if row < rows)]
    if len(set(values)) == 1:
        return constant(initial, rows)
    return np.repeat(np.array(values, dtype=float), np.diff(bounds))


def take_rows(column: NDArray[Any], rows: Ints) -> NDArray[Any]:
    """Return rows (n,) of a column; one of one value still takes no memory."""
    if len(column) and column.strides[0] == 0:
        return np.broadcast_to(column[0], (len(rows), *column.shape[1:]))
    return np.asarray(column[rows])


def line_states_of(words: Words, modes: Modes, rotary: Rotary | None) -> LineStates:
    """Return words and modal state of all lines of a program, lengths in mm.

    :param modes: modal state and events of the blocks that are not plain.
    :param rotary: the rotary axes of the cell, whose words are angles or directions; None: it has none.
    """
    count = modes.rows
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
    inverse_time = state["feed"] == 93.0
    feed_words = words.column("F")[:count]
    rate = carry_forward(feed_words, 0.0)
    return LineStates(
        xyz=xyz,
        is_placed=has_position,
        ijk=ijk,
        radius=radius[:, 0],
        turns=words.column("P")[:count],
        motion=motion,
        has_motion_code=kinds.has_motion_code,
        feed=_feeds(feed_words, rate, factor, inverse_time),
        rate=rate,
        plane=state["plane"],
        units=state["units"],
        incremental=state["distance"] == 91.0,
        absolute_centre=state["centre"] == 90.1,
        moving=kinds.moving,
        drilling=kinds.drilling,
        rotary=rotary_words,
        tip=_tip_control(modes, rotary, count),
        inverse_time=inverse_time,
        to_r=state["retract"] == 99.0,
        pecks=pecks[:, 0],
        repeats=words.column("L")[:count],
    )


class _LineKinds(NamedTuple):
    """Which lines (L,) have a motion code themselves, move by G0…G3, and move by a cycle."""

    has_motion_code: Bools
    moving: Bools
    drilling: Bools


def _line_kinds(code: Array, motion: NDArray[np.int8], has_axis_word: Bools, has_centre: Bools) -> _LineKinds:
    """Return which lines move: those with a word of an axis, and arcs with a code or a centre, such as full circles.

    :param code: (L,) motion code of each line; NaN: it has none. `motion`: (L,) the active one.
    :param has_axis_word: (L,) lines with X, Y, Z or a rotary axis; `has_centre`: (L,) with I, J or K.
    """
    has_motion_code = ~np.isnan(code) & (code != codes.CANCEL_CYCLE)
    is_arc = (motion == 2.0) | (motion == 3.0)
    drilling = np.isin(motion, codes.CYCLES) & has_axis_word
    moving = ~drilling & (has_axis_word | (is_arc & (has_motion_code | has_centre)))
    return _LineKinds(has_motion_code, moving, drilling)


def _in_mm(group_words: Array, factor: Array | None) -> Array:
    """Return words (L, n) in millimetres; a group without words still takes no memory.

    :param factor: (L, 1) millimetres per unit of each line; None: all lines are in millimetres.
    """
    return group_words if factor is None or not group_words.strides[0] else group_words * factor


def _tip_control(modes: Modes, rotary: Rotary | None, count: int) -> Bools:
    """Return whether tool-centre-point control is on, for each of `count` lines.

    It is always on without rotary axes, and where neither the cell nor the program has codes that switch it on.
    """
    if rotary is None or not (rotary.tcp_on or any(on for _, on in modes.tip)):
        return np.ones(count, dtype=bool)
    return active_values(modes.tip, 0.0, count) > 0.0


def _rotary_words(words: Words, is_arc: Bools, rotary: Rotary | None) -> Array:
    """Return the words of the rotary axes (n, k) of the first n lines [deg], or the direction of the tool (n, 3).

    :param is_arc: (n,) lines of arcs, where I, J and K are no direction of the tool but the centre.
    """
    count = len(is_arc)
    if rotary is not None and rotary.kind == "vector":
        direction = np.where(is_arc[:, None], np.nan, words["IJK"][:count])
        length = norm(direction)[:, None]  # NaN of an incomplete direction, which is an error like I0 J0 K0
        return np.divide(direction, length, out=direction, where=length > 0.0)
    if rotary is None or not rotary.axes:
        return np.zeros((count, 0))
    return np.stack([words.column(letter)[:count] for letter in rotary.axes], axis=1)


def _feeds(feed_words: Array, rate: Array, factor: Array | None, inverse_time: Bools) -> Array:
    """Return the modal feed (L,) of each line [mm/min]; in G93 the feed of the line itself [1/min], or 0.

    :param feed_words: (L,) F as written; NaN where absent. `rate`: (L,) the same, carried forward.
    :param factor: (L, 1) millimetres per unit of each line; None: all lines are in millimetres.
    :param inverse_time: (L,) lines in G93.
    """
    if factor is None and not inverse_time.any():
        return rate  # F is in mm/min everywhere: a column less
    feeds_mm = _in_mm(feed_words[:, None], factor)[:, 0]
    if not inverse_time.any():
        return carry_forward(feeds_mm, 0.0)
    is_after_g93 = np.append(False, inverse_time[:-1] & ~inverse_time[1:])  # the feed before G93 is not valid after it
    plain = np.where(inverse_time, np.nan, np.where(is_after_g93 & np.isnan(feeds_mm), 0.0, feeds_mm))
    return np.where(inverse_time, np.nan_to_num(feed_words), carry_forward(plain, 0.0))
