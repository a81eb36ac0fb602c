"""The readings as linear equations in the parameters: fits to all configurations or all but some, without new models.

The model is linear in its parameters to 0.3 %, so that what configurations left out would change is told by the
derivatives at one point.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from msgspec import Struct

from postproc.errors import PostprocError
from postproc.frames import Array
from postproc.identification.displacements import measured_displacements, visible, whiten, whitening
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement
from postproc.identification.prediction import predict
from postproc.identification.structure import Structure
from postproc.program import Ints

_HUBER = 3.5
"""Length of a residual of a point, in those usual, from which on it counts less (Huber 1964)."""
_SOFT = 1e-4
"""Ridge, over the effect of one parameter, that keeps what imitates a parameter small."""
_MEDIAN_OF_THREE = 1.538
"""Median length of a vector of three standard normal numbers."""


class Linearised(Struct, frozen=True, eq=False, dict=True):
    """Whitened equations design·p = target.

    :param design: (rows, p), rows are states, points, axes.
    :param target: (rows,).
    :param stated: (p,) values about which p is told; and `spread` (p,), standard deviations, of what is stated of them.
    :param config: (rows,) row of the configuration of each.
    :param weight: (rows,) of each in the sum of squares; less than one for gross residuals.
    """

    design: Array
    target: Array
    stated: Array
    spread: Array
    config: Ints
    weight: Array

    @cached_property
    def scale(self) -> Array:
        """Length (p,) of the columns: effect of a unit of each parameter on all readings, in σ."""
        length = np.linalg.norm(self.design, axis=0)
        return np.where(length > 0.0, length, 1.0)

    @cached_property
    def firm(self) -> Array:
        """Weights (p,) of what is stated of the scaled parameters; zero where nothing is."""
        return np.asarray(1.0 / (self.spread * self.scale))

    def values(self, scaled: Array) -> Array:
        """Return parameters (p,), SI, of scaled ones, which are zero at what is stated."""
        return np.asarray(self.stated + scaled / self.scale)

    @cached_property
    def _by_config(self) -> tuple[Array, Array]:
        rows = self.design / self.scale
        weighted = rows * self.weight[:, None]
        here = [self.config == index for index in range(int(self.config.max()) + 1)]
        return np.array([weighted[r].T @ rows[r] for r in here]), np.array(
            [weighted[r].T @ self.target[r] for r in here]
        )

    @cached_property
    def _whole(self) -> tuple[Array, Array]:
        square, right = self._by_config
        return square.sum(axis=0), right.sum(axis=0)

    def normal(self, columns: Ints, ridge: Array) -> Array:
        """Return the normal matrix of some columns, scaled, with a ridge (p,) in units of 1/σ of their effect."""
        square = self._whole[0]
        jitter = 1e-10 * np.trace(square) / len(square)
        own = ridge[columns] ** 2 + self.firm[columns] ** 2 + jitter
        return np.asarray(square[np.ix_(columns, columns)] + np.diag(own))

    def solve(self, columns: Ints, ridge: Array, without: Ints | None = None) -> Array:
        """Return the scaled parameters (p,), zero but for some columns, that fit all or most configurations.

        Non-negative least squares (Lawson and Hanson 1974) on the normal equations. What something is stated of may
        move to either side of that: such columns come first, and are eliminated by the triangle of Cholesky.

        :param ridge: (p,).
        :param without: configurations left out.
        """
        from scipy.optimize import nnls

        either = self.firm[columns] > 0.0
        columns, free = np.concatenate([columns[either], columns[~either]]), np.count_nonzero(either)
        normal, right = self.normal(columns, ridge), self._whole[1]
        if without is not None:
            square_out, right_out = (each[without].sum(axis=0) for each in self._by_config)
            normal, right = normal - square_out[np.ix_(columns, columns)], right - right_out
        factor = np.linalg.cholesky(normal)
        left = np.linalg.solve(factor, right[columns])
        found, _ = nnls(factor.T[free:, free:], left[free:], maxiter=50 * len(columns))
        values = np.zeros(len(ridge))
        values[columns[free:]] = found
        values[columns[:free]] = np.linalg.solve(factor.T[:free, :free], left[:free] - factor.T[:free, free:] @ found)
        return values

    def slope(self, values: Array, ridge: Array) -> Array:
        """Return half the derivatives (p,) of the squares and the ridge by scaled parameters."""
        square, right = self._whole
        return np.asarray(square @ values - right + (ridge**2 + self.firm**2) * values)

    def worth(self, columns: Ints, ridge: Array) -> float:
        """Return the effective degrees of freedom of a fit: tr (DᵀD + R²)⁻¹DᵀD of the parameters that are not zero."""
        on = np.flatnonzero(self.solve(columns, ridge) != 0.0)
        return float(np.trace(np.linalg.solve(self.normal(on, ridge), self._whole[0][np.ix_(on, on)])))

    def projection(self, columns: Ints) -> Array:
        """Return (kept, p) what scaled parameters do, told by some of them alone: the others by what imitates them."""
        square = self._whole[0]
        kept = square[np.ix_(columns, columns)] + _SOFT * np.eye(len(columns))
        out = np.linalg.solve(kept, square[columns])
        out[:, columns] = np.eye(len(columns))
        return np.asarray(out)

    def left(self, values: Array, rows: Array | slice = slice(None)) -> Array:
        """Return target less what scaled parameters give, for some rows."""
        return np.asarray(self.target[rows] - (self.design[rows] / self.scale) @ values)

    def left_out(self, columns: Ints, ridge: Array, fold: Ints) -> Array:
        """Return what is left (rows,) of each configuration by fits to those of other folds; `fold` (C,)."""
        out = np.empty(len(self.target))
        for index in np.unique(fold):
            test = fold[self.config] == index
            out[test] = self.left(self.solve(columns, ridge, np.flatnonzero(fold == index)), test)
        return out

    def by_config(self, left: Array) -> Array:
        """Return the weighted mean squares (C,) of residuals (rows,) of each configuration."""
        count = np.bincount(self.config)
        return np.asarray(np.bincount(self.config, weights=self.weight * left**2) / count)


def linearise(structure: Structure, values: Array, data: Measurements, placement: Placement) -> Linearised:
    """Return the equations at some values of the parameters; gross residuals there count less."""
    displacement, w = measured_displacements(data, placement), whitening(data)
    moved, slopes = predict(structure, values, data, placement)
    if not np.isfinite(slopes).all():
        raise PostprocError("these springs have no equilibrium under the loads measured")
    design = whiten(w, slopes).reshape(-1, len(values))
    white = whiten(w, (displacement - moved) * visible(data))
    size = np.linalg.norm(white, axis=2)
    usual = float(np.median(size[size > 0.0])) / _MEDIAN_OF_THREE if np.any(size > 0.0) else 1.0
    weight = np.minimum(1.0, _HUBER * max(usual, 1e-12) / np.maximum(size, 1e-300))
    rows = np.repeat(data.state_config[data.loaded], 3 * len(data.points))
    stated, spread = structure.stated
    target = white.ravel() + design @ (values - stated)
    return Linearised(design, target, stated, spread, rows, np.repeat(weight.ravel(), 3))
