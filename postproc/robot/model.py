"""The robot model: two chains, springs, compensator, covariance, errors of the gears' transmission."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.compensator import Compensator
from postproc.errors import ModelError
from postproc.frames import Array, norm
from postproc.robot import parameters, shapes
from postproc.robot.chain import Chain, elastic_chain
from postproc.robot.model_file import BASE, JOINTS, TransmissionEntry
from postproc.robot.parameters import (
    COMPENSATOR,
    LINK_AXES,
    PER_URAD,
    CompensatorSize,
    CompensatorTorque,
    GearCoupling,
    JointCompliance,
    LinkMass,
    LinkSpring,
    Parameter,
    PoseWave,
    Spring,
)
from postproc.robot.shapes import LinkShape
from postproc.robot.urdf import Geometry

GEAR_TERMS = ("sin", "cos", "sin2", "cos2")
"""Terms of a joint, in the order of `Transmission.amplitude`."""
_MOST_ROUNDS = 60
"""Limit of the fixed point, which ends far before at some hundredths in each round."""
_ANGLE_TOLERANCE = 1e-14
"""Change of angles [rad] by which the iteration ends: rounding of double numbers."""
_SAME_LAW = 1e-6
"""Relative difference of the numbers of two cutting laws that are one (assumed)."""


Basis = Literal["published", "scaled", "assumed"]
"""Where a compliance comes from that was not identified, the best first."""
_BASIS_WORDS: dict[Basis, str] = {
    "published": "from published values",
    "scaled": "scaled from another robot's values",
    "assumed": "assumed",
}


class SourcedValue(Struct, frozen=True):
    """One value of a model in words, its source in words, and whether it is assumed."""

    name: str
    value: str
    source: str
    assumed: bool


class Covariance(Struct, frozen=True, eq=False):
    """Covariance of identified parameters.

    :param parameters: n parameters.
    :param matrix: (n, n) of the values of the parameters in files, in units of files.
    """

    parameters: tuple[Parameter, ...]
    matrix: Array

    @classmethod
    def of(cls, names: Iterable[str], matrix: Sequence[Sequence[float]] | Array) -> Covariance:
        """Return the covariance of parameters by their names in files.

        :param matrix: (n, n) of the n parameters, in units of files.
        :raises ModelError: no parameter has one of the names.
        """
        parameter_of = {name: parameters.parameter_of_name(name) for name in names}
        unknown = [name for name, parameter in parameter_of.items() if parameter is None]
        if unknown:
            raise ModelError(
                f"[covariance] names {unknown[0]!r}, which is no parameter of the elastic model",
                advice="Identify the model anew, or remove [covariance].",
            )
        return cls(tuple(p for p in parameter_of.values() if p is not None), np.array(matrix, dtype=float))


FORCES = "forces"
"""Name of the factor of the forces in [covariance]."""


class ForceFactor(Struct, frozen=True, eq=False):
    """Factor of forces that were identified together with the compliances.

    Readings show only the product of force and compliance, so errors of the factor and of compliances are correlated.

    :param law: numbers of the cutting law that computes the forces, see `machining.CuttingLaw.numbers`.
    :param covariance: (n + 1,) of the factor with the n parameters of `RobotModel.covariance`, in units of files; its
        variance is last.
    """

    law: tuple[float, ...]
    covariance: Array

    def is_of(self, law: tuple[float, ...]) -> bool:
        """Return whether forces are computed with this law."""
        return len(law) == len(self.law) and bool(np.allclose(law, self.law, rtol=_SAME_LAW, atol=0.0))


class Discrepancy(Struct, frozen=True, eq=False):
    """Unmodelled error: on configurations that the model was not fitted to, without noise and parameter uncertainty.

    :param load: (m,) sizes of the loads, force [N] and moment [N·m] in one, ascending.
    :param u95: (m,) 95 % quantile of the error at each load [m].
    """

    load: Array
    u95: Array

    def at(self, wrench: Array) -> Array:
        """Return the 95 % bound (N,) [m] of the unmodelled error under wrenches (N, 6).

        It is interpolated between the measured loads and proportional to the load above them. Below the smallest load
        it is constant, as an error by backlash is. Without load it is zero.
        """
        force = norm(wrench)
        interpolated_bound = np.interp(force, self.load, self.u95)
        factor = np.maximum(force / self.load[-1], 1.0)
        return np.where(np.any(wrench != 0.0, axis=1), interpolated_bound * factor, 0.0)


_SMALLEST_SPAN = np.radians(10.0)
"""Span of a joint that hardly moved [rad], assumed: its errors are those of any joint of an arm, not without limit."""


class GeometryError(Struct, frozen=True, eq=False):
    """Error of the calibrated geometry without load and without noise.

    :param u95: 95 % quantile of the error inside the measured angles [m].
    :param lower: (6,) least angles of the readings [rad]; −inf if not stated.
    :param upper: (6,) largest angles of the readings [rad]; inf if not stated.
    :param unmeasured: 95 % quantile of the errors that the readings allow for over the whole range of the joints [m].
    """

    u95: float
    lower: Array
    upper: Array
    unmeasured: float = 0.0

    def at(self, q: Array) -> Array:
        """Return the 95 % bound (N,) [m] at joint angles (N, 6) [rad].

        Beyond the measured angles it grows like the error of a straight line fitted to readings spread evenly over a
        span (Draper, Smith 1998, "Applied regression analysis", 1.4). At a share x of the span beyond its end the
        variance is 1 + 12·(½ + x)² times the variance v of the mean of the readings. It is 2v on average inside, which
        is `u95`², and 4v at the end. So each joint adds 12·(x + x²)·v = 6·(x + x²)·`u95`². Errors that the readings do
        not determine, such as waves of a gear that did not turn, add the share x of `unmeasured`, at most all of it;
        the largest x of the joints counts.
        """
        excess = np.maximum(np.maximum(self.lower - q, q - self.upper), 0.0)  # (N, 6) beyond the measured angles
        share = excess / np.maximum(self.upper - self.lower, _SMALLEST_SPAN)
        extrapolated_square = self.u95**2 * (1.0 + 6.0 * np.sum(share + share**2, axis=1))
        unmeasured = self.unmeasured * np.minimum(share.max(axis=1), 1.0)
        return np.asarray(np.sqrt(extrapolated_square + unmeasured**2))


class MeasuredRange(Struct, frozen=True, eq=False):
    """The range of the measurements of an identified model.

    :param torque: (6,) largest torque of the loads on A1…A6 [N·m].
    :param not_trusted: reason that the model should not be used; empty if it may be used.
    """

    torque: Array
    not_trusted: str


class Transmission(Struct, frozen=True, eq=False):
    """Errors of transmission of six joints; `amplitude` (6, 4) of sin q, cos q, sin 2q, cos 2q [rad].

    Gear wheels that run out of true, and mounted encoders, turn a joint by q + s₁·sin q + c₁·cos q + s₂·sin 2q +
    c₂·cos 2q where the controller states q. Springs, weights and geometry depend on the actual angle.
    """

    amplitude: Array

    @classmethod
    def of(cls, entries: Mapping[str, TransmissionEntry]) -> Transmission | None:
        """Return the errors that a model file states, by joint; None if all are zero."""
        amplitude = np.array(
            [
                [getattr(entries[joint], f"{term}_urad") / PER_URAD if joint in entries else 0.0 for term in GEAR_TERMS]
                for joint in JOINTS
            ]
        )
        return cls(amplitude) if amplitude.any() else None

    def actual_angles(self, q: Array) -> Array:
        """Return the actual angles (6, n) of joints for the angles (6, n) of the controller [rad]."""
        return np.asarray(q + np.einsum("jk,kjn->jn", self.amplitude, waves(q)))

    def commanded_angles(self, actual: Array) -> Array:
        """Return the angles (6, n) of the controller for actual angles (6, n) of the joints [rad].

        By a fixed point: each round multiplies the error by the amplitudes, which are some hundredths at most.
        """
        q = actual
        for _ in range(_MOST_ROUNDS):
            q, previous_q = actual - (self.actual_angles(q) - q), q
            if np.abs(q - previous_q).max(initial=0.0) <= _ANGLE_TOLERANCE:
                break
        return q


class OverPose(Struct, frozen=True, eq=False):
    """Compliances of joints that change over the workspace: Σ a·cos(n·q) + b·sin(n·q), see `parameters.PoseWave`.

    :param turns: (k, 6) periods n of each wave in one turn of each joint.
    :param cos: (6, k) amplitudes a at each joint [rad/(N·m)], and `sin` b.
    """

    turns: Array
    cos: Array
    sin: Array

    @classmethod
    def of(cls, terms: Iterable[tuple[Spring, float]]) -> OverPose | None:
        """Return the sum of all waves among the terms of a robot; None without waves."""
        waves = {parameter: value for parameter, value in terms if isinstance(parameter, PoseWave)}
        if not waves:
            return None
        turns = list(dict.fromkeys(wave.turns for wave in waves))
        amplitude = {name: np.zeros((len(JOINTS), len(turns))) for name in ("cos", "sin")}
        for wave, value in waves.items():
            amplitude[wave.wave][JOINTS.index(wave.joint), turns.index(wave.turns)] += value
        return cls(np.array(turns, dtype=float), **amplitude)

    def compliance(self, q: Array) -> Array:
        """Return the compliance (6, n) [rad/(N·m)] in addition to the mean compliance, at angles q (6, n) [rad]."""
        phase = self.turns @ q
        return np.asarray(self.cos @ np.cos(phase) + self.sin @ np.sin(phase))

    def slopes(self, q: Array) -> Array:
        """Return ∂(compliance of joint j)/∂q_i (6, 6, n) [1/(N·m)], in row j and column i, at angles q (6, n) [rad]."""
        phase = self.turns @ q
        by_phase = self.sin[:, :, None] * np.cos(phase) - self.cos[:, :, None] * np.sin(phase)
        return np.asarray(np.einsum("jkn,ki->jin", by_phase, self.turns))


class RobotModel(Struct, frozen=True, eq=False, dict=True):
    """A robot model. SI units, KUKA joint signs, root frame = `$ROBROOT`.

    :param name: name of the model folder.
    :param title: full name of the robot.
    :param nominal: the controller's geometry.
    :param actual: geometry of the real robot (calibrated where known), with the masses of its links.
    :param loaded: `actual` with the payload that it carries in addition to the calibrated state.
    :param stiffness: (nv, nv) K⁰_θ of the virtual springs at small torque [N·m/rad, N/m].
    :param actuated: (6,) rows of A1…A6 among the nv coordinates of `actual`.
    :param compensator: spring parallel to A2, or None.
    :param subtract_reference: True if the geometry describes the robot at rest under its own weight (``"calibrated"``),
        so that the torque at rest deflects nothing; False for the geometry of the weightless robot.
    :param lower: (6,) joint limits [rad].
    :param upper: (6,) joint limits [rad].
    :param speed: (6,) joint speed limits [rad/s].
    :param covariance: of the identified parameters, or None.
    :param sources: each value with its source.
    :param terms: parameters of springs in addition to the compliances, with their values: gears that are not linear,
        coupled, or change over the workspace.
    :param carries_weight: whether the deflection by `terms` depends on the torque at rest (weights, compensator) too.
    :param link_springs: springs of the links, in the order of their coordinates.
    :param force_factor: factor of the forces that were identified together with the covariance, or None.
    :param discrepancy: unmodelled error, or None.
    :param geometry_error: error of the calibrated geometry without load, or None.
    :param measured: range of the measurements, or None.
    :param language: dialect that its controller reads; empty if not stated.
    :param transmission: errors of the gears' transmission, or None.
    :param mass_spread: relative standard deviation of the mass of each link.
    :param compensator_spread: relative standard deviation of the size of the compensator's torque.
    :param spring_basis: joint → origin of its compliance, if it was not identified.
    :param stated_spread: parameters of `covariance` whose variance is the spread of published or assumed values.
    :param geometries: shapes of the links that robot.urdf names; their files are read when they are needed.
    :param urdf: path of robot.urdf, which the names of these files are relative to.
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
    force_factor: ForceFactor | None = None
    discrepancy: Discrepancy | None = None
    geometry_error: GeometryError | None = None
    measured: MeasuredRange | None = None
    language: str = ""
    transmission: Transmission | None = None
    mass_spread: float = 0.0
    compensator_spread: float = 0.0
    stated_spread: tuple[Parameter, ...] = ()
    spring_basis: Mapping[str, Basis] = {}
    geometries: tuple[Geometry, ...] = ()
    urdf: str = ""

    @cached_property
    def compliance(self) -> Array:
        """C⁰ (nv,) of the virtual springs [rad/(N·m), m/N]; zero for rigid springs (infinite stiffness)."""
        return np.asarray(1.0 / np.diag(self.stiffness))

    @cached_property
    def constant_compliance(self) -> Array:
        """Compliance (nv,) that does not change with the torque [rad/(N·m), m/N]."""
        return self.compliance - self._initial_compliance(self.terms)

    def _initial_compliance(self, terms: Iterable[tuple[Spring, float]]) -> Array:
        """Return the compliances (nv,) at small torque that terms add to their coordinates [rad/(N·m), m/N]."""
        zero, compliance = np.zeros(1), np.zeros(self.actual.nv)
        for parameter, value in terms:
            if parameter.is_compliance:
                _, slope = parameter.effect(zero, zero)
                compliance[self.row(parameter)] += value * slope[0]
        return compliance

    @cached_property
    def over_pose(self) -> OverPose | None:
        """Compliances that change over the workspace, or None."""
        return OverPose.of(self.terms)

    @cached_property
    def torque_terms(self) -> tuple[tuple[Spring, float], ...]:
        """The terms whose deflection depends on torques alone."""
        return tuple(term for term in self.terms if not isinstance(term[0], PoseWave))

    @cached_property
    def coupling_compliance(self) -> Array | None:
        """Compliances (nv, nv) of coordinates by torques on other coordinates [rad/(N·m)]; None without couplings.

        Zero on the diagonal.
        """
        couplings = [(parameter, value) for parameter, value in self.terms if isinstance(parameter, GearCoupling)]
        if not couplings:
            return None
        compliance = np.zeros((self.actual.nv, self.actual.nv))
        for parameter, value in couplings:
            for row, torque_row in self.pairs(parameter):
                compliance[row, torque_row] += value
        return compliance

    def pairs(self, parameter: Spring) -> tuple[tuple[int, int], ...]:
        """Return pairs of a coordinate that a spring deflects and the coordinate whose torque deflects it.

        :raises ModelError: this robot does not have the spring.
        """
        row = self.row(parameter)
        if not isinstance(parameter, GearCoupling):
            return ((row, row),)
        second = self.actuated[JOINTS.index(parameter.second)]
        return ((row, second), (second, row))

    def row(self, parameter: Parameter) -> int:
        """Return the coordinate of the elastic chain at which a parameter acts, or that carries a mass.

        :raises ModelError: this robot does not have the parameter.
        """
        if isinstance(parameter, LinkSpring):
            if parameter not in self.link_springs:
                raise _missing_parameter(parameter)
            return self.passive[self.link_springs.index(parameter)]
        if isinstance(parameter, CompensatorTorque) and self.compensator is None:
            raise _missing_parameter(parameter)
        joint: str = parameter.joint  # type: ignore[attr-defined]  # all other kinds belong to a joint
        row = self.actuated[JOINTS.index(joint)]
        if isinstance(parameter, LinkMass):  # after the springs at the beginning of the link
            row += sum(spring.link == joint and not spring.at_end for spring in self.link_springs)
        return row

    def value(self, parameter: Parameter) -> float:
        """Return the value of a parameter in which the model is linear, SI; zero without such a spring or compensator.

        :raises ModelError: the parameter is of a kind that no robot has.
        """
        if isinstance(parameter, CompensatorTorque):
            return 0.0 if self.compensator is None else parameter.of(self.compensator)
        if isinstance(parameter, LinkMass):
            return float(self.nominal.mass[parameter.index])
        if isinstance(parameter, LinkSpring) and parameter not in self.link_springs:
            return 0.0
        if not isinstance(parameter, Spring):
            raise _missing_parameter(parameter)
        return (
            float(self.constant_compliance[self.row(parameter)])
            if parameter.linear
            else dict(self.terms).get(parameter, 0.0)
        )

    def prior_sigma(self, parameter: Parameter) -> float:
        """Return the standard deviation that the model states for a mass or the compensator's size, SI; else inf."""
        if isinstance(parameter, LinkMass):
            return self.mass_spread * self.value(parameter)
        if isinstance(parameter, CompensatorSize):
            return self.compensator_spread * self.value(parameter)
        return np.inf

    @cached_property
    def basis(self) -> str:
        """Where the covariance comes from, in words; empty without covariance."""
        if self.covariance is None:
            return ""
        if not self.stated_spread:
            return "measured on this robot"
        origin = self._stated_basis()
        if len(self.stated_spread) == len(self.covariance.parameters):
            return f"{origin}, not measured on this robot"
        names = ", ".join(parameter.symbol for parameter in self.stated_spread)
        return f"measured on this robot, but for {names}: {origin}"

    def _stated_basis(self) -> str:
        """Return the origin of compliances that were not identified, in words.

        The best origin comes first, in the order of `_BASIS_WORDS`. Joints with another origin follow by name: "from
        published values, A4, A5 assumed". The parameters of `stated_spread` are those that were not identified.
        """
        joints = dict.fromkeys(
            parameter.joint for parameter in self.stated_spread if isinstance(parameter, JointCompliance)
        )
        kinds = {joint: self.spring_basis.get(joint, "published") for joint in joints}
        present = [kind for kind in _BASIS_WORDS if kind in kinds.values()] or ["published"]
        remarks = (
            f"{', '.join(joint for joint, joint_kind in kinds.items() if joint_kind == kind)} {_BASIS_WORDS[kind]}"
            for kind in present[1:]
        )
        return ", ".join([_BASIS_WORDS[present[0]], *remarks])

    def link_shapes(self, *, for_drawing: bool) -> tuple[list[LinkShape], list[str]]:
        """Return the surface of each link that has one, and a sentence for each shape that could not be read.

        :param for_drawing: True for <visual> shapes, False for <collision> shapes. Links without shapes of this kind
            have their shapes of the other kind.
        :returns: surfaces in the frames of their joints [m], the base first; the sentences.
        """
        # links with shapes of this kind
        carriers = {geometry.carrier for geometry in self.geometries if geometry.drawn == for_drawing}
        selection = [
            geometry
            for geometry in self.geometries
            if geometry.drawn == for_drawing or geometry.carrier not in carriers
        ]
        surfaces, problems = shapes.read(selection, Path(self.urdf))
        return shapes.join_by_carrier(surfaces), problems

    @cached_property
    def passive(self) -> tuple[int, ...]:
        """Indices of the coordinates of link springs, which no motor drives."""
        return tuple(sorted(set(range(self.actual.nv)) - set(self.actuated)))

    @cached_property
    def geometry_is_nominal(self) -> bool:
        """Whether the actual geometry is the controller's: no calibration, and no errors of transmission."""
        if self.transmission is not None:
            return False
        nominal = elastic_chain(self.nominal, self.link_springs).chain  # with the coordinates of `actual`
        return bool((nominal.placement == self.actual.placement).all() and (nominal.flange == self.actual.flange).all())

    @cached_property
    def has_weight(self) -> bool:
        """Whether links or payload have mass."""
        return bool((self.loaded.mass > 0.0).any())

    @cached_property
    def unit_mass_chain(self) -> Chain:
        """The elastic chain with one kilogram at the stated centre of each link, without payload."""
        mass, centre = np.zeros(self.actual.nv), np.zeros((self.actual.nv, 3))
        for joint in JOINTS:
            link = LinkMass(joint)
            mass[self.row(link)], centre[self.row(link)] = 1.0, self.nominal.centre[link.index]
        return replace(self.actual, mass=mass, centre=centre)

    def with_link_springs(self, springs: Iterable[LinkSpring]) -> RobotModel:
        """Return the robot with a further coordinate of infinite stiffness for each link spring.

        Coordinates are inserted in the order of the links from the base. Without springs the robot itself is returned.
        The robot must have six coordinates and no payload.
        """
        order = [LinkSpring(link, axis) for link in (BASE, *JOINTS) for axis in LINK_AXES]
        link_springs = tuple(sorted(set(springs), key=order.index))
        if not link_springs:
            return self
        chain, joint_rows, _ = elastic_chain(self.actual, link_springs)
        stiffness = np.full(chain.nv, np.inf)
        stiffness[list(joint_rows)] = np.diag(self.stiffness)
        return replace(
            self,
            actual=chain,
            loaded=chain,
            stiffness=np.diag(stiffness),
            actuated=joint_rows,
            link_springs=link_springs,
        )

    def with_values(self, values: Mapping[Parameter, float]) -> RobotModel:
        """Return the robot with other (linear) values of some parameters, SI; all other parameters keep their values.

        :raises ModelError: the robot does not have one of the springs.
        """
        constant_compliance, terms = self.constant_compliance.copy(), dict(self.terms)
        for parameter, value in values.items():
            if not isinstance(parameter, Spring):
                continue
            if parameter.linear:
                constant_compliance[self.row(parameter)] = value
            else:
                terms[parameter] = value
        with np.errstate(divide="ignore"):  # rigid springs: infinite stiffness
            stiffness = np.diag(1.0 / (constant_compliance + self._initial_compliance(terms.items())))
        robot = self._with_masses({p: value for p, value in values.items() if isinstance(p, LinkMass)})
        compensator = self._compensator_with(values)
        return replace(robot, stiffness=stiffness, terms=tuple(terms.items()), compensator=compensator)

    def _compensator_with(self, values: Mapping[Parameter, float]) -> Compensator | None:
        """Return the compensator with new values of its spring, SI; None without compensator.

        `CompensatorSize` keeps the free length. Of stiffness and preload, the one without a new value is unchanged.
        """
        law = self.compensator
        if law is None or not any(isinstance(parameter, CompensatorTorque) for parameter in values):
            return law
        if (size := values.get(CompensatorSize())) is not None:
            return law.with_spring(size, size * law.free_length)
        stiffness, preload = (values.get(parameter, self.value(parameter)) for parameter in COMPENSATOR)
        return law.with_spring(stiffness, preload)

    def _with_masses(self, masses: Mapping[LinkMass, float]) -> RobotModel:
        """Return the robot with other masses of links [kg]; the payload is unchanged."""
        nominal_arm, actual_arm, loaded_arm = self.nominal, self.actual, self.loaded
        has_payload = loaded_arm is not actual_arm
        for link, mass in masses.items():
            difference, centre, row = mass - self.value(link), nominal_arm.centre[link.index], self.row(link)
            nominal_arm = nominal_arm.with_mass(link.index, difference, centre)
            actual_arm = actual_arm.with_mass(row, difference, centre)
            loaded_arm = loaded_arm.with_mass(row, difference, centre) if has_payload else actual_arm
        return replace(self, nominal=nominal_arm, actual=actual_arm, loaded=loaded_arm)

    def with_root(self, root: Array) -> RobotModel:
        """Return the model whose real arm is displaced as a whole; the controller's geometry is unchanged.

        :param root: (4, 4) displacement in the root of the robot [m].
        """
        actual_arm = self.actual.with_root(root)
        loaded_arm = actual_arm if self.loaded is self.actual else self.loaded.with_root(root)
        return replace(self, actual=actual_arm, loaded=loaded_arm)

    def with_payload(self, mass: float, centre: Array) -> RobotModel:
        """Return the model carrying a further payload.

        :param mass: [kg].
        :param centre: (3,) centre of mass in the flange frame [m].
        """
        if mass == 0.0:
            return self
        return replace(self, loaded=self.loaded.with_payload(mass, np.asarray(centre, dtype=float)))


def waves(q: Array) -> Array:
    """Return sin q, cos q, sin 2q, cos 2q (4, ...) of angles [rad]."""
    return np.stack([np.sin(q), np.cos(q), np.sin(2.0 * q), np.cos(2.0 * q)])


def _missing_parameter(parameter: Parameter) -> ModelError:
    """Return the error for a parameter that the model lacks; its name is from [covariance] of a file."""
    return ModelError(
        f"[covariance] names {parameter.name!r}, which the model does not have",
        advice="Identify the model anew, or remove [covariance].",
    )
