"""Geometry of the gravity compensator from tracker readings: L by Eq. (6), a_x and a_y by Eq. (7), with intervals.

Source: Klimchik et al., Eq. (6), (7), with the corrections of print noted at `joint_axis_radius` and `swivel_axis`.

The plane of the mechanism is found from the readings, so the tracker may stand anywhere. Its axes: origin P2, x towards
P1 at q2 = 0, y towards P1 at q2 = +90° (KUKA sign, so y points down when x points ahead). In these axes P1 is
L·(cos q2, sin q2), and Eq. (3) holds for P0 = −(a_x, a_y): the spring is longest at q2 = α.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from postproc import files
from postproc.errors import InputError, MeasurementError
from postproc.frames import DEG_PER_RAD, M_PER_MM, MM_PER_M, RAD_PER_DEG, Array
from postproc.program import Ints

P1 = "P1"
_COLUMNS = ("q2", "marker", "repeat", "X", "Y", "Z")
_OUTLIER = 6.0
_SMALL_TURN = 10.0 * RAD_PER_DEG
_Groups = dict[tuple[str, float], Ints]
_IMPOSSIBLE = 2e-3
"""Residual [m] that no tracker makes: a point has the wrong name, or an angle is wrong."""


class MarkerReadings(Struct, frozen=True, eq=False):
    """Positions of the markers, means over the repeats.

    :param q2: (m,) angles of joint 2, KUKA sign [rad].
    :param markers: names of the k markers on the compensator.
    :param p1: (m, 3) marker P1 in the tracker frame [m].
    :param p0: (k, m, 3) markers on the compensator [m].
    :param count_p1: (m,) repeats behind each mean.
    :param count_p0: (k, m).
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


class CompensatorGeometry(Struct, frozen=True, eq=False):
    """L, a_x, a_y of Eq. (3) with their uncertainty.

    :param value: (3,) L, a_x, a_y [m].
    :param covariance: (3, 3) [m²].
    :param ci95: (3,) half widths of the 95 % intervals [m].
    :param sigma: noise of one coordinate of one reading, from the residuals [m].
    :param dof: degrees of freedom behind `sigma`.
    :param turn: angle by which the compensator turned over the readings [rad].
    :param warnings: what the user should know.
    """

    value: Array
    covariance: Array
    ci95: Array
    sigma: float
    dof: int
    turn: float
    warnings: tuple[str, ...]


def joint_axis_radius(q2: Array, p1: Array) -> tuple[float, Array, Array]:
    """Return L by Eq. (6), the axes R of the mechanism in the tracker frame (3, 3), and P2 (3,) [m].

    As printed, with the transpose that is missing there: the SVD is of Σ û p̂ᵀ. R is made right-handed.

    :param q2: (m,) [rad].
    :param p1: (m, 3) [m].
    """
    u = np.column_stack([np.cos(q2), np.sin(q2), np.zeros_like(q2)])
    u_hat, p_hat = u - u.mean(axis=0), p1 - p1.mean(axis=0)
    left, _, right = np.linalg.svd(u_hat.T @ p_hat)
    handed = np.diag([1.0, 1.0, np.linalg.det(right.T @ left.T)])
    axes = right.T @ handed @ left.T
    length = float(np.sum(p_hat * (u_hat @ axes.T)) / np.sum(u_hat**2))
    return length, axes, p1.mean(axis=0) - length * axes @ u.mean(axis=0)


def swivel_axis(p0: Array) -> tuple[Array, Array]:
    """Return the point P0 (3,) [m] about which the markers turn, by Eq. (7), and the normal n (3,) of their plane.

    Three corrections of print: ŝ subtracts the mean of pᵀp; the last term takes p itself, not p̂; and the inverse is
    the pseudo-inverse of rank 2, because the points lie in planes.

    :param p0: (k, m, 3) k markers at m angles [m].
    """
    origin = p0.mean(axis=(0, 1))  # Eq. (7) does not depend on the origin; near the points it loses no digits
    p = p0 - origin
    p_hat = p - p.mean(axis=1, keepdims=True)
    squared = np.sum(p**2, axis=2)
    s_hat = squared - squared.mean(axis=1, keepdims=True)
    eigenvalues, vectors = np.linalg.eigh(np.einsum("kmi,kmj->ij", p_hat, p_hat))
    normal, plane = vectors[:, 0], vectors[:, 1:]
    if eigenvalues[1] <= 1e-16 * eigenvalues[2]:
        raise MeasurementError(
            "the markers on the compensator moved along a straight line: their centre of rotation cannot be found",
            advice="Measure a wider range of q2, and markers on opposite sides of P0.",
        )
    inverse = plane @ np.diag(1.0 / eigenvalues[1:]) @ plane.T
    centre = 0.5 * inverse @ np.einsum("km,kmi->i", s_hat, p_hat) + normal * (normal @ p.mean(axis=(0, 1)))
    return centre + origin, normal


