"""Exceptions for unusable input, and `Issue` for errors and warnings at one move.

Everything the library raises on purpose derives from `PostprocError`. An exception carries its
data (file, line, text, advice), so that a caller need not parse the message. Errors at single moves
are collected as `Issue`s; one of level ``"error"`` means that no program is written.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal, Self, TypeVar

from msgspec import Struct
from msgspec.structs import replace

Level = Literal["error", "warning", "info"]
MAX_ERRORS = 20
"""Largest number of errors shown for one input; a reader may stop after as many."""


def argument(path: object) -> str:
    """Return a path as an argument to type: in double quotes if there is a blank in it.

    >>> argument("cell.toml"), argument("my cell.toml")
    ('cell.toml', '"my cell.toml"')
    """
    text = str(path)
    return f'"{text}"' if " " in text else text


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """Return a question with the valid name that is nearest to an unknown one; empty if none is near.

    >>> did_you_mean("tolerence_mm", ["tolerance_mm", "lines_per_file"])
    'Did you mean `tolerance_mm`?'
    """
    valid_name = nearest_name(name, valid)
    return "" if valid_name is None else f"Did you mean `{valid_name}`?"


def nearest_name(name: str, valid: Iterable[str]) -> str | None:
    """Return the valid name that is nearest to an unknown one; None if none is near."""
    from difflib import get_close_matches  # needed where something is wrong

    name_of_lowercase = {valid_name.lower(): valid_name for valid_name in valid}
    nearest = get_close_matches(name.lower(), name_of_lowercase, n=1, cutoff=0.7)
    if not nearest and len(name) > 3:  # a shorter word would be in many names
        nearest = [valid_name for valid_name in name_of_lowercase if name.lower() in valid_name][:1]
    return name_of_lowercase[nearest[0]] if nearest else None


def choices(name: str, valid: Iterable[str], heading: str = "Valid names") -> str:
    """Return the advice for an unknown name: the nearest valid one as a question, then all valid ones.

    >>> choices("FEDE", ["BASE", "TOOL", "FEED"], "Valid frames")
    'Did you mean `FEED`? Valid frames: BASE, TOOL, FEED.'
    """
    names = list(valid)
    return f"{did_you_mean(name, names)} {heading}: {', '.join(names)}.".lstrip()


def first_of(names: Sequence[str], limit: int) -> str:
    """Return the first names of a list in words, and how many more there are.

    >>> first_of(["P1", "P2", "P3"], 2), first_of(["P1", "P2"], 2)
    ('P1, P2 and 1 more', 'P1, P2')
    """
    suffix = f" and {len(names) - limit} more" if len(names) > limit else ""
    return f"{', '.join(names[:limit])}{suffix}"


def line_names(lines: Sequence[int], limit: int) -> str:
    """Return numbers of lines in words.

    >>> line_names([6], 2), line_names([6, 8, 9], 2)
    ('line 6', 'lines 6, 8 and 1 more')
    """
    return f"line{'s' if len(lines) > 1 else ''} {first_of(list(map(str, lines)), limit)}"


class PostprocError(Exception):
    """Base of all exceptions of this package; pickling keeps all attributes."""

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle by message and attributes, whatever the constructor takes."""
        return _rebuild, (type(self), self.args, vars(self))


def _rebuild(kind: type[PostprocError], args: tuple[object, ...], attributes: dict[str, object]) -> PostprocError:
    """Return an error as `pickle` restores it: its `__init__` takes other arguments than `args`."""
    error = kind.__new__(kind, *args)
    vars(error).update(attributes)
    return error


