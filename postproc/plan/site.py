"""The site of a measurement, in SI units: rig, shape of the arm, obstacles, tracker, limits.

Obstacles are boxes and meshes; their distances from many points or segments are computed at once.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec import Struct

from postproc import files
from postproc.errors import PlanError
from postproc.frames import DEG_PER_RAD, M_PER_MM, RAD_PER_DEG, Array, inverse
from postproc.identification.readings import Box, Experiment, MeshFile, Payload
from postproc.kinematics.forward import GRAVITY
from postproc.plan.sensitivity import Arm
from postproc.program import Bools
from postproc.robot import Chain, RobotModel

_POINT_SPACING = 0.04
"""Spacing [m] of points on capsules and meshes; errors stay below 10 mm and are part of the clearance."""
_MOST_VERTICES = 400_000
"""Limit of points on a mesh (assumed): the time of a plan grows with them."""
_SIGHT_CLEARANCE = 0.005
"""Distance [m] from bodies that a line of sight keeps (assumed)."""
_POINT_TOLERANCE = 1e-12
"""Square of a length [m²] below which a segment is a point."""
_NO_DIRECTION = 1e-9
"""Length below which a normal states no direction (assumed)."""


def segment_distances(p: Array, p_end: Array, r: Array, r_end: Array) -> Array:
    """Return the distances (...) [m] between segments from p to p_end and from r to r_end, each (..., 3) [m].

    Source, with the names of its variables: Ericson, "Real-Time Collision Detection", 2005, 5.1.9. The closest points
    are at the shares s and t of the segments.
    """
    u, v, w = p_end - p, r_end - r, p - r
    a, b, c = _dot(u, u), _dot(u, v), _dot(v, v)
    d, e = _dot(u, w), _dot(v, w)
    denominator = a * c - b * b
    is_skew = denominator > _POINT_TOLERANCE  # else parallel, or one of them a point
    s = np.where(is_skew, np.clip((b * e - c * d) / np.where(is_skew, denominator, 1.0), 0.0, 1.0), 0.0)
    t = np.where(c > _POINT_TOLERANCE, (b * s + e) / np.where(c > _POINT_TOLERANCE, c, 1.0), 0.0)
    is_clipped = ((t < 0.0) | (t > 1.0) | (c <= _POINT_TOLERANCE)) & (a > _POINT_TOLERANCE)
    t = np.clip(t, 0.0, 1.0)
    s = np.where(is_clipped, np.clip((b * t - d) / np.where(a > _POINT_TOLERANCE, a, 1.0), 0.0, 1.0), s)
    gap = w + s[..., None] * u - t[..., None] * v
    return np.sqrt(_dot(gap, gap))


def _dot(a: Array, b: Array) -> Array:
    """Return the scalar products (...) of vectors (..., 3)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def points_on_segments(start: Array, end: Array, length: float) -> Array:
    """Return n evenly spaced points (..., n, 3) on segments from `start` to `end` (..., 3) [m], ends included.

    :param length: of the longest segment [m]; n is such that its points are at most `_POINT_SPACING` apart.
    """
    count = max(2, int(np.ceil(length / _POINT_SPACING)) + 1)
    t = np.linspace(0.0, 1.0, count)[:, None]
    return np.asarray(start[..., None, :] * (1.0 - t) + end[..., None, :] * t)


