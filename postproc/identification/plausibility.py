"""Plausibility of readings: gross errors, swapped names, a moved tracker, wrong units and signs of forces, hysteresis.

Single gross errors are left out and listed: first without a model, against the other repeats and against the distances
between points of one rigid body; then, in a fit that is good but for a few points, against the model. Errors of whole
sets (names, frames, angles, forces) are refused with their line.

Hysteresis: loads that are applied on the way up and again on the way down show the backlash and friction of each joint.
"""

from __future__ import annotations

from itertools import permutations

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
    visible,
    whiten,
    whitening,
)
from postproc.identification.outlying_configuration import check_configurations
from postproc.identification.readings import Measurements
from postproc.program import Ints
from postproc.robot import JOINT_COMPLIANCES, JOINTS, RobotModel

_GROSS = 6.0
"""Standard deviations beyond which a reading counts as a gross error."""


def check_placement(robot: RobotModel, data: Measurements) -> tuple[Measurements, Placement, list[str]]:
    """Check points and frames of readings before anything is fitted to them.

    :returns: the readings without gross errors, the placement, and a line for each reading that was left out.
    :raises MeasurementError: the readings are unusable.
    """
    check_points(data)
    data, outliers = remove_gross_errors(data)  # one would spoil the means that are judged next
    return data, check_frames(robot, data), outliers


def remove_gross_errors(data: Measurements) -> tuple[Measurements, list[str]]:
    """Return the measurements without readings that contradict their repeats or the rigid body, and a line for each."""
    lines: list[str] = []
    sigma = max(data.sigma, _robust_sigma(data))
    faulty_rows: list[int] = []
    for state in range(len(data.load)):
        for point in range(len(data.points)):
            rows = np.flatnonzero((data.state == state) & (data.point == point))
            if len(rows) < 3:
                continue
            distances = np.linalg.norm(data.position[rows] - np.median(data.position[rows], axis=0), axis=1)
            outlier_rows = rows[distances > _GROSS * 1.5 * sigma]
            if 0 < len(outlier_rows) < 0.5 * len(rows):
                faulty_rows += outlier_rows.tolist()
                lines += [
                    f"{data.name(int(row))} is {distance * MM_PER_M:.2f} mm from its repeats: left out"
                    for row, distance in zip(outlier_rows, distances[distances > _GROSS * 1.5 * sigma], strict=True)
                ]
    data = data.drop(faulty_rows)
    if len(data.points) >= 3:
        faulty_rows, names = _rigid_body(data, sigma)
        data, lines = data.drop(faulty_rows), lines + names
    return data, lines


def _robust_sigma(data: Measurements) -> float:
    """Return the noise of one coordinate from the repeats, insensitive to outliers [m]."""
    mean, count = data.means()
    has_repeats = count[data.state, data.point] >= 2
    if not has_repeats.any():
        return 0.0
    left = (data.position - mean[data.state, data.point])[has_repeats]
    shrink = np.sqrt(1.0 - 1.0 / np.median(count[count >= 2]))
    return float(np.median(np.abs(left)) / 0.6745 / shrink)


def _rigid_body(data: Measurements, sigma: float) -> tuple[list[int], list[str]]:
    """Return readings with wrong distances to the other points of their set, if the others agree; and a line for
    each.
    """
    faulty_rows, names = [], []
    sets = []
    for state in range(len(data.load)):
        for repeat in np.unique(data.repeat[data.state == state]):
            rows = np.flatnonzero((data.state == state) & (data.repeat == repeat) & data.used)
            if len(rows) == len(data.points):
                sets.append(rows[np.argsort(data.point[rows])])
    if len(sets) < 3:
        return [], []
    position = data.position[np.array(sets)]
    distances = np.linalg.norm(position[:, :, None] - position[:, None], axis=3)
    errors = np.abs(distances - np.median(distances, axis=0))
    limit = _GROSS * np.sqrt(2.0) * sigma
    for rows, set_errors in zip(sets, errors, strict=True):
        fault_counts = (set_errors > limit).sum(axis=1)
        worst = int(np.argmax(set_errors.sum(axis=1)))
        other_errors = np.delete(np.delete(set_errors, worst, axis=0), worst, axis=1)
        if fault_counts[worst] >= 1 and other_errors.max() <= limit:
            row = int(rows[worst])
            faulty_rows.append(row)
            names.append(
                f"{data.name(row)} is {set_errors[worst].max() * MM_PER_M:.2f} mm off in its distance to the other "
                "points: left out"
            )
    return faulty_rows, names


