"""The joints where programs start: above the part, so that the first move comes from above."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec.structs import replace

from postproc import kinematics
from postproc.cell import Cell
from postproc.decimals import without_negative_zero
from postproc.frames import DEG_PER_RAD, MM_PER_M, RAD_PER_DEG, Array, inverse
from postproc.robot import RobotModel

USUAL_START = (0.0, -70.0, 110.0, 0.0, 50.0, 0.0)
"""A1…A6 [deg] that give the branch of the arm if no start is stated: ahead, elbow up, A5 > 0."""
QUARTER_TURNS = (0.0, 90.0, 180.0, -90.0)
"""Turns of the tool about its axis [deg] that are tried: spindles are mounted in quarter turns."""
_ABOVE_MM = 50.0
"""Height of the tip at the start above the height to which programs retract [mm] (assumed)."""
_LEAST_JOINT_MARGIN = 10.0 * RAD_PER_DEG
"""Least distance of a chosen start from joint limits [rad] (assumed)."""


def joints_above_part(
    cell: Cell, robot: RobotModel, clearance: float, turns: Sequence[float]
) -> tuple[float, ...] | None:
    """Return A1…A6 [deg] with the tip above the origin of `$BASE`.

    Of the turns within reach and joint limits, the one with A4 and A6 nearest to 0 is chosen. None: there is none.

    :param cell: cell with [start], which gives the branch of the arm.
    :param clearance: Z of `$BASE` to which programs retract [mm]; the tip is 50 mm above it.
    :param turns: turns of the tool about its axis to try [deg].
    """
    candidates = []
    for turn in turns:
        joints = upright_joints(cell, robot, turn, clearance + _ABOVE_MM)
        if np.isfinite(joints).all() and (kinematics.joint_margin(robot, joints[None]) > _LEAST_JOINT_MARGIN).all():
            candidates.append(joints)
    if not candidates:
        return None
    nearest = min(candidates, key=lambda joints: float(np.abs(joints[[3, 5]]).max()))
    return tuple(without_negative_zero(np.round(nearest * DEG_PER_RAD, 1)).tolist())


def upright_joints(cell: Cell, robot: RobotModel, turn: float, height: float) -> Array:
    """Return the joints (6,) [rad] with the tool upright above the origin of `$BASE`, on the branch of the start.

    :param turn: turn of the tool about its axis [deg].
    :param height: Z of the tip in `$BASE` [mm].
    :returns: NaN if the pose is out of reach.
    """
    inverse_kinematics = kinematics.closed_form(robot)
    pose = cell.base.pose()
    pose[:3, 3] += pose[:3, 2] * (height / MM_PER_M)
    turned_cell = replace(cell, gcode=replace(cell.gcode, redundancy_deg=turn))
    pose[:3, :3] = pose[:3, :3] @ turned_cell.tool_orientation()
    branch = inverse_kinematics.branch_of(cell.start_joints[None])[0]
    joints: Array = inverse_kinematics.branches((pose @ inverse(cell.tool.pose()))[None])[0, branch]
    return joints


def low_start(cell: Cell, robot: RobotModel, clearance: float) -> Iterator[str]:
    """Yield a warning if the tip starts below the height `clearance` to which programs retract, Z of `$BASE` [mm]."""
    tip = kinematics.tcp(robot.nominal, cell.start_joints[None], cell.tool.pose())[0][0]
    x, y, z = (inverse(cell.base.pose()) @ tip)[:3, 3] * MM_PER_M
    if z < clearance:
        yield (
            f"at [start] the tip is at X {x:.0f}, Y {y:.0f}, Z {z:.0f} of $BASE, {clearance - z:.0f} mm below "
            "clearance_Z: the first move comes from below. Give [start] joints with the tip above part and clamps."
        )
