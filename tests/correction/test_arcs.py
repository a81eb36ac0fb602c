"""Arcs under forces that turn and grow along them, in the cell simulator that shares no code with the package.

The nominal path and the force along it are worked out here from the G-code's own numbers: arcs by centre and angle,
FEED axes by the travel, ramps of 1 mm.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.cells import sample
from tests.correction.simulated import rows_of, simulator, written
from tests.corrections import correct_files, process_files

RAMP_TO_Z0 = "%\nG21 G90 G17 G94\nG0 X0 Y0 Z20\nG1 Z0 F1500\n"
SHARES = (0.25, 0.55, 0.8, 1.0)
RAMP = 1.0


def made(rng, count, size, strength, frame):
    """Random arcs: text, and for each source line of an arc centre, start angle, turn, start, rise and own force."""
    x = y = z = 0.0
    text, arcs, force = RAMP_TO_Z0, {}, np.zeros(3)
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
    result = correct_files({"arcs.nc": text})
    assert not result.failed, result.issues
    sim, moves, rows = simulator("cell_kr270.toml"), written(result), rows_of(result)
    axis_moves = len(moves) - len(rows)
    worst, looked = 0.0, 0
    for index, share, _, q in sim.run(moves, SHARES):
        row = rows[index - axis_moves]
        line = int(row["source_line"])
        if line not in arcs or (index + SHARES.index(share)) % 2:  # every other place: two of each piece
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
    assert looked > 4 * count
    assert 0.0 < worst <= 0.010
    assert result.before.max() > 10 * 0.010e-3


class Through:
    """An arc in space with its force: turned about the centre from `u` towards `v`, both square to `axis`; mm."""

    def __init__(self, centre, u, v, turn, rise, force, up):
        self.centre, self.u, self.v, self.turn, self.rise = (
            np.asarray(x, dtype=float) for x in (centre, u, v, turn, rise)
        )
        self.force, self.up = np.asarray(force, dtype=float), np.asarray(up, dtype=float)

    @property
    def length(self):
        return np.hypot(np.linalg.norm(self.u) * self.turn, np.linalg.norm(self.rise))

    def nominal(self, t):
        angle = self.turn * t
        return self.centre + np.cos(angle) * self.u + np.sin(angle) * self.v + t * self.rise

    def own(self, t):
        """The full force in $BASE: FEED has z up to the spindle, x along the travel as far as it is square to z."""
        angle = self.turn * t
        travel = self.turn * (np.cos(angle) * self.v - np.sin(angle) * self.u) + self.rise
        x = travel - (travel @ self.up) * self.up
        if np.linalg.norm(x) < 1e-3 * np.linalg.norm(travel):  # along the spindle: it comes from, or goes to, beside
            return self.own(t + 0.01 if t < 0.5 else t - 0.01)
        x /= np.linalg.norm(x)
        return np.column_stack([x, np.cross(self.up, x), self.up]) @ self.force


def worst_miss(result, cell_file, arcs):
    """Return how far the simulated tip is from nominal [mm] anywhere on arcs; no force acts before each of them."""
    sim, moves, rows = simulator(cell_file), written(result), rows_of(result)
    axis_moves, worst, looked = len(moves) - len(rows), 0.0, set()
    for index, share, _, q in sim.run(moves, (0.3, 0.65, 1.0)):
        row = rows[index - axis_moves]
        line = int(row["source_line"])
        if line not in arcs or (share == 0.65) == index % 2:  # inside and at the end of a piece in turn
            continue
        before = rows[index - axis_moves - 1]
        start = before["t"] if before["source_line"] == line else 0.0
        t = start + share * (row["t"] - start)
        arc = arcs[line]
        ramp = 1.0 if t == 1.0 else min(1.0, t * arc.length / min(RAMP, arc.length))
        tip = sim.tip(moves[index], q, np.append(ramp * arc.own(t), np.zeros(3)))
        worst = max(worst, 1000.0 * np.linalg.norm(tip - arc.nominal(t) / 1000.0))
        looked.add(line)
    assert looked == set(arcs)
    return worst


KRL = {
    "cell_kr16.toml": (
        "{X 850,Y -150,Z 400,A 0,B 0,C 0}",
        "{X 0,Y 0,Z 180,A 0,B -90,C 0}",
        "A1 7,A2 -27,A3 84,A4 8,A5 122,A6 5",
    ),
    "cell_kr270.toml": (
        "{X 1500,Y -200,Z 700,A 0,B 0,C 0}",
        "{X 0,Y 0,Z 350,A 0,B 0,C 0}",
        "A1 8,A2 -76,A3 112,A4 0,A5 55,A6 -172",
    ),
}
"""$BASE, $TOOL, and axes near the arcs: the simulator looks for its joint angles from the last ones."""


def circ(cell_file, angles, via, end, force):
    base, tool, axes = KRL[cell_file]
    words = lambda names, values: ",".join(f"{n} {v}" for n, v in zip(names, values, strict=True))  # noqa: E731
    turned = words("ABC", angles)
    text = f"DEF part()\n$BASE={base}\n$TOOL={tool}\n$VEL.CP=0.02\nPTP {{{axes}}}\n"
    load = " ".join(f"F{n}={v}" for n, v in zip("XYZ", force, strict=True))
    text += f"LIN {{X 0,Y 0,Z 0,{turned}}} ;FORCE OFF\n;FORCE {load}"
    return f"{text} FRAME=FEED\nCIRC {{{words('XYZ', via)}}},{{{words('XYZ', end)},{turned}}}\nEND\n"


@pytest.mark.parametrize(
    ("cell_file", "angles", "up", "via", "end", "force"),
    [
        # the spindle lies in the plane of the arc but for half a degree
        ("cell_kr16.toml", (180, 0, 180), (1, 0, 0), (17.4311, 9.1073, 0), (36.3217, 0, 0.3646), (113, 369, -145)),
        ("cell_kr16.toml", (180, 0, 180), (1, 0, 0), (8, 0.1, 5), (14, 0.9, -3), (-300, 150, 90)),
        ("cell_kr270.toml", (0, 0, 180), (0, 0, 1), (-9, 1.5, 18), (3, 0, 40), (250, -350, 120)),
        ("cell_kr270.toml", (0, 0, 180), (0, 0, 1), (5, 1, 20), (2, 0.1, 41), (400, 0, 0)),
    ],
)  # fmt: skip
def test_arcs_on_which_feed_axes_swing_round_are_held_within_the_tolerance(cell_file, angles, up, via, end, force):
    a, b, c = np.zeros(3), np.array(via, dtype=float), np.array(end, dtype=float)
    square = np.cross(b, c)
    # the centre is in the plane and as far from all three points
    centre = np.linalg.solve(np.array([b, c, square]), [b @ b / 2, c @ c / 2, 0.0])
    axis = square / np.linalg.norm(square)
    u, v = a - centre, np.cross(axis, a - centre)
    turn = np.arctan2((c - centre) @ v, (c - centre) @ u) % (2 * np.pi)
    arc = Through(centre, u, v, turn, np.zeros(3), force, up)
    across = [np.linalg.norm(np.cross(np.cos(x) * v - np.sin(x) * u, up)) for x in np.linspace(0.0, turn, 400)]
    assert 1.5e-3 < min(across) / np.linalg.norm(u) < 0.1
    text = circ(cell_file, angles, via, end, force)
    result = process_files({"part.src": text}, *sample(cell_file))
    assert not result.failed, result.issues
    line = next(n for n, text in enumerate(text.split("\n"), 1) if text.startswith("CIRC"))
    assert 0.0 < worst_miss(result, cell_file, {line: arc}) <= 0.010
    assert len(result) < 120


def planar(plane, radius, begin, turn, rise):
    """A program with one G18 or G19 arc from the origin, and its geometry."""
    one, other, third = {18: (2, 0, 1), 19: (1, 2, 0)}[plane]
    u, across, climb = np.zeros(3), np.zeros(3), np.zeros(3)
    u[one], u[other] = radius * np.cos(begin), radius * np.sin(begin)
    across[one], across[other] = -u[other], u[one]
    climb[third] = rise
    end = -u + np.cos(turn) * u + np.sin(turn) * across + climb
    i, j = (f"{'IJK'[n]}{-u[n]:.6f}" for n in (one, other))
    word = "G3" if turn > 0 else "G2"
    text = f"{RAMP_TO_Z0}G1 X0 Y0\n(FORCE FX=-180 FY=220 FZ=90 FRAME=FEED)\nG{plane} {word} "
    text += " ".join(f"{name}{value:.6f}" for name, value in zip("XYZ", end, strict=True)) + f" {i} {j}\nM30\n%\n"
    arc = Through(-u, u, across * np.sign(turn), abs(turn), climb, (-180, 220, 90), (0, 0, 1))
    return text, {text[: text.index(f"G{plane} ")].count("\n") + 1: arc}


QUARTER = np.pi / 2


@pytest.mark.parametrize("plane", [18, 19])
@pytest.mark.parametrize(
    ("radius", "begin", "turn", "rise"),
    [(8.0, None, QUARTER, 0.0), (8.0, None, -QUARTER, 0.0), (20.0, None, 2 * QUARTER, 0.0), (5.0, 0.4, 5.0, 0.6)],
)
def test_upright_arcs_of_cam_programs_are_held_within_the_tolerance(plane, radius, begin, turn, rise):
    """Lead-in from a plunge, half circle from plunge to retract, and a helix that passes beside the spindle."""
    if begin is None:
        begin = QUARTER if plane == 18 else 0.0  # the arc begins along the spindle
    text, arcs = planar(plane, radius, begin, turn, rise)
    result = process_files({"part.nc": text})
    assert not result.failed, result.issues
    assert 0.0 < worst_miss(result, "cell_kr270.toml", arcs) <= 0.010


@pytest.mark.parametrize("plane", [18, 19])
def test_a_force_that_jumps_within_an_arc_is_told(plane):
    text, arcs = planar(plane, 20.0, (QUARTER if plane == 18 else 0.0) - 0.5, QUARTER, 0.0)
    result = process_files({"part.nc": text})
    (error,) = (issue for issue in result.issues if issue.level == "error")
    assert (error.kind, error.source_line) == ("force-jump", *arcs)
    assert "Divide the move" in error.message
    as_base = process_files({"part.nc": text.replace("FEED", "BASE")})
    assert not as_base.failed
