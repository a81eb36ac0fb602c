"""Fits of the elastic parameters: weighted least squares, and Bayesian regression with priors of physical size.

**Least squares** (`gauss_newton`): Gauss–Newton on the equilibrium.

**Linear equations** (`linearise`): the model is linear in its parameters to 0.3 %, so the derivatives at one point
predict fits without some configurations; no new models are needed.

**Priors** (`prior_of`): readings excite some parameters and not others. Each parameter is normal about a mean with a
spread of physical size. A parameter that the readings do not excite keeps that size and counts with it in the bound:

- compliance of a joint: about the stated one;
- parts of a gear (fading, up to a breakpoint) and rotations of links: a tenth of the joint's compliance;
- change of a joint's compliance over the pose (`over_pose`): a tenth of it, of all waves together; coupling of two
  joints: a tenth of the geometric mean of theirs;
- translations of links: 0.01 µm/N; backlash and lost motion: 20 µrad;
- masses, size of the compensator's torque: about the model's values, with the spread that the model states;
- K_c and K_c·s₀, where they are free: 10⁶ N/m, 10⁶ N.

**Regression** (`learn`): a size is common to all parameters of a kind, and is known to a factor only. Given readings y
of unit variance, derivatives D and a prior N(m, S²), y is normal about D·m with covariance φ·1 + D S² Dᵀ. The factors
in S and the noise factor φ ≥ 1 (residual beyond noise) maximise the density of y times that of the factors (evidence,
type-II maximum likelihood: MacKay, Neural Computation 4, 1992). The values are the most probable ones that are not
negative. The posterior covariance (DᵀD/φ + S⁻²)⁻¹ never exceeds S².
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.errors import MeasurementError, NotConvergedError, PostprocError
from postproc.frames import Array
from postproc.identification import over_pose
from postproc.identification.measurement_model import (
    Placement,
    Structure,
    coordinate_count,
    displacement_residuals,
    predict,
    whiten,
    whitened_derivatives,
    whitening,
)
from postproc.identification.readings import Measurements
from postproc.program import Bools, Ints
from postproc.robot import (
    BASE,
    JOINTS,
    Backlash,
    CompensatorTorque,
    FadingPart,
    GearCoupling,
    JointCompliance,
    Knee,
    LinkSpring,
    LostMotion,
    Parameter,
    PoseWave,
    RobotModel,
    Spring,
    file_slopes,
)

NORMAL_95 = 1.959964
"""Half width of a 95 % interval of a normal distribution, in standard deviations."""
LENGTH_95 = 1.6140
"""95 % quantile of the length of normal vectors in space over their RMS length."""

_MOST_ITERATIONS = 25
"""Limit of Gauss-Newton steps (assumed)."""
_MAX_GROWTH = 1.5
"""Growth of the squares that calls for a shorter step."""
_LEAST_EFFECT = 1e-6
"""Effect of a parameter of usual size on all readings, in σ, below which it has none."""


class Fit(Struct, frozen=True, eq=False):
    """Parameters that minimise the weighted squares of the residuals.

    Whitened readings are scaled and combined so that their noise is independent with variance 1.

    :param structure: the structure fitted.
    :param values: (p,) SI.
    :param covariance: (p, p), for noise σ as stated; infinite where the readings do not determine a value.
    :param residual: (L, P, 3) measured − predicted displacements [m], root axes.
    :param chi2: sum of squares of the whitened residuals, and `dof` its degrees of freedom.
    :param design: (rows, p) whitened derivatives at the solution, and `target` (rows,) the right side.
    """

    structure: Structure
    values: Array
    covariance: Array
    residual: Array
    chi2: float
    dof: int
    design: Array
    target: Array

    @classmethod
    def of(
        cls,
        structure: Structure,
        values: Array,
        data: Measurements,
        placement: Placement,
        *,
        covariance: Array,
        dof: int,
        prediction: Array,
        design: Array,
        target: Array | None = None,
    ) -> Fit:
        """Return the fit with values (p,) of the parameters [SI], with residuals and χ² of their prediction.

        :param prediction: (L, P, 3) displacements of the points in the loaded states, root axes [m].
        :param design: (rows, p) whitened derivatives.
        :param target: (rows,) right side of the equations; None: whitened residuals + design·values.
        """
        residual = displacement_residuals(prediction, data, placement)
        white_residual = whiten(whitening(data), residual).ravel()
        return cls(
            structure=structure,
            values=values,
            covariance=covariance,
            residual=residual,
            chi2=float(white_residual @ white_residual),
            dof=dof,
            design=design,
            target=white_residual + design @ values if target is None else target,
        )

    @property
    def robot(self) -> RobotModel:
        """The robot with the values of the fit."""
        return self.structure.robot(self.values)

    @property
    def rms(self) -> float:
        """RMS distance [m] of the points from their prediction; 0 without readings."""
        squares = np.sum(self.residual**2, axis=-1)  # exactly zero for points without a reading
        return float(np.sqrt(squares.sum() / max(1, np.count_nonzero(squares))))

    @property
    def ci95(self) -> Array:
        """Half widths (p,) of the 95 % intervals."""
        return np.asarray(NORMAL_95 * np.sqrt(np.diag(self.covariance)))

    @property
    def parameter_values(self) -> dict[Parameter, float]:
        """The values by parameter, SI."""
        return dict(zip(self.structure.parameters, self.values.tolist(), strict=True))


def gauss_newton(
    structure: Structure,
    data: Measurements,
    placement: Placement,
    start: Array | None = None,
    iterations: int = _MOST_ITERATIONS,
) -> Fit:
    """Return the least-squares fit of the parameters to loaded − unloaded displacements, by Gauss-Newton steps.

    :param start: (p,) values to begin with, SI; None: the robot's.
    :param iterations: largest number of steps; steps that are halved count too.
    :raises NotConvergedError: the springs have no equilibrium at the start, or at the values after the last step.
    """
    values = structure.start_values() if start is None else start.copy()
    whitening_matrices = whitening(data)
    last_good_values, smallest_cost = values, np.inf
    for _ in range(iterations):
        try:
            prediction, slopes = predict(structure, values, data, placement)
            white_residual = whiten(whitening_matrices, displacement_residuals(prediction, data, placement)).ravel()
            cost = float(white_residual @ white_residual)
        except NotConvergedError:
            if values is last_good_values:  # the start itself: there is no step to halve
                raise
            cost = np.inf
        if cost > _MAX_GROWTH * smallest_cost:  # the step was too large, or there is no equilibrium: halve it
            values = 0.5 * (last_good_values + values)
            continue
        last_good_values, smallest_cost = values, min(cost, smallest_cost)
        design = whitened_derivatives(whitening_matrices, slopes, data)
        # without effect on the readings a parameter would take any value: a column of zeros keeps it at zero
        design[:, np.linalg.norm(design, axis=0) * structure.usual_sizes() < _LEAST_EFFECT] = 0.0
        target = white_residual + design @ values
        new_values = solve(design, target)
        scale = np.linalg.norm(design, axis=0)
        change = float(np.max(np.abs((new_values - values) * scale), initial=0.0))
        values = new_values
        if change < 1e-4:  # of the whitened readings: far below their noise
            break
    return _fit_at(structure, values, data, placement)


def _fit_at(structure: Structure, values: Array, data: Measurements, placement: Placement) -> Fit:
    """Return the fit with values (p,) [SI] of the parameters: residuals, and the covariance of the values.

    The covariance is that of least squares with the derivatives of the prediction at these values.

    :raises NotConvergedError: the springs have no equilibrium under a load.
    """
    size = len(structure.parameters)
    prediction, slopes = predict(structure, values, data, placement)
    design = whitened_derivatives(whitening(data), slopes, data)
    return Fit.of(
        structure,
        values,
        data,
        placement,
        covariance=covariance_of(design, structure.usual_sizes()),
        dof=coordinate_count(data) - size,
        prediction=prediction,
        design=design,
    )


def solve(design: Array, target: Array) -> Array:
    """Return the least-squares parameters (p,) of design (r, p) and target (r,); columns are scaled to length 1."""
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0.0] = 1.0
    # rcond: directions that are rounding alone
    values, *_ = np.linalg.lstsq(design / scale, target, rcond=1e-9)
    return np.asarray(values / scale)


def covariance_of(design: Array, usual_sizes: Array) -> Array:
    """Return (DᵀD)⁻¹ (p, p) of a whitened design D (r, p); the variance of undetermined parameters is infinite.

    :param usual_sizes: (p,) of the parameters: a parameter is not determined if its usual size changes the readings by
        less than `_LEAST_EFFECT` σ.
    """
    scale = np.linalg.norm(design, axis=0)
    has_no_effect = scale * usual_sizes < _LEAST_EFFECT
    scale = np.where(has_no_effect, 1.0, scale)
    _, singular_values, directions = np.linalg.svd(design / scale, full_matrices=False)
    is_determined = singular_values > 1e-8 * singular_values.max(initial=0.0)  # below is rounding
    inverse = (directions[is_determined].T / singular_values[is_determined] ** 2) @ directions[is_determined]
    covariance = inverse / np.outer(scale, scale)
    # parameters with a component in a direction that is not determined; the limit is above rounding
    is_undetermined = np.sum(directions[~is_determined] ** 2, axis=0) > 1e-6
    for index in np.flatnonzero(has_no_effect | is_undetermined):
        covariance[index, :] = covariance[:, index] = 0.0
        covariance[index, index] = np.inf
    return np.asarray(covariance)


def correlations(covariance: Array) -> Array:
    """Return the correlations (p, p) of a covariance (p, p); 0 for parameters with a variance of zero or infinity."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(deviation, deviation)
    return np.asarray(np.nan_to_num(correlation, posinf=0.0, neginf=0.0))


