"""What statements of RAPID may change: data by their names, through routines and functions too.

A routine has data and parameters of its own. What it changes besides are data of the module, whatever the routine that
calls it declares under their names. A routine of another file may change all data of the module that are neither LOCAL
nor CONST; it is assumed not to call back.
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
    """What statements may change that call these routines, by name.

    :ivar has_functions: whether a statement of them calls a function that may change something.
    """

    def __init__(self, modules: Sequence[Module], without_effect: Iterable[str]) -> None:
        """Take the routines and data of modules.

        :param without_effect: routines of other files that change no data of these modules and move nothing.
        """
        self.routines = {routine.name: routine for module in modules for routine in module.routines}
        self.without_effect = frozenset(name.upper() for name in without_effect)
        data = [item for module in modules for item in module.data]
        self._all_data = frozenset(item.name for item in data)
        self._open_data = frozenset(item.name for item in data if not item.local)
        self.has_functions = any(self._calls_changing_function(routine.body) for routine in self.routines.values())
        self._changed_data: dict[tuple[str, bool], frozenset[str]] = {}
        self._changed_by_handler: dict[str, frozenset[str]] = {}

    def _calls_changing_function(self, statements: tuple[Statement, ...]) -> bool:
        """Return whether statements call a function that may change something: any but the pure ones of RAPID."""
        functions = {call.value for statement in all_statements(statements) for call in calls(statement)}
        return any(name in self.routines or name not in PURE for name in functions)

    def is_foreign(self, name: str) -> bool:
        """Return whether a routine is in another file and may change data of these modules, or move the robot."""
        return name not in self.routines and name not in self.without_effect and not is_of_rapid(name)

    def changed_names(self, statements: tuple[Statement, ...]) -> Iterator[str]:
        """Yield the names of data that statements may change themselves, as their own routine names them."""
        for statement in all_statements(statements):
            for call in calls(statement):
                yield from self.changed_arguments(call.value, call.items)
            if isinstance(statement, Assignment):
                yield base_name(statement.target)
            elif isinstance(statement, Instruction):
                name = statement.name.removeprefix("%")
                if name in self.routines or not (name in READING or name in MOVES):
                    yield from self.changed_arguments(name, statement.arguments)
                else:
                    yield from (base_name(argument) for argument in results(statement))

    def changed_arguments(self, name: str, arguments: tuple[Argument, ...]) -> Iterator[str]:
        """Yield the names of arguments that a routine may change; all of one that is in another file."""
        routine = self.routines.get(name)
        if routine is not None:
            bound = bound_arguments(routine, arguments, Scope({}))
            expressions = (argument.expression for argument in bound if argument.parameter.changeable)
            yield from (base_name(expression) for expression in expressions if expression is not None)
        elif name not in PURE:
            yield from (base_name(argument) for argument in changed_arguments(arguments))

    def changed_by_handler(self, routine: Routine) -> frozenset[str]:
        """Return the names of data that the handlers of a routine may change, as it names them."""
        if routine.name not in self._changed_by_handler:
            names = set(self.changed_names(routine.handler))
            for name in called_names(routine.handler):
                names |= self.changed_data_of(name)
            self._changed_by_handler[routine.name] = frozenset(names)
        return self._changed_by_handler[routine.name]

    def changed_data_of(self, name: str, *, with_foreign: bool = True) -> frozenset[str]:
        """Return the names of module data that a routine, and those that it calls, may change.

        :param with_foreign: whether what routines of other files may change counts.
        """
        if (name, with_foreign) not in self._changed_data:
            names: set[str] = set()
            waiting, visited_names = [name], {name}
            while waiting:
                called_name = waiting.pop()
                routine = self.routines.get(called_name)
                if routine is None:
                    names |= self._data_open_to(called_name, with_foreign=with_foreign)
                    continue
                statements = (*routine.body, *routine.handler)
                local_names = {parameter.name for parameter in routine.parameters}
                local_names |= {item.name for item in all_statements(statements) if isinstance(item, Declaration)}
                names |= set(self.changed_names(statements)) - local_names
                new_names = called_names(statements) - visited_names
                waiting += new_names
                visited_names |= new_names
            self._changed_data[name, with_foreign] = frozenset(names)
        return self._changed_data[name, with_foreign]

    def _data_open_to(self, name: str, *, with_foreign: bool) -> frozenset[str]:
        """Return the names of module data that an instruction, or a routine of another file, may change by name."""
        if name in BY_NAME:
            return self._all_data
        return self._open_data if with_foreign and self.is_foreign(name) else frozenset()


def results(instruction: Instruction) -> Iterator[Expression]:
    r"""Yield the data that an instruction of RAPID changes by its options (``\TimeFlag:=late`` of WaitDI)."""
    for argument in instruction.arguments:
        if argument.name in RESULT_OPTIONS and argument.value is not None:
            yield argument.value


def called_names(statements: tuple[Statement, ...]) -> set[str]:
    """Return the names of the instructions and functions in statements, those of routines among them."""
    names = {call.value for statement in all_statements(statements) for call in calls(statement)}
    instructions = (statement for statement in all_statements(statements) if isinstance(statement, Instruction))
    return names | {instruction.name.removeprefix("%") for instruction in instructions}


class BoundArgument(NamedTuple):
    """A parameter of a routine with its argument in a call.

    :param parameter: of the routine.
    :param expression: the argument; None: the call has none.
    :param is_given: whether the call gives the parameter; None: that is not known.
    """

    parameter: Parameter
    expression: Expression | None
    is_given: bool | None


def bound_arguments(routine: Routine, arguments: Sequence[Argument], scope: Scope) -> Iterator[BoundArgument]:
    """Yield the parameters of a routine with their arguments in a call.

    An argument that passes an optional parameter on is given if that is.

    :param scope: of the call; it knows which parameters of the calling routine are given.
    """
    positional = iter([argument.value for argument in arguments if not argument.name])
    options = {argument.name: argument for argument in arguments if argument.name}
    for parameter in routine.parameters:
        if not parameter.optional:
            yield BoundArgument(parameter, next(positional, None), True)
            continue
        argument = options.get(parameter.name)
        expression = None if argument is None else argument.value
        source = None if expression is None else expression.value
        is_given: bool | None = argument is not None
        if isinstance(source, str) and source in scope.presence:
            is_given = scope.presence[source]
        yield BoundArgument(parameter, expression, is_given)
