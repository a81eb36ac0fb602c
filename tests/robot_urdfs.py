"""URDFs of arms as others write them: the same arm with other names, frames and signs."""

from __future__ import annotations

import warnings
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from postproc.robot import RobotModel

ROS = ("base_link", "base", "joint_{}", "link_{}", "flange", "tool0")
ROS_A = ("base_link", "base", "joint_a{}", "link_{}", "flange", "tool0")
PREFIXED = ("kr_base_link", "kr_base", "kr_joint_{}", "kr_link_{}", "kr_flange", "kr_tool0")
INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
OUT = Rotation.from_euler("y", 90, degrees=True)


def ros_urdf(
    robot: RobotModel, signs, rng: np.random.Generator | None = None, names=ROS, decimals=12, zero=None
) -> str:
    """Write the arm with joints that turn by `signs` times KUKA's angles.

    With `rng` every joint frame is turned at random about its axis, slid along it, and its axis is its own z; the links
    hang in these frames, and so do their masses. With `zero` (6,) the file's zero is at these angles of KUKA's [rad].
    """
    base_link, base, joint, link, flange, tool0 = names
    chain = robot.nominal
    zero = np.zeros(6) if zero is None else np.asarray(zero)
    frames = [np.eye(4)]
    here = np.eye(4)
    turned_to = []
    for row in range(6):
        here = here @ chain.placement[row]
        here[:3, :3] = here[:3, :3] @ Rotation.from_rotvec(zero[row] * chain.axis[row]).as_matrix()
        turned_to.append(here)
        mine = here.copy()
        if rng is not None:
            z = signs[row] * chain.axis[row]
            x = np.cross(z, [0.3, 0.5, 0.8])
            x /= np.linalg.norm(x)
            turned = np.stack([x, np.cross(z, x), z], axis=1)
            mine[:3, :3] = here[:3, :3] @ turned @ Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix()
            mine[:3, 3] += here[:3, :3] @ chain.axis[row] * rng.uniform(-0.4, 0.4)
        frames.append(mine)
    tip = here @ chain.flange
    lines = [f"<robot name={quoteattr(robot.title)}>", '  <link name="world"/>', f'  <link name="{base_link}"/>']
    stands = np.eye(4)
    stands[:3, 3] = [2.0, 3.0, 1.0]
    lines += [f'  <link name="{base}"/>', _fixed("world", base_link, stands), _fixed(base_link, base, np.eye(4))]
    for row in range(6):
        centre = np.linalg.inv(frames[row + 1]) @ turned_to[row] @ np.append(chain.centre[row], 1.0)
        numbers = " ".join(f"{value:.{decimals}f}" for value in centre[:3])
        inertial = f'<origin xyz="{numbers}"/><mass value="{chain.mass[row]}"/>{INERTIA}'
        lines.append(f'  <link name="{link.format(row + 1)}"><inertial>{inertial}</inertial></link>')
        axis = "0 0 1" if rng is not None else " ".join(str(signs[row] * value) for value in chain.axis[row])
        limits = (chain.lower[row] - zero[row], chain.upper[row] - zero[row])
        low, high = sorted(signs[row] * limit for limit in limits)
        lines += [
            f'  <joint name="{joint.format(row + 1)}" type="revolute">',
            f'    <parent link="{base_link if row == 0 else link.format(row)}"/><child link="{link.format(row + 1)}"/>',
            f"    {_origin(np.linalg.inv(frames[row]) @ frames[row + 1], decimals)}",
            f'    <axis xyz="{axis}"/><limit lower="{low}" upper="{high}" velocity="{chain.speed[row]}" effort="7"/>',
            "  </joint>",
        ]
    out = np.eye(4)
    out[:3, :3] = OUT.as_matrix()
    lines += [f'  <link name="{flange}"/>', f'  <link name="{tool0}"/>']
    lines.append(_fixed(link.format(6), flange, np.linalg.inv(frames[6]) @ tip @ np.linalg.inv(out), decimals))
    lines += [_fixed(flange, tool0, out), "</robot>", ""]
    return "\n".join(lines)


def _fixed(parent: str, child: str, pose: np.ndarray, decimals: int = 12) -> str:
    return (
        f'  <joint name="{parent}-{child}" type="fixed"><parent link="{parent}"/><child link="{child}"/>'
        f"{_origin(pose, decimals)}</joint>"
    )


def _origin(pose: np.ndarray, decimals: int) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # at 90° scipy sets the third angle to zero, as is right here
        angles = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    xyz, rpy = (" ".join(f"{value:.{decimals}f}" for value in values) for values in (pose[:3, 3], angles))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'
