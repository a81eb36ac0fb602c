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
from postproc.identification.fit import NORMAL_95
from postproc.identification.record import Parameter, Record, Unexplained, Verdict
from postproc.machining import Process
from postproc.machining.material import CuttingLaw, IdentifiedTable
from postproc.machining.material import law as cutting_law
from postproc.robot import FORCES, Discrepancy, JointCompliance, file_slopes
from postproc.robot.model_file import (
    CovarianceTable,
    DiscrepancyEntry,
    ForcesEntry,
    MeasuredEntry,
    ModelFile,
)
from postproc.testpart.fit import HELD, LEAST, Fit, Prior

_DRIFTED = 3.0
"""Change of a parameter that is named, in standard deviations."""
_CHANCE = 0.005
"""Chance of deviations that look like a drift, below which it is one."""
_MISFIT = 0.25
"""Unmodelled error, as a share of the deflection, beyond which the model should not be used."""
_FAR = 4.0
"""Distance of a parameter from its prior, in prior standard deviations, that is not plausible."""
_TIED = 0.01
"""Correlation with any other parameter below which one that the part does not determine stays out of [covariance]."""
_DOUBTFUL = 3.0
"""Distance of the scale of the forces from 1, in its standard deviations, that is worth a warning."""
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
    """Change of a parameter since the model was identified: value now over value then, at the same forces.

    `sigmas`: change in its standard deviations.
    """

    name: str
    factor: float
    sigmas: float


class Agreement(Struct, frozen=True):
    """How the model before agrees with the part: χ² of the readings, and the parameters that have changed.

    `chance`: of deviations that look as much like a change of one parameter, or of all, if the robot is the same.
    """

    holds: bool
    line: str
    chi2: float
    points: int
    chance: float
    drifted: list[Change]
    warnings: list[str]


class PartIdentification(Record, frozen=True, kw_only=True, omit_defaults=True):
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


def in_files(found: Fit) -> tuple[Array, Array]:
    """Return the values of the parameters in units of files (p,), and the covariance (p + 1, p + 1).

    The last row is that of the relative error of the scale of the forces.
    """
    prior, robot = found.prior, found.robot
    given = {parameter: robot.value(parameter) for parameter in prior.order}
    values = np.array([parameter.in_file(given)[0] for parameter in prior.parameters])
    rows = [prior.order.index(parameter) for parameter in prior.parameters]
    slopes = np.zeros_like(found.covariance)
    slopes[:-1, :-1] = (file_slopes(prior.order, given) @ prior.by_file)[rows]
    slopes[-1, -1] = 1.0 / found.scale
    return values, slopes @ found.covariance @ slopes.T


def agreement(found: Fit, prior: Prior) -> Agreement:
    """Compare a model with a part.

    :param found: fit of `prior.widened()`: what the part says by itself.
    :param prior: the model with its own covariance.
    """
    count, off = len(found.readings.probed), found.against(prior)
    most = count + _SURPRISE * float(np.sqrt(2.0 * count)) + 7.0
    moved = off.chance < _CHANCE
    factor = np.maximum(1.0 + off.change[:-1] / prior.values, LEAST)
    drifted = [
        Change(parameter.name, round(float(factor[k]), 3), round(float(off.change[k] / off.spread[k]), 1))
        for k, parameter in enumerate(prior.parameters)
        if moved and abs(off.change[k]) > _DRIFTED * off.spread[k] > 0.0
    ]
    line = f"χ² {off.chi2:.0f} of {count} points (at most {most:.0f})"
    if moved:
        names = ", ".join(f"{each.name} × {each.factor:.2f}" for each in drifted)
        line += f"; the arm deflects otherwise under these forces: {names or 'no single joint'}"
    warnings = []
    together = prior.covariance[-1, :-1].any()
    if not together and prior.sigma[-1] > 0.0:
        warnings.append(
            "the model was not identified with these forces, so a change of all compliances by one factor is hardly "
            "seen: give the process with the material.toml of the model"
        )
    return Agreement(
        off.chi2 <= most and not moved, line, round(off.chi2, 2), count, round(off.chance, 4), drifted, warnings
    )


def summary(found: Fit, left_out: tuple[str, ...]) -> PartIdentification:
    """Return the result as plain data, with the verdict."""
    readings, prior = found.readings, found.prior
    values, covariance = in_files(found)
    half = NORMAL_95 * np.sqrt(np.diag(covariance))[:-1]
    parameters, held = {}, []
    for k, (parameter, before) in enumerate(zip(prior.parameters, prior.values.tolist(), strict=True)):
        open_ = not found.free[k]
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
    sigma = found.prior.sigma
    far = np.abs(found.z) / np.where(sigma > 0.0, sigma, np.inf)[:-1]
    reason = ""
    if found.swapped is not None:
        first, second = found.swapped
        reason = f"{first} and {second} look exchanged: exchange their rows of deviation_mm, or probe both again"
    elif left_out:
        reason = (
            f"{', '.join(left_out)} contradict the other points: probe them again, or leave their deviation_mm empty"
        )
    elif found.gamma > _MISFIT:
        reason = f"{100 * found.gamma:.0f} % of the deflection are not described by the model: check part and program"
    elif far.max() > _FAR:
        name = found.prior.parameters[int(np.argmax(far))].name
        reason = f"{name} would be {far.max():.1f} standard deviations from its prior: check material and process"
    elif abs(found.scale - 1.0) > _FAR * sigma[-1] > 0.0:
        reason = f"forces would be {found.scale:.2f} times those computed: check material, feed and depth"
    elif not found.free[:size].any() and found.sigma[-1] > HELD:
        reason = "the part determines neither a parameter of the robot nor the forces"
    if reason:
        return Verdict(True, f"NOT TO BE TRUSTED: {reason}")
    return Verdict(False, "the model may be used, within its bound")


