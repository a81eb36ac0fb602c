"""What a corrected RAPID module keeps of its text, and what it says: one form of a move, target or number at a time.

Each conversion is read back, and its poses, speeds and zones are compared, before it is written.
"""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from postproc.dialects.rapid.moves import Target
from postproc.dialects.rapid.rewrite import _Rewriter
from postproc.dialects.rapid.syntax import modules
from postproc.errors import PostprocError
from postproc.program import CIRC, LIN, PTP
from tests.dialects.rapid_reading import AXES, MOVE_HOME, Q, at, correct_module, module, read, tail

FORCE = "! FORCE FX=300 FY=-100"
FIRST = f"MoveL {at(0, 0, 20)}{tail()}"


def written(folder, code, data="", routines="", head=None):
    """Statements of a corrected module between its first move and its end, without blanks."""
    text = module(code, data, routines)
    if head is not None:
        text = text.replace(MOVE_HOME, head)
    return [line.strip() for line in correct_module(folder, text).splitlines()]


def moves_of(lines, word="Move"):
    return [line for line in lines if line.startswith(word)]


def numbers(line):
    """X, Y, Z as texts of the target of a line: the last one of a circle."""
    return re.findall(r"\[\[([^],]*),([^],]*),([^],]*)\]", line)[-1]


@pytest.mark.parametrize("velset", ["VelSet 50,800;", "VelSet 100,40;", "VelSet 50,20;"])
@pytest.mark.parametrize("speed", ["v50", "v50\\T:=2", "v50\\V:=30"])
def test_a_speed_that_is_written_is_that_before_velset(tmp_path, velset, speed):
    """A duration becomes the speed that VelSet lowers to that of the move, of 60 mm; other speeds stay."""
    move = f"MoveL {at(60, 0, 20)},{speed},z1,tMill\\WObj:=wPart;"
    code = [velset, FIRST, FORCE, move]
    feeds = read(module(code)).motions.feed * 1e3
    lines = moves_of(written(tmp_path, code), "MoveL")
    for line in lines[1:]:
        if "\\T" not in speed:
            assert f",{speed}," in line
            continue
        share = 0.5 if "50," in velset else 1.0
        assert float(re.search(r"v50\\V:=([\d.]+)", line).group(1)) == pytest.approx(feeds[-1] / share)


@pytest.mark.parametrize(
    ("word", "behind", "is_refused"),
    [("MoveL", "", False), ("MoveLDO", ",do1,1", False), ("MoveLAO", ",ao1,1", False), ("TriggL", "", True)],
)  # fmt: skip
def test_moves_that_switch_keep_it_at_their_end(tmp_path, word, behind, is_refused):
    """Inserted targets are plain moves before it; one that switches at a distance from its end gets none."""
    before = "trig," if word == "TriggL" else ""
    zone = f"v50,{before}z1,tMill\\WObj:=wPart"
    code = [FIRST, FORCE, f"{word} {at(160, 60, 20)},{zone}{behind};"]
    data = "  VAR triggdata trig;"
    if is_refused:
        assert "switches at a distance from its end" in correct_module(tmp_path, module(code, data), code=1)
        return
    lines = moves_of(written(tmp_path, code, data))
    assert lines[-1].startswith(f"{word} [[")
    assert lines[-1].endswith(f"{zone}{behind};")
    inner = lines[2:-1]
    assert inner
    assert all(line.startswith("MoveL [[") and line.endswith("v50,z1,tMill\\WObj:=wPart;") for line in inner)


def test_a_short_move_that_switches_before_its_end_keeps_its_form(tmp_path):
    code = [FIRST, FORCE, f"TriggL {at(1, 0, 20)},v50,trig,z1,tMill\\WObj:=wPart;"]
    lines = written(tmp_path, code, "  VAR triggdata trig;")
    (line,) = moves_of(lines, "TriggL")
    assert line.endswith(",v50,trig,z1,tMill\\WObj:=wPart;")
    assert float(numbers(line)[0]) != 1.0


