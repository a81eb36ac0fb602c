"""The map path × turn about the tool axis: what can be driven, and the expected error.

The path is divided into blocks, each with one turn of the tool at its end, between which the turn changes in proportion
to the path. A block is a motion, or a run of short ones; a block is divided into bins, the rows of the map. Every
sample of the path is solved for every turn; of a bin the worst sample counts.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.frames import Array, inverse
from postproc.kinematics.components import components, product
from postproc.placement import drive
from postproc.placement.bodies import Bodies
from postproc.placement.drive import WINDING, Keep, Margins
from postproc.placement.samples import PathSamples
from postproc.program import PTP, Bools, Ints
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
    setting = samples.robot_in_cell
    return int(kinematics.closed_form(setting.robot).branch_of(setting.cell.start_joints[None])[0])
