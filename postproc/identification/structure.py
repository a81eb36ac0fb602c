"""The elastic model as a function of its parameters: its springs, and the values to be identified."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.frames import Array
from postproc.program import Ints
from postproc.robot import JointCompliance, LinkSpring, Parameter, RobotModel

LEAST = 1e-12
"""Smallest joint compliance [rad/(N·m)] for which the equilibrium is solved; fits may pass through zero."""


class LevelCompliance(JointCompliance, frozen=True):
    """Equivalent compliance of joint 2, compensator included, at one level of q2: the paper's extended set, Eq. (8)."""

    level: int

    @property
    def name(self) -> str:
        """Return e.g. ``k2#3``; used in messages only, never in files."""
        return f"k{self.index + 1}#{self.level}"


class Structure(Struct, frozen=True, eq=False, dict=True):
    """The springs of a model and the parameters to be identified.

    :param parameters: (p,) to be identified.
    :param prior: robot, without springs of links, that gives all other values (and geometry, masses, compensator).
    :param levels: (C,) level of q2 of each configuration, for `LevelCompliance`.
    :param in_gears: stiffening gears follow the torque of weights and compensator too, not the load alone.
    """

    parameters: tuple[Parameter, ...]
    prior: RobotModel
    levels: Ints | None = None
    in_gears: bool = False

    @cached_property
    def template(self) -> RobotModel:
        """The prior with a coordinate for every spring to be identified, and linear gears."""
        plain = replace(self.prior, terms=(), carries_weight=self.in_gears)
        return plain.with_link_springs(p for p in self.parameters if isinstance(p, LinkSpring))

    def active(self, level: int | None) -> list[int]:
        """Return the indices of the parameters that act at a level of q2."""
        return [
            index
            for index, parameter in enumerate(self.parameters)
            if not isinstance(parameter, LevelCompliance) or parameter.level == level
        ]

    def robot(self, values: Array, level: int | None = None) -> RobotModel:
        """Return the robot with these values of the parameters.

        :param values: (p,) SI.
        :param level: level of q2 whose `LevelCompliance` applies to joint 2; None: no levels.
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
        """Return typical magnitudes (p,) of the parameters, SI, for scaling."""
        return np.array([parameter.usual for parameter in self.parameters])

    @cached_property
    def stated(self) -> tuple[Array, Array]:
        """Prior means (p,) and prior standard deviations (p,), SI.

        A parameter whose uncertainty the prior does not state has mean 0 and an infinite standard deviation.
        """
        spread = np.array([self.prior.prior_sigma(parameter) for parameter in self.parameters])
        return np.where(np.isfinite(spread), self.start(), 0.0), spread

    def start(self) -> Array:
        """Return start values (p,), SI: those of the prior, 0 for springs that it does not have."""
        return np.array([self.template.value(parameter) for parameter in self.parameters])
