"""Test poses: the poses and forces of the user's programs, thinned to a few that represent all.

Source: Klimchik et al., second Eq. (10): q₀ and F₀ "related to a typical machining configuration and force".
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc import files, kinematics
from postproc.cell import Cell
from postproc.chunks import Columns
from postproc.elastostatics import linear_deflection
from postproc.errors import PlanError
from postproc.forces import ForceSource
from postproc.frames import RAD_PER_DEG, Array
from postproc.program import WRENCH, Bools, Ints, Program
from postproc.robot import JOINTS, RobotModel
from postproc.under_load import ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, RobotInCell

_MAX_SAMPLES = 4000
"""Samples of a program that test poses are chosen from: of longer programs each second, third, … sample counts."""
_ROUNDS = 30
"""Rounds of Lloyd's algorithm (assumed)."""
_SHARE_OF_Q2 = 0.3
"""Weight of q2 against the other features (assumed): test poses are to cover the range of joint 2 as well."""
_FORCES = WRENCH[:3]


class TestPoses(Columns, frozen=True, eq=False):
    """T poses at which the error after compensation counts.

    :param q: (T, 6) joint angles [rad].
    :param wrench: (T, 6) on the tool tip, root axes [N, N·m].
    :param weight: (T,) shares of the work, sum 1.
    :param torque: (T, 6) on the joints by the wrench [N·m].
    :param regressor: (T, 3, 6) A₀ of Eq. (2), positions: ∂(tool tip)/∂(joint compliance) [m per rad/(N·m)].
    :param deflection: (T,) due to the force, without correction [m].
    :param is_law_force: (T,) whether a cutting law computes the wrench; errors of such wrenches are one common factor.
    :param source: names of the files of the poses.
    """

    __test__ = False  # not a test of pytest

    q: Array
    wrench: Array
    weight: Array
    torque: Array
    regressor: Array
    deflection: Array
    is_law_force: Bools
    source: str

    def __len__(self) -> int:
        return len(self.q)

    @property
    def second_moment(self) -> Array:
        """Σ w A₀ᵀA₀ (6, 6): the criterion depends on the test poses by this matrix and by q2 alone."""
        return np.asarray(np.einsum("t,tki,tkj->ij", self.weight, self.regressor, self.regressor))


def poses_under_load(
    robot: RobotModel,
    q: Array,
    tool: Array,
    wrench: Array,
    *,
    weight: Array,
    source: str,
    is_law_force: Bools | None = None,
) -> TestPoses:
    """Return the test poses of configurations under load, with torques, derivatives and deflections.

    The tool tip moves by J·δ, and joint k turns by δ_k = compliance · torque. So the regressor, the derivative of its
    position by the compliance of joint k, is column k of the position rows of J times the torque on joint k.

    :param q: (T, 6) joint angles [rad].
    :param tool: (4, 4) or (T, 4, 4) tool tip in the flange frame [m].
    :param wrench: (T, 6) on the tool tip, root axes [N, N·m].
    :param weight: (T,) of the poses, of any sum; they are normalised.
    :param source: names of the files of the poses.
    :param is_law_force: (T,) whether a cutting law computes the wrench; None: no wrench is computed.
    """
    _, jacobian = kinematics.tcp(robot.nominal, q, tool)
    torque = np.einsum("nij,ni->nj", jacobian, wrench)
    loaded_shift, sag = (linear_deflection(robot, q, tool, load)[:, :3] for load in (wrench, np.zeros_like(wrench)))
    deflection = loaded_shift - sag  # a robot with a weightless geometry sags without load too
    return TestPoses(
        q=q,
        wrench=wrench,
        weight=weight / weight.sum(),
        torque=torque,
        regressor=jacobian[:, :3] * torque[:, None],
        deflection=np.linalg.norm(deflection, axis=1),
        is_law_force=np.zeros(len(q), dtype=np.bool_) if is_law_force is None else is_law_force,
        source=source,
    )


