"""Knowledge of robot and forces before a test part is probed: a model and the scale of the forces, with covariance."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import MeasurementError
from postproc.frames import Array
from postproc.robot import Parameter, RobotModel, Spring, file_slopes

_UNMEASURED = 0.3
"""Relative standard deviation of a parameter of a robot that may have changed (assumed)."""
MIN_SHARE = 0.02
"""Least value of a compliance, and of the scale of the forces, as a share of its prior (assumed)."""


class Prior(Struct, frozen=True, eq=False):
    """Knowledge before the part is probed: model, covariance, forces.

    :param robot: the model.
    :param parameters: (p,) parameters of its covariance.
    :param order: (o,) these parameters, and the further ones that their values in model.toml depend on; the deflection
        is linear in the SI values of all of them.
    :param by_file: (o, p) derivatives of the SI values of `order` by the values of `parameters` in model.toml.
    :param covariance: (p + 1, p + 1) of the parameters, in the units of model.toml, and last of the scale of the
        forces: the factor of the real forces over the computed ones.
    """

    robot: RobotModel
    parameters: tuple[Parameter, ...]
    order: tuple[Parameter, ...]
    by_file: Array
    covariance: Array

    @classmethod
    def of(cls, robot: RobotModel, sigma_scale: float, law: tuple[float, ...] = ()) -> Prior:
        """Return the prior of a robot model: its parameters with their covariance, and the scale of the forces.

        :param sigma_scale: standard deviation of the scale of the forces.
        :param law: numbers of the cutting law that computes the forces. If the model was identified with the same law,
            the covariance of scale and compliances is that of the model.
        :raises MeasurementError: the model states no covariance and no `sigma_percent`.
        """
        if robot.covariance is None or not robot.covariance.parameters:
            raise MeasurementError(
                f"the model {robot.name} does not state how certain its values are",
                file=robot.name,
                advice="Give sigma_percent with the compliances of model.toml.",
            )
        parameters = robot.covariance.parameters
        order = tuple(
            dict.fromkeys([*parameters, *(partner for parameter in parameters for partner in parameter.partners())])
        )
        slopes = file_slopes(order, {parameter: robot.value(parameter) for parameter in order})
        by_file = np.asarray(np.linalg.inv(slopes)[:, [order.index(parameter) for parameter in parameters]])
        size = len(parameters)
        covariance = np.zeros((size + 1, size + 1))
        covariance[:size, :size], covariance[size, size] = robot.covariance.matrix, sigma_scale**2
        if robot.force_factor is not None and robot.force_factor.is_of(law):
            covariance[size] = covariance[:, size] = robot.force_factor.covariance
        return cls(robot, parameters, order, by_file, covariance)

    @property
    def sigma(self) -> Array:
        """(p + 1,) prior standard deviations of parameters, units of model.toml, and of the scale of the forces."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def has_forces_of_model(self) -> bool:
        """Whether the model was identified under the same cutting law: its parameters and the scale are correlated."""
        return bool(self.covariance[-1, :-1].any())

    @property
    def values(self) -> Array:
        """(p,) values of the parameters in units of model.toml."""
        robot_values = {parameter: self.robot.value(parameter) for parameter in self.order}
        return np.array([parameter.file_value(robot_values)[0] for parameter in self.parameters])

    @property
    def drift(self) -> Array:
        """(p + 1,) standard deviations of changes of the robot since its identification; 0 for the scale of forces."""
        return np.append(np.where(self.sigma[:-1] > 0.0, _UNMEASURED * self.values, 0.0), 0.0)

    def widen(self) -> Prior:
        """Return a wider prior: the squares of `drift`, of changes since identification, are added to the variances."""
        return replace(self, covariance=self.covariance + np.diag(self.drift**2))

    def robot_with_change(self, z: Array) -> RobotModel:
        """Return the robot with its parameters changed by z (p,), in units of model.toml.

        A positive compliance stays at `MIN_SHARE` of its value or above, because a negative one has no equilibrium.
        """
        changes = dict(zip(self.order, (self.by_file @ z).tolist(), strict=True))
        values = {}
        for parameter, change in changes.items():
            value = self.robot.value(parameter)
            smallest = MIN_SHARE * value if isinstance(parameter, Spring) and value > 0.0 else -np.inf
            values[parameter] = max(value + change, smallest)
        return self.robot.with_values(values)
