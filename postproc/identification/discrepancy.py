"""How far a fit is off on configurations that it has not seen, in millimetres, by load level: noise taken out.

What a model does not know (backlash, friction, a knee where it has none) shows in configurations left out as an error
beyond what noise and the uncertainty of the parameters make expect: the error e of a point is normal with a covariance
V + δ²·I, V being that of noise and parameters there. How large δ is, the errors tell: each configuration counts by how
little else blurs it, so that one whose parameters are open hides nothing of the others. As few configurations tell
little of δ, what is stated is not its likeliest value but one standard deviation more: 84 % of its distribution, with
nothing assumed of δ before (flat: Gelman, Bayesian Analysis 1, 2006). It is a level with its own spread, and is added
to the bound as such.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array, norm
from postproc.identification.displacements import unwhiten, visible, whitening
from postproc.identification.fit import LENGTH_95, Fit
from postproc.identification.measurements import Measurements
from postproc.program import Ints

_SAME_LEVEL = 1.25
"""Loads of which each is less than this times the one before make one level."""
_CLEAR = 3.29**2
"""Twice the logarithm of likelihoods beyond which, at any level, the model is clearly off (one in a thousand).

Where springs in proportion to the torque explain the readings, noise would pass for an error much larger than theirs.
"""
_ONE_SIGMA_ABOVE = 0.8413
"""Share of a normal distribution below one standard deviation above its middle."""
_STEPS, _SPAN = 400, 3.0
"""Values of δ that are looked at, up to so many times the RMS of the errors."""
_CLEAR_SCATTER = 30
"""Degrees of freedom from which on the scatter of the repeats tells their noise better than what is stated."""


class Discrepancy(Struct, frozen=True, eq=False):
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
    seen = visible(data)[..., 0] > 0.0
    count = seen.sum(axis=1)
    share = seen / np.maximum(count, 1)[:, None]
    slopes = unwhiten(whitening(data), fit.design.reshape((*left_out.shape, len(fit.values))))
    covariance = np.where(np.isfinite(fit.covariance), fit.covariance, 0.0)
    noise = noise_of(data)
    own = slopes @ covariance @ np.swapaxes(slopes, 2, 3)
    middle = np.einsum("lp,lpia->lia", share, slopes)
    squares = np.array(
        [
            np.sum(np.einsum("lp,lpi->li", share, left_out) ** 2, axis=1),
            np.sum(share**2 * noise, axis=1),
            np.trace(middle @ covariance @ np.swapaxes(middle, 1, 2), axis1=1, axis2=2),
        ]
    )
    blur = own + noise[..., None, None] / 3.0 * np.eye(3)
    level = levels(norm(data.wrench[data.loaded]))
    at_level = [np.flatnonzero((level == index) & (count > 0)) for index in range(int(level.max()) + 1)]
    at_level = [rows for rows in at_level if len(rows) > 0]
    load = np.array([np.median(norm(data.wrench[data.loaded[rows]])) for rows in at_level])
    told = []
    for rows in at_level:
        point = seen[rows]
        told.append(_beyond(left_out[rows][point], blur[rows][point], np.repeat(1.0 / count[rows], count[rows])))
    clear = max(gain for _, gain in told) > _CLEAR
    # what is off under a load is off under a larger one too
    sigma = np.maximum.accumulate([one for one, _ in told]) if clear or not explained else np.zeros(len(told))
    held_out, of_noise, of_own = np.sqrt([[values[rows].mean() for rows in at_level] for values in squares])
    return Discrepancy(load, held_out, of_noise, of_own, LENGTH_95 * np.sqrt(3.0) * sigma)


def _beyond(error: Array, blur: Array, weight: Array) -> tuple[float, float]:
    """Return δ [m] of errors (n, 3), one standard deviation above, and twice the gain in log likelihood over δ = 0.

    :param blur: (n, 3, 3) covariance of an error but for δ.
    :param weight: (n,) of each: points of one state have their errors in common.
    """
    spread, axes = np.linalg.eigh(blur)
    along = np.einsum("nij,ni->nj", axes, error) ** 2
    delta = np.linspace(0.0, _SPAN * max(float(np.sqrt(np.mean(error**2))), 1e-9), _STEPS)
    whole = spread + delta[:, None, None] ** 2
    likely = -0.5 * np.sum((np.log(whole) + along / whole).sum(axis=2) * weight, axis=1)
    chance = np.cumsum(np.exp(likely - likely.max()))
    above = float(np.interp(_ONE_SIGMA_ABOVE, chance / chance[-1], delta))
    return above, float(2.0 * (likely.max() - likely[0]))


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
