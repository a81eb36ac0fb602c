"""Model of the measurement: the readings that a robot with given parameters would show.

1. Placement: base transform and reference points, from readings without load by the robot's geometry (paper,
   section 4). Positions of points only, no orientations (partial pose).
2. Measured displacements, loaded − unloaded, and their noise.
3. Structure: the springs of the model, and the parameters to be identified.
4. Predicted displacements with derivatives. The prediction is the equilibrium of `elastostatics.deflect`, so that
   nothing is linearised in the load (Eq. (8) alone is off by 0.2–0.3 % at 2.7 kN). The derivatives are those of the
   equilibrium θ = c(τ(θ); p), c being the compliance law:

       ∂t/∂p = J (I − C_t H)⁻¹ ∂c/∂p        with C_t = ∂c/∂τ, H = ∂τ/∂θ (load, weights, compensator)
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import elastostatics, kinematics
from postproc.errors import MeasurementError, NotConvergedError
from postproc.frames import MM_PER_M, RAD_PER_DEG, Array, displace, inverse, xyzabc_from_pose
from postproc.identification.readings import Measurements
from postproc.program import Ints
from postproc.robot import JointCompliance, LinkSpring, Parameter, RobotModel

_MOST_STEPS = 20
"""Limit of Gauss-Newton steps from a rigid fit, which begins close by (assumed)."""
_SINGULAR = 1e10
"""Condition number of scaled normal equations beyond which they are singular but for rounding (assumed)."""
_SAME_LEVEL = 2.0 * RAD_PER_DEG
"""Sorted angles of A2 belong to one level while each is less than this from the one before (assumed)."""


class Placement(Struct, frozen=True, eq=False):
    """Base transform and reference points.

    :param root_in_device: (4, 4) maps robot root coordinates to the frame of the device [m].
    :param points: (P, 3) in the flange frame [m].
    :param covariance: (6 + 3P, 6 + 3P) of the twist of the root in device axes and the points, for noise of 1 m.
    :param residual: (C, P, 3) reading minus model without load, device axes [m]; 0 for points without a reading.
    """

    root_in_device: Array
    points: Array
    covariance: Array
    residual: Array

    @property
    def rms(self) -> float:
        """RMS distance of the unloaded readings from the model [m]."""
        squares = np.sum(self.residual**2, axis=-1)  # exactly zero for points without a reading
        return float(np.sqrt(squares.sum() / max(1, np.count_nonzero(squares))))


def kabsch(source: Array, target: Array) -> Array:
    """Return the rigid transform (4, 4) from `source` (n, 3) to `target` (n, 3) with least squares (Kabsch 1976)."""
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((source - source_mean).T @ (target - target_mean))
    # the last sign makes it a rotation, not a reflection
    sign = np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)])
    pose = np.eye(4)
    pose[:3, :3] = vt.T @ sign @ u.T
    pose[:3, 3] = target_mean - pose[:3, :3] @ source_mean
    return pose


def locate(robot: RobotModel, data: Measurements) -> Placement:
    """Return the root in the device frame and the points in the flange frame, fitted to the readings without load.

    :raises MeasurementError: fewer readings than unknowns, or points and configurations that do not determine the
        frames.
    :raises NotConvergedError: the robot cannot carry its own weight.
    """
    flange = unloaded_flange(robot, data.q)
    mean, count = data.means()
    readings, weight = mean[data.unloaded_states], count[data.unloaded_states]
    configs, points = readings.shape[:2]
    unknowns = 6 + 3 * points  # twist of the root, and the points
    if configs * points * 3 < unknowns:
        raise MeasurementError(
            f"{configs} configurations of {points} points are {configs * points * 3} coordinates for "
            f"{unknowns} unknowns of base and points",
            file=data.file,
            advice="Measure more configurations.",
        )
    position = data.guess.copy()
    model = point_positions(flange, position)
    has_reading = weight.ravel() > 0.0
    pose = kabsch(model.reshape(-1, 3)[has_reading], readings.reshape(-1, 3)[has_reading])
    for _ in range(_MOST_STEPS):
        model = point_positions(pose @ flange, position)
        white_residual = ((readings - model) * np.sqrt(weight)[..., None]).ravel()
        jacobian = placement_derivatives(model, pose[:3, 3], pose[:3, :3] @ flange[:, :3, :3])
        rows = (jacobian * np.sqrt(weight)[..., None, None]).reshape(-1, unknowns)
        normal = rows.T @ rows
        _check_separable(normal, data.file)
        step = np.asarray(np.linalg.solve(normal, rows.T @ white_residual), dtype=np.float64)
        pose = displace(pose, step[:6])
        position = position + step[6:].reshape(points, 3)
        # [m], [rad]: rounding
        if np.abs(step).max() < 1e-11:
            break
    residual = (readings - point_positions(pose @ flange, position)) * (weight > 0.0)[..., None]
    return Placement(pose, position, np.asarray(np.linalg.inv(normal)), residual)


def _check_separable(normal: Array, file_name: str) -> None:
    """Check that normal equations (n, n) determine base transform and reference points: they are not singular.

    :raises MeasurementError: they are singular, but for rounding.
    """
    scale = 1.0 / np.sqrt(np.diag(normal))
    if np.linalg.cond(normal * np.outer(scale, scale)) > _SINGULAR:
        raise MeasurementError(
            "base transform and reference points cannot be separated with these configurations",
            file=file_name,
            advice="Turn A1…A6, the wrist above all, more from configuration to configuration.",
        )


def unloaded_design(robot: RobotModel, data: Measurements, placement: Placement) -> Array:
    """Return the derivatives (C, P, 3, 6 + 3P) of the points without load in device axes, by root and points.

    The unknowns are those of `locate`: the twist of the root about itself in device axes, and the P points in the
    flange frame.
    """
    flange = unloaded_flange(robot, data.q)
    root = placement.root_in_device
    positions = point_positions(root @ flange, placement.points)
    return placement_derivatives(positions, root[:3, 3], root[:3, :3] @ flange[:, :3, :3])


def as_positions(robot: RobotModel, data: Measurements) -> Measurements:
    """Return readings of displacements as positions in the root frame; readings of positions are returned unchanged.

    A displacement is added to the position of its point without load, by the geometry of the robot.
    """
    if not data.are_displacements:
        return data
    points = point_positions(unloaded_flange(robot, data.q), data.guess)
    start = points[data.state_config[data.state], data.point]
    return replace(data, position=start + data.position, are_displacements=False, has_unloaded_readings=False)


def unloaded_flange(robot: RobotModel, q: Array) -> Array:
    """Return the pose (C, 4, 4) of the flange without load, root frame [m]; `q` (C, 6) [rad].

    A robot whose geometry is weightless sags by its weights; other geometries contain the sag.
    """
    if robot.subtract_reference:  # the geometry contains the sag
        pose, _ = kinematics.tcp(robot.actual, elastostatics.coordinates(robot, q), np.eye(4))
        return pose
    return elastostatics.deflect(robot, q, np.eye(4), np.zeros((len(q), 6))).pose


def in_root_axes(placement: Placement, vectors: Array) -> Array:
    """Turn vectors (..., 3) from device axes to root axes."""
    return np.asarray(vectors @ placement.root_in_device[:3, :3])


def base_frame(placement: Placement) -> dict[str, float]:
    """Return the base transform as a KUKA frame [mm, deg]: the root in the device frame."""
    values = xyzabc_from_pose(placement.root_in_device)
    return {name: float(value) for name, value in zip("XYZABC", values, strict=True)}


def point_table(placement: Placement, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Return the reference points in the flange frame [mm]."""
    return {
        name: {axis: float(v * MM_PER_M) for axis, v in zip("XYZ", p, strict=True)}
        for name, p in zip(names, placement.points, strict=True)
    }


