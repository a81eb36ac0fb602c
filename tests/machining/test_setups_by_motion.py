"""Set-ups of random programs, motion by motion: tilts in a plane have the middle of the outermost two as their cone."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from postproc.errors import ForceError
from postproc.machining import setups
from postproc.machining.setups import Setup
from postproc.machining.tool_path import Directions
from tests.programs import program

WIDEST = 37.5
"""Between the half angles of tilts in tens of degrees [deg]: 35 fits, and 40 does not."""


def tilted(degrees):
    angle = np.radians(degrees)
    return np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=-1)


class Tilts:
    """A program whose tool tilts about Y: at the ends of its motions, and within some of them."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        count = int(rng.integers(4, 24))
        self.cuts = rng.random(count) < 0.75
        runs = np.cumsum(rng.random(count) < 0.2)
        tens = rng.integers(-9, 10, count) if seed % 3 == 0 else np.cumsum(rng.integers(-2, 3, count))
        is_even = rng.random(runs.max() + 1) < 0.5
        self.end = np.where(is_even[runs], 10 * tens[runs], 10 * tens)
        self.end = np.clip(self.end, -90, 90) + 0.2 * rng.choice([-1, 0, 1], count)
        self.inner = {}
        for motion in np.flatnonzero(rng.random(count) < 0.25 * (seed % 2)).tolist():
            largest = 9 if seed % 5 == 1 else 3
            self.inner[motion] = np.clip(self.end[motion] + 10 * rng.integers(-largest, largest + 1, 4), -90, 90)

    def directions(self):
        inner = tilted(np.array(list(self.inner.values()), dtype=float).reshape(-1, 4).T)
        return Directions(tilted(self.end), self.cuts, np.array(list(self.inner), dtype=np.int64), inner)

    def among(self, begin, end):
        """Tilts on the cutting motions of a range."""
        cuts = [k for k in range(begin, min(end, len(self.cuts))) if self.cuts[k]]
        return [tilt for k in cuts for tilt in [self.end[k], *self.inner.get(k, ())]]

    def setups(self):
        """First motion and tilt of each map, or the motion that turns too far."""
        maps: list[tuple[int, float]] = []
        k = 0
        while k < len(self.cuts):
            if not self.cuts[k]:
                k += 1
                continue
            end = next((n for n in range(k, len(self.cuts)) if not self.cuts[n]), len(self.cuts))
            if all(abs(tilt - self.end[k]) < 0.5 for tilt in self.among(k, end)):
                if not maps or abs(self.end[k] - maps[-1][1]) > 0.5:
                    maps.append((k, self.end[k]))
                k = end
                continue
            while k < end:
                if not maps or any(abs(tilt - maps[-1][1]) > WIDEST for tilt in self.among(k, k + 1)):
                    count = len(self.cuts) - k
                    while np.ptp(self.among(k, k + count)) > 2.0 * WIDEST:
                        if count == 1:
                            return k
                        count = -(-count // 2)
                    tilts = self.among(k, k + count)
                    maps.append((k, 0.5 * (min(tilts) + max(tilts))))
                k += 1
        return maps


@pytest.mark.parametrize("seed", range(60))
def test_set_ups_are_those_of_a_count_motion_by_motion(seed):
    tilts = Tilts(seed)
    made = program([("LIN", 10 * k, 0, 0) for k in range(len(tilts.cuts))])
    expected = tilts.setups()
    if not tilts.cuts.any():
        expected = None
    if not isinstance(expected, list):
        with pytest.raises(ForceError) as refused:
            setups.setups(made, tilts.directions(), np.radians(WIDEST))
        if expected is not None:
            assert f"part.nc:{expected + 1}: the tool turns by more than 75° in one cutting move" in str(refused.value)
            assert "Divide the move." in str(refused.value)
        return
    parts = setups.setups(made, tilts.directions(), np.radians(WIDEST))
    first = [0, *(start for start, _ in expected[1:]), len(tilts.cuts)]
    assert [np.flatnonzero(part.motions).tolist() for part in parts] == [
        list(range(*span)) for span in itertools.pairwise(first)
    ]
    found = [np.degrees(np.arctan2(part.frame[0, 2], part.frame[2, 2])) for part in parts]
    np.testing.assert_allclose(found, [tilt for _, tilt in expected], atol=1.5)
    assert [part.factor for part in parts] == [1] * len(parts)


def test_the_programs_of_this_file_have_set_ups_of_all_kinds():
    kinds = {
        type(found) if not isinstance(found, list) else len(found) for found in (Tilts(s).setups() for s in range(60))
    }
    assert kinds >= {int, 1, 2, 3, 4}


@pytest.mark.parametrize("seed", range(30))
def test_cells_of_a_motion_are_divided_by_the_largest_factor_up_to_it(seed):
    """A set-up is divided where a factor begins, but a part without a cut is joined with the next one."""
    rng = np.random.default_rng(seed)
    cuts = rng.random(20) < 0.5
    bounds = [0, int(rng.integers(4, 12)), 20]
    cuts[[bounds[1] - 1, 19]] = True
    factors = {int(first): int(rng.integers(2, 6)) for first in rng.choice(20, 5, replace=False)}
    number = np.arange(20)
    in_order = [Setup(np.eye(4) * n, (number >= bounds[n]) & (number < bounds[n + 1])) for n in (0, 1)]
    expected = []
    for n in (0, 1):
        begin = bounds[n]
        for motion in [*range(bounds[n] + 1, bounds[n + 1]), bounds[n + 1]]:
            is_border = motion in factors or motion == bounds[n + 1]
            if is_border and cuts[begin:motion].any():
                first_cut = begin + int(np.argmax(cuts[begin:motion]))
                factor = max([1, *(value for first, value in factors.items() if bounds[n] <= first <= first_cut)])
                expected.append((n, list(range(begin, motion)), factor))
                begin = motion
    parts = setups.divide_by_cells(in_order, factors, cuts)
    found = [(int(part.frame[0, 0]), np.flatnonzero(part.motions).tolist(), part.factor) for part in parts]
    assert found == expected


@pytest.mark.parametrize("seed", range(12))
def test_x_of_a_map_is_the_nearest_direction_to_x_of_the_base(seed):
    """To y where the tool is within 26° of x."""
    direction = np.random.default_rng(seed).normal(size=3) * [1.0 + 3.0 * (seed % 2), 1.0, 1.0]
    direction /= np.linalg.norm(direction)
    frame = setups._frame(direction)
    along = np.array([1.0, 0.0, 0.0]) if abs(direction[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = along - (along @ direction) * direction
    np.testing.assert_allclose(frame[:3, 2], direction, atol=1e-12)
    np.testing.assert_allclose(frame[:3, 0], x / np.linalg.norm(x), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert frame[3].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert not frame[:3, 3].any()


def test_directions_without_a_middle_turn_too_far():
    """Opposite directions: their sum is zero."""
    opposite = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])[:, None]
    along = Directions(np.array([[0.0, 0.0, 1.0]]), np.ones(1, dtype=bool), np.zeros(1, dtype=np.int64), opposite)
    with pytest.raises(ForceError, match="turns by more than 75° in one cutting move"):
        setups.setups(program([("LIN", 0, 0, 0)]), along, np.radians(WIDEST))


@pytest.mark.parametrize(("tilt", "is_upright"), [(4e-5, True), (5e-5, False)])
def test_a_tool_that_leans_by_rounding_has_a_map_along_the_axes(tilt, is_upright):
    frame = setups._frame(np.array([np.sin(tilt), 0.0, np.cos(tilt)]))
    assert (frame == np.eye(4)).all() == is_upright
