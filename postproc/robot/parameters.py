"""The parameters of the elastic model: springs, their couplings and waves over the pose, compensator, link masses.

The model is linear in each of them. A `Spring` adds to the deflection of one coordinate its value times a function of
the torque there; a `GearCoupling` adds to those of two joints, each by the torque on the other; a `PoseWave` is a
compliance that changes over the workspace. A `CompensatorTorque` subtracts its value times a function of q2 from the
torque on joint 2. Values are SI; files hold the units of a workshop (the whole compliance of a joint, the free length
s₀): `Parameter.file_value`.

A further kind is a class in `KINDS`; identification, bound and report use the methods of the objects alone.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, ClassVar, Self

import numpy as np
from msgspec import Struct

from postproc.compensator import Compensator
from postproc.frames import MM_PER_M, Array
from postproc.robot.model_file import BASE, JOINTS, ModelFile

PER_URAD = 1e6
"""µrad, or µm, in one SI unit."""
LINK_AXES = ("X", "Y", "Z", "RX", "RY", "RZ", "end_RX", "end_RY", "end_RZ")
"""Directions of the springs of a link: translations and rotations at its beginning, rotations at its end."""
_MASS = ".mass"


class Parameter(Struct, frozen=True):
    """A value of the elastic model that can be identified.

    A kind that belongs to a joint has a field `joint`, at which it acts. `RobotModel.value` and `RobotModel.row` return
    the value and the coordinate of a parameter in a robot. `per_si`: units of the file in one SI unit. `sparse`: the
    parameter is one of many candidates of which few are expected: fitted ≥ 0, and left out of files if it is zero.
    """

    per_si: ClassVar[float] = PER_URAD
    sparse: ClassVar[bool] = False

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "urad/(N·m)"

    @property
    def usual(self) -> float:
        """Usual size, SI."""
        return 1e-6

    @property
    @abstractmethod
    def name(self) -> str:
        """Name in files: [covariance] of `model.toml`, `identification.json`."""

    @property
    def symbol(self) -> str:
        """Name of the fitted value in messages."""
        return self.name

    @property
    def title(self) -> str:
        """Heading in reports."""
        return self.name

    @property
    @abstractmethod
    def place(self) -> str:
        """Joint or link that the parameter belongs to, in words."""

    @classmethod
    @abstractmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the parameter of this kind whose name in files is `name`; None if no parameter of this kind has it."""

    @classmethod
    @abstractmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the parameters of this kind that a model file holds, with their (linear) values, SI."""

    @abstractmethod
    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put a value into tables of model.toml.

        :param tables: name → content, e.g. ``joints`` → ``A1`` → entry; they are changed.
        :param value: in units of the file.
        :param half_width: of the 95 % interval, in units of the file; most entries have no key for it.
        :param source: origin of the value, in words.
        """

    def partners(self) -> tuple[Parameter, ...]:
        """Return the other parameters that the value in model.toml depends on, or whose value there depends on this.

        The whole compliance of a joint in model.toml contains the parts that fade; s₀ is the preload divided by K_c.
        """
        return ()

    def file_value(self, values: Mapping[Parameter, float]) -> tuple[float, dict[Parameter, float]]:
        """Return the value in units of the file, and its derivatives by linear values.

        :param values: linear values (SI) of this parameter and of its partners.
        :returns: the value; parameter → derivative of the value by its linear value, for parameters that it depends on.
        """
        return self.per_si * values[self], {self: self.per_si}


class Spring(Parameter, frozen=True):
    """A parameter that adds to the deflection of one coordinate.

    `linear`: whether the value is the constant compliance of the coordinate; else it is a term in addition to it.
    `is_compliance`: whether the slope at small torque is part of the spring's compliance. `with_rest_torque`: whether
    the deflection depends on the torque at rest plus the torque of the load. `signed`: whether the value may be
    negative.
    """

    linear: ClassVar[bool] = True
    is_compliance: ClassVar[bool] = True
    with_rest_torque: ClassVar[bool] = True
    signed: ClassVar[bool] = False

    def effect(self, torque: Array, rest_torque: Array) -> tuple[Array, Array]:
        """Return the deflection (N,) per unit of the parameter, and its derivative (N,) by the torque.

        :param torque: (N,) on the spring, in addition to `rest_torque` [N·m, N].
        :param rest_torque: (N,) torque at which the deflection is zero [N·m, N].
        """
        return torque, np.ones_like(torque)

    def factor(self, angles: Array) -> Array | float:
        """Return the factor (N,) on `effect` at angles (6, N) of the joints [rad]; 1.0 if it depends on none."""
        return 1.0


