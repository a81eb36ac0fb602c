"""The poses in space: arms, loads, reference points, and what stands around."""

from __future__ import annotations

import numpy as np

from postproc.frames import Array
from postproc.plan import PlanResult
from postproc.plan.site import BoxShape
from postproc.report.kit import Lines, Plot, Section
from postproc.report.kit.plots import Colour

_ARROW = 0.45
"""Length of a load [m]."""
_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]


def poses(result: PlanResult) -> Section:
    """Return all poses in one view, with a slider that shows them one by one."""
    site, count = result.site, len(result.plan)
    posed = site.arm.pose(result.plan.q)
    origin = posed.origin
    base = np.zeros_like(origin[:, :1])
    column = np.concatenate([base[..., :2], origin[:, 1:2, 2:]], axis=2)
    hook = posed.point(site.load_point[None])
    arms = np.concatenate([base, column, origin[:, 1:5], posed.flange[:, None, :3, 3], hook], axis=1)
    pull = result.force / np.linalg.norm(result.force, axis=1, keepdims=True)
    loads = np.stack([hook[:, 0], hook[:, 0] + _ARROW * pull], axis=1)
    points = posed.point(site.points)
    around = []
    if site.obstacles:
        edges = [_box(thing)[[a, b]] for thing in site.obstacles for a, b in _EDGES]
        around.append(_line(edges, "obstacles", "warning", 2.0))
    if site.tracker is not None:
        around.append(_line([site.tracker[None]], "tracker", "force", 6.0, dots=True))
    alone = [
        trace
        for pose in range(count)
        for trace in (
            _line([arms[pose]], f"pose {pose + 1}", "after", 8.0),
            _line([loads[pose]], "pull of the load", "before", 6.0),
            _line([points[pose]], "reference points", "ink", 3.0, dots=True),
        )
    ]
    every = [_line(list(arms), "arms", "after", 5.0), _line(list(loads), "pull of the loads", "before", 3.0)]
    traces = [*around, *every, *alone]
    fixed = list(range(len(around)))
    begin = len(fixed) + len(every)
    steps = [[*fixed, len(fixed), len(fixed) + 1]]
    steps += [[*fixed, *(begin + 3 * pose + index for index in range(3))] for pose in range(count)]
    plot = Plot(
        label="The arm in all poses of the plan, and in each; angles and loads are in the table below",
        traces=list(traces),
        height=560,
        steps=steps,
        step_names=["all", *(f"{pose + 1}" for pose in range(count))],
        note="Drag to turn, wheel to zoom; the slider shows one pose after the other. Orange: pull of the load; dots: "
        "reference points. Metres, robot root.",
    )
    return Section("poses", "The poses", (plot,))


def _line(pieces: list[Array], name: str, colour: Colour, width: float, *, dots: bool = False) -> Lines:
    """Return pieces (k, 3) [m] as one line with gaps."""
    gap = np.full((1, 3), np.nan)
    joined = np.concatenate([part for piece in pieces for part in (piece, gap)] or [gap])
    x, y, z = (joined[:, axis].tolist() for axis in range(3))
    return Lines(x, y, z, name, colour, width, dots)


def _box(obstacle: object) -> Array:
    """Return the eight corners of a box, or of the box around a mesh [m]."""
    signs = np.array([[1 if corner >> axis & 1 else -1 for axis in range(3)] for corner in range(8)])
    if isinstance(obstacle, BoxShape):
        rotation, shift = obstacle.to_box[:3, :3], obstacle.to_box[:3, 3]
        return np.asarray((signs * obstacle.half - shift) @ rotation)
    vertices = obstacle.vertices  # type: ignore[attr-defined]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.asarray(0.5 * (low + high) + 0.5 * signs * (high - low))
