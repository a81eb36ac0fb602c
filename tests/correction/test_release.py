"""A planted wrong program is refused: by the read-back if the text is another one, else by the simulation."""

from __future__ import annotations

import re
from importlib import import_module

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction
from postproc.cell import ExternalAxis
from postproc.dialects.krl.dialect import Krl
from postproc.poses import Poses
from tests.corrections import read_files
from tests.kr270 import CELL, ROBOT
from tests.programs import program

MOVES = [
    ("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", 40, 0, 0), ("CIRC", 60, 20, 0, 40, 20, 0, 90.0, (0, 0, 1)),
    ("LIN", 60, 50, 0), ("LIN", 60, 50, 30),
]  # fmt: skip
FORCE = [(2, (120.0, 50.0, 90.0, 4.0, -3.0, 2.0))]
_NUMBER = r"-?\d+\.?\d*"


def process_moves(made=None, cell=CELL):
    made = program(MOVES, notes=FORCE, orientation=CELL.tool_orientation()) if made is None else made
    return correction.process(made, ROBOT, cell)


def errors(result):
    return [(issue.kind, issue.source_line) for issue in result.issues if issue.level == "error"]


def tampered(monkeypatch, change):
    """Let the writer write another text than it does."""
    honest = type(Krl.writer).write

    def wrong(*given, **named):
        written = honest(*given, **named)
        document = written.documents[0]
        text = change(document.text)
        assert text != document.text
        return replace(written, documents=(replace(document, text=text), *written.documents[1:]))

    monkeypatch.setattr(type(Krl.writer), "write", wrong)


def shifted(pattern, by, which=-1):
    """Add to the number that a pattern finds, at one of the places where it does."""

    def change(text):
        found = list(re.finditer(pattern, text))[which]
        return f"{text[: found.start(1)]}{float(found[1]) + by:.6f}{text[found.end(1) :]}"

    return change


def of_line(kind, name):
    """The number of one axis on a line of a kind of motion (the last point of it)."""
    return rf"(?m)^\s*{kind}\b[^\n]*\b{name} ({_NUMBER})"


def test_the_program_as_it_is_written_is_released():
    result = process_moves()
    assert not errors(result)
    text = result.documents[0].text
    for kind in ("PTP", "LIN", "CIRC"):
        assert re.search(rf"(?m)^\s*{kind}\b", text), text


@pytest.mark.parametrize("kind", ["LIN", "CIRC"])
@pytest.mark.parametrize("name", ["X", "Y", "Z", "A", "B", "C"])
def test_a_number_of_a_target_that_is_another_one(monkeypatch, kind, name):
    """Positions by 2 µm, angles by 1e-4°: twice what printing may do."""
    tampered(monkeypatch, shifted(of_line(kind, name), 2e-3 if name in "XYZ" else 1.2e-4))
    result = process_moves()
    assert errors(result) == [("read-back", 6 if kind == "LIN" else 4)]
    assert [issue.count for issue in result.issues if issue.level == "error"] == [1]
    assert result.documents == ()


@pytest.mark.parametrize("name", ["X", "Z"])
def test_what_printing_may_do_to_a_target_is_no_other_text(monkeypatch, name):
    tampered(monkeypatch, shifted(of_line("LIN", name), 1e-4))
    assert not errors(process_moves())


@pytest.mark.parametrize("name", ["X", "Y", "Z", "A", "B", "C"])
@pytest.mark.parametrize("frame", ["BASE", "TOOL"])
def test_a_frame_that_is_another_one(monkeypatch, frame, name):
    tampered(monkeypatch, shifted(rf"\${frame}\s*=\s*{{[^}}]*\b{name} ({_NUMBER})", 2e-3 if name in "XYZ" else 1.2e-4))
    assert {kind for kind, _ in errors(process_moves())} == {"read-back"}


@pytest.mark.parametrize(
    ("pattern", "new"),
    [
        (r"(?m)^(\s*)LIN\b(?=[^\n]*\n(?s:.)*^\s*CIRC)", r"\1PTP"),  # another kind of motion
        (r"(?m)^\s*LIN\b[^\n]*\n(?=\s*END)", ""),  # a target fewer
        (r"(?m)^(\s*LIN\b[^\n]*\n)(?=\s*END)", r"\1\1"),  # a target more
        (r"(?m)^(\s*)CIRC (\{[^}]*\}), *", r"\1LIN "),  # a line in place of an arc
    ],
)
def test_motions_that_are_others(monkeypatch, pattern, new):
    tampered(monkeypatch, lambda text: re.sub(pattern, new, text, count=1))
    result = process_moves()
    assert [kind for kind, _ in errors(result)] == ["read-back"]
    assert result.documents == ()


@pytest.mark.parametrize("by", [2e-6, -2e-6])
def test_a_speed_that_is_another_one(monkeypatch, by):
    tampered(monkeypatch, shifted(rf"\$VEL\.CP\s*=\s*({_NUMBER})", by))
    assert [kind for kind, _ in errors(process_moves())] == ["read-back"]


def test_a_text_that_cannot_be_read(monkeypatch):
    tampered(monkeypatch, lambda text: re.sub(r"(?m)^(\s*LIN )\{X", r"\1{Q", text, count=1))
    assert [kind for kind, _ in errors(process_moves())] == ["read-back"]


