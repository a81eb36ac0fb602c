"""Orientations of the auxiliary points of SCIRC: by which rotation the tool turns.

KUKA, KSS 8.x, `$CIRC_MODE.AUX_PT.ORI`: under #CONSIDER, the default, the tool turns from the start to the end by the
shorter or the longer rotation, whichever comes closer to the orientation of the auxiliary point: anywhere on the way.
Under #INTERPOLATE it takes on that orientation there; how it turns on both sides is not published. Under #IGNORE, and
under `$ORI_TYPE=#IGNORE`, it turns by the shorter rotation. CIRC disregards auxiliary orientations.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from msgspec import Struct

from postproc.dialects.krl.language.expressions import parse_aggregate
from postproc.dialects.krl.language.motion_statements import MotionStatement
from postproc.dialects.krl.language.trace import Trace
from postproc.dialects.krl.language.values import Number
from postproc.dialects.krl.layout import IGNORE
from postproc.dialects.krl.read.end_poses import Arcs
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.dialects.krl.read.spline_blocks import is_spline
from postproc.dialects.krl.read.state import MotionStates, State
from postproc.errors import ProgramError
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
_LONGER_ADVICE = "Leave A, B, C out of the auxiliary point, or give those of half the way; or use CIRC."
_THROUGH_ADVICE = "Use #CONSIDER or #IGNORE, or divide the circle at its auxiliary point into two."
_LEAST_ROTATION = 1e-6
"""A tool that turns by less than this [rad] keeps its orientation: the rotation has no axis."""
_ORIENTATION_TOLERANCE = 0.01 * RAD_PER_DEG
"""Orientations that differ by less than this [rad] count as equal, and so do two such differences."""


class Circles(Struct, frozen=True, eq=False):
    """n circles of a program.

    :param rows: (n,) rows of their motions.
    :param start: (n, 4, 4) tool frames at their starts, in `$BASE` [m].
    :param end: (n, 4, 4) tool frames at their targets, in `$BASE` [m].
    :param via: (n, 3) auxiliary points in `$BASE` [m].
    :param arcs: arcs through start, auxiliary point and end point as the text gives them.
    """

    rows: Ints
    start: Array
    end: Array
    via: Array
    arcs: Arcs

    def take(self, indices: Ints) -> Circles:
        """Return some of the circles, given by their `indices` (k,)."""
        arcs = Arcs(*(column[indices] for column in self.arcs))
        return Circles(self.rows[indices], self.start[indices], self.end[indices], self.via[indices], arcs)


class AuxiliaryOrientations(Struct, frozen=True, eq=False):
    """Orientations of the auxiliary points of n circles.

    :param angles: (n, 3) A, B, C [deg]; NaN where they are missing or have no effect.
    :param is_led_through: (n,) True where the tool takes on the orientation in the auxiliary point, or may
        (#INTERPOLATE).
    """

    angles: Array
    is_led_through: Bools

    @property
    def has_effect(self) -> Bools:
        """True for the circles (n,) whose auxiliary orientation may act.

        That is so if the tool takes on this orientation, or if its angles, not all NaN, may choose the rotation.
        Corrected circles need #IGNORE then: correction divides a circle into shorter arcs, and the rotation on one of
        them need not pass the orientation that the rotation of the whole circle passes.
        """
        return np.asarray(self.is_led_through | ~np.isnan(self.angles).all(axis=1))


def auxiliary_orientations(
    trace: Trace,
    columns: MotionColumns,
    moves: Mapping[int, MotionStatement],
    circle_rows: Ints,
    states: MotionStates,
) -> AuxiliaryOrientations:
    """Return the orientations of the auxiliary points of circles.

    :param columns: all motions of the program.
    :param moves: row → statement, for motions that are not read in bulk.
    :param circle_rows: (n,) indices of the circles among them.
    :param states: (n,) settings in force at the circles.
    """
    may_act = is_spline(trace, columns, circle_rows) & ~states.column(_ignores_auxiliary)
    angles = np.full((len(circle_rows), 3), np.nan)
    for index in np.flatnonzero(may_act).tolist():
        angles[index] = _auxiliary_angles(trace, columns, circle_rows.item(index), moves)
    return AuxiliaryOrientations(angles, may_act & states.column(_may_lead_through))


def first_other_rotation(circles: Circles, orientations: AuxiliaryOrientations, turns_with_path: Bools) -> int | None:
    """Return the index of the first circle on which the tool does not turn by the shorter rotation; None without one.

    :param orientations: orientations of the auxiliary points of the n circles.
    :param turns_with_path: (n,) True where the orientation is kept relative to the path, which itself turns the tool.
    """
    indices = np.flatnonzero(orientations.has_effect)
    if not len(indices):
        return None
    has_other_rotation = _has_other_rotation(
        circles.take(indices),
        orientations.angles[indices],
        turns_with_path[indices],
        orientations.is_led_through[indices],
    )
    return int(indices[np.argmax(has_other_rotation)]) if has_other_rotation.any() else None


def other_rotation_error(trace: Trace, row: int, *, is_led_through: bool) -> ProgramError:
    """Return the error that the tool does not turn by the shorter rotation on a circle.

    :param row: row of the circle in the trace, from 1.
    :param is_led_through: True if the tool turns through the orientation of the auxiliary point; False if it turns by
        the longer rotation.
    """
    problem, advice = (_THROUGH_MESSAGE, _THROUGH_ADVICE) if is_led_through else (_LONGER_MESSAGE, _LONGER_ADVICE)
    return trace.error(problem, row, advice)


def _has_other_rotation(circles: Circles, via_angles: Array, turns_with_path: Bools, is_led_through: Bools) -> Bools:
    """Return where (n,) the auxiliary orientation turns the tool otherwise than by the shorter rotation.

    #INTERPOLATE: the shorter rotation misses the orientation where the arc passes the auxiliary point. Other modes: the
    longer rotation comes closer to the orientation than the shorter one.

    :param via_angles: A, B, C (n, 3) [deg] of the auxiliary points; NaN: the angle of the start.
    :param turns_with_path: (n,) True where the orientation is kept relative to the path, which itself turns the tool.
    :param is_led_through: (n,) True where the tool takes on the orientation in the auxiliary point (#INTERPOLATE).
    """
    centre, axis, angle = circles.arcs
    numbers = xyzabc_from_pose(circles.start)  # X…C; A, B, C are replaced by those of the auxiliary points
    numbers[:, 3:] = np.where(np.isnan(via_angles), numbers[:, 3:], via_angles)
    start_radius, via_radius = circles.start[:, :3, 3] - centre, circles.via - centre
    # angle of the arc from its start to the auxiliary point
    via_turn = np.arctan2(
        np.einsum("ij,ij->i", axis, np.cross(start_radius, via_radius)), np.einsum("ij,ij->i", start_radius, via_radius)
    )
    via_turn %= 2.0 * np.pi
    # undoes the rotation of the path, so that orientations are relative to the path if they are kept so
    path_axis = np.where(turns_with_path, -1.0, 0.0)[:, None] * axis
    start_orientation = circles.start[:, :3, :3]
    via_orientation = rotation_from_vector(via_turn[:, None] * path_axis) @ pose_from_xyzabc(numbers)[:, :3, :3]
    end_orientation = rotation_from_vector(angle[:, None] * path_axis) @ circles.end[:, :3, :3]
    shorter_rotation = rotation_vector(end_orientation @ np.swapaxes(start_orientation, 1, 2))
    # the shorter rotation is in proportion to the path
    passed_orientation = rotation_from_vector((via_turn / angle)[:, None] * shorter_rotation) @ start_orientation
    return np.where(
        is_led_through,
        angle_between(passed_orientation, via_orientation) > _ORIENTATION_TOLERANCE,
        _is_longer_way_closer(start_orientation, shorter_rotation, via_orientation),
    )


def _is_longer_way_closer(start: Array, shorter_rotation: Array, via: Array) -> Bools:
    """Return where (n,) the longer rotation comes as close to an orientation as the shorter rotation, or closer.

    Turned from R₀ by φ about the axis k, the tool differs from R_v by an angle whose cosine is a + ρ·cos(φ − φ₀). The
    shorter rotation passes φ = 0 … θ, the longer one φ = 2π … θ. So each comes closest to R_v at its φ nearest to φ₀.

    False where the shorter rotation passes R_v, and where the tool does not turn.

    :param start: orientations R₀ (n, 3, 3).
    :param shorter_rotation: rotation vectors k·θ (n, 3) [rad].
    :param via: orientations R_v (n, 3, 3).
    """
    size = norm(shorter_rotation)
    axis = shorter_rotation / np.maximum(size, _LEAST_ROTATION)[:, None]
    # φ₀: with Q = R_v·R₀ᵀ, ρ·cos φ₀ is tr Q − kᵀ·Q·k, and ρ·sin φ₀ is −tr(k̂·Q)
    via_rotation = via @ np.swapaxes(start, 1, 2)
    cosine = np.trace(via_rotation, axis1=1, axis2=2) - np.einsum("ni,nij,nj->n", axis, via_rotation, axis)
    sine = -np.einsum("nij,nji->n", hat(axis), via_rotation)
    nearest_turn = np.arctan2(sine, cosine)

    def smallest_angle(middle: Array, half: Array) -> Array:
        """Return the smallest angle (n,) [rad] to R_v of the turns by middle − half … middle + half about k."""
        from_middle = (nearest_turn - middle + np.pi) % (2.0 * np.pi) - np.pi  # from −π to π
        turn = middle + np.clip(from_middle, -half, half)
        return angle_between(rotation_from_vector(turn[:, None] * axis) @ start, via)

    shorter_angle = smallest_angle(0.5 * size, 0.5 * size)  # turns by 0 … size
    longer_angle = smallest_angle(0.5 * size + np.pi, np.pi - 0.5 * size)  # turns by size … 2π
    return (
        (shorter_angle > _ORIENTATION_TOLERANCE)
        & (shorter_angle > longer_angle - _ORIENTATION_TOLERANCE)
        & (size >= _LEAST_ROTATION)
    )


def _auxiliary_angles(
    trace: Trace, columns: MotionColumns, row: int, moves: Mapping[int, MotionStatement]
) -> list[float]:
    """Return A, B, C [deg] of the auxiliary point of a circle, NaN where missing.

    :param row: index of the circle among all motions.
    :param moves: row → statement, for motions that are not read in bulk.
    """
    if row in moves:
        via = moves[row].via
        return [np.nan] * 3 if via is None else list(via.position.values[3:6])
    items = parse_aggregate(trace.source(columns.trace_row.item(row)), *columns.via_target[row].tolist()).items
    return [item.value if isinstance(item := items.get(name), Number) else np.nan for name in "ABC"]


def _is_auxiliary_mode_unknown(state: State) -> bool:
    """Return whether `$CIRC_MODE.AUX_PT.ORI` is not known in a state."""
    return any(field == "auxiliary" for field, _ in state.uncertain_fields)


def _ignores_auxiliary(state: State) -> bool:
    """Return whether auxiliary orientations surely have no effect in a state."""
    return state.orientation == IGNORE or (state.auxiliary == "#IGNORE" and not _is_auxiliary_mode_unknown(state))


def _may_lead_through(state: State) -> bool:
    """Return whether the tool takes on auxiliary orientations in a state, or may."""
    return state.auxiliary == "#INTERPOLATE" or _is_auxiliary_mode_unknown(state)