def geometry(q2: Array, p1: Array, p0: Array) -> Array:
    """Return (3,) L, a_x, a_y [m] of Eq. (3) from mean positions; see the module for the axes.

    >>> angle = np.radians([0.0, -50.0, -100.0, -140.0])
    >>> circle = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    >>> turn = np.radians([0.0, 5.0, 8.0, -3.0])
    >>> arc = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    >>> geometry(angle, 0.18 * circle, np.stack([0.1 * arc, -0.2 * arc]) - [0.68, 0.12, 0.0]).round(9).tolist()
    [0.18, 0.68, 0.12]
    """
    length, axes, centre_p2 = joint_axis_radius(q2, p1)
    centre_p0, _ = swivel_axis(p0)
    x, y, _ = axes.T @ (centre_p0 - centre_p2)
    return np.array([length, -x, -y])


def identify(readings: MarkerReadings) -> CompensatorGeometry:
    """Identify L, a_x, a_y with 95 % intervals.

    The noise comes from the scatter of the repeats and from what the two fits leave; the intervals from the sensitivity
    of the estimate to every coordinate (central differences) and Student's t.

    :raises MeasurementError: the readings do not belong to one such mechanism.
    """
    q2, p1, p0 = readings.q2, readings.p1, readings.p0
    value = geometry(q2, p1, p0)
    left_p1, left_p0 = _residuals(readings)
    _refuse_impossible(readings, left_p1, left_p0)
    m, k = len(q2), len(p0)
    # unknowns: 7 of the circle of P1; per marker radius and height, and together centre (2) and tilt (2)
    dof = readings.scatter_dof + (3 * m - 7) + (2 * k * m - 2 * k - 4)
    squares = readings.scatter + float(
        np.sum(readings.count_p1[:, None] * left_p1**2) + np.sum(readings.count_p0[..., None] * left_p0**2)
    )
    sigma = float(np.sqrt(squares / dof))
    data = np.concatenate([p1.ravel(), p0.ravel()])
    variance = sigma**2 / np.repeat(np.concatenate([readings.count_p1, readings.count_p0.ravel()]), 3)
    step = 1e-5
    sensitivity = np.empty((3, len(data)))
    for column in range(len(data)):
        moved = np.repeat(data[None], 2, axis=0)
        moved[0, column] += step
        moved[1, column] -= step
        plus, minus = (geometry(q2, row[: 3 * m].reshape(m, 3), row[3 * m :].reshape(k, m, 3)) for row in moved)
        sensitivity[:, column] = (plus - minus) / (2.0 * step)
    covariance = (sensitivity * variance) @ sensitivity.T
    from scipy.stats import t as student

    ci95 = student.ppf(0.975, dof) * np.sqrt(np.diag(covariance))
    turn = _turn(value, q2)
    warnings = list(readings.warnings)
    if np.any(ci95 > np.array([0.05, 0.05, 0.05]) * np.hypot(value[1], value[2])):
        warnings.append(
            f"a_x ± {ci95[1] * MM_PER_M:.1f} mm, a_y ± {ci95[2] * MM_PER_M:.1f} mm: the compensator turned by only "
            f"{turn * DEG_PER_RAD:.1f}°. Measure markers on opposite sides of P0, more angles q2, more repeats."
        )
    if np.hypot(value[1], value[2]) <= value[0]:
        raise MeasurementError(
            f"P0 comes out {np.hypot(value[1], value[2]) * MM_PER_M:.1f} mm from P2, inside the circle of P1 "
            f"({value[0] * MM_PER_M:.1f} mm)",
            advice="Check the sign of q2 (KUKA: negative upwards), and that the markers P01… sit on the compensator.",
        )
    return CompensatorGeometry(value, covariance, ci95, sigma, dof, turn, tuple(warnings))


def _turn(value: Array, q2: Array) -> float:
    direction = np.unwrap(np.arctan2(value[0] * np.sin(q2) + value[2], value[0] * np.cos(q2) + value[1]))
    return float(np.ptp(direction))


