"""Unmodelled error of a fit, by load level: cross-validation errors with noise and parameter uncertainty taken out.

What a model does not describe (friction, a breakpoint it does not have) shows on configurations left out, as an error
beyond what noise and the uncertainty of the parameters make expect. The error of a point is normal with a covariance
V + δ²·1, V that of noise and parameters. How large δ is, the errors say, each configuration weighted by how little
else blurs it. Before any reading δ is log-normal about half a thousandth of the displacements at its level, and one
standard deviation is a factor of 4.5; so it is never zero, and few configurations leave it wide. Stated is what 95 % of
the errors are below, δ being as uncertain as it is: a smooth function of the readings, without a threshold.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array, norm
from postproc.identification.displacements import measured_displacements, unwhiten, visible, whitening
from postproc.identification.fit import Fit
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement
from postproc.program import Ints

_SAME_LEVEL = 1.25
"""Loads of which each is less than this times the one before make one level."""
_SHARE = 0.0005
"""Median of δ over the displacements (RMS of a component) before any reading."""
_WIDTH = 1.5
"""Standard deviation of the logarithm of δ before any reading."""
_STEPS, _SPAN = 241, (-5.0, 4.5)
"""Values of δ that are tried, and between which standard deviations of its prior."""
_CLEAR_SCATTER = 30
"""Degrees of freedom from which the scatter of the repeats replaces the stated noise."""


class Discrepancy(Struct, frozen=True, eq=False):
    """Cross-validation errors at m load levels.

    :param load: (m,) force [N] and moment [N·m] in one.
    :param held_out: (m,) RMS distance of the mean of the points from its prediction [m].
    :param noise: (m,) RMS of the noise in it [m].
    :param own: (m,) RMS that the uncertainty of the parameters makes expect [m].
    :param u95: (m,) bound of 95 % on the unmodelled error [m].
    """

    load: Array
    held_out: Array
    noise: Array
    own: Array
    u95: Array


def discrepancy(data: Measurements, placement: Placement, fit: Fit, left_out: Array) -> Discrepancy:
    """Return the unmodelled error beyond noise and the fit's own covariance.

    :param left_out: (L, P, 3) measured − predicted, each by a fit without its configuration [m].
    """
    seen = visible(data)[..., 0] > 0.0
    count = seen.sum(axis=1)
    share = seen / np.maximum(count, 1)[:, None]
    slopes = unwhiten(whitening(data), fit.design.reshape((*left_out.shape, len(fit.values))))
    noise = noise_of(data)
    own = slopes @ fit.covariance @ np.swapaxes(slopes, 2, 3)
    middle = np.einsum("lp,lpia->lia", share, slopes)
    squares = np.array(
        [
            np.sum(np.einsum("lp,lpi->li", share, left_out) ** 2, axis=1),
            np.sum(share**2 * noise, axis=1),
            np.trace(middle @ fit.covariance @ np.swapaxes(middle, 1, 2), axis1=1, axis2=2),
        ]
    )
    blur = own + noise[..., None, None] / 3.0 * np.eye(3)
    moved = measured_displacements(data, placement)
    level = levels(norm(data.wrench[data.loaded]))
    at_level = [np.flatnonzero((level == index) & (count > 0)) for index in range(int(level.max()) + 1)]
    at_level = [rows for rows in at_level if len(rows) > 0]
    load = np.array([np.median(norm(data.wrench[data.loaded[rows]])) for rows in at_level])
    u95 = [
        unmodelled(
            left_out[rows][seen[rows]],
            blur[rows][seen[rows]],
            np.repeat(1.0 / count[rows], count[rows]),
            _SHARE * float(np.sqrt(np.mean(moved[rows][seen[rows]] ** 2))),
        )
        for rows in at_level
    ]
    held_out, of_noise, of_own = np.sqrt([[values[rows].mean() for rows in at_level] for values in squares])
    # an error under a load is there under a larger one too
    return Discrepancy(load, held_out, of_noise, of_own, np.maximum.accumulate(u95))


def unmodelled(error: Array, blur: Array, weight: Array, median: float) -> float:
    """Return what 95 % of the lengths of unmodelled errors are below [m].

    :param error: (n, 3) errors [m].
    :param blur: (n, 3, 3) their covariance but for δ [m²].
    :param weight: (n,) of each: points of one state share their errors.
    :param median: of δ before any reading [m].
    """
    from scipy.special import gammainc

    spread, axes = np.linalg.eigh(blur)
    along = np.einsum("nij,ni->nj", axes, error) ** 2
    off = np.linspace(*_SPAN, _STEPS)
    delta = max(median, 1e-9) * np.exp(_WIDTH * off)
    whole = spread + delta[:, None, None] ** 2
    likely = -0.5 * np.sum((np.log(whole) + along / whole).sum(axis=2) * weight, axis=1) - 0.5 * off**2
    chance = np.exp(likely - likely.max())
    chance /= chance.sum()
    length = np.geomspace(delta[0], 4.0 * delta[-1], 2000)
    below = gammainc(1.5, 0.5 * (length[:, None] / delta) ** 2) @ chance  # χ² of three degrees of freedom
    return float(np.interp(0.95, below, length))


def levels(load: Array) -> Ints:
    """Return the level (L,), from 0 up, of loads (L,)."""
    order = np.argsort(load)
    step = np.diff(load[order]) > (_SAME_LEVEL - 1.0) * load[order][:-1]
    out = np.empty(len(load), dtype=np.int64)
    out[order] = np.concatenate([[0], np.cumsum(step)])
    return out


def noise_of(data: Measurements) -> Array:
    """Return the mean square (L, P) of the noise of displacements in space [m²]: of the repeats, if there are many."""
    squares, dof = data.scatter()
    sigma2 = squares / dof if dof >= _CLEAR_SCATTER else data.sigma**2
    count = np.maximum(data.means()[1], 1.0)
    rest = data.unloaded[data.state_config[data.loaded]]
    return np.asarray(3.0 * sigma2 * (1.0 / count[data.loaded] + 1.0 / count[rest]))


def left_out_of(fit: Fit, data: Measurements) -> Array:
    """Return the residuals (L, P, 3) of each configuration when it is left out of a least-squares fit [m].

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
