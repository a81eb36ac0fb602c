"""What is wrong with the moves of a program, and what cannot be said because of something else that is wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from postproc.dialects.gcode import codes
from postproc.dialects.gcode.arcs import ArcFault
from postproc.dialects.gcode.blocks import Fault
from postproc.dialects.gcode.line_states import LineStates
from postproc.dialects.gcode.modes import Modes
from postproc.dialects.gcode.tool_positions import Moves
from postproc.errors import MOST
from postproc.frames import Array, any_column
from postproc.program import Bools, Ints


def faults_of(rows: LineStates, moves: Moves, modes: Modes, circular: Ints, arcs: Sequence[ArcFault]) -> list[Fault]:
    """Return what is wrong, in order of lines, one fault for each line.

    After a block that could not be read, nothing is said that may only be wrong because of it.

    :param circular: (A,) rows of the arcs.
    """
    doubt = _Doubt(rows, modes.faults)
    faults = {fault.row: fault for fault in modes.faults}

    def check(wrong: Bools, problem: str, advice: str | None = None, *, first: bool = False) -> None:
        for row in np.flatnonzero(wrong)[: 1 if first else MOST + 1].tolist():
            faults.setdefault(row, Fault(row, problem, advice))

    count = len(rows.motion)
    axes = rows.placed
    straight, arc = rows.motion == 1.0, (rows.motion == 2.0) | (rows.motion == 3.0)
    dwelling = np.zeros(count, dtype=bool)
    dwelling[[row for row in modes.dwells if row < count]] = True
    cancelled = axes & (rows.motion == codes.CANCEL_CYCLE) & ~doubt.motion
    check(cancelled, "coordinates without G0, G1, G2 or G3", "Say which motion it is.", first=True)
    used = (rows.moving & arc) | rows.drilling | doubt.motion
    centred = any_column(~np.isnan(rows.ijk))
    stray = centred | ~(np.isnan(rows.radius) & np.isnan(rows.turns))
    check(stray & ~used, "I, J, K, R or P without an arc or a cycle that uses it")
    stray = ~(np.isnan(rows.pecks) & np.isnan(rows.repeats))
    check(stray & (~used | (rows.moving & arc)), "Q or L without a cycle that uses it")
    check(rows.drilling & centred, "I, J or K in a cycle")
    check(dwelling & rows.moving & arc, "G4 in one block with an arc", "Write one block for each.")
    cuts = ((rows.named | rows.moving) & (straight | arc)) | rows.drilling
    no_feed = cuts & ~(rows.feed > 0.0) & ~doubt.motion & ~doubt.feed
    check(no_feed & ~rows.inverse_time, "cutting move without a feed", "Give F.", first=True)
    check(no_feed & rows.inverse_time & rows.moving, "cutting move in G93 without a feed", "Give F in each block.")
    check(rows.drilling & rows.inverse_time, "a cycle in G93", "Write G94, and F in mm/min or inch/min.", first=True)
    _check_unknown(rows, moves, doubt, check)
    for row, problem, advice in moves.faults:
        if not (doubt.motion[row] or doubt.position[row]):
            faults.setdefault(row, Fault(row, problem, advice))
    for fault in arcs:
        row = int(circular[fault.n])
        if not (doubt.motion[row] or (fault.placed and doubt.position[row])):
            faults.setdefault(row, Fault(row, fault.problem, fault.advice))
    return [faults[row] for row in sorted(faults)]


def _check_unknown(rows: LineStates, moves: Moves, doubt: _Doubt, check: Callable[..., None]) -> None:
    """Say where moves need to know where the tool is, while it is not known: at first, and after G28."""
    line = np.arange(len(rows.motion))
    axes = rows.placed
    straight, arc = rows.motion == 1.0, (rows.motion == 2.0) | (rows.motion == 3.0)
    advice = "Program X, Y and Z in rapid moves (G0, in G90) first: the tool may stand anywhere before."
    never = [axis for axis, words in zip("XYZ", rows.xyz.T, strict=True) if np.isnan(words).all()]
    if never:
        advice += f" {' and '.join(never)} {'is' if len(never) == 1 else 'are'} never programmed."
    for first, complete in moves.unknown:
        if first >= len(line):
            continue
        within = (line >= first) & (line <= complete)
        early = axes & within & ~doubt.position
        problem = "incremental move before the position is known"
        check(early & rows.incremental, problem, advice, first=True)
        begin = first + int(np.argmax(axes[first:])) if axes[first:].any() else first
        above = begin == complete or _is_above(rows, first, complete)  # one with all needs none
        cutting = early & (straight & (not above) | rows.drilling) & ~doubt.motion
        check(cutting, "cutting move before the position is known", advice, first=True)
        turning = rows.moving & arc & within & ~doubt.motion & ~doubt.position
        check(turning, "arc before the position is known", advice, first=True)
        elsewhere = early & (moves.offset != moves.offset[begin])
        check(elsewhere, "change of the work offset before the position is known", advice, first=True)


def _is_above(rows: LineStates, first: int, complete: int) -> bool:
    """Return whether the last Z before line `complete` is the highest of the program: X and Y are sought above it all.

    Programs for hobby controls go up by G1, and then to where they begin.
    """
    z = rows.xyz[first:complete, 2]
    z = z[~np.isnan(z)]
    return bool(len(z)) and not rows.incremental.any() and bool(z[-1] >= np.nanmax(rows.xyz[:, 2]))


class _Doubt:
    """Where blocks that could not be read leave open what holds; each (L,), True from such a block on.

    :ivar motion: which of G0…G3, until it is named again.
    :ivar position: where the tool stands, until X, Y and Z are given again.
    :ivar feed: whether there is one.
    """

    def __init__(self, rows: LineStates, faults: Sequence[Fault]) -> None:
        count = len(rows.motion)
        if not faults:
            self.motion = self.position = self.feed = np.zeros(count, dtype=bool)
            return
        line = np.arange(count)

        def latest(at: Array | Bools) -> Ints:
            return np.asarray(np.maximum.accumulate(np.where(at, line, -1)), dtype=np.int64)

        def lost(letters: str) -> Ints:
            at = np.zeros(count, dtype=bool)
            at[[fault.row for fault in faults if set(letters) & set(fault.lost)]] = True
            return latest(at)

        given = [latest(~np.isnan(rows.xyz[:, axis]) & ~rows.incremental) for axis in range(3)]
        before = np.minimum.reduce(given)
        before = np.concatenate([[-1], before[:-1]])  # the line itself needs to know where it starts
        self.motion = (lost("G") >= 0) & (latest(rows.named) <= lost("G"))
        self.position = (lost("GXYZIJK") >= 0) & (before <= lost("GXYZIJK"))
        self.feed = lost("F") >= 0