class FileValues(NamedTuple):
    """Parameters of a fit in the units of `model.toml`.

    :param parameters: p of them.
    :param values: (p,).
    :param covariance: (p, p).
    """

    parameters: tuple[Parameter, ...]
    values: Array
    covariance: Array


def to_file_units(fit: Fit) -> FileValues:
    """Return parameters, values and covariance of a fit in the units of `model.toml`.

    k1…k6 become compliances at small torque, fading parts included; K_c·s₀ becomes s₀. The covariance is transformed
    at first order.

    :raises MeasurementError: a value or its variance is not finite.
    """
    parameters = fit.structure.parameters
    slopes = file_slopes(parameters, fit.parameter_values)
    values_and_slopes = [parameter.file_value(fit.parameter_values) for parameter in parameters]
    values = np.array([value for value, _ in values_and_slopes])
    is_finite = np.isfinite(values) & np.isfinite(fit.covariance).all(axis=1)
    if not is_finite.all():
        infinite_names = ", ".join(parameters[index].name for index in np.flatnonzero(~is_finite))
        raise MeasurementError(
            f"the fit has no finite value or variance for {infinite_names}",
            file="",
            advice="Measure configurations and loads that put torque on these joints.",
        )
    covariance = slopes @ fit.covariance @ slopes.T
    return FileValues(parameters, values, 0.5 * (covariance + covariance.T))  # symmetric, but for rounding


