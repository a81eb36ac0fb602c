"""Calibration of the geometry from readings without load: displacements of the joint axes from the nominal geometry.

The set of parameters is non-redundant. Of all displacements of A1…A6 (six each), in the order zero offsets, lengths,
tilts, those are kept that the base transform, the reference points and the parameters before cannot imitate: 4·6 + 6 =
30 for a chain of six revolute joints, less 6 of the base and 6 of the points (Everett, Driels, Mooring 1987).

The springs of the model predict the sag under own weight, so the result is the geometry of the weightless robot.
Cross-validation decides whether that describes the readings better, and whether gears have errors of one and two
periods a turn (`robot.Transmission`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct

from postproc import elastostatics, kinematics
from postproc.errors import MeasurementError, PostprocError
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, displace
from postproc.identification import record
from postproc.identification.fit import LENGTH_95, NORMAL_95
from postproc.identification.measurement_model import Placement, kabsch, placement_derivatives, point_positions
from postproc.identification.outlying_configuration import check_configurations
from postproc.identification.readings import Measurements
from postproc.robot import GEAR_TERMS, LINK_AXES, PER_URAD, Chain, RobotModel, assemble, waves
from postproc.robot.model_file import (
    JOINTS,
    Displacement,
    GeometryErrorEntry,
    Gravity,
    ModelFile,
    TransmissionEntry,
)

_AXES = LINK_AXES[:6]
_WEIGHTLESS: Final = "rigid"
_AT_REST: Final = "calibrated"
"""[gravity] reference of model.toml: the geometry is that of the weightless robot, to which the sag is added; or that
of the robot at rest, which contains the sag."""
_USUAL_SHIFT, _USUAL_TURN, _USUAL_WAVE = 1e-3, 2e-3, 0.3e-3
"""Prior standard deviations of the errors of a joint (shift [m], turn [rad]) and its gear [rad] (assumed)."""
_MOST_STEPS = 8
"""Gauss-Newton steps from the nominal geometry, which is close (assumed)."""
_FOLDS = 10
"""Parts of the cross-validation: the usual number (Hastie, Tibshirani and Friedman 2009, section 7.10)."""
_INDEPENDENT_SHARE = 1e-6
"""Share of a column that the columns before it leave, below which it is dependent: the rounding of derivatives."""
_SPARE_READINGS = 10
"""Coordinates that must be read beyond the number of unknowns, so that residuals show the noise (assumed)."""
_WIDE_SHARE = 0.8
"""Share of the prior's interval beyond which an interval counts as not narrowed by the readings (assumed)."""
_STEP_TOLERANCE = 1e-9
"""Largest change of an unknown [m, rad] in the last Gauss-Newton step."""
_AVERAGED_CONFIGURATIONS = 200
"""Random configurations over which the error that readings allow for is averaged."""


class GeometryParameter(Struct, frozen=True):
    """Displacement of a joint along or about one axis of its nominal frame, or (``A2.sin2``) an error of its gear.

    :param joint: A1 to A6.
    :param axis: X, Y, Z for shifts, RX, RY, RZ for turns, or one of `GEAR_TERMS`.
    """

    joint: str
    axis: str

    @property
    def unit_and_factor(self) -> tuple[str, float]:
        """Return the unit of the parameter in files, and the factor from SI to this unit."""
        if self.axis in GEAR_TERMS:
            return "urad", PER_URAD
        return ("deg", DEG_PER_RAD) if self.axis.startswith("R") else ("mm", MM_PER_M)

    @property
    def usual_size(self) -> float:
        """Return the prior standard deviation [m, rad]."""
        if self.axis in GEAR_TERMS:
            return _USUAL_WAVE
        return _USUAL_TURN if self.axis.startswith("R") else _USUAL_SHIFT

    @property
    def name(self) -> str:
        """Return e.g. ``A2.RY``."""
        return f"{self.joint}.{self.axis}"