class CompensatorTorque(Parameter, frozen=True):
    """A parameter of the compensator's spring, which relieves joint 2 of torque. Source: paper, Eq. (3), (4)."""

    joint: ClassVar[str] = "A2"

    @abstractmethod
    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return the torque U_c′ (N,) and the stiffness U_c″ (N,) on joint 2 per unit of the parameter.

        :param law: compensator whose lengths count, for `CompensatorSize` the free length of its spring too.
        :param q2: (N,) angle of joint 2 [rad].
        """

    @abstractmethod
    def of(self, law: Compensator) -> float:
        """Return the value of this parameter in a compensator, SI."""

    @property
    def usual(self) -> float:
        """Usual size [N/m, N]."""
        return 1e6

    @property
    def place(self) -> str:
        """Return the compensator and its joint, in words."""
        return f"the compensator at {self.joint}"

    @classmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the parameter of this kind, of which there is one alone, if `name` is its name in files; else None."""
        return cls() if name == cls().name else None


class _JointSpring(Spring, frozen=True):
    """A spring of the gear of one joint, ``A1`` … ``A6``."""

    joint: str

    @property
    def place(self) -> str:
        """Return the name of the joint, ``A1`` … ``A6``."""
        return self.joint


class _NonlinearSpring(_JointSpring, frozen=True):
    """A spring of a gear that changes at about a torque [N·m]; one of many candidates."""

    torque: float
    sparse: ClassVar[bool] = True
    linear: ClassVar[bool] = False


class JointCompliance(_JointSpring, frozen=True):
    """The part of a joint's compliance that is the same at all torques: ``k1`` … ``k6``.

    Files hold the whole compliance at small torque, with the parts that fade.
    """

    @property
    def index(self) -> int:
        """Return the index of the joint, from 0."""
        return JOINTS.index(self.joint)

    @property
    def name(self) -> str:
        """Name in files, e.g. ``k1``."""
        return f"k{self.index + 1}"

    @classmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the compliance whose name in files is `name`, as ``k1``; None if there is none."""
        return next((cls(joint) for joint in JOINTS if name == cls(joint).name), None)

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the compliances of [joints] without the parts that fade [rad/(N·m)]."""
        for joint in JOINTS:
            spring = content.joints[joint]
            yield cls(joint), (spring.compliance_urad_per_Nm - spring.fading_compliance) / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put compliance and half width of its 95 % interval [µrad/(N·m)] into [joints.A1] of the tables of a file."""
        tables["joints"][self.joint] = {"source": source, "compliance_urad_per_Nm": value, "ci95": half_width}

    def file_value(self, values: Mapping[Parameter, float]) -> tuple[float, dict[Parameter, float]]:
        """Return the compliance at small torque [µrad/(N·m)], and its derivatives by the constant and the fading parts.

        :param values: linear values [rad/(N·m)] of this parameter, the constant part, and of fading parts of the joint;
            other parameters do not count.
        """
        parts = [part for part in values if part == self or self in part.partners()]
        return sum(self.per_si * values[part] for part in parts), dict.fromkeys(parts, self.per_si)


class FadingPart(_NonlinearSpring, frozen=True):
    """Part of a joint's compliance that fades as the torque grows beyond `torque` [N·m]: ``k1@800``.

    Deflection T·(f(u) − f(u₀)) with f = asinh, u = (torque + rest_torque)/T, u₀ = rest_torque/T: a sum of such parts
    follows any gear whose compliance falls with load; every part stays monotone, so that the spring is always stable.
    """

    separator: ClassVar[str] = "@"
    """Separates joint and torque in names."""
    key: ClassVar[str] = "stiffening"
    """Key of such parts in [joints] of model.toml."""

    @property
    def name(self) -> str:
        """Name in files, e.g. ``k1@800``."""
        return f"{JointCompliance(self.joint).name}{self.separator}{self.torque:g}"

    @property
    def title(self) -> str:
        """Heading in reports: joint and torque, in words."""
        return f"{JointCompliance(self.joint).name}, fades beyond {self.torque:g} N·m"

    @classmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the part whose name in files is `name`, as ``k6@6.2`` with `separator` in the middle; else None."""
        compliance_name, _, torque = name.partition(cls.separator)
        compliance = JointCompliance.from_name(compliance_name)
        try:
            return None if compliance is None else cls(compliance.joint, float(torque))
        except ValueError:
            return None

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the parts under `key` of [joints], with their compliances at small torque [rad/(N·m)]."""
        for joint in JOINTS:
            for part in getattr(content.joints[joint], cls.key):
                yield cls(joint, part.torque_Nm), part.compliance_urad_per_Nm / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Append the part to the list under `key` of its joint in the tables of a file; `value` [µrad/(N·m)]."""
        part = {"torque_Nm": self.torque, "compliance_urad_per_Nm": value}
        tables["joints"][self.joint].setdefault(self.key, []).append(part)

    def partners(self) -> tuple[Parameter, ...]:
        """Return the compliance of the joint, which contains the part in model.toml."""
        return (JointCompliance(self.joint),)

    def effect(self, torque: Array, rest_torque: Array) -> tuple[Array, Array]:
        """Return T·(asinh u − asinh u₀) (N,) and its derivative by the torque, 1/√(1 + u²) (N,).

        T is `self.torque`, u₀ = rest_torque/T, u = (torque + rest_torque)/T; torques (N,) [N·m].
        """
        u0 = rest_torque / self.torque
        u = torque / self.torque + u0
        return self.torque * (np.arcsinh(u) - np.arcsinh(u0)), 1.0 / np.sqrt(1.0 + u**2)


