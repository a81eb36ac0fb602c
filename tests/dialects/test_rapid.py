"""RAPID: what is written means what was computed, by a grammar and an arm of their own; what is not ours is refused."""

from __future__ import annotations

import contextlib
import csv
import json
import re
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from postproc import kinematics, robot
from postproc.dialects import krl
from postproc.dialects.rapid import language
from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.text import decode
from postproc.errors import PostprocError, ProgramError
from postproc.program import CIRC, LIN, PTP
from tests.commands import convert_text, printed
from tests.dialects.rapid_grammar import confdata, elbow_and_wrist, frame, parse
from tests.dialects.rapid_reading import place, read
from tests.oracle.arm import Arm
from tests.places import ABB_CELL_FILE, SAMPLES

MODEL = "abb_irb6700_200_260"
GCODE = (
    "G90 G21\n(FORCE FX=300 FZ=200)\nS1000 M3 F600\nG0 X0 Y0 Z10\nG1 Z0\nG1 X20\nG4 P0.5\nG3 X40 Y20 I0 J20\n"
    "G1 Y40\nG1 X41 Y60\n(FORCE OFF)\nG0 Z30\nM5\nM2\n"
)


def convert_to_rapid(folder, text=GCODE, *options, cell=ABB_CELL_FILE, code=0):
    output = convert_text(folder, "part.nc", text, "--to", "rapid", *options, code=code, cell=cell).output
    return output if code else (folder / "out" / "part.mod").read_bytes().decode("ascii")


@pytest.fixture(scope="module")
def pocket(tmp_path_factory):
    """Folder with pocket.mod and what goes with it."""
    folder = tmp_path_factory.mktemp("pocket")
    printed("convert", SAMPLES / "pocket.nc", "--cell", ABB_CELL_FILE, "--to", "rapid", "-o", folder)
    return folder


def rows_of(folder, name="pocket"):
    with (folder / f"{name}.targets.csv").open() as file:
        return [{key: float(text) for key, text in row.items() if text} for row in csv.DictReader(file)]


# --- conventions ---------------------------------------------------------------------------------------------------


def test_the_model_folder_is_the_arm_of_the_data_sheet_in_abb_axes():
    model = robot.load(robot.find(MODEL))
    q = np.random.default_rng(3).uniform(model.lower, model.upper, (200, 6))
    poses, _ = kinematics.tcp(model.nominal, q, np.eye(4))
    for angles, pose in zip(language.abb_from_joints(q), poses, strict=True):
        tool0 = elbow_and_wrist(angles)[2]
        np.testing.assert_allclose(pose[:3, 3] * 1e3, tool0[:3, 3], atol=1e-6)
        np.testing.assert_allclose(pose[:3, :3], tool0[:3, :3], atol=1e-9)
    np.testing.assert_allclose(language.joints_from_abb(language.abb_from_joints(q)), q, atol=1e-12)


def test_joint_limits_are_those_of_the_data_sheet():
    model = robot.load(robot.find(MODEL))
    ends = language.abb_from_joints(np.array([model.lower, model.upper]))
    expected = [[-170, 170], [-65, 85], [-180, 70], [-300, 300], [-130, 130], [-360, 360]]
    np.testing.assert_allclose(np.sort(ends, axis=0).T, expected, atol=1e-6)


def test_confdata_tell_the_branch_on_which_the_arm_stands():
    model = robot.load(robot.find(MODEL))
    q = np.random.default_rng(4).uniform(model.lower, model.upper, (500, 6))
    found = language.configuration(q, kinematics.status_of(model, q))
    expected = [confdata(angles) for angles in language.abb_from_joints(q)]
    assert found.tolist() == expected
    assert {row[3] for row in expected} == set(range(8))
    assert language.status_from_cfx(found[:, 3]).tolist() == kinematics.status_of(model, q).tolist()


