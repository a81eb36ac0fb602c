"""Lost motion in a program: listed by line and joint, corrected, and counted in the bound."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction
from postproc.report import page, summary
from postproc.robot import LostMotion
from tests.html_page import read_page
from tests.kr270 import CELL, ROBOT

LOOSE = replace(ROBOT, terms=((LostMotion("A1", 20.0), 50e-6),))
TEXT = """G90 G21
G0 X0 Y0 Z20
G1 Z0 F1200
(FORCE FX=0 FY=300 FZ=100)
G1 X60
(FORCE FX=0 FY=-300 FZ=100)
G1 X120
G0 Z20
M2
"""


def _convert(model, tmp_path):
    path = tmp_path / "part.nc"
    path.write_text(TEXT)
    from postproc.jobs.started_program import read_program

    return correction.process(read_program(path, model, CELL), model, CELL)


def test_the_step_of_a_reversal_is_listed_with_line_and_joint(tmp_path):
    result = _convert(LOOSE, tmp_path)
    assert not result.failed, result.issues
    found = summary(result).reversals
    assert (found[0].joint, found[0].source_line) == ("A1", 7)
    at = int(np.flatnonzero(result.source_line == 7)[0])
    flange = ROBOT.nominal.joint_frames(result.q[[at]])[1][0]
    tip = (flange @ result.program.tools[0])[:2, 3]
    assert found[0].lost_motion_mm == pytest.approx(2e3 * 50e-6 * np.linalg.norm(tip), rel=1e-3)
    assert all(entry.lost_motion_mm == 0.0 for entry in found if entry.joint != "A1")
    text = read_page(b"".join(page(result))).text("reversals")
    assert "A1 7 0." in text


def test_the_bound_next_to_the_reversal_holds_the_step_and_elsewhere_it_does_not(tmp_path):
    loose, tight = _convert(LOOSE, tmp_path), _convert(ROBOT, tmp_path)
    step = loose.reversals.step.max()
    turned = loose.reversals.row[np.argmax(loose.reversals.step)]
    assert loose.bound[turned] > 0.9 * step
    end = np.flatnonzero((loose.source_line == 7) & (loose.t == 1.0))[0]
    same = np.flatnonzero((tight.source_line == 7) & (tight.t == 1.0))[0]
    assert loose.bound[end] == pytest.approx(tight.bound[same], rel=1e-3)


def test_a_model_that_states_no_lost_motion_says_so(tmp_path):
    result = _convert(ROBOT, tmp_path)
    found = summary(result).reversals
    assert ("A1", 7, 0.0) in [(entry.joint, entry.source_line, entry.lost_motion_mm) for entry in found]
    assert "The robot model states none" in read_page(b"".join(page(result))).text("reversals")


def test_a_force_that_stays_reverses_nothing(tmp_path):
    path = tmp_path / "part.nc"
    path.write_text(TEXT.replace("FY=-300", "FY=300"))
    from postproc.jobs.started_program import read_program

    result = correction.process(read_program(path, ROBOT, CELL), ROBOT, CELL)
    assert not [entry for entry in summary(result).reversals if entry.source_line == 7]
