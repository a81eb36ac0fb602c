"""Samples of the path of a program with loads and joint angles, in the root frame of the robot."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc import toolpath
from postproc.frames import Array
from postproc.kinematics import JointPath, UnreachableError
from postproc.program import Ints, Program, read_only
from postproc.toolpath import Pieces, Toolpath
from postproc.under_load import bounds
from postproc.under_load.motions import MotionsUnderLoad
from postproc.under_load.setting import RobotInCell


class PathUnderLoad(Struct, frozen=True, eq=False):
    """N samples of the nominal path of a program. Row i of every array is the same sample.

    :param motions: the motions and the forces along them.
    :param arcs: the pieces of its arcs.
    :param sample: the places and their poses in `$BASE`.
    :param wrench: (N, 6) wrench on the tool at its tip [N, N·m], `$BASE` axes.
    :param joints: joint angles by the controller's nominal geometry, and their branch.
    """

    motions: MotionsUnderLoad
    arcs: Pieces
    sample: Toolpath
    wrench: Array
    joints: JointPath

    @classmethod
    def of(cls, motions: MotionsUnderLoad, arcs: Pieces, also: tuple[Ints, Array] | None = None) -> PathUnderLoad:
        """Sample the motions as closely as arcs and forces need, and solve the joint angles.

        :param arcs: the pieces of the arcs.
        :param also: places of straight motions that are needed: motion (n,) and t (n,); by default `motions.swung`.
        :raises ImpossiblePathError: a sample is out of reach.
        """
        program, setting = motions.program, motions.setting
        also = motions.swung if also is None else also
        motion, t = toolpath.places(program, motions.segments, setting.tolerance, motions.estimate, arcs, also)
        sample = toolpath.at(program, motions.segments, motion, t)
        try:
            joints = setting.follow(program, motion, t, sample.pose)
        except UnreachableError as cause:
            raise bounds.ImpossiblePathError(bounds.unreachable(program, motion[list(cause.rows)])) from None
        return read_only(cls(motions, arcs, sample, motions.forces.at(sample), joints))

    def __len__(self) -> int:
        return len(self.sample)

    @property
    def program(self) -> Program:
        """The program."""
        return self.motions.program

    def tool(self, rows: Ints) -> Array:
        """Return `$TOOL` in the flange frame at samples (n,) [m]: (4, 4) if the program has one, else (n, 4, 4)."""
        return toolpath.tool_of(self.program, self.sample.motion[rows])

    def pose_in_root(self, rows: Ints) -> Array:
        """Return the tool frame in the robot root at samples (n,): (n, 4, 4) [m]."""
        motion, t = self.sample.motion[rows], self.sample.t[rows]
        return toolpath.pose_in_root(self.program, motion, self.sample.pose.take(rows, axis=0), t)

    def wrench_in_root(self, rows: Ints) -> Array:
        """Return the wrench in root axes at samples (n,): (n, 6) [N, N·m]."""
        return toolpath.wrench_in_root(self.program, self.sample.motion[rows], self.wrench.take(rows, axis=0))

    def tip_in_base(self, rows: Ints, q: Array, wrench_in_root: Array, guess: Array) -> tuple[Array, Array]:
        """Return the loaded tip (n, 3) at samples (n,), and the deflection of holder, spindle and tool (n, 3).

        Both are in the `$BASE` of the motions [m]; the deflection is included in the tip position.

        :param q: (n, 6) joint angles [rad].
        :param wrench_in_root: (n, 6) [N, N·m].
        :param guess: (n, nv) initial guess of the deflections of the springs.
        :raises NotConvergedError: no loaded equilibrium: the load is too large for the springs.
        """
        motion = self.sample.motion[rows]
        tip, share = self.setting.tip_and_share(q, self.tool(rows), wrench_in_root, guess)
        if self.setting.tool_spring is not None:
            rotation = toolpath.base_of(self.program, motion)[..., :3, :3]
            share = np.asarray(np.einsum("...i,...ij->...j", share, rotation))
        return toolpath.points_in_base(self.program, motion, tip, self.sample.t[rows]), share

    @property
    def setting(self) -> RobotInCell:
        """The robot in its cell."""
        return self.motions.setting