def test_an_angle_that_is_a_quadrants_beginning_but_for_rounding_is_in_it():
    q = language.joints_from_abb(np.array([[-1e-12, 10.0, 0.0, 90.0 - 1e-12, 30.0, -90.0 - 1e-12]]))
    assert language.configuration(q, np.array([2])).tolist() == [[0, 1, -1, 0]]


@settings(max_examples=80, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3), st.sampled_from([1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-9, np.pi]))
def test_quaternions_are_those_of_scipy(axis, angle):
    axis = np.array(axis) if np.linalg.norm(axis) > 1e-3 else np.array([0.0, 0.0, 1.0])
    rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    q = language.quaternions(rotation.as_matrix()[None])[0]
    expected = np.roll(rotation.as_quat(), 1)
    assert min(np.abs(q - expected).max(), np.abs(q + expected).max()) < 1e-12
    assert q[0] >= 0.0
    np.testing.assert_allclose(language.rotations(q[None])[0], rotation.as_matrix(), atol=1e-12)


# --- what is written -------------------------------------------------------------------------------------------------


def test_every_target_is_where_its_joint_angles_bring_abbs_arm(pocket):
    data, code = parse((pocket / "pocket.mod").read_bytes().decode("ascii"))
    rows = {int(row["output_line"]): row for row in rows_of(pocket)}
    moves = [one for one in code if one[1] in ("MoveJ", "MoveL", "MoveC")]
    assert len(moves) == len(rows) > 500
    assert {name for _, name, *_ in moves} == {"MoveJ", "MoveL", "MoveC"}
    for line, _, arguments, work_object in moves:
        *_, (position, orientation, conf, external), _speed, _zone, tool = arguments
        row = rows[line]
        angles = language.abb_from_joints(np.radians([row[f"A{axis}"] for axis in range(1, 7)]))
        tcp = elbow_and_wrist(angles)[2] @ frame(data[tool][1][1])
        wobj = data[work_object][1]
        target = frame(wobj[3]) @ frame(wobj[4]) @ frame([position, orientation])
        assert np.abs(tcp[:3, 3] - target[:3, 3]).max() < 5e-4  # angles have 5 decimals: 0.3 µm each at 2 m
        assert np.abs(tcp[:3, :3] - target[:3, :3]).max() < 1e-6
        assert conf == confdata(angles)
        assert external == [9e9] * 6
        assert abs(np.linalg.norm(orientation) - 1.0) < 1e-7