@pytest.mark.parametrize(
    ("texts", "decimals"),
    [
        (("60", "0", "20"), (4, 4, 4)), (("60.0", "0.0", "20.00"), (4, 4, 4)),
        (("60.00000", "0.000000", "20.0000000"), (5, 6, 7)), (("6.0E1", "0", "2.000000E+01"), (4, 4, 6)),
        (("60.00000000000", "+0.5", "-20."), (9, 4, 4)),
    ],
)  # fmt: skip
def test_numbers_keep_their_decimals_but_for_four_at_least_and_nine_at_most(tmp_path, texts, decimals):
    """Zeros at their end are left out, so that there may be fewer."""
    code = [FIRST, FORCE, f"MoveL [[{','.join(texts)}],{Q},[0,0,0,0],{AXES}]{tail()}"]
    (x, y, z) = numbers(moves_of(written(tmp_path, code))[-1])
    for text, count in zip((x, y, z), decimals, strict=True):
        assert "E" not in text.upper()
        assert len(text.partition(".")[2]) <= count
    assert max(len(text.partition(".")[2]) for text in (x, y, z)) == max(decimals)


TARGETS = {
    "numbers": (f"[[60,0,20],{Q},[0,0,0,0],{AXES}]", ""),
    "a configuration by name": (f"[[60,0,20],{Q},conf,{AXES}]", "  CONST confdata conf:=[0,0,0,0];"),
    "axes by name": (f"[[60,0,20],{Q},[0,0,0,0],axes]", f"  CONST extjoint axes:={AXES};"),
    "a place by name": (f"[there,{Q},[0,0,0,0],{AXES}]", "  CONST pos there:=[60,0,20];"),
    "an orientation by name": (f"[[60,0,20],down,[0,0,0,0],{AXES}]", f"  CONST orient down:={Q};"),
    "an expression": (f"[[50+10,0,20],{Q},[0,0,0,0],{AXES}]", ""),
    "with blanks": (f"[ [ 60 , 0 , 20 ] , {Q} , [ 0 , 0 , 0 , 0 ] , {AXES} ]", ""),
    "a constant": ("p60", f"  CONST robtarget p60:={at(60, 0, 20)};"),
    "a variable": ("p60", f"  VAR robtarget p60:={at(60, 0, 20)};"),
    "a persistent": ("p60", f"  PERS robtarget p60:={at(60, 0, 20)};"),
    "of an array": ("p60{2}", f"  CONST robtarget p60{{2}}:=[{at(0, 0, 0)},{at(60, 0, 20)}];"),
    "computed": ("Offs(p0,60,0,0)", f"  CONST robtarget p0:={at(0, 0, 20)};"),
}


@pytest.mark.parametrize("kind", TARGETS)
def test_a_target_is_corrected_in_whatever_form_it_is_written(tmp_path, kind):
    """As numbers where they are, or in the move; names of configuration and axes stay where they can."""
    text, data = TARGETS[kind]
    code = [FIRST, FORCE, f"MoveL {text}{tail()}"]
    program = read(module(code, data))
    np.testing.assert_allclose(program.motions.target[-1, :3, 3], [0.06, 0.0, 0.02], atol=1e-8)
    lines = written(tmp_path, code, data)
    last = moves_of(lines)[-1]
    if kind in ("a constant", "a variable", "of an array"):
        assert f"MoveL {text}," in last
        (declared,) = [line for line in lines if "robtarget p60" in line]
        assert at(60, 0, 20) not in declared
        assert ("{2}" not in declared) or at(0, 0, 0) in declared
    else:
        assert last.startswith(("MoveL [[", "MoveL [ ["))
        assert data.strip() in lines  # as it was
    if kind == "axes by name":
        assert ",axes]" in last
    if kind == "a configuration by name":
        assert ",conf," in last or ",[0,0,0,0]," in last
    if kind == "with blanks":
        assert last.startswith("MoveL [ [ ")


