"""Features of a test part: how each is cut, and where it is probed.

A feature is a closed groove (a slot of the tool's width) of two halves. The first half is cut in one pass at full
width: its walls and its floor show the deflection of the tool under the full cutting force. The second half is trimmed
afterwards by passes that cut next to nothing: its walls and floor, a few centimetres away, show the path of the robot
without force, and the probe's own error. A step is a groove that a second pass widens to one side under load.

In the axes of a feature u is along the groove, v to its left and w up; the origin is in the middle of the groove on
the top of the block. The loaded half is at u < 0. The spindle turns clockwise (M3): a pass towards −u that cuts the
wall at +v is down-milling, at −v up-milling. Lengths in metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from postproc.decimals import without_negative_zero
from postproc.errors import PlanError
from postproc.frames import MM_PER_M, Array

_HALF_LENGTH_DIAMETERS = 1.6
"""Length of each half of a groove, in tool diameters: probed points are more than a radius from the ends of a cut."""
_PROBE_SHARE = 0.5
"""Distance of the probed points of a half from the middle of the groove, as a share of the length of the half."""
_FLOOR_PROBE_SHARE = 0.6
"""Distance of a probed floor from the middle line of its pass, over the radius (assumed), where there is a step."""
_STEP_WIDTH_DIAMETERS = 0.4
"""Width of a step, in tool diameters (assumed)."""
_LAST_SIDE, _LAST_FLOOR = 0.1e-3, 0.05e-3
"""Depth that the last trimming passes take off walls, and off the floor [m] (assumed)."""
_FLOOR_TRIM_SHARE = 0.4
"""Depth that the first trimming passes take off the floor, as a share of the depth at walls (assumed)."""
LEAST_TRIM = 0.3e-3
"""Least value of `Cutting.trim` [m] (assumed)."""
_CLEARANCE_HEIGHT = 5e-3
"""Height of rapid moves above the block [m] (assumed)."""
_END_HEIGHT = 20e-3
"""Height above the block at which the spindle stops after cutting [m] (assumed)."""
_ENTRY_HEIGHT = 0.2e-3
"""Height above the block at which the tool begins to descend into it [m] (assumed)."""
_WALL_DIAMETERS = 0.5
"""Wall left between features, in tool diameters (assumed)."""
_PLUNGE_FEED_SHARE = 0.5
"""Feed of ramps and entries, as a share of the feed (assumed)."""
_HANG_HEIGHT = 0.2
"""Height above the block at which a weight is hung on the tool [m] (assumed)."""
_TOUCH_EDGE_DISTANCE, _TOUCH_WALL_DISTANCE = 5e-3, 2e-3
"""Distance of touch-off points from the edge of the block, and from the walls of features [m] (assumed)."""
_TOUCH_PITCH = 2e-3
"""Distance between the places that are tried for touch-off points [m] (assumed)."""
_MOST_TOUCH_PLACES = 100.0
"""Largest number of these places along a side of the block (assumed): the pitch grows with the block."""
_FEWEST_TOUCHES = 3
"""Fewest touch-off points: three determine a plane, its height and two slopes."""
RAPID = 0.1
"""Speed of rapid moves for the estimate of the time [m/s] (assumed)."""


class Trim(NamedTuple):
    """Depths of a trimming pass beyond the groove: at its walls, and at its floor [m]."""

    wall: float
    floor: float


class Cutting(Struct, frozen=True):
    """How the part is cut.

    :param diameter: diameter of the tool [m].
    :param rpm: spindle speed [1/min].
    :param feed: [m/s].
    :param tool: number of the tool.
    :param top: Z of the upper face of the block, `$BASE` [m].
    :param trim: depth that the first trimming passes take off walls [m]: more than the tool deflects.
    """

    diameter: float
    rpm: float
    feed: float
    tool: int
    top: float
    trim: float = LEAST_TRIM

    @property
    def trims(self) -> tuple[Trim, ...]:
        """The trimming passes: one that takes off the deflection, and a last one that cuts next to nothing."""
        first = Trim(wall=self.trim, floor=_FLOOR_TRIM_SHARE * self.trim)
        return first, Trim(wall=first.wall + _LAST_SIDE, floor=first.floor + _LAST_FLOOR)


class Kind(Struct, frozen=True):
    """A groove or a step at one place of the part.

    :param depth: depth of the groove [m].
    :param side: 0: a groove without a step; 1: with a step that is cut down-milling; −1: up-milling.
    """

    depth: float
    side: int

    @property
    def title(self) -> str:
        """The kind in words."""
        return {0: "groove", 1: "step, down-milling", -1: "step, up-milling"}[self.side]


class Feature(Struct, frozen=True):
    """A feature at its place: middle (x, y) [m] and direction of u [rad] in `$BASE`."""

    kind: Kind
    x: float
    y: float
    angle: float


class Pass(Struct, frozen=True):
    """A straight move of the tool tip in the axes of the feature.

    :param end: (u, v, w) of its end [m].
    :param feed_share: its feed as a share of the feed of cuts; 0 for a rapid move.
    :param name: name of the pass if it makes probed surfaces; else empty.
    """

    end: tuple[float, float, float]
    feed_share: float
    name: str = ""

    @property
    def is_rapid(self) -> bool:
        """Whether it is a rapid move."""
        return self.feed_share == 0.0


class Probe(Struct, frozen=True):
    """A probed point in the axes of a feature.

    :param name: name of its surface.
    :param made_by: name of the pass that makes the surface.
    :param point: (u, v, w) [m].
    :param normal: (3,) unit normal out of the material.
    """

    name: str
    made_by: str
    point: tuple[float, float, float]
    normal: tuple[float, float, float]


def half_length(diameter: float) -> float:
    """Return half the length of the path of a groove [m]."""
    return _HALF_LENGTH_DIAMETERS * diameter


def outline(kind: Kind, cutting: Cutting) -> tuple[float, float]:
    """Return v of the middle of the strip that a feature takes, and half the width of the strip [m].

    The strip includes half of the wall that is left to each neighbour.
    """
    step = _STEP_WIDTH_DIAMETERS * cutting.diameter * kind.side
    return 0.5 * step, 0.5 * (1.0 + _WALL_DIAMETERS) * cutting.diameter + cutting.trims[-1].wall + 0.5 * abs(step)


def passes(kind: Kind, cutting: Cutting) -> list[Pass]:
    """Return the moves that cut a feature, from above the block to above the block.

    Their ends are in the axes of the feature: u along it, v to its left, w up from the top of the block.

    First the groove is cut along −u, its half u > 0 by a ramp there and back. Then follow the step, if there is one,
    and the trimming passes along the half u > 0, whose surfaces are the reference.
    """
    end_u, floor_w = half_length(cutting.diameter), -kind.depth
    step_v = _STEP_WIDTH_DIAMETERS * cutting.diameter * kind.side
    groove_moves = [
        Pass((end_u, 0.0, _CLEARANCE_HEIGHT), 0.0),
        Pass((end_u, 0.0, _ENTRY_HEIGHT), _PLUNGE_FEED_SHARE),
        Pass((0.0, 0.0, 0.5 * floor_w), _PLUNGE_FEED_SHARE),
        Pass((end_u, 0.0, floor_w), _PLUNGE_FEED_SHARE),
        Pass((0.0, 0.0, floor_w), 1.0),
        Pass((-end_u, 0.0, floor_w), 1.0, "groove"),
        Pass((-end_u, 0.0, _CLEARANCE_HEIGHT), 0.0),
    ]
    step_moves = [
        Pass((end_u, 0.0, _CLEARANCE_HEIGHT), 0.0),
        Pass((end_u, 0.0, floor_w), _PLUNGE_FEED_SHARE),
        Pass((end_u, step_v, floor_w), _PLUNGE_FEED_SHARE),
        Pass((0.0, step_v, floor_w), 1.0),
        Pass((-end_u, step_v, floor_w), 1.0, "step"),
        Pass((-end_u, step_v, _CLEARANCE_HEIGHT), 0.0),
    ]
    return [*groove_moves, *(step_moves if kind.side else []), *_trimming_moves(kind, cutting)]


def _trimming_moves(kind: Kind, cutting: Cutting) -> list[Pass]:
    """Return the moves that trim walls and floor of the half u > 0, from above the block to above the block."""
    end_u, floor_w = half_length(cutting.diameter), -kind.depth
    step_v = _STEP_WIDTH_DIAMETERS * cutting.diameter * kind.side  # displacement of the second pass; 0: no step
    moves = []
    for number, trim in enumerate(cutting.trims):
        # v of the tool at the left and at the right wall, and w of its tip
        left_v, right_v, trim_w = max(step_v, 0.0) + trim.wall, min(step_v, 0.0) - trim.wall, floor_w - trim.floor
        is_last = number == len(cutting.trims) - 1  # its surfaces are probed
        moves += [
            Pass((end_u, 0.5 * step_v, _CLEARANCE_HEIGHT), 0.0),
            Pass((end_u, 0.5 * step_v, trim_w), _PLUNGE_FEED_SHARE),
            Pass((end_u, left_v, trim_w), _PLUNGE_FEED_SHARE),
            Pass((0.0, left_v, trim_w), 1.0, "trim left" if is_last else ""),
            Pass((0.0, right_v, trim_w), _PLUNGE_FEED_SHARE),
            Pass((end_u, right_v, trim_w), 1.0, "trim right" if is_last else ""),
            Pass((end_u, right_v, _CLEARANCE_HEIGHT), 0.0),
        ]
    return moves


def probes(kind: Kind, cutting: Cutting) -> list[Probe]:
    """Return the probed points of a feature: on the surfaces of the loaded half, then on those of the trimmed half.

    Points are (u, v, w) [m]: u along the groove, negative in the loaded half; v to its left; w up from the top.
    """
    radius, side = 0.5 * cutting.diameter, kind.side
    step_v = _STEP_WIDTH_DIAMETERS * cutting.diameter * side
    trimmed_u = _PROBE_SHARE * half_length(cutting.diameter)
    loaded_u, trim = -trimmed_u, cutting.trims[-1]
    middle_w, floor_w, trim_w = -0.5 * kind.depth, -kind.depth, -kind.depth - trim.floor
    # normals out of the material: that of the left wall points to the right
    left_normal, right_normal, up = (0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    trim_left_v, trim_right_v = max(step_v, 0.0) + trim.wall, min(step_v, 0.0) - trim.wall
    loaded_probes = [
        Probe("left", "step" if side > 0 else "groove", (loaded_u, max(step_v, 0.0) + radius, middle_w), left_normal),
        Probe("right", "step" if side < 0 else "groove", (loaded_u, min(step_v, 0.0) - radius, middle_w), right_normal),
        # not where the pass of the step cuts the floor of the groove once more
        Probe("floor", "groove", (loaded_u, -_FLOOR_PROBE_SHARE * radius * side, floor_w), up),
    ]
    if side:
        loaded_probes.append(
            Probe("step_floor", "step", (loaded_u, step_v + _FLOOR_PROBE_SHARE * radius * side, floor_w), up)
        )
    return [
        *loaded_probes,
        Probe("ref_left", "trim left", (trimmed_u, trim_left_v + radius, middle_w), left_normal),
        Probe("ref_right", "trim right", (trimmed_u, trim_right_v - radius, middle_w), right_normal),
        Probe("ref_floor", "trim right", (trimmed_u, trim_right_v, trim_w), up),
    ]


def seconds(kind: Kind, cutting: Cutting) -> float:
    """Return the time that the moves of a feature take [s], without the move to the begin of the first one."""
    total, last_end = 0.0, None
    for move in passes(kind, cutting):
        end = np.array(move.end)
        if last_end is not None:
            speed = RAPID if move.is_rapid else move.feed_share * cutting.feed
            total += float(np.linalg.norm(end - last_end)) / speed
        last_end = end
    return total


def to_base(feature: Feature, top: float, vectors: Array, *, is_direction: bool = False) -> Array:
    """Return points (n, 3) in `$BASE` [m] that are given in the axes u, v, w of a feature.

    :param top: Z of the upper face of the block, which is w = 0 [m].
    :param is_direction: the vectors are directions: they are turned, not displaced.
    """
    cosine, sine = np.cos(feature.angle), np.sin(feature.angle)
    directions = vectors @ np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]).T
    return np.asarray(directions if is_direction else directions + np.array([feature.x, feature.y, top]))


class Placement(Struct, frozen=True):
    """The placement of the block while a program runs.

    :param number: n of `[base_data.n]` in the cell; empty: `[base]`.
    """

    number: str = ""

    @classmethod
    def of_base(cls, base: int) -> Placement:
        """Return the placement of probed points by its number in `ProbedSurfaces.base`; −1: `[base]`."""
        return cls("" if base < 0 else str(base))

    @property
    def name(self) -> str:
        """The name of the program for this placement."""
        return f"testpart_{self.number}.nc" if self.number else "testpart.nc"

    @property
    def title(self) -> str:
        """The frame of the placement, as a table of the cell."""
        return f"[base_data.{self.number}]" if self.number else "[base]"


class Program(Struct, frozen=True, eq=False):
    """A test part as text.

    :param text: G-code.
    :param features: number of features.
    :param feature: (n,) names of the probed points: feature and surface, ``F01.left``; ``T01.top`` on the uncut top.
    :param line: (n,) line of the text whose motion makes each point; 0 for points of the uncut top.
    :param t: (n,) place of the point on that motion, 0 … 1.
    :param point: (n, 3) in `$BASE` [m].
    :param normal: (n, 3) unit normals out of the material; of a gauge the direction in which it reads positive.
    :param mass: (n,) mass of the weight on the tool at a reading of a gauge [kg]; 0 at probed points.
    """

    text: str
    features: int
    feature: tuple[str, ...]
    line: Array
    t: Array
    point: Array
    normal: Array
    mass: Array


def hanging_places(low: Array, high: Array, top: float) -> Array:
    """Return the positions of the tip (n, 3) in `$BASE` [m] for a weight on the tool: above a diagonal of the block.

    :param low: (3,) lower corner of the block [m], and `high` (3,) upper corner.
    :param top: Z of its upper face [m].
    """
    share = np.array([[0.1, 0.1], [0.5, 0.5], [0.9, 0.9]])  # near two corners and in the middle (assumed)
    return np.column_stack([low[:2] + share * (high - low)[:2], np.full(len(share), top + _HANG_HEIGHT)])


class MiddleLine(NamedTuple):
    """Middle line of a feature, seen along Z.

    :param begin: (2,) X, Y of one end in `$BASE` [m], and `end` (2,) of the other end.
    :param half_width: half of the width of the feature, with half a wall [m].
    """

    begin: Array
    end: Array
    half_width: float


def middle_line(feature: Feature, cutting: Cutting) -> MiddleLine:
    """Return the middle line of a feature in the block."""
    middle, half_width = outline(feature.kind, cutting)
    end_u = half_length(cutting.diameter)
    ends = to_base(feature, 0.0, np.array([[-end_u, middle, 0.0], [end_u, middle, 0.0]]))[:, :2]
    return MiddleLine(ends[0], ends[1], half_width)


def touch_off_places(features: Sequence[Feature], cutting: Cutting, low: Array, high: Array) -> Array:
    """Return touch-off points (k, 3) on the uncut top near the corners of the block, `$BASE` [m].

    :param features: all features that are cut into the block, in any placement.
    :param low: (3,) lower corner of the block [m], and `high` (3,) upper corner.
    :raises PlanError: the features leave no room for three points that are not on a line.
    """
    x, y = (
        np.arange(
            low[k] + _TOUCH_EDGE_DISTANCE,
            high[k] - _TOUCH_EDGE_DISTANCE + 1e-9,  # 1e-9: the end counts
            max(_TOUCH_PITCH, (high[k] - low[k]) / _MOST_TOUCH_PLACES),
        )
        for k in (0, 1)
    )
    uncut = np.array([[px, py] for px in x for py in y]).reshape(-1, 2)
    for feature in features:
        begin, end, half_width = middle_line(feature, cutting)
        share = np.clip((uncut - begin) @ (end - begin) / ((end - begin) @ (end - begin)), 0.0, 1.0)
        distance = np.linalg.norm(uncut - begin - share[:, None] * (end - begin), axis=1)
        uncut = uncut[distance > half_width + _TOUCH_WALL_DISTANCE]
    places = np.zeros((0, 2))
    if len(uncut):
        corners = [(corner_x, corner_y) for corner_x in (low[0], high[0]) for corner_y in (low[1], high[1])]
        nearest_rows = [int(np.argmin(np.linalg.norm(uncut - corner, axis=1))) for corner in corners]
        places = uncut[list(dict.fromkeys(nearest_rows))]
    # spread of the points across the line that fits them best: points on a line show no tilt about it; the limit is
    # twice the distance from an edge (assumed)
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) if len(places) > 1 else np.zeros(1)
    if len(places) < _FEWEST_TOUCHES or spread[-1] < 2.0 * _TOUCH_EDGE_DISTANCE:
        raise PlanError(
            "the features leave no room for touch-off points on the top of the block",
            file="--block",
            advice="Give a larger block, or fewer --features.",
        )
    return np.column_stack([places, np.full(len(places), cutting.top)])


class _ProgramPoint(Struct, frozen=True, eq=False):
    """A probed point, or a reading of a gauge, with the line of the program whose motion makes it.

    :param name: name of feature and surface, ``F01.left``.
    :param line: number of the line, 1 for the first line of its section; 0 if no line makes the point.
    :param t: place on the motion of the line, in [0, 1].
    :param point: (3,) in `$BASE` [m].
    :param normal: (3,) unit normal out of the material; of a gauge the direction in which it reads positive.
    :param mass: mass of the weight on the tool [kg]; 0 at probed points.
    """

    name: str
    line: int
    t: float
    point: Array
    normal: Array
    mass: float = 0.0


class _Section(Struct, frozen=True):
    """Consecutive lines of a program, and the points to be probed or read that belong to them."""

    lines: list[str]
    points: list[_ProgramPoint]


class FirstNumbers(NamedTuple):
    """Numbers of the first feature, weight and touch-off point of a program."""

    feature: int = 1
    weight: int = 1
    touch: int = 1


_FROM_ONE = FirstNumbers()


def program(
    features: Iterable[Feature],
    cutting: Cutting,
    mass: float = 0.0,
    weight_places: Array | None = None,
    *,
    touches: Array | None = None,
    first: FirstNumbers = _FROM_ONE,
    placement_title: str = "",
) -> Program:
    """Return the G-code of a part with some features, and the points to be probed.

    :param mass: mass of a weight that is hung on the tool after cutting [kg].
    :param weight_places: (n, 3) positions of the tip at which it is hung, `$BASE` [m]; None: there are none.
    :param touches: (k, 3) touch-off points on the uncut top, `$BASE` [m]; None: there are none.
    :param first: numbers with which features, weights and touch-off points begin.
    :param placement_title: placement of the block, for the operator; empty: the block has one placement.
    """
    no_points = np.zeros((0, 3))
    sections = [_head_lines(cutting, no_points if touches is None else touches, first.touch, placement_title)]
    for number, feature in enumerate(features, start=first.feature):
        sections.append(_feature_lines(number, feature, cutting, has_height=number > first.feature))
    count = len(sections) - 1  # without the head
    sections.append(_Section([f"G0 Z{(cutting.top + _END_HEIGHT) * MM_PER_M:.4f}", "M5"], []))
    sections.append(_weight_stops(mass, no_points if weight_places is None else weight_places, first.weight))
    lines: list[str] = []
    line_numbers: list[int] = []
    for section in sections:
        # lines count from the start of their section; 0, a point that no line makes, stays 0
        line_numbers += [point.line + len(lines) if point.line else 0 for point in section.points]
        lines += section.lines
    points = [point for section in sections for point in section.points]
    return Program(
        text="\n".join([*lines, "M30", ""]),
        features=count,
        feature=tuple(point.name for point in points),
        line=np.array(line_numbers, dtype=np.int64),
        t=np.array([point.t for point in points], dtype=float),
        point=np.array([point.point for point in points]).reshape(-1, 3),
        normal=np.array([point.normal for point in points]).reshape(-1, 3),
        mass=np.array([point.mass for point in points], dtype=float),
    )


def _head_lines(cutting: Cutting, touches: Array, first: int, placement_title: str) -> _Section:
    """Return the first lines of the program: comments for the operator with the touch-off points, tool and spindle.

    :param touches: (k, 3) touch-off points in `$BASE` [m], and `first` the number of the first point.
    :param placement_title: placement of the block; empty: the block has one placement.
    """
    lines = [
        "(Test part for postproc identify part: cut it uncorrected, with the cell that it was made for)",
        *([f"(The block is at {placement_title})"] if placement_title else []),
    ]
    if len(touches):
        z = without_negative_zero(cutting.top * MM_PER_M)
        lines.append(f"(Before cutting touch the top of the block with the tool: it is at Z{z:g} of the base)")
    points = []
    for number, touch in enumerate(touches, start=first):
        x, y, z = without_negative_zero(touch * MM_PER_M).tolist()
        lines.append(f"(T{number:02d}: X{x:g} Y{y:g} Z{z:g}, left uncut, to be probed with the features)")
        up = np.array([0.0, 0.0, 1.0])
        points.append(_ProgramPoint(name=f"T{number:02d}.top", line=0, t=0.0, point=touch, normal=up))
    lines += ["G21 G90 G17 G94", f"T{cutting.tool} M6", f"S{cutting.rpm:g} M3"]
    return _Section(lines, points)


def _feature_lines(number: int, feature: Feature, cutting: Cutting, *, has_height: bool) -> _Section:
    """Return the G-code lines that cut a feature, and the points to be probed on it.

    :param number: number of the feature.
    :param has_height: whether the tool already is at the height of rapid moves: then the first move states no Z.
    """
    kind, name, feed = feature.kind, f"F{number:02d}", cutting.feed * MM_PER_M * 60.0
    lines = [f"({name}: {kind.title}, depth {kind.depth * MM_PER_M:g} mm, {np.degrees(feature.angle):g} deg)"]
    move_of_surface: dict[str, tuple[int, Array, Array]] = {}
    last_end = np.zeros(3)
    for index, move in enumerate(passes(kind, cutting)):
        end = to_base(feature, cutting.top, np.array([move.end]))[0] * MM_PER_M
        words = f"X{end[0]:.4f} Y{end[1]:.4f}" + ("" if index == 0 and has_height else f" Z{end[2]:.4f}")
        lines.append(f"G0 {words}" if move.is_rapid else f"G1 {words} F{move.feed_share * feed:.1f}")
        if move.name:
            # line from 1, and both ends of the move
            move_of_surface[move.name] = len(lines), last_end, np.array(move.end)
        last_end = np.array(move.end)
    points = []
    for probe in probes(kind, cutting):
        line, begin, end = move_of_surface[probe.made_by]
        # passes that make probed surfaces are along u
        share = float((probe.point[0] - begin[0]) / (end[0] - begin[0]))
        point = to_base(feature, cutting.top, np.array([probe.point]))[0]
        normal = to_base(feature, cutting.top, np.array([probe.normal]), is_direction=True)[0]
        points.append(_ProgramPoint(name=f"{name}.{probe.name}", line=line, t=share, point=point, normal=normal))
    return _Section(lines, points)


def _weight_stops(mass: float, places: Array, first: int) -> _Section:
    """Return the G-code lines of the stops at which a weight is hung on the tool, and the readings of the gauge.

    :param mass: mass of the weight [kg].
    :param places: (n, 3) positions of the tip in `$BASE` [m], and `first` the number of the first place.
    """
    lines, points = [], []
    for number, place in enumerate(places, start=first):
        x, y, z = (place * MM_PER_M).tolist()
        lines.append(f"(W{number:02d}: set the gauge to 0, hang {mass:g} kg on the tool, read)")
        lines += [*([f"G0 Z{z:.4f}"] if number == first else []), f"G0 X{x:.4f} Y{y:.4f}"]
        # at the end of the move of the last line; the gauge reads positive downwards
        points.append(
            _ProgramPoint(
                name=f"W{number:02d}.gauge",
                line=len(lines),
                t=1.0,
                point=place,
                normal=np.array([0.0, 0.0, -1.0]),
                mass=mass,
            )
        )
        lines.append("M0")  # stop
    return _Section(lines, points)