def test_the_loaded_arm_of_the_oracle_stands_where_the_part_is_to_be_cut(pocket):
    arm = Arm.load(robot.find(MODEL))
    data, code = parse((pocket / "pocket.mod").read_bytes().decode("ascii"))
    moves = {one[0]: one for one in code if one[1].startswith("Move") and one[1] != "MoveAbsJ"}
    tool, base = frame(data["tool_0"][1][1]), frame(data["wobj_0"][1][3])
    tool[:3, 3] /= 1e3
    for row in rows_of(pocket)[5::60]:
        *_, (position, *_), _speed, _zone, _tool = moves[int(row["output_line"])][2]
        np.testing.assert_allclose(position, [row["X_cmd"], row["Y_cmd"], row["Z_cmd"]], atol=5.1e-5)
        wrench = np.array([row[name] for name in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")])
        wrench = np.concatenate([base[:3, :3] @ wrench[:3], base[:3, :3] @ wrench[3:]])
        q = np.radians([row[f"A{axis}"] for axis in range(1, 7)])
        tip = arm.loaded_tcp(q, tool, wrench)[:3, 3]
        nominal = base @ np.array([row["X"], row["Y"], row["Z"], 1.0])
        assert np.abs(tip * 1e3 - nominal[:3]).max() < 1e-3


def test_speeds_zones_and_stops_are_those_of_the_program(tmp_path):
    data, code = parse(convert_to_rapid(tmp_path))
    assert data["speed_0"] == ("speeddata", [300.0, 500.0, 5000.0, 1000.0])
    instructions = [name for _, name, *_ in code]
    assert instructions[:6] == ["ConfJ", "ConfL", "CirPathMode", "MoveAbsJ", "SetAO", "SetDO"]
    assert instructions[-2:] == ["ConfL", "CirPathMode"]
    dwell = instructions.index("WaitTime", 8)
    assert code[dwell][2] == [0.5]
    stop = code[dwell - 1][2]
    assert stop[-2] == "fine"
    assert all(code[at - 1][2][-2] == "fine" for at, name in enumerate(instructions) if name == "SetDO" and at > 8)
    for _, name, arguments, _ in code:
        if name in ("MoveL", "MoveC"):
            assert data[arguments[-3]][1][0] in (10.0, 300.0)
            if arguments[-2] != "fine":
                zone = data[arguments[-2]][1]
                assert zone[0] == "FALSE"
                assert 0.0 < zone[1] <= 0.2
                assert zone[2] >= zone[1]


def test_no_circle_is_larger_than_abb_allows(tmp_path):
    _, code = parse(convert_to_rapid(tmp_path, "G90 G21\nF600\nG0 X0 Y0 Z10\nG1 Z0\nG2 X0 Y0 I20 J0\nG0 Z10\nM2\n"))
    here, total = None, 0.0
    for _, name, arguments, _ in code:
        if not name.startswith("Move") or name == "MoveAbsJ":
            continue
        points = [np.array(target[0]) for target in arguments[: 2 if name == "MoveC" else 1]]
        if name == "MoveC":
            a, b, c = here, *points
            u, v, w = np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(c - a)
            inscribed = np.arccos(np.clip((u * u + v * v - w * w) / (2 * u * v), -1, 1))
            total += (sweep := 360.0 - 2 * np.degrees(inscribed))
            assert sweep <= 240.0
        here = points[-1]
    assert abs(total - 360.0) < 0.5


def test_no_circle_is_smaller_than_abb_allows(tmp_path):
    """Limits of MoveC: 0.1 mm from the start to both points, 1 deg between them as seen from there."""
    tiny = "G2 X0.1 I0.05\nG2 X0.5 I0.2\nG1 X10\nG3 X10 Y0.6 J0.3\nG1 X40\nG2 X0 Y40.6 I0 J40\n"
    _, code = parse(
        convert_to_rapid(tmp_path, f"G90 G21\nF600\nG0 X0 Y0 Z10\nG1 Z0\n(FORCE FX=-90 FY=60)\n{tiny}G0 Z10\nM2\n")
    )
    here, circles = None, 0
    for _, name, arguments, _ in code:
        if not name.startswith("Move") or name == "MoveAbsJ":
            continue
        points = [np.array(target[0]) for target in arguments[: 2 if name == "MoveC" else 1]]
        if name == "MoveC":
            a, b = points[0] - here, points[1] - here
            circles += 1
            assert min(np.linalg.norm(a), np.linalg.norm(b)) >= 0.1
            assert np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)) >= 1.0
        here = points[-1]
    assert circles > 0


