"""Return error: how far the unloaded tool is from its place when it comes back from a load.

Gears with hysteresis do not return to where they were: the unloaded robot stands elsewhere after a load than before.
Structures of gears that depend on the torque can take the part of it that repeats with each load, so that
configurations left out do not show it; a job, which loads the robot in another order and direction, has it in full.
The states without load show it directly: in the first repeat of a configuration the robot has just arrived, in the
later ones it comes back from the loads.

**Positions** (`return_errors`). A device that drifts evenly moves the readings too, by the same amount from each repeat
to the next. The second difference of three repeats, x1 − 2 x2 + x3, has no such part; with the second and third alike
it is x1 − x2.

**Displacements** (`displacement_changes`). The state without load is not in the file, but each displacement begins
there. A gear with hysteresis is a play in series with a spring: the first load moves it from wherever it arrived to the
end of the play, and from then on each load closes the same loop (Krasnosel'skii and Pokrovskii, Systems with
Hysteresis, 1989, section 2). So the displacement of the first repeat differs from those of the later ones by the return
error, equally at all points but for a small rotation. This change is no noise of the device, and `noise_scatter` is
without it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.frames import Array
from postproc.identification.readings import Measurements
from postproc.program import Bools, Ints

_FEWEST_CONFIGURATIONS = 4
"""Fewest configurations with repeats of the same state from which return errors are judged (assumed)."""
CLEAR_SCATTER = 30
"""Degrees of freedom from which the scatter of the repeats counts as noise: it is known to 13 %, 1/√(2 dof)."""
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


class DisplacementChanges(NamedTuple):
    """Changes of n displacements from the first repeat to the mean of the later ones.

    :param state: (n,) the loaded state of each.
    :param change: (n, 3) weighted mean over the points [m].
    :param weight: (n,) reciprocal variance of one coordinate of a change, for readings with the variance 1.
    """

    state: Ints
    change: Array
    weight: Array


def displacement_changes(data: Measurements) -> DisplacementChanges | None:
    """Return the changes of displacements from the first repeat of a configuration to its later repeats.

    None if the readings are positions, or if fewer than `_FEWEST_CONFIGURATIONS` have a change. States and points
    without a reading in the first or in a later repeat do not count.
    """
    if data.has_unloaded_readings:
        return None
    is_first = is_first_repeat(data)
    first, first_count = replace(data, used=data.used & is_first).means()
    later, later_count = replace(data, used=data.used & ~is_first).means()
    # the difference of two means has the variance 1/n₁ + 1/n₂ for readings with the variance 1
    point_weight = first_count * later_count / np.maximum(first_count + later_count, 1.0)
    point_weight[data.unloaded_states] = 0.0
    weight = point_weight.sum(axis=1)
    states = np.flatnonzero(weight > 0.0)
    if len(np.unique(data.state_config[states])) < _FEWEST_CONFIGURATIONS:
        return None
    change = np.einsum("sp,spi->si", point_weight, first - later)[states] / weight[states, None]
    return DisplacementChanges(states, change, weight[states])


def is_first_repeat(data: Measurements) -> Bools:
    """Return whether each reading (n,) is of the first repeat with used readings under load of its configuration."""
    config = data.state_config[data.state]
    repeat = np.where(data.used & (data.load[data.state] != 0.0), data.repeat, np.inf)
    first_repeat = np.full(len(data.q), np.inf)
    np.minimum.at(first_repeat, config, repeat)
    return np.asarray(data.repeat == first_repeat[config])


def noise_scatter(data: Measurements) -> tuple[float, int]:
    """Return the sum of squares of the repeats about their means [m²], and its degrees of freedom.

    Without the changes of displacements from the first repeat to the later ones, see `displacement_changes`.
    """
    squares, dof = data.scatter()
    changes = displacement_changes(data)
    if changes is None:
        return squares, dof
    # each change is one more unknown of its state, with three coordinates
    return squares - float(np.sum(changes.weight[:, None] * changes.change**2)), dof - changes.change.size


def noise_variance(data: Measurements) -> float:
    """Return the variance of one coordinate of a reading [m²]: by the repeats if these are enough, else as stated."""
    squares, dof = noise_scatter(data)
    return squares / dof if dof >= CLEAR_SCATTER else data.sigma**2
