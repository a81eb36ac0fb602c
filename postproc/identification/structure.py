"""The elastic model as a function of its parameters: which springs it has, and which of their values are looked for."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.frames import Array
from postproc.program import Ints
from postproc.robot import JointCompliance, LinkSpring, Parameter, RobotModel

LEAST = 1e-12
"""Smallest joint compliance [rad/(N·m)] the equilibrium is solved with; fits may pass through zero."""


class LevelCompliance(JointCompliance, frozen=True):
    """Equivalent compliance of joint 2, compensator included, at one level of q2: the paper's extended set, Eq. (8)."""

    level: int

    @property
    def name(self) -> str:
        """Return e.g. ``k2#3``: in messages only, no file holds it."""
        return f"k{self.index + 1}#{self.level}"


class Structure(Struct, frozen=True, eq=False, dict=True):
    """Which springs the model has and which of their values are looked for.

    :param parameters: (p,) that are identified.
    :param prior: robot, without springs of links, that gives all other values (and geometry, masses, compensator).
    :param levels: (C,) level of q2 of each configuration, for `LevelCompliance`.
    :param in_gears: stiffening gears feel weights and compensator at rest, not the load alone.
    """

    parameters: tuple[Parameter, ...]
    prior: RobotModel
    levels: Ints | None = None
    in_gears: bool = False

    @cached_property
    def template(self) -> RobotModel:
        """The robot with a coordinate for every spring; its gears do not stiffen."""
        plain = replace(self.prior, terms=(), carries_weight=self.in_gears)
        return plain.with_link_springs(p for p in self.parameters if isinstance(p, LinkSpring))

    def active(self, level: int | None) -> list[int]:
        """Return which parameters count at a level of q2."""
        return [
            index
            for index, parameter in enumerate(self.parameters)
            if not isinstance(parameter, LevelCompliance) or parameter.level == level
        ]

    def robot(self, values: Array, level: int | None = None) -> RobotModel:
        """Return the robot with these values of the parameters.

        :param values: (p,) SI.
        :param level: which `LevelCompliance` holds for joint 2.
        """
        robot = self.template.with_values({self.parameters[i]: float(values[i]) for i in self.active(level)})
        joints = list(robot.actuated)
        if (robot.compliance[joints] < LEAST).any():
            stiffness = robot.stiffness.copy()
            stiffness[joints, joints] = 1.0 / np.maximum(robot.compliance[joints], LEAST)
            robot = replace(robot, stiffness=stiffness)
        if level is None:
            return robot
        # the levels hold the compensator's part, about the state of rest as in Eq. (4)
        return replace(robot, compensator=None, subtract_reference=True)

    def usual(self) -> Array:
        """Return usual sizes (p,) of the parameters, SI."""
        return np.array([parameter.usual for parameter in self.parameters])

    @cached_property
    def stated(self) -> tuple[Array, Array]:
        """Values (p,) about which parameters are looked for, and the standard deviations of what the prior states.

        Zero and infinite for those of which the prior says nothing.
        """
        spread = np.array([parameter.spread(self.prior) for parameter in self.parameters])
        return np.where(np.isfinite(spread), self.start(), 0.0), spread

    def start(self) -> Array:
        """Return values (p,) to start from: the prior's, zero for what it does not have."""
        return np.array([parameter.of(self.template) for parameter in self.parameters])
