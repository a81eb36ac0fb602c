"""Calls of routines of other files that cannot be followed: under force they must not stay uncorrected.

Whether there is a force is known of comments here; of tables and processes it is where these are used
(`Program.unfollowed`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from postproc.dialects.krl.read.run import Apart, Run
from postproc.errors import ProgramError
from postproc.program import ForceNote, Unfollowed

_KEEP = "--keep-unresolved leaves motions as they are"


def refuse_noted(run: Run) -> None:
    """Refuse routines that are not followed and say which force acts in them.

    :raises ProgramError: there is one; it is about what cannot be followed.
    """
    for call in run.moved:
        force = run.analysis.of(call.module, call.routine).force
        if force is not None and run.analysis.cuts(call.module, call.routine):
            raise _loaded(run, call, f": a force comment stands in what it runs ({force})")


def refuse_loaded(run: Run, notes: Sequence[tuple[int, ForceNote]]) -> None:
    """Refuse routines that are not followed and cut under the force that holds where they are called.

    :param notes: force comments of the course, by its lines.
    :raises ProgramError: there is one; it is about what cannot be followed.
    """
    for call in run.moved:
        held = [note for line, note in notes if line < call.line][-1:]
        if held and any(held[0].wrench) and run.analysis.cuts(call.module, call.routine):
            raise _loaded(run, call, ": a force comment holds there")


def unfollowed(run: Run) -> tuple[Unfollowed, ...]:
    """Return the calls of routines that are not followed and cut."""
    return tuple(
        Unfollowed(int(run.source.shown(np.array([call.line]))[0]), _loaded(run, call))
        for call in run.moved
        if run.analysis.cuts(call.module, call.routine)
    )


def _loaded(run: Run, call: Apart, force: str = "") -> ProgramError:
    cause, at = call.cause, run.source.origin(call.line)
    where = f"{at.source.document.name}, line {at.line}"
    problem = f"{cause.problem}; {call.name}(), called in {where}, would stay uncorrected under force{force}"
    advice = cause.advice or ""
    if "--keep-unresolved" not in advice:
        advice = f"{advice} {_KEEP}.".strip()
    return ProgramError(problem, file=cause.file, line=cause.line, text=cause.text, advice=advice)