_HUBER_LIMIT = 3.5
"""Residual of a point, over the usual one, beyond which it is weighted down (Huber 1964)."""
_MEDIAN_OF_THREE = 1.538
"""Median length of a vector of three standard normal numbers."""


class NormalEquations(NamedTuple):
    """Normal equations of least squares with design D, weights W and target y; of one set or of several sets.

    :param square: (..., p, p) DᵀWD.
    :param right: (..., p) DᵀWy.
    :param square_sum: (...) yᵀWy.
    """

    square: Array
    right: Array
    square_sum: Array


class LinearEquations(Struct, frozen=True, eq=False, dict=True):
    """Whitened equations design·values = target.

    :param design: (rows, p), per SI unit of each parameter; rows are states, points, axes. Zero without a reading.
    :param target: (rows,).
    :param config: (rows,) index of the configuration of each equation.
    :param weight: (rows,) of each equation in the sum of squares; less than one for gross residuals.
    """

    design: Array
    target: Array
    config: Ints
    weight: Array

    @property
    def config_count(self) -> int:
        """Number of configurations."""
        return int(self.config.max()) + 1

    @cached_property
    def reading_count(self) -> int:
        """Number of equations that contain a reading."""
        return int(np.count_nonzero(np.linalg.norm(self.design, axis=1) > 0.0))

    @cached_property
    def equations_by_configuration(self) -> NormalEquations:
        """The normal equations of each configuration: (C, p, p), (C, p) and (C,)."""
        product = self.design * self.weight[:, None]
        masks = [self.config == index for index in range(self.config_count)]
        return NormalEquations(
            square=np.array([product[rows].T @ self.design[rows] for rows in masks]),
            right=np.array([product[rows].T @ self.target[rows] for rows in masks]),
            square_sum=np.array([float(self.weight[rows] @ self.target[rows] ** 2) for rows in masks]),
        )

    def normal_equations(self, columns: Ints, excluded_configs: Ints | None = None) -> NormalEquations:
        """Return the normal equations of n parameters: (n, n), (n,) and ().

        :param columns: (n,) indices of these parameters.
        :param excluded_configs: configurations to leave out; None: none.
        """
        sums = self._total_equations
        if excluded_configs is not None:
            excluded_sums = (term[excluded_configs].sum(axis=0) for term in self.equations_by_configuration)
            sums = NormalEquations(*(total - excluded for total, excluded in zip(sums, excluded_sums, strict=True)))
        return NormalEquations(sums.square[np.ix_(columns, columns)], sums.right[columns], sums.square_sum)

    @cached_property
    def _total_equations(self) -> NormalEquations:
        """The normal equations of all configurations together: (p, p), (p,) and ()."""
        square, right, square_sum = self.equations_by_configuration
        return NormalEquations(square.sum(axis=0), right.sum(axis=0), np.asarray(square_sum.sum()))

    def residual(self, values: Array, rows: Array | slice = slice(None)) -> Array:
        """Return the residuals target − design·values of some rows, by default of all; `values` (p,), SI."""
        return np.asarray(self.target[rows] - self.design[rows] @ values)

    def mean_squares(self, residual: Array) -> Array:
        """Return the mean of weight times square (C,) of residuals (rows,), for each configuration."""
        count = np.bincount(self.config)
        return np.asarray(np.bincount(self.config, weights=self.weight * residual**2) / count)


