"""Plausibility of readings: gross errors, swapped names, a moved tracker, wrong units and signs of forces, hysteresis.

Single gross errors are left out and listed: first without a model, against the other repeats and against the distances
between points of one rigid body; then, in a fit that is good but for a few points, against the model. Errors of whole
sets (names, frames, angles, forces) are refused with their line.

Hysteresis: loads that are applied on the way up and again on the way down show the backlash and friction of each joint.
"""

from __future__ import annotations

from itertools import permutations
from typing import NamedTuple, NoReturn

import numpy as np
from msgspec.structs import replace

from postproc import elastostatics, kinematics
from postproc.errors import MeasurementError, PostprocError
from postproc.frames import M_PER_MM, MM_PER_M, Array, norm
from postproc.identification.fit import Fit
from postproc.identification.measurement_model import (
    Placement,
    Structure,
    joint_torques,
    locate,
    measured_displacements,
    predict,
    unloaded_design,
    visible_points,
    whiten,
    whitening,
)
from postproc.identification.outlying_configuration import check_configurations
from postproc.identification.readings import Measurements
from postproc.identification.return_error import is_first_repeat
from postproc.program import Bools, Ints
from postproc.robot import JOINT_COMPLIANCES, JOINTS, RobotModel

_GROSS_SIGMAS = 6.0
"""Standard deviations beyond which a reading counts as a gross error."""
_DISTANCE_FACTOR = 1.5
"""Distance of a reading from others over the noise of one coordinate, about: three coordinates (assumed)."""
_MAXIMUM_FACTOR = 1.3
"""Factor on the limit for the largest of all residuals, of points with three coordinates (assumed)."""
_MEDIAN_SIZE = 0.6745
"""Median size of a standard normal number."""


class CheckedPlacement(NamedTuple):
    """Readings that were checked, and where they are.

    :param data: readings without gross errors.
    :param placement: frame of the device and points on the flange.
    :param outliers: a sentence for each reading that was left out.
    """

    data: Measurements
    placement: Placement
    outliers: list[str]


def check_placement(robot: RobotModel, data: Measurements) -> CheckedPlacement:
    """Check points and frames of readings before springs are fitted to them; gross errors are left out.

    :raises MeasurementError: the readings are unusable.
    """
    check_points(data)
    data, outliers = remove_gross_errors(data)  # a gross error would spoil the means that the frames are judged by
    return CheckedPlacement(data, checked_frames(robot, data), outliers)


def remove_gross_errors(data: Measurements) -> tuple[Measurements, list[str]]:
    """Remove readings that contradict their repeats, or the distances between the points of a rigid body.

    :returns: the measurements without these readings; a sentence for each of them.
    :raises MeasurementError: the points move against each other in most sets.
    """
    sigma = max(data.sigma, _robust_sigma(data))
    faulty_rows, sentences = _readings_off_repeats(data, sigma)
    data = data.drop(faulty_rows)
    if len(data.points) >= 3:
        _check_rigid_body(data, sigma)
        faulty_rows, body_sentences = _readings_off_body(data, sigma)
        data, sentences = data.drop(faulty_rows), sentences + body_sentences
    return data, sentences


def _readings_off_repeats(data: Measurements, sigma: float) -> tuple[list[int], list[str]]:
    """Return the rows of readings that are far from the median of their repeats, and a sentence for each.

    Points with fewer than three repeats are not judged, nor points of which half of the repeats or more are far.

    :param sigma: noise of one coordinate [m].
    """
    faulty_rows: list[int] = []
    sentences: list[str] = []
    position = _without_common_change(data)
    for state, point in np.ndindex(len(data.load), len(data.points)):
        rows = np.flatnonzero((data.state == state) & (data.point == point))
        if len(rows) < 3:
            continue
        distances = np.linalg.norm(position[rows] - np.median(position[rows], axis=0), axis=1)
        is_outlier = distances > _GROSS_SIGMAS * _DISTANCE_FACTOR * sigma
        if 0 < np.count_nonzero(is_outlier) < 0.5 * len(rows):
            faulty_rows += rows[is_outlier].tolist()
            sentences += [
                f"{data.name(int(row))} is {distance * MM_PER_M:.2f} mm from its repeats: left out"
                for row, distance in zip(rows[is_outlier], distances[is_outlier], strict=True)
            ]
    return faulty_rows, sentences


