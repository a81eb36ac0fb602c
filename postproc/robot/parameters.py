"""The parameters of the elastic model, one class for each kind: names and units in files, effect, place in model.toml.

The model is linear in each of them. A `Spring` parameter adds to the deflection of one coordinate its value times a
function of the torque there; a `CompensatorTorque` takes its value times a function of q2 from the torque on joint 2.
Inside values are SI. Files hold what a workshop asks for (the whole compliance of a joint, the free length s₀), which
`in_file` makes of the linear values; names are made and read in this module only.

A further kind is a class in `KINDS` that fulfils `Spring`; identification, bound and report ask the objects.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from postproc.compensator import Compensator
from postproc.errors import ModelError
from postproc.frames import MM_PER_M, Array
from postproc.robot.model_file import BASE, JOINTS, ModelFile

if TYPE_CHECKING:
    from postproc.robot import RobotModel

PER_URAD = 1e6
"""µrad, or µm, in one SI unit."""
LINK_AXES = ("X", "Y", "Z", "RX", "RY", "RZ", "end_RX", "end_RY", "end_RZ")
A2 = "A2"
"""The joint that the compensator stands beside."""


class Parameter(ABC):
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

    def partners(self) -> tuple[Parameter, ...]:
        """Return the parameters besides which its value in files is told."""
        return ()

    def in_file(self, given: Mapping[Parameter, float]) -> tuple[float, dict[Parameter, float]]:
        """Return the value in units of the file, and its derivatives by the linear values `given` (SI)."""
        return self.per_si * given[self], {self: self.per_si}


class Spring(Parameter):
    """A parameter that adds to the deflection of one coordinate."""

    linear: ClassVar[bool] = True

    def effect(self, torque: Array, rest: Array) -> tuple[Array, Array]:
        """Return deflection (N,) per unit of the parameter, and its derivative by the torque.

        :param torque: (N,) on the spring, beyond `rest` (N,), where the deflection is zero [N·m, N].
        """
        return torque, np.ones_like(torque)


class CompensatorTorque(Parameter):
    """A parameter of the compensator's spring, which takes a torque from joint 2."""

    @abstractmethod
    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return the torque U_c′ (N,) and the stiffness U_c″ per unit of the parameter at q2 (N,) [rad]."""

    @property
    def usual(self) -> float:
        """Return a usual size [N/m, N]."""
        return 1e6

    @classmethod
    def named(cls, name: str) -> Self | None:
        """Return the parameter if the name is its."""
        return cls() if name == cls().name else None

    def row(self, robot: RobotModel) -> int:
        """Return the coordinate of joint 2."""
        if robot.compensator is None:
            raise _missing(self)
        return robot.actuated[JOINTS.index(A2)]


@dataclass(frozen=True, slots=True)
class JointCompliance(Spring):
    """Compliance of a joint that does not fade: ``k1`` … ``k6``; in files that at small torque, with what fades."""

    joint: str

    @property
    def index(self) -> int:
        """Return the number of the joint, from 0."""
        return JOINTS.index(self.joint)

    @property
    def name(self) -> str:
        """Return e.g. ``k1``."""
        return f"k{self.index + 1}"

    @classmethod
    def named(cls, name: str) -> Self | None:
        """Return the compliance of a joint."""
        return next((cls(joint) for joint in JOINTS if name == cls(joint).name), None)

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the compliances of [joints], less what fades."""
        for joint in JOINTS:
            spring = content.joints[joint]
            fades = sum(part.compliance_urad_per_Nm for part in spring.stiffening)
            yield cls(joint), (spring.compliance_urad_per_Nm - fades) / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Write [joints.A1]."""
        tables["joints"][self.joint] = {"source": source, "compliance_urad_per_Nm": value, "ci95": half}

    def row(self, robot: RobotModel) -> int:
        """Return the coordinate of the joint."""
        return robot.actuated[self.index]

    def of(self, robot: RobotModel) -> float:
        """Return what of the joint's compliance does not fade."""
        return float(robot.steady[self.row(robot)])

    def in_file(self, given: Mapping[Parameter, float]) -> tuple[float, dict[Parameter, float]]:
        """Return the compliance at small torque, fading parts included."""
        slopes = dict.fromkeys((p for p in given if p == self or self in p.partners()), self.per_si)
        return sum(slope * given[p] for p, slope in slopes.items()), slopes


