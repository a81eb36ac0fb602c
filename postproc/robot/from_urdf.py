"""Make a model folder from the URDF of a KUKA arm as the packages of ROS-Industrial contain it.

Names, signs and zero positions of the joints are free (``joint_1``, ``joint_a1``, about ±Z …), and so is the place of a
joint's frame on its axis: only the axes count. The result has joints A1…A6 with KUKA's signs and zero positions, frames
parallel to the root at A1…A6 = 0, and KUKA's `flange`. Source of the names: ROS-Industrial, "Create a URDF for an
industrial robot": `base` is the controller's root frame, `tool0` its flange.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.decimals import without_negative_zero
from postproc.errors import ModelError
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array, rotation_from_vector
from postproc.robot import urdf
from postproc.robot.chain import Chain
from postproc.robot.folder import load, shipped_models
from postproc.robot.model_file import FLANGE, JOINTS, JointSpring, Masses, ModelFile, SourcedEntry
from postproc.robot.parameters import PER_URAD
from postproc.robot.rating import rated_payload
from postproc.robot.urdf import AnyArm

_AXES = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=float)
"""Axes of A1…A6 at zero, root frame: KUKA's signs."""
_FLANGE_AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""The flange at zero: {A 0, B 90, C 0}."""
_TOLERANCE = 1e-3
"""Angles [rad] and lengths [m] by which the arm may miss KUKA's zero position."""
_PERPENDICULAR = 1e-9
"""Added to the cosine of an axis before its sign is taken: an axis that is perpendicular, to rounding, is not turned
round."""
_LENGTH_DIGITS = 7
"""Decimals of lengths [m]; further ones are rounding of the file."""
_CENTRE_DIGITS = 4
"""Decimals of centres of mass [m]: they are known to no tenth of a millimetre."""
_REFERENCE = "kuka_kr270"
_REFERENCE_PAYLOAD = 270.0
"""Payload [kg] of the reference, in its name."""
_SCALED_SIGMA = 40.0
"""Standard deviation [%] of a compliance scaled from another arm: published values of one class of arms differ by 20 to
50 %."""
_LIGHTEST = 0.01
"""A link below this [kg] has no mass: some files need a number larger than zero there (assumed)."""
_MASS_BY_LOAD = (12.0, 0.69)
"""Mass of the links [kg] is about 12·(payload [kg] · reach [m])^0.69: fitted to the ten arms that are shipped (KR 6 to
KR 500), which lie within a factor of 1.75 of it."""
_MASS_BY_REACH = 46.0
"""Without a known payload: about 46·reach³ [kg, m], the same arms within a factor of 1.7."""
_IMPLAUSIBLE = 2.0
"""Link masses that differ from these by more than this factor are not believed (assumed)."""


class AdoptedModel(Struct, frozen=True, eq=False):
    """The model of an arm from a URDF.

    :param chain: nominal geometry, KUKA's signs.
    :param content: of `model.toml`.
    :param notes: for the user.
    :param moved: (7, 4, 4) frames of the base and of the joints in the file, each in the frame of the model that
        replaces it [m].
    """

    chain: Chain
    content: ModelFile
    notes: tuple[str, ...]
    moved: Array

    def urdf(self, shapes: Mapping[tuple[int, str], str] | None = None) -> bytes:
        """Return the content of `robot.urdf`.

        :param shapes: (carrier, "visual" or "collision") → name of the mesh, see `shapes.LinkShape`; None: no meshes.
        """
        return _model_text(self.chain, self.content.name, shapes or {})


_REACHES = 0.1, 20.0
"""Reach [m] of arms with six axes: the longest that are built have about 5 m."""


