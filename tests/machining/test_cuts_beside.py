"""Cuts of another part, beside the stock of the process, are asked about: they would stay uncorrected."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from postproc.cell import Frame
from tests.kr270 import CELL
from tests.machining.setting import forces, gcode, process, tool

BOX = ((0, 100), (0, 60), (-20, 0))
SLOT = ("G0 X-10 Y30 Z20", "Z-2", "G1 X60 F1200", "G0 Z20")
TWO_PARTS = replace(CELL, work_offsets={"G55": Frame(X=-200.0)})


def lines_beside(folder, *blocks):
    _, found = forces(folder, gcode(*blocks), process(tool(12, 3), BOX, 1.0), cell=TWO_PARTS)
    return [line for issue in found.issues if issue.kind == "beside-stock" for line in issue.lines]


@pytest.mark.parametrize(
    ("blocks", "lines"),
    [
        ((*SLOT, "G55", *SLOT), [11]),
        ((*SLOT, "G55", *SLOT[:2], "G1 X20 F1200", "X60", "G0 Z20", "G54", *SLOT), [11, 12]),
        (SLOT, []),
        ((*SLOT, "G0 X-10 Y80", "Z-2", "G1 X90 F1200", "Y30", "G0 Z20"), []),  # it comes in from beside
        ((*SLOT, "G0 X-100 Y80", "Z-2", "G1 X-95 F1200", "G0 Z20"), []),  # shorter than the tool is wide
    ],
)
def test_runs_of_cuts_that_lie_beside_the_stock_are_named(tmp_path, blocks, lines):
    assert lines_beside(tmp_path, *blocks) == lines
