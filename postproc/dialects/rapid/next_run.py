"""Later runs of a program: whether they move like the first run, see `postproc.dialects.changed_data`.

PERS data keep their values from run to run, and VAR of a module until the program pointer is moved to main.
"""

from __future__ import annotations

from msgspec import Struct

from postproc.dialects.changed_data import FollowedRun, later_difference
from postproc.dialects.rapid.effects import called_names
from postproc.dialects.rapid.execution import ExecutedProgram, Execution, RapidError, first_difference
from postproc.dialects.rapid.syntax import Conditional, Declaration, Loop, Statement, all_statements


class ChangedData(Struct, frozen=True):
    """Data with which a later run of a program moves differently.

    :ivar changes: name as it is declared → offset of the first statement that changes the data; None if it is not
        known.
    :ivar variables: names, among these, of data that are reset when the program pointer is moved to main.
    :ivar start: offset of the first statement that moves differently, or cannot be followed.
    :ivar is_certain: True if it is the second run that differs. Otherwise some later run may.
    """

    changes: dict[str, int | None]
    variables: frozenset[str]
    start: int
    is_certain: bool


def changed_data(first: Execution) -> ChangedData | None:
    """Return the data with which a later run of a program moves differently; None if all runs move like the first.

    :param first: execution of the program, which has run.
    """
    last_run = first

    def follow_next_run(unknown_names: frozenset[str]) -> FollowedRun:
        """Follow the program with the data that the run before has left, and compare it with the first run."""
        nonlocal last_run
        last_run = last_run.next_run(unknown_names)
        start = _difference_of_run(first.result, last_run)
        return FollowedRun(start, frozenset(last_run.changed_names()))

    difference = later_difference(frozenset(first.changed_names()), follow_next_run)
    if difference is None:
        return None
    changes: dict[str, int | None] = {}
    variables: set[str] = set()
    for name in sorted(difference.names):
        declaration = first.data[name].declaration
        spelling = name if declaration is None else declaration.spelling
        changes[spelling] = _change_start(first, name)
        if declaration is not None and declaration.kind == "VAR":
            variables.add(spelling)
    return ChangedData(changes, frozenset(variables), difference.place, difference.is_certain)


def _difference_of_run(first: ExecutedProgram, later_execution: Execution) -> int | None:
    """Return the offset of the first statement at which a later run differs from the first; None if they are equal.

    :param later_execution: execution of the later run, which has not run.
    """
    try:
        later = later_execution.run()
    except RapidError as cause:
        return cause.start
    return first_difference(first, later)


def _change_start(execution: Execution, name: str) -> int | None:
    """Return the offset of the first statement in the followed routines that may change module data; None without one.

    :param name: name of the data, upper case.
    """
    for routine_name in sorted(execution.result.followed_names, key=lambda key: execution.routines[key].start):
        statements = tuple(all_statements(execution.routines[routine_name].body))
        parameters = {parameter.name for parameter in execution.routines[routine_name].parameters}
        if name in parameters or any(isinstance(item, Declaration) and item.name == name for item in statements):
            continue  # local data of the same name
        for statement in statements:
            if _may_change(execution, statement, name):
                return statement.start
    return None


def _may_change(execution: Execution, statement: Statement, name: str) -> bool:
    """Return whether a statement may change module data, without statements inside it and without followed calls.

    :param name: name of the data, upper case.
    """
    effects = execution.effects
    if isinstance(statement, Conditional | Loop):
        return False
    if name in effects.changed_names((statement,)):
        return True
    unfollowed_names = called_names((statement,)) - execution.result.followed_names
    return any(name in effects.changed_data_of(called, includes_foreign_changes=False) for called in unfollowed_names)
