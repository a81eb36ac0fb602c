"""Words and modal state of all lines at once: modal values carried forward."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from postproc.cell import Rotary
from postproc.dialects.gcode import codes
from postproc.dialects.gcode.modes import MM_PER_UNIT, Modes
from postproc.frames import Array, any_column
from postproc.program import Bools


class LineStates(Struct, frozen=True, eq=False):
    """Words and modal state of each line, lengths in mm: XYZ, IJK (L, 3); all else (L,).

    :param placed: where X, Y or Z is programmed.
    :param turns: P; of cycles a dwell [s].
    :param named: where a motion is named, not carried on.
    :param feed: mm/min; in G93 1/min. `rate`: F as it stands: of rotary axes alone in deg/min.
    :param moving: lines with G0…G3 that move; `drilling`: with a cycle.
    :param rotary: (L, k) words of the rotary axes [deg].
    :param tip: whether X, Y, Z are those of the tip although rotary axes turn.
    :param to_r: G99.
    :param pecks: Q; `repeats`: L.
    """

    xyz: Array
    placed: Bools
    ijk: Array
    radius: Array
    turns: Array
    motion: Array
    named: Bools
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


def held(values: Array, initial: float) -> Array:
    """Carry the last value forward over NaN; `initial` holds before the first. (L,) → (L,)."""
    last = np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(1, len(values) + 1)))
    carried: Array = np.concatenate([[initial], values])[last]
    return carried


def in_force(changes: Sequence[tuple[int, float]], initial: float, rows: int) -> Array:
    """Return the value (rows,) in force in each line, of changes (row, value) in order of their rows."""
    at = [0, *(row for row, _ in changes if row < rows), rows]
    values = [initial, *(value for row, value in changes if row < rows)]
    return np.repeat(np.array(values, dtype=float), np.diff(at))


def line_states_of(columns: Mapping[str, Array], modes: Modes, rotary: Rotary | None) -> LineStates:
    """Return words and modal state of the lines of a program."""
    count = modes.rows
    state = {group: in_force(modes.changes[group], valid[0], count) for group, valid in codes.GROUPS.items()}
    factor = np.where(state["units"] == 20.0, MM_PER_UNIT[20.0], MM_PER_UNIT[21.0])
    mm = {letter: columns[letter][:count] * factor for letter in "XYZIJKRFQ"}
    xyz, ijk = np.stack([mm[a] for a in "XYZ"], axis=1), np.stack([mm[a] for a in "IJK"], axis=1)
    code = columns["G"][:count]
    motion = held(code, codes.CANCEL_CYCLE)
    circular = (motion == 2.0) | (motion == 3.0)
    named = ~np.isnan(code) & (code != codes.CANCEL_CYCLE)
    letters = [] if rotary is None else rotary.axes
    turned = np.stack([columns[letter][:count] for letter in letters], axis=1) if letters else np.zeros((count, 0))
    placed = np.logical_or.reduce([~np.isnan(words) for words in xyz.T])
    axes = placed | ~np.isnan(turned).all(axis=1)
    always = rotary is None or not rotary.tcp_on
    drilling = np.isin(motion, codes.CYCLES) & axes
    moving = ~drilling & (axes | (circular & (named | any_column(~np.isnan(ijk)))))
    inverse_time = state["feed"] == 93.0
    return LineStates(
        xyz=xyz,
        placed=placed,
        ijk=ijk,
        radius=mm["R"],
        turns=columns["P"][:count],
        motion=motion,
        named=named,
        feed=_feeds(mm["F"], columns["F"][:count], inverse_time),
        rate=held(columns["F"][:count], 0.0),
        plane=state["plane"],
        units=state["units"],
        incremental=state["distance"] == 91.0,
        absolute_centre=state["centre"] == 90.1,
        moving=moving,
        drilling=drilling,
        rotary=turned,
        tip=np.ones(count, dtype=bool) if always else in_force(modes.tip, 0.0, count) > 0.0,
        inverse_time=inverse_time,
        to_r=state["retract"] == 99.0,
        pecks=mm["Q"],
        repeats=columns["L"][:count],
    )


def _feeds(mm: Array, words: Array, inverse_time: Bools) -> Array:
    """Return the feed of each line: as it holds [mm/min], and in G93 that of the line itself [1/min], 0 without."""
    if not inverse_time.any():
        return held(mm, 0.0)
    back = np.append(False, inverse_time[:-1] & ~inverse_time[1:])  # what held before G93 does not hold after it
    plain = np.where(inverse_time, np.nan, np.where(back & np.isnan(mm), 0.0, mm))
    return np.where(inverse_time, np.nan_to_num(words), held(plain, 0.0))
