"""The line through the map path × turn: dynamic programming over turns and whole turns of A4 and A6.

A state is the turn at the end of a block and the number of whole turns of A4 and A6: their angles are counted on along
the path, so that no line winds a joint past its limits. Within a block the turn changes in proportion to the path; all
bins that the line crosses must be free (Bellman 1957).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import RAD_PER_DEG, Array
from postproc.placement import drive
from postproc.placement.drive import WINDING, Keep
from postproc.placement.turn_map import TurnMap
from postproc.program import Bools, Ints
from postproc.robot import RobotModel

_TURN = 2.0 * np.pi
_PER_MM = 1.0 * RAD_PER_DEG
"""Largest change of the turn at feed per millimetre [rad]."""
_PER_SECOND = 30.0 * RAD_PER_DEG
"""Largest turning speed at feed [rad/s]: well below any wrist's."""
_RAPID_PER_MM = 3.0 * RAD_PER_DEG
"""Largest change per millimetre on rapid moves [rad]; those are slowed if a joint would be too fast."""
_PER_BIN = 60.0 * RAD_PER_DEG
"""Largest change in one bin: which way round A4 and A6 go is then certain."""
_LARGEST = 170.0 * RAD_PER_DEG
"""Largest change in one block: a motion turns the tool the short way."""
_ALIKE = 0.01
"""Share of the expected error that may be given for margin: lines whose errors differ by less are alike."""
_STEADY = 0.003
"""Cost of turning by a radian, as a share of the cost of all cuts: of lines alike, the one that turns least."""
_EASY = 15.0 * RAD_PER_DEG
"""Margin of joints and wrist beyond which more margin is worth little [rad]."""


class Line(Struct, frozen=True, eq=False):
    """A line through the map.

    :param knots: (B,) turn at the end of each block [rad], continuous along the path.
    :param cost: mean of the squared expected error over the cuts, as a share of that of the map, with what margins add.
    """

    knots: Array
    cost: float


class Blocked(Struct, frozen=True):
    """There is no line: `block` cannot be passed, `cells` are the reasons of its bins."""

    block: int


def find(
    robot: RobotModel,
    found: TurnMap,
    keep: Keep,
    start: Array,
    *,
    turn_at_feed: bool,
    closed: bool,
) -> Line | Blocked:
    """Find the cheapest line.

    :param start: (6,) joint angles before the program [rad]: A4 and A6 are counted from there.
    :param turn_at_feed: whether the turn may change on cuts; else on rapid moves only.
    :param closed: whether the map is a whole circle of turns.
    """
    reasons = found.reasons(keep)
    bad = drive.any_bad(reasons)
    cost = _cell_cost(found, bad)
    blocks = found.blocks
    step = float(found.offset[1] - found.offset[0])
    many = len(found.offset)
    bins = np.searchsorted(blocks.block, np.arange(len(blocks.length) + 1))
    state = np.full((3, 3, many), np.inf)
    back: list[tuple[Ints, Ints, Ints]] = []
    windings = _limits(robot, keep)
    base = found.base[np.append(blocks.first[1:], len(found.base)) - 1]
    last_q: Array | None = None
    for b in range(len(blocks.length)):
        part = slice(int(bins[b]), int(bins[b + 1]))
        if blocks.begins[b]:
            state, source = _begin(found, part, bad, cost, start, state, last_q, windings)
        else:
            own = float(base[part.stop - 1] - base[part.start - 1])
            steps = _steps(found, b, part, step, own, turn_at_feed=turn_at_feed)
            changes = steps, np.abs(steps * step + own)
            state, source = _advance(found, b, part, changes, bad, cost, state, windings, closed=closed)
        back.append(source)
        if not np.isfinite(state).any():
            return Blocked(b)
        last_q = found.q[part.stop - 1]
    return _traced(found, state, back, base)


def _cell_cost(found: TurnMap, bad: Bools) -> Array:
    """Return the cost (K, J) of each bin: its share of the squared error, and a little for missing margin."""
    blocks = found.blocks
    bins = np.diff(np.append(blocks.first, len(found.base)))
    error = np.where(bad, np.nan, found.error) ** 2
    weight = bins * blocks.cuts[blocks.block]
    typical = np.nan_to_num(np.nanmin(np.where(np.isnan(error), np.inf, error), axis=1), posinf=0.0)
    total = float((weight * typical).sum())
    out = np.zeros(bad.shape)
    if total > 0.0:
        out += weight[:, None] / total * np.nan_to_num(error, nan=0.0)
    ease = np.minimum(found.margin.joint, found.margin.wrist)
    with np.errstate(over="ignore"):
        tight = np.exp(-np.nan_to_num(ease, posinf=1e3) / _EASY)
    return np.asarray(out + _ALIKE * tight * (bins / bins.sum())[:, None])