def remove_worst_residual(data: Measurements, placement: Placement, fit: Fit) -> tuple[Measurements, list[str]]:
    """Return the measurements without the reading of the largest residual of a fit if it is a gross error, and its
    line.

    A residual is gross if it exceeds six standard deviations and six times what the others usually are. Whether the
    loaded or the unloaded reading is wrong follows from the unloaded one's distance from the geometry.
    """
    white = whiten(whitening(data), fit.residual)
    size = np.linalg.norm(white, axis=2)
    sigma = float(np.median(np.abs(white))) / 0.6745
    row, point = np.unravel_index(int(np.argmax(size)), size.shape)
    if size[row, point] <= _GROSS * max(1.0, sigma) * 1.3:
        return data, []
    state = int(data.loaded_states[row])
    config = int(data.state_config[state])
    unloaded_state = int(data.unloaded_states[config])
    deviation = placement.residual[:, point] - np.median(placement.residual[:, point], axis=0)
    rest_error = float(np.linalg.norm(deviation[config]))
    rest_usual = float(np.median(np.linalg.norm(deviation, axis=1)))
    load_states = np.flatnonzero((data.state_config == config) & (data.load != 0))
    is_common = len(load_states) > 1 and all(
        size[np.flatnonzero(data.loaded_states == load_state)[0], point] > _GROSS * max(1.0, sigma)
        for load_state in load_states
    )
    gross = float(np.linalg.norm(fit.residual[row, point]))
    culprit = unloaded_state if is_common or rest_error > max(0.5 * gross, 3.0 * rest_usual) else state
    candidates = np.flatnonzero((data.state == culprit) & (data.point == point) & data.used)
    has_worst_repeat = _worst_repeat(data, candidates, fit.residual[row, point], placement, culprit == state)
    names = [
        f"{data.name(int(reading))} is {gross * MM_PER_M:.2f} mm from what the model predicts: left out"
        for reading in has_worst_repeat
    ]
    return data.drop([int(reading) for reading in has_worst_repeat]), names


def _worst_repeat(data: Measurements, rows: Ints, residual: Array, placement: Placement, has_load: bool) -> list[int]:
    """Return the repeats with the error: the one that deviates most in its direction, or all if they agree."""
    if len(rows) == 1:
        return [int(rows[0])]
    direction = placement.root_in_device[:3, :3] @ (residual / np.linalg.norm(residual)) * (1.0 if has_load else -1.0)
    projection = (data.position[rows] - data.position[rows].mean(axis=0)) @ direction
    if np.ptp(projection) > _GROSS * data.sigma:
        return [int(rows[np.argmax(projection)])]
    return [int(row) for row in rows]


_BODY = 2e-3
"""Change of the distance between two points of one rigid body [m] that exceeds any noise (assumed)."""
_MAX_DISTANCE = 0.015
"""Distance [m] of unloaded readings from the geometry that no sag and no tolerance explains (assumed)."""
_MOST_DEFLECTION = 0.1
"""Displacement by a load [m] beyond that of any industrial robot (assumed)."""
_SAME_UNIT = (0.2, 5.0)
"""Ratios of displacements to those of the prior robot that compliances explain (assumed); another unit does not."""
_USUAL_SIZE = (0.6, 1.7)
"""Ratio of displacements to those of the prior robot outside which the scale of the forces is doubtful (assumed)."""
_OPPOSITE = -0.7
"""Cosine between displacement and expectation below which a force has the wrong sign."""
_KILOGRAMS = (6.0, 16.0)
"""Ratios around 9.8, the weight [N] of a kilogram, with compliances that differ by the factor 1.6."""


