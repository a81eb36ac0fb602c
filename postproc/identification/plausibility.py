"""Checks that need the robot: swapped points, a moved tracker, wrong angles, forces in kg or with the wrong sign."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from postproc.errors import MeasurementError, PostprocError
from postproc.frames import MM_PER_M, Array
from postproc.identification.displacements import measured_displacements
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement, locate
from postproc.identification.prediction import predict
from postproc.identification.structure import Structure
from postproc.program import Ints
from postproc.robot import JOINT_COMPLIANCES, RobotModel

_BODY = 2e-3
"""Change of the distance between two points of one rigid body [m] that is no noise."""
_FAR = 0.015
"""Distance [m] of unloaded readings from the geometry that no sag and no tolerance explains."""
_MOST_DEFLECTION = 0.1
_SAME_UNIT = (0.2, 5.0)
_OPPOSITE = -0.7
"""Cosine between displacement and expectation below which a force has the wrong sign."""
_KILOGRAMS = (6.0, 16.0)


def check_points(data: Measurements) -> None:
    """Refuse sets of readings (one state, one repeat) in which two points carry each other's name.

    :raises MeasurementError: names the rows.
    """
    count = len(data.points)
    if count < 2:
        return
    sets: dict[tuple[int, float], Ints] = {}
    for state in range(len(data.load)):
        for repeat in np.unique(data.repeat[data.state == state]):
            rows = np.flatnonzero((data.state == state) & (data.repeat == repeat))
            sets[state, float(repeat)] = rows[np.argsort(data.point[rows])]
    apart = np.array([_distances(data.position[rows]) for rows in sets.values()])
    usual = np.median(apart, axis=0)
    for rows, here in zip(sets.values(), apart, strict=True):
        wrong = float(np.abs(here - usual).max())
        if wrong <= _BODY:
            continue
        for order in permutations(range(count)):
            if list(order) != list(range(count)) and np.abs(here[np.ix_(order, order)] - usual).max() < 0.2 * wrong:
                moved = [data.points[index] for index in range(count) if order[index] != index]
                raise MeasurementError(
                    f"{data.name(int(rows[0])).partition(': ')[2].rpartition(',')[0]}: the distances between the "
                    f"points fit only if the names {' and '.join(moved)} are swapped",
                    file=data.file,
                    line=int(data.line[rows[0]]),
                    advice="Correct the names in this set.",
                )


def _distances(points: Array) -> Array:
    return np.asarray(np.linalg.norm(points[:, None] - points[None], axis=2))


def check_frames(robot: RobotModel, data: Measurements) -> Placement:
    """Return the placement, or say why the unloaded readings do not fit the robot's geometry.

    :raises MeasurementError: one configuration has wrong angles, the tracker was moved, or it is another robot.
    """
    placement = locate(robot, data)
    if placement.rms < _FAR:
        return placement
    size = len(data.q)
    for split in range(2, size - 1):
        halves = [_rms(robot, data, np.arange(split)), _rms(robot, data, np.arange(split, size))]
        if max(halves) < _FAR:
            first = np.flatnonzero(data.state_config[data.state] == split)[0]
            raise MeasurementError(
                f"readings from config {data.config[split]:g} on are in another frame of the measuring device",
                file=data.file,
                line=int(data.line[first]),
                advice="The tracker was moved or set up anew: identify from one set-up, or bring both into one frame.",
            )
    without = np.array([_rms(robot, data, np.delete(np.arange(size), row)) for row in range(size)])
    worst = int(np.argmin(without))
    if without[worst] < _FAR:
        first = np.flatnonzero(data.state_config[data.state] == worst)[0]
        raise MeasurementError(
            f"config {data.config[worst]:g}: the readings without load are far from the points that A1…A6 predict",
            file=data.file,
            line=int(data.line[first]),
            advice="Check its angles (degrees, KUKA signs) and its readings, or leave it out.",
        )
    raise MeasurementError(
        f"the readings without load are {placement.rms * MM_PER_M:.0f} mm (RMS) off the geometry of {robot.name}",
        file=data.file,
        advice="Check the robot named in the experiment, the signs of A1…A6 and the guesses of the points.",
    )


def _rms(robot: RobotModel, data: Measurements, rows: Ints) -> float:
    try:
        return locate(robot, data.only(rows)).rms
    except (PostprocError, np.linalg.LinAlgError):
        return np.inf


def check_loads(robot: RobotModel, data: Measurements, placement: Placement) -> None:
    """Compare displacements with what the prior robot would show: units and signs of the forces.

    :raises MeasurementError: names the configuration, or all.
    """
    seen = measured_displacements(data, placement)
    size = np.linalg.norm(seen, axis=2).max(axis=1)
    for row in np.flatnonzero(size > _MOST_DEFLECTION).tolist():
        raise MeasurementError(
            f"{_state_name(data, int(data.loaded[row]))}: the points moved by {size[row] * MM_PER_M:.0f} mm under load",
            file=data.file,
            line=_first_line(data, int(data.loaded[row])),
            advice="No robot bends that far: was the tracker moved, or is a reading of another configuration?",
        )
    structure = Structure(JOINT_COMPLIANCES, robot)
    expected, _ = predict(structure, structure.start(), data, placement)
    ratio = np.sum(seen * expected, axis=(1, 2)) / np.sum(expected**2, axis=(1, 2))
    usual = float(np.median(ratio))
    if usual < 0.0:
        raise MeasurementError(
            "the points move against the forces",
            file=data.file,
            advice="F is the force ON the tool, root axes: a hanging weight has Fz < 0.",
        )
    if not _SAME_UNIT[0] < usual < _SAME_UNIT[1]:
        unit = "kg" if _KILOGRAMS[0] < usual < _KILOGRAMS[1] else "another unit than N"
        raise MeasurementError(
            f"the points move {usual:.2g} times as far as {robot.name} would: the forces look like {unit}",
            file=data.file,
            advice="Give Fx, Fy, Fz in N, Mx, My, Mz in N·m, X, Y, Z in mm.",
        )
    # along the expected direction and by size: where links deflect other than the joints, one of the two is far off
    far = np.sqrt(np.sum(seen**2, axis=(1, 2)) / np.sum(expected**2, axis=(1, 2)))
    # against the force only if it is nearly opposite: links may deflect across what the joints would
    far = np.where(ratio < _OPPOSITE * far, -far, far)
    # deflection per newton: where the joints would hardly deflect, links may deflect by many times as much
    softness = size / np.maximum(np.linalg.norm(data.wrench[data.loaded, :3], axis=1), 1e-9)
    for row in range(len(ratio)):
        relative = far[row] / usual
        others = np.delete(softness, row)
        if relative > 0.0 and len(others) and others.min() < softness[row] < others.max():
            continue
        if not any(_SAME_UNIT[0] < each < _SAME_UNIT[1] for each in (relative, ratio[row] / usual)):
            state = int(data.loaded[row])
            unit = "kg" if _KILOGRAMS[0] < relative < _KILOGRAMS[1] else "another unit, direction or configuration"
            raise MeasurementError(
                f"{_state_name(data, state)}: displacement and force do not belong together "
                f"({relative:.2g} times the usual ratio): the force looks like {unit}",
                file=data.file,
                line=_first_line(data, state),
                advice="Give forces in N, root axes, for this load case.",
            )


def _state_name(data: Measurements, state: int) -> str:
    return f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}"


def _first_line(data: Measurements, state: int) -> int:
    return int(data.line[np.flatnonzero(data.state == state)[0]])
