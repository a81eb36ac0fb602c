"""`experiment.toml` and `measurements.csv`, read and checked: the set-up of a measurement, and readings of its points.

Set-up: mm and degrees as in the file; positions and boxes in the robot root. Readings: SI. Formats: docs/reference.
Only the numbers themselves are checked here; checks that need the robot (swapped points, a moved tracker, forces in kg)
are in `plausibility`.
"""

# ruff: noqa: N815 - keys of the file carry their unit

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import files
from postproc.cell import Frame, Length
from postproc.errors import MeasurementError, choices, combined_error
from postproc.frames import DEG_PER_RAD, M_PER_MM, RAD_PER_DEG, Array
from postproc.program import WRENCH, Bools, Ints
from postproc.robot import JOINTS

Positive = Annotated[float, msgspec.Meta(gt=0, le=1e6)]
NotNegative = Annotated[float, msgspec.Meta(ge=0, le=1e6)]
Mass = Annotated[float, msgspec.Meta(gt=0, le=1e4)]
OnFlange = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]
"""Coordinate in the flange frame [mm]; no tool is longer than 10 m."""

ASSUMED_LOAD_ERROR = 0.01
"""Common relative error of all loads (95 %) where none is stated: of load cells and scales in shops (assumed)."""


class Rig(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """The load on the arm: a weight that hangs, or pulls over a pulley at up to `max_angle_deg` from the vertical.

    `rope_mm` and `weight_radius_mm` give the space that rope and weight need at the load point; a rope over a pulley
    (`max_angle_deg` > 0) needs `rope_mm` of free run. `max_torque_Nm`: static torque limits of A1…A6, if the URDF has
    none.
    """

    mass_kg: Mass
    max_angle_deg: Annotated[float, msgspec.Meta(ge=0, le=90)] = 0.0
    rope_mm: NotNegative = 400.0
    weight_radius_mm: NotNegative = 200.0
    max_torque_Nm: tuple[Positive, Positive, Positive, Positive, Positive, Positive] | None = None


class Tracker(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Position of the measuring device; the largest angle between a marker (with a normal) and the line of sight."""

    X: Length
    Y: Length
    Z: Length
    acceptance_deg: Annotated[float, msgspec.Meta(gt=0, le=180)] = 45.0


class Floor(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Height of the floor."""

    Z: Length = 0.0


class Box(Frame, frozen=True, kw_only=True):
    """A box to stay clear of: its centre as a frame (A, B, C turn it) and its size along its own axes."""

    size: tuple[Positive, Positive, Positive]
    name: str = ""


class MeshFile(Frame, frozen=True, kw_only=True):
    """A mesh to stay clear of (STL, OBJ, PLY …; path relative to the experiment), placed by a frame."""

    file: str
    scale: Positive = 1.0


class Body(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Simple shape of the arm as capsules, and the clearance to everything.

    `radius_mm`: along base column, link 2, link 3 with its hump, forearm, hand; `tool_radius_mm`: of the parts from the
    flange to load point and markers.
    """

    radius_mm: tuple[Positive, Positive, Positive, Positive, Positive] | None = None
    tool_radius_mm: Positive = 40.0
    clearance_mm: NotNegative = 30.0


class FlangePoint(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A point in the flange frame [mm]."""

    X: OnFlange
    Y: OnFlange
    Z: OnFlange

    def position(self) -> Array:
        """Return the point (3,) [m]."""
        return np.array([self.X, self.Y, self.Z]) * M_PER_MM


class Marker(FlangePoint, frozen=True):
    """A reference point; `normal` (flange frame): direction of its reflector, for `plan`; none: turned by hand."""

    normal: tuple[Length, Length, Length] | None = None


class Payload(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Payload in all readings, in addition to the load: kg, and its centre of mass in the flange frame, mm."""

    mass_kg: Mass
    X: OnFlange = 0.0
    Y: OnFlange = 0.0
    Z: OnFlange = 0.0


Six = tuple[OnFlange, OnFlange, OnFlange, OnFlange, OnFlange, OnFlange]


class Angles(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Angles of another controller: A = sign·J + offset for each joint, and A3 turns by `A3_per_J2`·J2 in addition.

    A3_per_J2 is −1 or 1 for a robot with a parallelogram, whose controller counts J3 from the horizontal.
    """

    sign: tuple[Literal[-1, 1], ...] = (1, 1, 1, 1, 1, 1)
    offset_deg: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    A3_per_J2: Literal[-1, 0, 1] = 0

    def __post_init__(self) -> None:
        """Check that there are six signs.

        :raises ValueError: there are not; the reader of the file names the place.
        """
        if len(self.sign) != len(JOINTS):
            raise ValueError("[angles] sign needs six numbers, 1 or -1")

    def to_robot(self, joints: Array) -> Array:
        """Return the angles A1 … A6 (n, 6) for the angles (n, 6) of the file [deg]."""
        angles = joints * np.array(self.sign) + np.array(self.offset_deg)
        angles[:, 2] += self.A3_per_J2 * joints[:, 1]
        return np.asarray(angles)


class Experiment(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Content of `experiment.toml`; `sigma_mm`: noise of one coordinate of one reading; from `rig` on, for `plan`.

    `load_error_percent`: 95 % bound of the common relative error of all loads, assumed where it is not stated;
    `load_point_sigma_mm`: standard deviation of the load point, in each direction. `readings`: whether X, Y, Z are
    positions in the frame of the device, or displacements by the load, root axes. `angles`: of other controllers.
    """

    robot: str
    sigma_mm: Annotated[float, msgspec.Meta(ge=1e-6, le=100)]
    load_point: FlangePoint
    points: dict[str, Marker]
    payload: Payload | None = None
    load_error_percent: Annotated[float, msgspec.Meta(ge=0, le=100)] | None = None
    load_point_sigma_mm: Annotated[float, msgspec.Meta(ge=0, le=1000)] = 0.0
    readings: Literal["positions", "displacements"] = "positions"
    angles: Angles = Angles()
    rig: Rig | None = None
    tracker: Tracker | None = None
    floor: Floor = Floor()
    boxes: list[Box] = []
    meshes: list[MeshFile] = []
    body: Body = Body()

    @property
    def sigma(self) -> float:
        """Noise of one coordinate of one reading [m]."""
        return self.sigma_mm * M_PER_MM

    @property
    def load_error(self) -> float:
        """95 % bound of the common relative error of all loads."""
        return ASSUMED_LOAD_ERROR if self.load_error_percent is None else self.load_error_percent / 100.0

    @property
    def assumptions(self) -> list[str]:
        """One sentence for each value that the experiment does not state, so that it is assumed."""
        if self.load_error_percent is not None:
            return []
        return [
            f"all loads are right to {ASSUMED_LOAD_ERROR:.0%} together (95 %): set load_error_percent to what the "
            "certificate of the load cell or the scales states"
        ]


_IN_METRES = 1e-3
"""Distance [m] of the load point from the flange origin below which it looks like metres: no tool is longer than a
metre, and a load at the origin itself has zeros (assumed)."""
_ON_TOOL = 0.1
"""Distance [m] of a reference point from the flange origin that shows a tool of usual size, in mm (assumed)."""


def read_experiment(path: Path) -> Experiment:
    """Read `experiment.toml`.

    :raises MeasurementError: unknown or missing keys, values out of range, no points, a load point in metres.
    """
    experiment = files.read_toml(path, Experiment, MeasurementError)
    if not experiment.points:
        raise MeasurementError("no [points.NAME]", file=str(path), advice="Give the reference points on the tool.")
    lever = float(np.linalg.norm(experiment.load_point.position()))
    largest_distance = max(float(np.linalg.norm(point.position())) for point in experiment.points.values())
    if 0.0 < lever < _IN_METRES and largest_distance > _ON_TOOL:
        raise MeasurementError(
            f"[load_point] is {lever / M_PER_MM:.2g} mm from the flange origin, and the points up to "
            f"{largest_distance / M_PER_MM:.0f} mm: X, Y, Z of the load point look like metres",
            file=str(path),
            advice="Give them in mm; where the load acts at the flange origin, give 0, 0, 0.",
        )
    return experiment


class Measurements(Struct, frozen=True, eq=False):
    """Readings of P reference points in S states (a configuration without load, or with one of its loads).

    :param file: name of the file.
    :param config: (C,) numbers of the configurations as in the file.
    :param q: (C, 6) joint angles [rad].
    :param state_config: (S,) row of the configuration of each state.
    :param load: (S,) number of the load; 0 without load.
    :param wrench: (S, 6) force [N] and moment [N·m] at the load point, root axes.
    :param points: names of the reference points.
    :param guess: (P, 3) their approximate positions in the flange frame [m].
    :param load_point: (3,) in the flange frame [m].
    :param sigma: noise of one coordinate of one reading [m], as stated.
    :param state: (n,) state of each reading.
    :param point: (n,) point of each reading.
    :param repeat: (n,) number of the repeat.
    :param position: (n, 3) in the frame of the measuring device [m].
    :param line: (n,) line in the file.
    :param used: (n,) False for readings left out as outliers.
    :param load_error: 95 % bound of the common relative error of all loads.
    :param load_point_error: standard deviation of the load point, in each direction [m].
    :param are_displacements: `position` of a loaded state is the displacement from the state without load, root axes.
    :param has_unloaded_readings: False for positions computed from displacements: their states without load were added.
    """

    file: str
    config: Array
    q: Array
    state_config: Ints
    load: Array
    wrench: Array
    points: tuple[str, ...]
    guess: Array
    load_point: Array
    sigma: float
    state: Ints
    point: Ints
    repeat: Array
    position: Array
    line: Array
    used: Bools
    load_error: float = 0.0
    load_point_error: float = 0.0
    are_displacements: bool = False
    has_unloaded_readings: bool = True

    @property
    def loaded_states(self) -> Ints:
        """States with load."""
        return np.flatnonzero(self.load != 0)

    @property
    def unloaded_states(self) -> Ints:
        """(C,) the state without load of each configuration."""
        unloaded_rows = np.flatnonzero(self.load == 0)
        state_of_config = np.empty(len(self.q), dtype=np.int64)
        state_of_config[self.state_config[unloaded_rows]] = unloaded_rows
        return state_of_config

    def means(self) -> tuple[Array, Array]:
        """Return mean positions (S, P, 3) [m] and numbers (S, P) of the used readings of each point in each state.

        The mean is zero without a used reading.
        """
        states, points = len(self.load), len(self.points)
        cell = (self.state * points + self.point)[self.used]  # index in the flattened table of states and points
        count = np.bincount(cell, minlength=states * points).astype(float)
        total = np.stack(
            [np.bincount(cell, weights=self.position[self.used, axis], minlength=len(count)) for axis in range(3)]
        )
        mean = (total / np.maximum(count, 1.0)).T
        return mean.reshape(states, points, 3), count.reshape(states, points)

    def scatter(self) -> tuple[float, int]:
        """Return the sum of squares of used repeats about their means [m²], and its degrees of freedom."""
        mean, count = self.means()
        deviation = (self.position - mean[self.state, self.point])[self.used]
        # three coordinates; a mean costs one of its repeats
        return float(np.sum(deviation**2)), int(3 * np.sum(np.maximum(count - 1, 0)))

    def first_line(self, configuration: int) -> int:
        """Return the first line of the file with readings of a configuration, by its row in `q`."""
        return int(self.line[np.flatnonzero(self.state_config[self.state] == configuration)[0]])

    def name(self, reading: int) -> str:
        """Return line, configuration, load, repeat and point of a reading, for messages."""
        state = self.state[reading]
        return (
            f"line {int(self.line[reading])}: config {self.config[self.state_config[state]]:g}, "
            f"load {self.load[state]:g}, repeat {self.repeat[reading]:g}, point {self.points[self.point[reading]]}"
        )

    def drop(self, readings: list[int]) -> Measurements:
        """Return the measurements without some readings, which are marked as not used.

        :param readings: indices of these readings.
        """
        is_used = self.used.copy()
        is_used[readings] = False
        return replace(self, used=is_used)

    def take_configurations(self, configurations: Ints) -> Measurements:
        """Return the measurements of some configurations (rows of `q`), with their states and readings renumbered."""
        # new number of each configuration and state, −1 for those that are left out
        new_config = np.full(len(self.q), -1)
        new_config[configurations] = np.arange(len(configurations))
        states = np.flatnonzero(new_config[self.state_config] >= 0)
        new_state = np.full(len(self.load), -1)
        new_state[states] = np.arange(len(states))
        rows = np.flatnonzero(new_state[self.state] >= 0)
        return replace(
            self,
            config=self.config[configurations],
            q=self.q[configurations],
            state_config=new_config[self.state_config[states]],
            load=self.load[states],
            wrench=self.wrench[states],
            state=new_state[self.state[rows]],
            point=self.point[rows],
            repeat=self.repeat[rows],
            position=self.position[rows],
            line=self.line[rows],
            used=self.used[rows],
        )


AXES = ("X", "Y", "Z")
COLUMNS = (
    *("config", "load", "repeat", "point"),
    *JOINTS,
    *WRENCH,
    *AXES,
)
_LARGEST = (
    *((name, 1e9, "") for name in ("config", "load", "repeat")),
    *((name, 3600.0, " deg") for name in JOINTS),
    *((name, 1e6, " N" if name.startswith("F") else " N·m") for name in WRENCH),
    *((axis, 1e6, " mm") for axis in AXES),
)
"""Largest size of a cell of each column: beyond it no robot, no load and no measuring device is."""
_SAME_ANGLE = 1e-3
"""Difference [deg] of the angles of one configuration that is the rounding of their display."""
_SAME_FORCE = 0.05
"""Difference [N, N·m] of the components of one load case that is the rounding of their display."""
_LEAST_SPAN = 10e-3
"""Span of all positions [m] below which the robot did not move, or the file is in metres (assumed)."""
_NO_LOAD = 1e-6
"""Forces below this [N, N·m] are none but for rounding."""


def read(path: Path, experiment: Experiment, needs_loads: bool = True) -> Measurements:
    """Read `measurements.csv` and check that it is complete; rows without X, Y and Z are left out.

    :param needs_loads: whether each configuration needs readings under load; not for a calibration of the geometry.
    :raises MeasurementError: a reading is missing, given twice, not a number, or of a point that the experiment does
        not name; a configuration has no unloaded state; angles are in radians, lengths not in mm.
    """
    file_name = str(path)
    rows = _drop_empty_rows(files.read_csv(path, COLUMNS, (), MeasurementError, ("point",), AXES), file_name)
    if len(rows.lines) == 0:
        raise MeasurementError("no readings", file=file_name, advice="Fill in X, Y and Z.")
    files.check_sizes(path, rows.numbers, rows.lines, _LARGEST, MeasurementError)
    if experiment.readings == "displacements":
        rows = _add_unloaded_states(rows, file_name)
    _check_points(rows.texts["point"], tuple(experiment.points), rows.lines, file_name)
    data = _measurements(rows, experiment, path)
    _check_units(data.q * DEG_PER_RAD, data, file_name)
    _check_complete(data, file_name, needs_loads)
    return data


def _measurements(rows: files.CsvTable, experiment: Experiment, path: Path) -> Measurements:
    """Return the readings, grouped by states: a state has the rows with the same configuration and load.

    :param rows: of the file, all with X, Y, Z and a point of the experiment.
    :raises MeasurementError: rows of one configuration have different angles, or rows of one state different forces.
    """
    numbers, lines = rows.numbers, rows.lines
    angles = experiment.angles.to_robot(np.column_stack([numbers[name] for name in JOINTS]))
    wrench = np.column_stack([numbers[name] for name in WRENCH])
    config, config_of_row = np.unique(numbers["config"], return_inverse=True)
    states, first_of_state, state = np.unique(
        np.column_stack([config_of_row, numbers["load"]]), axis=0, return_index=True, return_inverse=True
    )
    state = state.ravel()
    first_of_config = np.array([np.flatnonzero(config_of_row == index)[0] for index in range(len(config))])
    # each row is compared with the first row of its configuration, and of its state
    angle_reference, force_reference = first_of_config[config_of_row], first_of_state[state]
    _check_equal(rows, angles, reference=angle_reference, names=JOINTS, tolerance=_SAME_ANGLE, path=path)
    _check_equal(rows, wrench, reference=force_reference, names=WRENCH, tolerance=_SAME_FORCE, path=path)
    names = tuple(experiment.points)
    return Measurements(
        file=path.name,
        config=config,
        q=angles[first_of_config] * RAD_PER_DEG,
        state_config=states[:, 0].astype(np.int64),
        load=states[:, 1],
        wrench=wrench[first_of_state],
        points=names,
        guess=np.array([experiment.points[name].position() for name in names]),
        load_point=experiment.load_point.position(),
        load_error=experiment.load_error,
        load_point_error=experiment.load_point_sigma_mm * M_PER_MM,
        sigma=experiment.sigma,
        state=state,
        point=np.array([names.index(name) for name in rows.texts["point"]]),
        repeat=numbers["repeat"],
        position=np.column_stack([numbers[axis] for axis in AXES]) * M_PER_MM,
        line=lines,
        used=np.ones(len(lines), dtype=bool),
        are_displacements=experiment.readings == "displacements",
    )


def _check_points(points: Sequence[str], names: Sequence[str], lines: Array, file_name: str) -> None:
    """Check that all readings are of points of the experiment.

    :param points: (n,) names of the points of the readings, in `lines` (n,) of the file.
    :param names: of the points of the experiment.
    :raises MeasurementError: a point has another name.
    """
    for row, name in enumerate(points):
        if name not in names:
            raise MeasurementError(
                f"unknown point {name!r}",
                file=file_name,
                line=int(lines[row]),
                advice=choices(name, names, "Points of the experiment"),
            )


def _drop_empty_rows(table: files.CsvTable, file_name: str) -> files.CsvTable:
    """Return the rows of a table that have X, Y, Z; rows without all three are points that the device did not see.

    :raises MeasurementError: one or two of X, Y, Z of a row are empty.
    """
    numbers, texts, lines = table
    is_empty = np.column_stack([np.isnan(numbers[axis]) for axis in AXES])
    faults = [
        MeasurementError(
            f"{' and '.join(axis for axis, empty in zip(AXES, is_empty[row], strict=True) if empty)} empty",
            file=file_name,
            line=int(lines[row]),
            advice="A reading has X, Y and Z; leave all three empty, or the row out, if there is none.",
        )
        for row in np.flatnonzero(is_empty.any(axis=1) & ~is_empty.all(axis=1))
    ]
    if faults:
        raise combined_error(faults)
    rows = np.flatnonzero(~is_empty.any(axis=1))
    return files.CsvTable(
        {name: column[rows] for name, column in numbers.items()},
        {name: [column[row] for row in rows] for name, column in texts.items()},
        lines[rows],
    )


_LARGEST_DISPLACEMENT = 0.2
"""Largest difference of displacements under loads [m] (assumed)."""


def _add_unloaded_states(table: files.CsvTable, file_name: str) -> files.CsvTable:
    """Return the rows of displacements, and after them one row without load for each configuration and point.

    The displacement in the added row is zero. Its line is that of the first row of the configuration and point.

    :raises MeasurementError: the file has rows without load.
    """
    numbers, texts, lines = table
    if np.any(numbers["load"] == 0.0):
        raise MeasurementError(
            "load 0 has rows, but X, Y, Z are displacements from the position without load",
            file=file_name,
            line=int(lines[np.argmax(numbers["load"] == 0.0)]),
            advice='Remove these rows, or leave out `readings = "displacements"` and give positions.',
        )
    pairs = [(config, name) for config, name in zip(numbers["config"].tolist(), texts["point"], strict=True)]
    first_rows = [pairs.index(pair) for pair in dict.fromkeys(pairs)]
    zero_columns = {name: column[first_rows] for name, column in numbers.items()}
    for name in ("load", *WRENCH, *AXES):
        zero_columns[name] = np.zeros(len(first_rows))
    zero_columns["repeat"] = np.ones(len(first_rows))
    return files.CsvTable(
        {name: np.concatenate([numbers[name], zero_columns[name]]) for name in numbers},
        {"point": [*texts["point"], *(texts["point"][row] for row in first_rows)]},
        np.concatenate([lines, lines[first_rows]]),
    )


def _check_equal(
    rows: files.CsvTable,
    values: Array,
    *,
    reference: Ints,
    names: tuple[str, ...],
    tolerance: float,
    path: Path,
) -> None:
    """Check that the values of each row equal the values of its reference row.

    :param rows: n rows of the file, for messages.
    :param values: (n, k) of the rows, in columns with `names` (k,).
    :param reference: (n,) index of the reference row of each row.
    :raises MeasurementError: a value differs by more than the tolerance; the message names the row.
    """
    differs = np.abs(values - values[reference]) > tolerance
    if differs.any():
        row, column = np.argwhere(differs)[0]
        raise MeasurementError(
            f"config {rows.numbers['config'][row]:g}: {names[column]} is {values[row, column]:g} here and "
            f"{values[reference[row], column]:g} at line {int(rows.lines[reference[row]])}",
            file=str(path),
            line=int(rows.lines[row]),
            advice="One configuration has one set of angles, one load case one force: give it another number.",
        )


def _check_units(angles: Array, data: Measurements, file_name: str) -> None:
    """Check by their size that angles are in degrees and positions in mm; a single configuration shows neither.

    Displacements must be smaller than `_LARGEST_DISPLACEMENT`.

    :param angles: (C, 6) of the configurations, in degrees if the file is right.
    :raises MeasurementError: the sizes are those of another unit.
    """
    largest_angle = float(np.abs(angles).max())
    if len(angles) >= 2 and largest_angle <= 2.0 * np.pi:
        raise MeasurementError(
            f"no joint angle is larger than {largest_angle:.3f}: these look like radians",
            file=file_name,
            advice="Give A1…A6 in degrees.",
        )
    span = float(np.ptp(data.position, axis=0).max())
    if data.are_displacements:
        if span > _LARGEST_DISPLACEMENT:
            raise MeasurementError(
                f"displacements differ by {span / M_PER_MM:.3g} mm: these look like positions",
                file=file_name,
                advice='Give displacements by the load in mm, root axes, or leave out `readings = "displacements"`.',
            )
        return
    if len(angles) >= 2 and span < _LEAST_SPAN:
        raise MeasurementError(
            f"all readings lie within {span / M_PER_MM:.3g} mm: these look like metres, or the robot did not move",
            file=file_name,
            advice="Give X, Y, Z in mm.",
        )


def _check_complete(data: Measurements, file_name: str, needs_loads: bool) -> None:
    """Check that no reading is given twice, and that each configuration has the readings that it needs.

    :param needs_loads: whether each configuration needs readings under load.
    :raises MeasurementError: load 0 has a force, a reading is given twice, or readings are missing, see `_check_sets`
        and `_check_loads`.
    """
    has_force = np.abs(data.wrench).max(axis=1) > _NO_LOAD
    wrong_rows = np.flatnonzero(((data.load == 0) & has_force)[data.state])
    if len(wrong_rows):
        row = int(wrong_rows[0])
        raise MeasurementError(
            f"config {data.config[data.state_config[data.state[row]]]:g}: load 0 means no load, but there is a force",
            file=file_name,
            line=int(data.line[row]),
        )
    keys, counts = np.unique(np.column_stack([data.state, data.point, data.repeat]), axis=0, return_counts=True)
    if counts.max() > 1:
        state, point, repeat = keys[np.argmax(counts)]
        rows = np.flatnonzero((data.state == state) & (data.point == point) & (data.repeat == repeat))
        raise MeasurementError(
            f"{data.name(int(rows[1])).partition(': ')[2]} is given twice (also line {int(data.line[rows[0]])})",
            file=file_name,
            line=int(data.line[rows[1]]),
            advice="Is a point name wrong?",
        )
    _check_sets(data, file_name)
    _check_loads(data, file_name, needs_loads)


def _check_sets(data: Measurements, file_name: str) -> None:
    """Check that each point has a reading, and that each load has a point with readings with and without this load.

    Single repeats may lack points, see `gaps`.

    :raises MeasurementError: a point has no reading, or a load has no such point.
    """
    absent = [name for index, name in enumerate(data.points) if index not in data.point]
    if absent:
        raise MeasurementError(
            f"no reading of point {', '.join(absent)}",
            file=file_name,
            advice="Measure it, or remove it from [points] of the experiment.",
        )
    _, count = data.means()
    for state in np.flatnonzero(data.load != 0.0).tolist():
        unloaded_states = np.flatnonzero((data.state_config == data.state_config[state]) & (data.load == 0.0))
        if len(unloaded_states) > 0 and not np.any((count[state] > 0.0) & (count[unloaded_states[0]] > 0.0)):
            raise MeasurementError(
                f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}: no point has readings "
                "with and without this load",
                file=file_name,
                line=int(data.line[np.flatnonzero(data.state == state)[0]]),
                advice="Measure one point at least in both, or leave this load out.",
            )


_MAX_NAMES = 5
"""Sets of readings that a warning names."""


def gaps(data: Measurements) -> list[str]:
    """Return one sentence on the repeats (of a state) that lack a point; empty if every repeat has all points."""
    sets = np.unique(np.column_stack([data.state, data.repeat]), axis=0)
    names = []
    for state, repeat in sets:
        rows = (data.state == state) & (data.repeat == repeat)
        absent = [name for index, name in enumerate(data.points) if index not in data.point[rows]]
        if absent:
            config = data.config[data.state_config[int(state)]]
            names.append(f"config {config:g}, load {data.load[int(state)]:g}, repeat {repeat:g}: {', '.join(absent)}")
    if not names:
        return []
    suffix = f"; and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    return [f"points without a reading, the others are used: {'; '.join(names[:_MAX_NAMES])}{suffix}"]


def _check_loads(data: Measurements, file_name: str, needs_loads: bool) -> None:
    """Check that each configuration has an unloaded state, and loaded states with a force if it needs loads.

    :raises MeasurementError: a configuration has no unloaded state, or needs loads and has none, or a force is zero.
    """
    for index, config in enumerate(data.config):
        config_loads = data.load[data.state_config == index]
        line = int(data.line[data.state_config[data.state] == index][0])
        if 0 not in config_loads:
            raise MeasurementError(
                f"config {config:g}: load {config_loads[0]:g} has no readings without load (load 0)",
                file=file_name,
                line=line,
                advice="Measure the same configuration unloaded, or leave it out.",
            )
        if needs_loads and len(config_loads) == 1:
            raise MeasurementError(
                f"config {config:g}: only readings without load",
                file=file_name,
                line=line,
                advice="Measure the same configuration loaded, or leave it out.",
            )
    is_without_force = np.abs(data.wrench).max(axis=1) <= _NO_LOAD
    if needs_loads and is_without_force[data.loaded_states].any():
        state = int(data.loaded_states[np.argmax(is_without_force[data.loaded_states])])
        raise MeasurementError(
            f"config {data.config[data.state_config[state]]:g}, load {data.load[state]:g}: the force is zero",
            file=file_name,
            line=int(data.line[np.flatnonzero(data.state == state)[0]]),
            advice="Give the force on the load point in N, root axes.",
        )
