"""RAPID whose moves depend on what ran before; for hours: `python -m tests.attack.rapid_states`."""

from __future__ import annotations

from collections import Counter

import pytest

from postproc.dialects.rapid import effects, execution, values
from postproc.dialects.rapid.effects import Effects
from postproc.dialects.rapid.execution import Execution
from postproc.dialects.rapid.syntax import Parameter
from postproc.dialects.rapid.values import Scope, Variable
from tests.attack.driver import Wrong
from tests.attack.rapid_states import StateGenerator, attack


def test_the_package_makes_the_moves_of_the_controller_or_refuses():
    outcomes = Counter(attack(seed).partition(":")[0] for seed in range(100))
    assert outcomes["read"] > 27
    assert outcomes["read, with inputs"] >= 1


def test_corrected_modules_lead_the_loaded_tool_along_the_path():
    outcomes = Counter(attack(seed, correct=True).partition(":")[0] for seed in range(1000, 1013))
    assert outcomes["corrected"] >= 1


def test_the_modules_have_all_forms():
    texts = [StateGenerator(seed).text() for seed in range(60)]
    for form in (
        "INOUT ",
        "PERS num n",
        "LOCAL PROC",
        "FUNC num",
        "FUNC robtarget",
        "TEST ",
        "WHILE ",
        "GOTO ",
        "RETURN;",
        "MODULE second",
        "Present(",
        "DInput(",
        "VAR num n1:=",
        "q{",
        "RelTool(",
        "! FORCE",
    ):
        assert any(form in text for text in texts), form


def nothing(*_args, **_options):
    return None


def arguments_by_value(routine, arguments, scope):
    for parameter, expression, is_given in effects.bound_arguments(routine, arguments, scope):
        by_value = Parameter(parameter.name, parameter.type, False, parameter.is_optional)
        yield effects.BoundArgument(by_value, expression, is_given)


def no_names(*_args):
    return frozenset()


def module_data_first(scope, name):
    return scope.outer.get(name) or scope.inner.get(name)


def rounds_that_keep_the_counter(execution_, loop, values_, scope, routine, depth):
    for value in values_:
        scope.inner[loop.name] = Variable("NUM", value)
        execution_._execute_block(loop.body, scope, routine, depth)


def first_case_only(execution_, statement, condition, scope):
    if statement.subject is None:
        return values.truth(condition, scope)
    return values.evaluate(statement.subject, scope)[0] == values.evaluate(condition.items[0], scope)[0]


def data_of_all_routines(execution_, declaration, scope, routine):
    variable = execution._initial_variable(declaration)
    variable.value = values.evaluate(declaration.value, scope)[0]
    execution_.data[declaration.name] = variable


def returns_at_once(_execution, _routine, _scope, _reason):
    raise execution._Return


def goes_on(execution_, jump, routine, scope):
    if jump.word == "RETURN":
        raise execution._Return


FAULTS = {
    # the first seed that shows it, and what is put in the place of what
    "functions change module data unseen": (239, Effects, "changed_data_of", no_names),
    "functions change their arguments unseen": (901, Effects, "changed_arguments", lambda *_: iter(())),
    "parameters are copies": (133, execution, "bound_arguments", arguments_by_value),
    "elements given to a routine are copies": (1705, Execution, "_may_change_array", lambda *_: False),
    "a routine that may end early keeps its data": (181, Execution, "_leave", returns_at_once),
    "GOTO is passed over": (52, Execution, "_execute_jump", goes_on),
    "branches that may run change nothing": (181, Execution, "_forget", nothing),
    "module data hide local data": (8, Scope, "find", module_data_first),
    "the variable of FOR outlives it": (129, Execution, "_follow_rounds", rounds_that_keep_the_counter),
    "CASE has one value": (450, Execution, "_holds", first_case_only),
    "local data are data of the module": (172, Execution, "_declare", data_of_all_routines),
    "forces in branches count for nothing": (1092, Execution, "_check_forces", nothing),
    "loops without moves are passed over": (6, Execution, "_execute_loop_without_moves", nothing),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_attack_finds_a_reader_in_which(fault, monkeypatch):
    seed, *change = FAULTS[fault]
    attack(seed)
    monkeypatch.setattr(*change)
    with pytest.raises(Wrong):
        attack(seed)