class Geometry(Struct, frozen=True, eq=False):
    """Calibrated geometry.

    :param parameters: identified parameters, in order.
    :param values: (n,) [m, rad].
    :param covariance: (n, n).
    :param content: model file with `[geometry]` and the gravity reference that belongs to it.
    :param placement: base transform and points of the same fit.
    :param is_weightless: whether the geometry is that of the weightless robot, to which the sag is added.
    :param rms: variant → RMS distance of the points [m] in the fit, and on configurations left out.
    :param chosen: the variant whose geometry this is.
    :param u95: 95 % quantile of the cross-validation errors, noise removed [m].
    :param not_observable: names of parameters whose interval the readings do not narrow.
    """

    parameters: tuple[GeometryParameter, ...]
    values: Array
    covariance: Array
    content: ModelFile
    placement: Placement
    is_weightless: bool
    rms: dict[str, tuple[float, float]]
    chosen: str
    u95: float
    not_observable: tuple[str, ...]

    @property
    def ci95(self) -> Array:
        """Half widths (n,) of the 95 % intervals [m, rad]."""
        return np.asarray(NORMAL_95 * np.sqrt(np.diag(self.covariance)))


def nonredundant_displacements(nominal: Chain, point_count: int) -> tuple[GeometryParameter, ...]:
    """Return the displacements of joints that base transform, points and the displacements before cannot imitate.

    Independence is decided by the rank of the derivatives at random configurations, so it is valid for any arm.

    :param point_count: number of points on the flange.
    :returns: sorted by joint, then axis.
    """
    # a dependent column is dependent at all configurations: some tens are enough, with joints far from 0
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (60, 6))
    # [m], not on one line; points beyond three make no further displacement independent
    offsets = np.array([[0.2, 0.1, 0.3], [-0.2, 0.15, 0.25], [0.05, -0.3, 0.2]])[: max(1, min(point_count, 3))]
    flange, columns = _joint_derivatives(nominal, q, offsets)
    basis, _ = np.linalg.qr(_placement_columns(flange, offsets, np.eye(4)))
    independent: list[tuple[int, int]] = []
    for joint, axis in _displacement_order(nominal):
        column = columns[:, joint, axis]
        residual = column - basis @ (basis.T @ column)
        residual -= basis @ (basis.T @ residual)  # once more, for rounding (Gram-Schmidt)
        if np.linalg.norm(residual) > _INDEPENDENT_SHARE * np.linalg.norm(column):
            basis = np.column_stack([basis, residual / np.linalg.norm(residual)])
            independent.append((joint, axis))
    return tuple(GeometryParameter(JOINTS[joint], _AXES[axis]) for joint, axis in sorted(independent))


def _displacement_order(nominal: Chain) -> list[tuple[int, int]]:
    """Return all displacements of the joints, each once, as pairs of joint (0…5) and axis (0…5: X, Y, Z, RX, RY, RZ).

    Zero offsets, which are turns about the axis of the joint itself, come first, then lengths, then tilts.
    """
    zero_offset_axis = 3 + np.argmax(np.abs(nominal.axis), axis=1)
    order = [(joint, int(zero_offset_axis[joint])) for joint in range(6)]
    order += [(joint, axis) for joint in range(6) for axis in range(3)]
    order += [(joint, 3 + axis) for joint in range(6) for axis in range(3)]
    return list(dict.fromkeys(order))


def _joint_derivatives(chain: Chain, q: Array, points: Array) -> tuple[Array, Array]:
    """Return flange poses (C, 4, 4) [m] and derivatives (C·P·3, 6, 6) of the points by displacements of the joints.

    :param q: (C, 6) joint angles [rad].
    :param points: (P, 3) in the flange frame [m].
    :returns: the poses; rows: coordinates of the points in the root; then the joint, and its displacements along and
        about X, Y, Z of its frame [m/m, m/rad].
    """
    frames, flange = chain.joint_frames(q)
    positions = point_positions(flange, points)
    columns = np.empty((len(q), len(points), 3, 6, 6))
    for joint in range(6):
        lever = positions - frames[:, joint, None, :3, 3]
        for axis in range(3):
            direction = frames[:, joint, :3, axis]
            columns[..., joint, axis] = direction[:, None]
            columns[..., joint, 3 + axis] = np.cross(direction[:, None], lever)
    return flange, columns.reshape(-1, 6, 6)


