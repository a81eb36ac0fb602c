"""Forces of a process: files of `postproc forces` and `identify forces`; the cut of the deflected tool; held feeds.

Imported only where a process is given: the models of cutting are loaded with it.

Held feeds are as high as those of the program, and as low as the force model says the tolerance of the part needs. The
force on an edge is that of its rubbing plus a part that grows with the feed f as f^(1 − mc). mc is 0 in the linear
edge-force model, else Kienzle's exponent (see `machining.material.CuttingLaw`). The expected error is nearly linear in
that too. So its root is found by false position in f^(1 − mc), each motion for itself, with the step of the Illinois
method where one end of the bracket stays (Dowell and Jarratt, BIT 11, 1971). Every trial is a whole conversion: swept,
corrected, written, read back and simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from postproc import cell as cells
from postproc import correction, forces, machining, toolpath
from postproc.cell import Cell, Collision
from postproc.chunks import Runs
from postproc.collision import cylinders
from postproc.correction import HeldFeed, Result
from postproc.errors import ForceError, InputError, Issue, PostprocError
from postproc.files import add_record, find_foreign_file, find_foreign_files, refuse, write_whole
from postproc.forces import Knots
from postproc.frames import M_PER_MM, MM_PER_MIN, Array, norm
from postproc.jobs.output_plan import backup_path, protect
from postproc.jobs.programs import load_robot
from postproc.jobs.started_program import read_with_start
from postproc.machining import Process, ProcessForces, ProcessSource, Shift, identification
from postproc.machining.identification import IdentifiedMaterial
from postproc.machining.remaining import Guard, ToolPart
from postproc.machining.stock import as_trimesh
from postproc.machining.stock_mesh import MOST_FILE_CELLS, RemainingMesh
from postproc.program import Bools, Program
from postproc.report import process_forces
from postproc.report.material import material_page
from postproc.robot import RobotModel
from postproc.under_load import ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, RobotInCell, segments_in_cell

_MOST_TRIALS = 10
"""Largest number of trials at feeds between the programmed feeds and the least feeds (assumed)."""
_TRIAL_SHARE = 0.997
"""Trials are at this share of the feed at which the tolerance would be reached: most then hold it at once."""
_LARGEST_RESERVE_SHARE = 0.01
"""A feed is final if it could be higher by this share at most (assumed)."""
_BACKSTEP_SHARE = 0.99
"""Share of its feed that a motion gets if it exceeds the tolerance at a feed at which it did not before."""
_ZERO_FEED_SHARE = 1e-3
"""Share of the programmed feed at which the errors are taken for those without feed."""
_SMALLEST_SLOPE = 1e-12
"""Least slope of the error over the feed [s], for a division: the slope may be zero or negative."""
_FEED_STEP = 1e-6
"""Feeds are multiples of this [m/s], the last digit that programs print."""

Trial = Callable[[Program], Result]
_MESHES = (".stl", ".glb", ".ply", ".obj")


def hold_tolerance(
    program: Program, length: Array, tip_speed: Array, cell: Cell, exponent: float, trial: Trial
) -> Result:
    """Return the result with the highest feeds, at most the programmed ones, that hold the tolerance of the part.

    A motion that exceeds the tolerance even at the least feed keeps its programmed feed or gets the least feed, as
    `[output] unheld` of the cell says. If a trial fails, its result is returned.

    :param length: (M,) length of the motions [m].
    :param tip_speed: (M,) speeds of the tip at the programmed feeds [m/s], see `toolpath.tip_speeds`.
    :param exponent: mc of the material: chip forces grow with feed^(1 − mc).
    :param trial: converts the program with the feeds of its motions.
    :raises InputError: the model states no uncertainty, so that no error is expected.
    """
    motions, min_feed = program.motions, cell.output.min_feed_mm_per_min / MM_PER_MIN
    result = trial(program)
    if result.failed:
        return result
    if result.expected is None or cell.part_tolerance is None:
        advice = 'Give sigma_percent or a covariance in its model.toml, or write feed = "program".'
        raise InputError('[output] feed = "hold": the robot model states no uncertainty', advice=advice)
    uses_min_feed = cell.output.unheld == "lowest"  # for motions that exceed the tolerance at each feed
    error = _largest_by_motion(result)
    search = _Search(
        program=program,
        tip_speed=tip_speed,
        tolerance=cell.part_tolerance,
        min_feed=min_feed,
        power=1.0 - exponent,
        error=error,
        uses_min_feed=uses_min_feed,
    )
    error_without_feed = np.full(len(motions), np.nan)  # NaN: not computed
    if search.is_open.any():
        result = trial(search.program_at(search.min_feeds))
        if not result.failed and (unheld := search.take_least_feed_errors(_largest_by_motion(result))).any():
            result = trial(search.program_at(np.maximum(_ZERO_FEED_SHARE * motions.feed, _FEED_STEP)))
            error_without_feed[unheld] = _largest_by_motion(result)[unheld]
            search.settle(unheld)
        for _ in range(_MOST_TRIALS):
            if result.failed:
                return result
            result = trial(search.program_at(search.trial_feeds()))
            if search.take_errors(_largest_by_motion(result)):  # the feeds are final
                break
        else:  # no trial was final: take the highest feeds known to hold the tolerance
            result = trial(search.program_at(search.low))
    error = _largest_by_motion(result)
    feed = result.program.motions.feed
    held_feed = HeldFeed(
        tolerance=cell.part_tolerance,
        least=min_feed,
        unheld=cell.output.unheld,
        programmed_feed=motions.feed,
        feed=feed,
        length=length,
        expected=error,
        without_feed=error_without_feed,
    )
    return replace(result, held_feed=held_feed)


def _with_feed(program: Program, feed: Array) -> Program:
    """Return a program with lower feeds (M,) [m/s]; `feed_as_read` keeps the feeds that its text states."""
    return replace(program, motions=replace(program.motions, feed=feed), feed_as_read=program.motions.feed)


_MOST_CAPPINGS = 4
"""Largest number of conversions at feeds that the conversion before has lowered (assumed)."""
_CAPPED = "feed-capped"
"""Kind of the issue that names moves at feed in which a joint would turn too fast."""


def at_written_feed(
    program: Program,
    robot: RobotModel,
    cell: Cell,
    source: ProcessSource,
    mode: correction.Mode,
    *,
    linearize_arcs: bool,
    to: str | None,
) -> Result:
    """Correct a program, or write it as it is, under the forces of the feeds that are written.

    With ``[limits] feed = "cap"`` moves are slowed to the speed limits of the joints. Their chips are then thinner than
    programmed, and the forces are computed again. The issues of the last slowed moves are kept.

    :param source: source of the forces of the process; other parameters: see `correction.process`.
    """
    result = correction.process(program, robot, cell, source, mode=mode, linearize_arcs=linearize_arcs, to=to)
    for _ in range(_MOST_CAPPINGS):
        capped_feeds = tuple(issue for issue in result.issues if issue.kind == _CAPPED)
        if not capped_feeds or result.failed:
            break
        slowed_program = _with_feed(program, result.program.motions.feed)
        result = correction.process(
            slowed_program, robot, cell, source, mode=mode, linearize_arcs=linearize_arcs, to=to
        )
        if not any(issue.kind == _CAPPED for issue in result.issues):
            return replace(result, issues=(*result.issues, *capped_feeds))
    return result


class _Search:
    """Bounds of the feed of each motion, by false position.

    :ivar is_open: (M,) motions whose feed may be lowered.
    :ivar feed: (M,) feeds of the last trial [m/s].
    :ivar low: (M,) highest feed known to hold the tolerance [m/s]; `high`: (M,) lowest feed known to exceed it.
    :ivar error_low, error_high: (M,) errors [m] at `low` and `high`; halved towards the limit by the Illinois method.
    :ivar was_raised: (M,) motions whose last trial raised `low`; `was_lowered`: (M,) whose last trial lowered `high`.
    :ivar power: 1 − mc: chip forces grow with feed^power.
    """

    def __init__(
        self,
        program: Program,
        tip_speed: Array,
        tolerance: float,
        min_feed: float,
        power: float,
        error: Array,
        *,
        uses_min_feed: bool,
    ) -> None:
        """Begin with the programmed feeds.

        :param tip_speed: (M,) speeds of the tip at the programmed feeds [m/s]; higher feeds have no effect.
        :param tolerance: tolerance of the part [m]; `min_feed`: least feed [m/s].
        :param power: chip forces grow with feed^power.
        :param error: (M,) expected errors at the programmed feeds [m].
        :param uses_min_feed: motions that exceed the tolerance at each feed get the least feed; else they keep the
            programmed feed.
        """
        motions = program.motions
        self.nominal_program, self.power, self.feed = program, power, motions.feed
        self.limit, self.uses_min_feed = tolerance, uses_min_feed
        self.high, self.error_high = tip_speed.copy(), error
        self.min_feeds = np.minimum(tip_speed, np.ceil(min_feed / _FEED_STEP) * _FEED_STEP)
        # errors at the least feeds are not known yet, see `take_least_feed_errors`
        self.low, self.error_low = self.min_feeds.copy(), np.zeros(len(motions))
        self.was_raised, self.was_lowered = np.zeros(len(motions), dtype=bool), np.zeros(len(motions), dtype=bool)
        self.is_open: Bools = np.asarray(~motions.rapid & (error > tolerance) & (self.low < self.high))

    def program_at(self, feed: Array) -> Program:
        """Return the program with feeds (M,) [m/s] for open motions; `feed` is set to the feeds of all motions."""
        self.feed = np.where(self.is_open, feed, self.nominal_program.motions.feed)
        return _with_feed(self.nominal_program, self.feed)

    def take_least_feed_errors(self, error: Array) -> Bools:
        """Set `error_low` to the errors (M,) [m] at the least feeds.

        :returns: (M,) open motions that exceed the tolerance even at the least feed.
        """
        self.error_low = error.copy()
        return np.asarray(self.is_open & (error > self.limit))

    def settle(self, unheld: Bools) -> None:
        """Fix the feed of motions (M,) that exceed the tolerance at each feed, see `uses_min_feed`.

        With the least feed both bounds become equal; else the motion is no longer open.
        """
        if self.uses_min_feed:
            self.high[unheld] = self.low[unheld] = self.min_feeds[unheld]
        else:
            self.is_open = self.is_open & ~unheld

    def trial_feeds(self) -> Array:
        """Return the feeds (M,) of the next trial [m/s], multiples of `_FEED_STEP`, by false position in feed^power.

        The error is nearly linear in feed^power, so the line between both bounds crosses the tolerance near the root.
        """
        low, high = self.low**self.power, self.high**self.power
        gap = self.error_high - self.error_low
        share = np.clip((self.limit - self.error_low) / np.where(gap > 0.0, gap, 1.0), 0.0, 1.0)
        feed = (low + share * (high - low)) ** (1.0 / self.power) * np.where(self.low < self.high, _TRIAL_SHARE, 1.0)
        # 1e-6: a feed that is a multiple of the step but for rounding is not lowered by a step
        return np.asarray(np.clip(np.floor(feed / _FEED_STEP + 1e-6) * _FEED_STEP, self.low, self.high))

    def take_errors(self, error: Array) -> bool:
        """Narrow the bounds of the feeds by the errors (M,) [m] of the last trial.

        :returns: whether the feeds of the trial are final: all hold the tolerance, and could be higher by the share
            `_LARGEST_RESERVE_SHARE` at most.
        """
        is_fixed = self.low >= self.high
        is_within = error <= self.limit
        is_raised, is_lowered = self.is_open & ~is_fixed & is_within, self.is_open & ~is_fixed & ~is_within
        reserve = np.minimum(self._reserve(error), self.high - self.feed)
        is_final = is_fixed | (is_raised & (reserve <= _LARGEST_RESERVE_SHARE * self.feed))
        # Illinois method: where a bound moves twice in turn, the distance of the other error from the limit is halved
        repeats_good, repeats_bad = is_raised & self.was_raised, is_lowered & self.was_lowered
        self.error_high[repeats_good] = 0.5 * (self.limit + self.error_high[repeats_good])
        self.error_low[repeats_bad] = 0.5 * (self.limit + self.error_low[repeats_bad])
        # a feed that held the tolerance now exceeds it, because errors depend on the motions before too
        is_stuck = is_lowered & (self.feed <= self.low)
        unheld = is_stuck & (self.feed <= self.min_feeds)
        self.low[is_raised], self.error_low[is_raised] = self.feed[is_raised], error[is_raised]
        self.low[is_stuck] = np.maximum(self.min_feeds, _BACKSTEP_SHARE * self.low)[is_stuck]
        self.high[is_lowered], self.error_high[is_lowered] = self.feed[is_lowered], error[is_lowered]
        self.was_raised, self.was_lowered = is_raised, is_lowered
        self.settle(unheld)
        return bool(np.all(~self.is_open | is_final)) and not (unheld.any() and not self.uses_min_feed)

    def _reserve(self, error: Array) -> Array:
        """Return by how much the feed (M,) could be higher [m/s]: (limit − error) / slope of the error over the feed.

        The slope is that of the secant to `low` or to `high`, whichever is smaller: the reserve is rather too large.

        :param error: (M,) errors at the present feeds [m].
        """
        upper_slope = (self.error_high - error) / np.maximum(self.high - self.feed, _FEED_STEP)
        lower_slope = (error - self.error_low) / np.maximum(self.feed - self.low, _FEED_STEP)
        lower_slope = np.where(self.feed > self.low, lower_slope, np.inf)
        slope = np.minimum(upper_slope, lower_slope)
        return np.asarray((self.limit - error) / np.maximum(slope, _SMALLEST_SLOPE))


def _largest_by_motion(result: Result) -> Array:
    """Return the largest expected error (M,) [m] of each motion; 0 for a motion without targets, or without a cut."""
    largest_error = np.zeros(len(result.program.motions))
    if result.expected is not None:
        # `maximum.at`: a motion may have several targets
        np.maximum.at(largest_error, result.motion, result.expected)
    return largest_error


_MOST_ROUNDS = 8
"""Largest number of sweeps with a displaced tip (assumed)."""
_FIRST_OFFSET_SHARE = 0.9
"""Share of the deflection on the nominal path as the first displacement: a deflected tool cuts less."""
_LARGEST_OVERSHOOT = 0.8
"""Largest share of the last change of the deflection that counts as overshoot (assumed)."""
_CONVERGENCE = 2e-6
"""Force and deflection agree if the next change of the deflection is below this [m] (RMS along the cutting path),"""
_CONVERGENCE_SHARE = 0.05
"""or below this share of the deflection (RMS)."""
_LOST_CONTACT_SHARE = 0.05
"""After two rounds, this share of the path with the largest residuals is left out: where a drill meets the bottom of
the last peck, its thrust pushes it back out of contact, and no deflection agrees with its force."""


def read(path: Path, cell: Cell, progress: Callable[[int, int], None] | None = None) -> ProcessSource:
    """Return the source of forces of a process.

    :param progress: called in each sweep of the stock with the number of segments done, and of all segments; None: not
        reported.
    :raises ForceError: the process is unusable.
    """
    guard = None if cell.collision is None else partial(_guard, cell.collision)
    return ProcessSource(machining.load(path), cell.tool.axis, guard=guard, progress=progress)


def _guard(table: Collision) -> Guard:
    """Return the bodies that must stay clear of the stock: the cylinders of the tool that do not cut.

    :param table: `[collision]` of the cell.
    """
    tool_cylinders = list(cylinders(table.holder))
    parts = [
        ToolPart(cylinder.name, cylinder.radius, bottom=cylinder.begin)
        for cylinder in tool_cylinders
        if not cylinder.cuts
    ]
    cutter_diameter = next((2.0 * part.radius for part in tool_cylinders if part.cuts), None)
    return Guard(parts, table.clearance_mm * M_PER_MM, cutter_diameter)


def stock_glb(process: ProcessForces) -> bytes:
    """Return the remaining stock as GLB."""
    mesh = process.mesh()
    return bytes(as_trimesh(mesh.vertices, mesh.faces).export(file_type="glb"))


def _coarse_mesh_issues(mesh: RemainingMesh, process: ProcessForces) -> list[Issue]:
    """Return a warning if the mesh of the remaining stock has wider cells than its map."""
    if mesh.cell < 1.5 * process.stock.cell:
        return []
    message = (
        f"the remaining stock has cells of {1e3 * mesh.cell:.2g} mm instead of {1e3 * process.stock.cell:.2g} mm, for "
        "the size of its file: forces of a next program that cuts less than that are less accurate. Put both "
        "operations in one program, or divide the stock"
    )
    return [Issue("warning", "coarse-stock", message)]


_ASIDE_SINE = 0.2
"""Sine of the angle between command and deflected tool from which on their difference is named: 12° (assumed)."""


def _aside_notes(path: PathUnderLoad, deviation: Array) -> list[Issue]:
    """Return a note if the deflected tool does not move along the commanded path, the command.

    Chips and forces are computed along the command.

    This happens where the force changes within a short way, as at the end of a slot or in a corner. The command of a
    corrected program steps aside there, and the tool goes straight.

    :param path: N samples of the path.
    :param deviation: (N, 3) deviation of the tip, `$BASE` [m].
    """
    sample, weight = path.sample, _weights(path)
    step, change = np.diff(sample.pose.position, axis=0), np.diff(deviation, axis=0)
    # the component of the change across the command
    length = np.maximum(norm(step), 1e-12)
    aside = norm(change - (np.einsum("ni,ni->n", change, step) / length**2)[:, None] * step)
    sine = aside / np.maximum(norm(step + change), 1e-12)
    is_cut = (weight[1:] > 0.0) & (weight[:-1] > 0.0) & (sample.motion[1:] == sample.motion[:-1])
    is_aside = is_cut & (sine > _ASIDE_SINE) & (aside > _CONVERGENCE)
    if not is_aside.any():
        return []
    worst = int(np.argmax(np.where(is_aside, aside, 0.0))) + 1
    share = float(weight[1:][is_aside].sum() / weight.sum())
    message = (
        f"along {100 * share:.2g} % of the cutting path the deflected tool moves aside of the command by more than "
        f"{np.degrees(np.arcsin(_ASIDE_SINE)):.0f}°, as the force changes there. Forces are computed along the "
        "command: force and deviation are uncertain there. For a corrected program see the report of convert, which "
        "has no such error, since its tool stays on the nominal path."
    )
    line = int(path.program.motions.line[sample.motion[worst]])
    return [Issue("info", "aside-of-command", message, line)]


def _real_cut_message(
    nominal_wrench: Runs, real_wrench: Runs, nominal: ProcessSource, real: ProcessSource, rounds: int
) -> str:
    """Return the sentence that compares largest force and removed volume of the deflected tool with the nominal values.

    :param nominal_wrench: (n, 6) on the nominal path; `real_wrench`: (m, 6) of the deflected tool [N, N·m].
    :param nominal: source of the forces on the nominal path; `real`: source of the forces of the deflected tool.
    :param rounds: number of rounds of the iteration.
    """
    nominal_force, real_force = (
        float(norm(wrench[:, :3]).max(initial=0.0)) for wrench in (nominal_wrench, real_wrench)
    )
    nominal_volume, real_volume = (
        0.0 if source.process_forces is None else source.process_forces.removed_volume * 1e9  # mm³
        for source in (nominal, real)
    )
    return (
        f"forces of the deflected tool ({rounds} round{'s' * (rounds != 1)}): largest force {real_force:.0f} N, "
        f"{nominal_force:.0f} N on the nominal path; removed {real_volume:.0f} mm³ of {nominal_volume:.0f}. The "
        "corrected program has the nominal engagement."
    )


def predict_in_material(
    program: Program, robot: RobotModel, cell: Cell, source: ProcessSource
) -> tuple[Result, ProcessSource]:
    """Predict a program whose tool cuts where it really is: force and deflection are iterated until they agree.

    The deflection of the tool leaves material or removes more; force and remaining stock are those of this cut. A round
    is one sweep of the stock and the loaded equilibrium at the samples of the nominal path.

    :returns: the result, and the source of forces of the deflected tool. If the program cannot be followed under load,
        or the source has no swept stock, they are those of the nominal engagement.
    """
    try:
        motions = MotionsUnderLoad.of(program, RobotInCell.of(robot, cell), source)
        path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
        deviation = _deviation(path)
    except ImpossiblePathError:  # the result says why
        return correction.process(program, robot, cell, source, mode="predict"), source
    if source.process_forces is None:
        return correction.process(program, robot, cell, source, mode="predict"), source
    cut = _real_cut(path, source, deviation)
    result = correction.process(program, robot, cell, cut.source, mode="predict")
    if result.failed:
        return result, cut.source
    message = _real_cut_message(path.wrench, result.wrench, source, cut.source, cut.rounds)
    note = Issue("info" if cut.is_settled else "warning", "real-cut", message)
    hits = [issue for issue in source.process_forces.issues if issue.kind in ("rapid-in-material", "collision")]
    engagement_result = correction.process(program, robot, cell, source, mode="predict")
    issues = (*result.issues, *hits, note, *_aside_notes(path, cut.deviation))
    return replace(result, issues=issues, engagement_result=engagement_result), cut.source


class _RealCut(NamedTuple):
    """Cut of the deflected tool.

    :param source: source of the forces of the cut.
    :param rounds: number of sweeps with a displaced tip.
    :param is_settled: whether force and deflection agree.
    :param deviation: (N, 3) deviation of the tip under its forces, `$BASE` [m].
    """

    source: ProcessSource
    rounds: int
    is_settled: bool
    deviation: Array


def _real_cut(path: PathUnderLoad, source: ProcessSource, deviation: Array) -> _RealCut:
    """Return the cut whose forces deflect the tool by as much as the tip was displaced for the cut.

    A deflected tool cuts less than the programmed (nominal) engagement, so its forces are smaller: force and deflection
    are found by fixed-point iteration with a displacement of the tip. After `_MOST_ROUNDS` rounds without agreement,
    the last cut is returned, with `is_settled` False.

    :param path: N samples of the nominal path, under the forces of the nominal engagement.
    :param source: source of the forces of the nominal engagement.
    :param deviation: (N, 3) deviation of the tip from the nominal path under these forces, `$BASE` [m].
    """
    motions, sample = path.motions, path.sample
    spindle, ramp = motions.robot_in_cell.spindle, motions.robot_in_cell.ramp
    weight = _weights(path)
    cut_source, rounds, is_settled = source, 0, False
    residual, offset, last_shift = deviation, _FIRST_OFFSET_SHARE * deviation, _FIRST_OFFSET_SHARE * deviation
    # offset: displacement of the tip for the cut; residual: deviation less offset, zero if they agree
    while not is_settled and rounds < _MOST_ROUNDS:
        rounds += 1
        cut_source = source.shift_tip(Shift.of(path.program, sample.motion, sample.t, offset))
        path_forces = forces.assign(path.program, motions.segments, cut_source, spindle, ramp)
        change = _deviation(replace(path, wrench=path_forces.at(sample))) - deviation
        deviation = deviation + change
        residual, last_residual = deviation - offset, residual
        shift = residual - _overshoot(residual, residual - last_residual, weight) * change
        limit = max(_CONVERGENCE, _CONVERGENCE_SHARE * _rms(deviation, weight))
        is_settled = _next_change(change, last_shift, shift, weight) < limit
        if rounds > 1 and not is_settled:  # but for places where the tool loses contact
            is_settled = _next_change(change, last_shift, shift, _contact_weights(weight, residual)) < limit
        last_shift, offset = shift, offset + shift
    return _RealCut(source=cut_source, rounds=rounds, is_settled=is_settled, deviation=deviation)


def _deviation(path: PathUnderLoad) -> Array:
    """Return the deviation (N, 3) [m] of the uncorrected tip from the N samples of a path, `$BASE` axes."""
    joint_deflections = np.broadcast_to(0.0, (len(path), path.robot_in_cell.robot.actual.nv))  # first guess
    return correction.uncorrected_deviations(path, np.arange(len(path)), joint_deflections).deviation


def _weights(path: PathUnderLoad) -> Array:
    """Return the length of cutting path (N,) [m] that each of the N samples represents.

    Samples are dense where forces change, so means over the path need these weights.
    """
    sample, motions = path.sample, path.program.motions
    is_continued = np.ones(len(sample), dtype=bool)  # forces are continuous between samples
    return toolpath.cut_lengths(motions, path.motions.segments.length, sample.motion, sample.t, is_continued)


def convert_with_held_feed(
    program: Program, robot: RobotModel, cell: Cell, source: ProcessSource, *, linearize_arcs: bool, to: str | None
) -> Result:
    """Convert a program with feeds that hold the tolerance of the part, see `hold_tolerance`.

    :raises InputError: the program or the process does not allow that.
    """
    if source.process.material is None:
        advice = "[operations] do not say how forces depend on the feed: give [material], tools and stock."
        raise InputError('[output] feed = "hold" without [material]', file=source.name, advice=advice)
    path = toolpath.segments(program, RobotInCell.of(robot, cell).start_flange)

    def trial(slow_program: Program) -> Result:
        """Return the conversion of the program with other feeds."""
        return correction.process(slow_program, robot, cell, source, linearize_arcs=linearize_arcs, to=to)

    tip_speed = toolpath.tip_speeds(program, path)
    return hold_tolerance(program, path.length, tip_speed, cell, source.process.law().exponent, trial)


def _overshoot(residual: Array, change: Array, weight: Array) -> float:
    """Return the share of the last change of the deflection that overshoots the fixed point of force and deflection.

    It is Σ w r·c / Σ w c·c, between 0 and `_LARGEST_OVERSHOOT`, with residual r, change c and weight w: Anderson's
    acceleration of a fixed point with one step of memory (Walker and Ni, SIAM J. Numer. Anal. 49, 2011).

    :param residual: (n, 3) deflection less the displacement of the tip for the cut [m].
    :param change: (n, 3) change of the residual in this round [m].
    :param weight: (n,) weights of the samples.
    """
    squared_change = float(weight @ np.sum(change * change, axis=1))
    share = float(weight @ np.sum(residual * change, axis=1)) / squared_change if squared_change > 0.0 else 0.0
    return float(np.clip(share, 0.0, _LARGEST_OVERSHOOT))


def _next_change(change: Array, shift: Array, next_shift: Array, weight: Array) -> float:
    """Return an estimate [m] of the change of the deflection in the next round.

    :param change: (n, 3) change of the deflection in this round [m].
    :param shift: (n, 3) change of the displacement of the cut in this round [m].
    :param next_shift: (n, 3) change of the displacement in the next round [m].
    :param weight: (n,) weights of the samples.
    """
    # the deflection follows a displacement of the cut as it did in this round, but does not grow beyond it
    rate = _rms(change, weight) / max(_rms(shift, weight), _CONVERGENCE)
    return min(rate, 1.0) * _rms(next_shift, weight)


def _contact_weights(weight: Array, residual: Array) -> Array:
    """Return the weights (n,), set to zero for the samples with the largest residuals.

    Together these samples have the share `_LOST_CONTACT_SHARE` of all weights at most. The tool loses contact there,
    and no deflection agrees with its force.

    :param weight: (n,) length of path [m] that each sample represents.
    :param residual: (n, 3) deflection less the displacement of the tip for the cut [m].
    """
    largest_first = np.argsort(-norm(residual))
    cumulated_weight = np.cumsum(weight[largest_first])
    left_out_count = np.searchsorted(cumulated_weight, _LOST_CONTACT_SHARE * weight.sum(), side="right")
    contact_weight = weight.copy()
    contact_weight[largest_first[:left_out_count]] = 0.0
    return contact_weight


def _rms(vectors: Array, weight: Array) -> float:
    """Return the weighted root mean square of the lengths of vectors (n, 3); 0 if all weights (n,) are zero."""
    total = float(weight.sum())
    return float(np.sqrt(weight @ np.einsum("ni,ni->n", vectors, vectors) / total)) if total > 0.0 else 0.0


class ForcesRequest(Struct, frozen=True, kw_only=True):
    """Inputs and output files of `postproc forces`.

    :param program: program file; `cell`: cell file; `process`: process.toml.
    :param output: CSV file to write; a JSON file of the same name is written next to it.
    :param stock: mesh of the stock before the program; None: the stock of the process.
    :param stock_out: mesh file to write for the remaining stock; None: it is not written.
    :param base_axes: write wrenches in `$BASE` axes; else in FEED axes.
    :param dialect: name of the format of the program; None: by the extension.
    """

    program: Path
    cell: Path
    process: Path
    output: Path
    stock: Path | None = None
    stock_out: Path | None = None
    base_axes: bool = False
    dialect: str | None = None
    overwrite: bool = False


class ForcesFiles(Struct, frozen=True, eq=False):
    """Forces as they were written: their summary, issues for the user, and the files."""

    summary: process_forces.ForcesSummary
    issues: tuple[Issue, ...]
    written_files: tuple[Path, ...]


def make_forces(request: ForcesRequest, progress: Callable[[int, int], None] | None = None) -> ForcesFiles:
    """Compute the forces of a program and write them: all files or none.

    Where that fails, files of an earlier run are renamed to NAME.old, because they look like new ones.

    :param progress: see `read`.
    :raises PostprocError: an input is unusable, or an output must not be written.
    """
    outputs = _outputs(request)
    protect(
        filter(None, (request.program, request.cell, request.process, request.stock)), outputs.folder, outputs.names
    )
    if not request.overwrite:
        refuse(find_foreign_files(outputs.folder, outputs.names, outputs.record))
    try:
        return _computed_forces(request, outputs, progress)
    except PostprocError as cause:
        _retire_outputs(outputs)
        if isinstance(cause, InputError):
            raise cause.with_file(request.program.name, str(request.program)) from cause
        raise


def _retire_outputs(outputs: _Outputs) -> None:
    """Rename the files of an earlier run to NAME.old; nothing is renamed if postproc did not write one of them."""
    if find_foreign_files(outputs.folder, outputs.names, outputs.record):
        return
    for path in (outputs.folder / name for name in outputs.names):
        if path.exists():
            path.rename(backup_path(path))


def _computed_forces(
    request: ForcesRequest, outputs: _Outputs, progress: Callable[[int, int], None] | None
) -> ForcesFiles:
    """Compute the forces of a program and write them; see `make_forces`."""
    process = machining.load(request.process)
    cell = cells.load(request.cell)
    robot = load_robot(cell.robot, cell.folder)
    program, cell = read_with_start(request.program, robot, cell, request.dialect)
    robot_in_cell = RobotInCell.of(robot, cell)
    path = segments_in_cell(program, robot_in_cell)
    forces = None
    if process.material is not None:
        forces = machining.estimate(
            program,
            path,
            process,
            robot_in_cell.spindle,
            stock=request.stock,
            base_axes=request.base_axes,
            progress=progress,
        )
    knots = _knots(program, process, forces)
    ramped_count = int(knots.ramped.sum())  # motions whose force grows from that of the motion before
    content = process_forces.summary(program, forces, ramped_count)
    rows = machining.knots_by_line(program, path, robot_in_cell.spindle, knots)
    contents: dict[str, bytes | Iterable[bytes]] = {outputs.table: process_forces.forces_csv(program, rows)}
    mesh_issues: list[Issue] = []
    if request.stock_out is not None:
        if forces is None:
            raise InputError(
                "--stock-out without [material]", advice="The remaining stock is known only where the tool is swept."
            )
        mesh = forces.mesh(MOST_FILE_CELLS)
        mesh_issues = _coarse_mesh_issues(mesh, forces)
        exported = as_trimesh(mesh.vertices, mesh.faces).export(file_type=request.stock_out.suffix[1:].lower())
        contents[outputs.stock] = bytes(exported)
    issues = (*(() if forces is None else forces.issues), *mesh_issues, *knots.issues)
    record = add_record(contents, outputs.record, lambda entries: process_forces.forces_json(content, issues, entries))
    return ForcesFiles(content, issues, tuple(write_whole(outputs.folder, record)))


class _Outputs(NamedTuple):
    """Files to be written.

    :param folder: of all files.
    :param table: name of the table of forces.
    :param stock: name of the mesh of the remaining stock; empty if it is not written.
    :param record: name of the JSON file.
    """

    folder: Path
    table: str
    stock: str
    record: str

    @property
    def names(self) -> list[str]:
        """The names of all files."""
        return [name for name in (self.table, self.stock, self.record) if name]


def _outputs(request: ForcesRequest) -> _Outputs:
    """Return the files to be written.

    :raises InputError: table and stock are in different folders, or the stock is of an unknown kind of mesh.
    """
    folder, stock = request.output.parent, ""
    if request.stock_out is not None:
        if request.stock_out.parent.resolve() != folder.resolve():
            raise InputError(
                "-o and --stock-out are in different folders", advice="They are written together: give one."
            )
        if request.stock_out.suffix.lower() not in _MESHES:
            advice = f"Known: {', '.join(_MESHES)}."
            raise InputError(f"--stock-out {request.stock_out.name}: not a kind of mesh file", advice=advice)
        stock = request.stock_out.name
    return _Outputs(folder, request.output.name, stock, f"{request.output.stem}.json")


def _knots(program: Program, process: Process, forces: ProcessForces | None) -> Knots:
    """Return the forces of all moves: stated forces of operations, and computed forces for other moves.

    Knots are the places on motions that have a wrench; between them it is linear.

    :param forces: computed forces; None: the process has no material, and only operations state forces.
    """
    if forces is None:
        return machining.operation_knots(program, process)
    return (
        machining.operation_knots(program, process).with_fallback(forces.knots) if process.operations else forces.knots
    )


def identify_forces(
    readings_path: Path, process: Path, output: Path, tool: str | None, *, overwrite: bool = False
) -> tuple[IdentifiedMaterial, list[Path]]:
    """Identify cutting coefficients, and write them as TOML with a page of the same name.

    :param readings_path: CSV file of readings.
    :param process: process.toml with the tool.
    :param output: TOML file to write.
    :param tool: number or name of the tool; None: the process has a single tool.
    :param overwrite: replace a file that postproc did not write.
    :returns: the coefficients, and the written files.
    :raises PostprocError: the readings are unusable, or the file must not be replaced.
    """
    page = output.with_suffix(".html")
    protect([readings_path, process], output.parent, [output.name, page.name])
    if not overwrite:
        refuse(find_foreign_file(output))
    process_file = machining.load(process, tools_only=True)
    _, entry = identification.tool_of(process_file, tool)
    readings = identification.read(readings_path)
    material = identification.identify(readings, entry, process_file.material, str(readings_path))
    contents = {
        output.name: identification.as_toml(material, entry, readings_path.name),
        page.name: material_page(material, readings, readings_path.name),
    }
    return material, write_whole(output.parent, contents)


def propose_cuts(process: Path, output: Path, tool: str | None, *, overwrite: bool = False) -> list[Path]:
    """Write test cuts as G-code, and the CSV file for their readings next to it; return the written files.

    :param process: process.toml with the tool; `output`: G-code file to write.
    :param tool: number or name of the tool; None: the process has a single tool.
    :param overwrite: replace existing files.
    :raises PostprocError: the process has no such tool, or a file must not be replaced.
    """
    process_file = machining.load(process, tools_only=True)
    key, entry = identification.tool_of(process_file, tool)
    table = output.with_suffix(".csv")
    protect([process], output.parent, [output.name, table.name])
    conflicts = [path for path in (output, table) if path.exists()]
    if conflicts and not overwrite:
        raise ForceError("this file exists", file=str(conflicts[0]), advice="Give another name, or --overwrite.")
    program, rows = identification.proposal(process_file, key, entry)
    return write_whole(output.parent, {output.name: program, table.name: rows})
