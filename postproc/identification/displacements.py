"""What was measured, as the fits take it: displacements loaded − unloaded, and their noise."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement, in_root_axes

_NOTHING = 1e-12
"""Weight of a point whose readings are all left out."""


def measured_displacements(data: Measurements, placement: Placement) -> Array:
    """Return loaded − unloaded mean positions (L, P, 3) [m] in root axes, L loaded states."""
    mean, _ = data.means()
    rest = data.unloaded[data.state_config[data.loaded]]
    return visible(data) * in_root_axes(placement, mean[data.loaded] - mean[rest])


def visible(data: Measurements) -> Array:
    """Return (L, P, 1) one where a loaded point and its unloaded counterpart have readings, zero elsewhere."""
    _, count = data.means()
    rest = data.unloaded[data.state_config[data.loaded]]
    return np.asarray(((count[data.loaded] > 0) & (count[rest] > 0)).astype(float)[..., None])


def whitening(data: Measurements) -> Array:
    """Return (P, L, L) that turns displacements into unit variance: W Σ Wᵀ = I.

    Loads of one configuration share its unloaded reading: Σ = σ²·(1/n_l on the diagonal, 1/n_0 added everywhere).
    """
    count = np.maximum(data.means()[1], _NOTHING)
    loaded, config = data.loaded, data.state_config[data.loaded]
    same = config[:, None] == config[None]
    rest = data.unloaded[config]
    out = np.empty((len(data.points), len(loaded), len(loaded)))
    for point in range(len(data.points)):
        covariance = np.diag(1.0 / count[loaded, point]) + same / count[rest, point][:, None]
        out[point] = np.linalg.inv(np.linalg.cholesky(covariance)) / data.sigma
    return out


def whiten(w: Array, values: Array) -> Array:
    """Apply (P, L, L) to the states of values (L, P, …)."""
    return np.asarray(np.einsum("plm,mp...->lp...", w, values))


def unwhiten(w: Array, values: Array) -> Array:
    """Undo `whiten` for values (L, P, …)."""
    return np.stack(
        [
            np.linalg.solve(w[point], values[:, point].reshape(len(values), -1)).reshape(values[:, point].shape)
            for point in range(values.shape[1])
        ],
        axis=1,
    )
