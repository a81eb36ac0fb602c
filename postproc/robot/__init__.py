"""A robot is a folder: `robot.urdf` (geometry, limits, speeds, masses) and `model.toml` (what was identified).

`load` reads the folder into a `RobotModel`: two chains (the controller's nominal geometry, and the actual
one with the calibrated geometry), the springs, the compensator, the covariance, and where each value comes from.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from postproc import files
from postproc.compensator import Compensator
from postproc.errors import ModelError
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array, rotation_from_vector
from postproc.robot import parameters, urdf
from postproc.robot.chain import Chain
from postproc.robot.flexible import elastic_chain
from postproc.robot.model_file import (
    BASE,
    FLANGE,
    JOINTS,
    CovarianceTable,
    Displacement,
    LinkSprings,
    ModelFile,
    Sourced,
)
from postproc.robot.parameters import (
    COMPENSATOR,
    JOINT_COMPLIANCES,
    LINK_AXES,
    CompensatorPreload,
    CompensatorStiffness,
    CompensatorTorque,
    FadingPart,
    JointCompliance,
    LinkSpring,
    Parameter,
    Spring,
    file_slopes,
)

__all__ = [
    "BASE",
    "COMPENSATOR",
    "FLANGE",
    "JOINTS",
    "JOINT_COMPLIANCES",
    "LINK_AXES",
    "Chain",
    "CompensatorPreload",
    "CompensatorStiffness",
    "CompensatorTorque",
    "Covariance",
    "Displacement",
    "FadingPart",
    "JointCompliance",
    "LinkSpring",
    "LinkSprings",
    "ModelFile",
    "Parameter",
    "Provenance",
    "RobotModel",
    "Spring",
    "assemble",
    "elastic_chain",
    "file_slopes",
    "find",
    "load",
    "shipped",
]


@dataclass(frozen=True, slots=True)
class Provenance:
    """One value of a model and where it comes from."""

    name: str
    value: str
    source: str
    assumed: bool


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
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


@dataclass(frozen=True, eq=False)
class RobotModel:
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
    :param provenance: where each value comes from.
    :param terms: parameters of springs that do not grow with the torque, with their values.
    :param carries_weight: they feel the torque at rest (weights, compensator) too, not the load alone.
    :param link_springs: springs of the links, in the order of their coordinates.
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
    provenance: tuple[Provenance, ...]
    terms: tuple[tuple[Spring, float], ...] = ()
    carries_weight: bool = False
    link_springs: tuple[LinkSpring, ...] = ()

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
            out[parameter.row(self)] += value * parameter.effect(zero, zero)[1][0]
        return out

    @cached_property
    def passive(self) -> tuple[int, ...]:
        """Coordinates of the link springs: those that no motor moves."""
        return tuple(sorted(set(range(self.actual.nv)) - set(self.actuated)))

    @cached_property
    def geometry_is_nominal(self) -> bool:
        """True if the actual geometry is the controller's."""
        plain = elastic_chain(self.nominal, self.link_springs)[0]
        return bool((plain.placement == self.actual.placement).all() and (plain.flange == self.actual.flange).all())

    @cached_property
    def has_weight(self) -> bool:
        """True if links or payload have mass."""
        return bool((self.loaded.mass > 0.0).any())

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
            law = law.with_spring(*(values.get(parameter, parameter.of(self)) for parameter in COMPENSATOR))
        with np.errstate(divide="ignore"):
            stiffness = np.diag(1.0 / (steady + self._at_small_torque(terms.items())))
        return replace(self, stiffness=stiffness, terms=tuple(terms.items()), compensator=law)

    def with_payload(self, mass: float, centre: Array) -> RobotModel:
        """Return the model carrying a further payload.

        :param mass: [kg].
        :param centre: (3,) centre of mass in the flange frame [m].
        """
        if mass == 0.0:
            return self
        return replace(self, loaded=self.loaded.with_payload(mass, np.asarray(centre, dtype=float)))


