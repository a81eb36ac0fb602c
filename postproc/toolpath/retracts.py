"""Motions at feed that do not cut: a retract, and the moves at its height.

A robot program, and a G-code program for a control with slow rapids, moves at feed through air too.
"""

from __future__ import annotations

import numpy as np

from postproc.frames import Array, norm
from postproc.program import Bools

_COORDINATE_ROUNDING = 1e-6
"""A retract rises by more and moves sideways by at most this [m]: the rounding of written coordinates (assumed)."""


def retract_motions(ends: Array, up: Array) -> Bools:
    """Return True (M,) for motions that retract straight up, or follow a retract before the tool descends again.

    :param ends: (M, 3) ends of all motions [m], in order.
    :param up: unit vector from the part to the spindle, (3,) or (M, 3).
    """
    if len(ends) < 2:
        return np.zeros(len(ends), dtype=bool)
    step = np.diff(ends, axis=0, prepend=ends[:1])
    rise = np.einsum("...i,...i->...", step, np.broadcast_to(up, step.shape))
    sideways = norm(step - rise[:, None] * up)
    is_retract = (rise > _COORDINATE_ROUNDING) & (sideways <= _COORDINATE_ROUNDING)
    is_descent = rise < -_COORDINATE_ROUNDING
    # the last retract or descent up to each motion decides; before the first of them, motion 0, which is neither
    row = np.arange(len(ends))
    last_decisive_row = np.maximum.accumulate(np.where(is_retract | is_descent, row, 0))
    return np.asarray(is_retract[last_decisive_row])
