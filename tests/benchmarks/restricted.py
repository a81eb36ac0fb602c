"""A published case of milling in restricted space: which straight paths through it one turn of the tool can drive.

Run: python -m tests.benchmarks.restricted SDG1V7sim350_400E1.STL

Su et al., "Investigation of the 3D-posture planning for space-restricted robotic milling", Int. J. Machine Tools and
Manufacture 215 (2026) 104364; its geometry (STL, in metres) is public: github.com/large-su,
"A-benchmark-for-robotic-milling-in-restricted-spaces". Published are the enclosure, a horizontal straight path of 1.3 m
in steps of 2 mm (651 points) and a tool of 25 mm diameter. Not published there: where the path is, where the robot (an
ABB IRB 6660) stands, how the tool is tilted, and the spindle. The authors say that the turn about the tool axis alone
has no solution. Here the ABB IRB 6700 of the package stands in front of the enclosure, each of its four long sides is
up once, the tool points down, and the path lies at points of a grid over the section where the tip is in free air.
Printed is how many of these paths can be driven with `redundancy = "path"`, and what is in the way on the others.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import trimesh
from msgspec.structs import replace

import postproc
from postproc import cell as cells
from postproc import placement
from postproc.errors import PostprocError
from postproc.frames import Array, xyzabc_from_pose
from postproc.jobs.started_program import read_with_start
from postproc.under_load import RobotInCell
from tests.places import ROOT

LENGTH, STEP, RADIUS = 1.3, 2e-3, 12.5e-3
HOLDER = [
    cells.HolderTable(diameter_mm=25, length_mm=80),
    cells.HolderTable(name="holder", diameter_mm=63, length_mm=80),
    cells.HolderTable(name="spindle", diameter_mm=160, length_mm=180),
]
CENTRE = np.array([1.7, 0.0, 0.9])
"""Of the enclosure in the robot root [m]; assumed."""


BASE = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Axes of `$BASE` in the root, in columns: the path goes across in front of the robot, the tool points down."""


def clear(triangles: Array, points: Array) -> bool:
    """Return whether points (N, 3) are outside of a closed mesh (M, 3, 3) and at least `RADIUS` off it [m].

    The solid angle of a triangle is that of van Oosterom and Strackee (IEEE Trans. Biomed. Eng. 30, 1983).
    """
    a, b, c = np.moveaxis(triangles[None] - points[:, None, None], 2, 0)
    r, s, t = (np.linalg.norm(each, axis=-1) for each in (a, b, c))
    dot = [np.einsum("nmi,nmi->nm", one, two) for one, two in ((a, b), (b, c), (c, a))]
    volume = np.einsum("nmi,nmi->nm", a, np.cross(b, c))
    turns = np.arctan2(volume, r * s * t + dot[0] * t + dot[1] * r + dot[2] * s).sum(axis=1) / (2.0 * np.pi)
    pairs = np.repeat(points, len(triangles), axis=0)
    closest = trimesh.triangles.closest_point(np.tile(triangles, (len(points), 1, 1)), pairs)
    return bool(np.abs(turns).max() < 0.5 and np.linalg.norm(closest - pairs, axis=1).min() > RADIUS)


def straight_program() -> str:
    """Return the path along X of `$BASE`, in mm."""
    points = np.arange(0.0, LENGTH + STEP / 2, STEP) * 1e3
    blocks = "\n".join(f"G1 X{x:g} F3000" for x in points)
    return f"G21 G90 G17 G94\nT1 M6\nS12000 M3\nF3000\nG1 X0 Y0 Z0\n(FORCE FX=-90 FY=-90 FZ=90)\n{blocks}\nM30\n"


def main() -> None:
    """Print how many paths can be driven, and why the others cannot."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("mesh", type=Path)
    options.add_argument("--grid", type=int, default=4)
    chosen = options.parse_args()
    mesh = trimesh.load(chosen.mesh, force="mesh")
    cell = postproc.load_cell(ROOT / "samples" / "cell_irb6700.toml")
    robot = postproc.load_robot(cell.robot)
    (low, high) = mesh.bounds[:, 1:]
    steps = (np.arange(chosen.grid) + 0.5) / chosen.grid
    grid = [low + (high - low) * np.array([a, b]) for a in steps for b in steps]
    along = np.linspace(0.0, LENGTH, 66)
    free = []
    for y, z in grid:
        line = np.column_stack([along, np.full_like(along, y), np.full_like(along, z)])
        if clear(mesh.triangles, line):
            free.append((y, z))
    print(f"{len(free)} of {len(grid)} paths of the grid are {1e3 * RADIUS:g} mm off the enclosure")
    outcomes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "part.nc").write_text(straight_program())
        for side in range(4):
            about_x = trimesh.transformations.rotation_matrix(side * np.pi / 2.0, [1.0, 0.0, 0.0])
            for y, z in free:
                moved = mesh.copy()
                moved.apply_translation([0.0, -y, -z])
                moved.apply_transform(about_x)
                pose = np.eye(4)
                pose[:3, :3] = BASE
                pose[:3, 3] = CENTRE - BASE @ moved.bounds.mean(axis=0)
                moved.apply_scale(1e3)
                moved.export(folder / "space.stl")
                base = cells.Frame(*xyzabc_from_pose(pose).tolist())
                outcomes[outcome(cell, robot, folder, base)] += 1
    print(f"{outcomes['drivable']} of {outcomes.total()} can be driven")
    for words, count in outcomes.most_common():
        print(f"{count:4d}  {words}")


def outcome(cell: cells.Cell, robot: postproc.RobotModel, folder: Path, base: cells.Frame) -> str:
    """Return ``drivable``, or why not in few words."""
    space = cells.ObstacleTable(name="enclosure", mesh="space.stl")
    inside = replace(
        cell,
        base=base,
        start=None,
        gcode=replace(cell.gcode, redundancy="path"),
        collision=cells.Collision(holder=HOLDER, obstacles=[space]),
        folder=str(folder),
    )
    try:
        read, started = read_with_start(folder / "part.nc", robot, inside)
        turn, issues = placement.choose_turn(read, RobotInCell.of(robot, started), None, "path")
    except PostprocError as error:
        return str(error).splitlines()[0][:160]
    return issues[0].message.partition(" at best")[0] if turn is None else "drivable"


if __name__ == "__main__":
    main()
