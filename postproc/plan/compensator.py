"""Plan of the readings that determine the geometry of the gravity compensator: angles of A2 and places of markers.

The criterion is the trace of the covariance of L, a_x, a_y by Eq. (6), (7) as corrected
(`identification.compensator_geometry`). The angles are chosen by exchange (Fedorov 1972), in whole degrees. Where the
markers go does not depend on the angles: evenly around P0, see `even_angles`. Their radii cancel: markers on a larger
circle move more, but the angle of a given error of the distance from P0 does not change.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.decimals import without_negative_zero
from postproc.errors import PlanError
from postproc.frames import DEG_PER_RAD, MM_PER_M, RAD_PER_DEG, Array
from postproc.identification import compensator_geometry as geometry
from postproc.robot import RobotModel

_MIN_STEP = 10.0
"""Least difference of two angles of A2 [deg]: readings at different angles check each other."""
_RADIUS = 0.15
"""Radius [m] for which the numbers are computed; they hardly depend on it."""


class CompensatorOptions(Struct, frozen=True):
    """Size of the plan.

    :param angles: number of angles of A2.
    :param markers: number of markers on the compensator.
    :param repeats: readings of each marker at each angle.
    :param margin: distance to keep from the limits of A2 [rad].
    """

    angles: int = 6
    markers: int = 4
    repeats: int = 3
    margin: float = 5.0 * RAD_PER_DEG


class CompensatorPlan(Struct, frozen=True, eq=False):
    """Angles and marker places to measure, and the expected intervals.

    :param robot: name of the model whose compensator is the prior.
    :param options: size of the plan.
    :param sigma: noise of one coordinate of one reading [m].
    :param lengths: (3,) L, a_x, a_y of the prior [m].
    :param q2: (m,) angles of A2, descending [rad].
    :param beta: (k,) angles of the markers around P0, from the line P0 → P1, positive as q2 [rad].
    :param turn: angle by which the compensator turns [rad].
    :param ci95: (3,) expected half widths of the 95 % intervals of L, a_x, a_y [m].
    :param ci95_even: (3,) expected half widths with angles of A2 evenly over the range [m].
    """

    robot: str
    options: CompensatorOptions
    sigma: float
    lengths: Array
    q2: Array
    beta: Array
    turn: float
    ci95: Array
    ci95_even: Array


def plan_compensator(robot: RobotModel, sigma: float, options: CompensatorOptions) -> CompensatorPlan:
    """Return the angles of A2 and the places of markers that determine L, a_x, a_y of the compensator best.

    L is the distance from joint axis 2 to P1, where the spring is attached to link 2. a_x and a_y are the distances to
    P0, about which the compensator swivels.

    :param sigma: noise of one coordinate of one reading [m].
    :raises PlanError: the robot has no compensator, or its A2 has no room for the angles.
    """
    compensator = robot.compensator
    if compensator is None:
        raise PlanError(
            f"robot {robot.name} has no gravity compensator",
            advice="Give the robot in the experiment a [compensator] in its model.toml, with rough L, a_x, a_y.",
        )
    lengths = np.array([compensator.L, compensator.ax, compensator.ay])
    lower = (robot.lower[1] + options.margin) * DEG_PER_RAD
    upper = (robot.upper[1] - options.margin) * DEG_PER_RAD
    # whole degrees; 1e-9: a limit that is whole but for rounding counts
    grid = np.arange(np.ceil(lower - 1e-9), np.floor(upper + 1e-9) + 1.0)
    if len(grid) < 1 + _MIN_STEP * (options.angles - 1):
        raise PlanError(
            f"A2 can turn from {lower:g}° to {upper:g}°: no room for {options.angles} angles {_MIN_STEP:g}° apart",
            advice="Ask for fewer with --angles, or for a smaller --margin.",
        )
    beta = geometry.even_angles(options.markers)
    even_angles = grid[np.round(np.linspace(0, len(grid) - 1, options.angles)).astype(np.int64)]
    angles = _exchanged_angles(lengths, grid, even_angles, beta)
    q2 = np.sort(angles)[::-1] * RAD_PER_DEG
    return CompensatorPlan(
        robot=robot.name,
        options=options,
        sigma=sigma,
        lengths=lengths,
        q2=q2,
        beta=beta,
        turn=float(np.ptp(geometry.spring_direction(lengths, q2))),
        ci95=expected_intervals(lengths, q2, beta, sigma, options.repeats),
        ci95_even=expected_intervals(lengths, even_angles * RAD_PER_DEG, beta, sigma, options.repeats),
    )


def expected_intervals(lengths: Array, q2: Array, beta: Array, sigma: float, repeats: int) -> Array:
    """Return the expected half widths (3,) of the 95 % intervals of L, a_x, a_y [m], for markers at `_RADIUS` from P0.

    :param lengths: (3,) L, a_x, a_y [m].
    :param q2: (m,) angles of joint 2 [rad].
    :param beta: (k,) angles of the markers around P0 [rad].
    :param sigma: noise of one coordinate of one reading [m].
    :param repeats: readings of each marker at each angle.
    """
    m, k = len(q2), len(beta)
    # of the residuals of the circle fits, and of the scatter of repeats: P1 and k markers at m angles, 3 coordinates
    dof = geometry.degrees_of_freedom(m, k) + 3 * (repeats - 1) * m * (k + 1)
    covariance = geometry.expected_covariance(lengths, q2, np.full(k, _RADIUS), beta, sigma**2 / repeats)
    return np.asarray(geometry.student_95(dof) * np.sqrt(np.diag(covariance)))


def _exchanged_angles(lengths: Array, grid: Array, start: Array, beta: Array) -> Array:
    """Return angles (m,) [deg] such that no exchange of a single angle makes the expected covariance smaller.

    Exchange algorithm of Fedorov (1972); the criterion is the trace of the covariance of L, a_x, a_y.

    :param lengths: (3,) L, a_x, a_y [m].
    :param grid: angles to choose from [deg], and `start` (m,) angles to begin with [deg].
    :param beta: (k,) angles of the markers around P0 [rad].
    """
    angles, radius = start.copy(), np.full(len(beta), _RADIUS)

    def cost(angles_deg: Array) -> float:
        """Return the trace of the expected covariance [m²] for angles (m,) [deg]."""
        # variance of a typical tracker [m²]: it scales the whole covariance but for the square of the bias
        return float(np.trace(geometry.expected_covariance(lengths, angles_deg * RAD_PER_DEG, radius, beta, 1e-9)))

    lowest_cost, has_gain = cost(angles), True
    while has_gain:
        has_gain = False
        for place in range(len(angles)):
            other_angles = np.delete(angles, place)
            for angle in grid[np.abs(grid[:, None] - other_angles).min(axis=1) >= _MIN_STEP]:
                trial_cost = cost(np.append(other_angles, angle))
                if trial_cost < lowest_cost * (1.0 - 1e-6):  # less is rounding: the loop would not end
                    angles[place], lowest_cost, has_gain = angle, trial_cost, True
    return angles


def template(plan: CompensatorPlan) -> bytes:
    """Return `compensator.csv` with every reading to be taken; X, Y, Z are to be filled in."""
    names = [geometry.P1, *marker_names(plan)]
    rows = ["q2,marker,repeat,X,Y,Z"]
    for angle in np.round(plan.q2 * DEG_PER_RAD).astype(int):
        rows += [f"{angle},{name},{turn + 1},,," for name in names for turn in range(plan.options.repeats)]
    return ("\n".join(rows) + "\n").encode()


def marker_names(plan: CompensatorPlan) -> list[str]:
    """Return the names of the markers on the compensator: P01, P02, …."""
    return [f"P0{number + 1}" for number in range(len(plan.beta))]


def summary(plan: CompensatorPlan) -> dict[str, object]:
    """Return the plan as content of a file, in mm and degrees."""
    rows = {"L_mm": 0, "a_x_mm": 1, "a_y_mm": 2}  # key → index of the length in the arrays of the plan
    return {
        "robot": plan.robot,
        "sigma_mm": round(plan.sigma * MM_PER_M, 9),
        "q2_deg": [float(angle) for angle in without_negative_zero(np.round(plan.q2 * DEG_PER_RAD))],
        "turn_deg": plan.turn * DEG_PER_RAD,
        "repeats": plan.options.repeats,
        "markers": [
            {"name": name, "beta_deg": float(angle)}
            for name, angle in zip(marker_names(plan), np.round(plan.beta * DEG_PER_RAD, 6), strict=True)
        ],
        **{
            key: {
                "prior": float(plan.lengths[row]) * MM_PER_M,
                "ci95": float(plan.ci95[row]) * MM_PER_M,
                "ci95_even_angles": float(plan.ci95_even[row]) * MM_PER_M,
            }
            for key, row in rows.items()
        },
    }


def text_lines(plan: CompensatorPlan) -> list[str]:
    """Return the plan as lines for a terminal."""
    angles = ", ".join(f"{angle:.0f}" for angle in without_negative_zero(np.round(plan.q2 * DEG_PER_RAD)))
    marker_texts = ", ".join(
        f"{name} {angle:.0f}°" for name, angle in zip(marker_names(plan), plan.beta * DEG_PER_RAD, strict=True)
    )
    ci, even_ci = plan.ci95 * MM_PER_M, plan.ci95_even * MM_PER_M
    opposite = "; opposite markers at equal radius" if len(plan.beta) >= 4 and len(plan.beta) % 2 == 0 else ""
    return [
        f"A2 at {angles}°: the compensator turns by {plan.turn * DEG_PER_RAD:.1f}°",
        "P1 on link 2 where the spring is attached; markers on the compensator around its swivel axis P0, from the "
        f"line P0 → P1, positive as A2 turns: {marker_texts}; any radius{opposite}",
        f"{plan.options.repeats} readings each with {plan.sigma * MM_PER_M:g} mm noise: L ± {ci[0]:.3f} mm, "
        f"a_x ± {ci[1]:.3f} mm, a_y ± {ci[2]:.3f} mm (95 %)",
        f"angles of A2 evenly over the range: L ± {even_ci[0]:.3f} mm, a_x ± {even_ci[1]:.3f} mm, "
        f"a_y ± {even_ci[2]:.3f} mm",
    ]