def device_to_root(placement: Placement, positions: Array) -> Array:
    """Return positions (..., 3) of the device frame in the root frame [m]."""
    transform = inverse(placement.root_in_device)
    return np.asarray(positions @ transform[:3, :3].T + transform[:3, 3])


def placement_derivatives(model: Array, origin: Array, rotation: Array) -> Array:
    """Return the derivatives (C, P, 3, 6 + 3P) of points in device axes, by the root and by the points themselves.

    The first six columns are by the twist of the root about its origin, in device axes: translation, then rotation.
    Three columns for each point follow, by its coordinates in flange axes.

    :param model: (C, P, 3) positions of the points in the device frame [m].
    :param origin: (3,) of the root in the device frame [m].
    :param rotation: (C, 3, 3) of the flange in the device frame.
    """
    configs, points = model.shape[:2]
    jacobian = np.zeros((configs, points, 3, 6 + 3 * points))
    jacobian[..., :3] = np.eye(3)
    for axis, direction in enumerate(np.eye(3)):
        jacobian[..., 3 + axis] = np.cross(direction, model - origin)
    for index in range(points):
        first = 6 + 3 * index  # column of the point's X, after the twist
        jacobian[:, index, :, first : first + 3] = rotation
    return jacobian


def point_positions(frames: Array, points: Array) -> Array:
    """Return the positions (C, P, 3) [m] of points (P, 3) that are fixed in frames (C, 4, 4)."""
    positions: Array = np.einsum("cij,pj->cpi", frames[:, :3, :3], points) + frames[:, None, :3, 3]
    return positions


