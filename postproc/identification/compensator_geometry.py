"""Geometry of the gravity compensator from tracker readings: L by Eq. (6), a_x and a_y by Eq. (7), with intervals.

Source: Klimchik et al., Eq. (6), (7), with the corrections of print noted at `joint_circle` and `swivel_axis`.

The plane of the mechanism is found from the readings, so the tracker may be anywhere. Its axes: origin P2, x towards
P1 at q2 = 0, y towards P1 at q2 = +90° (KUKA sign, so y points down when x points ahead). In these axes P1 is
L·(cos q2, sin q2), and Eq. (3) holds for P0 = −(a_x, a_y): the spring is longest at q2 = α.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc.compensator import Compensator
from postproc.decimals import without_negative_zero
from postproc.errors import InputError, MeasurementError
from postproc.frames import DEG_PER_RAD, M_PER_MM, MM_PER_M, RAD_PER_DEG, Array
from postproc.program import Ints

P1 = "P1"
_KEYS = ("L_mm", "a_x_mm", "a_y_mm")
_COLUMNS = ("q2", "marker", "repeat", "X", "Y", "Z")
_LARGEST = (("q2", 3600.0, " deg"), ("repeat", 1e9, ""), *((axis, 1e6, " mm") for axis in "XYZ"))
"""Largest size of a cell of each column: beyond it no angle and no measuring device is."""
_OUTLIER_DEVIATIONS = 6.0
"""Deviation of a repeat from the median of its group, in usual deviations, beyond which it is left out (assumed)."""
_MIN_TURN = 10.0 * RAD_PER_DEG
"""Markers that turn with A2 by less do not show where its axis is (assumed)."""
_Groups = dict[tuple[str, float], Ints]
"""(Marker, q2 [deg]) → rows of its repeats in the file."""
_IMPOSSIBLE_RESIDUAL = 2e-3
"""Residual [m] that no tracker makes: a point has the wrong name, or an angle is wrong."""
_LEAST_SPAN = 1e-2
"""Span of all readings [m] that P1 on link 2 and the markers on the compensator exceed: these are decimetres apart.
Readings in metres, taken as mm, span a few thousandths."""
_LENGTHS = (10.0, 2000.0)
"""Length on link 2 [mm]: of real compensators 100 to 600, so that metres are outside."""
_MOST_OFFSET = 5000.0
"""Largest coordinate of P0 [mm]: it is on link 1, near joint 2."""
_WIDE_SHARE = 0.05
"""Warn if the half width of a_x or a_y exceeds this share of the distance P0 … P2 (assumed)."""
_FAR_PIVOT_DISTANCE = 0.1
"""Distance [m] of P0 from its place in the robot model that is asked about (assumed): another size of arm, or an angle
with the wrong sign or zero."""
_COMMON_ERROR_CHANCE = 1e-3
"""Chance of residuals as large as these by the scatter of the repeats alone, below which repeats share an error."""
_WORTHWHILE_RATIO = 0.8
"""Half width with evenly spread markers over the present one below which spreading them is advised."""


def pivot_doubt(measured: Compensator | None, stated: Compensator | None) -> str:
    """Return a clause if P0 is far from its place in the robot model, with what to check; else an empty text.

    :param measured: compensator with the geometry identified from the markers; None: not measured.
    :param stated: compensator of the robot model; None: the model has none.
    """
    if measured is None or stated is None:
        return ""
    distance, mirrored_distance = (
        float(np.hypot(measured.ax - stated.ax, y - stated.ay)) for y in (measured.ay, -measured.ay)
    )
    if distance <= _FAR_PIVOT_DISTANCE:
        return ""
    measured_text, stated_text = (
        f"({law.ax * MM_PER_M:.0f}, {law.ay * MM_PER_M:.0f}) mm" for law in (measured, stated)
    )
    check = "the zero of q2 and the names of the markers"
    # half the distance (assumed): measured places are inexact, so that no mirror fits exactly
    if mirrored_distance < 0.5 * distance:  # q2 with the other sign mirrors a_y
        check = "the sign of q2 (KUKA: A2 is negative where link 2 points up)"
    return (
        f"the compensator's P0 comes out at {measured_text}, and the robot model has it at {stated_text}: check {check}"
    )


class MarkerReadings(Struct, frozen=True, eq=False):
    """Positions of the markers, means over the repeats.

    :param q2: (m,) angles of joint 2, KUKA sign [rad].
    :param markers: names of the k markers on the compensator.
    :param p1: (m, 3) marker P1 on link 2, in the tracker frame [m].
    :param p0: (k, m, 3) markers on the compensator, which turns about P0, in the tracker frame [m].
    :param count_p1: (m,) number of repeats of each mean of P1.
    :param count_p0: (k, m) number of repeats of each mean of the other markers.
    :param scatter: sum of squares of the repeats about their means [m²], and `scatter_dof` its degrees of freedom.
    :param warnings: readings left out, and why.
    """

    q2: Array
    markers: tuple[str, ...]
    p1: Array
    p0: Array
    count_p1: Array
    count_p0: Array
    scatter: float
    scatter_dof: int
    warnings: tuple[str, ...] = ()


class MarkerPlacement(Struct, frozen=True, eq=False):
    """Placement of the markers around the swivel axis P0, and its effect. Body-fixed polar coordinates about P0.

    The condition of the paper, Σ R cos β = Σ R sin β = 0, concerns the bias of Eq. (7), which grows with the square of
    the noise; the intervals depend on how evenly the directions of the markers are spread.

    :param names: of the k markers.
    :param radius: (k,) R [m].
    :param angle: (k,) β from the line P0 → P1, positive as q2 [rad].
    :param bias: (3,) of L, a_x, a_y due to this placement [m]; contained in their intervals.
    :param ci95_even: (3,) half widths with as many markers spread evenly around P0, all else equal [m].
    """

    names: tuple[str, ...]
    radius: Array
    angle: Array
    bias: Array
    ci95_even: Array

    @property
    def sums(self) -> Array:
        """Σ R cos β and Σ R sin β (2,) [m]: zero where the paper's condition holds."""
        return np.array([np.sum(self.radius * np.cos(self.angle)), np.sum(self.radius * np.sin(self.angle))])

    @property
    def imbalance(self) -> float:
        """Length of `sums` over Σ R: 0 if the condition holds, 1 with all markers in one direction."""
        return float(np.linalg.norm(self.sums) / self.radius.sum())


