"""Whether an identified model may be used, in one line; and what its readings do not show of the work."""

from __future__ import annotations

import numpy as np

from postproc.frames import MM_PER_M, norm
from postproc.identification.choice import Choice
from postproc.identification.discrepancy import levels
from postproc.identification.fit import NORMAL_95, Fit
from postproc.identification.measurements import Measurements
from postproc.identification.workspace import Workspace
from postproc.robot import (
    Backlash,
    CompensatorSize,
    FadingPart,
    JointCompliance,
    Knee,
    LinkMass,
    LinkSpring,
    LostMotion,
    Parameter,
)

_MOST_HELD_OUT = 4.0
"""Mean square on configurations left out, in σ², beyond which the model lacks something."""
_FEWEST = 5
"""Fewest configurations that show how configurations differ."""
_NUMBERS = {1: 3, 2: 5}
"""Numbers that the displacements of one, two, three points determine; three and more give the six of a rigid body."""
_SPARE = 2.0
"""Least numbers measured for each parameter: with fewer a model describes the readings and not the robot."""
_PLAY = 1e-5
"""Smallest backlash [rad] that is reported."""
_KINDS: tuple[tuple[type[Parameter], str], ...] = (
    (JointCompliance, "joints"),
    (LinkSpring, "link springs"),
    (Knee, "breakpoints"),
    (FadingPart, "fading parts of gears"),
    (LostMotion, "lost motion"),
    (Backlash, "backlash"),
    (LinkMass, "masses"),
    (CompensatorSize, "compensator"),
)
_NAMED = 6
"""Names of a kind that a warning lists."""


def judge(data: Measurements, fit: Fit, choice: Choice | None, workspace: Workspace) -> tuple[str, list[str]]:
    """Return why the model should not be used (empty if it may), and what else the user should know."""
    return _distrust(data, fit, choice) or workspace.refusal, _notes(data, fit, choice)


def line(distrust: str) -> str:
    """Return the verdict on a model in one line."""
    return f"NOT TO BE TRUSTED: {distrust}" if distrust else "the model may be used, within its bound"


def _distrust(data: Measurements, fit: Fit, choice: Choice | None) -> str:
    held_out = fit.chi2 / max(fit.dof, 1) if choice is None else float(choice.held_out.mean())
    if held_out > _MOST_HELD_OUT:
        where = "on configurations left out" if choice is not None else "on the readings"
        return (
            f"{where} the mean square error is {held_out:.1f} σ² (noise alone: 1): the robot does something that the "
            "model does not describe, or the set-up is wrong"
        )
    number = len(fit.values) if choice is None else choice.determined
    each = _numbers_of_a_configuration(data)
    fewest = max(_FEWEST, int(np.ceil(_SPARE * number / each)))
    if len(data.q) < fewest:
        kind = "joint springs" if choice is None else "link springs and gears"
        return (
            f"{len(data.q)} configurations were measured, which determine about {each:.0f} numbers each; the {kind} "
            f"have {number:.0f} and need {fewest} configurations at least (30 are usual)"
        )
    return ""


def _numbers_of_a_configuration(data: Measurements) -> float:
    """Return how many numbers a configuration determines of linear springs, by its points and directions of load."""
    wrench, config = data.wrench[data.loaded], data.state_config[data.loaded]
    directions = [
        np.linalg.matrix_rank(wrench[config == index] / norm(wrench[config == index])[:, None], tol=0.1)
        for index in range(len(data.q))
    ]
    return _NUMBERS.get(len(data.points), 6) * float(np.mean(directions))


def _notes(data: Measurements, fit: Fit, choice: Choice | None) -> list[str]:
    notes, half = [], dict(zip(fit.structure.parameters, fit.ci95.tolist(), strict=True))
    load = norm(data.wrench[data.loaded])
    if choice is not None:
        if int(levels(load).max()) == 0:
            notes.append(
                f"one level of loads ({np.median(load):.0f} N): gears that stiffen or have breakpoints show near the "
                "force of the work. Measure each configuration under a second load of about that force."
            )
        notes += _held(choice)
    for parameter, value in fit.given.items():
        if isinstance(parameter, JointCompliance) and parameter.in_file(fit.given)[0] <= 0.0:
            notes.append(f"{parameter.joint} has no compliance of its own: springs of the links take its place")
        if isinstance(parameter, Backlash) and value > max(_PLAY, half[parameter] / NORMAL_95):
            notes.append(f"looks like {value * MM_PER_M:.3f} mrad of backlash or friction in {parameter.joint}")
    return notes


def _held(choice: Choice) -> list[str]:
    """Return one sentence on the parameters that the readings do not narrow, by kind."""
    kinds: dict[str, list[str]] = {}
    for parameter in choice.held_by_prior:
        kind = next((name for of_kind, name in _KINDS if isinstance(parameter, of_kind)), "other parameters")
        kinds.setdefault(kind, []).append(parameter.name)
    if not kinds:
        return []
    parts = [
        f"{kind} {', '.join(names[:_NAMED])}{f' and {len(names) - _NAMED} more' if len(names) > _NAMED else ''}"
        for kind, names in kinds.items()
    ]
    return [
        "not identified, held by a prior of physical size, which counts in the bound: "
        f"{'; '.join(parts)} (all of them: held_by_prior in identification.json)"
    ]
