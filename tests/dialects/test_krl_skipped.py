"""Jumps on conditions that are not known: a GOTO to the end on a fault, a RETURN from a called routine."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.dialects import krl
from postproc.errors import ProgramError
from tests.dialects.krl_programs import CELL, forward, numbers, read, targets
from tests.krl_texts import TURNED_HOME

FAULT = ["IF $IN[1] THEN", "$OUT[1]=TRUE", "GOTO FAULT", "ENDIF"]


def line(x):
    return f"LIN {{X {x},Y 20,Z 30,A 10,B 20,C 170}}"


def job(*lines, subs=""):
    return "\n".join(["DEF part()", "BAS(#INITMOV,0)", TURNED_HOME, *lines, "END", ""]) + subs


def called(*lines):
    return "\n".join(["DEF SUB()", *lines, "END", ""])


ENDS = {
    "goto before joint angles": (
        job(line(1), *FAULT, line(2), TURNED_HOME, line(3), "FAULT:", TURNED_HOME, line(4)),
        [1, 2, 3, 4],
    ),
    "goto the end": (job(line(1), *FAULT, line(2), line(3), "FAULT:"), [1, 2, 3]),
    "joint angles on the way": (job(line(1), *FAULT, line(2), TURNED_HOME, line(1), "FAULT:", line(4)), [1, 2, 1, 4]),
    "two gotos": (job(line(1), *FAULT, line(2), *FAULT, line(3), "FAULT:", TURNED_HOME), [1, 2, 3]),
    "goto where both meet": (job(line(1), *FAULT, line(2), line(1), "FAULT:", line(4)), [1, 2, 1, 4]),
    "moving on a fault": (
        job(line(1), FAULT[0], line(9), *FAULT[2:], line(2), "FAULT:", TURNED_HOME, line(4)),
        [1, 9, 2, 4],
    ),
    "return": (
        job("SUB()", TURNED_HOME, line(4), subs=called(line(1), *FAULT[:2], "RETURN", "ENDIF", line(2))),
        [1, 2, 4],
    ),
    "return where both meet": (
        job("SUB()", line(4), subs=called(line(1), FAULT[0], "RETURN", "ENDIF", line(2), line(1))),
        [1, 2, 1, 4],
    ),
    "two returns": (
        job("SUB()", TURNED_HOME, subs=called(line(1), *([FAULT[0], "RETURN", "ENDIF", line(2)] * 2))),
        [1, 2, 2],
    ),
}


@pytest.mark.parametrize("name", ENDS)
def test_what_is_skipped_on_an_unknown_condition_is_a_branch(name):
    text, expected = ENDS[name]
    program = read(text)
    cartesian = np.isnan(program.motions.joints[:, 0])
    assert numbers(program)[cartesian, 0].tolist() == expected
    wanted = targets(program, np.tile([1e-3, 0, 0], (len(program.motions), 1)))
    (written,) = krl.rewrite(program, wanted).documents
    assert written.text.count("LIN ") == text.count("LIN ")
    kept = [one for one in text.splitlines() if not one.startswith("LIN")]
    assert [one for one in written.text.splitlines() if not one.startswith("LIN")] == kept
    again = krl.read_program([written], CELL, forward, "part")
    assert numbers(again)[cartesian, 0].tolist() == [x + 1 for x in expected]


def test_what_follows_a_skipped_part_begins_where_its_branch_begins():
    program = read(job(line(1), FAULT[0], line(9), *FAULT[2:], line(2), "FAULT:", TURNED_HOME, line(4)))
    assert program.after.tolist() == [-1, 0, 1, 1, 2, 4]
    assert program.joins == ()


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (job(line(1), *FAULT, line(2), "FAULT:", line(4)), "end in different places"),
        (job(line(1), *FAULT, line(2), "FAULT:", "PTP {X 5,Y 5,Z 5,A 0,B 0,C 0}"), "end in different places"),
        (job("SUB()", line(4), subs=called(line(1), FAULT[0], "RETURN", "ENDIF", line(2))), "end in different places"),
        (
            job(line(1), *FAULT, line(2), "PTP {X 5,Y 5,Z 9,A 10,B 20,C 170}", line(1), "FAULT:", line(4)),
            "a PTP to X, Y, Z without S and T is inside a branch",
        ),
        (job(line(1), *FAULT, "LOOP", line(2), "EXIT", "FAULT:", "ENDLOOP", TURNED_HOME), "GOTO"),
        (
            job(
                line(1),
                *FAULT,
                "IF $IN[2] THEN",
                "GOTO OTHER",
                "ENDIF",
                line(2),
                "FAULT:",
                TURNED_HOME,
                "OTHER:",
                TURNED_HOME,
            ),
            "GOTO",
        ),
        (job(line(1), "AGAIN:", *FAULT[:2], "GOTO AGAIN", "ENDIF", line(2)), "GOTO"),
        (
            job(line(1), *FAULT, "$BASE=BASE_DATA[3]", line(2), "FAULT:", TURNED_HOME, line(4)),
            "differs behind the branches",
        ),
        (
            job(line(1), "; FORCE FX=9", *FAULT, "; FORCE FX=5", line(2), "FAULT:", TURNED_HOME, line(4)),
            "which force acts is not known",
        ),
    ],
)
def test_what_differs_behind_a_skipped_part_is_refused(text, problem):
    with pytest.raises(ProgramError, match=problem):
        read(text)


def test_a_linear_axis_must_not_differ_behind_a_skipped_part():
    from postproc.cell import ExternalAxis

    cell = replace(CELL, external_axes={"E1": ExternalAxis((0.0, 1.0, 0.0))})
    with pytest.raises(ProgramError):
        read(job(line(1), *FAULT, line(2), "FAULT:", TURNED_HOME), cell=cell)
