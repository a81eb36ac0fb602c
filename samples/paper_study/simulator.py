"""A robot to be measured that shares no code with the package: links, gears, weights, compensator, tracker, noise.

Plain numpy. The state y holds the six joint deflections and, for every link with springs, three translations and three
rotations. The equilibrium is the stationary point of

    E(y) = sum of spring energies + weights·height + compensator − F·(load point)

found by damped-free Newton steps with the spring stiffness as the tangent (the load changes it by a per cent at most);
`tests/identification/test_simulator.py` checks by differences that the energy is stationary there.

Everything is SI; docs/reference describes the files. The robot is built weightless ("rigid"): sag is what
the weights do to it, so readings without load contain it.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ORIGINS = np.array([[0, 0, 0.75], [0.35, 0, 0], [1.25, 0, 0], [0, 0, -0.055], [1.1, 0, 0], [0.23, 0, 0]])
AXES = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=float)
MASSES = np.array([367.4, 232.1, 191.5, 47.9, 23.7, 12.2])
CENTRES = np.array(
    [[0.03, -0.01, -0.21], [0.47, -0.19, 0], [0.05, -0.04, -0.03], [0.93, 0.03, 0], [0.06, 0.04, 0], [-0.03, 0, 0]]
)
PAPER_K = np.array([0.623, 0.302, 0.416, 2.786, 3.483, 2.074]) * 1e-6
POINTS = {"P1": [0.118, 0.021, 0.262], "P2": [-0.077, 0.104, 0.255], "P3": [-0.049, -0.121, 0.301]}
DEMO_LEVELS = (0.075, 1.0)
"""Loads of each configuration of `main`, as shares of the largest one."""
LOAD_POINT = np.array([0.210, -0.060, 0.180])
G = 9.81


def rot(axis, angle):
    """Rotation matrices (N, 3, 3) about one axis."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * k + (1 - c) * (k @ k)


@dataclass
class Gear:
    """Torque of a gear τ(θ) with tangent; `kind`: linear, cubic, quadratic, three (three slopes, harmonic drive), knee
    (two slopes) or settling; or a tuple of six of them."""

    kind: str | tuple
    k: np.ndarray  # (6,) stiffness at small angle
    bend: np.ndarray  # (6,) angle [rad] that sets the scale of the stiffening

    def torque(self, t):
        if isinstance(self.kind, tuple):  # a kind for each joint
            each = [Gear(kind, self.k[j], self.bend[j]).torque(t[:, j]) for j, kind in enumerate(self.kind)]
            return tuple(np.stack(values, axis=1) for values in zip(*each, strict=True))
        k, b, a = self.k, self.bend, np.abs(t)
        if self.kind == "linear":
            return k * t, k + 0 * t
        if self.kind == "cubic":
            return k * t * (1 + (t / b) ** 2), k * (1 + 3 * (t / b) ** 2)
        if self.kind == "quadratic":
            return k * t * (1 + a / b), k * (1 + 2 * a / b)
        if self.kind == "three":  # slopes k, 1.25 k, 1.5 k, changing at b/2 and b
            slope = np.where(a < b / 2, k, np.where(a < b, 1.25 * k, 1.5 * k))
            value = k * np.minimum(a, b / 2) + 1.25 * k * np.clip(a - b / 2, 0, b / 2) + 1.5 * k * np.maximum(a - b, 0)
            return np.sign(t) * value, slope
        if self.kind == "knee":  # slopes k and 2.5 k, changing at b
            return np.sign(t) * (k * np.minimum(a, b) + 2.5 * k * np.maximum(a - b, 0)), np.where(a < b, k, 2.5 * k)
        if self.kind == "settling":  # secant stiffness grows from k to 1.4 k and stays there
            u = a / b
            return k * t * (1 + 0.4 * u / (1 + u)), k * (1 + 0.4 * u / (1 + u)) + k * a * 0.4 / (1 + u) ** 2 / b
        raise ValueError(self.kind)


