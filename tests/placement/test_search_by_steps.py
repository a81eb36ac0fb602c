"""The search of a region place by place: every judged place in order, against a search in plain steps."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from postproc.placement import drive, region
from postproc.placement.region import Assessment, JudgedPlace, Region

SIDES = {"X": 6, "Y": 6, "Z": 4, "A": 5, "E1": 4}


class Landscape:
    """Programs with several best places, places that are refused, and a record of all that are judged."""

    def __init__(self, seed, today):
        rng = np.random.default_rng(seed)
        self.centres = rng.uniform([900, -400, 400, -40, -200], [1700, 400, 800, 40, 200], (4, 5))
        self.depths, self.holes = rng.uniform(1e-4, 1.3e-4, 4), rng.uniform(0.1, 0.35, 4)
        self.robot_in_cell = SimpleNamespace(
            cell=SimpleNamespace(base=SimpleNamespace(**dict(zip("XYZA", today[:4], strict=True))))
        )
        self.calls = []

    def value(self, place, all_samples):
        distance = np.linalg.norm((place - self.centres) / [400.0, 400.0, 200.0, 40.0, 200.0], axis=1)
        error = float((self.depths * (1.0 + distance**2)).min())
        margin = float(0.2 + 0.1 * np.sin(0.05 * place.sum()))
        is_refused = distance[0] < self.holes[0] + 0.1 * all_samples or distance[1] < self.holes[1]
        return JudgedPlace(tuple(place), drive.LIMIT if is_refused else drive.FREE, 2.0 * error, error, margin)

    def judge(self, place, *, all_samples=False):
        self.calls.append((tuple(place), all_samples))
        return self.value(place, all_samples)


def inside(bounds, place):
    return np.minimum(np.maximum(place, bounds.low), bounds.high)


def rounded(bounds, place):
    whole = [round(v) if bounds.high[k] > bounds.low[k] else v for k, v in enumerate(place)]
    return inside(bounds, np.array(whole, dtype=float))


def by_steps(programs, bounds, today, assess):
    """Return the calls in order, and the best place."""
    calls = [(tuple(today), True)]
    assessed = 0
    sides = [
        np.linspace(bounds.low[k], bounds.high[k], SIDES[axis]) if bounds.high[k] > bounds.low[k] else [bounds.low[k]]
        for k, axis in enumerate(SIDES)
    ]
    trials = []

    def judge(place):
        calls.append((tuple(place), False))
        trials.append(programs.value(np.array(place), False))
        return trials[-1]

    for place in itertools.product(*sides):
        judge(place)
    best = min(trials, key=lambda trial: trial.cost)
    centre = best.place if best.reachable else tuple(0.5 * (np.array(bounds.low) + np.array(bounds.high)))
    if len(sides[0]) > 1 and len(sides[1]) > 1:
        for x, y in itertools.product(*(np.linspace(bounds.low[k], bounds.high[k], 15) for k in (0, 1))):
            judge((x, y, *centre[2:]))
    starts = sorted([trial for trial in trials if trial.reachable], key=lambda trial: trial.cost)[:4]
    for start in starts:
        best, steps = start, [0.5 * (side[1] - side[0]) if len(side) > 1 else 0.0 for side in sides]
        for _ in range(5):
            improved = True
            while improved:
                improved = False
                for k in [k for k in range(5) if len(sides[k]) > 1]:
                    for sign in (1.0, -1.0):
                        place = np.array(best.place)
                        place[k] += sign * steps[k]
                        place = rounded(bounds, place)
                        if place[k] == best.place[k]:
                            continue
                        trial = judge(place)
                        if trial.cost < 0.999 * best.cost:
                            best, improved = trial, True
                            break
            steps = [0.5 * step for step in steps]
    free = sorted([trial for trial in trials if trial.reachable], key=lambda trial: trial.cost)
    alike = [trial for trial in free if trial.cost <= 1.01 * free[0].cost]
    order = sorted(alike, key=lambda trial: -trial.margin) + [trial for trial in free if trial not in alike]
    chosen, refused, assessed = None, [], 0
    span = np.subtract(bounds.high, bounds.low)
    for trial in order:
        gaps = [(np.abs(np.subtract(trial.place, other)), share) for other, share in refused]
        if any(((gap < share * span) | (span == 0.0)).all() for gap, share in gaps):
            continue
        place = rounded(bounds, np.array(trial.place))
        calls.append((tuple(place), True))
        exact = programs.value(place, True)
        if exact.reachable and (not assess or assess(exact).problem == ""):
            chosen = exact
            break
        assessed += exact.reachable
        refused.append((place, 0.1 if exact.reachable else 1.0 / 30.0))
        if len(refused) == 200 or assessed == 8:  # there is one error: "a limit"
            break
    return calls, chosen, centre


@pytest.mark.parametrize("with_assessments", [False, True])
@pytest.mark.parametrize("free", ["XYZAE", "XY", "XA", "E", "YZ"])
@pytest.mark.parametrize("seed", range(2))
def test_places_are_judged_in_the_order_of_grid_slice_and_compass(seed, free, with_assessments):
    low, high = np.array([900.0, -300.0, 500.0, -30.0, -100.0]), np.array([1650.5, 310.0, 700.0, 30.0, 100.0])
    is_free = np.array([letter in free for letter in "XYZAE"])
    bounds = Region(tuple(low.tolist()), tuple(np.where(is_free, high, low).tolist()))
    today = np.array([800.0, 0.0, 500.0, 0.0, 0.0])
    programs = Landscape(seed, today)

    def assess(place):
        problem = "a limit" if sum(place.place) % 3.0 < 2.0 else ""
        return Assessment(place.deflection, None, 1.1 * place.u95, None, problem)

    rule = assess if with_assessments else None
    search = region.search(programs, bounds, assess=rule)
    calls, chosen, centre = by_steps(Landscape(seed, today), bounds, today, rule)
    assert len(programs.calls) == len(calls)
    np.testing.assert_allclose([place for place, _ in programs.calls], [place for place, _ in calls], atol=1e-9)
    assert [all_samples for _, all_samples in programs.calls] == [all_samples for _, all_samples in calls]
    assert (search.best is None) == (chosen is None)
    assert chosen is None or search.best.place == chosen.place
    np.testing.assert_allclose(search.slice_place, centre)
    assert len(search.trials) == sum(not all_samples for _, all_samples in calls)
    if with_assessments and chosen is not None:
        assert search.best.stated_cost == pytest.approx(1.1 * chosen.u95)
