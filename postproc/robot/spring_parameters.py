"""Parameters of springs: compliance of a joint, the parts of it that fade with load, backlash, spring of a link."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from postproc.frames import Array
from postproc.robot.model_file import BASE, JOINTS, ModelFile
from postproc.robot.parameter import PER_URAD, Parameter, Spring, missing

if TYPE_CHECKING:
    from postproc.robot.model import RobotModel

LINK_AXES = ("X", "Y", "Z", "RX", "RY", "RZ", "end_RX", "end_RY", "end_RZ")


class JointCompliance(Spring, frozen=True):
    """Compliance of a joint that does not fade: ``k1`` … ``k6``; in files that at small torque, with what fades."""

    joint: str

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
            yield cls(joint), (spring.compliance_urad_per_Nm - spring.fades) / PER_URAD

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


class FadingPart(Spring, frozen=True):
    """Part of a joint's compliance that fades as the torque grows beyond `torque` [N·m]: ``k1@800``.

    Deflection T·(f(u) − f(u₀)) with f = asinh, u = (torque + rest)/T, u₀ = rest/T: a sum of such parts follows any gear
    whose compliance falls with load; every part stays monotone, so that the spring is always stable.
    """

    joint: str
    torque: float
    sparse: ClassVar[bool] = True
    linear: ClassVar[bool] = False
    mark: ClassVar[str] = "@"
    """Stands between joint and torque in names."""
    key: ClassVar[str] = "stiffening"
    """Where such parts stand in [joints] of model.toml."""

    @property
    def place(self) -> str:
        """Return the joint."""
        return self.joint

    @property
    def name(self) -> str:
        """Return e.g. ``k1@800``."""
        return f"{JointCompliance(self.joint).name}{self.mark}{self.torque:g}"

    @property
    def title(self) -> str:
        """Return joint and torque in words."""
        return f"{JointCompliance(self.joint).name}, fades beyond {self.torque:g} N·m"

    @classmethod
    def named(cls, name: str) -> Self | None:
        """Return the part of a name like ``k6@6.2``, with the mark of the class."""
        head, _, torque = name.partition(cls.mark)
        whole = JointCompliance.named(head)
        try:
            return None if whole is None else cls(whole.joint, float(torque))
        except ValueError:
            return None

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the parts that stand under `key` of [joints]."""
        for joint in JOINTS:
            for part in getattr(content.joints[joint], cls.key):
                yield cls(joint, part.torque_Nm), part.compliance_urad_per_Nm / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Add to `key` of the joint."""
        part = {"torque_Nm": self.torque, "compliance_urad_per_Nm": value}
        tables["joints"][self.joint].setdefault(self.key, []).append(part)

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


class Knee(FadingPart, frozen=True):
    """Part of a joint's compliance that ends where the torque passes `torque` [N·m]: ``k1^800``.

    Deflection T·(f(u) − f(u₀)) with f = u/(1 + u⁴)^¼ and u, u₀ as in `FadingPart`: it grows as a spring's up to T and
    stays there. Any gear whose compliance falls with load is a sum of such parts, one with a knee too, and beyond the
    last knee the sum is a straight line.
    """

    mark: ClassVar[str] = "^"
    key: ClassVar[str] = "knees"

    @property
    def title(self) -> str:
        """Return joint and torque in words."""
        return f"{JointCompliance(self.joint).name}, up to {self.torque:g} N·m"

    def effect(self, torque: Array, rest: Array) -> tuple[Array, Array]:
        """Return T·(f(u) − f(u₀)) and f′(u)."""
        u0 = rest / self.torque
        u = torque / self.torque + u0
        there, here = 1.0 + u**4, 1.0 + u0**4
        return self.torque * (u / there**0.25 - u0 / here**0.25), there**-1.25


class Backlash(Spring, frozen=True):
    """Backlash of a gear: it lies off to the side to which it is pressed, ``A4.backlash`` [rad].

    Deflection tanh(v) − tanh(v₀) with v = (torque + rest)/T, v₀ = rest/T; T [N·m] is small: it says over which torque
    the gear turns over to its other flank.
    """

    joint: str
    torque: float
    sparse: ClassVar[bool] = True
    linear: ClassVar[bool] = False
    is_compliance: ClassVar[bool] = False
    key: ClassVar[str] = "backlash"
    """Where it stands in [joints] of model.toml, and between joint and torque in names."""

    @property
    def place(self) -> str:
        """Return the joint."""
        return self.joint

    @property
    def name(self) -> str:
        """Return e.g. ``A4.backlash@3``."""
        return f"{self.joint}.{self.key}@{self.torque:g}"

    @property
    def title(self) -> str:
        """Return the joint in words."""
        return f"{self.key.replace('_', ' ')} of {self.joint}"

    @property
    def unit(self) -> str:
        """Return the unit in files."""
        return "urad"

    @property
    def usual(self) -> float:
        """Return a usual size [rad]."""
        return 2e-5

    @classmethod
    def named(cls, name: str) -> Self | None:
        """Return what a name like ``A4.backlash@3`` means, with the key of the class."""
        head, _, torque = name.partition(f".{cls.key}@")
        try:
            return cls(head, float(torque)) if head in JOINTS else None
        except ValueError:
            return None

    @classmethod
    def stated(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield what stands under `key` of [joints]."""
        for joint in JOINTS:
            if (play := getattr(content.joints[joint], cls.key)) is not None:
                yield cls(joint, play.torque_Nm), play.angle_urad / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half: float, source: str) -> None:
        """Write `key` of the joint."""
        tables["joints"][self.joint][self.key] = {"angle_urad": value, "torque_Nm": self.torque}

    def row(self, robot: RobotModel) -> int:
        """Return the coordinate of the joint."""
        return JointCompliance(self.joint).row(robot)

    def of(self, robot: RobotModel) -> float:
        """Return by how much the gear lies off; zero if the robot has no such part."""
        return dict(robot.terms).get(self, 0.0)

    def effect(self, torque: Array, rest: Array) -> tuple[Array, Array]:
        """Return tanh(v) − tanh(v₀) and its derivative by the torque."""
        there, here = np.tanh((torque + rest) / self.torque), np.tanh(rest / self.torque)
        return there - here, (1.0 - there**2) / self.torque


class LostMotion(Backlash, frozen=True):
    """Lost motion of a gear: it lies off to the side to which the load presses it, ``A4.lost_motion@3`` [rad].

    Deflection tanh(v) with v = torque/T. Friction that holds the gear at rest lets it lie
    anywhere under the weights: what turns it over is the load alone, while backlash is turned over by all that acts.
    """

    key: ClassVar[str] = "lost_motion"
    feels_rest: ClassVar[bool] = False

    def effect(self, torque: Array, rest: Array) -> tuple[Array, Array]:
        """Return tanh(v) and its derivative by the torque."""
        there = np.tanh(torque / self.torque)
        return there, (1.0 - there**2) / self.torque


class LinkSpring(Spring, frozen=True):
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
    def place(self) -> str:
        """Return the link."""
        return "the base" if self.link == BASE else f"the link of {self.link}"

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
            raise missing(self)
        return robot.passive[robot.link_springs.index(self)]

    def of(self, robot: RobotModel) -> float:
        """Return its compliance; zero if the link is rigid there."""
        return float(robot.steady[self.row(robot)]) if self in robot.link_springs else 0.0
