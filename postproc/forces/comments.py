"""Forces from the comments of a program: each is valid until the next one."""

from __future__ import annotations

import numpy as np

from postproc.forces.knots import Knots
from postproc.program import FORCE_FRAMES, Program


def of_comments(program: Program) -> Knots:
    """Return the force of each motion after the first force comment: that of the last comment executed before it.

    :raises ValueError: the reader of the program has not set the first motion of a comment.
    """
    first = [note.before for note in program.notes]
    if min(first, default=0) < 0:
        raise ValueError(f"the reader of {program.dialect} leaves ForceNote.before unset")
    index = np.searchsorted(first, np.arange(len(program.motions)), side="right") - 1
    motion = np.flatnonzero(index >= 0)
    values = np.array([note.wrench for note in program.notes]).reshape(-1, 6)
    frames = np.array([FORCE_FRAMES.index(note.frame) for note in program.notes], dtype=np.int64)
    return Knots.throughout(motion, values[index[motion]], frames[index[motion]])
