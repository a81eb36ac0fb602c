"""Compute the forces along the motions of a program from its process: material, tools and stock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from postproc import files
from postproc.errors import MAX_ERRORS, ForceError, Issue, combined_error
from postproc.forces import Knots
from postproc.frames import M_PER_MM, MM_PER_INCH, MM_PER_M, Array, inverse, norm
from postproc.machining import stock as stocks
from postproc.machining.branches import check_branches, near_stock
from postproc.machining.material import CuttingLaw
from postproc.machining.override import override_issues, slow_turn_issues
from postproc.machining.process import Process, StockTable, box_corners
from postproc.machining.profiles import Stations, smooth_steps, thin_out
from postproc.machining.remaining import Ceiling, Guard, StockInTime
from postproc.machining.resolution import CellErrors, ThinPasses, cell_divisors, thin_passes
from postproc.machining.setups import Setup, divide_by_cells, setups
from postproc.machining.stock import Stock
from postproc.machining.stock_mesh import MOST_FILE_CELLS, RemainingMesh, mesh_of
from postproc.machining.sweep import Cuts, Sweep
from postproc.machining.tool_path import (
    AXIS_TOLERANCE,
    Directions,
    Shift,
    StraightSegments,
    ToolPoses,
    ToolStates,
    home_base,
    refuse_unread_cuts,
    shared_cutter_issues,
    stock_base_issues,
    straight_segments,
    tapping_motions,
    tool_states,
    unread_cut_issues,
)
from postproc.program import PTP, Bools, Ints, Program, distinct
from postproc.toolpath import Segments, tip_speeds

_LARGEST_TILT, _SECOND_TILT = np.radians(60.0), np.radians(20.0)
"""Largest angles between z of the map and a tool that turns while it cuts (assumed). Each new map blurs the stock a
little, so the second angle is used only where the first leaves material above the tool."""
_OVERHANG_SHARE = 0.02
"""Largest share of the volume that turning tools remove that may be lost above them (assumed): later cuts of it would
have no force."""
_HOLLOW_SHARE = 0.02
"""Warn if the map of the stock exceeds its volume by more than this share (assumed)."""
_HIDDEN_SHARE, _NOISE_SHARE = 0.05, 5e-4
"""The same for earlier cuts: this share of what they removed, and of the stock; turned maps of one stock differ by less
than a fifth of that (assumed)."""
_LITTLE_CUT = 0.01
"""Warn if a smaller share of the path at feed cuts (assumed): drilling with travel at feed has 1.5 to 4 %."""
_LEAST_FORCE, _LEAST_SHARE = 2.0, 0.02
"""A place cuts beyond this force [N], or beyond this share of the largest, if that is less (assumed)."""
_LARGE_RATIO = 5.0
"""Warn if the path is this many times as large as the stock in X and in Y (assumed)."""
_SAME_DIAMETER = 1e-6
"""Diameters of one tool differ by less [m] (assumed)."""
_DEEP_CUT = 4.0
"""Warn beyond this depth of cut, in tool diameters: no cutter cuts that deep."""
THICK_CHIP = 0.1
"""Warn beyond this feed per tooth, in tool diameters (assumed): catalogues give 0.002 to 0.05."""
_LEAST_TEETH = 1e-9
"""Teeth per second of a spindle that stands still: its cuts are refused."""
_LEAST_RISE = 2e-5
"""Minimum length over which the force of a motion builds up [m] (assumed)."""
_KILOWATT_PER_WATT = 1e-3
_BATCH = 200_000
"""Number of stations to collect before they are thinned out: some 40 MB."""


_ASSUMED_STOCK = (
    "the stock is assumed from the path of the tools: check [stock] of the process, since forces depend on it, and "
    "remove assumed = true"
)


class ProcessForces(Struct, frozen=True, eq=False):
    """Forces, engagement and remaining stock of a program.

    :param knots: the forces along its cutting motions.
    :param cuts: wrench and engagement at stations on them, as many as their changes need, see `Cuts`.
    :param power: (M,) largest mean power of the spindle on each motion [W].
    :param tools: tool and spindle speed of each motion.
    :param drills: whether each of `tools.keys` is a drill.
    :param stock: the remaining stock, in the frame of `map_in_base`.
    :param map_in_base: (4, 4) frame of the height map of the stock in the `$BASE` of the stock, see `home_base`.
    :param removed_volume: volume that the cuts remove [m³].
    :param issues: warnings and notes for the user.
    :param over_time: the stock over time, if it was swept with a guard.
    """

    knots: Knots
    cuts: Cuts
    power: Array
    tools: ToolStates
    drills: tuple[bool, ...]
    stock: Stock
    map_in_base: Array
    removed_volume: float
    issues: tuple[Issue, ...]
    over_time: StockInTime | None

    def mesh(self, most_cells: int = 250_000) -> RemainingMesh:
        """Return the remaining stock as a closed mesh in `$BASE`.

        :param most_cells: with more cells that are not in level regions, the mesh is made coarser.
        """
        mesh = mesh_of(self.stock, most_cells)
        return mesh._replace(vertices=mesh.vertices @ self.map_in_base[:3, :3].T + self.map_in_base[:3, 3])


class _OverhangError(ForceError):
    """A tool that leans leaves material above itself."""


class _ToolColumns(NamedTuple):
    """Values of the tools of a program, one row for each of T entries of `ToolStates.keys`.

    :param diameter_mm: (T,) [mm].
    :param flutes: (T,) number of teeth.
    :param is_drill: (T,) True for drills.
    """

    diameter_mm: Array
    flutes: Ints
    is_drill: Bools

    @classmethod
    def of(cls, tools: ToolStates, process: Process) -> _ToolColumns:
        """Return the values of tools as the process states them."""
        tables = [process.tools[key] for key in tools.keys]
        return cls(
            np.array([table.diameter_mm for table in tables]),
            np.array([table.flutes for table in tables]),
            np.array([table.shape == "drill" for table in tables]),
        )


def estimate(
    program: Program,
    path: Segments,
    process: Process,
    axis: str,
    *,
    stock: Path | None = None,
    base_axes: bool = False,
    shift: Shift | None = None,
    guard: Guard | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ProcessForces:
    """Return the cutting forces of a program.

    Tools that turn while they cut are swept with maps up to `_LARGEST_TILT` from their axis. If one leaves material
    above itself, the program is swept again with `_SECOND_TILT`; if that fails too, the first error is raised.

    :param path: geometry of its motions.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param stock: mesh of the stock, instead of the stock of the process; None: the process has the stock.
    :param base_axes: return wrenches in `$BASE` axes, except on motions along which FEED axes turn; else in FEED axes.
    :param shift: displacement of the tip, see `Shift`; None: no displacement.
    :param guard: parts of the tool that must stay clear of the stock. Where they do not, or cutters touch it in rapid
        moves, the result has an error. None: nothing is compared.
    :param progress: called with the number of straight segments done, and their total number.
    :raises ProgramError: a routine that cuts is not followed.
    :raises ForceError: missing data in the process, unusable stock, no contact at all, the spindle is off while the
        tool cuts, a tool that turns while it cuts leaves material above itself.
    """
    refuse_unread_cuts(program)
    programmed_feed = program.motions.feed
    program = replace(program, motions=replace(program.motions, feed=tip_speeds(program, path)))
    law, tools = process.law(), tool_states(program, process)
    directions = Directions.of(program, path, axis)
    task = _Task(
        program=program,
        programmed_feed=programmed_feed,
        path=path,
        process=process,
        axis=axis,
        law=law,
        tools=tools,
        directions=directions,
        stock=stock,
        base_axes=base_axes,
        shift=shift,
        guard=guard,
        progress=progress,
    )
    try:
        return _forces_up_to_tilt(task, _LARGEST_TILT)
    except _OverhangError as overhang_error:
        try:
            return _forces_up_to_tilt(task, _SECOND_TILT)
        except ForceError:
            raise overhang_error from None


class _Task(NamedTuple):
    """What the forces of a program depend on, see `estimate`.

    :param program: the program; its feeds are the speeds of the tip, see `toolpath.tip_speeds`.
    :param programmed_feed: (M,) feeds as the program states them [m/s].
    :param law: forces of the material per length of cutting edge and chip.
    :param tools: tool and spindle speed of each motion.
    :param directions: directions of the tools along the motions.
    :param stock: mesh of the stock; None: the process has the stock.
    """

    program: Program
    programmed_feed: Array
    path: Segments
    process: Process
    axis: str
    law: CuttingLaw
    tools: ToolStates
    directions: Directions
    stock: Path | None
    base_axes: bool
    shift: Shift | None
    guard: Guard | None
    progress: Callable[[int, int], None] | None

    def segments(self, frame: Array, cell: float) -> StraightSegments:
        """Return the straight segments of all motions in the frame of a height map.

        :param frame: (4, 4) in the `$BASE` of the stock, see `home_base`; `cell`: width of a cell [m].
        """
        return straight_segments(
            self.program, self.path, self.tools, frame, cell, shift=self.shift, directions=self.directions
        )

    def sweep(self, stock: Stock, frame: Array, cell_error_sums: CellErrors) -> Sweep:
        """Return the sweep of the tools through a height map of the stock, before any motion.

        :param stock: the map, which the sweep cuts in place.
        :param frame: (4, 4) of the map in the `$BASE` of the stock [m].
        :param cell_error_sums: sums that the sweep increases in place.
        """
        program, count = self.program, len(self.program.motions)
        leans = ~self.directions.is_within(frame[:3, 2], AXIS_TOLERANCE)  # the tool is not along Z of the map
        return Sweep(
            stock=stock,
            process=self.process,
            tools=self.tools,
            feed=program.motions.feed,
            law=self.law,
            poses=ToolPoses(program, self.path, frame, self.axis, leans),
            swing=np.full(count, np.nan) if program.swivel is None else program.swivel.rate,
            cell_error_sums=cell_error_sums,
            is_deflected=self.shift is not None,
            guard=self.guard,
            ceiling=None if self.guard is None else Ceiling(stock),
        )

    def knots(self, poses: ToolPoses, cuts: Cuts) -> Knots:
        """Return the forces at the stations of cuts as knots along their motions."""
        stations = Stations(cuts.motion, cuts.t, cuts.wrench, cuts.deviation)
        return smooth_steps(
            poses,
            stations,
            self.least_rise(),
            sigma=0.0 if self.law.covariance is not None else self.law.sigma,
            axial_sigma=self.law.unknown_axial,
            base_axes=self.base_axes,
        )

    def least_rise(self) -> Array:
        """Return the smallest length (M,) over which the force of each motion builds up [m]: half a feed per tooth."""
        teeth = _ToolColumns.of(self.tools, self.process).flutes[self.tools.tool]
        # at least one tooth a minute: no division by zero where the spindle is off
        feed_per_tooth = np.nan_to_num(self.program.motions.feed) * 60.0 / np.maximum(self.tools.rpm * teeth, 1.0)
        return np.asarray(np.maximum(0.5 * feed_per_tooth, _LEAST_RISE))


class _SweptSetups(NamedTuple):
    """The sweeps of all set-ups, in their order, and what they leave.

    :param cuts: stations along the cutting motions, as many as the changes of their forces need.
    :param knots: the forces at them, by set-up.
    :param stock: the remaining stock, in the frame of the last set-up.
    :param removed_volume: [m³].
    :param issues: warnings about maps of the stock that hold more than the stock.
    :param is_compared: (M,) motions on which the parts of the tool were compared while the stock was swept.
    :param cell_error_sums: sums (M,) over the stations of each motion.
    """

    sweeps: list[Sweep]
    cuts: Cuts
    knots: list[Knots]
    stock: Stock
    removed_volume: float
    issues: list[Issue]
    is_compared: Bools
    cell_error_sums: CellErrors

    @property
    def collisions(self) -> dict[int, float]:
        """Rapid motions through material, and how deep [m]."""
        return {motion: depth for sweep in self.sweeps for motion, depth in sweep.collisions.items()}

    @property
    def stopped_motions(self) -> set[int]:
        """Cutting motions through material with the spindle off."""
        return set[int]().union(*(sweep.stopped_motions for sweep in self.sweeps))


def _forces_up_to_tilt(task: _Task, max_tilt: float) -> ProcessForces:
    """Return the cutting forces of a program, see `estimate`.

    If the process states no width of cells, a second sweep has finer cells where the contact of the first one is thin.

    :param max_tilt: largest angle between a tool that turns while it cuts and the direction of a height map [rad].
    :raises ForceError: see `estimate`.
    """
    coarse = _swept_program(task, max_tilt, {})
    cell_factors: dict[int, int] = {}
    if task.process.stock.resolution_mm is None:
        setup_begins = [int(np.argmax(setup.motions)) for setup in coarse.setups]
        cell_factors = cell_divisors(coarse.thin_passes, coarse.swept_setups.stock.high.size, setup_begins)
    return _process_forces(task, _swept_program(task, max_tilt, cell_factors) if cell_factors else coarse)


class _SweptProgram(NamedTuple):
    """A program whose stock was swept, before its results are checked for warnings.

    :param setups: set-ups in their order; `segments`: of all motions, in the frame of the first one.
    :param bounds: smallest and largest x, smallest and largest y, and top of the uncut stock in that frame [m].
    :param stock_issues: warnings and notes about the stock.
    :param swept_setups: the sweeps and what they leave.
    :param thin_passes: passes that need finer cells than they had.
    """

    setups: list[Setup]
    segments: StraightSegments
    bounds: tuple[float, ...]
    stock_issues: list[Issue]
    swept_setups: _SweptSetups
    thin_passes: list[ThinPasses]


def _swept_program(task: _Task, max_tilt: float, cell_factors: dict[int, int]) -> _SweptProgram:
    """Sweep the tools of a program through its stock, and refuse cuts whose force cannot be computed.

    :param max_tilt: largest angle between a tool that turns while it cuts and the direction of a height map [rad].
    :param cell_factors: row of a motion → number by which the width of cells is divided from there on.
    :raises ForceError: no usable stock or no contact with it, an unknown force, or a branch that cuts, see `estimate`.
    """
    program, process = task.program, task.process
    if task.guard is not None:
        task.guard.close_distances.clear()  # an earlier sweep may have recorded distances
    ordered_setups = divide_by_cells(setups(program, task.directions, max_tilt), cell_factors, task.directions.cuts)
    frame, cell = ordered_setups[0].frame, process.stock.cell
    material, stock_issues = stock_map(process, frame, cell / ordered_setups[0].factor, task.stock)
    bounds = (*material.material_bounds, material.top)  # x, y and top of the uncut stock
    segments = task.segments(frame, cell)
    _check_spindle_speed(program, segments, task.tools)
    swept_setups = _swept_setups(task, ordered_setups, material, segments)
    _refuse_unknown_forces(program, swept_setups.sweeps)
    if not any(sweep.has_contact for sweep in swept_setups.sweeps):
        raise _no_contact_error(segments, bounds, process, task.stock)
    if program.branches:
        segments_of_map = segments if len(ordered_setups) == 1 else None
        is_near = _motions_near_stock(program, segments_of_map, bounds, process.largest_radius)
        check_branches(program, _engaged_motions(swept_setups.cuts), is_near)
    _refuse_stopped_spindle(program, swept_setups.stopped_motions)
    passes = thin_passes(program, task.tools, swept_setups.cell_error_sums)
    return _SweptProgram(
        setups=ordered_setups,
        segments=segments,
        bounds=bounds,
        stock_issues=stock_issues,
        swept_setups=swept_setups,
        thin_passes=passes,
    )


def _engaged_motions(cuts: Cuts) -> Ints:
    """Return the motions (k,) with a force, ascending."""
    return distinct(cuts.motion[norm(cuts.wrench) > 0.0])


def _process_forces(task: _Task, swept_program: _SweptProgram) -> ProcessForces:
    """Return the forces of a program whose cutters were moved through the stock, with warnings and notes.

    The stock over time is kept only with a guard: the parts of the tool that must stay clear of the stock.
    """
    program, tools, swept_setups = task.program, task.tools, swept_program.swept_setups
    return ProcessForces(
        knots=Knots.join(swept_setups.knots),
        cuts=swept_setups.cuts,
        power=_largest_power(swept_setups.cuts, len(program.motions)),
        tools=tools,
        drills=tuple(_ToolColumns.of(tools, task.process).is_drill.tolist()),
        stock=swept_setups.stock,
        map_in_base=swept_program.setups[-1].frame,  # of the remaining stock: the map of the last set-up
        removed_volume=swept_setups.removed_volume,
        issues=tuple(_program_issues(task, swept_program)),
        over_time=None if task.guard is None else _stock_in_time(program, swept_program.setups, swept_setups),
    )


def _program_issues(task: _Task, swept_program: _SweptProgram) -> list[Issue]:
    """Return all warnings and notes about a swept program, in the order in which they are reported."""
    program, process, tools, guard = task.program, task.process, task.tools, task.guard
    segments, bounds, swept_setups = swept_program.segments, swept_program.bounds, swept_program.swept_setups
    engaged_motions = _engaged_motions(swept_setups.cuts)
    has_one_map = len(swept_program.setups) == 1
    return [
        *swept_program.stock_issues,
        *override_issues(program),
        *slow_turn_issues(program, task.programmed_feed, engaged_motions),
        *stock_base_issues(program),
        *(_beside_stock_issues(program, segments, bounds, process.largest_radius) if has_one_map else []),
        *swept_setups.issues,
        *unread_cut_issues(program),
        *shared_cutter_issues(program, tools, engaged_motions),
        *_scale_issues(segments, bounds),
        *_little_cut_issues(segments, swept_setups.cuts, len(program.motions)),
        *_cut_issues(program, task.law, swept_setups.cuts, tools, process),
        *_coarse_contact_warnings(program, tools, swept_program.thin_passes, swept_program.setups, process.stock),
        *_collision_issues(program, swept_setups.collisions, guard),
        *_cutter_mismatch_issues(program, tools, process, guard),
    ]


def _largest_power(cuts: Cuts, count: int) -> Array:
    """Return the largest mean power (count,) of the spindle on each motion [W], 0 without a cut."""
    power = np.zeros(count)
    np.maximum.at(power, cuts.motion, cuts.power)
    return power


def _motions_near_stock(
    program: Program, segments: StraightSegments | None, bounds: tuple[float, ...], margin: float
) -> Bools:
    """Return True for motions (M,) that may come near the stock as it is before the program.

    These are all motions of a tool with several directions: it may touch the stock while its tip is next to it.

    :param segments: segments of all motions, in the frame of the height map; None: the tool has several directions.
    :param bounds: smallest and largest x, smallest and largest y, and top of the stock [m].
    :param margin: radius of the widest tool [m].
    """
    count = len(program.motions)
    return np.ones(count, dtype=bool) if segments is None else near_stock(segments, bounds, margin, count)


def _swept_setups(
    task: _Task, ordered_setups: list[Setup], material: Stock, segments: StraightSegments
) -> _SweptSetups:
    """Cut the stock by the motions of all set-ups, one after the other.

    A set-up is a range of motions that share a height map of the stock, along one direction of the tool.

    :param material: the stock in the frame of the first set-up; it is cut in place.
    :param segments: straight segments of all motions in that frame.
    """
    program, count = task.program, len(task.program.motions)
    start_volume, removed_volume, segment_count = material.volume(), 0.0, 0  # of the set-up; of those before it
    sweeps, cuts_of_setups, knots, issues = list[Sweep](), list[Cuts](), list[Knots](), list[Issue]()
    is_compared, cell_error_sums = np.zeros(count, dtype=bool), CellErrors(*np.zeros((4, count)))
    for number, setup in enumerate(ordered_setups):
        setup_segments = segments
        if number:
            removed_volume += start_volume - material.volume()
            remaining_volume = material.volume()
            material = _next_map(material, ordered_setups[number - 1], setup, task.process.stock.cell)
            start_volume = material.volume()
            issues += _hidden_cut_issues(start_volume - remaining_volume, removed_volume, remaining_volume)
            setup_segments = task.segments(setup.frame, material.cell)
        setup_segments = setup_segments.of(setup.motions)
        is_compared[setup_segments.motion[~setup_segments.leans]] = True
        sweep = task.sweep(material, setup.frame, cell_error_sums)
        progress = _progress_of_part(task.progress, segment_count, len(segments.motion))
        cuts = _without_taps(_needed_stations(sweep, setup_segments, progress), program, task.tools)
        segment_count += len(setup_segments.motion)
        sweeps.append(sweep)
        cuts_of_setups.append(cuts)
        if len(cuts.motion):  # none where the spindle is off on all motions of a set-up: refused with their lines later
            knots.append(task.knots(sweep.poses, cuts))
    return _SweptSetups(
        sweeps=sweeps,
        cuts=Cuts.join(cuts_of_setups),
        knots=knots,
        stock=material,
        removed_volume=removed_volume + start_volume - material.volume(),
        issues=issues,
        is_compared=is_compared,
        cell_error_sums=cell_error_sums,
    )


def _refuse_unknown_forces(program: Program, sweeps: list[Sweep]) -> None:
    """Refuse cuts of tools that lean or turn if their force cannot be computed on a height map of the stock.

    :raises ForceError: a tool turns in material with its tip at rest, at an unknown speed; or tools leave more
        material above themselves than `_OVERHANG_SHARE` of their cuts.
    """
    name, lines = program.documents[0].name, program.motions.line
    unpaced_motions = set[int]().union(*(sweep.unpaced_motions for sweep in sweeps))
    if unpaced_motions:
        problem = "the tool turns in material while its tip rests, at a speed that the program does not state"
        advice = "Move the tip with the turn, turn outside of the material, or give a force by [operations]."
        raise ForceError(problem, file=name, line=int(lines[min(unpaced_motions)]), advice=advice)
    overhang = {motion: volume for sweep in sweeps for motion, volume in sweep.overhang.items()}
    share = sum(overhang.values()) / max(sum(sweep.tilted_volume for sweep in sweeps), 1e-18)
    if share > _OVERHANG_SHARE:
        worst = max(overhang, key=lambda motion: (overhang[motion], -motion))  # the first of equal motions
        problem = (
            f"the tool leaves material above itself, as in an undercut: {overhang[worst] * MM_PER_M**3:.3g} mm³ here, "
            f"{100 * share:.0f} % of all that tools cut as they turn. The stock is a map with one height at each place"
        )
        advice = "Give the forces of such operations by [operations] or as a CSV file."
        raise _OverhangError(problem, file=name, line=int(lines[worst]), advice=advice)


def _stock_in_time(program: Program, setups: list[Setup], swept_setups: _SweptSetups) -> StockInTime:
    """Return the stock over time of set-ups that were swept with a guard (parts of the tool that must stay clear)."""
    base = program.bases[home_base(program)]
    return StockInTime(
        first=tuple(int(np.argmax(setup.motions)) for setup in setups),
        frame=tuple(base @ setup.frame for setup in setups),
        ceiling=tuple(sweep.ceiling for sweep in swept_setups.sweeps if sweep.ceiling is not None),
        is_compared=swept_setups.is_compared,
        removes_material=~program.motions.rapid,
    )


def _progress_of_part(
    progress: Callable[[int, int], None] | None, first: int, total: int
) -> Callable[[int], None] | None:
    """Return a callback that takes the number of segments done of a part which begins at segment `first` of `total`.

    :param progress: takes the number of segments done of all, and their total number; None: the result is None too.
    """
    return None if progress is None else lambda count: progress(first + count, total)


def _needed_stations(sweep: Sweep, segments: StraightSegments, progress: Callable[[int], None] | None) -> Cuts:
    """Sweep segments, and return the stations that their forces need, thinned out batch by batch to limit memory.

    A station is a place of the tool on a cutting motion for which its force is computed. The last motion of a batch may
    continue in the next one: its stations are thinned with those of the next batch.

    :param progress: called with the number of segments done.
    """
    thin_cuts: list[Cuts] = []
    pending_cuts: list[Cuts] = []
    pending_count = 0
    for new_cuts in sweep.run(segments, progress):
        pending_cuts.append(new_cuts)
        pending_count += len(new_cuts.t)
        if pending_count > _BATCH:
            cuts = Cuts.join(pending_cuts)
            # stations are in the order of motions: those of the last motion, which may continue, are at the end
            complete_count = int(np.searchsorted(cuts.motion, cuts.motion[-1], side="left"))
            partial_cuts, cuts = cuts.take(slice(complete_count, None)), cuts.take(slice(None, complete_count))
            thin_cuts.append(cuts.take(thin_out(cuts.motion, cuts.wrench)))
            pending_cuts, pending_count = [partial_cuts], len(partial_cuts.t)
    cuts = Cuts.join([Cuts.empty(), *pending_cuts])
    return Cuts.join([*thin_cuts, cuts.take(thin_out(cuts.motion, cuts.wrench))])


def _without_taps(cuts: Cuts, program: Program, tools: ToolStates) -> Cuts:
    """Return cuts in which the stations of taps have zero wrench, deviation, torque and power.

    A tap pulls itself into the hole, in a holder with axial float: its force is not that of a drill that feeds by the
    pitch.
    """
    is_tap = np.isin(cuts.motion, tapping_motions(program, tools)) & cuts.is_axial
    if not is_tap.any():
        return cuts
    is_cut = ~is_tap
    return replace(
        cuts,
        wrench=cuts.wrench * is_cut[:, None],
        deviation=cuts.deviation * is_cut[:, None],
        torque=cuts.torque * is_cut,
        power=cuts.power * is_cut,
    )


def _tap_issues(program: Program, cuts: Cuts, tools: ToolStates) -> Iterator[Issue]:
    """Yield a warning for taps, whose forces are not computed."""
    taps = np.intersect1d(tapping_motions(program, tools), cuts.motion[cuts.is_axial])
    if len(taps):
        number = tools.number[taps[0]]
        name = f"[operations.T{number}]" if number > 0 else "[operations]"
        message = (
            "forces of taps are not computed: none is assumed, as in a floating holder. If this tap pushes the tool, "
            f"state its force in {name} of the process"
        )
        yield program.motions.issue("warning", "tap-force", message, taps)


def _next_map(material: Stock, last_setup: Setup, setup: Setup, cell: float) -> Stock:
    """Return the remaining stock of one set-up as the height map of the next: finer, or along another direction.

    A set-up is a range of motions that share a height map, along one direction of the tool.

    :param material: map of the stock at the end of `last_setup`.
    :param cell: width of a cell that is not divided [m].
    """
    if np.array_equal(last_setup.frame, setup.frame):
        ratio = -(-setup.factor // last_setup.factor)  # rounded up to a whole number
        return stocks.refine(material, ratio) if ratio > 1 else material
    mesh = mesh_of(material, MOST_FILE_CELLS)
    to_map = inverse(setup.frame) @ last_setup.frame
    return stocks.from_mesh(mesh.vertices @ to_map[:3, :3].T + to_map[:3, 3], mesh.faces, cell / setup.factor)


def stock_map(process: Process, frame: Array, cell: float, path: Path | None) -> tuple[Stock, list[Issue]]:
    """Return the height map of the stock before the program, and warnings and notes about it.

    :param frame: (4, 4) frame of the map in the `$BASE` of the stock; `cell`: width of a cell [m].
    :param path: mesh of the stock, instead of that of the process; None: that of the process.
    :raises ForceError: no stock, or two, or a mesh that cannot be used.
    """
    table = process.stock
    issues = [Issue("warning", "assumed-stock", _ASSUMED_STOCK)] if table.assumed and path is None else []
    if path is None and table.box is not None and table.file is not None:
        raise ForceError("[stock] has a box and a file", file=process.path, advice="Give one of them.")
    if path is None and table.file is not None:
        path = Path(process.path).parent / table.file
    if path is not None:
        mesh, file = _placed_mesh(path, table.place.pose()), str(path)
    elif table.box is not None:
        low, high = box_corners(table.box)
        if np.array_equal(frame, np.eye(4)):
            return stocks.from_box(low, high, cell, process.path), issues
        mesh, file = _box_mesh(low, high), process.path
    else:
        raise ForceError("no stock", file=process.path, advice="Give [stock] box or file, or --stock STOCK.stl.")
    to_map = inverse(frame)
    material = stocks.from_mesh(mesh.vertices @ to_map[:3, :3].T + to_map[:3, 3], mesh.faces, cell, file)
    return material, [*issues, *_hollow_stock_issues(material.volume(), mesh.volume)]


class _StockMesh(NamedTuple):
    """The surface of the uncut stock, in the `$BASE` of the stock.

    :param vertices: (V, 3) [m]; `faces`: (F, 3).
    :param volume: volume that the surface encloses [m³].
    """

    vertices: Array
    faces: NDArray[np.int64]
    volume: float


def _box_mesh(low: Array, high: Array) -> _StockMesh:
    """Return the mesh of a box from corner `low` (3,) to `high` (3,) [m]."""
    import trimesh

    box = trimesh.creation.box(bounds=np.stack([low, high]))
    return _StockMesh(np.asarray(box.vertices), np.asarray(box.faces), float(np.prod(high - low)))


def _placed_mesh(path: Path, pose: Array) -> _StockMesh:
    """Return the closed mesh of a file, which is in mm, at a pose (4, 4) [m] in the `$BASE` of the stock.

    :raises ForceError: the mesh cannot be read, contains no surface or is not closed.
    """
    mesh = _closed_mesh(path)
    vertices = np.asarray(mesh.vertices, dtype=float) * M_PER_MM @ pose[:3, :3].T + pose[:3, 3]
    return _StockMesh(vertices, np.asarray(mesh.faces, dtype=np.int64), abs(float(mesh.volume)) * M_PER_MM**3)


def _hidden_cut_issues(gain: float, removed_volume: float, remaining_volume: float) -> list[Issue]:
    """Return a warning if earlier cuts overhang along the new direction of the tool: they count as material again.

    The limit of the gain is the lower of two: a share of the old map, and a share of what was cut (at least the noise).

    :param gain: volume of the new height map beyond that of the old one [m³].
    :param removed_volume: volume that was removed before [m³].
    :param remaining_volume: volume of the old height map [m³].
    """
    hidden_limit = max(_HIDDEN_SHARE * removed_volume, _NOISE_SHARE * remaining_volume)
    if gain <= min(_HOLLOW_SHARE * remaining_volume, hidden_limit):
        return []
    message = (
        "what was cut before this program turned the tool overhangs, seen along the tool now: "
        f"{100 * min(gain / max(removed_volume, 1e-18), 1.0):.0f} % of it counts as material again, and later cuts "
        "there have too large a force. Give forces for them, or divide the program and give the stock of each part"
    )
    return [Issue("warning", "hidden-cuts", message)]


def _hollow_stock_issues(map_volume: float, volume: float) -> list[Issue]:
    """Return a warning if the height map of a stock has more material than the stock.

    :param map_volume: volume of the map, and `volume` of the stock [m³].
    """
    hollow_share = map_volume / max(volume, 1e-18) - 1.0
    if hollow_share <= _HOLLOW_SHARE:
        return []
    message = (
        "the stock has hollows or undercuts, seen along the tool: they are treated as material "
        f"({100 * hollow_share:.0f} % more than the volume of the mesh)"
    )
    return [Issue("warning", "hollow-stock", message)]


def _closed_mesh(path: Path) -> Any:
    """Read a closed mesh.

    :raises ForceError: the mesh cannot be read, contains no surface or is not closed.
    """
    mesh = files.read_mesh(path, ForceError, "mesh of the stock")
    if not mesh.is_watertight:
        mesh.merge_vertices()
    if not mesh.is_watertight:
        advice = "Close it in CAD or with a mesh repair tool: an open surface does not define its inside."
        raise ForceError("the mesh of the stock is not closed", file=str(path), advice=advice)
    return mesh


def _check_spindle_speed(program: Program, segments: StraightSegments, tools: ToolStates) -> None:
    """Refuse a program that cuts, but never with a spindle speed.

    :raises ForceError: no cutting move has a spindle speed; the message names the cause.
    """
    motion = distinct(segments.motion[segments.cutting])
    if len(motion) and not (tools.rpm[motion] > 0.0).any():
        start_events = [event for event in program.events if event.kind in ("spindle_on", "spindle_ccw")]
        stop_lines = [
            event.line for event in program.events if event.kind == "spindle_off" and event.before <= motion[0]
        ]
        line = int(program.motions.line[motion[0]])
        problem, advice = (
            "the spindle is never started",
            "Give S and M3 in the program, or [tools.n] rpm in the process file.",
        )
        if program.keeps_text:  # a robot program states no spindle speed
            problem, advice = "the spindle speed is not known", "Give rpm in [tools.n] of the process file."
        if any(event.value > 0.0 for event in start_events) and stop_lines:
            problem, advice = (
                f"the cuts begin with the spindle off: line {stop_lines[-1]} stops it",
                "Stop it behind the cuts.",
            )
        elif start_events:
            problem, line = "the spindle is started without a speed", start_events[0].line
        raise ForceError(problem, file=program.documents[0].name, line=line, advice=advice)


def _refuse_stopped_spindle(program: Program, stopped_motions: set[int]) -> None:
    """Refuse cutting motions through material with the spindle off.

    :param stopped_motions: rows of these motions.
    :raises ForceError: a motion cuts with the spindle off; one error for each line.
    """
    if stopped_motions:
        lines, name = program.motions.line, program.documents[0].name
        advice = "Start the spindle (M3 S…) before the cut, or lift the tool."
        raise combined_error(
            ForceError("the tool moves through material while the spindle is off", file=name, line=line, advice=advice)
            for line in sorted({int(lines[motion]) for motion in stopped_motions})[: MAX_ERRORS + 1]
        )


def _cut_issues(program: Program, law: CuttingLaw, cuts: Cuts, tools: ToolStates, process: Process) -> Iterator[Issue]:
    """Yield warnings and notes about the cuts: material, power, tools, depths and chips."""
    lines = program.motions.line
    columns, tool = _ToolColumns.of(tools, process), tools.tool[cuts.motion]
    diameter, is_drill = columns.diameter_mm[tool] * M_PER_MM, columns.is_drill[tool]
    has_force = norm(cuts.wrench) > 0.0
    if law.warning is not None:
        yield Issue("warning", "material", law.warning)
    yield from _power_warnings(cuts, lines, process.spindle.power_kW)
    if law.unknown_axial and not is_drill.all():
        message = (
            "the material has no axial coefficients: the axial force is missing. Measured axial forces are 40 to 90 % "
            f"of the force across the feed; the bound includes {100 * law.unknown_axial:.0f} % of it. Give "
            "axial_ratio, or Kac and Kae, or measure them (identify forces)."
        )
        yield Issue("info", "no-axial-force", message)
    yield from _tap_issues(program, cuts, tools)
    yield from _mill_drilling_issues(program, cuts, is_drill)
    yield from _chip_load_issues(program, cuts, tools, process)
    yield from _drill_thrust_notes(lines, cuts, is_drill & has_force)
    yield from _deep_cut_warnings(lines, cuts, np.where(is_drill | ~has_force, np.inf, _DEEP_CUT * diameter))


def _drill_thrust_notes(lines: Ints, cuts: Cuts, is_drilling: Bools) -> Iterator[Issue]:
    """Yield a note that the feed force of drills is estimated.

    :param lines: (M,) lines of the motions; `is_drilling` (N,) stations at which a drill cuts.
    """
    if is_drilling.any():
        message = (
            "the feed force of drills is estimated: 0.65 kc fn D/2, the middle of published thrusts. It depends on the "
            "chisel edge in the middle: the bound includes 38 % more or less. Measure it, or give forces in a file, "
            "where the depth of holes matters."
        )
        drill_lines = distinct(lines[cuts.motion[is_drilling]])
        yield Issue("info", "drill-thrust", message, int(drill_lines[0]), count=len(drill_lines))


def _deep_cut_warnings(lines: Ints, cuts: Cuts, limit: Array) -> Iterator[Issue]:
    """Yield a warning for depths of cut that no cutter reaches: the stock has another position or unit.

    :param lines: (M,) lines of the motions.
    :param limit: (N,) largest usual depth at each station [m]; infinite: there is none.
    """
    deep_rows = np.flatnonzero(cuts.depth > limit)
    if len(deep_rows):
        worst = deep_rows[int(np.argmax(cuts.depth[deep_rows]))]
        message = (
            f"a depth of cut of {cuts.depth[worst] * MM_PER_M:.4g} mm, more than {_DEEP_CUT:g} diameters: check "
            "position and units of the stock (an inch is 25.4 mm)"
        )
        yield Issue("warning", "deep-cut", message, int(lines[cuts.motion[worst]]), count=len(deep_rows))


def _chip_load_issues(program: Program, cuts: Cuts, tools: ToolStates, process: Process) -> Iterator[Issue]:
    """Yield a warning where the feed per tooth is a large part of the tool: a wrong unit, or a move that is no cut."""
    columns, tool = _ToolColumns.of(tools, process), tools.tool[cuts.motion]
    diameter = columns.diameter_mm[tool]
    teeth_per_second = tools.rpm[cuts.motion] / 60.0 * columns.flutes[tool]
    chip = MM_PER_M * program.motions.feed[cuts.motion] / np.maximum(teeth_per_second, _LEAST_TEETH)
    has_force = norm(cuts.wrench) > 0.0  # stations in air precede and follow cuts
    rows = np.flatnonzero((chip > THICK_CHIP * diameter) & ~columns.is_drill[tool] & has_force)
    if len(rows):
        worst = rows[int(np.argmax(chip[rows]))]
        message = (
            f"{chip[worst]:.3g} mm per tooth with a tool of {diameter[worst]:.4g} mm: check feed, speed and "
            "flutes, or whether this move is to go through the material at all"
        )
        yield Issue("warning", "chip-load", message, int(program.motions.line[cuts.motion[worst]]), count=len(rows))


def _coarse_contact_warnings(
    program: Program, tools: ToolStates, passes: list[ThinPasses], ordered_setups: list[Setup], stock: StockTable
) -> Iterator[Issue]:
    """Yield a warning for each tool whose forces are uncertain because its contact is few cells of the height map wide.

    :param passes: passes with such a contact; the worst of each tool is named.
    :param ordered_setups: set-ups in their order, which divide the width of cells.
    :param stock: `[stock]` of the process.
    """
    alternative = "" if stock.resolution_mm is None else ", or no resolution_mm"
    for number in sorted({thin_pass.tool for thin_pass in passes}):
        worst = max((thin_pass for thin_pass in passes if thin_pass.tool == number), key=lambda item: item.excess)
        factor = next(setup.factor for setup in ordered_setups if setup.motions[worst.first])
        needed_cell_mm = stock.cell / factor * MM_PER_M / worst.excess
        key, line = tools.keys[number], int(program.motions.line[worst.first])
        message = (
            f"the contact of [tools.{key}] is few cells of the stock wide from here on: the standard deviation of its "
            f"forces by that is {100 * worst.force_share:.0f} % RMS. Give [stock] resolution_mm = {needed_cell_mm:.2g}"
            f", with which it is {100 * worst.force_share / worst.excess:.0f} %{alternative}"
        )
        yield Issue("warning", "coarse-stock", message, line, subject=key)


def _cutter_mismatch_issues(
    program: Program, tools: ToolStates, process: Process, guard: Guard | None
) -> Iterator[Issue]:
    """Yield an error if the cutter of [collision] has another diameter than a tool that cuts.

    :param guard: the tool of [collision]; None: collisions are not checked, and there is no error.
    """
    if guard is None or guard.cutter is None:
        return
    tool_keys = [tools.keys[n] for n in distinct(tools.tool[~program.motions.rapid]).tolist()]
    diameters = {key: process.tools[key].diameter_mm for key in tool_keys}
    differing_keys = [
        key for key, diameter in diameters.items() if abs(diameter * M_PER_MM - guard.cutter) > _SAME_DIAMETER
    ]
    if differing_keys:
        differences = ", ".join(f"tools.{key} of the process has {diameters[key]:g} mm" for key in differing_keys)
        message = (
            f"[collision] holder begins with a cutter of {guard.cutter * MM_PER_M:g} mm, but {differences}: "
            "collisions would be those of another tool. Give the cylinders of the tool that this program uses, and "
            "divide the program where it changes tools"
        )
        yield Issue("error", "other-cutter", message)


def _collision_issues(program: Program, depth_of_motion: dict[int, float], guard: Guard | None) -> Iterator[Issue]:
    """Yield errors for cutters that touch the stock in rapid moves, and for other parts of the tool that come close.

    :param depth_of_motion: row of a rapid motion through material → its depth [m].
    :param guard: parts that were compared with the stock, and those that came too close; None: none were.
    """
    if depth_of_motion:
        yield _rapid_collision(program, depth_of_motion, has_guard=guard is not None)
    if guard is None:
        return
    for part in guard.parts:
        distance_of_motion = {
            motion: distance for (name, motion), distance in guard.close_distances.items() if name == part.name
        }
        if distance_of_motion:
            yield _part_collision(program, part.name, distance_of_motion, guard.min_distance)


def _rapid_collision(program: Program, depth_of_motion: dict[int, float], *, has_guard: bool) -> Issue:
    """Return the error for rapid motions through material.

    :param depth_of_motion: row of a motion → depth in material [m].
    :param has_guard: collisions are checked: the error is one of kind "collision".
    """
    m, motion = program.motions, np.array(sorted(depth_of_motion))
    lines = distinct(m.line[motion]).tolist()
    depth_text = f"{max(depth_of_motion.values()) * MM_PER_M:.2g} mm deep"
    tool_note = _tool_length_advice(program, max(depth_of_motion, key=lambda row: (depth_of_motion[row], -row)))
    advice = f"{_rapid_advice(program, motion)}{tool_note}"
    if has_guard:
        message = f"collision: cutter goes {depth_text} into the stock in a rapid move. {advice}"
        return replace(m.issue("error", "collision", message, motion), subject="cutter, stock")
    place = f"line {', '.join(map(str, lines[:5]))}{' …' if len(lines) > 5 else ''}"
    message = f"a rapid move goes through material ({place}), {depth_text}. {advice}"
    return replace(m.issue("error", "rapid-in-material", message, motion), count=len(lines))


def _part_collision(program: Program, name: str, distance_of_motion: dict[int, float], min_distance: float) -> Issue:
    """Return the error for a part of the tool that comes too close to the stock.

    :param name: name of the part.
    :param distance_of_motion: row of a motion → smallest distance of the part from the stock [m]; 0: it touches.
    :param min_distance: smallest allowed distance [m].
    """
    m = program.motions
    worst = min(distance_of_motion, key=lambda motion: (distance_of_motion[motion], motion))
    distance = distance_of_motion[worst] * MM_PER_M
    contact_text = "touches the stock" if distance == 0.0 else f"comes within {distance:.2g} mm of the stock"
    message = (
        f"collision: {name} {contact_text} that is left here; [collision] asks for {min_distance * MM_PER_M:g} mm. "
        "Use a longer tool, cut here first, or correct the holder in the cell"
    )
    lines = tuple(distinct(m.line[np.array(sorted(distance_of_motion))]).tolist())
    issue = Issue("error", "collision", message, int(m.line[worst]), count=len(distance_of_motion), lines=lines)
    return replace(issue, subject=f"{name}, stock")


def _rapid_advice(program: Program, motion: Ints) -> str:
    """Return advice on rapid motions through material.

    The first motion of a G-code program begins at [start] of the cell, which the advice then names.

    :param motion: (n,) rows of these motions, ascending.
    """
    first, is_robot_program = int(motion[0]), program.keeps_text
    if first == 0 and program.motions.kind[0] == PTP and not is_robot_program:
        return (
            "On the way from [start] to the first target all axes move at once (PTP): choose [start] joints with the "
            "tip above the part, or lift the first target"
        )
    if (program.motions.kind[motion] == PTP).any():
        return "All axes move at once on a PTP, not the tip along a line: retract before it, or go there by LIN"
    return (
        "Retract, or cut here first. If another program cuts here first, state the stock that it leaves: "
        "[stock] file of the process"
    )


def _tool_length_advice(program: Program, motion: int) -> str:
    """Return the advice on a rapid motion that begins with a longer tool than the last; empty if it does not."""
    tool = program.motions.tool
    reach = norm(program.tools[:, :3, 3])
    extra_length = reach[tool[motion]] - reach[tool[motion - 1]] if motion else 0.0
    if extra_length <= 0.0:
        return ""
    return f". The new tool is {extra_length * MM_PER_M:.4g} mm longer: retract further before the tool change"


def _power_warnings(cuts: Cuts, lines: Ints, limit: float | None) -> list[Issue]:
    """Return a warning if cuts take more than the power of the spindle.

    :param lines: (M,) lines of the motions.
    :param limit: power of the spindle [kW]; None: not stated.
    """
    power = cuts.power * _KILOWATT_PER_WATT
    overload_rows = np.flatnonzero(power > (np.inf if limit is None else limit))
    if not len(overload_rows):
        return []
    worst = overload_rows[int(np.argmax(power[overload_rows]))]
    message = (
        f"the cut takes {power[worst]:.2g} kW, more than the {limit:g} kW of [spindle] power_kW: reduce feed or depth"
    )
    count = len(distinct(lines[cuts.motion[overload_rows]]))
    return [Issue("warning", "spindle-power", message, int(lines[cuts.motion[worst]]), count=count)]


def _mill_drilling_issues(program: Program, cuts: Cuts, is_drill: Bools) -> list[Issue]:
    """Return a warning if drilling cycles of G-code use a milling tool.

    A cycle is one line that makes rapid moves and cuts along the spindle. Robot programs have none: no warning.

    :param is_drill: (N,) True at stations of a drill.
    """
    m, is_robot_program = program.motions, program.keeps_text
    axial_cuts = distinct(cuts.motion[cuts.is_axial & ~is_drill & (cuts.torque > 0.0)])
    if is_robot_program or not len(axial_cuts):
        return []
    is_in_cycle = np.isin(m.line[axial_cuts], distinct(m.line[m.rapid]))
    if not is_in_cycle.any():
        return []
    message = (
        "a drilling cycle with a milling tool of the process file: its forces are those of plunge milling. "
        'If it is a drill, give shape = "drill" in its [tools] entry.'
    )
    return [m.issue("warning", "drilled-by-mill", message, axial_cuts[is_in_cycle])]


def _scale_issues(segments: StraightSegments, bounds: tuple[float, ...]) -> list[Issue]:
    """Return a warning if the path is many times as large as the stock in X and in Y: one of them may be in inches.

    :param segments: segments of all motions, in the frame of the height map.
    :param bounds: smallest and largest x, smallest and largest y, and top of the stock [m].
    """
    x_low, x_high, y_low, y_high, _ = bounds
    low = np.minimum(segments.begin, segments.end)[segments.cutting, :2].min(axis=0)
    high = np.maximum(segments.begin, segments.end)[segments.cutting, :2].max(axis=0)
    ratio = float(((high - low) / np.maximum([x_high - x_low, y_high - y_low], 1e-9)).min())
    if ratio < _LARGE_RATIO:
        return []
    message = (
        f"the path is {ratio:.0f} times as large as the stock in X and Y: check the units of both (an inch is 25.4 mm, "
        "a metre 1000)"
    )
    return [Issue("warning", "stock-scale", message)]


def _little_cut_issues(segments: StraightSegments, cuts: Cuts, count: int) -> list[Issue]:
    """Return a warning if hardly any of the path at feed cuts: frame or place of the stock may be wrong.

    :param segments: segments of all motions.
    :param count: number of motions M.
    """
    cutting = segments.take(np.flatnonzero(segments.cutting))
    length = np.bincount(cutting.motion, norm(cutting.end - cutting.begin), minlength=count)
    order = np.lexsort((cuts.t, cuts.motion))
    motion, t, force = cuts.motion[order], cuts.t[order], norm(cuts.wrench[order, :3])
    # linear between stations, and constant up to the ends of a motion
    least = min(_LEAST_FORCE, _LEAST_SHARE * force.max(initial=0.0))
    low, high = np.minimum(force[1:], force[:-1]), np.maximum(force[1:], force[:-1])
    share = np.where(low > least, 1.0, np.clip((high - least) / np.maximum(high - low, 1e-9), 0.0, 1.0))
    is_same = np.diff(motion) == 0
    is_cut, is_first, is_last = force > least, np.append(True, ~is_same), np.append(~is_same, True)
    cut_length = float(
        (share * np.diff(t) * length[motion[1:]])[is_same].sum()
        + (t * length[motion])[is_first & is_cut].sum()
        + ((1.0 - t) * length[motion])[is_last & is_cut].sum()
    )
    path_length = float(length.sum())
    if least == 0.0 or cut_length >= _LITTLE_CUT * path_length:
        return []
    message = (
        f"{100 * cut_length / path_length:.2g} % of the path at feed cuts: {cut_length * MM_PER_M:.3g} of "
        f"{path_length * MM_PER_M:.4g} mm. Check frame, place and size of the stock"
    )
    return [Issue("warning", "little-cut", message)]


def _beside_stock_issues(
    program: Program, segments: StraightSegments, bounds: tuple[float, ...], tool_radius: float
) -> list[Issue]:
    """Return a warning if a run of cuts between two rapid moves of a CAM program is nowhere near the stock.

    No warning is made for a robot program, whose moves at feed may also position. Heights do not count.

    :param segments: segments of all motions, in the frame of the height map of the stock.
    :param bounds: smallest and largest x, smallest and largest y, and top of the stock [m].
    :param tool_radius: radius of the widest tool [m]: a run shorter than twice this radius does not count.
    """
    m = program.motions
    if program.keeps_text:  # a robot program
        return []
    x_low, x_high, y_low, y_high, _ = bounds
    is_near = near_stock(segments, (x_low, x_high, y_low, y_high, np.inf), tool_radius, len(m))  # at any height
    horizontal_step = norm((segments.end - segments.begin)[:, :2])
    length = np.bincount(segments.motion, horizontal_step, minlength=len(m))
    cut_motions = np.flatnonzero(~m.rapid)
    # number of the run of each cutting motion; −2 before the first motion begins the first run
    run = np.cumsum(np.diff(cut_motions, prepend=-2) > 1) - 1
    count = int(run[-1]) + 1 if len(run) else 0
    is_beside = (np.bincount(run, is_near[cut_motions], count) == 0.0) & (
        np.bincount(run, length[cut_motions], count) > 2.0 * tool_radius
    )
    motions = cut_motions[is_beside[run]]
    if not len(motions):
        return []
    limits_x, limits_y = (
        f"{low * MM_PER_M:.4g} … {high * MM_PER_M:.4g}" for low, high in ((x_low, x_high), (y_low, y_high))
    )
    message = (
        f"cuts beside the stock, which lies within X {limits_x}, Y {limits_y} mm: they have no force, and are not "
        "corrected. Does [stock] describe another part? Give one for all, or convert part by part"
    )
    return [m.issue("warning", "beside-stock", message, motions)]


def _no_contact_error(
    segments: StraightSegments, bounds: tuple[float, ...], process: Process, stock: Path | None
) -> ForceError:
    """Return the error for a tool that never touches the stock, with the extents of both.

    :param segments: segments of all motions, in the frame of the height map.
    :param bounds: smallest and largest x, smallest and largest y, and top of the stock [m].
    :param stock: path of the mesh of the stock, for the message; None: the path of the process.
    """
    x_low, x_high, y_low, y_high, top = (MM_PER_M * value for value in bounds)
    cutting = segments.cutting
    low = MM_PER_M * np.minimum(segments.begin, segments.end)[cutting].min(axis=0)
    high = MM_PER_M * np.maximum(segments.begin, segments.end)[cutting].max(axis=0)
    problem = (
        "the tool never touches the stock: cutting moves lie within "
        f"X {low[0]:.4g} … {high[0]:.4g}, Y {low[1]:.4g} … {high[1]:.4g}, Z {low[2]:.4g} … {high[2]:.4g} mm, the "
        f"stock within X {x_low:.4g} … {x_high:.4g}, Y {y_low:.4g} … {y_high:.4g}, top Z {top:.4g} mm"
    )
    advice = "Give stock and program in the same frame ($BASE)."
    stock_size, path_size = np.array([x_high - x_low, y_high - y_low]), high[:2] - low[:2]
    ratio = float(np.max(path_size) / max(float(np.max(stock_size)), 1e-9))
    for factor, unit in ((MM_PER_INCH, "inches"), (MM_PER_M, "metres")):
        for size, share in (("smaller", ratio / factor), ("larger", ratio * factor)):
            if 0.3 < share < 3.0:  # about a unit over a millimetre: path and stock differ somewhat in size
                advice += f" The stock is {size} by about {factor:g}: is one of them in {unit}?"
    return ForceError(problem, file=str(stock or process.path), advice=advice)
