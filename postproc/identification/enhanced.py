"""Enhanced identification: partial poses, joint 2 per level of q2, compensator from the levels, then all at once.

Source: Klimchik et al., section 3: Eq. (8) gives the extended set k1, k2 per level, k3…k6; Eq. (9), (10) give K⁰_θ2,
K_c and s₀ from the levels. Both are linear in the load; a Gauss–Newton fit to the equilibrium takes out what they
leave.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.compensator import Compensator
from postproc.errors import MeasurementError, PostprocError
from postproc.frames import Array
from postproc.identification.fit import Fit, gauss_newton
from postproc.identification.measurements import Measurements
from postproc.identification.observability import NotObservable, is_physical, levels_of, not_observable
from postproc.identification.placement import Placement
from postproc.identification.structure import LevelCompliance, Structure
from postproc.robot import COMPENSATOR, JOINT_COMPLIANCES, CompensatorStiffness, Parameter, RobotModel

_REFUTED = 13.8
"""Growth of χ² by two parameters fewer that noise makes once in a thousand."""


class Levels(Struct, frozen=True, eq=False):
    """Equivalent compliance of joint 2 at the levels of q2: first step of the paper.

    :param q2: (m,) [rad].
    :param compliance: (m,) [rad/(N·m)], compensator included.
    :param covariance: (m, m).
    """

    q2: Array
    compliance: Array
    covariance: Array


class SpringOfJoint2(Struct, frozen=True, eq=False):
    """K⁰_θ2 [N·m/rad], K_c [N/m], s₀·K_c [N] from the levels: second step of the paper, with covariance (3, 3)."""

    values: Array
    covariance: Array


def extended_set(robot: RobotModel, data: Measurements, placement: Placement) -> tuple[Fit, Levels] | None:
    """First step: k1, k2 per level of q2, k3…k6 by Eq. (8), then iterated on the equilibrium.

    The first iterate, from zero compliance, is Eq. (8) itself: there the derivative of the displacement by k_j is
    J_j J_jᵀ F. Returns None if there are too few readings for a value per level.
    """
    level = levels_of(data)
    count = int(level.max()) + 1
    levels = (LevelCompliance(JOINT_COMPLIANCES[1].joint, index) for index in range(count))
    parameters = (JOINT_COMPLIANCES[0], *levels, *JOINT_COMPLIANCES[2:])
    if 3 * len(data.loaded) * len(data.points) <= len(parameters):
        return None
    structure = Structure(parameters, replace(robot, compensator=None), level)
    try:
        fit = gauss_newton(structure, data, placement, start=np.zeros(len(parameters)))
    except PostprocError:
        return None
    q2 = np.array([data.q[level == index, 1].mean() for index in range(count)])
    rows = np.arange(1, 1 + count)
    return fit, Levels(q2, fit.values[rows], fit.covariance[np.ix_(rows, rows)])


def compensator_from_levels(levels: Levels, law: Compensator) -> SpringOfJoint2 | None:
    """Second step: K⁰_θ2, K_c, s₀·K_c by Eq. (9), (10), weighted with the covariance of the levels.

    :param law: gives L, a_x, a_y.
    :returns: None with fewer than three usable levels.
    """
    good = np.isfinite(np.diag(levels.covariance)) & (levels.compliance > 0.0)
    if np.count_nonzero(good) < 3:
        return None
    k = levels.compliance[good]
    stiffness = 1.0 / k
    slope = -(stiffness**2)
    covariance = levels.covariance[np.ix_(good, good)] * np.outer(slope, slope)
    c = np.column_stack([np.ones_like(k), law.stiffness_columns(levels.q2[good])])
    weight = np.linalg.inv(covariance)
    normal = c.T @ weight @ c
    scale = 1.0 / np.sqrt(np.diag(normal))
    if np.linalg.cond(normal * np.outer(scale, scale)) > 1e12:
        return None
    inverse: Array = np.asarray(np.linalg.inv(normal))
    return SpringOfJoint2(inverse @ c.T @ weight @ stiffness, inverse)


def fit_joints(
    robot: RobotModel, data: Measurements, placement: Placement, start: SpringOfJoint2 | None
) -> tuple[Fit, list[NotObservable]]:
    """Fit k1…k6, and K_c and s₀ where the robot has a compensator; fix to the prior what the data leave open.

    :raises MeasurementError: there are fewer readings than unknowns.
    """
    wanted: list[Parameter] = [*JOINT_COMPLIANCES, *(COMPENSATOR if robot.compensator is not None else ())]
    readings = 3 * len(data.loaded) * len(data.points)
    if readings <= len(JOINT_COMPLIANCES):
        raise MeasurementError(
            f"{readings} loaded coordinates for {len(JOINT_COMPLIANCES)} compliances",
            file=data.file,
            advice="Measure more configurations or points: 15 configurations of 3 points are usual.",
        )
    missing: list[NotObservable] = []
    first, refuted = True, False
    while True:
        structure = Structure(tuple(wanted), robot)
        values = structure.start()
        if first and start is not None and CompensatorStiffness() in wanted and start.values[0] > 0.0:
            values[1], values[6], values[7] = 1.0 / start.values[0], start.values[1], start.values[2]
        fit = _attempt(structure, data, placement, values)
        left = not_observable(fit, data)
        if left and left[0].parameter in COMPENSATOR and (refuted or _prior_spring_refuted(fit, data, placement)):
            refuted, left = True, left[1:]
        if not left:
            return fit, missing
        worst = left[0]
        missing.append(worst)
        gone = COMPENSATOR if worst.parameter in COMPENSATOR else (worst.parameter,)
        wanted = [parameter for parameter in wanted if parameter not in gone]
        first = False
        if not wanted:
            raise MeasurementError(
                "none of the compliances can be determined", file=data.file, advice=missing[0].advice
            )


def _prior_spring_refuted(fit: Fit, data: Measurements, placement: Placement) -> bool:
    """Return whether the readings contradict the prior's compensator: an uncertain value is then better than that.

    Two parameters less in the fit; the growth of χ² is measured by what the fit leaves anyway.
    """
    spring = fit.structure.parameters.index(CompensatorStiffness())
    if not is_physical(fit) or not np.isfinite(fit.covariance[spring, spring]):
        return False
    rest = tuple(p for p in fit.structure.parameters if p not in COMPENSATOR)
    structure = Structure(rest, fit.structure.prior)
    without = _attempt(structure, data, placement, structure.start())
    return without.chi2 - fit.chi2 > _REFUTED * max(1.0, fit.chi2 / max(fit.dof, 1))


def _attempt(structure: Structure, data: Measurements, placement: Placement, values: Array) -> Fit:
    try:
        return gauss_newton(structure, data, placement, start=values)
    except PostprocError:  # a start far off: the prior itself
        return gauss_newton(structure, data, placement, iterations=2)
