"""A serial chain: joints one behind the other, each of which turns about or slides along one axis."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc.frames import Array, rotation_from_vector


class Chain(Struct, frozen=True, eq=False):
    """J joints in series and the flange on the last link. Metres, radians, kilograms.

    :param placement: (J, 4, 4) of each joint's frame on the link before it, at coordinate 0.
    :param axis: (J, 3) unit axis of each joint in its own frame.
    :param turns: (J,) True for a joint that turns, False for one that slides.
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

        For what needs every frame; `kinematics` is much faster for what the tool does.

        :param q: (N, J) coordinates [rad, m].
        """
        here = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        frames = np.empty((len(q), self.nv, 4, 4))
        for joint in range(self.nv):
            here = frames[:, joint] = here @ self.placement[joint]
            way = q[:, joint, None] * self.axis[joint]
            move = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
            if self.turns[joint]:
                move[:, :3, :3] = rotation_from_vector(way)
            else:
                move[:, :3, 3] = way
            here = here @ move
        return frames, here @ self.flange
