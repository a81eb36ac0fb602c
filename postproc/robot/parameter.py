"""What a parameter of the elastic model has to say of itself.

The model is linear in each of them. A `Spring` parameter adds to the deflection of one coordinate its value times a
function of the torque there; a `CompensatorTorque` takes its value times a function of q2 from the torque on joint 2.
Inside values are SI. Files hold what a workshop asks for (the whole compliance of a joint, the free length s₀), which
`in_file` makes of the linear values.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from msgspec import Struct

from postproc.compensator import Compensator
from postproc.errors import ModelError
from postproc.frames import Array
from postproc.robot.model_file import JOINTS, ModelFile

if TYPE_CHECKING:
    from postproc.robot.model import RobotModel

PER_URAD = 1e6
"""µrad, or µm, in one SI unit."""
A2 = "A2"
"""The joint that the compensator stands beside."""


class Parameter(Struct, frozen=True):
    """A value of the elastic model that can be identified.

    `per_si`: units of the file in one SI unit. `sparse`: one of many among which some are looked for: fitted ≥ 0 and
    with a ridge, and left out of files where it is zero.
    """

    per_si: ClassVar[float] = PER_URAD
    sparse: ClassVar[bool] = False

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "urad/(N·m)"

    @property
    def usual(self) -> float:
        """Return a usual size, SI."""
        return 1e-6

    @property
    @abstractmethod
    def name(self) -> str:
        """Name in files: [covariance] of `model.toml`, `identification.json`."""

    @property
    def symbol(self) -> str:
        """What messages call the value that is fitted."""
        return self.name

    @property
    def title(self) -> str:
        """Heading in reports."""
        return self.name

    @property
    @abstractmethod
    def place(self) -> str:
        """Joint or link that it belongs to."""

    @classmethod
    @abstractmethod
    def named(cls, name: str) -> Self | None:
        """Return the parameter of this kind that a file calls so, or None."""

    @classmethod
    @abstractmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the parameters of this kind that a model file holds, with their (linear) values, SI."""

    @abstractmethod
    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Put the value and the half width of its 95 % interval, in units of the file, into tables of model.toml."""

    @abstractmethod
    def row(self, robot: RobotModel) -> int:
        """Return the coordinate of the elastic chain that it moves.

        :raises ModelError: this robot does not have it.
        """

    @abstractmethod
    def of(self, robot: RobotModel) -> float:
        """Return its value in a robot, SI."""

    def spread(self, robot: RobotModel) -> float:
        """Return the standard deviation with which a robot states it, SI; infinite where readings alone tell it."""
        return np.inf

    def partners(self) -> tuple[Parameter, ...]:
        """Return the parameters besides which its value in files is told."""
        return ()

    def in_file(self, given: Mapping[Parameter, float]) -> tuple[float, dict[Parameter, float]]:
        """Return the value in units of the file, and its derivatives by the linear values `given` (SI)."""
        return self.per_si * given[self], {self: self.per_si}


class Spring(Parameter, frozen=True):
    """A parameter that adds to the deflection of one coordinate.

    `linear`: it grows with the torque. `is_compliance`: its slope at small torque is part of the spring's compliance.
    `feels_rest`: what is not linear depends on the torque at rest and that of the load together.
    """

    linear: ClassVar[bool] = True
    is_compliance: ClassVar[bool] = True
    feels_rest: ClassVar[bool] = True

    def effect(self, torque: Array, rest: Array) -> tuple[Array, Array]:
        """Return deflection (N,) per unit of the parameter, and its derivative by the torque.

        :param torque: (N,) on the spring, beyond `rest` (N,), where the deflection is zero [N·m, N].
        """
        return torque, np.ones_like(torque)


class CompensatorTorque(Parameter, frozen=True):
    """A parameter of the compensator's spring, which takes a torque from joint 2."""

    @abstractmethod
    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return the torque U_c′ (N,) and the stiffness U_c″ per unit of the parameter at q2 (N,) [rad]."""

    @property
    def usual(self) -> float:
        """Return a usual size [N/m, N]."""
        return 1e6

    @property
    def place(self) -> str:
        """Return the compensator."""
        return f"the compensator at {A2}"

    @classmethod
    def named(cls, name: str) -> Self | None:
        """Return the parameter if the name is its."""
        return cls() if name == cls().name else None

    def row(self, robot: RobotModel) -> int:
        """Return the coordinate of joint 2."""
        if robot.compensator is None:
            raise missing(self)
        return robot.actuated[JOINTS.index(A2)]


def missing(parameter: Parameter) -> ModelError:
    """Return the error of a robot that does not have a parameter."""
    return ModelError(f"[covariance] names {parameter.name!r}, which the model does not have")
