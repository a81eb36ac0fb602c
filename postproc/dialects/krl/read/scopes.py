"""Which variables the names of a routine mean: its own, those of its file, those that all share."""

from __future__ import annotations

from contextlib import suppress

from msgspec.structs import replace

from postproc.dialects.krl.language.declarations import declared_names
from postproc.dialects.krl.language.routines import Module, Routine
from postproc.dialects.krl.read.data_lists import read_data
from postproc.dialects.krl.read.known import Scope
from postproc.dialects.krl.read.variables import Variables
from postproc.errors import ProgramError

_OF_THE_CONTROLLER = frozenset({"BASE_DATA", "TOOL_DATA", "FDAT_ACT", "LDAT_ACT", "PDAT_ACT"})


class Scopes:
    """The scopes of routines; those of another file are made, and its data read, when they are first asked for.

    :param program: the file of the program.
    :param main: the routine that is followed; its names need no scope.
    """

    def __init__(self, program: Module, main: Routine, variables: Variables) -> None:
        self.program, self.main, self.variables = program, main, variables
        self._modules: dict[Module, Scope] = {}

    def of(self, module: Module, routine: Routine) -> Scope:
        """Return which variables the names of a routine mean that are not its own."""
        if routine is self.main:
            return Scope()
        if module is self.program:
            return Scope(own=self.main.local - routine.local, prefix=f"{module.name}/")
        if module not in self._modules:
            self._modules[module] = self._of_module(module)
        return self._modules[module]

    def of_call(self, module: Module, routine: Routine, number: int) -> Scope:
        """Return the scope of one call, in which the routine's own variables are new."""
        own = {name: f"{name}@{number}" for name in routine.local}
        return replace(self.of(module, routine), local=own)

    def _of_module(self, module: Module) -> Scope:
        """Return the scope of another file, its data read."""
        variables, data = self.variables, module.data
        own, public = (frozenset(), frozenset()) if data is None else declared_names(data)
        hidden = (frozenset(variables.types) - variables.public) | self.main.local
        scope = Scope(own=(hidden | own) - public - _OF_THE_CONTROLLER, prefix=f"{module.name}/")
        if data is not None:
            before, variables.scope = variables.scope, scope
            with suppress(ProgramError):  # its variables have no values then
                read_data(variables, data, fill=True)
            variables.scope = before
        return scope
