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
from postproc.identification.elastic import JOINT_NAMES, PRELOAD, STIFFNESS
from postproc.identification.fit import Fit
from postproc.identification.identify import Identification, before_and_after
from postproc.identification.placement import describe, describe_points
from postproc.identification.structure import summary
from postproc.robot.model_file import (
    JOINTS,
    CompensatorEntry,
    Covariance,
    Gravity,
    JointSpring,
    LinkSprings,
    ModelFile,
    Stiffening,
)

_URAD = 1e6
_Z95 = 1.959964


def to_file_units(fit: Fit) -> tuple[list[str], Array, Array]:
    """Return names, values and covariance of the parameters as `model.toml` holds them.

    k1…k6 [µrad/(N·m)] are compliances at small torque, fading parts included; parts ``k1@800`` and springs of links
    [µrad/(N·m), µm/N] only where they are not zero; K_c [N/m] and s_0 [mm].
    """
    names = fit.structure.names
    kept: list[str] = []
    rows: list[Array] = []
    for index, name in enumerate(names):
        row = np.zeros(len(names))
        if name in JOINT_NAMES:
            row[[other.partition("@")[0] == name for other in names]] = _URAD
        elif name == STIFFNESS:
            row[index] = 1.0
        elif name == PRELOAD:
            stiffness, preload = fit.value(STIFFNESS), fit.values[index]
            row[index] = MM_PER_M / stiffness if stiffness > 0.0 else 0.0
            row[names.index(STIFFNESS)] = -MM_PER_M * preload / stiffness**2 if stiffness > 0.0 else 0.0
        elif fit.values[index] <= 0.0:
            continue
        else:
            row[index] = _URAD
        kept.append("s_0" if name == PRELOAD else name)
        rows.append(row)
    matrix = np.array(rows).reshape(len(rows), len(names))
    values = matrix @ fit.values
    if PRELOAD in names:
        values[kept.index("s_0")] = MM_PER_M * fit.value(PRELOAD) / max(fit.value(STIFFNESS), 1e-300)
    covariance = matrix @ np.where(np.isfinite(fit.covariance), fit.covariance, 0.0) @ matrix.T
    return kept, values, 0.5 * (covariance + covariance.T)


def model_file(result: Identification, prior: ModelFile, source: str, geometry_source: str | None) -> ModelFile:
    """Return the content of `model.toml`: identified values with intervals, the prior's where none was identified."""
    names, values, covariance = to_file_units(result.fit)
    half = _Z95 * np.sqrt(np.diag(covariance))
    given = dict(zip(names, zip(values, half, strict=True), strict=True))
    unknown = {entry.name for entry in result.missing}
    joints = {}
    for joint, name in zip(JOINTS, JOINT_NAMES, strict=True):
        parts = [
            Stiffening(torque_Nm=float(n.partition("@")[2]), compliance_urad_per_Nm=float(v))
            for n, (v, _) in given.items()
            if n.startswith(f"{name}@") and v > 0.0
        ]
        if name in given and name not in unknown and given[name][0] > 0.0:
            value, ci = given[name]
            joints[joint] = JointSpring(
                source=source, compliance_urad_per_Nm=float(value), ci95=float(ci), stiffening=parts
            )
        else:
            old = prior.joints[joint]
            joints[joint] = JointSpring(
                source=f"prior, not observable in {source}: {old.source}",
                assumed=True,
                compliance_urad_per_Nm=old.compliance_urad_per_Nm,
            )
    links: dict[str, LinkSprings] = {}
    for joint in ("base", *JOINTS):
        found: dict[str, Any] = {}
        for name in names:
            if name.startswith(f"{joint}."):
                axis = name.partition(".")[2]
                unit = "um_per_N" if axis in "XYZ" else "urad_per_Nm"
                found[f"{axis}_{unit}"] = float(given[name][0])
        if found:
            links[joint] = LinkSprings(source=source, **found)
    kept = [i for i, name in enumerate(names) if name not in unknown]
    return ModelFile(
        name=prior.name,
        date=prior.date,
        joints=joints,
        gravity=Gravity(reference=prior.gravity.reference, in_gears=result.fit.structure.in_gears),
        compensator=_compensator(result, prior, given, source, geometry_source),
        geometry=prior.geometry,
        links=links,
        covariance=Covariance(
            [names[i] for i in kept], [[float(v) for v in row] for row in covariance[np.ix_(kept, kept)]]
        ),
        masses=prior.masses,
        geometry_nominal=prior.geometry_nominal,
    )