class BoxShape(Struct, frozen=True, eq=False):
    """A box.

    :param name: for the user.
    :param to_box: (4, 4) transform from the root to the frame of the box, whose origin is its centre [m].
    :param half: (3,) half sizes [m].
    """

    name: str
    to_box: Array
    half: Array

    @classmethod
    def of(cls, box: Box, number: int) -> BoxShape:
        """Return a box of the experiment; its number names it if it has no name."""
        name = box.name or str(number)
        return cls(f"box {name}", inverse(box.pose()), 0.5 * np.array(box.size) * M_PER_MM)

    def distance(self, point: Array) -> Array:
        """Return signed distances (...) of points (..., 3) [m]; negative inside."""
        excess = np.abs(point @ self.to_box[:3, :3].T + self.to_box[:3, 3]) - self.half
        return np.asarray(np.linalg.norm(np.maximum(excess, 0.0), axis=-1) + np.minimum(excess.max(axis=-1), 0.0))

    def blocks(self, start: Array, end: Array) -> Bools:
        """Return (...) True if the line from `start` to `end` (..., 3) [m] passes through the box.

        By slabs (Kay and Kajiya 1986): for each pair of opposite faces the line is between them from one share of its
        length to another. It passes through the box if all three ranges and the range 0…1 have a share in common.
        """
        begin = start @ self.to_box[:3, :3].T + self.to_box[:3, 3]
        chord = end @ self.to_box[:3, :3].T + self.to_box[:3, 3] - begin
        chord = np.where(np.abs(chord) > 1e-12, chord, 1e-12)  # no division by zero along a face
        low_side, high_side = (-self.half - begin) / chord, (self.half - begin) / chord
        enter, leave = np.minimum(low_side, high_side).max(axis=-1), np.maximum(low_side, high_side).min(axis=-1)
        return np.asarray((enter <= leave) & (leave >= 0.0) & (enter <= 1.0))


class MeshShape(Struct, frozen=True, eq=False):
    """A mesh as its vertices, after splitting all edges to at most 40 mm.

    The distance to the nearest vertex less `vertex_gap` is at most the distance to the surface. The arm begins
    outside and is checked along its whole way, so it cannot get inside unnoticed.

    :param name: for the user.
    :param vertices: (n, 3) in the root [m].
    :param vertex_gap: largest distance of a point of the surface from the nearest vertex [m].
    :param tree: `cKDTree` of the vertices.
    """

    name: str
    vertices: Array
    vertex_gap: float
    tree: object

    @classmethod
    def of(cls, mesh: MeshFile, folder: Path) -> MeshShape:
        """Read a mesh of the experiment; a unit of the file is `scale` millimetres.

        :param folder: of the experiment, which the path of the file is relative to.
        :raises PlanError: the file cannot be read or holds no surface.
        """
        import trimesh  # takes long to import
        from scipy.spatial import cKDTree

        path = folder / mesh.file.replace("\\", "/")
        shape = files.read_mesh(path, PlanError, "mesh of the obstacle")
        vertices, faces = np.asarray(shape.vertices, dtype=float), np.asarray(shape.faces, dtype=np.int64)
        vertices = vertices * (M_PER_MM * mesh.scale)
        area = float(trimesh.Trimesh(vertices, faces, process=False).area)
        # longest edge: triangles with this edge on the whole area have about the allowed number of vertices
        edge = max(_POINT_SPACING, 2.0 * np.sqrt(area / _MOST_VERTICES))
        split, _ = trimesh.remesh.subdivide_to_size(vertices, faces, edge, max_iter=30)  # type: ignore[no-untyped-call]
        pose = mesh.pose()
        points = np.unique(np.round(split @ pose[:3, :3].T + pose[:3, 3], 6), axis=0)  # vertices of edges coincide
        # the centre of an equilateral triangle is edge/√3 from its corners; no point of a triangle is farther
        return cls(f"mesh {mesh.file}", points, edge / np.sqrt(3.0), cKDTree(points))

    def distance(self, point: Array) -> Array:
        """Return lower bounds (...) of the distances of points (..., 3) from the surface, within `vertex_gap` [m]."""
        gap, _ = self.tree.query(point.reshape(-1, 3))  # type: ignore[attr-defined]
        return np.asarray(gap).reshape(point.shape[:-1]) - self.vertex_gap

    def blocks(self, start: Array, end: Array) -> Bools:
        """Return (...) True if the line from `start` to `end` (..., 3) [m] is closer to the surface than the clearance.

        By sphere tracing: each step along the line is as long as the distance of its point from the surface.
        """
        start, end = (np.ascontiguousarray(side) for side in np.broadcast_arrays(start, end))
        shape = start.shape[:-1]
        start, end = start.reshape(-1, 3), end.reshape(-1, 3)
        length = np.linalg.norm(end - start, axis=-1)
        travel, is_blocked = np.zeros(len(start)), np.zeros(len(start), dtype=bool)
        rows = np.arange(len(start))
        while len(rows):
            # 1e-9 keeps zero out of the denominator
            share = travel[rows] / np.maximum(length[rows], 1e-9)
            distance = self.distance(start[rows] + (end[rows] - start[rows]) * share[:, None])
            is_blocked[rows] = distance < _SIGHT_CLEARANCE
            travel[rows] += distance
            rows = rows[~is_blocked[rows] & (travel[rows] < length[rows])]
        return is_blocked.reshape(shape)