def _placement_columns(flange: Array, points: Array, root: Array) -> Array:
    """Return derivatives (3CP, 6 + 3P) of P points in C configurations in device axes: by the root, then by the points.

    The first six columns are by the twist of the root: translation, then rotation.

    :param flange: (C, 4, 4) in the root [m].
    :param points: (P, 3) in the flange frame [m].
    :param root: (4, 4) in the device [m].
    """
    device_flange = root @ flange
    positions = point_positions(device_flange, points)
    slopes = placement_derivatives(positions, root[:3, 3], device_flange[:, :3, :3])
    return slopes.reshape(-1, 6 + 3 * len(points))


def identify_geometry(content: ModelFile, nominal: Chain, name: str, data: Measurements) -> Geometry:
    """Identify the geometry from the readings without load: fit all variants, and take the simplest good one.

    :param content: model whose springs, masses and compensator predict the sag; its `[geometry]` is replaced.
    :param nominal: the controller's geometry.
    :param name: of the robot.
    :raises MeasurementError: fewer readings than unknowns, or a configuration contradicts all others.
    """
    fits = _fitted_variants(content, nominal, name, data)
    best_label = simplest_variant({label: fold_errors for label, (_, fold_errors) in fits.items()})
    solution, fold_errors = fits[best_label]
    half_width = NORMAL_95 * np.sqrt(np.diag(solution.covariance))
    source, u95 = f"identified from {data.file}", _error_95(fold_errors, data)
    error = GeometryErrorEntry(
        source=source,
        u95_mm=u95 * MM_PER_M,
        angles_deg=_ranges(data.q),
        unmeasured_mm=_extrapolation_error(solution, nominal) * MM_PER_M,
    )
    calibrated_content = _add_geometry(solution.content, solution.parameters, solution.values, source, half_width)
    _check_configurations(assemble(name, calibrated_content, nominal), data, solution)
    is_wide = half_width > _WIDE_SHARE * NORMAL_95 * _usual_sizes(solution.parameters)
    return Geometry(
        parameters=solution.parameters,
        values=solution.values,
        covariance=solution.covariance,
        content=msgspec.structs.replace(calibrated_content, geometry_error=error),
        placement=solution.placement,
        is_weightless=solution.content.gravity.reference == _WEIGHTLESS,
        rms={label: (_rms(fit.residual), float(np.sqrt(np.mean(errors)))) for label, (fit, errors) in fits.items()},
        chosen=best_label,
        u95=u95,
        not_observable=tuple(solution.parameters[index].name for index in np.flatnonzero(is_wide)),
    )


def _fitted_variants(
    content: ModelFile, nominal: Chain, name: str, data: Measurements
) -> dict[str, tuple[_Solution, Array]]:
    """Return the fit of each variant of the geometry, simple to rich, and its cross-validation errors (C,) [m²].

    Variants that cannot be fitted are left out. For the parameters see `identify_geometry`.

    :raises MeasurementError: there are fewer readings than unknowns.
    """
    parameters = nonredundant_displacements(nominal, len(data.points))
    unknowns = 6 + 3 * len(data.points) + len(parameters)
    readings = 3 * len(data.q) * len(data.points)
    if readings < unknowns + _SPARE_READINGS:
        raise MeasurementError(
            f"{readings} coordinates without load for {unknowns} unknowns of base, points and geometry",
            file=data.file,
            advice="Measure more configurations: 30 of three points are usual.",
        )
    with_gears = readings >= unknowns + len(_GEAR_ERRORS) + _SPARE_READINGS
    fits: dict[str, tuple[_Solution, Array]] = {}
    for variant in _variants(content, parameters, with_gears=with_gears):
        try:
            solution = _fit_geometry(variant.content, nominal, name, data, variant.parameters)
        except PostprocError:  # a model that cannot carry its own weight, or values beyond any arm
            continue
        fits[variant.label] = solution, _cross_validation_error(solution, data)
    return fits


def _check_configurations(robot: RobotModel, data: Measurements, solution: _Solution) -> None:
    """Check that no configuration contradicts all others in the fit of the geometry.

    :param robot: with the calibrated geometry.
    :raises MeasurementError: a configuration does.
    """
    whitening = solution.whitening.reshape(len(data.q), -1)
    readings_design, prior_rows = np.split(solution.design, [whitening.size])  # rows of the prior follow the readings
    design = readings_design.reshape(*whitening.shape, -1)
    check_configurations(robot, data, solution.placement, design, prior_rows, whitening)