class Knee(FadingPart, frozen=True):
    """Part of a joint's compliance that ends where the torque passes `torque` [N·m]: ``k1^800``.

    Deflection T·(f(u) − f(u₀)) with f = u/(1 + u⁴)^¼ and u, u₀ as in `FadingPart`: proportional to the torque up to T
    (the breakpoint of a bilinear spring) and constant beyond. Any gear whose compliance falls with load is a sum of
    such parts; beyond the last breakpoint the sum is a straight line.
    """

    separator: ClassVar[str] = "^"
    key: ClassVar[str] = "knees"

    @property
    def title(self) -> str:
        """Heading in reports: joint and torque, in words."""
        return f"{JointCompliance(self.joint).name}, up to {self.torque:g} N·m"

    def effect(self, torque: Array, rest_torque: Array) -> tuple[Array, Array]:
        """Return T·(f(u) − f(u₀)) (N,) with f(u) = u/(1 + u⁴)^¼, and its derivative f′(u) = (1 + u⁴)^(−5/4) (N,).

        T is `self.torque`, u₀ = rest_torque/T, u = (torque + rest_torque)/T; torques (N,) [N·m].
        """
        u0 = rest_torque / self.torque
        u = torque / self.torque + u0
        loaded_base, rest_base = 1.0 + u**4, 1.0 + u0**4
        return self.torque * (u / loaded_base**0.25 - u0 / rest_base**0.25), loaded_base**-1.25


