"""Model folders: list them, find one, read it into a `RobotModel`, and list its values with their sources."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc import files
from postproc.errors import ModelError, choices, did_you_mean
from postproc.frames import DEG_PER_RAD, M_PER_MM, RAD_PER_DEG, Array, rotation_from_vector
from postproc.robot import parameters, urdf
from postproc.robot.chain import Chain
from postproc.robot.model import (
    FORCES,
    Basis,
    Covariance,
    Discrepancy,
    ForceFactor,
    GeometryError,
    MeasuredRange,
    RobotModel,
    SourcedValue,
    Transmission,
)
from postproc.robot.model_file import (
    BASE,
    FLANGE,
    JOINTS,
    DiscrepancyEntry,
    Displacement,
    GeometryErrorEntry,
    JointSpring,
    Masses,
    ModelFile,
    SourcedEntry,
)
from postproc.robot.parameters import LinkMass, LinkSpring, Parameter

_WRIST = JOINTS[3:]
"""Joints whose gears may be coupled."""
_SUM_ROUNDING = 1e-6
"""Relative excess of a sum of parts over the whole that rounding of the written numbers explains."""
_ASYMMETRY = 1e-6
"""Relative difference of mirrored values of a covariance that rounding of the written numbers explains."""
_NEGATIVE_EIGENVALUE = -1e-9
"""Least eigenvalue of a covariance, in shares of its largest value, that rounding explains."""


def shipped_models() -> dict[str, Path]:
    """Return the robot models that come with the package: name → folder, sorted by name."""
    package = Path(__file__).parent.parent
    root = package / "robot_models"  # in a wheel; in a checkout it is next to the package
    root = root if root.is_dir() else package.parent / "robot_models"
    return {folder.name: folder for folder in sorted(root.iterdir()) if (folder / "model.toml").is_file()}


def find(name: str, relative_to: Path | None = None) -> Path:
    """Return the folder of a robot.

    :param name: of a shipped robot, or path of a folder, with slashes or backslashes.
    :param relative_to: folder that a path is relative to; None: the working directory.
    :raises ModelError: there is no such robot; the message lists the known ones.
    """
    robots = shipped_models()
    if name in robots:
        return robots[name]
    folder = (relative_to or Path()) / name.replace("\\", "/")
    if not (folder / "model.toml").is_file():
        raise ModelError(
            f"no robot {name!r}",
            advice=f"{did_you_mean(name, robots)} Give the path of a folder with robot.urdf and model.toml, or one of: "
            f"{', '.join(robots)}.".lstrip(),
        )
    return folder


def load(folder: str | Path) -> RobotModel:
    """Read a robot model folder.

    :raises ModelError: a file is missing or wrong: not six revolute joints A1…A6 in a chain that ends in `flange`, a
        limit missing, values not finite, a joint without compliance.
    """
    folder = Path(folder)
    content = files.read_toml(folder / "model.toml", ModelFile, ModelError)
    file_name = str(folder / "model.toml")
    _check_joint_names(content, file_name)
    for name, spring in content.joints.items():
        _check_spring(name, spring, file_name)
    _check_covariance(content, file_name)
    _check_angles(content.geometry_error, file_name)
    if content.discrepancy is not None:
        _check_discrepancy(content.discrepancy, file_name)
    path = folder / "robot.urdf"
    text = files.read_text(path, ModelError)
    robot = assemble(folder.resolve().name, content, urdf.read(text, str(path)))
    robot = replace(robot, geometries=urdf.geometries(text, str(path)), urdf=str(path.resolve()))
    for parameter in robot.covariance.parameters if robot.covariance is not None else ():
        try:
            robot.row(parameter)
        except ModelError as error:
            raise ModelError(error.problem, file=file_name) from None
    return robot


def _check_joint_names(content: ModelFile, file_name: str) -> None:
    """Check the names of the tables of joints and links, and that each joint has a spring.

    :raises ModelError: a name is not valid, or a joint is missing.
    """
    for table, valid in (
        (content.joints, JOINTS),
        (content.geometry, (*JOINTS, FLANGE)),
        (content.transmission, JOINTS),
        (content.links, (BASE, *JOINTS)),
    ):
        unknown_names = [name for name in table if name not in valid]
        if unknown_names:
            raise ModelError(
                f"unknown joint {unknown_names[0]!r}", file=file_name, advice=choices(unknown_names[0], valid)
            )
    absent_joints = [name for name in JOINTS if name not in content.joints]
    if absent_joints:
        raise ModelError(f"no [joints.{absent_joints[0]}]", file=file_name, advice="Every joint needs a compliance.")


def _check_discrepancy(discrepancy: DiscrepancyEntry, file_name: str) -> None:
    """Check that the loads of [discrepancy] are positive and ascend, and that each load has an error.

    :raises ModelError: they do not.
    """
    if not (
        0 < len(discrepancy.load_N) == len(discrepancy.u95_mm)
        and discrepancy.load_N[0] > 0.0
        and np.all(np.diff(discrepancy.load_N) > 0.0)
    ):
        raise ModelError(
            "[discrepancy] needs ascending load_N above zero, and as many u95_mm",
            file=file_name,
            advice="Sort them by load_N, one u95_mm for each.",
        )


def assemble(name: str, content: ModelFile, nominal: Chain) -> RobotModel:
    """Build a `RobotModel` from the content of `model.toml` and the controller's geometry.

    :param name: of the model folder.
    :param content: content that `load` or its writer has checked.
    :param nominal: geometry, limits and masses of robot.urdf.
    """
    actual = _actual_chain(content, nominal)
    values, load_range = parameters.stated_values(content), content.measured
    covariance, stated_spread = _covariance(content)
    masses = content.masses or Masses(source="")  # a file without [masses] has the default spread
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
        covariance=covariance,
        force_factor=_force_factor(content, covariance),
        sources=tuple(sourced_values(content, nominal)),
        carries_weight=content.gravity.in_gears,
        discrepancy=_discrepancy(content.discrepancy),
        geometry_error=_geometry_error(content.geometry_error),
        measured=None if load_range is None else MeasuredRange(np.array(load_range.torque_Nm), load_range.not_trusted),
        language=content.language,
        transmission=Transmission.of(content.transmission),
        mass_spread=masses.spread_percent / 100.0,
        compensator_spread=0.0 if content.compensator is None else content.compensator.spread_percent / 100.0,
        stated_spread=stated_spread,
        spring_basis={name: _basis(spring) for name, spring in content.joints.items()},
    )
    springs = [parameter for parameter in values if isinstance(parameter, LinkSpring)]
    return rigid.with_link_springs(springs).with_values(values)


def _actual_chain(content: ModelFile, nominal: Chain) -> Chain:
    """Return the calibrated chain of a model file, with the payload that it carried during the measurements."""
    placement, flange = nominal.placement.copy(), nominal.flange
    for place, entry in content.geometry.items():
        if place == FLANGE:
            flange = flange @ _placement(entry)
        else:
            placement[JOINTS.index(place)] = placement[JOINTS.index(place)] @ _placement(entry)
    actual = replace(nominal, placement=placement, flange=flange)
    if (payload := content.payload) is None:
        return actual
    return actual.with_payload(payload.mass_kg, np.array([payload.X_mm, payload.Y_mm, payload.Z_mm]) * M_PER_MM)


def _check_spring(name: str, spring: JointSpring, file_name: str) -> None:
    """Check the entry of one joint: its fading parts, its couplings and its waves over the pose.

    :param name: of the joint, ``A1`` … ``A6``.
    :raises ModelError: fading parts exceed the compliance, a coupling is outside the wrist or stated at the later of
        its joints, or a wave has no angle or is stated twice.
    """
    if spring.fading_compliance > spring.compliance_urad_per_Nm * (1 + _SUM_ROUNDING):
        raise ModelError(
            f"[joints.{name}]: the sum of the stiffening parts exceeds the compliance",
            file=file_name,
            advice="Reduce the stiffening parts, or raise the compliance.",
        )
    later_wrist_joints = _WRIST[_WRIST.index(name) + 1 :] if name in _WRIST else ()
    wrong_joints = [second for second in spring.coupling if second not in later_wrist_joints]
    if wrong_joints:
        raise ModelError(
            f"[joints.{name}] coupling: {name} and {wrong_joints[0]} are no pair of the wrist",
            file=file_name,
            advice="State those of A4 with A5 or A6 in [joints.A4.coupling], of A5 with A6 in [joints.A5.coupling].",
        )
    turns = [entry.turns for entry in spring.over_pose]
    if any(not any(numbers) for numbers in turns):
        raise ModelError(
            f"[joints.{name}] over_pose: turns are all zero",
            file=file_name,
            advice="Add what does not depend on the pose to compliance_urad_per_Nm.",
        )
    if len(set(turns)) < len(turns):
        raise ModelError(
            f"[joints.{name}] over_pose: two entries have the same turns", file=file_name, advice="Join them to one."
        )


def _covariance(content: ModelFile) -> tuple[Covariance | None, tuple[Parameter, ...]]:
    """Return the covariance of the parameters, and the parameters whose variance is a stated spread, not from readings.

    `sigma_percent` counts for parameters that [covariance] does not name, independent of all other parameters. K_c and
    s_0 are identified together: if the table names one of them, the spread of K_c is not used.

    :returns: the covariance, None without a table and without spreads; the parameters with a stated spread, which are
        the last parameters of the covariance.
    """
    table = content.covariance
    names = [] if table is None else [name for name in table.parameters if name != FORCES]
    spreads = _stated_spreads(content, names)
    if table is None and not spreads:
        return None, ()
    matrix = np.diag([0.0] * len(names) + [sigma**2 for sigma in spreads.values()])
    if table is not None and names:
        rows = [table.parameters.index(name) for name in names]
        square = table.square
        assert square is not None, "_check_covariance has refused the table"
        matrix[: len(names), : len(names)] = square[np.ix_(rows, rows)]
    return Covariance.of([*names, *(parameter.name for parameter in spreads)], matrix), tuple(spreads)


def _stated_spreads(content: ModelFile, names: Collection[str]) -> dict[Parameter, float]:
    """Return parameter → standard deviation by `sigma_percent`, in units of the file.

    :param names: parameters that [covariance] names, which are left out.
    """
    spreads: dict[Parameter, float] = {}
    for parameter in parameters.JOINT_COMPLIANCES:
        spring = content.joints[parameter.joint]
        if spring.sigma_percent is not None and parameter.name not in names:
            spreads[parameter] = spring.sigma_percent / 100.0 * spring.compliance_urad_per_Nm
    compensator = content.compensator
    if compensator is not None and compensator.sigma_percent is not None and compensator.stiffness_N_per_m > 0.0:
        stiffness, preload = parameters.COMPENSATOR
        if stiffness.name not in names and preload.name not in names:
            spreads[stiffness] = compensator.sigma_percent / 100.0 * compensator.stiffness_N_per_m
    return spreads


def _force_factor(content: ModelFile, covariance: Covariance | None) -> ForceFactor | None:
    """Return the cutting law that the model was identified with, and the covariances of its factor; None without a law.

    Parameters that [covariance] does not name have a stated spread; they are independent of the factor.
    """
    law, table = content.forces, content.covariance
    if law is None or table is None or covariance is None:
        return None
    square = table.square
    assert square is not None, "_check_covariance has refused the table"
    # covariances of the factor with each parameter, and its variance
    factor_row = dict(zip(table.parameters, square[table.parameters.index(FORCES)].tolist(), strict=True))
    covariances = [factor_row.get(parameter.name, 0.0) for parameter in covariance.parameters]
    numbers = (*law.cutting_N_per_mm2, *law.edge_N_per_mm, law.mc, law.sigma_percent)
    return ForceFactor(numbers, np.array([*covariances, factor_row[FORCES]]))


def _discrepancy(entry: DiscrepancyEntry | None) -> Discrepancy | None:
    """Return [discrepancy] in SI units, loads [N] and 95 % bounds [m]; None without the entry."""
    return None if entry is None else Discrepancy(np.array(entry.load_N), np.array(entry.u95_mm) * M_PER_MM)


def _geometry_error(entry: GeometryErrorEntry | None) -> GeometryError | None:
    """Return [geometry_error] in SI units; None without the entry. A joint without angles has infinite limits."""
    if entry is None:
        return None
    ranges = [entry.angles_deg.get(joint, (-np.inf, np.inf)) for joint in JOINTS]
    lower, upper = np.array(ranges, dtype=float).T * RAD_PER_DEG
    return GeometryError(entry.u95_mm * M_PER_MM, lower, upper, entry.unmeasured_mm * M_PER_MM)


def _placement(entry: Displacement) -> Array:
    """Return the pose (4, 4) [m] of a displacement, which a file states in mm and as a rotation vector in degrees."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_vector(np.array([entry.RX_deg, entry.RY_deg, entry.RZ_deg]) * RAD_PER_DEG)
    pose[:3, 3] = np.array([entry.X_mm, entry.Y_mm, entry.Z_mm]) * M_PER_MM
    return pose


