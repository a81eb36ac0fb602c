"""The readings as linear equations in the parameters, so that fits to all but some configurations need no new models.

The model is linear in its parameters to 0.3 %: the derivatives at one point say what changes without a configuration.
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
"""Residual of a point, over the usual one, beyond which it is weighted down (Huber 1964)."""
_MEDIAN_OF_THREE = 1.538
"""Median length of a vector of three standard normal numbers."""


class Linearised(Struct, frozen=True, eq=False, dict=True):
    """Whitened equations design·values = target.

    :param design: (rows, p), per SI unit of each parameter; rows are states, points, axes.
    :param target: (rows,).
    :param config: (rows,) row of the configuration of each.
    :param weight: (rows,) of each in the sum of squares; less than one for gross residuals.
    """

    design: Array
    target: Array
    config: Ints
    weight: Array

    @property
    def configs(self) -> int:
        """Number of configurations."""
        return int(self.config.max()) + 1

    @cached_property
    def count(self) -> int:
        """Number of equations that hold a reading."""
        return int(np.count_nonzero(np.linalg.norm(self.design, axis=1) > 0.0))

    @cached_property
    def by_configuration(self) -> tuple[Array, Array, Array]:
        """DᵀWD (C, p, p), DᵀWy (C, p) and yᵀWy (C,) of the equations of each configuration."""
        weighted = self.design * self.weight[:, None]
        here = [self.config == index for index in range(self.configs)]
        return (
            np.array([weighted[rows].T @ self.design[rows] for rows in here]),
            np.array([weighted[rows].T @ self.target[rows] for rows in here]),
            np.array([float(self.weight[rows] @ self.target[rows] ** 2) for rows in here]),
        )

    def normal(self, columns: Ints, without: Ints | None = None) -> tuple[Array, Array, float]:
        """Return DᵀWD (n, n), DᵀWy (n,) and yᵀWy of some columns.

        :param without: configurations to leave out.
        """
        square, right, own = self._whole
        if without is not None:
            out = [part[without].sum(axis=0) for part in self.by_configuration]
            square, right, own = square - out[0], right - out[1], own - float(out[2])
        return square[np.ix_(columns, columns)], right[columns], own

    @cached_property
    def _whole(self) -> tuple[Array, Array, float]:
        square, right, own = self.by_configuration
        return square.sum(axis=0), right.sum(axis=0), float(own.sum())

    def residual(self, values: Array, rows: Array | slice = slice(None)) -> Array:
        """Return target − design·values of some rows."""
        return np.asarray(self.target[rows] - self.design[rows] @ values)

    def mean_squares(self, residual: Array) -> Array:
        """Return the weighted mean squares (C,) of residuals (rows,) of each configuration."""
        count = np.bincount(self.config)
        return np.asarray(np.bincount(self.config, weights=self.weight * residual**2) / count)


def linearise(structure: Structure, values: Array, data: Measurements, placement: Placement) -> Linearised:
    """Return the equations at some values of the parameters; gross residuals there are weighted down.

    :raises PostprocError: the springs have no equilibrium under a measured load.
    """
    displacement, w = measured_displacements(data, placement), whitening(data)
    moved, slopes = predict(structure, values, data, placement)
    finite = np.isfinite(slopes).all(axis=(1, 2, 3)) & np.isfinite(moved).all(axis=(1, 2))
    if not finite.all():
        state = int(data.loaded[np.argmin(finite)])
        raise PostprocError(
            f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}: these springs have no "
            "equilibrium under this load"
        )
    design = whiten(w, slopes).reshape(-1, len(values))
    white = whiten(w, (displacement - moved) * visible(data))
    size = np.linalg.norm(white, axis=2)
    usual = float(np.median(size[size > 0.0])) / _MEDIAN_OF_THREE if np.any(size > 0.0) else 1.0
    weight = np.minimum(1.0, _HUBER * max(usual, 1e-12) / np.maximum(size, 1e-300))
    seen = np.repeat((visible(data)[..., 0] > 0.0).ravel(), 3)
    rows = np.repeat(data.state_config[data.loaded], 3 * len(data.points))
    design = design * seen[:, None]
    return Linearised(design, white.ravel() + design @ values, rows, np.repeat(weight.ravel(), 3))
