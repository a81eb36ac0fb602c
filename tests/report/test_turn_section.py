"""The section on the turn of the tool: errors along the chosen line and at the turn of the cell."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.placement import Turn
from postproc.placement.drive import LeastMargins
from postproc.report.deviation.sections import _gain_sentences, _turn_map
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


def test_the_map_of_the_turn_has_the_error_of_each_free_cell_and_the_reason_of_each_other_one():
    """A column for each bin that takes travel, a row for each turn; rapid moves have no error."""
    error = 1e-4 * np.arange(15.0).reshape(5, 3)
    margin = np.full((5, 3), 0.5)
    margin[1, 2], margin[2, 0] = np.nan, np.radians(1.0)
    drawn_map = small_map(u95=error, margin=replace(small_map().margin, joint=margin))
    turn = Turn("path", drawn_map, LeastMargins(joint=np.radians(5.0)), 0.0, np.zeros(3), np.zeros(3))
    found = _turn_map(turn, np.array([0.0, 0.02, 0.05, 0.09, 0.13]), np.array([-5.0, 0.0, 5.0]))
    assert (found.x, found.y) == ([0.02, 0.05, 0.09, 0.13], [-5.0, 0.0, 5.0])
    shown = [[None if value is None else round(value, 9) for value in row] for row in found.values]
    assert shown == [[0.3, None, None, None], [0.4, 0.7, None, None], [None, 0.8, None, None]]
    names = [[found.names[reason] for reason in row] for row in found.reasons]
    assert names == [["free", "joint limit", "free", "free"], ["free"] * 4, ["out of reach", "free", "free", "free"]]
    assert found.title == "expected error (95 %), mm"


def test_the_map_of_the_turn_shows_joint_margins_where_there_are_no_errors():
    margin = np.full((5, 3), 0.5)
    margin[3] = [0.25, np.inf, np.nan]
    no_error = small_map(u95=np.zeros((5, 3)), margin=replace(small_map().margin, joint=margin))
    turn = Turn("path", no_error, LeastMargins(), 0.0, np.zeros(3), np.zeros(3))
    found = _turn_map(turn, np.arange(5.0), np.array([-5.0, 0.0, 5.0]))
    assert found.title == "joint margin, °"
    assert [row[2] for row in found.values] == [pytest.approx(np.degrees(0.25)), None, None]
    assert found.values[0][0] == pytest.approx(np.degrees(0.5))
    uncertain = replace(turn, map=small_map(u95=np.full((5, 3), np.nan)))
    found = _turn_map(uncertain, np.arange(5.0), np.array([-5.0, 0.0, 5.0]))
    assert found.title == "deflection, mm"
    assert found.values[1][0] == pytest.approx(0.3)
