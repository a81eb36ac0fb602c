"""The bulk reading of plain blocks equals pygcode's reading of every block."""

import random
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from pygcode.block import Block

from postproc.cell import Rotary
from postproc.dialects import gcode
from postproc.dialects.gcode import words
from postproc.dialects.gcode.words import words_of
from postproc.dialects.text import decode
from postproc.program import Document
from tests.dialects.gcode_reading import CELL, forward, outcome, read
from tests.effort import calls_for_each


def split(text: str) -> words.Source:
    return words.split(Document("part.nc", text))


NUMBERS = st.one_of(
    st.decimals(-9999, 9999, places=3).map(str),
    st.floats(-1e6, 1e6, allow_nan=False).map(lambda x: f"{x:.12f}"),
    st.from_regex(r"[+-]?(\d{1,9}\.?\d{0,20}|\.\d{1,20})", fullmatch=True),
)
PLAIN = st.tuples(
    st.sampled_from(["", "N7", "n0012 ", "(c)"]),
    st.lists(
        st.tuples(st.sampled_from("XYZIJKRFG"), NUMBERS).map(lambda w: f"G{w[1][-1]}" if w[0] == "G" else w[0] + w[1]),
        max_size=5,
    ),
    st.sampled_from([" ", "", "  "]),
    st.sampled_from(["", " ", "(end)", " ; end"]),
).map(lambda parts: parts[0] + parts[2].join(parts[1]) + parts[3])
SCRAPS = st.text(alphabet="XYZIJRFGNM0123.+- ()/%;#x\x01é?", max_size=12)
ENDS = st.sampled_from(["\n", "\r\n", "\r\r\n", "\r"])
AT_X1_Y2_Z3 = "G21 G90 G0 X1 Y2 Z3 F100"


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(PLAIN, ENDS), max_size=8).map(lambda lines: "".join(map("".join, lines))))
def test_plain_blocks_have_the_words_that_pygcode_reads(text: str) -> None:
    source = split(AT_X1_Y2_Z3 + "\n" + text)
    found, odd = words.read_plain(source)
    for row in set(range(len(source))) - set(odd.tolist()):
        code = source.line(row).replace(words.COMMENT_MARK, " ").replace("+", "").replace(".G", " G")
        expected = {word.letter: float(word.value) for word in Block(code).words if word.letter != "N"}
        columns = {letter: found.column(letter)[row] for letter in words.COLUMNS}
        words_of_line = {letter: value for letter, value in columns.items() if not np.isnan(value)}
        assert words_of_line == expected, code
    for letter in words.COLUMNS:
        assert np.isnan(found.column(letter)[odd]).all()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(PLAIN | SCRAPS, ENDS), max_size=6).map(lambda lines: "".join(map("".join, lines))))
@example("N1N2X1\n")
@example("X1.2.3Y4\n")
@example("X.\nY-\nZ+.\n")
@example("G4X1\nG-0X1\nG1.0X2\nG1.X3")
@example("F-0X5\nF-1X5\n")
@example("X1 2 Y 3 . 5\n")
@example("X1(c)2\n")
@example("X9999999.99\nX10000000")
@example("N\nN5\nN5.5X1")
@example("\x01X1\n")
def test_programs_read_the_same_with_and_without_the_bulk_path(text: str) -> None:
    text = AT_X1_Y2_Z3 + "\n" + text + "\nM2\n"
    assert outcome(text, bulk=True) == outcome(text, bulk=False)


