"""Parts of a comparison on programs that are made up: statements between motions, speeds, missing and moved targets."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.comparison import differences, settings, statements
from postproc.comparison.result import Comparison, file_and_line, pair_warning
from postproc.program import CIRC, LIN, PTP, SPL, Document, UnresolvedMotion
from tests.comparison.krl_moves import TURNED
from tests.corrections import read_files
from tests.programs import program

TEXT = """DEF a( )
$OUT[1]=TRUE
LIN p1
LOOP
  FOR i=1 TO 3
    WAIT SEC 1 ; inner
  ENDFOR
  LIN p2
  TRIGGER WHEN DISTANCE=0 DELAY=-5 DO $OUT[2]=TRUE
  ; WAIT SEC 9
  LIN p3
  $ANOUT[1] = 0.5
ENDLOOP
HALT
END
DEF b( )
PULSE($OUT[3],TRUE,1)
LIN p4
END"""
TEXTS = statements._Texts(SimpleNamespace(documents=(Document("a.src", TEXT), Document("b.src", "LIN p5\nHALT"))))


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        (8, 11, [("TRIGGERDO$OUT[2]=TRUE", 9)]),
        (3, 8, [("WAITSEC1", 6)]),
        (11, 8, [("$ANOUT[1]=0.5", 12), ("WAITSEC1", 6)]),  # round the LOOP, past the FOR in it
        (1, 3, [("$OUT[1]=TRUE", 2)]),
        (18, 3, None),  # no loop is around them
    ],
)
def test_statements_between_two_motions_are_those_on_the_way(start, end, expected):
    assert TEXTS.statements_between(("a.src", start), ("a.src", end)) == expected


def test_the_way_round_a_loop_goes_from_its_last_line_to_its_first():
    """Its motions are next to its begin and end, or statements are between; other loops in them are passed."""
    text = "DEF c( )\nLOOP\nLIN p1\nHALT\nFOR i=1 TO 2\nWAIT SEC 1\nENDFOR\nLIN p2\nENDLOOP\nEND"
    texts = statements._Texts(SimpleNamespace(documents=(Document("c.src", text),)))
    assert texts.statements_between(("c.src", 8), ("c.src", 3)) == []
    assert texts.statements_between(("c.src", 3), ("c.src", 3)) == [("HALT", 4), ("WAITSEC1", 6)]
    assert texts.statements_between(("c.src", 3), ("c.src", 8)) == [("HALT", 4), ("WAITSEC1", 6)]
    farther = text.replace("LOOP\nLIN p1", "LOOP\nHALT\nLIN p1").replace("LIN p2\n", "LIN p2\nPULSE(1)\n")
    texts = statements._Texts(SimpleNamespace(documents=(Document("c.src", farther),)))
    assert texts.statements_between(("c.src", 9), ("c.src", 4)) == [("PULSE(1)", 10), ("HALT", 3)]


def test_what_is_right_before_or_behind_a_loop_is_not_in_its_rounds():
    text = "DEF d( )\nLIN p0\nHALT\nLOOP\nLIN p1\nENDLOOP\nPULSE(1)\nLIN p2\nEND"
    texts = statements._Texts(SimpleNamespace(documents=(Document("d.src", text),)))
    assert texts.statements_between(("d.src", 5), ("d.src", 5)) == []
    assert texts.statements_between(("d.src", 2), ("d.src", 5)) == [("HALT", 3)]
    assert texts.statements_between(("d.src", 5), ("d.src", 8)) == [("PULSE(1)", 7)]


def test_statements_between_files_are_not_known_and_a_routine_has_its_ends():
    assert TEXTS.statements_between(("a.src", 3), ("b.src", 1)) is None
    assert TEXTS.statements_between(("c.src", 1), ("c.src", 2)) is None
    assert TEXTS.routine_limits(("a.src", 8)) == (("a.src", 1), ("a.src", 15))
    assert TEXTS.routine_limits(("a.src", 18)) == (("a.src", 16), ("a.src", 19))
    assert TEXTS.routine_limits(("b.src", 1)) == (("b.src", 0), ("b.src", 3))


def test_statements_of_one_side_only_are_its_surplus_and_of_another_order_all():
    first = [("A", 1), ("B", 2), ("A", 3), ("C", 4)]
    assert list(statements._unmatched_statements(first, [("A", 7), ("D", 8), ("B", 9)])) == [
        ("A", 1, False), ("C", 4, False), ("D", 8, True),
    ]  # fmt: skip
    assert list(statements._unmatched_statements([("A", 1), ("B", 2)], [("B", 7), ("A", 8)])) == [
        ("B", 7, True),
        ("A", 8, True),
    ]


TWO_ROUTINES = f"""DEF main( )
$VEL.CP=0.05
$BASE={{X 1500,Y -200,Z 700,A 0,B 0,C 0}}
$TOOL={{X 0,Y 0,Z 350,A 0,B 0,C 0}}
PTP {{A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}}
LIN {{X 0,Y 0,Z 0,{TURNED}}}
side( )
END
DEF side( )
LIN {{X 40,Y 0,Z 0,{TURNED}}}
LIN {{X 40,Y 30,Z 0,{TURNED}}}
END
"""
"""Motions on lines 6, 10 and 11: the last one is in another routine than the first."""


def listed(second):
    """Statement differences of a program from the one above: line in each program, count and text."""
    programs = [read_files({f"{name}.src": text}) for name, text in (("one", TWO_ROUTINES), ("two", second))]
    rows = [np.flatnonzero(np.isnan(made.motions.joints[:, 0])) for made in programs]
    found = statements.statement_differences(compared(*programs, pair=np.stack(rows, axis=1)))
    return [(d.kind, d.nominal, d.corrected, d.count, d.message.partition(" is ")[0]) for d in found]


@pytest.mark.parametrize(
    ("before", "nominal", "corrected"),
    [
        ("$VEL.CP", 6, 2),  # before the first motion: its place in the nominal program is that of the motion behind
        ("side( )\nEND", 10, 7),
        ("LIN {X 40,Y 30", 11, 11),
        ("END\n", 11, 12),  # behind the last motion, to the end of its own routine
    ],
)
def test_a_statement_in_any_part_of_two_routines_is_named_by_its_line(before, nominal, corrected):
    head, middle, tail = TWO_ROUTINES.rpartition(before)
    found = listed(f"{head}$OUT[3]=TRUE\n{middle}{tail}")
    assert found == [("statement", ("one.src", nominal), ("two.src", corrected), 1, "$OUT[3]=TRUE")]


@pytest.mark.parametrize("count", [19, 20, 21, 23])
def test_twenty_statements_are_listed_and_the_others_counted(count):
    """Each is at two places."""
    added = "".join(f"$OUT[{n}]=TRUE\n" for n in range(count))
    text = TWO_ROUTINES.replace("LIN {X 40,Y 30", f"{added}LIN {{X 40,Y 30").replace("LIN {X 0,", f"{added}LIN {{X 0,")
    found = listed(text)
    assert [entry[4] for entry in found[:20]] == [f"$OUT[{n}]=TRUE" for n in range(min(count, 20))]
    assert [entry[1:4] for entry in found[:20]] == [
        (("one.src", 6), ("two.src", 6 + n), 2) for n in range(min(count, 20))
    ]
    words = f"{count - 20} other statements that switch, wait or set accelerations differ."
    assert found[20:] == ([("statement", None, None, 2 * (count - 20), words)] if count > 20 else [])


MOVES = [("PTP", 0, 0, 50), ("LIN", 0, 0, 0), ("LIN", 100, 0, 0), ("RAPID", 100, 0, 50), ("LIN", 0, 0, 50)]


def compared(nominal=None, corrected=None, pair=None, **fields) -> Comparison:
    nominal, corrected = nominal or program(MOVES), corrected or program(MOVES)
    pair = np.repeat(np.arange(5), 2).reshape(-1, 2) if pair is None else np.array(pair)
    none = np.zeros(0, dtype=np.int64)
    made = Comparison(
        nominal=nominal, corrected=corrected, robot="x", pair=pair, inserted_rows=none, passed_rows=none,
        passing_distance=np.zeros(0), only_nominal=none, missing_distance=np.zeros(0), additional_rows=none,
        pose=corrected.motions.target[pair[:, 1]], rotation=np.zeros(len(pair)), curves=None,
        path_length=np.array([0.0, 0.05, 0.1, 0.2, 0.3]),
        path_distance=np.zeros(len(pair)), cuts=None, differences=(),
    )  # fmt: skip
    return replace(made, **fields)


def test_offsets_are_from_the_nominal_to_the_commanded_position():
    pose = program(MOVES).motions.target[:].copy()
    pose[2, :3, 3] += [3e-3, 0.0, -4e-3]
    found = compared(pose=pose)
    np.testing.assert_allclose(found.offset[2], [3e-3, 0.0, -4e-3], atol=1e-15)
    np.testing.assert_allclose(found.distance, [0.0, 0.0, 5e-3, 0.0, 0.0], atol=1e-15)
    assert found.rapid.tolist() == [True, False, False, True, False]


def test_speeds_differ_by_more_than_a_thousandth_and_a_micrometre_a_second():
    corrected = program(MOVES)
    limit = 1e-3 * 0.05 + 1e-6
    corrected.motions.feed[[1, 2, 4]] += [0.99 * limit, 1.01 * limit, -1.01 * limit]
    found = compared(corrected=corrected, pair=[(1, 1), (2, 2), (3, 3), (4, 4)])
    np.testing.assert_allclose(found.speeds[:, 0], [0.05, 0.05, 0.5, 0.05])
    np.testing.assert_allclose(found.speeds[0, 1], 0.05 + 0.99 * limit)
    assert found.speed_differs.tolist() == [False, True, False, True]
    assert compared().speed_differs.tolist() == [False] * 5  # unknown speeds of joint interpolations are none


def test_a_piece_of_a_spline_in_both_programs_is_not_compared():
    nominal, corrected = program(MOVES), program(MOVES)
    nominal.motions.kind[[1, 2]], corrected.motions.kind[[2, 4]] = SPL, SPL
    assert compared(nominal, corrected).spline.tolist() == [False, False, True, False, False]


@pytest.mark.parametrize(
    ("distance_mm", "kind", "level"), [(7.9, LIN, "warning"), (8.1, LIN, "error"), (8.1, PTP, "warning")]
)
def test_an_additional_target_of_a_cut_is_an_error_where_it_is_farther_off_than_a_correction_may_be(
    monkeypatch, distance_mm, kind, level
):
    cell = SimpleNamespace(output=SimpleNamespace(max_correction_mm=8.0))
    path = SimpleNamespace(robot_in_cell=SimpleNamespace(tolerance=1e-4, cell=cell))
    found = compared(pair=[(0, 0), (4, 4)], additional_rows=np.array([2, 3]))
    found.corrected.motions.kind[3], found.corrected.motions.rapid[3] = kind, False
    monkeypatch.setattr(differences, "_distances_of_targets", lambda *parts: np.array([1e-3, 1e-3 * distance_mm]))
    (additional,) = differences._unpaired_targets(found, path, path)
    assert (additional.level, additional.corrected) == (level, ("part.nc", 4))
    assert additional.message == f"an additional target, {distance_mm:.4f} mm from the nominal path."
    # the worst cut is named, not a joint motion that is farther off
    monkeypatch.setattr(differences, "_distances_of_targets", lambda *parts: np.array([0.5, 1e-3 * distance_mm]))
    found.corrected.motions.kind[2] = PTP
    (additional,) = differences._unpaired_targets(found, path, path)
    assert additional.corrected == ("part.nc", 4 if level == "error" else 3)
    # behind the last pair it may be a retract
    found = replace(found, pair=found.pair[:1])
    (additional,) = differences._unpaired_targets(found, path, path)
    assert additional.level == "warning"


def test_missing_targets_are_an_error_where_the_path_leaves_the_nominal_one_by_more_than_the_tolerance(monkeypatch):
    monkeypatch.setattr(differences, "_distances_of_targets", lambda *parts: np.zeros(2))
    cell = SimpleNamespace(output=SimpleNamespace(max_correction_mm=8.0))
    path = SimpleNamespace(robot_in_cell=SimpleNamespace(tolerance=1e-4, cell=cell))
    pair = [(0, 0), (1, 1), (4, 4)]
    off = compared(pair=pair, only_nominal=np.array([2, 3]), missing_distance=np.array([np.nan, 2.5e-4]))
    (found,) = differences._unpaired_targets(off, path, path)
    assert (found.level, found.kind, found.nominal, found.corrected, found.count) == (
        "error", "only-nominal", ("part.nc", 4), ("part.nc", 5), 2,
    )  # fmt: skip
    assert "leaves the nominal one by 0.2500 mm there." in found.message
    near = replace(off, missing_distance=np.array([0.9e-4, np.nan]), additional_rows=np.array([2, 3]))
    missing, additional = differences._unpaired_targets(near, path, path)
    assert (missing.level, missing.nominal) == ("warning", ("part.nc", 3))
    assert (additional.kind, additional.nominal, additional.corrected, additional.count) == (
        "only-corrected", None, ("part.nc", 3), 2,
    )  # fmt: skip
    last = compared(pair=[(0, 0)], only_nominal=np.array([4]), missing_distance=np.zeros(1))
    assert next(differences._unpaired_targets(last, path, path)).corrected is None


def unresolved(*texts: str):
    return tuple(UnresolvedMotion(f"a{k}.src", 10 + k, text, "why") for k, text in enumerate(texts))


def test_motions_known_at_run_time_only_are_compared_by_their_text():
    nominal = replace(program(MOVES), unresolved=unresolved("PTP p1", "LIN p2"))
    same = replace(program(MOVES), unresolved=unresolved("ptp  P1", "LIN p2"))
    assert list(differences._unresolved_differences(compared(nominal, same))) == []
    other = replace(program(MOVES), unresolved=unresolved("PTP p1", "LIN p3"))
    (found,) = differences._unresolved_differences(compared(nominal, other))
    assert (found.level, found.kind, found.nominal, found.corrected, found.count) == (
        "error", "unresolved-differs", ("a1.src", 11), ("a1.src", 11), 1,
    )  # fmt: skip
    (fewer,) = differences._unresolved_differences(compared(nominal, program(MOVES)))
    assert (fewer.nominal, fewer.corrected, fewer.count) == (("a0.src", 10), None, 2)
    listed = list(differences._uncompared_motions(compared(nominal, replace(same, unresolved=same.unresolved[:1]))))
    assert [(entry.nominal, entry.corrected) for entry in listed] == [
        (("a0.src", 10), ("a0.src", 10)), (("a1.src", 11), None),
    ]  # fmt: skip
    assert listed[0].message.endswith("known at run time only: 'PTP p1' (why).")


BEFORE_MOTION = """DEF a( )
LIN p0
; a comment
q = $POS_ACT
$VEL.CP=0.1
  Q.z = q.z + 5 ; up
