"""Real robots: which springs the data support, by cross-validation over nested structures.

From simple to rich: joint springs; compensator; springs of the links in six directions; gears that stiffen with the
load, or with load and weights together; springs where links end and under the base. Rich structures are fitted with all
compliances non-negative and a slight ridge. Every structure predicts configurations it was not fitted to; the simplest
one within one standard error of the best is taken (Breiman et al. 1984), and none that predicts worse than a simpler.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from postproc.errors import PostprocError
from postproc.frames import Array
from postproc.identification.elastic import JOINT_NAMES, PRELOAD, STIFFNESS, Structure
from postproc.identification.fit import Fit, covariance_of, gauss_newton, solve
from postproc.identification.measurements import Measurements
from postproc.identification.observability import is_physical, joint_torques, levels_of, untouched
from postproc.identification.placement import Placement
from postproc.robot import BASE, JOINTS, LINK_AXES, RobotModel

_FOLDS = 10
_RIDGES = (0.001, 0.003, 0.01, 0.03)
_TORQUE_STEPS = (0.2, 0.6, 2.0)


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


def link_names(robot: RobotModel, rich: bool) -> list[str]:
    """Return the springs of links that are told from the joints'; `rich`: also where links end, and under the base."""
    links = (BASE, *JOINTS) if rich else JOINTS
    return [
        name
        for link in links
        for axis in LINK_AXES
        if (name := f"{link}.{axis}") not in _along(robot) and (rich or not axis.startswith("end_"))
    ]


def _along(robot: RobotModel) -> set[str]:
    """Return the rotations about joint axes of this robot; for axes along X, Y or Z of the joint frames."""
    found = set()
    for index, joint in enumerate(JOINTS):
        here = robot.nominal.axis[index]
        before = robot.nominal.placement[index, :3, :3] @ here
        found.add(f"{joint}.R{'XYZ'[int(np.argmax(np.abs(here)))]}")
        previous = (BASE, *JOINTS)[index]
        found.add(f"{previous}.end_R{'XYZ'[int(np.argmax(np.abs(before)))]}")
    return found


def gear_names(robot: RobotModel, data: Measurements, joints: Sequence[str] = JOINT_NAMES) -> list[str]:
    """Return the fading parts of the gears, at a fifth to twice the largest torque measured on the joint."""
    largest = np.abs(joint_torques(robot, data)).max(axis=0)
    return [
        f"{name}@{float(f'{step * torque:.2g}'):g}"
        for name, torque in zip(JOINT_NAMES, largest, strict=True)
        for step in _TORQUE_STEPS
        if name in joints and torque > 1.0
    ]


def candidates(robot: RobotModel, data: Measurements) -> list[tuple[str, Structure]]:
    """Return the nested structures, simple to rich."""
    idle = untouched(robot, data)
    joints = [name for name in JOINT_NAMES if name not in idle]
    spring = [STIFFNESS, PRELOAD] if robot.compensator is not None and levels_of(data).max() >= 2 else []
    links, gears = link_names(robot, rich=False), gear_names(robot, data, joints)
    rich = link_names(robot, rich=True)
    # where the geometry is a weightless robot's, the gears feel weights and compensator as they feel a load
    rest = robot.subtract_reference and (robot.has_weight or bool(spring))
    found = [("joint springs", Structure(tuple(joints), robot))]
    if spring:
        found.append(("joint springs, compensator", Structure((*joints, *spring), robot)))
    found.append(("joint springs, gears stiffen", Structure((*joints, *gears), robot)))
    found.append(("springs of links", Structure((*joints, *links), robot)))
    if spring:
        found.append(("springs of links, compensator", Structure((*joints, *links, *spring), robot)))
    found.append(("springs of links, gears stiffen", Structure((*joints, *links, *gears), robot)))
    if rest:
        found.append(
            (
                "springs of links, gears stiffen with load and weights",
                Structure((*joints, *links, *gears), robot, in_gears=True),
            )
        )
    if spring:
        found.append(
            ("springs of links, compensator, gears stiffen", Structure((*joints, *links, *gears, *spring), robot))
        )
    found.append(("springs of links, their ends and the base", Structure((*joints, *rich), robot)))
    if rest:
        found.append(
            (
                "springs of links, their ends and the base, gears stiffen with load and weights",
                Structure((*joints, *rich, *gears), robot, in_gears=True),
            )
        )
    return found


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
    free = {*JOINT_NAMES, STIFFNESS, PRELOAD}
    if set(structure.names) <= free:
        fit = gauss_newton(structure, data, placement)
        return fit, held_out_errors(fit, data, None)
    regularised = np.array([name not in free for name in structure.names])
    rough = gauss_newton(structure, data, placement, ridge=np.zeros(len(structure.names)), iterations=1)
    norm = np.linalg.norm(rough.design, axis=0) * regularised
    errors = [held_out_errors(rough, data, strength * norm) for strength in _RIDGES]
    best = int(np.argmin([error.mean() for error in errors]))
    ridge = _RIDGES[best] * norm
    fit = gauss_newton(structure, data, placement, start=rough.values, ridge=ridge, iterations=5)
    active = fit.values > 0.0
    covariance = np.zeros((len(active), len(active)))
    covariance[np.ix_(active, active)] = covariance_of(
        fit.design[:, active], structure.typical()[active], ridge[active]
    )
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