@dataclass
class TrueRobot:
    gear: Gear
    links: dict = field(default_factory=dict)  # index 0 (base) … 6 → (6, 6) compliance at the link's beginning
    masses: np.ndarray = field(default_factory=lambda: 0 * MASSES)
    comp: tuple = (0.0, 0.458, 0.18472, 0.68593, 0.12330)  # K_c, s_0, L, a_x, a_y
    origins: np.ndarray = field(default_factory=lambda: ORIGINS.copy())
    tilts: np.ndarray = field(default_factory=lambda: np.zeros((6, 3)))  # rotation vector of each joint frame
    offsets: np.ndarray = field(default_factory=lambda: np.zeros(6))
    gears_feel_rest: bool = True
    centres: np.ndarray = field(default_factory=lambda: CENTRES)
    payload: tuple = (0.0, np.zeros(3))  # what the flange carries always: mass, centre in the flange frame
    backlash: np.ndarray = field(default_factory=lambda: np.zeros(6))  # each gear lies off by ± this with its torque
    lost_motion: np.ndarray = field(default_factory=lambda: np.zeros(6))  # and by ± this with that of the load alone
    waves: np.ndarray = field(default_factory=lambda: np.zeros((6, 4)))  # of sin q, cos q, sin 2q, cos 2q, on top of q
    coupled: np.ndarray = field(
        default_factory=lambda: np.zeros((6, 6))
    )  # deflection of each joint by torques of others
    by_pose: tuple = ()  # of gears: (shares (6,), turns (6, 6), phases (6,)), see `stiffer`

    def __post_init__(self):
        self.chain = []  # (fixed 4×4, "R"/"P", axis, kind, index)
        eye = np.eye(4)
        if 0 in self.links:
            self._spring(0, eye)
        for j in range(6):
            fixed = np.eye(4)
            fixed[:3, 3] = self.origins[j]
            angle = np.linalg.norm(self.tilts[j])
            if angle:
                fixed[:3, :3] = rot(self.tilts[j] / angle, np.array([angle]))[0]
            self.chain.append((fixed, "R", AXES[j], "joint", j))
            if j + 1 in self.links:
                self._spring(j + 1, eye)
        self.size = len(self.chain)
        self.joint_rows = [i for i, e in enumerate(self.chain) if e[3] == "joint"]
        self.link_rows = {
            link: [i for i, e in enumerate(self.chain) if e[3] == "link" and e[4] == link] for link in self.links
        }
        self.body_row = [self.link_rows[j + 1][-1] if j + 1 in self.links else self.joint_rows[j] for j in range(6)]
        self.link_k = {link: np.linalg.inv(c) for link, c in self.links.items()}

    def _spring(self, link, eye):
        for kind in "PR":
            for axis in np.eye(3):
                self.chain.append((eye, kind, axis, "link", link))

    def frames(self, x):
        """Pose after each coordinate (size, N, 4, 4), unit axis and origin of each (size, N, 3)."""
        n = len(x)
        pose = np.repeat(np.eye(4)[None], n, axis=0)
        poses, axes, origins = [], [], []
        for i, (fixed, kind, axis, _, _) in enumerate(self.chain):
            pose = pose @ fixed
            axes.append(pose[:, :3, :3] @ axis)
            origins.append(pose[:, :3, 3])
            move = np.repeat(np.eye(4)[None], n, axis=0)
            if kind == "R":
                move[:, :3, :3] = rot(axis, x[:, i])
            else:
                move[:, :3, 3] = axis * x[:, i, None]
            pose = pose @ move
            poses.append(pose)
        return np.array(poses), np.array(axes), np.array(origins)

    def pulled(self, frames, row, point, force):
        """Generalised forces (N, size) of a force (N, 3) at a point (N, 3) on the body after coordinate `row`."""
        _, axes, origins = frames
        out = np.zeros((len(point), self.size))
        for i in range(row + 1):
            lever = axes[i] if self.chain[i][1] == "P" else np.cross(axes[i], point - origins[i])
            out[:, i] = np.sum(lever * force, axis=1)
        return out

    def comp_energy(self, q2):
        kc, s0, L, ax, ay = self.comp
        s = np.sqrt(ax**2 + ay**2 + L**2 + 2 * np.hypot(ax, ay) * L * np.cos(np.arctan2(ay, ax) - q2))
        return 0.5 * kc * (s - s0) ** 2

    def _comp(self, q2, h=1e-4):
        if self.comp[0] == 0:
            return 0 * q2, 0 * q2
        e = [self.comp_energy(q2 + i * h) for i in (-2, -1, 0, 1, 2)]
        slope = (e[0] - 8 * e[1] + 8 * e[3] - e[4]) / (12 * h)
        return slope, (-e[0] + 16 * e[1] - 30 * e[2] + 16 * e[3] - e[4]) / (12 * h * h)

    def commanded(self, q):
        x = np.zeros((len(q), self.size))
        s1, c1, s2, c2 = self.waves.T
        gears = s1 * np.sin(q) + c1 * np.cos(q) + s2 * np.sin(2 * q) + c2 * np.cos(2 * q)
        x[:, self.joint_rows] = q + self.offsets + gears
        return x

    def stiffer(self, q):
        """Factor (N, 6) on the stiffness of each gear at a pose: one plus its share of a wave over the joint angles."""
        if not self.by_pose:
            return np.ones_like(q)
        share, turns, phase = self.by_pose
        return 1.0 + share * np.sin(q @ turns.T + phase)

    def position_forces(self, frames, x):
        """Generalised forces of weights and compensator (N, size)."""
        out = np.zeros_like(x)
        for j, mass in enumerate(self.masses):
            if mass:
                pose = frames[0][self.body_row[j]]
                com = pose[:, :3, 3] + pose[:, :3, :3] @ self.centres[j]
                out += self.pulled(frames, self.body_row[j], com, np.tile([0, 0, -mass * G], (len(x), 1)))
        if self.payload[0]:
            flange = self.flange(frames)
            com = flange[:, :3, 3] + flange[:, :3, :3] @ self.payload[1]
            out += self.pulled(frames, self.size - 1, com, np.tile([0, 0, -self.payload[0] * G], (len(x), 1)))
        second = self.joint_rows[1]
        out[:, second] -= self._comp(x[:, second])[0]
        return out

    def solve(self, q, force, point=LOAD_POINT, moment=None, iterations=40):
        """Flange pose (N, 4, 4) under a dead force (N, 3) at a point of the flange frame."""
        base, factor = self.commanded(q), self.stiffer(q)
        rest = np.zeros_like(base)
        if not self.gears_feel_rest:  # the gears stiffen with the load alone: at rest they are balanced
            rest = self.position_forces(self.frames(base), base)
        y = np.zeros_like(base)
        for _ in range(iterations):
            x = base + y
            frames = self.frames(x)
            flange = self.flange(frames)
            tip = flange[:, :3, 3] + flange[:, :3, :3] @ point
            load = self.pulled(frames, self.size - 1, tip, force)
            if moment is not None:
                for i in range(self.size):
                    if self.chain[i][1] == "R":
                        load[:, i] += np.sum(frames[1][i] * moment, axis=1)
            g = load + self.position_forces(frames, x) - rest
            # a newton metre or two turn the gear over to its other flank
            slack = self.backlash * np.tanh(g[:, self.joint_rows] / 2.0)
            slack += self.lost_motion * np.tanh(load[:, self.joint_rows] / 2.0)
            slack += g[:, self.joint_rows] @ self.coupled
            torque, tangent = (here * factor for here in self.gear.torque(y[:, self.joint_rows] - slack))
            step = np.zeros_like(y)
            tangent[:, 1] += self._comp(x[:, self.joint_rows[1]])[1]
            step[:, self.joint_rows] = (g[:, self.joint_rows] - torque) / tangent
            for link, rows in self.link_rows.items():
                step[:, rows] = g[:, rows] @ self.links[link] - y[:, rows]
            y = y + step
            if np.abs(step).max() < 1e-11:
                break
        else:
            raise AssertionError(f"not converged: {np.abs(step).max()}")
        self.y = y
        return self.flange(self.frames(base + y))

    @staticmethod
    def flange(frames):
        turn = np.eye(4)
        turn[:3, :3] = rot((0, 1, 0), np.array([np.pi / 2]))[0]
        return frames[0][-1] @ turn

    def energy(self, q, y, force, point=LOAD_POINT):
        """E(y) (N,) for the check that the solution is stationary (linear or cubic gears)."""
        x = self.commanded(q) + y
        frames = self.frames(x)
        t = y[:, self.joint_rows]
        k, b = self.gear.k, self.gear.bend
        e = np.sum(0.5 * k * t**2, axis=1)
        if self.gear.kind == "cubic":
            e += np.sum(0.25 * k * t**4 / b**2, axis=1)
        for link, rows in self.link_rows.items():
            e += 0.5 * np.einsum("ni,ij,nj->n", y[:, rows], self.link_k[link], y[:, rows])
        for j, mass in enumerate(self.masses):
            pose = frames[0][self.body_row[j]]
            e += mass * G * (pose[:, :3, 3] + pose[:, :3, :3] @ self.centres[j])[:, 2]
        e += self.comp_energy(x[:, self.joint_rows[1]])
        flange = self.flange(frames)
        return e - np.sum((flange[:, :3, 3] + flange[:, :3, :3] @ point) * force, axis=1)


