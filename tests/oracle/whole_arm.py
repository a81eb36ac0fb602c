"""An arm with all that the model of docs/architecture.md knows, written anew: chain and weights by Pinocchio, springs,
compensator and errors of transmission in plain numpy, the loaded equilibrium by Newton's method with differences.

One configuration at a time. Of the package it takes the content of a model file, and computes nothing with it.
"""

from __future__ import annotations

import copy
import math
import operator

import numpy as np
import pinocchio as pin

from tests.oracle.pinocchio_arm import JOINTS
from tests.oracle.pinocchio_arm import Arm as Chain

AXES = ("X", "Y", "Z", "RX", "RY", "RZ", "end_RX", "end_RY", "end_RZ")


def _fading(torque, rest, scale):
    return scale * (math.asinh((torque + rest) / scale) - math.asinh(rest / scale))


def _knee(torque, rest, scale):
    def f(u):
        return u / (1.0 + u**4) ** 0.25

    return scale * (f((torque + rest) / scale) - f(rest / scale))


def _backlash(torque, rest, scale):
    return math.tanh((torque + rest) / scale) - math.tanh(rest / scale)


def _angle(turns):
    """The angle of a wave as names in files have it."""
    parts = [
        f"{'-' if n < 0 else '+'}{'' if abs(n) == 1 else abs(n)}{joint}"
        for n, joint in zip(turns, JOINTS, strict=True)
        if n
    ]
    return "".join(parts).lstrip("+")


