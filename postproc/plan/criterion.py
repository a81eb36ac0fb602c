"""What a plan is worth: the error expected after compensation at the test poses.

Source: Klimchik et al., second Eq. (10): trace(A₀ Σ_j (Σ_i A_iʲᵀ A_iʲ)⁻¹ A₀ᵀ), summed over the test poses with weights.

*Grouped* is this formula as printed: each level of q2 is a group identified alone.

*Pooled* (the default) is what the identification does with the data: Eq. (8) shares k1, k3…k6 between the groups and
has one k2 per level, so the covariance is the inverse of one pooled matrix of the extended set; k2 at a test pose comes
from the levels by Eq. (9), (10): K⁰_θ2, K_c, s₀K_c by least squares, then Eq. (4) at the q2 of the test pose. Where K_c
is kept at the robot's prior (it is rarely observable), K⁰_θ2 alone is the mean over the levels.

Both are in m²: the mean over the test poses of the squared distance that remains. Compliances are in units of the
robot's own (`Readings.scale`).

`Joint2` is the compliance of joint 2 between the levels of q2 where it is measured: second step of the paper, Eq. (4),
(9), (10). `Measured` is what was measured already, on its own levels of q2.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.compensator import Compensator
from postproc.frames import Array
from postproc.identification.measurements import Measurements
from postproc.identification.observability import levels_of
from postproc.plan.milling import TestPoses
from postproc.plan.sensitivity import Readings
from postproc.program import Ints
from postproc.robot import RobotModel

_LEVELS = 3


class Joint2(Struct, frozen=True, eq=False):
    """Equivalent spring of joint 2, relative to the compliance of its gear.

    :param compliance: of the gear, 1/K⁰_θ2 [rad/(N·m)].
    :param compensator: its law, or None.
    :param free: K_c and s₀ are identified too; else they stay at the robot's values.
    """

    compliance: float
    compensator: Compensator | None
    free: bool

    @classmethod
    def of(cls, robot: RobotModel, free: bool) -> Joint2:
        """Take joint 2 of a robot."""
        compliance = float(robot.compliance[robot.actuated[1]])
        return cls(compliance, robot.compensator, free and robot.compensator is not None)

    def relative(self, q2: Array) -> Array:
        """Return k2(q2) (n,) in units of the gear's compliance, Eq. (4)."""
        if self.compensator is None:
            return np.ones(len(q2))
        return np.asarray(1.0 / (1.0 + self.compliance * self.compensator.stiffness_about_joint(q2)))

    def columns(self, q2: Array) -> Array:
        """Return C (n, 3) of the printed first Eq. (10): K_θ2(q2) = C·[K⁰_θ2, K_c, s₀K_c]."""
        if self.compensator is None:
            return np.column_stack([np.ones(len(q2)), np.zeros((len(q2), 2))])
        return np.column_stack([np.ones(len(q2)), self.compensator.stiffness_columns(q2)])

    def from_levels(self, levels: Array, q2: Array) -> Array:
        """Return ∂k2(q2)/∂k2(levels), (n, m): how errors of the levels reach other q2, by Eq. (9) unweighted.

        With fewer than three levels the compensator is not identifiable and stays at the prior.
        """
        here, there = self.relative(q2), self.relative(levels)
        if self.free and len(levels) >= _LEVELS:
            c = self.columns(levels)
            size = np.linalg.norm(c, axis=0)
            share = (self.columns(q2) / size) @ np.linalg.pinv(c / size, rcond=1e-9)
        else:
            share = np.full((len(q2), len(levels)), 1.0 / len(levels))
        return np.asarray(here[:, None] ** 2 * share / there**2)

    def parameters(self, q2: Array) -> Array:
        """Return ∂k2(q2)/∂parameters (n, 1 or 3): relative gear compliance, then K_c and s₀K_c in units of K⁰_θ2."""
        here = self.relative(q2)[:, None] ** 2
        if not self.free:
            return here
        return np.concatenate([here, -here * self.columns(q2)[:, 1:]], axis=1)


class Measured(Struct, frozen=True, eq=False):
    """Loaded states measured so far.

    :param q: (d, 6) configurations [rad].
    :param q2: (m,) their levels [rad].
    :param information: (d, p, p) of each.
    :param level: (d,) its row among `q2`.
    """

    q: Array
    q2: Array
    information: Array
    level: Ints


def measured(data: Measurements, readings: Readings, sigma: float) -> Measured:
    """Weigh each loaded state by how often it and its unloaded state were read.

    :param readings: with the compliances looked for.
    :param sigma: noise of one coordinate of one reading [m].
    """
    level_of_config = levels_of(data)
    _, count = data.means()
    config = data.state_config[data.loaded]
    rest = data.unloaded[config]
    times = np.maximum(1.0 / (1.0 / count[data.loaded] + 1.0 / count[rest]).mean(axis=1), 0.0)
    share = times * (readings.noise / sigma) ** 2
    information = readings.information_of(data.q[config], data.wrench[data.loaded]) * share[:, None, None]
    level = level_of_config[config]
    q2 = np.array([data.q[level_of_config == index, 1].mean() for index in range(int(level_of_config.max()) + 1)])
    return Measured(data.q[config], q2, information, level)


