"""Cell files: what is missing or wrong is told, all keys at once."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest

from postproc import cell
from postproc.errors import CellError
from tests.kr270 import CELL_TEXT

_BARE = 'robot = "kuka_kr270"\n[base]\nX = 1500\n[tool]\nZ = 350\n'


def _load(tmp_path: Path, text: str) -> cell.Cell:
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return cell.load(path)


def test_all_missing_keys_are_told_at_once_with_an_example_that_loads(tmp_path: Path) -> None:
    with pytest.raises(CellError, match=r"missing keys: robot, \[base\], \[tool\]\. The least") as caught:
        _load(tmp_path, "[output]\n")
    example = str(caught.value.advice).partition("\n\n")[2]
    assert _load(tmp_path, example).robot == "kuka_kr270"


def test_all_unknown_and_missing_keys_are_told_in_one_run(tmp_path: Path) -> None:
    text = CELL_TEXT.replace("tolerance_mm", "tolerence_mm").replace("[start]", "[begin]").replace("axis =", "axes =")
    with pytest.raises(CellError) as caught:
        _load(tmp_path, text)
    error = caught.value
    assert sorted(e.problem for e in (error, *error.further_errors)) == [
        "unknown key 'axes' in [tool]",
        "unknown key 'tolerence_mm' in [output]",
        "unknown table [begin]",
    ]
    assert "Valid keys: tolerance_mm, max_correction_mm" in str(error)


def test_a_misspelt_table_is_named_with_its_line_and_not_also_called_missing(tmp_path: Path) -> None:
    text = CELL_TEXT.replace("[base]", "[bse]")
    with pytest.raises(CellError) as caught:
        _load(tmp_path, text)
    line = text[: text.index("[bse]")].count("\n") + 1
    assert f"cell.toml:{line}: unknown table [bse]. Did you mean `base`? Valid keys: robot, base," in str(caught.value)
    assert caught.value.further_errors == ()


def test_where_a_key_is_unknown_and_another_missing_no_example_hides_the_first(tmp_path: Path) -> None:
    with pytest.raises(CellError) as caught:
        _load(tmp_path, CELL_TEXT.replace("[base]", "[workpiece]"))
    error = caught.value
    assert [e.problem for e in (error, *error.further_errors)] == ["missing key: [base]", "unknown table [workpiece]"]
    assert "The least that a cell needs" not in str(error)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("tolerance_mm = 0.01", "tolerance_mm = 1e-300", "output.tolerance_mm: .*>= 0.0001"),
        (
            "force_ramp_mm = 1.0",
            'controller = "KRC5"',
            r"output.controller: .*'KRC5'. Did you mean `KRC4`\? Valid values: 'KRC2', 'KRC4'. A KR C5 with KSS",
        ),
        ('axis = "+Z"', 'axis = "up"', r"tool.axis: .*'up'. Valid values: '\+X', '\+Z', '-X', '-Z'."),
        ("X = 1500.0", 'X = "1500"', r"cell.toml:5: base.X: a number is expected, not a text in quotes"),
        (
            "X = 1500.0",
            "X = 1500,0",
            r"cell.toml:5: not valid TOML: .* \(column 9\). .*with a point, not a comma: 1500\.0",
        ),
        ("[base]", "[bases]", r"unknown table \[bases\]. Did you mean `base`"),
        (
            "[work_offsets.G54]",
            "[work_offsets.G59.3]",
            r"unknown table \[work_offsets.G59.3\]. A name with a dot is in quotes: \[work_offsets.\"G59.3\"\]. Valid",
        ),
        ("X = 1500.0", "X = 1e300", "base.X: Expected `float` <= 1000000.0"),
        ("X = 1500.0", "X = 1" + "0" * 400, "base.X: "),
        ("X = 1500.0", "X = 1" + "0" * 5000, "not valid TOML"),
        ("X = 1500.0", "X = nan", "base.X is nan"),
        ("X = 1500.0", "X = " + "[" * 5000, "not valid TOML"),
        ("[0, -90, 100, 0, 80, 0]", "[0, -70]", "start.joints: Expected a list of length 6, got 2"),
        (
            "[0, -90, 100, 0, 80, 0]",
            "[0, -1.22, 1.92, 0, 0.87, 0]",
            r"\[start\] joints = .* look like radians.*degrees",
        ),
        ("[start]", "[payload]\nmass_kg = 80000\n[start]", "payload.mass_kg: Expected `float` <= 3000.0, not 80000"),
        ("rapid_m_per_s = 0.3", "rapid_m_per_s = 300", "gcode.rapid_m_per_s: Expected `float` <= 10"),
        ("[base_data.3]", '[base_data."²"]', r"base_data\.²"),
        ("[base_data.3]", f"[base_data.{'3' * 5000}]", "is not a number"),
        ("[work_offsets.G54]", "[work_offsets.G60]", "Valid names: G54"),
        ("[work_offsets.G54]", "[m_codes]\nM8000x = []\n[work_offsets.G54]", "Valid names: M10"),
        ("[work_offsets.G54]", "[m_codes]\nM031 = []\n[work_offsets.G54]", "M031. Write M31"),
        ("[work_offsets.G54]", "[m_codes]\nM1 = []\n[work_offsets.G54]", "M1 has a meaning already. The program stops"),
        ("[work_offsets.G54]", "[m_codes]\nM03 = []\n[work_offsets.G54]", "M03 has a meaning already. .*: spindle_on"),
        ("[work_offsets.G54]", "[m_codes]\nM6 = []\n[work_offsets.G54]", "M6 has a meaning already. .*: tool_change"),
        ("[work_offsets.G54]", "[m_codes]\nM9 = []\n[work_offsets.G54]", "M9 has a meaning already. .*: coolant_off"),
        ("[work_offsets.G54]", "[m_codes]\nM98 = []\n[work_offsets.G54]", "M98 has a meaning already"),
        ('robot = "kuka_kr270"', 'robot = "kuka_kr270"\nfolder = "elsewhere"', "unknown key 'folder'"),
    ],
)
def test_what_a_key_may_hold_is_told(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in CELL_TEXT
    with pytest.raises(CellError, match=message):
        _load(tmp_path, CELL_TEXT.replace(old, new, 1))


@pytest.mark.parametrize(
    ("key", "lines", "message"),
    [
        ("tool_change", ["HALT", "CHG({T)"], "'CHG({T)': { is not closed"),
        ("spindle_on", ["SPIN({S}"], "'SPIN({S}': ( is not closed"),
        ("spindle_ccw", ["SPIN({S}))"], "'SPIN({S}))': ) closes no bracket"),
        ("spindle_off", ['MsgNotify("off)'], """'MsgNotify("off)': the string after " has no end"""),
        ("coolant_on", ["$OUT[1=TRUE"], "'$OUT[1=TRUE': [ is not closed"),
        ("coolant_off", ["$OUT1]=TRUE"], "'$OUT1]=TRUE': ] closes no bracket"),
        ("M31", ["HOOK("], "'HOOK(': ( is not closed"),
    ],
)
def test_a_line_that_is_not_closed_is_named_with_its_key(
    tmp_path: Path, key: str, lines: list[str], message: str
) -> None:
    table = "m_codes" if key == "M31" else "gcode"
    with pytest.raises(CellError, match=re.escape(f"[{table}] {key}, {message}")):
        _load(tmp_path, f"{_BARE}[{table}]\n{key} = {json.dumps(lines)}\n")