def _without_common_change(data: Measurements) -> Array:
    """Return the positions (n, 3) [m]; of displacements, the first repeat without the change that its points share.

    Gears with hysteresis make this change (`return_error`), so it is no gross error. It is the median of the points'
    distances from their later repeats, which a gross error of one point in three does not move.
    """
    position = data.position.copy()
    if data.has_unloaded_readings:
        return position
    is_first = is_first_repeat(data)
    for state in data.loaded_states.tolist():
        is_in_state = data.state == state
        later_rows = [
            np.flatnonzero(is_in_state & ~is_first & (data.point == point)) for point in range(len(data.points))
        ]
        rows = [row for row in np.flatnonzero(is_in_state & is_first).tolist() if len(later_rows[data.point[row]]) > 0]
        if rows:
            changes = [position[row] - np.median(position[later_rows[data.point[row]]], axis=0) for row in rows]
            position[rows] -= np.median(changes, axis=0)
    return position


def _robust_sigma(data: Measurements) -> float:
    """Return the noise of one coordinate from the repeats, insensitive to outliers [m]; 0 without repeats."""
    mean, count = data.means()
    has_repeats = count[data.state, data.point] >= 2
    if not has_repeats.any():
        return 0.0
    deviation = (data.position - mean[data.state, data.point])[has_repeats]
    # n repeats deviate from their mean by less than from the true value
    shrinkage = np.sqrt(1.0 - 1.0 / np.median(count[count >= 2]))
    return float(np.median(np.abs(deviation)) / _MEDIAN_SIZE / shrinkage)


def _check_rigid_body(data: Measurements, sigma: float) -> None:
    """Check that the points keep their distances in most sets of readings under load, as points of a rigid body do.

    Fewer than three sets under load are not judged.

    :param sigma: noise of one coordinate [m].
    :raises MeasurementError: they do not: markers are loose, or displacements are in other axes.
    """
    sets = _complete_sets(data)
    is_loaded = np.array([data.load[data.state[rows[0]]] > 0 for rows in sets], dtype=bool)
    if np.count_nonzero(is_loaded) < 3:
        return
    usual_change = float(np.median(_distance_errors(data, sets).max(axis=(1, 2))[is_loaded]))
    if usual_change > max(_LOOSE_CHANGE, _USUAL_CHANGE_SIGMAS * sigma):
        raise MeasurementError(
            f"the distances between the points change by {usual_change * MM_PER_M:.2f} mm or more under half of the "
            "loads: this is no rigid body",
            file=data.file,
            advice="Check that the markers are tight. Displacements must be in the axes of the robot root ($ROBROOT).",
        )


def _readings_off_body(data: Measurements, sigma: float) -> tuple[list[int], list[str]]:
    """Return the rows of readings whose distances to the other points of their set are wrong, and a sentence for each.

    At most one reading of a set is named: the distances between the other points must be right. Fewer than three sets
    are not judged.

    :param sigma: noise of one coordinate [m].
    """
    sets = _complete_sets(data)
    if len(sets) < 3:
        return [], []
    faulty_rows, sentences = [], []
    limit = _GROSS_SIGMAS * np.sqrt(2.0) * sigma  # a distance has the noise of two points
    for rows, set_errors in zip(sets, _distance_errors(data, sets), strict=True):
        worst = int(np.argmax(set_errors.sum(axis=1)))
        other_errors = np.delete(np.delete(set_errors, worst, axis=0), worst, axis=1)
        if set_errors[worst].max() > limit and other_errors.max() <= limit:
            row = int(rows[worst])
            faulty_rows.append(row)
            sentences.append(
                f"{data.name(row)} is {set_errors[worst].max() * MM_PER_M:.2f} mm off in its distance to the other "
                "points: left out"
            )
    return faulty_rows, sentences


def _distance_errors(data: Measurements, sets: list[Ints]) -> Array:
    """Return the absolute errors (S, P, P) [m] of the distances between the points of S sets, against their medians.

    :param sets: rows (P,) of the readings of each set.
    """
    distances = np.array([_distances(data.position[rows]) for rows in sets])
    return np.asarray(np.abs(distances - np.median(distances, axis=0)))