def _residuals(readings: MarkerReadings) -> tuple[Array, Array]:
    """Return what the fits leave: of P1 (m, 3), of the other markers (k, m, 2): radial and along the normal [m]."""
    length, axes, centre_p2 = joint_axis_radius(readings.q2, readings.p1)
    u = np.column_stack([np.cos(readings.q2), np.sin(readings.q2), np.zeros_like(readings.q2)])
    left_p1 = readings.p1 - centre_p2 - length * u @ axes.T
    centre_p0, normal = swivel_axis(readings.p0)
    height = (readings.p0 - centre_p0) @ normal
    radius = np.linalg.norm((readings.p0 - centre_p0) - height[..., None] * normal, axis=2)
    return left_p1, np.stack(
        [radius - radius.mean(axis=1, keepdims=True), height - height.mean(axis=1, keepdims=True)], axis=2
    )


def _refuse_impossible(readings: MarkerReadings, left_p1: Array, left_p0: Array) -> None:
    if len(readings.markers) > 2:  # the markers sit on one rigid body: their distances do not change
        apart = np.linalg.norm(readings.p0[:, None] - readings.p0[None], axis=3)
        usual = np.median(apart, axis=2)
        change = np.abs(apart - usual[..., None]).max(axis=(0, 1))
        angle = int(np.argmax(change))
        if change[angle] > _IMPOSSIBLE:
            here = apart[:, :, angle]
            k = len(readings.markers)
            swaps = [_swapped(k, i, j) for i in range(k) for j in range(i)]
            wrong = [float(np.abs(here[np.ix_(order, order)] - usual).max()) for order in swaps]
            best = int(np.argmin(wrong))
            names = [readings.markers[i] for i in range(k) if swaps[best][i] != i]
            advice = "Measure this angle again."
            if wrong[best] < _IMPOSSIBLE:
                advice = f"The names of {' and '.join(names)} are swapped there: correct the file."
            raise MeasurementError(
                f"at q2 = {readings.q2[angle] * DEG_PER_RAD:g}° the markers do not keep their distances "
                f"({change[angle] * MM_PER_M:.1f} mm)",
                advice=advice,
            )
    sizes = [np.linalg.norm(left_p1, axis=1), *np.linalg.norm(left_p0, axis=2)]
    worst = int(np.argmax([size.max() for size in sizes]))
    if sizes[worst].max() > _IMPOSSIBLE:
        name = (P1, *readings.markers)[worst]
        angle = readings.q2[np.argmax(sizes[worst])] * DEG_PER_RAD
        raise MeasurementError(
            f"marker {name} is up to {sizes[worst].max() * MM_PER_M:.1f} mm off its circle (at q2 = {angle:g}°)",
            advice="Check for swapped marker names, a wrong q2, a tracker that was moved, or lengths that are not mm.",
        )


def _swapped(count: int, i: int, j: int) -> list[int]:
    order = list(range(count))
    order[i], order[j] = j, i
    return order


def read(path: Path) -> MarkerReadings:
    """Read `compensator.csv`: q2 [deg], marker, repeat, X, Y, Z [mm].

    :raises MeasurementError: a marker is missing at an angle, too few angles or markers, angles in radians.
    """
    numbers, texts, lines = files.read_csv(path, _COLUMNS, (), MeasurementError, ("marker",))
    where = str(path)
    angles = np.unique(numbers["q2"])[::-1]
    names = sorted(set(texts["marker"]))
    on_compensator = tuple(name for name in names if name != P1)
    for name in names:
        if name != P1 and not (name.startswith("P0") and name[2:].isdigit()):
            first = int(lines[texts["marker"].index(name)])
            raise MeasurementError(
                f"unknown marker {name!r}", file=where, line=first, advice="Markers are P1, P01, P02, …."
            )
    if P1 not in names or not on_compensator:
        absent = P1 if P1 not in names else "P01"
        raise MeasurementError(
            f"no readings of marker {absent}",
            file=where,
            advice="Measure P1 (on link 2, where the spring is attached) and at least one marker P01… on the spring.",
        )
    _check_angles(angles, where)
    position = np.column_stack([numbers[axis] for axis in "XYZ"]) * M_PER_MM
    marker = np.array(texts["marker"])
    groups = {
        (n, a): np.flatnonzero((marker == n) & (numbers["q2"] == a)) for n in (P1, *on_compensator) for a in angles
    }
    for (name, angle), rows in groups.items():
        if len(rows) == 0:
            raise MeasurementError(
                f"no reading of marker {name} at q2 = {angle:g}°",
                file=where,
                advice="Measure every marker at every angle, or leave the angle out.",
            )
        repeats = numbers["repeat"][rows]
        if len(np.unique(repeats)) < len(rows):
            raise MeasurementError(
                f"marker {name} at q2 = {angle:g}°: a repeat stands twice", file=where, line=int(lines[rows[-1]])
            )
    groups, warnings = _without_outliers(groups, position, lines)
    mean = {key: position[rows].mean(axis=0) for key, rows in groups.items()}
    scatter = sum(float(np.sum((position[rows] - mean[key]) ** 2)) for key, rows in groups.items())
    dof = sum(3 * (len(rows) - 1) for rows in groups.values())
    return MarkerReadings(
        q2=angles * RAD_PER_DEG,
        markers=on_compensator,
        p1=np.array([mean[P1, a] for a in angles]),
        p0=np.array([[mean[n, a] for a in angles] for n in on_compensator]),
        count_p1=np.array([float(len(groups[P1, a])) for a in angles]),
        count_p0=np.array([[float(len(groups[n, a])) for a in angles] for n in on_compensator]),
        scatter=scatter,
        scatter_dof=dof,
        warnings=warnings,
    )


