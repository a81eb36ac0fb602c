"""A model folder from the URDF of a KUKA arm that somebody else wrote, as the packages of ROS-Industrial have them.

Joints may be called and turn as they like (``joint_1``, ``joint_a1``, about ±Z …), and their frames lie where they like
on their axes: only the axes count. What comes out has joints A1…A6 with KUKA's signs, frames parallel to the root at
A1…A6 = 0, and `flange` as KUKA has it. Source of the names: ROS-Industrial, "Create a URDF for an industrial robot":
`base` is the controller's root frame, `tool0` its flange.
"""

from __future__ import annotations

import datetime
from xml.sax.saxutils import quoteattr

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import ModelError
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array
from postproc.robot import urdf
from postproc.robot.chain import Chain
from postproc.robot.folder import load, shipped
from postproc.robot.model_file import FLANGE, JOINTS, JointSpring, Masses, ModelFile, Sourced
from postproc.robot.urdf import AnyArm

_AXES = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=float)
"""Axes of A1…A6 at zero, root frame: KUKA's signs."""
_FLANGE_AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""The flange at zero: {A 0, B 90, C 0}."""
_SAME = 1e-3
"""Angles [rad] and lengths [m] that may be missing to KUKA's zero position."""
_ROUND = 7
"""Decimals of lengths [m]: what is behind them is rounding of the file."""
_REFERENCE = "kuka_kr270"
_SCALED_SIGMA = 40.0
"""Standard deviation [%] of a compliance scaled from another arm: published values of one class of arms differ by 20 to
50 %."""
_LIGHTEST = 0.01
"""A link below this [kg] has no mass: some files need a number larger than zero there."""


class Adopted(Struct, frozen=True, eq=False):
    """An arm taken over.

    :param chain: nominal geometry, KUKA's signs.
    :param content: of `model.toml`.
    :param notes: what the user should know.
    """

    chain: Chain
    content: ModelFile
    notes: tuple[str, ...]

    def urdf(self) -> bytes:
        """Return the content of `robot.urdf`."""
        return _written(self.chain, self.content.name)


def adopt(text: str, file: str) -> Adopted:
    """Take over an arm.

    :param text: of the URDF.
    :param file: its name, for messages and as the source of its values.
    :raises ModelError: it is no six-axis arm, or does not stand in KUKA's zero position at zero.
    """
    if "<xacro:" in text:
        raise ModelError("a xacro, not a URDF", file=file, advice=f"Expand it first: xacro {file} > robot.urdf")
    arm = urdf.read_any(text, file)
    chain, notes = _in_kuka_form(arm, file)
    missing = [name for name, mass in zip(JOINTS, chain.mass, strict=True) if mass < _LIGHTEST]
    if missing:
        which = "no link has a mass" if len(missing) == len(JOINTS) else f"no mass behind {', '.join(missing)}"
        notes.append(f"{which}: give <inertial> in robot.urdf where the weight of the links is to count")
    compliance, reach, scaled = _compliances(chain)
    notes.append(f"compliances are ASSUMED, {scaled}: identify them (postproc identify), or replace them in model.toml")
    notes.append("a gravity compensator, if the arm has one, is not in the model")
    content = ModelFile(
        name=arm.name or "robot",
        date=datetime.datetime.now(datetime.UTC).date().isoformat(),
        language="krl",
        joints={
            joint: JointSpring(
                source=f"no published value: {scaled}",
                assumed=True,
                compliance_urad_per_Nm=value,
                sigma_percent=_SCALED_SIGMA,
            )
            for joint, value in zip(JOINTS, compliance, strict=True)
        },
        masses=Masses(source=f"{file}: none given" if len(missing) == len(JOINTS) else file, assumed=bool(missing)),
        geometry_nominal=Sourced(source=f"{file}, reach of the wrist {reach * MM_PER_M:.0f} mm"),
    )
    return Adopted(chain, content, tuple(notes))


