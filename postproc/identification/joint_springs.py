"""Joint springs and compensator: the paper's method, the serial baseline, and the parameters that readings determine.

**Enhanced method** (`extended_set`, `compensator_from_levels`, `fit_joints`). Source: Klimchik et al., section 3:
Eq. (8) gives the extended set k1, k2 per level of q2, k3…k6; Eq. (9), (10) give K⁰_θ2, K_c and s₀ from the levels. Both
are linear in the load; a Gauss–Newton fit to the equilibrium follows.

**Serial baseline** (`fit_serial`): strict serial chain, full-pose displacements, no compensator. Source: Dumas, Caro,
Garnier, Furet, "Joint stiffness identification of six-revolute industrial serial robots", Robotics and
Computer-Integrated Manufacturing 27 (2011), as the paper describes it. The displacement of the flange, position and
orientation, is computed from the points; k follows by linear least squares from Δt = J diag(k) Jᵀ F, Eq. (2).

**Observability** (`unobservable_parameters`): parameters that the readings do not determine, the reason, and what to
measure instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, kinematics
from postproc.compensator import Compensator
from postproc.errors import MeasurementError, PostprocError
from postproc.frames import Array, twist_between
from postproc.identification.fit import Fit, correlations, covariance_of, gauss_newton
from postproc.identification.measurement_model import (
    LevelCompliance,
    Placement,
    Structure,
    coordinate_count,
    device_to_root,
    joint_torques,
    kabsch,
    levels_of,
    predict,
    whitened_derivatives,
    whitening,
)
from postproc.identification.readings import Measurements
from postproc.robot import (
    COMPENSATOR,
    JOINT_COMPLIANCES,
    PER_URAD,
    CompensatorPreload,
    CompensatorStiffness,
    JointCompliance,
    Parameter,
    RobotModel,
)

UNCERTAIN_SHARE = 0.5
"""Half width of the 95 % interval over the value beyond which a parameter counts as not determined."""
_LEAST_TORQUE_SHARE = 0.02
"""Largest torque on a joint over the largest on any, below which the loads do not reach it."""
PRIOR_SPREAD_SHARE = 0.5
"""Standard deviation of a prior compliance over its value, where the prior states none: published sets for one class
of arm differ by 20 to 50 %."""
_MAX_FREE_LENGTH = 3.0
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


def unobservable_parameters(
    fit: Fit, data: Measurements, covariance_has_misfit: bool = False
) -> list[UnobservableParameter]:
    """Return the joint compliances and the compensator's stiffness, if the fit does not determine them.

    The compensator comes first, then the compliances by the width of their intervals, widest first.

    :param covariance_has_misfit: whether the covariance already contains the residual that noise does not explain.
    """
    robot = fit.structure.prior
    torque = joint_torques(robot, data)
    entries = []
    # noise alone does not double χ² (assumed): the intervals, which are for noise alone, grow with the residual
    widens_intervals = not covariance_has_misfit and fit.chi2 > 2.0 * fit.dof > 0
    interval_factor = np.sqrt(max(1.0, fit.chi2 / fit.dof)) if widens_intervals else 1.0
    for index, parameter in enumerate(fit.structure.parameters):
        if not isinstance(parameter, JointCompliance):
            continue
        prior_value = robot.compliance[robot.row(parameter)]
        half_width = float(fit.ci95[index] * interval_factor)
        # a value far below the prior is judged against the prior: a noisy small value would never count as determined
        if half_width <= UNCERTAIN_SHARE * max(abs(fit.values[index]), prior_value) and fit.values[index] > 0.0:
            continue
        entry = _unloaded_joint(parameter, torque) or _uncertain_joint(parameter, fit, half_width)
        entries.append((half_width, entry))
    spring = CompensatorStiffness()
    if spring in fit.structure.parameters:
        is_k2_undetermined = any(entry.parameter == JOINT_COMPLIANCES[1] for _, entry in entries)
        spring_entry = _unobservable_compensator(fit, data, interval_factor, is_k2_undetermined)
        if spring_entry is not None:
            entries.append((np.inf, spring_entry))
    # the compensator first: without it k2 is determined again
    return [entry for _, entry in sorted(entries, key=lambda pair: (pair[1].parameter != spring, -pair[0]))]


def _unobservable_compensator(
    fit: Fit, data: Measurements, interval_factor: float, is_k2_undetermined: bool
) -> UnobservableParameter | None:
    """Return the reason that the compensator of a fit is not observable, with advice; None if it is observable.

    Joint 2 has three unknowns: the stiffness of its gear, and stiffness K_c and free length s₀ of the compensator's
    spring. Only their sum at each level of q2 shows, so that three levels or more are needed.

    :param interval_factor: factor ≥ 1 on the 95 % intervals of the fit: residuals that noise does not explain widen
        them.
    :param is_k2_undetermined: whether the fit does not determine the compliance of the gear of joint 2.
    """
    index = fit.structure.parameters.index(CompensatorStiffness())
    stiffness, half_width = float(fit.values[index]), float(fit.ci95[index] * interval_factor)  # [N/m]
    level_count = int(levels_of(data).max()) + 1
    # if the gear is not determined either, the three unknowns cannot be separated: more levels help then too
    if level_count < 3 or is_k2_undetermined:
        return UnobservableParameter(
            CompensatorStiffness(),
            f"K_theta2_0, K_c and s_0 are three unknowns, and there are {level_count} levels of q2",
            "Measure at five levels of q2, far apart.",
        )
    if not has_possible_compensator(fit):
        return UnobservableParameter(
            CompensatorStiffness(),
            f"the fit gives K_c {stiffness:.3g} N/m, which no spring has: noise, or flexibility that is not the "
            "joint's, outweighs its effect",
            "Measure more and heavier loads at levels of q2 far apart.",
        )
    if half_width > UNCERTAIN_SHARE * stiffness:
        return UnobservableParameter(
            CompensatorStiffness(),
            f"its effect on joint 2 is too small against the noise (K_c {stiffness:.2g} ± {half_width:.2g} N/m)",
            f"Measure more and heavier loads at levels of q2 far apart (there are {level_count}); a compensator that "
            "only balances the weights can not be seen in deflections.",
        )
    return None


def has_possible_compensator(fit: Fit) -> bool:
    """Return whether the compensator of a fit could be built: K_c positive, a free length from 0 to `_MAX_FREE_LENGTH`.

    True for a fit without compensator.
    """
    stiffness = fit.parameter_values.get(CompensatorStiffness())
    if stiffness is None:
        return True
    return stiffness > 0.0 and 0.0 <= fit.parameter_values[CompensatorPreload()] / stiffness <= _MAX_FREE_LENGTH


def _unloaded_joint(parameter: JointCompliance, torque: Array) -> UnobservableParameter | None:
    """Return the entry of a joint compliance whose joint the loads hardly load; None if they load it enough.

    :param torque: (L, 6) on the joints by the loads [N·m].
    """
    joint = parameter.index  # 0 to 5
    joint_torque = float(np.abs(torque[:, joint]).max())
    if joint_torque >= _LEAST_TORQUE_SHARE * float(np.abs(torque).max()):
        return None
    reason = f"the loads put at most {joint_torque:.2g} N·m on A{joint + 1}"
    advice = f"Choose configurations in which the load has a lever about A{joint + 1}."
    if joint == 0:
        reason += " (they are vertical, parallel to its axis)"
        advice = "Pull the arm sideways too, for instance by a cable over a pulley."
    elif joint == 5:
        reason += " (they act on its axis)"
        advice = "Hang the load at a distance from the axis of A6: on a bracket, with another load point."
    return UnobservableParameter(parameter, reason, advice)


def _uncertain_joint(parameter: JointCompliance, fit: Fit, half_width: float) -> UnobservableParameter:
    """Return the entry of a joint compliance whose interval is too wide, with the parameter that is confused with it.

    :param half_width: of its 95 % interval [rad/(N·m)]; infinite if the readings do not determine it.
    """
    index = fit.structure.parameters.index(parameter)
    correlation = correlations(fit.covariance)[index]
    correlation[index] = 0.0  # of the parameter with itself
    partner = int(np.argmax(np.abs(correlation)))
    reason = "the configurations do not determine it"
    if np.isfinite(half_width):
        value = fit.values[index] * PER_URAD
        reason = f"its 95 % interval is ± {half_width * PER_URAD:.2g} µrad/(N·m) for a value of {value:.3g}"
    # 0.9: a correlation that is worth a mention (assumed)
    if np.abs(correlation).max() > 0.9:
        reason += (
            f", and it can hardly be separated from {fit.structure.parameters[partner].symbol} "
            f"(correlation {correlation[partner]:.2f})"
        )
    advice = f"Measure configurations that put more torque on {parameter.joint} alone."
    return UnobservableParameter(parameter, reason, advice)


def unloaded_joints(robot: RobotModel, data: Measurements) -> tuple[JointCompliance, ...]:
    """Return the compliances of joints whose torque by the loads is below `_LEAST_TORQUE_SHARE` of the largest one."""
    torque = np.abs(joint_torques(robot, data)).max(axis=0)
    is_unloaded = torque < _LEAST_TORQUE_SHARE * torque.max()
    return tuple(joint for joint, is_idle in zip(JOINT_COMPLIANCES, is_unloaded, strict=True) if is_idle)


def fit_with_prior_values(fit: Fit, unobservable_entries: list[UnobservableParameter]) -> Fit:
    """Return the fit with the prior's values and variances for joint compliances that it does not determine.

    The prior is the robot before the identification. Compliances that were omitted from the fit are added to it.

    :param unobservable_entries: parameters that are not observable; entries of the compensator are ignored.
    """
    robot, fit_parameters = fit.structure.prior, fit.structure.parameters
    joints = [entry.parameter for entry in unobservable_entries if isinstance(entry.parameter, JointCompliance)]
    parameters = (*fit_parameters, *(joint for joint in joints if joint not in fit_parameters))
    size, fit_size = len(parameters), len(fit_parameters)
    values, covariance = np.zeros(size), np.zeros((size, size))
    values[:fit_size], covariance[:fit_size, :fit_size] = fit.values, fit.covariance
    design = np.zeros((len(fit.design), size))
    design[:, :fit_size] = fit.design
    for joint in joints:  # independent of all other parameters
        index = parameters.index(joint)
        values[index] = robot.value(joint)
        covariance[index] = covariance[:, index] = 0.0
        covariance[index, index] = prior_spread(robot, joint) ** 2
    structure = replace(fit.structure, parameters=parameters)
    return replace(fit, structure=structure, values=values, covariance=covariance, design=design)


def prior_spread(robot: RobotModel, joint: Parameter) -> float:
    """Return the standard deviation of a joint compliance of a robot [rad/(N·m)].

    It is the stated one, or `PRIOR_SPREAD_SHARE` of the compliance if the robot states none.
    """
    covariance = robot.covariance
    if covariance is not None and joint in covariance.parameters:
        index = covariance.parameters.index(joint)
        return float(np.sqrt(covariance.matrix[index, index])) / joint.per_si
    return PRIOR_SPREAD_SHARE * robot.value(joint)


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
    """Gear and compensator of joint 2 from the levels: second step of the paper.

    :param values: (3,) K⁰_θ2 [N·m/rad], K_c [N/m], s₀·K_c [N].
    :param covariance: (3, 3).
    """

    values: Array
    covariance: Array


class ExtendedSet(NamedTuple):
    """Fit of k1, k2 at each level of q2, and k3…k6, and the values of k2 at the levels."""

    fit: Fit
    levels: Levels


def extended_set(robot: RobotModel, data: Measurements, placement: Placement) -> ExtendedSet | None:
    """Fit k1, k2 at each level of q2, and k3…k6: first step of Klimchik et al., Eq. (8).

    The fit is iterated on the equilibrium. Its first iterate, from zero compliance, is Eq. (8) itself: there the
    derivative of the displacement by k_j is J_j J_jᵀ F.

    :returns: None if there are too few readings for a value at each level, or the fit has no equilibrium.
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
    rows = np.arange(1, 1 + count)  # k2 at the levels, after k1
    return ExtendedSet(fit, Levels(q2, fit.values[rows], fit.covariance[np.ix_(rows, rows)]))


