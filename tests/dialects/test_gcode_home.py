"""[machine] home as a place: the machine is there before the first move, and after G28, G30 and G53."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

import postproc
from postproc.cell import Cell, IndexedAxis, Machine, Rotary
from postproc.errors import CellError, ProgramError
from postproc.program import PTP
from tests.dialects.gcode_reading import CELL, ends, outcome, read
from tests.kr270 import CELL_TEXT

AT_HOME = replace(CELL, machine=Machine(home=[3.0, -4.0, 200.0]))


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("G1 X5 Y5 Z-1", [[5, 5, -1]]),  # a cut as the first move
        ("G91 G0 X10\nG1 Z-190", [[13, -4, 200], [13, -4, 10]]),
        (
            "G0 Z5\nG1 Z-1\nG91 G28 Z0\nG90 X50\nG1 Z2",
            [[3, -4, 5], [3, -4, -1], [3, -4, 200], [50, -4, 200], [50, -4, 2]],
        ),
        ("G0 X5 Z5\nG28 X20\nG1 Z1", [[5, -4, 5], [20, -4, 5], [3, -4, 5], [3, -4, 1]]),  # over the intermediate point
        ("G0 X5 Z5\nG53 G0 X0 Y0\nG1 Z1", [[5, -4, 5], [3, -4, 5], [3, -4, 1]]),
        ("G0 X5 Y7 Z5\nG28 X\nG1 Z1", [[5, 7, 5], [3, 7, 5], [3, 7, 1]]),  # letters alone: no intermediate point
        ("G0 X5 Y7 Z5\nN40 G28 Z X (home)\nG1 Z1", [[5, 7, 5], [3, 7, 200], [3, 7, 1]]),
        ("$H\nG0 X5 Y7 Z5\n$H ; home\nG1 Z1", [[5, 7, 5], [3, -4, 200], [3, -4, 1]]),  # Grbl
        ("G0 X5 Y7 Z5\n$HZ\nG1 Z1", [[5, 7, 5], [5, 7, 200], [5, 7, 1]]),
        ("G2 X3 Y-4 I10 J0", [[3, -4, 200]]),
    ],
)
def test_moves_begin_where_the_machine_is(text: str, path: list[list[float]]) -> None:
    whole = f"G21 G90 F600\n{text}\nM2"
    program = read(whole, AT_HOME)
    assert program.motions.kind[0] == PTP
    np.testing.assert_allclose(ends(program), [[3, -4, 200], *path], atol=1e-9)
    assert outcome(whole, AT_HOME, bulk=True) == outcome(whole, AT_HOME, bulk=False)


def test_home_is_in_base_whatever_the_work_offset() -> None:
    program = read("G21 G90 F600\nG56\nG0 X0 Y0 Z0\nG28 G91 Z0\nG90 G1 Z1\nM2", AT_HOME)
    offset = CELL.work_offsets["G56"].pose()
    np.testing.assert_allclose(program.motions.target[0, :3, 3] * 1e3, [3, -4, 200], atol=1e-9)
    np.testing.assert_allclose(ends(program)[2], [*offset[:2, 3] * 1e3, 200.0], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("G53 G0 X-300\nG1 Y3", "X must be programmed again"),
        ("G53 G0 Z-30\nG1 Y3", "Z must be programmed again"),
        ("G53 G0 Z-30\nG91 G0 Z-5", "Z must be programmed again"),
    ],
)
def test_another_place_of_the_machine_is_not_known(text: str, problem: str) -> None:
    with pytest.raises(ProgramError, match=problem):
        read(f"G21 G90 F600\nG0 X5 Z5\n{text}\nM2", AT_HOME)


def test_with_a_tilted_tool_home_as_a_place_is_an_error_but_for_indexed_axes() -> None:
    tcp = replace(AT_HOME, rotary=Rotary(axes=["A"], kind="tcp"))
    text = "G21 G90 F600\nG0 X5 Y5 Z5 A30\nG28 G91 Z0\nG90 G1 Z1\nM2"
    with pytest.raises(ProgramError, match="with tilted axes, and home is a place"):
        read(text, tcp)
    place = IndexedAxis(point=(0.0, 0.0, 0.0), direction=(1.0, 0.0, 0.0))
    indexed: Cell = replace(AT_HOME, rotary=Rotary(axes=["A"], kind="indexed", A=place))
    program = read(text, indexed)
    height = ends(program)[-2]
    turn = np.deg2rad(30.0)
    assert height @ [0.0, -np.sin(turn), np.cos(turn)] == pytest.approx(200.0)


def test_home_with_another_count_of_numbers_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    assert "[machine]" not in CELL_TEXT
    file.write_text(CELL_TEXT + "\n[machine]\nhome = [0, 0, 200, 0]\n")
    with pytest.raises(CellError, match="home has 4 numbers"):
        postproc.load_cell(file)


@pytest.mark.parametrize(
    "text",
    [
        "G1 Z-1\nG1 X40\nG1 X0 Y20\nG0 Z-1",  # the highest Z is that of the cut
        "G1 Z-1\nX40\nX0 Y20\nZ-3",
        "G1 Z2\nG1 X40\nG1 Z-3\nG1 Y20\nG0 Z9",  # a plunge where Y is not known
        "G1 Z-1\nX40\nG91 G28 Z0\nG90 G1 X0 Y20",
    ],
)
def test_a_cut_before_the_place_is_known_is_not_left_out(text: str) -> None:
    """It was taken for one of the moves at the top with which hobby programs begin, or began at [start]."""
    cell = replace(AT_HOME, machine=Machine(clearance_Z=200.0))
    with pytest.raises(ProgramError, match="before the position is known"):
        read(f"G21 G90 F600\n{text}\nM2", cell)
    program = read(f"G21 G90 F600\n{text}\nM2", AT_HOME)
    assert [40.0, -4.0] in ends(program)[:, :2].tolist()
