"""The motions of a program with the forces along them, from which the samples of the path are chosen."""

from __future__ import annotations

from msgspec import Struct

from postproc import forces, toolpath
from postproc.forces import ForceSource, PathForces
from postproc.frames import Array
from postproc.program import Ints, Program
from postproc.toolpath import DisplacementEstimate, Pieces, Segments
from postproc.under_load import bounds
from postproc.under_load.setting import RobotInCell

SHARE_OF_TOLERANCE = 0.4
"""Share of the tolerance for deviations at the samples of the path; the rest is for deviations between them."""


class MotionsUnderLoad(Struct, frozen=True, eq=False):
    """The motions of a program with the forces along them, in the cell of a robot.

    :param program: the program.
    :param setting: the robot in its cell.
    :param segments: start and length of the motions.
    :param forces: the forces along them.
    :param softness: approximate compliance at the tip per force [m/N] and per moment [m/(N·m)].
    :param estimate: approximate displacement of the tool by the forces.
    :param swung: places of straight motions that are needed where FEED forces swing: motion (n,) and t (n,).
    """

    program: Program
    setting: RobotInCell
    segments: Segments
    forces: PathForces
    softness: tuple[float, float]
    estimate: DisplacementEstimate
    swung: tuple[Ints, Array]

    @classmethod
    def of(cls, program: Program, setting: RobotInCell, source: ForceSource | None) -> MotionsUnderLoad:
        """Assign forces to the motions of a program.

        :param source: forces that take precedence over the comments of the program.
        :raises ImpossiblePathError: the path is out of reach or implausibly long.
        :raises ForceError: the forces do not match the motions.
        """
        bounds.check_ends(program, setting.robot)
        segments = toolpath.segments(program, setting.start_flange)
        bounds.check_between(program, setting.robot, segments)
        along = forces.along(program, segments, source, setting.spindle, setting.ramp)
        softness = setting.softness(program.tools[0])
        swung = forces.swung(along, softness, SHARE_OF_TOLERANCE * setting.tolerance)
        return cls(program, setting, segments, along, softness, forces.estimate(along, softness), swung)

    def pieces(self, *, linearize_arcs: bool) -> Pieces:
        """Return the initial division of the arcs into pieces.

        :param linearize_arcs: replace arcs by chords.
        """
        tolerance = self.setting.tolerance
        arcs = toolpath.pieces(self.program, self.segments, tolerance, self.estimate, linearize_arcs=linearize_arcs)
        return forces.followed(self.forces, arcs, self.estimate, self.softness, SHARE_OF_TOLERANCE * tolerance)
