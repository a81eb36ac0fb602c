"""Small programs as a reader would deliver them, made by hand for tests of the stages after reading."""

from __future__ import annotations

import numpy as np

from postproc import frames
from postproc.poses import Poses
from postproc.program import CIRC, LIN, PTP, Document, ForceNote, Motions, Program, Targets

DOWN = frames.pose_from_xyzabc([0, 0, 0, 0, 0, 180.0])[:3, :3]


def program(moves, notes=(), bases=None, tools=None, base=None, orientation=DOWN):
    """Moves: ("PTP"|"RAPID"|"LIN", x, y, z) or ("CIRC", x, y, z, cx, cy, cz, sweep_deg, normal); mm. One line each."""
    n = len(moves)
    nan = np.nan
    target = np.tile(np.eye(4), (n, 1, 1))
    target[:, :3, :3] = orientation
    target[:, :3, 3] = [np.array(m[1:4]) / 1000 for m in moves]
    kinds = {"PTP": PTP, "RAPID": LIN, "LIN": LIN, "CIRC": CIRC}
    arcs = [m if m[0] == "CIRC" else ("", 0, 0, 0, nan, nan, nan, nan, (nan, nan, nan)) for m in moves]
    motions = Motions(
        kind=np.array([kinds[m[0]] for m in moves]),
        rapid=np.array([m[0] in ("PTP", "RAPID") for m in moves]),
        line=np.arange(1, n + 1),
        target=Poses.of(target),
        joints=np.full((n, 6), nan),
        centre=np.array([np.array(a[4:7], dtype=float) / 1000 for a in arcs]),
        normal=np.array([np.array(a[8], dtype=float) for a in arcs]),
        sweep=np.radians([float(a[7]) for a in arcs]),
        feed=np.array([nan if m[0] == "PTP" else 0.5 if m[0] == "RAPID" else 0.05 for m in moves]),
        base=np.zeros(n, dtype=np.int64) if base is None else np.array(base),
        tool=np.zeros(n, dtype=np.int64),
        blend=np.full(n, 5e-4),
        rounding=np.full(n, 5e-5),
        status=np.full(n, -1),
        turn=np.full(n, -1),
    )
    return Program(
        name="part",
        dialect="gcode",
        documents=(Document("part.nc", ""),),
        motions=motions,
        bases=frames.pose_from_xyzabc([[1500.0, -200, 700, 0, 0, 0]]) if bases is None else bases,
        tools=frames.pose_from_xyzabc([[0.0, 0, 350, 0, 0, 0]]) if tools is None else tools,
        notes=tuple(ForceNote(*note, before=note[0] - 1) for note in notes),
    )


def ends(motions, pose):
    """One target for each motion, at its end, without S and T."""
    n = len(motions)
    none = np.full(n, -1)
    return Targets(
        np.arange(n),
        np.ones(n),
        motions.kind,
        Poses.of(pose),
        np.full((n, 3), np.nan),
        np.zeros(n, bool),
        none,
        none,
        motions.blend,
    )
