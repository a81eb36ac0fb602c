"""What a plan is worth: the error expected after compensation at the test poses.

Source: Klimchik et al., second Eq. (10): trace(A₀ Σ_j (Σ_i A_iʲᵀ A_iʲ)⁻¹ A₀ᵀ), summed over the test poses with weights.

*Grouped* is this formula as printed: each level of q2 is a group identified alone.

*Pooled* (the default) is what the identification does with the data: Eq. (8) shares k1, k3…k6 between the groups and
has one k2 per level, so the covariance is the inverse of one pooled matrix of the extended set; k2 at a test pose comes
from the levels by Eq. (9), (10): K⁰_θ2, K_c, s₀K_c by least squares, then Eq. (4) at the q2 of the test pose. Where K_c
is kept at the robot's prior (it is rarely observable), K⁰_θ2 alone is the mean over the levels.

Both are in m²: the mean over the test poses of the squared distance that remains. Compliances are in units of the
robot's own (`Readings.scale`).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.frames import Array
from postproc.plan.joint2 import Joint2
from postproc.plan.measured import Measured
from postproc.plan.milling import TestPoses
from postproc.plan.sensitivity import Readings
from postproc.program import Ints


class Criterion(Struct, frozen=True, eq=False):
    """The criterion for given levels of q2. Its plans are arrays: information (n, p, p) and level (n,) of each pose.

    :param grouped: as printed, or pooled.
    :param two: place of k2 among the p compliances looked for.
    :param weight: pooled: (p − 1 + m, p − 1 + m) Σ w A₀ᵀA₀ of the extended set; grouped: (p, p).
    :param spread: (m, p) where each compliance of a group stands in the extended set.
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
