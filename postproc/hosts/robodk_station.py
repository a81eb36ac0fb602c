"""Cell data from a RoboDK station, queried from RoboDK itself: its files are binary and undocumented.

Needs RoboDK on this machine and its package `robodk`. Frames are those that RoboDK's own posts write: the active
reference frame in the base of the robot is `$BASE`, the active tool in the flange is `$TOOL`.
"""

from __future__ import annotations

import contextlib
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from postproc import kinematics, robot
from postproc.decimals import without_negative_zero
from postproc.errors import InputError
from postproc.frames import M_PER_MM, MM_PER_M, RAD_PER_DEG, Array, xyzabc_from_pose
from postproc.robot import JOINTS, RobotModel

OPEN = "open"
"""Instead of a file: the station that is open in RoboDK."""
_SAME_MM = 1.0
"""Distance [mm] of the flanges up to which both are the same arm (assumed): data sheets round to 1 mm."""
_ALTERNATIVE = "Or give --base, --tool and --start."


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """The robot of a station, with its frames and current joint angles.

    :param robot: its name in RoboDK.
    :param base: X…C of its active reference frame in its base [mm, deg].
    :param tool: X…C of its active tool in the flange [mm, deg].
    :param start: A1…A6 [deg].
    :param flange: (3,) position of the flange at `start`, in the base of the robot [mm].
    :param remarks: warnings about parts of the station that are ignored.
    """

    robot: str
    base: tuple[float, ...]
    tool: tuple[float, ...]
    start: tuple[float, ...]
    flange: Array
    remarks: tuple[str, ...]

    def shipped_model(self) -> str | None:
        """Return the shipped robot model of that name, or None."""
        letters = _letters(self.robot)
        models = {_letters(robot.load(folder).title): name for name, folder in robot.shipped_models().items()}
        return models.get(letters, models.get(f"kuka{letters}"))

    def check_flange(self, model: RobotModel) -> str | None:
        """Return a warning if the flange of a robot model is not where it is in RoboDK, else None."""
        q = np.array([self.start]) * RAD_PER_DEG
        flange = kinematics.tcp(model.nominal, q, np.eye(4))[0][0, :3, 3] * MM_PER_M
        distance = float(np.linalg.norm(flange - self.flange))
        if distance <= _SAME_MM:
            return None
        return (
            f"with these joint angles the flange of {model.title} is {distance:.4g} mm away from that of {self.robot} "
            "in RoboDK: is it the same arm, or one that RoboDK has calibrated?"
        )


def read(station: str) -> Station:
    """Ask RoboDK for the robot of a station.

    :param station: path of its file, which RoboDK opens; or `OPEN`.
    :raises InputError: RoboDK cannot be asked, or the station has not just one robot with six joints.
    """
    try:
        from robodk import robolink
    except ImportError:
        raise InputError(
            "a station is read by RoboDK, and its Python package is missing",
            file=station,
            advice=f"pip install robodk, with RoboDK on this machine. {_ALTERNATIVE}",
        ) from None
    if station != OPEN and not Path(station).is_file():
        raise InputError("no such file", file=station)
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # robolink prints what it is doing
            return _read_station(robolink, station)
    except InputError:
        raise
    except Exception as cause:  # robolink raises plain exceptions
        raise InputError(
            f"RoboDK does not answer ({cause})", file=station, advice=f"Start RoboDK, and try again. {_ALTERNATIVE}"
        ) from cause


def _read_station(robolink: Any, station: str) -> Station:
    """Return the robot, frames and start angles of a RoboDK station.

    :raises InputError: it does not have exactly one robot with six joints.
    """
    rdk = robolink.Robolink()
    if station != OPEN:
        rdk.AddFile(str(Path(station).resolve()))
    arms = rdk.ItemList(robolink.ITEM_TYPE_ROBOT)
    arms = [arm for arm in arms if len(arm.Joints().list()) >= len(JOINTS)]
    if len(arms) != 1:
        names = ", ".join(arm.Name() for arm in arms)
        raise InputError(
            f"{len(arms)} robots with six joints in the station{f': {names}' if names else ''}",
            file=station,
            advice=f"Open one with a single robot. {_ALTERNATIVE}",
        )
    (arm,) = arms
    joints = arm.Joints().list()
    start = tuple(float(value) for value in without_negative_zero(np.round(joints[: len(JOINTS)], 6)))
    remarks: tuple[str, ...] = ()
    if len(joints) > len(JOINTS):
        remarks = (f"{len(joints) - len(JOINTS)} external axes of the station are not taken over",)
    flange = np.array(arm.SolveFK(list(joints)).Rows())[:3, 3]
    return Station(
        robot=arm.Name(),
        base=_frame(arm.PoseFrame()),
        tool=_frame(arm.PoseTool()),
        start=start,
        flange=flange,
        remarks=remarks,
    )


def _frame(pose: Any) -> tuple[float, ...]:
    """Return X…C [mm, deg] of a pose of RoboDK [mm]."""
    matrix = np.array(pose.Rows(), dtype=float)
    matrix[:3, 3] *= M_PER_MM
    return tuple(float(value) for value in without_negative_zero(np.round(xyzabc_from_pose(matrix[None])[0], 6)))


def _letters(name: str) -> str:
    """Return the letters and digits of a name, lower case, without what is in brackets, to compare names."""
    return re.sub(r"\(.*|[^a-z0-9]", "", name.lower())