_RADIUS_SHARES = (0.149, 0.085, 0.12, 0.072, 0.055)
"""Radii of column, link 2, elbow, forearm and hand over the reach of the wrist, with motors and hoses: drawings of KUKA
arms of this class, rounded up. `[body] radius_mm` replaces them.
"""


class Rig(Struct, frozen=True, eq=False):
    """The load on the arm.

    :param force: size of the load [N].
    :param largest_tilt: largest angle of the load from straight down [rad].
    :param rope: length that must be free below the load point [m].
    :param weight_radius: radius of the weight at the end of the rope [m]; 0: the weight needs no space.
    """

    force: float
    largest_tilt: float
    rope: float
    weight_radius: float


class Site(Struct, frozen=True, eq=False):
    """Limits on poses that can be measured. Root frame unless stated otherwise.

    :param robot: with masses and compensator.
    :param loaded_chain: nominal chain of the robot with the payload of the experiment.
    :param payload_mass: of the experiment [kg].
    :param arm: geometry of the robot.
    :param rig: with the load.
    :param start: (6,) joint angles at the start [rad].
    :param lower: (6,) joint limits with margin [rad].
    :param upper: (6,) joint limits with margin [rad].
    :param radius: (5,) radii of column, link 2, elbow, forearm, hand [m].
    :param tool_radius: radius of the parts from the flange to load point and markers [m].
    :param clearance: distance to keep from everything [m].
    :param load_point: (3,) in the flange frame [m].
    :param points: (P, 3) markers in the flange frame [m].
    :param names: of the markers.
    :param normals: (P, 3) unit vectors in the flange frame; NaN for a reflector that is turned by hand.
    :param floor: height of the floor [m].
    :param obstacles: boxes and meshes.
    :param tracker: (3,) position [m]; None: unknown, so lines of sight are not checked.
    :param sigma: noise of one coordinate of one reading [m].
    :param acceptance: largest angle between normal and line of sight [rad].
    :param torque_limit: (6,) static limits [N·m]; None: not stated.
    """

    robot: RobotModel
    loaded_chain: Chain
    payload_mass: float
    arm: Arm
    rig: Rig
    start: Array
    lower: Array
    upper: Array
    radius: Array
    tool_radius: float
    clearance: float
    load_point: Array
    points: Array
    names: tuple[str, ...]
    normals: Array
    floor: float
    obstacles: tuple[BoxShape | MeshShape, ...]
    tracker: Array | None
    sigma: float
    acceptance: float
    torque_limit: Array | None