LIN q
END"""


def with_statements(name, text, line):
    """A program of one file with a motion on a line of it that is known at run time only."""
    layout = SimpleNamespace(places=lambda rows: None)
    motions = () if line is None else (UnresolvedMotion(name, line, "LIN q", "why"),)
    return replace(program(MOVES), documents=(Document("part.src", text),), unresolved=motions, layout=layout)


@pytest.mark.parametrize(
    ("name", "edit", "shift", "differs"),
    [
        ("part.src", ("", ""), 0, False),
        ("part.src", ("q = $POS_ACT", "Q=$pos_act ; now"), 0, False),
        ("part.src", ("; a comment\n", ""), -1, False),
        ("part.src", ("LIN p0", "LIN p9"), 0, False),  # the motion before it is compared as a target
        ("part.src", ("+ 5", "+ 6"), 0, True),
        ("part.src", ("q = $POS_ACT\n", ""), -1, True),
        ("part.src", ("q = $POS_ACT", "i=1\nq = $POS_ACT"), 1, False),  # as far back as the nominal program goes
        ("part.src", ("LIN q", "i=1\nLIN q"), 1, True),
        ("other.src", ("+ 5", "+ 6"), 0, False),  # a file that is not there, such as one of a divided program
    ],
)
def test_what_a_motion_known_at_run_time_only_follows_from_is_the_same_in_both(name, edit, shift, differs):
    nominal = with_statements("part.src", BEFORE_MOTION, 7)
    corrected = with_statements(name, BEFORE_MOTION.replace(*edit), 7 + shift)
    expected = [("error", "unresolved-differs", ("part.src", 7), (name, 7 + shift), 1)] if differs else []
    found = differences._unresolved_differences(compared(nominal, corrected))
    assert [(d.level, d.kind, d.nominal, d.corrected, d.count) for d in found] == expected
    two_files = replace(corrected, documents=(*corrected.documents, Document("more.src", "")))
    assert list(differences._unresolved_differences(compared(nominal, two_files))) == []
    assert list(differences._unresolved_differences(compared(nominal, replace(corrected, layout=None)))) == []


def test_a_second_program_with_files_of_other_names_is_compared_by_its_own():
    nominal = with_statements("part.src", BEFORE_MOTION, 7)
    corrected = with_statements("second.src", BEFORE_MOTION.replace("+ 5", "+ 6"), 7)
    corrected = replace(corrected, documents=(Document("second.src", corrected.documents[0].text),))
    (found,) = differences._unresolved_differences(compared(nominal, corrected))
    assert (found.nominal, found.corrected) == (("part.src", 7), ("second.src", 7))


def test_a_difference_names_the_first_of_its_pairs_and_their_number():
    found = pair_warning(compared(pair=[(0, 0), (2, 3), (4, 4)]), "x", "words.", np.array([1, 2]))
    assert (found.level, found.nominal, found.corrected, found.count) == ("warning", ("part.nc", 3), ("part.nc", 4), 2)
    assert file_and_line(program(MOVES), None) is None
    assert file_and_line(program(MOVES), 3) == ("part.nc", 3)
    assert file_and_line(program(MOVES), 77) == ("part.nc", 77)


@pytest.mark.parametrize(
    ("degrees", "kind"), [(0.99 * np.degrees(1e-3), None), (1.01 * np.degrees(1e-3), "orientation")]
)
def test_a_turn_of_the_tool_beyond_the_tolerance_over_a_tenth_of_a_metre_is_listed(degrees, kind):
    """0.1 mm over 100 mm of tool is 1 mrad."""
    path = SimpleNamespace(robot_in_cell=SimpleNamespace(tolerance=1e-4))
    turned = compared(rotation=np.radians([0.0, 0.0, 0.5 * degrees, degrees, 0.0]))
    found = list(differences._orientation_differences(turned, path, path))
    assert [entry.kind for entry in found] == ([kind] if kind else [])
    if kind:
        assert (found[0].nominal, found[0].count) == (("part.nc", 4), 1)
        assert f"turned by {degrees:.4f}° from its nominal orientation" in found[0].message


def test_another_kind_of_motion_is_named_but_for_an_arc_that_became_lines():
    corrected = program(MOVES)
    corrected.motions.kind[2] = SPL
    (found,) = settings._kind_differences(compared(corrected=corrected))
    assert (found.kind, found.nominal, found.corrected) == ("kind", ("part.nc", 3), ("part.nc", 3))
    assert "is a spline (SPL) instead of a line (LIN)." in found.message
    arcs = program(MOVES)
    arcs.motions.kind[2] = CIRC
    assert list(settings._kind_differences(compared(arcs, program(MOVES)))) == []
    assert len(list(settings._kind_differences(compared(program(MOVES), arcs)))) == 1
