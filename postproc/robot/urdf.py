"""Strict reader of a URDF that holds a six-axis arm: revolute joints in series, the flange fixed to the last.

Fixed joints may be anywhere; what they carry belongs to the previous link. `geometries` lists the shapes. Anything
else is refused. In a robot.urdf of ours the joints are called A1…A6 and the flange `flange`; `read_any` takes other
names. Source: the URDF specification (wiki.ros.org/urdf/XML); rpy is R = Rz(yaw)·Ry(pitch)·Rx(roll).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from xml.etree import ElementTree as ET

import numpy as np
from msgspec import Struct

from postproc.errors import ModelError
from postproc.frames import Array, rotation_from_angles
from postproc.robot.chain import Chain
from postproc.robot.model_file import FLANGE, JOINTS

_LARGEST = 1e9
"""A number beyond this is a mistake, whatever its unit (assumed)."""


_SIZES = {"box": (("size", 3),), "cylinder": (("radius", 1), ("length", 1)), "sphere": (("radius", 1),)}
"""Attributes of the primitives, with their number of values."""
_SHORTEST_AXIS = 1e-6
"""A direction shorter than this is none: the specification asks for unit vectors."""
_RIGHT_ANGLE_TOLERANCE = 1e-4
"""In files of others, angles this close to a right angle [rad] are right ones: many are written with four decimals."""


def read(text: str, file: str) -> Chain:
    """Return the arm of a URDF with postproc's names: joints A1…A6 and the link `flange`.

    :param file: name of the file, for messages.
    :raises ModelError: it is no such URDF, or a number is missing, no number or not finite; the message names the
        joint.
    """
    try:
        return _Reader(text, 0.0).chain()
    except _RefusedError as cause:
        raise ModelError(cause.problem, file=file, advice=cause.advice) from None


class AnyArm(Struct, frozen=True, eq=False):
    """A six-axis arm with the names and frames of any URDF.

    :param name: of the robot.
    :param chain: joints in series; its `flange` is the frame of the link that the last joint moves.
    :param frames: link → index of the joint that carries it (−1: the base, no joint) and pose (4, 4) of the link in the
        frame of this joint [m].
    """

    name: str
    chain: Chain
    frames: Mapping[str, tuple[int, Array]]


def read_any(text: str, file: str) -> AnyArm:
    """Return the arm of a URDF with any names.

    :param file: name of the file, for messages.
    :raises ModelError: it is no chain of six revolute joints, or a number is missing, no number or not finite.
    """
    try:
        return _Reader(text, _RIGHT_ANGLE_TOLERANCE).any_arm()
    except _RefusedError as cause:
        raise ModelError(cause.problem, file=file, advice=cause.advice) from None


class Geometry(Struct, frozen=True, eq=False):
    """A shape that a URDF names.

    :param carrier: 0…5: the joint that carries the shape; −1: the base.
    :param pose: (4, 4) in the frame of this joint, for the base in the frame of the first link [m].
    :param drawn: whether the shape is a <visual>; else it is a <collision>.
    :param kind: mesh, box, cylinder, sphere, or another tag of the file.
    :param size: box: three edges; cylinder: radius and length; sphere: radius [m]; else empty.
    :param file: name of the mesh as written; empty for other kinds.
    :param scale: (3,) of the mesh along its axes.
    """

    carrier: int
    pose: Array
    drawn: bool
    kind: str
    size: tuple[float, ...]
    file: str
    scale: Array


def geometries(text: str, file: str) -> tuple[Geometry, ...]:
    """Return the shapes of the links of an arm in a URDF with any names.

    :param file: name of the file, for messages.
    :raises ModelError: the URDF cannot be read, see `read_any`.
    """
    try:
        return tuple(_Reader(text, _RIGHT_ANGLE_TOLERANCE).geometries())
    except _RefusedError as cause:
        raise ModelError(cause.problem, file=file, advice=cause.advice) from None


class _RefusedError(Exception):
    """The file is no URDF of a six-axis arm: problem and advice of the `ModelError` that names the file."""

    def __init__(self, problem: str, advice: str | None = None) -> None:
        super().__init__(problem)
        self.problem, self.advice = problem, advice


_NO_TREE = _RefusedError("the links are not one tree", "Each link but the first must hang on one joint.")
"""Refusal of links that are not one tree."""


class _Reader:
    """Reader that walks from link to link and collects the joints and the links that each joint carries.

    :ivar right_angle_tolerance: largest difference from a right angle [rad] that is rounded off.
    :ivar name: of the robot.
    :ivar links: name → element.
    :ivar child_joints: link → the joints on it.
    :ivar joints: the revolute joints in series.
    :ivar placement: (4, 4) of the frame of each revolute joint in the frame of the joint before it [m].
    :ivar moments: mass [kg] that each revolute joint carries, and this mass times its centre (3,) [kg·m].
    :ivar frames: see `AnyArm.frames`.
    """

    def __init__(self, text: str, right_angle_tolerance: float) -> None:
        """Read a URDF.

        :raises _RefusedError: it is no URDF, its links are not one tree, or its joints are not revolute and in series.
        """
        self.right_angle_tolerance = right_angle_tolerance
        robot = _root_element(text)
        self.name = robot.get("name", "")
        self.links = {_attribute(link, "name"): link for link in robot.findall("link")}
        joints = {_attribute(joint, "name"): joint for joint in robot.findall("joint")}
        if len(self.links) < len(robot.findall("link")) or len(joints) < len(robot.findall("joint")):
            raise _RefusedError("two links or two joints have the same name")
        self.child_joints: dict[str, list[ET.Element]] = {name: [] for name in self.links}
        children = []
        for joint in joints.values():
            parent, child = (_attribute(_element(joint, end), "link") for end in ("parent", "child"))
            for link in (parent, child):
                if link not in self.links:
                    raise _RefusedError(f"joint {joint.get('name')} names link {link!r}, which the file does not have")
            self.child_joints[parent].append(joint)
            children.append(child)
        roots = set(self.links) - set(children)
        if len(roots) != 1 or len(children) != len(set(children)):
            raise _NO_TREE
        self.joints: list[ET.Element] = []
        self.placement: list[Array] = []
        self.moments: list[tuple[float, Array]] = []
        self.frames: dict[str, tuple[int, Array]] = {}
        self._visit(roots.pop(), np.eye(4), -1)
        if len(self.frames) < len(self.links):  # links in a ring that is not connected to the tree
            raise _NO_TREE

    def chain(self) -> Chain:
        """Return the chain of a file that postproc wrote.

        :raises _RefusedError: the joints are not A1 to A6, or the last link is not the flange.
        """
        names = tuple(str(joint.get("name")) for joint in self.joints)
        if names != JOINTS:
            raise _RefusedError(
                f"joints are {', '.join(names) or 'none'}",
                f"The robot must be a chain of six revolute joints named {', '.join(JOINTS)}.",
            )
        carrier, flange = self.frames.get(FLANGE, (-1, np.eye(4)))
        if carrier != len(JOINTS) - 1:
            raise _RefusedError(f"no link named {FLANGE!r} on A6", "The last frame must be `flange`, fixed to A6.")
        return self._chain(flange)

    def any_arm(self) -> AnyArm:
        """Return the arm with any names of its joints.

        :raises _RefusedError: it does not have six revolute joints.
        """
        if len(self.joints) != len(JOINTS):
            names = ", ".join(str(joint.get("name")) for joint in self.joints) or "none"
            raise _RefusedError(
                f"{len(self.joints)} revolute joints in series ({names})", "The robot must be an arm with six axes."
            )
        return AnyArm(self.name, self._chain(np.eye(4)), self.frames)

    def geometries(self) -> Iterator[Geometry]:
        """Yield the shapes of all links, for each link <visual> before <collision>.

        :raises _RefusedError: a size or scale is missing, no number or not finite.
        """
        for link, (carrier, pose) in self.frames.items():
            for tag in ("visual", "collision"):
                for shape in self.links[link].findall(tag):
                    for element in _element(shape, "geometry"):
                        yield Geometry(
                            carrier=carrier,
                            pose=pose @ self._origin(shape),
                            drawn=tag == "visual",
                            kind=element.tag,
                            size=_size(element),
                            file=element.get("filename", ""),
                            scale=_numbers(element, "scale", 3, "1 1 1"),
                        )

    def _chain(self, flange: Array) -> Chain:
        """Return the chain that was read, up to `flange` (4, 4) in the last link [m]."""
        mass = np.array([mass for mass, _ in self.moments])
        moment = np.array([moment for _, moment in self.moments])
        limits = np.array([_limits(joint) for joint in self.joints]).T
        return Chain(
            placement=np.array(self.placement),
            axis=np.array([_axis(joint) for joint in self.joints]),
            is_revolute=np.ones(len(self.joints), dtype=np.bool_),
            flange=flange,
            mass=mass,
            centre=np.divide(moment, mass[:, None], out=np.zeros_like(moment), where=mass[:, None] > 0.0),
            lower=limits[0],
            upper=limits[1],
            speed=limits[2],
            effort=limits[3],
        )

    def _visit(self, link: str, pose: Array, carrier: int) -> None:
        """Add a link, and recursively the links on it, to `frames`, `joints`, `placement` and `moments`.

        :param pose: (4, 4) of the link in the frame of its carrier [m].
        :param carrier: 0…5: the joint that carries the link; −1: no joint, the link is fixed to the root.
        :raises _RefusedError: a mass is negative, a joint is neither fixed nor revolute, or joints are parallel.
        """
        if carrier >= 0:
            self._add_mass(link, pose, carrier)
        self.frames[link] = carrier, pose
        for joint in self.child_joints[link]:
            name, kind = joint.get("name"), joint.get("type")
            child, place = _attribute(_element(joint, "child"), "link"), pose @ self._origin(joint)
            if kind == "fixed":
                self._visit(child, place, carrier)
                continue
            if kind != "revolute" or joint.find("mimic") is not None:
                raise _RefusedError(
                    f"joint {name} is {kind if kind != 'revolute' else 'a mimic of another'}",
                    "Only six revolute joints and fixed ones are possible.",
                )
            if carrier != len(self.joints) - 1:  # a joint after the carrier exists already: two joints on one link
                raise _RefusedError(
                    f"joint {name} is parallel to {self.joints[carrier + 1].get('name')}, not in series with it"
                )
            self.joints.append(joint)
            self.placement.append(place)
            self.moments.append((0.0, np.zeros(3)))
            self._visit(child, np.eye(4), len(self.joints) - 1)

    def _add_mass(self, link: str, pose: Array, carrier: int) -> None:
        """Add the mass of a link, if it states one, to `moments` of the joint that carries it.

        :param pose: (4, 4) of the link in the frame of its carrier [m].
        :param carrier: 0…5: the joint that carries the link.
        :raises _RefusedError: the mass is negative, or not stated as numbers.
        """
        inertial = self.links[link].find("inertial")
        if inertial is None:
            return
        mass = _numbers(_element(inertial, "mass"), "value", 1)[0]
        if mass < 0.0:
            raise _RefusedError(f"link {link} has a negative mass")
        mass_sum, moment = self.moments[carrier]
        self.moments[carrier] = mass_sum + mass, moment + mass * (pose @ self._origin(inertial))[:3, 3]

    def _origin(self, parent: ET.Element) -> Array:
        """Return the pose (4, 4) [m] that the <origin> of an element states; the identity without <origin>.

        Angles within `right_angle_tolerance` of a multiple of a right angle are rounded to it.

        :raises _RefusedError: a number is missing, no number or not finite.
        """
        pose, origin = np.eye(4), parent.find("origin")
        if origin is not None:
            angles = _numbers(origin, "rpy", 3, "0 0 0")[::-1]  # yaw, pitch, roll
            right_angles = np.round(angles / (np.pi / 2.0)) * (np.pi / 2.0)
            is_right = np.abs(angles - right_angles) < self.right_angle_tolerance
            pose[:3, :3] = rotation_from_angles(np.where(is_right, right_angles, angles))
            pose[:3, 3] = _numbers(origin, "xyz", 3, "0 0 0")
        return pose


def _root_element(text: str) -> ET.Element:
    """Return the element <robot> of a URDF.

    :raises _RefusedError: the text is no XML, or its outermost element is not <robot>.
    """
    try:
        robot = ET.fromstring(text)
    except ET.ParseError as cause:
        raise _RefusedError(f"not a URDF: {cause}", "The file must be XML with one <robot>.") from None
    if robot.tag != "robot":
        raise _RefusedError(f"not a URDF: its outermost element is <{robot.tag}>, not <robot>")
    return robot


def _attribute(element: ET.Element, name: str) -> str:
    """Return an attribute of an XML element.

    :raises _RefusedError: the element does not have it.
    """
    value = element.get(name)
    if value is None:
        raise _RefusedError(f"a <{element.tag}> has no {name}")
    return value


def _element(parent: ET.Element, tag: str) -> ET.Element:
    """Return the first child of an XML element with a tag.

    :raises _RefusedError: there is no such child.
    """
    element = parent.find(tag)
    if element is None:
        raise _RefusedError(f"{parent.tag} {parent.get('name', '')} has no <{tag}>".replace("  ", " "))
    return element


def _numbers(element: ET.Element, name: str, count: int, default: str | None = None) -> Array:
    """Return the numbers (count,) of an attribute.

    :param default: text in place of a missing attribute; None: the attribute must exist.
    :raises _RefusedError: the attribute is missing, or is not this many finite numbers of plausible size.
    """
    text = element.get(name, default) if default is not None else _attribute(element, name)
    try:
        values = np.array([float(word) for word in str(text).split()])
    except ValueError:
        values = np.zeros(0)  # refused by its length below
    if len(values) != count:
        raise _RefusedError(f'<{element.tag} {name}="{text}">: {count} number{"s" * (count > 1)} expected')
    if not (np.abs(values) <= _LARGEST).all():
        raise _RefusedError(f'<{element.tag} {name}="{text[:80]}">: a number is not finite, or beyond {_LARGEST:g}')
    return values


def _size(element: ET.Element) -> tuple[float, ...]:
    """Return the sizes of a primitive [m], see `Geometry.size`; empty for a mesh or an unknown tag.

    :raises _RefusedError: a size is missing, no number or not finite.
    """
    sizes: list[float] = []
    for name, count in _SIZES.get(element.tag, ()):
        sizes += _numbers(element, name, count).tolist()
    return tuple(sizes)


def _axis(joint: ET.Element) -> Array:
    """Return the unit axis (3,) of a joint; X without an <axis>.

    :raises _RefusedError: the axis has no length.
    """
    element = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if element is None else _numbers(element, "xyz", 3)
    length = float(np.sqrt(axis @ axis))
    if length < _SHORTEST_AXIS:
        raise _RefusedError(f"joint {joint.get('name')} has no axis")
    return np.asarray(axis / length)


def _limits(joint: ET.Element) -> Array:
    """Return the limits (4,) of a joint: lower, upper [rad, m], velocity [rad/s, m/s] and effort [N·m, N].

    The effort is 0 if the file states none.

    :raises _RefusedError: limits are missing, the lower is not below the upper, or the velocity is not positive.
    """
    limit = joint.find("limit")
    problem = f"limits of joint {joint.get('name')} are missing or impossible"
    advice = "Every joint needs <limit lower upper velocity> in radians, lower < upper, velocity > 0."
    if limit is None:
        raise _RefusedError(problem, advice)
    values = np.array([_numbers(limit, name, 1, "0")[0] for name in ("lower", "upper", "velocity", "effort")])
    if not (values[0] < values[1] and values[2] > 0.0):
        raise _RefusedError(problem, advice)
    return values