def _check_angles(entry: GeometryErrorEntry | None, file_name: str) -> None:
    """Check the joint ranges of [geometry_error].

    :raises ModelError: an unknown joint, or angles out of order.
    """
    for joint, (low, high) in ({} if entry is None else entry.angles_deg).items():
        if joint not in JOINTS:
            raise ModelError(f"[geometry_error] unknown joint {joint!r}", file=file_name, advice=choices(joint, JOINTS))
        if low > high:
            problem = f"[geometry_error] angles_deg: {joint} goes from {low:g} to {high:g}°"
            raise ModelError(problem, file=file_name, advice="Give the least angle first, then the largest.")


def _check_covariance(content: ModelFile, file_name: str) -> None:
    """Check [covariance], and that it names the factor of the forces exactly if [forces] states their law.

    :raises ModelError: a name is of no parameter, the size does not fit, the matrix is no covariance, or only one of
        law and factor is stated.
    """
    covariance = content.covariance
    if (content.forces is not None) != (covariance is not None and FORCES in covariance.parameters):
        advice = "Give both or none: the factor of forces is known for one cutting law."
        raise ModelError("[forces] and `forces` of [covariance] belong together", file=file_name, advice=advice)
    if covariance is None:
        return
    unknown = [name for name in covariance.parameters if name != FORCES and parameters.parameter_of_name(name) is None]
    if unknown:
        raise ModelError(
            f"[covariance] names {unknown[0]!r}, which is no parameter of the elastic model",
            file=file_name,
            advice="Valid: k1 … k6, k1@800 (the part that fades beyond 800 N·m), k1^800 (the part that ends there), "
            "A4.backlash@3, A4.lost_motion@3, k45 (A4 by a torque on A5), k3.cos(A2-A3) (a wave over the pose), "
            "A2.RX (a spring of a link), A2.mass, K_c, s_0.",
        )
    size = len(covariance.parameters)
    matrix = covariance.square
    if matrix is None:
        problem = f"[covariance] matrix is neither {size}×{size} nor the lower triangle of that"
        raise ModelError(problem, file=file_name, advice="Give a row for each parameter, with as many numbers in each.")
    is_symmetric = np.allclose(matrix, matrix.T, rtol=_ASYMMETRY, atol=0.0)
    allowed_eigenvalue = _NEGATIVE_EIGENVALUE * np.abs(matrix).max(initial=0.0)
    if not is_symmetric or np.linalg.eigvalsh(matrix).min(initial=0.0) < allowed_eigenvalue:
        raise ModelError(
            "[covariance] matrix is not symmetric positive semidefinite",
            file=file_name,
            advice="Identify the model anew, or remove [covariance].",
        )


