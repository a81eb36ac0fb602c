"""What the choice of turn and the check of collisions cost on a long program.

Run: python -m tests.benchmarks.placement [--targets 200000]

A ball cutter goes line by line over a wavy surface of 300 × 200 mm under a force, on the KR 270 with the meshes of a
holder and a spindle as cylinders, a table and a vice. Wall and processor time of

- map and path: `redundancy = "path"`, without and with [collision];
- collisions: the check of the corrected path.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from msgspec.structs import replace

import postproc
from postproc import cell as cells
from postproc import placement
from postproc.correction import collisions
from postproc.correction.process import corrected_commands
from postproc.under_load import MotionsUnderLoad, PathUnderLoad, RobotInCell
from tests.benchmarks.process import surface
from tests.kr270 import CELL

COLLISION = cells.Collision(
    holder=[
        cells.HolderTable(diameter_mm=10, length_mm=60),
        cells.HolderTable(name="holder", diameter_mm=63, length_mm=80),
        cells.HolderTable(name="spindle", diameter_mm=120, length_mm=200),
    ],
    obstacles=[
        cells.ObstacleTable(name="table", box=cells.Box(X=(-200.0, 500.0), Y=(-200.0, 400.0), Z=(-100.0, -50.0))),
        cells.ObstacleTable(name="vice", box=cells.Box(X=(-60.0, -20.0), Y=(0.0, 200.0), Z=(-50.0, 10.0))),
    ],
)
T = TypeVar("T")


def timed(name: str, work: Callable[[], T]) -> T:
    """Print wall and processor time of some work."""
    wall, own = time.perf_counter(), time.process_time()
    out = work()
    print(
        f"{name}: {time.perf_counter() - wall:.1f} s, {time.process_time() - own:.1f} s of processor time", flush=True
    )
    return out


def surface_program(targets: int) -> str:
    """Return the program."""
    blocks = "\n".join(surface(targets, 0, 300, 400))
    head = "G21 G90 G17 G94\nT1 M6\nS12000 M3\nG0 X0 Y0 Z30\n(FORCE FX=-110 FY=-90 FZ=130 FRAME=FEED)\nG1 Z-6 F3000"
    return f"{head}\n{blocks}\nG0 Z50\nM30\n"


def main() -> None:
    """Print the times."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--targets", type=int, default=200_000)
    chosen = options.parse_args()
    cell = replace(CELL, gcode=replace(CELL.gcode, redundancy="path"), start=cells.Start((0, -90, 100, 0, 80, 0)))
    robot = postproc.load_robot(cell.robot)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "part.nc"
        file.write_text(surface_program(chosen.targets))
        read = postproc.read_program(file, robot, cell)
    print(f"{len(read.motions)} targets, one process")
    inside = replace(cell, collision=COLLISION)
    turn = None
    for name, of in (("map and path", cell), ("map and path with [collision]", inside)):
        turn, issues = timed(name, lambda of=of: placement.choose_turn(read, RobotInCell.of(robot, of), None, "path"))
        print("  " + " ".join(issue.message for issue in issues))
    turned = read if turn is None else placement.turn_program(read, cell.tool.axis, turn.of_motion)
    motions = MotionsUnderLoad.of(turned, RobotInCell.of(robot, inside), None)
    path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    command = corrected_commands(path)
    smallest, issues = timed("collisions of the path", lambda: collisions.path_clearance(path, command.q))
    assert smallest is not None
    words = f"smallest clearance {smallest.distance * 1e3:.1f} mm, {' and '.join(smallest.bodies)}"
    print(f"  {len(path)} samples; {words}; {len(issues)} errors")


if __name__ == "__main__":
    main()
