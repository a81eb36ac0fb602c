"""Corners: what a parabola of the controller does to them, where it is not allowed to, and what is said of it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace as changed

from postproc import correction, report, toolpath
from postproc.correction import targets as correction_targets
from postproc.correction.targets import Corners
from tests.corrections import correct_files, read_files
from tests.kr270 import CELL, ROBOT
from tests.oracle import cell_sim
from tests.programs import program as made_of

SPINDLE_ON_AT_Z10 = "G90 G21 G17\nS1000 M3 F600\nG0 X0 Y0 Z10\n"


def converted(text, dialect="gcode", **gcode):
    cell = changed(CELL, gcode=changed(CELL.gcode, **gcode))
    return correct_files({"part.nc" if dialect == "gcode" else "part.src": text}, cell)


def stops(result):
    """Whether each LIN and CIRC of the written text is an exact stop, and $APO.CDIS [mm] there."""
    out, cdis = [], np.nan
    for line in result.documents[0].text.splitlines():
        if line.startswith("$APO.CDIS="):
            cdis = float(line.partition("=")[2])
        elif line.startswith(("LIN", "CIRC")):
            out.append(cdis if line.endswith("C_DIS") else 0.0)
    return out


def passed_by(before, corner, after, distance):
    """How far the parabola of a controller passes a corner, by looking at many points of it."""
    one, two = corner - before, after - corner
    d = min(distance, np.linalg.norm(one) / 2, np.linalg.norm(two) / 2)
    a, b = corner - d * one / np.linalg.norm(one), corner + d * two / np.linalg.norm(two)
    t = np.linspace(0.0, 1.0, 4001)[:, None]
    curve = (1 - t) ** 2 * a + 2 * t * (1 - t) * corner + t**2 * b
    return np.linalg.norm(curve - corner, axis=1).min()


def test_the_parabola_passes_a_corner_where_the_formula_says():
    rng = np.random.default_rng(3)
    for _ in range(50):
        points = rng.normal(size=(3, 3)) * 1e-3
        distance = rng.uniform(1e-5, 2e-3)
        run = np.diff(points, axis=0)
        length = np.linalg.norm(run, axis=1)
        sharp = np.linalg.norm(run[1] / length[1] - run[0] / length[0])
        rounding = Corners(np.array([sharp]), 0.5 * length.min(keepdims=True)).rounding(np.array([distance]))
        assert rounding[0] == pytest.approx(passed_by(*points, distance), rel=1e-6)
        turn = np.arccos(run[0] @ run[1] / length.prod())
        assert sharp == pytest.approx(2 * np.sin(turn / 2), rel=1e-9)


@pytest.mark.parametrize("degrees", [5.0, 20.0, 22.0, 23.5, 25.0, 90.0, 179.0, 180.0])
def test_a_corner_that_blending_would_round_too_much_is_an_exact_stop(degrees):
    """0.5 mm / 2 · sin(turn / 2) is 0.05 mm at 23.07°."""
    x, y = 20 + 20 * np.cos(np.radians(degrees)), 20 * np.sin(np.radians(degrees))
    text = f"{SPINDLE_ON_AT_Z10}G1 Z0\nG1 X20\nG1 X{x:.4f} Y{y:.4f}\nG1 X60 Y40\nM2\n"
    at = stops(converted(text, approximation_mm=0.5))
    assert at[1] == (0.5 if degrees < 23.07 else 0.0)


def test_a_bottom_is_reached_and_an_arc_that_runs_on_is_not_stopped_at():
    text = f"{SPINDLE_ON_AT_Z10}G1 Z-5\nG0 Z10\nG0 X40\nG1 Z-5\nG1 Z2\nG1 X60\nG3 X60 Y20 I0 J10\nG1 X40\nM2\n"
    at = stops(converted(text))
    assert at[:5] == [0.0] * 5  # down, up, across, down, up
    assert at[5:] == [0.2, 0.2, 0.2, 0.0]  # along, half a circle in two pieces, back


@pytest.mark.parametrize(
    ("code", "stopping"), [("G61", True), ("G64 P0.1", False), ("G64 P2", False), ("G64 P0.001", False), ("G64", True)]
)
def test_the_modes_of_the_program_keep_their_meaning(code, stopping):
    """P is what the program allows at corners: no corner is rounded by more, and none within it is a stop."""
    result = converted(f"{SPINDLE_ON_AT_Z10}{code}\nG1 Z0\nG1 X20\nG1 Y20\nG1 X40\nM2\n", approximation_mm=0.5)
    at = stops(result)[:3]
    assert all(distance == 0.0 for distance in at) is stopping
    assert all(distance > 0.0 for distance in at) is not stopping
    assert 0.25 * np.sqrt(2.0) * max(at) <= float(code.partition("P")[2] or 0.05)


def test_no_approximation_means_exact_stops_at_inserted_targets_too():
    text = f"{SPINDLE_ON_AT_Z10}(FORCE FX=300 FZ=200)\nG1 Z0\nG1 X20\nG1 X40 Y3\nM2\n"
    assert set(stops(converted(text, approximation_mm=0.0))) == {0.0}


def corners_of(result):
    """How far the controller passes each target of the written text, read by the simulator [m]; LIN only."""
    moves = cell_sim.read(result.documents[0].text)
    spots = [np.array(move["frame"][:3]) / 1e3 if "frame" in move else None for move in moves]
    lines = [move["kind"] == "LIN" for move in moves]
    distance = dict(zip([n for n, lin in enumerate(lines) if lin], stops(result), strict=True))
    return [
        passed_by(spots[n - 1], spots[n], spots[n + 1], distance[n] / 1e3)
        for n in range(2, len(moves) - 1)
        if lines[n] and lines[n + 1] and spots[n - 1] is not None and distance[n] > 0.0
    ]


def test_rounding_is_that_of_the_written_text_and_small_where_only_the_force_changes():
    moves = "(FORCE FX=300 FZ=200)\nG1 Z0\nG1 X20\n(FORCE FX=-300)\nG1 X40 Y3\n(FORCE OFF)\nG1 X60 Y6\nM2\n"
    result = converted(SPINDLE_ON_AT_Z10 + moves, approximation_mm=0.5)
    seen = corners_of(result)
    assert max(seen) == pytest.approx(result.rounding.max(), rel=1e-3)
    inserted = result.rounding[result.t < 1.0]
    assert len(inserted) >= 3
    assert 0.0 < inserted.max() <= 0.2 * 1e-5 + 1e-9
    content = report.summary(result, 1e-5)
    assert content.blending.max_mm == pytest.approx(1e3 * max(seen), rel=1e-3)
    assert content.tolerance_held is None
    assert "between targets too, but for rounded corners" in report.program_text(content)
    assert "rounds corners by up to 0.0" in report.program_text(content)


def test_held_is_said_where_it_is_held_with_approximation():
    text = f"{SPINDLE_ON_AT_Z10}(FORCE FX=300 FZ=200)\nG1 Z0\nG1 X20\nG1 X40 Y20\nM2\n"
    result = converted(text, corner_tolerance_mm=0.001)
    assert report.summary(result, 1e-5).tolerance_held is True


KRL = "DEF part( )\n$VEL.CP=0.05\n$APO.CDIS=2\n;FORCE FX=300 FZ=200\nPTP {X 0,Y 0,Z 10,A 180,B 0,C 180}\n"


@pytest.mark.parametrize("tail", ["", " C_DIS"])
def test_krl_keeps_its_corners_and_stops_at_inserted_targets_only_where_it_stops_anyway(tail):
    targets = ["X 20,Y 0", "X 20,Y 20", "X 40,Y 20"]
    lines = "".join(f"LIN {{{xy},Z 0,A 180,B 0,C 180}}{tail}\n" for xy in targets)
    result = converted(f"{KRL}{lines}END\n", "krl")
    written = [line for line in result.documents[0].text.splitlines() if line.startswith("LIN")]
    assert len(written) > len(targets)
    assert all(line.endswith("C_DIS") == bool(tail) for line in written)
    content = report.summary(result, 1e-5)
    if tail:
        corner = 0.25 * 2.0 * np.sqrt(2.0)
        assert content.blending.programmed_max_mm == pytest.approx(corner, rel=1e-6)
        assert "the program itself by 0.71 mm" in report.program_text(content)
        assert re.search("rounds the corrected path", " ".join(issue.message for issue in result.issues))
    else:
        assert "stop-inserted" in {issue.kind for issue in result.issues}
        assert content.blending.max_mm == 0.0
        assert content.tolerance_held is True


KEPT = """DEF part( )
BAS(#INITMOV,0)
$VEL.CP=0.05
$APO.CDIS=1
PTP {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}
LIN {X 0,Y 0,Z 10,A 0,B 0,C 180}
LIN {X 20,Y 0,Z 10,A 0,B 0,C 180} C_DIS
LIN $POS_ACT:{X 0,Y 5,Z -5} C_DIS
LIN {X 20,Y 30,Z 10,A 0,B 0,C 180} C_DIS
LIN {X 20,Y 60,Z 10,A 0,B 0,C 180}
END
"""


def test_no_corner_is_seen_between_motions_that_do_not_follow_each_other():
    keeping = changed(CELL, krl=changed(CELL.krl, keep_unresolved=True, initmov="cell"))
    program = read_files({"part.src": KEPT}, keeping)
    result = correction.process(program, ROBOT, keeping)
    assert result.rounding.max() < 1e-6
    joined = KEPT.replace("LIN $POS_ACT:{X 0,Y 5,Z -5} C_DIS\n", "")
    result = correction.process(read_files({"part.src": joined}, keeping), ROBOT, keeping)
    assert result.rounding.max() > 1e-4


def test_the_first_motion_of_another_branch_is_not_rounded_with_the_last_one_of_the_branch_before():
    """Rows 2 and 3 are two branches, both after row 1; row 4 follows row 3."""
    spots = [(0, 0, 10), (20, 0, 10), (20, 20, 10), (40, 0, 10), (40, 30, 10)]
    made = made_of([("LIN", *spot) for spot in spots])
    rows = np.arange(len(spots))
    assert correction_targets._is_continuous(made, rows, made.motions.kind).tolist() == [True, True, True, True, False]
    made = changed(made, after=np.array([-1, 0, 1, 1, 3]))
    assert correction_targets._is_continuous(made, rows, made.motions.kind).tolist() == [True, True, False, True, False]
    pieces = np.array([0, 1, 1, 2, 2, 3, 4])  # of which some motions have two
    kind = made.motions.kind[pieces]
    assert correction_targets._is_continuous(made, pieces, kind).tolist() == [
        True,
        True,
        True,
        True,
        False,
        True,
        False,
    ]


def test_an_arc_comes_to_its_end_in_another_direction_than_it_begins():
    moves = [
        ("LIN", 0, 0, 0), ("LIN", 40, 0, 0), ("CIRC", 60, 20, 0, 40, 20, 0, 90.0, (0, 0, 1)), ("LIN", 60, 50, 0),
        ("CIRC", 40, 70, 0, 60, 70, 0, 270.0, (0, 0, 1)), ("LIN", 40, 0, 0), ("LIN", 0, 0, 0),
    ]  # fmt: skip
    made = made_of(moves)
    path = toolpath.segments(made, np.eye(4))
    turns = [0.0, 0.0, 90.0, 0.0, 90.0]  # degrees, at the ends of rows 1 to 5
    corners = correction_targets.corners_of_motions(made, path, np.arange(1, 7))
    np.testing.assert_allclose(corners.sharpness[:-1], 2.0 * np.sin(np.radians(turns) / 2.0), atol=1e-9)
    length = np.array([40.0, 10.0 * np.pi, 30.0, 30.0 * np.pi, 70.0, 40.0]) / 1e3
    np.testing.assert_allclose(corners.reach[:-1], np.minimum(length[:-1], length[1:]) / 2.0, rtol=1e-9)
