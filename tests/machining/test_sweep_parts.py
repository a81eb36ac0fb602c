"""Parts of a sweep, each by itself: stations, sample points, engaged edge, records of contact, and tools that lean."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.machining import cutting, leaning, sweep, tilted
from postproc.machining import stock as stocks
from postproc.machining.cutting import EngagedEdge, Loads
from postproc.machining.material import CuttingLaw
from postproc.machining.resolution import CellErrors
from postproc.machining.stock import Footprint
from postproc.machining.sweep import Sweep
from postproc.machining.tool import BOTTOM, CORNER, SIDE, Cutter, Turn, edge
from postproc.machining.tool_path import StraightSegments
from tests.machining.test_cells_by_loop import CELL as MAP_CELL
from tests.machining.test_cells_by_loop import CUTTERS, around, random_stock
from tests.machining.test_tilted_by_pose import direction, is_inside

LAW = CuttingLaw((8e8, 2e8, 1e8), (2e4, 2e4, 1e3), 0.0, 0.1, "made up")
CELL = 1e-3
BOX = (np.array([0.0, 0.0, -0.02]), np.array([0.06, 0.04, 0.0]))


def made_sweep(cutters, cell=CELL, **columns):
    """Return a sweep of a block whose tools have the given cutters; motions have the tool of their number."""
    count = len(cutters)
    tools = SimpleNamespace(
        tool=np.arange(count), rpm=np.full(count, 6000.0), hand=np.ones(count, dtype=int),
        keys=tuple(str(number) for number in range(count)),
    )  # fmt: skip
    given = {
        "stock": stocks.from_box(*BOX, cell), "tools": tools, "law": LAW, "feed": np.full(count, 0.02),
        "swing": np.full(count, 1.0), "cell_error_sums": CellErrors(*np.zeros((4, count))), "poses": None,
        "process": SimpleNamespace(cutter=lambda key: cutters[int(key)], stock=SimpleNamespace(cell=CELL)),
    }  # fmt: skip
    return Sweep(**(given | columns))


def segments_of(begin, end, motion, cutting=True, leans=False, leave=None, arrive=None):
    """Return straight segments between places t of 0.2 and 0.8 of their motions."""
    begin, end = np.array(begin, dtype=float), np.array(end, dtype=float)
    n = len(begin)
    chord = (end - begin) / np.maximum(np.linalg.norm(end - begin, axis=1), 1e-12)[:, None]
    return StraightSegments(
        np.array(motion), np.full(n, 0.2), np.full(n, 0.8), begin, end, chord if leave is None else np.array(leave),
        chord if arrive is None else np.array(arrive), np.full(n, cutting), np.arange(n) > 0, np.full(n, leans),
    )  # fmt: skip


@pytest.mark.parametrize(("most", "cell"), [(100, CELL), (1, 0.2 * CELL), (200_000, CELL)])
def test_stations_of_cuts_are_a_cell_apart_in_the_middle_of_their_parts(monkeypatch, most, cell):
    """Directions change evenly along a segment; chunks are limited, and none is left out. A finer map has no more."""
    monkeypatch.setattr(sweep, "_MOST_POINTS", most)
    seen = []
    made = made_sweep([CUTTERS["flat"]] * 3, cell)
    turn = SimpleNamespace(phi=np.zeros(30))
    monkeypatch.setattr(Sweep, "_turn_points", lambda self, number, position, heading: turn)
    monkeypatch.setattr(Sweep, "_cuts_at", lambda self, *given: seen.append(given) or len(given[2]))
    begin, end = (
        [[9, 9, 9], [0, 0, 0], [0.0041, 0, 0], [0.0041, 0.003, 0]],
        [[9, 9, 9], [0.0041, 0, 0], [0.0041, 0.003, 0], [0.0041, 0.003, -0.0004]],
    )
    leave = [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1.0]]
    arrive = [[1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, -1.0]]
    given = segments_of(begin, end, [0, 1, 1, 2], leave=leave, arrive=arrive)
    list(made._upright_cuts(given, 1, 4, 2))
    assert all(row[:2] == (turn, 2) for row in seen)
    assert [len(row[2]) for row in seen] == {100: [3, 3, 3], 1: [1] * 9, 200_000: [9]}[most]
    position, heading, motion, t = (np.concatenate([row[k] for row in seen]) for k in (2, 3, 4, 5))
    n = 0
    for k, count in ((1, 5), (2, 3), (3, 1)):
        for part in range(count):
            share = (part + 0.5) / count
            np.testing.assert_allclose(position[n], np.array(begin[k]) * (1 - share) + np.array(end[k]) * share)
            way = np.array(leave[k]) * (1 - share) + np.array(arrive[k]) * share
            np.testing.assert_allclose(heading[n], way / np.linalg.norm(way), atol=1e-12)
            assert (motion[n], t[n]) == ([0, 1, 1, 2][k], pytest.approx(0.2 + 0.6 * share))
            n += 1


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize("rise", [0.0, -0.3, 0.3, -1.0])
@pytest.mark.parametrize("depth", [0.4e-3, 1.3e-3, 3.2e-3, 9e-3, -2e-3])
def test_sample_points_are_those_of_the_edge_below_the_surface_that_can_cut(shape, rise, depth):
    """The end face counts on a descent only; pieces above the surface around the tool do not, but for the lowest."""
    cutter = CUTTERS[shape]
    made = made_sweep([CUTTERS["flat"], cutter])
    position = np.array([[0.02, 0.02, -depth], [0.03, 0.02, 0.5e-3 - depth]])
    heading = np.array([[1.0, 0, 0], [math.sqrt(1 - rise**2), 0, rise]])
    turn = made._turn_points(1, position, heading)
    pieces = edge(cutter, CELL)
    low = [
        float(lower) for part, lower in zip(pieces.part, pieces.low, strict=True)
        if lower < max(depth, 1e-9) and (part != BOTTOM or rise < 0.0)
    ]  # fmt: skip
    if depth < 0.0:  # one piece remains: the lowest, or the cylinder where that is an end face that does not cut
        low = [float(pieces.low[0 if rise < 0.0 or shape == "ball" else -1])]
    expected = set(np.round(np.float32(low), 9).tolist())
    reached = set(np.round(np.float32(turn.low), 9).tolist())
    assert reached <= expected
    if -1.0 < rise < 0.0 or shape == "flat":  # each piece cuts ahead of the tool, but the side on a plunge
        assert len(reached) == len(expected)
    assert (turn.bottom.stop > turn.bottom.start) == (rise < 0.0 and shape != "ball")
    if turn.side.stop > turn.side.start:
        only_side = all(value >= cutter.corner for value in low) and not (rise < 0.0 and cutter.corner < 5e-3)
        spacing = 5e-3 * float(turn.width[turn.side].max())
        assert spacing <= (0.5 if only_side else 1.0) * CELL
        assert spacing > (0.5 if only_side else 1.0) * CELL * 0.85 or spacing > 5e-3 * math.pi / 25
    assert made._turn_points(1, position, heading) is turn
    other = made._turn_points(0, position, heading)
    assert other is not turn


def test_steeper_paths_have_more_sample_points():
    """In sixteenths of the sine of the slope, rounded up: a ball cuts behind its axis on a descent."""
    made = made_sweep([CUTTERS["ball"]])
    position = np.array([[0.02, 0.02, -4e-3]])

    def points(sine):
        heading = np.array([[math.sqrt(1 - sine**2), 0.0, -sine]])
        return made._turn_points(0, position, heading)

    assert points(0.01) is points(1 / 16)
    assert points(1.01 / 16) is points(2 / 16)
    counts = [len(points(sine).phi) for sine in (-0.5, 0.0, 1 / 16, 4 / 16, 8 / 16, 1.0)]
    assert counts == sorted(counts)
    assert counts[0] < counts[2] < counts[3] < counts[4] < counts[5]
    turn = points(4 / 16)
    pieces = edge(CUTTERS["ball"], CELL)
    for kappa, bend, lower in zip(pieces.kappa, pieces.bend, pieces.low, strict=True):
        if lower >= 4e-3:
            continue
        of_piece = np.isclose(turn.low, lower, atol=1e-9)
        # at the lower end of the piece the chip begins behind the axis where the surface still moves forwards
        chip = [
            math.sin(k) * np.sin(turn.phi[of_piece]) * math.sqrt(1 - 1 / 16) + math.cos(k) * 0.25
            for k in (kappa - 0.5 * bend, kappa + 0.5 * bend)
        ]
        assert (np.max(chip, axis=0) > -1e-3).all()


@pytest.mark.parametrize("hand", [1, -1])
def test_the_edge_is_at_its_angles_from_the_feed_to_the_side_of_the_hand(monkeypatch, hand):
    """With M3 an angle of 0 is to the left of the feed, seen from the spindle; with M4 to the right."""
    made = made_sweep([CUTTERS["ball"]])
    seen = []
    monkeypatch.setattr(sweep, "cut_edge", lambda *given: seen.append(given) or "edge")
    turn = SimpleNamespace(phi=np.array([0.0, 0.5 * np.pi, 2.0]), radius=np.array([1e-3, 2e-3, 5e-3], np.float32))
    position = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    ux, uy = np.array([0.6, 0.0]), np.array([0.8, -1.0])
    layer = np.array([1e-4, 2e-4], np.float32)
    found = made._engaged_edge(turn, position, (ux, uy, np.array([hand, hand])), layer)
    ((stock, given_turn, x, y, places, given_layer),) = seen
    assert found == "edge"
    assert stock is made.stock
    assert given_turn is turn
    np.testing.assert_array_equal(given_layer, layer)
    np.testing.assert_allclose(places, position, rtol=1e-6)
    for n in range(2):
        feed, left = np.array([ux[n], uy[n]]), hand * np.array([-uy[n], ux[n]])
        for p in range(3):
            offset = float(turn.radius[p]) * (math.sin(turn.phi[p]) * feed + math.cos(turn.phi[p]) * left)
            np.testing.assert_allclose([x[n, p], y[n, p]], position[n, :2] + offset, atol=1e-7)


@pytest.mark.parametrize("drill", [False, True])
def test_stations_have_the_feed_and_the_descent_of_a_tooth(monkeypatch, drill):
    """At 6000/min and 1200 mm/min, two teeth: 0.1 mm; along the spindle there is no feed across it."""
    made = made_sweep([replace(CUTTERS["flat"], drill=drill)] * 4)
    made.tools.rpm[:], made.tools.hand[:] = [6000, 3000, 6000, 6000], [1, -1, 1, 1]
    made.feed[:] = [0.02, 0.02, 0.04, 0.02]
    seen = {}
    sine = np.array([0.0, 0.6, 0.6, 1.0])
    heading = np.column_stack([0.6 * np.sqrt(1 - sine**2), 0.8 * np.sqrt(1 - sine**2), -sine])
    heading[2, 2] = 0.6
    position = np.array([[0.02, 0.02, -1e-3], [0.02, 0.02, -2e-3], [0.02, 0.02, -3e-3], [0.02, 0.02, -5e-3]])

    def engaged(self, turn, places, axes, layer):
        seen["axes"], seen["layer"] = axes, layer
        return EngagedEdge(np.ones((4, 2), np.float32), np.zeros((4, 0), np.float32))

    def chips(turn, feed, descent):
        seen["feed"] = feed
        return SimpleNamespace(share=np.array([[0.5, 1.0]] * 4))

    def loads(turn, edge_in_material, chip, descent_sine, cell, cosine):
        seen["sine"], seen["cell"], seen["cosine"] = descent_sine, cell, cosine
        return "loads"

    monkeypatch.setattr(Sweep, "_engaged_edge", engaged)
    monkeypatch.setattr(cutting, "chips", chips)
    monkeypatch.setattr(cutting, "mean_loads", loads)
    monkeypatch.setattr(Sweep, "_cuts_of_loads", lambda self, *given: given)
    turn = SimpleNamespace(normal_down=np.array([0.3, 0.7]))
    motion, t = np.arange(4), np.array([0.1, 0.2, 0.3, 0.4])
    result = made._cuts_at(turn, 3, position, heading, motion, t)
    per_tooth = np.array([1e-4, 2e-4, 2e-4, 1e-4])
    np.testing.assert_allclose(seen["feed"], per_tooth * [1, 0.8, 0.8, 0], rtol=1e-6)
    teeth_of_layer = 2 if drill else 1  # a cone enters over a turn
    np.testing.assert_allclose(seen["layer"], teeth_of_layer * per_tooth * [0, 0.6, -0.6, 1], rtol=1e-6)
    np.testing.assert_allclose(seen["sine"], [0, 0.6, 0, 1], rtol=1e-6)
    ux, uy, hand = seen["axes"]
    np.testing.assert_allclose(np.column_stack([ux, uy]), [[0.6, 0.8]] * 3 + [[1, 0]])
    assert hand.tolist() == [1, -1, 1, 1]
    assert (seen["cell"], seen["cosine"].tolist()) == (CELL, [0.3, 0.7])
    given_turn, stations, given_loads, cuts, hole_depth = result
    assert (given_turn, given_loads) == (turn, "loads")
    np.testing.assert_array_equal(stations[0], motion)
    np.testing.assert_array_equal(stations[1], t)
    assert stations[2].tolist() == [False, False, False, True]
    np.testing.assert_allclose(cuts, [[0.5, 1.0]] * 4)
    # below the surface at z = 0: the last station is half a step above the end of the hole
    assert hole_depth == pytest.approx(5e-3 + 0.5 * 4e-3 / 3 if drill else 0.0)
    air = made._cuts_at(turn, 0, position + np.array([0, 0, 0.02]), heading, motion, t)
    assert air[-1] == 0.0
    one = made._cuts_at(turn, 0, position[3:], heading[3:], motion[3:], t[3:])
    assert one[-1] == pytest.approx(5e-3 if drill else 0.0)


def test_loads_become_cuts_with_torque_power_and_the_error_by_cells(monkeypatch):
    """With M4 forces across the feed and moments about the other axes change their sign."""
    made = made_sweep([CUTTERS["flat"]] * 2)
    made.tools.rpm[:], made.tools.hand[:] = [6000, 3000], [1, -1]
    monkeypatch.setattr(
        sweep, "_engagement_sizes", lambda turn, cuts: tuple(np.arange(3) + k for k in (10, 20, 30, 40))
    )
    wrench = np.arange(1.0, 19.0).reshape(3, 6)
    loads = Loads(wrench.copy(), wrench + 0.5, np.array([0.1, 0.2, 0.3]), np.zeros(3), np.array([1e-9, 2e-9, 3e-9]))
    turn, motion = SimpleNamespace(drill=False, teeth=2), np.array([0, 1, 1])
    stations = motion, np.array([0.2, 0.5, 0.7]), np.array([False, True, False])
    length = np.array([[1.0], [0.0], [2.0]])
    cuts = made._cuts_of_loads(turn, stations, loads, length, 7.0)
    signs = np.array([[1.0] * 6, [1, -1, 1, -1, 1, -1], [1, -1, 1, -1, 1, -1]])
    np.testing.assert_allclose(cuts.wrench, wrench * signs)
    np.testing.assert_allclose(cuts.deviation, wrench + 0.5)
    np.testing.assert_allclose(cuts.torque, wrench[:, 5])
    np.testing.assert_allclose(cuts.power, wrench[:, 5] * np.array([100, 50, 50]) * 2 * np.pi)
    np.testing.assert_allclose(cuts.rate, np.array([1e-9, 2e-9, 3e-9]) * 2 * np.array([100, 50, 50]))
    for name, first in (("enter", 10), ("leave", 20), ("depth", 30), ("width", 40)):
        assert getattr(cuts, name).tolist() == [first, first + 1, first + 2]
    force = (wrench[:, :3] ** 2).sum(axis=1)
    squares = [0.01 * force[0], 0.04 * force[1] + 0.09 * force[2]]
    sums = made.cell_error_sums
    np.testing.assert_allclose([sums.error, sums.force], [squares, [force[0], force[1] + force[2]]])
    assert not sums.gentle_error.any()
    assert made.has_contact
    hole = made._cuts_of_loads(SimpleNamespace(drill=True, teeth=2), stations, loads, length, 7.0)
    assert hole.depth.tolist() == [7.0, 0.0, 7.0]
    made.has_contact, before = False, np.stack(made.cell_error_sums)
    air = made._cuts_of_loads(turn, stations, loads, 0.0 * length, 7.0)
    assert not made.has_contact
    np.testing.assert_array_equal(made.cell_error_sums, before)
    for name in ("torque", "power", "depth", "width", "rate"):
        assert not getattr(air, name).any()
    assert np.isnan(air.enter).all()
    assert np.isnan(air.leave).all()
    assert air.is_axial.tolist() == stations[2].tolist()


@pytest.mark.parametrize(
    ("cutting_moves", "is_deflected"), [(True, False), (False, False), (False, True), (True, True)]
)
def test_contact_without_a_cut_is_recorded_beyond_twenty_micrometres_and_its_material_removed(
    cutting_moves, is_deflected
):
    """Rapid moves with their depth, unless the tool springs back there; others as cuts with the spindle off."""
    made = made_sweep([CUTTERS["flat"]] * 8, is_deflected=is_deflected)
    made.collisions[2] = 5e-3
    depths = [9e-3, 0.0, 3e-3, 1.9e-5, 2.1e-5, 2e-3, 4e-3, 9e-3]
    begin = [[0.004 + 0.007 * k, 0.012, -depth] for k, depth in enumerate(depths)]
    end = [[x, 0.028, z] for x, _, z in begin]
    given = segments_of(begin, end, [0, 1, 2, 3, 4, 6, 6, 7], cutting=cutting_moves)
    made._record_contact(given, 1, 7, CUTTERS["flat"])
    recorded = [2, 4, 6]
    assert made.stopped_motions == (set(recorded) if cutting_moves else set())
    if cutting_moves or is_deflected:
        assert made.collisions == {2: 5e-3}
    else:
        assert made.collisions == pytest.approx({2: 5e-3, 4: 2.1e-5, 6: 4e-3}, abs=2e-9)
    for k, depth in enumerate(depths):
        column, row = int((begin[k][0] - made.stock.x) / CELL), int((0.02 - made.stock.y) / CELL)
        assert made.stock.high[row, column] == pytest.approx(-depth if 0 < k < 7 else 0.0, abs=1e-8)
    untouched = made_sweep([CUTTERS["flat"]])
    untouched._record_contact(segments_of(begin[3:4], end[3:4], [0], cutting=cutting_moves), 0, 1, CUTTERS["flat"])
    assert (untouched.collisions, untouched.stopped_motions) == ({}, set())


def test_rapid_moves_that_turn_the_tool_are_compared_at_places_a_cell_apart(monkeypatch):
    """Four parts of a segment at least; the largest depth of a motion counts, and nothing is removed."""
    made = made_sweep([CUTTERS["flat"], CUTTERS["ball"]])
    made.tools.tool = np.array([0, 0, 0, 1, 1])
    seen = []
    made.poses = SimpleNamespace(tips_and_axes=lambda motion, t: (motion, t))
    depths = iter([2e-3, 3e-3, 1e-3, 0.0])

    def depth_inside(stock, cutter, motion, t):
        seen.append((cutter, motion.tolist(), t))
        return next(depths)

    monkeypatch.setattr(sweep, "depth_inside", depth_inside)
    begin = [[0, 0, 0], [0, 0, 0], [0.0095, 0, 0], [0.0095, 0, 0], [0, 0, 0]]
    end = [[1, 0, 0], [0.0095, 0, 0], [0.0095, 0, 0], [0.0095, 0.0035, 0], [0, 0, -0.02]]
    given = segments_of(begin, end, [0, 3, 3, 3, 4], cutting=False, leans=True)
    made._record_turning_rapids(given, 1, 5)
    assert made.collisions == {3: 3e-3}
    for (cutter, motion, t), (number, parts) in zip(seen, [(3, 10), (3, 4), (3, 4), (4, 20)], strict=True):
        assert cutter == CUTTERS["ball"]
        assert motion == [number] * (parts + 1)
        np.testing.assert_allclose(t, 0.2 + 0.6 * np.arange(parts + 1) / parts)


def tilted_path(tips, axes, motion):
    """Return a path of pieces of a tool that leans, between poses (S + 1, 3)."""
    tips, axes = np.array(tips, dtype=float), np.array(axes, dtype=float)
    middle = 0.5 * (axes[:-1] + axes[1:])
    n = len(tips) - 1
    return tilted.TiltedPath(
        np.array(motion), np.full(n, 0.5), 0.5 * (tips[:-1] + tips[1:]),
        middle / np.linalg.norm(middle, axis=1)[:, None], np.tile([1.0, 0, 0], (n, 1)), tips[:-1], axes[:-1], tips[1:],
        axes[1:], np.full(n, 0.02), np.zeros((n, 3)),
    )  # fmt: skip


@pytest.mark.parametrize("goes_on", [False, True])
@pytest.mark.parametrize("rpm", [0.0, 6000.0])
@pytest.mark.parametrize("depth", [1.9e-5, 2.1e-5])
def test_a_sweep_of_a_tool_that_leans_removes_what_it_covers_and_returns_its_front(monkeypatch, goes_on, rpm, depth):
    """Volumes are summed; a spindle that is off is recorded beyond twenty micrometres."""
    made = made_sweep([CUTTERS["flat"]] * 3)
    made.tools.rpm[:] = rpm
    made.overhang[2], made.tilted_volume = 1e-9, 5e-9

    def cells(row, level):
        index = np.array([row * made.stock.high.shape[1] + 20])
        footprint = Footprint.empty()
        return replace(footprint, cell=index, level=np.array([level], np.float32), segment=np.zeros(1, np.int32))

    swept = tilted.SweptCells(cells(10, -3e-3), cells(12, -4e-3), depth, 2e-9, 7e-9)
    seen = []
    monkeypatch.setattr(tilted, "sweep", lambda *given: seen.append(given) or swept)
    axes = [[0, 0, 1], direction(5.0, 0.0), direction(9.0, 0.0)]
    path = tilted_path([[0, 0, 0], [1, 0, 0], [1, 1, 0]], axes, [1, 2])
    front = made._tilted_sweep(path, CUTTERS["bull"], 0.25, goes_on=goes_on)
    ((stock, cutter, tips, axes, top),) = seen
    assert stock is made.stock
    assert (cutter, top) == (CUTTERS["bull"], 0.25)
    assert tips.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert made.stopped_motions == ({2} if rpm == 0.0 and depth > 2e-5 else set())
    assert made.overhang == pytest.approx({2: 3e-9})
    assert made.tilted_volume == pytest.approx(12e-9)
    assert made.stock.high[10, 20] == np.float32(-3e-3)
    assert made.stock.high[12, 20] == np.float32(0.0 if goes_on else -4e-3)
    assert front.cell.tolist() == (swept.front.cell.tolist() if goes_on else [])


def test_the_surface_near_a_tool_that_leans_is_looked_for_as_far_as_its_side_reaches():
    """Its side rises by the height of the material above the tip, and is as far beside it as the lean gives."""
    made = made_sweep([CUTTERS["flat"]])
    made.top = 0.006
    made.stock.high[20, 40] = 0.006  # 40.5 - 2 mm along x
    lean = 30.0
    made.poses = SimpleNamespace(
        tips_and_axes=lambda motion, t: (None, np.tile(direction(lean, 0.0), (len(motion), 1)))
    )

    def found(x, z):
        given = segments_of([[x - 1e-4, 0.0185, z]], [[x + 1e-4, 0.0185, z]], [0], leans=True)
        path, top = made._tilted_path(given, 0, 1, CUTTERS["flat"])
        assert path.tip[:, 2] == pytest.approx(z)
        return top

    height = 0.006 + 1e-3 + 5e-3  # of the material and the rim above the tip at z = -1 mm
    reach = 5e-3 + height * math.tan(math.radians(lean))
    assert found(0.0385 - reach - 1e-3, -1e-3) == pytest.approx(0.006)
    assert found(0.0385 - reach - 4e-3, -1e-3) == pytest.approx(0.0)
    assert found(-0.2, -1e-3) == pytest.approx(-1e-3)  # beside the map: the height of the tip
    assert found(0.0385 - 5e-3 - 4e-3, 0.02) == pytest.approx(0.02)


@pytest.mark.parametrize("most", [1, 200_000])
def test_edges_of_tools_that_lean_reach_the_surface_in_steps_of_four_cells(monkeypatch, most):
    monkeypatch.setattr(sweep, "_MOST_POINTS", most)
    made = made_sweep([CUTTERS["flat"], CUTTERS["flat"]])
    made.tools.rpm[:], made.tools.hand[:] = [6000.0, 3000.0], [1, -1]
    seen, pieces = [], []

    def loads(stock, turn, part, tooth, hand):
        seen.append((turn, tooth, hand))
        return "loads", np.tile([1.0 if len(seen) < 2 else 0.0], (len(part.t), 1)), np.zeros(len(part.t), dtype=bool)

    monkeypatch.setattr(tilted, "loads", loads)
    monkeypatch.setattr(Sweep, "_cuts_of_loads", lambda self, *given: pieces.append(given) or "cuts")
    path = tilted_path([[0, 0, -1e-3], [1e-3, 0, -3e-3]], [direction(40.0, 0.0), direction(40.0, 0.0)], [1])
    path = replace(path, pace=np.array([np.nan]))
    for top in (-1e-3, 0.0, 0.02):
        assert list(made._tilted_cuts(path, 1, top)) == ["cuts"]
        turn, tooth, hand = seen[-1]
        reach = (top + 2e-3 + 5e-3) / math.cos(math.radians(40.0))
        upper = float((turn.low + np.where(np.isfinite(turn.rise), turn.rise, 0.0)).max())
        assert reach <= upper + 1e-9
        assert upper < reach + 4 * CELL
        assert upper / (4 * CELL) == pytest.approx(round(upper / (4 * CELL)))
        assert tooth.tolist() == [pytest.approx(60.0 / (3000 * 2))]
        assert hand.tolist() == [-1]
    assert made.unpaced_motions == {1}
    assert math.isnan(pieces[-1][-1])
    assert len({id(turn) for turn, _, _ in seen}) == len(made._turns) == 3 - (seen[0][0] is seen[1][0])


@pytest.mark.parametrize("seed", range(3))
def test_the_edge_of_a_leaning_tool_is_in_material_by_its_height_below_four_cells(seed):
    """Levels count up to two cells above and below the point; cells without material count as far below it.

    Its share in material goes from none to all over the extent of the piece along z of the map.
    """
    rng = np.random.default_rng(seed)
    stock = random_stock(rng, (0.0, 0.5, 1.0)[seed])
    cutter = Cutter(5e-3, 2e-3, 2)
    turn = Turn.of(edge(replace(cutter, drill=True), MAP_CELL), cutter, LAW, MAP_CELL, None)
    axes = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    count = len(turn.phi)
    x = rng.uniform(stock.x, stock.x + stock.high.shape[1] * MAP_CELL, (3, count))
    y = rng.uniform(stock.y, stock.y + stock.high.shape[0] * MAP_CELL, (3, count))
    z = rng.uniform(-7e-3, 1e-3, (3, count))
    found = tilted.tilted_cut_edge(stock, turn, np.stack([x, y, z], axis=-1), axes)
    assert found.moment.shape == (3, 0)
    extent, limit = tilted._vertical_extents(turn, axes), 2.0 * MAP_CELL
    engaged = 0
    for n, p in np.ndindex(3, count):
        depth, cells = 0.0, around(np.float32(x[n, p]), np.float32(y[n, p]))
        for row, column, _, _, weight in cells:
            high, low, share, floor = (float(v[row, column]) for v in (stock.high, stock.low, stock.share, stock.floor))
            upper = min(max(high - z[n, p], -limit), limit) if high > floor else -limit
            lower = min(max(min(low, high) - z[n, p], -limit), limit)
            depth += weight * ((1 - share) * upper + share * lower)
        if turn.bottom.start <= p < turn.bottom.stop:
            depth -= 2e-6
        part = min(max(0.5 + depth / float(extent[n, p]), 0.0), 1.0)
        row, column = cells[0][:2]
        if float(z.min()) < stock.ground and z[n, p] <= float(stock.floor[row, column]):
            part = 0.0
        assert float(found.length[n, p]) == pytest.approx(part * float(turn.length[p]), rel=2e-2, abs=3e-6)
        engaged += 0.0 < part < 1.0
    assert engaged > 20


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize("seed", range(3))
def test_the_lowest_level_of_a_move_is_that_of_poses_in_between(shape, seed):
    """Lower sides at sixty poses; it sinks at the end where the last one is lower than the one before."""
    rng, cutter = np.random.default_rng(seed), CUTTERS[shape]
    lean, turned = rng.uniform(5, 40), rng.uniform(0, 360)
    tips = np.array([[0.0, 0.0, 0.0], rng.uniform(-1, 1, 3) * [1e-4, 1e-4, 5e-5]])
    axes = np.array(
        [direction(lean, turned), direction(lean + rng.uniform(-0.4, 0.4), turned + rng.uniform(-0.4, 0.4))]
    )
    x, y = rng.uniform(-7e-3, 7e-3, (2, 1, 1, 80))
    level, sinks, upper = tilted._lowest_levels(cutter, tips, axes, np.array([0]), x, y)
    share = np.linspace(0.0, 1.0, 61)
    sides = []
    for part in share:
        axis = axes[0] + part * (axes[1] - axes[0])
        tip = tips[0] + part * (tips[1] - tips[0])
        low, high, _ = tilted._lower_and_upper_sides(
            cutter, (axis / np.linalg.norm(axis))[None], x - tip[0], y - tip[1], np.zeros((1, 3)), np.zeros((1, 3))
        )
        sides.append((low[0, 0] + tip[2], high[0, 0] + tip[2]))
    low, high = (np.array([side[k] for side in sides]) for k in (0, 1))
    compared = 0
    for n in range(80):
        if not np.isfinite(low[:, n]).all():
            continue
        compared += 1
        assert level[0, 0, n] == pytest.approx(low[:, n].min(), abs=1.5e-6)
        assert upper[0, 0, n] == pytest.approx(max(high[0, n], high[-1, n]), abs=1e-9)
        if abs(low[-1, n] - low[-2, n]) > 1e-8:
            assert sinks[0, 0, n] == (low[-1, n] < low[-2, n])
    assert compared > 20
    gone = ~np.isfinite(low).any(axis=0)
    assert (level[0, 0, gone] == np.inf).all()
    assert not sinks[0, 0, gone].any()
    assert (upper[0, 0, gone] == -np.inf).all()


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize("lean", [0.0, 35.0, 80.0])
def test_the_depth_of_a_tool_in_a_block_is_that_of_points_in_its_solid(shape, lean):
    """By points on a fine grid in a solid that is smaller by a cell; to the distance of rings and points."""
    cell = 0.5e-3
    stock, cutter = stocks.from_box(*BOX, cell), CUTTERS[shape]
    radius, corner = cutter.radius - cell, max(cutter.corner - cell, 0.0)
    inner = Cutter(radius, min(corner, radius), 2)
    axis = direction(lean, 50.0)
    across, down = np.arange(-0.012, 0.012, 0.25e-3), np.arange(-0.02, 0.0, 0.25e-3)
    grid = np.stack(np.meshgrid(across, across, down, indexing="ij"), axis=-1).reshape(-1, 3)
    for tip in ([0.03, 0.02, -4e-3], [0.055, 0.035, -6e-3], [0.0, 0.02, -3e-3], [0.03, 0.02, 2.5e-3]):
        points = grid + np.array([tip[0], tip[1], 0.0])
        inside_box = ((points > BOX[0]) & (points < BOX[1])).all(axis=1)
        raised = np.array(tip) + (2e-5 if shape == "flat" else cell) * axis
        points = points[inside_box]
        in_tool = is_inside(inner, raised, axis, points)
        expected = -float(points[in_tool][:, 2].min()) if in_tool.any() else 0.0
        depth = leaning.depth_inside(stock, cutter, np.array([tip]), axis[None])
        assert depth == pytest.approx(expected, abs=0.6e-3)


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize(
    ("lean", "turn", "tip"), [(70.0, 180.0, (0.07, 0.02, -2e-3)), (75.0, 90.0, (0.03, -0.02, 0.0))]
)
def test_a_shank_in_a_block_counts_where_the_tip_is_beside_it(shape, lean, turn, tip):
    """Its lowest line enters the block at the side: by the height of the axis there and the radius across it."""
    cell = 0.5e-3
    axis, radius = direction(lean, turn), 5e-3 - cell
    gap = tip[0] - 0.06 if turn == 180.0 else -tip[1]
    sine, cosine = math.sin(math.radians(lean)), math.cos(math.radians(lean))
    # below the axis by the radius, square to it; that line is at the side of the block further along the axis
    along = (gap - radius * cosine) / sine
    expected = -(tip[2] + along * cosine - radius * sine)
    depth = leaning.depth_inside(stocks.from_box(*BOX, cell), CUTTERS[shape], np.array([tip]), axis[None])
    assert depth == pytest.approx(expected, abs=1.2e-3)
    away = direction(lean, turn + 180.0)
    assert leaning.depth_inside(stocks.from_box(*BOX, cell), CUTTERS[shape], np.array([tip]), away[None]) == 0.0


def test_points_of_a_tool_are_compared_with_the_level_of_the_larger_part_of_a_cell():
    """Only between floor and surface; a point beside the map is in no material."""
    cell = 1e-3
    stock = stocks.from_box(*BOX, cell)
    stock.share[:], stock.low[:] = 0.49, -2e-3
    tip = np.array([[0.03, 0.02, -3e-3]])
    up = np.array([[0.0, 0.0, 1.0]])
    assert leaning.depth_inside(stock, CUTTERS["flat"], tip, up) == pytest.approx(3e-3 - 2e-5, abs=1e-8)
    stock.share[:] = 0.51
    assert leaning.depth_inside(stock, CUTTERS["flat"], tip, up) == pytest.approx(1e-3 - 2e-5, abs=1e-8)
    stock.floor[:] = -2.5e-3  # the end is below the material: the lowest ring of the shank within it counts
    assert leaning.depth_inside(stock, CUTTERS["flat"], tip, up) == 0.0
    stock.share[:] = 0.0
    assert 0.0 < leaning.depth_inside(stock, CUTTERS["flat"], tip, up) <= 2.5e-3


def test_the_parts_of_an_edge_are_in_order():
    pieces = edge(CUTTERS["bull"], CELL)
    assert pieces.part.tolist() == sorted(pieces.part.tolist())
    assert {BOTTOM, CORNER, SIDE} == set(pieces.part.tolist())


def test_a_tool_that_leans_may_touch_what_is_its_radius_and_a_millimetre_below_its_tip():
    made = made_sweep([CUTTERS["flat"]] * 2)
    heights = (5e-3 + 0.99e-3, 5e-3 + 1.01e-3, -1.0)
    places = [[9.0, 9.0, height] for height in heights]
    given = segments_of(places, [[9.0, 9.0, height + 0.01] for height in heights], [0, 1, 1], leans=True)
    assert made._can_touch(given, 0.0).tolist() == [True, False, True]


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize("lean", [-12.0, 0.0, 12.0])
@pytest.mark.parametrize("heading", [0.0, 70.0, 215.0])
def test_what_a_leaning_tool_enters_next_is_its_front(shape, lean, heading):
    """Leaning back, upright or forwards along the path: cells at its side ahead of the tip, and none behind it.

    With the lean the side at the surface is displaced along the path; cells a cell from the side may be either.
    """
    stock, cutter = stocks.from_box(*BOX, 0.5e-3), CUTTERS[shape]
    along = np.array([math.cos(math.radians(heading)), math.sin(math.radians(heading)), 0.0])
    tips = np.array([0.03, 0.02, -6e-3]) + np.linspace(-1.2e-3, 0.0, 13)[:, None] * along
    axis = math.sin(math.radians(lean)) * along + [0.0, 0.0, math.cos(math.radians(lean))]
    swept = tilted.sweep(stock, cutter, tips, np.tile(axis, (13, 1)), 0.0)
    columns = stock.high.shape[1]

    def of(footprint):
        """Return distances (n,) of cells from the tip, along the path and across it [m]."""
        row, column = np.divmod(footprint.cell, columns)
        x, y = stock.x + (column + 0.5) * 0.5e-3 - 0.03, stock.y + (row + 0.5) * 0.5e-3 - 0.02
        return x * along[0] + y * along[1], y * along[0] - x * along[1]

    surface = 6e-3 * math.tan(math.radians(lean))  # of the axis at the surface, along the path
    ahead, across = of(swept.front)
    if lean >= 0.0:  # leaning back, the end face moves into the material too
        assert (ahead > -0.5e-3).all()
    behind, beside = of(swept.footprint)
    gap = 5e-3 - np.hypot((behind - surface) * math.cos(math.radians(lean)), beside)
    is_at_side = (gap < 0.2e-3) & (behind - surface > 1e-3)
    assert not is_at_side.any()
    front_gap = 5e-3 - np.hypot((ahead - surface) * math.cos(math.radians(lean)), across)
    assert (front_gap < 0.3e-3).sum() > 10
    if lean > 0.0 and shape == "flat":  # leaning forwards, all cells at the end sink no more: its lower side rises
        assert (front_gap < 1.5e-3).all()


@pytest.mark.parametrize("shape", CUTTERS)
@pytest.mark.parametrize("lean", [2.0, 15.0, 30.0])
def test_between_two_poses_the_lower_side_is_a_parabola_or_two_planes(shape, lean):
    """In moves of a millimetre, by a search over 201 poses: two planes are exact, a parabola to the fourth order."""
    cutter, rng = CUTTERS[shape], np.random.default_rng(int(lean))
    axis, shift = direction(lean, 60.0), np.array([8e-4, 5e-4, 1e-4])
    tips, axes = np.array([[0.0, 0.0, 0.0], shift]), np.array([axis, axis])
    x, y = rng.uniform(-5e-3, 6e-3, (2, 1, 1, 300))
    level, _, _ = tilted._lowest_levels(cutter, tips, axes, np.array([0]), x, y)
    part = np.linspace(0.0, 1.0, 201)[:, None]
    still = np.zeros((1, 3))
    low, _, _ = tilted._lower_and_upper_sides(
        cutter, axis[None], x - part * shift[0], y - part * shift[1], still, still
    )
    lows = low[0] + part * shift[2]
    whole = np.isfinite(lows).all(axis=0)
    between = whole & (lows.min(axis=0) < np.minimum(lows[0], lows[-1]) - 5e-6)
    assert between.sum() > 5
    # next to the cylinder, whose side is steep, the curve is no parabola: half of the cells are away from it
    error = np.abs(np.nan_to_num(level[0, 0], posinf=1.0) - np.nan_to_num(lows.min(axis=0), posinf=1.0))
    assert np.median(error[between]) < {"flat": 1e-5, "ball": 2e-6, "bull": 6e-6}[shape]
    assert np.median(error[whole]) < 1e-6


@pytest.mark.parametrize(
    ("is_deflected", "height", "expected"), [(False, -3e-3, [(0, 1)]), (True, -3e-3, []), (False, 0.1, [])]
)
def test_turning_rapid_moves_of_a_tool_that_springs_back_are_not_compared(monkeypatch, is_deflected, height, expected):
    """Nor those of a tool that is above the stock."""
    ranges = []
    monkeypatch.setattr(Sweep, "_record_turning_rapids", lambda self, steps, begin, end: ranges.append((begin, end)))
    made = made_sweep([CUTTERS["flat"]], is_deflected=is_deflected)
    moves = segments_of([[0.01, 0.02, height]], [[0.03, 0.02, height]], [0], cutting=False, leans=True)
    assert list(made.run(moves)) == []
    assert ranges == expected


@pytest.mark.parametrize("begin", [-0.4e-3, -0.5e-3, -0.9e-3])
def test_a_ball_that_passes_over_a_cell_is_lowest_with_its_tip_there(begin):
    """Its section is a parabola but for 0.1 µm on a way of 1 mm."""
    tips = np.array([[begin, 0.0, 0.0], [begin + 1e-3, 0.0, 0.0]])
    place = np.full((1, 1, 1), -begin)
    found = tilted._lowest_levels(
        CUTTERS["ball"], tips, np.tile([0.0, 0.0, 1.0], (2, 1)), np.array([0]), place, 0.0 * place
    )
    assert float(found.low[0, 0, 0]) == pytest.approx(0.0, abs=1e-6)
