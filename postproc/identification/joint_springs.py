"""Joint springs and compensator: the paper's method, the serial baseline, and the parameters that readings determine.

**Enhanced method** (`extended_set`, `compensator_from_levels`, `fit_joints`). Source: Klimchik et al., section 3:
Eq. (8) gives the extended set k1, k2 per level of q2, k3…k6; Eq. (9), (10) give K⁰_θ2, K_c and s₀ from the levels. Both
are linear in the load; a Gauss–Newton fit to the equilibrium follows.

**Serial baseline** (`fit_serial`): strict serial chain, full-pose displacements, no compensator. Source: Dumas, Caro,
Garnier, Furet, "Joint stiffness identification of six-revolute industrial serial robots", Robotics and
Computer-Integrated Manufacturing 27 (2011), as the paper describes it. The displacement of the flange, position and
orientation, is computed from the points; k follows by linear least squares from Δt = J diag(k) Jᵀ F, Eq. (2).

**Observability** (`not_observable`): parameters that the readings do not determine, the reason, and what to measure
instead.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, kinematics
from postproc.compensator import Compensator
from postproc.errors import MeasurementError, PostprocError
from postproc.frames import Array, twist_between
from postproc.identification.fit import Fit, covariance_of, gauss_newton
from postproc.identification.measurement_model import (
    LevelCompliance,
    Placement,
    Structure,
    device_to_root,
    joint_torques,
    kabsch,
    levels_of,
    measured_displacements,
    predict,
    visible,
    whiten,
    whitening,
)
from postproc.identification.readings import Measurements
from postproc.robot import (
    COMPENSATOR,
    JOINT_COMPLIANCES,
    CompensatorPreload,
    CompensatorStiffness,
    JointCompliance,
    Parameter,
    RobotModel,
)

UNCERTAIN = 0.5
"""Half width of the 95 % interval over the value beyond which a parameter counts as not determined."""
_NO_TORQUE = 0.02
"""Largest torque on a joint over the largest on any, below which the loads do not reach it."""
PRIOR_SPREAD = 0.5
"""Standard deviation of a prior compliance over its value, where the prior states none: published sets for one class
of arm differ by 20 to 50 %."""
_LONGEST_SPRING = 3.0
"""Free length [m] that no compensator has (assumed)."""


class UnobservableParameter(Struct, frozen=True):
    """A parameter that the data do not determine; the model keeps the robot's prior value."""

    parameter: Parameter
    reason: str
    advice: str

    @property
    def name(self) -> str:
        """Return the name of the parameter in files."""
        return self.parameter.name

    def __str__(self) -> str:
        return f"{self.name} is not observable: {self.reason}. {self.advice} The robot's prior value is kept."


def not_observable(fit: Fit, data: Measurements, with_misfit: bool = False) -> list[UnobservableParameter]:
    """Return the joint compliances and compensator values that the fit does not determine, worst first.

    :param with_misfit: the covariance already contains the unexplained residual.
    """
    robot = fit.structure.prior
    torque = joint_torques(robot, data)
    entries = []
    # an unexplained residual widens the intervals
    wider = np.sqrt(max(1.0, fit.chi2 / fit.dof)) if not with_misfit and fit.chi2 > 2.0 * fit.dof > 0 else 1.0
    correlation = _correlation(fit.covariance)
    for index, parameter in enumerate(fit.structure.parameters):
        if not isinstance(parameter, JointCompliance):
            continue
        prior = robot.compliance[robot.row(parameter)]
        half = float(fit.ci95[index] * wider)
        # an interval against the larger of value and prior: a noisy small value must not look determined
        if half <= UNCERTAIN * max(abs(fit.values[index]), prior) and fit.values[index] > 0.0:
            continue
        entries.append((half, _joint_reason(parameter, torque, fit, index, half, correlation)))
    spring = CompensatorStiffness()
    if spring in fit.structure.parameters:
        k2_is_open = any(entry.parameter == JOINT_COMPLIANCES[1] for _, entry in entries)
        if entry := _compensator(fit, data, wider, k2_is_open):
            entries.append((np.inf, entry))
    # the compensator first: without it k2 is determined again
    return [entry for _, entry in sorted(entries, key=lambda pair: (pair[1].parameter != spring, -pair[0]))]