def paper_like(rng, stiff_compensator=True):
    """Joint springs near the paper's, and a compensator; the geometry is exact and holds the state at rest."""
    k = PAPER_K * np.exp(rng.uniform(-0.35, 0.35, 6))
    kc = rng.uniform(5e6, 7e6) if stiff_compensator else 1.2e5
    comp = (kc, rng.uniform(0.4, 0.55), 0.18472, 0.68593, 0.1233)
    return TrueRobot(Gear("linear", 1 / k, np.ones(6)), comp=comp, masses=MASSES.copy(), gears_feel_rest=False)


def hard(rng, gear="quadratic", links="begin", weights=True, base=False, geometry=3e-4, feel_rest=True, scale=1.0):
    """A robot as real ones are. `links`: where the six springs of a link sit: begin, end, beam, or none."""
    k = PAPER_K * np.exp(rng.uniform(-0.35, 0.35, 6))
    compliance = {}
    lengths = [*np.linalg.norm(ORIGINS, axis=1), 0.1]
    for link in range(0 if base else 1, 7):
        if links == "none":
            break
        arm = ORIGINS[link] if link < 6 else np.zeros(3)
        if links == "beam":  # Euler–Bernoulli, wrench at the end; moved to the beginning of the link
            L = max(lengths[link], 0.15)
            ei = 6e6 * np.exp(rng.uniform(-0.7, 0.7)) / scale * (1.0 if link < 3 else 0.25)
            end = np.diag([L / (3e9 / scale), L**3 / (3 * ei), L**3 / (3 * ei), L / (0.8 * ei), L / ei, L / ei])
            end[1, 5] = end[5, 1] = L**2 / (2 * ei)
            end[2, 4] = end[4, 2] = -(L**2) / (2 * ei)
            direction = arm / np.linalg.norm(arm) if np.linalg.norm(arm) else np.array([1.0, 0, 0])
            other = np.cross(direction, [0, 1, 0] if abs(direction[1]) < 0.9 else [1, 0, 0])
            other /= np.linalg.norm(other)
            axes = np.column_stack([direction, np.cross(other, direction), other])
            turn = np.kron(np.eye(2), axes)
            at_end = turn @ end @ turn.T
        else:
            t = np.exp(rng.uniform(np.log(4e-9), np.log(4e-8), 3))
            r = np.exp(rng.uniform(np.log(2e-8), np.log(1.2e-7), 3)) * (1.0 if link < 4 else 3.0)
            at_end = np.diag([*t, *r]) * scale
        if links in ("end", "beam"):  # C at the beginning = A C_end Aᵀ, wrench at begin carried to end
            x, y, z = arm
            hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            # displacement at begin that moves the end alike: t_begin = t_end + hat(arm)·r
            a = np.block([[np.eye(3), hat], [np.zeros((3, 3)), np.eye(3)]])
            compliance[link] = a @ at_end @ a.T
        else:
            compliance[link] = at_end
    bend = np.array([20e-3, 15e-3, 15e-3, 20e-3, 20e-3, 20e-3]) * np.exp(rng.uniform(-0.4, 0.4, 6)) / scale
    if gear == "cubic":
        bend = bend * 0.4
    if gear in ("three", "settling"):
        bend = bend * 0.2
    robot = TrueRobot(
        Gear(gear, 1 / k, bend),
        links=compliance,
        masses=MASSES * rng.uniform(0.95, 1.05, 6) if weights else 0 * MASSES,
        comp=(1.2e5 * rng.uniform(0.9, 1.1), 0.458, 0.18472, 0.68593, 0.1233),
        gears_feel_rest=feel_rest,
        origins=ORIGINS + rng.normal(0, geometry, (6, 3)),
        tilts=rng.normal(0, geometry, (6, 3)) * 0.5,
        offsets=rng.normal(0, geometry, 6) * 0.5,
    )
    return robot


