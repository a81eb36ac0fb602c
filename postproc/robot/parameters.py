"""The parameters of the elastic model: all kinds there are, read by name and from a model file.

A further kind is a class in `KINDS` that fulfils `parameter.Spring`; identification, bound and report ask the objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from postproc.frames import Array
from postproc.robot.compensator_parameters import CompensatorPreload, CompensatorStiffness
from postproc.robot.model_file import JOINTS, ModelFile
from postproc.robot.parameter import Parameter
from postproc.robot.rest_parameters import LinkMass
from postproc.robot.spring_parameters import Backlash, FadingPart, JointCompliance, Knee, LinkSpring, LostMotion

KINDS: tuple[type[Parameter], ...] = (
    JointCompliance,
    FadingPart,
    Knee,
    Backlash,
    LostMotion,
    LinkSpring,
    CompensatorStiffness,
    CompensatorPreload,
    LinkMass,
)
"""All kinds of parameters that files may name."""
JOINT_COMPLIANCES = tuple(JointCompliance(joint) for joint in JOINTS)
COMPENSATOR: tuple[Parameter, ...] = (CompensatorStiffness(), CompensatorPreload())


def named(name: str) -> Parameter | None:
    """Return the parameter that files call so, or None.

    >>> named("k6@6.2")
    FadingPart(joint='A6', torque=6.2)
    """
    return next((found for kind in KINDS if (found := kind.named(name)) is not None), None)


def stated(content: ModelFile) -> dict[Parameter, float]:
    """Return all parameters that a model file holds, with their linear values, SI."""
    return {parameter: value for kind in KINDS for parameter, value in kind.stated(content)}


def file_slopes(parameters: Iterable[Parameter], given: Mapping[Parameter, float]) -> Array:
    """Return ∂(values in units of the file)/∂(linear values) (n, n) of parameters whose partners are among them."""
    order = list(parameters)
    out = np.zeros((len(order), len(order)))
    for row, parameter in enumerate(order):
        for other, slope in parameter.in_file(given)[1].items():
            out[row, order.index(other)] = slope
    return out