def _limits(robot: RobotModel, keep: Keep) -> tuple[Array, Array]:
    """Return the least and largest angle (2,) of A4 and A6 [rad] with the margin to keep."""
    joints = list(WINDING)
    return robot.lower[joints] + keep.joint, robot.upper[joints] - keep.joint


def _begin(
    found: TurnMap,
    part: slice,
    bad: Bools,
    cost: Array,
    start: Array,
    state: Array,
    last_q: Array | None,
    limits: tuple[Array, Array],
) -> tuple[Array, tuple[Ints, Ints, Ints]]:
    """Begin at a joint interpolation: it takes A4 and A6 the short way from where they are."""
    joints = list(WINDING)
    here = found.q[part.stop - 1][:, joints]
    many = len(here)
    usable = ~bad[part].any(axis=0)
    own = cost[part].sum(axis=0)
    out = np.full((3, 3, many), np.inf)
    source = tuple(np.zeros((3, 3, many), dtype=np.int64) for _ in range(3))
    if last_q is None:
        sources = [(0, 0, 0, np.asarray(start)[joints], 0.0)]
    else:
        # from every turn before, by the cheapest of its states
        flat = state.reshape(9, many)
        best = flat.argmin(axis=0)
        sources = [
            (
                int(best[j]) // 3,
                int(best[j]) % 3,
                j,
                last_q[j, joints] + _TURN * _offsets(best[j]),
                float(flat[best[j], j]),
            )
            for j in range(many)
            if np.isfinite(flat[best[j], j])
        ]
    for n4, n6, j, q, before in sources:
        whole = np.rint((q - here) / _TURN)
        angle = here + _TURN * whole
        fits = usable & ((angle >= limits[0]) & (angle <= limits[1])).all(axis=1) & (np.abs(whole) <= 1).all(axis=1)
        turned = np.abs(angle - q).max(axis=1)
        value = before + own + _STEADY * 0.1 * turned
        for k in np.flatnonzero(fits).tolist():
            at = (int(whole[k, 0]) + 1, int(whole[k, 1]) + 1, k)
            if value[k] < out[at]:
                out[at] = value[k]
                source[0][at], source[1][at], source[2][at] = n4, n6, j
    return out, (source[0], source[1], source[2])


