"""Motions that instructions of RAPID state: how many arguments, options, frames and files, each against the manual."""

from __future__ import annotations

import csv
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from postproc.errors import PostprocError
from postproc.program import CIRC, LIN, PTP
from tests.commands import printed
from tests.dialects.rapid_reading import AXES, MOVE_HOME, TOOLDATA, WOBJ, at, module, place, read
from tests.places import ABB_CELL_FILE

TARGET, VIA, END = at(60, 0, 20), at(10, 10, 20), at(20, 0, 20)
JOINTS = f"[[0,10,20,0,60,0],{AXES}]"
START = f"MoveL {at(0, 0, 20)},v50,z1,tMill\\WObj:=wPart;"
FORMS = {
    "MoveL": (LIN, TARGET, 0, 0), "MoveJ": (PTP, TARGET, 0, 0), "MoveC": (CIRC, f"{VIA},{END}", 0, 0),
    "MoveAbsJ": (PTP, JOINTS, 0, 0), "MoveLDO": (LIN, TARGET, 0, 2), "MoveJDO": (PTP, TARGET, 0, 2),
    "MoveCDO": (CIRC, f"{VIA},{END}", 0, 2), "MoveLAO": (LIN, TARGET, 0, 2), "MoveLGO": (LIN, TARGET, 0, 2),
    "MoveLSync": (LIN, TARGET, 0, 1), "MoveJSync": (PTP, TARGET, 0, 1), "MoveCSync": (CIRC, f"{VIA},{END}", 0, 1),
    "TriggL": (LIN, TARGET, 1, 0), "TriggJ": (PTP, TARGET, 1, 0), "TriggC": (CIRC, f"{VIA},{END}", 1, 0),
}  # fmt: skip
"""Of each instruction its kind, targets, and how many arguments may be before the zone and behind the tool."""


@pytest.mark.parametrize("name", FORMS)
def test_an_instruction_has_its_arguments_no_fewer_and_no_more(name):
    kind, targets, before, behind = FORMS[name]
    wanted = targets.count("[[") + 3 + before
    for count in range(wanted - 1, wanted + behind + 2):
        end = ",tMill" if count >= wanted else ""
        text = f"{name} {targets},v50{',trig' * before},z10{end}\\WObj:=wPart{',do1' * (count - wanted)};"
        if not wanted <= count <= wanted + behind:
            with pytest.raises(PostprocError, match=f"has {count} arguments instead of {wanted}"):
                read(module([START, text]))
            continue
        motions = read(module([START, text])).motions
        assert motions.kind[-1] == kind
        assert motions.blend[-1] * 1e3 == pytest.approx(10.0)
        assert kind == PTP or motions.feed[-1] * 1e3 == pytest.approx(50.0)
        if name == "MoveAbsJ":
            np.testing.assert_allclose(motions.joints[-1], np.radians([0, -80, 110, 0, 60, 0]), atol=1e-6)
        else:
            place = [20, 0, 20] if kind == CIRC else [60, 0, 20]
            np.testing.assert_allclose(motions.target[-1, :3, 3] * 1e3, place, atol=1e-4)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ("\\ID:=5", "the move moves together with other robots (\\ID)"),
        ("\\Corr", "is corrected by a sensor (\\CORR)"),
        ("\\Track:=t", "is led by a sensor (\\TRACK)"), ("\\Advanced", "is led by a sensor (\\ADVANCED)"),
        ("\\Foo", "\\FOO is not followed"), ("\\Conc", None), ("\\TLoad:=load0", None), ("\\NoEOffs", None),
        *((f"\\T{k}:=trig", None) for k in range(1, 9)),
    ],
)  # fmt: skip
def test_options_of_moves_are_followed_or_refused(options, problem):
    text = f"MoveL {TARGET},v50,z1,tMill\\WObj:=wPart{options};"
    if problem is None:
        assert len(read(module([text])).motions) == 2
        return
    with pytest.raises(PostprocError) as caught:
        read(module([text]))
    assert problem in caught.value.problem
    assert caught.value.text == text


