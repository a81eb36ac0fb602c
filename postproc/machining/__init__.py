"""Engagement of the cutter in the stock, and cutting forces along a program.

`estimate` sweeps the tools of a program through its stock and returns forces along the motions; `operation_knots` takes
them from a small table instead. Both use the process that `load` reads from process.toml.
"""

from postproc.machining.estimate import ProcessForces, estimate
from postproc.machining.material import Entry, kienzle_coefficients, linear_coefficients, table
from postproc.machining.process import Process, load
from postproc.machining.profiles import knots_by_line
from postproc.machining.source import ProcessSource, operation_knots
from postproc.machining.sweep import Cuts
from postproc.machining.tool_path import Shift

__all__ = [
    "Cuts",
    "Entry",
    "Process",
    "ProcessForces",
    "ProcessSource",
    "Shift",
    "estimate",
    "kienzle_coefficients",
    "knots_by_line",
    "linear_coefficients",
    "load",
    "operation_knots",
    "table",
]