def sourced_values(content: ModelFile, nominal: Chain) -> Iterator[SourcedValue]:
    """Yield the values of a model file and of its URDF in words, with their sources.

    :param nominal: geometry, limits and masses of robot.urdf.
    """
    yield from _joint_values(content)
    yield from _compensator_values(content)
    if (payload := content.payload) is not None:
        value = f"{payload.mass_kg:g} kg at {payload.X_mm:g}, {payload.Y_mm:g}, {payload.Z_mm:g} mm of the flange"
        yield SourcedValue("payload when measured", value, payload.source, payload.assumed)
    for name, springs in content.links.items():
        count = sum(spring.link == name for spring, _ in LinkSpring.from_file(content))
        yield SourcedValue(f"springs of link {name}", f"{count} directions", springs.source, springs.assumed)
    for name, entry in content.geometry.items():
        value = (
            f"{entry.X_mm:g}, {entry.Y_mm:g}, {entry.Z_mm:g} mm; {entry.RX_deg:g}, {entry.RY_deg:g}, {entry.RZ_deg:g}°"
        )
        yield SourcedValue(f"calibrated {name}", value, entry.source, entry.assumed)
    for name, gear in content.transmission.items():
        first_order = f"{gear.sin_urad:.3g}, {gear.cos_urad:.3g}"
        second_order = f"{gear.sin2_urad:.3g}, {gear.cos2_urad:.3g}"
        value = f"{first_order} µrad once a turn (sin, cos), {second_order} µrad twice"
        yield SourcedValue(f"transmission {name}", value, gear.source, gear.assumed)
    yield from _bound_values(content)
    yield from _nominal_values(content, nominal)
    yield SourcedValue("gravity reference", content.gravity.reference, "model.toml", assumed=False)