def linearise(structure: Structure, values: Array, data: Measurements, placement: Placement) -> LinearEquations:
    """Return the equations at some values of the parameters; points with gross residuals are weighted down.

    :param values: (p,) SI.
    :raises PostprocError: the springs have no equilibrium under a measured load.
    """
    whitening_matrices = whitening(data)
    prediction, slopes = predict(structure, values, data, placement)
    is_finite = np.isfinite(slopes).all(axis=(1, 2, 3)) & np.isfinite(prediction).all(axis=(1, 2))
    if not is_finite.all():
        state = int(data.loaded_states[np.argmin(is_finite)])
        raise PostprocError(
            f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}: these springs have no "
            "equilibrium under this load"
        )
    design = whitened_derivatives(whitening_matrices, slopes, data)
    white_residual = whiten(whitening_matrices, displacement_residuals(prediction, data, placement))
    weight = _robust_weights(np.linalg.norm(white_residual, axis=2))
    config = np.repeat(data.state_config[data.loaded_states], 3 * len(data.points))
    target = white_residual.ravel() + design @ values
    return LinearEquations(design, target, config, np.repeat(weight.ravel(), 3))


def _robust_weights(size: Array) -> Array:
    """Return the weights (L, P) of points: 1, and less if the whitened residual of the point is gross.

    Source: Huber, "Robust estimation of a location parameter", 1964. The usual size comes from the median.

    :param size: (L, P) lengths of the whitened residuals; zero for points without a reading.
    """
    usual_size = float(np.median(size[size > 0.0])) / _MEDIAN_OF_THREE if np.any(size > 0.0) else 1.0
    # 1e-12 σ: residuals that are rounding are not gross; 1e-300 keeps zero out of the denominator
    return np.minimum(1.0, _HUBER_LIMIT * max(usual_size, 1e-12) / np.maximum(size, 1e-300))


