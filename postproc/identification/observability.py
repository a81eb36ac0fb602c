"""Parameters that the readings do not determine, the reason, and what to measure instead."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, kinematics
from postproc.frames import RAD_PER_DEG, Array
from postproc.identification.fit import Fit
from postproc.identification.measurements import Measurements
from postproc.program import Ints
from postproc.robot import (
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
_SAME_LEVEL = 2.0 * RAD_PER_DEG
_PUBLISHED = 0.5
"""Standard deviation of a prior compliance over its value, where the prior states none: published sets for one class
of arm differ by 20 to 50 %."""
_LONGEST_SPRING = 3.0
"""Free length [m] that no compensator has."""


class NotObservable(Struct, frozen=True):
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


def not_observable(fit: Fit, data: Measurements, scaled: bool = False) -> list[NotObservable]:
    """Return the joint compliances and compensator values that the fit leaves open, worst first.

    :param scaled: the covariance already holds what the structure does not explain.
    """
    robot = fit.structure.prior
    torque = joint_torques(robot, data)
    found = []
    # what the structure does not explain widens the intervals
    wider = np.sqrt(max(1.0, fit.chi2 / fit.dof)) if not scaled and fit.chi2 > 2.0 * fit.dof > 0 else 1.0
    correlation = _correlation(fit.covariance)
    for index, parameter in enumerate(fit.structure.parameters):
        if not isinstance(parameter, JointCompliance):
            continue
        prior = robot.compliance[robot.row(parameter)]
        half = float(fit.ci95[index] * wider)
        # an interval against the larger of value and prior: a noisy small value must not look determined
        if half <= UNCERTAIN * max(abs(fit.values[index]), prior) and fit.values[index] > 0.0:
            continue
        found.append((half, _joint_reason(parameter, torque, fit, index, half, correlation)))
    spring = CompensatorStiffness()
    if spring in fit.structure.parameters:
        k2_is_open = any(entry.parameter == JOINT_COMPLIANCES[1] for _, entry in found)
        if entry := _compensator(fit, data, wider, k2_is_open):
            found.append((np.inf, entry))
    # the compensator first: without it k2 is determined again
    return [entry for _, entry in sorted(found, key=lambda pair: (pair[1].parameter != spring, -pair[0]))]


def _compensator(fit: Fit, data: Measurements, wider: float, k2_is_open: bool) -> NotObservable | None:
    index = fit.structure.parameters.index(CompensatorStiffness())
    value, half = float(fit.values[index]), float(fit.ci95[index] * wider)
    levels = int(levels_of(data).max()) + 1
    if levels < 3 or k2_is_open:
        return NotObservable(
            CompensatorStiffness(),
            f"K_theta2_0, K_c and s_0 are three unknowns, and there are {levels} levels of q2",
            "Measure at five levels of q2, far apart.",
        )
    if not is_physical(fit):
        return NotObservable(
            CompensatorStiffness(),
            f"the fit gives K_c {value:.3g} N/m, which no spring has: noise, or flexibility that is not the joint's, "
            "outweighs its effect",
            "Measure more and heavier loads at levels of q2 far apart.",
        )
    if half > UNCERTAIN * value:
        return NotObservable(
            CompensatorStiffness(),
            f"its effect on joint 2 is too small against the noise (K_c {value:.2g} ± {half:.2g} N/m)",
            f"Measure more and heavier loads at levels of q2 far apart (there are {levels}); a compensator that only "
            "balances the weights can not be seen in deflections.",
        )
    return None


def is_physical(fit: Fit) -> bool:
    """Return whether the compensator of a fit, if it has one, is one that could be built."""
    stiffness = fit.given.get(CompensatorStiffness())
    if stiffness is None:
        return True
    return stiffness > 0.0 and 0.0 <= fit.given[CompensatorPreload()] / stiffness <= _LONGEST_SPRING


def levels_of(data: Measurements) -> Ints:
    """Group the configurations (C,) by q2; angles within 2° share a level."""
    order = np.argsort(data.q[:, 1])
    steps = np.concatenate([[0], np.cumsum(np.diff(data.q[order, 1]) > _SAME_LEVEL)])
    level = np.empty(len(order), dtype=np.int64)
    level[order] = steps
    return level


def joint_torques(robot: RobotModel, data: Measurements) -> Array:
    """Return the torques (L, 6) of the loads about the joint axes [N·m]."""
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    config = data.state_config[data.loaded]
    x = elastostatics.coordinates(robot, data.q[config])
    _, jacobian = kinematics.tcp(robot.actual, x, tool)
    torque = np.einsum("lij,li->lj", jacobian, data.wrench[data.loaded])
    return np.asarray(torque[:, list(robot.actuated)])


def _joint_reason(
    parameter: JointCompliance, torque: Array, fit: Fit, index: int, half: float, correlation: Array
) -> NotObservable:
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
        return NotObservable(parameter, reason, advice)
    others = np.abs(correlation[index].copy())
    others[index] = 0.0
    partner = fit.structure.parameters[int(np.argmax(others))].symbol
    reason = f"its 95 % interval is ± {half * 1e6:.2g} µrad/(N·m) for a value of {fit.values[index] * 1e6:.3g}"
    if not np.isfinite(half):
        reason = "the configurations leave it open"
    if others.max() > 0.9:
        reason += (
            f", and it can hardly be separated from {partner} (correlation {correlation[index, np.argmax(others)]:.2f})"
        )
    return NotObservable(parameter, reason, f"Measure configurations that put more torque on A{joint + 1} alone.")


def _correlation(covariance: Array) -> Array:
    deviation = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(deviation, deviation)
    return np.asarray(np.nan_to_num(correlation))


def unloaded(robot: RobotModel, data: Measurements) -> tuple[JointCompliance, ...]:
    """Return the compliances of joints on which the loads put next to no torque."""
    largest = np.abs(joint_torques(robot, data)).max(axis=0)
    return tuple(p for p, value in zip(JOINT_COMPLIANCES, largest, strict=True) if value < _NO_TORQUE * largest.max())


def held_by_prior(fit: Fit, missing: list[NotObservable]) -> Fit:
    """Return the fit with the compliances of missing joints at the prior's values, as uncertain as the prior states."""
    robot, parameters = fit.structure.prior, fit.structure.parameters
    joints = [entry.parameter for entry in missing if isinstance(entry.parameter, JointCompliance)]
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
        covariance[index, index] = _stated(robot, joint) ** 2
    structure = replace(fit.structure, parameters=order)
    return replace(fit, structure=structure, values=values, covariance=covariance, design=design)


def _stated(robot: RobotModel, joint: Parameter) -> float:
    """Return the standard deviation of a joint compliance of the prior [rad/(N·m)]."""
    known = robot.covariance
    if known is not None and joint in known.parameters:
        index = known.parameters.index(joint)
        return float(np.sqrt(known.matrix[index, index])) / joint.per_si
    return _PUBLISHED * robot.value(joint)
