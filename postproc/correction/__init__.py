"""One program from text to result: sample, load, solve, compensate, choose targets, write, read back, simulate.

Reads and writes no files; the command line, `jobs` and CAM hosts share it.
"""

from postproc.correction.process import process, read, uncorrected_deviations
from postproc.correction.result import (
    ExpectedErrors,
    HeldFeed,
    Mode,
    Result,
    Statistics,
    share_beyond,
    statistics,
    weighted_quantile,
)

__all__ = [
    "ExpectedErrors",
    "HeldFeed",
    "Mode",
    "Result",
    "Statistics",
    "process",
    "read",
    "share_beyond",
    "statistics",
    "uncorrected_deviations",
    "weighted_quantile",
]