_MIN_WEIGHT = 1e-12
"""Weight of a point whose readings are all left out (assumed)."""


def measured_displacements(data: Measurements, placement: Placement) -> Array:
    """Return loaded − unloaded mean positions (L, P, 3) [m] of L loaded states, root axes; 0 for unseen points.

    A point is unseen in a loaded state if it has no reading with or no reading without this load.
    """
    mean, _ = data.means()
    unloaded_state = data.unloaded_states[data.state_config[data.loaded_states]]
    return visible_points(data) * in_root_axes(placement, mean[data.loaded_states] - mean[unloaded_state])


def displacement_residuals(prediction: Array, data: Measurements, placement: Placement) -> Array:
    """Return measured − predicted displacements (L, P, 3) [m], root axes; 0 for points that `visible_points` excludes.

    :param prediction: (L, P, 3) of the loaded states, see `predict` [m].
    """
    return np.asarray((measured_displacements(data, placement) - prediction) * visible_points(data))


def visible_points(data: Measurements) -> Array:
    """Return 1 for points that have readings with and without load, else 0: (L, P, 1), for L loaded states."""
    _, count = data.means()
    unloaded_state = data.unloaded_states[data.state_config[data.loaded_states]]
    return np.asarray(((count[data.loaded_states] > 0) & (count[unloaded_state] > 0)).astype(float)[..., None])


def coordinate_count(data: Measurements) -> int:
    """Return the number of measured coordinates of displacements: three for each visible point of a loaded state."""
    return 3 * int(np.count_nonzero(visible_points(data)))


def whitening(data: Measurements) -> Array:
    """Return matrices W (P, L, L), one a point, that make its displacements independent with variance 1: W Σ Wᵀ = I.

    Σ (L, L) is the covariance of the displacements in L loaded states, for noise σ of a reading: σ²/n_l on the diagonal
    for n_l readings under load. Loads of one configuration share its n_0 readings without load: plus σ²/n_0.
    """
    count = np.maximum(data.means()[1], _MIN_WEIGHT)
    states, config = data.loaded_states, data.state_config[data.loaded_states]
    is_same_config = config[:, None] == config[None]
    unloaded_state = data.unloaded_states[config]
    matrix = np.empty((len(data.points), len(states), len(states)))
    for point in range(len(data.points)):
        covariance = np.diag(1.0 / count[states, point]) + is_same_config / count[unloaded_state, point][:, None]
        matrix[point] = np.linalg.inv(np.linalg.cholesky(covariance)) / data.sigma
    return matrix


def whiten(w: Array, values: Array) -> Array:
    """Return values (L, P, …) of L states at P points, those of each point multiplied by its matrix in w (P, L, L)."""
    return np.asarray(np.einsum("plm,mp...->lp...", w, values))


def whitened_derivatives(w: Array, slopes: Array, data: Measurements) -> Array:
    """Return the whitened derivatives (3LP, p) of displacements; 0 for points that `visible_points` excludes.

    :param w: (P, L, L) matrices of the points, which make their displacements independent with variance 1.
    :param slopes: (L, P, 3, p) derivatives of the displacements by p parameters.
    """
    return whiten(w, slopes * visible_points(data)[..., None]).reshape(-1, slopes.shape[-1])


