"""Expected error on the part without and with correction, and the chance that correction makes the part better.

**One error in both.** The tool is at d + e from its nominal position if nothing is corrected: d is the deviation that
the model predicts, e the error of the prediction. The corrected program takes d back, but for what it leaves, r: the
tool is at r + e. Model, forces and pose are the same up to the correction, so e is the same. It is normal with mean
zero and the covariances of `SourcesOfError`.

**Expected error (95 %)** of both: the 95 % quantile of the length of a normal vector with mean d, or r, and the
covariance of e (`length_bound`).

**Chance.** The part is better if the RMS along the cutting path is smaller. With the length w of the path for which
each target stands, Σ w|r + e|² < Σ w|d + e|². The squares of e cancel:

    Σ w (d − r)·e > −½ Σ w (|d|² − |r|²)

The left side is linear in e, so it is normal with mean zero. With its standard deviation σ the chance is
Φ(½ Σ w (|d|² − |r|²) / σ). For one unknown factor of relative standard deviation s, e = s·z·d and r = 0, it is
Φ(1/(2s)).
Where the path on the way to a target is further from nominal than r, that distance takes the place of |r|.

σ² adds up over independent sources (JCGM 100:2008, "Guide to the expression of uncertainty in measurement", 5.1.2).
Within a source the errors at different targets are correlated:

- A parameter of the model has one error for all targets, and so has a factor of all forces: their displacements are
  added over the targets before they are squared (ibid., 5.2.2). This is exact.
- Standard deviations of the components of a wrench come without correlation from target to target. One relative error
  of a component for all targets counts, as of a coefficient or a scale: of independent errors less would remain.
- Neither is it known for the unmodelled error, for lost motion and for the error of the geometry. σ is then the sum of
  the standard deviations at the targets, the largest that any correlation gives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from msgspec import Struct

from postproc.elastostatics.uncertainty import SourcesOfError, largest_length
from postproc.frames import Array, norm
from postproc.program import Bools

HARMFUL_CHANCE = 0.5
"""Chance below which correction does more harm than good."""
UNCERTAIN_CHANCE = 0.84
"""Chance below which a bound is wide: the gain is smaller than one standard deviation of itself (Φ(1) = 0.84)."""


class ExpectedErrorsAtPlaces(Struct, frozen=True, eq=False):
    """Expected errors (95 %) on the part at n places (n,) [m].

    :param bound: of the prediction.
    :param before: if nothing is corrected.
    :param after: with correction.
    :param with_known_robot: with correction, if the errors of the forces were the only ones.
    :param with_known_forces: with correction, if the forces were certain.
    """

    bound: Array
    before: Array
    after: Array
    with_known_robot: Array
    with_known_forces: Array


def expected_errors(errors: SourcesOfError, deviation: Array, remaining_deviation: Array) -> ExpectedErrorsAtPlaces:
    """Return the expected errors at n places.

    :param deviation: (n, 3) from nominal if nothing is corrected, root axes [m].
    :param remaining_deviation: (n, 3) from nominal with correction [m].
    """
    covariances = errors.covariances()
    return ExpectedErrorsAtPlaces(
        bound=largest_length(covariances),
        before=largest_length(covariances, deviation),
        after=largest_length(covariances, remaining_deviation),
        with_known_robot=largest_length(
            [displacement @ np.swapaxes(displacement, 1, 2) for displacement in errors.force_displacements],
            remaining_deviation,
        ),
        with_known_forces=largest_length([errors.robot_covariance], remaining_deviation),
    )


def chances_of_gain(errors: SourcesOfError, deviation: Array) -> Array:
    """Return the probability (n,) that correction improves each of n places, see the module; 1 without error.

    :param deviation: (n, 3) from nominal if nothing is corrected, root axes [m]; correction takes all of it back.
    """
    variance = np.max(
        [np.einsum("ni,nij,nj->n", deviation, covariance, deviation) for covariance in errors.covariances()], axis=0
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        gain_over_sigma = 0.5 * np.sum(deviation**2, axis=1) / np.sqrt(2.0 * np.maximum(variance, 0.0))
    # Φ(z) = ½·erfc(−z/√2); 0/0 is a place without deviation
    ratios = np.nan_to_num(gain_over_sigma, nan=0.0, posinf=np.inf).tolist()
    return 0.5 * np.array([math.erfc(-ratio) for ratio in ratios])


class ChanceOfGain:
    """Sums along the cutting path for the chance that correction lowers the RMS error on the part; see the module."""

    def __init__(self) -> None:
        """Begin without targets."""
        self._expected_gain, self._is_changed = 0.0, False
        """½ Σ w (|d|² − |r|²) [m³], and whether any target is changed."""
        self._parameter_slopes: Array | None = None
        """(P,) derivatives of Σ w (d − r)·e by the errors of the parameters; None before the first target."""
        self._covariance: Array | None = None
        """(P, P) of the parameters."""
        self._sigmas_by_force_case: list[Array] = []
        """For each possible correlation of the forces, the standard deviations (k,) of Σ w (d − r)·e by its causes."""
        self._sigma_by_source: dict[str, float] = {}
        """Standard deviation of Σ w (d − r)·e by each source that is neither a parameter nor a force."""

    def add(
        self,
        errors: SourcesOfError,
        deviation: Array,
        remaining_deviation: Array,
        path_distance: Array,
        cut_length: Array,
    ) -> None:
        """Add the errors of n targets.

        :param deviation: (n, 3) from nominal if nothing is corrected, root axes [m].
        :param remaining_deviation: (n, 3) from nominal with correction [m].
        :param path_distance: (n,) largest distance from the nominal path on the way to each target with correction [m].
        :param cut_length: (n,) length of the cutting path for which each target stands [m]; those with 0 do not count.
        """
        is_cut = cut_length > 0.0
        deviation, remaining_deviation, length = deviation[is_cut], remaining_deviation[is_cut], cut_length[is_cut]
        correction = deviation - remaining_deviation
        self._is_changed |= bool(correction.any())
        remaining_distance = np.maximum(path_distance[is_cut], norm(remaining_deviation))
        self._expected_gain += 0.5 * float(length @ (np.sum(deviation**2, axis=1) - remaining_distance**2))
        weighted_correction = length[:, None] * correction
        slopes = np.einsum("ni,nip->p", weighted_correction, errors.slopes[is_cut])
        sigmas = [
            np.einsum("ni,nik->k", weighted_correction, displacement[is_cut])
            for displacement in errors.force_displacements
        ]
        if self._parameter_slopes is None:
            self._parameter_slopes = np.zeros_like(slopes)
            self._sigmas_by_force_case = [np.zeros_like(case_sigmas) for case_sigmas in sigmas]
        self._covariance = errors.covariance
        self._parameter_slopes = self._parameter_slopes + slopes
        self._sigmas_by_force_case = [
            total + addend for total, addend in zip(self._sigmas_by_force_case, sigmas, strict=True)
        ]
        for name, sigma in _sigma_sums(errors.other_covariances, weighted_correction, is_cut).items():
            self._sigma_by_source[name] = self._sigma_by_source.get(name, 0.0) + sigma

    @property
    def chance(self) -> float | None:
        """Probability, in [0, 1], that correction lowers the RMS error on the part.

        None if correction changes no target, or no target was added. The gain is taken as normally distributed about
        the expected one. Its variance adds those of the robot's parameters, of the worst of the force cases, and of the
        other sources, each fully correlated along the path. Without variance the probability is 0 or 1.
        """
        if not self._is_changed or self._parameter_slopes is None or self._covariance is None:
            return None
        variance = float(self._parameter_slopes @ self._covariance @ self._parameter_slopes)
        variance += max(float(np.sum(sigmas**2)) for sigmas in self._sigmas_by_force_case)
        variance += sum(sigma**2 for sigma in self._sigma_by_source.values())
        if variance <= 0.0:
            return float(self._expected_gain > 0.0)
        # Φ(z) = ½·erfc(−z/√2)
        return 0.5 * math.erfc(-self._expected_gain / math.sqrt(2.0 * variance))


def _sigma_sums(covariances: Mapping[str, Array], correction: Array, is_cut: Bools) -> dict[str, float]:
    """Return the sums over targets of the standard deviations of errors along the corrections, by source [m³].

    :param covariances: (N, 3, 3) of the positions of all targets [m²], by source.
    :param correction: (n, 3) corrections of the n targets of cuts, each times the length of path it stands for [m²].
    :param is_cut: (N,) True for the n targets of cuts.
    """
    variances = {
        name: np.einsum("ni,nij,nj->n", correction, covariance[is_cut], correction)
        for name, covariance in covariances.items()
    }
    # rounding may make a variance of zero negative
    return {name: float(np.sum(np.sqrt(np.maximum(variance, 0.0)))) for name, variance in variances.items()}