def site_of(robot: RobotModel, experiment: Experiment, folder: Path, start: Array, margin: float) -> Site:
    """Return the site of a robot from an experiment.

    :param start: (6,) joint angles at the start [rad].
    :param folder: of the experiment; meshes are relative to it.
    :param margin: distance to keep from joint limits [rad].
    :raises PlanError: there is no [rig], a normal is zero, a mesh cannot be read, the margin exceeds the joint range.
    """
    rig, tracker, body = experiment.rig, experiment.tracker, experiment.body
    if rig is None:
        raise PlanError(
            "the experiment has no [rig]",
            advice="Give [rig] mass_kg = (weight that loads the arm), and max_angle_deg if a pulley can turn its pull.",
        )
    lower, upper = robot.lower + margin, robot.upper - margin
    if (lower >= upper).any():
        joint = int(np.argmax(lower >= upper)) + 1
        raise PlanError(f"a margin of {margin * DEG_PER_RAD:g}° leaves nothing of the range of A{joint}")
    arm = Arm.of(robot)
    return Site(
        robot=robot,
        loaded_chain=_loaded_chain(robot.nominal, experiment.payload),
        payload_mass=0.0 if experiment.payload is None else experiment.payload.mass_kg,
        arm=arm,
        rig=Rig(
            force=rig.mass_kg * GRAVITY,
            largest_tilt=rig.max_angle_deg * RAD_PER_DEG,
            rope=rig.rope_mm * M_PER_MM,
            weight_radius=rig.weight_radius_mm * M_PER_MM,
        ),
        start=start,
        lower=lower,
        upper=upper,
        radius=_radii(arm) if body.radius_mm is None else np.array(body.radius_mm) * M_PER_MM,
        tool_radius=body.tool_radius_mm * M_PER_MM,
        clearance=body.clearance_mm * M_PER_MM,
        load_point=experiment.load_point.position(),
        points=np.array([point.position() for point in experiment.points.values()]),
        names=tuple(experiment.points),
        normals=_normals(experiment),
        floor=experiment.floor.Z * M_PER_MM,
        obstacles=(
            *(BoxShape.of(box, number) for number, box in enumerate(experiment.boxes, 1)),
            *(MeshShape.of(mesh, folder) for mesh in experiment.meshes),
        ),
        tracker=None if tracker is None else np.array([tracker.X, tracker.Y, tracker.Z]) * M_PER_MM,
        sigma=experiment.sigma,
        acceptance=np.pi if tracker is None else tracker.acceptance_deg * RAD_PER_DEG,
        torque_limit=_torque_limit(robot, rig.max_torque_Nm),
    )


def _radii(arm: Arm) -> Array:
    """Return usual radii (5,) [m] of column, link 2, elbow, forearm and hand, by the reach of the wrist."""
    origin = arm.pose(np.zeros((1, 6))).origin[0]
    reach = float(np.linalg.norm(origin[2] - origin[1]) + np.linalg.norm(origin[4] - origin[2]))
    return np.array(_RADIUS_SHARES) * reach


def _normals(experiment: Experiment) -> Array:
    """Return unit normals (P, 3) of the points in the flange frame; NaN for points without a normal.

    :raises PlanError: a normal is zero.
    """
    normals = np.full((len(experiment.points), 3), np.nan)
    for row, (name, point) in enumerate(experiment.points.items()):
        if point.normal is not None:
            size = float(np.linalg.norm(point.normal))
            if size < _NO_DIRECTION:
                raise PlanError(f"[points.{name}] normal is zero", advice="Give a direction in the flange frame.")
            normals[row] = np.array(point.normal) / size
    return normals


def _loaded_chain(chain: Chain, payload: Payload | None) -> Chain:
    """Return a chain with the payload of an experiment; None: it carries nothing."""
    if payload is None:
        return chain
    return chain.with_payload(payload.mass_kg, np.array([payload.X, payload.Y, payload.Z]) * M_PER_MM)


def _torque_limit(robot: RobotModel, stated_limit: tuple[float, ...] | None) -> Array | None:
    """Return the allowed static torques (6,) [N·m]: the stated limits, else the efforts of the URDF.

    None if no limits are stated and the URDF lacks a positive, finite effort of a joint.
    """
    if stated_limit is not None:
        return np.array(stated_limit)
    effort = robot.nominal.effort
    return effort if np.isfinite(effort).all() and (effort > 0.0).all() else None
