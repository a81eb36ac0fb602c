"""An elastic arm that shares no code with the package: URDF by ElementTree, forward kinematics in plain numpy,
equilibrium as the stationary point of the potential V(θ) of "The model" in docs/architecture.md, derivatives by complex
step.

SI units, root frame, KUKA signs. Simple on purpose: joint angles are (6,), or (n, 6) for derivatives by all of them.
"""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares, root

G = 9.81


def rot(axis, angle):
    """Rodrigues' formula, safe for complex angles."""
    k, square = _hat(*axis)
    angle = np.asarray(angle)[..., None, None]
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * square


@cache
def _hat(x, y, z):
    """The matrix of a vector product, and its square."""
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return k, k @ k


@cache
def _turns(axes):
    """The matrices (n, 4, 4) of vector products with axes, and their squares."""
    k = np.zeros((2, len(axes), 4, 4))
    for row, axis in enumerate(axes):
        k[0, row, :3, :3], k[1, row, :3, :3] = _hat(*axis)
    return k


def _steps(axes, origins):
    """Matrices (n, 4, 4) whose sum is the step to each joint: of itself, of the sine and of one less the cosine."""
    return origins, *(origins @ _turns(axes))


def rpy(r, p, y):
    return rot((0, 0, 1), y) @ rot((0, 1, 0), p) @ rot((1, 0, 0), r)


def abc(x, y, z, a=0.0, b=0.0, c=0.0):
    """KUKA frame in mm and degrees as 4×4 in metres."""
    pose = np.eye(4)
    pose[:3, :3] = rpy(*np.radians([c, b, a]))
    pose[:3, 3] = np.array([x, y, z]) / 1000
    return pose