def _compensator(fit: Fit, data: Measurements, wider: float, k2_is_open: bool) -> UnobservableParameter | None:
    """Return the reason that the compensator is not observable, with advice; None if it is.

    :param wider: factor of its interval.
    :param k2_is_open: the compliance of joint 2 is not observable.
    """
    index = fit.structure.parameters.index(CompensatorStiffness())
    value, half = float(fit.values[index]), float(fit.ci95[index] * wider)
    levels = int(levels_of(data).max()) + 1
    if levels < 3 or k2_is_open:
        return UnobservableParameter(
            CompensatorStiffness(),
            f"K_theta2_0, K_c and s_0 are three unknowns, and there are {levels} levels of q2",
            "Measure at five levels of q2, far apart.",
        )
    if not is_physical(fit):
        return UnobservableParameter(
            CompensatorStiffness(),
            f"the fit gives K_c {value:.3g} N/m, which no spring has: noise, or flexibility that is not the joint's, "
            "outweighs its effect",
            "Measure more and heavier loads at levels of q2 far apart.",
        )
    if half > UNCERTAIN * value:
        return UnobservableParameter(
            CompensatorStiffness(),
            f"its effect on joint 2 is too small against the noise (K_c {value:.2g} ± {half:.2g} N/m)",
            f"Measure more and heavier loads at levels of q2 far apart (there are {levels}); a compensator that only "
            "balances the weights can not be seen in deflections.",
        )
    return None


def is_physical(fit: Fit) -> bool:
    """Return whether the compensator of a fit, if it has one, is one that could be built."""
    stiffness = fit.parameter_values.get(CompensatorStiffness())
    if stiffness is None:
        return True
    return stiffness > 0.0 and 0.0 <= fit.parameter_values[CompensatorPreload()] / stiffness <= _LONGEST_SPRING


def _joint_reason(
    parameter: JointCompliance, torque: Array, fit: Fit, index: int, half: float, correlation: Array
) -> UnobservableParameter:
    """Return the reason that a joint compliance is not observable, with advice.

    :param torque: (L, 6) of the loads [N·m].
    :param half: half 95 % interval [rad/(N·m)].
    :param correlation: (p, p) of the parameters.
    """
    joint = parameter.index
    largest = float(np.abs(torque[:, joint]).max())
    reference = float(np.abs(torque).max())
    if largest < _NO_TORQUE * reference:
        reason = f"the loads put at most {largest:.2g} N·m on A{joint + 1}"
        if joint == 0:
            reason += " (they are vertical, parallel to its axis)"
            advice = "Pull the arm sideways too, for instance by a cable over a pulley."
        elif joint == 5:
            reason += " (they act on its axis)"
            advice = "Hang the load at a distance from the axis of A6: on a bracket, with another load point."
        else:
            advice = f"Choose configurations in which the load has a lever about A{joint + 1}."
        return UnobservableParameter(parameter, reason, advice)
    cross_correlation = np.abs(correlation[index].copy())
    cross_correlation[index] = 0.0
    partner = fit.structure.parameters[int(np.argmax(cross_correlation))].symbol
    reason = f"its 95 % interval is ± {half * 1e6:.2g} µrad/(N·m) for a value of {fit.values[index] * 1e6:.3g}"
    if not np.isfinite(half):
        reason = "the configurations do not determine it"
    if cross_correlation.max() > 0.9:
        reason += (
            f", and it can hardly be separated from {partner} "
            f"(correlation {correlation[index, np.argmax(cross_correlation)]:.2f})"
        )
    return UnobservableParameter(
        parameter, reason, f"Measure configurations that put more torque on A{joint + 1} alone."
    )


def _correlation(covariance: Array) -> Array:
    """Return the correlations (p, p) of a covariance (p, p); 0 for parameters without variance."""
    deviation = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(deviation, deviation)
    return np.asarray(np.nan_to_num(correlation))


def unloaded_joints(robot: RobotModel, data: Measurements) -> tuple[JointCompliance, ...]:
    """Return the compliances of joints on which the loads put next to no torque."""
    largest = np.abs(joint_torques(robot, data)).max(axis=0)
    return tuple(p for p, value in zip(JOINT_COMPLIANCES, largest, strict=True) if value < _NO_TORQUE * largest.max())