def adopt(text: str, file: str, name: str | None = None) -> AdoptedModel:
    """Return the model of an arm in a URDF.

    :param text: content of the URDF.
    :param file: name of the URDF, for messages and as the source of its values.
    :param name: title of the robot; None: the name in the URDF.
    :raises ModelError: the URDF has no six-axis arm, or no pose of the arm is KUKA's zero position.
    """
    if "<xacro:" in text:
        raise ModelError("a xacro, not a URDF", file=file, advice=f"Expand it first: xacro {file} > robot.urdf")
    arm = urdf.read_any(text, file)
    chain, old_frames, notes = _to_kuka_form(arm, file)
    if not _REACHES[0] < (reach := _reach(chain)) < _REACHES[1]:
        raise ModelError(f"the wrist reaches {reach:.3g} m", file=file, advice="Lengths of a URDF are in metres.")
    title = name or arm.name or "robot"
    payload = rated_payload(arm.name, title, file)
    compliance, basis = _compliances(chain, payload)
    masses, mass_notes = _masses(chain, payload, file)
    notes += mass_notes
    notes.append(f"compliances are ASSUMED, {basis}: identify them (postproc identify), or replace them in model.toml")
    notes.append("a gravity compensator, if the arm has one, is not in the model")
    springs = [
        JointSpring(
            source=f"no published value: {basis}",
            assumed=True,
            scaled_from=_REFERENCE,
            compliance_urad_per_Nm=value,
            sigma_percent=_SCALED_SIGMA,
        )
        for value in compliance
    ]
    content = ModelFile(
        name=title,
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        language="krl",
        joints=dict(zip(JOINTS, springs, strict=True)),
        masses=masses,
        geometry_nominal=SourcedEntry(source=f"{file}, reach of the wrist {_reach(chain) * MM_PER_M:.0f} mm"),
    )
    return AdoptedModel(chain, content, tuple(notes), old_frames)


class _KukaForm(NamedTuple):
    """An arm in KUKA's conventions.

    :param chain: with KUKA's signs and zero positions.
    :param old_frames: (7, 4, 4), see `AdoptedModel.moved` [m].
    :param notes: on changed signs and zero positions, and on the turn of tool0 against KUKA's flange.
    """

    chain: Chain
    old_frames: Array
    notes: list[str]


def _to_kuka_form(arm: AnyArm, file: str) -> _KukaForm:
    """Return an arm with KUKA's signs and zero positions.

    :param file: name of the URDF, for messages.
    :raises ModelError: the flange is missing, a link is not unique, or no pose of the arm is KUKA's zero position.
    """
    first_link = np.linalg.inv(_pose_of_base(arm, file))
    placement = arm.chain.placement.copy()
    placement[0] = first_link @ placement[0]
    source, zero = _count_from_kuka_zero(replace(arm.chain, placement=placement, flange=_pose_of_flange(arm, file)))
    frames, flange = (array[0] for array in source.joint_frames(np.zeros((1, len(JOINTS)))))
    axis = np.einsum("jab,jb->ja", frames[:, :3, :3], source.axis)  # root axes, as all vectors from here on
    sign = np.sign(np.einsum("ja,ja->j", axis, _AXES))
    _check_zero(axis, frames[:, :3, 3], flange, file)
    origin = np.round(_origins(frames[:, :3, 3], flange[:3, 3]), _LENGTH_DIGITS)
    centre = np.einsum("jab,jb->ja", frames[:, :3, :3], source.centre) + frames[:, :3, 3] - origin
    placement = np.tile(np.eye(4), (len(JOINTS), 1, 1))
    placement[:, :3, 3] = np.round(np.diff(origin, axis=0, prepend=0.0), _LENGTH_DIGITS)
    old_frames = np.concatenate([first_link[None], frames])
    old_frames[1:, :3, 3] -= origin
    tip = np.eye(4)
    tip[:3, :3], tip[:3, 3] = _FLANGE_AXES, np.round(flange[:3, 3] - origin[-1], _LENGTH_DIGITS)
    chain = replace(
        source,
        placement=placement,
        axis=_AXES,
        flange=tip,
        centre=np.where(source.mass[:, None] < _LIGHTEST, 0.0, np.round(centre, _CENTRE_DIGITS)),
        mass=np.where(source.mass < _LIGHTEST, 0.0, source.mass),
        lower=np.where(sign > 0, source.lower, -source.upper),
        upper=np.where(sign > 0, source.upper, -source.lower),
    )
    return _KukaForm(chain, old_frames, _change_notes(sign, zero, flange))


