"""The map path × turn about the tool axis: what can be driven, the expected error, and the cheapest line through it.

The path is divided into blocks, each with one turn of the tool at its end, between which the turn changes in proportion
to the path. A block is a motion, or a run of short ones; a block is divided into bins, the rows of the map. Every
sample of the path is solved for every turn; of a bin the worst sample counts.

The line is found by dynamic programming over turns and whole turns of A4 and A6. A state is the turn at the end of a
block and the number of whole turns of A4 and A6: their angles are counted on along the path, so that no line winds a
joint past its limits. Within a block the turn changes in proportion to the path; all bins that the line crosses must be
free (Bellman 1957).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.frames import RAD_PER_DEG, Array, inverse
from postproc.kinematics.components import components, product
from postproc.placement import drive
from postproc.placement.bodies import Bodies
from postproc.placement.drive import WINDING, Keep, Margins
from postproc.placement.samples import PathSamples
from postproc.program import PTP, Bools, Ints
from postproc.robot import RobotModel
from postproc.toolpath import flange_from_tcp

_BLOCK = 0.010
"""Shortest block of several motions [m]; the length of the path over `_MOST_BLOCKS` if that is longer."""
_MOST_BLOCKS = 1000
_BINS = 6
"""Most bins of a block."""
_MOST_BINS = 2500
_CHUNK = 4096
"""Samples solved together."""
_MOST_POSES = 2500
"""Samples of a path at which collisions are looked for with every turn; more only where the line goes."""
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


class Blocks(Struct, frozen=True, eq=False):
    """Division of N samples into K bins and B blocks.

    :param first: (K,) first sample of each bin.
    :param block: (K,) block of each bin.
    :param share: (K,) share of the block's path at the end of the bin, in (0, 1].
    :param begins: (B,) True for blocks that do not continue the one before: the first, and joint interpolations.
    :param cuts: (B,) True for blocks at feed.
    :param length: (B,) path length [m].
    :param time: (B,) duration at the programmed feed [s].
    :param motion: (B,) last motion of each block.
    """

    first: Ints
    block: Ints
    share: Array
    begins: Array
    cuts: Array
    length: Array
    time: Array
    motion: Ints

    @classmethod
    def of(cls, samples: PathSamples) -> Blocks:
        """Divide the path."""
        program, segments, motion = samples.program, samples.segments, samples.sample.motion
        m = program.motions
        jump = m.kind == PTP
        length = np.where(jump, 0.0, segments.length)
        own = np.concatenate([[True], jump[1:] | jump[:-1] | (m.rapid[1:] != m.rapid[:-1])])
        step = max(_BLOCK, float(length.sum()) / _MOST_BLOCKS)
        block = _grouped(length, own, step)
        of_sample = block[motion]
        distance = samples.sample.distance
        new = np.diff(motion, prepend=-1) != 0
        travel = np.where(jump[motion], 0.0, np.where(new, distance, np.diff(distance, prepend=0.0)))
        count = np.bincount(of_sample)
        many = min(_BINS, max(1, _MOST_BINS // len(count)))
        start = np.concatenate([[0], np.cumsum(count)[:-1]])
        place = np.arange(len(of_sample)) - start[of_sample]
        number = np.minimum(count, many)[of_sample]
        inner = place * number // count[of_sample]
        first = np.flatnonzero((np.diff(inner, prepend=-1) != 0) | (np.diff(of_sample, prepend=-1) != 0))
        total = np.bincount(of_sample, travel)
        along = np.cumsum(travel)
        before = (np.cumsum(total) - total)[of_sample]
        last = np.append(first[1:], len(of_sample)) - 1
        whole = total[of_sample[last]]
        share = np.where(whole > 0.0, (along - before)[last] / np.where(whole > 0.0, whole, 1.0), 1.0)
        ends = np.append(np.flatnonzero(np.diff(block)), len(block) - 1)
        seconds = np.where(
            m.rapid, np.where(m.feed > 0.0, length / np.where(m.feed > 0.0, m.feed, 1.0), 0.0), length / m.feed
        )
        begin = np.concatenate([[0], ends[:-1] + 1])
        return cls(
            first,
            of_sample[first],
            np.clip(share, 0.0, 1.0),
            jump[begin] | (begin == 0),
            ~m.rapid[begin],
            np.asarray(total, dtype=float),
            np.asarray(np.bincount(block, np.nan_to_num(seconds)), dtype=float),
            ends,
        )

    @property
    def last(self) -> Ints:
        """(K,) last sample of each bin but the last."""
        return self.first[1:] - 1

    def turn_of_motions(self, samples: PathSamples, knots: Array) -> Array:
        """Return the turn (M,) [rad] at the end of each motion for turns (B,) at the ends of blocks."""
        segments, m = samples.segments, samples.program.motions
        block = np.searchsorted(self.motion, np.arange(len(m)))
        length = np.where(m.kind == PTP, 0.0, segments.length)
        total = self.length[block]
        along = np.cumsum(length)
        ends = along[self.motion]
        behind = ends[block] - along
        share = np.where(total > 0.0, 1.0 - behind / np.where(total > 0.0, total, 1.0), 1.0)
        before = np.append(knots[0], knots[:-1])
        before = np.where(self.begins, knots, before)
        return np.asarray(before[block] + np.clip(share, 0.0, 1.0) * (knots - before)[block])


def _grouped(length: Array, own: Array, step: float) -> Ints:
    """Return the block (M,) of each motion: runs are divided where another `step` of their length begins."""
    run = np.cumsum(own) - 1
    along = np.cumsum(length)
    begin = (along - length)[np.flatnonzero(own)]
    number = np.floor((along - length - begin[run]) / step + 1e-9).astype(np.int64)
    change = own | (np.diff(number, prepend=-1) != 0)
    return np.asarray(np.cumsum(change) - 1)


class TurnMap(Struct, frozen=True, eq=False):
    """The map: K bins of the path × J turns.

    :param blocks: the bins.
    :param base: (N,) turn of each sample [rad] to which `offset` adds.
    :param offset: (J,) [rad], ascending in equal steps.
    :param margin: worst margins in each bin (K, J).
    :param speed: (K, J) largest joint speed at the programmed feed with this turn, as a share of its limit.
    :param jump: (K, J) largest turn of a joint between samples [rad].
    :param rate: (K, J) largest joint speed per turn speed, as a share of its limit [s/rad].
    :param hit: (K, J) whether bodies come too close, or None: not checked.
    :param q: (K, J, 6) joint angles at the end of each bin [rad].
    :param winding: (K, J, 2, 3) A4 and A6 along the bin: how far they turn in all, least and most [rad].
    :param u95: (K, J) expected error in the middle of the bin [m]; NaN where there is none.
    :param deflection: (K, J) deflection there [m].
    """

    blocks: Blocks
    base: Array
    offset: Array
    margin: Margins
    speed: Array
    jump: Array
    rate: Array
    hit: Bools | None
    q: Array
    winding: Array
    u95: Array
    deflection: Array

    def reasons(self, keep: Keep) -> Ints:
        """Return why cells (K, J) are refused, see `drive.REASONS`."""
        return drive.reason(self.margin, self.speed, self.jump, keep, self.hit)

    @property
    def error(self) -> Array:
        """(K, J) expected error, or the deflection where the model has none [m]; zero on rapid moves."""
        return np.where(np.isnan(self.u95), self.deflection, self.u95)


def evaluate(
    samples: PathSamples,
    blocks: Blocks,
    branch: int,
    base: Array,
    offset: Array,
    bodies: Bodies | None = None,
) -> TurnMap:
    """Evaluate every sample at every turn.

    :param branch: of the inverse kinematics.
    :param base: (N,) turn of each sample [rad]; `offset` (J,) added to it.
    :param bodies: None = collisions are not checked.
    """
    robot = samples.robot_in_cell.robot
    count, many = len(blocks.first), len(offset)
    shape = (count, many)
    worst = Margins(*(np.full(shape, np.nan) for _ in range(4)))
    speed, jump, rate = (np.zeros(shape) for _ in range(3))
    hit = np.zeros(shape, dtype=bool)
    every = np.arange(0, len(samples), max(1, len(samples) // _MOST_POSES))
    every = np.unique(np.concatenate([every, blocks.last, [len(samples) - 1]]))
    ends, middles = np.empty((count, many, 6)), np.empty((count, many, 6))
    winding = np.zeros((count, many, 2, 3))
    free = samples.program.motions.kind[samples.sample.motion] == PTP
    bounds = np.append(blocks.first, len(samples))
    middle = (bounds[:-1] + bounds[1:] - 1) // 2
    tools = components(inverse(samples.program.tools))
    from_bin = 0
    while from_bin < count:
        to_bin = int(np.searchsorted(bounds, bounds[from_bin] + _CHUNK, side="right")) - 1
        to_bin = min(max(to_bin, from_bin + 1), count)
        begin, end = int(bounds[from_bin]), int(bounds[to_bin])
        lead = int(begin > 0)
        rows = np.arange(begin - lead, end)
        motion = samples.sample.motion[rows]
        pose = _untooled(samples, rows)
        tool = tools if tools.shape[-1] == 1 else tools[..., samples.program.motions.tool[motion]]
        starts = blocks.first[from_bin:to_bin] - begin
        part = slice(from_bin, to_bin)
        still = free[begin:end]
        picked = every[slice(*np.searchsorted(every, [begin, end]))] - begin
        joints = samples.program.motions.joints[motion]
        axis_targets = np.isfinite(joints[:, 0])
        fixed = axis_targets[lead:]
        for j in range(many):
            turn = samples.rotation(base[rows] + offset[j]) if base[rows].any() else samples.rotation(offset[j : j + 1])
            columns = [pose[:, k] for k in range(4)]
            local = np.zeros((3, 4, turn.shape[0]))
            local[:, :3] = np.moveaxis(turn, 0, -1)
            flange = product([*columns[:3], columns[3]], product([local[:, k] for k in range(4)], tool))
            q = drive.solve(robot, flange, branch)
            q[:, axis_targets] = joints[axis_targets].T
            step = np.diff(q, axis=1) if lead else np.diff(q, axis=1, prepend=q[:, :1])
            q = q[:, lead:]
            crossed = (np.abs(np.delete(step, WINDING, axis=0)) > np.pi).any(axis=0) & ~still
            step = np.nan_to_num(drive.wrapped(step))
            step[:, still] = 0.0
            margin = drive.margins(robot, q)
            margin.joint[crossed] = -1.0
            for each in margin.__struct_fields__:
                getattr(margin, each)[fixed] = np.inf
            for name in Margins.__struct_fields__:
                getattr(worst, name)[part, j] = np.minimum.reduceat(getattr(margin, name), starts)
            speed[part, j] = np.maximum.reduceat(drive.timed_speed(robot, step, samples.time[begin:end]), starts)
            jump[part, j] = np.maximum.reduceat(np.abs(step).max(axis=0), starts)
            ends[part, j] = q[:, bounds[from_bin + 1 : to_bin + 1] - 1 - begin].T
            middles[part, j] = q[:, middle[part] - begin].T
            winding[part, j] = _wound(step[list(WINDING)], starts)
            if bodies is not None:
                struck = np.zeros(end - begin, dtype=bool)
                found = bodies.along(q[:, picked].T, rows[lead:][picked], still[picked], between=False)
                struck[picked] = found
                hit[part, j] = np.logical_or.reduceat(struck, starts)
        from_bin = to_bin
    gap = drive.wrapped(np.roll(ends, -1, axis=1) - ends)
    if many > 1:
        rate = np.abs(gap / robot.speed).max(axis=2) / (offset[1] - offset[0])
        rate = np.fmax(rate, np.roll(rate, 1, axis=1))
    u95, deflection = _errors(samples, middle, base[middle][:, None] + offset, middles)
    return TurnMap(
        blocks,
        base,
        offset,
        worst,
        speed,
        jump,
        rate,
        None if bodies is None else hit,
        ends,
        winding,
        u95,
        deflection,
    )


def _untooled(samples: PathSamples, rows: Ints) -> Array:
    """Return the tool frames (3, 4, n) of samples in the root, without turn."""
    motion, t = samples.sample.motion[rows], samples.sample.t[rows]
    pose = samples.sample.pose[rows]
    flange = flange_from_tcp(samples.program, motion, pose, t)
    tools = samples.program.tools
    tool = tools[0] if len(tools) == 1 else tools[samples.program.motions.tool[motion]]
    return components(flange @ tool)


def _wound(step: Array, starts: Ints) -> Array:
    """Return how far (k, 2, 3) joints turn along bins in all, least and most, for steps (2, n) between samples."""
    total = np.cumsum(step, axis=1)
    before = np.concatenate([np.zeros((2, 1)), total[:, starts[1:] - 1]], axis=1)
    least = np.minimum.reduceat(total, starts, axis=1) - before
    most = np.maximum.reduceat(total, starts, axis=1) - before
    ends = np.append(starts[1:], step.shape[1]) - 1
    parts = [total[:, ends] - before, np.minimum(least, 0.0), np.maximum(most, 0.0)]
    return np.stack(parts, axis=2).swapaxes(0, 1)


def _errors(samples: PathSamples, middle: Ints, turn: Array, q: Array) -> tuple[Array, Array]:
    """Return expected error and deflection (K, J) at samples (K,); zero on rapid moves."""
    cuts = np.flatnonzero(samples.cuts[middle])
    u95, moved = np.zeros(turn.shape), np.zeros(turn.shape)
    if not len(cuts):
        return u95, moved
    many = turn.shape[1]
    rows = np.repeat(middle[cuts], many)
    found = drive.expected_error(samples, rows, turn[cuts].ravel(), q[cuts].reshape(-1, 6))
    u95[cuts], moved[cuts] = (each.reshape(-1, many) for each in found)
    return u95, moved


def whole_circle(step: float) -> Array:
    """Return turns (J,) from −180° to below 180° in steps of `step` [rad]."""
    number = round(2.0 * np.pi / step)
    return np.asarray((np.arange(number) - number // 2) * (2.0 * np.pi / number))


def branch_of_start(samples: PathSamples) -> int:
    """Return the branch of `[start]` of the cell."""
    robot_in_cell = samples.robot_in_cell
    return int(kinematics.closed_form(robot_in_cell.robot).branch_of(robot_in_cell.cell.start_joints[None])[0])


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


def line_through(
    robot: RobotModel,
    found: TurnMap,
    keep: Keep,
    start: Array,
    *,
    turn_at_feed: bool,
    closed: bool,
) -> Line | Blocked:
    """Find the line through the map with the smallest expected error, under the limits of the joints.

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