class Backlash(_NonlinearSpring, frozen=True):
    """Backlash of a gear: its angle to the flank on which the torque presses it, ``A4.backlash@3`` [rad].

    Deflection tanh(v) − tanh(v₀) with v = (torque + rest_torque)/T, v₀ = rest_torque/T. The gear changes its flank
    within about the small torque T [N·m].
    """

    is_compliance: ClassVar[bool] = False
    key: ClassVar[str] = "backlash"
    """Its key in [joints] of model.toml; separates joint and torque in names."""

    @property
    def name(self) -> str:
        """Name in files, e.g. ``A4.backlash@3``."""
        return f"{self.joint}.{self.key}@{self.torque:g}"

    @property
    def title(self) -> str:
        """Heading in reports: backlash or lost motion, and the joint."""
        return f"{self.key.replace('_', ' ')} of {self.joint}"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "urad"

    @property
    def usual(self) -> float:
        """Usual size [rad]."""
        return 2e-5

    @classmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the parameter whose name in files is `name`, as ``A4.backlash@3`` with the `key`; else None."""
        joint, _, torque = name.partition(f".{cls.key}@")
        try:
            return cls(joint, float(torque)) if joint in JOINTS else None
        except ValueError:
            return None

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the entries under `key` of [joints], with their angles [rad]."""
        for joint in JOINTS:
            if (play := getattr(content.joints[joint], cls.key)) is not None:
                yield cls(joint, play.torque_Nm), play.angle_urad / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put the angle [µrad] and its torque under `key` of the joint in the tables of a file."""
        tables["joints"][self.joint][self.key] = {"angle_urad": value, "torque_Nm": self.torque}

    def effect(self, torque: Array, rest_torque: Array) -> tuple[Array, Array]:
        """Return tanh(v) − tanh(v₀) (N,), and its derivative by the torque (N,) [1/(N·m)].

        v = (torque + rest_torque)/T and v₀ = rest_torque/T, T is `self.torque`; torques (N,) [N·m].
        """
        angle, rest_angle = np.tanh((torque + rest_torque) / self.torque), np.tanh(rest_torque / self.torque)
        return angle - rest_angle, (1.0 - angle**2) / self.torque


class LostMotion(Backlash, frozen=True):
    """Lost motion of a gear: its angle to the flank on which the load presses it, ``A4.lost_motion@3`` [rad].

    Deflection tanh(v) with v = torque/T. Friction holds the gear at rest anywhere between its flanks, whatever the
    weights: only the load moves it to a flank, while the sum of all torques decides where a gear with backlash is.
    """

    key: ClassVar[str] = "lost_motion"
    with_rest_torque: ClassVar[bool] = False

    def effect(self, torque: Array, rest_torque: Array) -> tuple[Array, Array]:
        """Return tanh(torque/T) (N,), and its derivative by the torque (N,) [1/(N·m)]; T is `self.torque`.

        :param torque: (N,) of the load alone [N·m]; the torque at rest has no effect.
        """
        angle = np.tanh(torque / self.torque)
        return angle, (1.0 - angle**2) / self.torque


class GearCoupling(_JointSpring, frozen=True):
    """Deflection of each of two joints by the torque on the other: ``k45``, of either sign.

    The motors of a wrist turn A5 and A6 by shafts and bevel gears within A4: a gear that deflects moves the others. By
    Maxwell's reciprocity the deflection of A4 by a torque on A5 is that of A5 by the same torque on A4. It is in
    addition to the compliances of the two joints.
    """

    second: str
    linear: ClassVar[bool] = False
    is_compliance: ClassVar[bool] = False
    signed: ClassVar[bool] = True
    key: ClassVar[str] = "coupling"
    """Key in [joints] of model.toml, at the first of the two joints."""

    @property
    def name(self) -> str:
        """Name in files, e.g. ``k45``."""
        return JointCompliance(self.joint).name + self.second[1:]

    @property
    def title(self) -> str:
        """Heading in reports: the two joints."""
        return f"coupling of {self.joint} and {self.second}"

    @classmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the coupling whose name in files is `name`, as ``k45``; None if there is none."""
        pairs = (cls(joint, second) for index, joint in enumerate(JOINTS) for second in JOINTS[index + 1 :])
        return next((pair for pair in pairs if pair.name == name), None)

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the entries under `key` of [joints], with their compliances [rad/(N·m)]."""
        for joint in JOINTS:
            for second, value in content.joints[joint].coupling.items():
                yield cls(joint, second), value / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put the compliance [µrad/(N·m)] under `key` of the first joint in the tables of a file."""
        tables["joints"][self.joint].setdefault(self.key, {})[self.second] = value