class CompensatorGeometry(Struct, frozen=True, eq=False):
    """L, a_x, a_y of Eq. (3) with their uncertainty.

    :param lengths: (3,) L, a_x, a_y [m].
    :param covariance: (3, 3) of the noise and of the bias of Eq. (7) [m²].
    :param ci95: (3,) half widths of the 95 % intervals [m].
    :param sigma: noise of one coordinate of one reading [m], and `dof` its degrees of freedom.
    :param turn: angle by which the compensator turned [rad].
    :param markers: their placement around P0.
    :param warnings: for the user.
    """

    lengths: Array
    covariance: Array
    ci95: Array
    sigma: float
    dof: int
    turn: float
    markers: MarkerPlacement
    warnings: tuple[str, ...]


class JointCircle(NamedTuple):
    """Circle of P1 about joint axis 2, in the tracker frame.

    :param length: (...) L, its radius [m].
    :param axes: (..., 3, 3) axes of the mechanism as columns, right-handed: x towards P1 at q2 = 0, y towards P1 at
        +90°.
    :param centre: (..., 3) P2 [m].
    """

    length: Array
    axes: Array
    centre: Array


def joint_circle(q2: Array, p1: Array) -> JointCircle:
    """Return the circle of P1 about joint axis 2.

    By Eq. (6) of Klimchik et al., with a transpose that is missing in print: the SVD is of Σ û p̂ᵀ.

    :param q2: (m,) angles of joint 2 [rad].
    :param p1: (..., m, 3) positions of P1 in the tracker frame [m].
    """
    u = _unit_vectors(q2)  # directions P2 → P1 in the axes of the mechanism
    mean = p1.mean(axis=-2)
    u_hat, p_hat = u - u.mean(axis=0), p1 - mean[..., None, :]
    left, _, right = np.linalg.svd(u_hat.T @ p_hat)
    left, right = left.swapaxes(-1, -2), right.swapaxes(-1, -2)
    signs = np.ones(left.shape[:-1])
    signs[..., 2] = np.linalg.det(right @ left)  # −1 if the product would be a reflection
    axes = (right * signs[..., None, :]) @ left
    length = np.sum(p_hat * (u_hat @ axes.swapaxes(-1, -2)), axis=(-2, -1)) / np.sum(u_hat**2)
    return JointCircle(length, axes, mean - length[..., None] * (axes @ u.mean(axis=0)))


def swivel_axis(p0: Array) -> tuple[Array, Array]:
    """Return the point P0 (..., 3) [m] about which the markers turn, and the unit normal (..., 3) of their planes.

    By Eq. (7) of Klimchik et al., with three corrections of print: ŝ subtracts the mean of pᵀp; the last term takes p
    itself, not p̂; and the inverse is the pseudo-inverse of rank 2, because the points lie in planes.

    :param p0: (..., k, m, 3) positions of k markers at m angles in the tracker frame [m].
    :raises MeasurementError: the markers moved along a straight line.
    """
    origin = p0.mean(axis=(-3, -2))  # Eq. (7) does not depend on the origin; near the points it loses no digits
    p = p0 - origin[..., None, None, :]
    p_hat = p - p.mean(axis=-2, keepdims=True)
    square = np.sum(p**2, axis=-1)
    s_hat = square - square.mean(axis=-1, keepdims=True)
    eigenvalues, vectors = np.linalg.eigh(np.einsum("...kmi,...kmj->...ij", p_hat, p_hat))
    normal, plane = vectors[..., 0], vectors[..., 1:]
    if np.any(eigenvalues[..., 1] <= 1e-16 * eigenvalues[..., 2]):  # of squares: 1e-8 of a length is rounding
        raise MeasurementError(
            "the markers on the compensator moved along a straight line: their centre of rotation cannot be found",
            advice="Measure a wider range of q2, and markers on opposite sides of P0.",
        )
    moment = np.einsum("...km,...kmi->...i", s_hat, p_hat)
    in_plane = np.einsum("...ia,...ja,...j->...ia", plane, plane, moment) / eigenvalues[..., None, 1:]
    height = np.einsum("...i,...i->...", normal, p.mean(axis=(-3, -2)))
    centre = 0.5 * in_plane.sum(axis=-1) + normal * height[..., None] + origin
    return centre, normal


