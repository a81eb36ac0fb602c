"""Flexible links: one Pinocchio coordinate for each spring between the joints of a chain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import pinocchio as pin

from postproc.robot.model_file import BASE, FLANGE, JOINTS

LINK_AXES = ("X", "Y", "Z", "RX", "RY", "RZ", "end_RX", "end_RY", "end_RZ")
_JOINT_OF_AXIS = {
    "X": pin.JointModelPX,
    "Y": pin.JointModelPY,
    "Z": pin.JointModelPZ,
    "RX": pin.JointModelRX,
    "RY": pin.JointModelRY,
    "RZ": pin.JointModelRZ,
}


class VirtualSpring(NamedTuple):
    """A spring of a link: `link` is base, A1…A6; `axis` is X, Y, Z, RX, RY, RZ or end_RX, end_RY, end_RZ."""

    link: str
    axis: str


def elastic_chain(model: pin.Model, springs: Sequence[VirtualSpring]) -> tuple[pin.Model, tuple[int, ...], list[int]]:
    """Insert one coordinate per link spring into a chain of six joints.

    Springs where a link begins follow its joint (for `base`: the root), springs where it ends stand at the place of
    the next joint (for A6: the flange). The mass of a link sits between the two.

    :returns: the chain, the coordinates of A1…A6 in it, and those of `springs`.
    """
    chain = pin.Model()
    chain.name = model.name
    chain.gravity = model.gravity
    flange = model.frames[model.getFrameId(FLANGE)]
    rows: dict[VirtualSpring, int] = {}
    actuated: list[int] = []
    parent, place, at_next = 0, pin.SE3.Identity(), False

    def add(kind: Any, name: str) -> int:
        nonlocal parent, place
        parent = chain.addJoint(parent, kind, place, name)
        place = pin.SE3.Identity()
        return int(chain.joints[parent].idx_v)

    for index, link in enumerate((BASE, *JOINTS)):
        if index:
            place = place * (model.jointPlacements[index] if not at_next else pin.SE3.Identity())
            actuated.append(add(model.joints[index], link))
        at_next = False
        for spring in springs:
            if spring.link == link and not spring.axis.startswith("end_"):
                rows[spring] = add(_JOINT_OF_AXIS[spring.axis](), f"{link}.{spring.axis}")
        if index:
            chain.appendBodyToJoint(parent, model.inertias[index], pin.SE3.Identity())
        ends = [spring for spring in springs if spring.link == link and spring.axis.startswith("end_")]
        if ends:
            place = flange.placement if link == JOINTS[-1] else model.jointPlacements[index + 1]
            at_next = True
            for spring in ends:
                rows[spring] = add(_JOINT_OF_AXIS[spring.axis.removeprefix("end_")](), f"{link}.{spring.axis}")
    placement = pin.SE3.Identity() if at_next else flange.placement
    chain.addFrame(pin.Frame(FLANGE, parent, placement, pin.FrameType.BODY))
    return chain, tuple(actuated), [rows[spring] for spring in springs]
