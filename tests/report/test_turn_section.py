"""The section on the turn of the tool: errors along the chosen line and at the turn of the cell."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.placement import Turn
from postproc.placement.drive import LeastMargins
from postproc.report.deviation.sections import _gain_sentences
from tests.placement.test_map_parts import small_map


@pytest.mark.parametrize(("lengths", "texts"), [
    ((0.01, 0.03), ("0.46 mm RMS", "0.18 mm with 30°")), ((0.03, 0.01), ("0.28 mm RMS", "0.11 mm with 30°")),
])  # fmt: skip
def test_errors_along_a_line_weigh_by_the_length_of_their_cuts(lengths, texts):
    """Bins 1 and 2 are cuts; the line is at the third turn, the cell at the second."""
    error = np.full((5, 3), np.nan)
    error[1], error[2] = [9e-4, 0.0, 1e-4], [9e-4, 2.1e-4, 5.3e-4]
    drawn_map = small_map(u95=error, deflection=error)
    cut_length = np.array([0.0, *lengths, 0.0, 0.0])
    drawn_map = replace(drawn_map, blocks=replace(drawn_map.blocks, cut_length=cut_length))
    turn = Turn("path", drawn_map, LeastMargins(), np.radians(30.0), np.zeros(3), np.zeros(3))
    (sentence,) = _gain_sentences(turn, np.full(5, 0.1))
    assert all(text in sentence for text in texts), sentence
