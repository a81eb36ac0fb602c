"""Modules that the controller loads beside a RAPID program: what is read from them, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import Rapid
from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from postproc.jobs import inputs
from tests.commands import printed
from tests.dialects.rapid_reading import TOOLDATA, WOBJ, at, module, place, read, tail
from tests.places import ABB_CELL_FILE

SPEED = "  CONST speeddata vCut:=[37,500,5000,1000];\n"
TARGET = f"  PERS robtarget pHome:={at(0, 0, 60)};\n"
BESIDE = f"MODULE CalibData\n  {TOOLDATA}\n  {WOBJ}\n{SPEED}{TARGET}%s\nENDMODULE\n"
CODE = ["MoveJ pHome,v100,fine,tMill\\WObj:=wPart;", f"MoveL {at(0, 40, 20)}{tail('vCut')}"]
INT_OR_REAL = module(CODE, SPEED + TARGET)
SPLIT = INT_OR_REAL.replace(f"  {TOOLDATA}\n  {WOBJ}\n{SPEED}{TARGET}", "")


@pytest.fixture
def beside(tmp_path):
    """Return a reader of a program beside a module."""

    def program(text, routines="", files=("CalibData.mod",), without_effect=()):
        (tmp_path / "CalibData.mod").write_text(BESIDE % routines)
        rapid = Rapid(modules=list(files), without_effect=list(without_effect))
        cell = replace(place().cell, folder=str(tmp_path), rapid=rapid)
        return RAPID.read([decode("part.mod", text.encode())], cell, place().forward, "part")

    return program


def test_data_of_another_module_are_those_of_the_program(beside):
    whole, split = read(INT_OR_REAL), beside(SPLIT)
    assert np.array_equal(split.motions.target, whole.motions.target)
    assert np.array_equal(split.motions.feed, whole.motions.feed, equal_nan=True)
    assert np.array_equal(split.bases, whole.bases)
    assert np.array_equal(split.tools, whole.tools)
    assert not split.issues
    assert [document.name for document in split.documents] == ["part.mod"]


def test_without_its_module_the_data_are_refused_with_what_to_do():
    with pytest.raises(PostprocError, match="VCUT is not declared") as caught:
        read(SPLIT.replace("MoveJ pHome", f"MoveJ {at(0, 0, 60)}"))
    assert "[rapid] modules" in caught.value.advice


@pytest.mark.parametrize(
    ("routines", "call", "problem"),
    [
        ("PROC slow()\n vLocal:=2;\nENDPROC\nVAR num vLocal;", "slow;", ""),
        ("PROC slow()\n pHome.trans.z:=90;\nENDPROC", "", "PHOME is not known: SLOW may change it"),
        ("PROC slow(INOUT num n)\n n:=1;\nENDPROC", "slow z;", "Z is not known: SLOW of another file may change it"),
        ("PROC slow()\n stop_it;\nENDPROC", "slow;", "SLOW of another file may change it"),
        ("PROC slow()\n MoveJ pHome,v10,fine,tMill;\nENDPROC", "slow;", "SLOW of another file moves the robot"),
        ("PROC slow()\n VelSet 50,100;\nENDPROC", "slow;", "SLOW of another file moves the robot or changes how"),
        ("FUNC num slow()\n pHome.trans.z:=90;\n RETURN 1;\nENDFUNC", "z:=slow();", "SLOW may change it"),
        ("FUNC num slow()\n RETURN 1;\nENDFUNC", "z:=slow();", "the function SLOW gives its value at run time"),
        ("TRAP slow\n pHome.trans.z:=90;\nENDTRAP", "", "SLOW may change it"),
        ("PROC Offs()\nENDPROC", "", "has the name of an instruction or function of RAPID"),
        ("VAR num z;", "", "Z is declared in two modules, CALIBDATA and PART"),
        ("PROC slow(\nENDPROC", "", "a name is expected"),
    ],
)  # fmt: skip
def test_routines_of_another_module_are_known_but_not_followed(beside, routines, call, problem):
    move = f"MoveL Offs(pHome,0,0,-z){tail()}"
    text = SPLIT.replace("    MoveL", f"    {call}\n    {move}\n    MoveL").replace(
        "  PROC main", "VAR num z:=5;\n  PROC main"
    )
    if problem:
        with pytest.raises(PostprocError) as caught:
            beside(text, routines)
        assert problem in str(caught.value)
    else:
        program = beside(text, routines)
        assert len(program.motions) == 4
        assert not program.issues


def test_a_file_that_is_missing_and_names_that_are_twice_are_errors_of_the_cell(beside, tmp_path):
    with pytest.raises(PostprocError, match=r"\[rapid\] modules: it cannot be read"):
        beside(SPLIT, files=["Calib.mod"])
    (tmp_path / "more.mod").write_text("MODULE More\n  CONST num vCut:=1;\nENDMODULE\n")
    with pytest.raises(PostprocError, match="VCUT is declared in two of them, CALIBDATA and MORE"):
        beside(SPLIT, files=["CalibData.mod", "more.mod"])


def own_data(declaration, *calls):
    """Return a program with a declaration of its own that moves to pHome behind some calls."""
    lines = [*calls, f"MoveL Offs(pHome,0,0,-z){tail()}", *CODE]
    return module(lines, f"  {declaration}\n  VAR num z:=5;\n").replace(f"  {TOOLDATA}\n  {WOBJ}\n", "")


@pytest.mark.parametrize(
    ("routines", "call"),
    [
        ("", ""),
        ("PROC slow()\n pHome.trans.z:=90;\nENDPROC", "slow;"),
        ("PROC slow()\n clean;\nENDPROC\nLOCAL PROC clean()\n pHome.trans.z:=90;\nENDPROC", "slow;"),
        ("TRAP late\n pHome.trans.z:=90;\nENDTRAP", ""),
        ("FUNC num slow()\n pHome.trans.z:=90;\n RETURN 1;\nENDFUNC", "IF slow()=1 TPErase;"),
        ('PROC slow()\n %"clean"%;\nENDPROC\nLOCAL PROC clean()\n pHome.trans.z:=90;\nENDPROC', "slow;"),
    ],
)
def test_local_data_of_the_program_hide_those_of_another_module(beside, routines, call):
    """The other module has a pHome of its own, 40 mm away, which its routines change."""
    program = beside(own_data(f"LOCAL VAR robtarget pHome:={at(40, 0, 60)};", call), routines)
    expected = read(
        module([], SPEED)
        .replace("  PROC main", f"  VAR robtarget pHome:={at(40, 0, 60)};\n  PROC main")
        .replace("  ENDPROC", f"    MoveL Offs(pHome,0,0,-5){tail()}\n  ENDPROC")
    )
    assert np.array_equal(program.motions.target[0], expected.motions.target[0])


@pytest.mark.parametrize(
    ("routines", "call", "problem"),
    [
        # names of its own in the other module: data, routines, and a component and an option that are called like them
        ("LOCAL VAR num z:=80;\nPROC slow()\n z:=81;\nENDPROC", "slow;", ""),
        ("LOCAL PROC main()\n z:=90;\n z:=z+nLocal;\nENDPROC\nLOCAL VAR num nLocal;\nLOCAL VAR num z;", "", ""),
        ("LOCAL PROC main()\n pHome.trans.z:=90;\nENDPROC", "", "PHOME is not known: MAIN of CALIBDATA may change it"),
        ("LOCAL CONST num main:=7;\nCONST num nDeep:=main;", "z:=nDeep-2;", ""),
        ("LOCAL CONST num trans:=7;\nCONST num nDeep:=pHome.trans.z-55;", "z:=nDeep;", ""),
        ("LOCAL VAR num trans;\nPROC slow()\n pHome.trans.z:=90;\nENDPROC", "slow;", "PHOME is not known: SLOW"),
        ("LOCAL VAR num k;\nPROC slow(\\INOUT num k)\n k:=1;\nENDPROC", "slow \\k:=z;", "Z is not known: SLOW"),
        ("LOCAL PROC clean()\n z:=1;\n pHome.trans.z:=90;\nENDPROC\nPROC slow()\n clean;\nENDPROC", "slow;", "PHOME"),
        ("VAR num z;", "", "Z is declared in two modules, CALIBDATA and PART"),
    ],
)
def test_local_names_of_another_module_are_its_own(beside, routines, call, problem):
    text = own_data("", call)
    if problem:
        with pytest.raises(PostprocError) as caught:
            beside(text, routines)
        assert problem in str(caught.value)
    else:
        program = beside(text, routines)
        whole = read(own_data(f"{TOOLDATA}\n  {WOBJ}\n{SPEED}{TARGET}"))
        assert np.array_equal(program.motions.target, whole.motions.target)
        assert not program.issues


def test_a_local_routine_of_another_module_is_not_called(beside):
    text = SPLIT.replace("    MoveL", "    clean;\n    MoveL")
    with pytest.raises(PostprocError, match="CLEAN, which is in no module of this file, may change it"):
        beside(text, "LOCAL PROC clean()\nENDPROC")
    assert len(beside(text, "PROC clean()\nENDPROC").motions) == 3


def test_local_names_may_be_those_of_other_modules(beside, tmp_path):
    text = "MODULE More\n  LOCAL CONST num vCut:=1;\n  LOCAL PROC clean()\n  ENDPROC\nENDMODULE\n"
    (tmp_path / "more.mod").write_text(text)
    files = ["CalibData.mod", "more.mod"]
    program = beside(SPLIT, "LOCAL PROC clean()\nENDPROC", files)
    assert np.array_equal(program.motions.feed, read(INT_OR_REAL).motions.feed, equal_nan=True)
    hiding = module(CODE, SPEED.replace("  CONST", "  LOCAL CONST").replace("37", "21")).replace(
        f"  {TOOLDATA}\n  {WOBJ}\n", ""
    )
    assert beside(hiding, files=files).motions.feed[-1] == pytest.approx(0.021)


def test_data_of_another_module_are_never_changed(tmp_path):
    """Correct a program whose target is in another module: the move gets numbers, the module stays, predict agrees."""
    named = '\n[rapid]\nmodules = ["CalibData.mod"]\n'
    (tmp_path / "cell.toml").write_text(ABB_CELL_FILE.read_text() + named)
    text = SPLIT.replace("    MoveL", f"    ! FORCE FX=400 FY=-200 FZ=300\n    MoveL pCut{tail()}\n    MoveL")
    (tmp_path / "CalibData.mod").write_text(BESIDE % f"  CONST robtarget pCut:={at(10, 20, 20)};")
    (tmp_path / "part.mod").write_text(text)
    before = (tmp_path / "CalibData.mod").read_bytes()
    cell = str(tmp_path / "cell.toml")
    printed("convert", str(tmp_path / "part.mod"), "--cell", cell, "-o", str(tmp_path / "out"))
    assert (tmp_path / "CalibData.mod").read_bytes() == before
    written = (tmp_path / "out" / "part.mod").read_text()
    assert "pCut" not in written
    assert "MoveJ pHome,v100" in written
    assert "tooldata" not in written
    printed("predict", str(tmp_path / "out" / "part.mod"), "--cell", cell, "-o", str(tmp_path / "seen"))


def test_modules_beside_the_program_are_inputs_of_the_cell(tmp_path):
    cell = replace(place().cell, folder=str(tmp_path), rapid=Rapid(modules=["CalibData.mod"]))
    assert tmp_path / "CalibData.mod" in inputs.cell_inputs(tmp_path / "cell.toml", cell)
