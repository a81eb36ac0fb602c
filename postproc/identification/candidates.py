"""Which springs a robot may have: nested structures, from simple to rich.

Joint springs; compensator; gears that stiffen with the load, or with load and weights together; springs of the links in
six directions; springs where links end and under the base.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc.identification.measurements import Measurements
from postproc.identification.observability import joint_torques, levels_of, touched
from postproc.identification.structure import Structure
from postproc.robot import (
    BASE,
    COMPENSATOR,
    JOINT_COMPLIANCES,
    JOINTS,
    LINK_AXES,
    FadingPart,
    JointCompliance,
    LinkSpring,
    Parameter,
    RobotModel,
)

_TORQUE_STEPS = (0.2, 0.6, 2.0)
"""Where parts of a gear fade, over the largest torque measured on its joint."""
_LEAST_TORQUE = 1.0
"""Largest torque [N·m] on a joint below which nothing is said of its gear."""


def link_springs(robot: RobotModel, rich: bool) -> tuple[LinkSpring, ...]:
    """Return the springs of links that are told from the joints'; `rich`: also where links end, and under the base."""
    along = _along_joints(robot)
    springs = (LinkSpring(link, axis) for link in ((BASE, *JOINTS) if rich else JOINTS) for axis in LINK_AXES)
    return tuple(spring for spring in springs if spring not in along and (rich or not spring.at_end))


def _along_joints(robot: RobotModel) -> set[LinkSpring]:
    """Return the rotations about joint axes of this robot; for axes along X, Y or Z of the joint frames."""
    found = set()
    for index, joint in enumerate(JOINTS):
        here = robot.nominal.axis[index]
        before = robot.nominal.placement[index, :3, :3] @ here
        found.add(LinkSpring(joint, LINK_AXES[3 + int(np.argmax(np.abs(here)))]))
        found.add(LinkSpring((BASE, *JOINTS)[index], LINK_AXES[6 + int(np.argmax(np.abs(before)))]))
    return found


def fading_parts(
    robot: RobotModel, data: Measurements, joints: Sequence[JointCompliance] = JOINT_COMPLIANCES
) -> tuple[FadingPart, ...]:
    """Return the fading parts of the gears of joints, at a fifth to twice the largest torque measured on each."""
    largest = np.abs(joint_torques(robot, data)).max(axis=0)
    return tuple(
        FadingPart(joint.joint, float(f"{step * largest[joint.index]:.2g}"))
        for joint in joints
        for step in _TORQUE_STEPS
        if largest[joint.index] > _LEAST_TORQUE
    )


def candidates(robot: RobotModel, data: Measurements) -> list[tuple[str, Structure]]:
    """Return the nested structures, simple to rich."""
    joints = touched(robot, data)
    spring = COMPENSATOR if robot.compensator is not None and levels_of(data).max() >= 2 else ()
    gears = fading_parts(robot, data, joints)
    links, ends = link_springs(robot, rich=False), link_springs(robot, rich=True)
    # where the geometry is a weightless robot's, the gears feel weights and compensator as they feel a load
    rest = robot.subtract_reference and (robot.has_weight or bool(spring))
    lists: list[tuple[str, tuple[Parameter, ...], bool, bool]] = [  # name, parameters, offered, in gears
        ("joint springs", (), True, False),
        ("joint springs, compensator", spring, bool(spring), False),
        ("joint springs, gears stiffen", gears, True, False),
        ("springs of links", links, True, False),
        ("springs of links, compensator", (*links, *spring), bool(spring), False),
        ("springs of links, gears stiffen", (*links, *gears), True, False),
        ("springs of links, gears stiffen with load and weights", (*links, *gears), rest, True),
        ("springs of links, compensator, gears stiffen", (*links, *gears, *spring), bool(spring), False),
        ("springs of links, their ends and the base", ends, True, False),
        (
            "springs of links, their ends and the base, gears stiffen with load and weights",
            (*ends, *gears),
            rest,
            True,
        ),
    ]
    return [
        (name, Structure((*joints, *more), robot, in_gears=in_gears))
        for name, more, offered, in_gears in lists
        if offered
    ]
