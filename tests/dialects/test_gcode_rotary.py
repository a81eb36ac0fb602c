"""Five axes with tool-centre-point control, against rotations of another library."""

import itertools
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation, Slerp

import postproc
from postproc import toolpath
from postproc.cell import Cell, Frame, Machine, Rotary
from postproc.errors import ProgramError
from postproc.program import CIRC, LIN, PTP, Program, direction, largest_rotation, tilt_to
from postproc.robot import RobotModel
from tests.dialects.gcode_reading import CELL, START_FLANGE, ends, outcome, read
from tests.places import CELL_FILE, SAMPLES

ANGLES_AT_HOME = (0.0, -90.0, 90.0, 0.0, 10.0, 0.0)
ROTARY_AXES_AT_ZERO = "G21 G90 G17\nG0 A0 B0 C0\nG0 X0 Y0 Z9 F600\n"
PAIRS = [[a, b] for a, b in itertools.permutations("ABC", 2)] + [["A"], ["B"], ["C"]]


def cell(axes: list[str], signs: list[int] | None = None, **keys: object) -> Cell:
    return replace(CELL, rotary=Rotary(axes=axes, signs=signs or [1] * len(axes), **{"kind": "tcp", **keys}))


def expected(axes: list[str], signs: list[int], degrees: list[float]) -> np.ndarray:
    """The direction from the tip to the spindle."""
    turned = Rotation.identity()
    for axis, sign, angle in zip(axes, signs, degrees, strict=True):
        turned = turned * Rotation.from_euler({"A": "x", "B": "y", "C": "z"}[axis], sign * angle, degrees=True)
    return turned.apply([0.0, 0.0, 1.0])


@pytest.mark.parametrize("axes", PAIRS, ids="".join)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_tool_points_where_the_axes_turn_it_all_along_a_move(axes: list[str], sign: int) -> None:
    signs = [sign, -sign][: len(axes)]
    others = "".join(f" {letter}0" for letter in "ABC" if letter not in axes)
    head = ROTARY_AXES_AT_ZERO.replace("A0 B0 C0", " ".join(f"{letter}0" for letter in axes))
    first, second = dict(zip(axes, (20.0, 35.0), strict=False)), dict(zip(axes, (-50.0, 60.0), strict=False))
    text = head + "".join(
        f"G1 X{x} " + " ".join(f"{letter}{angle}" for letter, angle in words.items()) + others + "\n"
        for x, words in ((10, first), (40, second))
    )
    program = read(text + "M2", cell(axes, signs))
    path = toolpath.segments(program, START_FLANGE)
    t = np.linspace(0.05, 1.0, 20)
    for motion, before, after in ((1, dict.fromkeys(axes, 0.0), first), (2, first, second)):
        poses = toolpath.at(program, path, np.full(len(t), motion), t).pose
        for share, pose in zip(t, poses, strict=True):
            angles = [before[letter] + share * (after[letter] - before[letter]) for letter in axes]
            np.testing.assert_allclose(-pose[:3, 2], expected(axes, signs, angles), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(program.motions.target[:, :3, :3]), 1.0)
    assert outcome(text + "M2", cell(axes, signs), bulk=True) == outcome(text + "M2", cell(axes, signs), bulk=False)


def test_where_the_axis_stands_along_the_tool_nothing_spins() -> None:
    program = read(
        ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "G1 C170\nX5 C-90\nX9 B10\nX9.1 B0\nC0\nX12\nM2", cell(["C", "B"])
    )
    rotations = program.motions.target[:, :3, :3]
    assert program.motions.line.tolist() == [3, 5, 6, 7, 9]  # C alone is no move there
    assert program.swivel.travel[1] == 0.0
    np.testing.assert_allclose(rotations[[0, 1, 3, 4]], np.broadcast_to(rotations[0], (4, 3, 3)), atol=1e-12)
    turned = Rotation.from_matrix(rotations[2] @ rotations[0].T).magnitude()
    assert turned == pytest.approx(np.radians(10.0), abs=1e-12)


