"""Tool and spindle speed on each motion: from the events of the program, else from process.toml."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.errors import MOST, ForceError, together
from postproc.frames import Array
from postproc.machining.process import Process
from postproc.program import Bools, Ints, Program


class Running(Struct, frozen=True, eq=False):
    """Tool and spindle speed on each of M motions.

    :param tool: (M,) index in `keys`.
    :param keys: keys of [tools].
    :param rpm: (M,) spindle speed [1/min]; 0 while it is off.
    :param hand: (M,) 1 for M3 (clockwise seen from the spindle), −1 for M4.
    :param number: (M,) tool number of the program; −1 before the first tool change.
    """

    tool: Ints
    keys: tuple[str, ...]
    rpm: Array
    hand: NDArray[np.int64]
    number: Ints


def running(program: Program, process: Process) -> Running:
    """Return tool and spindle speed on each motion.

    :raises ForceError: a tool that cuts is not in [tools].
    """
    m = len(program.motions)
    number, rpm, hand, speed_given = np.full(m, -1), np.zeros(m), np.ones(m, dtype=np.int64), False
    for event in program.events:
        rest = slice(event.before, None)
        if event.kind == "tool_change":
            number[rest] = int(event.value)
        elif event.kind in ("spindle_on", "spindle_ccw"):
            rpm[rest], hand[rest], speed_given = event.value, 1 if event.kind == "spindle_on" else -1, True
        elif event.kind == "spindle_off":
            rpm[rest] = 0.0
    keys = tuple(process.tools)
    place = np.full(m, -1)
    for value in np.unique(number).tolist():
        found = process.tool(value) if value > 0 or str(value) in process.tools else process.tool(None)
        if found is not None:
            here = number == value
            place[here] = keys.index(found[0])
            if not speed_given and found[1].rpm is not None:
                rpm[here] = found[1].rpm
                hand[here] = 1 if found[1].spindle == "M3" else -1
    missing = (place < 0) & ~program.motions.rapid
    if missing.any():
        _refuse(program, process, number, missing)
    return Running(place, keys, rpm, hand, number)


def _refuse(program: Program, process: Process, number: Ints, missing: Bools) -> None:
    errors = []
    for value in np.unique(number[missing]).tolist()[: MOST + 1]:
        line = int(program.motions.line[np.flatnonzero(missing & (number == value))[0]])
        known = ", ".join(f"[tools.{key}]" for key in process.tools) or "none"
        if value <= 0:  # T0, and M6 without T, name no tool
            problem = "no tool number (T… M6) before this move"
            advice = f"Give [tools.default] in {process.path}; found: {known}."
        else:
            problem, advice = f"tool T{value} is not in {process.path}", f"Give [tools.{value}]; found: {known}."
        errors.append(ForceError(problem, file=program.documents[0].name, line=line, advice=advice))
    raise together(errors)
