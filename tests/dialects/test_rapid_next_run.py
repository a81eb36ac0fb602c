"""RAPID programs that leave data changed: a warning if the next run moves differently, and only then."""

from __future__ import annotations

import pytest

from tests.dialects.rapid_reading import at, module, read, tail

DATA = (
    "  PERS num nPart:=0;\n  VAR num nTurn;\n  PERS num a{3}:=[0,10,20];\n  PERS bool bFirst:=TRUE;\n"
    f"  PERS robtarget pStart:={at(0, 0, 20)};\n  PERS speeddata vCut:=[50,500,5000,1000];\n"
    '  PERS wobjdata wShift:=[FALSE,TRUE,"",[[1500,-200,700],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
)
COUNT_UP = "  PROC countUp(INOUT num nParts)\n    nParts:=nParts+1;\n  ENDPROC\n"
ROUTINES = f"""  PROC count()
    nPart:=nPart+1;
  ENDPROC
  PROC pass()
    MoveL Offs(pStart,nPart*30,0,0){tail()}
  ENDPROC
"""


def move(expression, speed="v50"):
    return f"MoveL {expression}{tail(speed)}"


PART = move("Offs(pStart,nPart*30,0,0)")
HOME = f"MoveAbsJ [[0,10,20,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]]{tail('v200')}"
FORCE = "! FORCE FX=200 FY=-150 FZ=120"


def changed_data(lines):
    """Return the message and the number of the line among `lines`, from 1, of each warning on changed data."""
    text = module(lines, DATA, COUNT_UP)
    head = text.split(lines[0])[0].count("\n")
    return [
        (issue.message.partition(": ")[2].partition(". ")[0], issue.source_line - head)
        for issue in read(text).issues
        if issue.kind == "changed-data"
    ]


@pytest.mark.parametrize(
    ("lines", "name", "line", "change_line"),
    [
        ([PART, "nPart:=nPart+1;"], "nPart", 1, 2),
        ([PART, "Incr nPart;"], "nPart", 1, 2),
        ([PART, "countUp nPart;"], "nPart", 1, 2),
        ([PART, "nPart:=GInput(giPart);"], "nPart", 1, 2),
        ([PART, "IF di1=1 THEN", "nPart:=1;", "ENDIF"], "nPart", 1, 3),
        (["nPart:=nPart+1;", PART], "nPart", 2, 1),
        ([PART, "FOR i FROM 1 TO 3 DO", "nPart:=nPart+1;", "ENDFOR"], "nPart", 1, 3),
        (["FOR i FROM 1 TO 2 DO", PART, "nPart:=nPart+1;", "ENDFOR"], "nPart", 2, 3),
        (["WHILE nPart<2 DO", PART, "nPart:=nPart+1;", "ENDWHILE"], "nPart", 2, 3),
        ([move("pStart"), "pStart.trans.x:=30;"], "pStart", 1, 2),
        (["pStart.trans.x:=pStart.trans.x+30;", move("pStart")], "pStart", 2, 1),
        ([move("Offs(pStart,a{2},0,0)"), "a{2}:=a{3};"], "a", 1, 2),
        ([move("Offs(pStart,0,0,0)", "vCut"), "vCut.v_tcp:=20;"], "vCut", 1, 2),
        ([move("pStart").replace("wPart", "wShift"), "wShift.oframe.trans.x:=30;"], "wShift", 1, 2),
        ([move("pStart"), "IF bFirst THEN", move(at(0, 10, 20)), "ENDIF", "bFirst:=FALSE;"], "bFirst", 3, 5),
        (["IF nPart=0 THEN", FORCE, "ENDIF", move("pStart"), "nPart:=nPart+1;"], "nPart", 2, 5),
        ([PART, "WHILE TRUE DO", HOME, "nPart:=nPart+1;", "ENDWHILE"], "nPart", 1, 4),
        # the fifth part only
        (["IF nPart=4 THEN", move(at(0, 10, 20)), "ENDIF", move("pStart"), "nPart:=nPart+1;"], "nPart", 2, 5),
    ],
)
def test_a_program_whose_next_run_begins_with_other_values_is_warned_of(lines, name, line, change_line):
    ((message, found_line),) = changed_data(lines)
    offset = module(lines, DATA, COUNT_UP).split(lines[0])[0].count("\n")
    assert (message, found_line) == (f"{name} (line {offset + change_line})", line)