def _joint_values(content: ModelFile) -> Iterator[SourcedValue]:
    """Yield the compliances of the joints, with fading parts, backlash, waves, couplings and lost motion of gears."""
    for name in JOINTS:
        spring = content.joints[name]
        interval = "" if spring.ci95 is None else f" ± {spring.ci95:.3g}"
        value = f"{spring.compliance_urad_per_Nm:g}{interval} µrad/(N·m){_sigma_text(spring.sigma_percent)}"
        if spring.fading_compliance:
            value += f", of which {spring.fading_compliance:.3g} fade with load"
        if spring.backlash is not None:
            value += f"; backlash {spring.backlash.angle_urad:.3g} µrad"
        if spring.over_pose:
            value += f"; over the pose, {len(spring.over_pose)} waves"
        if spring.coupling:
            value += "; coupled: " + ", ".join(f"{size:.3g} with {joint}" for joint, size in spring.coupling.items())
        if spring.lost_motion is not None:
            value += f"; lost motion {spring.lost_motion.angle_urad:.3g} µrad"
        yield SourcedValue(f"compliance {name}", value, spring.source, spring.assumed)


def _compensator_values(content: ModelFile) -> Iterator[SourcedValue]:
    """Yield the values of the gravity compensator, if the model has one."""
    if (entry := content.compensator) is None:
        return
    geometry = f"L {entry.L_mm:g}, a_x {entry.a_x_mm:g}, a_y {entry.a_y_mm:g} mm"
    geometry_source = entry.geometry_source or entry.source
    is_assumed = entry.assumed and not entry.geometry_source
    yield SourcedValue("compensator geometry", geometry, geometry_source, is_assumed)
    stiffness = f"K_c {entry.stiffness_N_per_m:g} N/m{_sigma_text(entry.sigma_percent)}"
    yield SourcedValue(
        "compensator spring", f"{stiffness}, s_0 {entry.free_length_mm:g} mm", entry.source, entry.assumed
    )


