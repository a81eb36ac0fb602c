"""Probed deviations of a test part, referred to the uncut top of the block, and what part and path add to them.

The part lies anywhere when it is probed. Its uncut top is the datum: the plane through the touch-off points. The
position of the cuts against it is free (six numbers for each placement of the block). Along Z it is the error of the
touch-off: a program that runs too high over the block cuts less deep, so its forces and deflections are smaller. A path
that is off by p and a lift of the whole program both move a surface along its normal n by n·p, and change the
deflection by c·p_z, where c is the derivative of the deflection by the lift. So the direction in which a position is
seen is n + c Z.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.chunks import Columns
from postproc.errors import MeasurementError
from postproc.frames import Array
from postproc.testpart.cut import Surfaces
from postproc.testpart.probing import ProbedSurfaces, TouchOff

PATH_ERROR = 1e-4
"""Standard deviation of the path of the robot without force from one feature to another [m] (assumed)."""
RADIUS_ERROR = 5e-5
"""Standard deviation of the radius at which the tool cuts, run-out included [m] (assumed)."""
UNEVENNESS = 2e-5
"""Standard deviation of the uncut top from a plane [m]. Assumed: a faced block."""
POSITION_SIGMA, ROTATION_SIGMA = 1e-2, 1e-1
"""Standard deviations of the position of the part where it is probed [m, rad]: free."""
_FEWEST_TOUCHES = 3
"""Fewest touch-off points of a placement: height and two slopes of the top."""
_SMALLEST_SPREAD = 5e-3
"""Least spread of the touch-off points across their longest line, RMS [m] (assumed)."""
_MOST_MISFIT = 4.0
"""Distance of the touch-off points from a plane, in standard deviations, beyond which they contradict each other
(assumed)."""
_Z = np.array([0.0, 0.0, 1.0])
"""Direction away from the block, in `$BASE`."""


class Top(Struct, frozen=True, eq=False):
    """The uncut top of the block in one placement, in the frame in which the part was probed.

    :param base: number of the placement.
    :param points: names of the touch-off points.
    :param origin: (3,) middle of these points, `$BASE` [m].
    :param coefficients: (3,) deviation of the top at `origin` [m], and its slopes along X and Y.
    :param covariance: (3, 3) of `coefficients`.
    :param misfit: RMS distance of the points from the plane, in standard deviations of a point; 0 for three points.
    """

    base: int
    points: tuple[str, ...]
    origin: Array
    coefficients: Array
    covariance: Array
    misfit: float

    @property
    def is_contradictory(self) -> bool:
        """Whether the touch-off points are on no plane."""
        return self.misfit > _MOST_MISFIT

    def terms(self, points: Array) -> Array:
        """Return the factors (n, 3) of `coefficients` in the deviation of the top at points (n, 3) [m]."""
        return np.column_stack([np.ones(len(points)), (points - self.origin)[:, :2]])

    def deviation(self, points: Array, normals: Array) -> Array:
        """Return the deviation (n,) [m] of surfaces that move with the top from the program's zero.

        :param points: (n, 3) points of the surfaces, `$BASE` [m], and `normals` (n, 3) their unit normals.
        """
        height, slope_x, slope_y = self.coefficients
        motion = height * _Z + np.cross(np.array([slope_y, -slope_x, 0.0]), points - self.origin)
        return np.asarray(np.einsum("ni,ni->n", normals, motion))


def top_plane(touch_off: TouchOff, base: int, sigma: float, file: str) -> Top:
    """Return the plane through the touch-off points of a placement, by least squares.

    :param base: number of the placement: n of `[base_data.n]` of the cell, −1 for its `[base]`.
    :param sigma: noise of the probe [m].
    :param file: the table of the points.
    :raises MeasurementError: there are fewer than three touch-off points, or they are on a line.
    """
    touches = touch_off.of_placement(base)
    count = len(touches.name)
    is_cell_base = base < 0
    placement_note = "" if is_cell_base else f" for [base_data.{base}]"
    if count < _FEWEST_TOUCHES:
        raise MeasurementError(
            f"{count or 'no'} touch-off points{placement_note}: whether the program ran too high or too low over the "
            "block is not known, so the depth of its cuts is not known either",
            file=file,
            advice="Probe at least three points of the uncut top, far apart, in the clamping of the other points. Fill "
            "in the rows T01.top, T02.top …, or add rows: source_line and t 0; X, Y, Z of a point of the top as "
            "programmed; normal 0, 0, 1.",
        )
    origin = touches.point.mean(axis=0)
    smallest_spread = float(np.linalg.svd((touches.point - origin)[:, :2], compute_uv=False)[-1]) / np.sqrt(count)
    if smallest_spread < _SMALLEST_SPREAD:
        advice = "Probe points near three corners of the block."
        raise MeasurementError(f"the touch-off points{placement_note} are on one line", file=file, advice=advice)
    variance = sigma**2 + UNEVENNESS**2
    terms = np.column_stack([np.ones(count), (touches.point - origin)[:, :2]])
    covariance = variance * np.linalg.inv(terms.T @ terms)
    coefficients = covariance @ terms.T @ touches.deviation / variance
    residual = touches.deviation - terms @ coefficients
    surplus = count - _FEWEST_TOUCHES
    misfit = float(np.sqrt(residual @ residual / (surplus * variance))) if surplus else 0.0
    # points that are farther from the plane than their noise allows make it more uncertain
    return Top(
        base=base,
        points=touches.name,
        origin=origin,
        coefficients=coefficients,
        covariance=max(1.0, misfit**2) * covariance,
        misfit=misfit,
    )


class Lift(Struct, frozen=True, eq=False):
    """Height of a program over the block above the written one, by a touch-off error or a tilt of `$BASE`.

    :param base: number of the placement.
    :param origin: (3,) middle of the probed points, `$BASE` [m].
    :param coefficients: (3,) lift at `origin` [m], positive where less was cut, and its slopes along X and Y.
    :param covariance: (3, 3) of `coefficients`.
    """

    base: int
    origin: Array
    coefficients: Array
    covariance: Array

    def heights(self, points: Array) -> Array:
        """Return the lift (n,) [m] at points (n, 3) in `$BASE` [m]."""
        return np.asarray(self.coefficients[0] + (points - self.origin)[:, :2] @ self.coefficients[1:])


class Readings(Columns, frozen=True, eq=False):
    """Probed deviations, referred to the uncut top of the block, and where they come from.

    :param probed: the points. Their deviations are what would be measured if the top were at the program's zero.
    :param datum: (n,) measured deviations minus these deviations [m].
    :param surfaces: places where the surfaces are made.
    :param sigma: noise of the probe [m].
    :param tops: the top of each placement in which something was cut, in the order of the points.
    """

    probed: ProbedSurfaces
    datum: Array
    surfaces: Surfaces
    sigma: float
    tops: tuple[Top, ...]

    @classmethod
    def of(cls, points: ProbedSurfaces, surfaces: Surfaces, sigma: float) -> Self:
        """Refer the deviations of cut surfaces to the touch-off points.

        :raises MeasurementError: the touch-off points of a placement are too few, or on a line.
        """
        datum, tops = np.zeros(len(points)), []
        for base in dict.fromkeys(points.base.tolist()):
            rows = np.flatnonzero((points.base == base) & ~points.is_gauge)
            if len(rows):
                tops.append(top_plane(points.touch_off, base, sigma, points.file))
                datum[rows] = tops[-1].deviation(points.point[rows], points.normal[rows])
        return cls(replace(points, deviation=points.deviation - datum), datum, surfaces, sigma, tuple(tops))

    @property
    def least_depth(self) -> float:
        """Smallest depth of a probed point below the top [m]; of floors alone if any was probed, inf without points."""
        top_of_base = {top.base: top.origin[2] for top in self.tops}
        top_z = np.array([top_of_base.get(base, np.inf) for base in self.probed.base.tolist()])
        depth = top_z - self.probed.point[:, 2]
        is_floor = ~self.surfaces.is_wall & ~self.probed.is_gauge
        is_counted = is_floor if is_floor.any() else ~self.probed.is_gauge
        return float(depth[is_counted].min(initial=np.inf))

    @property
    def _cut_weight(self) -> Array:
        """(n,) 1 for cut surfaces, 0 for readings of a gauge, which do not depend on the position of the part."""
        return np.asarray(~self.probed.is_gauge, dtype=float)

    def _position_slopes(self, direction: Array) -> Array:
        """Return the derivatives (n, 6 b) [m] of the readings by the position of the cuts in each of b placements.

        Each placement has six columns: shifts along X, Y, Z in units of `POSITION_SIGMA`, then turns about X, Y, Z in
        units of `ROTATION_SIGMA`.

        :param direction: (n, 3) direction in which a displacement is seen at each point, see `directions`.
        """
        columns = []
        for base in self._bases:
            is_in_placement = (self.probed.base == base)[:, None]
            arm = self.probed.point - self.probed.point.mean(axis=0, where=is_in_placement)
            columns += [
                POSITION_SIGMA * direction * is_in_placement,
                ROTATION_SIGMA * np.cross(arm, direction) * is_in_placement,
            ]
        return np.concatenate(columns, axis=1)

    @property
    def _bases(self) -> list[int]:
        """Numbers of the placements, in the order of the points."""
        return list(dict.fromkeys(self.probed.base.tolist()))

    def directions(self, by_lift: Array) -> Array:
        """Return the vectors (n, 3) by which a displacement of the path is multiplied to get the deviation it causes.

        It is the normal of the surface, and along Z also the deflection that changes with the depth of cut.

        :param by_lift: (n,) derivative of the deviations by the lift of the program over the block.
        """
        return np.asarray(self._cut_weight[:, None] * (self.probed.normal + by_lift[:, None] * _Z))

    def part_covariance(self, by_lift: Array) -> Array:
        """Return the covariance (n, n) [m²] that part, touch-off and path without force add to the readings.

        It is the sum of the position of the part, the radius of the tool, the path and the unevenness of the top at
        each feature, and the errors of the touch-off plane.

        :param by_lift: (n,) derivative of the deviations by the lift of the program over the block.
        """
        probe_data = self.probed
        direction = self.directions(by_lift)
        position = self._position_slopes(direction)
        same_group = probe_data.group[:, None] == probe_data.group[None, :]
        by_radius = RADIUS_ERROR * self.surfaces.is_wall
        covariance = position @ position.T + np.outer(by_radius, by_radius)
        # features are cut apart from each other, so their paths and their patches of the top are independent
        covariance += same_group * (
            PATH_ERROR**2 * (direction @ direction.T) + UNEVENNESS**2 * np.outer(by_lift, by_lift)
        )
        for top in self.tops:
            terms = (by_lift * (probe_data.base == top.base))[:, None] * top.terms(probe_data.point)
            covariance += terms @ top.covariance @ terms.T
        return np.asarray(covariance)

    def lifts(self, by_lift: Array, precision: Array, target: Array) -> tuple[Lift, ...]:
        """Return the lift of the program over the block in each placement, with its covariance.

        :param by_lift: (n,) derivative of the deviations by the lift of the program over the block.
        :param precision: (n, n) inverse of the covariance of the deviations.
        :param target: (n,) deviations less those that the model predicts for a program without lift [m].
        """
        position = self._position_slopes(self.directions(by_lift))
        # posterior mean and covariance of the position, whose prior has unit variances
        shift = position.T @ precision @ target
        covariance = np.eye(len(shift)) - position.T @ precision @ position
        lifts = []
        for k, base in enumerate(self._bases):
            # of the six columns of a placement: along Z, about X, about Y
            columns = 6 * k + np.array([2, 3, 4])
            # height by the shift, slope along X by the turn about −Y, slope along Y by the turn about X
            terms = np.array([[POSITION_SIGMA, 0.0, 0.0], [0.0, 0.0, -ROTATION_SIGMA], [0.0, ROTATION_SIGMA, 0.0]])
            origin = self.probed.point.mean(axis=0, where=(self.probed.base == base)[:, None])
            lift_covariance = terms @ covariance[np.ix_(columns, columns)] @ terms.T
            for top in self.tops:
                if top.base == base:
                    by_top = top.terms(origin[None])[0]
                    lift_covariance[0, 0] += by_top @ top.covariance @ by_top
                    lift_covariance[1:, 1:] += top.covariance[1:, 1:]
            lifts.append(
                Lift(base=base, origin=origin, coefficients=terms @ shift[columns], covariance=lift_covariance)
            )
        return tuple(lifts)
