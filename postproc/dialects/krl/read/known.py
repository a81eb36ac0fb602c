"""Values as known before run time, the scopes that resolve names to variables, and errors where values are unknown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from msgspec import Struct, field
from msgspec.structs import replace

from postproc.dialects.krl.language.expressions import value_at
from postproc.dialects.krl.language.positions import Position
from postproc.dialects.krl.language.routines import Routine
from postproc.dialects.krl.language.source import Place, Source
from postproc.dialects.krl.language.tree import Import
from postproc.dialects.krl.language.values import Aggregate, Number, Value, Word
from postproc.errors import ProgramError


class UnknownValue(Struct, frozen=True):
    """A variable whose value is not known before run time.

    :param change_place: statement or interrupt that changes it, as text for a message; empty if it has no value at all.
    :param reason: why the value that it is set to there is not known, as text; may be empty.
    """

    change_place: str = ""
    reason: str = ""

    def message_for(self, name: str) -> str:
        """Return the text for a message that a variable has no known value, and why; `name` is the variable."""
        if self.reason:
            place_and_reason = ": ".join(filter(None, (self.change_place, self.reason)))
            return f"{name} is set to a value that is not known ({place_and_reason})"
        if self.change_place:
            return f"{name} is changed while the program runs ({self.change_place})"
        return f"{name} has no value in the program, its .dat, the $config.dat or [krl.values] of the cell"


NO_VALUE = UnknownValue()
"""The value of a variable that has none: it was never set."""

VariableValue = Number | Word | Aggregate | Position | UnknownValue


class UnparsedValue(Struct, frozen=True):
    """A value in a declaration, parsed on first use.

    :param row: of the execution trace with the declaration; 0 in data lists.
    """

    source: Source
    start: int
    stop: int
    row: int = 0

    @property
    def value(self) -> Value:
        """The value; it is parsed at the first call and stored with its file.

        An aggregate gets the row of its declaration in the execution trace: its numbers are corrected there.

        :raises ProgramError: the text is not a value.
        """
        value = self.source.declared.get(self.start)
        if value is None:
            value, _ = value_at(self.source, self.start, self.stop)
            self.source.declared[self.start] = value
        if self.row and isinstance(value, Aggregate):
            return replace(value, row=self.row)
        return cast("Value", value)


class Scope(Struct, frozen=True):
    """Resolves names to variables.

    :param local_names: local names of the routine → stored names.
    :param prefixed_names: names that are stored with the prefix: those of the routine's module, or those of the main
        program that the routine does not see.
    :param prefix: put before these names.
    :param array_names: names of its parameters that are whole arrays of the caller; `local_names` has the stored names
        of these arrays.
    """

    local_names: Mapping[str, str] = field(default_factory=dict)
    prefixed_names: frozenset[str] = frozenset()
    prefix: str = ""
    array_names: frozenset[str] = frozenset()

    def stored_name(self, name: str) -> str:
        """Return the name under which a variable (upper case) is stored.

        Local variables come first, then variables of the module, then GLOBAL variables, which keep their name.
        """
        if name[0] == "$":
            return name  # a variable of the controller, the same in all scopes
        local_name = self.local_names.get(name)
        if local_name is not None:
            return local_name
        return self.prefix + name if name in self.prefixed_names else name


def shown_name(name: str) -> str:
    """Return a stored name as messages show it: ``N of SUB`` for a variable of another file, see `Scope.prefix`."""
    module, _, variable = name.rpartition("/")
    return f"{variable} of {module}" if module else name


def stored_originals(imported: Import) -> tuple[str, str]:
    """Return the two names under which the variable of an IMPORT may be stored, see `Scope`.

    The first is the name of a GLOBAL variable. The second has the prefix of the `.dat` that declares the variable.
    """
    return imported.original, f"{imported.file}/{imported.original}"


class UnknownOrderError(ProgramError):
    """The order in which statements run is not known before run time: the branch taken, or the number of iterations.

    Also raised where more statements run than are followed.

    :ivar routine: the called routine; None if the error is not about a call.
    """

    routine: Routine | None = None


class UnresolvedError(ProgramError):
    """A value that a motion depends on is not known before run time."""


def unresolved_error(cause: ProgramError) -> UnresolvedError:
    """Return an `UnresolvedError` with the text of another error, which says why the value is not known."""
    return UnresolvedError(cause.problem, file=cause.file, line=cause.line, text=cause.text, advice=cause.advice)


def unknown_order_error(
    place: Place, problem: str, advice: str | None = None, routine: Routine | None = None
) -> UnknownOrderError:
    """Return the error that the branch taken, or the number of iterations, is not known or not followed at a line.

    :param routine: the called routine, if the error is about a call; else None.
    """
    base = place.error(problem, advice)
    error = UnknownOrderError(base.problem, file=base.file, line=base.line, text=base.text, advice=base.advice)
    error.routine = routine
    return error