def _rms(residual: Array) -> float:
    """Return the RMS length [m] of the residuals (C, P, 3) of points."""
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=2))))


def _ranges(q: Array) -> dict[str, tuple[float, float]]:
    """Return least and largest angle [deg] of each joint in configurations (C, 6) [rad]."""
    lower, upper = (angle * DEG_PER_RAD for angle in (q.min(axis=0), q.max(axis=0)))
    return {joint: (float(low), float(high)) for joint, low, high in zip(JOINTS, lower, upper, strict=True)}


_GEAR_ERRORS = tuple(GeometryParameter(joint, term) for joint in JOINTS for term in GEAR_TERMS)
"""Errors of the gears' transmission, of all joints."""


class _Variant(NamedTuple):
    """A geometry that is tried.

    :param label: for the user.
    :param content: model; it predicts the sag if its geometry is that of the weightless robot.
    :param parameters: the free ones.
    """

    label: str
    content: ModelFile
    parameters: tuple[GeometryParameter, ...]


def _variants(content: ModelFile, parameters: tuple[GeometryParameter, ...], *, with_gears: bool) -> list[_Variant]:
    """Return the geometries that are tried, simple to rich: nominal and calibrated, each without and with sag.

    With sag the geometry is that of the weightless robot, and the springs of the model add the sag by its weight.

    :param content: model whose geometry is replaced.
    :param parameters: of the calibrated geometry.
    :param with_gears: whether the calibrated geometries are tried with errors of the gears too.
    """
    without_sag = msgspec.structs.replace(
        content,
        geometry={},
        transmission={},
        geometry_error=None,
        gravity=Gravity(_AT_REST, content.gravity.in_gears),
    )
    with_sag = msgspec.structs.replace(without_sag, gravity=Gravity(_WEIGHTLESS, content.gravity.in_gears))
    calibrated_variants = [
        _Variant("calibrated geometry", without_sag, parameters),
        _Variant("calibrated geometry with sag", with_sag, parameters),
    ]
    variants = [
        _Variant("nominal geometry", without_sag, ()),
        _Variant("nominal geometry with sag", with_sag, ()),
        *calibrated_variants,
    ]
    if with_gears:
        variants += [
            _Variant(f"{variant.label}, gears", variant.content, (*variant.parameters, *_GEAR_ERRORS))
            for variant in calibrated_variants
        ]
    return variants


def simplest_variant(squares: dict[str, Array]) -> str:
    """Return the label of the simplest variant that is about as good as the best one.

    Its mean square error exceeds that of the best variant by at most one standard error of the difference.

    :param squares: label → mean square cross-validation errors (C,) of each configuration; variants simple to rich.
    """
    best = min(squares, key=lambda label: squares[label].mean())

    def is_as_good(square: Array) -> bool:
        """Return whether a variant with these squares (C,) is as good as the best one, within one standard error."""
        difference = square - squares[best]
        return bool(difference.mean() <= difference.std(ddof=1) / np.sqrt(len(difference)))

    return next(label for label, square in squares.items() if is_as_good(square))


def _error_95(square_errors: Array, data: Measurements) -> float:
    """Return an upper limit of the 95 % quantile of the errors of a point without noise [m].

    The mean square without noise is taken larger by one standard error; it is at least 0.

    :param square_errors: (C,) mean squares of the errors of the points in each configuration, with noise [m²].
    """
    _, reading_count = data.means()
    count = reading_count[data.unloaded_states]
    is_visible = count > 0.0
    # mean over the points of 3 σ²/n: three coordinates of the mean of n readings of a point
    noise = (
        3.0
        * data.sigma**2
        * np.sum(is_visible / np.maximum(count, 1.0), axis=1)
        / np.maximum(is_visible.sum(axis=1), 1)
    )
    square_excess = square_errors - noise
    upper_limit = square_excess.mean() + square_excess.std(ddof=1) / np.sqrt(len(square_excess))
    return float(LENGTH_95 * np.sqrt(max(0.0, upper_limit)))


