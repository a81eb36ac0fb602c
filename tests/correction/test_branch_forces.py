"""Branches that are chosen at run time must be corrected alike at their join: forces from a file may say otherwise."""

import re

import pytest

from postproc import correction, forces, robot
from tests.corrections import read_files
from tests.kr270 import CELL
from tests.krl_texts import HOME, SPEED

AT_HOME = f"DEF part()\n{HOME}\n{SPEED}\n"
BRANCHES = ("X 0,Y 0", "IF $IN[1] THEN", "X 20,Y 10", "X 30,Y 0", "ELSE", "X 20,Y -10", "X 30,Y 0", "ENDIF", "X 50,Y 0")
ONE = ("X 0,Y 0", "IF $IN[1] THEN", "X 20,Y 10", "X 0,Y 0", "ENDIF", "X 50,Y 0")


def processed(lines, rows, tmp_path, mode="convert"):
    text = AT_HOME + "".join(
        f"LIN {{{line},Z 0,A 180,B 0,C 180}}\n" if line[0] == "X" else f"{line}\n" for line in lines
    )
    table = tmp_path / "part.csv"
    table.write_text("line,Fx,Fy,Fz\n" + "".join(f"{line},{force},20,30\n" for line, force in rows.items()))
    model = robot.load(robot.find(CELL.robot))
    program = read_files({"part.src": f"{text}END\n"}, CELL, model)
    return correction.process(program, model, CELL, forces.read(table), mode)


@pytest.mark.parametrize(
    ("lines", "rows", "where"),
    [
        (BRANCHES, {4: 90, 6: 90, 7: 90, 9: 90, 10: -90, 12: 90}, (7, 10)),
        (BRANCHES, {7: 90}, (7, 10)),
        (ONE, {6: 90, 7: 90, 9: 90}, (4, 7)),
    ],
)
def test_branches_that_end_under_different_forces_are_told_with_lines_and_forces(lines, rows, where, tmp_path):
    result = processed(lines, rows, tmp_path)
    (error,) = [issue for issue in result.issues if issue.level == "error"]
    assert (error.kind, error.lines) == ("branch-forces", where)
    assert all(f"line {line}: F = (" in error.message for line in where)
    assert not processed(lines, rows, tmp_path, "predict").failed


@pytest.mark.parametrize(
    ("lines", "rows"),
    [(BRANCHES, {4: 90, 6: -50, 7: 90, 9: 10, 10: 90, 12: 9}), (ONE, {4: 90, 6: 10, 7: 90, 9: 1})],
)
def test_branches_that_end_under_one_force_are_corrected(lines, rows, tmp_path):
    result = processed(lines, rows, tmp_path)
    assert not result.failed, result.issues
    assert "IF $IN[1]" in result.documents[0].text


ROUND = "X 50,Y 50,Z 0,A {},B 0,C 180"


@pytest.mark.parametrize(("angles", "turned"), [((90, 180, -90, 0), True), ((90, 180, 90, 0), False)])
def test_a_round_of_an_endless_loop_that_turns_a6_all_the_way_is_refused(angles, turned):
    """Its second round would begin with A6 one turn farther, the fifth beyond its limit."""
    first, *_ = lines = [f"LIN {{{ROUND.format(angle)}}}\n" for angle in (0, *angles)]
    text = f"{AT_HOME}{first}; FORCE FZ=100\n{first}LOOP\n{''.join(lines[1:])}ENDLOOP\nEND\n"
    model = robot.load(robot.find(CELL.robot))
    program = read_files({"part.src": text}, CELL, model)
    errors = [issue for issue in correction.process(program, model, CELL).issues if issue.level == "error"]
    assert [error.kind for error in errors] == ["branch-joints"] * turned
    angles_of = [re.search(r"end with A6 at (-?\d+)° and (-?\d+)°", error.message) for error in errors]
    assert [float(found[2]) - float(found[1]) for found in angles_of] == [360.0] * turned
