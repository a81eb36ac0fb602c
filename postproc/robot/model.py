"""The robot as the package computes with it: two chains, springs, compensator, covariance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.compensator import Compensator
from postproc.errors import ModelError
from postproc.frames import Array, norm
from postproc.robot import parameters
from postproc.robot.chain import Chain
from postproc.robot.flexible import elastic_chain
from postproc.robot.model_file import BASE, JOINTS
from postproc.robot.parameter import CompensatorTorque, Parameter, Spring
from postproc.robot.parameters import COMPENSATOR
from postproc.robot.rest_parameters import CompensatorSize, LinkMass
from postproc.robot.spring_parameters import LINK_AXES, LinkSpring
from postproc.robot.transmission import Transmission
from postproc.robot.value_sources import SourcedValue


class Covariance(Struct, frozen=True, eq=False):
    """Covariance of identified parameters.

    :param parameters: (n,) of them.
    :param matrix: (n, n) of their values in files, in units of files.
    """

    parameters: tuple[Parameter, ...]
    matrix: Array

    @classmethod
    def of(cls, names: Iterable[str], matrix: Sequence[Sequence[float]] | Array) -> Covariance:
        """Return the covariance of parameters by their names in files.

        :raises ModelError: a name that no parameter has.
        """
        found = {name: parameters.named(name) for name in names}
        unknown = [name for name, parameter in found.items() if parameter is None]
        if unknown:
            raise ModelError(f"[covariance] names {unknown[0]!r}, which no parameter of the elastic model is called")
        return cls(tuple(p for p in found.values() if p is not None), np.array(matrix, dtype=float))


class Discrepancy(Struct, frozen=True, eq=False):
    """How far the model was off on configurations it was not fitted to, noise and its own uncertainty taken out.

    :param load: (m,) size of the loads there, force [N] and moment [N·m] in one, ascending.
    :param u95: (m,) what 95 % of the errors were below [m].
    """

    load: Array
    u95: Array

    def at(self, wrench: Array) -> Array:
        """Return the bound (N,) [m] under wrenches (N, 6).

        Between measured loads it is interpolated, above them it grows with the load; below the smallest it does not
        shrink, as backlash does not: what is off there is off by a milling force too. Without load nothing is.
        """
        force = norm(wrench)
        inside = np.interp(force, self.load, self.u95)
        beyond = np.maximum(force / self.load[-1], 1.0)
        return np.where(np.any(wrench != 0.0, axis=1), inside * beyond, 0.0)


class Measured(Struct, frozen=True, eq=False):
    """What the measurements of an identified model covered.

    :param torque: (6,) largest on A1…A6 [N·m].
    :param not_trusted: why the model should not be used; empty if it may.
    """

    torque: Array
    not_trusted: str


class RobotModel(Struct, frozen=True, eq=False, dict=True):
    """A robot as the package computes with it. SI units, KUKA joint signs, root frame = `$ROBROOT`.

    :param name: name of the model folder.
    :param title: full name of the robot.
    :param nominal: the controller's geometry.
    :param actual: geometry of the real robot (calibrated where known), with the masses of its links.
    :param loaded: `actual` with the payload that is carried beyond the calibrated state.
    :param stiffness: (nv, nv) K⁰_θ of the virtual springs at small torque [N·m/rad, N/m].
    :param actuated: (6,) rows of A1…A6 among the nv coordinates of `actual`.
    :param compensator: spring beside A2, or None.
    :param subtract_reference: True if the geometry holds the state of rest under own weight (``"calibrated"``).
    :param lower: (6,) joint limits [rad].
    :param upper: (6,) joint limits [rad].
    :param speed: (6,) joint speed limits [rad/s].
    :param covariance: of the identified parameters, or None.
    :param sources: where each value comes from.
    :param terms: parameters of springs that do not grow with the torque, with their values.
    :param carries_weight: they feel the torque at rest (weights, compensator) too, not the load alone.
    :param link_springs: springs of the links, in the order of their coordinates.
    :param discrepancy: by how much the model was off where it was not fitted, or None.
    :param geometry_error: what 95 % of the errors of the geometry, without load, are below [m]; 0 where none is told.
    :param measured: what the measurements of an identified model covered, or None.
    :param language: dialect that its controller reads; empty where the model does not say.
    :param transmission: errors of the gears' transmission, or None.
    :param mass_spread: standard deviation of what the mass of each link is off by, as a share.
    :param compensator_spread: the same of the size of the compensator's torque.
    :param stated_spread: parameters of `covariance` whose variance is the spread of published or assumed values.
    """

    name: str
    title: str
    nominal: Chain
    actual: Chain
    loaded: Chain
    stiffness: Array
    actuated: tuple[int, ...]
    compensator: Compensator | None
    subtract_reference: bool
    lower: Array
    upper: Array
    speed: Array
    covariance: Covariance | None
    sources: tuple[SourcedValue, ...]
    terms: tuple[tuple[Spring, float], ...] = ()
    carries_weight: bool = False
    link_springs: tuple[LinkSpring, ...] = ()
    discrepancy: Discrepancy | None = None
    geometry_error: float = 0.0
    measured: Measured | None = None
    language: str = ""
    transmission: Transmission | None = None
    mass_spread: float = 0.0
    compensator_spread: float = 0.0
    stated_spread: tuple[Parameter, ...] = ()

    @cached_property
    def compliance(self) -> Array:
        """C⁰ (nv,) of the virtual springs [rad/(N·m), m/N]; zero where a spring is rigid (infinite stiffness)."""
        return np.asarray(1.0 / np.diag(self.stiffness))

    @cached_property
    def steady(self) -> Array:
        """Compliance (nv,) that does not change with the torque [rad/(N·m), m/N]."""
        return self.compliance - self._at_small_torque(self.terms)

    def _at_small_torque(self, terms: Iterable[tuple[Spring, float]]) -> Array:
        """Return the compliance (nv,) of terms at small torque."""
        zero, out = np.zeros(1), np.zeros(self.actual.nv)
        for parameter, value in terms:
            if not parameter.is_compliance:
                continue
            out[parameter.row(self)] += value * parameter.effect(zero, zero)[1][0]
        return out

    @cached_property
    def basis(self) -> str:
        """What the covariance rests on, in words; empty without covariance."""
        if self.covariance is None:
            return ""
        if len(self.stated_spread) == len(self.covariance.parameters) and self.stated_spread:
            return "from published values, not measured on this robot"
        if self.stated_spread:
            names = ", ".join(parameter.symbol for parameter in self.stated_spread)
            return f"measured on this robot, but for {names}: from published values"
        return "measured on this robot"

    @cached_property
    def passive(self) -> tuple[int, ...]:
        """Coordinates of the link springs: those that no motor moves."""
        return tuple(sorted(set(range(self.actual.nv)) - set(self.actuated)))

    @cached_property
    def geometry_is_nominal(self) -> bool:
        """True if the actual geometry is the controller's."""
        if self.transmission is not None:
            return False
        plain = elastic_chain(self.nominal, self.link_springs)[0]
        return bool((plain.placement == self.actual.placement).all() and (plain.flange == self.actual.flange).all())

    @cached_property
    def has_weight(self) -> bool:
        """True if links or payload have mass."""
        return bool((self.loaded.mass > 0.0).any())

    @cached_property
    def a_kilogram_each(self) -> Chain:
        """The elastic chain with one kilogram at the centre of each link, as the model states it; no payload."""
        mass, centre = np.zeros(self.actual.nv), np.zeros((self.actual.nv, 3))
        for joint in JOINTS:
            link = LinkMass(joint)
            mass[link.row(self)], centre[link.row(self)] = 1.0, self.nominal.centre[link.index]
        return replace(self.actual, mass=mass, centre=centre)

    def with_link_springs(self, springs: Iterable[LinkSpring]) -> RobotModel:
        """Return the robot, of six coordinates and without payload, with one more for each spring, rigid as yet."""
        order = [LinkSpring(link, axis) for link in (BASE, *JOINTS) for axis in LINK_AXES]
        wanted = tuple(sorted(set(springs), key=order.index))
        if not wanted:
            return self
        chain, actuated, _ = elastic_chain(self.actual, wanted)
        stiffness = np.full(chain.nv, np.inf)
        stiffness[list(actuated)] = np.diag(self.stiffness)
        return replace(
            self, actual=chain, loaded=chain, stiffness=np.diag(stiffness), actuated=actuated, link_springs=wanted
        )

    def with_values(self, values: Mapping[Parameter, float]) -> RobotModel:
        """Return the robot with these (linear) values of its parameters, SI; those not named keep theirs."""
        steady, terms = self.steady.copy(), dict(self.terms)
        law = self.compensator
        for parameter, value in values.items():
            if not isinstance(parameter, Spring):
                continue
            if parameter.linear:
                steady[parameter.row(self)] = value
            else:
                terms[parameter] = value
        if law is not None and any(isinstance(parameter, CompensatorTorque) for parameter in values):
            if (size := values.get(CompensatorSize())) is not None:
                law = law.with_spring(size, size * law.free_length)
            else:
                law = law.with_spring(*(values.get(parameter, parameter.of(self)) for parameter in COMPENSATOR))
        with np.errstate(divide="ignore"):
            stiffness = np.diag(1.0 / (steady + self._at_small_torque(terms.items())))
        heavier = self._with_masses({p: value for p, value in values.items() if isinstance(p, LinkMass)})
        return replace(heavier, stiffness=stiffness, terms=tuple(terms.items()), compensator=law)

    def _with_masses(self, masses: Mapping[LinkMass, float]) -> RobotModel:
        """Return the robot with these masses of links [kg]; what the flange carries stays."""
        nominal, actual, loaded = self.nominal, self.actual, self.loaded
        for link, mass in masses.items():
            more, centre, row = mass - link.of(self), nominal.centre[link.index], link.row(self)
            nominal = nominal.with_mass(link.index, more, centre)
            bare, actual = actual, actual.with_mass(row, more, centre)
            loaded = actual if loaded is bare else loaded.with_mass(row, more, centre)
        return replace(self, nominal=nominal, actual=actual, loaded=loaded) if masses else self

    def with_payload(self, mass: float, centre: Array) -> RobotModel:
        """Return the model carrying a further payload.

        :param mass: [kg].
        :param centre: (3,) centre of mass in the flange frame [m].
        """
        if mass == 0.0:
            return self
        return replace(self, loaded=self.loaded.with_payload(mass, np.asarray(centre, dtype=float)))