class PoseWave(_JointSpring, frozen=True):
    """Part of a joint's compliance that is a wave over the joint angles: ``k3.cos(A2-A3)``, of either sign.

    Deflection cos(n·q)·torque or sin(n·q)·torque, with whole numbers n of turns of each joint. A sum of such waves is
    a Fourier series of the compliance over the workspace: gear wheels that run out of true change it once and twice a
    turn, and the arm's shape changes what the links add to a joint. Its mean over all angles is `JointCompliance`.

    :param turns: (6,) periods of the wave in one turn of each joint.
    :param wave: ``cos`` or ``sin``.
    """

    turns: tuple[int, ...]
    wave: str
    linear: ClassVar[bool] = False
    is_compliance: ClassVar[bool] = False
    signed: ClassVar[bool] = True
    key: ClassVar[str] = "over_pose"
    """Key of such parts in [joints] of model.toml."""

    @property
    def angle(self) -> str:
        """Return the angle of the wave, e.g. ``A2-2A3``."""
        terms = "".join(f"{turns:+d}{joint}" for turns, joint in zip(self.turns, JOINTS, strict=True) if turns)
        without_ones = re.sub(r"(?<=[+-])1(?=A)", "", terms)  # "+1A2" becomes "+A2"
        return without_ones.removeprefix("+")

    @property
    def name(self) -> str:
        """Name in files, e.g. ``k3.cos(A2-A3)``."""
        return f"{JointCompliance(self.joint).name}.{self.wave}({self.angle})"

    @property
    def title(self) -> str:
        """Heading in reports: joint and wave."""
        return f"{JointCompliance(self.joint).name} over the pose, {self.wave}({self.angle})"

    @classmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the wave whose name in files is `name`, as ``k3.cos(A2-A3)``; None if there is none.

        Only the spelling of the property `name` counts: joints in order, each once, without a leading plus.
        """
        match = re.fullmatch(r"(k[1-6])\.(cos|sin)\(((?:[+-]?[1-9]?A[1-6])+)\)", name)
        if match is None:
            return None
        turns = [0] * len(JOINTS)
        for sign, count, joint in re.findall(r"([+-]?)([1-9]?)(A[1-6])", match[3]):
            turns[JOINTS.index(joint)] = int(f"{sign}{count or 1}")
        compliance = JointCompliance.from_name(match[1])
        wave = None if compliance is None else cls(compliance.joint, tuple(turns), match[2])
        return wave if wave is not None and wave.name == name else None

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the waves under `key` of [joints], with their amplitudes [rad/(N·m)]."""
        for joint in JOINTS:
            for entry in content.joints[joint].over_pose:
                for wave, value in (("cos", entry.cos_urad_per_Nm), ("sin", entry.sin_urad_per_Nm)):
                    if value is not None:
                        yield cls(joint, entry.turns, wave), value / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put the amplitude [µrad/(N·m)] under `key` of the joint; cosine and sine of the same turns share an entry."""
        entries = tables["joints"][self.joint].setdefault(self.key, [])
        if not entries or entries[-1]["turns"] != self.turns:
            entries.append({"turns": self.turns})
        entries[-1][f"{self.wave}_urad_per_Nm"] = value

    def factor(self, angles: Array) -> Array:
        """Return cos(n·q) or sin(n·q) (N,) at angles (6, N) [rad]."""
        phase = np.array(self.turns, dtype=float) @ angles
        return np.asarray(np.cos(phase) if self.wave == "cos" else np.sin(phase))


class LinkSpring(Spring, frozen=True):
    """Spring of a link: ``A2.RX``. `link` is base, A1…A6; `axis` X, Y, Z, RX, RY, RZ or end_RX, end_RY, end_RZ."""

    link: str
    axis: str
    sparse: ClassVar[bool] = True

    @property
    def slides(self) -> bool:
        """Return whether the spring moves the link along its axis, not about it."""
        return self.axis in LINK_AXES[:3]

    @property
    def at_end(self) -> bool:
        """Return whether the spring is at the end of the link, not at its joint."""
        return self.axis in LINK_AXES[6:]

    @property
    def direction(self) -> Array:
        """Return the unit axis (3,), in the joint frame, along or about which the spring deflects."""
        return np.asarray(np.eye(3)[LINK_AXES.index(self.axis) % 3])

    @property
    def place(self) -> str:
        """Return the link, in words."""
        return "the base" if self.link == BASE else f"the link of {self.link}"

    @property
    def name(self) -> str:
        """Name in files, e.g. ``A2.RX``."""
        return f"{self.link}.{self.axis}"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "um/N" if self.slides else "urad/(N·m)"

    @property
    def usual(self) -> float:
        """Usual compliance of a link [m/N, rad/(N·m)]."""
        return 1e-8 if self.slides else 1e-6

    @property
    def key(self) -> str:
        """Return the key in [links.A2] of model.toml."""
        return f"{self.axis}_{'um_per_N' if self.slides else 'urad_per_Nm'}"

    @classmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the spring whose name in files is `name`, as ``A2.end_RX``; None if there is none."""
        link, _, axis = name.partition(".")
        return cls(link, axis) if link in (BASE, *JOINTS) and axis in LINK_AXES else None

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the springs of [links] that are not rigid, the base first, with their compliances [m/N, rad/(N·m)]."""
        for spring in (cls(link, axis) for link in (BASE, *JOINTS) for axis in LINK_AXES if link in content.links):
            value = getattr(content.links[spring.link], spring.key)
            if value > 0.0:
                yield spring, value / PER_URAD

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put the compliance [µm/N, µrad/(N·m)] into [links.A2] of the tables of a file."""
        tables["links"].setdefault(self.link, {"source": source})[self.key] = value


