"""What remains of a part after all passes of a tool that deflects: a height field swept at dense samples of the path.

For tools whose axis is +z. Above a place (x, y) the part remains up to the lowest point of the underside of all tools
that pass over it. Shares no code with the package, and knows neither normals of tools nor places of contact.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Tool(NamedTuple):
    """Radius and radius of the corner [m]."""

    radius: float
    corner: float

    def underside(self, distance):
        """Height over the tip at distances from the axis [m]; infinite beyond the radius."""
        flat = self.radius - self.corner
        on_corner = np.clip(distance - flat, 0.0, self.corner)
        height = self.corner - np.sqrt(self.corner**2 - on_corner**2)
        return np.where(distance <= self.radius, height, np.inf)


class Pass(NamedTuple):
    """A pass of a tool along a polyline: tips (n, 3) and deviations of the tip (n, 3) [m]."""

    tool: Tool
    tip: np.ndarray
    deviation: np.ndarray


def sampled(passes, step):
    """Return per tool the deflected tips (N, 3), at most `step` [m] apart, of polylines that deflect linearly."""
    tips = {}
    for tool, tip, deviation in passes:
        length = np.linalg.norm(np.diff(tip, axis=0), axis=1)
        for start, end, start_deviation, end_deviation, run in zip(
            tip[:-1], tip[1:], deviation[:-1], deviation[1:], length, strict=True
        ):
            share = np.linspace(0.0, 1.0, int(run / step) + 2)[:, None]
            point = (1.0 - share) * start + share * end
            tips.setdefault(tool, []).append(point + (1.0 - share) * start_deviation + share * end_deviation)
    return {tool: np.concatenate(points) for tool, points in tips.items()}


def height(tips, x, y):
    """Return the height that remains above one place; infinite where no tool passes."""
    lowest = np.inf
    for tool, point in tips.items():
        near = point[np.abs(point[:, 0] - x) <= tool.radius]
        distance = np.hypot(near[:, 0] - x, near[:, 1] - y)
        lowest = min(lowest, (near[:, 2] + tool.underside(distance)).min(initial=np.inf))
    return lowest


def along_normal(tips, centre, normal, window):
    """Return up to where the part remains along a normal through one point: [−window, window], by bisection.

    :returns: inf if the part remains all along, −inf if nothing does.
    """
    near = {
        tool: point[np.linalg.norm(point[:, :2] - centre[:2], axis=1) <= tool.radius + window]
        for tool, point in tips.items()
    }

    def is_part(s):
        at = centre + s * normal
        return at[2] < height(near, at[0], at[1])

    low, high = -window, window
    if not is_part(low):
        return -np.inf
    if is_part(high):
        return np.inf
    while high - low > 1e-8:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_part(middle) else (low, middle)
    return 0.5 * (low + high)
