"""Modules whose main asks which procedure runs: the procedures that the cell names are corrected, each as a run."""

from __future__ import annotations

import json

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import correction, toolpath
from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from tests.attack import rapid as attack
from tests.commands import comparison, convert_text, printed
from tests.dialects.rapid_reading import MOVE_HOME, TOOLDATA, WOBJ, at, place, tail
from tests.oracle.rapid import Controller
from tests.places import ABB_CELL_FILE

DATA = f"  CONST robtarget pIn:={at(0, 0, 20)};\n  CONST robtarget pBoth:={at(40, 0, 20)};\n  VAR num count:=1;\n"
MAIN = [
    "PROC main()",
    MOVE_HOME,
    "WHILE count<=3 DO",
    "IF DInput(diTop)=1 THEN",
    "top;",
    "ELSE",
    "side;",
    "ENDIF",
    "Incr count;",
    "ENDWHILE",
    "ENDPROC",
]
TOP = [
    "PROC top()",
    f"MoveJ pIn{tail()}",
    "! FORCE FX=300 FY=-100",
    f"MoveL pBoth{tail()}",
    "rows 10;",
    "! FORCE OFF",
    f"MoveL {at(40, 0, 60)}{tail()}",
    "ENDPROC",
]
SIDE = [
    "PROC side()",
    f"MoveJ pIn{tail()}",
    "! FORCE FX=-200 FZ=150",
    f"MoveL pBoth{tail()}",
    "rows 30;",
    "! FORCE OFF",
    f"MoveL {at(40, 0, 60)}{tail()}",
    "ENDPROC",
]
ROWS = [
    *("PROC rows(num y)", "FOR i FROM 1 TO 2 DO", f"MoveL Offs(pBoth,10*i,y,0){tail()}", "ENDFOR", "ENDPROC"),
]


def module(*routines, data=DATA):
    """Return a module with routines, each a list of lines."""
    lines = [f"  {line}" for routine in routines for line in routine]
    return "\n".join(["MODULE Menu", f"  {TOOLDATA}", f"  {WOBJ}", f"{data}{lines[0]}", *lines[1:], "ENDMODULE", ""])


LINE = f"MoveL {at(0, 0, 20)}{tail()}"
MENU = module(MAIN, TOP, SIDE, ROWS)


def cell_of(*procedures):
    """Return the cell with names of procedures."""
    cell = place().cell
    output = replace(cell.output, max_correction_mm=20.0)
    return replace(cell, rapid=replace(cell.rapid, procedures=list(procedures)), output=output)


def cell_file(folder, *procedures):
    """Write a cell file with names of procedures; return its path."""
    path = folder / "cell.toml"
    path.write_text(f"{ABB_CELL_FILE.read_text()}\n[rapid]\nprocedures = {json.dumps(procedures)}\n")
    return path


def read(text, *procedures):
    """Read a module of which the cell names procedures."""
    return RAPID.read([decode("menu.mod", text.encode())], cell_of(*procedures), place().forward, "menu")


def corrected(text, *procedures):
    """Return the text of a module whose procedures are corrected."""
    program = read(text, *procedures)
    result = correction.process(program, attack.setup()[1], cell_of(*procedures))
    assert result.documents, result.issues
    return result.documents[0].text


def refusal(text, *procedures):
    """Return the error with which a module is refused."""
    with pytest.raises(PostprocError) as caught:
        read(text, *procedures)
    return str(caught.value)


def lines_of(text, name):
    """Return the lines of a procedure of a module."""
    lines = text.splitlines()
    begin = next(row for row, line in enumerate(lines) if f"PROC {name}(" in line)
    return lines[begin : lines.index("  ENDPROC", begin)]


def choice(*answers):
    """Return a function that answers an input: the answers in turn."""
    return iter(answers).__next__


def test_main_with_an_input_says_what_to_do():
    message = refusal(MENU)
    assert "menu.mod:" in message
    assert "[rapid] procedures" in message


@pytest.mark.parametrize("answers", [(True, True, False), (False, True, False), (False, False, True)])
def test_the_loaded_tool_is_on_the_path_whatever_the_input_chooses(tmp_path, answers):
    """A controller runs main with each choice, three times one after another, before and after the correction."""
    convert_text(tmp_path, "Menu.mod", MENU, cell=cell_file(tmp_path, "top", "Side"))
    written = (tmp_path / "out" / "Menu.mod").read_text()
    attack.compare(Controller(MENU, choice(*answers)).run(), Controller(written, choice(*answers)).run())


def test_the_oracle_sees_a_procedure_that_is_not_corrected():
    written = corrected(MENU, "top")
    with pytest.raises(attack.Wrong):
        attack.compare(Controller(MENU, choice(False)).run("side"), Controller(written, choice(False)).run("side"))


