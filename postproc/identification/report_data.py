"""The results of an identification for `identification.json`."""

from __future__ import annotations

import numpy as np

from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, norm
from postproc.identification import coverage, record, trust
from postproc.identification.discrepancy import Discrepancy
from postproc.identification.enhanced import Levels, SpringOfJoint2
from postproc.identification.fit import NORMAL_95, to_file_units
from postproc.identification.measurements import Measurements
from postproc.identification.observability import joint_torques
from postproc.identification.placement import describe, describe_points
from postproc.identification.procedure import Identification, before_and_after
from postproc.robot import COMPENSATOR, JOINT_COMPLIANCES, PER_URAD, Parameter


def report_data(result: Identification) -> record.Identified:
    """Return the content of `identification.json`."""
    known, values, covariance = to_file_units(result.fit)
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    pairs = zip(known, values.tolist(), half.tolist(), strict=True)
    entries = _entries_of(result, {p: (value, reach) for p, value, reach in pairs if value > 0.0 or not p.sparse})
    return record.Identified(
        verdict=record.Verdict(bool(result.distrust), trust.line(result.distrust)),
        method=result.method,
        robot=result.prior.name,
        parameters=entries,
        k2_levels=_levels(result.levels),
        k2_curve=_k2_curve(result),
        from_levels=_from_levels(result.spring),
        residual=_residual(result),
        discrepancy=_unexplained(result.discrepancy),
        workspace=[
            record.InWorkspace(level.load, level.deflection * MM_PER_M, level.bound * MM_PER_M, level.worst)
            for level in result.workspace.levels
        ],
        workspace_line=result.workspace.line,
        structure=None
        if result.choice is None
        else record.Structure(result.choice.reason, [candidate.recorded for candidate in result.choice.candidates]),
        sigma_mm=result.data.sigma * MM_PER_M,
        base=describe(result.placement),
        points=describe_points(result.placement, result.data.points),
        unloaded_rms_mm=result.placement.rms * MM_PER_M,
        not_observable=[record.Missing(entry.name, entry.reason, entry.advice) for entry in result.missing],
        held_by_prior=None if result.choice is None else [parameter.name for parameter in result.choice.held_by_prior],
        outliers=list(result.left_out),
        warnings=list(result.warnings),
        correlation=record.Correlation([parameter.name for parameter in known], _correlation(covariance)),
        states=_states(result.data),
        torque_Nm=np.abs(joint_torques(result.prior, result.data)).max(axis=0).tolist(),
        torques=coverage.as_record(coverage.of_readings(result.prior, result.data)),
    )


def _levels(levels: Levels | None) -> list[record.Level]:
    if levels is None:
        return []
    deviation = np.sqrt(np.diag(levels.covariance))
    return [
        record.Level(
            float(q * DEG_PER_RAD), float(k * PER_URAD), float(NORMAL_95 * d * PER_URAD) if np.isfinite(d) else None
        )
        for q, k, d in zip(levels.q2, levels.compliance, deviation, strict=True)
    ]


def _from_levels(spring: SpringOfJoint2 | None) -> dict[str, record.FromLevels] | None:
    if spring is None:
        return None
    half = (NORMAL_95 * np.sqrt(np.diag(spring.covariance))).tolist()
    return {
        name: record.FromLevels(value, reach)
        for name, value, reach in zip(("K_theta2_0", "K_c", "K_c*s_0"), spring.values.tolist(), half, strict=True)
    }


def _residual(result: Identification) -> record.Residual:
    before, after = before_and_after(result)
    return record.Residual(
        rms_mm=result.fit.rms * MM_PER_M,
        max_mm=float(norm(result.fit.residual).max()) * MM_PER_M,
        before_rms_mm=float(np.sqrt(np.mean(before**2))) * MM_PER_M,
        chi2=result.fit.chi2,
        degrees_of_freedom=result.fit.dof,
        per_configuration=[
            record.OfConfiguration(float(c), float(b) * MM_PER_M, float(a) * MM_PER_M)
            for c, b, a in zip(result.data.config, before, after, strict=True)
        ],
    )


def _unexplained(off: Discrepancy) -> list[record.Unexplained]:
    lengths = np.stack([off.held_out, off.noise, off.own, off.u95], axis=1) * MM_PER_M
    return [record.Unexplained(load, *row) for load, row in zip(off.load.tolist(), lengths.tolist(), strict=True)]


def _states(data: Measurements) -> list[record.State]:
    angles = (data.q[data.state_config[data.loaded]] * DEG_PER_RAD).round(6).tolist()
    return [
        record.State(tuple(q), tuple(load)) for q, load in zip(angles, data.wrench[data.loaded].tolist(), strict=True)
    ]


def _entries_of(result: Identification, given: dict[Parameter, tuple[float, float]]) -> dict[str, record.Parameter]:
    """Return the parameters as `identification.json` holds them: k1…k6, K⁰_θ2, K_c, s₀ always, the others if found."""
    prior, unknown = result.prior, {entry.parameter for entry in result.missing}
    springs = COMPENSATOR if prior.compensator is not None else ()
    of_prior: dict[Parameter, float] = {p: prior.value(p) for p in (*JOINT_COMPLIANCES, *springs)} | dict(prior.terms)
    about = {p: prior.value(p) for p in given if np.isfinite(prior.prior_sigma(p))}
    always = (*JOINT_COMPLIANCES, *(springs if result.fit.structure.prior.compensator is not None else ()))
    entries: dict[str, record.Parameter] = {}

    def put(
        name: str, found: tuple[float, float] | None, unit: str, before: float | None, source: str | None = None
    ) -> None:
        if found is None:
            entries[name] = record.Parameter(before, None, unit, observable=False, prior=before, source="prior")
        else:
            determined = bool(found[1] <= found[0])
            entries[name] = record.Parameter(*found, unit, True, determined, before, source)

    for parameter in dict.fromkeys((*always, *given)):
        found = None if parameter in unknown else given.get(parameter)
        before = parameter.in_file(of_prior | about)[0] if parameter in always or parameter in about else None
        put(parameter.name, found, parameter.unit, before, record.ABOUT_THE_PRIOR if parameter in about else None)
        if parameter == JOINT_COMPLIANCES[-1]:
            k2 = entries[JOINT_COMPLIANCES[1].name]
            if k2.value is not None and k2.prior is not None:
                reach = None if k2.ci95 is None else (PER_URAD / k2.value, PER_URAD * k2.ci95 / k2.value**2)
                put("K_theta2_0", reach, "N·m/rad", PER_URAD / k2.prior)
    return entries


def _k2_curve(result: Identification) -> list[tuple[float, float]]:
    """Return equivalent compliance of joint 2 of the model over q2: [deg, µrad/(N·m)]."""
    if result.levels is None:
        return []
    model = result.robot()
    q2 = np.linspace(result.levels.q2.min(), result.levels.q2.max(), 41)
    stiffness = 1.0 / model.compliance[model.actuated[1]]
    added = np.zeros_like(q2) if model.compensator is None else model.compensator.stiffness_about_joint(q2)
    return [(float(a), float(c)) for a, c in zip(q2 * DEG_PER_RAD, PER_URAD / (stiffness + added), strict=True)]


def _correlation(covariance: Array) -> list[list[float]]:
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(deviation > 0.0, deviation, 1.0)
    return [[round(float(v), 4) for v in row] for row in covariance / np.outer(safe, safe)]
