"""Inverse kinematics of six-axis arms with parallel axes 2 and 3 and a spherical wrist.

The closed form (all eight branches) comes from py-opw-kinematics; its parameters are read off the URDF and checked
against Pinocchio. A calibrated geometry, which has no closed form, is reached from there by Newton steps (`refine`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
from py_opw_kinematics import KinematicModel, Robot
from scipy.spatial.transform import RigidTransform

from postproc.chunks import in_chunks
from postproc.errors import ModelError, PostprocError
from postproc.frames import Array, displaced, inverse, largest, twist_between
from postproc.kinematics.chain import tcp
from postproc.program import Bools, Ints
from postproc.robot import RobotModel

_TURN = 2.0 * np.pi
_SAME = 1e-6
_ZERO = 1e-6
"""A joint angle within this of zero [rad] is zero: its sign is rounding."""
_SMALL_STEP = 1e-5
_OFF_WRIST = 1e-3


class UnreachableError(PostprocError):
    """Poses have no solution on their branch; `rows` are the samples concerned."""

    def __init__(self, rows: Sequence[int]) -> None:
        super().__init__(f"{len(rows)} poses out of reach")
        self.rows = tuple(rows)


@dataclass(frozen=True, slots=True, eq=False)
class JointPath:
    """Joint angles of every sample of a path; exists only if every sample was solved.

    :param q: (N, 6) A1…A6 [rad], KUKA signs, continuous along the path (turns included).
    :param branch: (N,) branch 0…7 of the closed form.
    """

    q: Array
    branch: Ints


@dataclass(frozen=True, slots=True, eq=False)
class ClosedForm:
    """Closed-form inverse kinematics of the nominal geometry.

    :param arm: the solver.
    :param flange_in_wrist: (4, 4) constant between the solver's end frame and the flange.
    :param elbow_stretched: A3 [rad] at which the wrist centre lies on the line through axes 2 and 3.
    :param wrist_in_flange: (3,) the wrist centre, a fixed point of the flange frame [m].
    :param ahead: (3,) horizontal direction of the arm at A1 = 0, root axes.
    :param a1_axis: (3,) axis of A1, root axes.
    """

    arm: Robot
    flange_in_wrist: Array
    elbow_stretched: float
    wrist_in_flange: Array
    ahead: Array
    a1_axis: Array

    def wrist_reach(self, wrist: Array, a1: Array) -> Array:
        """Return how far in front of the A1 axis the wrist centre stands (N,) [m]; negative: overhead.

        :param wrist: (N, 3) the wrist centre in the root [m].
        :param a1: (N,) joint angle A1 [rad].
        """
        aside = np.cross(self.a1_axis, self.ahead)
        return np.asarray(np.cos(a1) * (wrist @ self.ahead) + np.sin(a1) * (wrist @ aside))

    def branches(self, pose_flange_in_root: Array) -> Array:
        """Return joint angles (N, 8, 6) [rad] of all branches; NaN where one does not exist."""
        wrist = RigidTransform(pose_flange_in_root @ inverse(self.flange_in_wrist), normalize=False, copy=False)
        # limits that nothing meets: the solver then skips the singular values, which are not used here
        nothing = [(10.0, 11.0)] * 6
        return np.asarray(self.arm.reach(wrist, joint_limits=nothing, threads=1).joints)


@lru_cache(maxsize=16)
def closed_form(robot: RobotModel) -> ClosedForm:
    """Read the parameters of the closed form off the robot's nominal geometry.

    :raises ModelError: the arm has no vertical A1, no parallel A2 and A3, or no spherical wrist: the closed form and
        Pinocchio disagree.
    """
    model = robot.nominal
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(6))
    origins = np.array([data.oMi[i].translation for i in range(1, 7)])
    jacobian = pin.computeJointJacobians(model, data, np.zeros(6))
    axes = jacobian[3:].T
    up = np.array([0.0, 0.0, 1.0])
    side = axes[1]
    if abs(side @ up) > _SAME or abs(abs(axes[0] @ up) - 1.0) > _SAME:
        raise _no_closed_form(robot)
    ahead = np.cross(side, up)
    shoulder = origins[1] - origins[0]
    if shoulder @ ahead < 0.0:
        side, ahead = -side, -ahead
    wrist = _crossing(origins[3], axes[3], origins[4], axes[4])
    along = axes[3] * np.sign((wrist - origins[2]) @ axes[3])
    arm = origins[2] - origins[1]
    out = _flange(model, data)[:3, 3] - wrist
    hand = axes[5] * (np.sign(out @ axes[5]) or 1.0)

    def tilt(direction: Array) -> float:
        return float(np.arctan2(direction @ ahead, direction @ up))

    upper_arm, forearm = tilt(arm), tilt(along)
    across = np.cross(side, along)
    turned = float(np.arctan2(np.cross(side, axes[4]) @ along, side @ axes[4]))
    f = [
        bool(cosine < 0.0)
        for cosine in (axes[0] @ up, axes[1] @ side, axes[2] @ side, axes[3] @ along, 1.0, axes[5] @ hand)
    ]
    flips = (f[0], f[1], f[2], f[3], f[4], f[5])
    bend = float(np.arctan2(np.cross(along, hand) @ axes[4], along @ hand))
    parameters = {
        "a1": shoulder @ ahead,
        "a2": (wrist - origins[2]) @ across,
        "b": (wrist - origins[0]) @ side,
        "c1": origins[1] @ up,
        "c2": float(np.hypot(arm @ ahead, arm @ up)),
        "c3": (wrist - origins[2]) @ along,
        "c4": out @ hand,
    }
    heading = float(np.arctan2(ahead[1], ahead[0]))
    sample = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 6))
    expected, _ = tcp(model, sample, np.eye(4))
    elbow = float(np.arctan2(parameters["a2"], parameters["c3"]))
    for sign in (1.0, -1.0):  # the sign convention of the solver's offsets is not documented: the check decides
        zero = (sign * heading, sign * upper_arm, sign * (forearm - upper_arm), sign * turned, sign * bend, 0.0)
        solver = Robot(KinematicModel(**parameters, offsets=zero, flip_axes=flips), degrees=False)
        poses = solver.batch_forward(np.vstack([np.zeros(6), sample])).as_matrix()
        constant = inverse(poses[0]) @ _flange(model, data)
        if np.abs(poses[1:] @ constant - expected).max() < _SAME:
            factor = -1.0 if flips[2] else 1.0
            stretched = factor * (-elbow - (forearm - upper_arm))
            return ClosedForm(
                arm=solver,
                flange_in_wrist=constant,
                elbow_stretched=float((stretched + np.pi) % _TURN - np.pi),
                wrist_in_flange=(inverse(_flange(model, data)) @ [*wrist, 1.0])[:3],
                ahead=ahead,
                a1_axis=axes[0],
            )
    raise _no_closed_form(robot)


def _no_closed_form(robot: RobotModel) -> ModelError:
    return ModelError(
        f"robot {robot.name}: not an arm with vertical A1, parallel A2 and A3 and a spherical wrist",
        advice="Only such arms (all common KUKA six-axis robots) are supported.",
    )


def _flange(model: pin.Model, data: pin.Data) -> Array:
    pin.updateFramePlacements(model, data)
    pose: Array = data.oMf[model.getFrameId("flange")].homogeneous
    return pose


def _crossing(p: Array, u: Array, r: Array, v: Array) -> Array:
    """Return the point of the first line (p, u) nearest to the second (r, v)."""
    normal = np.cross(u, v)
    if normal @ normal < _SAME:
        return r
    along: Array = p + u * (np.cross(r - p, v) @ normal) / (normal @ normal)
    return along


def branch_of(robot: RobotModel, q: Array) -> int:
    """Return the branch 0…7 on which a configuration (6,) lies; with A5 = 0 that of A5 > 0."""
    q = np.array(q, dtype=float)
    if abs(q[4]) < _OFF_WRIST:  # A4 and A6 are not unique there
        q[4] = _OFF_WRIST
    pose, _ = tcp(robot.nominal, q[None], np.eye(4))
    candidates = closed_form(robot).branches(pose)[0]
    distance = largest(_wrapped(candidates - q))
    return int(np.nanargmin(distance))


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % _TURN - np.pi)


def status_of(robot: RobotModel, q: Array) -> Ints:
    """Return KUKA S (N,) of configurations (N, 6).

    Bit 0: wrist centre behind A1; bit 1: A3 at or beyond the stretched position; bit 2: A5 < 0.
    """
    form = closed_form(robot)
    pose, _ = tcp(robot.nominal, q, np.eye(4))
    behind = form.wrist_reach(pose[:, :3] @ np.append(form.wrist_in_flange, 1.0), q[:, 0]) < 0.0
    beyond = _wrapped(q[:, 2] - form.elbow_stretched) >= 0.0
    return np.asarray(behind * 1 + beyond * 2 + (q[:, 4] < 0.0) * 4, dtype=np.int64)


def turn_of(q: Array) -> Ints:
    """Return KUKA T (N,) of configurations (N, 6): bit n − 1 is set when axis n is negative, beyond rounding."""
    return np.asarray((q < -_ZERO) @ (1 << np.arange(6)), dtype=np.int64)


def follow(
    robot: RobotModel,
    flange: Callable[[Ints], Array],
    start: Array,
    free: Bools,
    axis_target: Array,
    status: Ints,
    turn: Ints,
) -> JointPath:
    """Solve a path by the controller's geometry, continuous from the start.

    A run of linear and circular moves stays on one branch. A PTP move may change it: to the status S and turn T it
    gives, else it keeps the branch and takes the nearest turn.

    :param robot: the robot.
    :param flange: returns the flange poses (n, 4, 4) in the root [m] of samples (n,).
    :param start: (6,) joint angles before the first sample [rad].
    :param free: (N,) True where the sample is the target of a PTP move.
    :param axis_target: (J, 6) joint angles of the PTP moves to an axis target [rad], NaN for the others.
    :param status: (J,) S of the PTP targets, −1 where none.
    :param turn: (J,) T of the PTP targets, −1 where none.
    :raises UnreachableError: a pose has no solution on its branch.
    """
    jumps = np.flatnonzero(free)
    by_axes = np.isfinite(axis_target[:, 0])
    slots = _branches_along(robot, flange(jumps), start, axis_target, status)
    branch = np.repeat(slots, np.diff(jumps, prepend=0, append=len(free)))
    q = _on_branches(robot, flange, branch)
    q[jumps[by_axes]] = axis_target[by_axes]
    unreached = np.flatnonzero(np.isnan(q).any(axis=1))
    if len(unreached):
        raise UnreachableError(unreached.tolist())
    last = np.asarray(start, dtype=float)
    for begin, end in pairwise(np.unique(np.concatenate([[0], jumps, jumps + 1, [len(q)]]))):
        if not free[begin]:
            q[begin:end] = np.unwrap(np.vstack([last, q[begin:end]]), axis=0)[1:]
        elif not by_axes[jump := np.searchsorted(jumps, begin)]:
            q[begin] = _turned(robot, q[begin], last, int(turn[jump]))
        last = q[end - 1]
    return JointPath(q, branch)


def _branches_along(robot: RobotModel, flange: Array, start: Array, axis_target: Array, status: Ints) -> list[int]:
    """Return the branch before the first PTP move, and from each of them on."""
    slots = [branch_of(robot, start)]
    for joints, candidates, wanted in zip(axis_target, closed_form(robot).branches(flange), status, strict=True):
        if np.isfinite(joints[0]):
            slots.append(branch_of(robot, joints))
        else:
            slots.append(_slot(robot, candidates, slots[-1], int(wanted)))
    return slots


def _on_branches(robot: RobotModel, flange: Callable[[Ints], Array], branch: Ints) -> Array:
    def on_branch(rows: Ints, branch: Ints) -> tuple[Array]:
        return (_on_branch(robot, flange(rows), branch),)

    return in_chunks(on_branch, np.arange(len(branch)), branch)[0]


def _on_branch(robot: RobotModel, pose: Array, branch: Ints) -> Array:
    """Return joint angles (n, 6) of flange poses (n, 4, 4) on given branches; NaN out of reach."""
    return np.asarray(np.take_along_axis(closed_form(robot).branches(pose), branch[:, None, None], axis=1)[:, 0])


def on_branch(robot: RobotModel, pose_flange_in_root: Array, branch: Ints, near: Array) -> Array:
    """Return joint angles (N, 6) of poses on given branches, in the turns nearest to `near`; NaN out of reach."""
    angles = _on_branch(robot, pose_flange_in_root, branch)
    return np.asarray(angles + _TURN * np.round((near - angles) / _TURN))


def _slot(robot: RobotModel, candidates: Array, slot: int, status: int) -> int:
    if status < 0:
        return slot
    exists = np.flatnonzero(np.isfinite(candidates).all(axis=1))
    if len(exists) == 0:
        return slot
    matching = exists[status_of(robot, candidates[exists]) == status & 7]
    return int(matching[0]) if len(matching) else slot


def _turned(robot: RobotModel, angles: Array, last: Array, turn: int) -> Array:
    """Return angles with whole turns added: nearest to `last`, or with the signs that T asks for."""
    if turn < 0:
        return np.asarray(angles + _TURN * np.round((last - angles) / _TURN))
    out = angles.copy()
    for axis in range(6):
        options = angles[axis] + _TURN * np.arange(-2, 3)
        inside = (options >= robot.lower[axis] - _SAME) & (options <= robot.upper[axis] + _SAME)
        signed = inside & ((options < 0.0) == bool(turn >> axis & 1))
        pool = options[signed] if signed.any() else options[inside] if inside.any() else options
        out[axis] = pool[np.argmin(np.abs(pool))]
    return out


def refine(
    model: pin.Model,
    q: Array,
    actuated: Sequence[int],
    tool: Array,
    target: Array,
    start: tuple[Array, Array] | None = None,
    steps: int = 20,
) -> tuple[Array, Array, Array]:
    """Move the actuated coordinates until the tool frame stands at the target (Newton).

    :param model: geometry to be used.
    :param q: (N, nv) start.
    :param actuated: coordinates that may move (six of them).
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame.
    :param target: (N, 4, 4) tool frame in the root frame.
    :param start: pose (N, 4, 4) and Jacobian (N, 6, nv) at q, if they are known.
    :returns: q (N, nv), pose (N, 4, 4) and Jacobian (N, 6, nv) there; after a last step below 1e-5 they are those
        before it, moved by it to first order (an error below 1e-9 m). Rows that do not converge keep an error: the
        caller checks the poses.
    """
    q = np.array(q, dtype=float)
    pose, jacobian = tcp(model, q, tool) if start is None else (start[0].copy(), start[1].copy())
    columns = list(actuated)
    rows = np.arange(len(q))
    for _ in range(steps):
        error = twist_between(pose[rows], target[rows])
        off = (largest(error[:, :3]) > 1e-10) | (largest(error[:, 3:]) > 1e-11)
        rows, error = rows[off], error[off]
        square = jacobian[rows][:, :, columns]
        solvable = np.abs(np.linalg.det(square)) > 1e-12
        rows, error, square = rows[solvable], error[solvable], square[solvable]
        if len(rows) == 0:
            break
        step = np.linalg.solve(square, error[..., None])[..., 0]
        q[rows[:, None], columns] += np.clip(step, -0.2, 0.2)
        small = largest(step) < _SMALL_STEP
        done = rows[small]
        pose[done] = displaced(pose[done], np.einsum("nij,nj->ni", square[small], step[small]))
        rows = rows[~small]
        if len(rows) == 0:
            break
        pose[rows], jacobian[rows] = tcp(model, q[rows], tool if tool.ndim == 2 else tool[rows])
    return q, pose, jacobian
