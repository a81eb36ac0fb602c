"""Forces of tools that turn while they cut, on random surfaces, against exact fronts.

Run: python -m tests.benchmarks.turning_fronts [--seeds N] [--only WORD …]

Prints for each cutter and path, over the drawn programs: RMS of the error of the force at random places as a share of
the RMS of the force; how many places have an error above 15 % of the force there, and the largest. Places are clear of
edges of the stock (entries and exits). Surfaces, tilts of the tool, directions and lengths of moves are drawn anew. A
program whose slot is so deep that the leaning tool undercuts its wall is refused: it is named, and drawn again.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc import forces as force_sources
from postproc import machining, toolpath
from postproc.cell import Rotary
from postproc.errors import ForceError
from postproc.under_load import RobotInCell
from tests.benchmarks.fronts import ALLOWED, PER_TOOTH, RPM, STOCK, in_stock, rms, rows, surface
from tests.machining.setting import AL7075, CELL, ROBOT, gcode, process, read, tool
from tests.oracle import fronts

FIVE = replace(CELL, rotary=Rotary(axes=["C", "B"], signs=[1, 1], kind="tcp"))


class Case(NamedTuple):
    """A cutter [mm], passes over a surface with their depth [mm], and the tilt of the tool [°] with its change."""

    shape: str
    radius: float
    corner: float
    teeth: int
    path: str
    depth: float
    tilt: float
    change: float


CASES = {
    "ball R3 finish 0.35, 20° ± 8°": Case("ball", 3.0, 3.0, 2, "finish", 0.35, 20.0, 8.0),
    "ball R3 rough 1, 20° ± 8°": Case("ball", 3.0, 3.0, 2, "rough", 1.0, 20.0, 8.0),
    "ball R3 rough 1, 0° ± 20°": Case("ball", 3.0, 3.0, 2, "rough", 1.0, 0.0, 20.0),
    "bull R5 c1 rough 1.5, 8° ± 4°": Case("bull", 5.0, 1.0, 3, "rough", 1.5, 8.0, 4.0),
    "flat R5 rough 1.5, 8° ± 4°": Case("flat", 5.0, 0.0, 3, "rough", 1.5, 8.0, 4.0),
    "flat R5 rough 3, 0° ± 3°": Case("flat", 5.0, 0.0, 3, "rough", 3.0, 0.0, 3.0),
    "bull R5 c1 side 6, 4° ± 2°": Case("bull", 5.0, 1.0, 3, "side", 6.0, 4.0, 2.0),
    "ball R4 indexed 1, 30°": Case("ball", 4.0, 4.0, 2, "rough", 1.0, 30.0, 0.0),
}  # fmt: skip


def axes_of(b, c):
    """Axes of the tool (n, 3, 3) as columns, z to the spindle, of angles B and C (n,) [°]: Rz(C)·Ry(B)."""
    (sb, cb), (sc, cc) = ((np.sin(np.radians(each)), np.cos(np.radians(each))) for each in (b, c))
    z = np.stack([cc * sb, sc * sb, cb], axis=-1)
    x = np.stack([cc * cb, sc * cb, -sb], axis=-1)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def tilts(rng, case, passes):
    """B and C [°] at the points of passes, to 10⁻⁴, smooth along the path."""
    turn, phase = rng.uniform(0, 2 * math.pi), rng.uniform(0, 2 * math.pi, 2)
    lean = math.tan(math.radians(case.tilt)) * np.array([math.cos(turn), math.sin(turn)])
    direction = rng.normal(size=(2, 2))
    direction *= (2 * math.pi / rng.uniform(20, 60, 2) / np.linalg.norm(direction, axis=1))[:, None]
    out, before = [], 0.0
    for points in passes:
        u, v = (
            lean[k] + math.tan(math.radians(case.change)) * np.sin(points[:, :2] @ direction[k] + phase[k])
            for k in (0, 1)
        )
        c = np.degrees(np.unwrap(np.arctan2(v, u)))
        c -= 360.0 * round((c[0] - before) / 360.0)
        out.append(np.round(np.stack([np.degrees(np.arctan(np.hypot(u, v))), c], axis=-1), 4))
        before = c[-1]
    return out


def job(rng, case):
    """Draw passes as polylines (n, 3) [mm], and the first of those in which places are drawn."""
    length = rng.uniform(0.3, 0.8) if rng.uniform() < 2 / 3 else rng.uniform(1.0, 3.0)
    turn, radius = rng.uniform(0, 2 * math.pi), case.radius
    if case.path == "side":  # along a wall that a pass before it has left
        step, floor = rng.uniform(0.1, 0.5) * radius, -case.depth
        return rows(turn, lambda x, y: 0.0 * x + floor, radius, step, length, 3), 1
    z = surface(rng, radius)
    if case.path == "finish":
        step = rng.uniform(0.1, 0.25) * radius
        before = rows(turn, lambda x, y: z(x, y) + case.depth, radius, step, length, 10)
        return before + rows(turn, z, radius, step, length, 6), len(before) + 3
    return rows(turn, lambda x, y: z(x, y) - case.depth, radius, rng.uniform(0.3, 1.0) * radius, length, 3), 0


def applied(folder, case, passes, angles, cell):
    """Return the program, its path, and its forces as `convert` uses them."""
    blocks = []
    for points, tilt in zip(passes, angles, strict=True):
        (x, y, z), (b, c) = points[0], tilt[0]
        blocks += ["G0 Z40", f"G0 X{x:.5f} Y{y:.5f} B{b:.4f} C{c:.4f}", f"G0 Z{z:.5f}"]
        blocks.append(f"G1 F{PER_TOOTH * RPM * case.teeth:g}")
        blocks += [
            f"G1 X{x:.5f} Y{y:.5f} Z{z:.5f} B{b:.4f} C{c:.4f}"
            for (x, y, z), (b, c) in zip(points[1:], tilt[1:], strict=True)
        ]
    program = read(folder, gcode(*blocks, "G0 Z40", spindle=f"S{RPM:g} M3"), cell=FIVE)
    text = process(tool(2 * case.radius, case.teeth, case.shape, case.corner), STOCK, cell or 0.25)
    (folder / "process.toml").write_text(text if cell else text.replace("resolution_mm = 0.25\n", ""))
    place = RobotInCell.of(ROBOT, FIVE)
    path = toolpath.segments(program, place.start_flange)
    source = machining.ProcessSource(machining.load(folder / "process.toml"), place.spindle)
    return program, path, force_sources.assign(program, path, source, place.spindle, place.ramp)


def compared(folder, case, rng, cell=None, count=25, fineness=0.02):
    """Draw a program of a case; return its forces (n, 3) at random places [N], and those expected."""
    passes, first = job(rng, case)
    angles = tilts(rng, case, passes)
    passes = [np.round(points, 5) for points in passes]
    program, path, found = applied(folder, case, passes, angles, cell)
    gap = 0.08 if case.corner > 0.0 else 0.05  # between poses of the exact front [mm]
    tip, tilt, move, share = [], [], [], []
    moves = [(k, row) for k, points in enumerate(passes) for row in range(len(points) - 1)]
    for number, (k, row) in enumerate(moves):
        chord, turn = passes[k][row + 1] - passes[k][row], angles[k][row + 1] - angles[k][row]
        parts = max(1, math.ceil(np.linalg.norm(chord) / gap))
        place = (np.arange(parts) + 0.5) / parts
        tip.append(passes[k][row] + place[:, None] * chord)
        tilt.append(angles[k][row] + place[:, None] * turn)
        move.append(np.full(parts, number))
        share.append(place)
    tip, tilt, move, share = map(np.concatenate, (tip, tilt, move, share))
    clear = min(case.radius, 4.0)
    inner = np.all([(tip[:, k] > clear) & (tip[:, k] < STOCK[k][1] - clear) for k in (0, 1)], axis=0)
    inner &= (share > 0.15) & (share < 0.95) & (move >= sum(len(points) - 1 for points in passes[:first]))
    chosen = np.sort(rng.choice(np.flatnonzero(inner), count, replace=False))
    top = -float(tip[:, 2].min()) / math.cos(math.radians(float(tilt[:, 0].max()))) + 0.5 * case.radius
    cutter = fronts.Cutter(case.radius, case.corner, case.teeth, fineness * case.radius, top)
    per_tooth = np.full(len(tip), PER_TOOTH)
    axes = axes_of(*tilt.T)
    expected = fronts.turning_forces(cutter, tip, axes, chosen.tolist(), per_tooth, AL7075, in_stock)
    cutting = np.flatnonzero(~program.motions.rapid)[move[chosen]]
    return found.at(toolpath.at(program, path, cutting, share[chosen]))[:, :3], expected[:, :3]


def without_undercut(name, seed, cell):
    """Draw programs until the tool leaves no material above itself: a map cannot hold it, and such cuts are refused."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            with tempfile.TemporaryDirectory() as folder:
                return compared(Path(folder), CASES[name], rng, cell)
        except ForceError as refusal:
            if "undercut" not in str(refusal):
                raise
            print(f"{name}, seed {seed}: drawn again, {refusal}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="programs of each case")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", nargs="*", default=[], help="cases whose name has one of these words")
    parser.add_argument("--cell", type=float, help="resolution_mm of the stock")
    options = parser.parse_args()
    for name in CASES:
        if options.only and not any(word in name for word in options.only):
            continue
        programs = []
        for seed in range(options.first, options.first + options.seeds):
            programs.append(without_undercut(name, seed, options.cell))
        found, expected = (np.concatenate(column) for column in zip(*programs, strict=True))
        size = np.maximum(np.linalg.norm(expected, axis=1), 0.1 * rms(expected))
        shares = np.linalg.norm(found - expected, axis=1) / size
        print(
            f"{name}: RMS {100 * rms(found - expected) / rms(expected):.1f} % of {rms(expected):.0f} N, by program "
            f"{' '.join(f'{100 * rms(a - b) / rms(b):.1f}' for a, b in programs)}; over {100 * ALLOWED:.0f} %: "
            f"{np.count_nonzero(shares > ALLOWED)} of {len(shares)} places, largest {100 * shares.max():.0f} %",
            flush=True,
        )


if __name__ == "__main__":
    main()