def _change_notes(sign: Array, zero: Array, flange: Array) -> list[str]:
    """Return a sentence for each convention in which a URDF differs from KUKA's.

    :param sign: (6,) −1 for joints that turn the other way.
    :param zero: (6,) angles of KUKA's zero position as the URDF counts them [rad].
    :param flange: (4, 4) of the URDF in the root at KUKA's zero position.
    """
    notes = []
    reversed_joints = ", ".join(name for name, direction in zip(JOINTS, sign, strict=True) if direction < 0)
    if reversed_joints:
        notes.append(f"joints turn the other way than KUKA's, signs and limits are changed: {reversed_joints}")
    if zero.any():
        offsets = ", ".join(
            f"{name} {-angle * DEG_PER_RAD:.4g}°" for name, angle in zip(JOINTS, zero * sign, strict=True) if angle
        )
        notes.append(f"the URDF's zero position is not KUKA's, but {offsets} there: angles and limits are changed")
    angle = np.arctan2(flange[:3, 0] @ _FLANGE_AXES[:, 1], flange[:3, 0] @ _FLANGE_AXES[:, 0])
    if abs(angle) > _TOLERANCE:
        turn = f"by {angle * DEG_PER_RAD:.4g}°: $TOOL is in KUKA's flange frame, {{A 0, B 90, C 0}} at zero"
        notes.append(f"tool0 is turned about its axis against KUKA's flange {turn}")
    return notes


def _count_from_kuka_zero(arm: Chain) -> tuple[Chain, Array]:
    """Return the arm with its joints counted from KUKA's zero position, and the angles (6,) [rad] of this position.

    The angles count as in `arm`. Joint after joint, A1 to A5 are turned until a direction on the arm points to its goal
    (`_zero_goal`). A6 is not turned: the flange may be turned about its axis. Angles below `_TOLERANCE` count as zero.
    """
    zero = np.zeros(len(JOINTS))
    for joint in range(len(JOINTS) - 1):
        frames, flange = (array[0] for array in arm.joint_frames(zero[None]))
        axes = np.einsum("jab,jb->ja", frames[:, :3, :3], arm.axis)
        goal, direction = _zero_goal(joint, axes, frames[:, :3, 3], flange)
        # angle about the axis, which is perpendicular to the goal: what of the direction is along it does not count
        angle = float(np.arctan2(axes[joint] @ np.cross(direction, goal), direction @ goal))
        zero[joint] = angle if abs(angle) > _TOLERANCE else 0.0
    placement = arm.placement.copy()
    placement[:, :3, :3] = placement[:, :3, :3] @ rotation_from_vector(zero[:, None] * arm.axis)
    return replace(arm, placement=placement, lower=arm.lower - zero, upper=arm.upper - zero), zero


def _zero_goal(joint: int, axes: Array, points: Array, flange: Array) -> tuple[Array, Array]:
    """Return the goal (3,) at KUKA's zero position and the direction (3,) on the arm that a joint must turn to it.

    With all joints at zero a KUKA arm is stretched out along +X: the upper arm and the axes of A4 and A6 along X, the
    axis of A5 along Y. A1 has two cases: A2 is off the axis of A1, and must be ahead along X; or it is on the axis,
    and the axis of A2 must be along Y.

    :param joint: 0…4: A1…A5; the joints before it are at zero already.
    :param axes: (6, 3) of the joints, root frame, and `points` (6, 3) on these axes [m].
    :param flange: (4, 4) in the root, its Z outward.
    """
    x, y = np.eye(3)[:2]
    if joint == 0:  # the upper arm may point anywhere: the front is where the axis of A2 is
        normal = np.cross(axes[0], axes[1])
        offset = (points[1] - points[0]) @ normal
        return (x, normal * offset) if abs(offset) > _TOLERANCE else (y, _towards(axes[1], y))
    if joint == 1:
        return x, points[2] - points[1]
    if joint == 2:
        return x, _towards(axes[3], points[4] - points[2])
    if joint == 3:
        return y, _towards(axes[4], y)
    return x, flange[:3, 2]


