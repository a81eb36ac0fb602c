"""Samples of the path of a program that do not depend on reach: poses in the root, forces, times."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc import forces, toolpath
from postproc.forces import ForceSource, PathForces
from postproc.frames import Array, norm, rotation_from_vector
from postproc.poses import Poses
from postproc.program import PTP, SPL, Bools, Ints, Program
from postproc.toolpath import Segments, Toolpath
from postproc.under_load import RobotInCell

_SAMPLE_SPACING = 0.020
"""Largest spacing of samples [m] (assumed)."""
_SAMPLE_ROTATION = np.radians(5.0)
"""Largest rotation of the tool between samples [rad] (assumed)."""
_SHORTEST_TRAVEL = 1e-6
"""Path between samples that is shorter than this [m] turns the tool in place: the feed does not time it (assumed)."""
SPINDLE_AXES = {"+Z": (0.0, 0.0, 1.0), "-Z": (0.0, 0.0, -1.0), "+X": (1.0, 0.0, 0.0), "-X": (-1.0, 0.0, 0.0)}
"""Key of [tool] axis → direction from the spindle to the tip in the tool frame."""


class Load(NamedTuple):
    """Loads of the tool at n samples, root axes.

    :param wrench: (n, 6) wrench on the tool at its tip [N, N·m].
    :param spread: `force_spread` of `elastostatics.position_bound`; None if the forces are certain.
    :param pose: (n, 4, 4) tool frame in the root [m].
    :param is_scaled: (n,) `is_proportional` of `elastostatics.position_bound`.
    """

    wrench: Array
    spread: Array | None
    pose: Array
    is_scaled: Bools


class PathSamples(Struct, frozen=True, eq=False):
    """N samples of the nominal path of a program, without joint angles.

    :param program: the program.
    :param robot_in_cell: the robot in its cell.
    :param segments: start and length of its motions.
    :param forces: the forces along them.
    :param sample: motion, place t in it (0…1) and pose in `$BASE` of each sample.
    :param time: (N,) time from the sample before at the programmed feed [s]. It is infinite if the feed does not state
        it: on joint interpolations, rapid moves (which are slowed if a joint would be too fast) and turns in place.
    """

    program: Program
    robot_in_cell: RobotInCell
    segments: Segments
    forces: PathForces
    sample: Toolpath
    time: Array

    @classmethod
    def of(cls, program: Program, robot_in_cell: RobotInCell, source: ForceSource | None) -> PathSamples:
        """Return samples of a program: the end of every motion, and points between at places t.

        A place t is the share of a motion that is done: 0 at its start, 1 at its end. A joint interpolation and a
        segment of a spline have their end only.

        :param source: forces that take precedence over the comments of the program; None: the comments only.
        :raises ForceError: the forces do not match the motions.
        """
        m = program.motions
        segments = toolpath.segments(program, robot_in_cell.start_flange)
        path_forces = forces.assign(program, segments, source, robot_in_cell.spindle, robot_in_cell.ramp)
        sample_count = toolpath.even_parts(segments.travel, segments.turn, _SAMPLE_SPACING, _SAMPLE_ROTATION)
        sample_count[(m.kind == PTP) | (m.kind == SPL)] = 1
        motion, t = toolpath.even_places(np.arange(len(m)), sample_count)
        sample = toolpath.at(program, segments, motion, t)
        travel = segments.length[motion] / sample_count[motion]
        feed = m.feed[motion]
        has_time = ~m.rapid[motion] & (m.kind[motion] != PTP) & (travel > _SHORTEST_TRAVEL) & (feed > 0.0)
        time = np.where(has_time, travel / np.where(has_time, feed, 1.0), np.inf)
        return cls(program, robot_in_cell, segments, path_forces, sample, time)

    def __len__(self) -> int:
        return len(self.sample)

    @property
    def axis(self) -> Array:
        """Direction (3,) from the spindle to the tip in the tool frame."""
        return np.array(SPINDLE_AXES[self.robot_in_cell.spindle])

    def rotation(self, turn: Array) -> Array:
        """Return the rotations (n, 3, 3), in the tool frame, that turn the tool by angles (n,) [rad] about its axis.

        The sign is that of `redundancy_deg`: about the direction from the tip to the spindle.
        """
        return rotation_from_vector(-np.asarray(turn)[..., None] * self.axis)

    def flange(self, rows: Ints, turn: Array) -> Array:
        """Return the flange (n, 4, 4) in the root at samples (n,) with the tool turned by angles (n,) [rad]."""
        motion, t = self.sample.motion[rows], self.sample.t[rows]
        return toolpath.flange_from_tcp(self.program, motion, self._turned_poses(rows, turn), t)

    def load(self, rows: Ints, turn: Array) -> Load:
        """Return the load at samples (n,) with the tool turned by angles (n,) [rad], root axes."""
        pose = self._turned_poses(rows, turn)
        motion, t = self.sample.motion[rows], self.sample.t[rows]
        samples = Toolpath(motion, t, Poses.of(pose), self.sample.distance[rows])
        wrench = toolpath.wrench_in_root(self.program, motion, self.forces.at(samples))
        spread = self.forces.spread_in_root(samples)
        is_scaled = self.robot_in_cell.has_model_factor(self.forces, motion)
        return Load(wrench, spread, toolpath.pose_in_root(self.program, motion, pose, t), is_scaled)

    def _turned_poses(self, rows: Ints, turn: Array) -> Array:
        """Return the tool poses (n, 4, 4) of samples (n,), turned about the tool axis by `turn` (n,) [rad]."""
        pose = self.sample.pose[rows]
        if turn.any():
            pose[:, :3, :3] = pose[:, :3, :3] @ self.rotation(turn)
        return pose

    @property
    def is_at_feed(self) -> Array:
        """(N,) True for samples of motions at feed."""
        return np.asarray(~self.program.motions.rapid[self.sample.motion])

    @property
    def travel(self) -> Array:
        """(N,) distance from the sample before [m], along chords; 0 for the first one."""
        distances = np.append(0.0, norm(np.diff(self.sample.pose.position, axis=0)))
        return np.asarray(distances)
