"""Orientations of the auxiliary points of SCIRC: by which way the tool turns.

KUKA, KSS 8.x, `$CIRC_MODE.AUX_PT.ORI`: under #CONSIDER, the default, the tool turns from the start to the end by the
shorter or the longer rotation, whichever comes closer to the orientation of the auxiliary point: anywhere on the way.
Under #INTERPOLATE it takes on that orientation there; how it turns on both sides is not published. Under #IGNORE, and
under `$ORI_TYPE=#IGNORE`, it turns by the shorter rotation. CIRC disregards auxiliary orientations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from postproc.dialects.krl.language.expressions import parse_aggregate
from postproc.dialects.krl.language.motion_statements import MotionStatement
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.language.values import Number
from postproc.dialects.krl.layout import IGNORE
from postproc.dialects.krl.read.end_poses import OrientationControl
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.spline_blocks import is_spline
from postproc.dialects.krl.read.state import State
from postproc.frames import (
    RAD_PER_DEG,
    Array,
    angle_between,
    hat,
    norm,
    pose_from_xyzabc,
    rotation_from_vector,
    rotation_vector,
    xyzabc_from_pose,
)
from postproc.program import Bools, Ints

_LONGER_MESSAGE = (
    "the orientation of the auxiliary point is closer to the longer way round: SCIRC turns the tool that way"
)
_THROUGH_MESSAGE = (
    "SCIRC turns the tool through the orientation of its auxiliary point ($CIRC_MODE.AUX_PT.ORI #INTERPOLATE), which "
    "is not on the way from start to end by one rotation: how it turns on both sides is not published"
)
_ADVICE = (
    "Leave A, B, C out of the auxiliary point, or give those of half the way; or use CIRC.",
    "Use #CONSIDER or #IGNORE, or divide the circle at its auxiliary point into two.",
)
_NO_TURN = 1e-6
"""A tool that turns by less than this [rad] keeps its orientation: the rotation has no axis."""
_ON_THE_WAY = 0.01 * RAD_PER_DEG
"""An orientation closer than this [rad] to where the tool turns anyway is on its way; one must come closer by this."""


def ignores_auxiliary_orientation(
    trace: Trace,
    rows: MotionColumns,
    circular: Ints,
    moves: Mapping[int, MotionStatement],
    ends: tuple[Array, Array],
    arcs: tuple[Array, Array, Array, Array],
    control: OrientationControl,
    settings: Settings,
    in_force: tuple[Sequence[State], Ints],
) -> Bools:
    """Return the circles (n,) whose auxiliary orientation must be ignored once they are corrected.

    :param circular: (n,) rows of the circles.
    :param moves: row → statement, of those that are not plain.
    :param ends: tool frames (n, 4, 4) at start and end, `$BASE` [m].
    :param arcs: centres, axes and auxiliary points (n, 3) [m], angles (n,) [rad] of the circles.
    :param control: how the orientation is led.
    :param in_force: states, and the index of the state in which each circle runs (n,).
    :raises ProgramError: the tool does not turn by the shorter rotation, or it is not known whether it does.
    """
    is_left_out = np.zeros(len(circular), dtype=np.bool_)
    via_angles = np.full((len(circular), 3), np.nan)
    states, state = in_force
    is_strict_circle = np.array([s.auxiliary == "#INTERPOLATE" or _is_auxiliary_mode_unknown(s) for s in states])[state]
    is_free = np.array(
        [s.orientation == IGNORE or (s.auxiliary == "#IGNORE" and not _is_auxiliary_mode_unknown(s)) for s in states]
    )[state]
    counting_circles = np.flatnonzero(~is_free)
    is_spline_circle = is_spline(trace, rows, circular[counting_circles])
    is_strict_circle[counting_circles[~is_spline_circle]] = False
    for i in counting_circles[is_spline_circle].tolist():
        via_angles[i] = _auxiliary_angles(trace, rows, int(circular[i]), moves)
    oriented_circles = np.flatnonzero(~is_free & (is_strict_circle | ~np.isnan(via_angles).all(axis=1)))
    if not len(oriented_circles):
        return is_left_out
    turns_otherwise = _turns_otherwise(
        (ends[0][oriented_circles], ends[1][oriented_circles]),
        tuple(column[oriented_circles] for column in arcs),
        via_angles[oriented_circles],
        control.turns_with_path[circular[oriented_circles]],
        is_strict_circle[oriented_circles],
    )
    for i in np.flatnonzero(turns_otherwise).tolist():
        settings.refuse_uncertain(states[state[oriented_circles[i]]], ["auxiliary"])
        line, is_strict = int(rows.line[circular[oriented_circles[i]]]), bool(is_strict_circle[oriented_circles[i]])
        raise trace.error(_THROUGH_MESSAGE if is_strict else _LONGER_MESSAGE, line, _ADVICE[is_strict])
    is_left_out[oriented_circles] = (
        True  # an orientation on the rotation of a whole circle need not be on those of its pieces
    )
    return is_left_out


def _turns_otherwise(
    ends: tuple[Array, Array], arcs: tuple[Array, ...], via_angles: Array, with_path: Bools, is_strict: Bools
) -> Bools:
    """Return the circles (n,) on which the auxiliary orientation turns the tool otherwise than by the shorter rotation.

    :param ends: tool frames (n, 4, 4) at start and end, `$BASE` [m].
    :param arcs: centres, axes and auxiliary points (n, 3) [m], angles (n,) [rad] of the circles.
    :param via_angles: A, B, C (n, 3) [deg] of the auxiliary points, NaN where they are those of the start.
    :param with_path: (n,) True where the orientation is kept relative to the path, which itself turns the tool.
    :param is_strict: (n,) True where the tool takes on the orientation in the auxiliary point (#INTERPOLATE).
    """
    start, end = ends
    centre, axis, points, angle = arcs
    numbers = xyzabc_from_pose(start)
    numbers[:, 3:] = np.where(np.isnan(via_angles), numbers[:, 3:], via_angles)
    start_orientation, via_orientation, end_orientation = (
        start[:, :3, :3],
        pose_from_xyzabc(numbers)[:, :3, :3],
        end[:, :3, :3],
    )
    start_radius, via_radius = start[:, :3, 3] - centre, points - centre
    via_turn = np.arctan2(
        np.einsum("ij,ij->i", axis, np.cross(start_radius, via_radius)), np.einsum("ij,ij->i", start_radius, via_radius)
    )
    via_turn %= 2.0 * np.pi
    path_axis = np.where(with_path, -1.0, 0.0)[:, None] * axis
    via_orientation, end_orientation = (
        rotation_from_vector(via_turn[:, None] * path_axis) @ via_orientation,
        rotation_from_vector(angle[:, None] * path_axis) @ end_orientation,
    )
    shorter_rotation = rotation_vector(end_orientation @ np.swapaxes(start_orientation, 1, 2))
    passed_orientation = rotation_from_vector((via_turn / angle)[:, None] * shorter_rotation) @ start_orientation
    return np.where(
        is_strict,
        angle_between(passed_orientation, via_orientation) > _ON_THE_WAY,
        _is_longer_way_closer(start_orientation, shorter_rotation, via_orientation),
    )


def _is_longer_way_closer(first: Array, short: Array, via: Array) -> Bools:
    """Return where the longer way round (n,) comes as close to an orientation as the shorter, or closer.

    From R₀ by φ about k, cos of the angle to R_v is a + ρ·cos(φ − φ₀): the place of a way nearest φ₀ is the nearest.

    :param first: R₀ (n, 3, 3); short: shorter rotation (n, 3) [rad], about k; via: R_v (n, 3, 3).
    """
    size = norm(short)
    axis = short / np.maximum(size, _NO_TURN)[:, None]
    via_rotation = via @ np.swapaxes(first, 1, 2)
    cosine = np.trace(via_rotation, axis1=1, axis2=2) - np.einsum("ni,nij,nj->n", axis, via_rotation, axis)
    sine = -np.einsum("nij,nji->n", hat(axis), via_rotation)
    nearest = np.arctan2(sine, cosine)

    def angle(middle: Array, half: Array) -> Array:
        """Return the smallest angle (n,) [rad] to R_v of the rotations by middle − half … middle + half about k."""
        rotation = middle + np.clip((nearest - middle + np.pi) % (2.0 * np.pi) - np.pi, -half, half)
        return angle_between(rotation_from_vector(rotation[:, None] * axis) @ first, via)

    shorter_angle, longer_angle = angle(0.5 * size, 0.5 * size), angle(0.5 * size + np.pi, np.pi - 0.5 * size)
    return (shorter_angle > _ON_THE_WAY) & (shorter_angle > longer_angle - _ON_THE_WAY) & (size >= _NO_TURN)


def _auxiliary_angles(trace: Trace, rows: MotionColumns, row: int, moves: Mapping[int, MotionStatement]) -> list[float]:
    """Return A, B, C [deg] of the auxiliary point of a circle, NaN where missing."""
    if row in moves:
        via = moves[row].via
        return [np.nan] * 3 if via is None else list(via.position.values[3:6])
    items = parse_aggregate(trace.source(rows.line.item(row)), *rows.via_target[row].tolist()).items
    return [item.value if isinstance(item := items.get(name), Number) else np.nan for name in "ABC"]


def _is_auxiliary_mode_unknown(state: State) -> bool:
    """Return whether `$CIRC_MODE.AUX_PT.ORI` is not known in a state."""
    return any(field == "auxiliary" for field, _ in state.uncertain_fields)
