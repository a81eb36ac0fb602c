"""Parts of the process: numbers beside targets, reversals, what correction leaves, and what a draft adds."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.correction.verify import UnusableTextError
from postproc.elastostatics import Reversals
from postproc.errors import Issue, NotConvergedError
from postproc.poses import Poses
from postproc.under_load import ImpossiblePathError
from tests.kr270 import CELL
from tests.programs import program

process = importlib.import_module("postproc.correction.process")
MADE = program([
    ("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("CIRC", 50, 0, 0, 25, 0, 0, 180, (0, 0, 1)), ("RAPID", 50, 0, 50),
])  # fmt: skip


@pytest.mark.parametrize("mode", ["convert", "nominal", "predict"])
@pytest.mark.parametrize("keeps_text", [False, True])
def test_numbers_beside_targets_are_those_of_the_text_where_a_motion_of_the_text_ends(monkeypatch, mode, keeps_text):
    """Of a written program its own; of one that is only predicted those of the program, else the nominal pose."""
    made = replace(MADE, layout=SimpleNamespace() if keeps_text else None)
    monkeypatch.setattr(type(made), "numbers_as_written", lambda self: 1000.0 + np.arange(24.0).reshape(4, 6))
    motion, t = np.array([0, 1, 1, 2, 3]), np.array([1.0, 0.5, 1.0, 0.2, 1.0])
    pose = np.tile(np.eye(4), (5, 1, 1))
    pose[:, :3, 3] = 1e-3 * np.arange(15.0).reshape(5, 3)
    targets = SimpleNamespace(motion=motion, t=t, pose=Poses.of(pose))
    draft = SimpleNamespace(
        simulation=None, path=SimpleNamespace(program=made), selection=SimpleNamespace(targets=targets)
    )
    numbers = process._printed_numbers(SimpleNamespace(mode=mode), draft)
    for k in range(5):
        is_of_text = mode == "predict" and keeps_text and t[k] == 1.0
        expected = 1000.0 + 6.0 * motion[k] + np.arange(6.0) if is_of_text else [*(3.0 * k + np.arange(3.0)), 0, 0, 0]
        np.testing.assert_allclose(numbers[k], expected, atol=1e-9)
    draft.simulation = SimpleNamespace(numbers="as written")
    assert process._printed_numbers(SimpleNamespace(mode=mode), draft) == "as written"


def test_torque_reversals_count_on_cutting_moves_only(monkeypatch):
    """They are found for the loads at the targets, in the root of the robot."""
    points = Reversals(np.array([1, 2, 3, 5]), np.array([0, 1, 2, 4]), np.array([3, 0, 1, 5]), np.arange(4.0))
    calls = []
    monkeypatch.setattr(process.elastostatics, "reversals", lambda *parts: calls.append(parts) or points)
    row = np.array([0, 2, 4, 6, 7, 9])
    path = SimpleNamespace(
        program=MADE, robot_in_cell=SimpleNamespace(robot="robot"), tool=lambda rows: rows + 0.25,
        wrench_in_root=lambda rows: rows + 0.75,
    )  # fmt: skip
    selection = SimpleNamespace(row=row, targets=SimpleNamespace(motion=np.array([0, 1, 2, 3, 2, 1])))
    found = process._reversals(SimpleNamespace(path=path, selection=selection, q=10.0 * np.arange(10.0)))
    ((robot, q, tool, wrench),) = calls
    assert robot == "robot"
    np.testing.assert_array_equal(q, 10.0 * row)
    np.testing.assert_array_equal(tool, row + 0.25)
    np.testing.assert_array_equal(wrench, row + 0.75)
    assert (found.row.tolist(), found.previous_row.tolist()) == (
        [1, 2, 5],
        [0, 1, 4],
    )  # motion 3, of target 3, is rapid
    assert (found.joint.tolist(), found.step.tolist()) == ([3, 0, 5], [0.0, 1.0, 3.0])


def test_joints_may_be_on_either_flank_at_both_targets_of_a_reversal():
    points = Reversals(np.array([1, 2, 2]), np.array([0, 1, 1]), np.array([3, 0, 3]), np.zeros(3))
    expected = np.zeros((4, 6), dtype=bool)
    expected[0, 3] = expected[1, [0, 3]] = expected[2, [0, 3]] = True
    np.testing.assert_array_equal(process._joints_near_reversal(points, 4), expected)


@pytest.mark.parametrize("mode", ["convert", "nominal", "predict"])
@pytest.mark.parametrize("is_simulated", [False, True])
def test_correction_leaves_what_the_simulation_says_and_nothing_of_a_nominal_program(mode, is_simulated):
    rounding, programmed = np.array([1e-5, 5e-5, 2e-5]), np.array([3e-5, 1e-5, 2e-5])
    simulation = SimpleNamespace(deviation=np.ones((3, 3)), path_distance=np.full(3, 2.0), rounding=rounding)
    draft = SimpleNamespace(
        selection=SimpleNamespace(row=np.arange(3), programmed_rounding=programmed),
        simulation=simulation if is_simulated else None,
    )
    deviation, distance = process._remaining_errors(SimpleNamespace(mode=mode), draft)
    is_left = is_simulated and mode != "nominal"
    np.testing.assert_array_equal(deviation, np.full((3, 3), float(is_left)))
    np.testing.assert_array_equal(distance, np.full(3, 2.0 * is_left))
    np.testing.assert_allclose(process._extra_rounding(draft), [0.0, 4e-5 * is_simulated, 0.0])


def test_all_motions_without_equilibrium_are_named_by_their_lines():
    """Rows of a part are rows of the samples that were asked for."""
    path = SimpleNamespace(program=MADE, sample=SimpleNamespace(motion=np.array([0, 1, 1, 2, 3, 3])))

    def solve(row):
        raise NotConvergedError("no", [1, 2])

    with pytest.raises(ImpossiblePathError) as refused:
        process._solve_in_chunks(path, solve, np.array([0, 2, 5]))
    issue = refused.value.issue
    assert (issue.level, issue.kind, issue.source_line, issue.lines) == ("error", "not-converged", 2, (2, 4))


class Draft(process.Draft):
    """A draft whose text is given."""

    def _text(self, task):
        return task.writer


def drafted(monkeypatch, simulation, *, text_issues=(), initial_issues=(), has_force_file=False, mode="convert"):
    """The draft as written, and the calls of its stages."""
    calls = []

    def read_back(*parts):
        calls.append("read back")
        if isinstance(simulation, UnusableTextError):
            raise simulation
        return "readback"

    def simulate(path, selection, theta, readback, *, is_corrected):
        calls.append((theta, readback, is_corrected))
        return simulation

    monkeypatch.setattr(process, "read_back", read_back)
    monkeypatch.setattr(process, "simulate", simulate)
    monkeypatch.setattr(process, "_readback_forces", lambda draft, readback: ("knots", ("issue of the file",)))
    text = SimpleNamespace(issues=text_issues, size=10, modules=None)
    path = SimpleNamespace(robot_in_cell=SimpleNamespace(cell=CELL), program=MADE)
    draft = Draft(path, None, "theta", "selection", initial_issues)
    task = SimpleNamespace(writer=text, has_force_file=has_force_file, mode=mode)
    return draft.write(task), calls


def issue(kind, level="warning"):
    return Issue(level, kind, "message")


@pytest.mark.parametrize(("mode", "is_corrected"), [("convert", True), ("predict", True), ("nominal", False)])
@pytest.mark.parametrize("has_force_file", [False, True])
def test_a_written_draft_has_the_issues_of_its_simulation_that_are_new_and_all_of_blending(
    monkeypatch, mode, is_corrected, has_force_file
):
    simulation = SimpleNamespace(issues=(issue("old"), issue("new"), issue("blending"), issue("new")))
    initial = (issue("old"), issue("blending"))
    draft, calls = drafted(
        monkeypatch,
        simulation,
        text_issues=(issue("text"),),
        initial_issues=initial,
        has_force_file=has_force_file,
        mode=mode,
    )
    assert calls == ["read back", ("theta", "readback", is_corrected)]
    assert [entry.kind for entry in draft.issues] == ["old", "blending", "text", "new", "blending", "new"]
    assert draft.simulation is simulation
    assert (draft.file_forces, draft.force_file_issues) == (
        ("knots", ("issue of the file",)) if has_force_file else (None, ())
    )


def test_a_draft_with_an_error_of_its_simulation_has_no_force_file(monkeypatch):
    draft, _ = drafted(monkeypatch, SimpleNamespace(issues=(issue("tolerance", "error"),)), has_force_file=True)
    assert draft.failed
    assert (draft.file_forces, draft.force_file_issues) == (None, ())


def test_a_text_with_an_error_is_not_read_back(monkeypatch):
    draft, calls = drafted(monkeypatch, None, text_issues=(issue("letters", "error"),))
    assert (calls, draft.simulation, [entry.kind for entry in draft.issues]) == ([], None, ["letters"])


def test_a_text_that_cannot_be_used_is_an_error_of_the_draft(monkeypatch):
    unusable = UnusableTextError(issue("read-back", "error"))
    draft, calls = drafted(monkeypatch, unusable, text_issues=(issue("text"),))
    assert calls == ["read back"]
    assert ([entry.kind for entry in draft.issues], draft.simulation) == (["text", "read-back"], None)