def test_the_payload_of_the_cell_is_the_load_of_the_tool(tmp_path):
    cell = tmp_path / "cell.toml"
    cell.write_text(ABB_CELL_FILE.read_text() + "\n[payload]\nmass_kg = 12.5\nX = 5\nZ = 150\n")
    data, _ = parse(convert_to_rapid(tmp_path, cell=cell))
    assert data["tool_0"][1][2] == [12.5, [5.0, 0.0, 150.0], [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0]
    kinds = [issue["kind"] for issue in json.loads((tmp_path / "out" / "part.report.json").read_text())["issues"]]
    assert "tool-load" not in kinds


def test_a_module_longer_than_the_cell_allows_is_named_and_written(tmp_path):
    def kinds(limit):
        cell = tmp_path / "cell.toml"
        cell.write_text(ABB_CELL_FILE.read_text().replace("[output]\n", f"[output]\nlines_per_file = {limit}\n"))
        length = convert_to_rapid(tmp_path, GCODE, "--nominal", "--overwrite", cell=cell).count("\n")
        report = json.loads((tmp_path / "out" / "part.report.json").read_text())
        return length, [issue["kind"] for issue in report["issues"]].count("long-file")

    length, count = kinds(100000)
    assert count == 0
    assert kinds(length)[1] == 0
    assert kinds(length - 2)[1] == 1


def test_forces_come_along_as_comments_that_are_read_again(tmp_path):
    text = convert_to_rapid(tmp_path)
    notes = read(text).notes
    assert notes[0].wrench[0] == 300.0
    assert [note.before for note in notes] == sorted(note.before for note in notes)
    lines = text.split("\r\n")
    moves = read(text).motions.line
    for note in notes:
        following = next(n for n, line in enumerate(lines, 1) if n > note.line and line.strip().startswith("Move"))
        assert moves[note.before] == following
    assert notes[-1].wrench == (0.0,) * 6


def test_the_module_says_where_it_comes_from_and_is_not_converted_again(tmp_path):
    text = convert_to_rapid(tmp_path)
    line = text.split("\r\n")[1]
    assert line.startswith("!POSTPROC 1 ")
    module = tmp_path / "out" / "part.mod"
    said = printed("convert", module, "--cell", ABB_CELL_FILE, "-o", tmp_path / "twice", code=1)
    assert "corrected by postproc" in said
    module.write_text(text.replace("MoveL", "MoveL  ", 1))
    assert RAPID.writer.origin([decode("part.mod", module.read_bytes())]).state == "changed"


def test_prediction_of_what_was_written_says_what_its_targets_make_up_for(tmp_path):
    convert_to_rapid(tmp_path)
    printed("predict", tmp_path / "out" / "part.mod", "--cell", ABB_CELL_FILE, "-o", tmp_path / "seen")
    report = json.loads((tmp_path / "seen" / "part.predict.report.json").read_text())
    corrected = json.loads((tmp_path / "out" / "part.report.json").read_text())
    assert corrected["after"]["max_mm"] < 0.001
    assert abs(report["before"]["max_mm"] / corrected["before"]["max_mm"] - 1.0) < 0.002


def test_a_name_that_rapid_does_not_allow_is_made_valid(tmp_path):
    (tmp_path / "1-stop.nc").write_text(GCODE)
    printed("convert", tmp_path / "1-stop.nc", "--cell", ABB_CELL_FILE, "--to", "rapid", "-o", tmp_path)
    assert "PROC P1_stop()" in (tmp_path / "P1_stop.mod").read_text()
    printed(
        "convert",
        tmp_path / "1-stop.nc",
        "--cell",
        ABB_CELL_FILE,
        "--to",
        "rapid",
        "-o",
        tmp_path,
        "--name",
        "while",
        code=2,
    )


def test_names_are_those_of_rapid():
    assert language.fault_of("a" * 28) is None
    for name in ("a" * 29, "_a", "1a", "ä", "a b", "while", "MoveTo", "stop", ""):
        assert language.fault_of(name) is not None, name
        assert language.fault_of(language.valid_name(name)) is None, name


@pytest.mark.parametrize(
    ("name", "valid"),
    [("part_", "part_"), ("a__b", "a__b"), ("_a-", "a"), ("1", "P1"), ("---", "PROGRAM"), ("Größe", "Groesse"),
     ("a" * 30, "a" * 28), ("a" * 27 + "--b", "a" * 27), ("if", "P_if"), ("Trigg" + "a" * 23, "P_Trigg" + "a" * 21)],
)  # fmt: skip
def test_a_name_is_kept_if_it_is_valid_or_becomes_a_similar_one(name, valid):
    assert language.valid_name(name) == valid
    assert language.fault_of(valid) is None


def test_a_renamed_program_is_the_program_of_that_name(tmp_path):
    documents = [decode("part.mod", convert_to_rapid(tmp_path).encode())]
    (renamed,) = RAPID.writer.rename(documents, "other")
    assert renamed.name == "other.mod"
    assert "MODULE mod_other\r\n" in renamed.text
    assert "PROC other()" in renamed.text
    assert renamed.text.count("\n") == documents[0].text.count("\n")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("$OUT[1]=TRUE", "not a RAPID instruction"),
        ("SetDO doSpindle,1", "not a RAPID instruction"),
        ("MoveL p1,v100,fine,tool0;", "moves the robot"),
        ("ConfL\\\\On;", "changes how it moves"),
        ("RETURN;", "changes the execution order"),
        ("speed_1:=v100;", "is used by the moves"),
    ],
)
def test_lines_of_the_cell_that_cannot_stand_there_are_refused(tmp_path, line, words):
    cell = tmp_path / "cell.toml"
    cell.write_text(ABB_CELL_FILE.read_text().replace('"SetDO doSpindle,1;"', f'"{line}"'))
    said = convert_to_rapid(tmp_path, cell=cell, code=1)
    assert words in said
    assert "in the cell" in said


