"""Operations of a program: what is done with one tool, under one comment of the CAM system, in one `$BASE`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from msgspec import Struct

from postproc.correction import Result, Statistics, statistics
from postproc.frames import norm
from postproc.program import Ints, Program

_MOST = 60
"""More operations than this are not told apart by comments, but by tools and frames alone."""


class Operation(Struct, frozen=True):
    """A run of targets.

    :param name: comment before it, or empty.
    :param tool: number of the tool that was changed to, or of the `$TOOL` of the program (from 1); 0 = not known.
    :param first: row of its first target, `last` of its last one.
    :param line: source line of its first target.
    :param cutting: how many targets cut.
    :param before: of the tool tip if nothing is corrected, `after` with the program as written, over cutting targets.
    :param bound: 95 % bound of what remains on the part, or None.
    :param force: largest force [N].
    """

    name: str
    tool: int
    first: int
    last: int
    line: int
    cutting: int
    before: Statistics
    after: Statistics
    bound: Statistics | None
    force: float


def operations(result: Result) -> list[Operation]:
    """Return the operations that cut, in order; a program without any mark is one."""
    starts = operation_starts(result.program, result.motion)
    found = []
    for first, end in pairwise([*sorted(starts), len(result)]):
        rows = slice(first, end)
        rapid = result.rapid[rows]
        cutting = int(np.count_nonzero(~rapid))
        if not cutting:
            continue
        name, tool = starts[first]
        begin = first + int(np.argmin(rapid))
        found.append(
            Operation(
                name=name,
                tool=tool,
                first=first,
                last=end - 1,
                line=int(result.source_line[begin]),
                cutting=cutting,
                before=statistics(norm(result.deviation_before[rows]), rapid),
                after=statistics(norm(result.deviation_after[rows]), rapid),
                bound=None if result.bound is None else statistics(result.bound[rows], rapid),
                force=float(norm(result.wrench[rows, :3]).max(initial=0.0)),
            )
        )
    return found


def operation_starts(program: Program, motion: Ints) -> dict[int, tuple[str, int]]:
    """Return the rows at which operations start: row → (name, tool).

    :param motion: (K,) row of `program.motions`, never decreasing.
    """
    starts = _starts(program, motion, comments=True)
    return starts if len(starts) <= _MOST else _starts(program, motion, comments=False)


def _starts(program: Program, rows: Ints, *, comments: bool) -> dict[int, tuple[str, int]]:
    m, events = program.motions, program.events
    changes = [event for event in events if event.kind == "tool_change"]
    motion = _motions_with_other_frames(m.base, m.tool)
    told = {int(row): "" for row in motion} | {event.before: "" for event in changes}
    if comments:
        told |= {event.before: event.text.strip() for event in events if event.kind == "comment" and event.text.strip()}
    number = np.zeros(len(m) + 1, dtype=np.int64)
    for event in changes:
        number[event.before :] = int(event.value)
    if not changes:
        number[:-1] = m.tool + 1
    row = np.searchsorted(rows, np.array([0, *told], dtype=np.int64))
    names = ["", *told.values()]
    out: dict[int, tuple[str, int]] = {}
    for first, name in sorted(zip(row.tolist(), names, strict=True), key=lambda entry: entry[0]):
        if first < len(rows):
            out[first] = (name or out.get(first, ("", 0))[0], int(number[rows[first]]))
    return out


def _motions_with_other_frames(base: Ints, tool: Ints) -> Ints:
    return np.flatnonzero((np.diff(base) != 0) | (np.diff(tool) != 0)) + 1
