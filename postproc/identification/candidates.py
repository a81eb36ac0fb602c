"""Candidate parameters of a robot, and the structures made of them that are tried, from simple to rich.

Joint springs; compensator; gears whose compliance falls with the load, smoothly or at breakpoints, and which have
backlash or lost motion; springs of the links in six directions; springs where links end and under the base. Where the
gears carry the weights and the compensator's torque at rest, masses and compensator are parameters too, about what the
prior states.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from postproc.frames import Array
from postproc.identification.measurements import Measurements
from postproc.identification.observability import joint_torques, levels_of, unloaded
from postproc.identification.structure import Structure
from postproc.robot import (
    BASE,
    COMPENSATOR,
    JOINT_COMPLIANCES,
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
FADING, KNEE, BACKLASH, LOST_MOTION = "fading", "breakpoint", "backlash", "lost motion"
"""Kinds of parameters, of which structures are made."""
GEARS = (FADING, KNEE, BACKLASH, LOST_MOTION)
"""Kinds of gears whose deflection is not proportional to the torque."""

_FADE_AT = (0.2, 0.6, 2.0)
"""Torque at which parts of a gear fade, over the largest measured on its joint."""
_BREAKPOINTS_AT = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.28)
"""Breakpoints of a gear, over the largest torque: milling needs some hundredths of the torque that shows a spring."""
_TURNS_OVER_AT = (0.01,)
"""Torque that moves a gear with backlash to its other flank, over the largest."""
_ONE_LINE = 1e-3
"""Distance [m] between axes that count as one line."""
_LEAST_TORQUE = 1.0
"""Largest torque [N·m] on a joint below which its gear has no parameters of its own."""


def link_springs(robot: RobotModel, rich: bool) -> tuple[LinkSpring, ...]:
    """Return the springs of links that differ from those of the joints.

    :param rich: also springs where links end, and under the base.
    """
    along = _along_joints(robot)
    springs = (LinkSpring(link, axis) for link in ((BASE, *JOINTS) if rich else JOINTS) for axis in LINK_AXES)
    return tuple(spring for spring in springs if spring not in along and (rich or not spring.at_end))


def _along_joints(robot: RobotModel) -> set[LinkSpring]:
    """Return the rotations that are about a joint axis; for axes along X, Y or Z of the joint frames."""
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
    """Return the structure with all candidate parameters, and the kind of each.

    :param in_gears: the gears carry weights and compensator at rest.
    :param compensator: K_c and s₀ are free.
    """
    bare = unloaded(robot, data)
    joints = [joint for joint in JOINT_COMPLIANCES if joint not in bare]
    largest = np.abs(joint_torques(robot, data)).max(axis=0)
    links, ends = link_springs(robot, rich=False), link_springs(robot, rich=True)
    of_kind: dict[str, Iterable[Parameter]] = {
        JOINT: JOINT_COMPLIANCES,
        COMPENSATOR_SPRING: COMPENSATOR if compensator else (),
        LINK: links,
        END: (spring for spring in ends if spring not in links),
        FADING: _gears(FadingPart, _FADE_AT, joints, largest),
        KNEE: _gears(Knee, _BREAKPOINTS_AT, joints, largest),
        BACKLASH: _gears(Backlash, _TURNS_OVER_AT, joints, largest),
        # where gears carry the load alone, backlash is lost motion
        LOST_MOTION: _gears(LostMotion, _TURNS_OVER_AT, joints, largest) if in_gears else (),
        # a free compensator replaces the weights on joint 2: masses are not identifiable then
        AT_REST: _at_rest(robot) if not compensator and (in_gears or not robot.subtract_reference) else (),
    }
    pairs = [(parameter, kind) for kind, parameters in of_kind.items() for parameter in parameters]
    return Structure(tuple(p for p, _ in pairs), robot, in_gears=in_gears), tuple(kind for _, kind in pairs)


def _at_rest(robot: RobotModel) -> Iterator[Parameter]:
    """Yield the uncertain sources of torque on the gears at rest: masses and compensator."""
    wanted: list[Parameter] = [LinkMass(joint) for joint in JOINTS[1:]]
    if robot.compensator is not None:
        wanted.append(CompensatorSize())
    return (parameter for parameter in wanted if robot.prior_sigma(parameter) > 0.0)


def has_compensator(robot: RobotModel, data: Measurements) -> bool:
    """Return whether K_c and s₀ can be identified: there is a compensator, and three levels of q2 or more."""
    return robot.compensator is not None and int(levels_of(data).max()) >= 2


def candidates(compensator: bool) -> list[tuple[str, tuple[str, ...]]]:
    """Return the structures to try, from simple to rich: name, and kinds of parameters.

    Masses and compensator at rest are part of every structure with gears that are not linear.
    """
    gears: list[tuple[str, tuple[str, ...]]] = [
        ("", ()),
        (", gears stiffen", (FADING,)),
        (", gears with breakpoints", (KNEE,)),
        (", gears stiffen, with breakpoints", (FADING, KNEE)),
        (", gears stiffen, with backlash", (FADING, BACKLASH)),
        (", gears with breakpoints and backlash", (KNEE, BACKLASH)),
        (", gears stiffen, with breakpoints and backlash", (FADING, KNEE, BACKLASH)),
        (", gears stiffen, with lost motion", (FADING, LOST_MOTION)),
        (", gears with breakpoints and lost motion", (KNEE, LOST_MOTION)),
        (", gears stiffen, with breakpoints and lost motion", (FADING, KNEE, LOST_MOTION)),
    ]
    rich = [gears[index] for index in (0, 1, 2, 3, 6, 9)]
    arms: list[tuple[str, tuple[str, ...], list[tuple[str, tuple[str, ...]]]]] = [
        ("joint springs", (JOINT,), gears[:2]),
        ("link springs", (JOINT, LINK), gears),
        ("link springs, link ends and base", (JOINT, LINK, END), rich),
    ]
    extra, label = ((COMPENSATOR_SPRING,), ", compensator") if compensator else ((), "")
    return [
        (arm + label + gear, (*kinds, *extra, *more)) for arm, kinds, with_gears in arms for gear, more in with_gears
    ]
