"""Values of a cell that are possible, and nearly always a mistake: lengths in metres, a load that the arm cannot carry.

They are asked about, not refused: a touch probe on the flange may be short, and a manufacturer may release a load.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postproc.cell import Cell
from postproc.errors import Issue
from postproc.frames import MM_PER_M, Array, norm
from postproc.program import Program, distinct
from postproc.robot import RobotModel
from postproc.robot.rating import rated_payload

_SHORT_TOOL = 0.005
"""A tip nearer to the flange [m] is none of a spindle: 0.35 is a length in metres that is read in millimetres."""
_NEAR_BASE = 0.01
"""A base that is not zero and nearer to the robot root [m] is inside the foot of the arm."""


def of_setup(program: Program, cell: Cell, robot: RobotModel) -> Iterator[Issue]:
    """Yield a warning for each value of the cell, or frame of the program, to ask about."""
    m = program.motions
    cutting = np.flatnonzero(~m.rapid)
    length, distance = norm(program.tools[:, :3, 3]), norm(program.bases[:, :3, 3])
    table = "$TOOL of the program" if program.keeps_text else "[tool] or [tools.n] of the cell"
    for row in distinct(m.tool[cutting]):
        if length[row] < _SHORT_TOOL:
            message = (
                f"the tip of $TOOL ({_place(program.tools[row])}) is {length[row] * MM_PER_M:.3g} mm from the flange"
            )
            advice = f"is Z in mm? {table} is in mm: a tool of 0.35 m has Z = 350"
            yield m.issue("warning", "short-tool", f"{message}: {advice}", cutting[m.tool[cutting] == row])
    table = "$BASE of the program" if program.keeps_text else "[base] of the cell"
    for row in distinct(m.base[cutting]):
        if 0.0 < distance[row] < _NEAR_BASE:
            message = f"$BASE ({_place(program.bases[row])}) is {distance[row] * MM_PER_M:.3g} mm from the robot root"
            advice = f"are X, Y, Z in mm? {table} is in mm: 1.5 m are 1500"
            yield m.issue("warning", "near-base", f"{message}: {advice}", cutting[m.base[cutting] == row])
    rating = rated_payload(robot.title, robot.name)
    if rating is not None and cell.payload.mass_kg > rating:
        name = robot.title or robot.name
        message = (
            f"[payload] mass_kg = {cell.payload.mass_kg:g} is more than the {rating:g} kg of {name}: "
            "is it in kg? It counts in addition to what the arm carried when the model was calibrated"
        )
        yield Issue("warning", "payload-rating", message)


def _place(pose: Array) -> str:
    """Return X, Y, Z of a pose [m] in millimetres, in words."""
    return ", ".join(f"{name} {value:.6g}" for name, value in zip("XYZ", pose[:3, 3] * MM_PER_M, strict=True))