def geometry(q2: Array, p1: Array, p0: Array) -> Array:
    """Return (..., 3) L, a_x, a_y [m] of Eq. (3) of Klimchik et al. from mean positions of the markers.

    P1 turns about P2, on the axis of joint 2, at the distance L. The other markers turn about P0, which is at
    (−a_x, −a_y) from P2, in axes with x towards P1 at q2 = 0 and y towards P1 at q2 = +90°.

    :param q2: (m,) angles of joint 2, KUKA sign [rad].
    :param p1: (..., m, 3) positions of P1 in the tracker frame [m].
    :param p0: (..., k, m, 3) positions of the k markers on the compensator [m].

    >>> angle = np.radians([0.0, -50.0, -100.0, -140.0])
    >>> circle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    >>> turn = np.radians([0.0, 5.0, 8.0, -3.0])
    >>> arc = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    >>> geometry(angle, 0.18 * circle, np.stack([0.1 * arc, -0.2 * arc]) - [0.68, 0.12, 0.0]).round(9).tolist()
    [0.18, 0.68, 0.12]
    """
    length, axes, centre_p2 = joint_circle(q2, p1)
    centre_p0, _ = swivel_axis(p0)
    offset = np.einsum("...ji,...j->...i", axes, centre_p0 - centre_p2)
    return np.stack([length, -offset[..., 0], -offset[..., 1]], axis=-1)


def mechanism(lengths: Array, q2: Array, radius: Array, angle: Array) -> tuple[Array, Array]:
    """Return the positions of P1 (m, 3) and of markers on the compensator (k, m, 3) [m], axes of the mechanism.

    :param lengths: (3,) L, a_x, a_y [m].
    :param q2: (m,) angles of joint 2 [rad].
    :param radius: (k,) distances of the markers from P0 [m].
    :param angle: (k,) of the markers from the line P0 → P1, positive as q2 [rad].
    """
    p1, pivot = lengths[0] * _unit_vectors(q2), np.array([-lengths[1], -lengths[2], 0.0])
    return p1, pivot + radius[:, None, None] * _unit_vectors(spring_direction(lengths, q2) + angle[:, None])


def spring_direction(lengths: Array, q2: Array) -> Array:
    """Return the angle (m,) [rad] of the line P0 → P1 from the x axis of the mechanism, at angles q2 (m,) [rad].

    :param lengths: (3,) L, a_x, a_y [m].
    """
    length, ax, ay = lengths
    return np.asarray(np.unwrap(np.arctan2(length * np.sin(q2) + ay, length * np.cos(q2) + ax)))


def noise_covariance(q2: Array, p1: Array, p0: Array, variance_p1: Array, variance_p0: Array) -> Array:
    """Return the covariance (3, 3) of L, a_x, a_y by Eq. (6), (7) due to noise, to first order [m²].

    Derivatives are central differences by every coordinate.

    :param q2: (m,) angles of joint 2 [rad].
    :param p1: (m, 3) measured positions of marker P1 on link 2 [m]; variance_p1: (m,) of each coordinate [m²].
    :param p0: (k, m, 3) measured positions of the k markers on the compensator [m]; variance_p0: (k, m) likewise.
    """
    m, k, step = len(q2), len(p0), 1e-5  # a step [m] far above rounding, far below the lengths of the mechanism
    coordinates = np.concatenate([p1.ravel(), p0.ravel()])
    variance = np.repeat(np.concatenate([variance_p1.ravel(), variance_p0.ravel()]), 3)
    n = len(coordinates)
    # one coordinate is changed in each row: up in the first n, down in the others
    variations = coordinates + step * np.concatenate([np.eye(n), -np.eye(n)])
    varied_p1, varied_p0 = np.split(variations, [p1.size], axis=1)
    results = geometry(q2, varied_p1.reshape(-1, m, 3), varied_p0.reshape(-1, k, m, 3))
    sensitivity = (results[:n] - results[n:]) / (2.0 * step)
    return np.asarray((sensitivity.T * variance) @ sensitivity)


def pivot_bias(p0: Array, variance: Array) -> Array:
    """Return the bias (3,) [m] of P0 by Eq. (7) of Klimchik et al.: its mean error, to second order in the noise.

    The square of the noise of a point enters ŝ p̂ᵀ along its radius r. With M = Σ p̂ p̂ᵀ the bias is

        M⁻¹ Σ σ² ((1 − 1/m − p̂ᵀM⁻¹p̂) r − p̂ (p̂ᵀM⁻¹r))

    Its largest part is σ²(m − 1) M⁻¹ Σ_j R_j (cos β_j, sin β_j): hence the paper's condition on the markers.

    :param p0: (k, m, 3) positions of k markers at m angles in the tracker frame [m].
    :param variance: (k, m) of one coordinate [m²].
    """
    centre, normal = swivel_axis(p0)
    _, _, axes = np.linalg.svd(normal[None])  # rows: the normal, and two axes in the plane
    r = (p0 - centre) @ axes[1:].T
    p_hat = r - r.mean(axis=1, keepdims=True)
    inverse = np.linalg.inv(np.einsum("kmi,kmj->ij", p_hat, p_hat))
    gain = p_hat @ inverse
    moment = (1.0 - 1.0 / p0.shape[1] - np.sum(gain * p_hat, axis=2))[..., None] * r
    moment -= p_hat * np.sum(gain * r, axis=2)[..., None]
    return np.asarray(inverse @ np.einsum("km,kmi->i", variance, moment) @ axes[1:])


