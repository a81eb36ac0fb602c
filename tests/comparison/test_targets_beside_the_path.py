"""Targets without a partner against dense points of the paths: which are on the way, and by how much others miss it."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.comparison import partners
from postproc.comparison.paths import PlacedProgram, in_cell
from postproc.errors import ForceError, NotConvergedError
from postproc.program import LIN, PTP
from postproc.under_load import RobotInCell
from tests.comparison.test_named import CELL, ROBOT
from tests.programs import program

PLACE = RobotInCell.of(ROBOT, CELL)
DOWN = CELL.tool_orientation()
DENSE = np.linspace(0.0, 1.0, 801)


def zigzag(rng, count):
    """Corners of a path in millimetres, the first one by joints."""
    return np.cumsum(np.vstack([[0.0, 0.0, 50.0], rng.uniform(-30.0, 30.0, (count - 1, 3))]), axis=0)


def placed(points, kinds):
    names = {LIN: "LIN", PTP: "PTP"}
    made = program([(names[int(kind)], *point) for point, kind in zip(points, kinds, strict=True)], orientation=DOWN)
    made = replace(made, bases=CELL.base.pose()[None], tools=CELL.tool.pose()[None])
    return PlacedProgram.of(made, PLACE)


def on_the_way(path, first, last):
    """Dense points of a path [m], from the end of a motion to that of another, in the cell."""
    lengths = path.arc_length[first + 1] + DENSE * (path.arc_length[last + 1] - path.arc_length[first + 1])
    return path.points(np.maximum(lengths, 1e-12))


@pytest.mark.parametrize("seed", range(12))
def test_a_target_is_on_the_path_within_a_tenth_of_a_millimetre_and_three_offsets(seed):
    """Of the pairs next to it; on lines of the way to a pair on which no joint interpolation is."""
    rng = np.random.default_rng(seed)
    points = zigzag(rng, 7)
    nominal_kinds = np.where(rng.random(7) < 0.15, PTP, LIN)
    nominal_kinds[0] = PTP
    inserted, rows, pair, kinds = [], [], [], []
    distance = rng.choice([2e-5, 1e-4], 7)
    for k, point in enumerate(points):
        if k and rng.random() < 0.7:
            share, off = rng.uniform(0.2, 0.8), rng.choice([0.05, 0.09, 0.2, 0.35, 0.6, 3.0])
            along = point - points[k - 1]
            across = np.cross(along, rng.normal(size=3))
            rows.append(len(inserted))
            inserted.append(points[k - 1] + share * along + off * across / np.linalg.norm(across))
            kinds.append(PTP if rng.random() < 0.2 else LIN)
        pair.append((k, len(inserted)))
        inserted.append(point)
        kinds.append(int(nominal_kinds[k]))
    nominal, second = placed(points, nominal_kinds), placed(np.array(inserted), kinds)
    pairs, rows = np.array(pair), np.array(rows, dtype=int)
    found = partners._is_on_path(nominal, second, pairs, distance, rows)
    for n, row in enumerate(rows):
        k = int(sum(pairs[:, 1] < row))
        if nominal_kinds[k] == PTP:
            assert not found[n]
            continue
        spot = in_cell(second.program, np.array([row]), second.program.motions.target.position[[row]])
        gap = np.linalg.norm(on_the_way(nominal, pairs[k - 1, 0], pairs[k, 0]) - spot, axis=1).min()
        limit = 1e-4 + 3.0 * max(distance[k - 1], distance[k])
        if abs(gap - limit) > 1e-5:
            assert found[n] == (gap <= limit)
    behind = np.array([len(inserted) - 1])
    assert not partners._is_on_path(nominal, second, pairs[:-1], distance[:-1], behind)[0]


@pytest.mark.parametrize(
    ("inserted", "kinds", "partner", "moved"),
    [
        ([(20, 0), (40, 2)], [LIN, PTP], 2, 3), ([(40, 2), (60, 0)], [PTP, LIN], 3, 2),
        ([(-30, 0), (40, 2)], [LIN, PTP], 2, 2),
    ],
)  # fmt: skip
def test_a_target_that_was_moved_takes_its_partner_back_from_a_point_of_the_path(inserted, kinds, partner, moved):
    """The third target became a PTP 2 mm beside it; its partner is an inserted point before or behind that one.

    Not where this point would be off the path.
    """
    points = np.array([[0.0, 0, 50], [0, 0, 0], [40, 0, 0], [80, 0, 0]])
    between = np.hstack([np.array(inserted, dtype=float), np.zeros((2, 1))])
    nominal = placed(points, [PTP, LIN, LIN, LIN])
    second = placed(np.vstack([points[:2], between, points[3:]]), [PTP, LIN, *kinds, LIN])
    pairs = np.array([0, 1, partner, 4])
    found = partners.pair_targets(nominal, second, pairs, np.zeros(4, dtype=bool))
    assert found.pair[:, 1].tolist() == [0, 1, moved, 4]
    assert found.additional_rows.tolist() == []  # 3 times the offsets of the pairs beside it are large here
    stated = partners.pair_targets(nominal, second, pairs, np.ones(4, dtype=bool))
    assert stated.pair[:, 1].tolist() == pairs.tolist()


def test_a_last_target_that_was_moved_takes_its_partner_back_from_a_point_before_it():
    points = np.array([[0.0, 0, 50], [0, 0, 0], [40, 0, 0], [80, 0, 0]])
    nominal = placed(points, [PTP, LIN, LIN, LIN])
    second = placed(np.array([*points[:3], [60.0, 0, 0], [80, 3, 0]]), [PTP, *[LIN] * 4])
    found = partners.pair_targets(nominal, second, np.arange(4), np.zeros(4, dtype=bool))
    assert found.pair[:, 1].tolist() == [0, 1, 2, 4]
    assert (found.inserted_rows.tolist(), found.additional_rows.tolist()) == ([3], [])


@pytest.mark.parametrize("seed", range(12))
def test_a_missing_target_is_missed_by_its_distance_from_the_way_between_its_pairs(seed):
    """Moved by the offset that the pairs next to it have in proportion to the path; unknown for joint targets."""
    rng = np.random.default_rng(seed)
    points = zigzag(rng, 9)
    kinds = np.where(rng.random(9) < 0.15, PTP, LIN)
    kinds[0] = PTP
    kept = np.sort(rng.choice(np.arange(1, 8), 4, replace=False))
    offset_mm = rng.normal(0.0, 0.5, (4, 3))
    others = points[kept] + offset_mm
    nominal, second = placed(points, kinds), placed(others, [PTP, *[LIN] * 3])
    pairs = np.stack([kept, np.arange(4)], axis=1)
    missing = np.setdiff1d(np.arange(9), kept)
    turn = nominal.program.bases[0][:3, :3]
    offset = 1e-3 * offset_mm @ turn.T
    found = partners.missing_distances(nominal, second, pairs, missing, None, offset)
    lengths = nominal.arc_length[kept + 1]
    for n, row in enumerate(missing):
        if kinds[row] == PTP:
            assert np.isnan(found[n])
            continue
        at = nominal.arc_length[row + 1]
        moved = nominal.points(np.array([at]))[0] + [np.interp(at, lengths, column) for column in offset.T]
        after = int(sum(kept < row))
        begin = second.arc_length[after] if after else 0.0
        end = second.arc_length[after + 1] if after < 4 else second.arc_length[-1]
        way = second.points(np.maximum(begin + DENSE * (end - begin), 1e-12))
        assert found[n] == pytest.approx(np.linalg.norm(way - moved, axis=1).min(), abs=3e-5)
    assert np.isnan(partners.missing_distances(nominal, second, pairs[:0], missing, None, offset[:0])).all()


def test_a_missing_target_whose_force_the_arm_does_not_hold_is_named_by_its_line(monkeypatch):
    points = np.array([[0.0, 0, 50], [0, 0, 0], [40, 0, 0], [80, 0, 0], [120, 0, 0]])
    nominal, second = placed(points, [PTP, *[LIN] * 4]), placed(points[[0, 1, 4]], [PTP, LIN, LIN])

    def loaded_tip(path, motion, q, wrench, displacement):
        raise NotConvergedError("too large", np.flatnonzero(motion == 3))

    monkeypatch.setattr(PlacedProgram, "loaded_tip", loaded_tip)
    pairs, missing = np.array([[0, 0], [1, 1], [4, 2]]), np.array([2, 3])
    with pytest.raises(ForceError) as refused:
        partners.missing_distances(nominal, second, pairs, missing, nominal.forces(None), np.zeros((3, 3)))
    assert refused.value.line == nominal.program.motions.line[3]


@pytest.mark.parametrize("seed", range(8))
def test_a_path_has_the_positions_of_its_corners_at_its_arc_lengths(seed):
    rng = np.random.default_rng(seed)
    points = zigzag(rng, 6)
    path = placed(points, [PTP, *[LIN] * 5])
    base = path.program.bases[0]
    corners = 1e-3 * points @ base[:3, :3].T + base[:3, 3]
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    np.testing.assert_allclose(np.diff(path.arc_length)[1:], steps, rtol=1e-9)
    for k in range(1, 6):
        for share in (0.25, 1.0):
            length = path.arc_length[k + 1] if share == 1.0 else path.arc_length[k] + share * steps[k - 1]
            expected = corners[k - 1] + share * (corners[k] - corners[k - 1])
            np.testing.assert_allclose(path.points(np.array([length]))[0], expected, atol=1e-9)
            motion, t = path.at(np.array([length]))
            assert (motion[0], t[0]) == (k, pytest.approx(share))


def test_a_path_that_begins_with_a_line_has_places_on_it():
    path = placed(np.array([[0.0, 0.0, 50.0], [30.0, 0.0, 50.0]]), [LIN, LIN])
    begin = (PLACE.start_flange @ path.program.tools[0])[:3, 3]
    corner = (path.program.bases[0] @ [0.0, 0.0, 0.05, 1.0])[:3]
    size = np.linalg.norm(corner - begin)
    assert path.arc_length[1] == pytest.approx(size)
    for share in (0.0, 0.3, 1.0):
        motion, t = path.at(np.array([share * path.arc_length[1]]))
        assert (motion[0], t[0]) == (0, pytest.approx(max(share, 1e-9)))
        np.testing.assert_allclose(
            path.points(np.array([share * size]))[0], begin + share * (corner - begin), atol=1e-8
        )
    motion, t = path.at(np.array([path.arc_length[2] + 1.0]))
    assert (motion[0], t[0]) == (1, 1.0)
