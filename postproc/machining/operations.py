"""Forces by operation or tool, from a small table instead of a material and a stock."""

from __future__ import annotations

import re

import numpy as np
from msgspec import Struct

from postproc.errors import ForceError, together
from postproc.frames import Array
from postproc.machining.process import OperationTable, Process
from postproc.machining.unseen import refuse_unseen
from postproc.program import FORCE_FRAMES, Ints, Program

_COMMENT = re.compile(r"\(([^()]*)\)|;([^\r\n]*)")
_TOOL = re.compile(r"T0*(\d+)", re.IGNORECASE)
_BLOCK = re.compile(r"N0*(\d+)", re.IGNORECASE)
_N_WORD = re.compile(r"\s*/?\s*N\s*0*(\d+)", re.IGNORECASE)
_FINISH = re.compile(r"\s*(finish|end)\b", re.IGNORECASE)
_BEGIN = re.compile(r"^\s*(?:(?:begin|start)\s+)?(?:operation|op)?\s*[:=]?\s*", re.IGNORECASE)


class OperationForces(Struct, frozen=True, eq=False):
    """One wrench for each of n cutting motions.

    :param motion: (n,) row of `Motions`.
    :param wrench: (n, 6) [N, N·m] in the axes that `frame` names; frame: (n,) place in `FORCE_FRAMES`.
    :param sigma: (n, 6) standard deviations.
    """

    motion: Ints
    wrench: Array
    frame: Ints
    sigma: Array


def by_operation(program: Program, process: Process) -> OperationForces:
    """Return the force of each cutting motion that an entry of [operations] names.

    An entry is called by a comment of the program, with which the operation begins; by a tool, T3; or by the N word of
    the block in which it begins, N120. It holds until another one begins, a comment says that it is finished, or
    the tool is changed.

    :raises ForceError: an entry names nothing in the program; there are several operations, and loops or subprograms.
    :raises ProgramError: a routine that cuts is not followed.
    """
    refuse_unseen(program)
    m = program.motions
    names = list(process.operations)
    tools = {match[1]: k for k, name in enumerate(names) if (match := _TOOL.fullmatch(name.strip()))}
    blocks = {match[1]: k for k, name in enumerate(names) if (match := _BLOCK.fullmatch(name.strip()))}
    titles = {_plain(name): k for k, name in enumerate(names) if k not in {*tools.values(), *blocks.values()}}
    starts: list[tuple[int, int]] = []
    for line, text in enumerate(program.documents[0].text.splitlines(), start=1):
        number = _N_WORD.match(text)
        if number is not None and number[1] in blocks:
            starts.append((line, blocks[number[1]]))
        if "(" not in text and ";" not in text:
            continue
        for found in _COMMENT.finditer(text):
            comment = found[1] if found[1] is not None else found[2]
            title = _plain(_BEGIN.sub("", comment, count=1))
            if title in titles or _plain(comment) in titles:
                starts.append((line, titles.get(title, titles.get(_plain(comment), -1))))
            elif _FINISH.match(comment):
                starts.append((line, -1))
    for event in program.events:
        if event.kind == "tool_change":
            starts.append((event.line, tools.get(str(int(event.value)), -1)))
    starts.sort(key=lambda start: start[0])
    region = np.searchsorted([line for line, _ in starts], m.line, side="right")
    place = np.array([-1, *(which for _, which in starts)])[region]
    used = {which for _, which in starts}
    back = np.flatnonzero(np.diff(m.line) < 0)
    if len(back) and len(set(place[~m.rapid].tolist())) > 1:
        raise ForceError(
            "the program comes back to earlier lines, by a loop or a subprogram: which motions belong to which of "
            "several operations is not certain",
            file=program.documents[0].name,
            line=int(m.line[back[0]]),
            advice="Give the stock ([material] in the process), or the forces by line in a CSV.",
        )
    unused = [name for k, name in enumerate(names) if k not in used]
    if unused:
        advice = "Name an operation as a comment of the program does, a tool as T3, or a block as N120."
        problem = "[operations.{!r}]: no comment, tool or block of {} is called so"
        file = program.documents[0].name
        raise together(ForceError(problem.format(name, file), file=process.path, advice=advice) for name in unused)
    motion = np.flatnonzero((place >= 0) & ~m.rapid)
    entries = [process.operations[name] for name in names]
    wrench = np.array([_wrench(entry) for entry in entries]).reshape(-1, 6)
    frame = np.array([FORCE_FRAMES.index(entry.frame) for entry in entries], dtype=np.int64)
    share = np.array([entry.sigma_percent / 100.0 for entry in entries])
    rows = place[motion]
    return OperationForces(motion, wrench[rows], frame[rows], np.abs(wrench[rows]) * share[rows, None])


def _plain(text: str) -> str:
    return " ".join(text.split()).casefold()


def _wrench(entry: OperationTable) -> tuple[float, ...]:
    return entry.Fx, entry.Fy, entry.Fz, entry.Mx, entry.My, entry.Mz