def even_angles(count: int) -> Array:
    """Return the angles β (count,) [rad] of markers around P0 that determine P0 best.

    Three markers or more are spread evenly. Then Σ cos β = Σ sin β = 0, so that the bias is zero, and
    Σ cos 2β = Σ sin 2β = 0, so that all directions are determined equally well. Two markers cannot satisfy both. They
    are a quarter turn apart: opposite markers would not determine P0 along their line.
    """
    return np.asarray(np.arange(count) * (np.pi / 2.0 if count < 3 else 2.0 * np.pi / count), dtype=np.float64)


def expected_covariance(lengths: Array, q2: Array, radius: Array, angle: Array, variance: float) -> Array:
    """Return the covariance (3, 3) of L, a_x, a_y [m²] that planned readings will give, with the square of the bias.

    :param lengths: (3,) L, a_x, a_y [m].
    :param q2: (m,) angles of joint 2 at which to measure [rad].
    :param radius: (k,) distances of the markers from P0 [m].
    :param angle: (k,) of the markers from the line P0 → P1 [rad].
    :param variance: of one coordinate of the mean of the repeats [m²].
    """
    p1, p0 = mechanism(lengths, q2, radius, angle)
    variances = np.full(p0.shape[:2], variance)
    bias = np.concatenate([[0.0], -pivot_bias(p0, variances)[:2]])  # of L, a_x, a_y: P0 is at (−a_x, −a_y)
    return np.asarray(noise_covariance(q2, p1, p0, variances[0], variances) + np.outer(bias, bias))


def degrees_of_freedom(angles: int, markers: int) -> int:
    """Return the degrees of freedom of the residuals of the two circle fits: coordinates minus unknowns.

    The circle of P1 has 3 coordinates at each angle and 7 unknowns. Each other marker has 2 coordinates at each angle
    and 2 unknowns, radius and height; all together have 4 more, centre (2) and tilt (2).

    :param angles: number of angles q2; `markers` number of markers on the compensator.
    """
    return (3 * angles - 7) + (2 * markers * angles - 2 * markers - 4)


def student_95(dof: int) -> float:
    """Return the 97.5 % quantile of Student's t: half a 95 % interval, in standard deviations estimated with `dof`."""
    from scipy.special import stdtrit  # takes long to import

    return float(stdtrit(dof, 0.975))


def identify(readings: MarkerReadings) -> CompensatorGeometry:
    """Identify the lengths L, a_x, a_y of the compensator in Eq. (3) with 95 % intervals.

    P1 turns about P2 (joint 2) at the distance L; P0 is at (−a_x, −a_y) from P2. The noise comes from the scatter of
    the repeats and from the residuals of the two circle fits, see `_noise`. The intervals come from the sensitivity of
    the estimate to every coordinate, its bias and Student's t.

    :raises MeasurementError: the readings do not belong to one such mechanism.
    """
    q2, p1, p0 = readings.q2, readings.p1, readings.p0
    lengths = geometry(q2, p1, p0)
    residual_p1, residual_p0 = _circle_residuals(readings)
    _refuse_wrong_markers(readings, residual_p1, residual_p0)
    _refuse_size(lengths * MM_PER_M)
    noise = _noise(readings, residual_p1, residual_p0)
    sigma, dof = noise.sigma, noise.dof
    variance_p1, variance_p0 = sigma**2 / readings.count_p1, sigma**2 / readings.count_p0
    axes = joint_circle(q2, p1).axes
    # L has no bias; that of a_x, a_y is the bias of P0 in the axes of the mechanism, with the other sign
    bias = np.concatenate([[0.0], -(axes.T @ pivot_bias(p0, variance_p0))[:2]])
    covariance = noise_covariance(q2, p1, p0, variance_p1, variance_p0) + np.outer(bias, bias)
    ci95 = student_95(dof) * np.sqrt(np.diag(covariance))
    radius, angle = _polar_coordinates(lengths, readings, axes)
    even_intervals = _even_intervals(lengths, readings, radius=radius, angle=angle, sigma=sigma, dof=dof)
    markers = MarkerPlacement(readings.markers, radius, angle, bias, even_intervals)
    turn = float(np.ptp(spring_direction(lengths, q2)))
    warnings = [*readings.warnings, *noise.warnings]
    if np.any(ci95 > _WIDE_SHARE * np.hypot(lengths[1], lengths[2])):
        warnings.append(
            f"a_x ± {ci95[1] * MM_PER_M:.1f} mm, a_y ± {ci95[2] * MM_PER_M:.1f} mm: the compensator turned by only "
            f"{turn * DEG_PER_RAD:.1f}°. {_remedy(markers, ci95)}"
        )
    return CompensatorGeometry(
        lengths=lengths,
        covariance=covariance,
        ci95=ci95,
        sigma=sigma,
        dof=dof,
        turn=turn,
        markers=markers,
        warnings=tuple(warnings),
    )


