"""A serial chain: joints in series, each a rotation about or a translation along one axis; and flexible links in it."""

from __future__ import annotations

from collections.abc import Sequence

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
    :param turns: (J,) True for a rotation, False for a translation.
    :param flange: (4, 4) of the flange on the last link.
    :param mass: (J,) of the link that each joint carries.
    :param centre: (J, 3) its centre of mass in the frame of the joint.
    :param lower: (J,) limits; infinite where there are none.
    :param upper: (J,) limits.
    :param speed: (J,) speed limits.
    :param effort: (J,) largest torques [N·m]; 0 where not stated.
    """

    placement: Array
    axis: Array
    turns: NDArray[np.bool_]
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
        """Return the chain displaced by (4, 4) in its root [m]."""
        return replace(self, placement=np.concatenate([(root @ self.placement[0])[None], self.placement[1:]]))

    def with_payload(self, mass: float, centre: Array) -> Chain:
        """Return the chain with a further mass on its last link; its centre (3,) is given in the flange frame."""
        return self.with_mass(-1, mass, self.flange[:3, :3] @ centre + self.flange[:3, 3])

    def with_mass(self, row: int, mass: float, centre: Array) -> Chain:
        """Return the chain with a further mass, or less of it, on the link of a joint; its centre (3,) in its frame."""
        masses, centres = self.mass.copy(), self.centre.copy()
        masses[row] += mass
        if masses[row] != 0.0:
            centres[row] = (self.mass[row] * self.centre[row] + mass * centre) / masses[row]
        return replace(self, mass=masses, centre=centres)

    def joint_frames(self, q: Array) -> tuple[Array, Array]:
        """Return the frames of the joints before they move (N, J, 4, 4), and of the flange (N, 4, 4), in the root [m].

        For code that needs every frame; for the tool alone `kinematics` is much faster.

        :param q: (N, J) coordinates [rad, m].
        """
        frame = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        frames = np.empty((len(q), self.nv, 4, 4))
        vector = q.T[:, :, None] * self.axis[:, None]
        turn = rotation_from_vector(vector)  # of all joints at once: a call for each takes several times as long
        for joint in range(self.nv):
            frame = frames[:, joint] = frame @ self.placement[joint]
            move = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
            if self.turns[joint]:
                move[:, :3, :3] = turn[joint]
            else:
                move[:, :3, 3] = vector[joint]
            frame = frame @ move
        return frames, frame @ self.flange


class _Axes:
    """Axes of a chain so far: joints and springs.

    :ivar place: (4, 4) pose behind the last axis, in its frame [m].
    """

    def __init__(self) -> None:
        self.placement: list[Array] = []
        self.axis: list[Array] = []
        self.turns: list[bool] = []
        self.place = np.eye(4)

    def add(self, direction: Array, *, turns: bool) -> int:
        """Add an axis of a direction (3,) at `place`, which turns or slides; return its row."""
        self.placement.append(self.place)
        self.axis.append(direction)
        self.turns.append(turns)
        self.place = np.eye(4)
        return len(self.axis) - 1


def elastic_chain(chain: Chain, springs: Sequence[LinkSpring]) -> tuple[Chain, tuple[int, ...], list[int]]:
    """Insert one coordinate per link spring into a chain of six joints.

    Springs at the beginning of a link follow its joint (for `base`: the root), springs at its end are at the origin of
    the next joint (for A6: the flange). The mass of the link is between the two.

    :returns: the chain, the coordinates of A1…A6 in it, and those of `springs`.
    """
    axes = _Axes()
    rows: dict[LinkSpring, int] = {}
    joint_rows: list[int] = []
    link_of_row: dict[int, int] = {}
    for index, link in enumerate((BASE, *JOINTS)):
        link_springs = [spring for spring in springs if spring.link == link]
        if index:
            joint_rows.append(axes.add(chain.axis[index - 1], turns=True))
        rows |= {s: axes.add(s.direction, turns=not s.slides) for s in link_springs if not s.at_end}
        if index:
            link_of_row[len(axes.axis) - 1] = index - 1
        axes.place = axes.place @ (chain.placement[index] if index < len(JOINTS) else chain.flange)
        rows |= {s: axes.add(s.direction, turns=not s.slides) for s in link_springs if s.at_end}

    def over_axes(values: Array, source: dict[int, int], default: float) -> Array:
        """Return an array over all axes: at row r the value `source[r]`, elsewhere a default."""
        array = np.full((len(axes.axis), *values.shape[1:]), default)
        array[list(source)] = values[list(source.values())]
        return array

    joints = {row: joint for joint, row in enumerate(joint_rows)}
    result = Chain(
        placement=np.array(axes.placement),
        axis=np.array(axes.axis),
        turns=np.array(axes.turns),
        flange=axes.place,
        mass=over_axes(chain.mass, link_of_row, 0.0),
        centre=over_axes(chain.centre, link_of_row, 0.0),
        lower=over_axes(chain.lower, joints, -np.inf),
        upper=over_axes(chain.upper, joints, np.inf),
        speed=over_axes(chain.speed, joints, np.inf),
        effort=over_axes(chain.effort, joints, 0.0),
    )
    return result, tuple(joint_rows), [rows[spring] for spring in springs]