def _complete_sets(data: Measurements) -> list[Ints]:
    """Return the rows (P,) of readings, in the order of the points, of each set that has all P points.

    A set is one repeat of one state; readings that were left out do not count.
    """
    sets = []
    for state in range(len(data.load)):
        for repeat in np.unique(data.repeat[data.state == state]):
            rows = np.flatnonzero((data.state == state) & (data.repeat == repeat) & data.used)
            if len(rows) == len(data.points):
                sets.append(rows[np.argsort(data.point[rows])])
    return sets


def remove_worst_residual(data: Measurements, placement: Placement, fit: Fit) -> tuple[Measurements, list[str]]:
    """Remove the reading with the largest residual of a fit if it is a gross error.

    A residual is gross if it exceeds `_GROSS_SIGMAS` standard deviations, of the noise and of the usual residuals.

    :returns: the measurements without this reading, or without all its repeats if they agree; a sentence for each
        reading that was removed. Both are unchanged and empty without a gross error.
    """
    white = whiten(whitening(data), fit.residual)
    size = np.linalg.norm(white, axis=2)
    sigma = float(np.median(np.abs(white))) / _MEDIAN_SIZE
    row, point = (int(index) for index in np.unravel_index(int(np.argmax(size)), size.shape))
    limit = _GROSS_SIGMAS * max(1.0, sigma)
    if size[row, point] <= limit * _MAXIMUM_FACTOR:
        return data, []
    residual, state = fit.residual[row, point], int(data.loaded_states[row])
    config, error = int(data.state_config[state]), float(np.linalg.norm(residual))
    is_common = _is_common_to_loads(data, size[:, point] > limit, state)
    # the displacement is a difference: either of its two readings may be wrong
    is_unloaded_wrong = is_common or _is_unloaded_wrong(placement, config, point, error)
    wrong_state = int(data.unloaded_states[config]) if is_unloaded_wrong else state
    candidates = np.flatnonzero((data.state == wrong_state) & (data.point == point) & data.used)
    wrong_rows = _worst_repeat(data, candidates, residual, placement, has_load=not is_unloaded_wrong)
    sentences = [
        f"{data.name(reading)} is {error * MM_PER_M:.2f} mm from what the model predicts: left out"
        for reading in wrong_rows
    ]
    return data.drop(wrong_rows), sentences


def _is_common_to_loads(data: Measurements, is_gross: Bools, state: int) -> bool:
    """Return whether the configuration of a state has several loads, and a gross residual under all of them.

    :param is_gross: (L,) whether the residual of the point is gross in each loaded state.
    """
    is_of_config = data.state_config[data.loaded_states] == data.state_config[state]
    return bool(np.count_nonzero(is_of_config) > 1 and is_gross[is_of_config].all())


def _is_unloaded_wrong(placement: Placement, config: int, point: int, gross: float) -> bool:
    """Return whether the reading of a point without load, rather than its reading under load, has a gross error.

    It has if its distance from the geometry exceeds half of the error, and three times the median distance of the
    point in all configurations.

    :param config: index of the configuration, and `point` index of the point.
    :param gross: size of the error [m].
    """
    deviation = placement.residual[:, point] - np.median(placement.residual[:, point], axis=0)
    distance = np.linalg.norm(deviation, axis=1)
    return bool(distance[config] > max(0.5 * gross, 3.0 * float(np.median(distance))))


def _worst_repeat(data: Measurements, rows: Ints, residual: Array, placement: Placement, has_load: bool) -> list[int]:
    """Return the rows of the repeats with an error: the repeat farthest in its direction, or all if the repeats agree.

    :param rows: of the repeats, readings of one point in one state; at least one.
    :param residual: (3,) measured minus predicted displacement of the point, root axes [m].
    :param has_load: whether the state is loaded. The error has the direction of the residual then, else the opposite
        direction.
    """
    if len(rows) == 1:
        return [int(rows[0])]
    direction = placement.root_in_device[:3, :3] @ (residual / np.linalg.norm(residual)) * (1.0 if has_load else -1.0)
    projection = (data.position[rows] - data.position[rows].mean(axis=0)) @ direction
    if np.ptp(projection) > _GROSS_SIGMAS * data.sigma:
        return [int(rows[np.argmax(projection)])]
    return [int(row) for row in rows]