def _angles_text(entry: GeometryErrorEntry) -> str:
    """Return the joint angles for which a bound holds as the end of a sentence; empty if no angles are stated."""
    ranges = [f"{joint} {low:.0f} to {high:.0f}°" for joint, (low, high) in entry.angles_deg.items()]
    return f" at {', '.join(ranges)}; more beyond" if ranges else ""


def _bound_values(content: ModelFile) -> Iterator[SourcedValue]:
    """Yield the unmodelled error, the error of the geometry and the range of the measurements, if they are stated."""
    if (discrepancy := content.discrepancy) is not None:
        pairs = zip(discrepancy.u95_mm, discrepancy.load_N, strict=False)
        value = ", ".join(f"{u95:.2g} mm at {load:.0f} N" for u95, load in pairs)
        yield SourcedValue("discrepancy (95 %)", value, discrepancy.source, discrepancy.assumed)
    if (geometry_error := content.geometry_error) is not None:
        value = f"{geometry_error.u95_mm:.2g} mm{_angles_text(geometry_error)}"
        yield SourcedValue("error of the geometry (95 %)", value, geometry_error.source, geometry_error.assumed)
    if (load_range := content.measured) is not None:
        torques = ", ".join(f"{torque:.0f}" for torque in load_range.torque_Nm)
        value = f"{load_range.configurations} configurations, up to {torques} N·m on A1 … A6"
        yield SourcedValue("measured", value, load_range.source, load_range.assumed)


def _nominal_values(content: ModelFile, nominal: Chain) -> Iterator[SourcedValue]:
    """Yield the masses of the links, the geometry, and the speeds of the joints [°/s].

    :param nominal: chain with masses and speeds of robot.urdf; identified masses in the model file replace its masses.
    """
    stated_masses = dict(LinkMass.from_file(content))
    masses = ", ".join(
        f"{stated_masses.get(LinkMass(name), mass):.4g}" for name, mass in zip(JOINTS, nominal.mass, strict=True)
    )
    speeds = ", ".join(f"{speed:.4g}" for speed in nominal.speed * DEG_PER_RAD)
    for label, value, entry_source in (
        ("link masses", f"{masses} kg", content.masses),
        ("geometry, limits", "robot.urdf", content.geometry_nominal),
        ("joint speeds", f"{speeds} °/s", content.speeds or content.geometry_nominal),
    ):
        source = entry_source or SourcedEntry(source="not stated", assumed=True)
        yield SourcedValue(label, value, source.source, source.assumed)


def _basis(spring: JointSpring) -> Basis:
    """Return the origin of a joint's compliance that was not identified."""
    if spring.scaled_from:
        return "scaled"
    return "assumed" if spring.assumed else "published"


def _sigma_text(percent: float | None) -> str:
    """Return a relative standard deviation [%] in brackets with a leading space; empty for None."""
    return "" if percent is None else f" (σ {percent:g} %)"
