"""Forces by operation or tool, from a small table instead of a material and a stock."""

from __future__ import annotations

import difflib
import re

import numpy as np
from msgspec import Struct

from postproc.errors import ForceError, together
from postproc.frames import Array
from postproc.machining.process import OperationTable, Process
from postproc.machining.unseen import refuse_unseen
from postproc.operations import Operation, ended, operations, title
from postproc.program import FORCE_FRAMES, Ints, Program

_TOOL = re.compile(r"T0*(\d+)", re.IGNORECASE)
_BLOCK = re.compile(r"N0*(\d+)", re.IGNORECASE)
_N_WORD = re.compile(r"\s*/?\s*N\s*0*(\d+)", re.IGNORECASE)
_FINISH = re.compile(r"(?:finish|end)\b", re.IGNORECASE)
"""Comments that name the end of an operation, or its finishing pass."""
_MOST_LISTED = 20


class OperationForces(Struct, frozen=True):
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

    An entry is named like a comment of the program, with which the operation begins (before or after its tool change);
    like a tool, T3; or like the N word of the block in which it begins, N120. It holds until the next operation that
    begins at a retract, see `postproc.operations`, or until ``finish operation: NAME`` of its own name; "finish" in any
    other comment ends nothing. Comments and blocks take precedence over tools.

    :raises ForceError: an entry matches nothing in the program; the message lists the operations found.
    :raises ProgramError: a routine that cuts is not followed.
    """
    refuse_unseen(program)
    names, found = list(process.operations), operations(program, at_retracts=True)
    tools = {int(match[1]): k for k, name in enumerate(names) if (match := _TOOL.fullmatch(name.strip()))}
    blocks = {match[1]: k for k, name in enumerate(names) if (match := _BLOCK.fullmatch(name.strip()))}
    titles = {_plain(name): k for k, name in enumerate(names) if k not in {*tools.values(), *blocks.values()}}
    changes = [event for event in program.events if event.kind == "tool_change"]
    tool_marks = [(event.before, 0, tools.get(int(event.value), -1)) for event in changes]
    name_marks = _named(program, found, titles, blocks)
    by_name = _since(name_marks, len(program.motions))
    place = np.where(by_name >= 0, by_name, _since(tool_marks, len(program.motions)))
    used = {which for _, _, which in [*tool_marks, *name_marks]}
    unused = [name for k, name in enumerate(names) if k not in used]
    if unused:
        raise together(_unmatched(program, process, name, found) for name in unused)
    motion = np.flatnonzero((place >= 0) & ~program.motions.rapid)
    entries = [process.operations[name] for name in names]
    wrench = np.array([_wrench(entry) for entry in entries]).reshape(-1, 6)
    frame = np.array([FORCE_FRAMES.index(entry.frame) for entry in entries], dtype=np.int64)
    share = np.array([entry.sigma_percent / 100.0 for entry in entries])
    rows = place[motion]
    return OperationForces(motion, wrench[rows], frame[rows], np.abs(wrench[rows]) * share[rows, None])


_Mark = tuple[int, int, int]
"""Row of the first motion, rank among marks of one row, entry that begins (−1: none)."""


def _named(
    program: Program, found: tuple[Operation, ...], titles: dict[str, int], blocks: dict[str, int]
) -> list[_Mark]:
    """Return where entries that a comment or an N word names begin and end."""
    marks = [(each.first, 1, titles.get(_plain(each.name), -1)) for each in found if not _FINISH.match(each.name)]
    running = -1
    for event in program.events:
        if event.kind != "comment":
            continue
        which = titles.get(_plain(title(event.text)), titles.get(_plain(event.text), -1))
        finished = ended(event.text)
        if which >= 0:
            marks.append((event.before, 2, which))
            running = which
        elif finished is not None and running >= 0 and titles.get(_plain(finished)) == running:
            marks.append((event.before, 0, -1))
    line = program.motions.line
    for number, text in enumerate(program.documents[0].text.splitlines() if blocks else (), start=1):
        match = _N_WORD.match(text)
        if match is not None and match[1] in blocks:
            begins = (line >= number) & (np.concatenate([[0], line[:-1]]) < number)
            marks += [(row, 3, blocks[match[1]]) for row in np.flatnonzero(begins).tolist()]
    return marks


def _since(marks: list[_Mark], count: int) -> Ints:
    """Return the entry (M,) of the last mark at or before each motion, −1 before the first mark."""
    ordered = [(-1, 0, -1), *sorted(marks)]
    last = np.searchsorted([row for row, _, _ in ordered], np.arange(count), side="right") - 1
    return np.array([which for _, _, which in ordered], dtype=np.int64)[last]


def _unmatched(program: Program, process: Process, name: str, found: tuple[Operation, ...]) -> ForceError:
    """Return the error for an entry that matches nothing in the program."""
    file = program.documents[0].name
    known = list(dict.fromkeys(each.name for each in found))
    comments = [title(event.text) for event in program.events if event.kind == "comment" and event.text.strip()]
    near = difflib.get_close_matches(_plain(name), [_plain(each) for each in [*known, *comments]], 1)
    nearest = next((each for each in [*known, *comments] if near and _plain(each) == near[0]), None)
    listed = ", ".join(f"{each!r}" for each in known[:_MOST_LISTED]) + (" …" if len(known) > _MOST_LISTED else "")
    advice = f"Did you mean {nearest!r}? " if nearest else ""
    advice += f"Operations found: {listed or 'none'}. Name an operation as its comment, a tool as T3, a block as N120."
    return ForceError(
        f"[operations.{name!r}]: no comment, tool or block of {file} has this name", file=process.path, advice=advice
    )


def _plain(text: str) -> str:
    return " ".join(text.split()).casefold()


def _wrench(entry: OperationTable) -> tuple[float, ...]:
    return entry.Fx, entry.Fy, entry.Fz, entry.Mx, entry.My, entry.Mz
