"""Rotary axes of a program with tool-centre-point control: X, Y, Z are the tip in the part, A, B, C tilt the tool.

A, B and C turn about X, Y and Z; `[rotary]` names them from the part outwards, with their signs. What counts is the
direction of the tool, R₁(a)·R₂(b)·z: a robot need not spin the tool about itself as the machine does
(`program.Swivel`). Before they are programmed, rotary axes stand at zero.

F of a move that turns axes alone is in degrees a minute, as in LinuxCNC: √(ΔA² + ΔB² + ΔC²) over F is its time.
"""

from __future__ import annotations

import numpy as np

from postproc.cell import Rotary
from postproc.dialects.gcode.blocks import Fault
from postproc.dialects.gcode.line_states import LineStates
from postproc.dialects.gcode.tool_positions import Moves, Setting
from postproc.errors import MOST
from postproc.frames import RAD_PER_DEG, Array, angle_between, norm
from postproc.program import Bools, Ints, Swivel, direction, tilted, turning

_UPWARDS = -0.9999
"""z of a tool direction beyond which there is no shortest way to it."""
_STEPS = 32
"""In so many steps the way of the tool is measured."""
_S_PER_MIN = 60.0


def axes_of(rotary: Rotary | None) -> Array:
    """Return what the axes turn about (k, 3), from the part outwards, sign included."""
    if rotary is None:
        return np.zeros((0, 3))
    signs = rotary.signs or [1] * len(rotary.axes)
    return np.array([sign * np.eye(3)["ABC".index(axis)] for axis, sign in zip(rotary.axes, signs, strict=True)])


def turned(moves: Moves, axes: Array) -> Array:
    """Return by how much moves turn the tool at most (N,) [rad]: nothing where it stands along the axis that turns."""
    out = np.zeros(len(moves.row))
    rows = np.flatnonzero((moves.turn[:, 0] != moves.turn[:, 1]).any(axis=1))
    if len(rows):
        out[rows] = turning(axes, moves.turn[rows, 0] * RAD_PER_DEG, moves.turn[rows, 1] * RAD_PER_DEG)
    return out


def swivel_of(moves: Moves, rows: LineStates, kept: Ints, free: Bools, alone: Bools, setting: Setting) -> Swivel:
    """Return how the motions that are kept turn the tool.

    :param free: (M,) motions by joint interpolation, which start anywhere.
    :param alone: (M,) motions that turn the tool and do not move its tip, at the feed.
    """
    active = ~free & ~moves.home[kept]
    active[:1] = False
    begin, end = moves.turn[kept, 0] * RAD_PER_DEG, moves.turn[kept, 1] * RAD_PER_DEG
    rate = np.full(len(kept), np.nan)
    at = np.flatnonzero(alone)
    if len(at):
        row = moves.row[kept[at]]
        degrees = norm(moves.turn[kept[at], 1] - moves.turn[kept[at], 0])
        minutes = np.where(rows.inverse_time[row], 1.0, degrees) / rows.rate[row]
        rate[at] = _way(setting.axes, begin[at], end[at]) / (minutes * _S_PER_MIN)
    return Swivel(
        begin=begin,
        end=end,
        axes=setting.axes,
        frame=moves.frame[kept],
        frames=moves.frames[:, :3, :3],
        tool=setting.orientation,
        active=active,
        rate=rate,
    )


def _way(axes: Array, begin: Array, end: Array) -> Array:
    """Return by how much a tool turns (n,) [rad] on its way."""
    out = np.zeros(len(begin))
    before = tilted(direction(axes, begin))
    for step in range(1, _STEPS + 1):
        after = tilted(direction(axes, begin + (end - begin) * (step / _STEPS)))
        out += angle_between(before, after)
        before = after
    return out


def check_turning(rows: LineStates, moves: Moves, held_back: Bools, axes: Array, tip_on: str) -> list[Fault]:
    """Return what cannot be done with rotary axes, in order of lines.

    :param held_back: (N,) moves that are not made, because not all of X, Y, Z are known.
    :param tip_on: codes from which on X, Y, Z are those of the tip.
    """
    tilt = (moves.turn != 0.0).any(axis=(1, 2))
    placed = ~np.isnan(rows.xyz[moves.row]).all(axis=1) | (moves.code > 0.0)
    angles = np.concatenate([moves.turn[:, 0], moves.turn[:, 1]]) * RAD_PER_DEG
    upwards = (direction(axes, angles)[:, 2] < _UPWARDS).reshape(2, -1).any(axis=0)
    faults: dict[int, Fault] = {}
    for wrong, problem, advice in (
        (upwards, "the tool points away from the part", "Check axes and signs in [rotary]."),
        (
            tilt & placed & ~rows.tip[moves.row] & ~moves.home & ~held_back,
            "coordinates with tilted axes, but without tool-centre-point control",
            f"They depend on the machine: program {tip_on} before, retract by G53 Z or G28 Z as [machine] says, or "
            "leave out [rotary] tcp_on.",
        ),
    ):
        for row in moves.row[wrong][: MOST + 1].tolist():
            faults.setdefault(row, Fault(row, problem, advice))
    return [faults[row] for row in sorted(faults)]
