"""Writing the identified robot: a model folder with robot.urdf, model.toml and identification.json."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from postproc import files
from postproc.errors import InputError, MeasurementError, ModelError
from postproc.frames import MM_PER_M
from postproc.identification import record
from postproc.identification.experiment import Payload
from postproc.identification.fit import NORMAL_95, to_file_units
from postproc.identification.observability import joint_torques
from postproc.identification.procedure import Identification
from postproc.identification.structure import LEAST
from postproc.robot import JOINT_COMPLIANCES, WITH_LINKS, JointCompliance, urdf
from postproc.robot.model_file import (
    CompensatorEntry,
    CovarianceTable,
    DiscrepancyEntry,
    Gravity,
    JointSpring,
    LinkSprings,
    Masses,
    MeasuredEntry,
    ModelFile,
    PayloadEntry,
)

_COMMENT = f"Written by `postproc identify`. Units are in the names; every entry names its source. {WITH_LINKS}."


def model_file(result: Identification, prior: ModelFile, source: str, geometry_source: str | None) -> ModelFile:
    """Return the content of `model.toml`: identified values with intervals, the prior's where none was identified."""
    parameters, values, covariance = to_file_units(result.fit)
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    unknown = {entry.parameter for entry in result.missing}
    tables: dict[str, Any] = {"joints": {}, "links": {}, "compensator": {}, "masses": {}}
    for parameter, value, reach in zip(parameters, values.tolist(), half.tolist(), strict=True):
        if value > 0.0 or not parameter.sparse:  # a part of a gear that is zero is in [covariance] alone
            parameter.write(tables, value, reach, source)
    joints = {}
    for joint in JOINT_COMPLIANCES:
        table = tables["joints"].get(joint.joint)
        if table is not None and joint not in unknown and table["compliance_urad_per_Nm"] >= 0.0:
            # where link springs deflect in its place, the prior's value would count twice
            table["compliance_urad_per_Nm"] = max(table["compliance_urad_per_Nm"], LEAST * joint.per_si)
            joints[joint.joint] = msgspec.convert(table, JointSpring)
        else:
            old = prior.joints[joint.joint]
            joints[joint.joint] = JointSpring(
                source=f"prior, not observable in {source}: {old.source}",
                assumed=True,
                compliance_urad_per_Nm=old.compliance_urad_per_Nm,
                sigma_percent=old.sigma_percent,
            )
    # a joint that keeps the prior's value keeps its sigma_percent too; without one its variance is in the table
    kept = [
        index
        for index, parameter in enumerate(parameters)
        if not (isinstance(parameter, JointCompliance) and joints[parameter.joint].sigma_percent is not None)
    ]
    return ModelFile(
        name=prior.name,
        date=prior.date,
        language=prior.language,
        joints=joints,
        gravity=Gravity(reference=prior.gravity.reference, in_gears=result.fit.structure.in_gears),
        compensator=_compensator(result, prior, tables["compensator"], source, geometry_source),
        payload=prior.payload,
        geometry=prior.geometry,
        transmission=prior.transmission,
        geometry_error=prior.geometry_error,
        links=msgspec.convert(tables["links"], dict[str, LinkSprings]),
        covariance=CovarianceTable([parameters[i].name for i in kept], covariance[np.ix_(kept, kept)].tolist()),
        discrepancy=DiscrepancyEntry(
            source=source, load_N=result.discrepancy.load.tolist(), u95_mm=(result.discrepancy.u95 * MM_PER_M).tolist()
        ),
        measured=MeasuredEntry(
            source=source,
            configurations=len(result.data.q),
            torque_Nm=tuple(np.abs(joint_torques(result.prior, result.data)).max(axis=0).tolist()),
            not_trusted=result.distrust,
        ),
        masses=_masses(prior.masses, tables["masses"], source),
        geometry_nominal=prior.geometry_nominal,
        speeds=prior.speeds,
    )


def _compensator(
    result: Identification, prior: ModelFile, identified: dict[str, Any], source: str, geometry_source: str | None
) -> CompensatorEntry | None:
    law = result.fit.structure.prior.compensator
    old = prior.compensator
    if law is None or (old is None and not identified):
        return None
    spring: dict[str, Any] = {
        "stiffness_N_per_m": max(law.stiffness, 0.0),
        "free_length_mm": max(law.free_length * MM_PER_M, 0.0),
        "source": f"prior, not observable in {source}: {'' if old is None else old.source}",
        "assumed": True,
    } | identified
    return CompensatorEntry(
        L_mm=law.L * MM_PER_M,
        a_x_mm=law.ax * MM_PER_M,
        a_y_mm=law.ay * MM_PER_M,
        sigma_percent=None if old is None or identified else old.sigma_percent,
        spread_percent=CompensatorEntry.spread_percent if old is None else old.spread_percent,
        geometry_source=geometry_source or ("" if old is None else old.geometry_source),
        **spring,
    )


