"""How long the sweep takes, and how forces converge with the cell of the map: python -m tests.benchmarks.forces

Time is processor time of this process. Convergence: RMS of the error over places along a slot, beside it, in a bore and
on a slope, at cells of 1 mm down to 0.0625 mm, against the cutter that is turned tooth by tooth; walls stand askew to
the cells. The order is the slope of the error over the cell: 2 where no wall ends the cut, 1 where one does, since the
place where the front meets a wall is known to some tenths of a cell. At one place that error is as good as random, so
that a single one tells nothing.
"""

from __future__ import annotations

import math
import tempfile
import time
from pathlib import Path

import numpy as np

from postproc.machining import profiles
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
        print(
            f"{name}: {count} moves, {spent:.1f} s, {len(found.knots.t)} places, {found.removed_volume * 1e9:.0f} mm³"
        )


CELLS = (1.0, 0.5, 0.25, 0.125, 0.0625)
STEPS = 14_400


TURN = math.radians(17.0)
COS, SIN = math.cos(TURN), math.sin(TURN)


def placed(x, y):
    """A block's X and Y, askew to the cells."""
    return f"X{COS * x - SIN * y:.6f} Y{SIN * x + COS * y:.6f}"


def cases():
    """Yield name, program, tool, line of the motion, places on it, and the force expected at each."""
    flat = Teeth(5.0, 0.0, 4, AL7075).side(3.0, discs=1)

    def along_slot(y, stands):
        tip = (-SIN * y, COS * y, -3)
        own = lambda p: stands(COS * p[:, 0] + SIN * p[:, 1], -SIN * p[:, 0] + COS * p[:, 1])  # noqa: E731
        return flat.mean(tip, (COS, SIN, 0), 0.1, own, steps=STEPS)[0]

    straight = np.linspace(0.4, 0.6, 41)
    first = (f"G0 {placed(-70, 0)} Z5", "G1 Z-3 F2400", placed(70, 0))
    yield "slot", gcode(*first), tool(10, 4), 6, straight, along_slot(0, lambda x, y: x < 1e9)
    beside = gcode(*first, "G0 Z5", placed(-70, 3.21), "G1 Z-3", placed(70, 3.21))
    yield "side", beside, tool(10, 4), 10, straight, along_slot(3.21, lambda x, y: np.abs(y) > 5.0)
    bore = gcode("G0 X7.3 Y0 Z5", "G1 Z-3 F2400", "G3 X7.3 Y0 I-7.3 J0", "G1 X9.1", "G3 X9.1 Y0 I-9.1 J0")
    wall = flat.mean((9.1, 0, -3), (0, 1, 0), 0.1, lambda p: np.hypot(p[:, 0], p[:, 1]) > 12.3, steps=STEPS)[0]
    yield "bore", bore, tool(10, 4), 8, np.linspace(0.3, 0.7, 81), wall
    ball, places = Teeth(5.0, 5.0, 2, AL7075, discs=1000), np.linspace(0.2, 0.8, 13)
    slope = gcode(f"G0 {placed(-20, 0)} Z5", "G1 Z-0.5 F2400", f"{placed(20, 0)} Z-4.5")
    ways = [np.array([COS * x, SIN * x, z]) for x, z in ((-20, -0.5), (20, -4.5))]
    heading = (ways[1] - ways[0]) / np.linalg.norm(ways[1] - ways[0])
    expected = [
        ball.mean(ways[0] + t * (ways[1] - ways[0]), heading, 0.2, lambda p: p[:, 2] < 0, steps=STEPS // 10)[0]
        for t in places
    ]
    yield "ball on a slope", slope, tool(10, 2, "ball"), 6, places, np.array(expected)


def convergence(folder):
    """Print the RMS of the error over places along the path, and the order; no place is thinned out."""
    profiles._TOLERANCE_SHARE, profiles._LEAST_TOLERANCE = 1e-9, (1e-9, 1e-9)
    box = ((-60, 60), (-60, 60), (-20, 0))
    for name, text, cutter, line, places, expected in cases():
        errors = []
        for cell in CELLS:
            program, found = forces(folder, text, process(cutter, box, cell))
            force = on_line(program, found, line, places)[:3].T
            off = np.linalg.norm(force - expected, axis=-1)
            errors.append(float(np.sqrt(np.mean(off**2))) / float(np.linalg.norm(np.atleast_2d(expected)[0])))
        order = np.polyfit(np.log(CELLS), np.log(errors), 1)[0]
        told = ", ".join(f"{cell:g} mm {100 * error:.3f} %" for cell, error in zip(CELLS, errors, strict=True))
        print(f"{name}: {told}; order {order:.1f}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as where:
        speed(Path(where))
        convergence(Path(where))
