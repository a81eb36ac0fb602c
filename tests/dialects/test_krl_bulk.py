"""Runs of settings, assignments and comments between motions: read in bulk they mean what they mean line by line."""

import re
from pathlib import Path

import numpy as np
import pytest

from postproc import dialects
from postproc.errors import PostprocError
from tests.dialects.krl_programs import CELL, body, read
from tests.dialects.test_krl_reading import FULL

PROGRAMS = 250
SETTINGS = [
    "$VEL.CP={n}",
    "$VEL.CP = {n}",
    "$VEL.CP={i}",
    "$VEL.CP=SPEED",
    "$VEL.CP=SPEED*{n}",
    "$VEL.ORI1=200",
    "$VEL.ORI2={i}",
    "$APO.CDIS={n}",
    "$APO.CDIS={i}",
    "$APO.CDIS=NEAR",
    "$APO.CVEL=50",
    "$APO.CPTP={i}",
    "$APO.CORI=5",
    "$ACC.CP={n}",
    "$ACC.ORI1={i}",
    "$OUT[{i}]=TRUE",
    "$OUT[{i}]=FALSE",
    "$OUT[I]=TRUE",
    "$ANOUT[1]={n}",
    "$VEL_AXIS[{i}]=30",
    "$ACC_AXIS[{i}]=50",
    "$VEL={{CP {n},ORI1 200,ORI2 200}}",
    "$APO={{CDIS {n},CVEL 50}}",
    "$ADVANCE=3",
    "$ORI_TYPE=#CONSTANT",
    "$ORI_TYPE=#VAR",
    "$CIRC_TYPE=#PATH",
    "$CIRC_TYPE=#BASE",
    "BAS(#VEL_CP,{n})",
    "$BASE=BASE_DATA[3]",
    "$TOOL=TOOL_DATA[2]",
    "SPEED={n}",
    "NEAR={i}",
    "I={i}",
    "I=I+1",
    "P1.X={n}",
    "P1={{X 60,Y {n},Z 30,A 0,B 0,C 180}}",
    "WAIT SEC 0",
    "CONTINUE",
    "; $VEL.CP={n}",
    ";FORCE FX={n} FY=20",
    "; FORCE OFF",
    ";FORCE FX={i} FRAME=TOOL",
    "",
    "  ",
    ";FOLD A ;%{{PE}}",
    ";ENDFOLD",
    "WAY( )",
    "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[2]=TRUE",
]
WRONG = [
    "$VEL.CP=0",
    "$VEL.CP=-1",
    "$VEL.CP=101",
    "$APO.CDIS=-1",
    "$VEL.CP=0.1 0.2",
    "$VEL.CP={n};FORCE FX=",
    "$OUT[1]TRUE",
]
MOVES = [
    FULL,
    f"{FULL} C_DIS",
    "LIN {{X {n},Y 10,Z 30}} C_DIS",
    "LIN P1 C_DIS",
    "LIN_REL {{X 1}}",
    "PTP {{X {n},Y 10,Z 30}}",
    "CIRC {{X 90,Y {n},Z 30}},{{X 80,Y 20,Z 30}} C_DIS",
    "LIN {{X {n},Y 10,Z 30}} WITH $VEL.CP=0.5 C_DIS",
]
AROUND = [
    ("FOR J{d}=1 TO 2", "ENDFOR"),
    ("IF TRUE THEN", "ENDIF"),
    ("IF FALSE THEN", "ENDIF"),
    ("REPEAT", "UNTIL TRUE"),
]


class Maker:
    """Makes up programs of runs.

    :param rng: whose chance it is.
    """

    def __init__(self, rng):
        self.rng = rng

    def one(self, choices):
        return choices[int(self.rng.integers(len(choices)))]

    def filled(self, line):
        """A line with numbers, in some style: lower case, no blanks, more of them, a comment behind."""
        rng = self.rng
        number = self.one(
            [f"{rng.uniform(0.01, 2):.3f}", f"{rng.uniform(0.1, 90):.1f}", f"{rng.integers(1, 9)}.", ".5"]
        )
        text = line.replace(FULL, "LIN {{X 100,Y 20,Z 30,A 10,B 20,C 170}}").format(n=number, i=int(rng.integers(1, 7)))
        style = int(rng.integers(8))
        if style == 0:
            text = text.lower()
        elif style == 1 and not text.startswith(";"):
            text = re.sub(r"[ \t]*([=,(])[ \t]*", r" \1 ", text)
        elif style == 2 and "{" not in text and not text.startswith((";", "BAS", "WAIT", "TRIGGER", "LIN")):
            text = text.replace(" ", "")
        if rng.random() < 0.2:
            text = self.one(["\t", " ", "    "]) + text
        if rng.random() < 0.25 and text.strip() and "FORCE" not in text.upper():
            text += self.one([" ", "", ";a", " ; $VEL.CP=9", ";FORCE FX=7 FY=8", "\t", " ; N10", ";;"])
        return text

    def lines(self, depth=0):
        """Runs of settings, alike or not, with motions between."""
        out = []
        for _ in range(int(self.rng.integers(2, 7))):
            length = int(self.one([1, 1, 2, 3, 8, 30]))
            kind = self.rng.random()
            if kind < 0.35:
                same = self.one(SETTINGS)
                out += [self.filled(same) for _ in range(length)]
            elif kind < 0.6:
                out += [self.filled(self.one(SETTINGS)) for _ in range(length)]
            elif kind < 0.65 and depth < 2:
                opening, closing = self.one(AROUND)
                out += [opening.format(d=depth), *self.lines(depth + 1), closing]
            elif kind < 0.66:
                out.append(self.filled(self.one(WRONG)))
            else:
                out += [self.filled(self.one(MOVES)) for _ in range(min(length, 3))]
        return out

    def program(self):
        begin = ["DEF part( )", "DECL INT I,J0,J1", "DECL REAL SPEED,NEAR", "DECL POS P1", "BAS (#INITMOV,0 )", "I=1"]
        begin += ["SPEED=0.25", "NEAR=1.5", "P1={X 60,Y 10,Z 30,A 0,B 0,C 180}", FULL]
        way = [self.filled(self.one(SETTINGS[:24])) for _ in range(int(self.rng.integers(0, 6)))]
        end = self.one(["\r\n", "\n"])
        return end.join(
            [*begin, *self.lines(), *self.lines(), self.filled(self.one(MOVES)), "END", "DEF WAY( )", *way, "END", ""]
        )


