"""Real robots: which springs the data support, by cross-validation over nested structures (`candidates`).

Rich structures are fitted with all compliances non-negative and a slight ridge. Every structure predicts configurations
it was not fitted to; the simplest one within one standard error of the best is taken (Breiman et al. 1984), and none
that predicts worse than a simpler.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from postproc.errors import PostprocError
from postproc.frames import Array
from postproc.identification.candidates import candidates
from postproc.identification.fit import Fit, covariance_of, gauss_newton, solve
from postproc.identification.measurements import Measurements
from postproc.identification.observability import is_physical
from postproc.identification.placement import Placement
from postproc.identification.structure import Structure
from postproc.robot import RobotModel

_FOLDS = 10
_RIDGES = (0.001, 0.003, 0.01, 0.03)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A structure that was tried.

    :param name: for the user.
    :param parameters: number of parameters.
    :param active: how many of them are not zero.
    :param rms_mm: residual of the fit, RMS distance.
    :param held_out: mean square of the whitened residuals of configurations left out; 1 would be noise alone.
    :param error: standard error of the difference of `held_out` to the best structure.
    :param chosen: the one that was taken.
    """

    name: str
    parameters: int
    active: int
    rms_mm: float
    held_out: float
    error: float
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen fit and why.

    :param fit: with the covariance scaled to what held-out configurations show.
    :param candidates: all structures tried, simple to rich.
    :param reason: one sentence.
    :param held_out: (C,) mean square whitened residual of each configuration when it was left out.
    """

    fit: Fit
    candidates: tuple[Candidate, ...]
    reason: str
    held_out: Array


def choose(robot: RobotModel, data: Measurements, placement: Placement) -> Choice:
    """Fit all structures and take one by leave-configurations-out cross-validation.

    :raises PostprocError: not even joint springs can be fitted.
    """
    tried: list[tuple[str, Fit, Array]] = []
    for name, structure in candidates(robot, data):
        try:
            fit, held_out = _fit(structure, data, placement)
            if is_physical(fit):
                tried.append((name, fit, held_out))
        except PostprocError:
            if not tried:
                raise
    errors = np.array([error for _, _, error in tried])
    best = int(np.argmin(errors.mean(axis=1)))
    difference = errors - errors[best]
    spread = difference.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
    taken = best
    for index in range(len(tried)):
        simpler = errors[:index].mean(axis=1)
        if difference[index].mean() <= spread[index] and np.all(errors[index].mean() <= simpler):
            taken = index
            break
    name, fit, held_out = tried[taken]
    scale = max(1.0, float(held_out.mean()))
    size = fit.values != 0.0
    covariance = np.where(np.outer(size, size), fit.covariance * scale, 0.0)
    fit = Fit(fit.structure, fit.values, covariance, fit.residual, fit.chi2, fit.dof, fit.design, fit.target)
    table = tuple(
        Candidate(
            n,
            len(f.values),
            int(np.count_nonzero(f.values)),
            f.rms * 1e3,
            float(e.mean()),
            float(s),
            index == taken,
        )
        for index, ((n, f, e), s) in enumerate(zip(tried, spread, strict=True))
    )
    reason = (
        f"chosen: {name}: on configurations left out its mean square error is {held_out.mean():.2f} σ² "
        f"(joint springs alone: {errors[0].mean():.2f} σ²)"
    )
    if taken != best:
        reason += (
            f"; the richer '{tried[best][0]}' gains {difference[taken].mean():.2f} ± {spread[taken]:.2f} σ², which is "
            "within one standard error"
        )
    return Choice(fit, table, reason, held_out)


def _fit(structure: Structure, data: Measurements, placement: Placement) -> tuple[Fit, Array]:
    regularised = np.array([parameter.sparse for parameter in structure.parameters])
    if not regularised.any():
        fit = gauss_newton(structure, data, placement)
        return fit, held_out_errors(fit, data, None)
    rough = gauss_newton(structure, data, placement, ridge=np.zeros(len(structure.parameters)), iterations=1)
    norm = np.linalg.norm(rough.design, axis=0) * regularised
    errors = [held_out_errors(rough, data, strength * norm) for strength in _RIDGES]
    best = int(np.argmin([error.mean() for error in errors]))
    ridge = _RIDGES[best] * norm
    fit = gauss_newton(structure, data, placement, start=rough.values, ridge=ridge, iterations=5)
    active = fit.values > 0.0
    covariance = np.zeros((len(active), len(active)))
    covariance[np.ix_(active, active)] = covariance_of(fit.design[:, active], structure.usual()[active], ridge[active])
    fit = Fit(
        structure,
        fit.values,
        covariance,
        fit.residual,
        fit.chi2,
        len(fit.target) - int(active.sum()),
        fit.design,
        fit.target,
    )
    return fit, held_out_errors(fit, data, ridge)


def held_out_errors(fit: Fit, data: Measurements, ridge: Array | None) -> Array:
    """Return (C,) the mean square whitened residual of each configuration, predicted by a fit to the others.

    The model is linear in its parameters to 0.3 %, so the folds use the derivatives at the full fit.
    """
    states = len(data.loaded)
    points = len(data.points)
    config = data.state_config[data.loaded]
    row_config = np.repeat(config, points * 3)
    folds = min(_FOLDS, len(data.q))
    fold = np.random.default_rng(0).permutation(len(data.q)) % folds
    out = np.empty(len(data.q))
    design = fit.design.reshape(states * points * 3, -1)
    for index in range(folds):
        test = fold[row_config] == index
        values = solve(design[~test], fit.target[~test], ridge)
        left = fit.target[test] - design[test] @ values
        for row in np.flatnonzero(fold == index):
            out[row] = np.mean(left[row_config[test] == row] ** 2)
    return out


def summary(table: Sequence[Candidate]) -> list[dict[str, object]]:
    """Return the candidates as plain data."""
    return [
        {
            "structure": c.name,
            "parameters": c.parameters,
            "active": c.active,
            "rms_mm": c.rms_mm,
            "held_out_sigma2": c.held_out,
            "standard_error": c.error,
            "chosen": c.chosen,
        }
        for c in table
    ]
