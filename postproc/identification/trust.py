"""Whether an identified model may be used, said in one line; and what its readings do not say about the work."""

from __future__ import annotations

import numpy as np

from postproc.frames import MM_PER_M, norm
from postproc.identification.choice import Choice
from postproc.identification.discrepancy import Discrepancy, levels
from postproc.identification.displacements import measured_displacements, visible
from postproc.identification.fit import LENGTH_95, Fit
from postproc.identification.measurements import Measurements
from postproc.identification.placement import Placement
from postproc.robot import Backlash, JointCompliance

_MOST_HELD_OUT = 4.0
"""Mean square on configurations left out, in σ², beyond which something is missing in the model."""
_FEWEST = 5
"""Configurations without which nothing is known of how they differ."""
_NUMBERS = {1: 3, 2: 5}
"""Numbers that the displacement of so many points under one load tells; three and more tell the six of a rigid body."""
_SPARE = 2.0
"""Numbers measured for each that is looked for, below which a model describes the readings and not the robot."""
_LEAST_FACTOR = 5.0
"""Displacement over bound below which a correction is not worth its risk."""
_PLAY = 1e-5
"""Backlash [rad] that is worth a word."""


def judge(
    data: Measurements, placement: Placement, fit: Fit, off: Discrepancy, choice: Choice | None
) -> tuple[str, list[str]]:
    """Return why the model should not be used (empty if it may), and what else the user should know."""
    return _distrust(data, placement, fit, off, choice), _told(data, fit, choice)


def line(distrust: str) -> str:
    """Return the verdict on a model in one line."""
    return f"NOT TO BE TRUSTED: {distrust}" if distrust else "the model may be used, within its bound"


def _distrust(data: Measurements, placement: Placement, fit: Fit, off: Discrepancy, choice: Choice | None) -> str:
    held_out = fit.chi2 / max(fit.dof, 1) if choice is None else float(choice.held_out.mean())
    if held_out > _MOST_HELD_OUT:
        where = "on configurations left out" if choice is not None else "on the readings"
        return (
            f"{where} the model is off by {held_out:.1f} σ² (noise alone: 1): the robot does something that it does "
            "not know, or the set-up is wrong"
        )
    worth = len(fit.values) if choice is None else choice.worth
    told = _told_by_configuration(data)
    fewest = max(_FEWEST, int(np.ceil(_SPARE * worth / told)))
    if len(data.q) < fewest:
        kind = "joint springs" if choice is None else "springs of links and gears"
        return (
            f"{len(data.q)} configurations were measured, which tell some {told:.0f} numbers each; the {kind} found "
            f"are worth {worth:.0f} and need {fewest} configurations at least (30 are usual)"
        )
    lowest = levels(norm(data.wrench[data.loaded])) == 0
    seen = np.count_nonzero(visible(data)[lowest])
    moved = np.sqrt(np.sum(measured_displacements(data, placement)[lowest] ** 2) / max(seen, 1))
    bound = float(np.hypot(LENGTH_95 * off.own[0], off.u95[0]))
    if moved < _LEAST_FACTOR * bound:
        return (
            f"at {off.load[0]:.0f} N the points move by {moved * MM_PER_M:.3f} mm, and the bound is "
            f"{bound * MM_PER_M:.3f} mm: that supports no correction"
        )
    return ""


def _told_by_configuration(data: Measurements) -> float:
    """Return how many numbers a configuration tells of linear springs: by points and by directions of its loads."""
    wrench, config = data.wrench[data.loaded], data.state_config[data.loaded]
    directions = [
        np.linalg.matrix_rank(wrench[config == index] / norm(wrench[config == index])[:, None], tol=0.1)
        for index in range(len(data.q))
    ]
    return _NUMBERS.get(len(data.points), 6) * float(np.mean(directions))


def _told(data: Measurements, fit: Fit, choice: Choice | None) -> list[str]:
    told, half = [], dict(zip(fit.structure.parameters, fit.ci95.tolist(), strict=True))
    load = norm(data.wrench[data.loaded])
    if choice is not None and int(levels(load).max()) == 0:
        told.append(
            f"one level of loads ({np.median(load):.0f} N): gears that stiffen or have knees show near the force of "
            "the work. Measure each configuration under a second load of about that force."
        )
    for parameter, value in fit.given.items():
        if isinstance(parameter, JointCompliance) and parameter.in_file(fit.given)[0] <= 0.0:
            told.append(
                f"the springs of the links give way for {parameter.joint} too: beside them it has no compliance"
            )
        if isinstance(parameter, Backlash) and value > max(_PLAY, half[parameter]):
            told.append(f"looks like {value * MM_PER_M:.3f} mrad of backlash or friction in {parameter.joint}")
    return told
