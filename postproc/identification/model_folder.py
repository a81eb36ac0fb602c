"""Writing the identified robot: a model folder with robot.urdf, model.toml and identification.json."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from postproc import files
from postproc.errors import InputError, ModelError
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array
from postproc.identification.choice import summary
from postproc.identification.fit import NORMAL_95, Fit
from postproc.identification.identify import Identification, before_and_after
from postproc.identification.placement import describe, describe_points
from postproc.robot import COMPENSATOR, JOINT_COMPLIANCES, Parameter, file_slopes
from postproc.robot.model_file import (
    CompensatorEntry,
    CovarianceTable,
    Gravity,
    JointSpring,
    LinkSprings,
    ModelFile,
)
from postproc.robot.parameters import PER_URAD


def to_file_units(fit: Fit) -> tuple[tuple[Parameter, ...], Array, Array]:
    """Return parameters, values and covariance of a fit as `model.toml` holds them, in its units.

    k1…k6 are compliances at small torque, fading parts included; s₀ stands for K_c·s₀; of the parameters of which some
    are looked for only those that are not zero.
    """
    slopes = file_slopes(fit.structure.parameters, fit.given)
    covariance = slopes @ np.where(np.isfinite(fit.covariance), fit.covariance, 0.0) @ slopes.T
    kept = [index for index, (p, value) in enumerate(fit.given.items()) if value > 0.0 or not p.sparse]
    parameters = tuple(fit.structure.parameters[index] for index in kept)
    values = np.array([parameter.in_file(fit.given)[0] for parameter in parameters])
    covariance = covariance[np.ix_(kept, kept)]
    return parameters, values, 0.5 * (covariance + covariance.T)


def model_file(result: Identification, prior: ModelFile, source: str, geometry_source: str | None) -> ModelFile:
    """Return the content of `model.toml`: identified values with intervals, the prior's where none was identified."""
    parameters, values, covariance = to_file_units(result.fit)
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    unknown = {entry.parameter for entry in result.missing}
    tables: dict[str, Any] = {"joints": {}, "links": {}, "compensator": {}}
    for parameter, value, reach in zip(parameters, values.tolist(), half.tolist(), strict=True):
        parameter.write(tables, value, reach, source)
    joints = {}
    for joint in JOINT_COMPLIANCES:
        table = tables["joints"].get(joint.joint)
        if table is not None and joint not in unknown and table["compliance_urad_per_Nm"] > 0.0:
            joints[joint.joint] = msgspec.convert(table, JointSpring)
        else:
            old = prior.joints[joint.joint]
            joints[joint.joint] = JointSpring(
                source=f"prior, not observable in {source}: {old.source}",
                assumed=True,
                compliance_urad_per_Nm=old.compliance_urad_per_Nm,
            )
    kept = [index for index, parameter in enumerate(parameters) if parameter not in unknown]
    return ModelFile(
        name=prior.name,
        date=prior.date,
        joints=joints,
        gravity=Gravity(reference=prior.gravity.reference, in_gears=result.fit.structure.in_gears),
        compensator=_compensator(result, prior, tables["compensator"], source, geometry_source),
        geometry=prior.geometry,
        links=msgspec.convert(tables["links"], dict[str, LinkSprings]),
        covariance=CovarianceTable([parameters[i].name for i in kept], covariance[np.ix_(kept, kept)].tolist()),
        masses=prior.masses,
        geometry_nominal=prior.geometry_nominal,
    )


def _compensator(
    result: Identification, prior: ModelFile, identified: dict[str, Any], source: str, geometry_source: str | None
) -> CompensatorEntry | None:
    law = result.fit.structure.prior.compensator
    old = prior.compensator
    if law is None or (old is None and not identified):
        return None
    spring = identified or {
        "stiffness_N_per_m": max(law.stiffness, 0.0),
        "free_length_mm": max(law.free_length * MM_PER_M, 0.0),
        "source": f"prior, not observable in {source}: {'' if old is None else old.source}",
        "assumed": True,
    }
    return CompensatorEntry(
        L_mm=law.L * MM_PER_M,
        a_x_mm=law.ax * MM_PER_M,
        a_y_mm=law.ay * MM_PER_M,
        geometry_source=geometry_source or ("" if old is None else old.geometry_source),
        **spring,
    )