def shipped() -> dict[str, Path]:
    """Return the robot models that come with the package: name → folder."""
    package = Path(__file__).parent.parent
    root = package / "robot_models"  # where a wheel puts it; in a checkout it stands beside the package
    root = root if root.is_dir() else package.parent / "robot_models"
    return {folder.name: folder for folder in sorted(root.iterdir()) if (folder / "model.toml").is_file()}


def find(name: str, relative_to: Path | None = None) -> Path:
    """Return the folder of a robot given by name or by path (relative to `relative_to`).

    :raises ModelError: there is no such robot; the message lists the known ones.
    """
    known = shipped()
    if name in known:
        return known[name]
    folder = (relative_to or Path()) / name
    if not (folder / "model.toml").is_file():
        raise ModelError(
            f"no robot {name!r}",
            advice=f"Give the path of a folder with robot.urdf and model.toml, or one of: {', '.join(known)}.",
        )
    return folder


def load(folder: str | Path) -> RobotModel:
    """Read a robot model folder.

    :raises ModelError: a file is missing or wrong: not six revolute joints A1…A6 in a chain that ends in `flange`, a
        limit missing, values not finite, a joint without compliance.
    """
    folder = Path(folder)
    content = files.read_toml(folder / "model.toml", ModelFile, ModelError)
    where = str(folder / "model.toml")
    for table, valid in (
        (content.joints, JOINTS),
        (content.geometry, (*JOINTS, FLANGE)),
        (content.links, (BASE, *JOINTS)),
    ):
        wrong = [name for name in table if name not in valid]
        if wrong:
            raise ModelError(f"unknown joint {wrong[0]!r}", file=where, advice=f"Valid: {', '.join(valid)}.")
    missing = [name for name in JOINTS if name not in content.joints]
    if missing:
        raise ModelError(f"no [joints.{missing[0]}]", file=where, advice="Every joint needs a compliance.")
    for name, spring in content.joints.items():
        if sum(part.compliance_urad_per_Nm for part in spring.stiffening) > spring.compliance_urad_per_Nm * (1 + 1e-6):
            raise ModelError(f"[joints.{name}]: the stiffening parts are more than the whole compliance", file=where)
    _check_covariance(content.covariance, where)
    path = folder / "robot.urdf"
    robot = assemble(folder.resolve().name, content, urdf.read(files.read_text(path, ModelError), str(path)))
    for parameter in robot.covariance.parameters if robot.covariance is not None else ():
        try:
            parameter.row(robot)
        except ModelError as error:
            raise ModelError(error.problem, file=where) from None
    return robot


def assemble(name: str, content: ModelFile, nominal: Chain) -> RobotModel:
    """Build a `RobotModel` from the content of `model.toml` and the controller's geometry."""
    placement, flange = nominal.placement.copy(), nominal.flange
    for place, entry in content.geometry.items():
        if place == FLANGE:
            flange = flange @ _placement(entry)
        else:
            placement[JOINTS.index(place)] = placement[JOINTS.index(place)] @ _placement(entry)
    actual = replace(nominal, placement=placement, flange=flange)
    if (carried := content.payload) is not None:
        actual = actual.with_payload(carried.mass_kg, np.array([carried.X_mm, carried.Y_mm, carried.Z_mm]) * M_PER_MM)
    values, table = parameters.stated(content), content.covariance
    rigid = RobotModel(
        name=name,
        title=content.name,
        nominal=nominal,
        actual=actual,
        loaded=actual,
        stiffness=np.diag(np.full(len(JOINTS), np.inf)),
        actuated=tuple(range(len(JOINTS))),
        compensator=content.compensator.law() if content.compensator else None,
        subtract_reference=content.gravity.reference == "calibrated",
        lower=nominal.lower,
        upper=nominal.upper,
        speed=nominal.speed,
        covariance=None if table is None else Covariance.of(table.parameters, table.matrix),
        provenance=tuple(_provenance(content, nominal)),
        carries_weight=content.gravity.in_gears,
    )
    springs = [parameter for parameter in values if isinstance(parameter, LinkSpring)]
    return rigid.with_link_springs(springs).with_values(values)


