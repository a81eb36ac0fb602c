"""Deflection compensation for robot milling: G-code or KRL with cutting forces in, corrected KRL and a report out.

>>> import postproc
>>> cell = postproc.load_cell("samples/cell_kr270.toml")
>>> robot = postproc.load_robot(cell.robot)
>>> program = postproc.read_program("samples/pocket.nc", robot, cell)
>>> result = postproc.process(program, robot, cell)
>>> result.documents[0].name
'pocket.src'

Everything named in `__all__` is loaded on first use: importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as in typing, which takes longer to import than all else here
if TYPE_CHECKING:
    from postproc.cell import Cell
    from postproc.cell import load as load_cell
    from postproc.correction.process import process
    from postproc.correction.result import Result, statistics
    from postproc.errors import Issue, PostprocError
    from postproc.forces import read_force_csv
    from postproc.jobs import load_robot, read_program
    from postproc.program import Program
    from postproc.report.csv_files import targets_csv
    from postproc.report.deviation import page
    from postproc.report.summary import summary
    from postproc.robot import RobotModel

__all__ = [
    "Cell",
    "Issue",
    "PostprocError",
    "Program",
    "Result",
    "RobotModel",
    "load_cell",
    "load_robot",
    "page",
    "process",
    "read_force_csv",
    "read_program",
    "statistics",
    "summary",
    "targets_csv",
]

_HOME = {
    "Cell": "cell.Cell",
    "Issue": "errors.Issue",
    "PostprocError": "errors.PostprocError",
    "Program": "program.Program",
    "Result": "correction.Result",
    "RobotModel": "robot.RobotModel",
    "load_cell": "cell.load",
    "load_robot": "jobs.load_robot",
    "page": "report.page",
    "process": "correction.process",
    "read_force_csv": "forces.read_force_csv",
    "read_program": "jobs.read_program",
    "statistics": "correction.statistics",
    "summary": "report.summary",
    "targets_csv": "report.targets_csv",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562).

    :raises AttributeError: the package has no such name.
    """
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _HOME[name].rsplit(".", 1)
    value: object = getattr(import_module(f"{__name__}.{module}"), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