def test_krl_is_not_written_as_rapid(tmp_path):
    said = printed("convert", SAMPLES / "inline.src", "--cell", ABB_CELL_FILE, "--to", "rapid", "-o", tmp_path, code=1)
    assert "krl is written in krl again" in said


# --- what is read ----------------------------------------------------------------------------------------------------


def test_what_is_written_is_read_as_the_same_program_in_krl(tmp_path):
    """Both dialects of one program: the same motions, frames, speeds and zones."""
    cell = tmp_path / "cell.toml"
    own = ("spindle", "coolant", "tool_change", "robot")  # lines of RAPID, which are no KRL
    shutil.copytree(robot.find(MODEL), tmp_path / "any")  # reads both
    model = (tmp_path / "any" / "model.toml").read_text()
    (tmp_path / "any" / "model.toml").write_text(model.replace('language = "rapid"', ""))
    cell.write_text(
        'robot = "any"\n'
        + "".join(line for line in ABB_CELL_FILE.read_text().splitlines(True) if not line.startswith(own))
    )
    # without the wait, behind which the force rises over a piece of arc that is too small for MoveC
    text = convert_to_rapid(tmp_path, GCODE.replace("G4 P0.5\n", ""), "--nominal", cell=cell)
    printed("convert", tmp_path / "part.nc", "--cell", cell, "--nominal", "-o", tmp_path / "krl")
    other = krl.read_program(
        [decode("part.src", (tmp_path / "krl" / "part.src").read_bytes())], place().cell, place().forward, "part"
    )
    one = read(text)
    a, b = one.motions, other.motions
    assert a.kind.tolist() == b.kind.tolist()
    assert {LIN, CIRC, PTP} == set(a.kind.tolist())
    np.testing.assert_allclose(a.target[:, :3, 3], b.target[:, :3, 3], atol=2e-7)
    np.testing.assert_allclose(a.target[:, :3, :3], b.target[:, :3, :3], atol=3e-7)
    np.testing.assert_allclose(a.joints, b.joints, atol=1e-6)
    np.testing.assert_allclose(a.feed, b.feed, rtol=1e-6)
    np.testing.assert_allclose(a.blend, b.blend, rtol=1e-6)
    np.testing.assert_allclose(a.sweep, b.sweep, atol=1e-4)
    np.testing.assert_allclose(a.centre, b.centre, atol=1e-6)
    free = np.isnan(a.joints[:, 0]) & (a.kind == PTP)
    assert (a.status[free] == b.status[free] % 8).all()
    np.testing.assert_allclose(one.bases[0], other.bases[0], atol=1e-7)
    np.testing.assert_allclose(one.tools[0], other.tools[0], atol=1e-7)
    np.testing.assert_allclose(one.numbers_as_written()[1:, :3], other.numbers_as_written()[1:, :3], atol=1e-9)