def varied(rng):
    """A robot drawn otherwise than `hard`: each gear of another kind, springs anywhere along the links and about any
    axes, some links nearly rigid, masses and their centres off by more."""
    k = PAPER_K * np.exp(rng.normal(0.0, 0.3, 6))
    kinds = tuple(rng.choice(["linear", "quadratic", "cubic", "three", "settling"], 6))
    share = {"linear": 1.0, "quadratic": 1.0, "cubic": 0.4, "three": 0.2, "settling": 0.2}
    bend = np.array([20e-3, 15e-3, 15e-3, 20e-3, 20e-3, 20e-3]) * np.exp(rng.normal(0.0, 0.35, 6))
    compliance = {}
    for link in range(0 if rng.random() < 0.5 else 1, 7):
        arm = ORIGINS[link] if link < 6 else np.zeros(3)
        size = 0.1 if rng.random() < 0.25 else 1.0
        blocks = []
        for middle, wider in ((1.3e-8, 1.0), (5e-8, 1.0 if link < 4 else 3.0)):
            axis = rng.normal(size=3)
            turn = rot(axis / np.linalg.norm(axis), rng.uniform(0.0, 0.15, 1))[0]
            blocks.append(turn @ np.diag(size * wider * middle * np.exp(rng.normal(0.0, 0.6, 3))) @ turn.T)
        x, y, z = rng.random() * arm
        a = np.block([[np.eye(3), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])], [np.zeros((3, 3)), np.eye(3)]])
        c = np.zeros((6, 6))
        c[:3, :3], c[3:, 3:] = blocks
        compliance[link] = a @ c @ a.T
    return TrueRobot(
        Gear(kinds, 1 / k, bend * np.array([share[kind] for kind in kinds])),
        links=compliance,
        masses=MASSES * np.exp(rng.normal(0.0, 0.1, 6)),
        comp=(1.2e5 * np.exp(rng.normal(0.0, 0.08)), 0.458, 0.18472, 0.68593, 0.1233),
        gears_feel_rest=bool(rng.random() < 0.75),
        origins=ORIGINS + rng.normal(0, 3e-4, (6, 3)),
        tilts=rng.normal(0, 1.5e-4, (6, 3)),
        offsets=rng.normal(0, 1.5e-4, 6),
        centres=CENTRES + rng.normal(0, 0.02, (6, 3)),
    )


