"""Statements as the parser reads them, held against the grammar of the tests, which shares no code with it."""

from pathlib import Path

import numpy as np
import pytest
from lark import Token, Tree

from postproc.dialects.krl.language import parser, tree
from postproc.dialects.krl.language.expressions import calls
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.values import OpaqueText
from postproc.dialects.text import decode
from tests import effort
from tests.attack.krl_generator import Generator
from tests.attack.krl_jobs import Job
from tests.oracle.krl_grammar import check, takes

KINDS = {
    "procedure": tree.Definition,
    "function": tree.Definition,
    "variables": tree.Declaration,
    "struc": tree.Declaration,
    "enum": tree.IdleDeclaration,
    "external": tree.IdleDeclaration,
    "signal": tree.CyclicInput,
    "imported": tree.Import,
    "assignment": tree.Assignment,
    "call": tree.CallStatement,
    "motion": tree.Motion,
    "circle": tree.Motion,
    "piece": tree.Motion,
    "spline": tree.Spline,
    "label": tree.Label,
    "goto": tree.Goto,
    "branch": tree.If,
    "switch": tree.Switch,
    "case": tree.Case,
    "loop": (tree.For, tree.While, tree.BareWord),
    "leave": tree.Return,
    "interrupt": tree.Event,
    "trigger": tree.Trigger,
    "plain": (tree.Statement,),
}
"""What the grammar calls a statement, and what the parser makes of it."""
FEATURES = """DEF part( )
DECL INT i,j[3]
DECL CONST REAL v=0.5
GLOBAL INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO stopped(i)
INTERRUPT ON 4
ANIN ON v=0.1*$ANIN[1]+0
again:
FOR i=1 TO 5 STEP 2
  IF (i==1) AND NOT (v<>0.5) OR $IN[2] THEN
    j[i]=i+1
  ELSE
    EXIT
  ENDIF
ENDFOR
SWITCH i
CASE 1,2
  LIN {X 1,Y 2,Z 3,A 0,B 0,C 0} C_DIS
DEFAULT
  PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}
ENDSWITCH
TRIGGER WHEN PATH=-12.5 ONSTART DELAY=20 DO $OUT[1]=TRUE PRIO=-1
TRIGGER WHEN DISTANCE=1 DELAY=0 DO stopped(i) PRIO=5
CIRC {X 1,Y 2,Z 3},{X 1,Y 2,Z 5},CA 90
SPLINE WITH $VEL.CP=0.1
  SLIN {X 1}
  SPL {X 2}
ENDSPLINE C_SPL
WHILE i<3
  i=i+1
ENDWHILE
REPEAT
  i=i-1
UNTIL i==0
GOTO again
RETURN
END
DEF stopped(n:IN)
DECL INT n
HALT
END
DEFFCT REAL half(x:IN,y:OUT)
DECL REAL x,y
RETURN (x/2)
ENDFCT
"""


def texts():
    """Sources that the grammar takes."""
    yield FEATURES
    yield from (path.read_bytes().decode() for path in sorted((Path(__file__).parents[2] / "samples").glob("in*.src")))
    for seed in range(60):
        files = Generator(np.random.default_rng(seed)).programs()
        yield from (text for name, text in files.items() if name.endswith("part.src"))
        yield Job(np.random.default_rng([9, seed]), keep=seed % 2 == 0, unknown=True, forces=False).files["part.src"]


def stated(text):
    """Line → statement of the grammar; the outermost where several begin on it."""
    found, lines = {}, text.splitlines()
    for node in check("part.src", text).iter_subtrees_topdown():
        begins = not node.meta.empty and not lines[node.meta.line - 1][: node.meta.column - 1].strip()
        if node.data in KINDS and begins:
            found.setdefault(node.meta.line, node)
    return found


def source_of(text):
    return Source.of(decode("part.src", text.encode()), 0)


def first_name(node):
    """The first name in a part of the grammar's tree, as that of an assignment, a call, a label or a counter."""
    for value in node.children:
        if isinstance(value, Token) and value.type == "NAME":
            return str(value)
        if isinstance(value, Tree):
            return first_name(value)
    return None


def name_of(here):
    """The same of a statement of the parser; None where it has none."""
    for attribute in ("target", "call", "counter"):
        if hasattr(here, attribute):
            return getattr(here, attribute).name
    return {tree.Label: lambda: here.name, tree.Goto: lambda: here.label}.get(type(here), lambda: None)()


