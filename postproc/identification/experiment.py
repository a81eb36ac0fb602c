"""`experiment.toml`: the measurement on a robot and, for `postproc plan`, its site and its loads.

Mm and degrees as in the file; positions and boxes in the robot root.
"""

# ruff: noqa: N815 - keys of the file carry their unit

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from postproc import files
from postproc.cell import Frame
from postproc.errors import MeasurementError
from postproc.frames import M_PER_MM, Array

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]


class Rig(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What loads the arm: a weight that hangs, or pulls over a pulley at up to an angle from the vertical.

    `rope_mm` and `weight_radius_mm` give the space that rope and weight need at the load point; a rope over a pulley
    (`max_angle_deg` > 0) needs `rope_mm` of free run. `max_torque_Nm`: static torque limits of A1…A6, if the URDF has
    none.
    """

    mass_kg: Positive
    max_angle_deg: Annotated[float, msgspec.Meta(ge=0, le=90)] = 0.0
    rope_mm: NotNegative = 400.0
    weight_radius_mm: NotNegative = 200.0
    max_torque_Nm: tuple[Positive, Positive, Positive, Positive, Positive, Positive] | None = None


class Tracker(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Place of the measuring device; how far a marker may be turned away from it (where it has a normal)."""

    X: float
    Y: float
    Z: float
    acceptance_deg: Annotated[float, msgspec.Meta(gt=0, le=180)] = 45.0


class Floor(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Height of the floor."""

    Z: float = 0.0


class Box(Frame, frozen=True, kw_only=True):
    """A box to stay clear of: its centre as a frame (A, B, C turn it) and its size along its own axes."""

    size: tuple[Positive, Positive, Positive]
    name: str = ""


class MeshFile(Frame, frozen=True, kw_only=True):
    """A mesh to stay clear of (STL, OBJ, PLY …; path relative to the experiment), placed by a frame."""

    file: str
    scale: Positive = 1.0


class Body(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Simple shape of the arm: radii of capsules along base column, link 2, link 3 with its hump, forearm, hand; of
    those that carry load point and markers; and the distance to be kept from everything.
    """

    radius_mm: tuple[Positive, Positive, Positive, Positive, Positive] | None = None
    tool_radius_mm: Positive = 40.0
    clearance_mm: NotNegative = 30.0


class FlangePoint(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A point in the flange frame [mm]."""

    X: float
    Y: float
    Z: float

    def position(self) -> Array:
        """Return the point (3,) [m]."""
        return np.array([self.X, self.Y, self.Z]) * M_PER_MM


class Marker(FlangePoint, frozen=True):
    """A reference point; `normal` (flange frame) is where its reflector looks, for `plan`; none: turned by hand."""

    normal: tuple[float, float, float] | None = None


class Payload(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Payload in all readings, in addition to the load: kg, and its centre of mass in the flange frame, mm."""

    mass_kg: Positive
    X: float = 0.0
    Y: float = 0.0
    Z: float = 0.0


class Experiment(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Content of `experiment.toml`; `sigma_mm`: noise of one coordinate of one reading; from `rig` on, for `plan`.

    `load_error_percent`: 95 % bound of what all loads are wrong by together; `load_point_sigma_mm`: of where
    they act, in each direction.
    """

    robot: str
    sigma_mm: Positive
    load_point: FlangePoint
    points: dict[str, Marker]
    payload: Payload | None = None
    load_error_percent: NotNegative = 0.0
    load_point_sigma_mm: NotNegative = 0.0
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


def read_experiment(path: Path) -> Experiment:
    """Read `experiment.toml`.

    :raises MeasurementError: unknown or missing keys, values out of range, fewer than three points.
    """
    experiment = files.read_toml(path, Experiment, MeasurementError)
    if not experiment.points:
        raise MeasurementError("no [points.NAME]", file=str(path), advice="Give the reference points on the tool.")
    return experiment