@pytest.mark.parametrize("index", [0, 3, 1.5])
def test_an_element_that_an_array_does_not_have_is_no_target(index):
    data = f"  CONST robtarget p{{2}}:=[{at(0, 0, 0)},{at(60, 0, 20)}];"
    with pytest.raises(PostprocError, match=f"the index {index:g} is outside of the array"):
        read(module([f"MoveL p{{{index}}}{tail()}"], data))


def test_a_constant_of_two_moves_with_different_ends_stays(tmp_path):
    """Without a force at the second one there are two ends, and both moves get numbers, or keep the name."""
    data = f"  CONST robtarget p60:={at(60, 0, 20)};"
    code = [FIRST, FORCE, f"MoveL p60{tail()}", "! FORCE OFF", f"MoveL {at(0, 0, 90)}{tail()}", f"MoveL p60{tail()}"]
    lines = written(tmp_path, code, data)
    (declared,) = [line for line in lines if "robtarget p60" in line]
    assert at(60, 0, 20) in declared
    assert sum("MoveL p60," in line for line in lines) < 2


def test_a_circle_becomes_shorter_ones_with_points_between(tmp_path):
    code = ["CirPathMode\\ObjectFrame;", FIRST, FORCE, f"MoveC {at(20, 20, 20)},{at(40, 0, 20)}{tail()}"]
    lines = moves_of(written(tmp_path, code), "MoveC")
    assert len(lines) > 1
    for line in lines:
        assert len(re.findall(r"\[\[", line)) == 2
        assert line.endswith(tail())
    straight = moves_of(
        [
            line.strip()
            for line in correct_module(tmp_path, module(code), "--linearize-arcs", "--overwrite").splitlines()
        ]
    )
    assert not [line for line in straight if line.startswith("MoveC")]
    assert len(straight) > len(lines) + 2


@pytest.mark.parametrize("stop", ["fine", "z1\\Inpos:=inpos50", "z10\\Z:=0"])
def test_inserted_targets_on_a_long_line_to_a_stop_are_passed_without_one(tmp_path, stop):
    """The first one is a corner, where the force has come up: the robot stops there as at the end."""
    behind = ",tMill\\WObj:=wPart;"
    code = [FIRST, FORCE, f"MoveL {at(500, 350, 20)},v50,{stop}{behind}"]
    first, *inner, last = moves_of(written(tmp_path, code))[2:]
    assert first.endswith(f",v50,{stop}{behind}")
    assert last.endswith(f",v50,{stop}{behind}")
    assert inner
    assert all(line.endswith(f",v50,z0{behind}") for line in inner)


def test_a_zone_z0_that_the_module_declares_itself_is_not_used(tmp_path):
    """It may be another one: the robot stops at the inserted targets as at the end."""
    data = "  CONST zonedata z0:=[FALSE,90,90,90,9,90,9];"
    code = [FIRST, FORCE, f"MoveL {at(500, 350, 20)},v50,fine,tMill\\WObj:=wPart;"]
    lines = moves_of(written(tmp_path, code, data))[2:]
    assert len(lines) > 2
    assert all(line.endswith(",v50,fine,tMill\\WObj:=wPart;") for line in lines)


def test_two_statements_in_one_line_are_divided_where_targets_come_between(tmp_path):
    code = [FORCE, f"{FIRST} MoveL {at(160, 60, 20)}{tail()} SetDO d1,1;"]
    lines = written(tmp_path, code)
    moves = moves_of(lines)
    assert moves[-1].endswith("SetDO d1,1;")
    assert len(moves) > 3
    assert read("\n".join(["MODULE Part", *lines[1:]])).motions.kind.tolist()[0] == PTP


