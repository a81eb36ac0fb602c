"""RAPID modules for tests: pieces of their text, their cell, and short ways to read and correct them."""

from functools import cache

from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.text import decode
from postproc.under_load import RobotInCell
from tests.cells import sample
from tests.commands import convert_text
from tests.places import ABB_CELL_FILE

TOOLDATA = "PERS tooldata tMill:=[TRUE,[[0,0,350],[1,0,0,0]],[5,[0,0,100],[1,0,0,0],0,0,0]];"
WOBJ = 'TASK PERS wobjdata wPart:=[FALSE,TRUE,"",[[1500,-200,700],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];'
AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
Q = "[0,1,0,0]"
MOVE_HOME = f"MoveAbsJ [[0,10,20,0,60,0],{AXES}],v200,fine,tMill\\WObj:=wPart;"


def at(x, y, z, q=Q):
    return f"[[{x},{y},{z}],{q},[0,0,0,0],{AXES}]"


def module(code, data="", routines=""):
    body = "\n".join(f"    {line}" for line in [MOVE_HOME, *code])
    head = f"MODULE Part\n  {TOOLDATA}\n  {WOBJ}\n{data}\n{routines}\n"
    return f"{head}  PROC main()\n    ConfL\\Off;\n{body}\n  ENDPROC\nENDMODULE\n"


def tail(speed="v50", zone="z1"):
    return f",{speed},{zone},tMill\\WObj:=wPart;"


def local(text):
    return text.replace(f"  {TOOLDATA}", f"  LOCAL {TOOLDATA}").replace(
        f"  {WOBJ}", f"  LOCAL {WOBJ.removeprefix('TASK ')}"
    )


@cache
def place():
    """Return the robot in its cell."""
    cell, robot = sample(ABB_CELL_FILE.name)
    return RobotInCell.of(robot, cell)


def read(text, name="part"):
    """Read a module."""
    return RAPID.read([decode("part.mod", text.encode())], place().cell, place().forward, name)


def correct_module(folder, text, *options, code=0):
    """Return a module as it is written after its correction, or what the command prints if it fails."""
    output = convert_text(folder, "Part.mod", text, *options, code=code, cell=ABB_CELL_FILE).output
    return output if code else (folder / "out" / "Part.mod").read_bytes().decode()