class CompensatorStiffness(CompensatorTorque, frozen=True):
    """K_c of the compensator's spring [N/m], at a preload K_c·s₀ that does not change with it."""

    per_si: ClassVar[float] = 1.0

    @property
    def name(self) -> str:
        """Name in files, ``K_c``."""
        return "K_c"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "N/m"

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield K_c of [compensator] [N/m], if there is one."""
        if content.compensator is not None:
            yield cls(), content.compensator.stiffness_N_per_m

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put K_c [N/m] into [compensator] of the tables of a file; a fit's negative value as zero."""
        tables["compensator"] |= {"stiffness_N_per_m": max(value, 0.0), "source": source, "assumed": False}

    def of(self, law: Compensator) -> float:
        """Return the stiffness K_c of the spring [N/m]."""
        return law.stiffness

    def partners(self) -> tuple[Parameter, ...]:
        """Return the preload: model.toml states K_c and s₀, the model has K_c and K_c·s₀."""
        return (CompensatorPreload(),)

    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return U_c′ (N,) [N·m] and U_c″ (N,) [N·m/rad] of a spring of 1 N/m without free length at q2 (N,) [rad]."""
        return law.gradient_columns(q2)[..., 0], law.stiffness_columns(q2)[..., 0]


class CompensatorPreload(CompensatorTorque, frozen=True):
    """K_c·s₀ of the compensator's spring [N]; in files the free length s₀: ``s_0`` [mm]."""

    per_si: ClassVar[float] = MM_PER_M

    @property
    def name(self) -> str:
        """Name in files, ``s_0``."""
        return "s_0"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "mm"

    @property
    def symbol(self) -> str:
        """Name of the fitted value in messages, ``K_c*s_0``."""
        return "K_c*s_0"

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield K_c·s₀ of [compensator] [N], if there is one."""
        if (entry := content.compensator) is not None:
            yield cls(), entry.stiffness_N_per_m * entry.free_length_mm / MM_PER_M

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put s₀ [mm] into [compensator] of the tables of a file; a fit's negative value as zero."""
        tables["compensator"]["free_length_mm"] = max(value, 0.0)

    def of(self, law: Compensator) -> float:
        """Return the preload K_c·s₀ of the spring [N]."""
        return law.stiffness * law.free_length

    def partners(self) -> tuple[Parameter, ...]:
        """Return the stiffness: model.toml states s₀, which is the preload divided by the stiffness."""
        return (CompensatorStiffness(),)

    def file_value(self, values: Mapping[Parameter, float]) -> tuple[float, dict[Parameter, float]]:
        """Return s₀ [mm] and its derivatives by preload and stiffness; zero without derivatives if K_c ≤ 0."""
        stiffness, preload = values[CompensatorStiffness()], values[self]
        if stiffness <= 0.0:
            return 0.0, {}
        slopes: dict[Parameter, float] = {
            self: MM_PER_M / stiffness,
            CompensatorStiffness(): -MM_PER_M * preload / stiffness**2,
        }
        return MM_PER_M * preload / stiffness, slopes

    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return U_c′ (N,) [N·m] and U_c″ (N,) [N·m/rad] per newton of preload at q2 (N,) [rad]."""
        return law.gradient_columns(q2)[..., 1], law.stiffness_columns(q2)[..., 1]


class LinkMass(Parameter, frozen=True):
    """Mass of the link that a joint carries, without payload: ``A2.mass`` [kg]. Its centre is taken as stated.

    Gears whose compliance depends on the torque show their working point, and so the weights that load them at rest.
    The model states these roughly: in a fit they are parameters about the stated value, with its standard deviation.
    """

    joint: str
    per_si: ClassVar[float] = 1.0

    @property
    def index(self) -> int:
        """Return the index of the joint, from 0."""
        return JOINTS.index(self.joint)

    @property
    def place(self) -> str:
        """Return the name of the joint, ``A1`` … ``A6``."""
        return self.joint

    @property
    def name(self) -> str:
        """Name in files, e.g. ``A2.mass``."""
        return self.joint + _MASS

    @property
    def title(self) -> str:
        """Heading in reports: the mass of a link."""
        return f"mass of the link of {self.joint}"

    @property
    def unit(self) -> str:
        """Unit in files."""
        return "kg"

    @property
    def usual(self) -> float:
        """Usual size [kg]."""
        return 100.0

    @classmethod
    def from_name(cls, name: str) -> Self | None:
        """Return the mass whose name in files is `name`, as ``A2.mass``; None if there is none."""
        joint = name.removesuffix(_MASS)
        return cls(joint) if joint in JOINTS and name.endswith(_MASS) else None

    @classmethod
    def from_file(cls, content: ModelFile) -> Iterator[tuple[Self, float]]:
        """Yield the masses of [masses] [kg], which replace those of robot.urdf."""
        for joint in JOINTS:
            mass = None if content.masses is None else getattr(content.masses, f"{joint}_kg")
            if mass is not None:
                yield cls(joint), mass

    def write(self, tables: dict[str, Any], value: float, half_width: float, source: str) -> None:
        """Put the mass [kg] into [masses] of the tables of a file; a fit's negative value as zero."""
        tables["masses"][f"{self.joint}_kg"] = max(value, 0.0)


