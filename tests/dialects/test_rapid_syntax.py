"""RAPID as text: what each form means, and which piece of the text it is."""

from __future__ import annotations

import pytest

from postproc.dialects.rapid.syntax import (
    Argument,
    Assignment,
    Comment,
    Conditional,
    Declaration,
    Expression,
    Instruction,
    Jump,
    Loop,
    RapidSyntaxError,
    Statement,
    calls,
    modules,
)

TARGET = "[[1,-2.5,3E1],[0,1,0,0],[0,-1,0,1],[9E9,9E9,9E9,9E9,9E9,9E9]]"


def routine(body, kind="PROC", head="work()"):
    text = f"MODULE m\n{kind} {head}\n{body}\nEND{kind}\nENDMODULE"
    return text, modules(text)[0].routines[0]


def shown(text, item):
    """An item as nested tuples, with the piece of the text that it is."""
    piece = text[item.start : item.stop]
    match item:
        case Expression():
            return (item.kind, piece, item.value, *(shown(text, part) for part in item.items))
        case Argument():
            return (item.name, piece, item.value and shown(text, item.value))
        case Comment():
            return ("!", piece, item.text, item.is_trailing)
        case Instruction():
            return (item.name, piece, *(shown(text, part) for part in item.arguments))
        case Assignment():
            return (":=", piece, shown(text, item.target), shown(text, item.value))
        case Declaration():
            value = item.value and shown(text, item.value)
            sizes = tuple(shown(text, part) for part in item.dimensions)
            return (item.kind, piece, item.is_local, item.type, item.name, item.spelling, sizes, value)
        case Conditional():
            subject = item.subject and shown(text, item.subject)
            branches = [
                (test and shown(text, test), *(shown(text, part) for part in body)) for test, body in item.branches
            ]
            return ("IF" if subject is None else "TEST", piece, subject, *branches)
        case Loop():
            bounds = tuple(shown(text, part) for part in item.bounds)
            return (item.name, piece, bounds, text[slice(*item.body_span)], *(shown(text, part) for part in item.body))
        case Jump():
            return (item.word, piece)
    raise TypeError(item)


def name(text):
    return ("name", text, text.upper())


def num(text):
    return ("number", text, float(text))


