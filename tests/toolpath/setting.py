"""A program in which every term of the path matters, and the same path by other means (scipy, loops)."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace
from scipy.spatial.transform import Rotation, Slerp

from postproc import frames
from postproc.poses import Poses
from postproc.program import Carriage, Swivel
from tests.programs import program

START = frames.pose_from_xyzabc([900.0, 150.0, 800.0, 30.0, 50.0, -20.0])
BASES = frames.pose_from_xyzabc([[1500.0, -200, 700, 20, -35, 50], [1300.0, 300, 650, -70, 15, -100]])
TOOLS = frames.pose_from_xyzabc([[40.0, -25, 350, 10, 25, -15], [-30.0, 60, 280, -40, 5, 70]])
ABC = ((0, 0, 180), (25, 10, 170), (-40, 30, 140), (-10, -25, 200), (15, 20, 165), (60, 5, 190), (0, 40, 180))


def unit(*vector):
    return tuple(np.array(vector) / np.linalg.norm(vector))


def arc(begin, axis, centre, degrees, climb=0.0, growth=0.0):
    """A CIRC of `tests.programs` from a point [mm] about an axis through a centre; the end follows from the rest."""
    begin, centre, axis = np.array(begin), np.array(centre), np.array(axis)
    foot = centre + ((begin - centre) @ axis) * axis
    out = (1 + growth) * Rotation.from_rotvec(axis * np.radians(degrees)).apply(begin - foot)
    return ("CIRC", *(foot + out + climb * axis), *centre, float(degrees), tuple(axis))


def mixed():
    """Lines, helices about tilted axes whose radius grows, two bases and tools; the tool turns on every motion."""
    first = arc((40, 10, 5), unit(1, 2, 3), (10, -20, 45), 250.0, climb=12.0, growth=0.03)
    second = arc(first[1:4], unit(-2, 1, 1), (5, 30, -10), 100.0, climb=-7.0, growth=-0.05)
    moves = [
        ("PTP", 40, 10, 5), first, second, ("LIN", 100, -50, 20), ("LIN", 40, 60, -30), ("RAPID", 0, 0, 50),
        arc((0, 0, 50), unit(0, 3, 1), (0, 5, 20), 70.0, climb=3.0),
    ]  # fmt: skip
    made = program(moves, bases=BASES, tools=TOOLS)
    target = made.motions.target[:]
    target[:, :3, :3] = frames.pose_from_xyzabc([(0, 0, 0, *abc) for abc in ABC])[:, :3, :3]
    # other frames from the fourth motion on
    later = np.array([0, 0, 0, 0, 1, 1, 1])
    return replace(
        made, motions=replace(made.motions, target=Poses.of(target), base=later, tool=np.array([0, 0, 0, 1, 1, 0, 0]))
    )


def single(made):
    """The same with one base and one tool."""
    m = made.motions
    motions = replace(m, base=np.zeros_like(m.base), tool=np.zeros_like(m.tool))
    return replace(made, motions=motions, bases=BASES[:1], tools=TOOLS[:1])


def with_carriage(made, seed=2):
    """The same program while the robot is carried."""
    rng = np.random.default_rng(seed)
    end = rng.uniform(-0.8, 0.8, len(made.motions))
    return replace(made, carriage=Carriage(np.append(0.3, end[:-1]), end, np.array(unit(3, -4, 2))))


def begins(made, start=START):
    """Tool frames (M, 4, 4) where motions start, one after the other, in their `$BASE`."""
    m, flange, out = made.motions, start.copy(), []
    if made.carriage is not None:
        flange[:3, 3] += made.carriage.begin[0] * made.carriage.direction
    for k in range(len(m)):
        base, tool = made.bases[m.base[k]], made.tools[m.tool[k]]
        out.append(np.linalg.inv(base) @ flange @ tool)
        flange = base @ m.target[k] @ np.linalg.inv(tool)
    return np.array(out)


def turned(begin, end, t):
    """One rotation from a pose to another, to a share of it."""
    both = Slerp([0, 1], Rotation.from_matrix([begin[:3, :3], end[:3, :3]]))
    return both(t).as_matrix()


def point(made, begin, k, t):
    """Place (3,) of the tip on motion k."""
    m, a, b = made.motions, begin[k, :3, 3], made.motions.target[k, :3, 3]
    if m.kind[k] != 1:
        return a + t * (b - a)
    axis, centre = m.normal[k], m.centre[k]
    foot = centre + ((a - centre) @ axis) * axis
    climb = (b - a) @ axis
    grown = np.linalg.norm(b - foot - climb * axis) / np.linalg.norm(a - foot)
    out = Rotation.from_rotvec(axis * m.sweep[k] * t).apply(a - foot)
    return foot + out * (1 + t * (grown - 1)) + t * climb * axis


def swivel(made, axes, angles, inactive=()):
    """Rotary axes (k,) about X, Y or Z that stand at angles (M + 1, k) [deg] between motions."""
    angles, count = np.radians(angles), len(made.motions)
    active = np.ones(count, dtype=bool)
    active[list(inactive)] = False
    turned_frames = frames.pose_from_xyzabc([(0, 0, 0, 30, 10, 0), (0, 0, 0, -20, 5, 40)])[:, :3, :3]
    return Swivel(
        begin=angles[:-1], end=angles[1:], axes=np.array([np.eye(3)["ABC".index(name)] for name in axes]),
        frame=made.motions.base, frames=turned_frames,
        tool=frames.pose_from_xyzabc([0, 0, 0, 15, 0, 180])[:3, :3], active=active, rate=np.full(count, np.nan),
    )  # fmt: skip


def swivelled(made, axes, angles):
    """Orientation (3, 3) of the tool for angles [deg] of rotary axes about X, Y or Z, in the program frame."""
    whole = Rotation.identity()
    for name, angle in zip(axes, angles, strict=True):
        whole = whole * Rotation.from_euler("xyz"["ABC".index(name)], angle, degrees=True)
    up = whole.apply([0.0, 0.0, 1.0])
    across = np.cross([0.0, 0.0, 1.0], up)
    size = np.linalg.norm(across)
    tilt = Rotation.from_rotvec(across / size * np.arctan2(size, up[2]) if size else np.zeros(3))
    return (tilt * Rotation.from_euler("ZYX", [15, 0, 180], degrees=True)).as_matrix()