def _compensator(
    result: Identification,
    prior: ModelFile,
    given: dict[str, tuple[Any, Any]],
    source: str,
    geometry_source: str | None,
) -> CompensatorEntry | None:
    law = result.fit.structure.prior.compensator
    identified = STIFFNESS in given
    if law is None or (prior.compensator is None and not identified):
        return None
    old, old_geometry = ("", "") if prior.compensator is None else (
        prior.compensator.source, prior.compensator.geometry_source
    )  # fmt: skip
    stiffness, free = (
        (given[STIFFNESS][0], given["s_0"][0]) if identified else (law.stiffness, law.free_length * MM_PER_M)
    )
    return CompensatorEntry(
        L_mm=law.L * MM_PER_M,
        a_x_mm=law.ax * MM_PER_M,
        a_y_mm=law.ay * MM_PER_M,
        geometry_source=geometry_source or old_geometry,
        stiffness_N_per_m=float(max(stiffness, 0.0)),
        free_length_mm=float(max(free, 0.0)),
        source=source if identified else f"prior, not observable in {source}: {old}",
        assumed=not identified,
    )


def report_data(result: Identification) -> dict[str, Any]:
    """Return the content of `identification.json`."""
    names, values, covariance = to_file_units(result.fit)
    half = _Z95 * np.sqrt(np.diag(covariance))
    unknown = {entry.name: str(entry) for entry in result.missing}
    given = dict(zip(names, zip(values, half, strict=True), strict=True))
    parameters: dict[str, Any] = {}

    priors = {name: float(c * _URAD) for name, c in zip(JOINT_NAMES, result.prior.compliance, strict=True)}
    if (old := result.prior.compensator) is not None:
        priors |= {"K_c": old.stiffness, "s_0": old.free_length * MM_PER_M}
    priors["K_theta2_0"] = _URAD / priors["k2"]

    def put(name: str, value: float | None, ci: float | None, unit: str, observable: bool) -> None:
        entry: dict[str, Any] = {"value": value, "ci95": ci, "unit": unit, "observable": observable}
        if name in priors:
            entry["prior"] = priors[name]
        if not observable:
            entry["source"] = "prior"
        parameters[name] = entry

    for index, name in enumerate(JOINT_NAMES):
        if name in given and name not in unknown:
            put(name, float(given[name][0]), float(given[name][1]), "urad/(N·m)", observable=True)
        else:
            put(name, float(result.prior.compliance[index] * _URAD), None, "urad/(N·m)", observable=False)
    k2 = parameters["k2"]
    stiffness = _URAD / k2["value"]
    ci = None if k2["ci95"] is None else _URAD * k2["ci95"] / k2["value"] ** 2
    put("K_theta2_0", stiffness, ci, "N·m/rad", observable=bool(k2["observable"]))
    law = result.fit.structure.prior.compensator
    if STIFFNESS in given:
        put("K_c", float(given["K_c"][0]), float(given["K_c"][1]), "N/m", observable=True)
        put("s_0", float(given["s_0"][0]), float(given["s_0"][1]), "mm", observable=True)
    elif law is not None:
        put("K_c", law.stiffness, None, "N/m", observable=False)
        put("s_0", law.free_length * MM_PER_M, None, "mm", observable=False)
    for name, (value, ci_here) in given.items():
        if name not in parameters:
            unit = "um/N" if name.endswith((".X", ".Y", ".Z")) else "urad/(N·m)"
            put(name, float(value), float(ci_here), unit, observable=True)
    before, after = before_and_after(result)
    residual = np.linalg.norm(result.fit.residual, axis=2)
    levels = []
    if result.levels is not None:
        deviation = np.sqrt(np.diag(result.levels.covariance))
        levels = [
            {
                "q2_deg": float(q * DEG_PER_RAD),
                "value": float(k * _URAD),
                "ci95": float(_Z95 * d * _URAD) if np.isfinite(d) else None,
            }
            for q, k, d in zip(result.levels.q2, result.levels.compliance, deviation, strict=True)
        ]
    data: dict[str, Any] = {
        "method": result.method,
        "robot": result.prior.name,
        "parameters": parameters,
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
        "correlation": {"names": names, "matrix": _correlation(covariance)},
        "warnings": list(result.warnings),
    }
    if result.spring is not None:
        deviation = np.sqrt(np.diag(result.spring.covariance))
        data["from_levels"] = {
            name: {"value": float(v), "ci95": float(_Z95 * d)}
            for name, v, d in zip(("K_theta2_0", "K_c", "K_c*s_0"), result.spring.values, deviation, strict=True)
        }
    if result.choice is not None:
        data["structure"] = {"reason": result.choice.reason, "tried": summary(result.choice.candidates)}
    return data


def _k2_curve(result: Identification) -> list[list[float]]:
    """Return equivalent compliance of joint 2 of the model over q2: [deg, µrad/(N·m)]."""
    if result.levels is None:
        return []
    model = result.robot()
    q2 = np.linspace(result.levels.q2.min(), result.levels.q2.max(), 41)
    stiffness = 1.0 / model.compliance[model.actuated[1]]
    added = np.zeros_like(q2) if model.compensator is None else model.compensator.stiffness_about_joint(q2)
    return [[float(a), float(c)] for a, c in zip(q2 * DEG_PER_RAD, _URAD / (stiffness + added), strict=True)]


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
