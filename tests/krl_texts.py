"""Text of KRL programs: the lines with which many tests begin theirs, and programs of lines."""

from __future__ import annotations

INITMOV = "BAS (#INITMOV,0 )"
BASE = "$BASE={X 1500,Y -200,Z 700,A 0,B 0,C 0}"
"""`[base]` of the sample cell."""
TOOL = "$TOOL={X 0,Y 0,Z 350,A 0,B 0,C 0}"
"""`[tool]` of the sample cell."""
SPEED = "$VEL.CP=0.05"
HOME = "PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}"
TURNED_HOME = "PTP {A1 10,A2 -80,A3 95,A4 0,A5 45,A6 0}"
"""At an angle of each axis but A4 and A6 that differs from those of `HOME`."""
FRAMES_AND_SPEED = (BASE, TOOL, SPEED)


def krl_head(*lines: str, name: str = "part") -> str:
    """Return the first line of a program and further lines."""
    return "\n".join([f"DEF {name}( )", *lines, ""])


def krl_program(*lines: str, name: str = "part") -> str:
    """Return a program of lines."""
    return krl_head(*lines, "END", name=name)


HEAD = krl_head(SPEED, "$APO.CDIS=0.5", BASE, TOOL, HOME)
"""Of a program in the sample cell, up to its first joint target."""
