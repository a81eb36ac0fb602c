"""Arcs under forces that turn and grow along them, in the cell simulator that shares no code with the package.

The nominal path and the force along it are worked out here from the G-code's own numbers: arcs by centre and angle,
FEED axes by the travel, ramps of 1 mm.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.test_end_to_end import convert, rows_of, simulator, written

HEAD = "%\nG21 G90 G17 G94\nG0 X0 Y0 Z20\nG1 Z0 F1500\n"
SHARES = (0.25, 0.55, 0.8, 1.0)
RAMP = 1.0


def made(rng, count, size, strength, frame):
    """Random arcs: text, and for each source line of an arc centre, start angle, turn, start, rise and own force."""
    x = y = z = 0.0
    text, arcs, force = HEAD, {}, np.zeros(3)
    for n in range(count):
        radius, begin = rng.uniform(0.2, 1.0) * size, rng.uniform(0.0, 2.0 * np.pi)
        turn = rng.uniform(0.3, 5.5) * rng.choice([-1.0, 1.0])
        rise = rng.uniform(-2.0, 2.0) if n % 3 == 0 else 0.0
        if n % 2 == 0:
            force = strength * rng.normal(size=3)
            text += f"(FORCE FX={force[0]:.3f} FY={force[1]:.3f} FZ={force[2]:.3f} FRAME={frame})\n"
        i, j = (round(float(v), 5) for v in (-radius * np.cos(begin), -radius * np.sin(begin)))
        centre, begin = (x + i, y + j), np.arctan2(-j, -i)
        radius = np.hypot(i, j)
        ex, ey = (centre[0] + radius * np.cos(begin + turn), centre[1] + radius * np.sin(begin + turn))
        ex, ey, ez = (round(float(v), 5) for v in (ex, ey, z + rise))
        text += f"G{3 if turn > 0 else 2} X{ex} Y{ey} Z{ez} I{i} J{j}\n"
        arcs[text.count("\n")] = (centre, radius, begin, turn, z, ez - z, np.round(force, 3))
        x, y, z = ex, ey, ez
        if np.hypot(x, y) > 3 * size:
            text += f"(FORCE OFF)\nG1 X0 Y0 Z0\n(FORCE FX=0 FRAME={frame})\n"
            x = y = z = 0.0
            force = np.zeros(3)
    return text + "M30\n%\n", arcs


def nominal(arc, t):
    (cx, cy), radius, begin, turn, z, rise, _ = arc
    angle = begin + t * turn
    return np.array([cx + radius * np.cos(angle), cy + radius * np.sin(angle), z + t * rise])


def own_force(arc, t, frame):
    """The arc's full force in $BASE: FEED has x along the travel in the plane, z up to the spindle."""
    _, _, begin, turn, *_, force = arc
    if frame == "BASE":
        return force
    x = np.array([-np.sin(begin + t * turn), np.cos(begin + t * turn), 0.0]) * np.sign(turn)
    z = np.array([0.0, 0.0, 1.0])
    return np.column_stack([x, np.cross(z, x), z]) @ force


@pytest.mark.parametrize(
    ("seed", "count", "size", "strength", "frame"),
    [(1, 5, 4.0, 150.0, "FEED"), (2, 4, 60.0, 150.0, "FEED"), (3, 4, 1.0, 300.0, "FEED"), (4, 4, 100.0, 400.0, "BASE")],
)  # fmt: skip
def test_arcs_are_held_within_the_tolerance_everywhere(seed, count, size, strength, frame):
    text, arcs = made(np.random.default_rng(seed), count, size, strength, frame)
    result = convert({"arcs.nc": text.encode()}, "cell_kr270.toml", "gcode")
    assert not result.failed, result.issues
    sim, moves, rows = simulator("cell_kr270.toml"), written(result), rows_of(result)
    axis_moves = len(moves) - len(rows)
    worst, looked = 0.0, 0
    for index, share, _, q in sim.run(moves, SHARES):
        row = rows[index - axis_moves]
        line = int(row["source_line"])
        if line not in arcs:
            continue
        before = rows[index - axis_moves - 1]
        start = before["t"] if before["source_line"] == line else 0.0
        t = start + share * (row["t"] - start)
        arc, previous = arcs[line], arcs.get(line - 1) or arcs.get(line - 2)
        length = np.hypot(arc[1] * arc[3], arc[5])
        ramp = 1.0 if t == 1.0 else min(1.0, t * length / min(RAMP, length))
        at_start = np.zeros(3) if previous is None else own_force(previous, 1.0, frame)
        force = at_start + ramp * (own_force(arc, t, frame) - at_start)
        tip = sim.tip(moves[index], q, np.append(force, np.zeros(3)))
        worst = max(worst, 1000.0 * np.linalg.norm(tip - nominal(arc, t) / 1000.0))
        looked += 1
    assert looked > 8 * count
    assert 0.0 < worst <= 0.010
    assert result.before.max() > 10 * 0.010e-3
