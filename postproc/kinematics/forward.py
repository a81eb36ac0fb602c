"""Forward kinematics, Jacobian and torques of the weights of a chain, for many configurations at once.

The chain is walked once for all samples, each component of a vector an array with the sample index LAST (`components`).
Two joints are connected by the transform of Denavit and Hartenberg (1955): an offset, a tilt about X and a turn about
Z, which adds to the angle of the joint. It is made from the model once, and tested against Pinocchio.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.frames import Array, sine_and_cosine
from postproc.kinematics.components import combination, components, cross, matrices, product
from postproc.program import Ints
from postproc.robot import Chain

GRAVITY = 9.81
"""Acceleration of free fall [m/s²], along −Z of the root."""
_ZERO = 1e-15
"""A sine or cosine below this is zero: a right angle that a file gives by sixteen digits."""

_FEW = 1024
"""Samples up to which sines and cosines of all joints are computed at once; those of more do not fit the cache."""


class _Step(Struct, frozen=True, eq=False):
    """From one joint's frame to the next: moved by `offset`, tilted about X, then the joint, which is about Z.

    :param offset: X, Y, Z [m].
    :param tilt: rows: the new Y and Z by the old ones.
    :param angle_offset: constant added to the joint's angle [rad].
    :param is_revolute: whether the joint turns; else it slides.
    :param mass: of the link that the joint carries [kg].
    :param centre: X, Y, Z of its centre of mass in the joint's frame [m].
    """

    offset: tuple[float, ...]
    tilt: tuple[tuple[float, ...], ...]
    angle_offset: float
    is_revolute: bool
    mass: float
    centre: tuple[float, ...]


class _Steps(NamedTuple):
    """A chain by the steps from joint to joint.

    :param first_turn: (3, 3, 1) turn about Z of the root before the first step.
    :param joints: the nv joints.
    :param flange: (3, 4, 1) in the frame of the last joint [m].
    :param revolute_rows: rows of the joints that turn.
    :param angle_offset: (nv, 1) constants added to their angles; the angles of joints that slide [rad].
    :param offset_sine_and_cosine: sine and cosine (nv, 1) of these constants.
    """

    first_turn: Array
    joints: tuple[_Step, ...]
    flange: Array
    revolute_rows: Ints
    angle_offset: Array
    offset_sine_and_cosine: tuple[Array, Array]

    def sines_and_cosines(self, q: Array) -> Iterator[tuple[Array, Array]]:
        """Yield sine and cosine, (n,) or (1,), of the angle of each joint at coordinates q (nv, n) [rad, m]."""
        computed = {}
        if q.shape[1] <= _FEW:
            sines, cosines = sine_and_cosine(q[self.revolute_rows] + self.angle_offset[self.revolute_rows])
            computed = dict(zip(self.revolute_rows.tolist(), zip(sines, cosines, strict=True), strict=True))
        offset_sine, offset_cosine = self.offset_sine_and_cosine
        for row, step in enumerate(self.joints):
            if not step.is_revolute:
                yield offset_sine[row], offset_cosine[row]
            else:
                yield computed.get(row) or sine_and_cosine(q[row] + step.angle_offset)


class Posture(Struct, frozen=True, eq=False):
    """A chain in n configurations; vectors (3, n), or (3, 1) where they are the same for all.

    :param steps: the nv joints.
    :param axis: of each joint.
    :param origin: of each joint [m].
    :param frame: columns X, Y, Z and origin [m] of the last link.
    :param tool: (3, 4, n) or (3, 4, 1) in the frame of the last link [m].
    :param moment: (2, n) mass times X and Y of the centre of mass of each link [kg·m]; empty without weights.
    """

    steps: tuple[_Step, ...]
    axis: list[Array]
    origin: list[Array]
    frame: list[Array]
    tool: Array
    moment: list[Array]

    @property
    def point(self) -> Array:
        """(3, n) position of the tool [m]."""
        return combination(self.frame[:3], self.tool[:, 3]) + self.frame[3]

    @property
    def pose(self) -> Array:
        """(3, 4, n) of the tool [m]."""
        return product(self.frame, self.tool)

    def jacobian(self) -> Array:
        """Return the Jacobian (6, nv, n) of the tool: position [m] and rotation [rad] by each coordinate."""
        point = self.point
        columns = np.zeros((6, len(self.axis), point.shape[-1]))
        for joint, (axis, origin) in enumerate(zip(self.axis, self.origin, strict=True)):
            if self.steps[joint].is_revolute:
                cross(axis, point - origin, out=columns[:3, joint])
                columns[3:, joint] = axis
            else:
                columns[:3, joint] = axis
        return columns

    def weight_torques(self, link: int | None = None) -> Array:
        """Return the torques ∇U_g (nv, n) that hold the weights of the links [N·m], forces of sliding joints [N].

        Needs a posture with moments (`weigh=True`). Gravity is along −Z of the root: the torque on a joint is
        g·(axis × lever)_z, with the lever the mass that it carries times the level distance of its centre.

        :param link: index of the joint whose link alone has a weight; None: all links.
        """
        torque = np.zeros((len(self.axis), self.frame[0].shape[-1]))
        mass, moment = 0.0, np.zeros((2, 1))
        # from the tool to the base: a joint carries its own link and all after it
        for joint in reversed(range(len(torque))):
            if self.steps[joint].mass and link in (None, joint):
                mass, moment = mass + self.steps[joint].mass, moment + self.moment[joint]
            if mass and self.steps[joint].is_revolute:
                (axis_x, axis_y, _), lever = self.axis[joint], moment - mass * self.origin[joint][:2]
                torque[joint] = GRAVITY * (axis_x * lever[1] - axis_y * lever[0])
            elif mass:
                torque[joint] = GRAVITY * mass * self.axis[joint][2]
        return torque


def posture(chain: Chain, q: Array, tool: Array | None = None, *, weigh: bool = False) -> Posture:
    """Return the joint axes, joint origins and tool frames of a chain in n configurations, in the root frame.

    :param q: (nv, n) coordinates [rad, m].
    :param tool: (3, 4, n) or (3, 4, 1) in the flange frame [m]; None: the frames are those of the flange.
    :param weigh: whether to compute the moments of the links' masses, which `Posture.weight_torques` needs.
    """
    steps = _steps(chain)
    # the frame by its columns X, Y, Z
    frame, origin = [*np.moveaxis(steps.first_turn, 1, 0)], np.zeros((3, 1))
    axes, origins, moments = [], [], []
    for step, coordinate, (sine, cosine) in zip(steps.joints, q, steps.sines_and_cosines(q), strict=True):
        if any(step.offset):
            origin = origin + combination(frame, step.offset)
        x, y, z = frame
        y, z = [combination((y, z), factors) for factors in step.tilt]
        axes.append(z)
        origins.append(origin)
        if not step.is_revolute:
            origin = origin + z * coordinate
        frame = [x * cosine + y * sine, y * cosine - x * sine, z]
        if weigh:
            moments.append(step.mass * (origin[:2] + combination([column[:2] for column in frame], step.centre)))
    tool_in_last_link = steps.flange if tool is None else product([*steps.flange.swapaxes(0, 1)], tool)
    return Posture(steps.joints, axes, origins, [*frame, origin], tool_in_last_link, moments)


def tcp(chain: Chain, q: Array, tool: Array) -> tuple[Array, Array]:
    """Return pose and Jacobian of the tool frame.

    :param chain: of `RobotModel`: `nominal`, `actual` or `loaded`.
    :param q: (N, nv) coordinates [rad, m].
    :param tool: (4, 4) or (N, 4, 4) tool frame in the flange frame [m].
    :returns: pose in the root frame (N, 4, 4) [m]; Jacobian (N, 6, nv), rows: position [m], rotation [rad], root axes.
    """
    state = posture(chain, by_coordinate(q), components(tool))
    return matrices(state.pose), state.jacobian().transpose(2, 0, 1)


def tool_pose(chain: Chain, q: Array, tool: Array) -> Array:
    """Return the pose (N, 4, 4) of the tool frame in the root [m]; parameters as of `tcp`."""
    return matrices(posture(chain, by_coordinate(q), components(tool)).pose)


def gravity_torque(chain: Chain, q: Array) -> Array:
    """Return ∇U_g (N, nv): torques [N·m] (forces of sliding joints [N]) that hold the links at q (N, nv) [rad, m]."""
    return posture(chain, by_coordinate(q), weigh=True).weight_torques().T


def by_coordinate(rows: Array) -> Array:
    """Return rows (n, k) as (k, n), each coordinate in contiguous memory."""
    return np.ascontiguousarray(np.transpose(rows), dtype=float)


@lru_cache(maxsize=16)
def _steps(chain: Chain) -> _Steps:
    """Return the steps from the root to the last joint.

    With A_i any rotation that carries Z to the axis of joint i, what is between two joints is a rotation
    A_iᵀ·R·A_(i+1) = Rz(a)·Rx(b)·Rz(c): a adds to the angle of the joint before, c to that of the joint behind.
    """
    rotations = {axis: _upright_rotation(np.frombuffer(axis)) for axis in {axis.tobytes() for axis in chain.axis}}
    upright = [np.eye(3), *(rotations[axis.tobytes()] for axis in chain.axis)]  # A_i, of the root first
    steps: list[_Step] = []
    next_a = 0.0
    for joint in reversed(range(chain.nv)):  # the next joint's a is needed
        parent_axes, joint_axes = upright[joint : joint + 2]
        rotation = parent_axes.T @ chain.placement[joint, :3, :3] @ joint_axes
        sine_b = float(np.hypot(rotation[0, 2], rotation[1, 2]))
        a = float(np.arctan2(rotation[0, 2], -rotation[1, 2])) if sine_b > _ZERO else 0.0
        tilt_and_turn = _about_z(-a) @ rotation  # Rx(b)·Rz(c)
        cosine, sine = tilt_and_turn[2, 2], -tilt_and_turn[1, 2]  # of b
        step = _Step(
            offset=tuple(clean(_about_z(-a) @ (parent_axes.T @ chain.placement[joint, :3, 3])).tolist()),
            tilt=tuple(map(tuple, clean(np.array([[cosine, sine], [-sine, cosine]])).tolist())),
            angle_offset=float(np.arctan2(-tilt_and_turn[0, 1], tilt_and_turn[0, 0])) + next_a,
            is_revolute=bool(chain.is_revolute[joint]),
            mass=float(chain.mass[joint]),
            centre=tuple(clean(_about_z(-next_a) @ joint_axes.T @ chain.centre[joint]).tolist()),
        )
        steps.insert(0, step)
        next_a = a
    angle_offset = np.array([[step.angle_offset] for step in steps])
    return _Steps(
        first_turn=clean(_about_z(next_a))[..., None],
        joints=tuple(steps),
        flange=clean(upright[-1].T @ chain.flange[:3])[..., None],
        revolute_rows=np.flatnonzero(chain.is_revolute),
        angle_offset=angle_offset,
        offset_sine_and_cosine=sine_and_cosine(angle_offset),
    )


def _upright_rotation(axis: Array) -> Array:
    """Return a rotation (3, 3) that carries Z to a unit axis (3,)."""
    least_parallel = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(least_parallel, axis)
    x /= np.sqrt(x @ x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _about_z(angle: float) -> Array:
    """Return the rotation (3, 3) about Z by an angle [rad]."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def clean(values: Array) -> Array:
    """Return values with those within 1e-15 of 0, 1 or −1 set to exactly that: right angles lose their rounding."""
    nearest = np.round(values)
    return np.where((np.abs(values - nearest) < _ZERO) & (np.abs(nearest) <= 1.0), nearest, values)