class WholeArm:
    """The arm of a URDF and the content of a model file; `payload` (mass [kg], centre in the flange frame [m]).

    Its chains are built once, and once more for arms with other masses.

    What tests change: `linear` (nv,) compliances, `parts` [function, coordinate, torque, value], `over_pose` [joint,
    turns, function, value], `couplings` {(joint, joint): value}, `stiffness` and `preload` of the compensator,
    `heavier` (6,) factors of the masses.
    """

    def __init__(self, urdf, content, payload=(0.0, (0.0, 0.0, 0.0))):
        self.urdf, self.payload = urdf, payload
        self.rigid, self.in_gears = content.gravity.reference == "rigid", content.gravity.in_gears
        self.displaced = {
            place: (np.array([d.X_mm, d.Y_mm, d.Z_mm]) / 1e3, np.radians([d.RX_deg, d.RY_deg, d.RZ_deg]))
            for place, d in content.geometry.items()
        }
        self.springs, values = [], []
        for link in ("base", *JOINTS):
            for axis in AXES if link in content.links else ():
                value = getattr(content.links[link], f"{axis}_{'um_per_N' if axis in 'XYZ' else 'urad_per_Nm'}")
                if value:
                    self.springs.append((link, axis))
                    values.append(value * 1e-6)
        self.heavier, self.built = np.ones(6), None
        rows = self.chains()[1].actuated
        self.rows, count = rows, 6 + len(values)
        self.linear, self.parts = np.zeros(count), []
        self.linear[sorted(set(range(count)) - set(rows))] = values
        for row, name in zip(rows, JOINTS, strict=True):
            own = content.joints[name]
            self.linear[row] = own.compliance_urad_per_Nm * 1e-6
            for function, entries in ((_fading, own.stiffening), (_knee, own.knees)):
                for entry in entries:
                    self.parts.append([function, row, entry.torque_Nm, entry.compliance_urad_per_Nm * 1e-6])
                    self.linear[row] -= entry.compliance_urad_per_Nm * 1e-6
            for function, entry in ((_backlash, own.backlash), (None, own.lost_motion)):
                if entry is not None:
                    self.parts.append([function, row, entry.torque_Nm, entry.angle_urad * 1e-6])
        self.over_pose, self.couplings = [], {}
        for joint, name in enumerate(JOINTS):
            for entry in content.joints[name].over_pose:
                for function, value in ((math.cos, entry.cos_urad_per_Nm), (math.sin, entry.sin_urad_per_Nm)):
                    self.over_pose.append([joint, tuple(entry.turns), function, (value or 0.0) * 1e-6])
            for second, value in content.joints[name].coupling.items():
                self.couplings[joint, JOINTS.index(second)] = value * 1e-6
        law = content.compensator
        self.stiffness = law.stiffness_N_per_m if law else 0.0
        self.preload = self.stiffness * law.free_length_mm / 1e3 if law else 0.0
        self.triangle = (law.L_mm / 1e3, law.a_x_mm / 1e3, law.a_y_mm / 1e3) if law else (0.1, 1.0, 0.0)
        self.waves = np.zeros((6, 4))
        for name, entry in content.transmission.items():
            self.waves[JOINTS.index(name)] = entry.sin_urad, entry.cos_urad, entry.sin2_urad, entry.cos2_urad
        self.waves *= 1e-6

    def but(self, **changes):
        """Return the arm with other values."""
        other = copy.copy(self)
        if not changes.keys() <= {"linear", "parts", "over_pose", "couplings", "stiffness", "preload"}:
            other.built = None
        other.__dict__ |= changes
        return other

    def chains(self):
        """The chain with payload, and without."""
        if self.built is None:
            loaded = self.payload if self.payload[0] else None
            self.built = [Chain(self.urdf, self.displaced, self.springs, p, self.heavier) for p in (loaded, None)]
        return self.built

    def held_by_motors(self, q):
        """Coordinates (nv,) without deflection for joint angles (6,) that the controller holds."""
        q, x = np.asarray(q, dtype=float), np.zeros(len(self.linear))
        x[self.rows] = q + np.einsum("jk,kj->j", self.waves, [np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q)])
        return x

    def law(self, x, torque, rest, load):
        """θ (nv,) of the springs at coordinates x; lost motion goes by what the load alone puts on them."""
        theta, angle = (self.linear * torque).tolist(), x[self.rows].tolist()  # numpy takes ten times as long for one
        torque, rest, load = torque.tolist(), rest.tolist(), load.tolist()
        for function, row, scale, value in self.parts:
            if function is None:
                theta[row] += value * math.tanh(load[row] / scale)
            else:
                theta[row] += value * function(torque[row], rest[row], scale)
        for joint, turns, function, value in self.over_pose:
            row = self.rows[joint]
            theta[row] += value * function(sum(map(operator.mul, turns, angle))) * torque[row]
        for (one, two), value in self.couplings.items():
            theta[self.rows[one]] += value * torque[self.rows[two]]
            theta[self.rows[two]] += value * torque[self.rows[one]]
        return np.array(theta)

    def compensator(self, q2):
        """Slope by q2 of the energy ½·K·s² − K·s₀·s of the spring between its two points, by the complex step."""
        length, ax, ay = self.triangle
        q2 = q2 + 1e-30j
        s = np.sqrt((length * np.cos(q2) + ax) ** 2 + (length * np.sin(q2) + ay) ** 2)
        return np.imag(0.5 * self.stiffness * s**2 - self.preload * s) / 1e-30

    def loads(self, tool):
        """Functions of coordinates: pose and Jacobian, weights and compensator of the loaded arm, and of the bare."""
        loaded, bare = self.chains()
        model, data = loaded.with_tool(tool)
        frame = model.getFrameId("tool")
        bare_data = bare.model.createData()

        def tcp(x):
            jacobian = pin.computeFrameJacobian(model, data, x, frame, pin.LOCAL_WORLD_ALIGNED).copy()
            pin.framesForwardKinematics(model, data, x)
            return data.oMf[frame].homogeneous.copy(), jacobian

        def asked(own, own_data):
            def of(x):
                torque = pin.computeGeneralizedGravity(own, own_data, x).copy()
                torque[self.rows[1]] += self.compensator(x[self.rows[1]])
                return torque

            return of

        return tcp, asked(model, data), asked(bare.model, bare_data)

    def given(self, q, tool, wrench):
        """Return the function that says how far the springs give way at deflections θ, and that of the tool there."""
        x0 = self.held_by_motors(q)
        tcp, loaded, bare = self.loads(tool)
        rest = np.zeros(len(x0)) if self.rigid else bare(x0)
        felt = -rest if self.in_gears else 0.0 * rest

        def given(theta, force=wrench):
            x = x0 + theta
            torque = tcp(x)[1].T @ force - loaded(x) + rest
            return self.law(x, torque, felt, torque + bare(x) if self.rigid else torque)

        return given, lambda theta: tcp(x0 + theta)

    def equilibrium(self, q, tool, wrench):
        """Return θ (nv,), and the pose of the tool there."""
        given, tcp = self.given(q, tool, wrench)
        theta, before = np.zeros(len(self.linear)), 0.0
        for _ in range(80):
            missed = given(theta) - theta
            size = np.abs(missed).max()
            if size < 1e-14:
                return theta, tcp(theta)[0]
            if not size < 0.1 * before:  # the slopes of an earlier step serve as long as they lead there quickly
                matrix = np.eye(len(theta)) - slopes(given, theta, 1e-7)
            before = size
            theta = theta + np.linalg.solve(matrix, missed)
        assert np.abs(missed).max() < 1e-12, missed
        return theta, tcp(theta)[0]

    def changed(self, name, step):
        """Return the arm with a linear value of a parameter, by its name in files, changed by a step (SI units)."""
        if name in ("K_c", "size"):  # at a preload that stays, and at a free length that stays
            more = self.preload / self.stiffness * step if name == "size" else 0.0
            return self.but(stiffness=self.stiffness + step, preload=self.preload + more)
        if name == "s_0":
            return self.but(preload=self.preload + step)
        if name.endswith(".mass"):
            link = int(name[1]) - 1
            whole = Chain(self.urdf).model.inertias[link + 1].mass
            return self.but(heavier=self.heavier + step / whole * np.eye(6)[link])
        if name in (names := [f"{link}.{axis}" for link, axis in self.springs]):
            row = sorted(set(range(len(self.linear))) - set(self.rows))[names.index(name)]
            return self.but(linear=self.linear + step * np.eye(len(self.linear))[row])
        if name.startswith("k") and name[1:].isdigit() and len(name) == 3:
            pair = int(name[1]) - 1, int(name[2]) - 1
            return self.but(couplings={**self.couplings, pair: self.couplings[pair] + step})
        if "(" in name:
            joint, function = int(name[1]) - 1, {"cos": math.cos, "sin": math.sin}[name[3:6]]
            wave = [p for p in self.over_pose if p[0] == joint and p[2] is function and _angle(p[1]) == name[7:-1]]
            assert len(wave) == 1, name
            changed = [[*p[:3], p[3] + step * (p is wave[0])] for p in self.over_pose]
            return self.but(over_pose=changed)
        kinds = {"@": _fading, "^": _knee, "backlash": _backlash, "lost_motion": None}
        kind = next((kind for kind in ("backlash", "lost_motion", "@", "^") if kind in name), None)
        row = self.rows[int(name[1]) - 1]
        if kind is None:
            return self.but(linear=self.linear + step * np.eye(len(self.linear))[row])
        parts = [[f, r, t, v + step * (f is kinds[kind] and r == row)] for f, r, t, v in self.parts]
        assert parts != self.parts, name
        return self.but(parts=parts)

    def by_parameter(self, name, step, q, tool, wrench):
        """Derivative (6,) of where the loaded tool stands by a parameter, by central differences."""
        less, more = (self.changed(name, h).equilibrium(q, tool, wrench)[1] for h in (-step, step))
        return twist(less, more) / (2 * step)

    def nominal(self, q, tool):
        """Pose of the tool by the controller's geometry."""
        return Chain(self.urdf).tcp([np.asarray(q, dtype=float)], tool)[0][0]


def slopes(function, at, step):
    """Central differences of a function of (n,), one column for each."""
    return np.stack([(function(at + h) - function(at - h)) / (2 * step) for h in step * np.eye(len(at))], axis=1)


def twist(one, other):
    """Displacement from one pose to another that is near: translation, and the rotation vector."""
    turn = other[:3, :3] @ one[:3, :3].T
    sine = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    size = np.linalg.norm(sine)
    return np.concatenate([other[:3, 3] - one[:3, 3], sine * (np.arcsin(size) / size if size > 0 else 1.0)])