def _even_intervals(
    lengths: Array, readings: MarkerReadings, *, radius: Array, angle: Array, sigma: float, dof: int
) -> Array:
    """Return the half widths (3,) [m] of the 95 % intervals that k markers spread evenly around P0 would give.

    They are at the mean radius of the k markers, the first at its angle.

    :param lengths: (3,) L, a_x, a_y [m].
    :param radius: (k,) distances of the markers from P0 [m], and `angle` (k,) from the line P0 → P1 [rad].
    :param sigma: noise of one coordinate of one reading [m], and `dof` its degrees of freedom.
    """
    count = len(radius)
    covariance = expected_covariance(
        lengths,
        readings.q2,
        radius=np.full(count, radius.mean()),
        angle=even_angles(count) + float(angle[0]),
        variance=sigma**2 / float(readings.count_p0.mean()),
    )
    return np.asarray(student_95(dof) * np.sqrt(np.diag(covariance)))


class _Noise(NamedTuple):
    """Noise of the readings.

    :param sigma: standard deviation of one coordinate of one reading [m], and `dof` its degrees of freedom.
    :param warnings: for the user.
    """

    sigma: float
    dof: int
    warnings: list[str]


def _noise(readings: MarkerReadings, residual_p1: Array, residual_p0: Array) -> _Noise:
    """Return the noise, from the scatter of the repeats and the residuals of the circles together.

    Repeats at one angle share motions of the tracker, a marker or the arm between the angles. If an F test says that
    the residuals are larger than the scatter explains, the noise is that of the residuals alone, with a warning. There
    is no test if the scatter is zero: there are no repeats, or they agree in all digits.

    :param residual_p1: (m, 3) of the circle of P1 [m].
    :param residual_p0: (k, m, 2) of the circles of the other markers [m].
    """
    from scipy.special import fdtrc  # takes long to import

    fit_dof = degrees_of_freedom(len(readings.q2), len(readings.p0))
    fit_squares = float(
        np.sum(readings.count_p1[:, None] * residual_p1**2) + np.sum(readings.count_p0[..., None] * residual_p0**2)
    )
    if readings.scatter > 0.0:
        variance, fit_variance = readings.scatter / readings.scatter_dof, fit_squares / fit_dof
        if fdtrc(fit_dof, readings.scatter_dof, fit_variance / variance) < _COMMON_ERROR_CHANCE:
            mean_error = np.sqrt(fit_variance / readings.count_p0.mean()) * MM_PER_M
            return _Noise(
                sigma=float(np.sqrt(fit_variance)),
                dof=fit_dof,
                warnings=[
                    f"the means of the repeats are {mean_error:.3f} mm off their circles (RMS of a coordinate), more "
                    f"than the repeats explain, which scatter by {np.sqrt(variance) * MM_PER_M:.3f} mm: the intervals "
                    "are as wide as that asks for. Check that the tracker was not moved between the angles, that the "
                    "markers are tight, and each q2."
                ],
            )
    dof = readings.scatter_dof + fit_dof
    return _Noise(sigma=float(np.sqrt((readings.scatter + fit_squares) / dof)), dof=dof, warnings=[])


def _remedy(markers: MarkerPlacement, ci95: Array) -> str:
    """Return advice for a more accurate measurement of the compensator.

    :param ci95: (3,) half widths of the 95 % intervals of L, a_x, a_y [m].
    """
    even_ci = markers.ci95_even[1:]
    if np.linalg.norm(even_ci) > _WORTHWHILE_RATIO * np.linalg.norm(ci95[1:]):
        return "Measure more markers, more repeats, and the angles q2 that `postproc plan compensator` proposes."
    return (
        f"Spread the markers evenly around P0: a_x ± {even_ci[0] * MM_PER_M:.1f} mm, "
        f"a_y ± {even_ci[1] * MM_PER_M:.1f} mm with as many readings."
    )


def _polar_coordinates(lengths: Array, readings: MarkerReadings, axes: Array) -> tuple[Array, Array]:
    """Return radius (k,) [m] and angle β (k,) [rad] of the markers about P0, from the line P0 → P1.

    :param lengths: (3,) L, a_x, a_y [m].
    :param axes: (3, 3) of the mechanism as columns in the tracker frame.
    """
    centre, _ = swivel_axis(readings.p0)
    offset = (readings.p0 - centre) @ axes[:, :2]  # (k, m, 2) in the plane of the mechanism
    # as complex numbers: turned back by the angle of the spring, a marker is at one place at all angles of joint 2
    body_offset = offset @ np.array([1.0, 1.0j]) * np.exp(-1.0j * spring_direction(lengths, readings.q2))
    mean_offset = body_offset.mean(axis=1)
    return np.abs(mean_offset), np.angle(mean_offset)


def _unit_vectors(angle: Array) -> Array:
    """Return the unit vectors (…, 3) in the xy plane at angles (…) from x [rad]."""
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)


def _circle_residuals(readings: MarkerReadings) -> tuple[Array, Array]:
    """Return the residuals of the circles [m]: of P1 (m, 3), and of other markers (k, m, 2), radial and axial."""
    length, axes, centre_p2 = joint_circle(readings.q2, readings.p1)
    residual_p1 = readings.p1 - centre_p2 - length * _unit_vectors(readings.q2) @ axes.T
    centre_p0, normal = swivel_axis(readings.p0)
    height = (readings.p0 - centre_p0) @ normal
    radius = np.linalg.norm((readings.p0 - centre_p0) - height[..., None] * normal, axis=2)
    return residual_p1, np.stack(
        [radius - radius.mean(axis=1, keepdims=True), height - height.mean(axis=1, keepdims=True)], axis=2
    )


