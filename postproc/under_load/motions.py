"""The motions of a program with the forces along them: what the places to compute are chosen by."""

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
"""Of the tolerance, what a run between targets may use up at the places computed; the rest is for between them."""


class MotionsUnderLoad(Struct, frozen=True, eq=False):
    """The motions of a program with the forces along them, in the cell of a robot.

    :param program: the program.
    :param setting: the robot in its cell.
    :param segments: where the motions start, and how long they are.
    :param forces: the forces along them.
    :param softness: how far the tool gives way, about, per force [m/N] and per moment [m/(N·m)].
    :param estimate: how far the forces move the tool, about.
    :param swung: places of straight motions that are needed where FEED forces swing round: motion (n,) and t (n,).
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
        """Put forces on the motions of a program.

        :param source: forces beside the comments of the program; they win.
        :raises ImpossiblePathError: no arm could drive this path.
        :raises ForceError: forces that cannot be given to the motions.
        """
        bounds.check_ends(program, setting.robot)
        segments = toolpath.segments(program, setting.start_flange)
        bounds.check_between(program, setting.robot, segments)
        along = forces.along(program, segments, source, setting.spindle, setting.ramp)
        softness = setting.softness(program.tools[0])
        swung = forces.swung(along, softness, SHARE_OF_TOLERANCE * setting.tolerance)
        return cls(program, setting, segments, along, softness, forces.estimate(along, softness), swung)

    def pieces(self, *, linearize_arcs: bool = False) -> Pieces:
        """Return into how many pieces to divide the arcs at first.

        :param linearize_arcs: the pieces are chords.
        """
        tolerance = self.setting.tolerance
        arcs = toolpath.pieces(self.program, self.segments, tolerance, self.estimate, linearize_arcs=linearize_arcs)
        return forces.followed(self.forces, arcs, self.estimate, self.softness, SHARE_OF_TOLERANCE * tolerance)