def check_points(data: Measurements) -> None:
    """Refuse sets of readings (one state, one repeat) in which the names of two points are swapped.

    :raises MeasurementError: names the rows.
    """
    count = len(data.points)
    if count < 2:
        return
    sets: dict[tuple[int, float], Ints] = {}
    for state in range(len(data.load)):
        for repeat in np.unique(data.repeat[data.state == state]):
            rows = np.flatnonzero((data.state == state) & (data.repeat == repeat))
            if len(rows) == count:
                sets[state, float(repeat)] = rows[np.argsort(data.point[rows])]
    if not sets:
        return
    distances = np.array([_distances(data.position[rows]) for rows in sets.values()])
    median_distances = np.median(distances, axis=0)
    for rows, set_distances in zip(sets.values(), distances, strict=True):
        largest_change = float(np.abs(set_distances - median_distances).max())
        if largest_change <= _BODY:
            continue
        for order in permutations(range(count)):
            if (
                list(order) != list(range(count))
                and np.abs(set_distances[np.ix_(order, order)] - median_distances).max() < 0.2 * largest_change
            ):
                swapped_names = [data.points[index] for index in range(count) if order[index] != index]
                raise MeasurementError(
                    f"{data.name(int(rows[0])).partition(': ')[2].rpartition(',')[0]}: the distances between the "
                    f"points fit only if the names {' and '.join(swapped_names)} are swapped",
                    file=data.file,
                    line=int(data.line[rows[0]]),
                    advice="Correct the names in this set.",
                )


def _distances(points: Array) -> Array:
    """Return the distances (n, n) between all pairs of points (n, 3) [m]."""
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=2))


def check_frames(robot: RobotModel, data: Measurements) -> Placement:
    """Return the placement; refuse unloaded readings that do not fit the robot's geometry.

    :raises MeasurementError: one configuration has wrong angles, the tracker was moved, or it is another robot.
    """
    placement = locate(robot, data)
    design = unloaded_design(robot, data, placement)
    weight = np.sqrt(data.means()[1][data.unloaded_states]).repeat(3, axis=1)
    weighted_design = weight[..., None] * design.reshape(*weight.shape, -1)
    no_prior = np.empty((0, design.shape[-1]))
    check_configurations(robot, data, placement, weighted_design, no_prior, weight)
    if placement.rms < _MAX_DISTANCE:
        return placement
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
        f"the readings without load are {placement.rms * MM_PER_M:.0f} mm (RMS) off the geometry of {robot.name}",
        file=data.file,
        advice=_advice_on_positions(robot, data),
    )


_INCH = 25.4e-3
"""An inch [m]."""


def _advice_on_positions(robot: RobotModel, data: Measurements) -> str:
    """Return what to check where readings without load do not fit the robot: unit and axes of the positions first."""
    mean = data.means()[0][data.unloaded_states]
    sizes = [np.linalg.norm(points[..., 1:, :] - points[..., :1, :], axis=-1) for points in (mean, data.guess[None])]
    if len(data.points) > 1 and abs(np.nanmedian(sizes[0] / sizes[1]) / (M_PER_MM / _INCH) - 1.0) < _SAME_SCALE:
        return "The points are as far apart as if X, Y, Z were in inch: give them in mm."
    mirrored = replace(data, position=data.position * np.array([1.0, 1.0, -1.0]))
    if _rms(robot, mirrored, np.arange(len(data.q))) < _MAX_DISTANCE:
        return "They fit in a mirror: the axes of the measuring device are left-handed. Exchange two, or negate one."
    return "Check the robot named in the experiment, the signs of A1…A6 and the guesses of the points."


_SAME_SCALE = 0.2
"""Relative difference of a scale that stated distances of points leave: they are measured by a ruler (assumed)."""


def _frame_change(robot: RobotModel, data: Measurements) -> int | None:
    """Return the configuration from which on readings are best explained by another frame; None if none does.

    After a small move several splits are within the limit: a configuration on the wrong side adds little to its part.
    """
    size = len(data.q)
    rms = {
        split: np.array([_rms(robot, data, np.arange(split)), _rms(robot, data, np.arange(split, size))])
        for split in range(2, size - 1)
    }
    total = {
        split: float(halves**2 @ [split, size - split]) for split, halves in rms.items() if halves.max() < _MAX_DISTANCE
    }
    return min(total, key=lambda split: total[split], default=None)


def _rms(robot: RobotModel, data: Measurements, rows: Ints) -> float:
    """Return the residual RMS [m] of markers that are located by these configurations; inf: they cannot be."""
    try:
        return locate(robot, data.take_configurations(rows)).rms
    except (PostprocError, np.linalg.LinAlgError):
        return np.inf