def _check_angles(angles: Array, where: str) -> None:
    if len(angles) >= 3 and np.abs(angles).max() <= 2.0 * np.pi:
        raise MeasurementError(
            f"all q2 lie between {angles.min():g} and {angles.max():g}: these look like radians",
            file=where,
            advice="Give q2 in degrees.",
        )
    if len(angles) < 3 or np.ptp(angles) * RAD_PER_DEG < _SMALL_TURN:
        raise MeasurementError(
            f"{len(angles)} angles q2 over {np.ptp(angles) if len(angles) else 0:g}°: too few for a circle",
            file=where,
            advice="Measure at least 3 angles (6 are better) over as much of the range of A2 as can be reached.",
        )


def _without_outliers(groups: _Groups, position: Array, lines: Array) -> tuple[_Groups, tuple[str, ...]]:
    """Leave out readings that stand far from the other repeats of the same point (three or more repeats)."""
    deviation = {key: position[rows] - np.median(position[rows], axis=0) for key, rows in groups.items()}
    pooled = np.abs(np.concatenate([d.ravel() for key, d in deviation.items() if len(d) >= 3] or [np.zeros(0)]))
    if len(pooled) == 0:
        return groups, ()
    # of three repeats one is the median itself: the median of |deviation| over the other two, normal noise
    scale = float(np.median(pooled[pooled > 0.0]) / 0.9) if np.any(pooled > 0.0) else 0.0
    kept: _Groups = {}
    warnings: list[str] = []
    for key, rows in groups.items():
        far = np.linalg.norm(deviation[key], axis=1)
        good = far <= max(_OUTLIER * 1.5 * scale, 1e-6)
        if len(rows) >= 3 and 0 < np.count_nonzero(~good) < 0.5 * len(rows):
            kept[key] = rows[good]
            warnings += [
                f"line {int(lines[row])}: marker {key[0]} at q2 = {key[1]:g}° is {distance * MM_PER_M:.2f} mm from its "
                "other repeats: left out"
                for row, distance in zip(rows[~good], far[~good], strict=True)
            ]
        else:
            kept[key] = rows
    return kept, tuple(warnings)


def as_data(result: CompensatorGeometry, source: str) -> dict[str, object]:
    """Return the result as it stands in its file [mm, deg]; `source`: where the readings came from."""
    values = zip(("L_mm", "a_x_mm", "a_y_mm"), result.value * MM_PER_M, result.ci95 * MM_PER_M, strict=True)
    return {
        "source": source,
        "sigma_mm": result.sigma * MM_PER_M,
        "turn_deg": result.turn * DEG_PER_RAD,
        "covariance_mm2": (result.covariance * MM_PER_M**2).tolist(),
        "warnings": list(result.warnings),
        **{name: {"value": float(value), "ci95": float(half)} for name, value, half in values},
    }


class _Value(msgspec.Struct, frozen=True):
    value: float
    ci95: float = 0.0


class _File(msgspec.Struct, frozen=True):
    L_mm: _Value
    a_x_mm: _Value
    a_y_mm: _Value


def load(path: Path) -> Array:
    """Return (3,) L, a_x, a_y [m] from a file that `save` wrote.

    :raises MeasurementError: it is not such a file.
    """
    content = files.read_toml(path, _File, MeasurementError)
    return np.array([content.L_mm.value, content.a_x_mm.value, content.a_y_mm.value]) * M_PER_MM


def save(path: Path, result: CompensatorGeometry, source: str) -> None:
    """Write the result as TOML, whole or not at all.

    :raises InputError: the file cannot be written.
    """
    if path.is_dir():
        raise InputError("is a folder", file=str(path), advice="Give the name of the file to write.")
    comment = "Gravity compensator, identified by `postproc identify compensator` (paper, Eq. (6), (7))."
    files.write_whole(path.parent, {path.name: files.sealed(files.toml(as_data(result, source), comment))})
