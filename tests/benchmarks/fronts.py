"""Forces on random surfaces and paths against exact fronts.

Run: python -m tests.benchmarks.fronts [--seeds N] [--only WORD …]

Prints for each cutter and path, over the drawn programs: RMS of the error of the force at random places as a share of
the RMS of the force; how many places have an error above 15 % of the force there, and the largest. Then the deviation
by the cells of the map that the forces state, over the error, both RMS, and which share of the components X, Y and Z is
within 1.96 of these deviations. Places within a radius of an edge of the stock (entries and exits) are not in all but
the first, and balls alone have the last two: deviations of other cutters on slopes are for rubbing too. Surfaces,
directions, lengths of moves and places are drawn anew for each seed.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from postproc import forces as force_sources
from postproc import machining, toolpath
from postproc.under_load import RobotInCell
from tests.machining.setting import AL7075, CELL, ROBOT, gcode, process, read, tool
from tests.oracle import fronts

RPM, PER_TOOTH = 6000.0, 0.08
STOCK = ((0.0, 24.0), (0.0, 12.0), (-30.0, 0.0))
ALLOWED = 0.15


class Case(NamedTuple):
    """A cutter [mm] and a kind of path."""

    shape: str
    radius: float
    corner: float
    teeth: int
    path: str
    depth: float


class Job(NamedTuple):
    """Passes as polylines (n, 3) [mm]; places are drawn in those from `first` on."""

    passes: list
    first: int


def surface(rng, radius, slope=0.3):
    """A random smooth surface z(x, y) below 0, of slopes below `slope` and radii of curvature above 1.5 `radius`."""
    angle, phase = rng.uniform(0, 2 * math.pi, 3), rng.uniform(0, 2 * math.pi, 3)
    wave = 2 * math.pi / rng.uniform(4.0 * radius, 12.0 * radius, 3)
    height = rng.uniform(0.2, 1.0, 3)
    height *= min(slope / (height * wave).sum(), 1.0 / (1.5 * radius) / (height * wave**2).sum())

    def z(x, y):
        way = np.multiply.outer(np.cos(angle), x) + np.multiply.outer(np.sin(angle), y)
        return height @ np.sin(wave[:, None] * way + phase[:, None]) - height.sum()

    return z


def divided(points, length):
    """A polyline (n, 2) or (n, 3) in moves of about `length`."""
    out = [np.asarray(points[0], float)]
    for point in np.asarray(points, float)[1:]:
        number = max(1, math.ceil(np.linalg.norm(point - out[-1]) / length - 1e-9))
        begin = out[-1]
        out += [begin + (point - begin) * (k + 1) / number for k in range(number)]
    return np.array(out)


def rows(turn, z, radius, step, length, number):
    """Rows to and fro over the stock at an angle `turn`, from outside of it to outside."""
    ahead, left = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    middle, half = np.array([12.0, 6.0]), 14.0 + radius
    out = []
    for k in range(number):
        ends = [middle + (k - 0.5 * number) * step * left + side * half * ahead for side in (-1, 1)]
        points = divided(ends[:: 1 if k % 2 == 0 else -1], length)
        out.append(np.column_stack([points, z(points[:, 0], points[:, 1])]))
    return out


def finish(rng, case, length):
    """Rows of a finishing pass over a surface that was cut before, with `depth` left."""
    z, step = surface(rng, case.radius), rng.uniform(0.1, 0.25) * case.radius
    turn = rng.uniform(0, 2 * math.pi)
    wide = rows(turn, lambda x, y: z(x, y) + case.depth, case.radius, step, length, 14)
    return Job(wide + rows(turn, z, case.radius, step, length, 8), len(wide) + 3)


def rough(rng, case, length):
    """Rows over a surface, from a flat top."""
    z = surface(rng, case.radius)
    step, turn = rng.uniform(0.3, 1.2) * case.radius, rng.uniform(0, 2 * math.pi)
    return Job(rows(turn, lambda x, y: z(x, y) - case.depth, case.radius, step, length, 4), 0)


def ramp(rng, case, length):
    """A ramp through the stock, upwards or downwards, then one beside it."""
    rise, across = rng.uniform(0.05, 0.26) * rng.choice([-1, 1]), rng.uniform(4, 8, 2)
    ends = np.array([[-case.radius - 1, across[0]], [25 + case.radius, across[1]]])
    passes = []
    for aside in (0.0, 1.1 * case.radius):
        points = divided(ends + np.array([0, aside]), length)
        way = np.linalg.norm(points - points[0], axis=1)
        passes.append(np.column_stack([points, rise * (way - (way[-1] if rise > 0 else 0)) - case.depth]))
    return Job(passes, 0)


def corners(rng, case, length):
    """A level path with random corners."""
    points = [(-case.radius - 1, rng.uniform(0, 12))] + [tuple(rng.uniform((0, 0), (24, 12))) for _ in range(6)]
    points = divided(points, length if length < 1 else 100.0)
    return Job([np.column_stack([points, np.full(len(points), -case.depth)])], 0)


def loops(rng, case, length):
    """Level loops that go on a little in each turn, as adaptive clearing makes them."""
    around, sense = 1.5 * case.radius, rng.choice([-1, 1])
    turn = np.arange(0.0, 6.0 * math.pi, min(length, 1.0) / around)
    x = rng.uniform(0.1, 0.4) * case.radius * turn / (2 * math.pi) - 1.8 * case.radius + around * np.sin(turn)
    y = 6 + sense * around * (1 - np.cos(turn))
    return Job([np.stack([x, y, np.full(len(turn), -case.depth)], axis=-1)], 0)


def helix(rng, case, length):
    """A helix into solid material."""
    around, sense = rng.uniform(0.5, 1.4) * case.radius, rng.choice([-1, 1])
    turn = np.arange(0.0, 6.0 * math.pi, min(length, 1.0) / around)
    z = 0.2 - rng.uniform(0.1, 0.6) * case.depth * turn / (2 * math.pi)
    return Job([np.stack([12 + around * np.cos(turn), 6 + sense * around * np.sin(turn), z], axis=-1)], 0)


def wall(rng, case, length):
    """Level passes along a wall of 60 to 85°, from the top down, `depth` deep; its front was cleared before."""
    angle, top = math.radians(rng.uniform(60.0, 85.0)), rng.uniform(9.0, 10.0)

    def along(height, leave, length=100.0):
        """The pass that touches the wall at a height, with `leave` left on it."""
        away = case.radius + leave
        y = top + height / math.tan(angle) - away * math.sin(angle)
        ends = [(-case.radius - 1, y, height + away * math.cos(angle) - case.radius), (25 + case.radius, y)]
        points = divided([ends[0][:2], ends[1]], length)
        return np.column_stack([points, np.full(len(points), ends[0][2])])

    rough = [along(height, case.depth) for height in -0.4 * np.arange(1, 14)]
    clear = []
    for points in rough[1::2]:
        for aside in np.arange(1.2 * case.radius, points[0, 1] + case.radius, 1.2 * case.radius):
            clear.append(points - (0.0, aside, 0.0))
    step = rng.uniform(0.1, 0.2) * case.radius
    return Job(clear + rough + [along(-step * k, 0.0, length) for k in range(1, 9)], len(clear) + len(rough) + 3)


PATHS = {
    "finish": finish,
    "rough": rough,
    "ramp": ramp,
    "corners": corners,
    "loops": loops,
    "helix": helix,
    "wall": wall,
}


def job(rng, case):
    """Draw a program: two of three have moves of 0.2 to 0.5 mm, the others of 1 to 3 mm."""
    length = rng.uniform(0.2, 0.5) if rng.uniform() < 2 / 3 else rng.uniform(1.0, 3.0)
    return PATHS[case.path](rng, case, length)


CASES = {
    "ball R3 finish 0.1": Case("ball", 3.0, 3.0, 2, "finish", 0.1),
    "ball R3 finish 0.35": Case("ball", 3.0, 3.0, 2, "finish", 0.35),
    "ball R8 finish 0.5": Case("ball", 8.0, 8.0, 2, "finish", 0.5),
    "ball R3 wall 0.3": Case("ball", 3.0, 3.0, 2, "wall", 0.3),
    "ball R5 wall 0.3": Case("ball", 5.0, 5.0, 2, "wall", 0.3),
    "ball R3 rough 1": Case("ball", 3.0, 3.0, 2, "rough", 1.0),
    "ball R8 rough 2.5": Case("ball", 8.0, 8.0, 2, "rough", 2.5),
    "bull R5 c1 finish 0.3": Case("bull", 5.0, 1.0, 3, "finish", 0.3),
    "bull R5 c1 rough 1.5": Case("bull", 5.0, 1.0, 3, "rough", 1.5),
    "flat R5 rough 1.5": Case("flat", 5.0, 0.0, 3, "rough", 1.5),
    "flat R5 ramp 2": Case("flat", 5.0, 0.0, 3, "ramp", 2.0),
    "bull R5 c1 ramp 2": Case("bull", 5.0, 1.0, 3, "ramp", 2.0),
    "ball R5 ramp 2": Case("ball", 5.0, 5.0, 3, "ramp", 2.0),
    "flat R5 corners 3": Case("flat", 5.0, 0.0, 3, "corners", 3.0),
    "ball R5 corners 2": Case("ball", 5.0, 5.0, 3, "corners", 2.0),
    "flat R4 loops 3": Case("flat", 4.0, 0.0, 3, "loops", 3.0),
    "bull R4 c1 loops 3": Case("bull", 4.0, 1.0, 3, "loops", 3.0),
    "flat R4 helix 3": Case("flat", 4.0, 0.0, 3, "helix", 3.0),
    "ball R4 helix 3": Case("ball", 4.0, 4.0, 3, "helix", 3.0),
}  # fmt: skip


def in_stock(point):
    return np.all([(point[:, k] > STOCK[k][0]) & (point[:, k] < STOCK[k][1]) for k in range(3)], axis=0)


def applied(folder, case, passes, cell):
    """Return the program, its path, and its forces as `convert` uses them."""
    blocks = []
    for points in passes:
        x, y, depth = points[0]
        blocks += [f"G0 X{x:.5f} Y{y:.5f}", f"G0 Z{depth:.5f}", f"G1 F{PER_TOOTH * RPM * case.teeth:g}"]
        blocks += [f"G1 X{x:.5f} Y{y:.5f} Z{z:.5f}" for x, y, z in points[1:]]
        blocks.append("G0 Z20")
    program = read(folder, gcode("G0 Z20", *blocks, spindle=f"S{RPM:g} M3"))
    shape = tool(2 * case.radius, case.teeth, case.shape, case.corner)
    material = 'name = "al_7075_t6_carbide"\nsigma_percent = 0.0'
    text = process(shape, STOCK, cell or 0.25, material)
    (folder / "process.toml").write_text(text if cell else text.replace("resolution_mm = 0.25\n", ""))
    place = RobotInCell.of(ROBOT, CELL)
    path = toolpath.segments(program, place.start_flange)
    source = machining.ProcessSource(machining.load(folder / "process.toml"), place.spindle)
    return program, path, force_sources.assign(program, path, source, place.spindle, place.ramp)


class Comparison(NamedTuple):
    """Forces (n, 3) at random places [N], those expected, which places are clear of entries and exits, and the area of
    the front in material (n,) [mm²]; stated standard deviations (n, 3) of the forces [N]."""

    found: np.ndarray
    expected: np.ndarray
    inner: np.ndarray
    area: np.ndarray
    stated: np.ndarray

    @property
    def error(self):
        """RMS of the error as a share of the RMS of the force."""
        return rms(self.found - self.expected) / rms(self.expected)

    @property
    def shares(self):
        """Errors clear of entries and exits as a share of the force there, or of a tenth of its RMS if that is more."""
        size = np.maximum(np.linalg.norm(self.expected, axis=1), 0.1 * rms(self.expected))
        return (np.linalg.norm(self.found - self.expected, axis=1) / size)[self.inner]

    @property
    def coverage(self):
        """Stated deviation over the error, both RMS, and the share of components within 1.96 stated deviations."""
        error, stated = (self.found - self.expected)[self.inner], self.stated[self.inner]
        return rms(stated) / rms(error), np.mean(np.abs(error) <= 1.96 * stated)


def compared(folder, case, rng, cell=None, count=60):
    """Draw a program of a case and compare its forces at `count` random places."""
    passes, first = job(rng, case)
    passes = [np.round(points, 5) for points in passes]
    begin = np.concatenate([points[:-1] for points in passes])
    end = np.concatenate([points[1:] for points in passes])
    of_pass = np.repeat(np.arange(len(passes)), [len(points) - 1 for points in passes])
    program, path, found = applied(folder, case, passes, cell)
    cutting = np.flatnonzero(~program.motions.rapid)
    assert len(cutting) == len(begin)
    over_stock = np.all([(end[:, k] > -case.radius) & (end[:, k] < STOCK[k][1] + case.radius) for k in (0, 1)], axis=0)
    weight = np.cumsum(np.linalg.norm(end - begin, axis=1) * (of_pass >= first) * over_stock)
    move = np.searchsorted(weight, np.sort(rng.uniform(0.0, weight[-1], count)))
    share = rng.uniform(0.15, 0.95, count)  # at the start of a move the force changes within half the feed per tooth
    sample = toolpath.at(program, path, cutting[move], share)
    wrench, spread = found.at(sample), found.spread_at(sample)
    deepest = -float(np.minimum(begin, end)[:, 2].min())
    fineness = 0.01 if case.corner == case.radius else 0.02  # with 0.02 the front of a ball is itself off by 1 to 2 %
    cutter = fronts.Cutter(case.radius, case.corner, case.teeth, fineness * case.radius, deepest)
    places, per_tooth = list(zip(move.tolist(), share.tolist(), strict=True)), np.full(len(begin), PER_TOOTH)
    expected, area = fronts.forces(cutter, begin, end, places, per_tooth, AL7075, in_stock)
    tip, clear = begin[move] + share[:, None] * (end - begin)[move], np.minimum(case.radius, 4.0)
    inner = np.all([(tip[:, k] > clear) & (tip[:, k] < STOCK[k][1] - clear) for k in (0, 1)], axis=0)
    stated = np.sqrt(np.square(spread[:, 0]).sum(axis=2))
    return Comparison(wrench[:, :3], expected[:, :3], inner, area, stated)


def rms(vector):
    """Root mean square of the lengths of vectors (n, 3)."""
    return math.sqrt(np.mean(np.einsum("ni,ni->n", vector, vector)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="programs of each case")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", nargs="*", default=[], help="cases whose name has one of these words")
    parser.add_argument("--cell", type=float, help="resolution_mm of the stock")
    options = parser.parse_args()
    limit = f"{100 * ALLOWED:.0f} %"
    for name, case in CASES.items():
        if options.only and not any(word in name for word in options.only):
            continue
        programs = []
        for seed in range(options.first, options.first + options.seeds):
            with tempfile.TemporaryDirectory() as folder:
                programs.append(compared(Path(folder), case, np.random.default_rng(seed), options.cell))
        joined = Comparison(*(np.concatenate(column) for column in zip(*programs, strict=True)))
        shares, (ratio, within) = joined.shares, joined.coverage
        by_cells = f"stated over error {ratio:.1f}, {100 * within:.0f} % of components within 1.96 deviations"
        print(
            f"{name}: RMS {100 * joined.error:.1f} % of {rms(joined.expected):.0f} N, by program "
            f"{' '.join(f'{100 * each.error:.1f}' for each in programs)}; over {limit}: "
            f"{np.count_nonzero(shares > ALLOWED)} of {len(shares)} places, "
            f"largest {100 * shares.max(initial=0.0):.0f} %; {by_cells if case.corner == case.radius else ''}",
            flush=True,
        )


if __name__ == "__main__":
    main()
