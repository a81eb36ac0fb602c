"""A robot is a folder: `robot.urdf` (geometry, limits, speeds, masses) and `model.toml` (what was identified).

`load` reads the folder into a `RobotModel`: two Pinocchio models (the controller's nominal geometry, and the actual
one with the calibrated geometry), the springs, the compensator, the covariance, and where each value comes from.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
import pinocchio as pin

from postproc import files
from postproc.compensator import Compensator
from postproc.errors import ModelError
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array, rotation_from_vector

JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
FLANGE = "flange"
RAD_PER_URAD = 1e-6

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]


class _Sourced(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    source: str
    assumed: bool = False


class JointSpring(_Sourced, frozen=True, kw_only=True):
    """Compliance of one virtual joint spring."""

    compliance_urad_per_Nm: Positive
    ci95: NotNegative | None = None


class CompensatorEntry(_Sourced, frozen=True, kw_only=True):
    """Gravity compensator at joint A2, paper Eq. (3)–(4)."""

    L_mm: Positive
    a_x_mm: float
    a_y_mm: float
    stiffness_N_per_m: NotNegative
    free_length_mm: NotNegative
    geometry_source: str = ""

    def law(self) -> Compensator:
        """Return the law in SI units."""
        return Compensator(
            stiffness=self.stiffness_N_per_m,
            free_length=self.free_length_mm * M_PER_MM,
            L=self.L_mm * M_PER_MM,
            ax=self.a_x_mm * M_PER_MM,
            ay=self.a_y_mm * M_PER_MM,
        )


class Gravity(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What the geometry describes: the robot sagged under its own weight, or a weightless robot."""

    reference: Literal["calibrated", "rigid"] = "calibrated"


class Displacement(_Sourced, frozen=True, kw_only=True):
    """Calibrated geometry: how far a joint (or the flange) stands from its nominal place on the link before it.

    X, Y, Z [mm] and a rotation vector RX, RY, RZ [deg], in the axes of the nominal joint frame.
    """

    X_mm: float = 0.0
    Y_mm: float = 0.0
    Z_mm: float = 0.0
    RX_deg: float = 0.0
    RY_deg: float = 0.0
    RZ_deg: float = 0.0

    def placement(self) -> pin.SE3:
        """Return the displacement as a placement [m]."""
        rotation = rotation_from_vector(np.array([self.RX_deg, self.RY_deg, self.RZ_deg]) * RAD_PER_DEG)
        return pin.SE3(rotation, np.array([self.X_mm, self.Y_mm, self.Z_mm]) * M_PER_MM)


