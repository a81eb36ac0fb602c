"""Mean of a turn against the formulas of the edge, summed finely, and against teeth that turn.

What is in material is given here by angles and heights: no map of the stock is asked.
"""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.integrate import quad

from postproc.machining import cutting
from postproc.machining.cutting import EngagedEdge
from postproc.machining.material import CuttingLaw
from postproc.machining.tool import Cutter, Turn, _covered_parts, edge
from tests.machining.setting import forces, gcode, process, tool

LINEAR = CuttingLaw((800e6, 500e6, -300e6), (30e3, -20e3, 12e3), 0.0, 0.1, "linear")
KIENZLE = CuttingLaw((900e6, 400e6, 250e6), (0.0, 0.0, 0.0), 0.25, 0.1, "Kienzle")
FLAT, BALL, BULL = Cutter(5e-3, 0.0, 3), Cutter(5e-3, 5e-3, 2), Cutter(8e-3, 2e-3, 5)
DRILL = Cutter(4e-3, 0.0, 2, drill=True)
TOP = 7e-3
"""Height of material above the tip [m]."""


def turn_of(cutter, law=LINEAR, step=0.2e-3, descent=0.0):
    return Turn.of(edge(cutter, step), cutter, law, step, descent)


def engaged_of(turn, begin, end, *, in_part=True):
    """Edge in material between two angles, up to `TOP` above the tip."""
    over = np.minimum(turn.phi + 0.5 * turn.width, end) - np.maximum(turn.phi - 0.5 * turn.width, begin)
    inside = np.clip(over / turn.width, 0.0, 1.0) if in_part else (turn.phi > begin) & (turn.phi < end)
    rise = np.where(turn.rise > 0.0, turn.rise, 1.0)
    share = np.where(turn.rise > 0.0, np.clip((TOP - turn.low) / rise, 0.0, 1.0), 1.0)
    length = np.where(np.isfinite(turn.rise), turn.length * share, TOP - turn.low) * inside
    start = turn.low[turn.side].astype(float)
    moment = 0.5 * (TOP**2 - start**2) * inside[turn.side]
    return EngagedEdge(length[None].astype(np.float32), moment[None].astype(np.float32))


def edge_force(law, chip, phi, kappa, rubbing=1.0):
    """Forces (..., 3) per length of edge, of the docstring of `cutting`: x along the feed, z to the spindle [N/m]."""
    sin, cos, sk, ck, zero = np.sin(phi), np.cos(phi), np.sin(kappa), np.cos(kappa), 0.0 * (phi + kappa)
    cut = np.maximum(chip, 1e-15)
    size = [k * cut * (cut * 1e3) ** -law.exponent + e * rubbing for k, e in zip(law.cutting, law.edge, strict=True)]
    tangential, radial, axial = (np.where(chip > 1e-12, each, 0.0)[..., None] for each in size)
    normal = np.stack([sk * sin, sk * cos, zero - ck], axis=-1)
    along = np.stack([ck * sin, ck * cos, zero + sk], axis=-1)
    return tangential * np.stack([zero - cos, zero + sin, zero], axis=-1) - radial * normal + axial * along


def pieces_of(cutter, count, *, face):
    """Middles of pieces of edge in material: distance from the axis, height, length, angle of the normal; (P,) each."""
    flat, middles, columns = cutter.radius - cutter.corner, (np.arange(count) + 0.5) / count, []
    if not cutter.drill and cutter.corner < TOP:
        height = TOP - cutter.corner
        columns.append((np.full(count, cutter.radius), cutter.corner + height * middles, height, 0.5 * np.pi))
    if cutter.corner > 0.0:
        most = np.arccos(np.clip(1.0 - TOP / cutter.corner, 0.0, 1.0))
        kappa = most * middles
        height = cutter.corner * (1.0 - np.cos(kappa))
        columns.append((flat + cutter.corner * np.sin(kappa), height, cutter.corner * most, kappa))
    if flat > 0.0 and face:
        columns.append((flat * middles, np.zeros(count), flat, 0.0))
    parts = [np.broadcast_arrays(one, two, length / count, kappa) for one, two, length, kappa in columns]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def mean_by_sums(cutter, law, feed, descent, begin, end, rubbing):
    """Mean wrench about the tip (6,) and the volume that a tooth takes in a turn [m³]."""
    if cutter.drill:  # 1.3 times the feed force of tool makers, half the tangential force
        cut, rub = ((tangential, 0.65 * tangential, axial) for tangential, _, axial in (law.cutting, law.edge))
        law = replace(law, cutting=cut, edge=rub)
    distance, height, length, kappa = pieces_of(cutter, 30, face=descent > 0.0)
    count = 360
    phi = (begin + (np.arange(count) + 0.5) / count * (end - begin))[:, None]
    chip = feed * np.sin(kappa) * np.sin(phi) + descent * np.cos(kappa)
    force = edge_force(law, chip, phi, kappa, np.where(kappa > 0.0, 1.0, rubbing)) * length[:, None]
    point = np.stack([distance * np.sin(phi), distance * np.cos(phi), height + 0.0 * phi], axis=-1)
    whole = np.concatenate([force.sum(axis=(0, 1)), np.cross(point, force).sum(axis=(0, 1))])
    width = (end - begin) / count
    return whole * width * cutter.teeth / (2.0 * np.pi), (np.maximum(chip, 0.0) * distance * length).sum() * width


