"""Published measurements: one folder with licence, source, robot, rig, readings and checksums; what it has and lacks.

Format: docs/reference, "A folder to publish". `dataset.toml` says where the readings come from and who may use them,
the other files are those of `identify`. `SHA256SUMS` is the output of `sha256sum`.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from postproc import files
from postproc.errors import InputError, MeasurementError, PostprocError
from postproc.frames import norm
from postproc.identification.measurement_model import as_positions, joint_torques
from postproc.identification.model_folder import starting_robot
from postproc.identification.procedure import check_readings
from postproc.identification.readings import Experiment, Measurements, gaps, read, read_experiment
from postproc.identification.uncertainty import levels
from postproc.robot import JOINTS, RobotModel

DATASET, EXPERIMENT, READINGS, SUMS, LICENCE = (
    "dataset.toml",
    "experiment.toml",
    "measurements.csv",
    "SHA256SUMS",
    "LICENSE",
)
_USUAL_CONFIGURATIONS, _USUAL_REPEATS = 30, 3
"""Usual numbers of configurations and of repeats (assumed)."""
_TORQUE_SHARE = 0.02
"""Share of the largest torque on any joint below which a joint is not loaded."""


class Dataset(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Content of `dataset.toml`; `licence` by its SPDX identifier, `source` an address or a paper."""

    name: str
    licence: str
    source: str
    robot: str
    rig: str
    device: str
    authors: str = ""
    date: str = ""
    notes: str = ""


class Finding(Struct, frozen=True):
    """Something that a folder should contain.

    :param text: the thing, for the user.
    :param is_present: whether the folder contains it.
    :param required: whether a folder without it cannot be published.
    """

    text: str
    is_present: bool
    required: bool = False


def check(folder: Path) -> list[Finding]:
    """Return findings on what a folder of measurements contains and lacks for an identification.

    Files that cannot be read are one finding, in place of those on readings, set-up and robot.

    :raises InputError: there is no such folder.
    """
    if not folder.is_dir():
        raise InputError("no such folder", file=str(folder), advice="Give the folder with experiment.toml.")
    findings = _origin_findings(folder)
    try:
        setup = read_experiment(folder / EXPERIMENT)
        data = read(folder / READINGS, setup)
        robot = starting_robot(setup, folder / EXPERIMENT).model
        torque = np.abs(joint_torques(robot, as_positions(robot, data))).max(axis=0)
    except PostprocError as error:
        return [
            *findings,
            Finding(f"{EXPERIMENT}, {READINGS}: {error}", is_present=False, required=True),
            _checksum_finding(folder),
        ]
    return [
        *findings,
        *_reading_findings(data),
        *_setup_findings(setup),
        _torque_finding(torque),
        *_agreement_findings(robot, data),
        _checksum_finding(folder),
    ]


def _origin_findings(folder: Path) -> list[Finding]:
    """Return the findings on `dataset.toml`, with licence and source, and on the text of the licence."""
    findings = []
    try:
        dataset = files.read_toml(folder / DATASET, Dataset, MeasurementError)
        empty_keys = [
            key for key in ("name", "licence", "source", "robot", "rig", "device") if not getattr(dataset, key)
        ]
        text = f"{DATASET}: {dataset.name}, {dataset.licence}, from {dataset.source}"
        findings.append(
            Finding(
                text if not empty_keys else f"{DATASET}: {', '.join(empty_keys)} empty",
                is_present=not empty_keys,
                required=True,
            )
        )
    except PostprocError as error:
        findings.append(Finding(f"{DATASET}: {error}", is_present=False, required=True))
    has_licence = (folder / LICENCE).is_file()
    findings.append(Finding(f"{LICENCE}: text of the licence", is_present=has_licence, required=True))
    return findings


def _reading_findings(data: Measurements) -> list[Finding]:
    """Return the findings on numbers of configurations, loads, repeats and points."""
    _, count = data.means()
    load = norm(data.wrench[data.loaded_states])
    level_count = int(levels(load).max()) + 1
    repeats = int(count.max())
    kind = "displacements" if data.are_displacements else "positions"
    gap_notes = gaps(data)
    return [
        Finding(
            f"{READINGS}: {len(data.state)} readings of {kind}, each state and point named",
            is_present=True,
            required=True,
        ),
        Finding(
            f"{len(data.q)} configurations; {_USUAL_CONFIGURATIONS} are usual",
            is_present=len(data.q) >= _USUAL_CONFIGURATIONS,
        ),
        Finding(
            f"loads of {load.min():.0f} to {load.max():.0f} N on {level_count} levels; two show gears that are not "
            "linear",
            is_present=level_count >= 2,
        ),
        Finding(f"{repeats} repeats; {_USUAL_REPEATS} show the noise", is_present=repeats >= _USUAL_REPEATS),
        Finding(
            f"{len(data.points)} points; three show all six directions of a link", is_present=len(data.points) >= 3
        ),
        Finding("readings without load, which show the geometry", is_present=not data.are_displacements),
        Finding(gap_notes[0] if gap_notes else "every repeat has all points", is_present=not gap_notes),
    ]