@pytest.mark.parametrize("area", ["Off", "Wrist"])
def test_lines_with_the_wrist_led_by_its_axes_are_told_from_others(area):
    code = [f"SingArea\\{area};", FIRST, f"MoveL {at(60, 0, 20)}{tail()}"]
    program = read(module(code))
    if area == "Off":
        assert program.is_wrist_led is None
    else:
        assert program.is_wrist_led.tolist() == [False, True, True]
    assert program.turns_with_path is None
    circle = read(module([*code[:2], f"MoveC {at(10, 10, 20)},{at(20, 0, 20)}{tail()}"]))
    assert circle.motions.kind.tolist() == [PTP, LIN, CIRC]
    assert (circle.is_wrist_led is None) == (area == "Off")


@pytest.mark.parametrize(("z", "is_refused"), [("99000", False), ("1E7", True)])
def test_frames_beyond_any_cell_are_refused(z, is_refused):
    data = f'  TASK PERS wobjdata wFar:=[FALSE,TRUE,"",[[1500,-200,{z}],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];'
    text = module([f"MoveL {at(0, 0, 20)},v50,z1,tMill\\WObj:=wFar;"], data)
    if is_refused:
        with pytest.raises(PostprocError, match="the frame is beyond any cell"):
            read(text)
    else:
        assert read(text).bases[-1, 2, 3] == pytest.approx(99.0)


@pytest.mark.parametrize(
    ("quaternion", "is_refused"), [("[1,0,0,0]", False), ("[1,0,0,0.2]", True), ("[0.9,0,0,0]", True)]
)
def test_orientations_of_frames_are_unit_quaternions(quaternion, is_refused):
    data = f'  TASK PERS wobjdata wOff:=[FALSE,TRUE,"",[[1500,-200,700],{quaternion}],[[0,0,0],[1,0,0,0]]];'
    text = module([f"MoveL {at(0, 0, 20)},v50,z1,tMill\\WObj:=wOff;"], data)
    if is_refused:
        with pytest.raises(PostprocError, match="is not a unit quaternion"):
            read(text)
    else:
        assert len(read(text).motions) == 2


def test_headers_of_files_are_passed_over():
    body = module([FIRST])
    for header in ("%%%\n  VERSION:1\n  LANGUAGE:ENGLISH\n%%%\n", "%%% VERSION:1 %%%", "%%%\n%%%\n"):
        assert len(read(header + body).motions) == 2
    with pytest.raises(PostprocError, match="%%%"):
        read("%%%\n VERSION:1\n" + body)


def rewriter(degrees, programmed, own, target):
    """A writer of two targets of one move: configurations of its end, of the target, and joint angles there."""
    made = object.__new__(_Rewriter)
    made.motion_of_target, made.configuration = np.array([0, 0]), np.array([target, own])
    made.degrees = np.array([[0.0] * 6, [degrees, 0, 0, 0, 0, 0]])
    return made._configuration([0.0] * 7 + [float(value) for value in programmed], 0)


@pytest.mark.parametrize(
    ("degrees", "programmed", "own", "target", "expected"),
    [
        (45.0, (0, 0, 0, 0), (0, 0, 0), (1, 0, 0), [1, 0, 0, 0]),  # that of the target, as the program states its own
        (45.0, (0, 0, 0, 1), (0, 0, 0), (0, -1, 2), [0, -1, 2, 1]),  # cfx stays
        (45.0, (4, 0, 0, 0), (0, 0, 0), (1, 0, 0), [5, 0, 0, 0]),  # a whole turn more
        (45.0, (1, 0, 0, 0), (0, 0, 0), (1, 0, 0), [1, 0, 0, 0]),  # another quadrant: what it states
        (45.0, (1, 0, 0, 0), (0, 0, 0), (3, 2, 1), [1, 0, 0, 0]),
        (87.5, (1, 0, 0, 0), (0, 0, 0), (0, 0, 0), [0, 0, 0, 0]),  # near the border of a quadrant it may be the next
        (86.5, (1, 0, 0, 0), (0, 0, 0), (2, 0, 0), [1, 0, 0, 0]),
        (87.5, (2, 0, 0, 0), (0, 0, 0), (1, 0, 0), [2, 0, 0, 0]),  # but no further one
        (45.0, (8, 0, 0, 0), (0, 0, 0), (1, 0, 0), [9, 0, 0, 0]),  # several whole turns, either way, of each axis
        (45.0, (-4, 0, 0, 0), (0, 0, 0), (1, 0, 0), [-3, 0, 0, 0]),
        (45.0, (-12, 0, 0, 0), (0, 0, 0), (-1, 0, 0), [-13, 0, 0, 0]),
        (45.0, (0, 4, -8, 2), (0, 0, 0), (1, 1, 1), [1, 5, -7, 2]),
        (45.0, (7, -2, 1, 0), (3, 2, -3), (0, 0, 0), [4, -4, 4, 0]),
        (45.0, (3, 0, 0, 0), (0, 0, 0), (1, 0, 0), [3, 0, 0, 0]),  # a quadrant less than a turn
        (87.5, (3, 0, 0, 0), (0, 0, 0), (1, 0, 0), [5, 0, 0, 0]),
        (87.5, (-5, 0, 0, 0), (0, 0, 0), (1, 0, 0), [-3, 0, 0, 0]),
    ],
)  # fmt: skip
def test_configurations_are_those_of_the_joints_where_the_program_states_them(
    degrees, programmed, own, target, expected
):
    assert rewriter(degrees, programmed, own, target) == expected


