"""Bayesian linear regression of the readings, with widths of the priors chosen by maximum evidence.

Given readings y of unit variance, derivatives D and a prior N(m, S²) of the parameters, y is normal about D·m with
covariance φ·1 + D S² Dᵀ. The factors in S (`priors.FACTORS`) and the noise factor φ ≥ 1 (residual
beyond noise) maximise the density of y times that of the factors (evidence, type-II maximum likelihood: MacKay, Neural
Computation 4, 1992). The values are the most probable ones that are not negative. The posterior covariance
(DᵀD/φ + S⁻²)⁻¹ never exceeds S²: a parameter that the readings do not excite keeps its prior.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.identification.linearised import Linearised
from postproc.identification.priors import FACTORS, Prior
from postproc.program import Bools, Ints

_NARROWEST, _WIDEST = -6.0, 4.0
"""Limits of the logarithms of factors."""
_MOST_NOISE = 4.0
"""Largest logarithm of φ; its prior is normal about 0 with standard deviation `_NOISE_SPREAD`."""
_NOISE_SPREAD = 0.5


class Regression(Struct, frozen=True, eq=False):
    """Regression of the readings on n of the p parameters.

    :param columns: (n,) their indices among the p parameters of the equations.
    :param mean: (n,) prior mean, SI.
    :param spread: (n,) prior standard deviation, SI.
    :param signed: (n,) whether the parameter may be negative.
    :param noise: φ.
    :param evidence: logarithm of the density of the readings and the factors.
    :param size: p.
    """

    columns: Ints
    mean: Array
    spread: Array
    signed: Bools
    noise: float
    evidence: float
    size: int

    def solve(self, equations: Linearised, without: Ints | None = None) -> Array:
        """Return the most probable values (p,), SI; zero for parameters that are not among the columns.

        Non-negative least squares (Lawson and Hanson 1974) on the normal equations. Signed parameters come first, and
        are eliminated by the triangle of Cholesky.

        :param without: configurations to leave out.
        """
        from scipy.optimize import nnls

        normal, right = self._normal(equations, without)
        order, free = np.argsort(~self.signed, kind="stable"), int(np.count_nonzero(self.signed))
        factor = np.linalg.cholesky(normal[np.ix_(order, order)])
        left, upper = np.linalg.solve(factor, right[order]), factor.T
        found = np.empty(len(order))
        found[free:], _ = nnls(upper[free:, free:], left[free:], maxiter=100 * len(order))
        found[:free] = np.linalg.solve(upper[:free, :free], left[:free] - upper[:free, free:] @ found[free:])
        values = np.zeros(self.size)
        values[self.columns[order]] = found * self.spread[order]
        return values

    def covariance(self, equations: Linearised) -> Array:
        """Return the posterior covariance (p, p), SI."""
        normal, _ = self._normal(equations)
        out = np.zeros((self.size, self.size))
        out[np.ix_(self.columns, self.columns)] = np.linalg.inv(normal) * np.outer(self.spread, self.spread)
        return out

    def influence(self, equations: Linearised, values: Array) -> Array:
        """Return the derivatives (p, rows) of the values by the whitened readings; 0 for parameters that are zero."""
        on = np.flatnonzero((values[self.columns] != 0.0) | self.signed)
        normal, _ = self._normal(equations)
        rows = equations.design[:, self.columns[on]] * self.spread[on] * (equations.weight / self.noise)[:, None]
        out = np.zeros((self.size, len(equations.target)))
        out[self.columns[on]] = self.spread[on, None] * np.linalg.solve(normal[np.ix_(on, on)], rows.T)
        return out

    def degrees_of_freedom(self, equations: Linearised, values: Array) -> float:
        """Return the effective number of parameters: tr(1 − (DᵀD/φ + S⁻²)⁻¹S⁻²) over those that are not zero."""
        on = np.flatnonzero((values[self.columns] != 0.0) | self.signed)
        normal, _ = self._normal(equations)
        return float(len(on) - np.trace(np.linalg.inv(normal[np.ix_(on, on)])))

    def _normal(self, equations: Linearised, without: Ints | None = None) -> tuple[Array, Array]:
        """Return the normal equations (n, n), (n,) for the values divided by their prior standard deviation."""
        square, right, _ = equations.normal(self.columns, without)
        normal = square * np.outer(self.spread, self.spread) / self.noise + np.eye(len(self.columns))
        return normal, right * self.spread / self.noise + self.mean / self.spread


def learn(equations: Linearised, prior: Prior, columns: Ints) -> Regression:
    """Return the regression whose prior widths and noise factor maximise the evidence.

    :param columns: (n,) indices of the parameters to use, among those of the equations.
    """
    from scipy.optimize import minimize

    size, mean = prior.size[columns], prior.mean[columns]
    kinds = [name for index, name in enumerate(prior.kinds) if (prior.kind[columns] == index).any()]
    members = [np.flatnonzero(prior.kind[columns] == prior.kinds.index(name)) for name in kinds]
    square, right, own = equations.normal(columns)
    own = own - 2.0 * float(mean @ right) + float(mean @ square @ mean)
    right = (right - square @ mean) * size
    square = square * np.outer(size, size)
    count = equations.count
    middle = np.array([*(FACTORS[name][0] for name in kinds), 0.0])
    wide = np.array([*(FACTORS[name][1] for name in kinds), _NOISE_SPREAD])

    def factors(logs: Array) -> Array:
        factor = np.ones(len(columns))
        for log, rows in zip(logs, members, strict=False):
            factor[rows] = np.exp(log)
        return factor

    def cost(logs: Array) -> tuple[float, Array]:
        """Return −log evidence, up to a constant, and its derivatives by the logarithms of factors and φ."""
        factor, noise = factors(logs), float(np.exp(logs[-1]))
        normal = np.eye(len(columns)) + factor[:, None] * square * factor / noise
        lower = np.linalg.cholesky(normal)
        inverse = np.linalg.inv(normal)
        found = inverse @ (factor * right) / noise
        left = own - 2.0 * float(factor * found @ right) + float((factor * found) @ square @ (factor * found))
        value = 0.5 * (left / noise + found @ found + count * logs[-1]) + float(np.log(np.diag(lower)).sum())
        known = 1.0 - np.diag(inverse)
        slope = [float((known[rows] - found[rows] ** 2).sum()) for rows in members]
        slope.append(0.5 * (count - float(known.sum())) - 0.5 * left / noise)
        off = (logs - middle) / wide
        return value + 0.5 * float(off @ off), np.array(slope) + off / wide

    limits = [*([(_NARROWEST, _WIDEST)] * len(kinds)), (0.0, _MOST_NOISE)]
    found = minimize(cost, middle, jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": 200})
    return Regression(
        columns=columns,
        mean=mean,
        spread=size * factors(found.x),
        signed=prior.signed[columns],
        noise=float(np.exp(found.x[-1])),
        evidence=0.5 * float(np.log(equations.weight).sum()) - float(found.fun),
        size=len(prior.size),
    )