@dataclass(frozen=True, slots=True)
class FadingPart(Spring):
    """Part of a joint's compliance that fades as the torque grows beyond `torque` [N·m]: ``k1@800``.

    Deflection T·(f(u) − f(u₀)) with f = asinh, u = (torque + rest)/T, u₀ = rest/T: a sum of such parts follows any gear
    whose compliance falls with load; every part stays monotone, so that the spring is always stable.
    """

    joint: str
    torque: float
    sparse: ClassVar[bool] = True
    linear: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """Return e.g. ``k1@800``."""
        return f"{JointCompliance(self.joint).name}@{self.torque:g}"

    @property
    def title(self) -> str:
        """Return joint and torque in words."""
        return f"{JointCompliance(self.joint).name}, fades beyond {self.torque:g} N·m"

    @classmethod
    def named(cls, name: str) -> Self | None:
        """Return the part of a name like ``k6@6.2``."""
        head, _, torque = name.partition("@")
        whole = JointCompliance.named(head)
        try:
            return None if whole is None else cls(whole.joint, float(torque))
        except ValueError:
            return None

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield `stiffening` of [joints]."""
        for joint in JOINTS:
            for part in content.joints[joint].stiffening:
                yield cls(joint, part.torque_Nm), part.compliance_urad_per_Nm / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Add to `stiffening` of the joint."""
        part = {"torque_Nm": self.torque, "compliance_urad_per_Nm": value}
        tables["joints"][self.joint].setdefault("stiffening", []).append(part)

    def row(self, robot: RobotModel) -> int:
        """Return the coordinate of the joint."""
        return JointCompliance(self.joint).row(robot)

    def of(self, robot: RobotModel) -> float:
        """Return how much of the joint's compliance fades there; zero if the robot has no such part."""
        return dict(robot.terms).get(self, 0.0)

    def partners(self) -> tuple[Parameter, ...]:
        """Return the compliance of the joint, which contains the part."""
        return (JointCompliance(self.joint),)

    def effect(self, torque: Array, rest: Array) -> tuple[Array, Array]:
        """Return T·(f(u) − f(u₀)) and f′(u)."""
        u0 = rest / self.torque
        u = torque / self.torque + u0
        return self.torque * (np.arcsinh(u) - np.arcsinh(u0)), 1.0 / np.sqrt(1.0 + u**2)


@dataclass(frozen=True, slots=True)
class LinkSpring(Spring):
    """Spring of a link: ``A2.RX``. `link` is base, A1…A6; `axis` X, Y, Z, RX, RY, RZ or end_RX, end_RY, end_RZ."""

    link: str
    axis: str
    sparse: ClassVar[bool] = True

    @property
    def slides(self) -> bool:
        """Return whether it is a translation."""
        return self.axis in LINK_AXES[:3]

    @property
    def at_end(self) -> bool:
        """Return whether it stands where the link ends."""
        return self.axis in LINK_AXES[6:]

    @property
    def direction(self) -> Array:
        """Return the unit axis (3,) of the joint frame along or about which it gives way."""
        return np.asarray(np.eye(3)[LINK_AXES.index(self.axis) % 3])

    @property
    def name(self) -> str:
        """Return e.g. ``A2.RX``."""
        return f"{self.link}.{self.axis}"

    @property
    def unit(self) -> str:
        """Return the unit in files."""
        return "um/N" if self.slides else "urad/(N·m)"

    @property
    def usual(self) -> float:
        """Return a usual compliance [m/N, rad/(N·m)]."""
        return 1e-8 if self.slides else 1e-6

    @property
    def key(self) -> str:
        """Return the key in [links.A2] of model.toml."""
        return f"{self.axis}_{'um_per_N' if self.slides else 'urad_per_Nm'}"

    @classmethod
    def named(cls, name: str) -> Self | None:
        """Return the spring of a name like ``A2.end_RX``."""
        link, _, axis = name.partition(".")
        return cls(link, axis) if link in (BASE, *JOINTS) and axis in LINK_AXES else None

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the springs of [links] that are not rigid, in the order of the chain."""
        for spring in (cls(link, axis) for link in (BASE, *JOINTS) for axis in LINK_AXES if link in content.links):
            value = getattr(content.links[spring.link], spring.key)
            if value > 0.0:
                yield spring, value / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Write one direction of [links.A2]."""
        tables["links"].setdefault(self.link, {"source": source})[self.key] = value

    def row(self, robot: RobotModel) -> int:
        """Return the spring's own coordinate."""
        if self not in robot.link_springs:
            raise _missing(self)
        return robot.passive[robot.link_springs.index(self)]

    def of(self, robot: RobotModel) -> float:
        """Return its compliance; zero if the link is rigid there."""
        return float(robot.steady[self.row(robot)]) if self in robot.link_springs else 0.0