_SWAP_SHARE = 0.2
"""Share of the change of distances that remains, at most, once swapped names are put right (assumed)."""
_MIN_DISTANCE_CHANGE = 2e-3
"""Change of the distance between two points of one rigid body [m] that exceeds any noise (assumed)."""
_MAX_DISTANCE = 0.015
"""Distance [m] of unloaded readings from the geometry that no sag and no tolerance explains (assumed)."""
_MOST_DEFLECTION = 0.1
"""Displacement by a load [m] beyond that of any industrial robot (assumed)."""
_LOOSE_CHANGE = 2e-4
"""Usual change of distances between points [m] beyond which readings are no noise of a tracker (assumed)."""
_USUAL_CHANGE_SIGMAS = 4.0
"""Usual change of distances, in standard deviations of a coordinate, beyond which readings are no noise: the largest
change of three distances is usually two standard deviations."""
_SAME_UNIT_RATIOS = (0.2, 5.0)
"""Ratios of displacements to those of the prior robot that compliances explain (assumed); another unit does not."""
_USUAL_RATIOS = (0.6, 1.7)
"""Ratio of displacements to those of the prior robot outside which the scale of the forces is doubtful (assumed)."""
_OPPOSITE_COSINE = -0.7
"""Cosine between displacement and expectation below which a force has the wrong sign."""
_KILOGRAMS = (6.0, 16.0)
"""Ratios around 9.8, the weight [N] of a kilogram, with compliances that differ by the factor 1.6."""


def check_points(data: Measurements) -> None:
    """Check that no set of readings (one state, one repeat) fits only if the names of points are swapped.

    :raises MeasurementError: a set does; the message names the points and the line of the set.
    """
    count = len(data.points)
    sets = _complete_sets(data)
    if count < 2 or not sets:
        return
    distances = np.array([_distances(data.position[rows]) for rows in sets])
    median_distances = np.median(distances, axis=0)
    for rows, set_distances in zip(sets, distances, strict=True):
        largest_change = float(np.abs(set_distances - median_distances).max())
        if largest_change <= _MIN_DISTANCE_CHANGE:
            continue
        for order in permutations(range(count)):
            swapped_change = np.abs(set_distances[np.ix_(order, order)] - median_distances).max()
            if list(order) != list(range(count)) and swapped_change < _SWAP_SHARE * largest_change:
                swapped_names = [data.points[index] for index in range(count) if order[index] != index]
                # of the name of a reading without the line before, and without the point behind
                set_name = data.name(int(rows[0])).partition(": ")[2].rpartition(",")[0]
                raise MeasurementError(
                    f"{set_name}: the distances between the "
                    f"points fit only if the names {' and '.join(swapped_names)} are swapped",
                    file=data.file,
                    line=int(data.line[rows[0]]),
                    advice="Correct the names in this set.",
                )


def _distances(points: Array) -> Array:
    """Return the distances (n, n) between all pairs of points (n, 3) [m]."""
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=2))


def checked_frames(robot: RobotModel, data: Measurements) -> Placement:
    """Return the placement that the readings without load show, after checks that they fit the robot's geometry.

    :raises MeasurementError: one configuration has wrong angles, the tracker was moved, or it is another robot.
    """
    placement = locate(robot, data)
    design = unloaded_design(robot, data, placement)
    _, reading_count = data.means()
    # the mean of n readings has the noise σ/√n; a weight for each of the three coordinates of a point
    weight = np.sqrt(reading_count[data.unloaded_states]).repeat(3, axis=1)
    weighted_design = weight[..., None] * design.reshape(*weight.shape, -1)
    no_prior = np.empty((0, design.shape[-1]))
    check_configurations(robot, data, placement, weighted_design, no_prior, weight)
    if placement.rms >= _MAX_DISTANCE:
        _refuse_positions(robot, data, placement.rms)
    return placement


