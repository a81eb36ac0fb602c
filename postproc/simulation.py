"""A program as the controller drives it: what it commands at places of its motions, and where the loaded tip is.

One simulation for all: `correction.verify` moves the arm through the written program, `comparison` through both of its
programs. Lines, arcs, pieces of splines and joint motions are those of `toolpath.at`; the arm is that of
`under_load.RobotInCell`. Places on approximated corners are not among these: `correction.targets.Corners` says how far
a path leaves them.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import kinematics, toolpath
from postproc.frames import Array
from postproc.program import PTP, SPL, Bools, Ints, Program
from postproc.toolpath import Segments
from postproc.under_load import RobotInCell

_MAX_LENGTH, _MAX_ROTATION = 0.005, 0.02
"""Pieces of a path that are longer [m] or turn the tool by more [rad] are looked at between their ends: on shorter ones
the deflection is linear."""
_SPACING = 0.010
"""Distance of places looked at on them [m] (assumed)."""
_PLACES_ON_RAMPS = 4
"""Number of places looked at where the correction changes much over a piece, or unevenly along an arc (assumed)."""


class DrivenProgram(Struct, frozen=True, eq=False, dict=True):
    """A program of M motions as the controller of a robot drives it.

    A place on it is (motion, t): row of `Motions`, and share of that motion in (0, 1]. The cell is the robot root where
    that is at E1 = 0.

    :param segments: the geometry of its motions.
    """

    program: Program
    robot_in_cell: RobotInCell
    segments: Segments

    def commanded_poses(self, motion: Ints, t: Array, branch: Ints) -> tuple[Array, Array]:
        """Return the commanded tool poses (n, 4, 4) in `$BASE` [m] and joint angles (n, 6) [rad]; NaN out of reach.

        :param branch: (n,) branch of the inverse kinematics.
        """
        pose = toolpath.at(self.program, self.segments, motion, t).pose[:]
        flange = toolpath.flange_from_tcp(self.program, motion, pose, t)
        return pose, kinematics.branch_joints(self.robot_in_cell.robot, flange, branch)

    def carriage_displacement(self, motion: Ints, t: Array | float = 1.0) -> Array:
        """Return the displacement (n, 3) [m] of the robot by E1 at places (motion, t)."""
        carriage = self.program.carriage
        return np.zeros((len(motion), 3)) if carriage is None else carriage.offset(motion, t)

    def loaded_tip(
        self, motion: Ints, q: Array, wrench: Array, displacement: Array, guess: Array | None = None
    ) -> Array:
        """Return the loaded tip (n, 3) of the tool of motions (n,), in the cell [m].

        :param q: (n, 6) joint angles that the controller commands [rad]; those of another program may be given.
        :param wrench: (n, 6) at the tip, root axes [N, N·m].
        :param displacement: (n, 3) displacement of the robot by E1 [m].
        :param guess: (n, nv) initial guess of the deflections of the springs; None: zero.
        :raises NotConvergedError: no loaded equilibrium.
        """
        tool = toolpath.tool_of(self.program, motion)
        return np.asarray(self.robot_in_cell.tip(q, tool, wrench, guess) + displacement)

    def to_base(self, motion: Ints, point: Array) -> Array:
        """Return points (n, 3) of the cell in the `$BASE` of motions (n,) [m]."""
        return toolpath.points_in_base(self.program, motion, point, None)


def number_of_places(kind: Ints, length: Array, turn: Array, *, is_curved: Bools, is_steep: Bools) -> Ints:
    """Return at how many places the error on each piece of a path (n,) is computed, the last one at its end.

    :param kind: (n,) `LIN`, `CIRC`, `PTP` or `SPL`: only the ends of PTPs and of pieces of splines are known.
    :param length: (n,) [m], `turn` (n,) rotation of the tool [rad].
    :param is_curved: (n,) True for pieces of arcs, or that replace one, and where the force changes within the piece.
    :param is_steep: (n,) True where the correction changes much, or unevenly, over the piece.
    """
    number = np.where(is_curved, 2, 1)
    is_long = (length > _MAX_LENGTH) | (turn > _MAX_ROTATION)
    number[is_long] = np.maximum(2, toolpath.even_parts(length[is_long], turn[is_long], _SPACING, _MAX_ROTATION))
    number[is_steep] = np.maximum(number[is_steep], _PLACES_ON_RAMPS)
    number[(kind == PTP) | (kind == SPL)] = 1
    return number.astype(np.int64)