def unwhiten(w: Array, values: Array) -> Array:
    """Return values (L, P, …) of L states at P points, those of each point multiplied by the inverse of its matrix.

    It is the inverse of `whiten`.

    :param w: (P, L, L) matrices of the points.
    """
    columns = []
    for matrix, point_values in zip(w, np.swapaxes(values, 0, 1), strict=True):
        columns.append(np.linalg.solve(matrix, point_values.reshape(len(values), -1)).reshape(point_values.shape))
    return np.stack(columns, axis=1)


MIN_COMPLIANCE = 1e-12
"""Smallest joint compliance [rad/(N·m)] for which the equilibrium is solved; fits may pass through zero."""


class LevelCompliance(JointCompliance, frozen=True):
    """Equivalent compliance of joint 2, compensator included, at one level of q2: the paper's extended set, Eq. (8)."""

    level: int

    @property
    def name(self) -> str:
        """Return e.g. ``k2#3``; used in messages only, never in files."""
        return f"k{self.index + 1}#{self.level}"


class Structure(Struct, frozen=True, eq=False, dict=True):
    """The springs of a model and the parameters to be identified.

    :param parameters: (p,) to be identified.
    :param prior: robot, without springs of links, that gives all other values (and geometry, masses, compensator).
    :param levels: (C,) level of q2 of each configuration, for `LevelCompliance`.
    :param carries_weight: whether gears that are not linear deflect by weights and compensator too, not by the load
        alone.
    """

    parameters: tuple[Parameter, ...]
    prior: RobotModel
    levels: Ints | None = None
    carries_weight: bool = False

    @cached_property
    def template(self) -> RobotModel:
        """The prior with a coordinate for every spring to be identified, and linear gears."""
        plain = replace(self.prior, terms=(), carries_weight=self.carries_weight)
        return plain.with_link_springs(p for p in self.parameters if isinstance(p, LinkSpring))

    def active_rows(self, level: int | None) -> list[int]:
        """Return the indices of the parameters that act at a level of q2: all but compliances of other levels.

        :param level: None: a structure without levels.
        """
        return [
            index
            for index, parameter in enumerate(self.parameters)
            if not isinstance(parameter, LevelCompliance) or parameter.level == level
        ]

    def robot(self, values: Array, level: int | None = None) -> RobotModel:
        """Return the robot with these values of the parameters.

        :param values: (p,) SI.
        :param level: level of q2 whose `LevelCompliance` applies to joint 2; None: no levels.
        """
        robot = self.template.with_values({self.parameters[i]: float(values[i]) for i in self.active_rows(level)})
        # compliances of zero or below have no equilibrium
        joints = list(robot.actuated)
        if (robot.compliance[joints] < MIN_COMPLIANCE).any():
            stiffness = robot.stiffness.copy()
            stiffness[joints, joints] = 1.0 / np.maximum(robot.compliance[joints], MIN_COMPLIANCE)
            robot = replace(robot, stiffness=stiffness)
        if level is None:
            return robot
        # the levels contain the compensator's part, about the state of rest as in Eq. (4)
        return replace(robot, compensator=None, subtract_reference=True)

    def usual_sizes(self) -> Array:
        """Return typical magnitudes (p,) of the parameters, SI, for scaling."""
        return np.array([parameter.usual for parameter in self.parameters])

    def start_values(self) -> Array:
        """Return start values (p,), SI: those of the prior, 0 for springs that it does not have."""
        return np.array([self.template.value(parameter) for parameter in self.parameters])


def predict(structure: Structure, values: Array, data: Measurements, placement: Placement) -> tuple[Array, Array]:
    """Return the displacements of the points by the loads, and their derivatives by the parameters.

    :param values: (p,) SI.
    :returns: (L, P, 3) displacements in root axes [m]; (L, P, 3, p) derivatives per SI unit.
    :raises NotConvergedError: the springs have no equilibrium under a load; the message names it.
    """
    config = data.state_config[data.loaded_states]
    displacement = np.empty((len(config), len(data.points), 3))
    slopes = np.zeros((*displacement.shape, len(structure.parameters)))
    level = np.full(len(config), -1) if structure.levels is None else structure.levels[config]
    for number in np.unique(level):
        rows = np.flatnonzero(level == number)
        q2_level = None if structure.levels is None else int(number)
        active = structure.active_rows(q2_level)
        try:
            displacement[rows], active_slopes = _predict_states(
                structure, structure.robot(values, q2_level), active, data.loaded_states[rows], data, placement
            )
        except NotConvergedError as error:
            state = int(data.loaded_states[rows[error.rows[0]]])
            raise NotConvergedError(
                f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}: {error}", error.rows
            ) from None
        for column, index in enumerate(active):
            slopes[rows, ..., index] = active_slopes[..., column]
    return displacement, slopes


