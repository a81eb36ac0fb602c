"""The search of a region with errors that a formula gives, and what places state."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.placement import drive, region
from postproc.placement.region import Assessment, JudgedPlace, Region

REGION = Region((1000.0, -300.0, 500.0, -30.0, 0.0), (1600.0, 300.0, 500.0, 30.0, 0.0))
BEST = np.array([1234.0, 77.0, 500.0, -12.0, 0.0])


class Bowl:
    """Programs whose expected error is 0.1 mm at the best place, and grows with the square of the distance."""

    def __init__(self, today, hole=None, all_samples_refuse=lambda place: False):
        base = SimpleNamespace(X=today[0], Y=today[1], Z=today[2], A=today[3])
        self.robot_in_cell = SimpleNamespace(cell=SimpleNamespace(base=base))
        self.hole, self.refuses, self.places = hole, all_samples_refuse, []

    def judge(self, place, *, all_samples=False):
        self.places.append((tuple(place), all_samples))
        if self.hole is not None and np.linalg.norm(place[:2] - BEST[:2]) < self.hole:
            return JudgedPlace(tuple(place), drive.LIMIT)
        if all_samples and self.refuses(place):
            return JudgedPlace(tuple(place), drive.COLLISION)
        scale = np.array([300.0, 300.0, 1.0, 30.0, 1.0])
        error = 1e-4 * (1.0 + float(np.sum(((place - BEST) / scale) ** 2)))
        return JudgedPlace(tuple(place), drive.FREE, 2.0 * error, error, margin=0.1)


def test_the_lowest_place_of_a_bowl_is_found_to_some_millimetres():
    programs, steps = Bowl((1500.0, -250.0, 500.0, 0.0)), []
    search = region.search(programs, REGION, lambda done, total: steps.append((done, total)))
    assert steps == [(min(k, 6 * 6 * 5 + 15 * 15), 6 * 6 * 5 + 15 * 15) for k in range(1, len(steps) + 1)]
    assert search.best.u95 <= 1.003 * 1e-4
    assert all(value == round(value) for value in search.best.place)
    assert search.today.place == (1500.0, -250.0, 500.0, 0.0, 0.0)
    assert programs.places[0][1]  # today's place by all samples
    grid = np.array([place for place, _ in programs.places[1 : 1 + 6 * 6 * 5]])
    for column, values in ((0, np.linspace(1000, 1600, 6)), (1, np.linspace(-300, 300, 6)), (3, [-30, -15, 0, 15, 30])):
        np.testing.assert_allclose(np.unique(grid[:, column]), values)
    np.testing.assert_allclose(search.slice, [np.linspace(1000, 1600, 15), np.linspace(-300, 300, 15)])
    nearest = grid[np.argmin([programs.judge(place).u95 for place in grid])]
    np.testing.assert_allclose(search.slice_place, nearest)
    assert len(search.trials) >= 180 + 225
    trials = np.array([trial.place for trial in search.trials])
    assert (trials >= REGION.low).all()
    assert (trials <= REGION.high).all()


def test_a_region_without_x_or_y_has_no_slice_and_the_steps_are_told():
    steps = []
    fixed = Region((1234.0, -300.0, 500.0, 0.0, 0.0), (1234.0, 300.0, 500.0, 0.0, 0.0))
    search = region.search(Bowl((1234.0, -300.0, 500.0, 0.0)), fixed, lambda done, total: steps.append((done, total)))
    assert search.slice == ((), ())
    assert steps[:6] == [(k, 6) for k in range(1, 7)]
    assert set(steps[6:]) <= {(6, 6)}
    assert search.best.place[0] == 1234.0
    assert abs(search.best.place[1] - 77.0) <= 6.0


@pytest.mark.parametrize(("beside", "stays"), [(30.0, True), (60.0, False)])
def test_todays_place_stays_where_no_other_saves_two_percent(beside, stays):
    """30 mm beside the best place the error is 1 % larger, and 60 mm beside it 4 %."""
    today = (BEST[0] + beside, BEST[1], BEST[2], BEST[3])
    search = region.search(Bowl(today), REGION)
    assert (search.best == search.today) is stays


def test_todays_place_outside_of_the_region_does_not_stay():
    narrow = Region((1240.0, 0.0, 500.0, -12.0, 0.0), (1600.0, 300.0, 500.0, -12.0, 0.0))
    search = region.search(Bowl(tuple(BEST[:4])), narrow)
    assert search.best.place[0] == 1240.0
    assert search.today.u95 < search.best.u95


def test_a_place_that_all_samples_refuse_is_left_for_the_next_one():
    programs = Bowl((1010.0, -290.0, 500.0, 30.0), all_samples_refuse=lambda place: place[0] < 1240.0)
    search = region.search(programs, REGION)
    assert search.best.place[0] >= 1240.0
    assert not search.today.reachable
    none = region.search(Bowl((1010.0, -290.0, 500.0, 30.0), all_samples_refuse=lambda place: True), REGION)
    assert none.best is None


def test_a_region_in_which_nothing_can_be_driven_has_its_slice_through_the_middle():
    programs = Bowl((1500.0, -250.0, 500.0, 0.0), hole=9e3)
    search = region.search(programs, REGION)
    assert search.best is None
    assert [all_samples for _, all_samples in programs.places].count(True) == 1  # today's place
    assert search.slice_place == (1300.0, 0.0, 500.0, 0.0, 0.0)


def test_places_are_converted_until_all_programs_can_be_and_forty_at_most_or_eight_with_one_error():
    converted = []

    def assess(place, problem="a limit"):
        converted.append(place.place)
        return Assessment(1e-4, 2e-4, 1.5e-4, 0.9, problem if len(converted) < 4 else "")

    search = region.search(Bowl((1500.0, -250.0, 500.0, 0.0)), REGION, assess=assess)
    assert len(converted) == 4
    assert search.best.place == converted[-1]
    assert search.today.problem == "a limit"
    assert search.best.stated_cost == 1.5e-4
    for problem, count in (("{}", 40), ("x", 8)):

        def refused(place, problem=problem):
            converted.append(place.place)
            return Assessment(problem=problem.format(place.place))

        converted.clear()
        never = region.search(Bowl((1500.0, -250.0, 500.0, 0.0)), REGION, assess=refused)
        assert never.best is None
        assert len(converted) == 1 + count  # today's place besides
        assert [place.place for place in never.refusals] == converted[1:]


def test_the_best_of_places_that_are_alike_is_the_one_with_more_margin():
    one = JudgedPlace((0.0,) * 5, drive.FREE, 1e-4, 1.000e-4, margin=0.1)
    for cost, margin, is_better in (
        (1.005e-4, 0.2, True), (0.995e-4, 0.05, False), (0.98e-4, 0.05, True), (1.02e-4, 0.2, False),
        (1.01005e-4, 0.2, False), (0.99005e-4, 0.05, True),
    ):  # fmt: skip
        other = replace(one, u95=cost, margin=margin)
        assert region._is_better(other, one) is is_better
        assert region._is_better(one, other) is not is_better
    refused = JudgedPlace((0.0,) * 5, drive.REACH)
    assert region._is_better(one, refused)
    assert not region._is_better(refused, one)


def test_a_place_states_its_problem_and_its_cost():
    free = JudgedPlace((0.0,) * 5, drive.FREE, 3e-4, 2e-4, margin=0.1)
    assert (free.problem, free.reachable, free.cost, free.stated_cost) == ("", True, 2e-4, 2e-4)
    assert replace(free, u95=np.nan).cost == 3e-4
    refused = replace(free, reason=drive.COLLISION)
    assert (refused.problem, refused.reachable, refused.cost, refused.stated_cost) == (
        "collision",
        False,
        np.inf,
        np.inf,
    )
    assessed = replace(free, assessment=Assessment(deflection=5e-4, corrected=4e-4))
    assert (assessed.cost, assessed.stated_cost) == (2e-4, 4e-4)
    assert replace(free, assessment=Assessment(deflection=5e-4)).stated_cost == 5e-4
    failed = replace(free, assessment=Assessment(problem="out of reach"))
    assert (failed.problem, failed.cost, failed.stated_cost) == ("out of reach", np.inf, np.inf)


def test_a_person_sets_whole_millimetres_and_degrees_within_the_region():
    bounds = Region((0.5, 0.0, 7.25, 0.0, 0.0), (99.4, 10.0, 7.25, 10.0, 0.0))
    assert bounds.free == [0, 1, 3]
    np.testing.assert_array_equal(bounds.rounded(np.array([0.2, 3.6, 7.25, 2.4, 0.0])), [0.5, 4.0, 7.25, 2.0, 0.0])
    np.testing.assert_array_equal(bounds.rounded(np.array([99.6, 12.0, 7.25, -3.0, 0.0])), [99.4, 10.0, 7.25, 0.0, 0.0])
    np.testing.assert_array_equal(bounds.clip(np.array([99.6, 3.6, 9.0, 2.4, 5.0])), [99.4, 3.6, 7.25, 2.4, 0.0])
