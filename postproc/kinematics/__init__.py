"""Kinematics of a robot: forward, Jacobian, torques of weights; inverse with branches, status, turns and limits."""

from postproc.kinematics.closed_form import ClosedForm, closed_form, status_of
from postproc.kinematics.components import components, matrices, twist_between
from postproc.kinematics.forward import Posture, gravity_torque, posture, tcp, tool_pose
from postproc.kinematics.hessian import gravity_stiffness, load_stiffness, require_pinocchio
from postproc.kinematics.inverse import (
    ByWrist,
    JointPath,
    UnreachableError,
    branch_joints,
    follow,
    joint_margin,
    smallest_singular_value,
    smallest_singular_values,
    turn_of,
)

__all__ = [
    "ByWrist",
    "ClosedForm",
    "JointPath",
    "Posture",
    "UnreachableError",
    "branch_joints",
    "closed_form",
    "components",
    "follow",
    "gravity_stiffness",
    "gravity_torque",
    "joint_margin",
    "load_stiffness",
    "matrices",
    "posture",
    "require_pinocchio",
    "smallest_singular_value",
    "smallest_singular_values",
    "status_of",
    "tcp",
    "tool_pose",
    "turn_of",
    "twist_between",
]
