"""The joints: which angles they take, how near they come to their limits."""

import numpy as np

from postproc.frames import DEG_PER_RAD
from postproc.report.deviation.content import Deviation
from postproc.report.kit import Cell, Row, Section, Table
from postproc.report.text import number
from postproc.report.verdict import NARROW_DEG
from postproc.robot import JOINTS


def section(told: Deviation) -> Section | None:
    """Return a table of the joints."""
    result = told.result
    if not len(result):
        return None
    rows = []
    for index, name in enumerate(JOINTS):
        angle, margin = result.q[:, index] * DEG_PER_RAD, float(result.joint_margin[index]) * DEG_PER_RAD
        text = number(margin if np.isfinite(margin) else None, 1)
        limits = (f"{limit * DEG_PER_RAD:z.0f}" for limit in (result.robot.lower[index], result.robot.upper[index]))
        near = Cell(text, "warning" if margin < NARROW_DEG else "")
        rows.append(Row((name, f"{angle.min():z.1f}", f"{angle.max():z.1f}", " … ".join(limits), near)))
    head = ("Joint", "From, °", "To, °", "Limits, °", "Margin, °")
    return Section("joints", "Joints", (Table(head, tuple(rows), "Range of the joints and their margins"),), "half")
