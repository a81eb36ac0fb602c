"""The post driven as the programs that RoboDK generates drive it, with RoboDK's own poses."""

from __future__ import annotations

import csv
import importlib.util
import json
import math
import re
import sys
import warnings
from pathlib import Path

import pytest

from postproc.hosts import HOSTS, install_post, remove_post
from tests.places import CELL_FILE

with warnings.catch_warnings():
    warnings.simplefilter("ignore", PendingDeprecationWarning)  # robodk warns about itself
    from robodk.robomath import KUKA_2_Pose

START = [0.0, -70.0, 110.0, 0.0, 50.0, 0.0]


@pytest.fixture
def posts(tmp_path):
    folder = tmp_path / "Posts"
    folder.mkdir()
    install_post("robodk", folder)
    return folder


@pytest.fixture
def post(posts, tmp_path, monkeypatch):
    """The class as RoboDK loads it: from its file, in a Python that knows nothing of postproc."""
    monkeypatch.setenv("POSTPROC_CELL", str(CELL_FILE))
    monkeypatch.delitem(sys.modules, "postproc_host", raising=False)
    spec = importlib.util.spec_from_file_location("KUKA_KRC4_compensated", posts / "KUKA_KRC4_compensated.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.RobotPost("KUKA_KRC4_compensated", "KUKA KR 270 R2700", 6)


def _limited(post, lines):
    """The post as RoboDK makes it where its options limit the lines of a program."""
    return type(post)("KUKA_KRC4_compensated", "KUKA KR 270 R2700", 6, lines_x_prog=lines, pulses_x_deg=[1] * 6)


def _pose(x, y, z, a=0.0, b=0.0, c=180.0):
    return KUKA_2_Pose([x, y, z, a, b, c])


def _begin(post, name="Pocket 1"):
    post.ProgStart(name)
    post.RunMessage("Machining project: pocket", True)
    post.setFrame(_pose(1500, -200, 700, 0, 0, 0), 3, "Part")
    post.setTool(_pose(0, 0, 350, 0, 0, 0), 2, "Spindle")
    post.setSpeed(200.0)
    post.setZoneData(0.2)
    post.MoveJ(None, START, None)


def _mill(post, count=50):
    post.RunMessage("FORCE FX=-110 FY=190 FZ=130", True)
    post.MoveL(_pose(0, 0, 5, a=-180), [])
    post.setSpeed(25.0)
    for k in range(count):
        post.MoveL(_pose(100.0 * (k + 1) / count, 2.0 * math.sin(k / 5.0), -2.0, a=-180), [])
    post.MoveC(_pose(110, 10, -2, a=-180), [], _pose(100, 20, -2, a=-180), [])


def _rows(path):
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_a_milling_program(post, tmp_path, capsys):
    _begin(post)
    post.setDO(1, 1)
    _mill(post, 2000)
    post.setDO("OUT[7]", 0)
    post.Pause(500)
    post.ProgFinish("Pocket 1")
    out = tmp_path / "out"
    out.mkdir()
    post.ProgSave(str(out), "Pocket 1")
    rows = _rows(out / "Pocket_1.targets.csv")
    assert len(rows) >= 2002
    program = (out / "Pocket_1.src").read_text()
    assert re.match(r"(&.*\n)*DEF Pocket_1\(", program) or "DEF Pocket_1" in program
    for line in ("$OUT[1]=TRUE", "OUT[7]=FALSE", "WAIT SEC 0.500", "$VEL.CP=0.025", "CIRC {"):
        assert line in program
    ends = [row for row in rows if float(row["t"]) == 1.0 and row["rapid"] == "0"]
    assert float(ends[1]["X"]) == pytest.approx(100.0 / 2000)
    assert float(ends[-1]["Y"]) == pytest.approx(20.0)
    assert max(float(row["before_mm"]) for row in rows) > 0.05
    assert max(float(row["after_mm"]) for row in rows) < 0.01
    assert f"SAVED: {out / 'Pocket_1.src'}" in capsys.readouterr().out
    assert [str(out / "Pocket_1.src")] == post.PROG_FILES


@pytest.mark.parametrize("drive", ["ok", "failed"])
def test_a_program_that_fails_is_shown_and_one_that_may_not_be_driven_is_not_posted(
    post, tmp_path, monkeypatch, capsys, drive
):
    _begin(post)
    _mill(post, 3)
    post.ProgFinish("Pocket 1")
    host = sys.modules["postproc_host"]
    run = host._summary_of_run

    def judged(words):
        content = run(words)
        drive_answer = {"state": drive, "reasons": ["the spindle hits the vice"], "unchecked": []}
        answers = ["May it be driven?", "Is it better?", "Does it hold?"]
        verdict = {"state": "failed", "headline": "As judged.", "answers": answers, "reasons": ["why"]}
        content["programs"][0]["verdict"] = verdict | {"drive": drive_answer}
        return content

    monkeypatch.setattr(host, "_summary_of_run", judged)
    out = tmp_path / "out"
    out.mkdir()
    if drive == "failed":
        with pytest.raises(host.HostError, match=r"As judged.\nthe spindle hits the vice"):
            post.ProgSave(str(out), "Pocket 1")
        assert not list(out.glob("Pocket*.src"))
    else:
        post.ProgSave(str(out), "Pocket 1")
        assert (out / "Pocket_1.src").exists()
    shown = capsys.readouterr().err
    assert "As judged." in shown
    assert ("Does it hold?\nwhy" in shown) == (drive == "ok")


def test_two_programs_and_one_without_motion(post, tmp_path):
    post.ProgStart("Main")
    post.RunCode("Roughing", True)
    post.RunCode("Finishing", True)
    post.ProgFinish("Main")
    for name in ("Roughing", "Finishing"):
        _begin(post, name)
        _mill(post)
        post.ProgFinish(name)
    out = tmp_path / "out"
    out.mkdir()
    post.ProgSave(str(out), "Main")
    assert (out / "Main.src").read_text() == "DEF Main()\nRoughing()\nFinishing()\nEND\n"
    assert {path.name for path in out.glob("*.report.json")} == {"Roughing.report.json", "Finishing.report.json"}


def test_a_call_has_the_name_that_the_program_gets(post, tmp_path):
    names = ("Finishing of the side, left 1", "1001-b", "Pocket 2")
    post.ProgStart("Main")
    for name in names:
        post.RunCode(name, True)
    post.RunCode("Gripper (1, TRUE)", True)
    post.ProgFinish("Main")
    for name in names:
        _begin(post, name)
        _mill(post, 3)
        post.ProgFinish(name)
    out = tmp_path / "out"
    out.mkdir()
    post.ProgSave(str(out), "Main")
    _, *calls, gripper, _ = (out / "Main.src").read_text().splitlines()
    assert calls == ["Finishing_of_the_side__l()", "P1001_b()", "Pocket_2()"]
    assert gripper == "Gripper(1, TRUE)"
    assert {f"{path.stem}()" for path in out.glob("*.src")} == {*calls, "Main()"}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("Finishing of the left side 1", "Finishing of the left side 2"),
        ("Pocket-1", "Pocket 1"),
        ("Pocket", "POCKET"),
    ],
)
def test_two_programs_that_would_get_one_name_are_refused(post, tmp_path, capsys, one, other):
    """The second one replaced the first, and was called in its place."""
    _begin(post, one)
    with pytest.raises(Exception, match=f"{one}' and '{other}' would both be"):
        post.ProgStart(other)
    assert "Rename one of them in the station" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("one", "other"), [("Größe", "Grüße"), ("Open gripper", "Open-gripper(1)"), ("Gripper", "gripper (2)")]
)
@pytest.mark.parametrize("calls", [(True, True), (False, True), (True, False)])
def test_a_call_that_would_reach_another_program_is_refused(post, capsys, one, other, calls):
    """The call of a program of the controller ran that of the station, or one for two."""
    names = [text.partition("(")[0].strip() for text in (one, other)]
    first, second = (
        (lambda text=text: post.RunCode(text, True)) if called else (lambda name=name: post.ProgStart(name))
        for text, name, called in zip((one, other), names, calls, strict=True)
    )
    post.ProgStart("Main")
    first()
    with pytest.raises(Exception, match="case does not count"):
        second()
    message = capsys.readouterr().err
    assert all(repr(name) in message for name in names)


