"""Bound over deflection in the whole workspace: whether a model corrects more than it may add, and where it does not.

Readings are taken at some poses; work is done at others. The identified model is evaluated at random poses within the
joint limits, under forces in random directions from a small share of the largest load measured up to all of it, smaller
where a joint would get more torque than was measured. At small forces every model is worth less: the unmodelled error
does not shrink with the force. What counts for the verdict are loads that were measured.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import elastostatics, kinematics
from postproc.errors import NotConvergedError
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm
from postproc.identification.measurements import Measurements
from postproc.identification.observability import joint_torques
from postproc.robot import JOINTS, LinkSpring, Parameter, RobotModel

SHARES = (0.05, 0.1, 0.2, 0.5, 1.0)
"""Shares of the largest load measured."""
_POSES = 100
_WITHIN = 0.95
"""Share of the poses at which bound over deflection is below the stated value."""
_LOADED = 0.02
"""Largest torque on a joint over the largest on any, below which the readings do not load it."""
_CLEARANCE = 0.25
"""Distance from the axis of A1 over the largest reach, nearer than which no work is done."""


class WorkspaceLevel(Struct, frozen=True):
    """Bound over deflection at a share of the largest load, over the workspace.

    :param load: force [N], median over the poses.
    :param deflection: of the tool [m], median.
    :param bound: u95 [m], median.
    :param worst: bound over deflection that 95 % of the poses are below.
    """

    load: float
    deflection: float
    bound: float
    worst: float


class Workspace(Struct, frozen=True):
    """Bound over deflection in the workspace.

    :param levels: by load, ascending; none where the springs have no equilibrium under measured loads.
    :param least: smallest load measured [N].
    :param cause: joint and parameter that most of the bound comes from where it is worst under a measured load.
    :param pose: (6,) [rad] of that place.
    """

    levels: tuple[WorkspaceLevel, ...]
    least: float
    cause: str
    pose: tuple[float, ...]

    @property
    def measured(self) -> tuple[WorkspaceLevel, ...]:
        """Levels of loads as large as were measured; the largest at least."""
        return tuple(level for level in self.levels if level.load >= self.least) or self.levels[-1:]

    @property
    def worst(self) -> WorkspaceLevel:
        """The level of measured loads at which bound over deflection is largest; there must be levels."""
        return max(self.measured, key=lambda level: level.worst)

    @property
    def refusal(self) -> str:
        """Why the model corrects less than it may add; empty if it does not."""
        angles = ", ".join(f"{angle * DEG_PER_RAD:.0f}" for angle in self.pose)
        if not self.levels:
            return f"at A1 … A6 = {angles}° {self.cause}"
        if self.worst.worst <= 1.0:
            return ""
        return (
            f"under {self.worst.load:.0f} N its bound is up to {self.worst.worst:.2g} times the deflection that it "
            f"corrects (A1 … A6 = {angles}°): {self.cause}"
        )

    @property
    def line(self) -> str:
        """The workspace in one line."""
        if not self.levels:
            return f"workspace: {self.refusal}"
        text = (
            f"bound over deflection in the workspace: below {self.worst.worst:.2g} in 95 % of the poses from "
            f"{self.measured[0].load:.0f} N to {self.levels[-1].load:.0f} N"
        )
        small = [level for level in self.levels if level.worst > 1.0]
        if small and small[-1].load < self.least:
            text += f"; at {small[-1].load:.0f} N and below the bound can exceed the deflection"
        return text


def over_workspace(robot: RobotModel, data: Measurements) -> Workspace:
    """Return bound over deflection of an identified robot in its workspace.

    :param robot: with covariance and discrepancy.
    """
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    q, direction = _poses(robot, tool)
    force = norm(data.wrench[data.loaded, :3])
    measured = np.abs(joint_torques(robot, data)).max(axis=0)
    _, jacobian = kinematics.tcp(robot.loaded, elastostatics.coordinates(robot, q), tool)
    torque = np.abs(np.einsum("nij,ni->nj", jacobian[:, :3, list(robot.actuated)], direction)) * force.max()
    loaded = measured > _LOADED * measured.max()
    size = force.max() * np.minimum(1.0, (measured[loaded] / np.maximum(torque[:, loaded], 1e-9)).min(axis=1))
    levels, worst = [], (0.0, "", q[0])
    for share in SHARES:
        wrench = np.concatenate([share * size[:, None] * direction, np.zeros_like(direction)], axis=1)
        try:
            moved = norm(elastostatics.deflect(robot, q, tool, wrench).twist[:, :3])
        except NotConvergedError as error:
            row = int(error.rows[0])
            cause = f"the springs have no equilibrium under {share * size[row]:.0f} N"
            return Workspace((), float(force.min()), cause, tuple(q[row].tolist()))
        bound = elastostatics.position_bound(robot, q, tool, wrench)
        assert bound is not None, "the robot states a covariance"
        ratio = bound / np.maximum(moved, 1e-12)
        limit = float(np.quantile(ratio, _WITHIN))
        levels.append(
            WorkspaceLevel(float(np.median(share * size)), float(np.median(moved)), float(np.median(bound)), limit)
        )
        if levels[-1].load >= force.min() and limit > worst[0]:
            row = int(np.argmin(np.abs(ratio - limit)))
            worst = (limit, _cause(robot, q[row], tool, wrench[row], float(bound[row])), q[row])
    return Workspace(tuple(levels), float(force.min()), worst[1], tuple(worst[2].tolist()))


def _poses(robot: RobotModel, tool: Array) -> tuple[Array, Array]:
    """Return joint angles (n, 6) [rad], clear of the floor and the axis of A1, and directions (n, 3) of forces."""
    rng = np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (8 * _POSES, 6))
    at = kinematics.tcp(robot.loaded, elastostatics.coordinates(robot, q), tool)[0][:, :3, 3]
    reach = norm(at[:, :2])
    clear = np.flatnonzero((at[:, 2] > 0.0) & (reach > _CLEARANCE * reach.max()))[:_POSES]
    direction = rng.normal(size=(len(clear), 3))
    return q[clear], direction / norm(direction)[:, None]


def _cause(robot: RobotModel, q: Array, tool: Array, wrench: Array, bound: float) -> str:
    """Return which joint's parameters most of the bound at a pose comes from."""
    covariance = robot.covariance
    assert covariance is not None, "the robot states a covariance"
    slopes = elastostatics.sensitivity(robot, q[None], tool, wrench[None])[0]
    part = np.einsum("ai,ai->i", slopes, slopes @ covariance.matrix)  # of the trace of the covariance of the position
    of_joint: dict[str, float] = {}
    for parameter, value in zip(covariance.parameters, part.tolist(), strict=True):
        of_joint[_joint(parameter)] = of_joint.get(_joint(parameter), 0.0) + value
    off = 0.0 if robot.discrepancy is None else float(robot.discrepancy.at(wrench[None])[0])
    if off > 0.5 * bound or not of_joint:
        return f"the unmodelled error is {off * MM_PER_M:.3f} of {bound * MM_PER_M:.3f} mm"
    joint = max(of_joint, key=lambda name: of_joint[name])
    _, title = max(
        (value, parameter.title)
        for value, parameter in zip(part.tolist(), covariance.parameters, strict=True)
        if _joint(parameter) == joint
    )
    return f"most of it comes from {joint}, whose readings do not determine {title}"


def _joint(parameter: Parameter) -> str:
    """Return the joint or link that a parameter belongs to; the compensator is at A2."""
    if isinstance(parameter, LinkSpring):
        return parameter.link
    return str(getattr(parameter, "joint", JOINTS[1]))