class InputError(PostprocError):
    """A file, a line or a value cannot be used.

    The message reads ``file:line: problem. Text: '…'. Advice.``; every part is an attribute too. Further
    errors of the same input (`further_errors`, see `combined_error`) follow, each on its own line.

    :param problem: description of the error, without a full stop.
    :param file: name of the file as the user knows it.
    :param line: 1-based line in that file.
    :param text: the text found there.
    :param advice: what the user can do.
    :param further_errors: further errors of the same input, in order of lines.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | None = None,
        line: int | None = None,
        text: str | None = None,
        advice: str | None = None,
        further_errors: Sequence[InputError] = (),
    ) -> None:
        self.problem, self.file, self.line, self.text, self.advice = problem, file, line, text, advice
        self.further_errors = tuple(further_errors)
        place = _place(file, line)
        quotation = "" if text is None else f" Text: {text.strip()[:160]!r}."
        first_message = f"{place}{problem}.{quotation}{'' if advice is None else ' ' + advice}"
        messages = [first_message, *map(str, self.further_errors[: MAX_ERRORS - 1])]
        if len(self.further_errors) >= MAX_ERRORS:
            messages.append(f"There are more errors: these are the first {MAX_ERRORS}.")
        super().__init__("\n".join(messages))

    def with_file(self, name: str, path: str) -> Self:
        """Return the same error with file `path` where it says `name`, in all `further_errors` too."""
        return type(self)(
            self.problem,
            file=path if self.file == name else self.file,
            line=self.line,
            text=self.text,
            advice=self.advice,
            further_errors=[error.with_file(name, path) for error in self.further_errors],
        )


def _place(file: str | None, line: int | None) -> str:
    """Return the beginning of a message that names file and line, such as ``"part.nc:12: "``; empty without both."""
    if file is None:
        return "" if line is None else f"line {line}: "
    return f"{file}: " if line is None else f"{file}:{line}: "


AnyInputError = TypeVar("AnyInputError", bound=InputError)


def combined_error(errors: Iterable[AnyInputError]) -> AnyInputError:
    """Return all errors of one input as one: the first in order of lines, with the others as `further_errors`.

    :param errors: at least one, in any order and without others of their own; those of one file follow each other, in
        the order in which files are first named. Of equal ones the first counts.
    """
    unique: dict[str, AnyInputError] = {}
    for error in errors:
        unique.setdefault(str(error), error)
    distinct = list(unique.values())
    files = list(dict.fromkeys(error.file for error in distinct))
    first, *later_errors = sorted(distinct, key=lambda error: (files.index(error.file), error.line or 0))
    if not later_errors:
        return first
    return type(first)(
        first.problem,
        file=first.file,
        line=first.line,
        text=first.text,
        advice=first.advice,
        further_errors=later_errors,
    )


class ProgramError(InputError):
    """A program cannot be read: not understood, incomplete, or not what its extension says."""


class SubprogramError(ProgramError):
    """A file that only other programs call: there is nothing in it to be converted by itself."""


class OptionError(InputError):
    """A value of an option that the command does not take: wrong usage, exit code 2 on the command line."""


class CellError(InputError):
    """A cell file is unusable."""


class ForceError(InputError):
    """A force file or a force comment is unusable."""


class ModelError(InputError):
    """A robot model folder is unusable."""


class MeasurementError(InputError):
    """Measurements or the description of an experiment are unusable; the advice says what to measure or correct."""


class PlanError(InputError):
    """No plan is possible: constraints that exclude each other, a load that shows nothing, no forces."""


class NotConvergedError(PostprocError):
    """An iteration did not reach its tolerance; `rows` are the samples concerned."""

    def __init__(self, message: str, rows: Iterable[int]) -> None:
        super().__init__(message)
        self.rows = tuple(rows)


class Issue(Struct, frozen=True):
    """An error, warning or piece of information about one move.

    :param level: ``"error"`` (no program is written), ``"warning"`` or ``"info"``.
    :param kind: short stable name, e.g. ``"joint-limit"``; issues of one kind and subject are grouped.
    :param message: one sentence for the user.
    :param source_line: 1-based line of the input program, if there is one.
    :param output_line: 1-based line of the written program, if there is one.
    :param count: number of places covered by this issue after grouping.
    :param subject: the name or value that the message is about (a program that is called, a code), where issues of one
        kind may be about several; empty where there is but one.
    :param lines: all lines of the input program that it is about, ascending; empty: none, or `source_line` alone.
    """

    level: Level
    kind: str
    message: str
    source_line: int | None = None
    output_line: int | None = None
    count: int = 1
    subject: str = ""
    lines: tuple[int, ...] = ()


def group_issues(issues: Iterable[Issue]) -> tuple[Issue, ...]:
    """Return one issue per (level, kind, subject), the first found, with count and lines of all; errors first."""
    groups: dict[tuple[str, str, str], list[Issue]] = {}
    for issue in issues:
        groups.setdefault((issue.level, issue.kind, issue.subject), []).append(issue)
    order = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(map(_merge_issues, groups.values()), key=lambda issue: order[issue.level]))


def _merge_issues(issues: Sequence[Issue]) -> Issue:
    """Return issues of one kind as one, with the sum of their counts and all their lines."""
    lines = {line for issue in issues for line in (issue.lines or (issue.source_line,)) if line is not None}
    return replace(issues[0], count=sum(issue.count for issue in issues), lines=tuple(sorted(lines)))