def _predict_states(
    structure: Structure, robot: RobotModel, active: list[int], states: Ints, data: Measurements, placement: Placement
) -> tuple[Array, Array]:
    """Return the displacements (n, P, 3) [m] of the points in root axes, and derivatives (n, P, 3, a) per SI unit.

    :param robot: with the values of the parameters.
    :param active: indices of the a parameters by which the derivatives are.
    :param states: (n,) indices of loaded states.
    :raises NotConvergedError: the springs have no equilibrium under a load.
    """
    q = data.q[data.state_config[states]]
    unloaded_coordinates = elastostatics.coordinates(robot, q)
    wrench = data.wrench[states]
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    lever = placement.points - data.load_point  # from the load point to the points, flange axes
    pose, twist = _equilibrium(structure, robot, active, q, tool, wrench)
    with_load, slopes = _point_motions(pose, twist, lever)
    if robot.subtract_reference:
        unloaded_pose, _ = kinematics.tcp(robot.loaded, unloaded_coordinates, tool)
        without_load, _ = _point_motions(unloaded_pose, twist, lever)
    else:  # without load the robot sags by the same springs
        unloaded_pose, sag_twist = _equilibrium(structure, robot, active, q, tool, np.zeros_like(wrench))
        without_load, sag_slopes = _point_motions(unloaded_pose, sag_twist, lever)
        slopes = slopes - sag_slopes
    return with_load - without_load + (pose[:, :3, 3] - unloaded_pose[:, :3, 3])[:, None], slopes


def _point_motions(pose: Array, twist: Array, lever: Array) -> tuple[Array, Array]:
    """Return the points relative to the load point (L, P, 3) [m], and their motions (L, P, 3, p), in root axes.

    :param pose: (L, 4, 4) of the load point in the root frame.
    :param twist: (L, 6, p) of the load point per unit of p parameters: translation, then rotation.
    :param lever: (P, 3) points relative to the load point in flange axes [m].
    """
    points = np.einsum("lij,pj->lpi", pose[:, :3, :3], lever)
    rotation = np.cross(np.swapaxes(twist[:, 3:], 1, 2)[:, None], points[:, :, None], axisa=3, axisb=3, axisc=3)
    return points, twist[:, None, :3] + rotation.swapaxes(2, 3)


def _equilibrium(
    structure: Structure, robot: RobotModel, active: list[int], q: Array, tool: Array, wrench: Array
) -> tuple[Array, Array]:
    """Return the pose (L, 4, 4) [m] of the load point under load, and its twists (L, 6, a) per unit of each parameter.

    :param active: indices of the a parameters.
    :param q: (L, 6) joint angles [rad]; `wrench` (L, 6) at the load point, root axes [N, N·m].
    :param tool: (4, 4) the load point in the flange frame [m].
    :raises NotConvergedError: the springs have no equilibrium.
    """
    parameters = [structure.parameters[index] for index in active]
    deflection, twist = elastostatics.deflection_by_parameter(robot, q, tool, wrench, parameters)
    return deflection.pose, twist


def joint_torques(robot: RobotModel, data: Measurements) -> Array:
    """Return the torques (L, 6) of the loads about the joint axes [N·m], for L loaded states."""
    tool = np.eye(4)
    tool[:3, 3] = data.load_point
    loaded_q = data.q[data.state_config[data.loaded_states]]
    return elastostatics.load_torques(robot, loaded_q, tool, data.wrench[data.loaded_states])


def levels_of(data: Measurements) -> Ints:
    """Return the level of q2 of each configuration (C,), numbered from 0 by angle.

    Configurations of one level have about the same angle of joint 2, and so the same effect of the compensator. A level
    ends where the next larger angle is more than `_SAME_LEVEL` away.
    """
    order = np.argsort(data.q[:, 1])
    sorted_levels = np.concatenate([[0], np.cumsum(np.diff(data.q[order, 1]) > _SAME_LEVEL)])
    level = np.empty(len(order), dtype=np.int64)
    level[order] = sorted_levels
    return level
