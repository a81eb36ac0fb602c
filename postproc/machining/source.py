"""A process as a source of forces for `forces.along`."""

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
    """The forces of a process: from material, tools and stock; entries of its table of operations take precedence.

    Implements `forces.ForceSource`. The stock is swept once for a program.

    :ivar process: the process; found: the last result, None before the first and without [material].
    """

    def __init__(self, process: Process, axis: str, *, stock: Path | None = None, shift: Shift | None = None) -> None:
        """Store a process.

        :param axis: axis of the tool frame that points from the spindle to the tip.
        :param stock: mesh of the stock, instead of that of the process.
        :param shift: displacement of the tip, see `Shift`.
        """
        self.process, self._axis, self._stock, self._shift = process, axis, stock, shift
        self._of: Program | None = None
        self._knots: Knots | None = None
        self.found: ProcessForces | None = None

    def shifted(self, shift: Shift) -> ProcessSource:
        """Return the same process with a displaced tip."""
        return ProcessSource(self.process, self._axis, stock=self._stock, shift=shift)

    @property
    def name(self) -> str:
        """The file of the process."""
        return self.process.path

    def along(self, program: Program, path: Segments) -> Knots:
        """Return the forces along the motions of a program, see `estimate` and `by_operation`.

        :raises ForceError: the process cannot be used for this program.
        """
        if self._knots is None or self._of is not program:
            self._knots, self._of = self._made(program, path), program
        return self._knots

    def _made(self, program: Program, path: Segments) -> Knots:
        process = self.process
        computed = None
        if process.material is not None:
            self.found = estimate(program, path, process, self._axis, stock=self._stock, shift=self._shift)
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
    knots = Knots.along(along.motion, along.t, along.wrench, along.frame, along.sigma)
    return replace(knots, issues=found.issues)
