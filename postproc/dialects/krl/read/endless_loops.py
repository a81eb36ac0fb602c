"""A LOOP without EXIT: one iteration is corrected; it must end in the pose and state in which it began."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc.dialects.krl.course import Course, Repeated
from postproc.dialects.krl.read.motions import settings_at
from postproc.dialects.krl.read.settings import Settings
from postproc.errors import Issue, ProgramError
from postproc.frames import Array
from postproc.program import Carriage, ForceNote, Ints, Motions, Starts

_NEAR = 1e-6
"""Poses that differ by less [m, rad] count as equal."""
_ADVICE = "Begin and end each round of the LOOP in one pose, for example with a PTP to all of A1 … A6."
_SETTING_ADVICE = "Set before the LOOP what its rounds set."
_FORCE_ADVICE = "Write a force comment before the first motion of the LOOP."


def check_round(
    course: Course,
    line: Ints,
    motions: Motions,
    start: Starts,
    carriage: Carriage | None,
    notes: Sequence[tuple[int, ForceNote]],
    settings: Settings,
) -> tuple[list[Issue], tuple[tuple[int, ...], ...]]:
    """Return the issues about the LOOP without EXIT at the end of a program, and the motions before its iterations.

    The latter are the motion before the loop (−1: the start) and its last; both are empty if there is no such loop.

    :param line: (M,) lines of the motions in the trace.
    :param start: start poses of the motions, and one more after the last: the first motion of the second iteration.
    :param carriage: the linear axis that carries the robot.
    :param notes: force comments by lines of the trace.
    :param settings: settings in force, by line.
    :raises ProgramError: an iteration ends in another pose, with other settings or under another force than it began.
    """
    loop = course.endless
    if loop is None:
        return [], ()
    first, beyond = np.searchsorted(line, [loop.first, loop.last]).tolist()
    if first < beyond:
        problem = _moved(first, beyond - 1, motions, start, carriage)
        if problem:
            raise _error(course, loop, f"its round ends {problem}", _ADVICE)
        before, behind = settings_at(settings, np.array([loop.first, loop.last]))
        if before[0] != behind[0] or not all(np.array_equal(a, b) for a, b in zip(before[1:], behind[1:], strict=True)):
            raise _error(course, loop, "leaves other frames, speeds or modes than it begins with", _SETTING_ADVICE)
        _check_force(course, loop, int(line[first]), notes)
    message = "LOOP has no EXIT: one round is corrected, and is what all rounds do. What follows it is never reached."
    issues = [Issue("info", "endless-loop", message, _line(course, loop))]
    return issues, (((first - 1, beyond - 1),) if first < beyond and np.isnan(motions.joints[first, 0]) else ())


def _moved(first: int, last: int, motions: Motions, start: Starts, carriage: Carriage | None) -> str:
    """Return how the end of an iteration differs from its begin, as text; empty if it does not."""
    if carriage is not None and abs(carriage.end[last] - carriage.begin[first]) > _NEAR:
        return "with E1 elsewhere than it began"
    if not np.isnan(motions.joints[first, 0]):
        return ""  # it leads to joint angles, from wherever it starts
    begin, again = start.at(np.array([first, len(motions)]))
    if np.abs(again[:3] - begin[:3]).max() < _NEAR:
        return ""
    away = 1e3 * float(np.linalg.norm(again[:3, 3] - begin[:3, 3]))
    return f"{away:.3f} mm from where it began" if away > 1e3 * _NEAR else "in another orientation than it began"


def starts(
    course: Course, line: Ints, motions: Motions, frames: tuple[Array, Array], flange: Array, after: Ints | None
) -> Starts:
    """Return the start poses of motions, and one more: the first motion of an endless loop in its second iteration.

    :param frames: `$BASE` in the robot root and `$TOOL` in the flange frame, by the rows of motions.
    :param flange: (4, 4) in the root where the program starts.
    """
    loop, count = course.endless, len(motions)
    first, beyond = np.searchsorted(line, [loop.first, loop.last]).tolist() if loop is not None else (0, count)
    row = np.append(np.arange(count), min(first, count - 1))  # of a loop of which no motion is corrected, any
    before = np.append(np.arange(count) - 1 if after is None else after, beyond - 1)
    return Starts.of(
        (motions.base[row], motions.tool[row], *frames), lambda at: motions.target[row[at]], flange, before
    )


def _check_force(course: Course, loop: Repeated, line: int, notes: Sequence[tuple[int, ForceNote]]) -> None:
    """Refuse a loop whose first motion has another force in the second iteration.

    :param line: of its first motion.
    """
    if any(loop.first <= at <= line for at, _ in notes):
        return
    held = [[note for at, note in notes if at < until][-1:] for until in (loop.first, loop.last)]
    begin, end = ([(note.wrench, note.frame) for note in some if any(note.wrench)] for some in held)
    if begin != end:
        raise _error(course, loop, "its round ends under another force than it began with", _FORCE_ADVICE)


def _line(course: Course, loop: Repeated) -> int:
    """Return the line of a LOOP in its file, which precedes its body."""
    return course.source.origin(loop.first).line - 1


def _error(course: Course, loop: Repeated, problem: str, advice: str) -> ProgramError:
    return course.main.source.line_error(f"LOOP never ends, and {problem}", _line(course, loop), advice)
