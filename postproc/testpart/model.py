"""The model that a test part gives: `model.toml`, `identification.json`, `material.toml`, and what changed."""

from __future__ import annotations

from typing import Any, Literal

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc.files import FileEntry
from postproc.frames import MM_PER_M, Array
from postproc.identification.record import Parameter, Unexplained, Verdict
from postproc.machining import Process
from postproc.machining.material import CuttingLaw, IdentifiedTable
from postproc.robot import JointCompliance, file_slopes
from postproc.robot.model_file import (
    CovarianceTable,
    DiscrepancyEntry,
    MeasuredEntry,
    ModelFile,
)
from postproc.testpart.fit import Fit, Prior

NORMAL_95 = 1.96
_DRIFTED = 3.0
"""Difference between a parameter by the part alone and that of the model, in standard deviations, that is a drift."""
_MISFIT = 0.25
"""Unmodelled error, as a share of the deflection, beyond which the model should not be used."""
_FAR = 4.0
"""Distance of a parameter from its prior, in prior standard deviations, that is not plausible."""
_SURPRISE = 3.29
"""Standard deviations of χ² beyond which the readings do not agree with a model."""


class ProbedPoint(Struct, frozen=True):
    """A probed point: deviation as measured and as predicted, in mm, with the position of the part found."""

    feature: str
    measured_mm: float
    before_mm: float
    after_mm: float
    error_mm: float
    sigma_mm: float


class Change(Struct, frozen=True):
    """Difference of a parameter by the part from that of the model: in %, and in standard deviations."""

    name: str
    percent: float
    sigmas: float


class Agreement(Struct, frozen=True):
    """How the model before agrees with the part: χ² of the readings, and the parameters that have changed."""

    holds: bool
    line: str
    chi2: float
    points: int
    drifted: list[Change]


