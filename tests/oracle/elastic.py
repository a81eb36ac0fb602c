"""The arm of `tests.oracle.arm`, solved quickly: the same potential, its stationary point by a fixed point.

θ = K⁻¹ (gradient of what is balanced − gradient of springs and weights + Jᵀ of the wrench), all at q + θ, again and
again: the springs are so stiff that some rounds are exact to the last digits. `tests/test_elastic.py` holds it against
the slow way.
"""

from __future__ import annotations

import numpy as np

from tests.oracle.arm import G


def joint_frames(arm, q):
    """Points (6, 3) and directions (6, 3) of the axes, and all frames."""
    frames = arm.frames(q)
    points = np.array([frame[:3, 3] for frame in frames[:6]])
    axes = np.array([frame[:3, :3] @ axis for frame, axis in zip(frames, arm.axes, strict=False)])
    return points, axes, frames


def cross(a, b):
    """Vector products (n, 3) of (n, 3) and (n, 3) or (3,); `numpy.cross` takes ten times as long for so few."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u]).T


def torques(arm, q, tool, wrench, placed=None):
    """Torques of a wrench at the tip, (6,); `placed`: the joint frames, where they are known."""
    points, axes, frames = placed or joint_frames(arm, q)
    tip = (frames[-1] @ tool)[:3, 3]
    return np.einsum("ij,ij->i", axes, cross(tip - points, wrench[:3])) + axes @ wrench[3:]


def load(arm, q, payload=True, placed=None):
    """Gradient of the potential of weights and compensator, (6,); `placed` as for `torques`."""
    points, axes, frames = placed or joint_frames(arm, q)
    out = np.zeros(6)
    bodies = [(n, m, frames[n] @ [*c, 1.0]) for n, (m, c) in enumerate(zip(arm.masses, arm.centres, strict=True))]
    if payload and arm.payload[0]:
        bodies.append((5, arm.payload[0], frames[6] @ [*arm.payload[1], 1.0]))
    for link, mass, centre in bodies:
        moved = slice(link + 1)
        out[moved] += mass * G * cross(axes[moved], centre[:3] - points[moved])[:, 2]
    step = 1e-30
    out[1] += np.imag(arm.spring_energy(q[1] + 1j * step)) / step
    return out


def loaded_tip(arm, q, tool, wrench):
    """Where the tool (4, 4) stands under a wrench (6,) at its tip, root axes."""
    balanced = np.zeros(6) if arm.rigid else load(arm, q, payload=False)
    theta = np.zeros(6)
    for _ in range(30):
        placed = joint_frames(arm, q + theta)
        change = balanced - load(arm, q + theta, placed=placed) + torques(arm, q + theta, tool, wrench, placed)
        new = change / arm.stiffness
        done = np.abs(new - theta).max() < 1e-14
        theta = new
        if done:
            return arm.tcp(q + theta, tool)
    raise ArithmeticError("no equilibrium")


def inverse(arm, pose, tool, guess):
    """Joint angles whose tool stands at a pose, near a guess, by Newton's method."""
    q = np.array(guess, dtype=float)
    for _ in range(50):
        points, axes, frames = joint_frames(arm, q)
        here = frames[-1] @ tool
        turn = pose[:3, :3] @ here[:3, :3].T
        rotation = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        error = np.concatenate([pose[:3, 3] - here[:3, 3], rotation])
        if np.abs(error).max() < 1e-12:
            return q
        jacobian = np.vstack([cross(axes, here[:3, 3] - points).T, axes.T])
        step = np.linalg.solve(jacobian, error)
        q = q + step * min(1.0, 0.3 / np.abs(step).max())
    raise ArithmeticError(f"not reached: {error}")
