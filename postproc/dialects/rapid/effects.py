"""Data that statements of RAPID may change, by their names, also through routines and functions.

A routine has local data and parameters; all other data that it changes are data of the module. Local data of its
callers with the same names are different data. A routine of another file may change all data of the module that are
neither LOCAL nor CONST; it is assumed not to call routines of the module.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from postproc.dialects.rapid.instructions import BY_NAME, MOVES, PURE, READING, RESULT_OPTIONS, is_of_rapid
from postproc.dialects.rapid.syntax import (
    Argument,
    Assignment,
    Declaration,
    Expression,
    Instruction,
    Module,
    Parameter,
    Routine,
    Statement,
    all_statements,
    calls,
)
from postproc.dialects.rapid.values import Scope, base_name, changed_arguments


class Effects:
    """Names of the data that statements of some modules may change.

    :ivar routines: name → routine of these modules.
    :ivar without_effect: names, upper case, of routines of other files that change no data and move nothing.
    :ivar has_functions: True if a statement of the routines calls a function that may change data.
    """

    def __init__(self, modules: Sequence[Module], without_effect: Iterable[str]) -> None:
        """Collect the routines and data of modules.

        :param without_effect: names, in any case, of routines of other files that change no data of these modules and
            move nothing.
        """
        self.routines = {routine.name: routine for module in modules for routine in module.routines}
        self.without_effect = frozenset(name.upper() for name in without_effect)
        data = [item for module in modules for item in module.data]
        self._all_data = frozenset(item.name for item in data)
        self._open_data = frozenset(item.name for item in data if not item.is_local)
        self.has_functions = any(self._calls_changing_function(routine.body) for routine in self.routines.values())
        self._changed_data: dict[tuple[str, bool], frozenset[str]] = {}
        self._changed_by_handler: dict[str, frozenset[str]] = {}

    def _calls_changing_function(self, statements: tuple[Statement, ...]) -> bool:
        """Return whether statements call a function that may change data: all except the pure functions of RAPID."""
        functions = {call.value for statement in all_statements(statements) for call in calls(statement)}
        return any(name in self.routines or name not in PURE for name in functions)

    def is_foreign(self, name: str) -> bool:
        """Return whether a name is a routine of another file that may change data of these modules or move."""
        return name not in self.routines and name not in self.without_effect and not is_of_rapid(name)

    def changed_names(self, statements: tuple[Statement, ...]) -> Iterator[str]:
        """Yield the names of data that statements change directly: by assignment, or as argument of a call.

        Names are those in the routine of the statements. Data that called routines change by name are not among them.
        """
        for statement in all_statements(statements):
            for call in calls(statement):
                yield from self.changed_arguments(call.value, call.items)
            if isinstance(statement, Assignment):
                yield base_name(statement.target)
            elif isinstance(statement, Instruction):
                name = statement.name.removeprefix("%")
                if name in self.routines or not (name in READING or name in MOVES):  # may change any argument
                    yield from self.changed_arguments(name, statement.arguments)
                else:
                    yield from (base_name(argument) for argument in results(statement))

    def changed_arguments(self, name: str, arguments: tuple[Argument, ...]) -> Iterator[str]:
        """Yield the names of data among arguments that a routine or function may change.

        Routine of these modules: arguments of VAR, PERS and INOUT parameters. Pure function of RAPID: none. Others: all
        arguments that can be changed.

        :param name: name of the routine or function.
        """
        routine = self.routines.get(name)
        if routine is not None:
            # without a scope: it does not matter here which parameters are given
            bound = bound_arguments(routine, arguments, Scope({}))
            expressions = (argument.expression for argument in bound if argument.parameter.is_changeable)
            yield from (base_name(expression) for expression in expressions if expression is not None)
        elif name not in PURE:
            yield from (base_name(argument) for argument in changed_arguments(arguments))

    def changed_by_handler(self, routine: Routine) -> frozenset[str]:
        """Return the names of data that the error handlers of a routine, and routines called there, may change."""
        if routine.name not in self._changed_by_handler:
            names = set(self.changed_names(routine.handler))
            for name in called_names(routine.handler):
                names |= self.changed_data_of(name)
            self._changed_by_handler[routine.name] = frozenset(names)
        return self._changed_by_handler[routine.name]

    def changed_data_of(self, name: str, *, includes_foreign_changes: bool = True) -> frozenset[str]:
        """Return the names of module data that a routine, and all routines that it calls, may change.

        The result is stored.

        :param includes_foreign_changes: False to assume that routines of other files change no data.
        """
        key = name, includes_foreign_changes
        if key not in self._changed_data:
            names: set[str] = set()
            unvisited_names, visited_names = [name], {name}
            while unvisited_names:
                called_name = unvisited_names.pop()
                routine = self.routines.get(called_name)
                if routine is None:
                    names |= self._data_changed_outside(called_name, includes_foreign_changes=includes_foreign_changes)
                    continue
                statements = (*routine.body, *routine.handler)
                local_names = {parameter.name for parameter in routine.parameters}
                local_names |= {item.name for item in all_statements(statements) if isinstance(item, Declaration)}
                names |= set(self.changed_names(statements)) - local_names
                new_names = called_names(statements) - visited_names
                unvisited_names += new_names
                visited_names |= new_names
            self._changed_data[key] = frozenset(names)
        return self._changed_data[key]

    def _data_changed_outside(self, name: str, *, includes_foreign_changes: bool) -> frozenset[str]:
        """Return the names of module data that an instruction, or a routine of another file, may change by itself.

        Instructions in `BY_NAME`, which find data by a text: all data. Routines of other files: data that are not
        LOCAL. All others: no data.

        :param name: name of the instruction or routine, which is not in these modules.
        :param includes_foreign_changes: False to assume that routines of other files change no data.
        """
        if name in BY_NAME:
            return self._all_data
        return self._open_data if includes_foreign_changes and self.is_foreign(name) else frozenset()


def results(instruction: Instruction) -> Iterator[Expression]:
    r"""Yield the data to which an instruction of RAPID writes a result by an option (``\TimeFlag:=late`` of WaitDI)."""
    for argument in instruction.arguments:
        if argument.name in RESULT_OPTIONS and argument.value is not None:
            yield argument.value


def called_names(statements: tuple[Statement, ...]) -> set[str]:
    """Return the names of all instructions and functions in statements, routines of the modules among them."""
    names = {call.value for statement in all_statements(statements) for call in calls(statement)}
    instructions = (statement for statement in all_statements(statements) if isinstance(statement, Instruction))
    return names | {instruction.name.removeprefix("%") for instruction in instructions}


class BoundArgument(NamedTuple):
    """A parameter of a routine with its argument in a call.

    :param parameter: parameter of the routine.
    :param expression: its argument; None if the call has none.
    :param is_given: whether the call gives the parameter; None if this is not known before run time.
    """

    parameter: Parameter
    expression: Expression | None
    is_given: bool | None


def bound_arguments(routine: Routine, arguments: Sequence[Argument], scope: Scope) -> Iterator[BoundArgument]:
    """Yield the parameters of a routine with their arguments in a call.

    If the argument is itself an optional parameter of the calling routine, it is given if that parameter is given.

    :param scope: scope of the call, which states which parameters of the calling routine are given.
    """
    positional = iter([argument.value for argument in arguments if not argument.name])
    options = {argument.name: argument for argument in arguments if argument.name}
    for parameter in routine.parameters:
        if not parameter.is_optional:
            yield BoundArgument(parameter, next(positional, None), True)
            continue
        argument = options.get(parameter.name)
        expression = None if argument is None else argument.value
        source = None if expression is None else expression.value
        is_given: bool | None = argument is not None
        if isinstance(source, str) and source in scope.presence:
            is_given = scope.presence[source]
        yield BoundArgument(parameter, expression, is_given)
