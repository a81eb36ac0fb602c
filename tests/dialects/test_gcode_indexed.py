"""Indexed rotary axes: the part turns, X, Y, Z are machine axes. Against rotations of another library."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

import postproc
from postproc.cell import Cell, Frame, IndexedAxis, Machine, Rotary
from postproc.errors import CellError, ProgramError
from postproc.program import CIRC, LIN
from tests.commands import run
from tests.dialects.gcode_reading import CELL, ends, outcome, read
from tests.kr270 import CELL_TEXT

A_AXIS = IndexedAxis(point=(0.0, 12.0, -120.0), direction=(1.0, 0.0, 0.0))
C_AXIS = IndexedAxis(point=(30.0, -20.0, 0.0), direction=(0.0, 0.0, 2.0))
SKEW = IndexedAxis(point=(5.0, -7.0, -80.0), direction=(1.0, 0.4, -0.2))
AT_Z200 = "G21 G90 G17\nG0 X0 Y0 Z200 F600\n"


def cell(axes: list[str], signs: list[int] | None = None, **places: IndexedAxis) -> Cell:
    rotary = Rotary(axes=axes, signs=signs or [], kind="indexed", **places)
    return replace(
        CELL, rotary=rotary, machine=Machine(clearance_Z=150.0), work_offsets={"G55": Frame(X=100.0, Z=-5.0)}
    )


def in_part(points: np.ndarray, axes: list[tuple[IndexedAxis, float]]) -> np.ndarray:
    """Points (n, 3) of the machine in the part [mm]: the axis next to the part is the first, and the last to turn."""
    for axis, degrees in reversed(axes):
        unit = np.array(axis.direction) / np.linalg.norm(axis.direction)
        turn = Rotation.from_rotvec(np.radians(degrees) * unit)
        points = turn.apply(points - np.array(axis.point)) + np.array(axis.point)
    return points


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [A_AXIS, SKEW])
def test_points_of_the_machine_are_turned_into_the_part(axis: IndexedAxis, sign: int) -> None:
    text = AT_Z200 + "G0 A30\nG1 X10 Y5 Z-2\nX40 Y-6\nG0 Z200\nA-55\nG1 X4 Y3 Z1\nM2"
    program = read(text, cell(["A"], [sign], A=axis))
    feeds = ~program.motions.rapid
    machine = np.array([[10.0, 5.0, -2.0], [40.0, -6.0, -2.0], [4.0, 3.0, 1.0]])
    angles = sign * np.array([30.0, 30.0, -55.0])
    expected = np.vstack([in_part(point[None], [(axis, angle)]) for point, angle in zip(machine, angles, strict=True)])
    np.testing.assert_allclose(ends(program)[feeds], expected, atol=1e-9)
    unit = np.array(axis.direction) / np.linalg.norm(axis.direction)
    tools = [Rotation.from_rotvec(np.radians(angle) * unit).apply([0.0, 0.0, 1.0]) for angle in angles]
    np.testing.assert_allclose(-program.motions.target[feeds][:, :3, 2], tools, atol=1e-9)
    own = cell(["A"], [sign], A=axis)
    assert outcome(text, own, bulk=True) == outcome(text, own, bulk=False)


def test_of_two_axes_the_one_next_to_the_part_turns_with_the_second() -> None:
    own = cell(["C", "A"], A=A_AXIS, C=C_AXIS)
    program = read(AT_Z200 + "G55\nG0 C40 A-25\nG1 X10 Y5 Z-2\nM2", own)
    machine = np.array([[110.0, 5.0, -7.0]])
    expected = in_part(machine, [(C_AXIS, 40.0), (A_AXIS, -25.0)])
    np.testing.assert_allclose(ends(program)[-1:], expected, atol=1e-9)


def test_the_same_part_posted_for_tip_control_gives_the_same_targets() -> None:
    rng = np.random.default_rng(5)
    own = cell(["C", "A"], A=A_AXIS, C=C_AXIS)
    tip = replace(own, rotary=Rotary(axes=["C", "A"], kind="tcp"))
    indexed, tcp = [AT_Z200], [AT_Z200]
    for c, a in ((0.0, 0.0), (70.0, 20.0), (-110.0, 45.0)):
        machine = rng.uniform(-40.0, 40.0, (6, 3)) + np.array([0.0, 0.0, 60.0])
        part = in_part(machine, [(C_AXIS, c), (A_AXIS, a)])
        for lines, points in ((indexed, machine), (tcp, part)):
            words = [f"X{x:.9f} Y{y:.9f} Z{z:.9f}" for x, y, z in points]
            lines += [f"G0 C{c} A{a}\n", f"G0 {words[0]}\n", *(f"G1 {word}\n" for word in words[1:])]
    first, second = read("".join(indexed) + "M2", own), read("".join(tcp) + "M2", tip)
    cuts = [program.motions.target[~program.motions.rapid] for program in (first, second)]
    assert len(cuts[0]) == 15
    np.testing.assert_allclose(cuts[0], cuts[1], atol=1e-11)


def test_while_the_part_turns_the_tool_stays_at_its_distance_from_the_axis() -> None:
    program = read(AT_Z200 + "G1 X10 Y5 Z2\nG0 Z80\nA120\nG1 Z70\nM2", cell(["A"], A=A_AXIS))
    turning = program.motions.line == 5
    assert turning.sum() == 24
    assert (program.motions.kind[turning] == LIN).all()
    assert program.motions.rapid[turning].all()
    first = int(np.argmax(turning))
    corners = ends(program)[first - 1 : first + 24]
    share = np.linspace(0.0, 1.0, 11)[:, None, None]
    points = (corners[:-1] + share * np.diff(corners, axis=0)).reshape(-1, 3)
    radius = np.linalg.norm(points[:, 1:] - [12.0, -120.0], axis=1)
    expected = np.hypot(5.0 - 12.0, 80.0 + 120.0)
    assert radius.max() == pytest.approx(expected, abs=1e-9)
    assert radius.min() > 0.999 * expected
    np.testing.assert_allclose(points[:, 0], 10.0, atol=1e-9)


def test_arcs_and_holes_are_in_the_turned_plane() -> None:
    program = read(
        AT_Z200 + "G0 A30\nG1 X10 Y5 Z2\nG3 X30 Y5 I10 J0\nG0 Z50\nG81 X1 Y2 Z-3 R4\nG80\nM2", cell(["A"], A=A_AXIS)
    )
    arc = program.motions.kind == CIRC
    centre = in_part(np.array([[20.0, 5.0, 2.0]]), [(A_AXIS, 30.0)])
    np.testing.assert_allclose(program.motions.centre[arc] * 1e3, centre, atol=1e-9)
    normal = Rotation.from_euler("x", 30.0, degrees=True).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(program.motions.normal[arc], [normal], atol=1e-12)
    bottom = in_part(np.array([[1.0, 2.0, -3.0]]), [(A_AXIS, 30.0)])
    np.testing.assert_allclose(ends(program)[~program.motions.rapid][-1:], bottom, atol=1e-9)


def test_a_retract_to_a_machine_height_is_along_the_tool_even_if_it_is_horizontal() -> None:
    text = AT_Z200 + "G0 A90\nG1 X10 Y5 Z2\nG53 G0 Z0\nG0 A0\nG0 X0 Y0\nZ50\nG1 Z1\nM2"
    program = read(text, cell(["A"], A=A_AXIS))
    retract = program.motions.line == 5
    expected = in_part(np.array([[10.0, 5.0, 150.0]]), [(A_AXIS, 90.0)])
    np.testing.assert_allclose(ends(program)[retract], expected, atol=1e-9)


def test_an_index_before_the_first_position_is_no_motion() -> None:
    program = read("G21 G90\nG0 A30\nX10 Y5\nZ50 F600\nG1 Z2\nM2", cell(["A"], A=A_AXIS))
    assert program.motions.line.tolist() == [4, 5]
    np.testing.assert_allclose(ends(program)[-1:], in_part(np.array([[10.0, 5.0, 2.0]]), [(A_AXIS, 30.0)]), atol=1e-9)


def test_increments_turn_the_part_once() -> None:
    program = read(AT_Z200 + "G91\nG0 A30\nG0 A15 X5\nG90\nG1 X10 Y5 Z2\nM2", cell(["A"], A=A_AXIS))
    np.testing.assert_allclose(ends(program)[-1:], in_part(np.array([[10.0, 5.0, 2.0]]), [(A_AXIS, 45.0)]), atol=1e-9)
    program = read("G21 G90\nG91\nG0 A30\nG90\nG0 X10 Y5\nZ50 F600\nG1 Z2\nM2", cell(["A"], A=A_AXIS))
    np.testing.assert_allclose(ends(program)[-1:], in_part(np.array([[10.0, 5.0, 2.0]]), [(A_AXIS, 30.0)]), atol=1e-9)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("G1 X5 A30", "an indexed axis turns in a line that is not a rapid"),
        ("G81 X1 A30 Z-3 R4", "rotary axes turn in a cycle"),
        ("G10 L2 P1 R15\nG0 A30", "G10 R with indexed axes"),
        ("G43.4 H1\nG0 A30", "tool-centre-point control, and the rotary axes are indexed"),
        ("G0 A180", "the tool points away from the part"),
    ],
)
def test_what_indexed_axes_cannot_do_is_an_error(text: str, problem: str) -> None:
    with pytest.raises(ProgramError, match=problem):
        read(AT_Z200 + text + "\nG1 X6 Y5 Z2\nM2", cell(["A"], A=A_AXIS))


def test_without_a_kind_a_program_that_turns_axes_is_refused() -> None:
    own = replace(CELL, rotary=Rotary(axes=["A"]))
    with pytest.raises(ProgramError, match="the cell does not say what X, Y, Z are") as caught:
        read(AT_Z200 + "G0 A30\nG1 X50 Y5 Z2\nM2", own)
    assert 'kind = "indexed"' in str(caught.value)
    assert len(read(AT_Z200 + "G0 A0\nG1 X50 Y5 Z2\nM2", own).motions) == 2


def test_tip_control_that_the_program_itself_ends_is_off() -> None:
    own = replace(CELL, rotary=Rotary(axes=["A"], kind="tcp"), machine=Machine(clearance_Z=150.0))
    text = AT_Z200 + "G43.4 H1\nG0 A30\nG1 X50 Y5 Z2\n{}G1 X60\nM2"
    assert len(read(text.format(""), own).motions) == 4
    with pytest.raises(ProgramError, match="without tool-centre-point control"):
        read(text.format("G49\n"), own)


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ('axes = ["A"]\nkind = "indexed"', "A: no place"),
        ('axes = ["A"]\nkind = "indexed"\nA = { point = [0, 0, 0], direction = [0, 0, 0] }', "direction is zero"),
        ('axes = ["A"]\nkind = "indexed"\ntcp_on = ["M128"]\ntcp_off = ["M129"]', "tcp_on with indexed axes"),
    ],
)
def test_a_cell_that_contradicts_itself_is_refused(tmp_path: Path, lines: str, problem: str) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(CELL_TEXT + f"\n[rotary]\n{lines}\n")
    with pytest.raises(CellError, match=problem):
        postproc.load_cell(file)


def test_a_turned_work_offset_is_refused_where_a_program_uses_it(tmp_path: Path) -> None:
    axis = IndexedAxis((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    offsets = {"G55": Frame(X=20.0), "G56": Frame(C=10.0)}
    own = replace(CELL, rotary=Rotary(axes=["A"], kind="indexed", A=axis), work_offsets=offsets)
    assert read(AT_Z200 + "G55 G0 A30\nG1 X50 Y5 Z2\nM2", own).motions.line[-1] == 4
    with pytest.raises(ProgramError, match=r"\[work_offsets.G56\] is turned") as caught:
        read(AT_Z200 + "G56 G0 A30\nG1 X50 Y5 Z2\nM2", own)
    assert "turn [base] instead" in str(caught.value)
    file = tmp_path / "cell.toml"  # G54 is used by a program that names no work offset
    rotary = '\n[rotary]\naxes = ["A"]\nkind = "indexed"\nA = { point = [0, 0, 0], direction = [1, 0, 0] }\n'
    text = CELL_TEXT.replace("[work_offsets.G54]", "[work_offsets.G54]\nC = 10.0", 1)
    file.write_text(text + rotary)
    with pytest.raises(CellError, match=r"G54\] is turned"):
        postproc.load_cell(file)


def test_an_indexed_part_is_converted_as_a_user_would(tmp_path: Path) -> None:
    axis = "[rotary]\naxes = ['A']\nkind = 'indexed'\nA = { point = [0, 0, -120], direction = [1, 0, 0] }\n"
    (tmp_path / "cell.toml").write_text(CELL_TEXT + "\n" + axis)
    program = "G21 G90\nM3 S9000\nG0 X0 Y0\nG0 Z150\nG0 A30\nG0 X20 Y5\nZ60\nG1 Z50 F900\nX60\nG0 Z150\nM5\nM30\n"
    (tmp_path / "part.nc").write_text(program)
    arguments = ["convert", str(tmp_path / "part.nc"), "--cell", str(tmp_path / "cell.toml"), "-o", str(tmp_path / "o")]
    run(*arguments, code=(0, 3))
    rows = (tmp_path / "o" / "part.targets.csv").read_text().splitlines()
    columns = rows[0].split(",")
    last = [dict(zip(columns, row.split(","), strict=True)) for row in rows[1:] if row.split(",")[1] == "9"][-1]
    expected = in_part(np.array([[60.0, 5.0, 50.0]]), [(IndexedAxis((0.0, 0.0, -120.0), (1.0, 0.0, 0.0)), 30.0)])
    np.testing.assert_allclose([float(last[axis]) for axis in "XYZ"], expected[0], atol=1e-3)
