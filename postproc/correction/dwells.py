"""Dwells with the tool in material, in a corrected program.

The force of a cut is that of its feed. While the program waits, nothing is fed: the cutter cuts on until no chip is
left, and the arm springs back by the deflection that the force caused. Uncorrected, the tool comes to the nominal place
by that; corrected, it goes as far beyond.
"""

from __future__ import annotations

import numpy as np

from postproc.errors import Issue
from postproc.frames import MM_PER_M, Array, norm
from postproc.program import Ints, Program


def dwell_issues(program: Program, motion: Ints, t: Array, deflection: Array, tolerance: float) -> list[Issue]:
    """Return a warning if a program waits where the force deflects the tool by more than the tolerance.

    Known are G4, M0, M1, DELAY, cycles with a dwell, WAIT and HALT of KRL, Wait and Stop instructions of RAPID.
    Busy waiting, as by ``WHILE NOT $IN[3]``, is not found; a wait that is never reached may be named.

    :param motion: (K,) motion of each target.
    :param t: (K,) place of each target on its motion, in (0, 1].
    :param deflection: (K, 3) displacement of the tool tip by the force [m].
    :param tolerance: [m].
    """
    dwell_motions = [
        event.before - 1
        for event in program.events
        if event.kind == "stop" or (event.kind == "dwell" and event.value != 0.0)
    ]
    size = np.where((t == 1.0) & np.isin(motion, dwell_motions), norm(deflection), 0.0)
    size[program.motions.rapid[motion]] = 0.0
    rows = np.flatnonzero(size > tolerance)
    if not len(rows):
        return []
    message = (
        "The program waits here with the tool in material. While it waits, nothing is fed and the force ends: the tool "
        f"springs to the commanded place and cuts up to {size.max() * MM_PER_M:.2f} mm beyond the nominal one, where "
        "it would come without correction. Leave out the dwell (G81 instead of G82), or move back before it"
    )
    return [program.motions.issue("warning", "dwell-in-material", message, motion[rows])]
