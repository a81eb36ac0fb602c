"""Weighted least squares for the parameters of the elastic model: Gauss–Newton, free or with bounds and a ridge."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.errors import MeasurementError, NotConvergedError
from postproc.frames import Array
from postproc.identification.displacements import measured_displacements, visible, whiten, whitening
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement
from postproc.identification.prediction import predict
from postproc.identification.structure import Structure
from postproc.robot import Parameter, RobotModel, file_slopes

NORMAL_95 = 1.959964
"""Half width of a 95 % interval of a normal distribution, in standard deviations."""
LENGTH_95 = 1.6140
"""95 % quantile of the length of normal vectors in space over their RMS length."""

_ITERATIONS = 25
_WORSE = 1.5
"""Growth of the squares that calls for a shorter step."""
_DEAD = 1e-6
"""Effect of a parameter of usual size on all readings, in σ, below which it has none."""


class Fit(Struct, frozen=True, eq=False):
    """Parameters that minimise the weighted squares of the residuals.

    :param structure: what was fitted.
    :param values: (p,) SI.
    :param covariance: (p, p), for noise σ as stated; infinite where the data say nothing.
    :param residual: (L, P, 3) measured − predicted displacements [m], root axes.
    :param chi2: sum of squares of the whitened residuals, and `dof` its degrees of freedom.
    :param design: (rows, p) whitened derivatives at the solution, and `target` (rows,) what they should give.
    """

    structure: Structure
    values: Array
    covariance: Array
    residual: Array
    chi2: float
    dof: int
    design: Array
    target: Array

    @property
    def robot(self) -> RobotModel:
        """The robot with the values found."""
        return self.structure.robot(self.values)

    @property
    def rms(self) -> float:
        """RMS distance [m] of the points from their prediction."""
        squares = np.sum(self.residual**2, axis=-1)
        return float(np.sqrt(squares.sum() / max(1, np.count_nonzero(squares))))

    @property
    def ci95(self) -> Array:
        """Half widths (p,) of the 95 % intervals."""
        return np.asarray(NORMAL_95 * np.sqrt(np.diag(self.covariance)))

    @property
    def given(self) -> dict[Parameter, float]:
        """The values by parameter, SI."""
        return dict(zip(self.structure.parameters, self.values.tolist(), strict=True))


def gauss_newton(
    structure: Structure,
    data: Measurements,
    placement: Placement,
    start: Array | None = None,
    ridge: Array | None = None,
    iterations: int = _ITERATIONS,
) -> Fit:
    """Fit the parameters to loaded − unloaded displacements.

    :param ridge: (p,) weights r: the sum of (r·p)² is added and all parameters are kept ≥ 0 (regularised fit).
    """
    values = structure.start() if start is None else start.copy()
    displacement, w = measured_displacements(data, placement), whitening(data)
    size = len(structure.parameters)
    previous, smallest = values, np.inf
    for _ in range(iterations):
        try:
            moved, slopes = predict(structure, values, data, placement)
            cost = float(np.sum(whiten(w, displacement - moved) ** 2))
        except NotConvergedError:
            if values is previous or ridge is not None:
                raise
            cost = np.inf
        if cost > _WORSE * smallest and ridge is None:  # a step too far, perhaps without equilibrium: halve it
            values = 0.5 * (previous + values)
            continue
        previous, smallest = values, min(cost, smallest)
        design = whiten(w, slopes).reshape(-1, size)
        design[:, np.linalg.norm(design, axis=0) * structure.usual() < _DEAD] = 0.0
        target = whiten(w, displacement - moved).ravel() + design @ values
        new = solve(design, target, ridge)
        scale = np.linalg.norm(design, axis=0)
        change = float(np.max(np.abs((new - values) * scale), initial=0.0))
        values = new
        if change < 1e-4:
            break
    moved, slopes = predict(structure, values, data, placement)
    design = whiten(w, slopes).reshape(-1, size)
    left = (displacement - moved) * visible(data)
    white = whiten(w, left).ravel()
    return Fit(
        structure,
        values,
        covariance_of(design, structure.usual(), ridge),
        left,
        float(white @ white),
        int(np.count_nonzero(np.linalg.norm(design, axis=1) > 0.0)) - size,
        design,
        white + design @ values,
    )


def solve(design: Array, target: Array, ridge: Array | None = None) -> Array:
    """Return the least-squares parameters; with a ridge the non-negative ones (Lawson and Hanson 1974)."""
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0
    if ridge is None:
        values, *_ = np.linalg.lstsq(design / scale, target, rcond=1e-9)
        return np.asarray(values / scale)
    from scipy.optimize import nnls

    rows = np.vstack([design / scale, np.diag(ridge / scale)])
    square = rows.T @ rows  # p×p instead of rows×p: the active-set loop is then small
    right = rows.T @ np.concatenate([target, np.zeros(len(ridge))])
    jitter = 1e-12 * np.trace(square) / len(square)
    factor = np.linalg.cholesky(square + jitter * np.eye(len(square)))
    values, _ = nnls(factor.T, np.linalg.solve(factor, right), maxiter=50 * len(ridge))
    return np.asarray(values / scale)


def covariance_of(design: Array, typical: Array, ridge: Array | None = None) -> Array:
    """Return (DᵀD + R²)⁻¹; directions that the data leave open get infinite variance.

    :param typical: (p,) usual sizes of the parameters: one that then moves the readings by less than 10⁻⁶ σ is dead.
    """
    scale = np.linalg.norm(design, axis=0)
    dead = scale * typical < _DEAD
    safe = np.where(dead, 1.0, scale)
    rows = design / safe
    if ridge is not None:
        rows = np.vstack([rows, np.diag(ridge / safe)])
    _, singular, vt = np.linalg.svd(rows, full_matrices=False)
    good = singular > 1e-8 * singular.max(initial=0.0)
    inverse = (vt[good].T / singular[good] ** 2) @ vt[good]
    covariance = inverse / np.outer(safe, safe)
    open_directions = np.sum(vt[~good] ** 2, axis=0) > 1e-6 if (~good).any() else np.zeros(len(scale), dtype=bool)
    for index in np.flatnonzero(dead | open_directions):
        covariance[index, :] = covariance[:, index] = 0.0
        covariance[index, index] = np.inf
    return np.asarray(covariance)


def to_file_units(fit: Fit) -> tuple[tuple[Parameter, ...], Array, Array]:
    """Return parameters, values and covariance of a fit as `model.toml` holds them, in its units.

    k1…k6 are compliances at small torque, fading parts included; s₀ comes from K_c·s₀.

    :raises MeasurementError: a value or its variance is not finite.
    """
    parameters = fit.structure.parameters
    slopes = file_slopes(parameters, fit.given)
    values = np.array([parameter.in_file(fit.given)[0] for parameter in parameters])
    finite = np.isfinite(values) & np.isfinite(fit.covariance).all(axis=1)
    if not finite.all():
        wrong = ", ".join(parameter.name for parameter, good in zip(parameters, finite, strict=True) if not good)
        raise MeasurementError(
            f"the fit has no finite value or variance for {wrong}",
            file="",
            advice="Measure configurations and loads that put torque on these joints.",
        )
    covariance = slopes @ fit.covariance @ slopes.T
    return parameters, values, 0.5 * (covariance + covariance.T)
