"""Lines on which the wrist axes turn the tool.

Under ``$ORI_TYPE=#JOINT`` a KUKA controller leads the angles of the wrist axes from their values at the start to those
at the end, axis by axis, while the tip stays on its line (Beckhoff, TF5120: KUKA mxAutomation). That they change in
proportion to the path length is assumed.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from postproc.chunks import in_chunks
from postproc.frames import Array, angle_between, largest
from postproc.kinematics.closed_form import closed_form
from postproc.kinematics.components import components, matrices
from postproc.kinematics.forward import posture
from postproc.kinematics.inverse import UnreachableError
from postproc.program import Bools, Ints
from postproc.robot import RobotModel

_NEAR = 1e-11
"""The tip is on its line within this [m]."""
_ROUNDS = 12
_LOOKED_AT = 8
"""Pieces of a motion at whose ends its rotation is measured."""
_BETWEEN = 1.2
"""Factor on the rotation found so: the tool may turn to and fro within a piece."""


class ByWrist(Struct, frozen=True, eq=False):
    """W of M motions on which the wrist turns the tool.

    :param robot: the robot; its nominal geometry is used.
    :param motion: (W,) the motions, ascending.
    :param begin: (W, 6) joint angles at their start [rad], `end` (W, 6) at their end.
    :param tip: (W, 2, 3) tip in the root at their start and end [m].
    :param base: (W, 3, 3) orientation of `$BASE` in the root.
    :param tool: (W, 4, 4) `$TOOL` in the flange frame [m].
    :param active: (M,) True for them.
    :param travel: (M,) largest rotation of the tool on them [rad], 0 elsewhere.
    """

    robot: RobotModel
    motion: Ints
    begin: Array
    end: Array
    tip: Array
    base: Array
    tool: Array
    active: Bools
    travel: Array

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        count: int,
        motion: Ints,
        joints: tuple[Array, Array],
        tip: Array,
        base: Array,
        tool: Array,
    ) -> ByWrist:
        """Return the motions with their rotation.

        :param count: M.
        :param joints: angles (W, 6) at start and end.
        :raises UnreachableError: the tip cannot be held on its line on one branch; `rows` are motions.
        """
        active = np.zeros(count, dtype=np.bool_)
        active[motion] = True
        wrist = cls(robot, motion, *joints, tip, base, tool, active, np.zeros(count))
        turned, before = np.zeros(len(motion)), wrist.at(motion, np.zeros(len(motion)))
        for piece in range(1, _LOOKED_AT + 1):
            here = wrist.at(motion, np.full(len(motion), piece / _LOOKED_AT))
            turned += angle_between(before, here)
            before = here
        wrist.travel[motion] = _BETWEEN * turned
        return wrist

    def at(self, motion: Ints, t: Array) -> Array:
        """Return the orientation of the tool frame (n, 3, 3) in `$BASE` at places (motion, t).

        :raises UnreachableError: the tip cannot be held on its line on one branch; `rows` are motions.
        """
        row = np.searchsorted(self.motion, motion)
        q, pose = in_chunks(self._solved, row, t)
        off = largest(pose[:, :3, 3] - self._tip(row, t))
        form = closed_form(self.robot)
        missed = np.flatnonzero(~(off < _NEAR) | (form.branch_of(q) != form.branch_of(self.begin[row])))
        if len(missed):
            raise UnreachableError(sorted(set(motion[missed].tolist())))
        return np.asarray(np.swapaxes(self.base[row], 1, 2) @ pose[:, :3, :3])

    def _tip(self, row: Ints, t: Array) -> Array:
        return np.asarray(self.tip[row, 0] + t[:, None] * (self.tip[row, 1] - self.tip[row, 0]))

    def _solved(self, row: Ints, t: Array) -> tuple[Array, Array]:
        """Return the joint angles (n, 6) [rad] and the poses (n, 4, 4) in the root [m].

        A1 to A3 are found by Newton's method, from the line between their values at start and end.
        """
        q = (self.begin[row] + t[:, None] * (self.end[row] - self.begin[row])).T.copy()
        tip, tool = self._tip(row, t).T, components(self.tool[row])
        for _ in range(_ROUNDS):
            state = posture(self.robot.nominal, q, tool)
            missing = tip - state.point
            if not (np.abs(missing).max(initial=0.0) > 0.1 * _NEAR):
                break
            slope = np.moveaxis(state.jacobian()[:3, :3], -1, 0)
            try:
                q[:3] += np.linalg.solve(slope, missing.T[..., None])[..., 0].T
            except np.linalg.LinAlgError:
                break
        return q.T, matrices(posture(self.robot.nominal, q, tool).pose)