@pytest.mark.parametrize("rotary", [None, Rotary(["C", "B"], [1, 1], ["G43.4"], ["G49"], "tcp")])
@pytest.mark.parametrize("seed", range(30))
def test_lines_read_a_few_at_a_time_give_the_same(
    seed: int, rotary: Rotary | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, cell = random_program(seed, rotary), replace(CELL, rotary=rotary)
    together = outcome(text, cell, bulk=True)
    monkeypatch.setattr("postproc.chunks.ROWS", 3)
    assert outcome(text, cell, bulk=True) == together


def random_program(seed: int, rotary: Rotary | None) -> str:
    """Return a program in which modal words, incremental moves, and rotary axes go on over many lines."""
    rng = random.Random(seed)
    lines = [AT_X1_Y2_Z3, "G43.4" if rotary and rng.random() < 0.7 else ""]
    for _ in range(40):
        letters = rng.sample("XYZ", rng.randrange(4)) + (rng.sample("BC", rng.randrange(3)) if rotary else [])
        words = [f"{letter}{rng.choice([0, 0, 5, 10, -20])}" for letter in letters]
        arc = f"{rng.choice(['G2', 'G3'])} X{rng.randrange(9)} Y{rng.randrange(9)} R20"
        odd = rng.choice(["(c)", "G91", "G90", "G20", "G55", "G54", "M8", arc, "G81 X1 Z-1 R2", "G80", "N5 G49"])
        lines.append(odd if rng.random() < 0.15 else f"{rng.choice(['', '', 'G1 ', 'G0 '])}{' '.join(words)}")
    return "\n".join(lines) + "\nM2\n"


def test_numbers_in_bulk_are_rounded_like_float() -> None:
    rng = np.random.default_rng(1)
    texts = [f"{x:.{n}f}" for x, n in zip(rng.normal(size=5000) * 1e3, rng.integers(0, 25, 5000), strict=True)]
    found, odd = words.read_plain(split("".join(f"X{text}\n" for text in texts)))
    assert len(odd) == 0
    np.testing.assert_array_equal(found.column("X"), [float(text) for text in texts])


def test_words_of_a_block_keep_their_order_and_lose_the_line_number() -> None:
    assert words_of("N10G1X-1.5F200M8") == [("G", 1.0), ("X", -1.5), ("F", 200.0), ("M", 8.0)]
    assert words_of("O1234") == []


def test_all_lines_of_a_comparison_really_go_through_pygcode(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    monkeypatch.setattr("postproc.dialects.gcode.modes.words_of", lambda code: seen.append(code) or words_of(code))
    read("G0 X1 Y1 Z1\nN5 X2\n\n(c)\nX3\nM2\n", bulk=False)
    assert seen == ["G0X1Y1Z1", "N5X2", "X3", "M2"]
    seen.clear()
    read("G0 X1 Y1 Z1\nN5 X2\n\n(c)\nX3\nM2\n")
    assert seen == ["M2"]


def _finishing(lines: int) -> list[str]:
    points = np.random.default_rng(0).normal(size=(lines, 3)) * 300.0
    return [f"X{x:.3f} Y{y:.3f} Z{z:.3f}" for x, y, z in points]


def _numbered(lines: int) -> list[str]:
    return [f"N{10 * n} G1 {line}" for n, line in enumerate(_finishing(lines))]


def _mixed(lines: int) -> list[str]:
    """Straight and circular moves in turn; every arc is a half circle about a point of its own."""
    points = np.rint(np.random.default_rng(0).normal(size=(lines, 2)) * 300e3).astype(int)
    at, out = points[0], []
    for n, point in enumerate(points):
        if n % 2:
            x, y = (2 * point - at) / 1e3
            i, j = (point - at) / 1e3
            out.append(f"G{2 + n // 2 % 2} X{x:.3f} Y{y:.3f} I{i:.3f} J{j:.3f}")
            at = 2 * point - at
        else:
            out.append(f"G1 X{point[0] / 1e3:.3f} Y{point[1] / 1e3:.3f} F{500 + n % 7}")
            at = point
    return out


@pytest.mark.parametrize("lines", [_finishing, _numbered, _mixed], ids=["X Y Z", "N G1 X Y Z", "G1 G2 G3"])
def test_long_programs_are_read_in_bulk(lines) -> None:
    def reading(count: int) -> Callable[[], object]:
        text = "G21 G90\nG0 X0 Y0 Z50\nG1 F1000\n" + "\n".join(lines(count)) + "\nM30\n"
        document = decode("part.nc", text.encode())
        return lambda: gcode.read(document, CELL, forward, "part")

    program = reading(6000)()
    assert len(program.motions) == 6001
    assert program.motions.line[-1] == 6003
    assert calls_for_each(reading) < 0.05  # pygcode needs more than a hundred