class Criterion(Struct, frozen=True, eq=False):
    """The criterion for given levels of q2. Its plans are arrays: information (n, p, p) and level (n,) of each pose.

    :param grouped: as printed, or pooled.
    :param two: place of k2 among the p compliances looked for.
    :param weight: pooled: (p − 1 + m, p − 1 + m) Σ w A₀ᵀA₀ of the extended set; grouped: (p, p).
    :param spread: (m, p) index of each compliance of a group in the extended set.
    :param before: information of what was measured already: pooled in the extended set, grouped (m, p, p).
    """

    grouped: bool
    two: int
    weight: Array
    spread: Ints
    before: Array

    @classmethod
    def of(
        cls,
        tests: TestPoses,
        readings: Readings,
        joint2: Joint2,
        q2: Array,
        grouped: bool,
        measured: Measured | None = None,
    ) -> Criterion:
        """Make the criterion for levels q2 (m,) [rad]; `measured` is what was measured already."""
        keep, levels = list(readings.keep), len(q2)
        two = keep.index(1)
        a = tests.regressor[:, :, keep] * readings.scale[keep]  # (T, 3, p)
        size = len(keep)
        if grouped:
            weight = np.einsum("t,tki,tkj->ij", tests.weight, a, a)
            spread = np.tile(np.arange(size), (levels, 1))
            before = np.zeros((levels, size, size))
            if measured is not None:
                np.add.at(before, measured.level, measured.information)
            return cls(True, two, weight, spread, before)
        shared = [index for index in range(size) if index != two]
        extended = np.zeros((len(a), 3, size - 1 + levels))
        extended[:, :, : size - 1] = a[:, :, shared]
        extended[:, :, size - 1 :] = a[:, :, two, None] * joint2.from_levels(q2, tests.q[:, 1])[:, None, :]
        weight = np.einsum("t,tki,tkj->ij", tests.weight, extended, extended)
        spread = np.empty((levels, size), dtype=np.int64)
        spread[:, shared] = np.arange(size - 1)
        spread[:, two] = size - 1 + np.arange(levels)
        empty = cls(False, two, weight, spread, np.zeros_like(weight))
        if measured is None:
            return empty
        return replace(empty, before=empty.total(measured.information, measured.level))

    def total(self, information: Array, level: Ints) -> Array:
        """Return the normal matrix: pooled (P, P) of the extended set, grouped (m, p, p)."""
        out = self.before.copy()
        if self.grouped:
            np.add.at(out, level, information)
            return out
        where = self.spread[level]
        np.add.at(out, (where[:, :, None], where[:, None, :]), information)
        return out

    def value(self, information: Array, level: Ints) -> float:
        """Return the criterion of a plan [m²]; infinite if it leaves something open."""
        return float(self.of_totals(self.total(information, level)[None])[0])

    def of_totals(self, total: Array) -> Array:
        """Return the criterion (K,) [m²] of normal matrices (K, …)."""
        diagonal = np.sqrt(np.maximum(np.diagonal(total, axis1=-2, axis2=-1), 1e-300))
        scaled = total / (diagonal[..., :, None] * diagonal[..., None, :])
        scaled += 1e-11 * np.eye(total.shape[-1])  # an open direction costs 10¹¹, without a division by zero
        weight = self.weight / (diagonal[..., :, None] * diagonal[..., None, :])
        cost = np.einsum("...ij,...ji->...", np.linalg.inv(scaled), weight)
        return np.asarray(cost.sum(axis=-1) if self.grouped else cost)

    def exchanged(self, total: Array, old: Array, new: Array, level: int) -> Array:
        """Return the criterion (K,) if in one group information `old` (p, p) is replaced by each of `new` (K, p, p).

        :param total: normal matrix of the plan as it is.
        """
        candidates = np.repeat(total[None], len(new), axis=0)
        if self.grouped:
            candidates[:, level] += new - old
        else:
            where = self.spread[level]
            candidates[:, where[:, None], where[None]] += new - old
        return self.of_totals(candidates)

    def push(self, total: Array, level: Ints) -> Array:
        """Return ∂criterion/∂information (n, p, p) for measurements of levels (n,)."""
        inverse = np.linalg.inv(total)
        slope = -inverse @ self.weight @ inverse
        if self.grouped:
            return np.asarray(slope[level])
        where = self.spread[level]
        return np.asarray(slope[where[:, :, None], where[:, None, :]])