def test_a_program_that_was_not_read_from_rapid_is_not_rewritten():
    from postproc.dialects.rapid.rewrite import rewrite

    program = replace(read(module([FIRST])), layout=None)
    with pytest.raises(TypeError, match="not read from RAPID"):
        rewrite(program, None, None, None)


@pytest.mark.parametrize(
    ("notes", "expected"),
    [
        ([(1, False)], [-1, -1, 0, 0, 0, 0]), ([(1, True)], [-1, -1, -1, 0, 0, 0]), ([], [-1] * 6),
        ([(0, False), (2, True)], [0, 0, 0, 0, 0, 1]), ([(0, True), (1, False), (2, False)], [-1, 0, 1, 1, 2, 2]),
    ],
)  # fmt: skip
def test_a_force_comment_holds_for_the_targets_behind_it(monkeypatch, notes, expected):
    """Three moves with an inserted target each, which is above the line of the move, and so before its comment."""
    seen = []
    monkeypatch.setattr(
        "postproc.dialects.rapid.rewrite.force_comments.needs_comment",
        lambda forces, kind, note, of_program, start: seen.append((note.tolist(), start)) or np.arange(6) == 4,
    )
    monkeypatch.setattr(
        "postproc.dialects.rapid.rewrite.force_comments.texts",
        lambda comment, forces, rows: [f"{comment.decode()} {row}" for row in rows],
    )
    made = object.__new__(_Rewriter)
    made.motion_of_target, made.is_last, made.comment_forces = (
        np.array([0, 0, 1, 1, 2, 2]),
        np.array([False, True] * 3),
        "forces",
    )
    made.targets = SimpleNamespace(kind=np.full(6, LIN))
    made.program = SimpleNamespace(notes=[SimpleNamespace(before=before) for before, _ in notes], after=None)
    made.layout = SimpleNamespace(notes=[SimpleNamespace(is_trailing=trailing) for _, trailing in notes])
    assert made._missing_force_comments() == {4: "! 4"}
    assert seen == [(expected, 0.0)]
    made.comment_forces = None
    assert made._missing_force_comments() == {}