def held_by_prior(fit: Fit, open_entries: list[UnobservableParameter]) -> Fit:
    """Return the fit with the compliances of missing joints at the prior's values, as uncertain as the prior states."""
    robot, parameters = fit.structure.prior, fit.structure.parameters
    joints = [entry.parameter for entry in open_entries if isinstance(entry.parameter, JointCompliance)]
    order = (*parameters, *(joint for joint in joints if joint not in parameters))
    size, old = len(order), len(parameters)
    values, covariance = np.zeros(size), np.zeros((size, size))
    values[:old], covariance[:old, :old] = fit.values, fit.covariance
    design = np.zeros((len(fit.design), size))
    design[:, :old] = fit.design
    for joint in joints:
        index = order.index(joint)
        values[index] = robot.value(joint)
        covariance[index] = covariance[:, index] = 0.0
        covariance[index, index] = prior_spread(robot, joint) ** 2
    structure = replace(fit.structure, parameters=order)
    return replace(fit, structure=structure, values=values, covariance=covariance, design=design)


def prior_spread(robot: RobotModel, joint: Parameter) -> float:
    """Return the standard deviation of a joint compliance of the prior [rad/(N·m)]."""
    covariance = robot.covariance
    if covariance is not None and joint in covariance.parameters:
        index = covariance.parameters.index(joint)
        return float(np.sqrt(covariance.matrix[index, index])) / joint.per_si
    return PRIOR_SPREAD * robot.value(joint)


_CHI2_LIMIT = 13.8
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
    if 3 * len(data.loaded_states) * len(data.points) <= len(parameters):
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
    """Return gear and compensator of joint 2 from its compliance at levels of q2: least squares by Eq. (9) and (10).

    The equation is linear in K⁰_θ2, K_c and s₀·K_c; the covariance of the levels is its weight.

    :param law: gives L, a_x, a_y.
    :returns: None with fewer than three usable levels, or if these do not separate the three values.
    """
    is_determined = np.isfinite(np.diag(levels.covariance)) & (levels.compliance > 0.0)
    if np.count_nonzero(is_determined) < 3:
        return None
    k = levels.compliance[is_determined]
    stiffness = 1.0 / k
    slope = -(stiffness**2)
    covariance = levels.covariance[np.ix_(is_determined, is_determined)] * np.outer(slope, slope)
    c = np.column_stack([np.ones_like(k), law.stiffness_columns(levels.q2[is_determined])])
    weight = np.linalg.inv(covariance)
    normal = c.T @ weight @ c
    scale = 1.0 / np.sqrt(np.diag(normal))
    if np.linalg.cond(normal * np.outer(scale, scale)) > 1e12:
        return None
    inverse: Array = np.asarray(np.linalg.inv(normal))
    return SpringOfJoint2(inverse @ c.T @ weight @ stiffness, inverse)


def fit_joints(
    robot: RobotModel, data: Measurements, placement: Placement, start: SpringOfJoint2 | None
) -> tuple[Fit, list[UnobservableParameter]]:
    """Fit k1…k6, and K_c and s₀ of a compensator; keep the prior for values that the data do not determine.

    :raises MeasurementError: there are fewer readings than unknowns.
    """
    parameters: list[Parameter] = [*JOINT_COMPLIANCES, *(COMPENSATOR if robot.compensator is not None else ())]
    readings = 3 * len(data.loaded_states) * len(data.points)
    if readings <= len(JOINT_COMPLIANCES):
        raise MeasurementError(
            f"{readings} loaded coordinates for {len(JOINT_COMPLIANCES)} compliances",
            file=data.file,
            advice="Measure more configurations or points: 15 configurations of 3 points are usual.",
        )
    open_entries: list[UnobservableParameter] = []
    first, is_prior_refuted = True, False
    while True:
        structure = Structure(tuple(parameters), robot)
        values = structure.start()
        if first and start is not None and CompensatorStiffness() in parameters and start.values[0] > 0.0:
            values[1], values[6], values[7] = 1.0 / start.values[0], start.values[1], start.values[2]
        fit = _attempt(structure, data, placement, values)
        left = not_observable(fit, data)
        if (
            left
            and left[0].parameter in COMPENSATOR
            and is_physical(fit)  # a spring that cannot be built is no better than the prior's
            and (is_prior_refuted or _refutes_prior_spring(fit, data, placement))
        ):
            is_prior_refuted, left = True, left[1:]
        if not left:
            return fit, open_entries
        worst = left[0]
        if worst.parameter in COMPENSATOR:  # without it the joints left out before may be determined
            parameters, open_entries = list(JOINT_COMPLIANCES), [worst]
        else:
            parameters.remove(worst.parameter)
            open_entries.append(worst)
        first = False
        if not parameters:
            raise MeasurementError(
                "none of the compliances can be determined", file=data.file, advice=open_entries[0].advice
            )


