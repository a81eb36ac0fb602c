"""Every limit of a comparison: what is a fifth below it is no difference, what is a quarter above it is one."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.comparison import compare
from postproc.comparison.loaded_path import Search, Stretches
from postproc.comparison.partners import missed_targets, pair_targets, partners_under_force
from postproc.forces import Knots
from postproc.under_load import RobotInCell
from tests.comparison.test_named import CELL, FORCE, HEAD, POINT, ROBOT, TURNED, edited, lines, named, nominal
from tests.corrections import read_files

TOLERANCE = RobotInCell.of(ROBOT, CELL).tolerance * 1e3
"""Of the cell [mm]."""
FORCE_SIZE = float(np.linalg.norm([-150.0, 100.0, 120.0]))
ARC = f"CIRC {{X 60,Y 50,Z 0}},{{X 80,Y 30,Z 0,{TURNED}}}"


def speed(off):
    return edited((POINT, f"$VEL.CP={0.05 + off * 1e-3:.7f}\n{POINT}"))


def approximation(off):
    return edited(("LIN {X 40,Y 0", f"$APO.CDIS={0.5 + off:.5f}\nLIN {{X 40,Y 0"))


def axis_target(off):
    return edited(("A1 5,A2 -70", f"A1 {5 + off:.6f},A2 -70"))


def posture(off):
    """The tool is vertical, and its axis that of A6: A6 alone turns."""
    return edited((POINT, POINT.replace("A 180", f"A {180.0 + off:.4f}")))


def turned(off):
    return edited((POINT, POINT.replace("B 0", f"B {off:.6f}")))


def turned_where_inserted(off):
    return edited((POINT, POINT.replace("Y 0", "Y 20").replace("B 0", f"B {off:.6f}") + POINT))


def rapid(off):
    return edited(("X 100,Y 0,Z 40", f"X 100,Y 0,Z {40 + off:.6f}"))


def aside(off):
    return edited((POINT, POINT.replace("X 80,Y 0", f"X {80 + off:.6f},Y 15") + POINT))


def beside_an_offset(off):
    """Pairs on either side are 0.2 mm off, in the same direction."""
    moved = [line.replace("X 80,", "X 80.2,") for line in (ARC, POINT)]
    between = POINT.replace("X 80,Y 0", f"X {80 + off:.6f},Y 15")
    return edited((ARC, moved[0]), (POINT, between + moved[1]))


def bulge(off):
    return edited(("X 60,Y 50", f"X 60,Y {50 + off:.6f}"))


def back(off):
    between = "".join(POINT.replace("Y 0", f"Y {y:.5f}") for y in (15.0, 15.0 + off))
    return edited((POINT, between + POINT))


def comment(force):
    return lambda off: f"; FORCE FX={-150 - off:.4f} FY=100 FZ=120{force}\n" + edited()


DEGREES = np.degrees(TOLERANCE / 100.0)  # the tolerance, at 0.1 m of tool
LIMITS = {
    "speed": (speed, 0.05 + 0.001, "speed", ""),  # a thousandth and a micrometre a second [mm/s]
    "approximation": (approximation, 0.01, "approximation", ""),
    "axis target": (axis_target, 0.001, "axis-target", ""),
    "posture": (posture, 20.0, "posture", ""),
    "orientation": (turned, DEGREES, "orientation", ""),
    "orientation of an inserted target": (turned_where_inserted, DEGREES, "orientation", ""),
    "orientation of an inserted target under a force": (turned_where_inserted, DEGREES, "orientation", FORCE),
    "rapid": (rapid, TOLERANCE, "rapid", ""),
    "rapid under a force": (rapid, TOLERANCE, "rapid", FORCE),
    "aside": (aside, 0.1, "only-corrected", ""),
    "aside of an offset": (beside_an_offset, 0.1 + 3 * 0.2, "only-corrected", ""),
    "auxiliary point": (bulge, 0.1, "between", ""),
    "back": (back, 1.0, "back", FORCE),
    "force": (comment(""), 0.05 + 1e-3 * FORCE_SIZE, "force", FORCE),
    "force in axes of the tool": (
        comment(" FRAME=TOOL"),
        0.05 + 0.05 * FORCE_SIZE,
        "force",
        FORCE[:-1] + " FRAME=TOOL\n",
    ),
}


@pytest.mark.parametrize("case", LIMITS)
def test_half_below_its_limit_nothing_is_a_difference_and_above_it_is_one(case):
    edit, limit, kind, force = LIMITS[case]
    first = nominal(force)
    own = "" if kind == "force" else force
    for share, count in ((0.8, 0), (1.25, 1)):
        found = compare(first, read_files({"OTHER.src": HEAD + own + edit(share * limit)}), ROBOT, CELL)
        assert [d.kind for d in found.differences if d.kind == kind] == count * [kind], (share, named(found))


@pytest.mark.parametrize("share", [0.8, 1.25])
def test_a_missing_target_is_an_error_beyond_the_tolerance(share):
    """The middle one of three, that much beside the line through the others."""
    ends, middle = [(0, 0), (80, 0), (80, 30)], (40, share * TOLERANCE)
    one, other = lines(ends[0], middle, *ends[1:]).program, lines(*ends).program
    found = compare(one, other, ROBOT, CELL)
    assert [d.level for d in found.differences if d.kind == "only-nominal"] == (["error"] if share > 1.0 else [])
    assert len(found.passed_rows) == int(share < 1.0)


class Step:
    """A force of its own on each motion, from its first place on."""

    name = "steps"

    def __init__(self, forces):
        self.forces = np.array(forces, dtype=float)

    def along(self, program, path):
        motion = np.flatnonzero(self.forces.any(axis=1))
        return Knots.along(motion, np.ones(len(motion)), self.forces[motion], np.zeros(len(motion), dtype=np.int64))


def test_behind_a_step_of_the_force_the_new_one_acts_from_the_first_place_on():
    """The deflection there, against the direction of travel, leaves all of itself; before it there is none."""
    side = lines((0, 0), (60, 0), (120, 0))
    load = side.forces(Step([[0] * 6, [0] * 6, [0] * 6, [-900, 300, 200, 0, 0, 0]]))
    ways = Stretches(
        side, np.arange(4), side.arc_length[[0, 1, 2, 3]], side.arc_length[[1, 2, 3, 4]],
        np.stack([side.arc_length[:4], side.arc_length[1:]], axis=1), np.ones(4, dtype=bool),
    )  # fmt: skip
    motion, t, begin = np.array([3]), np.array([1e-7]), side.arc_length[[3]]
    q = side.joints_at(motion, t)
    off = side.robot_in_cell.tip(q, side.program.tools[0], side.wrench(load, motion))[0] - side.points(begin)[0]
    assert off[0] < -1e-4  # against the travel along X
    deviations = Search(side, side, load, ways).deviations(motion, t, q, begin, sufficient_distance=1e-8)
    for distance in (deviations.nominal_distance, deviations.corrected_distance):
        np.testing.assert_allclose(distance, [np.linalg.norm(off)], rtol=1e-3)


@pytest.mark.parametrize(("share", "count"), [(0.8, 0), (1.25, 1)])
def test_a_slow_speed_may_differ_by_a_micrometre_a_second_more(share, count):
    """1 mm/s: by a thousandth of it, and a micrometre a second."""
    texts = [(HEAD + edited()).replace("$VEL.CP=0.05", f"$VEL.CP={0.001 + off:.9f}") for off in (0.0, share * 2e-6)]
    found = compare(
        *(read_files({name: text}) for text, name in zip(texts, ("ONE.src", "OTHER.src"), strict=True)), ROBOT, CELL
    )
    assert [d.kind for d in found.differences] == count * ["speed"]


@pytest.mark.parametrize("first", [0.5, 0.2])
@pytest.mark.parametrize(("bulge", "passed"), [(1.5, True), (1.7, False)])
def test_the_larger_offset_next_to_a_point_of_a_line_counts(first, bulge, passed):
    """Pairs that are 0.5 and 0.2 mm off, in either order: between them 0.1 + 3 · 0.5 mm are allowed."""
    last = 0.7 - first
    one = lines((0, 0), (20, 0), (40, 0), (40, 30))
    offset = np.interp([10, 30], [0, 40], [first, last])
    other = lines((0, first), (10, offset[0] + bulge), (30, offset[1] + bulge), (40, last), (40, 30 + last))
    found = pair_targets(one, other, np.array([0, -1, 3, 4]), np.ones(4, dtype=bool))
    missed, judged = missed_targets(found, one, other, None)
    np.testing.assert_allclose(missed, (bulge - 0.3) * 1e-3, atol=1e-6)  # less what the offsets differ by
    assert judged.tolist() == [passed]


def test_of_many_free_targets_those_near_the_present_partner_are_tried():
    one = lines((0, 0), (85, 0), (150, 0))
    other = lines(*((x, 0) for x in range(151)))
    assert partners_under_force(one, other, np.array([0, 80, 150]), np.zeros((3, 6))).tolist() == [0, 85, 150]


def test_a_missing_last_target_is_missed_by_its_distance_from_where_the_second_path_ends():
    one, other = (lines((0, 0), (40, 0), (40, 30), *more).program for more in ([(16, -2)], []))
    (found,) = (d for d in compare(one, other, ROBOT, CELL).differences if d.kind == "only-nominal")
    assert found.level == "error"
    assert "by 40.0000 mm there" in found.message  # 24 and 32 mm from (40, 30)
    assert found.corrected is None


def test_a_turned_target_before_the_first_pair_is_no_difference():
    """There is no pair before it, so it is not known how the tool turns there."""
    side = lines((0, 0), (40, 0))
    start = side.segments.begin(np.array([1]))[0] * 1e3  # of the first line, in its $BASE
    assert np.linalg.norm(start) > 50.0
    x, y, z = 0.5 * start
    one = HEAD + edited()
    point = f"LIN {{X {x:.4f},Y {y:.4f},Z {z:.4f},A 180,B 2,C 180}}\n"
    found = compare(read_files({"ONE.src": one}), read_files({"OTHER.src": HEAD + point + edited()}), ROBOT, CELL)
    assert len(found.inserted_rows) == 1
    assert [d.kind for d in found.differences] == []