FIRST_MOVES = {
    "a line under force": ["! FORCE FX=300", f"MoveL {at(60, 10, 20)}{tail()}", "! FORCE OFF"],
    "a force in its line": [f"MoveL {at(60, 10, 20)}{tail()} ! FORCE FX=300"],
    "joint angles": [MOVE_HOME, f"MoveL {at(60, 10, 20)}{tail()} ! FORCE FX=300"],
    "a joint move": [f"MoveJ {at(60, 10, 20)}{tail()}", "! FORCE FX=100"],
    "no force": [f"MoveJ {at(60, 10, 20)}{tail()}", "! FORCE OFF"],
}


@pytest.mark.parametrize("kind", FIRST_MOVES)
def test_each_procedure_is_corrected_as_if_it_were_the_only_one(kind):
    """Also where the force with which the first one ends is that of the second, or would reach into it."""
    first = [
        "PROC top()",
        f"MoveJ pIn{tail()}",
        "! FORCE FX=300",
        *(f"MoveL {at(x, 0, 20)}{tail()}" for x in (40, 80)),
        "ENDPROC",
    ]
    second = ["PROC side()", *FIRST_MOVES[kind], f"MoveL {at(60, 10, 40)}{tail()}", "ENDPROC"]
    text = module(first, second)
    both = corrected(text, "top", "side")
    assert lines_of(both, "top") == lines_of(corrected(text, "top"), "top") != lines_of(text, "top")
    assert lines_of(both, "side") == lines_of(corrected(text, "side"), "side")


def test_further_procedures_begin_at_the_start_of_the_cell():
    program = read(MENU, "top", "side")
    (begin,) = np.flatnonzero(program.after[1:] < 0) + 1
    start = np.asarray(place().cell.start_joints)
    assert program.motions.joints[begin : begin + 1][0] == pytest.approx(start, abs=1e-7)
    assert program.after[begin + 1] == begin
    segments = toolpath.segments(program, place().start_flange)
    np.testing.assert_allclose(segments.start.at(np.array([begin]))[0], program.motions.target[begin], atol=1e-7)
    assert program.motions.line[begin] == MENU.splitlines().index("  PROC side()") + 1


def test_procedures_are_followed_in_the_order_of_the_cell():
    """The stock is cut in this order."""
    program = read(MENU, "side", "top")
    first = program.notes[0]
    assert first.wrench[0] == -200.0


def test_a_shared_routine_gets_a_copy_and_a_shared_target_numbers():
    written = corrected(MENU, "top", "side")
    assert "  rows 10;".strip() in [line.strip() for line in lines_of(written, "top")]
    assert "rows_2 30;" in [line.strip() for line in lines_of(written, "side")]
    assert "pBoth" not in "".join(lines_of(written, "top") + lines_of(written, "side"))
    assert f"pBoth:={at(40, 0, 20)};" in written


def test_main_and_what_it_calls_besides_stay_as_they_are():
    written = corrected(MENU, "top", "side")
    assert lines_of(written, "main") == lines_of(MENU, "main")


OUTSIDE = {
    "a procedure": ["PROC side()", "rows 30;", "ENDPROC"],
    "main": ["PROC main()", "IF DInput(diTop)=1 THEN", "top;", "ENDIF", "rows 30;", "ENDPROC"],
    "a handler": ["PROC side()", LINE, "ERROR", "rows 30;", "ENDPROC"],
    "a routine between": ["PROC side()", "between;", "ENDPROC", "PROC between()", "rows 30;", "ENDPROC"],
}


@pytest.mark.parametrize("kind", OUTSIDE)
def test_a_routine_that_is_called_where_it_is_not_corrected_stays_as_it_is_there(kind):
    """The corrected procedure calls a copy: the others would move along its corrected targets."""
    text = module(TOP, OUTSIDE[kind], ROWS)
    written = corrected(text, "top", *(["side"] if kind == "a handler" else []))
    assert lines_of(written, "rows") == lines_of(text, "rows")
    assert "rows_2 10;" in [line.strip() for line in lines_of(written, "top")]
    attack.compare(Controller(text).run("top"), Controller(written).run("top"))


def test_a_routine_whose_callers_are_not_followed_keeps_what_it_calls():
    """Both routines of `between` are copied."""
    between = ["PROC between()", "rows 30;", "ENDPROC"]
    text = module([*TOP[:-1], "between;", TOP[-1]], ["PROC side()", "between;", "ENDPROC"], between, ROWS)
    written = corrected(text, "top")
    for name in ("side", "between", "rows"):
        assert lines_of(written, name) == lines_of(text, name)
    attack.compare(Controller(text).run("top"), Controller(written).run("top"))


