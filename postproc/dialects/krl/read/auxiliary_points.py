"""Orientations of the auxiliary points of SCIRC: which way round the tool turns.

KUKA, KSS 8.x, `$CIRC_MODE.AUX_PT.ORI`: under #CONSIDER, the default, the tool turns from the start to the end by the
shorter or the longer rotation, whichever comes closer to the orientation of the auxiliary point. CIRC disregards it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from postproc.dialects.krl.language.circles import same_orientation
from postproc.dialects.krl.language.motion_statements import MotionStatement
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.read.end_poses import Led
from postproc.dialects.krl.read.motion_columns import MotionColumns
from postproc.frames import (
    Array,
    angle_between,
    pose_from_xyzabc,
    rotation_from_vector,
    rotation_vector,
    xyzabc_from_pose,
)
from postproc.program import Bools, Ints

_ANGLES = [re.compile(rf"\b{name}[ \t]+([-+.0-9eE]+)", re.IGNORECASE) for name in "ABC"]
_CLOSER = 1e-6
"""Angle [rad] by which the longer way must come closer: less is rounding."""


def turned_the_longer_way(
    source: Source,
    rows: MotionColumns,
    circular: Ints,
    moves: Mapping[int, MotionStatement],
    ends: tuple[Array, Array],
    arcs: tuple[Array, Array, Array, Array],
    led: Led,
) -> Bools:
    """Return which circles (n,) are SCIRC whose auxiliary orientation is closer to the longer rotation.

    :param circular: (n,) rows of the circles.
    :param moves: row → statement, of those that are not plain.
    :param ends: tool frames (n, 4, 4) at start and end, `$BASE` [m].
    :param arcs: centres, axes and auxiliary points (n, 3) [m], angles (n,) [rad] of the circles.
    :param led: how the orientation is led.
    """
    out = np.zeros(len(circular), dtype=np.bool_)
    (start, end), (centre, axis, points, angle) = ends, arcs
    with_path = led.with_path[circular]
    for i in np.flatnonzero(~same_orientation(start[:, :3, :3], end[:, :3, :3]) | with_path).tolist():
        row = int(circular[i])
        if source.text[int(rows.keyword[row])] not in "sS":
            continue
        given = _orientation(source, rows, row, moves)
        if np.isnan(given).all():
            continue
        numbers = xyzabc_from_pose(start[i])
        numbers[3:] = np.where(np.isnan(given), numbers[3:], given)
        via, last = pose_from_xyzabc(numbers)[:3, :3], end[i, :3, :3]
        one, other = start[i, :3, 3] - centre[i], points[i] - centre[i]
        half = float(np.arctan2(axis[i] @ np.cross(one, other), one @ other) % (2.0 * np.pi))
        if with_path[i]:
            via, last = rotation_from_vector(-half * axis[i]) @ via, rotation_from_vector(-angle[i] * axis[i]) @ last
        first = start[i, :3, :3]
        short = rotation_vector(last @ first.T)
        size = float(np.linalg.norm(short))
        if size < _CLOSER:
            continue
        ways = half / angle[i] * np.array([1.0, 1.0 - 2.0 * np.pi / size])[:, None] * short
        shorter, longer = angle_between(rotation_from_vector(ways) @ first, np.stack([via, via]))
        out[i] = longer < shorter - _CLOSER
    return out


def _orientation(source: Source, rows: MotionColumns, row: int, moves: Mapping[int, MotionStatement]) -> Array:
    """Return A, B, C (3,) [deg] of an auxiliary point, NaN where missing."""
    if row in moves:
        via = moves[row].via
        return np.full(3, np.nan) if via is None else np.array(via.position.values[3:6])
    begin, stop = rows.via_target[row].tolist()
    found = [pattern.search(source.text, begin, stop) for pattern in _ANGLES]
    return np.array([np.nan if match is None else float(match[1]) for match in found])
