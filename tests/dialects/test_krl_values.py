"""Values that are not known before the program runs: those that the cell gives, and constants of other files."""

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import cell as cells
from postproc.dialects import krl
from postproc.dialects.text import decode
from postproc.errors import CellError, ProgramError
from tests.dialects.krl_programs import CELL, forward, numbers, read, targets

FULL = "LIN {X 1,Y 0,Z 300,A 10,B 20,C 170}"


def given(**values):
    return replace(CELL, krl=replace(CELL.krl, values={name.replace("_IN", "$IN"): v for name, v in values.items()}))


def job(*lines, head="DEF part(lnActSt:IN)", subs=""):
    return "\n".join([head, "DECL INT lnActSt", "BAS(#INITMOV,0)", FULL, *lines, "END", ""]) + subs


BRANCH = ["IF lnActSt>1 THEN", "PTP {X 2,Y 0,Z 300,A 10,B 20,C 170}", "ENDIF"]


def test_the_cell_gives_parameters_of_the_main_program():
    assert numbers(read(job(*BRANCH), cell=given(lnActSt=2)))[:, 0].tolist() == [1, 2]
    found = read(job(*BRANCH), cell=given(LNACTST=1))
    assert numbers(found)[:, 0].tolist() == [1]
    (issue,) = (issue for issue in found.issues if issue.kind == "values-from-cell")
    assert (issue.level, "LNACTST = 1" in issue.message) == ("warning", True)
    assert not [i for i in read(job(), cell=given(lnActSt=1)).issues if i.kind == "values-from-cell"]


def test_a_value_is_converted_to_the_type_of_the_variable():
    with pytest.raises(ProgramError):
        read(job("LIN {X lnActSt*10}"), cell=given(lnActSt=1.5))
    lines = ["LIN {X lnActSt/2*10}"]
    assert numbers(read(job(*lines).replace("INT", "REAL"), cell=given(lnActSt=3)))[-1, 0] == 15


def test_the_cell_gives_inputs_and_variables_of_data_files():
    loop = ["WHILE $IN[5]", "LIN {X 2}", "ENDWHILE", "LIN {X I}"]
    data = "DEFDAT part\nDECL INT I=1\nENDDAT\n"
    values = {"$IN[5]": False, "I": 7}
    found = read(job(*loop), data, replace(CELL, krl=replace(CELL.krl, values=values)))
    assert numbers(found)[:, 0].tolist() == [1, 7]


def test_a_variable_of_a_called_routine_is_another_one():
    subs = "DEF SUB()\nDECL INT lnActSt\nWHILE lnActSt==1\nPTP {X 5,Y 0,Z 300,A 10,B 20,C 170}\nENDWHILE\nEND\n"
    with pytest.raises(ProgramError, match="not known"):
        read(job("SUB()", subs=subs), cell=given(lnActSt=1))


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        (["WHILE lnActSt>1", FULL, "ENDWHILE"], r"what lnActSt will be"),
        (["WHILE $IN[5] AND NOT $IN[lnActSt]", FULL, "ENDWHILE"], r"what \$IN\[5\], lnActSt will be"),
        (["LIN {X 1,Y 0,Z 300}", "IF $IN[5] THEN", "LIN {X 9,Y 0,Z 0,A 0,B 0,C 0}", "ENDIF", FULL], r"\[krl.values\]"),
    ],
)
def test_the_message_that_stops_names_what_the_cell_can_give(lines, named):
    with pytest.raises(ProgramError, match=named):
        read(job(*lines))


@pytest.mark.parametrize("line", ["'a b' = 1", "'X[I]' = 1", "X = 1e300", "'X.Y' = 1"])
def test_values_that_are_none_are_refused(tmp_path, line):
    text = 'robot = "kuka_kr270"\n[base]\nX = 1500\n[tool]\nZ = 350\n[start]\njoints = [0, -70, 110, 0, 50, 0]\n'
    text += "[krl.values]\n"
    (tmp_path / "cell.toml").write_text(text + "'$IN[5]' = false\nP = 1\n'Q[1,2]' = 2.5\n")
    assert cells.load(tmp_path / "cell.toml").krl.values == {"$IN[5]": False, "P": 1, "Q[1,2]": 2.5}
    (tmp_path / "cell.toml").write_text(text + line + "\n")
    with pytest.raises(CellError, match=r"krl\.values"):
        cells.load(tmp_path / "cell.toml")


@pytest.mark.parametrize("words", ["GLOBAL CONST INT", "CONST GLOBAL INT", "DECL GLOBAL CONST INT", "GLOBAL INT"])
def test_global_constants_of_another_file_are_known(tmp_path, words):
    (tmp_path / "limits.dat").write_text(f"DEFDAT limits PUBLIC\n{words} N=3\nENDDAT\n")
    source = job("FOR lnActSt=1 TO N", "LIN {X lnActSt}", "ENDFOR", head="DEF part()")
    document = replace(decode("part.src", source.encode()), folder=str(tmp_path))
    program = krl.read_program([document], replace(CELL, folder=str(tmp_path)), forward, "part")
    assert numbers(program)[1:, 0].tolist() == [1, 2, 3]
    krl.rewrite(program, targets(program, np.zeros((4, 3))))


def test_a_constant_of_a_called_routine_is_its_own():
    subs = "DEF SUB()\nCONST INT lnActSt=5\nLIN {X lnActSt}\nEND\n"
    found = read(job("lnActSt=3", "SUB()", "LIN {X lnActSt}", subs=subs))
    assert numbers(found)[1:, 0].tolist() == [5, 3]