def test_the_redundancy_turns_the_tool_about_its_axis() -> None:
    text = ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "G1 X5 B30 C20\nM2"
    one = cell(["C", "B"])
    other = replace(one, gcode=replace(one.gcode, redundancy_deg=40.0))
    relative = read(text, one).motions.target[1, :3, :3].T @ read(text, other).motions.target[1, :3, :3]
    np.testing.assert_allclose(Rotation.from_matrix(relative).as_rotvec(degrees=True), [0, 0, -40], atol=1e-9)


def test_increments_and_turns_alone_are_moves() -> None:
    program = read(ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "G91 G1 B10\nB10 C5\nX5\nM2", cell(["C", "B"]))
    assert len(program.motions) == 4
    np.testing.assert_allclose(-program.motions.target[3, :3, 2], expected(["C", "B"], [1, 1], [5, 20]), atol=1e-12)


FAULTS = {
    "another axis": ("G1 X1 A10", {}, "A word without a code"),
    "upwards": ("G1 X1 B180", {}, "points away from the part"),
    "no tip": ("G1 B10\nX5", {"tcp_on": ["G43.4"], "tcp_off": ["G49"]}, "without tool-centre-point control"),
    "no tip any more": (
        "G43.4 H1\nG1 X5 B10\nG49\nG0 Z50",
        {"tcp_on": ["G43.4"], "tcp_off": ["G49"]},
        "without tool-centre-point control",
    ),
    "in a cycle": ("G81 X1 Z-1 R1 B5", {}, "rotary axes turn in a cycle"),
    "across the tool": ("G0 B30\nG81 X1 Z-1 R1", {}, "a cycle with a tilted tool"),
    "level": ("G1 B85\nG53 G0 Z0", {}, "retract with a nearly horizontal tool"),
    "after the axes were swung home": (
        "G43.4 H1\nG1 X5 B10\nG49\nG0 B0\nX7\nG1 X9",
        {"tcp_on": ["G43.4"], "tcp_off": ["G49"]},
        "before the position is known",
    ),
}


@pytest.mark.parametrize(("text", "keys", "problem"), FAULTS.values(), ids=FAULTS)
def test_what_rotary_axes_cannot_do_is_told(text: str, keys: dict[str, list[str]], problem: str) -> None:
    own = replace(cell(["C", "B"], **keys), machine=Machine(clearance_Z=100.0))
    with pytest.raises(ProgramError, match=problem):
        read(ROTARY_AXES_AT_ZERO.replace("A0 ", "") + text + "\nM2", own)


def test_codes_of_tool_centre_point_control_are_read() -> None:
    text = ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "{on}\nG1 X5 B10\nB0\n{off}\nG0 Z50\nM2"
    for on, off in (("G43.4 H1", "G49"), ("M128", "M129")):
        keys = {"tcp_on": [on.split(" ")[0]], "tcp_off": [off]}
        assert len(read(text.format(on=on, off=off), cell(["C", "B"], **keys)).motions) == 4
        assert len(read(text.format(on=on, off=off), cell(["C", "B"])).motions) == 4


def test_the_words_of_axes_that_do_not_turn_may_stand_in_arcs_and_cycles() -> None:
    text = ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "G1 C20\nG2 X10 I5 C20. B0\nG81 X12 Z-1 R1 B0. C20\nX14 B0\nG80\nM2"
    plain = read(re.sub(r" ?[BC]-?[0-9.]+", "", text), CELL)
    program = read(text, cell(["C", "B"]))
    np.testing.assert_array_equal(ends(program), ends(plain))
    assert np.count_nonzero(program.motions.kind == CIRC) == 1


@pytest.mark.parametrize("units", ["G21", "G20"])
def test_the_feed_of_axes_that_turn_alone_is_in_degrees_a_minute(units: str) -> None:
    text = f"{ROTARY_AXES_AT_ZERO.replace('A0 ', '')}{units} F90\nG1 B30 F90\nX1\nB60 C40\nG93 B30 C0 F2\nM2"
    program = read(text, cell(["C", "B"]))
    rate = program.swivel.rate
    assert np.isnan(rate[[0, 2]]).all()
    assert rate[1] == pytest.approx(np.radians(90.0) / 60.0, rel=1e-9)
    times = [np.hypot(30.0, 40.0) / 90.0 * 60.0, 30.0]
    for motion, seconds in zip((3, 4), times, strict=True):
        t = np.linspace(0.0, 1.0, 2001)
        poses = program.swivel.at(np.full(len(t), motion), t)
        way = (Rotation.from_matrix(poses[:-1]).inv() * Rotation.from_matrix(poses[1:])).magnitude().sum()
        assert rate[motion] == pytest.approx(way / seconds, rel=1e-3)