def compensator_from_levels(levels: Levels, compensator: Compensator) -> SpringOfJoint2 | None:
    """Return gear and compensator of joint 2 from its compliance at levels of q2. Second step of Klimchik et al.

    Least squares by Eq. (9) and (10), which are linear in K⁰_θ2, K_c and s₀·K_c, weighted by the covariance of the
    levels.

    :param compensator: compensator whose lengths L, a_x, a_y count; its spring does not.
    :returns: None if fewer than three levels have a positive compliance of finite variance, or if the levels do not
        separate the three values.
    """
    is_determined = np.isfinite(np.diag(levels.covariance)) & (levels.compliance > 0.0)
    if np.count_nonzero(is_determined) < 3:
        return None
    stiffness = 1.0 / levels.compliance[is_determined]
    slope = -(stiffness**2)  # derivative of the stiffness by the compliance
    covariance = levels.covariance[np.ix_(is_determined, is_determined)] * np.outer(slope, slope)
    design = np.column_stack([np.ones_like(stiffness), compensator.stiffness_columns(levels.q2[is_determined])])
    weight = np.linalg.inv(covariance)
    normal = design.T @ weight @ design
    scale = 1.0 / np.sqrt(np.diag(normal))
    # singular, but for rounding
    if np.linalg.cond(normal * np.outer(scale, scale)) > 1e12:
        return None
    spring_covariance: Array = np.asarray(np.linalg.inv(normal))
    return SpringOfJoint2(spring_covariance @ design.T @ weight @ stiffness, spring_covariance)


