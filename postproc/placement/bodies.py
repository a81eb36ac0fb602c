"""Where arm, tool and obstacles of a cell come closer than allowed, for the choice of turn and place."""

from __future__ import annotations

import numpy as np

from postproc.collision import Clearance, Scene, Solids, clearance, hits, link_frames
from postproc.frames import M_PER_MM, Array, wrap_angles
from postproc.placement.samples import PathSamples
from postproc.program import Bools, Ints, distinct

_DEFLECTION_FACTOR = 2.0
"""Factor of the deflection, as the arm may be softer at other poses, and bodies move more than the tip (assumed)."""


class Bodies:
    """The bodies of a cell with [collision], with each tool of a program."""

    def __init__(self, samples: PathSamples, clearance_mm: float) -> None:
        """Read the bodies of the cell for each tool of a program.

        :param clearance_mm: smallest allowed distance [mm]; 0: no contact. `_DEFLECTION_FACTOR` times the largest
            deflection by the forces is added, as a correction moves the tool by about as much.
        :raises CellError: a body cannot be read.
        """
        program, robot_in_cell = samples.program, samples.robot_in_cell
        # compliance of the tip under a force [m/N] and under a moment [m/(N·m)]
        force_compliance, moment_compliance = robot_in_cell.tip_compliance(program.tools[0])
        wrench = np.abs(samples.forces.at(samples.sample)).max(axis=0, initial=0.0)
        deflection = force_compliance * float(np.linalg.norm(wrench[:3])) + moment_compliance * float(
            np.linalg.norm(wrench[3:])
        )
        self.min_distance = clearance_mm * M_PER_MM + _DEFLECTION_FACTOR * deflection
        self.chain = robot_in_cell.robot.nominal
        self.tool = program.motions.tool[samples.sample.motion]
        self.solids = {
            int(tool): Solids(Scene.of(robot_in_cell.robot, robot_in_cell.cell, program.tools[tool]))
            for tool in distinct(self.tool)
        }

    def is_hit_along_path(
        self,
        q: Array,
        rows: Ints,
        breaks: Bools,
        shift: Array | None = None,
        base_motion: Array | None = None,
        *,
        between_samples: bool = True,
    ) -> Bools:
        """Return True for samples (n,) of a path at which, or before which, bodies are too close; False if `q` is NaN.

        :param q: (n, 6) joint angles [rad]; from one sample to the next each joint turns by less than half a turn.
        :param rows: (n,) samples of the program.
        :param breaks: (n,) True where the path does not continue from the sample before.
        :param shift: (n, 3) displacement of the robot by E1 [m]; None: there is none.
        :param base_motion: (4, 4) motion of `$BASE` from its place in the cell, in the root; None: it stays there.
        :param between_samples: compare bodies between samples too; else at the samples only.
        """
        is_hit = np.zeros(len(rows), dtype=bool)
        is_in_reach = np.asarray(np.isfinite(q).all(axis=1))
        tool = self.tool[rows]
        # stretches of the path with one tool and without a gap
        is_first = breaks.copy()
        is_first |= ~is_in_reach
        is_first[1:] |= ~is_in_reach[:-1] | (np.diff(tool) != 0)
        ends = np.append(np.flatnonzero(is_first[1:]) + 1, len(rows))
        solids_by_tool = {
            key: solids if base_motion is None else solids.move_base(base_motion) for key, solids in self.solids.items()
        }
        for begin, end in zip(np.append(0, ends[:-1]).tolist(), ends.tolist(), strict=True):
            if begin < end and is_in_reach[begin]:
                stretch = slice(begin, end)
                steps = wrap_angles(np.diff(q[stretch], axis=0))
                path = q[begin] + np.concatenate([np.zeros((1, 6)), np.cumsum(steps, axis=0)])  # without whole turns
                is_hit[stretch] = hits(
                    solids_by_tool[int(tool[begin])],
                    path,
                    self.min_distance,
                    None if shift is None else shift[stretch],
                    between_samples=between_samples,
                )
        return is_hit

    def clearance(self, q: Array, rows: Ints) -> Clearance:
        """Return the smallest distance of bodies at n poses.

        :param q: (n, 6) joint angles [rad].
        :param rows: (n,) samples of these poses, all with the same tool.
        """
        return clearance(self.solids[int(self.tool[rows[0]])].scene, q)

    def name(self, row: int) -> str:
        """Return the name of the body in a row of the scene; it does not depend on the tool."""
        return next(iter(self.solids.values())).bodies[row].name

    def is_closer(self, q: Array, rows: Ints, shift: Array, base_motion: Array) -> bool:
        """Return whether bodies are too close at any of n independent poses.

        :param q: (n, 6) joint angles [rad].
        :param rows: (n,) samples of these poses, which state their tools.
        :param shift: (n, 3) displacement of the robot by E1 [m].
        :param base_motion: (4, 4) motion of `$BASE` from its place in the cell, in the root.
        """
        tools = self.tool[rows]
        for tool, solids in self.solids.items():
            has_tool = tools == tool
            if has_tool.any() and solids.move_base(base_motion).is_closer(
                link_frames(self.chain, q[has_tool], shift[has_tool]), self.min_distance
            ):
                return True
        return False