def report_data(result: Identification) -> dict[str, Any]:
    """Return the content of `identification.json`."""
    known, values, covariance = to_file_units(result.fit)
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    entries = _entries_of(result, dict(zip(known, zip(values.tolist(), half.tolist(), strict=True), strict=True)))
    before, after = before_and_after(result)
    residual = np.linalg.norm(result.fit.residual, axis=2)
    levels = []
    if result.levels is not None:
        deviation = np.sqrt(np.diag(result.levels.covariance))
        levels = [
            {
                "q2_deg": float(q * DEG_PER_RAD),
                "value": float(k * PER_URAD),
                "ci95": float(NORMAL_95 * d * PER_URAD) if np.isfinite(d) else None,
            }
            for q, k, d in zip(result.levels.q2, result.levels.compliance, deviation, strict=True)
        ]
    data: dict[str, Any] = {
        "method": result.method,
        "robot": result.prior.name,
        "parameters": entries,
        "k2_levels": levels,
        "k2_curve": _k2_curve(result),
        "residual": {
            "rms_mm": result.fit.rms * MM_PER_M,
            "max_mm": float(residual.max()) * MM_PER_M,
            "before_rms_mm": float(np.sqrt(np.mean(before**2))) * MM_PER_M,
            "chi2": result.fit.chi2,
            "degrees_of_freedom": result.fit.dof,
            "per_configuration": [
                {"config": float(c), "before_mm": float(b) * MM_PER_M, "after_mm": float(a) * MM_PER_M}
                for c, b, a in zip(result.data.config, before, after, strict=True)
            ],
        },
        "sigma_mm": result.data.sigma * MM_PER_M,
        "base": describe(result.placement),
        "points": describe_points(result.placement, result.data.points),
        "unloaded_rms_mm": result.placement.rms * MM_PER_M,
        "not_observable": [
            {"name": entry.name, "reason": entry.reason, "advice": entry.advice} for entry in result.missing
        ],
        "outliers": list(result.left_out),
        "correlation": {"names": [parameter.name for parameter in known], "matrix": _correlation(covariance)},
        "warnings": list(result.warnings),
    }
    if result.spring is not None:
        deviation = np.sqrt(np.diag(result.spring.covariance))
        data["from_levels"] = {
            name: {"value": float(v), "ci95": float(NORMAL_95 * d)}
            for name, v, d in zip(("K_theta2_0", "K_c", "K_c*s_0"), result.spring.values, deviation, strict=True)
        }
    if result.choice is not None:
        data["structure"] = {"reason": result.choice.reason, "tried": summary(result.choice.candidates)}
    return data


def _entries_of(result: Identification, given: dict[Parameter, tuple[float, float]]) -> dict[str, dict[str, Any]]:
    """Return the parameters as `identification.json` holds them: k1…k6, K⁰_θ2, K_c, s₀ always, the others if found."""
    prior, unknown = result.prior, {entry.parameter for entry in result.missing}
    springs = COMPENSATOR if prior.compensator is not None else ()
    of_prior: dict[Parameter, float] = {p: p.of(prior) for p in (*JOINT_COMPLIANCES, *springs)} | dict(prior.terms)
    always = (*JOINT_COMPLIANCES, *(springs if result.fit.structure.prior.compensator is not None else ()))
    entries: dict[str, dict[str, Any]] = {}

    def put(name: str, found: tuple[float, float] | None, value: float, unit: str, before: float | None) -> None:
        entry: dict[str, Any] = {"value": value, "ci95": None}
        if found is not None:
            entry = dict(zip(("value", "ci95"), found, strict=True))
        entry |= {"unit": unit, "observable": found is not None}
        if before is not None:
            entry["prior"] = before
        if found is None:
            entry["source"] = "prior"
        entries[name] = entry

    for parameter in dict.fromkeys((*always, *given)):
        found = None if parameter in unknown else given.get(parameter)
        before = parameter.in_file(of_prior)[0] if parameter in always else None
        put(parameter.name, found, np.nan if before is None else before, parameter.unit, before)
        if parameter == JOINT_COMPLIANCES[-1]:
            k2 = entries[JOINT_COMPLIANCES[1].name]
            stiffness, reach = PER_URAD / k2["value"], k2["ci95"]
            inverse = None if reach is None else (stiffness, PER_URAD * reach / k2["value"] ** 2)
            put("K_theta2_0", inverse, stiffness, "N·m/rad", PER_URAD / k2["prior"])
    return entries