@pytest.mark.parametrize(
    ("lines", "names"),
    [
        # a change that a later run makes only
        ([move("Offs(pStart,a{2},0,0)"), "nPart:=nPart+1;", "IF nPart=3 THEN", "a{2}:=20;", "ENDIF"], "a, nPart"),
        # the second run begins with bFirst = FALSE, and so does the third
        (
            [
                *("IF bFirst THEN", "nPart:=0;", "bFirst:=FALSE;", "ENDIF"),
                *("IF nPart=4 THEN", move(at(0, 10, 20)), "ENDIF", move("pStart"), "nPart:=nPart+1;"),
            ],
            "nPart",
        ),
    ],
)
def test_a_change_that_decides_in_a_later_run_is_warned_of(lines, names):
    (issue,) = (issue for issue in read(module(lines, DATA, COUNT_UP)).issues if issue.kind == "changed-data")
    assert issue.subject == names
    assert "a later run may move differently" in issue.message


def test_changes_of_called_routines_are_named_by_their_line():
    text = module(["pass;", "count;"], DATA, ROUTINES)
    (issue,) = (issue for issue in read(text).issues if issue.kind == "changed-data")
    lines = text.split("\n")
    assert f"nPart (line {lines.index('    nPart:=nPart+1;') + 1})" in issue.message
    assert "MoveL Offs" in lines[issue.source_line - 1]


def test_variables_of_a_module_keep_their_values_until_the_pointer_goes_to_main():
    ((message, line),) = changed_data([move("Offs(pStart,nTurn,0,0)"), "nTurn:=nTurn+1;"])
    assert message.startswith("nTurn (line ")
    assert message.endswith(", VAR: until PP to Main)")
    assert line == 1


@pytest.mark.parametrize(
    "lines",
    [
        [move("pStart"), "nPart:=nPart+1;"],
        [move("pStart"), "Incr nPart;", 'TPWrite "parts"\\Num:=nPart;'],
        [move("pStart"), "nPart:=nPart+1;", "IF nPart>=10 THEN", "nPart:=0;", "ENDIF"],
        ["nPart:=0;", PART, "nPart:=nPart+1;", PART],
        [PART, "nPart:=nPart+1;", PART, "nPart:=0;"],
        ["nPart:=0;", "WHILE nPart<2 DO", PART, "nPart:=nPart+1;", "ENDWHILE"],
        ["pStart.trans.x:=30;", move("pStart")],
        ["a{2}:=5;", move("Offs(pStart,a{2},0,0)"), "a{2}:=5;"],
        [move("pStart"), "a{2}:=5;", move("Offs(pStart,a{1},0,0)")],
        ["VAR num nLocal:=0;", move("Offs(pStart,nLocal,0,0)"), "nLocal:=5;"],
        [move("pStart"), "IF nPart>0 THEN", 'TPWrite "again";', "ENDIF", "nPart:=1;"],
    ],
)
def test_changed_data_that_do_not_change_the_next_run_are_not_warned_of(lines):
    assert changed_data(lines) == []


def test_routines_of_other_files_are_assumed_to_leave_data_as_they_are():
    assert changed_data([PART, "SpindleOff;"]) == []
    assert changed_data([PART, "IF di1=1 THEN", "SpindleOff;", "ENDIF"]) == []
    assert len(changed_data([PART, "nPart:=1;", "SpindleOff;"])) == 1


def test_a_run_that_sets_the_data_again_is_followed_once(monkeypatch):
    def next_run(*_):
        raise AssertionError

    monkeypatch.setattr("postproc.dialects.rapid.execution.Execution.next_run", next_run)
    assert changed_data(["nPart:=0;", PART, "nPart:=nPart+1;", PART]) == []
    assert changed_data([move("pStart"), "nPart:=nPart+1;"]) == []
    with pytest.raises(AssertionError):
        changed_data([PART, "nPart:=nPart+1;"])