def _extrapolation_error(solution: _Solution, nominal: Chain) -> float:
    """Return the 95 % quantile [m] of the errors that readings and prior allow for, over the whole range of the joints.

    The range is that of the joint limits, but one turn at most. Errors of base and points count too: readings over a
    small range do not separate them from errors of the joints.
    """
    half_turn = np.full(6, np.pi)
    lower, upper = np.maximum(nominal.lower, -half_turn), np.minimum(nominal.upper, half_turn)
    q = np.random.default_rng(0).uniform(lower, upper, (_AVERAGED_CONFIGURATIONS, 6))
    point, root = solution.placement.points[:1], solution.placement.root_in_device
    _, flange = nominal.joint_frames(q)
    by_parameter = _parameter_columns(solution.parameters, _PosedArm(nominal, flange, q), q, point, root)
    design = np.concatenate([_placement_columns(flange, point, root), *by_parameter], axis=1)
    first_parameter = len(solution.covariance_of_unknowns) - len(solution.values)  # after base and all points
    rows_of_arm = [
        *range(9),
        *range(first_parameter, len(solution.covariance_of_unknowns)),
    ]  # base, first point, parameters
    variance = np.einsum(
        "ni,ij,nj->n", design, solution.covariance_of_unknowns[np.ix_(rows_of_arm, rows_of_arm)], design
    )
    return float(LENGTH_95 * np.sqrt(3.0 * np.mean(variance)))  # rows are coordinates, three a point


class _Solution(Struct, frozen=True, eq=False):
    """A fit of u unknowns: base (6), P points (3 each) and p geometry parameters, in this order.

    :param content: model before the fit.
    :param parameters: (p,) of the geometry.
    :param values: (p,) of the parameters [m, rad].
    :param covariance_of_unknowns: (u, u) of all unknowns, increased by the misfit.
    :param placement: base and points.
    :param residual: (C, P, 3) measured minus predicted positions [m]; zero for points without readings.
    :param design: (n + p, u) derivatives of the n whitened coordinates, then rows of the prior.
    :param target: (n + p,) that design times unknowns should be.
    :param whitening: (n,) factors that whiten the coordinates: they divide by their noise [1/m].
    """

    content: ModelFile
    parameters: tuple[GeometryParameter, ...]
    values: Array
    covariance_of_unknowns: Array
    placement: Placement
    residual: Array
    design: Array
    target: Array
    whitening: Array

    @property
    def covariance(self) -> Array:
        """Covariance (p, p) of the geometry parameters alone, which are the last unknowns."""
        first = len(self.covariance_of_unknowns) - len(self.values)
        return self.covariance_of_unknowns[first:, first:]


def _misfit(white_residual: Array, unknowns: int) -> float:
    """Return the sum of squares of whitened residuals (n,) per degree of freedom, 1 at least.

    It is the factor on the variance of the noise that explains the residuals.

    :param unknowns: number of unknowns of the fit.
    """
    dof = max(1, len(white_residual) - unknowns)
    return max(1.0, float(white_residual @ white_residual) / dof)


class _PosedArm(NamedTuple):
    """An arm without load in C configurations.

    :param chain: chain for derivatives by displacements of the joints.
    :param flange: (C, 4, 4) poses of the flange in the root [m].
    :param angles: (C, 6) of the joints, with sag [rad].
    """

    chain: Chain
    flange: Array
    angles: Array


def _usual_sizes(parameters: tuple[GeometryParameter, ...]) -> Array:
    """Return the prior standard deviations (p,) of geometry parameters [m, rad]."""
    return np.array([parameter.usual_size for parameter in parameters])