@pytest.mark.parametrize("name", ["", " ", "(1)"])
def test_a_call_without_a_name_is_refused(post, name):
    """It became P()."""
    post.ProgStart("Main")
    with pytest.raises(Exception, match="A call in program Main has no name of a program"):
        post.RunCode(name, True)


def test_a_program_without_a_name_is_refused(post):
    with pytest.raises(Exception, match="A program has no name of a program"):
        post.ProgStart("")


@pytest.mark.parametrize("call", ["ROUGHING()", "  Roughing ( ) ; first"])
def test_inserted_krl_in_other_case_calls_a_divided_program_by_its_main_one(post, tmp_path, call):
    """Its call kept the name under which no program was written."""
    post = _limited(post, 40)
    post.ProgStart("Job")
    post.RunCode(call)
    post.ProgFinish("Job")
    _begin(post, "Roughing")
    _mill(post)
    post.ProgFinish("Roughing")
    out = tmp_path / "out"
    out.mkdir()
    post.ProgSave(str(out), "Job")
    assert (out / "Job.src").read_text().splitlines()[1].startswith("RoughingMain")
    assert (out / "RoughingMain.src").is_file()


def test_a_limit_of_lines_divides_programs_and_those_that_call_them_call_the_main_one(post, tmp_path, capsys):
    assert _limited(post, 1e9).MAX_LINES_X_PROG == _limited(post, None).MAX_LINES_X_PROG == 0
    post = _limited(post, 40)
    post.ProgStart("Job")
    post.RunCode("Roughing", True)
    post.RunCode("Cleaning", True)
    post.ProgFinish("Job")
    _begin(post, "Roughing")
    _mill(post)
    post.ProgFinish("Roughing")
    post.ProgStart("Cleaning")
    post.setDO(1, 1)
    post.ProgFinish("Cleaning")
    out = tmp_path / "out"
    out.mkdir()
    post.ProgSave(str(out), "Job")
    assert (out / "Job.src").read_text() == "DEF Job()\nRoughingMain()\nCleaning()\nEND\n"
    names = [Path(path).name for path in post.PROG_FILES]
    assert names[:4] == ["Job.src", "RoughingMain.src", "Roughing1.src", "Roughing2.src"]
    assert names[-1] == "Cleaning.src"
    parts = [path.read_text() for path in out.glob("Roughing[0-9]*.src")]
    assert all(len(text.splitlines()) <= 40 for text in parts)
    assert sum(text.count("LIN {") for text in parts) >= 51
    assert f"SAVED: {out / 'Roughing2.src'}" in capsys.readouterr().out