@pytest.mark.parametrize(("duration", "speed"), [("3.3", "18.181818"), ("2.4", "25"), ("0.7", "85.714286")])
def test_a_speed_in_place_of_a_duration_has_six_decimals_without_zeros_at_its_end(tmp_path, duration, speed):
    code = [FIRST, FORCE, f"MoveL {at(60, 0, 20)},v50\\T:={duration},z1,tMill\\WObj:=wPart;"]
    line = moves_of(written(tmp_path, code), "MoveL")[-1]
    assert f",v50\\V:={speed},z1" in line


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["p60", None])
def test_a_quaternion_keeps_the_sign_that_the_program_gives_it(tmp_path, sign, name):
    """Both signs are one orientation; the text changes by the correction only."""
    q = np.array([0.1, 0.99, 0.0, 0.0998749]) * sign
    target = at(60, 0, 20, str(q.round(7).tolist()).replace(" ", ""))
    data = f"  CONST robtarget p60:={target};" if name else ""
    lines = written(tmp_path, [FIRST, FORCE, f"MoveL {name or target}{tail()}"], data)
    (line,) = [line for line in lines if "robtarget p60" in line] if name else moves_of(lines, "MoveL")[-1:]
    found = [float(text) for text in re.search(r"\],\[([^]]*)\]", line).group(1).split(",")]
    np.testing.assert_allclose(found, q, atol=2e-3)


@pytest.mark.parametrize(
    ("text", "turn", "conf", "expected"),
    [
        ("[[1,2,3],[0,1,0,0],[0,-1,2,4],axes]", True, (0, -1, 2, 4), "[PLACE,TURN,[0,-1,2,4],axes]"),
        ("[[1,2,3],[0,1,0,0],[0,-1,2,4],axes]", True, (1, -1, -2, 4), "[PLACE,TURN,[1,-1,-2,4],axes]"),
        ("[[1,2,3],[0,-1,0,0],[0,-1,2,4],axes]", True, (0, 3, 2, 4), "[PLACE,BACK,[0,3,2,4],axes]"),
        ("[[1,2,3],[0,1,0,0],[0,-1,2,4],axes]", False, (1, -1, 2, 4), "[PLACE,[0,1,0,0],[0,-1,2,4],axes]"),
        ("[[1,2,3],[0,1,0,0],conf,axes]", True, (0, -1, 2, 4), "[PLACE,TURN,conf,axes]"),
        ("[[1,2,3],[0,1,0,0],conf,axes]", True, (1, -1, 2, 4), "whole"),
        ("[p,[0,1,0,0],conf,axes]", True, (0, -1, 2, 4), "whole"),
        ("[[1,2],[0,1,0,0],conf,axes]", True, (0, -1, 2, 4), "whole"),
        ("[[1,2,k],[0,1,0,0],conf,axes]", True, (0, -1, 2, 4), "whole"),
        ("[[1,2,3],[0,1,0,0],conf]", True, (0, -1, 2, 4), "whole"),
        (f"[[1,2,3],[0,1,0,0],[0,-1,2,4],{AXES}]", True, (0, -1, 0, 4),
         f"[PLACE,TURN,[0,-1,0,4],{AXES}]"),
    ],
)  # fmt: skip
def test_numbers_of_a_target_are_replaced_one_by_one_where_they_are_numbers(text, turn, conf, expected):
    """The configuration only where it changes with the orientation; all of it where the text has names instead."""
    whole = f"MODULE m VAR robtarget x:={text}; ENDMODULE"
    literal = modules(whole)[0].data[0].value
    sign = -1.0 if "-1,0,0]" in text else 1.0
    target = Target([1.0, 2, 3, 0, sign, 0, 0, 0, -1, 2, 4, *[9e9] * 6], literal, literal)
    made = object.__new__(_Rewriter)
    made.text = whole
    made._configuration = lambda numbers, k: list(conf)
    made._target_text = lambda numbers, place, k, turn: "whole"
    quaternion = np.array([0.0, 0.8, 0.6, 0.0]) if turn else None
    edits = made._literal_edits(literal, target, np.array([10.0, 20.5, -30.0]), quaternion, 7)
    for edit in sorted(edits, reverse=True):
        whole = whole[: edit.start] + edit.text + whole[edit.stop :]
    expected = expected.replace("PLACE", "[10.0000,20.5000,-30.0000]")
    for word, minus in (("TURN", ""), ("BACK", "-")):
        expected = expected.replace(word, f"[0.00000000,{minus}0.80000000,{minus}0.60000000,0.00000000]")
    assert whole == f"MODULE m VAR robtarget x:={expected}; ENDMODULE"
