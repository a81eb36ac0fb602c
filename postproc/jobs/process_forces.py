"""Forces of a process: the cut depends on the deflection of the tool. Imported only where a process is given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc import correction, forces, machining, toolpath
from postproc.cell import Cell
from postproc.correction import Result
from postproc.errors import InputError, Issue
from postproc.frames import Array, norm
from postproc.jobs import held_feed
from postproc.machining import ProcessForces, ProcessSource, Shift
from postproc.machining.stock import as_trimesh
from postproc.program import Program
from postproc.robot import RobotModel
from postproc.under_load import ImpossiblePathError, MotionsUnderLoad, PathUnderLoad, RobotInCell

_ROUNDS = 8
"""Largest number of sweeps with a displaced tip."""
_FIRST = 0.9
"""Share of the deflection on the nominal path that is tried first: the tool that deflects cuts less."""
_STEPS = 0.2, 1.0
"""Bounds of the share of the residual by which the tip is moved in a round: a larger step may oscillate at walls."""
_SETTLED = 2e-6
"""Force and deflection agree when the deflection is known to this [m] RMS along the cutting path,"""
_SHARE = 0.03
"""or to this share of it: the cells of the map make about that."""


def read(path: Path, cell: Cell) -> ProcessSource:
    """Return the source of forces of a process.

    :raises ForceError: it is unusable.
    """
    return ProcessSource(machining.load(path), cell.tool.axis)


def stock(found: ProcessForces) -> bytes:
    """Return the remaining stock as GLB."""
    return bytes(as_trimesh(*found.mesh()).export(file_type="glb"))


def predicted(program: Program, robot: RobotModel, cell: Cell, source: ProcessSource) -> tuple[Result, ProcessSource]:
    """Predict a program whose tool cuts where it really is: force and deflection are iterated until they agree.

    The deflection of the tool leaves material or removes more; force and remaining stock are those of this cut. A round
    is one sweep of the stock and the loaded equilibrium at the samples of the nominal path.

    :returns: the result, and the source that holds the cut.
    """
    try:
        motions = MotionsUnderLoad.of(program, RobotInCell.of(robot, cell), source)
        path = PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
        residual = _deviation(path)
    except ImpossiblePathError:  # the result says why
        return correction.process(program, robot, cell, source, "predict"), source
    if source.found is None:
        return correction.process(program, robot, cell, source, "predict"), source
    here, weight = (path.sample.motion, path.sample.t), _weights(path)
    cut, rounds, settled, step = source, 0, False, _FIRST
    moved = step * residual
    offset = moved
    while not settled and rounds < _ROUNDS:
        rounds += 1
        cut = source.shifted(Shift.of(program, *here, offset))
        along = forces.assign(program, motions.segments, cut, motions.setting.spindle, motions.setting.ramp)
        deviation = _deviation(replace(path, wrench=along.at(path.sample)))
        residual, before = deviation - offset, residual
        step = _secant(moved, residual - before, step, weight)
        # the deflection is nearer to its limit than the tip that was assumed is, by the rate of the contraction
        left = max(1.0 - step, _STEPS[0]) * _rms(residual, weight)
        settled = left < max(_SETTLED, _SHARE * _rms(deviation, weight))
        moved = step * residual
        offset = offset + moved
    result = correction.process(program, robot, cell, cut, "predict")
    if result.failed or source.found is None:
        return result, cut
    one, other = (float(norm(each[:, :3]).max(initial=0.0)) for each in (path.wrench, result.wrench))
    removed = [0.0 if each.found is None else each.found.removed * 1e9 for each in (source, cut)]
    message = (
        f"forces of the deflected tool ({rounds} rounds): largest force {other:.0f} N, {one:.0f} N on the "
        f"nominal path; removed {removed[1]:.0f} mm³ of {removed[0]:.0f}. The corrected program has the nominal "
        "engagement."
    )
    note = Issue("info" if settled else "warning", "real-cut", message)
    hits = [issue for issue in source.found.issues if issue.kind == "rapid-in-material"]
    return replace(result, issues=(*result.issues, *hits, note)), cut


def _deviation(path: PathUnderLoad) -> Array:
    """Return the deviation (N, 3) [m] of the uncorrected tip at the samples of a path, `$BASE`."""
    theta = np.zeros((len(path), path.setting.robot.actual.nv))
    return correction.uncorrected(path, np.arange(len(path)), theta)[0]


def _weights(path: PathUnderLoad) -> Array:
    """Return the length (N,) [m] of the cutting path around each sample: samples are dense where forces change."""
    motion, length = path.sample.motion, path.motions.segments.length
    place = (np.cumsum(length) - length)[motion] + length[motion] * path.sample.t
    around = 0.5 * (np.diff(place, prepend=place[:1]) + np.diff(place, append=place[-1:]))
    return np.asarray(np.where(path.program.motions.rapid[motion], 0.0, around))


def with_held_feed(
    program: Program, robot: RobotModel, cell: Cell, source: ProcessSource, *, linearize_arcs: bool, to: str | None
) -> Result:
    """Convert a program with feeds that hold the tolerance of the part, see `held_feed.held`.

    :raises InputError: the program or the process does not allow that.
    """
    if source.process.material is None:
        advice = "[operations] do not say how forces depend on the feed: give [material], tools and stock."
        raise InputError('[output] feed = "hold" without [material]', file=source.name, advice=advice)
    path = toolpath.segments(program, RobotInCell.of(robot, cell).start_flange)

    def trial(changed: Program) -> Result:
        return correction.process(changed, robot, cell, source, linearize_arcs=linearize_arcs, to=to)

    return held_feed.held(program, path.length, cell, source.process.law().exponent, trial)


def _secant(moved: Array, change: Array, step: float, weight: Array) -> float:
    """Return the share of the residual to move by next: dynamic relaxation by Irons and Tuck, 1969.

    :param moved: (n, 3) last step; change: (n, 3) change of the residual by it; step: the share before.
    :param weight: (n,) of the places.
    """
    square = float(weight @ np.sum(change * change, axis=1))
    found = -float(weight @ np.sum(moved * change, axis=1)) / square if square > 0.0 else step
    return float(np.clip(found, *_STEPS))


def _rms(vectors: Array, weight: Array) -> float:
    """Return the weighted root mean square of the lengths of vectors (n, 3)."""
    total = float(weight.sum())
    return float(np.sqrt(weight @ np.einsum("ni,ni->n", vectors, vectors) / total)) if total > 0.0 else 0.0