def fit_joints(
    robot: RobotModel, data: Measurements, placement: Placement, start: SpringOfJoint2 | None
) -> tuple[Fit, list[UnobservableParameter]]:
    """Fit k1…k6, and K_c and s₀ of a compensator, omitting what the readings do not determine.

    Parameters are omitted one after the other, the worst first; they keep the robot's values.

    :param start: gear and compensator of joint 2 to begin with; None: the robot's.
    :returns: the fit without the omitted parameters; entries of the omitted parameters.
    :raises MeasurementError: there are fewer readings than unknowns, or they determine none of the compliances.
    """
    _check_count(data)
    parameters: list[Parameter] = [*JOINT_COMPLIANCES, *(COMPENSATOR if robot.compensator is not None else ())]
    unobservable_entries: list[UnobservableParameter] = []
    is_prior_refuted = False  # of the compensator's spring
    while parameters:
        structure = Structure(tuple(parameters), robot)
        fit = _attempt(structure, data, placement, _start_values(structure, start))
        start = None  # of the first fit only
        unobservable = unobservable_parameters(fit, data)
        # an uncertain spring stays if the prior's is refuted; one that cannot be built is no better than the prior's
        if unobservable and unobservable[0].parameter in COMPENSATOR and has_possible_compensator(fit):
            is_prior_refuted = is_prior_refuted or _refutes_prior_spring(fit, data, placement)
            unobservable = unobservable[1:] if is_prior_refuted else unobservable
        if not unobservable:
            return fit, unobservable_entries
        worst = unobservable[0]
        if worst.parameter in COMPENSATOR:  # without it the joints omitted before may be determined
            parameters, unobservable_entries = list(JOINT_COMPLIANCES), [worst]
        else:
            parameters.remove(worst.parameter)
            unobservable_entries.append(worst)
    raise MeasurementError(
        "none of the compliances can be determined", file=data.file, advice=unobservable_entries[0].advice
    )


