"""The length of cut for which each target stands: statistics weigh by length, not by the number of targets.

A corner of 400 chords is then as much as its length, and an arc as much as its chords.
"""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.program import Bools, Ints, Motions

_LEAST_LENGTH = 1e-9
"""Length given to a cut that does not move the tip [m]: it counts among the cuts, but no sum of lengths changes."""


def cut_lengths(motions: Motions, length: Array, motion: Ints, t: Array, has_same_force: Bools) -> Array:
    """Return the length (K,) of cutting path that each target represents [m]: 0 on rapid moves, else above 0.

    The piece of path to a target counts half for this target and half for the target before (trapezoidal rule). It
    counts for this target alone if another force begins with the piece, or if a rapid move precedes it: the target
    before then has another deviation than the start of the piece. The sum is the length of all cutting motions up to
    the last target.

    :param motions: of the program, M of them.
    :param length: (M,) length of their paths [m]; 0 of PTP.
    :param motion: (K,) row of `motions` of each target, never decreasing.
    :param t: (K,) place on that motion, in (0, 1], in order.
    :param has_same_force: (K,) True if the force at the target before still acts on the piece to the target.

    >>> import numpy as np
    >>> from types import SimpleNamespace
    >>> cuts = SimpleNamespace(rapid=np.array([True, False, False]))
    >>> lengths, targets = np.array([5.0, 2.0, 4.0]), (np.array([0, 1, 2, 2]), np.array([1.0, 1.0, 0.5, 1.0]))
    >>> cut_lengths(cuts, lengths, *targets, np.ones(4, dtype=bool)).tolist()
    [0.0, 3.0, 2.0, 1.0]
    """
    is_cut = ~motions.rapid[motion]
    cutting_length = np.where(motions.rapid, 0.0, length)
    place = (np.cumsum(cutting_length) - cutting_length)[motion] + cutting_length[motion] * t
    piece = np.diff(place, prepend=0.0)
    # the slices shorten what `append` makes too long for a program without targets
    follows_cut = np.append(False, is_cut[:-1])[: len(piece)]
    half_for_previous = np.where(has_same_force & is_cut & follows_cut, 0.5 * piece, 0.0)
    half_of_next = np.append(half_for_previous[1:], 0.0)[: len(piece)]
    return np.where(is_cut, np.maximum(piece - half_for_previous + half_of_next, _LEAST_LENGTH), 0.0)