def _placement(entry: Displacement) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_vector(np.array([entry.RX_deg, entry.RY_deg, entry.RZ_deg]) * RAD_PER_DEG)
    pose[:3, 3] = np.array([entry.X_mm, entry.Y_mm, entry.Z_mm]) * M_PER_MM
    return pose


def _check_covariance(covariance: CovarianceTable | None, where: str) -> None:
    if covariance is None:
        return
    unknown = [name for name in covariance.parameters if parameters.named(name) is None]
    if unknown:
        raise ModelError(
            f"[covariance] names {unknown[0]!r}, which no parameter of the elastic model is called",
            file=where,
            advice="Valid: k1 … k6, k1@800 (what fades beyond 800 N·m), A2.RX (a spring of a link), K_c, s_0.",
        )
    size = len(covariance.parameters)
    if any(len(row) != size for row in covariance.matrix) or len(covariance.matrix) != size:
        raise ModelError(f"[covariance] matrix is not {size}×{size}", file=where)
    matrix = np.array(covariance.matrix)
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0) or np.linalg.eigvalsh(matrix).min(
        initial=0.0
    ) < -1e-9 * np.abs(matrix).max(initial=0.0):
        raise ModelError("[covariance] matrix is not symmetric positive semidefinite", file=where)


def _provenance(content: ModelFile, nominal: Chain) -> Iterator[Provenance]:
    for name in JOINTS:
        spring = content.joints[name]
        interval = "" if spring.ci95 is None else f" ± {spring.ci95:.3g}"
        value = f"{spring.compliance_urad_per_Nm:g}{interval} µrad/(N·m)"
        if spring.stiffening:
            fades = sum(part.compliance_urad_per_Nm for part in spring.stiffening)
            value += f", of which {fades:.3g} fade with load"
        yield Provenance(f"compliance {name}", value, spring.source, spring.assumed)
    if (spring_law := content.compensator) is not None:
        value = f"L {spring_law.L_mm:g}, a_x {spring_law.a_x_mm:g}, a_y {spring_law.a_y_mm:g} mm"
        geometry_source = spring_law.geometry_source or spring_law.source
        assumed = spring_law.assumed and not spring_law.geometry_source
        yield Provenance("compensator geometry", value, geometry_source, assumed)
        value = f"K_c {spring_law.stiffness_N_per_m:g} N/m, s_0 {spring_law.free_length_mm:g} mm"
        yield Provenance("compensator spring", value, spring_law.source, spring_law.assumed)
    if (carried := content.payload) is not None:
        value = f"{carried.mass_kg:g} kg at {carried.X_mm:g}, {carried.Y_mm:g}, {carried.Z_mm:g} mm of the flange"
        yield Provenance("payload when measured", value, carried.source, carried.assumed)
    for name, springs in content.links.items():
        count = sum(spring.link == name for spring, _ in LinkSpring.stated(content))
        yield Provenance(f"springs of link {name}", f"{count} directions", springs.source, springs.assumed)
    for name, entry in content.geometry.items():
        value = (
            f"{entry.X_mm:g}, {entry.Y_mm:g}, {entry.Z_mm:g} mm; {entry.RX_deg:g}, {entry.RY_deg:g}, {entry.RZ_deg:g}°"
        )
        yield Provenance(f"calibrated {name}", value, entry.source, entry.assumed)
    masses = ", ".join(f"{mass:g}" for mass in nominal.mass)
    for label, value, entry_source in (
        ("link masses", f"{masses} kg", content.masses),
        ("geometry, limits, speeds", "robot.urdf", content.geometry_nominal),
    ):
        source = entry_source or Sourced(source="not stated", assumed=True)
        yield Provenance(label, value, source.source, source.assumed)
    yield Provenance("gravity reference", content.gravity.reference, "model.toml", assumed=False)
