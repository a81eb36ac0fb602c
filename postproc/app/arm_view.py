"""The picture of a cell as lines of an SVG: one view of arm, tool and `$BASE`."""

from __future__ import annotations

from typing import Any

import numpy as np

from postproc.frames import Array
from postproc.jobs.cell_picture import CellPicture

_AXIS_MM = 350.0
"""Length of the drawn axes of $BASE [mm]."""
_MARGIN_SHARE = 0.08
"""Free space around the drawing, as a share of its span."""
_MIN_NAMED_SHARE = 0.3
"""Share of its length from which on a drawn axis has its name: an axis towards the reader has none."""
_LETTER_SHARE, _BOX_HEIGHT_SHARE = 0.05, 0.6
"""Height of letters as a share of the height of the picture; least height of the picture as a share of its width."""


def arm_view(picture: CellPicture, name: str, axes: tuple[int, int]) -> dict[str, Any]:
    """Return a view of a cell as values for the template, in mm.

    :param name: title of the view.
    :param axes: indices of the root axes to the right and upwards, such as (0, 2) from the side.
    """

    def projected(points: Array) -> Array:
        """Return points (…, 3) of the root as points (…, 2) of the picture, whose second axis points down as in SVG."""
        return np.asarray(points[..., list(axes)] * np.array([1.0, -1.0]))

    arm, tip, base = projected(picture.arm), projected(picture.tip), projected(picture.base)
    ends = projected(picture.base + _AXIS_MM * picture.base_axes)
    corners = np.vstack([arm, tip, base, ends])
    low, high = corners.min(axis=0), corners.max(axis=0)
    span = float(max(high - low))
    low, high = low - _MARGIN_SHARE * span, high + _MARGIN_SHARE * span
    lines = [
        {"name": letter if np.linalg.norm(end - base) > _MIN_NAMED_SHARE * _AXIS_MM else "", **_line(base, end)}
        for letter, end in zip("XYZ", ends, strict=True)  # an axis towards the reader is too short for its name
    ]
    return {
        "name": name,
        "box": f"{low[0]:.0f} {low[1]:.0f} {high[0] - low[0]:.0f} {high[1] - low[1]:.0f}",
        "left": f"{low[0]:.0f}",
        "right": f"{high[0]:.0f}",
        "size": f"{_LETTER_SHARE * max((high - low)[1], _BOX_HEIGHT_SHARE * (high - low)[0]):.0f}",
        "arm": _points(arm),
        "tool": _points(np.vstack([arm[-1], tip])),
        "axes": lines,
        "tip_text": ", ".join(f"{coordinate:.0f}" for coordinate in picture.tip),
        "base_text": ", ".join(f"{coordinate:.0f}" for coordinate in picture.base),
    }


def _points(points: Array) -> str:
    """Return points (n, 2) as the attribute `points` of an SVG polyline."""
    return " ".join(f"{x:.0f},{y:.0f}" for x, y in points)


def _line(start: Array, end: Array) -> dict[str, str]:
    """Return the attributes of an SVG line from start (2,) to end (2,)."""
    return dict(zip(("x1", "y1", "x2", "y2"), (f"{value:.0f}" for value in (*start, *end)), strict=True))