def _fit_geometry(
    content: ModelFile, nominal: Chain, name: str, data: Measurements, parameters: tuple[GeometryParameter, ...]
) -> _Solution:
    """Fit the geometry parameters, the frame of the tracker and the points to unloaded readings.

    Gauss-Newton with the priors of the parameters as a ridge; the covariance grows with the misfit.

    :param content: model whose geometry is replaced by the parameters.
    :param name: of the robot.
    :param parameters: free parameters; all others are zero.
    :raises PostprocError: the model has no equilibrium under its own weight, or a value is beyond any arm.
    """
    mean, count = data.means()
    readings, weight = mean[data.unloaded_states], count[data.unloaded_states]
    whitening = np.repeat(np.sqrt(weight).ravel(), 3) / data.sigma  # of the coordinates; 0 without a reading
    values, points, usual_sizes = np.zeros(len(parameters)), data.guess.copy(), _usual_sizes(parameters)
    placement_count = 6 + 3 * len(points)  # unknowns of base and points, which have no prior
    ridge = np.diag(np.concatenate([np.zeros(placement_count), 1.0 / usual_sizes]))[placement_count:]

    def pose_arm(values: Array) -> _PosedArm:
        """Return the arm without load in the configurations of the readings, for values (p,) of the parameters."""
        robot = assemble(name, _add_geometry(content, parameters, values, "", None), nominal)
        return _PosedArm(_derivative_chain(nominal, robot), *_unloaded_poses(robot, data.q))

    arm = pose_arm(values)
    root = kabsch(point_positions(arm.flange, points).reshape(-1, 3), readings.reshape(-1, 3))
    for _ in range(_MOST_STEPS):
        by_parameter = _parameter_columns(parameters, arm, data.q, points, root)
        columns = [_placement_columns(arm.flange, points, root), *by_parameter]
        design = np.concatenate(columns, axis=1) * whitening[:, None]
        white_residual = (readings - point_positions(root @ arm.flange, points)).ravel() * whitening
        target = np.concatenate([white_residual, -values / usual_sizes])
        step = np.linalg.lstsq(np.vstack([design, ridge]), target, rcond=None)[0]
        root = displace(root, step[:6])
        points = points + step[6:placement_count].reshape(points.shape)
        values = values + step[placement_count:]
        arm = pose_arm(values)
        if np.abs(step).max() < _STEP_TOLERANCE:
            break
    residual = (readings - point_positions(root @ arm.flange, points)) * (weight > 0.0)[..., None]
    white_residual = residual.ravel() * whitening
    covariance = np.linalg.pinv(design.T @ design + ridge.T @ ridge, hermitian=True)
    unknowns = np.concatenate([np.zeros(placement_count), values])  # twist and shifts of the points count from here
    return _Solution(
        content=content,
        parameters=parameters,
        values=values,
        covariance_of_unknowns=covariance * _misfit(white_residual, design.shape[1]),
        placement=Placement(root, points, covariance[:placement_count, :placement_count] / data.sigma**2, residual),
        residual=residual,
        design=np.vstack([design, ridge]),
        target=np.concatenate([white_residual + design @ unknowns, np.zeros(len(parameters))]),
        whitening=whitening,
    )


def _parameter_columns(
    parameters: tuple[GeometryParameter, ...], arm: _PosedArm, q: Array, points: Array, root: Array
) -> list[Array]:
    """Return the derivatives (3CP, 1) of P points in C configurations, device axes, by each parameter.

    :param q: (C, 6) joint angles of the controller [rad].
    :param points: (P, 3) [m], flange axes.
    :param root: (4, 4) pose of the robot root in the device frame [m].
    """
    _, columns = _joint_derivatives(arm.chain, arm.angles, points)
    by_joint = columns.reshape(len(q), len(points), 3, 6, 6)
    by_joint = np.einsum("ij,cpjab->cpiab", root[:3, :3], by_joint)
    return [_parameter_column(parameter, by_joint, arm.chain, q) for parameter in parameters]


def _parameter_column(parameter: GeometryParameter, by_joint: Array, chain: Chain, q: Array) -> Array:
    """Return the derivative (3CP, 1) of P points in C configurations by a parameter, device axes.

    An error of a gear is a turn about the joint's axis times a wave of the controller's angle.

    :param by_joint: (C, P, 3, 6, 6) derivatives by displacements of the joints, see `_joint_derivatives`, device axes.
    :param q: (C, 6) joint angles of the controller [rad].
    """
    joint = JOINTS.index(parameter.joint)
    if parameter.axis not in GEAR_TERMS:
        return np.asarray(by_joint[..., joint, _AXES.index(parameter.axis)].reshape(-1, 1))
    wave = waves(q[:, joint])[GEAR_TERMS.index(parameter.axis)]
    return np.asarray((by_joint[..., joint, 3:] @ chain.axis[joint] * wave[:, None, None]).reshape(-1, 1))


