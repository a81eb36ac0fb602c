"""`predict` tells what the program does as it stands, between its targets too: what `convert` says before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import asdict

from postproc import correction, jobs, report
from postproc.forces import read_force_csv
from postproc.program import Document
from tests.kr270 import CELL, ROBOT
from tests.places import SAMPLES
from tests.programs import program

DOWN = CELL.tool_orientation()


@pytest.mark.parametrize("name", ["pocket.nc", "long_lin.src", "inline.src"])
def test_prediction_has_the_numbers_that_convert_has_before(name: str) -> None:
    made = jobs.read_program(SAMPLES / name, ROBOT, CELL)
    csv = SAMPLES / f"{Path(name).stem}.forces.csv"
    rows = read_force_csv(csv) if csv.exists() else None
    corrected, predicted = (correction.process(made, ROBOT, CELL, rows, mode) for mode in ("convert", "predict"))
    before, as_it_stands = report.summary(corrected).before, report.summary(predicted).before
    for key, value in asdict(before).items():
        assert getattr(as_it_stands, key) == pytest.approx(value, abs=1e-7)  # mm: what the equilibrium is solved to
    np.testing.assert_array_equal(predicted.t, corrected.t)
    assert predicted.path_deviation >= max(predicted.before) > 0.0
    assert predicted.largest_correction == 0.0
    assert predicted.documents == ()


def test_what_is_worst_between_the_targets_of_a_long_line_is_told() -> None:
    made = jobs.read_program(SAMPLES / "inline.src", ROBOT, CELL)
    result = correction.process(made, ROBOT, CELL, mode="predict")
    ends, between = result.before[result.t == 1.0], result.before[result.t < 1.0]
    assert between.max() > ends.max() + 0.05e-3
    assert result.path_deviation >= between.max()


def test_numbers_of_krl_stand_beside_its_own_targets_only() -> None:
    made = jobs.read_program(SAMPLES / "inline.src", ROBOT, CELL)
    result = correction.process(made, ROBOT, CELL, mode="predict")
    nominal = result.nominal[:, :3, 3] * 1e3
    assert (result.t < 1.0).any()
    np.testing.assert_allclose(result.printed[:, :3], nominal, atol=1e-6)


def test_a_force_that_no_command_can_hold_is_an_error_with_its_line() -> None:
    made = program(
        [("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", 50, 0, 0)],
        notes=[(3, (0.0, 0.0, -9.9e5, 0, 0, 0))],
        orientation=DOWN,
    )
    assert isinstance(made.documents[0], Document)
    (issue,) = (i for i in correction.process(made, ROBOT, CELL, mode="predict").issues if i.level == "error")
    assert (issue.kind, issue.source_line) == ("not-converged", 3)
