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

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics
from postproc.frames import FULL_TURN, MM_PER_M, RAD_PER_DEG, Array, inverse, wrap_angles
from postproc.kinematics.components import components, product
from postproc.placement import drive
from postproc.placement.bodies import Bodies
from postproc.placement.drive import WINDING_JOINTS, LeastMargins, Margins
from postproc.placement.samples import PathSamples
from postproc.program import PTP, Bools, Ints, distinct
from postproc.robot import RobotModel
from postproc.toolpath import cut_lengths, flange_from_tcp

_LEAST_BLOCK_LENGTH = 0.010
"""Shortest block of several motions [m]; the length of the path over `MOST_BLOCKS` if that is longer (assumed)."""
MOST_BLOCKS = 1000
"""Largest number of blocks of a path: time and memory of the map are in proportion to it."""
BINS_OF_BLOCK = 6
"""Largest number of bins of a block (assumed)."""
MOST_BINS = 2500
"""Largest number of bins of all blocks together: each is solved for every turn of the tool."""
SAMPLES_AT_ONCE = 4096
"""Number of samples that are solved together."""
MOST_POSES = 2500
"""Number of samples of a path at which bodies are compared with every turn; along a line, they are at all samples."""
_TURN_PER_MM = 1.0 * RAD_PER_DEG
"""Largest change of the turn at feed per millimetre [rad] (assumed)."""
_TURN_PER_SECOND = 30.0 * RAD_PER_DEG
"""Largest turning speed at feed [rad/s]: well below any wrist's."""
_RAPID_TURN_PER_MM = 3.0 * RAD_PER_DEG
"""Largest change per millimetre on rapid moves [rad]; those are slowed if a joint would be too fast (assumed)."""
_TURN_PER_BIN = 60.0 * RAD_PER_DEG
"""Largest change of the turn in one bin [rad]: then it is certain in which direction A4 and A6 turn."""
_TURN_PER_BLOCK = 170.0 * RAD_PER_DEG
"""Largest change of the turn in one block [rad]: a motion turns the tool by less than half a turn."""
_MARGIN_WEIGHT = 0.01
"""Weight of missing margin, as a share of the squared expected error: lines whose errors differ by less are alike."""
_TURN_COST = 0.003
"""Cost of turning by a radian, as a share of the cost of all cuts: of similar lines, the least turning one is best."""
_TURNING_PRICE = 5e-5
"""Expected error [m] that a cut must save to turn at `_TURN_PER_MM`, and less in proportion for a slower turn. Assumed:
nothing measures what a fast turn of the wrist costs on the part."""
_WRIST_SHARE = 0.1
"""Share of `_TURN_COST` that A4 or A6 costs for each radian of a joint interpolation, which cuts nothing (assumed)."""
_EASY_MARGIN = 15.0 * RAD_PER_DEG
"""Margin of joints and wrist beyond which more margin is worth little [rad]."""


class Blocks(Struct, frozen=True, eq=False):
    """Division of N samples into K bins and B blocks.

    :param first: (K,) first sample of each bin.
    :param block: (K,) block of each bin.
    :param share: (K,) share of the path of its block at the end of the bin, in (0, 1].
    :param cut_length: (K,) length of the cutting path in the bin [m], see `toolpath.cut_lengths`; 0 on rapid moves.
    :param is_start: (B,) True for blocks that do not continue the block before, so that any turn is possible there: the
        first one, and joint interpolations.
    :param is_at_feed: (B,) True for blocks at feed.
    :param length: (B,) path length [m].
    :param time: (B,) duration at the programmed feed [s]; 0 for rapid blocks, whose turn no time limits.
    :param motion: (B,) last motion of each block.
    """

    first: Ints
    block: Ints
    share: Array
    cut_length: Array
    is_start: Array
    is_at_feed: Array
    length: Array
    time: Array
    motion: Ints

    @classmethod
    def of(cls, samples: PathSamples) -> Blocks:
        """Return the path divided into blocks, and the blocks into bins.

        A run is the motions between two joint interpolations, or between changes from feed to rapid moves and back. A
        block is a piece of a run; its samples are divided evenly into bins.
        """
        program, segments, motion = samples.program, samples.segments, samples.sample.motion
        m = program.motions
        is_ptp = m.kind == PTP
        length = np.where(is_ptp, 0.0, segments.length)
        starts_run = np.concatenate([[True], is_ptp[1:] | is_ptp[:-1] | (m.rapid[1:] != m.rapid[:-1])])
        least_length = max(_LEAST_BLOCK_LENGTH, float(length.sum()) / MOST_BLOCKS)
        block_of_motion = _block_of_motion(length, starts_run, least_length)
        block_of_sample = block_of_motion[motion]
        distance = samples.sample.distance
        # `distance` counts from the start of each motion
        begins_motion = np.diff(motion, prepend=-1) != 0
        travel = np.where(is_ptp[motion], 0.0, np.where(begins_motion, distance, np.diff(distance, prepend=0.0)))
        first_samples, share = _bins(block_of_sample, travel)
        last_motions = np.append(np.flatnonzero(np.diff(block_of_motion)), len(block_of_motion) - 1)  # of the blocks
        first_motions = np.concatenate([[0], last_motions[:-1] + 1])
        # no force goes on from sample to sample: the whole path that leads to a sample then counts for it. Samples are
        # dense, and the forces at them are those of their motions
        force_continues = np.zeros(len(motion), dtype=bool)
        cut_length = cut_lengths(m, length, motion, samples.sample.t, force_continues)
        is_cut = ~m.rapid
        seconds = np.nan_to_num(length[is_cut] / m.feed[is_cut])  # a PTP at feed has no feed (NaN)
        return cls(
            first=first_samples,
            block=block_of_sample[first_samples],
            share=share,
            cut_length=np.add.reduceat(cut_length, first_samples),
            is_start=is_ptp[first_motions] | (first_motions == 0),
            is_at_feed=is_cut[first_motions],
            length=np.asarray(np.bincount(block_of_sample, travel), dtype=float),
            time=np.asarray(np.bincount(block_of_motion[is_cut], seconds, minlength=len(first_motions)), dtype=float),
            motion=last_motions,
        )

    @property
    def last(self) -> Ints:
        """(K − 1,) last sample of each bin except the last bin."""
        return self.first[1:] - 1

    def turn_of_motions(self, samples: PathSamples, knots: Array) -> Array:
        """Return the turn (M,) [rad] at the end of each motion.

        Within a block, the turn changes in proportion to the path.

        :param knots: (B,) turns at the ends of blocks [rad].
        """
        segments, m = samples.segments, samples.program.motions
        block = np.searchsorted(self.motion, np.arange(len(m)))  # `motion` are the last motions of blocks, ascending
        length = np.where(m.kind == PTP, 0.0, segments.length)
        total = self.length[block]
        path_length = np.cumsum(length)
        ends = path_length[self.motion]
        length_left = ends[block] - path_length
        share = np.where(total > 0.0, 1.0 - length_left / np.where(total > 0.0, total, 1.0), 1.0)
        start_turn = np.append(knots[0], knots[:-1])
        start_turn = np.where(self.is_start, knots, start_turn)
        return np.asarray(start_turn[block] + np.clip(share, 0.0, 1.0) * (knots - start_turn)[block])