@dataclass(frozen=True, slots=True)
class CompensatorStiffness(CompensatorTorque):
    """K_c of the compensator's spring [N/m], at a preload K_c·s₀ that does not change with it."""

    per_si: ClassVar[float] = 1.0

    @property
    def name(self) -> str:
        """Return ``K_c``."""
        return "K_c"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "N/m"

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield K_c of [compensator]."""
        if content.compensator is not None:
            yield cls(), content.compensator.stiffness_N_per_m

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Write into [compensator]."""
        tables["compensator"] |= {"stiffness_N_per_m": max(value, 0.0), "source": source, "assumed": False}

    def of(self, robot: RobotModel) -> float:
        """Return K_c; zero without compensator."""
        return 0.0 if robot.compensator is None else robot.compensator.stiffness

    def partners(self) -> tuple[Parameter, ...]:
        """Return the preload: in files K_c stands beside s₀."""
        return (CompensatorPreload(),)

    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return U_c′ and U_c″ of a spring of 1 N/m without free length."""
        return law.gradient_columns(q2)[..., 0], law.stiffness_columns(q2)[..., 0]


@dataclass(frozen=True, slots=True)
class CompensatorPreload(CompensatorTorque):
    """K_c·s₀ of the compensator's spring [N]; in files the free length s₀: ``s_0`` [mm]."""

    per_si: ClassVar[float] = MM_PER_M

    @property
    def name(self) -> str:
        """Return ``s_0``."""
        return "s_0"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "mm"

    @property
    def symbol(self) -> str:
        """Return what is fitted."""
        return "K_c*s_0"

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield K_c·s₀ of [compensator]."""
        if (entry := content.compensator) is not None:
            yield cls(), entry.stiffness_N_per_m * entry.free_length_mm / MM_PER_M

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Write into [compensator]."""
        tables["compensator"]["free_length_mm"] = max(value, 0.0)

    def of(self, robot: RobotModel) -> float:
        """Return K_c·s₀; zero without compensator."""
        return 0.0 if robot.compensator is None else robot.compensator.stiffness * robot.compensator.free_length

    def partners(self) -> tuple[Parameter, ...]:
        """Return the stiffness, by which files divide."""
        return (CompensatorStiffness(),)

    def in_file(self, given: Mapping[Parameter, float]) -> tuple[float, dict[Parameter, float]]:
        """Return s₀ [mm]; zero where there is no spring to have one."""
        stiffness, preload = given[CompensatorStiffness()], given[self]
        if stiffness <= 0.0:
            return 0.0, {}
        slopes: dict[Parameter, float] = {
            self: MM_PER_M / stiffness,
            CompensatorStiffness(): -MM_PER_M * preload / stiffness**2,
        }
        return MM_PER_M * preload / stiffness, slopes

    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return what U_c′ and U_c″ gain with each newton of preload."""
        return law.gradient_columns(q2)[..., 1], law.stiffness_columns(q2)[..., 1]


KINDS: tuple[type[Parameter], ...] = (
    JointCompliance,
    FadingPart,
    LinkSpring,
    CompensatorStiffness,
    CompensatorPreload,
)
"""All kinds of parameters that files may name."""
JOINT_COMPLIANCES = tuple(JointCompliance(joint) for joint in JOINTS)
COMPENSATOR: tuple[Parameter, ...] = (CompensatorStiffness(), CompensatorPreload())


def named(name: str) -> Parameter | None:
    """Return the parameter that files call so, or None.

    >>> named("k6@6.2")
    FadingPart(joint='A6', torque=6.2)
    """
    return next((found for kind in KINDS if (found := kind.named(name)) is not None), None)


def stated(content: ModelFile) -> dict[Parameter, float]:
    """Return all parameters that a model file holds, with their linear values, SI."""
    return {parameter: value for kind in KINDS for parameter, value in kind.stated(content)}


def file_slopes(parameters: Iterable[Parameter], given: Mapping[Parameter, float]) -> Array:
    """Return ∂(values in units of the file)/∂(linear values) (n, n) of parameters whose partners are among them."""
    order = list(parameters)
    out = np.zeros((len(order), len(order)))
    for row, parameter in enumerate(order):
        for other, slope in parameter.in_file(given)[1].items():
            out[row, order.index(other)] = slope
    return out


def _missing(parameter: Parameter) -> ModelError:
    return ModelError(f"[covariance] names {parameter.name!r}, which the model does not have")
