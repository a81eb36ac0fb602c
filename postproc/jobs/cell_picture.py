"""The arm of a cell as points in the robot root: what a picture of the cell shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec import Struct

from postproc import cell as cells
from postproc.frames import MM_PER_M, RAD_PER_DEG, Array
from postproc.jobs.programs import load_robot
from postproc.jobs.start_joints import low_start

_EXAMPLE = (0.0, -90.0, 100.0, 0.0, 80.0, 0.0)
"""Posture of a cell without [start]: A1…A6 [deg]."""


class CellPicture(Struct, frozen=True, eq=False):
    """A robot and its frames, in the robot root [mm].

    :param title: name of the robot.
    :param arm: (8, 3) points of the arm: root, joints A1…A6, flange.
    :param tip: (3,) tip of the tool.
    :param base: (3,) origin of `$BASE`; `base_axes`: (3, 3) unit vectors of its X, Y, Z, one a row.
    :param is_start: True if the posture is [start] of the cell, False if it is an example.
    :param warning: a warning if the tip starts below the height to which programs retract; else empty.
    """

    title: str
    arm: Array
    tip: Array
    base: Array
    base_axes: Array
    is_start: bool
    warning: str


def cell_picture(path: Path) -> CellPicture:
    """Return the picture of a cell file.

    :raises PostprocError: the cell or its robot is unusable.
    """
    cell = cells.load(path)
    robot = load_robot(cell.robot, cell.folder)
    angles = np.array(_EXAMPLE) * RAD_PER_DEG if cell.start is None else cell.start_joints
    joints, flange = robot.nominal.joint_frames(angles[None])
    arm = np.vstack([np.zeros(3), joints[0, :6, :3, 3], flange[0, :3, 3]]) * MM_PER_M  # origins of the joint frames
    clearance = cell.machine.clearance_Z
    warnings = () if cell.start is None or clearance is None else low_start(cell, robot, clearance)
    tool, base = flange[0] @ cell.tool.pose(), cell.base.pose()
    return CellPicture(
        title=robot.title,
        arm=arm,
        tip=tool[:3, 3] * MM_PER_M,
        base=base[:3, 3] * MM_PER_M,
        base_axes=base[:3, :3].T,
        is_start=cell.start is not None,
        warning=next(iter(warnings), ""),
    )
