"""Every difference by itself: its number by hand, the place in both programs, and how many places there are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.cell import ExternalAxis
from postproc.comparison import compare
from postproc.comparison.loaded_path import Search, Stretches, places_on_pieces
from postproc.comparison.partners import missed_targets, ordered_partners, pair_targets, partners_under_force
from postproc.comparison.paths import Chain, PlacedProgram, nearest
from postproc.program import PTP
from postproc.under_load import RobotInCell
from tests.comparison.krl_moves import TURNED
from tests.corrections import read_files
from tests.kr270 import CELL, ROBOT
from tests.krl_texts import HEAD

BODY = f"""LIN {{X 0,Y 0,Z 0,{TURNED}}}
LIN {{X 40,Y 0,Z 0,{TURNED}}} C_DIS
LIN {{X 40,Y 30,Z 0,{TURNED}}} C_DIS
CIRC {{X 60,Y 50,Z 0}},{{X 80,Y 30,Z 0,{TURNED}}}
LIN {{X 80,Y 0,Z 0,{TURNED}}}
PTP {{A1 5,A2 -70,A3 110,A4 0,A5 50,A6 0}}
PTP {{X 100,Y 0,Z 40,{TURNED},S 2,T 2}}
LIN {{X 100,Y 40,Z 0,{TURNED}}}
PTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}}
END
"""
FIRST = 7
"""Line of the first motion of BODY."""
FORCE = "; FORCE FX=-150 FY=100 FZ=120\n"


@cache
def nominal(force=""):
    return read_files({"ONE.src": HEAD + force + BODY})


def edited(*edits):
    """Return BODY with pieces of text replaced, each once."""
    text = BODY
    for before, after in edits:
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    return text


def compared(body, force=""):
    return compare(nominal(force), read_files({"OTHER.src": HEAD + force + body}), ROBOT, CELL)


def named(found):
    """Return kind, message, line in both programs and count of the differences."""
    return [
        (
            d.kind,
            d.message,
            d.nominal and d.nominal[1] - FIRST,
            d.corrected and d.corrected[1] - FIRST,
            d.count,
        )
        for d in found.differences
    ]


POINT = f"LIN {{X 80,Y 0,Z 0,{TURNED}}}\n"
APPROXIMATION = "the approximation before the target ($APO.CDIS, C_DIS) is"
CUT_CORNER = "approximation (C_DIS) cuts the corner by"
SET_BACK = "Set $APO.CDIS and C_DIS back, or convert again."
PTP_CUT = "PTP instead of a cut: on the way to this target the tool leaves the nominal path by"
CASES = {
    "nothing": ([], []),
    "speed": (
        [(POINT, "$VEL.CP=0.03\n" + POINT)],
        [("speed", "the speed is 30 mm/s instead of 50 mm/s.", 4, 5, 2)],
    ),
    "kind": (
        [("LIN {X 80,Y 0", "PTP {X 80,Y 0")],
        [
            ("kind", "the way to this target is point to point (PTP) instead of a line (LIN).", 4, 4, 1),
            ("between", f"{PTP_CUT} 0.0716 mm. Write LIN or CIRC.", 4, 4, 1),
        ],
    ),
    "a cut divided, and a part of it driven by joints": (
        [(POINT, f"PTP {{X 80,Y 6,Z 0,{TURNED}}}\n" + POINT)],
        [
            ("kind", "the way to this target is point to point (PTP) instead of a line (LIN).", 4, 4, 1),
            ("between", f"{PTP_CUT} 0.0458 mm. Write LIN or CIRC.", 4, 4, 1),
        ],
    ),
    "two kinds": (
        [("LIN {X 40,Y 0", "PTP {X 40,Y 0"), ("PTP {X 100,Y 0,Z 40", "LIN {X 100,Y 0,Z 40")],
        [
            ("kind", "the way to this target is point to point (PTP) instead of a line (LIN).", 1, 1, 2),
            ("between", f"{PTP_CUT} 0.1107 mm. Write LIN or CIRC.", 1, 1, 1),
        ],
    ),
    "no approximation": (
        [(f"X 40,Y 0,Z 0,{TURNED}}} C_DIS", f"X 40,Y 0,Z 0,{TURNED}}}")],
        [("approximation", f"{APPROXIMATION} none instead of 0.5 mm.", 1, 1, 1)],
    ),
    "other approximation": (
        [("LIN {X 40,Y 0", "$APO.CDIS=0.8\nLIN {X 40,Y 0")],
        [
            ("approximation", f"{APPROXIMATION} 0.8 mm instead of 0.5 mm.", 1, 2, 2),
            # a square corner: a parabola is √2/4 of the distance from it
            ("between", f"{CUT_CORNER} 0.2828 mm; the nominal program allows 0.1768 mm. {SET_BACK}", 1, 2, 1),
        ],
    ),
    "axis targets": (
        [("A1 5,A2 -70,A3 110", "A1 6,A2 -68,A3 110"), ("A1 0,A2 -70,A3 110,A4 0,", "A1 0,A2 -70,A3 110,A4 3,")],
        [("axis-target", "an axis target is another one: A2 -68.0000° instead of -70.0000°.", 5, 5, 2)],
    ),
    "one axis target too few": (
        [("PTP {A1 5,A2 -70,A3 110,A4 0,A5 50,A6 0}\n", "")],
        [("axis-target", "an axis target (PTP {A1 …}) is in one of the programs only.", 5, None, 1)],
    ),
    "one axis target too many": (
        [(POINT, POINT + "PTP {A1 2,A2 -70,A3 110,A4 0,A5 50,A6 0}\n")],
        [
            ("axis-target", "an axis target is another one: A1 2.0000° instead of 5.0000°.", 5, 5, 1),
            ("axis-target", "an axis target (PTP {A1 …}) is in one of the programs only.", None, 6, 1),
        ],
    ),
    "base": (
        [(POINT, "$BASE={X 1500,Y -200,Z 701,A 0,B 0.5,C 0}\n" + POINT)],
        [
            (
                "base",
                "$BASE differs, by 1.0000 mm and 0.5000°: offsets are those of the tool in the root of the robot.",
                4,
                5,
                3,
            )
        ],
    ),
    "tool": (
        [(POINT, "$TOOL={X 0,Y 0.3,Z 350.4,A 0,B 0,C 0}\n" + POINT)],
        [
            (
                "tool",
                "$TOOL differs, by 0.5000 mm and 0.0000°: offsets are those of the tool in the root of the robot.",
                4,
                5,
                3,
            ),
            ("rapid", "a rapid target is 0.5000 mm off.", 6, 7, 1),
        ],
    ),
    "rapid": (
        [("X 100,Y 0,Z 40", "X 100.6,Y 0.8,Z 40")],
        [("rapid", "a rapid target is 1.0000 mm off.", 6, 6, 1)],
    ),
    "twice": (
        [(POINT, 2 * POINT)],
        [
            ("twice", "the same target twice in succession: the robot stops there.", None, 5, 1),
            ("only-corrected", "an additional target.", None, 5, 1),
        ],
    ),
    "an additional target": (
        [(POINT, POINT.replace("X 80,Y 0", "X 90,Y 15") + POINT)],
        [
            ("only-corrected", "an additional target, 10.0000 mm from the nominal path.", None, 4, 1),
            ("between", "the path is 10.0000 mm from the nominal one on the way to this target.", 4, 5, 1),
        ],
    ),
    "auxiliary point": (
        [("X 60,Y 50", "X 60,Y 49")],
        [
            (
                "between",
                "the path is 1.0000 mm from the nominal one on the way to this target. Check the auxiliary point of "
                "its arc.",
                3,
                3,
                1,
            )
        ],
    ),
    "status and turn": (
        [("S 2,T 2", "S 6,T 18")],
        [("posture", "the robot takes another posture: A4 is at 180.0° instead of -0.0° (S, T).", 6, 6, 2)],
    ),
    "no turn": (
        [("S 2,T 2", "S 2")],
        [
            (
                "posture",
                "status and turn of this target are S 2, no T instead of S 2, T 2: the axes may turn another way.",
                6,
                6,
                1,
            )
        ],
    ),
    "turn zero": (
        [("S 2,T 2", "S 2,T 0")],
        [
            (
                "posture",
                "status and turn of this target are S 2, T 0 instead of S 2, T 2: the axes may turn another way.",
                6,
                6,
                1,
            )
        ],
    ),
    "turned at a target": (
        [("X 40,Y 30,Z 0,A 180,B 0", "X 40,Y 30,Z 0,A 180,B 0.4"), ("X 80,Y 0,Z 0,A 180", "X 80,Y 0,Z 0,A 179.7")],
        [("orientation", "the tool is turned by 0.4000° from its nominal orientation.", 2, 2, 2)],
    ),
    "turned at an inserted target": (
        [(POINT, POINT.replace("Y 0,Z 0,A 180", "Y 20,Z 0,A 179.3") + POINT)],
        [("orientation", "the tool is turned by 0.7000° from its nominal orientation.", None, 4, 1)],
    ),
    "turned at a target, and less at an inserted one": (
        [
            ("X 40,Y 30,Z 0,A 180,B 0", "X 40,Y 30,Z 0,A 180,B 0.4"),
            (POINT, POINT.replace("Y 0,Z 0,A 180", "Y 20,Z 0,A 179.8") + POINT),
        ],
        [("orientation", "the tool is turned by 0.4000° from its nominal orientation.", 2, 2, 2)],
    ),
    "turned at two inserted targets": (
        [
            (
                POINT,
                POINT.replace("Y 0,Z 0,A 180", "Y 20,Z 0,A 180.3")
                + POINT.replace("Y 0,Z 0,A 180", "Y 10,Z 0,A 180.9")
                + POINT,
            )
        ],
        [("orientation", "the tool is turned by 0.9000° from its nominal orientation.", None, 5, 2)],
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_difference_has_its_number_its_lines_and_its_count(case):
    edits, expected = CASES[case]
    assert named(compared(edited(*edits))) == expected


@pytest.mark.parametrize("case", ["nothing", "speed", "axis targets", "rapid", "one axis target too many"])
def test_what_is_no_cut_is_the_same_under_a_force(case):
    edits, expected = CASES[case]
    found = compared(edited(*edits), FORCE)
    assert [(d.kind, d.message, d.count) for d in found.differences] == [(e[0], e[1], e[4]) for e in expected]
    assert [d.corrected and d.corrected[1] - FIRST - 1 for d in found.differences] == [e[3] for e in expected]


@pytest.mark.parametrize("force", ["FX=-150 FY=100 FZ=60", "FX=-151 FY=100 FZ=120", "FX=-150 FY=100.5 FZ=120 MZ=-1.5"])
def test_a_comment_with_another_force_is_quoted_with_that_of_the_nominal_program(force):
    found = compare(nominal(FORCE), read_files({"OTHER.src": f"{HEAD}; FORCE {force}\n{BODY}"}), ROBOT, CELL)
    now = " ".join(part.partition("=")[2] for part in force.split()[:3])
    message = (
        f"its comments give the force {now} N instead of -150 100 120 N ($BASE): it was corrected for another one."
    )
    assert named(found) == [("force", message, 1, 1, 6)]


def test_forces_alike_but_for_the_digits_written_are_the_same():
    text = f"{HEAD}; FORCE FX=-150.04 FY=100.02 FZ=120.03\n{BODY}"
    assert named(compare(nominal(FORCE), read_files({"OTHER.src": text}), ROBOT, CELL)) == []


@pytest.mark.parametrize(("first", "second", "count"), [(10, 20, 1), (20, 10, 0)])
def test_inserted_targets_in_the_wrong_order_are_told_with_the_way_back(first, second, count):
    between = "".join(POINT.replace("Y 0", f"Y {y}") for y in (first, second))
    found = compared(edited((POINT, between + POINT)), FORCE)
    back = [(d.message, d.nominal, d.corrected, d.count) for d in found.differences if d.kind == "back"]
    message = "the robot goes {:.4f} mm back on its path."
    assert len(back) == count
    if count:
        way = float(back[0][0].split()[3])
        assert way == pytest.approx(10.0, abs=0.02)  # mm; the deflection differs by less between the two
        assert back[0] == (message.format(way), None, ("OTHER.src", FIRST + 6), 1)


RAIL = replace(CELL, external_axes={"E1": ExternalAxis(direction=(0.0, 1.0, 0.0))})


def test_a_robot_on_a_track_cuts_as_one_that_was_set_up_there():
    """E1 = 300 and $BASE moved with it: the same poses of the arm, so the same deviations, between targets too."""
    inserted = "LIN {X 80,Y 12,Z 0.2,A 180.1,B 0,C 180}\n"
    texts = [HEAD + FORCE + body for body in (BODY, edited((POINT, inserted + POINT)))]
    fixed = compare(*(read_files({"P.src": text}) for text in texts), ROBOT, CELL).cuts
    there = [
        text.replace("Y -200", "Y 100").replace("C 180", "C 180,E1 300").replace("A6 0}", "A6 0,E1 300}")
        for text in texts
    ]
    programs = (read_files({"P.src": text}, RAIL) for text in there)
    moved = compare(*programs, ROBOT, RAIL).cuts
    assert np.sort(np.linalg.norm(fixed.corrected_deviation, axis=1))[1] > 1e-4  # but for the rapid motion
    assert len(fixed.row) > 10
    assert (fixed.path_rotation != 0.0).tolist() == (fixed.t == 1.0).tolist()
    for name in ("wrench", "nominal", "corrected_deviation", "rotation", "t", "length"):
        np.testing.assert_allclose(getattr(moved, name), getattr(fixed, name), rtol=0, atol=1e-7, err_msg=name)
    for between in ("nominal_distance", "corrected_distance", "path_rotation"):
        np.testing.assert_allclose(getattr(moved, between), getattr(fixed, between), rtol=0, atol=1e-7, err_msg=between)


def placed(text):
    return PlacedProgram.of(read_files({"ONE.src": text}), RobotInCell.of(ROBOT, CELL))


def test_lines_and_arcs_are_looked_at_every_centimetre_and_short_ones_at_least():
    lines = [f"LIN {{X {x},Y 0,Z 0,{TURNED}}}" for x in (0, 4, 29)]
    arcs = [f"CIRC {{X {x + 1},Y 1,Z 0}},{{X {x + 2},Y 0,Z 0,{TURNED}}}" for x in (29,)]
    arcs.append(f"CIRC {{X 61,Y 30,Z 0}},{{X 91,Y 0,Z 0,{TURNED}}}")
    side = placed("\n".join([HEAD, *lines, *arcs, "END", ""]))
    pieces = np.arange(2, 6)
    for steep, least in ((False, 2), (True, 4)):
        row, t = places_on_pieces(side, pieces, np.full(len(pieces), steep))
        parts = {2: least, 3: max(3, least), 4: 4, 5: 10}  # 4 mm, 25 mm, arcs of 3 and 94 mm
        for piece, count in parts.items():
            np.testing.assert_allclose(t[row == piece], np.arange(1, count) / count, rtol=1e-12)


@pytest.mark.parametrize("share", np.linspace(0.05, 0.95, 10))
def test_the_nearest_place_is_sought_on_its_way_alone(share):
    """Before it and after it the path passes the same points, on the way there and on the way back."""
    lines = [f"LIN {{X {x},Y 0,Z 0,{TURNED}}}" for x in (-60, 60, -60, 60)]
    side = placed("\n".join([HEAD, *lines, "END", ""]))
    motion, t = np.array([3]), np.array([share])
    load = side.forces(None)
    search = Search(side, side, load, None)
    low, high = side.arc_length[[3]], side.arc_length[[4]]
    found = search._nearest_lengths(side.joints_at(motion, t), np.zeros((1, 3)), (low, high))
    np.testing.assert_allclose(found, low + share * (high - low), atol=8e-5)  # 120 mm in 64 parts, refined twice


def test_the_nearest_place_of_a_short_way_is_not_behind_its_end():
    """The way is 0.3 mm, a tenth of what a force needs to come up thrice; the tip is 0.2 mm behind it."""
    side = placed("\n".join([HEAD, *(f"LIN {{X {x},Y 0,Z 0,{TURNED}}}" for x in (0, 0.3, 60)), "END", ""]))
    search = Search(side, side, side.forces(None), None)
    motion, t = np.array([3]), np.array([0.2 / 59.7])
    low, high = side.arc_length[[2]], side.arc_length[[3]]
    found = search._nearest_lengths(side.joints_at(motion, t), np.zeros((1, 3)), (low, high))
    np.testing.assert_allclose(found, high, atol=1e-9)


def lines(*points):
    return placed("\n".join([HEAD, *(f"LIN {{X {x},Y {y},Z 0,{TURNED}}}" for x, y in points), "END", ""]))


@pytest.mark.parametrize(
    ("second", "partner", "found"),
    [
        ((20, 0), [0, 1, 3, 4], [0, 1, 3, 4]),
        ((20, 0), [0, 2, 3, 4], [0, 1, 3, 4]),  # 1 is free, and brings the tip to the target
        ((20, 0), [0, 1, 2, 4], [0, 1, 3, 4]),
        ((20, 0), [-1, 1, 3, 4], [0, 1, 3, 4]),
        ((20, 0), [0, 1, 3, -1], [0, 1, 3, 4]),
        ((20, 0), [0, 1, 4, 5], [0, 1, 3, 4]),
        ((20, 0), [0, -1, 1, 4], [0, 1, 3, 4]),  # in the second round: 1 is free once the next one has left it
        ((0, 0.003), [-1, 0, 3, 4], [-1, 0, 3, 4]),  # 0 has a partner already, behind the first
        ((0, 0.003), [0, -1, 3, 4], [0, -1, 3, 4]),  # and before the second
    ],
)
def test_partners_are_exchanged_for_free_ones_that_bring_the_tip_to_the_target(second, partner, found):
    one = lines((0, 0), second, (40, 0), (40, 20))
    other = lines((0, 0), (20, 0), (20, 9), (40, 0), (40, 20), (50, 20))
    none = np.zeros((4, 6))
    assert partners_under_force(one, other, np.array(partner), none).tolist() == found


def test_partners_stay_in_order_where_the_path_passes_a_target_twice():
    """The third target is where the first is: its partner, when it has none, is behind that of the second."""
    one = lines((0, 0), (20, 0), (40, 0), (20, 0), (40, 20))
    other = lines((0, 0), (20, 0), (40, 0), (20, 9), (20, 0), (40, 20))
    for partner in ([0, 1, 2, 3, 5], [0, 1, 2, -1, 5]):
        assert partners_under_force(one, other, np.array(partner), np.zeros((5, 6))).tolist() == [0, 1, 2, 4, 5]
    other = lines((0, 0), (20, 0), (40, 0), (20, 9), (40, 20))
    for partner in ([0, 1, 2, 3, 4], [0, 1, 2, -1, 4]):  # and not that of the second target
        assert partners_under_force(one, other, np.array(partner), np.zeros((5, 6))).tolist() == partner


def test_no_target_is_the_partner_of_two_and_none_of_one_behind_a_later_one():
    assert ordered_partners(np.array([0, 2, 1, -1, 2, 3, 3])).tolist() == [0, 2, -1, -1, -1, 3, -1]


def test_only_free_partners_of_the_same_kind_are_taken():
    text = "\n".join([HEAD, *(f"LIN {{X {x},Y 0,Z 0,{TURNED}}}" for x in (0, 20, 40)), "END", ""])
    one = placed(text)
    other = placed(text.replace("LIN {X 20", f"PTP {{X 20,Y 0,Z 0,{TURNED}}}\nLIN {{X 21"))
    found = partners_under_force(one, other, np.array([0, 2, 3]), np.zeros((3, 6)))
    assert found.tolist() == [0, 2, 3]


@pytest.mark.parametrize(("bulge", "passed"), [(1.5, True), (1.7, False)])
def test_a_point_of_a_line_is_passed_within_a_tenth_and_three_times_the_offset(bulge, passed):
    """Pairs that are 0.5 mm off; between them the second path bulges by so much more."""
    one = lines((0, 0), (20, 0), (40, 0), (40, 30))
    other = lines((0, 0.5), (10, 0.5 + bulge), (30, 0.5 + bulge), (40, 0.5), (40, 30.5))
    found = pair_targets(one, other, np.array([0, -1, 3, 4]), np.ones(4, dtype=bool))
    missed, judged = missed_targets(found, one, other, None)
    np.testing.assert_allclose(missed, bulge * 1e-3, atol=1e-6)
    assert judged.tolist() == [passed]


def test_what_the_offsets_next_to_a_corner_differ_by_is_no_miss_of_it():
    """Offsets of 0.2 and 0.6 mm: the corner is missed by 3 mm, 0.4 of which may be a correction."""
    one = lines((0, 0), (20, 0), (20, 3), (40, 3), (40, 30))
    other = lines((0, 0.2), (20, 0.2), (40, 3.6), (40, 30.6))
    found = pair_targets(one, other, np.array([0, 1, -1, 2, 3]), np.ones(5, dtype=bool))
    missed, judged = missed_targets(found, one, other, None)
    a, b = np.array([20.0, 0.2]), np.array([40.0, 3.6])  # the line that cuts the corner
    share = np.linspace(0.0, 1.0, 200_001)[:, None]
    wanted = [20.0, 3.0 + 0.2 + 0.4 * 3.0 / 23.0]  # the offset between, by length of path
    nearest = np.linalg.norm(a + share * (b - a) - wanted, axis=1).min()
    np.testing.assert_allclose(missed, (nearest - 0.4) * 1e-3, atol=2e-7)
    assert judged.tolist() == [False]


def test_under_forces_a_missing_target_is_missed_by_the_tip_and_without_less_the_offset():
    """The second path runs 0.5 mm beside the nominal one, and no force explains that."""
    one, other = lines((0, 0), (20, 0), (40, 0), (40, 30)), lines((0, 0.5), (40, 0.5), (40, 30.5))
    found = pair_targets(one, other, np.array([0, -1, 1, 2]), np.ones(4, dtype=bool))
    for load, expected in ((None, 0.0), (one.forces(None), 0.5e-3)):
        missed, _ = missed_targets(found, one, other, load)
        np.testing.assert_allclose(missed, [expected], atol=1e-7)


def test_pieces_begin_where_the_one_before_ends():
    one = lines((0, 0), (40, 0), (40, 30))
    other = lines((0, 0), (10, 0), (30, 0), (40, 0), (40, 12), (40, 30))
    found = pair_targets(one, other, np.array([0, 3, 5]), np.ones(3, dtype=bool))
    ways = Stretches.from_pairs(found, one, other)
    ends = np.array([0.0, 10.0, 30.0, 40.0, 52.0, 70.0]) * 1e-3
    place = np.append(np.nan, one.arc_length[2] + ends)  # row 0 is the axis target
    begins = ways.begin_lengths(np.arange(2, 7), place)
    np.testing.assert_allclose(begins - one.arc_length[2], ends[:-1], atol=1e-9)
    np.testing.assert_allclose(ways.begin_lengths(np.array([1]), place), one.arc_length[1], atol=1e-9)
    np.testing.assert_allclose(ways.guessed_lengths(np.arange(2, 7)) - one.arc_length[2], ends[1:], atol=1e-9)


def test_forces_at_pairs_are_those_at_the_end_of_the_motion():
    """In FEED axes: the arc ends with travel along −Y, the line before it along Y, the one after it along −Y."""
    found = compared(BODY, "; FORCE FX=100 FY=0 FZ=0 FRAME=FEED\n")
    expected = [[1, 0, 0], [0, 1, 0], [0, -1, 0], [0, -1, 0]]
    np.testing.assert_allclose(found.cuts.wrench[1:5, :3], 100.0 * np.array(expected), atol=1e-6)


def test_the_nearest_place_of_a_metre_of_path_is_found_to_four_micrometres():
    """By its distance from a helix, whose nearest place to its own points is known."""

    def helix(at):
        return np.stack([0.1 * np.cos(8.0 * at), 0.1 * np.sin(8.0 * at), 0.6 * at], axis=-1)

    wanted = np.random.default_rng(1).uniform(0.01, 0.99, 200)
    place, distance = nearest(lambda _, length: helix(length), helix(wanted), np.zeros(200), np.ones(200))
    np.testing.assert_allclose(place, wanted, rtol=0, atol=4e-6)
    np.testing.assert_allclose(distance, np.abs(place - wanted), rtol=1e-3, atol=1e-9)  # at unit speed
    place, _ = nearest(
        lambda _, length: helix(length), helix(np.array([0.2, 0.9])), np.array([0.3, 0.3]), np.array([0.7, 0.7])
    )
    np.testing.assert_allclose(place, [0.3, 0.7], rtol=0, atol=1e-6)


def test_a_target_between_two_detours_is_on_the_path():
    """Neither the share of the way nor the length from either end tells where on the nominal path it is."""
    one = lines((0, 0), (80, 0), (80, 30))
    other = lines((0, 0), (20, 30), (30, 0), (60, 10), (80, 0), (80, 30))
    found = pair_targets(one, other, np.array([0, 4, 5]), np.ones(3, dtype=bool))
    assert found.inserted_rows.tolist() == [3]  # row 0 is the axis target
    assert found.additional_rows.tolist() == [2, 4]


def test_a_target_behind_the_last_pair_is_not_inserted_and_one_on_the_line_is_even_if_axes_move_to_it():
    """The first is on what would be the continuation of the nominal line."""
    one = lines((0, 0), (40, 0), (40, 30))
    other = lines((0, 0), (40, 0), (40, 30), (40, 30), (40, 50))
    found = pair_targets(one, other, np.array([0, 1, 2]), np.ones(3, dtype=bool))
    assert (found.inserted_rows.tolist(), found.additional_rows.tolist()) == ([], [4, 5])  # row 0 is the axis target
    text = "\n".join([HEAD, *(f"LIN {{X {x},Y 0,Z 0,{TURNED}}}" for x in (0, 20, 40)), "END", ""])
    one, other = (
        placed(text.replace(f"LIN {{X 20,Y 0,Z 0,{TURNED}}}\n", "")),
        placed(text.replace("LIN {X 20", "PTP {X 20")),
    )
    found = pair_targets(one, other, np.array([0, 2]), np.ones(2, dtype=bool))
    assert (found.inserted_rows.tolist(), found.additional_rows.tolist()) == ([2], [])
    assert np.isnan(found.path_distance).tolist() == [True, True]  # a PTP is between


def test_comments_of_the_second_program_alone_count_at_pairs():
    found = compare(nominal(), read_files({"OTHER.src": HEAD + FORCE + BODY}), ROBOT, CELL)
    assert [len(getattr(found.cuts, name)) for name in ("row", "t", "nominal_distance", "length")] == [0] * 4
    cutting = ~found.rapid
    np.testing.assert_allclose(found.cuts.wrench[cutting], np.tile([-150.0, 100, 120, 0, 0, 0], (6, 1)))
    np.testing.assert_allclose(found.cuts.corrected_deviation, found.cuts.nominal, atol=1e-9)
    assert np.linalg.norm(found.cuts.nominal[cutting], axis=1).min() > 1e-4


@pytest.mark.parametrize(("more", "count"), [(0.0005, 0), (0.0015, 1)])
@pytest.mark.parametrize("frame", ["BASE", "TOOL"])
def test_frames_that_differ_by_more_than_a_micrometre_are_reported(frame, more, count):
    text = HEAD.replace("Z 700" if frame == "BASE" else "Z 350", f"Z {(700 if frame == 'BASE' else 350) + more:.4f}")
    found = compare(nominal(), read_files({"OTHER.src": text + BODY}), ROBOT, CELL)
    assert [(d.kind, d.count) for d in found.differences] == count * [(frame.lower(), 7)]


def test_motions_known_at_run_time_only_are_counted():
    keeping = replace(CELL, krl=replace(CELL.krl, keep_unresolved=True))
    unknown = "LIN $POS_ACT:{X 0,Y 5,Z -5}\n"
    texts = [HEAD + edited((POINT, POINT + n * unknown)) for n in (1, 3)]
    one, other = (read_files({"P.src": text}, keeping) for text in texts)
    for pair in ((one, other), (other, one)):
        (found,) = (d for d in compare(*pair, ROBOT, keeping).differences if d.kind == "unresolved-differs")
        assert (found.level, found.count) == ("error", 2)


CARRIED = (HEAD + BODY).replace("C 180", "C 180,E1 300").replace("A6 0}", "A6 0,E1 300}")


def external_axes(texts, cell):
    programs = (read_files({"P.src": text}, cell) for text in texts)
    return [d for d in compare(*programs, ROBOT, cell).differences if d.kind == "external-axis"]


def test_another_place_on_the_track_is_reported_at_pairs():
    """At two targets, by 10 and by −9.5 mm."""
    other = CARRIED.replace("X 80,Y 0,Z 0,A 180,B 0,C 180,E1 300", "X 80,Y 0,Z 0,A 180,B 0,C 180,E1 310")
    other = other.replace("X 100,Y 40,Z 0,A 180,B 0,C 180,E1 300", "X 100,Y 40,Z 0,A 180,B 0,C 180,E1 290.5")
    (found,) = external_axes((CARRIED, other), RAIL)
    assert found.message.startswith("E1 is at 310.0000 mm instead of 300.0000 mm:")
    assert (found.nominal, found.corrected, found.count) == (("P.src", FIRST + 4), ("P.src", FIRST + 4), 2)
    assert external_axes((CARRIED, CARRIED.replace("E1 300", "E1 300.005")), RAIL) == []


@pytest.mark.parametrize(
    ("first", "second", "which"), [(CARRIED, HEAD + BODY, "nominal"), (HEAD + BODY, CARRIED, "corrected")]
)
def test_a_track_that_one_program_alone_uses_is_reported(first, second, which):
    found = external_axes((first, second), RAIL)[0]
    assert found.message == f"E1, which carries the robot, has values in the {which} program only."
    assert found.count == 7


@pytest.mark.parametrize(
    ("first", "second", "words", "places"),
    [
        ("E1 300", "E1 310", "E1 is at 310 in the corrected program, and at 300 in the nominal one.", (-1, -1)),
        (
            "E1 300",
            None,
            "E1 is at 0 or not given in the corrected program, and at 300 in the nominal one.",
            (-1, None),
        ),
        (
            None,
            "E2 300",
            "E2 is at 300 in the corrected program, and at 0 or not given in the nominal one.",
            (None, -1),
        ),
        ("E1 300", "E1 300", None, None),
    ],
)
def test_an_external_axis_that_carries_nothing_is_reported_once(first, second, words, places):
    texts = [CARRIED.replace("E1 300", axis) if axis else HEAD + BODY for axis in (first, second)]
    found = external_axes(texts, CELL)
    expected = [(words, *(None if k is None else ("P.src", FIRST + k) for k in places))] if words else []
    assert [(d.message, d.nominal, d.corrected) for d in found] == expected


def test_arcs_of_either_program_are_drawn_by_chords():
    """Half a circle, in pieces of 9.9° at most; in the second program also an arc of 103° to the point after it."""
    arc, line = f"CIRC {{X 60,Y 50,Z 0}},{{X 80,Y 30,Z 0,{TURNED}}}", f"LIN {{X 80,Y 30,Z 0,{TURNED}}}"
    other = f"CIRC {{X 87.4357,Y 15,Z 0}},{{X 80,Y 0,Z 0,{TURNED}}}\n"
    for edits, expected in (([], [19, 1]), ([(arc, line)], [19, 1]), ([(POINT, other)], [19, angle_parts()])):
        found = compared(edited(*edits))
        assert found.curves.parts(np.radians(9.9)).tolist() == [1, 1, 1, *expected, 1, 1]


def angle_parts():
    """Pieces of the arc from (80, 30) through (87.4357, 15) to (80, 0): its angle is four times that of the sagitta."""
    return int(np.ceil(np.degrees(4.0 * np.arctan(7.4357 / 15.0)) / 9.9))


@pytest.mark.parametrize("angle", ["B 0.5,C 180", "B 0,C 180.5", "B 0,C 180"])
def test_a_target_off_the_path_is_none_of_it_however_the_tool_is_turned(angle):
    end = f"{{X 80,Y 30,Z 0,{TURNED}}}"
    point = POINT.replace("B 0,C 180", angle)
    body = edited((end, end.replace("B 0,C 180", angle)), (POINT, point.replace("X 80,Y 0", "X 85,Y 15") + point))
    found = compared(body)
    assert found.inserted_rows.tolist() == []
    assert [(d.count, d.corrected[1] - FIRST) for d in found.differences if d.kind == "only-corrected"] == [(1, 4)]


def test_motions_without_a_way_share_it_by_their_number():
    """Three PTP to one place, of which the last one alone has a partner: the others are at a third and two thirds."""
    point = f"PTP {{X 100,Y 0,Z 40,{TURNED},S 2,T 2}}\n"
    side = placed(HEAD + BODY.replace(point, 3 * point))
    m = side.program.motions
    rows = np.flatnonzero((m.kind == PTP) & np.isnan(m.joints[:, 0]))
    chain = Chain.of(side, np.array([rows[0] - 1, rows[2], rows[2] + 1]))
    np.testing.assert_array_equal(chain.row, [*rows, rows[2] + 1])
    np.testing.assert_allclose(chain.end, [1 / 3, 2 / 3, 1.0, 2.0])
    np.testing.assert_allclose(chain.begin, [0.0, 1 / 3, 2 / 3, 1.0])


def test_a_turn_of_zero_in_both_programs_is_no_difference():
    text = HEAD + BODY.replace("T 2}", "T 0}")
    assert named(compare(read_files({"ONE.src": text}), read_files({"OTHER.src": text}), ROBOT, CELL)) == []


@pytest.mark.parametrize("payload", [0.0, 20.0])
def test_ways_by_ptp_and_from_where_nothing_is_corrected_are_not_compared_inside(payload):
    """The robot comes from an axis target to the first pair, and by a PTP to the last but one."""
    cell = replace(CELL, payload=replace(CELL.payload, mass_kg=payload))
    side = PlacedProgram.of(read_files({"ONE.src": HEAD + BODY}), RobotInCell.of(ROBOT, cell))
    found = pair_targets(side, side, np.arange(7), np.ones(7, dtype=bool))
    known = Stretches.from_pairs(found, side, side).is_comparable
    assert known.tolist() == [payload == 0.0, True, True, True, True, False, True]


class CurveSearch(Search):
    """A search with the offset of the tip given as a curve: it passes its nearest place at some rate of change."""

    def _tip_offset(self, q, displacement, length):
        """Rates and places are in the joint angles, the least distance in the displacement of the robot."""
        rate, place, bend = q[:, 0], q[:, 1], q[:, 2]
        gap = length - place
        return displacement + np.stack([rate * gap + bend * gap**2, np.zeros(len(q)), 0.0 * gap], axis=1)


@pytest.mark.parametrize("rate", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("bend", [0.0, 0.4])
def test_steps_to_the_nearest_place_are_those_of_newton_whatever_the_rate_of_the_tip(rate, bend):
    """A force that grows makes the tip pass faster or slower than the path; beyond the limits the limit is nearest."""
    place = np.array([0.02, 0.05, 0.099999, 0.13, -0.01])
    q = np.zeros((5, 6))
    q[:, :3] = np.column_stack([np.full(5, rate), place, np.full(5, bend)])
    aside = np.tile([0.0, 3e-4, -4e-4], (5, 1))
    limits = np.zeros(5), np.full(5, 0.1)
    search = CurveSearch(None, None, None, None)
    length, distance = search._newton_steps(q, aside, np.full(5, 0.06), limits, 1e-9)
    nearest = np.clip(place, 0.0, 0.1)
    gap = np.abs(rate * (nearest - place) + bend * (nearest - place) ** 2)
    np.testing.assert_allclose(length, nearest, atol=2e-6)
    np.testing.assert_allclose(distance, np.hypot(5e-4, gap), atol=2e-9)


def test_a_place_that_does_not_matter_or_is_near_enough_stays():
    """The tool only turns there, or the distance is that asked for."""
    q = np.zeros((2, 6))
    q[:, :2] = [[0.04, 0.02], [1.0, 0.02]]
    start = np.array([0.06, 0.06])
    limits = np.zeros(2), np.full(2, 0.1)
    for accuracy, moves in ((0.05, False), (1e-9, True)):
        search = CurveSearch(None, None, None, None)
        length, _ = search._newton_steps(q, np.zeros((2, 3)), start.copy(), limits, accuracy)
        assert length[0] == 0.06
        assert (abs(length[1] - 0.02) < 1e-9) == moves