_LEAST_COMPLIANCE = 1e-9
"""Smallest compliance of a joint [rad/(N·m)] that sets a scale (assumed)."""
_SHARE_OF_JOINT = 0.1
"""Usual compliance of a part of a gear, and of a link's rotation, over that of the joint (assumed)."""

JOINT, STATED_SPREAD = "joint", ""
"""Kinds of parameters: joint compliances; parameters whose prior has a stated standard deviation without a factor."""
FACTORS: dict[str, tuple[float, float]] = {
    JOINT: (0.0, 0.7),
    "link translation": (0.0, 1.0),
    "link rotation": (0.0, 1.0),
    "end rotation": (-1.0, 1.5),
    "base translation": (-1.0, 1.5),
    "base rotation": (-2.0, 1.5),
    "fading": (0.0, 1.5),
    "breakpoint": (-1.0, 2.0),
    "backlash": (-2.0, 2.0),
    "lost motion": (-2.0, 2.0),
    "coupling": (0.0, 1.5),
    **{f"{joint} over the pose": (-0.5, 1.5) for joint in JOINTS},
    "compensator": (1.0, 1.0),
}
"""Factor on the size of each kind: mean and standard deviation of its logarithm."""


class Prior(Struct, frozen=True, eq=False):
    """Prior of p parameters, SI.

    :param mean: (p,).
    :param size: (p,) standard deviation at a factor of one.
    :param kind_index: (p,) index into `kinds`, −1 for parameters of a stated size. Parameters of a kind share a factor.
    :param kinds: keys of `FACTORS`.
    :param signed: (p,) whether the parameter may have either sign; else it is ≥ 0.
    """

    mean: Array
    size: Array
    kind_index: Ints
    kinds: tuple[str, ...]
    signed: Bools


def prior_of(structure: Structure) -> Prior:
    """Return the prior of the parameters of a structure.

    Means: the robot's values for joint compliances and for parameters of the kind `STATED_SPREAD`, else 0.
    """
    robot = structure.prior
    kinds_and_sizes = [_kind_and_size(parameter, robot) for parameter in structure.parameters]
    parameter_kinds = [kind for kind, _ in kinds_and_sizes]
    kinds = tuple(name for name in FACTORS if name in parameter_kinds)
    is_about_robot = np.array([kind in (JOINT, STATED_SPREAD) for kind in parameter_kinds], dtype=bool)
    is_signed = [
        kind == STATED_SPREAD or (isinstance(parameter, Spring) and parameter.signed)
        for kind, parameter in zip(parameter_kinds, structure.parameters, strict=True)
    ]
    return Prior(
        mean=np.where(is_about_robot, structure.start_values(), 0.0),
        size=np.array([size for _, size in kinds_and_sizes]),
        kind_index=np.array([kinds.index(kind) if kind in kinds else -1 for kind in parameter_kinds], dtype=np.int64),
        kinds=kinds,
        signed=np.array(is_signed, dtype=bool),
    )


