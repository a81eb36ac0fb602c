"""Closed-form inverse kinematics of arms with parallel axes 2 and 3 and a spherical wrist, and KUKA's status.

The wrist centre fixes A1…A3 (a turn about the vertical, then two bars in a plane), the orientation A4…A6 (Pieper 1968).
A branch 0…7 says which of the two solutions is taken: bit 0, the wrist centre behind A1; bit 1, A3 at or past the
stretched arm; bit 2, A5 on the negative side of where A4 and A6 are in line. On KUKA arms these are the bits of S.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.errors import ModelError
from postproc.frames import Array, sine_and_cosine, wrap_angles
from postproc.kinematics.components import combination, components
from postproc.kinematics.forward import clean, posture, tcp
from postproc.program import Ints
from postproc.robot import Chain, RobotModel

_TOLERANCE = 1e-6
"""Angles [rad] that the closed form must return to count as solved, and sin² between axes that count as parallel
(assumed)."""
_IN_LINE = 1e-6
"""A5 within this of where A4 and A6 are in line [rad] counts as on the side of A5 > 0: its sign is rounding."""
_LEAST_WRIST_SINE = 1e-12
"""Sine of A5 below which only the sum of A4 and A6 means something: A4 is then 0."""


class _ArmAngles(NamedTuple):
    """Angles (n,) of an arm in n configurations [rad].

    :param heading: of the arm's plane about the vertical, from `ClosedForm.axes`.
    :param upper: of the upper arm against the vertical.
    :param elbow: of the forearm against the upper arm.
    """

    heading: Array
    upper: Array
    elbow: Array


class ClosedForm(Struct, frozen=True, eq=False):
    """The nominal geometry, read off at A1…A6 = 0. The plane of the arm is spanned by `ahead` and the vertical.

    Lengths in metres; directions by their components along ahead, across (the axis of A2 up to its sign) and up.

    :param axes: (3, 3) rows: ahead, across, up, in root axes.
    :param base: (3,) a point of the A1 axis at the height of A2.
    :param lateral_offset: distance of the wrist centre from the plane through the A1 axis.
    :param shoulder: distance of A2 ahead of the A1 axis.
    :param upper_arm: from A2 to A3.
    :param forearm: from A3 to the wrist centre.
    :param tilt: (2,) of upper arm and forearm against the vertical [rad].
    :param sign: (3,) of A1, A2, A3 about up, across, across.
    :param wrist: (3, 1) the wrist centre in the flange frame.
    :param wrist_frame: (3, 3) rows: the wrist's own X, Y (along A5), Z (along A4) at zero angles.
    :param wrist_frame_in_flange: (3, 3) columns: the same axes in the flange frame, turned so that Z lies along A6.
    :param bend: minus the A5 at which A4 and A6 are in line [rad]: there A5 + bend is 0.
    """

    axes: Array
    base: Array
    lateral_offset: float
    shoulder: float
    upper_arm: float
    forearm: float
    tilt: Array
    sign: Array
    wrist: Array
    wrist_frame: Array
    wrist_frame_in_flange: Array
    bend: float

    @property
    def stretched_elbow_angle(self) -> float:
        """A3 [rad] of the stretched arm: the wrist centre is on the line through axes 2 and 3."""
        return float(wrap_angles(self.sign[2] * (self.tilt[0] - self.tilt[1])))

    def wrist_distance_ahead_of_a1(self, q: Array) -> Array:
        """Return how far (N,) [m] the wrist centre is ahead of the A1 axis at angles (N, 6) [rad]; < 0 overhead."""
        upper_angle = self.tilt[0] + self.sign[1] * q[:, 1]
        forearm_angle = self.tilt[1] + self.sign[1] * q[:, 1] + self.sign[2] * q[:, 2]
        (upper_sine, _), (forearm_sine, _) = sine_and_cosine(upper_angle), sine_and_cosine(forearm_angle)
        return np.asarray(self.shoulder + self.upper_arm * upper_sine + self.forearm * forearm_sine)

    def elbow_angle_from_stretched(self, q: Array) -> Array:
        """Return A3 minus its value for the stretched arm (N,) [rad], from −π to π, at angles (N, 6) [rad]."""
        return wrap_angles(q[:, 2] - self.stretched_elbow_angle)

    def wrist_angle_from_in_line(self, q: Array) -> Array:
        """Return A5 minus its value where A4 and A6 are in line (N,) [rad], from −π to π, at angles (N, 6) [rad]."""
        return wrap_angles(q[:, 4] + self.bend)

    def branch_of(self, q: Array) -> Ints:
        """Return the branch 0…7 (N,) of joint angles (N, 6) [rad]; if A4 and A6 are in line, that of A5 > 0.

        Bit 0: the wrist centre is behind the A1 axis (overhead). Bit 1: A3 is beyond the stretched arm. Bit 2: the
        wrist is bent to the negative side.
        """
        is_overhead = self.wrist_distance_ahead_of_a1(q) < 0.0
        is_elbow_positive = self.elbow_angle_from_stretched(q) >= 0.0
        is_wrist_negative = self.wrist_angle_from_in_line(q) < -_IN_LINE
        return np.asarray(is_overhead * 1 + is_elbow_positive * 2 + is_wrist_negative * 4, dtype=np.int64)

    def branches(self, pose_flange_in_root: Array) -> Array:
        """Return joint angles (N, 8, 6) [rad] of all branches for flange poses (N, 4, 4) [m]; NaN out of reach."""
        flange = components(pose_flange_in_root)
        return np.stack([self.solve(flange, branch).T for branch in range(8)], axis=1)

    def solve(self, flange: Array, branch: int | Ints) -> Array:
        """Return joint angles (6, n) [rad] of flange poses in the root on branches; NaN out of reach.

        :param flange: (3, 4, n) poses [m], see `components`.
        :param branch: 0…7, one for all or (n,).
        """
        behind_bit, elbow_bit, wrist_bit = (np.asarray(branch) >> bit & 1 for bit in range(3))
        columns = [flange[:, column] for column in range(3)]
        wrist = combination(columns, self.wrist) + flange[:, 3] - self.base[:, None]
        arm = self._arm_angles(self.axes @ wrist, behind_bit, elbow_bit)
        return np.stack(
            [
                self.sign[0] * arm.heading,
                self.sign[1] * (arm.upper - self.tilt[0]),
                self.sign[2] * (arm.elbow + self.tilt[0] - self.tilt[1]),
                *self._wrist_angles(columns, arm, wrist_bit),
            ]
        )

    def _arm_angles(self, wrist: Array, behind_bit: Ints, elbow_bit: Ints) -> _ArmAngles:
        """Return the angles of the arm that bring the wrist centre to a point; NaN out of reach.

        First the heading; then, in the plane of the arm, the triangle of upper arm a, forearm b and the line from A2 to
        the wrist centre, by the law of cosines.

        :param wrist: (3, n) point from `base`, along ahead, across and up [m].
        :param behind_bit: 1 for a wrist centre behind the A1 axis, else 0; one for all or (n,).
        :param elbow_bit: 1 for A3 beyond the stretched arm, else 0; one for all or (n,).
        """
        wrist_x, wrist_y, height = wrist
        a, b = self.upper_arm, self.forearm
        with np.errstate(invalid="ignore"):
            # signed distance from the A1 axis in the plane of the arm: negative behind it
            radius = (1 - 2 * behind_bit) * np.sqrt(wrist_x * wrist_x + wrist_y * wrist_y - self.lateral_offset**2)
            heading = np.arctan2(
                wrist_y * radius - wrist_x * self.lateral_offset, wrist_x * radius + wrist_y * self.lateral_offset
            )
            radius = radius - self.shoulder
            cosine = (radius * radius + height * height - (a * a + b * b)) / (2.0 * a * b)
            sine = self.sign[2] * (2 * elbow_bit - 1) * np.sqrt((1.0 - cosine) * (1.0 + cosine))
        elbow = np.arctan2(sine, cosine)
        arm_length, arm_offset = a + b * cosine, b * sine  # of the wrist centre, along the upper arm and across it
        upper = np.arctan2(radius * arm_length - height * arm_offset, height * arm_length + radius * arm_offset)
        return _ArmAngles(heading, upper, elbow)

    def _wrist_angles(self, columns: Sequence[Array], arm: _ArmAngles, wrist_bit: Ints) -> Sequence[Array]:
        """Return A4, A5 and A6 (n,) [rad], by the orientation of the flange that remains after A1 to A3.

        :param columns: X, Y and Z (3, n) of the flange in the root.
        :param wrist_bit: 1 for a wrist bent to the negative side, else 0; one for all or (n,).
        """
        wrist_axes = np.stack(
            [combination(columns, column[:, None]) for column in self.wrist_frame_in_flange.T], axis=1
        )
        x, y, z = np.tensordot(self.axes, wrist_axes, 1)
        # turned back by A1
        sine, cosine = sine_and_cosine(arm.heading)
        x, y = x * cosine + y * sine, y * cosine - x * sine
        # turned back by A2 and A3
        sine, cosine = sine_and_cosine(arm.upper + arm.elbow - self.tilt[1])
        x, z = x * cosine - z * sine, z * cosine + x * sine
        # m = Rz(A4)·Ry(A5 + bend)·Rz(A6), which states the three angles
        m = np.tensordot(self.wrist_frame, np.stack([x, y, z]), 1)
        wrist_sine = np.sqrt(m[0, 2] * m[0, 2] + m[1, 2] * m[1, 2])
        is_unique = wrist_sine > _LEAST_WRIST_SINE
        factor = (1 - 2 * wrist_bit) / np.where(is_unique, wrist_sine, 1.0)
        cosine_a4 = np.where(is_unique, m[0, 2] * factor, 1.0)
        sine_a4 = np.where(is_unique, m[1, 2] * factor, 0.0)
        return (
            np.arctan2(sine_a4, cosine_a4),
            np.arctan2(cosine_a4 * m[0, 2] + sine_a4 * m[1, 2], m[2, 2]) - self.bend,
            np.arctan2(cosine_a4 * m[1, 0] - sine_a4 * m[0, 0], cosine_a4 * m[1, 1] - sine_a4 * m[0, 1]),
        )


@lru_cache(maxsize=16)
def closed_form(robot: RobotModel) -> ClosedForm:
    """Return the closed form of the inverse kinematics of a robot, by the axes of its nominal geometry at zero angles.

    It is tried on 20 configurations.

    :raises ModelError: the arm has no vertical A1, no parallel A2 and A3, or no spherical wrist: forward and
        inverse kinematics do not agree.
    """
    chain = robot.nominal
    form = _form_at_zero_angles(chain)
    q = np.sin(np.arange(120.0)).reshape(20, 6)  # spread evenly enough
    with np.errstate(divide="ignore", invalid="ignore"):
        solution = form.solve(components(tcp(chain, q, np.eye(4))[0]), form.branch_of(q)).T
    if not np.abs(wrap_angles(solution - q)).max() < _TOLERANCE:  # NaN too is no solution
        raise ModelError(
            f"robot {robot.name}: not an arm with vertical A1, parallel A2 and A3 and a spherical wrist",
            advice="Only such arms (all common KUKA six-axis robots) are supported.",
        )
    return form


def _form_at_zero_angles(chain: Chain) -> ClosedForm:
    """Return the lengths and directions of a chain of six joints at zero angles; the chain need not have this form."""
    zero = posture(chain, np.zeros((6, 1)))
    axis = np.array([vector[:, 0] for vector in zero.axis])
    origin = np.array([vector[:, 0] for vector in zero.origin])
    flange = zero.pose[..., 0]
    up = np.array([0.0, 0.0, 1.0])
    y_axis = axis[1]
    x_axis = np.cross(y_axis, up)
    if (origin[1] - origin[0]) @ x_axis < 0.0:  # A2 is ahead of A1
        y_axis, x_axis = -y_axis, -x_axis
    axes = np.array([x_axis, y_axis, up])
    # the wrist centre is where the axes of A4 and A5 cross; the bars are upper arm and forearm
    wrist = _crossing(origin[3], axis[3], origin[4], axis[4])
    bars = np.array([origin[2] - origin[1], wrist - origin[2]]) @ axes.T
    wrist_axes = np.array([np.cross(axis[4], axis[3]), axis[4], axis[3]])
    bend = float(np.arctan2(axis[5] @ wrist_axes[0], axis[5] @ wrist_axes[2]))
    about_y = np.array([[np.cos(bend), 0, np.sin(bend)], [0, 1, 0], [-np.sin(bend), 0, np.cos(bend)]])
    return ClosedForm(
        axes=axes,
        base=np.append(origin[0, :2], origin[1, 2]),
        lateral_offset=float((wrist - origin[0]) @ y_axis),
        shoulder=float((origin[1] - origin[0]) @ x_axis),
        upper_arm=float(np.hypot(bars[0, 0], bars[0, 2])),
        forearm=float(np.hypot(bars[1, 0], bars[1, 2])),
        tilt=np.arctan2(bars[:, 0], bars[:, 2]),
        sign=np.sign([axis[0] @ up, axis[1] @ y_axis, axis[2] @ y_axis]),
        wrist=clean(flange[:, :3].T @ (wrist - flange[:, 3])[:, None]),
        wrist_frame=clean(wrist_axes @ axes.T),
        wrist_frame_in_flange=clean(flange[:, :3].T @ wrist_axes.T @ about_y),
        bend=bend,
    )


def _crossing(p: Array, u: Array, r: Array, v: Array) -> Array:
    """Return the point of the line p + s·u that is nearest to the line r + t·v, each (3,); r if they are parallel."""
    normal = np.cross(u, v)
    if normal @ normal < _TOLERANCE:
        return r
    point: Array = p + u * (np.cross(r - p, v) @ normal) / (normal @ normal)
    return point


def status_of(robot: RobotModel, q: Array) -> Ints:
    """Return KUKA's status S (N,) of joint angles (N, 6) [rad].

    Bits 0 and 1 are those of the branch. Bit 2 is set if A5 is negative, without the tolerance of `branch_of`.

    :raises ModelError: the robot has no closed form.
    """
    bits_0_and_1 = closed_form(robot).branch_of(q) & 3
    return np.asarray(bits_0_and_1 | (q[:, 4] < 0.0) * 4)
