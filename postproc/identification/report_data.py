"""`identification.json`: what was identified, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from postproc.frames import DEG_PER_RAD, MM_PER_M, Array
from postproc.identification import trust
from postproc.identification.choice import summary
from postproc.identification.fit import NORMAL_95, to_file_units
from postproc.identification.placement import describe, describe_points
from postproc.identification.procedure import Identification, before_and_after
from postproc.robot import COMPENSATOR, JOINT_COMPLIANCES, Parameter
from postproc.robot.parameter import PER_URAD


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
        "verdict": {"refused": bool(result.distrust), "line": trust.line(result.distrust)},
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
        "discrepancy": [
            {"load_N": load, "held_out_mm": held, "noise_mm": noise, "own_mm": own, "u95_mm": u95}
            for load, held, noise, own, u95 in zip(
                result.discrepancy.load.tolist(),
                *(
                    (values * MM_PER_M).tolist()
                    for values in (
                        result.discrepancy.held_out,
                        result.discrepancy.noise,
                        result.discrepancy.own,
                        result.discrepancy.u95,
                    )
                ),
                strict=True,
            )
        ],
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
            entry = dict(zip(("value", "ci95"), found, strict=True)) | {"determined": bool(found[1] <= found[0])}
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