@dataclass
class Arm:
    origins: list
    axes: list
    flange: np.ndarray
    masses: list
    centres: list
    stiffness: np.ndarray
    comp: dict | None = None
    rigid: bool = False
    payload: tuple = (0.0, np.zeros(3))
    nominal_origins: list = field(default_factory=list)

    @classmethod
    def load(cls, folder: Path) -> Arm:
        tree = ET.parse(folder / "robot.urdf").getroot()
        model = tomllib.loads((folder / "model.toml").read_text(encoding="utf-8"))
        links = {link.get("name"): link for link in tree.findall("link")}
        origins, axes, masses, centres = [], [], [], []
        joints = {j.get("name"): j for j in tree.findall("joint")}

        def placement(element):
            pose = np.eye(4)
            origin = element.find("origin")
            if origin is not None:
                pose[:3, 3] = [float(v) for v in origin.get("xyz", "0 0 0").split()]
                pose[:3, :3] = rpy(*[float(v) for v in origin.get("rpy", "0 0 0").split()])
            return pose

        for n in range(1, 7):
            j = joints[f"A{n}"]
            origins.append(placement(j))
            axes.append(np.array([float(v) for v in j.find("axis").get("xyz").split()]))
            inertial = links[j.find("child").get("link")].find("inertial")
            masses.append(0.0 if inertial is None else float(inertial.find("mass").get("value")))
            centres.append(np.zeros(3) if inertial is None else placement(inertial)[:3, 3])
        flange = next(placement(j) for j in joints.values() if j.find("child").get("link") == "flange")
        k = np.array([model["joints"][f"A{n}"]["compliance_urad_per_Nm"] for n in range(1, 7)]) * 1e-6
        comp = None
        if "compensator" in model:
            c = model["compensator"]
            comp = {
                "K": c["stiffness_N_per_m"], "s0": c["free_length_mm"] / 1e3, "L": c["L_mm"] / 1e3,
                "ax": c["a_x_mm"] / 1e3, "ay": c["a_y_mm"] / 1e3,
            }  # fmt: skip
        rigid = model.get("gravity", {}).get("reference", "calibrated") == "rigid"
        arm = cls(origins, axes, flange, masses, centres, 1 / k, comp, rigid)
        arm.nominal_origins = origins
        return arm

    def frames(self, q, origins=None):
        """Poses of the six joints (after their rotation) and of the flange."""
        q = np.asarray(q)[..., None, None]
        origin, by_sine, by_cosine = _steps(tuple(map(tuple, self.axes)), np.stack(origins or self.origins))
        step = origin + np.sin(q) * by_sine + (1 - np.cos(q)) * by_cosine
        out = [step[..., 0, :, :]]
        for joint in range(1, len(self.axes)):
            out.append(out[-1] @ step[..., joint, :, :])
        return [*out, out[-1] @ self.flange]

    def tcp(self, q, tool):
        return self.frames(q)[-1] @ tool

    def nominal_tcp(self, q, tool):
        return self.frames(q, self.nominal_origins)[-1] @ tool

    def weight_energy(self, q, payload=True):
        return self.weight_energy_at(self.frames(q), payload)

    def weight_energy_at(self, frames, payload=True):
        bodies = list(zip(self.masses, frames[:6], self.centres, strict=True))
        if payload:
            bodies.append((self.payload[0], frames[6], self.payload[1]))
        return sum(m * G * (f @ [*c, 1.0])[..., 2] for m, f, c in bodies)

    def spring_energy(self, q2):
        c = self.comp
        if c is None:
            return 0.0 * q2
        s = np.sqrt(
            c["ax"] ** 2 + c["ay"] ** 2 + c["L"] ** 2
            + 2 * np.hypot(c["ax"], c["ay"]) * c["L"] * np.cos(np.arctan2(c["ay"], c["ax"]) - q2)
        )  # fmt: skip
        return 0.5 * c["K"] * (s - c["s0"]) ** 2

    def potential(self, theta, q, tool, force, reference, frames=None):
        """V(θ) without the moment, whose work is no function of θ; `reference`: gradient at q of what is balanced.

        `frames`: those at q + θ, if they are there already.
        """
        x = q + theta
        frames = frames or self.frames(x)
        value = 0.5 * np.sum(self.stiffness * theta**2, axis=-1) + self.spring_energy(x[..., 1])
        value = value + self.weight_energy_at(frames)
        return value - theta @ reference - (frames[-1] @ tool)[..., :3, 3] @ force

    def gradient(self, fun, at, h=1e-30):
        """Derivatives of a function of (n,) by each of the n."""
        return np.array([np.imag(fun(x)) / h for x in at + 1j * h * np.eye(len(at))])

    def slopes(self, fun, at, h=1e-30):
        """The same of a function that takes all n at once, (n, n)."""
        return np.imag(fun(at + 1j * h * np.eye(len(at)))) / h

    def reference(self, q):
        if self.rigid:
            return np.zeros(6)
        return self.slopes(lambda x: self.spring_energy(x[..., 1]) + self.weight_energy(x, payload=False), q)

    def moment_torque(self, x, moment, h=1e-30):
        """J_ωᵀ M: the rotation rate of each joint by the complex step on the rotation matrix."""
        return self.torque_of(self.frames(x + 1j * h * np.eye(6))[-1], moment, h)

    def torque_of(self, flange, moment, h):
        """The same by poses (6, 4, 4) of the flange, each with an imaginary step of one joint."""
        r = flange[:, :3, :3]
        w = np.imag(r) / h @ np.real(r).swapaxes(1, 2)
        return np.stack([w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]], axis=1) @ moment

    def equilibrium(self, q, tool, wrench, h=1e-30):
        """θ at which the potential is stationary under a dead force and moment at the TCP (root axes)."""
        reference = self.reference(q)

        def residual(scaled):
            theta = scaled / self.stiffness
            stepped = theta + 1j * h * np.eye(6)
            frames = self.frames(q + stepped)
            slope = np.imag(self.potential(stepped, q, tool, wrench[:3], reference, frames)) / h
            return slope - self.torque_of(frames[-1], wrench[3:], h)

        solution = root(residual, np.zeros(6), method="hybr", options={"xtol": 1e-13})
        assert np.abs(solution.fun).max() < 1e-6, solution.message
        return solution.x / self.stiffness

    def loaded_tcp(self, q, tool, wrench):
        return self.tcp(q + self.equilibrium(q, tool, wrench), tool)

    def inverse(self, pose, tool, guess, h=1e-30):
        """Joint angles by the controller's geometry, near `guess`: by Newton's method, or by least squares if that does
        not at least halve the error in each step."""

        def error(q):
            here = self.nominal_tcp(q, tool)
            r = here[..., :3, :3].swapaxes(-1, -2) @ pose[:3, :3]
            turned = [r[..., i, j] - r[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
            return np.concatenate([here[..., :3, 3] - pose[:3, 3], np.stack(turned, axis=-1)], axis=-1)

        q, before = np.asarray(guess, dtype=float), np.inf
        while True:
            values = error(q + 1j * h * np.eye(6))  # and its derivatives, by the complex step
            size = np.abs(values[0].real).max()
            if size < 1e-13:
                return q
            if not size < 0.5 * before:
                break
            before = size
            q = q - np.linalg.lstsq(values.imag.T / h, values[0].real, rcond=None)[0]
        found = least_squares(error, guess, lambda q: self.slopes(error, q).T, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert np.abs(found.fun).max() < 1e-9, found.fun
        return found.x
