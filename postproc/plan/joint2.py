"""Compliance of joint 2 between the levels of q2 where it is measured: second step of the paper, Eq. (4), (9), (10)."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.compensator import Compensator
from postproc.frames import Array
from postproc.robot import RobotModel

_LEVELS = 3


class Joint2(Struct, frozen=True, eq=False):
    """Equivalent spring of joint 2, relative to the compliance of its gear.

    :param compliance: of the gear, 1/K⁰_θ2 [rad/(N·m)].
    :param compensator: its law, or None.
    :param free: K_c and s₀ are identified too; else they stay at the robot's values.
    """

    compliance: float
    compensator: Compensator | None
    free: bool

    @classmethod
    def of(cls, robot: RobotModel, free: bool) -> Joint2:
        """Take joint 2 of a robot."""
        compliance = float(robot.compliance[robot.actuated[1]])
        return cls(compliance, robot.compensator, free and robot.compensator is not None)

    def relative(self, q2: Array) -> Array:
        """Return k2(q2) (n,) in units of the gear's compliance, Eq. (4)."""
        if self.compensator is None:
            return np.ones(len(q2))
        return np.asarray(1.0 / (1.0 + self.compliance * self.compensator.stiffness_about_joint(q2)))

    def columns(self, q2: Array) -> Array:
        """Return C (n, 3) of the printed first Eq. (10): K_θ2(q2) = C·[K⁰_θ2, K_c, s₀K_c]."""
        if self.compensator is None:
            return np.column_stack([np.ones(len(q2)), np.zeros((len(q2), 2))])
        return np.column_stack([np.ones(len(q2)), self.compensator.stiffness_columns(q2)])

    def from_levels(self, levels: Array, q2: Array) -> Array:
        """Return ∂k2(q2)/∂k2(levels), (n, m): how errors of the levels reach other q2, by Eq. (9) unweighted.

        With fewer than three levels the compensator cannot be told apart and stays at the prior.
        """
        here, there = self.relative(q2), self.relative(levels)
        if self.free and len(levels) >= _LEVELS:
            c = self.columns(levels)
            size = np.linalg.norm(c, axis=0)
            share = (self.columns(q2) / size) @ np.linalg.pinv(c / size, rcond=1e-9)
        else:
            share = np.full((len(q2), len(levels)), 1.0 / len(levels))
        return np.asarray(here[:, None] ** 2 * share / there**2)

    def parameters(self, q2: Array) -> Array:
        """Return ∂k2(q2)/∂parameters (n, 1 or 3): relative gear compliance, then K_c and s₀K_c in units of K⁰_θ2."""
        here = self.relative(q2)[:, None] ** 2
        if not self.free:
            return here
        return np.concatenate([here, -here * self.columns(q2)[:, 1:]], axis=1)