class Covariance(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Covariance of identified parameters, in the units of the file (k1…k6 in µrad/(N·m))."""

    parameters: list[str]
    matrix: list[list[float]]


class ModelFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Content of `model.toml`."""

    name: str
    joints: dict[str, JointSpring]
    date: str = ""
    gravity: Gravity = Gravity()
    compensator: CompensatorEntry | None = None
    geometry: dict[str, Displacement] = {}
    covariance: Covariance | None = None
    masses: _Sourced | None = None
    geometry_nominal: _Sourced | None = None


@dataclass(frozen=True, slots=True)
class Provenance:
    """One value of a model and where it comes from."""

    name: str
    value: str
    source: str
    assumed: bool


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A robot as the package computes with it. SI units, KUKA joint signs, root frame = `$ROBROOT`.

    :param name: name of the model folder.
    :param title: full name of the robot.
    :param nominal: the controller's geometry.
    :param actual: geometry of the real robot (calibrated where known), with the masses of its links.
    :param loaded: `actual` with the payload that is carried beyond the calibrated state.
    :param stiffness: (nv, nv) K⁰_θ of the virtual springs [N·m/rad, N/m].
    :param actuated: (6,) rows of A1…A6 among the nv coordinates of `actual`.
    :param compensator: spring beside A2, or None.
    :param subtract_reference: True if the geometry holds the state of rest under own weight (``"calibrated"``).
    :param lower: (6,) joint limits [rad].
    :param upper: (6,) joint limits [rad].
    :param speed: (6,) joint speed limits [rad/s].
    :param covariance: of the identified parameters, or None.
    :param provenance: where each value comes from.
    """

    name: str
    title: str
    nominal: pin.Model
    actual: pin.Model
    loaded: pin.Model
    stiffness: Array
    actuated: tuple[int, ...]
    compensator: Compensator | None
    subtract_reference: bool
    lower: Array
    upper: Array
    speed: Array
    covariance: Covariance | None
    provenance: tuple[Provenance, ...]

    @cached_property
    def geometry_is_nominal(self) -> bool:
        """True if the actual geometry is the controller's."""
        return all(
            frame.placement.isApprox(other.placement, 0.0)
            for frame, other in zip(self.nominal.frames, self.actual.frames, strict=True)
        ) and all(
            one.isApprox(other, 0.0)
            for one, other in zip(self.nominal.jointPlacements, self.actual.jointPlacements, strict=True)
        )

    @cached_property
    def has_weight(self) -> bool:
        """True if links or payload have mass."""
        return any(inertia.mass > 0.0 for inertia in list(self.loaded.inertias)[1:])

    def with_payload(self, mass: float, centre: Array) -> RobotModel:
        """Return the model carrying a further payload.

        :param mass: [kg].
        :param centre: (3,) centre of mass in the flange frame [m].
        """
        if mass == 0.0:
            return self
        loaded = self.loaded.copy()
        flange = loaded.frames[loaded.getFrameId(FLANGE)]
        loaded.appendBodyToJoint(
            flange.parentJoint, pin.Inertia(mass, np.asarray(centre, dtype=float), np.zeros((3, 3))), flange.placement
        )
        return replace(self, loaded=loaded)


def shipped() -> dict[str, Path]:
    """Return the robot models that come with the package: name → folder."""
    root = Path(str(resources.files("postproc.robot_models")))
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
    for table in (content.joints, content.geometry):
        wrong = [name for name in table if name not in (*JOINTS, FLANGE)]
        if wrong:
            raise ModelError(f"unknown joint {wrong[0]!r}", file=where, advice=f"Valid: {', '.join(JOINTS)}.")
    missing = [name for name in JOINTS if name not in content.joints]
    if missing:
        raise ModelError(f"no [joints.{missing[0]}]", file=where, advice="Every joint needs a compliance.")
    _check_covariance(content.covariance, where)
    nominal = _nominal(folder / "robot.urdf")
    actual = nominal.copy()
    for name, entry in content.geometry.items():
        if name == FLANGE:
            frame = actual.frames[actual.getFrameId(FLANGE)]
            frame.placement = frame.placement * entry.placement()
        else:
            joint = actual.getJointId(name)
            actual.jointPlacements[joint] = actual.jointPlacements[joint] * entry.placement()
    compliance = np.array([content.joints[name].compliance_urad_per_Nm for name in JOINTS]) * RAD_PER_URAD
    return RobotModel(
        name=folder.resolve().name,
        title=content.name,
        nominal=nominal,
        actual=actual,
        loaded=actual,
        stiffness=np.diag(1.0 / compliance),
        actuated=tuple(range(len(JOINTS))),
        compensator=content.compensator.law() if content.compensator else None,
        subtract_reference=content.gravity.reference == "calibrated",
        lower=nominal.lowerPositionLimit.copy(),
        upper=nominal.upperPositionLimit.copy(),
        speed=nominal.velocityLimit.copy(),
        covariance=content.covariance,
        provenance=tuple(_provenance(content, nominal)),
    )


def _nominal(path: Path) -> pin.Model:
    text = files.read_text(path, ModelError)
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as cause:
        raise ModelError(f"not a URDF that Pinocchio reads: {cause}", file=str(path)) from cause
    if tuple(model.names)[1:] != JOINTS or model.nq != len(JOINTS):
        raise ModelError(
            f"joints are {', '.join(list(model.names)[1:])}",
            file=str(path),
            advice=f"The robot must be a chain of six revolute joints named {', '.join(JOINTS)}.",
        )
    if not model.existFrame(FLANGE):
        raise ModelError(f"no link named {FLANGE!r}", file=str(path), advice="The last frame must be `flange`.")
    masses = [inertia.mass for inertia in list(model.inertias)[1:]]
    limits = np.array([model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit])
    if not (np.isfinite(limits).all() and (limits[0] < limits[1]).all() and (limits[2] > 0).all()):
        raise ModelError(
            "joint limits are missing or impossible",
            file=str(path),
            advice="Every joint needs <limit lower upper velocity> in radians, lower < upper, velocity > 0.",
        )
    placements = [p.homogeneous for p in model.jointPlacements]
    if not (np.isfinite(placements).all() and np.isfinite(masses).all()):
        raise ModelError("a number is not finite", file=str(path))
    return model


def _check_covariance(covariance: Covariance | None, where: str) -> None:
    if covariance is None:
        return
    size = len(covariance.parameters)
    if any(len(row) != size for row in covariance.matrix) or len(covariance.matrix) != size:
        raise ModelError(f"[covariance] matrix is not {size}×{size}", file=where)
    matrix = np.array(covariance.matrix)
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0) or np.linalg.eigvalsh(matrix).min(
        initial=0.0
    ) < -1e-9 * np.abs(matrix).max(initial=0.0):
        raise ModelError("[covariance] matrix is not symmetric positive semidefinite", file=where)


def _provenance(content: ModelFile, nominal: pin.Model) -> Iterator[Provenance]:
    for name in JOINTS:
        spring = content.joints[name]
        interval = "" if spring.ci95 is None else f" ± {spring.ci95:.3g}"
        value = f"{spring.compliance_urad_per_Nm:g}{interval} µrad/(N·m)"
        yield Provenance(f"compliance {name}", value, spring.source, spring.assumed)
    if (spring_law := content.compensator) is not None:
        value = f"L {spring_law.L_mm:g}, a_x {spring_law.a_x_mm:g}, a_y {spring_law.a_y_mm:g} mm"
        geometry_source = spring_law.geometry_source or spring_law.source
        assumed = spring_law.assumed and not spring_law.geometry_source
        yield Provenance("compensator geometry", value, geometry_source, assumed)
        value = f"K_c {spring_law.stiffness_N_per_m:g} N/m, s_0 {spring_law.free_length_mm:g} mm"
        yield Provenance("compensator spring", value, spring_law.source, spring_law.assumed)
    for name, entry in content.geometry.items():
        value = (
            f"{entry.X_mm:g}, {entry.Y_mm:g}, {entry.Z_mm:g} mm; {entry.RX_deg:g}, {entry.RY_deg:g}, {entry.RZ_deg:g}°"
        )
        yield Provenance(f"calibrated {name}", value, entry.source, entry.assumed)
    masses = ", ".join(f"{inertia.mass:g}" for inertia in list(nominal.inertias)[1:])
    for label, value, entry_source in (
        ("link masses", f"{masses} kg", content.masses),
        ("geometry, limits, speeds", "robot.urdf", content.geometry_nominal),
    ):
        source = entry_source or _Sourced(source="not stated", assumed=True)
        yield Provenance(label, value, source.source, source.assumed)
    yield Provenance("gravity reference", content.gravity.reference, "model.toml", assumed=False)