def _in_kuka_form(arm: AnyArm, file: str) -> tuple[Chain, list[str]]:
    """Return the chain, and what was changed in it."""
    base = _pose_of_base(arm, file)
    placement = arm.chain.placement.copy()
    placement[0] = np.linalg.inv(base) @ placement[0]
    own = replace(arm.chain, placement=placement, flange=_pose_of_flange(arm, file))
    frames, flange = (each[0] for each in own.joint_frames(np.zeros((1, len(JOINTS)))))
    axis = np.einsum("jab,jb->ja", frames[:, :3, :3], own.axis)
    sign = np.sign(np.einsum("ja,ja->j", axis, _AXES))
    _check_zero(axis, frames[:, :3, 3], flange, file)
    origin = np.round(_origins(frames[:, :3, 3], flange[:3, 3]), _ROUND) + 0.0
    centre = np.einsum("jab,jb->ja", frames[:, :3, :3], own.centre) + frames[:, :3, 3] - origin
    placement = np.tile(np.eye(4), (len(JOINTS), 1, 1))
    placement[:, :3, 3] = np.round(np.diff(origin, axis=0, prepend=0.0), _ROUND) + 0.0
    tip = np.eye(4)
    tip[:3, :3], tip[:3, 3] = _FLANGE_AXES, np.round(flange[:3, 3] - origin[-1], _ROUND) + 0.0
    chain = replace(
        own,
        placement=placement,
        axis=_AXES,
        flange=tip,
        centre=np.where(own.mass[:, None] < _LIGHTEST, 0.0, np.round(centre, 4)) + 0.0,
        mass=np.where(own.mass < _LIGHTEST, 0.0, own.mass),
        lower=np.where(sign > 0, own.lower, -own.upper),
        upper=np.where(sign > 0, own.upper, -own.lower),
    )
    turned = ", ".join(name for name, one in zip(JOINTS, sign, strict=True) if one < 0)
    notes = [f"joints turn the other way than KUKA's, signs and limits are changed: {turned}"] if turned else []
    angle = np.arctan2(flange[:3, 0] @ _FLANGE_AXES[:, 1], flange[:3, 0] @ _FLANGE_AXES[:, 0])
    if abs(angle) > _SAME:
        told = f"by {angle * DEG_PER_RAD:.4g}°: $TOOL is in KUKA's flange frame, {{A 0, B 90, C 0}} at zero"
        notes.append(f"tool0 is turned about its axis against KUKA's flange {told}")
    return chain, notes


def _pose_of_base(arm: AnyArm, file: str) -> Array:
    """Return the controller's root frame in the first link: `base`, else `base_link`, else the first link itself."""
    for wanted in ("base", "base_link"):
        found = _frame(arm, wanted, -1, file)
        if found is not None:
            return found
    return np.eye(4)


def _pose_of_flange(arm: AnyArm, file: str) -> Array:
    """Return KUKA's flange in the frame of the last joint; of `flange`, X points out, of `tool0` Z does."""
    out = np.eye(4)
    out[:3, :3] = _FLANGE_AXES
    for wanted, turn in (("tool0", np.eye(4)), (FLANGE, out)):
        found = _frame(arm, wanted, len(JOINTS) - 1, file)
        if found is not None:
            return found @ turn
    raise ModelError(
        "no link named tool0 or flange behind the last joint", file=file, advice="It says where the flange is: add it."
    )


def _frame(arm: AnyArm, wanted: str, carrier: int, file: str) -> Array | None:
    """Return the pose of a link of some name that a joint carries, or of the only one with a prefix to it."""
    poses = {name: pose for name, (joint, pose) in arm.frames.items() if joint == carrier}
    names = [name for name in poses if name == wanted] or [
        name for name in poses if name.endswith((f"_{wanted}", f"/{wanted}"))
    ]
    if len(names) > 1:
        raise ModelError(
            f"several links could be {wanted}: {', '.join(names)}", file=file, advice=f"Call the right one {wanted}."
        )
    return poses[names[0]] if names else None


def _check_zero(axis: Array, origin: Array, flange: Array, file: str) -> None:
    """At zero the arm must lie stretched out along +X of the root, as KUKA's do."""
    off = 1.0 - np.abs(np.einsum("ja,ja->j", axis, _AXES))
    advice = (
        "With all joints at zero a KUKA arm lies stretched out along +X: A1 about Z, A2, A3 and A5 about Y, A4 and A6 "
        "about X. Change the zero positions in the URDF."
    )
    if off.max() > _SAME**2:
        joint = JOINTS[int(np.argmax(off))]
        raise ModelError(f"at zero {joint} does not lie as KUKA's does", file=file, advice=advice)
    upper_arm = origin[2] - origin[1]
    if upper_arm[0] <= 0.0 or abs(upper_arm[2]) > _SAME or flange[0, 3] <= origin[4, 0]:
        raise ModelError("at zero the arm is not stretched out along +X of the root", file=file, advice=advice)
    if flange[0, 2] < 1.0 - _SAME**2:
        raise ModelError(
            "at zero the flange does not look along +X", file=file, advice="Z of tool0 (X of flange) must point out."
        )