def _refuse_positions(robot: RobotModel, data: Measurements, placement_rms: float) -> NoReturn:
    """Raise an error on readings without load that do not fit the robot's geometry, with the likeliest cause.

    The causes in their order: one wrong configuration, a moved tracker, another unit or robot.

    :param placement_rms: RMS distance of the readings from the geometry [m].
    :raises MeasurementError: always.
    """
    size = len(data.q)
    # one wrong configuration of a few first: readings of one point at a few configurations fit any frame
    reduced_rms = np.array([_rms(robot, data, np.delete(np.arange(size), row)) for row in range(size)])
    worst = int(np.argmin(reduced_rms))
    if reduced_rms[worst] < _MAX_DISTANCE:
        raise MeasurementError(
            f"config {data.config[worst]:g}: the readings without load are far from the points that A1…A6 predict",
            file=data.file,
            line=data.first_line(worst),
            advice="Check its angles (degrees, KUKA signs) and its readings, or leave it out.",
        )
    if (split := _frame_change(robot, data)) is not None:
        raise MeasurementError(
            f"readings from config {data.config[split]:g} on are in another frame of the measuring device",
            file=data.file,
            line=data.first_line(split),
            advice="The tracker was moved or set up anew: identify from one set-up, or bring both into one frame.",
        )
    raise MeasurementError(
        f"the readings without load are {placement_rms * MM_PER_M:.0f} mm (RMS) off the geometry of {robot.name}",
        file=data.file,
        advice=_advice_on_positions(robot, data),
    )


_INCH = 25.4e-3
"""An inch [m]."""


def _advice_on_positions(robot: RobotModel, data: Measurements) -> str:
    """Return advice if readings without load do not fit the robot: on the unit, on a mirror, else on the robot."""
    mean, _ = data.means()
    # distances of the points from the first point, as read and as stated
    measured_sizes, stated_sizes = (
        np.linalg.norm(points[..., 1:, :] - points[..., :1, :], axis=-1)
        for points in (mean[data.unloaded_states], data.guess[None])
    )
    inch_scale = M_PER_MM / _INCH  # inches that were read as mm
    if len(data.points) > 1 and abs(np.nanmedian(measured_sizes / stated_sizes) / inch_scale - 1.0) < _SAME_SCALE:
        return "The points are as far apart as if X, Y, Z were in inch: give them in mm."
    mirrored_data = replace(data, position=data.position * np.array([1.0, 1.0, -1.0]))
    if _rms(robot, mirrored_data, np.arange(len(data.q))) < _MAX_DISTANCE:
        return "They fit in a mirror: the axes of the measuring device are left-handed. Exchange two, or negate one."
    return "Check the robot named in the experiment, the signs of A1…A6 and the guesses of the points."


_SAME_SCALE = 0.2
"""Relative difference of a scale that stated distances of points leave: they are measured by a ruler (assumed)."""


def _frame_change(robot: RobotModel, data: Measurements) -> int | None:
    """Return the index of the configuration from which on the device has another frame; None if no split fits.

    Of all splits into two parts that both fit the geometry alone, it has the least sum of squares. After a small move
    several splits fit: a configuration on the wrong side adds little to the residual of its part.
    """
    size = len(data.q)
    rms = {
        split: np.array([_rms(robot, data, np.arange(split)), _rms(robot, data, np.arange(split, size))])
        for split in range(2, size - 1)
    }
    square_sum = {
        split: float(part_rms**2 @ [split, size - split])
        for split, part_rms in rms.items()
        if part_rms.max() < _MAX_DISTANCE
    }
    return min(square_sum, key=lambda split: square_sum[split], default=None)


def _rms(robot: RobotModel, data: Measurements, rows: Ints) -> float:
    """Return the RMS residual [m] of the points in a fit of frame and points to some configurations.

    Infinite if these configurations do not determine frame and points.

    :param rows: indices of the configurations.
    """
    try:
        return locate(robot, data.take_configurations(rows)).rms
    except (PostprocError, np.linalg.LinAlgError):
        return np.inf