def small(rng, gear="quadratic", links=True, feel_rest=True):
    """A KR 16 without compensator: origins, masses and centres as robot_models/kuka_kr16_2 has them (A6 at the flange,
    which is on its axis)."""
    k = np.array([1.9, 1.1, 2.1, 11.0, 14.0, 17.0]) * 1e-6 * np.exp(rng.uniform(-0.35, 0.35, 6))
    compliance = {}
    for link in range(1, 7) if links else ():
        t = np.exp(rng.uniform(np.log(1e-8), np.log(1e-7), 3))
        r = np.exp(rng.uniform(np.log(1e-7), np.log(6e-7), 3)) * (1.0 if link < 4 else 3.0)
        compliance[link] = np.diag([*t, *r])
    bend = np.array([20, 15, 15, 20, 20, 20]) * 0.2e-3 * np.exp(rng.uniform(-0.4, 0.4, 6))
    return TrueRobot(
        Gear(gear, 1 / k, bend),
        links=compliance,
        masses=np.array([90.0, 45.0, 35.0, 14.0, 6.0, 2.0]),
        comp=(0.0, 0.458, 0.18472, 0.68593, 0.1233),
        origins=np.array([[0, 0, 0.675], [0.26, 0, 0], [0.68, 0, 0], [0.67, 0, -0.035], [0, 0, 0], [0.158, 0, 0]]),
        gears_feel_rest=feel_rest,
        centres=np.array(
            [[0.05, 0, -0.15], [0.3, 0.05, 0], [0.08, 0, -0.035], [-0.25, 0, 0], [0.02, 0, 0], [-0.068, 0, 0]]
        ),
    )