def _origins(point: Array, flange: Array) -> Array:
    """Return an origin on each axis (6, 3), root frame [m]: where KUKA's drawings have their dimensions.

    A1 at the height of A2; A2 and A3 in the plane of A1; A4 above A3; A5 on the axis of A4; A6 at the flange.
    """
    origin = point.copy()
    origin[0, 2] = point[1, 2]
    origin[1:3, 1] = point[0, 1]
    origin[3, 0] = point[2, 0]
    origin[4, 1] = point[3, 1]
    origin[5, 0] = flange[0]
    return origin


def _compliances(chain: Chain) -> tuple[list[float], float, str]:
    """Return compliances [µrad/(N·m)] by size, the reach of the wrist [m], and how they were found.

    Of arms built alike, torsional stiffness grows with the cube of the size; the KR 270-2 is the one that is published.
    """
    reference = load(shipped()[_REFERENCE])
    known, own = _reach(reference.nominal), _reach(chain)
    compliance = reference.compliance[list(reference.actuated)] * 1e6 * (known / own) ** 3
    scaled = (
        f"that of the KR 270-2, scaled by the cube of the reach ({known * MM_PER_M:.0f} to {own * MM_PER_M:.0f} mm)"
    )
    return [float(f"{value:.2g}") for value in compliance], own, scaled


def _reach(chain: Chain) -> float:
    """Return how far from the axis of A1 the wrist gets, stretched out [m]."""
    step = chain.placement[:, :3, 3]
    return float(step[1, 0] + np.linalg.norm(step[2]) + np.linalg.norm(step[3] + step[4]))


def _written(chain: Chain, name: str) -> bytes:
    lines = [
        '<?xml version="1.0"?>',
        "<!-- Joints A1..A6 with KUKA's signs; root frame = $ROBROOT; at zero the arm lies stretched out along +X. -->",
        f"<robot name={quoteattr(name)}>",
        '  <link name="base_link"/>',
    ]
    for number, (mass, centre) in enumerate(zip(chain.mass, chain.centre, strict=True), 1):
        if mass == 0.0:
            lines.append(f'  <link name="link_{number}"/>')
            continue
        lines += [
            f'  <link name="link_{number}">',
            "    <inertial>",
            f'      <origin xyz="{_numbers(centre)}"/><mass value="{mass:g}"/>',
            '      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>',
            "    </inertial>",
            "  </link>",
        ]
    lines.append(f'  <link name="{FLANGE}"/>')
    parent = "base_link"
    for number, joint in enumerate(JOINTS, 1):
        row = number - 1
        limits = {
            "lower": chain.lower[row], "upper": chain.upper[row],
            "velocity": chain.speed[row], "effort": chain.effort[row],
        }  # fmt: skip
        lines += [
            f'  <joint name="{joint}" type="revolute"> <!-- {chain.lower[row] * DEG_PER_RAD:.4g}° to '
            f"{chain.upper[row] * DEG_PER_RAD:.4g}°, {chain.speed[row] * DEG_PER_RAD:.4g}°/s -->",
            f'    <parent link="{parent}"/><child link="link_{number}"/>',
            f'    <origin xyz="{_numbers(chain.placement[row, :3, 3])}"/><axis xyz="{_numbers(chain.axis[row])}"/>',
            "    <limit " + " ".join(f'{key}="{value + 0.0:.10g}"' for key, value in limits.items()) + "/>",
            "  </joint>",
        ]
        parent = f"link_{number}"
    lines += [
        '  <joint name="flange_fixed" type="fixed">',
        f'    <parent link="{parent}"/><child link="{FLANGE}"/>',
        f'    <origin xyz="{_numbers(chain.flange[:3, 3])}" rpy="0 1.5707963267948966 0"/>',
        "  </joint>",
        "</robot>",
        "",
    ]
    return "\n".join(lines).encode()


def _numbers(values: Array) -> str:
    return " ".join(f"{value + 0.0:.10g}" for value in values)