def _unloaded_poses(robot: RobotModel, q: Array) -> tuple[Array, Array]:
    """Return the flange poses without load and the joint angles there, with sag if the model predicts it.

    :param q: (C, 6) joint angles that the controller holds [rad].
    :returns: (C, 4, 4) poses in the root [m]; (C, 6) actual angles [rad].
    :raises NotConvergedError: the springs cannot carry the weight of the arm.
    """
    x, joints = elastostatics.coordinates(robot, q), list(robot.actuated)
    # a calibrated geometry contains the sag
    if robot.subtract_reference:
        pose, _ = kinematics.tcp(robot.actual, x, np.eye(4))
        return pose, x[:, joints]
    sag = elastostatics.deflect(robot, q, np.eye(4), np.zeros((len(q), 6)))
    return sag.pose, (x + sag.theta)[:, joints]


def _derivative_chain(nominal: Chain, robot: RobotModel) -> Chain:
    """Return the chain for derivatives by displacements of joints.

    It is the robot's actual chain. If links deflect, that has further coordinates, and the nominal chain is taken.
    """
    if robot.actual.nv == nominal.nv:
        return robot.actual
    return nominal


def _cross_validation_error(solution: _Solution, data: Measurements) -> Array:
    """Return the mean square cross-validation error (C,) [m²] of the points of each configuration.

    The linear equations of the fit are solved again without the configurations of each fold.
    """
    rows = 3 * len(data.points)  # of a configuration
    readings = len(data.q) * rows
    folds = min(_FOLDS, len(data.q))
    fold = np.random.default_rng(0).permutation(len(data.q)) % folds
    # −1: rows of the prior, which are in no fold, so they count in every solution
    row_fold = np.concatenate([np.repeat(fold, rows), np.full(len(solution.target) - readings, -1)])
    errors = np.empty(len(data.q))
    for index in range(folds):
        is_left_out = row_fold == index
        unknowns = np.linalg.lstsq(solution.design[~is_left_out], solution.target[~is_left_out], rcond=None)[0]
        white_residual = solution.target[is_left_out] - solution.design[is_left_out] @ unknowns
        residual = white_residual / solution.whitening[is_left_out[:readings]]
        # a point without readings has the factor 0: 0/0
        errors[fold == index] = np.sum(np.nan_to_num(residual).reshape(-1, rows) ** 2, axis=1) / len(data.points)
    return errors


def _add_geometry(
    content: ModelFile, parameters: tuple[GeometryParameter, ...], values: Array, source: str, half_widths: Array | None
) -> ModelFile:
    """Return the model with a geometry and transmission errors.

    :param values: (p,) of the parameters, SI.
    :param source: text on the origin of the values.
    :param half_widths: (p,) of the 95 % intervals, which the source then names, SI; None: it names none.
    :raises MeasurementError: a value is beyond any arm.
    """
    is_gear = np.array([parameter.axis in GEAR_TERMS for parameter in parameters], dtype=bool)
    geometry_table, gear_table = (
        _parameter_table(
            [parameter for parameter, counts in zip(parameters, rows, strict=True) if counts],
            values[rows],
            source,
            None if half_widths is None else half_widths[rows],
        )
        for rows in (~is_gear, is_gear)
    )
    try:
        geometry = msgspec.convert(geometry_table, dict[str, Displacement])
        transmission = msgspec.convert(gear_table, dict[str, TransmissionEntry])
    except msgspec.ValidationError as cause:  # values beyond any arm: the readings do not hold the parameters
        raise MeasurementError(f"the geometry cannot be found: {cause}", file="") from None
    return msgspec.structs.replace(content, geometry=geometry, transmission=transmission)


def _parameter_table(
    parameters: Sequence[GeometryParameter], values: Array, source: str, half_widths: Array | None
) -> dict[str, dict[str, float | str]]:
    """Return joint → entry of `model.toml`: its values in units of the file, and their source.

    :param values: (p,) of the parameters, SI.
    :param half_widths: (p,) of the 95 % intervals, which the source then names, SI; None: it names none.
    """
    table: dict[str, dict[str, float | str]] = {}
    for joint in dict.fromkeys(parameter.joint for parameter in parameters):
        rows = [row for row, parameter in enumerate(parameters) if parameter.joint == joint]
        entry: dict[str, float | str] = {"source": source}
        intervals = []
        for row in rows:
            (unit, factor), axis = parameters[row].unit_and_factor, parameters[row].axis
            entry[f"{axis}_{unit}"] = float(values[row] * factor)
            if half_widths is not None:
                intervals.append(f"{axis} ± {half_widths[row] * factor:.2g} {unit}")
        if intervals:
            entry["source"] = f"{source} (95 %: {', '.join(intervals)})"
        table[joint] = entry
    return table


