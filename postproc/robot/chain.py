"""A serial chain: joints in series, each a rotation about or a translation along one axis; and flexible links in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.frames import Array, rotation_from_vector
from postproc.robot.model_file import BASE, JOINTS
from postproc.robot.parameters import LinkSpring


class Chain(Struct, frozen=True, eq=False):
    """J joints in series and the flange on the last link. Metres, radians, kilograms.

    :param placement: (J, 4, 4) of each joint's frame on the link before it, at coordinate 0.
    :param axis: (J, 3) unit axis of each joint in its own frame.
    :param is_revolute: (J,) True for a joint that turns about its axis, False for one that slides along it.
    :param flange: (4, 4) of the flange on the last link.
    :param mass: (J,) of the link that each joint carries.
    :param centre: (J, 3) centre of mass of this link in the frame of the joint.
    :param lower: (J,) least coordinates; −inf without a limit.
    :param upper: (J,) largest coordinates; inf without a limit.
    :param speed: (J,) speed limits.
    :param effort: (J,) largest torques [N·m]; 0 if not stated.
    """

    placement: Array
    axis: Array
    is_revolute: NDArray[np.bool_]
    flange: Array
    mass: Array
    centre: Array
    lower: Array
    upper: Array
    speed: Array
    effort: Array

    @property
    def nv(self) -> int:
        """Number of coordinates."""
        return len(self.axis)

    def with_root(self, root: Array) -> Chain:
        """Return the chain displaced as a whole by the pose `root` (4, 4), in root axes [m]."""
        return replace(self, placement=np.concatenate([(root @ self.placement[0])[None], self.placement[1:]]))

    def with_payload(self, mass: float, centre: Array) -> Chain:
        """Return the chain with a further mass [kg] on its last link, with its centre (3,) in the flange frame [m]."""
        return self.with_mass(-1, mass, self.flange[:3, :3] @ centre + self.flange[:3, 3])

    def with_mass(self, row: int, mass: float, centre: Array) -> Chain:
        """Return the chain with a further mass on the link of a joint.

        :param row: index of the joint.
        :param mass: [kg]; negative to take mass away.
        :param centre: (3,) centre of the further mass in the frame of the joint [m].
        """
        masses, centres = self.mass.copy(), self.centre.copy()
        masses[row] += mass
        if masses[row] != 0.0:  # a link without mass keeps its old centre
            centres[row] = (self.mass[row] * self.centre[row] + mass * centre) / masses[row]
        return replace(self, mass=masses, centre=centres)

    def joint_frames(self, q: Array) -> tuple[Array, Array]:
        """Return the frames of all joints and of the flange.

        For code that needs every frame; for the tool alone `kinematics` is much faster.

        :param q: (N, J) coordinates [rad, m].
        :returns: (N, J, 4, 4) frame of each joint before its own motion; (N, 4, 4) of the flange; both in the root [m].
        """
        frame = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        frames = np.empty((len(q), self.nv, 4, 4))
        vectors = q.T[:, :, None] * self.axis[:, None]  # (J, N, 3): rotation vectors, or translations
        rotations = rotation_from_vector(vectors)  # of all joints at once: a call for each takes several times as long
        for joint in range(self.nv):
            frame = frames[:, joint] = frame @ self.placement[joint]
            motion = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
            if self.is_revolute[joint]:
                motion[:, :3, :3] = rotations[joint]
            else:
                motion[:, :3, 3] = vectors[joint]
            frame = frame @ motion
        return frames, frame @ self.flange


class _Axes:
    """Axes of a chain under construction: joints and springs.

    :ivar placement: (4, 4) of the frame of each axis in the frame of the axis before it [m].
    :ivar axis: (3,) unit direction of each axis in its frame.
    :ivar is_revolute: whether each axis turns; else it slides.
    :ivar place: (4, 4) pose of the end of the chain in the frame of the last axis [m].
    """

    def __init__(self) -> None:
        """Begin without axes, at the root."""
        self.placement: list[Array] = []
        self.axis: list[Array] = []
        self.is_revolute: list[bool] = []
        self.place = np.eye(4)

    def add(self, direction: Array, *, is_revolute: bool) -> int:
        """Add an axis of a direction (3,) at the end of the chain, which turns or slides; return its row.

        The new axis becomes the last, so that `place` is the identity.
        """
        self.placement.append(self.place)
        self.axis.append(direction)
        self.is_revolute.append(is_revolute)
        self.place = np.eye(4)
        return len(self.axis) - 1


class ElasticChain(NamedTuple):
    """A chain with a coordinate for each joint and each link spring.

    :param chain: joints and springs in series.
    :param joint_rows: (6,) coordinates of A1…A6 in the chain.
    :param spring_rows: coordinates of the springs in the chain, in the order of the springs of `elastic_chain`.
    """

    chain: Chain
    joint_rows: tuple[int, ...]
    spring_rows: list[int]


def elastic_chain(chain: Chain, springs: Sequence[LinkSpring]) -> ElasticChain:
    """Insert one coordinate per link spring into a chain of six joints.

    Springs at the beginning of a link follow its joint (for `base`: the root). Springs at the end of a link are at the
    origin of the next joint (for A6: the flange). The mass of the link is after the former and before the latter.

    :param chain: of six joints.
    :param springs: without duplicates.
    """
    axes = _Axes()
    spring_row: dict[LinkSpring, int] = {}
    joint_row: list[int] = []
    mass_row: list[int] = []  # the last axis before the body of the link
    for joint, link in enumerate((BASE, *JOINTS), start=-1):  # the link that a joint carries; joint −1: the base
        link_springs = [spring for spring in springs if spring.link == link]
        if link != BASE:
            joint_row.append(axes.add(chain.axis[joint], is_revolute=True))
        spring_row |= {s: axes.add(s.direction, is_revolute=not s.slides) for s in link_springs if not s.at_end}
        if link != BASE:
            mass_row.append(len(axes.axis) - 1)
        axes.place = axes.place @ (chain.flange if link == JOINTS[-1] else chain.placement[joint + 1])
        spring_row |= {s: axes.add(s.direction, is_revolute=not s.slides) for s in link_springs if s.at_end}

    def over_axes(values: Array, rows: list[int], default: float) -> Array:
        """Return an array over all axes: the values (6, ...) of joints or links at their rows, a default at others."""
        array = np.full((len(axes.axis), *values.shape[1:]), default)
        array[rows] = values
        return array

    return ElasticChain(
        Chain(
            placement=np.array(axes.placement),
            axis=np.array(axes.axis),
            is_revolute=np.array(axes.is_revolute),
            flange=axes.place,
            mass=over_axes(chain.mass, mass_row, 0.0),
            centre=over_axes(chain.centre, mass_row, 0.0),
            lower=over_axes(chain.lower, joint_row, -np.inf),
            upper=over_axes(chain.upper, joint_row, np.inf),
            speed=over_axes(chain.speed, joint_row, np.inf),
            effort=over_axes(chain.effort, joint_row, 0.0),
        ),
        tuple(joint_row),
        [spring_row[spring] for spring in springs],
    )
