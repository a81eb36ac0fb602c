"""Random KRL programs: what is read and written is what a controller does; for hours: `python -m tests.attack.krl`."""

from collections import Counter

import numpy as np
import pytest

from postproc.dialects.krl.read import flow, unresolved
from postproc.dialects.krl.read.calls import Calls
from postproc.dialects.krl.read.known import NO_VALUE
from postproc.dialects.krl.read.settings import Settings
from postproc.dialects.krl.read.variables import Variables
from postproc.dialects.krl.write.named_points import NamedPoints
from tests.attack.driver import Wrong
from tests.attack.krl import DECK, FIRST_SEEDS, KEPT, MIXED, SNIPPETS, STATES, attack, damaged, seed_in_turn
from tests.attack.krl_deck import SETTLED_CARDS, dealt
from tests.attack.krl_interpreter import Controller, abc


def test_random_programs_do_what_is_read_and_what_is_written():
    outcomes = Counter(attack(seed) for seed in range(16))
    assert outcomes["accepted"] > 3


def test_what_enters_variables_of_other_types_is_what_the_controller_makes_of_it():
    outcomes = Counter(attack(seed) for seed in range(1_000_000, 1_000_012))
    assert outcomes["accepted"] > 3


def test_nested_loops_splines_and_synchronised_robots_are_what_the_controller_makes_of_them():
    outcomes = Counter(attack(seed) for seed in range(MIXED, MIXED + 12))
    assert outcomes["accepted"] > 2


def test_routines_that_save_change_and_restore_what_the_controller_keeps_do_what_is_read_and_written():
    outcomes = Counter(attack(seed) for seed in range(MIXED + STATES, MIXED + STATES + 12))
    assert outcomes["accepted"] > 1


def test_programs_with_one_value_in_doubt_at_most_do_what_is_read_and_written():
    first = MIXED + STATES + SNIPPETS
    outcomes = Counter(attack(seed) for seed in range(first, first + 16))
    assert outcomes["accepted"] > 3
    assert outcomes["refused"] > 2


def test_pieces_that_are_understood_are_accepted_and_most_others_refused():
    first = MIXED + STATES + DECK
    settled = Counter(attack(seed) for seed in range(first, first + 48, 4))
    assert settled["accepted"] + settled["branches"] > 8
    doubtful = Counter(attack(seed) for seed in range(first + 1, first + 13))
    assert doubtful["refused"] > 5


def test_pieces_are_dealt_in_turn():
    count = len(SETTLED_CARDS)
    assert sorted(dealt(SETTLED_CARDS, 3 * count, count)) == sorted(SETTLED_CARDS)
    assert dealt(SETTLED_CARDS, 0, count) != dealt(SETTLED_CARDS, count, count)


def test_all_kinds_of_programs_follow_in_turn():
    seeds = [seed_in_turn(number) for number in range(3 * len(FIRST_SEEDS))]
    assert len({*seeds}) == len(seeds)
    assert {*FIRST_SEEDS} <= {*seeds}


def test_where_only_chance_leads_a_motion_elsewhere_nothing_is_wrong():
    assert attack(337520434) == "kept"


def test_motions_that_are_said_to_be_moved_and_loops_that_never_end_are_not_wrong():
    assert [attack(seed) for seed in (337502197, 337502239)] == ["kept", "invalid"]