def check_loads(robot: RobotModel, data: Measurements, placement: Placement, advice: str = "") -> list[str]:
    """Check units and signs of the forces: compare displacements with those of the prior robot.

    :param advice: addition to the advice of the error on a single load; may be empty.
    :returns: a warning if all displacements are larger or smaller than on any robot of this kind; else none.
    :raises MeasurementError: all forces, or the force of one configuration, do not belong to the displacements.
    """
    size = np.linalg.norm(measured_displacements(data, placement), axis=2).max(axis=1)
    too_large = np.flatnonzero(size > _MOST_DEFLECTION)
    if len(too_large):
        row = int(too_large[0])
        state = int(data.loaded_states[row])
        raise MeasurementError(
            f"{_state_name(data, state)}: the points moved by {size[row] * MM_PER_M:.0f} mm under load",
            file=data.file,
            line=_first_line(data, state),
            advice="No robot bends that far: was the tracker moved, or is a reading of another configuration?",
        )
    displacement, prediction, rows = _visible_displacements(robot, data, placement)
    ratio = _ratios(displacement, prediction)
    median_ratio = float(np.median(ratio))
    # two ratios, along the expected direction and by length: if links deflect unlike the joints, only one is far off
    length_ratio = np.sqrt(np.sum(displacement**2, axis=(1, 2)) / np.sum(prediction**2, axis=(1, 2)))
    _check_median_ratios(median_ratio, float(np.median(length_ratio)), data, robot.name)
    # a point moves against the force only if nearly opposite: links may deflect across the motion by the joints
    length_ratio = np.where(ratio < _OPPOSITE_COSINE * length_ratio, -length_ratio, length_ratio)
    states = data.loaded_states[rows]
    # 1e-9 N keeps zero out of the denominator
    _check_single_loads(
        data,
        states,
        ratio=ratio / median_ratio,
        length_ratio=length_ratio / median_ratio,
        per_newton=size[rows] / np.maximum(np.linalg.norm(data.wrench[states, :3], axis=1), 1e-9),
        advice=advice,
    )
    if _USUAL_RATIOS[0] < median_ratio < _USUAL_RATIOS[1]:
        return []
    return [
        f"all points move {median_ratio:.1f} times as far as {robot.name} would under these loads: check the scale of "
        "the forces. Loads that are all wrong by a factor make all compliances wrong by it, and no residual shows it."
    ]


def _check_median_ratios(median_ratio: float, median_length_ratio: float, data: Measurements, robot_name: str) -> None:
    """Check sign, axes and unit of the forces by the usual ratios of displacements to those of the prior robot.

    :param median_ratio: ratio along the expected direction, median over the load cases.
    :param median_length_ratio: ratio of the lengths, median over the load cases.
    :raises MeasurementError: points move against the forces or across them, or forces are in another unit.
    """
    if median_ratio < 0.0:
        raise MeasurementError(
            "the points move against the forces",
            file=data.file,
            advice="F is the force ON the tool, root axes: a hanging weight has Fz < 0.",
        )
    if median_ratio < _SAME_UNIT_RATIOS[0] < median_length_ratio < _SAME_UNIT_RATIOS[1]:
        raise MeasurementError(
            f"the points move {median_length_ratio:.2g} times as far as {robot_name} would, but in other directions",
            file=data.file,
            advice="Give F and M in the axes of the robot root ($ROBROOT), and displacements too; check the angles.",
        )
    if not _SAME_UNIT_RATIOS[0] < median_ratio < _SAME_UNIT_RATIOS[1]:
        unit = "kg" if _KILOGRAMS[0] < median_ratio < _KILOGRAMS[1] else "another unit than N"
        raise MeasurementError(
            f"the points move {median_ratio:.2g} times as far as {robot_name} would: the forces look like {unit}",
            file=data.file,
            advice="Give Fx, Fy, Fz in N, Mx, My, Mz in N·m, X, Y, Z in mm.",
        )