@pytest.mark.parametrize(("to", "turns"), [("krl", "$VEL.ORI1=1.5"), ("rapid", ",1.5,5000,1000]")])
def test_the_robot_is_told_how_fast_the_tool_turns(to: str, turns: str) -> None:
    own = postproc.load_cell(SAMPLES / ("cell_kr270.toml" if to == "krl" else "cell_irb6700.toml"))
    own = replace(own, rotary=Rotary(axes=["C", "B"], kind="tcp"))
    robot = postproc.load_robot(own.robot)
    text = "G21 G90\nG0 B0 C0\nG0 X0 Y0 Z50\nG1 X5 F90\nB15\nX9\nM30\n"
    program = five_axes(text, robot, own)
    result = postproc.process(program, robot, own, to=to)
    written = result.documents[0].text
    assert turns in written
    if to == "krl":
        lines = written.splitlines()
        assert lines.index("$VEL.ORI1=1.5") < lines.index("$VEL.ORI1=$VEL_MA.ORI1")


@pytest.mark.parametrize("axes", [["C", "B"], ["A", "B"], ["B", "A"], ["A", "C"], ["B"]], ids="".join)
def test_by_how_much_the_tool_turns_is_bounded(axes: list[str]) -> None:
    rng = np.random.default_rng(5)
    vectors = np.array([np.eye(3)["ABC".index(axis)] for axis in axes])
    begin, end = rng.uniform(-1.4, 1.4, (2, 40, len(axes)))
    bound = largest_rotation(vectors, begin, end)
    turned = np.zeros(40)
    before = tilt_to(direction(vectors, begin))
    for share in np.linspace(0.0, 1.0, 400)[1:]:
        after = tilt_to(direction(vectors, begin + share * (end - begin)))
        turned += Rotation.from_matrix(np.swapaxes(before, 1, 2) @ after).magnitude()
        before = after
    assert (turned <= bound * (1.0 + 1e-6)).all()
    assert (bound <= 4.0 * turned + 1e-9).mean() > 0.8


def test_axes_may_turn_along_an_arc() -> None:
    text = ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "G93 G3 X10 Y10 Z5 I0 J10 B30 C90 F2\nG94 G1 X20 F600\nM2"
    program = read(text, cell(["C", "B"]))
    m = program.motions
    pieces = np.flatnonzero(m.line == 4)
    centre, share = np.array([0.0, 10.0]), np.arange(1, len(pieces) + 1) / len(pieces)
    points = ends(program)[pieces]
    angle = np.radians(-90.0 + 90.0 * share)
    expected_points = np.column_stack(
        [*(centre[:, None] + 10.0 * np.array([np.cos(angle), np.sin(angle)])), 9 - 4 * share]
    )
    np.testing.assert_allclose(points, expected_points, atol=1e-9)
    sagitta = 10.0 * (1.0 - np.cos(np.radians(90.0) / len(pieces) / 2.0))
    assert sagitta <= 0.1 * CELL.output.tolerance_mm
    for pose, part in zip(m.target[pieces], share, strict=True):
        np.testing.assert_allclose(-pose[:3, 2], expected(["C", "B"], [1, 1], [90.0 * part, 30.0 * part]), atol=1e-9)
    length = np.hypot(np.pi * 5.0, 4.0)
    np.testing.assert_allclose(m.feed[pieces] * 60e3, 2.0 * length, rtol=1e-9)


