"""What the gears feel at rest: the masses of the links, and the size of the compensator's torque.

A gear that does not give way in proportion to the torque shows its working point, and with it the weights and the
compensator that press on it before any load does. Both are known only roughly, as the model states them; in a fit they
are parameters about the stated value, with its standard deviation.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, ClassVar, Self

from postproc.compensator import Compensator
from postproc.frames import Array
from postproc.robot.compensator_parameters import CompensatorStiffness
from postproc.robot.model_file import JOINTS, ModelFile
from postproc.robot.parameter import Parameter

if TYPE_CHECKING:
    from postproc.robot.model import RobotModel

_SUFFIX = ".mass"


class LinkMass(Parameter, frozen=True):
    """Mass of the link that a joint carries, its centre as stated: ``A2.mass`` [kg]; the payload is no part."""

    joint: str
    per_si: ClassVar[float] = 1.0

    @property
    def index(self) -> int:
        """Return the number of the joint, from 0."""
        return JOINTS.index(self.joint)

    @property
    def place(self) -> str:
        """Return the joint."""
        return self.joint

    @property
    def name(self) -> str:
        """Return e.g. ``A2.mass``."""
        return self.joint + _SUFFIX

    @property
    def title(self) -> str:
        """Return the link in words."""
        return f"mass of the link of {self.joint}"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "kg"

    @property
    def usual(self) -> float:
        """Return a usual size [kg]."""
        return 100.0

    @classmethod
    def named(cls, name: str) -> Self | None:
        """Return the mass of a name like ``A2.mass``."""
        joint = name.removesuffix(_SUFFIX)
        return cls(joint) if joint in JOINTS and name.endswith(_SUFFIX) else None

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the masses of [masses], which stand for those of robot.urdf."""
        for joint in JOINTS:
            mass = None if content.masses is None else getattr(content.masses, f"{joint}_kg")
            if mass is not None:
                yield cls(joint), mass

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Write into [masses]."""
        tables["masses"][f"{self.joint}_kg"] = max(value, 0.0)

    def row(self, robot: RobotModel) -> int:
        """Return the coordinate behind which the mass sits: the last spring where the link begins, or its joint."""
        begins = sum(spring.link == self.joint and not spring.at_end for spring in robot.link_springs)
        return robot.actuated[self.index] + begins

    def of(self, robot: RobotModel) -> float:
        """Return the mass [kg]."""
        return float(robot.nominal.mass[self.index])

    def spread(self, robot: RobotModel) -> float:
        """Return the standard deviation with which the model states it [kg]."""
        return robot.mass_spread * self.of(robot)


class CompensatorSize(CompensatorStiffness, frozen=True):
    """K_c at a free length s₀ that stays [N/m]: how strong the compensator is in all."""

    def partners(self) -> tuple[Parameter, ...]:
        """Return none."""
        return ()

    def spread(self, robot: RobotModel) -> float:
        """Return the standard deviation with which the model states it [N/m]."""
        return robot.compensator_spread * self.of(robot)

    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return U_c′ and U_c″ of a spring of 1 N/m."""
        gradient, stiffness = law.gradient_columns(q2), law.stiffness_columns(q2)
        return (
            gradient[..., 0] + law.free_length * gradient[..., 1],
            stiffness[..., 0] + law.free_length * stiffness[..., 1],
        )
