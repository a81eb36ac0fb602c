"""A robot that mills a test part, and a probe: they share no code with the package.

The G-code is read anew. The arm is `tests.oracle.whole_arm` (chain and weights by Pinocchio). The tool is a cylinder
whose front is turned through the material left by all of the path before, as it was with the deflected tool; at each
place force and deflection are iterated until they agree. Surfaces are what the cylinder and the rim of its end face
leave. Units inside: mm and N for the cut, SI for the arm.
"""

from __future__ import annotations

import csv
import math
import re

import numpy as np

from tests.oracle.arm import Arm, abc
from tests.oracle.whole_arm import twist

ANGLES = 90
PHI = (np.arange(ANGLES) + 0.5) * math.pi / ANGLES
SIN, COS = np.sin(PHI), np.cos(PHI)
STEP = 1.0
"""Distance of the places along the path that are solved [mm]."""


class Machine:
    """An arm in its cell, a flat end mill, and a material.

    `arm`: a WholeArm; `nominal`: `tests.oracle.arm.Arm` for the controller; `base`, `tool`: KUKA frames (mm, deg);
    `redundancy`: turn about Z [deg]; `k`: Ktc, Kte, Krc, Kre, Kac, Kae [N/mm², N/mm]; `radius` [mm], of the real tool;
    `top`: height of the uncut block above Z0 of the program [mm] at X0 Y0, and its slopes along X and Y.
    """

    def __init__(self, arm, nominal: Arm, start, base, tool, redundancy, k, radius, teeth, top=(0.0, 0.0, 0.0)):
        self.top = np.array(top, dtype=float)
        self.arm, self.nominal, self.start = arm, nominal, np.radians(start)
        self.base, self.tool = abc(*base), abc(*tool)
        self.turn = abc(0, 0, 0, redundancy)[:3, :3] @ abc(0, 0, 0, 0, 0, 180)[:3, :3]
        self.k, self.radius, self.teeth = k, radius, teeth
        self.tcp, self.loaded, self.bare = arm.loads(self.tool)
        self.at_rest, self.theta = None, None

    def joints(self, point, near):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.turn, np.array(point) / 1e3
        return self.nominal.inverse(self.base @ pose, self.tool, near)

    def deflected(self, q, force):
        """Displacement of the tool (mm, rad) under a force on its tip, both in axes of the part: θ = law(torque(θ))."""
        arm, rotation = self.arm, self.base[:3, :3]
        wrench = np.concatenate([rotation @ force, np.zeros(3)])
        if self.at_rest is None or self.at_rest[0] is not q:
            x0 = arm.held_by_motors(q)
            self.at_rest = q, x0, self.bare(x0), self.tcp(x0)[0]
        _, x0, rest, unloaded_pose = self.at_rest
        felt = -rest if arm.in_gears else 0.0 * rest
        theta = np.zeros(len(x0)) if self.theta is None else self.theta  # that of the place before is near
        for _ in range(20):
            before = theta
            torque = self.tcp(x0 + theta)[1].T @ wrench - self.loaded(x0 + theta) + rest
            theta = arm.law(x0 + theta, torque, felt, torque)
            if np.abs(theta - before).max() < 1e-9:
                break
        self.theta = theta
        moved = twist(unloaded_pose, self.tcp(x0 + theta)[0])
        return rotation.T @ moved[:3] * 1e3, rotation.T @ moved[3:]

    def cut(self, text, rng=None, path_error=0.0):
        """Mill a program of features, each behind a line `(F01: …)`; return the tool's path in each, by its name.

        `path_error`: standard deviation of the path of each feature as a whole [mm]: it is cut there.
        """
        features, now, feed, rpm, name = {}, np.zeros(3), 0.0, 0.0, None
        for line in text.splitlines():
            if head := re.match(r"\((F\d+):", line):
                name = head[1]
                features[name] = []
                continue
            words = {word[0]: float(word[1:]) for word in re.findall(r"[A-Z][-\d.]+", line.partition("(")[0])}
            rpm, feed = words.get("S", rpm), words.get("F", feed)
            end = np.array([words.get(axis, now[i]) for i, axis in enumerate("XYZ")])
            if line.startswith("G1") and name is not None:
                features[name].append((now, end, feed / (rpm * self.teeth)))
            now = end
        q, out = self.start, {}
        for name, moves in features.items():
            ends = np.array([point for move in moves for point in move[:2]])
            low, high = ends[np.argmin(ends @ (1, 0.1, 0))], ends[np.argmax(ends @ (1, 0.1, 0))]
            q = self.joints(low, q)
            off = np.zeros(3) if rng is None else rng.normal(size=3) * path_error
            moves = [(begin + off, end + off, chip) for begin, end, chip in moves]
            out[name] = self._feature(moves, (low, q), (high, self.joints(high, q)))
        return out

    def _feature(self, moves, one, other):
        span = (other[0] - one[0])[:2]

        def joints(point):
            share = float((point - one[0])[:2] @ span / (span @ span))
            return one[1] + share * (other[1] - one[1])

        centres, tilts, joined = [], [], []
        path = Left(self.top)
        moved, turned, last = np.zeros(3), np.zeros(3), None
        for begin, end, chip in moves:
            length = np.linalg.norm(end - begin)
            along = (end - begin) / length
            level = np.linalg.norm(along[:2])
            joined.append(bool(centres) and np.linalg.norm(last - begin) < 1e-9)  # the path goes on
            count = max(2, math.ceil(length / STEP))
            joined += [True] * count
            for share in np.arange(count + 1) / count:
                place = begin + share * (end - begin)
                q = joints(place)
                near = path.ahead(place + moved, along[:2] / level, self.radius) if level > 0.0 else None
                for _ in range(12):
                    force = np.zeros(3)
                    if near is not None:
                        force = self.force(near, place + moved, along[:2] / level, chip * level)
                    again, turned = self.deflected(q, force)
                    settled = np.abs(again - moved).max() < 2e-5
                    moved = again
                    if settled:
                        break
                if joined[len(centres)]:
                    path.add(centres[-1], place + moved)
                centres.append(place + moved)
                tilts.append(turned)
            last = end
        return np.array(centres), np.array(tilts), np.array(joined)

    def force(self, near, centre, unit, chip):
        """Mean force on the tool in a turn, axes of the part. `near`: material left near a place, see `Left.ahead`."""
        ktc, kte, krc, kre, kac, kae = self.k
        left = np.array([-unit[1], unit[0]])
        outward = SIN[:, None] * unit + COS[:, None] * left
        level = near(centre[:2] + self.radius * outward)
        edge = np.maximum(level - centre[2], 0.0) * self.teeth / (2.0 * ANGLES)
        h = chip * SIN
        moves = COS[:, None] * unit - SIN[:, None] * left
        plane = -((ktc * h + kte) * edge)[:, None] * moves - ((krc * h + kre) * edge)[:, None] * outward
        return np.array([*plane.sum(axis=0), ((kac * h + kae) * edge).sum()])

    def surface(self, path, point, normal):
        """Deviation of a surface [mm] from a nominal point along its normal: the furthest that the tool reached."""
        centres, tilts, joined = path
        rows = np.flatnonzero(joined)[1:] if joined[0] else np.flatnonzero(joined)
        share = np.arange(25)[:, None, None] / 24.0
        c = (centres[rows - 1] + share * (centres[rows] - centres[rows - 1])).reshape(-1, 3)
        r = (tilts[rows - 1] + share * (tilts[rows] - tilts[rows - 1])).reshape(-1, 3)
        if abs(normal[2]) > 0.5:
            lever = point - c
            near = np.linalg.norm(lever[:, :2], axis=1) <= self.radius
            return float((c[near, 2] + np.cross(r[near], lever[near])[:, 2] - point[2]).min())
        c = c + np.cross(r, np.array([0.0, 0.0, 1.0]) * (point[2] - c[:, 2])[:, None])
        away = c - point
        across = away @ np.array([-normal[1], normal[0], 0.0])
        near = (np.abs(across) < self.radius) & (c[:, 2] < point[2] + 1e-9)
        return float((away[near] @ normal - np.sqrt(self.radius**2 - across[near] ** 2)).min())

    def probed(self, text, probing, rng=None, sigma=0.005, path_error=0.05):
        """Cut the part; return `probing.csv` filled in, with noise, the part put elsewhere, and errors of the path."""
        paths = self.cut(text, rng, path_error)
        table = list(csv.DictReader(probing.splitlines()))
        pose = np.zeros(6) if rng is None else rng.normal(size=6) * [0.1, 0.1, 0.1, 2e-4, 2e-4, 2e-4]
        for row in table:
            point, normal = (np.array([float(row[a]) for a in axes]) for axes in (("X", "Y", "Z"), ("nx", "ny", "nz")))
            name = row["feature"].partition(".")[0]
            if mass := float(row.get("mass_kg") or 0.0):  # a gauge at the tip, that a weight on the tool moves
                moved, _ = self.deflected(self.joints(point, self.start), np.array([0.0, 0.0, -9.81 * mass]))
                noise = 0.0 if rng is None else sigma * rng.normal()
                row["deviation_mm"] = f"{normal @ moved + noise:.5f}"
                continue
            if name.startswith("T"):  # the uncut top
                off = self.top @ (1.0, point[0], point[1]) - point[2]
            else:
                off = self.surface(paths[name], point, normal)
            off += normal @ (pose[:3] + np.cross(pose[3:], point))
            row["deviation_mm"] = f"{off + (0.0 if rng is None else sigma * rng.normal()):.5f}"
        rows = [",".join(row.values()) for row in table]
        return "\n".join([",".join(table[0]), *rows, ""])


