"""Tools that turn while they move rapidly (PTP, rapid moves with a rotation) against the stock.

The map of the stock is compared with points of the tool: of its end, and of its cylinder, which goes on along the axis
without an end. The tool is taken smaller by a cell of the map, which locates walls no better; a flat end is not, as the
map has the levels of flat surfaces exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from postproc.frames import Array, norm
from postproc.machining.stock import Stock
from postproc.machining.tool import Cutter
from postproc.program import Ints

_FLUSH = 2e-5
"""Ends of tools that are less deep below a surface [m] only touch it: levels are single precision, cuts end there."""
_FEWEST_ANGLES, _MOST_ANGLES = 12, 48
"""Number of points around the tool; between those limits they are a cell apart (assumed)."""
_POSES_AT_ONCE = 128
"""Poses of the tool that are compared at once: it limits memory."""


def depth_inside(stock: Stock, cutter: Cutter, tip: Array, axis: Array) -> float:
    """Return the largest depth of a tool in n poses below the surface of the stock [m]; 0 if none is in material.

    :param tip: (n, 3) positions of the tip, frame of the height map [m].
    :param axis: (n, 3) unit directions from the tip to the spindle, frame of the map.
    """
    depth = 0.0
    for first in range(0, len(tip), _POSES_AT_ONCE):
        rows = slice(first, first + _POSES_AT_ONCE)
        depth = max(depth, _largest_depth(stock, cutter, tip[rows], axis[rows]))
    return depth


def _largest_depth(stock: Stock, cutter: Cutter, tip: Array, axis: Array) -> float:
    """Return the largest depth in material of points inside the cutter, one cell from its surface [m]; 0 if none is.

    :param tip: (n, 3) positions of the tip [m], and `axis` (n, 3) unit directions to the spindle, frame of the map.
    """
    radius = max(cutter.radius - stock.cell, 0.0)
    pose, ring_radius, height = _rings(stock, cutter, tip, axis, radius)
    if not len(pose):
        return 0.0
    angle_count = int(np.clip(np.ceil(2.0 * np.pi * radius / stock.cell), _FEWEST_ANGLES, _MOST_ANGLES))
    angle = np.arange(angle_count) * (2.0 * np.pi / angle_count)
    first_direction, second_direction = _perpendicular_directions(axis)
    radial = (
        np.cos(angle)[:, None] * first_direction[pose][:, None]
        + np.sin(angle)[:, None] * second_direction[pose][:, None]
    )
    centre = tip[pose] + height[:, None] * axis[pose]
    points = (centre[:, None] + ring_radius[:, None, None] * radial).reshape(-1, 3)
    column = np.floor((points[:, 0] - stock.x) / stock.cell).astype(np.int64)
    row = np.floor((points[:, 1] - stock.y) / stock.cell).astype(np.int64)
    rows, columns = stock.high.shape
    is_on_map = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    row, column, z = row[is_on_map], column[is_on_map], points[is_on_map, 2]
    floor = stock.floor[row, column]
    # of the two levels of a cell, the one with the larger share of its area counts
    level = np.where(stock.share[row, column] < 0.5, stock.high[row, column], stock.low[row, column])
    in_material = (z > floor) & (z < level)
    return float((level - z)[in_material].max(initial=0.0))


class _Rings(NamedTuple):
    """k circles about the axis of a tool, on its surface.

    :param pose: (k,) row of the pose of the tool.
    :param radius: (k,) [m].
    :param height: (k,) above the tip [m].
    """

    pose: Ints
    radius: Array
    height: Array


def _rings(stock: Stock, cutter: Cutter, tip: Array, axis: Array, radius: float) -> _Rings:
    """Return circles about the axis, on the surface of the tool and near the stock.

    :param tip: (n, 3) positions of the tip [m], and `axis` (n, 3) unit directions to the spindle, frame of the map.
    :param radius: radius of the tool less a cell of the height map [m].
    """
    x_low, x_high, y_low, y_high = stock.bounds
    low = np.array([x_low, y_low, float(stock.floor.min())]) - radius
    high = np.array([x_high, y_high, stock.top]) + radius
    reach = float(norm(np.maximum(np.abs(tip - low), np.abs(tip - high))).max())
    # the tool is taken smaller by a cell at its corner too; a flat end is raised by `_FLUSH` only
    corner = max(cutter.corner - stock.cell, 0.0)
    inner_cutter = Cutter(radius, min(corner, radius), cutter.teeth)
    end_radii = np.linspace(0.0, radius, max(2, int(np.ceil(radius / stock.cell)) + 1))
    end_height = _FLUSH if cutter.corner == 0.0 else stock.cell
    # along the cylinder the depth changes slowly: rings are two cells or a quarter of the radius apart (assumed)
    shank_heights = np.arange(end_height + inner_cutter.corner, reach, max(2.0 * stock.cell, 0.25 * radius))
    ring_radii = np.concatenate([end_radii, np.full(len(shank_heights), radius)])
    height = np.concatenate([end_height + inner_cutter.lower_side(end_radii), shank_heights])
    centre = tip[:, None] + height[:, None] * axis[:, None]
    pose, ring = np.nonzero(((centre > low) & (centre < high)).all(axis=2))
    return _Rings(pose, ring_radii[ring], height[ring])


def _perpendicular_directions(direction: Array) -> tuple[Array, Array]:
    """Return two unit vectors (n, 3) for each of n unit vectors `direction` (n, 3): square to it and to each other."""
    # x, or y where the direction is near x: a cross product with a parallel axis would be zero
    axis = np.where(np.abs(direction[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first_direction = np.cross(direction, axis)
    first_direction /= norm(first_direction)[:, None]
    return first_direction, np.cross(direction, first_direction)