def _check_count(data: Measurements) -> None:
    """Check that there are more coordinates of readings under load than joint compliances.

    :raises MeasurementError: there are as many or fewer.
    """
    readings = 3 * len(data.loaded_states) * len(data.points)
    if readings <= len(JOINT_COMPLIANCES):
        raise MeasurementError(
            f"{readings} loaded coordinates for {len(JOINT_COMPLIANCES)} compliances",
            file=data.file,
            advice="Measure more configurations or points: 15 configurations of 3 points are usual.",
        )


def _start_values(structure: Structure, start: SpringOfJoint2 | None) -> Array:
    """Return start values (p,) of a fit, SI: for joint 2 and its compensator from `start`, else the robot's.

    :param structure: a structure with K_c has k2 too.
    :param start: gear and compensator of joint 2. The robot's values are taken if it is None, if its gear stiffness is
        not positive, or if the structure has no K_c.
    """
    values = structure.start_values()
    if start is not None and CompensatorStiffness() in structure.parameters and start.values[0] > 0.0:
        gear_stiffness, spring_stiffness, preload = start.values
        rows = [structure.parameters.index(parameter) for parameter in (JOINT_COMPLIANCES[1], *COMPENSATOR)]
        values[rows] = 1.0 / gear_stiffness, spring_stiffness, preload
    return values


def _refutes_prior_spring(fit: Fit, data: Measurements, placement: Placement) -> bool:
    """Return whether the readings contradict the prior's compensator: an uncertain value is then better.

    The fit is repeated with the compensator of the prior. The readings contradict it if χ² grows by more than
    `_CHI2_LIMIT` times the χ² per degree of freedom of the full fit, at least 1. False if the full fit has no finite
    variance of K_c.
    """
    spring = fit.structure.parameters.index(CompensatorStiffness())
    if not np.isfinite(fit.covariance[spring, spring]):
        return False
    other_parameters = tuple(p for p in fit.structure.parameters if p not in COMPENSATOR)
    structure = Structure(other_parameters, fit.structure.prior)
    reduced_fit = _attempt(structure, data, placement, structure.start_values())
    return reduced_fit.chi2 - fit.chi2 > _CHI2_LIMIT * max(1.0, fit.chi2 / max(fit.dof, 1))