def test_a_routine_to_joint_angles_alone_needs_no_copy():
    home = ["PROC home()", MOVE_HOME, "ENDPROC"]
    text = module(
        ["PROC main()", "home;", "IF DInput(diTop)=1 THEN", "top;", "ENDIF", "ENDPROC"],
        home,
        ["PROC top()", "home;", *TOP[1:]],
        ROWS,
    )
    written = corrected(text, "top")
    assert "home_2" not in written
    assert "rows 10;" in [line.strip() for line in lines_of(written, "top")]


def test_names_that_the_module_does_not_have_are_those_of_others():
    text = module(["PROC main()", MOVE_HOME, f"MoveL {at(0, 0, 20)}{tail()}", "ENDPROC"])
    assert len(read(text, "top", "side").motions) == 2
    assert len(read(MENU, "top", "elsewhere").motions) == len(read(MENU, "top").motions)
    (message,) = [
        issue.message for issue in read(MENU, "top", "elsewhere", "side").issues if issue.kind == "procedures"
    ]
    assert message.endswith("from [start]: top, side.")


def proc(name, *lines):
    return [f"PROC {name}()", *lines, "ENDPROC"]


REFUSALS = {
    "parameters": ([["PROC top(num n)", LINE, "ENDPROC"], proc("side", LINE)], "has parameters", None),
    "no motions": ([proc("top", "SetDO do1,1;"), proc("side", LINE)], "PROC TOP has no motions", "PROC top()"),
    "a call of another": ([proc("top", "side;"), proc("side", LINE)], "TOP calls SIDE", "side;"),
    "no end": (
        [proc("top", "WHILE TRUE DO", MOVE_HOME, "ENDWHILE"), proc("side", LINE)], "never ends", "WHILE TRUE DO",
    ),
    "a setting that stays": (
        [proc("top", "ConfJ\\Off;", LINE), proc("side", LINE)], "leaves ConfJ", "PROC top()",
    ),
    "a force that stays": (
        [proc("top", "! FORCE FX=100", LINE), proc("side", LINE)], "ends under a force", "PROC side()",
    ),
    "data that another changes": (
        [proc("top", "count:=2;", LINE), proc("side", f"MoveL Offs(pIn,count,0,0){tail()}")],
        "TOP may change it", "MoveL Offs",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSALS)
def test_a_procedure_that_is_no_run_of_its_own_is_refused(kind):
    routines, problem, line_text = REFUSALS[kind]
    text = module(*routines)
    message = refusal(text, "top", "side")
    assert problem in message
    if line_text is not None:
        number = next(n for n, line in enumerate(text.splitlines(), 1) if line.strip().startswith(line_text))
        assert f"menu.mod:{number}:" in message


def test_a_setting_that_is_set_back_is_no_fault():
    moves = [f"MoveJ {at(0, 0, 20)}{tail()}", LINE]
    text = module(proc("top", "ConfJ\\Off;", *moves, "ConfJ\\On;"), proc("side", *moves))
    assert len(read(text, "top", "side").motions) == 5


@pytest.mark.parametrize(
    ("setting", "is_warned"),
    [
        ("ConfJ\\Off;", True), ("SingArea\\Wrist;", True), ("CirPathMode\\ObjectFrame;", True),
        ("VelSet 50,800;", True), ("VelSet nSpeed,5000;", True), ("ConfJ\\On;", False), ("SingArea\\Off;", False),
        ("ConfL\\Off;", False), ("VelSet 100,5000;", False), ("", False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("caller", ["main", "between"])
def test_settings_of_a_caller_that_is_not_followed_are_warned_of(setting, is_warned, caller):
    text = module(proc(caller, setting, "IF DInput(di1)=1 THEN", "top;", "ENDIF"), TOP, ROWS)
    issues = [issue for issue in read(text, "top").issues if issue.kind == "settings-elsewhere"]
    assert len(issues) == is_warned
    word = setting.partition(" ")[0].partition("\\")[0]
    for issue in issues:
        assert issue.source_line == text.splitlines().index(f"  {setting}") + 1
        assert f"PROC {caller.upper()} is not followed, and changes {word} for" in issue.message


def test_settings_of_a_procedure_that_calls_nothing_corrected_do_not_count():
    text = module(proc("other", "ConfJ\\Off;", LINE), TOP, ROWS)
    assert "settings-elsewhere" not in {issue.kind for issue in read(text, "top").issues}


def test_the_written_module_is_predicted_and_compared_with_the_same_cell(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cell = cell_file(tmp_path, "top", "side")
    convert_text(tmp_path, "Menu.mod", MENU, cell=cell)
    (predicted,) = json.loads(printed("predict", "out/Menu.mod", "--json", "-o", "predicted", cell=cell))["programs"]
    assert predicted["targets"] == 17, "14 targets as they were, and the inserted ones"
    summary = comparison("Menu.mod", "out/Menu.mod", cell=cell)
    assert (summary["pairs"], summary["inserted"]) == (10, 4)
    assert summary["verdict"]["state"] == "ok"
