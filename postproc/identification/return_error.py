"""Return error: how far the unloaded tool is from its place when it comes back from a load.

Gears with hysteresis do not return to where they were: the unloaded robot stands elsewhere after a load than before.
Structures of gears that depend on the torque can take the part of it that repeats with each load, so that
configurations left out do not show it; a job, which loads the robot in another order and direction, has it in full.
The states without load show it directly: in the first repeat of a configuration the robot has just arrived, in the
later ones it comes back from the loads.

A device that drifts evenly moves the readings too, by the same amount from each repeat to the next. The second
difference of three repeats, x1 − 2 x2 + x3, has no such part; with the second and third alike it is x1 − x2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc.frames import Array
from postproc.identification.readings import Measurements

_FEWEST_CONFIGURATIONS = 4
"""Fewest configurations with three repeats of the unloaded state from which return errors are judged (assumed)."""
GEARS_RETURN = (
    "the gears have no hysteresis: only readings without load before, between and after loads show it. Measure three "
    "repeats of each configuration, each from the state without load through all loads and back"
)
"""What is assumed where readings show no return errors, and how to measure them."""


class ReturnErrors(NamedTuple):
    """Return errors of n configurations.

    :param error: (n, 3) second differences of the unloaded mean of the points [m], frame of the measuring device.
    :param variance: of one coordinate by the noise, which the second and third repeat show [m²].
    """

    error: Array
    variance: float


def return_errors(data: Measurements) -> ReturnErrors | None:
    """Return the return errors of the configurations whose unloaded state was measured three times.

    None if there are fewer than `_FEWEST_CONFIGURATIONS`: with two repeats a drift cannot be told from a return error.
    If the robot was not loaded between the repeats, there is no return error in them, and nothing in the file says so.
    """
    places = [_first_three_places(data, state) for state in data.unloaded_states.tolist()]
    measured_places = [three for three in places if three is not None]
    if data.are_displacements or len(measured_places) < _FEWEST_CONFIGURATIONS:
        return None
    first, second, third = np.moveaxis(np.array(measured_places), 1, 0)
    step = third - second
    step -= step.mean(axis=0)  # the even drift
    step_variance = float(np.sum(step**2)) / (3 * (len(step) - 1))
    # the variances of x1 − 2 x2 + x3 and x3 − x2 are 6 and 2 times that of one place
    return ReturnErrors(first - 2.0 * second + third, 3.0 * step_variance)


def _first_three_places(data: Measurements, state: int) -> Array | None:
    """Return the mean of the points (3, 3) [m] in the first three repeats of a state; None without three repeats.

    Only points that were read in all three count.
    """
    is_read = data.used & (data.state == state)
    repeats = np.unique(data.repeat[is_read])[:3]
    rows_of_repeat = [is_read & (data.repeat == repeat) for repeat in repeats]
    points = np.arange(len(data.points))
    for rows in rows_of_repeat:
        points = np.intersect1d(points, data.point[rows])
    if len(repeats) < 3 or not len(points):
        return None
    is_counted = np.isin(data.point, points)
    return np.array([data.position[rows & is_counted].mean(axis=0) for rows in rows_of_repeat])