def told(source, *, bulk):
    """All that a program means, or why it is refused."""
    try:
        program = read(source, cell=CELL, bulk=bulk)
    except PostprocError as error:
        return str(error)
    motions = program.motions
    out = {f"motions.{name}": np.asarray(getattr(motions, name)) for name in motions.__struct_fields__}
    for name in (
        "trace_row",
        "notes",
        "numbers",
        "is_missing",
        "keyword",
        "target",
        "tail",
        "starts_from_joints",
        "orientation",
    ):
        out[f"layout.{name}"] = getattr(program.layout, name)
    for name in (
        "ignores_orientation",
        "turns_with_path",
        "is_distance_known",
        "is_in_spline_block",
        "triggers",
        "resume_place",
    ):
        out[f"layout.{name}"] = getattr(program.layout, name)
    for name in ("bases", "tools", "notes", "still", "issues", "after", "joins", "events"):
        out[name] = getattr(program, name)
    return out


def differing(one, other):
    """The names of what differs between two meanings."""
    if isinstance(one, str) or isinstance(other, str):
        return [] if one == other else [one, other]
    return [
        name
        for name, value in one.items()
        if not (
            np.array_equal(value, other[name], equal_nan=value.dtype.kind == "f")
            if isinstance(value, np.ndarray)
            else value == other[name]
        )
    ]


@pytest.mark.parametrize("part", range(2))
def test_runs_of_settings_mean_in_bulk_what_they_mean_line_by_line(part):
    read_ = 0
    for seed in range(part, PROGRAMS, 2):
        source = Maker(np.random.default_rng(seed)).program()
        one, other = told(source, bulk=True), told(source, bulk=False)
        assert not differing(one, other), f"seed {seed}: {differing(one, other)}\n{source}"
        read_ += not isinstance(one, str)
    assert read_ > PROGRAMS // 8  # of a half of them: the others hold what is refused


def test_motions_read_a_few_at_a_time_are_the_same(monkeypatch):
    sources = [Maker(np.random.default_rng(seed)).program() for seed in range(60)]
    together = [told(source, bulk=True) for source in sources]
    monkeypatch.setattr("postproc.chunks.ROWS", 3)
    for source, whole in zip(sources, together, strict=True):
        assert not differing(told(source, bulk=True), whole), source
    assert sum(not isinstance(whole, str) for whole in together) > 5


@pytest.mark.parametrize("bulk", [True, False])
def test_numbers_are_where_the_layout_says_in_short_and_in_long_targets(bulk, monkeypatch):
    monkeypatch.setattr("postproc.chunks.ROWS", 3)
    blanks = " " * 300
    lines = [FULL, "PTP {X 100,Y 20,Z 31,A 10,B 20,C 170,S 2,T 3}", f"LIN {{X 90.25,{blanks}Y 21,Z 30,C 170}} C_DIS"]
    program = read(body(*lines, *lines, lines[0]), bulk=bulk)
    text, spans = program.documents[0].text, program.layout.spans(slice(None))
    found = [[text[start:stop] for start, stop in row if start >= 0] for row in spans.tolist()]
    expected = [re.findall(r"(?<=[XYZABCST] )[0-9.]+", line) for line in lines]
    assert found == [*expected, *expected, expected[0]]
    assert program.layout.relative_spans.itemsize == 2
    assert program.motions.status.tolist() == [-1, 2, -1, -1, 2, -1, -1]


POSSESSIVE = re.compile(r"\)(?:[?*+]|\{[0-9,]*\})\+")


def test_no_expression_repeats_a_group_possessively():
    """CPython before 3.11.5 finds matches of such expressions that are none (gh-106052): ``LIN {X 1 Y 2}`` was one."""
    assert POSSESSIVE.search(r"(?:,[ ]*+)?+")
    files = list(Path(dialects.__file__).parent.parent.rglob("*.py"))
    assert len(files) > 200
    assert [file.name for file in files if POSSESSIVE.search(file.read_text())] == []
