"""LinuxCNC's interpreter as the oracle: it must print the moves that we read, and refuse what we refuse."""

import math
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from postproc.errors import ProgramError
from tests.dialects.gcode_reading import CELL, read
from tests.oracle.rs274 import RejectedError, accepts, assert_same_moves, canonical, needs_rs274
from tests.places import SAMPLES

pytestmark = needs_rs274

SCALE = 2000
"""rs274 prints four decimals. It gets the program with all lengths times this, so that it prints 5e-8 units."""

PLANES = {"G17": (0, 1, 2), "G18": (2, 0, 1), "G19": (1, 2, 0)}
TICK = Fraction(1, 10_000)


class Writer:
    """Writes a valid program, knowing where the tool is. Lengths are whole numbers of 1e-4 units."""

    def __init__(self, draw: st.DrawFn) -> None:
        self.draw = draw
        self.blocks: list[list[str | tuple[str, int]]] = []
        self.unit, self.plane, self.motion = Fraction(1), "G17", ""
        self.relative = self.absolute_centre = False
        self.position = [Fraction(0)] * 3  # mm

    def text(self, scale: int) -> str:
        def word(part: str | tuple[str, int]) -> str:
            if isinstance(part, str):
                return part
            letter, ticks = part
            number = f"{Decimal(ticks * scale).scaleb(-4):.4f}"
            return letter + (number.replace("0.", ".", 1) if number.startswith("0.") else number)

        return "\n".join(" ".join(map(word, block)) for block in self.blocks) + "\nM2\n"

    def block(self, *parts: str | tuple[str, int]) -> None:
        number = [f"N{len(self.blocks)}"] if self.draw(st.booleans()) else []
        self.blocks.append([*number, *parts])

    def code(self, code: str) -> list[str]:
        modal = code == self.motion and self.draw(st.booleans())
        self.motion = code
        return [] if modal else [self.draw(st.sampled_from([code, code.lower(), code.replace("G", "G0")]))]

    def towards(self, axis: int, target: Fraction) -> tuple[str, int]:
        """Word for an axis, and the position is there: the nearest that can be written."""
        origin = self.position[axis] if self.relative else Fraction(0)
        ticks = round((target - origin) / self.unit / TICK)
        self.position[axis] = origin + ticks * TICK * self.unit
        return "XYZ"[axis], ticks

    def length(self, low: int = -2_000_000, high: int = 2_000_000) -> Fraction:
        return self.draw(st.integers(low, high)) * TICK

    def straight(self) -> None:
        code = self.code(self.draw(st.sampled_from(["G0", "G1", "G1", "G1"])))
        axes = self.draw(st.lists(st.integers(0, 2), min_size=1, unique=True))
        self.block(*code, *[self.towards(axis, self.position[axis] + self.length()) for axis in axes])

    def arc(self) -> None:
        first, second, across = PLANES[self.plane]
        radius = float(self.draw(st.integers(5_000, 400_000)) * TICK * self.unit)
        heading, clockwise = self.draw(st.floats(-3.1, 3.1)), self.draw(st.booleans())
        by_radius = self.draw(st.booleans())
        sweep = self.draw(st.floats(0.2, 3.0) | st.floats(3.3, 6.0) | st.just(2.0 * math.pi))
        if sweep > 6.1:
            by_radius = False
        start = list(self.position)
        centre = [radius * math.cos(heading), radius * math.sin(heading)]  # from the start
        origin = [Fraction(0) if not self.absolute_centre else start[axis] for axis in (first, second)]
        offset = [round((Fraction(c) + o) / self.unit / TICK) for c, o in zip(centre, origin, strict=True)]
        centre = [float(n * TICK * self.unit - o) for n, o in zip(offset, origin, strict=True)]
        angle = -sweep if clockwise else sweep
        to = [-centre[0] * math.cos(angle) + centre[1] * math.sin(angle) + centre[0]]
        to += [-centre[0] * math.sin(angle) - centre[1] * math.cos(angle) + centre[1]]
        words: list[str | tuple[str, int]] = [*self.code("G2" if clockwise else "G3")]
        if sweep < 6.1:
            words += [
                self.towards(axis, start[axis] + Fraction(d)) for axis, d in zip((first, second), to, strict=True)
            ]
        if self.draw(st.booleans()):
            words.append(self.towards(across, self.position[across] + self.length(-100_000, 100_000)))
        if by_radius:
            ticks = round(math.hypot(*centre) / float(TICK * self.unit))
            words.append(("R", -ticks if sweep > math.pi else ticks))
        else:
            words += [("IJK"[axis], n) for axis, n in zip((first, second), offset, strict=True)]
        if self.draw(st.integers(0, 4)) == 0:
            words.append("P2")
        self.block(*words)

    def mode(self) -> None:
        code = self.draw(
            st.sampled_from(
                ["G20", "G21", "G90", "G91", "G90.1", "G91.1", "G17", "G18", "G19", "F", "(note)", "M3", ""]
            )
        )
        if code in PLANES:
            self.plane = code
        elif code in ("G20", "G21"):
            self.unit = Fraction(254, 10) if code == "G20" else Fraction(1)
        elif code in ("G90", "G91"):
            self.relative = code == "G91"
        elif code in ("G90.1", "G91.1"):
            self.absolute_centre = code == "G90.1"
        elif code == "F":
            code = f"F{self.draw(st.integers(1, 3000))}"
        elif code == "M3":
            code = f"S{self.draw(st.integers(1, 3000))} M3 G40 ; on"
        self.block(*code.split(" ")) if code else self.block()


