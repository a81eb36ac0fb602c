"""`measurements.csv`, read and checked.

Formats: docs/reference. What the numbers alone show is checked here; what needs the robot's
kinematics (swapped points, a moved tracker, forces in kg) in `plausibility`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from postproc import files
from postproc.errors import MeasurementError
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array
from postproc.identification.experiment import Experiment
from postproc.identification.measurements import Measurements
from postproc.program import WRENCH, Ints
from postproc.robot import JOINTS

COLUMNS = (
    *("config", "load", "repeat", "point"),
    *JOINTS,
    *WRENCH,
    *("X", "Y", "Z"),
)
_SAME_ANGLE = 1e-3
_NO_LOAD = 1e-6


def read(path: Path, experiment: Experiment, loads: bool = True) -> Measurements:
    """Read `measurements.csv` and check that it is complete.

    :param loads: False if readings without load are enough (calibration of the geometry).
    :raises MeasurementError: a reading is missing, given twice, not a number, belongs to a point that the
        experiment does not name; a loaded state without its unloaded one; angles in radians, lengths not in mm.
    """
    numbers, texts, lines = files.read_csv(path, COLUMNS, (), MeasurementError, ("point",))
    where = str(path)
    if len(lines) == 0:
        raise MeasurementError("no readings", file=where)
    names = tuple(experiment.points)
    for row, name in enumerate(texts["point"]):
        if name not in names:
            raise MeasurementError(
                f"unknown point {name!r}",
                file=where,
                line=int(lines[row]),
                advice=f"The experiment names {', '.join(names)}.",
            )
    angles = np.column_stack([numbers[name] for name in JOINTS])
    wrench = np.column_stack([numbers[name] for name in WRENCH])
    config, inverse = np.unique(numbers["config"], return_inverse=True)
    pairs, first, state = np.unique(
        np.column_stack([inverse, numbers["load"]]), axis=0, return_index=True, return_inverse=True
    )
    state = state.ravel()
    first_of_config = np.array([np.flatnonzero(inverse == c)[0] for c in range(len(config))])
    _check_same(angles, first_of_config[inverse], _SAME_ANGLE, JOINTS, numbers["config"], lines, where)
    _check_same(wrench, first[state], 0.05, WRENCH, numbers["config"], lines, where)
    q = angles[first_of_config]
    data = Measurements(
        file=path.name,
        config=config,
        q=q * RAD_PER_DEG,
        state_config=pairs[:, 0].astype(np.int64),
        load=pairs[:, 1],
        wrench=wrench[first],
        points=names,
        guess=np.array([experiment.points[name].position() for name in names]),
        load_point=experiment.load_point.position(),
        load_error=experiment.load_error_percent / 100.0,
        load_point_error=experiment.load_point_sigma_mm * M_PER_MM,
        sigma=experiment.sigma,
        state=state,
        point=np.array([names.index(name) for name in texts["point"]]),
        repeat=numbers["repeat"],
        position=np.column_stack([numbers[axis] for axis in "XYZ"]) * M_PER_MM,
        line=lines,
        used=np.ones(len(lines), dtype=bool),
    )
    _check_units(q, data, where)
    _check_complete(data, where, loads)
    return data


def _check_same(
    values: Array, reference: Ints, tolerance: float, names: tuple[str, ...], config: Array, lines: Array, where: str
) -> None:
    off = np.abs(values - values[reference]) > tolerance
    if off.any():
        row, column = np.argwhere(off)[0]
        raise MeasurementError(
            f"config {config[row]:g}: {names[column]} is {values[row, column]:g} here and "
            f"{values[reference[row], column]:g} at line {int(lines[reference[row]])}",
            file=where,
            line=int(lines[row]),
            advice="One configuration has one set of angles, one load case one force: give it another number.",
        )


def _check_units(q: Array, data: Measurements, where: str) -> None:
    if len(q) >= 2 and np.abs(q).max() <= 2.0 * np.pi:
        raise MeasurementError(
            f"no joint angle is larger than {np.abs(q).max():.3f}: these look like radians",
            file=where,
            advice="Give A1…A6 in degrees.",
        )
    span = float(np.ptp(data.position, axis=0).max())
    if len(q) >= 2 and span < 10.0 * M_PER_MM:
        raise MeasurementError(
            f"all readings lie within {span / M_PER_MM:.3g} mm: these look like metres, or the robot did not move",
            file=where,
            advice="Give X, Y, Z in mm.",
        )


def _check_complete(data: Measurements, where: str, loads: bool) -> None:
    for row in range(len(data.state)):
        state = data.state[row]
        if data.load[state] == 0 and np.abs(data.wrench[state]).max() > _NO_LOAD:
            raise MeasurementError(
                f"config {data.config[data.state_config[state]]:g}: load 0 means no load, but there is a force",
                file=where,
                line=int(data.line[row]),
            )
    keys, counts = np.unique(np.column_stack([data.state, data.point, data.repeat]), axis=0, return_counts=True)
    if counts.max() > 1:
        state, point, repeat = keys[np.argmax(counts)]
        rows = np.flatnonzero((data.state == state) & (data.point == point) & (data.repeat == repeat))
        raise MeasurementError(
            f"{data.name(int(rows[1])).partition(': ')[2]} is given twice (also line {int(data.line[rows[0]])})",
            file=where,
            line=int(data.line[rows[1]]),
            advice="Is a point name wrong?",
        )
    _check_sets(data, where)
    _check_loads(data, where, loads)


def _check_sets(data: Measurements, where: str) -> None:
    for state in range(len(data.load)):
        for repeat in np.unique(data.repeat[data.state == state]):
            rows = np.flatnonzero((data.state == state) & (data.repeat == repeat))
            absent = [name for index, name in enumerate(data.points) if index not in data.point[rows]]
            if absent:
                raise MeasurementError(
                    f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}, repeat {repeat:g}: "
                    f"no reading of point {', '.join(absent)}",
                    file=where,
                    line=int(data.line[rows[0]]),
                    advice="Measure it, or leave this repeat out.",
                )


def _check_loads(data: Measurements, where: str, loads: bool) -> None:
    for index, config in enumerate(data.config):
        loads_here = data.load[data.state_config == index]
        line = int(data.line[data.state_config[data.state] == index][0])
        if 0 not in loads_here:
            raise MeasurementError(
                f"config {config:g}: load {loads_here[0]:g} has no readings without load (load 0)",
                file=where,
                line=line,
                advice="Measure the same configuration unloaded, or leave it out.",
            )
        if loads and len(loads_here) == 1:
            raise MeasurementError(
                f"config {config:g}: only readings without load",
                file=where,
                line=line,
                advice="Measure the same configuration loaded, or leave it out.",
            )
    for state in data.loaded if loads else []:
        if np.abs(data.wrench[state]).max() <= _NO_LOAD:
            rows = np.flatnonzero(data.state == state)
            raise MeasurementError(
                f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}: the force is zero",
                file=where,
                line=int(data.line[rows[0]]),
                advice="Give the force on the load point in N, root axes.",
            )
