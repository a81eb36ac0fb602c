"""Random KRL jobs corrected, executed and loaded; for hours: `python -m tests.attack.krl_under_force`."""

import dataclasses
from collections import Counter
from functools import cache

import pytest
from msgspec.structs import replace

from postproc.dialects.krl.read import reader
from postproc.toolpath import path
from tests.attack import krl_under_force
from tests.attack.driver import Wrong
from tests.attack.krl_interpreter import Choices
from tests.attack.krl_under_force import attack


def test_the_loaded_tool_goes_where_the_job_said_whatever_inputs_say():
    outcomes = Counter(attack(seed).partition(":")[0] for seed in (*range(11), 30))  # the last is kept
    assert sum(number for name, number in outcomes.items() if "straight" in name) > 5
    assert sum(number for name, number in outcomes.items() if "branches" in name) > 0
    assert sum(number for name, number in outcomes.items() if "in files" in name) > 1
    assert sum(number for name, number in outcomes.items() if "no forces" in name) >= 1
    assert outcomes["kept"] >= 1


def test_jumps_over_statements_and_routines_left_early_do_what_the_job_said():
    outcomes = Counter(attack(seed).partition(":")[0] for seed in range(1_000_000, 1_000_013))
    assert sum(number for name, number in outcomes.items() if name != "refused") > 6
    assert attack(4_000_071) == "branches, in files"  # a force behind branches that meet where a routine ends
    assert attack(4_000_130) == "kept"  # a function of another file that moves


def test_jobs_that_inputs_choose_do_what_they_said_each_from_its_home_position():
    outcomes = Counter(attack(seed).partition(",")[0] for seed in range(10_000_000, 10_000_013))
    assert outcomes["branches"] > 1


def test_branches_that_stay_in_some_rounds_of_a_loop_only_are_read_back_as_they_were_read():
    assert attack(20409) == "kept, in files"  # its first round is corrected and written out, the others stay a loop


def test_branches_that_are_kept_and_end_under_different_forces_are_read_back_as_they_were_read():
    assert attack(995) == "kept"  # the written comment before the branches has other axes, in which the forces compare


def test_choices_go_through_all_that_inputs_may_be():
    def run(choices):
        return (choices(), choices() and choices())

    tried, choices = [], Choices()
    while choices is not None:
        run(choices)
        tried.append(choices.decided)
        choices = choices.following()
    assert tried == [
        [False, False],
        [False, True, False],
        [False, True, True],
        [True, False],
        [True, True, False],
        [True] * 3,
    ]


def stiffer(cell, robot, arm):
    return cell, robot, dataclasses.replace(arm, stiffness=arm.stiffness * 1.001)


SETUP, STARTS, NOTES = krl_under_force.setup, path.starts, reader.force_notes
FAULTS = {
    "branches begin where the one before ends": (
        path,
        "starts",
        lambda program, *rest: STARTS(replace(program, after=None), *rest),
    ),
    "first force holds to the end": (reader, "force_notes", lambda *given: NOTES(*given)[:1]),
    "springs are softer by a thousandth": (krl_under_force, "setup", cache(lambda: stiffer(*SETUP()))),
}


RARE = {"branches begin where the one before ends": 10, "first force holds to the end": 3}
"""The first seed to try where few programs show a fault."""


@pytest.mark.parametrize("fault", FAULTS)
def test_the_attack_finds_a_package_whose(fault, monkeypatch):
    monkeypatch.setattr(*FAULTS[fault])
    with pytest.raises(Wrong) as caught:
        Counter(attack(seed) for seed in range(RARE.get(fault, 0), 200))
    assert isinstance(caught.value.__cause__, Wrong)  # not another exception