def warnings(result: Geometry, sigma: float) -> list[str]:
    """Return warnings that the user must know before using the calibrated geometry.

    :param sigma: noise of one coordinate of one reading [m].
    """
    return [*_large_residuals(result, sigma), *_contradiction_warnings(result), *_small_motion_warnings(result)]


_LARGE_RESIDUAL = 5e-4
"""RMS distance [m] that no calibrated arm leaves: some tenths of a millimetre are usual (assumed)."""
_LARGE_RESIDUAL_SIGMAS = 5.0
"""RMS distance over the noise of a coordinate that noise does not explain: it makes less than 2 (assumed)."""


def _large_residuals(result: Geometry, sigma: float) -> list[str]:
    """Return a warning if the residuals are far larger than those of calibrated arms and than noise; else none.

    :param sigma: noise of one coordinate of one reading [m].
    """
    rms = result.placement.rms
    if rms <= max(_LARGE_RESIDUAL, _LARGE_RESIDUAL_SIGMAS * sigma):
        return []
    return [
        f"the best geometry leaves {rms * MM_PER_M:.2f} mm RMS of the readings without load, a calibrated arm some "
        "tenths of a millimetre: check that the noted angles are those of the controller, the tracker and the markers"
    ]


def _contradiction_warnings(result: Geometry) -> list[str]:
    """Return a warning if a weightless geometry contradicts nonlinear gears that were identified under the load alone.

    In a weightless geometry the weights load the gears too. Lost motion is no contradiction: it reacts to the load
    alone, with any geometry.
    """
    content = result.content
    if not result.is_weightless or content.gravity.in_gears:
        return []
    nonlinear_joints = [
        name for name, spring in content.joints.items() if spring.stiffening or spring.knees or spring.backlash
    ]
    if not nonlinear_joints:
        return []
    return [
        "the geometry is that of a weightless robot, in which weights load the gears too; the gears of "
        f"{', '.join(nonlinear_joints)} were identified with the load alone, and their prediction changes. Identify "
        'them from a robot whose model.toml says [gravity] reference = "rigid", or leave out --geometry.'
    ]


_USUAL_SPAN = 30.0
"""Span of a joint [deg] that programs usually leave: a part of half a metre two metres away turns A1 by 15°."""


def _small_motion_warnings(result: Geometry) -> list[str]:
    """Return a warning if joints turned by less than `_USUAL_SPAN` in the readings: programs will leave their range."""
    error = result.content.geometry_error
    assert error is not None, "a calibration states its error"
    spans = [(joint, high - low) for joint, (low, high) in error.angles_deg.items() if high - low < _USUAL_SPAN]
    if not spans:
        return []
    return [
        f"{', '.join(f'{joint} turned by {span:.0f}°' for joint, span in spans)} in the readings: the geometry is not "
        f"known beyond that, and u95_mm grows there. Measure with every joint turned by {_USUAL_SPAN:.0f}° and more, "
        "over the space in which you mill."
    ]


def report_data(result: Geometry) -> record.Geometry:
    """Return the geometry as `identification.json` contains it."""
    entries = {}
    for parameter, value, half_width in zip(result.parameters, result.values, result.ci95, strict=True):
        unit, factor = parameter.unit_and_factor
        is_observable = parameter.name not in result.not_observable
        entries[parameter.name] = record.Parameter(
            float(value * factor),
            float(half_width * factor),
            unit,
            observable=is_observable,
            determined=bool(half_width <= abs(value)),
        )
    variants = {
        name: record.Variant(fit * MM_PER_M, fold_rms * MM_PER_M) for name, (fit, fold_rms) in result.rms.items()
    }
    return record.Geometry(entries, result.is_weightless, result.chosen, variants, result.u95 * MM_PER_M)
