"""Forces of a process: the cut depends on how the tool gives way. Imported only where a process is given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc import correction, machining
from postproc.cell import Cell
from postproc.correction import Result
from postproc.errors import Issue
from postproc.frames import M_PER_MM, Array, norm
from postproc.machining import ProcessForces, ProcessSource, Shift
from postproc.machining.stock import as_trimesh
from postproc.program import Program
from postproc.robot import RobotModel

_ROUNDS = 8
_HALF = 0.5
"""By this share of what the tip moves it is moved in a round: a whole step may go to and fro at walls cut again."""
_SETTLED = 2e-6
"""Force and deflection agree when the tip moves by less than this [m] RMS from one round to the next,"""
_SHARE = 0.03
"""or by less than this share of the deflection: the cells of the map make about that."""


def read(path: Path, cell: Cell) -> ProcessSource:
    """Return the source of forces of a process.

    :raises ForceError: it is unusable.
    """
    return ProcessSource(machining.load(path), cell.tool.axis, cell.output.force_ramp_mm * M_PER_MM)


def stock(found: ProcessForces) -> bytes:
    """Return what is left of the stock, as GLB."""
    return bytes(as_trimesh(*found.mesh()).export(file_type="glb"))


def predicted(program: Program, robot: RobotModel, cell: Cell, source: ProcessSource) -> tuple[Result, ProcessSource]:
    """Predict a program whose tool cuts where it really is: force and deflection are iterated until they agree.

    What the tool gives way by leaves material or takes more; the force is that of this cut, and so is what is left.

    :returns: the result, and the source that holds the cut.
    """
    nominal = correction.process(program, robot, cell, source, "predict")
    if nominal.failed or source.found is None:
        return nominal, source
    result, cut, rounds, settled = nominal, source, 0, False
    shift = Shift(result.motion, result.t, result.deviation_before)
    while rounds < _ROUNDS and not settled:
        rounds += 1
        cut = source.shifted(shift)
        result = correction.process(program, robot, cell, cut, "predict")
        if result.failed:
            return result, cut
        moved = result.deviation_before - shift.at(result.motion, result.t)
        settled = _rms(moved) < max(_SETTLED, _SHARE * _rms(result.deviation_before))
        shift = Shift(result.motion, result.t, result.deviation_before - (1.0 - _HALF) * moved)
    one, other = (float(norm(each.wrench[:, :3]).max(initial=0.0)) for each in (nominal, result))
    removed = [0.0 if each.found is None else each.found.removed * 1e9 for each in (source, cut)]
    message = (
        f"the tool cuts where it gives way to ({rounds} rounds): largest force {other:.0f} N, {one:.0f} N on the "
        f"nominal path; removed {removed[1]:.0f} mm³ of {removed[0]:.0f}. The corrected program has the nominal "
        "engagement."
    )
    told = Issue("info" if settled else "warning", "real-cut", message)
    hits = [issue for issue in nominal.issues if issue.kind == "rapid-in-material"]
    return replace(result, issues=(*result.issues, *hits, told)), cut


def _rms(vectors: Array) -> float:
    """Return the root mean square of the lengths of vectors (n, 3)."""
    return float(np.sqrt(np.mean(np.einsum("ni,ni->n", vectors, vectors)))) if len(vectors) else 0.0