def from_program(program: Program, robot: RobotModel, cell: Cell, source: ForceSource | None = None) -> TestPoses:
    """Return test poses along the cutting moves of a program, weighted by the length of cut.

    :param source: forces; they take precedence over the comments of the program. None: the comments alone.
    :raises PlanError: no cutting move carries a force, or the robot cannot reach a pose.
    :raises ForceError: forces cannot be assigned to the motions.
    """
    name, m = program.documents[0].name, program.motions
    try:
        motions = MotionsUnderLoad.of(program, RobotInCell.of(robot, cell), source)
        path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    except ImpossiblePathError as cause:
        raise PlanError(cause.issue.message.rstrip("."), file=name, line=cause.issue.source_line) from None
    motion, distance = path.sample.motion, path.sample.distance
    # length of path from the sample before to each sample: distances begin anew with each motion
    previous_distance = np.concatenate([[0.0], distance[:-1]])
    is_first_of_motion = np.concatenate([[True], np.diff(motion) != 0])
    length = np.where(is_first_of_motion, distance, distance - previous_distance)
    wrench = path.wrench_in_root(np.arange(len(path)))
    cutting = np.flatnonzero(~m.rapid[motion] & (length > 0.0) & (np.abs(wrench).max(axis=1) > 0.0))
    if len(cutting) == 0:
        raise PlanError(
            "no cutting move of this program carries a force",
            file=name,
            advice="Give forces with --forces, or as comments (FORCE FX= FY= FZ=), or test poses with --poses.",
        )
    rows, lengths = _thin_rows(cutting, length[cutting])
    tool, law = program.tools[m.tool[motion[rows]]], motions.forces.law_forces
    is_law_force = None if law is None else np.isin(motion[rows], law.motion)
    return poses_under_load(
        robot, path.joints.q[rows], tool, wrench[rows], weight=lengths, source=name, is_law_force=is_law_force
    )