def _masses(prior: Masses | None, identified: dict[str, float], source: str) -> Masses | None:
    if not identified:
        return prior
    before = Masses(source="robot.urdf", assumed=True) if prior is None else prior
    return msgspec.structs.replace(before, source=f"{source}, about {before.source}", **identified)


def write(
    folder: Path,
    content: ModelFile,
    data: record.Identified,
    prior_folder: Path,
    render: Callable[[record.Identified, str], bytes] | None = None,
) -> list[Path]:
    """Write the model folder, whole or not at all.

    :param content: of `model.toml`.
    :param data: of `identification.json`; its ``files``, the files written with it, are added.
    :param prior_folder: where robot.urdf is, and the meshes that it names.
    :param render: makes `report.html` from `data` and the name of the model.
    :raises InputError: the folder cannot be written, or is the prior's.
    :raises MeasurementError: a number is not finite; the message names it.
    """
    for name, part in (("model.toml", content), (record.NAME, data)):
        require_finite(msgspec.to_builtins(part), name)
    if folder.resolve() == prior_folder.resolve():
        raise InputError("would overwrite the prior model", file=str(folder), advice="Give another folder with -o.")
    contents: dict[str, bytes | Iterable[bytes]] = {
        "model.toml": files.toml(content, _COMMENT),
        "robot.urdf": (prior_folder / "robot.urdf").read_bytes(),
    }
    text = (prior_folder / "robot.urdf").read_text(encoding="utf-8")
    for geometry in urdf.geometries(text, "robot.urdf"):
        path = prior_folder / geometry.file
        if geometry.file == path.name and path.is_file():
            contents[path.name] = path.read_bytes()
    if render is not None:
        contents["report.html"] = render(data, folder.resolve().name)

    def rendered(entries: list[files.FileEntry]) -> bytes:
        return msgspec.structs.replace(data, files=entries).as_json()

    return files.write_whole(folder, files.with_record(contents, record.NAME, rendered))


def require_finite(content: Any, name: str) -> None:
    """Refuse content in which a number is not finite.

    :param name: of the content, for the message.
    :raises MeasurementError: names the first such number.
    """
    if isinstance(content, float) and not np.isfinite(content):
        raise MeasurementError(
            f"{name} would be {content}: the identification failed",
            file="",
            advice="Check loads, joint angles and readings; measure more configurations that load this joint.",
        )
    if isinstance(content, dict):
        for key, value in content.items():
            require_finite(value, f"{name}: {key}" if ":" not in name else f"{name}.{key}")
    elif isinstance(content, list | tuple):
        for index, value in enumerate(content):
            require_finite(value, f"{name}[{index}]")


def protect(folder: Path) -> None:
    """Refuse a folder that holds a model which was not identified, or was changed since.

    :raises InputError: it does.
    """
    files.refuse(files.foreign(folder, ("model.toml", "robot.urdf", "report.html", record.NAME), record.NAME))


def read_prior(folder: Path, payload: Payload | None, source: str) -> ModelFile:
    """Return the content of the prior's `model.toml`, the flange carrying what the experiment says.

    :param source: the file that says so.
    """
    content = files.read_toml(folder / "model.toml", ModelFile, ModelError)
    carried = None
    if payload is not None:
        carried = PayloadEntry(
            source=f"stated in {source}", mass_kg=payload.mass_kg, X_mm=payload.X, Y_mm=payload.Y, Z_mm=payload.Z
        )
    return msgspec.structs.replace(content, payload=carried)


def without_found_springs(content: ModelFile) -> ModelFile:
    """Return a model with joint springs alone: those of links, and what fades of the gears, are looked for anew."""
    joints = {
        name: msgspec.structs.replace(spring, stiffening=[], knees=[], backlash=None, lost_motion=None)
        for name, spring in content.joints.items()
    }
    return msgspec.structs.replace(content, joints=joints, links={}, covariance=None, discrepancy=None, measured=None)