def _k2_curve(result: Identification) -> list[list[float]]:
    """Return equivalent compliance of joint 2 of the model over q2: [deg, µrad/(N·m)]."""
    if result.levels is None:
        return []
    model = result.robot()
    q2 = np.linspace(result.levels.q2.min(), result.levels.q2.max(), 41)
    stiffness = 1.0 / model.compliance[model.actuated[1]]
    added = np.zeros_like(q2) if model.compensator is None else model.compensator.stiffness_about_joint(q2)
    return [[float(a), float(c)] for a, c in zip(q2 * DEG_PER_RAD, PER_URAD / (stiffness + added), strict=True)]


def _correlation(covariance: Array) -> list[list[float]]:
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(deviation > 0.0, deviation, 1.0)
    return [[round(float(v), 4) for v in row] for row in covariance / np.outer(safe, safe)]


def write(
    folder: Path,
    content: ModelFile,
    data: dict[str, Any],
    prior_folder: Path,
    render: Callable[[dict[str, Any]], bytes] | None = None,
) -> list[Path]:
    """Write the model folder, whole or not at all.

    :param content: of `model.toml`.
    :param data: of `identification.json`.
    :param prior_folder: where robot.urdf is.
    :param render: makes `report.html` from `data`.
    :raises InputError: the folder cannot be written, or is the prior's.
    """
    if folder.resolve() == prior_folder.resolve():
        raise InputError("would overwrite the prior model", file=str(folder), advice="Give another folder with -o.")
    files_of = {
        "robot.urdf": (prior_folder / "robot.urdf").read_bytes(),
        "model.toml": to_toml(content).encode(),
        "identification.json": json.dumps(data, indent=2, ensure_ascii=False).encode(),
    }
    if render is not None:
        files_of["report.html"] = render(data)
    return files.write_whole(folder, files_of)


def read_prior(folder: Path) -> ModelFile:
    """Return the content of the prior's `model.toml`."""
    return files.read_toml(folder / "model.toml", ModelFile, ModelError)


def to_toml(content: ModelFile) -> str:
    """Return `model.toml` as text; values that are defaults are left out."""
    plain: dict[str, Any] = msgspec.to_builtins(content)
    default: dict[str, Any] = msgspec.to_builtins(ModelFile(name="", joints={}))
    head = [f"{key} = {_value(plain[key])}" for key in ("name", "date") if plain[key]]
    lines = ["# Written by `postproc identify`. Units stand in the names; every entry names its source.", *head]
    for key, value in plain.items():
        if not isinstance(value, dict) or value == default.get(key):
            continue
        if key in ("joints", "links", "geometry"):
            for name, entry in value.items():
                lines += ["", f"[{key}.{name}]", *_entries(entry)]
        else:
            lines += ["", f"[{key}]", *_entries(value)]
    return "\n".join(lines) + "\n"


def _entries(table: dict[str, Any]) -> list[str]:
    zero = {0.0, None, ""}
    return [
        f"{name} = {_value(value)}"
        for name, value in table.items()
        if not (isinstance(value, (float, bool, str, type(None))) and value in zero and name != "stiffness_N_per_m"
                and name != "free_length_mm" and name != "a_y_mm" and name != "a_x_mm")
        and value != []
    ]  # fmt: skip


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, float):
        return repr(float(f"{value:.10g}"))
    if isinstance(value, list):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_value(entry)}" for name, entry in value.items()) + " }"
    return str(value)
