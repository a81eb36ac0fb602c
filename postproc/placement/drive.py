"""What the robot can drive and how exactly it cuts: reach, limits, singular poses, joint speeds, expected error.

Arrays of joint angles are (6, n) here, the sample index last, as in `kinematics`.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import elastostatics, kinematics, toolpath
from postproc.elastostatics import ToolSpring
from postproc.errors import NotConvergedError
from postproc.frames import RAD_PER_DEG, Array, norm, wrap_angles
from postproc.placement.samples import Load, PathSamples
from postproc.program import Bools, Ints
from postproc.robot import RobotModel
from postproc.under_load import RobotInCell

REASONS = ("free", "out of reach", "joint limit", "singular pose", "joint speed", "collision")
"""Reasons to refuse a pose, in the order in which they are checked; the first, "free", refuses nothing."""
PLACE_REASONS = (*REASONS, "collision on the move from [start]")
"""Reasons to refuse a place."""
FREE, REACH, LIMIT, SINGULAR, SPEED, COLLISION, FIRST_MOVE = range(7)  # indices in PLACE_REASONS
LEAST_SAVING = 0.02
"""Share of the expected error that another place or turn must save; else that of today stays (assumed)."""
TRIED_TURNS = np.arange(-180.0, 180.0, 30.0) * RAD_PER_DEG
"""Turns of the tool about its axis that are tried where the cell leaves the turn open [rad]."""
WINDING_JOINTS = (3, 5)
"""A4 and A6: the joints that may turn by more than a whole turn."""


class LeastMargins(Struct, frozen=True):
    """Margins that a program must keep.

    :param joint: distance of each joint to its limits [rad].
    :param wrist: distance of A5 from where A4 and A6 are in line [rad].
    :param elbow: distance of A3 from the stretched arm [rad].
    :param shoulder: distance of the wrist centre from the axis of A1 [m].
    :param speed: largest speed of a joint, as a share of its limit.
    :param jump: largest turn of a joint between neighbouring samples [rad].
    """

    joint: float = 2.0 * RAD_PER_DEG
    wrist: float = 1.0 * RAD_PER_DEG
    elbow: float = 1.0 * RAD_PER_DEG
    shoulder: float = 0.02
    speed: float = 0.95
    jump: float = 40.0 * RAD_PER_DEG


BARE_MARGINS = LeastMargins(
    joint=0.01 * RAD_PER_DEG,
    wrist=0.25 * RAD_PER_DEG,
    elbow=0.25 * RAD_PER_DEG,
    shoulder=0.006,
    speed=0.98,
    jump=44.0 * RAD_PER_DEG,
)
"""The least margins that a program must keep to be converted."""


class Margins(Struct, frozen=True, eq=False):
    """Margins of n configurations; NaN for poses out of reach.

    :param joint: (n,) smallest distance of a joint to its limits [rad]; A4 and A6 count with the best whole turns.
    :param wrist: (n,) distance of A5 from the angle at which A4 and A6 are in line [rad].
    :param elbow: (n,) distance of A3 from the angle at which the arm is stretched [rad].
    :param shoulder: (n,) distance of the wrist centre from the axis of A1 [m].
    """

    joint: Array
    wrist: Array
    elbow: Array
    shoulder: Array


def solve(robot: RobotModel, flange: Array, branch: int | Ints) -> Array:
    """Return joint angles (6, n) [rad], each within half a turn of the middle of its limits; NaN out of reach.

    :param flange: (3, 4, n) flange frames in the root [m].
    :param branch: branch of the inverse kinematics, of all or of each (n,).
    """
    q = kinematics.closed_form(robot).solve(flange, branch)
    middle = 0.5 * (robot.lower + robot.upper)[:, None]
    return middle + wrap_angles(q - middle)


def margins(robot: RobotModel, q: Array) -> Margins:
    """Return the margins of joint angles (6, n) [rad]; NaN where these are NaN.

    Angles must be within half a turn of the middle of their limits, as `solve` returns them: so A4 and A6 have the
    largest margin that whole turns of them allow.
    """
    form = kinematics.closed_form(robot)
    with np.errstate(invalid="ignore"):
        limit_distance = np.minimum(q - robot.lower[:, None], robot.upper[:, None] - q)
        rows = q.T  # (n, 6), as the closed form takes them
        return Margins(
            joint=limit_distance.min(axis=0),
            wrist=np.abs(form.wrist_angle_from_in_line(rows)),
            elbow=np.abs(form.elbow_angle_from_stretched(rows)),
            shoulder=np.abs(form.wrist_distance_ahead_of_a1(rows)),
        )


def reason(margin: Margins, speed: Array, jump: Array, keep: LeastMargins, hit: Bools | None = None) -> Ints:
    """Return the first reason (...,) to refuse configurations, as an index in `REASONS`; `FREE`: none.

    A large jump counts as a singular pose, near which joints turn far between neighbouring samples. NaN is refused.

    :param margin: margins (...,) of the configurations.
    :param speed: (...,) largest joint speed as a share of its limit.
    :param jump: (...,) largest turn of a joint from the sample before [rad].
    :param keep: margins to keep.
    :param hit: (...,) True where bodies come too close; None: not checked.
    """
    with np.errstate(invalid="ignore"):
        reasons = np.zeros(margin.joint.shape, dtype=np.int64)  # assigned from the last reason to the first
        if hit is not None:
            reasons[hit] = COLLISION
        reasons[~(speed <= keep.speed)] = SPEED
        singular = ~((margin.wrist >= keep.wrist) & (margin.elbow >= keep.elbow) & (margin.shoulder >= keep.shoulder))
        reasons[singular | ~(jump <= keep.jump)] = SINGULAR
        reasons[~(margin.joint >= keep.joint)] = LIMIT
        reasons[np.isnan(margin.joint)] = REACH
    return reasons


def expected_error(samples: PathSamples, rows: Ints, turn: Array, q: Array) -> tuple[Array, Array]:
    """Return the expected error (95 %) (n,) and the deflection (n,) [m] at samples.

    Both are NaN where `q` is NaN, and without equilibrium. The expected error is also NaN if the model states none.

    :param rows: (n,) the samples.
    :param turn: (n,) turn of the tool about its axis [rad].
    :param q: (n, 6) joint angles [rad].
    """
    u95, deflection = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    rows_in_reach = np.flatnonzero(np.isfinite(q).all(axis=1))
    if len(rows_in_reach):
        tool = toolpath.tool_of(samples.program, samples.sample.motion[rows[rows_in_reach]])
        u95[rows_in_reach], deflection[rows_in_reach] = errors(
            samples.robot_in_cell, q[rows_in_reach], tool, samples.load(rows[rows_in_reach], turn[rows_in_reach])
        )
    return u95, deflection


def errors(robot_in_cell: RobotInCell, q: Array, tool: Array, load: Load) -> tuple[Array, Array]:
    """Return the expected error (95 %) (n,) and the deflection (n,) [m]; NaN without equilibrium.

    The expected error is by the model and the forces, as `u95_mm` of the report, without the error of lost motion that
    reverses along the path. It is NaN if the model states no uncertainty.

    :param q: (n, 6) joint angles [rad].
    :param tool: `$TOOL` (4, 4) or (n, 4, 4) in the flange frame [m].
    :param load: loads of the tool at these joint angles.
    """
    deflection = _deflections(robot_in_cell, q, tool, load.wrench, load.pose)
    tool_compliance = _tool_compliance(robot_in_cell.tool_spring, load.pose)
    with np.errstate(invalid="ignore", divide="ignore"):
        u95 = elastostatics.position_bound(
            robot_in_cell.robot,
            q,
            tool,
            load.wrench,
            force_spread=load.spread,
            in_series=tool_compliance,
            is_proportional=load.is_scaled,
        )
    return np.full(len(q), np.nan) if u95 is None else u95, deflection


def _tool_compliance(spring: ToolSpring | None, pose: Array) -> Array | None:
    """Return the compliance (n, 6, 6) of the tool in root axes at poses (n, 4, 4); None without a spring."""
    return None if spring is None else spring.matrices(pose[:, :3, :3])


def _deflections(robot_in_cell: RobotInCell, q: Array, tool: Array, wrench: Array, pose: Array) -> Array:
    """Return the deviation (n,) [m] of the tip from nominal without correction; NaN without equilibrium.

    :param q: (n, 6) joint angles [rad].
    :param tool: `$TOOL` (4, 4) or (n, 4, 4) in the flange frame [m].
    :param wrench: (n, 6) on the tool at its tip, root axes [N, N·m].
    :param pose: (n, 4, 4) nominal tool frames in the root [m].
    """
    deflection = np.full(len(q), np.nan)
    rows = np.arange(len(q))
    while len(rows):
        tools = tool if tool.ndim == 2 else tool[rows]
        try:
            tip = robot_in_cell.tip(q[rows], tools, wrench[rows])
        except NotConvergedError as cause:  # try again without the rows that have no equilibrium
            rows = np.delete(rows, list(cause.rows))
            continue
        deflection[rows] = norm(tip - pose[rows, :3, 3])
        break
    return deflection


def largest_speed_share(robot: RobotModel, step: Array, time: Array) -> Array:
    """Return the largest joint speed (n,) as a share of its limit, for turns (6, n) [rad] within times (n,) [s]."""
    with np.errstate(invalid="ignore"):
        least_time = (np.abs(step) / robot.speed[:, None]).max(axis=0)  # of the slowest joint at full speed
        return np.asarray(least_time / time)


def is_refused(reasons: Ints) -> Bools:
    """Return True for configurations (...) that are refused; `reasons` (...) are indices in `REASONS`."""
    return np.asarray(reasons != FREE)