def _refuse_wrong_markers(readings: MarkerReadings, residual_p1: Array, residual_p0: Array) -> None:
    """Refuse readings in which a marker has a wrong name or place.

    :param residual_p1: (m, 3) of the circle of P1 [m].
    :param residual_p0: (k, m, 2) of the circles of the other markers [m].
    :raises MeasurementError: markers on the compensator change their distances, or a marker is off its circle.
    """
    _refuse_changed_distances(readings)
    deviations = [np.linalg.norm(residual_p1, axis=1), *np.linalg.norm(residual_p0, axis=2)]
    worst = int(np.argmax([deviation.max() for deviation in deviations]))
    if deviations[worst].max() > _IMPOSSIBLE_RESIDUAL:
        name = (P1, *readings.markers)[worst]
        angle = readings.q2[np.argmax(deviations[worst])] * DEG_PER_RAD
        raise MeasurementError(
            f"marker {name} is up to {deviations[worst].max() * MM_PER_M:.1f} mm off its circle (at q2 = {angle:g}°)",
            advice="Check for swapped marker names, a wrong q2, a tracker that was moved, or lengths that are not mm.",
        )


def _refuse_changed_distances(readings: MarkerReadings) -> None:
    """Refuse readings in which the distances of the markers on the compensator, a rigid body, change with the angle.

    Two markers are not checked: it would not be known which of them is wrong.

    :raises MeasurementError: the distances change; the message names two markers if their names are swapped.
    """
    k = len(readings.markers)
    if k < 3:
        return
    distances = np.linalg.norm(readings.p0[:, None] - readings.p0[None], axis=3)
    median_distances = np.median(distances, axis=2)
    change = np.abs(distances - median_distances[..., None]).max(axis=(0, 1))
    worst = int(np.argmax(change))
    if change[worst] <= _IMPOSSIBLE_RESIDUAL:
        return
    wrong_distances = distances[:, :, worst]
    orders = [_swapped_order(k, i, j) for i in range(k) for j in range(i)]
    order_errors = [float(np.abs(wrong_distances[np.ix_(order, order)] - median_distances).max()) for order in orders]
    best = int(np.argmin(order_errors))
    names = [readings.markers[i] for i in range(k) if orders[best][i] != i]
    advice = "Measure this angle again."
    if order_errors[best] < _IMPOSSIBLE_RESIDUAL:
        advice = f"The names of {' and '.join(names)} are swapped there: correct the file."
    raise MeasurementError(
        f"at q2 = {readings.q2[worst] * DEG_PER_RAD:g}° the markers do not keep their distances "
        f"({change[worst] * MM_PER_M:.1f} mm)",
        advice=advice,
    )


def _refuse_size(lengths: Array) -> None:
    """Refuse L, a_x, a_y (3,) [mm] that no compensator has.

    :raises MeasurementError: a length is out of range, or P0 is inside the circle of P1.
    """
    if not _LENGTHS[0] <= lengths[0] <= _LENGTHS[1] or np.abs(lengths[1:]).max() > _MOST_OFFSET:
        raise MeasurementError(
            f"L comes out {lengths[0]:.3g} mm, a_x {lengths[1]:.3g} mm, a_y {lengths[2]:.3g} mm: "
            "no robot has such a compensator",
            advice="Give X, Y, Z in mm and q2 in degrees, and check the names of the markers.",
        )
    pivot_distance = np.hypot(lengths[1], lengths[2])
    if pivot_distance <= lengths[0]:
        raise MeasurementError(
            f"P0 comes out {pivot_distance:.1f} mm from P2, inside the circle of P1 ({lengths[0]:.1f} mm)",
            advice="Check the sign of q2 (KUKA: negative upwards), and that the markers P01… sit on the compensator.",
        )


def _swapped_order(count: int, i: int, j: int) -> list[int]:
    """Return 0 … count − 1 with i and j exchanged."""
    order = list(range(count))
    order[i], order[j] = j, i
    return order


def read(path: Path) -> MarkerReadings:
    """Read `compensator.csv`: q2 [deg], marker, repeat, X, Y, Z [mm].

    :raises MeasurementError: a marker is missing at an angle, too few angles or markers, angles in radians.
    """
    numbers, texts, lines = files.read_csv(path, _COLUMNS, (), MeasurementError, ("marker",))
    files.check_sizes(path, numbers, lines, _LARGEST, MeasurementError)
    file_name = str(path)
    angles = np.unique(numbers["q2"])[::-1]
    on_compensator = _markers_on_compensator(texts["marker"], lines, file_name)
    _check_angles(angles, file_name)
    position = np.column_stack([numbers[axis] for axis in "XYZ"]) * M_PER_MM
    span = float(np.ptp(position, axis=0).max())
    if span < _LEAST_SPAN:
        raise MeasurementError(
            f"all readings lie within {span * MM_PER_M:.3g} mm: these look like metres",
            file=file_name,
            advice="Give X, Y, Z in mm.",
        )
    marker = np.array(texts["marker"])
    groups = {
        (name, angle): np.flatnonzero((marker == name) & (numbers["q2"] == angle))
        for name in (P1, *on_compensator)
        for angle in angles
    }
    _check_repeats(groups, numbers["repeat"], lines, file_name)
    groups, warnings = _remove_outliers(groups, position, lines)
    return replace(_mean_readings(groups, position, angles, on_compensator), warnings=warnings)


