"""Touched points: the oracle arm touches points with a true cell; a wrong cell must be found, and by how much."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from postproc.jobs.frame_check import as_text, check_frames
from tests.commands import run
from tests.kr270 import FOLDER
from tests.oracle.arm import Arm, abc
from tests.places import CELL_FILE, ROOT

BASE, TOOL = (1500.0, -200.0, 700.0, 10.0, 0.0, 0.0), (3.0, -2.0, 350.0, 0.0, 0.0, 0.0)
POINTS = np.array([[0, 0, 0], [200, 0, 0], [0, 150, 0], [200, 150, 40], [100, 75, 0]], dtype=float)
TURNS = (0.0, 0.0, 0.0, 0.0, 90.0)


def touching(turns, tilts=(0.0, 0.0, 0.0, 0.0, 0.0)):
    """Joint angles [deg] at which the oracle arm has its tip at the points, the tool down, turned and tilted."""
    arm = Arm.load(FOLDER)
    rows = []
    for point, turn, tilt in zip(POINTS, turns, tilts, strict=True):
        target = abc(*BASE) @ abc(*point, turn + 180.0, tilt, 180.0)
        guess = np.radians([5, -80, 100, 0, 60, turn])
        joints = arm.inverse(target, abc(*TOOL), guess)
        assert abs(arm.nominal_tcp(joints, abc(*TOOL)) - target).max() < 1e-9
        rows.append(np.degrees(joints))
    return np.array(rows)


def written(folder: Path, joints, base=BASE, tool=TOOL, more=()) -> tuple[Path, Path]:
    head = "point,X,Y,Z,A1,A2,A3,A4,A5,A6"
    rows = [
        f"P{k}," + ",".join(map(repr, [*p.tolist(), *q.tolist()]))
        for k, (p, q) in enumerate(zip(POINTS, joints, strict=True), 1)
    ]
    (folder / "points.csv").write_text("\n".join([head, *rows]) + "\n")
    tables = [
        f"[{name}]\n" + "\n".join(f"{k} = {v}" for k, v in zip("XYZABC", frame, strict=True))
        for name, frame in (("base", base), ("tool", tool))
    ]
    (folder / "cell.toml").write_text("\n".join(['robot = "kuka_kr270"', *more, *tables]) + "\n")
    return folder / "points.csv", folder / "cell.toml"


@pytest.fixture(scope="module")
def joints():
    return touching(TURNS)


TILTS = (0.0, 30.0, 0.0, 0.0, 0.0)


def test_frames_that_agree_are_said_to_agree(tmp_path):
    check = check_frames(*written(tmp_path, touching(TURNS, TILTS)), 0.1)
    assert check.suspect == "none"
    assert check.distances.max() < 1e-6


@pytest.mark.parametrize(("turns", "tilts"), [(TURNS, (0.0,) * 5), ((0.0,) * 5, TILTS)], ids=["turned", "tilted"])
def test_a_tool_turned_about_one_axis_hides_an_error_along_it(tmp_path, turns, tilts):
    points, cell = written(tmp_path, touching(turns, tilts))
    assert check_frames(points, cell, 0.1).suspect == "one-axis"
    text = run("check", "frames", points, "--cell", cell, code=3).output
    assert "turned about one axis only" in text
    assert "agree with the points." not in text


def test_an_error_of_the_tool_as_large_as_is_said_to_hide_is_as_far_off_as_noise(tmp_path):
    """The tool is too long by the length that is stated, and $BASE is moved so as to hide it."""
    joints, sigma_mm = touching(TURNS, TILTS), 0.1
    hidden = check_frames(*written(tmp_path, joints), sigma_mm).hidden_error * 1e3
    assert 0.3 < hidden < 1.5
    assert f"errors of $TOOL up to {hidden:.2g} mm" in as_text(check_frames(*written(tmp_path, joints), sigma_mm), 0.1)
    longer = (*TOOL[:2], TOOL[2] + hidden, *TOOL[3:])
    lower = (*BASE[:2], BASE[2] - hidden, *BASE[3:])
    check = check_frames(*written(tmp_path, joints, base=lower, tool=longer), sigma_mm)
    left = np.linalg.norm(check.distances) * 1e3
    # moved by the best $BASE, it would be 1.96 standard deviations; by one that only is lower it is a little more
    assert 1.96 * sigma_mm - 1e-3 <= left < 1.5 * 1.96 * sigma_mm


def test_a_wrong_tool_is_found_with_its_error_and_the_right_numbers(tmp_path, joints):
    wrong = (TOOL[0] + 4.0, TOOL[1], TOOL[2] - 3.0, *TOOL[3:])
    check = check_frames(*written(tmp_path, joints, tool=wrong), 0.1)
    assert check.suspect == "tool"
    np.testing.assert_allclose(check.tool[0] * 1e3, [4.0, 0.0, -3.0], atol=1e-3)
    np.testing.assert_allclose(check.new_frames["tool"], TOOL, atol=2e-3)
    assert "X too long by 4.00 ±" in (text := as_text(check, 0.1))
    assert "Y off by 0.00 ±" in text
    assert "Z too short by 3.00 ±" in text


def test_a_wrong_base_is_found_and_the_right_numbers_given(tmp_path, joints):
    wrong = (BASE[0] + 5.0, BASE[1] - 2.0, BASE[2] + 1.0, BASE[3] + 0.5, 0.0, 0.0)
    check = check_frames(*written(tmp_path, joints, base=wrong), 0.1)
    assert check.suspect == "base"
    np.testing.assert_allclose(check.new_frames["base"], BASE, atol=0.03)  # linear in half a degree


def test_intervals_hold_what_noise_does_to_the_error(tmp_path):
    """Of 20 noisy sets, the 95 % intervals miss a coordinate of the true error in few."""
    outside = 0
    clean = touching(TURNS)
    wrong = (TOOL[0] + 4.0, TOOL[1], TOOL[2], *TOOL[3:])
    rng = np.random.default_rng(5)
    for _ in range(20):
        points, cell = written(tmp_path, clean, tool=wrong)
        lines = points.read_text().splitlines()
        moved = POINTS + 0.2 * rng.standard_normal(POINTS.shape)
        rows = [
            ",".join([line.split(",")[0], *map(repr, p.tolist()), *line.split(",")[4:]])
            for line, p in zip(lines[1:], moved, strict=True)
        ]
        points.write_text("\n".join([lines[0], *rows]) + "\n")
        check = check_frames(points, cell, 0.2)
        if check.tool is not None:
            outside += int((abs(check.tool[0] * 1e3 - [4.0, 0.0, 0.0]) > check.tool[1] * 1e3).sum())
    assert outside <= 9  # 3 of 60 are expected; 10 or more have a chance below 0.1 %


def test_frames_of_an_arm_that_sags_are_those_at_which_its_tip_touches(tmp_path):
    """With frames = "model", what the sag under a payload does to a $BASE that the controller measured is found."""
    mass, centre = 90.0, np.array([0.0, 50.0, 200.0])
    payload = f"payload = {{mass_kg = {mass}, X = {centre[0]}, Y = {centre[1]}, Z = {centre[2]}}}"
    arm = dataclasses.replace(Arm.load(FOLDER), payload=(mass, centre / 1e3))
    joints = []
    for k, start in enumerate(np.radians(touching(TURNS, TILTS))):
        target = abc(*BASE) @ abc(*POINTS[k], TURNS[k] + 180.0, TILTS[k], 180.0)
        commanded, q = target.copy(), start
        for _ in range(6):
            tip = arm.loaded_tcp(q, abc(*TOOL), np.zeros(6))
            commanded[:3, 3] += (target - tip)[:3, 3]
            q = arm.inverse(commanded, abc(*TOOL), q)
        assert 1e-4 < np.linalg.norm((commanded - target)[:3, 3]) < 2e-3
        joints.append(np.degrees(q))
    by_controller = check_frames(*written(tmp_path, joints, more=[payload]), 0.02)
    assert by_controller.suspect != "none"
    options = ['frames = "model"', payload]
    by_model = check_frames(*written(tmp_path, joints, more=options), 0.02)
    assert by_model.suspect == "none"
    assert by_model.distances.max() < 1e-7
    assert 'frames = "model"' in as_text(by_model, 0.02)
    measured = (BASE[0] + 0.2, BASE[1], BASE[2] + 0.4, *BASE[3:])
    corrected = check_frames(*written(tmp_path, joints, base=measured, more=options), 0.02)
    np.testing.assert_allclose(corrected.new_frames["base"], BASE, atol=1e-3)


def test_without_a_turned_tool_the_frames_cannot_be_told_apart(tmp_path):
    same = touching((0.0,) * len(POINTS))
    wrong = (TOOL[0] + 4.0, *TOOL[1:])
    check = check_frames(*written(tmp_path, same, tool=wrong), 0.1)
    assert check.suspect == "undecided"
    assert "tool turned about its axis by 90°" in as_text(check, 0.1)


def test_the_length_of_a_turned_tool_shows_only_where_it_is_tilted_as_the_advice_says(tmp_path, joints):
    wrong = (*TOOL[:2], TOOL[2] - 3.0, *TOOL[3:])
    check = check_frames(*written(tmp_path, joints, tool=wrong), 0.1)
    assert check.suspect == "undecided"
    assert "tool tilted as far as you can, 30° at least" in as_text(check, 0.1)
    tilted = touching(TURNS, TILTS)
    check = check_frames(*written(tmp_path, tilted, tool=wrong), 0.1)
    assert check.suspect == "tool"
    np.testing.assert_allclose(check.tool[0] * 1e3, [0.0, 0.0, -3.0], atol=1e-3)


def test_a_point_that_was_mistaken_is_no_frame(tmp_path, joints):
    mistaken = joints.copy()
    mistaken[2, 0] += 1.0
    check = check_frames(*written(tmp_path, mistaken), 0.1)
    assert check.suspect == "contradiction"


def test_the_command_exits_with_3_where_a_frame_is_off(tmp_path, joints):
    wrong = (TOOL[0] + 4.0, *TOOL[1:])
    points, cell = written(tmp_path, joints, tool=wrong)
    done = run("check", "frames", points, "--sigma", "0.1", cell=cell, code=3)
    assert "$TOOL is off" in done.output
    points.write_text("\n".join(points.read_text().splitlines()[:3]) + "\n")
    assert "2 points" in run("check", "frames", points, cell=cell, code=1).output


def test_a_tool_that_is_never_turned_leaves_errors_that_cancel_unseen(tmp_path):
    files = written(tmp_path, touching((0.0,) * len(POINTS)))
    assert check_frames(*files, 0.1).suspect == "unturned"
    assert run("check", "frames", files[0], "--cell", files[1], code=3).output.startswith("The points agree with both")


@pytest.mark.parametrize("kept", [[0, 1, 1, 0, 1], [0, 0, 0, 0, 0]], ids=["line", "one place"])
def test_points_on_one_line_are_refused(tmp_path, joints, kept):
    files = written(tmp_path, joints[kept])
    lines = files[0].read_text().splitlines()
    rows = [
        ",".join([f"P{n}", *lines[k + 1].split(",")[1:4], *lines[n + 1].split(",")[4:]]) for n, k in enumerate(kept)
    ]
    files[0].write_text("\n".join([lines[0], *rows]) + "\n")
    assert "on one line" in run("check", "frames", files[0], "--cell", files[1], code=1).stderr


def test_a_standard_deviation_that_is_no_number_is_refused(tmp_path, joints):
    files = written(tmp_path, joints)
    assert "nan" in run("check", "frames", files[0], "--cell", files[1], "--sigma", "nan", code=2).stderr


def test_the_example_of_the_reference_agrees_with_the_sample_cell(tmp_path):
    text = (ROOT / "docs" / "reference" / "checks.md").read_text()
    points = tmp_path / "points.csv"
    points.write_text(text.split("```csv\n")[1].split("```")[0])
    output = run("check", "frames", points, "--cell", CELL_FILE).output
    assert output.startswith("Both frames agree with the points.")
    (stated,) = re.findall(r"errors of \$TOOL up to (\S+ mm)", output)
    assert f"and 0.5 mm, {stated}" in text