STATEMENTS = {
    "Stop;": ("STOP", "Stop;"),
    "Set  do1 ;": ("SET", "Set  do1 ;", ("", "do1", name("do1"))),
    "f a,\\On,2\\k:=b\\p?q;": (
        "F", "f a,\\On,2\\k:=b\\p?q;", ("", "a", name("a")), ("ON", "\\On", None), ("", "2", num("2")),
        ("K", "\\k:=b", name("b")), ("P", "\\p?q", name("q")),
    ),
    '%"m:Cut"% x;': ("%CUT", '%"m:Cut"% x;', ("", "x", name("x"))),
    "%sName% x;": ("%", "%sName% x;", ("", "x", name("x"))),
    "here:": (":", "here:"),
    "GOTO here;": ("GOTO", "GOTO here;"),
    "RETURN x;": ("RETURN", "RETURN x;"),
    "RETURN;": ("RETURN", "RETURN;"),
    "EXIT;": ("EXIT", "EXIT;"),
    "CONNECT n{1} WITH late;": ("CONNECT", "CONNECT n{1} WITH late;", ("", "late", name("late"))),
    "IF a Stop;": ("IF", "IF a Stop;", None, (name("a"), ("STOP", "Stop;"))),
    "IF a THEN Stop; ELSEIF b THEN ELSE Set c; ENDIF": (
        "IF", "IF a THEN Stop; ELSEIF b THEN ELSE Set c; ENDIF", None, (name("a"), ("STOP", "Stop;")), (name("b"),),
        (None, ("SET", "Set c;", ("", "c", name("c")))),
    ),
    "TEST a CASE 1,b: Stop; DEFAULT: EXIT; ENDTEST": (
        "TEST", "TEST a CASE 1,b: Stop; DEFAULT: EXIT; ENDTEST", name("a"),
        (("list", "1,b", None, num("1"), name("b")), ("STOP", "Stop;")), (None, ("EXIT", "EXIT;")),
    ),
    "FOR i FROM 1 TO n STEP k DO Stop; ENDFOR": (
        "I", "FOR i FROM 1 TO n STEP k DO Stop; ENDFOR", (num("1"), name("n"), name("k")), " Stop; ", ("STOP", "Stop;"),
    ),
    "WHILE a DO ENDWHILE": ("", "WHILE a DO ENDWHILE", (name("a"),), " "),
    "VAR num nX{2,k}:=a;": (
        "VAR", "VAR num nX{2,k}:=a;", False, "NUM", "NX", "nX", (num("2"), name("k")), name("a"),
    ),
    "LOCAL PERS bool b;": ("PERS", "LOCAL PERS bool b;", True, "BOOL", "B", "b", (), None),
    "TASK PERS num b:=1;": ("PERS", "TASK PERS num b:=1;", False, "NUM", "B", "b", (), num("1")),
}  # fmt: skip
EXPRESSIONS = {
    "1.5E+1": ("number", "1.5E+1", 15.0),
    ".5": ("number", ".5", 0.5),
    "-3": ("number", "-3", -3.0),
    "+3": ("number", "+3", 3.0),
    "-a": ("operation", "-a", "-", name("a")),
    '"a""b"': ("string", '"a""b"', 'a"b'),
    "TRUE": ("bool", "TRUE", True),
    "false": ("bool", "false", False),
    "a.b{1,2}.c": (
        "field", "a.b{1,2}.c", "C", ("index", "a.b{1,2}", None, ("field", "a.b", "B", name("a")), num("1"), num("2")),
    ),
    "f()": ("call", "f()", "F"),
    "f(a\\k:=1)": ("call", "f(a\\k:=1)", "F", ("", "a", name("a")), ("K", "\\k:=1", num("1"))),
    "[1,a]": ("list", "[1,a]", None, num("1"), name("a")),
    "(a)": ("name", "(a)", "A"),
    "a-b-c": ("operation", "a-b-c", "-", ("operation", "a-b", "-", name("a"), name("b")), name("c")),
    "-a+b": ("operation", "-a+b", "+", ("operation", "-a", "-", name("a")), name("b")),
    "a*b+c": ("operation", "a*b+c", "+", ("operation", "a*b", "*", name("a"), name("b")), name("c")),
    "a*(b+c)": ("operation", "a*(b+c)", "*", name("a"), ("operation", "(b+c)", "+", name("b"), name("c"))),
    "a<b AND c": ("operation", "a<b AND c", "AND", ("operation", "a<b", "<", name("a"), name("b")), name("c")),
    "a OR b AND c": (
        "operation", "a OR b AND c", "OR", name("a"), ("operation", "b AND c", "AND", name("b"), name("c")),
    ),
    "a XOR b OR c": (
        "operation", "a XOR b OR c", "OR", ("operation", "a XOR b", "XOR", name("a"), name("b")), name("c"),
    ),
    "NOT a=b": ("operation", "NOT a=b", "NOT", ("operation", "a=b", "=", name("a"), name("b"))),
    "a AND NOT b": ("operation", "a AND NOT b", "AND", name("a"), ("operation", "NOT b", "NOT", name("b"))),
    "a DIV b MOD c": (
        "operation", "a DIV b MOD c", "MOD", ("operation", "a DIV b", "DIV", name("a"), name("b")), name("c"),
    ),
    TARGET: (
        "numbers", TARGET,
        ("1", "-2.5", "3E1", "0", "1", "0", "0", "0", "-1", "0", "1", "9E9", "9E9", "9E9", "9E9", "9E9", "9E9"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("text", STATEMENTS)
def test_a_statement_has_its_parts_and_their_places(text):
    whole, work = routine(f"  {text} ")
    (statement,) = work.body
    assert shown(whole, statement) == STATEMENTS[text]


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_an_expression_has_its_parts_and_their_places(text):
    whole, work = routine(f"x := {text} ;")
    (statement,) = work.body
    assert shown(whole, statement.value) == EXPRESSIONS[text]
    assert shown(whole, statement.target) == name("x")
    assert whole[statement.start : statement.stop] == f"x := {text} ;"


@pytest.mark.parametrize("text", ["a{1}.b{k}", "a.b", "a{1,2}"])
def test_an_element_or_component_takes_a_value(text):
    whole, work = routine(f"{text}:=1;")
    other, right = routine(f"x:={text};")
    assert shown(whole, work.body[0].target) == shown(other, right.body[0].value)


@pytest.mark.parametrize(
    "move",
    [
        f"MoveL {TARGET},v50,z1,tMill\\WObj:=wPart;", f"movej {TARGET} , v50 , fine , t1 ;",
        f"MoveL {TARGET},[50,500.5,5000,1000],z1,tMill,\\WObj:=w ;",
    ],
)  # fmt: skip
def test_a_plain_move_has_the_same_parts_as_one_read_token_by_token(move):
    """A comment behind the instruction keeps it from the pattern of plain moves."""
    whole, work = routine(move)
    split = move.replace("ove", "ove", 1)
    other, slow = routine(split[:5] + "! not plain\n" + split[5:])
    (first,), (second, *_) = work.body, [item for item in slow.body if isinstance(item, Instruction)]
    assert shown(whole, first)[0] == shown(other, second)[0]
    assert shown(whole, first)[1] == move
    for plain, token in zip(first.arguments, second.arguments, strict=True):
        assert shown(whole, plain) == shown(other, token)


def test_comments_are_in_order_and_trail_where_a_statement_is_in_their_line():
    whole, work = routine("! one\nStop; ! two\n\n! three\nIF a THEN ! four\nENDIF")
    items = [shown(whole, item) for item in work.body]
    assert items[:4] == [
        ("!", "! one", " one", False), ("STOP", "Stop;"), ("!", "! two", " two", True),
        ("!", "! three", " three", False)
    ]  # fmt: skip
    assert items[4][3] == (name("a"), ("!", "! four", " four", True))


def test_routines_have_their_names_parameters_and_handlers():
    head = "LOCAL FUNC num Half(num a,VAR num b{*}\\switch on|INOUT bool off,PERS pos p)"
    text = f"MODULE m\n  {head}\n  Stop;\n  ERROR\n  TRYNEXT;\n  UNDO\n  Set d;\n  ENDFUNC\nTRAP t1\nENDTRAP\nENDMODULE"
    half, trap = modules(text)[0].routines
    assert (half.kind, half.name, text[slice(*half.name_span)]) == ("FUNC", "HALF", "Half")
    assert text[half.start : half.stop].startswith("LOCAL FUNC")
    assert text[half.start : half.stop].endswith("ENDFUNC")
    assert [(p.name, p.type, p.is_changeable, p.is_optional) for p in half.parameters] == [
        ("A", "NUM", False, False), ("B", "NUM", True, False), ("ON", "SWITCH", False, True),
        ("OFF", "BOOL", True, True), ("P", "POS", True, False),
    ]  # fmt: skip
    assert [shown(text, item) for item in half.body] == [("STOP", "Stop;")]
    assert [shown(text, item)[:2] for item in half.handler] == [("TRYNEXT", "TRYNEXT;"), ("SET", "Set d;")]
    assert (trap.kind, trap.name, trap.parameters, trap.body) == ("TRAP", "T1", (), ())


def test_modules_have_their_data_and_routines_whatever_is_between():
    text = (
        "%%% VERSION:1 %%%\n! head\nMODULE a(SYSMODULE,NOVIEW)\nRECORD pair\nnum x;\nENDRECORD\nALIAS num level;\n! c\n"
        "LOCAL  TASK PERS num n:=1;\nTASK VAR num k;\nCONST num m:=2;\nLOCAL PROC p()\nENDPROC\nENDMODULE\n"
        "MODULE b\nENDMODULE\n! end"
    )
    first, second = modules(text)
    assert (first.name, second.name, second.data, second.routines) == ("A", "B", (), ())
    assert [(item.kind, item.is_local, item.name) for item in first.data] == [
        ("PERS", True, "N"), ("VAR", False, "K"), ("CONST", False, "M")
    ]  # fmt: skip
    assert [item.name for item in first.routines] == ["P"]


FAULTS = {
    "x = 1;": ("a name is expected", "="), "x := ;": ("a name is expected", ";"),
    "Stop": ("a name is expected", "ENDPROC"),
    "f a b;": ("a comma or ;", "b"), "ENDIF": ("ENDPROC is expected", "ENDIF"), "x := (1;": (") is expected", ";"),
    "x := [1;": ("] is expected", ";"), "x{1:=2;": ("} is expected", ":="), "x := a{1;": ("} is expected", ";"),
    "5;": ("a statement is expected", "5"), "THEN;": ("a statement is expected", "THEN"),
    "IF a THEN Stop;": ("ENDIF is expected", "ENDPROC"), "FOR 1 FROM 1 TO 2 DO ENDFOR": ("a name is expected", "1"),
    "FOR i FROM 1 DO ENDFOR": ("TO is expected", "DO"), "WHILE a ENDWHILE": ("DO is expected", "ENDWHILE"),
    "TEST a CASE 1 ENDTEST": (": is expected", "ENDTEST"), "LOCAL num x;": ("CONST, PERS or VAR", "num"),
    "VAR num x": ("; is expected", "ENDPROC"), "CONNECT n late;": ("WITH is expected", "late"),
    "x := a.;": ("a name is expected", ";"), "~;": ("a statement", "~"),
    "x := f(a;": ("a comma or )", ";"), "%\"a\" x;": ("% is expected", "x"), "f \\1;": ("a name is expected", "1"),
}  # fmt: skip


@pytest.mark.parametrize("text", FAULTS)
def test_what_is_not_rapid_is_refused_at_its_place(text):
    whole = f"MODULE m\nPROC p()\n{text}\nENDPROC\nENDMODULE"
    words, place = FAULTS[text]
    with pytest.raises(RapidSyntaxError) as caught:
        modules(whole)
    assert words in caught.value.problem
    assert caught.value.problem.endswith(f"instead of {place!r}")
    assert whole[caught.value.start :].startswith(place)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", None), ("PROC p()", "MODULE is expected"), ("MODULE m(", ") is expected"),
        ("MODULE m x", "data or a routine"),
        ("MODULE m RECORD r", "ENDRECORD is expected"), ("MODULE m ALIAS a", "; is expected"),
        ("MODULE m PROC p(num a{*", "} is expected"), ("MODULE m PROC p() Stop;", "the end of a routine"),
        ("MODULE m PROC p ENDPROC", "( is expected"), ("%%% x", "%%% is expected"),
        ("MODULE m LOCAL", "data or a routine"),
        ("MODULE m FUNC num p() ENDPROC", "ENDFUNC is expected"),
    ],
)  # fmt: skip
def test_a_text_that_ends_too_early_or_has_no_module_is_refused(text, words):
    if words is None:
        assert modules(text) == ()
        return
    with pytest.raises(RapidSyntaxError) as caught:
        modules(text)
    assert words in caught.value.problem


@pytest.mark.parametrize(
    ("head", "begin", "end", "tail", "count"),
    [("x := ", "(", ")", ";", 25), ("x := ", "[", "]", ";", 25), ("", "IF a THEN\n", "ENDIF\n", "", 90)],
)
def test_what_is_nested_beyond_any_program_is_refused(head, begin, end, tail, count):
    inside = "1" if head else "Stop;"
    assert len(routine(head + begin * count + inside + end * count + tail)[1].body) == 1
    with pytest.raises(RapidSyntaxError, match="nested too deeply"):
        routine(head + begin * 300 + inside + end * 300 + tail)


def test_many_brackets_and_blocks_one_behind_the_other_are_not_nested():
    body = "x := (1)+[[1]]+f(2);\nIF a THEN\nENDIF\n" * 400
    assert len(routine(body)[1].body) == 800


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("f g(1),h(k(2))\\o:=m(3);", "GHKM"), ("x{g(1)}:=h(2)-k(3);", "GHK"), ("VAR num n:=g(1);", "G"),
        ("IF g(1) THEN\nh(2);\nENDIF", "G"), ("TEST g(1)\nCASE h(2):\nENDTEST", "GH"),
        ("WHILE NOT g(1) DO\nENDWHILE", "G"),
        ("FOR i FROM g(1) TO h(2) STEP k(3) DO\nENDFOR", "GHK"), ("x:=[g(1),[h(2),3]];", "GH"), ("Stop;", ""),
        ("x:=a{g(1)}.b;", "G"),
    ],
)  # fmt: skip
def test_all_calls_of_a_statement_are_found_but_not_those_of_statements_in_it(text, names):
    statement: Statement = routine(text)[1].body[0]
    assert sorted(call.value for call in calls(statement)) == sorted(names)
