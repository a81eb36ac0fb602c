"""Sweep tools through the stock: engagement along the path, and the forces that follow from it.

Segments are processed together as long as the path is nearly straight. Their engagement is found in the stock before
the first of them: the front of a convex tool never reaches material that the tool has just cut on a straight path, nor
where the path turns with a radius above that of the tool. Then their material is removed, but for that under the front
of the tool where they end: cells there are only partly cut, and stay whole until they are under its front no more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct, field

from postproc.chunks import Columns
from postproc.frames import Array
from postproc.machining import cutting, tilted
from postproc.machining.cutting import EngagedEdge, Loads, cut_edge
from postproc.machining.leaning import depth_inside
from postproc.machining.material import CuttingLaw, Floats
from postproc.machining.process import Process
from postproc.machining.remaining import Ceiling, Guard
from postproc.machining.resolution import CellErrors
from postproc.machining.stock import Footprint, Stock, cut, depth_of_cut, remove
from postproc.machining.tilted import TiltedPath
from postproc.machining.tool import BOTTOM, SIDE, Cutter, Edge, Turn, edge, slice_cylinder, take_pieces
from postproc.machining.tool_path import StraightSegments, ToolPoses, ToolStates
from postproc.program import Bools, Ints, distinct
from postproc.toolpath import even_places

_STRAIGHT_COSINE = np.cos(np.radians(10.0))
"""Segments that turn by less are processed together (assumed)."""
_GROUP_LENGTH = 20.0
"""Maximum length of segments that are processed together, in radii of the tool (assumed)."""
_AXIAL_SINE = 1e-3
"""Sine of the angle to the spindle below which a segment is along it."""
_MOST_POINTS = 200_000
"""Points of edges that are processed together."""
_SLOPE_STEPS = 16
"""Steps of the sine of the slope for which the part of the edge that can cut is found."""
_RIM_SPACING = 0.5
"""Distance of sample points at the rim, in cells, if only the cylinder cuts (assumed)."""
_SLICE_STEP = 4
"""Edges of tools that lean are divided up to multiples of this many cells,"""
_TILT_KEY = -1
"""and kept under this number instead of a slope."""
_SAME_AXIS_COSINE = np.cos(np.radians(3.0))
"""Tools that turn while they cut are processed together while their axis turns by less (assumed)."""
_LINE_TOLERANCE = 1e-6
"""Directions that differ by less count as one straight line (assumed)."""
_ENGAGED_SHARE = 0.05
"""Share of an edge in material below which it does not count for angles and width of engagement."""
_CHORD_DEVIATION = 1e-3
"""The path of a tool that leans leaves its chords by less [m] (assumed)."""
_FEWEST_PLACES = 4
"""Smallest number of places on such a chord where the tool is compared with the stock (assumed)."""
_LEAST_DEPTH = 2e-5
"""Depth [m] to which a rapid move, or a move with the spindle off, may touch material without a warning."""


class Cuts(Columns, frozen=True, eq=False):
    """Engagement and loads at N stations of cutting moves, in order. SI.

    :param motion: (N,) row of `Motions`.
    :param t: (N,) position on it in [0, 1].
    :param wrench: (N, 6) mean force and moment about the tip on the tool. FEED axes; on moves along the spindle the
        axes of the height map.
    :param deviation: (N, 6) standard deviations of the wrench, see `cutting.Loads`.
    :param is_axial: (N,) True on moves along the spindle.
    :param torque: (N,) mean torque of the spindle [N·m].
    :param power: (N,) mean power of the spindle [W].
    :param enter: (N,) smallest angle of the turn in material [rad], and `leave` (N,) largest angle; NaN in air.
    :param depth: (N,) axial depth of cut [m]; of drills the depth of the tip below the surface around the hole.
    :param width: (N,) radial width of cut [m].
    :param rate: (N,) volume removed per time [m³/s].
    """

    motion: Ints
    t: Array
    wrench: Array
    deviation: Array
    is_axial: Bools
    torque: Array
    power: Array
    enter: Array
    leave: Array
    depth: Array
    width: Array
    rate: Array

    @classmethod
    def empty(cls) -> Cuts:
        """Return cuts without stations."""
        empty = np.zeros(0)
        six = np.zeros((0, 6))
        return cls(empty.astype(np.int64), empty, six, six, empty.astype(bool), *[empty] * 7)


class Sweep(Struct, eq=False):
    """A stock, and the tools that cut it.

    :ivar feed: (M,) speed of the tip on each motion [m/s].
    :ivar law: forces of the material per length of cutting edge and chip.
    :ivar poses: the tool anywhere on the path.
    :ivar swing: (M,) angular speed of the tool on motions that do not move its tip [rad/s]; NaN: not known.
    :ivar is_deflected: the tip is displaced. On rapid moves it still springs back: their contact is no collision.
    :ivar guard: parts of the tool that must stay clear of the stock; None: they are not compared.
    :ivar ceiling: with a guard, the stock over time.
    :ivar collisions: row of a rapid motion through material → its depth [m]; empty if `is_deflected`.
    :ivar stopped_motions: cutting motions through material with the spindle off.
    :ivar has_contact: whether any cutting move engaged material.
    :ivar cell_error_sums: sums (M,) over the stations of each motion, increased in place.
    :ivar overhang: row of a motion of a tool that leans → volume above the tool that a height map cannot keep [m³].
    :ivar tilted_volume: volume that tools that lean remove [m³].
    :ivar unpaced_motions: motions through material that only turn the tool, at a speed that is not known.
    :ivar top: height of the highest material at the start [m].
    """

    stock: Stock
    process: Process
    tools: ToolStates
    feed: Array
    law: CuttingLaw
    poses: ToolPoses
    swing: Array
    cell_error_sums: CellErrors
    is_deflected: bool = False
    guard: Guard | None = None
    ceiling: Ceiling | None = None
    collisions: dict[int, float] = field(default_factory=dict)
    stopped_motions: set[int] = field(default_factory=set)
    has_contact: bool = False
    overhang: dict[int, float] = field(default_factory=dict)
    tilted_volume: float = 0.0
    unpaced_motions: set[int] = field(default_factory=set)
    top: float = -np.inf
    _cutters: dict[int, Cutter] = field(default_factory=dict)
    _edges: dict[int, Edge] = field(default_factory=dict)
    _turns: dict[tuple[int, bool, int, int], Turn] = field(default_factory=dict)

    def run(self, segments: StraightSegments, progress: Callable[[int], None] | None = None) -> Iterator[Cuts]:
        """Yield engagement and loads on the cutting segments in order, and remove their material; see `Cuts`.

        Contacts without a cut, collisions and volumes are recorded in the attributes.

        :param progress: called with the number of segments done; None: not called.
        """
        self.top = self.stock.top
        may_touch = self._can_touch(segments, self.top)
        # cells under the front of the tool (the part that moves into material) where a group of segments ends: they are
        # cut when the tool has passed, as the next group must meet uncut material
        uncut_front = Footprint.empty()
        for begin, end in self._groups(segments, may_touch):
            if progress is not None:
                progress(end)
            leans, cuts = bool(segments.leans[begin]), bool(segments.cutting[begin])
            spindle_turns = bool(self.tools.rpm[segments.motion[begin]] > 0.0)
            if leans and not cuts:
                if may_touch[begin] and not self.is_deflected:
                    self._record_turning_rapids(segments, begin, end)
                continue
            if not leans:
                self._check_holder(segments, begin, end)
            if not may_touch[begin]:
                if cuts:
                    yield self._air_stations(segments, begin, end)
                continue
            number = int(self.tools.tool[segments.motion[begin]])
            cutter = self._cutter(number)
            goes_on = end < len(may_touch) and bool(segments.continues[end]) and bool(may_touch[end])
            if leans:
                path, top = self._tilted_path(segments, begin, end, cutter)
                if spindle_turns:
                    yield from self._tilted_cuts(path, number, top)
                front = self._tilted_sweep(path, cutter, top, goes_on=goes_on)
            elif cuts and spindle_turns:
                yield from self._upright_cuts(segments, begin, end, number)
                front = self._upright_sweep(segments, begin, end, cutter, goes_on=goes_on)
            else:
                cut(self.stock, uncut_front)
                uncut_front = front = Footprint.empty()
                self._record_contact(segments, begin, end, cutter)
            # of the middle of the end face, whose material need not be kept; 0 for a tool that leans
            face_radius = 0.0 if leans else cutter.radius - cutter.corner - self.stock.cell
            self._cut_passed_front(uncut_front, front, segments.end[end - 1], face_radius)
            uncut_front = front
            if self.ceiling is not None:
                self.ceiling.record_removal(*_extent(segments, begin, end, cutter), int(segments.motion[end - 1]))

    def _cut_passed_front(self, last_front: Footprint, front: Footprint, tip: Array, face_radius: float) -> None:
        """Remove the material that was kept under the front of the tool, where the tool has passed.

        The front is the part of the tool that moves into material; a group is a range of segments that are processed
        together. Cells that are still under the front are not cut: on circles smaller than the tool the next groups
        meet them again. Cells under the middle of an end face are cut: it needs no more material than the descent of
        one group.

        :param last_front: cells that the last group of segments kept, `front` cells that this group keeps.
        :param tip: (3,) position of the tip at the end of this group [m].
        :param face_radius: radius of the end face of a tool along z, less a cell [m]; 0: the tool leans.
        """
        kept_front = front.outside_circle(self.stock, tip, face_radius)
        cut(self.stock, last_front.not_covered_by(kept_front))

    def _check_holder(self, segments: StraightSegments, begin: int, end: int) -> None:
        """Compare the parts of the tool that do not cut with the stock before segments cut it, if there is a guard.

        :param begin: first segment, and `end` the one after the last.
        """
        if self.guard is not None and self.ceiling is not None:
            cutter = self._cutter(int(self.tools.tool[segments.motion[begin]]))
            cuts = bool(segments.cutting[begin])
            self.guard.check(self.ceiling, segments, slice(begin, end), cutter, removes=cuts)

    def _record_contact(self, segments: StraightSegments, begin: int, end: int, cutter: Cutter) -> None:
        """Record motions that touch material without cutting it (rapid, or spindle off), and remove that material.

        :param begin: first segment, and `end` the one after the last; all are rapid, or none is.
        """
        start, stop = segments.begin[begin:end], segments.end[begin:end]
        is_reported = segments.cutting[begin] or not self.is_deflected
        if not is_reported or depth_of_cut(self.stock, cutter, start, stop) <= _LEAST_DEPTH:
            remove(self.stock, cutter, start, stop)
            return
        for k, motion in enumerate(segments.motion[begin:end].tolist()):
            row = slice(k, k + 1)
            depth = depth_of_cut(self.stock, cutter, start[row], stop[row])
            if depth > _LEAST_DEPTH and segments.cutting[begin]:
                self.stopped_motions.add(motion)
            elif depth > _LEAST_DEPTH:
                self.collisions[motion] = max(depth, self.collisions.get(motion, 0.0))
            remove(self.stock, cutter, start[row], stop[row])

    def _record_turning_rapids(self, segments: StraightSegments, begin: int, end: int) -> None:
        """Record rapid motions that turn the tool and move it through material, which is left where it is.

        :param begin: first segment, and `end` the one after the last.
        """
        length = np.linalg.norm(segments.end[begin:end] - segments.begin[begin:end], axis=1)
        cutter = self._cutter(int(self.tools.tool[segments.motion[begin]]))
        for k, pieces in enumerate(np.maximum(_FEWEST_PLACES, np.ceil(length / self.stock.cell)).astype(int).tolist()):
            row = begin + k
            t = segments.first[row] + (segments.last[row] - segments.first[row]) * np.linspace(0.0, 1.0, pieces + 1)
            motion = int(segments.motion[row])
            depth = depth_inside(self.stock, cutter, *self.poses.tips_and_axes(np.full(len(t), motion), t))
            if depth > 0.0:
                self.collisions[motion] = max(depth, self.collisions.get(motion, 0.0))

    def _can_touch(self, segments: StraightSegments, top: float) -> Bools:
        """Return True for segments (L,) that can touch the stock at all; a tool that leans may touch it beside its tip.

        :param top: height of the highest material [m].
        """
        x_low, x_high, y_low, y_high = self.stock.bounds
        reach = np.zeros(len(segments.motion))
        for number in distinct(self.tools.tool[segments.motion]).tolist():
            reach[self.tools.tool[segments.motion] == number] = self._cutter(number).radius
        low, high = np.minimum(segments.begin, segments.end), np.maximum(segments.begin, segments.end)
        may_touch = (low[:, 2] < top) & (high[:, 0] + reach > x_low) & (low[:, 0] - reach < x_high)
        may_touch &= (high[:, 1] + reach > y_low) & (low[:, 1] - reach < y_high)
        # a tool that leans may touch anywhere along its axis: only its lowest point is compared
        may_touch[segments.leans] = (low[:, 2] - reach - _CHORD_DEVIATION < top)[segments.leans]
        return np.asarray(may_touch)

    def _groups(self, segments: StraightSegments, may_touch: Bools) -> Iterator[tuple[int, int]]:
        """Yield ranges of segments that are processed together: first segment, and the one after the last.

        A range is nearly straight where it may cut, and limited in length.

        :param may_touch: (L,) segments that can touch the stock.
        """
        tool = self.tools.tool[segments.motion].tolist()
        if not tool:
            return
        length = np.linalg.norm(segments.end - segments.begin, axis=1).tolist()
        leave, arrive = segments.leave.tolist(), segments.arrive.tolist()
        joins_previous = self._joins_previous(segments, may_touch).tolist()
        may_cut = (may_touch & segments.cutting).tolist()
        axes = self._tilted_axes(segments, may_touch)
        largest_lengths = {number: _GROUP_LENGTH * self._cutter(number).radius for number in set(tool)}

        def turns_too_far(begin: int, segment: int) -> bool:
            """Return whether path or tool turn too far from one segment to another."""
            if min(_dot(leave[begin], leave[segment]), _dot(leave[begin], arrive[segment])) < _STRAIGHT_COSINE:
                return True
            return segment in axes and _dot(axes[begin], axes[segment]) < _SAME_AXIS_COSINE

        begin, group_length = 0, length[0]
        for segment in range(1, len(tool)):
            if (
                not joins_previous[segment]
                or group_length > largest_lengths[tool[begin]]
                or (may_cut[segment] and turns_too_far(begin, segment))
            ):
                yield begin, segment
                begin, group_length = segment, 0.0
            group_length += length[segment]
        yield begin, len(tool)

    def _joins_previous(self, segments: StraightSegments, may_touch: Bools) -> Bools:
        """Return True for segments (L,) that are of one kind with the segment before, so that a group may have both.

        Their tool and spindle are the same, and both cut or both are rapid. Cuts of a tool along z also must both
        descend, or both not, and both be along the spindle, or both not.

        :param may_touch: (L,) segments that can touch the stock.
        """
        motion = segments.motion
        is_axial = np.hypot(segments.leave[:, 0], segments.leave[:, 1]) < _AXIAL_SINE
        is_descent = segments.leave[:, 2] < -1e-6
        joins_previous = np.zeros(len(motion), dtype=bool)
        spindle_state = np.stack([self.tools.tool[motion], self.tools.rpm[motion], self.tools.hand[motion]], axis=1)
        joins_previous[1:] = segments.continues[1:] & (spindle_state[1:] == spindle_state[:-1]).all(axis=1)
        joins_previous[1:] &= (may_touch[1:] == may_touch[:-1]) & (segments.cutting[1:] == segments.cutting[:-1])
        rapid, leans = ~segments.cutting, segments.leans
        # pieces of one rapid motion that turns the tool belong together, though none continues the one before
        joins_previous[1:] |= (rapid & leans)[1:] & (motion[1:] == motion[:-1]) & (may_touch[1:] == may_touch[:-1])
        same_kind = (is_axial[1:] == is_axial[:-1]) & (is_descent[1:] == is_descent[:-1])
        joins_previous[1:] &= ~may_touch[1:] | rapid[1:] | leans[1:] | same_kind
        return joins_previous

    def _upright_sweep(
        self, segments: StraightSegments, begin: int, end: int, cutter: Cutter, *, goes_on: bool
    ) -> Footprint:
        """Remove the material that a tool along z sweeps, and return the cells under its front, which are not cut yet.

        The front is the half of the tool that moves into material where the segments end. It must meet uncut material
        next, not cells that it has partly cut.

        :param begin: first segment, and `end` the one after the last.
        :param goes_on: the tool moves on from the last segment; else all material is removed, and no cells are
            returned.
        """
        run_begins = _straight_runs(segments, begin, end)
        run_ends = [*(run_begins[1:] - 1), end - 1]
        heading = segments.arrive[end - 1] if goes_on else None  # direction of travel where the last segment ends
        return remove(self.stock, cutter, segments.begin[run_begins], segments.end[run_ends], heading)

    def _tilted_axes(self, segments: StraightSegments, may_touch: Bools) -> dict[int, list[float]]:
        """Return segment → unit axis (3) of the tool at its end, for cuts on which the tool leans or turns.

        :param may_touch: (L,) True for segments that can touch the stock; the others are left out.
        """
        rows = np.flatnonzero(segments.leans & segments.cutting & may_touch)
        if not len(rows):
            return {}
        _, axes = self.poses.tips_and_axes(segments.motion[rows], segments.last[rows])
        return dict(zip(rows.tolist(), axes.tolist(), strict=True))

    def _air_stations(self, segments: StraightSegments, begin: int, end: int) -> Cuts:
        """Return stations without force for segments that cannot touch the stock: one in the middle of each.

        :param begin: first segment, and `end` the one after the last.
        """
        wrench = np.zeros((end - begin, 6))
        t = 0.5 * (segments.first[begin:end] + segments.last[begin:end])
        heading = segments.leave[begin:end]
        axis_sine = np.hypot(heading[:, 0], heading[:, 1])
        return _cuts_of_air(segments.motion[begin:end], t, axis_sine < _AXIAL_SINE, wrench, wrench)

    def _upright_cuts(self, segments: StraightSegments, begin: int, end: int, number: int) -> Iterator[Cuts]:
        """Yield the loads at stations along segments of tool `number`, in chunks that limit memory.

        Stations (places of the tool where its force is computed) are as far apart as the process states for cells of
        the height map, also where the map has finer ones: these are for the contact at a station, not for changes along
        the path.

        :param begin: first segment, and `end` the one after the last.
        :param number: number of the tool, an index in `ToolStates.keys`.
        """
        length = np.linalg.norm(segments.end[begin:end] - segments.begin[begin:end], axis=1)
        count = np.maximum(1, np.ceil(length / self.process.stock.cell - 1e-6)).astype(np.int64)
        segment, share = even_places(np.arange(begin, end), count, "middle")
        position = segments.begin[segment] + share[:, None] * (segments.end[segment] - segments.begin[segment])
        heading = segments.leave[segment] + share[:, None] * (segments.arrive[segment] - segments.leave[segment])
        heading /= np.linalg.norm(heading, axis=1)[:, None]
        t = segments.first[segment] + share * (segments.last[segment] - segments.first[segment])
        motion = segments.motion[segment]
        turn = self._turn_points(number, position, heading)
        chunk = max(1, _MOST_POINTS // len(turn.phi))
        for start in range(0, len(segment), chunk):
            rows = slice(start, start + chunk)
            yield self._cuts_at(turn, number, position[rows], heading[rows], motion[rows], t[rows])

    def _turn_points(self, number: int, position: Array, heading: Array) -> Turn:
        """Return the sample points of the edge that can be in material at some positions.

        Equal sets of points are made once. The end face is left out if the tool does not descend.

        :param number: number of the tool, an index in `ToolStates.keys`.
        :param position: (n, 3) of the tip [m], `heading` (n, 3) unit directions of travel, frame of the height map.
        """
        cutter, pieces = self._cutter(number), self._edge(number)
        is_descent = bool((heading[:, 2] < -1e-6).any())
        surface_level = self._highest_level(position, cutter.radius)
        # pieces are in order upwards: those that begin below the highest material
        piece_count = int(np.searchsorted(pieces.low, surface_level - float(position[:, 2].min()), side="left"))
        has_end_face = is_descent and bool((pieces.part == BOTTOM).any())
        piece_count = max(piece_count, 1)
        slope_steps = int(np.ceil(_SLOPE_STEPS * float((-heading[:, 2]).max()) - 1e-6))
        key = (number, has_end_face, piece_count, slope_steps)
        if key not in self._turns:
            is_used = (np.arange(len(pieces.low)) < piece_count) & (has_end_face | (pieces.part != BOTTOM))
            if not is_used.any():
                is_used[-1] = True  # a turn has at least one piece
            kept_edge = take_pieces(pieces, is_used)
            step = self.stock.cell * (_RIM_SPACING if (kept_edge.part == SIDE).all() else 1.0)
            self._turns[key] = Turn.of(kept_edge, cutter, self.law, step, min(slope_steps / _SLOPE_STEPS, 1.0))
        return self._turns[key]

    def _highest_level(self, position: Array, radius: float) -> float:
        """Return the highest level of the stock [m] within `radius` of tips at positions (n, 3); −inf off its map."""
        stock, reach = self.stock, radius + 2.0 * self.stock.cell
        (x_low, y_low), (x_high, y_high) = position[:, :2].min(axis=0) - reach, position[:, :2].max(axis=0) + reach
        columns = slice(max(0, int((x_low - stock.x) / stock.cell)), max(0, int((x_high - stock.x) / stock.cell) + 1))
        rows = slice(max(0, int((y_low - stock.y) / stock.cell)), max(0, int((y_high - stock.y) / stock.cell) + 1))
        return float(stock.high[rows, columns].max(initial=-np.inf))

    def _cuts_at(self, turn: Turn, number: int, position: Array, heading: Array, motion: Ints, t: Array) -> Cuts:
        """Return engagement and loads at n stations (places of the tip) of tool `number`.

        :param position: (n, 3) of the tip [m], `heading` (n, 3) unit directions of travel, frame of the height map.
        :param motion: (n,) rows of `Motions`, `t` (n,) places on them.
        """
        cutter = self._cutter(number)
        axis_sine = np.hypot(heading[:, 0], heading[:, 1])
        is_axial = axis_sine < _AXIAL_SINE
        ux = np.where(is_axial, 1.0, heading[:, 0] / np.where(is_axial, 1.0, axis_sine))
        uy = np.where(is_axial, 0.0, heading[:, 1] / np.where(is_axial, 1.0, axis_sine))
        rpm, hand = self.tools.rpm[motion], self.tools.hand[motion]
        per_tooth = self.feed[motion] * 60.0 / (rpm * cutter.teeth)
        feed = np.where(is_axial, 0.0, per_tooth * axis_sine).astype(np.float32)
        descent = (-per_tooth * heading[:, 2]).astype(np.float32)
        # the point of a drill is a cone: it does not enter within one tooth, as a flat end face does
        layer = descent * np.float32(cutter.teeth) if cutter.drill else descent
        engagement = self._engaged_edge(turn, position, (ux, uy, hand), layer)
        chip = cutting.chips(turn, feed, descent)
        descent_sine = np.maximum(-heading[:, 2], 0.0).astype(np.float32)
        loads = cutting.mean_loads(turn, engagement, chip, descent_sine, self.stock.cell, turn.normal_down)
        hole_depth = self._hole_depth(position, cutter.radius) if cutter.drill else 0.0
        return self._cuts_of_loads(turn, (motion, t, is_axial), loads, engagement.length * chip.share, hole_depth)

    def _hole_depth(self, position: Array, radius: float) -> float:
        """Return the depth of the hole that a drill cuts [m]; all stations have it, as few of them are kept later.

        :param position: (n, 3) of the tip at stations in the middle of equal steps [m].
        """
        heights = position[:, 2]
        # the hole ends half a step below the last station
        half_step = 0.5 * abs(float(heights[-1] - heights[0])) / max(1, len(heights) - 1)
        return max(self._highest_level(position, radius) - (float(heights.min()) - half_step), 0.0)

    def _cuts_of_loads(
        self,
        turn: Turn,
        stations: tuple[Ints, Array, Bools],
        loads: Loads,
        cuts: Floats,
        hole_depth: float,
    ) -> Cuts:
        """Return engagement and loads at n stations (places of the tip) on cutting motions.

        Set `has_contact` if an edge cuts, and add the errors by the cells of the map to `cell_error_sums`. Wrenches of
        tools that turn left (M4) are mirrored in place.

        :param stations: motions (n,), places t (n,) on them, and whether (n,) they are along the spindle.
        :param cuts: (n, P) length of edge that cuts [m].
        :param hole_depth: depth of the hole of a drill [m]; not used for other tools.
        """
        motion, t, is_axial = stations
        wrench, rpm, hand = loads.wrench, self.tools.rpm[motion], self.tools.hand[motion]
        wrench[:, [1, 3, 5]] *= hand[:, None]  # mirrored in y: Fy, Mx and Mz change their signs
        if not cuts.any():
            return _cuts_of_air(motion, t, is_axial, wrench, loads.deviation)
        self.has_contact = True
        # a covariance of the material is in `loads.deviation` already
        material_sigma = self.law.sigma if self.law.covariance is None else 0.0
        for sums, squares in zip(self.cell_error_sums, CellErrors.of(loads, material_sigma), strict=True):
            np.add.at(sums, motion, squares)
        enter, leave, depth, width = _engagement_sizes(turn, cuts)
        if turn.drill:
            depth = np.where(cuts.any(axis=1), hole_depth, 0.0)
        torque = wrench[:, 5] * hand
        return Cuts(
            motion=motion,
            t=t,
            wrench=wrench,
            deviation=loads.deviation,
            is_axial=is_axial,
            torque=torque,
            power=torque * rpm * (2.0 * np.pi / 60.0),
            enter=enter,
            leave=leave,
            depth=depth,
            width=width,
            rate=loads.removal * turn.teeth * rpm / 60.0,
        )

    def _engaged_edge(self, turn: Turn, position: Array, axes: tuple[Array, Array, Ints], layer: Floats) -> EngagedEdge:
        """Return the cutting edge in material at n stations.

        :param position: (n, 3) of the tip [m], frame of the height map.
        :param axes: x (n,) and y (n,) of the unit direction of the feed, and hand (n,) of the tool, see `ToolStates`.
        :param layer: (n,) thickness of the layer that the end face cuts [m], see `cut_edge`.
        """
        ux, uy, hand = (component.astype(np.float32)[:, None] for component in axes)
        feed_offset = np.sin(turn.phi).astype(np.float32) * turn.radius
        side_offset = np.cos(turn.phi).astype(np.float32) * turn.radius
        x = position[:, 0].astype(np.float32)[:, None] + (ux * feed_offset - (uy * hand) * side_offset)
        y = position[:, 1].astype(np.float32)[:, None] + (uy * feed_offset + (ux * hand) * side_offset)
        return cut_edge(self.stock, turn, x, y, position.astype(np.float32), layer)

    def _tilted_cuts(self, path: TiltedPath, number: int, top: float) -> Iterator[Cuts]:
        """Yield engagement and loads of a tool that leans or turns, in chunks that limit memory.

        :param number: number of the tool, an index in `ToolStates.keys`.
        :param top: height of the highest material near the path [m].
        """
        cutter, step = self._cutter(number), self.stock.cell
        # length of the cylinder that can be below the material, in slices; few different lengths share their points
        height = (top - float(path.tip[:, 2].min()) + cutter.radius) / float(path.axis[:, 2].min())
        count = max(1, int(np.ceil(height / step / _SLICE_STEP))) * _SLICE_STEP
        key = (number, True, count, _TILT_KEY)
        if key not in self._turns:
            self._turns[key] = Turn.of(
                slice_cylinder(self._edge(number), step, count * step), cutter, self.law, step, None
            )
        turn = self._turns[key]
        chunk = max(1, _MOST_POINTS // len(turn.phi))
        for start in range(0, len(path.t), chunk):
            part = path.take(slice(start, start + chunk))
            rpm, hand = self.tools.rpm[part.motion], self.tools.hand[part.motion]
            loads, cuts, is_axial = tilted.loads(self.stock, turn, part, 60.0 / (rpm * cutter.teeth), hand)
            self.unpaced_motions.update(part.motion[cuts.any(axis=1) & np.isnan(part.pace)].tolist())
            yield self._cuts_of_loads(turn, (part.motion, part.t, is_axial), loads, cuts, np.nan)

    def _tilted_path(
        self, segments: StraightSegments, begin: int, end: int, cutter: Cutter
    ) -> tuple[TiltedPath, float]:
        """Return the path of a tool that leans or turns, and the height of the highest material near it [m].

        :param begin: first segment of the path, and `end` the one after the last.
        """
        rows = slice(begin, end)
        motion = segments.motion[rows]
        axes = [self.poses.tips_and_axes(motion, t[rows])[1] for t in (segments.first, segments.last)]
        path = TiltedPath.of(
            segments.take(rows), axes[0], axes[1], cutter, self.stock.cell, feed=self.feed, swing=self.swing
        )
        height = max(self.top - float(path.tip[:, 2].min()) + cutter.radius, 0.0)
        cosine = float(path.axis[:, 2].min())  # of the largest tilt
        reach = height * float(np.sqrt(1.0 - cosine**2)) / cosine  # how far the tool leans aside up to that height
        return path, max(self._highest_level(path.tip, cutter.radius + reach), float(path.tip[:, 2].min()))

    def _tilted_sweep(self, path: TiltedPath, cutter: Cutter, top: float, *, goes_on: bool) -> Footprint:
        """Remove the material that a tool that leans or turns sweeps, and return the cells under its front.

        :param top: height of the highest material near the path [m].
        :param goes_on: the tool moves on from the end of the path; else all material is removed, and no cells are
            returned.
        """
        sweep = tilted.sweep(self.stock, cutter, *path.poses, top)
        last = int(path.motion[-1])
        if sweep.depth > _LEAST_DEPTH and not self.tools.rpm[last] > 0.0:
            self.stopped_motions.add(last)
        self.overhang[last] = self.overhang.get(last, 0.0) + sweep.overhang
        self.tilted_volume += sweep.removal
        cut(self.stock, sweep.footprint)
        if goes_on:
            return sweep.front
        cut(self.stock, sweep.front)
        return Footprint.empty()

    def _cutter(self, number: int) -> Cutter:
        """Return the cutter of a tool, `number` in `ToolStates.keys`; each is made once."""
        if number not in self._cutters:
            self._cutters[number] = self.process.cutter(self.tools.keys[number])
        return self._cutters[number]

    def _edge(self, number: int) -> Edge:
        """Return the cutting edge of a tool, `number` in `ToolStates.keys`; each is made once."""
        if number not in self._edges:
            self._edges[number] = edge(self._cutter(number), self.stock.cell)
        return self._edges[number]


def _cuts_of_air(motion: Ints, t: Array, is_axial: Bools, wrench: Array, deviation: Array) -> Cuts:
    """Return n stations at which no edge cuts: engagement, torque and power are 0, the angles NaN.

    :param motion: motions (n,), places `t` (n,) on them, and `is_axial` (n,): whether they are along the spindle.
    :param wrench: (n, 6) [N, N·m], and `deviation` (n, 6) its standard deviation; kept as they are.
    """
    no_angle, zero = np.full(len(t), np.nan), np.zeros(len(t))
    return Cuts(
        motion=motion,
        t=t,
        wrench=wrench,
        deviation=deviation,
        is_axial=is_axial,
        torque=zero,
        power=zero,
        enter=no_angle,
        leave=no_angle,
        depth=zero,
        width=zero,
        rate=zero,
    )


def _extent(segments: StraightSegments, begin: int, end: int, cutter: Cutter) -> tuple[Array, Array]:
    """Return the corners (3,) of a box around what a tool sweeps on the segments `begin` to `end` (exclusive) [m]."""
    ends = np.concatenate([segments.begin[begin:end], segments.end[begin:end]])
    return ends.min(axis=0) - cutter.radius, ends.max(axis=0) + cutter.radius


def _straight_runs(segments: StraightSegments, begin: int, end: int) -> Ints:
    """Return the first segment of each straight run (k,) among the segments from `begin` to `end` (exclusive)."""
    direction = segments.end[begin:end] - segments.begin[begin:end]
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    has_bend = np.abs(np.diff(direction, axis=0)).max(axis=1, initial=0.0) > _LINE_TOLERANCE
    return np.concatenate([[begin], np.flatnonzero(has_bend) + begin + 1])


def _dot(a: list[float], b: list[float]) -> float:
    """Return the dot product of two vectors of three numbers; numpy is slower for vectors as short."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class _EngagementSizes(NamedTuple):
    """Sizes of the engagement at n stations.

    :param enter: (n,) smallest angle of the turn in material [rad]; NaN in air.
    :param leave: (n,) largest one [rad]; NaN in air.
    :param depth: (n,) depth of cut [m].
    :param width: (n,) width of cut: extent of the edge in material across the feed [m].
    """

    enter: Array
    leave: Array
    depth: Array
    width: Array