def _check_single_loads(
    data: Measurements, states: Ints, *, ratio: Array, length_ratio: Array, per_newton: Array, advice: str
) -> None:
    """Check that the displacement of each load case fits its force as in the other load cases.

    :param states: (n,) loaded states, the load cases.
    :param ratio: (n,) displacements over predicted displacements, along the predicted direction, relative to the
        median.
    :param length_ratio: (n,) length of displacements over length of predicted ones, relative to the median of `ratio`;
        negative for motions against the force.
    :param per_newton: (n,) largest displacements of the points by force [m/N].
    :param advice: addition to the advice of the error; may be empty.
    :raises MeasurementError: a load case does not fit.
    """
    for row, (by_displacement, by_length) in enumerate(zip(ratio, length_ratio, strict=True)):
        other_cases = np.delete(per_newton, row)
        # where joints hardly deflect, links may deflect many times as much: the motion per newton is then a usual one
        if by_length > 0.0 and len(other_cases) and other_cases.min() < per_newton[row] < other_cases.max():
            continue
        if not any(_SAME_UNIT_RATIOS[0] < factor < _SAME_UNIT_RATIOS[1] for factor in (by_length, by_displacement)):
            state = int(states[row])
            unit = "kg" if _KILOGRAMS[0] < by_length < _KILOGRAMS[1] else "another unit, direction or configuration"
            raise MeasurementError(
                f"{_state_name(data, state)}: displacement and force do not belong together "
                f"({by_length:.2g} times the usual ratio): the force looks like {unit}",
                file=data.file,
                line=_first_line(data, state),
                advice="Give forces in N, root axes, for this load case." + advice,
            )


def displacement_ratio(robot: RobotModel, data: Measurements, placement: Placement) -> float:
    """Return the ratio of measured displacements to displacements by a robot's joint springs, median over the loads."""
    displacement, prediction, _ = _visible_displacements(robot, data, placement)
    return float(np.median(_ratios(displacement, prediction)))


class _VisibleDisplacements(NamedTuple):
    """Displacements of points in the n loaded states with readings; 0 for points without readings.

    :param measured: (n, P, 3) root axes [m].
    :param predicted: (n, P, 3) by the joint springs of a robot, root axes [m].
    :param rows: (n,) positions of these states among the loaded states.
    """

    measured: Array
    predicted: Array
    rows: Ints


def _visible_displacements(robot: RobotModel, data: Measurements, placement: Placement) -> _VisibleDisplacements:
    """Return measured displacements, and displacements by a robot's joint springs, of states with readings."""
    structure, visibility = Structure(JOINT_COMPLIANCES, robot), visible_points(data)
    rows = np.flatnonzero(visibility.any(axis=(1, 2)))
    prediction, _ = predict(structure, structure.start_values(), data, placement)
    return _VisibleDisplacements(measured_displacements(data, placement)[rows], (prediction * visibility)[rows], rows)


def _ratios(displacement: Array, prediction: Array) -> Array:
    """Return the ratios (n,) of displacements (n, P, 3) to predicted ones (n, P, 3), by projection on the latter."""
    return np.asarray(np.sum(displacement * prediction, axis=(1, 2)) / np.sum(prediction**2, axis=(1, 2)))


def _state_name(data: Measurements, state: int) -> str:
    """Return the configuration and load of a state as messages name them."""
    return f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}"


def _first_line(data: Measurements, state: int) -> int:
    """Return the first line of the file with readings of a state."""
    return int(data.line[np.flatnonzero(data.state == state)[0]])


_SAME_LOAD_TOLERANCE, _LARGER_LOAD_RATIO = 0.02, 1.2
"""Relative difference below which two loads are equal, and ratio from which a load is larger."""
_MIN_TORQUE_SHARE = 0.05
"""Share of the largest torque on a joint above which the flank of its gear is known."""
_CERTAIN_ERRORS = 4.0
"""Standard errors beyond which a loop is no noise."""
_MIN_LOOP = 1e-5
"""Smallest half width of a loop [rad] that is reported (assumed)."""