def _kind_and_size(parameter: Parameter, robot: RobotModel) -> tuple[str, float]:
    """Return the kind of a parameter, a key of `FACTORS`, and the standard deviation of its prior at factor 1, SI.

    The kind is `STATED_SPREAD`, which has no factor, if the robot states the standard deviation of the prior, or if no
    other kind has the parameter: then the standard deviation is the usual size of the parameter.
    """
    sigma = robot.prior_sigma(parameter)
    if not isinstance(parameter, JointCompliance) and np.isfinite(sigma):
        return STATED_SPREAD, sigma
    joint_compliances = np.maximum(robot.compliance[list(robot.actuated)], _LEAST_COMPLIANCE)
    match parameter:
        case JointCompliance():
            return JOINT, float(joint_compliances[parameter.index])
        case LinkSpring():
            part = "base" if parameter.link == BASE else "end" if parameter.at_end else "link"
            if parameter.slides:
                return f"{part} translation", parameter.usual
            joint_compliance = joint_compliances[0 if parameter.link == BASE else JOINTS.index(parameter.link)]
            return f"{part} rotation", float(_SHARE_OF_JOINT * joint_compliance)
        case GearCoupling():
            coupled_compliances = joint_compliances[[JOINTS.index(parameter.joint), JOINTS.index(parameter.second)]]
            return "coupling", float(_SHARE_OF_JOINT * np.sqrt(coupled_compliances.prod()))  # geometric mean
        case PoseWave():
            size = (
                _SHARE_OF_JOINT
                * joint_compliances[JOINTS.index(parameter.joint)]
                * over_pose.amplitude_share(parameter)
            )
            return f"{parameter.joint} over the pose", float(size)
        case LostMotion() | Backlash():
            return "lost motion" if isinstance(parameter, LostMotion) else "backlash", parameter.usual
        case FadingPart():
            kind = "breakpoint" if isinstance(parameter, Knee) else "fading"
            return kind, float(_SHARE_OF_JOINT * joint_compliances[JOINTS.index(parameter.joint)])
        case CompensatorTorque():
            return "compensator", parameter.usual
    return STATED_SPREAD, parameter.usual


_MIN_LOG_FACTOR, _MAX_LOG_FACTOR = -6.0, 4.0
"""Limits of the logarithms of factors (assumed)."""
_MAX_LOG_NOISE = 4.0
"""Largest logarithm of φ; its prior is normal about 0 with standard deviation `_LOG_NOISE_SIGMA` (assumed)."""
_MOST_SEARCH_STEPS = 200
"""Limit of the steps of the search for the most evidence (assumed)."""
_LOG_NOISE_SIGMA = 0.5
"""Assumed: the stated noise is right within a factor of 1.6, by one standard deviation."""


