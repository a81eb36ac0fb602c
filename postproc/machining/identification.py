"""Cutting coefficients with covariance, identified from measured mean forces or spindle power; and test cuts for them.

Mean forces of a flat tool are linear in the six coefficients of the linear edge-force model (Altintas, "Manufacturing
Automation", 2nd ed., 2012, Eq. (2.31)), and so is the mean power in Ktc and Kte: weighted least squares gives them with
their covariance. One feed per tooth cannot separate the edge from the cut; several feeds in a slot determine all six.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc.errors import ForceError, choices
from postproc.frames import M_PER_MM, Array
from postproc.machining import reading_checks
from postproc.machining.material import MaterialTable, law, six_numbers
from postproc.machining.process import Process, ToolTable
from postproc.program import Bools, Ints

NAMES = ("Ktc", "Krc", "Kac", "Kte", "Kre", "Kae")
"""Coefficients in the order of arrays: N/mm² of the cut, N/mm of the edge."""
KEYS = ("Ktc_N_per_mm2", "Krc_N_per_mm2", "Kac_N_per_mm2", "Kte_N_per_mm", "Kre_N_per_mm", "Kae_N_per_mm")
_MODES = ("slot", "up", "down")
_REQUIRED_COLUMNS = ("mode", "ap_mm", "rpm", "feed_mm_per_min")
_OPTIONAL_COLUMNS = ("ae_mm", "Fx", "Fy", "Fz", "sigma_N", "power_W")
_RANK = 1e-6
"""Singular value, as a share of the largest, below which a combination of coefficients is not excited."""
_LEAST_RANGE = 1.3
"""Ratio of largest to smallest feed per tooth below which edge and cutting coefficients cannot be separated."""
_LEAST_CORRELATION = 1e-9
"""Correlations below this are rounding errors."""
_LEAST_SCATTER = 1e-3
"""Least scatter of readings that do not state theirs, as a share of their RMS. Assumed: the linearity of dynamometers
is 0.1 to 0.5 % of their range."""
_AT_LEAST_ZERO = (0, 1, 3, 4)
"""Indices in `NAMES` of the coefficients that process.toml does not take below 0."""
_PER_MM2 = 1e6
"""N/m² of one N/mm²."""
_MOST_SIGMA = 200.0
"""Largest `sigma_percent` of a process [%]."""
_LEAST_SIGMA = 2.0
"""Minimum standard deviation [%] of forces from identified coefficients (assumed)."""


class CutReadings(Struct, frozen=True, eq=False):
    """Measured cuts.

    :param mode: (n,) "slot", "up" or "down".
    :param depth: (n,) axial depth of cut [mm].
    :param width: (n,) radial width of cut [mm]; not used for slots.
    :param rpm: (n,) spindle speed [1/min].
    :param feed: (n,) [mm/min].
    :param force: (n, 3) mean force on the tool, FEED axes [N]; NaN = not measured.
    :param power: (n,) mean power of the cut [W]; NaN = not measured.
    :param sigma: (n,) standard deviation of one force [N]; NaN = unknown.
    :param line: (n,) line of the file.
    """

    mode: list[str]
    depth: Array
    width: Array
    rpm: Array
    feed: Array
    force: Array
    power: Array
    sigma: Array
    line: Array


class IdentifiedMaterial(Struct, frozen=True, eq=False):
    """Cutting coefficients from readings.

    :param value: (6,) in the order of `NAMES`; `half_width` (6,) of their 95 % intervals.
    :param covariance: (6, 6).
    :param identified: (6,) False for values taken from the process because no reading depends on them.
    :param predictor: (m, 6) and measured: (m,) linear equations of the readings, sigma: (m,) their standard deviations.
    :param reading: (m,) row of the reading, component: (m,) 0…2 for Fx…Fz, 3 for the power.
    :param residual: RMS of the residuals of the forces [N].
    :param cross_validation_error: RMS error of the forces at each feed per tooth, by coefficients from the other feeds,
        as a share of their RMS; NaN where too few feeds are left.
    :param sigma_percent: standard deviation of forces computed with these coefficients.
    :param warnings: limits of the coefficients, for the user.
    """

    value: Array
    half_width: Array
    covariance: Array
    identified: Bools
    predictor: Array
    measured: Array
    sigma: Array
    reading: Ints
    component: Ints
    residual: float
    cross_validation_error: float
    sigma_percent: float
    warnings: tuple[str, ...]


def read(path: Path) -> CutReadings:
    """Read measured cuts from a CSV file with the columns of `_REQUIRED_COLUMNS` and any of `_OPTIONAL_COLUMNS`.

    :raises ForceError: a column is missing or unknown, a mode is unknown, a value is out of range.
    """
    numbers, texts, line = files.read_csv(
        path, _REQUIRED_COLUMNS, _OPTIONAL_COLUMNS, ForceError, ("mode",), _OPTIONAL_COLUMNS
    )
    count = len(line)
    if count == 0:
        raise ForceError("no readings", file=str(path), advice="Give at least one row of readings.")
    column = {name: numbers.get(name, np.full(count, np.nan)) for name in (*_REQUIRED_COLUMNS[1:], *_OPTIONAL_COLUMNS)}
    for k, mode in enumerate(texts["mode"]):
        problem = advice = None
        if mode not in _MODES:
            problem, advice = f"unknown mode {mode!r}", choices(mode, _MODES, "Valid modes")
        elif mode != "slot" and not column["ae_mm"][k] > 0.0:  # NaN: an empty field
            problem, advice = f"mode {mode} without ae_mm", "Give the radial width of cut."
        elif min(column[name][k] for name in ("ap_mm", "rpm", "feed_mm_per_min")) <= 0.0:
            problem = "ap_mm, rpm and feed_mm_per_min must be larger than 0"
        elif column["sigma_N"][k] <= 0.0:
            problem = "sigma_N must be larger than 0"
        if problem is not None:
            raise ForceError(problem, file=str(path), line=int(line[k]), advice=advice)
    force = np.stack([column[name] for name in ("Fx", "Fy", "Fz")], axis=-1)
    return CutReadings(
        texts["mode"], column["ap_mm"], column["ae_mm"], column["rpm"], column["feed_mm_per_min"],
        force, column["power_W"], column["sigma_N"], line,
    )  # fmt: skip


def tool_of(process: Process, name: str | None) -> tuple[str, ToolTable]:
    """Return key and entry of the tool used in the measurement.

    :param name: number or name of the tool in [tools]; None: [tools.default], or the only tool.
    :raises ForceError: the process has no such tool, or several and none is named, or the tool is not flat.
    """
    entry = process.tool(name)
    if entry is None:
        tool_names = ", ".join(process.tools) or "none"
        raise ForceError(
            "the measured tool is not given", file=process.path, advice=f"Give --tool; found: {tool_names}."
        )
    key, tool = entry
    if tool.shape != "flat":
        advice = "Measure with a flat tool: only there is the mean force linear in the six coefficients."
        raise ForceError(f"[tools.{key}] is a {tool.shape} tool", file=process.path, advice=advice)
    return key, tool


def equations(readings: CutReadings, tool: ToolTable) -> Array:
    """Return the derivatives of Fx, Fy, Fz [N] and the power [W] of readings by the coefficients: (n, 4, 6).

    Each is the antiderivative of the force of a tooth over its angle, at the angle where the tooth leaves the material
    minus at the angle where it enters (Altintas, "Manufacturing Automation", 2nd ed., 2012, Eq. (2.31)). With M4, Fy
    has the opposite sign. Coefficients are in the order of `NAMES`.
    """
    radius, teeth = 0.5 * tool.diameter_mm, tool.flutes
    width = np.where(np.array(readings.mode) == "slot", 2.0 * radius, np.minimum(readings.width, 2.0 * radius))
    arc = np.arccos(1.0 - width / radius)  # angle of the turn in which a tooth is in the material [rad]
    # angles are 0 where a tooth begins in up milling, with no chip, and π where it ends in down milling
    is_down = np.array(readings.mode) == "down"
    start_angle, end_angle = np.where(is_down, np.pi - arc, 0.0), np.where(is_down, np.pi, arc)
    chip_thickness = readings.feed / (readings.rpm * teeth)
    derivatives = np.zeros((len(chip_thickness), 4, 6))
    edge_length = teeth * readings.depth / (2.0 * np.pi)  # in the depth of cut, per radian of the turn [mm]
    # indices: reading (Fx, Fy, Fz, power), then coefficient (Ktc, Krc, Kac, Kte, Kre, Kae)
    for phi, sign in ((end_angle, 1.0), (start_angle, -1.0)):
        cos2, angle_term = np.cos(2.0 * phi), 2.0 * phi - np.sin(2.0 * phi)
        sine, cosine = np.sin(phi), np.cos(phi)
        cut_factor, edge_factor = sign * edge_length * chip_thickness, sign * edge_length
        derivatives[:, 0, 0] += cut_factor * cos2 / 4.0
        derivatives[:, 0, 1] -= cut_factor * angle_term / 4.0
        derivatives[:, 0, 3] -= edge_factor * sine
        derivatives[:, 0, 4] += edge_factor * cosine
        derivatives[:, 1, 0] += cut_factor * angle_term / 4.0
        derivatives[:, 1, 1] += cut_factor * cos2 / 4.0
        derivatives[:, 1, 3] -= edge_factor * cosine
        derivatives[:, 1, 4] -= edge_factor * sine
        derivatives[:, 2, 2] -= cut_factor * cosine
        derivatives[:, 2, 5] += edge_factor * phi
        edge_speed = radius * M_PER_MM * readings.rpm * (2.0 * np.pi / 60.0)  # [m/s]
        derivatives[:, 3, 0] -= cut_factor * cosine * edge_speed
        derivatives[:, 3, 3] += edge_factor * phi * edge_speed
    if tool.spindle == "M4":
        derivatives[:, 1] *= -1.0
    return derivatives


class _Equations(NamedTuple):
    """Linear equations of the m values that were measured.

    :param predictor: (m, 6) derivatives of the readings by the coefficients.
    :param readout: (m,) measured values: forces [N], powers [W].
    :param sigma: (m,) their standard deviations [N], [W]: as stated, else relative to that of a force, see
        `_linear_equations`.
    :param reading: (m,) row of the reading.
    :param component: (m,) 0, 1, 2 for Fx, Fy, Fz, and 3 for the power.
    :param has_sigma: whether all readings state their standard deviation.
    """

    predictor: Array
    readout: Array
    sigma: Array
    reading: Ints
    component: Ints
    has_sigma: bool


def identify(readings: CutReadings, tool: ToolTable, prior: MaterialTable | None, file: str) -> IdentifiedMaterial:
    """Identify the coefficients by weighted least squares.

    :param prior: material of the process: it gives the coefficients that no reading depends on; None: there is none.
    :param file: name of the file of the readings, for messages.
    :raises ForceError: the readings cannot separate coefficients (the message names them), there are too few readings,
        or signs, axes or units are wrong.
    """
    chip = readings.feed / (readings.rpm * tool.flutes)
    reading_checks.check_feeds(chip, tool.diameter_mm, file)
    system = _linear_equations(readings, tool, file)
    # a coefficient whose column is rounding has no reading that depends on it
    is_excited = np.abs(system.predictor).max(axis=0) > 1e-9 * np.abs(system.predictor).max()
    _check_separable(chip, system.predictor, system.sigma, is_excited, file)
    prior_coefficients = _prior_coefficients(prior, is_excited, file)
    degrees_of_freedom = _degrees_of_freedom(system, is_excited, file)
    warnings = [
        *prior_coefficients.warnings,
        *_check_signs(readings, tool, prior_coefficients.value, is_excited, file),
    ]
    fit = _fit_with_prior(system, prior_coefficients, is_excited, degrees_of_freedom)
    warnings += fit.warnings
    warnings += reading_checks.check_sizes(fit.value, readings.force, _tangential_coefficient(prior, file), file)
    half_width = 1.96 * np.sqrt(np.diag(fit.covariance))
    warnings += _wide_interval_warnings(fit.value, half_width, is_excited)
    force_error = fit.error[system.component < 3]
    return IdentifiedMaterial(
        value=fit.value,
        half_width=half_width,
        covariance=fit.covariance,
        identified=is_excited,
        predictor=system.predictor,
        measured=system.readout,
        sigma=system.sigma,
        reading=system.reading,
        component=system.component,
        residual=float(np.sqrt(np.mean(force_error**2))) if len(force_error) else float("nan"),
        cross_validation_error=_cross_validation_error(
            system.predictor[:, is_excited],
            fitted_part=system.readout - system.predictor @ prior_coefficients.value,
            readout=system.readout,
            sigma=system.sigma,
            chip=np.round(chip[system.reading], 6),  # equal feeds per tooth are equal numbers
        ),
        sigma_percent=max(
            _LEAST_SIGMA,
            _percent_of_readout(system, fit.covariance, fit.error, file),
            0.0 if is_excited.all() else _percent_of_forces(equations(readings, tool)[:, :3], fit),
        ),
        warnings=tuple(warnings),
    )


class _CoefficientFit(NamedTuple):
    """Coefficients that fit readings, in the order of `NAMES`.

    :param value: (6,) and `covariance` (6, 6): those that readings depend on are fitted, the others from the process.
    :param error: (m,) computed less measured readings [N], of the power [W].
    :param warnings: about the scatter of the readings and about coefficients that are taken as 0.
    """

    value: Array
    covariance: Array
    error: Array
    warnings: list[str]


def _fit_with_prior(
    system: _Equations, prior: _PriorCoefficients, is_excited: Bools, degrees_of_freedom: int
) -> _CoefficientFit:
    """Return the coefficients by weighted least squares; tangential and radial ones are at least 0.

    :param prior: the coefficients that no reading depends on.
    :param is_excited: (6,) True for coefficients that readings depend on.
    :param degrees_of_freedom: number of readings minus number of fitted coefficients.
    """
    # the part of the readings that the fitted coefficients must explain
    matrix, fitted_part = system.predictor[:, is_excited], system.readout - system.predictor @ prior.value
    fitted_value, spread = _fit(matrix, fitted_part, system.sigma)
    error = matrix @ fitted_value - fitted_part
    spread, warnings = _scaled_spread(spread, error, system, degrees_of_freedom)
    value = prior.value.copy()
    value[is_excited] = fitted_value
    negative_rows = [k for k in _AT_LEAST_ZERO if value[k] < 0.0]
    if negative_rows:
        warnings += [f"{NAMES[k]} is {value[k]:.2g}, within its error: taken as 0" for k in negative_rows]
        value[is_excited] = _positive_fit(matrix, fitted_part, system.sigma, np.flatnonzero(is_excited))
        error = system.predictor @ value - system.readout
    covariance = np.diag(prior.sigma**2)
    covariance[np.ix_(is_excited, is_excited)] = spread
    return _CoefficientFit(value, covariance, error, warnings)


def _degrees_of_freedom(system: _Equations, is_excited: Bools, file: str) -> int:
    """Return the number of readings minus the number of coefficients that they depend on.

    :param is_excited: (6,) True for these coefficients.
    :raises ForceError: there are not more readings than coefficients.
    """
    count = int(is_excited.sum())
    if len(system.readout) <= count:
        advice = "Measure at more feeds: five in a slot determine all six."
        raise ForceError(f"{len(system.readout)} readings for {count} coefficients", file=file, advice=advice)
    return len(system.readout) - count


def _wide_interval_warnings(estimate: Array, half_width: Array, is_excited: Bools) -> list[str]:
    """Return a warning for each coefficient whose 95 % interval is wider than itself.

    :param estimate: (6,) coefficients, and `half_width` (6,) of their intervals.
    :param is_excited: (6,) True for coefficients that readings depend on: the others get no warning.
    """
    return [
        f"{NAMES[k]} is known to ±{half_width[k]:.2g} only ({estimate[k]:.3g}): measure more feeds, or deeper cuts"
        for k in np.flatnonzero(is_excited & (half_width > 0.5 * np.abs(estimate))).tolist()
    ]


def _check_signs(readings: CutReadings, tool: ToolTable, estimate: Array, is_excited: Bools, file: str) -> list[str]:
    """Refuse forces that are not in FEED axes, and return warnings, see `reading_checks.check_signs`.

    :param estimate: (6,) values of the coefficients that no reading depends on, 0 for the others.
    :param is_excited: (6,) coefficients that readings depend on.
    :raises ForceError: other signs or axes of Fx and Fy are likely.
    """

    def fit_of_forces(force: Array) -> reading_checks.Fit | None:
        """Return the coefficients for forces (n, 3) [N] in other axes; None if these do not determine them."""
        system = _linear_equations(replace(readings, force=force), tool, file)
        matrix, target = system.predictor[:, is_excited], system.readout - system.predictor @ estimate
        scale = np.linalg.norm(matrix, axis=0)
        if not scale.all() or np.linalg.matrix_rank(matrix / system.sigma[:, None] / scale) < matrix.shape[1]:
            return None
        value, sigma = estimate.copy(), np.zeros(6)
        value[is_excited], spread = _fit(matrix, target, system.sigma)
        error = (matrix @ value[is_excited] - target) / system.sigma
        degrees_of_freedom = len(target) - matrix.shape[1]
        spread, _ = _scaled_spread(spread, error * system.sigma, system, degrees_of_freedom)
        sigma[is_excited] = np.sqrt(np.diag(spread))
        # computed readings have residuals of rounding alone: these do not rank arrangements
        size = float(np.linalg.norm(system.readout / system.sigma))
        return reading_checks.Fit(value, sigma, max(_LEAST_SCATTER, float(np.linalg.norm(error)) / size))

    return reading_checks.check_signs(readings.force, fit_of_forces, file)


def _positive_fit(predictor: Array, readout: Array, sigma: Array, coefficient: Ints) -> Array:
    """Return the weighted least-squares estimate (k,) of coefficients that are at least 0; axial ones are unbounded.

    :param predictor: (m, k) derivatives of the readings by these coefficients, `readout` (m,) the readings, `sigma`
        (m,) their standard deviations.
    :param coefficient: (k,) index of each in `NAMES`.
    """
    from scipy.optimize import lsq_linear

    matrix = predictor / sigma[:, None]
    scale = np.linalg.norm(matrix, axis=0)
    lower_bound = np.where(np.isin(coefficient, _AT_LEAST_ZERO), 0.0, -np.inf)
    return np.asarray(lsq_linear(matrix / scale, readout / sigma, (lower_bound, np.inf), method="bvls").x / scale)


def _tangential_coefficient(prior: MaterialTable | None, file: str) -> float | None:
    """Return Ktc or kc1.1 of a material [N/mm²]; None without a material, or with one that cannot be used.

    Such a material is no error: the readings may have been taken to replace it.
    """
    if prior is None:
        return None
    try:
        return law(prior, file).cutting[0] / _PER_MM2
    except ForceError:
        return None


def _linear_equations(readings: CutReadings, tool: ToolTable, file: str) -> _Equations:
    """Return the equations of all forces and powers that were measured.

    Without a stated `sigma_N`, forces have the standard deviation 1 N. The standard deviation of a power is that of a
    force, times the ratio of the derivatives of power and Fy by Ktc and Kte.

    :raises ForceError: no force and no power was measured.
    """
    derivatives = equations(readings, tool)
    values = np.concatenate([readings.force, readings.power[:, None]], axis=1)  # (n, 4): Fx, Fy, Fz, power; NaN: none
    reading, component = (np.asarray(index, dtype=np.int64) for index in np.nonzero(np.isfinite(values)))
    if not len(reading):
        raise ForceError("no force and no power in any row", file=file, advice="Fill in Fx, Fy, Fz or power_W.")
    has_sigma = np.isfinite(readings.sigma)
    sigma = np.where(has_sigma, readings.sigma, 1.0)[reading]
    # derivatives of the power (row 3) and of Fy (row 1) by Ktc and Kte (columns 0 and 3)
    power_size, force_size = (np.linalg.norm(derivatives[:, component, [0, 3]], axis=1) for component in (3, 1))
    watt_per_newton = power_size / np.maximum(force_size, 1e-12)
    sigma = np.where(component == 3, sigma * watt_per_newton[reading], sigma)
    predictor, readout = derivatives[reading, component], values[reading, component]
    return _Equations(
        predictor=predictor,
        readout=readout,
        sigma=sigma,
        reading=reading,
        component=component,
        has_sigma=bool(has_sigma.all()),
    )


def _scaled_spread(spread: Array, error: Array, system: _Equations, degrees_of_freedom: int) -> tuple[Array, list[str]]:
    """Return the covariance (k, k) of coefficients, scaled by the scatter of the readings, and warnings about it.

    If all readings state their standard deviations and scatter no more than these, the covariance remains. Else it is
    scaled by the observed scatter and widened to the interval of Student's t: then 1.96 standard deviations of the
    result still are the half width of a 95 % interval.

    :param spread: (k, k) covariance if the readings scatter as `system.sigma` says.
    :param error: (m,) residuals of forces [N] and powers [W].
    :param degrees_of_freedom: number of readings minus number of coefficients.
    """
    warnings: list[str] = []
    scale = float(np.sum((error / system.sigma) ** 2)) / degrees_of_freedom
    factor = 1.96  # half width of a 95 % interval of normal numbers, in standard deviations
    if not system.has_sigma:
        least_scale = _LEAST_SCATTER**2 * float(np.mean((system.readout / system.sigma) ** 2))
        if scale < least_scale:
            scale = least_scale
            warnings.append(
                "the readings scatter less than any sensor does: were they computed? The intervals are those of a "
                f"scatter of {100.0 * _LEAST_SCATTER:g} %; state sigma_N"
            )
    if not system.has_sigma or scale > 1.0:
        from scipy.special import stdtrit

        spread = spread * scale
        factor = float(stdtrit(degrees_of_freedom, 0.975))
    if system.has_sigma and scale > 2.0:
        warnings.append(
            f"the readings scatter {np.sqrt(scale):.1f} times as much as sigma_N says: the intervals are wider by that"
        )
    return spread * (factor / 1.96) ** 2, warnings


def _percent_of_readout(system: _Equations, covariance: Array, error: Array, file: str) -> float:
    """Return the RMS deviation of readings from their model, in % of the RMS of the readings.

    It combines the residuals with the uncertainty of the coefficients.

    :param covariance: (6, 6) of the coefficients.
    :param error: (m,) residuals of forces [N] and powers [W].
    :param file: name of the file of the readings, for the message.
    :raises ForceError: the deviation is above `_MOST_SIGMA`, the largest `sigma_percent` of a process.
    """
    variance = np.einsum("mi,ij,mj->m", system.predictor, covariance, system.predictor) + error**2
    rms_readout = float(np.sqrt(np.sum((system.readout / system.sigma) ** 2)))
    percent = 100.0 * float(np.sqrt(np.sum(variance / system.sigma**2))) / rms_readout
    if percent > _MOST_SIGMA:
        raise ForceError(
            f"no coefficients fit these readings: forces computed with them have a sigma of {percent:.0f} %",
            file=file,
            advice="Check mode, ap_mm, ae_mm, rpm and feed_mm_per_min, and flutes and diameter of the tool.",
        )
    return percent


def _percent_of_forces(derivatives: Array, fit: _CoefficientFit) -> float:
    """Return the RMS standard deviation of forces that follows from the coefficients, in % of the RMS of the forces.

    Readings of power alone fit well, but say nothing of the radial and axial coefficients.

    :param derivatives: (n, 3, 6) of the forces by the coefficients.
    """
    variance = float(np.einsum("nci,ij,ncj->", derivatives, fit.covariance, derivatives))
    rms_force = float(np.linalg.norm(derivatives @ fit.value))
    return min(100.0 * float(np.sqrt(variance)) / rms_force, _MOST_SIGMA)


def _fit(predictor: Array, readout: Array, sigma: Array) -> tuple[Array, Array]:
    """Return the weighted least-squares estimate (k,) and its covariance (k, k).

    Columns are scaled to the length 1, as coefficients of the cut and of the edge differ by their units.

    :param predictor: (m, k) derivatives of the readings by the coefficients, `readout` (m,) the readings, `sigma` (m,)
        their standard deviations.
    """
    matrix = predictor / sigma[:, None]
    scale = np.linalg.norm(matrix, axis=0)
    value = np.linalg.lstsq(matrix / scale, readout / sigma, rcond=None)[0] / scale
    return value, np.linalg.inv((matrix / scale).T @ (matrix / scale)) / np.outer(scale, scale)


def _cross_validation_error(predictor: Array, fitted_part: Array, readout: Array, sigma: Array, chip: Array) -> float:
    """Return the cross-validation error over feeds: RMS error of predicted readings, as a share of the RMS reading.

    The readings at each feed per tooth are predicted with coefficients from all other feeds. NaN if these do not
    determine the coefficients.

    :param predictor: (m, k) derivatives by the coefficients that readings depend on.
    :param fitted_part: (m,) part of the readings that these coefficients explain; `readout` (m,) the readings, `sigma`
        (m,) their standard deviations.
    :param chip: (m,) feeds per tooth [mm].
    """
    scale = np.linalg.norm(predictor, axis=0)
    square_sum = 0.0
    for chip_value in np.unique(chip):
        is_test = chip == chip_value
        is_training = ~is_test
        matrix = predictor[is_training] / sigma[is_training, None]
        if is_test.all() or np.linalg.matrix_rank(matrix / scale) < predictor.shape[1]:
            return float("nan")
        value, _ = _fit(predictor[is_training], fitted_part[is_training], sigma[is_training])
        square_sum += float(np.sum(((predictor[is_test] @ value - fitted_part[is_test]) / sigma[is_test]) ** 2))
    return float(np.sqrt(square_sum / np.sum((readout / sigma) ** 2)))


def _check_separable(chip: Array, predictor: Array, sigma: Array, is_excited: Bools, file: str) -> None:
    """Refuse readings that do not excite a combination of coefficients.

    :param chip: (n,) feeds per tooth of the readings [mm].
    :param predictor: (m, 6) derivatives of the readings by the coefficients, `sigma` (m,) standard deviations of the
        readings.
    :param is_excited: (6,) True for coefficients that readings depend on.
    :raises ForceError: a combination is not identifiable; the message names the coefficients.
    """
    names = [name for name, has_readings in zip(NAMES, is_excited, strict=True) if has_readings]  # columns of `matrix`
    if chip.max() < _LEAST_RANGE * chip.min():
        raise ForceError(
            f"one feed per tooth ({chip.mean():.3g} mm): edge and cut ({', '.join(names)}) cannot be separated",
            file=file,
            advice="Measure at several feeds, the largest at least twice the smallest; `--propose` writes test cuts.",
        )
    matrix = predictor[:, is_excited] / sigma[:, None]
    matrix = matrix / np.linalg.norm(matrix, axis=0)
    _, singular_values, axes = np.linalg.svd(matrix, full_matrices=True)
    singular_values = np.append(singular_values, np.zeros(len(axes) - len(singular_values)))
    # coefficients with a component in a combination of singular value 0 are not determined; 1e-3 is above rounding
    is_undetermined = np.abs(axes[singular_values < _RANK * singular_values[0]]).max(axis=0, initial=0.0) > 1e-3
    if is_undetermined.any():
        undetermined_names = ", ".join(
            name for name, undetermined in zip(names, is_undetermined, strict=True) if undetermined
        )
        advice = "Measure Fx and Fy, at several feeds; `--propose` writes test cuts."
        raise ForceError(f"these readings do not separate {undetermined_names}", file=file, advice=advice)


class _PriorCoefficients(NamedTuple):
    """Coefficients that are taken from the process, in the order of `NAMES`.

    :param value: (6,) their values; 0 for coefficients that readings depend on.
    :param sigma: (6,) their standard deviations; 0 for coefficients that readings depend on.
    :param warnings: a warning that names these coefficients; empty if there are none.
    """

    value: Array
    sigma: Array
    warnings: list[str]


def _prior_coefficients(prior: MaterialTable | None, is_excited: Bools, file: str) -> _PriorCoefficients:
    """Return the coefficients that no reading depends on, with the values of the process.

    :param prior: material of the process; None: the process has no material.
    :param is_excited: (6,) True for coefficients that readings depend on.
    :param file: name of the readings, for messages.
    :raises ForceError: no reading depends on some coefficients, and the process has no linear material.
    """
    value, sigma = np.zeros(6), np.zeros(6)
    if is_excited.all():
        return _PriorCoefficients(value, sigma, [])
    prior_names = ", ".join(name for name, has_readings in zip(NAMES, is_excited, strict=True) if not has_readings)
    linear_material = None if prior is None else six_numbers(prior, file)
    if linear_material is None:
        advice = "Measure it, or give [material] of the process by name or six numbers: they are taken from there."
        raise ForceError(f"no reading depends on {prior_names}", file=file, advice=advice)
    prior_value, prior_sigma = linear_material
    value[~is_excited] = prior_value[~is_excited]
    sigma[~is_excited] = np.abs(prior_value[~is_excited]) * prior_sigma
    percent = 196 * prior_sigma  # half width of the 95 % interval
    warning = f"no reading depends on {prior_names}: taken from [material] of the process, ±{percent:.0f} %"
    return _PriorCoefficients(value, sigma, [warning])


def as_toml(material: IdentifiedMaterial, tool: ToolTable, name: str) -> bytes:
    """Return the content of a material.toml with identified coefficients, intervals and covariance.

    :param name: name of the file of readings, stated as the source.
    """
    table: dict[str, object] = {key: float(f"{v:.6g}") for key, v in zip(KEYS, material.value, strict=True)}
    table["sigma_percent"] = round(material.sigma_percent, 2)
    table["source"] = f"identified from {name}: {len(set(material.reading.tolist()))} cuts with a flat tool of " + (
        f"{tool.diameter_mm:g} mm, {tool.flutes} teeth"
    )
    if np.isfinite(material.residual):
        table["residual_N"] = float(f"{round(material.residual, 6):.4g}")
    table["ci95"] = {name: float(f"{v:.4g}") for name, v in zip(NAMES, material.half_width, strict=True)}
    deviation = np.sqrt(np.diag(material.covariance))
    significant = np.where(
        np.abs(material.covariance) > _LEAST_CORRELATION * np.outer(deviation, deviation), material.covariance, 0.0
    )
    table["covariance"] = [[float(f"{v:.6g}") for v in row] for row in significant]
    comment = 'Cutting coefficients, identified by `postproc identify forces`. In process.toml: [material] file = "…".'
    return files.seal(files.toml({"material": table}, comment))


def proposal(process: Process, key: str, tool: ToolTable) -> tuple[bytes, bytes]:
    """Return a G-code program of test cuts, and the CSV file of readings to fill in: five slots at different feeds.

    The slots are along X, next to each other along Y, in the box of the stock, or from X0 Y0 Z0.

    :param key: key of the tool in [tools]; the program calls T1 if it is no number.
    """
    feeds, depth = proposed_feeds(tool)
    # without a stated speed: a cutting speed of 150 m/min, at most 12,000 rpm, in whole hundreds (assumed)
    rpm = tool.rpm or float(np.floor(min(12_000.0, 150_000.0 / (np.pi * tool.diameter_mm)) / 100.0) * 100.0)
    box = process.stock.box
    x_min, y_min, z_max = (0.0, 0.0, 0.0) if box is None else (box.X[0], box.Y[0], box.Z[1])
    # in a box: from one diameter before it to a fifth of one behind it, at most 60 mm of slot
    length = 60.0 if box is None else min(60.0 + tool.diameter_mm, box.X[1] - box.X[0] + 1.2 * tool.diameter_mm)
    lines = [
        "(Test cuts for `postproc identify forces`: five feeds in a slot. Measure the mean force of each, after entry)",
        "G21 G90 G17 G94", f"T{key if key.isdecimal() else 1} M6", f"S{rpm:g} {tool.spindle}", f"G0 Z{z_max + 20:g}",
    ]  # fmt: skip
    rows = ["mode,ap_mm,ae_mm,rpm,feed_mm_per_min,Fx,Fy,Fz,sigma_N"]
    for k, chip in enumerate(feeds.tolist()):
        feed = chip * rpm * tool.flutes
        y = y_min + (1.5 * k + 1.0) * tool.diameter_mm  # half a diameter of material between slots
        lines += [
            f"(slot {k + 1}: {chip:.3f} mm per tooth)", f"G0 X{x_min - tool.diameter_mm:.3f} Y{y:.3f}",
            f"G0 Z{z_max + 2:.3f}", f"G1 Z{z_max - depth:.3f} F1000",
            f"X{x_min - tool.diameter_mm + length:.3f} F{feed:.1f}", f"G0 Z{z_max + 20:g}",
        ]  # fmt: skip
        rows.append(f"slot,{depth:g},,{rpm:g},{feed:.1f},,,,")
    lines += ["M5", "M30", ""]
    return "\n".join(lines).encode(), "\n".join([*rows, ""]).encode()


def proposed_feeds(tool: ToolTable) -> tuple[Array, float]:
    """Return five feeds per tooth (5,) [mm] and the depth [mm] of test cuts; the shares of the diameter are assumed."""
    largest = min(0.125, 0.01 * tool.diameter_mm)
    return largest * np.array([0.2, 0.4, 0.6, 0.8, 1.0]), float(f"{min(3.0, 0.2 * tool.diameter_mm):.2g}")
