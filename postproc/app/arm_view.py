"""The picture of a cell as lines of an SVG: one view of arm, tool and `$BASE`."""

from __future__ import annotations

from typing import Any

import numpy as np

from postproc.frames import Array
from postproc.jobs.cell_picture import CellPicture

_AXIS_MM = 350.0
"""Length at which the axes of $BASE are drawn."""
_MARGIN = 0.08
"""Free space around the drawing, as a share of its span."""
_MIN_NAMED_LENGTH = 0.3
"""Share of its length from which on an axis has its name: one that points to the reader has none."""


_LETTER_SHARE, _BOX_SHAPE = 0.05, 0.6
"""Height of letters by that of the picture, whose height is about this share of its width."""


def arm_view(picture: CellPicture, name: str, axes: tuple[int, int]) -> dict[str, Any]:
    """Return a view as the template draws it, in mm.

    :param axes: of the root, to the right and upwards, such as (0, 2) from the side.
    """

    def projected(points: Array) -> Array:
        """Return points (…, 3) in the picture (…, 2), whose second axis points down as in SVG."""
        return np.asarray(points[..., list(axes)] * np.array([1.0, -1.0]))

    arm, tip, base = projected(picture.arm), projected(picture.tip), projected(picture.base)
    ends = projected(picture.base + _AXIS_MM * picture.base_axes)
    corners = np.vstack([arm, tip, base, ends])
    low, high = corners.min(axis=0), corners.max(axis=0)
    span = float(max(high - low))
    low, high = low - _MARGIN * span, high + _MARGIN * span
    lines = [
        {"name": letter if np.linalg.norm(end - base) > _MIN_NAMED_LENGTH * _AXIS_MM else "", **_line(base, end)}
        for letter, end in zip("XYZ", ends, strict=True)
    ]
    return {
        "name": name,
        "box": f"{low[0]:.0f} {low[1]:.0f} {high[0] - low[0]:.0f} {high[1] - low[1]:.0f}",
        "left": f"{low[0]:.0f}",
        "right": f"{high[0]:.0f}",
        "size": f"{_LETTER_SHARE * max((high - low)[1], _BOX_SHAPE * (high - low)[0]):.0f}",
        "arm": _points(arm),
        "tool": _points(np.vstack([arm[-1], tip])),
        "axes": lines,
        "tip_text": ", ".join(f"{value:.0f}" for value in picture.tip),
        "base_text": ", ".join(f"{value:.0f}" for value in picture.base),
    }


def _points(points: Array) -> str:
    """Return points (n, 2) as the attribute `points` of a polyline."""
    return " ".join(f"{x:.0f},{y:.0f}" for x, y in points)


def _line(start: Array, end: Array) -> dict[str, str]:
    """Return the attributes of an SVG line from start (2,) to end (2,)."""
    return dict(zip(("x1", "y1", "x2", "y2"), (f"{value:.0f}" for value in (*start, *end)), strict=True))
