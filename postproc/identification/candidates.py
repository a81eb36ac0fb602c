"""Which springs a robot may have, and the structures made of them that are tried, from simple to rich.

Joint springs; compensator; gears that stiffen with the load, smoothly or with knees, and have backlash; springs of the
links in six directions; springs where links end and under the base. Where gears feel the weights and the compensator at
rest, these are looked for too, about what the prior states of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from postproc.frames import Array
from postproc.identification.measurements import Measurements
from postproc.identification.observability import joint_torques, levels_of, touched
from postproc.identification.structure import Structure
from postproc.robot import (
    BASE,
    COMPENSATOR,
    JOINTS,
    LINK_AXES,
    Backlash,
    CompensatorSize,
    FadingPart,
    JointCompliance,
    Knee,
    LinkMass,
    LinkSpring,
    LostMotion,
    Parameter,
    RobotModel,
)

JOINT, COMPENSATOR_SPRING, LINK, END, AT_REST = "joint", "compensator", "link", "end", "at rest"
FADING, KNEE, BACKLASH, LOST_MOTION = "fading", "knee", "backlash", "lost motion"
"""Kinds of springs, of which structures are made."""
GEARS = (FADING, KNEE, BACKLASH, LOST_MOTION)
"""Those of gears that do not give way in proportion to the torque."""

_FADE_AT = (0.2, 0.6, 2.0)
"""Where parts of a gear fade, over the largest torque measured on its joint."""
_KNEES_AT = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
"""Where parts of a gear end: milling loads it to some hundredths of what weights do that show its springs."""
_TURNS_OVER_AT = (0.01,)
"""Torque that turns a gear with backlash over to its other flank."""
_ONE_LINE = 1e-3
"""Distance [m] between axes that are one line."""
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
        link, axis = (BASE, *JOINTS)[index], int(np.argmax(np.abs(before)))
        found.add(LinkSpring(link, LINK_AXES[6 + axis]))
        if np.linalg.norm(np.cross(before, robot.nominal.placement[index, :3, 3])) < _ONE_LINE:
            found.add(LinkSpring(link, LINK_AXES[3 + axis]))  # the link begins on the axis of the joint at its end
    return found


def _gears(
    kind: type[FadingPart | Backlash], steps: Sequence[float], joints: Sequence[JointCompliance], largest: Array
) -> Iterator[Parameter]:
    for joint in joints:
        if largest[joint.index] > _LEAST_TORQUE:
            for step in steps:
                yield kind(joint.joint, float(f"{step * largest[joint.index]:.2g}"))


def everything(
    robot: RobotModel, data: Measurements, in_gears: bool, compensator: bool
) -> tuple[Structure, tuple[str, ...]]:
    """Return the structure with all springs that a robot may have, and of which kind each parameter is.

    :param compensator: K_c and s₀ are looked for, and not the prior's.
    """
    joints = touched(robot, data)
    largest = np.abs(joint_torques(robot, data)).max(axis=0)
    links, ends = link_springs(robot, rich=False), link_springs(robot, rich=True)
    of_kind: dict[str, Iterable[Parameter]] = {
        JOINT: joints,
        COMPENSATOR_SPRING: COMPENSATOR if compensator else (),
        LINK: links,
        END: (spring for spring in ends if spring not in links),
        FADING: _gears(FadingPart, _FADE_AT, joints, largest),
        KNEE: _gears(Knee, _KNEES_AT, joints, largest),
        BACKLASH: _gears(Backlash, _TURNS_OVER_AT, joints, largest),
        # where gears feel the load alone, backlash is lost motion
        LOST_MOTION: _gears(LostMotion, _TURNS_OVER_AT, joints, largest) if in_gears else (),
        # a compensator that is free presses on joint 2 as it likes: masses beside it are told by nothing
        AT_REST: _at_rest(robot) if not compensator and (in_gears or not robot.subtract_reference) else (),
    }
    pairs = [(parameter, kind) for kind, parameters in of_kind.items() for parameter in parameters]
    return Structure(tuple(p for p, _ in pairs), robot, in_gears=in_gears), tuple(kind for _, kind in pairs)


def _at_rest(robot: RobotModel) -> Iterator[Parameter]:
    """Yield what presses on the gears at rest, and how strongly is not certain: masses and compensator."""
    wanted: list[Parameter] = [LinkMass(joint) for joint in JOINTS[1:]]
    if robot.compensator is not None:
        wanted.append(CompensatorSize())
    return (parameter for parameter in wanted if parameter.spread(robot) > 0.0)


def has_compensator(robot: RobotModel, data: Measurements) -> bool:
    """Return whether a compensator can be looked for: three levels of q2 show how joint 2 changes along its range."""
    return robot.compensator is not None and int(levels_of(data).max()) >= 2


def candidates(compensator: bool) -> list[tuple[str, tuple[str, ...]]]:
    """Return names and kinds of springs of the structures that are tried, simple to rich.

    What gears feel at rest goes along with every structure in which they do not give way in proportion.
    """
    gears: list[tuple[str, tuple[str, ...]]] = [
        ("", ()),
        (", gears stiffen", (FADING,)),
        (", gears with knees", (KNEE,)),
        (", gears stiffen, with knees", (FADING, KNEE)),
        (", gears stiffen, with backlash", (FADING, BACKLASH)),
        (", gears with knees and backlash", (KNEE, BACKLASH)),
        (", gears stiffen, with knees and backlash", (FADING, KNEE, BACKLASH)),
        (", gears stiffen, with lost motion", (FADING, LOST_MOTION)),
        (", gears with knees and lost motion", (KNEE, LOST_MOTION)),
        (", gears stiffen, with knees and lost motion", (FADING, KNEE, LOST_MOTION)),
    ]
    arms: list[tuple[str, tuple[str, ...], list[tuple[str, tuple[str, ...]]]]] = [
        ("joint springs", (JOINT,), gears[:2]),
        ("springs of links", (JOINT, LINK), gears),
        ("springs of links, their ends and the base", (JOINT, LINK, END), [gears[1], gears[3], gears[6], gears[9]]),
    ]
    extra, told = ((COMPENSATOR_SPRING,), ", compensator") if compensator else ((), "")
    return [
        (arm + told + gear, (*kinds, *extra, *more)) for arm, kinds, with_gears in arms for gear, more in with_gears
    ]
