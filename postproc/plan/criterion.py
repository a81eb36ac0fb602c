"""Criterion of a plan: expected error after compensation at the test poses; expected accuracy; directions of torques.

Source: Klimchik et al., second Eq. (10): trace(A₀ Σ_j (Σ_i A_iʲᵀ A_iʲ)⁻¹ A₀ᵀ), summed over the test poses with weights.

*Grouped* is this formula as printed: each level of q2 is a group identified alone.

*Pooled* (the default) is how the identification uses the data: Eq. (8) shares k1, k3…k6 between the groups and has one
k2 per level, so the covariance is the inverse of one pooled matrix of the extended set; k2 at a test pose comes from
the levels by Eq. (9), (10): K⁰_θ2, K_c, s₀K_c by least squares, then Eq. (4) at the q2 of the test pose. Where K_c is
kept at the robot's prior (it is rarely observable), K⁰_θ2 alone is the mean over the levels.

Both are in m²: the mean over the test poses of the squared distance that remains. Compliances are in units of the
robot's own (`Readings.scale`).

`expected_accuracy` uses the parameters that the identification ends with: k1…k6, and K_c, s₀K_c where they can be
determined, all readings weighted by their noise (Gauss–Markov): Cov = (Σ DᵀBᵀB D)⁻¹. The criterion, which follows the
paper's two steps, is never smaller.

`directions`: the plan must load each joint in both directions, as far as the rig can, with torques near those of the
work. Gears with lost motion, friction or a preload deflect differently in the other direction. The criterion contains
linear springs alone, so the directions are a condition on the plan.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.compensator import Compensator
from postproc.frames import Array
from postproc.identification.fit import NORMAL_95
from postproc.identification.joint_springs import UNCERTAIN_SHARE
from postproc.identification.measurement_model import levels_of
from postproc.identification.readings import Measurements
from postproc.identification.validation import LEAST_TORQUE, MIN_CONFIGURATIONS, SIGNS, split_signs
from postproc.plan.milling import TestPoses
from postproc.plan.sensitivity import Readings
from postproc.program import Bools, Ints
from postproc.robot import COMPENSATOR, JOINT_COMPLIANCES, JOINTS, Parameter, RobotModel

LEAST_LEVELS = 3
"""Fewest levels of q2 with which a compensator is identifiable."""


class Joint2(Struct, frozen=True, eq=False):
    """Equivalent spring of joint 2, relative to the compliance of its gear.

    :param compliance: of the gear, 1/K⁰_θ2 [rad/(N·m)].
    :param compensator: law of the compensator; None: the robot has none.
    :param has_free_compensator: whether K_c and s₀ are identified too; else they keep the robot's values.
    """

    compliance: float
    compensator: Compensator | None
    has_free_compensator: bool

    @classmethod
    def of(cls, robot: RobotModel, free: bool) -> Joint2:
        """Return joint 2 of a robot.

        :param free: whether K_c and s₀ are identified, if the robot has a compensator.
        """
        compliance = float(robot.compliance[robot.actuated[1]])
        return cls(compliance, robot.compensator, free and robot.compensator is not None)

    def relative_compliance(self, q2: Array) -> Array:
        """Return the compliance (n,) of the equivalent spring over that of the gear, at q2 (n,) [rad]; Eq. (4)."""
        if self.compensator is None:
            return np.ones(len(q2))
        return np.asarray(1.0 / (1.0 + self.compliance * self.compensator.stiffness_about_joint(q2)))

    def stiffness_columns(self, q2: Array) -> Array:
        """Return C (n, 3) of K_θ2(q2) = C·[K⁰_θ2, K_c, s₀K_c], first Eq. (10) of Klimchik et al.; `q2` (n,) [rad].

        Without a compensator the second and third column are zero.
        """
        if self.compensator is None:
            return np.column_stack([np.ones(len(q2)), np.zeros((len(q2), 2))])
        return np.column_stack([np.ones(len(q2)), self.compensator.stiffness_columns(q2)])

    def level_derivatives(self, levels: Array, q2: Array) -> Array:
        """Return ∂k2(q2)/∂k2(levels) (n, m): the effect of errors of k2 at m levels on k2 at n other angles.

        With a free compensator and three levels or more, the stiffness at q2 follows from the stiffnesses at the levels
        by least squares without weights, Eq. (9) of Klimchik et al. Else the compensator keeps the prior, and the
        stiffness of the gear is the mean over the levels.

        :param levels: (m,) [rad], and `q2` (n,) [rad].
        """
        compliance, level_compliance = self.relative_compliance(q2), self.relative_compliance(levels)
        if self.has_free_compensator and len(levels) >= LEAST_LEVELS:
            level_columns = self.stiffness_columns(levels)
            size = np.linalg.norm(level_columns, axis=0)
            stiffness_slopes = (self.stiffness_columns(q2) / size) @ np.linalg.pinv(level_columns / size, rcond=1e-9)
        else:
            stiffness_slopes = np.full((len(q2), len(levels)), 1.0 / len(levels))
        # ∂k/∂k' = ∂k/∂K · ∂K/∂K' · ∂K'/∂k', with ∂k/∂K = −k² for a compliance k = 1/K
        return np.asarray(compliance[:, None] ** 2 * stiffness_slopes / level_compliance**2)

    def parameter_derivatives(self, q2: Array) -> Array:
        """Return ∂k2(q2)/∂parameters (n, 1 or 3): relative gear compliance, then K_c and s₀K_c in units of K⁰_θ2.

        K_c and s₀K_c are parameters of a free compensator only. `q2` (n,) [rad].
        """
        square = self.relative_compliance(q2)[:, None] ** 2
        if not self.has_free_compensator:
            return square
        return np.concatenate([square, -square * self.stiffness_columns(q2)[:, 1:]], axis=1)


class MeasuredLoads(Struct, frozen=True, eq=False):
    """Loaded states that were already measured.

    :param q: (d, 6) joint angles of the states [rad].
    :param q2: (m,) levels of q2 [rad].
    :param information: (d, p, p) information matrix of each state, on the p identified compliances.
    :param level: (d,) level of each state, an index into `q2`.
    """

    q: Array
    q2: Array
    information: Array
    level: Ints


def measured_information(data: Measurements, readings: Readings, sigma: float) -> MeasuredLoads:
    """Return the information of readings that were already made, each loaded state weighted by its number of readings.

    The variance of a displacement is σ²/n with load plus σ²/n₀ without load, averaged over the points by precision.

    :param readings: with the compliances to be identified.
    :param sigma: noise of one coordinate of one reading [m].
    """
    level_of_config = levels_of(data)
    _, count = data.means()
    config = data.state_config[data.loaded_states]
    unloaded_state = data.unloaded_states[config]
    # σ² over the mean variance of a displacement; 0 if a point has no reading
    precision = np.maximum(1.0 / (1.0 / count[data.loaded_states] + 1.0 / count[unloaded_state]).mean(axis=1), 0.0)
    weight = precision * (readings.noise / sigma) ** 2
    information = readings.information_of(data.q[config], data.wrench[data.loaded_states]) * weight[:, None, None]
    level = level_of_config[config]
    q2 = np.array([data.q[level_of_config == index, 1].mean() for index in range(int(level_of_config.max()) + 1)])
    return MeasuredLoads(data.q[config], q2, information, level)


class Criterion(Struct, frozen=True, eq=False):
    """The criterion for given levels of q2. Its plans are arrays: information (n, p, p) and level (n,) of each pose.

    p is the number of joints whose compliance is identified, joint 2 among them. The extended set of P compliances has
    the p − 1 compliances that all levels share, then k2 of each of the m levels.

    :param is_grouped: whether each level is identified alone, as the formula is printed; else the levels are pooled.
    :param weight: Σ w A₀ᵀA₀ of the test poses: pooled (P, P), grouped (p, p).
    :param extended_index: (m, p) index in the extended set of each compliance of a level; grouped: 0…p − 1.
    :param earlier_matrix: normal matrix of earlier readings: pooled (P, P), grouped (m, p, p).
    """

    is_grouped: bool
    weight: Array
    extended_index: Ints
    earlier_matrix: Array

    @classmethod
    def of(
        cls,
        tests: TestPoses,
        readings: Readings,
        joint2: Joint2,
        q2: Array,
        grouped: bool,
        earlier_data: MeasuredLoads | None = None,
    ) -> Criterion:
        """Return the criterion for levels of q2.

        :param tests: poses at which errors count.
        :param readings: with the joints whose compliances are identified.
        :param joint2: model of joint 2, by which k2 at the test poses follows from k2 of the levels.
        :param q2: (m,) levels [rad].
        :param grouped: second Eq. (10) of Klimchik et al. as printed: each level is identified alone; else pooled.
        :param earlier_data: readings that were already made; None: there are none.
        """
        joints, levels = list(readings.identified_joints), len(q2)  # of the p compliances, from 0
        # (T, 3, p): displacement of the tool tip at each test pose by the compliances, in units of the robot's [m]
        regressor = tests.regressor[:, :, joints] * readings.unit_compliance[joints]
        size = len(joints)
        if grouped:
            extended_index = np.tile(np.arange(size), (levels, 1))
            earlier_matrix = np.zeros((levels, size, size))
        else:
            # extended set: compliances that all levels share, then k2 of each level
            k2 = joints.index(1)  # column of joint 2
            shared = [index for index in range(size) if index != k2]
            level_slopes = joint2.level_derivatives(q2, tests.q[:, 1])
            extended_regressor = np.empty((len(regressor), 3, size - 1 + levels))
            extended_regressor[:, :, : size - 1] = regressor[:, :, shared]
            extended_regressor[:, :, size - 1 :] = regressor[:, :, k2, None] * level_slopes[:, None, :]
            regressor = extended_regressor
            extended_index = np.empty((levels, size), dtype=np.int64)
            extended_index[:, shared] = np.arange(size - 1)
            extended_index[:, k2] = size - 1 + np.arange(levels)
            earlier_matrix = np.zeros((size - 1 + levels, size - 1 + levels))
        weight = np.einsum("t,tki,tkj->ij", tests.weight, regressor, regressor)
        criterion = cls(grouped, weight, extended_index, earlier_matrix)
        if earlier_data is None:
            return criterion
        matrix = criterion.normal_matrix(earlier_data.information, earlier_data.level)
        return replace(criterion, earlier_matrix=matrix)

    def normal_matrix(self, information: Array, level: Ints) -> Array:
        """Return the normal matrix of plan and earlier readings: pooled (P, P), grouped (m, p, p).

        :param information: (n, p, p) of the poses on the p identified compliances, and `level` (n,) their levels.
        """
        matrix = self.earlier_matrix.copy()
        if self.is_grouped:
            np.add.at(matrix, level, information)  # several poses of one level add up
            return matrix
        rows = self.extended_index[level]
        np.add.at(matrix, (rows[:, :, None], rows[:, None, :]), information)
        return matrix

    def value(self, information: Array, level: Ints) -> float:
        """Return the criterion of a plan [m²]; huge if a parameter is not determined.

        :param information: (n, p, p) of the poses on the p identified compliances, and `level` (n,) their levels.
        """
        return float(self.matrix_values(self.normal_matrix(information, level)[None])[0])

    def matrix_values(self, matrices: Array) -> Array:
        """Return the criterion (K,) [m²] of normal matrices (K, …): the trace of the weight times their inverses.

        Both are scaled so that the normal matrices have a diagonal of ones, for accurate inverses.
        """
        # 1e-300 keeps zero out of the denominator
        scale = np.sqrt(np.maximum(np.diagonal(matrices, axis1=-2, axis2=-1), 1e-300))
        normal = matrices / (scale[..., :, None] * scale[..., None, :])
        normal += 1e-11 * np.eye(matrices.shape[-1])  # an undetermined direction costs 10¹¹, instead of infinity
        weight = self.weight / (scale[..., :, None] * scale[..., None, :])
        cost = np.einsum("...ij,...ji->...", np.linalg.inv(normal), weight)
        return np.asarray(cost.sum(axis=-1) if self.is_grouped else cost)

    def exchange_values(self, matrix: Array, old: Array, new: Array, level: int) -> Array:
        """Return the criterion (K,) [m²] of plans in which one pose is exchanged for each of K others of its level.

        :param matrix: normal matrix of the present plan.
        :param old: (p, p) information of the pose, and `new` (K, p, p) of the other poses.
        :param level: number of the level of all these poses.
        """
        matrices = np.repeat(matrix[None], len(new), axis=0)
        change = new - old  # information of poses adds up
        if self.is_grouped:
            matrices[:, level] += change
        else:
            rows = self.extended_index[level]
            matrices[:, rows[:, None], rows[None]] += change
        return self.matrix_values(matrices)

    def information_slope(self, matrix: Array, level: Ints) -> Array:
        """Return ∂criterion/∂information (n, p, p) of poses at levels (n,): blocks of −N⁻¹ W N⁻¹.

        :param matrix: normal matrix N of the plan; W is `weight`, the sum over the test poses.
        :param level: number of the level of each pose, from 0.
        """
        inverse = np.linalg.inv(matrix)
        slope = -inverse @ self.weight @ inverse
        if self.is_grouped:
            return np.asarray(slope[level])
        rows = self.extended_index[level]
        return np.asarray(slope[rows[:, :, None], rows[:, None, :]])


_WEAK_PRIOR = 1e-9
"""Its square is added to a scaled diagonal of 1, so that undetermined parameters have a large, finite variance."""


class Accuracy(Struct, frozen=True, eq=False):
    """Expected error of the tool tip after compensation, over the test poses with their weights.

    :param rms: root of the expected mean square [m].
    :param interval: limits of the 95 % interval of the RMS error of one identification with this plan [m].
    :param poses: (T,) expected RMS error at each test pose [m].
    :param parameters: P parameters of the identification.
    :param relative_half_widths: (P,) of the 95 % intervals of the parameters, over the robot's values.
    """

    rms: float
    interval: tuple[float, float]
    poses: Array
    parameters: tuple[Parameter, ...]
    relative_half_widths: Array

    @property
    def uncertain(self) -> tuple[Parameter, ...]:
        """Parameters that the identification would not take from such measurements: their intervals are too wide."""
        pairs = zip(self.parameters, self.relative_half_widths, strict=True)
        # written with "not", so that NaN counts as too wide
        return tuple(parameter for parameter, half_width in pairs if not half_width <= UNCERTAIN_SHARE)


def expected_accuracy(
    tests: TestPoses,
    readings: Readings,
    joint2: Joint2,
    q: Array,
    information: Array,
    earlier_data: MeasuredLoads | None = None,
) -> Accuracy:
    """Return the expected accuracy of a plan, by the covariance of all parameters that the identification ends with.

    :param tests: poses at which errors count.
    :param readings: with the joints whose compliances are identified.
    :param joint2: gear and compensator of joint 2.
    :param q: (n, 6) poses of the plan [rad], with `information` (n, p, p) on the p compliances that are identified.
    :param earlier_data: readings that were already made, which count too; None: there are none.
    """
    joints = list(readings.identified_joints)
    if earlier_data is not None:
        q, information = np.vstack([q, earlier_data.q]), np.concatenate([information, earlier_data.information])
    slopes = _compliances_by_parameters(joint2, joints, q)
    normal = np.einsum("nia,nij,njb->ab", slopes, information, slopes)
    # (T, 3, P): displacement of the tool tip at each test pose by the parameters [m]
    tip_by_compliances = tests.regressor[:, :, joints] * readings.unit_compliance[joints]
    regressor = tip_by_compliances @ _compliances_by_parameters(joint2, joints, tests.q)
    covariance = _inverse(normal)
    variance = np.einsum("tka,ab,tkb->t", regressor, covariance, regressor)
    moment = np.einsum("t,tka,tkb->ab", tests.weight, regressor, regressor)
    mean = float(tests.weight @ variance)
    # the mean square error of one identification is a sum of squares of normal numbers: g·χ²_h (Satterthwaite 1946)
    product = covariance @ moment
    square = float(np.sum(product * product.T))
    h, g = mean**2 / square, square / mean
    lower, upper = (float(np.sqrt(g * _chi2_quantile(h, z))) for z in (-NORMAL_95, NORMAL_95))
    return Accuracy(
        rms=float(np.sqrt(mean)),
        interval=(lower, upper),
        poses=np.sqrt(variance),
        parameters=(
            *(JOINT_COMPLIANCES[joint] for joint in joints),
            *(COMPENSATOR if joint2.has_free_compensator else ()),
        ),
        relative_half_widths=NORMAL_95 * np.sqrt(np.diag(covariance)) / _robot_values(joint2, len(joints)),
    )


def _robot_values(joint2: Joint2, count: int) -> Array:
    """Return the robot's values (P,) of the parameters in the units of the plan.

    Compliances are relative to the robot's own, so that their values are 1. If the compensator is free, K_c and s₀K_c
    follow, in units of the stiffness of the gear of joint 2.

    :param count: number of compliances.
    """
    if not joint2.has_free_compensator or joint2.compensator is None:
        return np.ones(count)
    stiffness = joint2.compensator.stiffness * joint2.compliance
    # 1e-300 keeps zero out of the denominator
    spring = np.maximum([stiffness, stiffness * joint2.compensator.free_length], 1e-300)
    return np.concatenate([np.ones(count), spring])


def unidentifiable_joints(information: Array, count: int) -> tuple[int, ...]:
    """Return the joints, from 0, whose compliance no plan of `count` poses could determine.

    Even if all poses were as good as the best one, the 95 % interval of the compliance would be wider than
    `UNCERTAIN_SHARE` times the compliance, which the identification does not accept.

    :param information: (N, 6, 6) of many feasible poses, on the six compliances relative to their values.
    :param count: number of poses of the plan.
    """
    best_information = np.diagonal(information, axis1=1, axis2=2).max(axis=0)
    least_information = (NORMAL_95 / UNCERTAIN_SHARE) ** 2
    return tuple(int(joint) for joint in np.flatnonzero(best_information * count < least_information))


def _compliances_by_parameters(joint2: Joint2, joints: list[int], q: Array) -> Array:
    """Return the derivatives (n, p, P) of p compliances at configurations q (n, 6) [rad] by the P parameters.

    Parameters are the compliances, for joint 2 the compliance of its gear; then K_c and s₀K_c, if they are free.

    :param joint2: gear and compensator of joint 2.
    :param joints: joints of the p compliances, from 0; joint 2 is among them.
    """
    size, row = len(joints), joints.index(1)
    by_joint2 = joint2.parameter_derivatives(q[:, 1])
    slopes = np.zeros((len(q), size, size + by_joint2.shape[1] - 1))
    slopes[:, range(size), range(size)] = 1.0
    slopes[:, row, row] = by_joint2[:, 0]
    slopes[:, row, size:] = by_joint2[:, 1:]
    return slopes


def _inverse(normal: Array) -> Array:
    """Return the inverse of a normal matrix (p, p).

    Parameters are scaled to a unit diagonal. As the matrix may be singular, `_WEAK_PRIOR` is added.
    """
    # 1e-300 keeps zero out of the denominator
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    matrix = normal * np.outer(scale, scale) + _WEAK_PRIOR**2 * np.eye(len(normal))
    return np.asarray(np.linalg.inv(matrix) * np.outer(scale, scale))


def _chi2_quantile(freedom: float, z: float) -> float:
    """Return the quantile of χ² with `freedom` degrees of freedom at the probability Φ(z) of a normal distribution."""
    from scipy.special import gammaincinv, ndtr  # takes long to import

    return float(2.0 * gammaincinv(0.5 * freedom, ndtr(z)))


_POSES_PER_DIRECTION = 3
"""One of this many poses at least must load a joint in each direction; `MIN_CONFIGURATIONS` poses cover a direction
(assumed)."""
_TYPICAL_SHARE = 0.95
"""Torques of a joint up to this quantile of the poses are typical (assumed)."""
_RARE_SHARE = 0.01
"""Share of poses below which a direction counts as out of reach."""
_LEAST_TORQUE_SHARE, _MOST_TORQUE_SHARE = 0.1, 0.5
"""Limits of the torque from which on a pose counts, over the typical largest torque of candidates."""


class Directions(Struct, frozen=True, eq=False):
    """Demand on a plan: poses that must load each joint in each direction (column 0 negative, 1 positive).

    :param pose_count: (6, 2) required poses in addition to earlier readings; 0 for directions that the rig cannot load.
    :param min_torque: (6, 2) torque from which on a pose counts [N·m].
    :param rig_torque: (6, 2) typical largest torque of feasible poses [N·m]; 0 if too few poses have such a torque.
    :param work_torque: (6, 2) typical largest torque of the work [N·m].
    """

    pose_count: Ints
    min_torque: Array
    rig_torque: Array
    work_torque: Array

    def loaded_sides(self, torque: Array) -> Bools:
        """Return True for directions (..., 6, 2) in which torques (..., 6) [N·m] load the joints enough to count."""
        return np.asarray(split_signs(torque) >= self.min_torque)

    def missing_count(self, count: Ints) -> Ints:
        """Return the number (...) of poses that are missing, summed over joints and directions.

        :param count: (..., 6, 2) number of poses that load each joint in each direction.
        """
        return np.asarray(np.maximum(self.pose_count - count, 0).sum(axis=(-2, -1)))


def required_directions(torque: Array, tests: TestPoses, poses: int, data_torque: Array | None = None) -> Directions:
    """Return the demand on a plan: numbers of poses that must load each joint in each direction.

    A pose counts from the typical torque of the work on, within limits by the torques of the rig. Earlier readings that
    count reduce the numbers.

    :param torque: (N, 6) of many feasible poses with the load of the rig [N·m].
    :param tests: poses and forces of the work.
    :param poses: number of poses of the plan.
    :param data_torque: (m, 6) torques of configurations that were already measured [N·m]; None: there are none.
    """
    sides = split_signs(torque)
    rig_torque = _typical_torques(sides, np.full(len(torque), 1.0 / max(len(torque), 1)))
    work_torque = _typical_torques(split_signs(tests.torque), tests.weight)
    threshold = np.clip(work_torque, _LEAST_TORQUE_SHARE * rig_torque, _MOST_TORQUE_SHARE * rig_torque)
    earlier_torque = np.zeros((0, 6)) if data_torque is None else data_torque
    sufficient_count = min(MIN_CONFIGURATIONS, (poses + len(earlier_torque)) // _POSES_PER_DIRECTION)
    demand = Directions(
        pose_count=np.where(rig_torque > 0.0, sufficient_count, 0),
        min_torque=np.maximum(threshold, LEAST_TORQUE),
        rig_torque=rig_torque,
        work_torque=work_torque,
    )
    remaining_count = np.maximum(demand.pose_count - demand.loaded_sides(earlier_torque).sum(axis=0), 0)
    return replace(demand, pose_count=remaining_count)


def _typical_torques(sides: Array, weight: Array) -> Array:
    """Return the typical largest torque (6, 2) [N·m] on each joint in each direction: a weighted 95 % quantile.

    Only torques above `LEAST_TORQUE` count; the result is 0 if less than 1 % of the weight has such a torque.

    :param sides: (n, 6, 2) sizes of the torques in each direction [N·m], and `weight` (n,) of the poses, sum 1.
    """
    quantile = np.zeros((6, 2))
    for joint, side in np.ndindex(6, 2):
        values = sides[:, joint, side]
        rows = np.flatnonzero(values > LEAST_TORQUE)
        if weight[rows].sum() > _RARE_SHARE:
            rows = rows[np.argsort(values[rows])]
            share = np.cumsum(weight[rows]) / weight[rows].sum()  # ascending to 1
            quantile[joint, side] = values[rows[np.searchsorted(share, _TYPICAL_SHARE)]]
    return quantile


def unreachable_direction_warnings(demand: Directions, vertical: bool) -> tuple[str, ...]:
    """Return a warning on joints that the rig cannot load in one direction or in both; empty if it can load all.

    :param vertical: whether every load of the rig hangs vertically.
    """
    parts = []
    for joint, name in enumerate(JOINTS):
        sides = [
            side for side in range(len(SIGNS)) if demand.rig_torque[joint, side] == 0.0
        ]  # that the rig cannot load
        work_torques = [
            f"{demand.work_torque[joint, side]:.0f} N·m {SIGNS[side]}"
            for side in sides
            if demand.work_torque[joint, side] > 0.0
        ]
        if sides:
            note = f"; the work has up to {' and '.join(work_torques)}" if work_torques else ""
            parts.append(f"{name} ({' and '.join(SIGNS[side] for side in sides)}{note})")
    if not parts:
        return ()
    advice = "another load point, or [rig] max_angle_deg if a pulley can turn the pull, may reach it"
    if not vertical:
        advice = "another load point or a larger [rig] max_angle_deg may reach it"
    return (
        f"with this rig the load cannot turn the torque on {', '.join(parts)}: lost motion to that side stays unknown, "
        f"and `identify validate` covers no job that needs it; {advice}",
    )