def _engagement_sizes(turn: Turn, cuts: Floats) -> _EngagementSizes:
    """Return the angles in material, depth and width of cut at n stations.

    :param cuts: (n, P) length of edge that cuts at the points of a turn [m].
    """
    # on the cylinder the length has no limit: points count relative to the longest contact of the station
    is_engaged = cuts > _ENGAGED_SHARE * np.where(np.isfinite(turn.rise), turn.length, 0.0)
    is_engaged[:, turn.side] &= cuts[:, turn.side] > _ENGAGED_SHARE * cuts[:, turn.side].max(
        axis=1, keepdims=True, initial=0.0
    )
    has_contact = is_engaged.any(axis=1)
    half_width = 0.5 * turn.width
    outer_radius = turn.radius + np.where(turn.normal_down > 0.0, 0.5 * turn.length * turn.normal_down, 0.0)
    # pieces of a round corner are taken for straight: their outer ends must not be outside of the cylinder, if there is
    # one
    outer_radius = np.minimum(outer_radius, turn.radius[turn.side].max(initial=0.0) or np.inf)
    # across the feed, at both ends and in the middle of the angle of each point
    lateral = outer_radius * np.cos([turn.phi - half_width, turn.phi, turn.phi + half_width])

    def extent(low: Array, high: Array) -> tuple[Array, Array]:
        """Return the smallest of `low` and the largest of `high` (P,) over the engaged points, (n,) each."""
        return np.where(is_engaged, low, np.inf).min(axis=1), np.where(is_engaged, high, -np.inf).max(axis=1)

    enter, leave = (
        np.where(has_contact, angle, np.nan) for angle in extent(turn.phi - half_width, turn.phi + half_width)
    )
    right, left = extent(lateral.min(axis=0), lateral.max(axis=0))
    depth = cutting.product_in_blocks(cuts, turn.height_share).max(axis=1) if turn.side.start > 0 else cuts.max(axis=1)
    return _EngagementSizes(enter, leave, depth.astype(float), np.where(has_contact, left - right, 0.0))