def differing(text):
    """Lines on which the grammar and the parser see other statements."""
    source, out = source_of(text), []
    for line, node in stated(text).items():
        here = parser.statement(source, line)
        named = name_of(here)
        if here.word == "PULSE":
            continue  # which moves nothing: it is no call of a routine
        if not isinstance(here, KINDS[node.data]) or (named is not None and named != first_name(node)):
            out.append((line, node.data, type(here).__name__))
    return out


def test_every_statement_is_what_the_grammar_says():
    seen, count = set(), 0
    for text in filter(lambda text: takes("part.src", text), texts()):
        assert differing(text) == []
        count += len(stated(text))
        seen |= {node.data for node in stated(text).values()}
    assert count > 2000
    assert seen >= KINDS.keys() - {"struc", "enum", "external", "signal", "imported"}


def test_a_statement_that_is_read_otherwise_would_be_noticed(monkeypatch):
    monkeypatch.setitem(parser._READERS, "GOTO", parser._return)
    assert [kind for _, kind, _ in differing(FEATURES)] == ["goto"]


def test_parts_of_statements_are_where_the_text_has_them():
    source = source_of(FEATURES)

    def on(line):
        here = parser.statement(source, line)
        assert source.text[here.start : here.stop] == FEATURES.splitlines()[line - 1].strip()
        return here

    assert on(3).is_constant
    assert not on(2).is_constant
    assert [one.name for one in on(2).names] == ["I", "J"]
    assert on(4).is_global
    assert on(4).is_declaration
    assert isinstance(on(4).action, tree.CallStatement)
    assert not on(5).is_declaration
    assert on(5).action is None
    assert on(6).name == "V"
    assert on(9).condition.operators == ("AND", "OR")
    assert on(9).condition.negated == (False, True, False)
    asked = on(9).condition
    assert source.text[asked.start : asked.stop] == "(i==1) AND NOT (v<>0.5) OR $IN[2]"
    path, distance = on(21), on(22)
    assert (path.value.value, path.delay.value) == (-12.5, 20.0)
    assert path.is_from_start
    assert not path.is_distance
    assert distance.is_distance
    assert not distance.is_from_start
    assert len(on(16).values) == 2
    assert on(27).extra_text == "C_SPL"
    half = on(41)
    assert (half.name, half.result_type) == ("half", "REAL")
    assert [(one.name, one.by_value) for one in half.parameters] == [("X", True), ("Y", False)]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("LIN {X 1,Y (w+F(1)),Z (w)}:Q[G(H(2))] C_DIS", ["F", "G", "H"]),
        ("LIN P WITH $VEL.CP=F(1), $TOOL=TOOL_DATA[G(2)] C_SPL", ["F", "G"]),
        ("IF NOT (F(1)) AND (ABS(G(2))>3) THEN", ["F", "G"]),
        ("IF (F(1) B_AND 3)==1 THEN", ["F"]),
        ("WAIT FOR F(1) OR $IN[1]", ["F"]),
        ('A[F(1)].B[G(2)]="H(3)"', ["F", "G"]),
        ("TRIGGER WHEN PATH=F(1) DELAY=0 DO G(2) PRIO=-1", ["F", "G"]),
        ("FOR i=F(1) TO 2 STEP G(3)", ["F", "G"]),
        ("BAS(#VEL_CP,F(1))", ["BAS", "F"]),
    ],
)
def test_calls_are_found_wherever_they_are_in_a_statement(line, found):
    here = parser.statement(source_of(f"DEF part( )\n{line}\nEND\n"), 2)
    assert [call.name for call in calls(here.values)] == found


def test_what_follows_a_value_is_not_read_as_a_part_of_it():
    here = parser.statement(source_of("DEF part( )\nI=1 2\nEND\n"), 2)
    assert isinstance(here.value, OpaqueText)
    assert here.value.excess_start == len("DEF part( )\nI=1 ")


def test_a_line_is_read_once(monkeypatch):
    source = source_of(FEATURES)
    first = parser.statement(source, 10)
    monkeypatch.setattr(parser, "statement_in", None)
    assert parser.statement(source, 10) is first


@pytest.mark.parametrize(
    "line",
    ["I=" + "(" * 5000, "I=" + "1+" * 4000 + "1", "IF " + "NOT " * 2000 + "TRUE THEN", "I=" + "-" * 9000, "F(" * 3000],
)
def test_the_work_for_a_statement_grows_with_its_length_not_with_its_depth(line):
    source = source_of(f"DEF part( )\n{line}\nEND\n")
    assert effort.calls(lambda: parser.statement(source, 2)) < 100 * len(line)
