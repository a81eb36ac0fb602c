"""One of two programs that are compared, in its cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec import Struct

from postproc import forces, kinematics, toolpath
from postproc.comparison.entries import place_of
from postproc.comparison.pairing import Track
from postproc.errors import ProgramError
from postproc.forces import ForceSource, PathForces
from postproc.frames import Array, norm
from postproc.kinematics import JointPath, UnreachableError
from postproc.program import PTP, Bools, Ints, Program
from postproc.toolpath import Segments
from postproc.under_load import RobotInCell


class Side(Struct, frozen=True, eq=False):
    """One of the programs in its cell.

    :param place: the robot in its cell.
    :param path: the geometry of its motions.
    :param rows: (n,) motions with a Cartesian target.
    :param joints: (M, 6) joint angles at the ends of the motions [rad].
    :param branch: (M,) the branch of the inverse kinematics that they are on.
    """

    program: Program
    place: RobotInCell
    path: Segments
    rows: Ints
    joints: Array
    branch: Ints

    @classmethod
    def of(cls, program: Program, place: RobotInCell) -> Side:
        """Put a program into its cell.

        :raises ProgramError: a target is out of reach.
        """
        m = program.motions
        path = toolpath.segments(program, place.start_flange)
        ends = _ends(program, place)
        return cls(program, place, path, np.flatnonzero(np.isnan(m.joints[:, 0])), ends.q, ends.branch)

    def follows(self, before: Ints, motion: Ints) -> Bools:
        """Return whether there is no other Cartesian target between motions (n,); `before` −1: before the first."""
        return np.asarray(np.searchsorted(self.rows, motion) - np.searchsorted(self.rows, before + 1) == 0)

    def track(self, offset: Array | float = 0.0) -> Track:
        """Return the Cartesian targets as they stand in the root, displaced by offsets (n, 3) in their `$BASE` [m]."""
        m, rows = self.program.motions, self.rows
        pose = m.target[rows]
        step = np.where(m.kind[rows] == PTP, norm(pose[:, :3, 3] - self.path.begin[rows]), self.path.length[rows])
        pose[:, :3, 3] += offset
        return Track(toolpath.pose_in_root(self.program, rows, pose, None)[:, :3, 3], step, m.kind[rows] == PTP)

    def forces(self, source: ForceSource | None) -> PathForces:
        """Return the forces along it: from a source, else from its comments."""
        return forces.along(self.program, self.path, source, self.place.spindle, self.place.ramp)

    def wrench(self, load: PathForces, motion: Ints, t: Array | float = 1.0) -> Array:
        """Return the wrenches (n, 6) at places (motion, t), root axes."""
        share = np.broadcast_to(np.asarray(t, dtype=float), motion.shape)
        wrench = load.at(toolpath.at(self.program, self.path, motion, share))
        return toolpath.wrench_in_root(self.program, motion, wrench)

    def stands(self, motion: Ints, t: Array | float = 1.0) -> Array:
        """Return where its carriage has brought the robot (n, 3) at places (motion, t), seen from E1 = 0 [m]."""
        carriage = self.program.carriage
        return np.zeros((len(motion), 3)) if carriage is None else carriage.offset(motion, t)

    def joints_at(self, motion: Ints, t: Array) -> Array:
        """Return the joint angles (n, 6) at places (motion, t) [rad]; NaN out of reach."""
        pose = toolpath.at(self.program, self.path, motion, t).pose
        flange = toolpath.flange_from_tcp(self.program, motion, pose, t)
        return kinematics.on_branch(self.place.robot, flange, self.branch[motion])


def at(program: Program, row: int) -> tuple[str, int]:
    """Return the file, with its folder, and the line where a motion stands."""
    file, line = place_of(program, row)
    return str(Path(program.documents[0].folder) / file), line


def _ends(program: Program, place: RobotInCell) -> JointPath:
    """Return the joint angles at the ends of the motions."""
    count = len(program.motions)
    try:
        return place.follow(program, np.arange(count), np.ones(count), program.motions.target)
    except UnreachableError as cause:
        file, line = at(program, cause.rows[0])
        problem = "out of reach (on the branch of [start] joints)"
        raise ProgramError(problem, file=file, line=line) from None
