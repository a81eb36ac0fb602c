"""Execution of RAPID, statement by statement: X of every move as a person works it out, or the message and its line."""

from __future__ import annotations

import re

import pytest

from postproc.dialects.rapid import execution
from postproc.errors import PostprocError
from tests.dialects.rapid_reading import AXES, MOVE_HOME, at, local, module, read, tail

DECLARATIONS = (
    f"  LOCAL CONST robtarget p:={at(0, 0, 20)};\n  LOCAL VAR num x:=1;\n  LOCAL VAR num y:=2;\n"
    f"  LOCAL VAR num a{{3}}:=[10,20,30];\n  LOCAL VAR bool b;\n"
    f"  LOCAL CONST jointtarget j:=[[0,10,20,0,60,0],{AXES}];\n"
    f"  LOCAL VAR robtarget r{{2}}:=[{at(1, 0, 20)},{at(2, 0, 20)}];\n"
)
FIRST_LINE = 11
"""Of the statement behind the first move, where there are no routines."""


def move(x):
    return f"MoveL Offs(p,{x},0,0){tail()}"


def read_code(code, routines=""):
    return read(local(module(code, DECLARATIONS, routines)))


def refusal(code, routines=""):
    with pytest.raises(PostprocError) as caught:
        read_code(code, routines)
    return caught.value


def positions(code, routines=""):
    """X [mm] of the moves behind the first one."""
    return (read_code(code, routines).motions.target[1:, 0, 3] * 1e3).round(6).tolist()


