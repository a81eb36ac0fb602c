"""What becomes of a program that cannot be read, turned, corrected, judged or written: an error or a prediction."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction
from postproc.correction.targets import Commands
from postproc.errors import InputError, Issue, ProgramError
from postproc.under_load import ImpossiblePathError, RobotInCell
from tests.corrections import read_files
from tests.kr270 import CELL, ROBOT
from tests.placement import setting

process = importlib.import_module("postproc.correction.process")
TEXT = "G21 G90\nG0 X0 Y0 Z20\n(FORCE FX=-150 FY=120 FZ=200)\nG1 Z0 F600\nG1 X60 F1500\nG0 Z20\n"
MODES = ["convert", "nominal", "predict"]


@pytest.mark.parametrize("mode", MODES)
def test_a_language_that_the_controller_does_not_read_is_refused_where_it_would_be_written(mode):
    made, robot = read_files({"part.nc": TEXT}), replace(ROBOT, language="rapid")
    if mode == "predict":
        assert not correction.process(made, robot, CELL, None, mode).failed
        return
    with pytest.raises(InputError) as refused:
        correction.process(made, robot, CELL, None, mode)
    assert f"a program in krl for {ROBOT.title}, whose controller reads rapid" in str(refused.value)
    assert "or convert G-code with --to rapid" in str(refused.value)
    assert not correction.process(made, robot, CELL, None, mode, to="rapid").failed
    assert not correction.process(made, replace(ROBOT, language="krl"), CELL, None, mode).failed


def test_a_robot_program_in_another_language_is_not_read():
    krl = "DEF part( )\n$VEL.CP=0.05\nPTP {X 0,Y 0,Z 20,A 180,B 0,C 180}\nEND\n"
    assert len(read_files({"part.src": krl}).motions) == 1
    with pytest.raises(InputError, match="whose controller reads rapid"):
        read_files({"part.src": krl}, robot=replace(ROBOT, language="rapid"))
    assert len(read_files({"part.nc": TEXT}, robot=replace(ROBOT, language="rapid")).motions) == 4


@pytest.mark.parametrize(("name", "text"), [("part.nc", "G21 G90\nM30\n"), ("part.src", "DEF part( )\nEND\n")])
def test_a_program_without_a_motion_is_refused(name, text):
    with pytest.raises(ProgramError, match=r"moves nothing|no motion"):
        read_files({name: text})


def test_a_reader_of_another_package_that_returns_no_motion_is_refused(monkeypatch):
    empty = SimpleNamespace(motions=())
    dialect = SimpleNamespace(writer=None, read=lambda documents, cell, forward, name: empty)
    monkeypatch.setattr(process.registry, "dialect_of_name", lambda name: dialect)
    with pytest.raises(ProgramError, match="no motion in this program") as refused:
        process.read([SimpleNamespace(name="part.xyz")], ROBOT, CELL, "part", "xyz")
    assert refused.value.file == "part.xyz"


def cell_of(redundancy):
    return setting.cell(base=(0.0, 0.0, 500.0), redundancy=redundancy, redundancy_deg=110.0)


def test_a_turn_that_is_chosen_is_that_of_the_program_that_is_corrected():
    """It is written as a cell would write it that states the sum of both turns."""
    text = "G21 G90\n(FORCE FX=-110 FY=-190 FZ=130 FRAME=BASE)\nG0 X1300 Y-20 Z60\nG1 Z0 F600\nG1 Y20 F2000\nG0 Z60\n"
    chosen = setting.process_text(text, cell_of("best"))
    assert not chosen.failed, chosen.issues
    turn = np.degrees(chosen.turn.of_motion)
    assert np.ptp(turn) < 1e-9
    assert abs(turn[0]) > 1.0
    stated = setting.cell(base=(0.0, 0.0, 500.0), redundancy_deg=110.0 + float(turn[0]))
    np.testing.assert_allclose(setting.process_text(text, stated).printed, chosen.printed, atol=1e-4)
    assert setting.process_text(text, cell_of("constant")).turn is None
    assert [issue.kind for issue in chosen.issues].count("redundancy") == 1


def test_a_program_without_a_turn_that_can_be_driven_has_its_error_and_no_targets():
    text = "G21 G90\nG0 X1500 Y0 Z60\nG1 Z0 F1500\nG1 X4400 F2000\n"
    result = setting.process_text(text, cell_of("best"))
    assert result.failed
    assert (len(result), result.documents, result.turn) == (0, (), None)
    assert [issue.kind for issue in result.issues if issue.level == "error"] == ["redundancy"]


def test_an_error_that_is_known_before_spares_the_choice_of_a_turn(monkeypatch):
    def never(*parts):
        raise AssertionError("chosen")

    monkeypatch.setattr(process.placement, "in_chosen_turn", never)
    text = "G21 G90\nT1 M6\nG0 X1300 Y0 Z60\nG1 Z0 F600\nT2 M6\nG1 Y20 F2000\n"
    result = setting.process_text(text, cell_of("best"))
    assert [issue.kind for issue in result.issues if issue.level == "error"] == ["tool-change"]
    assert (len(result), result.documents) == (0, ())


def impossible(path):
    raise ImpossiblePathError(Issue("error", "not-converged", "no loaded equilibrium", 4))


@pytest.mark.parametrize("mode", MODES)
def test_what_cannot_be_corrected_can_be_predicted_and_written_as_it_is(monkeypatch, mode):
    monkeypatch.setattr(process, "corrected_commands", impossible)
    result = correction.process(read_files({"part.nc": TEXT}), ROBOT, CELL, None, mode)
    assert result.failed == (mode == "convert")
    assert len(result) == (0 if mode == "convert" else 4)
    if mode == "convert":
        assert [(issue.kind, issue.source_line) for issue in result.issues if issue.level == "error"] == [
            ("not-converged", 4)
        ]


@pytest.mark.parametrize("mode", MODES)
def test_what_cannot_be_written_can_be_predicted(monkeypatch, mode):
    made = read_files({"part.nc": TEXT})
    _, writer = process.registry.written_in(made.dialect, None)

    def write(*parts):
        raise ProgramError("no such letter", file="part.nc", line=3)

    monkeypatch.setattr(type(writer), "write", write)
    if mode == "predict":
        result = correction.process(made, ROBOT, CELL, None, mode)
        assert not result.failed
        assert set(result.source_line) == {2, 4, 5, 6}
        return
    with pytest.raises(ProgramError, match="no such letter"):
        correction.process(made, ROBOT, CELL, None, mode)


def test_an_expected_error_that_is_no_number_is_an_error_with_its_line(monkeypatch):
    original = process.elastostatics.expected_errors

    def expected_at(*parts):
        values = original(*parts)
        bound = values.bound.copy()
        bound[-2] = np.nan
        return replace(values, bound=bound)

    monkeypatch.setattr(process.elastostatics, "expected_errors", expected_at)
    result = correction.process(read_files({"part.nc": TEXT}), ROBOT, CELL)
    assert (result.bound, result.errors) == (None, None)
    (issue,) = [issue for issue in result.issues if issue.kind == "no-bound"]
    assert (issue.level, issue.source_line) == ("error", result.source_line[-2])
    assert "is not a number here" in issue.message


def test_a_robot_without_covariance_has_no_bound_and_no_word_of_it():
    result = correction.process(read_files({"part.nc": TEXT}), replace(ROBOT, covariance=None), CELL)
    assert (result.bound, result.errors) == (None, None)
    assert "no-bound" not in {issue.kind for issue in result.issues}


def test_a_place_between_samples_that_is_out_of_reach_is_an_error(monkeypatch):
    inspection = process.inspection
    original = inspection.kinematics.branch_joints

    def on_branch(robot, flange, branch):
        q = original(robot, flange, branch)
        q[len(q) // 2] = np.nan
        return q

    made = read_files({"part.nc": TEXT.replace("X60", "X600")})
    motions = process.MotionsUnderLoad.of(made, RobotInCell.of(ROBOT, CELL), None)
    path = process.PathUnderLoad.of(motions, motions.pieces(linearize_arcs=False))
    stretches = inspection.Stretches(np.array([2]), np.zeros(1), np.ones(1), np.array([8]))
    command: Commands = process.programmed_commands(path)
    monkeypatch.setattr(inspection.kinematics, "branch_joints", on_branch)
    issues = list(
        inspection.issues_between_samples(path, command.q, command.pose[:, :3, 3], stretches, np.zeros(0, dtype=int))
    )
    assert [(issue.level, issue.source_line) for issue in issues] == [("error", 5)]
    assert "out of reach" in issues[0].message
