"""A KRL program that visits the poses of a plan and waits at each."""

from __future__ import annotations

from postproc.cell import Cell
from postproc.dialects.krl.write import axis_motion, document, head
from postproc.frames import DEG_PER_RAD, Array
from postproc.plan.planning import PlanResult
from postproc.program import WRENCH, Document

_SPEED_PERCENT = 10
_DECIMALS = 3


def krl_program(result: PlanResult, cell: Cell, name: str) -> Document:
    """Return the program: for each pose PTP, a halt to measure without load, one for each of the two loads.

    :param name: of the program, as KRL allows it.
    """
    lines = [
        *head(name, cell.output.controller),
        f";{len(result.plan)} poses to measure, in the order of least travel (postproc plan)",
        ";Run it in T1: ways between the poses were checked by coarse shapes only.",
        "BAS (#INITMOV,0 )",
        f"BAS (#VEL_PTP,{_SPEED_PERCENT} )",
        axis_motion(cell.start.joints, _DECIMALS),
    ]
    for row, (angles, force) in enumerate(zip(result.plan.q * DEG_PER_RAD, result.force, strict=True)):
        lines += [
            axis_motion(angles, _DECIMALS) + " ;on the way, the straight one is blocked"
            for angles in result.via[row] * DEG_PER_RAD
        ]
        if row in result.blocked:
            lines += [";THE WAY TO THE NEXT POSE IS BLOCKED: stop here, jog the robot there", "HALT"]
        lines += [
            f";configuration {row + 1}: load {_vector(force)} N, root axes, at the load point",
            f";second load {_vector(result.second_load * force)} N",
            axis_motion(angles, _DECIMALS),
            "HALT ;measure all points WITHOUT load, then put the second, small load on",
            "HALT ;measure all points WITH the second load, then put the whole load on",
            "HALT ;measure all points WITH the whole load, then take it off",
        ]
    lines.append(axis_motion(cell.start.joints, _DECIMALS))
    return document(name, lines)


def _vector(force: Array) -> str:
    return " ".join(f"{axis} {value + 0.0:.1f}" for axis, value in zip(WRENCH[:3], force, strict=True))
