"""The motions of a program that its statements make while they run, one after the other."""

from __future__ import annotations

from postproc.dialects.krl.language.source import Place
from postproc.dialects.krl.language.tree import Motion, Statement
from postproc.dialects.krl.read.interpreter import LOOP_ADVICE
from postproc.dialects.krl.read.known import UnresolvedError
from postproc.dialects.krl.read.motion_columns import MotionCollector
from postproc.dialects.krl.read.motion_reader import MotionReader, keeps_position
from postproc.dialects.krl.read.run import Run
from postproc.dialects.krl.read.spline_blocks import SplineBlocks


class CollectedMotions:
    """Motions whose statements have run.

    :param run: the program as far as it has run.
    :param reader: reads motions with the settings of the run.
    :ivar motions: those read, in order, with the state in force.
    :ivar idle_rows: rows of motions to where the robot is already.
    :ivar splines: the spline blocks.
    """

    def __init__(self, run: Run, reader: MotionReader) -> None:
        """Begin without motions; `_refused` has control structures whose motions were refused."""
        self.run, self.reader = run, reader
        self.motions = MotionCollector()
        self.idle_rows: list[int] = []
        self.splines = SplineBlocks(run.settings, reader)
        self._refused: set[Place] = set()

    def take_motion(self, place: Place, stmt: Statement) -> None:
        """Take a motion, or a line that begins or ends a spline block; the functions in it have been followed.

        Under `--keep-unresolved` a motion whose target is not known is noted, to be left as it is.

        :raises ProgramError: it is not understood, not certain, or its target is not known before the program runs.
        """
        run = self.run
        if not isinstance(stmt, Motion):
            self.splines.follow_line(place, stmt, run.row)
            return
        if run.level.open_structures and not keeps_position(stmt):
            self._refuse(place)
            return
        try:
            move, state, name_offsets = self.reader.read_motion(place, stmt, run.row)
        except UnresolvedError as cause:
            if not run.keeps_unresolved:
                raise
            run.unresolved_motions.append((run.row, cause))
            return
        run.understand(*name_offsets)
        if move is None:
            self.idle_rows.append(run.row)
        else:
            self.motions.add(move, state)

    def _refuse(self, place: Place) -> None:
        """Refuse a motion of which it is not known whether or how often it runs.

        Each control structure is reported once. Under `--keep-unresolved` the motion is noted instead, to be left as it
        is.

        :raises ProgramError: without that option.
        """
        run = self.run
        opener, open_line = run.level.open_structures[-1]
        opening_place = Place(place.source, open_line)
        problem = f"motion inside {opener} ({opening_place})"
        if run.keeps_unresolved:
            run.unresolved_motions.append((run.row, place.error(problem)))
        elif opening_place not in self._refused:
            self._refused.add(opening_place)
            raise place.error(problem, LOOP_ADVICE)
