"""Forces by line: a force CSV has one force profile for all moves that one line of the program makes."""

from __future__ import annotations

import re

import numpy as np

from postproc.errors import ForceError
from postproc.frames import Array
from postproc.program import LIN, Ints, Program
from postproc.toolpath import Segments, tangent

_SAME = 2e-3
"""Forces that differ by less [N, N·m] count as equal: the file has three decimals."""
_ALONG = 1.0 - 1e-6
"""Cosine of the angle between a move and the spindle above which the move is along it."""
_COMMENT = re.compile(r"\([^)]*\)|;.*")
_CALL = re.compile(r"M[ \t]*0*98(?![\d.])|CALL", re.IGNORECASE)
_ADVICE = "Omit the CSV: `convert --process process.toml` and `predict --process` give each move its own force."

Places = tuple[Ints, Array, Array, Ints, Array]
"""K places along motions: row of `Motions`, never decreasing; position t on it, increasing, or NaN for all of it;
wrench (K, 6) [N, N·m] in the axes that the frame (K,) names, and standard deviations (K, 6)."""
_Profile = tuple[Array, Array, Ints]


def one_move_a_line(program: Program, path: Segments, axis: str, places: Places) -> Places:
    """Return the places of one representative move for each line, as a force CSV needs them.

    All cutting moves of a line must have the same force along them. A line makes several moves if it is executed
    several times, or if it calls a routine of another file. For a drilling cycle, the hole or peck with the largest
    force represents all of them.

    :param path: geometry of the motions.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :raises ForceError: moves of a line have different forces; the error is for the first such line.
    """
    motion, t, wrench, frame, sigma = places
    m = program.motions
    keep = np.ones(len(motion), dtype=np.bool_)
    cutting = np.flatnonzero(~m.rapid)
    cutting = cutting[np.argsort(m.line[cutting], kind="stable")]
    _, begin, count = np.unique(m.line[cutting], return_index=True, return_counts=True)
    texts = program.documents[0].text.splitlines()
    size = np.einsum("ni,ni->n", wrench[:, :3], wrench[:, :3])
    for row in np.flatnonzero(count > 1).tolist():
        moves = cutting[begin[row] : begin[row] + count[row]]
        low, high = np.searchsorted(motion, moves), np.searchsorted(motion, moves, side="right")
        given = high > low
        if not given.any():
            continue
        first = _profile(places, low[0], high[0])
        odd = [k for k in range(1, len(moves)) if not _same(first, _profile(places, low[k], high[k]))]
        chosen = int(np.argmax(given))
        if odd:
            text = texts[int(m.line[moves[0]]) - 1]
            if not _is_cycle(program, path, "XYZ".index(axis[1]), moves, text):
                raise _differing(program, moves[[0, odd[0]]], len(moves), text)
            chosen = int(np.argmax([size[a:b].max(initial=-1.0) for a, b in zip(low, high, strict=True)]))
        for k in np.flatnonzero(given).tolist():
            keep[low[k] : high[k]] = k == chosen
    return motion[keep], t[keep], wrench[keep], frame[keep], sigma[keep]


def _profile(places: Places, low: int, high: int) -> _Profile:
    """Return places on a move (k,), wrenches with standard deviations (k, 12) and their frames (k,); zero if none."""
    if low == high:
        return np.zeros(1), np.zeros((1, 12)), np.zeros(1, dtype=np.int64)
    _, t, wrench, frame, sigma = places
    return t[low:high], np.hstack([wrench[low:high], sigma[low:high]]), frame[low:high]


def _same(one: _Profile, other: _Profile) -> bool:
    """Whether the forces along two moves, linear between their places, are equal."""
    (t, values, frame), (t_, values_, frame_) = one, other
    if np.abs(values).max() <= _SAME and np.abs(values_).max() <= _SAME:
        return True
    if frame[0] != frame_[0] or np.isnan(t[0]) != np.isnan(t_[0]):
        return False
    if np.isnan(t[0]):
        return bool(np.abs(values[0] - values_[0]).max() <= _SAME)
    at = np.union1d(t, t_)
    apart = [np.interp(at, t, a) - np.interp(at, t_, b) for a, b in zip(values.T, values_.T, strict=True)]
    return bool(np.abs(apart).max() <= _SAME)


def _is_cycle(program: Program, path: Segments, column: int, moves: Ints, text: str) -> bool:
    """Whether a line is a drilling cycle: consecutive rapid moves and cuts along the spindle, without a call."""
    m = program.motions
    if program.keeps_text or _CALL.search(_COMMENT.sub("", text)):
        return False
    rows = np.flatnonzero(m.line == m.line[moves[0]])
    if len(rows) != rows[-1] - rows[0] + 1 or not m.rapid[rows].any():
        return False
    along = np.einsum("ni,ni->n", tangent(program, path, moves, np.ones(len(moves))), m.target[moves, :3, column])
    return bool(((m.kind[moves] == LIN) & (np.abs(along) > _ALONG)).all())


def _differing(program: Program, two: Ints, count: int, text: str) -> ForceError:
    line, file = int(program.motions.line[two[0]]), program.documents[0].name
    found = program.places(two)
    at = [f"{name}:{number}" for name, number in map(found.of, range(2)) if (name, number) != (file, line)]
    where = f" ({', '.join(at)} …)" if at else ""
    problem = (
        f"the {count} cutting moves of this line{where} have different forces: a force CSV has one for all of them"
    )
    return ForceError(problem, file=file, line=line, text=text, advice=_ADVICE)