class Left:
    """Material left by a path: where the tool has not been, the top of the block."""

    def __init__(self, top):
        self.top = top
        self.rows, self.count = np.zeros((64, 6)), 0

    def add(self, begin, end):
        """Let the tool move from one place to another."""
        if self.count == len(self.rows):
            self.rows = np.concatenate([self.rows, np.zeros_like(self.rows)])
        self.rows[self.count] = *begin, *end
        self.count += 1

    def ahead(self, centre, unit, radius, slack=1e-6):
        """Heights at points (n, 2) of what can touch the front half of a tool that is within 0.5 mm of a place."""
        rows = self.rows[: self.count]
        away = rows[:, :2] - centre[:2]
        near = np.einsum("ki,ki->k", away, away) < (2.0 * radius + 2.0 * STEP) ** 2
        near &= away @ unit > -0.5 * radius - STEP
        x, y, z, x_end, y_end, z_end = rows[near].T.copy()
        along_x, along_y, along_z = x_end - x, y_end - y, z_end - z
        square = np.maximum(along_x**2 + along_y**2, 1e-24)

        def height(points):
            out = self.top[0] + points @ self.top[1:]
            if not len(x):
                return out
            off_x, off_y = points[:, :1] - x, points[:, 1:] - y
            share = np.clip((off_x * along_x + off_y * along_y) / square, 0.0, 1.0)
            off_x -= share * along_x
            off_y -= share * along_y
            inside = off_x * off_x + off_y * off_y < (radius - slack) ** 2
            return np.minimum(out, np.where(inside, z + share * along_z, np.inf).min(axis=1))

        return height
