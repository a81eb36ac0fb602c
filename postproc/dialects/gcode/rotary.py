"""Rotary axes of a program with tool-centre-point control: X, Y, Z are the tip in the part, A, B, C tilt the tool.

A, B and C turn about X, Y and Z; `[rotary]` names them from the part outwards, with their signs. What counts is the
direction of the tool, R₁(a)·R₂(b)·z: a robot need not spin the tool about itself as the machine does
(`program.Swivel`). Before they are programmed, rotary axes stand at zero.
"""

from __future__ import annotations

import numpy as np

from postproc.cell import Rotary
from postproc.dialects.gcode.blocks import Fault
from postproc.dialects.gcode.moves import Moves, Setting
from postproc.dialects.gcode.rows import Rows
from postproc.errors import MOST
from postproc.frames import RAD_PER_DEG, Array
from postproc.program import Bools, Ints, Swivel

_UPWARDS = -0.9999
"""z of a tool direction beyond which there is no shortest way to it."""


def swivel_of(moves: Moves, kept: Ints, free: Bools, rotary: Rotary, setting: Setting) -> Swivel:
    """Return how the motions that are kept turn the tool.

    :param free: (M,) motions by joint interpolation, which start anywhere.
    """
    active = ~free & ~moves.home[kept]
    active[:1] = False
    return Swivel(
        begin=moves.turn[kept, 0] * RAD_PER_DEG,
        end=moves.turn[kept, 1] * RAD_PER_DEG,
        axes=_axes(rotary),
        frame=moves.frame[kept],
        frames=moves.frames[:, :3, :3],
        tool=setting.orientation,
        active=active,
    )


def _axes(rotary: Rotary) -> Array:
    signs = rotary.signs or [1] * len(rotary.axes)
    return np.array([sign * np.eye(3)["ABC".index(axis)] for axis, sign in zip(rotary.axes, signs, strict=True)])


def check_turning(rows: Rows, moves: Moves, rotary: Rotary) -> list[Fault]:
    """Return what cannot be done with rotary axes, in order of lines."""
    turns = (moves.turn[:, 0] != moves.turn[:, 1]).any(axis=1)
    turned = (moves.turn != 0.0).any(axis=(1, 2))
    placed = ~np.isnan(rows.xyz[moves.row]).all(axis=1) | (moves.code > 0.0)
    angles = np.concatenate([moves.turn[:, 0], moves.turn[:, 1]]) * RAD_PER_DEG
    every = np.zeros(len(angles), dtype=np.int64)
    swivel = Swivel(angles, angles, _axes(rotary), every, moves.frames[:, :3, :3], np.eye(3), every.astype(bool))
    upwards = (swivel.direction(angles)[:, 2] < _UPWARDS).reshape(2, -1).any(axis=0)
    faults: dict[int, Fault] = {}
    for wrong, problem, advice in (
        (turns & (moves.code >= 2.0), "rotary axes turn along an arc", "Let the CAM system write such moves as G1."),
        (upwards, "the tool points away from the part", "Check axes and signs in [rotary]."),
        (
            turned & placed & ~rows.tip[moves.row] & ~moves.home,
            "coordinates with tilted axes, but without tool-centre-point control",
            f"They depend on the machine: program {' or '.join(rotary.tcp_on)} before, or leave out [rotary] tcp_on.",
        ),
    ):
        for row in moves.row[wrong][: MOST + 1].tolist():
            faults.setdefault(row, Fault(row, problem, advice))
    return [faults[row] for row in sorted(faults)]
