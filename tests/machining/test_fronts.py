"""Forces on random surfaces against exact fronts; and these against a cutter that is turned tooth by tooth."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.fronts import CASES, compared
from tests.machining.setting import AL7075
from tests.oracle import fronts
from tests.oracle.teeth import Teeth

ALLOWED = 0.035
"""RMS of the error as a share of that of the force; the largest of these cases is 0.024."""
CELLS = {"ball R3 wall 0.3": 0.1}
"""Cells of the map [mm] that are not the default: forces of 6 N do not ask for finer ones themselves."""
ON_DEMAND = ("ball R5 wall 0.3",)
"""Cases of `tests.benchmarks.fronts` alone: the map of this one takes half a minute."""
PLACES = {"bull R5 c1 finish 0.3": 3}
"""Places where the force is compared; 12 in other cases, `tests.benchmarks.fronts` has more. Exact fronts of many short
moves take a second each."""


@pytest.mark.parametrize("name", [name for name in CASES if name not in ON_DEMAND])
def test_forces_on_random_surfaces_are_those_of_exact_fronts(tmp_path, name):
    error = compared(tmp_path, CASES[name], np.random.default_rng(5), CELLS.get(name), PLACES.get(name, 12)).error
    print(f"{name}: RMS {100 * error:.1f} %")
    assert error <= ALLOWED


def test_a_thin_pass_down_a_slope_has_no_contact_behind_its_ridge(tmp_path):
    """The rows fall by up to 10°, and meet the ridges of the rows before close to the tip: cells below it count too."""
    comparison = compared(tmp_path, CASES["ball R8 finish 0.5"], np.random.default_rng(52102), cell=0.25, count=25)
    assert comparison.error <= 0.045


@pytest.mark.parametrize(("corner", "drop"), [(0.0, 0.0), (0.0, 0.2), (1.5, 0.2), (5.0, 0.2), (5.0, -0.2)])
def test_exact_fronts_are_those_of_teeth(corner, drop):
    """A second cut beside a first one, straight, down or up: what is left is known without a swept solid."""
    chord = np.array([40.0, 0.0, -40.0 * drop])
    begin, end = np.array([[-10.0, 0, -3], [-10.0, 4, -3]]), np.array([[-10.0, 0, -3], [-10.0, 4, -3]]) + chord
    cutter, heading = fronts.Cutter(5.0, corner, 2, 0.08, 12.0), chord / np.linalg.norm(chord)

    def in_stock(point):
        return point[:, 2] < 0.0

    def left(point):
        off, share = point - begin[0], np.linspace(0.1, 0.9, 201)[:, None]
        distance = np.hypot(off[:, 0] - share * chord[0], off[:, 1])
        return in_stock(point) & ~(off[:, 2] > share * chord[2] + cutter.height(distance) + 1e-6).any(axis=0)

    found = fronts.forces(cutter, begin, end, [(1, 0.5)], np.full(2, 0.1), AL7075, in_stock)[0][0]
    teeth = Teeth(5.0, corner, 2, AL7075, discs=60).side(
        12.0, discs={0.0: 60, 1.5: 42, 5.0: 35}[corner]
    )  # ends at the top
    if corner < 5.0 and drop > 0.0:
        teeth.face(-heading[2], rings=30)
    expected = teeth.wrench(begin[1] + 0.5 * chord, heading, 0.1, left, steps=720 if corner == 0.0 else 360)
    np.testing.assert_allclose(found[:3], expected[:3], atol=0.01 * np.linalg.norm(expected[:3]))
    np.testing.assert_allclose(found[3:], expected[3:], atol=0.01 * np.linalg.norm(expected[3:]))


def test_a_turning_tool_at_rest_is_an_upright_one():
    """Dense poses of an upright ball give the force of its capsules."""
    points = np.stack([np.linspace(-5, 8, 261), np.full(261, 2.0), np.linspace(-1, -2, 261)], axis=-1)
    first = points * (1, 0, 1)
    tip, axes = np.concatenate([first, points]), np.broadcast_to(np.eye(3), (522, 3, 3))
    cutter = fronts.Cutter(3.0, 3.0, 2, 0.06, 6.0)

    def in_stock(point):
        return (point[:, 2] < 0.0) & (point[:, 0] > 0.0)

    moving = fronts.turning_forces(cutter, tip, axes, [461], np.full(522, 0.1), AL7075, in_stock)
    begin = np.concatenate([first[:-1], points[:-1]])
    end = np.concatenate([first[1:], points[1:]])
    fixed, _ = fronts.forces(cutter, begin, end, [(460, 0.0)], np.full(520, 0.1), AL7075, in_stock)
    assert np.linalg.norm(fixed[0, :3]) > 50.0
    np.testing.assert_allclose(moving, fixed, atol=0.01 * np.linalg.norm(fixed[0, :3]), rtol=0.02)
