"""Which cutter cuts in a RAPID module: [tools.NAME] is that of the tooldata NAME."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.text import decode
from tests.commands import convert_text, printed
from tests.dialects.rapid_reading import AXES, WOBJ, at, place
from tests.html_page import read_page
from tests.places import ABB_CELL_FILE

LENGTHS = {"tMill": 350.0, "tBall": 320.0}
CUTTERS = {
    "tMill": 'shape = "flat"\ndiameter_mm = 10.0\nflutes = 3\nrpm = 8000.0\n',
    "tBall": 'shape = "ball"\ndiameter_mm = 8.0\nflutes = 2\nrpm = 6000.0\n',
}
PROCESS = """[material]
name = "al_6082_t6_carbide"
{tools}[stock]
box = {{ X = [0, 120], Y = [0, 80], Z = [-15, 0] }}
resolution_mm = 0.5
"""
PLACES = ((-10, 20), (-10, -2), (130, -2), (130, 20))


def entries(cutters):
    """Tables of [tools]: key → tooldata of which it has the cutter."""
    return PROCESS.format(tools="".join(f"[tools.{key}]\n{CUTTERS[name]}" for key, name in cutters.items()))


def data(lengths):
    return "".join(
        f"  PERS tooldata {name}:=[TRUE,[[0,0,{length}],[1,0,0,0]],[5,[0,0,100],[1,0,0,0],0,0,0]];\n"
        for name, length in lengths.items()
    )


def slot(y, tool):
    """A slot along X, 2 mm deep, at `y`."""
    end = f"{tool}\\WObj:=wPart;\n"
    lines = [f"    MoveJ {at(-10, y, 40)},v1000,fine,{end}"]
    return "".join([*lines, *(f"    MoveL {at(x, y, z)},v20,fine,{end}" for x, z in PLACES)])


def module(code, lengths=None, routines=""):
    home = f"    MoveAbsJ [[0,10,20,0,60,0],{AXES}],v200,fine,tMill\\WObj:=wPart;\n"
    head = f"MODULE Part\n{data(lengths or LENGTHS)}  {WOBJ}\n{routines}"
    return f"{head}  PROC main()\n    ConfL\\Off;\n{home}{code}  ENDPROC\nENDMODULE\n"


def gcode(number, y):
    cuts = "".join(f"G1 X{x} Y{y} Z{z} F1200\n" for x, z in PLACES)
    return f"G21 G90\nT{number} M6\nG0 X-10 Y{y} Z40\n{cuts}M2\n"


BOTH = slot(20, "tMill") + slot(60, "tBall")


def mill_module(folder, text, process, *, name="part.mod", cell=None, code=0):
    """Return what is printed, and the largest force components in N (2, 3) below and above Y 40."""
    options = ("--overwrite", "--to", "rapid")
    said = convert_text(folder, name, text, *options, process=process, cell=cell or ABB_CELL_FILE, code=code).output
    if code:
        return said, None
    with (folder / "out" / "part.targets.csv").open() as file:
        rows = [[float(row[key] or 0.0) for key in ("Y", "Fx", "Fy", "Fz")] for row in csv.DictReader(file)]
    y, force = np.array(rows)[:, 0], np.abs(np.array(rows)[:, 1:])
    return said, np.array([force[half].max(axis=0, initial=0.0) for half in (y < 40.0, y > 40.0)])


def test_two_cutters_of_one_module_cut_as_they_do_in_modules_of_their_own(tmp_path):
    said, both = mill_module(tmp_path, module(BOTH), entries({"tMill": "tMill", "tBall": "tBall"}))
    assert "one cutter" not in said
    mill = mill_module(tmp_path, module(slot(20, "tMill")), entries({"default": "tMill"}))[1]
    ball = mill_module(tmp_path, module(slot(60, "tBall")), entries({"default": "tBall"}))[1]
    np.testing.assert_allclose(both, [mill[0], ball[1]], rtol=1e-6)
    assert (np.abs(both[1] / both[0] - 1.0) > 0.3).all(), "the cutters differ"


def test_two_cutters_of_one_module_cut_as_the_tools_of_gcode_do(tmp_path):
    both = mill_module(tmp_path, module(BOTH), entries({"tMill": "tMill", "tBall": "tBall"}))[1]
    cell = ABB_CELL_FILE.read_text() + "".join(f"\n[tools.{k}]\nZ = {z}\n" for k, z in enumerate(LENGTHS.values(), 1))
    (tmp_path / "cell.toml").write_text(cell)
    process = entries({"1": "tMill", "2": "tBall"})
    programs = [gcode(1, 20), gcode(2, 60)]
    forces = [mill_module(tmp_path, text, process, name="part.nc", cell=tmp_path / "cell.toml")[1] for text in programs]
    np.testing.assert_allclose(both, [forces[0][0], forces[1][1]], rtol=1e-3)  # written with three decimals


@pytest.mark.parametrize("cutters", [{"default": "tMill"}, {"1": "tMill"}, {"TMILL": "tMill", "default": "tMill"}])
def test_tools_of_other_lengths_that_cut_by_one_entry_are_asked_about(tmp_path, cutters):
    said, forces = mill_module(tmp_path, module(BOTH), entries(cutters))
    np.testing.assert_allclose(forces[0], forces[1], rtol=0.02)
    question = "tMill (line 11) and tBall (line 16), whose tips are 30 mm apart, both cut as"
    assert (question in said) == (len(cutters) == 1), "an entry with the name of a tool is that of no other one"
    if len(cutters) == 1:
        assert "are they one cutter? Give [tools.tMill] and [tools.tBall] if they are not." in said


@pytest.mark.parametrize(
    ("cutters", "problems"),
    [
        (["tMill"], ["part.mod:14: no cutter for tBall in", "Give [tools.tBall]; found: [tools.tMill]."]),
        (["1", "2"], ["part.mod:9: no cutter for tMill in", "part.mod:14: no cutter for tBall in"]),
        (["tMil", "tBall"], ["Give [tools.tMill]; found: [tools.tMil], [tools.tBall]."]),
        (
            ["tMil", "default"],
            ["[tools.tMil] is of no tool of part.mod", "Did you mean `tMill`? Its tools: tMill, tBall."],
        ),
        (["tMill", "TMILL"], ["[tools.TMILL] is another spelling of [tools.tMill]"]),
        (["Default"], ["[tools.Default] is another spelling of [tools.default]"]),
        (["t-mill"], ["'t-mill' is not a tool number, nor a name of RAPID tooldata"]),
    ],
)
def test_a_cutter_that_is_not_known_is_named_with_what_to_write(tmp_path, cutters, problems):
    said, _ = mill_module(tmp_path, module(BOTH), entries(dict.fromkeys(cutters, "tMill")), code=1)
    assert [text for text in problems if text not in said] == [], said


def test_a_table_for_another_program_does_no_harm_where_each_tool_has_its_own(tmp_path):
    cutters = {"tMill": "tMill", "tBall": "tBall", "tDrill": "tMill", "7": "tMill"}
    mill_module(tmp_path, module(BOTH), entries(cutters))


def test_a_parameter_is_the_tool_of_each_call(tmp_path):
    routine = f"  PROC mill(PERS tooldata t, num y)\n{slot('%', 't').replace('%', 'y')}  ENDPROC\n"
    code = "    mill tMill,20;\n    mill tBall,60;\n"
    process = entries({"tMill": "tMill", "tBall": "tBall"})
    both = mill_module(tmp_path, module(BOTH), process)[1]
    np.testing.assert_allclose(mill_module(tmp_path, module(code, routines=routine), process)[1], both, rtol=1e-6)


def test_an_element_of_an_array_needs_the_entry_for_all(tmp_path):
    tool = f"  PERS tooldata tools{{1}}:=[{data({'t': 350}).partition(':=')[2].strip()[:-1]}];\n"
    text = module(slot(20, "tools{1}"), routines=tool)
    said, _ = mill_module(tmp_path, text, entries({"tMill": "tMill", "tBall": "tBall"}), code=1)
    assert "no cutter for the tool of this move, which is no tooldata by its name. Give [tools.default]" in said


@pytest.mark.parametrize(
    ("cutters", "problem"),
    [
        (["tMill", "tBall"], "tMill and tBall are one frame, and have an entry each in"),
        (["tBall", "default"], "tMill and tBall are one frame, and only tBall has an entry in"),
    ],
)
def test_equal_tools_with_different_cutters_are_refused(tmp_path, cutters, problem):
    text = module(BOTH, lengths={"tMill": 350.0, "tBall": 350.0})
    said, _ = mill_module(tmp_path, text, entries(dict.fromkeys(cutters, "tMill")), code=1)
    assert problem in said
    assert "Measure their lengths, or give [tools.default] only." in said
    assert "one cutter" not in mill_module(tmp_path, text, entries({"default": "tMill"}))[0]


def test_names_are_those_of_the_declarations(tmp_path):
    text = module(BOTH).replace("fine,tMill", "fine,TMILL")
    program = RAPID.read([decode("part.mod", text.encode())], place().cell, place().forward, "part")
    assert program.tool_keys == (("tMill",), ("tBall",))


def test_the_set_up_asks_for_the_cutter_of_each_tool_and_writes_its_table(tmp_path):
    both = mill_module(tmp_path, module(BOTH), entries({"tMill": "tMill", "tBall": "tBall"}))[1]
    said = printed("start", tmp_path / "part.mod", "--cell", ABB_CELL_FILE, code=2)
    assert "--cutter tMill=flat,12    Cutter of tMill: shape and diameter" in said
    assert "--flutes tBall=3    Cutting edges of tBall" in said
    assert "--rpm tBall=12000" in said
    answers = ["--material", "al_6082_t6_carbide", "--stock", "X=0:120,Y=0:80,Z=-15:0"]
    answers += ["--cutter", "tMill=flat,10", "--cutter", "TBALL=ball,8"]
    answers += ["--flutes", "tMill=3", "--flutes", "tBall=2", "--rpm", "tMill=8000", "--rpm", "tBall=6000"]
    printed("start", tmp_path / "part.mod", "--cell", ABB_CELL_FILE, "-o", tmp_path / "started", *answers, "--no-open")
    text = (tmp_path / "started" / "part.process.toml").read_text()
    assert '[tools.tMill]\nshape = "flat"\ndiameter_mm = 10\nflutes = 3\nrpm = 8000\n' in text
    assert '[tools.tBall]\nshape = "ball"\ndiameter_mm = 8\nflutes = 2\nrpm = 6000\n' in text
    started = mill_module(tmp_path, module(BOTH), text)[1]
    np.testing.assert_allclose(started, both, rtol=0.1)  # other cells of the stock


def test_reports_name_the_tools_and_a_force_by_hand_may_be_of_one(tmp_path):
    process = entries({"tMill": "tMill", "tBall": "tBall"}) + "[operations.tball]\nFz = 55\nframe = 'BASE'\n"
    forces = mill_module(tmp_path, module(BOTH), process)[1]
    np.testing.assert_allclose(forces[1], [0.0, 0.0, 55.0], atol=1e-9)
    assert forces[0].min() > 10.0, "tMill has computed forces"
    rows = read_page((tmp_path / "out" / "part.report.html").read_bytes()).text("operations")
    assert rows.count("tMill") == rows.count("tBall") == 2, "name and tool of each operation"


def test_procedures_that_an_input_chooses_cut_one_after_another_from_the_start(tmp_path):
    """Each slot has the forces of a module of its own; a second pass through the first slot cuts air."""
    cell = tmp_path / "cell.toml"
    cell.write_text(f'{ABB_CELL_FILE.read_text()}\n[rapid]\nprocedures = ["one", "two", "again"]\n')
    routines = "".join(
        f"  PROC {name}()\n{slot(y, 'tMill')}  ENDPROC\n" for name, y in (("one", 20), ("two", 60), ("again", 20))
    )
    text = module(
        "    IF DInput(di1)=1 THEN\n      one;\n    ELSE\n      two;\n    ENDIF\n    again;\n", routines=routines
    )
    process = entries({"tMill": "tMill"})
    said, forces = mill_module(tmp_path, text, process, cell=cell)
    assert "goes through" not in said
    with (tmp_path / "out" / "part.targets.csv").open() as file:
        largest = {row["source_line"]: float(row["Fx"] or 0.0) for row in csv.DictReader(file)}
    again = text.splitlines().index("  PROC again()") + 1
    assert max(abs(force) for line, force in largest.items() if int(line) > again) < 1e-6
    single = mill_module(tmp_path, module(slot(20, "tMill") + slot(60, "tMill")), process)[1]
    np.testing.assert_allclose(forces, single, rtol=1e-6)
