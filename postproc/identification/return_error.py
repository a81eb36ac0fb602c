"""Return error: how far the unloaded tool is from its place when it comes back from a load.

Gears with hysteresis do not return to where they were: the unloaded robot stands elsewhere after a load than before.
Structures of gears that depend on the torque can take the part of it that repeats with each load, so that
configurations left out do not show it; a job, which loads the robot in another order and direction, has it in full.
The states without load show it directly: in the first repeat of a configuration the robot has just arrived, in the
later ones it comes back from the loads.

**Positions** (`return_errors`). A device that drifts evenly moves the readings too, by the same amount from each repeat
to the next. A line through the places of the second and later repeats continues this drift back to the first, which
is off the line by the return error. Slopes of single lines are uncertain: those of all configurations count, as far as
they do not differ by more than the noise.

**Displacements** (`displacement_changes`). The state without load is not in the file, but each displacement begins
there. A gear with hysteresis is a play in series with a spring: the first load moves it from wherever it arrived to the
end of the play, and from then on each load closes the same loop (Krasnosel'skii and Pokrovskii, Systems with
Hysteresis, 1989). So the displacement of the first repeat differs from those of the later ones by the return
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
_STATED_DOF = 10
"""Degrees of freedom that the stated noise counts (assumed): as if it were known to 22 %."""
CLEAR_SCATTER = 30
"""Degrees of freedom from which the scatter of the repeats counts as noise: it is known to 13 %, 1/√(2 dof)."""
GEARS_RETURN = (
    "the gears have no hysteresis: only readings without load before, between and after loads show it. Measure three "
    "repeats of each configuration, each from the state without load through all loads and back"
)
"""What is assumed where readings show no return errors, and how to measure them."""


class ReturnErrors(NamedTuple):
    """Return errors of n configurations.

    :param error: (n, 3) unloaded mean of the points in the first repeat, less where the later ones and the drift put it
        [m], frame of the measuring device.
    :param variance: of one coordinate by the noise [m²].
    """

    error: Array
    variance: float


def return_errors(data: Measurements) -> ReturnErrors | None:
    """Return the return errors of the configurations whose unloaded state was measured three times or more.

    None if there are fewer than `_FEWEST_CONFIGURATIONS`: with two repeats a drift cannot be told from a return error.
    If the robot was not loaded between the repeats, there is no return error in them, and nothing in the file says so.
    """
    places = _unloaded_places(data)
    if data.are_displacements or len(places) < _FEWEST_CONFIGURATIONS:
        return None
    first, later = places[:, 0], places[:, 1:]
    count, repeats, _ = later.shape
    time = np.arange(repeats) - 0.5 * (repeats - 1)  # of the later repeats from their middle, in repeats
    spread, lead = float(time @ time), 1.0 - float(time[0])  # the first repeat is `lead` before the middle
    mean, slope = later.mean(axis=1), np.einsum("r,nri->ni", time, later) / spread
    drift = _drifts(data, later - mean[:, None] - time[:, None] * slope[:, None], slope, spread)
    # the mean of n slopes has 1/n of their variance
    slope_share = drift.slope_weight**2 + (1.0 - drift.slope_weight**2) / count
    factor = 1.0 + 1.0 / repeats + lead**2 / spread * slope_share
    return ReturnErrors(first - mean + lead * drift.drift, factor * drift.noise_variance)


class _Drifts(NamedTuple):
    """Drifts (n, 3) of the device from repeat to repeat [m], and the variance of a place by the noise [m²].

    :param slope_weight: weight of the slope of each configuration, against the mean slope of all.
    :param noise_variance: that of the repeats, or the stated one if it is smaller, but at least the lower limit of 95 %
        by χ²: a scatter of few repeats that is large by chance does not hide a return error.
    """

    drift: Array
    slope_weight: float
    noise_variance: float


def _drifts(data: Measurements, residual: Array, slope: Array, spread: float) -> _Drifts:
    """Return the drifts of n configurations, between their own slopes and the mean of all slopes.

    Slopes that scatter as the noise makes them scatter are replaced by their mean; drifts that differ more are kept, in
    the proportion of the variances (shrinkage of random effects: Searle, Casella and McCulloch, Variance Components,
    1992).

    :param residual: (n, m, 3) of the lines through m places of each configuration [m].
    :param slope: (n, 3) of the lines [m].
    :param spread: sum of squares of the m times: the variance of a slope is that of a place over it.
    """
    from scipy.special import chdtri  # takes long to import

    count, repeats, _ = residual.shape
    mean_slope = slope.mean(axis=0)
    slope_squares, slope_dof = spread * float(np.sum((slope - mean_slope) ** 2)), 3 * (count - 1)
    line_squares, line_dof = float(np.sum(residual**2)), 3 * count * (repeats - 2)
    stated_variance = data.sigma**2 / len(data.points)
    noise = (line_squares + _STATED_DOF * stated_variance) / (line_dof + _STATED_DOF)
    # 1e-300: slopes that do not scatter at all
    slope_weight = max(0.0, 1.0 - noise * slope_dof / max(slope_squares, 1e-300))
    # two later places have no residual: all scatter of their steps counts as noise
    noise_share = 1.0 if line_dof == 0 else 1.0 - slope_weight
    squares = line_squares + noise_share * slope_squares
    dof = line_dof + slope_dof
    variance = float(np.clip(stated_variance, squares / chdtri(dof, 0.05), squares / dof))
    return _Drifts(mean_slope + slope_weight * (slope - mean_slope), slope_weight, variance)


def _unloaded_places(data: Measurements) -> Array:
    """Return the mean of the points (n, r, 3) [m] in the first r repeats of the n unloaded states with three or more.

    r is the least number of repeats of these states. Only points that were read in all repeats of a state count.
    """
    repeats_of_state = [np.unique(data.repeat[data.used & (data.state == state)]) for state in data.unloaded_states]
    counts = [len(repeats) for repeats in repeats_of_state if len(repeats) >= 3]
    count = min(counts, default=3)
    places = [
        _places(data, state, repeats[:count])
        for state, repeats in zip(data.unloaded_states.tolist(), repeats_of_state, strict=True)
        if len(repeats) >= 3
    ]
    return np.array([place for place in places if place is not None]).reshape(-1, count, 3)


def _places(data: Measurements, state: int, repeats: Array) -> Array | None:
    """Return the mean of the points (r, 3) [m] in r repeats of a state; None if no point was read in all of them."""
    rows_of_repeat = [data.used & (data.state == state) & (data.repeat == repeat) for repeat in repeats]
    points = np.arange(len(data.points))
    for rows in rows_of_repeat:
        points = np.intersect1d(points, data.point[rows])
    if not len(points):
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
