"""Waits with a corrected tool under force: it springs to where it is commanded, beyond the nominal place."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc.errors import Issue
from postproc.frames import MM_PER_M, Array, norm
from postproc.program import SPL, Ints, Program

_MESSAGE = (
    "The program waits here with the tool in material. While it waits, nothing is fed and the force ends: the tool "
    "springs to the commanded place and cuts up to {distance} mm beyond the nominal one, where it would come without "
    "correction. {advice}"
)
_SPLINE_ADVICE = "End the spline before, and wait behind a LIN, or leave out the wait"
_BRANCH_ADVICE = (
    "Other branches that meet here, or other rounds, do not wait: corrected, they would not meet. Wait in all of them, "
    "or behind their join, or leave out the wait"
)


def dwell_issues(program: Program, motion: Ints, t: Array, deflection: Array, tolerance: float) -> Iterator[Issue]:
    """Yield warnings if a program waits where the force deflects the tool by more than the tolerance.

    Lines and arcs that end in a wait are corrected for no force at their end (`forces.releases`), so that nothing
    happens there. Pieces of splines keep their force to the end, and so do branches of which not all wait.

    :param motion: (K,) motion of each target.
    :param t: (K,) place of each target on its motion, in (0, 1].
    :param deflection: (K, 3) displacement of the tool tip by the force [m].
    :param tolerance: [m].
    """
    m = program.motions
    is_waiting = (t == 1.0) & np.isin(motion, program.waiting_motions) & ~m.rapid[motion]
    size = np.where(is_waiting, norm(deflection), 0.0)
    is_spline = m.kind[motion] == SPL
    for is_case, advice in ((is_spline, _SPLINE_ADVICE), (~is_spline, _BRANCH_ADVICE)):
        rows = np.flatnonzero(is_case & (size > tolerance))
        if len(rows):
            message = _MESSAGE.format(distance=f"{size[rows].max() * MM_PER_M:.2f}", advice=advice)
            yield m.issue("warning", "dwell-in-material", message, motion[rows])