def _towards(axis: Array, direction: Array) -> Array:
    """Return an axis (3,), reversed if it points away from a direction (3,)."""
    return np.asarray(axis * np.sign(axis @ direction + _PERPENDICULAR))


def _pose_of_base(arm: AnyArm, file: str) -> Array:
    """Return the controller's root frame (4, 4) in the first link [m]: `base`, else `base_link`, else the first link.

    :raises ModelError: the names of several links end in one of these names.
    """
    for name in ("base", "base_link"):
        pose = _frame(arm, name, -1, file)
        if pose is not None:
            return pose
    return np.eye(4)


def _pose_of_flange(arm: AnyArm, file: str) -> Array:
    """Return a flange (4, 4) with its Z outward in the frame of the last joint [m]: `tool0`, else `flange`.

    Z of `tool0` points out. Of `flange` X points out, or, as in the models of this package, Z: the axis of A6 decides.

    :raises ModelError: neither is on the last link, or the names of several links end in one of these names.
    """
    kuka_axes = np.eye(4)
    kuka_axes[:3, :3] = _FLANGE_AXES
    for name, turn in (("tool0", np.eye(4)), (FLANGE, kuka_axes)):
        pose = _frame(arm, name, len(JOINTS) - 1, file)
        if pose is not None:
            is_z_outward = name == FLANGE and abs(pose[:3, 2] @ arm.chain.axis[-1]) > 1.0 - _TOLERANCE**2
            return pose if is_z_outward else pose @ turn
    raise ModelError(
        "no link named tool0 or flange behind the last joint", file=file, advice="It says where the flange is: add it."
    )


def _frame(arm: AnyArm, link: str, carrier: int, file: str) -> Array | None:
    """Return the pose (4, 4) [m] of a link that a joint carries, by its name or by the end of its name.

    A link with exactly this name comes first. None if the joint carries no such link.

    :param link: name, or end of the name after "_" or "/".
    :param carrier: 0…5: the joint, in whose frame the pose is; −1: the base.
    :raises ModelError: the names of several links end in the name.
    """
    poses = {name: pose for name, (joint, pose) in arm.frames.items() if joint == carrier}
    names = [name for name in poses if name == link] or [
        name for name in poses if name.endswith((f"_{link}", f"/{link}"))
    ]
    if len(names) > 1:
        raise ModelError(
            f"several links could be {link}: {', '.join(names)}", file=file, advice=f"Call the right one {link}."
        )
    return poses[names[0]] if names else None


def _check_zero(axis: Array, origin: Array, flange: Array, file: str) -> None:
    """Check that an arm, stretched out as well as its joints can, is in KUKA's zero position.

    :param axis: (6, 3) unit axes of the joints, root frame, and `origin` (6, 3) points on these axes [m].
    :param flange: (4, 4) in the root [m], its Z outward.
    :raises ModelError: an axis is not parallel to the axis of a KUKA arm, or arm or flange do not point along +X.
    """
    misalignment = 1.0 - np.abs(np.einsum("ja,ja->j", axis, _AXES))
    advice = (
        "With all joints at zero a KUKA arm is stretched out along +X: A1 turns about Z, A2, A3 and A5 about Y, A4 and "
        "A6 about X. Check the axes and origins of the joints in the URDF."
    )
    if misalignment.max() > _TOLERANCE**2:
        row = int(np.argmax(misalignment))
        angle = np.arccos(np.clip(1.0 - misalignment[row], -1.0, 1.0)) * DEG_PER_RAD
        raise ModelError(
            f"stretched out, the axis of {JOINTS[row]} is {angle:.3g}° off that of a KUKA arm", file=file, advice=advice
        )
    upper_arm = origin[2] - origin[1]
    if upper_arm[0] <= 0.0 or flange[0, 3] <= origin[4, 0]:
        raise ModelError("the arm cannot be stretched out along +X of the root", file=file, advice=advice)
    if flange[0, 2] < 1.0 - _TOLERANCE**2:
        raise ModelError(
            "stretched out, the flange does not point along +X",
            file=file,
            advice="Z of tool0 (X or Z of flange) must point out.",
        )


