"""Forces as a dynamometer gives them: over the distance cut, whatever the moves of the program are.

One row a reading, ``distance Fx Fy Fz`` in mm and N, axes of `$BASE`; linear between the rows.
"""

from __future__ import annotations

import numpy as np

from postproc.errors import ForceError
from postproc.forces import Knots

MM = 1e-3


class Record:
    """A record; what `postproc.forces.ForceSource` asks of a source is a name and `along`."""

    def __init__(self, name, distance, force):
        self.name, self.distance, self.force = name, distance, force

    def along(self, program, path):
        """Return a knot at both ends of each cutting move, and at every reading between."""
        length = np.where(program.motions.rapid, 0.0, path.length)
        end = np.cumsum(length)
        motion, t, wrench = [], [], []
        for move in np.flatnonzero(length > 0.0):
            begin = end[move] - length[move]
            between = self.distance[(self.distance > begin + 1e-9) & (self.distance < end[move] - 1e-9)]
            at = np.concatenate([[begin], between, [end[move]]])
            motion += [move] * len(at)
            t += list(np.clip((at - begin) / length[move], 0.0, 1.0))
            wrench += [[*(np.interp(one, self.distance, axis) for axis in self.force.T), 0.0, 0.0, 0.0] for one in at]
        count = len(motion)
        frame = np.zeros(count, dtype=np.int64)  # BASE
        return Knots.along(np.array(motion, dtype=np.int64), np.array(t), np.array(wrench).reshape(count, 6), frame)


def read(path):
    """Read a record.

    :raises ForceError: it has no rows of four numbers, or the distance does not grow.
    """
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as cause:
        raise ForceError(f"cannot be read ({cause})", file=str(path), advice="A row is: distance Fx Fy Fz.") from cause
    if rows.shape[1:] != (4,) or (np.diff(rows[:, 0]) <= 0.0).any():
        raise ForceError("no record", file=str(path), advice="A row is: distance Fx Fy Fz, the distance grows.")
    return Record(str(path), rows[:, 0] * MM, rows[:, 1:])
