"""A process as a source of forces: what `forces.along` puts on the motions of a program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc.forces import Knots
from postproc.machining.continuous import AlongMotions
from postproc.machining.estimate import ProcessForces, estimate
from postproc.machining.operations import by_operation
from postproc.machining.process import Process
from postproc.machining.ways import Shift
from postproc.program import Program
from postproc.toolpath import Segments

_NONE = np.zeros(0, dtype=np.int64), np.zeros((0, 6)), np.zeros(0, dtype=np.int64)


class ProcessSource:
    """The forces that a process makes: from material, tools and stock, and from its table of operations, which wins.

    Fulfils `forces.ForceSource`. The stock is swept once for a program.

    :ivar found: what was computed last; None before, and where there is no [material].
    """

    def __init__(
        self, process: Process, axis: str, ramp: float, *, stock: Path | None = None, shift: Shift | None = None
    ) -> None:
        """Take a process.

        :param axis: axis of the tool frame that points from the spindle to the tip.
        :param ramp: over which length the force comes up where a motion begins [m].
        :param stock: mesh of the stock, instead of that of the process.
        :param shift: displacement of the tip, see `Shift`.
        """
        self._process, self._axis, self._ramp, self._stock, self._shift = process, axis, ramp, stock, shift
        self._of: Program | None = None
        self._knots: Knots | None = None
        self.found: ProcessForces | None = None

    def shifted(self, shift: Shift) -> ProcessSource:
        """Return the same process for a tip that gives way."""
        return ProcessSource(self._process, self._axis, self._ramp, stock=self._stock, shift=shift)

    @property
    def name(self) -> str:
        """The file of the process."""
        return self._process.path

    def along(self, program: Program, path: Segments) -> Knots:
        """Return the forces along the motions of a program, see `estimate` and `by_operation`.

        :raises ForceError: the process cannot be used for this program.
        """
        if self._knots is None or self._of is not program:
            self._knots, self._of = self._made(program, path), program
        return self._knots

    def _made(self, program: Program, path: Segments) -> Knots:
        process = self._process
        computed = None
        if process.material is not None:
            self.found = estimate(program, path, process, self._axis, self._ramp, stock=self._stock, shift=self._shift)
            computed = knots_of(self.found.along, self.found)
        if not process.operations:
            return Knots.throughout(*_NONE) if computed is None else computed
        own = by_operation(program, process)
        given = Knots.throughout(own.motion, own.wrench, own.frame, own.sigma)
        if computed is None or self.found is None:
            return given
        return replace(given.over(computed), issues=self.found.issues)


def knots_of(along: AlongMotions, found: ProcessForces) -> Knots:
    """Return wrenches along motions as knots."""
    kept = ~along.steady | (along.t > 0.0)  # a steady force comes up over the ramp of itself
    t = np.where(along.steady, 1.0, along.t)
    knots = Knots(along.motion, t, along.wrench, along.frame, along.sigma, along.steady).take(kept)
    return replace(knots, issues=found.issues)
