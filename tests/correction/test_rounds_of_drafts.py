"""Rounds of drafts: motions are slowed and targets inserted as often as the simulation asks for, and no more."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import Struct

from postproc.correction import checks
from postproc.correction.verify import Exceedances
from postproc.errors import Issue
from postproc.poses import Poses

process = importlib.import_module("postproc.correction.process")


class Task(Struct, frozen=True):
    """What the rounds use of a task."""

    mode: str
    initial_issues: tuple


class Script:
    """Answers of the stages: how many joints are too fast, and how many places are missed, in each draft in turn."""

    def __init__(self, patch, fast, missed, *, can_slow=99, simulated=True):
        self.fast, self.missed, self.can_slow, self.simulated = fast, missed, can_slow, simulated
        self.log = []
        patch.setattr(process, "_first_pieces", lambda task, motions: "pieces 0")
        patch.setattr(process, "PathUnderLoad", SimpleNamespace(of=lambda *parts: parts))
        patch.setattr(process, "_written_draft", self.drafted)
        patch.setattr(process, "_refine", self.closer)
        patch.setattr(process.inspection, "slow_fast_motions", self.slowed)

    def drafted(self, task, path):
        number = sum(entry[0] == "draft" for entry in self.log)
        motions, pieces, places = path
        self.log.append(("draft", motions.name, pieces, places, task.initial_issues))
        count = self.fast[number] if number < len(self.fast) else 0
        issues = [
            Issue("error", f"{checks.JOINT_SPEED}A{k + 1}", "fast", 10 * k + 1, lines=(10 * k + 2,))
            for k in range(count)
        ]
        missed = self.missed[number] if number < len(self.missed) else 0
        rows = Exceedances(np.arange(missed), np.zeros(missed), np.zeros(missed))
        pose = Poses.fixed(np.full((2, 3), float(number)), np.eye(3))
        path = SimpleNamespace(sample=SimpleNamespace(pose=pose), number=number)
        simulation = SimpleNamespace(exceedances=rows) if self.simulated else None
        return SimpleNamespace(
            issues=[*issues, Issue("info", "x", "y")], q=f"q {number}", path=path, simulation=simulation, number=number
        )

    def closer(self, task, path, missed, places):
        self.log.append(("closer", path.number, len(missed.motion), places))
        count = sum(entry[0] == "closer" for entry in self.log)
        return process._Division(f"pieces {count}", f"places {count}")

    def slowed(self, path, q, position, slowing, fast_lines):
        count = sum(entry[0] == "slowed" for entry in self.log)
        self.log.append(("slowed", q, float(position[0, 0]), slowing, sorted(fast_lines)))
        if count >= self.can_slow:
            return None
        names = SimpleNamespace(issue=lambda motions: f"slow {count + 1} of {motions}", count=count + 1)
        program = SimpleNamespace(motions=f"motions {count + 1}")
        return SimpleNamespace(name=f"slow {count + 1}", program=program), names


def settled(mode="convert"):
    motions = SimpleNamespace(name="as read", swing_places="places 0")
    return process._refine_until_tolerated(Task(mode, ("first",)), motions)


def test_a_draft_that_holds_is_the_result(monkeypatch):
    script = Script(monkeypatch, [], [])
    task, draft = settled()
    assert (task.initial_issues, draft.number) == (("first",), 0)
    assert script.log == [("draft", "as read", "pieces 0", "places 0", ("first",))]


@pytest.mark.parametrize("rounds", [1, 2, 7, 20])
def test_targets_are_inserted_in_seven_rounds_at_most(monkeypatch, rounds):
    """The eighth draft is the last one, as it is."""
    script = Script(monkeypatch, [], [3] * rounds)
    _, draft = settled()
    drafts = min(rounds, 7) + 1
    assert draft.number == drafts - 1
    made = [entry for entry in script.log if entry[0] == "draft"]
    assert [entry[2:4] for entry in made] == [(f"pieces {k}", f"places {k}") for k in range(drafts)]
    asked = [entry for entry in script.log if entry[0] == "closer"]
    assert asked[: drafts - 1] == [("closer", k, 3, f"places {k}") for k in range(drafts - 1)]


@pytest.mark.parametrize("times", [1, 3, 5, 9])
def test_motions_are_slowed_until_no_joint_is_too_fast_and_five_times_at_most(monkeypatch, times):
    """In each draft by the lines on which a joint is; the remark is that of the last time."""
    script = Script(monkeypatch, [2] * times, [])
    task, draft = settled()
    count = min(times, 5)
    assert draft.number == count
    slowed = [entry for entry in script.log if entry[0] == "slowed"]
    assert [entry[1:3] for entry in slowed] == [(f"q {k}", float(k)) for k in range(count)]
    assert [None if entry[3] is None else entry[3].count for entry in slowed] == [None, *range(1, count)]
    assert all(entry[4] == [1, 2, 11, 12] for entry in slowed)
    made = [entry for entry in script.log if entry[0] == "draft"]
    assert [entry[1] for entry in made] == ["as read", *(f"slow {k}" for k in range(1, count + 1))]
    assert task.initial_issues == ("first", f"slow {count} of motions {count}")
    assert made[-1][4] == task.initial_issues


def test_what_cannot_be_slowed_stays_as_it_is(monkeypatch):
    script = Script(monkeypatch, [1] * 9, [], can_slow=1)
    task, draft = settled()
    assert draft.number == 1
    assert [entry[0] for entry in script.log] == ["draft", "slowed", "draft", "slowed"]
    assert task.initial_issues == ("first", "slow 1 of motions 1")


@pytest.mark.parametrize(("mode", "simulated"), [("nominal", True), ("convert", False)])
def test_nominal_programs_and_those_that_are_not_simulated_get_no_targets(monkeypatch, mode, simulated):
    script = Script(monkeypatch, [], [4], simulated=simulated)
    _, draft = settled(mode)
    assert draft.number == 0
    assert [entry[0] for entry in script.log] == ["draft"]


def test_slowed_motions_stay_slow_in_the_rounds_that_follow(monkeypatch):
    script = Script(monkeypatch, [1, 0, 1, 0], [0, 2, 0, 0])
    task, draft = settled()
    assert draft.number == 3
    made = [entry[1:3] for entry in script.log if entry[0] == "draft"]
    assert made == [("as read", "pieces 0"), ("slow 1", "pieces 0"), ("slow 1", "pieces 1"), ("slow 2", "pieces 1")]
    assert task.initial_issues == ("first", "slow 2 of motions 2")


@pytest.mark.parametrize("uncertain", [[False, False], [True, False], [True, True]])
def test_arcs_are_divided_by_the_error_of_larger_pieces_where_one_is_uncertain(monkeypatch, uncertain):
    pieces = SimpleNamespace(uncertain=np.array(uncertain))
    motions = SimpleNamespace(pieces=lambda *, linearize_arcs: pieces if linearize_arcs else None)
    for name, function in (
        ("PathUnderLoad", SimpleNamespace(of=lambda *parts: parts)),
        ("_commands", lambda task, path: (task.mode, path)),
        ("CommandedPath", SimpleNamespace(of=lambda path, command: (path, command))),
        ("arc_pieces", lambda commanded: ("needed", commanded)),
    ):  # fmt: skip
        monkeypatch.setattr(process, name, function)
    task = SimpleNamespace(mode="convert", linearize_arcs=True)
    found = process._first_pieces(task, motions)
    path = (motions, pieces)
    assert found == (("needed", (path, ("convert", path))) if any(uncertain) else pieces)