def _offsets(index: int) -> Array:
    return np.array([index // 3 - 1, index % 3 - 1], dtype=float)


def _steps(found: TurnMap, b: int, part: slice, step: float, own: float, *, turn_at_feed: bool) -> Ints:
    """Return the changes (D,) of the turn on a block, in steps of the map; 0 is one of them.

    :param own: change of the turn along the columns of the map [rad].
    """
    blocks = found.blocks
    millimetres = float(blocks.length[b]) * 1e3
    if not blocks.cuts[b]:
        limit = _RAPID_PER_MM * millimetres
    elif turn_at_feed:
        limit = min(_PER_MM * millimetres, _PER_SECOND * float(blocks.time[b]))
    else:
        return np.zeros(1, dtype=np.int64)
    limit = min(limit, _PER_BIN * (part.stop - part.start), _LARGEST)
    least, most = int(np.ceil((-limit - own) / step - _EXACT)), int(np.floor((limit - own) / step + _EXACT))
    many = len(found.offset)
    return np.arange(max(min(least, 0), 1 - many), min(max(most, 0), many - 1) + 1)


def _advance(
    found: TurnMap,
    b: int,
    part: slice,
    changes: tuple[Ints, Array],
    bad: Bools,
    cost: Array,
    state: Array,
    limits: tuple[Array, Array],
    *,
    closed: bool,
) -> tuple[Array, tuple[Ints, Ints, Ints]]:
    """Advance the states (3, 3, J) over a block.

    :param changes: changes of the turn (D,) in steps of the map, and the whole change (D,) with that of its columns
        [rad].
    """
    blocks, (steps, turned) = found.blocks, changes
    many = len(found.offset)
    source = np.arange(many)[:, None] - steps  # (target, change)
    outside = np.zeros(source.shape, dtype=bool) if closed else (source < 0) | (source >= many)
    source = source % many
    joints = list(WINDING)
    share = np.append(0.0, blocks.share[part])
    price = np.zeros(source.shape)
    blocked = outside.copy()
    angle = found.q[part.start - 1][source][..., joints]
    least, most = angle.copy(), angle.copy()
    whole_time = float(blocks.time[b])
    turning = (
        np.abs(steps) * (found.offset[1] - found.offset[0]) / whole_time if whole_time > 0.0 else np.zeros(len(steps))
    )
    at_feed = bool(blocks.cuts[b])
    columns = source
    closed_before = {k: np.concatenate([[0], np.cumsum(np.tile(bad[k], 3))]) for k in range(part.start, part.stop)}
    for n, k in enumerate(range(part.start, part.stop)):
        before = columns
        columns = _column(source + steps * share[n + 1], many)
        crossed = np.sort(source + steps * share[n : n + 2, None, None], axis=0)
        first, last = np.floor(crossed[0] + _EXACT).astype(np.int64), np.ceil(crossed[1] - _EXACT).astype(np.int64)
        blocked |= closed_before[k][last + many + 1] > closed_before[k][first + many]
        price += cost[k][_column(source + steps * (0.5 * (share[n] + share[n + 1])), many)]
        if at_feed and len(steps) > 1:
            blocked |= ~(found.speed[k][columns] + found.rate[k][columns] * turning <= 1.0)
        wound = found.winding[k][before]
        least = np.minimum(least, angle + wound[..., 1])
        most = np.maximum(most, angle + wound[..., 2])
        angle = angle + wound[..., 0]
        angle = angle + drive.wrapped(found.q[k][columns][..., joints] - found.q[k][before][..., joints])
        least, most = np.minimum(least, angle), np.maximum(most, angle)
    end = found.q[part.stop - 1][np.arange(many)][:, None, joints]
    with np.errstate(invalid="ignore"):
        more = np.rint((angle - end) / _TURN)
        unsure = np.isnan(more).any(axis=2)
    more = np.nan_to_num(more).astype(np.int64)
    length = max(float(blocks.length[b]) * 1e3, 1.0)
    price = price + _STEADY * turned * (1.0 + turned / (_PER_MM * length))
    price = np.where(blocked | unsure, np.inf, price)
    out = np.full((3, 3, many), np.inf)
    took = np.zeros((3, 3, many), dtype=np.int64)
    from4, from6 = took.copy(), took.copy()
    every = np.arange(many)
    for n4 in range(3):
        for n6 in range(3):
            before4, before6 = n4 - more[..., 0], n6 - more[..., 1]
            known = (before4 >= 0) & (before4 <= 2) & (before6 >= 0) & (before6 <= 2)
            own4, own6 = np.clip(before4, 0, 2), np.clip(before6, 0, 2)
            whole = _TURN * (np.stack([own4, own6], axis=2) - 1)
            known &= (least + whole >= limits[0]).all(axis=2) & (most + whole <= limits[1]).all(axis=2)
            value = np.where(known, state[own4, own6, source] + price, np.inf)
            best = value.argmin(axis=1)
            out[n4, n6] = value[every, best]
            took[n4, n6] = steps[best]
            from4[n4, n6], from6[n4, n6] = own4[every, best], own6[every, best]
    return out, (from4, from6, took + _STEP_MARK)


def _column(place: Array, many: int) -> Ints:
    """Return the columns next to places on a circle of `many`."""
    return np.asarray(np.rint(place).astype(np.int64) % many)


_EXACT = 1e-9
_STEP_MARK = 1_000_000
"""Added to changes of the turn, to distinguish them from turns of the block before."""


def _traced(found: TurnMap, state: Array, back: list[tuple[Ints, Ints, Ints]], base: Array) -> Line:
    """Return the line that ends in the cheapest state."""
    many = len(found.offset)
    at = np.unravel_index(int(np.argmin(state)), state.shape)
    n4, n6, j = (int(each) for each in at)
    blocks = found.blocks
    bins = np.append(np.flatnonzero(np.diff(blocks.block)), len(blocks.block) - 1)
    chain: list[tuple[int, int | None]] = []
    for source4, source6, how in reversed(back):
        mark = int(how[n4, n6, j])
        before4, before6 = int(source4[n4, n6, j]), int(source6[n4, n6, j])
        if mark >= _STEP_MARK // 2:
            chain.append((j, mark - _STEP_MARK))
            n4, n6, j = before4, before6, (j - (mark - _STEP_MARK)) % many
        else:
            chain.append((j, None))
            n4, n6, j = before4, before6, mark
    step = float(found.offset[1] - found.offset[0])
    knots = np.empty(len(chain))
    offset = 0.0
    for b, (column, change) in enumerate(reversed(chain)):
        offset = float(found.offset[column]) if change is None else offset + change * step
        knots[b] = offset + base[bins[b]]
    return Line(knots, float(state.min()))
