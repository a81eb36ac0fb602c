"""Where the robot is measured, in SI units: rig, shape of the arm, obstacles, tracker, limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec import Struct

from postproc.errors import PlanError
from postproc.frames import DEG_PER_RAD, M_PER_MM, RAD_PER_DEG, Array
from postproc.identification.experiment import Experiment
from postproc.kinematics.forward import GRAVITY
from postproc.plan.arm import Arm
from postproc.plan.shapes import BoxShape, MeshShape
from postproc.robot import RobotModel

_RADII = (0.149, 0.085, 0.12, 0.072, 0.055)
"""Radii of column, link 2, elbow, forearm and hand over the reach of the wrist, with motors and hoses: drawings of KUKA
arms of this class, rounded up. `[body] radius_mm` replaces them.
"""


class Rig(Struct, frozen=True, eq=False):
    """What loads the arm.

    :param force: size of the load [N].
    :param largest_tilt: largest angle of the load from straight down [rad].
    :param rope: length that must be free below the load point [m].
    :param weight_radius: of the weight at its end [m]; 0: none there.
    """

    force: float
    largest_tilt: float
    rope: float
    weight_radius: float


class Site(Struct, frozen=True, eq=False):
    """Everything that limits where the robot can be measured. Root frame where nothing else is said.

    :param robot: masses, compensator.
    :param arm: geometry.
    :param rig: what loads it.
    :param start: (6,) joint angles where the robot stands first [rad].
    :param lower: (6,) joint limits with margin [rad].
    :param upper: (6,) joint limits with margin [rad].
    :param radius: (5,) of column, link 2, elbow, forearm, hand [m].
    :param tool_radius: of the parts that carry load point and markers [m].
    :param clearance: to be kept from everything [m].
    :param load_point: (3,) in the flange frame [m].
    :param points: (P, 3) markers in the flange frame [m].
    :param names: of the markers.
    :param normals: (P, 3) unit vectors in the flange frame, NaN where a reflector is turned by hand.
    :param floor: height [m].
    :param obstacles: boxes and meshes.
    :param tracker: (3,) [m], or None.
    :param sigma: noise of one coordinate of one reading [m].
    :param acceptance: largest angle between normal and line of sight [rad].
    :param torque_limit: (6,) static limits [N·m], or None where nobody states them.
    """

    robot: RobotModel
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
    """Put a robot into the place where it is measured.

    :param start: (6,) joint angles where it stands first [rad].
    :param folder: where the experiment stands; meshes are relative to it.
    :param margin: distance to keep from joint limits [rad].
    :raises PlanError: there is no [rig], a normal is zero, a mesh cannot be read, the margin leaves nothing.
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
    origin = arm.pose(np.zeros((1, 6))).origin[0]
    reach = float(np.linalg.norm(origin[2] - origin[1]) + np.linalg.norm(origin[4] - origin[2]))
    radius = np.array(_RADII) * reach if body.radius_mm is None else np.array(body.radius_mm) * M_PER_MM
    obstacles: list[BoxShape | MeshShape] = [BoxShape.of(box, n) for n, box in enumerate(experiment.boxes, 1)]
    obstacles += [MeshShape.of(mesh, folder) for mesh in experiment.meshes]
    return Site(
        robot=robot,
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
        radius=radius,
        tool_radius=body.tool_radius_mm * M_PER_MM,
        clearance=body.clearance_mm * M_PER_MM,
        load_point=experiment.load_point.position(),
        points=np.array([point.position() for point in experiment.points.values()]),
        names=tuple(experiment.points),
        normals=_normals(experiment),
        floor=experiment.floor.Z * M_PER_MM,
        obstacles=tuple(obstacles),
        tracker=None if tracker is None else np.array([tracker.X, tracker.Y, tracker.Z]) * M_PER_MM,
        sigma=experiment.sigma,
        acceptance=np.pi if tracker is None else tracker.acceptance_deg * RAD_PER_DEG,
        torque_limit=_torque_limit(robot, rig.max_torque_Nm),
    )


def _normals(experiment: Experiment) -> Array:
    normals = np.full((len(experiment.points), 3), np.nan)
    for row, (name, point) in enumerate(experiment.points.items()):
        if point.normal is not None:
            size = float(np.linalg.norm(point.normal))
            if size < 1e-9:
                raise PlanError(f"[points.{name}] normal is zero", advice="Give a direction in the flange frame.")
            normals[row] = np.array(point.normal) / size
    return normals


def _torque_limit(robot: RobotModel, given: tuple[float, ...] | None) -> Array | None:
    if given is not None:
        return np.array(given)
    effort = robot.nominal.effort
    return effort if np.isfinite(effort).all() and (effort > 0.0).all() else None
