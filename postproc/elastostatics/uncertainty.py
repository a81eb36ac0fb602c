"""Uncertainty of the predicted deflection: 95 % bound, its sources, sensitivities to parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import kinematics
from postproc.chunks import Columns, chunks
from postproc.elastostatics.balance import (
    A2,
    StaticTorqueSlopes,
    compensator_factor,
    compliance_by_preload,
    coordinates,
    spring_deflection,
    static_torque,
)
from postproc.elastostatics.equilibrium import linear_compliance
from postproc.elastostatics.reversals import flank_covariance
from postproc.errors import ModelError
from postproc.frames import Array
from postproc.program import Bools
from postproc.robot import CompensatorTorque, Parameter, RobotModel, Spring, file_slopes

_QUANTILE_95 = 1.6448536
"""Of the normal distribution, one-sided."""
LENGTH_95 = 2.7954835
"""95 % of vectors of three standard normal numbers are shorter (χ² of three degrees of freedom)."""


class LoadedPlaces(Columns, frozen=True, eq=False):
    """Places of a robot under load, and what is known of the errors of their loads: a row for each of N places.

    :param q: (N, 6) joint angles [rad].
    :param tool: (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :param changes_flank: (N, 6) joints whose gears change their flank next to this place (`reversals`).
    :param is_proportional: (N,) places where the error of the wrench is one factor, `RobotModel.force_factor`,
        correlated with the parameters; `force_spread` does not count there.
    :param force_spread: (N, 6, 6) L of the covariance L·Lᵀ of the wrench, root axes; None if it is certain. (N, 6, 13)
        where errors may also be one factor: then six columns L for independent components, and seven for one factor.
    :param in_series: (N, 6, 6) compliance in series with the robot's, root axes; None if there is none.
    """

    q: Array
    tool: Array
    wrench: Array
    changes_flank: Bools
    is_proportional: Bools
    force_spread: Array | None
    in_series: Array | None

    @classmethod
    def of(
        cls,
        q: Array,
        tool: Array,
        wrench: Array,
        *,
        force_spread: Array | None = None,
        in_series: Array | None = None,
        changes_flank: Bools | None = None,
        is_proportional: Bools | None = None,
    ) -> LoadedPlaces:
        """Return the places; the parameters are those of the fields, with these defaults.

        :param tool: (4, 4) for all places, or (N, 4, 4).
        :param force_spread: None: the forces are certain.
        :param in_series: None: nothing but the robot is compliant.
        :param changes_flank: None: no gear is known to change its flank.
        :param is_proportional: None: nowhere.
        """
        return cls(
            q=q,
            tool=np.broadcast_to(tool, (len(q), 4, 4)),
            wrench=wrench,
            changes_flank=np.zeros((len(q), 6), dtype=bool) if changes_flank is None else changes_flank,
            is_proportional=np.zeros(len(q), dtype=bool) if is_proportional is None else is_proportional,
            force_spread=force_spread,
            in_series=in_series,
        )


def position_bound(
    robot: RobotModel,
    q: Array,
    tool: Array,
    wrench: Array,
    *,
    force_spread: Array | None = None,
    in_series: Array | None = None,
    changes_flank: Bools | None = None,
    is_proportional: Bools | None = None,
) -> Array | None:
    """Return the 95 % bound (N,) [m] on the error of the predicted position of the TCP; None without a covariance.

    Five sources, added as covariances: `RobotModel.covariance` through the sensitivity of the TCP to each identified
    parameter, at first order; the covariance of the wrench through the tangent compliance; the unmodelled error
    (`RobotModel.discrepancy`), in any direction; the unknown flanks of gears with lost motion (`flank_covariance`); and
    the error of a calibrated geometry without load (`RobotModel.geometry_error`).

    **Correlated forces.** If the components of a wrench w are off by one factor of standard deviation f (a harder
    material, a worn tool), their displacements C·w add up with their signs: the covariance is f²·(C w)(C w)ᵀ (JCGM
    100:2008, "Guide to the expression of uncertainty in measurement", 5.2.2: inputs with correlation +1 add
    linearly). If they are independent, it is f²·C diag(w²) Cᵀ. With a correlation ρ between, it is ρ times the former
    plus 1 − ρ times the latter. ρ is not known, since published sets of coefficients differ in size and in ratios. The
    covariance is linear in ρ, so its trace is largest at one of the two ends: the larger of their bounds counts.

    The parameters from `q` on are those of `LoadedPlaces.of`.

    :raises ModelError: the covariance is of a parameter that the model does not have.
    """
    if robot.covariance is None:
        return None
    places = LoadedPlaces.of(
        q,
        tool,
        wrench,
        force_spread=force_spread,
        in_series=in_series,
        changes_flank=changes_flank,
        is_proportional=is_proportional,
    )
    parts = (sources_of_error(robot, places.take(part)).covariances() for part in chunks(len(q)))
    return np.concatenate([largest_length(covariances) for covariances in parts])


class SourcesOfError(Struct, frozen=True, eq=False):
    """Errors of the predicted position at n places, at first order, by their sources; root axes [m].

    :param slopes: (n, 3, P) displacement for one unit of each parameter; with a factor of forces it is the last one.
    :param covariance: (P, P) of the parameters.
    :param force_displacements: for each possible correlation of the components of a wrench, (n, 3, k) displacements by
        one standard deviation of k independent causes; one entry or two.
    :param other_covariances: (n, 3, 3) covariances by sources that are neither parameters nor forces, by name.
    """

    slopes: Array
    covariance: Array
    force_displacements: tuple[Array, ...]
    other_covariances: dict[str, Array]

    @property
    def robot_covariance(self) -> Array:
        """(n, 3, 3) covariance by all sources but the forces."""
        by_parameters = self.slopes @ self.covariance @ np.swapaxes(self.slopes, 1, 2)
        return sum(self.other_covariances.values(), by_parameters)

    def with_parameters(self, slopes: Array, covariance: Array) -> SourcesOfError:
        """Return the errors with k more parameters.

        :param slopes: (n, 3, k) displacement for one unit of each; `covariance` (k, k), independent of the others.
        """
        size = len(self.covariance)
        joint = np.zeros((size + len(covariance), size + len(covariance)))
        joint[:size, :size], joint[size:, size:] = self.covariance, covariance
        return replace(self, slopes=np.concatenate([self.slopes, slopes], axis=2), covariance=joint)

    def covariances(self) -> list[Array]:
        """Return the covariance (n, 3, 3) of the position for each correlation of the forces that is possible."""
        robot_covariance = self.robot_covariance
        return [
            robot_covariance + displacement @ np.swapaxes(displacement, 1, 2)
            for displacement in self.force_displacements
        ]


def sources_of_error(robot: RobotModel, places: LoadedPlaces) -> SourcesOfError:
    """Return the errors of the predicted position at some places by their sources, see `position_bound`.

    :param robot: with a covariance.
    :raises ModelError: the covariance is of a parameter that the model does not have.
    """
    reaction = None if places.force_spread is None else _displacement_per_wrench(robot, places)
    slopes, covariance = _parameter_errors(robot, places, reaction)
    return SourcesOfError(slopes, covariance, _force_displacements(places, reaction), _other_covariances(robot, places))


def largest_length(covariances: Sequence[Array], mean: Array | None = None) -> Array:
    """Return the largest 95 % quantile (n,) of the length of normal vectors, for several covariances (n, 3, 3).

    :param mean: (n, 3) mean of the vectors; None: zero.
    """
    return np.asarray(np.max([length_bound(covariance, mean) for covariance in covariances], axis=0))


def _displacement_per_wrench(robot: RobotModel, places: LoadedPlaces) -> Array:
    """Return the displacement (N, 3, 6) of the tool per unit of the wrench [m/N, m/(N·m)], root axes."""
    compliance = linear_compliance(robot, places.q, places.tool, places.wrench)
    if places.in_series is not None:
        compliance = compliance + places.in_series
    return compliance[:, :3]


class _ParameterErrors(NamedTuple):
    """Sensitivities (N, 3, P) of the position to P parameters, and the covariance (P, P) of these."""

    slopes: Array
    covariance: Array


def _parameter_errors(robot: RobotModel, places: LoadedPlaces, reaction: Array | None) -> _ParameterErrors:
    """Return the errors by the parameters of a model, the last of which is the factor of the forces if it counts.

    :param reaction: (N, 3, 6) displacement per wrench; None if the forces are certain: then the factor does not count.
    """
    assert robot.covariance is not None
    slopes = sensitivity(robot, places.q, places.tool, places.wrench)
    matrix, factor = robot.covariance.matrix, robot.force_factor
    if factor is None or reaction is None or not places.is_proportional.any():
        return _ParameterErrors(slopes, matrix)
    by_factor = np.einsum("nij,nj->ni", reaction, places.wrench) * places.is_proportional[:, None]
    size = len(matrix)
    matrix_with_factor = np.empty((size + 1, size + 1))
    matrix_with_factor[:size, :size] = matrix
    matrix_with_factor[size], matrix_with_factor[:, size] = factor.covariance, factor.covariance
    return _ParameterErrors(np.concatenate([slopes, by_factor[:, :, None]], axis=2), matrix_with_factor)


def _other_covariances(robot: RobotModel, places: LoadedPlaces) -> dict[str, Array]:
    """Return the covariances (N, 3, 3) [m²] of the position that come from neither parameters nor forces, by source."""
    covariances = {}
    if robot.geometry_error is not None:
        covariances["the calibrated geometry"] = _isotropic_covariances(robot.geometry_error.at(places.q))
    if robot.discrepancy is not None:
        covariances["the unmodelled error of the robot model"] = _isotropic_covariances(
            robot.discrepancy.at(places.wrench)
        )
    covariances["lost motion of the gears"] = flank_covariance(
        robot, places.q, places.tool, places.wrench, places.changes_flank
    )
    return covariances


_COMPONENTS = 6
"""Columns of `force_spread` for independent components of the wrench."""


def _force_displacements(places: LoadedPlaces, reaction: Array | None) -> tuple[Array, ...]:
    """Return the displacements (N, 3, k) by one standard deviation of each force component, or of a common factor.

    Errors of the components are either independent, or all in proportion to one factor; both are returned if unknown.

    A standard deviation makes a component of the wrench larger in size, whatever its sign. Where the error of the
    cutting law is counted as a parameter already (`RobotModel.force_factor`), only the other errors are returned.

    :param reaction: (N, 3, 6) displacement per wrench; None if the forces are certain: then k is 0.
    :returns: one entry for independent components alone; two if errors may also be one factor: for independent
        components, and for one factor, whose last column is the error of the cutting law.
    """
    spread, is_proportional = places.force_spread, places.is_proportional
    if spread is None or reaction is None:
        return (np.zeros((len(is_proportional), 3, 0)),)
    sign = np.where(np.einsum("nik,ni->nk", spread, places.wrench) < 0.0, -1.0, 1.0)
    displacement = reaction @ (spread * sign[:, None])
    may_be_one_factor = spread.shape[2] > _COMPONENTS  # see `LoadedPlaces.force_spread`
    if not may_be_one_factor:
        return (displacement * ~is_proportional[:, None, None],)
    independent, by_factor = displacement[:, :, :_COMPONENTS], displacement[:, :, _COMPONENTS:]
    # without the error of the cutting law both correlations are one
    by_factor[is_proportional, :, -1] = 0.0
    other_columns = by_factor.shape[2] - 1
    independent[is_proportional] = 0.0
    independent[is_proportional, :, :other_columns] = by_factor[is_proportional, :, :other_columns]
    return independent, by_factor


def _isotropic_covariances(length: Array) -> Array:
    """Return the covariances (N, 3, 3) of errors whose length stays below `length` (N,) in 95 % of cases."""
    return np.asarray((length / LENGTH_95)[:, None, None] ** 2 * np.eye(3))


def length_bound(covariance: Array, mean: Array | None = None) -> Array:
    """Return the 95 % quantile (n,) of the length of normal vectors with covariances (n, 3, 3).

    It follows from the first two moments of the squared length. Without mean, |e|² ~ g·χ²_h with g = tr Σ²/tr Σ and
    h = tr² Σ/tr Σ² (Satterthwaite 1946). With a mean μ the expectation is |μ|² + tr Σ and the variance 2 tr Σ² + 4 μᵀΣμ
    (Mathai and Provost, "Quadratic forms in random variables", 1992, 3.2b), and χ² is fitted to both in the same way
    (Patnaik 1949). The quantile of χ² is that of Wilson and Hilferty (1931).

    :param mean: (n, 3) mean of the vectors; None: zero.
    """
    # of the squared length; tr Σ² is the sum of squares, Σ being symmetric
    expectation = np.trace(covariance, axis1=1, axis2=2)
    half_variance = np.sum(covariance**2, axis=(1, 2))
    if mean is not None:
        expectation = expectation + np.sum(mean**2, axis=1)
        half_variance = half_variance + 2.0 * np.einsum("ni,nij,nj->n", mean, covariance, mean)
    h = np.divide(expectation**2, half_variance, out=np.ones_like(expectation), where=half_variance > 0.0)
    g = np.divide(half_variance, expectation, out=np.zeros_like(expectation), where=expectation > 0.0)
    quantile = h * (1.0 - 2.0 / (9.0 * h) + _QUANTILE_95 * np.sqrt(2.0 / (9.0 * h))) ** 3
    square = np.where(half_variance > 0.0, g * quantile, expectation)  # without variance the length is |μ|
    return np.asarray(np.sqrt(square))


def sensitivity(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> Array:
    """Return (N, 3, P) ∂(position of the TCP)/∂(parameter), in m per unit of the file, at first order in the load.

    The parameters are those of `robot.covariance`, as files hold them: whole, each at fixed values of the others.

    :param q: (N, 6) joint angles that the controller holds [rad].
    :param tool: (4, 4) or (N, 4, 4) tool in the flange frame [m].
    :param wrench: (N, 6) at the TCP, root axes [N, N·m].
    :raises ModelError: the model does not have a parameter, or the covariance is of a compensator without spring.
    """
    parameters = robot.covariance.parameters if robot.covariance is not None else ()
    if not parameters:
        return np.zeros((len(q), 3, 0))
    # the covariance's parameters first, then partners that it does not name
    order = list(dict.fromkeys([*parameters, *(p for owner in parameters for p in owner.partners())]))
    file_by_linear = file_slopes(order, {parameter: robot.value(parameter) for parameter in order})
    try:
        linear_by_file = np.linalg.inv(file_by_linear)[:, : len(parameters)]
    except np.linalg.LinAlgError:
        raise ModelError(
            "[covariance] is of a compensator that has no spring",
            advice="Identify the model anew, or remove [covariance].",
        ) from None
    return np.asarray(_linear_sensitivity(robot, order, q, tool, wrench) @ linear_by_file)


class _FirstOrder(Struct, frozen=True, eq=False):
    """Springs of a robot at n places at first order in the load: torques as without deflection.

    :param x: (nv, n) coordinates.
    :param lever: (n, 3, nv) displacement of the tool by the deflection of each spring, root axes.
    :param torque: (nv, n) on the springs, without the compensator's part [N·m, N].
    :param preload: (nv, n) torque at rest on gears that are not linear [N·m, N].
    :param theta: (nv, n) deflections [rad, m].
    :param slope: (nv, n) tangent compliances [rad/(N·m), m/N].
    """

    x: Array
    lever: Array
    torque: Array
    preload: Array
    theta: Array
    slope: Array


def _linear_sensitivity(
    robot: RobotModel, parameters: Sequence[Parameter], q: Array, tool: Array, wrench: Array
) -> Array:
    """Return ∂(position of the TCP)/∂(linear value) (N, 3, P) of parameters [m per SI unit].

    A parameter p of the static torque T changes the deflection θ = c(τ, τ⁰) by the preload τ⁰ = −T: by −∂c/∂τ⁰·∂T/∂p.
    One of the compensator also changes its stiffness U_c″, which takes a part of the torque on joint 2: that adds
    −∂c/∂τ·θ₂·∂U_c″/∂p.
    """
    state = _first_order_springs(robot, q, tool, wrench)
    by_preload = compliance_by_preload(robot, state.torque, state.preload)
    static_slopes = StaticTorqueSlopes(robot, state.x)
    a2 = robot.actuated[A2]
    columns = []
    for parameter in parameters:
        if isinstance(parameter, Spring):
            columns.append(_displacement_by_spring(robot, state, parameter))
            continue
        theta_slope = -by_preload * static_slopes.slope(parameter)
        if isinstance(parameter, CompensatorTorque) and robot.compensator is not None:
            _, stiffness = parameter.effect(robot.compensator, state.x[a2])
            theta_slope[a2] -= state.slope[a2] * state.theta[a2] * stiffness
        columns.append(np.einsum("nik,nk->ni", state.lever, theta_slope.T))
    return np.stack(columns, axis=2)


def _first_order_springs(robot: RobotModel, q: Array, tool: Array, wrench: Array) -> _FirstOrder:
    """Return the springs under a load at first order; parameters as of `sensitivity`."""
    x = coordinates(robot, q).T
    _, jacobian = kinematics.tcp(robot.loaded, x.T, tool)
    torque = np.einsum("nij,ni->jn", jacobian, wrench) - _payload_torque(robot, x)
    preload = np.zeros_like(torque)
    if robot.carries_weight or not robot.subtract_reference:
        preload = -static_torque(robot, x)
    _, slope = spring_deflection(robot, x, torque, preload)
    factor, a2 = compensator_factor(robot, x, slope), robot.actuated[A2]
    torque[a2] /= factor  # the compensator carries the rest
    theta, slope = spring_deflection(robot, x, torque, preload)
    lever = jacobian[:, :3].copy()
    lever[:, :, a2] /= factor[:, None]
    return _FirstOrder(x, lever, torque, preload, theta, slope)


def _displacement_by_spring(robot: RobotModel, state: _FirstOrder, parameter: Spring) -> Array:
    """Return the displacement (n, 3) of the TCP per unit of the parameter of a spring [m per SI unit]."""
    factor = parameter.factor(state.x[list(robot.actuated)])
    displacement = np.zeros((len(state.lever), 3))
    for row, torque_row in robot.pairs(parameter):
        unit_deflection, _ = parameter.effect(state.torque[torque_row], state.preload[torque_row])
        displacement += state.lever[:, :, row] * (factor * unit_deflection)[:, None]
    return displacement


def _payload_torque(robot: RobotModel, x: Array) -> Array:
    """Return the torque (nv, n) [N·m, N] of the cell's payload at coordinates x (nv, n)."""
    if robot.loaded is robot.actual:
        return np.zeros_like(x)
    with_payload, without_payload = (
        kinematics.posture(chain, x, weigh=True).weight_torques() for chain in (robot.loaded, robot.actual)
    )
    return np.asarray(with_payload - without_payload)