COURSES = {
    "Incr, Decr, Add and Clear": (
        ["Incr x;", move("x"), "Decr x;", move("x"), "Add x,y;", move("x"), "Clear x;", move("x")], "", [2, 1, 3, 0],
    ),
    "Incr of an element": (["Incr a{2};", move("a{1}"), move("a{2}"), move("a{3}")], "", [10, 21, 30]),
    "a label and EXIT": (["here:", move("x"), "EXIT;"], "", [1]),
    "RETURN of a routine": (["work;", move("y")], f"PROC work()\n{move('x')}\nRETURN;\n{move(9)}\nENDPROC", [1, 2]),
    "TEST of a text": (
        ['TEST "b"', 'CASE "a":', move(1), 'CASE "c","b":', move(2), "DEFAULT:", move(3), "ENDTEST"], "", [2],
    ),
    "a branch known before one that is not": (
        ["IF x=1 THEN", move(5), "ELSEIF di1=1 THEN", "Incr x;", "ENDIF"], "", [5],
    ),
    "what no branch behind the known ones changes": (
        ["IF x=2 THEN", "Incr y;", "ELSEIF di1=1 THEN", "Incr x;", "ENDIF", move("y")], "", [2],
    ),
    "RETURN that an input decides, at the end of the program": (["IF di1=1 RETURN;", move("x")], "", [1]),
    "FOR of no round": (["FOR i FROM 1 TO 5 STEP -1 DO", move("i"), "ENDFOR", move("x")], "", [1]),
    "FOR of step 0": (["FOR i FROM 1 TO 5 STEP 0 DO", move("i"), "ENDFOR", move("x")], "", [1]),
    "FOR that ends between two steps": (["FOR i FROM 1 TO 6 STEP 3 DO", move("i"), "ENDFOR"], "", [1, 4]),
    "FOR down between two steps": (["FOR i FROM 6 TO 1 STEP -3 DO", move("i"), "ENDFOR"], "", [6, 3]),
    "FOR of quarters": (["FOR i FROM 0.25 TO 1.6 STEP 0.5 DO", move("i"), "ENDFOR"], "", [0.25, 0.75, 1.25]),
    "FOR of whole steps from a fraction on": (
        ["FOR i FROM 1.5 TO 3.25 DO", move("i"), "ENDFOR"], "", [1.5, 2.5],
    ),
    "bounds as they were at the beginning": (
        ["FOR i FROM x TO y DO", "Add y,5;", move("i"), "ENDFOR", move("y")], "", [1, 2, 12],
    ),
    "WHILE of no round": (["WHILE x>5 DO", move(3), "ENDWHILE", move("x")], "", [1]),
    "a parameter has a copy": (
        ["work x;", move("x")], f"PROC work(num n)\nIncr n;\nIncr x;\n{move('10*n')}\nENDPROC", [20, 2],
    ),
    "an array is passed whole": (["work a;"], f"PROC work(num n{{*}})\n{move('n{3}')}\nENDPROC", [30]),
    "arguments in order, options by name": (
        ["work 5\\c:=7,6;"], f"PROC work(num a,num b\\num d\\num c)\n{move('a')}\n{move('b')}\n{move('c')}\nENDPROC",
        [5, 6, 7],
    ),
    "local data begin anew in each call": (
        ["work;", "work;"], f"PROC work()\nVAR num n:=4;\n{move('n')}\nIncr n;\nENDPROC", [4, 4],
    ),
    "local data without value are 0": (["work;"], f"PROC work()\nVAR num n;\n{move('n')}\nENDPROC", [0]),
    "local data that another value gives": (
        ["work;"], f"PROC work()\nVAR num n:=2*a{{3}};\n{move('n')}\nENDPROC", [60],
    ),
    "a routine called by its name as text": (['%"work"%;'], f"PROC work()\n{move('x')}\nENDPROC", [1]),
    "a routine of a module by its name as text": (['%"Part:work"%;'], f"PROC work()\n{move('x')}\nENDPROC", [1]),
    "a routine of another file that takes no target": (["Spin x,a{2},\\On;", move("y")], "", [2]),
    "data of a trap besides": (["x:=5;", move("x")], "TRAP t1\ny:=3;\nENDTRAP", [5]),
    "an element of a robtarget": (["r{2}.trans.x:=7;", f"MoveL r{{1}}{tail()}", f"MoveL r{{2}}{tail()}"], "", [1, 7]),
    "data that a skipped branch does not change": (["IF di1=1 THEN", "SetDO do1,x;", "ENDIF", move("x")], "", [1]),
    "a loop of input signals": (["WHILE di1=0 DO", "WaitTime x;", "ENDWHILE", move("x")], "", [1]),
    "a stop in a branch": (["IF di1=1 THEN", "Stop;", "EXIT;", "ENDIF", move("x")], "", [1]),
    "ConfJ and other settings": (["ConfJ\\Off;", "ConfL\\On;", "SingArea;", "CirPathMode;", move("x")], "", [1]),
    "an instruction of RAPID that changes its argument": (["ClkRead\\HighRes,y;", move("x")], "", [1]),
    "a handler that changes other data": (
        ["work;", move("x")], "PROC work()\nx:=5;\nERROR\ny:=3;\nTRYNEXT;\nENDPROC", [5],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", COURSES)
def test_statements_run_as_they_are_written(kind):
    code, routines, expected = COURSES[kind]
    assert positions(code, routines) == expected


def routine(*lines, name="work"):
    return "\n".join([f"PROC {name}()", *lines, "ENDPROC"])


UNKNOWN = {
    "Add of what is not known": (["Add x,di1;", move("x")], "", "X is not known: ADD changes it"),
    "Incr of what is not known": (["x:=di1;", "Incr x;", move("x")], "", "X is not known: INCR changes it"),
    "Incr of an element that there is not": (["Incr a{4};", move("a{1}")], "", "A is not known: INCR changes it"),
    "Add without a number": (["Add x;", move("x")], "", "X is not known: ADD changes it"),
    "a component that there is not": (
        ["r{1}.foo:=1;", f"MoveL r{{1}}{tail()}"], "", "R is not known: its place is not",
    ),
    "the value of another function": (["x:=CSpeedOverride();", move("x")], "", "X is not known: the function CSPEED"),
    "a branch": (
        ["IF di1=1 x:=2;", move("x")], "", "it may be changed where it is not known whether: DI1 is not declared",
    ),
    "a later branch": (
        ["IF di1=1 THEN", "Incr y;", "ELSEIF x=1 THEN", "Incr x;", "ELSE", "Stop;", "ENDIF", move("x")], "",
        "X is not known: it may be changed",
    ),
    "local data of a branch": (
        ["work;"], routine("VAR num n:=3;", "IF di1=1 Incr n;", move("n")), "N is not known: it may be changed",
    ),
    "an initial value": (["work;"], routine("VAR num n:=di1;", move("n")), "N is not known: DI1 is not declared"),
    "a parameter that is not given": (
        ["work;"], f"PROC work(\\num n)\n{move('n')}\nENDPROC", "N is not known: the call of WORK does not give it",
    ),
    "a value that is passed": (["work di1;"], f"PROC work(num n)\n{move('n')}\nENDPROC", "DI1 is not declared"),
    "an element that a routine gets": (
        ["work a{1};", move("a{2}")], "PROC work(INOUT num n)\nIncr n;\nENDPROC", "A is not known: WORK may change it",
    ),
    "an element that a routine gets twice": (
        ["work a{1},a{1};"], f"PROC work(INOUT num n,INOUT num m)\n{move('n')}\nENDPROC", "WORK may change it",
    ),
    "data of an instruction": (["ClkRead y;", move("y")], "", "Y is not known: CLKREAD may change it"),
    "an element of an instruction": (["ClkRead a{1};", move("a{3}")], "", "A is not known: CLKREAD may change it"),
    "a loop of too many rounds": (
        ["FOR i FROM 1 TO 20000 DO", "Incr x;", "ENDFOR", move("x")], "",
        "the rounds of a loop are not known: it is too long",
    ),
    "a loop of input signals": (
        ["WHILE di1=0 DO", "Incr x;", "ENDWHILE", move("x")], "",
        "the rounds of a loop are not known: DI1 is not declared",
    ),
    "GOTO": (
        ["work;", move("x")], routine("GOTO over;", "x:=9;", "over:"),
        "X is not known: WORK may change it, of which it is not known what runs: GOTO skips statements",
    ),
    "local data behind GOTO": (
        ["work;", move("x")],
        routine("VAR num x;", "GOTO over;", "up;", "over:") + "\n" + routine("Incr x;", name="up"),
        "X is not known: WORK may change it",
    ),
    "SetDataVal in a routine": (["work;", move("x")], routine('SetDataVal "y",3;'), "X is not known: SETDATAVAL may"),
    "a routine of another file": (
        ["Spin x;", move("x")], "", "X is not known: SPIN may change it",
    ),
    "an interrupt": (
        ["x:=5;", move("x")], "TRAP late\nup;\nENDTRAP\n" + routine("Incr x;", name="up"), "LATE may change it",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", UNKNOWN)
def test_what_may_have_another_value_is_not_known_and_the_message_says_why(kind):
    code, routines, words = UNKNOWN[kind]
    error = refusal(code, routines)
    assert words in error.problem
    assert error.text.startswith("MoveL")
    assert error.advice


REFUSED = {
    "a call by a name put together": (['CallByVar "work",1;'], "known at run time only", 0),
    "a call by data": (["Incr x;", "%sName%;"], "known at run time only", 1),
    "a call by a name put together, in IF": (['IF di1=1 CallByVar "work",1;'], "whether CALLBYVAR is executed", 0),
    "an instruction that moves": (["Incr x;", "SoftAct 1,10;"], "SOFTACT moves the robot or changes how it moves", 1),
    "RAISE": (["RAISE 5;"], "RAISE changes the order of execution", 0),
    "TRYNEXT": (["Incr x;", "TRYNEXT;"], "TRYNEXT changes the order of execution", 1),
    "GOTO": (["GOTO over;", "over:"], "GOTO changes the order of execution", 0),
    "VelSet of what is not known": (["Incr x;", "VelSet di1,800;"], "the speeds of VelSet are not known", 1),
    "VelSet of one number": (["VelSet 50;"], "the speeds of VelSet are not known", 0),
    "FOR of what is not known": (
        ["FOR i FROM 1 TO di1 DO", move("i"), "ENDFOR"], "the number of rounds of FOR is not known before", 0,
    ),
    "FOR of far too many": (["FOR i FROM 1 TO 1E9 DO", move("i"), "ENDFOR"], "there are too many", 0),
    "WHILE of what is not known": (["WHILE di1=0 DO", move("x"), "ENDWHILE"], "how often WHILE runs: DI1 is not", 0),
    "a move in a branch": (["IF di1=1 THEN", "Incr x;", move("x"), "ENDIF"], "whether MOVEL is executed: DI1", 2),
    "a setting in a branch": (["IF di1=1 THEN", "VelSet 50,800;", "ENDIF"], "whether VELSET is executed", 1),
    "a target for another file, in a branch": (["IF di1=1 GoThere p;"], "whether GOTHERE is executed", 0),
    "a force in a branch": (["IF di1=1 THEN", "! FORCE FX=5", "ENDIF"], "whether this force acts: DI1", 1),
    "joint angles for another file": (["GoThere j;"], "GOTHERE is in no module of this file and takes a target", 0),
    "an element for another file": (["GoThere r{2};"], "GOTHERE is in no module of this file and takes a target", 0),
    "an option with a target": (["GoThere \\Fast\\At:=p;"], "GOTHERE is in no module of this file and takes", 0),
    "numbers for another file": ([f"GoThere {at(0, 0, 1)};"], "GOTHERE is in no module of this file and takes", 0),
    **{
        f"{function} for another file": ([f"GoThere {function}(x);"], "GOTHERE is in no module of this file and", 0)
        for function in ("Offs", "RelTool", "CalcRobT", "CalcJointT", "CRobT", "CJointT", "MirPos", "ORobT")
    },
    "a second round that differs by its speeds": (
        ["WHILE TRUE DO", MOVE_HOME, move("x"), "VelSet 50,800;", "ENDWHILE"],
        "loop without end moves differently here: each round changes the settings of moves", 1,
    ),
    "a second round that differs by its data": (
        ["WHILE TRUE DO", MOVE_HOME, move("y"), "Incr y;", "ENDWHILE"],
        "loop without end moves differently here: each round changes y for the next", 2,
    ),
    "a second round that differs by local data": (
        ["VAR num n:=3;", "WHILE TRUE DO", MOVE_HOME, move("n"), "n:=n+1;", "ENDWHILE"],
        "loop without end moves differently here: each round changes n for the next", 3,
    ),
    "a second round that has other moves": (
        ["WHILE TRUE DO", MOVE_HOME, "IF x=1 THEN", MOVE_HOME, "ENDIF", "x:=3;", "ENDWHILE"],
        "loop without end moves differently here: each round changes x for the next", 3,
    ),
    "a later round that has other moves": (
        ["WHILE TRUE DO", MOVE_HOME, "IF x=5 THEN", move("x"), "ENDIF", "x:=x+1;", "ENDWHILE"],
        "loop without end may move differently here: each round changes x for the next", 3,
    ),
    "a second round that has another force": (
        ["WHILE TRUE DO", MOVE_HOME, "IF NOT b THEN", "! FORCE FX=5", "ENDIF", move("x"), "b:=TRUE;", "ENDWHILE"],
        "loop without end moves differently here: each round changes b for the next", 3,
    ),
    "a second round that is the last": (
        ["WHILE TRUE DO", MOVE_HOME, "IF x=2 RETURN;", "x:=2;", "ENDWHILE"],
        "loop without end moves differently here: each round changes x for the next", 0,
    ),
    "a second round that begins at another place": (
        ["WHILE TRUE DO", move("x"), move("y"), "ENDWHILE"], "a loop without end begins with a straight move", 0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_followed_is_refused_at_its_line(kind):
    code, words, row = REFUSED[kind]
    error = refusal(code)
    first = local(module(code, DECLARATIONS)).splitlines().index(f"    {MOVE_HOME}") + 2
    assert words in error.problem
    assert error.line == first + sum(line.count("\n") + 1 for line in code[:row])
    assert error.text == code[row]
    assert error.advice


def test_all_moves_that_are_not_known_are_named_but_of_more_than_twenty_the_first():
    error = refusal([f"MoveL q{k}{tail()}" for k in range(3)])
    assert [f"Q{k} is not declared" in text for k, text in enumerate(str(error).splitlines())] == [True] * 3
    error = refusal([f"MoveL q{k}{tail()}" for k in range(25)])
    assert "Q0 is not declared" in str(error)
    assert "Q1 " not in str(error)


def test_calls_of_routines_of_other_files_are_counted_and_named_at_the_first():
    program = read_code(["Spin 1;", "x:=Ask(2);", "Spin 2;", '%"Gone"%;', "Spin 3;", "y:=Ask(1)+Ask(3);", move(9)])
    first = int(program.motions.line[0]) + 1
    issues = [(issue.subject, issue.source_line, issue.count) for issue in program.issues]
    assert issues == [("SPIN", first, 3), ("ASK", first + 1, 3), ("GONE", first + 3, 1)]
    assert all(issue.message.startswith(f"{issue.subject} is in no module") for issue in program.issues)


def test_settings_hold_from_their_statement_on():
    """cfx 5 is the wrist behind axis 1 and axis 5 below 0, in front of the lower arm: S 7, where MoveJ heeds it."""
    target = at(1, 2, 3).replace("[0,0,0,0]", "[0,0,0,5]")
    code = [
        f"MoveJ {target}{tail()}",
        "ConfJ\\Off;",
        f"MoveJ {target}{tail()}",
        "ConfJ\\On;",
        f"MoveJ {target}{tail()}",
    ]
    assert read_code(code).motions.status.tolist() == [-1, 7, -1, 7]
    code = ["SingArea\\Wrist;", move(1), "SingArea\\Off;", move(2), "SingArea\\Wrist;", move(3), "SingArea;", move(4)]
    assert read_code(code).is_wrist_led.tolist() == [False, True, False, True, False]
    circle = f"MoveC {at(10, 10, 20)},{at(20, 0, 20)}{tail()}"
    back = f"MoveC {at(10, 10, 20)},{at(0, 0, 20)}{tail()}"
    code = [move(0), circle, "CirPathMode\\ObjectFrame;", back, "CirPathMode;", circle, "CirPathMode\\PathFrame;", back]
    assert read_code(code).turns_with_path.tolist() == [False, False, True, False, True, True]


@pytest.mark.parametrize(
    ("calls", "is_refused"), [(execution._MAX_CALL_DEPTH, False), (execution._MAX_CALL_DEPTH + 1, True)]
)  # fmt: skip
def test_calls_in_one_another_are_followed_to_a_depth(calls, is_refused):
    text = routine("Incr x;", f"IF x<{calls + 1} work;")
    if is_refused:
        error = refusal(["work;", move("x")], text)
        assert error.problem == "WORK calls itself"
        assert error.text == "PROC work()"
    else:
        assert positions(["work;", move("x")], text) == [calls + 1]


def test_a_program_that_runs_too_long_is_refused_at_the_statement(monkeypatch):
    """ConfL, HOME, FOR, four rounds, a move: 8 statements."""
    code = ["FOR i FROM 1 TO 4 DO", "Incr x;", "ENDFOR", move("x")]
    monkeypatch.setattr(execution, "MOST_STATEMENTS", 8)
    assert positions(code) == [5]
    monkeypatch.setattr(execution, "MOST_STATEMENTS", 7)
    error = refusal(code)
    assert error.problem == "the program runs for more than 7 statements"
    assert error.text == code[-1]


@pytest.mark.parametrize(
    "code",
    [["FOR i FROM 1 TO {} DO", "Incr x;", "ENDFOR"], ["WHILE x<={} DO", "Incr x;", "ENDWHILE"]],
    ids=["FOR", "WHILE"],
)
def test_loops_without_moves_are_followed_for_so_many_rounds(monkeypatch, code):
    monkeypatch.setattr(execution, "MOST_ROUNDS", 6)
    rounds = 6 if code[0].startswith("FOR") else 5  # WHILE looks at its condition once more
    assert positions([line.format(rounds) for line in code] + [move("x")]) == [rounds + 1]
    assert "it is too long" in refusal([line.format(rounds + 1) for line in code] + [move("x")]).problem


def test_a_force_in_a_function_or_in_a_routine_that_may_run_is_refused_where_it_is():
    force = "! FORCE FX=5"
    for code, routines, words in (
        (["x:=half(3);", move("y")], f"FUNC num half(num n)\n{force}\nRETURN n;\nENDFUNC", "HALF is a function"),
        (["IF di1=1 up;", move("y")], routine("up2;", name="up") + "\n" + routine(force, "up;", name="up2"), "DI1"),
        (["up;", move("y")], routine("GOTO over;", force, "over:", name="up"), "GOTO skips statements"),
    ):
        error = refusal(code, routines)
        assert re.match(f"it is not known whether this force acts: .*{words}", error.problem)
        assert error.text == force


def test_an_interrupt_that_moves_the_robot_is_refused_where_it_is_connected():
    code = ["Incr x;", "CONNECT n WITH late;", move("x")]
    error = refusal(code, f"TRAP late\nup;\nENDTRAP\n{routine(MOVE_HOME, name='up')}")
    assert error.problem == "the interrupt LATE moves the robot at a time that is not known"
    assert error.text == code[1]
    assert positions(code, "TRAP late\nIncr y;\nENDTRAP") == [2]


def test_constants_that_only_the_second_round_of_a_loop_without_end_uses_are_no_difference():
    code = [
        "y:=3;",
        "WHILE TRUE DO",
        MOVE_HOME,
        "IF b THEN",
        "y:=a{1}-7;",
        "ELSE",
        "b:=TRUE;",
        "ENDIF",
        move("y"),
        "ENDWHILE",
    ]
    assert positions(code)[1:] == [3]


def test_a_parameter_that_changes_from_round_to_round_of_a_loop_without_end_is_a_difference():
    """Its third round would differ."""
    text = "\n".join(
        ["PROC work(num n)", "WHILE TRUE DO", MOVE_HOME, "n:=n+1;", f"IF n>2 THEN\n{MOVE_HOME}\nENDIF", "ENDWHILE"]
    )
    error = refusal(["work 0;"], f"{text}\nENDPROC")
    assert (
        error.problem
        == "a later round of this loop without end may move differently here: each round changes N for the next"
    )
    assert len(read_code(["work 0;"], f"{text}\nENDPROC".replace("n:=n+1;", "")).motions) == 2
