"""Errors for control flow and values that are not known before run time."""

from __future__ import annotations

from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Place
from postproc.errors import ProgramError


class InexactError(ProgramError):
    """The branch taken, or the number of iterations, is not known before run time.

    :ivar routine: the called routine; None if the error is not about a call.
    """

    routine: Routine | None = None


class UnresolvedError(ProgramError):
    """A value that a motion depends on is not known before run time."""


def unresolved(cause: ProgramError) -> UnresolvedError:
    """Return the error as an `UnresolvedError`."""
    return UnresolvedError(cause.problem, file=cause.file, line=cause.line, text=cause.text, advice=cause.advice)


def inexact(at: Place, problem: str, advice: str | None = None, routine: Routine | None = None) -> InexactError:
    """Return the `InexactError` for a line."""
    base = at.error(problem, advice)
    error = InexactError(base.problem, file=base.file, line=base.line, text=base.text, advice=base.advice)
    error.routine = routine
    return error