def _mean_readings(groups: _Groups, position: Array, angles: Array, markers: tuple[str, ...]) -> MarkerReadings:
    """Return the means and the scatter of the repeats.

    :param groups: rows of the repeats of each marker and angle.
    :param position: (n, 3) of all readings [m].
    :param angles: (m,) of joint 2 [deg].
    :param markers: names of the markers on the compensator.
    """
    mean = {key: position[rows].mean(axis=0) for key, rows in groups.items()}
    return MarkerReadings(
        q2=angles * RAD_PER_DEG,
        markers=markers,
        p1=np.array([mean[P1, angle] for angle in angles]),
        p0=np.array([[mean[name, angle] for angle in angles] for name in markers]),
        count_p1=np.array([float(len(groups[P1, angle])) for angle in angles]),
        count_p0=np.array([[float(len(groups[name, angle])) for angle in angles] for name in markers]),
        scatter=sum(float(np.sum((position[rows] - mean[key]) ** 2)) for key, rows in groups.items()),
        scatter_dof=sum(3 * (len(rows) - 1) for rows in groups.values()),
    )


def _markers_on_compensator(markers: list[str], lines: Array, file_name: str) -> tuple[str, ...]:
    """Return the names of the markers on the compensator, sorted.

    :param markers: names of the markers of all n readings, and `lines` (n,) of the readings in the file.
    :raises MeasurementError: a name is not valid, or P1 or all other markers are missing.
    """
    names = sorted(set(markers))
    for name in names:
        if name != P1 and not (name.startswith("P0") and name[2:].isdigit()):
            first = int(lines[markers.index(name)])
            raise MeasurementError(
                f"unknown marker {name!r}", file=file_name, line=first, advice="Markers are P1, P01, P02, …."
            )
    on_compensator = tuple(name for name in names if name != P1)
    if P1 not in names or not on_compensator:
        absent = P1 if P1 not in names else "P01"
        raise MeasurementError(
            f"no readings of marker {absent}",
            file=file_name,
            advice="Measure P1 (on link 2, where the spring is attached) and at least one marker P01… on the spring.",
        )
    return on_compensator


def _check_repeats(groups: _Groups, repeat: Array, lines: Array, file_name: str) -> None:
    """Check that each marker has a reading at each angle, and that no repeat is given twice.

    :param groups: rows of the repeats of each marker and angle; empty without a reading.
    :param repeat: (n,) number of the repeat of all readings, and `lines` (n,) of the readings in the file.
    :raises MeasurementError: a reading is missing or given twice.
    """
    for (name, angle), rows in groups.items():
        if len(rows) == 0:
            raise MeasurementError(
                f"no reading of marker {name} at q2 = {angle:g}°",
                file=file_name,
                advice="Measure every marker at every angle, or leave the angle out.",
            )
        if len(np.unique(repeat[rows])) < len(rows):
            raise MeasurementError(
                f"marker {name} at q2 = {angle:g}°: a repeat is given twice", file=file_name, line=int(lines[rows[-1]])
            )


def _check_angles(angles: Array, file_name: str) -> None:
    """Check that the angles q2 are in degrees, and that they are enough for a circle.

    :param angles: (m,) different angles of the file [deg].
    :raises MeasurementError: they look like radians, are fewer than three, or cover less than `_MIN_TURN`.
    """
    if len(angles) >= 3 and np.abs(angles).max() <= 2.0 * np.pi:
        raise MeasurementError(
            f"all q2 lie between {angles.min():g} and {angles.max():g}: these look like radians",
            file=file_name,
            advice="Give q2 in degrees.",
        )
    if len(angles) < 3 or np.ptp(angles) * RAD_PER_DEG < _MIN_TURN:
        raise MeasurementError(
            f"{len(angles)} angles q2 over {np.ptp(angles) if len(angles) else 0:g}°: too few for a circle",
            file=file_name,
            advice="Measure at least 3 angles (6 are better) over as much of the range of A2 as can be reached.",
        )


def _remove_outliers(groups: _Groups, position: Array, lines: Array) -> tuple[_Groups, tuple[str, ...]]:
    """Return the groups without readings that are far from the other repeats, and a warning for each such reading.

    Groups of fewer than three repeats are kept, and groups in which half of the readings or more would be removed.

    :param groups: (marker, q2 [deg]) → rows of its repeats.
    :param position: (n, 3) of all readings [m], and `lines` (n,) of the readings in the file.
    """
    deviation_by_group = {key: position[rows] - np.median(position[rows], axis=0) for key, rows in groups.items()}
    deviations = [deviation.ravel() for deviation in deviation_by_group.values() if len(deviation) >= 3]
    sizes = np.abs(np.concatenate(deviations or [np.zeros(0)]))
    # zeros do not count: of three repeats one is the median itself; the median |deviation| of the others is 0.9 σ
    scale = float(np.median(sizes[sizes > 0.0]) / 0.9) if np.any(sizes > 0.0) else 0.0
    good_groups: _Groups = {}
    warnings: list[str] = []
    for key, rows in groups.items():
        name, angle = key  # marker, q2 [deg]
        distances = np.linalg.norm(deviation_by_group[key], axis=1)
        # 1.5: distances in space are larger than coordinates; 1 µm: the resolution of trackers
        is_within_limit = distances <= max(_OUTLIER_DEVIATIONS * 1.5 * scale, 1e-6)
        if len(rows) >= 3 and 0 < np.count_nonzero(~is_within_limit) < 0.5 * len(rows):
            good_groups[key] = rows[is_within_limit]
            warnings += [
                f"line {int(lines[row])}: marker {name} at q2 = {angle:g}° is {distance * MM_PER_M:.2f} mm from its "
                "other repeats: left out"
                for row, distance in zip(rows[~is_within_limit], distances[~is_within_limit], strict=True)
            ]
        else:
            good_groups[key] = rows
    return good_groups, tuple(warnings)


