"""Poses that can be measured: constraints of room, line of sight and torques, and those that forbid a pose.

The arm is a chain of capsules (segments with a radius), tool and rope are capsules too, the weight is a ball.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from msgspec import Struct

from postproc import kinematics
from postproc.chunks import Columns
from postproc.frames import Array
from postproc.plan.sensitivity import ArmPoses, direction
from postproc.plan.site import BoxShape, MeshShape, Site, points_on_segments, segment_distances
from postproc.program import Bools

_ROPE_RADIUS = 0.01
"""Radius [m] of the rope of the load with its hooks (assumed)."""
_STRAIGHT_SHARE = 0.8
"""Share of the gap between parts with the arm stretched out that must remain at all configurations (assumed)."""
_PART_NAMES = ("column", "link 2", "elbow", "forearm", "hand")


class Capsule(Struct, frozen=True, eq=False):
    """A part in N configurations: segment from `start` (N, 3) to `end` (N, 3) and radius [m]."""

    name: str
    start: Array
    end: Array
    radius: float


class State(Columns, frozen=True, eq=False):
    """N configurations with their loads.

    :param q: (N, 6) joint angles [rad].
    :param load_direction: (N, 3) unit direction of the load, root axes; None: no load.
    :param arm_poses: origins, axes and flange of the arm.
    """

    q: Array
    load_direction: Array | None
    arm_poses: ArmPoses

    @classmethod
    def of(cls, site: Site, q: Array, tilt: Array | None) -> State:
        """Return configurations q (N, 6) [rad] with the poses of the arm.

        :param tilt: (N, 2) x, y in root axes [rad] along the horizontal part of the load; the length is the angle of
            the load from straight down. None: no load.
        """
        return cls(q, None if tilt is None else direction(tilt), site.arm.pose(q))


def are_feasible(site: Site, q: Array, tilt: Array) -> Bools:
    """Return True for configurations q (N, 6) [rad] that can be measured under their loads: all constraints hold.

    :param tilt: (N, 2) of the load [rad], along its horizontal part, as long as its angle from straight down.
    """
    state = State.of(site, q, tilt)
    # 1e-9 rad: rounding
    is_feasible = within_limits(site, q) & (np.linalg.norm(tilt, axis=1) <= site.rig.largest_tilt + 1e-9)
    rows = np.flatnonzero(is_feasible)
    for group in _CONSTRAINT_GROUPS:  # a group is checked only for configurations that satisfy the groups before
        state = State.of(site, q[rows], tilt[rows]) if len(rows) < len(state.q) else state
        is_allowed = np.ones(len(rows), dtype=bool)
        for _, is_satisfied in group(site, state):
            is_allowed &= is_satisfied
        is_feasible[rows] = is_allowed
        rows = rows[is_allowed]
    return np.asarray(is_feasible)


def are_passable(site: Site, q: Array) -> Bools:
    """Return True for configurations q (N, 6) [rad] in which the unloaded arm is within limits and touches nothing.

    Torques and lines of sight do not count: the arm is not measured there, it only moves through.
    """
    state = State.of(site, q, None)
    is_passable = within_limits(site, q)
    for group in (_floor_clearance, _self_clearance, _obstacle_clearance):
        for _, is_satisfied in group(site, state):
            is_passable &= is_satisfied
    return is_passable


def failures(site: Site, q: Array, tilt: Array) -> dict[str, Bools]:
    """Return name of a constraint → True for configurations (N,) that it forbids, independently of other constraints.

    :param q: (N, 6) joint angles [rad].
    :param tilt: (N, 2) of the load [rad], along its horizontal part, as long as its angle from straight down.
    """
    state = State.of(site, q, tilt)
    is_forbidden = {"joint limits": ~within_limits(site, q)}
    for group in _CONSTRAINT_GROUPS:
        for name, is_satisfied in group(site, state):
            is_forbidden[name] = is_forbidden.get(name, np.zeros(len(q), dtype=bool)) | ~is_satisfied
    return is_forbidden


def within_limits(site: Site, q: Array) -> Bools:
    """Return True for configurations q (N, 6) [rad] within the joint limits of the site, which include the margin."""
    # 1e-9 rad: rounding
    return np.asarray(((q >= site.lower - 1e-9) & (q <= site.upper + 1e-9)).all(axis=1))


def arm_parts(site: Site, state: State) -> list[Capsule]:
    """Return the capsules of column, link 2, elbow, forearm and hand at N configurations."""
    o, forearm_axis = state.arm_poses.origin, state.arm_poses.axis[:, 3]
    # begin of the forearm: the point of the axis of A4 next to A3; a URDF may put the origin of A4 anywhere on the axis
    begin = o[:, 3] + np.einsum("ni,ni->n", o[:, 2] - o[:, 3], forearm_axis)[:, None] * forearm_axis
    ends = [np.zeros_like(begin), o[:, 1], o[:, 2], begin, o[:, 4], state.arm_poses.flange[:, :3, 3]]
    pairs = zip(_PART_NAMES, ends[:-1], ends[1:], site.radius, strict=True)
    return [Capsule(name, start, end, float(radius)) for name, start, end, radius in pairs]


def tool_parts(site: Site, state: State) -> list[Capsule]:
    """Return capsules from the flange to the load point, and to each marker, at N configurations."""
    start = state.arm_poses.flange[:, :3, 3]
    ends = state.arm_poses.point(np.vstack([site.load_point, site.points]))
    return [
        Capsule(name, start, ends[:, row], site.tool_radius) for row, name in enumerate(("load point", *site.names))
    ]


def load_parts(site: Site, state: State) -> list[Capsule]:
    """Return capsules of the rope and the weight at N configurations.

    Empty without load. A weight of radius 0 has no capsule; else it is a ball, a capsule of length 0.
    """
    if state.load_direction is None:
        return []
    start = state.arm_poses.point(site.load_point[None])[:, 0]
    end = start + state.load_direction * site.rig.rope
    rope = Capsule("rope", start, end, _ROPE_RADIUS)
    return [rope, Capsule("weight", end, end, site.rig.weight_radius)] if site.rig.weight_radius > 0.0 else [rope]


def torques(site: Site, state: State) -> Array:
    """Return the static torques (N, 6) [N·m] of the joints that balance weights, payload, load and compensator."""
    torque = kinematics.gravity_torque(site.loaded_chain, state.q)
    if site.robot.compensator is not None:
        torque[:, 1] += site.robot.compensator.gradient(state.q[:, 1])
    if state.load_direction is not None:
        load_points = state.arm_poses.point(site.load_point[None])  # (N, 1, 3)
        derivatives = state.arm_poses.velocity(load_points)[:, 0]  # (N, 6, 3) of the load point by the joints [m/rad]
        # the load exerts force · derivative · direction on a joint, and the joint balances it
        torque -= site.rig.force * np.einsum("nij,nj->ni", derivatives, state.load_direction)
    return torque


def _floor_clearance(site: Site, state: State) -> Iterator[tuple[str, Bools]]:
    """Yield the name of the constraint and True for configurations (N,) with arm, tool and load clear of the floor."""
    is_above_floor = np.ones(len(state.q), dtype=bool)
    # the column, the first part of the arm, is on the floor
    for part in (*arm_parts(site, state)[1:], *tool_parts(site, state), *load_parts(site, state)):
        is_above_floor &= np.minimum(part.start[:, 2], part.end[:, 2]) - part.radius >= site.floor + site.clearance
    yield "floor", is_above_floor


def _torque_limits(site: Site, state: State) -> Iterator[tuple[str, Bools]]:
    """Yield for each joint the name of the constraint and True for configurations (N,) within its static torque.

    Nothing is yielded if no torques are stated.
    """
    if site.torque_limit is not None:
        is_allowed = np.abs(torques(site, state)) <= site.torque_limit
        for joint in range(6):
            yield f"static torque of A{joint + 1}", is_allowed[:, joint]


def _self_clearance(site: Site, state: State) -> Iterator[tuple[str, Bools]]:
    """Yield for each part of the robot its name and True for configurations (N,) in which other parts are clear of it.

    Parts must keep the clearance of the site. If the coarse shapes of two parts are closer with the arm stretched out,
    the limit is a share of that distance. Nothing is yielded without configurations.
    """
    if len(state.q) == 0:
        return
    pairs = _capsule_pairs(site, state)
    min_gap = np.array([part.radius + counterpart.radius + site.clearance for part, counterpart in pairs])
    # parts that are near with the arm stretched out overlap by their coarse shape, not by a collision; pairs with the
    # load, which come last, are not among the distances
    straight_gap = _straight_distances(site)
    min_gap[: len(straight_gap)] = np.minimum(min_gap[: len(straight_gap)], _STRAIGHT_SHARE * straight_gap)
    is_clear = _axis_distances(pairs) >= min_gap[:, None]
    for name in _PART_NAMES[:4]:
        rows = [row for row, (part, _) in enumerate(pairs) if part.name == name]
        yield f"tool, load and arm against the robot's {name}", np.asarray(is_clear[rows].all(axis=0))


def _capsule_pairs(site: Site, state: State) -> list[tuple[Capsule, Capsule]]:
    """Return pairs of a part of the robot and another part that could collide with it; pairs with the load are last.

    Against column and link 2 only the front half of the forearm counts: the rear half is next to link 2 at all angles.
    """
    column, link, elbow, forearm, hand = arm_parts(site, state)
    tool, load = tool_parts(site, state), load_parts(site, state)
    front_half = Capsule("forearm", 0.5 * (forearm.start + forearm.end), forearm.end, forearm.radius)
    # the forearm is shortened by its radius, at most by half: its round end would touch hand and tool
    length = max(float(np.linalg.norm(forearm.end[0] - forearm.start[0])), 1e-9)  # equal in all configurations; not 0
    share = 1.0 - min(0.5, forearm.radius / length)
    forearm = Capsule("forearm", forearm.start, forearm.start + share * (forearm.end - forearm.start), forearm.radius)
    pairs = [(part, counterpart) for part in (column, link) for counterpart in (front_half, hand, *tool)]
    pairs += [(elbow, counterpart) for counterpart in (hand, *tool)]
    pairs += [(forearm, counterpart) for counterpart in tool]
    pairs += [(part, counterpart) for part in (column, link, elbow, forearm) for counterpart in load]
    return pairs


def _axis_distances(pairs: list[tuple[Capsule, Capsule]]) -> Array:
    """Return the distances (pairs, N) [m] between the axes of the two parts of each pair, at N configurations."""
    return segment_distances(
        np.array([part.start for part, _ in pairs]),
        np.array([part.end for part, _ in pairs]),
        np.array([counterpart.start for _, counterpart in pairs]),
        np.array([counterpart.end for _, counterpart in pairs]),
    )


@lru_cache(maxsize=8)
def _straight_distances(site: Site) -> Array:
    """Return the distances (pairs,) [m] between the axes of parts, without load and with all joints at 0.

    Pairs are in the order of `_capsule_pairs`.
    """
    return np.asarray(_axis_distances(_capsule_pairs(site, State.of(site, np.zeros((1, 6)), None)))[:, 0])


def _obstacle_clearance(site: Site, state: State) -> Iterator[tuple[str, Bools]]:
    """Yield for each obstacle its name and True for configurations (N,) with arm, tool and load clear of it.

    The column, the first part of the arm, never moves and is not checked.
    """
    parts = (*arm_parts(site, state)[1:], *tool_parts(site, state), *load_parts(site, state))
    for obstacle in site.obstacles:
        yield obstacle.name, _keeps_clearance(site, parts, obstacle, len(state.q))


def _keeps_clearance(site: Site, parts: tuple[Capsule, ...], obstacle: BoxShape | MeshShape, count: int) -> Bools:
    """Return True for configurations (count,) in which all parts keep the clearance of the site from an obstacle."""
    is_clear = np.ones(count, dtype=bool)
    for part in parts:
        rows = np.flatnonzero(is_clear)
        start, end = part.start[rows], part.end[rows]
        # the longest axis gives the number of points on all of them
        length = float(np.linalg.norm(end - start, axis=1).max(initial=0.0))
        distances = obstacle.distance(points_on_segments(start, end, length)).min(axis=1)
        is_clear[rows] = distances >= part.radius + site.clearance
    return is_clear


def _acceptance(site: Site, state: State) -> Iterator[tuple[str, Bools]]:
    """Yield for each marker with a normal its name and True for configurations (N,) that turn it to the tracker.

    The angle between the normal and the line of sight is within the acceptance angle of the site. Nothing is yielded
    without a tracker.
    """
    if site.tracker is None:
        return
    point = state.arm_poses.point(site.points)
    for row, name in enumerate(site.names):
        if np.isfinite(site.normals[row, 0]):  # NaN: turned by hand
            line_of_sight = site.tracker - point[:, row]
            normal = state.arm_poses.flange[:, :3, :3] @ site.normals[row]
            cosine = np.einsum("ni,ni->n", line_of_sight, normal) / np.linalg.norm(line_of_sight, axis=1)
            yield f"acceptance angle of marker {name}", cosine >= np.cos(site.acceptance)


def _line_of_sight(site: Site, state: State) -> Iterator[tuple[str, Bools]]:
    """Yield for each marker its name and True for configurations (N,) in which the tracker sees it.

    No part of the arm, the load or an obstacle is between marker and tracker. Nothing is yielded without a tracker.
    """
    if site.tracker is None:
        return
    marker = np.swapaxes(state.arm_poses.point(site.points), 0, 1)  # (P, N, 3)
    tracker = np.broadcast_to(site.tracker, marker.shape)
    parts = [*arm_parts(site, state), *load_parts(site, state)]
    start, end = np.array([part.start for part in parts]), np.array([part.end for part in parts])
    radius = np.array([part.radius for part in parts])[:, None]
    # (P, parts, N); the coarse shape of the hand may contain the marker: such a shape does not hide it
    contains_marker = segment_distances(marker[:, None], marker[:, None], start, end) < radius
    is_clear_of_line = segment_distances(tracker[:, None], marker[:, None], start, end) >= radius
    is_in_sight = np.asarray((contains_marker | is_clear_of_line).all(axis=1))
    for row, name in enumerate(site.names):
        rows = np.flatnonzero(is_in_sight[row])
        for obstacle in site.obstacles:
            is_in_sight[row, rows] &= ~obstacle.blocks(tracker[row, rows], marker[row, rows])
        yield f"line of sight to marker {name}", is_in_sight[row]


_CONSTRAINT_GROUPS = (
    _floor_clearance,
    _torque_limits,
    _acceptance,
    _self_clearance,
    _line_of_sight,
    _obstacle_clearance,
)
"""Constraints in the order of their checks: cheap and strict constraints first."""
