"""Loops and routines with moves that run more than once: the text in which each move runs once, line by line."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.dialects.rapid import expansion
from postproc.errors import PostprocError
from tests.dialects.rapid_reading import MOVE_HOME, at, module, read, tail

DECLARATIONS = f"  CONST robtarget p:={at(0, 0, 20)};"


def move(x):
    return f"MoveL Offs(p,{x},0,0){tail()}"


def code_of(program):
    """Statements of the expanded module from its first routine or motion on, without blanks before them."""
    lines = [line.strip() for line in program.layout.text.splitlines()]
    return lines[4 : lines.index("ENDMODULE")]


def expanded(code, routines=""):
    """Return the expanded statements, the lines of the file of all moves and their X [mm]; the first is HOME."""
    program = read(module(code, DECLARATIONS, routines))
    x = (program.motions.target[1:, 0, 3] * 1e3).round(6).tolist()
    return program, program.motions.line[1:].tolist(), x


LOOPS = {
    "a variable below 0": (
        ["FOR i FROM -1 TO 0 DO", move("5+i"), "ENDFOR", move(9)],
        ["! i = -1", move("5+(-1)"), "! i = 0", move("5+0"), "! end", move(9)],
        [10, 10, 12],
        [4, 5, 9],
    ),
    "a fraction": (
        ["FOR nX FROM 0.25 TO 1 STEP 0.5 DO", move("nx"), "ENDFOR"],
        ["! nX = 0.25", move("0.25"), "! nX = 0.75", move("0.75"), "! end"],
        [10, 10],
        [0.25, 0.75],
    ),
    "a comment behind DO": (
        ["FOR i FROM 1 TO 2 DO ! i rounds", move("i"), "ENDFOR"],
        ["! i = 1", move("1"), "! i = 2", move("2"), "! end"],
        [10, 10],
        [1, 2],
    ),
    "a loop in a loop": (
        ["FOR i FROM 1 TO 2 DO", move("i"), "FOR k FROM 5 TO 6 DO", move("i+10*k"), "ENDFOR", "ENDFOR"],
        [
            *("! i = 1", move("1"), "! k = 5", move("1+10*5"), "! k = 6", move("1+10*6"), "! end"),
            *("! i = 2", move("2"), "! k = 5", move("2+10*5"), "! k = 6", move("2+10*6"), "! end", "! end"),
        ],
        [10, 12, 12, 10, 12, 12],
        [1, 51, 61, 2, 52, 62],
    ),
    "two loops": (
        ["FOR i FROM 1 TO 2 DO", move("i"), "ENDFOR", "FOR i FROM 3 TO 4 DO", move("i"), "ENDFOR"],
        ["! i = 1", move(1), "! i = 2", move(2), "! end", "! i = 3", move(3), "! i = 4", move(4), "! end"],
        [10, 10, 13, 13],
        [1, 2, 3, 4],
    ),
    "WHILE": (
        ["VAR num n:=2;", "WHILE n>0 DO", move("n"), "Decr n;", "ENDWHILE"],
        ["VAR num n:=2;", "! round 1", move("n"), "Decr n;", "! round 2", move("n"), "Decr n;", "! end"],
        [11, 11],
        [2, 1],
    ),
    "one line": (
        [f"FOR i FROM 1 TO 2 DO {move('i')} ENDFOR {move(9)}"],
        ["! i = 1", move("1"), "! i = 2", f"{move('2')} {move(9)}"],
        [9, 9, 9],
        [1, 2, 9],
    ),
    "a component and an option of the name": (
        ["FOR z FROM 1 TO 2 DO", f"MoveL Offs(p,z,p.trans.z,0),v50,z5\\z:=z{tail()[7:]}", "ENDFOR"],
        [
            "! z = 1", f"MoveL Offs(p,1,p.trans.z,0),v50,z5\\z:=1{tail()[7:]}",
            "! z = 2", f"MoveL Offs(p,2,p.trans.z,0),v50,z5\\z:=2{tail()[7:]}", "! end",
        ],
        [10, 10],
        [1, 2],
    ),
    "one round": (
        ["FOR i FROM 3 TO 3 DO", move("i"), "ENDFOR"], ["FOR i FROM 3 TO 3 DO", move("i"), "ENDFOR"], [10], [3],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", LOOPS)
def test_a_loop_is_written_out_line_by_line(kind):
    code, text, lines, x = LOOPS[kind]
    program, line, positions = expanded(code)
    assert code_of(program) == ["", "PROC main()", "ConfL\\Off;", MOVE_HOME, *text, "ENDPROC"]
    assert line == lines
    assert positions == x
    assert program.layout.is_plain == (kind == "one round")
    first = [number for number, text in enumerate(code, 9) if text.startswith(("FOR", "WHILE"))]
    assert [(issue.kind, issue.source_line) for issue in program.issues] == (
        [] if kind == "one round" else [("loop-expanded", first[0])]
    )
    assert all(str(number) in program.issues[0].message for number in first if kind != "one round")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_that_are_written_out_have_the_ends_and_the_indentation_of_the_module(end):
    text = module(
        ["FOR i FROM 1 TO 2 DO", "  " + move("i"), "ENDFOR"], DECLARATIONS, f"  PROC b()\n    {move(3)}\n  ENDPROC"
    )
    text = text.replace("    ENDFOR\n", "    ENDFOR\n    b;\n    b;\n")
    program = read(text.replace("\n", end))
    expected = [
        *("  PROC b()", f"    {move(3)}", "  ENDPROC", "PROC b_2()", f"    {move(3)}", "  ENDPROC", "  PROC main()"),
        *("    ConfL\\Off;", f"    {MOVE_HOME}", "    ! i = 1", f"      {move(1)}", "    ! i = 2", f"      {move(2)}"),
        *("    ! end", "    b;", "    b_2;", "  ENDPROC", "ENDMODULE", ""),
    ]
    assert program.layout.text.split(end)[4:] == expected
    assert program.layout.text.count("\n") == (0 if end == "\r" else len(expected) + 3)


CUT = "PROC cut()\n{}\nENDPROC"
CALLS = {
    "two calls": (
        ["cut;", "cut;"], CUT.format(move(1)),
        ["PROC cut()", move(1), "ENDPROC", "PROC cut_2()", move(1), "ENDPROC", "PROC main()"], ["cut;", "cut_2;"],
        [6, 6], [1, 1], "CUT",
    ),
    "a name that there is": (
        ["cut;", "cut;", "cut;"], CUT.format(move(1)) + "\nPROC cut_2()\nENDPROC",
        [
            *("PROC cut()", move(1), "ENDPROC", "PROC cut_2c()", move(1), "ENDPROC"),
            *("PROC cut_3()", move(1), "ENDPROC"),
            *("PROC cut_2()", "ENDPROC", "PROC main()"),
        ],
        ["cut;", "cut_2c;", "cut_3;"], [6, 6, 6], [1, 1, 1], "CUT",
    ),
    "a long name": (
        ["c123456789012345678901234567890;"] * 2, CUT.format(move(1)).replace("cut", "c123456789012345678901234567890"),
        [
            *("PROC c123456789012345678901234567890()", move(1), "ENDPROC"),
            *("PROC c123456789012345678901234567_2()", move(1), "ENDPROC", "PROC main()"),
        ],
        ["c123456789012345678901234567890;", "c123456789012345678901234567_2;"], [6, 6], [1, 1],
        "C123456789012345678901234567890",
    ),
    "calls in a routine that is called twice": (
        ["a;", "a;"], f"PROC a()\n{move(1)}\nb;\nENDPROC\nPROC b()\n{move(2)}\nENDPROC",
        [
            *("PROC a()", move(1), "b;", "ENDPROC", "PROC a_2()", move(1), "b_2;", "ENDPROC"),
            *("PROC b()", move(2), "ENDPROC", "PROC b_2()", move(2), "ENDPROC", "PROC main()"),
        ],
        ["a;", "a_2;"], [6, 10, 6, 10], [1, 2, 1, 2], "A, B",
    ),
    "a routine with parameters": (
        ["cut 3;", "cut 7;"], f"LOCAL PROC cut(num n)\n{move('n')}\nENDPROC",
        ["LOCAL PROC cut(num n)", move("n"), "ENDPROC", "LOCAL PROC cut_2(num n)", move("n"), "ENDPROC", "PROC main()"],
        ["cut 3;", "cut_2 7;"], [6, 6], [3, 7], "CUT",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", CALLS)
def test_a_routine_gets_a_copy_for_each_call_but_the_first(kind):
    """The message names the routines that were copied; no loop was written out."""
    code, routines, head, calls, lines, x, names = CALLS[kind]
    program, line, positions = expanded(code, routines)
    text = code_of(program)
    assert text == [*head, "ConfL\\Off;", MOVE_HOME, *calls, "ENDPROC"]
    assert line == lines
    assert positions == x
    (issue,) = program.issues
    assert issue.kind == "routine-copied"
    assert issue.message.endswith(f": {names}.")


def test_loops_and_copies_are_named_apart():
    """One line of a loop, in a routine that is called in two places: written out in both."""
    routine = f"PROC cut()\nFOR i FROM 1 TO 2 DO\n{move('i')}\nENDFOR\nENDPROC"
    program, line, x = expanded(["cut;", "cut;"], routine)
    assert x == [1, 2, 1, 2]
    assert line == [7, 7, 7, 7]
    loop, copy = program.issues
    assert (loop.kind, loop.source_line, "(line 6)" in loop.message) == ("loop-expanded", 6, True)
    assert (copy.kind, copy.message.rpartition(": ")[2]) == ("routine-copied", "CUT.")


@pytest.mark.parametrize(
    ("code", "routines", "problem", "line"),
    [
        (
            ['%"cut"%;', '%"cut"%;'],
            CUT.format(move(1)),
            "CUT needs a copy for this call, and is called by its name as text",
            12,
        ),
        (
            ["cut;", '%"cut"%;'],
            CUT.format(move(1)),
            "CUT needs a copy for this call, and is called by its name as text",
            12,
        ),
        (["FOR i FROM 1 TO 2 DO", "FOR i FROM 1 TO 2 DO", move("i"), "ENDFOR", "ENDFOR"], "", "I is the variable", 9),
        (
            ["cut 3;"],
            f"PROC cut(num n)\n{move('n')}\nIF n>0 THEN\ncut n-1;\nENDIF\nENDPROC",
            "a loop or routine with moves runs more than once",
            6,
        ),
    ],
)
def test_what_cannot_be_written_out_is_refused_at_its_line(code, routines, problem, line):
    with pytest.raises(PostprocError, match=problem) as caught:
        expanded(code, routines)
    assert caught.value.line == line
    assert caught.value.advice


def test_a_routine_that_calls_itself_once_gets_a_copy():
    routine = f"PROC cut(num n)\n{move('n')}\nIF n>0 THEN\ncut n-1;\nENDIF\nENDPROC"
    _, line, x = expanded(["cut 1;"], routine)
    assert x == [1, 0]
    assert line == [6, 6]


def test_force_comments_in_rounds_and_copies_hold_for_each():
    """A comment in the line of a move is that of this move, in each round; the line is that of the file."""
    code = ["FOR i FROM 1 TO 2 DO", f"{move('i')} ! FORCE FX=100", "ENDFOR", "cut;", "cut;"]
    program, _, _ = expanded(code, CUT.format(f"! FORCE FX=50\n{move(3)}"))
    assert [(note.before, note.line, note.wrench[0]) for note in program.notes] == [
        (1, 13, 100.0), (2, 13, 100.0), (3, 6, 50.0), (4, 6, 50.0),
    ]  # fmt: skip


def test_loops_and_calls_in_a_loop_without_end_are_expanded_in_its_one_round():
    code = [
        "WHILE TRUE DO",
        MOVE_HOME,
        "FOR i FROM 1 TO 2 DO",
        move("i"),
        "ENDFOR",
        "cut;",
        "cut;",
        "! FORCE OFF",
        "ENDWHILE",
        move(9),
    ]
    program, line, x = expanded(code, CUT.format(f"{move(3)} ! FORCE FX=50"))
    np.testing.assert_allclose(x[1:], [1, 2, 3, 3])
    assert line == [12, 14, 14, 6, 6]
    assert [(note.before, note.line) for note in program.notes] == [(4, 6), (5, 6), (6, 18)]
    assert {issue.kind for issue in program.issues} == {"loop-expanded", "routine-copied", "endless-loop"}


def test_the_variable_of_a_loop_hides_data_of_its_name_until_the_end():
    """Also without moves in the loop; data of the routine have their own value behind it."""
    for body in (["x:=x+i;"], [move("i")]):
        code = ["VAR num i:=40;", "FOR i FROM 1 TO 2 DO", *body, "ENDFOR", move("i+x")]
        program = read(module(code, f"{DECLARATIONS}\n  VAR num x:=0;"))
        assert program.motions.target[-1, 0, 3] * 1e3 == pytest.approx(43 if "x" in body[0] and ":=" in body[0] else 40)


def test_a_copied_call_and_a_move_in_one_line_are_both_of_this_line():
    _, line, x = expanded([f"cut; {move(5)}", f"cut; {move(6)}"], CUT.format(move(1)))
    assert x == [1, 5, 1, 6]
    assert line == [6, 11, 6, 12]


@pytest.mark.parametrize("limit", ["_MOST_CHARACTERS", "_MOST_PASSES"])
def test_programs_that_grow_too_long_are_refused_at_their_procedure(monkeypatch, limit):
    """The loop in a loop takes two passes, and a third that finds nothing more."""
    code = ["FOR i FROM 1 TO 2 DO", "FOR k FROM 1 TO 2 DO", move("i+k"), "ENDFOR", "ENDFOR"]
    size = len(read(module(code, DECLARATIONS)).layout.text) if limit == "_MOST_CHARACTERS" else 3
    monkeypatch.setattr(expansion, limit, size)
    read(module(code, DECLARATIONS))
    monkeypatch.setattr(expansion, limit, size - 1)
    with pytest.raises(PostprocError, match=r"too long to be written out|nested too deeply") as caught:
        read(module(code, DECLARATIONS))
    assert caught.value.text == "PROC main()"
    assert caught.value.advice