def _attempt(structure: Structure, data: Measurements, placement: Placement, values: Array) -> Fit:
    """Return the fit from start values (p,); if it fails, the fit after two iterations from the prior."""
    try:
        return gauss_newton(structure, data, placement, start=values)
    except PostprocError:  # a start far off: the prior itself
        return gauss_newton(structure, data, placement, iterations=2)


def flange_displacements(data: Measurements, placement: Placement) -> Array:
    """Return measured displacements (L, 6) of the load point by the loads: position [m], rotation [rad], root axes.

    A loaded state is NaN if fewer than three points have readings with and without its load.

    :raises MeasurementError: there are fewer than three points, or they are on one line, so that they show no
        orientation.
    """
    offset = placement.points - placement.points.mean(axis=0)
    if len(data.points) < 3 or np.linalg.matrix_rank(offset, tol=5e-3) < 2:  # within 5 mm of a line
        raise MeasurementError(
            "the serial method needs full poses: three points that are not on a line",
            file=data.file,
            advice="Measure three points, or use --method enhanced.",
        )
    mean, count = data.means()
    positions = device_to_root(placement, mean)
    load_point = np.eye(4)
    load_point[:3, 3] = data.load_point
    displacement = np.full((len(data.loaded_states), 6), np.nan)
    for row, state in enumerate(data.loaded_states):
        unloaded_state = data.unloaded_states[data.state_config[state]]
        is_visible = (count[state] > 0) & (count[unloaded_state] > 0)
        if np.count_nonzero(is_visible) >= 3:  # three points show the orientation
            points = placement.points[is_visible]
            unloaded_pose, loaded_pose = (
                kabsch(points, positions[index, is_visible]) for index in (unloaded_state, state)
            )
            displacement[row] = twist_between(unloaded_pose @ load_point, loaded_pose @ load_point)
    return displacement


def fit_serial(robot: RobotModel, data: Measurements, placement: Placement) -> Fit:
    """Return the fit of k1…k6 of a strict serial chain, linear in the load, to full-pose displacements.

    Method of Dumas, Caro, Garnier and Furet (Robotics and Computer-Integrated Manufacturing 27, 2011). Position [m] and
    rotation [rad] enter one sum of squares without weights, as in the source.

    :raises MeasurementError: the readings give no full poses, or fewer than seven of their components.
    """
    serial_robot = replace(robot, compensator=None)
    displacement = flange_displacements(data, placement)
    has_displacement = np.isfinite(displacement).all(axis=1)
    design = _twists_by_compliance(serial_robot, data)[has_displacement].reshape(-1, 6)
    target = displacement[has_displacement].ravel()
    if len(target) <= 6:
        raise MeasurementError(
            f"{len(target)} components of displacements for 6 compliances",
            file=data.file,
            advice="Measure more configurations.",
        )
    # 1e-300 keeps zero out of the denominator
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    # rcond: directions that are rounding alone
    values = np.linalg.lstsq(design / scale, target, rcond=1e-9)[0] / scale
    pose_residual = target - design @ values
    sigma = np.sqrt(float(pose_residual @ pose_residual) / (len(target) - 6))
    structure = Structure(JOINT_COMPLIANCES, serial_robot)
    covariance = covariance_of(design / sigma, structure.usual_sizes())
    return _fit_of_points(structure, values, covariance, data, placement)


def _twists_by_compliance(robot: RobotModel, data: Measurements) -> Array:
    """Return the twists (L, 6, 6) of the load point per unit of each joint compliance, J_k·τ_k, at first order."""
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    x = elastostatics.coordinates(robot, data.q[data.state_config[data.loaded_states]])
    _, jacobian = kinematics.tcp(robot.actual, x, tool)
    jacobian = jacobian[:, :, list(robot.actuated)]  # of the joints alone, without springs of links
    torque = np.einsum("lij,li->lj", jacobian, data.wrench[data.loaded_states])
    return np.asarray(jacobian * torque[:, None])


def _fit_of_points(
    structure: Structure, values: Array, covariance: Array, data: Measurements, placement: Placement
) -> Fit:
    """Return a fit of joint compliances, with residuals and χ² of the points that their equilibrium predicts.

    :param values: (6,) compliances [rad/(N·m)] that were fitted to poses, with `covariance` (6, 6).
    """
    # no equilibrium without stiffness: compliances are at least 1e-9 rad/(N·m) in the prediction of the points
    prediction, slopes = predict(structure, np.maximum(values, 1e-9), data, placement)
    design = whitened_derivatives(whitening(data), slopes, data)
    return Fit.of(
        structure,
        values,
        data,
        placement,
        covariance=covariance,
        dof=coordinate_count(data) - 6,
        prediction=prediction,
        design=design,
    )