def plan(rng, count=15, levels=(-10, -40, -70, -100, -130), load=2700.0, tilt=40.0, vertical=False):
    """Measurement poses and loads as the shop would choose them: (m, 6) [rad], (m, 3) [N]."""
    q, f = [], []
    while len(q) < count:
        a2 = levels[len(q) % len(levels)]
        a = np.array([rng.uniform(-60, 60), a2, 0, rng.uniform(-170, 170), 0, rng.uniform(-170, 170)])
        a[2] = rng.uniform(-20, 140)
        a[4] = rng.choice([-1, 1]) * rng.uniform(20, 100)
        if not -20 < a[2] + a2 < 110 - 0 and not -150 < a[2] + a2 < 20:
            continue
        t, p = np.radians(0 if vertical else tilt) * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        q.append(np.radians(np.round(a, 3)))
        f.append(np.round(load * np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), -np.cos(t)]), 1))
    return np.array(q), np.array(f)


def largest_torque(q, f, point=LOAD_POINT):
    """Largest torque (6,) of forces at a point of the flange frame about the joints [N·m]."""
    bare = TrueRobot(Gear("linear", 1 / PAPER_K, np.ones(6)))
    frames = bare.frames(bare.commanded(q))
    flange = bare.flange(frames)
    return np.abs(bare.pulled(frames, 5, flange[:, :3, 3] + flange[:, :3, :3] @ point, f)).max(axis=0)


def measure(robot, q, f, rng, sigma=0.03e-3, repeats=3, points=None, levels=(1.0,), tails=False):
    """Exact positions (m, 1 + loads, p, 3) [m] in a tilted tracker frame and noisy readings (m, 1 + loads, repeats, p,
    3): without load, and under the forces times each of `levels`; `tails`: noise with far more gross errors."""
    points = POINTS if points is None else points
    axis = rng.normal(size=3)
    tracker = rot(axis / np.linalg.norm(axis), rng.uniform(0.3, 2.5, 1))[0]
    shift = rng.uniform(-2, 2, 3)
    p = np.array(list(points.values())) + rng.normal(0, 0.5e-3, (len(points), 3))
    exact = np.empty((len(q), 1 + len(levels), len(points), 3))
    for load, force in enumerate((0 * f, *(level * f for level in levels))):
        flange = robot.solve(q, force)
        exact[:, load] = (flange[:, None, :3, 3] + np.einsum("nij,pj->npi", flange[:, :3, :3], p)) @ tracker.T + shift
    return exact, readings(exact, rng, sigma, repeats, tails)