def _origins(point: Array, flange: Array) -> Array:
    """Return a point on each axis (6, 3), root frame [m]: the points with dimensions in KUKA's drawings.

    A1: at the height of A2. A2 and A3: in the plane Y of A1. A4: above A3. A5: on the axis of A4. A6: at the flange.

    :param point: (6, 3) any point on each axis at KUKA's zero position, root frame [m].
    :param flange: (3,) the origin of the flange at KUKA's zero position, root frame [m].
    """
    origin = point.copy()
    origin[0, 2] = point[1, 2]
    origin[1:3, 1] = point[0, 1]
    origin[3, 0] = point[2, 0]
    origin[4, 1] = point[3, 1]
    origin[5, 0] = flange[0]
    return origin


def _compliances(chain: Chain, payload: float | None) -> tuple[list[float], str]:
    """Return compliances of A1…A6 [µrad/(N·m)], scaled from published values of the KR 270-2, and the scaling in words.

    In arms of similar design, torsional stiffness grows with the cube of the size, and the load moment (payload times
    reach) with the fourth power. So with a known payload, compliances scale with the load moment to the power −3/4.
    Without it, a smaller reach scales by its inverse cube, and a larger reach does not count: in one class the longer
    arm carries less and is not stiffer.

    :param payload: rated [kg]; None if it is not known.
    """
    reference = load(shipped_models()[_REFERENCE])
    reference_reach, reach = _reach(reference.nominal), _reach(chain)
    reference_mm, reach_mm = f"{reference_reach * MM_PER_M:.0f}", f"{reach * MM_PER_M:.0f}"
    if payload is not None:
        factor = (_REFERENCE_PAYLOAD * reference_reach / (payload * reach)) ** 0.75
        sizes = f"{_REFERENCE_PAYLOAD:.0f} kg at {reference_mm} mm to {payload:.0f} kg at {reach_mm} mm"
        reason = f"scaled by the load moment to the power of -3/4 ({sizes})"
    elif reach < reference_reach:
        factor = (reference_reach / reach) ** 3
        reason = f"scaled by the cube of the reach ({reference_mm} to {reach_mm} mm)"
    else:
        factor = 1.0
        reason = f"unchanged, since the payload of this longer arm ({reach_mm} mm) is not in its name"
    compliance = reference.compliance[list(reference.actuated)] * PER_URAD * factor
    return [float(f"{value:.2g}") for value in compliance], f"that of the KR 270-2, {reason}"


def _masses(chain: Chain, payload: float | None, file: str) -> tuple[Masses, list[str]]:
    """Return the entry of the link masses, and notes for the user.

    The masses are marked as assumed if some are missing, or if their sum does not fit the size of the arm.

    :param payload: rated [kg]; None if it is not known.
    :param file: name of the URDF, the source of the masses.
    """
    massless = [name for name, mass in zip(JOINTS, chain.mass, strict=True) if mass < _LIGHTEST]
    if len(massless) == len(JOINTS):
        note = "no link has a mass: give <inertial> in robot.urdf where the weight of the links is to count"
        return Masses(source=f"{file}: none given", assumed=True), [note]
    notes = []
    if massless:
        notes.append(
            f"{', '.join(massless)} carry no mass: give <inertial> in robot.urdf where the weight of the links is to "
            "count"
        )
    reach, total = _reach(chain), float(chain.mass.sum())
    if payload is None:
        arm_mass, size = _MASS_BY_REACH * reach**3, f"reach {reach * MM_PER_M:.0f} mm"
    else:
        arm_mass = _MASS_BY_LOAD[0] * (payload * reach) ** _MASS_BY_LOAD[1]
        size = f"{payload:.0f} kg payload, reach {reach * MM_PER_M:.0f} mm"
    if not arm_mass / _IMPLAUSIBLE <= total <= arm_mass * _IMPLAUSIBLE:
        notes.append(
            f"the links weigh {total:.0f} kg; arms of this size ({size}) have about {arm_mass:.2g} kg without the "
            "base. The masses are marked as assumed: correct <inertial> in robot.urdf, since their weight is corrected "
            "too"
        )
        return Masses(source=f"{file}: {total:.0f} kg are not plausible", assumed=True), notes
    return Masses(source=file, assumed=bool(massless)), notes