@pytest.mark.parametrize(
    ("place", "name", "fault", "skipped"),
    [
        (flow, "carried_variables", lambda *_: [], 105),  # rounds of a LOOP without EXIT may differ
        (Calls, "note_lasting_effects", lambda *_: None, 80),  # interrupts and triggers change nothing
    ],
)
def test_programs_with_one_value_in_doubt_find_a_reader_that_passes_over_it(place, name, fault, skipped, monkeypatch):
    """The programs before the first that shows the fault are skipped."""
    first = MIXED + STATES + SNIPPETS + skipped
    monkeypatch.setattr(place, name, fault)
    with pytest.raises(Wrong) as caught:
        Counter(attack(seed) for seed in range(first, first + 400))
    assert isinstance(caught.value.__cause__, Wrong)


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("TRUE OR TRUE EXOR TRUE", True),
        ("TRUE EXOR TRUE OR TRUE", True),
        ("TRUE EXOR FALSE AND FALSE", True),
        ("FALSE AND FALSE EXOR TRUE", True),
        ("(TRUE OR TRUE) EXOR TRUE", False),
    ],
)
def test_the_controller_joins_and_before_exor_and_that_before_or(condition, holds):
    text = f"DEF part()\nIF {condition} THEN\nPTP {{A1 0,A2 -80,A3 95,A4 0,A5 45,A6 0}}\nENDIF\nEND\n"
    frames = abc(0, 0, 0), abc(0, 0, 0)
    assert len(Controller({"PART.SRC": text}, np.random.default_rng(1), *frames, {}).run("PART")) == holds


def test_the_attack_finds_a_reader_that_reads_the_frame_before(monkeypatch):
    now = Settings.current_value

    def before(self, name, field):
        state, self.state = self.state, self.changes[-2][1] if len(self.changes) > 1 else self.state
        try:
            return now(self, name, field)
        finally:
            self.state = state

    monkeypatch.setattr(Settings, "current_value", before)
    with pytest.raises(Wrong):
        Counter(attack(seed) for seed in range(MIXED + STATES, MIXED + STATES + 200))


def test_motions_that_stay_are_those_of_the_program():
    outcomes = Counter(attack(seed) for seed in range(KEPT, KEPT + 15))
    assert outcomes["kept"] > 1


def test_programs_that_were_refused_when_they_were_read_back():
    assert [attack(seed) for seed in (508015, 4160)] == ["accepted", "accepted"]


def test_programs_that_call_one_routine_both_followed_and_not_followed():
    assert [attack(seed) for seed in (400010666, 400004494)] == ["kept", "accepted"]


def test_damaged_programs_are_refused_with_a_message_or_read():
    outcomes = Counter(damaged(seed) for seed in range(24))
    assert outcomes["read"] > 0
    assert outcomes["refused: True"] > 9
    assert outcomes["refused: False"] == 0


FAULTS = {
    "calls are passed over": (Calls, "follow_call", lambda self, at, call, is_certain: NO_VALUE),
    "what may happen is taken not to": (Calls, "_forget_written_variables", lambda self, at, name, effects: None),
    "arguments keep their values": (Calls, "_forget_arguments", lambda self, at, call, routine: None),
    "branches keep values": (Variables, "forget", lambda self, name, where: None),
    "branches keep settings": (
        Settings,
        "may_become",
        lambda self, line, state, reason: self.change_state(line, state),
    ),
    "points are corrected for all who read them": (
        NamedPoints,
        "_is_correctable_in_declaration",
        lambda self, uses, aggregate: True,
    ),
}
RARE = {
    "what may happen is taken not to": 58,
    "arguments keep their values": 51,
    "branches keep values": 51,
    "branches keep settings": 430,
}
"""The first seed to try where few programs show a fault."""


def test_the_attack_finds_a_reader_that_passes_over_synchronised_robots(monkeypatch):
    monkeypatch.setattr(unresolved, "_sync_lines", lambda main: [])
    with pytest.raises(Wrong, match="is between two SYNCCMD"):
        Counter(attack(seed) for seed in range(MIXED + 280, MIXED + 290))


@pytest.mark.parametrize("fault", FAULTS)
def test_the_attack_finds_a_reader_that(fault, monkeypatch):
    monkeypatch.setattr(*FAULTS[fault])
    with pytest.raises(Wrong) as caught:
        Counter(attack(seed) for seed in range(RARE.get(fault, 0), 1000))
    assert isinstance(caught.value.__cause__, Wrong)  # not another exception