def test_a_rail_goes_with_the_program(post, tmp_path, monkeypatch):
    cell = tmp_path / "rail.toml"
    cell.write_text(CELL_FILE.read_text() + "\n[external_axes.E1]\ndirection = [0, 1, 0]\n")
    monkeypatch.setenv("POSTPROC_CELL", str(cell))
    post = type(post)("KUKA_KRC4_compensated", "KUKA KR 270 R2700", 7)
    post.ProgStart("Rail")
    post.setFrame(_pose(1500, -200, 700, 0, 0, 0), 3, "Part")
    post.setTool(_pose(0, 0, 350, 0, 0, 0), 2, "Spindle")
    post.setSpeed(25.0)
    post.MoveJ(None, [*START, 100.0], None)
    post.RunMessage("FORCE FX=-110 FY=190 FZ=130", True)
    for k in range(5):
        post.MoveL(_pose(100, 200.0 * k, 0, a=-180), [0, 0, 0, 0, 0, 0, 100.0 + 200.0 * k])
    post.ProgFinish("Rail")
    post.joints["Rail"].clear()  # RoboDK gives true angles; those of this list are made up
    out = tmp_path / "out"
    out.mkdir()
    post.ProgSave(str(out), "Rail")
    rows = _rows(out / "Rail.targets.csv")
    ends = [row for row in rows if float(row["t"]) == 1.0]
    assert [float(row["E1"]) for row in ends] == [100.0, 300.0, 500.0, 700.0, 900.0]
    assert len({row["A1"] for row in ends[1:]}) == 1
    text = (out / "Rail.src").read_text()
    assert all(f"E1 {place:.5f}" in text for place in (100.0, 300.0, 900.0))


def test_tools_frames_and_speeds_change_within_a_program(post, tmp_path):
    _begin(post)
    _mill(post, 10)
    post.setTool(_pose(0, 0, 340, 0, 0, 0), 3, "Short")
    post.setFrame(_pose(1500, -100, 700, 0, 0, 0), 4, "Second part")
    post.MoveJ(None, START, None)
    _mill(post, 10)
    post.ProgFinish("Pocket 1")
    out = tmp_path / "out"
    out.mkdir()
    post.ProgSave(str(out), "Pocket 1")
    program = (out / "Pocket_1.src").read_text()
    assert program.count("$TOOL={") == program.count("$BASE={") == 2


def test_joint_angles_that_are_not_those_of_robodk_are_refused(post, tmp_path):
    _begin(post)
    post.MoveL(_pose(0, 0, 5, a=-180), [0, -70, 110, 180, -50, 180])
    post.ProgFinish("Pocket 1")
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(Exception, match="RoboDK has the robot at"):
        post.ProgSave(str(out), "Pocket 1")
    assert not list(out.glob("*.src"))