CASES = [
    (FLAT, 1e-4, 0.0), (BALL, 1e-4, 0.0), (BULL, 0.6e-4, 0.0), (FLAT, 1e-4, 2e-5), (BULL, 0.8e-4, 3e-5),
    (BALL, 1e-4, 4e-5), (BALL, 1e-4, -3e-5), (DRILL, 0.0, 6e-5), (FLAT, 0.0, 5e-5),
]  # fmt: skip


@pytest.mark.parametrize("law", [LINEAR, KIENZLE], ids=lambda law: law.name)
@pytest.mark.parametrize(("cutter", "feed", "descent"), CASES)
@pytest.mark.parametrize(("begin", "end"), [(0.0, 2.0 * np.pi), (0.4, 1.3), (1.9, 3.6)])
def test_mean_wrench_and_volume_are_the_integrals_of_the_formulas(law, cutter, feed, descent, begin, end):
    steep = descent / np.hypot(feed, descent)
    turn = turn_of(cutter, law, descent=steep)
    n = np.ones(1, dtype=np.float32)
    chip = cutting.chips(turn, n * np.float32(feed), n * np.float32(descent))
    rubbing = 0.3
    found = cutting.mean_loads(
        turn, engaged_of(turn, begin, end), chip, np.float32(rubbing) * n, 2.5e-4, turn.normal_down
    )
    expected, volume = mean_by_sums(cutter, law, feed, descent, begin, end, rubbing)
    lever = np.linalg.norm(expected[:3]) * cutter.radius
    np.testing.assert_allclose(found.wrench[0, :3], expected[:3], atol=0.01 * np.linalg.norm(expected[:3]))
    np.testing.assert_allclose(found.wrench[0, 3:], expected[3:], atol=0.01 * max(lever, np.linalg.norm(expected[3:])))
    assert found.removal[0] == pytest.approx(volume, rel=0.01)


def test_the_edge_that_moves_into_the_material_near_the_tip_is_the_integral_over_its_rings():
    """On a ball that goes down by an angle, a ring within that angle cuts along all of its circle."""
    turn, outermost = turn_of(BALL, step=0.25e-3, descent=0.25), 7 * float(edge(BALL, 0.25e-3).bend[0])
    pieces, n = turn.radius < BALL.radius * np.sin(outermost), np.ones(1, dtype=np.float32)
    kappa, errors = (np.arange(4000) + 0.5) * outermost / 4000, []
    for angle in np.radians(np.linspace(-14.0, 14.0, 57)):
        chip = cutting.chips(turn, n * np.float32(1e-4 * np.cos(angle)), n * np.float32(1e-4 * np.sin(angle)))
        length = np.sum((chip.share[0] * turn.length * turn.width)[pieces])
        circle = np.pi + 2.0 * np.arcsin(np.clip(np.tan(angle) / np.tan(kappa), -1.0, 1.0))
        errors.append(length / (BALL.radius * outermost * circle.mean()) - 1.0)
    assert np.sqrt(np.mean(np.square(errors))) < 0.015  # 0.035 by the middles of pieces alone


def test_products_in_pieces_are_products():
    rng = np.random.default_rng(1)
    for rows, inner, columns in ((1, 5, 3), (1000, 700, 6), (0, 4, 2), (3, 300_000, 1)):
        one, other = rng.normal(size=(rows, inner)), rng.normal(size=(inner, columns))
        np.testing.assert_allclose(cutting.product_in_blocks(one, other), one @ other, atol=1e-9)


def test_the_law_of_the_chip_is_that_of_kienzle():
    chip = np.array([0.0, 1e-6, 5e-5, 1e-3, 2e-3, -1e-5], dtype=np.float32)
    found = KIENZLE.cutting[0] * KIENZLE.chip_factor(chip).astype(float)
    expected = [0.0, *(900e6 * (h * 1e3) ** -0.25 * h for h in (1e-6, 5e-5, 1e-3, 2e-3)), 0.0]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    np.testing.assert_allclose(LINEAR.chip_factor(chip), np.maximum(chip, 0.0))