def frame_of(numbers):
    """A pose [mm, quaternion] by scipy."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat([*numbers[4:], numbers[3]]).as_matrix()
    pose[:3, 3] = np.array(numbers[:3]) / 1e3
    return pose


def text_of(numbers):
    return f"[{list(numbers[:3])},{list(numbers[3:])}]".replace(" ", "")


USER, OBJECT, FLANGE = (100, 200, 300, 0.8, 0, 0.6, 0), (10, 20, 30, 0.6, 0.8, 0, 0), (5, 6, 350, 0.8, 0.6, 0, 0)


def test_frames_are_those_of_the_data_and_each_has_one_row():
    """The object frame is in the user frame; equal frames are one, and tools keep the names of their data."""
    data = (
        f'  PERS wobjdata wTurned:=[FALSE,TRUE,"",{text_of(USER)},{text_of(OBJECT)}];\n'
        f'  PERS wobjdata wCopy:=[FALSE,TRUE,"",{text_of(USER)},{text_of(OBJECT)}];\n'
        f"  PERS tooldata tLong:=[TRUE,{text_of(FLANGE)},[5,[0,0,100],[1,0,0,0],0,0,0]];\n"
        f"  PERS tooldata tSame:=[TRUE,{text_of(FLANGE)},[5,[0,0,100],[1,0,0,0],0,0,0]];"
    )
    moves = [("tMill", "wPart"), ("tLong", "wTurned"), ("tSame", "wCopy"), ("tMill", "wTurned"), ("tMill", "wPart")]
    program = read(module([f"MoveL {TARGET},v50,z1,{tool}\\WObj:={wobj};" for tool, wobj in moves], data))
    assert program.motions.base.tolist() == [0, 0, 1, 1, 1, 0]
    assert program.motions.tool.tolist() == [0, 0, 1, 1, 0, 0]
    assert program.tool_keys == (("tMill",), ("tLong", "tSame"))
    np.testing.assert_allclose(program.bases[1], frame_of(USER) @ frame_of(OBJECT), atol=1e-7)
    np.testing.assert_allclose(program.tools[1], frame_of(FLANGE), atol=1e-7)
    np.testing.assert_allclose(program.bases[0][:3, 3], [1.5, -0.2, 0.7], atol=1e-7)


@pytest.mark.parametrize(("declared", "name", "section"), [(TOOLDATA, "TMILL", "[tool]"), (WOBJ, "WPART", "[base]")])
def test_a_frame_that_no_module_declares_is_that_of_the_cell_with_a_warning(declared, name, section):
    program = read(module([START]).replace(declared, ""))
    (issue,) = program.issues
    assert (issue.level, issue.kind, issue.subject) == ("warning", "frame-from-cell", name)
    assert issue.message.startswith(f"{name} is not declared in this file: {section} of the cell is taken for it.")
    cell = place().cell
    expected = cell.tool.pose() if section == "[tool]" else cell.base.pose()
    np.testing.assert_allclose((program.tools if section == "[tool]" else program.bases)[0], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("tMill:=[TRUE", "tMill:=[FALSE", "the tool is fixed in the room and the robot holds the part"),
        (TOOLDATA, "PERS num tMill:=3;", "a num is no tooldata"),
        (TOOLDATA, "PERS speeddata tMill:=[1,2,3,4];", "a speeddata is no tooldata"),
        (WOBJ, "PERS pos wPart:=[1,2,3];", "a pos is no wobjdata"),
        ("wPart:=[FALSE", "wPart:=[TRUE", "the robot holds the work object"),
        ('[FALSE,TRUE,""', '[FALSE,FALSE,""', "the work object moves with the mechanical unit ''"),
        ('[FALSE,TRUE,""', '[FALSE,TRUE,"STN1"', "the work object moves with the mechanical unit 'STN1'"),
        ("[[1500,-200,700]", "[[1500,-200]", "the value has another form than its type"),
        ("[[1500,-200,700]", "[[1500,-200,100001]", "the frame is beyond any cell"),
        (",[[0,0,0],[1,0,0,0]]];", "];", "the work object is no wobjdata"),
        ("[5,[0,0,100],[1,0,0,0],0,0,0]];", "5,6];", "the tool is no tooldata"),
    ],
)  # fmt: skip
def test_frames_that_are_none_are_refused_at_the_first_move(old, new, problem):
    text = module([START])
    assert old in text
    with pytest.raises(PostprocError) as caught:
        read(text.replace(old, new, 1))
    assert problem in caught.value.problem
    assert caught.value.text == MOVE_HOME


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("[[60,0,20]", "[[100001,0,20]", "no robot reaches this target"),
        ("[[60,0,20]", "[[60,0,-100001]", "no robot reaches this target"),
        ("[0,1,0,0]", "[0,1.0006,0,0]", "the orientation is not a unit quaternion"),
        ("[0,0,0,0]", "[0,0,0,8]", "the configuration (cf1, cf4, cf6, cfx) is not understood"),
        ("[0,0,0,0]", "[0,0,0,-1]", "the configuration (cf1, cf4, cf6, cfx) is not understood"),
        ("[0,0,0,0]", "[0,0.5,0,0]", "the configuration (cf1, cf4, cf6, cfx) is not understood"),
        ("[9E9,9E9,", "[9E9,12.5,", "the external axis eax_b is at 12.5"),
        ("9E9]", "-3]", "the external axis eax_f is at -3"),
    ],
)  # fmt: skip
def test_targets_that_no_robot_has_are_refused_at_their_move(old, new, problem):
    text = f"MoveL {TARGET.replace(old, new, 1)},v50,z1,tMill\\WObj:=wPart;"
    with pytest.raises(PostprocError) as caught:
        read(module([START, text, START]))
    assert problem in caught.value.problem
    assert caught.value.text == text
    assert caught.value.advice


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("[[60,0,20]", "[[60,0,20.]"), ("[0,1,0,0]", "[0,1.0004,0,0]"), ("[0,0,0,0]", "[-3,2,5,7]"),
        ("[9E9,9E9,", "[0,9E9,"), ("[9E9,9E9,", "[8.95E9,0.0,"),
    ],
)  # fmt: skip
def test_targets_at_these_limits_are_read(old, new):
    text = f"MoveL {TARGET.replace(old, new, 1)},v50,z1,tMill\\WObj:=wPart;"
    pose = read(module([START, text])).motions.target[-1]
    np.testing.assert_allclose(pose[:3, 3] * 1e3, [60, 0, 20], atol=1e-6)
    np.testing.assert_allclose(pose[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-9)


def test_a_duration_is_the_length_of_the_line_or_arc_over_the_speed():
    """A half circle of radius 10 mm in 2 s."""
    code = [
        START, f"MoveL {at(30, 40, 20)},v50\\T:=2,fine,tMill\\WObj:=wPart;",
        f"MoveC {at(40, 50, 20)},{at(50, 40, 20)},v50\\T:=2,fine,tMill\\WObj:=wPart;",
    ]  # fmt: skip
    motions = read(module(code)).motions
    np.testing.assert_allclose(motions.feed[2:] * 1e3, [25.0, 5.0 * np.pi], rtol=1e-6)
    np.testing.assert_allclose(motions.centre[3] * 1e3, [40, 40, 20], atol=1e-4)
    np.testing.assert_allclose(motions.sweep[3], np.pi, rtol=1e-6)
    with pytest.raises(PostprocError, match="a move without length has a duration") as caught:
        read(module([*code[:2], code[1]]))
    assert caught.value.line == 11


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        (["SingArea\\LockAxis4;", "{line}"], "is not known under SingArea\\LockAxis4"),
        (["SingArea\\Wrist;", "{circle}"], "the turn along a circle is not known under SingArea\\Wrist"),
        (["CirPathMode\\CircPointOri;", "{circle}"], "this CirPathMode is not followed"),
        (["SingArea\\LockAxis4;", "{plain}"], None), (["SingArea\\LockAxis4;", "{joint}"], None),
        (["CirPathMode\\CircPointOri;", "{flat}"], None), (["SingArea\\Wrist;", "{line}"], None),
        (["CirPathMode\\CircPointOri;", "{line}"], None),
    ],
)  # fmt: skip
def test_turns_of_the_tool_that_are_not_known_are_refused_where_it_turns(code, problem):
    turned = "[0.1,0.994987437,0,0]"
    behind = ",v50,z1,tMill\\WObj:=wPart;"
    forms = {
        "line": f"MoveL {at(60, 0, 20, turned)}{behind}",
        "circle": f"MoveC {VIA},{at(20, 0, 20, turned)}{behind}",
        "plain": f"MoveL {TARGET}{behind}", "joint": f"MoveJ {at(60, 0, 20, turned)}{behind}",
        "flat": f"MoveC {VIA},{END}{behind}",
    }  # fmt: skip
    lines = [START, *(line.format(**forms) for line in code)]
    if problem is None:
        assert len(read(module(lines)).motions) == 3
        return
    with pytest.raises(PostprocError) as caught:
        read(module(lines))
    assert problem in caught.value.problem
    assert caught.value.text == lines[-1]
    assert caught.value.advice


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_every_target_is_in_the_line_that_the_table_names(tmp_path, end):
    """Also inserted ones, in a loop, on a circle, behind other statements, and in data, with X, Y, Z of the row."""
    tail = ",v50,z1,tMill\\WObj:=wPart;"
    code = [
        "CirPathMode\\ObjectFrame;", START.replace("MoveL", "MoveJ"), "! FORCE FX=300 FY=-100",
        f"MoveL {at(160, 60, 20)}{tail}", "SetDO do1,1;",
        f"MoveC {at(170, 70, 20)},{at(180, 60, 20)}{tail}", "FOR i FROM 1 TO 2 DO",
        f"MoveL Offs(p,0,20*i,0){tail}", "ENDFOR", f"SetDO do2,1; MoveL p{tail}", f"MoveL {at(0, 60, 20)}{tail} ! end",
        f"SetDO do3,1; MoveL {at(400, 350, 20)}{tail}",
    ]  # fmt: skip
    data = f"  CONST robtarget p:={at(180, 0, 20)};"
    (tmp_path / "Part.mod").write_bytes(module(code, data).replace("\n", end).encode())
    printed("convert", tmp_path / "Part.mod", "--cell", ABB_CELL_FILE, "-o", tmp_path / "out")
    lines = (tmp_path / "out" / "Part.mod").read_bytes().decode().split(end)
    with (tmp_path / "out" / "Part.targets.csv").open() as file:
        rows = [{key: text for key, text in row.items() if text} for row in csv.DictReader(file)]
    assert len(rows) > 11
    assert "    SetDO do3,1; " in lines  # its move has inserted targets, in lines between them
    numbers = [int(row["output_line"]) for row in rows]
    assert numbers == sorted(set(numbers))
    moves = [number for number, line in enumerate(lines, 1) if re.search(r"\bMove[LCJ] ", line)]
    assert numbers == moves
    for row in rows:
        line = lines[int(row["output_line"]) - 1]
        place = re.findall(r"\[\[([-\d.]+),([-\d.]+),([-\d.]+)\]", line)
        if place:
            command = [float(row[name]) for name in ("X_cmd", "Y_cmd", "Z_cmd")]
            np.testing.assert_allclose([float(text) for text in place[-1]], command, atol=2e-4)
        else:
            assert "MoveL p," in line


def test_a_module_whose_last_line_has_moves_is_corrected(tmp_path):
    """The inserted lines end as those of other texts do."""
    behind = ",v50,z1,tMill\\WObj:=wPart;"
    text = module([START.replace("MoveL", "MoveJ"), "! FORCE FX=300 FY=-100"]).partition("  ENDPROC")[0]
    text += f"MoveL {at(160, 60, 20)}{behind} MoveL {at(160, 160, 20)}{behind} ENDPROC ENDMODULE"
    (tmp_path / "Part.mod").write_text(text)
    printed("convert", tmp_path / "Part.mod", "--cell", ABB_CELL_FILE, "-o", tmp_path / "out")
    lines = (tmp_path / "out" / "Part.mod").read_text().splitlines()
    assert lines[-1].endswith("ENDPROC ENDMODULE")
    assert [line.count("MoveL") for line in lines[-2:]] == [1, 2]


def test_a_program_without_motions_is_refused():
    with pytest.raises(PostprocError, match="there are no motions"):
        read(module([]).replace(MOVE_HOME, ""))
    with pytest.raises(PostprocError, match="there is no PROC"):
        read("MODULE a\nENDMODULE")


@pytest.mark.parametrize("via", [at(30, 0, 20), at(40, 0, 20), at(20, 0, 20)])
def test_a_circle_through_points_on_a_line_is_refused_at_its_move(via):
    good = f"MoveC {VIA},{END},v50,z1,tMill\\WObj:=wPart;"
    flat = f"MoveC {via},{at(40, 0, 20)},v50,z1,tMill\\WObj:=wPart;"
    with pytest.raises(PostprocError, match="the three points of the circle are on a line or coincide") as caught:
        read(module([START, good, flat, good]))
    assert caught.value.line == 11
