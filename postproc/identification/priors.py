"""Physical size of every candidate parameter, before any reading: the prior of the fit.

Readings excite some parameters and not others: a breakpoint that every reading passes, a spring that no load reaches.
One rule holds for all of them. Each parameter is normal about a mean with a spread of physical size, so that what the
readings leave open stays of that size and counts with it in the bound. The sizes:

- compliance of a joint: about the stated one;
- parts of a gear (fading, up to a breakpoint) and rotations of links: a tenth of the joint's compliance;
- translations of links: 0.01 µm/N; backlash and lost motion: 20 µrad;
- masses, size of the compensator's torque: about what the model states, with the spread it states;
- K_c and K_c·s₀, where they are free: 10⁶ N/m, 10⁶ N.

A size is common to all parameters of a kind, and is known to a factor only: `evidence` learns that factor.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.identification.structure import Structure
from postproc.program import Bools, Ints
from postproc.robot import (
    BASE,
    JOINTS,
    Backlash,
    CompensatorTorque,
    FadingPart,
    JointCompliance,
    Knee,
    LinkSpring,
    LostMotion,
    Parameter,
    RobotModel,
)

_LEAST_COMPLIANCE = 1e-9
"""Smallest compliance of a joint [rad/(N·m)] that sets a scale."""
_OF_JOINT = 0.1
"""Usual compliance of a part of a gear, and of a link's rotation, over that of the joint."""

JOINT, FIXED = "joint", ""
FACTORS: dict[str, tuple[float, float]] = {
    JOINT: (0.0, 0.7),
    "link translation": (0.0, 1.0),
    "link rotation": (0.0, 1.0),
    "end rotation": (-1.0, 1.5),
    "base translation": (-1.0, 1.5),
    "base rotation": (-2.0, 1.5),
    "fading": (0.0, 1.5),
    "breakpoint": (-1.0, 2.0),
    "backlash": (-2.0, 2.0),
    "lost motion": (-2.0, 2.0),
    "compensator": (1.0, 1.0),
}
"""Factor on the size of each kind: mean and standard deviation of its logarithm."""


class Prior(Struct, frozen=True, eq=False):
    """Prior of p parameters, SI.

    :param mean: (p,).
    :param size: (p,) standard deviation at a factor of one.
    :param kind: (p,) index into `kinds` of the factor on the size; −1 where the size is stated.
    :param kinds: names in `FACTORS`.
    :param signed: (p,) parameters that may have either sign; the others are ≥ 0.
    """

    mean: Array
    size: Array
    kind: Ints
    kinds: tuple[str, ...]
    signed: Bools


def prior_of(structure: Structure) -> Prior:
    """Return the prior of the parameters of a structure."""
    robot = structure.prior
    entries = [_entry(parameter, robot) for parameter in structure.parameters]
    kinds = tuple(name for name in FACTORS if any(name == kind for kind, _ in entries))
    stated = structure.start()
    about = np.array([kind in (JOINT, FIXED) for kind, _ in entries], dtype=bool)
    return Prior(
        mean=np.where(about, stated, 0.0),
        size=np.array([size for _, size in entries]),
        kind=np.array([kinds.index(kind) if kind in kinds else -1 for kind, _ in entries], dtype=np.int64),
        kinds=kinds,
        signed=np.array([kind == FIXED for kind, _ in entries], dtype=bool),
    )


def _entry(parameter: Parameter, robot: RobotModel) -> tuple[str, float]:
    """Return the kind of a parameter and its size, SI; `FIXED` where the robot states the spread."""
    stated = robot.prior_sigma(parameter)
    if not isinstance(parameter, JointCompliance) and np.isfinite(stated):
        return FIXED, stated
    joints = np.maximum(robot.compliance[list(robot.actuated)], _LEAST_COMPLIANCE)
    match parameter:
        case JointCompliance():
            return JOINT, float(joints[parameter.index])
        case LinkSpring():
            part = "base" if parameter.link == BASE else "end" if parameter.at_end else "link"
            if parameter.slides:
                return f"{part} translation", parameter.usual
            of_joint = joints[0 if parameter.link == BASE else JOINTS.index(parameter.link)]
            return f"{part} rotation", float(_OF_JOINT * of_joint)
        case LostMotion() | Backlash():
            return "lost motion" if isinstance(parameter, LostMotion) else "backlash", parameter.usual
        case FadingPart():
            kind = "breakpoint" if isinstance(parameter, Knee) else "fading"
            return kind, float(_OF_JOINT * joints[JOINTS.index(parameter.joint)])
        case CompensatorTorque():
            return "compensator", parameter.usual
    return FIXED, parameter.usual