def _refutes_prior_spring(fit: Fit, data: Measurements, placement: Placement) -> bool:
    """Return whether the readings contradict the prior's compensator: an uncertain value is then better than that.

    The fit is repeated without the two parameters; the growth of χ² is compared with the residual of the full fit.
    """
    spring = fit.structure.parameters.index(CompensatorStiffness())
    if not np.isfinite(fit.covariance[spring, spring]):
        return False
    other_parameters = tuple(p for p in fit.structure.parameters if p not in COMPENSATOR)
    structure = Structure(other_parameters, fit.structure.prior)
    reduced_fit = _attempt(structure, data, placement, structure.start())
    return reduced_fit.chi2 - fit.chi2 > _CHI2_LIMIT * max(1.0, fit.chi2 / max(fit.dof, 1))


def _attempt(structure: Structure, data: Measurements, placement: Placement, values: Array) -> Fit:
    """Return the fit from start values (p,); where it fails, two iterations from the prior."""
    try:
        return gauss_newton(structure, data, placement, start=values)
    except PostprocError:  # a start far off: the prior itself
        return gauss_newton(structure, data, placement, iterations=2)


def flange_displacements(data: Measurements, placement: Placement) -> Array:
    """Return displacements (L, 6) of the load point: position [m], rotation [rad], root axes.

    :raises MeasurementError: fewer than three points, or points on one line: no orientation.
    """
    if len(data.points) < 3 or np.linalg.matrix_rank(placement.points - placement.points.mean(axis=0), tol=5e-3) < 2:
        raise MeasurementError(
            "the serial method needs full poses: three points that are not on a line",
            file=data.file,
            advice="Measure three points, or use --method enhanced.",
        )
    mean, count = data.means()
    root = device_to_root(placement, mean)
    displacement = np.empty((len(data.loaded_states), 6))
    for row, state in enumerate(data.loaded_states):
        unloaded_state = data.unloaded_states[data.state_config[state]]
        is_visible = (count[state] > 0) & (count[unloaded_state] > 0)
        if np.count_nonzero(is_visible) < 3:
            displacement[row] = np.nan
            continue
        frames = [kabsch(placement.points[is_visible], root[index, is_visible]) for index in (unloaded_state, state)]
        load_point = np.eye(4)
        load_point[:3, 3] = data.load_point
        displacement[row] = twist_between(frames[0] @ load_point, frames[1] @ load_point)
    return displacement


def fit_serial(robot: RobotModel, data: Measurements, placement: Placement) -> Fit:
    """Fit k1…k6 of a strict serial chain, linear in the load, to full-pose displacements.

    Position [m] and rotation [rad] enter one sum of squares without weights, as in the source.
    """
    bare = replace(robot, compensator=None)
    displacement = flange_displacements(data, placement)
    has_displacement = np.isfinite(displacement).all(axis=1)
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    config = data.state_config[data.loaded_states]
    x = elastostatics.coordinates(bare, data.q[config])
    _, jacobian = kinematics.tcp(bare.actual, x, tool)
    jacobian = jacobian[:, :, list(bare.actuated)]
    torque = np.einsum("lij,li->lj", jacobian, data.wrench[data.loaded_states])
    design = (jacobian * torque[:, None])[has_displacement].reshape(-1, 6)
    target = displacement[has_displacement].ravel()
    if len(target) <= 6:
        raise MeasurementError(
            f"{len(target)} components of displacements for 6 compliances",
            file=data.file,
            advice="Measure more configurations.",
        )
    # 1e-300 keeps zero out of the denominator
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    values = np.linalg.lstsq(design / scale, target, rcond=1e-9)[0] / scale
    left = target - design @ values
    sigma2 = float(left @ left) / (len(target) - 6)
    structure = Structure(JOINT_COMPLIANCES, bare)
    deviation = np.sqrt(sigma2)
    covariance = covariance_of(design / deviation, structure.usual())
    prediction, slopes = predict(structure, np.maximum(values, 1e-9), data, placement)
    residual = (measured_displacements(data, placement) - prediction) * visible(data)
    w = whitening(data)
    white = whiten(w, residual).ravel()
    whole = whiten(w, slopes).reshape(-1, 6)
    return Fit(
        structure, values, covariance, residual, float(white @ white), len(white) - 6, whole, white + whole @ values
    )
