"""Samples of a path one at a time: frames multiplied out, joints, margins, speeds and errors in plain loops."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from postproc import elastostatics
from postproc.kinematics.components import components
from postproc.placement import drive

AXES = {"+X": [1.0, 0.0, 0.0], "-X": [-1.0, 0.0, 0.0], "+Z": [0.0, 0.0, 1.0], "-Z": [0.0, 0.0, -1.0]}


class SampleBySample:
    """A path with a turn of the tool at each sample.

    :param turn: (N,) turn about the direction from the tip to the spindle [rad].
    """

    def __init__(self, samples, branch, turn):
        self.samples, self.branch, self.turn = samples, branch, turn
        self.robot, self.motions = samples.robot_in_cell.robot, samples.program.motions
        self.axis = AXES[samples.robot_in_cell.cell.tool.axis]
        self.q = np.array([self._joints(i) for i in range(len(samples))])

    def pose(self, i):
        """Tool frame (4, 4) in the root, as the robot is carried there [m]."""
        program, k = self.samples.program, self.samples.sample.motion[i]
        turned, base = np.eye(4), program.bases[self.motions.base[k]].copy()
        turned[:3, :3] = Rotation.from_rotvec(-self.turn[i] * np.array(self.axis)).as_matrix()
        if program.carriage is not None:
            begin, end = program.carriage.begin[k], program.carriage.end[k]
            base[:3, 3] -= (begin + self.samples.sample.t[i] * (end - begin)) * program.carriage.direction
        return base @ self.samples.sample.pose[i] @ turned

    def tool(self, i):
        return self.samples.program.tools[self.motions.tool[self.samples.sample.motion[i]]]

    def is_axis_target(self, i):
        return bool(np.isfinite(self.motions.joints[self.samples.sample.motion[i], 0]))

    def is_interpolated(self, i):
        """Whether the motion of a sample is a joint interpolation."""
        return self.motions.kind[self.samples.sample.motion[i]] == 2

    def is_cut(self, i):
        return not self.motions.rapid[self.samples.sample.motion[i]]

    def _joints(self, i):
        if self.is_axis_target(i):
            return self.motions.joints[self.samples.sample.motion[i]]
        flange = self.pose(i) @ np.linalg.inv(self.tool(i))
        return drive.solve(self.robot, components(flange[None]), self.branch)[:, 0]

    def change(self, i):
        """Angles (6,) from the sample before, each the short way [rad]; 0 where one of the two is not reached."""
        if i == 0:
            return np.zeros(6)
        change = self.q[i] - self.q[i - 1]
        return np.nan_to_num((change + np.pi) % (2.0 * np.pi) - np.pi)

    def speed(self, i):
        """Largest share of a joint speed at the feed."""
        return float(np.max(np.abs(self.change(i)) / self.robot.speed) / self.samples.time[i])

    def margins(self, i):
        """Margins (4,) of joints, wrist, elbow and shoulder; unlimited at programmed joint angles."""
        if self.is_axis_target(i):
            return np.full(4, np.inf)
        margin = drive.margins(self.robot, self.q[i][:, None])
        return np.array([margin.joint[0], margin.wrist[0], margin.elbow[0], margin.shoulder[0]])

    def flips(self, i):
        """Whether A1, A2, A3 or A5 goes the long way round from the sample before."""
        return i > 0 and bool((np.abs(self.q[i] - self.q[i - 1])[[0, 1, 2, 4]] > np.pi).any())

    def wrench(self, i):
        """Wrench (6,) in the root: forces are stated in $BASE, or in the turned tool."""
        samples = self.samples
        one = samples.sample.take(np.array([i]))
        turned = self.pose(i)[:3, :3]
        base = samples.program.bases[self.motions.base[samples.sample.motion[i]]][:3, :3]
        wrench = samples.forces.at(one)[0]
        as_programmed = base @ samples.sample.pose[i, :3, :3]
        is_in_tool = samples.program.motions.line[samples.sample.motion[i]] in self.tool_lines
        axes = turned @ as_programmed.T @ base if is_in_tool else base
        return np.concatenate([axes @ wrench[:3], axes @ wrench[3:]])

    tool_lines: tuple[int, ...] = ()
    """Lines whose forces are stated in the axes of the tool."""

    def errors(self, i):
        """Expected error and deflection [m]; 0 on rapid moves, NaN out of reach."""
        if not self.is_cut(i):
            return 0.0, 0.0
        if np.isnan(self.q[i]).any():
            return np.nan, np.nan
        return self.errors_of([i])[0]

    def errors_of(self, rows):
        """Expected errors and deflections [m] of samples that cut and are reached."""
        samples, q = self.samples, self.q[rows]
        tool, wrench, pose = (np.array([function(i) for i in rows]) for function in (self.tool, self.wrench, self.pose))
        spring = samples.robot_in_cell.tool_spring
        series = None if spring is None else spring.matrices(pose[:, :3, :3])
        spread = samples.forces.spread_in_root(samples.sample.take(np.array(rows)))
        bound = elastostatics.position_bound(self.robot, q, tool, wrench, force_spread=spread, in_series=series)
        tip = samples.robot_in_cell.tip(q, tool, wrench)
        return list(zip(bound.tolist(), np.linalg.norm(tip - pose[:, :3, 3], axis=1).tolist(), strict=True))