def as_data(result: CompensatorGeometry, source: str) -> dict[str, object]:
    """Return the content of the result's file [mm, deg].

    :param source: origin of the readings.
    """
    markers = result.markers
    sums = markers.sums * MM_PER_M
    values = zip(_KEYS, result.lengths * MM_PER_M, result.ci95 * MM_PER_M, strict=True)
    return {
        "source": source,
        "sigma_mm": result.sigma * MM_PER_M,
        "turn_deg": result.turn * DEG_PER_RAD,
        "covariance_mm2": (result.covariance * MM_PER_M**2).tolist(),
        "warnings": list(result.warnings),
        **{name: {"value": float(value), "ci95": float(half)} for name, value, half in values},
        "markers": {
            "names": list(markers.names),
            "R_mm": (markers.radius * MM_PER_M).tolist(),
            "beta_deg": (markers.angle * DEG_PER_RAD).tolist(),
            "sum_R_cos_beta_mm": float(sums[0]),
            "sum_R_sin_beta_mm": float(sums[1]),
            "imbalance": markers.imbalance,
            "bias_mm": (markers.bias * MM_PER_M).tolist(),
            "ci95_even_mm": (markers.ci95_even * MM_PER_M).tolist(),
        },
    }


def text_lines(result: CompensatorGeometry) -> list[str]:
    """Return the values with their intervals, and the effect of the marker placement, for a terminal."""
    lines = [
        f"{name.removesuffix('_mm'):>4} = {value * MM_PER_M:8.3f} ± {half * MM_PER_M:.3f} mm"
        for name, value, half in zip(_KEYS, result.lengths, result.ci95, strict=True)
    ]
    markers = result.markers
    count = f"{len(markers.names)} marker{'s' if len(markers.names) > 1 else ''}"
    cosine, sine = without_negative_zero(np.round(markers.sums * MM_PER_M, 1))
    bias, even_ci = without_negative_zero(np.round(markers.bias * MM_PER_M, 4)), markers.ci95_even * MM_PER_M
    return [
        *lines,
        f"markers around P0: Σ R cos β = {cosine:.1f} mm, Σ R sin β = {sine:.1f} mm; the best is 0, all on one side "
        f"would give {markers.radius.sum() * MM_PER_M:.1f} mm",
        f"bias of Eq. (7) due to that: a_x {bias[1]:.4f} mm, a_y {bias[2]:.4f} mm, contained in the intervals",
        f"{count} spread evenly around P0, as many readings: a_x ± {even_ci[1]:.3f} mm, a_y ± {even_ci[2]:.3f} mm",
    ]


_Interval = Annotated[float, msgspec.Meta(ge=0, le=1e4)]


class _Arm(msgspec.Struct, frozen=True):
    value: Annotated[float, msgspec.Meta(ge=_LENGTHS[0], le=_LENGTHS[1])]
    ci95: _Interval = 0.0


class _Offset(msgspec.Struct, frozen=True):
    value: Annotated[float, msgspec.Meta(ge=-_MOST_OFFSET, le=_MOST_OFFSET)]
    ci95: _Interval = 0.0


class _File(msgspec.Struct, frozen=True):
    L_mm: _Arm
    a_x_mm: _Offset
    a_y_mm: _Offset


def load(path: Path) -> Array:
    """Return (3,) L, a_x, a_y [m] of a compensator from a file that `save` wrote.

    :raises MeasurementError: it is not such a file, or no robot has a compensator of this size.
    """
    content = files.read_toml(path, _File, MeasurementError)
    length, ax, ay = content.L_mm.value, content.a_x_mm.value, content.a_y_mm.value
    distance = float(np.hypot(ax, ay))
    if distance <= length:
        raise MeasurementError(
            f"a_x_mm and a_y_mm put P0 {distance:g} mm from joint 2, L_mm is {length:g}: expected more than L_mm",
            file=str(path),
            advice="Give all three in mm.",
        )
    return np.array([length, ax, ay]) * M_PER_MM


def save(path: Path, result: CompensatorGeometry, source: str) -> None:
    """Write the result as TOML; a failure leaves no partial file.

    :param source: origin of the readings.
    :raises InputError: the file cannot be written.
    """
    if path.is_dir():
        raise InputError("is a folder", file=str(path), advice="Give the name of the file to write.")
    comment = "Gravity compensator, identified by `postproc identify compensator` (paper, Eq. (6), (7))."
    files.write_whole(path.parent, {path.name: files.seal(files.toml(as_data(result, source), comment))})