def _thin_rows(rows: Ints, length: Array) -> tuple[Ints, Array]:
    """Return at most `_MAX_SAMPLES` of the rows of a path, evenly, and the lengths of path that they represent [m].

    The rows are split into pieces of equal numbers. The middle row of each piece represents the length of the piece.

    :param rows: (n,) sampled rows, and `length` (n,) of the path from the row before to each row [m].
    """
    piece_size = -(-len(rows) // _MAX_SAMPLES)  # a quotient, rounded up
    begin = np.arange(0, len(rows), piece_size)
    return rows[np.minimum(begin + piece_size // 2, len(rows) - 1)], np.add.reduceat(length, begin)


def from_file(path: Path, robot: RobotModel, cell: Cell) -> TestPoses:
    """Read test poses from a file: CSV A1…A6 [deg], Fx, Fy, Fz [N] at the tool tip in root axes[, weight].

    :raises PlanError: a column is missing or not a number, a weight is negative, there is no pose or no force.
    """
    numbers, _, lines = files.read_csv(path, (*JOINTS, *_FORCES), ("weight",), PlanError)
    if len(lines) == 0:
        raise PlanError("no test poses", file=str(path))
    weight = numbers.get("weight", np.ones(len(lines)))
    wrench = np.zeros((len(lines), 6))
    wrench[:, :3] = np.column_stack([numbers[name] for name in _FORCES])
    for is_invalid, problem in (
        (weight <= 0.0, "weight must be larger than 0"),
        (~wrench.any(axis=1), "the force is zero"),
    ):
        if is_invalid.any():
            raise PlanError(problem, file=str(path), line=int(lines[np.argmax(is_invalid)]))
    q = np.column_stack([numbers[name] for name in JOINTS]) * RAD_PER_DEG
    return poses_under_load(robot, q, cell.tool.pose(), wrench, weight=weight, source=path.name)


def join(parts: Sequence[TestPoses]) -> TestPoses:
    """Return the test poses of several programs together; each program has the same total weight."""
    weight = np.concatenate([part.weight for part in parts]) / len(parts)
    return TestPoses(
        q=np.concatenate([part.q for part in parts]),
        wrench=np.concatenate([part.wrench for part in parts]),
        weight=weight,
        torque=np.concatenate([part.torque for part in parts]),
        regressor=np.concatenate([part.regressor for part in parts]),
        deflection=np.concatenate([part.deflection for part in parts]),
        is_law_force=np.concatenate([part.is_law_force for part in parts]),
        source=", ".join(part.source for part in parts),
    )


def representatives(tests: TestPoses, robot_compliance: Array, count: int, seed: int) -> TestPoses:
    """Return at most `count` poses that represent all poses, with weights.

    Poses are clustered (k-means, Lloyd 1982) by the inputs of the criterion: A₀ᵀA₀, with the regressor A₀ in units of
    the compliances, and q2. The pose nearest to the mean of a cluster represents it, with the weight of the cluster.
    Then all forces are scaled so that Σ w A₀ᵀA₀ keeps its trace. With `count` poses or fewer nothing changes.

    :param robot_compliance: (6,) compliances of the robot [rad/(N·m)].
    :param seed: of the random choice of the first cluster centres.
    """
    if len(tests) <= count:
        return tests
    rows, weight = _cluster(_features(tests, robot_compliance), tests.weight, count, seed)
    sample = replace(tests.take(rows), weight=weight)
    full_trace, sample_trace = (
        np.trace(poses.second_moment * np.outer(robot_compliance, robot_compliance)) for poses in (tests, sample)
    )
    factor = np.sqrt(full_trace / sample_trace) if sample_trace > 0.0 else 1.0
    return TestPoses(
        q=sample.q,
        wrench=sample.wrench * factor,
        weight=sample.weight,
        torque=sample.torque * factor,
        regressor=sample.regressor * factor,
        deflection=sample.deflection * factor,
        is_law_force=sample.is_law_force,
        source=tests.source,
    )


def _features(tests: TestPoses, robot_compliance: Array) -> Array:
    """Return the features (T, 22) of T test poses for clustering: the 21 different entries of A₀ᵀA₀, and q2.

    :param robot_compliance: (6,) compliances of the robot [rad/(N·m)].
    """
    regressor = tests.regressor * robot_compliance
    square = np.einsum("tki,tkj->tij", regressor, regressor)
    row, column = np.triu_indices(6)
    # an entry off the diagonal counts twice, so that distances of features are distances of the matrices
    features = square[:, row, column] * np.where(row == column, 1.0, np.sqrt(2.0))
    q2 = tests.q[:, 1:2] - np.average(tests.q[:, 1:2], axis=0, weights=tests.weight)
    return np.hstack([features, _SHARE_OF_Q2 * q2 * float(np.linalg.norm(features, axis=1).mean())])


def _cluster(features: Array, weight: Array, count: int, seed: int) -> tuple[Ints, Array]:
    """Cluster points by k-means, begun with k-means++ (Arthur and Vassilvitskii 2007).

    :param features: (T, k) of the points, and `weight` (T,) of the points, sum 1.
    :param count: largest number of clusters; there are fewer if fewer points differ.
    :returns: for each of C clusters the row of the point nearest to its mean (C,), and its weight (C,).
    """
    rng = np.random.default_rng(seed)
    # k-means++: each further centre is drawn with a chance in proportion to its squared distance from the others
    centres = features[[int(rng.choice(len(features), p=weight))]]
    for _ in range(count - 1):
        distance = _squared_distances(features, centres).min(axis=1) * weight
        if distance.sum() <= 0.0:
            break
        centres = np.vstack([centres, features[int(rng.choice(len(features), p=distance / distance.sum()))]])
    cluster = np.zeros(len(features), dtype=np.int64)  # of each point
    for _ in range(_ROUNDS):
        cluster = _squared_distances(features, centres).argmin(axis=1)
        total = np.bincount(cluster, weights=weight, minlength=len(centres))
        weighted_sums = [np.bincount(cluster, weight * feature, len(centres)) for feature in features.T]
        # 1e-300 keeps zero out of the denominator
        mean = np.stack(weighted_sums, axis=1) / np.maximum(total, 1e-300)[:, None]
        centres = np.where(total[:, None] > 0.0, mean, centres)  # an empty cluster keeps its centre
    distance = _squared_distances(features, centres)
    clusters = np.unique(cluster)
    rows = np.array([np.flatnonzero(cluster == c)[distance[cluster == c, c].argmin()] for c in clusters])
    cluster_weight = np.bincount(cluster, weights=weight, minlength=len(centres))[clusters]
    return rows, np.asarray(cluster_weight, dtype=float)


def _squared_distances(features: Array, centres: Array) -> Array:
    """Return the squared distances (T, C) of features (T, k) from centres (C, k): |f|² − 2 f·c + |c|², ≥ 0."""
    return np.asarray(
        np.maximum((features**2).sum(1)[:, None] - 2.0 * features @ centres.T + (centres**2).sum(1)[None], 0.0)
    )