@st.composite
def programs(draw: st.DrawFn) -> Writer:
    writer = Writer(draw)
    writer.block("G0", *[writer.towards(axis, writer.length()) for axis in range(3)], "F500")
    for step in draw(st.lists(st.sampled_from(["straight", "arc", "arc", "mode"]), min_size=1, max_size=12)):
        getattr(writer, step)()
    return writer


@settings(max_examples=30, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(programs())
def test_generated_programs_have_the_moves_of_rs274(writer: Writer) -> None:
    assert_same_moves(read(writer.text(1)), canonical(writer.text(SCALE)), SCALE)


@pytest.mark.parametrize("path", sorted(SAMPLES.glob("*.nc")), ids=lambda path: path.name)
def test_samples_have_the_moves_of_rs274(path: Path) -> None:
    text = path.read_text()
    assert_same_moves(read(text), canonical(text), 1.0)


@pytest.mark.parametrize(
    ("opening", "held_back"),
    [("G0 X20 Y20\nG0 Z5\n", 1), ("G0 Z9\nX1\nX3\nY2\n", 3), ("G20 G0 X1\nG21 Y2\nZ3 F9\n", 2)],
)
def test_after_rapid_moves_held_back_the_moves_are_those_of_rs274(opening: str, held_back: int) -> None:
    text = f"G21 G90 G17\n{opening}G1 Z-1 F60\nG2 I5\nG91 G0 Z7\nM2\n"
    assert_same_moves(read(text), canonical(text)[held_back:], 1.0)


WORDS = (
    "G0 G1 G2 G3 G0 G1 g02 G03 G17 G18 G19 G20 G21 G90 G91 G90.1 G91.1 G4 G40 G49 G80 G61 G64 G98 G54 G43 G61.1 G1. "
    "F100 F0 F-1 S100 S-1 T1 M3 M5 M6 M8 M9 M0 M1 M7 M2 M30 M03 N5 (c) P1 P2 P0 P1.5 H1 Q1 D1 L1 E1 x X. Y- # ) ?"
)
VALUES = "0 1 -1 2 .5 +2 10 5 1.0 -.5 0.0 -5"
LENGTHS = st.builds(str.__add__, st.sampled_from("XYZXYXYIJIJKR"), st.sampled_from(VALUES.split(" ")))
BLOCK = st.lists(st.sampled_from(WORDS.split(" ")) | LENGTHS | LENGTHS, min_size=1, max_size=5).map(" ".join)
SOUP = st.lists(BLOCK.filter(lambda block: block.count("G80") < 2), min_size=1, max_size=3)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(SOUP)
def test_random_blocks_are_refused_exactly_when_rs274_refuses_them(blocks: list[str]) -> None:
    text = "G21 G90 G0 X0 Y0 Z0 F10\n" + "\n".join(blocks) + "\nM2\n"
    try:
        read(text)
        accepted = True
    except ProgramError:
        accepted = False
    assert accepts(text) is accepted


@pytest.mark.parametrize(("units", "mm"), [("G21", 1.0), ("G20", 25.4)])
@pytest.mark.parametrize("radius", [0.05, 0.5, 5.0, 28.0, 29.0, 500.0, 2900.0])
def test_tolerance_of_arc_radii_is_that_of_rs274(units: str, mm: float, radius: float) -> None:
    def text(excess: float) -> str:
        return f"{units} G90 G0 X0 Y0 Z0\nG2 X{2.0 * radius + excess:.7f} Y0 I{radius:.7f} F100\nM2\n"

    least = 0.02 * math.sqrt(2.0) / (1.0 if mm == 1.0 else 10.0)
    limit = min(max(least, 1e-3 * radius / (1.0 - 1e-3)), 100.0 * least)
    assert accepts(text(limit - 1e-6))
    assert not accepts(text(limit + 1e-6))
    read(text(limit - 1e-6))
    with pytest.raises(ProgramError, match="radii of the arc disagree"):
        read(text(limit + 1e-6))


@pytest.mark.parametrize(("units", "tolerance"), [("G21", 0.00127), ("G20", 0.00005)])
def test_least_radii_are_those_of_rs274(units: str, tolerance: float) -> None:
    head = f"{units} G90 G0 X0 Y0 Z0\n"
    for text, problem in [
        (head + "G2 X10 R{:.7f} F100\nM2\n", "R too small"),
        (head + "G2 I{:.7f} F100\nM2\n", "radius zero"),
    ]:
        nominal = 5.0 - tolerance if "R" in text else tolerance
        good, bad = text.format(nominal + 1e-6), text.format(nominal - 1e-6)
        assert accepts(good)
        assert not accepts(bad)
        read(good)
        with pytest.raises(ProgramError, match=problem):
            read(bad)


ACCEPTED_HERE_ONLY = {
    "text after an opening %": "%part 1\nG0 X1 Y1 Z1\n%",
    "a closing % alone": "G0 X1 Y1 Z1\n%",
    "no end": "G0 X1 Y1 Z1",
    "a switch number after /": "/2 G0 X1 Y1 Z1\nM2",
    "lone carriage returns": "G0 X1 Y1 Z1\rX2\rM2\r",
    "a byte order mark": "\ufeffG0 X1 Y1 Z1\nM2",
    "N after a comment": "(first) N10 G0 X1 Y1 Z1\nM2",
    "a tool that no table holds": "T12 M6\nG43 H12 G0 X1 Y1 Z1\nM2",
    "cancelling polar coordinates": "G15\nG0 X1 Y1 Z1\nM2",
    "cancelling mirroring": "G50.1\nG0 X1 Y1 Z1\nM2",
    "cancelling rotation": "G69\nG0 X1 Y1 Z1\nM2",
    "G94 keeps the feed": "G0 X1 Y1 Z1 F10\nG94\nG1 X2\nM2",
    "an offset of zero across the plane": "G0 X0 Y0 Z0\nG2 X1 I.5 K0 F10\nM2",
    "an axis at zero alone, after an arc": "G0 X0 Y0 Z0\nG2 X1 I.5 F10\nA0\nM2",
    "an axis at zero that rs274 has not": "G0 X0 Y0 Z0 U0\nM2",
    "a retract after G80": "G0 X0 Y0 Z0\nG80\nZ5\nM2",
    "a move after G80": "G0 X0 Y0 Z5\nG80\nX5\nM2",
    "brackets in a comment": "(holes (4x) at (1, 2) )\nG0 X1 Y1 Z1\nM2",
    "five M codes in a block": "G0 X1 Y1 Z1\nM3 M6 M8 M48 M0 T1 S1\nM2",
}
REFUSED_HERE_ONLY = {
    "a position that is not known from G1": "G1 X1 F10\nM2",
    "increments before the position is known": "G91 G0 X1\nM2",
    "a cut before the position is known": "G0 X1 Y1\nG1 Z-1 F10\nM2",
    "a work offset before the position is known": "G0 X1 Y1\nG55 G0 Z1\nM2",
    "a position that is never known": "G0 X1 Y1\nM2",
    "parameters that nothing has set": "G0 X#1 Y0 Z0\nM2",
    "assignments of the control's own": "#5221=3\nG0 X1 Y0 Z0\nM2",
    "double signs": "G0 X--1 Y0 Z0\nM2",
    "decimals in N": "N1.5 G0 X1 Y1 Z1\nM2",
    "numbers of astronomical size": "G0 X99999999999 Y0 Z0\nM2",
    "rotary axes": "G0 X1 Y1 Z1 A1\nM2",
    "the dwell of an arc": "G0 X0 Y0 Z0\nG2 X1 I.5 F10\nG4 P1 X2 I.5\nM2",
    "a length offset of its own": "G0 X1 Y1 Z1\nG43.1 Z1\nM2",
    "a work offset that the cell does not know": "G57 G0 X1 Y1 Z1\nM2",
    "restoring an offset that the program has not set": "G0 X1 Y1 Z1\nG92.3\nM2",
    "machine coordinates": "G53 G0 X1 Y1 Z1\nM2",
    "homing": "G0 X1 Y1 Z1\nG28\nM2",
    "radius compensation": "G0 X1 Y1 Z1\nG41 D1\nM2",
    "a pallet": "G0 X1 Y1 Z1\nM60\nM2",
    "the end of a subprogram": "G0 X1 Y1 Z1\nM99\nM2",
    "no motion": "(nothing)\nM2",
}


@pytest.mark.parametrize("text", ACCEPTED_HERE_ONLY.values(), ids=ACCEPTED_HERE_ONLY)
def test_what_is_accepted_on_purpose_is_refused_by_rs274(text: str) -> None:
    assert len(read(text).motions) >= 1
    assert not accepts(text)


@pytest.mark.parametrize("text", REFUSED_HERE_ONLY.values(), ids=REFUSED_HERE_ONLY)
def test_what_is_refused_on_purpose_is_accepted_by_rs274(text: str) -> None:
    assert "G57" not in CELL.work_offsets
    with pytest.raises(ProgramError):
        read(text)
    assert accepts(text)


@pytest.mark.parametrize("tail", ["M2\nG1 nonsense (", "%\n(notes)\n%\nG1 (", "M30 (end)\nG0 X9\nM2"])
def test_rs274_too_reads_nothing_after_the_end(tail: str) -> None:
    text = "%\nG21 G90 G0 X1 Y2 Z3\n" + tail
    assert_same_moves(read(text), canonical(text), 1.0)


def test_other_axes_at_zero_are_nothing_to_rs274_too() -> None:
    text = "G21 G90 G0 X1 Y2 Z3 A0\nG1 X5 B0 F100\nG2 X7 I1 C0\nM2\n"
    assert_same_moves(read(text), canonical(text), 1.0)


def test_the_comparison_can_fail() -> None:
    moves = canonical("G21 G90 G0 X1 Y2 Z3\nG18 G3 X3 I1 F60\nM2\n")
    assert [move.command for move in moves] == ["STRAIGHT_TRAVERSE", "ARC_FEED"]
    np.testing.assert_array_equal(moves[1].end, [3.0, 2.0, 3.0])
    np.testing.assert_array_equal(moves[1].centre, [2.0, 2.0, 3.0])
    with pytest.raises(RejectedError, match="zero feed rate"):
        canonical("G1 X1\nM2\n")
