"""The turn of the tool about its axis and the joint angles at the start: chosen where a cell leaves them open.

A program starts at its first target, on the branch with the most margin. The margin of a branch is the smallest along
the program: distance of each joint to its limits, of A5 from where A4 and A6 are in line, of A3 from the stretched arm.
Where the cell leaves the turn of the tool open, the best turn counts at each sample. Branches on which bodies of
[collision] come too close are taken only if there is no other.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.decimals import without_negative_zero
from postproc.errors import Issue, ProgramError
from postproc.forces import ForceSource
from postproc.frames import DEG_PER_RAD, MM_PER_M, RAD_PER_DEG, Array, norm, rotation_from_vector, wrap_angles
from postproc.kinematics import UnreachableError
from postproc.kinematics.components import components
from postproc.placement import drive, turn_map
from postproc.placement.bodies import Bodies
from postproc.placement.drive import BARE_MARGINS, REASONS, LeastMargins
from postproc.placement.samples import SPINDLE_AXES, PathSamples
from postproc.placement.turn_map import BlockedMap, Blocks, Line, TurnMap
from postproc.poses import Poses
from postproc.program import PTP, Bools, Ints, Program, distinct, read_only
from postproc.under_load import RobotInCell

Mode = Literal["best", "path"]
_COARSE_STEP = 5.0 * RAD_PER_DEG
"""Step of the turns in the coarse map, of the whole circle; `_FINE_OFFSETS` covers a step to both sides (assumed)."""
_TURN_TOLERANCE = 1e-6
"""Turns [rad] and lengths [m] below this are zero, but for rounding."""
_TILT_PROBLEM = (
    'redundancy = "path": this move tilts the tool, and turning it about its axis on the way would make it lean. Set '
    '[gcode] redundancy = "best".'
)
NO_CLEARANCE = "Collisions do not count in this choice: the cell has no [collision]."
_MARGIN_PRICE = 5e-5
"""Expected error [m] that a turn along the path must save to have no margin instead of a large one; it falls by the
factor e for each `_MARGIN_SCALE` of margin. Assumed: errors of mastering and of the place of the part reduce the
margin."""
_MARGIN_SCALE = 10.0 * RAD_PER_DEG
"""Margin by which its price falls by the factor e [rad] (assumed): three times this margin costs a twentieth."""
_MARGIN_LEVELS = tuple(np.array([30.0, 20.0, 12.0, 7.0, 4.0]) * RAD_PER_DEG)
"""Margins of joints, wrist and elbow with which a turn along the path is tried, in addition to the least margins."""
_ROUNDS = 8
"""Largest number of times that a line with collisions which the map did not show is replaced (assumed)."""
_MAX_ROWS = 8
"""Largest number of samples of a bin at which bodies are compared for an error message."""
_FINE_OFFSETS = np.arange(-6.0, 7.0) * RAD_PER_DEG
"""Offsets of turns in the fine map around a line [rad]: a step of the coarse map to both sides, and 1° more."""
_NO_OFFSET = np.zeros(1)
"""Offset of a map of one turn."""
_MAX_SAMPLES = 4000
"""Largest number of samples of a program by which branches are judged."""
_BRANCHES = 8
"""Number of branches: shoulder, elbow and wrist have two solutions each."""
_LARGE_ANGLE = 100.0
"""Stands for a pose that is not solved [rad]: beyond any A4 and A6, so that solved branches come first."""
_MAX_POSES = 120
"""Largest number of samples at which bodies are compared to judge branches."""
_DECIMALS = 4
"""Decimals of the joint angles of a chosen start [deg]."""
_NO_BRANCH_TEXT = "the cell has no [start], and no branch of the arm reaches the first target of the program"
_NO_STATUS_TEXT = (
    "the cell has no [start], and the first target of the program is out of reach with the status S that it states"
)


class Turn(Struct, frozen=True, eq=False):
    """The turn of the tool along a program, and the map that it was chosen on.

    :param mode: "best": one turn for each operation; "path": the turn changes along the path.
    :param map: reasons to refuse and errors by path and turn; its turns are added to `constant`.
    :param keep: margins that the line keeps.
    :param constant: `redundancy_deg` of the cell [rad].
    :param knots: (B,) chosen turn at the end of each block, without `constant` [rad]; continuous along the path.
    :param of_motion: (M,) chosen turn at the end of each motion, without `constant` [rad].
    """

    mode: Mode
    map: TurnMap
    keep: LeastMargins
    constant: float
    knots: Array
    of_motion: Array

    def range_deg(self) -> tuple[float, float]:
        """Return the smallest and the largest turn of the program [deg], as `redundancy_deg` counts it."""
        turn = (self.of_motion + self.constant) * DEG_PER_RAD
        return float(turn.min()), float(turn.max())


def turn_program(program: Program, axis: str, turn: Array) -> Program:
    """Return a program with its tool turned about its axis.

    Targets that state joint angles are not changed.

    :param axis: axis of the tool frame that points from the spindle to the tip.
    :param turn: (M,) turn at the end of each motion [rad], about the direction from the tip to the spindle, continuous
        along the path: between the ends it changes evenly with the place.
    """
    m = program.motions
    rotation = rotation_from_vector(-turn[:, None] * np.array(SPINDLE_AXES[axis]))
    rotation[np.isfinite(m.joints[:, 0])] = np.eye(3)
    target = Poses(m.target.position, m.target.rotation @ rotation)
    swivel = program.swivel
    if swivel is not None:
        begin = np.append(turn[:1], turn[:-1])
        swivel = replace(swivel, spin=np.stack([begin, turn], axis=1))
    return read_only(replace(program, motions=replace(m, target=target), swivel=swivel))


class TurnedProgram(NamedTuple):
    """A program with its tool turned about its axis.

    :param program: the program; unchanged if no turn was chosen.
    :param turn: the chosen turn; None: no turn was chosen.
    :param issues: issues of the choice; an error if no turn can be driven.
    """

    program: Program
    turn: Turn | None
    issues: tuple[Issue, ...]


def in_chosen_turn(program: Program, robot_in_cell: RobotInCell, source: ForceSource | None) -> TurnedProgram:
    """Return a program with its tool turned about its axis as `[gcode] redundancy` of the cell states.

    A robot program states its orientations, and with `redundancy = "constant"` a program has its turn when it is read:
    both are returned unchanged. A program that cannot be driven with any turn is returned unchanged, with an error.

    :param source: forces in addition to those of the program; None: there are none.

    :raises ForceError: the forces do not match the motions.
    :raises CellError: a body of [collision] cannot be read.
    """
    cell = robot_in_cell.cell
    if cell.gcode.redundancy == "constant" or program.keeps_text:
        return TurnedProgram(program, None, ())
    turn, issues = choose_turn(program, robot_in_cell, source, cell.gcode.redundancy)
    turned_program = program if turn is None else turn_program(program, cell.tool.axis, turn.of_motion)
    return TurnedProgram(turned_program, turn, issues)


def choose_turn(
    program: Program, robot_in_cell: RobotInCell, source: ForceSource | None, mode: Mode
) -> tuple[Turn | None, tuple[Issue, ...]]:
    """Return the chosen turn of the tool, and issues; with [collision] in the cell, no bodies come too close with it.

    :param source: forces in addition to those of the program; None: there are none.
    :returns: the turn, and a note on it; or None, and the error that says why no turn can be driven.
    :raises ForceError: the forces do not match the motions.
    :raises CellError: a body of [collision] cannot be read.
    """
    samples = PathSamples.of(program, robot_in_cell, source)
    if mode == "path" and program.swivel is None and (tilts := _tilting_motions(samples)).any():
        return None, (program.motions.issue("error", "redundancy", _TILT_PROBLEM, np.flatnonzero(tilts)),)
    blocks = Blocks.of(samples)
    branch = turn_map.branch_of_start(samples)
    table = robot_in_cell.cell.collision
    bodies = None if table is None else Bodies(samples, table.clearance_mm)
    coarse_map = turn_map.evaluate(
        samples, blocks, branch, np.zeros(len(samples)), turn_map.turns_of_circle(_COARSE_STEP), bodies
    )
    blocked_map: BlockedMap | None = None
    wide_margins = LeastMargins() if mode == "best" else _margins_of_least_cost(samples, coarse_map, branch)
    for keep in (wide_margins, BARE_MARGINS):
        line, coarse_map = _free_line(samples, coarse_map, branch, keep, mode, bodies)
        if isinstance(line, BlockedMap):  # of two blocked maps, the one whose lines lead farther is reported
            blocked_map = blocked_map if blocked_map is not None and blocked_map.block > line.block else line
            continue
        if keep is not BARE_MARGINS and _today_is_as_good(samples, coarse_map, branch, keep, line, bodies):
            line = Line(np.zeros(len(line.knots)), line.cost)
        of_motion = blocks.turn_of_motions(samples, line.knots)
        constant = robot_in_cell.cell.gcode.redundancy_deg * RAD_PER_DEG
        turn = Turn(
            mode, coarse_map, BARE_MARGINS if keep is BARE_MARGINS else LeastMargins(), constant, line.knots, of_motion
        )
        return turn, (_turn_issue(turn),)
    assert blocked_map is not None
    return None, (_blocked_error(samples, coarse_map, blocked_map, mode, branch, bodies),)


def _margins_of_least_cost(samples: PathSamples, coarse_map: TurnMap, branch: int) -> LeastMargins:
    """Return the margins with which a turn along the path costs least: its expected error and the price of its margin.

    The least margins are returned if no line keeps any of the tried margins.
    """
    best, least_cost = LeastMargins(), np.inf
    for keep in (LeastMargins(), *(LeastMargins(level, level, level) for level in _MARGIN_LEVELS)):
        line = _cheapest_line(samples, coarse_map, keep, "path", is_circle=True)
        if isinstance(line, BlockedMap):
            continue
        error, margin = _error_and_margin(samples, coarse_map.blocks, branch, line)
        price = _MARGIN_PRICE * float(np.exp(-margin / _MARGIN_SCALE))
        if error + price < least_cost:
            best, least_cost = keep, error + price
    return best


def _error_and_margin(samples: PathSamples, blocks: Blocks, branch: int, line: Line) -> tuple[float, float]:
    """Return the RMS of the expected error along the cuts of a line [m], and its least margin [rad].

    The RMS is 0 without cuts; bins without equilibrium count as 0. The margin is that of joints, wrist and elbow.

    :param branch: branch of the inverse kinematics.
    """
    turns = _sample_turns(samples, blocks, line.knots)
    line_map = turn_map.evaluate(samples, blocks, branch, turns, _NO_OFFSET)  # a map of one column
    error = np.nan_to_num(line_map.error[:, 0])
    margins = (line_map.margin.joint, line_map.margin.wrist, line_map.margin.elbow)
    total = float(blocks.cut_length.sum())
    rms = float(np.sqrt(blocks.cut_length @ error**2 / total)) if total > 0.0 else 0.0  # 0 without cuts
    return rms, min(float(values.min()) for values in margins)


def _free_line(
    samples: PathSamples, coarse_map: TurnMap, branch: int, keep: LeastMargins, mode: Mode, bodies: Bodies | None
) -> tuple[Line | BlockedMap, TurnMap]:
    """Return the cheapest line without collisions, and the map with cells closed where lines had collisions.

    The map compares bodies at some samples of long paths only, and not on joint interpolations, which depend on two
    turns. So all samples of a line are compared, and cells with collisions are closed for the next line. A line that
    still has collisions after `_ROUNDS` lines is returned: the path is checked again when it is converted.

    :param branch: branch of the inverse kinematics.
    :param keep: margins to keep.
    :param bodies: bodies that are compared; None: collisions are not checked.
    :returns: the line, or the block that no line passes; and the map with the closed cells.
    """
    for _ in range(_ROUNDS):
        line = _cheapest_line(samples, coarse_map, keep, mode, is_circle=True)
        if isinstance(line, BlockedMap):
            return line, coarse_map
        fine = _refine_line(samples, coarse_map.blocks, branch, line, keep=keep, mode=mode, bodies=bodies)
        if bodies is None:
            return line if fine is None else fine, coarse_map
        for candidate in (line,) if fine is None else (fine, line):
            is_hit = _is_hit(samples, coarse_map.blocks, branch, candidate, bodies)
            if not is_hit.any():
                return candidate, coarse_map
            coarse_map = _close_cells(samples, coarse_map, candidate, is_hit)
    return line, coarse_map


def _today_is_as_good(
    samples: PathSamples, coarse_map: TurnMap, branch: int, keep: LeastMargins, line: Line, bodies: Bodies | None
) -> bool:
    """Return whether the turn of the cell keeps the margins everywhere, and a line saves too little to change it.

    The line saves too little if it lowers the RMS of the expected error along cuts by less than `drive.LEAST_SAVING`.

    :param branch: branch of the inverse kinematics.
    :param keep: margins to keep.
    :param bodies: bodies that are compared; None: collisions are not checked.
    """
    no_turn = np.zeros(len(samples))
    at_line = _sample_turns(samples, coarse_map.blocks, line.knots)
    weight = coarse_map.blocks.cut_length
    today, best = (
        turn_map.evaluate(samples, coarse_map.blocks, branch, base, _NO_OFFSET, None).error[:, 0]
        for base in (no_turn, at_line)
    )
    if not np.sqrt(weight @ today**2) <= (1.0 + drive.LEAST_SAVING) * np.sqrt(
        weight @ best**2
    ):  # also where an error is NaN
        return False
    # every other turn is closed, so that only the line of the cell is left
    other_turns = np.broadcast_to(np.abs(wrap_angles(coarse_map.offset)) > _TURN_TOLERANCE, coarse_map.u95.shape)
    hit = other_turns if coarse_map.hit is None else coarse_map.hit | other_turns
    cell_line = _cheapest_line(samples, replace(coarse_map, hit=hit), keep, "best", is_circle=True)
    if isinstance(cell_line, BlockedMap):
        return False
    return bodies is None or not _is_hit(samples, coarse_map.blocks, branch, cell_line, bodies).any()


def _is_hit(samples: PathSamples, blocks: Blocks, branch: int, line: Line, bodies: Bodies) -> Bools:
    """Return True for samples (N,) at which, or before which, bodies come too close, from [start] on.

    :param line: turns of the tool about its axis along the path.
    :param branch: branch of the inverse kinematics.
    """
    robot_in_cell, motion = samples.robot_in_cell, samples.sample.motion
    rows = np.arange(len(samples))
    turn = _sample_turns(samples, blocks, line.knots)
    q = drive.solve(robot_in_cell.robot, components(samples.flange(rows, turn)), branch).T
    joints = samples.program.motions.joints[motion]
    is_axis_target = np.isfinite(joints[:, 0])
    q[is_axis_target] = joints[is_axis_target]
    q = np.concatenate([robot_in_cell.cell.start_joints[None], q])
    # at [start] the robot has the tool of sample 0; the result for [start] itself is left out
    return bodies.is_hit_along_path(q, np.append(0, rows), breaks=np.zeros(len(q), dtype=bool))[1:]


def _close_cells(samples: PathSamples, coarse_map: TurnMap, line: Line, is_hit: Bools) -> TurnMap:
    """Return the map with the two cells next to a line closed where it has collisions: no line may pass them then.

    :param is_hit: (N,) True for samples of the line with collisions.
    """
    turn = _sample_turns(samples, coarse_map.blocks, line.knots)
    rows = np.flatnonzero(is_hit)
    bins = np.searchsorted(coarse_map.blocks.first, rows, side="right") - 1  # `first` are the first samples of bins
    position = (turn[rows] - coarse_map.offset[0]) / coarse_map.step  # in columns of the map, which is a circle
    assert coarse_map.hit is not None
    hit = coarse_map.hit.copy()
    for column in (np.floor(position), np.ceil(position)):
        hit[bins, column.astype(np.int64) % len(coarse_map.offset)] = True
    return replace(coarse_map, hit=hit)


def _tilting_motions(samples: PathSamples) -> Bools:
    """Return True for motions (M,) at feed that tilt the tool axis: an additional turn would make the tool lean."""
    m = samples.program.motions
    end = m.target[:, :3, :3] @ samples.axis
    begin = samples.segments.start.at(np.arange(len(m)))[:, :3, :3] @ samples.axis
    return np.asarray(~m.rapid & (m.kind != PTP) & (norm(end - begin) > _TURN_TOLERANCE))


def _cheapest_line(
    samples: PathSamples, path_map: TurnMap, keep: LeastMargins, mode: Mode, *, is_circle: bool
) -> Line | BlockedMap:
    """Return the cheapest line through a map, or the block that no line passes.

    :param keep: margins to keep.
    :param is_circle: whether the map is a whole circle of turns.
    """
    robot, start = samples.robot_in_cell.robot, samples.robot_in_cell.cell.start_joints
    return turn_map.line_through(robot, path_map, keep, start, turn_at_feed=mode == "path", is_circle=is_circle)


def _refine_line(
    samples: PathSamples,
    blocks: Blocks,
    branch: int,
    line: Line,
    *,
    keep: LeastMargins,
    mode: Mode,
    bodies: Bodies | None,
) -> Line | None:
    """Return the cheapest line next to a line, on a fine map around it; None if no line passes through that map.

    :param branch: branch of the inverse kinematics.
    :param keep: margins to keep.
    :param bodies: bodies that are compared; None: collisions are not checked.
    """
    base = _sample_turns(samples, blocks, line.knots)
    fine_map = turn_map.evaluate(samples, blocks, branch, base, _FINE_OFFSETS, bodies)
    fine_line = _cheapest_line(samples, fine_map, keep, mode, is_circle=False)
    return None if isinstance(fine_line, BlockedMap) else fine_line


def _sample_turns(samples: PathSamples, blocks: Blocks, knots: Array) -> Array:
    """Return the turn (N,) [rad] at samples for turns (B,) at the ends of blocks, stretches of the path [rad]."""
    ends = blocks.turn_of_motions(samples, knots)
    motion, t = samples.sample.motion, samples.sample.t
    # a joint interpolation does not turn in proportion, but its end, t = 1, is its only sample
    begin = np.append(ends[0], ends[:-1])
    return np.asarray(begin[motion] + t * (ends - begin)[motion])


def _turn_issue(turn: Turn) -> Issue:
    """Return the information on the chosen turn of the tool."""
    low, high = (f"{angle:.0f}°" for angle in turn.range_deg())
    mode_text = "by one angle for each operation" if turn.mode == "best" else "along the path"
    if low == high:
        message = f"The tool is turned about its axis by {low} everywhere."
    else:
        message = f"The tool is turned about its axis {mode_text}, from {low} to {high}."
    if turn.map.hit is None:
        message += f" {NO_CLEARANCE}"
    return Issue("info", "redundancy", message)


def _blocked_error(
    samples: PathSamples, coarse_map: TurnMap, blocked_map: BlockedMap, mode: Mode, branch: int, bodies: Bodies | None
) -> Issue:
    """Return the error that names the motion that no line passes, the reasons there, and bodies that are too close.

    The motion is that of the first bin of the block without a free turn; if all have one, of the last bin.

    :param branch: branch of the inverse kinematics.
    :param bodies: bodies that were compared; None without [collision].
    """
    blocks = coarse_map.blocks
    rows = np.flatnonzero(blocks.block == blocked_map.block)  # bins of the block
    reasons = coarse_map.reasons(BARE_MARGINS)[rows]
    is_closed = (reasons != drive.FREE).all(axis=1)  # bins without a free turn
    row = int(np.argmax(is_closed)) if is_closed.any() else len(rows) - 1  # in `rows`
    counts = np.bincount(reasons[row], minlength=len(REASONS))
    turn_count = reasons.shape[1]
    parts = [
        f"{REASONS[k]} at {100.0 * count / turn_count:.0f} % of all turns"
        for k, count in enumerate(counts)
        if k != drive.FREE and count
    ]
    motion = np.array([int(samples.sample.motion[blocks.first[rows[row]]])])
    if bodies is not None and counts[drive.COLLISION]:  # collision is the last of the reasons, so the last part
        columns = np.flatnonzero(reasons[row] == drive.COLLISION)
        parts[-1] += f": {_closest_bodies(samples, coarse_map, int(rows[row]), columns, branch, bodies)}"
    reason_text = f" ({', '.join(parts)} here)" if parts else ""
    if is_closed.any():
        problem = (
            f"no turn of the tool about its axis can be driven here ({', '.join(parts)}). Move the part or [start]."
        )
    elif mode == "best":
        problem = (
            f"no single turn of the tool about its axis can be driven through this operation{reason_text}. "
            'Set [gcode] redundancy = "path", or move the part.'
        )
    else:
        problem = (
            "the tool cannot be turned about its axis quickly enough to stay where the robot can drive"
            f"{reason_text}. Lower the feed, move the part or choose other [start] joints."
        )
    return samples.program.motions.issue("error", "redundancy", problem, motion)


def _closest_bodies(
    samples: PathSamples, coarse_map: TurnMap, row: int, columns: Ints, branch: int, bodies: Bodies
) -> str:
    """Return in words which two bodies are closest in a bin of the map, a short stretch of the path.

    Of the turns of the tool about its axis, the one that keeps the bodies farthest apart is taken.

    :param row: the bin, a row of the map.
    :param columns: (c,) columns of the map: the turns that are compared.
    :param branch: 0…7, the branch of the inverse kinematics.
    """
    first = coarse_map.blocks.first  # sample of the path at which each bin begins
    stop = int(first[row + 1]) if row + 1 < len(first) else len(samples)
    sample_rows = distinct(np.linspace(first[row], stop - 1, _MAX_ROWS).astype(np.int64))
    rows, column = (values.ravel() for values in np.meshgrid(sample_rows, columns, indexing="ij"))
    turn = coarse_map.base[rows] + coarse_map.offset[column]  # [rad]
    flange = components(samples.flange(rows, turn))  # (3, 4, n), as `solve` takes frames
    q = drive.solve(samples.robot_in_cell.robot, flange, branch).T  # (n, 6)
    clearance = bodies.clearance(q, rows)
    distance = clearance.distance.reshape(len(sample_rows), len(columns))
    best_column = int(distance.min(axis=0).argmax())
    k = int(distance[:, best_column].argmin()) * len(columns) + best_column  # the same pose in the flat arrays
    first_body, second_body = (bodies.name(int(values[k])) for values in (clearance.first, clearance.second))
    distance_text = (
        f"{clearance.distance[k] * MM_PER_M:.2g} mm from" if clearance.distance[k] > 0.0 else "in contact with"
    )
    return f"{first_body} {distance_text} {second_body} at best, and {bodies.min_distance * MM_PER_M:.2g} mm are needed"


def bin_turns(turn: Turn) -> Array:
    """Return the chosen turn (K,) at the end of each bin of the map, a short stretch of the path [rad].

    The turn that the cell states for the whole program, `constant`, is not in it.
    """
    blocks = turn.map.blocks
    start_turn = np.append(turn.knots[0], turn.knots[:-1])
    start_turn = np.where(blocks.is_start, turn.knots, start_turn)[blocks.block]
    return np.asarray(start_turn + blocks.share * (turn.knots[blocks.block] - start_turn))


class ChosenStart(Struct, frozen=True):
    """Joint angles at which a program starts.

    :param joints: A1…A6 [deg].
    :param message: how they were chosen, in words.
    """

    joints: tuple[float, float, float, float, float, float]
    message: str


def _first_target_error(program: Program, problem: str, advice: str) -> ProgramError:
    """Return an error with the file and line of the first target of a program."""
    file, line = program.places(np.zeros(1, dtype=np.int64)).of(0)
    return ProgramError(problem, file=file, line=line, advice=advice)


def chosen_start(program: Program, robot_in_cell: RobotInCell) -> ChosenStart:
    """Return the chosen joint angles at the first target of a program.

    If the program states joint angles, or status and turn of its first target, it starts with these. Else the branch
    with the most margin is chosen.

    :param robot_in_cell: the robot in a cell; its [start] is not used.
    :raises ProgramError: the first target is out of reach, on all branches or with the status that it states.
    """
    m = program.motions
    if np.isfinite(m.joints[0]).all():  # NaN: the target is a pose
        return _chosen_start(m.joints[0], "whose joint angles it states")
    samples = PathSamples.of(program, robot_in_cell, None)
    if m.status[0] >= 0:  # −1: not stated
        return _chosen_start(_stated_joints(program, samples), "with the status and turn that it states")
    turn_is_free = robot_in_cell.cell.gcode.redundancy != "constant" and not program.keeps_text
    turns = drive.TRIED_TURNS if turn_is_free else np.zeros(1)
    branches = _Branches.of(samples, _samples_on_one_branch(program, samples), turns)
    best, second = branches.order[:2]
    q = branches.start_path(best)
    if q is None:
        raise _first_target_error(program, _NO_BRANCH_TEXT, "Move the part, or give [start] joints.")
    if not np.isfinite(branches.least_margin[best]):
        return _chosen_start(q[:, 0], "on the branch that reaches most of the program")
    # the turn along the path is still to be chosen: whole turns of A4 and A6 with this turn are of no use
    joints = q[:, 0] if turn_is_free else _unwind(robot_in_cell, q)
    return _chosen_start(joints, _branch_reason(best, second, branches.least_margin, branches.is_free))


class _Branches(Struct, frozen=True, eq=False):
    """The eight branches of the arm along some samples of a program.

    :param joint_paths: by branch, then by turn of the tool: joint angles (6, n) [rad].
    :param margins: (8, turns, n) margins of each sample [rad], see `_smallest_margins`.
    :param least_margin: (8,) least margin of each branch along the samples, each sample at its best turn [rad]; −inf if
        a sample cannot be driven.
    :param is_free: (8,) whether a branch is without collision, see `_collision_free_branches`.
    """

    joint_paths: list[list[Array]]
    margins: Array
    least_margin: Array
    is_free: list[bool]

    @classmethod
    def of(cls, samples: PathSamples, rows: Ints, turns: Array) -> _Branches:
        """Return the branches at samples.

        :param rows: (n,) the samples.
        :param turns: turns of the tool about its axis that are tried [rad].
        """
        joint_paths = [[_solve(samples, rows, turn, branch) for turn in turns] for branch in range(_BRANCHES)]
        margins = np.array([[_smallest_margins(samples.robot_in_cell, q) for q in paths] for paths in joint_paths])
        can_start = np.isfinite(margins[:, :, 0].max(axis=1))  # the first target is reached with some turn
        least_margin = np.where(can_start, margins.max(axis=1).min(axis=1), -np.inf)
        is_free = _collision_free_branches(samples, rows, joint_paths, least_margin)
        return cls(joint_paths, margins, least_margin, is_free)

    @property
    def order(self) -> list[int]:
        """The branches, the best one first: without collision, then with most margin, then with most samples in reach.

        Of equal branches, the one with A4 and A6 nearest to zero at the start comes first.
        """
        reach_count = np.isfinite(self.margins.max(axis=1)).sum(axis=1)
        wrist_turn = [np.abs(np.nan_to_num(paths[0][[3, 5], 0], nan=_LARGE_ANGLE)).sum() for paths in self.joint_paths]
        return sorted(
            range(_BRANCHES),
            key=lambda k: (self.is_free[k], round(float(self.least_margin[k]), 6), reach_count[k], -wrist_turn[k]),
            reverse=True,
        )

    def start_path(self, branch: int) -> Array | None:
        """Return the joint angles (6, n) [rad] of a branch at its best turn of the start; None if it cannot start."""
        at_start = self.margins[branch, :, 0]
        return self.joint_paths[branch][int(at_start.argmax())] if np.isfinite(at_start).any() else None


def _stated_joints(program: Program, samples: PathSamples) -> Array:
    """Return the joint angles (6,) [rad] at the first target of a program with the status and turn that it states.

    :raises ProgramError: the target cannot be reached with this status.
    """
    first = int(np.argmax(samples.sample.t == 1.0))
    part = slice(first, first + 1)
    sample = samples.sample
    try:
        joint_path = samples.robot_in_cell.follow(program, sample.motion[part], sample.t[part], sample.pose.take(part))
    except UnreachableError as cause:
        raise _first_target_error(program, _NO_STATUS_TEXT, "Move the part, or correct S, $BASE and $TOOL.") from cause
    joints: Array = joint_path.q[0]
    return joints


def _samples_on_one_branch(program: Program, samples: PathSamples) -> Ints:
    """Return some samples (n,) from the first target to where the program states joint angles or a status."""
    m = program.motions
    stated_rows = np.flatnonzero(np.isfinite(m.joints[:, 0]) | (m.status >= 0))  # joints NaN, status −1: not stated
    first = int(np.argmax(samples.sample.t == 1.0))  # samples before are on the way from a start that is not known
    rows = np.flatnonzero(samples.sample.motion < (stated_rows[0] if len(stated_rows) else len(m)))
    rows = rows[rows >= first]
    return rows[distinct(np.linspace(0, len(rows) - 1, min(_MAX_SAMPLES, len(rows))).astype(np.int64))]


def _branch_reason(best: int, second: int, margin: Array, free: list[bool]) -> str:
    """Return why a branch is chosen, in words.

    :param best: the chosen branch, and `second` the next best one.
    :param margin: (8,) least margin of each branch [rad]; −inf if it cannot follow the path.
    :param free: (8,) whether each branch is without collision.
    """
    restriction = (
        " of those without collisions" if not all(free[k] for k in range(_BRANCHES) if np.isfinite(margin[k])) else ""
    )
    words = (
        f"on the branch{restriction} with the most margin to joint limits and singular poses, "
        f"{margin[best] * DEG_PER_RAD:.1f}°"
    )
    if np.isfinite(margin[second]) and free[second]:
        words += f" (the next best has {margin[second] * DEG_PER_RAD:.1f}°)"
    return words


def _collision_free_branches(
    samples: PathSamples, rows: Ints, joint_paths: list[list[Array]], least_margin: Array
) -> list[bool]:
    """Return for each branch whether at each of some samples a turn of the tool is without collision.

    It is True for all branches if the cell has no [collision], if fewer than two branches can follow the path, or if no
    branch is without collision: then the check of the path names the bodies.

    :param rows: (n,) the samples.
    :param joint_paths: by branch, then by turn of the tool: joint angles (6, n) [rad].
    :param least_margin: (8,) least margin of each branch [rad]; −inf if it cannot follow the path.
    """
    table = samples.robot_in_cell.cell.collision
    possible_branches = [k for k in range(_BRANCHES) if np.isfinite(least_margin[k])]
    if table is None or len(possible_branches) < 2:
        return [True] * _BRANCHES
    bodies = Bodies(samples, table.clearance_mm)
    compared_rows = distinct(np.linspace(0, len(rows) - 1, min(_MAX_POSES, len(rows))).astype(np.int64))
    breaks = np.ones(len(compared_rows), dtype=bool)  # far samples are no path: each is compared by itself
    is_free = [False] * _BRANCHES
    for k in possible_branches:
        hits = [
            bodies.is_hit_along_path(q[:, compared_rows].T, rows[compared_rows], breaks, between_samples=False)
            for q in joint_paths[k]
        ]
        is_free[k] = not np.logical_and.reduce(hits).any()
    return is_free if any(is_free) else [True] * _BRANCHES


def _chosen_start(q: Array, reason: str) -> ChosenStart:
    """Return a start at joint angles (6,) [rad], rounded as a user would write them, with its message.

    :param reason: end of the message: how the angles were chosen.
    """
    joints = [without_negative_zero(round(float(angle), _DECIMALS)) for angle in q * DEG_PER_RAD]
    joint_text = ", ".join(f"{angle:.1f}" for angle in joints)
    message = f"The cell has no [start]: the program starts at A1…A6 = {joint_text}, its first target, {reason}."
    return ChosenStart((joints[0], joints[1], joints[2], joints[3], joints[4], joints[5]), message)


def _solve(samples: PathSamples, rows: Ints, turn: float, branch: int) -> Array:
    """Return the joint angles (6, n) [rad] at samples, with the tool turned about its axis by `turn` [rad]."""
    flange = samples.flange(rows, np.full(len(rows), turn))
    return drive.solve(samples.robot_in_cell.robot, components(flange), branch)


def _smallest_margins(robot_in_cell: RobotInCell, q: Array) -> Array:
    """Return the smallest margin (n,) of joints, wrist and elbow [rad]; −inf out of reach or beyond a limit."""
    margins = drive.margins(robot_in_cell.robot, q)
    smallest = np.minimum(np.minimum(margins.joint, margins.wrist), margins.elbow)
    return np.where(np.isnan(smallest) | (margins.joint < 0.0), -np.inf, smallest)


def _unwind(robot_in_cell: RobotInCell, q: Array) -> Array:
    """Return the joint angles (6,) [rad] at the start of a path, with A4 and A6 moved by −1, 0 or 1 whole turns.

    For each joint, the number with the largest margin of the whole path to its limits is taken; 0 if it is as good.

    :param q: (6, n) joint angles along the path [rad]; NaN where the robot does not reach it.
    """
    robot, joints = robot_in_cell.robot, q[:, 0].copy()
    for axis in drive.WINDING_JOINTS:
        axis_path = q[axis, 0] + np.append(0.0, np.cumsum(np.nan_to_num(wrap_angles(np.diff(q[axis])))))
        limit_margins = [
            min(axis_path.min() + whole_turn - robot.lower[axis], robot.upper[axis] - axis_path.max() - whole_turn)
            for whole_turn in 2.0 * np.pi * np.array([0.0, -1.0, 1.0])
        ]
        joints[axis] += 2.0 * np.pi * (0.0, -1.0, 1.0)[int(np.argmax(limit_margins))]
    return joints
