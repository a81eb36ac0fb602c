"""Plausibility of measured cuts: signs and axes of the forces, units of forces and feeds.

Cutting and edge coefficients of every material are positive along the cut and normal to it. Readings in other axes
give negative ones; the arrangement of Fx and Fy that gives positive ones and fits names the cause. Wrong units show in
sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from postproc.errors import ForceError
from postproc.frames import Array

_POSITIVE = {0: "Ktc", 1: "Krc", 3: "Kte", 4: "Kre"}
"""Index and name of the coefficients that are positive in every material; axial ones may pull the material out."""
_ARRANGEMENTS = {
    (False, 1, -1): (
        "the sign of Fy looks wrong",
        'Fy is to the left of the feed, on the tool: change its sign, or give spindle = "M4" in [tools.N].',
    ),
    (False, -1, 1): ("the sign of Fx looks wrong", "Fx is along the feed, on the tool: change its sign."),
    (False, -1, -1): (
        "they look like forces on the workpiece",
        "Give the forces ON the tool: change the signs of Fx, Fy and Fz.",
    ),
    (True, 1, 1): ("Fx and Fy look exchanged", "Fx is along the feed: exchange the columns Fx and Fy."),
    (True, 1, -1): (
        "their axes look turned by 90°",
        "Fx is along the feed, Fy to its left: give -Fx of this file as Fy, and Fy as Fx.",
    ),
    (True, -1, 1): (
        "their axes look turned by 90°",
        "Fx is along the feed, Fy to its left: give -Fy of this file as Fx, and Fx as Fy.",
    ),
    (True, -1, -1): (
        "Fx and Fy look exchanged, and on the workpiece",
        "Exchange the columns Fx and Fy, and change the signs of Fx, Fy and Fz: Fx is along the feed, on the tool.",
    ),
}
"""Cause and remedy by arrangement: whether Fx and Fy are exchanged, then the signs of the new Fx and Fy."""
_SIGMA_LIMIT = 3.0
"""Standard deviations within which a coefficient may be negative: of five feeds with 5 % noise none is refused then."""
_MOST_RADIAL_RATIO = 2.0
"""Krc over Ktc, the largest `radial_ratio` of a process. Metals have up to 0.6 in the table, CFRP 1."""
_EQUAL_FIT_RATIO = 1.5
"""Ratio of residuals up to which two arrangements fit equally well, as in slots (assumed)."""
_BETTER_FIT_RATIO = 5.0
"""Ratio of residuals from which another arrangement is the right one (assumed)."""
_LEAST_CHIP = 1e-4
"""Largest feed per tooth over the diameter below which it is in another unit. Shops mill with 0.001 to 0.1; of m/min a
thousandth is left (assumed)."""
_LARGEST_COEFFICIENTS = (2e4, 2e3)
"""Coefficients beyond any material [N/mm²], [N/mm] (assumed): hardened steel and nickel alloys are a fifth of that, and
worn tools in titanium have some hundred N/mm at the edge."""
_LEAST_TANGENTIAL, _LIKELY_KILONEWTON = 1.0, 10.0
"""Ktc [N/mm²] below which a material is only light foam, and below which it is foam or steel in kN (assumed)."""
_SMALL_FORCE = 3.0
"""Mean force [N] below which few dynamometers measure, and kN are likelier (assumed)."""
_KILONEWTON_RATIOS = 1e-3 / np.sqrt(10.0), 1e-3 * np.sqrt(10.0)
"""Limits of the ratio of Ktc to that of the process' material if forces are in kN: 0.001, divided and times √10."""
_SAME_MATERIAL = 5.0
"""Ratio of Ktc to that of the process' material up to which they agree (assumed)."""

_KTC, _KRC = 0, 1
"""Indices of two coefficients."""


class Fit(NamedTuple):
    """Coefficients in the order of `identification.NAMES` that fit forces.

    :param value: (6,) coefficients [N/mm²], [N/mm], and `sigma` (6,) their standard deviations.
    :param residual: residual of the forces, as a share of the forces.
    """

    value: Array
    sigma: Array
    residual: float


FitOf = Callable[[Array], Fit | None]
"""Returns the fit to forces (n, 3) [N]; None: these do not determine the coefficients."""
_Arrangement = tuple[bool, int, int]
"""A key of `_ARRANGEMENTS`."""


def check_feeds(chip: Array, diameter: float, file: str) -> None:
    """Refuse feeds in another unit than mm/min.

    :param chip: (n,) feeds per tooth [mm]; `diameter` of the tool [mm].
    :raises ForceError: even the largest is too small for milling.
    """
    if chip.max() < _LEAST_CHIP * diameter:
        raise ForceError(
            f"the largest feed per tooth is {chip.max():.2g} mm, of a tool of {diameter:g} mm: these look like m/min",
            file=file,
            advice="Give feed_mm_per_min in mm/min and rpm in 1/min.",
        )


def check_signs(force: Array, fit_of: FitOf, file: str) -> list[str]:
    """Refuse forces that give coefficients of no material, or that fit far better with Fx and Fy in other axes.

    :param force: (n, 3) as read [N]; NaN = not measured.
    :param fit_of: returns the coefficients that fit forces (n, 3); None if forces do not determine them.
    :returns: a warning if Krc is larger than Ktc; empty if not, or if the forces do not determine the coefficients.
    :raises ForceError: Ktc is not positive, Krc, Kte or Kre is negative beyond its error, or Krc beyond twice Ktc; or
        another arrangement of Fx and Fy fits far better. The message names the likely arrangement.
    """
    fit = fit_of(force)
    if fit is None:
        return []
    candidates = _plausible_arrangements(force, fit_of)
    if not _is_plausible(fit) or any(fit.residual > _BETTER_FIT_RATIO * item.residual for item in candidates.values()):
        raise _arrangement_error(fit, candidates, file)
    value = fit.value
    if value[_KRC] - 1.96 * fit.sigma[_KRC] <= value[_KTC]:
        return []
    return [
        f"Krc {value[_KRC]:.3g} is larger than Ktc {value[_KTC]:.3g}, which few materials have: check the axes "
        "and signs of Fx and Fy, and up and down"
    ]