def _setup_findings(setup: Experiment) -> list[Finding]:
    """Return the findings on the stated errors of load and load point."""
    has_load_error = setup.load_error_percent is not None
    return [
        Finding("load_error_percent of the load cell or the scales", is_present=has_load_error),
        Finding("load_point_sigma_mm of the load point", is_present=setup.load_point_sigma_mm > 0.0),
    ]


def _torque_finding(torque: np.ndarray) -> Finding:
    """Return the finding on the largest torques (6,) [N·m] by the loads, with the joints that are hardly loaded."""
    limit = _TORQUE_SHARE * torque.max()
    unloaded_joints = [name for name, joint_torque in zip(JOINTS, torque, strict=True) if joint_torque < limit]
    torque_text = ", ".join(f"{joint_torque:.0f}" for joint_torque in torque)
    text = f"torques up to {torque_text} N·m on A1 … A6"
    if unloaded_joints:
        text = f"{text}: {', '.join(unloaded_joints)} hardly loaded"
    return Finding(text, is_present=not unloaded_joints)


def _agreement_findings(robot: RobotModel, data: Measurements) -> list[Finding]:
    """Return a finding for each contradiction of the readings to the robot, the loads or each other.

    Contradictions are outliers, and doubts and warnings of `check_readings`. Unusable readings are one finding: the
    error. Readings without contradictions are one finding too, which is present.
    """
    try:
        checked_readings = check_readings(robot, data)
    except PostprocError as error:
        return [Finding(str(error), is_present=False, required=True)]
    faults = [*(f"outlier: {name}" for name in checked_readings.outliers), *filter(None, [checked_readings.doubt])]
    faults += [note for note in checked_readings.warnings if note not in gaps(data)]  # gaps have their own finding
    if not faults:
        text = f"readings that agree with {robot.name}: points, angles, frame, direction of the loads"
        return [Finding(text, is_present=True)]
    return [Finding(fault, is_present=False) for fault in faults]


_SUMS_COMMAND = f"find . -type f ! -name {SUMS} -exec sha256sum {{}} + > {SUMS}"
_CHECKSUM_LINE = re.compile(r"^([0-9a-fA-F]{64}) [ *](?:\./)?(.+?)\r?$", re.M)
"""A line of `sha256sum`; files that were edited on Windows end it with CR LF."""


def _checksum_finding(folder: Path) -> Finding:
    """Return the finding on `SHA256SUMS`: present if it has the right checksum for each file of the folder, no more."""
    path = folder / SUMS
    advice = f"run `{_SUMS_COMMAND}` in the folder"
    if not path.is_file():
        return Finding(f"{SUMS}: {advice}", is_present=False, required=True)
    stated_digests = {
        name: digest.lower() for digest, name in _CHECKSUM_LINE.findall(files.read_text(path, MeasurementError))
    }
    path_by_name = {p.relative_to(folder).as_posix(): p for p in sorted(folder.rglob("*")) if p.is_file() and p != path}
    # beginning of the message → names of the files with this fault
    files_by_fault = {
        "not those of": [
            name
            for name in path_by_name
            if name in stated_digests and stated_digests[name] != _digest(path_by_name[name])
        ],
        "none for": [name for name in path_by_name if name not in stated_digests],
        "no such files:": [name for name in stated_digests if name not in path_by_name],
    }
    parts = [f"{fault} {', '.join(names)}" for fault, names in files_by_fault.items() if names]
    if parts:
        return Finding(f"{SUMS}: {'; '.join(parts)}; {advice}", is_present=False, required=True)
    return Finding(f"{SUMS}: right for {len(path_by_name)} files", is_present=True, required=True)


def _digest(file: Path) -> str:
    """Return the SHA-256 of a file's content, in hexadecimal digits."""
    return hashlib.sha256(file.read_bytes()).hexdigest()
