"""Bodies of a cell: links of the arm, cylinders of holder and spindle, obstacles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc import files
from postproc.cell import Cell, HolderTable, ObstacleTable
from postproc.errors import CellError, ModelError
from postproc.frames import M_PER_MM, Array, norm
from postproc.robot import JOINTS, RobotModel
from postproc.robot.chain import Chain

FLANGE = len(JOINTS)
"""Carrier of bodies that are fixed to the flange."""
_CARRIER_GAP = {"arm": 4, "cutter": 3, "tool": 3}
"""Joints between a body and the links it is compared with: nearer links are joined to it or share a wrist."""
_TUBE_RADIUS_SHARES = (0.155, 0.12, 0.128, 0.063, 0.055, 0.03, 0.03)
"""Radii of the capsules along base and links, as shares of the length of the arm (assumed). The capsules and the balls
of `_BALL_SHARES` contain the collision meshes that ROS-Industrial publishes of KR 16-2, KR 120 R2500, KR 150-2,
KR 150 R3100 and IRB 6640, without balancer."""
_BALL_SHARES = ((0.12, 0.15), (0.12, 0.155), None, (0.06, 0.12), None, (0.0, 0.062), None)
"""Distances of balls behind foot, shoulder (A1), elbow (A3) and wrist (A5), where plugs, counterweights and motors are,
and their radii, as shares of the length of the arm (assumed); None: there is no ball."""
_FORK_RADIUS_SHARE, _FORK_LENGTH_SHARE = 0.045, 0.058
"""Radius and length of the forearm's end at the wrist, narrower than its tube: the tool is compared with the forearm,
and would touch a round end as wide as the tube, which no arm has. The ball around the wrist holds the fork."""
_FOREARM_CARRIERS = (2, 3)
"""Carriers (A3, A4) whose link may end at the wrist."""
_ASSUMED_ARM = (
    "the arm is checked as capsules of assumed radius, rather too large, since its model has no meshes: five published "
    "arms are inside of them, other arms and balancers may be thicker"
)
_LEAST_LENGTH = 1e-3
"""Parts of a tube that are shorter than this [m] are left out."""
_SIDE_COUNT = 32
"""Number of sides of round bodies. These are around the circle, so half a percent larger (capsules one percent)."""
ACCURACY = 0.5e-3
"""Error of computed distances [m]."""
Kind = Literal["box", "cylinder", "capsule", "mesh"]
Role = Literal["arm", "cutter", "tool", "obstacle", "part"]
_FIXED_CARRIER = ("obstacle", "part")


class Body(Struct, frozen=True, eq=False):
    """A rigid body.

    :param name: name in messages.
    :param carrier: 0…5: the joint that carries it; 6: the flange; −1: the robot root.
    :param role: arm, cutter, tool (shank, holder, spindle), obstacle or part; the cutter may touch the part.
    :param kind: kind of its shape.
    :param size: box: its edges [m]. Cylinder and capsule: radius and length along z, between the middles of the ends
        [m]. Mesh: empty.
    :param pose: (4, 4) pose of the middle of the shape in the frame of the carrier [m]; of a mesh the unit matrix.
    :param points: (P, 3) corners in the frame of the carrier [m]; of round shapes, those of a mesh around them.
    :param faces: (F, 3) triangles, rows of `points`.
    :param moves_with_base: whether the body moves with `$BASE`.
    """

    name: str
    carrier: int
    role: Role
    kind: Kind
    size: tuple[float, ...]
    pose: Array
    points: Array
    faces: NDArray[np.int64]
    moves_with_base: bool = False

    @property
    def is_fixed(self) -> bool:
        """Whether neither the arm nor an axis that carries it moves the body."""
        return self.role in _FIXED_CARRIER

    def transform(self, motion: Array) -> Body:
        """Return the body moved by a motion (4, 4) in the frame of its carrier [m]."""
        points = self.points @ motion[:3, :3].T + motion[:3, 3]
        return replace(self, pose=motion @ self.pose, points=points)

    @property
    def sphere(self) -> tuple[Array, float]:
        """Centre (3,) and radius of a sphere around the body, in the frame of its carrier [m]."""
        centre = 0.5 * (self.points.min(axis=0) + self.points.max(axis=0))
        return centre, float(norm(self.points - centre).max())


class Scene(Struct, frozen=True, eq=False):
    """The bodies of a cell and the robot that moves them.

    :param robot: the robot.
    :param bodies: bodies of the arm, its tool and the obstacles.
    :param remarks: assumptions on the bodies, one sentence each.
    """

    robot: RobotModel
    bodies: tuple[Body, ...]
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(cls, robot: RobotModel, cell: Cell, tool: Array | None = None, base: Array | None = None) -> Scene:
        """Return the scene of a cell; without [collision] it has no bodies.

        :param tool: (4, 4) `$TOOL` in the flange frame [m]; None: [tool] of the cell.
        :param base: (4, 4) `$BASE` in the robot root [m]; None: [base] of the cell.
        :raises CellError: a mesh cannot be read.
        :raises ModelError: a shape of the arm cannot be read.
        """
        table = cell.collision
        if table is None:
            return cls(robot, ())
        tool = cell.tool.pose() if tool is None else tool
        base = cell.base.pose() if base is None else base
        arm, remarks = _arm_bodies(robot, table.arm)
        folder = Path(cell.folder)
        holder = _flange_bodies(table.holder, tool, cell.tool.axis, folder)
        obstacles = [
            replace(_obstacle_body(table_row, number, base, folder), moves_with_base=table_row.frame == "base")
            for number, table_row in enumerate(table.obstacles, 1)
        ]
        return cls(robot, (*arm, *holder, *obstacles), tuple(remarks))

    def pairs(self) -> Iterator[tuple[int, int]]:
        """Yield the pairs of rows of bodies that are compared; the carrier of the first body is later on the arm.

        Not compared are fixed bodies with each other, the cutter with the part, and links that are joined or share a
        wrist, see `_CARRIER_GAP`.
        """
        for i, first in enumerate(self.bodies):
            for j, second in enumerate(self.bodies):
                if first.is_fixed or (first.role == "cutter" and second.role == "part"):
                    continue
                joint_count = first.carrier - second.carrier  # that move the first body relative to the second
                if joint_count >= (1 if second.is_fixed else _CARRIER_GAP[first.role]):
                    yield i, j


def _arm_bodies(robot: RobotModel, source: str) -> tuple[list[Body], list[str]]:
    """Return the bodies of the arm, from its meshes or as capsules, and remarks on assumptions, one sentence each.

    :param source: `arm` of [collision]: "urdf" for the meshes of the robot model, if it has any, or "capsules".
    :raises ModelError: a mesh is missing.
    """
    if source == "urdf" and robot.geometries:
        shapes, problems = robot.link_shapes(for_drawing=False)
        if problems:
            raise ModelError(
                f"a shape of the arm is missing: {problems[0]}",
                file=robot.urdf,
                advice='Add the file, or give arm = "capsules" in [collision].',
            )
        return [
            _mesh_body(_link_name(shape.carrier), shape.carrier, "arm", shape.points, shape.faces) for shape in shapes
        ], []
    return list(arm_capsules(robot.nominal)), [_ASSUMED_ARM]


def _link_name(carrier: int) -> str:
    """Return the name of a link for messages, by its carrier: the index of its joint, or −1 for the base."""
    return "base of the robot" if carrier < 0 else f"link of {JOINTS[carrier]}"


def arm_capsules(chain: Chain) -> Iterator[Body]:
    """Yield the assumed shape of an arm without meshes, larger rather than smaller than a real one.

    Each link has two capsules: along the axis of its joint, and from there to the next joint. Balls are behind foot,
    shoulder and elbow, and around the wrist. The end of the forearm at the wrist is narrower: a fork.
    """
    ends = [*chain.placement[:, :3, 3], chain.flange[:3, 3]]
    length = float(sum(norm(end[None])[0] for end in ends))
    ahead = _forward_directions(chain)
    for carrier, end in enumerate(ends, -1):
        tube_radius = _TUBE_RADIUS_SHARES[carrier + 1] * length
        axis = np.array([0.0, 0.0, 1.0]) if carrier < 0 else chain.axis[carrier]
        if (ball := _BALL_SHARES[carrier + 1]) is not None:
            offset, ball_radius = ball[0] * length, ball[1] * length
            middle = -offset * ahead.get(carrier, np.zeros(3))
            # a capsule of hardly any length
            yield capsule(
                _link_name(carrier), carrier, "arm", begin=middle, end=middle + _LEAST_LENGTH * axis, radius=ball_radius
            )
        tubes = [(end, tube_radius)]
        if carrier in _FOREARM_CARRIERS:
            # 1e-9 keeps zero out of the denominator
            span = max(float(norm(end[None])[0]), 1e-9)
            tubes = [  # the fork begins behind the middle of the forearm
                (end * max(1.0 - _FORK_LENGTH_SHARE * length / span, 0.5), tube_radius),
                (end, _FORK_RADIUS_SHARE * length),
            ]
        for tube_end, radius in tubes:
            corner = axis * (tube_end @ axis)
            for start, stop in ((np.zeros(3), corner), (corner, tube_end)):
                if float(norm((stop - start)[None])[0]) > _LEAST_LENGTH:
                    yield capsule(_link_name(carrier), carrier, "arm", begin=start, end=stop, radius=radius)


def _forward_directions(chain: Chain) -> dict[int, Array]:
    """Return carrier → unit vector (3,) in the frame of the carrier that points forwards.

    A carrier is the link that a body moves with: −1 is the base, 0 the link behind A1, 2 that behind A3.
    A1 points to A2. The base points in the direction of A1 at zero. A3 points along the axis of A4 to the wrist.
    """
    # `placement` has the frame of each axis in that of the axis before it, `axis` its direction in its own frame
    to_a2 = chain.placement[1, :3, 3]
    to_a2 = _unit(to_a2 - chain.axis[0] * (to_a2 @ chain.axis[0]))
    turn = chain.placement[3, :3, :3]
    # axis of A4, and the wrist (A5), in the frame of A3
    forearm, wrist = turn @ chain.axis[3], chain.placement[3, :3, 3] + turn @ chain.placement[4, :3, 3]
    return {-1: chain.placement[0, :3, :3] @ to_a2, 0: to_a2, 2: _unit(forearm * (forearm @ wrist))}


def _unit(vector: Array) -> Array:
    """Return a vector (3,) with length 1, or zero if it has none."""
    length = float(np.sqrt(vector @ vector))
    return vector / length if length > 0.0 else vector


class Cylinder(Struct, frozen=True):
    """A cylinder of the tool along its axis, from `begin` to `end` above the tip [m]; `cuts`: it is the cutter."""

    name: str
    radius: float
    begin: float
    end: float
    cuts: bool


def cylinders(holder_tables: Sequence[HolderTable]) -> Iterator[Cylinder]:
    """Yield the cylinders of [collision] holder, stacked from the tip upwards; meshes are left out.

    The first of them is the cutter.
    """
    bottom = 0.0  # above the tip
    for number, table in enumerate(holder_tables, 1):
        if table.mesh is None:
            assert table.diameter_mm is not None
            assert table.length_mm is not None
            top = bottom + table.length_mm * M_PER_MM
            is_cutter = number == 1
            name = table.name or ("cutter" if is_cutter else f"holder {number}")
            yield Cylinder(name, radius=0.5 * table.diameter_mm * M_PER_MM, begin=bottom, end=top, cuts=is_cutter)
            bottom = top


def _flange_bodies(holder_tables: Sequence[HolderTable], tool: Array, axis: str, folder: Path) -> Iterator[Body]:
    """Yield the bodies on the flange: cylinders stacked from the tip upwards, and meshes in the flange frame.

    :param holder_tables: cylinders and meshes of [collision] holder, from the tip upwards.
    :param tool: (4, 4) `$TOOL` in the flange frame [m].
    :param axis: axis of the tool frame that points out of the spindle, as ``+Z``.
    """
    sign, letter = axis[0], axis[1]
    up = -(1.0 if sign == "+" else -1.0) * tool[:3, "XYZ".index(letter)]  # from the tip into the spindle
    tip = tool[:3, 3]
    for tool_cylinder in cylinders(holder_tables):
        role: Role = "cutter" if tool_cylinder.cuts else "tool"
        begin, end = (tip + up * height for height in (tool_cylinder.begin, tool_cylinder.end))
        yield cylinder(tool_cylinder.name, FLANGE, role, begin=begin, end=end, radius=tool_cylinder.radius)
    for number, table in enumerate(holder_tables, 1):
        if table.mesh is not None:
            points, faces = _mesh_of_file(table.mesh, folder)
            yield _mesh_body(table.name or f"holder {number}", FLANGE, "tool", points, faces)


def _obstacle_body(table: ObstacleTable, number: int, base: Array, folder: Path) -> Body:
    """Return an obstacle of the cell as a body at the root.

    :param number: number of the obstacle, for its name if the table states none.
    :param base: (4, 4) `$BASE` in the root [m], to which the table may refer.
    :raises CellError: its mesh cannot be read.
    """
    frame = np.eye(4) if table.frame == "root" else base
    role: Role = "part" if table.part else "obstacle"
    name = table.name or (f"obstacle {number}" if table.mesh is None else Path(table.mesh).name)
    if table.mesh is not None:
        points, faces = _mesh_of_file(table.mesh, folder)
        return _mesh_body(name, -1, role, points @ frame[:3, :3].T + frame[:3, 3], faces)
    assert table.box is not None
    spans = np.array([table.box.X, table.box.Y, table.box.Z]) * M_PER_MM
    pose = frame.copy()
    pose[:3, 3] += frame[:3, :3] @ spans.mean(axis=1)
    return box(name, -1, role, pose, spans[:, 1] - spans[:, 0])


def _mesh_of_file(name: str, folder: Path) -> tuple[Array, NDArray[np.int64]]:
    """Return the vertices (v, 3) [m] and triangles (f, 3), as rows of vertices, of a mesh file in millimetres.

    :raises CellError: the file is missing or no mesh.
    """
    mesh = files.read_mesh(folder / name, CellError, "mesh of [collision]")
    return np.asarray(mesh.vertices) * M_PER_MM, np.asarray(mesh.faces, dtype=np.int64)


def _mesh_body(name: str, carrier: int, role: Role, points: Array, faces: NDArray[np.int64]) -> Body:
    """Return a body with the surface of a mesh: vertices (v, 3) [m] in the frame of its carrier, triangles (f, 3)."""
    return Body(name, carrier, role, "mesh", (), np.eye(4), points, faces)


def box(name: str, carrier: int, role: Role, pose: Array, edges: Array) -> Body:
    """Return a box with its middle at `pose` (4, 4) and edges (3,) [m]."""
    from trimesh import creation

    mesh = creation.box(extents=edges, transform=pose)
    return _body(name, carrier, role, mesh, kind="box", size=tuple(edges.tolist()), pose=pose)


def cylinder(name: str, carrier: int, role: Role, begin: Array, end: Array, radius: float) -> Body:
    """Return a cylinder between two points (3,) [m]."""
    from trimesh import creation

    pose, length = _line_pose(begin, end)
    # made with a radius near 1 and then scaled: trimesh leaves out triangles of a tenth of a millimetre
    mesh = creation.cylinder(radius=1.0 / np.cos(np.pi / _SIDE_COUNT), height=length / radius, sections=_SIDE_COUNT)
    mesh.apply_scale(radius)
    return _body(name, carrier, role, mesh.apply_transform(pose), kind="cylinder", size=(radius, length), pose=pose)


def inscribed_capsule(cutter: Body) -> Body:
    """Return a capsule inside of a cutter whose end has an unknown shape: its radius is smaller by `ACCURACY`.

    Its role is "tool", so that it is compared with the part, too.
    """
    radius, length = cutter.size
    half = max(0.5 * length - radius, _LEAST_SIZE)
    begin, end = (cutter.pose[:3, 3] + sign * half * cutter.pose[:3, 2] for sign in (-1.0, 1.0))
    inner_radius = max(min(radius, 0.5 * length) - ACCURACY, _LEAST_SIZE)
    return capsule(cutter.name, cutter.carrier, "tool", begin=begin, end=end, radius=inner_radius)


_LEAST_SIZE = 1e-4
"""Smallest radius and half length of the capsule in a cutter [m]."""


def capsule(name: str, carrier: int, role: Role, begin: Array, end: Array, radius: float) -> Body:
    """Return a body of all points within `radius` of the line between two points (3,) [m]."""
    from trimesh import creation

    pose, length = _line_pose(begin, end)
    # radius near 1 of the mesh around the capsule, which is then scaled, as that of a cylinder
    outer_radius = 1.0 / np.cos(np.pi / _SIDE_COUNT) ** 2
    mesh = creation.capsule(height=length / radius, radius=outer_radius, count=[_SIDE_COUNT, _SIDE_COUNT])
    mesh.apply_scale(radius)  # type: ignore[no-untyped-call]
    mesh.apply_translation(-mesh.bounds.mean(axis=0))  # versions of trimesh differ in where they put the origin
    return _body(name, carrier, role, mesh.apply_transform(pose), kind="capsule", size=(radius, length), pose=pose)


def _line_pose(begin: Array, end: Array) -> tuple[Array, float]:
    """Return the pose (4, 4) of the middle of a line with z along it, and the length of the line [m]."""
    line = end - begin
    length = float(np.sqrt(line @ line))
    z = line / length
    # x is square to z and to the coordinate axis that is farthest from z
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.sqrt(x @ x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    pose[:3, 3] = 0.5 * (begin + end)
    return pose, length


def _body(name: str, carrier: int, role: Role, mesh: Any, *, kind: Kind, size: tuple[float, ...], pose: Array) -> Body:
    """Return a body with the corners and triangles of a `trimesh.Trimesh` in the frame of its carrier [m].

    The other parameters are fields of `Body`.
    """
    return Body(
        name=name,
        carrier=carrier,
        role=role,
        kind=kind,
        size=size,
        pose=pose,
        points=np.asarray(mesh.vertices),
        faces=np.asarray(mesh.faces, dtype=np.int64),
    )
