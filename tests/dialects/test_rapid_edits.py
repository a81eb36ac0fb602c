"""The text of a RAPID module after edits of all kinds, to the byte, with the line of each target."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from postproc.dialects.rapid.rewrite import _Rewriter
from postproc.program import CIRC, LIN, PTP
from tests.dialects.rapid_reading import AXES, MOVE_HOME, at, module, read

NEW_AXES = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
TAIL = ",v50,z1,tMill\\WObj:=wPart;"


def new(x, y, z):
    """Text of a written target, whose orientation is that of all targets here."""
    numbers = f"{x:.4f},{y:.4f},{z:.4f}"
    return f"[[{numbers}],[0.00000000,1.00000000,0.00000000,0.00000000],[0,0,0,0],{NEW_AXES}]"


def edited(x, y, z):
    """Text of a target of the program whose numbers are replaced."""
    numbers = f"{x:.4f},{y:.4f},{z:.4f}"
    return f"[[{numbers}],[0.00000000,1.00000000,0.00000000,0.00000000],[0,0,0,0],{AXES}]"


def rewritten(code, targets, data="", forces=None, lowered=None, line_end="\n"):
    """Return a written module: code after HOME, lines of the targets counted from HOME, lines of the data, issues.

    :param targets: motion, place [mm], kind and point on the circle [mm] of each target after HOME; without a place the
        target is kept.
    :param forces: force comments by row of the target, HOME is row 0.
    :param lowered: motion → its lower feed [m/s].
    """
    program = read(module(code, data).replace("\n", line_end))
    count = len(targets) + 1
    zero = (0.0, 0.0, 0.0)
    rows = [(0, None, PTP, zero), *((*row, LIN, zero)[:4] if len(row) == 2 else (*row, zero)[:4] for row in targets)]
    poses = SimpleNamespace(
        position=np.array([row[1] or zero for row in rows]) / 1e3, rotation=np.tile(np.eye(3), (count, 1, 1))
    )
    made = SimpleNamespace(
        motion=np.array([row[0] for row in rows]), keep=np.array([row[1] is None for row in rows]),
        kind=np.array([row[2] for row in rows]), via=np.array([row[3] for row in rows]) / 1e3,
        blend=np.full(count, 0.001), pose=SimpleNamespace(take=lambda _: poses),
    )  # fmt: skip
    joints = SimpleNamespace(q=np.zeros((count, 6)), status=np.zeros(count, dtype=np.int64))
    writer = _Rewriter(program, program.layout, made, joints, None)
    writer.quaternion, writer.configuration = (
        np.tile([0.0, 1.0, 0.0, 0.0], (count, 1)),
        np.zeros((count, 4), dtype=np.int64),
    )
    writer.degrees = np.full((count, 6), 45.0)
    for motion, feed in (lowered or {}).items():
        program.motions.feed[motion] = feed
        writer.lowered_moves.add(motion)
    writer._missing_force_comments = lambda: forces or {}
    result = writer.write()
    lines = result.documents[0].text.split(line_end)
    home = next(k for k, line in enumerate(lines) if line.strip().startswith("MoveAbsJ"))
    end = lines.index("  ENDPROC")
    assert lines[home] == f"    {MOVE_HOME}"
    return SimpleNamespace(
        code=lines[home + 1 : end], lines=[int(line) - home - 1 for line in result.output_line],
        data=lines[:home], issues=result.issues,
    )  # fmt: skip


A, B, C = (10, 0, 20), (60, 0, 20), (60, 40, 20)
FIRST, LAST = f"MoveL {at(*A)}{TAIL}", f"MoveL {at(*B)}{TAIL}"
KEPT = (1, None)


@pytest.mark.parametrize(
    ("code", "targets", "expected", "lines"),
    [
        ([FIRST, LAST], [KEPT, (2, None)], [FIRST, LAST], [0, 1, 2]),
        ([FIRST, LAST], [KEPT, (2, (61, 0.5, 20))], [FIRST, f"MoveL {edited(61, 0.5, 20)}{TAIL}"], [0, 1, 2]),
        ([FIRST, LAST], [(1, (9, 1, 2)), (2, None)], [f"MoveL {edited(9, 1, 2)}{TAIL}", LAST], [0, 1, 2]),
        (
            [FIRST, LAST, FIRST],
            [KEPT, (2, (30, 0, 21)), (2, (40, 0, 22)), (2, (61, 0, 23)), (3, None)],
            [FIRST, f"MoveL {new(30, 0, 21)}{TAIL}", f"MoveL {new(40, 0, 22)}{TAIL}",
             f"MoveL {edited(61, 0, 23)}{TAIL}", FIRST],
            [0, 1, 2, 3, 4, 5],
        ),
        (  # the end of a divided move is kept
            [FIRST, "WaitTime 1;", LAST],
            [KEPT, (2, (30, 0, 21)), (2, None)],
            [FIRST, "WaitTime 1;", f"MoveL {new(30, 0, 21)}{TAIL}", LAST],
            [0, 1, 3, 4],
        ),
        (  # both moves are divided: the second one is further down by both
            [FIRST, LAST],
            [(1, (1, 0, 0)), KEPT, (2, (30, 0, 21)), (2, None)],
            [f"MoveL {new(1, 0, 0)}{TAIL}", FIRST, f"MoveL {new(30, 0, 21)}{TAIL}", LAST],
            [0, 1, 2, 3, 4],
        ),
        (  # two statements in a line
            [f"{FIRST} {LAST} SetDO d1,1;"],
            [KEPT, (2, (30, 0, 21)), (2, (61, 0, 20))],
            [f"{FIRST} ", f"MoveL {new(30, 0, 21)}{TAIL}", f"MoveL {edited(61, 0, 20)}{TAIL} SetDO d1,1;"],
            [0, 1, 2, 3],
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_lines_before_a_move_and_numbers_in_it(code, targets, expected, lines, line_end):
    result = rewritten(code, targets, line_end=line_end)
    assert result.code == [f"    {line}" for line in expected]
    assert result.lines == lines
    assert result.issues == ()


@pytest.mark.parametrize(
    ("move", "inserted"),
    [
        ("MoveL #,v50,fine,tMill\\WObj:=wPart;", "MoveL @,v50,z0,tMill\\WObj:=wPart;"),
        ("MoveL #,v50,z1\\Inpos:=inpos50,tMill\\WObj:=wPart;", "MoveL @,v50,z0,tMill\\WObj:=wPart;"),
        ("MoveL #,v50,z10\\Z:=0,tMill\\WObj:=wPart;", "MoveL @,v50,z0,tMill\\WObj:=wPart;"),
        ("MoveL #,v50,z10\\Z:=2,tMill\\WObj:=wPart;", "MoveL @,v50,z10\\Z:=2,tMill\\WObj:=wPart;"),
        ("MoveL \\Conc,#,v50,z1,tMill\\WObj:=wPart;", "MoveL \\Conc,@,v50,z1,tMill\\WObj:=wPart;"),
        ("MoveL #,v50\\V:=30,z1,tMill\\WObj:=wPart;", "MoveL @,v50\\V:=30,z1,tMill\\WObj:=wPart;"),
        ("MoveL #,v50,z1,tMill\\WObj:=wPart\\TLoad:=load0;", "MoveL @,v50,z1,tMill\\WObj:=wPart\\TLoad:=load0;"),
        ("MoveL #,v50,z1,tMill\\TLoad:=load0\\WObj:=wPart;", "MoveL @,v50,z1,tMill\\WObj:=wPart\\TLoad:=load0;"),
        ("MoveLDO #,v50,z1,tMill\\WObj:=wPart,do1,1;", "MoveL @,v50,z1,tMill\\WObj:=wPart;"),
        ("MoveLSync #,v50,z1,tMill\\WObj:=wPart,\"p\";", "MoveL @,v50,z1,tMill\\WObj:=wPart;"),
    ],
)  # fmt: skip
def test_an_inserted_line_has_the_options_of_its_move(move, inserted):
    """It is passed where the move stops by its zone; what the move switches is left to its end."""
    result = rewritten([FIRST, move.replace("#", at(*B))], [KEPT, (2, (30, 0, 21)), (2, None)])
    expected = [FIRST, inserted.replace("@", new(30, 0, 21)), move.replace("#", at(*B))]
    assert result.code == [f"    {line}" for line in expected]
    assert result.lines == [0, 1, 2, 3]
    assert result.issues == ()


def test_an_inserted_target_of_a_move_that_switches_early_is_an_error_of_its_line():
    code = [FIRST, f"TriggL {at(*B)},v50,trig,z1,tMill\\WObj:=wPart;"]
    result = rewritten(code, [KEPT, (2, (30, 0, 21)), (2, None)], "  VAR triggdata trig;")
    assert [(issue.level, issue.kind) for issue in result.issues] == [("error", "trigger")]
    assert result.code[1] == f"    MoveL {new(30, 0, 21)}{TAIL}"
    kept = rewritten(code, [KEPT, (2, (61, 0, 20))], "  VAR triggdata trig;", forces={2: "! FORCE FX=1"})
    assert kept.issues == ()
    assert kept.code[1:] == ["    ! FORCE FX=1", f"    TriggL {edited(61, 0, 20)},v50,trig,z1,tMill\\WObj:=wPart;"]


@pytest.mark.parametrize(
    ("forces", "code", "expected", "lines"),
    [
        ({2: "! F2"}, [FIRST, LAST], [FIRST, "! F2", "inserted", LAST], [0, 1, 3, 4]),
        ({3: "! F3"}, [FIRST, LAST], [FIRST, "inserted", "! F3", LAST], [0, 1, 2, 4]),
        ({1: "! F1", 2: "! F2", 3: "! F3"}, [FIRST, LAST],
         ["! F1", FIRST, "! F2", "inserted", "! F3", LAST], [0, 2, 4, 6]),
        ({2: "! F2", 3: "! F3"}, [FIRST, f"{LAST} ! FORCE FX=100"],
         [FIRST, "! F2", "inserted", f"{LAST} ! F3"], [0, 1, 3, 4]),
        ({3: "! F3"}, [f"{FIRST} ! FORCE FX=100", LAST],
         [f"{FIRST} ! FORCE FX=100", "inserted", "! F3", LAST], [0, 1, 2, 4]),
        ({3: "! F3"}, [FIRST, "! FORCE FX=100", LAST],
         [FIRST, "! FORCE FX=100", "inserted", "! F3", LAST], [0, 1, 3, 5]),
    ],
)  # fmt: skip
def test_force_comments_precede_their_targets_or_replace_that_of_the_line(forces, code, expected, lines):
    result = rewritten(code, [KEPT, (2, (30, 0, 21)), (2, None)], forces=forces)
    assert result.code == [f"    {line}".replace("inserted", f"MoveL {new(30, 0, 21)}{TAIL}") for line in expected]
    assert result.lines == lines


@pytest.mark.parametrize(
    ("targets", "expected"),
    [
        ([KEPT, (2, None, CIRC, B)], ["MoveC # via #"]),
        ([KEPT, (2, (61, 40, 20), CIRC, (50, 1, 20))], ["MoveC via=50,1,20 to=61,40,20"]),
        ([KEPT, (2, None)], ["MoveL # to #"]),
        ([KEPT, (2, (61, 40, 20))], ["MoveL to=61,40,20"]),
        ([KEPT, (2, (30, 10, 20), CIRC, (20, 5, 20)), (2, (61, 40, 20), CIRC, (50, 1, 20))],
         ["MoveC new via=20,5,20 to=30,10,20", "MoveC via=50,1,20 to=61,40,20"]),
    ],
)  # fmt: skip
def test_circles_stay_circles_or_become_lines(targets, expected):
    """The orientation of the point on a circle stays as written."""
    texts = {
        "MoveC # via #": f"MoveC {at(*B)},{at(*C)}",
        "MoveC via=50,1,20 to=61,40,20": f"MoveC {at('50.0000', '1.0000', '20.0000')},{edited(61, 40, 20)}",
        "MoveL # to #": f"MoveL {at(*C)}", "MoveL to=61,40,20": f"MoveL {edited(61, 40, 20)}",
        "MoveC new via=20,5,20 to=30,10,20": f"MoveC {new(20, 5, 20)},{new(30, 10, 20)}",
    }  # fmt: skip
    result = rewritten([FIRST, f"MoveC {at(*B)},{at(*C)}{TAIL}"], targets)
    assert result.code == [f"    {FIRST}", *(f"    {texts[key]}{TAIL}" for key in expected)]


@pytest.mark.parametrize(
    ("word", "line", "before", "behind"),
    [
        ("MoveCDO", "MoveLDO", "", ",do1,1"),
        ("MoveCSync", "MoveLSync", "", ',"p"'),
        ("TriggC", "TriggL", "trig,", ""),
    ],
)
def test_circles_that_switch_become_lines_that_switch(word, line, before, behind):
    tail = f",v50,{before}z1,tMill\\WObj:=wPart{behind};"
    code = [FIRST, f"{word} {at(*B)},{at(*C)}{tail}"]
    result = rewritten(code, [KEPT, (2, (61, 40, 20))], "  VAR triggdata trig;")
    assert result.code[1] == f"    {line} {edited(61, 40, 20)}{tail}"


P = f"  CONST robtarget p:={at(*B)};"


@pytest.mark.parametrize(
    ("code", "targets", "data", "expected", "data_after"),
    [
        (["MoveL p~"], [(1, (61, 0, 20))], P, ["MoveL p~"], f"  CONST robtarget p:={edited(61, 0, 20)};"),
        (["MoveL p~", "MoveL p~"], [(1, (61, 0, 20)), (2, (61, 0, 20))], P, ["MoveL p~", "MoveL p~"],
         f"  CONST robtarget p:={edited(61, 0, 20)};"),
        (["MoveL p~", "MoveL p~"], [(1, (61, 0, 20)), (2, (62, 0, 20))], P,
         [f"MoveL {new(61, 0, 20)}~", f"MoveL {new(62, 0, 20)}~"], P),
        (["MoveL p~", "MoveL p~"], [(1, (61, 0, 20)), (2, None)], P, [f"MoveL {new(61, 0, 20)}~", "MoveL p~"], P),
        (["MoveL P~", "MoveL p~"], [(1, None), (2, (61, 0, 20))], P, ["MoveL P~", f"MoveL {new(61, 0, 20)}~"], P),
        (["MoveL p~", "MoveL Offs(p,0,0,9)~"], [(1, (61, 0, 20)), (2, None)], P,
         [f"MoveL {new(61, 0, 20)}~", "MoveL Offs(p,0,0,9)~"], P),
        (["MoveL Offs(p,0,0,9)~"], [(1, (61, 0, 20))], P, [f"MoveL {new(61, 0, 20)}~"], P),
        (["MoveL p~"], [(1, (61, 0, 20))], P.replace("CONST", "PERS"), [f"MoveL {new(61, 0, 20)}~"],
         P.replace("CONST", "PERS")),
        (["MoveL p~"], [(1, (61, 0, 20))], P.replace("CONST", "VAR"), ["MoveL p~"],
         f"  VAR robtarget p:={edited(61, 0, 20)};"),
        ([f"MoveL {at(*A)}~", "MoveC p,p2~"], [(1, None), (2, (61, 9, 20), CIRC, (50, 1, 20))],
         P + f" CONST robtarget p2:={at(*C)};", [f"MoveL {at(*A)}~", "MoveC p,p2~"],
         f"  CONST robtarget p:={at('50.0000', '1.0000', '20.0000')}; CONST robtarget p2:={edited(61, 9, 20)};"),
    ],
)  # fmt: skip
def test_named_targets_change_once_or_become_numbers(code, targets, data, expected, data_after):
    result = rewritten([line.replace("~", TAIL) for line in code], targets, data)
    assert result.code == ["    " + line.replace("~", TAIL) for line in expected]
    assert data_after in result.data


@pytest.mark.parametrize(
    ("speed", "targets", "lowered", "expected"),
    [
        ("v50", [KEPT, (2, None)], {2: 0.02}, ["v50\\V:=20"]),
        ("v50\\V:=30", [KEPT, (2, None)], {2: 0.0205}, ["v50\\V:=20.5"]),
        ("v50\\T:=2", [KEPT, (2, None)], {2: 0.0205}, ["v50\\V:=20.5"]),
        ("v50\\T:=2", [KEPT, (2, None)], {}, ["v50\\T:=2"]),
        ("v50\\T:=2", [KEPT, (2, (61, 0, 20))], {}, ["v50\\V:=25"]),
        ("v50\\T:=2", [(1, (11, 0, 20)), (2, None)], {}, ["v50\\V:=25"]),  # it starts elsewhere
        ("v50\\T:=2", [KEPT, (2, (30, 0, 20)), (2, None)], {}, ["v50\\V:=25", "v50\\V:=25"]),
        ("v50\\V:=30", [KEPT, (2, (30, 0, 20)), (2, None)], {2: 0.02}, ["v50\\V:=20", "v50\\V:=20"]),
        ("v50", [KEPT, (2, (30, 0, 20)), (2, None)], {2: 0.02}, ["v50\\V:=20", "v50\\V:=20"]),
    ],
)  # fmt: skip
def test_durations_and_lowered_speeds_are_written_as_speeds(speed, targets, lowered, expected):
    """The move is 50 mm long: in 2 s at 25 mm/s."""
    code = [FIRST, f"MoveL {at(*B)},{speed},z1,tMill\\WObj:=wPart;"]
    result = rewritten(code, targets, lowered=lowered)
    assert [line.split("]],")[1].partition(",")[0] for line in result.code[1:]] == expected


def test_an_inserted_axis_target_is_a_movej_with_numbers():
    code = [FIRST, f"MoveJ {at(*B)}{TAIL}"]
    result = rewritten(code, [KEPT, (2, (30, 0, 21), PTP), (2, (61, 0, 20), PTP)])
    assert result.code[1:] == [f"    MoveJ {new(30, 0, 21)}{TAIL}", f"    MoveJ {edited(61, 0, 20)}{TAIL}"]


@pytest.mark.parametrize(
    ("axes", "written"),
    [("[9E9,9E9,9E9,9E9,9E9,9E9]", NEW_AXES), ("[100,-2.5,9E9,0,9E9,9E9]", "[100,-2.5,9E+09,0,9E+09,9E+09]")],
)
def test_external_axes_of_numbers_that_are_written_anew_are_those_as_read(axes, written):
    writer = object.__new__(_Rewriter)
    writer._configuration = lambda numbers, k: [1, -2, 3, 4]
    writer.quaternion = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.6, -0.8, 0.0]])
    numbers = [0.0] * 11 + [float(value) for value in axes.strip("[]").split(",")]
    place = np.array([1.23456, -7.0, 0.0])
    start = "[[1.2346,-7.0000,0.0000]"
    turns = ["[0.00000000,0.60000000,-0.80000000,0.00000000]", "[0.50000000,0.50000000,0.50000000,0.50000000]"]
    assert writer._target_text(numbers, place, 1) == f"{start},{turns[0]},[1,-2,3,4],{written}]"
    assert writer._target_text(numbers, place, 1, np.full(4, 0.5)) == f"{start},{turns[1]},[1,-2,3,4],{written}]"
