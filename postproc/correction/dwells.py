"""Waits with a corrected tool under force: it springs to where it is commanded, beyond the nominal place."""

from __future__ import annotations

import numpy as np

from postproc.errors import Issue
from postproc.frames import MM_PER_M, Array, norm
from postproc.program import Ints, Program


def dwell_issues(program: Program, motion: Ints, t: Array, deflection: Array, tolerance: float) -> list[Issue]:
    """Return a warning if a program waits where the force deflects the tool by more than the tolerance.

    At the end of lines and arcs it does not, see `forces.releases`; pieces of splines keep their force to the end.

    :param motion: (K,) motion of each target.
    :param t: (K,) place of each target on its motion, in (0, 1].
    :param deflection: (K, 3) displacement of the tool tip by the force [m].
    :param tolerance: [m].
    """
    size = np.where((t == 1.0) & np.isin(motion, program.waiting_motions), norm(deflection), 0.0)
    size[program.motions.rapid[motion]] = 0.0
    rows = np.flatnonzero(size > tolerance)
    if not len(rows):
        return []
    message = (
        "The program waits here with the tool in material. While it waits, nothing is fed and the force ends: the tool "
        f"springs to the commanded place and cuts up to {size.max() * MM_PER_M:.2f} mm beyond the nominal one, where "
        "it would come without correction. End the spline before, and wait behind a LIN, or leave out the wait"
    )
    return [program.motions.issue("warning", "dwell-in-material", message, motion[rows])]