def _reach(chain: Chain) -> float:
    """Return the distance of the wrist from the axis of A1 with the arm stretched out [m].

    :param chain: in KUKA's form: A2 is ahead of A1 along X.
    """
    offset = chain.placement[:, :3, 3]
    upper_arm, forearm = np.linalg.norm(offset[2]), np.linalg.norm(offset[3] + offset[4])
    return float(offset[1, 0] + upper_arm + forearm)


def _model_text(chain: Chain, name: str, shapes: Mapping[tuple[int, str], str]) -> bytes:
    """Return robot.urdf of an arm in KUKA's conventions.

    :param shapes: (carrier, "visual" or "collision") → name of the mesh; carrier 0…5: the joint, −1: the base.
    """
    lines = [
        '<?xml version="1.0"?>',
        "<!-- Joints A1..A6 with KUKA's signs; root frame = $ROBROOT; at zero the arm is stretched out along +X. -->",
        f"<robot name={quoteattr(name)}>",
    ]
    links = ["base_link", *(f"link_{number}" for number in range(1, len(JOINTS) + 1))]
    for carrier, link in enumerate(links, -1):
        lines += _link_lines(chain, carrier, link, shapes)
    lines.append(f'  <link name="{FLANGE}"/>')
    for row, (parent, child) in enumerate(pairwise(links)):
        lines += _joint_lines(chain, row, parent, child)
    lines += [
        '  <joint name="flange_fixed" type="fixed">',
        f'    <parent link="{links[-1]}"/><child link="{FLANGE}"/>',
        f'    <origin xyz="{_numbers(chain.flange[:3, 3])}" rpy="0 1.5707963267948966 0"/>',
        "  </joint>",
        "</robot>",
        "",
    ]
    return "\n".join(lines).encode()


def _link_lines(chain: Chain, carrier: int, link: str, shapes: Mapping[tuple[int, str], str]) -> list[str]:
    """Return the element of a link: its mass, and its meshes by use.

    :param carrier: joint that carries the link, 0 for A1; −1: the base, whose mass no joint carries.
    :param shapes: (carrier, "visual" or "collision") → name of the mesh.
    """
    content = []
    if carrier >= 0 and chain.mass[carrier] > 0.0:
        content = [
            "    <inertial>",
            f'      <origin xyz="{_numbers(chain.centre[carrier])}"/><mass value="{chain.mass[carrier]:g}"/>',
            '      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>',
            "    </inertial>",
        ]
    content += [
        f'    <{kind}><geometry><mesh filename="{shapes[carrier, kind]}"/></geometry></{kind}>'
        for kind in ("visual", "collision")
        if (carrier, kind) in shapes
    ]
    return [f'  <link name="{link}">', *content, "  </link>"] if content else [f'  <link name="{link}"/>']


def _joint_lines(chain: Chain, row: int, parent: str, child: str) -> list[str]:
    """Return the element of a joint of a chain, between two links; `row`: index of the joint, from 0."""
    limits = {
        "lower": chain.lower[row], "upper": chain.upper[row],
        "velocity": chain.speed[row], "effort": chain.effort[row],
    }  # fmt: skip
    limit_text = " ".join(f'{key}="{without_negative_zero(value):.10g}"' for key, value in limits.items())
    return [
        f'  <joint name="{JOINTS[row]}" type="revolute"> <!-- {chain.lower[row] * DEG_PER_RAD:.4g}° to '
        f"{chain.upper[row] * DEG_PER_RAD:.4g}°, {chain.speed[row] * DEG_PER_RAD:.4g}°/s -->",
        f'    <parent link="{parent}"/><child link="{child}"/>',
        f'    <origin xyz="{_numbers(chain.placement[row, :3, 3])}"/><axis xyz="{_numbers(chain.axis[row])}"/>',
        f"    <limit {limit_text}/>",
        "  </joint>",
    ]


def _numbers(values: Array) -> str:
    """Return numbers (n,) as the text of an attribute, with a space between them; zero has no sign."""
    return " ".join(f"{without_negative_zero(value):.10g}" for value in values)
