"""Canned cycles, shifted program frames, tools and places of the machine."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from postproc.cell import Frame, Machine
from postproc.errors import ProgramError
from postproc.program import LIN, PTP
from tests.dialects.gcode_reading import CELL, ends, outcome, read
from tests.effort import calls_for_each
from tests.oracle.rs274 import MACHINE, assert_same_moves, canonical, needs_rs274

G98_AT_Z9 = "G21 G90 G17 G98 G0 X0 Y0 Z9 F60\n"
CYCLES = {
    "drilling": "G81 X1 Y2 Z-3 R2\nX5\nG99 Y7\nX6 Z-4\nG98 X1 R3\nG80\nG0 X0",
    "a dwell": "M3 S100\nG82 X1 Z-1 R1 P.5\nX2\nX3 P1.5",
    "pecks": "G99 G83 X1 Y2 Z-5 R1 Q1.4\nX3 Q2.5\nG98 G73 X4 Z-3 R1 Q1\nY1",
    "tapping": "M3 S200\nG84 X1 Y1 Z-4 R2 F100\nX4\nG80 G0 Z20\nM5",
    "boring": "M4 S50\nG85 X1 Z-1 R1\nX2\nG86 X3 Z-1 R1 P.1\nX4\nG89 X5 Z-2 R1 P.2\nX6",
    "increments": "G91 G81 X2 Y1 Z-3 R-2 L3\nG99 X1 L2\nG90 X1 Z-1 R1",
    "below R": "G0 Z-1\nG81 X1 Y1 Z-5 R2\nX2\nG99 X3",
    "G18": "G18 G81 X1 Y-2 Z3 R2\nZ5\nG80\nG0 X0",
    "G19": "G19 G99 G83 X-3 Y2 Z3 R1 Q1.2\nY5",
    "repeats in place": "G81 X1 Z-1 R1 L2\nX3",
    "a cycle after another": "G81 X1 Z-1 R3\nG82 X2 Z-2 R1 P1\nG0 X9\nG99 G81 X3 Z-1 R2",
    "inches": "G20\nG81 X1 Z-.1 R.1 F5\nX2\nG21\nG80",
    "cycles in loops": "o1 sub\nG81 X#1 Y0 Z-#2 R1\no2 repeat [3]\nG91 X1\no2 endrepeat\nG90 G80\no1 endsub\n"
    "o1 call [5] [2]\no1 call [9] [3]".replace("G91 X1", "Y[#1+1]"),
}  # fmt: skip


@needs_rs274
@pytest.mark.parametrize("text", CYCLES.values(), ids=CYCLES)
def test_cycles_have_the_moves_of_rs274(text: str) -> None:
    text = f"{G98_AT_Z9}{text}\nM2\n"
    digits = 3e-3 if "G20" in text else 1e-4
    assert_same_moves(read(text), canonical(text), 1.0, digits=digits)
    assert outcome(text, bulk=True) == outcome(text, bulk=False)


@st.composite
def holes(draw: st.DrawFn) -> str:
    lines = [draw(st.sampled_from(["G17", "G18", "G19"])), "M3 S100"]

    def number(low: int, high: int) -> str:
        return f"{draw(st.integers(low, high)) / 8:g}"

    for _ in range(draw(st.integers(1, 4))):
        across = {"G17": "Z", "G18": "Y", "G19": "X"}[lines[0]]
        plane = "XYZ".replace(across, "")
        relative = draw(st.booleans())
        taps = [84] if lines[0] == "G17" else []  # elsewhere rs274 2.9 takes the axes of G84 for each other
        code = draw(st.sampled_from([81, 82, 83, 73, 85, 86, 89, *taps]))
        lines.append("G90 G0 X0 Y0 Z" + number(-40, 80))
        depth, r = (number(-60, -8), number(-30, 30)) if relative else (number(-60, -8), number(0, 60))
        # G84 of rs274 takes the P of a cycle before
        more = {
            82: f"P{number(1, 9)}",
            83: f"Q{number(3, 30)}",
            73: f"Q{number(3, 30)}",
            86: "P1",
            89: "P.5",
            84: "P0",
        }.get(code, "")
        lines.append(f"{'G91' if relative else 'G90'} {draw(st.sampled_from(['G98', 'G99']))} G{code} "
                     f"{plane[0]}{number(-80, 80)} {across}{depth} R{r} {more}")  # fmt: skip
        for _ in range(draw(st.integers(0, 6))):
            extra = draw(
                st.sampled_from([*[""] * 9, " L2", " G98", " G99", f" R{number(0, 30)}", f" {across}{number(-60, -8)}"])
            )
            lines.append(f"{draw(st.sampled_from(plane))}{number(-80, 80)}{extra}")
        lines.append(draw(st.sampled_from(["G80", "G0 X1", "G1 X1"])))
    return G98_AT_Z9 + "\n".join(lines) + "\nM2\n"


@needs_rs274
@settings(max_examples=35, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(holes())
def test_random_holes_have_the_moves_of_rs274(text: str) -> None:
    assert_same_moves(read(text), canonical(text), 1.0, digits=1e-4)


def test_rows_of_holes_are_read_in_bulk() -> None:
    def work(count: int) -> Callable[[], object]:
        lines = (f"X{n % 40} Y{n % 30}\n" for n in range(count))
        return partial(read, f"{G98_AT_Z9}G83 X1 Y1 Z-5 R2 Q2\n{''.join(lines)}G80\nM2\n")

    assert calls_for_each(work) < 0.5  # hole by hole: 50


def test_a_cycle_stops_at_its_bottoms() -> None:
    program = read(G98_AT_Z9 + "G83 X1 Z-3 R2 Q2\nM2")
    z, blend = ends(program)[:, 2], program.motions.blend
    feeds = ~program.motions.rapid
    assert (blend[feeds] == 0.0).all()
    np.testing.assert_allclose(z[feeds], [0, -2, -3])
    assert blend[1] > 0.0


BAD_CYCLES = {
    "no R": ("G81 X1 Z-1", "G81 without R"),
    "no Z": ("G81 X1 R1", "G81 without Z"),
    "no Q": ("G83 X1 Z-1 R1", "G83 without Q"),
    "no P": ("G82 X1 Z-1 R1", "G82 without P"),
    "R below Z": ("G81 X1 Z3 R1", "is below the bottom of the hole"),
    "no depth": ("G83 X1 Z-1 R1 Q0", "is not a valid depth of a peck"),
    "no spindle": ("G84 X1 Z-1 R1", "does not turn clockwise"),
    "no hole": ("G81 X1 Z-1 R1 L0", "L0 of a cycle"),
    "arc words": ("G81 X1 Z-1 R1 I1", "I, J or K in a cycle"),
    "inverse time": ("G93 G81 X1 Z-1 R1 F2", "a cycle in G93"),
}


@needs_rs274
@pytest.mark.parametrize(("text", "problem"), BAD_CYCLES.values(), ids=BAD_CYCLES)
def test_cycles_that_cannot_be_are_told(text: str, problem: str) -> None:
    with pytest.raises(ProgramError, match=problem) as caught:
        read(f"{G98_AT_Z9}{text}\nM2\n")
    assert caught.value.line == 2


@pytest.mark.parametrize(
    ("words", "units", "advice"),
    [
        ("K3", "G21", "If K is the number of holes, write L3."),
        ("K12.", "G20", "If K is the number of holes, write L12."),
        ("K2.5", "G21", None),
        ("K0", "G21", None),
        ("K-2", "G21", None),
        ("I3", "G21", None),
        ("I1 K3", "G21", None),
        ("J1 K3", "G21", None),
        ("K3 L2", "G21", None),
    ],
)
def test_a_number_of_holes_as_on_fanuc_is_refused_with_what_to_write(
    words: str, units: str, advice: str | None
) -> None:
    lines = f"{G98_AT_Z9}{units} G98 G81 X1 Y0 Z-4 R2 F100\nG91 X10. Y5. Z-2 R-1 "
    with pytest.raises(ProgramError, match="I, J or K in a cycle") as caught:
        read(f"{lines}{words}\nG80\nM2\n")
    assert (caught.value.line, caught.value.advice) == (3, advice)
    if advice is not None:
        right = ends(read(f"{lines}{advice.split()[-1][:-1]}\nG80\nM2\n"))
        assert len(np.unique(right[:, 0].round(3))) > round(float(words[1:]))


FIRST_PLACE = "G0 Z50\nG81 R2 Z-1 F100 X5 Y6\nX7\nG99 X9 Y3\nG80\nG0 Z50\nX1 Y1 Z1\n"


@needs_rs274
@pytest.mark.parametrize("plane", ["G17", "G18", "G19"])
@pytest.mark.parametrize("home", [None, [0.0, -90.0, 90.0, 0.0, 10.0, 0.0]])
def test_a_cycle_may_give_the_first_place_above_the_part(plane: str, home: list[float] | None) -> None:
    """pcb2gcode: Z is known by a rapid, the cycle begins with a rapid to X and Y at that height."""
    letters = dict(zip("XYZ", {"G17": "XYZ", "G18": "ZXY", "G19": "YZX"}[plane], strict=True))
    text = f"G21 G90 {plane} G98\n" + "".join(letters.get(one, one) for one in FIRST_PLACE) + "M2\n"
    program = read(text, replace(CELL, machine=replace(CELL.machine, home=home, clearance_Z=90.0)))
    there = [move.end.tolist() for move in canonical(text)][1:]
    np.testing.assert_allclose(ends(program), there, atol=1e-4)
    assert program.motions.kind[0] == PTP


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("G81 R2 Z-1 F100 X5 Y6", "cutting move before the position is known"),
        ("G0 Z1\nG81 R2 Z-1 F100 X5 Y6", "a cycle that begins below R before the position is known"),
        ("G0 Z50\nG81 R2 Z-1 F100 X5\nY6", "cutting move before the position is known"),
        ("G0 X5 Y6\nG81 R2 Z-1 F100 X5 Y6", "cutting move before the position is known"),
        ("G0 Z50\nG91 G81 R-48 Z-3 F100 X5 Y6", "incremental move before the position is known"),
    ],
)
def test_a_cycle_without_a_place_above_the_part_is_refused(text: str, problem: str) -> None:
    with pytest.raises(ProgramError) as caught:
        read(f"G21 G90 G17\n{text}\nG80\nG0 Z50\nM2\n")
    assert caught.value.problem == problem
    assert "G81" in str(caught.value.text)
    assert caught.value.advice


@pytest.mark.parametrize(("first", "then"), [("G91", "G90"), ("G90", "G91")])
@pytest.mark.parametrize("more", ["", "R2", "Z-3"])
def test_a_cycle_does_not_take_its_heights_into_the_other_distance_mode(first: str, then: str, more: str) -> None:
    """R-98 is 2 mm above the part in G91 from Z100, and 98 mm below its zero in G90."""
    r = {"G91": "R-98", "G90": "R2"}
    start = f"{G98_AT_Z9}G0 Z100\n{first} G81 X5 Y0 Z-3 {r[first]} F100\n"
    with pytest.raises(ProgramError, match=f"given in {first}, used in {then}") as caught:
        read(f"{start}{then} X5 {more}\nG80\nM2")
    assert str(caught.value.text).startswith(then)
    depth = ends(read(f"{start}{then} X5 Z-3 {r[then]}\nG80\nM2"))[:, 2].min()
    assert depth == pytest.approx(-3.0)
    assert len(read(f"{start}{then}\n{first} X9\nG80\nM2").motions) > 7


def test_a_tap_is_not_drawn_out_by_a_spindle_that_turns_on() -> None:
    lines = {"spindle_on": ["$OUT[1]=TRUE"], "spindle_off": ["$OUT[1]=FALSE"]}
    text = f"{G98_AT_Z9}M3 S200\nG84 X1 Y1 Z-4 R2 F100\nG80\nM2\n"
    one_way = replace(CELL, gcode=replace(CELL.gcode, **lines))
    with pytest.raises(ProgramError, match="reverses the spindle at the bottom"):
        read(text, one_way)
    both = replace(CELL, gcode=replace(CELL.gcode, **lines, spindle_ccw=["$OUT[2]=TRUE"]))
    program = read(text, both)
    assert [event.kind for event in program.events].count("spindle_ccw") == 1
    (question,) = [issue for issue in program.issues if issue.kind == "tapping"]
    assert (question.level, question.source_line) == ("warning", text.splitlines().index("G84 X1 Y1 Z-4 R2 F100") + 1)
    assert "spindle_ccw and spindle_on wait" in question.message
    by_hand = replace(CELL, gcode=replace(CELL.gcode, spindle_on=[], spindle_off=[]))
    (warning,) = [issue for issue in read(text, by_hand).issues if issue.kind == "tapping"]
    assert "No line reverses the spindle at the bottom" in warning.message


ORIGINS = {
    "G10 L2": "G10 L2 P1 X3 Y-2 Z1\nG0 X1 Y1\nG10 L2 P0 R30\nG1 X2 Y2 Z2\nG2 X4 I1",
    "G10 L2 of another": "G10 L2 P2 X3 Y-2 Z1 R-20\nG0 X1 Y1\nG55 G0 X1 Y1 Z1\nG54 X0",
    "G10 L2 in increments": "G91 G10 L2 P1 X3\nG90 G0 X1\nG91 X1",
    "G10 L20": "G0 X5 Y6 Z7\nG10 L20 P1 X0 Z1\nG1 X1 Y1 Z0\nG91 X1",
    "G52": "G52 X3 Y4\nG0 X1 Y1\nG52 X0 Y0\nG1 X1 Y1\nG52 Z2\nZ3",
    "G92": "G92 X0 Y1\nG0 X1 Y1\nG92 Z0\nG1 Z-1\nG92.2\nG1 X1 Z1\nG92.3\nG1 X1 Z1\nG92.1\nX2 Z2",
    "G92 in other offsets": "G10 L2 P2 X9\nG92 X4\nG0 X1\nG55 G0 X1 Y1 Z1\nG92.1\nX5",
    "G10 L2 while G92 is off": "G92 X4 Y1\nG92.2\nG0 X1 Y1\nG10 L2 P1 X3 Y-2\nG0 X1\nG92.3\nG1 X1 Y1",
    "G10 L20 while G92 is off": "G92 X4 Y1\nG0 X1 Y1\nG92.2\nG10 L20 P1 X0\nG92.3\nG1 X2",
    "G52 while G92 is off": "G92 X4\nG92.2\nG52 Y3\nG0 X1 Y1\nG92.3\nG1 X1 Y1\nG52 X0 Y0\nX5",
    "a turned frame": "G10 L2 P1 X1 R90\nG0 X1 Y2\nG52 X2\nG1 X5\nG3 Y6 J2\nG92 X0\nG1 X1",
    "inverse time": "G93\nG1 X10 F2\nG3 X20 I5 F4\nX30 I5 F1\nG0 X0\nG1 Z1 F60\nG94 F100\nG1 X5",
}


@needs_rs274
@pytest.mark.parametrize("text", ORIGINS.values(), ids=ORIGINS)
def test_shifted_frames_have_the_moves_of_rs274(text: str) -> None:
    text = f"{G98_AT_Z9}{text}\nM2\n"
    cell = replace(CELL, work_offsets={})
    assert_same_moves(read(text, cell), canonical(text), 1.0, digits=1e-4, offsets=MACHINE)
    assert outcome(text, cell, bulk=True) == outcome(text, cell, bulk=False)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("G92.3", "has not set"),
        ("G10 L1 P1 Z3", "G10 L1 is not supported"),
        ("G10 L2 X3", "G10 without a work offset"),
        ("G52", "G52 without X, Y or Z"),
        ("G0 X1 G81 Z1 R1", "two codes"),
        ("G81 X5 Y0 Z-4 R2 F100 G53", "G81 and G53 in one block use the same words"),
        ("G92 G2 X5 I1 F100", "G92 and G2 in one block use the same words"),
        ("G28 G92 X5", "G28 and G92 in one block use the same words"),
        ("G93 G1 X1", "cutting move in G93 without a feed"),
        ("G93 G1 X1 F2\nG94 X2", "cutting move without a feed"),
        ("G28 Z0", r"\[machine\]"),
        ("G53 G0 Z0", r"\[machine\]"),
    ],
)  # fmt: skip
def test_places_that_are_not_known_are_told(text: str, problem: str) -> None:
    with pytest.raises(ProgramError, match=problem):
        read(f"{G98_AT_Z9}{text}\nM2\n", replace(CELL, work_offsets={}))


CELL_WITH_HOME = replace(CELL, machine=Machine(home=(1.0, -89.0, 90.0, 0.0, 0.0, 0.0)))
CLEAR = replace(CELL, machine=Machine(clearance_Z=80.0))
BOTH = replace(CELL, machine=Machine(home=(1.0, -89.0, 90.0, 0.0, 0.0, 0.0), clearance_Z=80.0))


def test_G28_goes_home_in_joints_and_the_next_move_needs_what_it_took() -> None:
    program = read(G98_AT_Z9 + "G1 X5 Z-1\nG91 G28 Z0\nG90 G0 X7 Y8\nZ9\nG1 Z0\nM2", CELL_WITH_HOME)
    m = program.motions
    assert m.kind.tolist() == [PTP, LIN, PTP, PTP, LIN]
    np.testing.assert_allclose(np.rad2deg(m.joints[2]), CELL_WITH_HOME.machine.home)
    np.testing.assert_allclose(ends(program)[3], [7, 8, 9], atol=1e-9)
    assert m.line.tolist() == [1, 2, 3, 5, 6]


def test_G28_goes_over_its_intermediate_point_and_the_clearance() -> None:
    program = read(G98_AT_Z9 + "G28 X1 Z20\nM2", BOTH)
    np.testing.assert_allclose(ends(program)[1:3], [[1, 0, 20], [1, 0, 80]], atol=1e-9)
    assert program.motions.kind.tolist() == [PTP, LIN, LIN, PTP]


@pytest.mark.parametrize("block", ["G53 G0 Z0", "G0 G53 Z0", "G91 G28 Z0", "G30 G91 Z0"])
def test_retracting_goes_to_the_clearance(block: str) -> None:
    program = read(G98_AT_Z9 + f"G1 X5 Z-1\n{block}\nG90 G0 X7\nM2", CLEAR)
    np.testing.assert_allclose(ends(program)[2:], [[5, 0, 80], [7, 0, 80]], atol=1e-9)
    assert program.motions.rapid[2:].all()


@pytest.mark.parametrize("z", [4, 80, 90])
def test_a_move_at_feed_from_home_goes_down_over_the_clearance(z: int) -> None:
    text = f"G21 G90 G17 G0 X0 Y0 Z{z}\nG1 Z-1 F60\nG0 Z{z}\nG28 X\nG1 Z{z} F100\nX20 F1800\nY10\nM2"
    for cell, heights in ((BOTH, [80, z, z] if z < 80 else [z, z]), (CELL_WITH_HOME, [z, z])):
        program = read(text, cell)
        m = program.motions
        tail = slice(-len(heights), None)
        np.testing.assert_allclose(ends(program)[tail, 2], heights, atol=1e-9)
        np.testing.assert_allclose(ends(program)[tail, 0], 20, atol=1e-9)
        assert m.kind[tail].tolist() == [PTP, *[LIN] * (len(heights) - 1)]
        assert m.rapid[tail].tolist() == [True, *[False] * (len(heights) - 1)]
        np.testing.assert_allclose(m.feed[tail][1:], 0.03)


def test_from_home_the_robot_goes_down_over_the_clearance() -> None:
    text = G98_AT_Z9 + "G1 X5 Z-1\nG91 G28 Z0\nG90 G0 X20 Y30\nG43 Z15 H1\nG1 Z-2\nM2"
    program = read(text, BOTH)
    m = program.motions
    np.testing.assert_allclose(ends(program)[-3:], [[20, 30, 80], [20, 30, 15], [20, 30, -2]], atol=1e-9)
    assert m.kind[-4:].tolist() == [PTP, PTP, LIN, LIN]
    assert m.rapid[-4:].tolist() == [True, True, True, False]
    assert m.line[-3:].tolist() == [5, 5, 6]
    assert not [issue for issue in program.issues if issue.kind == "approach"]
    direct = read(text, replace(BOTH, machine=replace(BOTH.machine, clearance_Z=None)))
    np.testing.assert_allclose(ends(direct)[-2:], [[20, 30, 15], [20, 30, -2]], atol=1e-9)
    (issue,) = [issue for issue in direct.issues if issue.kind == "approach"]
    assert issue.level == "warning"


def test_retracting_at_the_head_of_a_program_does_nothing() -> None:
    program = read("G21 G90\nG53 G0 Z0\nG0 X1 Y2\nZ3\nG1 Z0 F9\nM2", CLEAR)
    assert len(program.motions) == 2


def test_each_tool_has_its_own_frame_and_keeps_the_tip_where_it_was() -> None:
    cell = replace(CELL, tools={"1": Frame(Z=300.0), "3": Frame(Z=412.5)})
    program = read("T1 M6\n" + G98_AT_Z9 + "G1 Z0\nG0 Z20\nT3 M6\nG43 H3 G0 X5\nG1 Z1\nM2", cell)
    m = program.motions
    np.testing.assert_allclose(program.tools[m.tool, 2, 3], [0.3, 0.3, 0.3, 0.4125, 0.4125, 0.4125])
    np.testing.assert_allclose(ends(program)[2:], [[0, 0, 20], [0, 0, 20], [5, 0, 20], [5, 0, 1]], atol=1e-9)
    assert [(e.kind, e.before) for e in program.events] == [("tool_change", 0), ("tool_change", 3)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("T1 M6\nG43 H1 Z9\n", []),
        ("T1 M6\nG43 H2 Z9\n", ["G43 H2 with tool 1"]),
        ("T1 M6\nT2\nG43 H1 Z9\n", []),  # the next tool is made ready
        ("T1 M6\nT2\nG43 H2 Z9\n", ["G43 H2 with tool 1"]),
        ("T1\nG43 H2 Z9\n", ["G43 H2 with tool 1"]),
        ("G43 H2 Z9\n", []),
    ],
)
def test_the_length_of_another_tool_is_a_warning_by_its_line(text: str, expected: list[str]) -> None:
    issues = [issue for issue in read(G98_AT_Z9 + text + "M2").issues if issue.level == "warning"]
    assert [issue.message.partition(":")[0] for issue in issues] == expected
    line = (G98_AT_Z9 + text).count("\n")
    assert all((issue.kind, issue.source_line) == ("tool-length", line) for issue in issues)


def test_a_length_of_a_tool_that_was_mounted_before_is_a_warning_too() -> None:
    cell = replace(CELL, tools={"1": Frame(Z=300.0), "3": Frame(Z=412.5)})
    program = read("T1 M6\n" + G98_AT_Z9 + "G1 Z0\nG0 Z20\nT3 M6\nT1\nG43 H1 G0 X5\nM2", cell)
    (issue,) = [issue for issue in program.issues if issue.kind == "tool-length"]
    assert issue.message == "G43 H1 is not the tool in the spindle: $TOOL of tool 3 is used."


def test_which_tool_M6_means_must_be_said() -> None:
    with pytest.raises(ProgramError, match="M6 without a T"):
        read(G98_AT_Z9 + "M6\nM2", replace(CELL, tools={"1": Frame(Z=300.0)}))
    program = read(G98_AT_Z9 + "M6\nM2")
    assert [issue.level for issue in program.issues if issue.kind == "tool-change"] == ["warning"]
    assert not [issue for issue in read(G98_AT_Z9 + "T0 M6\nM2").issues if issue.kind == "tool-change"]


def test_a_tool_that_the_cell_has_not_is_an_error() -> None:
    with pytest.raises(ProgramError, match="tool 4 is not in the cell"):
        read(G98_AT_Z9 + "T4 M6\nM2", replace(CELL, tools={"1": Frame(Z=300.0)}))


def test_M_codes_of_the_shop_are_its_lines_or_nothing() -> None:
    cell = replace(CELL, m_codes={"M111": [], "M51": ["$OUT[9]=TRUE"]})
    program = read(G98_AT_Z9 + "M111\nM51\nG1 X1\nM2", cell)
    assert [(e.kind, e.value, e.before) for e in program.events] == [("m_code", 51.0, 1)]
    with pytest.raises(ProgramError, match=r"\[m_codes\] M52"):
        read(G98_AT_Z9 + "M52\nM2", cell)
    with pytest.raises(ProgramError, match="M61 is not supported"):
        read(G98_AT_Z9 + "M61\nM2", replace(CELL, m_codes={"M61": []}))


@pytest.mark.parametrize("bare", ["Z15.", "G91 Z10", "Z15\nZ20"])
def test_a_retract_after_g80_is_a_rapid_as_on_fanuc_controls(bare):
    program = read(f"{G98_AT_Z9}G81 X1 Y1 Z-4 R2 F100\nG80\n{bare}\nM2\n")
    written = read(f"{G98_AT_Z9}G81 X1 Y1 Z-4 R2 F100\nG80\nG0 {bare}\nM2\n")
    np.testing.assert_array_equal(program.motions.target, written.motions.target)
    assert program.motions.rapid[-1]
    assert "motion-after-g80" in {issue.kind for issue in program.issues}


@pytest.mark.parametrize("bare", ["X9", "X9 Z15", "Z15\nX9", "X9 Y4 Z15\nZ2", "Z9."])
def test_coordinates_after_g80_at_heights_of_rapid_moves_are_rapids(bare):
    """Fusion: X0. Y-14.249 Z5.533 and Z5. between two cycles; the cycle has been at Z2 in rapid."""
    program = read(f"{G98_AT_Z9}G81 X1 Y1 Z-4 R2 F100\nG80\n{bare}\nM2\n")
    written = read(f"{G98_AT_Z9}G81 X1 Y1 Z-4 R2 F100\nG80\nG0 {bare}\nM2\n")
    np.testing.assert_array_equal(program.motions.target, written.motions.target)
    np.testing.assert_array_equal(program.motions.rapid, written.motions.rapid)


@pytest.mark.parametrize("bare", ["Z-5", "X9 Z1.9", "Z15\nX9\nZ1.99", "G10 L2 P1 X0 Y0 Z-5\nX9 Z5\nZ4"])
def test_other_coordinates_after_g80_are_refused(bare):
    with pytest.raises(ProgramError, match="coordinates without G0, G1, G2 or G3"):
        read(f"{G98_AT_Z9}G81 X1 Y1 Z-4 R2 F100\nG80\n{bare}\nM2\n")


# ---- the unit of P


DWELLS = {
    "G4": "G0 X0 Y0 Z5\nG4 P{}\nM30\n",
    "G4 X": "G0 X0 Y0 Z5\nG4 X{}\nM30\n",
    "G82": "G0 X0 Y0 Z5\nG82 X5 Y5 Z-3 R2 P{} F100\nM30\n",
    "G84": "G0 X0 Y0 Z5 S100 M3\nG84 X5 Y5 Z-3 R2 P{} F100\nM30\n",
    "G86": "G0 X0 Y0 Z5 S100 M3\nG86 X5 Y5 Z-3 R2 P{} F100\nM30\n",
}


def _cell(unit):
    return replace(CELL, gcode=replace(CELL.gcode, dwell_unit=unit))


def _waits(text, unit):
    return [event.value for event in read(f"G21\n{text}", _cell(unit)).events if event.kind == "dwell"]


@pytest.mark.parametrize("code", DWELLS)
def test_the_cell_says_whether_p_is_in_seconds_or_milliseconds(code):
    assert _waits(DWELLS[code].format("1000"), "ms") == [1.0]
    assert _waits(DWELLS[code].format("1000"), "s") == [1000.0]
    assert _waits(DWELLS[code].format("2"), None) == [2.0]
    assert _waits(DWELLS[code].format("0.5"), "s") == [0.5]


def test_p_of_later_holes_is_in_the_unit_of_the_cell_too():
    text = "G0 X0 Y0 Z5\nG89 X5 Y5 Z-3 R2 P1500 F100\nX9\nX12 P2000\nX15\nM30\n"
    assert _waits(text, "ms") == [1.5, 1.5, 2.0, 2.0]


@pytest.mark.parametrize("code", DWELLS)
def test_a_time_that_could_be_either_is_a_question_of_its_line(code):
    with pytest.raises(ProgramError, match="is 500 s or 500 ms: the cell does not say") as caught:
        read(f"G21\n{DWELLS[code].format('500')}", _cell(None))
    assert caught.value.line == 3
    assert 'dwell_unit = "ms"' in caught.value.advice


def test_the_point_of_p_alone_decides_and_on_lines_of_later_holes_too():
    text = "G0 X0 Y0 Z5\nG82 X5.5 Y5. Z-3. R2. P500 F100.\nX9.\nX12. P{}\nM30\n"
    assert _waits(text.format("2000"), "ms") == [0.5, 0.5, 2.0]
    with pytest.raises(ProgramError, match="looks like seconds"):
        read(f"G21\n{text.format('2000.')}", _cell("ms"))


def test_a_cycle_without_a_dwell_has_no_question():
    assert _waits("G0 X0 Y0 Z5\nG81 X5 Y5 Z-3 R2 P500 F100\nM30\n", None) == []


@pytest.mark.parametrize(
    ("code", "time"), [("G4", "1.5"), ("G4", "10."), ("G82", "10."), ("G82", "0.5"), ("G84", "12.5"), ("G86", "2")]
)
def test_seconds_where_the_cell_says_milliseconds_are_an_error(code, time):
    """Haas reads G4 P10. as ten seconds."""
    with pytest.raises(ProgramError, match="looks like seconds"):
        read(f"G21\n{DWELLS[code].format(time)}", _cell("ms"))


def test_x_of_a_dwell_with_a_decimal_point_is_in_seconds_on_every_control():
    for unit in ("s", "ms", None):
        assert _waits(DWELLS["G4 X"].format("12.5"), unit) == [12.5]


def test_a_dwell_of_unknown_unit_is_one_error_whatever_the_number_of_holes():
    with pytest.raises(ProgramError) as caught:
        read("G21 G90\nG0 X0 Y0 Z9\nG82 Z-2 R1 P500 F100\nX5\nX9\nG80\nM2\n")
    assert (caught.value.line, caught.value.further_errors) == (3, ())
    assert "500 ms" in caught.value.problem


@pytest.mark.parametrize(
    ("stated", "drilled"),
    [
        ("G81 Z-3 R2 L0\nX20\nY5", "G81 Z-3 R2 X20\nY5"),
        ("G81 X0 Y0 Z-3 R2 L0\nX20\nY5", "G81 Z-3 R2 X20\nY5"),
        ("G91 G81 X0 Z-11 R-7 L0\nX20\nY5", "G91 G81 Z-11 R-7 X20\nY5"),
        ("G81 X4 Z-3 R2\nZ-5 L0\nX20\nY5", "G81 X4 Z-3 R2\nX20 Z-5\nY5"),
    ],
)
def test_l0_states_the_hole_and_drills_none(stated, drilled):
    here, there = (read(f"{G98_AT_Z9}{text}\nG80\nM2\n", CELL) for text in (stated, drilled))
    np.testing.assert_allclose(ends(here), ends(there), atol=1e-9)


def test_l0_at_another_place_is_refused_since_controls_differ():
    with pytest.raises(ProgramError, match="L0 of a cycle at another place"):
        read(f"{G98_AT_Z9}G81 X20 Z-3 R2 L0\nX30\nM2\n", CELL)