def check_loads(robot: RobotModel, data: Measurements, placement: Placement, advice: str = "") -> list[str]:
    """Check units and signs of the forces: compare displacements with those of the prior robot.

    :param advice: what else to check where they do not belong together.
    :returns: a warning if all displacements are larger or smaller than any robot of this kind has them.
    :raises MeasurementError: names the configuration, or all.
    """
    size = np.linalg.norm(measured_displacements(data, placement), axis=2).max(axis=1)
    for row in np.flatnonzero(size > _MOST_DEFLECTION).tolist():
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
    if median_ratio < 0.0:
        raise MeasurementError(
            "the points move against the forces",
            file=data.file,
            advice="F is the force ON the tool, root axes: a hanging weight has Fz < 0.",
        )
    if not _SAME_UNIT[0] < median_ratio < _SAME_UNIT[1]:
        unit = "kg" if _KILOGRAMS[0] < median_ratio < _KILOGRAMS[1] else "another unit than N"
        raise MeasurementError(
            f"the points move {median_ratio:.2g} times as far as {robot.name} would: the forces look like {unit}",
            file=data.file,
            advice="Give Fx, Fy, Fz in N, Mx, My, Mz in N·m, X, Y, Z in mm.",
        )
    # two ratios, along the expected direction and by length: where links deflect unlike the joints, one is far off
    length_ratio = np.sqrt(np.sum(displacement**2, axis=(1, 2)) / np.sum(prediction**2, axis=(1, 2)))
    # against the force only if it is nearly opposite: links may deflect across what the joints would
    length_ratio = np.where(ratio < _OPPOSITE * length_ratio, -length_ratio, length_ratio)
    states = data.loaded_states[rows]
    per_newton = size[rows] / np.maximum(np.linalg.norm(data.wrench[states, :3], axis=1), 1e-9)
    _check_single_loads(data, states, ratio / median_ratio, length_ratio / median_ratio, per_newton, advice)
    if _USUAL_SIZE[0] < median_ratio < _USUAL_SIZE[1]:
        return []
    return [
        f"all points move {median_ratio:.1f} times as far as {robot.name} would under these loads: check the scale of "
        "the forces. Loads that are all wrong by a factor make all compliances wrong by it, and no residual shows it."
    ]


def _check_single_loads(
    data: Measurements, states: Ints, ratio: Array, length_ratio: Array, per_newton: Array, advice: str
) -> None:
    """Check that the displacement of each load case fits its force as those of the others do.

    :param states: (n,) load cases.
    :param ratio: (n,) displacements over those of the prior robot, along these, relative to the median.
    :param length_ratio: (n,) the same by length; negative against the force.
    :param per_newton: (n,) largest displacements of the points by force [m/N].
    :raises MeasurementError: one does not.
    """
    for row in range(len(ratio)):
        relative = length_ratio[row]
        other_cases = np.delete(per_newton, row)
        # if the joints would hardly deflect, links may deflect by many times as much: as in other load cases
        if relative > 0.0 and len(other_cases) and other_cases.min() < per_newton[row] < other_cases.max():
            continue
        if not any(_SAME_UNIT[0] < factor < _SAME_UNIT[1] for factor in (relative, ratio[row])):
            state = int(states[row])
            unit = "kg" if _KILOGRAMS[0] < relative < _KILOGRAMS[1] else "another unit, direction or configuration"
            raise MeasurementError(
                f"{_state_name(data, state)}: displacement and force do not belong together "
                f"({relative:.2g} times the usual ratio): the force looks like {unit}",
                file=data.file,
                line=_first_line(data, state),
                advice="Give forces in N, root axes, for this load case." + advice,
            )


def displacement_ratio(robot: RobotModel, data: Measurements, placement: Placement) -> float:
    """Return how many times as far as those of a robot the points moved, median over the loads."""
    displacement, prediction, _ = _visible_displacements(robot, data, placement)
    return float(np.median(_ratios(displacement, prediction)))


def _visible_displacements(robot: RobotModel, data: Measurements, placement: Placement) -> tuple[Array, Array, Ints]:
    """Return displacements (n, P, 3) [m], measured and of a robot's joint springs, and their rows of loaded states."""
    structure, seen = Structure(JOINT_COMPLIANCES, robot), visible(data)
    rows = np.flatnonzero(seen.any(axis=(1, 2)))
    prediction = predict(structure, structure.start(), data, placement)[0] * seen
    return measured_displacements(data, placement)[rows], prediction[rows], rows


