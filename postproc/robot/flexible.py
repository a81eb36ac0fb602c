"""Flexible links: one coordinate for each spring between the joints of a chain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc.frames import Array
from postproc.robot.chain import Chain
from postproc.robot.model_file import BASE, JOINTS
from postproc.robot.spring_parameters import LinkSpring


def elastic_chain(chain: Chain, springs: Sequence[LinkSpring]) -> tuple[Chain, tuple[int, ...], list[int]]:
    """Insert one coordinate per link spring into a chain of six joints.

    Springs where a link begins follow its joint (for `base`: the root), springs where it ends stand at the place of
    the next joint (for A6: the flange). The mass of a link sits between the two.

    :returns: the chain, the coordinates of A1…A6 in it, and those of `springs`.
    """
    rows: dict[LinkSpring, int] = {}
    actuated: list[int] = []
    placement: list[Array] = []
    from_joint: list[int] = []
    axis: list[Array] = []
    turns: list[bool] = []
    carried: dict[int, int] = {}
    place = np.eye(4)

    def add(direction: Array, turning: bool, joint: int = -1) -> int:
        nonlocal place
        placement.append(place)
        axis.append(direction)
        turns.append(turning)
        from_joint.append(joint)
        place = np.eye(4)
        return len(axis) - 1

    def add_spring(spring: LinkSpring) -> None:
        rows[spring] = add(spring.direction, not spring.slides)

    for index, link in enumerate((BASE, *JOINTS)):
        if index:
            actuated.append(add(chain.axis[index - 1], True, index - 1))
        own = [spring for spring in springs if spring.link == link]
        for spring in own:
            if not spring.at_end:
                add_spring(spring)
        if index:
            carried[len(axis) - 1] = index - 1
        place = place @ (chain.placement[index] if index < len(JOINTS) else chain.flange)
        for spring in own:
            if spring.at_end:
                add_spring(spring)

    def spread(values: Array, source: dict[int, int], otherwise: float) -> Array:
        out = np.full((len(axis), *values.shape[1:]), otherwise)
        out[list(source)] = values[list(source.values())]
        return out

    joints = {row: joint for row, joint in enumerate(from_joint) if joint >= 0}
    longer = Chain(
        placement=np.array(placement),
        axis=np.array(axis),
        turns=np.array(turns),
        flange=place,
        mass=spread(chain.mass, carried, 0.0),
        centre=spread(chain.centre, carried, 0.0),
        lower=spread(chain.lower, joints, -np.inf),
        upper=spread(chain.upper, joints, np.inf),
        speed=spread(chain.speed, joints, np.inf),
        effort=spread(chain.effort, joints, 0.0),
    )
    return longer, tuple(actuated), [rows[spring] for spring in springs]