def _plausible_arrangements(force: Array, fit_of: FitOf) -> dict[_Arrangement, Fit]:
    """Return the arrangements of Fx and Fy that give coefficients which a material may have, with their fits.

    :param force: (n, 3) as read [N].
    :param fit_of: returns the coefficients that fit forces; None if forces do not determine them.
    """
    fits = {}
    for arrangement in _ARRANGEMENTS:
        is_exchanged, x_sign, y_sign = arrangement
        columns = force[:, [1, 0, 2]] if is_exchanged else force
        fit = fit_of(columns * np.array([x_sign, y_sign, 1.0]))
        if fit is not None and _is_plausible(fit):
            fits[arrangement] = fit
    return fits


def _arrangement_error(fit: Fit, candidates: Mapping[_Arrangement, Fit], file: str) -> ForceError:
    """Return the error for forces in wrong axes, with the likely arrangement of Fx and Fy if there is one.

    :param fit: fit to the forces as read.
    :param candidates: other arrangements that give plausible coefficients, with their fits.
    """
    if not candidates:
        return ForceError(
            f"the readings give {_coefficient_text(fit)} N/mm² and N/mm: no material cuts so",
            file=file,
            advice="Fx is along the feed, Fy to its left, both means ON the tool in N. Check mode, ap_mm, ae_mm, the "
            "feeds, and flutes, diameter and spindle of the tool.",
        )
    smallest_residual = min(candidate.residual for candidate in candidates.values())

    def rank(arrangement: _Arrangement) -> tuple[bool, bool]:
        """Return a sort key: arrangements that fit about best come first, of these those with Krc ≤ Ktc."""
        value, _, residual = candidates[arrangement]
        return residual > _EQUAL_FIT_RATIO * smallest_residual, bool(value[_KRC] > value[_KTC])

    likely_arrangement = min(candidates, key=rank)
    cause, advice = _ARRANGEMENTS[likely_arrangement]
    values, likely_values = _coefficient_text(fit), _coefficient_text(candidates[likely_arrangement])
    return ForceError(f"the forces give {values}: {cause} (then {likely_values})", file=file, advice=advice)


def _coefficient_text(fit: Fit) -> str:
    """Return names and values of the coefficients that are positive in every material."""
    return ", ".join(f"{name} {fit.value[k]:.3g}" for k, name in _POSITIVE.items())


def _is_plausible(fit: Fit) -> bool:
    """Return whether a material may have these coefficients.

    Within their errors, none is negative, and Krc is at most twice Ktc.
    """
    value, sigma, _ = fit
    return (
        value[_KTC] > 0.0
        and all(value[k] > -_SIGMA_LIMIT * sigma[k] for k in _POSITIVE)
        and value[_KRC] - _SIGMA_LIMIT * sigma[_KRC] <= _MOST_RADIAL_RATIO * value[_KTC]
    )


def check_sizes(value: Array, force: Array, prior_tangential: float | None, file: str) -> list[str]:
    """Refuse coefficients of a size that no material has, and those from forces in kN; warn if these may be in kN.

    :param value: (6,) coefficients in the order of `identification.NAMES`.
    :param force: (n, 3) as read [N]; NaN = not measured.
    :param prior_tangential: Ktc or kc1.1 of the process' material [N/mm²]; None: it states none.
    :returns: warnings.
    :raises ForceError: a coefficient is too large, or the forces are in kN by their size and Ktc.
    """
    tangential = float(value[_KTC])
    # first the three coefficients of the cut, then those of the edge
    for values, limit, unit in zip((value[:3], value[3:]), _LARGEST_COEFFICIENTS, ("N/mm²", "N/mm"), strict=True):
        if np.abs(values).max() > limit:
            raise ForceError(
                f"the readings give a coefficient of {np.abs(values).max():.2g} {unit}: no material has that",
                file=file,
                advice="Give forces in N, ap_mm and ae_mm in mm, feed_mm_per_min in mm/min.",
            )
    ratio = None if prior_tangential is None else tangential / prior_tangential
    largest_force = float(np.nanmax(np.abs(force), initial=0.0)) if np.isfinite(force).any() else np.inf
    agrees_with_prior = ratio is not None and 1.0 / _SAME_MATERIAL < ratio < _SAME_MATERIAL
    is_small = largest_force < _SMALL_FORCE and tangential < _LIKELY_KILONEWTON and not agrees_with_prior
    least_ratio, largest_ratio = _KILONEWTON_RATIOS
    if is_small and (tangential < _LEAST_TANGENTIAL or (ratio is not None and least_ratio < ratio < largest_ratio)):
        raise ForceError(
            f"the largest force is {largest_force:.2g} N, Ktc {tangential:.2g} N/mm²: the forces look like kN",
            file=file,
            advice="Give Fx, Fy, Fz in N. If a foam is that soft, state it as [material] of the process.",
        )
    return (
        [f"the largest force is {largest_force:.2g} N, Ktc {tangential:.2g} N/mm²: are these kN? Foam is as soft"]
        if is_small
        else []
    )
