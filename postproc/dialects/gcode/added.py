"""Moves that a robot needs and the program does not write: the way down to the part, chords of arcs that turn the tool.

A machine that comes from home travels in X and Y and then goes down. A robot that is sent to the place at once takes
the shortest way of its joints, through whatever stands there. So where `[machine] clearance_Z` says at which height
nothing stands, it goes there first, above its goal (with a tilted tool: along the tool), and then straight to it.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc.dialects.gcode.arcs import Arcs
from postproc.dialects.gcode.tool_positions import LEVEL, Moves, Setting
from postproc.frames import M_PER_MM, RAD_PER_DEG, Array, norm
from postproc.program import Bools, Ints, direction

_NEAR_MM = 1e-6


def arrivals(moves: Moves) -> tuple[Bools, Bools]:
    """Return which moves (N,) are held back, as not all of X, Y, Z are known, and which (N,) are made instead."""
    held_back, arriving = np.zeros(len(moves.row), dtype=bool), np.zeros(len(moves.row), dtype=bool)
    for first, last in moves.unknown:
        begin, end = np.searchsorted(moves.row, [first, last]).tolist()
        held_back[begin:end] = ~moves.home[begin:end]
        arriving[end : end + 1] = moves.code[end : end + 1] == 0.0
    return held_back, arriving


def approached(moves: Moves, setting: Setting) -> tuple[Moves, Bools, Bools]:
    """Return the moves with the way down to the part by itself, and what `arrivals` says of them.

    From `[start]`, where the user has the program begin, the robot goes to the first place as it always does.
    """
    held_back, arriving = arrivals(moves)
    back = arriving & (moves.row >= min((first for first, _ in moves.unknown[1:]), default=np.inf))
    if setting.clearance is None or not back.any():
        return moves, held_back, arriving
    frames = moves.frames[moves.frame]
    tool = direction(setting.axes, moves.turn[:, 1] * RAD_PER_DEG)
    tool_z = np.einsum("ni,ni->n", frames[:, 2, :3], tool)
    z = np.einsum("ni,ni->n", frames[:, 2, :3], moves.end) + frames[:, 2, 3] / M_PER_MM
    split = back & (z < setting.clearance - _NEAR_MM) & (tool_z > LEVEL)
    count = 1 + split.astype(np.int64)
    above = np.cumsum(count)[split] - 2
    out = moves.repeated(count)
    begin, end = out.begin.copy(), out.end.copy()
    end[above] += tool[split] * ((setting.clearance - z[split]) / tool_z[split])[:, None]
    begin[above + 1] = end[above]
    turn = out.turn.copy()
    turn[above + 1, 0] = turn[above, 1]
    arriving = np.repeat(arriving, count)
    arriving[above + 1] = False
    return replace(out, begin=begin, end=end, turn=turn), np.repeat(held_back, count), arriving


def chords(moves: Moves, circular: Ints, arcs: Arcs, tolerance: float) -> tuple[Moves, Ints]:
    """Return the moves with arcs along which rotary axes turn as straight ones, and how many there are of each (N,).

    :param circular: (A,) which moves are `arcs`.
    :param tolerance: what chords may leave them by [mm].
    """
    count = np.ones(len(moves.row), dtype=np.int64)
    turns = (moves.turn[circular, 0] != moves.turn[circular, 1]).any(axis=1)
    if not turns.any():
        return moves, count
    radial = moves.begin[circular] - arcs.centre
    angle = np.sqrt(8.0 * tolerance / np.maximum(norm(radial), tolerance))
    count[circular[turns]] = np.ceil(arcs.sweep[turns] / angle[turns] - 1e-9).astype(np.int64)
    out = moves.repeated(count)
    code, begin, end, turn = out.code.copy(), out.begin.copy(), out.end.copy(), out.turn.copy()
    first = np.cumsum(count) - count
    for n in np.flatnonzero(turns).tolist():
        move = circular[n]
        rows = slice(first[move], first[move] + count[move])
        share = np.linspace(0.0, 1.0, count[move] + 1)[:, None]
        path = _along(moves.begin[move], moves.end[move], radial[n], arcs.normal[n], arcs.sweep[n] * share)
        path[-1] = moves.end[move]
        angles = moves.turn[move, 0] + share * (moves.turn[move, 1] - moves.turn[move, 0])
        code[rows], begin[rows], end[rows] = 1.0, path[:-1], path[1:]
        turn[rows] = np.stack([angles[:-1], angles[1:]], axis=1)
    return replace(out, code=code, begin=begin, end=end, turn=turn), count


def _along(begin: Array, end: Array, radial: Array, normal: Array, angle: Array) -> Array:
    """Return the points (n, 3) of a helix at angles (n, 1) from 0 to its whole; the radius may grow."""
    share = angle / angle[-1]
    climb = normal * (normal @ (end - begin))
    growth = norm(end - climb - begin + radial) / norm(radial) - 1.0
    turned = np.cos(angle) * radial + np.sin(angle) * np.cross(normal, radial)
    return np.asarray(begin - radial + turned * (1.0 + share * growth) + share * climb)
