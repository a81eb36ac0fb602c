"""Scenes, and distances from formulas and dense samples; the arm's frames come from Pinocchio."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin

from postproc.collision import Scene, bodies
from tests.kr270 import FOLDER, ROBOT

_MODEL = pin.buildModelFromUrdf(str(FOLDER / "robot.urdf"))
_PINOCCHIO_DATA = _MODEL.createData()
_FLANGE = _MODEL.getFrameId("flange")


def frame(q, carrier: int) -> np.ndarray:
    """The frame (4, 4) of a carrier, by Pinocchio."""
    if carrier < 0:
        return np.eye(4)
    pin.framesForwardKinematics(_MODEL, _PINOCCHIO_DATA, np.asarray(q))
    return (_PINOCCHIO_DATA.oMf[_FLANGE] if carrier == 6 else _PINOCCHIO_DATA.oMi[carrier + 1]).homogeneous


def pose(rotation, point) -> np.ndarray:
    return pin.SE3(rotation, np.asarray(point, dtype=float)).homogeneous


def surface_of_cylinder(begin, end, radius, count=24) -> np.ndarray:
    """Points on a cylinder, the rims of its ends among them."""
    line = end - begin
    length = np.linalg.norm(line)
    x = np.linalg.svd(line[None] / length)[2][1]
    y = np.cross(line / length, x)
    angle = np.arange(count) * 2 * np.pi / count
    rim = radius * (np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y)
    along = begin + np.linspace(0, 1, 12)[:, None] * line
    lids = [middle + share * rim for middle in (begin, end) for share in (0.0, 0.5)]
    return np.concatenate([(along[:, None] + rim[None]).reshape(-1, 3), *lids])


def from_box(points, place, edges) -> np.ndarray:
    """Distance of points (..., 3) from a box; 0 inside."""
    inv = np.linalg.inv(place)
    local = points @ inv[:3, :3].T + inv[:3, 3]
    return np.linalg.norm(np.maximum(np.abs(local) - 0.5 * np.asarray(edges), 0.0), axis=-1)


def scene(*parts) -> Scene:
    return Scene(ROBOT, parts)


def random_scene(rng):
    """A cylinder and a capsule on the arm, a box, and a short motion by it; and their numbers."""
    q = rng.uniform(0.5 * ROBOT.lower, 0.5 * ROBOT.upper)
    steps = rng.normal(0, rng.choice([0.01, 0.05, 0.2]), (rng.integers(2, 6), 6))
    path = q + np.cumsum(steps, axis=0)
    begin = rng.uniform(-0.1, 0.1, 3)
    end = begin + rng.normal(0, 0.2, 3)
    radius = rng.uniform(0.02, 0.15)
    carrier = int(rng.integers(2, 5))
    edges = rng.uniform(0.05, 0.8, 3)
    middle = frame(path[len(path) // 2], 6)[:3, 3] + rng.normal(0, 0.4, 3)
    place = pose(pin.exp3(rng.normal(0, 1, 3)), middle)
    parts = (
        bodies.cylinder("spindle", 6, "tool", begin, end, radius),
        bodies.capsule("link", carrier, "arm", begin, end, radius),
        bodies.box("vice", -1, "obstacle", place, edges),
    )
    return scene(*parts), path, (begin, end, radius, carrier, place, edges)


def sampled(path, numbers, between=40) -> np.ndarray:
    """Smallest distances (2,) of cylinder and capsule from the box, by dense samples: never below the true ones."""
    begin, end, radius, carrier, place, edges = numbers
    cylinder = surface_of_cylinder(begin, end, radius)
    segment = begin + np.linspace(0, 1, 60)[:, None] * (end - begin)
    share = np.linspace(0, 1, between, endpoint=False)
    dense = [a + s * (b - a) for a, b in itertools.pairwise(path) for s in share] + [path[-1]]
    out = np.full(2, np.inf)
    for q in dense:
        for k, (points, of, less) in enumerate(((cylinder, 6, 0.0), (segment, carrier, radius))):
            at = frame(q, of)
            found = from_box(points @ at[:3, :3].T + at[:3, 3], place, edges).min() - less
            out[k] = min(out[k], max(found, 0.0))
    return out
