"""The forces of the deflected tool, as a function of the model that deflects it."""

from __future__ import annotations

from collections.abc import Callable

from postproc.machining import ProcessSource
from postproc.program import Program
from postproc.robot import RobotModel
from postproc.testpart.cut import States, Surfaces, cut
from postproc.under_load import RobotInCell


def forces_of(
    program: Program, setting: RobotInCell, source: ProcessSource, where: Surfaces
) -> Callable[[RobotModel, float], States]:
    """Return a function of a model and a scale of the forces: the states where surfaces are made.

    Each call cuts the program once, with the tool deflected as by the forces of the call before.
    """
    last = None

    def states(robot: RobotModel, scale: float) -> States:
        nonlocal last
        shifted = source if last is None else source.shifted(last.shift(setting, robot, scale))
        last = cut(program, setting, shifted, where)
        return last.at

    return states
