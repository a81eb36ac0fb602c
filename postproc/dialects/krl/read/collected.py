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
    :ivar motions: the motions that have been read, in order, each with the state in force.
    :ivar idle_rows: rows of the trace with motions to where the robot is already.
    :ivar splines: the spline blocks.
    """

    def __init__(self, run: Run, reader: MotionReader) -> None:
        """Begin without motions."""
        self.run, self.reader = run, reader
        self.motions = MotionCollector()
        self.idle_rows: list[int] = []
        self.splines = SplineBlocks(run.settings, reader)
        self._refused_structures: set[Place] = set()  # control structures whose motions were refused

    def take_motion(self, place: Place, stmt: Statement) -> None:
        """Add a motion to `motions`, or follow a line that begins or ends a spline block.

        A motion to where the robot is already is added to `idle_rows` instead. Under `--keep-unresolved` a motion whose
        target is not known is added to `run.unresolved_motions`, to be left uncorrected.

        :param stmt: the statement at `place`; the functions that it calls have been followed.
        :raises ProgramError: the statement is not understood, may not run, or its target is not known before run time.
        """
        run = self.run
        if not isinstance(stmt, Motion):
            self.splines.follow_line(place, stmt, run.row)
            return
        if run.level.open_structures and not keeps_position(stmt):
            self._refuse_uncertain_motion(place)
            return
        try:
            move, state, name_offsets = self.reader.read_motion(place, stmt, run.row)
        except UnresolvedError as cause:
            if not run.keeps_unresolved:
                raise
            run.unresolved_motions.append((run.row, cause))
            return
        run.note_followed_names(*name_offsets)
        if move is None:  # the robot is at the target already
            self.idle_rows.append(run.row)
        else:
            self.motions.add(move, state)

    def _refuse_uncertain_motion(self, place: Place) -> None:
        """Refuse a motion in a control structure, of which it is not known whether or how often it runs.

        Under `--keep-unresolved` the motion is added to `run.unresolved_motions` instead, to be left uncorrected.

        :raises ProgramError: without that option, at the first motion of each control structure; later motions in it
            are passed over.
        """
        run = self.run
        opener, open_line = run.level.open_structures[-1]
        opening_place = Place(place.source, open_line)
        problem = f"motion inside {opener} ({opening_place})"
        if run.keeps_unresolved:
            run.unresolved_motions.append((run.row, place.error(problem)))
        elif opening_place not in self._refused_structures:
            self._refused_structures.add(opening_place)
            raise place.error(problem, LOOP_ADVICE)
