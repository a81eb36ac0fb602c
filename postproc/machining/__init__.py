"""Engagement of the cutter in the stock, and cutting forces along a program.

`estimate` sweeps the tools of a program through its stock and returns forces along the motions; `by_operation` takes
them from a small table instead. Both use the process that `load` reads from process.toml.
"""

from postproc.machining.by_lines import one_move_a_line
from postproc.machining.estimate import ProcessForces, estimate
from postproc.machining.material import Entry, table
from postproc.machining.operations import OperationForces, by_operation
from postproc.machining.process import Process, load
from postproc.machining.source import ProcessSource
from postproc.machining.sweep import Cuts
from postproc.machining.ways import Shift

__all__ = [
    "Cuts",
    "Entry",
    "OperationForces",
    "Process",
    "ProcessForces",
    "ProcessSource",
    "Shift",
    "by_operation",
    "estimate",
    "load",
    "one_move_a_line",
    "table",
]