def test_with_a_tilted_tool_a_retract_leaves_along_the_tool() -> None:
    own = replace(cell(["C", "B"]), machine=Machine(clearance_Z=80.0))
    program = read(ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "G1 X5 Z4 B30 C40\nG53 G0 Z0\nM2", own)
    tip, away = ends(program)[-2:]
    along = expected(["C", "B"], [1, 1], [40, 30])
    np.testing.assert_allclose(away - tip, along * (80.0 - 4.0) / along[2], atol=1e-9)


def test_with_a_tilted_tool_the_way_down_is_along_the_tool() -> None:
    own = replace(
        cell(["C", "B"], tcp_on=["G43.4"], tcp_off=["G49"]), machine=Machine(home=ANGLES_AT_HOME, clearance_Z=80.0)
    )
    text = ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "G28 G91 Z0\nG90 G0 B30 C40\nG0 X7 Y3\nG43.4 Z4 H1\nG1 X9\nM2"
    program = read(text, own)
    m = program.motions
    above, tip = ends(program)[-3:-1]
    along = expected(["C", "B"], [1, 1], [40, 30])
    np.testing.assert_allclose(tip, [7, 3, 4], atol=1e-9)
    np.testing.assert_allclose(above - tip, along * 76.0 / along[2], atol=1e-9)
    assert m.kind[-3:].tolist() == [PTP, LIN, LIN]
    np.testing.assert_allclose(-m.target[-3, :3, 2], along, atol=1e-9)


def test_home_brings_rotary_axes_home() -> None:
    own = replace(cell(["C", "B"]), machine=Machine(home=(0.0, -90.0, 90.0, 0.0, 10.0, 0.0)))
    text = ROTARY_AXES_AT_ZERO.replace("A0 ", "") + "G1 X5 B10\nG28 G91 Z0\nG28 B0\nG90\nG0 X1 Y1\nZ5\nM2"
    program = read(text, own)
    np.testing.assert_allclose(-program.motions.target[-1, :3, 2], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(ends(program)[-1], [1, 1, 5], atol=1e-9)


def five_axes(text: str, robot: RobotModel, own: Cell) -> Program:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "five.nc"
        path.write_text(text)
        return postproc.read_program(path, robot, own)


def test_a_jump_of_the_axis_along_the_tool_is_no_target_of_its_own() -> None:
    own = replace(postproc.load_cell(CELL_FILE), rotary=Rotary(axes=["C", "B"], kind="tcp"))
    robot = postproc.load_robot(own.robot)
    program = five_axes("G21 G90\nG0 X0 Y0 Z50\nG1 X5 F900\nC180\nX9 C-180\nX12\nM30\n", robot, own)
    assert len(postproc.process(program, robot, own)) == 4


def test_targets_are_inserted_so_that_the_robot_turns_the_tool_as_the_axes_do() -> None:
    own = postproc.load_cell(CELL_FILE)
    own = replace(own, rotary=Rotary(axes=["C", "B"], kind="tcp"), base=Frame(X=1500.0, Y=-200.0, Z=700.0))
    robot = postproc.load_robot(own.robot)
    lines = ["G21 G90", "G0 B0 C0", "G0 X0 Y0 Z50", "(FORCE FX=100 FY=50 FZ=80)", "G1 Z0 F1200"]
    lines += ["X40 B20 C30", "X60 Y5 C120 B15", "B0 C180"]
    program = five_axes("\n".join([*lines, "G0 Z60", "M30", ""]), robot, own)
    result = postproc.process(program, robot, own)
    assert result.inserted > 20
    rows = np.flatnonzero(np.isin(result.motion, np.flatnonzero(program.swivel.travel > 0.0)))
    for k in rows[1:]:
        motion, t = int(result.motion[k]), float(result.t[k])
        begin = float(result.t[k - 1]) if result.motion[k - 1] == motion else 0.0
        turned = Slerp([0.0, 1.0], Rotation.from_matrix(result.nominal[k - 1 : k + 1, :3, :3]))(np.linspace(0, 1, 9))
        places = begin + np.linspace(0, 1, 9) * (t - begin)
        own_turn = Rotation.from_matrix(program.swivel.at(np.full(9, motion), places))
        assert (turned.inv() * own_turn).magnitude().max() < 1.5 * 1e-5 / 0.1
