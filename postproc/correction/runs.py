"""Runs of samples that the robot drives one after another, with one tool.

A run ends where the tool changes, and where the next motion begins elsewhere: branches begin at the fork, and behind
a motion that stays as it is the start is not known. A motion that control flow reaches from several places begins a
run for each.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.program import Ints, Program

_SAME_STATE = 1e-6
"""Starts whose joints [rad] or E1 [m] differ by less count as one."""


class Run(Struct, frozen=True):
    """Samples that follow one another.

    :param rows: the samples.
    :param tool: row of `Program.tools`.
    :param before: the sample at which they begin; −1: the start of the program; their first one if it is not known.
    """

    rows: slice
    tool: int
    before: int


def samples_before(program: Program, motion: Ints) -> Ints:
    """Return the sample (N,) at which each sample of a path begins, see `Run.before`.

    :param motion: (N,) row of `Motions` of each sample, never decreasing; each motion has one.
    """
    before = np.arange(len(motion)) - 1
    if program.after is None:
        return before
    motions = np.arange(len(program.motions))
    first = np.searchsorted(motion, motions)
    end = _ends(program, motion)[program.after]
    before[first] = np.where(program.after == motions, first, np.where(program.after < 0, -1, end))
    return before


def runs(program: Program, motion: Ints, q: Array) -> Iterator[Run]:
    """Yield the runs of a path, in order, and then motions that also begin elsewhere (`Program.transitions`).

    :param motion: (N,) row of `Motions` of each sample.
    :param q: (N, 6) joint angles [rad].
    """
    before, tool = samples_before(program, motion), program.motions.tool[motion]
    change = (before[1:] != np.arange(len(motion) - 1)) | (tool[1:] != tool[:-1])
    begins = np.append(0, np.flatnonzero(change) + 1)
    for begin, end in zip(begins.tolist(), [*begins[1:].tolist(), len(motion)], strict=True):
        yield Run(slice(begin, end), int(tool[begin]), int(before[begin]))
    if not program.transitions:
        return
    ends = _ends(program, motion)
    starts: dict[int, list[int]] = {}
    for row, previous in program.transitions:
        first = int(np.searchsorted(motion, row))
        compared = starts.setdefault(row, [int(before[first])])
        start = int(ends[previous]) if previous >= 0 else -1
        if not any(_is_same(program, motion, q, start, other) for other in compared):
            compared.append(start)
            yield Run(slice(first, int(ends[row]) + 1), int(tool[first]), start)


def _ends(program: Program, motion: Ints) -> Ints:
    """Return the last sample (M,) of each motion."""
    return np.asarray(np.searchsorted(motion, np.arange(len(program.motions)), side="right") - 1)


def _is_same(program: Program, motion: Ints, q: Array, first: int, second: int) -> bool:
    """Return whether the robot is in the same state at two samples that end motions (−1: the start of the program)."""
    if first < 0 or second < 0:
        return first == second
    distance = float(np.abs(q[first] - q[second]).max())
    if program.carriage is not None:
        distance = max(distance, float(np.ptp(program.carriage.at(motion[[first, second]]))))
    return distance < _SAME_STATE
