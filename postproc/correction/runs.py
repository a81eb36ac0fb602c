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
"""Starts whose joints [rad] and E1 [m] differ by less are one state: rounding of the inverse kinematics (assumed)."""


class Run(Struct, frozen=True):
    """Samples that the robot reaches one after another with one tool.

    :param rows: the samples: rows of those of the path.
    :param tool: row of `Program.tools`.
    :param previous: the sample from which the robot moves to the first one; −1: the start of the program; the first one
        itself if it is not known.
    """

    rows: slice
    tool: int
    previous: int


def previous_samples(program: Program, motion: Ints) -> Ints:
    """Return the sample (N,) from which the robot moves to each sample of a path, see `Run.previous`.

    :param motion: (N,) row of `Motions` of each sample, never decreasing; each motion has one.
    """
    previous = np.arange(len(motion)) - 1
    if program.after is None:  # each motion begins where the one before ends
        return previous
    predecessors, motions = program.predecessors, np.arange(len(program.motions))
    first_samples = np.searchsorted(motion, motions)
    begins_at_start, has_unknown_start = predecessors < 0, predecessors == motions
    start_samples = np.where(begins_at_start, -1, _end_samples(program, motion)[predecessors])
    previous[first_samples] = np.where(has_unknown_start, first_samples, start_samples)
    return previous


def runs(program: Program, motion: Ints, q: Array) -> Iterator[Run]:
    """Yield the runs of a path in order, and then a run for each motion that also begins elsewhere.

    A run: samples that the robot reaches one after another with one tool. `Program.transitions` has the pairs of a
    motion and one that control flow may run before it.

    :param motion: (N,) row of `Motions` of each sample.
    :param q: (N, 6) joint angles [rad].
    """
    previous, tool = previous_samples(program, motion), program.motions.tool[motion]
    begins_elsewhere, is_other_tool = previous[1:] != np.arange(len(motion) - 1), tool[1:] != tool[:-1]
    begins = np.append(0, np.flatnonzero(begins_elsewhere | is_other_tool) + 1)
    for begin, end in zip(begins.tolist(), [*begins[1:].tolist(), len(motion)], strict=True):
        yield Run(slice(begin, end), int(tool[begin]), int(previous[begin]))
    if not program.transitions:
        return
    end_samples = _end_samples(program, motion)
    starts_of_motion: dict[int, list[int]] = {}  # samples from which the motion was begun in the runs so far
    for row, previous_row in program.transitions:
        first = int(np.searchsorted(motion, row))
        starts = starts_of_motion.setdefault(row, [int(previous[first])])
        start = int(end_samples[previous_row]) if previous_row >= 0 else -1
        if not any(_is_same_state(program, motion, q, start, known_start) for known_start in starts):
            starts.append(start)
            yield Run(slice(first, int(end_samples[row]) + 1), int(tool[first]), start)


def _end_samples(program: Program, motion: Ints) -> Ints:
    """Return the last sample (M,) of each motion.

    :param motion: (N,) row of `Motions` of each sample, never decreasing.
    """
    return np.asarray(np.searchsorted(motion, np.arange(len(program.motions)), side="right") - 1)


def _is_same_state(program: Program, motion: Ints, q: Array, first: int, second: int) -> bool:
    """Return whether the robot is in the same state at two samples that end motions.

    :param motion: (N,) row of `Motions` of each sample.
    :param q: (N, 6) joint angles of the samples [rad].
    :param first: a sample, `second` another one; −1: the start of the program.
    """
    if first < 0 or second < 0:
        return first == second
    distance = float(np.abs(q[first] - q[second]).max())
    if program.carriage is not None:
        distance = max(distance, float(np.ptp(program.carriage.at(motion[[first, second]]))))
    return distance < _SAME_STATE