@pytest.mark.parametrize(
    "line",
    ["LIN {X 0}", " lin_rel {Z 10}", "SCIRC P1,P2", "SPL XP3", "PTP {X 0,Y 0,Z 0,A 0,B 0,C 180}", "SPTP_REL {Z 10}"],
)
@pytest.mark.parametrize("key", ["gcode.spindle_off", "m_codes.M31"])
def test_a_line_with_a_motion_to_a_target_is_refused_with_its_key(tmp_path: Path, key: str, line: str) -> None:
    table, name = key.split(".")
    with pytest.raises(CellError, match=re.escape(f"[{table}] {name}, {line!r} moves the tool to a target. Move by")):
        _load(tmp_path, f"{_BARE}[{table}]\n{name} = {json.dumps(['$OUT[1]=FALSE', line])}\n")


@pytest.mark.parametrize(
    "lines",
    [
        ["; LIN {X 0}", "PTP XHOME", "SPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}", "PTP_REL {A1 10}", "LINEAR_LAMP(TRUE)"],
        ["; by hand (see sheet", 'CHG({T}, "a ) ; b") ; 5" ('],
        ["! by hand (see sheet", "MoveAbsJ [[0,0,0,0,0,0],", "[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tool0;"],
    ],
)
def test_comments_strings_and_statements_of_several_lines_are_lines(tmp_path: Path, lines: list[str]) -> None:
    assert _load(tmp_path, f"{_BARE}[gcode]\ntool_change = {json.dumps(lines)}\n").gcode.tool_change == lines


def test_the_folder_of_a_cell_is_that_of_its_file(tmp_path: Path) -> None:
    assert _load(tmp_path, CELL_TEXT).folder == str(tmp_path)
    assert set(tomllib.loads(CELL_TEXT)) <= set(cell.CellFile.__struct_fields__)