def _remarks(found: Fit, held: list[str], left_out: tuple[str, ...]) -> list[str]:
    out = []
    if held:
        out.append(f"the part does not determine {', '.join(held)}: they keep their prior")
    out += [f"outlier: {name}" for name in left_out]
    if abs(found.scale - 1.0) > _DOUBTFUL * found.prior.sigma[-1] > 0.0:
        out.append(
            f"forces would be {found.scale:.2f} times those computed, more than three standard deviations "
            f"({300.0 * found.prior.sigma[-1]:.0f} %) off: check material, tool, feed and depth"
        )
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


def model_file(found: Fit, prior: ModelFile, process: Process, source: str) -> ModelFile:
    """Return `model.toml`: identified values with intervals, the prior's where the part determines none.

    Its covariance has the scale of the forces too, for those that are computed with `material`.
    """
    values, covariance = in_files(found)
    half = NORMAL_95 * np.sqrt(np.diag(covariance))[:-1]
    size = np.sqrt(np.diag(covariance))
    tied = (np.abs(covariance) > _TIED * np.outer(size, size)).sum(axis=0) > 1
    content = msgspec.to_builtins(prior)
    tables: dict[str, Any] = {"joints": {}, "links": {}, "compensator": {}, "masses": {}}
    stated = []
    for k, parameter in enumerate(found.prior.parameters):
        own_spread = parameter in found.prior.robot.stated_spread
        if not found.free[k] and own_spread and not tied[k]:
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
    names = [found.prior.parameters[k].name for k in stated]
    forces = _forces(found, process, source)
    if forces is not None:
        names.append(FORCES)
        stated.append(len(found.prior.parameters))
    load, u95 = _discrepancy(found)
    known = found.prior.robot.measured
    torque = found.torque if known is None else np.maximum(found.torque, known.torque)
    extra = {
        "covariance": CovarianceTable(names, covariance[np.ix_(stated, stated)].tolist()),
        "forces": forces,
        "discrepancy": DiscrepancyEntry(source=source, load_N=load.tolist(), u95_mm=(u95 * MM_PER_M).tolist()),
        "measured": MeasuredEntry(
            source=source,
            configurations=len(set(found.readings.probed.group.tolist()))
            + (0 if prior.measured is None else prior.measured.configurations),
            torque_Nm=tuple(torque.tolist()),
            not_trusted="",
        ),
    }
    return msgspec.structs.replace(msgspec.convert(content, ModelFile), **extra)


def _discrepancy(found: Fit) -> tuple[Array, Array]:
    """Return levels of load [N] and the unmodelled error [m] there: the larger one of the part and the model before."""
    load, u95 = found.u95()
    before = found.prior.robot.discrepancy
    if before is None:
        return load, u95
    every = np.union1d(load, before.load)
    wrench = np.pad(every[:, None], ((0, 0), (0, 5)))
    return every, np.maximum(Discrepancy(load, u95).at(wrench), before.at(wrench))


def _forces(found: Fit, process: Process, source: str) -> ForcesEntry | None:
    """Return the law of `material`, as its numbers are read; None where the scale is certain or says too little."""
    numbers = cutting_law(_scaled(found, process, source), process.path).numbers
    if not numbers or not numbers[-1] > 0.0:
        return None
    return ForcesEntry(
        source=source,
        cutting_N_per_mm2=(numbers[0], numbers[1], numbers[2]),
        edge_N_per_mm=(numbers[3], numbers[4], numbers[5]),
        mc=numbers[6],
        sigma_percent=numbers[7],
    )


def material(found: Fit, process: Process, source: str) -> bytes:
    """Return `material.toml`: the cutting law of the process with the scale of the forces found."""
    comment = "Written by `postproc identify part`; process.toml takes it by [material] file."
    return files.toml({"material": _scaled(found, process, source)}, comment)


def _scaled(found: Fit, process: Process, source: str) -> IdentifiedTable:
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
        return replace(
            table,
            kc11_N_per_mm2=chip / 1e6,
            mc=law.exponent,
            radial_ratio=law.cutting[1] / law.cutting[0],
            axial_ratio=law.cutting[2] / law.cutting[0],
        )
    return replace(table, Ktc_N_per_mm2=chip / 1e6, Krc_N_per_mm2=radial / 1e6, Kac_N_per_mm2=axial / 1e6)