class Regression(Struct, frozen=True, eq=False):
    """Regression of the readings on n of the p parameters.

    :param columns: (n,) their indices among the p parameters of the equations.
    :param mean: (n,) prior mean, SI.
    :param spread: (n,) prior standard deviation, SI.
    :param signed: (n,) whether the parameter may be negative.
    :param noise: factor φ on the variance of the readings.
    :param evidence: logarithm of the density of the readings and the factors.
    :param size: number p of parameters of the equations.
    """

    columns: Ints
    mean: Array
    spread: Array
    signed: Bools
    noise: float
    evidence: float
    size: int

    def solve(self, equations: LinearEquations, excluded_configs: Ints | None = None) -> Array:
        """Return the most probable values (p,), SI; zero for parameters that are not among the columns.

        Non-negative least squares (Lawson and Hanson 1974) on the normal equations N x = r. With the Cholesky factor
        N = Uᵀ U, the cost is |U x − t|² with Uᵀ t = r. Signed parameters s come first, so that U is triangular in
        blocks: non-negative parameters b minimise |U_bb x_b − t_b|², then U_ss x_s = t_s − U_sb x_b.

        :param excluded_configs: configurations to leave out; None: none.
        """
        from scipy.optimize import nnls  # takes long to import

        normal, right = self._normal(equations, excluded_configs)
        order, signed_count = np.argsort(~self.signed, kind="stable"), int(np.count_nonzero(self.signed))
        lower = np.linalg.cholesky(normal[np.ix_(order, order)])
        target, upper = np.linalg.solve(lower, right[order]), lower.T
        signed_part, bounded_part = slice(0, signed_count), slice(signed_count, None)  # of `order`; bounded: ≥ 0
        scaled_values = np.empty(len(order))
        # maxiter: far more than the steps that are usual, about one for each parameter
        scaled_values[bounded_part], _ = nnls(
            upper[bounded_part, bounded_part], target[bounded_part], maxiter=100 * len(order)
        )
        scaled_values[signed_part] = np.linalg.solve(
            upper[signed_part, signed_part],
            target[signed_part] - upper[signed_part, bounded_part] @ scaled_values[bounded_part],
        )
        values = np.zeros(self.size)
        values[self.columns[order]] = scaled_values * self.spread[order]
        return values

    def unbounded_values(self, equations: LinearEquations, excluded_configs: Ints | None = None) -> Array:
        """Return the most probable values (p,), SI, if all parameters may be negative; see `solve`."""
        normal, right = self._normal(equations, excluded_configs)
        values = np.zeros(self.size)
        values[self.columns] = np.linalg.solve(normal, right) * self.spread
        return values

    def covariance(self, equations: LinearEquations) -> Array:
        """Return the posterior covariance (p, p), SI; zero for parameters that are not among the columns."""
        normal, _ = self._normal(equations)
        matrix = np.zeros((self.size, self.size))
        matrix[np.ix_(self.columns, self.columns)] = np.linalg.inv(normal) * np.outer(self.spread, self.spread)
        return matrix

    def influence(self, equations: LinearEquations, values: Array) -> Array:
        """Return the derivatives (p, rows) of the values by the whitened readings.

        They are 0 for non-negative parameters at their bound 0, and for parameters that are not among the columns.

        :param values: (p,) result of `solve`, SI.
        """
        active = self._active_parameters(values)
        normal, _ = self._normal(equations)
        noise_weight = (equations.weight / self.noise)[:, None]
        design = equations.design[:, self.columns[active]] * self.spread[active] * noise_weight
        matrix = np.zeros((self.size, len(equations.target)))
        derivatives = np.linalg.solve(normal[np.ix_(active, active)], design.T)
        matrix[self.columns[active]] = self.spread[active, None] * derivatives
        return matrix

    def degrees_of_freedom(self, equations: LinearEquations, values: Array) -> float:
        """Return the effective number of parameters: tr(1 − (DᵀD/φ + S⁻²)⁻¹S⁻²).

        D is the design, φ the noise factor, S the prior standard deviations. Non-negative parameters at their bound 0
        do not count.

        :param values: (p,) result of `solve`, SI.
        """
        active = self._active_parameters(values)
        normal, _ = self._normal(equations)
        return float(len(active) - np.trace(np.linalg.inv(normal[np.ix_(active, active)])))

    def _active_parameters(self, values: Array) -> Ints:
        """Return the indices, from 0 to n − 1, of the parameters that are not at their bound 0; `values` (p,), SI."""
        return np.flatnonzero((values[self.columns] != 0.0) | self.signed)

    def _normal(self, equations: LinearEquations, excluded_configs: Ints | None = None) -> tuple[Array, Array]:
        """Return matrix (n, n) and right side (n,) of the normal equations, readings and prior together.

        The unknowns are the values, each over its prior standard deviation.

        :param excluded_configs: configurations to leave out; None: none.
        """
        square, right, _ = equations.normal_equations(self.columns, excluded_configs)
        normal = square * np.outer(self.spread, self.spread) / self.noise + np.eye(len(self.columns))
        return normal, right * self.spread / self.noise + self.mean / self.spread


