"""Which statements of a KRL program stay to the byte, and that what is written anew does what they said."""

from __future__ import annotations

import numpy as np
import pytest

from tests.correction.simulated import check_targets, simulator
from tests.corrections import correct_files
from tests.kr270 import CELL
from tests.oracle import cell_sim


def converted(*lines, dat=""):
    """Result for a program with these lines; the first of them is line 3."""
    src = "\r\n".join(["DEF part( )", "$VEL.CP=0.05", *lines, "END", ""])
    result = correct_files({"part.src": src} | ({"part.dat": f"DEFDAT part\r\n{dat}ENDDAT\r\n"} if dat else {}))
    return result, result.documents[0].text.splitlines()


POINTS = (
    "DECL E6POS XS={X 0,Y 0,Z 100,A 180,B 0,C 180}\r\n"
    "DECL E6POS XP={X 0,Y 50,Z 100,A 180,B 0,C 180}\r\n"
    "DECL POS TABLE={X 0,Y 0,Z 300,A 180,B 0,C 180}\r\n"
)


def test_a_rapid_move_after_a_corrected_one_stays_to_the_byte():
    result, lines = converted(";FORCE FX=300 FZ=200", "PTP XS", "LIN XP", "PTP XS", "SPTP Table ; away", dat=POINTS)
    assert [line for line in lines if "PTP" in line] == ["PTP XS", "PTP XS", "SPTP Table ; away"]
    assert "XS_2" not in result.documents[1].text
    assert "DECL E6POS XP={X 0,Y 50,Z 100,A 180,B 0,C 180}" not in result.documents[1].text


def test_a_rapid_move_whose_missing_numbers_were_corrected_is_completed():
    _, lines = converted(
        ";FORCE FX=300 FZ=200",
        "LIN {X 0,Y 50,Z 100,A 180,B 0,C 180}",
        "PTP {X 5}",
        "LIN {X 9,Y 50,Z 100,A 180,B 0,C 180}",
    )
    (rapid,) = [line for line in lines if line.startswith("PTP")]
    assert rapid.startswith("PTP {X 5,Y 50.0000,Z 100.0000,")


def test_a_line_that_ends_without_force_stays_and_gets_the_targets_that_its_start_needs():
    last = "LIN {X 200,Y 0,Z 150,A 180,B 0,C 180}"
    _, lines = converted(";FORCE FX=300 FZ=200", "LIN {X 100,Y 0,Z 150,A 180,B 0,C 180}", ";FORCE OFF", last)
    at = lines.index(last)
    assert lines[at - 1].startswith("LIN {X 101.0000,")  # where the force has ramped down
    assert lines[at - 2] == ";FORCE OFF"


ANGLES = [-470.0, -30.0, 150.0, 200.0, 365.0, 725.5]


@pytest.mark.parametrize("angle", ANGLES)
def test_a_circle_with_an_angle_stays_where_its_start_stays_to_the_digit(angle):
    """A force of 0.03 N bends the arm by less than the last digit: nothing of this must be written anew."""
    circle = f"CIRC {{X 110,Y 30,Z 150}},{{X 140,Y 0.0,Z 150.0}},CA {angle}"
    line = "LIN {X 80,Y 0,Z 150,A 180,B 0,C 180}"
    _, lines = converted(";FORCE FX=300 FZ=200", "LIN {X 0,Y 0,Z 150,A 180,B 0,C 180}", ";FORCE FX=0.03", line, circle)
    assert line in lines
    assert circle in lines


@pytest.mark.parametrize("angle", ANGLES)
def test_a_circle_with_an_angle_is_corrected_after_a_start_that_rounding_moves(angle):
    """The end of the first circle is rounded, because its own start is corrected: the next one is another circle."""
    x = 80.0 + 1.0 / 3.0e4
    result, lines = converted(
        ";FORCE FX=300 FZ=200",
        "LIN {X 0,Y 0,Z 150,A 180,B 0,C 180}",
        ";FORCE FX=0.03",
        f"CIRC {{X 40,Y 40,Z 150}},{{X {x:.11f},Y 0,Z 150,A 179.9999985}}",
        f"CIRC {{X 110,Y 30,Z 150}},{{X {x:.11f},Y 0.0004,Z 150.0}},CA {angle}",
        ";FORCE FX=300 FZ=200",
        f"CIRC {{X 110,Y 30,Z 150}},{{X {x:.11f},Y 0.0004,Z 150.0}},CA {angle}",
    )
    moves = cell_sim.read("\n".join(lines))
    assert not any("CA" in line for line in lines)
    check_targets(result, simulator("cell_kr270.toml"), moves, every=1)
    m = result.program.motions
    on = [np.linalg.norm(row[:2] - m.centre[2, :2]) for row in result.nominal[result.motion >= 2][:, :3, 3]]
    np.testing.assert_allclose(on, np.linalg.norm(m.target[1, :2, 3] - m.centre[2, :2]), atol=1e-8)


def test_a_base_that_is_not_that_of_the_cell_is_stated_with_its_numbers():
    def said(base):
        result, _ = converted(base, "PTP XS", "LIN XP", dat=POINTS)
        return [(issue.source_line, issue.count, issue.message) for issue in result.issues if issue.kind == "own-base"]

    here = f"$BASE={{X {CELL.base.X},Y {CELL.base.Y},Z {CELL.base.Z},A 0,B 0,C 0}}"
    assert said(here) == []
    ((line, count, message),) = said("$BASE={X 1400.5,Y -200,Z 700,A 0.25,B 0,C 0}")
    assert (line, count) == (4, 2)
    assert "{X 1400.5, Y -200, Z 700, A 0.25, B 0, C 0}" in message


def test_a_tool_that_is_not_that_of_the_cell_is_stated_with_its_numbers():
    def said(z):
        text = f"$TOOL={{X 0,Y 0,Z {z},A 0,B 0,C 0}}"
        result, _ = converted(text, "PTP XS", "LIN XP", dat=POINTS)
        return [(issue.source_line, issue.message) for issue in result.issues if issue.kind == "own-tool"]

    assert said(CELL.tool.Z) == []
    ((line, message),) = said(CELL.tool.Z - 1.5)
    assert line == 4
    assert f"Z {CELL.tool.Z - 1.5:g}" in message