@pytest.mark.parametrize(("by", "kind"), [(0.05, "tolerance"), (1e-4, None)])
def test_an_auxiliary_point_that_is_another_one_is_seen_between_targets(monkeypatch, by, kind):
    """The read-back compares ends; how the arc runs is for the simulation to see."""
    tampered(monkeypatch, shifted(rf"(?m)^\s*CIRC\b \{{X ({_NUMBER})", by))
    result = process_moves()
    assert {each for each, _ in errors(result)} == ({kind} if kind else set())
    if kind:
        assert any("between targets" in issue.message for issue in result.issues)
        assert (result.documents, errors(result)[0][1]) == ((), 4)


@pytest.mark.parametrize(("by", "refused"), [("E1 +2e-3", True), ("E1 +1e-4", False)])
def test_a_place_of_the_carriage_that_is_another_one(monkeypatch, by, refused):
    cell = replace(CELL, external_axes={"E1": ExternalAxis((3.0, 4.0, 0.0))})
    lines = (
        "DEF part( )", "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}", "$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}", "$VEL.CP=0.05",
        ";FORCE FX=-110 FY=190 FZ=130 MZ=2", "PTP {X 0,Y 0,Z 0,A 180,B 0,C 180,E1 100}", "LIN {X 100,E1 150}",
        "LIN {X 200,E1 170}", "END", "",
    )  # fmt: skip
    made = read_files({"part.src": "\n".join(lines)}, cell)
    tampered(monkeypatch, shifted(rf"E1 ({_NUMBER})", float(by.split()[1])))
    assert bool([kind for kind, _ in errors(process_moves(made, cell)) if kind == "read-back"]) is refused


def commands(monkeypatch, change):
    """Let the correction command other poses than it should: what is written is then what was computed."""
    stages = import_module("postproc.correction.process")  # the package names the function alike
    honest = stages.corrected_commands

    def wrong(path):
        found = honest(path)
        pose = found.pose[:]
        change(path, pose)
        return replace(found, pose=Poses.of(pose))

    monkeypatch.setattr(stages, "corrected_commands", wrong)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("by", "refused"), [(2e-6, True), (-2e-6, True), (3e-7, False)])
def test_a_command_that_does_not_hold_the_tip_at_a_target(monkeypatch, axis, by, refused):
    """One micrometre is allowed, rounding included; the line of the target is named."""

    def change(path, pose):
        pose[(path.sample.motion == 4) & (path.sample.t == 1.0), axis, 3] += by

    commands(monkeypatch, change)
    result = process_moves()
    assert errors(result) == ([("tolerance", 5)] if refused else [])
    assert (result.documents == ()) is refused
    if refused:
        (issue,) = (issue for issue in result.issues if issue.kind == "tolerance")
        assert "misses a target" in issue.message
        assert 0.0015 < float(re.search(r"by ([\d.]+) mm", issue.message)[1]) < 0.0025


def test_a_correction_the_other_way_round_is_refused(monkeypatch):
    def change(path, pose):
        pose[:, :3, 3] -= 2.0 * (pose[:, :3, 3] - path.sample.pose[:, :3, 3])

    commands(monkeypatch, change)
    kinds = {kind for kind, _ in errors(process_moves())}
    assert "tolerance" in kinds


@pytest.mark.parametrize(("axis", "angle"), [("x", 1e-3), ("y", -1e-3)])
def test_a_command_whose_orientation_leaves_the_tip_elsewhere_under_moments_is_seen(monkeypatch, axis, angle):
    """Turned about its own tip the tool stands where it should, but for the deflection, which turns with the arm."""
    from scipy.spatial.transform import Rotation

    def change(path, pose):
        pose[path.sample.motion == 2, :3, :3] = (
            Rotation.from_euler(axis, 40 * angle).as_matrix() @ (pose[path.sample.motion == 2, :3, :3])
        )

    commands(monkeypatch, change)
    assert ("tolerance", 3) in errors(process_moves())


def test_deviations_of_the_result_are_those_of_the_simulation(monkeypatch):
    def change(path, pose):
        pose[path.sample.motion > 0, :3, 3] += np.array([3e-7, -4e-7, 2e-7])

    honest = process_moves()
    commands(monkeypatch, change)
    other = process_moves()
    moved = honest.motion > 0
    np.testing.assert_array_equal(honest.motion, other.motion)
    np.testing.assert_allclose(
        (other.deviation_after - honest.deviation_after)[moved],
        np.tile([3e-7, -4e-7, 2e-7], (moved.sum(), 1)),
        atol=1.5e-7,
    )


def test_a_command_that_no_joint_angles_reach_names_its_line(monkeypatch):
    """The next place on the path is in reach."""

    def change(path, pose):
        pose[(path.sample.motion == 5) & (path.sample.t == 1.0), 0, 3] += 9.0

    commands(monkeypatch, change)
    result = process_moves(cell=replace(CELL, output=replace(CELL.output, max_correction_mm=1e5)))
    assert errors(result)[-1] == ("read-back", 6)
    (message,) = (issue.message for issue in result.issues if issue.kind == "read-back")
    assert "cannot be simulated: a commanded pose is out of reach" in message