class CompensatorSize(CompensatorStiffness, frozen=True):
    """K_c at a constant free length s₀ [N/m]: the size of the compensator's torque."""

    def partners(self) -> tuple[Parameter, ...]:
        """Return no parameters: the free length s₀ does not change with this stiffness."""
        return ()

    def effect(self, law: Compensator, q2: Array) -> tuple[Array, Array]:
        """Return U_c′ (N,) [N·m] and U_c″ (N,) [N·m/rad] of 1 N/m with the law's free length at q2 (N,) [rad]."""
        gradient, stiffness = law.gradient_columns(q2), law.stiffness_columns(q2)
        return (
            gradient[..., 0] + law.free_length * gradient[..., 1],
            stiffness[..., 0] + law.free_length * stiffness[..., 1],
        )


KINDS: tuple[type[Parameter], ...] = (
    JointCompliance,
    FadingPart,
    Knee,
    Backlash,
    LostMotion,
    GearCoupling,
    PoseWave,
    LinkSpring,
    CompensatorStiffness,
    CompensatorPreload,
    LinkMass,
)
"""The kinds of parameters that files may name."""
JOINT_COMPLIANCES = tuple(JointCompliance(joint) for joint in JOINTS)
COMPENSATOR: tuple[Parameter, ...] = (CompensatorStiffness(), CompensatorPreload())


def parameter_of_name(name: str) -> Parameter | None:
    """Return the parameter of any kind whose name in files is `name`; None if there is none.

    >>> parameter_of_name("k6@6.2")
    FadingPart(joint='A6', torque=6.2)
    """
    return next((match for kind in KINDS if (match := kind.from_name(name)) is not None), None)


def stated_values(content: ModelFile) -> dict[Parameter, float]:
    """Return all parameters that a model file holds, with their linear values, SI."""
    return {parameter: value for kind in KINDS for parameter, value in kind.from_file(content)}


def file_slopes(parameters: Iterable[Parameter], values: Mapping[Parameter, float]) -> Array:
    """Return ∂(values in units of the file)/∂(linear values) (n, n) of n parameters.

    Parameters that the file value of one of them depends on must be among the n.

    :param values: linear values (SI) of these parameters.
    """
    order = list(parameters)
    jacobian = np.zeros((len(order), len(order)))
    for row, parameter in enumerate(order):
        _, slopes = parameter.file_value(values)
        for partner, slope in slopes.items():
            jacobian[row, order.index(partner)] = slope
    return jacobian