def _bins(block: Ints, travel: Array) -> tuple[Ints, Array]:
    """Return the first sample of each bin (K,), and the share of the path of its block at the end of the bin (K,).

    The samples of a block are divided evenly into bins.

    :param block: (N,) block of each sample, ascending.
    :param travel: (N,) length of the path from the sample before [m].
    """
    count = np.bincount(block)  # samples of each block
    bin_count = np.minimum(count, min(BINS_OF_BLOCK, max(1, MOST_BINS // len(count))))
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    bin_in_block = (np.arange(len(block)) - start[block]) * bin_count[block] // count[block]
    first = np.flatnonzero((np.diff(bin_in_block, prepend=-1) != 0) | (np.diff(block, prepend=-1) != 0))
    last = np.append(first[1:], len(block)) - 1  # last sample of each bin
    length = np.bincount(block, travel)
    preceding_length = np.cumsum(length) - length
    block_length = length[block[last]]
    length_at_end = np.cumsum(travel)[last] - preceding_length[block[last]]
    # a block without length has its whole path at the end of any bin
    share = np.where(block_length > 0.0, length_at_end / np.where(block_length > 0.0, block_length, 1.0), 1.0)
    return first, np.clip(share, 0.0, 1.0)


def _block_of_motion(length: Array, starts_run: Array, step: float) -> Ints:
    """Return the block (M,) of each motion: runs are divided where another `step` of their length begins.

    :param length: (M,) lengths of the motions [m].
    :param starts_run: (M,) True for motions that begin a run.
    :param step: least length of a block [m].
    """
    run = np.cumsum(starts_run) - 1
    path_length = np.cumsum(length)
    begin = (path_length - length)[np.flatnonzero(starts_run)]
    # 1e-9: a motion that begins at a multiple of the step begins a block, also if rounding puts it just before
    number = np.floor((path_length - length - begin[run]) / step + 1e-9).astype(np.int64)
    change = starts_run | (np.diff(number, prepend=-1) != 0)
    return np.asarray(np.cumsum(change) - 1)


class TurnMap(Struct, frozen=True, eq=False):
    """The map: K bins of the path × J turns.

    :param blocks: the division of the path into bins.
    :param base: (N,) turn of each sample [rad], to which `offset` is added.
    :param offset: (J,) turns relative to `base` [rad], ascending in equal steps.
    :param margin: smallest margins in each cell (K, J).
    :param speed: (K, J) largest joint speed at the programmed feed with this turn, as a share of its limit.
    :param jump: (K, J) largest turn of a joint between samples [rad].
    :param rate: (K, J) largest joint speed per turn speed, as a share of its limit [s/rad].
    :param hit: (K, J) True where bodies come too close; None: not checked.
    :param q: (K, J, 6) joint angles at the end of each bin [rad].
    :param winding: (K, J, 2, 3) turns of A4 and A6 from the start of the bin [rad]: at its end, the least and the
        largest.
    :param u95: (K, J) expected error (95 %) in the middle of the bin [m]; NaN if the model states none.
    :param deflection: (K, J) deflection in the middle of the bin [m].
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

    @property
    def step(self) -> float:
        """Step of `offset` [rad]."""
        return float(self.offset[1] - self.offset[0])

    @property
    def base_at_ends(self) -> Array:
        """(K,) turn at the end of each bin, to which `offset` is added [rad]."""
        return np.asarray(self.base[np.append(self.blocks.first[1:], len(self.base)) - 1])

    def reasons(self, keep: LeastMargins) -> Ints:
        """Return why cells (K, J) are refused, see `drive.REASONS`."""
        return drive.reason(self.margin, self.speed, self.jump, keep, self.hit)

    @property
    def error(self) -> Array:
        """(K, J) expected error (95 %), or the deflection if the model states none [m]; zero on rapid moves."""
        return np.where(np.isnan(self.u95), self.deflection, self.u95)


def evaluate(
    samples: PathSamples,
    blocks: Blocks,
    branch: int,
    base: Array,
    offset: Array,
    bodies: Bodies | None = None,
) -> TurnMap:
    """Return the map of every sample at every turn.

    :param branch: branch of the inverse kinematics.
    :param base: (N,) turn of each sample [rad], and `offset` (J,) turns that are added to it [rad].
    :param bodies: bodies of the cell; None: collisions are not checked.
    """
    robot = samples.robot_in_cell.robot
    turn_map = _empty_map(blocks, base, offset, has_bodies=bodies is not None)
    bounds = np.append(blocks.first, len(samples))
    middle = (bounds[:-1] + bounds[1:] - 1) // 2
    middle_q = np.empty(turn_map.q.shape)  # joint angles at the samples in the middle of bins
    for chunk in _chunks(samples, blocks):
        for j in range(len(offset)):
            q, step = _solve(samples, chunk, base, offset[j : j + 1], branch)
            _fill(turn_map, j, samples, chunk, q, step)
            q = q[:, chunk.lead :]
            middle_q[chunk.bins, j] = q[:, middle[chunk.bins] - chunk.begin].T
            if turn_map.hit is not None and bodies is not None:
                turn_map.hit[chunk.bins, j] = np.logical_or.reduceat(_hits(bodies, chunk, q), chunk.starts)
    rate = turn_map.rate
    if len(offset) > 1:
        offset_step = offset[1] - offset[0]
        gap = wrap_angles(np.roll(turn_map.q, -1, axis=1) - turn_map.q)
        if (len(offset) + 0.5) * offset_step < FULL_TURN:
            gap[:, -1] = np.nan  # the turns are a part of the circle: no turn follows the last one
        rate = np.abs(gap / robot.speed).max(axis=2) / offset_step
        rate = np.fmax(rate, np.roll(rate, 1, axis=1))  # the larger one to both neighbours
    u95, deflection = _errors(samples, middle, base[middle][:, None] + offset, middle_q)
    return replace(turn_map, rate=rate, u95=u95, deflection=deflection)


def _empty_map(blocks: Blocks, base: Array, offset: Array, *, has_bodies: bool) -> TurnMap:
    """Return a map whose cells are still to be filled.

    :param has_bodies: True: no cell is hit yet; False: hits are not checked.
    """
    shape = (len(blocks.first), len(offset))
    return TurnMap(
        blocks,
        base,
        offset,
        margin=Margins(*(np.empty(shape) for _ in range(4))),
        speed=np.empty(shape),
        jump=np.empty(shape),
        rate=np.zeros(shape),
        hit=np.zeros(shape, dtype=bool) if has_bodies else None,
        q=np.empty((*shape, 6)),
        winding=np.empty((*shape, 2, 3)),
        u95=np.empty(shape),
        deflection=np.empty(shape),
    )


class _Chunk(NamedTuple):
    """Samples that are solved together: the n samples of k whole bins, and the sample before them if there is one.

    :param bins: bins of the map.
    :param begin: first sample of the bins.
    :param lead: 1 if `rows` begin with the sample before; 0 at the start of the path.
    :param rows: (lead + n,) samples.
    :param starts: (k,) first sample of each bin, and `ends` (k,) last sample, counted from `begin`.
    :param is_ptp: (n,) True on joint interpolations: steps from the sample before do not count.
    :param pose_rows: samples at which bodies are compared, counted from `begin`.
    :param pose: (3, 4, lead + n) tool frames in the root, without turn.
    :param tool: (3, 4, 1 or lead + n) flange in the tool frame; 1: one tool for all samples.
    :param joints: (lead + n, 6) programmed joint angles [rad]; NaN where poses are programmed.
    """

    bins: slice
    begin: int
    lead: int
    rows: Ints
    starts: Ints
    ends: Ints
    is_ptp: Bools
    pose_rows: Ints
    pose: Array
    tool: Array
    joints: Array

    @property
    def is_axis_target(self) -> Bools:
        """(lead + n,) True where joint angles are programmed."""
        return np.isfinite(self.joints[:, 0])


def _chunks(samples: PathSamples, blocks: Blocks) -> Iterator[_Chunk]:
    """Yield the samples of the path in chunks of whole bins, of at most `SAMPLES_AT_ONCE` samples or of one bin.

    A bin is a short stretch of the path, a row of the map.
    """
    motions, count = samples.program.motions, len(blocks.first)
    pose_rows = np.arange(0, len(samples), max(1, len(samples) // MOST_POSES))
    pose_rows = distinct(np.concatenate([pose_rows, blocks.last, [len(samples) - 1]]))
    is_ptp = motions.kind[samples.sample.motion] == PTP
    bounds = np.append(blocks.first, len(samples))
    tools = components(inverse(samples.program.tools))
    from_bin = 0
    while from_bin < count:
        # `bounds` are the first samples of bins, and the end of the path
        to_bin = int(np.searchsorted(bounds, bounds[from_bin] + SAMPLES_AT_ONCE, side="right")) - 1
        to_bin = min(max(to_bin, from_bin + 1), count)
        begin, end = int(bounds[from_bin]), int(bounds[to_bin])
        lead = int(begin > 0)
        rows = np.arange(begin - lead, end)
        motion = samples.sample.motion[rows]
        yield _Chunk(
            bins=slice(from_bin, to_bin),
            begin=begin,
            lead=lead,
            rows=rows,
            starts=blocks.first[from_bin:to_bin] - begin,
            ends=bounds[from_bin + 1 : to_bin + 1] - 1 - begin,
            is_ptp=is_ptp[begin:end],
            pose_rows=pose_rows[slice(*np.searchsorted(pose_rows, [begin, end]))] - begin,
            pose=_tool_frames(samples, rows),
            tool=tools if tools.shape[-1] == 1 else tools[..., motions.tool[motion]],
            joints=motions.joints[motion],
        )
        from_bin = to_bin


def _solve(samples: PathSamples, chunk: _Chunk, base: Array, offset: Array, branch: int) -> tuple[Array, Array]:
    """Return joint angles (6, lead + n) of a chunk at a turn, and their steps (6, n) from the sample before [rad].

    A chunk is n samples, with the sample before them (lead = 1) except at the start of the path (lead = 0). The first
    sample of the path has the step 0.

    :param base: (N,) turn of each sample [rad], and `offset` (1,) that is added to it [rad].
    :param branch: branch of the inverse kinematics.
    """
    has_base = base[chunk.rows].any()
    turn = samples.rotation(base[chunk.rows] + offset[0]) if has_base else samples.rotation(offset)
    tool_frame = [chunk.pose[:, k] for k in range(4)]
    turned_frame = np.zeros((3, 4, turn.shape[0]))  # in the tool frame
    turned_frame[:, :3] = np.moveaxis(turn, 0, -1)
    flange = product(tool_frame, product([turned_frame[:, k] for k in range(4)], chunk.tool))
    q = drive.solve(samples.robot_in_cell.robot, flange, branch)
    q[:, chunk.is_axis_target] = chunk.joints[chunk.is_axis_target].T
    step = np.diff(q, axis=1) if chunk.lead else np.diff(q, axis=1, prepend=q[:, :1])
    return q, step


def _fill(turn_map: TurnMap, j: int, samples: PathSamples, chunk: _Chunk, q: Array, step: Array) -> None:
    """Enter margins, speeds, jumps and windings of the joints on the bins of a chunk into column j of the map.

    :param j: the turn, a column of the map.
    :param q: (6, lead + n) joint angles with this turn [rad], and `step` (6, n) from the sample before [rad]; lead is 1
        if `q` begins with the sample before the chunk.
    """
    robot, bins, starts = samples.robot_in_cell.robot, chunk.bins, chunk.starts
    q = q[:, chunk.lead :]
    # A4 and A6 may wind; half a turn of another joint between samples is a jump to another solution, and refused
    flips = (np.abs(np.delete(step, WINDING_JOINTS, axis=0)) > np.pi).any(axis=0) & ~chunk.is_ptp
    step = np.nan_to_num(wrap_angles(step))
    step[:, chunk.is_ptp] = 0.0
    margin = drive.margins(robot, q)
    margin.joint[flips] = -1.0  # a negative margin is refused
    for name in Margins.__struct_fields__:
        values = getattr(margin, name)
        values[chunk.is_axis_target[chunk.lead :]] = np.inf  # programmed joint angles do not depend on the turn
        getattr(turn_map.margin, name)[bins, j] = np.minimum.reduceat(values, starts)
    time = samples.time[chunk.begin : chunk.begin + q.shape[1]]
    turn_map.speed[bins, j] = np.maximum.reduceat(drive.largest_speed_share(robot, step, time), starts)
    turn_map.jump[bins, j] = np.maximum.reduceat(np.abs(step).max(axis=0), starts)
    turn_map.q[bins, j] = q[:, chunk.ends].T
    turn_map.winding[bins, j] = _windings(step[list(WINDING_JOINTS)], starts)


def _hits(bodies: Bodies, chunk: _Chunk, q: Array) -> Bools:
    """Return True for samples (n,) of a chunk at which bodies come too close, for joint angles (6, n) [rad]."""
    rows = chunk.pose_rows
    is_hit = np.zeros(q.shape[1], dtype=bool)
    samples = chunk.rows[chunk.lead :][rows]
    is_hit[rows] = bodies.is_hit_along_path(q[:, rows].T, samples, chunk.is_ptp[rows], between_samples=False)
    return is_hit


def _tool_frames(samples: PathSamples, rows: Ints) -> Array:
    """Return the tool frames (3, 4, n) of samples in the root, without turn."""
    motion, t = samples.sample.motion[rows], samples.sample.t[rows]
    pose = samples.sample.pose[rows]
    flange = flange_from_tcp(samples.program, motion, pose, t)
    tools = samples.program.tools
    tool = tools[0] if len(tools) == 1 else tools[samples.program.motions.tool[motion]]
    return components(flange @ tool)


def _windings(step: Array, starts: Ints) -> Array:
    """Return the turns (k, 2, 3) of two joints from the start of each bin: at its end, the least and the largest.

    :param step: (2, n) steps from the sample before.
    :param starts: (k,) first sample of each bin; the running sum before it is subtracted.
    """
    total = np.cumsum(step, axis=1)
    bin_start = np.concatenate([np.zeros((2, 1)), total[:, starts[1:] - 1]], axis=1)
    lowest_turn = np.minimum.reduceat(total, starts, axis=1) - bin_start
    highest_turn = np.maximum.reduceat(total, starts, axis=1) - bin_start
    ends = np.append(starts[1:], step.shape[1]) - 1
    parts = [total[:, ends] - bin_start, np.minimum(lowest_turn, 0.0), np.maximum(highest_turn, 0.0)]
    return np.stack([part.T for part in parts], axis=2)


def _errors(samples: PathSamples, middle: Ints, turn: Array, q: Array) -> tuple[Array, Array]:
    """Return the expected error (95 %) (K, J) and the deflection (K, J) [m] at a sample of each bin; 0 on rapid moves.

    :param middle: (K,) the samples.
    :param turn: (K, J) turns of the tool at these samples [rad], and `q` (K, J, 6) joint angles [rad].
    """
    cut_bins = np.flatnonzero(samples.is_at_feed[middle])
    u95, deflection = np.zeros(turn.shape), np.zeros(turn.shape)
    if not len(cut_bins):
        return u95, deflection
    turn_count = turn.shape[1]
    rows = np.repeat(middle[cut_bins], turn_count)
    errors = drive.expected_error(samples, rows, turn[cut_bins].ravel(), q[cut_bins].reshape(len(rows), 6))
    u95[cut_bins], deflection[cut_bins] = (values.reshape(len(cut_bins), turn_count) for values in errors)
    return u95, deflection


def turns_of_circle(step: float) -> Array:
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
    :param cost: mean of the squared expected error over the cuts, as a share of that with the least error of each bin,
        and the costs of turning and of missing margin.
    """

    knots: Array
    cost: float


class BlockedMap(Struct, frozen=True):
    """No line passes through the map; `block` is the first block that no line passes."""

    block: int


def line_through(
    robot: RobotModel,
    turn_map: TurnMap,
    keep: LeastMargins,
    start: Array,
    *,
    turn_at_feed: bool,
    is_circle: bool,
) -> Line | BlockedMap:
    """Return the line through the map with the least cost, under the limits of the joints.

    :param keep: margins to keep.
    :param start: (6,) joint angles before the program [rad], from which the whole turns of A4 and A6 count.
    :param turn_at_feed: whether the turn may change on cuts; else on rapid moves only.
    :param is_circle: whether the map is a whole circle of turns, so that its first column follows the last.
    :returns: the line, or the first block that no line passes.
    """
    is_forbidden = drive.is_refused(turn_map.reasons(keep))
    lowest, highest = _limits(robot, keep)
    search = _LineSearch(
        turn_map=turn_map,
        is_forbidden=is_forbidden,
        costs=_costs(turn_map, is_forbidden),
        start=np.asarray(start)[list(WINDING_JOINTS)],
        lowest=lowest,
        highest=highest,
        turn_at_feed=turn_at_feed,
        is_circle=is_circle,
    )
    blocks = turn_map.blocks
    bounds = np.searchsorted(blocks.block, np.arange(len(blocks.length) + 1)).tolist()  # first bin of each block
    cost, origins = np.full((3, 3, len(turn_map.offset)), np.inf), list[_Origins]()
    for b, bins in enumerate(itertools.starmap(slice, itertools.pairwise(bounds))):
        cost, origin = search.begin(bins, cost) if blocks.is_start[b] else search.advance(b, bins, cost)
        origins.append(origin)
        if not np.isfinite(cost).any():
            return BlockedMap(b)
    return _line_to_cheapest_state(turn_map, cost, origins)


class _Costs(NamedTuple):
    """Costs of bins (K,) and cells (K, J).

    :param cell: (K, J) cost of a cell: its squared error, as a share of the sum of the least ones, and missing margin.
    :param error: (K, J) expected error [m]; 0 for refused cells.
    :param square_error_cost: (K,) cost of a squared error of 1 m² in a bin.
    """

    cell: Array
    error: Array
    square_error_cost: Array

    def cost_of_increase(self, k: int, columns: Ints, increase: Array) -> Array:
        """Return the cost (J, D) of an increase p of the errors e in a bin, from e² to (e + p)².

        It is computed for a line to each of J columns at the end of the bin, with each of D changes of the turn.

        :param k: the bin.
        :param columns: (J, D) column of the map that each of these lines crosses in the bin.
        :param increase: (D,) increase p of the error for each change of the turn [m].
        """
        return np.asarray(self.square_error_cost[k] * (2.0 * self.error[k][columns] + increase) * increase)


def _costs(turn_map: TurnMap, is_forbidden: Bools) -> _Costs:
    """Return the costs of a map; without forces, errors cost nothing.

    :param is_forbidden: (K, J) True for refused cells: their errors do not count.
    """
    blocks = turn_map.blocks
    sample_count = np.diff(np.append(blocks.first, len(turn_map.base)))  # of each bin
    error = np.where(is_forbidden | np.isnan(turn_map.error), np.inf, turn_map.error)
    total = float(blocks.cut_length @ np.nan_to_num(error.min(axis=1), posinf=0.0) ** 2)
    square_error_cost = blocks.cut_length / total if total > 0.0 else np.zeros(len(sample_count))
    error[~np.isfinite(error)] = 0.0
    margin = np.minimum(turn_map.margin.joint, turn_map.margin.wrist)
    with np.errstate(over="ignore"):
        margin_price = np.exp(
            -np.nan_to_num(margin, posinf=1e3) / _EASY_MARGIN
        )  # 0 on axis targets, whose margin is infinite
    sample_share = (sample_count / sample_count.sum())[:, None]
    cell_cost = square_error_cost[:, None] * error**2 + _MARGIN_WEIGHT * margin_price * sample_share
    return _Costs(cell_cost, error, square_error_cost)


def _limits(robot: RobotModel, keep: LeastMargins) -> tuple[Array, Array]:
    """Return the least angles (2,) and the largest angles (2,) of A4 and A6 [rad] with the margin to keep."""
    joints = list(WINDING_JOINTS)
    return robot.lower[joints] + keep.joint, robot.upper[joints] - keep.joint


class _Origins(NamedTuple):
    """For each state (3, 3, J) at the end of a block, the state at its start from which it is reached at least cost.

    A state is the number of whole turns of A4 and of A6 (−1, 0 or 1, as index 0, 1 or 2) and a column of the map.

    :param turns4: (3, 3, J) index of the whole turns of A4 at the start of the block; `turns6` (3, 3, J): of A6.
    :param column: (3, 3, J) column of the map at the start of the block.
    :param step: (3, 3, J) change of the turn on the block, in steps of the map; None: the block does not continue the
        block before, and has one turn.
    """

    turns4: Ints
    turns6: Ints
    column: Ints
    step: Ints | None


class _State(NamedTuple):
    """A state at the start of a block.

    :param indices: index of the whole turns of A4, of A6, and column of the map, as in `_Origins`.
    :param angle: (2,) angles of A4 and A6 [rad].
    :param cost: cost of the cheapest line to this state.
    """

    indices: tuple[int, int, int]
    angle: Array
    cost: float


class _Changes(NamedTuple):
    """Changes of the turn on a block.

    :param step: (D,) changes in steps of the map; 0 is one of them.
    :param size: (D,) absolute changes of the turn [rad]: these, and the change of `base` along a column of the map.
    """

    step: Ints
    size: Array


class _Crossing(NamedTuple):
    """Crossings of a block: J columns of the map at its end × D changes of the turn.

    :param source: (J, D) column at the start of the block.
    :param price: (J, D) cost; infinite where the crossing is blocked.
    :param extra_turns: (J, D, 2) whole turns of A4 and A6 at the end, relative to the angles of the map there.
    :param low_angle: (J, D, 2) least angles of A4 and A6 on the crossing, if it starts at the angles of the map [rad].
    :param high_angle: (J, D, 2) largest angles.
    """

    source: Ints
    price: Array
    extra_turns: Ints
    low_angle: Array
    high_angle: Array


class _WristAngles(NamedTuple):
    """Angles of A4 and A6 on J × D crossings of a block (J, D, 2) [rad] that start at the angles of the map.

    :param low: the least angles, `high` the largest ones, and `end` the angles at the end.
    """

    low: Array
    high: Array
    end: Array


class _LineSearch(Struct, frozen=True, eq=False):
    """The search of a line through a map of K bins of the path and J turns of the tool, block (of bins) by block.

    :param turn_map: the map.
    :param is_forbidden: (K, J) True for cells that are refused.
    :param costs: costs of the cells.
    :param start: (2,) angles of A4 and A6 before the program [rad].
    :param lowest: (2,) least permitted angles of A4 and A6 [rad]; `highest` (2,) the largest.
    :param turn_at_feed: whether the turn may change on cuts.
    :param is_circle: whether the map is a whole circle of turns.
    """

    turn_map: TurnMap
    is_forbidden: Bools
    costs: _Costs
    start: Array
    lowest: Array
    highest: Array
    turn_at_feed: bool
    is_circle: bool

    def begin(self, bins: slice, cost: Array) -> tuple[Array, _Origins]:
        """Return costs (3, 3, J) and origins of states at the end of a block that does not continue the block before.

        It may have any turn. The joint interpolation to it turns A4 and A6 by at most half a turn from where they are.

        :param bins: bins of the block.
        :param cost: (3, 3, J) costs of the states before the block; not used for the first block of the path.
        """
        end_angle = self.turn_map.q[bins.stop - 1][:, WINDING_JOINTS]  # (J, 2)
        is_free = ~self.is_forbidden[bins].any(axis=0)
        cell_cost = self.costs.cell[bins].sum(axis=0)
        next_cost = np.full(cost.shape, np.inf)
        turns4, turns6, column = (np.zeros(cost.shape, dtype=np.int64) for _ in range(3))
        for state in self._states(bins, cost):
            turns = np.rint((state.angle - end_angle) / FULL_TURN)
            angle = end_angle + FULL_TURN * turns
            fits = is_free & self._is_permitted(angle, angle) & (np.abs(turns) <= 1).all(axis=1)
            value = state.cost + cell_cost + _TURN_COST * _WRIST_SHARE * np.abs(angle - state.angle).max(axis=1)
            rows = np.flatnonzero(fits)
            index4, index6 = turns[rows].T.astype(np.int64) + 1  # −1, 0, 1 whole turns are the indices 0, 1, 2
            is_cheaper = value[rows] < next_cost[index4, index6, rows]
            cheaper_states = index4[is_cheaper], index6[is_cheaper], rows[is_cheaper]
            next_cost[cheaper_states] = value[rows[is_cheaper]]
            turns4[cheaper_states], turns6[cheaper_states], column[cheaper_states] = state.indices
        return next_cost, _Origins(turns4, turns6, column, None)

    def _states(self, bins: slice, cost: Array) -> Iterator[_State]:
        """Yield the cheapest state at the end of the previous block for each column of the map, if one can be reached.

        The first block of the path has one state before it: the start of the program, with cost 0.

        :param bins: bins of the block that begins.
        :param cost: (3, 3, J) costs of the states at the end of the previous block, by whole turns −1, 0 and 1 of A4
            and of A6 and by column; infinite where a state cannot be reached.
        """
        if bins.start == 0:
            yield _State((0, 0, 0), angle=self.start, cost=0.0)  # no state is before it: the indices are not read
            return
        angle = self.turn_map.q[bins.start - 1][:, WINDING_JOINTS]
        for j in range(cost.shape[2]):
            index4, index6 = np.unravel_index(int(cost[:, :, j].argmin()), (3, 3))
            least = float(cost[index4, index6, j])
            if np.isfinite(least):
                turns = np.array([index4 - 1.0, index6 - 1.0])
                yield _State((int(index4), int(index6), j), angle[j] + FULL_TURN * turns, least)

    def _is_permitted(self, low_angle: Array, high_angle: Array) -> Bools:
        """Return True (...,) where least and largest angles (..., 2) of A4 and A6 [rad] are within the limits."""
        return np.asarray(((low_angle >= self.lowest) & (high_angle <= self.highest)).all(axis=-1))

    def advance(self, b: int, bins: slice, cost: Array) -> tuple[Array, _Origins]:
        """Return costs (3, 3, J) and origins of states at the end of a block that continues the block before.

        :param b: the block, and `bins` its bins.
        :param cost: (3, 3, J) costs of the states at its start.
        """
        changes = self._changes(b, bins)
        crossing = self.crossing(b, bins, changes)
        next_cost = np.empty(cost.shape)
        turns4, turns6, column, step = (np.empty(cost.shape, dtype=np.int64) for _ in range(4))
        columns = np.arange(cost.shape[2])
        for n4, n6 in itertools.product(range(3), repeat=2):
            # whole turns at the start that lead to n4 and n6 at the end
            start4, start6 = n4 - crossing.extra_turns[..., 0], n6 - crossing.extra_turns[..., 1]
            index4, index6 = np.clip(start4, 0, 2), np.clip(start6, 0, 2)
            turns = FULL_TURN * (np.stack([index4, index6], axis=2) - 1)
            is_allowed = (start4 == index4) & (start6 == index6)
            is_allowed &= self._is_permitted(crossing.low_angle + turns, crossing.high_angle + turns)
            value = np.where(is_allowed, cost[index4, index6, crossing.source] + crossing.price, np.inf)
            best = columns, value.argmin(axis=1)
            next_cost[n4, n6], column[n4, n6], step[n4, n6] = value[best], crossing.source[best], changes.step[best[1]]
            turns4[n4, n6], turns6[n4, n6] = index4[best], index6[best]
        return next_cost, _Origins(turns4, turns6, column, step)

    def _changes(self, b: int, bins: slice) -> _Changes:
        """Return the permitted changes of the turn on a block; one along a column of the map is always among them.

        :param b: the block, and `bins` its bins.
        """
        turn_map, blocks = self.turn_map, self.turn_map.blocks
        step, turn_count = turn_map.step, len(turn_map.offset)
        base = turn_map.base_at_ends
        base_change = float(base[bins.stop - 1] - base[bins.start - 1])
        millimetres = float(blocks.length[b]) * MM_PER_M
        if not blocks.is_at_feed[b]:
            limit = _RAPID_TURN_PER_MM * millimetres
        elif self.turn_at_feed:
            limit = min(_TURN_PER_MM * millimetres, _TURN_PER_SECOND * float(blocks.time[b]))
        else:
            return _Changes(np.array([0]), np.abs(np.array([0]) * step + base_change))
        limit = min(limit, _TURN_PER_BIN * (bins.stop - bins.start), _TURN_PER_BLOCK)
        first = min(int(np.ceil((-limit - base_change) / step - _COLUMN_TOLERANCE)), 0)
        last = max(int(np.floor((limit - base_change) / step + _COLUMN_TOLERANCE)), 0)
        steps = np.arange(max(first, 1 - turn_count), min(last, turn_count - 1) + 1)
        return _Changes(steps, np.abs(steps * step + base_change))

    def crossing(self, b: int, bins: slice, changes: _Changes) -> _Crossing:
        """Return the crossings of a block with some changes of the turn; see `advance` for `b` and `bins`."""
        turn_map, blocks, steps = self.turn_map, self.turn_map.blocks, changes.step
        turn_count = len(turn_map.offset)
        source = np.arange(turn_count)[:, None] - steps  # of the columns at the end, as rows
        is_blocked = np.zeros(source.shape, dtype=bool) if self.is_circle else (source < 0) | (source >= turn_count)
        source = source % turn_count
        share = np.append(0.0, blocks.share[bins])  # of the change, at the start and at the end of each bin
        columns = [_nearest_columns(source + steps * end_share, turn_count) for end_share in share]
        length = max(float(blocks.length[b]) * MM_PER_M, 1.0)
        turning_price = _TURNING_PRICE * changes.size / (_TURN_PER_MM * length)
        turning = _turning_speed(turn_map, b, steps)
        price = np.zeros(source.shape)
        for n, k in enumerate(range(bins.start, bins.stop)):
            is_blocked |= _crosses_forbidden(self.is_forbidden[k], source + steps * share[n : n + 2, None, None])
            middle_columns = _nearest_columns(source + steps * (0.5 * (share[n] + share[n + 1])), turn_count)
            price += self.costs.cell[k][middle_columns] + self.costs.cost_of_increase(k, middle_columns, turning_price)
            if blocks.is_at_feed[b] and len(steps) > 1:
                end_columns = columns[n + 1]
                is_blocked |= ~(turn_map.speed[k][end_columns] + turn_map.rate[k][end_columns] * turning <= 1.0)
        angles = self._wrist_angles(bins, columns)
        with np.errstate(invalid="ignore"):
            extra_turns = np.rint((angles.end - turn_map.q[bins.stop - 1][:, None, WINDING_JOINTS]) / FULL_TURN)
        is_blocked |= np.isnan(extra_turns).any(axis=2)
        price = price + _TURN_COST * changes.size * (1.0 + changes.size / (_TURN_PER_MM * length))
        price = np.where(is_blocked, np.inf, price)
        return _Crossing(source, price, np.nan_to_num(extra_turns).astype(np.int64), angles.low, angles.high)

    def _wrist_angles(self, bins: slice, columns: Sequence[Ints]) -> _WristAngles:
        """Return the angles of A4 and A6 on crossings of a block.

        :param bins: bins of the block.
        :param columns: (J, D) columns at the start of the block, then at the end of each bin.
        """
        turn_map = self.turn_map
        angle = turn_map.q[bins.start - 1][columns[0]][..., WINDING_JOINTS]
        low, high = angle.copy(), angle.copy()
        for k, (start_columns, end_columns) in zip(
            range(bins.start, bins.stop), itertools.pairwise(columns), strict=True
        ):
            # along the column at the start of the bin
            end_turn, least_turn, largest_turn = np.moveaxis(turn_map.winding[k][start_columns], -1, 0)
            low, high = np.minimum(low, angle + least_turn), np.maximum(high, angle + largest_turn)
            angle = angle + end_turn
            # then, at the end of the bin, from that column to the column at the end
            end_q = turn_map.q[k]
            angle = angle + wrap_angles(
                end_q[end_columns][..., WINDING_JOINTS] - end_q[start_columns][..., WINDING_JOINTS]
            )
            low, high = np.minimum(low, angle), np.maximum(high, angle)
        return _WristAngles(low, high, angle)


def _turning_speed(turn_map: TurnMap, b: int, steps: Ints) -> Array:
    """Return the speed (D,) [rad/s] with which changes of the turn, in steps of the map, turn the tool on a block.

    It is 0 on rapid blocks, whose time is not known.
    """
    time = float(turn_map.blocks.time[b])
    if not time > 0.0:
        return np.zeros(len(steps))
    return np.asarray(np.abs(steps) * turn_map.step / time)


def _crosses_forbidden(is_forbidden: Bools, columns: Array) -> Bools:
    """Return True for crossings (J, D) of a bin that touch refused columns.

    :param is_forbidden: (J,) True for refused columns of the bin.
    :param columns: (2, J, D) position at the start and at the end of the bin, in columns; it need not be whole, and may
        be beyond the map by less than its size.
    """
    # three copies of the map, as crossings may be beyond it to both sides; differences of the running sum are counts
    forbidden_count = np.concatenate([[0], np.cumsum(np.tile(is_forbidden, 3))])
    lowest, highest = np.sort(columns, axis=0)
    first = np.floor(lowest + _COLUMN_TOLERANCE).astype(np.int64)
    last = np.ceil(highest - _COLUMN_TOLERANCE).astype(np.int64)
    return np.asarray(forbidden_count[last + len(is_forbidden) + 1] > forbidden_count[first + len(is_forbidden)])


def _nearest_columns(position: Array, count: int) -> Ints:
    """Return the columns nearest to positions, which need not be whole, on a circle of `count` columns."""
    return np.asarray(np.rint(position).astype(np.int64) % count)


_COLUMN_TOLERANCE = 1e-9
"""Positions that are this near to a column [columns] are on it, but for rounding."""


def _line_to_cheapest_state(turn_map: TurnMap, cost: Array, origins: Sequence[_Origins]) -> Line:
    """Return the line that ends in the state that costs least.

    It is followed back from the last block to the first, then its turns are summed forwards.

    :param cost: (3, 3, J) costs of the states at the end of the path: index of the whole turns of A4, of A6, and column
        of the map, see `_Origins`.
    :param origins: for each block, the states at its start from which the states at its end are reached.
    """
    index4, index6, column = (int(index) for index in np.unravel_index(int(np.argmin(cost)), cost.shape))
    columns_and_steps: list[tuple[int, int | None]] = []  # at the end of each block, from the last to the first
    for origin in reversed(origins):
        state = index4, index6, column
        columns_and_steps.append((column, None if origin.step is None else int(origin.step[state])))
        index4, index6, column = int(origin.turns4[state]), int(origin.turns6[state]), int(origin.column[state])
    offsets, offset = [], 0.0  # of the turn from `turn_map.base` at the end of each block [rad]
    for column, step in reversed(columns_and_steps):
        # steps are summed, not looked up: on a circle the turn continues beyond the last column
        offset = float(turn_map.offset[column]) if step is None else offset + step * turn_map.step
        offsets.append(offset)
    block_of_bin = turn_map.blocks.block
    last_bins = np.append(np.flatnonzero(np.diff(block_of_bin)), len(block_of_bin) - 1)  # of each block
    return Line(np.array(offsets) + turn_map.base_at_ends[last_bins], float(cost.min()))