class PartIdentification(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Content of `identification.json` of a model from a test part.

    `force_scale`: measured forces over those computed. `agreement`: of the model before, where it is compared.
    `left_mm`: RMS of what the model leaves of the deviations; `without_mm`: of what the model before leaves;
    `deviation_mm`: of the deviations themselves.
    """

    verdict: Verdict
    method: Literal["part"] = "part"
    robot: str
    parameters: dict[str, Parameter]
    force_scale: Parameter
    sigma_mm: float
    left_mm: float
    without_mm: float
    deviation_mm: float
    unmodelled_percent: float
    discrepancy: list[Unexplained]
    agreement: Agreement | None = None
    points: list[ProbedPoint]
    held_by_prior: list[str]
    outliers: list[str]
    warnings: list[str]
    files: list[FileEntry] | None = None

    def as_json(self) -> bytes:
        """Return the content of the file."""
        return msgspec.json.format(msgspec.json.encode(self), indent=2)


def in_files(found: Fit) -> tuple[Array, Array]:
    """Return the values of the parameters in units of files (p,), and their covariance (p, p)."""
    prior, robot = found.prior, found.robot
    given = {parameter: robot.value(parameter) for parameter in prior.order}
    values = np.array([parameter.in_file(given)[0] for parameter in prior.parameters])
    rows = [prior.order.index(parameter) for parameter in prior.parameters]
    slopes = (file_slopes(prior.order, given) @ prior.by_file)[rows]
    size = len(values)
    return values, slopes @ found.covariance[:size, :size] @ slopes.T


def agreement(found: Fit, prior: Prior) -> Agreement:
    """Compare a model with a part.

    :param found: fit of `prior.widened()`: what the part says by itself.
    :param prior: the model with its own covariance.
    """
    count, chi2 = len(found.readings.probed), found.surprise(prior)
    given = {parameter: prior.robot.value(parameter) for parameter in prior.order}
    changed = np.sqrt(np.diag(prior.covariance) + np.diag(found.covariance)[:-1])
    drifted = [
        Change(
            parameter.name,
            round(100.0 * float(found.z[k]) / parameter.in_file(given)[0], 1),
            round(float(found.z[k] / changed[k]), 1),
        )
        for k, parameter in enumerate(prior.parameters)
        if found.free[k] and abs(found.z[k]) > _DRIFTED * changed[k]
    ]
    most = count + _SURPRISE * float(np.sqrt(2.0 * count)) + 7.0
    line = f"χ² {chi2:.0f} of {count} points (at most {most:.0f})"
    if drifted:
        line += "; changed: " + ", ".join(f"{each.name} {each.percent:+.0f} %" for each in drifted)
    return Agreement(chi2 <= most and not drifted, line, round(chi2, 2), count, drifted)


def summary(found: Fit, left_out: tuple[str, ...]) -> PartIdentification:
    """Return the result as plain data, with the verdict."""
    readings, prior = found.readings, found.prior
    values, covariance = in_files(found)
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    parameters, held = {}, []
    given = {parameter: prior.robot.value(parameter) for parameter in prior.order}
    for k, parameter in enumerate(prior.parameters):
        open_ = not found.free[k]
        before = parameter.in_file(given)[0]
        if open_:
            held.append(parameter.name)
        parameters[parameter.name] = Parameter(
            float(before if open_ else values[k]),
            float(half[k]),
            parameter.unit,
            observable=not open_,
            prior=float(before),
            source="prior" if open_ else None,
        )
    scale = Parameter(
        float(found.scale), float(NORMAL_95 * np.sqrt(found.covariance[-1, -1])), "1",
        observable=bool(found.sigma[-1] < 0.9), prior=1.0,
    )  # fmt: skip
    load, u95 = found.u95()
    measured = readings.probed.deviation
    points = [
        ProbedPoint(name, *(round(float(value) * MM_PER_M, 5) for value in row))
        for name, *row in zip(
            readings.probed.name, measured, found.before, found.after, found.error, found.spread, strict=True
        )
    ]
    return PartIdentification(
        verdict=_verdict(found, left_out),
        robot=prior.robot.name,
        parameters=parameters,
        force_scale=scale,
        sigma_mm=readings.sigma * MM_PER_M,
        left_mm=_rms(found.after - measured),
        without_mm=_rms(found.before - measured),
        deviation_mm=_rms(measured),
        unmodelled_percent=round(100.0 * found.gamma, 2),
        discrepancy=[
            Unexplained(
                float(level), _rms(found.error), readings.sigma * MM_PER_M, _rms(found.spread), float(each) * MM_PER_M
            )
            for level, each in zip(load, u95, strict=True)
        ],
        points=points,
        held_by_prior=held,
        outliers=list(left_out),
        warnings=_remarks(found, held, left_out),
    )


def _rms(values: Array) -> float:
    return round(float(np.sqrt(np.mean(np.square(values)))) * MM_PER_M, 5)


def _verdict(found: Fit, left_out: tuple[str, ...]) -> Verdict:
    size = len(found.prior.parameters)
    sigma = np.sqrt(np.diag(found.prior.covariance))
    far = np.abs(found.z) / np.where(sigma > 0.0, sigma, np.inf)
    reason = ""
    if found.gamma > _MISFIT:
        reason = f"{100 * found.gamma:.0f} % of the deflection are not described by the model: check part and program"
    elif far.max() > _FAR:
        name = found.prior.parameters[int(np.argmax(far))].name
        reason = f"{name} would be {far.max():.1f} standard deviations from its prior: check material and process"
    elif abs(found.scale - 1.0) > _FAR * found.prior.sigma_scale > 0.0:
        reason = f"forces would be {found.scale:.2f} times those computed: check material, feed and depth"
    elif found.free[:size].sum() == 0:
        reason = "the part determines no parameter of the robot"
    if reason:
        return Verdict(True, f"NOT TO BE TRUSTED: {reason}")
    return Verdict(False, "the model may be used, within its bound")


def _remarks(found: Fit, held: list[str], left_out: tuple[str, ...]) -> list[str]:
    out = []
    if held:
        out.append(f"the part does not determine {', '.join(held)}: they keep their prior")
    out += [f"outlier: {name}" for name in left_out]
    own = found.covariance
    sigma = np.sqrt(np.diag(own))
    size = len(found.prior.parameters)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.nan_to_num(own[-1, :size] / (sigma[-1] * sigma[:size]))
    tied = [found.prior.parameters[k].name for k in range(size) if found.free[k] and correlation[k] < -0.6]
    if tied:
        out.append(
            f"{', '.join(tied)} and the scale of the forces are known by their product only (scale ± "
            f"{100 * NORMAL_95 * sigma[-1]:.0f} %): use material.toml together with this model"
        )
    return out


def model_file(found: Fit, prior: ModelFile, source: str) -> ModelFile:
    """Return `model.toml`: identified values with intervals, the prior's where the part determines none."""
    values, covariance = in_files(found)
    half = NORMAL_95 * np.sqrt(np.diag(covariance))
    content = msgspec.to_builtins(prior)
    tables: dict[str, Any] = {"joints": {}, "links": {}, "compensator": {}, "masses": {}}
    stated = []
    for k, parameter in enumerate(found.prior.parameters):
        own_spread = parameter in found.prior.robot.stated_spread
        if not found.free[k] and own_spread:
            continue  # value and spread stay as they are in the file
        stated.append(k)
        if found.free[k]:
            parameter.write(tables, float(values[k]), float(half[k]), source)
    for table, entries in tables.items():
        if not entries:
            continue
        if table in ("compensator", "masses"):
            before = content.get(table) or {"source": source}
            content[table] = before | entries
        else:
            for name, entry in entries.items():
                content[table][name] = content[table].get(name, {}) | entry
    for k in stated:
        parameter = found.prior.parameters[k]
        if found.free[k] and isinstance(parameter, JointCompliance):
            content["joints"][parameter.joint] |= {"sigma_percent": None, "assumed": False}
    load, u95 = found.u95()
    extra = {
        "covariance": CovarianceTable(
            [found.prior.parameters[k].name for k in stated], covariance[np.ix_(stated, stated)].tolist()
        ),
        "discrepancy": DiscrepancyEntry(source=source, load_N=load.tolist(), u95_mm=(u95 * MM_PER_M).tolist()),
        "measured": MeasuredEntry(
            source=source,
            configurations=len(set(found.readings.probed.group.tolist())),
            torque_Nm=tuple(found.torque.tolist()),
            not_trusted="",
        ),
    }
    return msgspec.structs.replace(msgspec.convert(content, ModelFile), **extra)


def material(found: Fit, process: Process, source: str) -> bytes:
    """Return `material.toml`: the cutting law of the process with the scale of the forces found."""
    law: CuttingLaw = process.law()
    chip, radial, axial, *edge = (found.scale * value for value in (*law.cutting, *law.edge))
    table = IdentifiedTable(
        sigma_percent=round(100.0 * float(np.sqrt(found.covariance[-1, -1])) / found.scale, 3),
        source=f"{law.name}, forces scaled by {found.scale:.3f}: {source}",
        Kte_N_per_mm=edge[0] / 1e3,
        Kre_N_per_mm=edge[1] / 1e3,
        Kae_N_per_mm=edge[2] / 1e3,
    )
    if law.exponent:
        table = replace(
            table,
            kc11_N_per_mm2=chip / 1e6,
            mc=law.exponent,
            radial_ratio=law.cutting[1] / law.cutting[0],
            axial_ratio=law.cutting[2] / law.cutting[0],
        )
    else:
        table = replace(table, Ktc_N_per_mm2=chip / 1e6, Krc_N_per_mm2=radial / 1e6, Kac_N_per_mm2=axial / 1e6)
    comment = "Written by `postproc identify part`; process.toml takes it by [material] file."
    return files.toml({"material": table}, comment)