class _Evidence(Struct, frozen=True, eq=False):
    """Evidence of the readings for factors on the prior standard deviations, and for the noise factor φ.

    With the whitened design D, the readings y, the prior N(m, S²) and the noise factor φ, y is normal about D·m with
    covariance φ·1 + D S² Dᵀ. S has one factor for each of k kinds of parameters. Factors and φ are given by `logs`
    (k + 1,), their natural logarithms, φ last; these have normal priors. The normal equations are those for deviations
    of n parameters from m, in units of their standard deviations at factor 1.

    :param square: (n, n) matrix of the normal equations, and `right` (n,) right side.
    :param square_sum: sum of the squares of the deviations of y from D·m.
    :param count: number of readings.
    :param kind_rows: for each of k kinds the indices of its parameters, from 0 to n − 1.
    :param log_mean: (k + 1,) prior mean of `logs`, and `log_sigma` (k + 1,) standard deviation.
    """

    square: Array
    right: Array
    square_sum: float
    count: int
    kind_rows: Sequence[Ints]
    log_mean: Array
    log_sigma: Array

    @classmethod
    def of(cls, equations: LinearEquations, prior: Prior, columns: Ints) -> _Evidence:
        """Return the evidence for n parameters; `columns` (n,): their indices among those of the equations."""
        size, mean = prior.size[columns], prior.mean[columns]
        kinds = [name for index, name in enumerate(prior.kinds) if (prior.kind_index[columns] == index).any()]
        square, right, target_square = equations.normal_equations(columns)
        log_priors = [*(FACTORS[name] for name in kinds), (0.0, _LOG_NOISE_SIGMA)]
        return cls(
            square=square * np.outer(size, size),
            right=(right - square @ mean) * size,
            square_sum=float(target_square) - 2.0 * float(mean @ right) + float(mean @ square @ mean),
            count=equations.reading_count,
            kind_rows=[np.flatnonzero(prior.kind_index[columns] == prior.kinds.index(name)) for name in kinds],
            log_mean=np.array([log_mean for log_mean, _ in log_priors]),
            log_sigma=np.array([log_sigma for _, log_sigma in log_priors]),
        )

    def factors(self, logs: Array) -> Array:
        """Return the factor (n,) on the standard deviation of each parameter; 1 for parameters of a stated size.

        :param logs: (k + 1,) see the class.
        """
        factor = np.ones(len(self.right))
        for log, rows in zip(logs[:-1], self.kind_rows, strict=True):
            factor[rows] = np.exp(log)
        return factor

    def cost(self, logs: Array) -> tuple[float, Array]:
        """Return −log evidence, up to a constant, and its derivatives (k + 1,) by `logs` (k + 1,), see the class.

        With N = 1 + S(DᵀD)S/φ and the most probable values x, over their standard deviations, it is
        ½(|y − DSx|²/φ + |x|² + count·log φ + log det N) plus the priors of `logs`. For the derivatives x counts as
        fixed, as it minimises the cost.
        """
        factor, noise = self.factors(logs), float(np.exp(logs[-1]))
        normal = np.eye(len(factor)) + factor[:, None] * self.square * factor / noise
        lower = np.linalg.cholesky(normal)
        inverse = np.linalg.inv(normal)
        values = inverse @ (factor * self.right) / noise  # over their standard deviations
        scaled_values = factor * values
        residual_sum = (
            self.square_sum
            - 2.0 * float(scaled_values @ self.right)
            + float(scaled_values @ self.square @ scaled_values)
        )
        log_determinant_half = float(np.log(np.diag(lower)).sum())
        likelihood_cost = 0.5 * (residual_sum / noise + values @ values + self.count * logs[-1]) + log_determinant_half
        information_share = 1.0 - np.diag(inverse)  # share of the readings, next to the prior, in each parameter
        slope = [float((information_share[rows] - values[rows] ** 2).sum()) for rows in self.kind_rows]
        slope.append(0.5 * (self.count - float(information_share.sum())) - 0.5 * residual_sum / noise)
        deviation = (logs - self.log_mean) / self.log_sigma
        return likelihood_cost + 0.5 * float(deviation @ deviation), np.array(slope) + deviation / self.log_sigma


def learn(equations: LinearEquations, prior: Prior, columns: Ints) -> Regression:
    """Return the regression on n parameters whose prior widths and noise factor maximise the evidence (MacKay 1992).

    Parameters of one kind share a factor on their prior widths.

    :param columns: (n,) indices of the parameters to use, among those of the equations.
    """
    from scipy.optimize import minimize  # takes long to import

    evidence = _Evidence.of(equations, prior, columns)
    limits = [*([(_MIN_LOG_FACTOR, _MAX_LOG_FACTOR)] * len(evidence.kind_rows)), (0.0, _MAX_LOG_NOISE)]
    optimum = minimize(
        evidence.cost,
        evidence.log_mean,
        jac=True,
        method="L-BFGS-B",
        bounds=limits,
        options={"maxiter": _MOST_SEARCH_STEPS},
    )
    return Regression(
        columns=columns,
        mean=prior.mean[columns],
        spread=prior.size[columns] * evidence.factors(optimum.x),
        signed=prior.signed[columns],
        noise=float(np.exp(optimum.x[-1])),
        evidence=0.5 * float(np.log(equations.weight).sum()) - float(optimum.fun),
        size=len(prior.size),
    )
