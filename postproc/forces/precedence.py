"""Which source states the force of each motion, and the issues of forces that are stated and not used.

One rule: a source (a file, a process) replaces the comments of the program on the motions that it covers; comments
hold on the others; rapid moves have no force. A process refuses programs with force comments.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, zip_longest

import numpy as np

from postproc.errors import Issue
from postproc.forces.sources import Knots
from postproc.frames import any_column, norm
from postproc.program import FORCE_FRAMES, Bools, Ints, Program, distinct

_FORCE_TOLERANCE = 2e-3
"""Forces that differ by less [N, N·m] are the same: comments and files have three decimals."""
_SMALL_FORCE = 3.0
"""The largest force of a program is questioned below this [N]. It deflects a milling robot (about 1 µm/N) by a few
micrometres, a twentieth of what it repeats to; in kN, it is the force of a heavy cut."""


def combine(program: Program, source: Knots, name: str) -> tuple[Knots, list[Issue]]:
    """Return the forces of a source and, on motions that it does not cover, of the comments of a program.

    :param source: forces of the source, at places along motions.
    :param name: name of the source, for messages.
    :returns: the knots, and issues: how many motions have their force from which source, and comments that the source
        replaces by another force.
    """
    comments = comment_knots(program)
    issues = []
    cutting = ~program.motions.rapid
    has_source = np.zeros(len(cutting), dtype=np.bool_)
    has_source[source.motion] = True
    has_comment = _has_force(comments, len(cutting)) & cutting
    if has_comment.any():
        by_source, by_comment = int(np.count_nonzero(has_source & cutting)), has_comment & ~has_source
        message = (
            f"forces: {name} on {by_source} cutting moves, comments of the program on {np.count_nonzero(by_comment)}; "
            "where both state one, the comment is not used"
        )
        issues.append(program.motions.issue("info", "force-sources", message, np.flatnonzero(has_comment)))
    conflicts = _replaced_motions(source, comments, has_comment)
    if len(conflicts):
        message = f"{name} states another force than the comment of the program: the comment is not used here"
        issues.append(program.motions.issue("warning", "force-replaced", message, conflicts))
    return source.with_fallback(comments), issues


def comment_knots(program: Program) -> Knots:
    """Return the force of each motion after the first force comment, as the last comment executed before it states it.

    :raises ValueError: the reader of the program has not set the first motion of a comment.
    """
    index = _note_of_motion(program)
    motion = np.flatnonzero(index >= 0)
    values = np.array([note.wrench for note in program.notes]).reshape(len(program.notes), 6)
    frames = np.array([FORCE_FRAMES.index(note.frame) for note in program.notes], dtype=np.int64)
    return Knots.throughout(motion, values[index[motion]], frames[index[motion]])


def unused_comment_issues(program: Program) -> Iterator[Issue]:
    """Yield a warning if forces that comments state hold on no cutting move.

    A force counts as used if any comment with the same force holds on a cutting move: at branches and joins the reader
    of KRL repeats the comment that holds there. A comment also counts as used if another force follows before the next
    motion: corrected KRL keeps the comments of the program, before the comments of its pieces.
    """
    # notes that another one follows before the next motion
    is_replaced = [
        note.before == next_note.before and any(next_note.wrench) for note, next_note in pairwise(program.notes)
    ]
    stated_notes = [
        note
        for note, is_replaced_note in zip_longest(program.notes, is_replaced)
        if any(note.wrench) and not is_replaced_note
    ]
    if not stated_notes:
        return
    note_rows = distinct(_note_of_motion(program)[~program.motions.rapid])
    used_forces = {
        (program.notes[index].wrench, program.notes[index].frame) for index in note_rows[note_rows >= 0].tolist()
    }
    lines = sorted({note.line for note in stated_notes if (note.wrench, note.frame) not in used_forces})
    if lines:
        message = "a force comment that holds on no cutting move: rapid moves and moves of zero length carry no force"
        yield Issue("warning", "force-unused", message, lines[0], count=len(lines), lines=tuple(lines))


def small_force_issues(program: Program, knots: Knots) -> Iterator[Issue]:
    """Yield an issue if the largest force of the cutting moves is so small that it may be in kilonewtons."""
    size = norm(knots.wrench[:, :3])
    has_force = ~program.motions.rapid[knots.motion] & (size > 0.0)
    if has_force.any() and not any_column(knots.wrench[:, 3:] != 0.0).any() and size[has_force].max() < _SMALL_FORCE:
        row = int(np.argmax(np.where(has_force, size, 0.0)))
        message = f"the largest force is {size[row]:.2g} N: are these kN? Forces are read in newtons"
        yield program.motions.issue("warning", "force-unit", message, knots.motion[row : row + 1])


def _note_of_motion(program: Program) -> Ints:
    """Return the force comment (M,) that holds on each motion, as index of `Program.notes`; −1 before the first.

    :raises ValueError: the reader of the program has not set the first motion of a comment.
    """
    first = [note.before for note in program.notes]  # ascending: comments are in the order of execution
    if min(first, default=0) < 0:
        raise ValueError(f"the reader of {program.dialect} leaves ForceNote.before unset")
    return np.asarray(np.searchsorted(first, np.arange(len(program.motions)), side="right") - 1)


def _has_force(knots: Knots, count: int) -> Bools:
    """Return True for motions (count,) that have a knot with a wrench other than zero; `count`: number of motions."""
    has_force = np.zeros(count, dtype=np.bool_)
    has_force[knots.motion[any_column(knots.wrench != 0.0)]] = True
    return has_force


def _replaced_motions(source: Knots, comments: Knots, has_comment: Bools) -> Ints:
    """Return the motions (n,) on which a source has another force than the comment that holds there.

    :param has_comment: (M,) True where a comment states a force on a cutting move.
    """
    if not has_comment.any() or not len(source):
        return np.zeros(0, dtype=np.int64)
    # one knot of comments for each motion after the first comment: every motion of the source after it has a row
    row = np.searchsorted(comments.motion, source.motion)
    differs = any_column(np.abs(source.wrench - comments.wrench[row]) > _FORCE_TOLERANCE) | (
        source.frame != comments.frame[row]
    )
    return distinct(source.motion[differs & has_comment[source.motion]])
