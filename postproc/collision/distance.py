"""Distances between the bodies of a scene at given joint angles."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.collision.bodies import Body, Scene
from postproc.frames import Array, inverse, norm, rotation_from_vector
from postproc.program import Ints
from postproc.robot.chain import Chain

_TOUCH_DISTANCE = 1e-6
"""Bodies whose bounding volumes are farther apart than this [m] do not touch (assumed)."""
_CONVEX_TOLERANCE = 1e-3
"""A mesh is convex if its volume is smaller than that of its hull by at most this share (assumed)."""


class Clearance(Struct, frozen=True, eq=False):
    """Smallest distance of the bodies of a scene at n poses.

    :param distance: (n,) [m]; 0 if two bodies touch or overlap, infinite without bodies to compare.
    :param first: (n,) row in `Scene.bodies` of the body that moves; −1 without bodies to compare.
    :param second: (n,) row of the other body; −1 without bodies to compare.
    """

    distance: Array
    first: Ints
    second: Ints


def clearance(scene: Scene, q: Array) -> Clearance:
    """Return the smallest distance of the bodies of a scene at each of n independent poses.

    :param q: (n, 6) joint angles of the controller [rad].
    """
    smallest = Clearance(np.full(len(q), np.inf), np.full(len(q), -1), np.full(len(q), -1))
    solids = Solids(scene)
    frames = link_frames(scene.robot.nominal, q)
    for first, second in solids.pairs:
        distance = solids.distance(first, second, frames, solid=True)
        is_smaller = distance < smallest.distance
        smallest.distance[is_smaller] = distance[is_smaller]
        smallest.first[is_smaller], smallest.second[is_smaller] = first, second
    return smallest


def link_frames(chain: Chain, q: Array, shift: Array | None = None) -> Array:
    """Return the frames (n, 8, 4, 4) in the root [m] of the carriers: base (−1), links (0…5) and flange (6).

    The row of a frame is its carrier + 1.

    :param chain: chain of six joints, without springs of links.
    :param q: (n, 6) joint angles [rad].
    :param shift: (n, 3) displacement of the robot from the root by E1 [m]; None: there is no E1.
    """
    joint_frames, flange = chain.joint_frames(q)  # of joints before they turn
    turn = rotation_from_vector(q[:, :, None] * chain.axis)
    frames = np.empty((len(q), 8, 4, 4))
    frames[:, 0], frames[:, 7] = np.eye(4), flange
    frames[:, 1:7] = joint_frames
    frames[:, 1:7, :3, :3] = joint_frames[:, :, :3, :3] @ turn
    if shift is not None:
        frames[..., :3, 3] += shift[:, None]
    return frames


class Solids:
    """The bodies of a scene as objects of FCL, which computes their distances."""

    def __init__(self, scene: Scene, pairs: Iterable[tuple[int, int]] | None = None) -> None:
        """Make the FCL objects of the bodies of a scene.

        :param pairs: rows of bodies to compare, the one that moves first; None: all pairs that matter.
        """
        import fcl  # programs without [collision] start without it

        self.fcl = fcl
        self.scene = scene
        self.bodies = scene.bodies
        self.pairs = list(scene.pairs() if pairs is None else pairs)
        self.calls = 0
        self.convex = [body.kind != "mesh" or _is_convex(body) for body in scene.bodies]
        self.objects = [
            fcl.CollisionObject(self._geometry(body, convex))
            for body, convex in zip(scene.bodies, self.convex, strict=True)
        ]
        self.request = fcl.DistanceRequest(enable_nearest_points=False, enable_signed_distance=False)
        self.spheres = [body.sphere for body in scene.bodies]
        self.spans = [_span(body) for body in scene.bodies]

    def replace_last(self, body: Body) -> Solids:
        """Return these solids with another mesh in place of the last body; the mesh need not be convex."""
        solids = copy(self)
        solids.bodies = (*self.bodies[:-1], body)
        solids.convex = [*self.convex[:-1], False]
        solids.objects = [*self.objects[:-1], self.fcl.CollisionObject(self._geometry(body, convex=False))]
        solids.spheres, solids.spans = [*self.spheres[:-1], body.sphere], [*self.spans[:-1], _span(body)]
        return solids

    def move_base(self, motion: Array) -> Solids:
        """Return these solids with the bodies that move with `$BASE` moved by a motion (4, 4) in the root [m]."""
        solids = copy(self)
        solids.bodies = tuple(body.transform(motion) if body.moves_with_base else body for body in self.bodies)
        solids.spheres = [body.sphere for body in solids.bodies]
        return solids

    def _geometry(self, body: Body, convex: bool) -> Any:
        """Return a body as a geometry of FCL.

        :param convex: True: a mesh is given by its convex hull; False: by its surface.
        """
        fcl, size = self.fcl, body.size
        if body.kind == "box":
            return fcl.Box(*size)
        if body.kind == "cylinder":
            return fcl.Cylinder(*size)
        if body.kind == "capsule":
            return fcl.Capsule(*size)
        if convex:
            from trimesh import Trimesh

            hull = Trimesh(body.points, body.faces, process=False).convex_hull
            faces = np.column_stack([np.full(len(hull.faces), 3), hull.faces])
            return fcl.Convex(np.asarray(hull.vertices), len(faces), faces.ravel())
        model = fcl.BVHModel()
        model.beginModel(len(body.points), len(body.faces))
        model.addSubModel(body.points, body.faces)
        model.endModel()
        return model

    def frame(self, row: int, frames: Array) -> Array:
        """Return the frames (n, 4, 4) of the carrier of a body; of a fixed body the root.

        :param row: row of the body.
        :param frames: (n, 8, 4, 4) frames of all carriers, see `link_frames`.
        """
        body = self.bodies[row]
        return np.broadcast_to(np.eye(4), (len(frames), 4, 4)) if body.is_fixed else frames[:, body.carrier + 1]

    def may_be_near(self, first: int, second: int, frames: Array, min_distance: float) -> NDArray[np.bool_]:
        """Return True for poses (n,) at which two bodies may be closer than a distance, by their bounding volumes.

        The bounding sphere of each body is compared with the bounding box of the other.

        :param first: row of a body, and `second` of the other.
        :param frames: (n, 8, 4, 4) frames of the carriers, see `link_frames`.
        :param min_distance: the distance [m].
        """
        may_be_near = np.ones(len(frames), dtype=bool)
        for ball, box_body in ((first, second), (second, first)):
            centre, radius = self.spheres[ball]
            frame, box = self.frame(ball, frames), self.frame(box_body, frames) @ self.bodies[box_body].pose
            point = frame[:, :3, :3] @ centre + frame[:, :3, 3] - box[:, :3, 3]
            local = np.einsum("nji,nj->ni", box[:, :3, :3], point)  # middle of the sphere in the axes of the box
            low, high = self.spans[box_body]
            may_be_near &= norm(np.maximum(np.maximum(low - local, local - high), 0.0)) - radius < min_distance
        return may_be_near

    def is_closer(self, frames: Array, min_distance: float) -> bool:
        """Return whether two bodies touch or are closer than `min_distance` [m] at any of n poses.

        :param frames: (n, 8, 4, 4) frames of the carriers, see `link_frames`.
        """
        for first, second in self.pairs:
            rows = np.flatnonzero(self.may_be_near(first, second, frames, max(min_distance, _TOUCH_DISTANCE)))
            distance = self.distance(first, second, frames[rows], solid=True)
            if ((distance < min_distance) | (distance <= 0.0)).any():
                return True
        return False

    def distance(self, first: int, second: int, frames: Array, *, solid: bool) -> Array:
        """Return the distance (n,) of two bodies [m]; 0 where they touch or overlap.

        :param first: row of a body, and `second` of another.
        :param frames: (n, 8, 4, 4) frames of the carriers, see `link_frames`.
        :param solid: True: the distance is 0 also if one body is inside of a mesh. False: only surfaces of meshes
            count; along a path on which the surfaces never touch, it is enough to compare solids at one pose.
        """
        poses = [self.frame(row, frames) @ self.bodies[row].pose for row in (first, second)]
        first_object, second_object = self.objects[first], self.objects[second]
        distances = np.empty(len(frames))
        first_rotation, second_rotation = (np.ascontiguousarray(pose[:, :3, :3]) for pose in poses)
        first_position, second_position = (np.ascontiguousarray(pose[:, :3, 3]) for pose in poses)
        transform, distance_of_objects = self.fcl.Transform, self.fcl.distance
        request, new_result = self.request, self.fcl.DistanceResult
        for k in range(len(distances)):
            first_object.setTransform(transform(first_rotation[k], first_position[k]))
            second_object.setTransform(transform(second_rotation[k], second_position[k]))
            distances[k] = distance_of_objects(first_object, second_object, request, new_result())
        self.calls += len(distances)
        distances = np.maximum(distances, 0.0)
        if solid:
            for inner, outer in ((first, second), (second, first)):
                if not self.convex[outer]:
                    distances[self._contains(inner, outer, frames)] = 0.0
        return distances

    def _contains(self, inner: int, outer: int, frames: Array) -> NDArray[np.bool_]:
        """Return True for poses (n,) at which the first point of a body is inside a mesh, by its solid angle.

        Source: van Oosterom and Strackee, "The solid angle of a plane triangle", IEEE Trans. Biomed. Eng. 30, 1983.
        """
        body, mesh = self.bodies[inner], self.bodies[outer]
        point = (self.frame(inner, frames) @ np.append(body.points[0], 1.0))[:, :3]
        frame = self.frame(outer, frames)
        local = np.einsum("nji,nj->ni", frame[:, :3, :3], point - frame[:, :3, 3])
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        is_inside = ((local > low) & (local < high)).all(axis=1)
        for row in np.flatnonzero(is_inside).tolist():
            a, b, c = (mesh.points[mesh.faces[:, k]] - local[row] for k in range(3))
            length_a, length_b, length_c = (np.sqrt(np.einsum("fi,fi->f", vector, vector)) for vector in (a, b, c))
            # tan(Ω/2) of each triangle is numerator / denominator
            numerator = np.einsum("fi,fi->f", a, np.cross(b, c))
            denominator = length_a * length_b * length_c + np.einsum("fi,fi->f", a, b) * length_c
            denominator += np.einsum("fi,fi->f", b, c) * length_a + np.einsum("fi,fi->f", c, a) * length_b
            # the solid angle of a closed mesh is 4π from inside and 0 from outside
            is_inside[row] = abs(float(np.sum(2.0 * np.arctan2(numerator, denominator)))) > 2.0 * np.pi
        return np.asarray(is_inside)


def _is_convex(body: Body) -> bool:
    """Return whether a body fills its convex hull: it is closed, and its volume is that of the hull."""
    from trimesh import Trimesh

    mesh = Trimesh(body.points, body.faces, process=True)
    return bool(mesh.is_watertight and abs(mesh.volume) >= (1.0 - _CONVEX_TOLERANCE) * mesh.convex_hull.volume)


def _span(body: Body) -> tuple[Array, Array]:
    """Return the smallest coordinates (3,) and the largest coordinates (3,) of a body in the axes of its pose [m]."""
    to_body = inverse(body.pose)
    points = body.points @ to_body[:3, :3].T + to_body[:3, 3]
    return points.min(axis=0), points.max(axis=0)