def hysteresis_warnings(robot: RobotModel, data: Measurements, placement: Placement) -> list[str]:
    """Return a sentence for each joint with hysteresis; empty if no load was measured before and after a larger one.

    Under the same load, the displacement after a larger load differs from the displacement before it: by twice the
    half width of each joint's loop, in the direction of its torque. The widths ≥ 0 are fitted by least squares.
    """
    from scipy.optimize import nnls  # takes long to import

    design, target = _loop_equations(robot, data, placement)
    if len(target) == 0:
        return []
    scale = norm(design.T)  # of the columns; zero for joints without torque
    joints = np.flatnonzero(scale > 0.0)
    scaled_design = design[:, joints] / scale[joints]
    solution, _ = nnls(scaled_design, target)
    variance = np.diag(np.linalg.pinv(scaled_design.T @ scaled_design))
    is_certain = solution > _CERTAIN_ERRORS * np.sqrt(variance)
    half_width = 0.5 * solution / scale[joints]
    return [
        f"loads up and down differ: looks like {half_width[row] * MM_PER_M:.3f} mrad of backlash or friction in "
        f"{JOINTS[joint]}"
        for row, joint in enumerate(joints.tolist())
        if is_certain[row] and half_width[row] > _MIN_LOOP
    ]


def _loop_equations(robot: RobotModel, data: Measurements, placement: Placement) -> tuple[Array, Array]:
    """Return whitened equations for the widths of the joints' loops: design (r, 6) [1/rad], and right side (r,).

    An equation is for a coordinate of a point: the right side is its displacement under a load after a larger load,
    less its displacement before. No equations if no load was measured before and after a larger one.
    """
    start_rows, end_rows = load_loops(data)
    displacement, visibility = measured_displacements(data, placement), visible_points(data)[..., 0]
    is_visible = (visibility[start_rows] * visibility[end_rows]).astype(bool)
    _, reading_counts = data.means()
    count = np.maximum(reading_counts[data.loaded_states], 1.0)
    noise = data.sigma * np.sqrt(1.0 / count[start_rows] + 1.0 / count[end_rows])
    columns = _motions_by_loops(robot, data, placement, start_rows)
    design = (columns / noise[..., None, None])[is_visible].reshape(-1, 6)
    return design, ((displacement[end_rows] - displacement[start_rows]) / noise[..., None])[is_visible].ravel()


def _motions_by_loops(robot: RobotModel, data: Measurements, placement: Placement, states: Ints) -> Array:
    """Return the motions (n, P, 3, 6) of the points per radian of each joint in the direction of its torque [m/rad].

    Zero for joints with so little torque that the flank of their gear is not known.

    :param states: (n,) positions among the loaded states.
    """
    torque = joint_torques(robot, data)
    direction = np.sign(torque[states]) * (np.abs(torque[states]) > _MIN_TORQUE_SHARE * np.abs(torque).max(axis=0))
    x = elastostatics.coordinates(robot, data.q[data.state_config[data.loaded_states[states]]])
    motions = np.empty((len(states), len(placement.points), 3, 6))
    for index, point in enumerate(placement.points):
        tool = np.eye(4)
        tool[:3, 3] = point
        _, jacobian = kinematics.tcp(robot.actual, x, tool)
        motions[:, index] = jacobian[:, :3, list(robot.actuated)] * direction[:, None]
    return motions


def load_loops(data: Measurements) -> tuple[Ints, Ints]:
    """Return pairs of loaded states with the same load of a configuration, before and after a larger load.

    :returns: positions among the loaded states: (m,) before the larger load, and (m,) after it.
    """
    load, config = data.wrench[data.loaded_states], data.state_config[data.loaded_states]
    number, size = data.load[data.loaded_states], norm(load)  # loads are numbered in the order of the measurements
    pairs: list[tuple[int, int]] = []
    for first in range(len(load)):
        is_same_load = norm(load[first] - load) < _SAME_LOAD_TOLERANCE * size[first]
        for second in np.flatnonzero(is_same_load & (config == config[first]) & (number > number[first])).tolist():
            if _has_larger_load(size, number, config, first, second):
                pairs.append((first, second))
    start_rows, end_rows = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return start_rows, end_rows


def _has_larger_load(size: Array, number: Array, config: Ints, first: int, second: int) -> bool:
    """Return whether a larger load was applied between two loaded states of a configuration.

    :param size: (L,) size of the load of each loaded state [N, N·m].
    :param number: (L,) number of the load, in the order of the measurements.
    :param config: (L,) index of the configuration.
    :param first: position of a state among the loaded states, and `second` of a later state.
    """
    rows = (config == config[first]) & (number > number[first]) & (number < number[second])
    return bool((size[rows] > _LARGER_LOAD_RATIO * size[first]).any())