def _ratios(displacement: Array, prediction: Array) -> Array:
    """Return the ratios (n,) of displacements (n, P, 3) along predicted ones to these."""
    return np.asarray(np.sum(displacement * prediction, axis=(1, 2)) / np.sum(prediction**2, axis=(1, 2)))


def _state_name(data: Measurements, state: int) -> str:
    """Return the configuration and load of a state as messages name them."""
    return f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}"


def _first_line(data: Measurements, state: int) -> int:
    """Return the first line of the file with readings of a state."""
    return int(data.line[np.flatnonzero(data.state == state)[0]])


_SAME_LOAD, _LARGER = 0.02, 1.2
"""Relative difference below which two loads are equal, and from which one is larger."""
_TORQUE = 0.05
"""Share of the largest torque on a joint above which the flank of its gear is known."""
_CERTAIN = 4.0
"""Standard errors beyond which a loop is no noise."""
_MIN_LOOP = 1e-5
"""Smallest half width of a loop [rad] that is reported (assumed)."""


def loops(robot: RobotModel, data: Measurements, placement: Placement) -> list[str]:
    """Return the hysteresis of each joint in sentences; none if no load was measured before and after a larger one."""
    from scipy.optimize import nnls

    up, down_rows = load_loops(data)
    if len(up) == 0:
        return []
    displacement, visibility = measured_displacements(data, placement), visible(data)[..., 0]
    is_visible = (visibility[up] * visibility[down_rows]).astype(bool)
    count = np.maximum(data.means()[1][data.loaded_states], 1.0)
    noise = data.sigma * np.sqrt(1.0 / count[up] + 1.0 / count[down_rows])
    torque = joint_torques(robot, data)
    flank = np.sign(torque[up]) * (np.abs(torque[up]) > _TORQUE * np.abs(torque).max(axis=0))
    x = elastostatics.coordinates(robot, data.q[data.state_config[data.loaded_states[up]]])
    columns = np.empty((*is_visible.shape, 3, 6))
    for index, point in enumerate(placement.points):
        tool = np.eye(4)
        tool[:3, 3] = point
        jacobian = kinematics.tcp(robot.actual, x, tool)[1][:, :3, list(robot.actuated)]
        columns[:, index] = jacobian * flank[:, None]
    rows = (columns / noise[..., None, None])[is_visible].reshape(-1, 6)
    target = ((displacement[down_rows] - displacement[up]) / noise[..., None])[is_visible].ravel()
    scale = norm(rows.T)
    joints = np.flatnonzero(scale > 0.0)
    solution, _ = nnls(rows[:, joints] / scale[joints], target)
    inverse = np.linalg.pinv((rows[:, joints] / scale[joints]).T @ (rows[:, joints] / scale[joints]))
    clear = solution > _CERTAIN * np.sqrt(np.diag(inverse))
    half = 0.5 * solution / scale[joints]
    return [
        f"loads up and down differ: looks like {half[row] * MM_PER_M:.3f} mrad of backlash or friction in "
        f"{JOINTS[joint]}"
        for row, joint in enumerate(joints.tolist())
        if clear[row] and half[row] > _MIN_LOOP
    ]


def load_loops(data: Measurements) -> tuple[Ints, Ints]:
    """Return pairs of rows of the loaded states: the same load of a configuration before and after a larger one."""
    load, config = data.wrench[data.loaded_states], data.state_config[data.loaded_states]
    number, size = data.load[data.loaded_states], norm(load)
    pairs = [
        (first, second)
        for first in range(len(load))
        for second in np.flatnonzero(config == config[first]).tolist()
        if number[first] < number[second]
        and norm(load[first] - load[second]) < _SAME_LOAD * size[first]
        and _has_larger_load(size, number, config, first, second)
    ]
    up, down_rows = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return up, down_rows


def _has_larger_load(size: Array, number: Array, config: Ints, first: int, second: int) -> bool:
    """Return whether a larger load was applied between two states of a configuration."""
    rows = (config == config[first]) & (number > number[first]) & (number < number[second])
    return bool((size[rows] > _LARGER * size[first]).any())
