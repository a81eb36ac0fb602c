"""A short attack in every run of the tests; `python -m tests.attack.carried --minutes N` is the long one."""

from tests.attack import carried


def test_random_programs_are_confirmed_as_written():
    results = {carried.try_program(seed) for seed in range(15)}
    assert {"carried by a file", "carried by comments"} <= results
