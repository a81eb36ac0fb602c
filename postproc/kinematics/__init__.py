"""Kinematics of a robot: forward, Jacobian, Hessian, gravity torques; inverse with branches and limits."""

from postproc.kinematics.chain import gravity_stiffness, gravity_torque, load_stiffness, tcp, tcp_and_weight
from postproc.kinematics.inverse import (
    JointPath,
    UnreachableError,
    branch_of,
    closed_form,
    follow,
    on_branch,
    refine,
    status_of,
    turn_of,
)
from postproc.kinematics.margins import joint_margin, smallest_singular_value

__all__ = [
    "JointPath",
    "UnreachableError",
    "branch_of",
    "closed_form",
    "follow",
    "gravity_stiffness",
    "gravity_torque",
    "joint_margin",
    "load_stiffness",
    "on_branch",
    "refine",
    "smallest_singular_value",
    "status_of",
    "tcp",
    "tcp_and_weight",
    "turn_of",
]