def readings(exact, rng, sigma, repeats, tails=False):
    if tails:  # Student's t of three degrees of freedom, as wide as σ on the whole
        shape = (*exact.shape[:2], repeats, *exact.shape[2:])
        return exact[:, :, None] + sigma / np.sqrt(3.0) * rng.standard_t(3, shape)
    return exact[:, :, None] + rng.normal(0, sigma, (*exact.shape[:2], repeats, *exact.shape[2:]))


def write(folder: Path, q, f, raw, sigma=0.03e-3, robot="kuka_kr270", points=None, levels=(1.0,), more=""):
    """Write measurements.csv and experiment.toml as docs/reference describes them, with lines `more` at its head."""
    points = POINTS if points is None else points
    folder.mkdir(parents=True, exist_ok=True)
    rows = ["config,load,repeat,point,A1,A2,A3,A4,A5,A6,Fx,Fy,Fz,Mx,My,Mz,X,Y,Z"]
    for c in range(len(q)):
        angles = ",".join(f"{a:.3f}" for a in np.degrees(q[c]))
        for load, level in enumerate((0.0, *levels)):
            force = ",".join(f"{v:.1f}" for v in level * f[c])
            for r in range(raw.shape[2]):
                for name, p in zip(points, raw[c, load, r] * 1e3, strict=True):
                    xyz = f"{p[0]:.4f},{p[1]:.4f},{p[2]:.4f}"
                    rows.append(f"{c + 1},{load},{r + 1},{name},{angles},{force},0.0,0.0,0.0,{xyz}")
    (folder / "measurements.csv").write_text("\n".join(rows) + "\n")
    text = f'robot = "{robot}"\nsigma_mm = {sigma * 1e3:g}\n{more}\n[load_point]\n'
    text += "".join(f"{n} = {v * 1e3:g}\n" for n, v in zip("XYZ", LOAD_POINT, strict=True))
    for name, p in points.items():
        text += f"\n[points.{name}]\n" + "".join(f"{n} = {v * 1e3:g}\n" for n, v in zip("XYZ", p, strict=True))
    (folder / "experiment.toml").write_text(text)
    return folder


def milling_job(rng, count=60, force=600.0):
    """Joint angles (n, 6) [rad] along a pocket in front of the robot, forces (n, 3) [N] along and across the path."""
    start = np.radians([rng.uniform(-15, 15), rng.uniform(-75, -45), rng.uniform(75, 105), rng.uniform(-10, 10), 0, 0])
    start[4] = np.radians(rng.uniform(30, 70))
    start[5] = np.radians(rng.uniform(-20, 20))
    t = np.linspace(0, 2 * np.pi, count)
    swing = np.radians([8, 6, 7, 4, 5, 6]) * rng.uniform(0.5, 1.0, 6)
    phase = rng.uniform(0, 2 * np.pi, 6)
    q = start + swing * np.sin(t[:, None] + phase)
    direction = np.stack([np.cos(2 * t), np.sin(2 * t), rng.uniform(0.2, 0.6) + 0 * t], axis=1)
    return q, force * direction / np.linalg.norm(direction, axis=1, keepdims=True)


def milling_jobs(rng, count=3):
    """The angles and forces of several jobs."""
    return [milling_job(rng) for _ in range(count)]


def main():
    """Write readings to identify a robot by, and readings at other poses to validate the model by, into a folder.

    The robot is as the paper models it. Each configuration is read without load, and under an inclined pull of 0.2 and
    of 2.7 kN.
    """
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "demo")
    rng = np.random.default_rng(1)
    robot = paper_like(rng)
    for name in ("validation.csv", "measurements.csv"):
        q, f = plan(rng, count=30, tilt=90.0)
        write(folder, q, f, measure(robot, q, f, rng, levels=DEMO_LEVELS)[1], levels=DEMO_LEVELS)
        (folder / "measurements.csv").replace(folder / name)
    print(f"written: {folder / 'measurements.csv'}, {folder / 'experiment.toml'}, {folder / 'validation.csv'}")


if __name__ == "__main__":
    main()