def test_the_edge_is_as_long_as_the_profile_and_as_high():
    for cutter in (FLAT, BALL, BULL, DRILL, Cutter(5e-3, 4.9e-3, 2)):
        for step in (0.05e-3, 1e-3):
            found = edge(cutter, step)
            below = found.kappa < 1.5707
            profile = (cutter.radius - cutter.corner) + 0.5 * np.pi * cutter.corner
            assert found.length[below].sum() == pytest.approx(profile)
            assert found.rise[below].sum() == pytest.approx(cutter.corner)
            corner = found.part == 1
            np.testing.assert_allclose(
                cutter.lower_side(found.radius[corner]),
                found.low[corner] + 0.5 * found.rise[corner],
                atol=step**2 / 5e-3,
            )
            assert (np.diff(found.low[corner]) > 0).all()
            assert np.abs(
                quad(lambda x, c=cutter: c.lower_side(np.array([x]))[0], 0, cutter.radius)[0]
            ) == pytest.approx(cutter.corner**2 * (1 - np.pi / 4), abs=1e-9)


def test_a_place_covers_the_parts_of_a_turn_whose_middles_are_within_it():
    rng, turn = np.random.default_rng(3), 2.0 * np.pi
    phi, width = rng.uniform(0.0, turn, 12), rng.uniform(0.05, 0.9, 12) * turn
    found = _covered_parts(phi, width, 24)
    for place in range(len(phi)):
        for part in range(24):
            middles = (part + 0.5) * turn / 24 + np.arange(-8, 9) * turn
            there = bool((np.abs(middles - phi[place]) < 0.5 * width[place]).any())
            assert found[place, part] == there


@pytest.mark.parametrize(
    ("shape", "block", "cells"),
    [
        ("flat", "G1 X20 F2400", 0.5),  # the cylinder alone: finer
        ("ball", "G1 X20 F2400", 1.0),
        ("flat", "G1 X20 Z-4 F2400", 1.0),  # on a ramp the end face cuts too
    ],
)
def test_points_of_the_edge_are_a_cell_apart_at_the_rim_and_half_of_one_on_a_cylinder(
    tmp_path, monkeypatch, shape, block, cells
):
    steps, honest = [], Turn.of.__func__

    def of(cls, *given):
        steps.append(given[3])
        return honest(cls, *given)

    monkeypatch.setattr(Turn, "of", classmethod(of))
    text = gcode("G0 X-10 Y-3 Z5", "G0 Z-3", block)
    forces(tmp_path, text, process(tool(10, 2, shape), ((0, 40), (-20, 20), (-20, 0)), resolution=0.5))
    assert steps
    np.testing.assert_allclose(steps, cells * 0.5e-3)


@pytest.mark.parametrize("is_drill", [False, True])
@pytest.mark.parametrize("axis", range(3))
def test_unit_wrenches_are_those_of_a_law_with_one_coefficient(axis, is_drill):
    """Forces are linear in the coefficients; a drill has no radial one of its own."""
    cutter, covariance = Cutter(5e-3, 0.0 if is_drill else 2e-3, 2, is_drill), tuple(map(tuple, np.eye(6)))
    unit = tuple(float(k == axis) for k in range(3))
    made_law = CuttingLaw(cutting=unit, edge=unit, exponent=0.0, sigma=0.0, name="", covariance=covariance)
    turn = Turn.of(edge(cutter, 5e-4), cutter, made_law, 5e-4, 0.4)
    np.testing.assert_array_equal(turn.unit_wrench[axis], turn.cut_wrench)
    assert turn.unit_wrench.shape == (3, len(turn.phi), 6)
    assert np.abs(turn.cut_wrench).any() == (axis != 1 or not is_drill)


@pytest.mark.parametrize("descent", [0.0, 0.2, 0.7, -0.3])
@pytest.mark.parametrize("corner", [5e-3, 2e-3])
def test_points_of_a_turn_are_those_where_an_end_of_the_piece_moves_into_the_material(corner, descent):
    """The chip is the component of the feed along the normal, in the middle of a piece of edge and at its ends."""
    cutter, level = Cutter(5e-3, corner, 2), np.sqrt(1.0 - descent**2)
    pieces = edge(cutter, 1e-3)
    every, kept = (Turn.of(pieces, cutter, LINEAR, 1e-3, sine) for sine in (None, descent))
    points = zip(every.low, every.radius, strict=True)
    row = np.array([int(np.argmin(np.hypot(pieces.low - low, pieces.radius - radius))) for low, radius in points])
    kappa, half_bend = pieces.kappa[row], 0.5 * pieces.bend[row]
    radial, axial = level * np.sin(every.phi), descent
    chip = radial * np.sin(kappa) + axial * np.cos(kappa)
    chip_by_kappa = radial * np.cos(kappa) - axial * np.sin(kappa)
    has_chip = np.maximum(chip + half_bend * chip_by_kappa, chip - half_bend * chip_by_kappa) > 1e-9
    np.testing.assert_array_equal(kept.phi, every.phi[has_chip])
    np.testing.assert_array_equal(kept.radius, every.radius[has_chip])
    assert 0 < has_chip.sum() < len(has_chip)