SPOILT = [
    ("ENDMODULE", ""),
    ("  ENDPROC", "    RETURN\r\n  ENDPROC"),
    ("    MoveJ ", "    IF x=1 THEN\r\n    MoveJ "),
    ("    MoveJ ", "    MoveL p10,v100,fine,tool0;\r\n    MoveJ "),
    ("    MoveJ ", "    TriggL p10,v100,t1,fine,tool0;\r\n    MoveJ "),
    ("    MoveJ ", "    SearchL di1,p1,[[0,0,0],[1,0,0,0],[0,0,0,0],[0,0,0,0,0,0]],v100,tool0;\r\n    MoveJ "),
    ("    MoveJ ", "    SoftAct 3,20;\r\n    MoveJ "),
    ("    MoveJ ", "    PDispOn p1,tool0;\r\n    MoveJ "),
    ("    MoveJ ", "    tool_0:=CTool();\r\n    MoveJ "),
    (",fine,tool_0", ",z11,tool_0"),
    ("9E+09]]", "100]]"),
    ("[FALSE,TRUE,", "[TRUE,TRUE,"),
    ("[FALSE,TRUE,", "[FALSE,FALSE,"),
    ("tooldata tool_0:=[TRUE", "tooldata tool_0:=[FALSE"),
    ("LOCAL CONST speeddata speed_0:=[300", "LOCAL CONST speeddata speed_0:=[0"),
    ("LOCAL CONST speeddata speed_0:=[300", "LOCAL CONST speeddata speed_0:=[NaN"),
    (",[0.00000000,", ",[0.50000000,"),
    ("\\WObj:=wobj_0;", "\\WObj:=wobj_0\\ID:=10;"),
    ("\\WObj:=wobj_0;", "\\WObj:=wobj_0\\Corr;"),
    ("\\WObj:=wobj_0;", "\\WObj:=wobj_0"),
]


@pytest.mark.parametrize(("old", "new"), SPOILT)
def test_what_is_not_understood_is_refused_with_its_line(tmp_path, old, new):
    text = convert_to_rapid(tmp_path, GCODE, "--nominal")
    assert old in text
    with pytest.raises(ProgramError) as caught:
        read(text.replace(old, new, 1))
    assert caught.value.line
    assert caught.value.advice


def test_the_orientation_at_a_point_on_a_circle_is_a_unit_quaternion_too(tmp_path):
    text = convert_to_rapid(tmp_path, GCODE, "--nominal")
    changed = re.sub(r"(MoveC \[\[[^]]*\],\[)[^]]*\]", r"\g<1>0,0,0,0]", text, count=1)
    assert changed != text
    with pytest.raises(ProgramError, match="unit quaternion"):
        read(changed)


_TEXT: list[str] = []


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0, 1),
    st.integers(0, 3),
    st.sampled_from(["", "[", "]", ",", ";", "1e999", "-", "x", "\r\n", "0", ".", "é"]),
)
def test_slips_are_refused_with_a_message_or_read(tmp_path_factory, where, removed, slip):
    if not _TEXT:
        _TEXT.append(convert_to_rapid(tmp_path_factory.mktemp("slips"), GCODE, "--nominal"))
    at = round(where * len(_TEXT[0]))
    text = _TEXT[0][:at] + slip + _TEXT[0][at + removed :]
    with contextlib.suppress(PostprocError):
        assert np.isfinite(read(text).motions.target).all()


def test_procedures_of_the_user_are_named(tmp_path):
    cell = tmp_path / "cell.toml"
    cell.write_text(ABB_CELL_FILE.read_text().replace('"SetDO doSpindle,1;"', '"SpindleOn {S};"'))
    issues = read(convert_to_rapid(tmp_path, cell=cell)).issues
    assert [(issue.kind, issue.subject) for issue in issues] == [("external-call", "SPINDLEON")]
