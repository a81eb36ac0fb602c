"""Random cuts in random stock, against a cutter that is turned tooth by tooth.

python -m tests.attack.forces --minutes 10 [--seed 0]

What the oracle knows of the stock is its box and every way of the tool before the place that is looked at, as a list of
straight pieces; whether a point lies in what the tool swept there is a formula. Entries and exits may come by one cell
earlier or later.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from postproc.errors import ForceError
from tests.attack.driver import Wrong, parser, try_seeds
from tests.machining.setting import AL7075, forces, gcode, on_line, process, tool
from tests.oracle.teeth import Teeth

RELATIVE, ABSOLUTE = 0.04, 3.0
"""The bound: of the force, and N."""
CHORD = math.radians(3.0)
FEED, RPM = 1200.0, 6000.0
STEPS, DISCS = 180, 24
"""Into which the oracle divides a turn, and the corner and the cylinder of the cutter."""
FINER = 4
"""Where a force misses, the oracle divides so many times finer, and the cells of the stock are half as large."""
PLACES = 2


@dataclass
class Cutter:
    radius: float
    corner: float
    teeth: int

    def height(self, away):
        """Height of the lower side above the tip; infinite beside the tool."""
        over = np.clip(away - (self.radius - self.corner), 0.0, None)
        inside = self.corner - np.sqrt(np.maximum(self.corner**2 - over**2, 0.0))
        return np.where(away < self.radius - 1e-6, inside + 1e-6, np.inf)  # what touches is not in it

    def swept(self, point, begin, end):
        """Whether points (n, 3) lie in what the tool sweeps on a straight piece."""
        way = end - begin
        square = way[0] ** 2 + way[1] ** 2
        offset = point[:, :2] - begin[:2]
        near = np.clip(offset @ way[:2] / square, 0, 1) if square > 1e-18 else np.zeros(len(point))

        def lower(t):
            away = np.linalg.norm(offset - t[:, None] * way[:2], axis=1)
            return begin[2] + t * way[2] + self.height(away)

        if abs(way[2]) < 1e-12:
            return point[:, 2] > lower(near)
        if square < 1e-18:
            return point[:, 2] > lower(np.full(len(point), float(way[2] < 0)))
        length = math.sqrt(square)
        across = np.abs(way[0] * offset[:, 1] - way[1] * offset[:, 0]) / length
        half = np.sqrt(np.maximum((self.radius - 2e-6) ** 2 - across**2, 0)) / length
        along = offset @ way[:2] / square
        a, b = np.clip(along - half, 0, 1), np.clip(along + half, 0, 1)
        for _ in range(0 if self.corner == 0.0 else 20):
            one, other = a + 0.381966 * (b - a), b - 0.381966 * (b - a)
            left = lower(one) < lower(other)
            a, b = np.where(left, a, one), np.where(left, other, b)
        return point[:, 2] > np.minimum(lower(0.5 * (a + b)), np.minimum(lower(a), lower(b)))


@dataclass
class Motion:
    """One block: points along it, by t."""

    block: str
    cutting: bool
    begin: np.ndarray
    end: np.ndarray
    centre: np.ndarray | None = None
    sweep: float = 0.0

    def at(self, t):
        if self.centre is None:
            return self.begin + t * (self.end - self.begin)
        arm, turn = self.begin[:2] - self.centre, t * self.sweep
        c, s = math.cos(turn), math.sin(turn)
        x, y = self.centre + np.array([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]])
        return np.array([x, y, self.begin[2] + t * (self.end[2] - self.begin[2])])

    def direction(self, t):
        d = (self.at(t + 1e-6) - self.at(t - 1e-6)) if self.centre is not None else self.end - self.begin
        return d / np.linalg.norm(d)

    def pieces(self, t=1.0):
        chord = CHORD if self.end[2] == self.begin[2] else 2 * CHORD
        count = 1 if self.centre is None else max(1, math.ceil(abs(self.sweep) * t / chord))
        places = [self.at(t * k / count) for k in range(count + 1)]
        return list(pairwise(places))


@dataclass
class Scene:
    """A random stock, cutter and program."""

    rng: np.random.Generator
    motions: list[Motion] = field(default_factory=list)

    def __post_init__(self):
        r = self.rng
        shape = str(r.choice(["flat", "flat", "ball", "bull"]))
        diameter = float(r.choice([6, 8, 10, 12, 16, 20]))
        corner = {"flat": 0.0, "ball": diameter / 2, "bull": round(float(r.uniform(0.1, 0.45)) * diameter, 2)}[shape]
        self.shape, self.cutter = shape, Cutter(diameter / 2, corner, int(r.integers(1, 7)))
        self.hand = int(r.choice([1, 1, -1]))
        self.box = [sorted((round(float(r.uniform(-60, -15)), 2), round(float(r.uniform(15, 60)), 2))) for _ in "XY"]
        self.box.append([-25.0, round(float(r.uniform(-1, 3)), 2)])
        self.depth = round(float(r.uniform(0.4, 0.9 * diameter)), 2)
        self.here = np.array([-80.0, -80.0, 30.0])
        kind = str(r.choice(["hatch", "contour", "bore", "ramp", "helix", "free"]))
        self.kind = kind
        getattr(self, kind)()
        self.rapid(z=30)

    def point(self):
        return np.array([round(float(self.rng.uniform(low - 3, high + 3)), 3) for low, high in self.box[:2]])

    def rapid(self, xy=None, z=None):
        to = self.here.copy()
        to[:2] = to[:2] if xy is None else xy
        to[2] = to[2] if z is None else z
        self._add(Motion(f"G0 X{to[0]:.4f} Y{to[1]:.4f} Z{to[2]:.4f}", False, self.here, to))

    def line(self, xy=None, z=None):
        to = self.here.copy()
        to[:2] = to[:2] if xy is None else np.round(xy, 4)
        to[2] = to[2] if z is None else round(z, 4)
        self._add(Motion(f"G1 X{to[0]:.4f} Y{to[1]:.4f} Z{to[2]:.4f} F{FEED}", True, self.here, to))

    def arc(self, centre, sweep, z=None):
        centre = np.round(centre, 4)
        motion = Motion("", True, self.here, self.here.copy(), centre, sweep)
        to = np.round(motion.at(1.0), 4)
        if abs(abs(sweep) - 2 * math.pi) < 1e-9:
            to = self.here.copy()
        to[2] = to[2] if z is None else round(z, 4)
        motion.end = to
        word, (i, j) = "G3" if sweep > 0 else "G2", centre - self.here[:2]
        motion.block = f"{word} X{to[0]:.4f} Y{to[1]:.4f} Z{to[2]:.4f} I{i:.4f} J{j:.4f} F{FEED}"
        self._add(motion)

    def _add(self, motion):
        if np.linalg.norm(motion.end - motion.begin) < 1e-9 and motion.centre is None:
            return
        self.motions.append(motion)
        self.here = motion.end

    def enter(self, xy, z):
        self.rapid(z=30)
        self.rapid(xy)
        self.line(z=z)

    def hatch(self):
        turn, step = self.rng.uniform(0, 2 * math.pi), self.rng.uniform(0.05, 1.1) * 2 * self.cutter.radius
        u = np.array([math.cos(turn), math.sin(turn)])
        v, middle = np.array([-u[1], u[0]]), np.array([np.mean(side) for side in self.box[:2]])
        top = self.box[2][1]
        first = middle + v * self.rng.uniform(-20, 20)
        for level in range(int(self.rng.integers(1, 3))):
            self.enter(np.round(first - 100 * u, 3), top - self.depth * (0.5 + 0.5 * level))
            for row in range(int(self.rng.integers(2, 6))):
                self.line(self.here[:2] + 200 * u * (1 if row % 2 == 0 else -1))
                self.line(self.here[:2] + step * v)

    def contour(self):
        self.enter(np.array([self.box[0][0] - 15, self.box[1][0] - 15]), self.box[2][1] - self.depth)
        width = self.rng.uniform(0.1, 1.5) * self.cutter.radius
        x0, x1, y0, y1 = (
            self.box[0][0] - self.cutter.radius + width, self.box[0][1] + self.cutter.radius - width,
            self.box[1][0] - self.cutter.radius + width, self.box[1][1] + self.cutter.radius - width,
        )  # fmt: skip
        corners = [(x0, y0), (x0, y1), (x1, y1), (x1, y0), (x0, y0)]
        for xy in corners if self.rng.random() < 0.5 else corners[::-1]:
            self.line(np.array(xy))

    def bore(self):
        centre = np.round(np.array([np.mean(side) for side in self.box[:2]]) + self.rng.uniform(-5, 5, 2), 3)
        self.enter(centre, self.box[2][1] - self.depth)
        sense, out = float(self.rng.choice([-1, 1])), 0.0
        for _ in range(int(self.rng.integers(2, 5))):
            out += 0.03 * 30 ** self.rng.random() * self.cutter.radius  # first rounds of a spiral as well
            self.line(centre + np.array([out, 0]))
            self.arc(centre, sense * 2 * math.pi)

    def ramp(self):
        top = self.box[2][1]
        self.enter(self.point(), top + 0.1)
        for _ in range(int(self.rng.integers(2, 6))):
            self.line(self.point(), top - self.rng.uniform(0, self.depth))

    def helix(self):
        centre = np.round(np.array([np.mean(side) for side in self.box[:2]]), 3)
        radius, top = self.rng.uniform(0.3, 2.5) * self.cutter.radius, self.box[2][1]
        self.enter(centre + np.round([radius, 0], 3), top + 0.1)
        for k in range(1, 4):
            self.arc(centre, 2 * math.pi * float(self.rng.choice([1, 1])), top - self.depth * k / 3)
        self.line(centre + np.round([1.4 * radius, 0], 3))
        self.arc(centre, 2 * math.pi)

    def free(self):
        self.enter(self.point(), self.box[2][1] - self.depth)
        for _ in range(int(self.rng.integers(3, 8))):
            to = self.point()
            if self.rng.random() < 0.5:
                self.line(to)
            else:
                chord = to - self.here[:2]
                bow = self.rng.uniform(-2, 2)
                middle = 0.5 * (to + self.here[:2]) + bow * np.array([-chord[1], chord[0]])
                arm = np.round(middle, 4) - self.here[:2]
                half = math.asin(min(1.0, 0.5 * np.linalg.norm(chord) / np.linalg.norm(arm)))
                self.arc(middle, math.copysign(2 * half, bow))

    @property
    def text(self):
        return gcode(*(motion.block for motion in self.motions), spindle=f"S{RPM:.0f} M{3 if self.hand > 0 else 4}")

    def process(self, cell):
        return process(tool(2 * self.cutter.radius, self.cutter.teeth, self.shape, self.cutter.corner), self.box, cell)

    def expected(self, row, t, finer=1):
        """Force by the oracle on motion `row` at t; `finer`: so many times finer than usual."""
        motion, cutter = self.motions[row], self.cutter
        tip, direction = motion.at(t), motion.direction(t)
        history = [piece for one in self.motions[:row] for piece in one.pieces()] + motion.pieces(t)
        reach = 2 * cutter.radius + 0.1
        history = [
            (a, b)
            for a, b in history
            if min(a[2], b[2]) < self.box[2][1]
            and (np.minimum(a, b)[:2] < tip[:2] + reach).all()
            and (np.maximum(a, b)[:2] > tip[:2] - reach).all()
        ]

        def material(point):
            inside = np.ones(len(point), dtype=bool)
            for axis in range(3):
                inside &= (point[:, axis] > self.box[axis][0]) & (point[:, axis] < self.box[axis][1])
            for begin, end in history:
                rows = np.flatnonzero(inside)
                if len(rows) == 0:
                    break
                inside[rows] = ~cutter.swept(point[rows], begin, end)
            return inside

        one = Teeth(cutter.radius, cutter.corner, 1, AL7075, discs=finer * DISCS)
        high = self.box[2][1] - tip[2]
        if high > cutter.corner:
            one.side(high, discs=finer * DISCS)
        if direction[2] < -1e-9 and cutter.corner < cutter.radius:
            one.face(-direction[2])
        return (
            cutter.teeth
            * one.mean(tip, direction, FEED / RPM / cutter.teeth, material, self.hand, steps=finer * STEPS)[0]
        )


def try_scene(seed, cell=0.25, finer=1):
    """Hold some places of one random program against the oracle; return (scene, worst miss over its bound, told)."""
    rng = np.random.default_rng(seed)
    scene = Scene(rng)
    with tempfile.TemporaryDirectory() as folder:
        try:
            program, found = forces(Path(folder), scene.text, scene.process(cell))
        except ForceError as refusal:
            if "never touches" not in str(refusal):
                raise
            program, found = None, None
    worst, told = 0.0, ""
    rows = [k for k, motion in enumerate(scene.motions) if motion.cutting and abs(motion.direction(0.5)[2]) < 0.9]
    for _ in range(PLACES):
        row, t = int(rng.choice(rows[1:] or rows)), float(rng.uniform(0.02, 0.98))
        motion = scene.motions[row]
        length = (
            abs(motion.sweep) * np.linalg.norm(motion.begin[:2] - motion.centre)
            if motion.centre is not None
            else (np.linalg.norm(motion.end - motion.begin))
        )
        near = [float(np.clip(t + d * cell / length, 0, 1)) for d in (-1, 0, 1)]
        around = np.array([scene.expected(row, place, finer) for place in near])
        force = np.zeros(3) if found is None else on_line(program, found, 4 + row, t)[:3]
        slack = RELATIVE * np.linalg.norm(around[1]) + ABSOLUTE
        miss = float(np.maximum(force - around.max(axis=0), around.min(axis=0) - force).max() / slack)
        if miss > worst:
            worst = miss
            told = f"{motion.block} t {t:.4f}: {np.round(force, 1)}, expected {np.round(around[1], 1)}"
    return scene, worst, told


def attack(seed, cell=0.25):
    """Try the scene of a seed; return its kind.

    :raises Wrong: a force is outside the bound with finer cells and a finer oracle too.
    """
    scene, worst, told = try_scene(seed, cell)
    name = f"{scene.kind} {scene.shape}"
    if worst <= 1.0:
        return name
    _, worst, told = try_scene(seed, cell / 2, FINER)
    if worst > 1.0:
        raise Wrong(f"{name} {worst:.2f} D{2 * scene.cutter.radius:g} {told}")
    return f"{name}, with finer cells"


def main():
    """Try scenes, and count their kinds."""
    arguments = parser(__doc__)
    arguments.add_argument("--cell", type=float, default=0.25, help="edge of the cells of the stock [mm]")
    options = arguments.parse_args()
    return try_seeds(options, partial(attack, cell=options.cell))


if __name__ == "__main__":
    raise SystemExit(main())
