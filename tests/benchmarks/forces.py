"""How long the sweep takes, and how forces converge with the cell of the map: python -m tests.benchmarks.forces

Time is processor time of this process. Convergence: forces beside a slot and in a bore, at cells of 1 mm down to
0.0625 mm, against the cutter that is turned tooth by tooth; walls stand askew to the cells. The order is the slope of
the error over the cell.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path

import numpy as np

from postproc.machining import thinning
from tests.machining.setting import AL7075, forces, gcode, on_line, process, tool
from tests.oracle.teeth import Teeth

MOVES = 100_000
BOX = ((0, 200), (0, 200), (-20, 0))


def surface():
    """A ball cutter over a wavy surface, line by line: moves of 0.4 mm."""
    for row in range(200):
        x = np.linspace(0, 200, MOVES // 200)[:: 1 if row % 2 == 0 else -1]
        z = -6 + 3 * np.sin(x / 20) * math.cos(row / 25)
        yield from (f"X{a:.3f} Y{row:.3f} Z{b:.3f}" for a, b in zip(x, z, strict=True))


def spiral():
    """A flat cutter, four levels of a spiral: moves of 0.3 mm."""
    turn = np.linspace(0, 2 * math.pi * 25, MOVES // 4)
    x, y = 100 + 90 * turn / turn[-1] * np.cos(turn), 100 + 90 * turn / turn[-1] * np.sin(turn)
    for level in range(1, 5):
        yield "G0 Z5"
        yield "X100 Y100"
        yield f"G1 Z{-1.5 * level} F1000"
        yield from (f"X{a:.3f} Y{b:.3f} F3000" for a, b in zip(x, y, strict=True))


def hatch():
    """A flat cutter to and fro in long moves, cut into short ones on the way: 20 levels."""
    for level in range(1, 21):
        yield f"G1 Z{-0.9 * level} F1000"
        for row in range(50):
            x = np.linspace(0, 200, MOVES // 1000)[:: 1 if row % 2 == 0 else -1]
            yield from (f"X{a:.3f} Y{4 * row:.3f} F3000" for a in x)


def speed(folder):
    for name, blocks, shape in (("surface", surface, "ball"), ("spiral", spiral, "flat"), ("hatch", hatch, "flat")):
        text = gcode("G0 X0 Y0 Z5", "G1 F3000", *blocks(), spindle="S12000 M3")
        spent = [0.0]

        def progress(done, of, spent=spent):
            spent[0] = spent[0] or time.process_time()

        _, found = forces(folder, text, process(tool(10, 4, shape), BOX, 0.5), progress=progress)
        spent = time.process_time() - spent[0]
        count = text.count("\n")
        print(f"{name}: {count} moves, {spent:.1f} s, {len(found.along.t)} places, {found.removed * 1e9:.0f} mm³")


CELLS = (1.0, 0.5, 0.25, 0.125, 0.0625)


def convergence(folder):
    """Print errors and orders, of all places along the path: none is thinned out."""
    thinning._SHARE = thinning._LEAST = 0.0
    turn = math.radians(17.0)
    c, s = math.cos(turn), math.sin(turn)
    box = ((-60, 60), (-60, 60), (-20, 0))

    def placed(x, y):
        return f"X{c * x - s * y:.6f} Y{s * x + c * y:.6f}"

    def slot(point, radius):
        along = np.clip(c * point[:, 0] + s * point[:, 1], -70, 70)
        across = -s * point[:, 0] + c * point[:, 1]
        inside = np.abs(across) < radius
        return (point[:, 2] < 0) & ~(inside & (np.abs(along) < 70))

    cases = {}
    side = gcode(
        f"G0 {placed(-70, 0)} Z5", "G1 Z-3 F2400", placed(70, 0), "G0 Z5", placed(-70, 3.21), "G1 Z-3",
        f"{placed(70, 3.21)}",
    )  # fmt: skip
    flat = Teeth(5.0, 0.0, 4, AL7075).side(3.0)
    tip = (-s * 3.21, c * 3.21, -3)
    expected, _ = flat.mean(tip, (c, s, 0), 0.1, lambda p: slot(p, 5.0), steps=1440)
    cases["beside a slot"] = (side, tool(10, 4), 10, 0.5, expected)
    bore = gcode("G0 X7.3 Y0 Z5", "G1 Z-3 F2400", "G3 X7.3 Y0 I-7.3 J0", "G1 X9.1", "G3 X9.1 Y0 I-9.1 J0")

    def ring(point):
        return (point[:, 2] < 0) & (np.hypot(point[:, 0], point[:, 1]) > 12.3)

    angle = 2 * math.pi * 0.61
    tip = (9.1 * math.cos(angle), 9.1 * math.sin(angle), -3)
    heading = (-math.sin(angle), math.cos(angle), 0)
    cases["in a bore"] = (bore, tool(10, 4), 8, 0.61, flat.mean(tip, heading, 0.1, ring, steps=1440)[0])
    for name, (text, cutter, line, t, expected) in cases.items():
        errors = []
        for cell in CELLS:
            program, found = forces(folder, text, process(cutter, box, cell))
            force = on_line(program, found, line, np.linspace(t - 0.1, t + 0.1, 41) if name != "in a bore" else t)[:3]
            force = force.mean(axis=-1) if force.ndim > 1 else force
            errors.append(float(np.linalg.norm(force - expected) / np.linalg.norm(expected)))
        order = np.polyfit(np.log(CELLS), np.log(errors), 1)[0]
        told = ", ".join(f"{cell:g} mm {100 * error:.2f} %" for cell, error in zip(CELLS, errors, strict=True))
        print(f"{name}: {told}; order {order:.1f}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as where:
        speed(Path(where))
        convergence(Path(where))
