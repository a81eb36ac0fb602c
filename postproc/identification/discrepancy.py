"""How far a fit is off on configurations that it has not seen, in millimetres, by load level: noise taken out.

What a model does not know (backlash, friction, a knee where it has none) shows in configurations left out as an error
beyond what noise and the uncertainty of the parameters make expect. It is a level with its own spread, and is added to
the bound as such. What is looked at is the middle of the points: what the model is off by is common to them, noise is
not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postproc.frames import Array, norm
from postproc.identification.displacements import unwhiten, visible, whitening
from postproc.identification.fit import LENGTH_95, Fit
from postproc.identification.measurements import Measurements
from postproc.program import Ints

_SAME_LEVEL = 1.25
"""Loads of which each is less than this times the one before make one level."""
_WRONG, _WRONG_IF_EXPLAINED = 2.0, 3.29
"""Standard errors of the mean of squares beyond which, at any level, the model is clearly off.

Where springs in proportion to the torque explain the readings, noise would pass for an error much larger than theirs.
"""
_AT_MOST, _CERTAIN = 1.0, 0.5
"""Standard errors: so many more it may be where it is clearly off; below so many nothing is said to be left else."""
_CLEAR_SCATTER = 30
"""Degrees of freedom from which on the scatter of the repeats tells their noise better than what is stated."""


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancy:
    """What a fit leaves on configurations left out, at m load levels.

    :param load: (m,) force [N] and moment [N·m] in one.
    :param held_out: (m,) RMS distance of the middle of the points as it is [m].
    :param noise: (m,) RMS of the noise in it [m].
    :param own: (m,) RMS of what the uncertainty of the parameters makes expect [m].
    :param u95: (m,) what 95 % of the rest are below [m].
    """

    load: Array
    held_out: Array
    noise: Array
    own: Array
    u95: Array


def discrepancy(data: Measurements, fit: Fit, left_out: Array, explained: bool) -> Discrepancy:
    """Return what is left beyond noise and the fit's own covariance.

    :param explained: springs in proportion to the torque explain the readings.
    :param left_out: (L, P, 3) measured − predicted, each by a fit without its configuration [m].
    """
    seen = visible(data)[..., 0]
    count = seen.sum(axis=1)
    share = seen / np.maximum(count, 1.0)[:, None]
    error = np.sum(np.einsum("lp,lpi->li", share, left_out) ** 2, axis=1)
    noise = np.sum(share**2 * noise_of(data), axis=1)
    own = _own(data, fit, share)
    level = levels(norm(data.wrench[data.loaded]))
    at_level = [np.flatnonzero((level == index) & (count > 0)) for index in range(int(level.max()) + 1)]
    at_level = [rows for rows in at_level if len(rows) > 0]
    load = np.array([np.median(norm(data.wrench[data.loaded[rows]])) for rows in at_level])
    squares = np.array([[values[rows].mean() for rows in at_level] for values in (error, noise, own)])
    excess = squares[0] - squares[1] - squares[2]
    doubt = np.array([_standard_error(error[rows] - noise[rows] - own[rows]) for rows in at_level])
    if (excess > (_WRONG_IF_EXPLAINED if explained else _WRONG) * doubt).any():
        left = excess + _AT_MOST * doubt
    else:
        left = np.zeros_like(excess) if explained else excess - _CERTAIN * doubt
    held_out, of_noise, of_own = np.sqrt(squares)
    return Discrepancy(load, held_out, of_noise, of_own, LENGTH_95 * np.sqrt(np.maximum(left, 0.0)))


def _standard_error(values: Array) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def levels(load: Array) -> Ints:
    """Return the level (L,), from 0 up, of loads (L,)."""
    order = np.argsort(load)
    step = np.diff(load[order]) > (_SAME_LEVEL - 1.0) * load[order][:-1]
    out = np.empty(len(load), dtype=np.int64)
    out[order] = np.concatenate([[0], np.cumsum(step)])
    return out


def noise_of(data: Measurements) -> Array:
    """Return the mean square (L, P) of the noise of displacements in space [m²]: that of the repeats, if they tell."""
    squares, dof = data.scatter()
    sigma2 = squares / dof if dof >= _CLEAR_SCATTER else data.sigma**2
    count = np.maximum(data.means()[1], 1.0)
    rest = data.unloaded[data.state_config[data.loaded]]
    return np.asarray(3.0 * sigma2 * (1.0 / count[data.loaded] + 1.0 / count[rest]))


def _own(data: Measurements, fit: Fit, share: Array) -> Array:
    """Return the mean square (L,) that the covariance makes expect of the middle of the points, shares (L, P) [m²]."""
    shape = (len(data.loaded), len(data.points), 3, len(fit.values))
    slopes = np.einsum("lp,lpia->lia", share, unwhiten(whitening(data), fit.design.reshape(shape)))
    covariance = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)
    return np.asarray(np.einsum("lia,ab,lib->l", slopes, covariance, slopes, optimize=True))


def left_out_of(fit: Fit, data: Measurements) -> Array:
    """Return (L, P, 3) what a plain least-squares fit leaves of each configuration when it is left out [m].

    By the derivatives at the fit: (I − H)⁻¹ times the residual of a configuration, H its part of the hat matrix.
    """
    shape = (len(data.loaded), len(data.points), 3)
    scale = np.linalg.norm(fit.design, axis=0)
    rows = fit.design / np.where(scale > 0.0, scale, 1.0)
    inverse = np.linalg.pinv(rows.T @ rows, hermitian=True)
    left = fit.target - fit.design @ fit.values
    config = np.repeat(data.state_config[data.loaded], 3 * len(data.points))
    out = np.empty_like(left)
    for index in range(len(data.q)):
        mine = config == index
        hat = rows[mine] @ inverse @ rows[mine].T
        out[mine] = np.linalg.solve(np.eye(len(hat)) - hat * (1.0 - 1e-9), left[mine])
    return unwhiten(whitening(data), out.reshape(shape))