def test_what_is_out_of_reach_is_said_with_the_instruction(post, tmp_path):
    _begin(post)
    post.MoveL(_pose(5000, 0, 0, a=-180), [])
    post.ProgFinish("Pocket 1")
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(Exception, match=r"program Pocket_1, line \d+ \(MoveL\): out of reach"):
        post.ProgSave(str(out), "Pocket 1")
    assert not list(out.iterdir())


def test_without_a_cell_file_it_says_where_it_looked(post, tmp_path, monkeypatch):
    monkeypatch.delenv("POSTPROC_CELL")
    _begin(post)
    post.ProgFinish("Pocket 1")
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(Exception, match=r"cell\.toml do not exist.*postproc init"):
        post.ProgSave(str(out), "Pocket 1")


def test_a_postproc_that_is_gone_says_how_to_mend_it(posts, post, tmp_path):
    (posts / "postproc_host" / "command.json").write_text(json.dumps({"command": ["/nowhere/postproc"]}))
    _begin(post)
    _mill(post, 5)
    post.ProgFinish("Pocket 1")
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(Exception, match=r"/nowhere/postproc.*install-post"):
        post.ProgSave(str(out), "Pocket 1")
    assert not list(out.iterdir())


def test_posts_are_removed_and_what_they_share_with_the_last(tmp_path):
    for name in HOSTS:
        install_post(name, tmp_path)
    remove_post("freecad", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"KUKA_KRC4_compensated.py", "postproc_host"}
    assert remove_post("freecad", tmp_path) == []
    remove_post("robodk", tmp_path)
    assert not list(tmp_path.iterdir())


NASTY = 'pocket\nLIN {X 500,Y 0,Z 0,A 0,B 0,C 0}\r$VEL.CP=2.0 "}\x1a'


def test_texts_of_the_station_never_become_statements(post, tmp_path):
    post.ProgStart(f"Pocket {NASTY}")
    post.setFrame(_pose(1500, -200, 700, 0, 0, 0), 3, f"F {NASTY}")
    post.setTool(_pose(0, 0, 350, 0, 0, 0), 2, f"T {NASTY}")
    post.setSpeed(200.0)
    post.setZoneData(0.2)
    post.MoveJ(None, START, None)
    post.RunMessage(NASTY, True)
    post.RunMessage(NASTY)
    _mill(post, 3)
    post.ProgFinish("x")
    post.ProgSave(str(tmp_path), "x")
    (program,) = tmp_path.glob("*.src")
    lines = program.read_text().splitlines()
    assert not [line for line in lines if line.lstrip().upper().startswith(("LIN {X 500", "$VEL.CP=2"))]
    message = [line for line in lines if line.startswith("MsgNotify")]
    assert message == ['MsgNotify("pocket LIN (X 500,Y 0,Z 0,A 0,B 0,C 0) $VEL.CP=2.0 \')")']
    told = 'pocket LIN {X 500,Y 0,Z 0,A 0,B 0,C 0} $VEL.CP=2.0 "}'
    assert {f"; frame F {told}", f"; tool T {told}", f"; {told}"} <= set(lines)


@pytest.mark.parametrize("signal", ["1\nLIN {X 500}", "DOOR OPEN", "$OUT[1]=TRUE $OUT[2]", ""])
def test_a_signal_that_is_no_name_is_refused(post, signal):
    _begin(post)
    with pytest.raises(Exception, match="neither a number nor the name of a signal"):
        post.setDO(signal, 1)
    with pytest.raises(Exception, match="neither a number nor the name of a signal"):
        post.setAO(5, signal)


def test_code_of_several_lines_is_several_lines_of_the_program(post):
    _begin(post)
    before = len(post.programs[post.name])
    post.addline("$OUT[1]=TRUE\r\n$OUT[2]=FALSE\n")
    assert [block.text for block in post.programs[post.name][before:]] == ["$OUT[1]=TRUE", "$OUT[2]=FALSE"]


def test_a_program_whose_only_motion_is_inserted_code_is_corrected_too(post, tmp_path):
    _begin(post, "Own")
    post.programs["Own"] = [block for block in post.programs["Own"] if not block.text.startswith("PTP")]
    post.RunCode("ptp {A1 0,A2 -70,A3 110,A4 0,A5 50,A6 0}")
    post.ProgFinish("Own")
    post.ProgSave(str(tmp_path), "Own")
    assert (tmp_path / "Own.report.json").is_file()
