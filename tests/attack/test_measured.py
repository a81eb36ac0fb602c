"""The measure of the random programs: what it plants is found, in a process of its own."""

from tests.attack.measured import READER, executed_lines, judgement, outcome_of, programs_of, reading, seed_of
from tests.mutation.mutants import mutants_of
from tests.places import ROOT


def fault(module, words):
    """The first fault of a module that leaves out a statement with some words."""
    return next(m for m in mutants_of(READER / f"{module}.py", ROOT) if m.kind == "dropped" and words in m.before)


def test_a_planted_fault_is_found_and_does_not_stay():
    seeds = [seed_of(number) for number in range(3)]
    usual = [(reading(seed), outcome_of(seed)[0]) for seed in seeds]
    executed = executed_lines(seeds)
    broken = fault("run", "self.level = Level(")
    numbers = programs_of(broken, executed)
    assert numbers == [0, 1, 2]
    assert judgement(broken, numbers, usual)[0] == "wrong"
    harmless = fault("flow", "level.loop_depth -= 1")._replace(new="level.loop_depth -= 1")
    assert judgement(harmless, numbers, usual)[0] == "not found"
    assert [outcome_of(seed)[0] for seed in seeds] == [outcome for _, outcome in usual]
