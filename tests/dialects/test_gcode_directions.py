"""I, J, K of G0 and G1 as the direction of the tool (G43.5), against spherical interpolation of another library."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation, Slerp

import postproc.cell
from postproc import toolpath
from postproc.cell import Rotary
from postproc.errors import PostprocError, ProgramError
from postproc.program import CIRC, LIN
from tests.dialects.gcode_reading import CELL, START_FLANGE, outcome, read

VECTOR = replace(CELL, rotary=Rotary(kind="vector"))
TOOL_ALONG_Z = "G21 G90 G17\nG43.5 H1\nG0 X0 Y0 Z9 I0 J0 K1 F600\n"


def unit(*vector):
    return np.array(vector) / np.linalg.norm(vector)


def directions(program, motion, t):
    """From the tip to the spindle, (n, 3) at places of a motion."""
    path = toolpath.segments(program, START_FLANGE)
    return -toolpath.at(program, path, np.full(len(t), motion), t).pose[:, :3, 2]


def test_the_tool_turns_the_shortest_way_between_directions_of_any_length():
    program = read(TOOL_ALONG_Z + "G1 X10 I0.3 J-.4 K2\nX40 I-.2 J.1 K.5\nM2", VECTOR)
    ways = [(unit(0, 0, 1), unit(0.3, -0.4, 2)), (unit(0.3, -0.4, 2), unit(-0.2, 0.1, 0.5))]
    for motion, (begin, end) in zip((1, 2), ways, strict=True):
        ends = directions(program, motion, np.array([1e-9, 1.0]))
        np.testing.assert_allclose(ends, [begin, end], atol=1e-8)
        axis = unit(*np.cross(begin, end))
        angle = np.arccos(begin @ end)
        slerp = Slerp([0, 1], Rotation.from_rotvec([0 * axis, angle * axis]))
        t = np.linspace(0.1, 0.9, 9)
        expected = slerp(t).apply(begin)
        along = directions(program, motion, t)
        np.testing.assert_allclose(along @ axis, 0.0, atol=1e-9)  # in the plane of both
        # evenly to a hundredth of the angle
        assert np.arccos(np.clip((along * expected).sum(axis=1), -1.0, 1.0)).max() < 0.01 * angle


def test_a_direction_stays_until_the_next_and_arcs_have_centres():
    program = read(TOOL_ALONG_Z + "G1 X10 I.1 J0 K1\nY10\nG2 X20 Y20 I10 J0\nG1 X30\nG91\nG1 X5 I0 J0 K1\nM2", VECTOR)
    assert program.motions.kind[1:].tolist() == [LIN, LIN, CIRC, LIN, LIN]
    tool = -program.motions.target[:, :3, 2]
    np.testing.assert_allclose(tool[1:5], np.tile(unit(0.1, 0, 1), (4, 1)), atol=1e-12)
    np.testing.assert_allclose(tool[5], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(program.motions.target[5, :2, 3] * 1e3, [35.0, 20.0], atol=1e-9)


def test_bulk_and_line_by_line_read_the_same():
    text = TOOL_ALONG_Z + "".join(f"G1 X{n} I{0.01 * n:.2f} J0 K1\n" for n in range(50)) + "M2"
    assert outcome(text, VECTOR, bulk=True) == outcome(text, VECTOR, bulk=False)


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("G1 X10 I0.1 K1", "without I, J or K"),
        ("G1 X10 I0 J0 K0", "no direction"),
        ("G1 X10 I.1 J0 K1\nX20 I-.1 J0 K-1", "more than 170°"),
        ("G1 X10 I0 J0 K-1", "more than 170°"),
        ("G1 X10 I1 J0 K0\nX20 I.01 J0 K-1", "away from the part"),
        ("G81 X10 Z-2 R2 I.1 J0 K1", "turn in a cycle"),
    ],
)
def test_what_is_no_direction_is_an_error(line, problem):
    with pytest.raises(ProgramError, match=problem):
        read(TOOL_ALONG_Z + line + "\nM2", VECTOR)


def test_without_the_key_the_message_names_it():
    for code in ("G43.5 H1\nG1 X10 F600", "G1 X10 I0.1 J0 K1 F600"):
        with pytest.raises(PostprocError) as caught:
            read(f"G21 G90\nG0 X0 Y0 Z9\n{code}\nM2", CELL)
        errors = getattr(caught.value, "errors", [caught.value])
        assert any('kind = "vector"' in str(error.advice) for error in errors)


def test_the_cell_takes_no_axes_with_it(tmp_path):
    path = tmp_path / "cell.toml"
    frames = 'robot = "kuka_kr270"\n[base]\nX = 1500\n[tool]\nZ = 350\n[start]\njoints = [0, -90, 90, 0, 10, 0]\n'
    path.write_text(frames + '[rotary]\nkind = "vector"\naxes = ["C"]\n', encoding="utf-8")
    with pytest.raises(PostprocError, match="axes with kind"):
        postproc.cell.load(path)
