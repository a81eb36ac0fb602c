"""What cannot be followed statement by statement."""

from __future__ import annotations

from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Place
from postproc.errors import ProgramError


class InexactError(ProgramError):
    """It is not known before the program runs what runs, or how often.

    :ivar routine: what was to be run; None where it is not about a call.
    """

    routine: Routine | None = None


class UnresolvedError(ProgramError):
    """What a motion needs is not known before the program runs."""


def unresolved(cause: ProgramError) -> UnresolvedError:
    """Return an error as one that says so."""
    return UnresolvedError(cause.problem, file=cause.file, line=cause.line, text=cause.text, advice=cause.advice)


def inexact(at: Place, problem: str, advice: str | None = None, routine: Routine | None = None) -> InexactError:
    """Return the error for a line at which that is not known."""
    told = at.error(problem, advice)
    error = InexactError(told.problem, file=told.file, line=told.line, text=told.text, advice=told.advice)
    error.routine = routine
    return error
